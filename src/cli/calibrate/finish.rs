//! From a round's samples to calibration files: solve for what is asked, say every sample's error, tie to
//! touches, write.
//!
//! In: the cell's configuration and a [`Taken`] round. Out: the three files, or why not; nothing is written
//! unless all of it can be believed. Whether the camera sits on the flange or stands decides the solver,
//! never the report.

use crate::calibration::files::CalibrationSet;
use crate::calibration::fit::solve;
use crate::cli::calibrate::{Fault, RoundArgs, Taken, Wanted, bad_input, touch};
use crate::cli::task::complain;
use crate::config::cell::{CameraMount, CellConfig};
use crate::config::setup::reference_markers;
use crate::document::chain::chain;
use crate::io::files;
use crate::units::mm_from_m;
use crate::vision::calibrate::fixed::{FixedGuess, solve_fixed, table_before};
use crate::vision::calibrate::{HandEye, HandEyeSettings, Sample};
use crate::vision::calibration::hand_eye::{HandEyeCalibration, Mount, Provenance};
use crate::vision::calibration::table::TableCalibration;

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
    let round = Round { config, lens: &taken.lens.model, samples: &samples };
    let solved = match config.camera {
        CameraMount::Flange { .. } => round.on_the_flange(known, &provenance),
        CameraMount::Fixed { .. } => round.fixed(known, &provenance),
    }?;
    let mut table =
        TableCalibration::from_solution(&solved.table, &reference_markers(config), provenance.clone());
    if let Some((touched, tied)) = touch::tied(config, &args.tie, &provenance, &solved.table)? {
        table = table.tied(&touched, &tied);
    }
    let set = CalibrationSet { camera: taken.lens, hand_eye: solved.hand_eye, table };
    let paths = set.write(&config.calibration).map_err(|error| Fault { message: chain(&error), code: 1 })?;
    for path in paths {
        complain(&format!("wrote {}", path.display()));
    }
    Ok(())
}

/// What a round says.
struct Solved {
    hand_eye: HandEyeCalibration,
    /// The fit that places the table.
    table: HandEye,
}

/// What there is to solve from.
struct Round<'a> {
    config: &'a CellConfig,
    lens: &'a crate::vision::camera::CameraModel,
    samples: &'a [Sample],
}

fn unsolved(error: &(dyn std::error::Error + 'static)) -> Fault {
    Fault { message: chain(error), code: 1 }
}

impl Round<'_> {
    fn on_the_flange(
        &self,
        known: Option<HandEyeCalibration>,
        provenance: &Provenance,
    ) -> Result<Solved, Fault> {
        let mount = known.as_ref().and_then(|known| match known.mount {
            Mount::Flange { flange_from_camera } => Some(flange_from_camera),
            Mount::Fixed { .. } => None,
        });
        let mut table =
            solve(self.config, self.lens, self.samples, mount).map_err(|error| unsolved(&error))?;
        if let Some(known) = &known {
            table.widen_by_mount(&known.std, self.lever_m(&table));
        }
        report("reference markers", &table);
        let hand_eye = known.unwrap_or_else(|| HandEyeCalibration::from_solution(&table, provenance.clone()));
        Ok(placed(Solved { hand_eye, table }))
    }

    /// Mean distance of the camera from the table's frame, m.
    fn lever_m(&self, table: &HandEye) -> f64 {
        let origin = table.base_from_table.translation.vector;
        let camera = |sample: &Sample| sample.base_from_flange * table.flange_from_camera;
        let far = self.samples.iter().map(|sample| (camera(sample).translation.vector - origin).norm());
        far.sum::<f64>() / self.samples.len().max(1) as f64
    }

    fn fixed(&self, known: Option<HandEyeCalibration>, provenance: &Provenance) -> Result<Solved, Fault> {
        let CameraMount::Fixed { base_from_camera, board, .. } = self.config.camera else {
            return Err(bad_input("the configuration's camera is not fixed".into()));
        };
        let (reference, settings) = (reference_markers(self.config), HandEyeSettings::default());
        let base_from_table = self.config.base_from_table;
        if let Some(known) = known {
            let camera = (known.mount.base_from_camera(&nalgebra::Isometry3::identity()), known.std.spread());
            let table =
                table_before(self.samples, &reference, self.lens, camera, &base_from_table, &settings);
            let table = table.map_err(|error| unsolved(&error))?;
            report("reference markers", &table);
            return Ok(placed(Solved { hand_eye: known, table }));
        }
        let start = FixedGuess { base_from_camera, base_from_table };
        let found = solve_fixed(self.samples, &board, &reference, self.lens, &start, &settings);
        let found = found.map_err(|error| unsolved(&error))?;
        report("board on the hand", &found.hand);
        report("reference markers", &found.table);
        let hand_eye = HandEyeCalibration::from_fixed(&found, provenance.clone());
        Ok(placed(Solved { hand_eye, table: found.table }))
    }
}

/// Says how well camera and table are known.
fn placed(solved: Solved) -> Solved {
    let told = |translation_m: f64, rotation_rad: f64| {
        format!("within {:.2} mm, {:.3} degrees", mm_from_m(translation_m), rotation_rad.to_degrees())
    };
    let (camera, table) = (&solved.hand_eye.std, &solved.table.base_from_table_std);
    complain(&format!(
        "camera ({}) known {}; table {} (standard deviations)",
        solved.hand_eye.mount.word(),
        told(camera.translation_m, camera.rotation_rad),
        told(table.translation_m, table.rotation_rad)
    ));
    solved
}

/// The mount measured before, if it is this camera's on this robot.
pub(super) fn known_mount(config: &CellConfig, now: &Provenance) -> Result<HandEyeCalibration, String> {
    let path = &config.calibration.hand_eye;
    let text = files::read_named(path, 1 << 20)
        .map_err(|error| format!("{}; run `celld calibrate hand-eye` first", chain(&error)))?;
    let known = HandEyeCalibration::parse(&text, &path.display().to_string());
    let known = known.map_err(|complaints| complaints.to_string())?;
    let wanted = match config.camera {
        CameraMount::Flange { .. } => "flange",
        CameraMount::Fixed { .. } => "fixed",
    };
    if known.mount.word() != wanted {
        return Err(format!(
            "{}: made with `mount: {}`, but the configuration says {wanted}; run `celld calibrate hand-eye`",
            path.display(),
            known.mount.word()
        ));
    }
    let same = known.provenance.camera_serial == now.camera_serial
        && known.provenance.robot_serial == now.robot_serial
        && known.provenance.kinematics_checksum == now.kinematics_checksum;
    if same {
        return Ok(known);
    }
    Err(format!(
        "{}: made with camera {} on robot {}, but this is {} on {}; run `celld calibrate hand-eye`",
        path.display(),
        known.provenance.camera_serial,
        known.provenance.robot_serial,
        now.camera_serial,
        now.robot_serial
    ))
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
