//! A cell that works for hours of virtual time, with a fault every few minutes: does work always go on, and
//! does the machine grow?
//!
//! In: a stage, a seed, how long, how often a fault comes. Out: after every period what was done and how
//! large the machine is, written down as for a recording; and what must not be, in words. Faults are those
//! of the table that leave celld running: one that is started anew has forgotten what it might have piled
//! up. After each a person puts the objects back to where they were at the start. What this loop itself
//! keeps of jobs and sentences is dropped, so that the size of the process is a bound for the machine, too.

use crate::pair::reactions::{Cause, ROWS, Row};
use crate::pair::run::{bring_up, true_poses};
use crate::pair::stage::Stage;
use crate::pair::storm::aftermath;
use crate::pair::sweep::bring_about;
use crate::pair::work::approved_job;
use crate::pair::{Choice, Pair};
use cell_machine::orders::Order;
use cell_replay::Piece;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rearrange::geometry::pose::Pose2;
use std::collections::BTreeMap;
use ur_sim::faults::{Fault, Order as FaultOrder, WorldFault};

/// Simulated seconds after which a job that has not ended is a fault of celld.
const JOB_WITHIN_S: f64 = 600.0;

/// A fault comes within this time after its job was submitted, s.
const STRIKES_WITHIN_S: f64 = 15.0;

/// No fault lasts longer, s.
const LASTS_AT_MOST_S: f64 = 40.0;

/// Where an object is off the table, m: from there it is put back.
const AWAY_M: f64 = 5.0;

/// How long, and how it is divided.
#[derive(Clone, Copy, Debug)]
pub struct Course {
    /// Periods.
    pub periods: u32,
    /// Simulated seconds of one.
    pub period_s: f64,
    /// A fault comes after so many simulated seconds.
    pub fault_every_s: f64,
}

/// What a period came to.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Period {
    /// From 1.
    pub number: u32,
    /// How jobs ended, by code; those with faults and those after them included.
    pub ends: BTreeMap<String, usize>,
    /// Faults that came.
    pub faults: usize,
    /// Bytes of the machine as a recording has it.
    pub machine_bytes: usize,
    /// How often celld had to be started since the beginning.
    pub starts: u64,
}

/// Runs it; `over` is called after each period. What must not be, in words.
///
/// # Errors
/// The loop cannot be set up.
pub fn endurance(
    stage: &Stage,
    choice: Choice,
    course: Course,
    over: &mut dyn FnMut(&Period),
) -> Result<(Vec<String>, Pair), String> {
    let mut pair = Pair::new(stage.clone(), choice).map_err(|error| error.to_string())?;
    if !bring_up(&mut pair) {
        return Ok((vec!["the cell does not come up".to_string()], pair));
    }
    pair.approve_plans();
    let rng = ChaCha8Rng::seed_from_u64(choice.seed ^ 0x656e_6475_7265);
    let mut day = Day { stage, seed: choice.seed, rng, number: 0, wrong: Vec::new() };
    let mut next_fault_s = course.fault_every_s;
    for number in 1..=course.periods {
        let mut period = Period { number, ..Period::default() };
        while pair.seconds() < f64::from(number) * course.period_s && day.wrong.is_empty() {
            if pair.seconds() < next_fault_s {
                day.job(&mut pair);
            } else {
                next_fault_s += course.fault_every_s;
                day.fault(&mut pair);
                period.faults += 1;
            }
            for report in pair.reports() {
                *period.ends.entry(report.code.to_string()).or_default() += 1;
            }
            day.wrong.extend(pair.breaches().iter().map(|b| format!("{:?}: {}", b.rule, b.detail)));
            forget(&mut pair);
        }
        let now = pair.now();
        let piece = Piece::machine(now, pair.machine(), false).map_err(|error| error.to_string())?;
        (period.machine_bytes, period.starts) = (piece.bytes.len(), pair.runs);
        over(&period);
        if !day.wrong.is_empty() {
            break;
        }
    }
    Ok((day.wrong, pair))
}

fn has_jobs(pair: &Pair) -> bool {
    pair.store.active().is_some() || pair.store.waiting() > 0
}

/// Drops what was said, reported and written so far: no job is under way.
fn forget(pair: &mut Pair) {
    pair.notices.clear();
    pair.replies.clear();
    pair.store.forget();
    pair.disk.forget();
    pair.rules.forget();
}

/// The operator and what goes wrong.
struct Day<'a> {
    stage: &'a Stage,
    seed: u64,
    rng: ChaCha8Rng,
    /// Of the next job.
    number: usize,
    /// What must not be.
    wrong: Vec<String>,
}

impl Day<'_> {
    fn submit(&mut self, pair: &mut Pair) {
        if !pair.status().is_some_and(|status| status.armed) {
            pair.order(Order::Arm);
        }
        let at = true_poses(pair, &self.stage.model);
        pair.submit(approved_job(&self.stage.model, &at, self.seed, self.number));
        self.number += 1;
    }

    /// A job without a fault.
    fn job(&mut self, pair: &mut Pair) {
        self.submit(pair);
        let over = pair.run_until(JOB_WITHIN_S, |pair| !pair.reports().is_empty());
        if !over {
            let doing = pair.status().map(|status| status.text()).unwrap_or_default();
            self.wrong.push(format!("after {:.0} s a job does not end: {doing}", pair.seconds()));
        }
    }

    /// A job with a fault, and the one after it.
    fn fault(&mut self, pair: &mut Pair) {
        self.submit(pair);
        let row = self.drawn();
        let wait = self.rng.random_range(0.0..STRIKES_WITHIN_S);
        pair.run_until(wait, |_| false);
        bring_about(pair, &row);
        let said = format!("after {:.0} s, row {} ({})", pair.seconds(), row.number, row.name);
        let aftermath = aftermath(pair, self.stage, self.seed, true);
        self.wrong.extend(aftermath.faults.iter().map(|fault| format!("{said}: {fault}")));
        // A job that outlived the fault is followed by the other, under which no object may be put back.
        if !pair.run_until(2.0 * JOB_WITHIN_S, |pair| !has_jobs(pair)) {
            let doing = pair.status().map(|status| status.text()).unwrap_or_default();
            self.wrong.push(format!("{said}: a job does not end: {doing}"));
        }
        self.put_back(pair);
    }

    /// A row of the table that leaves celld running and the cell fit for work.
    fn drawn(&mut self) -> Row {
        let fits = |row: &&Row| {
            let of_a_moment = match row.cause {
                Cause::Faults(_) | Cause::Garbage(_) | Cause::Flipped | Cause::Ordered(_) => true,
                Cause::OverlappingGoals
                | Cause::BadPlan
                | Cause::PlanWork(_)
                | Cause::Disk(_)
                | Cause::Lost(_)
                | Cause::AllPower => false,
            };
            of_a_moment && !row.ends_work
        };
        let rows: Vec<&Row> = ROWS.iter().filter(fits).collect();
        let row = *rows[self.rng.random_range(0..rows.len())];
        Row { seconds: row.seconds.min(LASTS_AT_MOST_S), ..row }
    }

    /// All objects to where they were at the start: first away, so that none comes down on another.
    fn put_back(&mut self, pair: &mut Pair) {
        let objects = || self.stage.world.objects.iter().filter(|object| !object.fixed);
        let away = objects().map(|object| (object.id.clone(), Pose2::new(AWAY_M, AWAY_M, 0.0)));
        let back = objects().map(|object| (object.id.clone(), object.pose));
        for (object, pose) in away.chain(back) {
            let fault = Fault::World(WorldFault::Place { object, pose });
            // What hangs on the cups stays there, and is the next job's trouble.
            let _ = pair.fault_now(FaultOrder { name: "world.place", fault, seconds: None });
        }
        pair.run_until(1.0, |_| false);
    }
}
