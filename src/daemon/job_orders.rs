//! From a job file to an order of the supervisor: what it is read against, and what it leaves open.
//!
//! In: the configuration, the journal of other jobs, a job, its goals as they are known, what a person
//! agreed to. Out: the context of its checks, and the order; the keeper's for a job that begins, the page's
//! for a draft.

use crate::config::cell::CellConfig;
use crate::daemon::plan_files::action_of;
use crate::jobs::goal::{FoundBy, JobContext, ReadGoal};
use crate::jobs::journal::Journal;
use crate::jobs::record::{GoalPose, JobSpec, PlanStep};
use cell_machine::supervisor::order::JobOrder;
use cell_values::time::Duration;
use rearrange::document::chain::chain;
use rearrange::planning::solver::SolverKind;
use rearrange::tabletop::instance::KeepOut;
use std::path::Path;

/// Where the objects lay when the job `id` first looked.
///
/// # Errors
/// Why that is not known.
pub fn found_by(journal: &Path, id: &str) -> Result<Vec<GoalPose>, String> {
    let job = Journal::open_to_read(journal).and_then(|journal| journal.job(id)).map_err(|e| chain(&e))?;
    let job = job.ok_or_else(|| format!("no job {id:?} is known"))?;
    if job.found.is_empty() {
        return Err(format!("what job {id:?} found on the table is not known: it has not looked"));
    }
    Ok(job.found)
}

/// What a job of this cell is checked against; `obstacles` are [`CellConfig::obstacles`].
pub fn job_context<'a>(
    config: &'a CellConfig,
    obstacles: &'a [KeepOut],
    read_goal: &'a ReadGoal<'a>,
    found: &'a FoundBy<'a>,
) -> JobContext<'a> {
    let goal = Some(config.goal_context(obstacles));
    JobContext { goal, approval: config.approval, read_goal, found: Some(found) }
}

/// The order of a job.
///
/// # Errors
/// It names a solver that this celld does not have: nothing else is put in its place.
pub fn job_order(
    config: &CellConfig,
    id: &str,
    spec: &JobSpec,
    goals: &[GoalPose],
    agreed: &[PlanStep],
) -> Result<JobOrder, String> {
    let planner = &config.planner;
    let solver = match &spec.solver {
        Some(word) => word.parse::<SolverKind>().map_err(|_| format!("this celld has no solver {word:?}"))?,
        None => planner.solver,
    };
    let seconds = spec.time_limit_s.unwrap_or(planner.time_limit_s);
    Ok(JobOrder {
        id: id.to_string(),
        goals: goals.iter().map(|goal| (goal.id.clone(), goal.pose)).collect(),
        rule: spec.rule.clone(),
        agreed: agreed.iter().map(action_of).collect(),
        objective: spec.objective.unwrap_or(planner.objective),
        solver,
        time_limit: Duration::from_secs_f64(seconds.clamp(0.001, 86_400.0)),
        seed: spec.seed.unwrap_or(planner.seed),
        // The cell's policy is a floor, also for a job that was taken in under a laxer one.
        approval: config.approval.max(spec.approval.unwrap_or(cell_machine::orders::Approval::Never)),
    })
}
