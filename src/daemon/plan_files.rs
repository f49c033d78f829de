//! Plans between the machine, the journal and the job's folder.
//!
//! In: a plan as the supervisor has it. Out: the journal's record of it; `plan.json` and `plan.svg` in the
//! job's folder, for whoever has to approve it. The files are copies: the journal alone is the truth.

use crate::config::cell::CellConfig;
use crate::jobs::record::{GoalPose, PlanRecord, PlanStep, StepKind};
use crate::jobs::utc;
use crate::report::colour;
use crate::report::route_svg::{DrawnMove, DrawnPlan};
use cell_edge::files::{FileError, write_whole};
use cell_machine::supervisor::input::PlanNote;
use cell_machine::supervisor::order::RouteAction;
use cell_vision::annotate::moves;
use rearrange::geometry::pose::Pose2;
use rearrange::tabletop::instance::Workspace;
use serde_json::json;
use std::path::Path;

/// Corners of a curve as it is drawn, at the least.
const OUTLINE_CORNERS: usize = 32;

/// Poses by name as the journal has them.
pub fn poses(pairs: &[(String, Pose2)]) -> Vec<GoalPose> {
    pairs.iter().map(|(id, pose)| GoalPose { id: id.clone(), pose: *pose }).collect()
}

/// A plan as the journal has it; numbers that JSON cannot hold are left out.
pub fn record_of(note: &PlanNote, unix_s: f64) -> PlanRecord {
    let finite = |value: f64| Some(value).filter(|value| value.is_finite());
    let step = |RouteAction { object, from, to, to_goal }: &RouteAction| {
        let kind = if *to_goal { StepKind::Goal } else { StepKind::Buffer };
        PlanStep { object: object.clone(), from: *from, to: *to, kind }
    };
    PlanRecord {
        number: note.number,
        steps: note.actions.iter().map(step).collect(),
        made: note.made,
        lower_bound: finite(note.lower_bound),
        seconds: finite(note.seconds),
        table: poses(&note.table),
        preview: note.preview,
        sight_age_s: finite(note.sight_age_s).unwrap_or(0.0),
        unix_s,
    }
}

/// A step of the journal as the supervisor has it.
pub fn action_of(step: &PlanStep) -> RouteAction {
    let PlanStep { object, from, to, kind } = step;
    RouteAction { object: object.clone(), from: *from, to: *to, to_goal: *kind == StepKind::Goal }
}

/// The moves of a plan with the outlines of their objects, for the picture; objects that the cell no longer
/// knows are left out.
pub fn drawn_moves(plan: &PlanRecord, cell: &CellConfig) -> Vec<moves::DrawnMove> {
    let drawn = |(index, step): (usize, &PlanStep)| {
        let (place, object) = cell.objects.iter().enumerate().find(|(_, object)| object.id == step.object)?;
        Some(moves::DrawnMove {
            number: index + 1,
            from: step.from,
            to: step.to,
            height_m: object.height.unwrap_or(0.0),
            outline: object.footprint.outline(OUTLINE_CORNERS),
            colour: colour::rgb(place).map(|share| (share * 255.0).round() as u8),
        })
    };
    plan.steps.iter().enumerate().filter_map(drawn).collect()
}

/// Writes `plan.json` and `plan.svg` into a job's folder.
///
/// # Errors
/// The system refuses to write one of them.
pub fn write(folder: &Path, id: &str, plan: &PlanRecord, cell: &CellConfig) -> Result<(), FileError> {
    let json = serde_json::to_string_pretty(&plan_json(id, plan)).expect("a plan has string keys only");
    write_whole(&folder.join("plan.json"), (json + "\n").as_bytes())?;
    match drawing(plan, cell, &title(id, plan)) {
        Some(svg) => write_whole(&folder.join("plan.svg"), svg.as_bytes()),
        None => Ok(()),
    }
}

fn plan_json(id: &str, plan: &PlanRecord) -> serde_json::Value {
    json!({
        "job": id, "number": plan.number, "preview": plan.preview, "sight_age_s": plan.sight_age_s, "made": utc::text(plan.unix_s),
        "moves": plan.steps.len(), "buffers": plan.buffers(), "lower_bound": plan.lower_bound,
        "seconds": plan.seconds, "actions": plan.steps, "after_moves": plan.made, "table": plan.table,
    })
}

fn title(id: &str, plan: &PlanRecord) -> String {
    let what = match plan.preview {
        true => format!("preview from what was seen {:.0} s before", plan.sight_age_s),
        false => "plan".to_string(),
    };
    format!("job {id}: {what}, {} pick-n-places", plan.steps.len())
}

/// The picture of a plan; `None` where the catalogue does not have what it moves.
pub fn drawing(plan: &PlanRecord, cell: &CellConfig, title: &str) -> Option<String> {
    drawn_plan(plan, cell, title, |drawn| drawn.svg())
}

/// Its moves one after the other; `None` as for [`drawing`].
pub fn film(plan: &PlanRecord, cell: &CellConfig, title: &str) -> Option<String> {
    drawn_plan(plan, cell, title, |drawn| drawn.animation())
}

fn drawn_plan(
    plan: &PlanRecord,
    cell: &CellConfig,
    title: &str,
    draw: impl FnOnce(&DrawnPlan) -> Option<String>,
) -> Option<String> {
    let table: Vec<_> = plan.table.iter().map(|object| (object.id.clone(), object.pose)).collect();
    let drawn = |PlanStep { object, from, to, kind }: &PlanStep| DrawnMove {
        object: object.clone(),
        from: *from,
        to: *to,
        to_goal: *kind == StepKind::Goal,
    };
    let moves: Vec<_> = plan.steps.iter().map(drawn).collect();
    let workspace = Workspace { width: cell.workspace.width_m, height: cell.workspace.height_m };
    let keep_out = &cell.workspace.keep_out;
    draw(&DrawnPlan { objects: &cell.objects, workspace, keep_out, table: &table, moves: &moves, title })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_file_says_when_a_plan_was_made_and_after_how_many_moves() {
        let plan = PlanRecord { number: 3, made: 2, unix_s: 1.7e9, ..PlanRecord::default() };
        let json = plan_json("tidy", &plan);
        assert_eq!(
            (json["made"].as_str(), json["after_moves"].as_u64()),
            (Some("2023-11-14T22:13:20Z"), Some(2))
        );
    }
}
