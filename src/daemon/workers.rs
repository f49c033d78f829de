//! Slow work on threads of its own: frames and markers, planning.
//!
//! In: requests. Out: one [`Answer`] each over a bounded channel. Workers run at a lower priority than the
//! loop that keeps the robot's heartbeat, and planning has a stop flag that the loop may raise.

use crate::daemon::cameras::trouble_of;
use crate::daemon::doubts::{self, Shot};
use crate::io::camera::{CameraSource, FaultKind};
use crate::io::clock::Clock;
use crate::io::priority;
use crate::planning::plan::{Action, Status};
use crate::planning::problem::Problem;
use crate::planning::solver::{Control, solve};
use crate::supervisor::input::{CameraTrouble, PlanAnswer, PlanRequest};
use crate::vision::camera::CameraModel;
use crate::vision::detect::Detector;
use crate::vision::foreign::HeightMapError;
use crate::vision::foreign::search::ForeignSearch;
use crate::vision::image::Image;
use crate::vision::observe::reference::DriftLimits;
use crate::vision::observe::{MarkedObject, Observation, ObserveLimits, ReferenceMarker, View, observe};
use nalgebra::Isometry3;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;
use tokio::sync::mpsc;

/// An answer with the number of the request that it is for.
pub type Numbered = (u64, Answer);

/// What the workers answer.
#[derive(Debug)]
pub enum Answer {
    /// Frames of one look pose with the markers found, and the last picture.
    Captured(Result<(Vec<View>, Image), CameraTrouble>),
    /// A look put together.
    Observed(Result<Box<Observation>, String>),
    /// A plan, or why not.
    Planned(Box<PlanAnswer>),
}

/// What the eye is asked for.
pub enum EyeRequest {
    /// Take this many frames with the camera there.
    Capture {
        /// Number of frames.
        frames: usize,
        /// Camera pose.
        table_from_camera: Isometry3<f64>,
    },
    /// Put these views together.
    Observe(Vec<View>),
}

/// What the eye has to know.
pub struct EyeParameters {
    /// Calibrated camera.
    pub camera: CameraModel,
    /// Markers to look for.
    pub objects: Vec<MarkedObject>,
    /// Reference markers round the table.
    pub reference: Vec<ReferenceMarker>,
    /// Limits of plausibility.
    pub limits: ObserveLimits,
    /// The search for what carries no marker; `None` when it is switched off.
    pub foreign: Option<ForeignSearch>,
    /// From where on the camera counts as moved: such looks are drawn.
    pub drift: DriftLimits,
    /// Folder for pictures of looks that are doubted.
    pub doubts: Option<PathBuf>,
}

/// Starts the thread that owns the camera and the detector.
pub fn spawn_eye(
    mut source: Box<dyn CameraSource + Send>,
    mut detector: Detector,
    parameters: EyeParameters,
    clock: Clock,
    answers: mpsc::Sender<Numbered>,
) -> mpsc::Sender<(u64, EyeRequest)> {
    let (requests_in, mut requests) = mpsc::channel(4);
    std::thread::spawn(move || {
        priority::lower();
        let mut shots = Vec::new();
        while let Some((number, request)) = requests.blocking_recv() {
            let answer = match request {
                EyeRequest::Capture { frames, table_from_camera } => {
                    let search = parameters.foreign.as_ref();
                    let eye = (&mut *source as &mut dyn CameraSource, &mut detector);
                    let taken = capture(eye, frames, table_from_camera, &clock, search);
                    if taken.is_err() {
                        // The look may end here; the next one's pictures are other ones.
                        shots.clear();
                    }
                    if let (Ok((_, image)), Some(_)) = (&taken, &parameters.doubts) {
                        doubts::keep(&mut shots, Shot { image: image.clone(), table_from_camera });
                    }
                    Answer::Captured(taken)
                }
                EyeRequest::Observe(views) => {
                    let seen = put_together(&parameters, &views);
                    // A look that was broken off has left pictures of its own.
                    let of_it = |shot: &Shot| {
                        views.iter().any(|view| view.table_from_camera == shot.table_from_camera)
                    };
                    shots.retain(of_it);
                    if let (Ok(seen), Some(folder)) = (&seen, &parameters.doubts) {
                        doubts::write(&parameters, &shots, &views, seen, folder);
                    }
                    shots.clear();
                    Answer::Observed(seen)
                }
            };
            if answers.blocking_send((number, answer)).is_err() {
                return;
            }
        }
    });
    requests_in
}

fn put_together(parameters: &EyeParameters, views: &[View]) -> Result<Box<Observation>, String> {
    let EyeParameters { camera, objects, reference, limits, foreign, .. } = parameters;
    let mut seen = observe(objects, reference, camera, views, limits).map_err(|error| error.to_string())?;
    seen.foreign = foreign.as_ref().and_then(|search| search.report(views, &seen));
    Ok(Box::new(seen))
}

/// Takes `frames` new frames and finds the markers in each; the last one comes with depth if there is a search for it.
///
/// # Errors
/// The camera's own words, or that no frame was asked for.
fn capture(
    (source, detector): (&mut dyn CameraSource, &mut Detector),
    frames: usize,
    table_from_camera: Isometry3<f64>,
    clock: &Clock,
    search: Option<&ForeignSearch>,
) -> Result<(Vec<View>, Image), CameraTrouble> {
    let failed = |message: String| CameraTrouble {
        code: "detection_failed",
        message,
        remedy: "start the daemon again; if it stays so, this is a fault of celld",
        lasting: true,
    };
    let misfit = |error: &HeightMapError| CameraTrouble {
        code: FaultKind::Misfit.code(),
        message: error.to_string(),
        remedy: FaultKind::Misfit.remedy(),
        lasting: true,
    };
    let mut views = Vec::with_capacity(frames);
    let mut last = None;
    for left in (0..frames).rev() {
        source.want_depth(search.is_some() && left == 0);
        let frame = source.grab().map_err(|error| trouble_of(&error))?;
        let grey = frame.image.gray();
        // The first picture is searched whole; the others are of the same place and the same moment.
        let found = match views.last() {
            Some(View { detections, .. }) => detector.detect_again(&grey, detections),
            None => detector.detect(&grey),
        };
        let detections = found.map_err(|error| failed(error.to_string()))?;
        let heights = match (search, &frame.depth) {
            (Some(search), Some(depth)) => {
                let map = search.map(depth, &table_from_camera).map_err(|error| misfit(&error))?;
                Some(Arc::new(map))
            }
            (Some(search), None) if left == 0 => {
                search.changed(&frame.image, &table_from_camera).map(Arc::new)
            }
            _ => None,
        };
        views.push(View { table_from_camera, detections, time: clock.now(), heights });
        last = Some(frame.image);
    }
    last.map(|image| (views, image)).ok_or_else(|| failed("no frame was asked for".to_string()))
}

/// Starts one planning run; `stop` ends it early with the best plan so far.
pub fn spawn_plan(number: u64, request: PlanRequest, stop: Arc<AtomicBool>, answers: mpsc::Sender<Numbered>) {
    std::thread::spawn(move || {
        priority::lower();
        let answer = plan(&request, &stop);
        let _ = answers.blocking_send((number, Answer::Planned(Box::new(answer))));
    });
}

fn plan(request: &PlanRequest, stop: &AtomicBool) -> PlanAnswer {
    let problem = match Problem::new(&request.instance) {
        Ok(problem) => problem,
        Err(error) => return PlanAnswer::Refused(error.to_string()),
    };
    // Planning is work of this computer, so its budget is real time even when the cell's time is scaled.
    let started = Instant::now();
    let over = || stop.load(Ordering::Relaxed) || started.elapsed() >= request.time_limit;
    let seconds = |actions: &[Action]| request.times.seconds(actions.iter().map(|a| (a.from, a.to)));
    let control = Control {
        seconds: Some(&seconds),
        least_move_seconds: request.times.least_move_seconds(),
        ..Control::until(&over)
    };
    let outcome = match solve(&problem, request.solver, request.objective, &control, request.seed) {
        Ok(outcome) => outcome,
        Err(error) => return PlanAnswer::Unsolvable(error.to_string()),
    };
    match (outcome.status, outcome.plan, outcome.cost) {
        (Status::Optimal | Status::Solved, Some(plan), Some(cost)) => PlanAnswer::Found {
            actions: plan.actions().to_vec(),
            cost,
            lower_bound: outcome.lower_bound,
            seconds: started.elapsed().as_secs_f64(),
        },
        (Status::Infeasible, ..) => {
            PlanAnswer::Infeasible(outcome.witness.map(|w| w.to_string()).unwrap_or_default())
        }
        _ => PlanAnswer::Timeout,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::camera::{CameraError, Frame};
    use crate::vision::detect::DetectSettings;
    use crate::vision::foreign::search::Inventory;
    use crate::vision::foreign::{Area, ForeignLimits};
    use crate::vision::image::DepthImage;

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
    fn looked(depth: (u32, u32)) -> Result<(Vec<View>, Image), CameraTrouble> {
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
        let mut detector = Detector::new(DetectSettings::default()).unwrap();
        let mut camera = Camera { depth, wanted: true, taken: 0 };
        let down = nalgebra::UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.0, 0.0);
        let over = Isometry3::from_parts(nalgebra::Translation3::new(0.1, 0.1, 0.5), down);
        capture((&mut camera, &mut detector), 2, over, &Clock::new(1.0), Some(&search))
    }

    #[test]
    fn depth_of_another_size_than_the_lens_is_a_misfit_and_lasts() {
        let (views, _) = looked((64, 48)).unwrap();
        let mapped: Vec<bool> = views.iter().map(|view| view.heights.is_some()).collect();
        assert_eq!(mapped, [false, true], "the last frame comes with depth");
        let told = looked((32, 24)).unwrap_err();
        assert_eq!((told.code, told.lasting), ("camera_misfit", true));
        assert!(told.message.contains("32 x 24") && told.message.contains("64 x 48"), "{told:?}");
        assert!(told.remedy.contains("devices.camera"), "{told:?}");
    }
}
