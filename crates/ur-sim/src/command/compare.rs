//! `celld-sim compare CSV SCRIPT`: is the simulated arm where the real one was?
//!
//! In: a recording that ur_rtde's recorder made while a real arm carried out a program, the program, and the
//! arm's own kinematics where they are at hand. Out: tables or one JSON object, and the exit code: 0 within
//! the tolerances, 1 beyond, 2 when there is nothing to compare, with the reason on standard error.

use crate::command::check_script::program_in;
use crate::command::values;
use crate::compare::comparison::{Comparison, Tolerances, compare};
use crate::compare::kinematics::read_kinematics;
use crate::compare::motions::Motion;
use crate::compare::recording::read_recording;
use crate::compare::replay::{Replayed, replay};
use crate::compare::track::{Change, STATES, Track};
use cell_edge::files::{read_bytes, read_named};
use cell_edge::terminal::{complain, print, read_text, within};
use clap::{Args, ValueEnum};
use rearrange::document::chain::chain;
use serde_json::json;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use ur_arm::kinematics::{ArmModel, DhParameters, model_of};

/// Recordings have some MB a minute.
const LARGEST_RECORDING_BYTES: u64 = 1 << 30;

/// A description has 1 KB, what a controller sends some 10 KB a second.
const LARGEST_KINEMATICS_BYTES: u64 = 1 << 24;

/// `celld-sim compare`
#[derive(Args, Clone, Debug)]
pub struct CompareArgs {
    /// Recording by `RTDEReceiveInterface.startFileRecording`. Needs actual_q, and timestamp or --rate.
    csv: PathBuf,
    /// The URScript program that the real arm carried out.
    script: PathBuf,
    /// Which arm it was.
    #[arg(long, value_name = "NAME", value_parser = values::model, default_value = "UR5e")]
    model: ArmModel,
    /// Its own kinematics: the calibration.yaml of ROS (ur_calibration), or what port 30001 sends
    /// (`timeout 2 nc ROBOT 30001 > arm.bin`). Without them those of the model.
    #[arg(long, value_name = "FILE")]
    kinematics: Option<PathBuf>,
    /// How many samples a second has, where the recording has no timestamp.
    #[arg(long, value_name = "HZ", value_parser = rate)]
    rate: Option<f64>,
    /// Software version of its controller, as 5.13.0.
    #[arg(long, value_name = "VERSION", value_parser = values::software)]
    software: Option<[u32; 4]>,
    /// Most difference of a joint's position at any time, rad.
    #[arg(long, value_name = "RAD", value_parser = radians, default_value_t = 0.02)]
    joint_tolerance: f64,
    /// Most difference of the pause before a motion, of how long it lasts and of when a state changes, s.
    #[arg(long, value_name = "S", value_parser = seconds, default_value_t = 0.1)]
    time_tolerance: f64,
    /// Tables for people, or one JSON object.
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    /// Tables.
    Text,
    /// One JSON object.
    Json,
}

fn radians(text: &str) -> Result<f64, String> {
    within(text, 0.0..=10.0, "rad")
}

fn rate(text: &str) -> Result<f64, String> {
    within(text, 1.0..=1000.0, "Hz")
}

fn seconds(text: &str) -> Result<f64, String> {
    within(text, 0.0..=100.0, "s")
}

/// Compares; the exit code.
pub fn run(args: &CompareArgs) -> u8 {
    let (comparison, remarks) = match compared(args) {
        Ok(found) => found,
        Err(message) => {
            complain(&message);
            return 2;
        }
    };
    let tolerances = Tolerances { joint_rad: args.joint_tolerance, time_s: args.time_tolerance };
    let breaches = comparison.breaches(&tolerances);
    match args.format {
        Format::Text => print(&page(&comparison, &remarks, &breaches)),
        Format::Json => {
            let whole = json!({
                "within": breaches.is_empty(),
                "tolerances": tolerances,
                "beyond": breaches,
                "comparison": comparison,
                "controller": remarks,
            });
            print(&format!("{whole}\n"));
        }
    }
    u8::from(!breaches.is_empty())
}

fn compared(args: &CompareArgs) -> Result<(Comparison, Vec<String>), String> {
    let recorded = recording(&args.csv, args.rate)?;
    let program = program_in(&args.script.display().to_string(), &read_text(&args.script)?)?;
    let start = recorded.joints.first().copied().unwrap_or_default();
    let kinematics = args.kinematics.as_deref().map(|path| kinematics(path, &args.model)).transpose()?;
    let which = Replayed { arm: args.model, kinematics, software: args.software };
    let (simulated, remarks) =
        replay(program, &which, start, recorded.length_s()).map_err(|error| chain(&error))?;
    let comparison = compare(&recorded, &simulated).map_err(|error| {
        let said = remarks.iter().map(|remark| format!("\n  the simulated controller: {remark}"));
        format!("{}: {error}{}", args.csv.display(), said.collect::<String>())
    })?;
    Ok((comparison, remarks))
}

fn kinematics(path: &Path, model: &ArmModel) -> Result<DhParameters, String> {
    let name = path.display().to_string();
    let bytes = read_bytes(path, LARGEST_KINEMATICS_BYTES).map_err(|error| chain(&error))?;
    let dh = read_kinematics(&bytes, &name)?;
    let found = model_of(&dh).name;
    if found != model.name {
        return Err(format!("{name} describes a {found}, not a {}: use --model {found}", model.name));
    }
    Ok(dh)
}

fn recording(path: &Path, rate_hz: Option<f64>) -> Result<Track, String> {
    let name = path.display();
    let text = read_named(path, LARGEST_RECORDING_BYTES)
        .map_err(|error| format!("{name}: cannot be read: {}", error.reason()))?;
    read_recording(&text, rate_hz).map_err(|complaints| {
        let lines = complaints.iter().map(|complaint| format!("{name}: {complaint}"));
        lines.collect::<Vec<_>>().join("\n")
    })
}

/// Tables of all differences, and the sentences that say what is beyond the tolerances.
fn page(comparison: &Comparison, remarks: &[String], breaches: &[String]) -> String {
    let mut out = format!(
        "{} samples, {:.3} s apart, compared for {:.3} s from the first motion on\n\n",
        comparison.samples, comparison.interval_s, comparison.length_s
    );
    // Writing to a string cannot fail.
    let _ = writeln!(out, "joint  largest, rad    at, s  rms, rad");
    for (number, joint) in comparison.joints.iter().enumerate() {
        let (largest, at, rms) = (joint.largest_rad, joint.at_s, joint.rms_rad);
        let _ = writeln!(out, "{number:<5}  {largest:>12.5}  {at:>7.3}  {rms:>8.5}");
    }
    let _ = writeln!(
        out,
        "\nmotion  recorded: begins, lasts, s  simulated: begins, lasts, s  extra pause before, s  largest, rad"
    );
    let times = |motion: Option<Motion>| {
        motion.map_or("-".to_owned(), |motion| format!("{:.3}  {:.3}", motion.begins_s, motion.lasts_s))
    };
    for (pair, number) in comparison.motions.iter().zip(1..) {
        let (real, ours) = (times(pair.recorded), times(pair.simulated));
        let pause = pair.pause_longer_s.map_or("-".to_owned(), |pause_s| format!("{pause_s:+.3}"));
        let _ = writeln!(out, "{number:<6}  {real:>27}  {ours:>28}  {pause:>21}  {:>12.5}", pair.largest_rad);
    }
    let _ = writeln!(out, "\nstate          recorded, simulated: number at s");
    let changes = |changes: &[Change]| {
        let each = changes.iter().map(|change| format!("{} at {:.3}", change.state, change.at_s));
        each.collect::<Vec<_>>().join(", ")
    };
    for pair in &comparison.states {
        let (real, ours) = (changes(&pair.recorded), changes(&pair.simulated));
        let _ = writeln!(out, "{:<13}  {real}\n{:<13}  {ours}", pair.name, "");
    }
    let missing = STATES.iter().filter(|name| comparison.states.iter().all(|pair| pair.name != **name));
    missing.for_each(|name| out += &format!("{name:<13}  not recorded\n"));
    remarks.iter().for_each(|remark| out += &format!("\nthe simulated controller: {remark}"));
    out += if remarks.is_empty() { "\n" } else { "\n\n" };
    match breaches {
        [] => out += "within the tolerances\n",
        some => some.iter().for_each(|breach| out += &format!("beyond the tolerances: {breach}\n")),
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Cli {
        #[command(flatten)]
        args: CompareArgs,
    }

    /// What an arm does that turns its base from -1.6 by `turn` rad within `lasts_s`, in a straight line.
    fn recorded(turn: f64, lasts_s: f64) -> String {
        let mut text =
            "timestamp,robot_mode,actual_q_0,actual_q_1,actual_q_2,actual_q_3,actual_q_4,actual_q_5\n"
                .to_owned();
        for frame in 0..1000 {
            let time = f64::from(frame) * 0.002;
            let base = -1.6 + turn * ((time - 0.2) / lasts_s).clamp(0.0, 1.0);
            text += &format!("{time:.6},7,{base:.6},-1.9,1.8,-1.5,-1.57,0.1\n");
        }
        text
    }

    fn code_of(csv: &str, script: &str, options: &[&str]) -> u8 {
        let folder = tempfile::tempdir().unwrap();
        let [csv_path, script_path] = ["arm.csv", "work.script"].map(|name| folder.path().join(name));
        std::fs::write(&csv_path, csv).unwrap();
        std::fs::write(&script_path, script).unwrap();
        let paths = [csv_path.display().to_string(), script_path.display().to_string()];
        let words = ["compare"].into_iter().chain(paths.iter().map(String::as_str));
        let args = Cli::try_parse_from(words.chain(options.iter().copied())).map(|cli| cli.args);
        run(&args.unwrap_or_else(|error| panic!("{error}")))
    }

    const WORK: &str = "def work():\n movej([-1.5, -1.9, 1.8, -1.5, -1.57, 0.1], t=0.5)\nend\n";

    #[test]
    fn the_exit_code_says_whether_it_agrees() {
        let wide = ["--joint-tolerance", "0.05", "--time-tolerance", "0.2"];
        assert_eq!(code_of(&recorded(0.1, 0.5), WORK, &wide), 0);
        assert_eq!(code_of(&recorded(0.1, 0.5), WORK, &["--format", "json", "--joint-tolerance", "0"]), 1);
        assert_eq!(code_of(&recorded(0.3, 0.5), WORK, &wide), 1);
    }

    #[test]
    fn positions_alone_need_the_rate_and_kinematics_a_sound_file() {
        let wide = ["--joint-tolerance", "0.05", "--time-tolerance", "0.2"];
        let untimed: String = recorded(0.1, 0.5)
            .lines()
            .map(|line| line.split_once(',').map_or(line, |(_, rest)| rest).to_owned() + "\n")
            .collect();
        assert_eq!(code_of(&untimed, WORK, &wide), 2);
        assert_eq!(code_of(&untimed, WORK, &[&wide[..], &["--rate", "500"]].concat()), 0);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("arm.yaml");
        std::fs::write(&path, "kinematics: {}\n").unwrap();
        let kinematics = ["--kinematics", path.to_str().unwrap()];
        assert_eq!(code_of(&recorded(0.1, 0.5), WORK, &[&wide[..], &kinematics[..]].concat()), 2);
    }

    #[test]
    fn what_cannot_be_compared_has_a_code_of_its_own() {
        assert_eq!(code_of("nothing\n", WORK, &[]), 2);
        assert_eq!(code_of(&recorded(0.1, 0.5), "def work(\n", &[]), 2);
        assert_eq!(code_of(&recorded(0.0, 0.5), WORK, &[]), 2, "the recorded arm rests");
        assert_eq!(code_of(&recorded(0.1, 0.5), "def work():\n sync()\nend\n", &[]), 2);
    }

    #[test]
    fn the_page_has_every_joint_motion_state_and_breach() {
        let track = read_recording(&recorded(0.1, 0.5), None).unwrap();
        let comparison = compare(&track, &track).unwrap();
        let page = page(&comparison, &["C1A2 words".to_owned()], &["joint 0: too far".to_owned()]);
        for line in
            ["5           0.00000", "runtime_state  not recorded", "the simulated controller: C1A2 words"]
        {
            assert!(page.contains(line), "{line}\n{page}");
        }
        assert!(page.ends_with("beyond the tolerances: joint 0: too far\n"), "{page}");
    }
}
