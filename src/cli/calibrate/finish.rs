//! From a round's samples to calibration files: solve for what is requested, report every sample's error, tie
//! to touches, write.
//!
//! In: the cell's configuration and a [`Taken`] round. Out: the three files, or why not; nothing is written
//! unless all of it can be trusted. Whether the camera sits on the flange or is fixed decides the solver,
//! never the report.

use crate::calibration::files::hand_eye::{HandEyeCalibration, Provenance};
use crate::calibration::files::set::CalibrationSet;
use crate::calibration::files::table::TableCalibration;
use crate::calibration::fit::HandEye;
use crate::calibration::fit::solve::{Solved, solve};
use crate::cli::calibrate::fault::{Fault, bad_input};
use crate::cli::calibrate::round::{RoundArgs, Taken, Wanted};
use crate::cli::calibrate::touch;
use crate::config::calibrated::write_calibration;
use crate::config::cell::CellConfig;
use crate::config::setup::drawn;
use cell_edge::files;
use cell_edge::terminal::complain;
use cell_values::units::mm_from_m;
use rearrange::document::chain::chain;

/// Solves, reports, writes.
pub(super) fn finish(
    config: &CellConfig,
    taken: Taken,
    args: &RoundArgs,
    wanted: Wanted,
) -> Result<(), Fault> {
    let (mut samples, provenance) = (taken.samples, taken.provenance);
    for number in &args.drop {
        let Some(sample) = number.checked_sub(1).and_then(|index| samples.get_mut(index)) else {
            return Err(bad_input(format!("--drop {number}: there are samples 1 to {}", samples.len())));
        };
        sample.detections.clear();
    }
    let known = match wanted {
        Wanted::MountAndTable => None,
        Wanted::Table => Some(known_mount(config, &provenance).map_err(bad_input)?),
    };
    let drawn = drawn(config);
    let solved = solve(&drawn, &taken.lens.model, &samples, known, &provenance);
    let solved = solved.map_err(|error| Fault { message: chain(&error), code: 1 })?;
    report_solution(&solved);
    let mut table = TableCalibration::from_solution(&solved.table, &drawn.reference, provenance.clone());
    if let Some((touched, tied)) = touch::tied(config, &args.tie, &provenance, &solved.table)? {
        table = table.tied(&touched, &tied);
    }
    let set = CalibrationSet { camera: taken.lens, hand_eye: solved.hand_eye, table };
    let paths = write_calibration(&set, &config.calibration)
        .map_err(|error| Fault { message: chain(&error), code: 1 })?;
    for path in paths {
        complain(&format!("wrote {}", path.display()));
    }
    Ok(())
}

/// Says how every sample fits, and how well camera and table are known.
fn report_solution(solved: &Solved) {
    if let Some(board) = &solved.board {
        report("board on the hand", board);
    }
    report("reference markers", &solved.table);
    let reported = |translation_m: f64, rotation_rad: f64| {
        format!("within {:.2} mm, {:.3} degrees", mm_from_m(translation_m), rotation_rad.to_degrees())
    };
    let (camera, table) = (&solved.hand_eye.std, &solved.table.base_from_table_std);
    complain(&format!(
        "camera ({}) known {}; table {} (standard deviations)",
        solved.hand_eye.mount.as_str(),
        reported(camera.translation_m, camera.rotation_rad),
        reported(table.translation_m, table.rotation_rad)
    ));
}

/// The mount measured before, if it is this camera's on this robot.
pub(super) fn known_mount(config: &CellConfig, now: &Provenance) -> Result<HandEyeCalibration, String> {
    let path = &config.calibration.hand_eye;
    let text = files::read_named(path, 1 << 20)
        .map_err(|error| format!("{}; run `celld calibrate hand-eye` first", chain(&error)))?;
    let known = HandEyeCalibration::parse(&text, &path.display().to_string());
    let known = known.map_err(|complaints| complaints.to_string())?;
    known.check_devices(&path.display().to_string(), &config.camera, now)?;
    Ok(known)
}

fn report(what: &str, solved: &HandEye) {
    let mm = |value: Option<f64>| value.map_or("-".to_string(), |m| format!("{:.2} mm", m * 1e3));
    complain(&format!("{what}: reprojection {:.3} px rms", solved.reprojection_px_rms));
    complain(&format!("held out {} rms, {} at most", mm(solved.held_out_rms_m), mm(solved.held_out_max_m)));
    for sample in &solved.samples {
        let mark = if sample.rejected { "  rejected" } else { "" };
        complain(&format!(
            "  sample {:2}: {:2} markers, {:.3} px, {:.2} mm{mark}",
            sample.sample + 1,
            sample.markers,
            sample.residual_px,
            sample.residual_m * 1e3
        ));
    }
}
