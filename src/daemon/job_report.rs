//! A job as one page: what was found, planned and done, pictures, errors.
//!
//! In: the journal's record and steps of a job, the cell for its shapes, the job's folder for its pictures.
//! Out: the report that `report::html` makes a page of; `celld report` and the daemon's page show the same.

use crate::config::cell::CellConfig;
use crate::daemon::plan_files;
use crate::jobs::history::{how_far_at, story_lines, unseen};
use crate::jobs::record::{
    GoalPose, JobRecord, JobResult, JobState, ObjectResult, StepKind, StepPhase, StepRecord,
};
use crate::jobs::utc;
use crate::report::plan_animation::FILM_CAPTION;
use crate::report::run::{Drawing, Figures, LogRow, MoveRow, ObjectRow, Picture, RunReport};
use crate::report::table_svg::{DrawnObject, TableDrawing, table_svg};
use cell_machine::code::{Code, JobStatus};
use rearrange::geometry::pose::Pose2;
use std::path::Path;

/// What is known of a job, as the page has it.
pub fn job_report(
    job: &JobRecord,
    steps: &[StepRecord],
    cell: &CellConfig,
    folder: Option<&Path>,
) -> RunReport {
    let result = job.result.as_ref();
    let hint = |hint: &str| if hint.is_empty() { String::new() } else { format!("; to do: {hint}") };
    let done = steps.iter().filter(|step| step.phase == StepPhase::Done);
    RunReport {
        title: job.id.clone(),
        reached: job.state == JobState::Ended(JobStatus::Done),
        headline: match result {
            Some(result) => {
                let way = on_the_way(job, steps).map_or_else(String::new, |words| format!("; {words}"));
                format!("{} ({}){way}{}", result.message, result.code, hint(&result.hint))
            }
            None => format!("the job is {}", job.state),
        },
        figures: Figures {
            objects: job.found.len(),
            moves: result.map_or(0, |result| result.moves as usize),
            buffers: done.filter(|step| step.intent.kind == StepKind::Buffer).count(),
            lower_bound: result.and_then(|result| result.lower_bound),
            cycle_s: result.map(|result| result.seconds),
            tolerance_mm: cell.tolerances.goal_position_m * 1e3,
            tolerance_deg: cell.tolerances.goal_angle_rad.to_degrees(),
            ..Figures::default()
        },
        moves: moves(steps, job.started_unix_s, job.ended_unix_s),
        objects: result.map(|result| objects(result, steps)).unwrap_or_default(),
        pictures: folder.map(pictures).unwrap_or_default(),
        drawings: drawings(job, cell),
        log: log(job, steps),
        settings: settings(job),
    }
}

/// What was gripped and not put down when the job ended, where the job's own words leave that open.
fn on_the_way(job: &JobRecord, steps: &[StepRecord]) -> Option<String> {
    let code = job.result.as_ref().map_or("", |result| result.code.as_str());
    if [Code::VacuumLost, Code::InterruptedCarrying].iter().any(|said| said.as_str() == code) {
        return None;
    }
    let last = steps.last()?;
    let off = match last.phase {
        StepPhase::Gripped => false,
        // By a way back, after the job.
        StepPhase::Released => job.ended_unix_s.is_none_or(|ended| last.changed_unix_s <= ended),
        StepPhase::Intent | StepPhase::Done | StepPhase::Abandoned => true,
    };
    (!off).then(|| format!("{} {}", last.intent.object, how_far_at(last, job.ended_unix_s)))
}

fn objects(result: &JobResult, steps: &[StepRecord]) -> Vec<ObjectRow> {
    let row = |object: &ObjectResult| ObjectRow {
        id: object.id.clone(),
        goal: object.goal,
        measured: object.measured,
        unseen: object.measured.is_none().then(|| unseen(&object.id, steps)),
        truth: None,
    };
    result.objects.iter().map(row).collect()
}

/// One row a pick-n-place.
fn moves(steps: &[StepRecord], started_unix_s: Option<f64>, ended_unix_s: Option<f64>) -> Vec<MoveRow> {
    let mut before = started_unix_s;
    let row = |(number, step): (usize, &StepRecord)| {
        let done = step.phase == StepPhase::Done;
        let seconds = before.filter(|_| done).map(|before| step.changed_unix_s - before);
        before = Some(step.changed_unix_s);
        let intent = &step.intent;
        MoveRow {
            object: intent.object.clone(),
            buffer: intent.kind == StepKind::Buffer,
            from: intent.from,
            to: intent.to,
            unfinished: (!done).then(|| how_far_at(step, ended_unix_s)),
            anew: step.phase == StepPhase::Abandoned
                && steps.iter().skip(number + 1).any(|later| later.intent.object == intent.object),
            seconds,
            vacuum: None,
        }
    };
    steps.iter().enumerate().map(row).collect()
}

/// The pictures that the daemon has left in the job's folder.
fn pictures(folder: &Path) -> Vec<Picture> {
    let named = [
        ("plan.jpg", "When the plan was made; its time is in its lower left corner"),
        ("end.jpg", "The last picture of the job; its time is in its lower left corner"),
    ];
    let read = |(name, caption): (&str, &str)| {
        let bytes = std::fs::read(folder.join(name)).ok()?;
        Some(Picture { caption: caption.to_string(), media_type: "image/jpeg", bytes })
    };
    named.into_iter().filter_map(read).collect()
}

fn drawings(job: &JobRecord, cell: &CellConfig) -> Vec<Drawing> {
    let pose = |list: &[GoalPose], id: &str| list.iter().find(|at| at.id == id).map(|at| at.pose);
    let goals = job.resolved.as_ref().unwrap_or(&job.spec.goal);
    let measured = |id: &str| -> Option<Pose2> {
        job.result.as_ref()?.objects.iter().find(|object| object.id == id)?.measured
    };
    let title = "Found, wanted and last seen";
    let drawn = cell.objects.iter().map(|object| DrawnObject {
        id: &object.id,
        footprint: &object.footprint,
        start: pose(&job.found, &object.id).or(object.start.filter(|_| object.fixed)),
        goal: pose(goals, &object.id),
        measured: measured(&object.id),
    });
    let known = |object: &DrawnObject| object.start.or(object.goal).or(object.measured).is_some();
    let table = TableDrawing {
        title,
        width_m: cell.workspace.width_m,
        height_m: cell.workspace.height_m,
        keep_out: cell.workspace.keep_out.iter().map(|region| (&region.footprint, region.pose)).collect(),
        objects: drawn.filter(known).collect(),
    };
    let plan = job.plan.as_ref().and_then(|plan| {
        let caption = format!("The last plan: {}", plan.summary());
        Some(Drawing { svg: plan_files::drawing(plan, cell, &caption)?, caption })
    });
    let film = job.plan.as_ref().filter(|plan| !plan.steps.is_empty()).and_then(|plan| {
        let svg = plan_files::film(plan, cell, "The same, one move after the other")?;
        let caption = match job.state == JobState::Ended(JobStatus::Done) {
            true => FILM_CAPTION.to_string(),
            false => format!("As planned, whatever was carried out of it. {FILM_CAPTION}"),
        };
        Some(Drawing { svg, caption })
    });
    let table = Drawing { caption: title.to_string(), svg: table_svg(&table) };
    std::iter::once(table).chain(plan).chain(film).collect()
}

/// The story, a line each.
fn log(job: &JobRecord, steps: &[StepRecord]) -> Vec<LogRow> {
    let row = |(at, text): (Option<f64>, String)| LogRow {
        seconds: at.map(|at| at - job.claimed_unix_s),
        level: "info",
        text,
    };
    story_lines(job, steps).into_iter().map(row).collect()
}

fn settings(job: &JobRecord) -> Vec<(String, String)> {
    let pair = |key: &str, value: String| (key.to_string(), value);
    let time = |at: Option<f64>| at.map_or_else(|| "-".to_string(), utc::text);
    let mut settings = vec![
        pair("file", job.name.clone()),
        pair("sha256", job.sha256.clone()),
        pair("claimed", time(Some(job.claimed_unix_s))),
        pair("ended", time(job.ended_unix_s)),
    ];
    for (what, seconds) in job.result.iter().flat_map(|result| &result.times) {
        settings.push(pair(what, format!("{seconds:.1} s")));
    }
    if let Some(off_mm) = job.result.as_ref().and_then(|result| result.links_off_mm) {
        settings.push(pair("arm", format!("links up to {off_mm:.1} mm from those of a nominal arm")));
    }
    settings
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::record::StepIntent;

    fn step(step: u32, object: &str, phase: StepPhase) -> StepRecord {
        let at = |x| Pose2::new(x, 0.1, 0.0);
        let intent = StepIntent {
            object: object.into(),
            from: at(0.1),
            to: at(0.2),
            kind: StepKind::Goal,
            tool_from_object: None,
            table: Vec::new(),
        };
        let changed_unix_s = 10.0 * f64::from(step);
        StepRecord { step, intent, phase, changed_unix_s, gripped_unix_s: None, note: None }
    }

    #[test]
    fn what_was_on_its_way_when_the_job_ended_is_in_the_first_line() {
        let ended = |code: Code| {
            let result = JobResult { code: code.to_string(), ..JobResult::sample("a", JobStatus::Failed) };
            JobRecord { ended_unix_s: Some(15.0), result: Some(result), ..JobRecord::sample("a") }
        };
        let (stopped, lost) = (ended(Code::ProtectiveStop), ended(Code::VacuumLost));
        let earlier = JobRecord { ended_unix_s: Some(25.0), ..stopped.clone() };
        let of = |job, phase| on_the_way(job, &[step(1, "lid", StepPhase::Done), step(2, "mug", phase)]);
        let on_its_way = Some("mug was gripped, on its way to its goal".to_string());
        assert_eq!(of(&stopped, StepPhase::Gripped), on_its_way);
        assert_eq!(of(&stopped, StepPhase::Released), on_its_way, "it was let go after the end");
        assert_eq!(of(&earlier, StepPhase::Released), None);
        assert_eq!((of(&stopped, StepPhase::Done), of(&stopped, StepPhase::Intent)), (None, None));
        assert_eq!(of(&lost, StepPhase::Gripped), None, "what was lost is said already");
    }

    #[test]
    fn the_report_says_how_far_the_arm_is_from_nominal_where_that_is_known() {
        let of = |links_off_mm| {
            let result = JobResult { links_off_mm, ..JobResult::sample("a", JobStatus::Done) };
            let settings = settings(&JobRecord { result: Some(result), ..JobRecord::sample("a") });
            settings.into_iter().find(|(key, _)| key == "arm").map(|(_, value)| value)
        };
        assert_eq!(of(Some(4.62)).as_deref(), Some("links up to 4.6 mm from those of a nominal arm"));
        assert_eq!(of(None), None);
    }

    #[test]
    fn what_was_given_up_and_begun_anew_is_there_without_alarm() {
        let steps = [
            step(1, "lid", StepPhase::Abandoned),
            step(2, "mug", StepPhase::Done),
            step(3, "lid", StepPhase::Done),
            step(4, "box", StepPhase::Abandoned),
        ];
        let rows = moves(&steps, Some(0.0), None);
        let drawn: Vec<_> = rows.iter().map(|row| (row.object.as_str(), row.seconds, row.anew)).collect();
        let expected = [
            ("lid", None, true),
            ("mug", Some(10.0), false),
            ("lid", Some(10.0), false),
            ("box", None, false),
        ];
        assert_eq!(drawn, expected);
        assert!(rows[0].unfinished.is_some() && rows[1].unfinished.is_none() && rows[3].unfinished.is_some());
    }
}
