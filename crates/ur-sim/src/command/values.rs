//! Values of options that stand for keys of the configuration: an arm by its name, a software version.
//!
//! In: what was typed. Out: the value, or one sentence that says what to give.

use ur_arm::kinematics::{ARM_MODELS, ArmModel};

/// Build number of a version that was given without one.
const BUILD: u32 = 1_234_567;

/// An arm by its name, as UR10e.
///
/// # Errors
/// One sentence that says what to give.
pub fn model(text: &str) -> Result<ArmModel, String> {
    let found = ARM_MODELS.iter().find(|arm| arm.name.eq_ignore_ascii_case(text));
    found.copied().ok_or_else(|| {
        let names: Vec<&str> = ARM_MODELS.iter().map(|arm| arm.name).collect();
        format!("give one of {}", names.join(", "))
    })
}

/// A software version of three or four numbers: major, minor, bug fix, build.
///
/// # Errors
/// One sentence that says what to give.
pub fn software(text: &str) -> Result<[u32; 4], String> {
    let numbers: Option<Vec<u32>> = text.split('.').map(|part| part.parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[major, minor, bug_fix]) => Ok([major, minor, bug_fix, BUILD]),
        Some(&[major, minor, bug_fix, build]) => Ok([major, minor, bug_fix, build]),
        _ => Err("give a version with points between its numbers, as 5.13.0".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_arm_is_found_by_its_name_and_others_are_named() {
        assert_eq!(model("ur10E").unwrap().name, "UR10e");
        let refused = model("UR9").unwrap_err();
        assert!(ARM_MODELS.iter().all(|arm| refused.contains(arm.name)), "{refused}");
    }

    #[test]
    fn a_version_has_three_or_four_numbers() {
        assert_eq!(software("5.13.1"), Ok([5, 13, 1, BUILD]));
        assert_eq!(software("3.15.8.106339"), Ok([3, 15, 8, 106_339]));
        for text in ["", "5", "5.13", "5.13.x", "5.13.1.2.3", "5.13.-1", "5.13.99999999999"] {
            assert!(software(text).is_err(), "{text:?}");
        }
    }
}
