//! Recorded touches held against the table that the camera sees.
//!
//! In: the touches of a file, which of them count, the survey; the robot and the table of a round. Out: the
//! table by both, or why the touches place no table, or not this one. What is wrong with the touches alone
//! is known before a round is taken. Pure.

use crate::files::hand_eye::Provenance;
use crate::files::touches::Touches;
use crate::fit::HandEye;
use crate::fit::touch::{Registration, RegistrationLimits, TouchFit, TouchSettings, fit_touches, register};
use cell_vision::observe::ReferenceMarker;
use nalgebra::Point3;
use rearrange::document::chain::chain;

/// Why there is no table by touch and camera.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TiedFault {
    /// The file is of another survey or robot, or has no touch of that number.
    #[error("{0}")]
    Input(String),
    /// The touches fix no table, or another than the camera's.
    #[error("{0}")]
    Unfit(String),
}

/// Touches that by themselves place the table of this survey.
#[derive(Clone, Debug)]
pub struct FittedTouches {
    name: String,
    touches: Touches,
    used: Vec<usize>,
    fit: TouchFit,
}

impl FittedTouches {
    /// The table by the touches of the file `name` but the `dropped` ones, numbered from 1.
    ///
    /// # Errors
    /// A marker that the survey does not have, a number that is not in the file, touches that fix no table.
    pub fn new(
        name: String,
        touches: Touches,
        dropped: &[usize],
        survey: &[ReferenceMarker],
    ) -> Result<FittedTouches, TiedFault> {
        let all = touches.resolve(survey).map_err(|error| TiedFault::Input(format!("{name}: {error}")))?;
        if let Some(number) = dropped.iter().find(|number| !(1..=all.len()).contains(*number)) {
            let message = format!("--drop-touch {number}: there are touches 1 to {}", all.len());
            return Err(TiedFault::Input(message));
        }
        let used: Vec<usize> = (0..all.len()).filter(|index| !dropped.contains(&(index + 1))).collect();
        let chosen: Vec<_> = used.iter().map(|&index| all[index]).collect();
        let fit = fit_touches(&chosen, &TouchSettings::default())
            .map_err(|error| TiedFault::Unfit(format!("{name}: {}", chain(&error))))?;
        Ok(FittedTouches { name, touches, used, fit })
    }

    /// All touches of the file.
    pub fn touches(&self) -> &Touches {
        &self.touches
    }

    /// Which of them count, from 0.
    pub fn used(&self) -> &[usize] {
        &self.used
    }

    /// The table by them alone.
    pub fn fit(&self) -> &TouchFit {
        &self.fit
    }

    /// Compares the robot that touched with the one of the pictures.
    ///
    /// # Errors
    /// It is another one, or its kinematics were measured anew.
    pub fn check_robot(&self, taken: &Provenance) -> Result<(), TiedFault> {
        self.touches.check_robot(&self.name, taken).map_err(TiedFault::Input)
    }

    /// The table by touch and camera; it is `table_m` wide and deep, m.
    ///
    /// # Errors
    /// The two disagree by more than the limits.
    pub fn register(
        &self,
        camera: &HandEye,
        table_m: [f64; 2],
        limits: &RegistrationLimits,
    ) -> Result<Registration, TiedFault> {
        let middle = Point3::new(table_m[0] / 2.0, table_m[1] / 2.0, 0.0);
        let by_camera = (&camera.base_from_table, &camera.base_from_table_covariance);
        register(by_camera, &self.fit, &middle, limits)
            .map_err(|error| TiedFault::Unfit(format!("{}: {}", self.name, chain(&error))))
    }
}
