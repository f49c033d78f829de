//! Which jobs are wanted, and the story of one: what came in, what was found, planned, done, and how it
//! ended.
//!
//! In: a filter as a person writes it; a job's record and its steps. Out: the clause for the database; lines
//! of text with dates. Pure.

use crate::jobs::record::{GoalPose, JobRecord, JobState, StepIntent, StepKind, StepPhase, StepRecord};
use crate::jobs::utc;
use std::fmt::Write as _;

/// Jobs that are wanted.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct JobFilter {
    /// Only those that failed or were interrupted.
    pub failed: bool,
    /// Only those claimed at or after this time, s since 1970.
    pub since_unix_s: Option<f64>,
    /// Only those that had to do with this object: a goal of it, or a step.
    pub object: Option<String>,
}

/// A time as a person writes it: so long before `now` (`90s`, `30m`, `12h`, `2d`, `1w`), or a date in UTC.
pub fn since(text: &str, now_unix_s: f64) -> Option<f64> {
    let units = [('s', 1.0), ('m', 60.0), ('h', 3600.0), ('d', 86_400.0), ('w', 604_800.0)];
    let ago = units.iter().find_map(|(unit, seconds)| {
        let count: u32 = text.strip_suffix(*unit)?.parse().ok()?;
        Some(now_unix_s - f64::from(count) * seconds)
    });
    ago.or_else(|| utc::parse(text)).or_else(|| utc::parse(&format!("{text}T00:00:00Z")))
}

/// The story of a job; whether it is the one that was begun last, so that its hint is of now.
pub fn story(job: &JobRecord, steps: &[StepRecord], is_last: bool) -> String {
    let mut text = head(job, is_last);
    for (unix_s, what) in story_lines(job, steps) {
        let time = unix_s.map_or_else(|| " ".repeat(20), utc::text);
        let _ = writeln!(text, "{time}  {what}");
    }
    let times = job.result.iter().flat_map(|result| &result.times);
    let used: Vec<_> = times.map(|(what, seconds)| format!("{what} {seconds:.1}")).collect();
    if !used.is_empty() {
        let _ = writeln!(text, "{}  where the time went, s: {}", " ".repeat(20), used.join(", "));
    }
    text.push_str(&objects(job, steps));
    text
}

/// What happened, with its time (s since 1970) where that is known, in order. The page has each line in
/// other languages too: phrases end at `: ` and `; `, and names have such a phrase to themselves.
pub fn story_lines(job: &JobRecord, steps: &[StepRecord]) -> Vec<(Option<f64>, String)> {
    let mut lines: Vec<(Option<f64>, String)> = Vec::new();
    let mut at = |unix_s: Option<f64>, what: String| lines.push((unix_s, what));
    let priority = match job.spec.priority {
        0 => String::new(),
        other => format!("; priority {other}"),
    };
    at(Some(job.claimed_unix_s), format!("taken up: {}{priority}", job.name));
    if let Some(started) = job.started_unix_s {
        at(Some(started), "begun".to_string());
    }
    if !job.found.is_empty() {
        let goals = job.resolved.as_ref().map_or(0, Vec::len);
        at(
            job.found_unix_s,
            format!("found {} objects on the table, {goals} of them with a goal", job.found.len()),
        );
    }
    if let Some(plan) = &job.plan {
        at(Some(plan.unix_s), format!("planned: {}", plan.summary()));
        if job.approved.is_some() {
            at(job.approved_unix_s, "a person approved a plan".to_string());
        }
    }
    for step in steps {
        let mut of_step = |unix_s: f64, how_far: &str| {
            at(Some(unix_s), format!("{}. {} {how_far}", step.step, step.intent.object));
        };
        // Of what did not end well each part has its time.
        let gripped = step.gripped_unix_s.filter(|_| match step.phase {
            StepPhase::Released | StepPhase::Abandoned => true,
            StepPhase::Intent | StepPhase::Gripped | StepPhase::Done => false,
        });
        if let Some(unix_s) = gripped {
            of_step(unix_s, &reached(&step.intent, StepPhase::Gripped));
        }
        of_step(step.changed_unix_s, &how_far(step));
    }
    if let Some(result) = &job.result {
        at(job.ended_unix_s, format!("{} after {:.1} s", result.status, result.seconds));
    }
    in_order(lines)
}

/// By time: what a job had gripped may be let go after its end. What has no time stays behind what it came
/// after.
fn in_order(lines: Vec<(Option<f64>, String)>) -> Vec<(Option<f64>, String)> {
    let mut last = f64::MIN;
    let mut timed: Vec<_> = lines
        .into_iter()
        .map(|line| {
            last = line.0.unwrap_or(last);
            (last, line)
        })
        .collect();
    timed.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    timed.into_iter().map(|(_, line)| line).collect()
}

/// Pick-n-places that the job would have made by its last plan; `None` without one.
pub fn planned_moves(job: &JobRecord, steps: &[StepRecord]) -> Option<usize> {
    let plan = job.plan.as_ref().filter(|plan| !plan.preview)?;
    let before = |step: &&StepRecord| step.phase == StepPhase::Done && step.changed_unix_s < plan.unix_s;
    Some(steps.iter().filter(before).count() + plan.steps.len())
}

/// What matters first: how it ended and what to do.
fn head(job: &JobRecord, is_last: bool) -> String {
    let ended = job.ended_unix_s.map_or_else(String::new, |at| format!(", {}", utc::text(at)));
    let mut text = match &job.result {
        Some(result) => {
            format!("{}: {} ({}){ended}\n{}\n", job.id, job.state, result.code, result.message)
        }
        None => format!("{}: {}{ended}\n", job.id, job.state),
    };
    let hint = job.result.as_ref().map_or("", |result| result.hint.as_str());
    let (hint, of_now) = match job.state {
        JobState::Active => ("`celld status` says what the cell does now", true),
        JobState::Waiting => ("`celld status` says what it waits for", true),
        JobState::Ended(_) => (hint, is_last),
    };
    if !hint.is_empty() {
        let _ = writeln!(text, "{}: {hint}", if of_now { "to do" } else { "what was to be done" });
    }
    text.push('\n');
    text
}

/// How far the object of a step came, and what became of it where it did not come to its place.
fn how_far(StepRecord { intent, phase, note, .. }: &StepRecord) -> String {
    let far = reached(intent, *phase);
    match note.as_deref().filter(|note| !note.is_empty()) {
        Some(note) => format!("{far}: {note}"),
        None => far,
    }
}

/// How far it had come when its job ended: what is taken off the cups afterwards is no part of the job.
pub fn how_far_at(step: &StepRecord, ended_unix_s: Option<f64>) -> String {
    let later = ended_unix_s.is_some_and(|ended| step.changed_unix_s > ended);
    match step.phase {
        StepPhase::Released if later => reached(&step.intent, StepPhase::Gripped),
        StepPhase::Released
        | StepPhase::Intent
        | StepPhase::Gripped
        | StepPhase::Done
        | StepPhase::Abandoned => how_far(step),
    }
}

fn reached(intent: &StepIntent, phase: StepPhase) -> String {
    let to = match intent.kind {
        StepKind::Goal => "its goal",
        StepKind::Buffer => "a temporary place",
    };
    match phase {
        StepPhase::Done => format!("moved to {to}"),
        StepPhase::Intent => format!("was to be moved to {to}: begun, how far is not known"),
        StepPhase::Gripped => format!("was gripped, on its way to {to}"),
        // By a way back or by hand it may have been let go anywhere, and may have fallen before.
        StepPhase::Released => format!("was off the gripper on its way to {to}"),
        StepPhase::Abandoned => format!("was to be moved to {to}; given up"),
    }
}

/// How far each object was from its goal; of a job without a result, what is wanted.
fn objects(job: &JobRecord, steps: &[StepRecord]) -> String {
    let mut text = String::new();
    let Some(result) = job.result.as_ref().filter(|result| !result.objects.is_empty()) else {
        for GoalPose { id, pose } in job.resolved.as_ref().unwrap_or(&job.spec.goal) {
            let _ = writeln!(text, "  {id} is wanted at [{:.4}, {:.4}, {:.4}]", pose.x, pose.y, pose.theta);
        }
        return text;
    };
    text.push('\n');
    for object in &result.objects {
        let state = match (object.error_mm, object.error_deg) {
            (Some(mm), Some(deg)) => format!("{mm:.1} mm and {deg:.1} degrees from its goal, as seen last"),
            _ => unseen(&object.id, steps),
        };
        let _ = writeln!(text, "  {}: {state}", object.id);
    }
    text
}

/// Of an object without a measured place: why, and what became of it as far as is known.
pub fn unseen(object: &str, steps: &[StepRecord]) -> String {
    if !hung_since_it_was_seen(object, steps) {
        return "not seen".to_string();
    }
    let last = steps.iter().rev().find(|step| step.intent.object == object);
    match last.and_then(|step| step.note.as_deref()).filter(|note| !note.is_empty()) {
        Some(note) => format!("not seen since it was gripped; {note}"),
        None => "not seen since it was gripped".to_string(),
    }
}

/// Whether an object without a measured place has one that is known no more, since it was on the cups.
fn hung_since_it_was_seen(object: &str, steps: &[StepRecord]) -> bool {
    steps.iter().any(|step| {
        let was_on_the_cups = match step.phase {
            StepPhase::Gripped | StepPhase::Released | StepPhase::Done => true,
            StepPhase::Intent | StepPhase::Abandoned => step.gripped_unix_s.is_some(),
        };
        step.intent.object == object && was_on_the_cups
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::record::{JobResult, JobSpec, ObjectResult, PlanRecord, StepIntent};
    use cell_machine::code::JobStatus;
    use rearrange::geometry::pose::Pose2;

    const NOW: f64 = 1_795_248_000.0;

    #[test]
    fn a_time_is_a_span_or_a_date() {
        assert_eq!(since("2d", NOW), Some(NOW - 172_800.0));
        assert_eq!(since("90s", NOW), Some(NOW - 90.0));
        assert_eq!(since("2026-11-21T08:00:00Z", NOW), Some(NOW));
        assert_eq!(since("2026-11-21", NOW), Some(NOW - 8.0 * 3600.0));
        for wrong in ["", "d", "-2d", "2y", "tomorrow", "1.5h"] {
            assert_eq!(since(wrong, NOW), None, "{wrong}");
        }
    }

    /// A step that was cut off with the mug on the cups.
    fn gripped(pose: Pose2) -> StepRecord {
        let intent = StepIntent {
            object: "mug".into(),
            from: pose,
            to: pose,
            kind: StepKind::Goal,
            tool_from_object: None,
            table: Vec::new(),
        };
        StepRecord {
            step: 1,
            intent,
            phase: StepPhase::Gripped,
            changed_unix_s: NOW + 20.0,
            gripped_unix_s: Some(NOW + 20.0),
            note: None,
        }
    }

    /// The next one, let go by a person after the job had ended.
    fn let_go(pose: Pose2) -> StepRecord {
        StepRecord {
            step: 2,
            phase: StepPhase::Released,
            changed_unix_s: NOW + 40.0,
            gripped_unix_s: Some(NOW + 25.0),
            note: Some("it was taken off by a person's order".into()),
            ..gripped(pose)
        }
    }

    #[test]
    fn what_is_let_go_after_the_end_of_its_job_stands_after_it() {
        let line = |at: Option<f64>, text: &str| (at, text.to_string());
        let lines = vec![
            line(Some(1.0), "begun"),
            line(None, "found"),
            line(Some(9.0), "let go"),
            line(Some(4.0), "failed"),
        ];
        let texts: Vec<String> = in_order(lines).into_iter().map(|(_, text)| text).collect();
        assert_eq!(texts, ["begun", "found", "failed", "let go"]);
    }

    #[test]
    fn the_story_says_first_how_it_ended_and_what_to_do() {
        let pose = Pose2::new(0.1, 0.2, 0.0);
        let goal = GoalPose { id: "mug".into(), pose };
        let job = JobRecord {
            spec: JobSpec { goal: vec![goal.clone()], ..JobSpec::default() },
            state: JobState::Ended(JobStatus::Failed),
            found: vec![goal.clone()],
            found_unix_s: Some(NOW + 8.0),
            approved: Some("[]".into()),
            resolved: Some(vec![goal.clone()]),
            plan: Some(PlanRecord {
                number: 1,
                lower_bound: Some(1.0),
                seconds: Some(8.0),
                table: vec![goal],
                unix_s: NOW + 9.0,
                ..PlanRecord::default()
            }),
            claimed_unix_s: NOW,
            started_unix_s: Some(NOW + 1.0),
            ended_unix_s: Some(NOW + 30.0),
            result: Some(JobResult {
                id: "tidy".into(),
                status: JobStatus::Failed,
                code: "vacuum_lost".into(),
                message: "mug was lost".into(),
                hint: "see where it lies".into(),
                moves: 0,
                lower_bound: Some(1.0),
                seconds: 29.0,
                times: [("travel".to_string(), 12.0)].into(),
                links_off_mm: None,
                objects: vec![ObjectResult::new("mug", Some(pose), None)],
            }),
            ..JobRecord::sample("tidy")
        };
        let steps = [gripped(pose), let_go(pose)];
        assert_eq!(how_far_at(&steps[1], job.ended_unix_s), "was gripped, on its way to its goal");
        let old = story(&job, &steps, false);
        assert!(old.contains("\nwhat was to be done: see where it lies\n"), "{old}");
        insta::assert_snapshot!(story(&job, &steps, true), @r"
        tidy: failed (vacuum_lost), 2026-11-21T08:00:30Z
        mug was lost
        to do: see where it lies

        2026-11-21T08:00:00Z  taken up: tidy.yaml
        2026-11-21T08:00:01Z  begun
        2026-11-21T08:00:08Z  found 1 objects on the table, 1 of them with a goal
        2026-11-21T08:00:09Z  planned: 0 pick-n-places, lower bound 1, about 8 s
                              a person approved a plan
        2026-11-21T08:00:20Z  1. mug was gripped, on its way to its goal
        2026-11-21T08:00:25Z  2. mug was gripped, on its way to its goal
        2026-11-21T08:00:30Z  failed after 29.0 s
        2026-11-21T08:00:40Z  2. mug was off the gripper on its way to its goal: it was taken off by a person's order
                              where the time went, s: travel 12.0

          mug: not seen since it was gripped; it was taken off by a person's order
        ");
    }
}
