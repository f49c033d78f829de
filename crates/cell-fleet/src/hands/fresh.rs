//! A message on its way to a claim: whether it is free, judged, refused or set aside.
//!
//! In: the claim as it was read, the cell's verdict. Out: the next step of the hand. Pure.

use super::{Hand, Step};
use crate::payloads::{Claim, ClaimState, What, sentence};
use crate::values::{Effect, Kept, Settle};
use crate::world::World;
use cell_values::time::Duration;

/// A refused message comes again after so long, doubled with each delivery.
const REFUSED_FIRST: Duration = Duration::from_secs(5);
const REFUSED_MOST: Duration = Duration::from_secs(60);

/// A job that is not to begin yet is looked at again after so long at most.
const NOT_BEFORE_MOST: Duration = Duration::from_secs(600);

impl Hand {
    /// A message of the queue.
    pub(super) fn fresh(&mut self, world: &mut World) {
        let cancelled = world.cancelled_by(self.id()).map(str::to_string);
        let free = match &self.claim {
            None => true,
            Some((claim, _)) if !claim.job.sha256.is_empty() && claim.job.sha256 != self.entry.job.sha256 => {
                return self.same_name(world);
            }
            Some((claim, _)) => claim.state == ClaimState::Offered && claim.job.epoch == self.entry.job.epoch,
        };
        if self.is_mine(world, ClaimState::Claimed) {
            return self.note_claimed(world);
        }
        match (free, cancelled) {
            // Another cell has it, or it is over: delivered once more.
            (false, _) => {
                self.settle(world, Settle::Done);
                self.forget(world);
            }
            (true, Some(by)) => {
                let mut claim = self.new_claim(world, ClaimState::Cancelled);
                claim.cell = String::new();
                claim.reasons.insert("cancelled by".to_string(), by);
                self.write(world, claim, Step::Closing);
            }
            (true, None) => self.not_yet_or_judge(world),
        }
    }

    fn not_yet_or_judge(&mut self, world: &mut World) {
        let wait_s = self.entry.job.not_before_unix_s.unwrap_or(0.0) - world.at.unix_s;
        if wait_s > 0.0 {
            let wait = Duration::try_from_secs_f64(wait_s).unwrap_or(NOT_BEFORE_MOST).min(NOT_BEFORE_MOST);
            self.settle(world, Settle::Back(wait));
            return self.forget(world);
        }
        if self.entry.begun_here {
            let why = "this cell began the job before it was given away, and its journal knows the id";
            return self.refuse(world, format!("{why}; submit it under another id to have it done here"));
        }
        self.go(world, Step::Judging);
        world.want(Effect::Judge(Box::new(self.entry.job.clone())));
    }

    /// Another job has this id: kept under a name of its own, so that nothing is lost.
    fn same_name(&mut self, world: &mut World) {
        let hash = self.entry.job.sha256.get(..8).unwrap_or_default().to_string();
        let message = format!("there is another job {} with other content; this one is set aside", self.id());
        let code = "same_name".to_string();
        world.want(Effect::Report { job: Some(self.id().to_string()), what: What::Fault { code, message } });
        let mut claim = self.new_claim(world, ClaimState::Aside);
        claim.cell = String::new();
        claim.job.id = format!("{}.{hash}", self.id().chars().take(70).collect::<String>());
        claim.reasons.insert("the fleet".to_string(), format!("the id {} is in use", self.id()));
        self.entry.job.id.clone_from(&claim.job.id);
        self.claim = None;
        self.write(world, claim, Step::Closing);
    }

    /// The verdict of the cell.
    pub fn judged(&mut self, world: &mut World, verdict: Result<(), String>) {
        if self.step != Step::Judging {
            return;
        }
        let own = world.settings.cell.clone();
        let before = world.refusals.get(self.id()).is_some_and(|of_job| of_job.contains_key(&own));
        match verdict {
            Ok(()) if world.ready && world.connected => {
                if before {
                    world.refused(self.id(), &own, None);
                    world.want(Effect::Refuse { job: self.id().to_string(), refusal: None });
                }
                self.keep(world, Kept::Wanted, Step::Wanting);
            }
            // Not ready any more: another one may be.
            Ok(()) => {
                self.settle(world, Settle::Back(Duration::ZERO));
                self.forget(world);
            }
            Err(reason) => self.refuse(world, reason),
        }
    }

    fn refuse(&mut self, world: &mut World, reason: String) {
        let (job, epoch) = (self.id().to_string(), self.entry.job.epoch);
        let refusal = (epoch, sentence(&reason));
        world.refused(&job, &world.settings.cell.clone(), Some(refusal.clone()));
        world.want(Effect::Refuse { job, refusal: Some(refusal) });
        // Another cell may have come that could do it.
        self.go(world, Step::Refusing);
        world.want(Effect::List);
    }

    /// The cells were listed, or could not be: set aside when all that serve the job have refused it.
    pub fn listed(&mut self, world: &mut World, complete: bool) {
        if self.step != Step::Refusing {
            return;
        }
        let all = world.all_refused(self.id(), self.entry.job.epoch, &self.lane().target);
        if let Some(reasons) = all.filter(|_| complete) {
            let claim = self.new_claim(world, ClaimState::Aside);
            let claim = Claim { reasons, cell: String::new(), ..claim };
            return self.write(world, claim, Step::Closing);
        }
        let doublings = u32::try_from(self.delivered.saturating_sub(1).min(10)).unwrap_or(10);
        self.settle(world, Settle::Back((REFUSED_FIRST * 2_u32.pow(doublings)).min(REFUSED_MOST)));
        self.forget(world);
    }
}
