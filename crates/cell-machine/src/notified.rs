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
    /// When the robot was last seen moving, until it has been seen at rest for [`RESTS_AFTER`].
    moved: Option<Timestamp>,
}

/// For how long the robot is seen at rest before the status says so: at the speed that counts as rest, a
/// measured speed goes to and fro.
pub(crate) const RESTS_AFTER: Duration = Duration::from_millis(500);

impl Notified {
    /// The robot moves, whoever moves it, or was last seen moving: it brakes by itself in a stop of its own,
    /// a person may guide it, and of one that is silent nothing else is known. It rests once it was seen to
    /// for this long.
    pub fn moves(&mut self, now: Timestamp, seen: &DeviceSnapshot, long: Duration) -> bool {
        if let Some(robot) = seen.robot.filter(|_| seen.robot_fresh) {
            if !robot.stands_still() {
                self.moved = Some(now);
            } else if self.moved.is_some_and(|at| now.since(at) >= long) {
                self.moved = None;
            }
        }
        self.moved.is_some()
    }
}
