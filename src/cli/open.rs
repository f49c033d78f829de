//! `celld open`: signs this computer's browser in at the cell's page, or prints a link or a token.
//!
//! In: the state folder of a running daemon, which knows who gives the command by the owner of its file.
//! Out: a browser that is signed in (its link counts for no other user); with `--print` a link that counts
//! once, for two minutes; with `--token` a secret for a program; with `--revoke` what was given to a name is
//! void. A daemon that is still starting is waited for. Exit code 1 where there is no daemon or no page.

use crate::cli::client::{ClientError, StateArg, request_at_start};
use crate::cli::task::outln;
use crate::jobs::command::{Command, SignIn};
use cell_machine::orders::Role;
use clap::Args;
use std::process::Stdio;
use std::sync::atomic::AtomicBool;

/// Days that a token lasts unless the command says otherwise.
const TOKEN_DAYS: u32 = 90;

/// Arguments of `celld open`.
#[derive(Args, Debug)]
pub struct OpenArgs {
    #[command(flatten)]
    state: StateArg,
    /// What may be done at the page: view, operate, approve or engineer; each may do what those before it
    /// may.
    #[arg(long, default_value = "engineer")]
    role: Role,
    /// How the person or program is called in the log [default: the user's name]
    #[arg(long)]
    name: Option<String>,
    /// Print the link and open nothing: for a browser on another computer
    #[arg(long, conflicts_with = "token")]
    print: bool,
    /// Print a token for a program instead (Authorization: Bearer TOKEN)
    #[arg(long)]
    token: bool,
    /// How long the token lasts, days
    #[arg(long, default_value_t = TOKEN_DAYS, requires = "token")]
    days: u32,
    /// End all sessions, tokens and links of this name, at once
    #[arg(long, value_name = "NAME", conflicts_with_all = ["print", "token", "name"])]
    revoke: Option<String>,
}

/// Runs the command; the exit code.
pub(super) fn open(args: &OpenArgs, stop: &AtomicBool) -> Result<u8, ClientError> {
    if let Some(name) = args.revoke.clone() {
        let reply = request_at_start(&args.state.folder(), &Command::SignOut { name }, stop)?;
        if reply.accepted {
            outln!("{}", reply.message);
        } else {
            cell_edge::terminal::complain(&reply.message);
        }
        return Ok(u8::from(!reply.accepted));
    }
    let token_days = args.token.then_some(args.days);
    // All users of this computer can read the arguments with which the browser is started.
    let own_browser = !args.token && !args.print && has_a_desktop();
    let wanted = SignIn { role: args.role, name: args.name.clone(), token_days, own_browser };
    let reply = request_at_start(&args.state.folder(), &Command::SignIn(wanted), stop)?;
    if !reply.accepted {
        cell_edge::terminal::complain(&reply.message);
        return Ok(1);
    }
    if args.token || args.print {
        outln!("{}", reply.message);
        return Ok(0);
    }
    if own_browser && opened(&reply.message) {
        let address = reply.message.split("/#").next().unwrap_or_default();
        outln!("the page is open in the browser: {address}");
        return Ok(0);
    }
    outln!("{}", reply.message);
    let whose = if own_browser { " of yours on this computer" } else { "" };
    eprintln!("no browser could be started; open this link in one{whose} within two minutes, it counts once");
    Ok(0)
}

fn has_a_desktop() -> bool {
    std::env::var_os("DISPLAY").is_some() || std::env::var_os("WAYLAND_DISPLAY").is_some()
}

/// Hands the link to the desktop's browser.
fn opened(link: &str) -> bool {
    let mut browser = std::process::Command::new("xdg-open");
    browser.arg(link).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    browser.status().is_ok_and(|status| status.success())
}
