//! Poses, footprints, collision and clearance on the table, and poses in space.
//!
//! `pose`: SE(2) and SE(3). `footprint`: the shapes objects have. `polygon`: simple polygons and their
//! convex parts. `ellipse`: the exact predicates of ellipses. `collision`: do two placed footprints overlap,
//! how deep, how far apart. Pure, and knows nothing of objects, plans or robots.

pub mod collision;
pub mod ellipse;
pub mod footprint;
pub mod polygon;
pub mod pose;
