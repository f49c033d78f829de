//! Object catalogue, workspace, arrangement, instance files and importers. Pure: text in, values out.

pub mod instance;
