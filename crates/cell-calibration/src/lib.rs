//! Calibration of a cell: where its camera sits, where its table lies, what its lens is.
//!
//! The steps in their order: `drawn` is the cell as the configuration draws it, where everything starts;
//! `propose` finds poses inside a taught box; `visit` collects what the camera saw from each;
//! `board_pictures` judges pictures of a board as they are taken, `touching` records touches; `fit` turns
//! samples into camera, table and lens, with their errors; `taken` is a whole round and what comes of it,
//! `tied` holds touches against it; `blends` judges how an arm passes corners; `files` keeps the results as
//! text and checks whether they fit together. Pure: the arm is moved by the machine
//! (`cell_machine::supervisor::round`), files are read and written by `config`, people are prompted by
//! `cli::calibrate`, and OpenCV is called by `cell_vision::cv` alone.

pub mod blends;
pub mod board_pictures;
pub mod drawn;
pub mod files;
pub mod fit;
pub mod propose;
pub mod taken;
pub mod tied;
pub mod touching;
pub mod visit;

/// The example of the README, run by `cargo test --doc`.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct Readme;
