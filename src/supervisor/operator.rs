//! What the operator may ask for, and what each order does in which state of the cell.

use crate::supervisor::cell::{Cell, Phase, alarm, say};
use crate::supervisor::input::{Action, OperatorCommand};
use crate::supervisor::order::JobEnd;
use crate::time::Timestamp;

impl Cell {
    pub(crate) fn on_operator(&mut self, now: Timestamp, command: OperatorCommand, out: &mut Vec<Action>) {
        match command {
            OperatorCommand::Arm => self.on_arm(out),
            OperatorCommand::Disarm => self.on_disarm(out),
            OperatorCommand::Approve => {
                if let (Phase::Approve, Some(job)) = (&self.phase, &mut self.job) {
                    job.approved = true;
                    self.phase = Phase::Ready;
                }
            }
            OperatorCommand::Reject => {
                if matches!(self.phase, Phase::Approve) {
                    self.phase = Phase::Ready;
                    self.finish(now, JobEnd::Cancelled, "plan_rejected", "the plan was rejected", "", out);
                }
            }
            OperatorCommand::Cancel => {
                if let Some(job) = &mut self.job {
                    job.cancel = true;
                }
                if matches!(self.phase, Phase::Plan | Phase::Approve) {
                    self.phase = Phase::Ready;
                }
            }
            OperatorCommand::Pause => self.paused = true,
            OperatorCommand::Resume => {
                self.paused = false;
                self.single_step = false;
            }
            OperatorCommand::Step => {
                self.paused = false;
                self.single_step = true;
            }
            OperatorCommand::Park if self.armed => {
                self.park_wanted = true;
                self.waiting_since = now;
            }
            OperatorCommand::Park => alarm(out, "the cell is disarmed: it does not park; `celld arm` first"),
            OperatorCommand::Abort => self.on_abort(now, out),
            OperatorCommand::Release(channels) => self.on_release_order(now, channels, out),
        }
    }

    fn on_arm(&mut self, out: &mut Vec<Action>) {
        if let Some(reason) = &self.locked {
            return alarm(out, format!("not armed: {reason}; end celld, `celld calibrate`, start it again"));
        }
        self.armed = true;
        // Whoever arms has looked at the table; what stood on it may be gone, and only a look can tell.
        self.foreign_height = 0.0;
        self.drift_told = false;
        say(out, "armed");
    }

    /// What is under way is finished, then nothing moves; whoever disarms may put hands on the table.
    fn on_disarm(&mut self, out: &mut Vec<Action>) {
        self.armed = false;
        self.park_wanted = false;
        self.seen = None;
        if matches!(self.phase, Phase::BringUp(_)) {
            self.phase = Phase::Ready;
        }
        let moving = self.follows_a_path() || matches!(self.phase, Phase::Work(_));
        say(out, if moving { "disarmed once the present motion is over" } else { "disarmed" });
    }
}
