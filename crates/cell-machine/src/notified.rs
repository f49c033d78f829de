//! What people were last shown of the cell, and whether the arm is known to rest.
//!
//! In: the robot's state, turn by turn. Out: whether it moves, whoever moves it. A status is given only
//! where it differs from the last one.

use crate::supervisor::input::DeviceSnapshot;
use crate::supervisor::order::RouteAction;
use crate::supervisor::status::Status;
use cell_values::time::{Duration, Timestamp};
use serde::{Deserialize, Serialize};

/// What was notified last.
#[derive(Default, Deserialize, Serialize)]
pub(crate) struct Notified {
    pub status: Option<Status>,
    pub route: Vec<RouteAction>,
    /// The robot was seen moving, and not yet at rest for [`RESTS_AFTER`] since.
    moved: bool,
    /// Since when it has been seen at rest without a gap.
    rests_since: Option<Timestamp>,
}

/// For how long the robot is seen at rest before the status says so: at the speed that counts as rest, a
/// measured speed goes to and fro.
pub(crate) const RESTS_AFTER: Duration = Duration::from_millis(500);

impl Notified {
    /// The robot moves, whoever moves it, or was last seen moving: it brakes by itself in a stop of its own,
    /// a person may guide it, and of one that is silent nothing else is known. It rests once it was seen to
    /// for this long.
    pub fn moves(&mut self, now: Timestamp, seen: &DeviceSnapshot, long: Duration) -> bool {
        let fresh = seen.robot.filter(|_| seen.robot_fresh);
        if fresh.is_some_and(|robot| robot.stands_still()) {
            let since = *self.rests_since.get_or_insert(now);
            self.moved &= now.since(since) < long;
        } else {
            self.rests_since = None;
            self.moved |= fresh.is_some();
        }
        self.moved
    }
}
