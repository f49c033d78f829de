//! Pictures and pages people look at: SVG, HTML, tables. Pure.

pub mod plan_svg;
