//! Many cells, each a process, and a server, all of them killed at random: is every job done once?
//!
//! In: options, the program of a NATS server. Out: a table of figures; exit code 1 where a job was lost or
//! carried out twice. The cells are the real part of a cell in its fleet with its database, a journal on the
//! disk that is as durable as the real one, and the machine in virtual time without pictures; with
//! `--takes-ms` a job only takes time instead. `make bench-fleet` runs it; docs/evaluation.md has the
//! figures.

#![allow(clippy::unwrap_used, reason = "a figure that cannot be taken ends the run")]

mod cell;
mod server;
mod work;

use cell_fleet::changes::{Change, Changes};
use cell_fleet::client::Client;
use cell_fleet::connect::Access;
use cell_fleet::payloads::{Claim, ClaimState, Job};
use cell_fleet::server::Storage;
use cell_fleet::subjects::{Fleet, Lane, Priority, Target};
use futures_util::StreamExt;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use server::Server;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitCode, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant, SystemTime};
use tokio::sync::Semaphore;
use tokio::task::JoinSet;
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
    /// Of a cluster; of several one goes away at half of the jobs, and stays away.
    nodes: usize,
    /// Of a job, ms; none: the machine in virtual time carries it out.
    takes_ms: Option<u64>,
    /// Between two submissions, ms; 0: as fast as the server takes them.
    pace_ms: u64,
    /// The server writes each message to the disk before it answers.
    sync_always: bool,
    seed: u64,
}

const USAGE: &str = "storm --nats FILE [--cells 100] [--jobs 10000] [--kills 300] [--server-kills 20] [--nodes 1] \
                     [--takes-ms N] [--pace-ms 0] [--sync always|default] [--seed 1]";

fn options() -> Result<Options, String> {
    let mut given: BTreeMap<String, String> = BTreeMap::new();
    let mut arguments = std::env::args().skip(1);
    // `cargo bench` adds its own.
    while let Some(key) = arguments.find(|argument| argument != "--bench") {
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
        nodes: count(number("--nodes", 1))?,
        takes_ms: Some(number("--takes-ms", 0)?).filter(|ms| *ms > 0),
        pace_ms: number("--pace-ms", 0)?,
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
    /// The servers, with commas.
    addresses: String,
    nodes: usize,
    takes_ms: Option<u64>,
    running: Vec<Child>,
}

impl Cells {
    fn start(count: usize, server: &Server, takes_ms: Option<u64>) -> Cells {
        let (folder, running) = (tempfile::tempdir().unwrap(), Vec::new());
        let (addresses, nodes) = (server.addresses().join(","), server.replicas());
        let mut cells = Cells { folder, addresses, nodes, takes_ms, running };
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
        command.env("CELLD_STORM_CELL", self.place(number)).env("CELLD_STORM_NATS", &self.addresses);
        command.env("CELLD_STORM_NODES", self.nodes.to_string());
        let takes = self.takes_ms.map_or("machine".to_string(), |ms| ms.to_string());
        command.env("CELLD_STORM_TAKES_MS", takes).stdin(Stdio::null());
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
    /// How many of them have ended.
    over: usize,
    /// When each cell showed itself last, by the server's clock.
    shown_unix_s: BTreeMap<String, f64>,
}

impl Seen {
    fn take(&mut self, change: Change) {
        match change {
            Change::Claim(claim) => {
                let id = &claim.job.id;
                let before = self.claims.insert(id.clone(), claim.state);
                let [was, is] = [before, Some(claim.state)].map(|state| state == Some(ClaimState::Ended));
                self.over = self.over + usize::from(is) - usize::from(was);
            }
            Change::Cell(shown) => drop(self.shown_unix_s.insert(shown.name.clone(), shown.unix_s)),
            Change::Event(_) | Change::CellGone(_) | Change::ClaimGone(_) | Change::Ended(_) => {}
        }
    }
}

/// What was written to claims, at the moment at which it was: a reader of the bucket that lags sees the last
/// of several.
#[derive(Default)]
struct Writes {
    /// From submission to the first claim, s.
    claimed_after_s: BTreeMap<String, f64>,
    /// Cells that had begun a job.
    begun_by: BTreeMap<String, Vec<String>>,
}

impl Writes {
    fn take(&mut self, claim: &Claim) {
        let Job { id, submitted_unix_s, .. } = &claim.job;
        self.claimed_after_s.entry(id.clone()).or_insert_with(|| now_s() - submitted_unix_s);
        if matches!(claim.state, ClaimState::Begun | ClaimState::Ended) && !claim.cell.is_empty() {
            let by = self.begun_by.entry(id.clone()).or_default();
            if !by.contains(&claim.cell) {
                by.push(claim.cell.clone());
            }
        }
    }
}

/// Takes in what is written from now on.
async fn follow_writes(client: Client, writes: Arc<Mutex<Writes>>) {
    let mut written = std::pin::pin!(client.writes_of_claims().await.unwrap());
    while let Some(claim) = written.next().await {
        writes.lock().unwrap().take(&claim);
    }
}

/// The run.
struct Storm<'o> {
    options: &'o Options,
    random: ChaCha8Rng,
    server: Server,
    client: Client,
    cells: Cells,
    changes: Changes,
    seen: Seen,
    writes: Arc<Mutex<Writes>>,
    killed: usize,
    server_killed: usize,
    /// One node of several has gone.
    away: bool,
    /// After each return of the server, until the last cell was back, s.
    backs_s: Vec<f64>,
}

async fn storm(options: &Options) -> bool {
    let server = Server::start(&options.nats, options.sync_always, options.nodes);
    let client = connect(&server).await;
    // Before the cells come all at once.
    let changes = client.changes(0).await.unwrap();
    let mut storm = Storm {
        options,
        random: ChaCha8Rng::seed_from_u64(options.seed),
        cells: Cells::start(options.cells, &server, options.takes_ms),
        changes,
        server,
        client,
        seen: Seen::default(),
        writes: Arc::default(),
        killed: 0,
        server_killed: 0,
        away: false,
        backs_s: Vec::new(),
    };
    while storm.seen.shown_unix_s.len() < options.cells {
        storm.change().await;
    }
    println!("{} cells are there; submitting {} jobs", options.cells, options.jobs);
    let begun = Instant::now();
    tokio::spawn(follow_writes(connect(&storm.server).await, storm.writes.clone()));
    let submitting = tokio::spawn(submit(connect(&storm.server).await, options.jobs, options.pace_ms));
    let (mut before, mut at) = (0, Instant::now());
    // With how many had ended after it.
    let (mut first_s, mut longest_pause) = (0.0, (Duration::ZERO, 0));
    while storm.seen.over < options.jobs && begun.elapsed() < MOST {
        storm.change().await;
        let over = storm.seen.over;
        if over > before {
            if before == 0 {
                first_s = at.elapsed().as_secs_f64();
            } else {
                longest_pause = longest_pause.max((at.elapsed(), over));
            }
            if over / 1000 > before / 1000 {
                println!("{over} over after {:.0} s", begun.elapsed().as_secs_f64());
            }
            (before, at) = (over, Instant::now());
        }
        storm.disturbance(over).await;
    }
    let new = submitting.await.unwrap();
    let (seconds, over) = (begun.elapsed().as_secs_f64(), storm.seen.over);
    let (killed, server_killed) = (storm.killed, storm.server_killed);
    println!("submitted {new}, ended {over}, in {seconds:.0} s");
    println!("{killed} kills of cells, {server_killed} of the server");
    let (pause, ended_it) = longest_pause;
    println!("the first job ended after {first_s:.2} s");
    println!(
        "longest pause between two jobs that ended: {:.2} s, before job {ended_it}",
        pause.as_secs_f64()
    );
    storm.verdict()
}

impl Storm<'_> {
    /// The next change. A watch that has ended is begun again; the claims come once more, which does no
    /// harm.
    async fn change(&mut self) {
        match tokio::time::timeout(Duration::from_secs(10), self.changes.next()).await {
            Ok(Some(Change::Ended(_)) | None) | Err(_) => self.follow_again().await,
            Ok(Some(change)) => self.seen.take(change),
        }
    }

    async fn follow_again(&mut self) {
        if let Ok(again) = self.client.changes(0).await {
            self.changes = again;
        }
    }

    /// What is due when so many jobs are over: evenly over the jobs, whatever the speed.
    async fn disturbance(&mut self, over: usize) {
        let Options { jobs, kills, server_kills, nodes, cells, .. } = *self.options;
        let due = |done: usize, all: usize| {
            done < all && over >= (done + 1) * jobs.checked_div(all + 1).unwrap_or(usize::MAX).max(1)
        };
        if nodes > 1 && !self.away && over >= jobs / 2 {
            println!("one of {nodes} nodes goes away");
            self.server.kill(0);
            self.away = true;
        }
        if due(self.killed, kills) {
            self.cells.kill(self.random.random_range(0..cells));
            self.killed += 1;
        }
        if due(self.server_killed, server_kills) {
            self.server.kill(0);
            sleep(Duration::from_millis(self.random.random_range(0..3000))).await;
            self.server.up(0);
            self.server_killed += 1;
            let back_s = self.back().await;
            self.backs_s.push(back_s);
        }
    }

    /// How long after the server's return the last cell has shown itself, s.
    async fn back(&mut self) -> f64 {
        let (returned, begun) = (now_s(), Instant::now());
        while begun.elapsed() < Duration::from_secs(60) {
            let shown = self.client.cells().await.unwrap_or_default();
            if shown.len() == self.options.cells && shown.iter().all(|cell| cell.unix_s >= returned) {
                let last = begun.elapsed().as_secs_f64();
                self.follow_again().await;
                return last;
            }
            sleep(Duration::from_millis(50)).await;
        }
        f64::INFINITY
    }

    /// What the cells' own disks say, against what was submitted.
    fn verdict(mut self) -> bool {
        self.backs_s.sort_by(f64::total_cmp);
        if let (Some(median), Some(longest)) = (self.backs_s.get(self.backs_s.len() / 2), self.backs_s.last())
        {
            println!(
                "all cells back after the server's return: median {median:.2} s, longest {longest:.2} s"
            );
        }
        let mut carried_out: BTreeMap<String, usize> = BTreeMap::new();
        for number in 0..self.options.cells {
            for job in cell::carried_out(&self.cells.place(number)) {
                *carried_out.entry(job).or_default() += 1;
            }
        }
        let (mut done, mut moves) = (0, 0);
        for number in 0..self.options.cells {
            let of_cell = cell::done(&self.cells.place(number));
            (done, moves) = (done + of_cell.0, moves + of_cell.1);
        }
        println!("{done} jobs done with {moves} moves; the others were interrupted by a kill");
        let is_lost = |number: &usize| !carried_out.contains_key(&format!("job-{number}"));
        let lost = (0..self.options.jobs).filter(is_lost).count();
        let twice = carried_out.values().filter(|count| **count > 1).count();
        let writes = self.writes.lock().unwrap();
        let by_two = writes.begun_by.values().filter(|cells| cells.len() > 1).count();
        println!("lost {lost}, carried out twice {twice}, begun by a second cell {by_two}");
        let mut after: Vec<(f64, &String)> =
            writes.claimed_after_s.iter().map(|(job, s)| (*s, job)).collect();
        after.sort_by(|a, b| a.0.total_cmp(&b.0));
        let at =
            |share: f64| after.get((after.len() as f64 * share) as usize).map_or(f64::NAN, |(s, _)| s * 1e3);
        println!("submitted to claimed: median {:.1} ms, p99 {:.1} ms", at(0.5), at(0.99));
        let slowest = after.iter().rev().take(5).map(|(s, job)| format!("{job} {:.0} ms", s * 1e3));
        println!("the slowest: {}", slowest.collect::<Vec<_>>().join(", "));
        lost + twice + by_two == 0
    }
}

async fn connect(server: &Server) -> Client {
    let access = Access {
        servers: server.addresses(),
        credentials: None,
        authority: None,
        tls: false,
        domain: None,
        name: "storm".to_string(),
    };
    let storage = Storage { replicas: server.replicas(), ..Storage::USUAL };
    // A cluster elects who leads it first.
    for _ in 0..100 {
        if let Ok(client) = Client::open(&access, Fleet::new(FLEET).unwrap(), "storm", storage).await {
            return client;
        }
        sleep(Duration::from_millis(300)).await;
    }
    Client::open(&access, Fleet::new(FLEET).unwrap(), "storm", storage).await.unwrap()
}

/// Submits all jobs, so many at once at most, each again until the server has taken it.
async fn submit(client: Client, jobs: usize, pace_ms: u64) -> usize {
    let (client, places) = (Arc::new(client), Arc::new(Semaphore::new(AT_ONCE)));
    let mut submitting = JoinSet::new();
    for number in 0..jobs {
        sleep(Duration::from_millis(pace_ms)).await;
        let place = places.clone().acquire_owned().await.unwrap();
        // Each a task of its own: one that waits keeps no other one waiting.
        let client = client.clone();
        submitting.spawn(async move {
            submit_one(&client, number).await;
            drop(place);
        });
    }
    submitting.join_all().await.len()
}

async fn submit_one(client: &Client, number: usize) {
    let lane = Lane { priority: Priority::Normal, target: Target::any() };
    let id = format!("job-{number}");
    let mut job = Job::new(&id, &format!("version: 1\nid: {id}\n"), now_s());
    loop {
        match client.submit(&job, &lane).await {
            Ok(_) => return,
            // Taken before, and the answer was lost.
            Err(message) if message.contains("was submitted before") => return,
            Err(_) => sleep(Duration::from_millis(200)).await,
        }
        job.submitted_unix_s = now_s();
    }
}
