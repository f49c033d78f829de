//! What a demo came to: the verdict, the report, the drawings, the result for programs.
//!
//! In: a [`DemoOutcome`]. Out: a [`RunReport`] and texts; nothing is written here. The wanted arrangement
//! counts as reached only if the simulated world itself says that every object is where the job wanted it.

use crate::config::cell::CellConfig;
use crate::demo::cell::DemoChoice;
use crate::demo::kept::Kept;
use crate::report::plan_animation::{FILM_CAPTION, plan_animation};
use crate::report::plan_svg::plan_svg;
use crate::report::run::{Drawing, Figures, MoveRow, ObjectRow, Picture, RunReport, deviation};
use crate::report::table_svg::{DrawnObject, TableDrawing, table_svg};
use crate::report::times_svg::{TimeRow, times_svg};
use cell_calibration::fit::HandEye;
use cell_machine::code::JobStatus;
use cell_machine::supervisor::order::{JobReport, RouteAction};
use cell_machine::times::TimeSplit;
use cell_values::image::Image;
use rearrange::geometry::pose::Pose2;
use rearrange::planning::plan::{Action, ActionKind};
use rearrange::planning::problem::Problem;
use rearrange::tabletop::instance::Instance;
use serde_json::json;

/// What the demo requires: every object within this of its goal, in truth and as measured.
const GOOD_MM: f64 = 2.0;
const GOOD_DEG: f64 = 1.0;

/// What became of a demo.
pub struct DemoOutcome {
    /// The daemon's configuration.
    pub config: CellConfig,
    /// What calibration found.
    pub calibration: HandEye,
    /// Everything that was seen and said.
    pub kept: Kept,
    /// True poses at the end, from the simulated world.
    pub truth: Vec<(String, Pose2)>,
    /// Simulated seconds per second that were reached.
    pub factor: f64,
    /// Why the recording is incomplete, if it is.
    pub recording_fault: Option<String>,
}

/// The run as people read about it, with the verdict.
pub fn report(outcome: &DemoOutcome, instance: &Instance, choice: &DemoChoice) -> RunReport {
    let kept = &outcome.kept;
    let objects: Vec<ObjectRow> = instance
        .objects
        .iter()
        .filter(|object| !object.fixed)
        .map(|object| ObjectRow {
            id: object.id.clone(),
            goal: object.goal,
            measured: kept.last_seen.as_ref().and_then(|seen| seen.object(&object.id)).map(|o| o.pose),
            unseen: None,
            truth: outcome.truth.iter().find(|(id, _)| *id == object.id).map(|(_, pose)| *pose),
        })
        .collect();
    let good = |goal: Option<Pose2>, pose: Option<Pose2>| {
        goal.is_none() || deviation(goal, pose).is_some_and(|d| d.mm <= GOOD_MM && d.deg <= GOOD_DEG)
    };
    let all_good = objects.iter().all(|o| good(o.goal, o.truth) && good(o.goal, o.measured));
    let job = kept.report.as_ref();
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
            moves: job.map_or(kept.done.len(), |job| job.moves),
            buffers: kept.done.iter().filter(|(step, _)| !step.to_goal).count(),
            lower_bound: job.and_then(|job| job.lower_bound),
            plans: Some(kept.plans),
            looks: Some(kept.looks),
            planning_s: job.map(|job| job.planning_seconds),
            cycle_s: job.map(|job| job.seconds),
            tolerance_mm: GOOD_MM,
            tolerance_deg: GOOD_DEG,
        },
        moves: moves(kept),
        objects,
        pictures: pictures(kept),
        drawings: drawings(kept, instance),
        log: kept.log.clone(),
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

fn moves(kept: &Kept) -> Vec<MoveRow> {
    let mut before = None;
    kept.done
        .iter()
        .map(|(RouteAction { object, from, to, to_goal }, at)| {
            let seconds = before.map(|before| at.since(before).as_secs_f64());
            before = Some(*at);
            let (object, buffer) = (object.clone(), !to_goal);
            MoveRow {
                object,
                buffer,
                from: *from,
                to: *to,
                unfinished: None,
                anew: false,
                seconds,
                vacuum: None,
            }
        })
        .collect()
}

fn pictures(kept: &Kept) -> Vec<Picture> {
    let picture = |caption: &str, images: &[Image]| {
        let bytes = look_png(images)?;
        Some(Picture { caption: caption.to_string(), media_type: "image/png", bytes })
    };
    let (first, last) = (&kept.first_look[..], kept.last_look());
    [picture("Before: the first look, with the markers found", first), picture("After: the last look", last)]
        .into_iter()
        .flatten()
        .collect()
}

fn drawings(kept: &Kept, instance: &Instance) -> Vec<Drawing> {
    let seen = kept.last_seen.as_ref();
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
    if let Some(svg) = first_plan_svg(kept, instance) {
        out.push(Drawing { caption: "The first plan: numbered moves".to_string(), svg });
    }
    if let Some((problem, actions)) = first_plan(kept, instance).filter(|(_, actions)| !actions.is_empty()) {
        let svg = plan_animation(&problem, &actions, "celld demo", &[]);
        out.push(Drawing { caption: FILM_CAPTION.to_string(), svg });
    }
    let svg = times_svg(&time_rows(kept));
    if !svg.is_empty() {
        let caption = "Where the time of each move went, the look before it included".to_string();
        out.push(Drawing { caption, svg });
    }
    out
}

/// Each pick-n-place, with its object, and all looks at the whole table together.
fn time_rows(kept: &Kept) -> Vec<TimeRow> {
    let Some(job) = &kept.report else { return Vec::new() };
    let row = |label: String, split: &TimeSplit| TimeRow {
        label,
        parts: split.iter().map(|(what, seconds)| (what.as_str(), seconds)).collect(),
    };
    let mut whole = TimeSplit::default();
    job.times.rounds.iter().for_each(|split| whole.add_all(split));
    let object = |index: usize| kept.done.get(index).map_or("", |(step, _)| step.object.as_str());
    let moves = job.times.moves.iter().enumerate();
    let moves = moves.map(|(index, split)| row(format!("{} {}", index + 1, object(index)), split));
    moves.chain(std::iter::once(row("whole table".to_string(), &whole))).collect()
}

/// The first plan on the table as it was measured then.
pub fn first_plan_svg(kept: &Kept, instance: &Instance) -> Option<String> {
    let (problem, actions) = first_plan(kept, instance)?;
    Some(plan_svg(&problem, &actions, "celld demo"))
}

fn first_plan(kept: &Kept, instance: &Instance) -> Option<(Problem, Vec<Action>)> {
    let seen = kept.first_seen.as_ref()?;
    let mut measured = instance.clone();
    measured.overlap_tolerance = 1.0;
    for object in &mut measured.objects {
        object.start = seen.object(&object.id).map(|o| o.pose).or(object.start);
    }
    let problem = Problem::new(&measured).ok()?;
    let actions: Option<Vec<Action>> = kept
        .plan
        .iter()
        .map(|RouteAction { object: id, from, to, to_goal }| {
            let object = problem.objects.iter().position(|object| object.id == *id)?;
            let kind = if *to_goal { ActionKind::Goal } else { ActionKind::Buffer };
            Some(Action { object, from: *from, to: *to, kind })
        })
        .collect();
    Some((problem, actions?))
}

/// Pictures of one look, one above the other, as PNG.
pub fn look_png(images: &[Image]) -> Option<Vec<u8>> {
    stacked(images)?.encode_png().ok()
}

fn stacked(images: &[Image]) -> Option<Image> {
    let first = images.first()?;
    let height = images.iter().map(|image| image.height).sum();
    let rgb = images.iter().flat_map(|image| image.rgb.iter().copied()).collect();
    Image::from_rgb(first.width, height, rgb).ok()
}

/// The verdict and its figures for programs.
pub fn result_json(outcome: &DemoOutcome, report: &RunReport, choice: &DemoChoice) -> String {
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
    let job = outcome.kept.report.as_ref();
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
