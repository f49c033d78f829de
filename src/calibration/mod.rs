//! Calibration of a cell: where its camera sits, where its table lies, what its lens is.
//!
//! The steps in their order: `drawn` is the cell as the configuration draws it, where everything starts;
//! `propose` finds poses inside a taught box; `visit` collects what the camera saw from each; `fit` turns the
//! samples into camera, table and lens, with their errors; `files` keeps the results as text and checks
//! whether they fit together. Pure: the arm is moved by the machine (`cell::supervisor::round`), files are
//! read and written by `config` and `cli::calibrate`, and OpenCV is called by `cell_vision::cv` alone.

pub mod drawn;
pub mod files;
pub mod fit;
pub mod propose;
pub mod visit;
