//! What is reported to the fleet of a cell: its state, and events where the status has changed.
//!
//! In: the status before and now. Out: [`What`] happened, and the part of [`CellState`] that a status shows.
//! Pure.

use crate::jobs::record::{JobRecord, JobState};
use crate::jobs::status::{STARTING, Status};
use cell_fleet::payloads::{CellState, Outcome, What};
use cell_fleet::values::Local;
use cell_machine::code::JobStatus;

/// The word of the status for a cell that has nothing to do.
const IDLE: &str = "idle";

/// Nothing is worked on, nothing waits, and nothing has to be done by a person first.
pub fn is_idle(status: &Status) -> bool {
    let free = status.job.is_none() && status.waiting == 0 && status.unread == 0 && status.blocked.is_none();
    free && status.state == IDLE && !status.paused && status.stopped.is_none() && status.holding.is_none()
}

/// What a status shows of a cell.
pub fn state_of(status: Option<&Status>) -> CellState {
    let celld = env!("CARGO_PKG_VERSION").to_string();
    let Some(status) = status else {
        return CellState { celld, state: STARTING.to_string(), ..CellState::default() };
    };
    CellState {
        celld,
        state: status.state.clone(),
        message: status.message.clone(),
        hint: status.hint.clone(),
        armed: status.armed,
        moving: status.moving,
        idle: is_idle(status),
        job: status.job.clone(),
        awaiting_approval: status.awaiting_approval.clone(),
        plan: status.plan.as_ref().map(|plan| plan.number),
        step: status.step,
        ..CellState::default()
    }
}

/// What has happened between two statuses, with the job it is about.
pub fn events(before: &Status, now: &Status) -> Vec<(Option<String>, What)> {
    let mut events = Vec::new();
    let job = || now.job.clone();
    if let Some(plan) = now.plan.as_ref().filter(|plan| before.plan.as_ref() != Some(plan) && !plan.preview) {
        let waits = now.job.as_ref().is_some_and(|job| now.awaiting_approval.contains(job));
        let moves = u32::try_from(plan.steps.len()).unwrap_or(u32::MAX);
        events.push((job(), What::Planned { moves, lower_bound: plan.lower_bound, waits }));
    }
    let made = |status: &Status| status.step.filter(|_| status.job == now.job);
    if let Some((step, of)) =
        now.step.filter(|(step, _)| *step > 0 && made(before).is_none_or(|b| b.0 < *step))
    {
        events.push((job(), What::Step { step, of }));
    }
    if let Some(stopped) = now.stopped.as_ref().filter(|_| now.stopped != before.stopped) {
        let (code, message) = (stopped.code.clone(), stopped.message.clone());
        events.push((now.job.clone().or_else(|| before.job.clone()), What::Fault { code, message }));
    }
    events
}

/// Jobs whose plan does not wait any more and which go on: a person has decided.
pub fn decided(before: &Status, now: &Status) -> Vec<String> {
    let gone = |id: &&String| !now.awaiting_approval.contains(id);
    before.awaiting_approval.iter().filter(gone).cloned().collect()
}

/// What the journal's record of a job says to the fleet.
pub fn local(job: &JobRecord) -> Local {
    let JobState::Ended(status) = job.state else { return Local::Open };
    let word = match status {
        JobStatus::Done => "done",
        JobStatus::Failed => "failed",
        JobStatus::Cancelled => "cancelled",
        JobStatus::Interrupted => "interrupted",
    };
    let result = job.result.as_ref();
    Local::Ended(Outcome {
        status: word.to_string(),
        code: result.map(|result| result.code.clone()).unwrap_or_default(),
        message: result.map(|result| result.message.clone()).unwrap_or_default(),
        moves: result.map_or(0, |result| result.moves),
        lower_bound: result.and_then(|result| result.lower_bound),
        seconds: result.map_or(0.0, |result| result.seconds),
    })
}

/// A job that the cell's own reader refused, after it was begun for the fleet.
pub fn rejected(reason: &str) -> Local {
    let (status, code) = ("rejected".to_string(), "rejected".to_string());
    Local::Ended(Outcome { status, code, message: reason.to_string(), ..Outcome::default() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::record::PlanRecord;
    use crate::jobs::status::Stopped;

    fn idle() -> Status {
        Status { state: "idle".into(), armed: true, ..Status::default() }
    }

    #[test]
    fn a_cell_with_anything_to_do_is_not_idle() {
        assert!(is_idle(&idle()));
        for busy in [
            Status { job: Some("a".into()), ..idle() },
            Status { waiting: 1, ..idle() },
            Status { unread: 1, ..idle() },
            Status { paused: true, ..idle() },
            Status { blocked: Some("the disk is nearly full".into()), ..idle() },
            Status { stopped: Some(Stopped::default()), ..idle() },
            Status { holding: Some("mug".into()), ..idle() },
            Status { state: "executing".into(), ..idle() },
        ] {
            assert!(!is_idle(&busy), "{busy:?}");
        }
        assert!(!state_of(None).armed && !state_of(None).idle);
    }

    #[test]
    fn plan_steps_and_stops_are_reported_once() {
        let plan = PlanRecord {
            number: 1,
            steps: Vec::new(),
            lower_bound: Some(2.0),
            seconds: None,
            table: Vec::new(),
            preview: false,
            made: 0,
            sight_age_s: 0.0,
            unix_s: 1.0,
        };
        let planned = Status { job: Some("a".into()), plan: Some(plan), step: Some((0, 2)), ..idle() };
        let reported = events(&idle(), &planned);
        assert!(
            matches!(&reported[..], [(Some(job), What::Planned { moves: 0, waits: false, .. })] if job == "a")
        );
        let stepped = Status { step: Some((1, 2)), ..planned.clone() };
        assert_eq!(events(&planned, &stepped), [(Some("a".to_string()), What::Step { step: 1, of: 2 })]);
        assert_eq!(events(&stepped, &stepped), []);
        let stopped = Stopped {
            code: "vacuum_lost".into(),
            message: "mug was lost".into(),
            hint: String::new(),
            job: None,
        };
        let stopped = Status { stopped: Some(stopped), job: None, step: None, plan: None, ..idle() };
        let reported = events(&stepped, &stopped);
        assert!(
            matches!(&reported[..], [(Some(job), What::Fault { code, .. })] if job == "a" && code == "vacuum_lost")
        );
    }

    #[test]
    fn the_next_job_counts_its_steps_anew() {
        let job = |id: &str, step| Status { job: Some(id.into()), step: Some((step, 3)), ..idle() };
        assert_eq!(events(&job("a", 3), &job("b", 1)).len(), 1);
        assert_eq!(events(&job("a", 3), &job("b", 0)).len(), 0);
    }

    #[test]
    fn a_plan_that_waits_no_more_was_decided() {
        let waits = Status { awaiting_approval: vec!["a".into()], ..idle() };
        assert_eq!(decided(&waits, &idle()), ["a"]);
        assert_eq!(decided(&idle(), &waits), Vec::<String>::new());
    }
}
