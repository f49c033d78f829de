//! The independent plan checker: the only way to a plan that a robot may carry out.
//!
//! In: a [`Problem`] and actions. Out: a [`CheckedPlan`], or the first [`PlanFault`]. It re-derives who lies
//! where action by action from the start, and decides contact with `planning::overlap`, which shares no
//! predicate with the solvers' collision kernel. The rules are those of the design, section 3: no overlap of
//! interiors beyond 1e-9 m, clearance between objects and to keep-out regions at every new place, nothing
//! over the edge; pairs that overlap as given are exempt while both are exactly in those poses. The last
//! action of an object repeats its goal's numbers exactly; members of a group end on the group's goals in
//! any order.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::sync::Arc;

use crate::geometry::footprint::Footprint;
use crate::geometry::pose::Pose2;
use crate::planning::effort::Watch;
use crate::planning::overlap::{Body, TOUCH_M};
use crate::planning::plan::{Action, ActionKind};
use crate::planning::problem::{Problem, ProblemObject};

/// A plan that passed the check. There is no other way to make one.
#[derive(Clone, Debug)]
pub struct CheckedPlan {
    actions: Vec<Action>,
    exempt: Vec<Exempt>,
    final_poses: Vec<Pose2>,
}

/// A given overlap (or closeness) that was taken as it is.
#[derive(Clone, Debug, PartialEq)]
pub struct Exempt {
    /// The object.
    pub object: String,
    /// What it meets: another object, a keep-out region, the table's edge.
    pub meets: String,
    /// The arrangement that gives it.
    pub given: GivenIn,
    /// Depth of the overlap, m.
    pub depth_m: f64,
}

/// The arrangement that gives an overlap.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GivenIn {
    /// The start arrangement.
    Start,
    /// The goal arrangement.
    Goal,
}

impl fmt::Display for Exempt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let given = match self.given {
            GivenIn::Start => "start",
            GivenIn::Goal => "goal",
        };
        write!(
            f,
            "{} overlaps {} by {:.1} um as given in the {given}",
            self.object,
            self.meets,
            self.depth_m * 1e6
        )
    }
}

impl CheckedPlan {
    /// Checks the plan from the start arrangement to the last action.
    ///
    /// # Errors
    /// The first fault in the order of the plan, then faults of the final arrangement.
    pub fn new(problem: &Problem, actions: &[Action]) -> Result<CheckedPlan, PlanFault> {
        CheckedPlan::within(problem, actions, &mut Watch::new(&|| false))
    }

    /// The same, as far as `watch` lets it.
    ///
    /// # Errors
    /// As [`CheckedPlan::new`]; [`PlanFault::Unfinished`] where the caller ended the check.
    pub fn within(
        problem: &Problem,
        actions: &[Action],
        watch: &mut Watch,
    ) -> Result<CheckedPlan, PlanFault> {
        let mut table = Table::new(problem);
        table.check_start(watch)?;
        for (index, action) in actions.iter().enumerate() {
            table.go_on(watch)?;
            table.carry_out(index, action)?;
        }
        table.check_end(actions, watch)?;
        Ok(CheckedPlan { actions: actions.to_vec(), exempt: table.exempt, final_poses: table.poses })
    }

    /// The actions in order.
    pub fn actions(&self) -> &[Action] {
        &self.actions
    }

    /// Given overlaps that were taken as they are.
    pub fn exempt(&self) -> &[Exempt] {
        &self.exempt
    }

    /// Where every object ends.
    pub fn final_poses(&self) -> &[Pose2] {
        &self.final_poses
    }
}

/// An overlap of a body.
struct Contact {
    /// What is met: another object, a keep-out region, the table's edge.
    meets: String,
    /// Depth of the overlap, m.
    depth_m: f64,
    /// The depth is beyond what a given pose is allowed to have.
    too_deep: bool,
}

/// Who lies where.
struct Table<'p> {
    problem: &'p Problem,
    poses: Vec<Pose2>,
    bodies: Vec<Body>,
    regions: Vec<Body>,
    /// Goals each object may take: its own, or all of its group's; a fixed object's start.
    goals: Vec<Arc<[Pose2]>>,
    /// What one object takes, in ticks.
    ticks: u64,
    exempt: Vec<Exempt>,
}

impl<'p> Table<'p> {
    fn new(problem: &'p Problem) -> Table<'p> {
        let objects = &problem.objects;
        let mut shared: BTreeMap<&str, Vec<Pose2>> = BTreeMap::new();
        for object in objects {
            if let Some(group) = &object.group {
                shared.entry(group).or_default().extend(object.goal);
            }
        }
        let shared: BTreeMap<&str, Arc<[Pose2]>> =
            shared.into_iter().map(|(group, goals)| (group, goals.into())).collect();
        let goals_of = |object: &ProblemObject| -> Arc<[Pose2]> {
            if object.fixed {
                return Arc::new([object.start]);
            }
            let group = object.group.as_ref().and_then(|group| shared.get(group.as_str()));
            group.map_or_else(|| object.goal.into_iter().collect(), Arc::clone)
        };
        // Corners of all, as a test of two polygons takes as long as their corners are many.
        let pieces = |object: &ProblemObject| match &object.footprint {
            Footprint::Polygon(polygon) => polygon.points().len(),
            Footprint::Disc { .. } | Footprint::Ellipse { .. } | Footprint::Rectangle { .. } => 4,
        };
        let corners: usize = objects.iter().map(pieces).sum();
        Table {
            problem,
            poses: objects.iter().map(|object| object.start).collect(),
            bodies: objects.iter().map(|object| Body::new(&object.footprint, &object.start)).collect(),
            regions: problem
                .keep_out
                .iter()
                .map(|region| Body::new(&region.footprint, &region.pose))
                .collect(),
            goals: objects.iter().map(goals_of).collect(),
            ticks: (corners + objects.iter().map(pieces).max().unwrap_or(0).pow(2)) as u64,
            exempt: Vec::new(),
        }
    }

    fn name(&self, k: usize) -> String {
        self.problem.objects[k].id.clone()
    }

    /// Depth that a given pose is allowed to have.
    fn tolerated(&self) -> f64 {
        self.problem.overlap_tolerance.max(0.0) + TOUCH_M
    }

    /// Calls the caller's stop function before the next object.
    fn go_on(&self, watch: &mut Watch) -> Result<(), PlanFault> {
        if watch.go_on(self.ticks) { Ok(()) } else { Err(PlanFault::Unfinished) }
    }

    fn check_start(&mut self, watch: &mut Watch) -> Result<(), PlanFault> {
        for k in 0..self.poses.len() {
            self.go_on(watch)?;
            if !self.poses[k].is_finite() {
                return Err(PlanFault::NotFinite { action: 0, object: self.name(k) });
            }
            let mut found = self.edge_contact(k, &self.bodies[k]);
            found.extend(self.region_contacts(&self.bodies[k]));
            found.extend((0..k).filter_map(|j| self.object_contact(j, &self.bodies[k])));
            self.admit(k, found, GivenIn::Start)?;
        }
        Ok(())
    }

    /// Takes given overlaps within the tolerance as they are, and refuses deeper ones.
    fn admit(&mut self, k: usize, found: Vec<Contact>, given: GivenIn) -> Result<(), PlanFault> {
        for Contact { meets, depth_m, too_deep } in found {
            if too_deep {
                let (depth_um, tolerated_um) = (depth_m * 1e6, self.problem.overlap_tolerance * 1e6);
                return Err(PlanFault::Start { object: self.name(k), meets, depth_um, tolerated_um });
            }
            self.note(Exempt { object: self.name(k), meets, given, depth_m });
        }
        Ok(())
    }

    fn note(&mut self, exempt: Exempt) {
        let known = |e: &Exempt| {
            e.given == exempt.given
                && ((e.object == exempt.object && e.meets == exempt.meets)
                    || (e.object == exempt.meets && e.meets == exempt.object))
        };
        if !self.exempt.iter().any(known) {
            self.exempt.push(exempt);
        }
    }

    fn edge_contact(&self, _k: usize, body: &Body) -> Vec<Contact> {
        let (width, height) = (self.problem.workspace.width, self.problem.workspace.height);
        if !body.reaches_over(width, height, TOUCH_M) {
            return Vec::new();
        }
        vec![Contact {
            meets: "the table's edge".to_string(),
            depth_m: body.overhang(width, height),
            too_deep: body.reaches_over(width, height, self.tolerated()),
        }]
    }

    fn region_contacts(&self, body: &Body) -> Vec<Contact> {
        let contact = |(r, region): (usize, &Body)| {
            region.overlaps_deeper(body, TOUCH_M).then(|| Contact {
                meets: format!("keep_out[{r}]"),
                depth_m: region.depth(body),
                too_deep: region.overlaps_deeper(body, self.tolerated()),
            })
        };
        self.regions.iter().enumerate().filter_map(contact).collect()
    }

    fn object_contact(&self, j: usize, body: &Body) -> Option<Contact> {
        let other = &self.bodies[j];
        other.overlaps_deeper(body, TOUCH_M).then(|| Contact {
            meets: self.name(j),
            depth_m: other.depth(body),
            too_deep: other.overlaps_deeper(body, self.tolerated()),
        })
    }

    fn carry_out(&mut self, index: usize, action: &Action) -> Result<(), PlanFault> {
        let k = action.object;
        let Some(object) = self.problem.objects.get(k) else {
            return Err(PlanFault::NoSuchObject { action: index, object: k });
        };
        let name = object.id.clone();
        if !action.from.is_finite() || !action.to.is_finite() {
            return Err(PlanFault::NotFinite { action: index, object: name });
        }
        if object.fixed {
            return Err(PlanFault::Fixed { action: index, object: name });
        }
        if !self.poses[k].same(&action.from) {
            let (off_um, off_deg) = off(&self.poses[k], &action.from);
            return Err(PlanFault::From { action: index, object: name, off_um, off_deg });
        }
        if action.kind == ActionKind::Goal && !self.goals[k].contains(&action.to) {
            let nearest = self.nearest_goal(k, &action.to);
            let (off_um, off_deg) = nearest.map_or((f64::INFINITY, 0.0), |goal| off(goal, &action.to));
            return Err(PlanFault::NotItsGoal { action: index, object: name, off_um, off_deg });
        }
        let body = Body::new(&object.footprint, &action.to);
        self.check_surroundings(index, k, &action.to, &body)?;
        self.check_neighbours(index, k, &action.to, &body)?;
        self.poses[k] = action.to;
        self.bodies[k] = body;
        Ok(())
    }

    fn nearest_goal(&self, k: usize, pose: &Pose2) -> Option<&Pose2> {
        self.goals[k].iter().min_by(|a, b| a.distance(pose).total_cmp(&b.distance(pose)))
    }

    /// The table's edge and the keep-out regions; a given pose is exempt up to the tolerance.
    fn check_surroundings(
        &mut self,
        action: usize,
        k: usize,
        to: &Pose2,
        body: &Body,
    ) -> Result<(), PlanFault> {
        let given = self.given_alone(k, to);
        for Contact { depth_m, too_deep, .. } in self.edge_contact(k, body) {
            match given {
                Some(given) if !too_deep => {
                    let meets = "the table's edge".to_string();
                    self.note(Exempt { object: self.name(k), meets, given, depth_m });
                }
                _ => return Err(PlanFault::Edge { action, object: self.name(k), depth_um: depth_m * 1e6 }),
            }
        }
        for Contact { meets, depth_m, too_deep } in self.region_contacts(body) {
            match given {
                Some(given) if !too_deep => self.note(Exempt { object: self.name(k), meets, given, depth_m }),
                _ => {
                    let (object, depth_um) = (self.name(k), depth_m * 1e6);
                    return Err(PlanFault::Overlap { action, object, meets, depth_um });
                }
            }
        }
        if given.is_none() {
            for (r, region) in self.regions.iter().enumerate() {
                self.check_clearance(action, k, body, region, || format!("keep_out[{r}]"))?;
            }
        }
        Ok(())
    }

    fn check_neighbours(
        &mut self,
        action: usize,
        k: usize,
        to: &Pose2,
        body: &Body,
    ) -> Result<(), PlanFault> {
        for j in (0..self.poses.len()).filter(|&j| j != k) {
            // Whether a pair is given is looked up where it matters: in a large group that takes long.
            let given = || self.given_together(k, to, j);
            match self.object_contact(j, body).map(|contact| (given(), contact)) {
                Some((Some(given), Contact { meets, depth_m, too_deep: false })) => {
                    self.note(Exempt { object: self.name(k), meets, given, depth_m });
                }
                Some((_, Contact { meets, depth_m, .. })) => {
                    let (object, depth_um) = (self.name(k), depth_m * 1e6);
                    return Err(PlanFault::Overlap { action, object, meets, depth_um });
                }
                None => {
                    let near = self.check_clearance(action, k, body, &self.bodies[j], || self.name(j));
                    near.or_else(|fault| given().map_or(Err(fault), |_| Ok(())))?;
                }
            }
        }
        Ok(())
    }

    fn check_clearance(
        &self,
        action: usize,
        k: usize,
        body: &Body,
        other: &Body,
        name: impl Fn() -> String,
    ) -> Result<(), PlanFault> {
        let clearance = self.problem.clearance;
        if clearance > 0.0 && other.nearer_than(body, clearance) {
            return Err(PlanFault::Clearance {
                action,
                object: self.name(k),
                meets: name(),
                gap_um: other.gap(body, clearance) * 1e6,
                clearance_um: clearance * 1e6,
            });
        }
        Ok(())
    }

    /// Is the pose exactly one that the files give for this object?
    fn given_alone(&self, k: usize, pose: &Pose2) -> Option<GivenIn> {
        if *pose == self.problem.objects[k].start {
            return Some(GivenIn::Start);
        }
        self.goals[k].contains(pose).then_some(GivenIn::Goal)
    }

    /// Are both exactly as given, in the same arrangement?
    fn given_together(&self, k: usize, pose: &Pose2, j: usize) -> Option<GivenIn> {
        let other = &self.poses[j];
        if *pose == self.problem.objects[k].start && *other == self.problem.objects[j].start {
            return Some(GivenIn::Start);
        }
        (self.goals[k].contains(pose) && self.goals[j].contains(other)).then_some(GivenIn::Goal)
    }

    fn check_end(&self, actions: &[Action], watch: &mut Watch) -> Result<(), PlanFault> {
        let mut moved = vec![false; self.poses.len()];
        actions.iter().for_each(|action| moved[action.object] = true);
        // An object that never moves is there if its start is the goal, angles modulo a full turn.
        let arrived = |k: usize, goal: &Pose2| {
            if moved[k] { self.poses[k] == *goal } else { self.poses[k].same(goal) }
        };
        for (k, object) in self.problem.objects.iter().enumerate() {
            let Some(goal) = object.goal.filter(|_| !object.fixed && object.group.is_none()) else {
                continue;
            };
            if !arrived(k, &goal) {
                let (off_um, off_deg) = off(&self.poses[k], &goal);
                return Err(PlanFault::Goal { object: object.id.clone(), off_um, off_deg });
            }
        }
        self.check_groups(&arrived, watch)
    }

    /// Every goal of a group needs a member of its own, also where two goals are the same pose.
    fn check_groups(
        &self,
        arrived: &dyn Fn(usize, &Pose2) -> bool,
        watch: &mut Watch,
    ) -> Result<(), PlanFault> {
        let objects = &self.problem.objects;
        let groups: BTreeSet<&String> = objects.iter().filter_map(|object| object.group.as_ref()).collect();
        for group in groups {
            let members: Vec<usize> =
                (0..objects.len()).filter(|&m| objects[m].group.as_ref() == Some(group)).collect();
            let goals: Vec<(usize, Pose2)> = members
                .iter()
                .filter_map(|&m| Some((m, objects[m].goal.filter(|_| !objects[m].fixed)?)))
                .collect();
            let there = |goal: &Pose2| members.iter().copied().filter(|&m| arrived(m, goal)).collect();
            let standing = goals.iter().map(|(_, goal)| self.go_on(watch).map(|()| there(goal)));
            let standing: Vec<Vec<usize>> = standing.collect::<Result<_, PlanFault>>()?;
            if let Some(unserved) = group_goals::unserved(&standing) {
                let object = objects[goals[unserved].0].id.clone();
                return Err(PlanFault::GroupGoal { group: group.clone(), object });
            }
        }
        Ok(())
    }
}

/// Distance in micrometres and angle in degrees between two poses.
fn off(a: &Pose2, b: &Pose2) -> (f64, f64) {
    (a.distance(b) * 1e6, a.angle_difference(b).to_degrees())
}

mod fault;
mod group_goals;

pub use fault::PlanFault;

#[cfg(test)]
mod agreement;
#[cfg(test)]
mod bad_plans;
