//! The rule about contacts: what is neither picked nor put down is not touched at speed.
//!
//! In: what the simulated arm touches in every frame and how fast the tool is, the pick-n-place as it was
//! written down. Out: breaches. Cups on the object that is to be picked and a load on the table at its place
//! have a limit of their own: the end of a straight way down. What a hand has moved is nowhere that a path
//! could know.

use crate::pair::rules::found::Found;
use crate::pair::rules::rule::Rule;
use crate::pair::rules::truth::Truth;
use rearrange::geometry::pose::Pose2;
use ur_sim::world::World;
use ur_sim::world::event::Contact;
use ur_wire::enumerations::RobotMode;

/// Less than this is the elasticity of a cup or the error of a height, m.
const TOUCH_M: f64 = 0.3e-3;

/// The fastest tool that may touch anything, m/s.
const TOUCH_M_S: f64 = 0.01;

/// The fastest tool that may touch what it picks, or the table with what it puts down, m/s.
const DOWN_M_S: f64 = 0.12;

/// The simulated world's name for the gripper's body.
const HOUSING: &str = "gripper";

/// What is put down is at most this far from its place, m.
const PLACE_M: f64 = 0.01;

/// What is touched, and what may be. See the module.
#[derive(Debug, Default)]
pub(super) struct Contacts {
    /// What is touched, by what.
    touched: Option<(String, String)>,
    /// The object of the pick-n-place under way, and its place.
    meant: Option<(String, Pose2)>,
}

impl Contacts {
    /// A pick-n-place is written down.
    pub fn intends(&mut self, object: &str, to: Pose2) {
        self.meant = Some((object.to_string(), to));
    }

    /// One controller frame; `astray`: nobody but a hand knows where the object is; `recovers`: what is held
    /// is put down where there is room.
    pub fn frame(
        &mut self,
        truth: &Truth,
        world: &World,
        astray: impl Fn(&str) -> bool,
        recovers: bool,
        found: &mut Found,
    ) {
        let touch = world.touch().filter(|touch| touch.depth_m > TOUCH_M);
        let now = touch.map(|touch| (touch.moving.clone(), touch.against.clone()));
        let before = std::mem::replace(&mut self.touched, now);
        // Another arm in its place, or another calibration, is no motion.
        let driven = truth.ours && truth.moves && truth.mode == RobotMode::Running;
        let Some(touch) = touch.filter(|_| self.touched != before && driven) else { return };
        // The housing meets things sideways too. Cups that have let go of an object still touch it as they
        // go up.
        let speed = if touch.moving == HOUSING { truth.tool_speed } else { -world.glance().velocity[2] };
        let most = if self.is_meant(touch, world, recovers) { DOWN_M_S } else { TOUCH_M_S };
        let known = !astray(&touch.against) && !astray(&touch.moving);
        if known && speed > most {
            let detail = format!("{} on {} at {speed:.3} m/s", touch.moving, touch.against);
            found.push(Rule::ContactTooFast, detail);
        }
    }

    /// The cups on what is to be picked, or a load on the table where it is put down.
    fn is_meant(&self, touch: &Contact, world: &World, recovers: bool) -> bool {
        let Some((object, to)) = &self.meant else { return false };
        if touch.moving == "cup" {
            return touch.against == *object;
        }
        let Some(load) = world.object(&touch.moving).filter(|load| load.is_held()) else { return false };
        let (at, wanted) = (load.pose(), to);
        let there = load.id == *object && (at.x - wanted.x).hypot(at.y - wanted.y) < PLACE_M;
        touch.against == "table" && (there || recovers)
    }
}
