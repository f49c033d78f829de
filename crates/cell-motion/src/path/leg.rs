//! Pieces of a path, and what each has to keep.
//!
//! In: ends in joints, speeds, blends. Out: plain values, SI. Pure.

use crate::bodies::sweep::Zone;
use cell_values::units::Joints;
use serde::{Deserialize, Serialize};

/// One piece of a path, as the on-robot program understands it.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
pub enum Segment {
    /// `movej`: straight in joint space. Speed rad/s, acceleration rad/s2, blend radius m.
    Joint {
        /// End of the segment.
        target: Joints,
        /// Leading joint's speed, rad/s.
        speed: f64,
        /// Leading joint's acceleration, rad/s2.
        acceleration: f64,
        /// Blend radius into the next segment, m; 0 stops at the end.
        blend: f64,
    },
    /// `movel`: the tool goes straight. Speed m/s, acceleration m/s2, blend radius m. The end is given in
    /// joints so that the branch of the inverse kinematics is never in doubt.
    Linear {
        /// End of the segment.
        target: Joints,
        /// Tool speed, m/s.
        speed: f64,
        /// Tool acceleration, m/s2.
        acceleration: f64,
        /// Blend radius into the next segment, m; 0 stops at the end.
        blend: f64,
    },
}

impl Segment {
    /// The joints the segment ends at.
    pub fn target(&self) -> Joints {
        match self {
            Segment::Joint { target, .. } | Segment::Linear { target, .. } => *target,
        }
    }

    /// Blend radius, m.
    pub fn blend(&self) -> f64 {
        match self {
            Segment::Joint { blend, .. } | Segment::Linear { blend, .. } => *blend,
        }
    }
}

/// A segment and what it has to keep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Leg {
    /// The segment.
    pub segment: Segment,
    /// Lowest height of the tool's tip, m over the table.
    pub floor: f64,
    /// Whether it goes over everything on the table, or straight down or up between.
    pub zone: Zone,
    /// Largest acceleration that what is held withstands on the cups, m/s2.
    pub hold: f64,
}

impl Leg {
    /// With nothing held, over everything on the table.
    pub fn over(segment: Segment, floor: f64) -> Leg {
        Leg { segment, floor, zone: Zone::Over, hold: f64::INFINITY }
    }

    /// With nothing held, straight down or up between the objects.
    pub fn between(segment: Segment, floor: f64) -> Leg {
        Leg { segment, floor, zone: Zone::Between, hold: f64::INFINITY }
    }

    /// The same with something held that withstands this acceleration (m/s2).
    pub fn holding(self, hold: f64) -> Leg {
        Leg { hold, ..self }
    }
}
