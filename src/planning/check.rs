//! The independent plan checker, and the only way to a plan the robot may carry out.
//!
//! In: a problem and a list of actions. Out: a [`CheckedPlan`], or the first [`PlanFault`] with its action, its
//! objects and its micrometres. It shares poses and footprints with the solvers and no predicate: shapes are
//! polygons here, decided by the robust predicates of `geo`, and occupancy is derived anew from the start,
//! action by action. `overlap` holds the geometry.

mod overlap;

#[cfg(test)]
mod tests;

use crate::geometry::pose::Pose2;
use crate::planning::plan::{Action, ActionKind};
use crate::planning::problem::Problem;
use overlap::{Body, deeper_than, depth, nearer_than, overhang};

/// Penetration up to here is touching, m (design, section 3).
const TOUCH_M: f64 = 1e-9;

/// What is wrong with a plan. Actions count from 0.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PlanFault {
    /// No such object.
    #[error("action {action}: the problem has no object number {object}")]
    UnknownObject {
        /// Action.
        action: usize,
        /// Index given.
        object: usize,
    },
    /// A pose is not finite.
    #[error("action {action}: a pose of {object} is not a finite number")]
    NotFinite {
        /// Action.
        action: usize,
        /// Object.
        object: String,
    },
    /// The object is an obstacle.
    #[error("action {action}: {object} is fixed")]
    Fixed {
        /// Action.
        action: usize,
        /// Object.
        object: String,
    },
    /// The object is not where the action picks it.
    #[error(
        "action {action}: {object} is not at `from`, but {off_um:.1} um and {off_mrad:.3} mrad away from it"
    )]
    From {
        /// Action.
        action: usize,
        /// Object.
        object: String,
        /// Distance, um.
        off_um: f64,
        /// Angle, mrad.
        off_mrad: f64,
    },
    /// The new place is over the edge.
    #[error("action {action}: {object} would reach {over_um:.3} um over the table's edge")]
    Edge {
        /// Action.
        action: usize,
        /// Object.
        object: String,
        /// By how much, um.
        over_um: f64,
    },
    /// The new place overlaps something.
    #[error("action {action}: {object} would overlap {other} by {depth_um:.3} um")]
    Overlap {
        /// Action.
        action: usize,
        /// Object moved.
        object: String,
        /// What it meets.
        other: String,
        /// Depth, um.
        depth_um: f64,
    },
    /// The new place is too near to something.
    #[error(
        "action {action}: {object} would be nearer to {other} than the clearance of {clearance_um:.1} um"
    )]
    Clearance {
        /// Action.
        action: usize,
        /// Object moved.
        object: String,
        /// What it comes near to.
        other: String,
        /// Clearance asked for, um.
        clearance_um: f64,
    },
    /// The action says it goes to the goal, and does not, or the other way round.
    #[error("action {action}: {object} is said to go to {said}, but does not")]
    Kind {
        /// Action.
        action: usize,
        /// Object.
        object: String,
        /// "its goal" or "a buffer".
        said: &'static str,
    },
    /// An object does not end at its goal, to the last digit.
    #[error("{object} does not end at its goal, but {off_um:.3} um and {off_mrad:.3} mrad away from it")]
    NotAtGoal {
        /// Object.
        object: String,
        /// Distance, um.
        off_um: f64,
        /// Angle, mrad.
        off_mrad: f64,
    },
    /// A given arrangement overlaps by more than the tolerance.
    #[error("{arrangement}: {object} overlaps {other} by {depth_um:.3} um, more than the tolerance")]
    Given {
        /// "start" or "goal".
        arrangement: &'static str,
        /// One object.
        object: String,
        /// The other, or the table's edge.
        other: String,
        /// Depth, um.
        depth_um: f64,
    },
}

/// A plan that passed the check; there is no other way to make one.
#[derive(Clone, Debug, PartialEq)]
pub struct CheckedPlan {
    actions: Vec<Action>,
    cost_pp: usize,
    cost_ti: f64,
}

impl CheckedPlan {
    /// Replays `actions` from the problem's start.
    ///
    /// # Errors
    /// The first fault.
    pub fn new(problem: &Problem, actions: &[Action]) -> Result<CheckedPlan, PlanFault> {
        let mut table = Table::new(problem);
        table.check_given("start", |i| Some(problem.objects[i].start))?;
        table.check_given("goal", |i| problem.objects[i].goal)?;
        for (index, action) in actions.iter().enumerate() {
            table.apply(index, action)?;
        }
        table.check_end()?;
        let cost_ti = actions.iter().map(|action| problem.objects[action.object].impedance).sum();
        Ok(CheckedPlan { actions: actions.to_vec(), cost_pp: actions.len(), cost_ti })
    }

    /// The actions.
    pub fn actions(&self) -> &[Action] {
        &self.actions
    }

    /// Number of pick-n-places.
    pub fn cost_pp(&self) -> usize {
        self.cost_pp
    }

    /// Total task impedance.
    pub fn cost_ti(&self) -> f64 {
        self.cost_ti
    }
}

/// Pairs of a given arrangement that overlap by more than touching: names and depth, m. For `celld verify`.
pub fn exempt_pairs(problem: &Problem) -> Vec<(String, String, f64)> {
    let table = Table::new(problem);
    let mut out = Vec::new();
    for arrangement in [true, false] {
        let pose = |i: usize| {
            let object = &problem.objects[i];
            if arrangement { Some(object.start) } else { object.goal }
        };
        for i in 0..problem.objects.len() {
            let Some(at) = pose(i) else { continue };
            let a = table.body(i, at);
            for j in i + 1..problem.objects.len() {
                let Some(at) = pose(j) else { continue };
                let b = table.body(j, at);
                if deeper_than(&a, &b, TOUCH_M) {
                    let names = (problem.objects[i].id.clone(), problem.objects[j].id.clone());
                    out.push((names.0, names.1, depth(&a, &b)));
                }
            }
        }
    }
    out
}

/// The table while a plan is replayed.
struct Table<'a> {
    problem: &'a Problem,
    at: Vec<Pose2>,
    keep_out: Vec<Body>,
}

impl<'a> Table<'a> {
    fn new(problem: &'a Problem) -> Table<'a> {
        Table {
            problem,
            at: problem.objects.iter().map(|object| object.start).collect(),
            keep_out: problem.keep_out.iter().map(|r| Body::new(&r.footprint, r.pose)).collect(),
        }
    }

    fn body(&self, object: usize, pose: Pose2) -> Body {
        Body::new(&self.problem.objects[object].footprint, pose)
    }

    /// A given arrangement may overlap by the tolerance and no more.
    fn check_given(
        &self,
        arrangement: &'static str,
        pose: impl Fn(usize) -> Option<Pose2>,
    ) -> Result<(), PlanFault> {
        let tolerance = self.problem.overlap_tolerance + TOUCH_M;
        let bodies: Vec<Option<Body>> =
            (0..self.at.len()).map(|i| pose(i).map(|pose| self.body(i, pose))).collect();
        for (i, a) in bodies.iter().enumerate() {
            let Some(a) = a else { continue };
            let fault = |other: String, depth_m: f64| PlanFault::Given {
                arrangement,
                object: self.problem.objects[i].id.clone(),
                other,
                depth_um: depth_m * 1e6,
            };
            let workspace = &self.problem.workspace;
            let over = overhang(a, workspace.width, workspace.height);
            if over > tolerance {
                return Err(fault("the table's edge".to_string(), over));
            }
            for (j, b) in bodies.iter().enumerate().skip(i + 1) {
                if let Some(b) = b.as_ref().filter(|b| deeper_than(a, b, tolerance)) {
                    return Err(fault(self.problem.objects[j].id.clone(), depth(a, b)));
                }
            }
        }
        Ok(())
    }

    fn apply(&mut self, index: usize, action: &Action) -> Result<(), PlanFault> {
        let unknown = PlanFault::UnknownObject { action: index, object: action.object };
        let object = self.problem.objects.get(action.object).ok_or(unknown)?;
        let name = || object.id.clone();
        if !action.from.is_finite() || !action.to.is_finite() {
            return Err(PlanFault::NotFinite { action: index, object: name() });
        }
        if object.fixed {
            return Err(PlanFault::Fixed { action: index, object: name() });
        }
        let here = self.at[action.object];
        if !here.same(&action.from) {
            let (off_um, off_mrad) = difference(&here, &action.from);
            return Err(PlanFault::From { action: index, object: name(), off_um, off_mrad });
        }
        let to_goal = self.is_goal(action.object, &action.to);
        if to_goal != (action.kind == ActionKind::Goal) {
            let said = if to_goal { "a buffer" } else { "its goal" };
            return Err(PlanFault::Kind { action: index, object: name(), said });
        }
        self.check_place(index, action)?;
        self.at[action.object] = action.to;
        Ok(())
    }

    fn check_place(&self, index: usize, action: &Action) -> Result<(), PlanFault> {
        let (problem, moved) = (self.problem, action.object);
        let object = problem.objects[moved].id.clone();
        let body = self.body(moved, action.to);
        let given = action.to == problem.objects[moved].start || self.is_goal(moved, &action.to);
        let over = overhang(&body, problem.workspace.width, problem.workspace.height);
        if over > TOUCH_M + if given { problem.overlap_tolerance } else { 0.0 } {
            return Err(PlanFault::Edge { action: index, object, over_um: over * 1e6 });
        }
        for (k, region) in self.keep_out.iter().enumerate() {
            if !given {
                self.check_pair(index, &object, &body, &format!("keep_out[{k}]"), region)?;
            }
        }
        for other in (0..self.at.len()).filter(|&other| other != moved) {
            if !self.exempt(moved, &action.to, other, &self.at[other]) {
                let there = self.body(other, self.at[other]);
                self.check_pair(index, &object, &body, &problem.objects[other].id, &there)?;
            }
        }
        Ok(())
    }

    fn check_pair(
        &self,
        action: usize,
        object: &str,
        body: &Body,
        other: &str,
        there: &Body,
    ) -> Result<(), PlanFault> {
        let (object, other) = (object.to_string(), other.to_string());
        if deeper_than(body, there, TOUCH_M) {
            let depth_um = depth(body, there) * 1e6;
            return Err(PlanFault::Overlap { action, object, other, depth_um });
        }
        let clearance = self.problem.clearance;
        if clearance > TOUCH_M && nearer_than(body, there, clearance - TOUCH_M) {
            return Err(PlanFault::Clearance { action, object, other, clearance_um: clearance * 1e6 });
        }
        Ok(())
    }

    /// Both exactly at given starts, or both exactly at given goals: their contact was checked at the outset.
    fn exempt(&self, i: usize, at_i: &Pose2, j: usize, at_j: &Pose2) -> bool {
        let start = |k: usize, pose: &Pose2| *pose == self.problem.objects[k].start;
        (start(i, at_i) && start(j, at_j)) || (self.is_goal(i, at_i) && self.is_goal(j, at_j))
    }

    /// Exactly a goal of the object, or of another member of its group.
    fn is_goal(&self, object: usize, pose: &Pose2) -> bool {
        let mine = &self.problem.objects[object];
        self.problem.objects.iter().enumerate().any(|(k, other)| {
            let shares = k == object || (mine.group.is_some() && mine.group == other.group);
            shares && other.goal.is_some_and(|goal| goal == *pose)
        })
    }

    fn check_end(&self) -> Result<(), PlanFault> {
        let objects = &self.problem.objects;
        for (i, object) in objects.iter().enumerate() {
            let Some(goal) = object.goal else { continue };
            if object.group.is_some() {
                // The goal has to be taken by some member; as many goals as takers make it a permutation.
                let taken = objects
                    .iter()
                    .enumerate()
                    .any(|(k, other)| other.group == object.group && self.at[k] == goal);
                if taken {
                    continue;
                }
            } else if self.at[i] == goal || self.never_moved_and_there(i, &goal) {
                continue;
            }
            let (off_um, off_mrad) = difference(&self.at[i], &goal);
            return Err(PlanFault::NotAtGoal { object: object.id.clone(), off_um, off_mrad });
        }
        Ok(())
    }

    /// An object whose start is its goal but for a whole turn need not be moved.
    fn never_moved_and_there(&self, object: usize, goal: &Pose2) -> bool {
        let start = &self.problem.objects[object].start;
        self.at[object] == *start && start.same(goal)
    }
}

fn difference(a: &Pose2, b: &Pose2) -> (f64, f64) {
    (a.distance(b) * 1e6, a.angle_difference(b) * 1e3)
}
