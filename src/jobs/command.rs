//! Commands of the operator to the running daemon, as files in the state folder.
//!
//! In: a [`Command`] from `celld arm` and its like. Out: the same in the daemon, once, and its answer back.
//! A command is a file, renamed into place whole, that carries the name of the daemon it was meant for: one
//! that was not taken (the daemon had just ended) is never obeyed by the next daemon. Its sender keeps the
//! file locked until it has the answer, so the daemon sees when nobody waits any more, and either the
//! daemon takes a command or its sender takes it back (`cell_edge::mailbox`). Stops are taken before
//! everything else that lies there; files are removed with the answer (`jobs::inbox`). How old a command may
//! be is judged where it is decided (`cell_machine::intake`).

use cell_edge::files::{FileError, read_regular, remove};
use cell_edge::mailbox::{Left, leave};
use cell_machine::orders::{Channels, Order, Reply, Role, WayBack};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Longest file that is read as a command.
pub(super) const MAX_BYTES: u64 = 64 * 1024;

/// How the file of a command is called.
pub(super) const SUFFIX: &str = ".command";

/// What names the file of a stop besides, so that it is looked into first.
pub const STOP_MARK: &str = "-stop";

/// When an order was given.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Given {
    /// Calendar time, s since 1970: orders the commands of several senders.
    pub unix_s: f64,
    /// Time since the machine started, s: how old the order is.
    pub boot_s: f64,
}

/// What an operator may request of the daemon.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "do", rename_all = "lowercase", deny_unknown_fields)]
pub enum Command {
    /// Allow motion.
    Arm,
    /// Forbid motion after the present step; a robot that is held or being started is stopped at once.
    Disarm,
    /// Agree to a job's plan.
    Approve {
        /// The job.
        id: String,
        /// Number of the plan that was shown, as in the status.
        plan: u64,
    },
    /// Refuse a job's plan: the job ends as cancelled.
    Reject {
        /// The job.
        id: String,
    },
    /// End a job, waiting or active.
    Cancel {
        /// The job.
        id: String,
    },
    /// Stop after the present step.
    Pause,
    /// Go on after a pause.
    Resume,
    /// One step, then pause.
    Step,
    /// Stop the arm now and end the active job.
    Abort,
    /// Move to the park pose, gripper empty.
    Park,
    /// Stop and disarm, then vacuum off, wherever the arm is.
    Release {
        /// Absent: both.
        channel: Option<ReleaseChannel>,
    },
    /// Leave a stop.
    Recover {
        /// How.
        how: WayBack,
    },
    /// What answers at the gripper's address is the gripper.
    #[serde(rename = "confirm-gripper")]
    ConfirmGripper,
    /// A calibration round to the taught poses.
    Calibrate,
    /// Sign a person in at the page. Not for the machine.
    #[serde(rename = "sign-in")]
    SignIn(SignIn),
    /// End sessions and tokens of the page, and links that were not used. Not for the machine.
    #[serde(rename = "sign-out")]
    SignOut {
        /// Of whom.
        name: String,
    },
}

/// Who is to be signed in at the page, and how.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SignIn {
    /// What the person may do.
    pub role: Role,
    /// How the person is called; absent: as the system calls who gave the command.
    pub name: Option<String>,
    /// A token for a program, for so many days; absent: a link that signs a browser in once.
    pub token_days: Option<u32>,
    /// The link is for a browser of who gives the command, on this computer, and counts for no other.
    #[serde(default)]
    pub own_browser: bool,
}

/// A suction channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ReleaseChannel {
    /// Channel A.
    A,
    /// Channel B.
    B,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Envelope {
    pub(super) daemon: String,
    /// When it was given, s since the machine started.
    pub(super) boot_s: f64,
    pub(super) command: Command,
}

impl Command {
    /// The order to the machine; `None` for what is not for the machine.
    pub fn order(&self) -> Option<Order> {
        Some(match self {
            Command::Arm => Order::Arm,
            Command::Disarm => Order::Disarm,
            Command::Approve { id, plan } => Order::Approve { id: id.clone(), plan: *plan },
            Command::Reject { id } => Order::Reject(id.clone()),
            Command::Cancel { id } => Order::Cancel(id.clone()),
            Command::Pause => Order::Pause,
            Command::Resume => Order::Resume,
            Command::Step => Order::Step,
            Command::Abort => Order::Abort,
            Command::Park => Order::Park,
            Command::Release { channel } => Order::Release(match channel {
                Some(ReleaseChannel::A) => Channels::A,
                Some(ReleaseChannel::B) => Channels::B,
                None => Channels::Both,
            }),
            Command::Recover { how } => Order::Recover(*how),
            Command::ConfirmGripper => Order::ConfirmGripper,
            Command::Calibrate => Order::Calibrate,
            Command::SignIn(_) | Command::SignOut { .. } => return None,
        })
    }

    /// It only stops: obeyed however old it is, and whoever waits for it.
    pub fn only_stops(&self) -> bool {
        self.order().is_some_and(|order| order.only_stops())
    }

    /// What is written into its file, for the daemon of this name; given at `boot_s` since the machine
    /// started.
    pub fn text(&self, daemon: &str, boot_s: f64) -> String {
        let envelope = Envelope { daemon: daemon.to_owned(), boot_s, command: self.clone() };
        serde_json::to_string(&envelope).expect("commands have string keys only")
    }
}

/// Name of the file of a command that this process gave at this calendar time; `number` distinguishes
/// several of the same moment.
pub fn file_name(unix_s: f64, pid: u32, number: u32, stops: bool) -> String {
    let micros = (unix_s * 1e6) as u64;
    let mark = if stops { STOP_MARK } else { "" };
    format!("{micros:020}-{pid}-{number:03}{mark}{SUFFIX}")
}

/// The process that gave a command, by the name of its file; all names of another form count as one sender.
pub fn sender_of(name: &str) -> &str {
    name.split('-').nth(1).unwrap_or("")
}

/// A command on its way, seen from the sender. As long as it is kept, the daemon sees that its sender waits.
#[derive(Debug)]
pub struct Sent {
    left: Left,
    pub(super) reply: PathBuf,
}

impl Sent {
    /// Leaves `command` for the daemon called `daemon`.
    ///
    /// # Errors
    /// The command cannot be written, or 1000 commands of this process with the same time are still
    /// there.
    pub fn send(folder: &Path, daemon: &str, command: &Command, given: Given) -> Result<Sent, FileError> {
        let text = command.text(daemon, given.boot_s);
        let (pid, stops) = (std::process::id(), command.only_stops());
        let names = (0..1000).map(|number| file_name(given.unix_s, pid, number, stops));
        let left = leave(folder, names, text.as_bytes())?;
        Ok(Sent { reply: left.path.with_extension("reply"), left })
    }

    /// The answer, once it is there; it is removed.
    ///
    /// # Errors
    /// The answer is there, but it cannot be read or removed.
    pub fn poll(&self) -> Result<Option<Reply>, FileError> {
        poll(&self.reply)
    }

    /// Takes the command back; false when the daemon has it already.
    ///
    /// # Errors
    /// The file system does not say who has it.
    pub fn withdraw(&self) -> Result<bool, FileError> {
        self.left.take_back()
    }

    /// No daemon has taken the command.
    ///
    /// # Errors
    /// The file system does not say who has it.
    pub fn waits(&self) -> Result<bool, FileError> {
        self.left.waits()
    }

    /// Waits no longer: the daemon carries the command out only if it was decided before. What is left is
    /// the place of the answer.
    pub fn let_go(self) -> LastWord {
        LastWord(self.reply)
    }
}

/// Where the answer to a command appears that nobody waits for any more.
#[derive(Debug)]
pub struct LastWord(PathBuf);

impl LastWord {
    /// As [`Sent::poll`].
    ///
    /// # Errors
    /// As [`Sent::poll`].
    pub fn poll(&self) -> Result<Option<Reply>, FileError> {
        poll(&self.0)
    }
}

fn poll(reply: &Path) -> Result<Option<Reply>, FileError> {
    let text = match read_regular(reply, MAX_BYTES) {
        Err(error) if error.is_absent() => return Ok(None),
        other => other?.0,
    };
    remove(reply)?;
    let unreadable = |_| Reply::refuse("the daemon's answer is not readable");
    Ok(Some(serde_json::from_str(&text).unwrap_or_else(unreadable)))
}
