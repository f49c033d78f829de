//! What comes out of an observation.
//!
//! In: nothing. Out: the types that `observe` gives: estimates with their uncertainty, and the headings
//! under which everything that cannot be trusted is filed. Poses are in the table frame. Pure data.

use crate::foreign::ForeignReport;
use crate::observe::reference;
use cell_values::time::Timestamp;
use rearrange::geometry::pose::Pose2;
use serde::{Deserialize, Serialize};

/// Where an object lies.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ObjectEstimate {
    /// The object's name.
    pub id: String,
    /// The object's frame in the table frame.
    pub pose: Pose2,
    /// Standard deviation of the position along the worse axis, m.
    pub std_xy_m: f64,
    /// Standard deviation of the angle, rad.
    pub std_theta_rad: f64,
    /// Pictures that contributed.
    pub views: usize,
    /// Pictures left out as outliers or misread.
    pub rejected_views: usize,
    /// Angle between the marker's normal and the vertical, rad: noise below `tilt_std_rad` or so.
    pub tilt_rad: f64,
    /// Standard deviation of the tilt in its worse direction, rad.
    pub tilt_std_rad: f64,
    /// How much higher the marker seems than it should be, m.
    pub height_error_m: f64,
    /// Standard deviation of that, m.
    pub height_std_m: f64,
    /// When the newest contributing picture was taken.
    pub time: Timestamp,
}

/// An object that was seen but must not be handled as if it lay flat.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Suspicious {
    /// The object's name.
    pub id: String,
    /// What is wrong, in words.
    pub reason: String,
    /// Best guess of where it is, where there is one: for pictures and recovery, not for planning.
    pub estimate: Option<ObjectEstimate>,
}

/// One marker id seen at several places.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Duplicate {
    /// The object's name.
    pub id: String,
    /// The marker's number.
    pub marker_id: u32,
    /// Where it was seen, object frame in the table frame.
    pub poses: Vec<Pose2>,
}

/// What the pictures say about the table.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Observation {
    /// Objects whose pose can be trusted, in the order they were requested.
    pub objects: Vec<ObjectEstimate>,
    /// Objects whose marker was not seen at all.
    pub missing: Vec<String>,
    /// Marker ids seen at more than one place; their objects are not in `objects`.
    pub duplicates: Vec<Duplicate>,
    /// Marker ids that belong to no object and no reference, ascending.
    pub unknown: Vec<u32>,
    /// Objects seen tilted, at a wrong height, or inconsistently; not in `objects`.
    pub suspicious: Vec<Suspicious>,
    /// The reference markers against their survey; `None` when none was seen.
    pub reference: Option<reference::ReferenceCheck>,
    /// Root mean square error of the reference markers' centres, m; `None` when none was seen.
    pub reference_residual_m: Option<f64>,
    /// What is there and carries no marker; `None` where no depth was measured. The caller with depth fills
    /// it in.
    pub foreign: Option<ForeignReport>,
}

impl Observation {
    /// The estimate of the object called `id`, if it is trusted.
    pub fn object(&self, id: &str) -> Option<&ObjectEstimate> {
        self.objects.iter().find(|object| object.id == id)
    }

    /// True when every object was seen and can be trusted.
    pub fn complete(&self) -> bool {
        self.missing.is_empty() && self.duplicates.is_empty() && self.suspicious.is_empty()
    }
}
