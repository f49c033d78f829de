//! Two parallel fingers as they are now: opening, force, what they hold.
//!
//! In: the opening, and the registers of the gripper's controller. Out: where the fingers are, and what they
//! carry. The world moves them (`finger_grip`).

use crate::world::drive::FingersSpec;
use crate::world::section::Section;
use crate::world::two_finger::TwoFinger;
use std::sync::Arc;

/// Friction between pads and objects.
const FRICTION: f64 = 0.5;

/// The fingers as they are now.
pub(super) struct Fingers {
    /// Sizes, speeds, forces.
    pub(super) spec: FingersSpec,
    /// Registers.
    pub(super) device: TwoFinger,
    /// How far they are open, m.
    pub(super) gap_m: f64,
    /// Force of one, N.
    pub(super) force_n: f64,
    /// Objects between them, by number.
    pub(super) holds: Vec<usize>,
    /// Outline of one.
    pub(super) section: Arc<Section>,
}

impl Fingers {
    /// Open.
    pub(super) fn new(spec: FingersSpec) -> Fingers {
        let section = Arc::new(Section::rectangle(spec.thickness_m, spec.width_m));
        let device = TwoFinger::new(spec);
        Fingers { spec, device, gap_m: spec.stroke_m, force_n: 0.0, holds: Vec::new(), section }
    }

    /// Where the middles of the fingers are along x of the tool, m.
    pub(super) fn places(&self) -> [f64; 2] {
        self.places_at(self.gap_m)
    }

    /// The same if they were so far open.
    pub(super) fn places_at(&self, gap_m: f64) -> [f64; 2] {
        let out = (gap_m + self.spec.thickness_m) / 2.0;
        [-out, out]
    }

    /// The force that carries an object, N.
    pub(super) fn carries_n(&self, index: usize) -> f64 {
        if self.holds.contains(&index) { 2.0 * FRICTION * self.force_n } else { 0.0 }
    }

    /// An object has left them.
    pub(super) fn lost(&mut self, index: usize) {
        self.holds.retain(|held| *held != index);
    }
}
