//! A person brings the tool's tip onto points of the table, one after the other: what is recorded at each.
//!
//! In: the points, the tip, the arm; at each point where the arm's joints are and how fast they move. Out:
//! [`Touches`], and the table by them alone. A touch counts only while the arm is at rest, for its pose and
//! the press of a key are not of one moment. Pure: the person is prompted by `cli::calibrate::touch`.

use crate::files::touches::{Place, RecordedTouch, Target, Touches};
use crate::fit::touch::{TouchFit, TouchSettings, fit_touches};
use cell_values::units::Joints;
use cell_vision::observe::ReferenceMarker;
use nalgebra::Point3;
use rearrange::document::chain::chain;
use ur_arm::kinematics::{DhParameters, forward};

/// Joint speed below which a hand-held arm counts as still, rad/s.
const STILL_RAD_S: f64 = 0.01;

/// A session of touching.
#[derive(Clone, Debug)]
pub struct TouchSession {
    targets: Vec<Target>,
    dh: DhParameters,
    touches: Touches,
}

impl TouchSession {
    /// `begun` says who touches, when and with which tip, and has no touch yet; `dh` is the arm's.
    pub fn new(targets: Vec<Target>, dh: DhParameters, begun: Touches) -> TouchSession {
        TouchSession { targets, dh, touches: begun }
    }

    /// The point to touch next, and its number from 1; `None` when all are touched.
    pub fn wanted(&self) -> Option<(usize, Target)> {
        let done = self.touches.touches.len();
        self.targets.get(done).map(|target| (done + 1, *target))
    }

    /// The tip is on the point wanted, with the joints at `q` (rad) and moving at `qd` (rad/s): where that
    /// puts the tip in the base frame, m. `None`, and nothing recorded, unless the arm is still.
    pub fn touch(&mut self, q: &Joints, qd: &[f64; 6]) -> Option<Point3<f64>> {
        let (_, target) = self.wanted()?;
        let still = qd.iter().all(|speed| speed.abs() <= STILL_RAD_S);
        if !still {
            return None;
        }
        let base_from_flange = forward(&self.dh, q);
        self.touches.touches.push(RecordedTouch { target, place: Place::Flange(base_from_flange) });
        let tip = self.touches.flange_from_tip_m.unwrap_or_default();
        Some(base_from_flange * Point3::from(tip))
    }

    /// What is recorded so far.
    pub fn touches(&self) -> &Touches {
        &self.touches
    }

    /// The table by these touches alone.
    ///
    /// # Errors
    /// A marker that the survey does not have, or touches that fix no table.
    pub fn fit(&self, survey: &[ReferenceMarker]) -> Result<TouchFit, String> {
        let resolved = self.touches.resolve(survey)?;
        fit_touches(&resolved, &TouchSettings::default()).map_err(|error| chain(&error))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_touch_counts_only_while_the_arm_is_still() {
        let begun = Touches {
            robot_serial: "1".into(),
            kinematics_checksum: "2".into(),
            date: "2026-11-21".into(),
            flange_from_tip_m: Some([0.0, 0.0, 0.15]),
            touches: Vec::new(),
        };
        let targets = vec![Target::Point([0.1, 0.1, 0.0]), Target::Point([0.2, 0.1, 0.0])];
        let mut session = TouchSession::new(targets.clone(), DhParameters::UR5E, begun);
        let q = Joints([0.1, -1.6, 1.9, -1.9, -1.57, 0.0]);
        for moving in [0.02, f64::NAN] {
            assert_eq!(session.touch(&q, &[0.0, 0.0, moving, 0.0, 0.0, 0.0]), None);
            assert_eq!(session.wanted(), Some((1, targets[0])));
        }
        let at = session.touch(&q, &[0.0; 6]).unwrap();
        let flange = forward(&DhParameters::UR5E, &q);
        assert!((at - flange * Point3::new(0.0, 0.0, 0.15)).norm() < 1e-12);
        assert_eq!(session.wanted(), Some((2, targets[1])));
        session.touch(&q, &[0.0; 6]).unwrap();
        assert_eq!((session.wanted(), session.touch(&q, &[0.0; 6])), (None, None));
        assert_eq!(session.touches().touches.len(), 2);
    }
}
