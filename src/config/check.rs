//! What no single key can show: whether the parts of a cell's configuration fit each other.
//!
//! In: the parts that could be read, and where the keys are. Out: complaints in the decoder. Each check
//! takes the parts it needs and is left out when one of them is missing, so that one wrong key hides no
//! other fault. Pure.

use crate::config::calibration::check_board;
use crate::config::cell::Devices;
use crate::config::parts::CellParts;
use crate::config::sessions::HELD_SHARE;
use cell_calibration::drawn::CameraMount;
use cell_machine::supervisor::model::ForeignRule;
use cell_motion::holding::{LEAST_ACCELERATION, Lip, Offset, Suction};
use cell_parts::gripper::{CupConfig, GripperConfig};
use cell_parts::places::Places;
use cell_parts::reference::check_reference_markers;
use cell_values::units::{Joints, deg_from_rad, mm_from_m};
use rearrange::document::Location;
use rearrange::document::decode::Decoder;
use rearrange::geometry::collision::penetration;
use rearrange::geometry::footprint::Footprint;
use rearrange::geometry::pose::Pose2;
use rearrange::tabletop::instance::{KeepOut, ObjectSpec, Workspace};
use rearrange::tabletop::room::{Cup, Grip, place_for_cups};
use std::net::IpAddr;

/// Space that every cup keeps to the rim of the face it sits on, m.
pub const CUP_MARGIN_M: f64 = 0.001;

/// So far a reference marker's paper may reach into the workspace: less than it was surveyed to, m.
const ASIDE_M: f64 = 1e-3;

/// Angles tried between 0 and a half turn.
const ANGLES: usize = 36;

/// Complains about everything that does not fit.
pub(super) fn check_cell(decoder: &mut Decoder, parts: &CellParts, places: &Places) {
    check_simulation(decoder, parts, places);
    check_depth(decoder, parts, places);
    check_poses(decoder, parts, places);
    check_board(decoder, parts, places);
    check_empty(decoder, parts, places);
    check_reference_markers(decoder, places, &parts.object_markers);
    check_ignored(decoder, parts, places);
    check_references_are_aside(decoder, parts, places);
    check_gripper_height(decoder, parts, places);
    for (index, object) in parts.objects.iter().flatten().enumerate() {
        let Some(object) = object else { continue };
        let at = places.at(&["objects", &index.to_string()]);
        check_object(decoder, parts, object, at, &format!("objects[{index}]"));
    }
}

/// A marker that is ignored is seen nowhere: one that the cell looks for would be missing for ever.
fn check_ignored(decoder: &mut Decoder, parts: &CellParts, places: &Places) {
    for (index, id) in parts.ignore_markers.iter().flatten().enumerate() {
        let object = parts.object_markers.iter().find(|marker| marker.number == i64::from(*id));
        let reference = parts.reference_markers.iter().flatten().any(|marker| marker.id == *id);
        let whose = match object {
            Some(marker) => format!("the marker of {:?}", marker.owner),
            None if reference => "a reference marker".to_string(),
            None => continue,
        };
        let at = places.at(&["ignore_markers", &index.to_string()]);
        let message = format!("{id} is {whose}, which the cell looks for");
        decoder.complain(at, &format!("ignore_markers[{index}]"), message, "remove one of the two");
    }
}

/// Printed with its white ring, a marker is this many times as wide as its black square.
const PRINTED: f64 = 1.25;

/// A reference marker within the workspace would be covered by what is placed there, and is then missed or
/// torn off: it lies outside, or where nothing may be placed.
fn check_references_are_aside(decoder: &mut Decoder, parts: &CellParts, places: &Places) {
    let (Some(size), Some(keep_out)) = (&parts.table.size, &parts.table.keep_out) else { return };
    let room = Footprint::Rectangle { length: size.width, width: size.height };
    let middle = Pose2::new(size.width / 2.0, size.height / 2.0, 0.0);
    for (index, marker) in parts.reference_markers.iter().flatten().enumerate() {
        let edge = PRINTED * marker.size_m;
        let paper = Footprint::Rectangle { length: edge, width: edge };
        let inside = penetration(&paper, &marker.pose, &room, &middle);
        let kept_free = |kept: &KeepOut| {
            let corners = paper.outline(4).into_iter();
            corners.into_iter().all(|corner| {
                let at = kept.pose.inverse_transform(marker.pose.transform(corner));
                kept.footprint.contains_point(at, 0.0)
            })
        };
        if inside <= ASIDE_M || keep_out.iter().any(kept_free) {
            continue;
        }
        let message = format!(
            "reference marker {} reaches {:.1} mm into the workspace, where objects are placed",
            marker.id,
            mm_from_m(inside)
        );
        let help = "fix it to the table beside the workspace, or name its place in `keep_out`";
        let at = places.at(&["reference_markers", &index.to_string()]);
        decoder.complain(at, &format!("reference_markers[{index}]"), message, help);
    }
}

/// The gripper's body comes down over what its cups touch, and keeps its distance to that too.
fn check_gripper_height(decoder: &mut Decoder, parts: &CellParts, places: &Places) {
    let (Some(gripper), Some(limits), Some(cell)) = (&parts.gripper, &parts.limits, &parts.equipment) else {
        return;
    };
    if gripper.body_height_m - limits.press_m > cell.margin_m {
        return;
    }
    let message = format!(
        "the gripper's lower face is {:.1} mm over what the cups are pressed onto, and keeps {:.1} mm \
         (cell.margin_m)",
        mm_from_m(gripper.body_height_m - limits.press_m),
        mm_from_m(cell.margin_m)
    );
    let help = "measure from the cup lips up to the body; or longer cups, or a smaller margin";
    decoder.complain(places.at(&["gripper", "body", "height"]), "gripper.body.height", message, help);
}

fn check_simulation(decoder: &mut Decoder, parts: &CellParts, places: &Places) {
    let Some(simulation) = &parts.simulation else { return };
    if simulation.is_none() {
        if parts.arm_at_start == Some(true) {
            let message = "only a simulated cell may be armed at start: a person arms a real one";
            let help = "remove the key, and arm with `celld arm`";
            decoder.complain(places.at(&["arm_at_start"]), "arm_at_start", message, help);
        }
        return;
    }
    for (name, host) in parts.devices.iter().flat_map(hosts) {
        if !is_loopback(host) {
            let message = format!("the {name} is at {host:?}, which is not this machine");
            let help = "remove `simulation`: its clock would run past a real device's deadlines";
            decoder.complain(places.at(&["simulation"]), "simulation", message, help);
        }
    }
}

/// What carries no marker is found by depth.
fn check_depth(decoder: &mut Decoder, parts: &CellParts, places: &Places) {
    let needed = matches!(
        parts.foreign,
        Some(ForeignRule::Refuse { depth_needed: true } | ForeignRule::Obstacle { .. })
    );
    let measured = parts.devices.as_ref().is_none_or(|devices| devices.camera.measures_depth());
    let obstacle = matches!(parts.foreign, Some(ForeignRule::Obstacle { .. }));
    let compared = parts.calibration.as_ref().is_some_and(|files| files.empty.is_some());
    // Colour does not show how high a thing is: it can be refused, but not driven over.
    if needed && !measured && (obstacle || !compared) {
        let message = "the search for what carries no marker needs depth, and the camera is not asked for it";
        let help = "set `depth: true` in `devices.camera` where the camera measures depth, or `foreign: \
                    {mode: off}`; `mode: refuse` also works with pictures of the empty table (`empty` under \
                    `calibration`)";
        decoder.complain(places.at(&["devices", "camera"]), "devices.camera", message, help);
    }
}

/// A fixed camera sees the same table in every look, and the arm in another place: its pictures of the
/// empty table cannot be distinguished by where they were taken from.
fn check_empty(decoder: &mut Decoder, parts: &CellParts, places: &Places) {
    let stands = matches!(parts.camera, Some(CameraMount::Fixed { .. }));
    let compared = parts.calibration.as_ref().is_some_and(|files| files.empty.is_some());
    let looks = parts.look_poses.as_ref().map_or(0, Vec::len);
    if stands && compared && looks > 1 {
        let message =
            format!("{looks} look poses before a camera that stands, whose looks are compared with `empty`");
        let help =
            "teach one look pose with the arm out of the picture; or leave out `empty` under `calibration`";
        decoder.complain(places.at(&["look_poses_deg"]), "look_poses_deg", message, help);
    }
}

fn hosts(devices: &Devices) -> Vec<(&'static str, &str)> {
    let mut hosts = vec![("robot", devices.robot_host.as_str()), ("gripper", devices.gripper_host.as_str())];
    hosts.extend(devices.camera.host().map(|host| ("camera", host)));
    hosts
}

/// True for this machine's own addresses. Names other than `localhost` are not looked up: an answer may
/// change.
pub fn is_loopback(host: &str) -> bool {
    host == "localhost" || host.parse::<IpAddr>().is_ok_and(|address| address.is_loopback())
}

fn check_poses(decoder: &mut Decoder, parts: &CellParts, places: &Places) {
    if parts.look_poses.as_ref().is_some_and(Vec::is_empty) {
        let help = "teach joint poses that together see the whole workspace";
        decoder.complain(places.at(&["look_poses_deg"]), "look_poses_deg", "no look pose is given", help);
    }
    let Some(range) = &parts.joint_range else { return };
    let lists = [("look_poses_deg", &parts.look_poses), ("calibration_poses_deg", &parts.calibration_poses)];
    for (key, poses) in lists {
        for (index, pose) in poses.iter().flatten().enumerate() {
            let Some(pose) = pose else { continue };
            let at = places.at(&[key, &index.to_string()]);
            check_range(decoder, range, pose, at, &format!("{key}[{index}]"));
        }
    }
    for (key, pose) in [("park_pose_deg", &parts.park_pose), ("work_pose_deg", &parts.work_pose)] {
        if let Some(pose) = pose {
            check_range(decoder, range, pose, places.at(&[key]), key);
        }
    }
}

fn check_range(decoder: &mut Decoder, range: &[(f64, f64); 6], pose: &Joints, at: Location, path: &str) {
    for (joint, (q, (low, high))) in pose.0.iter().zip(range).enumerate() {
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

fn check_object(decoder: &mut Decoder, parts: &CellParts, object: &ObjectSpec, at: Location, path: &str) {
    if let Some(Workspace { width, height }) = parts.table.size
        && !fits_table(&object.footprint, width, height)
    {
        let message =
            format!("{:?} is larger than the table of {width} m x {height} m at any angle", object.id);
        decoder.complain(at, path, message, "lengths are in m; check footprint and workspace");
        return;
    }
    check_marker(decoder, object, at, path);
    if object.fixed {
        if object.start.is_none() {
            let message = format!("{:?} is fixed, but has no pose", object.id);
            decoder.complain(at, path, message, "add start: [x, y, theta], its surveyed pose in m, m, rad");
        }
        return;
    }
    let Some(gripper) = &parts.gripper else { return };
    // All cups, as `daemon::setup` places them: the gripper has no way to leave one out.
    let grip = place_for_cups(&object.footprint, object.grippable.as_ref(), &cups(gripper), CUP_MARGIN_M);
    let Some(grip) = grip else {
        let message = format!(
            "no place on {:?} takes all {} cups with {:.0} mm to spare",
            object.id,
            gripper.cups.len(),
            mm_from_m(CUP_MARGIN_M)
        );
        decoder.complain(at, path, message, "use smaller cups or fewer of them, or give another `grippable`");
        return;
    };
    if let (Some(limits), Some(mass_kg)) = (&parts.limits, object.mass) {
        let (suction, off) = (suction(gripper), off_centre(&object.footprint, &grip));
        let needed_n = suction.needed_n(mass_kg, off, limits.tool_acceleration.min(LEAST_ACCELERATION));
        check_weight(decoder, object, mass_kg, [suction.force_n, needed_n], (at, path));
    }
}

/// The cups as the search for a place on an object needs them.
pub fn cups(gripper: &GripperConfig) -> Vec<Cup> {
    let cup = |cup: &CupConfig| Cup { x: cup.x_m, y: cup.y_m, radius: cup.diameter_m / 2.0 };
    gripper.cups.iter().map(cup).collect()
}

fn check_weight(
    decoder: &mut Decoder,
    object: &ObjectSpec,
    mass_kg: f64,
    [held, needed]: [f64; 2],
    (at, path): (Location, &str),
) {
    if held < needed {
        let message = format!(
            "{:?} weighs {mass_kg} kg: carrying it safely takes {needed:.1} N, its cups hold {held:.1} N \
             where a loss is reported, at {HELD_SHARE} of vacuum_min",
            object.id
        );
        decoder.complain(at, path, message, "use larger or more cups, or a higher vacuum_min");
    }
}

/// The gripper's cups together, at the least vacuum with which an object counts as held.
pub fn suction(gripper: &GripperConfig) -> Suction {
    let lip = |cup: &CupConfig| Lip { middle: [cup.x_m, cup.y_m], radius: cup.diameter_m / 2.0 };
    Suction {
        force_n: HELD_SHARE * gripper.holding_force_n(&gripper.cups),
        lips: gripper.cups.iter().map(lip).collect(),
    }
}

/// Where an object's centre hangs on the tool that grips it there.
pub fn off_centre(footprint: &Footprint, grip: &Grip) -> Offset {
    let [x, y] = footprint.centroid();
    let [x, y] = [x - grip.point[0], y - grip.point[1]];
    let Some(yaw) = grip.yaw else { return Offset::Anywhere(x.hypot(y)) };
    // The tool points down: its x axis lies at the yaw, its y axis 90 degrees clockwise of that.
    let (sin, cos) = yaw.sin_cos();
    Offset::At([cos * x + sin * y, sin * x - cos * y])
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
