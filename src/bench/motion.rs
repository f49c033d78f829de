//! `bench motion`: what kinematics, the swept check, reach and the search for ways cost, and how right they
//! are.
//!
//! In: seeds and numbers of cases. Out: [`MotionFigures`]. The arm of the demo at a table of 0.6 m. Times
//! are of one thread. What is measured against: a model of this file's own (capsules 10 mm thinner,
//! distances by another formula, sampled densely), and a planner of another method (a probabilistic
//! roadmap) with 100 times the steps.

use crate::bench::blends::BlendFigures;
use crate::bench::motion_model::{roadmap, rod};
use crate::pair::thin_arm::{THINNER_M, ThinModel};
use cell_motion::bodies::cell::{CellBodies, NamedShape};
use cell_motion::bodies::shape::Shape;
use cell_motion::bodies::sweep::Sweep;
use cell_motion::bodies::{Bodies, Room, Standing, Surroundings};
use cell_motion::path::ArmModel;
use cell_motion::pick_n_place::{CycleParameters, PickNPlace, plan, tool_down};
use cell_motion::reach::reaches;
use cell_motion::way::{NoWay, Search, find};
use cell_values::units::Joints;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rearrange::geometry::footprint::Footprint;
use rearrange::geometry::pose::Pose2;
use std::time::Instant;
use ur_arm::bodies::Capsule;
use ur_arm::kinematics::{ARM_MODELS, DhParameters, Kinematics, pose_error};

/// How much is measured.
#[derive(Clone, Copy, Debug)]
pub struct MotionCases {
    /// Poses of each arm model.
    pub poses: usize,
    /// Random joint moves that are accepted, and as many that are free by 30 mm.
    pub moves: usize,
    /// Random starts of ways.
    pub starts: usize,
    /// Steps of the other planner.
    pub roadmap_steps: usize,
    /// Of all random choices.
    pub seed: u64,
}

/// What was measured. Fields that end in `_us` and `_ms` are means, `way_ms` is a median; the first are
/// means over the demo's scenes ([`crate::bench::cycle`]), `None` where they were not measured.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct MotionFigures {
    /// Seconds of a pick-n-place at the limits of config/cell.yaml.
    pub cycle_s: Option<f64>,
    /// The same at fast limits, without the scene whose heaviest part is at the limit of its cup.
    pub cycle_fast_s: Option<f64>,
    /// That scene's.
    pub cycle_fast_heavy_s: Option<f64>,
    /// Against a naive script.
    pub cycle_vs_naive: Option<f64>,
    /// Against a lower bound.
    pub cycle_vs_bound: Option<f64>,
    /// Seconds by the speed at which the arm passes blends, in fewer jobs ([`crate::bench::blends`]).
    pub blends: Vec<BlendFigures>,
    /// Share of it during which the arm rests, and neither for a picture nor for the vacuum.
    pub idle_fraction: Option<f64>,
    /// Stops for pictures of each, looks at the whole table not counted.
    pub pictures_per_move: Option<f64>,
    /// All branches of a pose of a nominal arm.
    pub ik_us: f64,
    /// The same of a calibrated arm.
    pub ik_calibrated_us: f64,
    /// Largest pose error of forward(inverse(pose)), m and rad together, over all models.
    pub ik_worst: f64,
    /// Poses for which no joints were found.
    pub ik_missed: usize,
    /// Poses, off the singularities, without the very joints they were made from.
    pub ik_branches_missed: usize,
    /// Paths of one pick-n-place, planned and checked with 40 objects on the table.
    pub check_us: f64,
    /// Whether each start and goal of 40 objects and 100 buffer poses can be reached.
    pub reach_ms: f64,
    /// Random joint moves that were accepted.
    pub accepted: usize,
    /// Of them, those on which the model of this file's own finds two bodies in each other.
    pub accepted_but_meeting: usize,
    /// Share of moves that are free by 30 mm in that model, which are accepted.
    pub free_accepted_fraction: f64,
    /// Median of finding a way from a random start to a look pose.
    pub way_ms: f64,
    /// Longest search.
    pub way_worst_ms: f64,
    /// Ways found, of those that either planner finds.
    pub ways_found_fraction: f64,
    /// Starts from which a way was found, found by the other planner only, found by none, and starts that
    /// are not free themselves.
    pub ways: [usize; 4],
}

/// The cell that is measured.
pub struct Subject {
    /// The arm with its bodies.
    pub model: ArmModel,
    /// Heights and speeds.
    pub cycle: CycleParameters,
    /// Where the arm looks from.
    pub look: Joints,
    /// Width and depth of the table, m.
    pub table: [f64; 2],
}

/// All figures; `said` is called with each as it is there.
pub fn measure(subject: &Subject, cases: MotionCases, said: &dyn Fn(&str)) -> MotionFigures {
    let mut figures = MotionFigures::default();
    kinematics(&mut figures, cases);
    said(&format!("kinematics of {} arms, {} poses each", ARM_MODELS.len(), cases.poses));
    checks(&mut figures, subject, cases.seed);
    said("pick-n-places with 40 objects on the table, reach of 180 poses");
    moves(&mut figures, subject, cases);
    said(&format!("{} random moves against the other model", 2 * cases.moves));
    ways(&mut figures, subject, cases);
    said(&format!("ways from {} random starts", cases.starts));
    figures
}

/// Joints anywhere within half a turn.
fn random_joints(random: &mut ChaCha8Rng) -> Joints {
    Joints(std::array::from_fn(|_| random.random_range(-3.1..3.1)))
}

/// Inverse kinematics of all models, nominal and calibrated.
pub fn kinematics(figures: &mut MotionFigures, cases: MotionCases) {
    let mut random = ChaCha8Rng::seed_from_u64(cases.seed);
    let (mut nominal_s, mut calibrated_s) = (0.0, 0.0);
    for arm in ARM_MODELS {
        let mut calibrated = arm.dh;
        for i in 0..6 {
            calibrated.a[i] += random.random_range(-5e-4..5e-4);
            calibrated.d[i] += random.random_range(-5e-4..5e-4);
            calibrated.alpha[i] += random.random_range(-1e-3..1e-3);
            calibrated.theta[i] += random.random_range(-1e-3..1e-3);
        }
        nominal_s += round_trips(figures, &arm.dh, cases.poses, &mut random);
        calibrated_s += round_trips(figures, &calibrated, cases.poses / 10, &mut random);
    }
    let poses = (ARM_MODELS.len() * cases.poses) as f64;
    figures.ik_us = 1e6 * nominal_s / poses;
    figures.ik_calibrated_us = 1e7 * calibrated_s / poses;
}

/// Seconds of the inverse alone.
fn round_trips(figures: &mut MotionFigures, dh: &DhParameters, poses: usize, random: &mut ChaCha8Rng) -> f64 {
    let joints: Vec<Joints> = (0..poses).map(|_| random_joints(random)).collect();
    let arm = Kinematics::of(dh);
    let targets: Vec<_> = joints.iter().map(|q| arm.forward(q)).collect();
    let began = Instant::now();
    let found: Vec<Vec<Joints>> = targets.iter().map(|target| arm.inverse(target)).collect();
    let seconds = began.elapsed().as_secs_f64();
    for ((q, target), solutions) in joints.iter().zip(&targets).zip(&found) {
        let worst = solutions.iter().map(|q| pose_error(&arm.forward(q), target).norm());
        figures.ik_worst = worst.fold(figures.ik_worst, f64::max);
        figures.ik_missed += usize::from(solutions.is_empty());
        // Near a singularity joints trade places freely, and only the pose counts.
        let singular = [q.0[4].sin(), q.0[2].sin()].iter().any(|sine| sine.abs() < 0.02);
        let there = solutions.iter().any(|found| found.max_difference(q) < 1e-3);
        figures.ik_branches_missed += usize::from(!(there || singular));
    }
    seconds
}

/// `count` flat discs in rows on the table.
fn discs(table: [f64; 2], count: usize) -> Vec<Standing> {
    let columns = (count as f64).sqrt().ceil() as usize;
    let rows = count.div_ceil(columns);
    let at = |k: usize, of: usize, length: f64| length * (k as f64 + 0.5) / of as f64;
    let disc = |k: usize| Standing {
        name: format!("disc-{k}"),
        footprint: Footprint::Disc { radius: 0.025 },
        pose: Pose2::new(at(k % columns, columns, table[0]), at(k / columns, rows, table[1]), 0.0),
        height: 0.02,
    };
    (0..count).map(disc).collect()
}

fn task(from: &Standing, to: Pose2) -> PickNPlace {
    PickNPlace {
        object: from.name.clone(),
        footprint: from.footprint.clone(),
        from: from.pose,
        to,
        grip_point: [0.0, 0.0],
        grip_yaw: None,
        height: from.height,
        hold: 20.0,
    }
}

fn checks(figures: &mut MotionFigures, subject: &Subject, seed: u64) {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let (model, cycle) = (&subject.model, &subject.cycle);
    let all = discs(subject.table, 41);
    let anywhere = |random: &mut ChaCha8Rng| {
        let [x, y] = subject.table.map(|length| random.random_range(0.05..length - 0.05));
        Pose2::new(x, y, random.random_range(-3.1..3.1))
    };
    let mut at = subject.look;
    let (mut planned, mut seconds) = (0, 0.0);
    for k in 0..200 {
        let moved = &all[k % all.len()];
        let standing = all.iter().filter(|disc| disc.name != moved.name).cloned().collect();
        let table = cycle.tabletop(standing);
        let task = task(moved, anywhere(&mut random));
        let began = Instant::now();
        if let Ok(paths) = plan(model, &at, &task, cycle, &table) {
            seconds += began.elapsed().as_secs_f64();
            planned += 1;
            at = paths.retreat.end();
        }
    }
    figures.check_us = 1e6 * seconds / f64::from(planned.max(1));
    let began = Instant::now();
    let goals = all.iter().take(40).flat_map(|disc| [disc.pose, anywhere(&mut random)]);
    let poses: Vec<Pose2> = goals.collect();
    let buffers = (0..100).map(|_| anywhere(&mut random));
    let task = task(&all[0], all[0].pose);
    let count = poses.into_iter().chain(buffers).filter(|pose| reaches(model, &task, pose, cycle).is_ok());
    std::hint::black_box(count.count());
    figures.reach_ms = 1e3 * began.elapsed().as_secs_f64();
}

/// The arm with a rod in place of its gripper, which the other model has too, thinner.
fn with_a_rod(model: &ArmModel, table: [f64; 2]) -> Bodies {
    let mut cell = CellBodies::bare();
    let Capsule { a, b, radius } = rod(model);
    cell.tool.push(NamedShape { name: "the rod".to_string(), shape: Shape::capsule(a, b, radius) });
    let (base_from_table, flange_from_tool) = (model.base_from_table, model.flange_from_tool);
    Bodies::new(
        model.kinematics.dh(),
        &Surroundings { base_from_table, flange_from_tool, table, link_floor: 0.0, cell },
    )
}

/// The same rod in the other model.
fn thin_rod(model: &ArmModel) -> Capsule {
    let rod = rod(model);
    Capsule { radius: rod.radius - THINNER_M, ..rod }
}

/// Random joint moves, against another model of the arm.
pub fn moves(figures: &mut MotionFigures, subject: &Subject, cases: MotionCases) {
    let mut random = ChaCha8Rng::seed_from_u64(cases.seed ^ 0x5eed);
    let thin = ThinModel::of(&subject.model, thin_rod(&subject.model));
    let (room, plain) = (Room::empty(), with_a_rod(&subject.model, subject.table));
    let (mut free, mut free_accepted, mut tried) = (0, 0, 0);
    let mut sweep = Sweep::new(&plain, &room);
    while (figures.accepted < cases.moves || free < cases.moves) && tried < 400 * cases.moves {
        tried += 1;
        let from = random_joints(&mut random);
        let stretch = random.random_range(0.05..1.5);
        let to = Joints(from.0.map(|value| value + random.random_range(-stretch..stretch)));
        let is_free = free < cases.moves && thin.keeps(0.03, &from, &to, 0.05);
        if !is_free && figures.accepted == cases.moves {
            continue;
        }
        let accepted = sweep.way(&from, &to).is_ok();
        if accepted && figures.accepted < cases.moves {
            figures.accepted += 1;
            figures.accepted_but_meeting += usize::from(!thin.keeps(0.0, &from, &to, 0.02));
        }
        if is_free {
            free += 1;
            free_accepted += usize::from(accepted);
        }
    }
    figures.free_accepted_fraction = free_accepted as f64 / free.max(1) as f64;
}

/// Steps of the search that is measured; the other planner gets 100 times as many.
pub const WAY_STEPS: usize = 1500;

/// Ways from random starts to a look pose.
pub fn ways(figures: &mut MotionFigures, subject: &Subject, cases: MotionCases) {
    let mut random = ChaCha8Rng::seed_from_u64(cases.seed ^ 0xa11);
    let model = &subject.model;
    let table = subject.cycle.tabletop(Vec::new());
    let room = Room::new(&model.bodies, &table, None);
    let mut times = Vec::new();
    let [found, other_only, none, not_free] = &mut figures.ways;
    for k in 0..cases.starts {
        let range = model.limits.joint_range;
        let start = Joints(std::array::from_fn(|j| random.random_range(range[j].0..range[j].1)));
        let target = model.unwound(&subject.look, &start).unwrap_or(subject.look);
        let began = Instant::now();
        let way = find(model, &room, &start, &target, Search { seed: 1, steps: WAY_STEPS });
        let seconds = began.elapsed().as_secs_f64();
        match way {
            Err(NoWay::Start(_)) => {
                *not_free += 1;
                continue;
            }
            Ok(_) => *found += 1,
            Err(_) => {
                let seed = cases.seed.wrapping_add(k as u64);
                let exists = roadmap(model, &room, &start, &target, cases.roadmap_steps, seed);
                *(if exists { &mut *other_only } else { &mut *none }) += 1;
            }
        }
        times.push(1e3 * seconds);
    }
    times.sort_by(f64::total_cmp);
    figures.way_ms = times.get(times.len() / 2).copied().unwrap_or(0.0);
    figures.way_worst_ms = times.last().copied().unwrap_or(0.0);
    figures.ways_found_fraction = *found as f64 / (*found + *other_only).max(1) as f64;
}

/// The demo's arm at its table, from which the figures are taken.
pub fn subject(model: ArmModel, cycle: CycleParameters, table: [f64; 2]) -> Subject {
    let over = tool_down(table[0] / 2.0, table[1] / 2.0, 0.3, 0.0);
    let look = model.joints_in_work_posture(&over, &model.home).unwrap_or(model.home);
    Subject { model, cycle, look, table }
}

/// The figures for people, with what is aimed at.
pub fn table(figures: &MotionFigures) -> String {
    let row = |what: &str, value: String, aim: &str| format!("{what:<58} {value:>12}   {aim}\n");
    let [found, other, none, not_free] = figures.ways;
    [
        row("inverse kinematics, nominal, all branches, us", format!("{:.2}", figures.ik_us), "under 2"),
        row("  calibrated, us", format!("{:.2}", figures.ik_calibrated_us), "under 20"),
        row("  largest error of forward(inverse(pose))", format!("{:.1e}", figures.ik_worst), "1e-9"),
        row("  poses without joints", figures.ik_missed.to_string(), "0"),
        row("  poses without the joints they came from", figures.ik_branches_missed.to_string(), ""),
        row("a pick-n-place with 40 objects, us", format!("{:.0}", figures.check_us), "under 3000"),
        row("reach of 180 poses, ms", format!("{:.1}", figures.reach_ms), "under 30"),
        row("random moves accepted", figures.accepted.to_string(), ""),
        row("  that meet in the other model", figures.accepted_but_meeting.to_string(), "0"),
        row(
            "  of those free by 30 mm in it, accepted",
            format!("{:.3}", figures.free_accepted_fraction),
            "0.95",
        ),
        row("a way from a random start, median ms", format!("{:.1}", figures.way_ms), "under 50"),
        row("  longest, ms", format!("{:.0}", figures.way_worst_ms), ""),
        row(
            "  share found of those that either planner finds",
            format!("{:.3}", figures.ways_found_fraction),
            "0.99",
        ),
        format!(
            "  found {found}, by the other planner only {other}, by none {none}, start not free {not_free}\n"
        ),
    ]
    .concat()
}
