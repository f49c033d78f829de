//! Small values of the loop: when it came round last, and what the cell works on.

use cell_machine::supervisor::status::{Doing, Status};
use cell_values::time::{Duration, Timestamp};
use std::time::Instant;

/// When the loop came round last, in the cell's time and by the wall's clock.
#[derive(Default)]
pub(super) struct LoopPace(Option<(Timestamp, Instant)>);

impl LoopPace {
    /// Time since the last call. A simulated cell's clock stands while its simulator waits, and what passes
    /// then is no time of the cell.
    pub(super) fn gap(&mut self, now: Timestamp) -> Duration {
        let wall = Instant::now();
        let last = self.0.replace((now, wall));
        last.map_or(Duration::ZERO, |(cell, at)| now.since(cell).min(wall.duration_since(at)))
    }
}

/// What the cell works on, for the fields of the log.
#[derive(Debug, Default)]
pub(super) struct AtWork {
    pub(super) job: Option<String>,
    /// Of the plan, from 1.
    pub(super) step: Option<usize>,
}

impl AtWork {
    pub(super) fn of(status: &Status) -> AtWork {
        let works = matches!(status.doing, Doing::Working(..));
        AtWork { job: status.job.clone(), step: works.then_some(status.moves + 1) }
    }
}
