//! The stand-in for the hardware: world, UR controller, VGC10 and camera behind the real protocols.

pub mod controller;

pub mod motion;
