//! The demo from beginning to end: simulator and daemon in one process, connected through real sockets.
//!
//! In: an instance that fits the cell. Out: [`DemoOutcome`]; files are written by `output`. Calibration
//! comes first, as in a real cell: the daemon's nominal numbers are off by millimetres.

use crate::cli::demo::watch::DemoObserver;
use crate::config::cell::{CameraDevice, CellConfig, Devices, RecordedPictures};
use crate::config::sessions::machine_parameters;
use crate::config::setup::{Measured, cell_model, drawn, nominal_model, scene};
use crate::daemon::cameras::open_camera;
use crate::daemon::intake::Sources;
use crate::daemon::recorder::Recorder;
use crate::daemon::shell::Shell;
use crate::daemon::sockets::Addresses;
use crate::daemon::store::Keeper;
use crate::daemon::workers::{PerceptionSetup, Sight};
use crate::demo::cell::{DemoChoice, sim_file};
use crate::demo::outcome::DemoOutcome;
use crate::io::camera::CameraSource;
use crate::io::camera::monitored::MonitoredCamera;
use crate::perception::Perception;
use cell_calibration::files::hand_eye::Mount;
use cell_calibration::fit::HandEye;
use cell_calibration::fit::solve::on_the_flange;
use cell_calibration::visit::{Samples, Stop};
use cell_edge::clock::Clock;
use cell_machine::orders::{Approval, Reply};
use cell_machine::supervisor::input::Record;
use cell_machine::supervisor::order::JobOrder;
use cell_machine::supervisor::round::RoundOrder;
use cell_machine::supervisor::status::Status;
use cell_values::time::{Duration, Timestamp};
use cell_vision::camera::CameraModel;
use cell_vision::detect::{DetectSettings, Detector};
use rearrange::document::chain::chain;
use rearrange::tabletop::instance::Instance;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use ur_sim::cell::{RunningSim, SimError, start};
use ur_sim::command::sim_config;
use ur_sim::faults::{FaultError, Planned};
use ur_sim::robot_server::RobotPorts;
use ur_sim::world::lock;

/// Why a demo did not come to its end.
#[derive(Debug, thiserror::Error)]
pub enum DemoError {
    /// A planned fault names something that is not in the scene.
    #[error("--faults: {0}")]
    Faults(FaultError),
    /// What could not be done, and what helps.
    #[error("{0}")]
    Failed(String),
}

impl From<String> for DemoError {
    fn from(sentence: String) -> DemoError {
        DemoError::Failed(sentence)
    }
}

/// Runs the demo.
///
/// # Errors
/// What could not be done.
pub async fn demo(
    instance: &Instance,
    choice: &DemoChoice,
    config: &CellConfig,
    faults: Vec<Planned>,
    out: &Path,
    stop: Arc<AtomicBool>,
) -> Result<DemoOutcome, DemoError> {
    let mut config = config.clone();
    let file = sim_file(instance, &config, choice)?;
    let mut simulated = sim_config(&file, choice.bind, RobotPorts::ANY);
    simulated.faults = faults;
    let sim = start(simulated).await.map_err(|error| match error {
        SimError::Fault(fault) => DemoError::Faults(fault),
        error => DemoError::Failed(chain(&error)),
    })?;
    config.devices.gripper_port = sim.addresses.modbus.port();
    let outcome = with_sim(instance, choice, out, &config, &sim, &stop).await;
    let truth = {
        let world = sim.world();
        let world = lock(&world);
        world.objects().iter().map(|body| (body.id.clone(), body.pose())).collect()
    };
    let factor = sim.factor_reached();
    sim.shutdown().await;
    let (calibration, mut watch) = outcome?;
    let recording_fault = watch.close();
    Ok(DemoOutcome { config, calibration, kept: watch.kept, truth, factor, recording_fault })
}

async fn with_sim(
    instance: &Instance,
    choice: &DemoChoice,
    out: &Path,
    config: &CellConfig,
    sim: &RunningSim,
    stop: &Arc<AtomicBool>,
) -> Result<(HandEye, DemoObserver), String> {
    let addresses = Addresses {
        rtde: sim.addresses.robot.rtde,
        dashboard: sim.addresses.robot.dashboard,
        primary: sim.addresses.robot.primary,
        gripper: sim.addresses.modbus,
        gripper_unit: config.devices.gripper_unit,
    };
    let clock = Clock::simulated(sim.addresses.robot.rtde, choice.time_factor);
    let mut parameters = machine_parameters(config, choice.seed.wrapping_add(1));
    parameters.robot.process = std::process::id();
    let mut shell = Shell::open(&addresses, clock, parameters).map_err(|error| chain(&error))?;
    let (calibration, measured) = calibrate(&mut shell, config, sim, stop).await?;
    let camera = camera_of(config, sim, Some(measured.camera.clone()))?;
    let scene = scene(config, &measured).map_err(|error| chain(&error))?;
    let perception = Perception::new(scene, DetectSettings::default()).map_err(|error| chain(&error))?;
    let sight = Sight::Cell(Box::new(perception));
    shell.see_with(PerceptionSetup { camera: Box::new(camera), sight, diagnostic_images: None, film: None });
    let model = cell_model(config, &measured).map_err(|error| error.to_string())?;
    // Nothing real moves: the cell arms itself.
    shell.commission(model, true);
    let job = OneJob { order: Some(order(instance, choice)), over: stop.clone() };
    shell.keep_in(Box::new(job), Sources::of(Vec::new()));
    let recorder =
        Recorder::create(&out.join("run.mcap"), RecordedPictures::Jpeg, Some(measured.camera.clone()));
    let mut watch = DemoObserver::new(recorder);
    shell.run(&mut watch, &|_| stop.load(Ordering::Relaxed)).await.map_err(|error| error.to_string())?;
    Ok((calibration, watch))
}

/// Camera and table measured, as on a real cell: the configuration's nominal numbers are off by millimetres.
async fn calibrate(
    shell: &mut Shell,
    config: &CellConfig,
    sim: &RunningSim,
    stop: &Arc<AtomicBool>,
) -> Result<(HandEye, Measured), String> {
    let mut camera = camera_of(config, sim, None)?;
    let lens = tokio::task::block_in_place(|| camera.intrinsics()).map_err(|error| chain(&error))?;
    let stopped = || stop.load(Ordering::Relaxed);
    let arm = shell.identify(&stopped).await.map_err(|error| chain(&error))?;
    eprintln!("calibrating the camera on the arm ({} poses)", config.calibration_poses.len());
    let detector = Detector::new(DetectSettings::default()).map_err(|error| error.to_string())?;
    shell.see_with(PerceptionSetup {
        camera: Box::new(camera),
        sight: Sight::Markers(Box::new(detector)),
        diagnostic_images: None,
        film: None,
    });
    shell.commission(nominal_model(config, &arm, &lens), false);
    let round = RoundOrder::pictures(config.calibration_poses.clone(), config.calibration_box);
    let progress: &dyn Fn(&Stop) =
        &|stop| eprintln!("  pose {}: {} markers", stop.pose, stop.sample.detections.len());
    let mut samples = Samples::new(progress);
    shell.round(round, &mut samples, &stopped).await.map_err(|error| chain(&error))?;
    let calibration = on_the_flange(&drawn(config), &lens, &samples.into_vec(), None);
    let calibration = calibration.map_err(|error| chain(&error))?;
    eprintln!(
        "calibrated: {:.2} px, {:.2} mm held out",
        calibration.reprojection_px_rms,
        calibration.held_out_rms_m.unwrap_or(f64::NAN) * 1e3
    );
    let measured = Measured {
        dh: arm.dh,
        base_from_table: calibration.base_from_table,
        mount: Mount::Flange { flange_from_camera: calibration.flange_from_camera },
        camera: lens,
        blends: true,
    };
    Ok((calibration, measured))
}

/// The simulated camera where it listens.
fn camera_of(
    config: &CellConfig,
    sim: &RunningSim,
    lens: Option<CameraModel>,
) -> Result<MonitoredCamera, String> {
    let (host, port) = (sim.addresses.camera.ip().to_string(), sim.addresses.camera.port());
    let camera = CameraDevice::Simulator { host, port, depth: true };
    let devices = Devices { camera, ..config.devices.clone() };
    open_camera(&devices, lens).map_err(|error| chain(&error))
}

fn order(instance: &Instance, choice: &DemoChoice) -> JobOrder {
    JobOrder {
        id: "demo".to_string(),
        goals: instance.objects.iter().filter_map(|o| Some((o.id.clone(), o.goal?))).collect(),
        objective: choice.objective,
        solver: choice.solver,
        time_limit: Duration::from_secs_f64(choice.time_limit_s),
        seed: choice.seed,
        approval: Approval::Never,
        rule: None,
        agreed: Vec::new(),
    }
}

/// The demo's keeper: one job, over when the job is. Nothing is kept.
struct OneJob {
    order: Option<JobOrder>,
    over: Arc<AtomicBool>,
}

impl Keeper for OneJob {
    fn commit(&mut self, record: &Record) -> Result<(), String> {
        if let Record::Ended(_) = record {
            self.over.store(true, Ordering::Relaxed);
        }
        Ok(())
    }

    fn look_after(&mut self, _now: Timestamp) -> Vec<String> {
        Vec::new()
    }

    fn claim(&mut self) -> Option<JobOrder> {
        self.order.take()
    }

    fn cancel_waiting(&mut self, _id: &str) -> Option<Reply> {
        None
    }

    fn status(&mut self, _status: &Status) {}
}
