//! An armed cell stops when orders cannot reach it, and when celld itself was held up.
//!
//! In: whether orders reach the cell, for how long the loop did not come round. Out: the arm stopped, the
//! vacuum as it is, the job kept for a new look, the cell disarmed. A person who cannot stop the cell must
//! not believe that it is under control; after a pause of celld nothing is as it was.

use crate::code::{Code, JobStatus};
use crate::intake::Unreachable;
use crate::supervisor::cell::Supervisor;
use crate::supervisor::gates::GateClosed;
use crate::supervisor::input::Action;
use crate::supervisor::phase::Phase;
use crate::supervisor::reason::{Reason, alarm};
use cell_values::time::{Duration, Timestamp};

impl Supervisor {
    pub(crate) fn on_orders_reach(
        &mut self,
        now: Timestamp,
        fault: Option<Unreachable>,
        out: &mut Vec<Action>,
    ) {
        let was = std::mem::replace(&mut self.unreachable, fault);
        match (&self.unreachable, was) {
            (Some(fault), None) => {
                let message = format!("orders do not reach celld: {fault}");
                self.interrupt(now, Code::OrdersUnreachable.because(message, RESTORE_HINT), out);
            }
            (None, Some(_)) => {
                alarm(out, "orders reach celld again; see that the cell is clear, then `celld arm`")
            }
            (Some(_), Some(_)) | (None, None) => {}
        }
    }

    pub(crate) fn on_held_up(&mut self, now: Timestamp, gap: Duration, out: &mut Vec<Action>) {
        self.ledger.start_again(now);
        self.refuse_releases(out);
        let seconds = gap.as_secs_f64();
        let message = format!(
            "celld was held up for {seconds:.1} s: its process was stopped, or the computer was busy"
        );
        if !self.mode.armed() && !self.is_under_way() {
            return alarm(out, message);
        }
        self.interrupt(now, Code::HeldUp.because(message, "see what held it up"), out);
    }

    /// Nothing begins while no order could end it.
    pub(crate) fn orders_reach(&self) -> Result<(), GateClosed> {
        self.unreachable.clone().map_or(Ok(()), |fault| Err(GateClosed::Orders(fault)))
    }

    /// Something is under way that moves the arm or is about to.
    fn is_under_way(&self) -> bool {
        self.moving() || matches!(self.phase, Phase::BringUp(_)) || self.back.recovery.is_some()
    }

    /// Stops what moves and disarms; a job goes on after a new look, as often as its limit allows.
    pub(crate) fn interrupt(&mut self, now: Timestamp, reason: Reason, out: &mut Vec<Action>) {
        if self.job_outlives_a_stop() && self.mode.armed() {
            self.stop_and_keep_the_job(now, reason, out);
        } else if self.moving() || matches!(self.phase, Phase::BringUp(_)) {
            self.stop_what_has_begun(now, JobStatus::Interrupted, reason, out);
        } else {
            self.stand_down(now, reason, out);
        }
    }
}

/// What to do when orders do not reach the cell.
const RESTORE_HINT: &str = "put the state folder back or restart celld; until then the page and the emergency stop are the ways to stop";
