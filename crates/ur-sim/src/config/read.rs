//! `config/sim.yaml`: text to [`SimFile`].
//!
//! In: the text and its name. Out: the checked configuration of the simulated cell, or every complaint at
//! once. The deviations of the simulated truth have documented defaults: they are chosen, not measured.

use crate::box_clients::BoxConfig;
use crate::config::blend::entry_speed;
use crate::config::compute_box::compute_box;
use crate::config::conveyors::conveyors;
use crate::config::gripper::gripper;
use crate::config::programs::programs;
use crate::config::rest::rest;
use crate::config::safety::safety;
use crate::config::software::controller;
use crate::config::{Installation, SimErrors, SimFile, SimHandBoard, SimMount, SimPorts};
use crate::controller::config::SOFTWARE;
use crate::controller::modes::Control;
use crate::controller::program_files::ProgramFiles;
use crate::motion::rest::RestConfig;
use crate::motion::rounding::EntrySpeed;
use crate::motion::safety::SafetyLimits;
use crate::robot_server::{ROBOT_API_PORT, ROBOTIQ_PORT};
use cell_parts::fields::{each, joints_deg, optional, port, required_number, transform};
use cell_parts::grid::{board, board_apart};
use cell_parts::places::Places;
use cell_parts::reference::{ReferenceMarkerConfig, check_reference_markers, reference_markers};
use cell_values::units::rad_from_deg;
use rearrange::document::Diagnostics;
use rearrange::document::decode::{At, Decoder, Fields};
use rearrange::tabletop::arrangement::{Layout, Place};
use rearrange::tabletop::decode;
use rearrange::tabletop::instance::{ObjectSpec, Workspace};
use rearrange::tabletop::parse::{MarkerUse, unique_names_and_markers, workspace};
use std::net::IpAddr;
use ur_arm::kinematics::{ARM_MODELS, ArmModel};

/// Keys of the file.
pub const SIM_KEYS: &[&str] = &[
    "version",
    "bind",
    "ports",
    "seed",
    "time_factor",
    "workspace",
    "objects",
    "reference_markers",
    "gripper",
    "flange_from_tool",
    "base_from_table",
    "flange_from_camera",
    "base_from_camera",
    "hand_board",
    "conveyors",
    "model",
    "controller",
    "start_pose_deg",
    "control_mode",
    "safety",
    "blend",
    "rest",
    "installation",
    "compute_box",
    "programs",
    "errors",
];

/// From where the arm is commanded, as the file names it.
const CONTROL_MODES: &[(&str, Control)] =
    &[("remote", Control::Remote), ("local", Control::Local), ("not_enabled", Control::NotEnabled)];

/// What the installation says of the tool, as the file names it.
const INSTALLATIONS: &[(&str, Installation)] =
    &[("bare", Installation::Bare), ("gripper", Installation::Gripper)];

/// What the truth deviates by unless the file says otherwise (design, sections 5 and issue 2 part 7).
pub const DEFAULT_ERRORS: SimErrors = SimErrors {
    placement_m: 2e-4,
    placement_rad: 0.1 * std::f64::consts::PI / 180.0,
    table_m: 3e-3,
    table_rad: 0.3 * std::f64::consts::PI / 180.0,
    mount_m: 3e-3,
    mount_rad: 0.5 * std::f64::consts::PI / 180.0,
    dh_m: 5e-4,
    dh_rad: 0.05 * std::f64::consts::PI / 180.0,
    noise_levels: 2.0,
};

/// Reads and checks a simulated cell's configuration.
///
/// # Errors
/// Every complaint.
pub fn read_sim(text: &str, source: &str) -> Result<SimFile, Diagnostics> {
    let (node, mut decoder) = Decoder::open(text, source)?;
    let file = decoder
        .map(&At::top(&node), SIM_KEYS)
        .and_then(|fields| sim(&mut decoder, &fields, &Places::new(&node)));
    decoder.finish(file)
}

fn sim(decoder: &mut Decoder, fields: &Fields, places: &Places) -> Option<SimFile> {
    fields.required("version", decoder).and_then(|at| decoder.integer(&at, 1..=1));
    let bind = fields.required("bind", decoder).and_then(|at| address(decoder, &at));
    let ports = fields.required("ports", decoder).and_then(|at| ports(decoder, &at));
    let seed = optional(decoder, fields, "seed", 0, |decoder, at| decoder.integer(at, 0..=i64::MAX));
    let time_factor = optional(decoder, fields, "time_factor", 1.0, time_factor);
    let size = fields.required("workspace", decoder).and_then(|at| workspace(decoder, &at));
    let objects = fields.required("objects", decoder).and_then(|at| objects(decoder, &at, size, places));
    let markers =
        fields.required("reference_markers", decoder).and_then(|at| reference_markers(decoder, &at));
    let gripper = fields.required("gripper", decoder).and_then(|at| gripper(decoder, &at));
    let flange_from_tool = transform(decoder, fields, "flange_from_tool");
    let base_from_table = transform(decoder, fields, "base_from_table");
    let camera = mount(decoder, fields);
    let hand_board = optional(decoder, fields, "hand_board", None, held_board);
    apart(decoder, hand_board.as_ref(), numbers_on_table(markers.as_deref(), objects.as_deref()), places);
    let start_pose = fields.required("start_pose_deg", decoder).and_then(|at| joints_deg(decoder, &at));
    let model = optional(decoder, fields, "model", ARM_MODELS[0], model);
    let controller = optional(decoder, fields, "controller", (SOFTWARE, [0.0; 2]), controller);
    let control = optional(decoder, fields, "control_mode", Control::Remote, control);
    let conveyors = optional(decoder, fields, "conveyors", Vec::new(), conveyors);
    let safety = optional(decoder, fields, "safety", SafetyLimits::default(), safety);
    let entry_speed = optional(decoder, fields, "blend", EntrySpeed::Braked, entry_speed);
    let rest = optional(decoder, fields, "rest", RestConfig::recorded(), rest);
    let installation = optional(decoder, fields, "installation", Installation::Bare, installation);
    let compute_box = optional(decoder, fields, "compute_box", BoxConfig::default(), compute_box);
    let programs = optional(decoder, fields, "programs", (None, ProgramFiles::default()), programs);
    let errors = optional(decoder, fields, "errors", DEFAULT_ERRORS, errors);
    let (size, (program_folder, programs), (gripper, drive)) = (size?, programs?, gripper?);
    Some(SimFile {
        bind: bind?,
        ports: ports?,
        seed: u64::try_from(seed?).ok()?,
        time_factor: time_factor?,
        width_m: size.width,
        height_m: size.height,
        base_from_table: base_from_table?,
        flange_from_tool: flange_from_tool?,
        camera: camera?,
        hand_board: hand_board?,
        gripper,
        drive,
        objects: objects?,
        reference_markers: markers?,
        model: model?,
        start_pose: start_pose?,
        software: controller?.0,
        encoders: controller?.1,
        conveyors: conveyors?,
        control: control?,
        safety: safety?,
        entry_speed: entry_speed?,
        rest: rest?,
        installation: installation?,
        compute_box: compute_box?,
        program_folder,
        programs,
        errors: errors?,
    })
}

fn time_factor(decoder: &mut Decoder, at: &At) -> Option<f64> {
    decoder.number_in(at, 0.01..=1000.0, "times real time")
}

fn held_board(decoder: &mut Decoder, at: &At) -> Option<Option<SimHandBoard>> {
    hand_board(decoder, at).map(Some)
}

fn installation(decoder: &mut Decoder, at: &At) -> Option<Installation> {
    decoder.choice(at, INSTALLATIONS)
}

fn control(decoder: &mut Decoder, at: &At) -> Option<Control> {
    decoder.choice(at, CONTROL_MODES)
}

fn model(decoder: &mut Decoder, at: &At) -> Option<ArmModel> {
    let choices: Vec<_> = ARM_MODELS.iter().map(|model| (model.name, *model)).collect();
    decoder.choice(at, &choices)
}

/// No marker is on the hand's board and elsewhere.
fn apart(decoder: &mut Decoder, held: Option<&Option<SimHandBoard>>, on_table: Vec<i64>, places: &Places) {
    let Some(Some(held)) = held else { return };
    let place = (places.at(&["hand_board", "board"]), "hand_board.board");
    board_apart(decoder, held.board.numbers(), on_table.into_iter(), place);
}

/// Numbers of the markers that are not on the hand's board.
fn numbers_on_table(markers: Option<&[ReferenceMarkerConfig]>, objects: Option<&[ObjectSpec]>) -> Vec<i64> {
    let reference = markers.into_iter().flatten().map(|marker| marker.id);
    let on_objects = objects.into_iter().flatten().filter_map(|object| object.marker.as_ref());
    reference.chain(on_objects.map(|marker| marker.id)).map(i64::from).collect()
}

/// The camera on the hand or on a stand.
fn mount(decoder: &mut Decoder, fields: &Fields) -> Option<SimMount> {
    let Some(at) = fields.optional("base_from_camera") else {
        return transform(decoder, fields, "flange_from_camera").map(SimMount::Flange);
    };
    if fields.optional("flange_from_camera").is_some() {
        let message = "the camera sits on the flange or stands, not both";
        decoder.complain_at(&at, message, "leave out flange_from_camera or base_from_camera");
        return None;
    }
    transform(decoder, fields, "base_from_camera").map(SimMount::Fixed)
}

fn hand_board(decoder: &mut Decoder, at: &At) -> Option<SimHandBoard> {
    let fields = decoder.map(at, &["board", "flange_from_board"])?;
    let board = fields.required("board", decoder).and_then(|at| board(decoder, &at));
    let flange_from_board = transform(decoder, &fields, "flange_from_board");
    Some(SimHandBoard { board: board?, flange_from_board: flange_from_board? })
}

fn ports(decoder: &mut Decoder, at: &At) -> Option<SimPorts> {
    let known = ["modbus", "camera", "control", "controller_modbus", "robot_api", "robotiq"];
    let fields = decoder.map(at, &known)?;
    let [modbus, camera, control] = ["modbus", "camera", "control"].map(|key| port(decoder, &fields, key));
    let mut given = |key| match fields.optional(key) {
        Some(_) => port(decoder, &fields, key).map(Some),
        None => Some(None),
    };
    let (own, robot_api, robotiq) = (given("controller_modbus")?, given("robot_api")?, given("robotiq")?);
    let ports = SimPorts {
        modbus: modbus?,
        camera: camera?,
        control: control?,
        controller_modbus: own,
        robot_api: robot_api.unwrap_or(ROBOT_API_PORT),
        robotiq: robotiq.unwrap_or(ROBOTIQ_PORT),
    };
    let taken = [29999, 30001, 30002, 30003, 30004, 30011, 30012, 30013, 30020];
    let mut mine = vec![("modbus", ports.modbus), ("camera", ports.camera), ("control", ports.control)];
    mine.extend(ports.controller_modbus.map(|port| ("controller_modbus", port)));
    // Where they are not written down they disturb only a controller that has them, when it starts.
    mine.extend(robot_api.map(|port| ("robot_api", port)));
    mine.extend(robotiq.map(|port| ("robotiq", port)));
    for (index, (key, port)) in mine.iter().enumerate() {
        if taken.contains(port) || mine.iter().take(index).any(|(_, other)| other == port) {
            let message = format!("port {port} for {key} is taken by another server of the cell");
            decoder.complain_at(
                at,
                message,
                "29999, 30001 to 30004, 30011 to 30013 and 30020 are the controller's own",
            );
        }
    }
    Some(ports)
}

/// An address to listen at. A name is refused: it may resolve to several, and the cell's side compares
/// addresses.
fn address(decoder: &mut Decoder, at: &At) -> Option<String> {
    let text = decoder.text(at)?;
    if text.parse::<IpAddr>().is_err() {
        let help = "write an address of this machine alone, as 127.0.0.2";
        decoder.complain_at(at, format!("{text:?} is not an IP address"), help);
        return None;
    }
    Some(text)
}

/// The objects, their starts compared with each other and with the table, their markers with the table's.
fn objects(
    decoder: &mut Decoder,
    at: &At,
    workspace: Option<Workspace>,
    places: &Places,
) -> Option<Vec<ObjectSpec>> {
    let items = decoder.sequence(at)?;
    unique_names_and_markers(decoder, &items);
    let markers: Vec<MarkerUse> = items.iter().filter_map(MarkerUse::of).collect();
    check_reference_markers(decoder, places, &markers);
    let objects = each(decoder, at, |decoder, at| {
        let object = decode::object(decoder, at)?;
        if object.start.is_none() || object.height.is_none() || object.mass.is_none() {
            let message = format!("{:?} needs start, height (m) and mass (kg)", object.id);
            decoder.complain_at(at, message, "the simulated world cannot guess them");
        }
        Some(object)
    })?;
    let layout = Layout {
        workspace,
        overlap_tolerance: Some(0.0),
        keep_out: &[],
        objects: objects.iter().map(Option::as_ref).collect(),
        places: &items.iter().map(Place::of).collect::<Vec<_>>(),
    };
    layout.start_faults(decoder);
    objects.into_iter().collect()
}

fn errors(decoder: &mut Decoder, at: &At) -> Option<SimErrors> {
    let known = [
        "placement_m",
        "placement_deg",
        "table_m",
        "table_deg",
        "mount_m",
        "mount_deg",
        "dh_m",
        "dh_deg",
        "noise_levels",
    ];
    let fields = decoder.map(at, &known)?;
    let mut length = |key: &str| required_number(decoder, &fields, key, 0.0..=0.05, "m");
    let (placement_m, table_m, mount_m, dh_m) =
        (length("placement_m"), length("table_m"), length("mount_m"), length("dh_m"));
    let mut angle =
        |key: &str| required_number(decoder, &fields, key, 0.0..=10.0, "degrees").map(rad_from_deg);
    let (placement_rad, table_rad, mount_rad, dh_rad) =
        (angle("placement_deg"), angle("table_deg"), angle("mount_deg"), angle("dh_deg"));
    // Pictures without noise repeat bit by bit, and the daemon takes a camera that repeats itself for
    // frozen.
    let noise_levels = required_number(decoder, &fields, "noise_levels", 0.1..=50.0, "grey levels");
    Some(SimErrors {
        placement_m: placement_m?,
        placement_rad: placement_rad?,
        table_m: table_m?,
        table_rad: table_rad?,
        mount_m: mount_m?,
        mount_rad: mount_rad?,
        dh_m: dh_m?,
        dh_rad: dh_rad?,
        noise_levels: noise_levels?,
    })
}
