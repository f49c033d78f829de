//! Whether the demo's cell can do an instance, and the instance as it fits that cell.
//!
//! In: an instance as its author wrote it, the size of the table. Out: the instance with heights, masses and
//! markers, and the configuration of a cell that can carry every object to its goal; or which object cannot
//! be done, by name, before anything is started.

use crate::config::cell::CellConfig;
use crate::config::setup::{CUP_MARGIN_M, Transport, check_reach};
use crate::demo::cell::{CUP_DIAMETER_M, DemoChoice, LOOK_DISTANCE_M, cell_config};
use crate::demo::teach::reference_markers;
use rearrange::tabletop::fit::{self, Requirements, fit, scaled_to_table, smallest_table_size};
use rearrange::tabletop::instance::{Instance, ObjectSpec, Workspace};
use rearrange::tabletop::room::Cup;
use std::path::Path;
use ur_sim::command::FOCAL_PX;

/// Tables up to this size are proposed, m.
const LARGEST_TABLE_M: f64 = 0.8;

/// What the demo's camera and cup require of an object.
pub fn requirements() -> Requirements {
    Requirements {
        pixels_per_metre: FOCAL_PX / LOOK_DISTANCE_M,
        least_module_px: 3.0,
        cups: vec![Cup { x: 0.0, y: 0.0, radius: CUP_DIAMETER_M / 2.0 }],
        cup_margin: CUP_MARGIN_M,
    }
}

/// Longer side of the smallest table that every object allows, m.
///
/// # Errors
/// The objects that no table of a size that is proposed allows.
pub fn smallest_table_m(given: &Instance) -> Result<f64, String> {
    smallest_table_size(given, &requirements(), LARGEST_TABLE_M).map_err(|error| error.to_string())
}

/// The instance on a table whose longer side is `table_m`, or as it is, with all that the cell needs of its
/// objects.
///
/// # Errors
/// Objects that camera or cup cannot handle, or that carry a marker of the table.
pub fn fitted(given: &Instance, table_m: Option<f64>) -> Result<Instance, String> {
    let scaled = match table_m {
        Some(size) => scaled_to_table(given, size).map_err(|error| error.to_string())?,
        None => given.clone(),
    };
    let fitted = fit(&scaled, &requirements()).map_err(|error| error.to_string())?.instance;
    refuse_table_markers(&fitted)?;
    Ok(fitted)
}

/// The demo glues reference markers round the table; an object with one of those numbers would be taken for
/// the table.
fn refuse_table_markers(instance: &Instance) -> Result<(), String> {
    let Workspace { width, height } = instance.workspace;
    let table: Vec<u32> = reference_markers(width, height).into_iter().map(|(id, _)| id).collect();
    let clash = |object: &ObjectSpec| {
        let id = object.marker.as_ref().map(|marker| marker.id).filter(|id| table.contains(id))?;
        Some(format!("object `{}` carries marker {id}", object.id))
    };
    let clashes: Vec<String> = instance.objects.iter().filter_map(clash).collect();
    if clashes.is_empty() {
        return Ok(());
    }
    let (first, last) = (table.iter().min().unwrap_or(&0), table.iter().max().unwrap_or(&0));
    Err(format!(
        "{}: markers {first} to {last} are the demo table's own; give other numbers, {} to {} are for \
         objects",
        clashes.join(", "),
        fit::OBJECT_IDS.start,
        fit::OBJECT_IDS.end - 1
    ))
}

/// The cell for the instance, if its arm can do the work: what is too heavy or too far is refused by name,
/// now.
///
/// # Errors
/// The object that cannot be carried, and what helps.
pub fn possible_cell(instance: &Instance, choice: &DemoChoice, out: &Path) -> Result<CellConfig, String> {
    let config = cell_config(instance, choice, out)?;
    let task: Vec<_> = instance
        .objects
        .iter()
        .filter(|object| !object.fixed)
        .filter_map(|object| {
            Some(Transport { object: object.id.clone(), from: object.start?, to: object.goal? })
        })
        .collect();
    let table = fit::table_size(instance);
    check_reach(&config, &task).map_err(|message| {
        format!("{message}; on a smaller table than {table:.2} m it may do (--table-size)")
    })?;
    Ok(config)
}
