//! `celld fleet page`: all cells on one page.
//!
//! In: how the server is reached, an address of this computer. Out: the link, and the page until Ctrl-C.

use crate::cli::fleet::reach::{Failure, ReachArgs};
use crate::cli::task::outln;
use crate::fleet::page::FleetPage;
use crate::fleet::watch::watch;
use clap::Args;
use std::net::SocketAddr;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};

/// `celld fleet page`
#[derive(Args, Debug)]
pub struct PageArgs {
    /// Where the page is: an address of this computer alone
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:8738")]
    listen: SocketAddr,
    #[command(flatten)]
    reach: ReachArgs,
}

/// # Errors
/// One sentence for the terminal: what is wrong with the arguments, the server or the answer.
pub async fn page(args: &PageArgs, stop: &AtomicBool) -> Result<(), Failure> {
    let client = args.reach.client().await?;
    let page = FleetPage::start(args.listen).map_err(Failure::Usage)?;
    outln!("{}", page.link());
    eprintln!("the page of fleet {}; Ctrl-C ends it", client.fleet_name());
    let shown = watch(&client, client.fleet_name(), |view| {
        page.show(&view);
        match stop.load(Ordering::Relaxed) {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        }
    });
    tokio::select! {
        () = shown => {}
        _ = tokio::signal::ctrl_c() => {}
    }
    Ok(())
}
