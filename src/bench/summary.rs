//! The planning benchmark as a table for people.
//!
//! In: rows. Out: one line a cell (scenario, density, number of objects, solver, objective): how many were
//! solved, mean moves and cost, mean cost over mean bound of those that were solved, mean, median and worst
//! time to the first plan.

use crate::bench::table::Row;
use crate::report::text::columns;
use std::collections::BTreeMap;

const HEAD: [&str; 13] = [
    "scenario",
    "density",
    "n",
    "solver",
    "objective",
    "solved",
    "moves",
    "cost",
    "bound",
    "gap",
    "mean s",
    "median s",
    "max s",
];

/// The table, cells in order.
pub fn summary(rows: &[Row]) -> String {
    let mut cells: BTreeMap<_, Vec<&Row>> = BTreeMap::new();
    for row in rows {
        let key = &row.key;
        let cell = (&key.scenario, &key.density, key.objects, key.objective.as_str(), key.solver.as_str());
        cells.entry(cell).or_default().push(row);
    }
    let lines: Vec<Vec<String>> = cells
        .into_iter()
        .map(|((scenario, density, objects, objective, solver), rows)| {
            let names = [scenario, density, &objects.to_string(), solver, objective].map(ToString::to_string);
            names.into_iter().chain(figures(&rows)).collect()
        })
        .collect();
    format!("{}\n", columns(&HEAD, &lines))
}

fn figures(rows: &[&Row]) -> [String; 8] {
    let solved: Vec<&Row> = rows.iter().copied().filter(|row| row.cost.is_some()).collect();
    let share = format!("{}/{}", solved.len(), rows.len());
    let mut times: Vec<f64> = solved.iter().filter_map(|row| row.first_plan_seconds).collect();
    times.sort_by(f64::total_cmp);
    let time = |at: usize| times.get(at).map_or("-".to_string(), |seconds| format!("{seconds:.4}"));
    let mean =
        |value: &dyn Fn(&Row) -> f64| solved.iter().map(|row| value(row)).sum::<f64>() / solved.len() as f64;
    if solved.is_empty() {
        return std::array::from_fn(|at| if at == 0 { share.clone() } else { "-".to_string() });
    }
    let (cost, bound) = (mean(&|row| row.cost.unwrap_or(0.0)), mean(&|row| row.lower_bound));
    let seconds = mean(&|row| row.first_plan_seconds.unwrap_or(row.seconds));
    let moves = mean(&|row| row.moves.unwrap_or(0) as f64);
    // No cost is below its bound: what is, is the rounding of sums.
    let gap = if bound > 0.0 { ((cost / bound - 1.0) * 100.0).max(0.0) } else { 0.0 };
    [
        share,
        format!("{moves:.2}"),
        format!("{cost:.2}"),
        format!("{bound:.2}"),
        format!("{gap:.1}%"),
        format!("{seconds:.4}"),
        time(times.len() / 2),
        time(times.len().saturating_sub(1)),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::table::tests::row;

    #[test]
    fn the_gap_counts_solved_cases_only() {
        let text = summary(&[row("1", Some(22.0)), row("2", Some(26.0)), row("3", None)]);
        assert!(text.contains("2/3") && text.contains("20.0%"), "{text}");
    }

    #[test]
    fn a_cell_without_a_plan_has_no_figures() {
        let text = summary(&[row("1", None)]);
        assert!(text.contains("0/1") && !text.contains("NaN") && !text.contains("%"), "{text}");
    }
}
