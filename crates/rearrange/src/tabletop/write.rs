//! Instances back to text: YAML for people, JSON for programs; both read back to the same instance.
//!
//! In: an [`Instance`]. Out: the file of design section 4.1, keys with a default left out.

use crate::document::write::Out;
use crate::geometry::footprint::Footprint;
use crate::geometry::polygon::Polygon;
use crate::geometry::pose::Pose2;
use crate::tabletop::instance::{Instance, MarkerSpec, ObjectSpec};

/// The instance as YAML.
pub fn to_yaml(instance: &Instance) -> String {
    tree(instance).to_yaml(3)
}

/// The instance as JSON.
pub fn to_json(instance: &Instance) -> String {
    tree(instance).to_json()
}

fn tree(instance: &Instance) -> Out {
    let workspace = instance.workspace;
    let mut pairs = vec![(
        "workspace",
        Out::map(vec![("width", Out::Number(workspace.width)), ("height", Out::Number(workspace.height))]),
    )];
    if instance.clearance != 0.0 {
        pairs.push(("clearance", Out::Number(instance.clearance)));
    }
    if instance.overlap_tolerance != 0.0 {
        pairs.push(("overlap_tolerance", Out::Number(instance.overlap_tolerance)));
    }
    if !instance.keep_out.is_empty() {
        let regions = instance.keep_out.iter().map(|region| {
            Out::map(vec![("footprint", footprint(&region.footprint)), ("pose", pose(&region.pose))])
        });
        pairs.push(("keep_out", Out::List(regions.collect())));
    }
    pairs.push(("objects", Out::List(instance.objects.iter().map(object).collect())));
    Out::map(pairs)
}

/// One object as in an instance file or a catalogue.
pub fn object(object: &ObjectSpec) -> Out {
    let mut pairs = vec![("id", Out::Text(object.id.clone())), ("footprint", footprint(&object.footprint))];
    let mut push = |key, value: Option<Out>| {
        if let Some(value) = value {
            pairs.push((key, value));
        }
    };
    push("impedance", object.impedance.map(Out::Number));
    push("start", object.start.as_ref().map(pose));
    push("goal", object.goal.as_ref().map(pose));
    push("fixed", object.fixed.then_some(Out::Boolean(true)));
    push("group", object.group.clone().map(Out::Text));
    push("height", object.height.map(Out::Number));
    push("mass", object.mass.map(Out::Number));
    push("marker", object.marker.as_ref().map(marker));
    push("grippable", object.grippable.as_ref().map(points));
    Out::map(pairs)
}

fn marker(marker: &MarkerSpec) -> Out {
    let mut pairs = vec![
        ("family", Out::Text(marker.family.clone())),
        ("id", Out::Integer(i64::from(marker.id))),
        ("size", Out::Number(marker.size)),
    ];
    if marker.offset != Pose2::default() {
        pairs.push(("offset", pose(&marker.offset)));
    }
    Out::map(pairs)
}

/// A footprint as in an instance file.
pub fn footprint(shape: &Footprint) -> Out {
    let lengths = |length: &f64, width: &f64| {
        Out::map(vec![("length", Out::Number(*length)), ("width", Out::Number(*width))])
    };
    match shape {
        Footprint::Rectangle { length, width } => Out::map(vec![("rectangle", lengths(length, width))]),
        Footprint::Ellipse { length, width } => Out::map(vec![("ellipse", lengths(length, width))]),
        Footprint::Disc { radius } => {
            Out::map(vec![("disc", Out::map(vec![("radius", Out::Number(*radius))]))])
        }
        Footprint::Polygon(polygon) => Out::map(vec![("polygon", points(polygon))]),
    }
}

fn points(polygon: &Polygon) -> Out {
    Out::List(polygon.points().iter().map(|point| Out::numbers(point)).collect())
}

fn pose(pose: &Pose2) -> Out {
    Out::numbers(&[pose.x, pose.y, pose.theta])
}
