//! Files and pictures spoilt at random, by the readers that the daemon and the commands use: whatever comes
//! of it is a value or a complaint with its place, never a panic.
//!
//! In: sound texts of every kind, a seed, `CELLD_SPOILT=N` for N files (and a hundredth of it pictures)
//! instead of some thousand. Out: nothing panics; with a number given, the slowest file and the most memory
//! are printed, for the figures. Changes are those of people and disks: a byte, a line, a number that cannot
//! be, a tail that is missing, a part of another file.

use cell_calibration::files::camera::CameraCalibration;
use cell_calibration::files::hand_eye::HandEyeCalibration;
use cell_calibration::files::table::TableCalibration;
use cell_machine::orders::Approval;
use cell_values::image::Image;
use cell_values::image::depth::DepthImage;
use celld::config::read_cell::read_cell;
use celld::jobs::goal::parse_goal_file;
use celld::jobs::job_file::{JobContext, read_job};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rearrange::document::Diagnostics;
use rearrange::tabletop::parse::parse_with_sound_goals;
use std::path::Path;
use std::time::{Duration, Instant};

const CONFIG: &str = include_str!("../../config/cell.yaml");
pub(crate) const CAMERA: &str = include_str!("../../calibration/sim/camera.yaml");
pub(crate) const HAND_EYE: &str = include_str!("../../calibration/sim/hand_eye.yaml");
pub(crate) const TABLE: &str = include_str!("../../calibration/sim/table.yaml");
pub(crate) const JOB: &str = "\
version: 1
id: tidy
goal:
  region: {group: planks, polygon: [[0, 0], [0.4, 0], [0.4, 0.4]]}
objective: pp
approval: job
not_before: 2026-11-21T08:00:00Z
";
pub(crate) const GOAL: &str = "\
version: 1
objects:
  - {id: plank-1, pose: [0.1, 0.1, 0.5]}
  - {id: block, pose: [0.4, 0.4, -1]}
";
pub(crate) const INSTANCE: &str = "\
workspace: {width: 0.5, height: 0.5}
objects:
  - {id: a, footprint: {disc: {radius: 0.05}}, start: [0.1, 0.1, 0], goal: [0.4, 0.1, 0]}
  - {id: b, footprint: [[0, 0], [0.1, 0], [0.1, 0.1]], start: [0.1, 0.4, 0], goal: [0.4, 0.4, 0]}
";

/// What no number of a cell is, and what no file has.
const STRANGE: &[&str] = &[
    "-1e308",
    "1e999",
    ".nan",
    "-.inf",
    "0x7fffffff",
    "18446744073709551616",
    "-0.0",
    "~",
    "true",
    "[[[[",
    "{a: {",
    "&a [*a, *a]",
    "!!binary x",
    "\u{202e}",
    "\u{0}",
    "- - - -",
    "'",
    "\"\\u0000\"",
    "? ",
    "<<: *a",
    "%YAML 9",
    "2026-02-30T25:61:00Z",
    "../../etc/passwd",
    "\t",
];

/// Reads a text as each kind of file would be read.
fn read(kind: usize, text: &str) {
    let no_file = |_: &str| -> Result<String, String> { Err("no such file".to_string()) };
    match kind {
        0 => complaints(read_cell(text, "cell.yaml", None, Path::new("/nowhere"), &|_| {
            Err("no such file".to_string())
        })),
        1 => complaints(CameraCalibration::parse(text, "camera.yaml")),
        2 => complaints(HandEyeCalibration::parse(text, "hand_eye.yaml")),
        3 => complaints(TableCalibration::parse(text, "table.yaml")),
        4 => {
            let context =
                JobContext { goal: None, approval: Approval::Never, read_goal: &no_file, found: None };
            complaints(read_job(text, "job.yaml", &context));
        }
        5 => complaints(parse_goal_file(text, "goal.yaml", None)),
        _ => complaints(parse_with_sound_goals(text, "instance.yaml", &|_| None)),
    }
}

/// A complaint is printed as a person would read it.
fn complaints<T>(read: Result<T, Diagnostics>) {
    if let Err(complaints) = read {
        assert!(!complaints.to_string().is_empty(), "a refusal without a word");
    }
}

fn spoil(sound: &[&str], kind: usize, rng: &mut ChaCha8Rng) -> String {
    let mut bytes = sound[kind].as_bytes().to_vec();
    for _ in 0..rng.random_range(1..=4) {
        let at = rng.random_range(0..=bytes.len());
        match rng.random_range(0..7) {
            0 if at < bytes.len() => bytes[at] = rng.random(),
            1 => bytes.truncate(at),
            2 => bytes.insert(at, rng.random()),
            3 if at < bytes.len() => {
                let to = (at + rng.random_range(1..40)).min(bytes.len());
                bytes.drain(at..to);
            }
            4 => {
                let other = sound[rng.random_range(0..sound.len())].as_bytes();
                let from = rng.random_range(0..other.len());
                let to = (from + rng.random_range(1..200)).min(other.len());
                bytes.splice(at..at, other[from..to].iter().copied());
            }
            5 => replace_a_number(&mut bytes, at, STRANGE[rng.random_range(0..STRANGE.len())]),
            _ => {
                let times = 1 << rng.random_range(0..8);
                let strange = STRANGE[rng.random_range(0..STRANGE.len())].repeat(times);
                bytes.splice(at..at, strange.bytes());
            }
        }
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

/// Puts a text in the place of the first number after `at`.
fn replace_a_number(bytes: &mut Vec<u8>, at: usize, by: &str) {
    let is_number = |byte: &u8| byte.is_ascii_digit() || matches!(byte, b'.' | b'-');
    let Some(from) = bytes[at..].iter().position(is_number).map(|offset| at + offset) else { return };
    let length = bytes[from..].iter().take_while(|byte| is_number(byte)).count();
    bytes.splice(from..from + length, by.bytes());
}

fn wanted() -> Option<usize> {
    std::env::var("CELLD_SPOILT").ok().and_then(|text| text.parse().ok())
}

/// Most memory that this process has had, MB.
fn peak_mb() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap_or_default();
    line.trim().split(' ').next().and_then(|kb| kb.parse::<u64>().ok()).unwrap_or(0) / 1024
}

#[test]
fn spoilt_files_are_survived_by_every_reader() {
    let sound = [CONFIG, CAMERA, HAND_EYE, TABLE, JOB, GOAL, INSTANCE];
    let (count, mut slowest) = (wanted().unwrap_or(4000), (Duration::ZERO, 0));
    for seed in 0..count as u64 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let kind = rng.random_range(0..sound.len());
        let text = spoil(&sound, kind, &mut rng);
        let began = Instant::now();
        let survived = std::panic::catch_unwind(|| read(kind, &text));
        assert!(survived.is_ok(), "seed {seed}, kind {kind}:\n{text}");
        slowest = slowest.max((began.elapsed(), seed));
    }
    if wanted().is_some() {
        let (time, seed) = (slowest.0.as_secs_f64() * 1e3, slowest.1);
        eprintln!("{count} files: slowest {time:.1} ms (seed {seed}), most memory {} MB", peak_mb());
    }
}

#[test]
fn spoilt_pictures_are_survived() {
    let picture = Image::filled(320, 240, [120, 60, 200]);
    let depth = DepthImage::from_metres(64, 48, vec![0.5; 64 * 48]).expect("a depth picture");
    let sound = [
        picture.encode_png().expect("encoded"),
        picture.encode_jpeg(80).expect("encoded"),
        depth.encode_png(1e-4).expect("encoded"),
    ];
    let (count, mut slowest) = (wanted().map_or(300, |files| files / 100), (Duration::ZERO, 0));
    for seed in 0..count as u64 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut bytes = sound[rng.random_range(0..sound.len())].clone();
        for _ in 0..rng.random_range(1..=6) {
            let at = rng.random_range(0..bytes.len());
            match rng.random_range(0..4) {
                0 => bytes.truncate(at.max(8)),
                1 => bytes[at] = rng.random(),
                2 => bytes[at] ^= 1 << rng.random_range(0..8),
                // Headers first: sizes and lengths are there.
                _ => bytes[at % 64] = rng.random(),
            }
        }
        let began = Instant::now();
        let survived = std::panic::catch_unwind(|| {
            drop(Image::decode(&bytes));
            drop(DepthImage::decode(&bytes, 1e-4));
        });
        assert!(survived.is_ok(), "seed {seed}");
        slowest = slowest.max((began.elapsed(), seed));
    }
    if wanted().is_some() {
        let (time, seed) = (slowest.0.as_secs_f64() * 1e3, slowest.1);
        eprintln!("{count} pictures: slowest {time:.1} ms (seed {seed}), most memory {} MB", peak_mb());
    }
}
