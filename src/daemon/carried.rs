//! Where an object is that the cell has carried since the camera saw it.
//!
//! In: what hangs on the gripper and how, the arm's joints, what is seen. Out: the poses of what hangs
//! there and of what was let go and not seen since. Without it the table is drawn as it was before the
//! move, beside an arm that carries what is drawn there. Nothing is planned on it: plans come from what is
//! measured.

use cell_machine::supervisor::model::CellModel;
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
    /// What hangs on the gripper, and its pose in the tool's frame seen from above.
    held: Option<(String, Pose2)>,
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
    pub fn hangs(&mut self, object: Option<(&str, Option<Pose2>)>) -> bool {
        let known = object.and_then(|(id, pose)| Some((id, pose?)));
        if known == self.held.as_ref().map(|(id, pose)| (id.as_str(), *pose)) {
            return false;
        }
        self.held = known.map(|(id, pose)| (id.to_string(), pose));
        for object in &mut self.objects {
            object.held = self.held.as_ref().is_some_and(|(id, _)| *id == object.id);
        }
        for object in self.objects.iter_mut().filter(|object| !object.held) {
            object.lost |= object.bottom_m > PLACED_WITHIN_M;
            object.bottom_m = 0.0;
        }
        true
    }

    /// The arm's joints, rad.
    pub fn arm(&mut self, model: &CellModel, q: &Joints) {
        let Some((id, tool_from_object)) = &self.held else { return };
        let tool = model.arm.tool_at(q);
        let (at, along) = (tool.translation.vector, tool.rotation * nalgebra::Vector3::x());
        let height = model.objects.iter().find(|object| object.id == *id).map_or(0.0, |object| object.height);
        let view = CarriedView {
            id: id.clone(),
            pose: Pose2::new(at.x, at.y, along.y.atan2(along.x)).compose(tool_from_object),
            bottom_m: (at.z - height).max(0.0),
            held: true,
            lost: false,
        };
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

#[cfg(test)]
mod tests {
    use super::*;
    use cell_values::time::Timestamp;
    use cell_vision::observe::ObjectEstimate;

    fn sight(ids: &[&str]) -> Observation {
        let estimate = |id: &&str| ObjectEstimate {
            id: id.to_string(),
            pose: Pose2::new(0.1, 0.1, 0.0),
            std_xy_m: 1e-4,
            std_theta_rad: 1e-3,
            views: 1,
            rejected_views: 0,
            tilt_rad: 0.0,
            tilt_std_rad: 0.01,
            height_error_m: 0.0,
            height_std_m: 1e-3,
            time: Timestamp::ZERO,
        };
        Observation { objects: ids.iter().map(estimate).collect(), ..Observation::default() }
    }

    #[test]
    fn what_was_let_go_is_there_until_it_is_seen() {
        let hangs = Pose2::new(0.01, 0.0, 0.2);
        let mut carried = Carried::default();
        assert!(carried.hangs(Some(("lid", Some(hangs)))) && !carried.hangs(Some(("lid", Some(hangs)))));
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
        assert!(carried.hangs(Some(("lid", Some(hangs)))));
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
