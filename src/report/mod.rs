//! Pictures and pages people look at: SVG, HTML, tables. Pure.

pub mod chart;
pub mod colour;
pub mod html;
pub mod plan_animation;
pub mod plan_svg;
pub mod prints;
pub mod raster;
pub mod replay_page;
pub mod route_svg;
pub mod run;
pub mod summary;
pub mod table_svg;
pub mod text;
pub mod times_svg;
