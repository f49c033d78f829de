//! A hand on the table between looks (rows 18, 20, 28 and 29 of the fault table): is it noticed before the
//! next pick that it concerns?
//!
//! In: a seed. Out: what must not be, in words. A job runs while at random moments an object is pushed,
//! put elsewhere, lost from the cups, sticks to them, or the camera is bumped; the rules of the closed
//! loop watch that nothing is picked where a picture since then would have shown that it is not.

use crate::pair::run::{bring_up, true_poses};
use crate::pair::stage::Stage;
use crate::pair::sweep::{after, settled};
use crate::pair::work::approved_job;
use crate::pair::{Choice, Pair};
use cell_machine::orders::Order;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use ur_sim::faults::read::read_posted;

/// Seconds after arming within which hands come.
const WITHIN_S: f64 = 20.0;

/// Simulated seconds for the job to end, or to wait for a person.
const END_WITHIN_S: f64 = 240.0;

/// What a hand does, as a fault of the simulator.
fn deed(rng: &mut ChaCha8Rng, objects: &[String]) -> String {
    let object = &objects[rng.random_range(0..objects.len())];
    let mut by = || rng.random_range(-0.04..0.04);
    let (dx, dy, turn) = (by(), by(), by() * 10.0);
    match rng.random_range(0..8) {
        0..=4 => format!(
            r#"{{"do": "world.nudge", "args": {{"object": "{object}", "dx_m": {dx}, "dy_m": {dy}, "dtheta_rad": {turn}}}}}"#
        ),
        5 => r#"{"do": "vacuum.drop", "args": {"seconds": 0.5}}"#.to_string(),
        6 => r#"{"do": "vacuum.stick", "args": {"seconds": 30}}"#.to_string(),
        _ => format!(r#"{{"do": "camera.extrinsics", "args": {{"translation_m": [{dx}, {dy}, 0]}}}}"#),
    }
}

/// A job with one to three deeds of a hand, and the job after it: what must not be, and the loop with its
/// trace, where that is kept.
///
/// # Errors
/// The loop cannot be set up.
pub fn hands(stage: &Stage, seed: u64, keep: bool) -> Result<(Vec<String>, Pair), String> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x6861_6e64);
    let choice = Choice { keep_trace: keep, ..Choice::of(seed) };
    let mut pair = Pair::new(stage.clone(), choice).map_err(|error| error.to_string())?;
    if !bring_up(&mut pair) {
        return Ok((vec!["the cell does not come up".to_string()], pair));
    }
    let objects: Vec<String> = stage.model.objects.iter().map(|object| object.id.clone()).collect();
    pair.order(Order::Arm);
    pair.approve_plans();
    pair.submit(approved_job(&stage.model, &true_poses(&pair, &stage.model), seed, 0));
    let began = pair.seconds();
    let mut moments: Vec<f64> =
        (0..rng.random_range(1..=3)).map(|_| rng.random_range(0.0..WITHIN_S)).collect();
    moments.sort_by(f64::total_cmp);
    for moment in moments {
        pair.run_until((began + moment - pair.seconds()).max(0.0), |_| false);
        let text = deed(&mut rng, &objects);
        for planned in read_posted(&text).map_err(|error| error.to_string())? {
            // What is impossible now (nothing hangs on the cups, say) is no deed.
            let _ = pair.fault(planned);
        }
    }
    pair.run_until(END_WITHIN_S, |pair| settled(pair, 0));
    let mut faults = Vec::new();
    if after(&mut pair, stage, seed).is_none() {
        faults.push("the job after it has not ended".to_string());
    }
    faults.extend(pair.breaches().iter().map(|breach| format!("{:?}: {}", breach.rule, breach.detail)));
    Ok((faults, pair))
}
