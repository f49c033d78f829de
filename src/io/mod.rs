//! The edge: cameras and recordings. What touches the outside besides is `cell-edge`, `jobs` and `daemon`.

pub mod camera;
pub mod recording;
