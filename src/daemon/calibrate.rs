//! `celld calibrate`: drives the arm through the calibration poses, looks, and solves hand-eye and table.
//!
//! In: the cell's configuration (nominal mount and table as a start, surveyed reference markers, calibration
//! poses) and live devices. Out: the solution with its residuals; the caller writes the files. Motion is on
//! the operator's order only, through checked joint paths, at a speed that keeps the tool under 0.1 m/s
//! (design, section 7, rule 1, class *calibrate*).

use crate::config::cell::{CalibrationBox, CameraMount, CellConfig};
use crate::daemon::cameras::trouble_of;
use crate::daemon::hardware::{Happening, Hardware};
use crate::daemon::setup::{arm_model, reference_markers};
use crate::device::program::Nonce;
use crate::device::robot_types::{RobotCommand, RobotEvent, RobotState};
use crate::geometry::pose::ur_pose_from_isometry;
use crate::io::camera::CameraSource;
use crate::motion::kinematics::{DhParameters, forward};
use crate::motion::path::{ArmModel, CheckedPath, Leg, PathFault, Segment};
use crate::supervisor::gates::{Closed, any_motion};
use crate::time::Timestamp;
use crate::units::{Joints, mm_from_m};
use crate::vision::calibrate::{
    CalibrateError, HandEye, HandEyeGuess, HandEyeSettings, Sample, solve_hand_eye,
};
use crate::vision::camera::CameraModel;
use crate::vision::detect::{Detection, Detector};
use crate::vision::image::Image;
use crate::wire::enumerations::{RobotMode, RuntimeState};
use nalgebra::Isometry3;
use std::time::Duration;

/// Why a calibration run ended without samples.
#[derive(Debug, thiserror::Error)]
pub enum DriveError {
    /// A device did not come up or stopped answering.
    #[error(
        "{what} within {seconds} s ({links}); see that `devices.robot` is its address, that it is powered and in \
         remote control, and try `ping`; for a simulated one start `celld sim`"
    )]
    Deadline {
        /// What was waited for.
        what: String,
        /// How long.
        seconds: u64,
        /// Which links are down, and why.
        links: String,
    },
    /// The camera does not sit where this solver looks for it.
    #[error("the configuration's camera is not mounted on the flange")]
    FixedCamera,
    /// The arm would leave the taught box, or stands outside of it.
    #[error(
        "{what} {outside_mm:.0} mm outside the calibration box: jog the arm into it, or widen `calibration_box` as far as the \
         arm's reach is free of people and things"
    )]
    OutsideBox {
        /// Who is outside.
        what: String,
        /// How far, mm.
        outside_mm: f64,
    },
    /// The samples do not give a solution.
    #[error("calibration")]
    Solve(#[from] CalibrateError),
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

/// Highest tool speed while calibrating, m/s (design, section 7, rule 1).
const TOOL_SPEED: f64 = 0.1;

/// Pieces a move is cut into to find where its tool is fastest.
const TRAVEL_SAMPLES: usize = 200;

/// Lowest height of the cups over the nominal table while calibrating, m.
const FLOOR: f64 = 0.05;

/// The arm counts as still below this joint speed, rad/s, for this long.
const STILL_RAD_S: f64 = 5e-4;
const SETTLE: Duration = Duration::from_millis(500);

/// For a state before a move, s.
const STATE_WITHIN: u64 = 5;

/// Between the order to end the program and its end.
const END_WITHIN: u64 = 10;

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
pub async fn kinematics(hardware: &mut Hardware, stop: &dyn Fn() -> bool) -> Result<Arm, DriveError> {
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
        guard(hardware, started, 30, "the robot did not answer on all its ports", stop)?;
    }
}

/// What a calibration round works with.
pub struct Setting<'a> {
    /// The cell: nominal mount and table, survey, calibration poses, limits.
    pub config: &'a CellConfig,
    /// Number of the program that will be started; no other run may have used it.
    pub nonce: Nonce,
    /// The operator's stop.
    pub stop: &'a dyn Fn() -> bool,
    /// Hears of each pose with what was seen from it.
    pub progress: &'a dyn Fn(&Look),
}

/// One stop of a calibration round.
pub struct Look<'a> {
    /// The pose's number, from 1.
    pub pose: usize,
    /// The picture taken there.
    pub image: &'a Image,
    /// Where the flange was and which markers were found.
    pub sample: &'a Sample,
}

/// The whole round: wakes the arm, visits the poses, looks, ends the program. The arm stands afterwards, whatever
/// happened.
///
/// # Errors
/// What kept the robot from coming up or interrupted the round.
pub async fn measure(
    hardware: &mut Hardware,
    eye: Eye,
    setting: &Setting<'_>,
) -> Result<(Arm, Vec<Sample>), DriveError> {
    let arm = kinematics(hardware, setting.stop).await?;
    let samples = visit(hardware, &arm, &setting.config.calibration_poses, eye, setting).await?;
    Ok((arm, samples))
}

/// The same through given poses, with an arm whose kinematics are known.
///
/// # Errors
/// What kept the robot from coming up or interrupted the round.
pub async fn visit(
    hardware: &mut Hardware,
    arm: &Arm,
    poses: &[Joints],
    eye: Eye,
    setting: &Setting<'_>,
) -> Result<Vec<Sample>, DriveError> {
    bring_up(hardware, setting).await?;
    let model = arm_model(setting.config, arm.dh, setting.config.base_from_table);
    let room = setting.config.calibration_box;
    let mut round = Round { hardware, model: &model, room, nonce: setting.nonce, stop: setting.stop };
    let samples = collect(&mut round, poses, eye, setting.progress).await;
    let ended = end_program(hardware).await;
    let samples = samples?;
    ended.map(|()| samples)
}

/// Camera mount and table from the samples, starting at the configuration's nominal values.
///
/// With a known mount only the table is solved for.
///
/// # Errors
/// The solver's, or that the camera does not sit on the flange.
pub fn solve(
    config: &CellConfig,
    lens: &CameraModel,
    samples: &[Sample],
    known_mount: Option<Isometry3<f64>>,
) -> Result<HandEye, DriveError> {
    let CameraMount::Flange { flange_from_camera } = config.camera else {
        return Err(DriveError::FixedCamera);
    };
    let flange_from_camera = known_mount.unwrap_or(flange_from_camera);
    let guess = HandEyeGuess { flange_from_camera, base_from_table: config.base_from_table };
    let settings = HandEyeSettings { keep_mount: known_mount.is_some(), ..HandEyeSettings::default() };
    Ok(solve_hand_eye(samples, &reference_markers(config), lens, &guess, &settings)?)
}

/// Powers the arm, releases the brakes, starts the on-robot program, tells it what hangs on the flange.
async fn bring_up(hardware: &mut Hardware, setting: &Setting<'_>) -> Result<(), DriveError> {
    let started = hardware.now();
    let mut asked: Option<RobotMode> = None;
    let mut program_asked = false;
    loop {
        guard(hardware, started, 60, "the robot did not come up", setting.stop)?;
        trouble(&hardware.next().await)?;
        // Whether remote control is on is asked after the first state has come; until then every command would be refused.
        let told = |robot: &&RobotState| robot.remote_control.is_some();
        let Some(robot) = hardware.robot().state().filter(told) else { continue };
        let (mode, running_ours) = (robot.robot_mode, robot.nonce == setting.nonce.number() && program_asked);
        let command = match mode {
            RobotMode::PowerOff if asked != Some(mode) => RobotCommand::PowerOn,
            RobotMode::Idle if asked != Some(mode) => RobotCommand::ReleaseBrakes,
            RobotMode::Running if running_ours => break,
            RobotMode::Running if !program_asked => {
                program_asked = true;
                RobotCommand::StartProgram { nonce: setting.nonce }
            }
            _ => continue,
        };
        asked = Some(mode);
        order(hardware, command)?;
    }
    let gripper = &setting.config.gripper;
    order(hardware, RobotCommand::SetTcp(ur_pose_from_isometry(&setting.config.flange_from_tool)))?;
    let centre_of_gravity_m = gripper.centre_of_gravity_m;
    order(hardware, RobotCommand::SetPayload { mass_kg: gripper.mass_kg, centre_of_gravity_m })
}

/// Gives a command; a refusal is an error.
fn order(hardware: &mut Hardware, command: RobotCommand) -> Result<(), DriveError> {
    match hardware.command_robot(command) {
        Some(RobotEvent::Refused { what, reply }) => {
            Err(DriveError::Robot(format!("{what} refused: {reply}")))
        }
        _ => Ok(()),
    }
}

/// Ends the program and waits until it is over, so that another can be started.
async fn end_program(hardware: &mut Hardware) -> Result<(), DriveError> {
    let started = hardware.now();
    // A round that failed has stopped the arm; then there may be no program left to end.
    let _ = hardware.command_robot(RobotCommand::EndProgram);
    loop {
        hardware.next().await;
        let over = |state: &RobotState| state.runtime_state == RuntimeState::Stopped;
        if hardware.robot().program_settled() && hardware.robot().state().is_none_or(over) {
            return Ok(());
        }
        guard(hardware, started, END_WITHIN, "the on-robot program did not end", &|| false)?;
    }
}

/// The check that every move of a calibration passes: reach, limits and heights of the arm, and that the flange stays
/// in the taught box where there is one.
///
/// # Errors
/// `Path` or `OutsideBox`; `pose` is the number that they name.
pub fn checked_move(
    model: &ArmModel,
    room: Option<&CalibrationBox>,
    pose: usize,
    from: &Joints,
    target: Joints,
) -> Result<CheckedPath, DriveError> {
    let speed = slow_enough(model, from, &target);
    let segment = Segment::Joint { target, speed, acceleration: model.limits.joint_acceleration, blend: 0.0 };
    let path = CheckedPath::new(model, from, &[Leg { segment, floor: FLOOR }])
        .map_err(|fault| DriveError::Path { pose, fault })?;
    let Some(room) = room else { return Ok(path) };
    for k in 0..=TRAVEL_SAMPLES {
        let q = between(from, &target, k as f64 / TRAVEL_SAMPLES as f64);
        let outside_m = room.outside_m(&forward(&model.dh, &q).translation.vector);
        if outside_m > 0.0 {
            let what = match k {
                0 => "the flange is".to_string(),
                TRAVEL_SAMPLES => format!("calibration pose {pose} is"),
                _ => format!("on the way to calibration pose {pose} the flange would be"),
            };
            return Err(DriveError::OutsideBox { what, outside_mm: mm_from_m(outside_m) });
        }
    }
    Ok(path)
}

/// The joints a share of the way along a joint move.
fn between(from: &Joints, to: &Joints, share: f64) -> Joints {
    Joints(std::array::from_fn(|i| from.0[i] + share * (to.0[i] - from.0[i])))
}

/// Moves to `target` on a checked joint path and waits until the arm stands still there.
///
/// # Errors
/// The path's fault, or what interrupted the motion.
async fn move_to(round: &mut Round<'_>, pose: usize, target: Joints) -> Result<Joints, DriveError> {
    let started = round.hardware.now();
    // Whoever heard of the last picture may have taken a moment in which no state was read.
    while !round.hardware.robot().fresh(round.hardware.now()) {
        guard(round.hardware, started, STATE_WITHIN, "the robot did not say where it is", round.stop)?;
        round.hardware.next().await;
    }
    let now = round.hardware.now();
    any_motion(true, &round.hardware.outside(now), Some(round.nonce))?;
    let Some(q) = round.hardware.robot().state().map(|robot| robot.q) else {
        return Err(Closed::Stale.into());
    };
    let path = checked_move(round.model, round.room.as_ref(), pose, &q, target)?;
    // Who pressed Ctrl-C while the arm stood for a picture wants it to go on standing.
    if (round.stop)() {
        return Err(DriveError::Stopped);
    }
    order(round.hardware, RobotCommand::Stream(path))?;
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
        guard(round.hardware, started, 120, "the pose was not reached", round.stop)?;
    }
}

/// Speed of the leading joint (rad/s) at which the tool stays below [`TOOL_SPEED`] all along the move.
fn slow_enough(model: &ArmModel, from: &Joints, to: &Joints) -> f64 {
    let travel = from.max_difference(to);
    let at =
        |k: usize| model.tool_at(&between(from, to, k as f64 / TRAVEL_SAMPLES as f64)).translation.vector;
    let steps = (0..TRAVEL_SAMPLES).map(|k| (at(k + 1) - at(k)).norm());
    let metres_per_rad = steps.fold(0.0, f64::max) * TRAVEL_SAMPLES as f64 / travel.max(1e-9);
    // A move that hardly moves the tool needs no limit of ours.
    model.limits.joint_speed.min(TOOL_SPEED / metres_per_rad.max(1e-3))
}

/// Camera and detector, lent to a blocking thread for every frame.
pub struct Eye {
    /// Where frames come from.
    pub camera: Box<dyn CameraSource + Send>,
    /// What finds the markers.
    pub detector: Detector,
}

/// The arm and the program that moves it, for the length of a calibration round.
struct Round<'a> {
    hardware: &'a mut Hardware,
    /// With the nominal table.
    model: &'a ArmModel,
    /// Where the flange has to stay.
    room: Option<CalibrationBox>,
    /// Of the running program.
    nonce: Nonce,
    /// The operator's.
    stop: &'a dyn Fn() -> bool,
}

/// Visits the poses and takes a picture at each; `progress` hears of it.
///
/// # Errors
/// What interrupted the round; the arm is told to stop.
async fn collect(
    round: &mut Round<'_>,
    poses: &[Joints],
    mut eye: Eye,
    progress: &dyn Fn(&Look),
) -> Result<Vec<Sample>, DriveError> {
    let mut samples = Vec::with_capacity(poses.len());
    for (index, pose) in poses.iter().enumerate() {
        let looked = match move_to(round, index + 1, *pose).await {
            Ok(q) => detect(round, eye).await.map(|seen| (q, seen)),
            Err(error) => Err(error),
        };
        let (q, (returned, image, detections)) = match looked {
            Ok(looked) => looked,
            Err(error) => {
                round.hardware.command_robot(RobotCommand::Stop);
                round.hardware.next().await;
                return Err(error);
            }
        };
        eye = returned;
        let sample = Sample { base_from_flange: forward(&round.model.dh, &q), detections };
        progress(&Look { pose: index + 1, image: &image, sample: &sample });
        samples.push(sample);
    }
    Ok(samples)
}

/// One new frame and its markers. The frame is taken on another thread, so that the robot's heartbeat goes on. How long that
/// may take is the camera's to bound, which gives up by itself (`io::camera::supervised`).
async fn detect(round: &mut Round<'_>, mut eye: Eye) -> Result<(Eye, Image, Vec<Detection>), DriveError> {
    let task = tokio::task::spawn_blocking(move || {
        eye.camera.want_depth(false);
        let frame = eye.camera.grab().map_err(|error| trouble_of(&error).message);
        let found = frame.and_then(|frame| {
            let seen = eye.detector.detect(&frame.image.gray()).map_err(|error| error.to_string())?;
            Ok((frame.image, seen))
        });
        (eye, found)
    });
    while !task.is_finished() {
        trouble(&round.hardware.next().await)?;
        if (round.stop)() {
            return Err(DriveError::Stopped);
        }
    }
    let (eye, found) = task.await.map_err(|error| DriveError::Camera(error.to_string()))?;
    let (image, detections) = found.map_err(DriveError::Camera)?;
    Ok((eye, image, detections))
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
    stop: &dyn Fn() -> bool,
) -> Result<(), DriveError> {
    if stop() {
        return Err(DriveError::Stopped);
    }
    if hardware.now().since(since) > Duration::from_secs(seconds) {
        let links = hardware.why_down();
        let links = if links.is_empty() { "all links stand".to_string() } else { links.join("; ") };
        return Err(DriveError::Deadline { what: what.to_string(), seconds, links });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::path::ArmLimits;
    use nalgebra::Isometry3;
    use std::f64::consts::TAU;

    fn model() -> ArmModel {
        let limits = ArmLimits {
            joint_range: [(-TAU, TAU); 6],
            joint_speed: 2.0,
            joint_acceleration: 4.0,
            tool_speed: 0.5,
            tool_acceleration: 2.0,
            link_floor: 0.03,
        };
        ArmModel {
            dh: DhParameters::UR5E,
            base_from_table: Isometry3::identity(),
            flange_from_tool: Isometry3::translation(0.0, 0.0, 0.2),
            home: Joints([0.0, -1.5, 1.5, -1.5, -1.5, 0.0]),
            limits,
        }
    }

    #[test]
    fn no_move_leaves_the_box_at_its_ends_or_on_its_way() {
        let model = model();
        // The base turns: the way swings out beyond the line between its ends.
        let turned = |turn: f64| Joints([turn, -1.4, 1.2, -1.4, -1.5, 0.0]);
        let (from, to) = (turned(-0.8), turned(0.8));
        let at = |q: &Joints| -> [f64; 3] { forward(&model.dh, q).translation.vector.into() };
        let around = |places: &[Joints]| {
            let wide = CalibrationBox::around(places.iter().map(at)).unwrap();
            CalibrationBox { low_m: wide.low_m.map(|v| v - 0.01), high_m: wide.high_m.map(|v| v + 0.01) }
        };
        let move_in = |room: &CalibrationBox, from: &Joints, to: Joints| {
            checked_move(&model, Some(room), 7, from, to).map(|_| ()).map_err(|error| error.to_string())
        };
        let steps: Vec<Joints> = (-8..=8).map(|k| turned(0.1 * f64::from(k))).collect();
        move_in(&around(&steps), &from, to).unwrap();
        let ends = around(&[from, to]);
        let told = move_in(&ends, &from, to).unwrap_err();
        assert!(told.contains("on the way to calibration pose 7"), "{told}");
        let near = around(&[from, turned(-0.7)]);
        let told = move_in(&near, &to, from).unwrap_err();
        assert!(told.starts_with("the flange is") && told.contains("outside the calibration box"), "{told}");
        // All of the way is in this one, but for its last half step.
        let (before, end) = (between(&from, &to, 1.0 - 0.5 / TRAVEL_SAMPLES as f64), at(&to));
        let mut short = CalibrationBox { low_m: [-2.0; 3], high_m: [2.0; 3] };
        let axis = usize::from((end[1] - at(&from)[1]).abs() > (end[0] - at(&from)[0]).abs());
        let bound = if end[axis] > at(&from)[axis] { &mut short.high_m } else { &mut short.low_m };
        bound[axis] = at(&before)[axis];
        let told = move_in(&short, &from, to).unwrap_err();
        assert!(told.starts_with("calibration pose 7 is"), "{told}");
        checked_move(&model, None, 7, &from, to).unwrap();
    }

    #[test]
    fn the_tool_stays_slow_with_all_joints_moving_and_the_arm_stretched() {
        let model = model();
        let (from, to) =
            (Joints([0.0, -0.9, 0.2, -0.7, -1.5, 0.0]), Joints([0.6, -0.4, 0.1, -0.9, -1.2, 0.3]));
        let speed = slow_enough(&model, &from, &to);
        // At that speed the leading joint needs so long for a thousandth of the way:
        let seconds = from.max_difference(&to) / speed / 1000.0;
        let mut fastest: f64 = 0.0;
        let at = |k: usize| {
            let mut q = from;
            (0..6).for_each(|j| q.0[j] += (to.0[j] - from.0[j]) * k as f64 / 1000.0);
            model.tool_at(&q).translation.vector
        };
        for k in 0..1000 {
            fastest = fastest.max((at(k + 1) - at(k)).norm() / seconds);
        }
        assert!((0.09..=0.1005).contains(&fastest), "{fastest} m/s");
        assert_eq!(slow_enough(&model, &from, &from), 2.0, "no way, no limit");
    }
}
