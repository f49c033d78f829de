//! What a person does in a drill, and how a drill is run.

use crate::mutants::plant::Plant;
use cell_machine::orders::Order;
use cell_machine::supervisor::status::{Doing, WorkStep};
use celld::pair::camera_view::SightKind;
use celld::pair::network::Weather;
use celld::pair::rules::Rule;
use celld::pair::run::{bring_up, true_poses};
use celld::pair::stage::Stage;
use celld::pair::table::stage;
use celld::pair::work::job;
use celld::pair::{Choice, Pair};
use ur_sim::faults::read::read_posted;

/// Seed of every drill.
pub const SEED: u64 = 5;

/// A mutant, and the drill in which its rule finds it.
pub struct Case {
    /// What goes wrong.
    pub name: &'static str,
    /// The one rule that finds it.
    pub rule: Rule,
    /// How the cell differs from the usual one.
    pub cell: fn(&mut Stage),
    /// The mutant.
    pub plant: fn() -> Plant,
    /// What happens.
    pub drill: fn(&mut Pair, &Stage),
}

/// The usual cell.
pub fn usual(_: &mut Stage) {}

/// A cell after a drill.
pub fn after(cell: fn(&mut Stage), plant: Option<fn() -> Plant>, drill: fn(&mut Pair, &Stage)) -> Pair {
    let mut stage = stage(SEED, SightKind::Corners).expect("the drill runs");
    // Long enough not to be found in bytes that mean something else.
    stage.parameters.nonce_seed = 1_234_567_890;
    cell(&mut stage);
    let weather = Weather { late: 0.0, split: 0.0, ..Weather::LAN };
    let choice = Choice { weather: Some(weather), replay: true, ..Choice::of(SEED) };
    let mut pair = Pair::new(stage.clone(), choice).expect("the drill runs");
    if let Some(plant) = plant {
        pair.adapt(Box::new(plant()));
    }
    assert!(bring_up(&mut pair), "the cell comes up");
    drill(&mut pair, &stage);
    pair
}

/// The rules that were broken in a drill, with what was seen.
pub fn run(
    cell: fn(&mut Stage),
    plant: Option<fn() -> Plant>,
    drill: fn(&mut Pair, &Stage),
) -> Vec<(Rule, String)> {
    let pair = after(cell, plant, drill);
    pair.breaches().iter().map(|breach| (breach.rule, breach.detail.clone())).collect()
}

pub fn wait(pair: &mut Pair, seconds: f64) {
    pair.run_until(seconds, |_| false);
}

/// Until a rule is broken, and half a second more.
pub fn until_found(pair: &mut Pair, seconds: f64) {
    pair.run_until(seconds, |pair| !pair.breaches().is_empty());
    wait(pair, 0.5);
}

pub fn arm(pair: &mut Pair) {
    pair.order(Order::Arm);
    wait(pair, 0.3);
}

pub fn submit(pair: &mut Pair, stage: &Stage, number: usize) {
    pair.submit(job(&stage.model, &true_poses(pair, &stage.model), SEED, number));
}

pub fn until_working(pair: &mut Pair, step: WorkStep) {
    pair.run_until(60.0, |pair| {
        let doing = pair.status().map(|status| &status.doing);
        matches!(doing, Some(Doing::Working(doing, _)) if *doing == step)
    });
}

/// An armed cell at work, so far.
pub fn work_until(pair: &mut Pair, stage: &Stage, step: WorkStep) {
    arm(pair);
    submit(pair, stage, 0);
    until_working(pair, step);
}

/// Brings a fault of the simulator about.
pub fn bring_about(pair: &mut Pair, text: &str) {
    for planned in read_posted(text).expect("the drill runs") {
        pair.fault(planned).expect("the drill runs");
    }
}
