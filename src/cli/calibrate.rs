//! `celld calibrate`: the lens, the camera on the hand or over the table, the table under the robot.
//!
//! In: the cell's configuration with its nominal mount, table and calibration poses, and live devices or a
//! recorded round. Out: calibration files, and the error of every sample on stderr. `camera` measures the
//! lens (its own file), `hand-eye` (and no word at all) mount and table together, `table` the table alone
//! after it was moved, `touches` records points that the tool's tip touched, which `table` ties to what the
//! camera sees. Exit codes as everywhere.

mod blends;
pub mod camera;
mod empty;
mod fault;
mod finish;
mod round;
mod stops;
mod take;
pub mod touch;
mod trial;

use crate::cli::daemon::{open_camera, open_shell, with_runtime};
use crate::config::calibrated::{known_mount, lens_for, read_lens};
use crate::config::cell::CellConfig;
use crate::config::empty::keep_if_empty;
use crate::config::load::load_cell;
use crate::config::round::{RecordedRound, Recording};
use crate::config::setup::{arm_model, drawn, nominal_model};
use crate::daemon::workers::{PerceptionSetup, Sight};
use crate::io::camera::CameraSource;
use crate::io::camera::monitored::MonitoredCamera;
use crate::jobs::utc;
use cell_calibration::files::camera::CameraCalibration;
use cell_calibration::files::hand_eye::Provenance;
use cell_calibration::propose;
use cell_calibration::taken::{Taken, Wanted};
use cell_calibration::visit::{Samples, Stop};
use cell_edge::clock::unix_now_s;
use cell_edge::terminal::{complain, print};
use cell_machine::event::Arm;
use cell_machine::supervisor::round::RoundOrder;
use cell_vision::camera::CameraModel;
use cell_vision::detect::{DetectSettings, Detector};
use clap::{Args, Subcommand};
use fault::{Fault, bad_input};
use finish::finish;
use rearrange::document::chain::chain;
use round::RoundArgs;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use ur_arm::kinematics::DhParameters;

/// `celld calibrate`
#[derive(Args, Clone, Debug)]
#[command(args_conflicts_with_subcommands = true)]
pub struct CalibrateArgs {
    #[command(subcommand)]
    what: Option<What>,
    #[command(flatten)]
    round: RoundArgs,
}

#[derive(Subcommand, Clone, Debug)]
enum What {
    /// The lens, from pictures of a printed board
    Camera(camera::CameraArgs),
    /// Where the camera sits (on the flange, or fixed over the table), and the table under the robot
    #[command(after_help = HAND_EYE_HELP)]
    HandEye(HandEyeArgs),
    /// The table alone, after it was moved: the camera's place is kept; with --touches, tied to what the
    /// tool's tip touched
    #[command(after_help = TABLE_HELP)]
    Table(RoundArgs),
    /// Pictures of the empty table from the look poses, for cameras without depth to compare with
    #[command(after_help = empty::HELP)]
    Empty(empty::EmptyArgs),
    /// How this controller passes corners that are cut: the arm moves, celld records and judges it
    #[command(after_help = blends::HELP)]
    Blends(trial::TrialArgs),
    /// How this arm stops: by order, without celld, by the dashboard; the arm moves, celld measures
    #[command(after_help = stops::HELP)]
    Stops(trial::TrialArgs),
    /// Record points of the table that the tool's tip touches: a person moves the arm, in Local Control
    #[command(after_help = touch::HELP)]
    Touches(touch::TouchArgs),
}

const HAND_EYE_HELP: &str = "\
With `camera: {mount: flange}` the camera looks at the reference markers from the taught
`calibration_poses_deg`. With `camera: {mount: fixed, base_from_camera, board}` the hand carries
the board through the picture of a camera that stands; the reference markers seen meanwhile place
the table. `celld sim` draws such a cell: base_from_camera and hand_board in its configuration
(docs/simulator.md).

Poses need not be taught: give a `calibration_box` in the configuration, which the flange does not
leave; gripper and camera reach beyond it and the elbow goes anywhere, so keep the arm's whole
reach free of people and things. For a camera that stands, tell how the board is clamped, within 2
cm and 10 degrees: flange_from_board in `camera`; the poses keep arm and board 0.2 m clear of
where the configuration has the camera, its stand is yours to keep clear. Then
  celld calibrate hand-eye --propose              # prints poses in the box, as calibration_poses_deg
  celld calibrate hand-eye --visit --yes          # proposes, moves there slowly, looks, calibrates
Poses that leave a rotation out are refused with its name. Expect under 0.3 px, and under 0.5 mm
for held-out samples.";

const TABLE_HELP: &str = "\
Register the table to the tool as well: touch at least three marked points far apart, not on one
line, then
  celld calibrate touches --points 500,501,502,503 --tip-mm 0,0,150 --save touches.yaml
  celld calibrate table --touches touches.yaml
Touches know nothing of lens and mount. Expect them within 0.5 mm, and touches and camera to agree
within 1 mm and 0.2 degrees; above --tie-mm or --tie-deg nothing is written.";

/// A round for camera and table, from taught or proposed poses.
#[derive(Args, Clone, Debug)]
pub struct HandEyeArgs {
    #[command(flatten)]
    round: RoundArgs,
    /// Print this many poses within the configuration's `calibration_box` and stop; nothing moves.
    #[arg(long, value_name = "N", num_args = 0..=1, default_missing_value = "15",
          conflicts_with_all = ["from", "record", "visit"],
          value_parser = clap::value_parser!(u16).range(8..=60))]
    propose: Option<u16>,
    /// Propose this many poses within `calibration_box` and move the arm to them instead of the taught ones.
    #[arg(long, value_name = "N", num_args = 0..=1, default_missing_value = "15", conflicts_with = "from",
          value_parser = clap::value_parser!(u16).range(8..=60))]
    visit: Option<u16>,
    /// The arm's reach is free of people and things: let it move to the proposed poses.
    #[arg(long, requires = "visit")]
    yes: bool,
}

/// Calibrates; returns the exit code.
pub fn run(args: &CalibrateArgs, stop: Arc<AtomicBool>) -> u8 {
    match &args.what {
        None => round(&args.round, Wanted::MountAndTable, None, stop),
        Some(What::HandEye(args)) => hand_eye(args, stop),
        Some(What::Table(args)) => round(args, Wanted::Table, None, stop),
        Some(What::Empty(args)) => empty_table(args, stop),
        Some(What::Camera(args)) => camera::run(args),
        Some(What::Touches(args)) => touch::run(args, stop),
        Some(What::Blends(args)) => blends::run(args, stop),
        Some(What::Stops(args)) => stops::run(args, stop),
    }
}

fn hand_eye(args: &HandEyeArgs, stop: Arc<AtomicBool>) -> u8 {
    let count = args.propose.or(args.visit).map(usize::from);
    match count {
        Some(count) if !args.yes => {
            let reported = load_cell(&args.round.config).map_err(|error| error.to_string());
            match reported.and_then(|config| on_paper(&config, count)) {
                Ok(text) => print(&text),
                Err(message) => {
                    complain(&message);
                    return 2;
                }
            }
            if args.visit.is_none() {
                return 0;
            }
            complain(
                "the arm would move to poses like these, chosen from where it then stands; the flange stays \
                 in the box, gripper and elbow do not: when the arm's whole reach is free of people and \
                 things (a fixed camera's stand too), add --yes",
            );
            2
        }
        count => round(&args.round, Wanted::MountAndTable, count, stop),
    }
}

/// Proposed poses as the text that goes into the configuration.
fn on_paper(config: &CellConfig, count: usize) -> Result<String, String> {
    // Before a camera is waited for.
    let drawn = drawn(config);
    propose::check(&drawn)?;
    let arm = arm_model(config, DhParameters::UR5E, config.base_from_table);
    let proposal = propose::on_paper(&drawn, &known_lens(config)?, &arm, count)?;
    complain(&proposal.sentence());
    Ok(proposal.yaml())
}

fn known_lens(config: &CellConfig) -> Result<CameraModel, String> {
    let path = &config.calibration.camera;
    if !path.exists() {
        return camera_and_lens(config).map(|(_, lens)| lens.model);
    }
    read_lens(path).map(|known| known.model)
}

fn round(args: &RoundArgs, wanted: Wanted, proposed: Option<usize>, stop: Arc<AtomicBool>) -> u8 {
    let config = match load_cell(&args.config) {
        Ok(config) => config,
        Err(error) => {
            complain(&error.to_string());
            return 2;
        }
    };
    // Before the arm moves for nothing.
    let proposing = proposed.map_or(Ok(()), |_| propose::check(&drawn(&config)).map_err(bad_input));
    if let Err(fault) = proposing.and_then(|()| args.registration.fitted(&config)) {
        complain(&fault.message);
        return fault.code;
    }
    if args.from.is_some() {
        return match recorded(&config, args).and_then(|taken| finish(&config, taken, args, wanted)) {
            Ok(()) => 0,
            Err(fault) => {
                complain(&fault.message);
                fault.code
            }
        };
    }
    let args = args.clone();
    with_runtime(stop, move |stop| async move {
        let ready = |arm: &Provenance| fits_arm(&config, &args, wanted, arm).map_err(|fault| fault.message);
        let taken = live(&config, args.record.as_deref(), proposed, &ready, stop).await?;
        finish(&config, taken, &args, wanted).map_err(|fault| fault.message)
    })
}

/// Takes the pictures of the empty table.
fn empty_table(args: &empty::EmptyArgs, stop: Arc<AtomicBool>) -> u8 {
    let Some((config, folder)) = empty::prepare(args) else { return 2 };
    with_runtime(stop, move |stop| async move {
        let taken = live(&config, Some(&folder), None, &|_| Ok(()), stop).await?;
        keep_if_empty(&config, &folder, &taken.samples)
    })
}

/// What a round rests on that was made before: the touches and the mount have to be this arm's.
fn fits_arm(config: &CellConfig, args: &RoundArgs, wanted: Wanted, arm: &Provenance) -> Result<(), Fault> {
    if wanted == Wanted::Table {
        known_mount(config, arm).map_err(bad_input)?;
    }
    match args.registration.fitted(config)? {
        Some(touched) => Ok(touched.check_robot(arm)?),
        None => Ok(()),
    }
}

/// Moves the arm round: to the taught poses, or to so many proposed ones. Pictures and poses are kept in the
/// folder `record`. Nothing moves before `ready` has agreed with camera and arm.
async fn live(
    config: &CellConfig,
    record: Option<&Path>,
    proposed: Option<usize>,
    ready: &dyn Fn(&Provenance) -> Result<(), String>,
    stop: Arc<AtomicBool>,
) -> Result<Taken, String> {
    let mut shell = open_shell(config, (unix_now_s() * 1e3) as u64)?;
    let (camera, lens) = camera_and_lens(config)?;
    let detector = Detector::new(DetectSettings::default()).map_err(|error| error.to_string())?;
    let stopped = || stop.load(Ordering::Relaxed);
    let arm = shell.identify(&stopped).await.map_err(|error| chain(&error))?;
    let provenance = of_arm(&lens.model, &arm);
    ready(&provenance)?;
    let poses = match proposed {
        None => config.calibration_poses.clone(),
        Some(count) => {
            // What was sent meanwhile is old.
            shell.listen().await;
            let state = shell.robot_state().ok_or("the robot does not say where it is")?;
            let arm = arm_model(config, arm.dh, config.base_from_table);
            let proposal = propose::from_here(&drawn(config), &lens.model, &arm, state.q, count)?;
            complain(&proposal.sentence());
            complain(proposal.yaml().trim_end());
            proposal.poses
        }
    };
    let count = poses.len();
    let recording = record.map(Recording::new).transpose()?;
    let progress = |stop: &Stop| {
        complain(&format!("pose {}/{count}: {} markers", stop.pose, stop.sample.detections.len()));
        if let Some(recording) = &recording {
            recording.keep(stop);
        }
    };
    shell.see_with(PerceptionSetup {
        camera: Box::new(camera),
        sight: Sight::Markers(Box::new(detector)),
        diagnostic_images: None,
        film: None,
    });
    shell.commission(nominal_model(config, &arm, &lens.model), false);
    let mut samples = Samples::new(&progress);
    let order = RoundOrder::pictures(poses, config.calibration_box);
    shell.round(order, &mut samples, &stopped).await.map_err(|error| chain(&error))?;
    let samples = samples.into_vec();
    if let Some((recording, folder)) = recording.zip(record) {
        let kept = recording.close(&lens, &provenance)?;
        complain(&format!("recorded {kept} samples in {}", folder.display()));
    }
    Ok(Taken { lens, provenance, samples })
}

fn of_arm(lens: &CameraModel, arm: &Arm) -> Provenance {
    Provenance {
        camera_serial: lens.serial.clone(),
        robot_serial: arm.serial.clone(),
        kinematics_checksum: arm.checksum.clone(),
        date: utc::text(unix_now_s()),
    }
}

/// The cell's camera, and the lens to work with. A camera that reports no lens needs a measured one first.
fn camera_and_lens(config: &CellConfig) -> Result<(MonitoredCamera, CameraCalibration), String> {
    if config.devices.camera.knows_its_lens() {
        let mut camera = open_camera(config, None)?;
        match camera.intrinsics() {
            Ok(own) => return lens_for(config, own).map(|lens| (camera, lens)),
            // What its factory says may be of no use; then the measured lens is all that is needed.
            Err(_) if config.calibration.camera.exists() => drop(camera),
            Err(error) => return Err(chain(&error)),
        }
    }
    let lens = read_lens(&config.calibration.camera).map_err(|error| {
        format!("{error}; this camera reports no intrinsics: measure it with `celld calibrate camera`")
    })?;
    Ok((open_camera(config, Some(lens.model.clone()))?, lens))
}

/// Reads a recorded round and finds its markers.
fn recorded(config: &CellConfig, args: &RoundArgs) -> Result<Taken, Fault> {
    let folder = args.from.as_deref().unwrap_or(Path::new("."));
    let recorded = RecordedRound::read(folder).map_err(bad_input)?;
    let lens = lens_for(config, recorded.own.clone()).map_err(bad_input)?;
    let progress = |number: usize, image: &str, markers: usize| {
        complain(&format!("sample {number:2}, {image}: {markers} markers"));
    };
    let samples = recorded.samples(&lens.model, &progress).map_err(bad_input)?;
    Ok(Taken { lens, provenance: recorded.round.provenance, samples })
}

#[cfg(test)]
mod tests;
