//! What no single key can tell: whether the parts of a cell's configuration fit each other.
//!
//! In: a configuration whose keys are all sound, and where the keys stand. Out: complaints in the decoder.
//! Pure.

use crate::config::cell::{
    CameraDevice, CellConfig, CupChannel, CupConfig, Devices, GripperConfig, MotionLimits,
    ReferenceMarkerConfig,
};
use crate::document::Location;
use crate::document::decode::Decoder;
use crate::document::tree::{Node, Value};
use crate::geometry::footprint::Footprint;
use crate::geometry::pose::Pose2;
use crate::tabletop::instance::ObjectSpec;
use crate::units::{GRAVITY, Joints, deg_from_rad, mm_from_m};
use std::net::IpAddr;

/// Space that every cup keeps to the rim of the face it sits on, m.
pub const CUP_MARGIN_M: f64 = 0.001;

/// Holding force over load at rest, and while the arm accelerates (design, section 4.4).
const FACTOR_AT_REST: f64 = 2.0;
const FACTOR_ACCELERATING: f64 = 4.0;

/// Least number of places tried along each side of an object when looking for a grip.
const GRIP_STEPS: usize = 24;

/// Angles tried between 0 and a half turn.
const ANGLES: usize = 36;

/// Finds the place of a key in the text, for complaints about values that were read long ago.
pub(super) struct Places<'n> {
    top: &'n Node,
}

impl<'n> Places<'n> {
    pub(super) fn new(top: &'n Node) -> Places<'n> {
        Places { top }
    }

    /// Place of `keys` inside each other; of the innermost that is there.
    fn at(&self, keys: &[&str]) -> Location {
        let mut node = self.top;
        for key in keys {
            let inner = match key.parse::<usize>() {
                Ok(index) => item(node, index),
                Err(_) => node.get(key),
            };
            let Some(inner) = inner else { break };
            node = inner;
        }
        node.at
    }
}

fn item(node: &Node, index: usize) -> Option<&Node> {
    match &node.value {
        Value::Sequence(items) => items.get(index),
        Value::Map(_) | Value::Scalar { .. } => None,
    }
}

/// Complains about everything that does not fit.
pub(super) fn check_cell(decoder: &mut Decoder, cell: &CellConfig, places: &Places) {
    check_simulation(decoder, cell, places);
    check_poses(decoder, cell, places);
    check_limits(decoder, &cell.limits, places);
    check_reference_markers(decoder, &cell.reference_markers, &cell.objects, places);
    for (index, object) in cell.objects.iter().enumerate() {
        let at = places.at(&["objects", &index.to_string()]);
        check_object(decoder, cell, object, at, &format!("objects[{index}]"));
    }
}

fn check_simulation(decoder: &mut Decoder, cell: &CellConfig, places: &Places) {
    if cell.simulation.is_none() {
        if cell.arm_at_start {
            let message = "only a simulated cell may be armed at start: a person arms a real one";
            let help = "remove the key, and arm with `celld arm`";
            decoder.complain(places.at(&["arm_at_start"]), "arm_at_start", message, help);
        }
        return;
    }
    for (name, host) in hosts(&cell.devices) {
        if !is_loopback(host) {
            let message = format!("the {name} is at {host:?}, which is not this machine");
            let help = "remove `simulation`: its clock would run past a real device's deadlines";
            decoder.complain(places.at(&["simulation"]), "simulation", message, help);
        }
    }
}

fn hosts(devices: &Devices) -> Vec<(&'static str, &str)> {
    let mut hosts = vec![("robot", devices.robot_host.as_str()), ("gripper", devices.gripper_host.as_str())];
    match &devices.camera {
        CameraDevice::Simulator { host, .. } => hosts.push(("camera", host)),
        CameraDevice::Folder { .. } | CameraDevice::Video { .. } => {}
    }
    hosts
}

/// True for this machine's own addresses. Names other than `localhost` are not looked up: an answer may change.
pub fn is_loopback(host: &str) -> bool {
    host == "localhost" || host.parse::<IpAddr>().is_ok_and(|address| address.is_loopback())
}

fn check_poses(decoder: &mut Decoder, cell: &CellConfig, places: &Places) {
    if cell.look_poses.is_empty() {
        let help = "teach joint poses that together see the whole workspace";
        decoder.complain(places.at(&["look_poses_deg"]), "look_poses_deg", "no look pose is given", help);
    }
    let lists = [("look_poses_deg", &cell.look_poses), ("calibration_poses_deg", &cell.calibration_poses)];
    for (key, poses) in lists {
        for (index, pose) in poses.iter().enumerate() {
            let at = places.at(&[key, &index.to_string()]);
            check_range(decoder, &cell.limits, pose, at, &format!("{key}[{index}]"));
        }
    }
    check_range(decoder, &cell.limits, &cell.park_pose, places.at(&["park_pose_deg"]), "park_pose_deg");
    check_range(decoder, &cell.limits, &cell.work_pose, places.at(&["work_pose_deg"]), "work_pose_deg");
}

fn check_range(decoder: &mut Decoder, limits: &MotionLimits, pose: &Joints, at: Location, path: &str) {
    for (joint, (q, (low, high))) in pose.0.iter().zip(&limits.joint_range).enumerate() {
        if !(*low..=*high).contains(q) {
            let message = format!(
                "joint {} at {:.1} degrees is outside its range of {:.1} to {:.1}",
                joint + 1,
                deg_from_rad(*q),
                deg_from_rad(*low),
                deg_from_rad(*high)
            );
            decoder.complain(at, path, message, "teach another pose, or widen limits.joint_range_deg");
        }
    }
}

fn check_limits(decoder: &mut Decoder, limits: &MotionLimits, places: &Places) {
    if limits.blend_m > limits.lift_height_m {
        let message = format!(
            "a blend radius of {} m rounds the corner of a lift of {} m off",
            limits.blend_m, limits.lift_height_m
        );
        let at = places.at(&["limits", "blend_m"]);
        decoder.complain(at, "limits.blend_m", message, "make it smaller than limits.lift_height_m");
    }
}

fn check_reference_markers(
    decoder: &mut Decoder,
    markers: &[ReferenceMarkerConfig],
    objects: &[ObjectSpec],
    places: &Places,
) {
    for (index, marker) in markers.iter().enumerate() {
        let at = places.at(&["reference_markers", &index.to_string()]);
        let path = format!("reference_markers[{index}].id");
        if markers.iter().take(index).any(|other| other.id == marker.id) {
            let message = format!("marker {} is used twice", marker.id);
            decoder.complain(at, &path, message, "give each place a marker of its own");
        }
        let owner = objects.iter().find(|o| o.marker.as_ref().is_some_and(|m| m.id == marker.id));
        if let Some(owner) = owner {
            let message = format!("marker {} is also that of object {:?}", marker.id, owner.id);
            decoder.complain(at, &path, message, "give one of them another marker");
        }
    }
}

fn check_object(decoder: &mut Decoder, cell: &CellConfig, object: &ObjectSpec, at: Location, path: &str) {
    let (width, height) = (cell.workspace.width_m, cell.workspace.height_m);
    if !fits_table(&object.footprint, width, height) {
        let message =
            format!("{:?} is larger than the table of {width} m x {height} m at any angle", object.id);
        decoder.complain(at, path, message, "lengths are in m; check footprint and workspace");
        return;
    }
    check_marker(decoder, object, at, path);
    if object.fixed {
        if object.start.is_none() {
            let message = format!("{:?} is fixed, but the cell is not told where it stands", object.id);
            decoder.complain(at, path, message, "add start: [x, y, theta], its surveyed pose in m, m, rad");
        }
        return;
    }
    let face = match &object.grippable {
        Some(polygon) => Footprint::Polygon(polygon.clone()),
        None => object.footprint.clone(),
    };
    let usable: Vec<Vec<CupConfig>> =
        channel_sets(&cell.gripper).into_iter().filter(|cups| sits_on(cups, &face)).collect();
    if usable.is_empty() {
        let message = format!(
            "no place on {:?} takes all cups of channel A, of B or of both with {:.0} mm to spare",
            object.id,
            mm_from_m(CUP_MARGIN_M)
        );
        decoder.complain(at, path, message, "use smaller cups or fewer of them, or give another `grippable`");
        return;
    }
    check_weight(decoder, cell, object, &usable, at, path);
}

fn check_weight(
    decoder: &mut Decoder,
    cell: &CellConfig,
    object: &ObjectSpec,
    usable: &[Vec<CupConfig>],
    at: Location,
    path: &str,
) {
    let Some(mass_kg) = object.mass else { return };
    let most = usable.iter().map(|cups| cell.gripper.holding_force_n(cups)).fold(0.0, f64::max);
    let needed = needed_force_n(mass_kg, &cell.limits);
    if most < needed {
        let message = format!(
            "{:?} weighs {mass_kg} kg: carrying it safely takes {needed:.1} N, its cups hold {most:.1} N at vacuum_min",
            object.id
        );
        decoder.complain(at, path, message, "use larger or more cups, or a higher vacuum_min");
    }
}

/// Force of the cups (N) that carrying `mass_kg` safely takes: the larger of what rest and acceleration ask for.
pub fn needed_force_n(mass_kg: f64, limits: &MotionLimits) -> f64 {
    let at_rest = FACTOR_AT_REST * mass_kg * GRAVITY;
    at_rest.max(FACTOR_ACCELERATING * mass_kg * (GRAVITY + limits.tool_acceleration))
}

/// The marker's print (black square and white ring, 10/8 of the edge) has to lie on the object.
fn check_marker(decoder: &mut Decoder, object: &ObjectSpec, at: Location, path: &str) {
    let Some(marker) = &object.marker else { return };
    let half = marker.size * 10.0 / 8.0 / 2.0;
    let corners = [[-half, -half], [half, -half], [half, half], [-half, half]];
    // A hair of tolerance, so that a print exactly as wide as the object is fine.
    let inside = |corner: [f64; 2]| {
        let inward = [corner[0] * (1.0 - 1e-6), corner[1] * (1.0 - 1e-6)];
        object.footprint.contains_point(marker.offset.transform(inward), 0.0)
    };
    if !corners.into_iter().all(inside) {
        let message = format!(
            "the marker of {:?} with its white ring is {:.1} mm wide and sticks out over the object",
            object.id,
            mm_from_m(2.0 * half)
        );
        decoder.complain(at, path, message, "use a smaller marker, or correct its offset");
    }
}

fn fits_table(footprint: &Footprint, width: f64, height: f64) -> bool {
    half_turn().any(|theta| {
        let (low, high) = footprint.bounds(&Pose2::new(0.0, 0.0, theta));
        high[0] - low[0] <= width + 1e-9 && high[1] - low[1] <= height + 1e-9
    })
}

fn half_turn() -> impl Iterator<Item = f64> {
    (0..ANGLES).map(|k| std::f64::consts::PI * k as f64 / ANGLES as f64)
}

/// Cups that suck together: those of A, of B, of both.
fn channel_sets(gripper: &GripperConfig) -> Vec<Vec<CupConfig>> {
    let of = |wanted: &[CupChannel]| -> Vec<CupConfig> {
        gripper.cups.iter().copied().filter(|cup| wanted.contains(&cup.channel)).collect()
    };
    let mut sets = vec![of(&[CupChannel::A]), of(&[CupChannel::B]), of(&[CupChannel::A, CupChannel::B])];
    sets.retain(|cups| !cups.is_empty());
    sets.dedup();
    sets
}

/// True when some pose of the cups puts them all on the face, each with its margin. Poses are tried on a
/// grid: a face that only just takes the cups may be refused, never the other way round.
fn sits_on(cups: &[CupConfig], face: &Footprint) -> bool {
    let (low, high) = face.bounds(&Pose2::default());
    let step = |axis: usize, k: usize| low[axis] + (high[axis] - low[axis]) * k as f64 / GRIP_STEPS as f64;
    let centre = face.centroid();
    let grid = (0..=GRIP_STEPS).flat_map(|i| (0..=GRIP_STEPS).map(move |j| (i, j)));
    let origins: Vec<[f64; 2]> =
        std::iter::once(centre).chain(grid.map(|(i, j)| [step(0, i), step(1, j)])).collect();
    half_turn().any(|theta| {
        origins.iter().any(|[x, y]| {
            // The grid is where the first cup sits: cups far off the tool's axis are found as well.
            let turn = Pose2::new(0.0, 0.0, theta);
            let first = cups.first().map_or([0.0; 2], |cup| turn.transform([cup.x_m, cup.y_m]));
            cups.iter().all(|cup| {
                let offset = turn.transform([cup.x_m, cup.y_m]);
                let at = [x + offset[0] - first[0], y + offset[1] - first[1]];
                face.contains_point(at, cup.diameter_m / 2.0 + CUP_MARGIN_M)
            })
        })
    })
}
