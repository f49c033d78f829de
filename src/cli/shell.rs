//! `celld completions`, `celld man`: what a shell and `man` know of the command line, made from the command
//! line itself.
//!
//! In: the shell, or a folder. Out: a completion script on stdout; manual pages in the folder, one a
//! command (`celld-plan.1`), or the page of `celld` on stdout.

use crate::cli::client::exit_2;
use cell_edge::terminal::{print, prints};
use clap::{Args, Command};
use clap_complete::Shell;
use std::io;
use std::path::{Path, PathBuf};

/// Arguments of `celld completions`.
#[derive(Args, Debug)]
#[command(after_help = COMPLETIONS_HELP)]
pub struct CompletionsArgs {
    /// For which shell
    shell: Shell,
}

const COMPLETIONS_HELP: &str = "\
For this user, in bash:

    celld completions bash > ~/.local/share/bash-completion/completions/celld

`make install` and the Debian package place those of bash, zsh and fish.";

/// Arguments of `celld man`.
#[derive(Args, Debug)]
pub struct ManArgs {
    /// Write the pages of all commands into this folder; without it, the page of celld goes to stdout
    #[arg(long, value_name = "FOLDER")]
    out: Option<PathBuf>,
}

/// Runs `celld completions`; returns the exit code.
pub fn completions(args: &CompletionsArgs, mut command: Command) -> u8 {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut command, "celld", &mut script);
    print(&String::from_utf8_lossy(&script));
    0
}

/// Runs `celld man`; returns the exit code.
pub fn man(args: &ManArgs, command: Command) -> u8 {
    let Some(folder) = &args.out else {
        let mut page = Vec::new();
        return match clap_mangen::Man::new(command).render(&mut page) {
            Ok(()) => u8::from(!prints(&String::from_utf8_lossy(&page))),
            Err(error) => exit_2(&format!("the page could not be made: {error}")),
        };
    };
    match std::fs::create_dir_all(folder).and_then(|()| pages(command, folder)) {
        Ok(()) => 0,
        Err(error) => exit_2(&format!("{}: {error}", folder.display())),
    }
}

/// Writes the page of every command into a folder.
pub(super) fn pages(command: Command, folder: &Path) -> io::Result<()> {
    clap_mangen::generate_to(command, folder)
}
