//! The files and the summary a demo leaves behind.
//!
//! In: a [`DemoOutcome`]. Out: `report.html`, `plan.svg`, `start.png`, `end.png` and `result.json` in the
//! output folder, the summary on stdout, and the exit code: 0 only if the wanted arrangement was reached and
//! everything is written.

use crate::cli::task::outln;
use crate::demo::cell::DemoChoice;
use crate::demo::outcome::{DemoOutcome, first_plan_svg, look_png, report, result_json};
use crate::report::html::html;
use crate::report::summary::summary;
use rearrange::tabletop::instance::Instance;
use std::path::Path;

/// Writes everything; returns the exit code.
pub fn write(outcome: &DemoOutcome, instance: &Instance, choice: &DemoChoice, out: &Path) -> u8 {
    let report = report(outcome, instance, choice);
    outln!("{}", summary(&report));
    if let Some(fault) = &outcome.recording_fault {
        eprintln!("recording: {fault}");
    }
    let mut failed = false;
    let mut save = |name: &str, bytes: &[u8]| {
        let path = out.join(name);
        if let Err(error) = std::fs::write(&path, bytes) {
            eprintln!("celld demo: {}: {error}", path.display());
            failed = true;
        }
    };
    save("report.html", html(&report).as_bytes());
    if let Some(svg) = first_plan_svg(&outcome.kept, instance) {
        save("plan.svg", svg.as_bytes());
    }
    for (name, images) in [("start.png", &outcome.kept.first_look[..]), ("end.png", outcome.kept.last_look())]
    {
        if let Some(png) = look_png(images) {
            save(name, &png);
        }
    }
    save("result.json", result_json(outcome, &report, choice).as_bytes());
    outln!("report: {}", out.join("report.html").display());
    u8::from(failed || !report.reached)
}
