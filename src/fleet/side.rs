//! The cell as its part in the fleet sees it, through what exists: status, journal, spool, orders.
//!
//! In: each status as it is written, the feed of sights and trends, the journal, read as any other process
//! reads it. Out: state and events for the fleet; jobs in `incoming`; orders by the page's channel. Reading
//! a job, and whether the arm reaches its goals, are computed here, on the fleet's own thread.

use crate::config::cell::CellConfig;
use crate::daemon::job_orders::{found_by, job_context};
use crate::fleet::ends::Ends;
use crate::fleet::files::files_of;
use crate::fleet::fragment::{Follower, Next};
use crate::fleet::reported::{decided, events, local, rejected, state_of};
use crate::jobs::goal::read_goal_file;
use crate::jobs::job_file::read_job;
use crate::jobs::journal::Journal;
use crate::jobs::order_queue::OrderedBy;
use crate::jobs::record::{JobRecord, JobSpec};
use crate::jobs::state::StateFolder;
use crate::jobs::status::{Remarks, Status};
use crate::jobs::submit::{Handed, hand_in, prepare, stem};
use crate::page::feed::{Feed, Sight};
use crate::page::orders::OrderSender;
use cell_edge::clock::unix_now_s;
use cell_fleet::files::FileKind;
use cell_fleet::fragments::Wanted;
use cell_fleet::payloads::{CellState, Job, What};
use cell_fleet::side::{CellEvent, CellSide, FilesRequested, FragmentState, Ordered};
use cell_fleet::subjects::RequestKind;
use cell_fleet::values::Local;
use cell_machine::orders::{Order, Reply};
use cell_motion::reach::reaches;
use rearrange::document::chain::chain;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::Receiver;
use tokio::sync::oneshot;

/// A status, and when it was written, s since 1970.
pub type Written = (Status, f64);

/// What the daemon has that the fleet's thread works with.
pub struct Daemon {
    /// The cell.
    pub config: CellConfig,
    /// Jobs and journal.
    pub state: StateFolder,
    /// What happens.
    pub feed: Feed,
    /// Where orders go.
    pub order_sender: OrderSender,
    /// What the status says of the fleet.
    pub remarks: Remarks,
    /// The shared part of the configuration.
    pub fragments: Follower,
    /// Whether celld is to start anew once it is idle and disarmed.
    pub start_anew: Box<dyn Fn(bool) + Send>,
    /// Stops celld.
    pub stop: Arc<AtomicBool>,
}

/// See the module.
pub struct Side {
    daemon: Daemon,
    statuses: Receiver<Written>,
    last: Status,
    /// When the sight that was reported last was made.
    seen_unix_s: f64,
    /// Files that were put into `incoming`, by job.
    handed: BTreeMap<String, Handed>,
    /// Jobs that were decided about from afar: reported already.
    decided_afar: BTreeSet<String>,
    /// Which ends of jobs are reported; `None` until the journal could be read.
    ends: Option<Ends>,
    pending: Vec<CellEvent>,
}

impl Side {
    /// With the statuses that the keeper writes.
    pub fn new(daemon: Daemon, statuses: Receiver<Written>) -> Side {
        let mut side = Side {
            daemon,
            statuses,
            last: Status::default(),
            seen_unix_s: 0.0,
            handed: BTreeMap::new(),
            decided_afar: BTreeSet::new(),
            ends: None,
            pending: Vec::new(),
        };
        side.ended();
        side
    }

    /// Takes in what was written since the last look.
    fn follow(&mut self) {
        let mut news = false;
        while let Ok((status, unix_s)) = self.statuses.try_recv() {
            news = true;
            for (job, what) in events(&self.last, &status) {
                self.pending.push(CellEvent { job, what, unix_s });
            }
            for job in decided(&self.last, &status) {
                self.decided(&job, unix_s);
            }
            self.last = status;
        }
        if news {
            self.ended();
        }
        let Some(Sight { seen, unix_s, .. }) = self.daemon.feed.last_sight() else { return };
        if unix_s > self.seen_unix_s {
            self.seen_unix_s = unix_s;
            let objects = u32::try_from(seen.objects.len()).unwrap_or(u32::MAX);
            let residual_mm = seen.reference_residual_m.map(|residual| residual * 1e3);
            let (job, what) = (self.last.job.clone(), What::Looked { objects, residual_mm });
            self.pending.push(CellEvent { job, what, unix_s });
        }
    }

    /// Reports the jobs that have ended since the last look into the journal. One that cannot be read now is
    /// read with the next status.
    fn ended(&mut self) {
        match self.newly_ended() {
            Ok(ended) => self.pending.extend(ended.iter().filter_map(end_of)),
            Err(error) => tracing::debug!(error, "the ends of jobs are reported to the fleet later"),
        }
    }

    fn newly_ended(&mut self) -> Result<Vec<JobRecord>, String> {
        let Some(journal) = self.journal()? else {
            // Without a journal nothing has ended yet.
            self.ends.get_or_insert_default();
            return Ok(Vec::new());
        };
        let active = self.last.job.as_deref();
        let ended = match &mut self.ends {
            Some(ends) => ends.next(&journal, active),
            none => Ends::from_now(&journal).map(|ends| {
                *none = Some(ends);
                Vec::new()
            }),
        };
        ended.map_err(|error| chain(&error))
    }

    /// A person at the cell has decided about a plan.
    fn decided(&mut self, job: &str, unix_s: f64) {
        if self.decided_afar.remove(job) {
            return;
        }
        let record = self.journal().ok().flatten().and_then(|journal| journal.job(job).ok().flatten());
        let Some(record) = record else { return };
        let what =
            What::Approved { by: "a person at the cell".to_string(), agreed: record.approved.is_some() };
        self.pending.push(CellEvent { job: Some(job.to_string()), what, unix_s });
    }

    fn journal(&self) -> Result<Option<Journal>, String> {
        let path = self.daemon.state.journal();
        if !path.exists() {
            return Ok(None);
        }
        Journal::open_to_read(&path).map(Some).map_err(|error| chain(&error))
    }

    fn read(&self, job: &Job) -> Result<JobSpec, String> {
        let obstacles = self.daemon.config.obstacles();
        let read_goal = |name: &str| read_goal_file(&self.daemon.config.goal_folder, name);
        let journal = self.daemon.state.journal();
        let found = |id: &str| found_by(&journal, id);
        let context = job_context(&self.daemon.config, &obstacles, &read_goal, &found);
        read_job(&job.text, &job.id, &context).map_err(|complaints| complaints.to_string())
    }

    /// The first goal that the arm does not reach with the object's grip.
    fn out_of_reach(&self, spec: &JobSpec) -> Option<String> {
        let cell = self.daemon.feed.cell()?;
        let model = &cell.model;
        spec.goal.iter().find_map(|goal| {
            let object = model.object(&goal.id)?;
            let task = object.pick_n_place(goal.pose, goal.pose);
            let fault = reaches(&model.arm, &task, &goal.pose, &model.cycle).err()?;
            Some(format!("{} cannot be put at its goal: {fault}", goal.id))
        })
    }
}

/// The event of a job that has ended.
fn end_of(job: &JobRecord) -> Option<CellEvent> {
    let Local::Ended(outcome) = local(job) else { return None };
    let unix_s = job.ended_unix_s.unwrap_or_else(unix_now_s);
    Some(CellEvent { job: Some(job.id.clone()), what: What::Done { outcome }, unix_s })
}

/// The file that a job of the fleet has in `incoming`, if it is still there: from before a restart.
fn waiting_file(state: &StateFolder, job: &Job) -> Option<String> {
    let end = format!("-{}-{}.yaml", stem(&job.id), job.sha256.get(..8).unwrap_or_default());
    let names = std::fs::read_dir(state.incoming()).ok()?.flatten();
    names.filter_map(|entry| entry.file_name().into_string().ok()).find(|name| name.ends_with(&end))
}

/// The order that a request is; one for files is none.
fn order_of(requested: RequestKind, job: &str, plan: Option<u64>) -> Option<Order> {
    match requested {
        RequestKind::Approve => plan.map(|plan| Order::Approve { id: job.to_string(), plan }),
        RequestKind::Reject => Some(Order::Reject(job.to_string())),
        RequestKind::Cancel => Some(Order::Cancel(job.to_string())),
        RequestKind::Send => None,
    }
}

impl CellSide for Side {
    fn state(&mut self) -> CellState {
        self.follow();
        let mut state = state_of(self.daemon.feed.last_status().as_deref());
        let trends = self.daemon.feed.trends();
        state.vacuum_percent = trends.vacuum_percent.back().map(|(_, percent)| *percent);
        state.drift_mm = trends.reference_residual_mm.back().map(|(_, mm)| (mm * 1e3).round() / 1e3);
        // What is not of now allows nothing.
        state.idle &= self.daemon.feed.is_of_now();
        state
    }

    fn events(&mut self) -> Vec<CellEvent> {
        self.follow();
        std::mem::take(&mut self.pending)
    }

    fn judge(&mut self, job: &Job) -> Result<(), String> {
        let spec = self.read(job)?;
        if spec.id.as_deref() != Some(job.id.as_str()) || spec.rerun {
            return Err(format!("the job's text has to state id: {}, and no rerun", job.id));
        }
        let known = self.journal()?.map(|journal| journal.job(&job.id)).transpose();
        if known.map_err(|error| chain(&error))?.flatten().is_some() {
            return Err(format!("the journal of this cell knows a job {} already", job.id));
        }
        self.out_of_reach(&spec).map_or(Ok(()), Err)
    }

    fn hand_in(&mut self, job: &Job) -> Result<(), String> {
        if let Some(name) = waiting_file(&self.daemon.state, job) {
            self.handed.insert(job.id.clone(), Handed { id: job.id.clone(), name });
            return Ok(());
        }
        let no_file = |name: &str| Err(format!("a job of the fleet names no file, and this one {name}"));
        let (spec, text) = prepare(&job.text, &job.id, &no_file)?;
        let name = Path::new(&stem(&job.id)).with_extension("yaml");
        let handed =
            hand_in(&self.daemon.state, &name, &spec, &text, unix_now_s()).map_err(|error| chain(&error))?;
        tracing::info!(job = job.id, file = handed.name, "a job of the fleet goes into the spool");
        self.handed.insert(job.id.clone(), handed);
        Ok(())
    }

    fn look(&mut self, job: &str) -> Result<Local, String> {
        let Some(journal) = self.journal()? else { return Ok(Local::Unknown) };
        if let Some(record) = journal.job(job).map_err(|error| chain(&error))? {
            self.handed.remove(job);
            return Ok(local(&record));
        }
        let Some(handed) = self.handed.get(job) else { return Ok(Local::Unknown) };
        let refused = journal.rejection_of_name(&handed.name).map_err(|error| chain(&error))?;
        if let Some(refusal) = refused {
            return Ok(rejected(&refusal.reason));
        }
        let waits = self.daemon.state.incoming().join(&handed.name).exists();
        Ok(if waits { Local::Open } else { Local::Unknown })
    }

    fn order(&mut self, requested: RequestKind, job: &str, plan: Option<u64>, by: &str) -> Ordered {
        let (answer, answered) = oneshot::channel();
        // No page may give it, whatever comes: what sets the arm in motion needs eyes on the cell.
        let Some(order) = order_of(requested, job, plan).filter(|order| !order.needs_sight()) else {
            return answered;
        };
        let (order_sender, by) = (self.daemon.order_sender.clone(), format!("{by}, over the fleet"));
        if requested != RequestKind::Cancel {
            self.decided_afar.insert(job.to_string());
        }
        tokio::spawn(async move {
            let by = OrderedBy { session: by.clone(), name: by };
            let Reply { accepted, message, .. } = order_sender.order(order, by).await;
            // Who requested it may have gone.
            let _ = answer.send((accepted, message));
        });
        answered
    }

    fn files(&mut self, job: &str, kinds: &[FileKind]) -> FilesRequested {
        let (answer, answered) = oneshot::channel();
        let (config, state) = (self.daemon.config.clone(), self.daemon.state.clone());
        let (job, kinds) = (job.to_string(), kinds.to_vec());
        tokio::task::spawn_blocking(move || {
            // Who requested it may have gone.
            let _ = answer.send(files_of(&config, &state, &job, &kinds));
        });
        answered
    }

    fn fragment(&mut self, wanted: Option<Wanted<'_>>) -> FragmentState {
        let state = FragmentState { runs: self.daemon.fragments.runs(), ..FragmentState::default() };
        let next = self.daemon.fragments.next(wanted);
        (self.daemon.start_anew)(matches!(next, Next::Start(_)));
        match next {
            Next::Stay => state,
            Next::Start(number) => FragmentState { waits: Some(number), ..state },
            Next::Fault(fault) => FragmentState { fault: Some(fault), ..state },
        }
    }

    fn complaints(&mut self, complaints: &[String]) {
        for complaint in complaints {
            tracing::warn!("fleet: {complaint}");
        }
        if complaints.is_empty() {
            tracing::info!("fleet: connected, nothing is wrong");
        }
        if let Ok(mut remarks) = self.daemon.remarks.lock() {
            *remarks = complaints.to_vec();
        }
    }
}
