//! The daemon's office in the state folder: job files in, commands in, results and status out, and the
//! journal in between, which alone is the truth.
//!
//! In: a state folder whose lock this process holds, and the configuration. Out: inputs for the supervisor; what
//! it reports is committed before this returns.

use crate::config::cell::CellConfig;
use crate::daemon::run::Office;
use crate::device::gripper::Channels;
use crate::io::clock::unix_now_s;
use crate::jobs::command::{Command, Inbox, ReleaseChannel, Reply, Taken};
use crate::jobs::goal::read_goal_file;
use crate::jobs::job_file::{JobContext, read_for_spool};
use crate::jobs::journal::{Journal, JournalError, Recovered};
use crate::jobs::policy::{Approval, JobObjective};
use crate::jobs::record::{JobRecord, JobResult, JobState, JobStatus, ObjectResult, StepIntent};
use crate::jobs::spool::{Spool, SpoolError, SpoolEvent, SpoolSettings};
use crate::jobs::state::StateFolder;
use crate::jobs::status;
use crate::planning::plan::Objective;
use crate::planning::solver::SolverKind;
use crate::supervisor::cell::Status;
use crate::supervisor::input::{Input, JournalEntry, OperatorCommand};
use crate::supervisor::order::{ApprovalRule, JobEnd, JobOrder, JobReport};
use crate::time::{Duration, Timestamp};

/// Why the office cannot open.
#[derive(Debug, thiserror::Error)]
pub enum OfficeError {
    /// The journal.
    #[error("the journal cannot be used")]
    Journal(#[from] JournalError),
    /// The job folders.
    #[error("the job folders cannot be used")]
    Spool(#[from] SpoolError),
    /// The command folder.
    #[error("the command folder cannot be used")]
    Files(#[from] crate::io::files::FileError),
}

/// The open office.
pub struct StateOffice {
    config: CellConfig,
    state: StateFolder,
    journal: Journal,
    spool: Spool,
    inbox: Inbox,
    daemon: String,
    started_unix_s: f64,
    /// The active job and its open step.
    active: Option<(String, Option<u32>)>,
    last: Status,
    notices: Vec<String>,
    /// Commands that the loop has heard of, and what is to be said of them.
    unanswered: Vec<(Taken, Reply)>,
}

impl StateOffice {
    /// Opens journal, folders and inbox, and decides about jobs that an earlier daemon left unfinished.
    ///
    /// # Errors
    /// What cannot be used.
    pub fn open(config: CellConfig, state: StateFolder, daemon: String) -> Result<StateOffice, OfficeError> {
        let now = unix_now_s();
        let mut journal = Journal::open(&state.journal())?;
        let mut notices = Vec::new();
        for recovered in journal.recover(now)? {
            notices.push(match recovered {
                Recovered::Requeued { id } => {
                    format!("job {id} was not begun before the last end; it waits again")
                }
                Recovered::Interrupted { id, step } => {
                    format!(
                        "job {id} was cut off in step {} ({}); see its result",
                        step.step, step.intent.object
                    )
                }
            });
        }
        let mut spool = Spool::open(state.root(), SpoolSettings { at_once: 1, ..SpoolSettings::STANDARD })?;
        spool.reconcile_at_start(&mut journal)?;
        let inbox = Inbox::open(&state.commands(), daemon.clone())?;
        let last = Status {
            armed: false,
            paused: false,
            phase: "starting".to_string(),
            job: None,
            moves: 0,
            remaining_moves: 0,
        };
        let started_unix_s = now;
        Ok(StateOffice {
            config,
            state,
            journal,
            spool,
            inbox,
            daemon,
            started_unix_s,
            active: None,
            last,
            notices,
            unanswered: Vec::new(),
        })
    }

    /// What the recovery has to say, once.
    pub fn notices(&mut self) -> Vec<String> {
        std::mem::take(&mut self.notices)
    }

    /// Takes in new job files; a fault of the folders is said and tried again at the next call.
    fn scan(&mut self, now: Timestamp, inputs: &mut Vec<Input>) {
        let config = &self.config;
        let folder = config.goal_folder.clone();
        let obstacles = config.obstacles();
        let read_goal = move |name: &str| read_goal_file(&folder, name);
        let context = JobContext {
            goal: Some(config.goal_context(&obstacles)),
            approval: config.approval,
            read_goal: &read_goal,
        };
        let read = |text: &str, name: &str| read_for_spool(text, name, &context);
        let events = match self.spool.scan(&mut self.journal, &read, now, unix_now_s()) {
            Ok(events) => events,
            Err(error) => return tracing::error!(%error, "job folders"),
        };
        for event in events {
            match event {
                SpoolEvent::Claimed { id, name } => tracing::info!(id, name, "job accepted"),
                SpoolEvent::Rejected { name, code, message, reason } => {
                    tracing::warn!(name, code, message, reason = %reason.display(), "job rejected");
                }
                SpoolEvent::Cancel { id } => self.cancel_file(&id, inputs),
                SpoolEvent::Full { name } => tracing::warn!(name, "the queue is full"),
                SpoolEvent::Trouble { name, message } => tracing::warn!(name, message, "job file"),
            }
        }
        self.reconcile();
    }

    fn cancel_file(&mut self, id: &str, inputs: &mut Vec<Input>) {
        if self.active.as_ref().is_some_and(|(active, _)| active == id) {
            return inputs.push(Input::Operator(OperatorCommand::Cancel));
        }
        match self.cancel_waiting(id) {
            Ok(true) => tracing::info!(id, "waiting job cancelled"),
            Ok(false) => tracing::warn!(id, "there is no such job to cancel"),
            Err(error) => tracing::error!(id, %error, "job could not be cancelled"),
        }
    }

    fn reconcile(&mut self) {
        if let Err(error) = self.spool.reconcile(&mut self.journal) {
            tracing::error!(%error, "job folders could not be brought into line; tried again later");
        }
    }

    fn answer(&mut self) {
        for (command, reply) in std::mem::take(&mut self.unanswered) {
            if let Err(error) = self.inbox.reply(&command, &reply) {
                tracing::warn!(%error, "a command could not be answered");
            }
        }
    }

    /// Ends a job that has not begun; false when it is not waiting.
    fn cancel_waiting(&mut self, id: &str) -> Result<bool, JournalError> {
        if !self.journal.job(id)?.is_some_and(|job| job.state == JobState::Waiting) {
            return Ok(false);
        }
        let result = JobResult {
            id: id.to_string(),
            status: JobStatus::Cancelled,
            code: "cancelled".to_string(),
            message: "the operator cancelled the job before it began".to_string(),
            remedy: String::new(),
            moves: 0,
            lower_bound: None,
            seconds: 0.0,
            objects: Vec::new(),
        };
        self.journal.finish(id, &result, unix_now_s())?;
        self.reconcile();
        Ok(true)
    }

    fn translate(&mut self, command: &Command) -> (Option<OperatorCommand>, Reply) {
        let accept = |operator: OperatorCommand, message: &str| {
            (Some(operator), Reply { accepted: true, message: message.to_string() })
        };
        let refuse = |message: String| (None, Reply { accepted: false, message });
        let active = self.active.as_ref().map(|(id, _)| id.clone());
        let of_active = |id: &str, operator, message| match &active {
            Some(active) if active == id => accept(operator, message),
            _ => refuse(format!("job {id} is not the active one; `celld status` names it")),
        };
        match command {
            Command::Arm => accept(OperatorCommand::Arm, "armed"),
            Command::Disarm => accept(
                OperatorCommand::Disarm,
                "disarmed; a motion under way is finished first, `celld abort` stops it now",
            ),
            Command::Approve { id } => of_active(id, OperatorCommand::Approve, "approved"),
            Command::Reject { id } => of_active(id, OperatorCommand::Reject, "rejected"),
            Command::Cancel { id } => match self.cancel_waiting(id) {
                Ok(true) => {
                    (None, Reply { accepted: true, message: "cancelled before it began".to_string() })
                }
                Ok(false) => {
                    of_active(id, OperatorCommand::Cancel, "cancelled after the present pick-n-place")
                }
                Err(error) => refuse(error.to_string()),
            },
            Command::Pause => accept(OperatorCommand::Pause, "pauses after the present pick-n-place"),
            Command::Resume => accept(OperatorCommand::Resume, "goes on"),
            Command::Step => accept(OperatorCommand::Step, "one pick-n-place"),
            Command::Abort => accept(OperatorCommand::Abort, "stopped and disarmed"),
            Command::Park if !self.last.armed => {
                refuse("the cell is disarmed; `celld arm` first".to_string())
            }
            Command::Park => accept(OperatorCommand::Park, "parks as soon as it may move"),
            Command::Release { channel } => {
                let channels = match channel {
                    Some(ReleaseChannel::A) => Channels::A,
                    Some(ReleaseChannel::B) => Channels::B,
                    None => Channels::Both,
                };
                accept(OperatorCommand::Release(channels), &format!("vacuum off, {}", channels.word()))
            }
            Command::Recover { .. } => refuse(
                "recover is not built yet: clear the stop at the pendant, look at the arm, then `celld arm`"
                    .into(),
            ),
        }
    }

    fn next_job(&mut self) -> Option<Input> {
        let job = match self.journal.next_ready(unix_now_s()) {
            Ok(job) => job?,
            Err(error) => {
                tracing::error!(%error, "journal");
                return None;
            }
        };
        if let Err(error) = self.journal.start(&job.id, unix_now_s()) {
            tracing::error!(%error, "journal");
            return None;
        }
        self.reconcile();
        self.active = Some((job.id.clone(), None));
        Some(Input::Job(Box::new(self.order(&job))))
    }

    fn order(&self, job: &JobRecord) -> JobOrder {
        let planner = &self.config.planner;
        let spec = &job.spec;
        let objective = objective_of(spec.objective.unwrap_or(planner.objective));
        let solver = spec.solver.as_deref().unwrap_or(&planner.solver);
        let seconds = spec.time_limit_s.unwrap_or(planner.time_limit_s);
        JobOrder {
            id: job.id.clone(),
            goals: spec.goal.iter().map(|goal| (goal.id.clone(), goal.pose)).collect(),
            objective,
            // A name the build does not know comes back as a refusal of the planner, in words.
            solver: SolverKind::from_word(solver).unwrap_or(SolverKind::Auto),
            time_limit: Duration::from_secs_f64(seconds.clamp(0.001, 86_400.0)),
            seed: spec.seed.unwrap_or(planner.seed),
            approval: self.approval(spec.approval),
        }
    }

    /// The cell's policy is a floor, also for a job that was taken in under a laxer one.
    fn approval(&self, job: Option<Approval>) -> ApprovalRule {
        match self.config.approval.max(job.unwrap_or(Approval::Never)) {
            Approval::Always => ApprovalRule::EveryPlan,
            Approval::Job => ApprovalRule::FirstPlan,
            Approval::Never => ApprovalRule::NoPlan,
        }
    }

    fn result(report: &JobReport) -> JobResult {
        JobResult {
            id: report.id.clone(),
            status: match report.end {
                JobEnd::Done => JobStatus::Done,
                JobEnd::Failed => JobStatus::Failed,
                JobEnd::Cancelled => JobStatus::Cancelled,
                JobEnd::Interrupted => JobStatus::Interrupted,
            },
            code: report.code.clone(),
            message: report.message.clone(),
            remedy: report.remedy.clone(),
            moves: u32::try_from(report.moves).unwrap_or(u32::MAX),
            lower_bound: report.lower_bound,
            seconds: report.seconds,
            objects: report
                .objects
                .iter()
                .map(|o| ObjectResult::new(o.id.clone(), o.goal, o.measured))
                .collect(),
        }
    }
}

impl Office for StateOffice {
    fn commands(&mut self) -> Vec<Input> {
        let taken = self.inbox.take().unwrap_or_else(|error| {
            tracing::error!(%error, "command folder");
            Vec::new()
        });
        let mut inputs = Vec::new();
        for command in taken {
            let (input, reply) = self.translate(&command.command);
            inputs.extend(input.map(Input::Operator));
            self.unanswered.push((command, reply));
        }
        inputs
    }

    fn jobs(&mut self, now: Timestamp, wants_job: bool) -> Vec<Input> {
        self.answer();
        let mut inputs = Vec::new();
        self.scan(now, &mut inputs);
        if wants_job && self.active.is_none() {
            inputs.extend(self.next_job());
        }
        inputs
    }

    fn journal(&mut self, entry: &JournalEntry) -> Result<(), String> {
        let Some((id, open)) = &mut self.active else { return Ok(()) };
        let now = unix_now_s();
        let written = match (entry, *open) {
            (JournalEntry::Intent { object, from, to, .. }, previous) => {
                // A grip that failed left its step open; it is over once the next one is meant.
                let abandoned = previous.map_or(Ok(()), |step| self.journal.step_abandoned(id, step, now));
                let intent =
                    StepIntent { object: object.clone(), from: *from, to: *to, kind: "move".to_string() };
                abandoned
                    .and_then(|()| self.journal.step_intent(id, &intent, now))
                    .map(|step| *open = Some(step))
            }
            (JournalEntry::Gripped { .. }, Some(step)) => self.journal.step_gripped(id, step, now),
            (JournalEntry::Released { .. }, Some(step)) => self.journal.step_released(id, step, now),
            (JournalEntry::Done { .. }, Some(step)) => {
                self.journal.step_done(id, step, now).map(|()| *open = None)
            }
            (JournalEntry::Planned { .. }, _) | (_, None) => Ok(()),
        };
        written.map_err(|error| error.to_string())
    }

    fn finished(&mut self, report: &JobReport) -> Result<(), String> {
        let finished = self.journal.finish(&report.id, &StateOffice::result(report), unix_now_s());
        self.active = None;
        self.reconcile();
        finished.map_err(|error| error.to_string())
    }

    fn status(&mut self, status: &Status) {
        self.last = status.clone();
        let waiting_approval = status.phase == "waiting for approval";
        let total = status.moves + status.remaining_moves;
        let number = |count: usize| u32::try_from(count).unwrap_or(u32::MAX);
        let file = status::Status {
            daemon: self.daemon.clone(),
            pid: std::process::id(),
            started_unix_s: self.started_unix_s,
            written_unix_s: unix_now_s(),
            state: if status.job.is_some() { "working" } else { "idle" }.to_string(),
            message: status.phase.clone(),
            armed: status.armed,
            paused: status.paused,
            job: status.job.clone(),
            step: status.job.as_ref().map(|_| (number(status.moves), number(total))),
            awaiting_approval: status.job.iter().filter(|_| waiting_approval).cloned().collect(),
            waiting: self.journal.waiting().map_or(0, |count| number(count as usize)),
            ..status::Status::default()
        };
        if let Err(error) = file.write(&self.state.status()) {
            tracing::warn!(%error, "the status file could not be written");
        }
    }
}
/// The planner's objective for a job's.
pub fn objective_of(objective: JobObjective) -> Objective {
    match objective {
        JobObjective::Pp => Objective::Pp,
        JobObjective::Ti => Objective::Ti,
        JobObjective::Time => Objective::Time,
    }
}
