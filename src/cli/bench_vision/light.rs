//! The parts of `celld bench vision` about poor pictures: degraded ones with markers, cluttered ones
//! without.
//!
//! In: the arguments. Out: each part's table for people and its figures as JSON; `None` after Ctrl-C.

use crate::bench::vision::degraded::{self, Subject};
use crate::bench::vision::{Bench, Task, empty};
use crate::cli::bench_vision::args::{BenchVisionArgs, Figures};
use crate::config::pictures::read_picture;
use cell_values::image::GrayImage;
use cell_vision::detect::DetectSettings;
use indicatif::{ProgressBar, ProgressStyle};
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

/// What is found in degraded pictures: those that the benchmark renders, or recorded ones.
pub(super) fn degraded(args: &BenchVisionArgs, stop: &AtomicBool) -> Result<Option<Figures>, String> {
    let subjects = match &args.recorded {
        Some(folder) => photographs(folder)?.into_iter().map(Subject::taken).collect::<Result<_, _>>()?,
        None => rendered(args)?,
    };
    let bar = bar(subjects.len() as u64);
    let task = degraded::Task { seed: args.seed, threads: usize::from(args.threads) };
    let report = degraded::run(&task, &subjects, stop, &|| bar.inc(1))?;
    bar.finish_and_clear();
    let Some(report) = report else { return Ok(None) };
    let mut text = format!(
        "degraded pictures  {} markers in {} pictures; found in percent, false ids, median corner error in \
         px, ms\n{:<20}",
        report.markers, report.pictures, ""
    );
    for name in report.columns {
        let _ = write!(text, "{name:>22}");
    }
    text.push_str("  behind\n");
    for row in &report.rows {
        let _ = write!(text, "{:<20}", row.degradation);
        for cell in &row.columns {
            let percent = format!("{:.1}", cell.found_percent);
            let false_ids = cell.false_ids;
            let (px, ms) = (cell.corner_median_px, cell.ms);
            let _ = write!(text, "{:>22}", format!("{percent:>5} {false_ids:>3} {px:>5.2} {ms:>4.0}"));
        }
        let _ = writeln!(text, "{:>8.1}", row.behind_points);
    }
    let figures = serde_json::to_value(&report).map_err(|error| error.to_string())?;
    Ok(Some((text, figures)))
}

/// What is read in pictures without markers.
pub(super) fn empty(args: &BenchVisionArgs, stop: &AtomicBool) -> Result<Option<Figures>, String> {
    let task = empty::Task {
        pictures: args.empty as usize,
        seed: args.seed,
        threads: usize::from(args.threads),
        photographs: args.photographs.as_deref().map(photographs).transpose()?.unwrap_or_default(),
    };
    let bar = bar(u64::from(args.empty));
    let report = empty::run(&task, stop, &|| bar.inc(1))?;
    bar.finish_and_clear();
    let Some(report) = report else { return Ok(None) };
    let [one, middle, two] = report.library;
    let mut text = format!(
        "pictures without   {} cluttered, degraded pictures, {} photographs\n\
         false ids          {} in one pass, {} with every way, {} with a catalogue expected\n\
         the library        {one} at decimation 1, {middle} at 1.5, {two} at 2, in {} of them\n",
        report.pictures,
        task.photographs.len(),
        report.one_pass.len(),
        report.thorough.len(),
        report.expecting.len(),
        report.library_pictures
    );
    for found in report.expecting.iter().chain(&report.thorough).chain(&report.one_pass) {
        let _ = writeln!(text, "  picture {}: {:?}", found.picture, found.detection);
    }
    let figures = serde_json::to_value(&report).map_err(|error| error.to_string())?;
    Ok(Some((text, figures)))
}

fn rendered(args: &BenchVisionArgs) -> Result<Vec<Subject>, String> {
    let (seed, settings) = (args.seed, DetectSettings::default());
    let bench = Bench::new(Task { frames: 5, seed, settings, threads: 1, calibrated: false })?;
    let frames = bench.frames(args.pictures as usize).into_iter();
    Ok(frames.map(|(picture, markers)| Subject::rendered(picture, markers)).collect())
}

/// All pictures of a folder, in grey.
fn photographs(folder: &Path) -> Result<Vec<GrayImage>, String> {
    let entries = std::fs::read_dir(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    let mut files: Vec<PathBuf> =
        entries.flatten().map(|entry| entry.path()).filter(|path| is_picture(path)).collect();
    if files.is_empty() {
        return Err(format!("{}: no PNG or JPEG file in it", folder.display()));
    }
    files.sort();
    files.iter().map(|file| read_picture(file).map(|picture| picture.gray())).collect()
}

fn is_picture(path: &Path) -> bool {
    let extension = path.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
    ["png", "jpg", "jpeg"].iter().any(|known| extension.eq_ignore_ascii_case(known))
}

/// A bar with the time that is left.
fn bar(length: u64) -> ProgressBar {
    let bar = ProgressBar::new(length);
    let style = ProgressStyle::with_template("{wide_bar} {pos}/{len}, {eta} left");
    if let Ok(style) = style {
        bar.set_style(style);
    }
    bar
}
