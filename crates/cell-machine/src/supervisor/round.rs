//! A calibration round as data: the poses to visit, how far it is, and why it ended early.
//!
//! What the supervisor does with it is in `visits`.

use cell_motion::crossing::Crossing;
use cell_motion::path::PathFault;
use cell_motion::slow::{CalibrationBox, SlowFault};
use cell_values::units::Joints;
use serde::{Deserialize, Serialize};

/// A round to be carried out.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize)]
pub struct RoundOrder {
    /// Where pictures are taken, in this order.
    pub poses: Vec<Joints>,
    /// Where the flange stays.
    pub room: Option<CalibrationBox>,
    /// Ways through corners that are cut, after the last pose, at the speeds of the configuration. The arm
    /// goes slowly to where each begins.
    #[serde(default)]
    pub crossings: Vec<Crossing>,
}

impl RoundOrder {
    /// Pictures from these poses.
    pub fn pictures(poses: Vec<Joints>, room: Option<CalibrationBox>) -> RoundOrder {
        RoundOrder { poses, room, crossings: Vec::new() }
    }

    /// Crossings alone.
    pub fn crossings(crossings: Vec<Crossing>) -> RoundOrder {
        RoundOrder { poses: Vec::new(), room: None, crossings }
    }

    /// The crossing that is visit number `at`, counted from 0 with the poses.
    pub(crate) fn crossing(&self, at: usize) -> Option<&Crossing> {
        self.crossings.get(at.checked_sub(self.poses.len())?)
    }
}

/// Why a round ended without all its pictures.
#[derive(Clone, Debug, PartialEq, thiserror::Error, Deserialize, Serialize)]
pub enum RoundFault {
    /// A gate stayed closed.
    #[error(
        "{what} for {seconds} s; see that `devices.robot` is its address, that it is powered and in remote \
         control"
    )]
    NotReady {
        /// Which.
        what: String,
        /// How long.
        seconds: u64,
    },
    /// A pose cannot be visited.
    #[error(transparent)]
    Move(#[from] SlowFault),
    /// A crossing cannot be carried out.
    #[error("a way through cut corners")]
    Crossing(#[source] PathFault),
    /// It came to rest elsewhere.
    #[error("the arm came to rest {off_mrad:.0} mrad from where its way ends")]
    Elsewhere {
        /// How far the farthest joint was.
        off_mrad: f64,
    },
    /// What stopped the robot.
    #[error("the round ended, or was not begun: {0}")]
    Robot(String),
    /// The camera gave no picture.
    #[error("camera: {0}")]
    Camera(String),
}

/// A round under way.
#[derive(Debug, Deserialize, Serialize)]
pub(crate) struct Round {
    pub order: RoundOrder,
    /// Index of the pose that is visited.
    pub at: usize,
    /// The arm is on the crossing itself, not on its way to where that begins.
    #[serde(default)]
    pub crosses: bool,
}

impl Round {
    pub fn new(order: RoundOrder) -> Round {
        Round { order, at: 0, crosses: false }
    }

    /// Number of the pose, from 1, and how many there are.
    pub fn progress(&self) -> (usize, usize) {
        (self.at + 1, self.order.poses.len() + self.order.crossings.len())
    }
}
