//! The time of a job by its use: each span between two decisions is attributed by what the arm did in it.
//!
//! In: the phase, the robot's state, the time that passed. Out: [`JobTimes`] in the job's report. The arm's
//! own speeds say whether it moves; the phase says what for, or what it rests for.

use crate::supervisor::cell::Supervisor;
use crate::supervisor::input::DeviceSnapshot;
use crate::supervisor::phase::{Look, LookStage, Phase, WorkStage};
use crate::times::Use;
use cell_values::time::Duration;

impl Supervisor {
    /// Attributes the time since the last decision.
    pub(crate) fn book_time(&mut self, devices: &DeviceSnapshot, passed: Duration) {
        if self.job.is_none() {
            return;
        }
        let moves = devices.robot.is_some_and(|robot| !robot.stands_still());
        let (what, is_round) = self.use_of_time(moves);
        self.times.spend(what, is_round, passed.as_secs_f64());
    }

    /// What the time is used for now, and whether it belongs to a look at the whole table or to a plan.
    fn use_of_time(&self, moves: bool) -> (Use, bool) {
        let unless_moving = |what: Use| if moves { Use::Travel } else { what };
        match &self.phase {
            Phase::Look(look) => (unless_moving(use_of_look(look)), look.region.is_none()),
            Phase::Work(work) => (self.use_of_work(work.stage, moves), false),
            Phase::Plan => (unless_moving(Use::Planning), true),
            Phase::Approve => (unless_moving(Use::Waiting), true),
            Phase::Ready | Phase::BringUp(_) | Phase::Park | Phase::Visit(_) | Phase::Recover(_) => {
                (unless_moving(Use::Waiting), self.seen.is_none())
            }
        }
    }

    fn use_of_work(&self, stage: WorkStage, moves: bool) -> Use {
        let first = self.times.segments() == 0;
        let vertical = match stage {
            WorkStage::Approaching { segments } | WorkStage::Carrying { segments } => {
                (first && matches!(stage, WorkStage::Carrying { .. }))
                    || self.times.segments() + 1 >= segments
            }
            WorkStage::Retreating | WorkStage::Withdrawing => first,
            WorkStage::NotingIntent(_) | WorkStage::Gripping | WorkStage::Releasing | WorkStage::GivingUp => {
                false
            }
        };
        match (moves, stage) {
            (true, _) if vertical => Use::Vertical,
            (true, _) => Use::Travel,
            (false, WorkStage::NotingIntent(_)) => Use::Disk,
            (false, WorkStage::Gripping | WorkStage::Releasing | WorkStage::GivingUp) => Use::Vacuum,
            (
                false,
                WorkStage::Approaching { .. }
                | WorkStage::Carrying { .. }
                | WorkStage::Retreating
                | WorkStage::Withdrawing,
            ) => Use::Waiting,
        }
    }
}

fn use_of_look(look: &Look) -> Use {
    match look.stage {
        LookStage::Moving => Use::Waiting,
        LookStage::Settling { .. } => Use::Settle,
        LookStage::Capturing { .. } => Use::Exposure,
        LookStage::Observing => Use::Detection,
    }
}
