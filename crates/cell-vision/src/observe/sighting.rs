//! Detections with the lens taken out: what everything that places a marker works on.
//!
//! In: the lens, [`View`]s. Out: [`Sighting`]s by marker number. Pure but for OpenCV's call in `cv`.

use crate::camera::CameraModel;
use crate::cv::{self, CvError};
use crate::observe::input::View;
use nalgebra::{Matrix2, Vector2};
use std::collections::BTreeMap;

/// A detection with the lens taken out.
#[derive(Clone, Debug)]
pub struct Sighting {
    /// Which view it is from.
    pub view: usize,
    /// Corners in normalised camera coordinates, order of `Detection::corners`.
    pub normalised: [Vector2<f64>; 4],
    /// Change of pixels by normalised coordinates at each corner.
    pub pixels_by_normalised: [Matrix2<f64>; 4],
}

/// All detections of all views by marker id, undistorted in one go per view.
///
/// # Errors
/// OpenCV reports an error or gives no usable answer for the corners of a view.
pub fn sightings(camera: &CameraModel, views: &[View]) -> Result<BTreeMap<u32, Vec<Sighting>>, CvError> {
    let mut by_id: BTreeMap<u32, Vec<Sighting>> = BTreeMap::new();
    for (view, seen) in views.iter().enumerate() {
        let corners = seen.detections.iter().flat_map(|detection| detection.corners);
        // Each corner and its two neighbours a pixel away: the lens model's slope comes with the point.
        let probes: Vec<[f64; 2]> = corners.flat_map(|[x, y]| [[x, y], [x + 1.0, y], [x, y + 1.0]]).collect();
        let normalised = cv::undistort(camera, &probes)?;
        for (detection, points) in seen.detections.iter().zip(normalised.chunks_exact(12)) {
            if let Some(sighting) = sighting(view, points) {
                by_id.entry(detection.id).or_default().push(sighting);
            }
        }
    }
    Ok(by_id)
}

fn sighting(view: usize, points: &[[f64; 2]]) -> Option<Sighting> {
    let point = |i: usize| points.get(i).map(|p| Vector2::new(p[0], p[1]));
    let mut normalised = [Vector2::zeros(); 4];
    let mut pixels_by_normalised = [Matrix2::zeros(); 4];
    for corner in 0..4 {
        let here = point(3 * corner)?;
        let slope = Matrix2::from_columns(&[point(3 * corner + 1)? - here, point(3 * corner + 2)? - here]);
        normalised[corner] = here;
        pixels_by_normalised[corner] = slope.try_inverse()?;
    }
    Some(Sighting { view, normalised, pixels_by_normalised })
}
