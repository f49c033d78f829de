//! `celld run`: the daemon on real (or simulated) devices, and what `celld calibrate` shares with it.
//!
//! In: the cell's configuration and the state folder. Out: work on job files, and the page where one is
//! configured, until Ctrl-C or SIGTERM. Bad
//! configuration or calibration files are exit 2, before any device is touched; a second daemon on one state
//! folder is 1.

use crate::cli::in_fleet::{Anew, Parts, Shared, fleet, is_to_start_disarmed, start_with, take_shared};
use crate::cli::interrupt;
use crate::config::blends::why_no_blends;
use crate::config::calibrated::{measured, read_calibration};
use crate::config::cell::CellConfig;
use crate::config::empty::compare_with_empty;
use crate::config::sessions::{clock, gripper_address, machine_parameters};
use crate::config::setup::{Measured, cell_model, cell_objects, scene};
use crate::daemon::cameras;
use crate::daemon::film::Film;
use crate::daemon::gripper_memory::GripperMemory;
use crate::daemon::intake::{Orders, Sources};
use crate::daemon::keeper::{Identities, StateKeeper};
use crate::daemon::last_picture::LastPicture;
use crate::daemon::reception::Reception;
use crate::daemon::recorder::{self, Recorder};
use crate::daemon::shell::{Observer, Scene, Shell, StartError};
use crate::daemon::sockets::Addresses;
use crate::daemon::state_orders::StateOrders;
use crate::daemon::watchdog::{Beats, Watchdog};
use crate::daemon::workers::{PerceptionSetup, Sight};
use crate::doctor::files::blocked_poses;
use crate::io::camera::monitored::MonitoredCamera;
use crate::jobs::inbox::Inbox;
use crate::jobs::state::StateFolder;
use crate::jobs::status::{Remarks, Status};
use crate::page::feed::{Feed, KnownCell, Watcher};
use crate::page::orders::order_channel;
use crate::page::shared::Setup;
use crate::page::texts::Texts;
use crate::page::{ServeError, app};
use crate::perception::Perception;
use cell_calibration::files::set::CalibrationSet;
use cell_edge::clock::unix_now_s;
use cell_edge::files::FileError;
use cell_edge::priority;
use cell_edge::terminal::{complain, complain_within};
use cell_machine::event::Arm;
use cell_machine::orders::ConfirmedGripper;
use cell_machine::supervisor::model::CellModel;
use cell_values::time::Timestamp;
use cell_vision::camera::CameraModel;
use cell_vision::detect::DetectSettings;
use clap::Args;
use rearrange::document::chain::chain;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// When a name without an address is looked up again.
const NAMES_AGAIN: std::time::Duration = std::time::Duration::from_secs(2);

/// From the robot's first answer to the first turn: the camera is opened, the empty table's pictures are
/// read.
const START_WITHIN: std::time::Duration = std::time::Duration::from_secs(120);

/// What is said between the robot's first answer and the first turn.
const OPENING: &str = "the robot answers; the camera is opened and the table's pictures are read";

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

/// Runs the daemon until Ctrl-C or SIGTERM; returns the exit code.
pub fn run(args: &RunArgs, stop: Arc<AtomicBool>) -> u8 {
    cell_edge::log::log_panics();
    cell_edge::memory::keep_large_blocks_apart();
    cell_edge::reserve::raise_limit();
    if !cell_edge::reserve::fill() {
        tracing::warn!("the system allows this process hardly any open files");
    }
    let read = start_with(&args.config, &args.state).and_then(|(config, shared)| {
        let calibration = read_calibration(&config)?;
        refuse_recorded_camera(&config)?;
        cell_objects(&config).map_err(|error| error.to_string())?;
        Ok((config, shared, calibration))
    });
    let (mut config, shared, calibration) = match read {
        Ok(read) => read,
        Err(message) => {
            complain(&message);
            return 2;
        }
    };
    let state = StateFolder::new(&args.state);
    let seed = seed();
    let lock = match state.take(&first_status(seed)) {
        Ok(lock) => lock,
        Err(error) => {
            complain(&chain(&error));
            return 1;
        }
    };
    // With the lock held: one who is turned away by it does not take the mark from who is not.
    config.arm_at_start &= !is_to_start_disarmed(&args.state);
    let begin = Begin { config, config_file: args.config.clone(), shared, calibration, state, seed };
    let (restart, state, simulated) =
        (Anew::default(), begin.state.clone(), begin.config.simulation.is_some());
    // Once a person has ended celld it must not start again.
    let after_signal = restart.clone();
    interrupt::at_end(move || after_signal.never());
    let code = with_runtime(stop, |stop| daemon(begin, restart.clone(), stop));
    let next = restart.next(code, || take_shared(&state));
    drop(lock);
    next.carry_out(simulated)
}

/// What the daemon begins with.
struct Begin {
    config: CellConfig,
    config_file: PathBuf,
    shared: Shared,
    calibration: CalibrationSet,
    state: StateFolder,
    seed: u64,
}

/// Another one in every run: the name of the run, and what chance starts from.
fn seed() -> u64 {
    (unix_now_s() * 1e3) as u64
}

fn name_of(seed: u64) -> String {
    format!("celld-{seed}")
}

/// What commands read before the records are open.
fn first_status(seed: u64) -> Status {
    let now = unix_now_s();
    Status::starting(name_of(seed), now, now, "opening the records of the state folder".to_string())
}

/// Old pictures must not move a real arm.
fn refuse_recorded_camera(config: &CellConfig) -> Result<(), String> {
    if config.devices.camera.is_recording() && config.simulation.is_none() {
        return Err(
            "devices.camera: a folder or recording shows an old table, no arm may act on it; name a live \
             camera, or try the pictures with `celld detect`"
                .to_string(),
        );
    }
    Ok(())
}

/// For a last complaint: a terminal that takes nothing keeps no process from ending.
const COMPLAIN_WITHIN: std::time::Duration = std::time::Duration::from_secs(1);

/// Runs a future with Ctrl-C, SIGTERM and SIGHUP raising `stop`; an error is one sentence and exit 1, or 130
/// when it was stopped.
pub(super) fn with_runtime<F>(stop: Arc<AtomicBool>, work: impl FnOnce(Arc<AtomicBool>) -> F) -> u8
where
    F: Future<Output = Result<(), String>>,
{
    priority::raise();
    interrupt::watch_every(&stop);
    // One thread: nothing that the loop waits for has to be woken first.
    let runtime = match tokio::runtime::Builder::new_current_thread().enable_all().build() {
        Ok(runtime) => runtime,
        Err(error) => {
            complain(&error.to_string());
            return 1;
        }
    };
    match runtime.block_on(work(stop.clone())) {
        Ok(()) => 0,
        Err(message) => {
            complain_within(&message, COMPLAIN_WITHIN);
            if stop.load(Ordering::Relaxed) { 130 } else { 1 }
        }
    }
}

/// The machine and its sockets, for the devices that the configuration names. `seed` differs from run to
/// run.
pub(super) fn open_shell(config: &CellConfig, seed: u64) -> Result<Shell, String> {
    let addresses = Addresses::of(&config.devices)?;
    let clock = clock(config.simulation, addresses.rtde);
    let mut parameters = machine_parameters(config, seed);
    parameters.robot.process = std::process::id();
    Shell::open(&addresses, clock, parameters).map_err(|error| chain(&error))
}

pub(super) fn open_camera(config: &CellConfig, lens: Option<CameraModel>) -> Result<MonitoredCamera, String> {
    cameras::open_camera(&config.devices, lens).map_err(|error| chain(&error))
}

/// Says what is waited for, where everyone looks: status file, log, service manager.
fn waits_for(keeper: &StateKeeper, watchdog: &Watchdog, message: &str) {
    keeper.waits_for(message);
    watchdog.words(message);
}

/// The shell once all devices' names have addresses: a network may come up after this computer.
async fn shell_when_named(
    config: &CellConfig,
    seed: u64,
    stop: &AtomicBool,
    say: &mut dyn FnMut(&str),
) -> Result<Shell, String> {
    let mut said = String::new();
    loop {
        match open_shell(config, seed) {
            Ok(shell) => return Ok(shell),
            Err(_) if stop.load(Ordering::Relaxed) => return Err(StartError::Stopped.to_string()),
            Err(fault) if fault != said => {
                say(&fault);
                said = fault;
            }
            Err(_) => {}
        }
        tokio::time::sleep(NAMES_AGAIN).await;
    }
}

async fn daemon(begin: Begin, anew: Anew, stop: Arc<AtomicBool>) -> Result<(), String> {
    let (beats, stopped) = (Beats::default(), || stop.load(Ordering::Relaxed));
    let watchdog = Watchdog::start(beats.clone());
    let Opened { mut keeper, orders, feed, film } = opened(&begin, name_of(begin.seed), &anew, &stop)?;
    let Begin { config, config_file, calibration, state, seed, .. } = begin;
    let diagnostic_images = state.root().to_path_buf();
    let confirmed = state.confirmed_gripper(&gripper_address(&config.devices));
    let reception = Reception::open(orders);
    for notice in keeper.notices() {
        tracing::warn!("{notice}");
    }
    let waiting = format!("waiting for the robot at {}", config.devices.robot_host);
    waits_for(&keeper, &watchdog, &waiting);
    watchdog.ready();
    let mut say = |missing: &str| {
        let message = format!("{waiting}: {missing}");
        waits_for(&keeper, &watchdog, &message);
        tracing::warn!("{message}");
    };
    let mut shell = shell_when_named(&config, seed, &stop, &mut say).await?.watched(beats.clone());
    let starting = beats.task("the start", START_WITHIN);
    let arm = shell.wait_for_robot(&stopped, &mut say).await.map_err(|error| chain(&error))?;
    waits_for(&keeper, &watchdog, OPENING);
    starting.now();
    let measured = measured(&config, &calibration, &arm)?;
    let mut model = cell_model(&config, &measured).map_err(|error| error.to_string())?;
    if model.confirmed == ConfirmedGripper::None {
        model.confirmed = confirmed;
    }
    (model.held_before, model.cut_off) = (keeper.held_before(), keeper.cut_off());
    model.plans_before = keeper.plans_before();
    warn_of(&config, &model, &arm);
    let setup = perception_setup(&config, &measured, &arm, diagnostic_images)?;
    // Who watches would use up a recording.
    let watched = film.clone().filter(|_| !config.devices.camera.is_recording());
    shell.see_with(PerceptionSetup { film: watched, ..setup });
    let (pictures, lens) = (LastPicture::new(Some(measured.camera.clone())), measured.camera.clone());
    feed.known(known_cell(&model, &calibration, &arm, &pictures));
    shell.commission(model, config.arm_at_start);
    let keeper =
        keeper.with(pictures.clone(), &config_file, identities(&arm, &measured), shell.last_answers());
    shell.keep_in(Box::new(keeper), reception.close()?);
    tracing::info!("celld runs; job files go into the state folder's jobs/incoming, Ctrl-C ends");
    starting.rests();
    let recorder = config.recording.as_ref().map(|to| recorder::start(to, Some(lens))).transpose()?;
    let mut lines = Lines { recorder, pictures, watchdog, feed: feed.observer().with_film(film.clone()) };
    let ends = |quiet| stop.load(Ordering::Relaxed) || anew.begins(quiet);
    // The threads that are started from here on are planners, which leave real time.
    go_first(&config);
    let ended = shell.run(&mut lines, &ends).await.map_err(|error| error.to_string());
    // A restart must not inherit it.
    priority::ordinary();
    lines.watchdog.stopping();
    if let Some(fault) = lines.recorder.as_mut().and_then(Recorder::close) {
        tracing::warn!("recording: {fault}");
    }
    ended
}

/// What an operator should know before anything moves.
fn warn_of(config: &CellConfig, model: &CellModel, arm: &Arm) {
    if let Some(why) = why_no_blends(config, &model.arm, arm) {
        tracing::warn!("{why}");
    }
    for pose in blocked_poses(config, model) {
        tracing::warn!("taught pose {pose}; the arm will not go there");
    }
}

/// Lets the loop go first; simulated time that runs faster than real time would leave it no rest.
fn go_first(config: &CellConfig) {
    if config.simulation.is_none_or(|simulated| simulated.clock_factor <= 1.0) {
        priority::real_time();
    }
}

/// What the page shows of the cell.
fn known_cell(
    model: &CellModel,
    calibration: &CalibrationSet,
    arm: &Arm,
    pictures: &LastPicture,
) -> KnownCell {
    let (model, lens) = (model.clone(), calibration.camera.clone());
    KnownCell { model, lens, arm: arm.clone(), pictures: pictures.clone() }
}

/// The state folder in use, and what the page shows; without `page:` nothing is served, and the rest is the
/// same.
struct Opened {
    keeper: StateKeeper,
    orders: Sources,
    feed: Feed,
    /// Where a page is served.
    film: Option<Film>,
}

fn opened(begin: &Begin, name: String, anew: &Anew, stop: &Arc<AtomicBool>) -> Result<Opened, String> {
    let Begin { config, config_file, shared, state, .. } = begin;
    let memory = GripperMemory::new(state, gripper_address(&config.devices));
    let inbox = Inbox::open(&state.commands(), name.clone()).map_err(|error| chain(&error))?;
    let ((order_sender, at_page), feed, remarks) =
        (order_channel(memory.clone()), Feed::default(), Remarks::default());
    let reported = fleet(Parts {
        config,
        config_file,
        shared: shared.clone(),
        state,
        feed: &feed,
        order_sender: &order_sender,
        remarks: &remarks,
        anew: anew.clone(),
        stop: stop.clone(),
    })?;
    let (mut sign_ins, mut film) = (None, None);
    if let Some(page) = &config.page {
        let config_name = config_file.file_stem().map(|stem| stem.to_string_lossy().into_owned());
        let (config_name, state) = (config_name.unwrap_or_default(), state.clone());
        let (shown, pictures) = Film::new();
        let texts = Texts::read(&page.texts);
        let texts = texts.map_err(|(file, reason)| ServeError::Texts { file, reason }.to_string())?;
        let setup = Setup {
            page,
            cell: config,
            config_name,
            state,
            feed: feed.clone(),
            order_sender,
            film: shown.clone(),
            pictures,
            texts,
        };
        sign_ins = Some(app::start(setup).map_err(|error| chain(&error))?);
        film = Some(shown);
    }
    let published = feed.clone();
    let keeper = StateKeeper::open(config.clone(), state.clone(), name).map_err(|error| chain(&error))?;
    let publish = move |status: &Status| {
        published.status(status);
        reported(status);
    };
    let keeper = keeper.published(Box::new(publish), remarks).sharing(shared.name());
    let orders = sources(StateOrders::of(inbox, memory, sign_ins), at_page);
    Ok(Opened { keeper, orders, feed, film })
}

/// Those of the folder and the page's.
fn sources((in_folder, unwatched): (Vec<StateOrders>, Option<FileError>), at_page: impl Orders) -> Sources {
    if let Some(error) = unwatched {
        let error = chain(&error);
        tracing::warn!(
            error,
            "the kernel does not report new command files, so orders may be late: raise \
             fs.inotify.max_user_instances and restart celld"
        );
    }
    let mut orders: Vec<Box<dyn Orders>> = vec![Box::new(at_page)];
    orders.extend(in_folder.into_iter().map(|source| Box::new(source) as Box<dyn Orders>));
    Sources::of(orders)
}

fn identities(arm: &Arm, measured: &Measured) -> Identities {
    Identities {
        robot: format!("serial {}", arm.serial),
        camera: format!("serial {}", measured.camera.serial),
    }
}

/// Camera and perception; a camera that is away is said, and waited for.
fn perception_setup(
    config: &CellConfig,
    measured: &Measured,
    arm: &Arm,
    diagnostic_images: PathBuf,
) -> Result<PerceptionSetup, String> {
    let camera = cameras::open_when_there(&config.devices, &measured.camera);
    let (camera, away) = camera.map_err(|error| chain(&error))?;
    if let Some(error) = away {
        tracing::warn!("{}; looks wait for it ({})", chain(&error), error.kind().hint());
    }
    let mut scene = scene(config, measured).map_err(|error| chain(&error))?;
    compare_with_empty(scene.foreign.as_mut(), config, measured, arm)?;
    let perception = Perception::new(scene, DetectSettings::default()).map_err(|error| chain(&error))?;
    let sight = Sight::Cell(Box::new(perception));
    Ok(PerceptionSetup {
        camera: Box::new(camera),
        sight,
        diagnostic_images: Some(diagnostic_images),
        film: None,
    })
}

/// The recording, the last picture, the line for the service manager; sentences go into the log
/// (`daemon/shell`).
struct Lines {
    recorder: Option<Recorder>,
    pictures: LastPicture,
    watchdog: Watchdog,
    feed: Watcher,
}

impl Observer for Lines {
    fn on(&mut self, now: Timestamp, scene: Scene) {
        if let Scene::Displayed(displayed) = &scene {
            self.pictures.keep(displayed);
        }
        if let Scene::Status(status) = &scene {
            let armed = if status.armed { "armed" } else { "disarmed" };
            let job = status.job.as_ref().map(|job| format!(", job {job}")).unwrap_or_default();
            self.watchdog.words(&format!("{}{job} ({armed})", status.text()));
        }
        if let Some(recorder) = &mut self.recorder {
            recorder.on(now, &scene);
        }
        self.feed.on(now, scene);
    }
}
