//! Instance files: design section 4.1 in YAML or JSON, and the public data distinguished by their keys.
//!
//! In: text, the name to put into complaints, and a way to look up a named shape (the public data keep
//! polygons in files of their own; this module opens nothing). Out: an [`Instance`], or all complaints at
//! once, each with line and column. Besides the fields, the start arrangement is checked (bad input, design
//! 4.2); a bad goal arrangement is a valid, infeasible task and is checked by the caller that must not
//! accept one ([`parse_with_sound_goals`]).

use std::collections::HashMap;

use crate::document::decode::{At, Decoder, Fields};
use crate::document::tree::Value;
use crate::document::{Diagnostic, Diagnostics, Location, Node, parse};
use crate::tabletop::arrangement::Place;
use crate::tabletop::decode;
use crate::tabletop::instance::{Instance, ObjectSpec, Workspace};
use crate::tabletop::parts::{Header, MAX_OBJECTS, Parts, ShapeLookup};
use crate::tabletop::public_data;

/// Keys of an instance file.
pub const INSTANCE_KEYS: &[&str] = &["workspace", "clearance", "overlap_tolerance", "keep_out", "objects"];

/// What a file is read for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Role {
    /// A task: every object has a start.
    Task,
    /// A task whose goals must be possible.
    SoundTask,
    /// The second file of a pair: starts may be absent, goals count.
    Goals,
}

/// Parses an instance file of any known format.
///
/// # Errors
/// Every complaint about it.
pub fn parse_instance(text: &str, source: &str, shapes: ShapeLookup) -> Result<Instance, Diagnostics> {
    read(text, source, shapes, Role::Task)
}

/// As [`parse_instance`], for tasks whose goals must be possible: goals that overlap each other, a fixed
/// object, a keep-out region or the table's edge are complaints too.
///
/// # Errors
/// Every complaint about it.
pub fn parse_with_sound_goals(
    text: &str,
    source: &str,
    shapes: ShapeLookup,
) -> Result<Instance, Diagnostics> {
    read(text, source, shapes, Role::SoundTask)
}

/// Two files that make one task: `start` and `goal` arrangements of the public disc and stick data (object k
/// is the k-th entry of both), or two instance files of ours, where the second one gives goals by name: an
/// object's `goal`, or its `start` if that is all it has. Both files are judged, whatever is wrong with the
/// other.
///
/// # Errors
/// Every complaint about both.
pub fn parse_pair(
    (start_text, start_source): (&str, &str),
    (goal_text, goal_source): (&str, &str),
    shapes: ShapeLookup,
) -> Result<Instance, Diagnostics> {
    let (start, goal) = match (parse(start_text, start_source), parse(goal_text, goal_source)) {
        (Ok(start), Ok(goal)) => (start, goal),
        (start, goal) => {
            let mut faults = faults_alone(start, start_source, shapes, Role::Task);
            faults.extend(faults_alone(goal, goal_source, shapes, Role::Goals));
            return Err(Diagnostics(faults));
        }
    };
    match (public_data::is_arrangement(&start), public_data::is_arrangement(&goal)) {
        (true, true) => public_data::arrangement_pair((&start, start_source), (&goal, goal_source)),
        (false, false) => own_pair((&start, start_source), (&goal, goal_source), shapes),
        _ => {
            let mut decoder = Decoder::new(goal_source);
            let message = "start and goal files are of different kinds";
            decoder.complain(goal.at, "", message, "give two arrangement files or two instance files");
            decoder.finish(None)
        }
    }
}

/// What is wrong with one file of a pair whose other file is no document at all.
fn faults_alone(
    node: Result<Node, Diagnostics>,
    source: &str,
    shapes: ShapeLookup,
    role: Role,
) -> Vec<Diagnostic> {
    let node = match node {
        Ok(node) => node,
        Err(faults) => return faults.0,
    };
    if public_data::is_arrangement(&node) {
        return public_data::arrangement_faults(&node, source);
    }
    let mut decoder = Decoder::new(source);
    let parts = parts(&mut decoder, &node, shapes, role);
    decoder.finish(parts).err().map(|faults| faults.0).unwrap_or_default()
}

fn own_pair(
    (start, start_source): (&Node, &str),
    (goal, goal_source): (&Node, &str),
    shapes: ShapeLookup,
) -> Result<Instance, Diagnostics> {
    let (mut of_start, mut of_goal) = (Decoder::new(start_source), Decoder::new(goal_source));
    let start = parts(&mut of_start, start, shapes, Role::Task);
    let goal = parts(&mut of_goal, goal, shapes, Role::Goals);
    if let (Some(start), Some(goal)) = (&start, &goal) {
        let known = |name: &str| start.places.iter().any(|place| place.name.as_deref() == Some(name));
        for place in &goal.places {
            if let Some(name) = place.name.as_deref().filter(|name| !known(name)) {
                let message = format!("object {name:?} is not in {start_source}");
                of_goal.complain(place.at, &place.path, message, "remove it or correct its name");
            }
        }
    }
    let start = of_start.finish(start.and_then(Parts::instance));
    let goal = of_goal.finish(goal.and_then(Parts::instance));
    match (start, goal) {
        (Ok(mut task), Ok(goals)) => {
            for object in &mut task.objects {
                let wanted = goals.objects.iter().find(|wanted| wanted.id == object.id && !object.fixed);
                object.goal = wanted.and_then(|wanted| wanted.goal.or(wanted.start));
            }
            Ok(task)
        }
        (start, goal) => {
            let faults = [start.err(), goal.err()].into_iter().flatten().flat_map(|faults| faults.0);
            Err(Diagnostics(faults.collect()))
        }
    }
}

fn read(text: &str, source: &str, shapes: ShapeLookup, role: Role) -> Result<Instance, Diagnostics> {
    let (node, mut decoder) = Decoder::open(text, source)?;
    let parts = parts(&mut decoder, &node, shapes, role);
    decoder.finish(parts.and_then(Parts::instance))
}

fn parts(decoder: &mut Decoder, node: &Node, shapes: ShapeLookup, role: Role) -> Option<Parts> {
    if public_data::is_arrangement(node) {
        let help = "a disc or stick task is two files: celld plan START.json --goal GOAL.json";
        decoder.complain(node.at, "", "this is one arrangement, not a task", help);
        return None;
    }
    let parts = if public_data::is_heterogeneous(node) {
        public_data::heterogeneous(decoder, node, shapes)
    } else {
        own(decoder, node, role)
    }?;
    parts.layout().start_faults(decoder);
    if role == Role::SoundTask {
        parts.layout().goal_faults(decoder);
    }
    Some(parts)
}

fn own(decoder: &mut Decoder, node: &Node, role: Role) -> Option<Parts> {
    let fields = decoder.map(&At::top(node), INSTANCE_KEYS)?;
    let header = header(decoder, &fields);
    let items = fields.required("objects", decoder).and_then(|at| decoder.sequence(&at))?;
    if items.len() > MAX_OBJECTS {
        let message = format!("{} objects, at most {MAX_OBJECTS} are read", items.len());
        decoder.complain(node.at, "objects", message, "");
        return None;
    }
    let objects: Vec<Option<ObjectSpec>> = items.iter().map(|item| decode::object(decoder, item)).collect();
    unique_names_and_markers(decoder, &items);
    groups(decoder, &items, &objects);
    fixed_objects(decoder, &items, &objects);
    missing_starts(decoder, &items, role);
    Some(Parts { header, objects, places: items.iter().map(Place::of).collect() })
}

/// The keys of an instance besides its objects.
pub fn header(decoder: &mut Decoder, fields: &Fields) -> Header {
    let workspace = fields.required("workspace", decoder).and_then(|at| workspace(decoder, &at));
    let mut length = |key: &str| match fields.optional(key) {
        Some(at) => decoder.number_in(&at, 0.0..=10.0, "m"),
        None => Some(0.0),
    };
    let (clearance, overlap_tolerance) = (length("clearance"), length("overlap_tolerance"));
    let keep_out = match fields.optional("keep_out").map(|at| decoder.sequence(&at)) {
        Some(Some(items)) => items.iter().map(|item| decode::keep_out(decoder, item)).collect(),
        Some(None) => vec![None],
        None => Vec::new(),
    };
    Header { workspace, clearance, overlap_tolerance, keep_out }
}

/// A workspace: `{width, height}` in m.
pub fn workspace(decoder: &mut Decoder, at: &At) -> Option<Workspace> {
    let fields = decoder.map(at, &["width", "height"])?;
    let mut length =
        |key: &str| fields.required(key, decoder).and_then(|at| decoder.number_in(&at, 0.01..=100.0, "m"));
    let (width, height) = (length("width"), length("height"));
    Some(Workspace { width: width?, height: height? })
}

/// Complains about every object of a task without a start, and about fixed ones without in any file. Works
/// on the tree, as [`unique_names_and_markers`].
fn missing_starts(decoder: &mut Decoder, items: &[At], role: Role) {
    for item in items {
        let given = |key: &str| item.node.get(key).is_some_and(|node| !node.is_null());
        let fixed = item.node.get("fixed").and_then(Node::scalar) == Some("true");
        let map = matches!(item.node.value, Value::Map(_));
        if map && (fixed || role != Role::Goals) && !given("start") && !given("start_deg") {
            let help = "add `start: [x, y, theta]` (m, rad) or `start_deg`";
            let message = if fixed { "a fixed object has no start" } else { "the object has no start" };
            decoder.complain(item.node.at, &item.path, message, help);
        }
    }
}

/// Complains about every name or marker number that a second object carries. Works on the tree, so that it
/// finds them in objects that are wrong otherwise. Numbers are compared, not their digits: `07` is 7.
pub fn unique_names_and_markers(decoder: &mut Decoder, items: &[At]) {
    let mut names: HashMap<&str, Location> = HashMap::new();
    let mut markers: HashMap<i64, MarkerUse> = HashMap::new();
    for item in items {
        if let Some(node) = item.node.get("id")
            && let Some(name) = node.scalar()
            && let Some(first) = names.insert(name, node.at)
        {
            let message = format!("the name {name:?} is used twice, first in line {}", first.line);
            decoder.complain(node.at, &format!("{}.id", item.path), message, "give each object its own name");
        }
        let Some(used) = MarkerUse::of(item) else { continue };
        let (number, at) = (used.number, used.at);
        if let Some(first) = markers.insert(number, used) {
            let message = format!(
                "marker {number} is used twice, first by object {:?} in line {}",
                first.owner, first.at.line
            );
            let path = format!("{}.marker.id", item.path);
            decoder.complain(at, &path, message, "give each object a marker of its own");
        }
    }
}

/// A marker number that an object carries, read from the tree alone.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MarkerUse {
    /// The number.
    pub number: i64,
    /// The object's name.
    pub owner: String,
    /// Where the number is.
    pub at: Location,
}

impl MarkerUse {
    /// The marker of an object, if it states a number.
    pub fn of(item: &At) -> Option<MarkerUse> {
        let node = item.node.get("marker")?.get("id")?;
        let number = node.scalar()?.parse().ok()?;
        let owner = item.node.get("id").and_then(Node::scalar).unwrap_or_default().to_owned();
        Some(MarkerUse { number, owner, at: node.at })
    }
}

fn groups(decoder: &mut Decoder, items: &[At], objects: &[Option<ObjectSpec>]) {
    let mut first: HashMap<&str, &ObjectSpec> = HashMap::new();
    for (item, object) in items.iter().zip(objects) {
        let Some(object) = object else { continue };
        let Some(group) = object.group.as_deref() else { continue };
        let leader = *first.entry(group).or_insert(object);
        let at = item.node.get("group").map_or(item.node.at, |node| node.at);
        let mut complain = |what: &str| {
            let message = format!("{:?} and {:?} of group {group:?} differ in {what}", leader.id, object.id);
            let help = "members of a group are interchangeable: same footprint, same impedance, none fixed";
            decoder.complain(at, &format!("{}.group", item.path), message, help);
        };
        if leader.footprint != object.footprint {
            complain("footprint");
        }
        if leader.impedance != object.impedance {
            complain("impedance");
        }
        if object.fixed {
            complain("`fixed`");
        }
    }
}

fn fixed_objects(decoder: &mut Decoder, items: &[At], objects: &[Option<ObjectSpec>]) {
    for (item, object) in items.iter().zip(objects) {
        let Some(object) = object.as_ref().filter(|object| object.fixed) else { continue };
        let Some(start) = object.start else { continue };
        if object.goal.is_some_and(|goal| goal != start) {
            let message = format!("{:?} is fixed, but its goal is not its start", object.id);
            let (at, path) = Place::of(item).goal;
            decoder.complain(at, &path, message, "remove the goal");
        }
    }
}
