//! What OpenCV computes for us: undistorting and projecting points, poses of squares and boards, the lens,
//! hand-eye start.
//!
//! In: [`CameraModel`], points in pixels or metres, poses. Out: the same kinds of things as nalgebra types;
//! no OpenCV type leaves this file, the only one here that calls the library (Debian 12's 4.6:
//! signatures differ between versions). Pure: same input, same output. Frames and the pixel convention are
//! those of `camera`.

use crate::camera::CameraModel;
use crate::marker;
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use opencv::calib3d;
use opencv::core::{
    Mat, MatTraitConst, Point2d, Point2f, Point3d, Point3f, Size, TermCriteria, Vector, no_array,
};

/// OpenCV refused or answered with something that is not a number.
#[derive(Debug, thiserror::Error)]
pub enum CvError {
    /// The library reported an error.
    #[error("OpenCV could not {what}")]
    Library {
        /// The requested operation.
        what: &'static str,
        /// What it says.
        #[source]
        source: opencv::Error,
    },
    /// The answer holds NaN, infinity, or too few values.
    #[error("OpenCV gave no usable answer when asked to {what}")]
    NoAnswer {
        /// The requested operation.
        what: &'static str,
    },
}

/// One candidate pose of a flat target.
#[derive(Clone, Copy, Debug)]
pub struct TargetPose {
    /// The target's frame seen from the camera.
    pub camera_from_target: Isometry3<f64>,
    /// Root mean square distance between the corners and their projections, pixels.
    pub reprojection_px: f64,
}

/// Pixels to normalised camera coordinates (x/z, y/z), the lens distortion taken out.
///
/// # Errors
/// `Library` or `NoAnswer`; an empty input is an empty answer.
pub fn undistort(camera: &CameraModel, pixels: &[[f64; 2]]) -> Result<Vec<[f64; 2]>, CvError> {
    const WHAT: &str = "undistort points";
    if pixels.is_empty() {
        return Ok(Vec::new());
    }
    let source: Vector<Point2d> = pixels.iter().map(|p| Point2d::new(p[0], p[1])).collect();
    let mut target = Vector::<Point2d>::new();
    // OpenCV's default of 5 rounds leaves up to a tenth of a pixel in the corners of a strongly distorted
    // picture.
    let until = TermCriteria { typ: 3, max_count: 100, epsilon: 1e-10 };
    let (matrix, distortion) = lens(camera, WHAT)?;
    calib3d::undistort_points_iter(
        &source,
        &mut target,
        &matrix,
        &distortion,
        &no_array(),
        &no_array(),
        until,
    )
    .map_err(|source| CvError::Library { what: WHAT, source })?;
    points(&target, pixels.len(), WHAT)
}

/// Points in the target's frame (m) to pixels, distortion included.
///
/// # Errors
/// `Library` or `NoAnswer`; points behind the camera give meaningless pixels, as in OpenCV.
pub fn project(
    camera: &CameraModel,
    camera_from_target: &Isometry3<f64>,
    target_points: &[[f64; 3]],
) -> Result<Vec<[f64; 2]>, CvError> {
    const WHAT: &str = "project points";
    if target_points.is_empty() {
        return Ok(Vec::new());
    }
    let source: Vector<Point3d> = target_points.iter().map(|p| Point3d::new(p[0], p[1], p[2])).collect();
    let rotation = camera_from_target.rotation.scaled_axis();
    let translation = camera_from_target.translation.vector;
    let (matrix, distortion) = lens(camera, WHAT)?;
    let mut target = Vector::<Point2d>::new();
    calib3d::project_points(
        &source,
        &Vector::from_slice(rotation.as_slice()),
        &Vector::from_slice(translation.as_slice()),
        &matrix,
        &distortion,
        &mut target,
        &mut no_array(),
        0.0,
    )
    .map_err(|source| CvError::Library { what: WHAT, source })?;
    points(&target, target_points.len(), WHAT)
}

/// The poses a square marker can have, best first: usually two, and only perspective decides which is true.
///
/// In: corners in the order of `Detection::corners`, the edge of the black square in m. IPPE (Collins and
/// Bartoli, "Infinitesimal plane-based pose estimation", 2014).
///
/// # Errors
/// `Library` or `NoAnswer`.
pub fn square_poses(
    camera: &CameraModel,
    corners: &[[f64; 2]; 4],
    size_m: f64,
) -> Result<Vec<TargetPose>, CvError> {
    let target: Vec<[f64; 2]> = marker::corners_m(size_m).to_vec();
    flat_poses(camera, &target, corners, calib3d::SolvePnPMethod::SOLVEPNP_IPPE)
}

/// The pose of a flat board (all points at z = 0 of its frame), at least 4 points not on one line.
///
/// # Errors
/// `Library` or `NoAnswer`, also when the points do not fix a pose.
pub fn board_pose(
    camera: &CameraModel,
    board_m: &[[f64; 2]],
    pixels: &[[f64; 2]],
) -> Result<TargetPose, CvError> {
    let what = "find the pose of a board";
    // OpenCV gives some pose for these too.
    if on_one_line(board_m) {
        return Err(CvError::NoAnswer { what });
    }
    let candidates = flat_poses(camera, board_m, pixels, calib3d::SolvePnPMethod::SOLVEPNP_IPPE)?;
    let rough = candidates.into_iter().next().ok_or(CvError::NoAnswer { what })?;
    refined(camera, board_m, pixels, &rough)
}

/// The pose with the least reprojection error near a rough one, or the rough one where there is no better.
fn refined(
    camera: &CameraModel,
    board_m: &[[f64; 2]],
    pixels: &[[f64; 2]],
    rough: &TargetPose,
) -> Result<TargetPose, CvError> {
    const WHAT: &str = "refine the pose of a board";
    let failed = |source| CvError::Library { what: WHAT, source };
    let object: Vector<Point3d> = board_m.iter().map(|p| Point3d::new(p[0], p[1], 0.0)).collect();
    let image: Vector<Point2d> = pixels.iter().map(|p| Point2d::new(p[0], p[1])).collect();
    let (matrix, distortion) = lens(camera, WHAT)?;
    let column = |v: Vector3<f64>| Mat::from_slice_2d(&[[v.x], [v.y], [v.z]]).map_err(failed);
    let mut turn = column(rough.camera_from_target.rotation.scaled_axis())?;
    let mut shift = column(rough.camera_from_target.translation.vector)?;
    let until = TermCriteria { typ: 3, max_count: 50, epsilon: 1e-12 };
    calib3d::solve_pnp_refine_lm(&object, &image, &matrix, &distortion, &mut turn, &mut shift, until)
        .map_err(failed)?;
    let (r, t) = (vector3(&turn).map_err(failed)?, vector3(&shift).map_err(failed)?);
    if !r.iter().chain(t.iter()).all(|value| value.is_finite()) || t.z <= 0.0 {
        return Ok(*rough);
    }
    let camera_from_target = Isometry3::new(t, r);
    let points: Vec<[f64; 3]> = board_m.iter().map(|p| [p[0], p[1], 0.0]).collect();
    let reprojection_px = rms(&project(camera, &camera_from_target, &points)?, pixels);
    let better = reprojection_px < rough.reprojection_px;
    Ok(if better { TargetPose { camera_from_target, reprojection_px } } else { *rough })
}

/// Corners of a board on the board (m) and in one picture (pixels).
pub type BoardCorners = (Vec<[f64; 2]>, Vec<[f64; 2]>);

/// A lens fitted to pictures of a board.
#[derive(Clone, Debug)]
pub struct LensFit {
    /// The numbers; the serial is empty.
    pub camera: CameraModel,
    /// Root mean square corner error, pixels.
    pub reprojection_px: f64,
    /// The same of each picture, in their order.
    pub by_view_px: Vec<f64>,
    /// Standard deviations of fx, fy, cx, cy, pixels.
    pub std_px: [f64; 4],
}

/// Fits focal lengths, principal point and k1, k2, p1, p2, k3 to pictures of a flat board (Zhang, 2000).
///
/// # Errors
/// `Library` or `NoAnswer`, for instance with fewer than 3 pictures.
pub fn calibrate_lens(width: u32, height: u32, views: &[BoardCorners]) -> Result<LensFit, CvError> {
    const WHAT: &str = "fit the lens to pictures of a board";
    let failed = |source| CvError::Library { what: WHAT, source };
    let sound =
        |(board, seen): &BoardCorners| board.len() == seen.len() && board.len() >= 4 && !on_one_line(board);
    if views.len() < 3 || !views.iter().all(sound) {
        return Err(CvError::NoAnswer { what: WHAT });
    }
    // Single precision is what the function takes: a ten thousandth of a pixel.
    let (mut object, mut image) = (Vector::<Vector<Point3f>>::new(), Vector::<Vector<Point2f>>::new());
    for (board, seen) in views {
        object.push(board.iter().map(|p| Point3f::new(p[0] as f32, p[1] as f32, 0.0)).collect());
        image.push(seen.iter().map(|p| Point2f::new(p[0] as f32, p[1] as f32)).collect());
    }
    let size = Size::new(i32::try_from(width).unwrap_or(0), i32::try_from(height).unwrap_or(0));
    let (mut matrix, mut distortion) = (Mat::default(), Mat::default());
    let (mut turns, mut shifts) = (Vector::<Mat>::new(), Vector::<Mat>::new());
    let (mut std, mut std_views, mut by_view) = (Mat::default(), Mat::default(), Mat::default());
    let until = TermCriteria { typ: 3, max_count: 200, epsilon: 1e-12 };
    let reprojection_px = calib3d::calibrate_camera_extended(
        &object,
        &image,
        size,
        &mut matrix,
        &mut distortion,
        &mut turns,
        &mut shifts,
        &mut std,
        &mut std_views,
        &mut by_view,
        0,
        until,
    )
    .map_err(failed)?;
    let number = |mat: &Mat, i: i32| {
        let at = if mat.rows() == 1 { mat.at_2d::<f64>(0, i) } else { mat.at_2d::<f64>(i, 0) };
        at.copied().map_err(failed)
    };
    let entry = |i: i32, j: i32| matrix.at_2d::<f64>(i, j).copied().map_err(failed);
    let camera = CameraModel {
        serial: String::new(),
        width,
        height,
        fx: entry(0, 0)?,
        fy: entry(1, 1)?,
        cx: entry(0, 2)?,
        cy: entry(1, 2)?,
        distortion: numbers([0, 1, 2, 3, 4].map(|i| number(&distortion, i)))?,
    };
    let std_px = numbers([0, 1, 2, 3].map(|i| number(&std, i)))?;
    let by_view_px = (0..views.len() as i32).map(|i| number(&by_view, i)).collect::<Result<Vec<_>, _>>()?;
    let finite =
        by_view_px.iter().chain(&std_px).all(|value| value.is_finite()) && reprojection_px.is_finite();
    if !finite || camera.check().is_err() {
        return Err(CvError::NoAnswer { what: WHAT });
    }
    Ok(LensFit { camera, reprojection_px, by_view_px, std_px })
}

/// All numbers, or the first failure.
fn numbers<const N: usize>(found: [Result<f64, CvError>; N]) -> Result<[f64; N], CvError> {
    let mut values = [0.0; N];
    for (value, found) in values.iter_mut().zip(found) {
        *value = found?;
    }
    Ok(values)
}

/// True when the points fix no plane: their spread across is less than a thousandth of that along.
fn on_one_line(points: &[[f64; 2]]) -> bool {
    let count = points.len().max(1) as f64;
    let mean = |axis: usize| points.iter().map(|p| p[axis]).sum::<f64>() / count;
    let (x, y) = (mean(0), mean(1));
    let moment = |f: fn(f64, f64) -> f64| points.iter().map(|p| f(p[0] - x, p[1] - y)).sum::<f64>();
    let spread = nalgebra::Matrix2::new(
        moment(|x, _| x * x),
        moment(|x, y| x * y),
        moment(|x, y| x * y),
        moment(|_, y| y * y),
    );
    let (least, most) = (spread.symmetric_eigenvalues().min(), spread.symmetric_eigenvalues().max());
    // A spread that is no number is none either.
    least.is_nan() || least <= 1e-6 * most
}

/// Closed-form start for hand-eye: where the camera sits on the flange (Park and Martin, 1994).
///
/// In: for each pose of the arm the flange in the base, and the board as the camera saw it.
///
/// # Errors
/// `Library` or `NoAnswer`, for instance when all rotations are alike.
pub fn hand_eye_park(
    base_from_flange: &[Isometry3<f64>],
    camera_from_board: &[Isometry3<f64>],
) -> Result<Isometry3<f64>, CvError> {
    const WHAT: &str = "find where the camera sits on the flange";
    let failed = |source| CvError::Library { what: WHAT, source };
    let (flange_r, flange_t) = rotations_and_translations(base_from_flange).map_err(failed)?;
    let (board_r, board_t) = rotations_and_translations(camera_from_board).map_err(failed)?;
    let (mut rotation, mut translation) = (Mat::default(), Mat::default());
    calib3d::calibrate_hand_eye(
        &flange_r,
        &flange_t,
        &board_r,
        &board_t,
        &mut rotation,
        &mut translation,
        calib3d::HandEyeCalibrationMethod::CALIB_HAND_EYE_PARK,
    )
    .map_err(failed)?;
    isometry(&rotation, &translation, WHAT)
}

/// Camera matrix and distortion as OpenCV takes them.
fn lens(camera: &CameraModel, what: &'static str) -> Result<(Mat, Vector<f64>), CvError> {
    let rows = [[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]];
    let matrix = Mat::from_slice_2d(&rows).map_err(|source| CvError::Library { what, source })?;
    Ok((matrix, Vector::from_slice(&camera.distortion)))
}

fn points(found: &Vector<Point2d>, wanted: usize, what: &'static str) -> Result<Vec<[f64; 2]>, CvError> {
    let points: Vec<[f64; 2]> = found.iter().map(|p| [p.x, p.y]).collect();
    let usable = points.len() == wanted && points.iter().flatten().all(|value| value.is_finite());
    usable.then_some(points).ok_or(CvError::NoAnswer { what })
}

fn flat_poses(
    camera: &CameraModel,
    target_m: &[[f64; 2]],
    pixels: &[[f64; 2]],
    method: calib3d::SolvePnPMethod,
) -> Result<Vec<TargetPose>, CvError> {
    const WHAT: &str = "find the pose of a flat target";
    let failed = |source| CvError::Library { what: WHAT, source };
    if target_m.len() != pixels.len() || target_m.len() < 4 {
        return Err(CvError::NoAnswer { what: WHAT });
    }
    let object: Vector<Point3d> = target_m.iter().map(|p| Point3d::new(p[0], p[1], 0.0)).collect();
    let image: Vector<Point2d> = pixels.iter().map(|p| Point2d::new(p[0], p[1])).collect();
    let (matrix, distortion) = lens(camera, WHAT)?;
    let (mut rotations, mut translations) = (Vector::<Mat>::new(), Vector::<Mat>::new());
    calib3d::solve_pnp_generic(
        &object,
        &image,
        &matrix,
        &distortion,
        &mut rotations,
        &mut translations,
        false,
        method,
        &no_array(),
        &no_array(),
        &mut no_array(),
    )
    .map_err(failed)?;
    let target_points: Vec<[f64; 3]> = target_m.iter().map(|p| [p[0], p[1], 0.0]).collect();
    let mut poses = Vec::new();
    for (rotation, translation) in rotations.iter().zip(translations.iter()) {
        let (Ok(r), Ok(t)) = (vector3(&rotation), vector3(&translation)) else { continue };
        if !r.iter().chain(t.iter()).all(|value| value.is_finite()) || t.z <= 0.0 {
            continue;
        }
        let camera_from_target = Isometry3::new(t, r);
        let seen = project(camera, &camera_from_target, &target_points)?;
        poses.push(TargetPose { camera_from_target, reprojection_px: rms(&seen, pixels) });
    }
    poses.sort_by(|a, b| a.reprojection_px.total_cmp(&b.reprojection_px));
    if poses.is_empty() { Err(CvError::NoAnswer { what: WHAT }) } else { Ok(poses) }
}

/// Root mean square distance of corresponding points.
fn rms(a: &[[f64; 2]], b: &[[f64; 2]]) -> f64 {
    let sum: f64 = a.iter().zip(b).map(|(p, q)| (p[0] - q[0]).powi(2) + (p[1] - q[1]).powi(2)).sum();
    (sum / a.len().max(1) as f64).sqrt()
}

fn vector3(mat: &Mat) -> opencv::Result<Vector3<f64>> {
    let at = |i| if mat.rows() == 3 { mat.at_2d::<f64>(i, 0) } else { mat.at_2d::<f64>(0, i) };
    Ok(Vector3::new(*at(0)?, *at(1)?, *at(2)?))
}

fn rotations_and_translations(poses: &[Isometry3<f64>]) -> opencv::Result<(Vector<Mat>, Vector<Mat>)> {
    let (mut rotations, mut translations) = (Vector::new(), Vector::new());
    for pose in poses {
        let r = pose.rotation.to_rotation_matrix();
        let rows = [0, 1, 2].map(|i| [0, 1, 2].map(|j| r[(i, j)]));
        rotations.push(Mat::from_slice_2d(&rows)?);
        // A column: OpenCV 4.6 wants 3 x 1 here.
        translations.push(Mat::from_slice_2d(&[0, 1, 2].map(|i| [pose.translation.vector[i]]))?);
    }
    Ok((rotations, translations))
}

fn isometry(rotation: &Mat, translation: &Mat, what: &'static str) -> Result<Isometry3<f64>, CvError> {
    let mut matrix = Matrix3::zeros();
    for i in 0..3 {
        for j in 0..3 {
            let value = rotation.at_2d::<f64>(i, j).map_err(|source| CvError::Library { what, source })?;
            matrix[(i as usize, j as usize)] = *value;
        }
    }
    let t = vector3(translation).map_err(|source| CvError::Library { what, source })?;
    let proper = (matrix.determinant() - 1.0).abs() < 1e-3;
    if !proper || !t.iter().all(|value| value.is_finite()) {
        return Err(CvError::NoAnswer { what });
    }
    let rotation = Rotation3::from_matrix(&matrix);
    Ok(Isometry3::from_parts(Translation3::from(t), UnitQuaternion::from_rotation_matrix(&rotation)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;

    #[test]
    fn undistorting_undoes_projecting_over_the_whole_picture() {
        let camera = testing::camera(1280, 720);
        for (column, row) in (0..=12).flat_map(|i| (0..=7).map(move |j| (i, j))) {
            let pixel = [f64::from(column) * 106.0, f64::from(row) * 102.0];
            let [x, y] = undistort(&camera, &[pixel]).unwrap()[0];
            let back = project(&camera, &Isometry3::identity(), &[[x, y, 1.0]]).unwrap()[0];
            assert!((back[0] - pixel[0]).hypot(back[1] - pixel[1]) < 1e-4, "{pixel:?} {back:?}");
        }
        assert!(undistort(&camera, &[]).unwrap().is_empty());
    }

    #[test]
    fn opencv_agrees_with_the_forward_model_of_the_tests() {
        let camera = testing::camera(1280, 720);
        let pose = Isometry3::new(Vector3::new(0.02, -0.03, 0.5), Vector3::new(0.2, -0.3, 1.0));
        for point in [[0.0, 0.0, 0.0], [0.1, 0.05, 0.02], [-0.2, 0.1, -0.05]] {
            let ours = testing::project(&camera, &(pose * nalgebra::Point3::from(point)));
            let theirs = project(&camera, &pose, &[point]).unwrap()[0];
            assert!((ours[0] - theirs[0]).hypot(ours[1] - theirs[1]) < 1e-9);
        }
    }

    #[test]
    fn a_square_gives_its_pose_back() {
        let camera = testing::camera(1280, 720);
        let truth = Isometry3::new(Vector3::new(0.05, 0.02, 0.4), Vector3::new(2.8, 0.3, 0.2));
        let corners = marker::corners_m(0.03)
            .map(|[x, y]| testing::project(&camera, &(truth * nalgebra::Point3::new(x, y, 0.0))));
        let poses = square_poses(&camera, &corners, 0.03).unwrap();
        let best = poses[0].camera_from_target;
        assert!((best.translation.vector - truth.translation.vector).norm() < 1e-5);
        assert!(best.rotation.angle_to(&truth.rotation) < 1e-3);
        assert!(poses.len() == 2 && poses[1].reprojection_px > poses[0].reprojection_px);
    }

    #[test]
    fn park_finds_the_camera_on_the_flange_from_exact_poses() {
        let flange_from_camera =
            Isometry3::new(Vector3::new(0.01, -0.07, 0.03), Vector3::new(0.02, 0.01, 3.0));
        let base_from_board = Isometry3::new(Vector3::new(0.4, 0.1, 0.0), Vector3::new(0.0, 0.0, 0.3));
        let turns = [[0.0, 0.0, 0.0], [0.3, 0.0, 0.1], [0.0, 0.4, -0.2], [-0.3, 0.2, 0.5]];
        let flanges: Vec<_> = turns
            .iter()
            .map(|r| Isometry3::new(Vector3::new(0.4, r[0], 0.5), Vector3::new(3.0 + r[0], r[1], r[2])))
            .collect();
        let boards: Vec<_> =
            flanges.iter().map(|flange| (flange * flange_from_camera).inverse() * base_from_board).collect();
        let found = hand_eye_park(&flanges, &boards).unwrap();
        assert!((found.inverse() * flange_from_camera).translation.vector.norm() < 1e-9);
        assert!(found.rotation.angle_to(&flange_from_camera.rotation) < 1e-7);
    }

    #[test]
    fn points_on_one_line_or_too_few_are_an_error_not_a_pose() {
        let camera = testing::camera(640, 480);
        let few = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]];
        assert!(board_pose(&camera, &few, &few).is_err());
        let line = [[0.0, 0.0], [0.01, 0.0], [0.02, 0.0], [0.03, 0.0]];
        let pixels = [[100.0, 100.0], [120.0, 100.0], [140.0, 100.0], [160.0, 100.0]];
        assert!(board_pose(&camera, &line, &pixels).is_err(), "a line fixes no plane");
    }
}
