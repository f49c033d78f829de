//! How surely a camera that was bumped is noticed, and how often one is called bumped that was not.
//!
//! In: how many trials and looks, a seed. Out: [`Report`]. A table with twelve reference markers and two
//! look poses, as in the example configuration; the arm comes back to each within its repeatability, corners
//! carry noise. A bump shifts the camera by 2 mm in any direction or turns it by 0.3 degrees about any axis,
//! for the whole look. Most looks use the corners as the lens projects them, with normal noise twice what
//! the detector leaves on rendered pictures; some are rendered and detected. Observation and decision are
//! the cell's own. A last part measures how much of the limits a calibration's own error takes up on an
//! untouched cell: mounts off by what the hand-eye calibration may be off, and mounts as its rounds find
//! them.

use crate::bench::vision::hand_eye::Calibration;
use crate::bench::vision::scene::{DEGRADE, bare, bench_camera, looking_down};
use crate::bench::vision::tally::quantile;
use crate::perception::{Perception, Scene, observe_views};
use cell_values::time::Timestamp;
use cell_vision::detect::{DetectSettings, Detection, Family};
use cell_vision::observe::reference::DriftLimits;
use cell_vision::observe::{ReferenceMarker, View};
use nalgebra::{Isometry3, UnitVector3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rearrange::document::chain::chain;
use rearrange::geometry::pose::Pose2;
use serde::Serialize;
use std::sync::atomic::{AtomicBool, Ordering};
use vision_pictures::render::{Ground, Lens, Print, render};

/// The bumps.
const SHIFT_M: f64 = 2e-3;
const TURN_RAD: f64 = 0.3 * std::f64::consts::PI / 180.0;
/// The arm's repeatability, standard deviation along each axis, m.
const REPEAT_M: f64 = 3e-5;
/// Corner noise along each axis, pixels.
const CORNER_PX: f64 = 0.05;
/// The table and the markers round it, m.
const TABLE_M: f64 = 0.5;
const MARKER_M: f64 = 0.03;
/// Frames from each look pose.
const FRAMES: usize = 2;
/// Most that a mount may be off after calibration.
const MOUNT_M: f64 = 5e-4;
const MOUNT_RAD: f64 = 0.1 * std::f64::consts::PI / 180.0;

/// What to run.
#[derive(Clone, Copy, Debug)]
pub struct Task {
    /// Bumped looks; half of them shifted, half turned.
    pub trials: usize,
    /// Looks with nothing wrong.
    pub looks: usize,
    /// Looks that are rendered and detected, half of them bumped.
    pub rendered: usize,
    /// Calibrations of each kind whose own error is looked at.
    pub calibrations: usize,
    /// Seed.
    pub seed: u64,
}

/// What came out.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Bumped looks.
    pub trials: usize,
    /// Those that were noticed.
    pub noticed: usize,
    /// The least any bump exceeded its limit by, 1 being the limit.
    pub least_excess: f64,
    /// Looks with nothing wrong.
    pub looks: usize,
    /// Those that were called bumped.
    pub false_alarms: usize,
    /// The most any of them came to, 1 being the limit.
    pub largest_share: f64,
    /// Rendered looks that were bumped, and those of them that were noticed.
    pub rendered_trials: usize,
    /// See `rendered_trials`.
    pub rendered_noticed: usize,
    /// Rendered looks with nothing wrong, and those of them that were called bumped.
    pub rendered_looks: usize,
    /// See `rendered_looks`.
    pub rendered_false_alarms: usize,
    /// Mounts off by up to 0.5 mm and 0.1 degrees, nothing else wrong.
    pub within: Untouched,
    /// Mounts and tables as rounds of twenty poses find them, with the noise of that part.
    pub calibrated: Untouched,
    /// The limits.
    pub limit_mm: f64,
    /// See `limit_mm`.
    pub limit_deg: f64,
}

/// Looks of untouched cells, each with a calibration of its own.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Untouched {
    /// Looks.
    pub looks: usize,
    /// Those that were called bumped.
    pub alarms: usize,
    /// Median of how near they come to a limit, 1 being the limit.
    pub median_share: f64,
    /// The largest.
    pub largest_share: f64,
}

/// Lens, markers and look poses.
struct Bench {
    lens: Lens,
    /// What the cell knows: lens, survey, limits.
    known: Scene,
    prints: Vec<Print>,
    poses: [Isometry3<f64>; 2],
}

/// How the markers of a picture become known.
enum SightKind {
    /// Projected, with noise.
    Corners,
    /// Drawn, and found by the cell's own eyes.
    Pictures(Box<Perception>),
}

/// What came of bumped looks and of looks with nothing wrong.
struct Tally {
    noticed: usize,
    least_excess: f64,
    false_alarms: usize,
    largest_share: f64,
}

/// Runs with these limits; `None` when `stop` was set.
///
/// # Errors
/// What detector or observation say.
pub fn run(task: Task, limits: DriftLimits, stop: &AtomicBool) -> Result<Option<Report>, String> {
    let mut random = ChaCha8Rng::seed_from_u64(task.seed);
    let bench = Bench::new(limits, &mut random);
    let Some(projected) =
        bench.tally([task.trials, task.looks], &mut SightKind::Corners, stop, &mut random)?
    else {
        return Ok(None);
    };
    let perception = Perception::new(bench.known.clone(), DetectSettings::default());
    let mut sight = SightKind::Pictures(Box::new(perception.map_err(|error| chain(&error))?));
    let (rendered_trials, rendered_looks) = (task.rendered / 2, task.rendered - task.rendered / 2);
    let Some(rendered) = bench.tally([rendered_trials, rendered_looks], &mut sight, stop, &mut random)?
    else {
        return Ok(None);
    };
    let Some(within) = bench.untouched(task.calibrations, stop, &mut random, &mut |random| {
        let shift = direction(random).scale(random.random_range(0.0..MOUNT_M));
        let turn = direction(random).scale(random.random_range(0.0..MOUNT_RAD));
        let off = Isometry3::new(shift, turn);
        Ok(Box::new(move |truly: &Isometry3<f64>| truly * off))
    })?
    else {
        return Ok(None);
    };
    let Some(calibrated) = bench.untouched(task.calibrations, stop, &mut random, &mut |random| {
        let found = Calibration::found(&bench.lens, random).map_err(|error| error.to_string())?;
        Ok(Box::new(move |truly: &Isometry3<f64>| found.believed(truly)))
    })?
    else {
        return Ok(None);
    };
    Ok(Some(Report {
        trials: task.trials,
        noticed: projected.noticed,
        least_excess: projected.least_excess,
        looks: task.looks,
        false_alarms: projected.false_alarms,
        largest_share: projected.largest_share,
        rendered_trials,
        rendered_noticed: rendered.noticed,
        rendered_looks,
        rendered_false_alarms: rendered.false_alarms,
        within,
        calibrated,
        limit_mm: limits.shift_m * 1e3,
        limit_deg: limits.turn_rad.to_degrees(),
    }))
}

/// From where the camera truly is to where the cell assumes it.
type Belief<'a> = Box<dyn Fn(&Isometry3<f64>) -> Isometry3<f64> + 'a>;

/// By turns a shift and a turn, in a direction of its own, in the camera's frame.
fn bump(trial: usize, random: &mut ChaCha8Rng) -> Isometry3<f64> {
    let direction = direction(random);
    if trial.is_multiple_of(2) {
        Isometry3::new(direction.scale(SHIFT_M), Vector3::zeros())
    } else {
        Isometry3::new(Vector3::zeros(), direction.scale(TURN_RAD))
    }
}

/// Any direction, all equally likely.
fn direction(random: &mut ChaCha8Rng) -> UnitVector3<f64> {
    loop {
        let mut one = || random.random_range(-1.0..1.0);
        let v = Vector3::new(one(), one(), one());
        if (0.01..=1.0).contains(&v.norm()) {
            return UnitVector3::new_normalize(v);
        }
    }
}

fn normal(random: &mut ChaCha8Rng) -> f64 {
    let (u, v): (f64, f64) = (random.random(), random.random());
    (-2.0 * (1.0 - u).ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

impl Bench {
    fn new(limits: DriftLimits, random: &mut ChaCha8Rng) -> Bench {
        let (low, high) = (-0.045, TABLE_M + 0.045);
        let (a, b) = (TABLE_M / 3.0, 2.0 * TABLE_M / 3.0);
        let corners = [[low, low], [high, low], [low, high], [high, high]];
        let along = [a, b].into_iter().flat_map(|at| [[at, low], [at, high], [low, at], [high, at]]);
        let marker = |(i, [x, y]): (u32, [f64; 2])| ReferenceMarker {
            id: 500 + i,
            size: MARKER_M,
            pose: Pose2::new(x, y, 0.0),
        };
        let reference: Vec<ReferenceMarker> =
            (0..).zip(corners.into_iter().chain(along)).map(marker).collect();
        let print = |marker: &ReferenceMarker| {
            Some(Print {
                pattern: Family::Tag36h11.pattern(marker.id)?,
                size_m: marker.size,
                table_from_marker: marker.pose.at_height(0.0),
                greys: [35.0, 215.0],
                rim: (0.002, 150.0),
            })
        };
        let prints = reference.iter().filter_map(print).collect();
        let middle = TABLE_M / 2.0;
        let poses = [0.14, TABLE_M - 0.14].map(|y| looking_down([middle, y], 0.5, [0.02, -0.03], 0.05));
        let lens = Lens::new(bench_camera(), random);
        let known = Scene { reference, drift: limits, ..bare(&lens.camera) };
        Bench { lens, known, prints, poses }
    }

    /// So many bumped looks and then so many with nothing wrong; `None` when `stop` was set.
    fn tally(
        &self,
        [bumped, sound]: [usize; 2],
        eye: &mut SightKind,
        stop: &AtomicBool,
        random: &mut ChaCha8Rng,
    ) -> Result<Option<Tally>, String> {
        let mut tally =
            Tally { noticed: 0, least_excess: f64::INFINITY, false_alarms: 0, largest_share: 0.0 };
        for trial in 0..bumped + sound {
            if stop.load(Ordering::Relaxed) {
                return Ok(None);
            }
            let bump = Some(trial).filter(|trial| *trial < bumped);
            let (drifted, share) = self.trial(bump, eye, random)?;
            if bump.is_some() {
                tally.noticed += usize::from(drifted);
                tally.least_excess = tally.least_excess.min(share);
            } else {
                tally.false_alarms += usize::from(drifted);
                tally.largest_share = tally.largest_share.max(share);
            }
        }
        Ok(Some(tally))
    }

    /// A look of a cell that is calibrated exactly, with the bump of this number or none.
    fn trial(
        &self,
        bumped: Option<usize>,
        eye: &mut SightKind,
        random: &mut ChaCha8Rng,
    ) -> Result<(bool, f64), String> {
        let bump = bumped.map_or_else(Isometry3::identity, |number| bump(number, random));
        self.look(&|truly| *truly, &bump, eye, random)
    }

    /// One look with each of so many calibrations; `None` when `stop` was set.
    fn untouched<'a>(
        &self,
        count: usize,
        stop: &AtomicBool,
        random: &mut ChaCha8Rng,
        calibration: &mut dyn FnMut(&mut ChaCha8Rng) -> Result<Belief<'a>, String>,
    ) -> Result<Option<Untouched>, String> {
        let (mut shares, mut alarms) = (Vec::with_capacity(count), 0);
        for _ in 0..count {
            if stop.load(Ordering::Relaxed) {
                return Ok(None);
            }
            let belief = calibration(random)?;
            let (drifted, share) =
                self.look(&*belief, &Isometry3::identity(), &mut SightKind::Corners, random)?;
            alarms += usize::from(drifted);
            shares.push(share);
        }
        let largest_share = shares.iter().copied().fold(0.0, f64::max);
        Ok(Some(Untouched { looks: count, alarms, median_share: quantile(&mut shares, 0.5), largest_share }))
    }

    /// Whether a look with the camera bumped like that is called drift, and how near it comes to the limits.
    fn look(
        &self,
        belief: &dyn Fn(&Isometry3<f64>) -> Isometry3<f64>,
        bump: &Isometry3<f64>,
        eye: &mut SightKind,
        random: &mut ChaCha8Rng,
    ) -> Result<(bool, f64), String> {
        let mut views = Vec::with_capacity(self.poses.len() * FRAMES);
        for nominal in &self.poses {
            let repeat = Vector3::new(normal(random), normal(random), normal(random)) * REPEAT_M;
            let truly = nominal * Isometry3::new(repeat, Vector3::zeros()) * bump;
            for _ in 0..FRAMES {
                views.push(self.view(&truly, belief(nominal), eye, random)?);
            }
        }
        let seen = observe_views(&self.known, &views, None);
        let check = seen.map_err(|error| chain(&error))?.reference;
        let check = check.ok_or("a look showed no reference marker")?;
        let limits = &self.known.drift;
        let share = check.worst_look(limits).map_or(0.0, |(_, excess)| excess);
        Ok((check.drifted(limits), share.max(check.residual_rms_m / limits.residual_m)))
    }

    /// One frame with the camera truly there, for a cell that assumes it elsewhere.
    fn view(
        &self,
        truly: &Isometry3<f64>,
        table_from_camera: Isometry3<f64>,
        eye: &mut SightKind,
        random: &mut ChaCha8Rng,
    ) -> Result<View, String> {
        let time = Timestamp::ZERO;
        if let SightKind::Pictures(perception) = eye {
            let ground = Ground::Plain(140.0);
            let picture = render(&self.lens, truly, &ground, &self.prints, DEGRADE, random);
            let view = perception.grey_view(picture, table_from_camera, time, None);
            return view.map_err(|error| chain(&error));
        }
        let detections = self.projected(truly, random);
        Ok(View { table_from_camera, detections, time, heights: None })
    }

    /// The markers' corners as the lens projects them, with noise.
    fn projected(&self, table_from_camera: &Isometry3<f64>, random: &mut ChaCha8Rng) -> Vec<Detection> {
        let (width, height) = (f64::from(self.lens.camera.width), f64::from(self.lens.camera.height));
        let mut seen = Vec::new();
        for (marker, print) in self.known.reference.iter().zip(&self.prints) {
            let corners = print.corners(&self.lens, table_from_camera);
            let inside =
                |[x, y]: &[f64; 2]| (4.0..width - 4.0).contains(x) && (4.0..height - 4.0).contains(y);
            let Some(mut corners) = corners.filter(|corners| corners.iter().all(inside)) else { continue };
            for value in corners.iter_mut().flatten() {
                *value += CORNER_PX * normal(random);
            }
            seen.push(Detection {
                family: "tag36h11".into(),
                id: marker.id,
                corners,
                ..Detection::default()
            });
        }
        seen
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: DriftLimits =
        DriftLimits { residual_m: 2e-3, shift_m: 1e-3, turn_rad: 0.15 * 0.017_453_292 };

    #[test]
    fn every_bump_is_noticed_and_nothing_else_is() {
        let task = Task { trials: 100, looks: 300, rendered: 4, calibrations: 10, seed: 2 };
        let report = run(task, LIMITS, &AtomicBool::new(false)).unwrap().unwrap();
        println!("{report:?}");
        assert_eq!((report.noticed, report.false_alarms), (100, 0), "{report:?}");
        assert_eq!((report.rendered_noticed, report.rendered_false_alarms), (2, 0), "{report:?}");
        assert!(report.least_excess > 1.0 && report.largest_share < 0.5, "{report:?}");
        // A calibration's own error shows, and one that was found leaves most of the limits.
        assert!(report.within.largest_share > report.largest_share, "{report:?}");
        assert!(report.calibrated.alarms == 0 && report.calibrated.largest_share < 0.8, "{report:?}");
    }

    #[test]
    fn limits_that_are_too_wide_let_bumps_through() {
        let wide = DriftLimits { residual_m: 9e-3, shift_m: 4e-3, turn_rad: 0.02 };
        let task = Task { trials: 20, looks: 0, rendered: 0, calibrations: 0, seed: 2 };
        assert!(run(task, wide, &AtomicBool::new(false)).unwrap().unwrap().noticed < 20);
    }
}
