//! When faults are due.
//!
//! In: plans, and in each frame what the world shows ([`Glance`]), how far the arm is in its move, and what
//! has happened. Out: the orders that are due, each once. Pure.
//!
//! The world has no plan, so steps and phases are inferred from what happens: a pick-n-place ends when the
//! arm has left the place where it let go, and the phases follow from pump, hold and the way the tool moves.
//! How long a carry will be cannot be known; `progress` therefore is the share of the move that the arm is
//! in (a carry mostly is one move). A phase that ends before its progress was reached fires the fault at its
//! end, so that none is lost.

use crate::faults::{DeviceEvent, Order, Phase, Planned, Trigger};
use crate::world::event::{Event, EventKind};

/// Sideways from the place of grip or release from which the arm has left it, m.
const ASIDE_M: f64 = 5e-3;
/// Height over the place of grip from which the object is lifted, m.
const LIFTED_M: f64 = 2e-3;
/// Slower than this the tool is at rest, m/s.
const STANDING_M_S: f64 = 2e-3;

/// What the world shows of a pick-n-place in one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Glance {
    /// The gripper holds something.
    pub holds: bool,
    /// Some channel is commanded to grip.
    pub gripping: bool,
    /// The tool in the table frame, m.
    pub tool: [f64; 3],
    /// Its speed, m/s.
    pub velocity: [f64; 3],
}

/// Which pick-n-place the cell is in, and which part of it.
#[derive(Clone, Debug)]
pub struct Steps {
    step: u32,
    phase: Phase,
    place: [f64; 3],
    before: Option<Glance>,
}

impl Default for Steps {
    fn default() -> Steps {
        Steps { step: 1, phase: Phase::Approach, place: [0.0; 3], before: None }
    }
}

impl Steps {
    /// Number of the pick-n-place, from 1, and its phase.
    pub fn now(&self) -> (u32, Phase) {
        (self.step, self.phase)
    }

    /// One frame.
    pub fn advance(&mut self, glance: &Glance) {
        let before = self.before.replace(*glance);
        let held = before.is_some_and(|before| before.holds);
        if glance.holds != held {
            self.place = glance.tool;
            self.phase = if glance.holds { Phase::Grip } else { Phase::Retreat };
        } else if glance.holds {
            self.phase = self.phase_of_held(glance);
        } else {
            let started = glance.gripping && before.is_some_and(|before| !before.gripping);
            self.phase_of_empty(glance, started);
        }
    }

    fn aside(&self, glance: &Glance) -> bool {
        (glance.tool[0] - self.place[0]).hypot(glance.tool[1] - self.place[1]) > ASIDE_M
    }

    fn phase_of_held(&self, glance: &Glance) -> Phase {
        let [x, y, z] = glance.velocity;
        let sideways = x.hypot(y);
        if !self.aside(glance) && self.phase <= Phase::Lift {
            let lifted = glance.tool[2] > self.place[2] + LIFTED_M;
            return if lifted { Phase::Lift } else { self.phase };
        }
        if sideways.hypot(z) < STANDING_M_S && self.phase >= Phase::Carry {
            return self.phase;
        }
        if -z > sideways { Phase::Place } else { Phase::Carry }
    }

    fn phase_of_empty(&mut self, glance: &Glance, started: bool) {
        let next = match self.phase {
            _ if started => Phase::Grip,
            Phase::Grip if !glance.gripping => Phase::Approach,
            Phase::Retreat if self.aside(glance) => Phase::Approach,
            other => other,
        };
        if self.phase == Phase::Retreat && next != Phase::Retreat {
            self.step = self.step.saturating_add(1);
        }
        self.phase = next;
    }
}

/// What counts for triggers in one frame.
#[derive(Clone, Copy, Debug)]
pub struct Situation {
    /// Simulated seconds since the start.
    pub time_s: f64,
    /// Pick-n-place and phase.
    pub step: (u32, Phase),
    /// Share of the arm's current move, 0 to 1; 0 when it is in none.
    pub progress: f64,
}

/// Plans that are not due yet.
#[derive(Debug, Default)]
pub struct Schedule {
    waiting: Vec<Waiting>,
}

#[derive(Debug)]
struct Waiting {
    trigger: Trigger,
    order: Order,
    seen: u32,
}

impl Schedule {
    /// Adds a plan; one without a trigger is due in the next frame.
    pub fn add(&mut self, plan: Planned) {
        let trigger = plan.at.unwrap_or(Trigger::Time(0.0));
        self.waiting.push(Waiting { trigger, order: plan.order, seen: 0 });
    }

    /// Plans that wait.
    pub fn waiting(&self) -> usize {
        self.waiting.len()
    }

    /// What is due in this frame, in the order of the plans.
    pub fn due<'a>(
        &mut self,
        now: &Situation,
        events: impl Iterator<Item = &'a Event> + Clone,
    ) -> Vec<Order> {
        let mut due = Vec::new();
        self.waiting.retain_mut(|waiting| {
            let is_due = waiting.is_due(now, events.clone());
            if is_due {
                due.push(waiting.order.clone());
            }
            !is_due
        });
        due
    }
}

impl Waiting {
    fn is_due<'a>(&mut self, now: &Situation, events: impl Iterator<Item = &'a Event>) -> bool {
        match &self.trigger {
            Trigger::Time(time_s) => now.time_s >= *time_s,
            Trigger::Step { step, phase, progress } => {
                let wanted = (*step, *phase);
                now.step > wanted || (now.step == wanted && now.progress >= *progress)
            }
            Trigger::Event { kind, object, count } => {
                let matching = events.filter(|event| {
                    device_event(&event.kind).is_some_and(|(happened, who)| {
                        happened == *kind && object.as_ref().is_none_or(|object| object == who)
                    })
                });
                self.seen = self.seen.saturating_add(u32::try_from(matching.count()).unwrap_or(u32::MAX));
                self.seen >= *count
            }
        }
    }
}

/// What an event is to fault files, and which object it is about.
fn device_event(kind: &EventKind) -> Option<(DeviceEvent, &str)> {
    Some(match kind {
        EventKind::Gripped { object } => (DeviceEvent::Grip, object),
        EventKind::Placed { object, .. } => (DeviceEvent::Place, object),
        EventKind::Dropped { object, .. } => (DeviceEvent::Drop, object),
        EventKind::Fallen { object } => (DeviceEvent::Fall, object),
        EventKind::Pushed { object, .. } => (DeviceEvent::Push, object),
        EventKind::Tilted { object, .. } => (DeviceEvent::Tilt, object),
        EventKind::Contact(contact) => (DeviceEvent::Contact, &contact.against),
        EventKind::Fault { .. } => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::faults::{Fault, RobotFault};

    /// A tool that goes from point to point at 0.1 m/s, with the phases it passes through.
    struct Walk {
        steps: Steps,
        glance: Glance,
        seen: Vec<(u32, Phase)>,
    }

    impl Walk {
        fn new() -> Walk {
            let glance = Glance { holds: false, gripping: false, tool: [0.1, 0.1, 0.2], velocity: [0.0; 3] };
            Walk { steps: Steps::default(), glance, seen: Vec::new() }
        }

        fn frame(&mut self) {
            self.steps.advance(&self.glance);
            if self.seen.last() != Some(&self.steps.now()) {
                self.seen.push(self.steps.now());
            }
        }

        fn go(&mut self, to: [f64; 3]) {
            let from = self.glance.tool;
            let length = (0..3).map(|i| (to[i] - from[i]).powi(2)).sum::<f64>().sqrt();
            let frames = (length / 0.1 / 0.002).ceil().max(1.0);
            self.glance.velocity = std::array::from_fn(|i| (to[i] - from[i]) / (frames * 0.002));
            for k in 1..=frames as usize {
                self.glance.tool = std::array::from_fn(|i| from[i] + (to[i] - from[i]) * k as f64 / frames);
                self.frame();
            }
            self.glance.velocity = [0.0; 3];
            self.frame();
        }

        fn set(&mut self, gripping: bool, holds: bool) {
            (self.glance.gripping, self.glance.holds) = (gripping, holds);
            self.frame();
        }

        fn pick_and_place(&mut self, x: f64, to: f64) {
            self.go([x, 0.1, 0.1]);
            self.go([x, 0.1, 0.02]);
            self.set(true, false);
            self.set(true, true);
            self.go([x, 0.1, 0.1]);
            self.go([to, 0.1, 0.1]);
            self.go([to, 0.1, 0.02]);
            self.set(false, true);
            self.set(false, false);
            self.go([to, 0.1, 0.1]);
        }
    }

    #[test]
    fn steps_and_phases_are_derived_from_what_happens() {
        use Phase::{Approach, Carry, Grip, Lift, Place, Retreat};
        let mut walk = Walk::new();
        walk.pick_and_place(0.2, 0.4);
        walk.pick_and_place(0.1, 0.3);
        let phases = [Approach, Grip, Lift, Carry, Place, Retreat];
        let wanted: Vec<(u32, Phase)> = [1, 2].iter().flat_map(|step| phases.map(|p| (*step, p))).collect();
        assert_eq!(walk.seen, wanted);
    }

    #[test]
    fn a_grip_that_fails_stays_in_its_step() {
        let mut walk = Walk::new();
        walk.go([0.2, 0.1, 0.02]);
        walk.set(true, false);
        walk.set(false, false);
        walk.set(true, false);
        walk.set(true, true);
        assert_eq!(walk.steps.now(), (1, Phase::Grip));
    }

    fn order() -> Order {
        Order { name: "ur.pstop", fault: Fault::Robot(RobotFault::ProtectiveStop), seconds: None }
    }

    fn due(trigger: Trigger, situations: &[Situation]) -> Vec<usize> {
        let mut schedule = Schedule::default();
        schedule.add(Planned { at: Some(trigger), order: order() });
        let due = |now: &Situation| schedule.due(now, [].iter()).len();
        situations.iter().map(due).collect()
    }

    fn at(time_s: f64, step: u32, phase: Phase, progress: f64) -> Situation {
        Situation { time_s, step: (step, phase), progress }
    }

    #[test]
    fn times_and_steps_are_due_once_and_never_lost() {
        let approach = |time_s| at(time_s, 1, Phase::Approach, 0.0);
        assert_eq!(due(Trigger::Time(1.0), &[approach(0.9), approach(1.0), approach(1.1)]), [0, 1, 0]);
        let half = || Trigger::Step { step: 2, phase: Phase::Carry, progress: 0.5 };
        let carry = |step, progress| at(0.0, step, Phase::Carry, progress);
        assert_eq!(due(half(), &[carry(1, 0.9), carry(2, 0.4), carry(2, 0.5)]), [0, 0, 1]);
        assert_eq!(due(half(), &[carry(2, 0.4), at(0.0, 2, Phase::Place, 0.0)]), [0, 1], "at its end");
        assert_eq!(due(half(), &[at(0.0, 3, Phase::Approach, 0.0)]), [1]);
    }

    #[test]
    fn events_are_counted_by_kind_and_object() {
        let gripped =
            |object: &str| Event { time_s: 0.0, kind: EventKind::Gripped { object: object.into() } };
        let mut schedule = Schedule::default();
        let trigger = Trigger::Event { kind: DeviceEvent::Grip, object: Some("a".into()), count: 2 };
        schedule.add(Planned { at: Some(trigger), order: order() });
        let now = at(0.0, 1, Phase::Grip, 0.0);
        assert!(schedule.due(&now, [gripped("a"), gripped("b")].iter()).is_empty());
        assert!(
            schedule
                .due(&now, [Event { time_s: 0.0, kind: EventKind::Fallen { object: "a".into() } }].iter())
                .is_empty()
        );
        assert_eq!(schedule.due(&now, [gripped("a")].iter()).len(), 1);
        assert_eq!(schedule.waiting(), 0);
    }
}
