//! The six figures of the paper's evaluation, from rows of the planning benchmark.
//!
//! In: rows. Out: for each [`Spec`] a figure of three panels as in the paper: plan length as a multiple of
//! the number of objects (total impedance for TI), computation time, success rate; with our lower bound as a
//! line. A point is the mean over the solved cases of a cell ("the average of 50 cases except for unfinished
//! trials"), its whisker the standard error; the bound's is over all cases of the cell, solved or not. The
//! success rate is solved cases over cases run.

use crate::bench::cells::Cell;
use crate::bench::table::{Row, density_word};
use crate::report::chart::{Curve, Figure, Look, Mark, Panel, Point, Scale};
use rearrange::planning::plan::Objective;
use rearrange::planning::solver::SolverKind;
use std::collections::BTreeMap;

/// What a figure varies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Axis {
    /// The number of objects, at this density.
    Objects {
        /// Density of all cells.
        density: f64,
    },
    /// The density, at this number of objects.
    Density {
        /// Number of objects of all cells.
        objects: usize,
    },
}

/// One figure of the paper.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spec {
    /// On the command line and as file name.
    pub name: &'static str,
    /// `rand` or `sq`.
    pub scenario: &'static str,
    /// What the solvers minimise.
    pub objective: Objective,
    /// What is varied.
    pub axis: Axis,
}

/// Numbers of objects and densities of the paper's cells.
const OBJECTS: [usize; 3] = [20, 30, 40];
const DENSITIES: [f64; 3] = [0.2, 0.3, 0.4];

const fn spec(name: &'static str, scenario: &'static str, objective: Objective, axis: Axis) -> Spec {
    Spec { name, scenario, objective, axis }
}

/// The figures in the paper's order.
pub const FIGURES: [Spec; 6] = [
    spec("rand-pp", "rand", Objective::Pp, Axis::Objects { density: 0.4 }),
    spec("sq-pp", "sq", Objective::Pp, Axis::Objects { density: 0.4 }),
    spec("rand-density", "rand", Objective::Pp, Axis::Density { objects: 20 }),
    spec("sq-density", "sq", Objective::Pp, Axis::Density { objects: 20 }),
    spec("rand-ti", "rand", Objective::Ti, Axis::Objects { density: 0.3 }),
    spec("sq-ti", "sq", Objective::Ti, Axis::Objects { density: 0.3 }),
];

impl Spec {
    /// The cells the paper shows in this figure.
    pub fn cells(&self) -> Vec<Cell> {
        let cell = |density, objects| Cell::new(self.scenario, density, objects, self.objective);
        match self.axis {
            Axis::Objects { density } => OBJECTS.map(|objects| cell(density, objects)).to_vec(),
            Axis::Density { objects } => DENSITIES.map(|density| cell(density, objects)).to_vec(),
        }
    }

    /// Where a row is on the x axis, if it belongs into this figure.
    fn x(&self, row: &Row) -> Option<f64> {
        let key = &row.key;
        if key.scenario != self.scenario || key.objective != self.objective {
            return None;
        }
        match self.axis {
            Axis::Objects { density } => (key.density == density_word(density)).then_some(key.objects as f64),
            Axis::Density { objects } => key.density.parse().ok().filter(|_| key.objects == objects),
        }
    }

    fn title(&self) -> String {
        let scenario = self.scenario.to_uppercase();
        let objective = if self.objective == Objective::Ti { "total impedance" } else { "pick-n-places" };
        match self.axis {
            Axis::Objects { density } => format!("{scenario}, density {density}, objective {objective}"),
            Axis::Density { objects } => format!("{scenario}, {objects} objects, objective {objective}"),
        }
    }
}

/// The rows of one solver at one place on the x axis.
type Cases<'a> = BTreeMap<(usize, u64), Vec<&'a Row>>;

/// What is drawn of the rows at a place, and its spread; None where there is nothing.
type Value<'a> = &'a dyn Fn(&[&Row]) -> Option<(f64, f64)>;

/// Draws a figure; None when no row belongs into it.
pub fn figure(spec: &Spec, rows: &[Row]) -> Option<Figure> {
    let mine: Vec<(f64, &Row)> = rows.iter().filter_map(|row| Some((spec.x(row)?, row))).collect();
    if mine.is_empty() {
        return None;
    }
    // Bits of a non-negative number sort as the number does.
    let mut cases: Cases = BTreeMap::new();
    for (x, row) in &mine {
        cases.entry((place(row.key.solver), x.to_bits())).or_default().push(row);
    }
    let (cost_title, by_objects) = match spec.objective {
        Objective::Ti => ("Total impedance", false),
        Objective::Pp | Objective::Time => ("Plan length / number of objects", true),
    };
    let share = |row: &Row| if by_objects { row.key.objects as f64 } else { 1.0 };
    let cost = |rows: &[&Row]| mean(rows.iter().filter_map(|row| Some(row.cost? / share(row))));
    let time = |rows: &[&Row]| mean(rows.iter().filter(|row| row.cost.is_some()).map(|row| row.seconds));
    let success = |rows: &[&Row]| {
        mean(rows.iter().map(|row| f64::from(u8::from(row.cost.is_some())))).map(|(y, _)| (y, 0.0))
    };
    let mut first = curves(&cases, &cost);
    first.push(bound_curve(&mine, &share));
    let panel = |title: &str, scale, curves| Panel { title: title.to_string(), scale, curves };
    Some(Figure {
        title: spec.title(),
        subtitle: subtitle(&cases),
        x_label: match spec.axis {
            Axis::Objects { .. } => "number of objects".into(),
            Axis::Density { .. } => "density".into(),
        },
        x_ticks: x_ticks(spec, &mine),
        panels: vec![
            panel(cost_title, Scale::Linear, first),
            panel("Computation time (s)", Scale::Log, curves(&cases, &|rows| time(rows).map(|t| (t.0, 0.0)))),
            panel("Success rate", Scale::Percent, curves(&cases, &success)),
        ],
    })
}

fn x_ticks(spec: &Spec, rows: &[(f64, &Row)]) -> Vec<(f64, String)> {
    let mut places: Vec<f64> = rows.iter().map(|(x, _)| *x).collect();
    places.sort_by(f64::total_cmp);
    places.dedup();
    let word = |x: f64| match spec.axis {
        Axis::Objects { .. } => format!("{x:.0}"),
        Axis::Density { .. } => format!("{x}"),
    };
    places.into_iter().map(|x| (x, word(x))).collect()
}

/// One curve a solver, in the order of [`LOOKS`]; points without a value are left out.
fn curves(cases: &Cases, value: Value) -> Vec<Curve> {
    let mut curves = Vec::new();
    for (index, (solver, look)) in LOOKS.iter().enumerate() {
        let here = cases.range((index, 0)..=(index, u64::MAX));
        let points: Vec<Point> = here
            .clone()
            .filter_map(|((_, x), rows)| {
                let (y, spread) = value(rows)?;
                Some(Point { x: f64::from_bits(*x), y, spread })
            })
            .collect();
        if here.count() > 0 {
            curves.push(Curve { name: solver.as_str().to_uppercase(), look: *look, points });
        }
    }
    curves
}

/// The mean bound of all cases of each place, each case once however many solvers ran on it.
fn bound_curve(rows: &[(f64, &Row)], share: &dyn Fn(&Row) -> f64) -> Curve {
    let mut bounds: BTreeMap<u64, BTreeMap<&str, f64>> = BTreeMap::new();
    for (x, row) in rows {
        bounds.entry(x.to_bits()).or_default().insert(&row.key.id, row.lower_bound / share(row));
    }
    let points = bounds.into_iter().filter_map(|(x, cases)| {
        let (y, _) = mean(cases.into_values())?;
        Some(Point { x: f64::from_bits(x), y, spread: 0.0 })
    });
    let look = Look { colour: "#000", mark: Mark::None, solid: true };
    Curve { name: "lower bound".into(), look, points: points.collect() }
}

fn subtitle(cases: &Cases) -> String {
    let counts = || cases.values().map(Vec::len);
    let (least, most) = (counts().min().unwrap_or(0), counts().max().unwrap_or(0));
    let counted = if least == most { format!("{most}") } else { format!("{least} to {most}") };
    let word = if most == 1 { "case" } else { "cases" };
    format!(
        "{counted} {word} a point; length and time: means of the solved cases, whiskers: standard error; \
         lower bound: mean of all cases"
    )
}

/// Mean and its standard error; None of nothing.
fn mean(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    let values: Vec<f64> = values.collect();
    let count = values.len() as f64;
    if values.is_empty() {
        return None;
    }
    let mean = values.iter().sum::<f64>() / count;
    let squares = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>();
    let error = if values.len() > 1 { (squares / (count - 1.0) / count).sqrt() } else { 0.0 };
    Some((mean, error))
}

const fn look(colour: &'static str, mark: Mark, solid: bool) -> Look {
    Look { colour, mark, solid }
}

/// A method and its extension share colour and mark; the extension is solid. Colours are distinguishable for
/// the colour-blind (Okabe and Ito).
const LOOKS: [(SolverKind, Look); 7] = [
    (SolverKind::Tbm, look("#0072b2", Mark::Disc, false)),
    (SolverKind::Etbm, look("#0072b2", Mark::Disc, true)),
    (SolverKind::Rbm, look("#d55e00", Mark::Square, false)),
    (SolverKind::Erbm, look("#d55e00", Mark::Square, true)),
    (SolverKind::Mcts, look("#009e73", Mark::Triangle, false)),
    (SolverKind::Emcts, look("#009e73", Mark::Triangle, true)),
    (SolverKind::Auto, look("#7b3294", Mark::Diamond, true)),
];

fn place(solver: SolverKind) -> usize {
    LOOKS.iter().position(|(kind, _)| *kind == solver).unwrap_or(LOOKS.len() - 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::table::tests::row;
    use crate::report::chart::figure_svg;

    fn panel<'a>(figure: &'a Figure, at: usize, name: &str) -> &'a [Point] {
        &figure.panels[at].curves.iter().find(|curve| curve.name == name).expect("a curve").points
    }

    #[test]
    fn means_are_over_solved_cases_and_the_bound_over_all() {
        let mut hard = row("3", None);
        hard.lower_bound = 26.0;
        let rows = [row("1", Some(22.0)), row("2", Some(26.0)), hard];
        let figure = figure(&FIGURES[0], &rows).expect("rows of RAND at 0.4");
        let length = panel(&figure, 0, "ERBM");
        assert_eq!((length.len(), length[0].x), (1, 20.0));
        assert!((length[0].y - 1.2).abs() < 1e-12);
        assert!((length[0].spread - 0.1).abs() < 1e-12);
        assert!((panel(&figure, 0, "lower bound")[0].y - 1.1).abs() < 1e-12);
        assert_eq!(panel(&figure, 1, "ERBM")[0].y, 1.0);
        assert!((panel(&figure, 2, "ERBM")[0].y - 2.0 / 3.0).abs() < 1e-12);
        assert!(figure.subtitle.starts_with("3 cases a point"));
    }

    #[test]
    fn a_row_is_drawn_where_it_belongs_and_nowhere_else() {
        let rows = [row("1", Some(22.0))];
        let with_data: Vec<&str> =
            FIGURES.iter().filter(|spec| figure(spec, &rows).is_some()).map(|spec| spec.name).collect();
        assert_eq!(with_data, ["rand-pp", "rand-density"]);
        let drawn = figure(&FIGURES[2], &rows).expect("one density");
        assert_eq!(drawn.x_ticks, [(0.4, "0.4".to_string())]);
    }

    #[test]
    fn total_impedance_is_not_divided() {
        let mut heavy = row("1", Some(31.5));
        heavy.key.objective = Objective::Ti;
        heavy.key.density = "0.30".into();
        let figure = figure(&FIGURES[4], &[heavy]).expect("rows of RAND TI");
        assert_eq!(panel(&figure, 0, "ERBM")[0].y, 31.5);
        assert!(figure_svg(&figure).contains("Total impedance"));
    }

    #[test]
    fn solvers_that_solve_nothing_still_show_their_success_rate() {
        let figure = figure(&FIGURES[0], &[row("1", None)]).expect("a row");
        assert!(panel(&figure, 0, "ERBM").is_empty());
        assert_eq!(panel(&figure, 2, "ERBM")[0].y, 0.0);
        assert!(!figure_svg(&figure).contains("NaN"));
    }

    #[test]
    fn the_six_figures_have_the_paper_s_cells() {
        assert!(FIGURES.iter().all(|spec| spec.cells().len() == 3));
        let cells: Vec<Cell> = FIGURES.iter().flat_map(Spec::cells).collect();
        assert!(cells.iter().any(|cell| cell.scenario == "sq" && cell.density == 0.3 && cell.objects == 40));
    }
}
