//! The registers of a Robotiq 2F gripper and what they make the fingers do.
//!
//! In: registers by name, as its URCap's socket has them. Out: where the fingers are to go ([`Wanted`]), and
//! registers again. Source: the instruction manual's register map and published clients; how long an
//! activation takes, and at which counts the fingers are open and closed, is assumed. Pure.

use crate::world::drive::FingersSpec;

/// Position register with the fingers open and closed without an object: the mechanics end before 0 and
/// 255.
const OPEN: f64 = 3.0;
const CLOSED: f64 = 227.0;

/// Time an activation takes, s.
const ACTIVATION_S: f64 = 1.0;

/// Speed of an automatic release, m/s.
const RELEASE_SPEED: f64 = 0.02;

/// Fault register: activation under way or missing while motion is wanted; automatic release under way and
/// done.
const FLT_ACTIVATING: u8 = 0x05;
const FLT_NOT_ACTIVE: u8 = 0x07;
const FLT_RELEASING: u8 = 0x0b;
const FLT_RELEASED: u8 = 0x0f;

/// Object register.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Object {
    /// The fingers move.
    Moving = 0,
    /// They have met something while they opened.
    MetOpening = 1,
    /// They have met something while they closed.
    MetClosing = 2,
    /// They are where they were to go.
    Arrived = 3,
}

/// Where the fingers are to go.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wanted {
    /// Opening, m.
    pub gap_m: f64,
    /// Of the opening, m/s.
    pub speed: f64,
    /// N.
    pub force: f64,
}

/// The gripper's own controller.
#[derive(Clone, Debug)]
pub struct TwoFinger {
    spec: FingersSpec,
    active: bool,
    activation_left_s: f64,
    go: bool,
    position: u8,
    speed: u8,
    force: u8,
    release: bool,
    release_opens: bool,
    object: Object,
    fault: u8,
}

impl TwoFinger {
    /// Just switched on.
    pub fn new(spec: FingersSpec) -> TwoFinger {
        TwoFinger {
            spec,
            active: false,
            activation_left_s: 0.0,
            go: false,
            position: 0,
            speed: 255,
            force: 150,
            release: false,
            release_opens: false,
            object: Object::Arrived,
            fault: 0,
        }
    }

    /// Sets a register; false if there is none of that name to set.
    pub fn set(&mut self, name: &str, value: u8) -> bool {
        match name {
            "ACT" => self.activate(value != 0),
            "GTO" => self.go = value != 0,
            "POS" => self.position = value,
            "SPE" => self.speed = value,
            "FOR" => self.force = value,
            "ATR" => self.release = value != 0,
            "ADR" | "ARD" => self.release_opens = value != 0,
            _ => return false,
        }
        if matches!(name, "GTO" | "POS") && self.go {
            self.fault = match self.status() {
                _ if self.release || self.fault >= FLT_RELEASING => self.fault,
                0 => FLT_NOT_ACTIVE,
                1 => FLT_ACTIVATING,
                _ => 0,
            };
            if self.status() == 3 {
                // A client that looks at once must not take the last motion's end for this one's.
                self.object = Object::Moving;
            }
        }
        true
    }

    fn activate(&mut self, active: bool) {
        if active && !self.active {
            self.activation_left_s = ACTIVATION_S;
            self.object = Object::Moving;
        }
        if !active {
            (self.go, self.release, self.fault) = (false, false, 0);
        }
        self.active = active;
    }

    /// A register while the fingers are so far open; `None` if there is none of that name.
    pub fn get(&self, name: &str, gap_m: f64) -> Option<u8> {
        Some(match name {
            "ACT" => u8::from(self.active),
            "GTO" => u8::from(self.go),
            "POS" => (CLOSED - gap_m / self.spec.stroke_m * (CLOSED - OPEN)).round().clamp(0.0, 255.0) as u8,
            "PRE" => self.position,
            "SPE" => self.speed,
            "FOR" => self.force,
            "ATR" => u8::from(self.release),
            "ADR" | "ARD" => u8::from(self.release_opens),
            "STA" => self.status(),
            "OBJ" => self.object as u8,
            "FLT" => self.fault,
            "COU" => 0,
            _ => return None,
        })
    }

    /// Reset, activating, active.
    fn status(&self) -> u8 {
        match (self.active, self.activation_left_s > 0.0) {
            (false, _) => 0,
            (true, true) => 1,
            (true, false) => 3,
        }
    }

    /// Time goes on; where the fingers are to go now, if anywhere.
    pub fn step(&mut self, dt_s: f64) -> Option<Wanted> {
        if !self.active {
            return None;
        }
        let force = FingersSpec::share(self.spec.force, self.force);
        if self.release {
            let gap_m = if self.release_opens { self.spec.stroke_m } else { 0.0 };
            if self.fault != FLT_RELEASED {
                self.fault = FLT_RELEASING;
            }
            return Some(Wanted { gap_m, speed: RELEASE_SPEED, force });
        }
        if self.activation_left_s > 0.0 {
            // It opens within its time; the real one closes first.
            self.activation_left_s = (self.activation_left_s - dt_s).max(0.0);
            let speed = 2.0 * self.spec.stroke_m / ACTIVATION_S;
            return Some(Wanted { gap_m: self.spec.stroke_m, speed, force });
        }
        let closed = (f64::from(self.position) - OPEN) / (CLOSED - OPEN);
        let gap_m = self.spec.stroke_m * (1.0 - closed.clamp(0.0, 1.0));
        let speed = FingersSpec::share(self.spec.speed, self.speed);
        (self.go && self.fault < FLT_RELEASING).then_some(Wanted { gap_m, speed, force })
    }

    /// How a step of the fingers has ended.
    pub fn ended(&mut self, object: Object) {
        self.object = object;
        if self.release && object != Object::Moving {
            self.fault = FLT_RELEASED;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gripper() -> TwoFinger {
        TwoFinger::new(FingersSpec::ROBOTIQ_2F85)
    }

    fn active() -> TwoFinger {
        let mut gripper = gripper();
        assert!(gripper.set("ACT", 1));
        while gripper.status() != 3 {
            assert!(gripper.step(0.002).is_some());
        }
        gripper.ended(Object::Arrived);
        gripper
    }

    #[test]
    fn an_activation_takes_its_time_and_motion_before_it_is_a_fault() {
        let mut gripper = gripper();
        let get = |gripper: &TwoFinger, name| gripper.get(name, 0.0);
        assert_eq!((get(&gripper, "STA"), get(&gripper, "ACT")), (Some(0), Some(0)));
        gripper.set("GTO", 1);
        assert_eq!((get(&gripper, "FLT"), gripper.step(0.002)), (Some(FLT_NOT_ACTIVE), None));
        gripper.set("ACT", 0);
        assert_eq!((get(&gripper, "FLT"), get(&gripper, "GTO")), (Some(0), Some(0)));
        gripper.set("ACT", 1);
        gripper.set("GTO", 1);
        assert_eq!((get(&gripper, "STA"), get(&gripper, "FLT")), (Some(1), Some(FLT_ACTIVATING)));
        (0..499).for_each(|_| assert_eq!(gripper.step(0.002).unwrap().gap_m, 0.085));
        assert_eq!(get(&gripper, "STA"), Some(1));
        (0..3).for_each(|_| assert!(gripper.step(0.002).is_some()));
        assert_eq!(get(&gripper, "STA"), Some(3));
    }

    #[test]
    fn registers_lead_to_openings_speeds_and_forces() {
        let mut gripper = active();
        assert_eq!(gripper.step(0.002), None, "without GTO");
        assert!(gripper.set("SPE", 255) && gripper.set("FOR", 0) && gripper.set("POS", 255));
        assert!(gripper.set("GTO", 1));
        assert_eq!(gripper.get("OBJ", 0.0), Some(0), "at once");
        assert_eq!(gripper.step(0.002), Some(Wanted { gap_m: 0.0, speed: 0.150, force: 20.0 }));
        gripper.set("POS", 0);
        assert_eq!(gripper.step(0.002).unwrap().gap_m, 0.085);
        assert_eq!((gripper.get("POS", 0.085), gripper.get("POS", 0.0)), (Some(3), Some(227)));
        assert_eq!(gripper.get("PRE", 0.0), Some(0));
        assert!(!gripper.set("STA", 3) && !gripper.set("POSE", 3));
        assert_eq!(gripper.get("FMT", 0.0), None);
    }

    #[test]
    fn an_automatic_release_ends_in_a_fault_until_it_is_activated_anew() {
        let mut gripper = active();
        gripper.set("ADR", 1);
        gripper.set("ATR", 1);
        assert_eq!(gripper.step(0.002).unwrap().gap_m, 0.085);
        assert_eq!(gripper.get("FLT", 0.0), Some(FLT_RELEASING));
        gripper.ended(Object::Arrived);
        assert_eq!(gripper.get("FLT", 0.0), Some(FLT_RELEASED));
        gripper.set("ATR", 0);
        gripper.set("GTO", 1);
        assert_eq!((gripper.step(0.002), gripper.get("FLT", 0.0)), (None, Some(FLT_RELEASED)));
        gripper.set("ACT", 0);
        assert_eq!(gripper.get("FLT", 0.0), Some(0));
    }
}
