//! What there is to report about a finished run: the figures, the moves, the objects, the log.
//!
//! In: plain values from the daemon. Out: the same, named, for `report::html` and `report::summary`. Pure.

use rearrange::geometry::pose::Pose2;

/// A finished run, as people want to read about it.
#[derive(Clone, Debug, Default)]
pub struct RunReport {
    /// "tetris-heart" or the job's id.
    pub title: String,
    /// The wanted arrangement was reached.
    pub reached: bool,
    /// One sentence: what came of it, and if it failed why and what to do.
    pub headline: String,
    /// The numbers.
    pub figures: Figures,
    /// Every pick-n-place in order.
    pub moves: Vec<MoveRow>,
    /// Every object.
    pub objects: Vec<ObjectRow>,
    /// Camera pictures.
    pub pictures: Vec<Picture>,
    /// Drawings as SVG text.
    pub drawings: Vec<Drawing>,
    /// The run's log.
    pub log: Vec<LogRow>,
    /// Seed, solver, version, time factor and the like: label and value.
    pub settings: Vec<(String, String)>,
}

/// The numbers of a run. `None`: not known or not applicable, shown as a dash.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Figures {
    /// Objects on the table.
    pub objects: usize,
    /// Pick-n-places carried out.
    pub moves: usize,
    /// How many of them went to a buffer.
    pub buffers: usize,
    /// No plan has fewer moves (or less cost).
    pub lower_bound: Option<f64>,
    /// Plans made, the first included.
    pub plans: Option<usize>,
    /// Looks taken.
    pub looks: Option<usize>,
    /// All planning, s.
    pub planning_s: Option<f64>,
    /// From first motion to last, s of the cell's time.
    pub cycle_s: Option<f64>,
    /// Tolerance of the goal, mm.
    pub tolerance_mm: f64,
    /// Tolerance of the goal, degrees.
    pub tolerance_deg: f64,
}

impl Figures {
    /// Mean time of one pick-n-place, s.
    pub fn per_move_s(&self) -> Option<f64> {
        self.cycle_s.filter(|_| self.moves > 0).map(|cycle| cycle / self.moves as f64)
    }
}

/// One pick-n-place.
#[derive(Clone, Debug, PartialEq)]
pub struct MoveRow {
    /// Object.
    pub object: String,
    /// To a buffer, not to its goal.
    pub buffer: bool,
    /// Table frame.
    pub from: Pose2,
    /// Table frame.
    pub to: Pose2,
    /// How far it came; `None`: it was carried out.
    pub unfinished: Option<String>,
    /// It was given up, and the same object was picked again later: no alarm.
    pub anew: bool,
    /// s of the cell's time, if it was carried out.
    pub seconds: Option<f64>,
    /// Relative vacuum while carrying.
    pub vacuum: Option<f64>,
}

/// One object at the end.
#[derive(Clone, Debug, PartialEq)]
pub struct ObjectRow {
    /// Object.
    pub id: String,
    /// Wanted pose.
    pub goal: Option<Pose2>,
    /// As the camera saw it last.
    pub measured: Option<Pose2>,
    /// What is known instead where the camera did not see it, or not since it was gripped.
    pub unseen: Option<String>,
    /// As the simulated world knows it; absent on a real cell.
    pub truth: Option<Pose2>,
}

/// Distance of two poses in the units people read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Deviation {
    /// mm.
    pub mm: f64,
    /// degrees.
    pub deg: f64,
}

/// How far `pose` is from `goal`, if both are known.
pub fn deviation(goal: Option<Pose2>, pose: Option<Pose2>) -> Option<Deviation> {
    let (goal, pose) = goal.zip(pose)?;
    Some(Deviation { mm: goal.distance(&pose) * 1e3, deg: goal.angle_difference(&pose).to_degrees() })
}

/// A picture with its encoded bytes.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// What it shows.
    pub caption: String,
    /// `image/png` or `image/jpeg`.
    pub media_type: &'static str,
    /// The encoded picture.
    pub bytes: Vec<u8>,
}

/// An SVG drawing.
#[derive(Clone, Debug, PartialEq)]
pub struct Drawing {
    /// What it shows.
    pub caption: String,
    /// A whole `<svg>` element, as `report` made it.
    pub svg: String,
}

/// One log line.
#[derive(Clone, Debug, PartialEq)]
pub struct LogRow {
    /// s since the run began; `None`: not known.
    pub seconds: Option<f64>,
    /// "info", "warning", "error".
    pub level: &'static str,
    /// The line.
    pub text: String,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deviation_is_in_mm_and_degrees_and_modulo_a_turn() {
        let goal = Some(Pose2::new(0.1, 0.1, 0.0));
        let pose = Some(Pose2::new(0.1, 0.102, std::f64::consts::TAU - 0.01));
        let Deviation { mm, deg } = deviation(goal, pose).unwrap();
        assert!((mm - 2.0).abs() < 1e-9 && (deg - 0.573).abs() < 1e-3, "{mm} {deg}");
        assert_eq!(deviation(goal, None), None);
    }
}
