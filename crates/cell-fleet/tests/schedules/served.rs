//! The server of the fleet in virtual time: a work queue, claims that are compared and set, watches.
//!
//! In: requests as they arrive. Out: answers, and what goes to every cell that follows.

use super::{ACK_WAIT_MS, Cell, Message, Request, SimEvent, TIMEOUT_MS, World};
use cell_fleet::payloads::{CellState, Claim, ClaimState, Job, encode};
use cell_fleet::subjects::{Key, Lane, Priority, Target};
use cell_fleet::values::{Input, Settle, Unread, Written};
use rand::RngExt;

impl World {
    pub(super) fn send(&mut self, cell: usize, request: Request) {
        let delay = if self.rng.random_bool(0.02) { self.between(0, 3000) } else { self.between(0, 30) };
        let here = &mut self.cells[cell];
        let process = here.process;
        let answer = lost_answer(&request);
        let Some(connection) = here.connection else {
            if let Some(input) = answer {
                let ms = self.now + 1;
                self.at(ms, SimEvent::Received { cell, process, connection: None, input });
            }
            return;
        };
        here.sent = here.sent.max(self.now + delay);
        let ms = here.sent;
        self.at(ms, SimEvent::Arrives { cell, connection, request });
    }

    pub(super) fn arrives(&mut self, cell: usize, connection: u64, request: Request) {
        let process = self.cells[cell].process;
        let joined = self.cells[cell].connection == Some(connection);
        let answer = lost_answer(&request);
        // What was in the sockets when a connection ended may still be carried out.
        let carried_out = self.up && (joined || self.rng.random_bool(0.5));
        let given = if carried_out { self.serve(cell, joined, request) } else { None };
        let Some(lost) = answer else { return };
        match given.filter(|_| joined) {
            Some(input) => self.receives(cell, input),
            None => {
                let ms = self.now + TIMEOUT_MS;
                self.at(ms, SimEvent::Received { cell, process, connection: None, input: lost });
            }
        }
    }

    pub(super) fn serve(&mut self, cell: usize, joined: bool, request: Request) -> Option<Input> {
        match request {
            Request::Pull(on) => {
                self.cells[cell].pulls = on && joined;
                self.deliver();
            }
            Request::Settle(sequence, how) => self.settled(sequence, &how),
            Request::Read(job) => {
                let found =
                    self.claims.get(&job).map(|(claim, revision, _)| (Box::new(claim.clone()), *revision));
                return Some(Input::Read { job, found: Ok(found) });
            }
            Request::Write { who, claim, over } => {
                let (job, outcome) = (claim.job.id.clone(), self.write(*claim, over));
                return Some(Input::Written { who, job, outcome });
            }
            Request::Publish(claim) => {
                let lane = claim.lane().expect("a lane");
                self.publish(&claim.job, &lane);
                return Some(Input::Published { job: claim.job.id, stored: true });
            }
            Request::Refuse { job, refusal } => {
                let from = self.cells[cell].name.clone();
                match refusal.clone() {
                    Some(refusal) => self.refusals.insert((job.clone(), from.clone()), refusal),
                    None => self.refusals.remove(&(job.clone(), from.clone())),
                };
                self.broadcast(&Input::Refused { job, cell: from, refusal });
            }
            Request::Remove(key) => {
                if let Key::Refusal { job, cell } = &key {
                    self.refusals.remove(&(job.clone(), cell.clone()));
                }
                self.wishes.remove(&key);
                self.broadcast(&Input::Wish { key, wish: None });
            }
            Request::Follow(on) => {
                self.cells[cell].follows = on;
                if on {
                    self.follow(cell);
                }
            }
            Request::Watch(name) => self.watch(cell, name),
            // A server that stalls has nothing, or breaks off.
            Request::List if self.rng.random_bool(0.05) => return Some(Input::Cells(Some(Vec::new()))),
            Request::List if self.rng.random_bool(0.05) => return Some(Input::Cells(None)),
            Request::List => {
                let cell = |(name, (state, ms)): (&String, &(CellState, u64))| {
                    (name.clone(), state.clone(), *ms as f64 / 1e3)
                };
                return Some(Input::Cells(Some(self.states.iter().map(cell).collect())));
            }
            Request::State(state) => self.show(cell, *state),
        }
        None
    }

    /// Names of the cells that follow all others.
    pub fn follow_all(&self) -> Vec<&str> {
        self.cells.iter().filter(|cell| cell.follows).map(|cell| cell.name.as_str()).collect()
    }

    /// Names of the cells that follow one, each with that one's.
    pub fn follow_one(&self) -> Vec<(&str, &str)> {
        let following = self.cells.iter().filter(|cell| cell.watches.is_some());
        following.map(|cell| (cell.name.as_str(), cell.watches.as_deref().unwrap_or_default())).collect()
    }

    fn watch(&mut self, cell: usize, name: Option<String>) {
        self.cells[cell].watches.clone_from(&name);
        if let Some((name, (state, ms))) = name.and_then(|name| self.states.get_key_value(&name)) {
            let (name, state) = (name.clone(), Some(Box::new(state.clone())));
            let unix_s = *ms as f64 / 1e3;
            self.receives(cell, Input::Cell { name, state, unix_s });
        }
    }

    fn show(&mut self, cell: usize, state: CellState) {
        let name = self.cells[cell].name.clone();
        self.states.insert(name.clone(), (state.clone(), self.now));
        self.followers_receive(&name, Some(state));
    }

    /// The state of a cell, or that it was taken out, goes to who follows it.
    pub(super) fn followers_receive(&mut self, name: &str, state: Option<CellState>) {
        let unix_s = self.now as f64 / 1e3;
        let input = Input::Cell { name: name.to_string(), state: state.map(Box::new), unix_s };
        for other in 0..self.cells.len() {
            let here = &self.cells[other];
            let sees = here.follows || here.name == name || here.watches.as_deref() == Some(name);
            if sees && here.connection.is_some() {
                self.receives(other, input.clone());
            }
        }
    }

    fn settled(&mut self, sequence: u64, how: &Settle) {
        match how {
            Settle::Done => drop(self.messages.remove(&sequence)),
            Settle::Back(after) => {
                let due = self.now + u64::try_from(after.as_millis()).unwrap_or(0);
                self.due(sequence, due);
                self.deliver();
            }
            Settle::Progress => {
                let due = self.now + ACK_WAIT_MS;
                self.due(sequence, due);
            }
        }
    }

    fn due(&mut self, sequence: u64, due: u64) {
        if let Some(message) = self.messages.get_mut(&sequence) {
            message.due = due;
        }
    }

    pub(super) fn follow(&mut self, cell: usize) {
        for (name, (state, ms)) in self.states.clone() {
            let unix_s = ms as f64 / 1e3;
            self.receives(cell, Input::Cell { name, state: Some(Box::new(state)), unix_s });
        }
        for (claim, revision, ms) in self.claims.values().cloned().collect::<Vec<_>>() {
            let unix_s = ms as f64 / 1e3;
            self.receives(cell, Input::Claim { claim: Box::new(claim), revision, unix_s });
        }
        self.receives(cell, Input::ClaimsKnown);
    }

    fn write(&mut self, claim: Claim, over: Option<u64>) -> Written {
        let job = claim.job.id.clone();
        if self.claims.get(&job).map(|(_, revision, _)| *revision) != over {
            return Written::Conflict;
        }
        if claim.state == ClaimState::Begun {
            self.begun.push((job.clone(), claim.job.epoch, claim.cell.clone()));
        }
        self.counter += 1;
        let revision = self.counter;
        self.claims.insert(job, (claim.clone(), revision, self.now));
        let input = Input::Claim { claim: Box::new(claim), revision, unix_s: self.now as f64 / 1e3 };
        for cell in 0..self.cells.len() {
            if self.cells[cell].follows && self.cells[cell].connection.is_some() {
                self.receives(cell, input.clone());
            }
        }
        Written::Done(revision)
    }

    pub(super) fn submit(&mut self, number: usize) {
        if !self.up {
            let again = self.now + 1000;
            return self.at(again, SimEvent::Submit(number));
        }
        let target = match number % 4 {
            1 => Target::Label("even".into()),
            2 => Target::Cell(format!("c{}", number % self.plan.cells)),
            _ => Target::any(),
        };
        let target = if number % 10 == 3 { Target::any() } else { target };
        // A cell that never comes back would keep its jobs.
        let target = if self.plan.dead > 0 { Target::any() } else { target };
        let lane = Lane { priority: Priority::ALL[number % 3], target };
        let mut job = Job::new(&format!("job-{number}"), "text", 0.0);
        job.not_before_unix_s = (number % 11 == 5).then_some(self.now as f64 / 1e3 + 100.0);
        // Submitted twice now and then, when an answer was lost, the second time beyond the server's memory.
        self.publish(&job, &lane);
        if self.rng.random_bool(0.1) {
            self.seen.remove(&job.message_id());
            self.publish(&job, &lane);
        }
    }

    fn publish(&mut self, job: &Job, lane: &Lane) {
        if !self.seen.insert(job.message_id()) {
            return;
        }
        self.counter += 1;
        let (sequence, due) = (self.counter, self.now);
        let (subject, payload) = (self.fleet.job(lane, "anna"), encode(job).expect("a job"));
        self.messages.insert(sequence, Message { sequence, subject, payload, due, delivered: 0 });
        self.deliver();
    }

    /// Each message that is due goes to a cell that pulls and serves its lane.
    pub(super) fn deliver(&mut self) {
        if !self.up {
            return;
        }
        let due: Vec<u64> =
            self.messages.values().filter(|m| m.due <= self.now).map(|m| m.sequence).collect();
        for sequence in due {
            let lane = self.fleet.read_job(&self.messages[&sequence].subject).expect("a subject").lane;
            let serves = |cell: &Cell| {
                cell.pulls && cell.connection.is_some() && lane.target.includes(&cell.name, &cell.labels)
            };
            let takers: Vec<usize> = (0..self.cells.len()).filter(|c| serves(&self.cells[*c])).collect();
            if takers.is_empty() {
                continue;
            }
            let taker = takers[self.rng.random_range(0..takers.len())];
            // As with several lanes pulled at once, two may arrive before the cell says stop.
            if self.rng.random_bool(0.9) {
                self.cells[taker].pulls = false;
            }
            let Some(message) = self.messages.get_mut(&sequence) else { continue };
            message.due = self.now + ACK_WAIT_MS;
            message.delivered += 1;
            let input = Input::Pulled {
                token: sequence,
                subject: message.subject.clone(),
                sequence,
                delivered: message.delivered,
                payload: message.payload.clone(),
            };
            self.receives(taker, input);
        }
    }
}

/// What comes back for a request that got no answer; nothing where none is awaited.
fn lost_answer(request: &Request) -> Option<Input> {
    match request {
        Request::Read(job) => Some(Input::Read { job: job.clone(), found: Err(Unread::Unanswered) }),
        Request::Write { who, claim, .. } => {
            Some(Input::Written { who: *who, job: claim.job.id.clone(), outcome: Written::Unknown })
        }
        Request::Publish(claim) => Some(Input::Published { job: claim.job.id.clone(), stored: false }),
        Request::List => Some(Input::Cells(None)),
        _ => None,
    }
}
