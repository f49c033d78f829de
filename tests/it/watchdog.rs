//! The service manager's view of the daemon, on a socket of this test's own: it learns when the daemon is
//! ready and what it does, gets signs of life while every task answers, and none while one hangs.
//!
//! A library put before libc's holds one call of the loop up for as long as a file is there: the process
//! runs on, its other threads too, only the loop does not.

use crate::cell::{
    CELLD, LOG, configuration, copy_calibration, preloaded, start_daemon_with, start_strict_sim, wait_until,
};
use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::path::Path;
use std::process::Command;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Before libc: what is sent to the controller waits while a file is there.
const HANGS: &str = r#"
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <unistd.h>

static int to_controller(int socket) {
    struct sockaddr_in peer;
    socklen_t size = sizeof peer;
    return getpeername(socket, (struct sockaddr *)&peer, &size) == 0 && peer.sin_family == AF_INET
        && ntohs(peer.sin_port) >= 29999 && ntohs(peer.sin_port) <= 30004;
}

ssize_t send(int socket, const void *bytes, size_t size, int flags) {
    while (to_controller(socket) && access(getenv("HANGS_WHILE"), F_OK) == 0) usleep(1000);
    return syscall(SYS_sendto, socket, bytes, size, flags, NULL, 0);
}
"#;

/// What was sent to the service manager so far.
#[derive(Clone)]
struct Manager(Arc<Mutex<Vec<String>>>);

impl Manager {
    fn at(address: &SocketAddr) -> Manager {
        let socket = UnixDatagram::bind_addr(address).expect("a socket");
        let manager = Manager(Arc::default());
        let messages = Arc::clone(&manager.0);
        std::thread::spawn(move || {
            let mut buffer = [0; 4096];
            while let Ok(size) = socket.recv(&mut buffer) {
                let text = String::from_utf8_lossy(&buffer[..size]).into_owned();
                messages.lock().expect("unpoisoned").extend(text.lines().map(str::to_string));
            }
        });
        manager
    }

    fn count(&self, message: &str) -> usize {
        self.0.lock().expect("unpoisoned").iter().filter(|line| line.starts_with(message)).count()
    }

    fn waits_for(&self, message: &str) {
        let before = self.count(message);
        wait_until(message, || self.count(message) > before);
    }
}

/// A daemon runs, by its lock.
fn runs(folder: &Path) -> bool {
    let status = Command::new(CELLD).arg("status").current_dir(folder).output().expect("the binary runs");
    status.status.code() == Some(0)
}

#[test]
fn cell_feeds_the_watchdog_only_while_every_task_answers() {
    let folder = tempfile::tempdir().expect("a folder");
    let (cell, sim) = configuration(folder.path(), "127.7.6.10", 1);
    copy_calibration(folder.path());
    let (socket, hangs) = (folder.path().join("notify"), folder.path().join("hang"));
    let manager = Manager::at(&SocketAddr::from_pathname(&socket).expect("a short path"));
    let library = preloaded(folder.path(), HANGS);
    let environment = [
        ("NOTIFY_SOCKET", socket.as_path()),
        ("WATCHDOG_USEC", Path::new("600000")),
        ("LD_PRELOAD", library.as_path()),
        ("HANGS_WHILE", hangs.as_path()),
    ];
    let daemon = start_daemon_with(folder.path(), &cell, &environment);
    // The robot is not even there, and the daemon is well: it waits.
    wait_until("it is ready", || manager.count("READY=1") == 1);
    wait_until("it says what it waits for", || manager.count("STATUS=waiting for the robot") > 0);
    manager.waits_for("WATCHDOG=1");

    let _sim = start_strict_sim(&sim);
    wait_until("it says what it does", || manager.count("STATUS=idle (disarmed)") > 0);
    manager.waits_for("WATCHDOG=1");

    std::fs::write(&hangs, "").expect("written");
    let log = || std::fs::read_to_string(folder.path().join(LOG)).expect("what the daemon says");
    wait_until("the loop is missed", || log().contains("the loop has not answered for"));
    // What was on its way when the loop was found late; then nothing for many times the period of 200 ms,
    // while process and lock are there all the while.
    assert!(runs(folder.path()) && runs(folder.path()));
    let (fed, since) = (manager.count("WATCHDOG=1"), Instant::now());
    while since.elapsed() < Duration::from_secs(1) {
        assert!(runs(folder.path()));
    }
    assert_eq!(manager.count("WATCHDOG=1"), fed, "no sign of life while the loop hangs");

    std::fs::remove_file(&hangs).expect("removed");
    wait_until("the loop answers", || log().contains("the loop answers again"));
    manager.waits_for("WATCHDOG=1");
    let ended = Command::new("sh").args(["-c", &format!("kill -TERM {}", daemon.0.id())]).status();
    assert!(ended.expect("sh").success());
    wait_until("it says that it ends", || manager.count("STOPPING=1") == 1);
}

#[test]
fn cell_reports_to_a_service_manager_with_an_abstract_socket() {
    let folder = tempfile::tempdir().expect("a folder");
    let (cell, _) = configuration(folder.path(), "127.7.6.11", 1);
    copy_calibration(folder.path());
    let name = format!("celld-watchdog-{}", std::process::id());
    let manager = Manager::at(&SocketAddr::from_abstract_name(&name).expect("a name"));
    let socket = format!("@{name}");
    let daemon = start_daemon_with(folder.path(), &cell, &[("NOTIFY_SOCKET", Path::new(&socket))]);
    wait_until("it is ready", || manager.count("READY=1") == 1);
    let ended = Command::new("sh").args(["-c", &format!("kill -TERM {}", daemon.0.id())]).status();
    assert!(ended.expect("sh").success());
    wait_until("it says that it ends", || manager.count("STOPPING=1") == 1);
}
