//! Seal, hold, carry and contact: what connects the tool to the objects.
//!
//! In: the tool's true pose and motion, the pumps. Out: which object hangs on which channel, how high it can
//! go down, and what the arm presses on. The conditions are listed in the module above.

use crate::world::event::{Contact, EventKind};
use crate::world::section::Section;
use crate::world::vacuum::{Channel, VacuumMode};
use crate::world::{Body, BodyState, Tool, World};
use cell_values::units::{ATMOSPHERE_PA, GRAVITY};
use nalgebra::{Isometry3, Point3, Vector3};
use rearrange::geometry::pose::Pose2;

/// How far the lips give, m.
const COMPLIANCE_M: f64 = 2e-3;
/// Largest angle between the tool axis and the top's normal, rad.
const SEAL_ANGLE_RAD: f64 = 3.0 * std::f64::consts::PI / 180.0;
/// Vacuum at which a sealed cup takes hold.
const HOLD_VACUUM: f64 = 0.2;
/// Vacuum below which an object that rests on something is let go.
const LET_GO_VACUUM: f64 = 0.05;
/// An object this close above what it rests on is carried by it, m.
const STANDING_M: f64 = 1e-3;
/// Overlap from which a neighbour is in the way, m; less gives way.
pub(super) const YIELD_M: f64 = 1e-3;
/// Height from which an object has left those beside and above it, m.
const CLEAR_OF_TABLE_M: f64 = 5e-3;

impl World {
    /// How far what is held is over what would hold it up, m; `None` when nothing is held. Truth: for tests
    /// only.
    pub fn held_over_place(&self) -> Option<f64> {
        let over = self.bodies.iter().filter_map(|body| match body.state {
            BodyState::Held { floor_m, .. } => Some(body.bottom_m() - floor_m),
            _ => None,
        });
        over.fold(None, |most, over| Some(most.map_or(over, |most: f64| most.max(over))))
    }

    /// Seals, pumps, and takes hold of what a channel has sucked on.
    pub(super) fn run_pumps(&mut self, dt_s: f64) {
        for channel in Channel::ALL {
            let c = channel.index();
            let on = match self.channels[c].holds {
                _ if self.channels[c].faults.open => None,
                Some(body) => Some(body),
                None if self.channels[c].pump.at_rest() => None,
                None => self.sealed_on(channel),
            };
            let state = &mut self.channels[c];
            state.sealed = on.is_some();
            state.leak_age_s += dt_s;
            state.pump.set_ceiling(state.faults.leak.map(|leak| leak.ceiling(state.leak_age_s)));
            state.pump.step(dt_s, on.is_some());
            if let Some(body) = on
                && state.holds.is_none()
                && state.pump.mode() == VacuumMode::Grip
                && state.pump.vacuum() >= HOLD_VACUUM
                && !self.bodies[body].fixed
            {
                self.take_hold(channel, body);
            }
        }
    }

    /// The one object that all cups of `channel` seal on.
    fn sealed_on(&self, channel: Channel) -> Option<usize> {
        let tool = self.tool.as_ref()?;
        let axis = -(tool.table_from_tool.rotation * Vector3::z());
        let mut found = None;
        for cup in self.gripper.cups.iter().filter(|cup| cup.channel == channel) {
            let lip = tool.table_from_tool * Point3::new(cup.x_m, cup.y_m, 0.0);
            let body = self.body_under(&lip, cup.diameter_m / 2.0, &axis)?;
            if found.is_some_and(|first| first != body) {
                return None;
            }
            found = Some(body);
        }
        found
    }

    /// The object whose top a cup at `lip` with that radius seals on.
    fn body_under(&self, lip: &Point3<f64>, radius_m: f64, axis: &Vector3<f64>) -> Option<usize> {
        let mut sealed = None;
        for (index, body) in self.bodies.iter().enumerate() {
            let Some((over, local)) = over(body, lip) else { continue };
            if over < -COMPLIANCE_M {
                return None; // something is higher than the lip: the cup cannot be on what lies below it
            }
            let normal = body.table_from_object.rotation * Vector3::z();
            let top = body.grippable.as_deref().unwrap_or(&body.section);
            if over <= COMPLIANCE_M
                && normal.angle(axis) <= SEAL_ANGLE_RAD
                && body.section.contains(local, radius_m)
                && top.contains(local, radius_m)
            {
                sealed = Some(index);
            }
        }
        sealed
    }

    fn take_hold(&mut self, channel: Channel, index: usize) {
        self.channels[channel.index()].holds = Some(index);
        let Some(tool) = self.tool else { return };
        if self.bodies[index].is_held() {
            return; // the second channel on the same object
        }
        let slip = self.random_offset(self.errors.std_xy_m, self.errors.std_theta_rad);
        self.hold(index, &tool, slip);
    }

    /// From now on the object moves with the tool; on the way into its grip it slips so far.
    pub(super) fn hold(&mut self, index: usize, tool: &Tool, slip: Pose2) {
        let mut beside = self.overlapping(index, 0.0);
        // Those it comes to touch by slipping are brushed, not pushed.
        let slipped = self.bodies[index].pose().compose(&slip);
        beside.extend(self.overlapping_at(index, &slipped, 0.0));
        let beside = beside.into_iter().map(|(other, _)| other).collect();
        let body = &mut self.bodies[index];
        let seen = tool.table_from_tool.inverse() * body.table_from_object;
        // What it stands on is its floor; where it leans, the table is.
        let floor_m = if body.is_stacked() { body.bottom_m() } else { 0.0 };
        // The grip shifts the object: in its own plane, about its own origin.
        body.state = BodyState::Held { tool_from_object: seen * slip.at_height(0.0), floor_m, beside };
        let object = body.id.clone();
        self.record(EventKind::Gripped { object });
    }

    /// Moves what is held with the tool, not deeper than its floor.
    pub(super) fn carry(&mut self) {
        let Some(tool) = self.tool else { return };
        for index in 0..self.bodies.len() {
            let body = &mut self.bodies[index];
            let BodyState::Held { tool_from_object, floor_m, .. } = &body.state else { continue };
            let floor_m = *floor_m;
            body.table_from_object = tool.table_from_tool * tool_from_object;
            let bottom_m = body.bottom_m();
            body.table_from_object.translation.z += (floor_m - bottom_m).max(0.0);
            if bottom_m > floor_m + CLEAR_OF_TABLE_M {
                self.drop_what_lay_on(index);
                self.settle_stacks();
            }
        }
    }

    /// Lets go of what the vacuum no longer carries.
    pub(super) fn let_go(&mut self) {
        let Some(tool) = self.tool.filter(|_| !self.sticky) else { return };
        for index in 0..self.bodies.len() {
            let body = &self.bodies[index];
            let BodyState::Held { floor_m, .. } = body.state else { continue };
            let standing = body.bottom_m() - floor_m <= STANDING_M;
            let needed_n = body.mass_kg * (tool.acceleration + Vector3::z() * GRAVITY).norm();
            let squeezed_n = self.fingers.as_ref().map_or(0.0, |fingers| fingers.carries_n(index));
            let carried_n = self.holding_force_n(index) + squeezed_n;
            let sucked = Channel::ALL.into_iter().any(|channel| {
                let state = &self.channels[channel.index()];
                state.holds == Some(index) && state.pump.vacuum() >= LET_GO_VACUUM
            });
            if if standing { !sucked && squeezed_n == 0.0 } else { carried_n < needed_n } {
                for state in self.channels.iter_mut().filter(|state| state.holds == Some(index)) {
                    state.holds = None;
                }
                if let Some(fingers) = &mut self.fingers {
                    fingers.lost(index);
                }
                self.land(index, &tool.velocity);
            }
        }
    }

    fn holding_force_n(&self, index: usize) -> f64 {
        let area = |channel: Channel| -> f64 {
            self.gripper.cups.iter().filter(|cup| cup.channel == channel).map(|cup| cup.area_m2()).sum()
        };
        Channel::ALL
            .into_iter()
            .filter(|channel| self.channels[channel.index()].holds == Some(index))
            .map(|channel| self.channels[channel.index()].pump.vacuum() * ATMOSPHERE_PA * area(channel))
            .sum()
    }

    /// Finds what the tool or a held object presses on and how far a held object can go down.
    pub(super) fn feel_contacts(&mut self) {
        let Some(tool) = self.tool else { return };
        let mut deepest: Option<Contact> = None;
        let mut holding = false;
        for index in 0..self.bodies.len() {
            if self.bodies[index].is_held() {
                holding = true;
                keep_deeper(&mut deepest, self.held_contact(index, &tool));
            }
        }
        if !holding {
            keep_deeper(&mut deepest, self.cup_contact(&tool));
        }
        keep_deeper(&mut deepest, self.finger_contact(&tool, holding));
        keep_deeper(&mut deepest, self.housing_contact(&tool));
        self.touch = deepest.filter(|contact| contact.depth_m > 0.0);
        let deepest = self.touch.clone().filter(|contact| contact.depth_m > COMPLIANCE_M);
        let same = |a: &Contact, b: &Contact| a.moving == b.moving && a.against == b.against;
        if let Some(contact) = &deepest
            && !self.contact.as_ref().is_some_and(|before| same(before, contact))
        {
            self.record(EventKind::Contact(contact.clone()));
        }
        self.contact = deepest;
    }

    /// The arm's deepest contact at this moment, also where the cups only give way.
    pub fn touch(&self) -> Option<&Contact> {
        self.touch.as_ref()
    }

    /// Updates the floor of a held object and says how far the tool presses it below that.
    fn held_contact(&mut self, index: usize, tool: &Tool) -> Option<Contact> {
        let BodyState::Held { tool_from_object, beside, .. } = &self.bodies[index].state else { return None };
        let (mut moved, mut beside) = (self.bodies[index].clone(), beside.clone());
        moved.table_from_object = tool.table_from_tool * tool_from_object;
        let bottom_m = moved.bottom_m();
        beside.retain(|other| bottom_m < self.bodies[*other].top_m());
        let (mut floor_m, mut against) = (0.0, "table");
        for (other, body) in self.bodies.iter().enumerate() {
            let top_m = body.top_m();
            if other == index || !body.is_resting() || beside.contains(&other) || top_m <= floor_m {
                continue;
            }
            // A metre above it nothing can be in the way; the floor only counts close to it.
            if bottom_m > top_m + CLEAR_OF_TABLE_M {
                continue;
            }
            let overlap = Section::overlap(&moved.section, &moved.pose(), &body.section, &body.pose());
            if overlap.is_some_and(|overlap| overlap.depth_m > YIELD_M) {
                (floor_m, against) = (top_m, body.id.as_str());
            }
        }
        let contact = Contact { moving: moved.id, against: against.to_string(), depth_m: floor_m - bottom_m };
        if let BodyState::Held { floor_m: floor, beside: left, .. } = &mut self.bodies[index].state {
            *floor = floor_m;
            *left = beside;
        }
        Some(contact)
    }

    /// How far an empty cup presses into an object or the table.
    fn cup_contact(&self, tool: &Tool) -> Option<Contact> {
        let mut deepest = None;
        for cup in &self.gripper.cups {
            let lip = tool.table_from_tool * Point3::new(cup.x_m, cup.y_m, 0.0);
            let mut press = |against: &str, depth_m: f64| {
                let contact = Contact { moving: "cup".to_string(), against: against.to_string(), depth_m };
                keep_deeper(&mut deepest, Some(contact));
            };
            if self.on_board(lip.x, lip.y) && lip.z < 0.0 {
                press("table", -lip.z);
            }
            for body in &self.bodies {
                if let Some((over, _)) = over(body, &lip)
                    && over < 0.0
                {
                    press(&body.id, -over);
                }
            }
        }
        deepest
    }

    /// How far the gripper's housing sits in an object.
    fn housing_contact(&self, tool: &Tool) -> Option<Contact> {
        let table_from_body =
            tool.table_from_tool * Isometry3::translation(0.0, 0.0, -self.gripper.body_above_lips_m);
        let under_m = table_from_body.translation.z;
        let reach = self.bodies.iter().filter(|body| body.is_resting() && body.top_m() > under_m);
        let x_axis = table_from_body.rotation * Vector3::x();
        let mut deepest = None;
        for body in reach {
            // Seen from above the tool frame is mirrored: its outline is turned over before it is laid on
            // the table.
            let pose = rearrange::geometry::pose::Pose2::new(
                table_from_body.translation.x,
                table_from_body.translation.y,
                x_axis.y.atan2(x_axis.x),
            );
            if Section::overlap(&self.housing_from_above, &pose, &body.section, &body.pose()).is_some() {
                let contact = Contact {
                    moving: "gripper".to_string(),
                    against: body.id.clone(),
                    depth_m: body.top_m() - under_m,
                };
                keep_deeper(&mut deepest, Some(contact));
            }
        }
        deepest
    }
}

/// Height of `lip` over the top of `body` along its normal, and its place on that top, when it is above or
/// in it.
pub(super) fn over(body: &Body, lip: &Point3<f64>) -> Option<(f64, [f64; 2])> {
    if !body.is_resting() && !body.is_held() {
        return None;
    }
    let centre = body.table_from_object.translation.vector;
    if (lip.x - centre.x).hypot(lip.y - centre.y) > body.section.bounding_radius_m() + body.height_m {
        return None;
    }
    let local = body.table_from_object.inverse_transform_point(lip);
    body.section.contains([local.x, local.y], 0.0).then_some((local.z - body.height_m, [local.x, local.y]))
}

pub(super) fn keep_deeper(deepest: &mut Option<Contact>, other: Option<Contact>) {
    if let Some(other) = other
        && deepest.as_ref().is_none_or(|best| other.depth_m > best.depth_m)
    {
        *deepest = Some(other);
    }
}
