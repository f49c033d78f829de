//! From where the table is looked at, what has to be seen, and how much of what was seen holds.
//!
//! Plain data; `sight` decides with it.

use cell_values::time::Timestamp;
use cell_values::units::Joints;
use cell_vision::region::Region;
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// How much of what was seen holds.
#[derive(Debug, Default, Deserialize, Serialize)]
pub(crate) struct Sight {
    /// What was disturbed and not seen since.
    pub disturbed: Region,
    /// The number of the pick-n-place that the last look was made for.
    pub made_for: Option<usize>,
    /// The last look showed the whole table, and nothing was disturbed since.
    pub whole: bool,
    /// Pick-n-places since the last look at the whole table.
    pub since_whole: u32,
    /// When the last look that showed an object was over: a slow arm may take long from stop to stop, and
    /// what a look has just shown is not old for that.
    pub looked_at: BTreeMap<String, Timestamp>,
    /// How long the pictures of the last look were searched after the last of them was taken, s; 0 before
    /// the first.
    pub searched_s: f64,
}

/// From where the table is looked at, in order, and what has to be seen: the whole table where there is no
/// region.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(crate) struct LookPlan {
    pub poses: Vec<Joints>,
    pub region: Option<Region>,
    /// Objects whose places are in the region because they will soon be too old, and for nothing else.
    pub for_age: Vec<String>,
}

/// A stop of a look for its frames.
#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
pub(crate) struct Stop {
    /// When the first frame was taken.
    pub at: Timestamp,
    /// `table_from_camera`.
    pub camera: Isometry3<f64>,
}
