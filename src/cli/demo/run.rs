//! The demo from beginning to end: simulator and daemon in one process, connected through real sockets.
//!
//! In: an instance that fits the cell. Out: [`DemoOutcome`]; files are written by `output`. Calibration comes
//! first, as in a real cell: the daemon's nominal numbers are off by millimetres.

use crate::cli::demo::cell::{DemoChoice, sim_file};
use crate::cli::demo::watch::Watch;
use crate::cli::recorder::Recorder;
use crate::cli::sim::sim_config;
use crate::config::cell::{CameraDevice, CellConfig};
use crate::daemon::calibrate::{Eye, Setting, measure, solve};
use crate::daemon::cameras::open_camera;
use crate::daemon::hardware::{Addresses, Hardware};
use crate::daemon::office::objective_of;
use crate::daemon::run::{Office, Shell, Workers, run};
use crate::daemon::setup::{Measured, cell_model, eye_parameters, gripper_parameters};
use crate::daemon::workers::spawn_eye;
use crate::device::program::Nonce;
use crate::device::robot_types::RobotParameters;
use crate::document::chain::chain;
use crate::geometry::pose::Pose2;
use crate::io::camera::CameraSource;
use crate::io::clock::Clock;
use crate::planning::solver::SolverKind;
use crate::sim::cell::{RunningSim, SimError, start};
use crate::sim::faults::{FaultError, Planned};
use crate::sim::robot_server::RobotPorts;
use crate::sim::world::lock;
use crate::supervisor::cell::{Cell, Status};
use crate::supervisor::input::{Input, JournalEntry, OperatorCommand};
use crate::supervisor::order::{ApprovalRule, JobOrder, JobReport};
use crate::tabletop::instance::Instance;
use crate::time::{Duration, Timestamp};
use crate::vision::calibrate::HandEye;
use crate::vision::calibration::hand_eye::Mount;
use crate::vision::detect::{DetectSettings, Detector};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// What became of a demo.
pub struct DemoOutcome {
    /// The daemon's configuration.
    pub config: CellConfig,
    /// What calibration found.
    pub calibration: HandEye,
    /// Everything that was seen and said.
    pub watch: Watch,
    /// True poses at the end, from the simulated world.
    pub truth: Vec<(String, Pose2)>,
    /// Simulated seconds per second that were reached.
    pub factor: f64,
    /// Why the recording is incomplete, if it is.
    pub recording_fault: Option<String>,
}

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

/// The robot's session, 125 states a second: enough for 10 ms ticks, and a quarter of the work.
const RTDE_HZ: f64 = 125.0;

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
    Ok(DemoOutcome { config, calibration, watch, truth, factor, recording_fault })
}

async fn with_sim(
    instance: &Instance,
    choice: &DemoChoice,
    out: &Path,
    config: &CellConfig,
    sim: &RunningSim,
    stop: &Arc<AtomicBool>,
) -> Result<(HandEye, Watch), String> {
    let clock = Clock::paced(sim.pace(), choice.time_factor);
    let addresses = Addresses {
        rtde: sim.addresses.robot.rtde,
        dashboard: sim.addresses.robot.dashboard,
        primary: sim.addresses.robot.primary,
        gripper: sim.addresses.modbus,
    };
    let mut devices = config.devices.clone();
    let (host, port) = (sim.addresses.camera.ip().to_string(), sim.addresses.camera.port());
    devices.camera = CameraDevice::Simulator { host, port, depth: true };
    let mut parameters = RobotParameters::full_rate();
    parameters.frequency_hz = RTDE_HZ;
    let mut hardware = Hardware::open(&addresses, clock.clone(), parameters, gripper_parameters(config))
        .map_err(|error| chain(&error))?;
    let open = |lens| open_camera(&devices, lens).map_err(|error| chain(&error));
    let mut camera = open(None)?;
    let lens = tokio::task::block_in_place(|| camera.intrinsics()).map_err(|error| chain(&error))?;
    eprintln!("calibrating the camera on the arm ({} poses)", config.calibration_poses.len());
    let detector = Detector::new(DetectSettings::default()).map_err(|error| error.to_string())?;
    let setting = Setting {
        config,
        nonce: Nonce::new(choice.seed.wrapping_add(1)),
        stop: &|| stop.load(Ordering::Relaxed),
        progress: &|look| eprintln!("  pose {}: {} markers", look.pose, look.sample.detections.len()),
    };
    let eye = Eye { camera: Box::new(camera), detector };
    let (arm, samples) = measure(&mut hardware, eye, &setting).await.map_err(|error| chain(&error))?;
    let calibration = solve(config, &lens, &samples, None).map_err(|error| chain(&error))?;
    eprintln!(
        "calibrated: {:.2} px, {:.2} mm held out",
        calibration.reprojection_px_rms,
        calibration.held_out_rms_m.unwrap_or(f64::NAN) * 1e3
    );
    let measured = Measured {
        dh: arm.dh,
        base_from_table: calibration.base_from_table,
        mount: Mount::Flange { flange_from_camera: calibration.flange_from_camera },
        camera: lens.clone(),
    };
    let model = cell_model(config, &measured).map_err(|error| error.to_string())?;
    let (answers_in, answers) = tokio::sync::mpsc::channel(16);
    let camera = open(Some(lens))?;
    let detector = Detector::new(DetectSettings::default()).map_err(|error| error.to_string())?;
    let eye_parameters = eye_parameters(config, &measured).map_err(|error| chain(&error))?;
    let eye = spawn_eye(Box::new(camera), detector, eye_parameters, clock, answers_in.clone());
    let mut watch = Watch::new(Recorder::create(&out.join("run.mcap"), true));
    let office = OneJob { order: Some(order(instance, choice)?), armed: false, over: stop.clone() };
    let cell = Cell::new(model, choice.seed.wrapping_add(1000));
    let shell =
        Shell::new(cell, hardware, Workers { eye, answers, answers_in }, Box::new(office), &mut watch);
    run(shell, stop).await.map_err(|error| error.to_string())?;
    Ok((calibration, watch))
}

fn order(instance: &Instance, choice: &DemoChoice) -> Result<JobOrder, String> {
    let solver = SolverKind::from_word(&choice.solver)
        .ok_or_else(|| format!("there is no solver {:?}", choice.solver))?;
    Ok(JobOrder {
        id: "demo".to_string(),
        goals: instance.objects.iter().filter_map(|o| Some((o.id.clone(), o.goal?))).collect(),
        objective: objective_of(choice.objective),
        solver,
        time_limit: Duration::from_secs_f64(choice.time_limit_s),
        seed: choice.seed,
        approval: ApprovalRule::NoPlan,
    })
}

/// The demo's office: one job, armed at once because nothing real moves, over when the job is.
struct OneJob {
    order: Option<JobOrder>,
    armed: bool,
    over: Arc<AtomicBool>,
}

impl Office for OneJob {
    fn commands(&mut self) -> Vec<Input> {
        let armed = std::mem::replace(&mut self.armed, true);
        if armed { Vec::new() } else { vec![Input::Operator(OperatorCommand::Arm)] }
    }

    fn jobs(&mut self, _now: Timestamp, wants_job: bool) -> Vec<Input> {
        let order = if wants_job { self.order.take() } else { None };
        order.map(|order| Input::Job(Box::new(order))).into_iter().collect()
    }

    fn journal(&mut self, _entry: &JournalEntry) -> Result<(), String> {
        Ok(())
    }

    fn finished(&mut self, _report: &JobReport) -> Result<(), String> {
        self.over.store(true, Ordering::Relaxed);
        Ok(())
    }

    fn status(&mut self, _status: &Status) {}
}
