//! What a cell does as part of a fleet, decided as a machine: inputs and time in, effects out.
//!
//! In: [`Input`]s with their moment. Out: [`Effect`]s in their order, and when to come back. It pulls only
//! while the cell is armed and idle and no job is in hand; a job's way is that of [`crate::hands`], and one
//! cell of the fleet looks after all jobs ([`crate::steward`]). Nothing here arms, resumes, recovers or
//! releases: there is no effect for it. Pure, so that seeded schedules can try it.

use crate::hands::{Hand, OTHER_VERSION, Step};
use crate::payloads::{CellState, Job, PayloadFault, What, sentence, sha256};
use crate::steward::Steward;
use crate::subjects::{Fleet, JobSubject};
use crate::values::{At, Effect, Entry, Input, Kept, Settle, Token, Who};
use crate::world::{KnownCell, Settings, World};
use cell_values::time::{Duration, Timestamp};
use std::collections::{BTreeMap, BTreeSet};

/// A message whose job is in hand under another epoch, or with other content.
const OTHER_EPOCH: Duration = Duration::from_secs(30);

/// How often the steward looks at what is to be done.
const STEWARD_EVERY: Duration = Duration::from_secs(1);

/// See the module.
pub struct Agent {
    fleet: Fleet,
    world: World,
    hands: BTreeMap<String, Hand>,
    steward: Steward,
    steward_at: Timestamp,
    /// Jobs that were begun here once: never taken again.
    past: BTreeSet<String>,
    pulling: bool,
    progress_at: Timestamp,
    complaints: BTreeMap<&'static str, String>,
}

impl Agent {
    /// An agent with what the own database has from before.
    pub fn new(fleet: Fleet, settings: Settings, entries: Vec<Entry>) -> Agent {
        let past =
            entries.iter().filter(|entry| entry.begun_here).map(|entry| entry.job.id.clone()).collect();
        let open = entries.into_iter().filter(|entry| entry.kept != Kept::Closed);
        let hands = open.map(|entry| (entry.job.id.clone(), Hand::restored(entry))).collect();
        Agent {
            fleet,
            world: World::new(settings),
            hands,
            steward: Steward::default(),
            steward_at: Timestamp::ZERO,
            past,
            pulling: false,
            progress_at: Timestamp::ZERO,
            complaints: BTreeMap::new(),
        }
    }

    /// Jobs that it has in hand, for the cell's state.
    pub fn holds(&self) -> Vec<String> {
        self.hands.iter().filter(|(_, hand)| hand.is_held()).map(|(job, _)| job.clone()).collect()
    }

    /// It has begun the job, as one of the fleet.
    pub fn has_begun(&self, job: &str) -> bool {
        self.past.contains(job) || self.hands.get(job).is_some_and(|hand| hand.entry.begun_here)
    }

    /// What is wrong with messages it came across.
    pub fn complaints(&self) -> Vec<String> {
        self.complaints.values().cloned().collect()
    }

    /// The next thing to do.
    pub fn poll(&mut self) -> Option<Effect> {
        self.world.effects.pop_front()
    }

    /// When time alone makes a difference.
    pub fn next_wake(&self) -> Timestamp {
        let hands = self.hands.values().filter_map(|hand| hand.wake(self.world.connected)).min();
        let steward = self.steward_at + STEWARD_EVERY;
        hands.map_or(steward, |hands| hands.min(steward))
    }

    /// Takes something in.
    pub fn handle(&mut self, at: At, input: Input) {
        self.world.at = at;
        match input {
            Input::Time => {}
            Input::Connected => self.connected(),
            Input::Disconnected => {
                self.world.connected = false;
                self.pulling = false;
            }
            Input::Ready(ready) => self.world.ready = ready,
            Input::Pulled { token, subject, sequence, delivered, payload } => {
                self.pulled(token, &subject, sequence, delivered, &payload);
            }
            Input::Published { job, stored } => self.steward.published(&mut self.world, &job, stored),
            Input::Written { who: Who::Steward, job, .. } => self.steward.written(&job),
            Input::Claim { claim, revision, unix_s } => self.steward.claim(*claim, revision, unix_s),
            Input::ClaimsKnown => self.steward.complete(),
            Input::Cell { name, state, unix_s } => {
                match state {
                    Some(state) => self.world.members.insert(name, KnownCell { state: *state, unix_s }),
                    None => self.world.members.remove(&name),
                };
            }
            Input::Cells(cells) => self.listed(cells),
            Input::Wish { key, wish } => {
                match wish {
                    Some(wish) => self.world.wishes.insert(key, wish),
                    None => self.world.wishes.remove(&key),
                };
            }
            Input::Refused { job, cell, refusal } => self.world.refused(&job, &cell, refusal),
            of_hand => self.for_hand(of_hand),
        }
        self.turn();
    }

    fn listed(&mut self, cells: Option<Vec<(String, CellState, f64)>>) {
        // A server that stalls and one that has nothing look alike; the own state is there.
        let own = &self.world.settings.cell;
        let cells = cells.filter(|cells| cells.iter().any(|(name, ..)| name == own));
        let complete = cells.is_some();
        if let Some(cells) = cells {
            self.world.list(cells);
        }
        self.steward.listed(&mut self.world, complete);
        for hand in self.hands.values_mut() {
            hand.listed(&mut self.world, complete);
        }
    }

    fn for_hand(&mut self, input: Input) {
        let world = &mut self.world;
        match input {
            Input::Read { job, found } => self.hands.get_mut(&job).map(|hand| hand.resume(world, found)),
            Input::Judged { job, verdict } => {
                self.hands.get_mut(&job).map(|hand| hand.judged(world, verdict))
            }
            Input::Written { job, outcome, .. } => {
                self.hands.get_mut(&job).map(|hand| hand.written(world, outcome))
            }
            Input::Kept { job, on_disk } => {
                self.hands.get_mut(&job).map(|hand| hand.kept_on_disk(world, on_disk))
            }
            Input::HandedIn { job, result } => {
                self.hands.get_mut(&job).map(|hand| hand.handed_in(world, result))
            }
            Input::Local { job, state } => self.hands.get_mut(&job).map(|hand| hand.local(world, state)),
            _ => None,
        };
    }

    fn connected(&mut self) {
        self.world.connected = true;
        self.pulling = false;
        self.steward.reconnected(&self.world);
        self.steward_at = Timestamp::ZERO;
        for hand in self.hands.values_mut() {
            hand.reconnected(&mut self.world);
        }
    }

    fn pulled(&mut self, token: Token, subject: &str, sequence: u64, delivered: u64, payload: &[u8]) {
        self.pulling = false;
        let read = self.fleet.read_job(subject);
        let JobSubject { lane, by } = match read {
            Ok(read) => read,
            Err(fault) => return self.leave(token, "subject", fault.to_string()),
        };
        let job = match Job::read(payload) {
            Ok(job) => job,
            Err(fault @ (PayloadFault::Version { .. } | PayloadFault::TooLarge { .. })) => {
                return self.leave(token, "payload", format!("message {sequence} of {subject}: {fault}"));
            }
            Err(fault) => {
                let text = sentence(&String::from_utf8_lossy(payload));
                let job =
                    Job { sha256: sha256(&text), ..Job::new(&format!("message-{sequence}"), &text, 0.0) };
                let hand = Hand::pulled(job, &lane, by, token, delivered);
                let hand = hand.set_aside(&mut self.world, fault.to_string());
                self.hands.insert(hand.entry.job.id.clone(), hand);
                return;
            }
        };
        if let Some(hand) = self.hands.get_mut(&job.id) {
            // Another one under this id is set aside once this one is out of hand.
            match hand.entry.job.epoch == job.epoch && hand.entry.job.sha256 == job.sha256 {
                true => hand.delivered_again(&mut self.world, token),
                false => self.world.want(Effect::Settle(token, Settle::Back(OTHER_EPOCH))),
            }
            return;
        }
        if !self.wants_work() {
            return self.world.want(Effect::Settle(token, Settle::Back(Duration::ZERO)));
        }
        let mut hand = Hand::pulled(job, &lane, by, token, delivered);
        hand.entry.begun_here = self.past.contains(&hand.entry.job.id);
        hand.read(&mut self.world);
        self.hands.insert(hand.entry.job.id.clone(), hand);
    }

    /// Another cell may make something of it.
    fn leave(&mut self, token: Token, about: &'static str, message: String) {
        if self.complaints.get(about) != Some(&message) {
            let what = What::Fault { code: format!("foreign_{about}"), message: message.clone() };
            self.world.want(Effect::Report { job: None, what });
            self.complaints.insert(about, message);
        }
        self.world.want(Effect::Settle(token, Settle::Back(OTHER_VERSION)));
    }

    /// A job that is set aside under a name of its own is found by it from then on: answers come to that.
    fn rename(&mut self) {
        let renamed = self.hands.iter().find(|(key, hand)| **key != hand.entry.job.id);
        if let Some(hand) = renamed.map(|(key, _)| key.clone()).and_then(|key| self.hands.remove(&key)) {
            self.hands.insert(hand.entry.job.id.clone(), hand);
        }
    }

    fn wants_work(&self) -> bool {
        let free = !self.hands.values().any(Hand::is_in_the_way);
        self.world.connected && self.world.ready && free
    }

    fn turn(&mut self) {
        let now = self.world.at.now;
        for hand in self.hands.values_mut() {
            hand.turn(&mut self.world);
        }
        self.rename();
        let (gone, past) = (&mut self.hands, &mut self.past);
        gone.retain(|job, hand| {
            if hand.entry.begun_here {
                past.insert(job.clone());
            }
            hand.step != Step::Gone
        });
        if now.since(self.steward_at) >= STEWARD_EVERY || self.steward_at == Timestamp::ZERO {
            self.steward_at = now;
            self.steward.turn(&mut self.world);
        }
        if now.since(self.progress_at) >= self.world.settings.ack_wait / 3 {
            self.progress_at = now;
            let open = self.hands.values().filter_map(|hand| hand.token);
            let progress: Vec<Effect> = open.map(|token| Effect::Settle(token, Settle::Progress)).collect();
            self.world.effects.extend(progress);
        }
        let wanted = self.wants_work();
        if wanted != self.pulling {
            self.pulling = wanted;
            self.world.want(Effect::Pull(wanted));
        }
    }
}
