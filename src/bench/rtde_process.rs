//! The simulator as a process of its own, watched from outside: start, processor time, memory.
//!
//! In: the program and its configuration. Out: a running `celld sim` that ends with the value, and what the
//! system counts for it (Linux: `/proc`).

use crate::bench::rtde_client::{PATIENCE, RTDE};
use std::io::{BufRead, BufReader};
use std::net::{IpAddr, SocketAddr, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// A running simulator.
pub struct Simulator {
    child: Child,
    /// From the start of the process to the first connection that was accepted, ms.
    pub start_ms: f64,
    control: String,
}

impl Simulator {
    /// Starts one and waits until it accepts connections.
    ///
    /// # Errors
    /// It cannot be started, or does not come up.
    pub fn start(program: &Path, config: &Path, host: IpAddr, factor: f64) -> Result<Simulator, String> {
        let mut command = Command::new(program);
        if program.file_stem().is_none_or(|name| name != "celld-sim") {
            command.arg("sim");
        }
        command.arg("--config").arg(config).arg("--control");
        command.args(["--bind", &host.to_string(), "--time-factor", &factor.to_string()]);
        command.stdout(Stdio::piped()).stderr(Stdio::null());
        let began = Instant::now();
        let child = command.spawn().map_err(|error| format!("{}: {error}", program.display()))?;
        let mut simulator = Simulator { child, start_ms: 0.0, control: String::new() };
        while TcpStream::connect(SocketAddr::new(host, RTDE)).is_err() {
            let ended = simulator.child.try_wait().ok().flatten();
            if let Some(status) = ended {
                return Err(format!(
                    "the simulator ended with {status}; try `celld sim` with the same options"
                ));
            }
            if began.elapsed() > PATIENCE {
                return Err("the simulator accepts no connection".to_owned());
            }
            std::thread::sleep(Duration::from_micros(200));
        }
        simulator.start_ms = began.elapsed().as_secs_f64() * 1e3;
        simulator.control = simulator.ready_line()?;
        Ok(simulator)
    }

    fn ready_line(&mut self) -> Result<String, String> {
        let mut line = String::new();
        if let Some(stdout) = self.child.stdout.as_mut() {
            BufReader::new(stdout).read_line(&mut line).map_err(|error| error.to_string())?;
        }
        let ready: serde_json::Value = serde_json::from_str(&line).map_err(|error| error.to_string())?;
        let control = ready["control"].as_str().ok_or("the simulator has no control server")?;
        Ok(format!("http://{control}"))
    }

    /// What the simulator has recorded about its own sending.
    ///
    /// # Errors
    /// The control server does not answer.
    pub fn timing(&self) -> Result<serde_json::Value, String> {
        let mut reply =
            ureq::get(format!("{}/timing.json", self.control)).call().map_err(|e| e.to_string())?;
        let text = reply.body_mut().read_to_string().map_err(|error| error.to_string())?;
        serde_json::from_str(&text).map_err(|error| error.to_string())
    }

    /// Processor time of all its threads that are alive, s.
    pub fn cpu_seconds(&self) -> f64 {
        let tasks = std::fs::read_dir(format!("/proc/{}/task", self.child.id()));
        let threads = tasks.into_iter().flatten().flatten();
        let nanoseconds = threads.filter_map(|thread| {
            let text = std::fs::read_to_string(thread.path().join("schedstat")).ok()?;
            text.split_whitespace().next()?.parse::<f64>().ok()
        });
        nanoseconds.sum::<f64>() * 1e-9
    }

    /// Resident memory, MB; `None` where the system does not report it.
    pub fn resident_mb(&self) -> Option<f64> {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).ok()?;
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
        Some(line.trim().strip_suffix("kB")?.trim().parse::<f64>().ok()? * 1024e-6)
    }
}

impl Drop for Simulator {
    fn drop(&mut self) {
        // It keeps nothing that a kill could spoil.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
