//! `celld fleet`: many cells, one queue, at a terminal.
//!
//! In: how the server is reached, by options or by the `fleet:` section of a cell's configuration, and the
//! name of the person, who is one user of the server. Out: lists, answers, sentences. Exit code 0 done, 1
//! understood and not succeeded, 2 bad input,
//! 130 after Ctrl-C. Nothing here arms, resumes, recovers or releases: that needs
//! eyes on the cell.

mod config;
mod demo;
mod export;
mod fetch;
mod jobs;
mod page;
mod reach;
mod show;
mod submit;

use crate::cli::fleet::reach::Failure;
use cell_edge::terminal::complain;
use clap::Subcommand;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// `celld fleet ...`
#[derive(Subcommand, Debug)]
pub enum FleetCommand {
    /// The cells, what each does, and what is wrong
    Status(show::StatusArgs),
    /// The jobs that cells have taken, and how many wait in which queue
    Jobs(show::JobsArgs),
    /// What happens in the cells, a line each, until Ctrl-C
    Watch(show::WatchArgs),
    /// A page of all cells, for this computer, until Ctrl-C
    Page(page::PageArgs),
    /// A whole fleet in simulation: a NATS server, cells, a campaign, the page, a report
    Demo(demo::DemoArgs),
    /// Put a job into the queue
    Submit(submit::SubmitArgs),
    /// Agree to the plan of a job
    Approve(jobs::ApproveArgs),
    /// Refuse the plan of a job
    Reject(jobs::DecideArgs),
    /// Give a job up, wherever it is
    Cancel(jobs::JobArgs),
    /// Give a job to another cell; for one that was begun: its objects are on the table of the cell that
    /// began it
    Give(jobs::GiveArgs),
    /// Take a cell out of the fleet that does not come back
    Forget(jobs::ForgetArgs),
    /// What became of a job, and why
    Why(jobs::JobArgs),
    /// Pictures, plan, report and recording of a job, from the cell that did it
    Fetch(fetch::FetchArgs),
    /// A part of the configuration that cells share: catalogue, planner, tolerances
    #[command(subcommand)]
    Config(config::ConfigCommand),
    /// Jobs and events for shift reports, as CSV or JSON Lines
    Export(export::ExportArgs),
    /// The state of all cells for Prometheus
    Metrics(export::MetricsArgs),
}

/// Runs a subcommand; returns the exit code.
pub fn run(command: FleetCommand, stop: &Arc<AtomicBool>) -> u8 {
    let runtime = match tokio::runtime::Builder::new_current_thread().enable_all().build() {
        Ok(runtime) => runtime,
        Err(error) => {
            complain(&error.to_string());
            return 1;
        }
    };
    let done = runtime.block_on(async {
        match command {
            FleetCommand::Status(args) => show::status(&args).await,
            FleetCommand::Jobs(args) => show::jobs(&args).await,
            FleetCommand::Watch(args) => show::watch(&args, stop).await,
            FleetCommand::Page(args) => page::page(&args, stop).await,
            FleetCommand::Demo(args) => demo::demo(&args, stop).await,
            FleetCommand::Submit(args) => submit::submit(&args).await,
            FleetCommand::Approve(args) => jobs::approve(&args).await,
            FleetCommand::Reject(args) => jobs::reject(&args).await,
            FleetCommand::Cancel(args) => jobs::cancel(&args).await,
            FleetCommand::Give(args) => jobs::give(&args).await,
            FleetCommand::Forget(args) => jobs::forget(&args).await,
            FleetCommand::Why(args) => jobs::why(&args).await,
            FleetCommand::Config(command) => config::run(&command).await,
            FleetCommand::Fetch(args) => tokio::select! {
                done = fetch::fetch(&args) => done,
                Ok(()) = tokio::signal::ctrl_c() => Err(Failure::Stopped),
            },
            FleetCommand::Export(args) => export::export(&args).await,
            FleetCommand::Metrics(args) => export::metrics(&args).await,
        }
    });
    match done {
        Ok(()) => 0,
        Err(Failure::Usage(message)) => {
            complain(&message);
            2
        }
        Err(Failure::Failed(message)) => {
            complain(&message);
            1
        }
        Err(Failure::Stopped) => 130,
    }
}
