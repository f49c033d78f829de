//! `celld fleet approve | reject | cancel | give | why`: one job, by a person.
//!
//! In: a job's id. Out: what the cell or the fleet decided, or the job's story.

use crate::cli::fleet::reach::{Failure, ReachArgs};
use crate::cli::task::outln;
use crate::fleet::words::words;
use crate::jobs::utc;
use cell_fleet::client::{Client, Story};
use cell_fleet::payloads::Claim;
use cell_fleet::subjects::{RequestKind, Target};
use clap::Args;
use std::fmt::Write as _;

/// A job of the fleet.
#[derive(Args, Debug)]
pub struct JobArgs {
    /// Its id
    job: String,
    #[command(flatten)]
    reach: ReachArgs,
}

/// The plan that is agreed to.
#[derive(Args, Debug)]
pub struct ApproveArgs {
    #[command(flatten)]
    decide: DecideArgs,
    /// Number of the plan that you have seen, as `celld fleet status` shows it; another that has taken its
    /// place meanwhile is not agreed to
    #[arg(long, value_name = "N")]
    plan: u64,
}

/// A plan that waits.
#[derive(Args, Debug)]
pub struct DecideArgs {
    /// The job's id
    job: String,
    /// The cell where it waits [default: the one whose state says so]
    #[arg(long, value_name = "NAME")]
    cell: Option<String>,
    #[command(flatten)]
    reach: ReachArgs,
}

/// A job that is given to another cell.
#[derive(Args, Debug)]
pub struct GiveArgs {
    /// Its id
    job: String,
    /// Which cell does it: cell=NAME, label=NAME, or any [default: as before]
    #[arg(long, value_name = "TARGET")]
    to: Option<String>,
    /// The job was begun: the objects on that table were seen to
    #[arg(long)]
    yes: bool,
    #[command(flatten)]
    reach: ReachArgs,
}

/// A cell of the fleet.
#[derive(Args, Debug)]
pub struct ForgetArgs {
    /// Its name
    cell: String,
    #[command(flatten)]
    reach: ReachArgs,
}

/// # Errors
/// One sentence for the terminal: what is wrong with the arguments, the server or the answer.
pub async fn forget(args: &ForgetArgs) -> Result<(), Failure> {
    let client = args.reach.client().await?;
    client.forget(&args.cell).await?;
    outln!("{}: out of the fleet; jobs that it had begun stay with it until they are given away", args.cell);
    Ok(())
}

/// The cell at which the plan of a job waits.
async fn waits_at(client: &Client, job: &str) -> Result<String, Failure> {
    let cells = client.cells().await?;
    let waiting = cells.iter().find(|cell| cell.state.awaiting_approval.iter().any(|id| id == job));
    waiting.map(|cell| cell.name.clone()).ok_or_else(|| {
        Failure::Failed(format!("no cell has a plan of job {job} that waits; see `celld fleet why {job}`"))
    })
}

/// # Errors
/// One sentence for the terminal: what is wrong with the arguments, the server or the answer.
pub async fn approve(args: &ApproveArgs) -> Result<(), Failure> {
    decide(&args.decide, RequestKind::Approve, Some(args.plan)).await
}

/// # Errors
/// One sentence for the terminal: what is wrong with the arguments, the server or the answer.
pub async fn reject(args: &DecideArgs) -> Result<(), Failure> {
    decide(args, RequestKind::Reject, None).await
}

async fn decide(args: &DecideArgs, requested: RequestKind, plan: Option<u64>) -> Result<(), Failure> {
    let client = args.reach.client().await?;
    let cell = match &args.cell {
        Some(cell) => cell.clone(),
        None => waits_at(&client, &args.job).await?,
    };
    let answer = client.request(&cell, requested, &args.job, plan).await?;
    let said = format!("{cell}: {}", answer.message);
    match answer.accepted {
        true => {
            outln!("{said}");
            Ok(())
        }
        false => Err(Failure::Failed(said)),
    }
}

/// # Errors
/// One sentence for the terminal: what is wrong with the arguments, the server or the answer.
pub async fn cancel(args: &JobArgs) -> Result<(), Failure> {
    let client = args.reach.client().await?;
    let said = client.cancel(&args.job).await?;
    outln!("{}: {said}", args.job);
    Ok(())
}

/// # Errors
/// One sentence for the terminal: what is wrong with the arguments, the server or the answer.
pub async fn give(args: &GiveArgs) -> Result<(), Failure> {
    if let Some(to) = &args.to
        && Target::parse(to).is_none()
    {
        return Err(Failure::Usage(format!("{to:?} names no cells: write cell=NAME, label=NAME, or any")));
    }
    let client = args.reach.client().await?;
    let claim = client.give(&args.job, args.to.clone(), args.yes).await?;
    let to = args.to.as_deref().unwrap_or(&claim.target);
    outln!("{}: goes back into the queue for {to}", args.job);
    Ok(())
}

/// # Errors
/// One sentence for the terminal: what is wrong with the arguments, the server or the answer.
pub async fn why(args: &JobArgs) -> Result<(), Failure> {
    let client = args.reach.client().await?;
    let story = client.why(&args.job).await?;
    if story == Story::default() {
        return Err(Failure::Failed(format!(
            "nothing is known of job {}: it waits in its queue (`celld fleet jobs`), or there is none",
            args.job
        )));
    }
    outln!("{}", story_text(&args.job, &story).trim_end());
    Ok(())
}

/// A job's story in lines.
fn story_text(job: &str, story: &Story) -> String {
    let mut text = story.claim.as_ref().map_or_else(|| format!("{job}: no cell has it\n"), head);
    for (cell, (epoch, reason)) in &story.refusals {
        let _ = writeln!(text, "  {cell} refuses it (epoch {epoch}): {reason}");
    }
    for by in &story.cancelled_by {
        let _ = writeln!(text, "  {by} does not want it any more");
    }
    for event in &story.events {
        let _ = writeln!(text, "  {}  {}: {}", utc::text(event.unix_s), event.cell, words(event));
    }
    text
}

fn head(claim: &Claim) -> String {
    let Claim { job, state, cell, by, .. } = claim;
    let at = if cell.is_empty() { String::new() } else { format!(" at {cell}") };
    let mut text =
        format!("{}: {}{at}, epoch {}, for {} by {by}\n", job.id, state.as_str(), job.epoch, claim.target);
    if let Some(outcome) = &claim.outcome {
        let _ = writeln!(text, "{} ({})\n{}", outcome.status, outcome.code, outcome.message);
    }
    for (who, reason) in &claim.reasons {
        let _ = writeln!(text, "  {who}: {reason}");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use cell_fleet::payloads::{ClaimState, Event, Job, VERSION, What};
    use cell_fleet::subjects::{Lane, Priority};

    #[test]
    fn a_story_begins_with_what_became_of_the_job() {
        let lane = Lane { priority: Priority::Normal, target: Target::any() };
        let mut claim = Claim::new(Job::new("tidy", "x", 0.0), &lane, "anna", ClaimState::Aside, "", 0.0);
        claim.reasons.insert("c1".into(), "no object mug".into());
        let event = Event {
            version: VERSION,
            cell: "c1".into(),
            series: "s".into(),
            number: 4,
            unix_s: 1_795_248_000.0,
            job: Some("tidy".into()),
            what: What::Step { step: 1, of: 2 },
        };
        let story = Story { claim: Some(claim), events: vec![event], ..Story::default() };
        let text = story_text("tidy", &story);
        assert_eq!(
            text,
            "tidy: aside, epoch 1, for label=any by anna\n  c1: no object mug\n  2026-11-21T08:00:00Z  c1: move 1 of \
             2 made\n"
        );
    }
}
