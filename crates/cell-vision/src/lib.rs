//! Images, marker detection, object poses with their uncertainty, things without a marker.
//!
//! The path of a picture: `image` (pixels) -> `detect` (marker corners; `refine` makes them exact) ->
//! `observe` (what lies where, how sure). `camera` is the lens as numbers, `cv` what we let OpenCV compute
//! with them, `foreign` what carries no marker, `region` parts of the table, `annotate` the picture for
//! people, `marker` the print itself. Pure; OpenCV is called in `cv` alone and the AprilTag library in
//! `detect` alone.

pub mod annotate;
pub mod board;
pub mod camera;
pub mod cv;
pub mod detect;
pub mod foreign;
pub mod marker;
pub mod observe;
pub mod refine;
pub mod region;

#[cfg(any(test, feature = "testing"))]
pub mod testing;

/// The example of the README, run by `cargo test --doc`.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct Readme;
