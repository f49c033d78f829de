//! What has changed between two states of the daemon, a line each: for `celld watch`.
//!
//! In: the status before and now. Out: sentences, the most important first; none where nothing that a person
//! follows has changed. Pure.

use crate::jobs::status::{DeviceStatus, RefusedFile, Status};

/// The lines that are new in `now`.
pub fn changes(before: &Status, now: &Status) -> Vec<String> {
    let mut lines = Vec::new();
    if now.daemon != before.daemon {
        lines.push(format!("celld {} has started", now.daemon));
    }
    if now.armed != before.armed {
        let disarmed = if now.moving { "disarmed, THE ARM MAY STILL MOVE" } else { "disarmed" };
        lines.push(if now.armed { "ARMED: the arm may move" } else { disarmed }.to_string());
    }
    if before.moving && !now.moving && !now.armed && now.daemon == before.daemon {
        lines.push("the arm is at rest".to_string());
    }
    if now.paused != before.paused {
        let pausing = if now.moving { "pausing; what is under way is finished first" } else { "paused" };
        lines.push(if now.paused { pausing } else { "the pause is over" }.to_string());
    }
    if let Some(stopped) = now.stopped.as_ref().filter(|_| now.stopped != before.stopped) {
        lines.push(stopped.text(before.job.as_deref().or(now.job.as_deref())));
    }
    if now.job != before.job {
        match (&before.job, &now.job) {
            (None, Some(job)) => lines.push(taken_up(job)),
            (Some(job), None) => lines.push(ended(job)),
            (Some(last), Some(job)) => lines.extend([ended(last), taken_up(job)]),
            (None, None) => {}
        }
    }
    if let Some(plan) = now.plan.as_ref().filter(|plan| before.plan.as_ref() != Some(plan)) {
        lines.push(format!("planned: {}", plan.summary()));
    }
    for id in now.awaiting_approval.iter().filter(|id| !before.awaiting_approval.contains(id)) {
        lines.push(format!("waits for `celld approve {id}` or `celld reject {id}`"));
    }
    if (&now.state, &now.message) != (&before.state, &before.message) || now.step != before.step {
        let step = now.step.filter(|_| now.job.is_some());
        let step = step.map(|(step, of)| format!(" ({step} of {of} moves made)")).unwrap_or_default();
        lines.push(format!("{}{step}", now.message));
    }
    if let Some(because) = now.because.as_ref().filter(|_| now.because != before.because) {
        lines.push(format!("looks again: {because}"));
    }
    if now.holding != before.holding {
        let nothing = "nothing is held".to_string();
        lines.push(format!("gripper: {}", now.holding.as_ref().unwrap_or(&nothing)));
    }
    if (now.waiting, now.unread) != (before.waiting, before.unread) {
        lines.push(format!("jobs that wait: {}, files that are not read yet: {}", now.waiting, now.unread));
    }
    let refused = now.refused.as_ref().filter(|_| now.refused != before.refused);
    lines.extend(refused.map(RefusedFile::text));
    lines.extend(devices(before, now));
    if now.hint != before.hint && !now.hint.is_empty() {
        lines.push(format!("to do: {}", now.hint));
    }
    lines
}

/// Devices that are ready now and were not, or the other way round.
fn devices(before: &Status, now: &Status) -> Vec<String> {
    let was = |name: &str| before.devices.iter().find(|device| device.name == name).map(|d| d.ready);
    let changed = now.devices.iter().filter(|device| was(&device.name) != Some(device.ready));
    let words = |DeviceStatus { name, address, ready, message, .. }: &DeviceStatus| {
        format!("{name} at {address}: {}, {message}", if *ready { "ready" } else { "NOT READY" })
    };
    changed.map(words).collect()
}

fn taken_up(job: &str) -> String {
    format!("job {job} is taken up")
}

fn ended(job: &str) -> String {
    format!("job {job} has ended: `celld why {job}`")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::status::Stopped;

    #[test]
    fn a_refused_file_is_said_once() {
        let idle = Status { state: "idle".into(), message: "idle".into(), ..Status::default() };
        let file =
            RefusedFile { name: "a.yaml".into(), code: "bad".into(), message: "no goal".into(), unix_s: 1.0 };
        let refused = Status { refused: Some(file), ..idle.clone() };
        assert_eq!(
            changes(&idle, &refused),
            ["a.yaml was refused (bad): no goal; `celld why a.yaml` has all of it"]
        );
        assert_eq!(changes(&refused, &refused), Vec::<String>::new());
    }

    #[test]
    fn a_pause_and_the_end_of_a_job_that_another_one_follows_are_said() {
        let stop = Stopped { code: "protective_stop".into(), job: Some("a".into()), ..Stopped::default() };
        let first = Status { armed: true, moving: true, job: Some("a".into()), ..Status::default() };
        let pausing = Status { paused: true, ..first.clone() };
        assert_eq!(changes(&first, &pausing), ["pausing; what is under way is finished first"]);
        let next = Status { job: Some("b".into()), ..first.clone() };
        assert_eq!(changes(&first, &next), ["job a has ended: `celld why a`", "job b is taken up"]);
        assert_eq!(stop.text(next.job.as_deref()), "stopped in job a:  (protective_stop)");
        assert_eq!(stop.text(first.job.as_deref()), "stopped:  (protective_stop)");
    }

    #[test]
    fn only_what_changes_is_said() {
        let idle =
            Status { daemon: "d1".into(), state: "idle".into(), message: "idle".into(), ..Status::default() };
        assert_eq!(changes(&idle, &Status { written_unix_s: 5.0, ..idle.clone() }), Vec::<String>::new());
        let working = Status {
            state: "working".into(),
            message: "carrying mug".into(),
            armed: true,
            job: Some("tidy".into()),
            step: Some((2, 7)),
            holding: Some("mug hangs on it".into()),
            waiting: 3,
            ..idle.clone()
        };
        assert_eq!(
            changes(&idle, &working),
            [
                "ARMED: the arm may move",
                "job tidy is taken up",
                "carrying mug (2 of 7 moves made)",
                "gripper: mug hangs on it",
                "jobs that wait: 3, files that are not read yet: 0",
            ]
        );
        let device = |ready| DeviceStatus {
            name: "gripper".into(),
            address: "10.0.0.3:502".into(),
            ready,
            message: "answers".into(),
            ..DeviceStatus::default()
        };
        let stop = Stopped {
            code: "aborted".into(),
            message: "a person stopped it".into(),
            hint: String::new(),
            job: None,
        };
        let with = Status { devices: vec![device(true)], ..working.clone() };
        let stopped = Status {
            armed: false,
            stopped: Some(stop),
            job: None,
            devices: vec![device(false)],
            hint: "`celld recover`".into(),
            ..with.clone()
        };
        assert_eq!(
            changes(&with, &stopped),
            [
                "disarmed",
                "stopped: a person stopped it (aborted)",
                "job tidy has ended: `celld why tidy`",
                "gripper at 10.0.0.3:502: NOT READY, answers",
                "to do: `celld recover`",
            ]
        );
    }
}
