//! `celld journal`: a damaged journal made usable again.
//!
//! In: the state folder of a daemon that does not run. Out: what was kept and lost, where the damaged files
//! are, what to check before the next motion. Exit codes: 0 the journal is usable; 1 it is not, or a daemon
//! runs; 2 no such state folder.

use crate::cli::client::{StateArg, exit_2};
use crate::jobs::journal::repair::{Kept, Repaired, repair};
use crate::jobs::state::StateFolder;
use cell_edge::clock::unix_now_s;
use cell_edge::file_lock::FileLock;
use cell_edge::terminal::{complain, print};
use clap::{Args, Subcommand};
use rearrange::document::chain::chain;
use std::path::Path;

/// `celld journal`
#[derive(Subcommand, Debug)]
pub enum JournalCommand {
    /// Replace a damaged journal by a new one with everything that can still be read
    Repair(RepairArgs),
}

const HELP: &str = "\
The journal is the file history.sqlite in the state folder: the database of jobs, steps and refused
files. When it is damaged, celld stops the cell and does not start. Then:

    1. stop celld (`systemctl stop celld`, or Ctrl-C)
    2. run `celld journal repair` as the user that celld runs as
    3. check that the cups are empty, and look at `celld jobs`
    4. start celld

A sound journal is left as it is. The damaged files stay beside the new journal, as
history.sqlite.damaged-TIME; delete them when nobody needs them. With a backup, compare first: it
may have more than the damaged file.

Exit codes: 0 the journal is usable; 1 it is not, or celld runs; 2 no such state folder.";

/// Arguments of `celld journal repair`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub struct RepairArgs {
    #[command(flatten)]
    state: StateArg,
}

/// Runs `celld journal`; returns the exit code.
pub fn run(command: &JournalCommand) -> u8 {
    let JournalCommand::Repair(args) = command;
    let state = args.state.folder();
    if !state.root().is_dir() {
        return exit_2(&format!("there is no state folder {}; name it with --state", state.root().display()));
    }
    match repaired(&state) {
        Ok(text) => {
            print(&text);
            0
        }
        Err(text) => {
            complain(&text);
            1
        }
    }
}

fn repaired(state: &StateFolder) -> Result<String, String> {
    let note = format!("{}\n", std::process::id());
    let lock = FileLock::take(&state.lock_file(), &note).map_err(|error| chain(&error))?;
    let _lock = lock.ok_or_else(|| {
        format!("celld runs on the state folder {}: stop it, then repeat the repair", state.root().display())
    })?;
    let path = state.journal();
    if path.symlink_metadata().is_err_and(|error| error.kind() == std::io::ErrorKind::NotFound) {
        return Ok(format!("there is no journal {}; celld creates one when it starts\n", path.display()));
    }
    match repair(&path, unix_now_s()) {
        Ok(Repaired::Sound) => Ok(format!("{} is sound; nothing was changed\n", path.display())),
        Ok(Repaired::Replaced { tables, damaged }) => Ok(report(&path, &tables, &damaged)),
        Err(error) => Err(format!("{} was not repaired: {}", path.display(), chain(&error))),
    }
}

fn report(path: &Path, tables: &[Kept], damaged: &Path) -> String {
    let mut text = format!("{} is repaired\n", path.display());
    for Kept { table, rows, lost } in tables {
        let lost = lost.map_or("an unknown number".to_string(), |lost| lost.to_string());
        text.push_str(&format!("  {table}: {rows} kept, {lost} lost\n"));
    }
    text.push_str(&format!("the damaged journal is kept as {}\n", damaged.display()));
    if tables.iter().any(|kept| kept.lost != Some(0)) {
        text.push_str(
            "Before the next `celld arm`, check that the cups are empty: the record of the last grip may be \
             lost.\nLook at `celld jobs` too: celld takes up waiting and active jobs whose record is lost \
             again.\n",
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_report_counts_what_was_lost_and_names_the_check_of_the_cups_only_then() {
        let kept = |lost| [Kept { table: "steps", rows: 4, lost }];
        let text = |lost| report(Path::new("s/history.sqlite"), &kept(lost), Path::new("s/old"));
        assert!(text(None).contains("steps: 4 kept, an unknown number lost"), "{}", text(None));
        assert!(text(None).contains("cups") && text(Some(1)).contains("cups"));
        assert!(text(Some(0)).contains("kept as s/old") && !text(Some(0)).contains("cups"));
    }
}
