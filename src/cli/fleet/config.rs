//! `celld fleet config`: a part of the configuration that many cells share, in versions.
//!
//! In: a file with `objects`, `planner`, `tolerances` or some of them; for whom. Out: its number, what is
//! there, what a cell runs with. A cell takes one when it is idle and disarmed, after checking it as
//! `celld check` does; what is a cell's own (bodies, limits, addresses, calibration) is in no fragment.

use crate::cli::fleet::reach::{Failure, ReachArgs};
use crate::cli::task::outln;
use crate::config::load::load_cell_with;
use crate::config::read_fragment::read_fragment;
use crate::jobs::utc;
use cell_edge::clock::unix_now_s;
use cell_edge::files::read_regular;
use cell_fleet::client::Shown;
use cell_fleet::fragments::{FRAGMENT_MAX, Published};
use cell_fleet::subjects::Target;
use clap::{Args, Subcommand};
use std::path::PathBuf;

/// `celld fleet config ...`
#[derive(Subcommand, Debug)]
pub enum ConfigCommand {
    /// What is published, and with which number each cell runs
    Show(ShowArgs),
    /// Publish a file for a cell, a label or all
    Publish(PublishArgs),
    /// Go back to what was published before, or to a number
    Back(BackArgs),
    /// Take back what is published: its cells run with their own files again
    Withdraw(WithdrawArgs),
}

/// For whom.
#[derive(Args, Debug)]
pub struct TargetArgs {
    /// Which cells: cell=NAME, label=NAME, or any; of a cell the nearest counts
    #[arg(long, value_name = "TARGET")]
    to: String,
}

impl TargetArgs {
    fn target(&self) -> Result<Target, Failure> {
        let to = &self.to;
        let none = || Failure::Usage(format!("{to:?} names no cells: write cell=NAME, label=NAME, or any"));
        Target::parse(to).ok_or_else(none)
    }
}

/// `celld fleet config show`
#[derive(Args, Debug)]
pub struct ShowArgs {
    /// With the text of the one that has this number
    #[arg(long, value_name = "N")]
    number: Option<u64>,
    #[command(flatten)]
    reach: ReachArgs,
}

/// `celld fleet config publish`
#[derive(Args, Debug)]
pub struct PublishArgs {
    /// The fragment
    file: PathBuf,
    #[command(flatten)]
    to: TargetArgs,
    /// A cell's configuration to check it with before; each cell checks it with its own anyhow
    #[arg(long, value_name = "FILE")]
    check: Option<PathBuf>,
    #[command(flatten)]
    reach: ReachArgs,
}

/// `celld fleet config back`
#[derive(Args, Debug)]
pub struct BackArgs {
    #[command(flatten)]
    to: TargetArgs,
    /// To this number [default: the last one before the present]
    #[arg(long, value_name = "N")]
    number: Option<u64>,
    #[command(flatten)]
    reach: ReachArgs,
}

/// `celld fleet config withdraw`
#[derive(Args, Debug)]
pub struct WithdrawArgs {
    #[command(flatten)]
    to: TargetArgs,
    #[command(flatten)]
    reach: ReachArgs,
}

/// # Errors
/// One sentence for the terminal: what is wrong with the arguments, the server or the answer.
pub async fn run(command: &ConfigCommand) -> Result<(), Failure> {
    match command {
        ConfigCommand::Show(args) => show(args).await,
        ConfigCommand::Publish(args) => publish(args).await,
        ConfigCommand::Back(args) => back(args).await,
        ConfigCommand::Withdraw(args) => withdraw(args).await,
    }
}

async fn publish(args: &PublishArgs) -> Result<(), Failure> {
    let target = args.to.target()?;
    let source = args.file.display().to_string();
    let text = read_regular(&args.file, FRAGMENT_MAX as u64);
    let text = text.map_err(|error| Failure::Usage(format!("{source}: {error}")))?.0;
    let fragment = read_fragment(&text, &source).map_err(|fault| Failure::Usage(fault.to_string()))?;
    if let Some(cell) = &args.check {
        load_cell_with(cell, Some(&fragment)).map_err(|fault| Failure::Usage(fault.to_string()))?;
    }
    let client = args.reach.client().await?;
    let number = client.publish_fragment(&target, &text, unix_now_s()).await?;
    outln!("{number}");
    eprintln!("{target}: fragment {number}; a cell takes it when it is idle and disarmed");
    Ok(())
}

async fn back(args: &BackArgs) -> Result<(), Failure> {
    let target = args.to.target()?;
    let client = args.reach.client().await?;
    let history = client.fragment_history(&target).await?;
    let before = earlier(&history, args.number).map_err(Failure::Failed)?;
    let number = client.publish_fragment(&target, &before.fragment.text, unix_now_s()).await?;
    outln!("{number}");
    eprintln!("{target}: fragment {number} has the content of {}", before.revision);
    Ok(())
}

/// The one to go back to: the number, or the last before the present one that says something else.
fn earlier(history: &[Published], number: Option<u64>) -> Result<&Published, String> {
    let Some((present, before)) = history.split_last() else {
        return Err("nothing was published for this target".to_string());
    };
    let found = match number {
        Some(number) => history.iter().find(|published| published.revision == number),
        None => before.iter().rfind(|published| published.fragment.sha256 != present.fragment.sha256),
    };
    let known: Vec<String> = history.iter().map(|published| published.revision.to_string()).collect();
    found.ok_or_else(|| format!("there is none to go back to; the server has {}", known.join(", ")))
}

async fn withdraw(args: &WithdrawArgs) -> Result<(), Failure> {
    let target = args.to.target()?;
    let client = args.reach.client().await?;
    let number = client.publish_fragment(&target, "", unix_now_s()).await?;
    outln!("{number}");
    eprintln!("{target}: taken back; a cell starts with its own file when it is idle and disarmed");
    Ok(())
}

async fn show(args: &ShowArgs) -> Result<(), Failure> {
    let client = args.reach.client().await?;
    let (shelf, cells) = (client.fragments().await?, client.cells().await?);
    if let Some(number) = args.number {
        let target = shelf.all().find(|published| published.revision == number);
        let found = match target {
            Some(found) => found.clone(),
            None => {
                let mut all = Vec::new();
                for published in shelf.all() {
                    all.extend(client.fragment_history(&published.target).await?);
                }
                let found = all.into_iter().find(|published| published.revision == number);
                found.ok_or_else(|| Failure::Failed(format!("the server has no fragment {number}")))?
            }
        };
        outln!("{}", found.fragment.text.trim_end());
        return Ok(());
    }
    if shelf.all().next().is_none() {
        outln!("nothing is published; each cell runs with its own file");
    }
    for published in shelf.all() {
        let Published { target, by, revision, fragment } = published;
        let what = if fragment.text.is_empty() { "taken back" } else { "published" };
        outln!("{target}: fragment {revision}, {what} by {by} at {}", utc::text(fragment.unix_s));
    }
    cells.iter().for_each(|cell| outln!("{}", runs(cell)));
    Ok(())
}

fn runs(cell: &Shown) -> String {
    let with = match cell.state.fragment {
        Some(number) => format!("fragment {number}"),
        None => "its own file alone".to_string(),
    };
    let waits = match cell.state.fragment_waits {
        Some(0) => "; goes back to its own file when idle and disarmed".to_string(),
        Some(number) => format!("; takes {number} when idle and disarmed"),
        None => String::new(),
    };
    format!("{}: {with}{waits}", cell.name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use cell_fleet::fragments::Fragment;
    use cell_fleet::payloads::{CellState, sha256};

    fn published(revision: u64, text: &str) -> Published {
        let fragment = Fragment { version: 1, text: text.into(), sha256: sha256(text), unix_s: 0.0 };
        Published { target: Target::any(), by: "anna".into(), revision, fragment }
    }

    #[test]
    fn one_goes_back_to_what_said_something_else() {
        let history = [published(1, "a"), published(4, "b"), published(6, "b")];
        assert_eq!(earlier(&history, None).unwrap().revision, 1);
        assert_eq!(earlier(&history, Some(4)).unwrap().revision, 4);
        assert!(earlier(&history, Some(5)).unwrap_err().contains("1, 4, 6"));
        assert!(earlier(&history[..1], None).is_err() && earlier(&[], None).is_err());
    }

    #[test]
    fn what_a_cell_runs_with_is_said() {
        let state = CellState { fragment: Some(3), fragment_waits: Some(0), ..CellState::default() };
        let shown = Shown { name: "c1".into(), state, unix_s: 0.0 };
        assert_eq!(runs(&shown), "c1: fragment 3; goes back to its own file when idle and disarmed");
    }
}
