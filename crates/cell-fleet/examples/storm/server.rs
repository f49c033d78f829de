//! The NATS server of the storm, on a port that stays.
//!
//! In: its program. Out: a process that is killed as by a power cut and started again on the same disk.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

pub struct Server {
    program: PathBuf,
    folder: tempfile::TempDir,
    port: u16,
    child: Option<Child>,
}

impl Server {
    pub fn start(program: &Path, sync_always: bool) -> Server {
        let folder = tempfile::tempdir().unwrap();
        // A port that is free now; the server gets it again after each kill.
        let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let sync = if sync_always { ", sync_interval: always" } else { "" };
        let store = folder.path().join("store");
        let text =
            format!("listen: \"127.0.0.1:{port}\"\njetstream {{store_dir: \"{}\"{sync}}}\n", store.display());
        std::fs::write(folder.path().join("nats.conf"), text).unwrap();
        let mut server = Server { program: program.to_owned(), folder, port, child: None };
        server.up();
        server
    }

    pub fn address(&self) -> String {
        format!("nats://127.0.0.1:{}", self.port)
    }

    /// Returns once it takes connections.
    pub fn up(&mut self) {
        let mut command = Command::new(&self.program);
        command.arg("-c").arg(self.folder.path().join("nats.conf"));
        self.child = Some(command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap());
        while std::net::TcpStream::connect(("127.0.0.1", self.port)).is_err() {
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    pub fn kill(&mut self) {
        if let Some(mut child) = self.child.take() {
            child.kill().unwrap();
            child.wait().unwrap();
        }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.kill();
    }
}
