//! `celld check FILE...`: every complaint about configuration, calibration, job, goal, instance and fault
//! files.
//!
//! In: files; their kind follows from their top-level keys; with `--config`, the cell that jobs and goals
//! are for. Out: one line for each complaint, with file, line and column, on stdout; exit code 2 if there is
//! any. Nothing is changed and no daemon is needed.

use crate::cli::task::outln;
use crate::config::cell::CellConfig;
use crate::config::load::load_cell;
use crate::jobs::goal::{find_goal_file, parse_goal_file};
use crate::jobs::job_file::{JobContext, read_job};
use cell_calibration::files;
use cell_machine::orders::Approval;
use cell_parts::file::read_text;
use clap::{Args, ValueEnum};
use rearrange::document::tree::Node;
use rearrange::document::{Diagnostics, parse_rest};
use rearrange::tabletop::parse::parse_with_sound_goals;
use std::path::{Path, PathBuf};
use ur_sim::config::load::load_sim;
use ur_sim::faults::read::read_faults;

/// Arguments of `celld check`.
#[derive(Args, Debug)]
pub struct CheckArgs {
    /// Files to check.
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// What they are, where the top-level keys do not show it.
    #[arg(long)]
    kind: Option<Kind>,
    /// Folder of named shapes, for public instances.
    #[arg(long)]
    shapes: Option<PathBuf>,
    /// The cell whose catalogue, table and approval jobs and goals are checked against.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
}

/// What the files are checked with.
#[derive(Clone, Copy, Default)]
struct With<'a> {
    kind: Option<Kind>,
    shapes: Option<&'a Path>,
    cell: Option<&'a CellConfig>,
}

/// Kinds of file that celld reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Kind {
    /// `config/cell.yaml`.
    Config,
    /// `config/sim.yaml`.
    Sim,
    /// A calibration file.
    Calibration,
    /// A job.
    Job,
    /// A goal that jobs name.
    Goal,
    /// A task for the planner.
    Instance,
    /// Faults for the simulator.
    Faults,
}

/// Checks the files and returns the exit code: 0 when all are sound, else 2.
pub fn run(args: &CheckArgs) -> u8 {
    let mut sound = true;
    let cell = args.config.as_deref().and_then(|path| match load_cell(path) {
        Ok(cell) => Some(cell),
        Err(error) => {
            sound = false;
            outln!("{error}");
            None
        }
    });
    let with = With { kind: args.kind, shapes: args.shapes.as_deref(), cell: cell.as_ref() };
    for path in &args.files {
        match check(path, with) {
            Ok(kind) => eprintln!("{}: sound ({kind:?})", path.display()),
            Err(message) => {
                sound = false;
                outln!("{message}");
            }
        }
    }
    if sound { 0 } else { 2 }
}

fn check(path: &Path, with: With) -> Result<Kind, String> {
    let source = path.display().to_string();
    let text = read_text(path).map_err(|reason| format!("{source}: {reason}"))?;
    let kind = match with.kind {
        Some(kind) => kind,
        None => {
            let (node, _) = parse_rest(&text, &source).map_err(|complaints| complaints.to_string())?;
            kind_of(&node).ok_or_else(|| {
                format!(
                    "{source}:1:1: its top-level keys are those of no file of celld; say what it is with \
                     --kind config, sim, calibration, job, goal, instance or faults"
                )
            })?
        }
    };
    check_as(kind, path, &text, &source, with)?;
    Ok(kind)
}

/// The kind of file that has such top-level keys.
pub fn kind_of(top: &Node) -> Option<Kind> {
    let has = |key: &str| top.get(key).is_some();
    if files::kind(top).is_some() {
        Some(Kind::Calibration)
    } else if has("devices") || has("limits") {
        Some(Kind::Config)
    } else if has("bind") || has("ports") {
        Some(Kind::Sim)
    } else if has("workspace") || has("object_list") || has("point_list") {
        Some(Kind::Instance)
    } else if has("goal") {
        Some(Kind::Job)
    } else if has("faults") {
        Some(Kind::Faults)
    } else if has("objects") {
        Some(Kind::Goal)
    } else {
        None
    }
}

fn check_as(kind: Kind, path: &Path, text: &str, source: &str, with: With) -> Result<(), String> {
    let obstacles = with.cell.map(CellConfig::obstacles).unwrap_or_default();
    let goal = with.cell.map(|cell| cell.goal_context(&obstacles));
    let reported = |complaints: Diagnostics| complaints.to_string();
    match kind {
        Kind::Config => load_cell(path).map(drop).map_err(|error| error.to_string()),
        Kind::Sim => load_sim(path).map(drop).map_err(|error| error.to_string()),
        Kind::Calibration => check_calibration(text, source),
        Kind::Job => {
            let goals = with.cell.map(|cell| cell.goal_folder.as_path());
            let read_goal = |name: &str| find_goal_file(&folder_of(path), goals, name);
            let approval = with.cell.map_or(Approval::Never, |cell| cell.approval);
            let context = JobContext { goal, approval, read_goal: &read_goal, found: None };
            read_job(text, source, &context).map(drop).map_err(reported)
        }
        Kind::Goal => parse_goal_file(text, source, goal.as_ref()).map(drop).map_err(reported),
        Kind::Faults => read_faults(text, source).map(drop).map_err(reported),
        Kind::Instance => {
            let folder = with.shapes.map_or_else(|| default_shapes(path), Path::to_path_buf);
            let lookup = |name: &str| read_text(&folder.join(format!("{name}.json"))).ok();
            parse_with_sound_goals(text, source, &lookup).map(drop).map_err(reported)
        }
    }
}

fn check_calibration(text: &str, source: &str) -> Result<(), String> {
    let reported = |complaints: Diagnostics| complaints.to_string();
    let (node, _) = parse_rest(text, source).map_err(reported)?;
    match files::kind(&node) {
        Some(files::Kind::Camera) => {
            files::camera::CameraCalibration::parse(text, source).map(drop).map_err(reported)
        }
        Some(files::Kind::HandEye) => {
            files::hand_eye::HandEyeCalibration::parse(text, source).map(drop).map_err(reported)
        }
        Some(files::Kind::Table) => {
            files::table::TableCalibration::parse(text, source).map(drop).map_err(reported)
        }
        Some(files::Kind::Touches) => {
            files::touches::Touches::parse(text, source).map(drop).map_err(reported)
        }
        Some(files::Kind::Round) => files::round::Round::parse(text, source).map(drop).map_err(reported),
        Some(files::Kind::Blends) => {
            files::blends::BlendRecording::parse(text, source).map(drop).map_err(reported)
        }
        None => Err(format!(
            "{source}:1:1: no calibration file has these keys; it has `version`, `date` and one of \
             `camera`, `hand_eye`, `table`, `touches`, `blends`, `samples`"
        )),
    }
}

/// The folder of a file.
pub fn folder_of(path: &Path) -> PathBuf {
    path.parent().unwrap_or(Path::new("")).to_path_buf()
}

/// The `shapes` folder beside the `instances` folder that holds `path`, as in the public data.
fn default_shapes(path: &Path) -> PathBuf {
    let instances =
        path.ancestors().find(|folder| folder.file_name().is_some_and(|name| name == "instances"));
    instances.and_then(Path::parent).unwrap_or(Path::new(".")).join("shapes")
}

#[cfg(test)]
mod tests {
    use super::*;
    use rearrange::document::parse;

    #[track_caller]
    fn check_kind(text: &str, expected: Option<Kind>) {
        assert_eq!(kind_of(&parse(text, "f").unwrap()), expected, "{text}");
    }

    #[test]
    fn the_keys_determine_the_kind() {
        check_kind("version: 1\ngoal: {file: goal.yaml}\n", Some(Kind::Job));
        check_kind("objects: []\n", Some(Kind::Goal));
        check_kind("workspace: {width: 1, height: 1}\nobjects: []\n", Some(Kind::Instance));
        check_kind("version: 1\ncamera: {}\ndate: today\n", Some(Kind::Calibration));
        check_kind(include_str!("../../config/cell.yaml"), Some(Kind::Config));
        check_kind(include_str!("../../config/sim.yaml"), Some(Kind::Sim));
        check_kind(include_str!("../../config/faults-example.yaml"), Some(Kind::Faults));
        check_kind("colour: blue\n", None);
        check_kind("- 1\n", None);
    }

    #[test]
    fn complaints_are_exit_code_2() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str, text: &str| {
            let path = folder.path().join(name);
            std::fs::write(&path, text).unwrap();
            path
        };
        let good = path("good.yaml", "version: 1\ngoal: {objects: [{id: a, pose: [0, 0, 0]}]}\n");
        let bad = path("bad.yaml", "version: 1\ngoal: {objects: [{id: a, psoe: [0, 0, 0]}]}\n");
        let none = path("none.yaml", "colour: blue\n");
        let code = |files: &[&PathBuf], kind| {
            let files = files.iter().map(|path| (*path).clone()).collect();
            run(&CheckArgs { files, kind, shapes: None, config: None })
        };
        assert_eq!(code(&[&good], None), 0);
        assert_eq!(code(&[&good, &bad], None), 2);
        assert_eq!(code(&[&none], None), 2);
        assert_eq!(code(&[&good], Some(Kind::Instance)), 2);
        assert_eq!(code(&[&folder.path().join("absent.yaml")], None), 2);
        let reported = check(&bad, With::default()).unwrap_err();
        assert!(
            reported.contains("bad.yaml:2:26: goal.objects[0].psoe: unknown key; did you mean \"pose\"?"),
            "{reported}"
        );
    }

    #[test]
    fn a_job_finds_its_goal_file_beside_it() {
        let folder = tempfile::tempdir().unwrap();
        let job = folder.path().join("job.yaml");
        std::fs::write(&job, "version: 1\ngoal: {file: goal.yaml}\n").unwrap();
        assert!(check(&job, With::default()).unwrap_err().contains("goal.file: goal.yaml:"));
        std::fs::write(folder.path().join("goal.yaml"), "objects:\n  - {id: a, pose: [0, 0, 0]}\n").unwrap();
        assert_eq!(check(&job, With::default()), Ok(Kind::Job));
    }
}
