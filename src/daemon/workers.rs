//! Slow work on threads of its own: frames and markers, planning.
//!
//! In: requests with numbers. Out: events with the same numbers, and pictures to be shown or recorded;
//! between two requests pictures for those who watch the film.
//! Workers run at a lower priority than the loop that keeps the robot's heartbeat, and planning has a
//! stop flag that the loop raises.

use crate::daemon::cameras::fault_of;
use crate::daemon::film::{self, Film};
use crate::daemon::messages::{Displayed, Message};
use crate::daemon::watchdog::Beat;
use crate::io::camera::{CameraSource, Frame};
use crate::perception::diagnostic_images::{self, SHOTS_MAX, Shot};
use crate::perception::{Perception, PerceptionError, Picture};
use cell_calibration::fit::Sample;
use cell_edge::clock::Clock;
use cell_edge::files;
use cell_edge::panics::guarded;
use cell_edge::priority;
use cell_machine::code::Code;
use cell_machine::event::Event;
use cell_machine::planner::answer;
use cell_machine::supervisor::input::{CameraFault, PlanAnswer, PlanRequest};
use cell_values::time::Timestamp;
use cell_vision::detect::Detector;
use cell_vision::foreign::HeldBody;
use cell_vision::observe::{Observation, PartialLook, View};
use nalgebra::Isometry3;
use rearrange::document::chain::chain;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, SyncSender, sync_channel};
use std::time::{Duration, Instant};
use tokio::sync::mpsc;

/// Stack of the planner's thread: a search of a thousand objects goes as many calls deep. What is not used
/// costs nothing.
const PLANNER_STACK_BYTES: usize = 16 << 20;

/// What is requested of perception.
pub enum SeeRequest {
    /// Take this many frames with the camera there.
    Look {
        /// Number of frames.
        frames: usize,
        /// Camera pose.
        table_from_camera: Isometry3<f64>,
    },
    /// Put these views together.
    Observe {
        /// All of a look.
        views: Vec<View>,
        /// What it had to show; `None`: the whole table.
        partial: Option<PartialLook>,
        /// What hangs on the gripper and is meant to.
        held: Option<HeldBody>,
    },
    /// One picture of a calibration round.
    Picture {
        /// The pose, from 1.
        pose: usize,
        /// Where the flange is.
        base_from_flange: Isometry3<f64>,
    },
}

/// Camera and perception, on the way to their thread.
pub struct PerceptionSetup {
    /// Where frames come from.
    pub camera: Box<dyn CameraSource + Send>,
    /// What is seen in them.
    pub sight: Sight,
    /// Folder for pictures of looks that are doubted.
    pub diagnostic_images: Option<PathBuf>,
    /// Who watches besides.
    pub film: Option<Film>,
}

/// What is made of frames.
pub enum Sight {
    /// Views and observations.
    Cell(Box<Perception>),
    /// Markers only: a calibration round.
    Markers(Box<Detector>),
}

/// Starts the thread that owns the camera.
pub fn spawn_perception(
    setup: PerceptionSetup,
    clock: Clock,
    messages: mpsc::Sender<Message>,
    beat: Beat,
) -> SyncSender<(u64, SeeRequest)> {
    let (requests_in, requests) = sync_channel(4);
    std::thread::spawn(move || {
        give_way(&clock);
        let mut seeing = Seeing { setup, clock, messages, shots: Vec::new() };
        let mut next_glimpse = Instant::now();
        loop {
            match requests.recv_timeout(next_glimpse.saturating_duration_since(Instant::now())) {
                Ok((number, request)) => {
                    beat.now();
                    let event = seeing.answer(number, request);
                    beat.rests();
                    if seeing.messages.blocking_send(Message::Event(event)).is_err() {
                        return;
                    }
                }
                Err(RecvTimeoutError::Timeout) => {
                    beat.now();
                    next_glimpse = seeing.glimpse(next_glimpse);
                    beat.rests();
                }
                Err(RecvTimeoutError::Disconnected) => return,
            }
        }
    });
    requests_in
}

/// A camera that gave viewers no picture is left alone for so long.
const GLIMPSE_AGAIN: Duration = Duration::from_secs(2);

/// What a request that finds the thread busy comes to.
pub fn busy(number: u64, request: &SeeRequest) -> Event {
    let fault = || CameraFault {
        code: Code::CameraBusy,
        message: "the camera thread still works on an earlier request".to_string(),
        hint: "see what the camera says in the log".into(),
        lasting: false,
    };
    match request {
        SeeRequest::Look { .. } => Event::Looked(number, Err(fault())),
        SeeRequest::Observe { .. } => {
            Event::Observed(number, Err("the camera thread does not answer".into()))
        }
        SeeRequest::Picture { .. } => Event::Pictured(number, Err(fault())),
    }
}

struct Seeing {
    setup: PerceptionSetup,
    clock: Clock,
    messages: mpsc::Sender<Message>,
    shots: Vec<Shot>,
}

impl Seeing {
    fn answer(&mut self, number: u64, request: SeeRequest) -> Event {
        match request {
            SeeRequest::Look { frames, table_from_camera } => {
                let looked = self.look(number, frames, table_from_camera);
                if looked.is_err() {
                    // The look may end here; the next one's pictures are other ones.
                    self.shots.clear();
                }
                Event::Looked(number, looked)
            }
            SeeRequest::Observe { views, partial, held } => {
                let seen = self.observe(&views, partial.as_ref(), held.as_ref());
                Event::Observed(number, seen.map(Box::new))
            }
            SeeRequest::Picture { pose, base_from_flange } => {
                Event::Pictured(number, self.picture(pose, base_from_flange))
            }
        }
    }

    fn show(&self, displayed: Displayed) {
        // The loop has ended if there is no receiver.
        let _ = self.messages.blocking_send(Message::Displayed(displayed));
    }

    /// A picture for viewers, if there are any; when the next one is due, given when this one was.
    fn glimpse(&mut self, due: Instant) -> Instant {
        let now = Instant::now();
        let Some(film) = self.setup.film.as_ref().filter(|film| film.wants_a_picture()) else {
            return now + film::EVERY;
        };
        self.setup.camera.want_depth(false);
        match self.setup.camera.glimpse() {
            Ok(frame) => film.picture(frame.image),
            Err(error) => {
                tracing::debug!("no picture for viewers: {}", chain(&error));
                return Instant::now() + GLIMPSE_AGAIN;
            }
        }
        // In step, and none made up for.
        (due + film::EVERY).max(now)
    }

    fn look(
        &mut self,
        number: u64,
        frames: usize,
        table_from_camera: Isometry3<f64>,
    ) -> Result<Vec<View>, CameraFault> {
        let PerceptionSetup { camera, sight: Sight::Cell(perception), diagnostic_images, .. } =
            &mut self.setup
        else {
            return Err(no_perception());
        };
        let camera: &mut dyn CameraSource = &mut **camera;
        let taken = take(camera, perception.wants_depth(), frames, &self.clock)?;
        // The arm may go on while the pictures are searched; the loop has ended if there is no receiver.
        let _ = self.messages.blocking_send(Message::Event(Event::Exposed(number)));
        let (views, frame) = found_in(perception, taken, table_from_camera)?;
        if diagnostic_images.is_some() {
            diagnostic_images::keep(&mut self.shots, Shot { image: frame.image.clone(), table_from_camera });
        }
        self.show(Displayed::Picture { image: frame.image, views: views.clone() });
        Ok(views)
    }

    fn observe(
        &mut self,
        views: &[View],
        partial: Option<&PartialLook>,
        held: Option<&HeldBody>,
    ) -> Result<Observation, String> {
        let PerceptionSetup { sight: Sight::Cell(perception), diagnostic_images, .. } = &mut self.setup
        else {
            return Err(no_perception().message);
        };
        let seen = perception.observe_holding(views, partial, held).map_err(|error| chain(&error));
        // A look that was broken off has left pictures of its own.
        let of_it = |shot: &Shot| views.iter().any(|view| view.table_from_camera == shot.table_from_camera);
        self.shots.retain(of_it);
        if let Ok(seen) = &seen {
            if let Some(folder) = diagnostic_images {
                write_diagnostic_images(
                    diagnostic_images::pictures(perception.scene(), &self.shots, views, seen),
                    folder,
                );
            }
            self.show(Displayed::Observed { seen: Box::new(seen.clone()), partial: partial.is_some() });
        }
        self.shots.clear();
        seen
    }

    fn picture(&mut self, pose: usize, base_from_flange: Isometry3<f64>) -> Result<(), CameraFault> {
        let PerceptionSetup { camera, sight, .. } = &mut self.setup;
        camera.want_depth(false);
        let frame = camera.grab().map_err(|error| fault_of(&error))?;
        let found = match sight {
            Sight::Cell(perception) => perception.detect(&frame.image),
            Sight::Markers(detector) => {
                detector.detect(&frame.image.gray()).map_err(PerceptionError::Detector)
            }
        };
        let detections = found.map_err(|error| failed(&error))?;
        let sample = Sample { base_from_flange, detections };
        self.show(Displayed::Sample { pose, image: frame.image, sample });
        Ok(())
    }
}

/// Takes `frames` new frames, the last one with depth where that is wanted, each with its time.
///
/// # Errors
/// What the camera says.
fn take(
    camera: &mut dyn CameraSource,
    wants_depth: bool,
    frames: usize,
    clock: &Clock,
) -> Result<Vec<(Timestamp, Frame)>, CameraFault> {
    let one = |left: usize| {
        camera.want_depth(wants_depth && left == 0);
        let frame = camera.grab().map_err(|error| fault_of(&error))?;
        Ok((clock.now(), frame))
    };
    (0..frames).rev().map(one).collect()
}

/// Finds the markers in frames of one place and one moment; the last one with what depth or colour say.
///
/// # Errors
/// What the detector says, or that there is no frame.
fn found_in(
    perception: &mut Perception,
    frames: Vec<(Timestamp, Frame)>,
    table_from_camera: Isometry3<f64>,
) -> Result<(Vec<View>, Frame), CameraFault> {
    let mut views: Vec<View> = Vec::with_capacity(frames.len());
    let mut last = None;
    let count = frames.len();
    for (index, (time, frame)) in frames.into_iter().enumerate() {
        let picture = Picture { image: &frame.image, depth: frame.depth.as_ref() };
        // The first picture is searched whole; the others are of the same place and the same moment.
        let view = perception.view(picture, table_from_camera, time, views.last(), index + 1 == count);
        views.push(view.map_err(|error| failed(&error))?);
        last = Some(frame);
    }
    let frame = last.ok_or_else(|| failed(&PerceptionError::Observe("no frame was asked for".into())))?;
    Ok((views, frame))
}

fn no_perception() -> CameraFault {
    failed(&PerceptionError::Observe("the cell has not been commissioned for looks".into()))
}

fn failed(error: &PerceptionError) -> CameraFault {
    let (code, hint) = match error {
        PerceptionError::Depth(_) => (Code::CameraMisfit, crate::io::camera::FaultKind::Misfit.hint()),
        PerceptionError::Detector(_) | PerceptionError::Observe(_) => {
            (Code::DetectionFailed, "start the daemon again; if it stays so, this is a fault of celld")
        }
    };
    CameraFault { code, message: chain(error), hint: hint.into(), lasting: true }
}

/// Keeps the pictures of a doubted look, and none of an earlier one; what cannot be written is logged, for a
/// picture is no reason to stop.
fn write_diagnostic_images(pictures: Result<Vec<Vec<u8>>, String>, folder: &Path) {
    let path = |number: usize| folder.join(format!("doubt-{number}.png"));
    for number in 1..=SHOTS_MAX {
        // Most often there is none.
        let _ = std::fs::remove_file(path(number));
    }
    let pictures = pictures.unwrap_or_else(|error| {
        tracing::warn!(error, "what is doubted could not be drawn");
        Vec::new()
    });
    for (number, bytes) in (1..).zip(pictures) {
        match files::write_atomic(&path(number), &bytes) {
            Ok(()) => tracing::warn!("what is doubted is drawn in {}", path(number).display()),
            Err(error) => tracing::warn!("{}: {error}", path(number).display()),
        }
    }
}

/// Lets the loop go first. A simulated robot waits for it anyway; there this thread only goes behind it, for
/// beside other programs it would get next to nothing, and simulated time does not wait for pictures.
fn give_way(clock: &Clock) {
    if clock.is_simulated() {
        priority::ordinary();
    } else {
        priority::lower();
    }
}

/// Starts one planning run; `stop` ends it early with the best plan so far.
pub fn spawn_plan(
    number: u64,
    request: PlanRequest,
    clock: &Clock,
    stop: Arc<AtomicBool>,
    messages: mpsc::Sender<Message>,
    beat: Beat,
) {
    // Planning is work of this computer, so its budget is real time even when the cell's time is scaled; but
    // what is searched for while the arm moves has to be there before it rests.
    let meanwhile = !request.known_plan.is_empty();
    let limit = if meanwhile { clock.wall(request.time_limit) } else { request.time_limit };
    let plan = move || {
        let started = Instant::now();
        // A plan that the arm cannot carry out is followed by another one, with a budget of its own.
        let over = |attempt: u32| stop.load(Ordering::Relaxed) || started.elapsed() >= limit * (attempt + 1);
        answer(&request, None, &over, &|| started.elapsed().as_secs_f64())
    };
    spawn_planner(number, plan, clock, messages, beat);
}

/// Runs `plan` on a thread of its own. There is always an answer: a panic, or a thread that cannot be had,
/// is one.
fn spawn_planner(
    number: u64,
    plan: impl FnOnce() -> PlanAnswer + Send + 'static,
    clock: &Clock,
    messages: mpsc::Sender<Message>,
    beat: Beat,
) {
    let answered = move |answer| Message::Event(Event::Planned(number, Box::new(answer)));
    let (replies, clock) = (messages.clone(), clock.clone());
    let work = move || {
        beat.now();
        give_way(&clock);
        let answer = guarded(plan).unwrap_or_else(PlanAnswer::Failed);
        beat.rests();
        // The loop has ended if there is no receiver.
        let _ = replies.blocking_send(answered(answer));
    };
    let planner = std::thread::Builder::new().name("planner".to_string()).stack_size(PLANNER_STACK_BYTES);
    if let Err(error) = planner.spawn(work) {
        let answer = PlanAnswer::Failed(format!("no thread can be started for it: {error}"));
        // The channel is far longer than what the loop leaves in it.
        let _ = messages.try_send(answered(answer));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::daemon::watchdog::Beats;
    use crate::io::camera::CameraError;
    use crate::perception::Scene;
    use cell_values::image::Image;
    use cell_values::image::depth::DepthImage;
    use cell_vision::camera::CameraModel;
    use cell_vision::detect::DetectSettings;
    use cell_vision::foreign::search::ForeignSearch;
    use cell_vision::foreign::search::Inventory;
    use cell_vision::foreign::{Area, ForeignLimits};
    use cell_vision::observe::ObserveLimits;
    use cell_vision::observe::reference::DriftLimits;

    /// A camera whose depth pictures have a size of their own.
    struct Camera {
        depth: (u32, u32),
        wanted: bool,
        taken: u64,
    }

    impl CameraSource for Camera {
        fn intrinsics(&mut self) -> Result<CameraModel, CameraError> {
            Err(CameraError::NoIntrinsics { place: "made up".into() })
        }

        fn grab(&mut self) -> Result<Frame, CameraError> {
            self.taken += 1;
            let (width, height) = self.depth;
            let metres = vec![0.5; width as usize * height as usize];
            Ok(Frame {
                image: Image::filled(64, 48, [180; 3]),
                sequence: self.taken,
                time_s: self.taken as f64,
                source: "made up".into(),
                depth: self.wanted.then(|| DepthImage::from_metres(width, height, metres).unwrap()),
            })
        }

        fn want_depth(&mut self, wanted: bool) {
            self.wanted = wanted;
        }

        fn is_live(&self) -> bool {
            true
        }

        fn reopen(&mut self) -> Result<(), CameraError> {
            Ok(())
        }
    }

    /// Two frames of a camera with such depth pictures, for a lens of 64 x 48.
    fn looked(depth: (u32, u32)) -> Result<(Vec<View>, Frame), CameraFault> {
        let lens = CameraModel {
            serial: "made up".into(),
            width: 64,
            height: 48,
            fx: 60.0,
            fy: 60.0,
            cx: 31.5,
            cy: 23.5,
            distortion: [0.0; 5],
        };
        let inventory = Inventory {
            area: Area { low: [0.0, 0.0], high: [0.2, 0.2] },
            objects: Vec::new(),
            fixed: Vec::new(),
            ignored: Vec::new(),
            own: None,
        };
        let search = ForeignSearch::new(&lens, inventory, ForeignLimits::default()).unwrap();
        let drift = DriftLimits { residual_m: 1e-3, shift_m: 1e-3, turn_rad: 1e-3 };
        let limits = ObserveLimits::default();
        let (objects, reference) = (Vec::new(), Vec::new());
        let scene = Scene { camera: lens, objects, reference, limits, foreign: Some(search), drift };
        let mut perception = Perception::new(scene, DetectSettings::default()).unwrap();
        let mut camera = Camera { depth, wanted: true, taken: 0 };
        let down = nalgebra::UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.0, 0.0);
        let over = Isometry3::from_parts(nalgebra::Translation3::new(0.1, 0.1, 0.5), down);
        let wants_depth = perception.wants_depth();
        found_in(&mut perception, take(&mut camera, wants_depth, 2, &Clock::new(1.0))?, over)
    }

    /// What the loop gets from a planner, and the beats of that planner.
    fn planned(plan: impl FnOnce() -> PlanAnswer + Send + 'static) -> (PlanAnswer, Beats) {
        let (messages, mut received) = mpsc::channel(4);
        let beats = Beats::default();
        spawn_planner(
            7,
            plan,
            &Clock::new(1.0),
            messages,
            beats.task("the planner", Duration::from_secs(60)),
        );
        match received.blocking_recv() {
            Some(Message::Event(Event::Planned(7, answer))) => (*answer, beats),
            _ => panic!("no answer of the planner"),
        }
    }

    #[test]
    fn a_panic_of_a_planner_is_an_answer_with_its_words_and_no_dead_task() {
        let (answer, beats) = planned(|| panic!("index 256 of 256"));
        assert!(matches!(&answer, PlanAnswer::Failed(cause) if cause == "index 256 of 256"), "{answer:?}");
        assert_eq!(beats.late(Instant::now()), []);
        let (answer, _) = planned(|| PlanAnswer::Timeout);
        assert!(matches!(answer, PlanAnswer::Timeout), "the next one plans as ever");
    }

    /// A thread pool hands a panic of one of its threads on to whoever uses it.
    #[test]
    fn a_panic_in_a_thread_pool_of_a_planner_is_an_answer_too() {
        let (answer, _) = planned(|| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().expect("a pool");
            pool.install(|| rayon::join(|| PlanAnswer::Timeout, || panic!("in the pool")).0)
        });
        assert!(matches!(&answer, PlanAnswer::Failed(cause) if cause == "in the pool"), "{answer:?}");
    }

    #[test]
    fn depth_of_another_size_than_the_lens_is_a_misfit_and_lasts() {
        let (views, _) = looked((64, 48)).unwrap();
        let mapped: Vec<bool> = views.iter().map(|view| view.heights.is_some()).collect();
        assert_eq!(mapped, [false, true], "the last frame comes with depth");
        let reported = looked((32, 24)).unwrap_err();
        assert_eq!((reported.code, reported.lasting), (Code::CameraMisfit, true));
        assert!(reported.message.contains("32 x 24") && reported.message.contains("64 x 48"), "{reported:?}");
        assert!(reported.hint.contains("devices.camera"), "{reported:?}");
    }
}
