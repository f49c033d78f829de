//! Rows of the planning benchmark and their CSV: what runs write, resume from, merge and draw.
//!
//! In: rows, or CSV text (one file, or several one after the other: a repeated head is skipped). Out: CSV
//! text, or rows, or every line that is none, with its number. No field holds a comma, so nothing is quoted.

use rearrange::planning::plan::{Objective, Status};
use rearrange::planning::solver::SolverKind;
use std::collections::HashSet;

/// Head of the CSV table.
pub const CSV_HEADER: &str =
    "scenario,density,n,id,solver,objective,seed,status,moves,cost,lower_bound,first_plan_seconds,seconds";

const FIELDS: usize = 13;

/// What is run: no two rows of a table share it.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Key {
    /// Family of instances, `rand` or `sq` for the paper's.
    pub scenario: String,
    /// Nominal density of the cell, with two digits where that is exact.
    pub density: String,
    /// Number of objects.
    pub objects: usize,
    /// Name of the case in its cell.
    pub id: String,
    /// Solver.
    pub solver: SolverKind,
    /// Objective.
    pub objective: Objective,
    /// Seed of the solver.
    pub seed: u64,
}

/// The result of one case.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// What was run.
    pub key: Key,
    /// How it ended.
    pub status: Status,
    /// Moves of the plan.
    pub moves: Option<usize>,
    /// Cost of the plan.
    pub cost: Option<f64>,
    /// Lower bound on the cost.
    pub lower_bound: f64,
    /// Seconds to the first plan, wall time.
    pub first_plan_seconds: Option<f64>,
    /// Seconds in all, wall time.
    pub seconds: f64,
}

/// A density as the tables name it: two digits where that is exact.
pub fn density_word(density: f64) -> String {
    let short = format!("{density:.2}");
    if short.parse() == Ok(density) { short } else { format!("{density}") }
}

impl Row {
    /// The row as CSV, in the order of [`CSV_HEADER`]; absent values are empty.
    pub fn csv(&self) -> String {
        let number = |value: Option<f64>| value.map_or(String::new(), |value| format!("{value:.6}"));
        let Key { scenario, density, objects, id, solver, objective, seed } = &self.key;
        format!(
            "{scenario},{density},{objects},{id},{solver},{objective},{seed},{},{},{},{:.6},{},{:.6}",
            status_word(self.status),
            self.moves.map_or(String::new(), |moves| moves.to_string()),
            number(self.cost),
            self.lower_bound,
            number(self.first_plan_seconds),
            self.seconds
        )
    }

    /// Reads a row back.
    ///
    /// # Errors
    /// Which field is at fault, and why.
    pub fn parse(line: &str) -> Result<Row, String> {
        let fields: Vec<&str> = line.split(',').collect();
        if fields.len() != FIELDS {
            return Err(format!("{} fields, {FIELDS} are needed", fields.len()));
        }
        let name = |at: usize| CSV_HEADER.split(',').nth(at).unwrap_or_default();
        let bad = |at: usize| format!("{}: {:?} is not one", name(at), fields[at]);
        let number = |at: usize| match fields[at].parse::<f64>() {
            Ok(value) if value.is_finite() && value >= 0.0 => Ok(value),
            _ => Err(bad(at)),
        };
        let optional = |at: usize| if fields[at].is_empty() { Ok(None) } else { number(at).map(Some) };
        let density = density_word(number(1)?);
        let moves = if fields[8].is_empty() { None } else { Some(fields[8].parse().map_err(|_| bad(8))?) };
        Ok(Row {
            key: Key {
                scenario: fields[0].to_string(),
                density,
                objects: fields[2].parse().map_err(|_| bad(2))?,
                id: fields[3].to_string(),
                solver: fields[4].parse().map_err(|_| bad(4))?,
                objective: fields[5].parse().map_err(|_| bad(5))?,
                seed: fields[6].parse().map_err(|_| bad(6))?,
            },
            status: status(fields[7]).ok_or_else(|| bad(7))?,
            moves,
            cost: optional(9)?,
            lower_bound: number(10)?,
            first_plan_seconds: optional(11)?,
            seconds: number(12)?,
        })
    }
}

/// Rows of a table, each key once.
#[derive(Clone, Debug, Default)]
pub struct Table {
    /// In the order of their first appearance.
    pub rows: Vec<Row>,
    /// Rows left out because their key had come before.
    pub repeated: usize,
    keys: HashSet<Key>,
}

impl Table {
    /// Adds what is new in the CSV text named `source`; empty lines and heads are skipped.
    ///
    /// # Errors
    /// Every line that is no row, with its number.
    pub fn read(&mut self, text: &str, source: &str) -> Result<(), String> {
        let mut faults = Vec::new();
        for (number, line) in text.lines().enumerate().map(|(at, line)| (at + 1, line.trim_end_matches('\r')))
        {
            if number == 1 && line != CSV_HEADER {
                return Err(format!("{source}:1: not a table of this benchmark; its head is {CSV_HEADER}"));
            }
            if line.is_empty() || line == CSV_HEADER {
                continue;
            }
            match Row::parse(line) {
                Ok(row) => self.add(row),
                Err(fault) => faults.push(format!("{source}:{number}: {fault}; remove the line")),
            }
        }
        if faults.is_empty() { Ok(()) } else { Err(faults.join("\n")) }
    }

    /// Adds a row unless its key is there.
    pub fn add(&mut self, row: Row) {
        if self.keys.insert(row.key.clone()) {
            self.rows.push(row);
        } else {
            self.repeated += 1;
        }
    }

    /// Is there a row of that key?
    pub fn has(&self, key: &Key) -> bool {
        self.keys.contains(key)
    }
}

fn status_word(status: Status) -> &'static str {
    match status {
        Status::Optimal => "optimal",
        Status::Solved => "solved",
        Status::Infeasible => "infeasible",
        Status::Timeout => "timeout",
    }
}

fn status(word: &str) -> Option<Status> {
    [Status::Optimal, Status::Solved, Status::Infeasible, Status::Timeout]
        .into_iter()
        .find(|status| status_word(*status) == word)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A row of RAND 0.40 n=20, solved if it has a cost.
    pub(crate) fn row(id: &str, cost: Option<f64>) -> Row {
        Row {
            key: Key {
                scenario: "rand".into(),
                density: "0.40".into(),
                objects: 20,
                id: id.into(),
                solver: SolverKind::Erbm,
                objective: Objective::Pp,
                seed: 7,
            },
            status: if cost.is_some() { Status::Solved } else { Status::Timeout },
            moves: cost.map(|cost| cost as usize),
            cost,
            lower_bound: 20.0,
            first_plan_seconds: cost.map(|_| 0.5),
            seconds: 1.0,
        }
    }

    #[test]
    fn a_row_has_as_many_fields_as_the_head_and_reads_back() {
        assert_eq!(CSV_HEADER.split(',').count(), FIELDS);
        for row in [row("1", Some(24.0)), row("2", None)] {
            assert_eq!(row.csv().split(',').count(), FIELDS);
            assert_eq!(Row::parse(&row.csv()), Ok(row));
        }
        assert!(row("2", None).csv().contains(",timeout,,,20.000000,,"));
    }

    #[test]
    fn every_bad_field_is_named() {
        let good = row("1", Some(24.0)).csv();
        let without = |at: usize| {
            let mut fields: Vec<&str> = good.split(',').collect();
            fields[at] = "?";
            Row::parse(&fields.join(",")).unwrap_err()
        };
        for (at, name) in CSV_HEADER.split(',').enumerate().filter(|(at, _)| ![0, 3].contains(at)) {
            assert!(without(at).starts_with(name), "{}", without(at));
        }
        assert!(Row::parse("1,2").unwrap_err().contains("2 fields"));
    }

    #[test]
    fn shards_merge_by_concatenation_and_repeated_keys_count_once() {
        let (a, b) = (row("1", Some(24.0)).csv(), row("2", None).csv());
        let again = row("1", Some(30.0)).csv();
        let mut table = Table::default();
        table.read(&format!("{CSV_HEADER}\n{a}\n{CSV_HEADER}\n{b}\n{again}\n"), "x.csv").unwrap();
        assert_eq!((table.rows.len(), table.repeated), (2, 1));
        assert_eq!(table.rows[0].cost, Some(24.0));
        assert!(table.has(&row("2", None).key) && !table.has(&row("3", None).key));
    }

    #[test]
    fn faults_are_reported_with_their_lines() {
        let read = |text: &str| Table::default().read(text, "x.csv").unwrap_err();
        assert!(read("a,b\n").starts_with("x.csv:1: not a table"));
        let fault = read(&format!("{CSV_HEADER}\n{}\nrand,0.40\n", row("1", None).csv()));
        assert!(fault.starts_with("x.csv:3: 2 fields"), "{fault}");
    }

    #[test]
    fn densities_keep_their_digits() {
        assert_eq!(density_word(0.4), "0.40");
        assert_eq!(density_word(0.405), "0.405");
    }
}
