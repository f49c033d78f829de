//! A program carried out by a simulated arm, as fast as the computer computes.
//!
//! In: the program, which controller, where the arm is at first, for how long. Out: its [`Track`] of
//! every frame, and what the controller said meanwhile. The arm has nothing in reach but itself.

use crate::compare::track::Track;
use crate::controller::ControllerConfig;
use crate::session::Port;
use crate::simulator::{Simulator, SimulatorError, Transmission};
use crate::world::spec::{GripperSpec, WorldSpec};
use cell_values::units::Joints;
use nalgebra::Isometry3;
use ur_arm::kinematics::{ArmModel, DhParameters};
use ur_wire::primary::{HEADER, Package};
use ur_wire::primary_message::MessageBody;
use urscript::code::Code;

/// How far below the arm the table is, m: out of reach of all of them.
const TABLE_M: f64 = -5.0;

/// Frames in a second.
const FRAMES_A_SECOND: f64 = 500.0;

/// A program that does not end is watched for twice the recording's length and this, s.
const LONGER_S: f64 = 10.0;

/// Most words of the controller that are kept.
const MOST_REMARKS: usize = 10;

/// Which controller.
#[derive(Clone, Copy, Debug)]
pub struct Replayed {
    /// Which arm.
    pub arm: ArmModel,
    /// Its own kinematics; absent: those of the model. A recording does not have them.
    pub kinematics: Option<DhParameters>,
    /// Software version, if not the usual one.
    pub software: Option<[u32; 4]>,
}

/// Why there is nothing to compare.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// No such pose.
    #[error("joint {0} of the recording's first position is out of the arm's range")]
    Start(usize),
    /// The simulated cell cannot be made.
    #[error("the simulated arm cannot be made")]
    Simulator(#[from] SimulatorError),
    /// Its server does not listen.
    #[error("the simulated controller takes no connection")]
    Connection,
}

/// Runs the program; returns what the arm did and what the controller said.
///
/// # Errors
/// [`ReplayError`].
pub fn replay(
    program: Code,
    which: &Replayed,
    start: [f64; 6],
    length_s: f64,
) -> Result<(Track, Vec<String>), ReplayError> {
    let usual = ControllerConfig::of(&which.arm, 1);
    let config = ControllerConfig {
        dh: which.kinematics.unwrap_or(which.arm.dh),
        start: Joints(start),
        running: true,
        version: which.software.unwrap_or(usual.version),
        ..usual
    };
    let table = Isometry3::translation(0.0, 0.0, TABLE_M);
    let world = WorldSpec::bare(table, GripperSpec::one_cup(0.001));
    let mut simulator = Simulator::new(config, world, 1, Vec::new())?;
    if let Some(joint) = simulator.core().robot.controller().core.mover.arm.outside(&Joints(start)) {
        return Err(ReplayError::Start(joint));
    }
    simulator.connect(Port::Primary).ok_or(ReplayError::Connection)?;
    simulator.core().robot.controller().programs.upload(Ok(program));
    let mut track = Track { states: [const { Some(Vec::new()) }; 3], ..Track::default() };
    let mut remarks = Vec::new();
    let most = ((2.0 * length_s + LONGER_S) * FRAMES_A_SECOND) as usize;
    let least = ((length_s + 1.0) * FRAMES_A_SECOND) as usize;
    for frame in 0..most {
        let ended = note(&simulator, &mut track);
        if ended && frame >= least {
            break;
        }
        simulator.advance();
        while let Some(transmission) = simulator.transmit() {
            let Transmission::Bytes(_, bytes) = transmission else { continue };
            if let Some(remark) = remark(&bytes).filter(|_| remarks.len() < MOST_REMARKS) {
                remarks.push(remark);
            }
        }
    }
    Ok((track, remarks))
}

/// Adds the present state; true when no program runs and the arm rests.
fn note(simulator: &Simulator, track: &mut Track) -> bool {
    let controller = simulator.core().robot.controller();
    let core = &controller.core;
    track.times_s.push(core.timestamp());
    track.joints.push(core.mover.q().0);
    let numbers = [
        core.modes.robot_mode().code(),
        core.modes.safety_mode().code(),
        controller.programs.runtime_state().code(),
    ];
    for (column, number) in track.states.iter_mut().flatten().zip(numbers) {
        column.push(number);
    }
    !controller.programs.playing() && !controller.programs.paused() && core.mover.stands()
}

/// What a package of the primary interface says to people.
fn remark(bytes: &[u8]) -> Option<String> {
    let kind = *bytes.get(HEADER.checked_sub(1)?)?;
    let Ok(Package::Message(message)) = Package::decode(kind, bytes.get(HEADER..)?) else { return None };
    match message.body {
        MessageBody::Text(text) | MessageBody::Popup { text, .. } => Some(text),
        MessageBody::Error { code, argument, text, .. } => Some(format!("C{code}A{argument} {text}")),
        MessageBody::RuntimeException { line, column, text } => Some(format!("{line}:{column}: {text}")),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compare::comparison::{Tolerances, compare};
    use crate::controller::builtins::compile_program;
    use ur_arm::kinematics::ARM_MODELS;

    const START: [f64; 6] = [-1.6, -1.9, 1.8, -1.5, -1.57, 0.1];
    const UR5E: Replayed = Replayed { arm: ARM_MODELS[0], kinematics: None, software: None };

    fn run(body: &str, start: [f64; 6]) -> Result<(Track, Vec<String>), ReplayError> {
        replay(compile_program(&format!("def work():\n{body}\nend\n")).unwrap(), &UR5E, start, 3.0)
    }

    #[test]
    fn a_program_moves_the_arm_from_where_the_recording_began() {
        let (track, remarks) =
            run(" movej([-1.2, -1.9, 1.8, -1.5, -1.57, 0.1], a=1.4, v=1.05)", START).unwrap();
        assert_eq!((track.joints[0], remarks.len()), (START, 0));
        assert!((track.joints.last().unwrap()[0] + 1.2).abs() < 1e-6);
        assert!(track.length_s() >= 3.0);
        let playing = track.states[2].as_ref().unwrap();
        assert!(playing.contains(&2) && *playing.last().unwrap() == 1, "it played and ended");
        let same = compare(&track, &track).unwrap();
        assert_eq!(same.breaches(&Tolerances { joint_rad: 0.0, time_s: 0.0 }), [""; 0]);
    }

    /// The same pose is elsewhere in the joints of another arm.
    #[test]
    fn the_arm_has_the_kinematics_that_are_given() {
        let program = " movel(pose_add(get_actual_tcp_pose(), p[0, 0, 0.1, 0, 0, 0]), a=1, v=0.2)";
        let end = |kinematics| {
            let code = compile_program(&format!("def work():\n{program}\nend\n")).unwrap();
            let (track, _) = replay(code, &Replayed { kinematics, ..UR5E }, START, 3.0).unwrap();
            *track.joints.last().unwrap()
        };
        let mut dh = UR5E.arm.dh;
        dh.a[1] -= 0.005;
        let (nominal, own) = (end(None), end(Some(dh)));
        let apart = nominal.iter().zip(own).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!((1e-4..0.02).contains(&apart), "{nominal:?} {own:?}");
    }

    #[test]
    fn what_the_controller_says_is_kept() {
        let (_, remarks) = run(" textmsg(\"half way\")\n x = 1 / 0", START).unwrap();
        assert!(remarks.iter().any(|remark| remark == "half way"), "{remarks:?}");
        assert!(remarks.iter().any(|remark| remark.contains("3:")), "{remarks:?}");
    }

    #[test]
    fn a_program_without_end_is_left_and_a_start_out_of_range_refused() {
        let (track, _) = run(" while True:\n  sync()\n end", START).unwrap();
        assert!((track.length_s() - 16.0).abs() < 0.01, "{}", track.length_s());
        let refused = run(" sync()", [0.0, 0.0, 9.0, 0.0, 0.0, 0.0]).unwrap_err();
        assert!(matches!(refused, ReplayError::Start(2)));
    }
}
