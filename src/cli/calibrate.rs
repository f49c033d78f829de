//! `celld calibrate`: camera on the hand and table under the robot, against live devices.
//!
//! In: the cell's configuration with its nominal mount, table and calibration poses. Out: the three calibration files,
//! and the error of every sample on stderr. Exit codes as everywhere.

use crate::cli::daemon::{open_camera, open_hardware, with_runtime};
use crate::cli::demo::run::chain;
use crate::cli::task::complain;
use crate::config::cell::CellConfig;
use crate::config::load::load_cell;
use crate::daemon::calibrate::{Arm, Eye, Setting, measure, solve};
use crate::daemon::calibration_files::{CalibrationSet, provenance};
use crate::daemon::setup::reference_markers;
use crate::device::program::Nonce;
use crate::io::clock::unix_now_s;
use crate::jobs::utc;
use crate::vision::calibrate::HandEye;
use crate::vision::calibration::camera::CameraCalibration;
use crate::vision::calibration::hand_eye::HandEyeCalibration;
use crate::vision::calibration::table::TableCalibration;
use crate::vision::camera::CameraModel;
use crate::vision::detect::{DetectSettings, Detector};
use clap::Args;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// `celld calibrate`
#[derive(Args, Clone, Debug)]
pub struct CalibrateArgs {
    /// The cell's configuration, with nominal camera mount, table and calibration poses.
    #[arg(long, default_value = "config/cell.yaml", value_name = "FILE")]
    config: PathBuf,
}

/// Calibrates hand-eye and table; returns the exit code.
pub fn run(args: &CalibrateArgs, stop: Arc<AtomicBool>) -> u8 {
    match load_cell(&args.config) {
        Ok(config) => with_runtime(stop, |stop| calibration(config, stop)),
        Err(error) => {
            complain(&error.to_string());
            2
        }
    }
}

async fn calibration(config: CellConfig, stop: Arc<AtomicBool>) -> Result<(), String> {
    let (mut hardware, _) = open_hardware(&config)?;
    let mut camera = open_camera(&config, None)?;
    let lens = tokio::task::block_in_place(|| camera.intrinsics()).map_err(|error| chain(&error))?;
    let detector = Detector::new(DetectSettings::default()).map_err(|error| error.to_string())?;
    let count = config.calibration_poses.len();
    let setting = Setting {
        config: &config,
        nonce: Nonce::new((unix_now_s() * 1e3) as u64),
        stop: &|| stop.load(Ordering::Relaxed),
        progress: &|pose, markers| complain(&format!("pose {pose}/{count}: {markers} markers")),
    };
    let eye = Eye { camera, detector };
    let (arm, samples) = measure(&mut hardware, eye, &setting).await.map_err(|error| chain(&error))?;
    let solved = solve(&config, &lens, &samples).map_err(|error| chain(&error))?;
    report(&solved);
    let written = set(&config, lens, &arm, &solved).write(&config.calibration).map(|paths| {
        for path in paths {
            complain(&format!("wrote {}", path.display()));
        }
    });
    written.map_err(|error| chain(&error))
}

fn report(solved: &HandEye) {
    let mm = |value: Option<f64>| value.map_or("-".to_string(), |m| format!("{:.2} mm", m * 1e3));
    complain(&format!("reprojection {:.3} px rms", solved.reprojection_px_rms));
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

fn set(config: &CellConfig, lens: CameraModel, arm: &Arm, solved: &HandEye) -> CalibrationSet {
    let date = utc::text(unix_now_s());
    let whose = provenance(&lens.serial, arm, &date);
    CalibrationSet {
        camera: CameraCalibration {
            model: lens,
            source: "factory intrinsics".to_string(),
            date,
            reprojection_px: None,
        },
        hand_eye: HandEyeCalibration::from_solution(solved, whose.clone()),
        table: TableCalibration::from_solution(solved, &reference_markers(config), whose),
    }
}
