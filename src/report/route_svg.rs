//! A plan on a table as it was seen, as a picture: for the job's folder and its report.
//!
//! In: the catalogue, where the objects lay, the moves by name. Out: the drawing of `plan_svg`. Objects that
//! were not on the table are left out; an overlap that was measured is drawn as it is. Pure.

use crate::report::plan_animation::plan_animation;
use crate::report::plan_svg::coloured_plan_svg;
use rearrange::geometry::pose::Pose2;
use rearrange::planning::plan::{Action, ActionKind};
use rearrange::planning::problem::Problem;
use rearrange::tabletop::instance::{Instance, KeepOut, ObjectSpec, Workspace};

/// One pick-n-place by the name of its object.
#[derive(Clone, Debug, PartialEq)]
pub struct DrawnMove {
    /// Object of the catalogue.
    pub object: String,
    /// Table frame.
    pub from: Pose2,
    /// Table frame.
    pub to: Pose2,
    /// `to` is its goal, not a buffer.
    pub to_goal: bool,
}

/// A plan and the table that it is for.
#[derive(Clone, Copy, Debug)]
pub struct DrawnPlan<'a> {
    /// The catalogue.
    pub objects: &'a [ObjectSpec],
    /// Extent of the table.
    pub workspace: Workspace,
    /// Places that stay free.
    pub keep_out: &'a [KeepOut],
    /// Where the objects lay.
    pub table: &'a [(String, Pose2)],
    /// In order.
    pub moves: &'a [DrawnMove],
    /// Above the picture.
    pub title: &'a str,
}

impl DrawnPlan<'_> {
    /// The drawing; `None` where a move names an object that was not on the table.
    pub fn svg(&self) -> Option<String> {
        let Drawn { problem, actions, colours } = self.resolved()?;
        Some(coloured_plan_svg(&problem, &actions, self.title, &colours))
    }

    /// The moves as a film; `None` as for [`DrawnPlan::svg`].
    pub fn animation(&self) -> Option<String> {
        let Drawn { problem, actions, colours } = self.resolved()?;
        Some(plan_animation(&problem, &actions, self.title, &colours))
    }

    fn resolved(&self) -> Option<Drawn> {
        let at = |id: &str| self.table.iter().find(|(seen, _)| seen == id).map(|(_, pose)| *pose);
        let seen = self.objects.iter().filter_map(|object| {
            let start = at(&object.id).or(object.start.filter(|_| object.fixed))?;
            Some(ObjectSpec { start: Some(start), goal: None, group: None, ..object.clone() })
        });
        let problem = Problem::new(&Instance {
            workspace: self.workspace,
            clearance: 0.0,
            overlap_tolerance: self.workspace.width.max(self.workspace.height),
            keep_out: self.keep_out.to_vec(),
            objects: seen.collect(),
        });
        let problem = problem.ok()?;
        let action = |DrawnMove { object, from, to, to_goal }: &DrawnMove| {
            let object = problem.objects.iter().position(|known| known.id == *object)?;
            let kind = if *to_goal { ActionKind::Goal } else { ActionKind::Buffer };
            Some(Action { object, from: *from, to: *to, kind })
        };
        let actions: Option<Vec<Action>> = self.moves.iter().map(action).collect();
        let place = |id: &str| self.objects.iter().position(|known| known.id == id);
        let colours: Vec<usize> = problem.objects.iter().filter_map(|object| place(&object.id)).collect();
        Some(Drawn { actions: actions?, problem, colours })
    }
}

/// A plan in the terms of a problem.
struct Drawn {
    problem: Problem,
    actions: Vec<Action>,
    /// Of each object, its place in the catalogue.
    colours: Vec<usize>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use rearrange::geometry::footprint::Footprint;

    #[test]
    fn a_measured_overlap_and_an_absent_object_are_no_reason_for_no_picture() {
        let disc = |id: &str| ObjectSpec::new(id, Footprint::disc(0.05).expect("a disc"));
        let objects = [disc("a"), disc("b"), disc("absent")];
        let at = |x: f64| Pose2::new(x, 0.2, 0.0);
        let table = [("a".to_string(), at(0.2)), ("b".to_string(), at(0.29))];
        let step = |object: &str| DrawnMove {
            object: object.to_string(),
            from: at(0.2),
            to: at(0.4),
            to_goal: true,
        };
        let draw = |moves: &[DrawnMove]| {
            let workspace = Workspace { width: 0.5, height: 0.4 };
            DrawnPlan { objects: &objects, workspace, keep_out: &[], table: &table, moves, title: "t" }.svg()
        };
        let svg = draw(&[step("a")]).expect("a drawing");
        assert!(svg.contains(">a</text>") && !svg.contains(">absent</text>"), "{svg}");
        assert_eq!(draw(&[step("absent")]), None);
    }
}
