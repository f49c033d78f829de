//! A folder in which the commands of a page are run, as a reader runs them in a clone of the repository.
//!
//! In: the blocks of a page. Out: what each prints, or a panic with the block, its exit code and all that
//! it printed. `celld` is the program that is tested. The folder has the example configuration at an
//! address and a speed of its own, so that pages are run beside each other; commands name the address of
//! the example, and so does what is compared.

use super::pages::{Block, missing};
use crate::cell::{CELLD, PATIENCE, celld, configuration, text, wait_until};
use crate::edit::replace_once;
use std::cell::{Cell, RefCell};
use std::os::unix::fs::symlink;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Where the example of the repository has its simulated devices, and its page.
const EXAMPLE: &str = "127.0.0.2";
const EXAMPLE_PAGE: &str = "127.0.0.1:8737";

pub struct Sandbox {
    folder: tempfile::TempDir,
    address: &'static str,
    /// The process groups that were started, one a block.
    groups: RefCell<Vec<u32>>,
    printed: Cell<usize>,
}

impl Sandbox {
    /// A sandbox whose simulated devices are at `address` and `factor` times as fast as real ones.
    pub fn new(address: &'static str, factor: u32) -> Sandbox {
        let folder = tempfile::tempdir().unwrap();
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let (cell, _) = configuration(folder.path(), address, factor);
        let example = std::fs::read_to_string(&cell).unwrap();
        std::fs::write(&cell, replace_once(&example, "\napproval: never", "\napproval: always")).unwrap();
        for name in ["faults-example.yaml", "README.md"] {
            std::fs::copy(root.join("config").join(name), folder.path().join("config").join(name)).unwrap();
        }
        for name in ["calibration", "docs", "schemas", "examples"] {
            symlink(root.join(name), folder.path().join(name)).unwrap();
        }
        std::fs::create_dir(folder.path().join(".bin")).unwrap();
        symlink(CELLD, folder.path().join(".bin/celld")).unwrap();
        Sandbox { folder, address, groups: RefCell::default(), printed: Cell::new(0) }
    }

    pub fn path(&self) -> &Path {
        self.folder.path()
    }

    /// Keeps a block as the file that it is.
    pub fn keep(&self, block: &Block) {
        if let Some(name) = block.file() {
            let path = self.path().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, self.ours(&block.text)).unwrap();
        }
    }

    /// Runs a block to its end; what it printed, to standard output and standard error.
    pub fn run(&self, page: &str, block: &Block) -> String {
        let (child, log) = self.start(&block.text);
        let code = ended(child);
        let printed = self.theirs(&std::fs::read_to_string(log).unwrap());
        let wanted = block.exit_code();
        assert!(code == wanted, "{page}:{}: exit code {code}, not {wanted}\n{printed}", block.line);
        printed
    }

    /// Runs a block again and again until it succeeds and prints what is wanted: a reader sees when it is
    /// time for it.
    pub fn run_until_it_prints(&self, page: &str, block: &Block, wanted: &str) -> String {
        let begun = Instant::now();
        loop {
            let (child, log) = self.start(&block.text);
            let code = ended(child);
            let printed = self.theirs(&std::fs::read_to_string(log).unwrap());
            let line = missing(wanted, &printed);
            if code == block.exit_code() && line.is_none() {
                return printed;
            }
            let at = format!("{page}:{}: exit code {code}, not printed: {line:?}", block.line);
            assert!(begun.elapsed() < PATIENCE, "{at}\n{printed}");
            // Programs that start without a break would take the core from the cell that is waited for.
            std::thread::sleep(Duration::from_millis(200));
        }
    }

    /// Starts a block that goes on for as long as the page does, and waits until it serves.
    pub fn run_beside(&self, page: &str, block: &Block) {
        let (child, log) = self.start(&block.text);
        // It is ended with its group; a process that ends by itself is found by what it does not serve.
        drop(child);
        let at = format!("{page}:{}: {}", block.line, block.text);
        if block.text.contains("celld sim") {
            let ready = || std::fs::read_to_string(&log).is_ok_and(|text| text.contains("\"ready\":true"));
            wait_until(&at, ready);
        }
        if block.text.contains("celld run") {
            let idle = || text(&celld(&["status"], self.path()).stdout).starts_with("idle");
            wait_until(&at, idle);
        }
    }

    /// A block as a process group of its own; what it prints goes to a file, which a process that goes on in
    /// the background does not keep open for whoever reads it.
    fn start(&self, commands: &str) -> (Child, PathBuf) {
        let number = self.printed.get();
        self.printed.set(number + 1);
        let log = self.path().join(format!(".bin/{number}.log"));
        let file = std::fs::File::create(&log).unwrap();
        let path = std::env::var("PATH").unwrap_or_default();
        let child = Command::new("sh")
            .args(["-eu", "-c", &self.ours(commands)])
            .current_dir(self.path())
            .env("PATH", format!("{}:{path}", self.path().join(".bin").display()))
            .stdin(Stdio::null())
            .stdout(file.try_clone().unwrap())
            .stderr(file)
            .process_group(0)
            .spawn()
            .unwrap();
        self.groups.borrow_mut().push(child.id());
        (child, log)
    }

    /// A text of the page with this sandbox's addresses.
    fn ours(&self, text: &str) -> String {
        let page = format!("{}:8737", self.address);
        let demo = format!("celld demo --bind {}", self.address);
        let text =
            text.replace(EXAMPLE_PAGE, &page).replace(EXAMPLE, self.address).replace("celld demo", &demo);
        text.lines().map(at_a_terminal).collect()
    }

    /// The other way round.
    fn theirs(&self, text: &str) -> String {
        text.replace(&format!("{}:8737", self.address), EXAMPLE_PAGE).replace(self.address, EXAMPLE)
    }
}

/// A line of a block; an approval, which wants a yes at a terminal, gets both.
fn at_a_terminal(line: &str) -> String {
    match line.starts_with("celld approve ") {
        true => format!("printf 'y\\n' | script -qefc '{line}' /dev/null\n"),
        false => format!("{line}\n"),
    }
}

impl Drop for Sandbox {
    fn drop(&mut self) {
        for group in self.groups.borrow().iter() {
            // A group that is over already is no fault.
            let end = format!("kill -s KILL -- -{group}");
            let _ = Command::new("sh").args(["-c", &end]).stderr(Stdio::null()).status();
        }
    }
}

/// The exit code of a process, waited for; 128 and the signal's number for one that a signal ended.
fn ended(child: Child) -> i32 {
    use std::os::unix::process::ExitStatusExt;
    let child = RefCell::new(child);
    let code = Cell::new(None);
    wait_until("a command ends", || {
        code.set(child.borrow_mut().try_wait().unwrap());
        code.get().is_some()
    });
    let status = code.get().unwrap();
    status.code().unwrap_or_else(|| 128 + status.signal().unwrap_or(0))
}
