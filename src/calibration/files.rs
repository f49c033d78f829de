//! The three calibration files together: read, checked against each other, the configuration and the arm;
//! written.
//!
//! In: the paths of the configuration. Out: [`CalibrationSet`], or every complaint about all three files at
//! once. A calibration is only as good as the agreement of camera, hand and table: files of different rounds,
//! of another camera or arm, or of markers that have been moved since are refused.

use crate::cell::event::Arm;
use crate::config::cell::{CalibrationFiles, CameraMount, CellConfig};
use crate::config::setup::{Measured, reference_markers};
use crate::document::Complaints;
use crate::io::files::{FileError, write_atomic};
use crate::vision::calibration::camera::CameraCalibration;
use crate::vision::calibration::hand_eye::{HandEyeCalibration, Provenance};
use crate::vision::calibration::table::TableCalibration;
use crate::vision::observe::ReferenceMarker;
use std::path::Path;

/// Distance (m) and angle (rad) by which a survey may differ from the configuration's: rounding in the files.
const SAME_PLACE: (f64, f64) = (1e-6, 1e-6);

/// Camera, hand-eye and table of one calibration round.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibrationSet {
    /// The lens.
    pub camera: CameraCalibration,
    /// Where the camera sits.
    pub hand_eye: HandEyeCalibration,
    /// The table under the robot.
    pub table: TableCalibration,
}

impl CalibrationSet {
    /// Reads all three files.
    ///
    /// # Errors
    /// Everything that is wrong with any of them, one complaint a line.
    pub fn read(config: &CellConfig) -> Result<CalibrationSet, String> {
        let files = &config.calibration;
        let camera = read(&files.camera, CameraCalibration::parse);
        let hand_eye = read(&files.hand_eye, HandEyeCalibration::parse);
        let table = read(&files.table, TableCalibration::parse);
        match (camera, hand_eye, table) {
            (Ok(camera), Ok(hand_eye), Ok(table)) => {
                let set = CalibrationSet { camera, hand_eye, table };
                let faults = set.faults(config);
                if faults.is_empty() { Ok(set) } else { Err(faults.join("\n")) }
            }
            (camera, hand_eye, table) => {
                let faults = [camera.err(), hand_eye.err(), table.err()];
                Err(faults.into_iter().flatten().collect::<Vec<_>>().join("\n"))
            }
        }
    }

    /// What does not fit together.
    fn faults(&self, config: &CellConfig) -> Vec<String> {
        let CalibrationFiles { hand_eye, table, .. } = &config.calibration;
        let mut faults = Vec::new();
        let mut differ = |path: &Path, what: &str, made_with: &str, now: &str| {
            if made_with != now {
                let path = path.display();
                faults.push(format!(
                    "{path}: made with {what} {made_with}, now it is {now}; run `celld calibrate`"
                ));
            }
        };
        let now = match &config.camera {
            CameraMount::Flange { .. } => "flange",
            CameraMount::Fixed { .. } => "fixed",
        };
        differ(hand_eye, "mount", self.hand_eye.mount.word(), now);
        let (hand, flat) = (&self.hand_eye.provenance, &self.table.provenance);
        differ(hand_eye, "camera", &hand.camera_serial, &self.camera.model.serial);
        differ(table, "camera", &flat.camera_serial, &self.camera.model.serial);
        differ(table, "robot", &flat.robot_serial, &hand.robot_serial);
        differ(table, "kinematics", &flat.kinematics_checksum, &hand.kinematics_checksum);
        let survey = reference_markers(config);
        if !same_survey(&self.table.reference_markers, &survey) {
            faults.push(format!(
                "{}: made with other reference markers than the configuration's; run `celld calibrate`",
                table.display()
            ));
        }
        faults
    }

    /// That the calibration was made with this arm.
    ///
    /// # Errors
    /// A sentence that names both arms.
    pub fn check_arm(&self, config: &CellConfig, arm: &Arm) -> Result<(), String> {
        let made_with = &self.hand_eye.provenance;
        if made_with.robot_serial == arm.serial && made_with.kinematics_checksum == arm.checksum {
            return Ok(());
        }
        Err(format!(
            "{}: made with robot {} (kinematics {}), but this is {} ({}); run `celld calibrate`",
            config.calibration.hand_eye.display(),
            made_with.robot_serial,
            made_with.kinematics_checksum,
            arm.serial,
            arm.checksum
        ))
    }

    /// The numbers that the daemon works with; the kinematics are the controller's.
    pub fn measured(&self, arm: &Arm) -> Measured {
        Measured {
            dh: arm.dh,
            base_from_table: self.table.base_from_table,
            mount: self.hand_eye.mount,
            camera: self.camera.model.clone(),
        }
    }

    /// Writes all three files and returns their paths.
    ///
    /// # Errors
    /// The first that could not be written.
    pub fn write<'a>(&self, files: &'a CalibrationFiles) -> Result<[&'a Path; 3], FileError> {
        let written: [(&Path, String); 3] = [
            (&files.camera, self.camera.to_yaml()),
            (&files.hand_eye, self.hand_eye.to_yaml()),
            (&files.table, self.table.to_yaml()),
        ];
        for (path, text) in &written {
            if let Some(folder) = path.parent() {
                crate::io::files::create_folder(folder)?;
            }
            write_atomic(path, text.as_bytes())?;
        }
        Ok(written.map(|(path, _)| path))
    }
}

/// Whose calibration it is.
pub fn provenance(camera_serial: &str, arm: &Arm, date: &str) -> Provenance {
    Provenance {
        camera_serial: camera_serial.to_string(),
        robot_serial: arm.serial.clone(),
        kinematics_checksum: arm.checksum.clone(),
        date: date.to_string(),
    }
}

fn same_survey(made_with: &[ReferenceMarker], now: &[ReferenceMarker]) -> bool {
    let same = |a: &ReferenceMarker, b: &ReferenceMarker| {
        let (distance, angle) = SAME_PLACE;
        a.id == b.id
            && (a.size - b.size).abs() <= distance
            && a.pose.distance(&b.pose) <= distance
            && a.pose.angle_difference(&b.pose) <= angle
    };
    made_with.len() == now.len() && made_with.iter().all(|a| now.iter().any(|b| same(a, b)))
}

fn read<T>(path: &Path, parse: impl Fn(&str, &str) -> Result<T, Complaints>) -> Result<T, String> {
    let text = crate::config::load::read_text(path).map_err(|reason| {
        format!("{}: {reason}; `celld calibrate` makes the calibration files", path.display())
    })?;
    parse(&text, &path.display().to_string()).map_err(|complaints| complaints.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::load::load_cell;

    /// The example cell with its files copied, so that they can be spoilt.
    fn example() -> (tempfile::TempDir, CellConfig) {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let mut config = load_cell(&root.join("config/cell.yaml")).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let copy = |path: &mut std::path::PathBuf| {
            let to = folder.path().join(path.file_name().unwrap());
            std::fs::copy(&*path, &to).unwrap();
            *path = to;
        };
        let files = &mut config.calibration;
        [&mut files.camera, &mut files.hand_eye, &mut files.table].into_iter().for_each(copy);
        (folder, config)
    }

    fn spoil(path: &Path, from: &str, to: &str) {
        let text = std::fs::read_to_string(path).unwrap();
        assert!(text.contains(from), "{text}");
        std::fs::write(path, text.replace(from, to)).unwrap();
    }

    #[test]
    fn the_example_fits_together_and_a_mixed_set_does_not() {
        let (_folder, config) = example();
        CalibrationSet::read(&config).unwrap();
        let mut moved = config.clone();
        moved.reference_markers[0].pose.x += 1e-3;
        assert!(CalibrationSet::read(&moved).unwrap_err().contains("other reference markers"));
        spoil(&config.calibration.camera, "sim-d405", "sim-d406");
        let told = CalibrationSet::read(&config).unwrap_err();
        assert!(told.contains("hand_eye.yaml: made with camera sim-d405"), "{told}");
        assert!(told.contains("table.yaml: made with camera sim-d405"), "{told}");
    }

    #[test]
    fn all_files_are_judged_in_one_go() {
        let (_folder, config) = example();
        std::fs::remove_file(&config.calibration.camera).unwrap();
        spoil(&config.calibration.hand_eye, "robot_serial", "robot_seral");
        spoil(&config.calibration.table, "std_m:", "std_mm:");
        let told = CalibrationSet::read(&config).unwrap_err();
        for part in ["camera.yaml", "`celld calibrate` makes", "robot_seral", "std_mm"] {
            assert!(told.contains(part), "{part} in {told}");
        }
    }
}
