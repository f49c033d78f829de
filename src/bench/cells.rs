//! Which cases a benchmark run consists of, and which of them are this machine's.
//!
//! In: cells (scenario, density, number of objects, objective), ids, solvers, seeds. Out: [`Unit`]s in one
//! fixed order that every machine derives alike; a [`Shard`] takes every N-th of them so that each solver's
//! and each cell's cases are spread over all machines.

use crate::bench::table::{Key, density_word};
use rearrange::planning::plan::Objective;
use rearrange::planning::solver::SolverKind;

/// One point of a figure: cases of the same kind.
#[derive(Clone, Debug, PartialEq)]
pub struct Cell {
    /// Family of instances.
    pub scenario: String,
    /// Density.
    pub density: f64,
    /// Number of objects.
    pub objects: usize,
    /// Objective.
    pub objective: Objective,
}

impl Cell {
    /// The cell of these.
    pub fn new(scenario: &str, density: f64, objects: usize, objective: Objective) -> Cell {
        Cell { scenario: scenario.to_string(), density, objects, objective }
    }
}

/// One run of one solver on one case.
#[derive(Clone, Debug, PartialEq)]
pub struct Unit {
    /// The cell it belongs to.
    pub cell: Cell,
    /// Its key in the table.
    pub key: Key,
}

/// Every combination, cell by cell and case by case; a cell named twice counts once.
pub fn units(
    cells: &[Cell],
    ids: &dyn Fn(&Cell) -> Vec<String>,
    solvers: &[SolverKind],
    seeds: &[u64],
) -> Vec<Unit> {
    let mut units = Vec::new();
    for (at, cell) in cells.iter().enumerate() {
        if cells[..at].contains(cell) {
            continue;
        }
        for id in ids(cell) {
            for (&solver, &seed) in solvers.iter().flat_map(|s| seeds.iter().map(move |seed| (s, seed))) {
                let key = Key {
                    scenario: cell.scenario.clone(),
                    density: density_word(cell.density),
                    objects: cell.objects,
                    id: id.clone(),
                    solver,
                    objective: cell.objective,
                    seed,
                };
                units.push(Unit { cell: cell.clone(), key });
            }
        }
    }
    units
}

/// Part `index` (from 1) of `count`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    index: usize,
    count: usize,
}

impl Shard {
    /// All of it.
    pub const WHOLE: Shard = Shard { index: 1, count: 1 };

    /// Reads `i/N`.
    ///
    /// # Errors
    /// What is wrong with the text.
    pub fn parse(text: &str) -> Result<Shard, String> {
        let numbers = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
        match numbers {
            Some((index, count)) if (1..=count).contains(&index) => Ok(Shard { index, count }),
            _ => Err("has to be i/N with i from 1 to N, such as 2/8".into()),
        }
    }

    /// This part of the units, when each case has `runs` runs one after the other. Consecutive cases begin
    /// one part further on: no solver ends up on one machine.
    pub fn take(self, units: Vec<Unit>, runs: usize) -> Vec<Unit> {
        let runs = runs.max(1);
        let part = |at: usize| (at / runs + at % runs) % self.count;
        units
            .into_iter()
            .enumerate()
            .filter(|(at, _)| part(*at) == self.index - 1)
            .map(|(_, unit)| unit)
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all() -> Vec<Unit> {
        let cell =
            |objects| Cell { scenario: "rand".into(), density: 0.4, objects, objective: Objective::Pp };
        let ids = |_: &Cell| (0..6).map(|id| id.to_string()).collect();
        let solvers = [SolverKind::Rbm, SolverKind::Erbm, SolverKind::Tbm];
        units(&[cell(20), cell(30), cell(20)], &ids, &solvers, &[0, 1])
    }

    #[test]
    fn a_cell_named_twice_is_run_once() {
        let all = all();
        assert_eq!(all.len(), 2 * 6 * 3 * 2);
        for (at, unit) in all.iter().enumerate() {
            assert!(!all[..at].contains(unit));
        }
    }

    #[test]
    fn shards_are_disjoint_complete_and_even() {
        for count in 1..=7 {
            let shards: Vec<Vec<Unit>> =
                (1..=count).map(|index| Shard { index, count }.take(all(), 6)).collect();
            let sizes: Vec<usize> = shards.iter().map(Vec::len).collect();
            assert!(sizes.iter().max().unwrap() - sizes.iter().min().unwrap() <= 2, "{sizes:?}");
            let mut together: Vec<Unit> = shards.into_iter().flatten().collect();
            let order = |unit: &Unit| all().iter().position(|other| other == unit).unwrap();
            together.sort_by_key(order);
            assert_eq!(together, all());
        }
    }

    #[test]
    fn every_machine_gets_some_of_every_solver() {
        for index in 1..=3 {
            let mine = Shard { index, count: 3 }.take(all(), 6);
            for solver in [SolverKind::Rbm, SolverKind::Erbm, SolverKind::Tbm] {
                assert_eq!(mine.iter().filter(|unit| unit.key.solver == solver).count(), 8);
            }
        }
    }

    #[test]
    fn a_shard_is_read_strictly() {
        assert_eq!(Shard::parse("2/8"), Ok(Shard { index: 2, count: 8 }));
        for text in ["0/4", "5/4", "1", "a/b", "1/0", "-1/4", ""] {
            assert!(Shard::parse(text).is_err(), "{text}");
        }
    }
}
