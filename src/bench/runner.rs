//! Runs the units of a benchmark on several threads.
//!
//! In: units, a way to get a unit's problem, limits. Out: each row as it is ready, to one caller at a time.
//! The first error ends the whole run; so does `stop`, after which cases in flight leave no row.

use crate::bench::cells::Unit;
use crate::bench::planning::{Limits, run_case};
use crate::bench::table::Row;
use rearrange::planning::problem::Problem;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// The means of a run.
pub struct Runner<'a> {
    /// Makes or reads the problem of a unit.
    pub load: &'a (dyn Fn(&Unit) -> Result<Problem, String> + Sync),
    /// For a case.
    pub limits: &'a (dyn Fn(&Unit) -> Limits + Sync),
    /// Cases at the same time.
    pub threads: usize,
    /// Polled often; true ends the run.
    pub stop: &'a (dyn Fn() -> bool + Sync),
}

impl Runner<'_> {
    /// Runs all units; `on_row` gets every row, one at a time.
    ///
    /// # Errors
    /// The first thing that went wrong, with the case's key.
    pub fn run(
        &self,
        units: &[Unit],
        on_row: &mut (dyn FnMut(Row) -> Result<(), String> + Send),
    ) -> Result<(), String> {
        let next = AtomicUsize::new(0);
        let failed = AtomicBool::new(false);
        let fault = Mutex::new(None);
        let on_row = Mutex::new(on_row);
        let stop = || failed.load(Ordering::Relaxed) || (self.stop)();
        let work = || {
            while !stop() {
                let Some(unit) = units.get(next.fetch_add(1, Ordering::Relaxed)) else { return };
                let done = self.one(unit, &stop).and_then(|row| match (row, on_row.lock()) {
                    (Some(row), Ok(mut on_row)) => on_row(row),
                    _ => Ok(()),
                });
                if let Err(message) = done {
                    failed.store(true, Ordering::Relaxed);
                    if let Ok(mut first) = fault.lock() {
                        first.get_or_insert(message);
                    }
                }
            }
        };
        std::thread::scope(|scope| {
            for _ in 1..self.threads.min(units.len()) {
                scope.spawn(work);
            }
            work();
        });
        match fault.into_inner() {
            Ok(Some(message)) => Err(message),
            _ => Ok(()),
        }
    }

    fn one(&self, unit: &Unit, stop: &(dyn Fn() -> bool + Sync)) -> Result<Option<Row>, String> {
        let problem = (self.load)(unit)?;
        run_case(&problem, unit.key.clone(), (self.limits)(unit), stop).map_err(|error| {
            let key = &unit.key;
            format!("{} density {} n {} case {}: {error}", key.scenario, key.density, key.objects, key.id)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::cells::{Cell, units};
    use rearrange::planning::generate::{RatioLaw, Recipe, Scenario, generate};
    use rearrange::planning::plan::Objective;
    use rearrange::planning::solver::SolverKind;

    fn some_units() -> Vec<Unit> {
        let cell = Cell { scenario: "rand".into(), density: 0.2, objects: 5, objective: Objective::Pp };
        let ids = |_: &Cell| (0..6).map(|id| id.to_string()).collect();
        units(&[cell], &ids, &[SolverKind::Rbm, SolverKind::Erbm], &[3])
    }

    fn load(unit: &Unit) -> Result<Problem, String> {
        let Cell { objects, density, .. } = unit.cell;
        let recipe = Recipe { scenario: Scenario::Rand, objects, density, ratios: RatioLaw::Paper };
        let case = unit.key.id.parse().map_err(|_| "no such case")?;
        let generated = generate(&recipe, 1, case).map_err(|error| error.to_string())?;
        Problem::new(&generated.instance).map_err(|faults| faults.to_string())
    }

    const LIMITS: Limits =
        Limits { seconds: 600.0, work: Some(100_000), first: true, strict_paper: false, solver_threads: 1 };

    fn rows(threads: usize) -> Vec<Row> {
        let mut rows = Vec::new();
        let runner = Runner { load: &load, limits: &|_| LIMITS, threads, stop: &|| false };
        runner
            .run(&some_units(), &mut |row| {
                rows.push(row);
                Ok(())
            })
            .unwrap();
        rows.sort_by_key(|row| row.csv());
        rows
    }

    #[test]
    fn every_unit_gives_one_row_on_any_number_of_threads() {
        let plans = |rows: Vec<Row>| rows.into_iter().map(|row| (row.key, row.moves)).collect::<Vec<_>>();
        let (one, four) = (plans(rows(1)), plans(rows(4)));
        assert_eq!(one.len(), 12);
        assert!(one.iter().all(|(_, moves)| moves.is_some_and(|moves| moves >= 5)));
        assert_eq!(one, four);
    }

    #[test]
    fn the_first_error_ends_the_run_and_is_reported() {
        let runner =
            Runner { load: &|_| Err("gone".into()), limits: &|_| LIMITS, threads: 2, stop: &|| false };
        assert_eq!(runner.run(&some_units(), &mut |_| Ok(())), Err("gone".into()));
        let runner = Runner { load: &load, limits: &|_| LIMITS, threads: 2, stop: &|| false };
        let mut count = 0;
        let full = runner.run(&some_units(), &mut |_| {
            count += 1;
            Err("disk full".into())
        });
        assert_eq!(full, Err("disk full".into()));
        assert!(count <= 2, "{count}");
    }

    #[test]
    fn nothing_is_run_once_stopped() {
        let runner = Runner { load: &load, limits: &|_| LIMITS, threads: 2, stop: &|| true };
        let mut count = 0;
        runner
            .run(&some_units(), &mut |_| {
                count += 1;
                Ok(())
            })
            .unwrap();
        assert_eq!(count, 0);
    }
}
