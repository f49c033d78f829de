//! What the arm can do of a plan: reach, known to the solvers, and the whole plan before it is shown.
//!
//! In: the arm, heights and speeds, the objects and obstacles, a problem or its plan. Out: the problem
//! within reach; or the first pick or place that the arm cannot do, by object and place. Pure.
//!
//! Objects out of reach that need not move never do: they are obstacles. The whole plan is carried out
//! here, pick-n-place by pick-n-place, with the bodies standing as planned; the paths are not kept, for
//! each is planned again from where its object is then seen.

use cell_motion::bodies::Standing;
use cell_motion::path::{ArmModel, PathFault};
use cell_motion::pick_n_place::{CycleParameters, PickNPlace, plan};
use cell_motion::reach::{ReachMask, reaches};
use cell_values::units::Joints;
use rearrange::geometry::pose::Pose2;
use rearrange::planning::plan::{Action, ActionKind};
use rearrange::planning::problem::Reach;
use rearrange::tabletop::instance::Instance;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::sync::{Arc, OnceLock};

/// The arm as far as a plan has to suit it.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct PlanLimits {
    /// The arm.
    pub arm: ArmModel,
    /// Heights and speeds.
    pub cycle: CycleParameters,
    /// The objects of the instance, in its order; where they are moved from and to says the plan.
    pub objects: Vec<PickNPlace>,
    /// What stands on the table besides.
    pub obstacles: Vec<Standing>,
    /// Where the arm is when a pick-n-place begins.
    pub start: Joints,
    /// Filled when it is first needed; it holds for these objects and heights.
    #[serde(skip)]
    pub mask: Arc<OnceLock<ReachMask>>,
}

/// A pick or place that the arm cannot do.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
pub struct OutOfReach {
    /// Index of the object.
    pub object: usize,
    /// Its name.
    pub name: String,
    /// The object, by index, and the place of the plan's own choice that may be to blame.
    pub buffer: Option<(usize, Pose2)>,
    /// In words, with the object's name.
    pub message: String,
    /// What a person can do about it.
    pub hint: Cow<'static, str>,
}

impl PlanLimits {
    /// Checks starts and goals, and fixes what is out of reach and need not move: the names of these.
    ///
    /// # Errors
    /// An object that has to move from or to where the arm does not reach.
    pub fn restrict(&self, instance: &mut Instance) -> Result<Vec<String>, OutOfReach> {
        let mut stay = Vec::new();
        for (index, object) in instance.objects.iter_mut().enumerate() {
            let (Some(task), Some(start)) = (self.objects.get(index), object.start) else { continue };
            let moves = object.goal.is_some_and(|goal| !goal.same(&start));
            let places = [("where it is", Some(start)), ("its goal", object.goal.filter(|_| moves))];
            for (what, pose) in places {
                let Some(pose) = pose else { continue };
                match reaches(&self.arm, task, &pose, &self.cycle) {
                    Ok(()) => {}
                    Err(_) if !moves => {
                        (object.fixed, object.goal) = (true, None);
                        stay.push(object.id.clone());
                    }
                    Err(fault) => {
                        return Err(self.out_of_reach(index, &format!("{what}, {}", place(pose)), &fault));
                    }
                }
            }
        }
        Ok(stay)
    }

    /// Where new places may be; `not` are poses of objects that were tried already.
    pub fn reach(&self, table: [f64; 2], not: Vec<(usize, Pose2)>) -> Reach {
        let limits = self.clone();
        Reach::new(move |object, pose| {
            let tried = |(index, bad): &(usize, Pose2)| *index == object && bad.distance(pose) < TRIED_M;
            let Some(task) = limits.objects.get(object) else { return true };
            let made = || ReachMask::new(&limits.arm, &limits.cycle, &limits.objects, table);
            limits.mask.get_or_init(made).serves(task, pose) && !not.iter().any(tried)
        })
    }

    /// Carries a plan out, but for moving.
    ///
    /// # Errors
    /// The first pick or place that fails.
    pub fn carry_out(&self, actions: &[Action]) -> Result<(), OutOfReach> {
        let mut poses: Vec<Pose2> = self.objects.iter().map(|object| object.from).collect();
        // Objects that are where the plan has put them aside.
        let mut aside: Vec<usize> = Vec::new();
        for (number, action) in actions.iter().enumerate() {
            let Some(object) = self.objects.get(action.object) else { continue };
            let task = PickNPlace { from: action.from, to: action.to, ..object.clone() };
            let others = self.objects.iter().zip(&poses).enumerate();
            let others = others.filter(|(index, _)| *index != action.object);
            let standing = others.map(|(_, (other, pose))| other.lying_at(*pose));
            let standing = standing.chain(self.obstacles.iter().cloned()).collect();
            let table = self.cycle.tabletop(standing);
            let to_buffer = action.kind == ActionKind::Buffer;
            if let Err(fault) = plan(&self.arm, &self.start, &task, &self.cycle, &table) {
                let what =
                    format!("move {}, from {} to {}", number + 1, place(action.from), place(action.to));
                let found = self.out_of_reach(action.object, &what, &fault);
                // Its own place aside, else that of what it would meet.
                let own = match (to_buffer, aside.contains(&action.object)) {
                    (true, _) => Some((action.object, action.to)),
                    (false, true) => Some((action.object, action.from)),
                    (false, false) => None,
                };
                let met = aside.iter().find(|index| fault.names(&self.objects[**index].object));
                let buffer = own.or_else(|| met.map(|index| (*index, poses[*index])));
                return Err(OutOfReach { buffer, ..found });
            }
            poses[action.object] = action.to;
            aside.retain(|index| *index != action.object);
            aside.extend(to_buffer.then_some(action.object));
        }
        Ok(())
    }

    fn out_of_reach(&self, object: usize, what: &str, fault: &PathFault) -> OutOfReach {
        let name = self.objects[object].object.clone();
        let message = format!("{name} cannot be moved ({what}): {fault}");
        OutOfReach { object, name, buffer: None, message, hint: fault.hint().into() }
    }
}

fn place(Pose2 { x, y, .. }: Pose2) -> String {
    format!("x {x:.3} m, y {y:.3} m")
}

/// Places as near as this to one that did not do are not tried again, m.
const TRIED_M: f64 = 0.03;
