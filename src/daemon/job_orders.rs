//! A job as the journal has it, as the supervisor takes it: what it leaves open is the cell's.
//!
//! In: the configuration, a job, its goals as they are known, what a person agreed to. Out: the order; the
//! keeper's for a job that begins, the page's for a draft. Pure.

use crate::cell::supervisor::order::JobOrder;
use crate::config::cell::CellConfig;
use crate::daemon::plan_files::action_of;
use crate::jobs::record::{GoalPose, JobSpec, PlanStep};
use cell_values::time::Duration;
use rearrange::planning::solver::SolverKind;

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
        approval: config.approval.max(spec.approval.unwrap_or(crate::cell::orders::Approval::Never)),
    })
}
