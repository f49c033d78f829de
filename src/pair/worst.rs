//! The worst controller, gripper and network that are still plausible.
//!
//! In: a stage, a seed. Out: the same stage with all of it at once: late packets and gaps of 100 ms, slow
//! answers of the dashboard, a program that takes 2 s to load, joints that creep and are noisy at rest, a
//! pump that overshoots. By seed: the speed in blends, registers that another client holds at first, a
//! gripper's box that refuses a second client or drops the first, and how long it keeps a dead client's
//! place. Most values are guesses.

use crate::pair::network::Weather;
use crate::pair::stage::Stage;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use ur_sim::box_clients::{BoxConfig, SecondClient};
use ur_sim::faults::read::read_posted;
use ur_sim::motion::rest::{RestConfig, Stop};
use ur_sim::motion::rounding::{BlendConfig, ENTRY_SPEEDS};

/// Speeds at rest of an e-Series arm in recordings, rad/s, and encoders, rad.
const SPEED_NOISE: f64 = 3e-4;
const POSITION_NOISE: f64 = 1e-5;

/// Load time of celld's program, s.
const LOADS_FOR_S: f64 = 2.0;

/// Overshoot, share of the target: field reports say that a pump drops a tenth from its peak.
const OVERSHOOT: f64 = 0.11;

/// A crashed client's registers are free again after some seconds.
const CLAIMED: &str = r#"{"do": "ur.claim", "args": {"input": "input_int_register_24", "seconds": 8}}"#;

/// Makes controller, gripper and network as bad as they may be.
///
/// # Errors
/// The faults at the start are not in the catalogue.
pub fn worst(stage: &mut Stage, seed: u64) -> Result<(), String> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x0077_6f72_7374);
    let (_, entry_speed) = ENTRY_SPEEDS[rng.random_range(0..ENTRY_SPEEDS.len())];
    stage.controller.blends = BlendConfig { entry_speed, seed };
    stage.controller.rest =
        RestConfig { stop: Stop::Creeping, speed_noise: SPEED_NOISE, position_noise: POSITION_NOISE };
    stage.controller.loads_for_s = LOADS_FOR_S;
    let seconds = [SecondClient::Refused, SecondClient::Evicts, SecondClient::Waits];
    let second = seconds[rng.random_range(0..seconds.len())];
    stage.world.gripper.clients = BoxConfig { second, half_open_s: rng.random_range(0.0..20.0) };
    stage.world.gripper.overshoot = OVERSHOOT;
    stage.weather = Weather::WORST;
    if rng.random_bool(0.5) {
        stage.at_start = read_posted(CLAIMED).map_err(|complaints| complaints.to_string())?;
    }
    Ok(())
}
