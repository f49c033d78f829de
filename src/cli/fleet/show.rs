//! `celld fleet status | jobs | watch`: what the fleet is and does.
//!
//! In: states, claims, events. Out: tables for people, JSON for programs.

use crate::cli::client::Format;
use crate::cli::fleet::reach::{Failure, ReachArgs};
use crate::cli::task::outln;
use crate::fleet::view::OLD_S;
use crate::fleet::words::words;
use crate::jobs::utc;
use cell_edge::clock::unix_now_s;
use cell_fleet::client::{Client, Shown};
use cell_fleet::payloads::Claim;
use clap::Args;
use futures_util::StreamExt;
use serde_json::json;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// How often Ctrl-C is looked for.
const LOOK_EVERY: Duration = Duration::from_millis(200);

/// `celld fleet status`
#[derive(Args, Debug)]
pub struct StatusArgs {
    /// text or json
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
    #[command(flatten)]
    reach: ReachArgs,
}

/// `celld fleet jobs`
#[derive(Args, Debug)]
pub struct JobsArgs {
    /// Only the newest so many
    #[arg(long, value_name = "N", default_value_t = 30)]
    last: usize,
    /// text or json
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
    #[command(flatten)]
    reach: ReachArgs,
}

/// `celld fleet watch`
#[derive(Args, Debug)]
pub struct WatchArgs {
    /// text, or json: one event a line
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
    #[command(flatten)]
    reach: ReachArgs,
}

/// The time by the server's clock, which dates the states; this computer's where it does not say.
pub async fn now_s(client: &Client) -> f64 {
    client.server_unix_s().await.unwrap_or_else(|_| unix_now_s())
}

/// # Errors
/// One sentence for the terminal: what is wrong with the arguments, the server or the answer.
pub async fn status(args: &StatusArgs) -> Result<(), Failure> {
    let client = args.reach.client().await?;
    let (cells, queued) = (client.cells().await?, client.queued().await?);
    let now = now_s(&client).await;
    match args.format {
        Format::Json => {
            let cell =
                |cell: &Shown| json!({ "cell": cell.name, "age_s": now - cell.unix_s, "state": cell.state });
            outln!("{}", json!({ "cells": cells.iter().map(cell).collect::<Vec<_>>(), "queued": queued }));
        }
        Format::Text => {
            if cells.is_empty() {
                outln!("no cell has joined the fleet yet");
            }
            cells.iter().for_each(|cell| outln!("{}", line(cell, now)));
            let waiting: usize = queued.values().sum();
            outln!("{waiting} jobs in the queue");
            queued.iter().for_each(|(lane, count)| outln!("  {lane}: {count}"));
        }
    }
    Ok(())
}

/// A cell in a few lines.
fn line(Shown { name, state, unix_s }: &Shown, now: f64) -> String {
    let age = now - unix_s;
    let away = if age > OLD_S { format!("  AWAY for {age:.0} s, before that: ") } else { "  ".to_string() };
    let armed = match (state.armed, state.moving) {
        (true, _) => "armed",
        (false, true) => "disarmed, THE ARM MAY STILL MOVE",
        (false, false) => "disarmed",
    };
    let job = state.job.as_ref().map(|job| {
        let step = state.step.map(|(step, of)| format!(" ({step} of {of} moves)")).unwrap_or_default();
        format!(", job {job}{step}")
    });
    let (totals, job) = (&state.totals, job.unwrap_or_default());
    let mut text = format!(
        "{name}{away}{} ({armed}){job}; {} done, {} failed, {} moves (bound {:.0})",
        state.state, totals.done, totals.failed, totals.moves, totals.bound
    );
    for job in &state.awaiting_approval {
        let plan = state.plan.filter(|_| state.job.as_ref() == Some(job));
        let plan = plan.map(|plan| format!(" --plan {plan}")).unwrap_or_default();
        text.push_str(&format!("\n    waits for `celld fleet approve {job}{plan}`"));
    }
    if state.undelivered > 0 {
        text.push_str(&format!("\n    {} events wait for the network", state.undelivered));
    }
    for complaint in &state.complaints {
        text.push_str(&format!("\n    {complaint}"));
    }
    text
}

/// # Errors
/// One sentence for the terminal: what is wrong with the arguments, the server or the answer.
pub async fn jobs(args: &JobsArgs) -> Result<(), Failure> {
    let client = args.reach.client().await?;
    let (claims, cells, queued) = (client.claims().await?, client.cells().await?, client.queued().await?);
    let from = claims.len().saturating_sub(args.last);
    let shown = claims.get(from..).unwrap_or_default();
    if args.format == Format::Json {
        outln!("{}", json!({ "claims": shown, "queued": queued }));
        return Ok(());
    }
    let now = now_s(&client).await;
    let seen: BTreeMap<&str, f64> = cells.iter().map(|cell| (cell.name.as_str(), cell.unix_s)).collect();
    shown.iter().for_each(|claim| outln!("{}", claim_line(claim, &seen, now)));
    outln!("{} jobs in the queue", queued.values().sum::<usize>());
    Ok(())
}

fn claim_line(claim: &Claim, seen: &BTreeMap<&str, f64>, now: f64) -> String {
    let Claim { job, state, cell, outcome, .. } = claim;
    let outcome = outcome.as_ref().map(|outcome| format!(", {} ({} moves)", outcome.status, outcome.moves));
    let held = claim.is_held_by(cell, job.epoch);
    let age = seen.get(cell.as_str()).map_or(f64::INFINITY, |unix_s| now - unix_s);
    let stranded = if held && age > OLD_S { ", STRANDED: its cell is away" } else { "" };
    let at = if cell.is_empty() { String::new() } else { format!(" at {cell}") };
    format!(
        "{}  {}  {}{at}{}{stranded}",
        utc::text(job.submitted_unix_s),
        job.id,
        state.as_str(),
        outcome.unwrap_or_default()
    )
}

/// # Errors
/// One sentence for the terminal: what is wrong with the arguments, the server or the answer.
pub async fn watch(args: &WatchArgs, stop: &AtomicBool) -> Result<(), Failure> {
    let client = args.reach.client().await?;
    let mut events = client.watch().await?;
    while !stop.load(Ordering::Relaxed) {
        let next = tokio::select! {
            next = events.next() => next,
            () = tokio::time::sleep(LOOK_EVERY) => continue,
            _ = tokio::signal::ctrl_c() => return Ok(()),
        };
        let Some(next) = next else { break };
        let (Some(event), _) = next? else { continue };
        match args.format {
            Format::Json => outln!("{}", json!(event)),
            Format::Text => {
                let job = event.job.as_ref().map(|job| format!(" {job}")).unwrap_or_default();
                outln!("{}  {}{job}: {}", utc::text(event.unix_s), event.cell, words(&event));
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use cell_fleet::payloads::{CellState, ClaimState, Job};
    use cell_fleet::subjects::{Lane, Priority, Target};

    #[test]
    fn a_cell_that_is_away_and_a_job_that_is_stranded_are_seen() {
        let state = CellState { state: "idle".into(), armed: true, ..CellState::default() };
        let cell = |unix_s| Shown { name: "c1".into(), state: state.clone(), unix_s };
        assert!(line(&cell(95.0), 100.0).starts_with("c1  idle (armed); 0 done"));
        assert!(line(&cell(10.0), 100.0).contains("AWAY for 90 s"));
        let lane = Lane { priority: Priority::Normal, target: Target::any() };
        let claim = Claim::new(Job::new("tidy", "x", 0.0), &lane, "anna", ClaimState::Begun, "c1", 0.0);
        let at = |unix_s| claim_line(&claim, &[("c1", unix_s)].into(), 100.0);
        assert!(at(10.0).contains("STRANDED") && !at(99.0).contains("STRANDED"));
    }
}
