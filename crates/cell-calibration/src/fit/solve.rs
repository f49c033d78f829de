//! Camera and table from a round's samples, whether the camera sits on the flange or is fixed.
//!
//! In: the cell as drawn, the lens, samples of a round, the mount where it was measured before. Out:
//! [`Solved`], or why there is no solution. With a known mount only the table is looked for. Pure.

use crate::drawn::{CameraMount, Drawn};
use crate::files::hand_eye::{HandEyeCalibration, Mount, Provenance};
use crate::fit::fixed::{FixedGuess, solve_fixed, table_before};
use crate::fit::hand_eye::solve_hand_eye;
use crate::fit::{CalibrateError, HandEye, HandEyeGuess, HandEyeSettings, Sample};
use cell_vision::camera::CameraModel;
use nalgebra::Isometry3;

/// Why there is no solution.
#[derive(Debug, thiserror::Error)]
pub enum FitError {
    /// The camera does not sit where this solver looks for it.
    #[error("the configuration's camera is not mounted on the flange")]
    FixedCamera,
    /// The samples do not give a solution.
    #[error("calibration")]
    Solve(#[from] CalibrateError),
    /// The same with a fixed camera.
    #[error(transparent)]
    Standing(CalibrateError),
}

/// What a round says.
#[derive(Clone, Debug)]
pub struct Solved {
    /// Where the camera sits: as known before, or as found.
    pub hand_eye: HandEyeCalibration,
    /// The fit to the board on the hand, where it was what found the camera.
    pub board: Option<HandEye>,
    /// The fit to the reference markers, which places the table.
    pub table: HandEye,
}

/// Camera and table, or with a `known` mount the table alone.
///
/// # Errors
/// [`FitError`].
pub fn solve(
    drawn: &Drawn,
    lens: &CameraModel,
    samples: &[Sample],
    known: Option<HandEyeCalibration>,
    provenance: &Provenance,
) -> Result<Solved, FitError> {
    let CameraMount::Fixed { base_from_camera, board, .. } = drawn.camera else {
        let mount = known.as_ref().and_then(|known| match known.mount {
            Mount::Flange { flange_from_camera } => Some(flange_from_camera),
            Mount::Fixed { .. } => None,
        });
        let mut table = on_the_flange(drawn, lens, samples, mount)?;
        if let Some(known) = &known {
            table.widen_by_mount(&known.std, lever_m(samples, &table));
        }
        let hand_eye = known.unwrap_or_else(|| HandEyeCalibration::from_solution(&table, provenance.clone()));
        return Ok(Solved { hand_eye, board: None, table });
    };
    let (reference, base_from_table) = (&drawn.reference, drawn.base_from_table);
    let settings = HandEyeSettings::default();
    if let Some(known) = known {
        let camera = (known.mount.base_from_camera(&Isometry3::identity()), known.std.spread());
        let table = table_before(samples, reference, lens, camera, &base_from_table, &settings);
        return Ok(Solved { hand_eye: known, board: None, table: table.map_err(FitError::Standing)? });
    }
    let start = FixedGuess { base_from_camera, base_from_table };
    let found = solve_fixed(samples, &board, reference, lens, &start, &settings);
    let found = found.map_err(FitError::Standing)?;
    let hand_eye = HandEyeCalibration::from_fixed(&found, provenance.clone());
    Ok(Solved { hand_eye, board: Some(found.hand), table: found.table })
}

/// Camera mount and table of a camera on the flange, starting as drawn.
///
/// # Errors
/// [`FitError`].
pub fn on_the_flange(
    drawn: &Drawn,
    lens: &CameraModel,
    samples: &[Sample],
    known_mount: Option<Isometry3<f64>>,
) -> Result<HandEye, FitError> {
    let CameraMount::Flange { flange_from_camera } = drawn.camera else {
        return Err(FitError::FixedCamera);
    };
    let flange_from_camera = known_mount.unwrap_or(flange_from_camera);
    let guess = HandEyeGuess { flange_from_camera, base_from_table: drawn.base_from_table };
    let settings = HandEyeSettings { keep_mount: known_mount.is_some(), ..HandEyeSettings::default() };
    Ok(solve_hand_eye(samples, &drawn.reference, lens, &guess, &settings)?)
}

/// Mean distance of the camera from the table's frame, m.
fn lever_m(samples: &[Sample], table: &HandEye) -> f64 {
    let origin = table.base_from_table.translation.vector;
    let camera = |sample: &Sample| sample.base_from_flange * table.flange_from_camera;
    let far = samples.iter().map(|sample| (camera(sample).translation.vector - origin).norm());
    far.sum::<f64>() / samples.len().max(1) as f64
}
