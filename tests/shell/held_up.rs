//! A process that is stopped, a log and a service manager that take nothing, signals that end.

use super::{Cell, request, terminate, thread_files};
use crate::cell::{CELLD, LOG, Running, wait_until};
use std::io::Write;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::process::{ChildStdin, Command, Stdio};
use std::time::Duration;

/// Ctrl-S (XOFF) suspends the output of a terminal, Ctrl-Q (XON) resumes it.
const CTRL_S: &[u8] = b"\x13";
const CTRL_Q: &[u8] = b"\x11";

/// Requests to the page that leave more lines of trace than the log's queue takes (4096): two each.
const REQUESTS: usize = 3000;

/// The daemon is stopped in the middle of a carry: disarmed afterwards, still there, and says so.
#[test]
fn cell_that_was_held_up_is_disarmed_stays_and_says_so() {
    let mut cell = Cell::start("127.7.9.4", &[]);
    cell.carry();
    cell.signal("STOP");
    // Long enough for every deadline of the robot; the arm stops by its program's own watchdog.
    wait_until("the arm rests", || cell.rests());
    std::thread::sleep(Duration::from_secs(16));
    cell.signal("CONT");
    let words = "celld was held up for ";
    // A busy computer may hold celld up for a moment before.
    let is_long = |rest: &str| rest.split(' ').next().and_then(|text| text.parse().ok()) >= Some(16.0);
    wait_until("it says so", || cell.log().split(words).skip(1).any(is_long));
    wait_until("the status says so", || !cell.armed());
    assert!(cell.daemon().try_wait().expect("a child").is_none(), "it stays: {}", cell.log());
    assert!(!cell.log().contains("check the disk"), "{}", cell.log());
    assert!(cell.holds(), "the object stays held");
}

/// A thread's scheduling is SCHED_FIFO (1), by its `stat` (proc(5)).
fn is_real_time(stat: &str) -> bool {
    stat.rsplit_once(") ").and_then(|(_, after)| after.split(' ').nth(38)) == Some("1")
}

/// So many threads of this process have real-time scheduling.
fn real_time_threads(process: u32) -> usize {
    thread_files(process, "stat").iter().filter(|stat| is_real_time(stat)).count()
}

/// The system gives this user's threads real-time scheduling.
fn may_have_real_time() -> bool {
    let tried = std::thread::spawn(|| {
        cell_edge::priority::real_time();
        std::fs::read_to_string("/proc/thread-self/stat").is_ok_and(|stat| is_real_time(&stat))
    });
    tried.join().expect("it ends")
}

/// The loop and the two readers of reported orders go before everything ordinary, also after a plan was
/// made; nothing else does.
#[test]
fn cell_keeps_real_time_for_the_loop_and_the_readers_of_orders() {
    let mut cell = Cell::start("127.7.9.17", &[]);
    cell.carry();
    let expected = if may_have_real_time() { 3 } else { 0 };
    assert_eq!(real_time_threads(cell.daemon().id()), expected);
}

/// Under the C library's allocator the loop waits for threads of low priority. With this variable the other
/// one prints its name on standard error.
#[test]
fn cell_uses_mimalloc() {
    let mut celld = Command::new(CELLD);
    let output = celld.arg("--version").env("MIMALLOC_VERBOSE", "1").output().expect("the binary runs");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.starts_with("mimalloc: "), "{said}");
}

/// The socket of a service manager that reads nothing, with a full queue.
struct FullSocket(UnixDatagram);

impl FullSocket {
    const FILLED_WITH: &[u8] = b"full";

    fn at(address: &SocketAddr) -> FullSocket {
        let socket = UnixDatagram::bind_addr(address).expect("a socket");
        // A sender of its own for each message: only the receiver's queue can be full.
        let takes_one = || {
            let sender = UnixDatagram::unbound().expect("a socket");
            sender.set_nonblocking(true).expect("set");
            sender.send_to_addr(FullSocket::FILLED_WITH, address).is_ok()
        };
        while takes_one() {}
        FullSocket(socket)
    }

    /// It was full all the time.
    fn got_nothing(&self) {
        self.0.set_nonblocking(true).expect("set");
        let mut message = [0; 4096];
        while let Ok(size) = self.0.recv(&mut message) {
            let message = &message[..size];
            assert_eq!(message, FullSocket::FILLED_WITH, "{}", String::from_utf8_lossy(message));
        }
    }
}

/// The arm carries something and rests after an abort, which is answered.
fn carries_and_is_aborted(cell: &Cell) {
    cell.carry();
    let (code, said) = cell.celld(&["abort"]);
    assert!(said.contains("disarmed"), "{code:?}: {said}");
    assert!(cell.rests());
}

/// Standard error is a pipe that nobody reads, and the queue of the service manager's socket is full: an
/// abort is taken, and SIGTERM ends the daemon.
#[test]
fn cell_with_a_blocked_log_takes_an_abort_and_ends() {
    let mut cell = Cell::without_daemon("127.7.9.5");
    let socket = cell.path().join("notify");
    let manager = FullSocket::at(&SocketAddr::from_pathname(&socket).expect("a short path"));
    let process =
        cell.run().env("CELLD_LOG", "trace").env("NOTIFY_SOCKET", &socket).stderr(Stdio::piped()).spawn();
    cell.daemon = Some(Running(process.expect("the binary runs")));
    cell.takes_orders();
    carries_and_is_aborted(&cell);
    cell.end();
    assert!(cell.holds(), "the end leaves the vacuum as it is");
    manager.got_nothing();
}

/// `script` runs the daemon on a terminal of its own, and copies what the terminal shows into the log file;
/// what is written to the result is typed.
fn start_on_a_terminal(cell: &mut Cell) -> ChildStdin {
    let command = format!("exec '{CELLD}' run --config '{}'", cell.config.display());
    let script = Command::new("script")
        .args(["--quiet", "--flush", "--command", &command, LOG])
        .envs([("SHELL", "/bin/sh"), ("CELLD_LOG", "trace")])
        .current_dir(cell.path())
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .spawn();
    let mut script = script.expect("`script` of util-linux");
    let keys = script.stdin.take().expect("piped");
    cell.daemon = Some(Running(script));
    cell.takes_orders();
    keys
}

/// Standard output and error are a terminal on which Ctrl-S was pressed, and more lines wait than the log's
/// queue takes: an abort is taken, and SIGTERM ends the daemon.
#[test]
fn cell_on_a_suspended_terminal_takes_an_abort_and_ends() {
    let mut cell = Cell::without_daemon("127.7.9.20");
    let mut keys = start_on_a_terminal(&mut cell);
    let process = cell.status()["pid"].as_u64().and_then(|id| u32::try_from(id).ok()).expect("its number");
    let shown = || std::fs::metadata(cell.path().join(LOG)).map_or(0, |log| log.len());
    let suspend_and_fill = |keys: &mut ChildStdin| {
        keys.write_all(CTRL_S).expect("pressed");
        wait_until("the terminal shows nothing new", || {
            let before = shown();
            std::thread::sleep(Duration::from_millis(300));
            shown() == before
        });
        let before = shown();
        (0..REQUESTS).for_each(|_| _ = request(cell.address, 8737, "/livez", ""));
        before
    };
    suspend_and_fill(&mut keys);
    keys.write_all(CTRL_Q).expect("pressed");
    wait_until("so many requests fill the queue", || cell.log().contains("lines of the log were lost"));
    let before = suspend_and_fill(&mut keys);
    carries_and_is_aborted(&cell);
    assert_eq!(shown(), before, "the output is suspended");
    terminate(process);
    assert!(cell.holds(), "the end leaves the vacuum as it is");
}

/// A terminal that is closed ends the daemon as SIGTERM does: the arm stops, the status is no longer armed.
#[test]
fn cell_ends_at_a_hangup_as_at_sigterm() {
    let mut cell = Cell::start("127.7.9.6", &[]);
    cell.carry();
    cell.signal("HUP");
    let code = cell.daemon().wait().expect("a child").code();
    let log = std::fs::read_to_string(cell.path().join(LOG)).expect("the log");
    assert_eq!(code, Some(0), "{log}");
    assert!(cell.rests() && cell.holds() && !cell.armed(), "{log}");
}
