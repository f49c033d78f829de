//! `celld fleet demo`: a NATS server, simulated cells, a campaign, the page, a report: one command.
//!
//! In: how many cells, where the server's program is. Out: the page's link on stdout, lines of progress on
//! stderr, `report.html` and `result.json` in the output folder. Exit 0 when every job was done, 1 when not,
//! 130 after Ctrl-C. Everything that was started ends with it.

use crate::cli::fleet::reach::Failure;
use crate::cli::task::outln;
use crate::fleet::demo::cells::DemoCell;
use crate::fleet::demo::processes::{Process, end, nats, nats_program};
use crate::fleet::demo::report::html;
use crate::fleet::page::FleetPage;
use crate::fleet::view::{CellView, FleetView, JobView};
use crate::fleet::watch::watch;
use cell_edge::clock::unix_now_s;
use cell_fleet::client::Client;
use cell_fleet::connect::Access;
use cell_fleet::payloads::Job;
use cell_fleet::server::Storage;
use cell_fleet::subjects::{Fleet, Lane, Priority, Target};
use clap::Args;
use std::fs::File;
use std::net::{Ipv4Addr, SocketAddr};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use tokio::signal::unix::{SignalKind, signal};

/// Name of the fleet, and of who submits.
const FLEET: &str = "demo";

/// Cells are there within this time: they are several, and each has a camera to open.
const READY_WITHIN: Duration = Duration::from_secs(180);

/// What all cells do once; then what any of them does: the halves of the table.
const CAMPAIGNS: [(&str, [f64; 2]); 2] = [("to-the-left", [0.02, 0.24]), ("to-the-right", [0.26, 0.48])];

/// `celld fleet demo`
#[derive(Args, Debug)]
pub struct DemoArgs {
    /// How many simulated cells, two of which are enough work for one core
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=32))]
    cells: u32,
    /// Jobs for any cell, after the campaign that every cell does once
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(0..=1000))]
    jobs: u32,
    /// The NATS server's program [default: nats-server on the path]
    #[arg(long, value_name = "FILE")]
    nats_server: Option<PathBuf>,
    /// Loopback address of the first cell's devices; the others follow
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.40.1")]
    bind: Ipv4Addr,
    /// Where the page is
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:8738")]
    listen: SocketAddr,
    /// Report, logs and the cells' folders
    #[arg(long, value_name = "DIR", default_value = "out/fleet")]
    out: PathBuf,
    /// Go on after the report, to look around, until Ctrl-C
    #[arg(long)]
    keep: bool,
}

/// # Errors
/// One sentence for the terminal: what is wrong with the arguments, the server or the answer.
pub async fn demo(args: &DemoArgs, stop: &AtomicBool) -> Result<(), Failure> {
    let program = nats_program(args.nats_server.as_deref()).map_err(Failure::Usage)?;
    let cells = (0..args.cells).map(|number| DemoCell::new(number, args.bind, &args.out));
    let cells = cells.collect::<Result<Vec<_>, _>>().map_err(Failure::Usage)?;
    let page = FleetPage::start(args.listen).map_err(Failure::Usage)?;
    let _mine = fresh_folder(&args.out)?;
    let (server, address) = nats(&program, &args.out)?;
    eprintln!("the NATS server is at {address}");
    let client = open(&address).await?;
    let mut fleet = Demo { processes: vec![server], client, page, stop, begun: Instant::now() };
    let done = fleet.perform(args, &cells, &address).await;
    eprintln!("ending the cells and the server");
    end(fleet.processes);
    done
}

/// What a folder of a fleet's demo has in it: only such a one is emptied.
const MARK: &str = ".celld-fleet-demo";

/// The folder, empty but for its mark: of an earlier run nothing is left that could be taken for this one's.
/// It is this run's as long as the mark is held.
fn fresh_folder(out: &Path) -> Result<File, Failure> {
    let fault = |error: std::io::Error| Failure::Failed(format!("{}: {error}", out.display()));
    std::fs::create_dir_all(out).map_err(fault)?;
    let mark = out.join(MARK);
    if !mark.is_file() && out.read_dir().map_err(fault)?.next().is_some() {
        let out = out.display();
        return Err(Failure::Usage(format!("{out}: has files that are no fleet demo's; name another --out")));
    }
    let held = File::create(&mark).map_err(fault)?;
    if held.try_lock().is_err() {
        let out = out.display();
        return Err(Failure::Usage(format!("{out}: another fleet demo runs in it; name another --out")));
    }
    for entry in out.read_dir().map_err(fault)? {
        let entry = entry.map_err(fault)?;
        if entry.file_name() == MARK {
            continue;
        }
        match entry.file_type().map_err(fault)?.is_dir() {
            true => std::fs::remove_dir_all(entry.path()).map_err(fault)?,
            false => std::fs::remove_file(entry.path()).map_err(fault)?,
        }
    }
    Ok(held)
}

async fn open(address: &str) -> Result<Client, Failure> {
    let access = Access {
        servers: vec![address.to_string()],
        credentials: None,
        authority: None,
        tls: false,
        domain: None,
        name: "celld fleet demo".to_string(),
    };
    let fleet = Fleet::new(FLEET).ok_or_else(|| Failure::Failed(format!("{FLEET} is no name")))?;
    let client = Client::open(&access, fleet, FLEET, Storage::USUAL).await;
    client.map_err(|fault| Failure::Failed(fault.to_string()))
}

/// Ctrl-C, SIGTERM, or the terminal has gone: what was started ends in each case.
async fn ended_by_a_signal() {
    let (Ok(mut terminate), Ok(mut hang_up)) =
        (signal(SignalKind::terminate()), signal(SignalKind::hangup()))
    else {
        // Without those this one still counts.
        let _ = tokio::signal::ctrl_c().await;
        return;
    };
    tokio::select! {
        _ = tokio::signal::ctrl_c() => {}
        _ = terminate.recv() => {}
        _ = hang_up.recv() => {}
    }
}

struct Demo<'s> {
    processes: Vec<Process>,
    client: Client,
    page: FleetPage,
    stop: &'s AtomicBool,
    begun: Instant,
}

impl Demo<'_> {
    async fn perform(&mut self, args: &DemoArgs, cells: &[DemoCell], address: &str) -> Result<(), Failure> {
        outln!("{}", self.page.link());
        for cell in cells {
            cell.write(FLEET, address)?;
            self.start(cell)?;
        }
        self.say(&format!("{} cells start; the page above shows them", cells.len()));
        let ready = |view: &FleetView| view.cells.iter().filter(|cell| is_ready(cell)).count() == cells.len();
        self.until("the cells are armed and idle", Some(READY_WITHIN), ready).await?;
        let count = self.submit(args, cells).await?;
        self.say(&format!("{count} jobs are in the queue"));
        let work = Instant::now();
        let over = |view: &FleetView| view.jobs.len() >= count && view.jobs.iter().all(is_over);
        let last = self.until("all jobs are over", None, over).await?;
        let verdict = finish(&args.out, &last, work.elapsed().as_secs_f64());
        if args.keep && verdict.is_ok() {
            self.say("the cells stay; Ctrl-C ends them");
            self.until("Ctrl-C", None, |_| false).await?;
        }
        verdict
    }

    /// A simulated robot and its daemon.
    fn start(&mut self, cell: &DemoCell) -> Result<(), Failure> {
        let celld = std::env::current_exe().map_err(|error| Failure::Failed(error.to_string()))?;
        let mut sim = Command::new(&celld);
        sim.args(["sim", "--config"]).arg(cell.sim());
        let log = |name: &str| cell.folder.join(name);
        let name = |what: &str| format!("the {what} of {}", cell.name);
        self.processes.push(Process::start(&name("simulator"), &mut sim, log("sim.log"))?);
        let mut daemon = Command::new(&celld);
        daemon.args(["run", "--config"]).arg(cell.config()).arg("--state").arg(cell.state());
        self.processes.push(Process::start(&name("daemon"), &mut daemon, log("celld.log"))?);
        Ok(())
    }

    fn say(&self, text: &str) {
        eprintln!("{:6.1} s  {text}", self.begun.elapsed().as_secs_f64());
    }

    /// Shows the fleet until something holds.
    async fn until(
        &mut self,
        what: &str,
        within: Option<Duration>,
        holds: impl Fn(&FleetView) -> bool,
    ) -> Result<FleetView, Failure> {
        let (begun, mut last, mut said) = (Instant::now(), None, String::new());
        let (page, processes, stop, demo_begun) = (&self.page, &mut self.processes, self.stop, self.begun);
        let mut each = |view: FleetView| {
            page.show(&view);
            let line = progress(&view);
            if line != said {
                eprintln!("{:6.1} s  {line}", demo_begun.elapsed().as_secs_f64());
                said = line;
            }
            let ended = processes.iter_mut().find_map(|process| process.check().err());
            let late = within.is_some_and(|within| begun.elapsed() > within);
            last = Some(match ended {
                Some(fault) => Err(Failure::Failed(fault)),
                None if holds(&view) => Ok(view),
                None if stop.load(Ordering::Relaxed) => Err(Failure::Stopped),
                None if late => Err(Failure::Failed(format!("{what}: not in time; {}", progress(&view)))),
                None => return ControlFlow::Continue(()),
            });
            ControlFlow::Break(())
        };
        let followed = watch(&self.client, FLEET, &mut each);
        tokio::select! {
            () = followed => {}
            () = ended_by_a_signal() => return Err(Failure::Stopped),
        }
        last.unwrap_or(Err(Failure::Stopped))
    }

    /// The campaigns, then jobs for any cell.
    async fn submit(&self, args: &DemoArgs, cells: &[DemoCell]) -> Result<usize, Failure> {
        let (first, half) = CAMPAIGNS[0];
        for cell in cells {
            let id = format!("{first}.{}", cell.name);
            self.put(&id, half, Some(first), Target::Cell(cell.name.clone())).await?;
        }
        for number in 1..=args.jobs {
            // In turn: a cell that has its objects there already does a job in no moves.
            let (name, half) = CAMPAIGNS[number as usize % CAMPAIGNS.len()];
            self.put(&format!("{name}-{number}"), half, None, Target::any()).await?;
        }
        Ok(cells.len() + args.jobs as usize)
    }

    async fn put(
        &self,
        id: &str,
        half: [f64; 2],
        campaign: Option<&str>,
        target: Target,
    ) -> Result<(), Failure> {
        let text = job_text(id, half);
        let job = Job { campaign: campaign.map(str::to_string), ..Job::new(id, &text, unix_now_s()) };
        self.client.submit(&job, &Lane { priority: Priority::Normal, target }).await?;
        Ok(())
    }
}

/// All objects into one half of the table.
fn job_text(id: &str, [left, right]: [f64; 2]) -> String {
    format!(
        "version: 1\nid: \"{id}\"\ngoal:\n  region:\n    objects: [plank-1, plank-2, block, lid]\n    \
         polygon: [[{left}, 0.02], [{right}, 0.02], [{right}, 0.48], [{left}, 0.48]]\n"
    )
}

fn is_ready(cell: &CellView) -> bool {
    !cell.away && cell.state.armed && cell.state.idle
}

fn is_over(job: &JobView) -> bool {
    matches!(job.state.as_str(), "ended" | "aside" | "cancelled")
}

/// One line of where it is.
fn progress(view: &FleetView) -> String {
    let cell = |cell: &CellView| match (&cell.state.job, cell.state.step) {
        (Some(job), Some((step, of))) => format!("{} {job} {step}/{of}", cell.name),
        (Some(job), None) => format!("{} {job}", cell.name),
        (None, _) if is_ready(cell) => format!("{} idle", cell.name),
        (None, _) => format!("{} {}", cell.name, cell.state.state),
    };
    let cells: Vec<String> = view.cells.iter().map(cell).collect();
    let over = view.jobs.iter().filter(|job| is_over(job)).count();
    let waiting: usize = view.queued.values().sum();
    format!("{over} jobs over, {waiting} wait; {}", cells.join(", "))
}

/// The report, and whether all was done.
fn finish(out: &Path, view: &FleetView, seconds: f64) -> Result<(), Failure> {
    let report = out.join("report.html");
    let result = serde_json::to_vec_pretty(view).map_err(|error| Failure::Failed(error.to_string()))?;
    for (path, bytes) in [(&report, html(view, seconds).into_bytes()), (&out.join("result.json"), result)] {
        std::fs::write(path, bytes)
            .map_err(|error| Failure::Failed(format!("{}: {error}", path.display())))?;
    }
    eprintln!("report: {}", report.display());
    let failed: Vec<&str> = view
        .jobs
        .iter()
        .filter(|job| job.outcome.as_ref().is_none_or(|outcome| outcome.status != "done"))
        .map(|job| job.id.as_str())
        .collect();
    match failed.is_empty() {
        true => Ok(()),
        false => Err(Failure::Failed(format!("not done: {}", failed.join(", ")))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cell_fleet::payloads::JOB_TEXT_MAX;

    #[test]
    fn only_what_is_of_a_demo_is_removed() {
        let folder = tempfile::tempdir().unwrap();
        let (out, others) = (folder.path().join("fleet"), folder.path().join("nats"));
        std::fs::create_dir(&others).unwrap();
        std::fs::write(others.join("nats.conf"), "x").unwrap();
        assert!(
            matches!(fresh_folder(&others), Err(Failure::Usage(fault)) if fault.contains("another --out"))
        );
        assert!(others.join("nats.conf").exists());
        let held = fresh_folder(&out).ok().unwrap();
        std::fs::create_dir(out.join("cell-1")).unwrap();
        assert!(matches!(fresh_folder(&out), Err(Failure::Usage(fault)) if fault.contains("runs in it")));
        assert!(out.join("cell-1").exists(), "of a demo that runs nothing is removed");
        drop(held);
        assert!(fresh_folder(&out).is_ok() && !out.join("cell-1").exists());
    }

    #[test]
    fn its_jobs_are_jobs() {
        for (name, half) in CAMPAIGNS {
            let text = job_text(name, half);
            assert!(text.len() < JOB_TEXT_MAX && Job::new(name, &text, 0.0).check().is_ok());
            let no_file = |_: &str| Err(String::new());
            crate::jobs::submit::prepare(&text, name, &no_file).unwrap();
        }
    }
}
