//! Goals that are set by hand: what the checker says of them, the nearest place that is free, a plan.
//!
//! In: poses of objects, the cell's configuration, the table as it was seen. Out: complaints by object, a
//! pose, a plan. The checks are those of job files (`jobs/goal`), and the clearance that every new place
//! keeps besides: what is red on the page is refused or has no plan, and nothing else is. Pure but for the
//! caller's clock.

use crate::config::cell::CellConfig;
use crate::jobs::record::GoalPose;
use rearrange::geometry::collision::{Placed, TOUCH_M, overhang};
use rearrange::geometry::pose::Pose2;
use rearrange::tabletop::instance::ObjectSpec;
use serde::Serialize;
use std::f64::consts::TAU;

/// Most objects in a draft.
pub const MOST: usize = 1000;

/// How far from where it was dropped a free place is searched, m, ring by ring, and in how many directions.
const SEARCHED_M: f64 = 0.12;
const RING_M: f64 = 0.002;
const DIRECTIONS: usize = 32;

/// What is wrong with a draft.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GoalFault {
    /// Which objects: one, or two that are in each other's way.
    pub objects: Vec<String>,
    /// `unknown`, `twice`, `fixed`, `overlap`, `near`, `edge`, `keep_out`.
    pub kind: &'static str,
    /// One sentence.
    pub message: String,
}

fn mm(metres: f64) -> String {
    format!("{:.1} mm", metres * 1e3)
}

/// Everything that is wrong with these goals.
pub fn goal_faults(config: &CellConfig, goals: &[GoalPose]) -> Vec<GoalFault> {
    let mut found = Vec::new();
    let mut known: Vec<Wanted> = Vec::new();
    for (index, goal) in goals.iter().enumerate() {
        let one = |kind, message| GoalFault { objects: vec![goal.id.clone()], kind, message };
        if goals[..index].iter().any(|other| other.id == goal.id) {
            found.push(one("twice", format!("{} has two goals", goal.id)));
            continue;
        }
        match config.objects.iter().find(|object| object.id == goal.id) {
            None => found.push(one("unknown", format!("the catalogue has no {}", goal.id))),
            Some(object) if object.fixed => found.push(one("fixed", format!("{} never moves", goal.id))),
            Some(object) => {
                let placed = Placed::new(&object.footprint, goal.pose);
                known.push(Wanted { object, placed, pose: goal.pose });
            }
        }
    }
    for (index, Wanted { object, placed, pose }) in known.iter().enumerate() {
        found.extend(of_the_table(config, object, placed, pose));
        for other in &known[..index] {
            found.extend(of_two(config, (&object.id, placed), (&other.object.id, &other.placed)));
        }
    }
    found
}

/// An object at its goal.
struct Wanted<'a> {
    object: &'a ObjectSpec,
    placed: Placed,
    pose: Pose2,
}

/// Over the edge, or in a place that stays free.
fn of_the_table(config: &CellConfig, object: &ObjectSpec, placed: &Placed, pose: &Pose2) -> Vec<GoalFault> {
    let tolerance = CellConfig::goal_overlap_tolerance_m().max(TOUCH_M);
    let one = |kind, message| GoalFault { objects: vec![object.id.clone()], kind, message };
    let mut found = Vec::new();
    let beyond = overhang(&object.footprint, pose, config.workspace.width_m, config.workspace.height_m);
    if beyond > tolerance {
        found.push(one("edge", format!("{} reaches {} over the table's edge", object.id, mm(beyond))));
    }
    for place in config.obstacles() {
        let depth = placed.penetration(&Placed::new(&place.footprint, place.pose));
        if depth > TOUCH_M {
            let message = format!("{} reaches {} into a place that stays free", object.id, mm(depth));
            found.push(one("keep_out", message));
        }
    }
    found
}

fn of_two(config: &CellConfig, (a, at): (&str, &Placed), (b, there): (&str, &Placed)) -> Option<GoalFault> {
    let objects = vec![a.to_string(), b.to_string()];
    let depth = at.penetration(there);
    if depth > CellConfig::goal_overlap_tolerance_m().max(TOUCH_M) {
        let message = format!("{a} and {b} overlap by {}", mm(depth));
        return Some(GoalFault { objects, kind: "overlap", message });
    }
    let clearance = config.workspace.clearance_m;
    if clearance > 0.0 && at.closer_than(there, clearance - TOUCH_M) {
        let message = format!("{a} and {b} are nearer than the clearance of {}", mm(clearance));
        return Some(GoalFault { objects, kind: "near", message });
    }
    None
}

/// The pose nearest to where `moved` was dropped at which it is in no trouble; its own where it is in none
/// or no place near by is free.
pub fn settled(config: &CellConfig, goals: &[GoalPose], moved: &str) -> Option<Pose2> {
    let index = goals.iter().position(|goal| goal.id == moved)?;
    let object = config.objects.iter().find(|object| object.id == moved)?;
    let others: Vec<(&str, Placed)> = goals
        .iter()
        .filter(|goal| goal.id != moved)
        .filter_map(|goal| {
            let known = config.objects.iter().find(|object| object.id == goal.id)?;
            Some((goal.id.as_str(), Placed::new(&known.footprint, goal.pose)))
        })
        .collect();
    let free = |pose: &Pose2| {
        let placed = Placed::new(&object.footprint, *pose);
        of_the_table(config, object, &placed, pose).is_empty()
            && others.iter().all(|(id, there)| of_two(config, (moved, &placed), (id, there)).is_none())
    };
    let dropped = goals[index].pose;
    let rings = (0..=(SEARCHED_M / RING_M) as usize).map(|ring| ring as f64 * RING_M);
    let tried = rings.flat_map(|radius| {
        let directions = if radius == 0.0 { 1 } else { DIRECTIONS };
        (0..directions).map(move |direction| {
            let (sin, cos) = (TAU * direction as f64 / DIRECTIONS as f64).sin_cos();
            Pose2::new(dropped.x + radius * cos, dropped.y + radius * sin, dropped.theta)
        })
    });
    tried.into_iter().find(free).or(Some(dropped))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::load::load_cell;
    use crate::jobs::goal::parse_goal_file;
    use std::path::Path;

    fn cell() -> CellConfig {
        load_cell(&Path::new(env!("CARGO_MANIFEST_DIR")).join("config/cell.yaml")).unwrap()
    }

    fn goal(id: &str, x: f64, y: f64) -> GoalPose {
        GoalPose { id: id.into(), pose: Pose2::new(x, y, 0.0) }
    }

    fn kinds(goals: &[GoalPose]) -> Vec<&'static str> {
        goal_faults(&cell(), goals).iter().map(|fault| fault.kind).collect()
    }

    #[test]
    fn every_trouble_has_its_objects() {
        assert_eq!(kinds(&[goal("lid", 0.3, 0.3), goal("block", 0.1, 0.1)]), [""; 0]);
        assert_eq!(kinds(&[goal("lid", 0.3, 0.3), goal("block", 0.3, 0.3)]), ["overlap"]);
        // Radius of the lid and half of the block's edge, and half of the clearance.
        assert_eq!(kinds(&[goal("lid", 0.2, 0.2), goal("block", 0.2 + 0.085 + 0.001, 0.2)]), ["near"]);
        assert_eq!(kinds(&[goal("lid", 0.0, 0.3)]), ["edge"]);
        assert_eq!(
            kinds(&[goal("lid", 0.3, 0.3), goal("lid", 0.1, 0.1), goal("mug", 0.1, 0.1)]),
            ["twice", "unknown"]
        );
    }

    /// What the page calls sound is sound as a goal file, and the other way round but for the clearance.
    #[test]
    fn the_page_and_job_files_agree() {
        let cell = cell();
        let obstacles = cell.obstacles();
        let context = cell.goal_context(&obstacles);
        for step in 0..60 {
            let x = 0.2 + 0.003 * f64::from(step);
            let goals = [goal("lid", 0.2, 0.2), goal("block", x, 0.2), goal("plank-1", x, 0.45)];
            let lines: String = goals
                .iter()
                .map(|g| format!("  - {{id: {}, pose: [{}, {}, 0]}}\n", g.id, g.pose.x, g.pose.y))
                .collect();
            let file = parse_goal_file(&format!("objects:\n{lines}"), "goal.yaml", Some(&context));
            let strict = goal_faults(&cell, &goals).iter().any(|fault| fault.kind != "near");
            assert_eq!(file.is_err(), strict, "block at {x}: {file:?}");
        }
    }

    #[test]
    fn what_is_dropped_onto_another_slides_to_the_nearest_free_place() {
        let cell = cell();
        let goals = [goal("lid", 0.25, 0.25), goal("block", 0.3, 0.25)];
        let settled = settled(&cell, &goals, "block").unwrap();
        let moved = [goals[0].clone(), GoalPose { id: "block".into(), pose: settled }];
        assert_eq!(goal_faults(&cell, &moved), []);
        assert!(settled.x > 0.3 && settled.distance(&goals[1].pose) < 0.05, "{settled:?}");
        let free = [goal("lid", 0.25, 0.25), goal("block", 0.1, 0.1)];
        assert_eq!(super::settled(&cell, &free, "block"), Some(free[1].pose), "where it is free it stays");
    }
}
