//! What happened in the world, for tests, the report, the control server and faults that wait for it.
//!
//! Out: plain values that serialise to JSON.

use rearrange::geometry::pose::Pose2;
use serde::Serialize;

/// Something that happened, with the controller's time.
#[derive(Clone, Debug, Serialize)]
pub struct Event {
    /// Controller time, s.
    pub time_s: f64,
    /// What it was.
    #[serde(flatten)]
    pub kind: EventKind,
}

/// What can happen.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum EventKind {
    /// The vacuum of a channel took hold of an object.
    Gripped {
        /// The object.
        object: String,
    },
    /// An object was set down.
    Placed {
        /// The object.
        object: String,
        /// Where it lies now.
        pose: Pose2,
    },
    /// An object fell.
    Dropped {
        /// The object.
        object: String,
        /// How far, m.
        height_m: f64,
    },
    /// A placed object moved a neighbour, or was moved by one that is fixed; or the arm ran into it.
    Pushed {
        /// Who moved.
        object: String,
        /// Who moved it: an object, `cup` or `gripper`.
        by: String,
        /// How far, m.
        distance_m: f64,
    },
    /// A placed object came to lie on others.
    Tilted {
        /// The object.
        object: String,
        /// Those under it.
        on: Vec<String>,
        /// Angle of its top against the table, rad.
        tilt_rad: f64,
    },
    /// An object left the table.
    Fallen {
        /// The object.
        object: String,
    },
    /// The arm pressed something into something, beyond what the cups give.
    Contact(Contact),
    /// A fault was requested.
    Fault {
        /// Its name.
        name: String,
    },
}

/// Something pressed into something else.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Contact {
    /// What the arm moves: an object's name, `cup` or `gripper`.
    pub moving: String,
    /// What is in the way: an object's name or `table`.
    pub against: String,
    /// How far, m.
    pub depth_m: f64,
}
