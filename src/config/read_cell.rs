//! `config/cell.yaml`: text to [`CellConfig`].
//!
//! In: the text, its name, the folder its paths are relative to, and a reader for files it names. Out: the
//! checked configuration, or every complaint at once. Nothing measured and no limit has a default; what may
//! be left out are the keys that only switch something on.

use crate::config::bodies::{Equipment, equipment};
use crate::config::calibration;
use crate::config::camera::camera_device;
use crate::config::cell::{CellConfig, Devices, MotionLimits, PlannerConfig, SimulationConfig, Tolerances};
use crate::config::check::check_cell;
use crate::config::fleet::fleet;
use crate::config::fragment::ConfigFragment;
use crate::config::kept::{history, recording};
use crate::config::limits::check_limits;
use crate::config::page::page;
use crate::config::parts::{CellParts, TableParts};
use crate::jobs::journal::old::HistoryLimits;
use cell_machine::device::gripper_types::UNIT;
use cell_machine::orders::Approval;
use cell_machine::stillness::{LEAST_REST, SIMULATED_LEAST_REST};
use cell_machine::supervisor::model::ForeignRule;
use cell_parts::fields::{
    each, host, joints_deg, list, optional, path, port, required_each, required_number, required_positive,
    transform,
};
use cell_parts::gripper::gripper;
use cell_parts::places::Places;
use cell_parts::reference::reference_markers;
use cell_values::units::{Joints, rad_from_deg};
use rearrange::document::Diagnostics;
use rearrange::document::decode::{At, Decoder, Fields};
use rearrange::tabletop::decode;
use rearrange::tabletop::instance::ObjectSpec;
use rearrange::tabletop::parse::{MarkerUse, unique_names_and_markers, workspace};
use std::path::Path;

/// Keys of the file.
pub const CELL_KEYS: &[&str] = &[
    "version",
    "devices",
    "workspace",
    "clearance",
    "keep_out",
    "objects",
    "reference_markers",
    "gripper",
    "flange_from_tool",
    "base_from_table",
    "camera",
    "look_poses_deg",
    "park_pose_deg",
    "work_pose_deg",
    "calibration_poses_deg",
    "calibration_box",
    "calibration",
    "limits",
    "tolerances",
    "planner",
    "approval",
    "arm_at_start",
    "arm_lapse_s",
    "simulation",
    "recording",
    "history",
    "goal_folder",
    "ignore_markers",
    "foreign",
    "cell",
    "page",
    "fleet",
];

/// How far the camera may seem shifted or lifted, and turned, unless the file says otherwise: half of what
/// costs a millimetre or two at the objects, and several times what calibration and arm leave.
pub const REFERENCE_SHIFT_M: f64 = 1e-3;
/// See [`REFERENCE_SHIFT_M`].
pub const REFERENCE_TURN_DEG: f64 = 0.15;

/// Pick-n-places after which the whole table is looked at again, unless the file says otherwise.
pub const FULL_LOOK_EVERY: u32 = 20;

/// How often something is tried again unless the configuration says otherwise.
pub const RETRIES: u32 = 2;

/// How long the arm is at rest before a picture is taken, s, unless the file says longer: of a real arm,
/// and of a simulated one, whose camera does not swing.
pub const SETTLE_S: f64 = LEAST_REST.as_secs_f64();
pub const SIMULATED_SETTLE_S: f64 = SIMULATED_LEAST_REST.as_secs_f64();

/// Seconds without motion after which arming lapses, unless the file says otherwise.
pub const ARM_LAPSE_S: f64 = 600.0;

/// Text of a file that the configuration names; `Err` says why it cannot be had.
pub type ReadFile<'a> = dyn Fn(&Path) -> Result<String, String> + 'a;

/// Reads and checks a cell's configuration, with the sections of `shared` in the place of its own.
///
/// # Errors
/// Every complaint, those about an object file with the places in that file.
pub fn read_cell(
    text: &str,
    source: &str,
    shared: Option<&ConfigFragment>,
    folder: &Path,
    read_file: &ReadFile,
) -> Result<CellConfig, Diagnostics> {
    let (own, mut decoder) = Decoder::open(text, source)?;
    let node = match shared {
        Some(shared) => shared.over(own),
        None => own,
    };
    let mut beside = Diagnostics::default();
    let cell = decoder.map(&At::top(&node), CELL_KEYS).and_then(|fields| {
        let parts = parts(&mut decoder, &fields, folder, read_file, &mut beside);
        let places = Places::new(&node);
        check_cell(&mut decoder, &parts, &places);
        check_limits(&mut decoder, &parts, &places);
        parts.whole()
    });
    // A fault beside this file is no fault in it.
    if cell.is_none() && decoder.count() == 0 && !beside.0.is_empty() {
        return Err(beside);
    }
    match decoder.finish(cell) {
        Ok(cell) if beside.0.is_empty() => Ok(cell),
        Ok(_) => Err(beside),
        Err(mut complaints) => {
            complaints.0.extend(beside.0);
            Err(complaints)
        }
    }
}

fn parts(
    d: &mut Decoder,
    fields: &Fields,
    folder: &Path,
    read_file: &ReadFile,
    beside: &mut Diagnostics,
) -> CellParts {
    if let Some(at) = fields.required("version", d) {
        d.integer(&at, 1..=1);
    }
    let devices = fields.required("devices", d).and_then(|at| devices(d, &at, folder));
    let objects = fields.required("objects", d);
    let catalogue = objects.map(|at| catalogue(d, &at, folder, read_file, beside)).unwrap_or_default();
    let reference_markers = fields.required("reference_markers", d).and_then(|at| reference_markers(d, &at));
    let gripper = fields.required("gripper", d).and_then(|at| gripper(d, &at));
    let [flange_from_tool, base_from_table] =
        ["flange_from_tool", "base_from_table"].map(|key| transform(d, fields, key));
    let camera = fields.required("camera", d).and_then(|at| calibration::camera(d, &at));
    let look_poses = required_each(d, fields, "look_poses_deg", joints_deg);
    let calibration_poses = required_each(d, fields, "calibration_poses_deg", joints_deg);
    let [park_pose, work_pose] =
        ["park_pose_deg", "work_pose_deg"].map(|key| required_joints(d, fields, key));
    let calibration_box =
        optional(d, fields, "calibration_box", None, |d, at| calibration::calibration_box(d, at).map(Some));
    let calibration = fields.required("calibration", d).and_then(|at| calibration::files(d, &at, folder));
    let (joint_range, limits) = fields.required("limits", d).map_or((None, None), |at| limits(d, &at));
    CellParts {
        devices,
        table: table(d, fields),
        objects: catalogue.objects,
        object_markers: catalogue.markers,
        reference_markers,
        gripper,
        flange_from_tool,
        base_from_table,
        camera,
        look_poses,
        park_pose,
        work_pose,
        calibration_poses,
        calibration_box,
        calibration,
        joint_range,
        limits,
        tolerances: fields.required("tolerances", d).and_then(|at| tolerances(d, &at, settle_s(fields))),
        planner: fields.required("planner", d).and_then(|at| planner(d, &at)),
        approval: optional(d, fields, "approval", Approval::Always, |d, at| d.word(at)),
        arm_at_start: optional(d, fields, "arm_at_start", false, |d, at| d.boolean(at)),
        arm_lapse_s: optional(d, fields, "arm_lapse_s", ARM_LAPSE_S, arm_lapse),
        simulation: optional(d, fields, "simulation", None, |d, at| simulation(d, at).map(Some)),
        recording: optional(d, fields, "recording", None, |d, at| recording(d, at, folder).map(Some)),
        ignore_markers: optional(d, fields, "ignore_markers", Vec::new(), |d, at| list(d, at, marker_number)),
        foreign: optional(d, fields, "foreign", REFUSE, foreign),
        equipment: optional(d, fields, "cell", Equipment::default(), equipment),
        page: optional(d, fields, "page", None, |d, at| page(d, at, folder).map(Some)),
        fleet: optional(d, fields, "fleet", None, |d, at| fleet(d, at, folder).map(Some)),
        history: optional(d, fields, "history", HistoryLimits::YEAR, history),
        goal_folder: optional(d, fields, "goal_folder", folder.to_owned(), |d, at| path(d, at, folder)),
    }
}

/// How long the arm is at rest before a picture unless the file says otherwise, s.
fn settle_s(fields: &Fields) -> f64 {
    if fields.optional("simulation").is_some() { SIMULATED_SETTLE_S } else { SETTLE_S }
}

/// What is done about foreign things unless the configuration says otherwise.
const REFUSE: ForeignRule = ForeignRule::Refuse { depth_needed: false };

fn arm_lapse(decoder: &mut Decoder, at: &At) -> Option<f64> {
    decoder.number_in(at, 10.0..=86_400.0, "s")
}

fn required_joints(decoder: &mut Decoder, fields: &Fields, key: &str) -> Option<Joints> {
    let at = fields.required(key, decoder)?;
    joints_deg(decoder, &at)
}

fn marker_number(decoder: &mut Decoder, at: &At) -> Option<u32> {
    decoder.integer(at, 0..=586).map(|id| id as u32)
}

fn devices(decoder: &mut Decoder, at: &At, folder: &Path) -> Option<Devices> {
    let fields = decoder.map(at, &["robot", "gripper", "camera"])?;
    let robot = fields.required("robot", decoder).and_then(|at| {
        let fields = decoder.map(&at, &["host"])?;
        host(decoder, &fields, "host")
    });
    let gripper = fields.required("gripper", decoder).and_then(|at| {
        let fields = decoder.map(&at, &["host", "port", "unit"])?;
        let (host, port) = (host(decoder, &fields, "host"), port(decoder, &fields, "port"));
        let unit = optional(decoder, &fields, "unit", UNIT, gripper_unit);
        Some((host?, port?, unit?))
    });
    let camera = fields.required("camera", decoder).and_then(|at| camera_device(decoder, &at, folder));
    let ((gripper_host, gripper_port, gripper_unit), (camera, picture_limits)) = (gripper?, camera?);
    Some(Devices { robot_host: robot?, gripper_host, gripper_port, gripper_unit, camera, picture_limits })
}

/// Units beyond 247 are reserved, and 0 addresses every device at once.
fn gripper_unit(decoder: &mut Decoder, at: &At) -> Option<u8> {
    decoder.integer(at, 1..=247).and_then(|unit| u8::try_from(unit).ok())
}

fn table(decoder: &mut Decoder, fields: &Fields) -> TableParts {
    let size = fields.required("workspace", decoder).and_then(|at| workspace(decoder, &at));
    let clearance_m = required_number(decoder, fields, "clearance", 0.0..=0.2, "m");
    let keep_out =
        optional(decoder, fields, "keep_out", Vec::new(), |decoder, at| list(decoder, at, decode::keep_out));
    TableParts { size, clearance_m, keep_out }
}

/// What could be read of the objects, and the marker numbers of all.
#[derive(Default)]
pub(super) struct Catalogue {
    objects: Option<Vec<Option<ObjectSpec>>>,
    markers: Vec<MarkerUse>,
}

/// The catalogue: a list, or `{file: ...}` with a file that holds the list under `objects`.
fn catalogue(
    decoder: &mut Decoder,
    at: &At,
    folder: &Path,
    read_file: &ReadFile,
    beside: &mut Diagnostics,
) -> Catalogue {
    if at.node.get("file").is_none() {
        return object_list(decoder, at);
    }
    let file = decoder.map(at, &["file"]).and_then(|fields| {
        let file_at = fields.required("file", decoder)?;
        let file = path(decoder, &file_at, folder)?;
        match read_file(&file) {
            Ok(text) => Some((text, file.display().to_string())),
            Err(reason) => {
                decoder.complain_at(&file_at, format!("{}: {reason}", file.display()), "correct the path");
                None
            }
        }
    });
    let Some((text, source)) = file else { return Catalogue::default() };
    let (found, complaints) = object_file(&text, &source);
    beside.0.extend(complaints.0);
    found
}

fn object_file(text: &str, source: &str) -> (Catalogue, Diagnostics) {
    let (node, mut decoder) = match Decoder::open(text, source) {
        Ok(opened) => opened,
        Err(complaints) => return (Catalogue::default(), complaints),
    };
    let found = decoder.map(&At::top(&node), &["version", "objects"]).and_then(|fields| {
        if let Some(version) = fields.optional("version") {
            decoder.integer(&version, 1..=1);
        }
        let at = fields.required("objects", &mut decoder)?;
        Some(object_list(&mut decoder, &at))
    });
    (found.unwrap_or_default(), decoder.finish(Some(())).err().unwrap_or_default())
}

pub(super) fn object_list(decoder: &mut Decoder, at: &At) -> Catalogue {
    let Some(items) = decoder.sequence(at) else { return Catalogue::default() };
    if items.is_empty() {
        decoder.complain_at(
            at,
            "no object is given",
            "name what lies on the table: id, footprint, height, ...",
        );
    }
    unique_names_and_markers(decoder, &items);
    let objects = each(decoder, at, |decoder, at| {
        let object = decode::object(decoder, at)?;
        let missing: Vec<&str> = [
            ("height (m)", object.height.is_none()),
            ("mass (kg)", object.mass.is_none()),
            ("marker", object.marker.is_none()),
        ]
        .iter()
        .filter_map(|(key, missing)| missing.then_some(*key))
        .collect();
        if !missing.is_empty() {
            let message = format!("{:?} has no {}", object.id, missing.join(", no "));
            decoder.complain_at(at, message, "measure and add it; the cell guesses none of these");
        }
        if object.goal.is_some() || (object.start.is_some() && !object.fixed) {
            let message = format!("{:?} has a start or goal, the catalogue says only what it is", object.id);
            decoder.complain_at(at, message, "the camera finds the start, the job says the goal");
        }
        Some(object)
    });
    Catalogue { objects, markers: items.iter().filter_map(MarkerUse::of).collect() }
}

/// The joints' ranges, which the taught poses are compared with, and all limits together.
fn limits(decoder: &mut Decoder, at: &At) -> (Option<[(f64, f64); 6]>, Option<MotionLimits>) {
    let known = [
        "joint_range_deg",
        "joint_speed_deg_s",
        "joint_acceleration_deg_s2",
        "tool_speed_m_s",
        "tool_acceleration_m_s2",
        "link_floor_m",
        "lift_height_m",
        "approach_height_m",
        "press_m",
        "blend_m",
    ];
    let Some(fields) = decoder.map(at, &known) else { return (None, None) };
    let range = fields.required("joint_range_deg", decoder).and_then(|at| joint_range(decoder, &at));
    (range, range_and_rest(decoder, &fields, range))
}

fn range_and_rest(
    decoder: &mut Decoder,
    fields: &Fields,
    range: Option<[(f64, f64); 6]>,
) -> Option<MotionLimits> {
    // The arm's own maxima: UR5e, 180 deg/s, tool 1 m/s as the manual gives them.
    let joint_speed = required_positive(decoder, fields, "joint_speed_deg_s", 180.0, "deg/s");
    let joint_acceleration =
        required_positive(decoder, fields, "joint_acceleration_deg_s2", 2000.0, "deg/s2");
    let tool_speed = required_positive(decoder, fields, "tool_speed_m_s", 1.0, "m/s");
    let tool_acceleration = required_positive(decoder, fields, "tool_acceleration_m_s2", 20.0, "m/s2");
    let link_floor = required_number(decoder, fields, "link_floor_m", 0.0..=1.0, "m");
    let lift = required_positive(decoder, fields, "lift_height_m", 0.5, "m");
    let approach = required_positive(decoder, fields, "approach_height_m", 0.5, "m");
    let press = required_number(decoder, fields, "press_m", 0.0..=0.01, "m");
    let blend = required_number(decoder, fields, "blend_m", 0.0..=0.1, "m");
    Some(MotionLimits {
        joint_range: range?,
        joint_speed: rad_from_deg(joint_speed?),
        joint_acceleration: rad_from_deg(joint_acceleration?),
        tool_speed: tool_speed?,
        tool_acceleration: tool_acceleration?,
        link_floor_m: link_floor?,
        lift_height_m: lift?,
        approach_height_m: approach?,
        press_m: press?,
        blend_m: blend?,
    })
}

/// Six pairs [lowest, highest] in degrees.
fn joint_range(decoder: &mut Decoder, at: &At) -> Option<[(f64, f64); 6]> {
    let pairs = list(decoder, at, |decoder, at| {
        let [low, high] = decoder.numbers::<2>(at)?;
        if low >= high || low < -363.0 || high > 363.0 {
            let message = format!("[{low}, {high}] is not a joint range");
            decoder.complain_at(at, message, "lowest and highest position in degrees, within -363 to 363");
            return None;
        }
        Some((rad_from_deg(low), rad_from_deg(high)))
    })?;
    let count = pairs.len();
    let range = <[(f64, f64); 6]>::try_from(pairs).ok();
    if range.is_none() {
        decoder.complain_at(at, format!("{count} pairs, 6 are wanted"), "one for each joint, base first");
    }
    range
}

pub(super) fn tolerances(decoder: &mut Decoder, at: &At, settle_s: f64) -> Option<Tolerances> {
    let known = [
        "goal_position_m",
        "goal_angle_deg",
        "observation_age_s",
        "full_look_every",
        "retries",
        "retries_after_stop",
        "settle_s",
        "reference_residual_m",
        "reference_shift_m",
        "reference_turn_deg",
    ];
    let fields = decoder.map(at, &known)?;
    let position = required_positive(decoder, &fields, "goal_position_m", 0.1, "m");
    let angle = required_positive(decoder, &fields, "goal_angle_deg", 90.0, "degrees");
    let age = required_number(decoder, &fields, "observation_age_s", 1.0..=3600.0, "s");
    let every = optional(decoder, &fields, "full_look_every", FULL_LOOK_EVERY, |d, at| {
        d.integer(at, 1..=10_000).and_then(|count| u32::try_from(count).ok())
    });
    let count = |decoder: &mut Decoder, at: &At| decoder.integer(at, 0..=100).map(|count| count as u32);
    let retries = optional(decoder, &fields, "retries", RETRIES, count);
    let after_stop = optional(decoder, &fields, "retries_after_stop", 0, count);
    let settle = optional(decoder, &fields, "settle_s", settle_s, |d, at| d.number_in(at, 0.0..=5.0, "s"));
    let residual = required_positive(decoder, &fields, "reference_residual_m", 0.1, "m");
    let shift = optional(decoder, &fields, "reference_shift_m", REFERENCE_SHIFT_M, |d, at| {
        d.number_in(at, 1e-5..=0.1, "m")
    });
    let turn = optional(decoder, &fields, "reference_turn_deg", REFERENCE_TURN_DEG, |d, at| {
        d.number_in(at, 1e-3..=10.0, "degrees")
    });
    Some(Tolerances {
        goal_position_m: position?,
        goal_angle_rad: rad_from_deg(angle?),
        observation_age_s: age?,
        full_look_every: every?,
        retries: retries?,
        stop_retries: after_stop?,
        settle_s: settle?,
        reference_residual_m: residual?,
        reference_shift_m: shift?,
        reference_turn_rad: rad_from_deg(turn?),
    })
}

/// `{mode: refuse | off}` or `{mode: obstacle, margin_m}`.
fn foreign(decoder: &mut Decoder, at: &At) -> Option<ForeignRule> {
    let mode_at = decoder.open_map(at)?.required("mode", decoder)?;
    match decoder.choice(&mode_at, &[("refuse", "refuse"), ("obstacle", "obstacle"), ("off", "off")])? {
        "obstacle" => {
            let fields = decoder.map(at, &["mode", "margin_m"])?;
            let margin_m = required_number(decoder, &fields, "margin_m", 0.0..=0.2, "m")?;
            Some(ForeignRule::Obstacle { margin_m })
        }
        mode => {
            decoder.map(at, &["mode"])?;
            let refuse = ForeignRule::Refuse { depth_needed: true };
            Some(if mode == "refuse" { refuse } else { ForeignRule::Off })
        }
    }
}

pub(super) fn planner(decoder: &mut Decoder, at: &At) -> Option<PlannerConfig> {
    let fields = decoder.map(at, &["solver", "objective", "time_limit_s", "seed"])?;
    let solver = fields.required("solver", decoder).and_then(|at| decoder.word(&at));
    let objective = fields.required("objective", decoder).and_then(|at| decoder.word(&at));
    let time_limit_s = required_positive(decoder, &fields, "time_limit_s", 86_400.0, "s");
    let seed = fields.required("seed", decoder).and_then(|at| decoder.integer(&at, 0..=i64::MAX));
    Some(PlannerConfig {
        solver: solver?,
        objective: objective?,
        time_limit_s: time_limit_s?,
        seed: u64::try_from(seed?).ok()?,
    })
}

fn simulation(decoder: &mut Decoder, at: &At) -> Option<SimulationConfig> {
    let fields = decoder.map(at, &["clock_factor"])?;
    let clock_factor = required_number(decoder, &fields, "clock_factor", 0.01..=1000.0, "times real time")?;
    Some(SimulationConfig { clock_factor })
}
