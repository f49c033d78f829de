//! The rules about ends: what is under way goes on or ends, and no pick-n-place is tried for ever.
//!
//! In: the truth of every frame, the records of the journal. Out: breaches. What a person or a fault holds
//! up may last as long as that: a program that is paused, a slider at zero, a camera or disk that does not
//! answer.

use crate::pair::rules::found::Found;
use crate::pair::rules::rule::Rule;
use crate::pair::rules::truth::Truth;
use cell_machine::supervisor::status::Doing;
use ur_sim::faults::camera::CameraFaults;
use ur_sim::world::World;

/// Nothing that is under way stands still for longer, 2 minutes.
const STANDS_FRAMES: u64 = 60_000;

/// A slower slider holds a motion up for long.
const SLOW: f64 = 0.1;

/// Beginnings of one pick-n-place beside those that `retries` allows: after a restart, a stop, an approval.
const BEGUN_AGAIN: u32 = 4;

/// What is waited for. See the module.
#[derive(Debug)]
pub(super) struct Waits {
    retries: u32,
    /// What the status says, and since when it has said so with an arm at rest.
    doing: Option<Doing>,
    since: u64,
    /// The pick-n-place that was written down last, by its number in the job, and how often.
    step: Option<usize>,
    begun: u32,
}

impl Waits {
    /// A failed grip is tried again so many times.
    pub fn new(retries: u32) -> Waits {
        Waits { retries, doing: None, since: 0, step: None, begun: 0 }
    }

    /// A person acts, or the daemon comes back: what follows is not a repetition.
    pub fn acted_on(&mut self) {
        self.begun = 0;
    }

    /// A pick-n-place is written down.
    pub fn intends(&mut self, step: usize, found: &mut Found) {
        self.begun = if self.step == Some(step) { self.begun + 1 } else { 1 };
        self.step = Some(step);
        if self.begun == self.retries + BEGUN_AGAIN + 1 {
            found.push(Rule::RetriesWithoutEnd, format!("number {step} of its job, {} times", self.begun));
        }
    }

    /// It succeeded, or its job is over.
    pub fn succeeded(&mut self) {
        (self.step, self.begun) = (None, 0);
    }

    /// One controller frame.
    pub fn frame(&mut self, truth: &Truth, world: &World, found: &mut Found) {
        let doing = truth.status.map(|status| &status.doing);
        let goes_on = truth.moves || doing != self.doing.as_ref();
        let dark =
            matches!(doing, Some(Doing::Looking(..))) && *world.camera_faults() != CameraFaults::default();
        let held_up = truth.paused || truth.speed < SLOW || dark;
        let under_way = doing.is_some_and(|doing| doing.is_under_way() && *doing != Doing::AwaitingApproval);
        if goes_on || held_up || !under_way {
            self.since = truth.frame;
            if goes_on {
                self.doing = doing.cloned();
            }
        }
        if truth.frame == self.since + STANDS_FRAMES {
            found.push(Rule::WaitWithoutEnd, format!("{:?}", self.doing));
        }
    }
}
