//! The calibration files on disk: where the configuration says they are.
//!
//! In: a checked [`CellConfig`]. Out: [`CalibrationSet`], or every complaint about all three files at once;
//! one of them, where a calibration starts from it; the numbers that the daemon works with; files written.
//! What is in them, and what fits together, is `cell_calibration::files`.

use crate::config::blends::recorded_blends;
use crate::config::cell::{CalibrationFiles, CellConfig};
use crate::config::setup::{Measured, arm_model, reference_markers};
use crate::jobs::utc;
use cell_calibration::files::camera::CameraCalibration;
use cell_calibration::files::hand_eye::{HandEyeCalibration, Provenance};
use cell_calibration::files::set::{CalibrationSet, FileText};
use cell_edge::clock::unix_now_s;
use cell_edge::files::{self, FileError, create_folder};
use cell_edge::together::write_together;
use cell_machine::event::Arm;
use cell_parts::file::read_text;
use cell_vision::camera::CameraModel;
use rearrange::document::chain::chain;
use std::path::Path;

/// Reads all three files.
///
/// # Errors
/// Everything that is wrong with any of them, one complaint a line.
pub fn read_calibration(config: &CellConfig) -> Result<CalibrationSet, String> {
    let CalibrationFiles { camera, hand_eye, table, .. } = &config.calibration;
    let file = |path: &Path| FileText { name: path.display().to_string(), text: read_text(path) };
    let texts = [file(camera), file(hand_eye), file(table)];
    CalibrationSet::parse(&texts, &config.camera, &reference_markers(config))
}

/// Writes all three files and returns their paths.
///
/// # Errors
/// One of them could not be written; all are as they were then.
pub fn write_calibration<'a>(
    set: &CalibrationSet,
    files: &'a CalibrationFiles,
) -> Result<[&'a Path; 3], FileError> {
    let written: [(&Path, String); 3] = [
        (&files.camera, set.camera.to_yaml()),
        (&files.hand_eye, set.hand_eye.to_yaml()),
        (&files.table, set.table.to_yaml()),
    ];
    written.iter().filter_map(|(path, _)| path.parent()).try_for_each(create_folder)?;
    write_together(&written.each_ref().map(|(path, text)| (*path, text.as_bytes())))?;
    Ok(written.map(|(path, _)| path))
}

/// The lens that a file says was measured.
///
/// # Errors
/// Everything that is wrong with the file.
pub fn read_lens(path: &Path) -> Result<CameraCalibration, String> {
    let text = files::read_named(path, 1 << 20).map_err(|error| chain(&error))?;
    let lens = CameraCalibration::parse(&text, &path.display().to_string());
    lens.map_err(|complaints| complaints.to_string())
}

/// The lens to work with: the one `celld calibrate camera` measured for this camera at this size, or the
/// camera's own.
///
/// # Errors
/// A file that is broken, or of another camera.
pub fn lens_for(config: &CellConfig, own: CameraModel) -> Result<CameraCalibration, String> {
    let path = &config.calibration.camera;
    if path.exists() {
        // A broken file is for its owner to mend: it would be written over in the end.
        let known = read_lens(path)?;
        if known.measured.is_some() {
            known.check_camera(&path.display().to_string(), &own)?;
            return Ok(known);
        }
    }
    let (source, date) = ("factory intrinsics".to_string(), utc::text(unix_now_s()));
    Ok(CameraCalibration { model: own, source, date, reprojection_px: None, measured: None })
}

/// The mount measured before, if it is this camera's on this robot.
///
/// # Errors
/// A file that is missing, broken, or of other devices.
pub fn known_mount(config: &CellConfig, now: &Provenance) -> Result<HandEyeCalibration, String> {
    let path = &config.calibration.hand_eye;
    let text = files::read_named(path, 1 << 20)
        .map_err(|error| format!("{}; run `celld calibrate hand-eye` first", chain(&error)))?;
    let known = HandEyeCalibration::parse(&text, &path.display().to_string());
    let known = known.map_err(|complaints| complaints.to_string())?;
    known.check_devices(&path.display().to_string(), &config.camera, now)?;
    Ok(known)
}

/// The numbers that the daemon works with; the kinematics are the controller's.
///
/// # Errors
/// The calibration was made with another arm.
pub fn measured(config: &CellConfig, set: &CalibrationSet, arm: &Arm) -> Result<Measured, String> {
    set.check_arm(&config.calibration.hand_eye.display().to_string(), &arm.serial, &arm.checksum)?;
    let model = arm_model(config, arm.dh, set.table.base_from_table);
    Ok(Measured {
        dh: arm.dh,
        base_from_table: set.table.base_from_table,
        mount: set.hand_eye.mount,
        camera: set.camera.model.clone(),
        blends: config.simulation.is_some() || recorded_blends(config, &model, arm).is_ok(),
    })
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
        read_calibration(&config).unwrap();
        let mut moved = config.clone();
        moved.reference_markers[0].pose.x += 1e-3;
        assert!(read_calibration(&moved).unwrap_err().contains("other reference markers"));
        spoil(&config.calibration.camera, "sim-d405", "sim-d406");
        let reported = read_calibration(&config).unwrap_err();
        assert!(reported.contains("hand_eye.yaml: made with camera sim-d405"), "{reported}");
        assert!(reported.contains("table.yaml: made with camera sim-d405"), "{reported}");
    }

    /// A power cut between two of the three files.
    #[test]
    fn files_of_two_rounds_are_refused() {
        let (_folder, config) = example();
        let hand_eye = std::fs::read_to_string(&config.calibration.hand_eye).unwrap();
        let date = hand_eye.lines().find(|line| line.starts_with("date:")).unwrap();
        let table = std::fs::read_to_string(&config.calibration.table).unwrap();
        assert!(table.contains(&format!("\nhand_eye_{date}\n")), "{table}");
        read_calibration(&config).unwrap();
        spoil(&config.calibration.hand_eye, date, "date: \"2026-11-27T00:00:00Z\"");
        let reported = read_calibration(&config).unwrap_err();
        assert!(reported.contains("table.yaml: made with a hand-eye calibration of 2026"), "{reported}");
        assert!(reported.contains("now it is 2026-11-27T00:00:00Z; run `celld calibrate`"), "{reported}");
    }

    #[test]
    fn all_files_are_judged_in_one_go() {
        let (_folder, config) = example();
        std::fs::remove_file(&config.calibration.camera).unwrap();
        spoil(&config.calibration.hand_eye, "robot_serial", "robot_seral");
        spoil(&config.calibration.table, "std_m:", "std_mm:");
        let reported = read_calibration(&config).unwrap_err();
        for part in ["camera.yaml", "`celld calibrate` makes", "robot_seral", "std_mm"] {
            assert!(reported.contains(part), "{part} in {reported}");
        }
    }
}
