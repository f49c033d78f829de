//! `celld bench vision`: how often markers are found, how exact their poses are, how long it takes; how
//! surely a bumped camera and things without a marker are noticed; how exact the camera's mount comes out of
//! calibration; what is found in poor pictures, and what is read where there is nothing.
//!
//! In: which parts, how many frames, scenes and looks, a seed, detector settings. Out: a table for people,
//! or one JSON object; some of the frames as pictures with the truth about their corners where that is
//! requested. Exit code 0, 2 for usage, 130 after Ctrl-C.

mod args;
mod light;
mod parts;

use crate::bench::vision::tally::Accuracy;
use crate::bench::vision::{Bench, Report, Task};
use crate::cli::bench_vision::args::{Figures, Part};
use cell_edge::files;
use cell_edge::terminal::{complain, print};
use cell_vision::detect::DetectSettings;
use indicatif::ProgressBar;
use std::fmt::Write;
use std::path::Path;
use std::sync::atomic::AtomicBool;

pub use crate::cli::bench_vision::args::BenchVisionArgs;

/// Frames that `--save` writes at most.
const SAVED: usize = 60;

/// Runs the benchmark; `stop` is set by Ctrl-C. Returns the exit code.
pub fn run(args: &BenchVisionArgs, stop: &AtomicBool) -> u8 {
    match run_all(args, stop) {
        Ok(Some(text)) => {
            print(&text);
            0
        }
        Ok(None) => 130,
        Err(message) => {
            complain(&format!("celld bench vision: {message}"));
            2
        }
    }
}

fn run_all(args: &BenchVisionArgs, stop: &AtomicBool) -> Result<Option<String>, String> {
    let (mut text, mut json) = (String::new(), serde_json::Map::new());
    for part in Part::ALL.into_iter().filter(|part| args.part.contains(part)) {
        let done = match part {
            Part::Markers => markers(args, stop)?,
            Part::Drift => parts::drift(args, stop)?,
            Part::Foreign => parts::foreign(args, stop)?,
            Part::HandEye => Some(parts::hand_eye(args)?),
            Part::Degraded => light::degraded(args, stop)?,
            Part::Empty => light::empty(args, stop)?,
        };
        let Some((reported, figures)) = done else { return Ok(None) };
        if !text.is_empty() {
            text.push('\n');
        }
        text.push_str(&reported);
        match figures {
            // The figures of the markers are at the top.
            serde_json::Value::Object(figures) if part == Part::Markers => json.extend(figures),
            figures => {
                let name = match part {
                    Part::Markers => "markers",
                    Part::Drift => "drift",
                    Part::Foreign => "foreign",
                    Part::HandEye => "hand_eye",
                    Part::Degraded => "degraded",
                    Part::Empty => "empty",
                };
                json.insert(name.to_owned(), figures);
            }
        }
    }
    Ok(Some(if args.format == "json" { format!("{}\n", serde_json::Value::Object(json)) } else { text }))
}

fn markers(args: &BenchVisionArgs, stop: &AtomicBool) -> Result<Option<Figures>, String> {
    let settings = DetectSettings {
        decimate: args.decimate,
        sharpen_px: args.sharpen,
        tone: args.tone,
        sub_pixel: !args.library_corners,
        ..DetectSettings::default()
    };
    let task = Task {
        frames: args.frames(),
        seed: args.seed,
        settings,
        threads: usize::from(args.threads),
        calibrated: !args.no_calibration,
    };
    let bench = Bench::new(task)?;
    if let Some(folder) = &args.save {
        save(&bench, SAVED.min(task.frames), folder)?;
    }
    let bar = ProgressBar::new(task.frames.div_ceil(5) as u64);
    let report = bench.run(stop, &|_, _| bar.inc(1))?;
    bar.finish_and_clear();
    let Some(report) = report else { return Ok(None) };
    let figures = serde_json::to_value(&report).map_err(|error| error.to_string())?;
    Ok(Some((table(&report), figures)))
}

fn save(bench: &Bench, count: usize, folder: &Path) -> Result<(), String> {
    files::create_folder(folder).map_err(|error| error.to_string())?;
    let mut truth = Vec::new();
    for (number, (picture, markers)) in bench.frames(count).into_iter().enumerate() {
        let name = format!("frame-{number:03}.png");
        let bytes = picture.encode_png().map_err(|error| error.to_string())?;
        files::write_atomic(&folder.join(&name), &bytes).map_err(|error| error.to_string())?;
        let markers: Vec<_> =
            markers.iter().map(|(id, corners)| serde_json::json!({"id": id, "corners": corners})).collect();
        truth.push(serde_json::json!({"image": name, "markers": markers}));
    }
    let text = serde_json::to_string(&truth).map_err(|error| error.to_string())?;
    files::write_atomic(&folder.join("truth.json"), text.as_bytes()).map_err(|error| error.to_string())
}

fn table(report: &Report) -> String {
    let mut text = format!(
        "{} frames of 1280 x 720, seed {}\n\
         detection rate    {:.3} % of {} markers wholly visible; {} false ids, {} misplaced\n\
         corners           median {:.3} px, p99 {:.3} px\n\
         time              {:.1} ms a frame on a core, {:.1} ms with two threads; the C library alone {:.1} \
         ms, ratio {:.2}\n",
        report.frames,
        report.seed,
        100.0 * report.detection_rate,
        report.visible,
        report.false_ids,
        report.misplaced,
        report.corner_median_px,
        report.corner_p99_px,
        report.ms_per_frame,
        report.ms_two_threads,
        report.ms_library,
        report.ratio_to_c_library,
    );
    if let Some(column) = &report.calibrated {
        let lens = column.lens;
        let _ = writeln!(
            text,
            "calibrated lens   reprojection {:.3} px, focal length {:.3} %, principal point {:.2} px, \
             distortion {:.2} px off",
            lens.reprojection_px,
            lens.focal_error_percent,
            lens.centre_error_px,
            lens.distortion_map_error_px
        );
    }
    text.push_str("\n                          true lens  calibrated\n");
    let calibrated = report.calibrated.as_ref().map(|column| &column.accuracy);
    type Line = (&'static str, fn(&Accuracy) -> f64);
    let lines: [Line; 12] = [
        ("position median mm", |a| a.position_median_mm),
        ("position p99 mm", |a| a.position_p99_mm),
        ("angle median deg", |a| a.angle_median_deg),
        ("angle p99 deg", |a| a.angle_p99_deg),
        ("std real / claimed", |a| a.std_ratio),
        ("the same by medians", |a| a.std_ratio_median),
        ("five fused, median mm", |a| a.fused_median_mm),
        ("five fused, p99 mm", |a| a.fused_p99_mm),
        ("five fused, std ratio", |a| a.fused_std_ratio),
        ("the same by medians", |a| a.fused_std_ratio_median),
        ("poses", |a| a.poses as f64),
        ("refused", |a| a.refused as f64),
    ];
    for (name, value) in lines {
        let digits = if name == "poses" || name == "refused" { 0 } else { 3 };
        let _ = write!(text, "{name:<24} {:>10.digits$}", value(&report.accuracy));
        if let Some(accuracy) = calibrated {
            let _ = write!(text, " {:>11.digits$}", value(accuracy));
        }
        text.push('\n');
    }
    text
}
