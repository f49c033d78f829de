//! The jobs that a cell has in hand: from a pulled message to the end that is reported to the fleet.
//!
//! In: answers to what was requested. Out: what to do next. One job at a time is pulled; the order of its
//! way is fixed: judged, noted as wanted, claimed in the bucket, noted as claimed, settled with the queue,
//! set to begun in the bucket, noted as begun, handed into the spool. Whatever is cut off on this way is
//! taken up from the own database and the claim: [`Hand::resume`] is the one place that compares them.
//! Pure.

mod fresh;
mod running;

use crate::payloads::{Claim, ClaimState, Job, What};
use crate::steward::given_on;
use crate::subjects::{Key, Lane, Priority, Target};
use crate::values::{Effect, Entry, Found, Kept, Settle, Token, Unread, Who, Written};
use crate::world::World;
use cell_values::time::{Duration, Timestamp};

/// What could not be read or written is tried again after so long.
const AGAIN: Duration = Duration::from_secs(2);

/// How often the journal is read for a job that was begun.
const LOOK_EVERY: Duration = Duration::from_millis(500);

/// How often the claim of a job that was begun is read: a person may have given it away.
const READ_EVERY: Duration = Duration::from_secs(30);

/// A message, or a claim, of another version is offered again after so long: a cell of that version may take
/// it.
pub const OTHER_VERSION: Duration = Duration::from_secs(300);

/// Where a job is on its way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// Its claim is to be read, or is being read.
    Reading,
    /// The cell judges it.
    Judging,
    /// This cell refuses it; all cells are being listed: another one may do it.
    Refusing,
    /// The own database notes that it is wanted.
    Wanting,
    /// The claim is being written.
    Claiming,
    /// The own database notes that it is claimed.
    Claimed,
    /// It waits for the cell to be ready.
    Held,
    /// The claim is being set to begun.
    Beginning,
    /// The own database notes that it is begun.
    Begun,
    /// Its claim is read once more before it goes into the spool: a person may have given it away since.
    Confirming,
    /// It is put into the spool.
    HandingIn,
    /// The journal has it.
    Running,
    /// The own database notes its end.
    Ending,
    /// Its report to the fleet is under way.
    Reporting,
    /// It goes back into the queue.
    Returning,
    /// The claim is written as cancelled or set aside.
    Closing,
    /// The own database forgets it.
    Forgetting,
    /// Nothing more to do.
    Gone,
}

/// A job in hand.
#[derive(Clone, Debug)]
pub struct Hand {
    /// As the own database has it, or will have it.
    pub entry: Entry,
    /// The own database has an entry of it.
    on_disk: bool,
    /// Its message, until settled.
    pub token: Option<Token>,
    delivered: u64,
    /// Its claim.
    claim: Option<(Claim, u64)>,
    /// Where it is.
    pub step: Step,
    /// Since when it is there.
    since: Timestamp,
    /// When it is tried again.
    again: Option<Timestamp>,
    read_at: Timestamp,
    /// When it was last ordered to be given up.
    cancelled_at: Option<Timestamp>,
    /// It was given to another cell by a person: there is nothing to report.
    given_away: bool,
}

impl Hand {
    /// A message that no version of this celld can make sense of: it is kept with the reason.
    pub fn set_aside(mut self, world: &mut World, reason: String) -> Hand {
        let mut claim = self.new_claim(world, ClaimState::Aside);
        claim.cell = String::new();
        claim.reasons.insert("the fleet".to_string(), reason);
        self.write(world, claim, Step::Closing);
        self
    }

    /// The message came once more.
    pub fn delivered_again(&mut self, world: &mut World, token: Token) {
        match self.token {
            Some(_) => self.token = Some(token),
            // It is about to be found out whose it is.
            None if self.entry.kept == Kept::Wanted => self.token = Some(token),
            None => world.want(Effect::Settle(token, Settle::Done)),
        }
    }

    /// A message that was pulled.
    pub fn pulled(job: Job, lane: &Lane, by: String, token: Token, delivered: u64) -> Hand {
        let entry = Entry {
            job,
            target: lane.target.to_string(),
            priority: lane.priority.as_str().to_string(),
            by,
            kept: Kept::Wanted,
            begun_here: false,
            outcome: None,
        };
        Hand { token: Some(token), delivered, on_disk: false, ..Hand::restored(entry) }
    }

    /// What the own database has from before a restart.
    pub fn restored(entry: Entry) -> Hand {
        let step = match entry.kept {
            Kept::Wanted | Kept::Claimed | Kept::Ended => Step::Reading,
            Kept::Begun => Step::Running,
            Kept::Closed => Step::Gone,
        };
        Hand {
            entry,
            on_disk: true,
            token: None,
            delivered: 1,
            claim: None,
            step,
            since: Timestamp::ZERO,
            again: Some(Timestamp::ZERO),
            read_at: Timestamp::ZERO,
            cancelled_at: None,
            given_away: false,
        }
    }

    /// It keeps the arm or the next pull waiting.
    pub fn is_in_the_way(&self) -> bool {
        let over = matches!(self.entry.kept, Kept::Ended | Kept::Closed);
        !over && !matches!(self.step, Step::Reporting | Step::Gone)
    }

    /// The fleet should see that this cell has it.
    pub fn is_held(&self) -> bool {
        self.step != Step::Gone && self.on_disk
    }

    /// When time alone makes a difference to it; what needs the server waits for a connection.
    pub fn wake(&self, connected: bool) -> Option<Timestamp> {
        let waits = !connected && matches!(self.step, Step::Reading | Step::Confirming);
        self.again.filter(|_| !waits)
    }

    fn id(&self) -> &str {
        &self.entry.job.id
    }

    fn go(&mut self, world: &World, step: Step) {
        self.step = step;
        self.since = world.at.now;
        self.again = None;
    }

    fn later(&mut self, world: &World, after: Duration) {
        self.again = Some(world.at.now + after);
    }

    fn settle(&mut self, world: &mut World, how: Settle) {
        if let Some(token) = self.token.take() {
            world.want(Effect::Settle(token, how));
        }
    }

    fn lane(&self) -> Lane {
        let priority = Priority::of(&self.entry.priority).unwrap_or(Priority::Normal);
        Lane { priority, target: Target::parse(&self.entry.target).unwrap_or_else(Target::any) }
    }

    fn new_claim(&self, world: &World, state: ClaimState) -> Claim {
        let (entry, cell) = (&self.entry, &world.settings.cell);
        Claim::new(entry.job.clone(), &self.lane(), &entry.by, state, cell, world.at.unix_s)
    }

    fn keep(&mut self, world: &mut World, kept: Kept, step: Step) {
        self.entry.kept = kept;
        self.on_disk = true;
        self.go(world, step);
        world.want(Effect::Keep(Box::new(self.entry.clone())));
    }

    fn write(&mut self, world: &mut World, claim: Claim, step: Step) {
        let over = self.claim.as_ref().map(|(_, revision)| *revision);
        self.go(world, step);
        world.want(Effect::Write { who: Who::Hand, claim: Box::new(claim), over });
    }

    /// Reads the claim, now or once the server answers.
    pub fn read(&mut self, world: &mut World) {
        self.go(world, Step::Reading);
        self.again = Some(world.at.now);
        self.turn(world);
    }

    /// Nothing of it is left to do here.
    fn forget(&mut self, world: &mut World) {
        if self.on_disk && self.entry.kept != Kept::Closed {
            self.keep(world, Kept::Closed, Step::Forgetting);
        } else {
            self.go(world, Step::Gone);
        }
    }

    /// The claim was read: compares it with what the own database has.
    pub fn resume(&mut self, world: &mut World, found: Found) {
        let found = match found {
            Ok(found) => found,
            // Nothing was begun: a cell of that version may make something of it.
            Err(Unread::Foreign) if self.step == Step::Reading && self.entry.kept == Kept::Wanted => {
                self.settle(world, Settle::Back(OTHER_VERSION));
                return self.forget(world);
            }
            Err(Unread::Foreign | Unread::Unanswered) => return self.later(world, AGAIN),
        };
        let found = found.map(|(claim, revision)| (*claim, revision));
        if self.step == Step::Running {
            self.claim = found;
            self.read_at = world.at.now;
            self.still_ours(world);
        } else if self.step == Step::Reading {
            self.claim = found;
            self.compare(world);
        } else if self.step == Step::Confirming {
            self.claim = found;
            self.confirmed(world);
        }
    }

    fn compare(&mut self, world: &mut World) {
        match self.entry.kept {
            Kept::Wanted if self.token.is_some() => self.fresh(world),
            Kept::Wanted if self.is_mine(world, ClaimState::Claimed) => self.note_claimed(world),
            Kept::Wanted => self.forget(world),
            Kept::Claimed => self.claimed_before(world),
            Kept::Begun => self.go(world, Step::Running),
            Kept::Ended => self.report(world),
            Kept::Closed => self.forget(world),
        }
    }

    fn is_mine(&self, world: &World, state: ClaimState) -> bool {
        let mine = |claim: &Claim| {
            claim.is_held_by(&world.settings.cell, self.entry.job.epoch) && claim.state == state
        };
        self.claim.as_ref().is_some_and(|(claim, _)| mine(claim))
    }

    fn note_claimed(&mut self, world: &mut World) {
        self.keep(world, Kept::Claimed, Step::Claimed);
    }

    /// The own database says that the claim was made.
    fn claimed_before(&mut self, world: &mut World) {
        if self.is_mine(world, ClaimState::Begun) {
            // Its answer was lost.
            self.entry.begun_here = true;
            self.keep(world, Kept::Begun, Step::Begun);
        } else if self.is_mine(world, ClaimState::Claimed) {
            self.settle(world, Settle::Done);
            self.go(world, Step::Held);
            self.turn(world);
        } else if self.claim.is_none() {
            // The server has lost what it stored.
            let claim = self.new_claim(world, ClaimState::Claimed);
            self.write(world, claim, Step::Claiming);
        } else {
            self.settle(world, Settle::Done);
            self.forget(world);
        }
    }

    /// A claim was written, or not.
    pub fn written(&mut self, world: &mut World, outcome: Written) {
        let Written::Done(revision) = outcome else {
            // What is there says how to go on.
            if !matches!(self.step, Step::Reading | Step::Gone | Step::Forgetting) {
                self.go(world, Step::Reading);
                let wait = if outcome == Written::Conflict { Duration::ZERO } else { AGAIN };
                self.later(world, wait);
            }
            return;
        };
        match self.step {
            Step::Claiming => {
                self.claim = Some((self.new_claim(world, ClaimState::Claimed), revision));
                self.note_claimed(world);
            }
            Step::Beginning => {
                self.claim = Some((self.new_claim(world, ClaimState::Begun), revision));
                self.entry.begun_here = true;
                self.keep(world, Kept::Begun, Step::Begun);
            }
            Step::Closing => {
                self.settle(world, Settle::Done);
                self.forget(world);
            }
            Step::Reporting | Step::Returning => self.forget(world),
            _ => {}
        }
    }

    /// The own database has it, or could not.
    pub fn kept_on_disk(&mut self, world: &mut World, on_disk: bool) {
        if !on_disk {
            self.later(world, AGAIN);
            return;
        }
        match self.step {
            Step::Wanting => {
                let claim = self.new_claim(world, ClaimState::Claimed);
                self.write(world, claim, Step::Claiming);
            }
            Step::Claimed => {
                self.settle(world, Settle::Done);
                self.go(world, Step::Held);
                self.turn(world);
            }
            // The claim was written or read a moment ago.
            Step::Begun if world.at.now.since(self.since) < AGAIN => self.hand_in(world),
            Step::Begun => self.confirm(world),
            Step::Ending => {
                self.go(world, Step::Reading);
                self.again = Some(world.at.now);
            }
            Step::Forgetting => self.go(world, Step::Gone),
            _ => {}
        }
    }

    /// The spool has it, or could not.
    pub fn handed_in(&mut self, world: &mut World, result: Result<(), String>) {
        if self.step != Step::HandingIn {
            return;
        }
        match result {
            Ok(()) => {
                self.go(world, Step::Running);
                self.later(world, LOOK_EVERY);
            }
            Err(message) => {
                let what = What::Fault { code: "spool".to_string(), message };
                world.want(Effect::Report { job: Some(self.id().to_string()), what });
                self.later(world, AGAIN);
            }
        }
    }

    /// Time has passed, or something in the world has changed.
    pub fn turn(&mut self, world: &mut World) {
        if self.step == Step::Held {
            return self.held(world);
        }
        if self.step == Step::Running && self.is_due_to_read(world) {
            self.read_at = world.at.now;
            world.want(Effect::Read(self.id().to_string()));
        }
        if self.again.is_none_or(|again| again > world.at.now) {
            return;
        }
        match self.step {
            Step::Reading | Step::Confirming if world.connected => {
                self.again = None;
                world.want(Effect::Read(self.id().to_string()));
            }
            Step::Running => {
                self.later(world, LOOK_EVERY);
                world.want(Effect::Look(self.id().to_string()));
            }
            Step::HandingIn => self.confirm(world),
            Step::Wanting | Step::Claimed | Step::Begun | Step::Ending | Step::Forgetting => {
                self.again = None;
                world.want(Effect::Keep(Box::new(self.entry.clone())));
            }
            _ => {}
        }
    }

    fn is_due_to_read(&self, world: &World) -> bool {
        let due = world.at.now.since(self.read_at) >= READ_EVERY;
        let announced = world.wishes.keys().any(|key| match key {
            Key::Give { job, .. } => job == self.id(),
            _ => false,
        });
        let soon = announced && world.at.now.since(self.read_at) >= AGAIN;
        world.connected && (due || soon)
    }

    /// Claimed, and not begun: begins when the cell is ready, and goes back when it is not for long.
    fn held(&mut self, world: &mut World) {
        self.again = None;
        if !world.connected {
            return;
        }
        let Some((claim, _)) = &self.claim else { return self.read(world) };
        if let Some(by) = world.cancelled_by(self.id()) {
            let reasons = [("cancelled by".to_string(), by.to_string())].into();
            let unix_s = world.at.unix_s;
            let claim = Claim { state: ClaimState::Cancelled, reasons, unix_s, ..claim.clone() };
            self.write(world, claim, Step::Returning);
        } else if world.ready {
            let claim = self.new_claim(world, ClaimState::Begun);
            self.write(world, claim, Step::Beginning);
        } else if world.at.now.since(self.since) >= world.settings.hold {
            let claim = given_on(claim, None, world.at.unix_s);
            self.write(world, claim, Step::Returning);
        } else {
            self.again = Some(self.since + world.settings.hold);
        }
    }

    /// The connection was lost or is there again: what was requested before may have been answered or not.
    pub fn reconnected(&mut self, world: &mut World) {
        self.read_at = Timestamp::ZERO;
        match self.step {
            Step::Held => {
                self.claim = None;
                self.held(world);
            }
            Step::Running => {
                self.read_at = world.at.now;
                world.want(Effect::Read(self.id().to_string()));
            }
            _ => {}
        }
    }
}
