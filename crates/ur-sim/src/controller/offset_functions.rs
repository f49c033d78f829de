//! Built-ins of path offsets, and of the revolution counter.
//!
//! In: calls from running programs. Out: what the mover lays over the path, values, or the message of a
//! runtime exception. Assumed: an offset and a conveyor at once are an exception, an offset begins at none
//! with each `path_offset_enable`, and limits and filter hold until the program ends.

use crate::controller::core::Core;
use crate::motion::path_offset::OffsetFrame;
use cell_values::units::Joints;
use std::f64::consts::TAU;
use urscript::host::{Call, Reply};
use urscript::value::Value;

/// Frames in which an arm has to come to rest after its last move.
const STILL_FRAMES: u64 = 10;

/// Carries out a built-in of this file; `None` if it is none of them.
pub fn call(core: &mut Core, call: &Call<'_>) -> Option<Result<Reply, String>> {
    let done = match call.name {
        "path_offset_disable" => return Some(disable(core, call)),
        "path_offset_enable" => enable(core),
        "path_offset_set" => set(core, call),
        "path_offset_get" => {
            let offset = frame(call, 0).map(|frame| core.mover.applied_offset(frame));
            return Some(offset.map(|offset| Reply::Value(Value::Pose(offset))));
        }
        "path_offset_set_max_offset" => limit(core, call),
        "path_offset_set_alpha_filter" => filter(core, call),
        "reset_revolution_counter" => return Some(reset_revolutions(core, call)),
        _ => return None,
    };
    Some(done.map(|()| Reply::Value(Value::Nothing)))
}

fn frame(call: &Call<'_>, index: usize) -> Result<OffsetFrame, String> {
    Ok(match call.required(index)?.integer()? {
        1 => OffsetFrame::Base,
        2 => OffsetFrame::Tool,
        3 => OffsetFrame::Motion,
        4 => OffsetFrame::World,
        other => return Err(format!("{}: there is no type {other}", call.name)),
    })
}

fn enable(core: &mut Core) -> Result<(), String> {
    if core.mover.tracks() {
        return Err("path_offset_enable: a conveyor is tracked".to_owned());
    }
    core.mover.offset().offset = [0.0; 6];
    core.mover.begin_offset();
    Ok(())
}

fn disable(core: &mut Core, call: &Call<'_>) -> Result<Reply, String> {
    let acceleration = call.number_or(0, 20.0)?;
    if !acceleration.is_finite() || acceleration <= 0.0 {
        return Err(format!("{}: an acceleration is positive, not {acceleration}", call.name));
    }
    if call.frames == 0 {
        if !core.mover.is_offset() {
            return Ok(Reply::Value(Value::Nothing));
        }
        core.owner = None;
        core.mover.leave_carrier(acceleration);
        return Ok(Reply::Wait);
    }
    Ok(if core.mover.has_braked() { Reply::Value(Value::Nothing) } else { Reply::Wait })
}

fn set(core: &mut Core, call: &Call<'_>) -> Result<(), String> {
    let offset = call.required(0)?.array::<6>()?;
    if offset.iter().any(|number| !number.is_finite()) {
        return Err(format!("{}: the offset has numbers that are not finite", call.name));
    }
    let frame = frame(call, 1)?;
    let wish = core.mover.offset();
    (wish.offset, wish.frame) = (offset, frame);
    Ok(())
}

fn limit(core: &mut Core, call: &Call<'_>) -> Result<(), String> {
    let (metres, radians) = (call.required(0)?.number()?, call.required(1)?.number()?);
    if !(metres.is_finite() && radians.is_finite() && metres >= 0.0 && radians >= 0.0) {
        return Err(format!("{}: {metres} m and {radians} rad are no limits", call.name));
    }
    let wish = core.mover.offset();
    (wish.most_m, wish.most_rad) = (metres, radians);
    Ok(())
}

fn filter(core: &mut Core, call: &Call<'_>) -> Result<(), String> {
    let alpha = call.required(0)?.number()?;
    if !(0.0..=1.0).contains(&alpha) {
        return Err(format!("{}: {alpha} is not between 0 and 1", call.name));
    }
    core.mover.offset().alpha = alpha;
    Ok(())
}

/// Joints without a limit count from near the given position again; the others are as they were.
fn reset_revolutions(core: &mut Core, call: &Call<'_>) -> Result<Reply, String> {
    let near = call.argument(0).map_or(Ok([0.0; 6]), Value::array::<6>)?;
    if near.iter().any(|number| !number.is_finite()) {
        return Err(format!("{}: numbers must be finite", call.name));
    }
    let done = Ok(Reply::Value(Value::Nothing));
    let Some(joint) = core.mover.arm.endless else { return done };
    if core.mover.tracks() || core.mover.is_offset() || call.frames > STILL_FRAMES {
        return Err(format!("{}: the arm is moving", call.name));
    }
    if !core.mover.stands() {
        return Ok(Reply::Wait);
    }
    let Joints(mut q) = core.mover.q();
    q[joint] -= TAU * ((q[joint] - near[joint]) / TAU).round();
    core.mover.place(Joints(q));
    done
}
