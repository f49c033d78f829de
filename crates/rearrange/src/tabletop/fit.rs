//! Makes an instance ready for a cell: table size, markers, heights, masses, and where the cups take hold.
//!
//! In: any [`Instance`] and what camera and gripper need. Out: the instance with a marker on every object
//! and a grip for each, or every object that cannot be handled, by name, with the table size that would do.
//! The marker is the largest that fits (the larger, the better its corners are seen); it may be gripped on.

use crate::geometry::footprint::{Footprint, FootprintFault};
use crate::geometry::polygon::Point;
use crate::geometry::pose::Pose2;
use crate::tabletop::instance::{Instance, MarkerSpec, ObjectSpec};
use crate::tabletop::room::{Cup, Grip, largest_square, place_for_cups, place_for_square};
use std::collections::BTreeSet;

/// The marker family of the cell.
pub const FAMILY: &str = "tag36h11";
/// Modules along the edge of the black square.
pub const BLACK_MODULES: f64 = 8.0;
/// Modules along the edge of the print: the black square and its white ring.
pub const PRINT_MODULES: f64 = 10.0;
/// Marker ids for objects; the ones above belong to the table.
pub const OBJECT_IDS: std::ops::Range<u32> = 0..200;
/// Height of an object that states none, m.
pub const DEFAULT_HEIGHT_M: f64 = 0.02;
/// Density of an object that states no mass (light wood), kg/m3.
pub const DEFAULT_DENSITY: f64 = 450.0;
/// Sizes of markers are multiples of this: what a printer and a ruler can distinguish, m.
const SIZE_STEP_M: f64 = 1e-4;
/// Table sizes that are proposed are multiples of 1 / this, in 1/m.
const TABLE_STEPS_PER_M: f64 = 100.0;
/// No table is proposed that is larger than this, m.
const LARGEST_TABLE_M: f64 = 10.0;

/// What camera and gripper need of an object.
#[derive(Clone, Debug, PartialEq)]
pub struct Requirements {
    /// Pixels per metre on the table at the camera's working distance (focal length in px over distance in
    /// m).
    pub pixels_per_metre: f64,
    /// Fewest pixels along the edge of one marker module.
    pub least_module_px: f64,
    /// The cups that grip, tool frame.
    pub cups: Vec<Cup>,
    /// Distance every cup keeps to the edge of the top, m.
    pub cup_margin: f64,
}

impl Requirements {
    /// Edge of the smallest readable black square, in printable steps, m.
    pub fn least_marker_size(&self) -> f64 {
        let size = self.least_module_px * BLACK_MODULES / self.pixels_per_metre;
        (size / SIZE_STEP_M - 1e-6).ceil() * SIZE_STEP_M
    }

    /// Pixels along the edge of one module of a marker with this black square.
    fn module_px(&self, size: f64) -> f64 {
        size / BLACK_MODULES * self.pixels_per_metre
    }
}

/// An instance a cell can handle, and how it grips each object.
#[derive(Clone, Debug, PartialEq)]
pub struct Fitted {
    /// With heights, masses and markers.
    pub instance: Instance,
    /// By object; `None` for a fixed one.
    pub grips: Vec<Option<Grip>>,
}

/// What is in the way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Lack {
    /// The largest marker that fits cannot be read.
    Marker {
        /// Edge of the black square, m.
        size: f64,
        /// Pixels a module.
        px: f64,
        /// Pixels needed.
        needed: f64,
    },
    /// The marker the file states cannot be read.
    StatedMarker {
        /// Edge of the black square, m.
        size: f64,
        /// Pixels a module.
        px: f64,
        /// Pixels needed.
        needed: f64,
    },
    /// The cups have no place.
    Cups {
        /// Width the largest cup needs, m.
        needed: f64,
    },
}

/// An object the cell cannot handle at this size.
#[derive(Clone, Debug, PartialEq)]
pub struct Refusal {
    /// Its name.
    pub object: String,
    /// Why.
    pub lack: Lack,
    /// Longer side of the smallest table on which it would do, m, when the whole task grows with the table.
    pub table_size: Option<f64>,
}

impl std::fmt::Display for Refusal {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.lack {
            Lack::Marker { size, px, needed } => write!(
                out,
                "object `{}` is too small for a readable marker: at most {:.1} mm, {px:.1} px a module where \
                 {needed} are needed",
                self.object,
                size * 1e3
            )?,
            Lack::StatedMarker { size, px, needed } => {
                return write!(
                    out,
                    "the marker of object `{}` ({:.1} mm) is too small to be read: {px:.1} px a module where \
                     {needed} are needed; print a larger one, or leave it out and the largest that fits is \
                     taken",
                    self.object,
                    size * 1e3
                );
            }
            Lack::Cups { needed } => write!(
                out,
                "object `{}` is too small for the suction cup: {:.0} mm of flat top are needed",
                self.object,
                needed * 1e3
            )?,
        }
        match self.table_size {
            Some(size) => write!(out, "; a table of {size:.2} m would do"),
            None => write!(out, "; no table would do"),
        }
    }
}

/// Why an instance cannot be made ready.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FitError {
    /// Objects that camera or gripper cannot handle; all of them.
    #[error("{}", .0.iter().map(Refusal::to_string).collect::<Vec<_>>().join("\n"))]
    Refused(Vec<Refusal>),
    /// More objects than marker ids.
    #[error("{objects} objects, but only {markers} markers for objects")]
    TooManyObjects {
        /// Objects.
        objects: usize,
        /// Marker ids.
        markers: usize,
    },
    /// No table up to the given size would do.
    #[error("no table up to {max:.2} m is large enough: {first}")]
    NoTable {
        /// The largest table considered, m.
        max: f64,
        /// The first object in the way, on that table.
        first: Refusal,
    },
    /// Scaling made a footprint that is none.
    #[error("at this table size, {0}")]
    Scale(#[from] FootprintFault),
}

/// Longer side of the workspace, m: the "table size".
pub fn table_size(instance: &Instance) -> f64 {
    instance.workspace.width.max(instance.workspace.height)
}

/// The task scaled so that the longer side of its table is `size` m. Heights, masses and markers that the
/// file states are dropped when the size changes.
///
/// # Errors
/// A footprint that becomes too small or too large.
pub fn scaled_to_table(instance: &Instance, size: f64) -> Result<Instance, FootprintFault> {
    let factor = size / table_size(instance);
    if (factor - 1.0).abs() < 1e-9 { Ok(instance.clone()) } else { instance.scaled(factor) }
}

/// Heights, masses, markers and grips for every object that lacks them.
///
/// # Errors
/// Every object that is too small, or more objects than markers.
pub fn fit(instance: &Instance, needs: &Requirements) -> Result<Fitted, FitError> {
    let mut free_ids = free_ids(instance)?.into_iter();
    let mut refusals = Vec::new();
    let mut fitted = Fitted { instance: instance.clone(), grips: Vec::with_capacity(instance.objects.len()) };
    for object in &mut fitted.instance.objects {
        let height = *object.height.get_or_insert(DEFAULT_HEIGHT_M);
        object.mass.get_or_insert(object.footprint.area() * height * DEFAULT_DENSITY);
        if object.fixed {
            fitted.grips.push(None);
            continue;
        }
        match fit_object(object, needs) {
            Ok(ObjectFit { size, centre, grip }) => {
                fitted.grips.push(Some(grip));
                if object.marker.is_none() {
                    let offset = Pose2::new(centre[0], centre[1], 0.0);
                    let id = free_ids.next().unwrap_or(OBJECT_IDS.end);
                    object.marker = Some(MarkerSpec { family: FAMILY.to_string(), id, size, offset });
                }
            }
            Err(lack) => {
                let table_size = table_for_object(object, needs, table_size(instance), LARGEST_TABLE_M);
                refusals.push(Refusal { object: object.id.clone(), lack, table_size });
            }
        }
    }
    if refusals.is_empty() { Ok(fitted) } else { Err(FitError::Refused(refusals)) }
}

/// The smallest table (longer side, a multiple of 0.01 m) on which every object of the task can be handled.
///
/// # Errors
/// The first object for which `max` m is too small.
pub fn smallest_table_size(instance: &Instance, needs: &Requirements, max: f64) -> Result<f64, FitError> {
    let present = table_size(instance);
    let mut smallest = 1.0 / TABLE_STEPS_PER_M;
    for object in instance.objects.iter().filter(|object| !object.fixed) {
        match table_for_object(object, needs, present, max) {
            Some(size) => smallest = f64::max(smallest, size),
            None => {
                let largest = scaled_object(object, max / present)?;
                let lack = fit_object(&largest, needs).err().unwrap_or(cups_lack(needs));
                let table_size = table_for_object(object, needs, present, LARGEST_TABLE_M);
                let first = Refusal { object: object.id.clone(), lack, table_size };
                return Err(FitError::NoTable { max, first });
            }
        }
    }
    Ok(smallest)
}

/// Marker ids that no object of the file uses yet, enough for those without one.
fn free_ids(instance: &Instance) -> Result<Vec<u32>, FitError> {
    let used: BTreeSet<u32> =
        instance.objects.iter().filter_map(|object| object.marker.as_ref().map(|marker| marker.id)).collect();
    let free: Vec<u32> = OBJECT_IDS.filter(|id| !used.contains(id)).collect();
    let wanting = instance.objects.iter().filter(|object| object.marker.is_none() && !object.fixed).count();
    if wanting > free.len() {
        return Err(FitError::TooManyObjects { objects: instance.objects.len(), markers: OBJECT_IDS.len() });
    }
    Ok(free)
}

/// An object's marker and grip.
struct ObjectFit {
    /// Edge of the marker's black square, m.
    size: f64,
    /// Centre of the marker in the object's frame, m.
    centre: Point,
    /// Where the cups take hold.
    grip: Grip,
}

fn fit_object(object: &ObjectSpec, needs: &Requirements) -> Result<ObjectFit, Lack> {
    let (size, centre) = match &object.marker {
        Some(marker) => (marker.size, [marker.offset.x, marker.offset.y]),
        None => largest_marker(&object.footprint),
    };
    let px = needs.module_px(size);
    if px < needs.least_module_px - 1e-9 {
        let needed = needs.least_module_px;
        let stated = object.marker.is_some();
        return Err(if stated {
            Lack::StatedMarker { size, px, needed }
        } else {
            Lack::Marker { size, px, needed }
        });
    }
    let grip = place_for_cups(&object.footprint, object.grippable.as_ref(), &needs.cups, needs.cup_margin);
    Ok(ObjectFit { size, centre, grip: grip.ok_or(cups_lack(needs))? })
}

fn cups_lack(needs: &Requirements) -> Lack {
    let widest = needs.cups.iter().map(|cup| cup.radius).fold(0.0, f64::max);
    Lack::Cups { needed: 2.0 * (widest + needs.cup_margin) }
}

/// The largest marker, white ring included, that fits on the footprint: edge of its black square and centre.
/// A size of 0 when not even the smallest step fits.
pub fn largest_marker(footprint: &Footprint) -> (f64, Point) {
    let room = largest_square(footprint) * BLACK_MODULES / PRINT_MODULES;
    // The step may be one too many when the division came out a hair high; the next smaller one then fits.
    let steps = (room / SIZE_STEP_M + 1e-6).floor();
    for steps in [steps, steps - 1.0].into_iter().filter(|steps| *steps >= 1.0) {
        let size = steps * SIZE_STEP_M;
        if let Some(centre) = place_for_square(footprint, size * PRINT_MODULES / BLACK_MODULES) {
            return (size, centre);
        }
    }
    (0.0, footprint.centroid())
}

/// The object on a table `factor` times as large, without its marker, as [`Instance::scaled`] makes it.
fn scaled_object(object: &ObjectSpec, factor: f64) -> Result<ObjectSpec, FootprintFault> {
    let only = Instance {
        workspace: crate::tabletop::instance::Workspace { width: 1.0, height: 1.0 },
        clearance: 0.0,
        overlap_tolerance: 0.0,
        keep_out: Vec::new(),
        objects: vec![object.clone()],
    };
    Ok(only.scaled(factor)?.objects.remove(0))
}

/// The smallest table on which this object of a table of `present` m can be handled, if one up to `max`
/// does.
fn table_for_object(object: &ObjectSpec, needs: &Requirements, present: f64, max: f64) -> Option<f64> {
    let print = needs.least_marker_size() * PRINT_MODULES / BLACK_MODULES;
    let for_marker = present * print / largest_square(&object.footprint);
    let widest = needs.cups.iter().map(|cup| cup.radius + needs.cup_margin).fold(0.0, f64::max);
    // Every cup needs its disc; the object has at most the area of one around its bounding radius.
    let for_cups = present * widest / object.footprint.bounding_radius();
    let first = (for_marker.max(for_cups) * TABLE_STEPS_PER_M - 1e-6).ceil().max(1.0);
    let last = (max * TABLE_STEPS_PER_M + 1e-6).floor();
    if first.is_nan() || last.is_nan() || first > last {
        return None;
    }
    (first as u64..=last as u64).map(|steps| steps as f64 / TABLE_STEPS_PER_M).find(|size| {
        scaled_object(object, size / present).is_ok_and(|scaled| fit_object(&scaled, needs).is_ok())
    })
}

#[cfg(test)]
mod tests;
