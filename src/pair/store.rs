//! Jobs in the closed loop: what waits, what is active, what has ended, as the journal would know it.
//!
//! In: jobs, records that reached the disk, restarts. Out: the next job when one is wanted, reports. After a
//! restart the rules are the journal's: a job without an open step waits again, one with an open step is
//! interrupted.

use cell_machine::code::{Code, JobStatus};
use cell_machine::supervisor::input::Record;
use cell_machine::supervisor::model::HeldBefore;
use cell_machine::supervisor::order::{JobOrder, JobReport};
use cell_machine::times::JobTimes;
use std::collections::VecDeque;

/// Jobs. See the module.
#[derive(Default)]
pub struct Store {
    waiting: VecDeque<JobOrder>,
    active: Option<JobOrder>,
    wanted: bool,
    reports: Vec<JobReport>,
    /// Records on disk when the daemon was started last.
    recovered: usize,
    /// What was gripped and not let go when it was.
    held_before: Option<HeldBefore>,
}

impl Store {
    /// A job comes in.
    pub fn submit(&mut self, order: JobOrder) {
        self.waiting.push_back(order);
    }

    /// The machine is free.
    pub fn wanted(&mut self) {
        self.wanted = true;
    }

    /// The next job, if one is wanted and there is one.
    pub fn hand_out(&mut self) -> Option<JobOrder> {
        if !self.wanted || self.active.is_some() {
            return None;
        }
        let job = self.waiting.pop_front()?;
        self.wanted = false;
        self.active = Some(job.clone());
        Some(job)
    }

    /// A record has reached the disk.
    pub fn written(&mut self, record: &Record) {
        if let Record::Ended(report) = record {
            self.active = None;
            self.reports.push((**report).clone());
        }
    }

    /// Jobs that wait for their turn.
    pub fn waiting(&self) -> usize {
        self.waiting.len()
    }

    /// The active job's name.
    pub fn active(&self) -> Option<&str> {
        self.active.as_ref().map(|job| job.id.as_str())
    }

    /// Reports of jobs that have ended, oldest first.
    pub fn reports(&self) -> &[JobReport] {
        &self.reports
    }

    /// Drops reports; the records that they come from are dropped, too.
    pub fn forget(&mut self) {
        self.reports.clear();
        self.recovered = 0;
    }

    /// The daemon starts anew and finds these records.
    pub fn recover(&mut self, durable: &[Record]) {
        self.wanted = false;
        self.held_before = gripped_last(durable);
        let since = durable.get(self.recovered..).unwrap_or_default();
        self.recovered = durable.len();
        let Some(mut job) = self.active.take() else { return };
        // What the journal keeps of the job for its next beginning.
        let mut planned = Vec::new();
        for record in since {
            match record {
                Record::Found { goals, .. } => job.goals.clone_from(goals),
                Record::Planned(plan) => planned.clone_from(&plan.actions),
                Record::Approved => job.agreed.clone_from(&planned),
                _ => {}
            }
        }
        match since.iter().rev().find(|record| is_of_a_step(record)) {
            // Its report had reached the disk, and had reached no reader.
            Some(Record::Ended(report)) if report.id == job.id => self.reports.push((**report).clone()),
            Some(
                Record::Ended(_)
                | Record::LetGo { .. }
                | Record::Done { .. }
                | Record::Withdrawn { .. }
                | Record::Found { .. }
                | Record::Planned(_)
                | Record::Approved,
            )
            | None => {
                self.waiting.push_front(job);
            }
            Some(Record::Intent { .. } | Record::Released { .. }) => self.interrupt(&job, Code::Interrupted),
            Some(Record::Gripped { .. }) => self.interrupt(&job, Code::InterruptedCarrying),
        }
    }

    /// What was gripped and not let go when the daemon was started last.
    pub fn held_before(&self) -> Option<&HeldBefore> {
        self.held_before.as_ref()
    }

    fn interrupt(&mut self, job: &JobOrder, code: Code) {
        self.reports.push(JobReport {
            id: job.id.clone(),
            end: JobStatus::Interrupted,
            code,
            object: None,
            message: code.meaning().to_string(),
            hint: match code {
                Code::InterruptedCarrying => {
                    "something may be held: `celld recover` shows the ways back; then submit again"
                }
                _ => "look at the cell, `celld recover`, then submit the job again",
            }
            .to_string(),
            moves: 0,
            lower_bound: None,
            planned: None,
            planning_seconds: 0.0,
            seconds: 0.0,
            times: JobTimes::default(),
            links_off_m: 0.0,
            objects: Vec::new(),
        });
    }
}

/// False for what is written down of a job beside its steps and its end.
fn is_of_a_step(record: &Record) -> bool {
    !matches!(record, Record::Found { .. } | Record::Planned(_) | Record::Approved)
}

/// The object of the last step, if that was not let go: gripped, or meant to be, for the word of the grip
/// may not have reached the disk.
fn gripped_last(durable: &[Record]) -> Option<HeldBefore> {
    let steps = durable.iter().rev().filter(|record| is_of_a_step(record));
    let mut steps = steps.filter(|record| !matches!(record, Record::Ended(_)));
    let last = steps.next()?;
    let intent = if matches!(last, Record::Gripped { .. }) { steps.next()? } else { last };
    let Record::Intent { object, to, tool_from_object, table, .. } = intent else { return None };
    let (object, table) = (object.clone(), table.clone());
    Some(HeldBefore { object, to: *to, tool_from_object: *tool_from_object, table })
}
