//! The rearrangement problem: objects with starts, goals and costs, and the one rule of contact.
//!
//! In: an [`Instance`]. Out: a [`Problem`], or all [`ProblemFault`]s. The rule for a pair, which `scene`
//! holds for the dependency graph, the buffers and every solver alike: two objects must not overlap, and
//! must keep the clearance, except while both are exactly at their given starts, or both exactly at their
//! given goals (design, section 3, given overlap).

use crate::geometry::collision::{Placed, TOUCH_M, overhang};
use crate::geometry::footprint::Footprint;
use crate::geometry::pose::Pose2;
use crate::tabletop::instance::{Instance, Workspace};
use std::fmt;
use std::sync::Arc;

/// One object of a problem.
#[derive(Clone, Debug)]
pub struct ProblemObject {
    /// Name.
    pub id: String,
    /// Outline.
    pub footprint: Footprint,
    /// Cost of one move under TI.
    pub impedance: f64,
    /// Where it is.
    pub start: Pose2,
    /// Where it should end; anywhere if absent.
    pub goal: Option<Pose2>,
    /// Never moves.
    pub fixed: bool,
    /// Group of interchangeable objects.
    pub group: Option<String>,
}

/// A keep-out region at its pose.
#[derive(Clone, Debug)]
pub struct Region {
    /// Shape.
    pub footprint: Footprint,
    /// Pose.
    pub pose: Pose2,
    placed: Placed,
}

/// A problem whose start arrangement is valid.
#[derive(Clone, Debug)]
pub struct Problem {
    /// The table.
    pub workspace: Workspace,
    /// Gap at every new place, m.
    pub clearance: f64,
    /// Given overlap that is taken as it is, m.
    pub overlap_tolerance: f64,
    /// Regions to leave free.
    pub keep_out: Vec<Region>,
    /// The objects.
    pub objects: Vec<ProblemObject>,
    /// Where objects can be put down at all; everywhere if absent.
    pub reach: Option<Reach>,
}

/// Which new places whoever moves the objects can serve. Starts and goals are taken as they are given.
#[derive(Clone)]
pub struct Reach(Arc<Serves>);

/// Whether the object with this index can be put down and picked up at a pose.
type Serves = dyn Fn(usize, &Pose2) -> bool + Send + Sync;

impl Reach {
    /// By a function of object index and pose, which has to give the same answer each time.
    pub fn new(serves: impl Fn(usize, &Pose2) -> bool + Send + Sync + 'static) -> Reach {
        Reach(Arc::new(serves))
    }

    /// Whether the object can be put down and picked up at this pose.
    pub fn serves(&self, object: usize, pose: &Pose2) -> bool {
        (self.0)(object, pose)
    }
}

impl fmt::Debug for Reach {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Reach")
    }
}

/// Two things in contact, or one over the edge, by name.
#[derive(Clone, Debug, PartialEq)]
pub struct Witness {
    /// The object.
    pub object: String,
    /// What it meets: another object, a keep-out region, the table's edge.
    pub meets: String,
    /// By how much, m.
    pub depth_m: f64,
}

impl fmt::Display for Witness {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} overlaps {} by {:.3} mm", self.object, self.meets, self.depth_m * 1e3)
    }
}

/// What is wrong with a start arrangement.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ProblemFault {
    /// An object has no start pose.
    #[error("object {0}: no start pose; add `start: [x, y, theta]`")]
    NoStart(String),
    /// A fixed object whose goal differs from its start.
    #[error("object {0} is fixed but its goal is not its start; remove one of the two")]
    FixedMoves(String),
    /// Two objects of a group differ, or some have goals and others do not fit.
    #[error("group {group}: {object} differs from the others in footprint or impedance")]
    GroupDiffers {
        /// Group.
        group: String,
        /// Object.
        object: String,
    },
    /// The start arrangement overlaps.
    #[error(
        "start: {witness}, {tolerance_mm:.3} mm are tolerated; move them apart or raise overlap_tolerance"
    )]
    Start {
        /// Who, whom, how much.
        witness: Witness,
        /// Tolerance, mm.
        tolerance_mm: f64,
    },
}

/// All faults of an instance.
#[derive(Clone, Debug, PartialEq)]
pub struct ProblemFaults(pub Vec<ProblemFault>);

impl fmt::Display for ProblemFaults {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, fault) in self.0.iter().enumerate() {
            let separator = if index > 0 { "\n" } else { "" };
            write!(f, "{separator}{fault}")?;
        }
        Ok(())
    }
}

impl std::error::Error for ProblemFaults {}

/// Which arrangement is meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Given {
    /// The start.
    Start,
    /// The goal.
    Goal,
}

impl Problem {
    /// Builds the problem and checks the start arrangement.
    ///
    /// # Errors
    /// Every fault; a faulty goal arrangement is no error here, see [`Problem::goal_conflict`].
    pub fn new(instance: &Instance) -> Result<Problem, ProblemFaults> {
        let mut faults = Vec::new();
        let mut objects = Vec::with_capacity(instance.objects.len());
        for object in &instance.objects {
            let Some(start) = object.start else {
                faults.push(ProblemFault::NoStart(object.id.clone()));
                continue;
            };
            let goal = if object.fixed { Some(start) } else { object.goal };
            if object.fixed && object.goal.is_some_and(|goal| !goal.same(&start)) {
                faults.push(ProblemFault::FixedMoves(object.id.clone()));
            }
            objects.push(ProblemObject {
                id: object.id.clone(),
                footprint: object.footprint.clone(),
                impedance: object.impedance.unwrap_or_else(|| object.footprint.area()),
                start,
                goal,
                fixed: object.fixed,
                group: object.group.clone(),
            });
        }
        check_groups(&objects, &mut faults);
        let keep_out = instance
            .keep_out
            .iter()
            .map(|region| Region {
                footprint: region.footprint.clone(),
                pose: region.pose,
                placed: Placed::new(&region.footprint, region.pose),
            })
            .collect();
        let problem = Problem {
            workspace: instance.workspace,
            clearance: instance.clearance,
            overlap_tolerance: instance.overlap_tolerance,
            keep_out,
            objects,
            reach: None,
        };
        let tolerance_mm = problem.overlap_tolerance * 1e3;
        let starts = problem.contacts(Given::Start);
        let beyond = starts.into_iter().filter(|w| w.depth_m > problem.overlap_tolerance + TOUCH_M);
        faults.extend(beyond.map(|witness| ProblemFault::Start { witness, tolerance_mm }));
        if faults.is_empty() { Ok(problem) } else { Err(ProblemFaults(faults)) }
    }

    /// The same problem where new places have to be within reach.
    pub fn within(mut self, reach: Reach) -> Problem {
        self.reach = Some(reach);
        self
    }

    /// The worst overlap of the goal arrangement beyond the tolerance, which proves that there is no plan.
    ///
    /// Only objects that have a goal take part; with groups, their goals are taken as the places they are.
    pub fn goal_conflict(&self) -> Option<Witness> {
        self.contacts(Given::Goal)
            .into_iter()
            .filter(|witness| witness.depth_m > self.overlap_tolerance + TOUCH_M)
            .max_by(|a, b| a.depth_m.total_cmp(&b.depth_m))
    }

    /// Pairs (and objects over the edge or in a keep-out region) that overlap in a given arrangement.
    pub fn contacts(&self, given: Given) -> Vec<Witness> {
        let mut out = Vec::new();
        let poses: Vec<Option<Pose2>> = self.objects.iter().map(|object| object.given(given)).collect();
        let placed: Vec<Option<Placed>> = self
            .objects
            .iter()
            .zip(&poses)
            .map(|(object, pose)| pose.map(|pose| Placed::new(&object.footprint, pose)))
            .collect();
        let near = neighbours(&placed);
        let mut note = |object: &str, meets: &str, depth_m: f64| {
            if depth_m > TOUCH_M {
                out.push(Witness { object: object.to_string(), meets: meets.to_string(), depth_m });
            }
        };
        for (i, object) in self.objects.iter().enumerate() {
            let (Some(pose), Some(shape)) = (&poses[i], &placed[i]) else { continue };
            let (width, height) = (self.workspace.width, self.workspace.height);
            note(&object.id, "the table's edge", overhang(&object.footprint, pose, width, height));
            for (k, region) in self.keep_out.iter().enumerate() {
                note(&object.id, &format!("keep_out[{k}]"), shape.penetration(&region.placed));
            }
            for &k in &near[i] {
                if let Some(placed) = &placed[k] {
                    note(&object.id, &self.objects[k].id, shape.penetration(placed));
                }
            }
        }
        out
    }
}

impl ProblemObject {
    fn given(&self, given: Given) -> Option<Pose2> {
        match given {
            Given::Start => Some(self.start),
            Given::Goal => self.goal,
        }
    }
}

/// For each object the later ones that lie beside it in x, in order: of a thousand objects few can touch.
fn neighbours(placed: &[Option<Placed>]) -> Vec<Vec<usize>> {
    let spans = placed.iter().enumerate().filter_map(|(i, shape)| Some((shape.as_ref()?.span_x(), i)));
    let mut spans: Vec<([f64; 2], usize)> = spans.collect();
    spans.sort_by(|a, b| a.0[0].total_cmp(&b.0[0]));
    let mut near = vec![Vec::new(); placed.len()];
    for (at, ([_, high], i)) in spans.iter().enumerate() {
        for (_, k) in spans[at + 1..].iter().take_while(|([low, _], _)| low <= high) {
            near[*i.min(k)].push(*i.max(k));
        }
    }
    near.iter_mut().for_each(|later| later.sort_unstable());
    near
}

fn check_groups(objects: &[ProblemObject], faults: &mut Vec<ProblemFault>) {
    for (i, object) in objects.iter().enumerate() {
        let Some(group) = &object.group else { continue };
        let first = objects[..i].iter().find(|other| other.group.as_ref() == Some(group));
        if first.is_some_and(|f| f.footprint != object.footprint || f.impedance != object.impedance) {
            faults.push(ProblemFault::GroupDiffers { group: group.clone(), object: object.id.clone() });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::planning::scene::Scene;
    use crate::tabletop::instance::ObjectSpec;

    /// Where a square starts, and where it should end.
    type Places = (f64, f64, Option<(f64, f64)>);

    fn instance(poses: &[Places]) -> Instance {
        let square = Footprint::rectangle(0.1, 0.1).expect("valid");
        let objects = poses
            .iter()
            .enumerate()
            .map(|(k, (x, y, goal))| {
                let mut object = ObjectSpec::new(format!("o{k}"), square.clone());
                object.start = Some(Pose2::new(*x, *y, 0.0));
                object.goal = goal.map(|(x, y)| Pose2::new(x, y, 0.0));
                object
            })
            .collect();
        Instance {
            workspace: Workspace { width: 1.0, height: 1.0 },
            clearance: 0.0,
            overlap_tolerance: 0.0,
            keep_out: Vec::new(),
            objects,
        }
    }

    #[test]
    fn a_start_that_overlaps_is_bad_input_and_names_both() {
        let error = Problem::new(&instance(&[(0.1, 0.1, None), (0.19, 0.1, None)])).expect_err("overlap");
        let text = error.to_string();
        assert!(text.contains("o0 overlaps o1 by 10.000 mm"), "{text}");
        let over = Problem::new(&instance(&[(0.04, 0.1, None)])).expect_err("over the edge");
        assert!(over.to_string().contains("the table's edge by 10.000 mm"), "{over}");
    }

    #[test]
    fn a_given_overlap_within_the_tolerance_is_exempt_there_and_nowhere_else() {
        let mut given = instance(&[(0.1, 0.1, Some((0.5, 0.5))), (0.199, 0.1, Some((0.7, 0.7)))]);
        given.overlap_tolerance = 0.002;
        let problem = Problem::new(&given).expect("tolerated");
        let scene = Scene::new(&problem);
        let a = scene.start(0);
        assert!(scene.clear(a, scene.start(1)));
        let moved = scene.spot(0, Pose2::new(a.pose.x + 1e-6, a.pose.y, 0.0));
        assert!(!scene.clear(&moved, scene.start(1)));
    }

    #[test]
    fn a_goal_that_overlaps_is_a_witness() {
        let goals = instance(&[(0.1, 0.1, Some((0.5, 0.5))), (0.3, 0.1, Some((0.55, 0.5)))]);
        let witness = Problem::new(&goals).expect("start is fine").goal_conflict().expect("conflict");
        assert_eq!((witness.object.as_str(), witness.meets.as_str()), ("o0", "o1"));
        assert!((witness.depth_m - 0.05).abs() < 1e-9);
    }

    #[test]
    fn clearance_is_kept_but_not_from_given_neighbours() {
        let mut given = instance(&[(0.1, 0.1, Some((0.5, 0.5))), (0.201, 0.1, Some((0.601, 0.5)))]);
        given.clearance = 0.01;
        let problem = Problem::new(&given).expect("valid");
        let scene = Scene::new(&problem);
        let goals = [scene.goal(0).expect("goal"), scene.goal(1).expect("goal")];
        assert!(scene.clear(goals[0], goals[1]));
        assert!(!scene.clear(&scene.spot(0, Pose2::new(0.4995, 0.5, 0.0)), goals[1]));
    }
}
