//! `celld sim`: simulated UR5e, VGC10 and camera on the controller's own port numbers.
//!
//! In: the simulator's configuration. Out: one JSON line on stdout when all servers listen, then nothing
//! until Ctrl-C or SIGTERM. `sim_config` is also what the demo starts its cell from.

pub mod check_script;

pub mod compare;

pub mod end;

pub mod values;

use crate::camera::{CameraSetup, CameraTiming};
use crate::cell::{SimConfig, SimError, start};
use crate::config::conveyors::ConveyorConfig;
use crate::config::load::load_sim;
use crate::config::read::read_sim;
use crate::config::{Installation, SimFile, SimHandBoard, SimMount};
use crate::conformance;
use crate::controller::config::{ControllerConfig, calibrated};
use crate::facts;
use crate::faults::Planned;
use crate::faults::read::read_faults;
use crate::motion::belt::TableBelt;
use crate::motion::rounding::BlendConfig;
use crate::render::lens::CameraTruth;
use crate::robot_server::{RobotPorts, TOOL_SERIAL_PORT};
use crate::world::drive::Drive;
use crate::world::spec;
use crate::world::vacuum::Channel;
use cell_edge::terminal::{complain, print, within};
use cell_edge::{clock_channel, priority};
use cell_parts::gripper::CupChannel;
use check_script::check_scripts;
use clap::Args;
use rearrange::geometry::footprint::Footprint;
use rearrange::tabletop::instance::ObjectSpec;
use serde_json::json;
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use ur_arm::kinematics::ArmModel;
use ur_arm::pose::ur_pose_from_isometry;

/// Nominal focal length of the simulated camera, px, and its picture.
pub const FOCAL_PX: f64 = 650.0;
/// Columns and rows.
pub const PICTURE: (u32, u32) = (1280, 720);

/// Board round the work area, m.
const MARGIN_M: f64 = 0.12;

/// `celld sim`
#[derive(Args, Clone, Debug)]
pub struct SimArgs {
    /// The simulator's configuration; without it config/sim.yaml, and where there is none, the copy in this
    /// program.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Address to listen at, instead of the configuration's; the last one of several.
    #[arg(long, overrides_with = "bind")]
    bind: Option<IpAddr>,
    /// Added to every port number, the controller's own included: several simulations on one address.
    #[arg(long, value_name = "N", default_value_t = 0)]
    port_offset: u16,
    /// Which arm, instead of the configuration's: UR5e, UR10e, ...
    #[arg(long, value_name = "NAME", value_parser = values::model)]
    model: Option<ArmModel>,
    /// Software version that the controller has, as 5.13.0; 10.12.0 is PolyScope X, without a dashboard.
    #[arg(long, value_name = "VERSION", value_parser = values::software)]
    software: Option<[u32; 4]>,
    /// Simulated seconds per second, instead of the configuration's.
    #[arg(long, value_name = "F", value_parser = time_factor)]
    time_factor: Option<f64>,
    /// Wait for nobody: no clock channel for celld, and frames are skipped for clients that read too slowly.
    #[arg(long)]
    strict: bool,
    /// What goes wrong and when (docs/faults.md); nothing without it.
    #[arg(long, value_name = "FILE")]
    faults: Option<PathBuf>,
    /// Also open the control socket (loopback only): faults and the world's truth.
    #[arg(long)]
    control: bool,
    /// End when standard input does: with the program at its other end, however that ends.
    #[arg(long)]
    until_eof: bool,
    /// Parse URScript programs (`-` for standard input), report, and stop.
    #[arg(long, value_name = "FILE", num_args = 1..)]
    check_script: Vec<PathBuf>,
    /// Print what of the real machines is real here, modelled or absent, and stop.
    #[arg(long)]
    conformance: bool,
    /// Measure what is published about the real controller on this one, print both, and stop.
    #[arg(long)]
    facts: bool,
}

/// Simulated seconds per second.
///
/// # Errors
/// One sentence that says what to give.
pub fn time_factor(text: &str) -> Result<f64, String> {
    within(text, 0.01..=1000.0, "simulated seconds per second")
}

/// The configuration that is used where no other is at hand.
const BUILT_IN: &str = include_str!("../../../config/sim.yaml");

/// Where it is looked for before that.
const USUAL_PLACE: &str = "config/sim.yaml";

/// The configuration and what to call it in messages.
fn configuration(requested: Option<&Path>) -> Result<(SimFile, String), String> {
    let usual = Path::new(USUAL_PLACE);
    let path = requested.or_else(|| usual.exists().then_some(usual));
    let Some(path) = path else {
        let name = "built-in configuration";
        let file = read_sim(BUILT_IN, name).map_err(|complaints| complaints.to_string())?;
        return Ok((file, name.to_owned()));
    };
    let file = load_sim(path).map_err(|error| error.to_string())?;
    Ok((file, path.display().to_string()))
}

/// Runs the simulator; returns the exit code.
pub fn run(args: &SimArgs) -> u8 {
    if !args.check_script.is_empty() {
        return check_scripts(&args.check_script);
    }
    if args.conformance {
        print(&conformance::page());
        return 0;
    }
    if args.facts {
        print(&facts::page());
        return 0;
    }
    let (mut file, name) = match configuration(args.config.as_deref()) {
        Ok(found) => found,
        Err(message) => {
            complain(&message);
            return 2;
        }
    };
    file.model = args.model.unwrap_or(file.model);
    // Before the ports: PolyScope X has others.
    file.software = args.software.unwrap_or(file.software);
    let bind = match args.bind.map_or_else(|| file.bind.parse::<IpAddr>(), Ok) {
        Ok(bind) => bind,
        Err(error) => {
            complain(&format!("{name}: bind {:?}: {error}", file.bind));
            return 2;
        }
    };
    if args.control && !bind.is_loopback() {
        complain(&format!(
            "--control at {bind}: the control socket breaks things and tells the truth, so it opens on this \
             machine only; give --bind 127.0.0.2, or leave --control out"
        ));
        return 2;
    }
    let mut config = sim_config(&file, bind, RobotPorts::REAL);
    (config.time_factor, config.strict) = (args.time_factor.unwrap_or(file.time_factor), args.strict);
    match args.faults.as_deref().map_or(Ok(Vec::new()), faults_of) {
        Ok(faults) => config.faults = faults,
        Err(message) => {
            complain(&message);
            return 2;
        }
    }
    config.control_port = args.control.then_some(file.ports.control);
    if let Err(error) = config.move_ports(args.port_offset) {
        complain(&error.to_string());
        return 2;
    }
    let runtime =
        tokio::runtime::Builder::new_multi_thread().enable_all().on_thread_start(priority::raise).build();
    match runtime {
        Ok(runtime) => runtime.block_on(serve(config, args.port_offset, args.until_eof)),
        Err(error) => {
            complain(&error.to_string());
            1
        }
    }
}

/// The plans in a fault file.
///
/// # Errors
/// Every complaint, for a terminal.
pub fn faults_of(path: &Path) -> Result<Vec<Planned>, String> {
    let text = cell_edge::terminal::read_text(path)?;
    read_faults(&text, &path.display().to_string()).map_err(|complaints| complaints.to_string())
}

async fn serve(config: SimConfig, port_offset: u16, until_eof: bool) -> u8 {
    cell_edge::memory::keep_large_blocks_apart();
    // Before the ready line: who reads it may end the simulator at once.
    let ended = match end::of_process(until_eof) {
        Ok(ended) => ended,
        Err(error) => {
            complain(&error.to_string());
            return 1;
        }
    };
    let sim = match start(config).await {
        Ok(sim) => sim,
        Err(error @ SimError::Fault(_)) => {
            complain(&rearrange::document::chain::chain(&error));
            return 2;
        }
        Err(error) => {
            complain(&rearrange::document::chain::chain(&error));
            return 1;
        }
    };
    let addresses = &sim.addresses;
    let polyscope_x = sim.robot().controller().core.config.is_polyscope_x();
    let front = addresses.robot.dashboard.to_string();
    let (dashboard, robot_api) = if polyscope_x { (None, Some(front)) } else { (Some(front), None) };
    let ready = json!({
        "ready": true,
        "bind": addresses.robot.rtde.ip().to_string(),
        "port_offset": port_offset,
        "dashboard": dashboard,
        "robot_api": robot_api,
        "robotiq": addresses.robot.robotiq.map(|robotiq| robotiq.to_string()),
        "tool_serial": addresses.robot.tool_serial.map(|serial| serial.to_string()),
        "primary": addresses.robot.primary.to_string(),
        "secondary": addresses.robot.secondary.to_string(),
        "realtime": addresses.robot.realtime.to_string(),
        "interpreter": addresses.robot.interpreter.to_string(),
        "rtde": addresses.robot.rtde.to_string(),
        "controller_modbus": addresses.robot.modbus.map(|modbus| modbus.to_string()),
        "modbus": addresses.modbus.to_string(),
        "camera": addresses.camera.to_string(),
        "control": addresses.control.map(|control| control.to_string()),
        "clock": addresses.clock.then(|| clock_channel::name(addresses.robot.rtde)),
    });
    print(&format!("{ready}\n"));
    ended.await;
    complain(&format!("time factor reached: {:.2}", sim.factor_reached()));
    sim.shutdown().await;
    0
}

/// The simulated cell a configuration describes; its truth deviates from the nominal values by the seed.
pub fn sim_config(file: &SimFile, bind: IpAddr, ports: RobotPorts) -> SimConfig {
    let errors = &file.errors;
    let mut camera = CameraTruth::ideal("sim-d405", PICTURE.0, PICTURE.1, FOCAL_PX);
    camera.noise_sigma = errors.noise_levels;
    let nominal = spec::NominalCell {
        base_from_table: file.base_from_table,
        mount: match file.camera {
            SimMount::Flange(flange_from_camera) => spec::CameraMount::Flange(flange_from_camera),
            SimMount::Fixed(base_from_camera) => {
                spec::CameraMount::Fixed(file.base_from_table.inverse() * base_from_camera)
            }
        },
        camera,
    };
    let limits = spec::TruthLimits {
        table_m: errors.table_m,
        table_rad: errors.table_rad,
        mount_m: errors.mount_m,
        mount_rad: errors.mount_rad,
    };
    let truth = spec::TruthSpec::from_seed(&nominal, &limits, file.seed);
    SimConfig {
        bind,
        ports: robot_ports(file, ports),
        modbus_port: file.ports.modbus,
        camera_port: file.ports.camera,
        control_port: None,
        time_factor: file.time_factor,
        strict: false,
        controller: controller_config(file),
        world: spec::WorldSpec {
            table: spec::TableSpec { width_m: file.width_m, height_m: file.height_m, margin_m: MARGIN_M },
            base_from_table: truth.base_from_table,
            objects: file.objects.iter().filter_map(world_object).collect(),
            reference_markers: file
                .reference_markers
                .iter()
                .map(|m| spec::ReferenceMarker { id: m.id, size_m: m.size_m, pose: m.pose })
                .collect(),
            errors: spec::PlacementErrors {
                std_xy_m: errors.placement_m,
                std_theta_rad: errors.placement_rad,
                ..spec::PlacementErrors::default()
            },
            gripper: gripper_spec(file),
            hand_board: file.hand_board.as_ref().map(hand_board),
        },
        camera: CameraSetup {
            truth: truth.camera,
            reported: truth.reported,
            mount: truth.mount,
            timing: CameraTiming::D405,
        },
        seed: file.seed,
        faults: Vec::new(),
    }
}

/// Those of the controller with what the file says of them; any port stays any.
fn robot_ports(file: &SimFile, ports: RobotPorts) -> RobotPorts {
    let fingers = matches!(file.drive, Drive::Fingers(_)).then_some(file.ports.robotiq);
    RobotPorts {
        dashboard: match controller_config(file).is_polyscope_x() && ports.dashboard != 0 {
            true => file.ports.robot_api,
            false => ports.dashboard,
        },
        modbus: ports.modbus.or(file.ports.controller_modbus),
        robotiq: ports.robotiq.or(fingers),
        tool_serial: ports.tool_serial.or((file.drive == Drive::Vgc10OnTool).then_some(TOOL_SERIAL_PORT)),
        ..ports
    }
}

fn controller_config(file: &SimFile) -> ControllerConfig {
    let usual = ControllerConfig::of(&file.model, file.seed);
    let (payload, payload_centre, tcp) = match file.installation {
        Installation::Bare => (usual.payload, usual.payload_centre, usual.tcp),
        Installation::Gripper => {
            let gripper = &file.gripper;
            (gripper.mass_kg, gripper.centre_of_gravity_m, ur_pose_from_isometry(&file.flange_from_tool))
        }
    };
    ControllerConfig {
        payload,
        payload_centre,
        tcp,
        start: file.start_pose,
        version: file.software,
        encoders: file.encoders,
        belts: file.conveyors.iter().map(|conveyor| table_belt(conveyor, &file.encoders)).collect(),
        control: file.control,
        safety: file.safety.clone(),
        blends: BlendConfig { entry_speed: file.entry_speed, seed: file.seed },
        rest: file.rest,
        programs: file.programs.clone(),
        dh: calibrated(&file.model.dh, file.seed, file.errors.dh_m, file.errors.dh_rad),
        ..usual
    }
}

/// A belt runs as fast as its encoder counts.
fn table_belt(conveyor: &ConveyorConfig, encoders: &[f64; 2]) -> TableBelt {
    let ticks = encoders.get(conveyor.encoder).copied().unwrap_or_default();
    let (speed, (sin, cos)) = (ticks / conveyor.ticks_per_m, conveyor.direction_rad.sin_cos());
    TableBelt { area: conveyor.area, velocity: [speed * cos, speed * sin] }
}

fn world_object(object: &ObjectSpec) -> Option<spec::WorldObject> {
    Some(spec::WorldObject {
        id: object.id.clone(),
        footprint: object.footprint.clone(),
        height_m: object.height?,
        mass_kg: object.mass?,
        pose: object.start?,
        marker: object.marker.as_ref().map(|marker| spec::ObjectMarker {
            id: marker.id,
            size_m: marker.size,
            offset: marker.offset,
        }),
        grippable: object.grippable.clone().map(Footprint::Polygon),
        fixed: object.fixed,
        colour: None,
    })
}

fn hand_board(held: &SimHandBoard) -> spec::HandBoard {
    spec::HandBoard {
        flange_from_board: held.flange_from_board,
        grid: [held.board.columns, held.board.rows],
        size_m: held.board.size_m,
        gap_m: held.board.gap_m,
        first_id: held.board.first_id,
    }
}

fn gripper_spec(file: &SimFile) -> spec::GripperSpec {
    let gripper = &file.gripper;
    let channel = |channel| match channel {
        CupChannel::A => Channel::A,
        CupChannel::B => Channel::B,
    };
    let cups = gripper.cups.iter().map(|cup| spec::Cup {
        channel: channel(cup.channel),
        x_m: cup.x_m,
        y_m: cup.y_m,
        diameter_m: cup.diameter_m,
    });
    spec::GripperSpec {
        drive: file.drive,
        clients: file.compute_box,
        overshoot: 0.0,
        flange_from_tool: file.flange_from_tool,
        cups: cups.collect(),
        // A body that cannot be drawn is no reason to stop: it only hides part of a picture.
        body: Footprint::polygon(&gripper.body_polygon).unwrap_or(Footprint::Disc { radius: 0.04 }),
        body_above_lips_m: gripper.body_height_m,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_installation_has_the_gripper_if_the_file_says_so() {
        const SIM: &str = include_str!("../../../config/sim.yaml");
        let installed = |word: &str| {
            let text = SIM.replace("\ninstallation: bare\n", &format!("\ninstallation: {word}\n"));
            let config = controller_config(&read_sim(&text, "sim.yaml").unwrap());
            (config.payload, config.payload_centre, config.tcp)
        };
        assert_eq!(installed("bare"), (0.0, [0.0; 3], [0.0; 6]));
        let gripper = (1.72, [0.0, -0.005, 0.065], [0.0, 0.0, 0.2, 0.0, 0.0, 0.0]);
        assert_eq!(installed("gripper"), gripper);
    }
}
