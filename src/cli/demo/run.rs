//! The demo from beginning to end: simulator and daemon in one process, connected through real sockets.
//!
//! In: an instance that fits the cell. Out: [`DemoOutcome`]; files are written by `output`. Calibration comes
//! first, as in a real cell: the daemon's nominal numbers are off by millimetres.

use crate::cli::demo::cell::{DemoChoice, cell_config, sim_file};
use crate::cli::demo::watch::Watch;
use crate::cli::sim::sim_config;
use crate::config::cell::{CameraMount, CellConfig};
use crate::daemon::calibrate::{Eye, Round, bring_up, collect, kinematics};
use crate::daemon::hardware::{Addresses, Hardware};
use crate::daemon::run::{Office, Shell, Workers, run};
use crate::daemon::setup::{
    Measured, arm_model, cell_model, eye_parameters, gripper_parameters, reference_markers,
};
use crate::daemon::workers::spawn_eye;
use crate::device::program::Nonce;
use crate::device::robot_types::{RobotCommand, RobotParameters};
use crate::geometry::pose::Pose2;
use crate::io::camera::CameraSource;
use crate::io::camera::http::HttpCamera;
use crate::io::clock::Clock;
use crate::io::recording::Recording;
use crate::planning::plan::Objective;
use crate::planning::solver::SolverKind;
use crate::sim::cell::{RunningSim, start};
use crate::sim::robot_server::RobotPorts;
use crate::sim::world::lock;
use crate::supervisor::cell::{Cell, Status};
use crate::supervisor::input::{Input, JournalEntry, OperatorCommand};
use crate::supervisor::order::{JobOrder, JobReport};
use crate::tabletop::instance::Instance;
use crate::time::{Duration, Timestamp};
use crate::vision::calibrate::{HandEye, HandEyeGuess, HandEyeSettings, solve_hand_eye};
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

/// The robot's session, 125 states a second: enough for 10 ms ticks, and a quarter of the work.
const RTDE_HZ: f64 = 125.0;

/// How long one frame may take, wall time: the simulator renders it on the same computer.
const FRAME_LIMIT: std::time::Duration = std::time::Duration::from_secs(20);

/// Runs the demo.
///
/// # Errors
/// One sentence: what could not be done, and what helps.
pub async fn demo(
    instance: &Instance,
    choice: &DemoChoice,
    out: &Path,
    stop: Arc<AtomicBool>,
) -> Result<DemoOutcome, String> {
    let mut config = cell_config(instance, choice, out)?;
    let file = sim_file(instance, &config, choice)?;
    let sim = start(sim_config(&file, choice.bind, RobotPorts::ANY)).await.map_err(|error| chain(&error))?;
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
    let clock = Clock::new(choice.time_factor);
    let addresses = Addresses {
        rtde: sim.addresses.robot.rtde,
        dashboard: sim.addresses.robot.dashboard,
        primary: sim.addresses.robot.primary,
        gripper: sim.addresses.modbus,
    };
    let mut parameters = RobotParameters::full_rate();
    parameters.frequency_hz = RTDE_HZ;
    let mut hardware = Hardware::open(&addresses, clock, parameters, gripper_parameters(config))
        .map_err(|error| chain(&error))?;
    let camera_address = format!("http://{}", sim.addresses.camera);
    let mut camera = HttpCamera::new(&camera_address, FRAME_LIMIT);
    let lens = tokio::task::block_in_place(|| camera.intrinsics()).map_err(|error| chain(&error))?;
    eprintln!("calibrating the camera on the arm ({} poses)", config.calibration_poses.len());
    let (dh, calibration) = calibrate(config, &mut hardware, Box::new(camera), &lens, choice, stop).await?;
    eprintln!(
        "calibrated: {:.2} px, {:.2} mm held out",
        calibration.reprojection_px_rms,
        calibration.held_out_rms_m.unwrap_or(f64::NAN) * 1e3
    );
    let measured = Measured {
        dh,
        base_from_table: calibration.base_from_table,
        flange_from_camera: calibration.flange_from_camera,
        camera: lens.clone(),
    };
    let model = cell_model(config, &measured).map_err(|error| error.to_string())?;
    let (answers_in, answers) = tokio::sync::mpsc::channel(16);
    let camera = HttpCamera::new(&camera_address, FRAME_LIMIT).with_lens(lens.clone());
    let detector = Detector::new(DetectSettings::default()).map_err(|error| error.to_string())?;
    let eye = spawn_eye(Box::new(camera), detector, eye_parameters(config, lens), clock, answers_in.clone());
    let recording = Recording::create(&out.join("run.mcap"), crate::io::clock::unix_now_s());
    let mut watch = Watch::new(recording.ok());
    let mut office = OneJob { order: Some(order(instance, choice)?), armed: false, over: stop.clone() };
    let shell = Shell {
        cell: Cell::new(model, choice.seed.wrapping_add(1000)),
        hardware,
        workers: Workers { eye, answers, answers_in },
        office: &mut office,
        observer: &mut watch,
    };
    run(shell, stop).await.map_err(|error| error.to_string())?;
    Ok((calibration, watch))
}

/// Drives the calibration poses and solves; the arm's kinematics come with it.
async fn calibrate(
    config: &CellConfig,
    hardware: &mut Hardware,
    camera: Box<dyn CameraSource + Send>,
    lens: &crate::vision::camera::CameraModel,
    choice: &DemoChoice,
    stop: &Arc<AtomicBool>,
) -> Result<(crate::motion::kinematics::DhParameters, HandEye), String> {
    let stopped = || stop.load(Ordering::Relaxed);
    let address = choice.bind.to_string();
    let dh = kinematics(hardware, &address, &stopped).await.map_err(|error| chain(&error))?.dh;
    let nonce = Nonce::new(choice.seed.wrapping_add(1));
    bring_up(hardware, nonce, &address, &stopped).await.map_err(|error| chain(&error))?;
    let model = arm_model(config, dh, config.base_from_table);
    let detector = Detector::new(DetectSettings::default()).map_err(|error| error.to_string())?;
    let mut round = Round { hardware, model: &model, nonce, stop: &stopped };
    let progress = |pose: usize, markers: usize| eprintln!("  pose {pose}: {markers} markers");
    let samples = collect(&mut round, &config.calibration_poses, Eye { camera, detector }, &progress)
        .await
        .map_err(|error| chain(&error))?;
    round.hardware.command_robot(RobotCommand::EndProgram);
    let CameraMount::Flange { flange_from_camera } = config.camera else {
        return Err("the demo's camera sits on the flange".to_string());
    };
    let guess = HandEyeGuess { flange_from_camera, base_from_table: config.base_from_table };
    let settings = HandEyeSettings::default();
    let solved = solve_hand_eye(&samples, &reference_markers(config), lens, &guess, &settings)
        .map_err(|error| chain(&error))?;
    Ok((dh, solved))
}

fn order(instance: &Instance, choice: &DemoChoice) -> Result<JobOrder, String> {
    let solver = SolverKind::from_word(&choice.solver)
        .ok_or_else(|| format!("there is no solver {:?}", choice.solver))?;
    Ok(JobOrder {
        id: "demo".to_string(),
        goals: instance.objects.iter().filter_map(|o| Some((o.id.clone(), o.goal?))).collect(),
        objective: Objective::Pp,
        solver,
        time_limit: Duration::from_secs_f64(choice.time_limit_s),
        seed: choice.seed,
        needs_approval: false,
    })
}

/// The demo's office: one job, armed at once because nothing real moves, over when the job is.
struct OneJob {
    order: Option<JobOrder>,
    armed: bool,
    over: Arc<AtomicBool>,
}

impl Office for OneJob {
    fn poll(&mut self, _now: Timestamp, wants_job: bool) -> Vec<Input> {
        let mut inputs = Vec::new();
        if !self.armed {
            self.armed = true;
            inputs.push(Input::Operator(OperatorCommand::Arm));
        }
        if wants_job {
            inputs.extend(self.order.take().map(|order| Input::Job(Box::new(order))));
        }
        inputs
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

/// An error with all its causes, in one line.
pub fn chain(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        text.push_str(": ");
        text.push_str(&error.to_string());
        cause = error.source();
    }
    text
}
