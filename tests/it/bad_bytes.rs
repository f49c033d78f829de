//! Bytes that no client should send, to every server of the simulator: the fuzzers' corpora, and over real
//! sockets garbage, slices, lengths that lie, and clients that never read. Afterwards a healthy client is
//! served.

#![expect(clippy::unwrap_used, reason = "a test that unwraps is a test that fails loudly")]

use crate::robot_session::config;
use rand::{RngExt, SeedableRng};
use std::fs::File;
use std::io::Read;
use std::net::SocketAddr;
use std::path::Path;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use ur_sim::box_clients::SecondClient;
use ur_sim::cell::{RunningSim, start};

#[allow(dead_code, reason = "the fuzzers' binaries use more of it")]
#[path = "../../fuzz/targets.rs"]
mod targets;

/// Longest the test waits for a healthy client's answer.
const PATIENCE: Duration = Duration::from_secs(60);

#[test]
fn the_fuzzers_corpora_are_survived() {
    for (name, target) in targets::TARGETS {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("fuzz/corpus/{name}.tar.gz"));
        let file = File::open(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let mut corpus = tar::Archive::new(flate2::read::GzDecoder::new(file));
        let mut count = 0;
        for entry in corpus.entries().unwrap() {
            let mut entry = entry.unwrap();
            let mut bytes = Vec::new();
            entry.read_to_end(&mut bytes).unwrap();
            if std::panic::catch_unwind(|| target(&bytes)).is_err() {
                panic!("{name} fails on {} of {}", entry.path().unwrap().display(), path.display());
            }
            count += 1;
        }
        assert!(count > 2, "{name} has no corpus");
    }
}

/// Every server of a cell, by what a healthy client requests there and how the answer has to begin.
fn servers(sim: &RunningSim) -> Vec<(&'static str, SocketAddr, Vec<u8>, Vec<u8>)> {
    let robot = &sim.addresses.robot;
    let [primary, secondary, realtime] = robot.read_only;
    let version: &[u8] = &[0, 0, 0];
    let block: &[u8] = &1220i32.to_be_bytes();
    let read = [0, 1, 0, 0, 0, 6, 65, 3, 0, 2, 0, 1];
    let http =
        |path: &str| format!("GET {path} HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n").into_bytes();
    let ok: &[u8] = b"HTTP/1.1 200";
    let mut servers = vec![
        ("dashboard", robot.dashboard, b"quit\n".to_vec(), b"Connected: Universal Robots".to_vec()),
        ("rtde", robot.rtde, vec![0, 5, b'V', 0, 2], vec![0, 4, b'V', 1]),
        ("gripper", sim.addresses.modbus, read.to_vec(), vec![0, 1, 0, 0, 0, 5, 65, 3, 2, 1, 0xf4]),
        ("camera", sim.addresses.camera, http("/intrinsics.json"), ok.to_vec()),
        ("control", sim.addresses.control.unwrap(), http("/world.json"), ok.to_vec()),
    ];
    for (name, address) in [("primary", robot.primary), ("secondary", robot.secondary)] {
        servers.push((name, address, Vec::new(), version.to_vec()));
    }
    for (name, address) in [("read-only primary", primary), ("read-only secondary", secondary)] {
        servers.push((name, address, Vec::new(), version.to_vec()));
    }
    for (name, address) in [("real-time", robot.realtime), ("read-only real-time", realtime)] {
        servers.push((name, address, Vec::new(), block.to_vec()));
    }
    servers
}

/// What is thrown at a server: garbage, lengths that lie, lines and programs without an end, a request in
/// slices.
fn nonsense(request: &[u8], rng: &mut impl RngExt) -> Vec<Vec<u8>> {
    let mut all: Vec<Vec<u8>> =
        (0..6).map(|_| (0..rng.random_range(1..3000)).map(|_| rng.random::<u8>()).collect()).collect();
    all.push(vec![0xff; 70_000]);
    all.push(vec![0; 5000]);
    all.push(b"def a():\n".repeat(2000));
    all.push([b"GET /".as_slice(), &[b'a'; 20_000]].concat());
    all.push([&[0xff, 0xff, b'U'], [7; 100].as_slice()].concat());
    all.push([&[0, 1, 0, 0, 0xff, 0xff, 65], [3; 100].as_slice()].concat());
    all.extend(request.iter().map(|byte| vec![*byte]));
    all
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_port_survives_bad_clients_and_serves_a_good_one() {
    let mut config = config(true);
    config.control_port = Some(0);
    // A client that never reads would keep the only place there.
    config.world.gripper.clients.second = SecondClient::Evicts;
    let sim = start(config).await.unwrap();
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(7);
    let mut silent = Vec::new();
    for (name, address, request, _) in servers(&sim) {
        // A client that requests everything and never reads.
        let mut lazy = TcpStream::connect(address).await.unwrap();
        let many = request.repeat(2000);
        let _ = tokio::time::timeout(Duration::from_millis(200), lazy.write_all(&many)).await;
        silent.push((name, lazy));
        for bytes in nonsense(&request, &mut rng) {
            let mut stream = TcpStream::connect(address).await.unwrap();
            for piece in bytes.chunks(1500) {
                // The server may have closed on the first nonsense already, or stopped reading.
                let _ = tokio::time::timeout(Duration::from_millis(50), stream.write_all(piece)).await;
            }
        }
    }
    for (name, address, request, expected) in servers(&sim) {
        let served = async {
            loop {
                // The bad clients' connections are counted until the server has seen their end.
                let mut stream = TcpStream::connect(address).await.unwrap();
                let _ = stream.write_all(&request).await;
                let mut answer = vec![0; expected.len()];
                if stream.read_exact(&mut answer).await.is_ok() {
                    return answer;
                }
            }
        };
        let answer =
            tokio::time::timeout(PATIENCE, served).await.unwrap_or_else(|_| panic!("{name} is silent"));
        assert_eq!(answer, expected, "{name}");
    }
    let step = sim.robot().controller().core.step;
    assert!(step > 0 && !silent.is_empty());
    sim.shutdown().await;
}
