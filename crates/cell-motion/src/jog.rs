//! Where a person can jog an arm that is too near to something.
//!
//! In: the arm's model, the room, its joints. Out: one joint and how far to turn it, on which way the arm
//! comes nearer to nothing, or nothing. Pure. A sentence that only names what is too near leaves the person
//! at the pendant to guess the direction, with the arm a few millimetres from what it could break. Where it
//! is not known how deep two bodies overlap no jog is given, for neither is the way out; nor between the
//! objects, where the model has one layer for all of them and any way aside would look free.

use crate::bodies::Room;
use crate::bodies::sweep::Sweep;
use crate::path::ArmModel;
use cell_values::units::Joints;
use std::fmt;

/// The joints as the pendant calls them.
const NAMES: [&str; 6] = ["Base", "Shoulder", "Elbow", "Wrist 1", "Wrist 2", "Wrist 3"];

/// Steps in which a joint is turned, degrees, and the farthest.
const STEP_DEG: f64 = 0.5;
const FARTHEST_DEG: f64 = 45.0;

/// A pair that is too near already may come nearer by so much in all, m: the arc of a jog is not straight.
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

/// The shortest jog of one joint after which nothing is too near any more; `None` where there is none, where
/// nothing is too near, or where the way out is not known.
pub fn jog_free(model: &ArmModel, room: &Room, from: &Joints) -> Option<Jog> {
    let sweep = Sweep::new(&model.bodies, room);
    let near = sweep.too_near(from);
    if near.is_empty() || !sweep.way_out_is_known(&near) {
        return None;
    }
    let no_nearer = |now: &[(usize, f64)]| {
        let was = |pair: usize| near.iter().find(|(before, _)| *before == pair).map(|(_, was)| *was);
        now.iter().all(|(pair, distance)| was(*pair).is_some_and(|was| *distance > was - NEARER_M))
    };
    let ways = (0..6).flat_map(|joint| [1.0, -1.0].map(|way| (joint, way)));
    let mut jogs: Vec<Jog> = ways.map(|(joint, way)| Jog { joint, by_deg: way }).collect();
    let steps = (FARTHEST_DEG / STEP_DEG) as usize;
    for step in 1..=steps {
        let mut free = None;
        jogs.retain_mut(|jog| {
            jog.by_deg = jog.by_deg.signum() * STEP_DEG * step as f64;
            let q = turned(from, *jog);
            let now = sweep.too_near(&q);
            let goes = no_nearer(&now) && model.outside_range(&q).is_none();
            if goes && now.is_empty() {
                free = free.or(Some(*jog));
            }
            goes
        });
        if free.is_some() {
            return free;
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
    use crate::bodies::sweep::Zone;
    use crate::pick_n_place::tool_down;
    use crate::testing::{home, model, table};
    use rand::{RngExt, SeedableRng};

    #[test]
    fn after_the_jog_nothing_is_too_near_and_on_its_way_nothing_comes_nearer() {
        let model = model(0.5);
        let room = Room::new(&model.bodies, &table(), None);
        let mut sweep = Sweep::new(&model.bodies, &room);
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let (mut blocked, mut freed, mut overlapping) = (0, 0, 0);
        while blocked < 100 {
            let mut q = Joints(std::array::from_fn(|_| random.random_range(-3.0..3.0)));
            q.0[1] = random.random_range(-2.6..-0.5);
            let near = |q: &Joints| Sweep::new(&model.bodies, &room).too_near(q);
            let before = near(&q);
            if before.is_empty() {
                continue;
            }
            let jog = jog_free(&model, &room, &q);
            if !sweep.way_out_is_known(&before) {
                assert_eq!(jog, None, "{q:?}: {before:?}");
                overlapping += 1;
                continue;
            }
            blocked += 1;
            let Some(jog) = jog else { continue };
            freed += 1;
            let after = turned(&q, jog);
            assert_eq!(sweep.place(&after, Zone::Over), Ok(()), "{q:?}: {jog}");
            // On the way no pair is nearer than it was, in finer steps too.
            for k in 1..100 {
                let on = near(&turned(&q, Jog { by_deg: jog.by_deg * f64::from(k) / 100.0, ..jog }));
                let kept = |(pair, distance): &(usize, f64)| {
                    before.iter().any(|(known, was)| known == pair && *distance > was - 2.0 * NEARER_M)
                };
                assert!(on.iter().all(kept), "{q:?}: {jog}: {on:?}, {before:?}");
            }
        }
        assert!(freed > 60 && overlapping > 30, "{freed} of {blocked}, {overlapping} overlap");
    }

    #[test]
    fn an_arm_between_the_objects_is_given_no_way_aside() {
        let model = model(0.5);
        let room = Room::new(&model.bodies, &table(), None);
        for (x, y) in [(0.02, 0.25), (0.25, 0.25), (0.48, 0.48), (0.1, 0.02)] {
            let low = model.joints_at(&tool_down(x, y, 0.015, 0.0), &home(&model, 0.5)).expect("in reach");
            assert!(Sweep::new(&model.bodies, &room).place(&low, Zone::Over).is_err());
            assert_eq!(jog_free(&model, &room, &low), None, "x {x}, y {y}");
        }
    }

    #[test]
    fn a_free_arm_needs_no_jog_and_the_sentence_uses_the_pendants_names() {
        let model = model(0.5);
        assert_eq!(jog_free(&model, &Room::empty(), &home(&model, 0.5)), None);
        let jog = Jog { joint: 3, by_deg: -12.0 };
        assert_eq!(jog.to_string(), "jog Wrist 1 by -12.0 degrees");
    }
}
