//! Objects, footprints and regions out of a document tree: shared by instance files, jobs and configuration.
//!
//! In: a located tree and a decoder that collects complaints. Out: the structs of `tabletop::instance`, or
//! `None` with at least one complaint kept. Every field of design section 4.1 is read here and nowhere else.

use crate::document::decode::{At, Decoder, Fields};
use crate::geometry::footprint::{Footprint, FootprintFault};
use crate::geometry::polygon::{Point, Polygon, PolygonFault};
use crate::geometry::pose::Pose2;
use crate::tabletop::instance::{KeepOut, MarkerSpec, ObjectSpec};
use std::ops::RangeInclusive;

/// Keys of an object, for the check of unknown ones.
pub const OBJECT_KEYS: &[&str] = &[
    "id",
    "footprint",
    "impedance",
    "start",
    "start_deg",
    "goal",
    "goal_deg",
    "fixed",
    "group",
    "height",
    "mass",
    "marker",
    "grippable",
];

/// Coordinates beyond this are a mistake (usually millimetres), m.
const FAR_M: f64 = 1000.0;

/// Lengths of objects, m: what is beyond is in another unit.
const LENGTHS_M: RangeInclusive<f64> = 1e-6..=100.0;

/// Numbers of the marker family tag36h11.
const LAST_TAG36H11: i64 = 586;

/// An object with any of [`OBJECT_KEYS`].
pub fn object(decoder: &mut Decoder, at: &At) -> Option<ObjectSpec> {
    let fields = decoder.map(at, OBJECT_KEYS)?;
    let id = fields.required("id", decoder).and_then(|at| identifier(decoder, &at));
    let shape = fields.required("footprint", decoder).and_then(|at| footprint(decoder, &at));
    let start = pose(decoder, &fields, "start");
    let goal = pose(decoder, &fields, "goal");
    let mut positive = |key: &str, range: RangeInclusive<f64>, unit: &str| match fields.optional(key) {
        Some(at) => decoder.positive(&at, unit).and_then(|_| decoder.number_in(&at, range, unit)).map(Some),
        None => Some(None),
    };
    let impedance = positive("impedance", 1e-9..=1e9, "");
    let height = positive("height", LENGTHS_M, "m");
    let mass = positive("mass", 1e-6..=1e4, "kg");
    let fixed = fields.optional("fixed").map_or(Some(false), |at| decoder.boolean(&at));
    let group = optional(fields.optional("group"), |at| identifier(decoder, at));
    let marker = optional(fields.optional("marker"), |at| marker(decoder, at));
    let grippable = optional(fields.optional("grippable"), |at| polygon(decoder, at));
    Some(ObjectSpec {
        id: id?,
        footprint: shape?,
        impedance: impedance?,
        start: start?,
        goal: goal?,
        fixed: fixed?,
        group: group?,
        height: height?,
        mass: mass?,
        marker: marker?,
        grippable: grippable?,
    })
}

fn optional<'n, T>(at: Option<At<'n>>, read: impl FnOnce(&At<'n>) -> Option<T>) -> Option<Option<T>> {
    match at {
        Some(at) => read(&at).map(Some),
        None => Some(None),
    }
}

/// A name: not empty, at most 64 characters, nothing that breaks lines or file names.
pub fn identifier(decoder: &mut Decoder, at: &At) -> Option<String> {
    let text = decoder.text(at)?;
    let allowed = |c: char| c.is_alphanumeric() || matches!(c, '-' | '_' | '.' | ' ' | ':' | '+');
    if text.trim().is_empty() || text.chars().count() > 64 || !text.chars().all(allowed) {
        let help = "use 1 to 64 letters, digits, spaces and - _ . : +";
        decoder.complain_at(at, format!("{text:?} is no usable name"), help);
        return None;
    }
    Some(text)
}

/// A pose under `key` or `key_deg`; the inner `None` when neither is there.
pub fn pose(decoder: &mut Decoder, fields: &Fields, key: &str) -> Option<Option<Pose2>> {
    let Some([x, y, theta]) = decoder.pose(fields, key)? else { return Some(None) };
    if x.abs() > FAR_M || y.abs() > FAR_M || theta.abs() > FAR_M {
        let at = fields.optional(key).or_else(|| fields.optional(&format!("{key}_deg")))?;
        decoder.complain_at(&at, format!("{x} m, {y} m, {theta} rad is out of range"), "lengths are in m");
        return None;
    }
    Some(Some(Pose2::new(x, y, theta)))
}

/// A pose that has to be there.
pub fn required_pose(decoder: &mut Decoder, fields: &Fields, key: &str) -> Option<Pose2> {
    let found = pose(decoder, fields, key)?;
    if found.is_none() {
        let help = format!("add `{key}: [x, y, theta]` (m, rad) or `{key}_deg`");
        decoder.complain(fields.at(), fields.path(), format!("key {key:?} is missing"), help);
    }
    found
}

/// A footprint: one of the four shapes, or a bare list of points.
pub fn footprint(decoder: &mut Decoder, at: &At) -> Option<Footprint> {
    if matches!(at.node.value, crate::document::tree::Value::Sequence(_)) {
        return polygon(decoder, at).map(Footprint::Polygon);
    }
    const SHAPES: &[&str] = &["rectangle", "disc", "ellipse", "polygon"];
    let fields = decoder.map(at, SHAPES)?;
    let mut given = SHAPES.iter().filter_map(|shape| fields.optional(shape).map(|at| (*shape, at)));
    let (Some((shape, inner)), None) = (given.next(), given.next()) else {
        let unknown = fields.keys().any(|(key, _)| !SHAPES.contains(&key));
        if !unknown {
            let message = "a footprint has exactly one of rectangle, disc, ellipse, polygon";
            decoder.complain_at(at, message, "keep one shape");
        }
        return None;
    };
    match shape {
        "rectangle" | "ellipse" => {
            let fields = decoder.map(&inner, &["length", "width"])?;
            let length = length_of(decoder, &fields, "length");
            let width = length_of(decoder, &fields, "width");
            let build = if shape == "ellipse" { Footprint::ellipse } else { Footprint::rectangle };
            checked(decoder, &inner, build(length?, width?))
        }
        "disc" => {
            let fields = decoder.map(&inner, &["radius"])?;
            let radius = length_of(decoder, &fields, "radius")?;
            checked(decoder, &inner, Footprint::disc(radius))
        }
        _ => polygon(decoder, &inner).map(Footprint::Polygon),
    }
}

fn length_of(decoder: &mut Decoder, fields: &Fields, key: &str) -> Option<f64> {
    let at = fields.required(key, decoder)?;
    let value = decoder.positive(&at, "m")?;
    if !LENGTHS_M.contains(&value) {
        decoder.complain_at(&at, format!("{value} m is out of range"), "lengths are in m");
        return None;
    }
    Some(value)
}

fn checked(decoder: &mut Decoder, at: &At, shape: Result<Footprint, FootprintFault>) -> Option<Footprint> {
    match shape {
        Ok(shape) => Some(shape),
        Err(fault) => {
            decoder.complain_at(at, fault.to_string(), "lengths are in m");
            None
        }
    }
}

/// A simple polygon from a list of points; a fault is reported at the point where it is.
pub fn polygon(decoder: &mut Decoder, at: &At) -> Option<Polygon> {
    let items = decoder.sequence(at)?;
    if items.len() > 2000 {
        decoder.complain_at(
            at,
            format!("{} points, at most 2000 are read", items.len()),
            "simplify the outline",
        );
        return None;
    }
    let points: Vec<Option<Point>> = items.iter().map(|item| decoder.numbers::<2>(item)).collect();
    let mut points: Vec<Point> = points.into_iter().collect::<Option<_>>()?;
    if let Some(k) = points.iter().position(|p| p[0].abs() > 100.0 || p[1].abs() > 100.0) {
        decoder.complain_at(&items[k], "a corner more than 100 m from the origin", "lengths are in m");
        return None;
    }
    // Closing an outline by repeating its first point is common and means nothing.
    if points.len() > 3 && points.first() == points.last() {
        points.pop();
    }
    match Polygon::new(&points) {
        Ok(polygon) => Some(polygon),
        Err(fault) => {
            let (place, help) = match &fault {
                PolygonFault::NotFinite(k) | PolygonFault::Coincident(_, k) => {
                    (items.get(*k), "leave one out")
                }
                PolygonFault::SelfCrossing(_, k) => {
                    (items.get(*k), "reorder the points so that the outline does not meet itself")
                }
                PolygonFault::TooFewPoints(_) | PolygonFault::NoArea | PolygonFault::NoParts => {
                    (None, "give the corners of a simple polygon")
                }
            };
            decoder.complain_at(place.unwrap_or(at), fault.to_string(), help);
            None
        }
    }
}

fn marker(decoder: &mut Decoder, at: &At) -> Option<MarkerSpec> {
    let fields = decoder.map(at, &["family", "id", "size", "offset", "offset_deg"])?;
    let family = match fields.optional("family") {
        Some(at) => decoder.choice(&at, &[("tag36h11", "tag36h11")]),
        None => Some("tag36h11"),
    };
    let id = fields.required("id", decoder).and_then(|at| decoder.integer(&at, 0..=LAST_TAG36H11));
    let size = fields.required("size", decoder).and_then(|at| decoder.number_in(&at, 0.001..=1.0, "m"));
    let offset = pose(decoder, &fields, "offset");
    Some(MarkerSpec {
        family: family?.to_string(),
        id: u32::try_from(id?).ok()?,
        size: size?,
        offset: offset?.unwrap_or_default(),
    })
}

/// A keep-out region.
pub fn keep_out(decoder: &mut Decoder, at: &At) -> Option<KeepOut> {
    let fields = decoder.map(at, &["footprint", "pose", "pose_deg"])?;
    let footprint = fields.required("footprint", decoder).and_then(|at| footprint(decoder, &at));
    let pose = required_pose(decoder, &fields, "pose");
    Some(KeepOut { footprint: footprint?, pose: pose? })
}
