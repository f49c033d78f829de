//! What happens to an object that leaves the gripper: it is placed, or falls, pushes its neighbours apart or
//! stays tilted on them, or leaves the table.
//!
//! In: the object's pose when it was let go and the tool's speed. Out: new poses and events. Nothing here
//! knows of goals: every pose is where the object was let go, plus errors, plus what its neighbours force on
//! it.

use crate::world::event::EventKind;
use crate::world::grip::YIELD_M;
use crate::world::section::{Overlap, Section};
use crate::world::{BodyState, World};
use cell_values::units::GRAVITY;
use nalgebra::{Isometry3, Translation3, Unit, UnitQuaternion, Vector3};
use rand::RngExt;
use rearrange::geometry::pose::Pose2;

/// An object let go lower than this is set down, higher it falls, m.
const SET_DOWN_M: f64 = 3e-3;
/// Overlap that counts as touching, m.
pub(super) const TOUCH_M: f64 = 1e-6;
/// Objects above each other by less than this are beside each other, m.
const LEVEL_M: f64 = 1e-4;
/// Rounds of pushing; a tight cluster keeps what is left then.
const PUSH_ROUNDS: usize = 40;
/// Range of the tilt of an object that lies on others, rad.
const TILT_RAD: [f64; 2] = [5.0 * std::f64::consts::PI / 180.0, 12.0 * std::f64::consts::PI / 180.0];

impl World {
    /// A normal random shift and turn.
    pub(super) fn random_offset(&mut self, std_xy_m: f64, std_theta_rad: f64) -> Pose2 {
        Pose2::new(self.normal() * std_xy_m, self.normal() * std_xy_m, self.normal() * std_theta_rad)
    }

    /// A standard normal number (Box-Muller).
    fn normal(&mut self) -> f64 {
        let (u, v): (f64, f64) = (self.rng.random(), self.rng.random());
        (-2.0 * (1.0 - u).ln()).sqrt() * (std::f64::consts::TAU * v).cos()
    }

    /// Lets the object go where it is; `velocity` is the tool's, m/s in the table frame.
    pub(super) fn land(&mut self, index: usize, velocity: &Vector3<f64>) {
        let BodyState::Held { floor_m, .. } = self.bodies[index].state else { return };
        let pose = self.bodies[index].pose();
        let height_m = self.bodies[index].bottom_m() - floor_m;
        let PlacementOffset { shift, fell } = self.landing_offset(height_m, velocity);
        if fell {
            let object = self.bodies[index].id.clone();
            self.record(EventKind::Dropped { object, height_m });
        }
        self.put_down(index, Pose2::new(pose.x + shift.x, pose.y + shift.y, pose.theta + shift.theta));
        if !fell && self.bodies[index].is_resting() {
            let body = &self.bodies[index];
            let event = EventKind::Placed { object: body.id.clone(), pose: body.pose() };
            self.record(event);
        }
    }

    fn landing_offset(&mut self, height_m: f64, velocity: &Vector3<f64>) -> PlacementOffset {
        let errors = self.errors;
        if height_m <= SET_DOWN_M {
            return PlacementOffset {
                shift: self.random_offset(errors.std_xy_m, errors.std_theta_rad),
                fell: false,
            };
        }
        let seconds = (2.0 * height_m / GRAVITY).sqrt();
        let mut shift =
            self.random_offset(errors.std_xy_m + errors.drop_xy_per_m * height_m, errors.drop_theta_rad);
        shift.x += velocity.x * seconds;
        shift.y += velocity.y * seconds;
        PlacementOffset { shift, fell: true }
    }

    /// Objects lie on those that were named before them and lie under them: a stack is written from below.
    /// What would not stand leans.
    pub(super) fn stack_in_order(&mut self) {
        for index in 0..self.bodies.len() {
            let pose = self.bodies[index].pose();
            let mut below = self.outlines_meeting(index, &pose, YIELD_M);
            below.retain(|(other, _)| *other < index);
            let under: Vec<usize> = below.iter().map(|(other, _)| *other).collect();
            if !under.is_empty() && !self.bodies[index].fixed && !self.stand_on(index, &pose, &under) {
                self.tilt(index, &below);
            }
        }
    }

    /// Puts the object flat at `pose` and settles it with its neighbours.
    pub(super) fn put_down(&mut self, index: usize, pose: Pose2) {
        self.come_down(index, pose);
        self.settle_stacks();
    }

    /// The same, and what stood on it is left where it is.
    pub(super) fn come_down(&mut self, index: usize, pose: Pose2) {
        let body = &mut self.bodies[index];
        body.table_from_object = pose.at_height(0.0);
        body.state = BodyState::Resting { on: Vec::new() };
        self.fall_off(index);
        if self.bodies[index].is_resting() {
            let blocked = self.under(index, &pose);
            let under: Vec<usize> = blocked.iter().map(|(other, _)| *other).collect();
            if blocked.is_empty() {
                self.push_apart(index);
            } else if !self.stand_on(index, &pose, &under) {
                self.tilt(index, &blocked);
            }
        }
    }

    /// Resting objects on which one would come down at `pose`, whatever their height, with how they overlap;
    /// those that stand on it do not count.
    fn under(&self, index: usize, pose: &Pose2) -> Vec<(usize, Overlap)> {
        let mut found = self.outlines_meeting(index, pose, YIELD_M);
        found.retain(|(other, _)| !self.bodies[*other].supports().contains(&index));
        found
    }

    /// True when the point is over the board.
    pub(super) fn on_board(&self, x: f64, y: f64) -> bool {
        let margin = self.table.margin_m;
        (-margin..=self.table.width_m + margin).contains(&x)
            && (-margin..=self.table.height_m + margin).contains(&y)
    }

    pub(super) fn fall_off(&mut self, index: usize) {
        let pose = self.bodies[index].pose();
        if !self.on_board(pose.x, pose.y) {
            self.bodies[index].state = BodyState::Fallen;
            let object = self.bodies[index].id.clone();
            self.record(EventKind::Fallen { object });
        }
    }

    /// Resting objects that penetrate this one by more than `more_than_m`, with how they do.
    pub(super) fn overlapping(&self, index: usize, more_than_m: f64) -> Vec<(usize, Overlap)> {
        self.overlapping_at(index, &self.bodies[index].pose(), more_than_m)
    }

    /// The same with this one at `pose`.
    pub(super) fn overlapping_at(
        &self,
        index: usize,
        pose: &Pose2,
        more_than_m: f64,
    ) -> Vec<(usize, Overlap)> {
        let (bottom_m, top_m) = (self.bodies[index].bottom_m(), self.bodies[index].top_m());
        let mut found = self.outlines_meeting(index, pose, more_than_m);
        found.retain(|(other, _)| {
            let other = &self.bodies[*other];
            other.bottom_m() < top_m - LEVEL_M && bottom_m < other.top_m() - LEVEL_M
        });
        found
    }

    /// Resting objects whose outlines penetrate this one's at `pose`, whatever their height.
    fn outlines_meeting(&self, index: usize, pose: &Pose2, more_than_m: f64) -> Vec<(usize, Overlap)> {
        let body = &self.bodies[index];
        let others = self.bodies.iter().enumerate().filter(|(other, b)| *other != index && b.is_resting());
        others
            .filter_map(|(other, b)| {
                Some((other, Section::overlap(&b.section, &b.pose(), &body.section, pose)?))
            })
            .filter(|(_, overlap)| overlap.depth_m > more_than_m)
            .collect()
    }

    /// Shares small penetrations between the placed object and its neighbours, and theirs.
    fn push_apart(&mut self, placed: usize) {
        let mut moved = vec![placed];
        for _ in 0..PUSH_ROUNDS {
            let mut pushed = false;
            for k in 0..moved.len() {
                let index = moved[k];
                for (other, _) in self.overlapping(index, TOUCH_M) {
                    pushed |= self.push_pair(index, other);
                    if !moved.contains(&other) && !self.bodies[other].fixed {
                        moved.push(other);
                    }
                }
            }
            if !pushed {
                break;
            }
        }
        for index in moved {
            self.fall_off(index);
        }
    }

    /// Separates two objects: both move by half, or the free one by all.
    fn push_pair(&mut self, index: usize, other: usize) -> bool {
        let (a, b) = (&self.bodies[other], &self.bodies[index]);
        let Some(overlap) = Section::overlap(&a.section, &a.pose(), &b.section, &b.pose()) else {
            return false;
        };
        let share = match (a.fixed, b.fixed) {
            (true, true) => return false,
            (true, false) => [0.0, 1.0],
            (false, true) => [1.0, 0.0],
            (false, false) => [0.5, 0.5],
        };
        let distance_m = overlap.depth_m + TOUCH_M;
        for (moves, by, part) in [(other, index, -share[0]), (index, other, share[1])] {
            let shift = Vector3::new(overlap.away[0], overlap.away[1], 0.0) * (part * distance_m);
            self.bodies[moves].table_from_object.translation.vector += shift;
            if part != 0.0 && distance_m > 1e-5 {
                let (object, by) = (self.bodies[moves].id.clone(), self.bodies[by].id.clone());
                self.record(EventKind::Pushed { object, by, distance_m: (part * distance_m).abs() });
            }
        }
        true
    }

    /// Leaves the object tilted on those it penetrates: the side towards the deepest one is raised.
    fn tilt(&mut self, index: usize, blocked: &[(usize, Overlap)]) {
        let Some((under, overlap)) =
            blocked.iter().max_by(|a, b| a.1.depth_m.total_cmp(&b.1.depth_m)).copied()
        else {
            return;
        };
        let pose = self.bodies[index].pose();
        let away = Vector3::new(overlap.away[0], overlap.away[1], 0.0);
        let step_m = self.bodies[under].top_m();
        let section = self.bodies[index].section.clone();
        let local = pose.theta.sin_cos();
        let towards = [-(local.1 * away.x + local.0 * away.y), -(local.1 * away.y - local.0 * away.x)];
        let width_m = section.support(towards) + section.support([-towards[0], -towards[1]]);
        let tilt_rad = step_m.atan2(width_m).clamp(TILT_RAD[0], TILT_RAD[1]);
        let axis = Unit::new_normalize(Vector3::z().cross(&away));
        let flat = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), pose.theta);
        let rotation = UnitQuaternion::from_axis_angle(&axis, tilt_rad) * flat;
        // Its lower edge rests on the table, or on the lower object if its middle lies over that.
        let seat = &self.bodies[under];
        let on_top = seat.section.contains(seat.pose().inverse_transform([pose.x, pose.y]), 0.0);
        let body = &mut self.bodies[index];
        body.table_from_object = Isometry3::from_parts(Translation3::new(pose.x, pose.y, 0.0), rotation);
        let lowest_m = body.bottom_m();
        body.table_from_object.translation.z = if on_top { step_m } else { 0.0 } - lowest_m;
        body.state = BodyState::Resting { on: blocked.iter().map(|(other, _)| *other).collect() };
        let object = body.id.clone();
        let on = blocked.iter().map(|(other, _)| self.bodies[*other].id.clone()).collect();
        self.record(EventKind::Tilted { object, on, tilt_rad });
    }

    /// Lets fall what lay tilted on an object that has been lifted.
    pub(super) fn drop_what_lay_on(&mut self, lifted: usize) {
        for index in 0..self.bodies.len() {
            let lies_on =
                matches!(&self.bodies[index].state, BodyState::Resting { on } if on.contains(&lifted));
            if lies_on {
                let pose = self.bodies[index].pose();
                let slip = self.random_offset(5.0 * self.errors.std_xy_m, 5.0 * self.errors.std_theta_rad);
                self.put_down(index, Pose2::new(pose.x + slip.x, pose.y + slip.y, pose.theta + slip.theta));
            }
        }
    }
}

struct PlacementOffset {
    shift: Pose2,
    fell: bool,
}
