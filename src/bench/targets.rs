//! What `auto` is meant to reach on the public instances, and a table of what was reached.
//!
//! In: rows of the planning benchmark. Out: the cells of every target; a line for each target and solver:
//! cases solved, time to the first plan that 95 of 100 stay below, share of plans at the bound, cost over
//! bound, and whether that is what was aimed at.

use crate::bench::cells::Cell;
use crate::bench::table::{Row, density_word};
use crate::report::text::{columns, seconds};
use rearrange::planning::plan::{Objective, Status};
use std::collections::BTreeMap;

/// How good the plans are to be at the end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Quality {
    /// Share of the cases that cost no more than the bound.
    AtBound(f64),
    /// Mean cost over mean bound of the cases solved.
    OverBound(f64),
    /// Reported, without an aim.
    Reported,
}

/// One line of the table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    /// Family of instances.
    pub scenario: &'static str,
    /// Densities.
    pub densities: &'static [f64],
    /// Numbers of objects.
    pub objects: &'static [usize],
    /// What is minimised.
    pub objective: Objective,
    /// Share of cases solved.
    pub solved: f64,
    /// Seconds to the first plan that 95 of 100 cases stay below.
    pub first_plan: Option<f64>,
    /// Of the plans at the end.
    pub quality: Quality,
    /// Seconds for a case.
    pub limit: f64,
}

const ALL: &[usize] = &[20, 30, 40, 50, 60];
const MORE: &[usize] = &[30, 40, 50, 60];

const fn target(
    scenario: &'static str,
    densities: &'static [f64],
    objects: &'static [usize],
    first_plan: f64,
    quality: Quality,
) -> Target {
    let (objective, first_plan) = (Objective::Pp, Some(first_plan));
    Target { scenario, densities, objects, objective, solved: 1.0, first_plan, quality, limit: 10.0 }
}

const fn long(
    scenario: &'static str,
    densities: &'static [f64],
    objects: &'static [usize],
    solved: f64,
) -> Target {
    let (objective, quality) = (Objective::Pp, Quality::Reported);
    Target { scenario, densities, objects, objective, solved, first_plan: None, quality, limit: 60.0 }
}

const fn ti(scenario: &'static str, densities: &'static [f64], quality: Quality) -> Target {
    let (objective, objects) = (Objective::Ti, ALL);
    Target { scenario, densities, objects, objective, solved: 1.0, first_plan: None, quality, limit: 10.0 }
}

/// The targets, least crowded tables first.
pub const TARGETS: [Target; 17] = [
    target("rand", &[0.2, 0.3], ALL, 0.02, Quality::AtBound(0.98)),
    target("sq", &[0.2], ALL, 0.02, Quality::AtBound(0.9)),
    target("sq", &[0.3], ALL, 0.2, Quality::OverBound(1.03)),
    target("rand", &[0.4], &[20], 0.05, Quality::OverBound(1.015)),
    target("rand", &[0.4], MORE, 0.05, Quality::OverBound(1.003)),
    target("sq", &[0.4], ALL, 1.0, Quality::OverBound(1.05)),
    target("rand", &[0.5], &[20], 0.5, Quality::OverBound(1.05)),
    target("rand", &[0.5], MORE, 0.5, Quality::OverBound(1.03)),
    long("rand", &[0.6], &[20, 40], 0.7),
    long("disk", &[0.5], &[10, 20, 40, 60], 1.0),
    long("disk", &[0.6], &[10, 20, 40, 60], 0.9),
    long("stick", &[0.4], &[10, 20, 30, 40], 1.0),
    ti("rand", &[0.2], Quality::AtBound(0.98)),
    ti("sq", &[0.2], Quality::AtBound(0.9)),
    ti("rand", &[0.3, 0.4], Quality::OverBound(1.01)),
    ti("sq", &[0.3], Quality::OverBound(1.01)),
    ti("sq", &[0.4], Quality::OverBound(1.06)),
];

impl Target {
    /// The cells that the target is about.
    pub fn cells(&self) -> Vec<Cell> {
        let cell = |density, objects| Cell::new(self.scenario, density, objects, self.objective);
        let densities = self.densities.iter();
        densities.flat_map(|&density| self.objects.iter().map(move |&n| cell(density, n))).collect()
    }

    fn has(&self, row: &Row) -> bool {
        let key = &row.key;
        key.scenario == self.scenario
            && key.objective == self.objective
            && self.objects.contains(&key.objects)
            && self.densities.iter().any(|&density| density_word(density) == key.density)
    }

    fn name(&self) -> String {
        let densities: Vec<String> = self.densities.iter().map(f64::to_string).collect();
        let (least, most) = (self.objects.first().unwrap_or(&0), self.objects.last().unwrap_or(&0));
        let objects = if least == most { format!("{least}") } else { format!("{least}-{most}") };
        format!("{} {} {} n {objects}", self.scenario, self.objective, densities.join(","))
    }
}

/// Some cells of the targets: scenario, objective, density and number of objects, from the left as far as
/// given.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Selection {
    words: Vec<String>,
}

impl Selection {
    /// Reads `rand`, `rand/pp`, `rand/pp/0.6` or `rand/pp/0.6/20`.
    ///
    /// # Errors
    /// What the text has to be; it must name a cell that there is.
    pub fn parse(text: &str) -> Result<Selection, String> {
        let selection = Selection { words: text.split('/').map(str::to_string).collect() };
        let named = TARGETS.iter().flat_map(Target::cells).any(|cell| selection.takes(&cell));
        named.then_some(selection).ok_or_else(|| {
            "names no cell of the targets: SCENARIO/OBJECTIVE/DENSITY/N, such as rand/pp/0.6/20 or sq/ti"
                .into()
        })
    }

    /// Is the cell one of these?
    pub fn takes(&self, cell: &Cell) -> bool {
        let Cell { scenario, density, objects, objective } = cell;
        let cell = [scenario.clone(), objective.to_string(), density.to_string(), objects.to_string()];
        self.words.len() <= cell.len() && self.words.iter().zip(&cell).all(|(word, of_cell)| word == of_cell)
    }
}

/// Seconds for a case of the cell.
pub fn limit(cell: &Cell) -> f64 {
    TARGETS.iter().find(|target| target.cells().contains(cell)).map_or(f64::INFINITY, |target| target.limit)
}

const HEAD: [&str; 9] =
    ["target", "solver", "solved", "aim", "first plan p95", "aim", "at bound", "cost/bound", "met"];

/// The table: a line for each target and solver that there are rows of.
pub fn report(rows: &[Row]) -> String {
    let mut lines = Vec::new();
    for target in &TARGETS {
        let mut by_solver: BTreeMap<&str, Vec<&Row>> = BTreeMap::new();
        for row in rows.iter().filter(|row| target.has(row)) {
            by_solver.entry(row.key.solver.as_str()).or_default().push(row);
        }
        lines.extend(by_solver.into_iter().map(|(solver, rows)| line(target, solver, &rows)));
    }
    format!("{}\n", columns(&HEAD, &lines))
}

fn line(target: &Target, solver: &str, rows: &[&Row]) -> Vec<String> {
    let solved: Vec<&Row> = rows.iter().copied().filter(|row| row.cost.is_some()).collect();
    let share = |part: usize| part as f64 / rows.len() as f64;
    let first = percentile_95(rows);
    let at_bound = share(solved.iter().filter(|row| row.status == Status::Optimal).count());
    let sum = |value: &dyn Fn(&Row) -> f64| solved.iter().map(|row| value(row)).sum::<f64>();
    let over = sum(&|row| row.cost.unwrap_or(0.0)) / sum(&|row| row.lower_bound);
    let good = match target.quality {
        Quality::AtBound(least) => at_bound >= least,
        Quality::OverBound(most) => over <= most + 1e-9,
        Quality::Reported => true,
    };
    let in_time = target.first_plan.is_none_or(|most| first <= most);
    let met = share(solved.len()) >= target.solved && in_time && good;
    let aim = |wanted: Quality| match wanted {
        Quality::AtBound(least) => (format!(" (aim {:.0} %)", 100.0 * least), String::new()),
        Quality::OverBound(most) => (String::new(), format!(" (aim {most})")),
        Quality::Reported => (String::new(), String::new()),
    };
    let (aim_at_bound, aim_over) = aim(target.quality);
    let time = |value: f64| if value.is_finite() { seconds(value) } else { "-".to_string() };
    let ratio = if solved.is_empty() { "-".to_string() } else { format!("{over:.4}") };
    vec![
        target.name(),
        solver.to_string(),
        format!("{}/{}", solved.len(), rows.len()),
        format!("{:.0} %", 100.0 * target.solved),
        time(first),
        target.first_plan.map_or("-".to_string(), time),
        format!("{:.0} %{aim_at_bound}", 100.0 * at_bound),
        format!("{ratio}{aim_over}"),
        if met { "yes" } else { "no" }.to_string(),
    ]
}

/// Time to the first plan that 95 of 100 cases stay below; infinite if more than that have none.
fn percentile_95(rows: &[&Row]) -> f64 {
    let time = |row: &&Row| row.first_plan_seconds.unwrap_or(f64::INFINITY);
    let mut times: Vec<f64> = rows.iter().map(time).collect();
    times.sort_by(f64::total_cmp);
    let at = (0.95 * times.len() as f64).ceil() as usize;
    times.get(at.saturating_sub(1)).copied().unwrap_or(f64::INFINITY)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::table::tests::row;

    #[test]
    fn a_target_is_met_by_all_of_its_figures() {
        // RAND 0.4 n=20: 1.015 times the bound, first plan within 50 ms.
        let good = |id: &str, first: f64| {
            let cost = if id == "1" { 21.0 } else { 20.0 };
            let mut row = row(id, Some(cost));
            row.first_plan_seconds = Some(first);
            row
        };
        let met = |rows: &[Row]| report(rows).lines().any(|line| line.ends_with("yes"));
        let all: Vec<Row> = (0..20).map(|id| good(&id.to_string(), 0.01)).collect();
        assert!(met(&all), "{}", report(&all));
        assert!(!met(&all[..2]), "1.025 times the bound");
        let late: Vec<Row> =
            (0..20).map(|id| good(&id.to_string(), if id < 2 { 0.2 } else { 0.01 })).collect();
        assert!(!met(&late), "two of twenty are late");
        let failed: Vec<Row> = all.into_iter().chain([row("20", None)]).collect();
        assert!(!met(&failed), "one without a plan");
    }

    #[test]
    fn a_selection_takes_what_begins_like_it() {
        let all: Vec<Cell> = TARGETS.iter().flat_map(Target::cells).collect();
        let count = |text: &str| {
            let selection = Selection::parse(text).unwrap();
            all.iter().filter(|cell| selection.takes(cell)).count()
        };
        assert_eq!(
            [count("rand/pp/0.6/20"), count("rand/pp/0.6"), count("disk"), count("sq/ti")],
            [1, 2, 8, 15]
        );
        for text in ["", "rand/pp/0.7", "ran", "rand/pp/0.6/20/1", "rand//0.6"] {
            assert!(Selection::parse(text).is_err(), "{text}");
        }
    }

    #[test]
    fn no_cell_belongs_to_two_targets() {
        let cells: Vec<Cell> = TARGETS.iter().flat_map(Target::cells).collect();
        for (at, cell) in cells.iter().enumerate() {
            assert!(!cells[..at].contains(cell), "{cell:?}");
            assert!(limit(cell) >= 10.0);
        }
    }
}
