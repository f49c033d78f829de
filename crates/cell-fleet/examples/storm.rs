//! Many cells, each a process, and a server, all of them killed at random: is every job done once?
//!
//! In: options, the program of a NATS server. Out: a table of figures; exit code 1 where a job was lost or
//! carried out twice. The cells are the real part of a cell in its fleet with its database; the cell
//! behind it is a small one: a journal on the disk that is as durable as the real one, and work that is only
//! time. `make bench-fleet` runs it; docs/evaluation.md has the figures.

#![allow(clippy::unwrap_used, reason = "a figure that cannot be taken ends the run")]

#[path = "storm/cell.rs"]
mod cell;
#[path = "storm/server.rs"]
mod server;

use cell_fleet::changes::Change;
use cell_fleet::client::Client;
use cell_fleet::connect::Access;
use cell_fleet::payloads::{ClaimState, Job};
use cell_fleet::server::Storage;
use cell_fleet::subjects::{Fleet, Lane, Priority, Target};
use futures_util::StreamExt;
use futures_util::stream::FuturesUnordered;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use server::Server;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitCode, Stdio};
use std::time::{Duration, Instant, SystemTime};
use tokio::time::sleep;

const FLEET: &str = "storm";

/// Submissions on their way at once.
const AT_ONCE: usize = 32;

/// A run that takes longer has lost something.
const MOST: Duration = Duration::from_secs(3 * 3600);

struct Options {
    nats: PathBuf,
    cells: usize,
    jobs: usize,
    kills: usize,
    server_kills: usize,
    /// Of a job, ms.
    takes_ms: u64,
    /// The server writes each message to the disk before it answers.
    sync_always: bool,
    seed: u64,
}

const USAGE: &str = "storm --nats FILE [--cells 100] [--jobs 10000] [--kills 300] [--server-kills 20] \
                     [--takes-ms 50] [--sync always|default] [--seed 1]";

fn options() -> Result<Options, String> {
    let mut given: BTreeMap<String, String> = BTreeMap::new();
    let mut arguments = std::env::args().skip(1);
    while let Some(key) = arguments.next() {
        given.insert(key, arguments.next().ok_or(USAGE)?);
    }
    let mut number = |key: &str, usual: u64| match given.remove(key) {
        Some(text) => text.parse::<u64>().map_err(|_| format!("{key} {text}: a number, please")),
        None => Ok(usual),
    };
    let count = |number: Result<u64, String>| number.map(|number| number as usize);
    let options = Options {
        cells: count(number("--cells", 100))?,
        jobs: count(number("--jobs", 10_000))?,
        kills: count(number("--kills", 300))?,
        server_kills: count(number("--server-kills", 20))?,
        takes_ms: number("--takes-ms", 50)?,
        seed: number("--seed", 1)?,
        sync_always: given.remove("--sync").is_none_or(|word| word == "always"),
        nats: given.remove("--nats").map(PathBuf::from).ok_or(USAGE)?,
    };
    given.is_empty().then_some(options).ok_or_else(|| USAGE.to_string())
}

fn main() -> ExitCode {
    if let Some(folder) = std::env::var_os("CELLD_STORM_CELL") {
        cell::run(Path::new(&folder));
        return ExitCode::SUCCESS;
    }
    let options = match options() {
        Ok(options) => options,
        Err(message) => {
            eprintln!("{message}");
            return ExitCode::from(2);
        }
    };
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    match runtime.block_on(storm(&options)) {
        true => ExitCode::SUCCESS,
        false => ExitCode::FAILURE,
    }
}

fn now_s() -> f64 {
    SystemTime::UNIX_EPOCH.elapsed().unwrap().as_secs_f64()
}

/// The cells' processes.
struct Cells {
    folder: tempfile::TempDir,
    address: String,
    takes_ms: u64,
    running: Vec<Child>,
}

impl Cells {
    fn start(count: usize, address: &str, takes_ms: u64) -> Cells {
        let folder = tempfile::tempdir().unwrap();
        let mut cells = Cells { folder, address: address.to_string(), takes_ms, running: Vec::new() };
        for number in 0..count {
            std::fs::create_dir_all(cells.place(number)).unwrap();
            let child = cells.spawn(number);
            cells.running.push(child);
        }
        cells
    }

    fn place(&self, number: usize) -> PathBuf {
        self.folder.path().join(format!("cell-{number}"))
    }

    fn spawn(&self, number: usize) -> Child {
        let mut command = Command::new(std::env::current_exe().unwrap());
        command.env("CELLD_STORM_CELL", self.place(number)).env("CELLD_STORM_NATS", &self.address);
        command.env("CELLD_STORM_TAKES_MS", self.takes_ms.to_string()).stdin(Stdio::null());
        command.spawn().unwrap()
    }

    /// As a power cut of that cell's computer would, and on again.
    fn kill(&mut self, number: usize) {
        self.running[number].kill().unwrap();
        self.running[number].wait().unwrap();
        self.running[number] = self.spawn(number);
    }
}

impl Drop for Cells {
    fn drop(&mut self) {
        for child in &mut self.running {
            // It may have ended.
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

/// What was seen while it ran.
#[derive(Default)]
struct Seen {
    /// The state of each claim.
    claims: BTreeMap<String, ClaimState>,
    /// Cells that had begun a job.
    begun_by: BTreeMap<String, Vec<String>>,
    /// From submission to the first claim, s.
    claimed_after_s: Vec<f64>,
    /// When each cell showed itself last, by the server's clock.
    shown_unix_s: BTreeMap<String, f64>,
}

impl Seen {
    fn take(&mut self, change: Change) {
        match change {
            Change::Claim(claim) => {
                let id = &claim.job.id;
                if !self.claims.contains_key(id) {
                    self.claimed_after_s.push(claim.unix_s - claim.job.submitted_unix_s);
                }
                if matches!(claim.state, ClaimState::Begun | ClaimState::Ended) && !claim.cell.is_empty() {
                    let by = self.begun_by.entry(id.clone()).or_default();
                    if !by.contains(&claim.cell) {
                        by.push(claim.cell.clone());
                    }
                }
                self.claims.insert(id.clone(), claim.state);
            }
            Change::Cell(shown) => drop(self.shown_unix_s.insert(shown.name.clone(), shown.unix_s)),
            Change::Event(_) | Change::CellGone(_) | Change::ClaimGone(_) | Change::Ended(_) => {}
        }
    }

    fn over(&self) -> usize {
        self.claims.values().filter(|state| **state == ClaimState::Ended).count()
    }
}

async fn storm(options: &Options) -> bool {
    let mut random = ChaCha8Rng::seed_from_u64(options.seed);
    let mut server = Server::start(&options.nats, options.sync_always);
    let client = connect(&server).await;
    let mut cells = Cells::start(options.cells, &server.address(), options.takes_ms);
    let mut seen = Seen::default();
    let mut changes = client.changes(0).await.unwrap();
    while seen.shown_unix_s.len() < options.cells {
        seen.take(changes.next().await.unwrap());
    }
    println!("{} cells are there; submitting {} jobs", options.cells, options.jobs);
    let begun = Instant::now();
    let submitting = tokio::spawn(submit(connect(&server).await, options.jobs));
    let (mut killed, mut server_killed, mut backs_s) = (0, 0, Vec::new());
    let mut said = 0;
    // Evenly over the jobs, whatever the speed.
    let every = |count: usize| options.jobs.checked_div(count + 1).unwrap_or(usize::MAX).max(1);
    while seen.over() < options.jobs && begun.elapsed() < MOST {
        // A watch that has ended is begun again; the claims come once more, which does no harm.
        match tokio::time::timeout(Duration::from_secs(10), changes.next()).await {
            Ok(Some(Change::Ended(_)) | None) | Err(_) => {
                if let Ok(again) = client.changes(0).await {
                    changes = again;
                }
            }
            Ok(Some(change)) => seen.take(change),
        }
        let over = seen.over();
        if over / 1000 > said {
            said = over / 1000;
            println!(
                "{over} over after {:.0} s, {killed} + {server_killed} kills",
                begun.elapsed().as_secs_f64()
            );
        }
        if killed < options.kills && over >= (killed + 1) * every(options.kills) {
            cells.kill(random.random_range(0..options.cells));
            killed += 1;
        }
        if server_killed < options.server_kills && over >= (server_killed + 1) * every(options.server_kills) {
            server.kill();
            sleep(Duration::from_millis(random.random_range(0..3000))).await;
            server.up();
            server_killed += 1;
            backs_s.push(back(&client, &mut seen, &mut changes, options.cells).await);
        }
    }
    let new = submitting.await.unwrap();
    let seconds = begun.elapsed().as_secs_f64();
    println!(
        "submitted {new}, ended {}, in {seconds:.0} s; {killed} kills of cells, {server_killed} of the server",
        seen.over()
    );
    backs_s.sort_by(f64::total_cmp);
    if let (Some(median), Some(longest)) = (backs_s.get(backs_s.len() / 2), backs_s.last()) {
        println!("all cells back after the server's return: median {median:.2} s, longest {longest:.2} s");
    }
    verdict(options, &cells, &mut seen)
}

async fn connect(server: &Server) -> Client {
    let access = Access {
        servers: vec![server.address()],
        credentials: None,
        authority: None,
        tls: false,
        name: "storm".to_string(),
    };
    Client::open(&access, Fleet::new(FLEET).unwrap(), "storm", Storage::USUAL).await.unwrap()
}

/// Submits all jobs, each again until the server has taken it.
async fn submit(client: Client, jobs: usize) -> usize {
    let lane = Lane { priority: Priority::Normal, target: Target::any() };
    let mut on_their_way = FuturesUnordered::new();
    let mut submitted = 0;
    for number in 0..jobs {
        let (client, lane) = (&client, &lane);
        on_their_way.push(async move {
            let id = format!("job-{number}");
            let mut job = Job::new(&id, &format!("version: 1\nid: {id}\n"), now_s());
            loop {
                match client.submit(&job, lane).await {
                    Ok(_) => return,
                    // Taken before, and the answer was lost.
                    Err(message) if message.contains("was submitted before") => return,
                    Err(_) => sleep(Duration::from_millis(200)).await,
                }
                job.submitted_unix_s = now_s();
            }
        });
        if on_their_way.len() >= AT_ONCE {
            on_their_way.next().await;
            submitted += 1;
        }
    }
    while on_their_way.next().await.is_some() {
        submitted += 1;
    }
    submitted
}

/// How long after the server's return the last cell has shown itself, s.
async fn back(
    client: &Client,
    seen: &mut Seen,
    changes: &mut cell_fleet::changes::Changes,
    cells: usize,
) -> f64 {
    let returned = now_s();
    let begun = Instant::now();
    while begun.elapsed() < Duration::from_secs(60) {
        let shown = client.cells().await.unwrap_or_default();
        let last = shown.iter().map(|cell| cell.unix_s - returned).fold(0.0, f64::max);
        if shown.len() == cells && shown.iter().all(|cell| cell.unix_s >= returned) {
            if let Ok(again) = client.changes(0).await {
                *changes = again;
            }
            shown.into_iter().for_each(|cell| seen.take(Change::Cell(Box::new(cell))));
            return last;
        }
        sleep(Duration::from_millis(50)).await;
    }
    f64::INFINITY
}

/// What the cells' own disks say, against what was submitted.
fn verdict(options: &Options, cells: &Cells, seen: &mut Seen) -> bool {
    let mut carried_out: BTreeMap<String, usize> = BTreeMap::new();
    for number in 0..options.cells {
        for job in cell::carried_out(&cells.place(number)) {
            *carried_out.entry(job).or_default() += 1;
        }
    }
    let lost = (0..options.jobs).filter(|number| !carried_out.contains_key(&format!("job-{number}"))).count();
    let twice = carried_out.values().filter(|count| **count > 1).count();
    let by_two = seen.begun_by.values().filter(|cells| cells.len() > 1).count();
    println!("lost {lost}, carried out twice {twice}, begun by a second cell {by_two}");
    let after = &mut seen.claimed_after_s;
    after.sort_by(f64::total_cmp);
    let at = |share: f64| after.get((after.len() as f64 * share) as usize).copied().unwrap_or(f64::NAN) * 1e3;
    println!(
        "submitted to claimed: median {:.1} ms, p99 {:.1} ms (of jobs that waited for a cell too)",
        at(0.5),
        at(0.99)
    );
    lost + twice + by_two == 0
}
