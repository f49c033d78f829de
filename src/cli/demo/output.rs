//! The files and the summary a demo leaves behind.
//!
//! In: a [`DemoOutcome`]. Out: `report.html`, `plan.svg`, `start.png`, `end.png` and `result.json` in the
//! output folder, the summary on stdout, and the exit code: 0 only if the simulated world itself says that
//! every object is where the job wanted it.

use crate::cell::code::JobStatus;
use crate::cell::supervisor::order::JobReport;
use crate::cli::demo::cell::DemoChoice;
use crate::cli::demo::run::DemoOutcome;
use crate::cli::demo::watch::Watch;
use crate::cli::task::outln;
use crate::report::html::html;
use crate::report::plan_svg::plan_svg;
use crate::report::run::{Drawing, Figures, MoveRow, ObjectRow, Picture, RunReport, deviation};
use crate::report::summary::summary;
use crate::report::table_svg::{DrawnObject, TableDrawing, table_svg};
use cell_values::image::Image;
use rearrange::geometry::pose::Pose2;
use rearrange::planning::plan::{Action, ActionKind};
use rearrange::planning::problem::Problem;
use rearrange::tabletop::instance::Instance;
use serde_json::json;
use std::path::Path;

/// What the demo requires: every object within this of its goal, in truth and as measured.
const GOOD_MM: f64 = 2.0;
const GOOD_DEG: f64 = 1.0;

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
    if let Some(svg) = first_plan_svg(&outcome.watch, instance) {
        save("plan.svg", svg.as_bytes());
    }
    for (name, images) in
        [("start.png", &outcome.watch.first_look[..]), ("end.png", outcome.watch.last_look())]
    {
        if let Some(png) = stacked(images).and_then(|image| image.encode_png().ok()) {
            save(name, &png);
        }
    }
    save("result.json", result_json(outcome, &report, choice).as_bytes());
    outln!("report: {}", out.join("report.html").display());
    u8::from(failed || !report.reached)
}

fn report(outcome: &DemoOutcome, instance: &Instance, choice: &DemoChoice) -> RunReport {
    let watch = &outcome.watch;
    let objects: Vec<ObjectRow> = instance
        .objects
        .iter()
        .filter(|object| !object.fixed)
        .map(|object| ObjectRow {
            id: object.id.clone(),
            goal: object.goal,
            measured: watch.last_seen.as_ref().and_then(|seen| seen.object(&object.id)).map(|o| o.pose),
            truth: outcome.truth.iter().find(|(id, _)| *id == object.id).map(|(_, pose)| *pose),
        })
        .collect();
    let good = |goal: Option<Pose2>, pose: Option<Pose2>| {
        goal.is_none() || deviation(goal, pose).is_some_and(|d| d.mm <= GOOD_MM && d.deg <= GOOD_DEG)
    };
    let all_good = objects.iter().all(|o| good(o.goal, o.truth) && good(o.goal, o.measured));
    let job = watch.report.as_ref();
    let done = job.is_some_and(|job| job.end == JobStatus::Done);
    RunReport {
        title: "celld demo".to_string(),
        reached: done && all_good,
        headline: match job {
            None => "the job was not finished".to_string(),
            Some(job) if done && !all_good => format!("{}; but the world says otherwise", job.message),
            Some(job) => job.message.clone(),
        },
        figures: Figures {
            objects: objects.len(),
            moves: job.map_or(watch.done.len(), |job| job.moves),
            buffers: watch.done.iter().filter(|(step, _)| !step.3).count(),
            lower_bound: job.and_then(|job| job.lower_bound),
            plans: watch.plans,
            looks: watch.looks,
            planning_s: job.map(|job| job.planning_seconds),
            cycle_s: job.map(|job| job.seconds),
            tolerance_mm: GOOD_MM,
            tolerance_deg: GOOD_DEG,
        },
        moves: moves(watch),
        objects,
        pictures: pictures(watch),
        drawings: drawings(watch, instance),
        log: watch.log.clone(),
        settings: settings(outcome, instance, choice),
    }
}

fn settings(outcome: &DemoOutcome, instance: &Instance, choice: &DemoChoice) -> Vec<(String, String)> {
    let calibration = &outcome.calibration;
    let pair = |key: &str, value: String| (key.to_string(), value);
    vec![
        pair("table", format!("{:.2} x {:.2} m", instance.workspace.width, instance.workspace.height)),
        pair("density", format!("{:.2}", instance.density())),
        pair("solver", choice.solver.to_string()),
        pair("objective", choice.objective.to_string()),
        pair("seed", choice.seed.to_string()),
        pair("time factor", format!("{} asked, {:.1} reached", choice.time_factor, outcome.factor)),
        pair("calibration", format!("{:.2} px rms", calibration.reprojection_px_rms)),
        pair(
            "held out",
            calibration.held_out_rms_m.map_or("-".to_string(), |m| format!("{:.2} mm", m * 1e3)),
        ),
    ]
}

fn moves(watch: &Watch) -> Vec<MoveRow> {
    let mut before = None;
    watch
        .done
        .iter()
        .map(|((object, from, to, to_goal), at)| {
            let seconds = before.map(|before| at.since(before).as_secs_f64());
            before = Some(*at);
            MoveRow { object: object.clone(), buffer: !to_goal, from: *from, to: *to, seconds, vacuum: None }
        })
        .collect()
}

fn pictures(watch: &Watch) -> Vec<Picture> {
    let picture = |caption: &str, images: &[Image]| {
        let bytes = stacked(images)?.encode_png().ok()?;
        Some(Picture { caption: caption.to_string(), media_type: "image/png", bytes })
    };
    let (first, last) = (&watch.first_look[..], watch.last_look());
    [picture("Before: the first look, with the markers found", first), picture("After: the last look", last)]
        .into_iter()
        .flatten()
        .collect()
}

fn drawings(watch: &Watch, instance: &Instance) -> Vec<Drawing> {
    let seen = watch.last_seen.as_ref();
    let drawing = TableDrawing {
        title: "Start, goal and measured end",
        width_m: instance.workspace.width,
        height_m: instance.workspace.height,
        keep_out: instance.keep_out.iter().map(|region| (&region.footprint, region.pose)).collect(),
        objects: instance
            .objects
            .iter()
            .map(|object| DrawnObject {
                id: &object.id,
                footprint: &object.footprint,
                start: object.start,
                goal: object.goal,
                measured: seen.and_then(|seen| seen.object(&object.id)).map(|o| o.pose),
            })
            .collect(),
    };
    let mut out = vec![Drawing { caption: drawing.title.to_string(), svg: table_svg(&drawing) }];
    if let Some(svg) = first_plan_svg(watch, instance) {
        out.push(Drawing { caption: "The first plan: numbered moves".to_string(), svg });
    }
    out
}

/// The first plan on the table as it was measured then.
fn first_plan_svg(watch: &Watch, instance: &Instance) -> Option<String> {
    let seen = watch.first_seen.as_ref()?;
    let mut measured = instance.clone();
    measured.overlap_tolerance = 1.0;
    for object in &mut measured.objects {
        object.start = seen.object(&object.id).map(|o| o.pose).or(object.start);
    }
    let problem = Problem::new(&measured).ok()?;
    let actions: Option<Vec<Action>> = watch
        .plan
        .iter()
        .map(|(id, from, to, to_goal)| {
            let object = problem.objects.iter().position(|object| object.id == *id)?;
            let kind = if *to_goal { ActionKind::Goal } else { ActionKind::Buffer };
            Some(Action { object, from: *from, to: *to, kind })
        })
        .collect();
    Some(plan_svg(&problem, &actions?, "celld demo"))
}

/// Pictures of one look, one above the other.
fn stacked(images: &[Image]) -> Option<Image> {
    let first = images.first()?;
    let height = images.iter().map(|image| image.height).sum();
    let rgb = images.iter().flat_map(|image| image.rgb.iter().copied()).collect();
    Image::from_rgb(first.width, height, rgb).ok()
}

fn result_json(outcome: &DemoOutcome, report: &RunReport, choice: &DemoChoice) -> String {
    let error = |goal: Option<Pose2>, pose: Option<Pose2>| {
        deviation(goal, pose).map(|d| json!({"mm": d.mm, "deg": d.deg}))
    };
    let objects: Vec<_> = report
        .objects
        .iter()
        .map(|o| {
            json!({
                "id": o.id, "goal": o.goal, "measured": o.measured, "truth": o.truth,
                "measured_error": error(o.goal, o.measured), "true_error": error(o.goal, o.truth),
            })
        })
        .collect();
    let job = outcome.watch.report.as_ref();
    let worst = |pick: fn(&ObjectRow) -> Option<Pose2>| {
        let errors = report.objects.iter().filter_map(|o| deviation(o.goal, pick(o)));
        errors.fold((0.0f64, 0.0f64), |(mm, deg), d| (mm.max(d.mm), deg.max(d.deg)))
    };
    let (true_mm, true_deg) = worst(|o| o.truth);
    let (measured_mm, measured_deg) = worst(|o| o.measured);
    let value = json!({
        "reached": report.reached, "headline": report.headline, "code": job.map(JobReport::code_text),
        "seed": choice.seed, "solver": choice.solver.as_str(), "objective": choice.objective.as_str(), "moves": report.figures.moves,
        "buffers": report.figures.buffers, "lower_bound": report.figures.lower_bound,
        "plans": report.figures.plans, "looks": report.figures.looks,
        "planning_seconds": report.figures.planning_s, "cycle_seconds": report.figures.cycle_s,
        "time_factor_reached": outcome.factor,
        "worst": {"true_mm": true_mm, "true_deg": true_deg, "measured_mm": measured_mm, "measured_deg": measured_deg},
        "objects": objects,
    });
    serde_json::to_string_pretty(&value).unwrap_or_default() + "\n"
}
