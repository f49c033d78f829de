//! Whether the arm may cut corners: only where this controller, with this software and limits at least as
//! large, was recorded doing so.
//!
//! In: the configuration, the files `blends.yaml` and `blends.csv` of its calibration folder, the arm. Out:
//! how the arm passed the corners, judged from the recording each time; or a sentence that says why there
//! are no blends. A simulated arm needs no recording.

use crate::config::cell::CellConfig;
use cell_calibration::blends::{Passage, judge};
use cell_calibration::files::blends::{BlendRecording, RecordedLimits};
use cell_calibration::files::joints;
use cell_edge::files;
use cell_machine::event::Arm;
use cell_motion::path::ArmModel;
use cell_values::units::deg_from_rad;
use rearrange::document::chain::chain;
use std::path::{Path, PathBuf};

/// Largest recording that is read, bytes: minutes at 500 Hz.
const RECORDING_MAX: u64 = 16 << 20;

/// A recording that lets corners be cut.
#[derive(Clone, Debug)]
pub struct JudgedBlends {
    /// When it was made.
    pub date: String,
    /// How each path was followed.
    pub passages: Vec<Passage>,
}

impl JudgedBlends {
    /// The tool's highest speed in it, m/s.
    pub fn fastest_m_s(&self) -> f64 {
        self.passages.iter().map(|passage| passage.fastest_m_s).fold(0.0, f64::max)
    }

    /// The farthest that the tool was off its way, m.
    pub fn off_m(&self) -> f64 {
        self.passages.iter().map(|passage| passage.off_m).fold(0.0, f64::max)
    }
}

/// The configuration's limits for corners.
pub fn limits(config: &CellConfig) -> RecordedLimits {
    let limits = &config.limits;
    RecordedLimits {
        blend_m: limits.blend_m,
        joint_speed_deg_s: deg_from_rad(limits.joint_speed),
        joint_acceleration_deg_s2: deg_from_rad(limits.joint_acceleration),
        tool_speed_m_s: limits.tool_speed,
        tool_acceleration_m_s2: limits.tool_acceleration,
    }
}

/// Where the joints of a recording are.
pub fn joints_file(blends: &Path) -> PathBuf {
    blends.with_extension("csv")
}

/// The same moves as a program, to compare the simulated arm with.
pub fn script_file(blends: &Path) -> PathBuf {
    blends.with_extension("script")
}

/// The recording of this arm's blends, judged.
///
/// # Errors
/// There is none, it is of another controller or software or of smaller limits, it is broken, or the arm was
/// elsewhere or faster than checked.
pub fn recorded_blends(config: &CellConfig, model: &ArmModel, arm: &Arm) -> Result<JudgedBlends, String> {
    let path = &config.calibration.blends;
    let name = path.display().to_string();
    let text = files::read_named(path, 1 << 20).map_err(|error| chain(&error))?;
    let recording = BlendRecording::parse(&text, &name).map_err(|complaints| complaints.to_string())?;
    recording.check_robot(&name, &arm.serial, &arm.software)?;
    recording.check_limits(&name, &limits(config))?;
    let recorded = joints_file(path);
    let name = recorded.display();
    let text = files::read_named(&recorded, RECORDING_MAX).map_err(|error| chain(&error))?;
    let track = joints::parse(&text).map_err(|complaint| format!("{name}: {complaint}"))?;
    let passages = judge(model, &recording.paths, &track)
        .map_err(|(way, fault)| format!("{name}, way {way}: {fault}"))?;
    Ok(JudgedBlends { date: recording.date, passages })
}

/// Why the daemon stops the arm at each corner; `None` where it does not, or the configuration wants it so.
pub fn why_no_blends(config: &CellConfig, model: &ArmModel, arm: &Arm) -> Option<String> {
    if config.simulation.is_some() || config.limits.blend_m <= 0.0 {
        return None;
    }
    let why = recorded_blends(config, model, arm).err()?;
    Some(format!(
        "the arm stops at each corner, which takes longer: {why}; `celld calibrate blends` records how this \
         controller passes corners"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::calibrated::{measured, read_calibration};
    use crate::config::load::load_cell;
    use crate::config::setup::cell_model;
    use ur_arm::kinematics::DhParameters;

    /// A real arm that nobody has recorded: the model that plans its paths has no blends.
    #[test]
    fn without_a_recording_a_real_arm_stops_at_each_corner() {
        let mut config = load_cell(&Path::new(env!("CARGO_MANIFEST_DIR")).join("config/cell.yaml")).unwrap();
        let folder = tempfile::tempdir().unwrap();
        config.calibration.blends = folder.path().join("blends.yaml");
        let set = read_calibration(&config).unwrap();
        let made_with = set.hand_eye.provenance.clone();
        let arm = Arm {
            dh: DhParameters::UR5E,
            checksum: made_with.kinematics_checksum,
            serial: made_with.robot_serial,
            software: "URSoftware 5.13.0".to_string(),
        };
        let blend_m = |config: &CellConfig| {
            let measured = measured(config, &set, &arm).unwrap();
            let why = why_no_blends(config, &cell_model(config, &measured).unwrap().arm, &arm);
            (cell_model(config, &measured).unwrap().cycle.blend, why)
        };
        assert_eq!(blend_m(&config), (config.limits.blend_m, None), "a simulation");
        config.simulation = None;
        let (none, why) = blend_m(&config);
        assert!(
            none == 0.0 && why.as_ref().is_some_and(|why| why.contains("blends.yaml")),
            "{none}, {why:?}"
        );
        // A flag in the file does not enable blends.
        std::fs::write(&config.calibration.blends, "version: 1\nblends: true\n").unwrap();
        assert_eq!(blend_m(&config).0, 0.0);
        config.limits.blend_m = 0.0;
        assert_eq!(blend_m(&config), (0.0, None), "as the configuration wants it");
    }
}
