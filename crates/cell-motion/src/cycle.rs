//! Heights and speeds of a pick-n-place, and the air that is kept over what may lie on the table.
//!
//! In: numbers of the configuration, SI. Out: [`CycleParameters`], and a table with them. Pure.

use crate::bodies::{Standing, Tabletop};
use serde::{Deserialize, Serialize};

/// Of the air over everything, so much is kept on the way over the table, and so much where a corner is cut
/// (shares): there the tool is almost over its place, slower, and higher the farther it is away from it.
const AIR_OVER: f64 = 0.5;
const AIR_IN_CORNER: f64 = 1.0 / 6.0;

/// There it is so much at least, if it is no more than elsewhere, m: heights are measured to a millimetre or
/// two.
const LEAST_IN_CORNER_M: f64 = 3e-3;

/// Heights and speeds of a cycle, from the configuration.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
pub struct CycleParameters {
    /// Height of the tallest object on the table, m.
    pub tallest: f64,
    /// Air kept between what is carried and what is on the table, m.
    pub air: f64,
    /// How far over the object the slow, straight part of approach and retreat begins, m.
    pub approach: f64,
    /// How far the cups are pressed below the nominal top so that they seal, m.
    pub press: f64,
    /// Blend radius between segments, m.
    pub blend: f64,
    /// Joint speed of transfers, rad/s.
    pub joint_speed: f64,
    /// Joint acceleration of transfers, rad/s2.
    pub joint_acceleration: f64,
    /// Tool speed of the straight parts, m/s.
    pub tool_speed: f64,
    /// Tool acceleration of the straight parts, m/s2.
    pub tool_acceleration: f64,
}

impl CycleParameters {
    /// Anything may lie on the table up to here, m, and some air over it for what hangs below the tool.
    pub fn layer(&self) -> f64 {
        self.tallest + AIR_OVER * self.air
    }

    /// The same where a corner is cut, m.
    pub fn corner_layer(&self) -> f64 {
        self.tallest + (AIR_IN_CORNER * self.air).max(LEAST_IN_CORNER_M).min(AIR_OVER * self.air)
    }

    /// A table with this on it, and anything else up to there.
    pub fn tabletop(&self, standing: Vec<Standing>) -> Tabletop {
        Tabletop { layer: self.layer(), corner_layer: self.corner_layer(), standing }
    }
}
