//! The rule about calibration: nothing is gripped by the pictures of a camera that was moved, once a look at
//! the whole table could show that.
//!
//! In: where the simulated camera truly sits, looks as they were requested and answered. Out: why a pick
//! rests on a calibration that is not valid.

use crate::pair::rules::truth::Truth;
use cell_vision::observe::reference::DriftLimits;
use nalgebra::{Isometry3, Point3};
use std::collections::BTreeSet;
use ur_sim::world::World;

/// Distance of the camera from the table in a look, m.
const LOOKS_FROM_M: f64 = 0.42;

/// So many times the limit are surely beyond it, whatever noise does.
const SURELY: f64 = 3.0;

/// Where the camera is, and who could know. See the module.
#[derive(Debug)]
pub(super) struct Calibration {
    limit_m: f64,
    /// The camera from where it was mounted, how far it shows the table beside where it is, m, and since
    /// when.
    shift: Isometry3<f64>,
    shift_m: f64,
    since: u64,
    frame: u64,
    /// Looks at the whole table that are put together, by number: all their pictures were taken since the
    /// camera sits where it does.
    asked: BTreeSet<u64>,
    /// When the look under way began.
    began: u64,
    /// A look at the whole table has shown where the camera sits.
    shown: bool,
}

impl Calibration {
    /// With these limits of the cell.
    pub fn new(limits: &DriftLimits) -> Calibration {
        let limit_m = SURELY * limits.shift_m.max(limits.residual_m);
        Calibration {
            limit_m,
            shift: Isometry3::identity(),
            shift_m: 0.0,
            since: 0,
            frame: 0,
            asked: BTreeSet::new(),
            began: 0,
            shown: false,
        }
    }

    /// One controller frame.
    pub fn frame(&mut self, truth: &Truth, world: &World) {
        self.frame = truth.frame;
        let shift = world.camera_faults().shift;
        if shift != self.shift {
            (self.shift, self.shift_m) = (shift, beside_m(&shift));
            (self.since, self.shown) = (truth.frame, false);
            self.asked.clear();
        }
    }

    /// A picture is requested.
    pub fn pictured(&mut self) {
        if self.began == 0 {
            self.began = self.frame;
        }
    }

    /// The views of a look are put together; `whole`: of the whole table.
    pub fn put_together(&mut self, number: u64, whole: bool) {
        if whole && self.began > self.since {
            self.asked.insert(number);
        }
        self.began = 0;
    }

    /// What came of it reaches the machine.
    pub fn observed(&mut self, number: u64) {
        self.shown |= self.asked.remove(&number);
    }

    /// Why a pick that begins now rests on a calibration that is not valid.
    pub fn invalid(&self) -> Option<String> {
        let off = self.shown && self.shift_m > self.limit_m;
        off.then(|| format!("the camera shows the table {:.1} mm beside where it is", 1e3 * self.shift_m))
    }
}

/// How far beside its place a point of the table appears to a camera that was moved so, m.
fn beside_m(shift: &Isometry3<f64>) -> f64 {
    let point = Point3::new(0.0, 0.0, LOOKS_FROM_M);
    let seen = shift.inverse() * point;
    (seen.x - point.x).hypot(seen.y - point.y)
}
