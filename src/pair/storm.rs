//! Jobs with one to three faults at once, drawn by seed (row 49 of the fault table).
//!
//! In: a seed. Out: which faults come when ([`strikes`]), and what became of the job and of the one after it
//! ([`storm`]). While faults may come, only the rules count: anything may fail. Then the faults end, a
//! person clears the pendant and arms, and another job has to end in a named state. [`fewest`] leaves out
//! what a failure does not need.

use crate::pair::reactions::{Cause, ROWS, Row};
use crate::pair::run::{bring_up, true_poses};
use crate::pair::stage::Stage;
use crate::pair::sweep::{after, bring_about, settled};
use crate::pair::work::approved_job;
use crate::pair::{Choice, Pair};
use cell_machine::code::Code;
use cell_machine::orders::Order;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Faults come within this time after arming, s: two or three pick-n-places.
const STRIKES_WITHIN_S: f64 = 25.0;

/// No fault lasts longer here, s.
const LASTS_AT_MOST_S: f64 = 40.0;

/// The job has ended, or waits for a person, within this time after the last fault, s.
const END_WITHIN_S: f64 = 240.0;

/// A cell that is disarmed or paused for so long waits for a person, s.
const WAITS_S: f64 = 10.0;

/// A fault that comes.
#[derive(Clone, Copy, Debug)]
pub struct Strike {
    /// Seconds after arming.
    pub at_s: f64,
    /// What.
    pub row: Row,
}

/// What became of it.
#[derive(Clone, Debug, Default)]
pub struct Aftermath {
    /// How the job ended; `None` where it waits, or celld has ended.
    pub code: Option<Code>,
    /// How the job after it ended.
    pub next: Option<Code>,
    /// What must not be, in words.
    pub faults: Vec<String>,
}

/// The faults of a seed, in the order in which they come.
pub fn strikes(seed: u64) -> Vec<Strike> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x5374_6f72_6d00);
    let count = rng.random_range(1..=3);
    let mut strikes: Vec<Strike> = Vec::new();
    while strikes.len() < count {
        let row = ROWS[rng.random_range(0..ROWS.len())];
        // These are of the job or of the whole run, not of a moment.
        match row.cause {
            Cause::OverlappingGoals | Cause::BadPlan | Cause::PlanWork(_) => continue,
            Cause::Faults(_)
            | Cause::Disk(_)
            | Cause::Lost(_)
            | Cause::AllPower
            | Cause::Garbage(_)
            | Cause::Flipped
            | Cause::Ordered(_) => {}
        }
        let at_s = rng.random_range(0.0..STRIKES_WITHIN_S);
        strikes.push(Strike { at_s, row: Row { seconds: row.seconds.min(LASTS_AT_MOST_S), ..row } });
    }
    strikes.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
    strikes
}

/// A job with these faults, and the job after it, by the choice's seed.
///
/// # Errors
/// The loop cannot be set up.
pub fn storm(stage: &Stage, choice: Choice, strikes: &[Strike]) -> Result<(Aftermath, Pair), String> {
    let seed = choice.seed;
    let mut pair = Pair::new(stage.clone(), choice).map_err(|error| error.to_string())?;
    let mut aftermath = Aftermath::default();
    if !bring_up(&mut pair) {
        aftermath.faults.push("the cell does not come up".to_string());
        return Ok((aftermath, pair));
    }
    pair.order(Order::Arm);
    pair.approve_plans();
    pair.submit(approved_job(&stage.model, &true_poses(&pair, &stage.model), seed, 0));
    let began = pair.seconds();
    for strike in strikes {
        let left = began + strike.at_s - pair.seconds();
        pair.run_until(left.max(0.0), |_| false);
        bring_about(&mut pair, &strike.row);
    }
    let ends_work = strikes.iter().any(|strike| strike.row.ends_work);
    Ok((rest_of(&mut pair, stage, seed, !ends_work, aftermath), pair))
}

/// What becomes of the job that is under way, and of the one after it; with `goes_on`, that one has to end.
pub(super) fn aftermath(pair: &mut Pair, stage: &Stage, seed: u64, goes_on: bool) -> Aftermath {
    rest_of(pair, stage, seed, goes_on, Aftermath::default())
}

fn rest_of(pair: &mut Pair, stage: &Stage, seed: u64, goes_on: bool, mut aftermath: Aftermath) -> Aftermath {
    let mut waits_since = None;
    let over = pair.run_until(END_WITHIN_S, |pair| {
        let goes_on = pair.status().is_some_and(|status| status.armed && !status.paused);
        waits_since = if goes_on { None } else { waits_since.or(Some(pair.seconds())) };
        settled(pair, 0) || waits_since.is_some_and(|at| pair.seconds() > at + WAITS_S)
    });
    aftermath.code = pair.reports().first().map(|report| report.code);
    if !over {
        let doing = pair.status().map(|status| status.text()).unwrap_or_default();
        aftermath.faults.push(format!("the job neither ended nor waits for a person: {doing}"));
    }
    aftermath.next = after(pair, stage, seed);
    if aftermath.next.is_none() && goes_on {
        let doing = pair.status().map(|status| status.text()).unwrap_or_default();
        aftermath.faults.push(format!("the job after it has not ended: {doing}"));
    }
    for breach in pair.breaches() {
        aftermath.faults.push(format!("{:?} was broken: {}", breach.rule, breach.detail));
    }
    aftermath
}

/// The numbers of the fewest of these faults with which something still is as it must not be.
pub fn fewest(stage: &Stage, choice: Choice, strikes: &[Strike]) -> Vec<usize> {
    let all = (1u32 << strikes.len()) - 1;
    let mut masks: Vec<u32> = (0..=all).collect();
    masks.sort_by_key(|mask| mask.count_ones());
    let numbers = |mask: u32| (0..strikes.len()).filter(move |number| mask & (1 << number) != 0);
    let fails = |mask: &u32| {
        let chosen: Vec<Strike> = numbers(*mask).map(|number| strikes[number]).collect();
        storm(stage, choice, &chosen).is_ok_and(|(aftermath, _)| !aftermath.faults.is_empty())
    };
    numbers(masks.into_iter().find(fails).unwrap_or(all)).collect()
}
