//! Built-ins of encoders and of tracking a conveyor.
//!
//! In: calls from running programs; a frame of the belt. Out: values, and an arm whose motion a belt carries
//! along. While the arm is held (pause, stop) the belt leaves it behind, and it goes on from where it is:
//! assumed. The direction of a straight belt counts, not its length or the pose's rotation.

use crate::controller::core::Core;
use crate::controller::encoders::{Conveyor, Decoder};
use crate::motion::FRAME_SECONDS;
use crate::motion::belt::Belt;
use crate::motion::mover::SOFT_RAMP_SECONDS;
use nalgebra::{Unit, Vector3};
use std::f64::consts::TAU;
use ur_arm::pose::isometry_from_ur_pose;
use urscript::host::{Call, Reply};
use urscript::value::Value;

/// Inputs that take pulses, by bit.
const PULSE_PINS: std::ops::RangeInclusive<i32> = 8..=11;

/// Carries out a built-in of this file; `None` if it is none of them.
pub fn call(core: &mut Core, call: &Call<'_>) -> Option<Result<Reply, String>> {
    let done = match call.name {
        "stop_conveyor_tracking" => return Some(stop(core, call)),
        "track_conveyor_linear" => linear(core, call),
        "track_conveyor_circular" => circular(core, call),
        "get_conveyor_tick_count" => Ok(Value::Float(core.settings.encoders[0].count())),
        "set_conveyor_tick_count" => set_conveyor(core, call),
        "conveyor_pulse_decode" => pulses(core, call, 0, 0),
        "encoder_enable_pulse_decode" => index(call, 0).and_then(|encoder| pulses(core, call, encoder, 1)),
        "encoder_enable_set_tick_count" => index(call, 0).and_then(|encoder| {
            let range = call.required(1)?.integer()?;
            match core.settings.encoders[encoder].expect_counts(range) {
                true => Ok(Value::Nothing),
                false => Err(format!("{}: there is no range {range}", call.name)),
            }
        }),
        "encoder_set_tick_count" => index(call, 0).and_then(|encoder| set(core, call, encoder, 1)),
        "encoder_get_tick_count" => index(call, 0).and_then(|encoder| get(core, call, encoder)),
        "encoder_unwind_delta_tick_count" => index(call, 0).and_then(|encoder| {
            let delta = call.required(1)?.number()?;
            Ok(core.settings.encoders[encoder].unwind(delta).map_or(Value::Nothing, Value::Float))
        }),
        _ => return None,
    };
    Some(done.map(Reply::Value))
}

/// Which encoder an argument means.
fn index(call: &Call<'_>, argument: usize) -> Result<usize, String> {
    let number = call.number_or(argument, 0.0)?;
    match number {
        0.0 => Ok(0),
        1.0 => Ok(1),
        _ => Err(format!("{}: there is no encoder {number}", call.name)),
    }
}

fn get(core: &Core, call: &Call<'_>, encoder: usize) -> Result<Value, String> {
    let encoder = &core.settings.encoders[encoder];
    let raw = call.argument(1).map_or(Ok(false), |option| Ok::<_, String>(&**option.string()? == "raw"))?;
    Ok(if raw { Value::Int(encoder.raw()) } else { Value::Float(encoder.count()) })
}

fn set(core: &mut Core, call: &Call<'_>, encoder: usize, argument: usize) -> Result<Value, String> {
    let count = call.required(argument)?.number()?;
    match core.settings.encoders[encoder].set(count) {
        true => Ok(Value::Nothing),
        false => Err(format!("{}: {count} is out of the encoder's range", call.name)),
    }
}

/// The old function: the range comes with every count, and changes nothing when it is the same.
fn set_conveyor(core: &mut Core, call: &Call<'_>) -> Result<Value, String> {
    let range = call.number_or(1, 0.0)? as i32;
    let known = &mut core.settings.conveyor_range;
    if *known != Some(range) {
        if !core.settings.encoders[0].expect_counts(range) {
            return Err(format!("{}: there is no resolution {range}", call.name));
        }
        *known = Some(range);
    }
    set(core, call, 0, 0)
}

fn pulses(core: &mut Core, call: &Call<'_>, encoder: usize, first: usize) -> Result<Value, String> {
    let kind = call.required(first)?.integer()?;
    let pin = |argument: usize| -> Result<u8, String> {
        let pin = call.number_or(argument, -1.0)? as i32;
        let known = u8::try_from(pin).ok().filter(|_| PULSE_PINS.contains(&pin));
        known.ok_or_else(|| format!("{}: pin {pin} takes no pulses, 8 to 11 do", call.name))
    };
    let decoder = match kind {
        0 => None,
        1 => Some(Decoder::Quadrature),
        2 => Some(Decoder::Edges),
        3 => Some(Decoder::Rising),
        4 => Some(Decoder::Falling),
        _ => return Err(format!("{}: there is no decoder {kind}", call.name)),
    };
    let expected = match decoder {
        None => None,
        Some(Decoder::Quadrature) => Some((Decoder::Quadrature, [pin(first + 1)?, pin(first + 2)?])),
        Some(other) => Some((other, [pin(first + 1)?; 2])),
    };
    core.settings.encoders[encoder].expect_pulses(expected);
    Ok(Value::Nothing)
}

fn linear(core: &mut Core, call: &Call<'_>) -> Result<Value, String> {
    without_offset(core, call)?;
    let direction = call.required(0)?.array::<6>()?;
    let direction = Vector3::new(direction[0], direction[1], direction[2]);
    let direction = Unit::try_new(direction, 1e-9).filter(|unit| unit.iter().all(|axis| axis.is_finite()));
    let Some(direction) = direction else {
        return Err(format!("{}: a conveyor has a direction", call.name));
    };
    let per_tick = 1.0 / ticks(call)?;
    let encoder = index(call, 2)?;
    follow(core, Belt::Straight { direction: direction.into_inner(), moved: 0.0 }, encoder, per_tick);
    Ok(Value::Nothing)
}

fn circular(core: &mut Core, call: &Call<'_>) -> Result<Value, String> {
    without_offset(core, call)?;
    let centre = call.required(0)?.array::<6>()?;
    if centre.iter().any(|number| !number.is_finite()) {
        return Err(format!("{}: the centre has numbers that are not finite", call.name));
    }
    let centre = isometry_from_ur_pose(centre);
    let turns_tool = call.argument(2).map_or(Ok(false), Value::truth)?;
    let per_tick = TAU / ticks(call)?;
    let encoder = index(call, 3)?;
    let axis = centre.rotation * Vector3::z_axis();
    let belt = Belt::Round { centre: centre.translation.vector, axis, turns_tool, moved: 0.0 };
    follow(core, belt, encoder, per_tick);
    Ok(Value::Nothing)
}

/// The manual forbids both at once.
fn without_offset(core: &Core, call: &Call<'_>) -> Result<(), String> {
    match core.mover.is_offset() {
        true => Err(format!("{}: a path offset is enabled", call.name)),
        false => Ok(()),
    }
}

/// Ticks for a metre or a revolution; negative where the encoder counts backwards.
fn ticks(call: &Call<'_>) -> Result<f64, String> {
    let ticks = call.required(1)?.number()?;
    match ticks.is_finite() && ticks.abs() > 1e-9 {
        true => Ok(ticks),
        false => Err(format!("{}: {ticks} ticks are no measure", call.name)),
    }
}

fn follow(core: &mut Core, belt: Belt, encoder: usize, per_tick: f64) {
    core.settings.encoders[encoder].take_moved();
    core.mover.track(belt);
    core.conveyor = Some(Conveyor { encoder, per_tick, share: 1.0 });
}

fn stop(core: &mut Core, call: &Call<'_>) -> Result<Reply, String> {
    let acceleration = call.number_or(0, 20.0)?;
    if !acceleration.is_finite() || acceleration <= 0.0 {
        return Err(format!("{}: an acceleration is positive, not {acceleration}", call.name));
    }
    if call.frames == 0 && core.conveyor.take().is_some() && core.mover.tracks() {
        core.owner = None;
        core.mover.leave_carrier(acceleration);
        return Ok(Reply::Wait);
    }
    Ok(if core.mover.has_braked() { Reply::Value(Value::Nothing) } else { Reply::Wait })
}

impl Core {
    /// One frame of the encoders: belts run whatever the arm does.
    pub(super) fn count_encoders(&mut self) {
        let inputs = self.registers.digital_inputs;
        for (encoder, rate) in self.settings.encoders.iter_mut().zip(self.config.encoders) {
            encoder.advance(inputs, rate * FRAME_SECONDS);
        }
    }

    /// One frame of the belt that carries the arm; `held`: the arm stays where it is.
    pub(super) fn run_conveyor(&mut self, held: bool) {
        if !self.mover.tracks() {
            self.conveyor = None;
        }
        let Some(conveyor) = &mut self.conveyor else { return };
        let ramp = FRAME_SECONDS / SOFT_RAMP_SECONDS;
        let share = if held { 0.0 } else { 1.0 };
        conveyor.share += (share - conveyor.share).clamp(-ramp, ramp);
        let ticks = self.settings.encoders[conveyor.encoder].take_moved();
        self.mover.move_belt(ticks * conveyor.per_tick * conveyor.share);
    }
}
