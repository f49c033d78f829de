//! From a round's samples to calibration files: solve for what is requested, report every sample's error,
//! tie to touches, write.
//!
//! In: the cell's configuration and a [`Taken`] round. Out: the three files, or why not; nothing is written
//! unless all of it can be trusted. What is computed is `cell_calibration::taken`.

use crate::cli::calibrate::fault::{Fault, bad_input};
use crate::cli::calibrate::round::RoundArgs;
use crate::cli::calibrate::touch;
use crate::config::calibrated::{known_mount, write_calibration};
use crate::config::cell::CellConfig;
use crate::config::setup::drawn;
use cell_calibration::fit::HandEye;
use cell_calibration::fit::solve::Solved;
use cell_calibration::taken::{Taken, Wanted};
use cell_edge::terminal::complain;
use cell_values::units::mm_from_m;
use rearrange::document::chain::chain;

/// Solves, reports, writes.
pub(super) fn finish(
    config: &CellConfig,
    mut taken: Taken,
    args: &RoundArgs,
    wanted: Wanted,
) -> Result<(), Fault> {
    taken.leave_out(&args.drop).map_err(bad_input)?;
    let known = match wanted {
        Wanted::MountAndTable => None,
        Wanted::Table => Some(known_mount(config, &taken.provenance).map_err(bad_input)?),
    };
    let drawn = drawn(config);
    let solved = taken.solve(&drawn, known);
    let solved = solved.map_err(|error| Fault { message: chain(&error), code: 1 })?;
    report_solution(&solved);
    let tied = touch::tied(config, &args.registration, &taken.provenance, &solved.table)?;
    let tied = tied.as_ref().map(|(touched, registration)| (touched.fit(), registration));
    let set = taken.calibrated(solved, &drawn, tied);
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
