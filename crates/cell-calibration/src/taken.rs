//! A round that was taken: what is requested of it, and the calibration files that come of it.
//!
//! In: lens, arm and samples of a round; the cell as drawn; the mount where it is known; the tie to touches.
//! Out: [`Solved`], and from it the three files as data. Whether the camera sits on the flange or is fixed
//! decides the solver, never what comes out. Pure.

use crate::drawn::Drawn;
use crate::files::camera::CameraCalibration;
use crate::files::hand_eye::{HandEyeCalibration, Provenance};
use crate::files::set::CalibrationSet;
use crate::files::table::TableCalibration;
use crate::fit::Sample;
use crate::fit::solve::{FitError, Solved, solve};
use crate::fit::touch::{Registration, TouchFit};

/// What is requested of a round.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wanted {
    /// Where the camera sits, and the table.
    MountAndTable,
    /// The table alone.
    Table,
}

/// A round as it was taken.
#[derive(Debug)]
pub struct Taken {
    /// The lens to work with.
    pub lens: CameraCalibration,
    /// Which camera and arm, and when.
    pub provenance: Provenance,
    /// In the order of the poses.
    pub samples: Vec<Sample>,
}

impl Taken {
    /// Leaves samples out, by their numbers from 1: they keep their places and show nothing.
    ///
    /// # Errors
    /// A number that no sample has.
    pub fn leave_out(&mut self, numbers: &[usize]) -> Result<(), String> {
        for number in numbers {
            let all = self.samples.len();
            let Some(sample) = number.checked_sub(1).and_then(|index| self.samples.get_mut(index)) else {
                return Err(format!("--drop {number}: there are samples 1 to {all}"));
            };
            sample.detections.clear();
        }
        Ok(())
    }

    /// Camera and table, or with a `known` mount the table alone.
    ///
    /// # Errors
    /// [`FitError`].
    pub fn solve(&self, drawn: &Drawn, known: Option<HandEyeCalibration>) -> Result<Solved, FitError> {
        solve(drawn, &self.lens.model, &self.samples, known, &self.provenance)
    }

    /// The calibration files; the table is that by touch and camera where it is tied.
    pub fn calibrated(
        self,
        solved: Solved,
        drawn: &Drawn,
        tied: Option<(&TouchFit, &Registration)>,
    ) -> CalibrationSet {
        let mut table = TableCalibration::from_solution(&solved.table, &drawn.reference, self.provenance);
        if let Some((touched, tie)) = tied {
            table = table.tied(touched, tie);
        }
        let hand_eye = solved.hand_eye;
        table.hand_eye_date = Some(hand_eye.provenance.date.clone());
        CalibrationSet { camera: self.lens, hand_eye, table }
    }
}
