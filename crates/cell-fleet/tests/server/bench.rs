//! A real NATS server, and cells whose arm is a clock: what the tests with the server stand on.
//!
//! In: the program that `CELLD_NATS_SERVER` names. Out: a server that can be killed and started again on the
//! same port and folder; cells on their own threads, which can be ended at any moment and go on from their
//! disk.

use cell_fleet::client::Client;
use cell_fleet::connect::{Access, Credentials};
use cell_fleet::files::{Content, FileKind, FileToSend};
use cell_fleet::fragments::Wanted;
use cell_fleet::payloads::{CellState, Job, Outcome, What};
use cell_fleet::run::run;
use cell_fleet::server::Storage;
use cell_fleet::side::{CellEvent, CellSide, FilesRequested, FragmentState, Ordered, Settings};
use cell_fleet::store::Limits;
use cell_fleet::subjects::{Fleet, RequestKind};
use cell_fleet::values::Local;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use tokio::sync::oneshot;

/// For what takes long on a busy computer.
pub const PATIENCE: Duration = Duration::from_secs(120);

/// The server's program; `None` skips a test, and says so.
pub fn program() -> Option<PathBuf> {
    let path = std::env::var_os("CELLD_NATS_SERVER").map(PathBuf::from);
    if path.is_none() {
        eprintln!("SKIPPED: CELLD_NATS_SERVER names no nats-server; `make test-fleet` installs one");
    }
    path
}

/// Waits until something holds.
#[track_caller]
pub fn until(what: &str, mut holds: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !holds() {
        assert!(begun.elapsed() < PATIENCE, "{what}: not within {PATIENCE:?}");
        std::thread::park_timeout(Duration::from_millis(200));
    }
}

/// A server with its folder.
pub struct Server {
    program: PathBuf,
    folder: tempfile::TempDir,
    config: String,
    child: Option<Child>,
    pub port: u16,
}

impl Server {
    /// Starts one; `config` is added to its configuration, in which `STORE` stands for its folder.
    pub fn start(program: &Path, config: &str) -> Server {
        let folder = tempfile::tempdir().unwrap();
        let config = config.replace("STORE", &folder.path().join("store").display().to_string());
        let mut server = Server { program: program.to_owned(), folder, config, child: None, port: 0 };
        server.up();
        server
    }

    /// A server with JetStream that writes every message to the disk before it answers. Its room is a
    /// number, since what a server takes of itself is a share of what this computer's disk has left.
    pub fn usual(program: &Path) -> Server {
        Server::start(
            program,
            "jetstream {store_dir: \"STORE\", max_file_store: 10GB, sync_interval: always}",
        )
    }

    pub fn up(&mut self) {
        let file = self.folder.path().join("nats.conf");
        let port = if self.port == 0 { -1 } else { i32::from(self.port) };
        let ports = self.folder.path().join("ports");
        std::fs::create_dir_all(&ports).unwrap();
        for entry in std::fs::read_dir(&ports).unwrap().flatten() {
            std::fs::remove_file(entry.path()).unwrap();
        }
        let text = format!(
            "listen: \"127.0.0.1:{port}\"\nports_file_dir: \"{}\"\n{}\n",
            ports.display(),
            self.config
        );
        std::fs::write(&file, text).unwrap();
        let mut command = Command::new(&self.program);
        command.arg("-c").arg(&file).stdout(Stdio::null()).stderr(Stdio::null());
        self.child = Some(command.spawn().unwrap());
        let mut found = 0;
        until("the server's ports", || {
            let mut files = std::fs::read_dir(&ports).unwrap().flatten();
            let text = files.find_map(|entry| std::fs::read_to_string(entry.path()).ok()).unwrap_or_default();
            let ports: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
            let address = ports["nats"][0].as_str().unwrap_or_default().to_string();
            found = address.rsplit(':').next().and_then(|port| port.parse().ok()).unwrap_or(0);
            found != 0
        });
        self.port = found;
    }

    /// Ends it as a power cut would.
    pub fn kill(&mut self) {
        if let Some(mut child) = self.child.take() {
            child.kill().unwrap();
            child.wait().unwrap();
        }
    }

    /// A server of the same address that has lost its disk.
    pub fn wipe(&mut self) {
        self.kill();
        // Without JetStream there is none.
        let _ = std::fs::remove_dir_all(self.folder.path().join("store"));
        self.up();
    }

    pub fn address(&self) -> String {
        format!("nats://127.0.0.1:{}", self.port)
    }

    pub fn access(&self, credentials: Option<Credentials>) -> Access {
        Access {
            servers: vec![self.address()],
            credentials,
            authority: None,
            tls: false,
            domain: None,
            name: "test".to_string(),
        }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.kill();
    }
}

pub fn fleet() -> Fleet {
    Fleet::new("test").unwrap()
}

/// Small, so that a server on any disk makes them.
pub const STORAGE: Storage =
    Storage { replicas: 1, jobs_bytes: 16 << 20, events_bytes: 16 << 20, claims_bytes: 16 << 20 };

/// A person at a terminal.
pub async fn client(server: &Server, user: &str) -> Client {
    Client::open(&server.access(None), fleet(), user, STORAGE).await.unwrap()
}

/// What of a cell survives the end of its process.
#[derive(Default)]
pub struct Disk {
    /// Jobs with the time they take, and their end.
    journal: BTreeMap<String, (Instant, Option<Outcome>)>,
    /// How often the arm set out for a job.
    pub carried_out: BTreeMap<String, u32>,
    /// What it was ordered.
    pub ordered: Vec<(RequestKind, String, Option<u64>, String)>,
    /// What it complained of last.
    pub complaints: Vec<String>,
    /// Faults of its own, to be reported.
    pub announced: Vec<String>,
    pub disarmed: bool,
    /// The shared configuration that it should run with, as it was last: absent, none, or a text.
    pub wanted: Option<Option<String>>,
    /// Bytes of each file of its jobs.
    pub file: Vec<u8>,
}

struct Side {
    disk: Arc<Mutex<Disk>>,
    takes: Duration,
    /// Jobs whose id begins so are refused.
    refuses: String,
}

impl CellSide for Side {
    fn state(&mut self) -> CellState {
        let mut disk = self.disk.lock().unwrap();
        let now = Instant::now();
        for (over, end) in disk.journal.values_mut() {
            if *over <= now && end.is_none() {
                *end = Some(Outcome { status: "done".into(), moves: 2, ..Outcome::default() });
            }
        }
        let idle = disk.journal.values().all(|(_, end)| end.is_some());
        CellState { armed: !disk.disarmed, idle, state: "idle".into(), ..CellState::default() }
    }

    fn events(&mut self) -> Vec<CellEvent> {
        let announced = std::mem::take(&mut self.disk.lock().unwrap().announced);
        let unix_s = std::time::SystemTime::UNIX_EPOCH.elapsed().unwrap().as_secs_f64();
        announced
            .into_iter()
            .map(|message| CellEvent { job: None, what: What::Fault { code: "t".into(), message }, unix_s })
            .collect()
    }

    fn judge(&mut self, job: &Job) -> Result<(), String> {
        let refused = !self.refuses.is_empty() && job.id.starts_with(&self.refuses);
        if refused { Err("no such object here".to_string()) } else { Ok(()) }
    }

    fn hand_in(&mut self, job: &Job) -> Result<(), String> {
        let over = Instant::now() + self.takes;
        let mut disk = self.disk.lock().unwrap();
        if !disk.journal.contains_key(&job.id) {
            disk.journal.insert(job.id.clone(), (over, None));
            *disk.carried_out.entry(job.id.clone()).or_default() += 1;
        }
        Ok(())
    }

    fn look(&mut self, job: &str) -> Result<Local, String> {
        Ok(match self.disk.lock().unwrap().journal.get(job) {
            None => Local::Unknown,
            Some((_, None)) => Local::Open,
            Some((_, Some(outcome))) => Local::Ended(outcome.clone()),
        })
    }

    fn order(&mut self, requested: RequestKind, job: &str, plan: Option<u64>, by: &str) -> Ordered {
        let (answer, answered) = oneshot::channel();
        self.disk.lock().unwrap().ordered.push((requested, job.to_string(), plan, by.to_string()));
        let _ = answer.send((true, "agreed".to_string()));
        answered
    }

    fn files(&mut self, job: &str, kinds: &[FileKind]) -> FilesRequested {
        let (answer, answered) = oneshot::channel();
        let disk = self.disk.lock().unwrap();
        let file = |kind: &FileKind| FileToSend {
            name: format!("{}.bin", kind.as_str()),
            content: Content::Bytes(disk.file.clone()),
        };
        let known = disk.journal.contains_key(job);
        let files = if known { Ok(kinds.iter().map(file).collect()) } else { Err("no such job".to_string()) };
        let _ = answer.send(files);
        answered
    }

    fn fragment(&mut self, wanted: Option<Wanted<'_>>) -> FragmentState {
        let text = wanted.map(|wanted| match wanted {
            Wanted::This(published) => Some(published.fragment.text.clone()),
            Wanted::None => None,
        });
        let runs = match wanted {
            Some(Wanted::This(published)) => Some(published.revision),
            Some(Wanted::None) | None => None,
        };
        self.disk.lock().unwrap().wanted = text;
        FragmentState { runs, ..FragmentState::default() }
    }

    fn complaints(&mut self, complaints: &[String]) {
        self.disk.lock().unwrap().complaints = complaints.to_vec();
    }
}

/// A cell that can be ended and started again.
pub struct Cell {
    pub name: String,
    folder: tempfile::TempDir,
    pub disk: Arc<Mutex<Disk>>,
    access: Access,
    takes: Duration,
    pub refuses: String,
    pub fleet: Fleet,
    running: Option<(Arc<AtomicBool>, oneshot::Sender<()>, JoinHandle<()>)>,
}

impl Cell {
    pub fn new(name: &str, access: Access, takes_ms: u64) -> Cell {
        let folder = tempfile::tempdir().unwrap();
        let (disk, takes) = (Arc::default(), Duration::from_millis(takes_ms));
        let name = name.to_string();
        Cell { name, folder, disk, access, takes, refuses: String::new(), fleet: fleet(), running: None }
    }

    pub fn up(&mut self) {
        let settings = Settings {
            fleet: self.fleet.clone(),
            cell: self.name.clone(),
            labels: vec!["line".to_string()],
            access: self.access.clone(),
            storage: STORAGE,
            database: self.folder.path().join("fleet.sqlite"),
            series: "s".to_string(),
            limits: Limits::USUAL,
        };
        let (disk, refuses) = (self.disk.clone(), self.refuses.clone());
        let side = Side { disk, takes: self.takes, refuses };
        let stop = Arc::new(AtomicBool::new(false));
        let (kill, killed) = oneshot::channel();
        let stopped = stop.clone();
        let thread = std::thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build();
            runtime.unwrap().block_on(async {
                tokio::select! {
                    () = run(settings, Box::new(side), stopped) => {}
                    _ = killed => {}
                }
            });
        });
        self.running = Some((stop, kill, thread));
    }

    /// Ends it at whatever it does; only its disk goes on.
    pub fn kill(&mut self) {
        if let Some((_, kill, thread)) = self.running.take() {
            let _ = kill.send(());
            thread.join().unwrap();
        }
    }

    pub fn complains_of(&self, words: &str) -> bool {
        self.disk.lock().unwrap().complaints.iter().any(|complaint| complaint.contains(words))
    }
}

impl Drop for Cell {
    fn drop(&mut self) {
        if let Some((stop, ..)) = &self.running {
            stop.store(true, Ordering::Relaxed);
        }
        if !std::thread::panicking() {
            self.kill();
        }
    }
}
