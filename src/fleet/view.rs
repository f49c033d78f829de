//! A fleet as people look at it: each cell with its trends and counts, the jobs, what happened.
//!
//! In: changes of the fleet, jobs that wait, the time by the server's clock. Out: [`FleetView`], whole and
//! bounded whatever the fleet did. Events that come twice count once: they have numbers. Pure.

use crate::fleet::words::words;
use cell_fleet::changes::Change;
use cell_fleet::client::Shown;
use cell_fleet::payloads::{CellState, Claim, ClaimState, Event, Outcome, What, sentence};
use serde::Serialize;
use std::collections::{BTreeMap, VecDeque};

/// A state older than this is not of now, s.
pub const OLD_S: f64 = 15.0;

/// Counts and trends are those of the last so many seconds: a shift.
pub const WINDOW_S: f64 = 8.0 * 3600.0;

/// Points of a trend.
const TREND: usize = 240;

/// Ended jobs and faults of one cell that are counted.
const ENDED: usize = 4000;
const FAULTS: usize = 20;

/// Claims that are remembered, and shown.
const CLAIMS: usize = 20_000;
const CLAIMS_SHOWN: usize = 100;

/// Cells whose past is remembered.
const CELLS: usize = 1000;

/// Lines of what happened.
const HAPPENED: usize = 200;

/// A time, s since 1970, and a value.
pub type Point = (f64, f64);

/// A fleet at one moment.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FleetView {
    /// Its name.
    pub fleet: String,
    /// The moment, by the server's clock.
    pub unix_s: f64,
    /// The server answers; otherwise all of this is old.
    pub connected: bool,
    /// Length of the time that counts cover, s.
    pub window_s: f64,
    /// Jobs that no cell has taken, by lane.
    pub queued: BTreeMap<String, usize>,
    /// By name.
    pub cells: Vec<CellView>,
    /// The newest first.
    pub jobs: Vec<JobView>,
    /// The newest first.
    pub happened: Vec<Line>,
}

/// One cell.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CellView {
    /// Its name.
    pub name: String,
    /// How old its state is, s.
    pub age_s: f64,
    /// Older than [`OLD_S`].
    pub away: bool,
    /// What it showed last.
    pub state: CellState,
    /// What it did in the window.
    pub counts: Counts,
    /// Residual of the reference markers, mm.
    pub drift_mm: Vec<Point>,
    /// Vacuum while something was held, %.
    pub vacuum_percent: Vec<Point>,
    /// Time of one pick-n-place of each job, s.
    pub cycle_s: Vec<Point>,
    /// What went wrong, the newest first.
    pub faults: Vec<Line>,
}

/// What was done in the window.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Counts {
    /// Jobs that ended as done.
    pub done: u64,
    /// All others that ended.
    pub failed: u64,
    /// Pick-n-places.
    pub moves: u64,
    /// The least that they could have been.
    pub bound: f64,
    /// Working time, s.
    pub seconds: f64,
    /// Pick-n-places an hour, from the first that counts to now.
    pub moves_per_hour: f64,
}

/// One job.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct JobView {
    /// Its id.
    pub id: String,
    /// The campaign it belongs to.
    pub campaign: Option<String>,
    /// When it was submitted.
    pub submitted_unix_s: f64,
    /// Who submitted it.
    pub by: String,
    /// For whom.
    pub target: String,
    /// What has become of it.
    pub state: String,
    /// Who has it, or had it last.
    pub cell: String,
    /// Its cell is away.
    pub stranded: bool,
    /// How it ended.
    pub outcome: Option<Outcome>,
    /// When that was stored; none while it is not over.
    pub ended_unix_s: Option<f64>,
    /// Why cells refused it, or who decided.
    pub reasons: BTreeMap<String, String>,
}

/// Something that happened.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Line {
    /// When, by the cell's clock.
    pub unix_s: f64,
    /// Where.
    pub cell: String,
    /// About which job.
    pub job: Option<String>,
    /// `looked`, `done`, ...
    pub kind: String,
    /// A person should know: a fault, a gap, a job that did not end well.
    pub alarm: bool,
    /// In words.
    pub text: String,
}

/// What is remembered of one cell.
#[derive(Default)]
struct History {
    /// Series and number of the last event that was counted.
    last: (String, u64),
    drift_mm: VecDeque<Point>,
    vacuum_percent: VecDeque<Point>,
    ended: VecDeque<(f64, Outcome)>,
    faults: VecDeque<Line>,
}

/// See the module.
#[derive(Default)]
pub struct Board {
    cells: BTreeMap<String, Shown>,
    histories: BTreeMap<String, History>,
    claims: BTreeMap<String, Claim>,
    happened: VecDeque<Line>,
    queued: BTreeMap<String, usize>,
}

fn keep<T>(values: &mut VecDeque<T>, value: T, most: usize) {
    values.push_back(value);
    if values.len() > most {
        values.pop_front();
    }
}

impl Board {
    /// Takes a change in. What has ended is for who reads the changes.
    pub fn take(&mut self, change: Change) {
        match change {
            Change::Cell(shown) => self.cell(*shown),
            Change::CellGone(name) => {
                self.cells.remove(&name);
                self.histories.remove(&name);
            }
            Change::Claim(claim) => {
                self.claims.insert(claim.job.id.clone(), *claim);
                self.forget_old_claims();
            }
            Change::ClaimGone(job) => {
                self.claims.remove(&job);
            }
            Change::Event(event) => self.event(&event),
            Change::Ended(_) => {}
        }
    }

    /// The jobs that wait, by lane.
    pub fn queue(&mut self, queued: BTreeMap<String, usize>) {
        self.queued = queued;
    }

    fn cell(&mut self, shown: Shown) {
        let history = self.histories.entry(shown.name.clone()).or_default();
        if let Some(percent) = shown.state.vacuum_percent
            && history.vacuum_percent.back().is_none_or(|(_, last)| (last - percent).abs() > 1e-9)
        {
            keep(&mut history.vacuum_percent, (shown.unix_s, percent), TREND);
        }
        self.cells.insert(shown.name.clone(), shown);
    }

    fn forget_old_claims(&mut self) {
        if self.claims.len() <= CLAIMS {
            return;
        }
        let mut by_time: Vec<(f64, String)> =
            self.claims.values().map(|claim| (claim.job.submitted_unix_s, claim.job.id.clone())).collect();
        by_time.sort_by(|a, b| a.0.total_cmp(&b.0).then_with(|| a.1.cmp(&b.1)));
        // A tenth at a time: sorting them at every claim would be the work of a large fleet's page.
        for (_, id) in by_time.into_iter().take(CLAIMS / 10) {
            self.claims.remove(&id);
        }
    }

    fn event(&mut self, event: &Event) {
        if self.histories.len() >= CELLS && !self.histories.contains_key(&event.cell) {
            return;
        }
        let history = self.histories.entry(event.cell.clone()).or_default();
        if history.last.0 == event.series && event.number <= history.last.1 {
            return;
        }
        history.last = (event.series.clone(), event.number);
        let line = line(event);
        match &event.what {
            What::Looked { residual_mm: Some(mm), .. } => {
                keep(&mut history.drift_mm, (event.unix_s, *mm), TREND);
            }
            What::Done { outcome } => keep(&mut history.ended, (event.unix_s, outcome.clone()), ENDED),
            What::Looked { .. }
            | What::Planned { .. }
            | What::Approved { .. }
            | What::Step { .. }
            | What::Fault { .. }
            | What::Gap { .. } => {}
        }
        if line.alarm {
            keep(&mut history.faults, line.clone(), FAULTS);
        }
        keep(&mut self.happened, line, HAPPENED);
    }

    /// The fleet now, by the server's clock.
    pub fn view(&self, fleet: &str, now: f64, connected: bool) -> FleetView {
        FleetView {
            fleet: fleet.to_string(),
            unix_s: now,
            connected,
            window_s: WINDOW_S,
            queued: self.queued.clone(),
            cells: self.cells.values().map(|cell| self.cell_view(cell, now)).collect(),
            jobs: self.job_views(now),
            happened: self.happened.iter().rev().cloned().collect(),
        }
    }

    fn cell_view(&self, shown: &Shown, now: f64) -> CellView {
        let nothing = History::default();
        let history = self.histories.get(&shown.name).unwrap_or(&nothing);
        let within = |unix_s: f64| now - unix_s <= WINDOW_S;
        let ended: Vec<&(f64, Outcome)> =
            history.ended.iter().filter(|(unix_s, _)| within(*unix_s)).collect();
        let per_move = |(unix_s, outcome): &&(f64, Outcome)| {
            (outcome.moves > 0).then(|| (*unix_s, outcome.seconds / f64::from(outcome.moves)))
        };
        let cycle_s: Vec<Point> = ended.iter().filter_map(per_move).collect();
        CellView {
            name: shown.name.clone(),
            age_s: age_s(shown, now),
            away: age_s(shown, now) > OLD_S,
            state: shown.state.clone(),
            counts: counts(&ended, now),
            drift_mm: history.drift_mm.iter().copied().collect(),
            vacuum_percent: history.vacuum_percent.iter().copied().collect(),
            cycle_s: cycle_s.iter().rev().take(TREND).rev().copied().collect(),
            faults: history.faults.iter().rev().cloned().collect(),
        }
    }

    fn job_views(&self, now: f64) -> Vec<JobView> {
        let mut claims: Vec<&Claim> = self.claims.values().collect();
        claims.sort_by(|a, b| b.job.submitted_unix_s.total_cmp(&a.job.submitted_unix_s));
        claims.iter().take(CLAIMS_SHOWN).map(|claim| self.job_view(claim, now)).collect()
    }

    fn job_view(&self, claim: &Claim, now: f64) -> JobView {
        let away = self.cells.get(&claim.cell).is_none_or(|shown| age_s(shown, now) > OLD_S);
        JobView {
            id: claim.job.id.clone(),
            campaign: claim.job.campaign.clone(),
            submitted_unix_s: claim.job.submitted_unix_s,
            by: claim.by.clone(),
            target: claim.target.clone(),
            state: claim.state.as_str().to_string(),
            cell: claim.cell.clone(),
            stranded: claim.is_held_by(&claim.cell, claim.job.epoch) && away,
            outcome: claim.outcome.clone(),
            ended_unix_s: (claim.state == ClaimState::Ended).then_some(claim.unix_s),
            reasons: claim.reasons.clone(),
        }
    }
}

/// How old the state of a cell is, s.
pub fn age_s(shown: &Shown, now: f64) -> f64 {
    (now - shown.unix_s).max(0.0)
}

fn counts(ended: &[&(f64, Outcome)], now: f64) -> Counts {
    let mut counts = Counts::default();
    for (_, outcome) in ended {
        match outcome.status.as_str() {
            "done" => counts.done += 1,
            _ => counts.failed += 1,
        }
        counts.moves += u64::from(outcome.moves);
        counts.bound += outcome.lower_bound.unwrap_or_default();
        counts.seconds += outcome.seconds;
    }
    // From when the first of them began.
    let begun = ended.first().map_or(now, |(unix_s, outcome)| unix_s - outcome.seconds);
    let hours = (now - begun).clamp(60.0, WINDOW_S) / 3600.0;
    counts.moves_per_hour = counts.moves as f64 / hours;
    counts
}

fn line(event: &Event) -> Line {
    let alarm = match &event.what {
        What::Fault { .. } | What::Gap { .. } => true,
        What::Done { outcome } => outcome.status != "done",
        What::Looked { .. } | What::Planned { .. } | What::Approved { .. } | What::Step { .. } => false,
    };
    Line {
        unix_s: event.unix_s,
        cell: event.cell.clone(),
        job: event.job.clone(),
        kind: event.what.kind().to_string(),
        alarm,
        text: sentence(&words(event)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cell_fleet::payloads::{Job, VERSION};
    use cell_fleet::subjects::{Lane, Priority, Target};

    fn cell(name: &str, unix_s: f64, vacuum: Option<f64>) -> Change {
        let state = CellState { state: "idle".into(), vacuum_percent: vacuum, ..CellState::default() };
        Change::Cell(Box::new(Shown { name: name.into(), state, unix_s }))
    }

    fn event(number: u64, unix_s: f64, what: What) -> Change {
        let (cell, series, job) = ("c1".to_string(), "s".to_string(), Some("a".to_string()));
        Change::Event(Box::new(Event { version: VERSION, cell, series, number, unix_s, job, what }))
    }

    fn done(status: &str, moves: u32, seconds: f64) -> What {
        let outcome = Outcome {
            status: status.into(),
            moves,
            lower_bound: Some(f64::from(moves)),
            seconds,
            ..Outcome::default()
        };
        What::Done { outcome }
    }

    fn claim(id: &str, state: ClaimState, unix_s: f64) -> Change {
        let lane = Lane { priority: Priority::Normal, target: Target::any() };
        Change::Claim(Box::new(Claim::new(Job::new(id, "x", unix_s), &lane, "anna", state, "c1", unix_s)))
    }

    #[test]
    fn counts_are_of_the_window_and_events_count_once() {
        let mut board = Board::default();
        let now = 100_000.0;
        board.take(cell("c1", now - 1.0, None));
        board.take(event(1, now - WINDOW_S - 10.0, done("done", 50, 500.0)));
        board.take(event(2, now - 3000.0, done("done", 4, 600.0)));
        for _ in 0..2 {
            board.take(event(3, now - 100.0, done("failed", 2, 20.0)));
        }
        let view = board.view("plant", now, true);
        let counts = view.cells[0].counts;
        assert_eq!((counts.done, counts.failed, counts.moves, counts.bound), (1, 1, 6, 6.0));
        assert!((counts.moves_per_hour - 6.0).abs() < 1e-9, "an hour since the first began: {counts:?}");
        assert_eq!(view.cells[0].cycle_s, [(now - 3000.0, 150.0), (now - 100.0, 10.0)]);
        assert_eq!(view.cells[0].faults.len(), 1, "a job that failed is something to know");
        assert_eq!(view.happened[0].text, "failed after 2 moves and 20 s: ");
    }

    #[test]
    fn a_cell_that_is_away_strands_its_job() {
        let mut board = Board::default();
        board.take(cell("c1", 100.0, None));
        board.take(claim("held", ClaimState::Begun, 90.0));
        board.take(claim("over", ClaimState::Ended, 80.0));
        let of = |now: f64| {
            let view = board.view("plant", now, true);
            (view.cells[0].away, view.jobs.iter().map(|job| job.stranded).collect::<Vec<_>>())
        };
        assert_eq!(of(101.0), (false, vec![false, false]));
        assert_eq!(of(100.0 + OLD_S + 1.0), (true, vec![true, false]));
    }

    #[test]
    fn trends_and_lists_are_bounded() {
        let mut board = Board::default();
        for step in 0..3000_u32 {
            let unix_s = f64::from(step);
            board.take(cell("c1", unix_s, Some(unix_s)));
            board.take(event(
                u64::from(step) + 1,
                unix_s,
                What::Looked { objects: 4, residual_mm: Some(0.5) },
            ));
            board.take(claim(&format!("job-{step}"), ClaimState::Ended, unix_s));
        }
        let view = board.view("plant", 3000.0, true);
        let cell = &view.cells[0];
        assert_eq!((cell.drift_mm.len(), cell.vacuum_percent.len()), (TREND, TREND));
        assert_eq!((view.jobs.len(), view.happened.len()), (CLAIMS_SHOWN, HAPPENED));
        assert_eq!(view.jobs[0].id, "job-2999");
        board.take(Change::CellGone("c1".into()));
        assert!(board.view("plant", 3000.0, true).cells.is_empty());
    }
}
