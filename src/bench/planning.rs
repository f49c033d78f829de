//! Planning benchmark, one case: runs a solver on a problem and measures it.
//!
//! In: a problem with its key, limits. Out: a [`Row`]. Every plan counted has passed the independent checker
//! inside `solve`. The clock is read here: seconds are wall time of this process, and cases that run beside
//! each other on one machine slow each other down.

use crate::bench::table::{Key, Row};
use rearrange::geometry::footprint::Footprint;
use rearrange::geometry::pose::Pose2;
use rearrange::planning::check::CheckedPlan;
use rearrange::planning::plan::{Action, Objective, Status};
use rearrange::planning::problem::Problem;
use rearrange::planning::solver::{Control, SolveError, SolverKind, solve};
use rearrange::tabletop::instance::{Instance, ObjectSpec, Workspace};
use std::sync::Mutex;
use std::time::Instant;

/// Stack of a thread that searches: a search of a thousand objects goes as many calls deep.
const STACK_BYTES: usize = 16 << 20;

/// When a case ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Seconds for one case.
    pub seconds: f64,
    /// Deterministic steps for one case.
    pub work: Option<u64>,
    /// At the first plan, as the paper's figures do.
    pub first: bool,
    /// As [`Control::strict_paper`].
    pub strict_paper: bool,
    /// Threads of one case, for `auto`; results do not depend on it unless the clock ends the search.
    pub solver_threads: u16,
}

/// Runs one case.
///
/// None when `stop` cut it short: what it would have reached is not known.
///
/// # Errors
/// What makes the run impossible.
pub fn run_case(
    problem: &Problem,
    key: Key,
    limits: Limits,
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<Option<Row>, SolveError> {
    let begun = Instant::now();
    let first_plan = Mutex::new(None);
    let over = || stop() || begun.elapsed().as_secs_f64() >= limits.seconds;
    let on_plan = |_: &[Action], _: f64| {
        if let Ok(mut first) = first_plan.lock() {
            first.get_or_insert(begun.elapsed().as_secs_f64());
        }
    };
    let pool = thread_pool(limits.solver_threads);
    let control = Control {
        work_limit: limits.work,
        pool: pool.as_ref(),
        on_plan: &on_plan,
        first: limits.first,
        strict_paper: limits.strict_paper,
        ..Control::until(&over)
    };
    let outcome = solve(problem, key.solver, key.objective, &control, key.seed)?;
    let seconds = begun.elapsed().as_secs_f64();
    let ended_by_itself = match outcome.status {
        Status::Optimal | Status::Infeasible => true,
        Status::Solved => limits.first,
        Status::Timeout => false,
    };
    if stop() && !ended_by_itself && seconds < limits.seconds {
        return Ok(None);
    }
    Ok(Some(Row {
        key,
        status: outcome.status,
        moves: outcome.plan.as_ref().map(CheckedPlan::actions).map(<[Action]>::len),
        cost: outcome.cost,
        lower_bound: outcome.lower_bound,
        first_plan_seconds: first_plan.lock().ok().and_then(|first| *first),
        seconds,
    }))
}

/// Threads for `auto`; None for one, or where no more can be had: the caller's own has to do then.
pub fn thread_pool(threads: u16) -> Option<rayon::ThreadPool> {
    let pool = rayon::ThreadPoolBuilder::new().stack_size(STACK_BYTES);
    let build = |count| pool.num_threads(count).build().ok();
    (threads > 1).then(|| build(usize::from(threads))).flatten()
}

/// Has a solver swap two discs: shows what it cannot do before hours are spent on what it can.
///
/// # Errors
/// A solver that is not built, an objective that it does not have here.
pub fn probe(solver: SolverKind, objective: Objective) -> Result<(), SolveError> {
    let Some(problem) = two_discs() else { return Ok(()) };
    let control = Control { work_limit: Some(1000), first: true, ..Control::until(&|| false) };
    solve(&problem, solver, objective, &control, 0).map(|_| ())
}

/// Two discs that change places, so that one of them has to wait in a buffer.
fn two_discs() -> Option<Problem> {
    let (left, right) = (Pose2::new(0.2, 0.5, 0.0), Pose2::new(0.8, 0.5, 0.0));
    let mut objects = Vec::new();
    for (id, start, goal) in [("a", left, right), ("b", right, left)] {
        let mut disc = ObjectSpec::new(id, Footprint::disc(0.1).ok()?);
        disc.start = Some(start);
        disc.goal = Some(goal);
        objects.push(disc);
    }
    let instance = Instance {
        workspace: Workspace { width: 1.0, height: 1.0 },
        clearance: 0.0,
        overlap_tolerance: 0.0,
        keep_out: Vec::new(),
        objects,
    };
    Problem::new(&instance).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(solver: SolverKind) -> Key {
        Key {
            scenario: "discs".into(),
            density: "0.06".into(),
            objects: 2,
            id: "0".into(),
            solver,
            objective: Objective::Pp,
            seed: 0,
        }
    }

    #[test]
    fn a_case_is_measured_and_one_cut_short_is_not() {
        let limits =
            Limits { seconds: 60.0, work: None, first: true, strict_paper: false, solver_threads: 1 };
        let problem = two_discs().unwrap();
        let row = run_case(&problem, key(SolverKind::Erbm), limits, &|| false).unwrap().unwrap();
        assert_eq!((row.status, row.moves, row.cost), (Status::Optimal, Some(3), Some(3.0)));
        assert!(row.first_plan_seconds.unwrap() <= row.seconds);
        assert_eq!(run_case(&problem, key(SolverKind::Erbm), limits, &|| true), Ok(None));
    }

    #[test]
    fn a_case_that_its_own_limit_ends_is_a_timeout() {
        let limits = Limits { seconds: 0.0, work: None, first: true, strict_paper: false, solver_threads: 1 };
        let row = run_case(&two_discs().unwrap(), key(SolverKind::Erbm), limits, &|| false).unwrap().unwrap();
        assert_eq!((row.status, row.moves, row.first_plan_seconds), (Status::Timeout, None, None));
    }

    #[test]
    fn the_probe_reports_what_cannot_be_run() {
        assert_eq!(probe(SolverKind::Erbm, Objective::Ti), Ok(()));
        assert_eq!(probe(SolverKind::Erbm, Objective::Time), Err(SolveError::NoTimes));
    }
}
