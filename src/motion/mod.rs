//! How the arm does a pick-n-place: kinematics, limits, path, timing.

pub mod kinematics;
