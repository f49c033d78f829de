//! Where a person can jog an arm that touches something, or nearly.
//!
//! In: the arm's model, the room, its joints. Out: one joint and how far to turn it, on which way the arm
//! comes nearer to nothing, or nothing. Pure. A sentence that only names what is too near leaves the person
//! at the pendant to guess the direction, with the arm a few millimetres from what it could break.

use crate::motion::bodies::Room;
use crate::motion::bodies::sweep::Sweep;
use crate::motion::path::ArmModel;
use cell_values::units::Joints;
use std::fmt;

/// The joints as the pendant calls them.
const NAMES: [&str; 6] = ["Base", "Shoulder", "Elbow", "Wrist 1", "Wrist 2", "Wrist 3"];

/// Steps in which a joint is turned, degrees, and the farthest.
const STEP_DEG: f64 = 0.5;
const FARTHEST_DEG: f64 = 45.0;

/// A pair that is too near already may come nearer by so much in one step, m: the arc of a jog is not
/// straight.
const NEARER_M: f64 = 1e-4;

/// One joint turned, the others left as they are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jog {
    /// Joint, counted from 0.
    pub joint: usize,
    /// How far, degrees.
    pub by_deg: f64,
}

impl fmt::Display for Jog {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "jog {} by {:+.1} degrees", NAMES[self.joint], self.by_deg)
    }
}

/// A jog that is under consideration, as far as it is free.
struct Attempt {
    jog: Jog,
    near: Vec<(usize, f64)>,
}

/// The shortest jog of one joint after which nothing is too near any more; `None` where there is none, or
/// where nothing is too near.
pub fn jog_free(model: &ArmModel, room: &Room, from: &Joints) -> Option<Jog> {
    let sweep = Sweep::new(&model.bodies, room);
    let near = sweep.too_near(from);
    if near.is_empty() {
        return None;
    }
    let ways = (0..6).flat_map(|joint| [1.0, -1.0].map(|way| (joint, way)));
    let attempt = |(joint, way)| Attempt { jog: Jog { joint, by_deg: way * STEP_DEG }, near: near.clone() };
    let mut attempts: Vec<Attempt> = ways.map(attempt).collect();
    let steps = (FARTHEST_DEG / STEP_DEG) as usize;
    for step in 1..=steps {
        attempts.retain_mut(|attempt| {
            attempt.jog.by_deg = attempt.jog.by_deg.signum() * STEP_DEG * step as f64;
            let q = turned(from, attempt.jog);
            let now = sweep.too_near(&q);
            let no_nearer = now.iter().all(|(pair, distance)| {
                attempt.near.iter().any(|(before, was)| before == pair && *distance > was - NEARER_M)
            });
            attempt.near = now;
            no_nearer && model.outside_range(&q).is_none()
        });
        if let Some(free) = attempts.iter().find(|attempt| attempt.near.is_empty()) {
            return Some(free.jog);
        }
    }
    None
}

/// The joints after a jog.
fn turned(from: &Joints, jog: Jog) -> Joints {
    let mut q = *from;
    q.0[jog.joint] += jog.by_deg.to_radians();
    q
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::bodies::Tabletop;
    use crate::motion::bodies::sweep::Zone;
    use crate::motion::pick_n_place::tests::{home, model};
    use rand::{RngExt, SeedableRng};

    #[test]
    fn after_the_jog_nothing_is_too_near_and_on_its_way_nothing_comes_nearer() {
        let model = model(0.5);
        let room = Room::new(&model.bodies, &Tabletop { layer: 0.035, standing: Vec::new() }, None);
        let mut sweep = Sweep::new(&model.bodies, &room);
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let (mut blocked, mut freed) = (0, 0);
        while blocked < 200 {
            let mut q = Joints(std::array::from_fn(|_| random.random_range(-3.0..3.0)));
            q.0[1] = random.random_range(-2.6..-0.5);
            let Err(first) = sweep.place(&q, Zone::Over) else { continue };
            blocked += 1;
            let Some(jog) = jog_free(&model, &room, &q) else { continue };
            freed += 1;
            let after = turned(&q, jog);
            assert_eq!(sweep.place(&after, Zone::Over), Ok(()), "{q:?}: {jog}");
            // What was free before stays so, in finer steps too.
            let near = |q: &Joints| Sweep::new(&model.bodies, &room).too_near(q);
            let before = near(&q);
            for k in 1..100 {
                let on = near(&turned(&q, Jog { by_deg: jog.by_deg * f64::from(k) / 100.0, ..jog }));
                let known = |(pair, distance): &(usize, f64)| {
                    *distance > 0.0 || before.iter().any(|(before, _)| before == pair)
                };
                assert!(on.iter().all(known), "{q:?}: {jog}: {on:?}, {first:?}");
            }
        }
        assert!(freed > 60, "{freed} of {blocked}");
    }

    #[test]
    fn a_free_arm_needs_no_jog_and_the_sentence_uses_the_pendants_names() {
        let model = model(0.5);
        assert_eq!(jog_free(&model, &Room::empty(), &home(&model, 0.5)), None);
        let jog = Jog { joint: 3, by_deg: -12.0 };
        assert_eq!(jog.to_string(), "jog Wrist 1 by -12.0 degrees");
    }
}
