//! What a cell of the storm does with a job: it is carried out by the machine of a real cell against its
//! simulator in virtual time, without pictures, or it only takes time.
//!
//! In: names of jobs. Out: how each ended. The machine runs on a thread of its own, as fast as the computer
//! allows; a cell that is killed loses it, and the next one has a table of its own. The machine takes what
//! the server and all cells' parts in the fleet leave of the processor: cells have computers of their own,
//! and what is measured is how long the fleet takes, not how long a hundred simulations take on one.

use cell_edge::priority;
use cell_machine::orders::Order;
use cell_machine::supervisor::order::JobOrder;
use celld::pair::camera_view::SightKind;
use celld::pair::run::{bring_up, true_poses};
use celld::pair::table::stage;
use celld::pair::work::job;
use celld::pair::{Choice, Pair};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::{Duration, Instant};

/// A job of virtual time that has not ended by then has a fault of celld, s.
const JOB_WITHIN_S: f64 = 600.0;

/// How a job ended.
pub struct Ended {
    pub job: String,
    pub status: String,
    pub moves: i64,
}

/// Work of a cell, one job at a time.
pub trait Work: Send {
    /// It takes jobs.
    fn is_ready(&mut self) -> bool;
    /// Begins a job.
    fn begin(&mut self, job: &str);
    /// The job that has ended since.
    fn ended(&mut self) -> Option<Ended>;
}

/// A job takes so long.
pub struct Timed {
    pub takes: Duration,
    pub works: Option<(String, Instant)>,
}

impl Work for Timed {
    fn is_ready(&mut self) -> bool {
        true
    }

    fn begin(&mut self, job: &str) {
        self.works = Some((job.to_string(), Instant::now() + self.takes));
    }

    fn ended(&mut self) -> Option<Ended> {
        let (job, _) = self.works.take_if(|(_, over)| *over <= Instant::now())?;
        Some(Ended { job, status: "done".to_string(), moves: 2 })
    }
}

enum Said {
    Up,
    Ended(Ended),
}

/// The machine of a cell, its simulator and its table.
pub struct Virtual {
    jobs: Sender<String>,
    said: Receiver<Said>,
    up: bool,
    over: Option<Ended>,
}

impl Virtual {
    pub fn start(seed: u64) -> Virtual {
        let ((jobs, due), (say, said)) = (channel(), channel());
        std::thread::spawn(move || cell(seed, &due, &say));
        Virtual { jobs, said, up: false, over: None }
    }

    fn listen(&mut self) {
        for said in self.said.try_iter() {
            match said {
                Said::Up => self.up = true,
                Said::Ended(ended) => self.over = Some(ended),
            }
        }
    }
}

impl Work for Virtual {
    fn is_ready(&mut self) -> bool {
        self.listen();
        self.up
    }

    fn begin(&mut self, job: &str) {
        self.jobs.send(job.to_string()).unwrap();
    }

    fn ended(&mut self) -> Option<Ended> {
        self.listen();
        self.over.take()
    }
}

/// A cell in virtual time: comes up, and carries out what is sent.
fn cell(seed: u64, due: &Receiver<String>, say: &Sender<Said>) {
    priority::idle();
    let stage = stage(seed, SightKind::Corners).unwrap();
    let mut pair = Pair::new(stage.clone(), Choice::of(seed)).unwrap();
    assert!(bring_up(&mut pair), "the cell of seed {seed} does not come up");
    // What is computed of a cell once, before it takes jobs.
    stage.model.views();
    say.send(Said::Up).unwrap();
    for (number, id) in due.iter().enumerate() {
        if !pair.status().is_some_and(|status| status.armed) {
            pair.order(Order::Arm);
        }
        let ended = pair.reports().len();
        let goals = true_poses(&pair, &stage.model);
        pair.submit(JobOrder { id: id.clone(), ..job(&stage.model, &goals, seed, number) });
        let over = pair.run_until(JOB_WITHIN_S, |pair| pair.reports().len() > ended);
        assert!(over && pair.breaches().is_empty(), "{id} of seed {seed}: {:?}", pair.breaches());
        let report = pair.reports().last().unwrap();
        let (status, moves) = (report.end.to_string(), report.moves as i64);
        say.send(Said::Ended(Ended { job: id, status, moves })).unwrap();
    }
}
