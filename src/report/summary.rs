//! The end of a run in the terminal: one line of verdict, the figures, the objects.
//!
//! In: a [`RunReport`]. Out: text for a terminal of 80 columns, without colours. Pure.

use crate::report::run::{Figures, ObjectRow, RunReport, deviation};
use crate::report::text::{columns, or_dash, plain_number, seconds};

/// The whole summary.
pub fn summary(report: &RunReport) -> String {
    let verdict = if report.reached { "REACHED" } else { "NOT REACHED" };
    let mut parts = vec![format!("{}: {verdict}. {}", report.title, report.headline)];
    let rows: Vec<_> =
        figures(&report.figures).into_iter().map(|(label, value)| vec![label, value]).collect();
    parts.push(columns(&["figure", "value"], &rows));
    if !report.objects.is_empty() {
        parts.push(object_table(&report.objects));
    }
    parts.join("\n\n")
}

/// Labels and values of the figures that are known, in the order people look for them.
pub fn figures(figures: &Figures) -> Vec<(String, String)> {
    let count = |value: usize| value.to_string();
    let rows = [
        ("objects", Some(count(figures.objects))),
        ("moves", Some(count(figures.moves))),
        ("of them to buffers", Some(count(figures.buffers))),
        ("lower bound", figures.lower_bound.map(plain_number)),
        ("plans made", figures.plans.map(count)),
        ("looks taken", figures.looks.map(count)),
        ("planning time", figures.planning_s.map(seconds)),
        ("cycle time", figures.cycle_s.map(seconds)),
        ("time per move", figures.per_move_s().map(seconds)),
    ];
    rows.into_iter().filter_map(|(label, value)| Some((label.to_owned(), value?))).collect()
}

fn object_table(objects: &[ObjectRow]) -> String {
    let with_truth = objects.iter().any(|object| object.truth.is_some());
    let mut head = vec!["object", "camera mm", "camera deg"];
    if with_truth {
        head.extend(["world mm", "world deg"]);
    }
    let rows: Vec<_> = objects
        .iter()
        .map(|object| {
            let measured = deviation(object.goal, object.measured);
            let truth = deviation(object.goal, object.truth);
            let cells = [measured, truth].into_iter().take(if with_truth { 2 } else { 1 });
            let numbers = cells.flat_map(|deviation| {
                [
                    or_dash(deviation, |d| format!("{:.2}", d.mm)),
                    or_dash(deviation, |d| format!("{:.2}", d.deg)),
                ]
            });
            std::iter::once(object.id.clone()).chain(numbers).collect()
        })
        .collect();
    format!("distance to the goal\n{}", columns(&head, &rows))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rearrange::geometry::pose::Pose2;

    #[test]
    fn a_run_in_a_few_lines() {
        let goal = Some(Pose2::new(0.1, 0.2, 0.0));
        let near = Some(Pose2::new(0.1004, 0.2003, 0.004));
        let report = RunReport {
            title: "planks".into(),
            reached: true,
            headline: "Every object is where it should be.".into(),
            figures: Figures {
                objects: 2,
                moves: 3,
                buffers: 1,
                lower_bound: Some(3.0),
                plans: Some(1),
                looks: Some(2),
                planning_s: None,
                cycle_s: Some(31.0),
                ..Figures::default()
            },
            objects: vec![
                ObjectRow { id: "plank-1".into(), goal, measured: near, unseen: None, truth: goal },
                ObjectRow { id: "plank-2".into(), goal: None, measured: near, unseen: None, truth: None },
            ],
            ..RunReport::default()
        };
        insta::assert_snapshot!(summary(&report), @r"
        planks: REACHED. Every object is where it should be.

        figure               value
        ------------------  ------
        objects                  2
        moves                    3
        of them to buffers       1
        lower bound              3
        plans made               1
        looks taken              2
        cycle time          31.0 s
        time per move       10.3 s

        distance to the goal
        object   camera mm  camera deg  world mm  world deg
        -------  ---------  ----------  --------  ---------
        plank-1       0.50        0.23      0.00       0.00
        plank-2          -           -         -          -
        ");
    }
}
