//! Where an object is that the cell has carried since the camera saw it.
//!
//! In: what hangs on the gripper and how, the arm's joints, what is seen. Out: the poses of what hangs
//! there and of what was let go and not seen since. Without it the table is drawn as it was before the
//! move, beside an arm that carries what is drawn there. Nothing is planned on it: plans come from what is
//! measured.

use cell_motion::path::ArmModel;
use cell_motion::put_down::Grasp;
use cell_values::units::Joints;
use cell_vision::observe::Observation;
use rearrange::geometry::pose::Pose2;
use serde::Serialize;

/// An object where the arm has taken it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CarriedView {
    /// Its name.
    pub id: String,
    /// Seen from above, table frame.
    pub pose: Pose2,
    /// Its lower side over the table, m.
    pub bottom_m: f64,
    /// It hangs on the gripper; otherwise it was let go there.
    pub held: bool,
    /// It fell from there, or a person has it: where it is now is not known.
    pub lost: bool,
}

/// What is let go from higher than this falls, or is taken: where it is then is not known, m.
const PLACED_WITHIN_M: f64 = 0.01;

/// See the module.
#[derive(Default)]
pub struct Carried {
    /// What hangs on the gripper, and how.
    held: Option<(String, Grasp)>,
    objects: Vec<CarriedView>,
}

impl Carried {
    /// All that is not where it was seen.
    pub fn objects(&self) -> &[CarriedView] {
        &self.objects
    }

    /// What hangs on the gripper, where it was taken.
    pub fn held(&self) -> Option<&CarriedView> {
        self.objects.iter().find(|object| object.held)
    }

    /// What the machine knows of the gripper; true if that is something else than before. Where it is not
    /// known how an object hangs, it stays where it was seen.
    pub fn hangs(&mut self, object: Option<(&str, Option<&Grasp>)>) -> bool {
        let known = object.and_then(|(id, grasp)| Some((id, grasp?)));
        if known == self.held.as_ref().map(|(id, grasp)| (id.as_str(), grasp)) {
            return false;
        }
        self.held = known.map(|(id, grasp)| (id.to_string(), grasp.clone()));
        for object in &mut self.objects {
            object.held = self.held.as_ref().is_some_and(|(id, _)| *id == object.id);
            if !object.held {
                object.lost |= object.bottom_m > PLACED_WITHIN_M;
                object.bottom_m = 0.0;
            }
        }
        true
    }

    /// The arm's joints, rad. Where its tool does not point straight down, the object stays where it was.
    pub fn arm(&mut self, arm: &ArmModel, q: &Joints) {
        let Some((id, grasp)) = &self.held else { return };
        let Some(pose) = grasp.object_at(arm, q) else { return };
        let bottom_m = (arm.tool_at(q).translation.vector.z - grasp.load().height).max(0.0);
        let view = CarriedView { id: id.clone(), pose, bottom_m, held: true, lost: false };
        match self.objects.iter_mut().find(|object| object.id == *id) {
            Some(object) => *object = view,
            None => self.objects.push(view),
        }
    }

    /// A look shows what is there, and at the whole table (not `partial`) also what is not.
    pub fn seen(&mut self, seen: &Observation, partial: bool) {
        let shown = |id: &String| {
            seen.object(id).is_some()
                || seen.missing.contains(id)
                || seen.suspicious.iter().any(|object| object.id == *id)
        };
        self.objects.retain(|object| object.held || (partial && !shown(&object.id)));
    }
}

/// A look at a part of the table with what was seen of the rest before.
pub fn merged(mut seen: Observation, before: Option<&Observation>) -> Observation {
    let Some(before) = before else { return seen };
    for object in &before.objects {
        let doubted = seen.suspicious.iter().any(|doubted| doubted.id == object.id);
        if !doubted && seen.object(&object.id).is_none() {
            seen.objects.push(object.clone());
        }
    }
    let known: Vec<String> = seen.objects.iter().map(|object| object.id.clone()).collect();
    seen.missing.retain(|id| !known.contains(id));
    seen
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use cell_motion::bodies::Load;
    use cell_values::time::Timestamp;
    use cell_vision::observe::ObjectEstimate;
    use rearrange::geometry::footprint::Footprint;

    /// An object that lies flat, seen in one picture.
    pub(crate) fn estimate(id: &str, x: f64) -> ObjectEstimate {
        ObjectEstimate {
            id: id.to_string(),
            pose: Pose2::new(x, 0.1, 0.0),
            std_xy_m: 1e-4,
            std_theta_rad: 1e-3,
            views: 1,
            rejected_views: 0,
            tilt_rad: 0.0,
            tilt_std_rad: 0.01,
            height_error_m: 0.0,
            height_std_m: 1e-3,
            time: Timestamp::ZERO,
        }
    }

    fn sight(ids: &[&str]) -> Observation {
        let objects = ids.iter().map(|id| estimate(id, 0.1)).collect();
        Observation { objects, ..Observation::default() }
    }

    #[test]
    fn what_was_let_go_is_there_until_it_is_seen() {
        let (hangs, footprint) = (Pose2::new(0.01, 0.0, 0.2), Footprint::disc(0.04).unwrap());
        let load = Load { name: "lid".into(), footprint, tool_from_object: hangs, height: 0.02 };
        let grasp = Grasp::remembered(load, 1.0);
        let mut carried = Carried::default();
        assert!(carried.hangs(Some(("lid", Some(&grasp)))) && !carried.hangs(Some(("lid", Some(&grasp)))));
        let at = |held| CarriedView { id: "lid".into(), pose: hangs, bottom_m: 0.0, held, lost: false };
        carried.objects.push(at(true));
        carried.seen(&sight(&["lid"]), false);
        assert_eq!(
            carried.held(),
            Some(&at(true)),
            "a picture with its marker does not take it off the cups"
        );
        assert!(carried.hangs(None));
        carried.seen(&sight(&["mug"]), true);
        assert_eq!((carried.objects(), carried.held()), (&[at(false)][..], None));
        carried.seen(&sight(&["mug", "lid"]), true);
        assert!(carried.objects().is_empty());
        carried.objects.push(at(false));
        let gone = Observation { missing: vec!["lid".into()], ..sight(&["mug"]) };
        carried.seen(&gone, true);
        assert!(carried.objects().is_empty(), "a look shows that it is not there");
        carried.objects.push(at(false));
        carried.seen(&sight(&["mug"]), false);
        assert!(carried.objects().is_empty(), "nor is it anywhere on the table");
        assert!(carried.hangs(Some(("lid", Some(&grasp)))));
        carried.objects.push(CarriedView { bottom_m: 0.2, ..at(true) });
        assert!(carried.hangs(None));
        let lost = CarriedView { lost: true, ..at(false) };
        assert_eq!(carried.objects(), [lost], "it fell, or a person has it");
        carried.seen(&sight(&["lid"]), true);
        assert!(carried.objects().is_empty());
        assert!(
            !carried.hangs(Some(("lid", None))),
            "how it hangs is not known: it is shown where it was seen"
        );
    }
}
