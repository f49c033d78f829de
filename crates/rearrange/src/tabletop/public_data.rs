//! Importers for the instances published with the HeTORI and TRLB papers.
//!
//! In: a located tree of one of their JSON files. Out: an [`Instance`] on a table of 1 m (their unit is the
//! millimetre of a 1 m table), with `overlap_tolerance` 0.002 of the width, because their ellipses are
//! inscribed polygons and their arrangements overlap a little for true ones. Formats: one file per
//! heterogeneous task; one file per arrangement of discs or sticks, two of which make a task. Object k of a
//! file is named `<shape>-<k>`. Two of their outlines (the plate and the skillet of YCB1) cross themselves
//! in loops of a few millimetres; such loops are cut off. Impedance is area over the smallest area, 1 for
//! discs and sticks.

use std::collections::HashMap;

use crate::document::decode::{At, Decoder, Fields};
use crate::document::{Diagnostic, Diagnostics, Node, parse};
use crate::geometry::footprint::{Footprint, FootprintFault};
use crate::geometry::polygon::{Point, Polygon, PolygonFault, cross, signed_area, sub};
use crate::geometry::pose::Pose2;
use crate::tabletop::arrangement::Place;
use crate::tabletop::instance::{Instance, ObjectSpec, Workspace};
use crate::tabletop::parts::{Header, MAX_OBJECTS, Parts, ShapeLookup};

/// Their length units in a metre; divided by, not multiplied with the inverse, so that 700 becomes 0.7.
const UNITS_PER_M: f64 = 1000.0;

/// Given overlap taken as it is, share of the workspace width.
const TOLERANCE_SHARE: f64 = 0.002;

/// True for a heterogeneous task file.
pub fn is_heterogeneous(node: &Node) -> bool {
    node.get("object_list").is_some()
}

/// True for one arrangement of discs or sticks.
pub fn is_arrangement(node: &Node) -> bool {
    node.get("point_list").is_some()
}

/// Reads a heterogeneous task.
pub(crate) fn heterogeneous(decoder: &mut Decoder, node: &Node, shapes: ShapeLookup) -> Option<Parts> {
    let known =
        ["Workspace_Density", "Workspace_Height", "Workspace_Width", "number_of_objects", "object_list"];
    let fields = decoder.map(&At::top(node), &known)?;
    let workspace = workspace(decoder, &fields);
    let items = fields.required("object_list", decoder).and_then(|at| limited(decoder, &at));
    check_summary(decoder, &fields, items.as_ref().map(Vec::len));
    let items = items?;
    let mut models = Models { lookup: shapes, known: HashMap::new() };
    let mut objects: Vec<Option<ObjectSpec>> = items
        .iter()
        .enumerate()
        .map(|(k, item)| heterogeneous_object(decoder, item, k, &mut models))
        .collect();
    let areas = objects.iter().flatten().map(|object| object.footprint.area());
    let smallest = areas.fold(f64::INFINITY, f64::min);
    for object in objects.iter_mut().flatten() {
        object.impedance = Some(object.footprint.area() / smallest);
    }
    let places = items.iter().zip(&objects).map(|(item, object)| {
        let at = |key: &str| {
            (item.node.get(key).map_or(item.node.at, |node| node.at), format!("{}.{key}", item.path))
        };
        Place {
            name: object.as_ref().map(|object| object.id.clone()),
            at: item.node.at,
            path: item.path.clone(),
            start: at("initial_pose"),
            goal: at("goal_pose"),
        }
    });
    let places = places.collect();
    Some(Parts { header: header(workspace), objects, places })
}

/// What a file says of itself beside its list. One published file (the desk) states 0 objects and means
/// nothing by it.
fn check_summary(decoder: &mut Decoder, fields: &Fields, listed: Option<usize>) {
    if let Some(at) = fields.optional("Workspace_Density") {
        decoder.number_in(&at, 0.0..=1.0, "of the table");
    }
    let Some(at) = fields.optional("number_of_objects") else { return };
    let stated = decoder.integer(&at, 0..=i64::MAX).and_then(|count| usize::try_from(count).ok());
    if let (Some(stated), Some(listed)) = (stated, listed)
        && stated != 0
        && stated != listed
    {
        let message = format!("{stated} objects are stated, {listed} are listed");
        decoder.complain_at(&at, message, "complete the list, or correct the number");
    }
}

fn header(workspace: Option<Workspace>) -> Header {
    Header {
        workspace,
        clearance: Some(0.0),
        overlap_tolerance: workspace.map(|workspace| TOLERANCE_SHARE * workspace.width),
        keep_out: Vec::new(),
    }
}

fn instance(workspace: Workspace, objects: Vec<ObjectSpec>) -> Instance {
    Instance {
        workspace,
        clearance: 0.0,
        overlap_tolerance: TOLERANCE_SHARE * workspace.width,
        keep_out: Vec::new(),
        objects,
    }
}

fn workspace(decoder: &mut Decoder, fields: &Fields) -> Option<Workspace> {
    let mut length = |key: &str| {
        let at = fields.required(key, decoder)?;
        decoder.number_in(&at, 1.0..=100_000.0, "mm").map(|length| length / UNITS_PER_M)
    };
    let (width, height) = (length("Workspace_Width"), length("Workspace_Height"));
    Some(Workspace { width: width?, height: height? })
}

fn limited<'n>(decoder: &mut Decoder, at: &At<'n>) -> Option<Vec<At<'n>>> {
    let items = decoder.sequence(at)?;
    if items.len() > MAX_OBJECTS {
        decoder.complain_at(at, format!("{} objects, at most {MAX_OBJECTS} are read", items.len()), "");
        return None;
    }
    Some(items)
}

fn heterogeneous_object(
    decoder: &mut Decoder,
    item: &At,
    k: usize,
    models: &mut Models,
) -> Option<ObjectSpec> {
    let known = ["Object_Shape", "Object_Length", "Object_Width", "initial_pose", "goal_pose"];
    let fields = decoder.map(item, &known)?;
    let shape_at = fields.required("Object_Shape", decoder);
    let shape = shape_at.as_ref().and_then(|at| decoder.text(at));
    let mut number = |key: &str| fields.required(key, decoder).and_then(|at| decoder.positive(&at, "mm"));
    let (length, width) = (number("Object_Length"), number("Object_Width"));
    let mut pose = |key: &str| {
        let at = fields.required(key, decoder)?;
        decoder.numbers::<3>(&at).map(|[x, y, theta]| Pose2::new(x / UNITS_PER_M, y / UNITS_PER_M, theta))
    };
    let (start, goal) = (pose("initial_pose"), pose("goal_pose"));
    let (shape_at, shape, length, width) = (shape_at?, shape?, length? / UNITS_PER_M, width? / UNITS_PER_M);
    let (word, footprint) = match shape.as_str() {
        "cuboid" => ("rectangle", Footprint::rectangle(length, width)),
        "disc" => ("ellipse", Footprint::ellipse(length, width)),
        name => {
            let points = models.points(decoder, &shape_at, name)?;
            let scaled: Vec<Point> = points.iter().map(|p| [p[0] * length, p[1] * width]).collect();
            (name, Footprint::polygon(&untangled(scaled)))
        }
    };
    let mut object = ObjectSpec::new(format!("{word}-{k}"), accepted(decoder, item, footprint)?);
    object.start = Some(start?);
    object.goal = Some(goal?);
    Some(object)
}

fn accepted(decoder: &mut Decoder, at: &At, shape: Result<Footprint, FootprintFault>) -> Option<Footprint> {
    match shape {
        Ok(shape) => Some(shape),
        Err(fault) => {
            decoder.complain_at(at, fault.to_string(), "");
            None
        }
    }
}

/// Cuts off the smaller loop wherever an outline crosses itself, and spikes. Gives up (and leaves the
/// complaint to the polygon's own check) when more than 2 % of the area would go.
fn untangled(points: Vec<Point>) -> Vec<Point> {
    let wanted = signed_area(&points).abs();
    let mut trial = points.clone();
    for _ in 0..points.len() {
        match Polygon::new(&trial) {
            Err(PolygonFault::SelfCrossing(i, j)) => trial = without_loop(&trial, i, j),
            Err(PolygonFault::Coincident(i, _)) => drop(trial.remove(i)),
            _ => break,
        }
    }
    if (signed_area(&trial).abs() - wanted).abs() <= 0.02 * wanted { trial } else { points }
}

/// The outline without the smaller of the two loops that the crossing edges from `i` and `j` (i < j) make.
fn without_loop(points: &[Point], i: usize, j: usize) -> Vec<Point> {
    let n = points.len();
    let (a, b, c, d) = (points[i], points[(i + 1) % n], points[j], points[(j + 1) % n]);
    let (u, v) = (sub(b, a), sub(d, c));
    let spread = cross(u, v);
    let share = if spread.abs() > 0.0 { (cross(sub(c, a), v) / spread).clamp(0.0, 1.0) } else { 1.0 };
    let meeting = [a[0] + share * u[0], a[1] + share * u[1]];
    let mut inner = vec![meeting];
    inner.extend_from_slice(&points[i + 1..=j]);
    let mut outer = vec![meeting];
    outer.extend((j + 1..n + i + 1).map(|k| points[k % n]));
    if signed_area(&inner).abs() < signed_area(&outer).abs() { outer } else { inner }
}

/// Named polygons, read once each.
struct Models<'a> {
    lookup: ShapeLookup<'a>,
    known: HashMap<String, Option<Vec<Point>>>,
}

impl Models<'_> {
    fn points(&mut self, decoder: &mut Decoder, at: &At, name: &str) -> Option<Vec<Point>> {
        if let Some(known) = self.known.get(name) {
            return known.clone();
        }
        let plain =
            !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-');
        let points = match plain.then(|| (self.lookup)(name)).flatten() {
            Some(text) => shape_points(decoder, at, name, &text),
            None => {
                let help = format!("give the folder that holds {name}.json with --shapes DIR");
                decoder.complain_at(at, format!("the shape {name:?} is not known"), help);
                None
            }
        };
        self.known.insert(name.to_string(), points.clone());
        points
    }
}

fn shape_points(decoder: &mut Decoder, at: &At, name: &str, text: &str) -> Option<Vec<Point>> {
    let source = format!("{name}.json");
    let node = match parse(text, &source) {
        Ok(node) => node,
        Err(faults) => {
            decoder.complain_at(at, format!("its shape file cannot be read: {faults}"), "");
            return None;
        }
    };
    let mut inner = Decoder::new(source);
    let points = inner.map(&At::top(&node), &["center", "radius", "points"]).and_then(|fields| {
        let list = fields.required("points", &mut inner).and_then(|at| inner.sequence(&at))?;
        let points: Vec<Option<Point>> = list.iter().map(|item| inner.numbers::<2>(item)).collect();
        points.into_iter().collect::<Option<Vec<Point>>>()
    });
    match inner.finish(points) {
        Ok(points) => Some(points),
        Err(faults) => {
            decoder.complain_at(at, format!("its shape file cannot be read: {faults}"), "");
            None
        }
    }
}

struct Arrangement {
    workspace: Workspace,
    word: &'static str,
    footprint: Footprint,
    poses: Vec<Pose2>,
}

impl Arrangement {
    fn object(&self, k: usize) -> ObjectSpec {
        let mut object = ObjectSpec::new(format!("{}-{k}", self.word), self.footprint.clone());
        object.impedance = Some(1.0);
        object
    }
}

/// Two arrangements of discs or sticks make a task: object k is the k-th entry of both.
pub(crate) fn arrangement_pair(
    (start, start_source): (&Node, &str),
    (goal, goal_source): (&Node, &str),
) -> Result<Instance, Diagnostics> {
    let (start, wanted) =
        match (arrangement(start, start_source, true), arrangement(goal, goal_source, false)) {
            (Ok(start), Ok(wanted)) => (start, wanted),
            (start, wanted) => {
                let faults = [start.err(), wanted.err()].into_iter().flatten().flat_map(|faults| faults.0);
                return Err(Diagnostics(faults.collect()));
            }
        };
    let mut decoder = Decoder::new(goal_source);
    if start.footprint != wanted.footprint || start.workspace != wanted.workspace {
        let message = format!("its workspace or object size differs from that of {start_source}");
        decoder.complain(goal.at, "", message, "take two files of one folder");
    }
    if start.poses.len() != wanted.poses.len() {
        let message = format!("{} objects, {start_source} has {}", wanted.poses.len(), start.poses.len());
        decoder.complain(goal.at, "point_list", message, "take two files of one folder");
    }
    let poses = start.poses.iter().zip(&wanted.poses).enumerate();
    let objects = poses
        .map(|(k, (from, to))| ObjectSpec { start: Some(*from), goal: Some(*to), ..start.object(k) })
        .collect();
    decoder.finish(Some(instance(start.workspace, objects)))
}

/// What is wrong with one arrangement by itself.
pub(crate) fn arrangement_faults(node: &Node, source: &str) -> Vec<Diagnostic> {
    arrangement(node, source, false).err().map(|faults| faults.0).unwrap_or_default()
}

/// One arrangement; a start must be possible, an impossible goal is a valid task without a solution.
fn arrangement(node: &Node, source: &str, is_start: bool) -> Result<Arrangement, Diagnostics> {
    let mut decoder = Decoder::new(source);
    let read = read_arrangement(&mut decoder, node, is_start);
    decoder.finish(read)
}

fn read_arrangement(decoder: &mut Decoder, node: &Node, is_start: bool) -> Option<Arrangement> {
    let known = [
        "Object_Radius",
        "Object_Length",
        "Object_Width",
        "Object_Shape",
        "Workspace_Density",
        "Workspace_Height",
        "Workspace_Width",
        "number_of_objects",
        "point_list",
    ];
    let fields = decoder.map(&At::top(node), &known)?;
    let workspace = workspace(decoder, &fields);
    let items = fields.required("point_list", decoder).and_then(|at| limited(decoder, &at));
    check_summary(decoder, &fields, items.as_ref().map(Vec::len));
    let shape_at = fields.required("Object_Shape", decoder)?;
    let sticks = decoder.choice(&shape_at, &[("disc", false), ("cuboid", true)])?;
    let footprint = listed_shape(decoder, &fields, &shape_at, sticks);
    let items = items?;
    let poses: Vec<Option<Pose2>> = items.iter().map(|item| listed_pose(decoder, item, sticks)).collect();
    let word = if sticks { "stick" } else { "disc" };
    if let (true, Some(footprint)) = (is_start, &footprint) {
        check_starts(decoder, workspace, (word, footprint), &items, &poses);
    }
    let poses = poses.into_iter().collect::<Option<_>>()?;
    Some(Arrangement { workspace: workspace?, word, footprint: footprint?, poses })
}

/// The one shape of all objects of an arrangement.
fn listed_shape(decoder: &mut Decoder, fields: &Fields, at: &At, sticks: bool) -> Option<Footprint> {
    let mut number = |key: &str| {
        let length = fields.required(key, decoder).and_then(|at| decoder.positive(&at, "mm"));
        length.map(|length| length / UNITS_PER_M)
    };
    let shape = if sticks {
        let (length, width) = (number("Object_Length"), number("Object_Width"));
        Footprint::rectangle(length?, width?)
    } else {
        Footprint::disc(number("Object_Radius")?)
    };
    accepted(decoder, at, shape)
}

/// An entry of `point_list`: x and y, of sticks also the angle.
fn listed_pose(decoder: &mut Decoder, item: &At, sticks: bool) -> Option<Pose2> {
    let [x, y, theta] = if sticks {
        decoder.numbers::<3>(item)?
    } else {
        let [x, y] = decoder.numbers::<2>(item)?;
        [x, y, 0.0]
    };
    Some(Pose2::new(x / UNITS_PER_M, y / UNITS_PER_M, theta))
}

fn check_starts(
    decoder: &mut Decoder,
    workspace: Option<Workspace>,
    (word, footprint): (&str, &Footprint),
    items: &[At],
    poses: &[Option<Pose2>],
) {
    let object = |(k, pose): (usize, &Option<Pose2>)| {
        let object = ObjectSpec::new(format!("{word}-{k}"), footprint.clone());
        pose.map(|pose| ObjectSpec { start: Some(pose), ..object })
    };
    let place = |item: &At| Place {
        name: None,
        at: item.node.at,
        path: item.path.clone(),
        start: (item.node.at, item.path.clone()),
        goal: (item.node.at, item.path.clone()),
    };
    let objects = poses.iter().enumerate().map(object).collect();
    let places = items.iter().map(place).collect();
    Parts { header: header(workspace), objects, places }.layout().start_faults(decoder);
}
