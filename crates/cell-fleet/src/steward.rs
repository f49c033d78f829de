//! Looks after the jobs of the whole fleet, on the one cell that is its steward.
//!
//! In: all claims as they change, the world. Out: compare-and-sets. A job that was claimed by a cell that is
//! away, and not begun, goes back into the queue with the next epoch; so does any job that a person gives
//! away, which alone moves one that was begun: its objects lie on *that* table. A job whose claim says that
//! it is offered and not queued is queued. What a person cancelled before a cell has it is closed. A steward
//! that ends in the midst of this leaves a claim from which the next one goes on. Pure.

use crate::payloads::{Claim, ClaimState, Job, VERSION, Wish};
use crate::subjects::{Key, Lane, Priority, Target};
use crate::succession::Succession;
use crate::values::{Effect, Who};
use crate::world::World;
use std::collections::{BTreeMap, BTreeSet};

/// A cell that was seen so much later than it claimed a job, and does not name that job among those it
/// holds, has lost it.
const LOST_S: f64 = 15.0;

#[derive(Clone, Debug)]
struct Known {
    claim: Claim,
    revision: u64,
    unix_s: f64,
}

/// What the steward knows.
#[derive(Default)]
pub struct Steward {
    /// Which cell is it.
    succession: Succession,
    /// This cell is it.
    on: bool,
    /// All claims that there were have come.
    complete: bool,
    claims: BTreeMap<String, Known>,
    /// Jobs for which an answer is awaited.
    busy: BTreeSet<String>,
}

impl Steward {
    /// A claim as it is now.
    pub fn claim(&mut self, claim: Claim, revision: u64, unix_s: f64) {
        let job = claim.job.id.clone();
        if self.claims.get(&job).is_none_or(|known| known.revision < revision) {
            self.claims.insert(job, Known { claim, revision, unix_s });
        }
    }

    /// The cells were listed, or could not be.
    pub fn listed(&mut self, world: &mut World, complete: bool) {
        self.succession.listed(world, complete);
        self.turn(world);
    }

    /// The connection is another one: all that was followed ended with the one before.
    pub fn reconnected(&mut self, world: &World) {
        *self = Steward { succession: std::mem::take(&mut self.succession), ..Steward::default() };
        self.succession.reconnected(world);
    }

    /// All have come.
    pub fn complete(&mut self) {
        self.complete = self.on;
    }

    /// An answer came to a write; the claim itself comes by the watch.
    pub fn written(&mut self, job: &str) {
        self.busy.remove(job);
    }

    /// A message was put into a queue: the claim says so then, and else it is tried again.
    pub fn published(&mut self, world: &mut World, job: &str, stored: bool) {
        self.busy.remove(job);
        let Some(known) = self.claims.get(job).filter(|known| stored && offered(&known.claim)) else {
            return;
        };
        let claim = Claim { queued: true, ..known.claim.clone() };
        self.write(world, claim, Some(known.revision));
    }

    /// Looks at what is to be done.
    pub fn turn(&mut self, world: &mut World) {
        let on = self.succession.turn(world);
        if on != self.on {
            *self = Steward { on, succession: std::mem::take(&mut self.succession), ..Steward::default() };
            world.want(Effect::Follow(on));
        }
        if !self.complete {
            return;
        }
        self.grant_wishes(world);
        // Most claims are over or begun, and there are as many as the fleet had jobs in three months.
        let concerns = |(job, known): &(&String, &Known)| {
            !self.busy.contains(*job) && needs_a_look(world, job, &known.claim)
        };
        let concerned: Vec<Known> = self.claims.iter().filter(concerns).map(|(_, k)| k.clone()).collect();
        for known in concerned {
            self.look_after(world, &known);
        }
    }

    fn look_after(&mut self, world: &mut World, known: &Known) {
        let Known { claim, revision, .. } = known;
        let job = &claim.job.id;
        if offered(claim) {
            self.busy.insert(job.clone());
            world.want(Effect::Publish(Box::new(claim.clone())));
        } else if claim.state == ClaimState::Claimed
            && self.succession.is_settled(world)
            && is_stranded(world, claim, known.unix_s)
        {
            let next = given_on(claim, None, world.at.unix_s);
            self.write(world, next, Some(*revision));
        } else if over(claim) {
            self.tidy(world, job);
        }
    }

    /// Small keys of a job that is over are of no use.
    fn tidy(&mut self, world: &mut World, job: &str) {
        let wishes: Vec<Key> = world.wishes.keys().filter(|key| cancels(key, job)).cloned().collect();
        let refusals = world.refusals.remove(job).unwrap_or_default();
        let refusals = refusals.into_keys().map(|cell| Key::Refusal { job: job.to_string(), cell });
        for key in wishes.into_iter().chain(refusals) {
            world.wishes.remove(&key);
            world.want(Effect::Remove(key));
        }
    }

    fn grant_wishes(&mut self, world: &mut World) {
        for (key, wish) in world.wishes.clone() {
            match &key {
                Key::Give { job, by } if !self.busy.contains(job) => self.give(world, &key, job, by, &wish),
                Key::Cancel { job, by } if !self.busy.contains(job) => self.cancel(world, job, by),
                _ => {}
            }
        }
    }

    fn give(&mut self, world: &mut World, key: &Key, job: &str, by: &str, wish: &Wish) {
        let known = self.claims.get(job).filter(|known| can_be_given(&known.claim, wish));
        let target = wish.target.as_deref().map(Target::parse);
        match (known, target.clone()) {
            (Some(known), None | Some(Some(_))) => {
                let revision = known.revision;
                let mut next = given_on(&known.claim, target.flatten(), world.at.unix_s);
                next.reasons = [("given by".to_string(), by.to_string())].into();
                self.write(world, next, Some(revision));
            }
            // Done already, or not what the person saw.
            _ => {
                world.wishes.remove(key);
                world.want(Effect::Remove(key.clone()));
            }
        }
    }

    /// A job that no cell has is closed; one that a cell has is given up there.
    fn cancel(&mut self, world: &mut World, job: &str, by: &str) {
        let reasons: BTreeMap<String, String> = [("cancelled by".to_string(), by.to_string())].into();
        match self.claims.get(job) {
            Some(Known { claim, revision, .. })
                if matches!(claim.state, ClaimState::Offered | ClaimState::Aside) =>
            {
                let unix_s = world.at.unix_s;
                let claim = Claim { state: ClaimState::Cancelled, reasons, unix_s, ..claim.clone() };
                let revision = *revision;
                self.write(world, claim, Some(revision));
            }
            Some(_) => {}
            None => {
                let claim = Claim { reasons, ..tombstone(job, world.at.unix_s) };
                self.write(world, claim, None);
            }
        }
    }

    fn write(&mut self, world: &mut World, claim: Claim, over: Option<u64>) {
        self.busy.insert(claim.job.id.clone());
        world.want(Effect::Write { who: Who::Steward, claim: Box::new(claim), over });
    }
}

fn cancels(key: &Key, job: &str) -> bool {
    match key {
        Key::Cancel { job: of, .. } => of == job,
        Key::Claim { .. } | Key::Refusal { .. } | Key::Give { .. } => false,
    }
}

/// There may be something to do about a claim.
fn needs_a_look(world: &World, job: &str, claim: &Claim) -> bool {
    match claim.state {
        ClaimState::Offered => !claim.queued,
        ClaimState::Claimed => true,
        ClaimState::Ended | ClaimState::Cancelled => {
            world.refusals.contains_key(job) || world.wishes.keys().any(|key| cancels(key, job))
        }
        ClaimState::Begun | ClaimState::Aside => false,
    }
}

fn offered(claim: &Claim) -> bool {
    claim.state == ClaimState::Offered && !claim.queued
}

fn over(claim: &Claim) -> bool {
    matches!(claim.state, ClaimState::Ended | ClaimState::Cancelled)
}

/// In a queue or in a cell's hands there is nothing to give but what the person saw; a job that was done is
/// not done again under its name.
fn can_be_given(claim: &Claim, wish: &Wish) -> bool {
    let has_text = !claim.job.text.is_empty();
    let moved = matches!(claim.state, ClaimState::Begun | ClaimState::Ended);
    let of_this_epoch = claim.job.epoch == wish.epoch && (wish.begun || !moved);
    of_this_epoch && has_text && claim.state != ClaimState::Cancelled
}

/// The holder of a claim is away, or lives and does not know of it.
pub fn is_stranded(world: &World, claim: &Claim, unix_s: f64) -> bool {
    let away_s = world.settings.away.as_secs_f64();
    match world.members.get(&claim.cell) {
        _ if world.at.unix_s - unix_s <= LOST_S => false,
        None => world.at.unix_s - unix_s > away_s,
        Some(member) => {
            let forgotten = member.unix_s - unix_s > LOST_S && !member.state.holds.contains(&claim.job.id);
            world.is_away(&claim.cell) || forgotten
        }
    }
}

/// The claim with the next epoch, free for the next cell.
pub fn given_on(claim: &Claim, target: Option<Target>, unix_s: f64) -> Claim {
    let epoch = claim.job.epoch.saturating_add(1);
    let target = target.map_or_else(|| claim.target.clone(), |target| target.to_string());
    Claim {
        job: Job { epoch, ..claim.job.clone() },
        target,
        state: ClaimState::Offered,
        queued: false,
        unix_s,
        outcome: None,
        reasons: BTreeMap::new(),
        ..claim.clone()
    }
}

/// A claim of a job that was cancelled before anything else was known of it: its message, when it comes, is
/// done with.
fn tombstone(job: &str, unix_s: f64) -> Claim {
    let job = Job {
        version: VERSION,
        id: job.to_string(),
        sha256: String::new(),
        text: String::new(),
        epoch: 1,
        submitted_unix_s: unix_s,
        not_before_unix_s: None,
        campaign: None,
    };
    let lane = Lane { priority: Priority::Normal, target: Target::any() };
    Claim::new(job, &lane, "", ClaimState::Cancelled, "", unix_s)
}
