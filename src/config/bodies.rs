//! The `cell:` section of the configuration: equipment, safety planes, what else hangs on the flange.
//!
//! In: located values and a decoder that collects complaints. Out: [`Equipment`], shapes in the base frame
//! and in the flange's, m, or `None` with a complaint kept. Every key is optional: a cell with nothing near
//! it is described by the rest of the file.

use cell_motion::bodies::cell::{MARGIN_M, NamedShape};
use cell_motion::bodies::shape::Shape;
use cell_parts::fields::{list, optional, required_positive, transform};
use rearrange::document::decode::{At, Decoder, Fields};

/// Longest edge of anything that is described, m.
const LONGEST_M: f64 = 20.0;

/// What stands round the arm and hangs on it besides gripper and camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Equipment {
    /// Distance kept to everything that does not move, m.
    pub margin_m: f64,
    /// Room for hoses and cables round forearm and wrists, m.
    pub cable_m: f64,
    /// What the robot is mounted on; a column where it is not given.
    pub stand: Option<Shape>,
    /// In the base frame.
    pub fixed: Vec<NamedShape>,
    /// In the flange frame.
    pub tool: Vec<NamedShape>,
}

impl Default for Equipment {
    fn default() -> Equipment {
        Equipment { margin_m: MARGIN_M, cable_m: 0.0, stand: None, fixed: Vec::new(), tool: Vec::new() }
    }
}

/// The check measures distances as often as half a millimetre may be used up, m.
const LEAST_MARGIN_M: f64 = 0.001;

/// The section.
pub(super) fn equipment(d: &mut Decoder, at: &At) -> Option<Equipment> {
    let fields = d.map(at, &["margin_m", "cable_m", "stand", "boxes", "cylinders", "planes", "tool"])?;
    let margin_m =
        optional(d, &fields, "margin_m", MARGIN_M, |d, at| d.number_in(at, LEAST_MARGIN_M..=0.1, "m"));
    let cable_m = optional(d, &fields, "cable_m", 0.0, |d, at| d.number_in(at, 0.0..=0.2, "m"));
    let stand = optional(d, &fields, "stand", None, |d, at| stand(d, at).map(Some));
    let boxes = optional(d, &fields, "boxes", Vec::new(), |d, at| list(d, at, cuboid));
    let cylinders = optional(d, &fields, "cylinders", Vec::new(), |d, at| list(d, at, cylinder));
    let planes = optional(d, &fields, "planes", Vec::new(), |d, at| list(d, at, plane));
    let tool = optional(d, &fields, "tool", Vec::new(), tool);
    let fixed = boxes?.into_iter().chain(cylinders?).chain(planes?).collect();
    Some(Equipment { margin_m: margin_m?, cable_m: cable_m?, stand: stand?, fixed, tool: tool? })
}

/// `{size: [x, y, z], at}` or `{radius, height, at}`, without a name.
fn stand(d: &mut Decoder, at: &At) -> Option<Shape> {
    let round = d.open_map(at)?.optional("radius").is_some();
    let keys: &[&str] = if round { &["radius", "height", "at"] } else { &["size", "at"] };
    let fields = d.map(at, keys)?;
    if round { cylinder_of(d, &fields) } else { cuboid_of(d, &fields) }
}

fn tool(d: &mut Decoder, at: &At) -> Option<Vec<NamedShape>> {
    let fields = d.map(at, &["boxes", "cylinders"])?;
    let boxes = optional(d, &fields, "boxes", Vec::new(), |d, at| list(d, at, cuboid));
    let cylinders = optional(d, &fields, "cylinders", Vec::new(), |d, at| list(d, at, cylinder));
    Some(boxes?.into_iter().chain(cylinders?).collect())
}

/// `{name, size: [x, y, z], at}`: edges along the axes of `at`, which is its middle.
fn cuboid(d: &mut Decoder, at: &At) -> Option<NamedShape> {
    let fields = d.map(at, &["name", "size", "at"])?;
    let (name, shape) = (name(d, &fields), cuboid_of(d, &fields));
    Some(NamedShape { name: name?, shape: shape? })
}

fn cuboid_of(d: &mut Decoder, fields: &Fields) -> Option<Shape> {
    let size = fields.required("size", d).and_then(|at| {
        let size = d.numbers_in::<3>(&at, -100.0..=100.0, "m")?;
        if size.iter().all(|edge| *edge > 0.0 && *edge <= LONGEST_M) {
            return Some(size);
        }
        d.complain_at(&at, format!("{size:?} is not the size of a box"), "three edges in m, 0 to 20");
        None
    });
    let frame = transform(d, fields, "at");
    Some(Shape::cuboid(size?, &frame?))
}

/// `{name, radius, height, at}`: along the z axis of `at`, which is the middle of its lower face.
fn cylinder(d: &mut Decoder, at: &At) -> Option<NamedShape> {
    let fields = d.map(at, &["name", "radius", "height", "at"])?;
    let (name, shape) = (name(d, &fields), cylinder_of(d, &fields));
    Some(NamedShape { name: name?, shape: shape? })
}

fn cylinder_of(d: &mut Decoder, fields: &Fields) -> Option<Shape> {
    let radius = required_positive(d, fields, "radius", LONGEST_M, "m");
    let height = required_positive(d, fields, "height", LONGEST_M, "m");
    let frame = transform(d, fields, "at");
    Some(Shape::cylinder(radius?, height?, &frame?))
}

/// `{name, point, normal}`: the arm stays on the side that the normal points to.
fn plane(d: &mut Decoder, at: &At) -> Option<NamedShape> {
    let fields = d.map(at, &["name", "point", "normal"])?;
    let name = name(d, &fields);
    let point = fields.required("point", d).and_then(|at| d.numbers_in::<3>(&at, -100.0..=100.0, "m"));
    let normal = fields.required("normal", d).and_then(|at| {
        let normal = d.numbers::<3>(&at)?;
        if normal.iter().map(|part| part * part).sum::<f64>() > 1e-6 {
            return Some(normal);
        }
        d.complain_at(&at, "a normal of no length", "the direction in which the arm may be, base frame");
        None
    });
    Some(NamedShape { name: name?, shape: Shape::half_space(point?, normal?) })
}

/// A name, as sentences use it.
fn name(d: &mut Decoder, fields: &Fields) -> Option<String> {
    let at = fields.required("name", d)?;
    let name = d.text(&at)?;
    if name.trim().is_empty() || name.chars().count() > 40 || name.chars().any(char::is_control) {
        d.complain_at(&at, "not a name", "up to 40 characters, as in: the feeder");
        return None;
    }
    Some(name)
}
