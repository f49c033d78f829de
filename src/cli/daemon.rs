//! `celld run` and `celld calibrate`: the daemon on real (or simulated) devices.
//!
//! In: the cell's configuration. Out: `run` works on job files until Ctrl-C; `calibrate` writes the three
//! calibration files. Exit codes as everywhere; a second daemon on one state folder is 1.

use crate::cli::demo::run::chain;
use crate::cli::task::complain;
use crate::config::cell::{CameraDevice, CameraMount, CellConfig};
use crate::config::load::load_cell;
use crate::daemon::calibrate::{Arm, Eye, Round, bring_up, collect, kinematics};
use crate::daemon::hardware::{Addresses, Hardware};
use crate::daemon::office::StateOffice;
use crate::daemon::run::{Event, Observer, Shell, Workers, run as run_shell};
use crate::daemon::setup::{
    Measured, arm_model, cell_model, eye_parameters, gripper_parameters, reference_markers,
};
use crate::daemon::workers::spawn_eye;
use crate::device::program::Nonce;
use crate::device::robot_types::{RobotCommand, RobotParameters};
use crate::io::camera::CameraSource;
use crate::io::camera::folder::FolderCamera;
use crate::io::camera::http::HttpCamera;
use crate::io::camera::video::VideoCamera;
use crate::io::clock::{Clock, unix_now_s};
use crate::io::files::write_atomic;
use crate::io::priority;
use crate::jobs::state::StateFolder;
use crate::jobs::utc;
use crate::supervisor::cell::Cell;
use crate::time::Timestamp;
use crate::vision::calibrate::{HandEye, HandEyeGuess, HandEyeSettings, solve_hand_eye};
use crate::vision::calibration::camera::CameraCalibration;
use crate::vision::calibration::hand_eye::{HandEyeCalibration, Provenance};
use crate::vision::calibration::table::TableCalibration;
use crate::vision::camera::CameraModel;
use crate::vision::detect::{DetectSettings, Detector};
use clap::Args;
use std::net::{SocketAddr, ToSocketAddrs};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// `celld run`
#[derive(Args, Clone, Debug)]
pub struct RunArgs {
    /// The cell's configuration.
    #[arg(long, default_value = "config/cell.yaml", value_name = "FILE")]
    config: PathBuf,
    /// The state folder: jobs, journal, commands.
    #[arg(long, default_value = "state", value_name = "DIR")]
    state: PathBuf,
}

/// `celld calibrate`
#[derive(Args, Clone, Debug)]
pub struct CalibrateArgs {
    /// The cell's configuration, with nominal camera mount, table and calibration poses.
    #[arg(long, default_value = "config/cell.yaml", value_name = "FILE")]
    config: PathBuf,
}

/// States a second asked of the robot: a state every 8 ms is fresh enough for the 100 ms limit.
const RTDE_HZ: f64 = 125.0;

/// How long a frame may take, wall time.
const FRAME_LIMIT: Duration = Duration::from_secs(20);

/// Runs the daemon until Ctrl-C; returns the exit code.
pub fn run(args: &RunArgs, stop: Arc<AtomicBool>) -> u8 {
    let config = match load_cell(&args.config) {
        Ok(config) => config,
        Err(error) => {
            complain(&error.to_string());
            return 2;
        }
    };
    let state = StateFolder::new(&args.state);
    let _lock = match state.take() {
        Ok(lock) => lock,
        Err(error) => {
            complain(&chain(&error));
            return 1;
        }
    };
    with_runtime(stop, |stop| daemon(config, state, stop))
}

/// Calibrates hand-eye and table; returns the exit code.
pub fn calibrate(args: &CalibrateArgs, stop: Arc<AtomicBool>) -> u8 {
    let config = match load_cell(&args.config) {
        Ok(config) => config,
        Err(error) => {
            complain(&error.to_string());
            return 2;
        }
    };
    with_runtime(stop, |stop| calibration(config, stop))
}

/// Runs a future with Ctrl-C raising `stop`; an error is one sentence and exit 1.
fn with_runtime<F>(stop: Arc<AtomicBool>, work: impl FnOnce(Arc<AtomicBool>) -> F) -> u8
where
    F: Future<Output = Result<(), String>>,
{
    priority::raise();
    let runtime =
        tokio::runtime::Builder::new_multi_thread().enable_all().on_thread_start(priority::raise).build();
    let runtime = match runtime {
        Ok(runtime) => runtime,
        Err(error) => {
            complain(&error.to_string());
            return 1;
        }
    };
    let raise = stop.clone();
    runtime.spawn(async move {
        if tokio::signal::ctrl_c().await.is_ok() {
            raise.store(true, Ordering::Relaxed);
        }
    });
    match runtime.block_on(work(stop)) {
        Ok(()) => 0,
        Err(message) => {
            complain(&message);
            1
        }
    }
}

fn resolve(host: &str, port: u16) -> Result<SocketAddr, String> {
    let fault = |cause: String| format!("{host}:{port}: {cause}; check `devices` in the configuration");
    let mut found = (host, port).to_socket_addrs().map_err(|error| fault(error.to_string()))?;
    found.next().ok_or_else(|| fault("no address".to_string()))
}

fn open_hardware(config: &CellConfig) -> Result<(Hardware, Clock), String> {
    let devices = &config.devices;
    let robot = |port| resolve(&devices.robot_host, port);
    let addresses = Addresses {
        rtde: robot(30004)?,
        dashboard: robot(29999)?,
        primary: robot(30001)?,
        gripper: resolve(&devices.gripper_host, devices.gripper_port)?,
    };
    let clock = Clock::new(config.simulation.map_or(1.0, |simulation| simulation.clock_factor));
    let mut parameters = RobotParameters::full_rate();
    parameters.frequency_hz = RTDE_HZ;
    let hardware = Hardware::open(&addresses, clock, parameters, gripper_parameters(config));
    hardware.map(|hardware| (hardware, clock)).map_err(|error| chain(&error))
}

fn open_camera(
    config: &CellConfig,
    lens: Option<CameraModel>,
) -> Result<Box<dyn CameraSource + Send>, String> {
    Ok(match &config.devices.camera {
        CameraDevice::Simulator { host, port } => {
            let camera = HttpCamera::new(&format!("http://{host}:{port}"), FRAME_LIMIT);
            Box::new(match lens {
                Some(lens) => camera.with_lens(lens),
                None => camera,
            })
        }
        CameraDevice::Folder { path } => {
            Box::new(FolderCamera::open(path, lens).map_err(|error| chain(&error))?)
        }
        CameraDevice::Video { path } => {
            Box::new(VideoCamera::open(path, lens).map_err(|error| chain(&error))?)
        }
    })
}

fn read<T, E: std::fmt::Display>(
    path: &Path,
    parse: impl Fn(&str, &str) -> Result<T, E>,
) -> Result<T, String> {
    let text = crate::cli::task::read_text(path)
        .map_err(|message| format!("{message}; `celld calibrate` makes the calibration files"))?;
    parse(&text, &path.display().to_string()).map_err(|complaints| complaints.to_string())
}

/// Calibration from its files; the kinematics come from the controller.
///
/// # Errors
/// A file that is missing or faulty, or a calibration made with another arm.
fn measured(config: &CellConfig, arm: &Arm) -> Result<Measured, String> {
    let files = &config.calibration;
    let hand_eye = read(&files.hand_eye, HandEyeCalibration::parse)?;
    let made_with = &hand_eye.provenance;
    if made_with.robot_serial != arm.serial || made_with.kinematics_checksum != arm.checksum {
        return Err(format!(
            "{}: made with robot {} (kinematics {}), but this is {} ({}); run `celld calibrate`",
            files.hand_eye.display(),
            made_with.robot_serial,
            made_with.kinematics_checksum,
            arm.serial,
            arm.checksum
        ));
    }
    Ok(Measured {
        dh: arm.dh,
        base_from_table: read(&files.table, TableCalibration::parse)?.base_from_table,
        flange_from_camera: hand_eye.flange_from_camera,
        camera: read(&files.camera, CameraCalibration::parse)?.model,
    })
}

async fn daemon(config: CellConfig, state: StateFolder, stop: Arc<AtomicBool>) -> Result<(), String> {
    let (mut hardware, clock) = open_hardware(&config)?;
    let seed = (unix_now_s() * 1e3) as u64;
    let mut office =
        StateOffice::open(config.clone(), state, format!("celld-{seed}")).map_err(|error| chain(&error))?;
    for notice in office.notices() {
        complain(&notice);
    }
    let stopped = || stop.load(Ordering::Relaxed);
    let arm = kinematics(&mut hardware, &config.devices.robot_host, &stopped)
        .await
        .map_err(|error| chain(&error))?;
    let measured = measured(&config, &arm)?;
    let model = cell_model(&config, &measured).map_err(|error| error.to_string())?;
    let (answers_in, answers) = tokio::sync::mpsc::channel(16);
    let camera = open_camera(&config, Some(measured.camera.clone()))?;
    let detector = Detector::new(DetectSettings::default()).map_err(|error| error.to_string())?;
    let eye =
        spawn_eye(camera, detector, eye_parameters(&config, measured.camera), clock, answers_in.clone());
    let mut cell = Cell::new(model, seed);
    if config.arm_at_start {
        cell.arm_at_start();
    }
    complain("celld runs; job files go into the state folder's jobs/incoming, Ctrl-C ends");
    let mut observer = Lines;
    let workers = Workers { eye, answers, answers_in };
    let shell = Shell { cell, hardware, workers, office: &mut office, observer: &mut observer };
    run_shell(shell, &stop).await.map_err(|error| error.to_string())
}

/// Sentences on stderr.
struct Lines;

impl Observer for Lines {
    fn on(&mut self, now: Timestamp, event: Event) {
        if let Event::Notice(notice) = event {
            let mark = if notice.alarm { "! " } else { "" };
            complain(&format!("{:9.1} s  {mark}{}", now.as_secs_f64(), notice.text));
        }
    }
}

async fn calibration(config: CellConfig, stop: Arc<AtomicBool>) -> Result<(), String> {
    let (mut hardware, _) = open_hardware(&config)?;
    let mut camera = open_camera(&config, None)?;
    let lens = tokio::task::block_in_place(|| camera.intrinsics()).map_err(|error| chain(&error))?;
    let (arm, solved) = solve(&config, &mut hardware, camera, &lens, &stop).await?;
    report(&solved);
    write_files(&config, &lens, &arm, &solved)
}

/// Drives the calibration poses and solves: which arm it was, and the solution.
async fn solve(
    config: &CellConfig,
    hardware: &mut Hardware,
    camera: Box<dyn CameraSource + Send>,
    lens: &CameraModel,
    stop: &Arc<AtomicBool>,
) -> Result<(Arm, HandEye), String> {
    let stopped = || stop.load(Ordering::Relaxed);
    let address = &config.devices.robot_host;
    let arm = kinematics(hardware, address, &stopped).await.map_err(|error| chain(&error))?;
    let nonce = Nonce::new((unix_now_s() * 1e3) as u64);
    bring_up(hardware, nonce, address, &stopped).await.map_err(|error| chain(&error))?;
    let model = arm_model(config, arm.dh, config.base_from_table);
    let detector = Detector::new(DetectSettings::default()).map_err(|error| error.to_string())?;
    let mut round = Round { hardware, model: &model, nonce, stop: &stopped };
    let count = config.calibration_poses.len();
    let progress = |pose: usize, markers: usize| complain(&format!("pose {pose}/{count}: {markers} markers"));
    let samples = collect(&mut round, &config.calibration_poses, Eye { camera, detector }, &progress)
        .await
        .map_err(|error| chain(&error))?;
    round.hardware.command_robot(RobotCommand::EndProgram);
    round.hardware.next().await;
    let CameraMount::Flange { flange_from_camera } = config.camera else {
        return Err("a fixed camera cannot be calibrated yet: `camera: {mount: flange}` only".to_string());
    };
    let guess = HandEyeGuess { flange_from_camera, base_from_table: config.base_from_table };
    let settings = HandEyeSettings::default();
    let solved = solve_hand_eye(&samples, &reference_markers(config), lens, &guess, &settings);
    Ok((arm, solved.map_err(|error| chain(&error))?))
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

fn write_files(config: &CellConfig, lens: &CameraModel, arm: &Arm, solved: &HandEye) -> Result<(), String> {
    let date = utc::text(unix_now_s());
    let provenance = Provenance {
        camera_serial: lens.serial.clone(),
        robot_serial: arm.serial.clone(),
        kinematics_checksum: arm.checksum.clone(),
        date: date.clone(),
    };
    let camera = CameraCalibration {
        model: lens.clone(),
        source: "factory intrinsics".to_string(),
        date,
        reprojection_px: None,
    };
    let hand_eye = HandEyeCalibration::from_solution(solved, provenance.clone());
    let table = TableCalibration::from_solution(solved, &reference_markers(config), provenance);
    let files = &config.calibration;
    let written = [
        (&files.camera, camera.to_yaml()),
        (&files.hand_eye, hand_eye.to_yaml()),
        (&files.table, table.to_yaml()),
    ];
    for (path, text) in written {
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
        }
        write_atomic(path, text.as_bytes()).map_err(|error| chain(&error))?;
        complain(&format!("wrote {}", path.display()));
    }
    Ok(())
}
