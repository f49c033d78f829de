//! The checker's geometry and the solvers' kernel answer alike, on pairs of every shape, far, near and
//! touching.

use std::f64::consts::TAU;

use crate::geometry::collision::{Placed, overhang};
use crate::geometry::footprint::Footprint;
use crate::geometry::pose::Pose2;
use crate::planning::overlap::{Body, TOUCH_M};

/// SplitMix64: short, and the same everywhere.
struct Random(u64);

impl Random {
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    fn pick<T: Copy>(&mut self, items: &[T]) -> T {
        items[((self.unit() * items.len() as f64) as usize).min(items.len() - 1)]
    }
}

const KINDS: [&str; 5] = ["rectangle", "disc", "ellipse", "convex polygon", "non-convex polygon"];

/// Every pair of kinds once, and each kind with itself.
fn combinations() -> Vec<(usize, usize)> {
    (0..KINDS.len()).flat_map(|i| (i..KINDS.len()).map(move |j| (i, j))).collect()
}

fn shape(kind: usize, random: &mut Random) -> Footprint {
    let size = random.between(0.05, 0.3);
    let ratio = random.between(0.15, 1.0);
    let made = match kind {
        0 => Footprint::rectangle(size, size * ratio),
        1 => Footprint::disc(size / 2.0),
        2 => Footprint::ellipse(size, size * ratio),
        3 => {
            // Corners on an ellipse at sorted angles: always convex.
            let n = random.pick(&[3.0, 4.0, 5.0, 8.0, 13.0]);
            let corner = |k: f64, random: &mut Random| {
                let (sin, cos) = (TAU * (k + 0.8 * random.unit()) / n).sin_cos();
                [0.5 * size * cos, 0.5 * size * ratio * sin]
            };
            let points: Vec<[f64; 2]> = (0..n as usize).map(|k| corner(k as f64, random)).collect();
            Footprint::polygon(&points)
        }
        _ => match random.pick(&[0, 1, 2]) {
            // Star-shaped with random radii, an L, and a mug with its handle.
            0 => {
                let n = random.pick(&[5.0, 8.0, 12.0, 20.0]);
                let corner = |k: f64, random: &mut Random| {
                    let (sin, cos) = (TAU * (k + 0.5 * random.unit()) / n).sin_cos();
                    let radius = 0.5 * size * random.between(0.25, 1.0);
                    [radius * cos, radius * sin]
                };
                let points: Vec<[f64; 2]> = (0..n as usize).map(|k| corner(k as f64, random)).collect();
                Footprint::polygon(&points)
            }
            1 => {
                let (s, t) = (size, size * 0.5 * ratio);
                Footprint::polygon(&[[0.0, 0.0], [s, 0.0], [s, t], [t, t], [t, s], [0.0, s]])
            }
            _ => {
                let s = size / 2.0;
                let points = [
                    [-0.4, -0.8],
                    [0.3, -0.7],
                    [0.6, -0.15],
                    [1.0, -0.1],
                    [1.0, 0.1],
                    [0.6, 0.15],
                    [0.3, 0.7],
                    [-0.4, 0.8],
                    [-1.0, 0.1],
                    [-1.0, -0.1],
                ];
                Footprint::polygon(&points.map(|p| [p[0] * s, p[1] * s]))
            }
        },
    };
    made.expect("a valid shape")
}

fn pose(random: &mut Random, reach: f64) -> Pose2 {
    let theta =
        if random.unit() < 0.2 { random.pick(&[0.0, 0.25, 0.5]) * TAU } else { random.between(0.0, TAU) };
    Pose2::new(random.between(-reach, reach), random.between(-reach, reach), theta)
}

/// A pair in contact to within rounding: `b` is moved along a random direction until the kernel's answer
/// changes.
fn touching(a: &Footprint, pose_a: &Pose2, b: &Footprint, random: &mut Random) -> Option<(Pose2, [f64; 2])> {
    let (sin, cos) = random.between(0.0, TAU).sin_cos();
    let theta = if random.unit() < 0.3 { pose_a.theta } else { random.between(0.0, TAU) };
    let base =
        Pose2::new(pose_a.x + random.between(-0.05, 0.05), pose_a.y + random.between(-0.05, 0.05), theta);
    let placed = Placed::new(a, *pose_a);
    let at = |d: f64| Pose2::new(base.x + d * cos, base.y + d * sin, theta);
    let (mut hit, mut free) = (0.0, 1.0);
    if !placed.collides(&Placed::new(b, at(hit))) {
        return None;
    }
    for _ in 0..50 {
        let middle = 0.5 * (hit + free);
        if placed.collides(&Placed::new(b, at(middle))) {
            hit = middle;
        } else {
            free = middle;
        }
    }
    Some((at(free), [cos, sin]))
}

const OFFSETS: [f64; 10] = [3e-8, -3e-8, 1e-6, -1e-6, 1e-7, -1e-7, 1e-5, -1e-5, 1e-4, -1e-4];

#[test]
fn checker_and_kernel_agree_on_a_hundred_thousand_pairs() {
    const PAIRS: usize = 7000;
    let (mut tested, mut near, mut overlapping) = (0usize, 0usize, 0usize);
    for (i, j) in combinations() {
        let seed = (10 * i + j) as u64;
        let mut random = Random(seed);
        for k in 0..PAIRS {
            let (a, b) = (shape(i, &mut random), shape(j, &mut random));
            let pose_a = pose(&mut random, 0.5);
            let close = (k % 2 == 0).then(|| touching(&a, &pose_a, &b, &mut random)).flatten();
            let pose_b = match close {
                Some((contact, away)) => {
                    near += 1;
                    let d = random.pick(&OFFSETS);
                    Pose2::new(contact.x + d * away[0], contact.y + d * away[1], contact.theta)
                }
                None => {
                    let shift = pose(&mut random, 0.25);
                    Pose2::new(pose_a.x + shift.x, pose_a.y + shift.y, shift.theta)
                }
            };
            let (placed_a, placed_b) = (Placed::new(&a, pose_a), Placed::new(&b, pose_b));
            let kernel = placed_a.collides(&placed_b);
            let checker = Body::new(&a, &pose_a).overlaps_deeper(&Body::new(&b, &pose_b), TOUCH_M);
            tested += 1;
            overlapping += usize::from(kernel);
            assert_eq!(
                kernel,
                checker,
                "{} and {}, seed {seed}, pair {k}: {a:?} at {pose_a:?}, {b:?} at {pose_b:?}, depth {:e}, \
                 distance {:e}",
                KINDS[i],
                KINDS[j],
                placed_a.penetration(&placed_b),
                placed_a.distance(&placed_b),
            );
        }
    }
    println!("{tested} pairs, {near} of them near-touching, {overlapping} overlapping; seeds 10 i + j");
    assert!(tested >= 100_000 && near > 40_000 && overlapping > 20_000 && overlapping < 80_000);
}

#[test]
fn clearance_and_depth_agree_too() {
    let mut compared = [0usize; 2];
    for (i, j) in combinations() {
        let seed = 1000 + (10 * i + j) as u64;
        let mut random = Random(seed);
        for k in 0..200 {
            let (a, b) = (shape(i, &mut random), shape(j, &mut random));
            let pose_a = pose(&mut random, 0.5);
            let Some((contact, away)) = touching(&a, &pose_a, &b, &mut random) else { continue };
            let d = random.between(-0.01, 0.01);
            let pose_b = Pose2::new(contact.x + d * away[0], contact.y + d * away[1], contact.theta);
            let (placed_a, placed_b) = (Placed::new(&a, pose_a), Placed::new(&b, pose_b));
            let (body_a, body_b) = (Body::new(&a, &pose_a), Body::new(&b, &pose_b));
            let what = || format!("{} and {}, seed {seed}, pair {k}", KINDS[i], KINDS[j]);
            let gap = placed_a.distance(&placed_b);
            if gap > 1e-6 {
                compared[0] += 1;
                for (clearance, nearer) in [(gap + 2e-7, true), (gap - 2e-7, false)] {
                    assert_eq!(body_a.nearer_than(&body_b, clearance), nearer, "{} gap {gap}", what());
                    assert_eq!(placed_a.closer_than(&placed_b, clearance), nearer, "{} gap {gap}", what());
                }
            }
            // Of non-convex polygons the two take different convex pieces: depths differ, answers do not.
            let depth = placed_a.penetration(&placed_b);
            if depth > 1e-6 && j < 3 {
                compared[1] += 1;
                assert!(body_a.overlaps_deeper(&body_b, depth - 2e-7), "{} depth {depth}", what());
                assert!(!body_a.overlaps_deeper(&body_b, depth + 2e-7), "{} depth {depth}", what());
                assert!((body_a.depth(&body_b) - depth).abs() < 2e-7, "{}", what());
            }
        }
    }
    println!("{} clearances and {} depths compared", compared[0], compared[1]);
    assert!(compared[0] > 500 && compared[1] > 300, "{compared:?}");
}

#[test]
fn the_edge_agrees() {
    let mut random = Random(77);
    for k in 0..5000 {
        let footprint = shape(k % KINDS.len(), &mut random);
        let at = pose(&mut random, 0.5);
        let (low, high) = footprint.bounds(&at);
        // Moved so that it touches a wall of the unit table, then a little to either side.
        let d = random.pick(&OFFSETS);
        let [x, y] = random.pick(&[
            [d - low[0], 0.5 - at.y],
            [1.0 - high[0] + d, 0.5 - at.y],
            [0.5 - at.x, d - low[1]],
        ]);
        let at = Pose2::new(at.x + x, at.y + y, at.theta);
        let kernel = overhang(&footprint, &at, 1.0, 1.0) > TOUCH_M;
        let checker = Body::new(&footprint, &at).reaches_over(1.0, 1.0, TOUCH_M);
        assert_eq!(kernel, checker, "pair {k}, seed 77: {footprint:?} at {at:?}");
    }
}

#[test]
fn exact_fits_do_not_collide_at_any_angle() {
    // A block in the bay of a U whose walls touch it on three sides: rounding must not make it collide.
    let bay = Footprint::polygon(&[
        [-0.15, -0.1],
        [0.15, -0.1],
        [0.15, 0.1],
        [0.05, 0.1],
        [0.05, 0.0],
        [-0.05, 0.0],
        [-0.05, 0.1],
        [-0.15, 0.1],
    ])
    .expect("valid");
    let block = Footprint::rectangle(0.1, 0.1).expect("valid");
    let mut random = Random(5);
    for _ in 0..500 {
        let at = pose(&mut random, 0.5);
        let inside = at.compose(&Pose2::new(0.0, 0.05, 0.0));
        assert!(!Body::new(&bay, &at).overlaps_deeper(&Body::new(&block, &inside), TOUCH_M), "{at:?}");
        assert!(!Placed::new(&bay, at).collides(&Placed::new(&block, inside)), "{at:?}");
        let pushed = at.compose(&Pose2::new(0.0, 0.05 - 1e-8, 0.0));
        assert!(Body::new(&bay, &at).overlaps_deeper(&Body::new(&block, &pushed), TOUCH_M), "{at:?}");
        assert!(Placed::new(&bay, at).collides(&Placed::new(&block, pushed)), "{at:?}");
    }
}
