//! The hand-eye least squares problem: pixel errors of the reference markers over twelve unknowns.
//!
//! In: samples, survey, lens. Out: [`Fit`]s for any subset of the samples, residuals in pixels and metres.
//! The corners are undistorted once, and errors are carried back to pixels by the lens model's slope, so
//! that the loop is pure pinhole arithmetic. Unknowns: small motions of the camera in its own frame and of
//! the table in its own frame.

use crate::fit::{HandEyeGuess, HandEyeSettings, Sample};
use cell_vision::camera::CameraModel;
use cell_vision::cv::CvError;
use cell_vision::marker;
use cell_vision::observe::planar;
use cell_vision::observe::pnp::cross;
use cell_vision::observe::sighting::{self, Sighting};
use cell_vision::observe::{ReferenceMarker, View};
use nalgebra::{
    Isometry3, Matrix2x3, Point3, SMatrix, SVector, Translation3, UnitQuaternion, Vector2, Vector3,
};

/// Weight of a mount that is known: nothing a picture says moves it by more than a nanometre.
const HELD: f64 = 1e16;

/// 12 x 12: six of the camera on the flange, then six of the table in the base; translation before rotation.
pub type Information = SMatrix<f64, 12, 12>;

/// One sample with its reference markers matched to the survey.
#[derive(Debug)]
pub struct Stop {
    /// Its place among the samples given.
    pub sample: usize,
    /// The flange in the base.
    pub base_from_flange: Isometry3<f64>,
    /// Surveyed corners on the table, m, four for each marker seen.
    pub board_m: Vec<[f64; 2]>,
    /// The same corners as detected, pixels.
    pub pixels: Vec<[f64; 2]>,
    /// The same markers with the lens taken out.
    pub sightings: Vec<Sighting>,
}

/// All samples that show reference markers.
#[derive(Debug)]
pub struct Problem {
    /// In the order given.
    pub stops: Vec<Stop>,
}

/// A minimum of the robust cost.
#[derive(Clone, Debug)]
pub struct Fit {
    /// The two transforms.
    pub guess: HandEyeGuess,
    /// Robust cost, pixels squared.
    pub cost: f64,
    /// J^T J for 1 px of noise.
    pub information: Information,
}

impl Problem {
    /// Matches detections to the survey; markers seen twice in one picture are left out of it.
    ///
    /// # Errors
    /// What OpenCV reports.
    pub fn new(
        samples: &[Sample],
        reference: &[ReferenceMarker],
        camera: &CameraModel,
    ) -> Result<Problem, CvError> {
        let mut stops = Vec::new();
        for (index, sample) in samples.iter().enumerate() {
            let view = View {
                table_from_camera: Isometry3::identity(),
                detections: sample.detections.clone(),
                time: cell_values::time::Timestamp::ZERO,
                heights: None,
            };
            let mut sightings = sighting::sightings(camera, std::slice::from_ref(&view))?;
            let mut stop = Stop {
                sample: index,
                base_from_flange: sample.base_from_flange,
                board_m: Vec::new(),
                pixels: Vec::new(),
                sightings: Vec::new(),
            };
            for marker in reference {
                let once: Vec<_> = view.detections.iter().filter(|seen| seen.id == marker.id).collect();
                let ([detection], Some(mut seen)) = (once.as_slice(), sightings.remove(&marker.id)) else {
                    continue;
                };
                let Some(sighting) = seen.pop() else { continue };
                stop.board_m
                    .extend(marker::corners_m(marker.size).map(|corner| marker.pose.transform(corner)));
                stop.pixels.extend(detection.corners);
                stop.sightings.push(sighting);
            }
            if !stop.sightings.is_empty() {
                stops.push(stop);
            }
        }
        Ok(Problem { stops })
    }

    /// Fits the chosen stops from `start`; `None` when a marker lies behind a camera or the numbers break
    /// down.
    pub fn fit(&self, chosen: &[usize], start: HandEyeGuess, settings: &HandEyeSettings) -> Option<Fit> {
        let at = |guess| {
            let mut linear = self.linearise(chosen, guess, settings.robust_px)?;
            if settings.keep_mount {
                (0..6).for_each(|i| linear.gradient[i] = 0.0);
                (0..6).for_each(|i| linear.information[(i, i)] += HELD);
            }
            Some(linear)
        };
        let mut best = at(start)?;
        let mut damping = 1e-3;
        for _ in 0..200 {
            let next = step(&best, damping).and_then(at);
            match next {
                Some(next) if next.cost < best.cost => {
                    let settled = best.cost - next.cost < 1e-12 * (1.0 + best.cost);
                    best = next;
                    damping = (damping * 0.3).max(1e-12);
                    if settled {
                        break;
                    }
                }
                _ => damping *= 5.0,
            }
            if damping > 1e9 {
                break;
            }
        }
        Some(Fit { guess: best.guess, cost: best.cost, information: best.information })
    }

    /// Root mean square corner error of the chosen stops, pixels; infinite if a marker lies behind a camera.
    pub fn residual_px(&self, chosen: &[usize], guess: &HandEyeGuess) -> f64 {
        match self.linearise(chosen, *guess, f64::INFINITY) {
            Some(linear) if linear.corners > 0 => (linear.cost / linear.corners as f64).sqrt(),
            _ => f64::INFINITY,
        }
    }

    /// Root mean square corner error of one stop on the table's surface, m.
    pub fn residual_m(&self, stop: usize, guess: &HandEyeGuess) -> Option<f64> {
        let stop = self.stops.get(stop)?;
        let table_from_camera =
            guess.base_from_table.inverse() * stop.base_from_flange * guess.flange_from_camera;
        let mut squares = 0.0;
        for (sighting, surveyed) in stop.sightings.iter().zip(stop.board_m.chunks_exact(4)) {
            let seen = planar::corners_on_plane(sighting, &table_from_camera, 0.0)?;
            let error = |(a, b): (&[f64; 2], &[f64; 2])| (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2);
            squares += seen.iter().zip(surveyed).map(error).sum::<f64>();
        }
        Some((squares / stop.board_m.len() as f64).sqrt())
    }

    fn linearise(&self, chosen: &[usize], guess: HandEyeGuess, robust_px: f64) -> Option<Linear> {
        let mut linear = Linear {
            guess,
            cost: 0.0,
            corners: 0,
            information: Information::zeros(),
            gradient: SVector::zeros(),
        };
        for stop in chosen.iter().filter_map(|&index| self.stops.get(index)) {
            let camera_from_table =
                (stop.base_from_flange * guess.flange_from_camera).inverse() * guess.base_from_table;
            for (sighting, board) in stop.sightings.iter().zip(stop.board_m.chunks_exact(4)) {
                for (corner, place) in board.iter().enumerate() {
                    linear.add(sighting, corner, &camera_from_table, *place, robust_px)?;
                }
            }
        }
        linear.cost.is_finite().then_some(linear)
    }
}

/// The problem linearised at a guess.
struct Linear {
    guess: HandEyeGuess,
    cost: f64,
    corners: usize,
    information: Information,
    gradient: SVector<f64, 12>,
}

impl Linear {
    /// Adds one corner with Huber's loss.
    fn add(
        &mut self,
        sighting: &Sighting,
        corner: usize,
        camera_from_table: &Isometry3<f64>,
        place: [f64; 2],
        robust_px: f64,
    ) -> Option<()> {
        let on_table = Vector3::new(place[0], place[1], 0.0);
        let point = camera_from_table * Point3::from(on_table);
        if point.z <= 1e-3 {
            return None;
        }
        let seen = Vector2::new(point.x / point.z, point.y / point.z);
        let pixels = sighting.pixels_by_normalised[corner];
        let miss = pixels * (sighting.normalised[corner] - seen);
        let size = miss.norm();
        let (weight, cost) = if size <= robust_px {
            (1.0, size * size)
        } else {
            (robust_px / size, robust_px * (2.0 * size - robust_px))
        };
        let project = Matrix2x3::new(1.0, 0.0, -seen.x, 0.0, 1.0, -seen.y) / point.z;
        let by_point: Matrix2x3<f64> = pixels * project;
        let by_table: Matrix2x3<f64> =
            by_point * camera_from_table.rotation.to_rotation_matrix().into_inner();
        let mut slope = SMatrix::<f64, 2, 12>::zeros();
        slope.fixed_columns_mut::<3>(0).copy_from(&-by_point);
        slope.fixed_columns_mut::<3>(3).copy_from(&(by_point * cross(&point.coords)));
        slope.fixed_columns_mut::<3>(6).copy_from(&by_table);
        slope.fixed_columns_mut::<3>(9).copy_from(&(-by_table * cross(&on_table)));
        self.cost += cost;
        self.corners += 1;
        self.information += slope.transpose() * slope * weight;
        self.gradient += slope.transpose() * miss * weight;
        Some(())
    }
}

/// A damped step; the damping also holds what the samples do not determine.
fn step(linear: &Linear, damping: f64) -> Option<HandEyeGuess> {
    let mut matrix = linear.information;
    let floor = 1e-9 * matrix.diagonal().max();
    for i in 0..12 {
        matrix[(i, i)] += damping * matrix[(i, i)].max(floor);
    }
    let change = matrix.cholesky()?.solve(&linear.gradient);
    let moved = |from: usize| {
        let turn = Vector3::new(change[from + 3], change[from + 4], change[from + 5]);
        let shift = Vector3::new(change[from], change[from + 1], change[from + 2]);
        Isometry3::from_parts(Translation3::from(shift), UnitQuaternion::from_scaled_axis(turn))
    };
    Some(HandEyeGuess {
        flange_from_camera: linear.guess.flange_from_camera * moved(0),
        base_from_table: linear.guess.base_from_table * moved(6),
    })
}
