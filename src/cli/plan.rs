//! `celld plan`: solves an instance and prints, writes and draws the plan.
//!
//! In: an instance file, solver, objective, limits. Out: the plan on standard output (text or JSON), files
//! with `--out` and `--svg`, progress on standard error. Exit code 0 with a plan, 1 without one, 2 for bad
//! input, 130 after Ctrl-C before there was a plan. The clock is read here and nowhere below.

use crate::bench::planning::thread_pool;
use crate::cli::task::TaskArgs;
use crate::report::plan_svg::plan_svg;
use cell_edge::panics::guarded;
use cell_edge::terminal::{complain, print};
use clap::builder::{PossibleValuesParser, TypedValueParser};
use indicatif::{ProgressBar, ProgressStyle};
use rearrange::planning::check::CheckedPlan;
use rearrange::planning::plan::{Action, ActionKind, Objective, PlanFile, Status};
use rearrange::planning::problem::Problem;
use rearrange::planning::solver::{Control, Outcome, SolverKind, solve};
use rearrange::planning::travel::NOMINAL;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// A search shorter than this shows no progress.
const QUIET: Duration = Duration::from_millis(500);

/// The line on the terminal is drawn again after this time: searches look far more often whether they have
/// to stop.
const REDRAW: Duration = Duration::from_millis(50);

/// What `--help` says about the choice of a solver.
const SOLVERS: &str = "\
How the plan is found.

Objects that block each other in a circle cannot all go straight home: some have to wait elsewhere on the \
table. The solvers differ in whom they put aside, and when.

  erbm   As little as possible waits at the same time, and objects that are hard to place (large, long) \
count more. Fast and dependable, also on crowded tables.
  rbm    The same, all objects count alike. Good for objects of one size.
  etbm   As little as possible is put aside in all, hard-to-place objects counting more. The shortest plans \
where there is room.
  tbm    The same, all objects count alike.
  mcts   Tries moves on the real table and follows those that bring objects home. Longer plans at first, \
but it goes on improving until the time limit unless --first is given.
  emcts  The same, hard-to-place objects are tried more often.
  auto   A plan within milliseconds, then better ones until the time limit or until one is proved best. The \
default: take another only to compare.

Under --objective ti the three that begin with e count impedance instead of difficulty; the others search \
as under pp. All are randomised: another --seed gives another plan.";

/// Arguments of `celld plan`.
#[derive(Clone, Debug, clap::Args)]
pub struct PlanArgs {
    /// The task
    #[command(flatten)]
    pub task: TaskArgs,
    /// How the plan is found; `--help` says which to take
    #[arg(long, default_value = "auto", long_help = SOLVERS, value_parser = solver_parser())]
    pub solver: SolverKind,
    /// What is minimised: pp number of moves, ti total impedance, time seconds (here of a nominal arm: 4 s a
    /// move and its ways at 0.25 m/s; the cell uses its own arm)
    #[arg(long, default_value = "pp", value_parser = objective_parser())]
    pub objective: Objective,
    /// Seconds of planning; default 600 for the paper's solvers, 10 for auto
    #[arg(long, value_name = "S", value_parser = seconds)]
    pub time_limit: Option<f64>,
    /// Deterministic steps of planning; with it the same seed gives the same plan on any machine
    #[arg(long, value_name = "N")]
    pub work: Option<u64>,
    /// Stop at the first plan, as in the paper. tbm, rbm, etbm and erbm always do; mcts, emcts and auto go
    /// on for better ones until the time is up or the plan is proved best
    #[arg(long)]
    pub first: bool,
    /// Seed of every random choice
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Threads for auto, default one for each core; the paper's solvers use one
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    pub threads: Option<u16>,
    /// Keep to the paper where celld knows better: rbm and erbm take the first order of moves with the
    /// fewest objects waiting at once, not the one with the fewest put aside in all; tbm, rbm, etbm and erbm
    /// never clear a place for an object that finds none
    #[arg(long)]
    pub strict_paper: bool,
    /// Write the plan (JSON) to this file
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Draw the plan (SVG) into this file
    #[arg(long, value_name = "FILE")]
    pub svg: Option<PathBuf>,
    /// What standard output gets
    #[arg(long, default_value = "text", value_parser = ["text", "json"])]
    pub format: String,
}

/// A solver by its word.
pub fn solver_parser() -> impl TypedValueParser<Value = SolverKind> {
    PossibleValuesParser::new(SolverKind::ALL.map(SolverKind::as_str))
        .try_map(|word| word.parse::<SolverKind>())
}

/// An objective by its word.
pub fn objective_parser() -> impl TypedValueParser<Value = Objective> {
    PossibleValuesParser::new(Objective::ALL.map(Objective::as_str)).try_map(|word| word.parse::<Objective>())
}

/// A finite number that is not negative.
///
/// # Errors
/// What is wrong with the text.
pub fn seconds(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| "not a number of seconds".to_string())?;
    if value.is_finite() && value >= 0.0 {
        Ok(value)
    } else {
        Err("has to be finite and not negative".into())
    }
}

/// Runs `celld plan`; `stop` is set by Ctrl-C. Returns the exit code.
pub fn run(args: &PlanArgs, stop: &AtomicBool) -> u8 {
    let started = Instant::now();
    let problem = match args.task.read() {
        Ok(problem) => problem,
        Err(complaints) => {
            complain(&complaints);
            return 2;
        }
    };
    let searched = guarded(|| search(args, &problem, started, stop));
    let (outcome, timing) = match searched {
        Ok(Ok(done)) => done,
        Ok(Err(error)) => {
            complain(&format!("{}: {error}", args.task.instance.display()));
            return 2;
        }
        Err(panic) => {
            complain(&format!("{}: the planner failed: {panic}", args.task.instance.display()));
            return 1;
        }
    };
    if outcome.status == Status::Timeout && stop.load(Ordering::Relaxed) {
        complain("stopped before a plan was found");
        return 130;
    }
    let file = plan_file(args, &problem, &outcome, &timing);
    if let Err(error) = write_files(args, &problem, &outcome, &file) {
        complain(&error);
        return 2;
    }
    print(&if args.format == "json" { file.to_json() } else { summary(&problem, &outcome, &file) });
    if outcome.plan.is_some() { 0 } else { 1 }
}

/// Seconds to the first plan, and in all.
struct Timing {
    first_plan: Option<f64>,
    all: f64,
}

/// Plans; the limit counts from when the command `started`, the seconds of the plan from here.
fn search(
    args: &PlanArgs,
    problem: &Problem,
    started: Instant,
    stop: &AtomicBool,
) -> Result<(Outcome, Timing), rearrange::planning::solver::SolveError> {
    let limit = args.time_limit.unwrap_or(if args.solver == SolverKind::Auto { 10.0 } else { 600.0 });
    let begun = Instant::now();
    let first_plan = Mutex::new(None);
    let progress = Progress::new(args, begun, limit);
    let stop = || {
        progress.tick();
        stop.load(Ordering::Relaxed) || started.elapsed().as_secs_f64() >= limit
    };
    let on_plan = |_: &[Action], cost: f64| {
        if let Ok(mut first) = first_plan.lock() {
            first.get_or_insert(begun.elapsed().as_secs_f64());
        }
        progress.found(cost);
    };
    let pool = pool(args.threads);
    let seconds = |actions: &[Action]| NOMINAL.seconds(actions);
    let control = Control {
        work_limit: args.work,
        pool: pool.as_ref(),
        seconds: Some(&seconds),
        least_move_seconds: NOMINAL.least_move_seconds(),
        on_plan: &on_plan,
        on_bound: &|bound| progress.proved(bound),
        first: args.first,
        strict_paper: args.strict_paper,
        ..Control::until(&stop)
    };
    let outcome = solve(problem, args.solver, args.objective, &control, args.seed);
    progress.clear();
    let first_plan = first_plan.lock().ok().and_then(|first| *first);
    Ok((outcome?, Timing { first_plan, all: begun.elapsed().as_secs_f64() }))
}

/// Threads for `auto`: so many, or one for each core.
fn pool(threads: Option<u16>) -> Option<rayon::ThreadPool> {
    let cores = || std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    thread_pool(threads.unwrap_or_else(|| u16::try_from(cores()).unwrap_or(u16::MAX)))
}

/// What goes to standard error: a line for each better plan of a search that goes on, and, on a terminal,
/// one that stays and shows the time when a search takes long.
struct Progress {
    begun: Instant,
    limit: f64,
    /// Better plans and bounds are reported.
    reported: bool,
    /// Below which no cost can be, once that is known.
    bound: Mutex<Option<f64>>,
    /// When the line on the terminal is due again, ms.
    due_ms: AtomicU64,
    bar: Mutex<Option<ProgressBar>>,
    best: Mutex<Option<f64>>,
}

impl Progress {
    fn new(args: &PlanArgs, begun: Instant, limit: f64) -> Progress {
        let goes_on = matches!(args.solver, SolverKind::Mcts | SolverKind::Emcts | SolverKind::Auto);
        let (reported, due_ms) = (goes_on && !args.first, AtomicU64::new(QUIET.as_millis() as u64));
        let (bound, bar, best) = (Mutex::new(None), Mutex::new(None), Mutex::new(None));
        Progress { begun, limit, reported, bound, due_ms, bar, best }
    }

    fn found(&self, cost: f64) {
        if let Ok(mut best) = self.best.lock() {
            *best = Some(cost);
        }
        self.display(cost);
    }

    fn proved(&self, bound: f64) {
        if let Ok(mut known) = self.bound.lock() {
            *known = Some(bound);
        }
        let best = self.best.lock().ok().and_then(|best| *best);
        if let Some(cost) = best {
            self.display(cost);
        }
    }

    fn display(&self, cost: f64) {
        let bound = self.bound.lock().ok().and_then(|bound| *bound);
        let Some(bound) = bound.filter(|_| self.reported) else { return };
        let line = format!("{:.3} s: {}", self.begun.elapsed().as_secs_f64(), standing(cost, bound));
        match self.bar.lock().as_deref() {
            Ok(Some(bar)) => bar.suspend(|| complain(&line)),
            _ => complain(&line),
        }
    }

    fn tick(&self) {
        let passed = self.begun.elapsed();
        let (now_ms, due_ms) = (passed.as_millis() as u64, self.due_ms.load(Ordering::Relaxed));
        let next_ms = now_ms + REDRAW.as_millis() as u64;
        let mine = || self.due_ms.compare_exchange(due_ms, next_ms, Ordering::Relaxed, Ordering::Relaxed);
        if now_ms < due_ms || mine().is_err() {
            return;
        }
        let (Ok(mut bar), Ok(best), Ok(bound)) = (self.bar.lock(), self.best.lock(), self.bound.lock())
        else {
            return;
        };
        let bar = bar.get_or_insert_with(|| {
            let template = ProgressStyle::with_template("{spinner} planning {msg}");
            ProgressBar::new_spinner()
                .with_style(template.unwrap_or_else(|_| ProgressStyle::default_spinner()))
        });
        let best = match (*best, *bound) {
            (None, _) => "no plan yet".to_string(),
            (Some(cost), Some(bound)) if self.reported => standing(cost, bound),
            (Some(cost), _) => format!("cost {cost}"),
        };
        bar.set_message(format!("{:.1} s of at most {:.0} s, {best}", passed.as_secs_f64(), self.limit));
        bar.tick();
    }

    fn clear(&self) {
        if let Ok(Some(bar)) = self.bar.lock().as_deref() {
            bar.finish_and_clear();
        }
    }
}

/// Cost, bound, and by how much the one is over the other.
fn standing(cost: f64, bound: f64) -> String {
    let gap = if bound > 0.0 { (100.0 * (cost / bound - 1.0)).max(0.0) } else { 0.0 };
    let number = |value: f64| (value * 1e6).round() / 1e6;
    format!("cost {}, bound {}, gap {gap:.1} %", number(cost), number(bound))
}

fn plan_file(args: &PlanArgs, problem: &Problem, outcome: &Outcome, timing: &Timing) -> PlanFile {
    let actions = outcome.plan.as_ref().map(CheckedPlan::actions);
    PlanFile {
        solver: args.solver.to_string(),
        objective: args.objective,
        seed: args.seed,
        status: outcome.status,
        cost: outcome.cost,
        moves: actions.map(<[Action]>::len),
        lower_bound: outcome.lower_bound,
        first_plan_seconds: timing.first_plan,
        seconds: timing.all,
        witness: outcome.witness.as_ref().map(ToString::to_string),
        actions: PlanFile::entries(problem, actions.unwrap_or_default()),
    }
}

fn write_files(args: &PlanArgs, problem: &Problem, outcome: &Outcome, file: &PlanFile) -> Result<(), String> {
    let write = |path: &Path, text: &str| {
        std::fs::write(path, text).map_err(|error| format!("{}: cannot be written: {error}", path.display()))
    };
    if let Some(path) = &args.out {
        write(path, &file.to_json())?;
    }
    if let Some(path) = &args.svg {
        let actions = outcome.plan.as_ref().map(CheckedPlan::actions).unwrap_or_default();
        write(path, &plan_svg(problem, actions, &headline(file)))?;
    }
    Ok(())
}

fn headline(file: &PlanFile) -> String {
    let bound = file.lower_bound;
    let objective = file.objective;
    match (file.status, file.cost, file.moves) {
        (Status::Infeasible, ..) => format!("{}: there is no plan", file.solver),
        (_, Some(cost), Some(moves)) => {
            let optimal = if file.status == Status::Optimal { ", optimal" } else { "" };
            format!(
                "{}: {moves} moves, {objective} cost {cost:.6}, lower bound {bound:.6}{optimal}",
                file.solver
            )
        }
        _ => format!("{}: no plan found, lower bound {bound:.6} ({objective})", file.solver),
    }
}

/// The plan for people: one line for the result, one a move.
fn summary(problem: &Problem, outcome: &Outcome, file: &PlanFile) -> String {
    let mut text = format!("{} in {:.3} s\n", headline(file), file.seconds);
    if let Some(witness) = &file.witness {
        let _ = writeln!(text, "the goal arrangement is impossible: {witness}");
    }
    let actions = outcome.plan.as_ref().map(CheckedPlan::actions).unwrap_or_default();
    let width = actions.iter().map(|a| problem.objects[a.object].id.chars().count()).max().unwrap_or(0);
    for (number, action) in actions.iter().enumerate() {
        let kind = if action.kind == ActionKind::Goal { "to its goal" } else { "out of the way" };
        let (x, y, degrees) = (action.to.x, action.to.y, action.to.theta.to_degrees());
        let id = &problem.objects[action.object].id;
        let _ = writeln!(
            text,
            "{:4}  {id:width$}  to x {x:.4} m, y {y:.4} m, {degrees:.1} deg  {kind}",
            number + 1
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gap_is_that_of_cost_over_bound() {
        assert_eq!(standing(23.0, 20.0), "cost 23, bound 20, gap 15.0 %");
        assert_eq!(standing(0.1 + 0.2, 0.3), "cost 0.3, bound 0.3, gap 0.0 %");
        assert_eq!(standing(0.0, 0.0), "cost 0, bound 0, gap 0.0 %");
    }
}
