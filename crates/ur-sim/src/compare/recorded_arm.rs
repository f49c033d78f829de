//! The simulated arm against recordings of a real UR10e, in the folder that CELLD_DATA names.

use crate::compare::comparison::compare;
use crate::compare::motions::motions;
use crate::compare::recording::read_recording;
use crate::compare::replay::{Replayed, replay};
use crate::controller::builtins::compile_program;
use std::fmt::Write;
use std::path::PathBuf;
use ur_arm::kinematics::ARM_MODELS;

/// Speed and acceleration of the recorded moves, rad/s and rad/s2: 40 and 50 degrees.
const LIMITS: [f64; 2] = [0.6981, 0.8727];

/// Ten moves without a blend: as far apart and as long as this at most, rad and s.
const APART_RAD: f64 = 5e-3;
const LONGER_S: f64 = 0.02;

#[test]
fn moves_without_a_blend_are_those_of_a_real_arm() {
    let folder = std::env::var_os("CELLD_DATA").map(|data| PathBuf::from(data).join("real/ur10e"));
    let file = folder.map(|folder| folder.join("ur-20_01_17-ptp_10_points.csv"));
    let Some(text) = file.and_then(|file| std::fs::read_to_string(file).ok()) else {
        eprintln!("SKIPPED: no recording of a real UR10e (set CELLD_DATA)");
        return;
    };
    let recorded = read_recording(&text, None).unwrap();
    let found = motions(&recorded, 0.0, recorded.interval_s());
    let arm = *ARM_MODELS.iter().find(|arm| arm.name == "UR10e").unwrap();
    // The arm was sent to where it rested.
    let mut program = "def work():\n".to_owned();
    for (number, motion) in found.iter().enumerate() {
        let next = found.get(number + 1).map_or(motion.ends_s() + 1.0, |next| next.begins_s);
        let q = recorded.at(0.5 * (motion.ends_s() + next)).unwrap();
        writeln!(program, " movej({q:?}, a={}, v={})", LIMITS[1], LIMITS[0]).unwrap();
    }
    let program = compile_program(&(program + "end\n")).unwrap();
    let which = Replayed { arm, kinematics: None, software: None };
    let (simulated, _) = replay(program, &which, recorded.joints[0], recorded.length_s()).unwrap();
    let comparison = compare(&recorded, &simulated).unwrap();
    assert!(comparison.motions.len() >= 9, "{} motions", comparison.motions.len());
    for pair in &comparison.motions {
        let (Some(real), Some(ours)) = (pair.recorded, pair.simulated) else { panic!("{pair:?}") };
        assert!((ours.lasts_s - real.lasts_s).abs() < LONGER_S, "{pair:?}");
        assert!(pair.largest_rad < APART_RAD, "{pair:?}");
    }
}
