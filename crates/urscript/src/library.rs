//! Built-ins that touch nothing but their arguments: the table of all of them, and the mathematics.
//!
//! In: arguments bound to parameters. Out: a value or the message of a runtime exception. Angles in rad
//! unless the name says otherwise. The generator behind `random` belongs to the program, so that a seed
//! repeats a run.

use crate::host::urscript_builtins;
use crate::host::{Builtin, Call};
use crate::value::Value;
use crate::{list_library, pose_library, string_library};

/// Built-ins of the language itself; `sync` and `sleep` are the scheduler's.
pub const BUILTINS: &[Builtin] = urscript_builtins![
    sync(), sleep(t),
    abs(f), acos(f), asin(f), atan(f), atan2(x, y), ceil(f), cos(f), d2r(d), floor(f), log(b, f), pow(base, exponent),
    r2d(r), random(), sin(f), sqrt(f), tan(f), round(f), exp(f), min(a, b), max(a, b), int(f), float(f),
    norm(a), normalize(v), length(v), size(v), get_list_length(v), dot(a, b), cross(a, b), inv(m), transpose(m),
    make_list(length, initial_value; capacity), sum(v),
    point_dist(p_from, p_to), pose_add(p_1, p_2), pose_dist(p_from, p_to), pose_inv(p_from), pose_sub(p_to, p_from),
    pose_trans(p_from, p_from_to), interpolate_pose(p_from, p_to, alpha), rotvec2rpy(rotation_vector),
    rpy2rotvec(rpy_vector), wrench_trans(T_from_to, w_from),
    str_at(src, index), str_cat(op1, op2), str_empty(str), str_find(src, target; start_from), str_len(str),
    str_sub(src, index; len), to_num(str), to_str(val), assert(condition; message),
    binary_list_to_integer(l), integer_to_binary_list(x),
];

/// The built-in called `name`.
pub fn find(name: &str) -> Option<&'static Builtin> {
    BUILTINS.iter().find(|builtin| builtin.name == name)
}

/// Splitmix64: enough for `random`, and repeatable.
#[derive(Clone, Debug)]
pub struct Random(u64);

impl Random {
    /// A generator from a seed.
    pub fn new(seed: u64) -> Random {
        Random(seed)
    }

    /// Uniform in [0, 1).
    pub fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// Carries out a pure built-in; `None` if it is none of them.
pub fn call(call: &Call<'_>, random: &mut Random) -> Option<Result<Value, String>> {
    mathematics(call, random)
        .or_else(|| list_library::call(call))
        .or_else(|| pose_library::call(call))
        .or_else(|| string_library::call(call))
}

fn mathematics(call: &Call<'_>, random: &mut Random) -> Option<Result<Value, String>> {
    let function: fn(f64) -> f64 = match call.name {
        "acos" => f64::acos,
        "asin" => f64::asin,
        "atan" => f64::atan,
        "cos" => f64::cos,
        "sin" => f64::sin,
        "tan" => f64::tan,
        "d2r" => f64::to_radians,
        "r2d" => f64::to_degrees,
        "exp" => f64::exp,
        "sqrt" => f64::sqrt,
        "random" => return Some(Ok(Value::Float(random.uniform()))),
        "abs" => return Some(absolute(call)),
        "ceil" | "floor" | "round" | "int" | "float" => return Some(rounded(call)),
        "atan2" | "log" | "pow" | "min" | "max" => return Some(of_two(call)),
        _ => return None,
    };
    let compute = || {
        let argument = call.required(0)?.number()?;
        let result = function(argument);
        if result.is_finite() {
            Ok(Value::Float(result))
        } else {
            Err(format!("{}({argument}) is not defined", call.name))
        }
    };
    Some(compute())
}

fn absolute(call: &Call<'_>) -> Result<Value, String> {
    match call.required(0)? {
        Value::Int(value) => Ok(Value::Int(value.wrapping_abs())),
        other => Ok(Value::Float(other.number()?.abs())),
    }
}

fn rounded(call: &Call<'_>) -> Result<Value, String> {
    let number = match call.required(0)? {
        Value::Bool(value) => f64::from(u8::from(*value)),
        other => other.number()?,
    };
    let whole = match call.name {
        "ceil" => number.ceil(),
        "floor" => number.floor(),
        "round" => number.round(),
        "int" => number.trunc(),
        _ => return Ok(Value::Float(number)),
    };
    if whole.abs() > f64::from(i32::MAX) || whole.is_nan() {
        return Err(format!("{}({number}) does not fit a whole number", call.name));
    }
    Ok(Value::Int(whole as i32))
}

fn of_two(call: &Call<'_>) -> Result<Value, String> {
    let (left, right) = (call.required(0)?, call.required(1)?);
    let (a, b) = (left.number()?, right.number()?);
    let result = match call.name {
        "atan2" => a.atan2(b),
        "log" => b.ln() / a.ln(),
        "pow" => a.powf(b),
        "min" => return Ok(if b < a { right.clone() } else { left.clone() }),
        _ => return Ok(if b > a { right.clone() } else { left.clone() }),
    };
    if result.is_finite() {
        Ok(Value::Float(result))
    } else {
        Err(format!("{}({a}, {b}) is not defined", call.name))
    }
}
