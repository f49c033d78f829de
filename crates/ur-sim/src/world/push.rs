//! What the arm touches from the side is pushed along the table, and what it touches presses back.
//!
//! In: the tool's pose in this frame. Out: moved objects, and the force the tool feels. The model is
//! quasi-static and planar: the pusher penetrates, and the object leaves it along the contact normal,
//! turning as one that slides with uniform pressure does (ellipsoidal limit surface: a force `f` at `r`
//! moves it along `f` and turns it by `r x f / c^2`, with `c` the mean distance of its points from its
//! centre). What the object meets is pushed in turn. Whether a touch is one from the side or from above is
//! decided when it begins, by which penetration is the smaller. An object that is screwed down, or is in
//! front of one that is, does not give way: the arm presses on it.

use crate::world::event::EventKind;
use crate::world::finger_grip::{finger, seen_from_above};
use crate::world::placing::TOUCH_M;
use crate::world::section::Section;
use crate::world::{Body, BodyState, World};
use cell_values::units::GRAVITY;
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use rearrange::geometry::pose::Pose2;
use std::sync::Arc;

/// Friction between objects and table.
const FRICTION: f64 = 0.4;
/// Stiffness of cups and gripper when they press on something, N/m.
const STIFFNESS_N_PER_M: f64 = 5000.0;
/// Rounds in which an object is moved out of its pusher; turning does not part them at once.
const ROUNDS: usize = 8;
/// Room over what an object can reach, m, for rounding.
const SURELY_M: f64 = 1e-6;
/// Objects one push may set in motion.
const MAX_CHAIN: usize = 32;

/// Something of the arm that can push: its outline, where it is, how far down it reaches.
pub(super) struct Pusher {
    name: String,
    section: Arc<Section>,
    pose: Pose2,
    bottom_m: f64,
    /// Objects it does not push: what it holds, and what lay against that where it was gripped.
    spares: Vec<usize>,
}

impl Pusher {
    /// An object that is moved by something else than the arm.
    pub(super) fn object(index: usize, body: &Body) -> Pusher {
        Pusher {
            name: body.id.clone(),
            section: body.section.clone(),
            pose: body.pose(),
            bottom_m: body.bottom_m(),
            spares: vec![index],
        }
    }
}

impl World {
    /// Moves what the tool has run into from the side, and notes what it touches from above.
    pub(super) fn push_aside(&mut self) {
        if self.is_clear_above() {
            self.from_above.clear();
            self.pushing = Vector3::zeros();
            return;
        }
        let mut pushing = Vector3::zeros();
        let mut from_above = Vec::new();
        // What stands on others goes with them before it is looked at itself.
        let mut order: Vec<usize> = (0..self.bodies.len()).collect();
        if self.bodies.iter().any(Body::is_stacked) {
            order.sort_by(|a, b| self.bodies[*a].bottom_m().total_cmp(&self.bodies[*b].bottom_m()));
        }
        for pusher in self.pushers() {
            for index in order.iter().copied() {
                let Some(depth_m) = self.met(&pusher, index) else { continue };
                let over_m = self.bodies[index].top_m() - pusher.bottom_m;
                let touch = (pusher.name.clone(), index);
                if self.from_above.contains(&touch) || depth_m >= over_m {
                    from_above.push(touch);
                } else if let Some(force) = self.push(&pusher, index) {
                    pushing += force;
                } else {
                    from_above.push(touch);
                }
            }
        }
        self.from_above = from_above;
        self.pushing = pushing;
    }

    /// Nothing of the arm is as low as the highest place that an object on the table can reach: most of the
    /// time, and soon found out.
    fn is_clear_above(&self) -> bool {
        let Some(tool) = &self.tool else { return false };
        if self.fingers.is_some() {
            return false;
        }
        let height = |x: f64, y: f64, z: f64| (tool.table_from_tool * Point3::new(x, y, z)).z;
        let cups = self.gripper.cups.iter().map(|cup| height(cup.x_m, cup.y_m, 0.0));
        let housing = height(0.0, 0.0, -self.gripper.body_above_lips_m);
        let held = self.bodies.iter().filter_map(|body| {
            let BodyState::Held { tool_from_object, .. } = &body.state else { return None };
            let origin = Point3::from(tool_from_object.translation.vector);
            Some((tool.table_from_tool * origin).z - body.section.bounding_radius_m())
        });
        let lowest = cups.chain(held).fold(housing, f64::min);
        let highest = |body: &Body| {
            body.table_from_object.translation.z + body.height_m + body.section.bounding_radius_m()
        };
        let resting = self.bodies.iter().filter(|body| body.is_resting());
        lowest > resting.map(highest).fold(0.0, f64::max) + SURELY_M
    }

    /// Force on the tool from what it touches, N, in the table frame. What hangs on it is the payload's
    /// affair.
    pub fn contact_force(&self) -> Vector3<f64> {
        let pressing = self.touch.as_ref().map_or(0.0, |contact| contact.depth_m) * STIFFNESS_N_PER_M;
        Vector3::new(0.0, 0.0, pressing) - self.pushing
    }

    fn pushers(&self) -> Vec<Pusher> {
        let Some(tool) = self.tool else { return Vec::new() };
        // Seen from above the tool's frame is mirrored; its parts are named by outlines that are turned
        // over.
        let mut pushers = Vec::new();
        for (cup, section) in self.gripper.cups.iter().zip(&self.cup_sections) {
            let lip = tool.table_from_tool * Isometry3::translation(cup.x_m, cup.y_m, 0.0);
            pushers.push(Pusher {
                name: "cup".to_owned(),
                section: section.clone(),
                pose: seen_from_above(&lip),
                bottom_m: lip.translation.z,
                spares: self.held_indices(),
            });
        }
        if let Some(fingers) = &self.fingers {
            for place in fingers.places() {
                let tip = finger(&tool, place);
                pushers.push(Pusher {
                    name: "finger".to_owned(),
                    section: fingers.section.clone(),
                    pose: seen_from_above(&tip),
                    bottom_m: tip.translation.z,
                    spares: self.held_indices(),
                });
            }
        }
        let housing =
            tool.table_from_tool * Isometry3::translation(0.0, 0.0, -self.gripper.body_above_lips_m);
        pushers.push(Pusher {
            name: "gripper".to_owned(),
            section: self.housing_from_above.clone(),
            pose: seen_from_above(&housing),
            bottom_m: housing.translation.z,
            spares: self.held_indices(),
        });
        for (index, body) in self.bodies.iter().enumerate() {
            let BodyState::Held { tool_from_object, beside, .. } = &body.state else { continue };
            let mut moved = body.clone();
            moved.table_from_object = tool.table_from_tool * tool_from_object;
            let spares = beside.iter().copied().chain([index]).collect();
            pushers.push(Pusher {
                name: body.id.clone(),
                section: body.section.clone(),
                pose: moved.pose(),
                bottom_m: moved.bottom_m(),
                spares,
            });
        }
        pushers
    }

    fn held_indices(&self) -> Vec<usize> {
        (0..self.bodies.len()).filter(|index| self.bodies[*index].is_held()).collect()
    }

    /// How deep the pusher sits in an object that lies there, m; `None` if it does not touch it.
    fn met(&self, pusher: &Pusher, index: usize) -> Option<f64> {
        let body = &self.bodies[index];
        if !body.is_resting() || pusher.spares.contains(&index) || pusher.bottom_m >= body.top_m() {
            return None;
        }
        let overlap = Section::overlap(&pusher.section, &pusher.pose, &body.section, &body.pose())?;
        (overlap.depth_m > TOUCH_M).then_some(overlap.depth_m)
    }

    /// Pushes an object and what it meets; the force that takes. `None`, and nothing moved, if something
    /// does not give way.
    pub(super) fn push(&mut self, pusher: &Pusher, index: usize) -> Option<Vector3<f64>> {
        let before: Vec<Isometry3<f64>> = self.bodies.iter().map(|body| body.table_from_object).collect();
        let direction = self.slide(&pusher.section, &pusher.pose, index);
        let mut moved = vec![index];
        let mut k = 0;
        let gives_way = direction.is_some()
            && loop {
                let Some(&by) = moved.get(k) else { break true };
                let (section, pose) = (self.bodies[by].section.clone(), self.bodies[by].pose());
                for (other, _) in self.overlapping(by, TOUCH_M) {
                    // Back towards where the push came from there is no way.
                    if moved[..=k].contains(&other) {
                        continue;
                    }
                    if moved.len() >= MAX_CHAIN || self.slide(&section, &pose, other).is_none() {
                        k = usize::MAX;
                        break;
                    }
                    if !moved.contains(&other) {
                        moved.push(other);
                    }
                }
                if k == usize::MAX {
                    break false;
                }
                k += 1;
            };
        if !gives_way {
            for (body, before) in self.bodies.iter_mut().zip(before) {
                body.table_from_object = before;
            }
            return None;
        }
        self.carry_along(&before);
        let weight = |index: &usize| (self.bodies[*index].mass_kg + self.carried_kg(*index)) * GRAVITY;
        let weight_n: f64 = moved.iter().map(weight).sum();
        for index in moved {
            let by_m = (self.bodies[index].table_from_object.translation.vector
                - before[index].translation.vector)
                .norm();
            self.note_push(index, &pusher.name, by_m);
            self.fall_off(index);
        }
        self.settle_stacks();
        direction.map(|direction| direction * FRICTION * weight_n)
    }

    /// Moves an object out of an outline; the direction of the first contact. `None` if it is screwed down.
    fn slide(&mut self, outline: &Section, pose: &Pose2, index: usize) -> Option<Vector3<f64>> {
        if self.bodies[index].fixed {
            return None;
        }
        let section = self.bodies[index].section.clone();
        let mut direction = None;
        for round in 0..ROUNDS {
            let at = self.bodies[index].pose();
            let Some(overlap) = Section::overlap(outline, pose, &section, &at) else { break };
            if overlap.depth_m <= TOUCH_M {
                break;
            }
            let normal = Vector3::new(overlap.away[0], overlap.away[1], 0.0);
            direction = direction.or(Some(normal));
            let centre = at.transform(section.centroid());
            let touch = Section::touch(outline, pose, &section, &at).unwrap_or(centre);
            let lever = (touch[0] - centre[0]) * normal.y - (touch[1] - centre[1]) * normal.x;
            let turns = if round + 1 < ROUNDS { lever / section.friction_radius_m().powi(2) } else { 0.0 };
            let along_m = (overlap.depth_m + TOUCH_M) / (1.0 + turns * lever);
            let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turns * along_m);
            let about = Vector3::new(centre[0], centre[1], 0.0);
            let body = &mut self.bodies[index].table_from_object;
            body.translation.vector = turn * (body.translation.vector - about) + about + normal * along_m;
            body.rotation = turn * body.rotation;
        }
        // Touching within rounding is no touch: then there is nothing to move.
        direction.or(Some(Vector3::zeros()))
    }

    /// Notes a push, as one event for as long as nothing else happens.
    pub(super) fn note_push(&mut self, index: usize, by: &str, by_m: f64) {
        let object = &self.bodies[index].id;
        if let Some(EventKind::Pushed { object: last, by: pusher, distance_m }) =
            self.events.back_mut().map(|event| &mut event.kind)
            && last == object
            && pusher == by
        {
            *distance_m += by_m;
            return;
        }
        let (object, by) = (object.clone(), by.to_owned());
        self.record(EventKind::Pushed { object, by, distance_m: by_m });
    }
}

#[cfg(test)]
mod tests {
    use crate::world::event::EventKind;
    use crate::world::tests::{Cell, block, no_errors};

    fn cell(objects: Vec<crate::world::spec::WorldObject>) -> Cell {
        Cell::new(objects, no_errors(), 1)
    }

    #[test]
    fn a_cup_pushes_what_it_runs_into_and_feels_its_friction() {
        let mut cell = cell(vec![block("a", 0.25, 0.25)]);
        cell.go([0.15, 0.25, 0.1]);
        cell.go([0.15, 0.25, 0.01]);
        cell.go([0.25, 0.25, 0.01]);
        let pose = cell.pose("a");
        // The front of the cup is 10 mm ahead of its middle, half the block 25 mm.
        assert!((pose.x - 0.285).abs() < 1e-4 && (pose.y - 0.25).abs() < 1e-4, "{pose:?}");
        assert!(pose.theta.abs() < 1e-6);
        assert_eq!(cell.happened(|event| matches!(event, EventKind::Contact(_))), 0);
        let pushes = cell.happened(|event| matches!(event, EventKind::Pushed { by, .. } if by == "cup"));
        assert_eq!(pushes, 1, "one push, however many frames");
        cell.go([0.252, 0.25, 0.01]);
        cell.at[0] += 5e-4;
        cell.frame(0.0);
        let force = cell.world.contact_force();
        assert!((force.x + 0.4 * 0.1 * 9.81).abs() < 0.01 && force.y.abs() < 1e-6, "{force}");
        cell.go([0.2, 0.25, 0.01]);
        assert_eq!(cell.world.contact_force().norm(), 0.0);
    }

    #[test]
    fn a_push_beside_the_middle_turns_the_object() {
        let mut cell = cell(vec![block("a", 0.25, 0.25)]);
        cell.go([0.15, 0.268, 0.1]);
        cell.go([0.15, 0.268, 0.01]);
        cell.go([0.25, 0.268, 0.01]);
        let pose = cell.pose("a");
        // Pushed along x above the middle: clockwise.
        assert!(pose.theta < -0.2 && pose.x > 0.26, "{pose:?}");
        let apart = cell.world.met(&cell.world.pushers()[0], 0);
        assert!(apart.is_none(), "{apart:?}");
    }

    #[test]
    fn what_is_pushed_pushes_on_and_falls_off_the_edge() {
        let mut cell = cell(vec![block("a", 0.30, 0.25), block("b", 0.36, 0.25)]);
        cell.go([0.2, 0.25, 0.1]);
        cell.go([0.2, 0.25, 0.01]);
        cell.go([0.4, 0.25, 0.01]);
        assert!((cell.pose("a").x - 0.435).abs() < 1e-4, "{:?}", cell.pose("a"));
        assert!((cell.pose("b").x - 0.485).abs() < 1e-4, "{:?}", cell.pose("b"));
        cell.go([0.55, 0.25, 0.01]);
        assert!(cell.world.object("b").unwrap().is_fallen());
    }

    #[test]
    fn what_is_screwed_down_does_not_give_way_nor_does_what_stands_before_it() {
        let mut fixed = block("post", 0.36, 0.25);
        fixed.fixed = true;
        let mut cell = cell(vec![block("a", 0.30, 0.25), fixed]);
        cell.go([0.2, 0.25, 0.1]);
        cell.go([0.2, 0.25, 0.004]);
        cell.go([0.3, 0.25, 0.004]);
        assert!((cell.pose("post").x - 0.36).abs() < 1e-12);
        let pose = cell.pose("a");
        assert!((pose.x - 0.31).abs() < 1e-3, "it stops at the post: {pose:?}");
        let contact = cell.world.contact().unwrap();
        assert!(contact.against == "a" && contact.depth_m > 0.006, "{contact:?}");
        assert!(cell.world.contact_force().z > 30.0);
    }

    #[test]
    fn an_object_carried_low_pushes_others_along() {
        let mut cell = cell(vec![block("a", 0.15, 0.25), block("b", 0.30, 0.25)]);
        cell.grip(0.15, 0.25, 0.02);
        cell.go([0.15, 0.25, 0.025]);
        cell.go([0.30, 0.25, 0.025]);
        let (carried, pushed) = (cell.pose("a"), cell.pose("b"));
        assert!((carried.x - 0.30).abs() < 1e-3 && (pushed.x - 0.35).abs() < 1e-3, "{carried:?} {pushed:?}");
        assert!(cell.world.object("a").unwrap().bottom_m() < 0.006, "it is not lifted over the other");
    }

    #[test]
    fn coming_down_on_an_edge_presses_and_does_not_push() {
        let mut cell = cell(vec![block("a", 0.25, 0.25)]);
        cell.go([0.217, 0.25, 0.1]);
        cell.go([0.217, 0.25, 0.017]);
        assert!((cell.pose("a").x - 0.25).abs() < 1e-4, "{:?}", cell.pose("a"));
    }
}
