//! Planning benchmark: runs a solver on cases and tells how well and how fast, as CSV rows and a summary.
//!
//! In: problems with a label, a solver, limits. Out: one [`Row`] a case, CSV text, and a table by cell (scenario,
//! density, number of objects). Every plan counted has passed the independent checker inside `solve`. The clock is
//! read here: seconds are wall time of this process.

use crate::planning::check::CheckedPlan;
use crate::planning::plan::{Action, Objective, Status};
use crate::planning::problem::Problem;
use crate::planning::solver::{Control, SolveError, SolverKind, solve};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::sync::Mutex;
use std::time::Instant;

/// Where a case belongs.
#[derive(Clone, Debug, PartialEq)]
pub struct Label {
    /// Family of instances, `rand` or `sq` for the paper's.
    pub scenario: String,
    /// Nominal density of the cell, as in the file's path.
    pub density: String,
    /// Number of the case in its cell, or a pair of arrangements.
    pub id: String,
}

/// What is run on every case.
#[derive(Clone, Copy, Debug)]
pub struct Run {
    /// Solver.
    pub solver: SolverKind,
    /// Objective.
    pub objective: Objective,
    /// Seed.
    pub seed: u64,
    /// Seconds for one case.
    pub limit_seconds: f64,
    /// Deterministic steps for one case.
    pub work_limit: Option<u64>,
}

/// The result of one case.
#[derive(Clone, Debug)]
pub struct Row {
    /// Which case.
    pub label: Label,
    /// Number of objects.
    pub objects: usize,
    /// What was run.
    pub run: Run,
    /// How it ended.
    pub status: Status,
    /// Moves of the plan.
    pub moves: Option<usize>,
    /// Cost of the plan.
    pub cost: Option<f64>,
    /// Lower bound on the cost.
    pub lower_bound: f64,
    /// Seconds to the first plan.
    pub first_plan_seconds: Option<f64>,
    /// Seconds in all.
    pub seconds: f64,
}

/// Head of the CSV table.
pub const CSV_HEADER: &str =
    "scenario,density,n,id,solver,objective,seed,status,moves,cost,lower_bound,first_plan_seconds,seconds";

/// Runs one case.
///
/// # Errors
/// What makes the run impossible.
pub fn run_case(
    problem: &Problem,
    label: Label,
    run: Run,
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<Row, SolveError> {
    let begun = Instant::now();
    let first_plan = Mutex::new(None);
    let over = || stop() || begun.elapsed().as_secs_f64() >= run.limit_seconds;
    let on_plan = |_: &[Action], _: f64| {
        if let Ok(mut first) = first_plan.lock() {
            first.get_or_insert(begun.elapsed().as_secs_f64());
        }
    };
    let control =
        Control { work_limit: run.work_limit, on_plan: &on_plan, first: true, ..Control::until(&over) };
    let outcome = solve(problem, run.solver, run.objective, &control, run.seed)?;
    Ok(Row {
        label,
        objects: problem.objects.len(),
        run,
        status: outcome.status,
        moves: outcome.plan.as_ref().map(CheckedPlan::actions).map(<[Action]>::len),
        cost: outcome.cost,
        lower_bound: outcome.lower_bound,
        first_plan_seconds: first_plan.lock().ok().and_then(|first| *first),
        seconds: begun.elapsed().as_secs_f64(),
    })
}

impl Row {
    /// The row as CSV, in the order of [`CSV_HEADER`]; absent values are empty.
    pub fn csv(&self) -> String {
        let number = |value: Option<f64>| value.map_or(String::new(), |value| format!("{value:.6}"));
        let status = match self.status {
            Status::Optimal => "optimal",
            Status::Solved => "solved",
            Status::Infeasible => "infeasible",
            Status::Timeout => "timeout",
        };
        let Label { scenario, density, id } = &self.label;
        format!(
            "{scenario},{density},{},{id},{},{},{},{status},{},{},{:.6},{},{:.6}",
            self.objects,
            self.run.solver.word(),
            self.run.objective.word(),
            self.run.seed,
            self.moves.map_or(String::new(), |moves| moves.to_string()),
            number(self.cost),
            self.lower_bound,
            number(self.first_plan_seconds),
            self.seconds
        )
    }
}

/// A table for people, one line a cell: how many were solved, mean moves and cost, mean cost over mean bound of
/// those that were solved, median and worst time to the first plan.
pub fn summary(rows: &[Row]) -> String {
    let mut cells: BTreeMap<(&str, &str, usize, &str, &str), Vec<&Row>> = BTreeMap::new();
    for row in rows {
        let Label { scenario, density, .. } = &row.label;
        let key = (
            scenario.as_str(),
            density.as_str(),
            row.objects,
            row.run.solver.word(),
            row.run.objective.word(),
        );
        cells.entry(key).or_default().push(row);
    }
    let mut text = format!(
        "{:<22} {:>7} {:>4} {:<6} {:<4} {:>8} {:>8} {:>9} {:>9} {:>7} {:>10} {:>10}\n",
        "scenario",
        "density",
        "n",
        "solver",
        "obj",
        "solved",
        "moves",
        "cost",
        "bound",
        "gap",
        "median s",
        "max s"
    );
    for ((scenario, density, n, solver, objective), rows) in cells {
        let solved: Vec<&Row> = rows.iter().copied().filter(|row| row.cost.is_some()).collect();
        let mean = |value: &dyn Fn(&Row) -> f64| {
            solved.iter().map(|row| value(row)).sum::<f64>() / solved.len().max(1) as f64
        };
        let (cost, bound) = (mean(&|row| row.cost.unwrap_or(0.0)), mean(&|row| row.lower_bound));
        let moves = mean(&|row| row.moves.unwrap_or(0) as f64);
        let mut times: Vec<f64> = solved.iter().filter_map(|row| row.first_plan_seconds).collect();
        times.sort_by(f64::total_cmp);
        let time = |at: usize| times.get(at).map_or("-".to_string(), |seconds| format!("{seconds:.4}"));
        let _ = writeln!(
            text,
            "{scenario:<22} {density:>7} {n:>4} {solver:<6} {objective:<4} {:>8} {moves:>8.2} {cost:>9.2} {bound:>9.2} \
             {:>6.1}% {:>10} {:>10}",
            format!("{}/{}", solved.len(), rows.len()),
            if bound > 0.0 { (cost / bound - 1.0) * 100.0 } else { 0.0 },
            time(times.len() / 2),
            time(times.len().saturating_sub(1)),
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(id: &str, cost: Option<f64>) -> Row {
        let run = Run {
            solver: SolverKind::Erbm,
            objective: Objective::Pp,
            seed: 7,
            limit_seconds: 1.0,
            work_limit: None,
        };
        Row {
            label: Label { scenario: "rand".into(), density: "0.40".into(), id: id.into() },
            objects: 20,
            run,
            status: if cost.is_some() { Status::Solved } else { Status::Timeout },
            moves: cost.map(|c| c as usize),
            cost,
            lower_bound: 20.0,
            first_plan_seconds: cost.map(|_| 0.5),
            seconds: 1.0,
        }
    }

    #[test]
    fn a_row_has_as_many_fields_as_the_head() {
        let fields = |text: &str| text.split(',').count();
        assert_eq!(fields(&row("1", Some(24.0)).csv()), fields(CSV_HEADER));
        assert_eq!(fields(&row("2", None).csv()), fields(CSV_HEADER));
        assert!(row("2", None).csv().contains(",timeout,,,20.000000,,"));
    }

    #[test]
    fn the_gap_counts_solved_cases_only() {
        let text = summary(&[row("1", Some(22.0)), row("2", Some(26.0)), row("3", None)]);
        assert!(text.contains("2/3") && text.contains("20.0%"), "{text}");
    }
}
