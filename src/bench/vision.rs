//! The vision benchmark: how often markers are found, how far off they are said to be and really are, how
//! long it takes.
//!
//! In: how many frames, a seed, detector settings. Out: [`Report`]. Frames are drawn by `vision-pictures`
//! from `scene`'s tables, five views a table; `perception` looks at them as in the cell. Accuracy is
//! reported with the lens's true numbers and with those that a calibration from board pictures found
//! (`calibrated`);
//! times are those of one frame on a core, beside a plain call of the C library on the same frame. Beside it
//! are the figures of drift (`drift`), of what carries no marker (`foreign`), of the camera's mount
//! (`hand_eye`), of poor pictures (`degraded`) and of pictures without markers (`empty`).

pub mod calibrated;
pub mod change;
pub mod clutter;
pub mod degraded;
pub mod drift;
pub mod empty;
pub mod foreign;
pub mod hand_eye;
pub mod scene;
pub mod tally;

use crate::bench::vision::scene::{DEGRADE, HEIGHT_M, HEIGHT_OFF_M, SIZE_M, Scene, TILT_RAD, whole};
use crate::bench::vision::tally::{Accuracy, Tally};
use crate::perception::{self, Perception};
use cell_values::image::GrayImage;
use cell_values::time::Timestamp;
use cell_vision::camera::CameraModel;
use cell_vision::detect::{DetectSettings, Detection, Detector};
use cell_vision::observe::planar::{self, Target};
use cell_vision::observe::sighting::sightings;
use cell_vision::observe::{MarkedObject, ObserveLimits, View, fuse};
use nalgebra::{Isometry3, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use rearrange::document::chain::chain;
use rearrange::geometry::pose::{Pose2, wrap_angle};
use serde::Serialize;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Instant;
use vision_pictures::render::{Lens, Sheet, render};

/// A detection this near a marker's true centre is that marker, pixels.
const SAME_PX: f64 = 4.0;
/// Its number was read from a marker this near, pixels: half of a marker's edge.
const NEAR_PX: f64 = 20.0;
/// Frames that are timed, and how often each.
const TIMED: usize = 12;
const TIMES: usize = 5;

/// Marker numbers with the true corners in the picture, pixels.
pub type KnownCorners = Vec<(u32, [[f64; 2]; 4])>;

/// What to run.
#[derive(Clone, Copy, Debug)]
pub struct Task {
    /// Frames, rounded up to whole scenes.
    pub frames: usize,
    /// Seed of everything.
    pub seed: u64,
    /// The detector's settings; its threads are set by the benchmark.
    pub settings: DetectSettings,
    /// Scenes at the same time.
    pub threads: usize,
    /// Also with intrinsics and mount found by calibration.
    pub calibrated: bool,
}

/// What came out.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Frames looked at.
    pub frames: usize,
    /// The seed.
    pub seed: u64,
    /// Markers wholly in a picture.
    pub visible: usize,
    /// Those that were found, as a share.
    pub detection_rate: f64,
    /// Detections of our family where no such marker is.
    pub false_ids: usize,
    /// Markers read rightly with a corner more than 4 px off.
    pub misplaced: usize,
    /// Median corner error, pixels.
    pub corner_median_px: f64,
    /// 99th percentile of it, pixels.
    pub corner_p99_px: f64,
    /// With the lens's true numbers.
    #[serde(flatten)]
    pub accuracy: Accuracy,
    /// With those that calibration found.
    pub calibrated: Option<calibrated::Column>,
    /// Detection and poses of one frame of 20 markers on one core, ms.
    pub ms_per_frame: f64,
    /// The same with two threads, ms.
    pub ms_two_threads: f64,
    /// The C library's call alone on the same frames and settings, one core, ms.
    pub ms_library: f64,
    /// `ms_per_frame` over `ms_library`.
    pub ratio_to_c_library: f64,
    /// What went wrong in detection, one by one.
    pub slips: Slips,
}

/// Markers read where there is none, and not read where there is one.
#[derive(Clone, Debug, Serialize)]
pub struct Slips {
    /// Of our family where no such marker is.
    pub read_wrongly: Vec<tally::Slip>,
    /// Read rightly, with a corner far off.
    pub misplaced: Vec<tally::Slip>,
    /// Wholly in the picture and not found.
    pub missed: Vec<tally::Slip>,
}

/// The noise model that the benchmark's tables require: nothing is glued on by hand here.
pub fn limits() -> ObserveLimits {
    ObserveLimits {
        systematic_xy_m: 0.0,
        systematic_theta_rad: 0.0,
        height_std_m: HEIGHT_OFF_M / 3.0_f64.sqrt(),
        tilt_std_rad: TILT_RAD / 2.0,
        ..ObserveLimits::default()
    }
}

/// The lens, the ground and the eyes of a run.
pub struct Bench {
    lens: Lens,
    sheets: Vec<Sheet>,
    task: Task,
}

impl Bench {
    /// Prepares a run.
    ///
    /// # Errors
    /// What kept the sheets from being drawn.
    pub fn new(task: Task) -> Result<Bench, String> {
        let mut random = ChaCha8Rng::seed_from_u64(task.seed);
        let lens = Lens::new(scene::bench_camera(), &mut random);
        Ok(Bench { lens, sheets: scene::sheets(6, &mut random)?, task })
    }

    /// Runs; `done` is called with how many scenes are through. `None` when `stop` was set.
    ///
    /// # Errors
    /// What the detector or the pose mathematics says.
    pub fn run(
        &self,
        stop: &AtomicBool,
        done: &(dyn Fn(usize, usize) + Sync),
    ) -> Result<Option<Report>, String> {
        let Task { settings, seed, .. } = self.task;
        let calibrate = || calibrated::calibrate(&self.lens, settings, seed);
        let eye = self.task.calibrated.then(calibrate).transpose()?;
        let scenes = self.task.frames.div_ceil(scene::VIEWS);
        let through = AtomicUsize::new(0);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(self.task.threads).build();
        let pool = pool.map_err(|error| error.to_string())?;
        let one = |number: usize| -> Result<Tally, String> {
            if stop.load(Ordering::Relaxed) {
                return Ok(Tally::default());
            }
            let tally = self.scene(number, eye.as_ref())?;
            done(through.fetch_add(1, Ordering::Relaxed) + 1, scenes);
            Ok(tally)
        };
        let tallies = pool.install(|| (0..scenes).into_par_iter().map(one).collect::<Result<Vec<_>, _>>())?;
        if stop.load(Ordering::Relaxed) {
            return Ok(None);
        }
        let tally = tallies.into_iter().fold(Tally::default(), Tally::merge);
        Ok(Some(self.report(&tally, eye.as_ref())?))
    }

    fn report(&self, tally: &Tally, eye: Option<&calibrated::Found>) -> Result<Report, String> {
        let [ms_per_frame, ms_two_threads, ms_library] = self.times()?;
        let mut corners = tally.corner_px.clone();
        Ok(Report {
            frames: tally.frames,
            seed: self.task.seed,
            visible: tally.visible,
            detection_rate: tally.found as f64 / tally.visible.max(1) as f64,
            false_ids: tally.false_ids.len(),
            misplaced: tally.misplaced.len(),
            slips: Slips {
                read_wrongly: tally.false_ids.clone(),
                misplaced: tally.misplaced.clone(),
                missed: tally.missed.clone(),
            },
            corner_median_px: tally::quantile(&mut corners, 0.5),
            corner_p99_px: tally::quantile(&mut corners, 0.99),
            accuracy: tally.exact.accuracy(),
            calibrated: eye.map(|eye| eye.column(tally.calibrated.accuracy())),
            ms_per_frame,
            ms_two_threads,
            ms_library,
            ratio_to_c_library: ms_per_frame / ms_library,
        })
    }

    /// Picture and truth of one scene; every other one is cluttered.
    fn table(&self, number: usize) -> (Scene<'_>, ChaCha8Rng) {
        let mut random = ChaCha8Rng::seed_from_u64(self.task.seed);
        random.set_stream(1 + number as u64);
        let sheets = if number % 2 == 1 { &self.sheets[..] } else { &[] };
        (Scene::random(&self.lens, sheets, &mut random), random)
    }

    /// Some frames, with the truth about their corners: for people and for other detectors.
    pub fn frames(&self, count: usize) -> Vec<(GrayImage, KnownCorners)> {
        let of_scene = |number: usize| {
            let (scene, mut random) = self.table(number);
            let picture =
                render(&self.lens, &scene.views[0], &scene.ground, &scene.prints, DEGRADE, &mut random);
            let seen = scene.truths.iter().filter_map(|truth| {
                let print = &scene.prints[truth.print];
                print.corners(&self.lens, &scene.views[0]).map(|corners| (truth.id, corners))
            });
            (picture, seen.collect())
        };
        (0..count).map(of_scene).collect()
    }

    fn scene(&self, number: usize, eye: Option<&calibrated::Found>) -> Result<Tally, String> {
        let (scene, mut random) = self.table(number);
        let mut perception = self.perception(&scene, 1)?;
        let mut tally = Tally::default();
        let mut views = Vec::new();
        for table_from_camera in &scene.views {
            let picture =
                render(&self.lens, table_from_camera, &scene.ground, &scene.prints, DEGRADE, &mut random);
            let time = Timestamp::from_nanos(views.len() as u64);
            let view = perception.grey_view(picture, *table_from_camera, time, None);
            let view = view.map_err(|error| chain(&error))?;
            self.count(&scene, [number, views.len()], &view.detections, &mut tally);
            views.push(view);
        }
        self.judge(&scene, &self.lens.camera, &views, &mut tally.exact)?;
        if let Some(eye) = eye {
            for view in &mut views {
                view.table_from_camera = eye.table_from_camera(&view.table_from_camera);
            }
            self.judge(&scene, &eye.lens, &views, &mut tally.calibrated)?;
        }
        Ok(tally)
    }

    /// Which markers were found in one view, and what was found that matches no marker.
    fn count(&self, scene: &Scene, at: [usize; 2], seen: &[Detection], tally: &mut Tally) {
        tally.frames += 1;
        let [number, view] = at;
        let table_from_camera = &scene.views[view];
        let slip = |detection: &Detection, read: bool| tally::Slip {
            scene: number,
            view,
            id: detection.id,
            centre: detection.centre(),
            edge_px: detection.edge_min_px(),
            hamming: read.then_some(detection.hamming),
            decision_margin: read.then_some(detection.decision_margin),
        };
        let mut known = vec![false; seen.len()];
        for truth in &scene.truths {
            let print = &scene.prints[truth.print];
            let Some(corners) = print.corners(&self.lens, table_from_camera) else { continue };
            let is_it = |detection: &Detection| {
                detection.id == truth.id && farthest(&detection.corners, &corners) < SAME_PX
            };
            let place = seen.iter().position(is_it);
            for (known, detection) in known.iter_mut().zip(seen).filter(|(known, _)| !**known) {
                let apart =
                    detection.id == truth.id && distance(detection.centre(), middle(&corners)) < NEAR_PX;
                if apart && !is_it(detection) {
                    tally.misplaced.push(slip(detection, true));
                }
                *known = apart;
            }
            if !whole(print, &self.lens, table_from_camera) {
                continue;
            }
            tally.visible += 1;
            match place {
                Some(place) => {
                    tally.found += 1;
                    tally.corner_px.extend((0..4).map(|i| distance(seen[place].corners[i], corners[i])));
                }
                None => {
                    let there = Detection { id: truth.id, corners, ..Detection::default() };
                    tally.missed.push(slip(&there, false));
                }
            }
        }
        let strangers = seen.iter().zip(&known).filter(|(_, known)| !**known);
        tally.false_ids.extend(strangers.map(|(detection, _)| slip(detection, true)));
    }

    /// The cell's eyes before this table.
    fn perception(&self, scene: &Scene, threads: u8) -> Result<Perception, String> {
        let objects = scene.truths.iter().map(|truth| object(truth.id)).collect();
        let known = perception::Scene { objects, limits: limits(), ..scene::bare(&self.lens.camera) };
        let settings = DetectSettings { threads, ..self.task.settings };
        Perception::new(known, settings).map_err(|error| chain(&error))
    }

    /// How far off the poses are, of single views and of all views together.
    ///
    /// Below `perception` on purpose, by the functions that it calls: whether an error is as large as was
    /// claimed is shown by the whole covariance of each pose, and an observation gives deviations only.
    fn judge(
        &self,
        scene: &Scene,
        lens: &CameraModel,
        views: &[View],
        sums: &mut tally::Sums,
    ) -> Result<(), String> {
        let limits = limits();
        let sightings = sightings(lens, views).map_err(|error| error.to_string())?;
        let target = Target {
            size_m: SIZE_M,
            height_m: HEIGHT_M,
            height_std_m: limits.height_std_m,
            tilt_std_rad: limits.tilt_std_rad,
        };
        for truth in &scene.truths {
            let seen = sightings.get(&truth.id).map_or(&[][..], Vec::as_slice);
            let mut placed: Vec<_> =
                seen.iter().filter_map(|sighting| planar::place(sighting, target, views, &limits)).collect();
            // As `observe` does: corners that form no square are misread.
            let read = placed.len();
            placed.retain(|one| one.shape_residual_px <= limits.shape_residual_max_px);
            sums.refused += read - placed.len();
            for one in &placed {
                match fuse::fuse(std::slice::from_ref(one), target, views, &limits) {
                    Ok(fused) => sums.single.add(off(&fused.pose, &truth.pose), &fused.covariance),
                    Err(_) => sums.refused += 1,
                }
            }
            if placed.len() == scene::VIEWS {
                match fuse::fuse(&placed, target, views, &limits) {
                    Ok(fused) => sums.fused.add(off(&fused.pose, &truth.pose), &fused.covariance),
                    Err(_) => sums.refused += 1,
                }
            }
        }
        Ok(())
    }

    /// Milliseconds of detection and poses on one core, with two threads, and of the library alone on one
    /// core: medians over frames of the least time of several, in turns so that a busy machine slows all
    /// alike.
    fn times(&self) -> Result<[f64; 3], String> {
        // The bare detector on purpose: what it costs beside the library's own call is the question.
        let settings = DetectSettings { threads: 1, ..self.task.settings };
        let mut library = Detector::new(settings).map_err(|error| error.to_string())?;
        let mut columns = [Vec::new(), Vec::new(), Vec::new()];
        for number in 0..TIMED.min(2 * self.task.frames) {
            let (scene, mut random) = self.table(number);
            let picture =
                render(&self.lens, &scene.views[0], &scene.ground, &scene.prints, DEGRADE, &mut random);
            let (mut one, mut two) = (self.perception(&scene, 1)?, self.perception(&scene, 2)?);
            let mut least = [f64::INFINITY; 3];
            for _ in 0..TIMES {
                let took = [
                    whole_time(&mut one, &picture, &scene.views[0])?,
                    whole_time(&mut two, &picture, &scene.views[0])?,
                    library_time(&mut library, &picture)?,
                ];
                least.iter_mut().zip(took).for_each(|(least, took)| *least = least.min(took));
            }
            columns.iter_mut().zip(least).for_each(|(column, value)| column.push(value));
        }
        Ok(columns.map(|mut column| tally::quantile(&mut column, 0.5)))
    }
}

fn whole_time(
    perception: &mut Perception,
    picture: &GrayImage,
    table_from_camera: &Isometry3<f64>,
) -> Result<f64, String> {
    let started = Instant::now();
    let view = perception.grey_view(picture.clone(), *table_from_camera, Timestamp::ZERO, None);
    let view = view.map_err(|error| chain(&error))?;
    perception.observe(&[view], None).map_err(|error| chain(&error))?;
    Ok(started.elapsed().as_secs_f64() * 1e3)
}

fn library_time(detector: &mut Detector, picture: &GrayImage) -> Result<f64, String> {
    let started = Instant::now();
    detector.library_alone(picture).map_err(|error| error.to_string())?;
    Ok(started.elapsed().as_secs_f64() * 1e3)
}

fn object(marker_id: u32) -> MarkedObject {
    MarkedObject {
        id: marker_id.to_string(),
        marker_id,
        marker_size: SIZE_M,
        height: HEIGHT_M,
        offset: Pose2::default(),
    }
}

fn off(found: &Pose2, truth: &Pose2) -> Vector3<f64> {
    Vector3::new(found.x - truth.x, found.y - truth.y, wrap_angle(found.theta - truth.theta))
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

fn middle(corners: &[[f64; 2]; 4]) -> [f64; 2] {
    [0, 1].map(|axis| corners.iter().map(|corner| corner[axis]).sum::<f64>() / 4.0)
}

fn farthest(a: &[[f64; 2]; 4], b: &[[f64; 2]; 4]) -> f64 {
    (0..4).map(|i| distance(a[i], b[i])).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report(calibrated: bool) -> Report {
        let task = Task { frames: 10, seed: 3, settings: DetectSettings::default(), threads: 2, calibrated };
        Bench::new(task).unwrap().run(&AtomicBool::new(false), &|_, _| ()).unwrap().unwrap()
    }

    #[test]
    fn ten_frames_meet_the_figures() {
        let report = report(false);
        println!("{report:?}");
        assert!(report.frames == 10 && report.visible > 100);
        assert!(report.detection_rate > 0.99 && report.false_ids == 0, "{report:?}");
        assert!(
            report.accuracy.position_median_mm < 0.1 && report.accuracy.position_p99_mm < 0.4,
            "{report:?}"
        );
        assert!(report.accuracy.fused_median_mm < 0.05 && report.accuracy.angle_p99_deg < 0.4, "{report:?}");
        assert!((0.6..1.5).contains(&report.accuracy.std_ratio), "{report:?}");
    }

    #[test]
    fn a_run_that_is_stopped_has_no_report() {
        let task =
            Task { frames: 5, seed: 3, settings: DetectSettings::default(), threads: 1, calibrated: false };
        let bench = Bench::new(task).unwrap();
        assert!(bench.run(&AtomicBool::new(true), &|_, _| ()).unwrap().is_none());
    }
}
