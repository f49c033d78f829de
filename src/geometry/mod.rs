//! Poses, footprints, collision and clearance on the table, and poses in space.
//!
//! `pose`: SE(2) and SE(3). `footprint`: the shapes objects have. `collision`: do two placed footprints
//! overlap, how deep, how far apart. Pure, and knows nothing of objects, plans or robots.

pub mod pose;
