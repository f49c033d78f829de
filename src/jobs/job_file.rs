//! Job files: text to [`JobSpec`], with every complaint at once.
//!
//! In: the text of a job file, the cell's catalogue and table, a reader for goal files. Out: the job with its
//! goal resolved to poses, so that nothing outside the journal is needed later; or all complaints with line
//! and column. A goal that overlaps itself, leaves the table or names an unknown object is a complaint here:
//! such a job is rejected, it does not fail later.

use crate::document::decode::{At, Decoder, Fields};
use crate::document::{Complaint, Complaints, Location, parse};
use crate::geometry::pose::Pose2;
use crate::jobs::goal::{GoalContext, GoalEntry, check_goal, decode_goal, parse_goal_file};
use crate::jobs::policy::{Approval, decode_objective, decode_solver};
use crate::jobs::record::{GoalPose, JobSpec, quoted};
use crate::jobs::spool::{Refusal, RefusalDetail, is_plain_name};
use crate::jobs::utc;
use std::fmt::Write as _;
use std::path::{Component, Path};

/// Keys of a job file.
const KEYS: [&str; 11] = [
    "version",
    "id",
    "goal",
    "objective",
    "solver",
    "time_limit_s",
    "seed",
    "priority",
    "not_before",
    "approval",
    "rerun",
];

/// Longest planning budget a job may ask for, s.
const MAX_TIME_LIMIT_S: f64 = 86_400.0;

/// Text of a goal file, by the path as the job writes it; `Err` says why it cannot be had.
pub type ReadGoal<'a> = dyn Fn(&str) -> Result<String, String> + 'a;

/// What a job is checked against.
#[derive(Clone, Copy)]
pub struct JobContext<'a> {
    /// Catalogue and table; absent where they are not known (`celld check`, `celld submit`).
    pub goal: Option<GoalContext<'a>>,
    /// Least approval; a job may only be stricter.
    pub approval: Approval,
    /// Finds goal files.
    pub read_goal: &'a ReadGoal<'a>,
}

/// Reads and checks a job file.
///
/// # Errors
/// Every complaint; those about the goal file name that file.
pub fn read_job(text: &str, source: &str, context: &JobContext) -> Result<JobSpec, Complaints> {
    let node = parse(text, source)?;
    let mut decoder = Decoder::new(source);
    let mut goal_complaints = Complaints::default();
    let job = decoder
        .map(&At::top(&node), &KEYS)
        .and_then(|fields| decode_job(&mut decoder, &fields, context, &mut goal_complaints));
    match decoder.finish(job) {
        Ok(job) if goal_complaints.0.is_empty() => Ok(job),
        Ok(_) => Err(goal_complaints),
        Err(mut complaints) => {
            complaints.0.retain(|complaint| complaint.message != UNUSED);
            complaints.0.extend(goal_complaints.0);
            Err(complaints)
        }
    }
}

/// Marks a job that has no complaint of its own but whose goal file has.
const UNUSED: &str = "the goal file has complaints";

fn decode_job(
    decoder: &mut Decoder,
    fields: &Fields,
    context: &JobContext,
    goal_complaints: &mut Complaints,
) -> Option<JobSpec> {
    if let Some(at) = fields.required("version", decoder) {
        decoder.integer(&at, 1..=1);
    }
    let goal = fields
        .required("goal", decoder)
        .and_then(|at| decode_goal_source(decoder, &at, context, goal_complaints));
    let id = fields.optional("id").and_then(|at| decode_id(decoder, &at));
    let objective = fields.optional("objective").and_then(|at| decode_objective(decoder, &at));
    let solver = fields.optional("solver").and_then(|at| decode_solver(decoder, &at));
    let time_limit_s =
        fields.optional("time_limit_s").and_then(|at| decoder.number_in(&at, 0.001..=MAX_TIME_LIMIT_S, "s"));
    let seed = fields.optional("seed").and_then(|at| decoder.integer(&at, 0..=i64::MAX));
    let priority = fields.optional("priority").and_then(|at| decoder.integer(&at, -1000..=1000));
    let not_before = fields.optional("not_before").and_then(|at| decode_time(decoder, &at));
    let approval = fields.optional("approval").and_then(|at| decode_approval(decoder, &at, context.approval));
    let rerun = fields.optional("rerun").and_then(|at| decoder.boolean(&at));
    Some(JobSpec {
        id,
        goal: goal?,
        objective,
        solver: solver.map(str::to_owned),
        time_limit_s,
        seed: seed.and_then(|seed| u64::try_from(seed).ok()),
        priority: priority.unwrap_or(0),
        not_before_unix_s: not_before,
        approval,
        rerun: rerun.unwrap_or(false),
    })
}

fn decode_id(decoder: &mut Decoder, at: &At) -> Option<String> {
    let id = decoder.text(at)?;
    if is_plain_name(&id) {
        return Some(id);
    }
    let help = "1 to 80 letters, digits, dots, dashes and underscores, not beginning with a dot";
    decoder.complain_at(at, format!("{id:?} cannot be the id of a job"), help);
    None
}

fn decode_time(decoder: &mut Decoder, at: &At) -> Option<f64> {
    let text = decoder.text(at)?;
    let time = utc::parse(&text);
    if time.is_none() {
        decoder.complain_at(at, format!("{text:?} is not a time"), "write it in UTC as 2026-11-21T08:00:00Z");
    }
    time
}

fn decode_approval(decoder: &mut Decoder, at: &At, floor: Approval) -> Option<Approval> {
    let approval =
        decoder.choice(at, &[Approval::Never, Approval::Job, Approval::Always].map(|a| (a.word(), a)))?;
    if approval < floor {
        let message = format!("the cell asks for approval {:?}, a job may only be stricter", floor.word());
        decoder.complain_at(at, message, "remove the key");
        return None;
    }
    Some(approval)
}

/// `{file: ...}` or `{objects: [...]}`.
fn decode_goal_source(
    decoder: &mut Decoder,
    at: &At,
    context: &JobContext,
    goal_complaints: &mut Complaints,
) -> Option<Vec<GoalPose>> {
    let fields = decoder.map(at, &["file", "objects"])?;
    match (fields.optional("file"), fields.optional("objects")) {
        (None, Some(objects)) => {
            let entries = decode_goal(decoder, &objects)?;
            if let Some(goal) = &context.goal {
                check_goal(decoder, &entries, goal);
            }
            Some(poses(entries))
        }
        (Some(file), None) => {
            let path = decoder.text(&file)?;
            if !stays_below(&path) {
                let help = "name a file in the goal folder or below it: no leading /, no ..";
                decoder.complain_at(&file, format!("{path:?} leads out of the goal folder"), help);
                return None;
            }
            match goal_of_file(&path, context) {
                Ok(goal) => Some(goal),
                Err(GoalFault::Unreadable(reason)) => {
                    let help = "name a file relative to the goal folder (here: the job file's own)";
                    let help =
                        if context.goal.is_some() { "name a file of the cell's goal_folder" } else { help };
                    decoder.complain_at(&file, format!("{path}: {reason}"), help);
                    None
                }
                Err(GoalFault::Complaints(complaints)) => {
                    goal_complaints.0.extend(complaints.0);
                    decoder.complain_at(&file, UNUSED, "");
                    None
                }
            }
        }
        (Some(_), Some(second)) => {
            decoder.complain(second.key_at, &second.path, "beside \"file\"", "remove one of the two");
            None
        }
        (None, None) => {
            decoder.complain_at(at, "neither \"file\" nor \"objects\" is given", "add one of the two");
            None
        }
    }
}

/// True for a path that leads to a file in the folder it is joined to, or below it.
fn stays_below(path: &str) -> bool {
    let mut named = false;
    for component in Path::new(path).components() {
        match component {
            Component::Normal(_) => named = true,
            Component::CurDir => {}
            Component::Prefix(_) | Component::RootDir | Component::ParentDir => return false,
        }
    }
    named
}

enum GoalFault {
    Unreadable(String),
    Complaints(Complaints),
}

fn goal_of_file(path: &str, context: &JobContext) -> Result<Vec<GoalPose>, GoalFault> {
    let text = (context.read_goal)(path).map_err(GoalFault::Unreadable)?;
    let entries = parse_goal_file(&text, path, context.goal.as_ref()).map_err(GoalFault::Complaints)?;
    Ok(poses(entries))
}

fn poses(entries: Vec<GoalEntry>) -> Vec<GoalPose> {
    entries.into_iter().filter_map(GoalEntry::into_goal).collect()
}

/// [`read_job`] in the words of the spool.
pub fn read_for_spool(text: &str, name: &str, context: &JobContext) -> Result<JobSpec, Refusal> {
    read_job(text, name, context).map_err(|complaints| refusal(text, name, &complaints))
}

fn refusal(text: &str, name: &str, complaints: &Complaints) -> Refusal {
    let syntax = parse(text, name).is_err();
    let incomplete = text.trim().is_empty() || (syntax && complaints.0.iter().any(|c| at_end(text, c)));
    let count = complaints.0.len();
    let message = match complaints.0.as_slice() {
        [only] => only.to_string(),
        _ => format!("{count} complaints, the first: {}", first(complaints)),
    };
    let hint = if incomplete {
        "the file ends in the middle; was it still being copied? copy it again, or use `celld submit`"
    } else {
        "correct what the complaints name and submit the file again; `celld check` tells the same beforehand"
    };
    let mut refusal = Refusal::new(if syntax { "E_SYNTAX" } else { "E_INVALID" }, message, hint);
    refusal.incomplete = incomplete;
    refusal.complaints = complaints.0.iter().map(detail).collect();
    refusal
}

fn first(complaints: &Complaints) -> String {
    complaints.0.first().map(ToString::to_string).unwrap_or_default()
}

fn detail(complaint: &Complaint) -> RefusalDetail {
    let number = |value: usize| u32::try_from(value).unwrap_or(u32::MAX);
    RefusalDetail {
        path: complaint.path.clone(),
        line: number(complaint.at.line),
        column: number(complaint.at.column),
        message: format!("{}: {}", complaint.source, complaint.message),
        help: complaint.help.clone(),
    }
}

/// True for a complaint at the very end of the text, or behind it.
fn at_end(text: &str, complaint: &Complaint) -> bool {
    let last = text.trim_end().lines().count();
    let width = text.trim_end().lines().last().map_or(0, |line| line.chars().count());
    complaint.at >= Location { line: last, column: width }
}

/// A job file with the same content and the goal inside: what `celld submit` leaves for the daemon.
pub fn job_yaml(job: &JobSpec) -> String {
    let mut yaml = String::from("version: 1\n");
    let mut line = |key: &str, value: Option<String>| {
        if let Some(value) = value {
            let _ = writeln!(yaml, "{key}: {value}");
        }
    };
    line("id", job.id.as_deref().map(quoted));
    line("objective", job.objective.map(|objective| objective.word().to_owned()));
    line("solver", job.solver.clone());
    line("time_limit_s", job.time_limit_s.map(|limit| limit.to_string()));
    line("seed", job.seed.map(|seed| seed.to_string()));
    line("priority", (job.priority != 0).then(|| job.priority.to_string()));
    line("not_before", job.not_before_unix_s.map(|time| quoted(&utc::text(time))));
    line("approval", job.approval.map(|approval| approval.word().to_owned()));
    line("rerun", job.rerun.then(|| "true".to_owned()));
    yaml.push_str("goal:\n");
    yaml.push_str(&goal_yaml(job.goal.iter().map(|goal| (goal.id.as_str(), goal.pose)), "  "));
    yaml
}

/// `objects: [...]` of a goal, one line each; also the content of a goal file.
pub fn goal_yaml<'a>(goal: impl Iterator<Item = (&'a str, Pose2)>, indent: &str) -> String {
    let mut yaml = format!("{indent}objects:\n");
    for (id, Pose2 { x, y, theta }) in goal {
        let _ = writeln!(yaml, "{indent}  - {{id: {}, pose: [{x}, {y}, {theta}]}}", quoted(id));
    }
    yaml
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::footprint::Footprint;
    use crate::jobs::policy::JobObjective;
    use crate::tabletop::instance::ObjectSpec;
    use proptest::prelude::*;

    fn no_file(path: &str) -> Result<String, String> {
        match path {
            "goal.yaml" => Ok("objects:\n  - {id: mug, pose: [0.1, 0.2, 0.3]}\n".to_owned()),
            "bad.yaml" => Ok("objects:\n  - {id: mug}\n  - {}\n".to_owned()),
            _ => Err("no such file".to_owned()),
        }
    }

    fn read(text: &str) -> Result<JobSpec, Complaints> {
        read_job(text, "job.yaml", &JobContext { goal: None, approval: Approval::Job, read_goal: &no_file })
    }

    #[track_caller]
    fn check_complaint(text: &str, expected: &str) {
        let told = read(text).unwrap_err().to_string();
        assert!(told.contains(expected), "{told}");
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
                objective: Some(JobObjective::Ti),
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
        let told = read("version: 1\ngoal: {file: bad.yaml}\n").unwrap_err().to_string();
        assert!(told.starts_with("bad.yaml:2:5: ") && !told.contains("job.yaml"), "{told}");
    }

    #[test]
    fn each_fault_is_named_where_it_is() {
        check_complaint("goal: {file: goal.yaml}\n", "key \"version\" is missing");
        check_complaint("version: 2\ngoal: {file: goal.yaml}\n", "1:10: version: 2 is out of range");
        check_complaint("version: 1\n", "key \"goal\" is missing");
        check_complaint("version: 1\ngoal: {}\n", "neither \"file\" nor \"objects\"");
        check_complaint("version: 1\ngoal: {objects: []}\n", "goal.objects: 0 objects");
        let with = |line: &str| format!("version: 1\ngoal: {{file: goal.yaml}}\n{line}\n");
        check_complaint(&with("objctive: pp"), "3:1: objctive: unknown key; did you mean \"objective\"?");
        check_complaint(
            &with("objective: fast"),
            "3:12: objective: \"fast\" is not known here; one of: pp, ti",
        );
        check_complaint(
            &with("objective: time"),
            "3:12: objective: \"time\" is not built yet; one of: pp, ti",
        );
        check_complaint(&with("solver: auto"), "3:9: solver: \"auto\" is not built yet; one of: tbm, rbm");
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
    fn a_goal_file_outside_the_goal_folder_is_not_even_asked_for() {
        let asked = |path: &str| -> Result<String, String> { panic!("{path} was read") };
        let context = JobContext { goal: None, approval: Approval::Job, read_goal: &asked };
        for path in ["/dev/zero", "../goal.yaml", "below/../../goal.yaml", ".", "''"] {
            let text = format!("version: 1\ngoal: {{file: {path}}}\nseed: x\n");
            let told = read_job(&text, "job.yaml", &context).unwrap_err().to_string();
            assert!(told.contains("job.yaml:2:14: goal.file: ") && told.contains("leads out of"), "{told}");
            assert!(told.contains("seed: \"x\" is not a whole number"), "{told}");
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
            keep_out: &[],
            overlap_tolerance_m: 0.001,
        };
        let context = JobContext { goal: Some(goal), approval: Approval::Job, read_goal: &no_file };
        let text = "version: 1
goal:
  objects:
    - {id: a, pose: [100 mm, 0, 0]}
    - {id: b, pose: [0.2, 0.2, 0]}
    - {id: c, pose: [0.25, 0.2, 0]}
    - {id: d, pose: [0.4]}
";
        let told = read_job(text, "job.yaml", &context).unwrap_err().to_string();
        let expected = [
            "job.yaml:4:22: goal.objects[0].pose[0]: \"100 mm\" is not a number",
            "job.yaml:6:7: goal.objects[2]: the goals of \"c\" and \"b\" (line 5) overlap by 50.00 mm",
            "job.yaml:7:7: goal.objects[3]: object \"d\" is unknown",
            "job.yaml:7:21: goal.objects[3].pose: 1 values, 3 are wanted",
        ];
        assert_eq!(told.lines().count(), expected.len(), "{told}");
        for (line, wanted) in told.lines().zip(expected) {
            assert!(line.starts_with(wanted), "{line}\nwanted {wanted}");
        }
    }

    #[test]
    fn a_torn_file_is_told_from_a_wrong_one() {
        let context = JobContext { goal: None, approval: Approval::Never, read_goal: &no_file };
        let refuse = |text: &str| read_for_spool(text, "job.yaml", &context).unwrap_err();
        for torn in
            ["", "  \n", "version: 1\ngoal: {objects: [{id: mug, pose: [0.1,", "version: 1\ngoal: {obj"]
        {
            assert!(refuse(torn).incomplete, "{torn:?}");
        }
        for wrong in ["version: 1\n", "version: 1\ngoal: }\nseed: 1\npriority: 2\n"] {
            assert!(!refuse(wrong).incomplete, "{wrong:?}: {:?}", refuse(wrong));
        }
    }

    proptest! {
        #[test]
        fn no_text_panics(text in "[ -~\\n]{0,200}") {
            let context = JobContext { goal: None, approval: Approval::Never, read_goal: &no_file };
            let _ = read_for_spool(&text, "job.yaml", &context);
        }

        #[test]
        fn no_torn_or_altered_job_panics(cut in 0_usize..400, change in 0_usize..400, byte in 32_u8..127) {
            let mut text: String = FULL.chars().take(cut).collect();
            if change < text.len() && text.is_char_boundary(change) {
                text.insert(change, char::from(byte));
            }
            let context = JobContext { goal: None, approval: Approval::Never, read_goal: &no_file };
            let _ = read_for_spool(&text, "job.yaml", &context);
        }
    }
}
