//! The parts of `celld bench vision` beside the markers: bumped cameras, things without a marker, the
//! camera's mount.
//!
//! In: the arguments. Out: each part's table for people and its figures as JSON; `None` after Ctrl-C.

use crate::bench::vision::{change, drift, foreign, hand_eye};
use crate::cli::bench_vision::args::{BenchVisionArgs, Figures};
use crate::config::read_cell::{REFERENCE_SHIFT_M, REFERENCE_TURN_DEG};
use cell_vision::observe::reference::DriftLimits;
use indicatif::ProgressBar;
use std::fmt::Write;
use std::sync::atomic::AtomicBool;

/// One in so many tables is also searched by colour.
const COLOUR_SHARE: usize = 5;

/// The mean residual that the example configuration allows, m.
const RESIDUAL_M: f64 = 2e-3;

/// How surely bumps are noticed, with the limits that a configuration has unless it names others.
pub(super) fn drift(args: &BenchVisionArgs, stop: &AtomicBool) -> Result<Option<Figures>, String> {
    let task = drift::Task {
        trials: args.trials as usize,
        looks: args.looks as usize,
        rendered: args.rendered as usize,
        calibrations: args.rounds as usize,
        seed: args.seed,
    };
    let limits = DriftLimits {
        residual_m: RESIDUAL_M,
        shift_m: REFERENCE_SHIFT_M,
        turn_rad: REFERENCE_TURN_DEG.to_radians(),
    };
    let Some(report) = drift::run(task, limits, stop)? else { return Ok(None) };
    let text = format!(
        "drift             camera moved by 2 mm or turned by 0.3 degrees, limits {:.1} mm and {:.2} degrees\n\
         bumps noticed     {} of {}, the least at {:.2} of its limit\n\
         false alarms      {} in {} looks, the nearest at {:.2} of its limit\n\
         rendered looks    {} of {} bumps noticed, {} false alarms in {}\n\
         untouched cells   mount off by up to 0.5 mm, 0.1 degrees: {}\n\
         as calibrated     twenty poses, corners 0.2 px, arm 0.05 mm: {}\n",
        report.limit_mm,
        report.limit_deg,
        report.noticed,
        report.trials,
        report.least_excess,
        report.false_alarms,
        report.looks,
        report.largest_share,
        report.rendered_noticed,
        report.rendered_trials,
        report.rendered_false_alarms,
        report.rendered_looks,
        untouched(&report.within),
        untouched(&report.calibrated)
    );
    Ok(Some((text, json(&report)?)))
}

fn untouched(looks: &drift::Untouched) -> String {
    format!(
        "{} false alarms in {} looks, at {:.2} of the limits (median), {:.2} (largest)",
        looks.alarms, looks.looks, looks.median_share, looks.largest_share
    )
}

/// How surely things without a marker are found.
pub(super) fn foreign(args: &BenchVisionArgs, stop: &AtomicBool) -> Result<Option<Figures>, String> {
    let task = foreign::Task { scenes: args.scenes(), seed: args.seed, threads: usize::from(args.threads) };
    let bar = ProgressBar::new(2 * args.scenes() as u64);
    let report = foreign::run(task, stop, &|| bar.inc(1))?;
    bar.finish_and_clear();
    let Some(report) = report else { return Ok(None) };
    let mut text = format!(
        "foreign objects   {:.2} % of {} found; false alarms on {:.2} % of {} clean tables, {} strays \
         beside real ones\n\
         where             position median {:.1} mm, height median {:.1} mm off\n\
         clean tables      depth on {:.1} % of each and more, the largest piece without {:.1} cm2\n\
         time              {:.1} ms a look on a core\n",
        100.0 * report.found_rate,
        report.scenes,
        100.0 * report.false_alarm_rate,
        report.clean_scenes,
        report.strays,
        report.position_median_mm,
        report.height_median_mm,
        100.0 * report.measured_least,
        report.largest_hole_cm2,
        report.ms_per_look
    );
    for row in &report.kinds {
        let _ = writeln!(text, "  {:<22} {:>4} of {:>4}", row.kind, row.found, row.scenes);
    }
    // Colour pictures take longer to draw, and no figure is required.
    let scenes = args.scenes().div_ceil(COLOUR_SHARE);
    let Some(colour) = change::run(scenes, args.seed, usize::from(args.threads), stop)? else {
        return Ok(None);
    };
    let _ = writeln!(
        text,
        "by colour alone   {:.1} % of {} found; false alarms on {:.1} % of {} clean tables; {:.1} ms a look",
        100.0 * colour.found_rate,
        colour.scenes,
        100.0 * colour.false_alarm_rate,
        colour.scenes,
        colour.ms_per_look
    );
    let mut reported = json(&report)?;
    reported["by_colour"] = json(&colour)?;
    Ok(Some((text, reported)))
}

/// How exact the camera's mount is.
pub(super) fn hand_eye(args: &BenchVisionArgs) -> Result<Figures, String> {
    let report = hand_eye::run(args.rounds as usize, args.seed);
    let mut text = format!(
        "hand-eye          {} rounds of {} poses, corners 0.2 px, arm 0.05 mm; {} refused\n\
         position          median {:.3} mm, worst {:.3} mm\n\
         angle             median {:.4} degrees, worst {:.4} degrees\n",
        report.rounds,
        report.poses,
        report.refused,
        report.position_median_mm,
        report.position_worst_mm,
        report.angle_median_deg,
        report.angle_worst_deg
    );
    for (name, sentence) in &report.degenerate {
        let answer = sentence.as_deref().unwrap_or("NOT REFUSED");
        let _ = writeln!(text, "  {name}: {answer}");
    }
    Ok((text, json(&report)?))
}

fn json(report: &impl serde::Serialize) -> Result<serde_json::Value, String> {
    serde_json::to_value(report).map_err(|error| error.to_string())
}
