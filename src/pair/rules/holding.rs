//! The rule about what the status says of the gripper: what hangs there is named, and what is named hangs
//! there.
//!
//! In: the simulated world, the status. Out: breaches. Without vacuum an object that sticks to the cups is
//! known to nobody before a picture shows it, and its fall to nobody before a person says so. A gripper that
//! does not answer shows nothing.

use crate::pair::rules::found::Found;
use crate::pair::rules::rule::Rule;
use crate::pair::rules::truth::Truth;
use ur_sim::world::World;
use ur_sim::world::vacuum::{Channel, VacuumMode};

/// The status knows of a grip within this, 1 s: the vacuum is read, and the grip is written down.
const NAMED_FRAMES: u64 = 500;

/// It knows within this that nothing hangs there any more, 3 s: a loss is noticed by the falling vacuum.
const DROPPED_FRAMES: u64 = 1500;

/// How the status begins what surely hangs on the gripper.
const HOLDS: &str = "holds ";

/// Since when status and truth differ. See the module.
#[derive(Debug, Default)]
pub(super) struct Holding {
    unnamed: Option<u64>,
    empty: Option<u64>,
}

impl Holding {
    /// One controller frame; `sound`: the gripper answers in time.
    pub fn frame(&mut self, truth: &Truth, world: &World, sound: bool, found: &mut Found) {
        let Some(status) = truth.status.filter(|_| sound) else {
            return (self.unnamed, self.empty) = (None, None);
        };
        let grips = Channel::ALL.iter().any(|channel| world.vacuum_command(*channel).0 == VacuumMode::Grip);
        let held = world.held().next().filter(|_| grips);
        let words = status.held.as_deref();
        let named = held.is_none_or(|object| words.is_some_and(|words| words.contains(object)));
        let says = grips && words.is_some_and(|words| words.starts_with(HOLDS));
        let hangs = !says || world.held().next().is_some();
        self.unnamed = if named { None } else { self.unnamed.or(Some(truth.frame)) };
        self.empty = if hangs { None } else { self.empty.or(Some(truth.frame)) };
        if self.unnamed.is_some_and(|since| truth.frame == since + NAMED_FRAMES) {
            let detail = format!("{} hangs there, the status says {words:?}", held.unwrap_or_default());
            found.push(Rule::HeldNotTrue, detail);
        }
        if self.empty.is_some_and(|since| truth.frame == since + DROPPED_FRAMES) {
            found.push(Rule::HeldNotTrue, format!("nothing hangs there, the status says {words:?}"));
        }
    }

    /// The daemon is gone and comes back.
    pub fn restarted(&mut self) {
        *self = Holding::default();
    }
}
