//! What a closed loop may differ in: seed, camera, network, how far planning goes, what is kept.
//!
//! In: a seed. Out: [`Choice`], the usual one of that seed, to be changed where a run needs it.

use crate::pair::camera_view::SightKind;
use crate::pair::network::Weather;

/// Deterministic steps that a plan may take: enough for an optimal plan of a few moves.
const PLAN_WORK: u64 = 20_000;

/// What a closed loop may differ in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Choice {
    /// Seed of every delay and error.
    pub seed: u64,
    /// How the cell sees.
    pub eye: SightKind,
    /// How the network behaves; that of the stage unless given.
    pub weather: Option<Weather>,
    /// Steps a plan may take.
    pub plan_work: u64,
    /// Keep the trace as text, not only its fingerprint.
    pub keep_trace: bool,
    /// Record the run and carry it out again beside it.
    pub replay: bool,
}

impl Choice {
    /// Corners, a little weather.
    pub fn of(seed: u64) -> Choice {
        let (eye, weather, plan_work) = (SightKind::Corners, None, PLAN_WORK);
        Choice { seed, eye, weather, plan_work, keep_trace: false, replay: false }
    }
}
