//! `celld approve`: a person approves exactly the plan that was shown.
//!
//! In: a job and the number of its plan. Out: the daemon's answer. Without a number the plan that waits is
//! shown and a yes is needed; off a terminal the command is refused: typed again from a shell's history it
//! would approve whatever waits then.

use crate::cli::client::{ClientError, StateArg, exit_2, running_daemon, send};
use crate::cli::interrupt::watch_every;
use crate::cli::task::outln;
use crate::jobs::command::Command;
use crate::jobs::record::PlanRecord;
use crate::jobs::status::Status;
use clap::Args;
use std::io::{IsTerminal, Write};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Arguments of `celld approve`.
#[derive(Args, Debug)]
pub struct ApproveArgs {
    /// The job.
    id: String,
    /// Number of the plan that was shown to you, as in `celld status`. Another plan is not approved.
    #[arg(long, value_name = "N")]
    plan: Option<u64>,
    #[command(flatten)]
    state: StateArg,
}

/// Approves a plan; the exit code.
pub(super) fn approve(args: &ApproveArgs, stop: &Arc<AtomicBool>) -> Result<u8, ClientError> {
    let state = args.state.folder();
    let plan = match args.plan {
        Some(plan) => plan,
        None => {
            let status = running_daemon(&state)?;
            let waits = waiting(&status, &args.id).map_err(ClientError::Refused)?;
            if !(std::io::stdin().is_terminal() && std::io::stderr().is_terminal()) {
                let (id, number) = (&args.id, waits.number);
                return Ok(exit_2(&format!(
                    "nothing was approved: name the plan that you saw; the one that waits now is `celld approve \
                     {id} --plan {number}`"
                )));
            }
            if !confirmed(waits) {
                outln!("nothing was approved");
                return Ok(1);
            }
            waits.number
        }
    };
    watch_every(stop);
    send(&state, &Command::Approve { id: args.id.clone(), plan }, stop)
}

/// The plan of this job that waits for a person.
fn waiting<'a>(status: &'a Status, id: &str) -> Result<&'a PlanRecord, String> {
    let waits = status.awaiting_approval.iter().any(|waits| waits == id);
    status
        .plan
        .as_ref()
        .filter(|_| waits)
        .ok_or_else(|| format!("no plan of job {id} waits for approval; see `celld status`"))
}

/// Shows the plan and waits for a yes; anything else is a no.
fn confirmed(plan: &PlanRecord) -> bool {
    eprintln!("plan {}: {}", plan.number, plan.summary());
    plan.moves().iter().for_each(|line| eprintln!("  {line}"));
    eprint!("approve plan {}? [y/N] ", plan.number);
    let _ = std::io::stderr().flush();
    let mut answer = String::new();
    let read = std::io::stdin().read_line(&mut answer);
    read.is_ok() && matches!(answer.trim().to_ascii_lowercase().as_str(), "y" | "yes")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plan_of_another_job_is_not_offered() {
        let plan = PlanRecord { number: 4, ..PlanRecord::default() };
        let waits =
            Status { awaiting_approval: vec!["tidy".into()], plan: Some(plan.clone()), ..Status::default() };
        assert_eq!(waiting(&waits, "tidy"), Ok(&plan));
        assert!(waiting(&waits, "other").is_err_and(|why| why.contains("no plan of job other")));
        assert!(waiting(&Status { awaiting_approval: Vec::new(), ..waits }, "tidy").is_err());
    }
}
