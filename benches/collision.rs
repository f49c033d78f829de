//! What a question to the collision kernel costs, by pair of shapes: `cargo bench`.
//!
//! In: pairs of footprints of like size at random poses, by seed; near pairs (bounding discs meet, so that
//! the exact test decides) and any pairs on a table of 1 m, where most are separated by their discs. Out: a
//! table of nanoseconds a pair, least of many rounds: what else the machine does only adds. Poses are placed
//! beforehand; placing is measured by itself. Then the same pairs with `parry2d` (`parry`), and whole checks
//! of a pose among many objects, with four broad phases (`broad`).

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rearrange::geometry::collision::Placed;
use rearrange::geometry::footprint::Footprint;
use rearrange::geometry::pose::Pose2;
use std::hint::black_box;
use std::time::Instant;

#[path = "collision/broad.rs"]
mod broad;
#[path = "collision/parry.rs"]
mod parry;

/// Pairs of one kind, and poses of one broad phase.
const PAIRS: usize = 4096;

/// Rounds over them; the shortest counts.
const ROUNDS: usize = 101;

const SEED: u64 = 1;

fn main() {
    let shapes = shapes();
    println!("{:<22} {:>10} {:>10} {:>10}", "ns a pair of poses", "near", "any", "colliding");
    for (at, (name, shape)) in shapes.iter().enumerate() {
        for (other_name, other) in &shapes[at..] {
            let near = pairs(shape, other, true);
            let any = pairs(shape, other, false);
            let colliding = near.iter().filter(|(a, b)| a.collides(b)).count();
            println!(
                "{:<22} {:>10.1} {:>10.1} {:>9.0}%",
                format!("{name}-{other_name}"),
                nanoseconds(|k| near[k].0.collides(&near[k].1)),
                nanoseconds(|k| any[k].0.collides(&any[k].1)),
                100.0 * colliding as f64 / PAIRS as f64
            );
        }
    }
    println!("\n{:<22} {:>10}", "ns to place", "");
    for (name, shape) in &shapes {
        let mut rng = ChaCha8Rng::seed_from_u64(SEED);
        let poses: Vec<Pose2> = (0..PAIRS).map(|_| anywhere(&mut rng)).collect();
        println!("{name:<22} {:>10.1}", nanoseconds(|k| Placed::new(shape, poses[k])));
    }
    parry::run();
    broad::run();
}

/// Of about the area of an object among 20 that cover 0.4 of the table.
fn shapes() -> Vec<(&'static str, Footprint)> {
    let tee = [
        [-0.1, 0.0],
        [0.1, 0.0],
        [0.1, 0.07],
        [0.035, 0.07],
        [0.035, 0.14],
        [-0.035, 0.14],
        [-0.035, 0.07],
        [-0.1, 0.07],
    ];
    let made = [
        ("disc", Footprint::disc(0.08)),
        ("ellipse", Footprint::ellipse(0.22, 0.115)),
        ("rectangle", Footprint::rectangle(0.2, 0.1)),
        ("tee", Footprint::polygon(&tee)),
    ];
    made.into_iter().map(|(name, shape)| (name, shape.expect("a footprint"))).collect()
}

fn anywhere(rng: &mut ChaCha8Rng) -> Pose2 {
    let mut number = |most: f64| rng.random_range(0.0..most);
    Pose2::new(number(1.0), number(1.0), number(std::f64::consts::TAU))
}

fn pairs(a: &Footprint, b: &Footprint, near: bool) -> Vec<(Placed, Placed)> {
    let placed = |(here, there)| (Placed::new(a, here), Placed::new(b, there));
    pose_pairs(a, b, near).into_iter().map(placed).collect()
}

fn pose_pairs(a: &Footprint, b: &Footprint, near: bool) -> Vec<(Pose2, Pose2)> {
    let mut rng = ChaCha8Rng::seed_from_u64(SEED);
    let reach = a.bounding_radius() + b.bounding_radius();
    let mut out = Vec::with_capacity(PAIRS);
    while out.len() < PAIRS {
        let (here, there) = (anywhere(&mut rng), anywhere(&mut rng));
        if !near || here.distance(&there) < reach {
            out.push((here, there));
        }
    }
    out
}

/// Mean time of one call in the shortest round.
fn nanoseconds<T>(call: impl Fn(usize) -> T) -> f64 {
    let round = |_| {
        let begun = Instant::now();
        for k in 0..PAIRS {
            black_box(call(black_box(k)));
        }
        begun.elapsed().as_secs_f64() * 1e9 / PAIRS as f64
    };
    (0..ROUNDS).map(round).fold(f64::INFINITY, f64::min)
}
