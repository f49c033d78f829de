//! The NATS servers of the storm, on ports that stay: one, or the nodes of a cluster.
//!
//! In: their program. Out: processes that are killed as by a power cut and started again on the same disks.

use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

struct Node {
    port: u16,
    child: Option<Child>,
}

pub struct Server {
    program: PathBuf,
    folder: tempfile::TempDir,
    nodes: Vec<Node>,
}

/// A port that is free now; a node gets it again after each kill.
fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

impl Server {
    pub fn start(program: &Path, sync_always: bool, nodes: usize) -> Server {
        let folder = tempfile::tempdir().unwrap();
        let routes: Vec<u16> = (0..nodes).map(|_| free_port()).collect();
        let sync = if sync_always { ", sync_interval: always" } else { "" };
        let mut server = Server { program: program.to_owned(), folder, nodes: Vec::new() };
        for (number, route) in routes.iter().enumerate() {
            let port = free_port();
            let store = server.folder.path().join(format!("store-{number}"));
            let mut text = format!(
                "server_name: \"n{number}\"\nlisten: \"127.0.0.1:{port}\"\njetstream {{store_dir: \"{}\", \
                 max_file_store: 10GB{sync}}}\n",
                store.display()
            );
            if nodes > 1 {
                let all: Vec<String> =
                    routes.iter().map(|route| format!("\"nats-route://127.0.0.1:{route}\"")).collect();
                text.push_str(&format!(
                    "cluster {{name: storm, listen: \"127.0.0.1:{route}\", routes: [{}]}}\n",
                    all.join(", ")
                ));
            }
            std::fs::write(server.folder.path().join(format!("n{number}.conf")), text).unwrap();
            server.nodes.push(Node { port, child: None });
        }
        (0..nodes).for_each(|node| server.up(node));
        server
    }

    pub fn addresses(&self) -> Vec<String> {
        self.nodes.iter().map(|node| format!("nats://127.0.0.1:{}", node.port)).collect()
    }

    /// Nodes that hold each message.
    pub fn replicas(&self) -> usize {
        self.nodes.len()
    }

    /// Returns once the node takes connections.
    pub fn up(&mut self, node: usize) {
        let mut command = Command::new(&self.program);
        command.arg("-c").arg(self.folder.path().join(format!("n{node}.conf")));
        let node = &mut self.nodes[node];
        node.child = Some(command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap());
        while std::net::TcpStream::connect(("127.0.0.1", node.port)).is_err() {
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    pub fn kill(&mut self, node: usize) {
        if let Some(mut child) = self.nodes[node].child.take() {
            child.kill().unwrap();
            child.wait().unwrap();
        }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        (0..self.nodes.len()).for_each(|node| self.kill(node));
    }
}
