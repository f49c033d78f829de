//! A body that may be on the table without being foreign. Pure data.

use rearrange::geometry::footprint::Footprint;
use rearrange::geometry::pose::Pose2;

/// Something whose place is known.
#[derive(Clone, Debug, PartialEq)]
pub struct KnownBody {
    /// Its outline seen from above, in its own frame.
    pub footprint: Footprint,
    /// Where it is, table frame.
    pub pose: Pose2,
    /// How high it is, m.
    pub height_m: f64,
}
