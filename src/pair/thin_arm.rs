//! Another model of the arm's bodies than the one that paths are checked with.
//!
//! In: the arm's model, a tool. Out: distances, m. Capsules 10 mm thinner than the published ones,
//! distances by another formula, one position at a time: what passes the swept check must not meet anything
//! here. Pure.

use cell_calibration::propose::body::apart_m;
use cell_motion::path::ArmModel;
use cell_values::units::Joints;
use nalgebra::{Isometry3, Point3, Vector3};
use ur_arm::bodies::{Capsule, HARMLESS_PAIRS, capsules};
use ur_arm::chain::Chain;
use ur_arm::kinematics::{DhParameters, model_of};

/// How much thinner its capsules are than those of the check, m.
pub const THINNER_M: f64 = 0.01;

/// Arm, gripper and table as a few thin bodies.
#[derive(Clone, Debug)]
pub struct ThinModel {
    chain: Chain,
    base_from_table: Isometry3<f64>,
    /// Frame (0 to 6), and the capsule in it.
    bodies: Vec<(usize, Capsule)>,
    pairs: Vec<(usize, usize)>,
}

impl ThinModel {
    /// The published capsules, thinner, and a tool in the flange's frame.
    pub fn of(model: &ArmModel, tool: Capsule) -> ThinModel {
        ThinModel::new(model.kinematics.dh(), model.base_from_table, tool)
    }

    /// The same of an arm with these parameters.
    pub fn new(dh: &DhParameters, base_from_table: Isometry3<f64>, tool: Capsule) -> ThinModel {
        let links = capsules(model_of(dh).name).into_iter().flatten().enumerate();
        let thinner = |capsule: &Capsule| Capsule { radius: capsule.radius - THINNER_M, ..*capsule };
        let mut bodies: Vec<(usize, Capsule)> = links
            .flat_map(|(frame, each)| each.iter().map(move |capsule| (frame, thinner(capsule))))
            .collect();
        let arm_bodies = bodies.len();
        bodies.push((6, tool));
        let mut pairs = Vec::new();
        for a in 0..bodies.len() {
            for b in a + 1..bodies.len() {
                let frames = (bodies[a].0, bodies[b].0);
                let tool = b >= arm_bodies;
                let harmless = frames.0 == frames.1 || HARMLESS_PAIRS.contains(&frames);
                if (tool && frames.0 < 4) || (!tool && !harmless) {
                    pairs.push((a, b));
                }
            }
        }
        ThinModel { chain: Chain::of(dh), base_from_table, bodies, pairs }
    }

    /// Whether all distances on a straight way in joint space are at least `distance` (m), with samples at
    /// most `step` (rad) apart.
    pub fn keeps(&self, distance: f64, from: &Joints, to: &Joints, step: f64) -> bool {
        let samples = (from.max_difference(to) / step).ceil().max(1.0) as usize;
        let at = |k: usize| {
            let share = k as f64 / samples as f64;
            from.lerp(to, share)
        };
        (0..=samples).all(|k| self.least_at(&at(k)) >= distance)
    }

    /// The least distance of two bodies, or of one over the table, m; not positive where they overlap.
    pub fn least_at(&self, q: &Joints) -> f64 {
        let mut frames = vec![Isometry3::identity()];
        frames.extend(self.chain.placed(q).bodies);
        let placed: Vec<[Point3<f64>; 2]> = self
            .bodies
            .iter()
            .map(|(frame, capsule)| [capsule.a, capsule.b].map(|end| frames[*frame] * Point3::from(end)))
            .collect();
        let pair = |(a, b): &(usize, usize)| {
            apart_m(&placed[*a], &placed[*b]) - self.bodies[*a].1.radius - self.bodies[*b].1.radius
        };
        let own = self.pairs.iter().map(pair).fold(f64::INFINITY, f64::min);
        let up = self.base_from_table.rotation * Vector3::z();
        let surface = self.base_from_table.translation.vector;
        let over = self.bodies.iter().zip(&placed).filter(|((frame, _), _)| *frame >= 2);
        let heights = over.flat_map(|((_, capsule), ends)| {
            ends.map(|end| up.dot(&(end.coords - surface)) - capsule.radius)
        });
        own.min(heights.fold(f64::INFINITY, f64::min))
    }
}
