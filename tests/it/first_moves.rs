//! The first move from wherever the arm was left, and plans that the arm can carry out, in virtual time.
//! The rules of the loop hold the arm against a model of their own while it moves.

use cell_machine::code::JobStatus;
use cell_machine::orders::Order;
use cell_machine::supervisor::order::JobReport;
use cell_motion::bodies::cell::NamedShape;
use cell_motion::bodies::shape::Shape;
use cell_values::units::Joints;
use celld::pair::camera_view::SightKind;
use celld::pair::run::{bring_up, true_poses};
use celld::pair::stage::Stage;
use celld::pair::table::stage;
use celld::pair::work::job;
use celld::pair::{Choice, Pair};
use rand::{RngExt, SeedableRng};
use rearrange::geometry::pose::Pose2;

/// A cell whose arm was left like this.
fn left_at(stage: &Stage, start: Joints) -> Pair {
    let mut stage = stage.clone();
    stage.controller.start = start;
    let mut pair = Pair::new(stage, Choice { eye: SightKind::Corners, ..Choice::of(1) }).expect("a cell");
    assert!(bring_up(&mut pair));
    pair
}

/// Arms, with a job waiting; whether the first look comes about, or why not.
fn looks(pair: &mut Pair, stage: &Stage) -> Result<(), Box<JobReport>> {
    pair.submit(job(&stage.model, &true_poses(pair, &stage.model), 1, 0));
    pair.order(Order::Arm);
    let looked = |pair: &Pair| pair.status().is_some_and(|now| now.text().starts_with("planning"));
    let over = |pair: &Pair| !pair.reports().is_empty();
    assert!(pair.run_until(180.0, |pair| looked(pair) || over(pair)), "{:?}", pair.status());
    assert_eq!(pair.breaches(), []);
    match pair.reports().last() {
        Some(report) if report.moves == 0 && report.end == JobStatus::Failed => Err(Box::new(report.clone())),
        _ => Ok(()),
    }
}

fn turned_m(pair: &Pair, joint: usize) -> f64 {
    pair.simulator().core().robot.controller().core.mover.q().0[joint]
}

#[test]
fn a_base_that_was_left_wound_up_does_not_sweep_round() {
    let stage = stage(1, SightKind::Corners).expect("a cell");
    let mut start = stage.model.park;
    start.0[0] += std::f64::consts::TAU;
    let mut pair = left_at(&stage, start);
    pair.submit(job(&stage.model, &true_poses(&pair, &stage.model), 1, 0));
    pair.order(Order::Arm);
    let mut least = f64::INFINITY;
    let done = pair.run_until(200.0, |pair| {
        least = least.min(turned_m(pair, 0));
        !pair.reports().is_empty()
    });
    assert!(done && pair.reports()[0].message.contains("goal"), "{:?}", pair.reports());
    assert!(least > start.0[0] - 1.5, "the base turned back by {} rad", start.0[0] - least);
    assert_eq!(pair.breaches(), []);
}

#[test]
fn from_a_folded_wrist_the_arm_finds_its_way_or_stays() {
    let stage = stage(1, SightKind::Corners).expect("a cell");
    let folded = Joints([-30.2, -136.8, 129.9, 36.4, -92.1, -70.0].map(f64::to_radians));
    let mut pair = left_at(&stage, folded);
    looks(&mut pair, &stage).expect("there is a way round the upper arm");
}

#[test]
fn from_random_places_the_arm_goes_a_free_way_or_stays_and_says_what_is_near() {
    let stage = stage(1, SightKind::Corners).expect("a cell");
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(17);
    let (mut gone, mut stayed, mut jogged) = (0, 0, 0);
    for case in 0..30 {
        let mut start = Joints(std::array::from_fn(|_| random.random_range(-6.2..6.2)));
        start.0[2] = random.random_range(-2.9..2.9);
        let mut pair = left_at(&stage, start);
        match looks(&mut pair, &stage) {
            Ok(()) => gone += 1,
            Err(report) => {
                let JobReport { message, hint, .. } = *report;
                stayed += 1;
                if let Some(after) = after_the_jog(&start, &hint) {
                    jogged += 1;
                    if let Err(again) = looks(&mut left_at(&stage, after), &stage) {
                        let still = again.message.contains("where the arm is");
                        assert!(!still, "case {case}: {hint}, then: {}", again.message);
                    }
                }
                let q = pair.simulator().core().robot.controller().core.mover.q();
                assert!(q.max_difference(&start) < 1e-3, "case {case}: it moved, then: {message}");
                let says = ["too near", "meet", "cannot be reached", "no free way", "out of the arm's reach"];
                assert!(says.iter().any(|part| message.contains(part)), "case {case}: {message}");
            }
        }
    }
    assert!(gone > 3 && stayed > 3 && jogged > 3, "{gone} gone, {stayed} stayed, {jogged} jogged");
}

/// Where the arm is after a person has done what a hint says: "jog Wrist 1 by +12 degrees".
fn after_the_jog(start: &Joints, hint: &str) -> Option<Joints> {
    let (joint, by) = hint.strip_prefix("jog ")?.split_once(" degrees")?.0.split_once(" by ")?;
    let names = ["Base", "Shoulder", "Elbow", "Wrist 1", "Wrist 2", "Wrist 3"];
    let joint = names.iter().position(|name| *name == joint)?;
    let mut after = *start;
    after.0[joint] += by.parse::<f64>().expect("degrees").to_radians();
    Some(after)
}

#[test]
fn a_job_out_of_reach_fails_before_its_first_move_and_names_object_and_place() {
    let mut stage = stage(1, SightKind::Corners).expect("a cell");
    // A feeder hangs over the far right corner of the table: the gripper cannot come down there.
    let far = Pose2::new(0.33, 0.33, 0.0);
    let at = stage.model.arm.base_from_table * far.at_height(0.25);
    let feeder = NamedShape { name: "the feeder".to_string(), shape: Shape::cuboid([0.12, 0.12, 0.1], &at) };
    stage.model.arm.bodies = stage.model.arm.bodies.clone().with(&feeder);
    let mut pair = left_at(&stage, stage.model.park);
    let mut order = job(&stage.model, &true_poses(&pair, &stage.model), 1, 0);
    let moved = order.goals[0].0.clone();
    order.goals = vec![(moved.clone(), far)];
    pair.submit(order);
    pair.order(Order::Arm);
    assert!(pair.run_until(200.0, |pair| !pair.reports().is_empty()));
    let report = &pair.reports()[0];
    assert!(report.moves == 0 && report.message.contains(&moved), "{report:?}");
    assert!(report.message.contains("its goal") && report.message.contains("the feeder"), "{report:?}");
    assert_eq!(pair.breaches(), []);
}
