//! A traced leg: its joint positions, its length, and its segment at a safe speed.
//!
//! In: a chain of joint positions and a distance. Out: the first position at that distance of the tool.
//! Pure.

use crate::arm::ArmModel;
use crate::path::leg::Segment;
use cell_values::units::Joints;

/// See the module.
pub(super) struct Traced {
    pub points: Vec<Joints>,
    pub segment: Segment,
    /// In the segment's unit: rad of the leading joint, m of the tool.
    pub length: f64,
}

/// The first position of a chain at which the tool is `distance` (m) away from the chain's start.
pub(super) fn at_distance<'a>(
    model: &ArmModel,
    chain: impl Iterator<Item = &'a Joints>,
    distance: f64,
) -> Joints {
    let mut chain = chain.peekable();
    let Some(first) = chain.peek().copied().copied() else { return model.home };
    let origin = model.tool_at(&first).translation.vector;
    let away = |q: &Joints| (model.tool_at(q).translation.vector - origin).norm();
    let mut near = first;
    for next in chain {
        if away(next) >= distance {
            let (mut low, mut high) = (0.0, 1.0);
            for _ in 0..12 {
                let middle = 0.5 * (low + high);
                if away(&near.lerp(next, middle)) >= distance { high = middle } else { low = middle }
            }
            return near.lerp(next, high);
        }
        near = *next;
    }
    near
}
