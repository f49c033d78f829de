//! The edge: cameras, sockets, files, clocks. The only place that touches the outside, besides `sim` and
//! `daemon`.

pub mod camera;
pub mod clock;
pub mod files;
pub mod priority;
pub mod recording;
