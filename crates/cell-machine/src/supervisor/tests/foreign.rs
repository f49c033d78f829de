//! Things on the table that carry no marker: when nothing moves, and when they are driven round.

use super::*;

pub(super) fn thing(x: f64, y: f64, height_m: f64) -> ForeignObject {
    let outline =
        vec![[x - 0.03, y - 0.03], [x + 0.03, y - 0.03], [x + 0.03, y + 0.03], [x - 0.03, y + 0.03]];
    ForeignObject { outline, centre: [x, y], area_m2: 0.0036, height_m }
}

pub(super) fn report(objects: Vec<ForeignObject>, measured_share: f64) -> Option<ForeignReport> {
    Some(ForeignReport { objects, measured_share, ..ForeignReport::default() })
}

fn with(rule: ForeignRule, foreign: Option<ForeignReport>) -> Bench {
    let mut bench = Bench::new();
    bench.cell = Supervisor::new(CellModel { foreign: rule, ..model() }, 7);
    bench.foreign = foreign;
    bench
}

const REFUSE: ForeignRule = ForeignRule::Refuse { depth_needed: false };

/// Looks until the job ends or a plan is requested; the report of the job, and the request to the planner.
fn goes(bench: &mut Bench) -> Result<crate::supervisor::input::PlanRequest, (String, String, String)> {
    bench.job(false);
    let mut all = bench.until_planning();
    for _ in 0..4 {
        for action in &all {
            match action {
                Action::Plan(request) => return Ok((**request).clone()),
                Action::Commit { record: Record::Ended(report), .. } => {
                    return Err((report.code_text(), report.message.clone(), report.hint.clone()));
                }
                Action::Gripper(_) => panic!("the gripper was used: {all:?}"),
                _ => {}
            }
        }
        all = bench.look();
    }
    panic!("neither planned nor ended")
}

#[test]
fn a_foreign_object_is_refused_with_where_it_is_and_how_high() {
    let mut bench = with(REFUSE, report(vec![thing(0.212, 0.105, 0.094)], 0.99));
    bench.missing = vec!["b".into()];
    let (code, message, hint) = goes(&mut bench).unwrap_err();
    assert_eq!(code, "foreign_object");
    assert!(message.contains("94 mm high") && message.contains("x = 212 mm, y = 105 mm"), "{message}");
    assert!(message.contains("not seen: b") && hint.contains("take it away"), "{message} {hint}");
}

#[test]
fn what_only_its_colour_reveals_may_be_of_any_height_so_nothing_moves_over_it() {
    let thing = thing(0.212, 0.105, f64::INFINITY);
    let seen =
        ForeignReport { objects: vec![thing], measured_share: 0.99, holes: Vec::new(), by_colour: true };
    let mut bench = with(REFUSE, Some(seen));
    bench.job(false);
    let mut all = bench.until_planning();
    all.extend(bench.ticks(20));
    assert_eq!(streams(&all), 0, "{all:?}");
    assert_eq!(ended(&all), Some((JobStatus::Failed, "foreign_object".into())), "{all:?}");
    assert!(!bench.cell.status().armed, "a person has to look");
    bench.foreign = report(Vec::new(), 0.99);
    bench.feed(order(Order::Abort));
    bench.feed(Input::Robot(RobotEvent::Stopped));
    assert!(goes(&mut bench).is_ok(), "taken away and armed");
}

#[test]
fn taken_away_before_the_last_look_it_is_forgotten() {
    let mut bench = with(REFUSE, report(vec![thing(0.2, 0.1, 0.09)], 0.99));
    bench.job(false);
    let refused = bench.until_planning();
    assert!(!refused.iter().any(|action| matches!(action, Action::Plan(_))), "{refused:?}");
    bench.foreign = report(Vec::new(), 0.99);
    assert!(bench.look().iter().any(|action| matches!(action, Action::Plan(_))));
}

#[test]
fn nothing_foreign_is_no_doubt_and_neither_is_a_camera_without_depth() {
    assert!(goes(&mut with(REFUSE, report(Vec::new(), 0.95))).is_ok());
    assert!(goes(&mut with(REFUSE, None)).is_ok());
    assert!(goes(&mut with(ForeignRule::Off, report(vec![thing(0.2, 0.1, 0.09)], 0.1))).is_ok());
}

#[test]
fn depth_that_is_requested_has_to_come_and_to_cover_the_table() {
    let needed = ForeignRule::Refuse { depth_needed: true };
    assert_eq!(goes(&mut with(needed, None)).unwrap_err().0, "depth_missing");
    assert_eq!(
        goes(&mut with(ForeignRule::Obstacle { margin_m: 0.01 }, None)).unwrap_err().0,
        "depth_missing"
    );
    assert_eq!(goes(&mut with(REFUSE, report(Vec::new(), 0.4))).unwrap_err().0, "depth_poor");
    assert_eq!(goes(&mut with(REFUSE, report(Vec::new(), f64::NAN))).unwrap_err().0, "depth_poor");
    // Colours that were compared with nothing are named as such.
    let elsewhere = ForeignReport { measured_share: 0.0, by_colour: true, ..ForeignReport::default() };
    let (code, message, hint) = goes(&mut with(REFUSE, Some(elsewhere))).unwrap_err();
    assert_eq!(code, "table_not_compared");
    assert!(
        message.contains("empty table on 0 %") && hint.contains("celld calibrate empty"),
        "{message} {hint}"
    );
    // Much of the table was measured, but not where something large may be.
    for (area_m2, refused) in [(12e-4, false), (30e-4, true), (f64::NAN, true)] {
        let hole = Hole { area_m2, centre: [0.31, 0.12], reach_m: 0.1, outline: Vec::new() };
        let seen =
            ForeignReport { objects: Vec::new(), measured_share: 0.97, holes: vec![hole], by_colour: false };
        let reported = goes(&mut with(REFUSE, Some(seen)));
        let Err((code, message, _)) = reported else {
            assert!(!refused, "{area_m2}");
            continue;
        };
        assert!(refused && code == "depth_poor" && message.contains("x = 310 mm, y = 120 mm"), "{message}");
    }
}

#[test]
fn a_bumped_camera_is_named_before_what_it_imagines() {
    let mut bench = with(REFUSE, report(vec![thing(0.2, 0.1, 0.09)], 0.99));
    bench.reference = reference(4, 3e-3);
    assert_eq!(goes(&mut bench).unwrap_err().0, "calibration_invalid");
}

#[test]
fn as_an_obstacle_it_reaches_the_planner_with_its_margin_and_the_arm_goes_over_it() {
    let rule = ForeignRule::Obstacle { margin_m: 0.01 };
    let mut bench = with(rule, report(vec![thing(0.42, 0.1, 0.12)], 0.99));
    let request = goes(&mut bench).unwrap();
    let [keep_out] = &request.instance.keep_out[..] else { panic!("{:?}", request.instance.keep_out) };
    let (low, high) = keep_out.footprint.bounds(&keep_out.pose);
    assert!(low[0] < 0.381 && low[0] > 0.378 && high[1] > 0.139 && high[1] < 0.142, "{low:?} {high:?}");
    // Travelling ends over the object that is gripped: with the thing, its margin and the air above the
    // lips' way there.
    let air = bench.cell.model().cycle.air;
    let over = approach_m(&mut bench);
    assert!(over >= 0.12 + 0.01 + 0.5 * air, "{over}");
    let mut low = with(REFUSE, report(Vec::new(), 0.99));
    goes(&mut low).unwrap();
    let over = approach_m(&mut low);
    assert!(over < 0.12, "{over}: the thing alone makes the way higher");
}

/// How high the lips end the first part of the way to the object, m: the travelling height, as the look
/// poses are higher.
fn approach_m(bench: &mut Bench) -> f64 {
    let arm = bench.cell.model().arm.clone();
    let streamed = bench.plan();
    let path = streamed.iter().find_map(|action| match action {
        Action::Robot(RobotCommand::Stream(path)) => Some(path.clone()),
        _ => None,
    });
    let path = path.expect("the approach");
    arm.tool_at(&path.segments()[0].target()).translation.vector.z
}

#[test]
fn the_gripper_does_not_come_down_beside_a_tall_foreign_obstacle() {
    let rule = ForeignRule::Obstacle { margin_m: 0.01 };
    // Beside the object's start by less than the radius of the gripper's body, and higher than its
    // underside.
    let mut bench = with(rule, report(vec![thing(0.15, 0.385, 0.12)], 0.99));
    goes(&mut bench).unwrap();
    let (_, code) = ended(&bench.plan()).expect("refused");
    assert_eq!(code, "unpickable:a");
    let mut bench = with(rule, report(vec![thing(0.15, 0.385, 0.03)], 0.99));
    goes(&mut bench).unwrap();
    assert_eq!(ended(&bench.plan()), None, "a low one is no matter");
}

#[test]
fn nothing_moves_below_what_is_taller_than_the_way_until_a_person_has_taken_it_away() {
    for rule in [REFUSE, ForeignRule::Obstacle { margin_m: 0.01 }] {
        let mut bench = with(rule, report(vec![thing(0.2, 0.1, 0.9)], 0.99));
        bench.job(false);
        let mut all = bench.until_planning();
        all.extend(bench.ticks(20));
        let looks =
            all.iter().filter(|action| matches!(action, Action::Robot(RobotCommand::Stream(_)))).count();
        assert_eq!(looks, 0, "{rule:?}: {all:?}");
        if rule == REFUSE {
            assert_eq!(ended(&all), Some((JobStatus::Failed, "foreign_object".into())), "{all:?}");
            assert!(!bench.cell.status().armed);
        } else {
            // With the obstacle rule the plan is requested, and found: its cycle cannot be driven, nor can
            // the next look.
            assert!(all.iter().any(|action| matches!(action, Action::Plan(_))), "{all:?}");
            let mut all = bench.plan();
            all.extend(bench.ticks(20));
            assert_eq!(streams(&all), 0, "{all:?}");
            assert!(!all.iter().any(|action| matches!(action, Action::Gripper(_))), "{all:?}");
            assert!(ended(&all).is_some_and(|(end, _)| end == JobStatus::Failed), "{all:?}");
        }
        // Taken away and armed: the cell looks again and goes on.
        bench.foreign = report(Vec::new(), 0.99);
        bench.feed(order(Order::Abort));
        bench.feed(Input::Robot(RobotEvent::Stopped));
        assert!(goes(&mut bench).is_ok(), "{rule:?}");
    }
}

#[test]
fn each_obstacle_is_as_high_as_it_is_known_to_be() {
    let rule = ForeignRule::Obstacle { margin_m: 0.01 };
    let mut bench = with(rule, report(vec![thing(0.42, 0.1, 0.12), thing(0.1, 0.45, 0.005)], 0.99));
    let region = KeepOut { footprint: Footprint::Disc { radius: 0.02 }, pose: Pose2::new(0.45, 0.45, 0.0) };
    let mut model = bench.cell.model().clone();
    model.keep_out.push(region);
    bench.cell = Supervisor::new(model, 7);
    let request = goes(&mut bench).unwrap();
    let heights: Vec<f64> = request.limits.obstacles.iter().map(|standing| standing.height).collect();
    let tallest = bench.cell.model().cycle.tallest;
    for (found, known) in heights.iter().zip([tallest, 0.13, 0.015]) {
        assert!((found - known).abs() < 1e-9, "{heights:?}");
    }
    assert_eq!(heights.len(), 3);
}
