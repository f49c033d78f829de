//! Instance files: design section 4.1 in YAML or JSON, and the public data told apart by their keys.
//!
//! In: text, the name to put into complaints, and a way to look up a named shape (the public data keep
//! polygons in files of their own; this module opens nothing). Out: an [`Instance`], or all complaints at once,
//! each with line and column. Besides the fields, the start arrangement is checked (bad input, design 4.2);
//! a bad goal arrangement is a valid, infeasible task and is checked by whoever must not accept one
//! ([`parse_with_sound_goals`]).

use std::collections::HashMap;

use crate::document::decode::{At, Decoder};
use crate::document::{Complaints, Location, Node, parse};
use crate::geometry::collision::{Placed, TOUCH_M, overhang};
use crate::geometry::pose::Pose2;
use crate::tabletop::decode;
use crate::tabletop::instance::{Instance, KeepOut, ObjectSpec, Workspace};
use crate::tabletop::public_data;

/// Most objects in one instance: every pair of starts is compared.
pub const MAX_OBJECTS: usize = 1000;

/// How a named shape's file is found: the name without `.json`; its text, if there is one.
pub type ShapeLookup<'a> = &'a dyn Fn(&str) -> Option<String>;

/// Parses an instance file of any known format.
///
/// # Errors
/// Every complaint about it.
pub fn parse_instance(text: &str, source: &str, shapes: ShapeLookup) -> Result<Instance, Complaints> {
    read(text, source, shapes, false)
}

/// As [`parse_instance`], for tasks whose goals must be possible: goals that overlap each other, a fixed object,
/// a keep-out region or the table's edge are complaints too.
///
/// # Errors
/// Every complaint about it.
pub fn parse_with_sound_goals(text: &str, source: &str, shapes: ShapeLookup) -> Result<Instance, Complaints> {
    read(text, source, shapes, true)
}

/// Two files that make one task: `start` and `goal` arrangements of the public disc and stick data (object k is
/// the k-th entry of both), or two instance files of ours, where the second one gives goals by name: an object's
/// `goal`, or its `start` if that is all it has.
///
/// # Errors
/// Every complaint about both.
pub fn parse_pair(
    (start_text, start_source): (&str, &str),
    (goal_text, goal_source): (&str, &str),
    shapes: ShapeLookup,
) -> Result<Instance, Complaints> {
    let (start, goal) = (parse(start_text, start_source), parse(goal_text, goal_source));
    let (start, goal) = match (start, goal) {
        (Ok(start), Ok(goal)) => (start, goal),
        (first, second) => {
            let faults = [first.err(), second.err()].into_iter().flatten().flat_map(|faults| faults.0);
            return Err(Complaints(faults.collect()));
        }
    };
    match (public_data::is_arrangement(&start), public_data::is_arrangement(&goal)) {
        (true, true) => public_data::arrangement_pair((&start, start_source), (&goal, goal_source)),
        (false, false) => own_pair((start_text, start_source), (goal_text, goal_source), &goal, shapes),
        _ => {
            let mut decoder = Decoder::new(goal_source);
            let message = "start and goal files are of different kinds";
            decoder.complain(goal.at, "", message, "give two arrangement files or two instance files");
            decoder.finish(None)
        }
    }
}

fn own_pair(
    start: (&str, &str),
    goal: (&str, &str),
    goal_node: &Node,
    shapes: ShapeLookup,
) -> Result<Instance, Complaints> {
    let mut instance = parse_instance(start.0, start.1, shapes)?;
    let goals = parse_instance(goal.0, goal.1, shapes)?;
    let mut decoder = Decoder::new(goal.1);
    for object in &mut instance.objects {
        object.goal = None;
    }
    for wanted in &goals.objects {
        match instance.objects.iter_mut().find(|object| object.id == wanted.id) {
            Some(object) if object.fixed => {}
            Some(object) => object.goal = wanted.goal.or(wanted.start),
            None => {
                let message = format!("object {:?} is not in {}", wanted.id, start.1);
                decoder.complain(goal_node.at, "objects", message, "remove it or correct its name");
            }
        }
    }
    decoder.finish(Some(instance))
}

fn read(text: &str, source: &str, shapes: ShapeLookup, sound_goals: bool) -> Result<Instance, Complaints> {
    let node = parse(text, source)?;
    if public_data::is_arrangement(&node) {
        let mut decoder = Decoder::new(source);
        let help = "a disc or stick task is two files: celld plan START.json --goal GOAL.json";
        decoder.complain(node.at, "", "this is one arrangement, not a task", help);
        return decoder.finish(None);
    }
    let mut decoder = Decoder::new(source);
    let read = if public_data::is_heterogeneous(&node) {
        public_data::heterogeneous(&mut decoder, &node, shapes)
    } else {
        own(&mut decoder, &node)
    };
    if let Some((instance, places)) = &read {
        start_faults(&mut decoder, instance, places);
        if sound_goals {
            goal_faults(&mut decoder, instance, places);
        }
    }
    decoder.finish(read.map(|(instance, _)| instance))
}

/// Where an object's parts stand in the text.
#[derive(Clone, Debug)]
pub(crate) struct Place {
    pub path: String,
    pub start: Location,
    pub goal: Location,
}

fn own(decoder: &mut Decoder, node: &Node) -> Option<(Instance, Vec<Place>)> {
    let before = decoder.count();
    let known = ["workspace", "clearance", "overlap_tolerance", "keep_out", "objects"];
    let fields = decoder.map(&At::top(node), &known)?;
    let workspace = fields.required("workspace", decoder).and_then(|at| workspace(decoder, &at));
    let mut length = |key: &str| match fields.optional(key) {
        Some(at) => decoder.number_in(&at, 0.0..=10.0, "m"),
        None => Some(0.0),
    };
    let clearance = length("clearance");
    let overlap_tolerance = length("overlap_tolerance");
    let keep_out = fields.optional("keep_out").map_or(Some(Vec::new()), |at| regions(decoder, &at));
    let list = fields.required("objects", decoder).and_then(|at| decoder.sequence(&at));
    let items = list.unwrap_or_default();
    if items.len() > MAX_OBJECTS {
        let message = format!("{} objects, at most {MAX_OBJECTS} are read", items.len());
        decoder.complain(node.at, "objects", message, "");
        return None;
    }
    let objects: Vec<Option<ObjectSpec>> = items.iter().map(|item| decode::object(decoder, item)).collect();
    unique_names_and_markers(decoder, &items);
    groups(decoder, &items, &objects);
    fixed_objects(decoder, &items, &objects);
    if decoder.count() > before {
        // The arrangement is checked only when all of it could be read: what is missing would mislead.
        return None;
    }
    let instance = Instance {
        workspace: workspace?,
        clearance: clearance?,
        overlap_tolerance: overlap_tolerance?,
        keep_out: keep_out?,
        objects: objects.into_iter().collect::<Option<_>>()?,
    };
    Some((instance, items.iter().map(place).collect()))
}

fn place(item: &At) -> Place {
    let at = |key: &str| {
        let node = item.node.get(key).or_else(|| item.node.get(&format!("{key}_deg")));
        node.map_or(item.node.at, |node| node.at)
    };
    Place { path: item.path.clone(), start: at("start"), goal: at("goal") }
}

/// A workspace: `{width, height}` in m.
pub fn workspace(decoder: &mut Decoder, at: &At) -> Option<Workspace> {
    let fields = decoder.map(at, &["width", "height"])?;
    let mut length =
        |key: &str| fields.required(key, decoder).and_then(|at| decoder.number_in(&at, 0.01..=100.0, "m"));
    let (width, height) = (length("width"), length("height"));
    Some(Workspace { width: width?, height: height? })
}

fn regions(decoder: &mut Decoder, at: &At) -> Option<Vec<KeepOut>> {
    let items = decoder.sequence(at)?;
    let regions: Vec<Option<KeepOut>> = items.iter().map(|item| decode::keep_out(decoder, item)).collect();
    regions.into_iter().collect()
}

/// Complains about every name or marker number that a second object carries. Works on the tree, so that it
/// finds them in objects that are wrong otherwise.
pub fn unique_names_and_markers(decoder: &mut Decoder, items: &[At]) {
    let mut names: HashMap<String, Location> = HashMap::new();
    let mut markers: HashMap<String, (String, Location)> = HashMap::new();
    for item in items {
        let name = item.node.get("id").and_then(scalar).unwrap_or_default();
        if let Some(node) = item.node.get("id")
            && let Some(first) = names.insert(name.clone(), node.at)
        {
            let message = format!("the name {name:?} is used twice, first in line {}", first.line);
            decoder.complain(node.at, &format!("{}.id", item.path), message, "give each object its own name");
        }
        let Some(node) = item.node.get("marker").and_then(|marker| marker.get("id")) else { continue };
        let Some(number) = scalar(node) else { continue };
        if let Some((owner, first)) = markers.insert(number.clone(), (name, node.at)) {
            let message =
                format!("marker {number} is used twice, first by object {owner:?} in line {}", first.line);
            let path = format!("{}.marker.id", item.path);
            decoder.complain(node.at, &path, message, "give each object a marker of its own");
        }
    }
}

fn scalar(node: &Node) -> Option<String> {
    match &node.value {
        crate::document::tree::Value::Scalar { text, .. } => Some(text.clone()),
        _ => None,
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
        let Some(start) = object.start else {
            decoder.complain(
                item.node.at,
                &item.path,
                "a fixed object has no start",
                "add `start: [x, y, theta]`",
            );
            continue;
        };
        if object.goal.is_some_and(|goal| goal != start) {
            let message = format!("{:?} is fixed, but its goal is not its start", object.id);
            decoder.complain(place(item).goal, &format!("{}.goal", item.path), message, "remove the goal");
        }
    }
}

fn start_faults(decoder: &mut Decoder, instance: &Instance, places: &[Place]) {
    let starts: Vec<Option<Pose2>> = instance.objects.iter().map(|object| object.start).collect();
    let at = |k: usize| (places[k].start, format!("{}.start", places[k].path));
    arrangement_faults(decoder, instance, &starts, &at);
}

fn goal_faults(decoder: &mut Decoder, instance: &Instance, places: &[Place]) {
    let fixed = |object: &ObjectSpec| if object.fixed { object.start } else { object.goal };
    let goals: Vec<Option<Pose2>> = instance.objects.iter().map(fixed).collect();
    let at = |k: usize| (places[k].goal, format!("{}.goal", places[k].path));
    arrangement_faults(decoder, instance, &goals, &at);
}

/// Overlaps beyond the tolerance, each at the later of the two objects.
fn arrangement_faults(
    decoder: &mut Decoder,
    instance: &Instance,
    poses: &[Option<Pose2>],
    place: &dyn Fn(usize) -> (Location, String),
) {
    let limit = instance.overlap_tolerance + TOUCH_M;
    let help = || {
        let tolerated = instance.overlap_tolerance * 1e3;
        format!("move them apart; overlap_tolerance allows {tolerated:.3} mm")
    };
    let placed: Vec<Option<Placed>> = instance
        .objects
        .iter()
        .zip(poses)
        .map(|(object, pose)| pose.map(|pose| Placed::new(&object.footprint, pose)))
        .collect();
    let regions: Vec<Placed> =
        instance.keep_out.iter().map(|region| Placed::new(&region.footprint, region.pose)).collect();
    for (k, object) in instance.objects.iter().enumerate() {
        let (Some(pose), Some(shape)) = (&poses[k], &placed[k]) else { continue };
        let (at, path) = place(k);
        let mut told = |what: String, depth: f64, help: String| {
            if depth > limit {
                decoder.complain(at, &path, format!("{:?} {what} by {:.3} mm", object.id, depth * 1e3), help);
            }
        };
        let Workspace { width, height } = instance.workspace;
        let over = overhang(&object.footprint, pose, width, height);
        told(
            "reaches over the table's edge".to_string(),
            over,
            format!("the table is {width} m x {height} m"),
        );
        for (r, region) in regions.iter().enumerate() {
            told(format!("overlaps keep_out[{r}]"), shape.penetration(region), help());
        }
        for (other, earlier) in instance.objects[..k].iter().zip(&placed) {
            if let Some(earlier) = earlier {
                told(format!("overlaps {:?}", other.id), shape.penetration(earlier), help());
            }
        }
    }
}
