//! Looks at parts of the table in the closed loop: nothing that a hand moved is picked where it was, the
//! time of a job adds up, a slow disk costs nothing while the arm moves, and a scene is as quick as its
//! bound allows.

use cell_machine::code::Code;
use cell_machine::orders::Order;
use cell_machine::supervisor::order::JobOrder;
use cell_machine::times::Use;
use celld::bench::cycle::{CycleRun, FAST, USUAL, cell_of, order_of, run};
use celld::pair::camera_view::SightKind;
use celld::pair::disk::Mood;
use celld::pair::hands::hands;
use celld::pair::run::{bring_up, true_poses};
use celld::pair::table::stage;
use celld::pair::work::job;
use celld::pair::{Choice, Pair};
use rayon::iter::{IntoParallelIterator, ParallelIterator};
use rearrange::planning::plan::Objective;

/// `celld simulate --faults hands` runs as many as there is time for.
#[test]
fn nothing_is_picked_where_a_picture_since_a_hand_would_have_shown_that_it_is_not() {
    let wrong: Vec<String> = (0..24_u64)
        .into_par_iter()
        .flat_map_iter(|seed| {
            let (faults, _) = hands(&stage(seed, SightKind::Corners).unwrap(), seed, false).unwrap();
            faults.into_iter().map(move |fault| format!("seed {seed}: {fault}"))
        })
        .collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// One job with a disk of this mood from its first look on.
fn one_job(seed: u64, mood: Mood) -> Pair {
    let stage = stage(seed, SightKind::Corners).expect("a stage");
    let mut pair = Pair::new(stage.clone(), Choice::of(seed)).expect("a pair");
    assert!(bring_up(&mut pair));
    pair.order(Order::Arm);
    pair.submit(job(&stage.model, &true_poses(&pair, &stage.model), seed, 0));
    assert!(pair.run_until(60.0, |pair| pair.status().is_some_and(|now| now.text().starts_with("looking"))));
    pair.disk().mood = mood;
    assert!(pair.run_until(300.0, |pair| !pair.reports().is_empty()), "seed {seed}");
    assert_eq!((pair.reports()[0].code, pair.breaches()), (Code::Done, &[][..]), "seed {seed}");
    pair
}

#[test]
fn the_seconds_of_a_job_add_up_and_a_slow_disk_costs_nothing_while_the_arm_moves() {
    for seed in 0..4 {
        let pair = one_job(seed, Mood::Fine);
        let report = &pair.reports()[0];
        let total = report.times.total();
        assert!((total.total_s() - report.seconds).abs() < 0.1, "seed {seed}: {total:?}, {}", report.seconds);
        assert_eq!(report.times.moves.len(), report.moves);
        for split in &report.times.moves {
            for what in [Use::Travel, Use::Vertical, Use::Vacuum] {
                assert!(split.of(what) > 0.1, "seed {seed}: {what} {split:?}");
            }
            assert!(split.of(Use::Settle) < 0.2 && split.idle_s() < 1.0, "seed {seed}: {split:?}");
        }
        // Only what is written before the first pick is waited for.
        let slow = one_job(seed, Mood::Slow(0.3));
        let waited = |pair: &Pair| -> Vec<f64> {
            pair.reports()[0].times.moves.iter().map(|split| split.of(Use::Disk)).collect()
        };
        let (fine, slow) = (waited(&pair), waited(&slow));
        assert!((slow[0] - fine[0] - 0.29).abs() < 0.05, "seed {seed}: {slow:?}");
        assert!(slow[1..].iter().all(|seconds| *seconds < 0.02), "seed {seed}: {slow:?}");
    }
}

/// A plan by time that the search had no time to make a good one: the rest becomes better while the arm
/// moves, and what is carried out brings every object to its goal.
#[test]
fn the_rest_of_a_plan_becomes_better_while_the_arm_moves() {
    let choice = Choice { plan_work: 4000, ..Choice::of(4) };
    let (mut pair, instance) = cell_of(&FAST, "planks", choice).expect("a cell");
    pair.order(Order::Arm);
    pair.submit(JobOrder { objective: Objective::Time, ..order_of(&instance, 4) });
    assert!(pair.run_until(600.0, |pair| !pair.reports().is_empty()));
    let report = &pair.reports()[0];
    assert_eq!((report.code, pair.breaches()), (Code::Done, &[][..]), "{report:?}");
    let said = pair.notices().iter().map(|notice| notice.text.as_str());
    let better = said.filter(|text| text.starts_with("a better rest of the plan")).count();
    let planned = report.planned.expect("a plan").0;
    assert!(better > 0 && report.moves <= planned, "{better}: {} of {planned}", report.moves);
}

#[test]
fn a_pick_n_place_takes_little_more_than_its_bound_and_far_less_than_a_naive_script() {
    for pace in [USUAL, FAST] {
        let CycleRun { fault, moves, times, naive_s, bound_s, errors_mm, errors_deg } =
            run(&pace, "tetris-heart", 3).unwrap();
        assert_eq!(fault, None);
        let each = |seconds: f64| seconds / moves as f64;
        let seconds = times.in_moves().total_s();
        println!(
            "{}: {:.2} s, naive {:.2}, bound {:.2}",
            pace.name,
            each(seconds),
            each(naive_s),
            each(bound_s)
        );
        assert!(bound_s < seconds && seconds < 1.3 * bound_s && seconds < 0.75 * naive_s, "{}", pace.name);
        assert!(f64::from(times.stops) < 1.2 * moves as f64, "{} stops", times.stops);
        assert!(errors_mm.iter().all(|mm| *mm < 2.0) && errors_deg.iter().all(|deg| *deg < 1.0));
    }
}
