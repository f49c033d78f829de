//! Two parallel fingers at work: they close on what is between them, hold it, and let it go.
//!
//! In: the opening that the gripper's controller wants, frame by frame. Out: moved and held objects, and how
//! the step ended. Quasi-static: what one finger meets first is pushed along until both touch it; it is
//! shifted, not turned. Held by friction: two fingers carry 2 mu F. What is screwed down does not give way.
//! Prisms have no hollow, so fingers that open meet only what is beside them.

use crate::world::event::Contact;
use crate::world::fingers::Fingers;
use crate::world::grip::{keep_deeper, over};
use crate::world::placing::TOUCH_M;
use crate::world::section::Section;
use crate::world::two_finger::{Object, Wanted};
use crate::world::{BodyState, Tool, World};
use nalgebra::{Isometry3, Point3, Translation3, Vector3};
use rearrange::geometry::pose::Pose2;

/// How deep an object is at least between the pads, m.
const ENGAGED_M: f64 = 2e-3;
/// Largest angle between the tool's axis and the vertical at which the fingers find anything, rad.
const UPRIGHT_RAD: f64 = 3.0 * std::f64::consts::PI / 180.0;
/// Openings this close are the same, m.
const SAME_M: f64 = 1e-7;

/// An object between the fingers, and its extent along x of the tool, m.
type Between = (usize, [f64; 2]);

impl World {
    /// Sets a register of the two-finger gripper; false if there is none.
    pub fn set_finger_register(&mut self, name: &str, value: u8) -> bool {
        self.fingers.as_mut().is_some_and(|fingers| fingers.device.set(name, value))
    }

    /// A register of the two-finger gripper.
    pub fn finger_register(&self, name: &str) -> Option<u8> {
        let fingers = self.fingers.as_ref()?;
        fingers.device.get(name, fingers.gap_m)
    }

    /// How far the fingers are open, m. Truth: for tests and the drawing only.
    pub fn finger_gap_m(&self) -> Option<f64> {
        self.fingers.as_ref().map(|fingers| fingers.gap_m)
    }

    /// One frame of the fingers.
    pub(super) fn run_fingers(&mut self, dt_s: f64) {
        let Some(tool) = self.tool else { return };
        let Some(mut fingers) = self.fingers.take() else { return };
        fingers.holds.retain(|index| self.bodies[*index].is_held());
        if let Some(wanted) = fingers.device.step(dt_s) {
            let step_m = wanted.speed * dt_s;
            // Fingers that hold something are as far open as it is wide: whatever is not narrower lets go.
            let lets_go = !fingers.holds.is_empty() && wanted.gap_m >= fingers.gap_m - SAME_M;
            let object = if lets_go || wanted.gap_m > fingers.gap_m + SAME_M {
                self.open_fingers(&mut fingers, &tool, (wanted.gap_m, step_m))
            } else {
                self.close_fingers(&mut fingers, &tool, &wanted, step_m)
            };
            fingers.device.ended(object);
        }
        self.fingers = Some(fingers);
    }

    fn close_fingers(&mut self, fingers: &mut Fingers, tool: &Tool, wanted: &Wanted, step_m: f64) -> Object {
        if !fingers.holds.is_empty() && !upright(tool) {
            return Object::MetClosing;
        }
        let gap_m = wanted.gap_m.max(fingers.gap_m - step_m);
        let between = self.between(fingers, tool);
        let left = between.iter().map(|(_, [left, _])| *left).fold(f64::INFINITY, f64::min);
        let right = between.iter().map(|(_, [_, right])| *right).fold(f64::NEG_INFINITY, f64::max);
        let stuck = between.iter().any(|(index, _)| self.bodies[*index].fixed);
        let width_m = if stuck { 2.0 * right.max(-left) } else { right - left };
        if between.is_empty() || gap_m > width_m {
            fingers.gap_m = gap_m;
            if !stuck {
                self.shift(&between, tool, shift_between(left, right, gap_m));
            }
            let arrived = gap_m <= wanted.gap_m + SAME_M;
            return if arrived { Object::Arrived } else { Object::Moving };
        }
        if width_m > fingers.gap_m + SAME_M {
            // They press on it from above: it does not fit between them.
            return Object::MetClosing;
        }
        fingers.gap_m = width_m;
        if wanted.gap_m >= width_m - SAME_M {
            // They touch it and press no further.
            return Object::Arrived;
        }
        if !stuck {
            self.shift(&between, tool, -(left + right) / 2.0);
            fingers.force_n = wanted.force;
            for (index, _) in between {
                if !self.bodies[index].is_held() {
                    self.hold(index, tool, Pose2::new(0.0, 0.0, 0.0));
                }
                if !fingers.holds.contains(&index) {
                    fingers.holds.push(index);
                }
            }
        }
        Object::MetClosing
    }

    fn open_fingers(&mut self, fingers: &mut Fingers, tool: &Tool, (goal_m, step_m): (f64, f64)) -> Object {
        for index in std::mem::take(&mut fingers.holds) {
            if !self.sticky {
                self.land(index, &tool.velocity);
            }
        }
        let gap_m = goal_m.min(fingers.gap_m + step_m);
        if self.meets_outside(fingers, tool, gap_m) {
            return Object::MetOpening;
        }
        fingers.gap_m = gap_m;
        if gap_m >= goal_m - SAME_M { Object::Arrived } else { Object::Moving }
    }

    /// Something stands beside a finger that opens so far, and did not so far.
    fn meets_outside(&self, fingers: &Fingers, tool: &Tool, gap_m: f64) -> bool {
        let tip_m = tool.table_from_tool.translation.z;
        let meets = |place: f64, index: usize| {
            let body = &self.bodies[index];
            if !body.is_resting() || body.top_m() <= tip_m {
                return false;
            }
            let pose = seen_from_above(&finger(tool, place));
            let overlap = Section::overlap(&fingers.section, &pose, &body.section, &body.pose());
            overlap.is_some_and(|overlap| overlap.depth_m > TOUCH_M)
        };
        let pairs = fingers.places_at(gap_m).into_iter().zip(fingers.places());
        pairs.into_iter().any(|(there, here)| {
            (0..self.bodies.len()).any(|index| meets(there, index) && !meets(here, index))
        })
    }

    /// What is between the fingers, and deep enough.
    fn between(&self, fingers: &Fingers, tool: &Tool) -> Vec<Between> {
        if !upright(tool) {
            return Vec::new();
        }
        let (tip_m, frame) = (tool.table_from_tool.translation.z, seen_from_above(&tool.table_from_tool));
        let found = self.bodies.iter().enumerate().filter_map(|(index, body)| {
            let deep = body.is_resting()
                && body.top_m() >= tip_m + ENGAGED_M
                && body.bottom_m() <= tip_m + fingers.spec.pad_m;
            if !deep && !fingers.holds.contains(&index) {
                return None;
            }
            let extent = body.section.extent(&body.pose(), &frame, fingers.spec.width_m / 2.0)?;
            let inside = extent[0] < fingers.gap_m / 2.0 && extent[1] > -fingers.gap_m / 2.0;
            inside.then_some((index, extent))
        });
        found.collect()
    }

    /// Moves objects along x of the tool.
    fn shift(&mut self, between: &[Between], tool: &Tool, by_m: f64) {
        if by_m.abs() <= SAME_M {
            return;
        }
        let along = tool.table_from_tool.rotation * Vector3::x() * by_m;
        for (index, _) in between {
            let body = &mut self.bodies[*index];
            match &mut body.state {
                BodyState::Held { tool_from_object, .. } => {
                    *tool_from_object = Translation3::new(by_m, 0.0, 0.0) * *tool_from_object;
                }
                _ => body.table_from_object.translation.vector += Vector3::new(along.x, along.y, 0.0),
            }
            self.note_push(*index, "finger", by_m.abs());
        }
    }

    /// How far a finger presses on the table or, with nothing held, on an object.
    pub(super) fn finger_contact(&self, tool: &Tool, holding: bool) -> Option<Contact> {
        let fingers = self.fingers.as_ref()?;
        let mut deepest = None;
        for place in fingers.places() {
            let tip = finger(tool, place).translation.vector;
            let mut press = |against: &str, depth_m: f64| {
                let contact = Contact { moving: "finger".to_owned(), against: against.to_owned(), depth_m };
                keep_deeper(&mut deepest, Some(contact));
            };
            if self.on_board(tip.x, tip.y) && tip.z < 0.0 {
                press("table", -tip.z);
            }
            for body in self.bodies.iter().filter(|_| !holding) {
                if let Some((over, _)) = over(body, &Point3::from(tip))
                    && over < 0.0
                {
                    press(&body.id, -over);
                }
            }
        }
        deepest
    }
}

/// Whether the tool points down.
fn upright(tool: &Tool) -> bool {
    let axis = -(tool.table_from_tool.rotation * Vector3::z());
    axis.angle(&Vector3::z()) <= UPRIGHT_RAD
}

/// A finger's frame on the table.
pub(super) fn finger(tool: &Tool, place_m: f64) -> Isometry3<f64> {
    tool.table_from_tool * Isometry3::translation(place_m, 0.0, 0.0)
}

/// Position and direction of x as seen from above.
pub(super) fn seen_from_above(at: &Isometry3<f64>) -> Pose2 {
    let x_axis = at.rotation * Vector3::x();
    Pose2::new(at.translation.x, at.translation.y, x_axis.y.atan2(x_axis.x))
}

/// How far what reaches from `left` to `right` is moved by fingers that are so far open.
fn shift_between(left: f64, right: f64, gap_m: f64) -> f64 {
    let half = gap_m / 2.0;
    if right > half {
        half - right
    } else if left < -half {
        -half - left
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use crate::world::drive::{Drive, FingersSpec};
    use crate::world::event::EventKind;
    use crate::world::spec::{GripperSpec, WorldObject};
    use crate::world::tests::{Cell, block, gripper, no_errors};

    /// A cell with a 2F-85 that is active, its fingers over (0.25, 0.25).
    fn cell(objects: Vec<WorldObject>) -> Cell {
        let drive = Drive::Fingers(FingersSpec::ROBOTIQ_2F85);
        let gripper = GripperSpec { drive, cups: Vec::new(), ..gripper() };
        let mut cell = Cell::with(gripper, objects, no_errors(), 1);
        assert!(cell.world.set_finger_register("ACT", 1));
        cell.wait(1.1);
        cell
    }

    fn go(cell: &mut Cell, position: u8) {
        for (name, value) in [("POS", position), ("SPE", 255), ("FOR", 100), ("GTO", 1)] {
            assert!(cell.world.set_finger_register(name, value));
        }
        assert_eq!(cell.world.finger_register("OBJ"), Some(0));
        cell.wait(1.0);
    }

    fn read(cell: &Cell, name: &str) -> u8 {
        cell.world.finger_register(name).unwrap()
    }

    #[test]
    fn without_an_object_the_fingers_close_and_open_wholly() {
        let mut cell = cell(Vec::new());
        go(&mut cell, 255);
        assert_eq!((read(&cell, "OBJ"), read(&cell, "POS"), read(&cell, "PRE")), (3, 227, 255));
        go(&mut cell, 0);
        assert_eq!((read(&cell, "OBJ"), read(&cell, "POS")), (3, 3));
        go(&mut cell, 100);
        assert_eq!((read(&cell, "OBJ"), read(&cell, "POS")), (3, 100));
    }

    #[test]
    fn an_object_between_the_fingers_is_centred_held_carried_and_set_down() {
        let mut cell = cell(vec![block("a", 0.26, 0.25)]);
        cell.go([0.25, 0.25, 0.005]);
        go(&mut cell, 255);
        assert_eq!(read(&cell, "OBJ"), 2);
        // 50 mm of 85: 227 - 50 / 85 * 224.
        assert_eq!(read(&cell, "POS"), 95);
        assert!((cell.world.finger_gap_m().unwrap() - 0.05).abs() < 1e-6);
        let pose = cell.pose("a");
        assert!((pose.x - 0.25).abs() < 1e-6 && (pose.y - 0.25).abs() < 1e-6, "centred: {pose:?}");
        cell.go([0.25, 0.25, 0.1]);
        cell.go([0.35, 0.3, 0.1]);
        assert_eq!(cell.world.held().collect::<Vec<_>>(), ["a"]);
        assert_eq!(read(&cell, "OBJ"), 2, "while it is carried");
        cell.go([0.35, 0.3, 0.005]);
        go(&mut cell, 0);
        let pose = cell.pose("a");
        assert!((pose.x - 0.35).abs() < 1e-6 && (pose.y - 0.3).abs() < 1e-6, "{pose:?}");
        assert!(cell.world.object("a").unwrap().is_resting());
        assert_eq!(read(&cell, "OBJ"), 3);
        assert_eq!(cell.happened(|event| matches!(event, EventKind::Gripped { .. })), 1);
    }

    #[test]
    fn an_object_that_is_lost_lets_the_fingers_close() {
        let mut cell = cell(vec![block("a", 0.25, 0.25)]);
        cell.go([0.25, 0.25, 0.005]);
        for (name, value) in [("POS", 255), ("FOR", 0), ("GTO", 1)] {
            cell.world.set_finger_register(name, value);
        }
        cell.wait(1.0);
        cell.go([0.25, 0.25, 0.1]);
        assert_eq!((cell.world.held().count(), read(&cell, "OBJ")), (1, 2));
        // 2 x 0.5 x 20 N carry 0.1 kg up to 190 m/s2.
        for frame in 0..20 {
            cell.at[0] += if frame % 2 == 0 { 0.03 } else { -0.03 };
            cell.frame(0.0);
        }
        cell.wait(1.0);
        assert_eq!((cell.world.held().count(), read(&cell, "OBJ"), read(&cell, "POS")), (0, 3, 227));
    }

    #[test]
    fn what_is_too_wide_or_too_low_is_not_gripped() {
        let mut wide = block("wide", 0.25, 0.25);
        wide.footprint = rearrange::geometry::footprint::Footprint::rectangle(0.1, 0.1).unwrap();
        let mut cell = cell(vec![wide]);
        cell.go([0.25, 0.25, 0.012]);
        let contact = cell.world.contact().unwrap();
        assert_eq!((contact.moving.as_str(), contact.against.as_str()), ("finger", "wide"));
        cell.go([0.25, 0.25, 0.021]);
        go(&mut cell, 255);
        assert_eq!((cell.world.held().count(), read(&cell, "OBJ")), (0, 3), "the tips are above it");
    }

    #[test]
    fn what_does_not_fit_between_the_fingers_is_not_gripped_from_above() {
        let mut wide = block("wide", 0.25, 0.25);
        wide.footprint = rearrange::geometry::footprint::Footprint::rectangle(0.1, 0.1).unwrap();
        let mut cell = cell(vec![wide]);
        // 4 mm deep in its top.
        cell.go([0.25, 0.25, 0.016]);
        go(&mut cell, 255);
        assert_eq!((cell.world.held().count(), read(&cell, "OBJ")), (0, 2));
        let open = cell.world.finger_gap_m().unwrap();
        assert!((open - 0.085).abs() < 1e-6, "{open}");
    }

    #[test]
    fn what_is_as_wide_as_the_fingers_open_is_held_and_let_go() {
        let mut wide = block("wide", 0.25, 0.25);
        wide.footprint = rearrange::geometry::footprint::Footprint::rectangle(0.085, 0.04).unwrap();
        let mut cell = cell(vec![wide]);
        cell.go([0.25, 0.25, 0.005]);
        go(&mut cell, 255);
        assert_eq!((cell.world.held().count(), read(&cell, "OBJ")), (1, 2));
        go(&mut cell, 0);
        assert_eq!((cell.world.held().count(), read(&cell, "OBJ")), (0, 3));
    }

    #[test]
    fn a_tool_that_tilts_keeps_what_it_holds() {
        let mut cell = cell(vec![block("a", 0.25, 0.25)]);
        cell.go([0.25, 0.25, 0.005]);
        go(&mut cell, 255);
        cell.go([0.25, 0.25, 0.1]);
        let before = (read(&cell, "OBJ"), read(&cell, "POS"));
        for frame in 0..200 {
            cell.frame(0.001 * f64::from(frame));
        }
        assert_eq!(
            (read(&cell, "OBJ"), read(&cell, "POS"), cell.world.held().count()),
            (before.0, before.1, 1)
        );
        cell.wait(0.5);
        assert_eq!((read(&cell, "OBJ"), read(&cell, "POS")), before, "upright again");
    }

    #[test]
    fn what_is_screwed_down_stops_the_fingers_and_stays() {
        let mut post = block("post", 0.255, 0.25);
        post.fixed = true;
        let mut cell = cell(vec![post]);
        cell.go([0.25, 0.25, 0.005]);
        go(&mut cell, 255);
        assert_eq!((read(&cell, "OBJ"), cell.world.held().count()), (2, 0));
        assert!((cell.world.finger_gap_m().unwrap() - 0.06).abs() < 1e-6, "the nearer side stops both");
        assert!((cell.pose("post").x - 0.255).abs() < 1e-12);
    }

    #[test]
    fn fingers_that_open_meet_what_is_beside_them() {
        let mut cell = cell(vec![block("a", 0.30, 0.25)]);
        go(&mut cell, 255);
        cell.go([0.25, 0.25, 0.005]);
        go(&mut cell, 0);
        assert_eq!(read(&cell, "OBJ"), 1);
        // The block begins 25 mm from the middle, a finger is 14 mm thick.
        assert!((cell.world.finger_gap_m().unwrap() - 0.022).abs() < 1e-3);
    }

    #[test]
    fn a_finger_pushes_what_it_runs_into() {
        let mut cell = cell(vec![block("a", 0.35, 0.25)]);
        go(&mut cell, 255);
        cell.go([0.25, 0.25, 0.005]);
        cell.go([0.35, 0.25, 0.005]);
        // Closed, the front of a finger is 14 mm ahead of the middle, half the block 25 mm.
        assert!((cell.pose("a").x - 0.389).abs() < 1e-4, "{:?}", cell.pose("a"));
    }
}
