//! Focal lengths, principal point and distortion of a camera, from pictures of a board.
//!
//! In: the board's corners in each picture, the picture's size. Out: [`LensSolution`] with the error of
//! every picture, or the sentence that says what is missing. OpenCV fits (`cv::calibrate_lens`); choosing
//! the pictures, the refusals and the honest errors are ours: pictures that disagree with all others are
//! left out, every fifth is predicted by a fit that has not seen it. Pure.

use cell_vision::camera::CameraModel;
use cell_vision::cv::{self, BoardCorners, CvError, LensFit};

/// One picture of the board.
#[derive(Clone, Debug)]
pub struct BoardView {
    /// The picture's name, for the report.
    pub name: String,
    /// The board's corners on the board (m) and in the picture (pixels).
    pub corners: BoardCorners,
}

/// What is required of the pictures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LensSettings {
    /// Fewest pictures that show the board.
    pub views_min: usize,
    /// Fewest corners for a picture to count.
    pub corners_min: usize,
    /// Pictures with an error above this many times the median are left out, at most a quarter of them.
    pub outlier_ratio: f64,
    /// Largest standard deviation of a focal length, as a share of it.
    pub focal_std_max: f64,
    /// Largest standard deviation of the principal point, pixels.
    pub centre_std_max_px: f64,
}

impl Default for LensSettings {
    fn default() -> LensSettings {
        LensSettings {
            views_min: 10,
            corners_min: 24,
            outlier_ratio: 3.0,
            focal_std_max: 1e-3,
            centre_std_max_px: 1.0,
        }
    }
}

/// How well one picture fits.
#[derive(Clone, Debug, PartialEq)]
pub struct LensSample {
    /// Its name.
    pub name: String,
    /// Corners of the board in it.
    pub corners: usize,
    /// Root mean square corner error, pixels.
    pub residual_px: f64,
    /// The same with a lens that was fitted without it; `None` where that was not tried.
    pub held_out_px: Option<f64>,
    /// Left out of the fit.
    pub rejected: bool,
}

/// The lens and everything that says how good it is.
#[derive(Clone, Debug, PartialEq)]
pub struct LensSolution {
    /// The numbers; the serial is the caller's to fill in.
    pub camera: CameraModel,
    /// Root mean square corner error of the pictures used, pixels.
    pub reprojection_px: f64,
    /// The same of pictures predicted without having been used, pixels.
    pub held_out_px: f64,
    /// Standard deviations of fx, fy, cx, cy, pixels.
    pub std_px: [f64; 4],
    /// One entry for each picture that shows the board.
    pub samples: Vec<LensSample>,
}

/// Why there is no lens.
#[derive(Debug, thiserror::Error)]
pub enum LensError {
    /// Too few pictures show the board.
    #[error(
        "only {found} of {given} pictures show {corners} or more corners of the board, {wanted} are needed: \
         check the board's family, ids and size (--family, --board, --first-id), the light, and that the \
         pictures are sharp"
    )]
    TooFewViews {
        /// Pictures that do.
        found: usize,
        /// Pictures given.
        given: usize,
        /// Corners required of each.
        corners: usize,
        /// Pictures needed.
        wanted: usize,
    },
    /// A part of the picture was never covered: the distortion there would be a guess.
    #[error("no picture shows the board in the {part} of the picture: take two or three more with it there")]
    Uncovered {
        /// Which part.
        part: &'static str,
    },
    /// The pictures leave a number undetermined.
    #[error(
        "{what} is only known to {std:.2} px (limit {limit:.2} px): tilt the board by 20 to 40 degrees about \
         both of its axes in half of the pictures, and fill the picture with it"
    )]
    NotObservable {
        /// Which number.
        what: &'static str,
        /// Its standard deviation, pixels.
        std: f64,
        /// The limit, pixels.
        limit: f64,
    },
    /// The fit does not come near the data.
    #[error(
        "the best fit misses the corners by {reprojection_px:.1} px: blurred pictures, a bent board, another \
         board than the one named, or pictures of several cameras"
    )]
    NoFit {
        /// Root mean square corner error, pixels.
        reprojection_px: f64,
    },
    /// Not even a start can be found, which is what pictures of a board that is never tilted bring about.
    #[error(
        "the pictures fix no focal length: tilt the board by 20 to 40 degrees about both of its axes in half \
         of them, and see that --board, --size-mm and --first-id are those of the print"
    )]
    Undetermined {
        /// What the solver said.
        source: CvError,
    },
    /// OpenCV failed.
    #[error("the lens could not be fitted")]
    Cv(#[from] CvError),
}

/// A fit worse than this is no fit, pixels.
const NO_FIT_PX: f64 = 1.5;
/// Every so many pictures one is held out.
const HELD_OUT_EVERY: usize = 5;
/// Parts of the picture that have to be covered, by rows.
const PARTS: [&str; 9] = [
    "upper left",
    "upper middle",
    "upper right",
    "middle left",
    "middle",
    "middle right",
    "lower left",
    "lower middle",
    "lower right",
];

/// Fits the lens.
///
/// # Errors
/// `TooFewViews`, `Undetermined`, `Uncovered`, `NotObservable`, `NoFit`, `Cv`.
pub fn solve_lens(
    views: &[BoardView],
    width: u32,
    height: u32,
    settings: &LensSettings,
) -> Result<LensSolution, LensError> {
    let usable: Vec<&BoardView> =
        views.iter().filter(|view| view.corners.0.len() >= settings.corners_min).collect();
    let wanted = settings.views_min.max(4);
    let corners = settings.corners_min;
    if usable.len() < wanted {
        return Err(LensError::TooFewViews { found: usable.len(), given: views.len(), corners, wanted });
    }
    let all = fit(&usable, width, height, &|_| true).map_err(|source| LensError::Undetermined { source })?;
    let rejected = outliers(&all.by_view_px, settings.outlier_ratio);
    let kept = |i: usize| !rejected[i];
    covered(&usable, &rejected, width, height)?;
    let best = fit(&usable, width, height, &kept)?;
    if best.reprojection_px > NO_FIT_PX {
        return Err(LensError::NoFit { reprojection_px: best.reprojection_px });
    }
    observable(&best, settings)?;
    let held = |i: usize| i % HELD_OUT_EVERY == HELD_OUT_EVERY / 2;
    let without = fit(&usable, width, height, &|i| kept(i) && !held(i))?;
    let mut samples = Vec::with_capacity(usable.len());
    for (i, view) in usable.iter().enumerate() {
        samples.push(LensSample {
            name: view.name.clone(),
            corners: view.corners.0.len(),
            residual_px: miss(&best.camera, view)?,
            held_out_px: if held(i) { Some(miss(&without.camera, view)?) } else { None },
            rejected: rejected[i],
        });
    }
    let reported = samples.iter().filter(|sample| !sample.rejected).filter_map(|sample| sample.held_out_px);
    let squares: Vec<f64> = reported.map(|px| px * px).collect();
    let held_out_px = (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt();
    let LensFit { camera, reprojection_px, std_px, .. } = best;
    Ok(LensSolution { camera, reprojection_px, held_out_px, std_px, samples })
}

/// The lens from those views that `take` takes.
fn fit(
    views: &[&BoardView],
    width: u32,
    height: u32,
    take: &dyn Fn(usize) -> bool,
) -> Result<LensFit, CvError> {
    let taken = views.iter().enumerate().filter(|(i, _)| take(*i));
    let corners: Vec<BoardCorners> = taken.map(|(_, view)| view.corners.clone()).collect();
    cv::calibrate_lens(width, height, &corners)
}

/// Root mean square corner error of a picture whose board may be anywhere, pixels.
fn miss(camera: &CameraModel, view: &BoardView) -> Result<f64, CvError> {
    Ok(cv::board_pose(camera, &view.corners.0, &view.corners.1)?.reprojection_px)
}

fn outliers(by_view_px: &[f64], ratio: f64) -> Vec<bool> {
    let mut sorted = by_view_px.to_vec();
    sorted.sort_by(f64::total_cmp);
    let median = sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
    // No more than a quarter: beyond that it is not the picture that is wrong.
    let quarter = sorted.len() - 1 - (sorted.len() - 1) / 4;
    let limit = (ratio * median).max(sorted.get(quarter).copied().unwrap_or(0.0));
    by_view_px.iter().map(|px| *px > limit).collect()
}

fn covered(views: &[&BoardView], rejected: &[bool], width: u32, height: u32) -> Result<(), LensError> {
    let kept = views.iter().zip(rejected).filter(|(_, rejected)| !**rejected).map(|(view, _)| *view);
    match uncovered(kept, width, height).first() {
        Some(part) => Err(LensError::Uncovered { part }),
        None => Ok(()),
    }
}

/// Ninths of the picture in which no view shows a corner of the board, by name, from the upper left.
pub fn uncovered<'a>(
    views: impl Iterator<Item = &'a BoardView>,
    width: u32,
    height: u32,
) -> Vec<&'static str> {
    let mut seen = [false; 9];
    let third = |value: f64, size: u32| ((3.0 * value / f64::from(size.max(1))) as usize).min(2);
    for [x, y] in views.flat_map(|view| &view.corners.1) {
        seen[3 * third(*y, height) + third(*x, width)] = true;
    }
    PARTS.into_iter().zip(seen).filter(|(_, seen)| !seen).map(|(part, _)| part).collect()
}

fn observable(fit: &LensFit, settings: &LensSettings) -> Result<(), LensError> {
    let [fx, fy, cx, cy] = fit.std_px;
    let focal = settings.focal_std_max * fit.camera.focal();
    let centre = settings.centre_std_max_px;
    let checks = [
        ("the focal length along x", fx, focal),
        ("the focal length along y", fy, focal),
        ("the principal point's column", cx, centre),
        ("the principal point's row", cy, centre),
    ];
    match checks.into_iter().find(|(_, std, limit)| std > limit) {
        Some((what, std, limit)) => Err(LensError::NotObservable { what, std, limit }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cell_vision::board::Board;
    use cell_vision::detect::Family;
    use cell_vision::testing;
    use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// The board held before the camera, tilted by up to `tilt` about both axes.
    fn view(camera: &CameraModel, tilt: f64, noise_px: f64, random: &mut ChaCha8Rng) -> BoardView {
        let board = Board::new(Family::Tag36h11, 7, 5, 0.03, 0);
        let mut within = |reach: f64| random.random_range(-reach..=reach);
        let turn =
            UnitQuaternion::from_euler_angles(std::f64::consts::PI + within(tilt), within(tilt), within(3.1));
        let at = Translation3::new(within(0.25), within(0.13), 0.36 + within(0.08));
        let [wide, high] = board.extent_m();
        let pose = Isometry3::from_parts(at, turn) * Translation3::new(-wide / 2.0, -high / 2.0, 0.0);
        let (mut on_board, mut in_picture) = (Vec::new(), Vec::new());
        for corner in board.markers().filter_map(|(id, _)| board.corners(id)).flatten() {
            let [x, y] = testing::project(camera, &(pose * Point3::new(corner[0], corner[1], 0.0)));
            if (0.0..1280.0).contains(&x) && (0.0..720.0).contains(&y) {
                on_board.push(corner);
                in_picture
                    .push([x + noise_px * testing::normal(random), y + noise_px * testing::normal(random)]);
            }
        }
        BoardView { name: "picture".into(), corners: (on_board, in_picture) }
    }

    fn views(tilt: f64, noise_px: f64, count: usize) -> (CameraModel, Vec<BoardView>) {
        let camera = testing::camera(1280, 720);
        let mut random = ChaCha8Rng::seed_from_u64(11);
        let views = (0..count).map(|_| view(&camera, tilt, noise_px, &mut random)).collect();
        (camera, views)
    }

    fn solve(views: &[BoardView]) -> Result<LensSolution, LensError> {
        solve_lens(views, 1280, 720, &LensSettings::default())
    }

    #[test]
    fn the_lens_comes_back_and_a_spoilt_picture_is_left_out() {
        let (camera, mut views) = views(0.6, 0.1, 24);
        for corner in &mut views[4].corners.1[..20] {
            corner[0] += 3.0;
        }
        let found = solve(&views).unwrap();
        assert!(
            (found.camera.fx / camera.fx - 1.0).abs() < 2e-3
                && (found.camera.fy / camera.fy - 1.0).abs() < 2e-3
        );
        assert!((found.camera.cx - camera.cx).abs() < 1.0 && (found.camera.cy - camera.cy).abs() < 1.0);
        assert!(found.reprojection_px < 0.2 && found.held_out_px < 0.2 && found.held_out_px > 0.05);
        let rejected: Vec<usize> = (0..24).filter(|&i| found.samples[i].rejected).collect();
        assert!(rejected.contains(&4) && rejected.len() <= 6, "{rejected:?}");
        // Its true errors are within three of its own standard deviations.
        let off = [found.camera.fx - camera.fx, found.camera.fy - camera.fy, found.camera.cx - camera.cx];
        assert!(
            off.iter().zip(&found.std_px).all(|(off, std)| off.abs() < 4.0 * std),
            "{off:?} {:?}",
            found.std_px
        );
    }

    #[test]
    fn boards_that_are_never_tilted_are_refused() {
        let (_, views) = views(0.0, 0.2, 20);
        let reported = solve(&views).unwrap_err().to_string();
        assert!(reported.contains("tilt the board"), "{reported}");
    }

    #[test]
    fn missing_pictures_and_parts_are_named() {
        let (_, mut views) = views(0.6, 0.1, 24);
        let reported = solve(&views[..5]).unwrap_err().to_string();
        assert!(reported.contains("only 5 of 5 pictures") && reported.contains("--board"), "{reported}");
        assert!(solve(&[]).unwrap_err().to_string().contains("only 0 of 0"));
        for view in &mut views {
            let (board, seen) = &view.corners;
            let left = board.iter().zip(seen).filter(|(_, p)| p[0] < 850.0).map(|(b, p)| (*b, *p));
            view.corners = left.unzip();
        }
        let reported = solve(&views).unwrap_err().to_string();
        assert!(reported.contains("right of the picture"), "{reported}");
        let scrambled: Vec<BoardView> = views
            .iter()
            .map(|view| {
                let mut view = view.clone();
                view.corners.1.reverse();
                view
            })
            .collect();
        assert!(solve(&scrambled).is_err());
    }
}
