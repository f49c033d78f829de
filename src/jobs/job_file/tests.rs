//! Job files as people write them: whole, wrong in every key, torn, and with goals that cannot be.

use super::*;
use crate::jobs::goal::{GoalContext, stays_below};
use crate::jobs::record::GoalPose;
use proptest::prelude::*;
use rearrange::geometry::footprint::Footprint;
use rearrange::planning::plan::Objective;
use rearrange::tabletop::instance::ObjectSpec;

fn no_file(path: &str) -> Result<String, String> {
    match path {
        "goal.yaml" => Ok("objects:\n  - {id: mug, pose: [0.1, 0.2, 0.3]}\n".to_owned()),
        "bad.yaml" => Ok("objects:\n  - {id: mug}\n  - {}\n".to_owned()),
        _ => Err("no such file".to_owned()),
    }
}

fn read(text: &str) -> Result<JobSpec, Diagnostics> {
    read_job(
        text,
        "job.yaml",
        &JobContext { goal: None, approval: Approval::Job, read_goal: &no_file, found: None },
    )
}

#[track_caller]
fn check_complaint(text: &str, expected: &str) {
    let reported = read(text).unwrap_err().to_string();
    assert!(reported.contains(expected), "{reported}");
}

const FULL: &str = "version: 1
id: tidy-42
goal: {objects: [{id: mug, pose_deg: [0.1, 0.2, 180]}]}
objective: ti
solver: erbm
time_limit_s: 2.5
seed: 7
priority: 5
not_before: 2026-11-21T08:00:00Z
approval: always
rerun: true
";

#[test]
fn every_key_is_read() {
    let job = read(FULL).unwrap();
    let pose = Pose2::new(0.1, 0.2, std::f64::consts::PI);
    assert_eq!(
        job,
        JobSpec {
            id: Some("tidy-42".into()),
            goal: vec![GoalPose { id: "mug".into(), pose }],
            rule: None,
            restore: None,
            objective: Some(Objective::Ti),
            solver: Some("erbm".into()),
            time_limit_s: Some(2.5),
            seed: Some(7),
            priority: 5,
            not_before_unix_s: Some(1_795_248_000.0),
            approval: Some(Approval::Always),
            rerun: true,
        }
    );
    assert_eq!(read(&job_yaml(&job)).unwrap(), job, "what submit writes reads back alike");
}

#[test]
fn a_goal_file_is_taken_into_the_job() {
    let job = read("version: 1\ngoal: {file: goal.yaml}\n").unwrap();
    assert_eq!(job.goal[0].pose, Pose2::new(0.1, 0.2, 0.3));
    check_complaint(
        "version: 1\ngoal: {file: none.yaml}\n",
        "job.yaml:2:14: goal.file: none.yaml: no such file",
    );
    let reported = read("version: 1\ngoal: {file: bad.yaml}\n").unwrap_err().to_string();
    assert!(reported.starts_with("bad.yaml:2:5: ") && !reported.contains("job.yaml"), "{reported}");
}

#[test]
fn each_fault_is_named_where_it_is() {
    check_complaint("goal: {file: goal.yaml}\n", "key \"version\" is missing");
    check_complaint("version: 2\ngoal: {file: goal.yaml}\n", "1:10: version: 2 is out of range");
    check_complaint("version: 1\n", "key \"goal\" is missing");
    check_complaint("version: 1\ngoal: {}\n", "none of \"file\", \"objects\", \"region\"");
    check_complaint("version: 1\ngoal: {objects: []}\n", "goal.objects: 0 objects");
    let with = |line: &str| format!("version: 1\ngoal: {{file: goal.yaml}}\n{line}\n");
    check_complaint(&with("objctive: pp"), "3:1: objctive: unknown key; did you mean \"objective\"?");
    check_complaint(
        &with("objective: fast"),
        "3:12: objective: \"fast\" is not known here; one of: pp, ti, time",
    );
    check_complaint(&with("solver: best"), "3:9: solver: \"best\" is not known here; one of: tbm, rbm");
    check_complaint(&with("time_limit_s: 0"), "time_limit_s: 0 s is out of range");
    check_complaint(&with("time_limit_s: .nan"), ".nan is not a finite number");
    check_complaint(&with("seed: -1"), "seed: -1 is out of range");
    check_complaint(&with("id: ../etc"), "cannot be the id of a job");
    check_complaint(&with("not_before: tomorrow"), "write it in UTC");
    check_complaint(&with("approval: never"), "a job may only be stricter");
    let several = read(&with("seed: x\npriority: y")).unwrap_err();
    assert_eq!(several.0.len(), 2, "{several}");
}

#[test]
fn a_goal_file_outside_the_goal_folder_is_not_even_requested() {
    let requested = |path: &str| -> Result<String, String> { panic!("{path} was read") };
    let context = JobContext { goal: None, approval: Approval::Job, read_goal: &requested, found: None };
    for path in ["/dev/zero", "../goal.yaml", "below/../../goal.yaml", ".", "''"] {
        let text = format!("version: 1\ngoal: {{file: {path}}}\nseed: x\n");
        let reported = read_job(&text, "job.yaml", &context).unwrap_err().to_string();
        assert!(
            reported.contains("job.yaml:2:14: goal.file: ")
                && (reported.contains("leads out of") || reported.contains("an empty text")),
            "{reported}"
        );
        assert!(reported.contains("seed: \"x\" is not a whole number"), "{reported}");
    }
    assert!(stays_below("goals/monday.yaml") && stays_below("./goal.yaml"));
}

#[test]
fn a_job_is_judged_whole_although_one_pose_is_wrong() {
    let spec = |id: &str| ObjectSpec::new(id, Footprint::disc(0.05).unwrap());
    let objects = [spec("a"), spec("b"), spec("c")];
    let goal = GoalContext {
        objects: &objects,
        width_m: 0.5,
        height_m: 0.5,
        clearance_m: 0.002,
        keep_out: &[],
        overlap_tolerance_m: 0.001,
    };
    let context = JobContext { goal: Some(goal), approval: Approval::Job, read_goal: &no_file, found: None };
    let text = "version: 1
goal:
  objects:
    - {id: a, pose: [100 mm, 0, 0]}
    - {id: b, pose: [0.2, 0.2, 0]}
    - {id: c, pose: [0.25, 0.2, 0]}
    - {id: d, pose: [0.4]}
";
    let reported = read_job(text, "job.yaml", &context).unwrap_err().to_string();
    let expected = [
        "job.yaml:4:22: goal.objects[0].pose[0]: \"100 mm\" is not a number",
        "job.yaml:6:7: goal.objects[2]: the goals of \"c\" and \"b\" (line 5) overlap by 50.00 mm",
        "job.yaml:7:7: goal.objects[3]: object \"d\" is unknown",
        "job.yaml:7:21: goal.objects[3].pose: 1 values, 3 are wanted",
    ];
    assert_eq!(reported.lines().count(), expected.len(), "{reported}");
    for (line, wanted) in reported.lines().zip(expected) {
        assert!(line.starts_with(wanted), "{line}\nwanted {wanted}");
    }
}

/// A cell with three planks of one group, a fixed base and a table of half a metre.
fn in_a_cell(goal: &str) -> Result<JobSpec, Diagnostics> {
    let spec = |id: &str| ObjectSpec {
        group: Some("planks".into()),
        fixed: id == "base",
        ..ObjectSpec::new(id, Footprint::rectangle(0.1, 0.04).unwrap())
    };
    let objects = ["a", "b", "c", "base"].map(spec);
    let found = |id: &str| match id {
        "monday" => Ok(["a", "base", "gone"]
            .map(|id| GoalPose { id: id.into(), pose: Pose2::new(0.2, 0.2, 0.0) })
            .to_vec()),
        _ => Err(format!("no job {id:?} is known")),
    };
    let goal_context = GoalContext {
        objects: &objects,
        width_m: 0.5,
        height_m: 0.5,
        clearance_m: 0.002,
        keep_out: &[],
        overlap_tolerance_m: 0.001,
    };
    let context = JobContext {
        goal: Some(goal_context),
        approval: Approval::Job,
        read_goal: &no_file,
        found: Some(&found),
    };
    read_job(&format!("version: 1\ngoal: {goal}\n"), "job.yaml", &context)
}

#[test]
fn goals_by_rule_are_read_and_written_alike() {
    for goal in [
        "{region: {objects: [a, b], polygon: [[0.1, 0.1], [0.4, 0.1], [0.4, 0.4]]}}",
        "{region: {group: planks, polygon: [[0.1, 0.1], [0.4, 0.1], [0.4, 0.4], [0.1, 0.4]]}}",
        "{grid: {objects: [c, a], origin: [0.1, 0.1], pitch: [0.2, 0.1], columns: 2, theta_deg: 90}}",
        "{grid: {group: planks, origin: [0.1, 0.1], pitch: [0.2, 0.1], columns: 2}}",
        "{swap: [a, b]}",
    ] {
        let job = in_a_cell(goal).unwrap_or_else(|fault| panic!("{goal}: {fault}"));
        assert!(job.goal.is_empty() && job.rule.is_some(), "{goal}: {job:?}");
        assert_eq!(read(&job_yaml(&job)).unwrap(), job, "{}", job_yaml(&job));
    }
    let restored = in_a_cell("{restore: monday}").unwrap();
    assert_eq!(restored.goal, [GoalPose { id: "a".into(), pose: Pose2::new(0.2, 0.2, 0.0) }]);
    let unread = read("version: 1\ngoal: {restore: monday}\n").unwrap();
    assert_eq!(unread.restore.as_deref(), Some("monday"), "the daemon looks it up");
    assert_eq!(read(&job_yaml(&unread)).unwrap(), unread);
    let look = in_a_cell("{look: true}").unwrap();
    assert!(look.goal.is_empty() && look.rule.is_none() && look.restore.is_none());
    assert_eq!(read(&job_yaml(&look)).unwrap(), look);
}

#[test]
fn a_rule_that_no_table_can_follow_is_refused_where_it_is() {
    let square = "[[0.1, 0.1], [0.4, 0.1], [0.4, 0.4], [0.1, 0.4]]";
    let region = |rest: &str| format!("{{region: {{{rest}}}}}");
    for (goal, wanted) in [
        (
            region("objects: [a], polygon: [[0, 0], [0.6, 0], [0, 0.4]]"),
            "the corner [0.6, 0] is off the table",
        ),
        (
            region("objects: [a], polygon: [[0, 0], [0.05, 0], [0, 0.05]]"),
            "no place was found inside the region",
        ),
        (region(&format!("objects: [a, a], polygon: {square}")), "\"a\" is named twice"),
        (
            region(&format!("objects: [x], polygon: {square}")),
            "object \"x\" is unknown; the catalogue has: a",
        ),
        (region(&format!("objects: [base], polygon: {square}")), "object \"base\" is fixed"),
        (region(&format!("group: nuts, polygon: {square}")), "no object that moves is of group \"nuts\""),
        (region(&format!("group: planks, objects: [a], polygon: {square}")), "beside \"objects\""),
        (region(&format!("polygon: {square}")), "neither \"objects\" nor \"group\" is given"),
        (region("objects: [a]"), "key \"polygon\" is missing"),
        ("{swap: [a]}".into(), "1 objects, 2 change places"),
        ("{swap: [a, a]}".into(), "cannot change places with itself"),
        ("{restore: never}".into(), "no job \"never\" is known"),
        ("{look: false}".into(), "a look that is not wanted"),
        ("{look: true, swap: [a, b]}".into(), "beside \"swap\""),
        ("{restore: monday, swap: [a, b]}".into(), "beside \"swap\""),
        (
            "{grid: {objects: [a, b], origin: [0.1, 0.1], pitch: [0.05, 0.1], columns: 2}}".into(),
            "the goals of \"b\" and \"a\" (line 2) overlap by 40.00 mm",
        ),
        (
            "{grid: {objects: [a, b], origin: [0.1, 0.1], pitch: [0.4, 0.1], columns: 2}}".into(),
            "the goal of \"b\" reaches 50.00 mm over the table's edge",
        ),
        ("{grid: {objects: [a], origin: [0.1, 0.1], pitch: [1, 1], columns: 0}}".into(), "0 is out of range"),
    ] {
        let reported = in_a_cell(&goal).expect_err(&goal).to_string();
        assert!(reported.starts_with("job.yaml:2:") && reported.contains(wanted), "{goal}: {reported}");
    }
}

#[test]
fn a_torn_file_is_distinguished_from_a_wrong_one() {
    let context = JobContext { goal: None, approval: Approval::Never, read_goal: &no_file, found: None };
    let refuse = |text: &str| read_for_spool(text, "job.yaml", &context).unwrap_err();
    for torn in ["", "  \n", "version: 1\ngoal: {objects: [{id: mug, pose: [0.1,", "version: 1\ngoal: {obj"] {
        assert!(refuse(torn).incomplete, "{torn:?}");
    }
    for wrong in ["version: 1\n", "version: 1\ngoal: }\nseed: 1\npriority: 2\n"] {
        assert!(!refuse(wrong).incomplete, "{wrong:?}: {:?}", refuse(wrong));
    }
}

proptest! {
    #[test]
    fn no_text_panics(text in "[ -~\\n]{0,200}") {
        let context = JobContext { goal: None, approval: Approval::Never, read_goal: &no_file, found: None };
        let _ = read_for_spool(&text, "job.yaml", &context);
    }

    #[test]
    fn no_torn_or_altered_job_panics(cut in 0_usize..400, change in 0_usize..400, byte in 32_u8..127) {
        let mut text: String = FULL.chars().take(cut).collect();
        if change < text.len() && text.is_char_boundary(change) {
            text.insert(change, char::from(byte));
        }
        let context = JobContext { goal: None, approval: Approval::Never, read_goal: &no_file, found: None };
        let _ = read_for_spool(&text, "job.yaml", &context);
    }
}
