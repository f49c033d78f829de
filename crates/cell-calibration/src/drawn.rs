//! The cell as drawn, good to some centimetres and degrees: where a calibration starts, and what poses are
//! proposed for.
//!
//! In: what the configuration says of camera, table and survey. Out: plain data. Pure.

use cell_motion::slow::CalibrationBox;
use cell_vision::board::Board;
use cell_vision::observe::ReferenceMarker;
use nalgebra::Isometry3;

/// Where the camera sits, nominally; the calibration files hold the measured transforms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CameraMount {
    /// On the wrist.
    Flange {
        /// Nominal mount.
        flange_from_camera: Isometry3<f64>,
    },
    /// Over the table; the look poses keep the arm out of its picture.
    Fixed {
        /// Nominal mount.
        base_from_camera: Isometry3<f64>,
        /// What the hand carries before it to calibrate it.
        board: Board,
        /// The board's frame (lower left corner of its lower left square, x along the lower edge, z out of
        /// the print) in the flange frame, m, within 2 cm and 10 degrees: for poses to be proposed by.
        /// Calibration finds it by itself.
        flange_from_board: Option<Isometry3<f64>>,
    },
}

impl CameraMount {
    /// The word for it in files, as of the measured `Mount`.
    pub fn as_str(&self) -> &'static str {
        match self {
            CameraMount::Flange { .. } => "flange",
            CameraMount::Fixed { .. } => "fixed",
        }
    }
}

/// A cell that is not calibrated yet.
#[derive(Clone, Debug)]
pub struct Drawn {
    /// Where the camera sits.
    pub camera: CameraMount,
    /// The table in the base frame.
    pub base_from_table: Isometry3<f64>,
    /// The surveyed markers, table frame; the one thing here that has to be right.
    pub reference: Vec<ReferenceMarker>,
    /// The workspace's extent along the table's x and y, m.
    pub table_m: [f64; 2],
    /// What the flange does not leave while calibrating.
    pub room: Option<CalibrationBox>,
}
