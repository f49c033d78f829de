//! Ranges of RTDE output variables: which numbers a controller may send.
//!
//! In: a variable's name and its value. Out: fine, or the number that no arm can have. The ranges are
//! physical bounds of every arm of the maker with a wide margin, not the limits of one model or of a cell:
//! a number outside is a broken package or a broken controller, and nothing computed from it can be
//! trusted. Of a variable without a range every number that is finite is fine.

use crate::rtde_values::Value;
use std::f64::consts::TAU;

/// Joints turn by 363 degrees each way at most; twice that is no position.
const JOINT_RAD: f64 = 2.0 * TAU;
/// Wrist 3 of some arms turns without end and its position is counted on.
const WRIST_3_RAD: f64 = 1000.0 * TAU;
/// The fastest joints turn at 360 degrees per second (6.3 rad/s); a collision adds little to that.
const JOINT_RAD_S: f64 = 20.0;
/// The longest arm reaches 1.75 m, with its tool a few metres.
const POSITION_M: f64 = 20.0;
/// A rotation vector is 180 degrees long; entered by hand, it may be a few turns.
const ROTATION_RAD: f64 = 4.0 * TAU;
/// The strongest arm carries 35 kg.
const PAYLOAD_KG: f64 = 100.0;
/// The pendant takes a centre of gravity within 1 m of the flange.
const CENTRE_M: f64 = 10.0;
/// Speed scaling and slider are 0 to 1; a limiter may overshoot, and rounding may fall below 0.
const SHARE: (f64, f64) = (-0.01, 2.0);
/// Ten years without a restart.
const UPTIME_S: f64 = 10.0 * 366.0 * 86_400.0;

/// A range of some doubles of a variable.
struct Row {
    variable: &'static str,
    /// First and last double of a vector.
    doubles: (usize, usize),
    low: f64,
    high: f64,
    unit: &'static str,
}

const fn row(
    variable: &'static str,
    doubles: (usize, usize),
    (low, high): (f64, f64),
    unit: &'static str,
) -> Row {
    Row { variable, doubles, low, high, unit }
}

const fn both_ways(bound: f64) -> (f64, f64) {
    (-bound, bound)
}

const ROWS: [Row; 13] = [
    row("timestamp", (0, 0), (0.0, UPTIME_S), " s"),
    row("actual_q", (0, 4), both_ways(JOINT_RAD), " rad"),
    row("actual_q", (5, 5), both_ways(WRIST_3_RAD), " rad"),
    row("actual_qd", (0, 5), both_ways(JOINT_RAD_S), " rad/s"),
    row("actual_TCP_pose", (0, 2), both_ways(POSITION_M), " m"),
    row("actual_TCP_pose", (3, 5), both_ways(ROTATION_RAD), " rad"),
    row("tcp_offset", (0, 2), both_ways(POSITION_M), " m"),
    row("tcp_offset", (3, 5), both_ways(ROTATION_RAD), " rad"),
    row("speed_scaling", (0, 0), SHARE, ""),
    row("target_speed_fraction", (0, 0), SHARE, ""),
    row("payload", (0, 0), (0.0, PAYLOAD_KG), " kg"),
    row("payload_cog", (0, 2), both_ways(CENTRE_M), " m"),
    row("payload_inertia", (0, 5), both_ways(PAYLOAD_KG * CENTRE_M * CENTRE_M), " kg m2"),
];

/// A number that no controller in order sends.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Implausible {
    /// NaN or infinite.
    #[error("{variable} is not a finite number")]
    NotFinite {
        /// Which variable.
        variable: String,
    },
    /// Outside its range.
    #[error(
        "{variable} is {}{unit} (number {} of its value), possible are {} to {}",
        short(.value), .index + 1, short(.low), short(.high)
    )]
    OutOfRange {
        /// Which variable.
        variable: String,
        /// Which double of its value, from 0.
        index: usize,
        /// The number.
        value: f64,
        /// Lowest possible.
        low: f64,
        /// Highest possible.
        high: f64,
        /// With a space in front; empty for a share.
        unit: &'static str,
    },
}

/// A number in a few characters, however large.
fn short(value: &f64) -> String {
    if value.abs() < 1e6 { format!("{value:.3}") } else { format!("{value:e}") }
}

/// Checks every number of a variable's value.
///
/// # Errors
/// The first number that is NaN, infinite, or outside the variable's range.
pub fn check(variable: &str, value: &Value) -> Result<(), Implausible> {
    if !value.is_finite() {
        return Err(Implausible::NotFinite { variable: variable.to_string() });
    }
    let doubles = value.doubles();
    let rows = ROWS.iter().filter(|row| row.variable == variable);
    for Row { doubles: (first, last), low, high, unit, .. } in rows {
        let numbered = doubles.iter().enumerate().skip(*first).take(last + 1 - first);
        if let Some((index, &value)) =
            numbered.into_iter().find(|(_, value)| !(*low..=*high).contains(*value))
        {
            let (variable, low, high, unit) = (variable.to_string(), *low, *high, *unit);
            return Err(Implausible::OutOfRange { variable, index, value, low, high, unit });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rtde_variables::output_type;

    /// The variable's zero with one of its doubles replaced.
    fn with(variable: &str, index: usize, number: f64) -> Value {
        match output_type(variable).unwrap().zero() {
            Value::Double(_) => Value::Double(number),
            Value::Vector3D(mut values) => {
                values[index] = number;
                Value::Vector3D(values)
            }
            Value::Vector6D(mut values) => {
                values[index] = number;
                Value::Vector6D(values)
            }
            other => panic!("{variable} is {other:?}"),
        }
    }

    #[test]
    fn every_ranged_variable_exists_and_each_of_its_doubles_has_one_range() {
        for Row { variable, .. } in &ROWS {
            let count = output_type(variable).unwrap().zero().doubles().len();
            for index in 0..count {
                let rows = ROWS.iter().filter(|row| {
                    row.variable == *variable && (row.doubles.0..=row.doubles.1).contains(&index)
                });
                assert_eq!(rows.count(), 1, "{variable} {index}");
            }
        }
    }

    #[test]
    fn numbers_at_a_bound_are_taken_and_those_beyond_it_are_not() {
        for Row { variable, doubles, low, high, .. } in &ROWS {
            for index in [doubles.0, doubles.1] {
                for good in [*low, *high, 0.0, -0.0] {
                    assert_eq!(check(variable, &with(variable, index, good)), Ok(()), "{variable}");
                }
                for bad in [low - 1e-3, high + high * 1e-6, 1e308, -1e308] {
                    let fault = check(variable, &with(variable, index, bad)).unwrap_err();
                    let Implausible::OutOfRange { index: named, value, .. } = fault else {
                        panic!("{variable}: {fault}")
                    };
                    assert_eq!((named, value), (index, bad), "{variable}");
                }
            }
        }
    }

    #[test]
    fn nan_and_infinities_are_refused_with_and_without_a_range() {
        for variable in ["actual_q", "payload", "actual_main_voltage", "joint_temperatures"] {
            for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
                let fault = check(variable, &with(variable, 0, bad)).unwrap_err();
                assert_eq!(fault.to_string(), format!("{variable} is not a finite number"));
            }
        }
    }

    #[test]
    fn a_speed_of_1e308_is_named_in_a_short_line() {
        let fault = check("actual_qd", &with("actual_qd", 2, 1e308)).unwrap_err();
        let text = "actual_qd is 1e308 rad/s (number 3 of its value), possible are -20.000 to 20.000";
        assert_eq!(fault.to_string(), text);
    }

    #[test]
    fn the_last_wrist_may_have_turned_many_times() {
        assert_eq!(check("actual_q", &with("actual_q", 5, 300.0 * TAU)), Ok(()));
        assert!(check("actual_q", &with("actual_q", 4, 300.0 * TAU)).is_err());
    }
}
