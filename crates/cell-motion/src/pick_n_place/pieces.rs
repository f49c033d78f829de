//! Pieces of the paths of a pick-n-place: segments, corners that are cut, ways round.
//!
//! In: places in joints, heights and speeds of a cycle. Out: segments, blend radii, legs. Pure.

use crate::bodies::Room;
use crate::cycle::CycleParameters;
use crate::path::{ArmModel, Leg, PathFault, Segment};
use crate::way::{Search, find};
use cell_values::units::Joints;

/// A blend is so much of the way to the next corner at most, and none that is smaller is worth it, m.
pub(crate) const WAY_SHARE: f64 = 0.9;
const LEAST_BLEND_M: f64 = 2e-3;

/// A corner's lowest place is so far over what it keeps out of, m: what a joint move sags between its ends.
const SAG_M: f64 = 1e-3;

/// Blend radii of a corner at a height, m, the larger first: with something `below` the tool (m), the way
/// that cuts it stays over everything, and the corner fits into the `ways` on both sides of it (m).
pub(crate) fn corner(height: f64, below: f64, cycle: &CycleParameters, ways: [f64; 2]) -> [f64; 2] {
    let over_all = height - below - cycle.corner_layer() - SAG_M;
    let largest = ways.into_iter().map(|way| WAY_SHARE * way).fold(cycle.blend.min(over_all), f64::min);
    [1.0, 0.5].map(|share| if share * largest < LEAST_BLEND_M { 0.0 } else { share * largest })
}

/// The path with the wider corners of two, or else with the narrower.
pub(crate) fn widest<T>(
    [wide, narrow]: [f64; 2],
    path: impl Fn(f64) -> Result<T, PathFault>,
) -> Result<T, PathFault> {
    path(wide).or_else(|fault| if narrow < wide { path(narrow) } else { Err(fault) })
}

/// Metres from tool to tool.
pub(crate) fn metres(model: &ArmModel, from: &Joints, to: &Joints) -> f64 {
    (model.tool_at(to).translation.vector - model.tool_at(from).translation.vector).norm()
}

/// A way round what is in the straight way, stop by stop; `None` where none is searched for or found.
pub(crate) fn round(
    model: &ArmModel,
    (from, to): (&Joints, &Joints),
    cycle: &CycleParameters,
    room: &Room,
    search: Option<Search>,
) -> Option<Vec<Leg>> {
    let points = find(model, room, from, to, search?).ok()?;
    Some(points.into_iter().map(|q| Leg::over(joint(q, cycle, 0.0), f64::NEG_INFINITY)).collect())
}

pub(crate) fn joint(target: Joints, cycle: &CycleParameters, blend: f64) -> Segment {
    Segment::Joint { target, speed: cycle.joint_speed, acceleration: cycle.joint_acceleration, blend }
}

pub(crate) fn linear(target: Joints, cycle: &CycleParameters, blend: f64) -> Segment {
    Segment::Linear { target, speed: cycle.tool_speed, acceleration: cycle.tool_acceleration, blend }
}
