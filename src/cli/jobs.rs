//! The commands that reach the daemon through the state folder: jobs, arming, recovery, status.
//!
//! In: arguments. Out: what came of it on stdout, exit code 0, 1 or 2. `submit`, `jobs` and `status` work
//! with the daemon off; every other command is refused then, and never stored for a later daemon.

use crate::cli::approve::{self, ApproveArgs};
use crate::cli::client::{ClientError, Format, StateArg, complain, send, start_line};
use crate::cli::history::{self, JobsArgs, ReportArgs, WhyArgs};
use crate::cli::interrupt::watch_every;
use crate::cli::open::{self, OpenArgs};
use crate::cli::submit::{SubmitArgs, submit};
use crate::cli::task::outln;
use crate::cli::watch::WatchArgs;
use crate::jobs::command::{Command, ReleaseChannel};
use crate::jobs::state::StateFolder;
use crate::jobs::status::Status;
use cell_machine::orders::WayBack;
use clap::{Args, Subcommand, ValueEnum};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Commands to the cell.
#[derive(Subcommand, Debug)]
pub enum ClientCommand {
    /// Hand in a job; works with the daemon off. While one runs, its verdict is waited for: 2 when it
    /// refuses the job.
    Submit(SubmitArgs),
    /// List jobs, newest first.
    Jobs(JobsArgs),
    /// Why a job ended as it did: its story from the records. Also of a file that was refused.
    Why(WhyArgs),
    /// A job as one HTML page: what was found, planned and done, pictures, errors.
    Report(ReportArgs),
    /// What the cell does, a line at every change, until Ctrl-C.
    Watch(WatchArgs),
    /// Allow motion. Refused, with what is missing, unless every link is up, the safety mode normal or
    /// reduced, remote control on and the gripper empty; an arm that is off is powered at once.
    Arm(StateArg),
    /// Forbid motion after the present step; a robot that is held or being started is stopped at once.
    Disarm(StateArg),
    /// Approve a job's plan. Without `--plan` celld shows the plan that waits and wants a yes.
    Approve(ApproveArgs),
    /// Refuse a job's plan; the job ends as cancelled.
    Reject(JobArg),
    /// End a job, waiting or active.
    Cancel(JobArg),
    /// Stop after the present step.
    Pause(StateArg),
    /// Go on after a pause.
    Resume(StateArg),
    /// One step, then pause.
    Step(StateArg),
    /// Stop the arm now and end the active job.
    Abort(StateArg),
    /// Move to the park pose, gripper empty.
    Park(StateArg),
    /// Stop and disarm, then vacuum off, wherever the arm is: what it holds falls.
    Release {
        #[command(flatten)]
        state: StateArg,
        /// Only this channel.
        #[arg(long, value_enum, ignore_case = true)]
        channel: Option<ChannelArg>,
        /// Yes, let go.
        #[arg(long, required = true)]
        yes: bool,
    },
    /// After a stop: what happened, what is held, and the ways back; with a choice, one of them.
    Recover(RecoverArgs),
    /// Say that what answers at the gripper's address is the gripper on this arm. Needed once for an
    /// address, before the first `arm`: no register of the device says what it is. Not needed in simulation.
    ConfirmGripper(StateArg),
    /// Sign this computer's browser in at the cell's page (`page:` in the configuration), or give a program
    /// a token for it.
    Open(OpenArgs),
    /// What the cell is doing; exit code 1 when no daemon runs.
    Status {
        #[command(flatten)]
        state: StateArg,
        /// Text or JSON.
        #[arg(long, value_enum, default_value_t = Format::Text)]
        format: Format,
    },
}

/// A job by its id.
#[derive(Args, Debug)]
pub struct JobArg {
    /// The job.
    id: String,
    #[command(flatten)]
    state: StateArg,
}

/// How a stop is left.
#[derive(Args, Debug)]
#[group(multiple = false)]
struct RecoverChoice {
    /// Straight up, a look, and what is held is put down at its goal or the nearest free place.
    #[arg(long)]
    place: bool,
    /// Keep what is held, and the arm where it is; only unlocks a protective stop.
    #[arg(long)]
    hold: bool,
    /// Vacuum off where it is: hold the object by hand.
    #[arg(long)]
    release: bool,
    /// Straight up, with whatever is held.
    #[arg(long)]
    retreat: bool,
}

impl RecoverChoice {
    fn way_back(&self) -> WayBack {
        let ways = [
            (self.place, WayBack::Place),
            (self.hold, WayBack::Hold),
            (self.release, WayBack::Release),
            (self.retreat, WayBack::Retreat),
        ];
        ways.into_iter().find(|(chosen, _)| *chosen).map_or(WayBack::Show, |(_, way)| way)
    }
}

const RECOVER_HELP: &str = "\
Without a choice nothing is done: the answer says what happened, what is held and where the arm
is, and for each way back what it would do, or why it cannot be taken now. Each choice is your
word that the cell is safe: a protective stop is unlocked by it, once the 5 s have passed that the
controller demands; not by
--release, which is for hands at the gripper. Whatever comes of it, the cell is disarmed afterwards;
`celld abort` stops a way back; the gripper keeps holding the object.";

/// Arguments of `celld recover`.
#[derive(Args, Debug)]
#[command(after_help = RECOVER_HELP)]
pub struct RecoverArgs {
    #[command(flatten)]
    how: RecoverChoice,
    #[command(flatten)]
    state: StateArg,
}

/// A suction channel on the command line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ChannelArg {
    /// Channel A.
    A,
    /// Channel B.
    B,
}

/// Carries out a client command and returns the exit code.
pub fn run(command: ClientCommand, stop: &Arc<AtomicBool>) -> u8 {
    let reported = match command {
        ClientCommand::Submit(args) => return submit(&args),
        ClientCommand::Jobs(args) => return history::code(history::jobs(&args)),
        ClientCommand::Why(args) => return history::code(history::why(&args)),
        ClientCommand::Report(args) => return history::code(history::report(&args)),
        ClientCommand::Status { state, format } => status(&state.folder(), format),
        ClientCommand::Open(args) => {
            watch_every(stop);
            open::open(&args, stop)
        }
        ClientCommand::Approve(args) => approve::approve(&args, stop),
        other => {
            let (state, command) = to_send(other);
            watch_every(stop);
            send(&state, &command, stop)
        }
    };
    match reported {
        Ok(code) => code,
        Err(error) => complain(&error),
    }
}

fn to_send(command: ClientCommand) -> (StateFolder, Command) {
    match command {
        ClientCommand::Arm(state) => (state.folder(), Command::Arm),
        ClientCommand::Disarm(state) => (state.folder(), Command::Disarm),
        ClientCommand::Pause(state) => (state.folder(), Command::Pause),
        ClientCommand::Resume(state) => (state.folder(), Command::Resume),
        ClientCommand::Step(state) => (state.folder(), Command::Step),
        ClientCommand::Abort(state) => (state.folder(), Command::Abort),
        ClientCommand::Park(state) => (state.folder(), Command::Park),
        ClientCommand::ConfirmGripper(state) => (state.folder(), Command::ConfirmGripper),
        ClientCommand::Reject(job) => (job.state.folder(), Command::Reject { id: job.id }),
        ClientCommand::Cancel(job) => (job.state.folder(), Command::Cancel { id: job.id }),
        ClientCommand::Release { state, channel, yes: _ } => {
            let channel = channel.map(|channel| match channel {
                ChannelArg::A => ReleaseChannel::A,
                ChannelArg::B => ReleaseChannel::B,
            });
            (state.folder(), Command::Release { channel })
        }
        ClientCommand::Recover(args) => (args.state.folder(), Command::Recover { how: args.how.way_back() }),
        ClientCommand::Submit(_)
        | ClientCommand::Jobs(_)
        | ClientCommand::Why(_)
        | ClientCommand::Report(_)
        | ClientCommand::Watch(_)
        | ClientCommand::Open(_)
        | ClientCommand::Approve(_)
        | ClientCommand::Status { .. } => unreachable!("these are not sent"),
    }
}

fn status(state: &StateFolder, format: Format) -> Result<u8, ClientError> {
    let running = state.is_taken()?;
    let status = Status::read(&state.status())?;
    if format == Format::Json {
        let status = status.filter(|_| running);
        outln!("{}", serde_json::json!({"running": running, "status": status}));
        return Ok(u8::from(!running));
    }
    match status {
        Some(status) if running => outln!("{}", status.text()),
        Some(last) => {
            outln!("no daemon runs on {}; the last one was {}", state.root().display(), last.daemon);
            outln!("{}", last.last_words());
            let held = match last.holding {
                Some(_) => "; what it held may still hang there: `celld recover` then shows the ways back",
                None => "",
            };
            outln!("  to do: {} starts it{held}", start_line(state, Some(&last)));
        }
        None => outln!("no daemon runs on {}; {} starts it", state.root().display(), start_line(state, None)),
    }
    Ok(u8::from(!running))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::inbox::Inbox;
    use cell_machine::orders::Reply;
    use clap::Parser;

    static NEVER: AtomicBool = AtomicBool::new(false);

    #[derive(Parser, Debug)]
    struct Line {
        #[command(subcommand)]
        command: ClientCommand,
    }

    #[track_caller]
    fn command(line: &str) -> Command {
        let words = std::iter::once("celld").chain(line.split_whitespace());
        to_send(Line::try_parse_from(words).unwrap().command).1
    }

    #[test]
    fn words_become_commands() {
        assert_eq!(command("arm"), Command::Arm);
        assert_eq!(command("confirm-gripper"), Command::ConfirmGripper);
        assert_eq!(
            command("release --yes --channel b"),
            Command::Release { channel: Some(ReleaseChannel::B) }
        );
        assert_eq!(command("recover"), Command::Recover { how: WayBack::Show });
        for (option, how) in [
            ("--place", WayBack::Place),
            ("--hold", WayBack::Hold),
            ("--release", WayBack::Release),
            ("--retreat", WayBack::Retreat),
        ] {
            assert_eq!(command(&format!("recover {option}")), Command::Recover { how });
        }
        for wrong in ["release", "approve", "recover --hold --place", "release --channel C --yes"] {
            let words = std::iter::once("celld").chain(wrong.split_whitespace());
            assert!(Line::try_parse_from(words).is_err(), "{wrong}");
        }
    }

    #[test]
    fn without_a_daemon_nothing_is_stored_for_the_next_one() {
        let folder = tempfile::tempdir().unwrap();
        let state = StateFolder::new(folder.path());
        assert!(matches!(send(&state, &Command::Arm, &NEVER), Err(ClientError::NoDaemon { .. })));
        let lock = state.take(&Status::default()).unwrap();
        Status { daemon: "d1".into(), ..Status::default() }.write(&state.status()).unwrap();
        drop(lock);
        assert!(matches!(send(&state, &Command::Arm, &NEVER), Err(ClientError::NoDaemon { .. })));
        assert_eq!(std::fs::read_dir(state.commands()).unwrap().count(), 0);
    }

    #[test]
    fn a_daemon_that_waits_for_the_robot_takes_no_order_and_says_so() {
        let folder = tempfile::tempdir().unwrap();
        let state = StateFolder::new(folder.path());
        let _lock = state.take(&Status::default()).unwrap();
        let waits = Status::starting("d1".into(), 0.0, 0.0, "waiting for the robot at 10.0.0.2".into());
        waits.write(&state.status()).unwrap();
        let refused = send(&state, &Command::Arm, &NEVER).expect_err("no order is taken").to_string();
        assert!(refused.contains("waiting for the robot at 10.0.0.2"), "{refused}");
        assert_eq!(std::fs::read_dir(state.commands()).unwrap().count(), 0, "and none is kept");
    }

    #[test]
    fn the_daemon_s_answer_is_the_exit_code() {
        let folder = tempfile::tempdir().unwrap();
        let state = StateFolder::new(folder.path());
        let _lock = state.take(&Status::default()).unwrap();
        Status { daemon: "d1".into(), ..Status::default() }.write(&state.status()).unwrap();
        let mut inbox = Inbox::open(&state.commands(), "d1").unwrap();
        for accepted in [true, false] {
            let answer = std::thread::scope(|scope| {
                let client = scope.spawn(|| send(&state, &Command::Arm, &NEVER));
                let taken = loop {
                    if let Some(taken) = inbox.take(1).taken.pop() {
                        break taken;
                    }
                    std::thread::yield_now();
                };
                taken.answer(&Reply { accepted, ..Reply::refuse("heard") }).unwrap();
                client.join().unwrap()
            });
            assert_eq!(answer.unwrap(), u8::from(!accepted));
        }
    }

    fn running() -> (tempfile::TempDir, StateFolder, Inbox, cell_edge::file_lock::FileLock) {
        let folder = tempfile::tempdir().unwrap();
        let state = StateFolder::new(folder.path());
        let lock = state.take(&Status::default()).unwrap();
        Status { daemon: "d1".into(), ..Status::default() }.write(&state.status()).unwrap();
        let inbox = Inbox::open(&state.commands(), "d1").unwrap();
        (folder, state, inbox, lock)
    }

    #[test]
    fn ctrl_c_takes_an_order_back_and_leaves_a_stop() {
        let (_folder, state, mut inbox, _lock) = running();
        let interrupted = AtomicBool::new(true);
        assert!(matches!(send(&state, &Command::Arm, &interrupted), Err(ClientError::TakenBack)));
        assert!(inbox.take(9).taken.is_empty());
        assert!(matches!(send(&state, &Command::Abort, &interrupted), Err(ClientError::StopStands)));
        assert_eq!(inbox.take(9).taken.pop().map(|taken| taken.command), Some(Command::Abort));
    }

    #[test]
    fn when_the_daemon_ends_before_its_answer_the_client_promises_nothing() {
        let (_folder, state, inbox, lock) = running();
        let interrupted = AtomicBool::new(false);
        let taken = std::thread::scope(|scope| {
            let client = scope.spawn(|| send(&state, &Command::Arm, &interrupted));
            let mut inbox = inbox;
            let taken = loop {
                match inbox.take(1).taken.pop() {
                    Some(taken) => break taken,
                    None => std::thread::yield_now(),
                }
            };
            // It has the command, and ends without an answer.
            drop((inbox, lock));
            interrupted.store(true, std::sync::atomic::Ordering::Relaxed);
            assert!(matches!(client.join().unwrap(), Err(ClientError::Ended { interrupted: true })));
            taken
        });
        drop(taken);
    }

    #[test]
    fn after_ctrl_c_the_daemon_sees_that_nobody_waits_and_its_answer_is_still_shown() {
        let (_folder, state, mut inbox, _lock) = running();
        let interrupted = AtomicBool::new(false);
        std::thread::scope(|scope| {
            let client = scope.spawn(|| send(&state, &Command::Arm, &interrupted));
            let taken = loop {
                match inbox.take(1).taken.pop() {
                    Some(taken) => break taken,
                    None => std::thread::yield_now(),
                }
            };
            assert!(taken.lock.is_held());
            interrupted.store(true, std::sync::atomic::Ordering::Relaxed);
            while taken.lock.is_held() {
                std::thread::yield_now();
            }
            taken.answer(&Reply::refuse("nothing was done")).unwrap();
            assert_eq!(client.join().unwrap().unwrap(), 1);
        });
    }
}
