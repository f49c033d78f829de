//! `celld replay` and `celld recordings`: a recorded run carried out again, and recordings made whole.
//!
//! In: recordings. Out: whether the cell decides the same again, byte for byte, or the first decision that
//! differs; with `--detect`, what the detector finds now in the recorded pictures; with `--page`, the run on
//! a page. Exit codes: 0 the same
//! again; 1 something differs, or a file could not be repaired; 2 a file that is no recording, or has
//! nothing to replay.

mod pictures;

use crate::cli::client::StateArg;
use crate::config::load::load_cell;
use crate::daemon::playback::Playback;
use crate::daemon::recorder::{piece_of, topic_of};
use crate::io::recording::read::{Entry, Item, Items};
use crate::io::recording::repair::{Repaired, is_whole, repair};
use crate::io::recording::{ABOUT, Recording, log_time_at};
use crate::jobs::status::Status;
use crate::report::replay_page::replay_page;
use cell_edge::terminal::{complain, in_shell, print};
use cell_machine::event::{Effect, News};
use cell_machine::machine::Machine;
use cell_machine::supervisor::cell::Supervisor;
use cell_machine::supervisor::order::JobReport;
use cell_replay::{Difference, Kind, Piece, Replay, Replayed, effect_of};
use cell_values::time::Timestamp;
use clap::{Args, Subcommand};
use indicatif::ProgressBar;
use pictures::Pictures;
use rearrange::document::chain::chain;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

/// Where `cargo test` looks for recordings that are to be decided the same for ever.
const TESTS: &str = "tests/recordings";

/// The longest text of a decision.
const SHOWN: usize = 400;

/// Arguments of `celld replay`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub struct ReplayArgs {
    /// The recording (MCAP); a broken one is read up to where it breaks off
    file: PathBuf,
    /// Run the detector again on the recorded pictures too, and print what changes
    #[arg(long)]
    detect: bool,
    /// Write the run as one HTML page: table, arm, pictures and sentences at any time of it
    #[arg(long, value_name = "FILE")]
    page: Option<PathBuf>,
    /// Write what the replay needs, and nothing else, into this folder: each file there is a test
    #[arg(long, value_name = "FOLDER", num_args = 0..=1, default_missing_value = TESTS)]
    as_test: Option<PathBuf>,
}

const HELP: &str = "\
The recording holds what the cell observed (bytes from the robot, markers found, plans made)
and what it decided. The same observations are handed to the cell of this program, without
robot, camera or planner, and each of its decisions is compared with the recorded one.";

/// `celld recordings`
#[derive(Subcommand, Debug)]
pub enum RecordingsCommand {
    /// Give recordings whose writer was killed their index and end, so that every viewer opens them
    Repair(RepairArgs),
}

/// Arguments of `celld recordings repair`.
#[derive(Args, Debug)]
pub struct RepairArgs {
    /// Recordings, or folders of recordings; default: the folder that the daemon ran with last
    files: Vec<PathBuf>,
    #[command(flatten)]
    state: StateArg,
}

/// What a recording says of itself.
#[derive(Default)]
struct About {
    version: String,
    epoch_unix_s: f64,
}

impl About {
    fn of(map: &BTreeMap<String, String>) -> About {
        let epoch = map.get("epoch_unix_s").and_then(|text| text.parse().ok());
        About { version: map.get("version").cloned().unwrap_or_default(), epoch_unix_s: epoch.unwrap_or(0.0) }
    }
}

/// Runs `celld replay`; returns the exit code.
pub fn run(args: &ReplayArgs) -> u8 {
    match replay(args) {
        Ok(code) => code,
        Err(message) => {
            complain(&message);
            2
        }
    }
}

fn replay(args: &ReplayArgs) -> Result<u8, String> {
    let located = |what: String| format!("{}: {what}", args.file.display());
    let file = File::open(&args.file).map_err(|error| located(error.to_string()))?;
    let pictures = args.detect.then(Pictures::new).transpose().map_err(|error| chain(&error))?;
    let title = args.file.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let page = args.page.as_ref().map(|_| Playback::new(title, 0.0));
    let (replay, about, jobs) = (Replay::default(), About::default(), Vec::new());
    let mut run = Run { replay, about, pictures, page, jobs };
    let (mut test, mut read) = (None, 0_u64);
    let mut difference = None;
    let bar = ProgressBar::new_spinner();
    for item in Items::new(BufReader::new(file)) {
        match item {
            Ok(Item::About(metadata)) if metadata.name == ABOUT => {
                run.about = About::of(&metadata.metadata);
                test = args.as_test.as_ref().map(|to| test_file(to, &args.file, &run.about)).transpose()?;
                run.page = run.page.map(|page| page.since(run.about.epoch_unix_s));
            }
            Ok(Item::About(_)) => {}
            Ok(Item::Message(entry)) => {
                read += 1;
                if read.is_multiple_of(5000) {
                    bar.set_message(format!("{read} messages"));
                    bar.tick();
                }
                let found = run.take(&entry);
                if let (Some(recording), Some(kind)) = (&mut test, piece_of(&entry.channel.topic)) {
                    keep(recording, kind, &entry, &run.about)?;
                }
                let found = found.map_err(|error| located(different_version(&error, &run.about)))?;
                if found.is_some() {
                    difference = found;
                    break;
                }
            }
            Err(error) if read == 0 => return Err(located(error.to_string())),
            Err(error) => {
                bar.suspend(|| {
                    eprintln!("{}; `celld recordings repair` makes it whole", located(error.to_string()))
                });
            }
        }
    }
    bar.finish_and_clear();
    if let Some(recording) = test {
        let path = recording.finish().map_err(|error| chain(&error))?;
        eprintln!("{} is replayed by `cargo test recorded_runs` from now on", path.display());
    }
    if run.replay.machine().is_none() {
        let none = "it holds no decisions; `recording: {decisions: true}` records them".to_string();
        return Err(located(none));
    }
    run.outcome(difference.as_ref(), &args.file, args.page.as_deref())
}

/// A recording on its way through the replay.
struct Run {
    replay: Replay,
    about: About,
    pictures: Option<Pictures>,
    page: Option<Playback>,
    /// How jobs ended, a sentence each.
    jobs: Vec<String>,
}

impl Run {
    /// One message: what is replayed of it, what the detector says of it, what the page shows of it.
    fn take(&mut self, entry: &Entry) -> Result<Option<Difference>, cell_replay::Unreadable> {
        let kind = piece_of(&entry.channel.topic);
        if let Some(pictures) = &mut self.pictures {
            pictures.take(entry, kind);
        }
        let found = kind.map_or(Ok(None), |kind| self.replay.take(kind, &entry.piece()))?;
        if kind == Some(Kind::Effect)
            && let Some(Effect::Notify(News::Ended(report))) = effect_of(&entry.piece())
        {
            self.jobs.push(ended(&report));
        }
        if let Some(page) = &mut self.page {
            page.take(entry, &self.replay, self.about.epoch_unix_s);
        }
        Ok(found)
    }

    /// Prints what came of it, and writes the page; the exit code.
    fn outcome(self, difference: Option<&Difference>, from: &Path, to: Option<&Path>) -> Result<u8, String> {
        print(&text(&self.replay.so_far(), difference, &self.about));
        print(&last_words(&self.jobs, self.replay.machine()));
        let changed = self.pictures.map(Pictures::finish).is_some_and(|(text, changed)| {
            print(&text);
            changed
        });
        if let (Some(page), Some(to)) = (self.page, to) {
            let html = replay_page(&page.finish()).map_err(|error| error.to_string())?;
            std::fs::write(to, html).map_err(|error| format!("{}: {error}", to.display()))?;
            complain(&format!("{} shows the run in any browser", to.display()));
        } else {
            complain(&format!(
                "`celld replay --page run.html {}` shows the run in any browser",
                in_shell(from)
            ));
        }
        Ok(u8::from(difference.is_some() || changed))
    }
}

fn ended(report: &JobReport) -> String {
    let hint = if report.hint.is_empty() { String::new() } else { format!("\n  to do: {}", report.hint) };
    format!("job {} {}: {} ({}){hint}", report.id, report.end, report.message, report.code_text())
}

/// How the run ended: its jobs, and how the cell was at the last moment that was replayed.
fn last_words(jobs: &[String], machine: Option<&Machine>) -> String {
    let mut lines = jobs.to_vec();
    if let Some(status) = machine.and_then(|machine| machine.supervisor()).map(Supervisor::status) {
        let armed = if status.armed { "armed" } else { "disarmed" };
        lines.push(format!("at its end the cell was {armed}: {}", status.text()));
        lines.extend(status.held.map(|held| format!("  gripper: {held}")));
        lines.extend(status.stopped.map(|stop| format!("  stopped: {} ({})", stop.message, stop.code)));
    }
    lines.iter().map(|line| format!("{line}\n")).collect()
}

fn different_version(error: &cell_replay::Unreadable, about: &About) -> String {
    let (then, now) = (&about.version, env!("CARGO_PKG_VERSION"));
    format!("{error} (recorded by celld {then}, this is {now})")
}

fn test_file(folder: &Path, file: &Path, about: &About) -> Result<Recording, String> {
    let name = file.file_name().ok_or("the recording has no name")?;
    std::fs::create_dir_all(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    let target = folder.join(name);
    if target.exists() {
        return Err(format!("{} exists already: remove it, or name another folder", target.display()));
    }
    Recording::create(&target, about.epoch_unix_s).map_err(|error| chain(&error))
}

fn keep(recording: &mut Recording, kind: Kind, entry: &Entry, about: &About) -> Result<(), String> {
    let at = log_time_at(about.epoch_unix_s, entry.log_time);
    let piece = Piece { kind, at, bytes: entry.piece().into_owned() };
    recording.piece(topic_of(kind), piece.at, &piece.bytes).map_err(|error| chain(&error))
}

fn text(so_far: &Replayed, difference: Option<&Difference>, about: &About) -> String {
    let seconds = so_far.until.since(so_far.from.unwrap_or(Timestamp::ZERO)).as_secs_f64();
    let mut text = format!(
        "{} events of {seconds:.1} s, recorded by celld {}; {} decisions compared\n",
        so_far.events, about.version, so_far.decisions
    );
    if so_far.gaps > 0 {
        text.push_str(&format!(
            "in {} places pieces are missing: the replay goes on behind them\n",
            so_far.gaps
        ));
    }
    match difference {
        None => text.push_str("all of them are the same again\n"),
        Some(difference) => {
            let short = |text: &Option<String>| match text {
                None => "nothing more".to_string(),
                Some(text) => text.chars().take(SHOWN).collect(),
            };
            text.push_str(&format!(
                "decision {} at {:.3} s differs\n  then: {}\n  now:  {}\n",
                difference.decision,
                difference.at.as_secs_f64(),
                short(&difference.then),
                short(&difference.now)
            ));
            let now = env!("CARGO_PKG_VERSION");
            text.push_str(&format!("recorded by celld {}, this is celld {now}\n", about.version));
        }
    }
    text
}

/// Runs `celld recordings`; returns the exit code.
pub fn recordings(command: &RecordingsCommand) -> u8 {
    let RecordingsCommand::Repair(args) = command;
    let files = match files(args) {
        Ok(files) => files,
        Err(message) => {
            complain(&message);
            return 2;
        }
    };
    let (mut mended, mut failed) = (0, 0);
    for path in &files {
        match repair(path) {
            Ok(Repaired::Whole) => {}
            Ok(Repaired::Mended { messages, .. }) => {
                mended += 1;
                print(&format!("{}: made whole, {messages} messages\n", path.display()));
            }
            Err(error) => {
                failed += 1;
                complain(&chain(&error));
            }
        }
    }
    print(&format!("{} recordings, {mended} made whole, {failed} not\n", files.len()));
    u8::from(failed > 0)
}

/// The files that are meant; of the folder of a daemon that runs, not the one that it writes.
fn files(args: &RepairArgs) -> Result<Vec<PathBuf>, String> {
    let mut named = args.files.clone();
    if named.is_empty() {
        named.push(folder_of_the_daemon(args)?);
    }
    let mut files = Vec::new();
    for path in named {
        if !path.is_dir() {
            files.push(path);
            continue;
        }
        let fail = |error: std::io::Error| format!("{}: {error}", path.display());
        let mut within = Vec::new();
        for entry in std::fs::read_dir(&path).map_err(fail)? {
            let entry = entry.map_err(fail)?.path();
            if entry.extension().is_some_and(|extension| extension == "mcap") {
                within.push(entry);
            }
        }
        within.sort();
        files.extend(within);
    }
    let running = args.state.folder().is_taken().unwrap_or(false);
    if running {
        files.retain(|file| is_whole(file).unwrap_or(true) || !is_written(file));
    }
    Ok(files)
}

/// A daemon writes a chunk at least every second.
fn is_written(file: &Path) -> bool {
    let changed = file.metadata().and_then(|meta| meta.modified());
    changed.is_ok_and(|at| at.elapsed().is_ok_and(|age| age.as_secs() < 10))
}

fn folder_of_the_daemon(args: &RepairArgs) -> Result<PathBuf, String> {
    let none = "name recordings or their folder: no daemon has run with this state folder yet".to_string();
    let status = Status::read(&args.state.folder().status()).map_err(|error| chain(&error))?;
    let config = status.map(|status| status.config).filter(|path| !path.is_empty()).ok_or(none)?;
    let cell = load_cell(Path::new(&config)).map_err(|error| error.to_string())?;
    let to =
        cell.recording.ok_or(format!("{config} has no `recording:`; name recordings or their folder"))?;
    Ok(to.folder)
}
