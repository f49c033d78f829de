//! The rule about contacts: the arm touches nothing at speed but the object that it picks and the table
//! under the object that it puts down.
//!
//! In: the deepest contact of the simulated arm in every frame, the tool's speed, the pick-n-place that was
//! written down. Out: breaches. The cups on the object to pick and a load on the table at its place have a
//! higher limit: the end of a straight way down. Objects that a hand has moved are not judged: no path could
//! know where they are. Beside a deeper contact another one is not seen.

use crate::pair::rules::found::Found;
use crate::pair::rules::rule::Rule;
use crate::pair::rules::truth::Truth;
use rearrange::geometry::pose::Pose2;
use ur_sim::world::World;
use ur_sim::world::event::Contact;
use ur_wire::enumerations::RobotMode;

/// A contact that is less deep is the elasticity of a cup or the error of a height, m. Chosen.
const TOUCH_M: f64 = 0.3e-3;

/// The fastest tool that may touch anything, m/s.
const TOUCH_M_S: f64 = 0.01;

/// The fastest tool that may touch the object it picks, or the table with the object it puts down, m/s.
/// Chosen: between the press at the end of a way down and a way down that is not braked.
const DOWN_M_S: f64 = 0.12;

/// The simulated world's names for a cup and for the gripper's body.
const CUP: &str = "cup";
const HOUSING: &str = "gripper";

/// An object is put down at most this far from its place, m.
const PLACE_M: f64 = 0.01;

/// The last contact and the present pick-n-place. See the module.
#[derive(Debug, Default)]
pub(super) struct Contacts {
    /// Part of the arm, and the object or table that it touches.
    touched: Option<(String, String)>,
    /// The object of the pick-n-place under way, and its place.
    meant: Option<(String, Pose2)>,
    /// The pick-n-place is over once the arm rests.
    ends: bool,
    /// Height of the tool over the table, m.
    height_m: f64,
}

impl Contacts {
    /// A pick-n-place is written down.
    pub fn intends(&mut self, object: &str, to: Pose2) {
        (self.meant, self.ends) = (Some((object.to_string(), to)), false);
    }

    /// The job has ended, or celld is gone; the arm may still brake.
    pub fn ends(&mut self) {
        self.ends = true;
    }

    /// One controller frame. `astray`: a hand has moved the object, and celld has not seen it since.
    /// `recovers`: the arm puts the held object down where there is room.
    pub fn frame(
        &mut self,
        truth: &Truth,
        world: &World,
        astray: impl Fn(&str) -> bool,
        recovers: bool,
        found: &mut Found,
    ) {
        if self.ends && !truth.moves {
            (self.meant, self.ends) = (None, false);
        }
        let height_m = world.glance().tool[2];
        let rises = height_m > std::mem::replace(&mut self.height_m, height_m);
        let touch = world.touch().filter(|touch| touch.depth_m > TOUCH_M);
        let now = touch.map(|touch| (touch.moving.clone(), touch.against.clone()));
        let before = std::mem::replace(&mut self.touched, now);
        // Another arm in its place, or another calibration, is no motion.
        let driven = truth.ours && truth.moves && truth.mode == RobotMode::Running;
        let Some(touch) = touch.filter(|_| self.touched != before && driven) else { return };
        // Cups that have let go of an object still touch it on their way up.
        let speed = if rises && touch.moving != HOUSING { 0.0 } else { truth.tool_speed };
        let most = if self.is_meant(touch, world, recovers) { DOWN_M_S } else { TOUCH_M_S };
        let known = !astray(&touch.against) && !astray(&touch.moving);
        if known && speed > most {
            let detail = format!("{} on {} at {speed:.3} m/s", touch.moving, touch.against);
            found.push(Rule::ContactTooFast, detail);
        }
    }

    /// True for the cups on the object to pick, and for a load on the table at its place.
    fn is_meant(&self, touch: &Contact, world: &World, recovers: bool) -> bool {
        let meant = self.meant.as_ref();
        if touch.moving == CUP {
            return meant.is_some_and(|(object, _)| touch.against == *object);
        }
        let Some(load) = world.object(&touch.moving).filter(|load| load.is_held()) else { return false };
        let (id, at) = (&load.id, load.pose());
        let there =
            meant.is_some_and(|(object, to)| object == id && (at.x - to.x).hypot(at.y - to.y) < PLACE_M);
        touch.against == "table" && (there || recovers)
    }
}
