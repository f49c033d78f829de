//! Our solvers beside measurements of the public code, row by row and cell by cell.
//!
//! In: a CSV table of the public code's runs (its head names the fields that are read: set, label, density,
//! n, instance, method, status, actions, ti_cost, wall_s), and rows of our benchmark on the same instances
//! with several seeds. Out: the units to run, and a text: which rows they solved and we do not dependably,
//! mean cost over bound of both, cells where ours is more than [`WORSE`] dearer, how much sooner our first
//! plan is there. Both costs are taken over our lower bound. Theirs is one run, and on another machine: the
//! ratio of times is an indication.

use crate::bench::cells::{Cell, Unit};
use crate::bench::table::{Key, Row, density_word};
use crate::report::text::columns;
use rearrange::planning::plan::Objective;
use rearrange::planning::solver::SolverKind;
use std::collections::BTreeMap;

/// Cells whose cost over bound is larger than theirs by more than this share are listed.
pub const WORSE: f64 = 0.05;

/// Share of the seeds in which a row has to be solved, as a fraction: 9 of 10.
const DEPENDABLE: (usize, usize) = (9, 10);

/// Their runs shorter than this reflect more of the start of a program than of its search, s.
const LEAST_SECONDS: f64 = 0.1;

/// Status of a row that says only why there was no run.
const SKIPPED: &str = "skipped";

/// One run of the public code.
#[derive(Clone, Debug, PartialEq)]
pub struct Measured {
    /// Where it belongs, in our words.
    pub cell: Cell,
    /// Name of the instance.
    pub id: String,
    /// Solver.
    pub solver: SolverKind,
    /// Cost of its plan in the objective; None: no plan.
    pub cost: Option<f64>,
    /// Wall time.
    pub seconds: f64,
}

/// Reads the table; `source` names it in complaints. Rows of status `skipped` are no runs and are left out.
///
/// # Errors
/// What the head lacks, or every line that is at fault, with its number.
pub fn parse(text: &str, source: &str) -> Result<Vec<Measured>, String> {
    let mut lines = text.lines().enumerate();
    let head: Vec<&str> = lines.next().map(|(_, line)| line.split(',').collect()).unwrap_or_default();
    let (mut rows, mut faults) = (Vec::new(), Vec::new());
    for (at, line) in lines.filter(|(_, line)| !line.is_empty()) {
        let fields: Vec<&str> = line.split(',').collect();
        let field = |name: &str| {
            let at = head.iter().position(|head| *head == name).ok_or(format!("no field {name}"))?;
            fields.get(at).copied().ok_or(format!("{name} is missing"))
        };
        match field("status")
            .and_then(|status| if status == SKIPPED { Ok(None) } else { measured(&field).map(Some) })
        {
            Ok(row) => rows.extend(row),
            Err(fault) => faults.push(format!("{source}:{}: {fault}", at + 1)),
        }
    }
    if faults.is_empty() { Ok(rows) } else { Err(faults.join("\n")) }
}

fn measured<'a>(field: &dyn Fn(&str) -> Result<&'a str, String>) -> Result<Measured, String> {
    let number = |name: &str| -> Result<f64, String> {
        let text = field(name)?;
        let value = text.parse().ok().filter(|v: &f64| v.is_finite() && *v >= 0.0);
        value.ok_or_else(|| format!("{name}: {text:?} is not a number of it"))
    };
    let (family, objective) = match field("label")?.split_once(':') {
        None => (field("label")?, Objective::Pp),
        Some((family, "TI")) => (family, Objective::Ti),
        Some((_, other)) => return Err(format!("label: objective {other:?} is not known")),
    };
    let scenario = match family {
        "random_general" => "rand",
        "Klotski_blocks_2large" => "sq",
        other => other,
    };
    let word = field("method")?.to_lowercase();
    let solver = word.parse::<SolverKind>().map_err(|_| format!("method: {word:?} is not one of ours"))?;
    let cost = if objective == Objective::Ti { "ti_cost" } else { "actions" };
    let solved = field("status")? == "ok";
    let objects = field("n")?.parse().map_err(|_| "n is not a number of objects".to_string())?;
    Ok(Measured {
        cell: Cell { scenario: scenario.to_string(), density: number("density")?, objects, objective },
        id: field("instance")?.to_string(),
        solver,
        cost: if solved { Some(number(cost)?) } else { None },
        seconds: number("wall_s")?,
    })
}

impl Measured {
    fn key(&self, seed: u64) -> Key {
        Key {
            scenario: self.cell.scenario.clone(),
            density: density_word(self.cell.density),
            objects: self.cell.objects,
            id: self.id.clone(),
            solver: self.solver,
            objective: self.cell.objective,
            seed,
        }
    }
}

/// The cells of these rows, each once.
pub fn cells(measured: &[Measured]) -> Vec<Cell> {
    let mut cells: Vec<Cell> = Vec::new();
    for row in measured {
        if !cells.contains(&row.cell) {
            cells.push(row.cell.clone());
        }
    }
    cells
}

/// The same runs for us, with each seed.
pub fn units(measured: &[Measured], seeds: &[u64]) -> Vec<Unit> {
    let unit = |row: &Measured, seed| Unit { cell: row.cell.clone(), key: row.key(seed) };
    measured.iter().flat_map(|row| seeds.iter().map(move |&seed| unit(row, seed))).collect()
}

/// One of their rows with ours.
struct Pair<'a> {
    theirs: &'a Measured,
    ours: Vec<&'a Row>,
}

impl Pair<'_> {
    fn solved(&self) -> usize {
        self.ours.iter().filter(|row| row.cost.is_some()).count()
    }

    fn dependable(&self) -> bool {
        let (share, of) = DEPENDABLE;
        !self.ours.is_empty() && self.solved() * of >= self.ours.len() * share
    }

    /// Costs over our bound, ours (mean over the seeds) and theirs, when both have one.
    fn over_bound(&self) -> Option<(f64, f64)> {
        let bound = self.ours.first()?.lower_bound;
        let ours = mean(self.ours.iter().filter_map(|row| row.cost))?;
        let theirs = self.theirs.cost?;
        (bound > 0.0).then_some((ours / bound, theirs / bound))
    }

    /// Their time over ours (median over the seeds), where theirs says anything.
    fn sooner(&self) -> Option<f64> {
        let worth_it = self.theirs.cost.is_some() && self.theirs.seconds > LEAST_SECONDS;
        let ours = median(self.ours.iter().filter_map(|row| row.first_plan_seconds).collect())?;
        (worth_it && ours > 0.0).then_some(self.theirs.seconds / ours)
    }
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0_usize), |(sum, count), value| (sum + value, count + 1));
    (count > 0).then(|| sum / count as f64)
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

const HEAD: [&str; 9] =
    ["scenario", "density", "n", "solver", "objective", "solved", "theirs", "cost/bound", "theirs"];

/// The comparison; rows that were not run are left out.
pub fn report(measured: &[Measured], rows: &[Row]) -> String {
    let pairs: Vec<Pair> = measured
        .iter()
        .map(|theirs| {
            let same = |row: &&Row| row.key == theirs.key(row.key.seed);
            Pair { theirs, ours: rows.iter().filter(same).collect() }
        })
        .filter(|pair| !pair.ours.is_empty())
        .collect();
    let mut cells: BTreeMap<_, Vec<&Pair>> = BTreeMap::new();
    for pair in &pairs {
        let Measured { cell, solver, .. } = pair.theirs;
        let name = CellName {
            scenario: &cell.scenario,
            density: density_word(cell.density),
            objects: cell.objects,
            objective: cell.objective.as_str(),
        };
        cells.entry((solver.as_str(), name)).or_default().push(pair);
    }
    let lines: Vec<Vec<String>> =
        cells.iter().map(|((solver, name), pairs)| line(solver, name, pairs)).collect();
    let all: Vec<&Pair> = pairs.iter().collect();
    format!("{}\n\n{}{}", columns(&HEAD, &lines), totals(&all), worse(&cells))
}

/// A cell in the words of the report, which is sorted by them.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
struct CellName<'a> {
    /// Name of the scenario.
    scenario: &'a str,
    /// Density, as in the table of results.
    density: String,
    /// Number of objects.
    objects: usize,
    /// Word of the objective.
    objective: &'static str,
}

fn line(solver: &str, name: &CellName, pairs: &[&Pair]) -> Vec<String> {
    let (ours, theirs) = over_bound(pairs).unzip();
    let ratio = |value: Option<f64>| value.map_or("-".to_string(), |value| format!("{value:.3}"));
    vec![
        name.scenario.to_string(),
        name.density.clone(),
        name.objects.to_string(),
        solver.to_string(),
        name.objective.to_string(),
        format!("{}/{}", pairs.iter().filter(|pair| pair.dependable()).count(), pairs.len()),
        format!("{}/{}", pairs.iter().filter(|pair| pair.theirs.cost.is_some()).count(), pairs.len()),
        ratio(ours),
        ratio(theirs),
    ]
}

/// Means over the rows that both solved.
fn over_bound(pairs: &[&Pair]) -> Option<(f64, f64)> {
    let both: Vec<(f64, f64)> = pairs.iter().filter_map(|pair| pair.over_bound()).collect();
    Some((mean(both.iter().map(|both| both.0))?, mean(both.iter().map(|both| both.1))?))
}

fn totals(pairs: &[&Pair]) -> String {
    let (share, of) = DEPENDABLE;
    let solved: Vec<&&Pair> = pairs.iter().filter(|pair| pair.theirs.cost.is_some()).collect();
    let lost: Vec<String> =
        solved.iter().filter(|pair| !pair.dependable()).map(|pair| missed(pair)).collect();
    let gained = pairs.iter().filter(|pair| pair.theirs.cost.is_none() && pair.dependable()).count();
    let mut text = format!(
        "rows: {}; theirs solved {}, of which ours in at least {share} of {of} seeds {}; ours solved \
         {gained} of \
         the {} that theirs did not\n",
        pairs.len(),
        solved.len(),
        solved.len() - lost.len(),
        pairs.len() - solved.len()
    );
    text.extend(lost);
    if let Some((ours, theirs)) = over_bound(pairs) {
        text += &format!("mean cost over bound, rows solved by both: ours {ours:.4}, theirs {theirs:.4}\n");
    }
    let sooner: Vec<f64> = pairs.iter().filter_map(|pair| pair.sooner()).collect();
    let count = sooner.len();
    if let Some(times) = median(sooner) {
        text += &format!(
            "their time over ours, median of {count} rows with theirs over {LEAST_SECONDS} s: {times:.0}\n"
        );
    }
    text
}

fn missed(pair: &Pair) -> String {
    let Measured { cell, id, solver, .. } = pair.theirs;
    format!(
        "  not dependable: {} {} n {} {id} {solver}: {} of {} seeds\n",
        cell.scenario,
        cell.density,
        cell.objects,
        pair.solved(),
        pair.ours.len()
    )
}

fn worse(cells: &BTreeMap<(&str, CellName), Vec<&Pair>>) -> String {
    let mut text = format!("cells where ours costs over {:.0} % more:", WORSE * 100.0);
    let before = text.len();
    for ((solver, CellName { scenario, density, objects, objective }), pairs) in cells {
        let Some((ours, theirs)) = over_bound(pairs) else { continue };
        if ours > theirs * (1.0 + WORSE) {
            let more = (ours / theirs - 1.0) * 100.0;
            text += &format!("\n  {scenario} {density} n {objects} {solver} {objective}: {more:.1} % more");
        }
    }
    if text.len() == before {
        text += " none";
    }
    text + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;
    use rearrange::planning::plan::Status;

    const HEAD_LINE: &str =
        "set,label,density,n,instance,method,cap_s,status,actions,ratio,ti_cost,wall_s,lb_pp";

    fn table(lines: &[&str]) -> Result<Vec<Measured>, String> {
        parse(&format!("{HEAD_LINE}\n{}\n", lines.join("\n")), "x.csv")
    }

    fn ours(theirs: &Measured, seed: u64, cost: Option<f64>) -> Row {
        Row {
            key: theirs.key(seed),
            status: if cost.is_some() { Status::Solved } else { Status::Timeout },
            moves: cost.map(|_| 1),
            cost,
            lower_bound: 20.0,
            first_plan_seconds: cost.map(|_| 0.01),
            seconds: 0.02,
        }
    }

    #[test]
    fn their_words_become_ours() {
        let rows = table(&[
            "disk,disk,0.2,10,1-3,RBM,100,ok,11,1.1,11.0,0.001,11",
            "hete,Klotski_blocks_2large:TI,0.3,20,0,ERBM,50,ok,24,1.2,48.27,0.554,23",
            "disk,disk,0.5,60,1-3,TBM,60,skipped,,,,,67",
            "hete,random_general,0.4,30,1,ERBM,53,timeout,,,,52.6,34",
        ])
        .unwrap();
        let keys: Vec<Key> = rows.iter().map(|row| row.key(3)).collect();
        assert_eq!((keys[0].scenario.as_str(), keys[0].id.as_str(), keys[0].objects), ("disk", "1-3", 10));
        assert_eq!((keys[1].scenario.as_str(), keys[1].objective), ("sq", Objective::Ti));
        assert_eq!(rows.iter().map(|row| row.cost).collect::<Vec<_>>(), [Some(11.0), Some(48.27), None]);
        assert_eq!(units(&rows, &[1, 2]).len(), 6);
    }

    #[test]
    fn every_line_at_fault_is_reported() {
        let fault =
            table(&["disk,disk,0.2,x,1-3,RBM,100,ok,11", "disk,disk,0.2,5,1-3,SOLVE,100,ok,11"]).unwrap_err();
        assert!(fault.contains("x.csv:2: n is not") && fault.contains("x.csv:3: method"), "{fault}");
        assert!(parse("a,b\n1,2\n", "x.csv").unwrap_err().contains("no field status"));
    }

    #[test]
    fn undependable_rows_and_dear_cells_are_named() {
        let rows = table(&["hete,random_general,0.4,20,0,RBM,90,ok,24,1.2,0,2.0,22"]).unwrap();
        let good: Vec<Row> = (0..10).map(|seed| ours(&rows[0], seed, (seed > 0).then_some(24.0))).collect();
        let text = report(&rows, &good);
        assert!(text.contains("9 of 10 seeds 1;") && text.contains("more: none"), "{text}");
        assert!(text.contains("ours 1.2000, theirs 1.2000") && text.contains("0.1 s: 200"), "{text}");
        let bad: Vec<Row> = (0..10).map(|seed| ours(&rows[0], seed, (seed > 1).then_some(30.0))).collect();
        let text = report(&rows, &bad);
        assert!(text.contains("rand 0.4 n 20 0 rbm: 8 of 10 seeds"), "{text}");
        assert!(text.contains("rand 0.40 n 20 rbm pp: 25.0 % more"), "{text}");
    }
}
