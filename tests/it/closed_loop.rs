//! The whole cell in virtual time: repeatable, as the page of reactions says, and the same with both eyes.

use cell_machine::orders::Order;
use cell_machine::supervisor::round::RoundOrder;
use cell_machine::supervisor::status::Doing;
use cell_motion::slow::CalibrationBox;
use celld::pair::camera_view::SightKind;
use celld::pair::endurance::{Course, Period, endurance};
use celld::pair::network::Weather;
use celld::pair::orders::{self, ORDERS_SEED};
use celld::pair::orders_page;
use celld::pair::outcome::Phase;
use celld::pair::page::{PAGE, PAGE_SEED, expected, title};
use celld::pair::reactions::{ROWS, Row};
use celld::pair::run::{bring_up, run_jobs, true_poses};
use celld::pair::shell_jobs::shell_job;
use celld::pair::stage::Stage;
use celld::pair::storm::{storm, strikes};
use celld::pair::sweep::{case, cases, judge};
use celld::pair::table::stage;
use celld::pair::work::job;
use celld::pair::worst::worst;
use celld::pair::{Choice, Pair};
use rayon::iter::{IntoParallelRefIterator, ParallelIterator};
use rearrange::document::chain::chain;
use rearrange::geometry::pose::Pose2;
use std::collections::BTreeSet;
use ur_arm::links::{farthest_apart, model_of};
use ur_sim::faults::read::read_posted;
use ur_sim::motion::rest::{RestConfig, Stop};
use ur_sim::motion::rounding::{BlendConfig, ENTRY_SPEEDS, EntrySpeed};

#[test]
fn a_seed_gives_the_same_run_twice_and_another_seed_another() {
    let mut prints = Vec::new();
    for seed in 0..6 {
        let stage = stage(seed, SightKind::Corners).unwrap();
        let once = || run_jobs(&stage, Choice::of(seed), 1, &[], &mut |_| {}).unwrap().0;
        let (first, second) = (once(), once());
        assert_eq!(first, second, "seed {seed}");
        assert!(first.is_clean() && first.jobs == 1, "seed {seed}: {first:?}");
        prints.push(first.fingerprint);
    }
    prints.sort_unstable();
    prints.dedup();
    assert_eq!(prints.len(), 6);
}

#[test]
fn no_rule_is_broken_at_any_blend_speed() {
    for seed in [1, 100] {
        let run = |entry_speed: EntrySpeed| {
            let mut stage = stage(seed, SightKind::Corners).unwrap();
            stage.controller.blends = BlendConfig { entry_speed, seed };
            let (summary, _) = run_jobs(&stage, Choice::of(seed), 2, &[], &mut |_| {}).unwrap();
            assert!(summary.is_clean() && summary.jobs == 2, "{entry_speed:?}, seed {seed}: {summary:?}");
            summary.fingerprint
        };
        let [braked, kept, scaled, raised] =
            [EntrySpeed::Braked, EntrySpeed::Kept, EntrySpeed::Scaled, EntrySpeed::Raised].map(run);
        assert!(braked != kept && kept != raised && raised != braked, "seed {seed}");
        assert_eq!(kept, scaled, "seed {seed}: no speed that is kept has to be lowered");
    }
}

/// Each thing that the seed decides comes both ways within a few seeds, and the rest is always there.
#[test]
fn the_worst_controller_is_as_bad_as_its_page_says() {
    let mut speeds = BTreeSet::new();
    let (mut claims, mut boxes, mut half_open_s) = (0, BTreeSet::new(), 0.0f64);
    for seed in 0..20 {
        let mut stage = stage(seed, SightKind::Corners).unwrap();
        worst(&mut stage, seed).unwrap();
        speeds.insert(format!("{:?}", stage.controller.blends.entry_speed));
        claims += stage.at_start.len();
        boxes.insert(format!("{:?}", stage.world.gripper.clients.second));
        half_open_s = half_open_s.max(stage.world.gripper.clients.half_open_s);
        let RestConfig { stop, speed_noise, position_noise } = stage.controller.rest;
        assert!(stop == Stop::Creeping && speed_noise > 0.0 && position_noise > 0.0);
        assert!(stage.controller.loads_for_s == 2.0 && stage.world.gripper.overshoot == 0.11);
        assert_eq!(stage.weather, Weather::WORST);
    }
    assert_eq!(speeds.len(), 4);
    assert!((1..20).contains(&claims) && boxes.len() == 3, "{claims} {boxes:?}");
    assert!(half_open_s > 10.0, "{half_open_s} s");
}

/// What `--faults sweep` and `--orders` do, with the worst controller of one seed after the other: some of
/// the cases in each run.
#[test]
fn no_case_breaks_a_rule_with_the_worst_controller() {
    let worst_cell = |number: usize| {
        let mut stage = stage(number as u64, SightKind::Corners).unwrap();
        worst(&mut stage, number as u64).unwrap();
        stage
    };
    let some: Vec<_> = cases().enumerate().filter(|(number, _)| chosen(*number, 40)).collect();
    let reactions = some.par_iter().filter_map(|(number, (row, phase))| {
        let (outcome, _) = case(&worst_cell(*number), row, *phase, PAGE_SEED, false).unwrap();
        let faults = judge(row, *phase, &outcome, None);
        (!faults.is_empty()).then(|| format!("worst {number}, {}: {faults:?}", title(row, *phase)))
    });
    let some: Vec<_> = orders::cases().enumerate().filter(|(number, _)| chosen(*number, 40)).collect();
    let answers = some.par_iter().filter_map(|(number, (state, given))| {
        let found = orders::case(&worst_cell(*number), state, given).unwrap();
        let faults = orders::judge(given, &found);
        let title = orders_page::title(state, given);
        (!faults.is_empty()).then(|| format!("worst {number}, {title}: {faults:?}"))
    });
    let wrong: Vec<String> = reactions.chain(answers).collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// `celld simulate --faults random` with each blend speed, without blends, and with the worst controller.
#[test]
fn no_random_job_breaks_a_rule_with_any_controller() {
    type Change = Box<dyn Fn(&mut Stage, u64) + Sync>;
    let mut changes: Vec<(&str, Change)> = vec![
        ("none", Box::new(|stage, _| stage.model.cycle.blend = 0.0)),
        ("worst", Box::new(|stage, seed| worst(stage, seed).unwrap())),
    ];
    for (name, entry_speed) in ENTRY_SPEEDS {
        let blend = |stage: &mut Stage, seed| {
            stage.controller.blends = BlendConfig { entry_speed: *entry_speed, seed };
        };
        changes.push((*name, Box::new(blend)));
    }
    let seeds = (0..64).filter(|seed| chosen(*seed as usize, 8));
    let runs: Vec<_> = seeds.flat_map(|seed| changes.iter().map(move |change| (seed, change))).collect();
    let wrong: Vec<String> = runs
        .par_iter()
        .flat_map_iter(|(seed, (name, change))| {
            let mut stage = stage(*seed, SightKind::Corners).unwrap();
            change(&mut stage, *seed);
            let (aftermath, _) = storm(&stage, Choice::of(*seed), &strikes(*seed)).unwrap();
            aftermath.faults.into_iter().map(move |fault| format!("{name}, seed {seed}: {fault}"))
        })
        .collect();
    assert!(wrong.is_empty(), "part {}:\n{}", part(), wrong.join("\n"));
}

/// The simulated arm has a calibration of its own, as a real one; celld reads it from the controller.
#[test]
fn a_jobs_report_says_how_far_the_arm_is_from_a_nominal_one() {
    let stage = stage(3, SightKind::Corners).unwrap();
    let (_, pair) = run_jobs(&stage, Choice::of(3), 1, &[], &mut |_| {}).unwrap();
    let off_m = pair.reports()[0].links_off_m;
    let nominal = model_of(&stage.controller.dh).dh;
    assert_eq!(off_m, farthest_apart(&stage.controller.dh, &nominal));
    assert!((1e-3..0.02).contains(&off_m), "{off_m} m");
}

/// `celld simulate --controller worst`: every job ends, and only a silent link keeps one from being done.
#[test]
fn no_rule_is_broken_by_the_worst_controller() {
    for (seed, gaps) in (0..3).flat_map(|seed| [(seed, true), (seed, false)]) {
        let mut stage = stage(seed, SightKind::Corners).unwrap();
        worst(&mut stage, seed).unwrap();
        if !gaps {
            stage.weather.gap_share = 0.0;
        }
        let (summary, _) = run_jobs(&stage, Choice::of(seed), 2, &[], &mut |_| {}).unwrap();
        assert!(summary.is_clean() && summary.jobs == 2, "seed {seed}: {summary:?}");
        let expected: &[&str] = if gaps { &["done", "link_silent"] } else { &["done"] };
        assert!(
            summary.ends.keys().all(|code| expected.contains(&code.as_str())),
            "seed {seed}: {summary:?}"
        );
    }
}

#[test]
fn a_cell_that_works_on_through_faults_does_not_grow() {
    let stage = stage(21, SightKind::Corners).unwrap();
    let course = Course { periods: 6, period_s: 180.0, fault_every_s: 90.0 };
    let mut periods: Vec<Period> = Vec::new();
    let over = &mut |period: &Period| periods.push(period.clone());
    let (wrong, _) = endurance(&stage, Choice::of(21), course, over).unwrap();
    assert!(wrong.is_empty(), "{wrong:?}");
    let done = |period: &Period| period.ends.get("done").copied().unwrap_or(0) > 0;
    assert!(periods.len() == 6 && periods.iter().all(done), "work goes on after every fault: {periods:?}");
    assert!(periods.iter().all(|period| period.starts == 0), "by the same celld");
    // Between two jobs the machine differs by what a job leaves: names, where objects were seen last.
    let sizes: Vec<usize> = periods.iter().map(|period| period.machine_bytes).collect();
    assert!(sizes.iter().all(|size| size.abs_diff(sizes[0]) < 4096), "{sizes:?}");
}

#[test]
fn the_page_of_reactions_has_every_case_and_no_other() {
    let page = expected(PAGE);
    let titles: Vec<String> = cases().map(|(row, phase)| title(row, phase)).collect();
    for title in &titles {
        assert!(page.contains_key(title), "docs/reactions.md lacks {title}: see its second paragraph");
    }
    assert_eq!(page.len(), titles.len());
}

/// Of so many parts the cases of one run are one part: which, says CELLD_PART (`make test` takes it from the
/// commit, so that all come by in time); all with CELLD_ALL_CASES=1 (`make test-cases`).
fn chosen(number: usize, parts: usize) -> bool {
    std::env::var_os("CELLD_ALL_CASES").is_some() || (number + part()).is_multiple_of(parts)
}

fn part() -> usize {
    std::env::var("CELLD_PART").ok().and_then(|text| text.parse().ok()).unwrap_or(0)
}

/// What `celld simulate --faults sweep` does, which wrote the page: of the phases in which a fault can occur
/// a twelfth, and of the faults that can occur in a phase.
#[test]
fn every_fault_has_the_reaction_that_the_page_gives() {
    let stage = stage(PAGE_SEED, SightKind::Corners).unwrap();
    let page = expected(PAGE);
    let rows = ROWS.iter().enumerate();
    let cases: Vec<(&Row, Phase)> = rows
        .flat_map(|(number, row)| {
            let phases = row.phases.iter().enumerate();
            let phases = phases.filter(move |(phase, _)| chosen(number + phase, 12));
            phases.map(move |(_, phase)| (row, *phase))
        })
        .collect();
    let wrong: Vec<String> = cases
        .par_iter()
        .flat_map_iter(|(row, phase)| {
            let (outcome, _) = case(&stage, row, *phase, PAGE_SEED, false).unwrap();
            let faults = judge(row, *phase, &outcome, Some(&page));
            faults.into_iter().map(|fault| format!("{}: {fault}", title(row, *phase)))
        })
        .collect();
    assert!(wrong.is_empty(), "part {}:\n{}", part(), wrong.join("\n"));
}

/// What `celld simulate --orders` does.
#[test]
fn every_order_in_every_state_does_what_it_answers() {
    let stage = stage(ORDERS_SEED, SightKind::Corners).unwrap();
    let page = orders_page::expected(orders_page::PAGE);
    assert_eq!(page.len(), orders::cases().count(), "docs/orders.md: see its second paragraph");
    // Every fifth order of each state, and in the next state the ones after them.
    let of_a_state = orders::ORDERS.len();
    let numbered = orders::cases().enumerate();
    let picked = numbered.filter(|(number, _)| chosen(number / of_a_state + number % of_a_state, 5));
    let cases: Vec<_> = picked.map(|(_, case)| case).collect();
    let wrong: Vec<String> = cases
        .par_iter()
        .flat_map_iter(|(state, given)| {
            let found = orders::case(&stage, state, given).unwrap();
            let mut faults = orders::judge(given, &found);
            let title = orders_page::title(state, given);
            let line = orders_page::line(given, &found);
            if page.get(&title) != Some(&line) {
                faults.push(format!("found {line}, the page has {:?}", page.get(&title)));
            }
            faults.into_iter().map(move |fault| format!("{title}: {fault}"))
        })
        .collect();
    assert!(wrong.is_empty(), "part {}:\n{}", part(), wrong.join("\n"));
}

/// Singles, pairs and triples of faults; `celld simulate --faults random --jobs N` runs as many as there is
/// time for.
#[test]
fn no_rule_is_broken_and_no_job_lost_under_random_faults() {
    // The last ones once failed.
    let failed = [
        50_028, 51_167, 52_484, 4_000_099, 4_001_773, 4_003_777, 7_016_876, 12_000_037, 12_000_076,
        12_002_918,
    ];
    let seeds: Vec<u64> = (0..24).filter(|seed| chosen(*seed as usize, 2)).chain(failed).collect();
    let wrong: Vec<String> = seeds
        .par_iter()
        .flat_map_iter(|seed| {
            let stage = stage(*seed, SightKind::Corners).unwrap();
            let (aftermath, _) = storm(&stage, Choice::of(*seed), &strikes(*seed)).unwrap();
            aftermath.faults.into_iter().map(move |fault| format!("seed {seed}: {fault}"))
        })
        .collect();
    assert!(wrong.is_empty(), "part {}:\n{}", part(), wrong.join("\n"));
}

/// Orders that come late, twice or never, and a daemon that is held up: `celld simulate --faults shell` runs
/// as many as there is time for.
#[test]
fn no_rule_is_broken_and_no_order_is_late_beside_a_disturbed_shell() {
    let seeds: Vec<u64> = (0..48).filter(|seed| chosen(*seed as usize, 2)).collect();
    let wrong: Vec<String> = seeds
        .par_iter()
        .flat_map_iter(|seed| {
            let (faults, _) = shell_job(&stage(*seed, SightKind::Corners).unwrap(), *seed, false).unwrap();
            faults.into_iter().map(move |fault| format!("seed {seed}: {fault}"))
        })
        .collect();
    assert!(wrong.is_empty(), "part {}:\n{}", part(), wrong.join("\n"));
}

/// A program that is paused cannot be stopped by its registers, and not by a dashboard that does not answer:
/// a person who presses play later finds that it does not move on. Found by random faults.
#[test]
fn a_paused_program_does_not_move_on_after_a_stop() {
    const DASHBOARD: &str = r#"{"do": "net.timeout", "args": {"link": "dashboard", "seconds": 20}}"#;
    const RTDE: &str = r#"{"do": "net.reset_peer", "args": {"link": "rtde"}}"#;
    // Play comes before the stop is given up, or after the link to the registers was lost as well.
    for (seconds, faults) in [(2.5, [DASHBOARD].as_slice()), (12.0, &[DASHBOARD, RTDE])] {
        let stage = stage(7, SightKind::Corners).unwrap();
        let mut pair = Pair::new(stage.clone(), Choice::of(7)).unwrap();
        assert!(bring_up(&mut pair));
        pair.order(Order::Arm);
        pair.submit(job(&stage.model, &true_poses(&pair, &stage.model), 7, 0));
        let approaches = |pair: &Pair| pair.status().is_some_and(|now| now.text().starts_with("approaching"));
        assert!(pair.run_until(60.0, approaches));
        pair.run_until(0.3, |_| false);
        let pause = format!(r#"{{"do": "ur.pause", "args": {{"seconds": {seconds}}}}}"#);
        for text in [pause.as_str()].iter().chain(faults) {
            for planned in read_posted(text).unwrap() {
                pair.fault(planned).unwrap();
            }
        }
        pair.run_until(1.0, |_| false);
        let stood = pair.simulator().core().robot.controller().core.mover.q();
        pair.order(Order::Abort);
        pair.run_until(25.0, |_| false);
        let stands = pair.simulator().core().robot.controller().core.mover.q();
        assert_eq!(pair.breaches(), [], "{faults:?}");
        assert!(stood.max_difference(&stands) < 1e-3, "{faults:?}");
    }
}

/// A calibration round moves under the same rules as every other motion, and leaves the cell disarmed,
/// whatever happens on the way.
#[test]
fn a_calibration_round_ends_disarmed_whatever_happens() {
    const CAMERA: &str = r#"{"do": "camera.off"}"#;
    const CABLE: &str = r#"{"do": "net.reset_peer", "args": {"link": "rtde"}}"#;
    const SAFETY: &str = r#"{"do": "ur.pstop"}"#;
    let stage = stage(5, SightKind::Corners).unwrap();
    let poses = [stage.model.look_poses.clone(), vec![stage.model.park]].concat();
    for (fault, order) in [
        (None, None),
        (Some(CAMERA), None),
        (Some(CABLE), None),
        (Some(SAFETY), None),
        (None, Some(Order::Abort)),
    ] {
        let mut pair = Pair::new(stage.clone(), Choice::of(5)).unwrap();
        assert!(bring_up(&mut pair));
        pair.visit(RoundOrder::pictures(poses.clone(), None));
        let second =
            |pair: &Pair| pair.status().is_some_and(|now| matches!(now.doing, Doing::Visiting(2, _)));
        assert!(pair.run_until(120.0, second), "{:?}", pair.notices());
        pair.run_until(0.2, |_| false);
        for planned in fault.iter().flat_map(|text| read_posted(text).unwrap()) {
            pair.fault(planned).unwrap();
        }
        let ordered = order.is_some();
        if let Some(order) = order {
            pair.order(order);
        }
        assert!(pair.run_until(300.0, |pair| pair.round_over().is_some()), "{:?}", pair.notices());
        let sound = fault.is_none() && !ordered;
        assert_eq!(pair.round_over().unwrap().is_ok(), sound, "{fault:?}: {:?}", pair.round_over());
        let pictures = pair.camera_view().pictures().len();
        assert_eq!(pictures, if sound { poses.len() } else { 1 }, "{fault:?}");
        pair.run_until(10.0, |_| false);
        let playing = pair.simulator().core().robot.controller().programs.playing();
        assert!(!playing || !sound, "the program has ended");
        assert!(!pair.machine().supervisor().unwrap().mode().armed(), "{fault:?}");
        assert_eq!(pair.breaches(), [], "{fault:?}");
    }
}

/// Ctrl-C of `celld calibrate` is an abort: while a picture is taken the arm is at rest, and stays at rest.
#[test]
fn a_round_that_is_aborted_at_a_picture_leaves_the_arm_where_it_is() {
    let stage = stage(6, SightKind::Corners).unwrap();
    let mut pair = Pair::new(stage.clone(), Choice::of(6)).unwrap();
    assert!(bring_up(&mut pair));
    pair.visit(RoundOrder::pictures(stage.model.look_poses.clone(), None));
    let q = |pair: &Pair| pair.simulator().core().robot.controller().core.mover.q();
    let at_first = |pair: &Pair| q(pair).max_difference(&stage.model.look_poses[0]) < 1e-3;
    assert!(pair.run_until(120.0, at_first), "{:?}", pair.notices());
    pair.run_until(0.1, |_| false);
    let stood = q(&pair);
    pair.order(Order::Abort);
    assert!(pair.run_until(60.0, |pair| pair.round_over().is_some()), "{:?}", pair.notices());
    assert!(pair.round_over().unwrap().is_err());
    pair.run_until(10.0, |_| false);
    assert!(stood.max_difference(&q(&pair)) < 1e-4);
    assert_eq!(pair.breaches(), []);
}

#[test]
fn a_pose_outside_the_calibration_box_is_refused_and_the_arm_stays() {
    let stage = stage(6, SightKind::Corners).unwrap();
    let mut pair = Pair::new(stage.clone(), Choice::of(6)).unwrap();
    assert!(bring_up(&mut pair));
    let q = |pair: &Pair| pair.simulator().core().robot.controller().core.mover.q();
    let stood = q(&pair);
    let at = pair.simulator().core().robot.controller().core.base_from_flange().translation.vector;
    let [low_m, high_m] = [-0.01, 0.01].map(|by| [at.x + by, at.y + by, at.z + by]);
    let room = Some(CalibrationBox { low_m, high_m });
    pair.visit(RoundOrder::pictures(stage.model.look_poses.clone(), room));
    assert!(pair.run_until(60.0, |pair| pair.round_over().is_some()), "{:?}", pair.notices());
    let reported = pair.round_over().unwrap().as_ref().map_err(|error| chain(error)).unwrap_err();
    assert!(
        reported.contains("calibration pose 1") && reported.contains("outside the calibration box"),
        "{reported}"
    );
    pair.run_until(10.0, |_| false);
    assert!(stood.max_difference(&q(&pair)) < 1e-4 && pair.camera_view().pictures().is_empty());
    assert_eq!(pair.breaches(), []);
}

/// What the fast eye shows is what the detector would have found: within half a millimetre and half a
/// degree.
#[test]
fn both_eyes_see_the_same_table() {
    for seed in [3, 4] {
        let seen = [SightKind::Corners, SightKind::Pictures].map(|eye| observed(seed, eye).unwrap());
        let [corners, pictures] = &seen;
        assert_eq!(corners.len(), 6);
        assert_eq!(corners.len(), pictures.len());
        for (a, b) in corners.iter().zip(pictures) {
            assert_eq!(a.0, b.0);
            let apart_m = (a.1.x - b.1.x).hypot(a.1.y - b.1.y);
            assert!(apart_m < 0.5e-3, "seed {seed}: {} is {:.2} mm apart", a.0, apart_m * 1e3);
            let turned = (a.1.theta - b.1.theta).sin().abs();
            assert!(turned < 0.5f64.to_radians(), "seed {seed}: {} is turned by {turned}", a.0);
        }
    }
}

fn observed(seed: u64, eye: SightKind) -> Result<Vec<(String, Pose2)>, String> {
    let stage = stage(seed, SightKind::Corners)?;
    let choice = Choice { eye, ..Choice::of(seed) };
    let mut pair = Pair::new(stage.clone(), choice).map_err(|error| error.to_string())?;
    assert!(bring_up(&mut pair));
    pair.order(Order::Arm);
    pair.submit(job(&stage.model, &true_poses(&pair, &stage.model), seed, 0));
    let seen = |pair: &Pair| pair.machine().supervisor().and_then(|cell| cell.observation().cloned());
    assert!(pair.run_until(60.0, |pair| seen(pair).is_some()), "seed {seed}: nothing was seen");
    let seen = seen(&pair).ok_or("nothing was seen")?;
    let mut objects: Vec<_> = seen.objects.iter().map(|object| (object.id.clone(), object.pose)).collect();
    objects.sort_by(|a, b| a.0.cmp(&b.0));
    Ok(objects)
}
