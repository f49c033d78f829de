//! What goes wrong in a fleet in virtual time, and what a person does about it.
//!
//! In: a plan of troubles, the seed. Out: crashes, cuts, disarming, cancellations, at times of their own.

use super::{SimEvent, World};
use cell_fleet::payloads::{Claim, ClaimState, VERSION, Wish};
use cell_fleet::subjects::Key;
use rand::RngExt;
use std::collections::BTreeSet;

impl World {
    /// The troubles of the first ten minutes.
    pub(super) fn schedule(&mut self) {
        let plan = self.plan;
        for cell in 0..plan.cells {
            self.at(1, SimEvent::Start(cell));
        }
        for job in 0..plan.jobs {
            let ms = self.between(1, 300_000);
            self.at(ms, SimEvent::Submit(job));
        }
        let some = |world: &mut World| world.rng.random_range(0..plan.cells);
        for index in 0..plan.crashes {
            let (cell, ms) = (some(self), self.between(1000, 600_000));
            self.at(ms, SimEvent::Crash(cell));
            if index >= plan.dead {
                let back = ms + self.between(100, 120_000);
                self.at(back, SimEvent::Start(cell));
            }
        }
        for _ in 0..plan.server_crashes {
            let ms = self.between(1000, 600_000);
            self.at(ms, SimEvent::ServerDown);
            let up = ms + self.between(100, 30_000);
            self.at(up, SimEvent::ServerUp);
        }
        for _ in 0..plan.cuts {
            let (cell, ms) = (some(self), self.between(1000, 600_000));
            self.at(ms, SimEvent::Cut(cell));
            let joined = ms + self.between(100, 180_000);
            self.at(joined, SimEvent::Join(cell));
        }
        for _ in 0..plan.disarms {
            let (cell, ms) = (some(self), self.between(1000, 600_000));
            self.at(ms, SimEvent::Arm(cell, false));
            let armed = ms + self.between(100, 200_000);
            self.at(armed, SimEvent::Arm(cell, true));
        }
        for _ in 0..plan.cancels {
            let (job, ms) = (self.rng.random_range(0..plan.jobs), self.between(1, 400_000));
            let key = Key::Cancel { job: format!("job-{job}"), by: "anna".into() };
            self.at(ms, SimEvent::Wished(key, wish(0)));
        }
        self.at(1, SimEvent::Deliver);
    }

    pub(super) fn disturbance(&mut self, disturbance: SimEvent) {
        match disturbance {
            SimEvent::Crash(cell) => {
                self.disconnect(cell);
                self.cells[cell].agent = None;
                self.cells[cell].process += 1;
            }
            SimEvent::Start(cell) if self.cells[cell].agent.is_none() => self.start(cell),
            SimEvent::Cut(cell) => self.disconnect(cell),
            SimEvent::Join(cell) => self.connect(cell),
            SimEvent::ServerDown => {
                self.up = false;
                (0..self.cells.len()).for_each(|cell| self.disconnect(cell));
            }
            SimEvent::ServerUp => {
                self.up = true;
                (0..self.cells.len()).for_each(|cell| self.connect(cell));
            }
            SimEvent::Arm(cell, armed) => {
                self.cells[cell].armed = armed;
                self.state(cell);
            }
            _ => {}
        }
    }

    /// A person gives away what a cell has begun that does not come back.
    pub(super) fn give_stranded(&mut self) {
        let dead: BTreeSet<String> =
            self.cells.iter().filter(|cell| cell.dead).map(|cell| cell.name.clone()).collect();
        let begun = |claim: &Claim| claim.state == ClaimState::Begun && dead.contains(&claim.cell);
        let stranded: Vec<(String, u32)> = self
            .claims
            .values()
            .filter(|(claim, ..)| begun(claim))
            .map(|(claim, ..)| (claim.job.id.clone(), claim.job.epoch))
            .collect();
        // And takes that cell out of the fleet: it is not waited for with jobs that all others refuse.
        for name in &dead {
            if self.states.remove(name).is_some() {
                self.followers_receive(name, None);
            }
        }
        for (job, epoch) in stranded {
            self.given.insert(job.clone());
            self.happen(SimEvent::Wished(Key::Give { job, by: "anna".into() }, wish(epoch)));
        }
    }
}

fn wish(epoch: u32) -> Wish {
    Wish { version: VERSION, epoch, target: None, begun: true, unix_s: 0.0 }
}
