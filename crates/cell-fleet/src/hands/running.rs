//! A job that was begun, until the fleet knows its end.
//!
//! In: what the journal says, the claim as it is read now and then. Out: the next step of the hand. Pure.

use super::{Hand, LOOK_EVERY, Step};
use crate::payloads::{Claim, ClaimState, Outcome, What};
use crate::values::{Effect, Kept, Local};
use crate::world::World;
use cell_values::time::Duration;

/// A job that goes on although it was ordered to be given up is ordered so again after this: the order may
/// have come before the cell knew the job, or before it took orders.
const CANCEL_AGAIN: Duration = Duration::from_secs(5);

impl Hand {
    /// What the journal says.
    pub fn local(&mut self, world: &mut World, state: Local) {
        if self.step != Step::Running {
            return;
        }
        match state {
            Local::Unknown if self.given_away => self.forget(world),
            Local::Unknown => self.confirm(world),
            Local::Open => {
                self.order_cancel(world);
                self.later(world, LOOK_EVERY);
            }
            Local::Ended(outcome) => self.ended(world, outcome),
        }
    }

    fn ended(&mut self, world: &mut World, outcome: Outcome) {
        let what = What::Done { outcome: outcome.clone() };
        world.want(Effect::Report { job: Some(self.id().to_string()), what });
        self.entry.outcome = Some(outcome);
        let kept = if self.given_away { Kept::Closed } else { Kept::Ended };
        let step = if self.given_away { Step::Forgetting } else { Step::Ending };
        self.keep(world, kept, step);
    }

    /// A job that runs here was cancelled, or given to another cell by a person.
    fn order_cancel(&mut self, world: &mut World) {
        let by = match self.given_away {
            true => Some("the fleet, which gave it to another cell".to_string()),
            false => world.cancelled_by(self.id()).map(str::to_string),
        };
        let now = world.at.now;
        let due = self.cancelled_at.is_none_or(|at| now.since(at) >= CANCEL_AGAIN);
        if let Some(by) = by.filter(|_| due) {
            self.cancelled_at = Some(now);
            world.want(Effect::Cancel { job: self.id().to_string(), by });
        }
    }

    /// Into the spool, the claim being this cell's a moment ago.
    pub(super) fn hand_in(&mut self, world: &mut World) {
        self.go(world, Step::HandingIn);
        world.want(Effect::HandIn(Box::new(self.entry.job.clone())));
    }

    /// Begun, and in neither spool nor journal: nothing has moved, and a person may have given it to another
    /// cell since. Without the network it waits.
    pub(super) fn confirm(&mut self, world: &mut World) {
        self.go(world, Step::Confirming);
        self.again = Some(world.at.now);
    }

    /// The claim was read; none means that the server has lost what it stored.
    pub(super) fn confirmed(&mut self, world: &mut World) {
        if self.claim.is_none() || self.is_mine(world, ClaimState::Begun) {
            return self.hand_in(world);
        }
        let message = "a person gave the job to another cell before it went into the spool here".to_string();
        let what = What::Fault { code: "given_away".to_string(), message };
        world.want(Effect::Report { job: Some(self.id().to_string()), what });
        self.forget(world);
    }

    /// The claim of a job that runs here was read.
    pub(super) fn still_ours(&mut self, world: &mut World) {
        let others =
            |claim: &Claim| claim.job.epoch != self.entry.job.epoch || claim.cell != world.settings.cell;
        let lost = self.claim.as_ref().is_some_and(|(claim, _)| others(claim));
        if lost && !self.given_away {
            self.given_away = true;
            let message = "a person gave the job to another cell; it is given up here".to_string();
            let what = What::Fault { code: "given_away".to_string(), message };
            world.want(Effect::Report { job: Some(self.id().to_string()), what });
        }
        self.order_cancel(world);
    }

    /// Reports to the fleet how it ended.
    pub(super) fn report(&mut self, world: &mut World) {
        // Also to a server that has lost what it stored.
        let epoch = self.entry.job.epoch;
        let held = |claim: &Claim| claim.is_held_by(&world.settings.cell, epoch);
        if !self.claim.as_ref().is_none_or(|(claim, _)| held(claim)) {
            return self.forget(world);
        }
        let outcome = self.entry.outcome.clone();
        let done = outcome.as_ref().is_some_and(|outcome| outcome.status == "done");
        let mut claim = Claim { outcome, ..self.new_claim(world, ClaimState::Ended) };
        if done {
            claim.job.text.clear();
        }
        self.write(world, claim, Step::Reporting);
    }
}
