//! The probes: sockets, camera, files and clock of this computer, opened once and for reading.
//!
//! In: the configuration, the state folder. Out: facts, as plain values, for the rest of the module to
//! judge. The links to the controller are those of the daemon: the same sessions read the same bytes, so
//! that what the doctor finds good is good for the daemon. While a daemon runs on the state folder, its
//! gripper and camera are left alone: both have one master.

pub mod camera;
pub mod computer;
pub mod gripper;
pub mod robot;

use crate::config::calibrated::{measured, read_calibration};
use crate::config::cell::CellConfig;
use crate::config::setup::Measured;
use crate::doctor::gripper::GripperFacts;
use crate::doctor::robot::RobotFacts;
use crate::doctor::{Area, Line, Sheet, arming, files};
use crate::jobs::state::StateFolder;
use cell_calibration::files::set::CalibrationSet;
use cell_edge::clock::unix_now_s;
use cell_machine::device::gripper_types::GripperFault;
use cell_machine::event::Arm;
use cell_machine::supervisor::gates;
use cell_machine::supervisor::input::DeviceSnapshot;

/// Looks at everything; `say` gets a few words before each part, for a person who waits.
pub fn examine(name: &str, config: &CellConfig, state: &StateFolder, say: &mut dyn FnMut(&str)) -> Sheet {
    let unix_s = unix_now_s();
    let daemon = state.is_taken().unwrap_or(false);
    let mut lines = vec![files::configuration(config, config.simulation.is_some())];
    let set = read_calibration(config);
    lines.extend(files::calibration(&set, unix_s));

    say("this computer: clock, disk, how late it wakes up");
    lines.extend(computer::facts(state.root(), unix_s).lines());

    say(&format!("the controller at {}", config.devices.robot_host));
    let robot = robot::facts(config, daemon);
    lines.extend(robot.lines());
    let arm = arm_of(&robot);
    let mut known = None;
    if let (Ok(set), Some(arm)) = (&set, &arm) {
        lines.push(files::fits(config, set, arm));
        known = calibrated(config, set, arm);
    }
    lines.extend(known.iter().flat_map(|measured| files::taught_poses(config, measured)));
    if let (Some(measured), Some(arm)) = (&known, &arm) {
        lines.push(files::blends(config, measured, arm));
    }

    if daemon {
        lines.extend([Area::Gripper, Area::Camera].map(in_use));
        lines.push(in_use(Area::Arming));
        return Sheet::new(name.to_string(), unix_s, lines);
    }
    say("the gripper");
    let gripper = gripper::facts(config, state);
    lines.extend(gripper.lines());
    say("the camera");
    lines.extend(camera::facts(config, known.as_ref(), &robot).lines());
    lines.push(arming_line(&robot, &gripper));
    Sheet::new(name.to_string(), unix_s, lines)
}

/// What a running celld has for itself.
fn in_use(area: Area) -> Line {
    let hint = "`celld status` says what it sees; end it for more";
    Line::note(area, "in use", "a celld runs on this state folder", hint)
}

/// Which arm it is, if all of it is known.
fn arm_of(robot: &RobotFacts) -> Option<Arm> {
    let primary = robot.primary.as_ref().ok()?;
    let dashboard = robot.dashboard.as_ref().ok()?;
    let (serial, software) = (dashboard.serial.clone()?, dashboard.version.clone()?);
    Some(Arm { dh: primary.dh?, checksum: primary.checksum.clone(), serial, software })
}

/// The numbers the daemon would work with. A calibration of another arm has its own line; its numbers say
/// nothing about this one.
fn calibrated(config: &CellConfig, set: &CalibrationSet, arm: &Arm) -> Option<Measured> {
    measured(config, set, arm).ok()
}

/// What `celld arm` would answer, from the same gates.
fn arming_line(robot: &RobotFacts, gripper: &GripperFacts) -> Line {
    let state = robot.rtde.as_ref().ok().and_then(|rtde| rtde.state.clone());
    let remote = robot.dashboard.as_ref().ok().and_then(|dashboard| dashboard.remote_control);
    let state = state.map(|mut state| {
        state.remote_control = remote;
        state
    });
    let down = robot.link_down();
    let devices = DeviceSnapshot {
        link_down: down,
        link_lost: down,
        all_links_lost: false,
        robot_fresh: state.is_some(),
        robot: state.as_ref(),
        program_settled: true,
        arm_settled: true,
        gripper_holds: false,
        gripper_answers: gripper.vacuum.is_ok(),
        gripper_fault: gripper.vacuum.as_ref().err().map(GripperFault::from).unwrap_or_default(),
        gripper_identity: gripper.identity.as_ref().ok().copied(),
        vacuum: gripper.vacuum.clone().ok(),
    };
    let confirmed = || gates::confirmed(&gripper.confirmed, gripper.identity.as_ref().ok());
    arming(gates::arming(&devices).and_then(|()| confirmed()))
}
