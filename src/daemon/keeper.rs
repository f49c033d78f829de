//! The state folder as the daemon keeps it: job files in, results and status out, orders in and answers out,
//! and the journal in between, which alone is the truth.
//!
//! In: a state folder whose lock this process holds, and the configuration. Out: what
//! [`crate::daemon::store`] requests; what is committed is on disk when the call returns.

mod drawn;
mod file_watch;
mod status_file;
#[cfg(test)]
mod tests;
mod unfinished;

use crate::config::cell::CellConfig;
use crate::daemon::disk::Disk;
use crate::daemon::job_orders::{found_by, job_context, job_order};
use crate::daemon::last_answers::LastAnswers;
use crate::daemon::last_picture::LastPicture;
use crate::daemon::plan_files::{self, poses};
use crate::daemon::store::Keeper;
use crate::jobs::goal::read_goal_file;
use crate::jobs::job_file::read_for_spool;
use crate::jobs::journal::{Journal, JournalError};
use crate::jobs::record::{
    JobRecord, JobResult, JobState, ObjectResult, PlanRecord, StepIntent, StepKind, StepRecord, moves_made,
};
use crate::jobs::spool::{Spool, SpoolError, SpoolEvent, SpoolSettings};
use crate::jobs::state::StateFolder;
use crate::jobs::status;
use cell_edge::clock::unix_now_s;
use cell_machine::code::{Code, JobStatus};
use cell_machine::orders::Reply;
use cell_machine::supervisor::input::Record;
use cell_machine::supervisor::mode::EndFault;
use cell_machine::supervisor::model::{CutOff, HeldBefore};
use cell_machine::supervisor::order::{JobOrder, JobReport};
use cell_machine::supervisor::status::Status;
use cell_machine::times::TimeSplit;
use cell_values::time::{Duration, Timestamp};
use file_watch::FileWatch;
use rearrange::document::chain::chain;
use rearrange::planning::plan::ActionKind;
use std::collections::BTreeMap;
use std::path::Path;
use unfinished::{held_before, unfinished};

/// Why the state folder cannot be kept.
#[derive(Debug, thiserror::Error)]
pub enum KeeperError {
    /// The journal.
    #[error("the journal cannot be used")]
    Journal(#[from] JournalError),
    /// The job folders.
    #[error("the job folders cannot be used")]
    Spool(#[from] SpoolError),
    /// The command folder.
    #[error("the command folder cannot be used")]
    Files(#[from] cell_edge::files::FileError),
}

/// Journal, job folders and status of one state folder.
pub struct StateKeeper {
    config: CellConfig,
    state: StateFolder,
    journal: Journal,
    spool: Spool,
    daemon: String,
    started_unix_s: f64,
    /// The active job and its open step.
    active: Option<(String, Option<u32>)>,
    /// What the camera showed last.
    pictures: LastPicture,
    /// The file that the configuration came from.
    config_file: String,
    /// What is planned for it.
    plan: Option<PlanRecord>,
    /// The plan is not in the job's folder yet.
    undrawn: bool,
    notices: Vec<String>,
    held_before: Option<HeldBefore>,
    plans_before: u64,
    cut_off: Option<CutOff>,
    identities: Identities,
    last_answers: LastAnswers,
    disk: Disk,
    file_watch: FileWatch,
    /// The last status could not be written.
    status_is_old: bool,
    /// When the history was brought within its limits last.
    pruned: Option<Timestamp>,
    /// The file that was refused last.
    refused: Option<status::RefusedFile>,
    /// Whoever is given each status that is written.
    publish: Publish,
    /// What the cell's part in a fleet has to say in it.
    remarks: status::Remarks,
    /// The shared part of the configuration, for people.
    shared: Option<String>,
}

/// Is given each status; must not block.
pub type Publish = Box<dyn Fn(&status::Status) + Send>;

/// Which devices the cell works with, in words for the status.
#[derive(Clone, Debug, Default)]
pub struct Identities {
    /// Serial number.
    pub robot: String,
    /// Serial number.
    pub camera: String,
}

/// When the history is looked through again once it is within its limits.
const PRUNE_EVERY: Duration = Duration::from_secs(3600);

impl StateKeeper {
    /// Opens journal and folders, and decides about jobs that an earlier daemon left unfinished. `daemon` is
    /// a name that no other run has.
    ///
    /// # Errors
    /// What cannot be used.
    pub fn open(config: CellConfig, state: StateFolder, daemon: String) -> Result<StateKeeper, KeeperError> {
        let now = unix_now_s();
        let mut journal = Journal::open(&state.journal())?;
        let (notices, cut_off) = unfinished(&mut journal, now)?;
        let mut spool = Spool::open(
            state.root(),
            SpoolSettings { at_once: 1, entries_at_once: 200, ..SpoolSettings::STANDARD },
        )?;
        spool.reconcile_at_start(&mut journal)?;
        let (started_unix_s, disk) = (now, Disk::of(state.root()));
        let state_journal = state.journal();
        let (held_before, plans_before) = (held_before(&journal)?, journal.highest_plan()?);
        Ok(StateKeeper {
            config,
            state,
            journal,
            spool,
            daemon,
            started_unix_s,
            active: None,
            pictures: LastPicture::new(None),
            config_file: String::new(),
            plan: None,
            undrawn: false,
            notices,
            held_before,
            plans_before,
            cut_off,
            identities: Identities::default(),
            last_answers: LastAnswers::default(),
            disk,
            file_watch: FileWatch::new(state_journal),
            status_is_old: false,
            pruned: None,
            publish: Box::new(|_| {}),
            refused: None,
            remarks: status::Remarks::default(),
            shared: None,
        })
    }

    /// With somewhere else that each status goes, and what the cell's part in a fleet has to say in it.
    pub fn published(self, publish: Publish, remarks: status::Remarks) -> StateKeeper {
        StateKeeper { publish, remarks, ..self }
    }

    /// What of the configuration is shared with other cells, in words.
    pub fn sharing(self, shared: Option<String>) -> StateKeeper {
        StateKeeper { shared, ..self }
    }

    /// With pictures for the folders of jobs, and for whoever reads the status: the name of the
    /// configuration, which devices there are and when they answered.
    pub fn with(
        self,
        pictures: LastPicture,
        config_file: &Path,
        identities: Identities,
        last_answers: LastAnswers,
    ) -> StateKeeper {
        let file = std::path::absolute(config_file).unwrap_or_else(|_| config_file.to_path_buf());
        StateKeeper { pictures, config_file: file.display().to_string(), identities, last_answers, ..self }
    }

    /// The job that was cut off when an earlier celld ended.
    pub fn cut_off(&self) -> Option<CutOff> {
        self.cut_off.clone()
    }

    /// Brings the history within its limits, a few jobs at a time while nothing is carried out.
    fn prune(&mut self, now: Timestamp) {
        if self.active.is_some() || self.pruned.is_some_and(|at| now.since(at) < PRUNE_EVERY) {
            return;
        }
        match self.spool.remove_old(&mut self.journal, &self.config.history, unix_now_s()) {
            Ok(0) => self.pruned = Some(now),
            Ok(count) => tracing::info!(count, "old jobs and refusals were removed from the history"),
            Err(error) => {
                self.pruned = Some(now);
                tracing::warn!(error = %chain(&error), "the history could not be brought within its limits");
            }
        }
    }

    /// What was gripped and not let go when an earlier celld ended.
    pub fn held_before(&self) -> Option<HeldBefore> {
        self.held_before.clone()
    }

    /// The highest number of a plan that an earlier celld made, as far as the journal has it.
    pub fn plans_before(&self) -> u64 {
        self.plans_before
    }

    /// What the recovery found, once.
    pub fn notices(&mut self) -> Vec<String> {
        std::mem::take(&mut self.notices)
    }

    /// Writes down that the daemon waits for something before it takes orders; a disk that does not take it
    /// is named later, by what needs it.
    pub fn waits_for(&self, message: &str) {
        let (started, now) = (self.started_unix_s, unix_now_s());
        let status = status::Status::starting(self.daemon.clone(), started, now, message.to_string());
        (self.publish)(&status);
        if let Err(error) = status.write(&self.state.status()) {
            tracing::warn!(error = %chain(&error), "the status file could not be written");
        }
    }

    /// Takes in new job files; a fault of the folders is said and tried again at the next call.
    fn scan(&mut self, now: Timestamp) -> Vec<SpoolEvent> {
        let config = &self.config;
        let obstacles = config.obstacles();
        let read_goal = |name: &str| read_goal_file(&config.goal_folder, name);
        // The journal itself is at work in the scan.
        let path = self.state.journal();
        let found = |id: &str| found_by(&path, id);
        let context = job_context(config, &obstacles, &read_goal, &found);
        let read = |text: &str, name: &str| read_for_spool(text, name, &context);
        self.spool.scan(&mut self.journal, &read, now, unix_now_s()).unwrap_or_else(|error| {
            tracing::error!(error = %chain(&error), "no job file could be taken in");
            Vec::new()
        })
    }

    fn is_active(&self, id: &str) -> bool {
        self.active.as_ref().is_some_and(|(active, _)| active == id)
    }

    fn reconcile(&mut self) {
        if let Err(error) = self.spool.reconcile(&mut self.journal) {
            tracing::error!(error = %chain(&error), "job folders could not be brought into line; tried again later");
        }
    }

    /// Ends a job that has not begun; false when it is not waiting.
    fn end_waiting(&mut self, id: &str) -> Result<bool, JournalError> {
        if !self.journal.job(id)?.is_some_and(|job| job.state == JobState::Waiting) {
            return Ok(false);
        }
        let message = match self.moves_of(id)? {
            0 => "the operator cancelled the job before it began".to_string(),
            moves => format!("the operator cancelled the job before it went on; it had made {moves} moves"),
        };
        self.end_unbegun(id, JobStatus::Cancelled, Code::Cancelled, message, String::new())?;
        Ok(true)
    }

    /// Pick-n-places that a job has made: one that went on after a restart may have made some before.
    fn moves_of(&self, id: &str) -> Result<u32, JournalError> {
        Ok(moves_made(&self.journal.steps(id)?))
    }

    fn end_unbegun(
        &mut self,
        id: &str,
        status: JobStatus,
        code: Code,
        message: String,
        hint: String,
    ) -> Result<(), JournalError> {
        let result = JobResult {
            id: id.to_string(),
            status,
            code: code.to_string(),
            message,
            hint,
            moves: self.moves_of(id)?,
            lower_bound: None,
            seconds: 0.0,
            times: BTreeMap::new(),
            links_off_mm: None,
            objects: Vec::new(),
        };
        self.journal.finish(id, &result, unix_now_s())?;
        self.reconcile();
        Ok(())
    }

    /// The next job that can be begun. One that names a solver of another build is ended with that reason:
    /// nothing else is put in its place.
    fn next_job(&mut self) -> Result<Option<JobOrder>, JournalError> {
        while let Some(job) = self.journal.next_ready(unix_now_s())? {
            self.journal.start(&job.id, unix_now_s())?;
            match self.order(&job) {
                Ok(order) => {
                    self.pictures.job_begins();
                    self.plan.clone_from(&job.plan);
                    self.active = Some((job.id, None));
                    self.reconcile();
                    return Ok(Some(order));
                }
                Err(message) => {
                    let hint = "name a solver of this celld in the job, submit again".to_string();
                    self.end_unbegun(&job.id, JobStatus::Failed, Code::SolverUnfit, message, hint)?;
                }
            }
        }
        Ok(None)
    }

    fn order(&self, job: &JobRecord) -> Result<JobOrder, String> {
        let goals = job.resolved.as_ref().unwrap_or(&job.spec.goal);
        job_order(&self.config, &job.id, &job.spec, goals, &job.agreed())
    }

    /// What was let go by hand while its job goes on has closed the job's step.
    fn forget_a_closed_step(&mut self) -> Result<(), JournalError> {
        if let Some((id, open)) = &mut self.active {
            let still = |step: &StepRecord| Some(step.step) == *open && step.phase.is_open();
            if !self.journal.steps(id)?.iter().any(still) {
                *open = None;
            }
        }
        Ok(())
    }

    fn write(&mut self, record: &Record) -> Result<(), JournalError> {
        if let Record::Ended(report) = record {
            let now = unix_now_s();
            self.journal.finish(&report.id, &result_of(report, now), now)?;
            self.draw_plan();
            if let Ok(Some(folder)) = self.spool.folder_now(&self.journal, &report.id) {
                self.leave_picture(self.pictures.of_job(&[]), &folder.join("end.jpg"));
            }
            (self.active, self.plan) = (None, None);
            self.reconcile();
            return Ok(());
        }
        let now = unix_now_s();
        if let Record::LetGo { how } = record {
            self.journal.let_go(how, now)?;
            return self.forget_a_closed_step();
        }
        let Some((id, open)) = &mut self.active else { return Ok(()) };
        match (record, *open) {
            (Record::Found { objects: o, goals: g }, _) => self.journal.found(id, &poses(o), &poses(g), now),
            (Record::Planned(note), _) => {
                let plan = plan_files::record_of(note, now);
                self.undrawn = true;
                self.journal.planned(id, self.plan.insert(plan))
            }
            (Record::Approved, _) => self.journal.approve(id, now),
            (Record::Intent { object, from, to, kind, tool_from_object, table, .. }, previous) => {
                // A grip that failed left its step open; it is over once the next one is meant.
                if let Some(step) = previous {
                    self.journal.step_abandoned(id, step, now)?;
                }
                let kind = match kind {
                    ActionKind::Goal => StepKind::Goal,
                    ActionKind::Buffer => StepKind::Buffer,
                };
                let (object, tool_from_object, table) = (object.clone(), *tool_from_object, table.clone());
                let intent = StepIntent { object, from: *from, to: *to, kind, tool_from_object, table };
                *open = Some(self.journal.step_intent(id, &intent, now)?);
                Ok(())
            }
            (Record::Gripped { .. }, Some(step)) => self.journal.step_gripped(id, step, now),
            (Record::Released { .. }, Some(step)) => self.journal.step_released(id, step, now),
            (Record::Withdrawn { .. }, Some(step)) => {
                *open = None;
                self.journal.step_abandoned(id, step, now)
            }
            (Record::Done { .. }, Some(step)) => {
                *open = None;
                self.journal.step_done(id, step, now)
            }
            (
                Record::Gripped { .. }
                | Record::Released { .. }
                | Record::Done { .. }
                | Record::Withdrawn { .. },
                None,
            )
            | (Record::LetGo { .. } | Record::Ended(_), _) => Ok(()),
        }
    }
}

/// A report as the journal keeps it.
fn result_of(report: &JobReport, unix_s: f64) -> JobResult {
    JobResult {
        id: report.id.clone(),
        status: report.end,
        code: report.code_text(),
        message: report.message.clone(),
        hint: report.hint.clone(),
        moves: u32::try_from(report.moves).unwrap_or(u32::MAX),
        lower_bound: report.lower_bound,
        seconds: report.seconds,
        times: in_words(&report.times.total()),
        links_off_mm: Some(report.links_off_m * 1e3),
        objects: report
            .objects
            .iter()
            .map(|object| {
                let measured = object.measured.map(|(pose, age)| (pose, unix_s - age.as_secs_f64()));
                ObjectResult::new(object.id.clone(), object.goal, measured)
            })
            .collect(),
    }
}

/// Seconds by the word of their use, to a millisecond.
fn in_words(split: &TimeSplit) -> BTreeMap<String, f64> {
    split.iter().map(|(what, seconds)| (what.to_string(), (seconds * 1e3).round() / 1e3)).collect()
}

impl Keeper for StateKeeper {
    fn commit(&mut self, record: &Record) -> Result<(), String> {
        let written = self.write(record).map_err(|error| chain(&error));
        // A commit that reached a file without a name has failed.
        self.file_watch.look(&mut self.journal).map_or(written, Err)
    }

    fn fault(&mut self) -> Option<EndFault> {
        let idle = self.active.is_none();
        self.file_watch.fault(&mut self.journal, idle).map(EndFault::Damaged)
    }

    fn look_after(&mut self, now: Timestamp) -> Vec<String> {
        let mut cancelled = Vec::new();
        for event in self.scan(now) {
            match event {
                SpoolEvent::Claimed { id, name } => tracing::info!(job = id, name, "job accepted"),
                SpoolEvent::Rejected { name, code, message: why, reason } => {
                    tracing::warn!(name, %code, why, reason = %reason.display(), "job rejected");
                    let (code, unix_s) = (code.to_string(), unix_now_s());
                    self.refused = Some(status::RefusedFile { name, code, message: why, unix_s });
                }
                SpoolEvent::Cancel { id } if self.is_active(&id) => cancelled.push(id),
                SpoolEvent::Cancel { id } => match self.end_waiting(&id) {
                    Ok(true) => tracing::info!(job = id, "waiting job cancelled"),
                    Ok(false) => tracing::warn!(job = id, "there is no such job to cancel"),
                    Err(error) => {
                        tracing::error!(job = id, error = %chain(&error), "job could not be cancelled")
                    }
                },
                SpoolEvent::Full { name } => tracing::warn!(name, "the queue is full"),
                SpoolEvent::Unreadable { name, message } => tracing::warn!(name, why = message, "job file"),
            }
        }
        self.reconcile();
        self.draw_plan();
        self.prune(now);
        cancelled
    }

    fn has_more(&self) -> bool {
        self.spool.has_more()
    }

    fn claim(&mut self) -> Option<JobOrder> {
        if self.active.is_some() || self.disk.low().is_some() || self.file_watch.is_lost() {
            return None;
        }
        self.next_job().unwrap_or_else(|error| {
            tracing::error!(error = %chain(&error), "the next job could not be read");
            None
        })
    }

    fn close(&mut self) {
        self.leave_no_old_status();
    }

    fn cancel_waiting(&mut self, id: &str) -> Option<Reply> {
        match self.end_waiting(id) {
            Ok(true) => Some(Reply::accept("cancelled before it began")),
            Ok(false) => None,
            Err(error) => Some(Reply::refuse(error.to_string())),
        }
    }

    fn status(&mut self, status: &Status) {
        self.write_status(status);
    }
}
