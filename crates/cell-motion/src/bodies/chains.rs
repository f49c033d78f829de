//! The arm's links and its flange as chains, for many positions of one arm.
//!
//! In: nominal and calibrated kinematics, joints. Out: the poses of the frames that bodies move with. Pure.

use crate::bodies::nearing::{Twist, twists};
use crate::bodies::shape::placed;
use cell_values::units::Joints;
use nalgebra::Isometry3;
use parry3d_f64::math::Pose;
use ur_arm::chain::Chain;
use ur_arm::kinematics::DhParameters;

/// Frame of what hangs on the flange, after the arm's frames 0 (base) to 6.
pub const TOOL_FRAME: usize = 7;

/// The nominal arm, and the calibrated one.
pub(super) struct Chains {
    nominal: Chain,
    /// Where it differs.
    calibrated: Option<Chain>,
}

impl Chains {
    /// Links follow the nominal arm, the flange the calibrated one.
    pub fn new(nominal: &DhParameters, calibrated: &DhParameters) -> Chains {
        let differs = calibrated != nominal;
        Chains { nominal: Chain::of(nominal), calibrated: differs.then(|| Chain::of(calibrated)) }
    }

    /// Poses of the frames 0 to 6 and of the flange, in the base frame.
    pub fn frames(&self, q: &Joints) -> [Pose; 8] {
        let nominal = self.nominal.frames(q);
        let flange = self.calibrated.as_ref().map_or(nominal[5], |chain| chain.forward(q));
        poses(&nominal, &flange)
    }

    /// The same, and how each moves there while the joints go `way` (rad).
    pub fn moving(&self, q: &Joints, way: &[f64; 6]) -> ([Pose; 8], [Twist; 8]) {
        let nominal = self.nominal.frames(q);
        let links = twists(&nominal, way);
        let (flange, tool) = match &self.calibrated {
            None => (nominal[5], links[6]),
            Some(chain) => {
                let calibrated = chain.frames(q);
                (calibrated[5], twists(&calibrated, way)[6])
            }
        };
        let twist = |frame: usize| links.get(frame).copied().unwrap_or(tool);
        (poses(&nominal, &flange), std::array::from_fn(twist))
    }
}

fn poses(links: &[Isometry3<f64>; 6], flange: &Isometry3<f64>) -> [Pose; 8] {
    std::array::from_fn(|frame| match frame {
        0 => Pose::IDENTITY,
        TOOL_FRAME => placed(flange),
        link => placed(&links[link - 1]),
    })
}
