//! What the controller's built-ins do: dispatch, state and kinematics, tool, messages, watchdogs (motion and
//! input/output, sockets and forces are in their own files).
//!
//! In: calls from running programs. Out: values, waits, or the message of a runtime exception.

use crate::controller::core::{Core, DEFAULT_STOP, Payload};
use crate::controller::modes::STOP_BY_PROGRAM_CODE;
use crate::controller::registers::Input;
use crate::controller::watchdog::{Watchdog, WatchdogAction};
use crate::controller::{
    conveyor_functions, force_functions, interpreter, io_functions, modbus_command, motion_functions,
    offset_functions, payload_estimate, request_functions, rpc_functions, setting_functions,
    socket_functions,
};
use crate::motion::FRAMES_PER_SECOND;
use cell_values::units::Joints;
use nalgebra::Isometry3;
use ur_arm::pose::{isometry_from_ur_pose, ur_pose_from_isometry};
use ur_wire::primary_message::MessageBody;
use urscript::host::{Call, Host, Reply};
use urscript::string_library::cut_short;
use urscript::value::{ThreadId, Value};

/// Frames the arm must have been at rest to count as steady (0.5 s).
const STEADY_FRAMES: u64 = 250;

impl Host for Core {
    fn call(&mut self, mut call: Call<'_>) -> Result<Reply, String> {
        if let Some(value) = io_functions::register_call(self, &call) {
            return value.map(Reply::Value);
        }
        if self.secondary && motion_functions::takes_the_arm(call.name) {
            return Err(format!("{}: a secondary program must not move the arm", call.name));
        }
        let slow = motion_functions::call(self, &mut call)
            .or_else(|| conveyor_functions::call(self, &call))
            .or_else(|| offset_functions::call(self, &call))
            .or_else(|| socket_functions::call(self, &mut call))
            .or_else(|| interpreter::call(self, &call))
            .or_else(|| rpc_functions::call(self, &mut call))
            .or_else(|| request_functions::call(self, &mut call))
            .or_else(|| modbus_command::call(self, &mut call))
            .or_else(|| (call.name == "popup").then(|| popup(self, &call)));
        if let Some(reply) = slow {
            return reply.map(|reply| match reply {
                Reply::Value(value) => Reply::Waited(value),
                other => other,
            });
        }
        let value = io_functions::call(self, &call)
            .or_else(|| force_functions::call(self, &call))
            .or_else(|| setting_functions::call(self, &call))
            .or_else(|| kinematics(self, &call))
            .or_else(|| tool(self, &call))
            .or_else(|| state(self, &call))
            .or_else(|| messages(self, &call));
        let Some(value) = value else {
            return Err(format!("{} is not available in the simulation", call.name));
        };
        value.map(Reply::Value)
    }

    fn takes_statements(&self) -> bool {
        self.interpreter.takes_statements()
    }

    fn abandoned(&mut self, thread: ThreadId, name: &'static str) {
        // Its threads have the numbers of the main program's.
        if self.secondary {
            return;
        }
        if motion_functions::MOVES.contains(&name) {
            self.orphaned = true;
        }
        if name.ends_with("_from_primary_client") {
            self.requests.clear_of(thread);
        }
        // Connections that a call opens for itself, which now closes none.
        self.sockets.close(&rpc_functions::socket(thread));
        self.sockets.close(&modbus_command::socket(thread));
        if self.owner.is_some_and(|(owner, _)| owner == thread) {
            self.owner = None;
        }
    }
}

impl Core {
    /// Brakes a motion whose thread was killed, unless the program has commanded another one since.
    pub(crate) fn settle_orphaned_motion(&mut self) {
        if std::mem::take(&mut self.orphaned) {
            self.mover.stop_joints(DEFAULT_STOP);
        }
    }

    /// Counts a frame for each watchdog; what to do if one has run out.
    pub(crate) fn watchdog_action(&mut self) -> Option<WatchdogAction> {
        let mut action = None;
        for watchdog in &mut self.watchdogs {
            let due = watchdog.count(&self.registers);
            action = action.or(due);
        }
        action
    }
}

fn list(values: [f64; 6]) -> Value {
    Value::numbers(values)
}

/// An optional argument that is a pose; else the active tool centre point.
fn tcp_argument(core: &Core, call: &Call<'_>, index: usize) -> Result<Isometry3<f64>, String> {
    match call.argument(index) {
        Some(value) => {
            // Scripts that pass on options use an empty or short list for "the active one".
            let numbers = value.number_list()?;
            match <[f64; 6]>::try_from(numbers) {
                Ok(pose) => Ok(isometry_from_ur_pose(pose)),
                Err(_) => Ok(core.mover.arm.flange_from_tcp),
            }
        }
        None => Ok(core.mover.arm.flange_from_tcp),
    }
}

/// Joint positions for a TCP pose, nearest to `qnear` or to where the arm is.
fn solve(core: &Core, call: &Call<'_>, pose: [f64; 6]) -> Result<Option<Joints>, String> {
    if pose.iter().any(|value| !value.is_finite()) {
        return Err(format!("{}: the pose has numbers that are not finite", call.name));
    }
    let near = match call.argument(1).map(Value::array::<6>) {
        Some(Ok(near)) => Joints(near),
        _ => core.mover.q(),
    };
    let flange = isometry_from_ur_pose(pose) * tcp_argument(core, call, 4)?.inverse();
    let arm = &core.mover.arm;
    Ok(arm.kinematics.inverse_near(&flange, &near, (-arm.joint_range, arm.joint_range)))
}

fn kinematics(core: &Core, call: &Call<'_>) -> Option<Result<Value, String>> {
    Some(match call.name {
        "get_forward_kin" => forward_kin(core, call),
        "get_inverse_kin" => call.required(0).and_then(Value::pose).and_then(|pose| {
            solve(core, call, pose)?
                .map(|q| list(q.0))
                .ok_or_else(|| "get_inverse_kin: unable to find an inverse kinematics solution".to_owned())
        }),
        "get_inverse_kin_has_solution" => call
            .required(0)
            .and_then(Value::pose)
            .and_then(|pose| Ok(Value::Bool(solve(core, call, pose)?.is_some()))),
        "is_within_safety_limits" => call.required(0).and_then(|target| match target {
            Value::Pose(pose) => {
                let free = solve(core, call, *pose)?.is_some_and(|q| safe(core, &q));
                Ok(Value::Bool(free))
            }
            other => {
                let q = Joints(other.array::<6>()?);
                Ok(Value::Bool(core.mover.arm.outside(&q).is_none() && safe(core, &q)))
            }
        }),
        _ => return None,
    })
}

/// The safety system lets the arm be there.
fn safe(core: &Core, q: &Joints) -> bool {
    let (arm, config) = (&core.mover.arm, &core.config);
    let tcp = arm.tcp(q).translation.vector;
    let bodies = arm.kinematics.chain().placed(q).bodies;
    config.safety.clearance(config.arm.name, &bodies, &tcp).is_ok()
}

fn forward_kin(core: &Core, call: &Call<'_>) -> Result<Value, String> {
    let q = match call.argument(0) {
        Some(q) => Joints(q.array::<6>()?),
        None => core.mover.q(),
    };
    if !q.is_finite() {
        return Err("get_forward_kin: the joint positions are not finite".to_owned());
    }
    let pose = core.mover.arm.kinematics.forward(&q) * tcp_argument(core, call, 1)?;
    Ok(Value::Pose(ur_pose_from_isometry(&pose)))
}

fn finite<const N: usize>(call: &Call<'_>, index: usize) -> Result<[f64; N], String> {
    let numbers = call.required(index)?.array::<N>()?;
    match numbers.iter().all(|number| number.is_finite()) {
        true => Ok(numbers),
        false => Err(format!("{}: numbers must be finite", call.name)),
    }
}

/// Numbers that are not larger than anything there is.
fn within(call: &Call<'_>, numbers: &[f64], most: f64) -> Result<(), String> {
    match numbers.iter().all(|number| number.abs() <= most) {
        true => Ok(()),
        false => Err(format!("{}: {numbers:?} is not possible", call.name)),
    }
}

/// A centre of gravity.
fn centre(call: &Call<'_>, index: usize) -> Result<[f64; 3], String> {
    let centre = finite(call, index)?;
    within(call, &centre, MAX_OFFSET)?;
    Ok(centre)
}

fn tool(core: &mut Core, call: &Call<'_>) -> Option<Result<Value, String>> {
    let done = match call.name {
        "set_tcp" => call.required(0).and_then(Value::pose).and_then(|_| {
            let pose = finite(call, 0)?;
            within(call, &pose, MAX_OFFSET)?;
            core.set_tcp(pose);
            Ok(())
        }),
        "set_payload" | "set_target_payload" | "set_payload_mass" => set_payload(core, call),
        "set_payload_cog" => centre(call, 0).map(|centre| {
            core.payload_change = None;
            core.payload.centre = centre;
            core.payload.inertia = [0.0; 6];
            zero_sensor(core);
        }),
        "set_gravity" => finite(call, 0).and_then(|gravity| {
            within(call, &gravity, MAX_GRAVITY)?;
            core.payload.gravity = gravity;
            Ok(())
        }),
        "estimate_payload" => return Some(payload_estimate::estimate(core, call)),
        "get_tcp_offset" => return Some(Ok(Value::Pose(core.tcp_offset))),
        "get_target_payload" => return Some(Ok(Value::Float(core.payload.mass))),
        "get_gravity" => return Some(Ok(Value::numbers(core.payload.gravity))),
        "get_target_payload_cog" => return Some(Ok(Value::numbers(core.payload.centre))),
        "get_target_payload_inertia" => return Some(Ok(list(core.payload.inertia))),
        _ => return None,
    };
    Some(done.map(|()| Value::Nothing))
}

/// Another payload makes what the sensor measured before worthless: the controller zeroes it (script manual,
/// set_payload).
fn zero_sensor(core: &mut Core) {
    let raw = core.raw_wrench();
    core.sensing.zero(raw);
}

/// Largest number of a tool centre point (m, rad), of a centre of gravity (m) and of gravity (m/s2): far
/// beyond what there is, and small enough to be computed with.
const MAX_OFFSET: f64 = 100.0;
const MAX_GRAVITY: f64 = 1000.0;

/// Longest transition to another payload, s: far beyond what programs use.
const MAX_TRANSITION_S: f64 = 3600.0;

/// Largest element of a payload's inertia, kg m2 (script manual, set_target_payload).
const MAX_INERTIA: f64 = 133.0;

fn set_payload(core: &mut Core, call: &Call<'_>) -> Result<(), String> {
    let mass = call.required(0)?.number()?;
    if !(0.0..=50.0).contains(&mass) {
        return Err(format!("{}: a payload of {mass} kg is not possible", call.name));
    }
    let centre = call.argument(1).map(|_| centre(call, 1)).transpose()?;
    // An inertia that is not given is none.
    let inertia: [f64; 6] = call.argument(2).map_or(Ok([0.0; 6]), |_| finite(call, 2))?;
    let [moments, products] = [&inertia[..3], &inertia[3..]];
    if moments.iter().any(|moment| !(0.0..=MAX_INERTIA).contains(moment))
        || products.iter().any(|product| product.abs() > MAX_INERTIA)
    {
        return Err(format!("{}: an inertia of {inertia:?} kg m2 is not possible", call.name));
    }
    let [x, y, z, ..] = core.tcp_offset;
    let seconds = call.number_or(3, 0.0)?;
    if !(0.0..=MAX_TRANSITION_S).contains(&seconds) {
        return Err(format!("{}: a transition time of {seconds} s is not possible", call.name));
    }
    let centre = match (centre, call.name) {
        (Some(centre), _) => centre,
        (None, "set_payload") => [x, y, z],
        (None, _) => core.payload.centre,
    };
    core.change_payload(Payload { mass, centre, inertia, gravity: core.payload.gravity }, seconds);
    zero_sensor(core);
    Ok(())
}

fn state(core: &Core, call: &Call<'_>) -> Option<Result<Value, String>> {
    let mover = &core.mover;
    Some(Ok(match call.name {
        "get_actual_joint_positions" | "get_joint_positions" => list(core.actual_q().0),
        "get_target_joint_positions" => list(mover.q().0),
        "get_actual_joint_speeds" => list(core.actual_qd()),
        "get_target_joint_speeds" => list(mover.qd()),
        "get_target_joint_accelerations" => list(mover.qdd()),
        "get_target_tcp_pose_along_path" => Value::Pose(ur_pose_from_isometry(&mover.path_tcp())),
        "get_actual_tcp_pose" => Value::Pose(core.tcp_pose()),
        "get_target_tcp_pose" => Value::Pose(ur_pose_from_isometry(&mover.tcp())),
        "get_target_tcp_speed_along_path" => Value::numbers(mover.path_speed().iter().copied()),
        "get_actual_tcp_speed" | "get_target_tcp_speed" => Value::numbers(mover.tcp_speed().iter().copied()),
        "get_actual_tool_flange_pose" => Value::Pose(ur_pose_from_isometry(&core.base_from_flange())),
        "is_steady" => Value::Bool(mover.still_frames() >= STEADY_FRAMES),
        "get_steptime" => Value::Float(1.0 / FRAMES_PER_SECOND as f64),
        "get_joint_temp" => Value::Float(35.0),
        "get_controller_temp" => Value::Float(40.0),
        "get_tool_accelerometer_reading" => Value::numbers(core.tool_accelerometer()),
        "get_tool_current" => Value::Float(0.0),
        "get_tool_temp" => Value::Float(35.0),
        "time" => return Some(time(core, call)),
        "get_target_waypoint" => Value::Pose(core.target_waypoint()),
        _ => return None,
    }))
}

/// Simulated time as `struct(sec, nanosec)`.
fn time(core: &Core, call: &Call<'_>) -> Result<Value, String> {
    /// 2026-01-01 as system time, s.
    const EPOCH_S: f64 = 1_767_225_600.0;
    let start = match call.argument(0).map_or(Ok(0), Value::integer)? {
        0 => 0.0,
        2 => EPOCH_S,
        mode => return Err(format!("time: there is no mode {mode}")),
    };
    let seconds = start + core.timestamp();
    let nanoseconds = (seconds.fract() * 1e9).round().min(999_999_999.0);
    let member = |name: &str, value: f64| (name.into(), Value::Int(value as i32));
    Ok(Value::Struct(std::sync::Arc::new(vec![
        member("sec", seconds.trunc()),
        member("nanosec", nanoseconds),
    ])))
}

fn messages(core: &mut Core, call: &Call<'_>) -> Option<Result<Value, String>> {
    let done = match call.name {
        "textmsg" => call.required(0).map(|first| {
            let second = call.argument(1).map(cut_short).unwrap_or_default();
            core.message(MessageBody::Text(cut_short(first) + &second));
        }),
        "protective_stop" => {
            let reason = "protective stop by the program".to_owned();
            core.stop_requested = Some((STOP_BY_PROGRAM_CODE, reason));
            Ok(())
        }
        "powerdown" => {
            core.modes.power_off();
            Ok(())
        }
        "rtde_set_watchdog" => set_watchdog(core, call),
        _ => return None,
    };
    Some(done.map(|()| Value::Nothing))
}

fn set_watchdog(core: &mut Core, call: &Call<'_>) -> Result<(), String> {
    let name = call.required(0)?.string()?.clone();
    let frequency = call.number_or(1, 10.0)?;
    let action = match call.argument(2).map_or(Ok("pause"), |value| value.string().map(|text| &**text))? {
        "ignore" => None,
        "pause" => Some(WatchdogAction::Pause),
        "stop" => Some(WatchdogAction::Stop),
        other => return Err(format!("rtde_set_watchdog: unknown action \"{other}\"")),
    };
    let input = Input::from_name(&name).filter(|_| core.registers.claimed(&name));
    let Some(input) = input else {
        return Err(format!("rtde_set_watchdog: no client writes {name}"));
    };
    core.watchdogs.retain(|watchdog| watchdog.input() != input);
    if frequency > 0.0 {
        core.watchdogs.push(Watchdog::new(input, frequency, action, &core.registers));
    }
    Ok(())
}

/// Shows a text on the pendant; a blocking one waits until it has been closed.
fn popup(core: &mut Core, call: &Call<'_>) -> Result<Reply, String> {
    let text = cut_short(call.required(0)?);
    let blocking = call.argument(4).map_or(Ok(false), Value::truth)?;
    if call.frames == 0 {
        core.popup = Some(text);
    } else if core.popup.as_ref() != Some(&text) {
        return Ok(Reply::Value(Value::Nothing));
    }
    Ok(if blocking { Reply::Wait } else { Reply::Value(Value::Nothing) })
}
