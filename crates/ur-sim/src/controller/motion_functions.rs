//! Built-ins that move the arm.
//!
//! In: calls from running programs, repeated each frame until they are done. Out: waits and, in the end,
//! nothing. Defaults are those of the script manual. A pose may be given as joint positions and the other
//! way round. `optimovej` and `optimovel` take shares of the fastest the arm can do and are trapezoids all
//! the same. A target that is not finite, that no posture reaches or that lies outside the joint range is a
//! runtime exception; a line that leaves the range on its way or leads through a singularity is a protective
//! stop, as on the arm.

use crate::controller::core::Core;
use crate::controller::modes::PATH_SANITY_CODE;
use crate::motion::dynamics;
use crate::motion::mover::MoveId;
use crate::motion::segment::MoveLimits;
use crate::motion::{FRAME_SECONDS, MotionFault};
use cell_values::units::Joints;
use nalgebra::{Isometry3, Matrix6, Vector6};
use ur_arm::pose::isometry_from_ur_pose;
use ur_wire::primary_message::MessageBody;
use urscript::host::{Call, Reply};
use urscript::value::Value;

/// Built-ins whose motion ends with the thread that commanded it.
pub const MOVES: &[&str] = &[
    "movej",
    "movel",
    "movep",
    "movec",
    "servoc",
    "optimovej",
    "optimovel",
    "servoj",
    "speedj",
    "speedl",
    "direct_torque",
];

/// True for built-ins that move the arm or decide how it gives way.
pub fn takes_the_arm(name: &str) -> bool {
    let others = ["stopj", "stopl", "set_pos", "force_mode", "freedrive_mode", "teach_mode", "screw_driving"];
    MOVES.contains(&name)
        || others.contains(&name)
        || name.contains("conveyor_tracking")
        || name.starts_with("track_conveyor")
        || name.starts_with("path_offset")
        || name == "reset_revolution_counter"
}

/// What `optimovej` and `optimovel` take as the fastest acceleration: rad/s2 and m/s2.
const OPTIMAL_JOINT_ACCELERATION: f64 = 15.0;
const OPTIMAL_TOOL_ACCELERATION: f64 = 5.0;

/// Friction that `direct_torque` does not compensate, Nm for each rad/s; modelled, not published.
const FRICTION: [f64; 6] = [2.0, 2.0, 2.0, 0.5, 0.5, 0.5];

/// First version of PolyScope X that has them.
const OPTIMAL_SINCE: [u32; 2] = [10, 8];

/// Carries out a built-in of this file; `None` if it is none of them.
pub fn call(core: &mut Core, call: &mut Call<'_>) -> Option<Result<Reply, String>> {
    let first = call.frames == 0;
    let [major, minor, ..] = core.version();
    let optimal = major < OPTIMAL_SINCE[0] || [major, minor] >= OPTIMAL_SINCE;
    Some(match call.name {
        "optimovej" | "optimovel" if !optimal => {
            Err(format!("{} is not there before software 10.8", call.name))
        }
        "movej" | "movel" | "movep" | "movec" | "servoc" | "optimovej" | "optimovel" => {
            if first {
                start_move(core, call)
            } else {
                Ok(done_if(core.mover.released(MoveId(*call.note))))
            }
        }
        "direct_torque" => torque(core, call),
        "set_pos" => place(core, call),
        "stopj" | "stopl" if first => stop(core, call),
        "stopj" | "stopl" => Ok(done_if(core.mover.has_braked())),
        "servoj" => servo(core, call),
        "speedj" | "speedl" => speed(core, call),
        _ => return None,
    })
}

fn done_if(done: bool) -> Reply {
    if done { Reply::Value(Value::Nothing) } else { Reply::Wait }
}

/// A number that must be positive, with its default.
fn positive(call: &Call<'_>, index: usize, default: f64) -> Result<f64, String> {
    let number = call.number_or(index, default)?;
    if number.is_finite() && number > 0.0 {
        Ok(number)
    } else {
        Err(format!("{}: argument {} must be positive, not {number}", call.name, index + 1))
    }
}

fn not_negative(call: &Call<'_>, index: usize) -> Result<f64, String> {
    let number = call.number_or(index, 0.0)?;
    if number.is_finite() && number >= 0.0 {
        Ok(number)
    } else {
        Err(format!("{}: argument {} must not be negative, not {number}", call.name, index + 1))
    }
}

fn finite(call: &Call<'_>, index: usize) -> Result<[f64; 6], String> {
    let numbers = call.required(index)?.array::<6>()?;
    match numbers.iter().all(|number| number.is_finite()) {
        true => Ok(numbers),
        false => Err(format!("{}: the target has numbers that are not finite", call.name)),
    }
}

/// No other thread may be moving the arm.
fn take_arm(core: &mut Core, call: &Call<'_>) -> Result<(), String> {
    let other = core.owner.is_some_and(|(owner, id)| owner != call.thread && !core.mover.released(id));
    if other {
        return Err("another thread is already controlling the robot".to_owned());
    }
    core.orphaned = false;
    Ok(())
}

/// Turns what the arm cannot do into a protective stop; the program waits and is paused by it.
fn or_stop<T>(core: &mut Core, result: Result<T, MotionFault>) -> Option<T> {
    result.map_err(|fault| core.stop_requested = Some((PATH_SANITY_CODE, fault.to_string()))).ok()
}

fn start_move(core: &mut Core, call: &mut Call<'_>) -> Result<Reply, String> {
    take_arm(core, call)?;
    let limits = limits_of(core, call)?;
    if is_skipped(core, call, &limits)? {
        core.message(MessageBody::Text(format!("Overlapping blends in {}, the move is skipped", call.name)));
        return Ok(Reply::Value(Value::Nothing));
    }
    let started = match call.name {
        "movej" | "optimovej" => {
            let joints = joints_of(core, call)?;
            if let Some(joint) = core.mover.arm.outside(&joints) {
                return Err(format!(
                    "{}: the target of joint {joint} is out of its range: {} rad",
                    call.name, joints.0[joint]
                ));
            }
            core.mover.move_joints(&joints, &limits)
        }
        "movec" => {
            let fixed = call.number_or(5, 0.0)? != 0.0;
            let (via, to) = (pose_of(core, call, 0)?, pose_of(core, call, 1)?);
            core.mover.move_circle(&via, &to, fixed, &limits)
        }
        "movep" | "servoc" => {
            let pose = pose_of(core, call, 0)?;
            core.mover.move_process(&pose, &limits)
        }
        _ => {
            let pose = pose_of(core, call, 0)?;
            core.mover.move_tool(&pose, &limits)
        }
    };
    match or_stop(core, started) {
        Some(id) => {
            *call.note = id.0;
            core.owner = Some((call.thread, id));
        }
        None => core.owner = None,
    }
    Ok(Reply::Wait)
}

/// Whether a move is left out, as its blend overlaps that of the move before it.
fn is_skipped(core: &Core, call: &Call<'_>, limits: &MoveLimits) -> Result<bool, String> {
    let target = match call.name {
        "movej" | "optimovej" => core.mover.arm.tcp(&joints_of(core, call)?),
        "movel" | "optimovel" => pose_of(core, call, 0)?,
        _ => return Ok(false),
    };
    Ok(core.mover.blends_overlap(&target, limits.blend))
}

/// Speeds, accelerations, duration and blend of a move; the place of each argument depends on the move.
fn limits_of(core: &Core, call: &Call<'_>) -> Result<MoveLimits, String> {
    let arm = &core.mover.arm;
    let joint = matches!(call.name, "movej" | "optimovej");
    let first = if call.name == "movec" { 2 } else { 1 };
    if matches!(call.name, "optimovej" | "optimovel") {
        let share = |index: usize| match positive(call, index, 0.3)? {
            share if share <= 1.0 => Ok(share),
            share => Err(format!("{}: {share} is not a share between 0 and 1", call.name)),
        };
        let (acceleration, speed) = match joint {
            true => (OPTIMAL_JOINT_ACCELERATION, arm.joint_speed.into_iter().fold(0.0, f64::max)),
            false => (OPTIMAL_TOOL_ACCELERATION, arm.tool_speed),
        };
        let (acceleration, speed) = (acceleration * share(1)?, speed * share(2)?);
        let blend = not_negative(call, 3)?;
        return Ok(MoveLimits { acceleration, speed, seconds: 0.0, blend, keeps: false });
    }
    let (a, v) = if joint { (1.4, 1.05) } else { (1.2, 0.25) };
    let (acceleration, speed) = (positive(call, first, a)?, positive(call, first + 1, v)?);
    // Only movej and movel have a duration before the blend radius.
    let (seconds, blend) = match call.name {
        "movej" | "movel" => (not_negative(call, 3)?, not_negative(call, 4)?),
        _ => (0.0, not_negative(call, first + 2)?),
    };
    Ok(MoveLimits { acceleration, speed, seconds, blend, keeps: false })
}

fn pose_of(core: &Core, call: &Call<'_>, index: usize) -> Result<Isometry3<f64>, String> {
    let target = finite(call, index)?;
    let is_pose = matches!(call.required(index)?, Value::Pose(_));
    Ok(if is_pose { isometry_from_ur_pose(target) } else { core.mover.arm.tcp(&Joints(target)) })
}

fn joints_of(core: &Core, call: &Call<'_>) -> Result<Joints, String> {
    let target = finite(call, 0)?;
    let is_pose = matches!(call.required(0)?, Value::Pose(_));
    if is_pose { joints_for(core, &isometry_from_ur_pose(target)) } else { Ok(Joints(target)) }
}

fn joints_for(core: &Core, base_from_tcp: &Isometry3<f64>) -> Result<Joints, String> {
    let arm = &core.mover.arm;
    let flange = base_from_tcp * arm.flange_from_tcp.inverse();
    arm.kinematics
        .inverse_near(&flange, &core.mover.q(), (-arm.joint_range, arm.joint_range))
        .ok_or_else(|| "movej: unable to find an inverse kinematics solution".to_owned())
}

fn stop(core: &mut Core, call: &Call<'_>) -> Result<Reply, String> {
    let acceleration = positive(call, 0, 1.0)?;
    core.orphaned = false;
    core.owner = None;
    if core.mover.stands() && !core.mover.busy() {
        core.mover.rest();
        return Ok(Reply::Value(Value::Nothing));
    }
    if call.name == "stopj" {
        core.mover.stop_joints(acceleration);
    } else {
        let turning = positive(call, 1, acceleration)?;
        core.mover.stop_tool(acceleration, turning);
    }
    Ok(Reply::Wait)
}

/// Waits its time `t` even if that is one frame, so that a loop of calls runs once per frame.
fn servo(core: &mut Core, call: &mut Call<'_>) -> Result<Reply, String> {
    let seconds = positive(call, 3, FRAME_SECONDS)?;
    if call.frames == 0 {
        take_arm(core, call)?;
        let target = Joints(finite(call, 0)?);
        let lookahead = call.number_or(4, 0.1)?;
        let gain = call.number_or(5, 300.0)?;
        if !(0.03..=0.2).contains(&lookahead) || !(100.0..=2000.0).contains(&gain) {
            return Err(format!("servoj: lookahead {lookahead} s or gain {gain} is out of range"));
        }
        let started = core.mover.servo(&target, lookahead, seconds);
        or_stop(core, started);
    }
    Ok(done_if(call.frames as f64 * FRAME_SECONDS >= seconds - 1e-9))
}

fn speed(core: &mut Core, call: &mut Call<'_>) -> Result<Reply, String> {
    if call.frames == 0 {
        take_arm(core, call)?;
        let target = finite(call, 0)?;
        if call.name == "speedj" {
            let limit = core.mover.arm.joint_speed;
            let acceleration = positive(call, 1, 1.4)?;
            let speeds = std::array::from_fn(|i| target[i].clamp(-limit[i], limit[i]));
            core.mover.joint_speed(speeds, acceleration);
        } else {
            let acceleration = positive(call, 1, 1.2)?;
            let turning = positive(call, 3, acceleration)?;
            core.mover.tool_speed(Vector6::from(target), acceleration, turning);
        }
        return Ok(Reply::Wait);
    }
    let seconds = not_negative(call, 2)?;
    if seconds > 0.0 {
        // Its time is that of the motion: at half speed it takes twice as long, and leads as far.
        *call.note += (core.mover.pace() * FRAME_SECONDS * 1e9).round() as u64;
        return Ok(done_if(*call.note as f64 * 1e-9 >= seconds - 1e-9));
    }
    Ok(done_if(core.mover.at_speed()))
}

/// Rigid bodies driven by the given torques, gravity already held; one frame. The real controller
/// compensates most of the friction; [`FRICTION`] is left of it, and the arguments that set how much have no
/// effect.
fn torque(core: &mut Core, call: &Call<'_>) -> Result<Reply, String> {
    if call.frames > 0 {
        return Ok(Reply::Value(Value::Nothing));
    }
    take_arm(core, call)?;
    let torque = Vector6::from(finite(call, 0)?);
    let (mover, masses) = (&core.mover, core.masses());
    let (chain, q, qd) = (mover.arm.kinematics.chain(), mover.q(), mover.qd());
    let friction = Vector6::from(FRICTION);
    let taken = Vector6::from(dynamics::velocity_torques(chain, &masses, &q, &qd))
        + friction.component_mul(&Vector6::from(qd));
    let felt = Vector6::from(core.tcp_force());
    let felt = dynamics::tool_jacobian(chain, &mover.arm.flange_from_tcp, &q).transpose() * felt;
    // Friction of the speed to come, not of the present one: light wrists would else swing up.
    let inertia =
        dynamics::mass_matrix(chain, &masses, &q) + Matrix6::from_diagonal(&(friction * FRAME_SECONDS));
    let solved = inertia.cholesky().map(|matrix| matrix.solve(&(torque + felt - taken)));
    let acceleration =
        solved.ok_or_else(|| "direct_torque: the payload's inertia is impossible".to_owned())?;
    core.mover.drive(acceleration.into());
    Ok(Reply::Wait)
}

/// Of a simulated arm only: it is elsewhere at once.
fn place(core: &mut Core, call: &Call<'_>) -> Result<Reply, String> {
    let q = Joints(finite(call, 0)?);
    if core.mover.arm.outside(&q).is_some() || !core.mover.stands() {
        return Err("set_pos: the arm moves, or the positions are out of range".to_owned());
    }
    core.mover.place(q);
    Ok(Reply::Value(Value::Nothing))
}
