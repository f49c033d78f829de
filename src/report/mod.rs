//! Pictures and pages people look at: SVG, HTML, tables. Pure.

/// How the styles of all pages name a computer that is dark, spelled alike so that a page can be made dark
/// or light whatever the computer is.
pub const DARK_COMPUTER: &str = "@media(prefers-color-scheme:dark)";

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
