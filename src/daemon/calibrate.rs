//! `celld calibrate`: drives the arm through the calibration poses, looks, and solves hand-eye and table.
//!
//! In: the cell's configuration (nominal mount and table as a start, surveyed reference markers, calibration
//! poses) and live devices. Out: the solution with its residuals; the caller writes the files. Motion is on
//! the operator's order only, through checked joint paths, at a speed that keeps the tool under 0.1 m/s
//! (design, section 7, rule 1, class *calibrate*).

use crate::daemon::hardware::{Happening, Hardware};
use crate::device::program::Nonce;
use crate::device::robot_types::{RobotCommand, RobotEvent};
use crate::io::camera::CameraSource;
use crate::motion::kinematics::{DhParameters, forward};
use crate::motion::path::{ArmModel, CheckedPath, Leg, PathFault, Segment};
use crate::supervisor::gates::{Closed, any_motion};
use crate::time::Timestamp;
use crate::units::Joints;
use crate::vision::calibrate::Sample;
use crate::vision::detect::{Detection, Detector};
use crate::wire::enumerations::RobotMode;
use std::time::Duration;

/// Why a calibration run ended without samples.
#[derive(Debug, thiserror::Error)]
pub enum DriveError {
    /// A device did not come up or stopped answering.
    #[error("{what} within {seconds} s; see that {address} is the robot, powered and in remote control")]
    Deadline {
        /// What was waited for.
        what: String,
        /// How long.
        seconds: u64,
        /// Address of the device.
        address: String,
    },
    /// The robot reported trouble.
    #[error("the robot stopped: {0}")]
    Robot(String),
    /// Motion is not allowed.
    #[error("no motion: {0}")]
    Closed(#[from] Closed),
    /// A calibration pose cannot be reached safely.
    #[error("calibration pose {pose}")]
    Path {
        /// Its number, from 1.
        pose: usize,
        /// Why.
        #[source]
        fault: PathFault,
    },
    /// The camera failed.
    #[error("camera: {0}")]
    Camera(String),
    /// The operator stopped it.
    #[error("stopped by the operator")]
    Stopped,
}

/// Highest tool speed while calibrating, m/s, and the reach it is reckoned at, m.
const TOOL_SPEED: f64 = 0.1;
const REACH: f64 = 0.9;

/// Lowest height of the cups over the nominal table while calibrating, m.
const FLOOR: f64 = 0.05;

/// The arm counts as still below this joint speed, rad/s, for this long.
const STILL_RAD_S: f64 = 5e-4;
const SETTLE: Duration = Duration::from_millis(500);

/// Which arm it is, as the controller says.
#[derive(Clone, Debug, PartialEq)]
pub struct Arm {
    /// Calibrated kinematics.
    pub dh: DhParameters,
    /// Checksum of the kinematics, hex.
    pub checksum: String,
    /// Serial number.
    pub serial: String,
}

/// Kinematics and identity of the arm, as the controller reports them when it is connected.
///
/// # Errors
/// [`DriveError::Deadline`] when the controller does not say, [`DriveError::Stopped`].
pub async fn kinematics(
    hardware: &mut Hardware,
    address: &str,
    stop: &dyn Fn() -> bool,
) -> Result<Arm, DriveError> {
    let started = hardware.now();
    let mut kinematics: Option<(DhParameters, String)> = None;
    let mut serial = String::new();
    loop {
        for happening in hardware.next().await {
            match happening {
                Happening::Robot(RobotEvent::Kinematics { dh, checksum }) => {
                    kinematics = Some((dh, checksum.map(|word| format!("{word:08x}")).concat()));
                }
                Happening::Robot(RobotEvent::Identity { serial: reported, .. }) => serial = reported,
                _ => {}
            }
        }
        let known = !serial.is_empty() && hardware.robot().state().is_some();
        if let Some((dh, checksum)) = kinematics.clone().filter(|_| known) {
            return Ok(Arm { dh, checksum, serial });
        }
        guard(hardware, started, 30, "the robot did not answer on all its ports", address, stop)?;
    }
}

/// Powers the arm, releases the brakes, starts the on-robot program.
///
/// # Errors
/// What kept the robot from coming up.
pub async fn bring_up(
    hardware: &mut Hardware,
    nonce: Nonce,
    address: &str,
    stop: &dyn Fn() -> bool,
) -> Result<(), DriveError> {
    let started = hardware.now();
    let mut asked: Option<RobotMode> = None;
    let mut program_asked = false;
    loop {
        trouble(&hardware.next().await)?;
        let Some(robot) = hardware.robot().state() else { continue };
        let (mode, running_ours) = (robot.robot_mode, robot.nonce == nonce.number() && program_asked);
        let command = match mode {
            RobotMode::PowerOff if asked != Some(mode) => Some(RobotCommand::PowerOn),
            RobotMode::Idle if asked != Some(mode) => Some(RobotCommand::ReleaseBrakes),
            RobotMode::Running if running_ours => return Ok(()),
            RobotMode::Running if !program_asked => {
                program_asked = true;
                Some(RobotCommand::StartProgram { nonce })
            }
            _ => None,
        };
        if let Some(command) = command {
            asked = Some(mode);
            if let Some(RobotEvent::Refused { what, reply }) = hardware.command_robot(command) {
                return Err(DriveError::Robot(format!("{what} refused: {reply}")));
            }
        }
        guard(hardware, started, 60, "the robot did not come up", address, stop)?;
    }
}

/// Moves to `target` on a checked joint path and waits until the arm stands still there.
///
/// # Errors
/// The path's fault, or what interrupted the motion.
pub async fn move_to(round: &mut Round<'_>, pose: usize, target: Joints) -> Result<Joints, DriveError> {
    let started = round.hardware.now();
    any_motion(true, &round.hardware.outside(started), Some(round.nonce))?;
    let Some(q) = round.hardware.robot().state().map(|robot| robot.q) else {
        return Err(Closed::Stale.into());
    };
    let limits = &round.model.limits;
    let speed = limits.joint_speed.min(TOOL_SPEED / REACH);
    let segment = Segment::Joint { target, speed, acceleration: limits.joint_acceleration, blend: 0.0 };
    let path = CheckedPath::new(round.model, &q, &[Leg { segment, floor: FLOOR }])
        .map_err(|fault| DriveError::Path { pose, fault })?;
    if let Some(RobotEvent::Refused { what, reply }) =
        round.hardware.command_robot(RobotCommand::Stream(path))
    {
        return Err(DriveError::Robot(format!("{what} refused: {reply}")));
    }
    let mut finished = false;
    let mut still_since: Option<Timestamp> = None;
    loop {
        let happenings = round.hardware.next().await;
        trouble(&happenings)?;
        let at_end = |h: &Happening| matches!(h, Happening::Robot(RobotEvent::PathFinished { .. }));
        finished |= happenings.iter().any(at_end);
        let now = round.hardware.now();
        if let Some(robot) = round.hardware.robot().state().filter(|_| finished) {
            if robot.qd.iter().any(|speed| speed.abs() > STILL_RAD_S) {
                still_since = None;
            } else if now.since(*still_since.get_or_insert(now)) >= SETTLE {
                return Ok(robot.q);
            }
        }
        guard(round.hardware, started, 120, "the pose was not reached", "", round.stop)?;
    }
}

/// Camera and detector, lent to a blocking thread for every frame.
pub struct Eye {
    /// Where frames come from.
    pub camera: Box<dyn CameraSource + Send>,
    /// What finds the markers.
    pub detector: Detector,
}

/// The arm and the program that moves it, for the length of a calibration round.
pub struct Round<'a> {
    /// Robot and gripper.
    pub hardware: &'a mut Hardware,
    /// The arm, with the nominal table.
    pub model: &'a ArmModel,
    /// Nonce of the running program.
    pub nonce: Nonce,
    /// The operator's stop.
    pub stop: &'a dyn Fn() -> bool,
}

/// Visits the poses and takes a picture at each; `progress` hears the pose's number and the markers found.
///
/// # Errors
/// What interrupted the round; the arm is told to stop.
pub async fn collect(
    round: &mut Round<'_>,
    poses: &[Joints],
    mut eye: Eye,
    progress: &dyn Fn(usize, usize),
) -> Result<Vec<Sample>, DriveError> {
    let mut samples = Vec::with_capacity(poses.len());
    for (index, pose) in poses.iter().enumerate() {
        let q = match move_to(round, index + 1, *pose).await {
            Ok(q) => q,
            Err(error) => {
                round.hardware.command_robot(RobotCommand::Stop);
                round.hardware.next().await;
                return Err(error);
            }
        };
        let (returned, detections) = detect(round.hardware, eye).await?;
        eye = returned;
        progress(index + 1, detections.len());
        samples.push(Sample { base_from_flange: forward(&round.model.dh, &q), detections });
    }
    Ok(samples)
}

/// Markers of one new frame. The frame is taken on another thread, so that the robot's heartbeat goes on.
async fn detect(hardware: &mut Hardware, mut eye: Eye) -> Result<(Eye, Vec<Detection>), DriveError> {
    let task = tokio::task::spawn_blocking(move || {
        let frame = eye.camera.grab().map_err(|error| error.to_string());
        let found = frame
            .and_then(|frame| eye.detector.detect(&frame.image.gray()).map_err(|error| error.to_string()));
        (eye, found)
    });
    while !task.is_finished() {
        trouble(&hardware.next().await)?;
    }
    let (eye, found) = task.await.map_err(|error| DriveError::Camera(error.to_string()))?;
    Ok((eye, found.map_err(DriveError::Camera)?))
}

fn trouble(happenings: &[Happening]) -> Result<(), DriveError> {
    for happening in happenings {
        let message = match happening {
            Happening::Robot(RobotEvent::ProgramEnded { reason }) => reason.to_string(),
            Happening::Robot(RobotEvent::RuntimeException { line, text, .. }) => {
                format!("line {line}: {text}")
            }
            Happening::Robot(RobotEvent::Refused { what, reply }) => format!("{what}: {reply}"),
            _ => continue,
        };
        return Err(DriveError::Robot(message));
    }
    Ok(())
}

fn guard(
    hardware: &Hardware,
    since: Timestamp,
    seconds: u64,
    what: &str,
    address: &str,
    stop: &dyn Fn() -> bool,
) -> Result<(), DriveError> {
    if stop() {
        return Err(DriveError::Stopped);
    }
    if hardware.now().since(since) > Duration::from_secs(seconds) {
        let (what, address) = (what.to_string(), address.to_string());
        return Err(DriveError::Deadline { what, seconds, address });
    }
    Ok(())
}
