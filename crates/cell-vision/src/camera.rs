//! The lens as numbers: focal lengths, principal point, distortion, and the picture size they hold for.
//!
//! In: values from the camera's factory or from a calibration. Out: a checked [`CameraModel`]. Pure data;
//! projecting and undistorting with it is `cv`'s job. Pixel (0, 0) is the centre of the first pixel; the
//! camera frame is optical (x right, y down, z forward). Distortion is Brown-Conrady as OpenCV orders it:
//! k1, k2, p1, p2, k3. Factories write it in other forms too; [`FactoryLens::model`] brings those into this
//! one, or refuses.

use nalgebra::{Matrix3, SMatrix, SVector};
use serde::{Deserialize, Serialize};

/// A calibrated camera. Nothing here has a default: every number is measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraModel {
    /// The camera's serial number; a calibration of another camera is refused by it.
    pub serial: String,
    /// Pixels per row these numbers hold for.
    pub width: u32,
    /// Rows these numbers hold for.
    pub height: u32,
    /// Focal length along x, pixels.
    pub fx: f64,
    /// Focal length along y, pixels.
    pub fy: f64,
    /// Principal point, column, pixels.
    pub cx: f64,
    /// Principal point, row, pixels.
    pub cy: f64,
    /// k1, k2, p1, p2, k3 (dimensionless, on normalised coordinates).
    pub distortion: [f64; 5],
}

/// Why numbers cannot be a camera's.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CameraModelError {
    /// A number is NaN or infinite.
    #[error("camera {serial:?}: {field} is not a finite number")]
    NotFinite {
        /// Whose numbers.
        serial: String,
        /// Which number.
        field: &'static str,
    },
    /// A number is outside what a camera can have.
    #[error("camera {serial:?}: {field} = {value} {reason}")]
    Implausible {
        /// Whose numbers.
        serial: String,
        /// Which number.
        field: &'static str,
        /// What it is.
        value: f64,
        /// Why it cannot be.
        reason: &'static str,
    },
    /// The picture has another size than the calibration.
    #[error(
        "the picture is {picture_width} x {picture_height} but camera {serial:?} is calibrated for {width} x \
         {height}; set the stream to that size or calibrate at this one"
    )]
    OtherSize {
        /// Whose calibration.
        serial: String,
        /// Calibrated pixels per row.
        width: u32,
        /// Calibrated rows.
        height: u32,
        /// Pixels per row of the picture.
        picture_width: u32,
        /// Rows of the picture.
        picture_height: u32,
    },
    /// The factory's distortion cannot be written as Brown-Conrady.
    #[error(
        "camera {serial:?}: the factory's distortion ({form}) differs from Brown-Conrady by {miss_px:.2} \
         pixels at worst; measure the lens with `celld calibrate camera` instead"
    )]
    Distortion {
        /// Whose numbers.
        serial: String,
        /// The factory's form.
        form: &'static str,
        /// Worst difference within the picture, pixels.
        miss_px: f64,
    },
}

/// Worst difference that bringing a factory's distortion into our form may make, pixels: half of what
/// corners are found to.
const FACTORY_MISS_PX: f64 = 0.05;

/// How a factory writes down a lens.
#[derive(Clone, Debug, PartialEq)]
pub struct FactoryLens {
    /// Everything but the distortion, which is ignored here.
    pub pinhole: CameraModel,
    /// The form of the coefficients.
    pub form: FactoryDistortion,
    /// k1, k2, p1, p2, k3 in that form.
    pub coefficients: [f64; 5],
}

/// What a factory's distortion coefficients mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FactoryDistortion {
    /// The picture is rectified.
    None,
    /// As ours.
    BrownConrady,
    /// As ours, but for the tangential part, which is that of the point that was moved radially already. The
    /// SDK of the RealSense cameras projects with this for the models that it calls modified and, despite
    /// the name, inverse Brown-Conrady (D405, D415, D455): the coefficients distort, they do not undistort.
    TangentialAfterRadial,
    /// A fisheye lens.
    Fisheye,
}

impl FactoryLens {
    /// The lens in our form, checked.
    ///
    /// # Errors
    /// `Distortion` where the nearest Brown-Conrady lens differs by more than 0.05 pixels anywhere in the
    /// picture, and those of [`CameraModel::check`].
    pub fn model(&self) -> Result<CameraModel, CameraModelError> {
        let straight = CameraModel { distortion: [0.0; 5], ..self.pinhole.clone() };
        straight.check()?;
        let serial = straight.serial.clone();
        let distortion = match self.form {
            FactoryDistortion::None => [0.0; 5],
            FactoryDistortion::BrownConrady => self.coefficients,
            FactoryDistortion::TangentialAfterRadial => self.nearest()?,
            FactoryDistortion::Fisheye if self.coefficients == [0.0; 5] => [0.0; 5],
            FactoryDistortion::Fisheye => {
                return Err(CameraModelError::Distortion { serial, form: "fisheye", miss_px: f64::INFINITY });
            }
        };
        let model = CameraModel { distortion, ..straight };
        model.check()?;
        Ok(model)
    }

    /// The coefficients of ours that come nearest, by least squares over the picture.
    fn nearest(&self) -> Result<[f64; 5], CameraModelError> {
        let CameraModel { width, height, fx, fy, cx, cy, .. } = self.pinhole;
        let (mut normal, mut right) = (SMatrix::<f64, 5, 5>::zeros(), SVector::<f64, 5>::zeros());
        let mut points = Vec::new();
        for row in 0..=16 {
            for column in 0..=16 {
                let x = (f64::from(width) * f64::from(column) / 16.0 - cx) / fx;
                let y = (f64::from(height) * f64::from(row) / 16.0 - cy) / fy;
                let moved = tangential_after_radial([x, y], &self.coefficients);
                for (terms, shift) in brown_conrady_terms(x, y).into_iter().zip([moved[0] - x, moved[1] - y])
                {
                    let terms = SVector::<f64, 5>::from(terms);
                    normal += terms * terms.transpose();
                    right += terms * shift;
                    points.push((terms, shift));
                }
            }
        }
        let found = normal.cholesky().map(|solver| solver.solve(&right));
        let miss = |found: &SVector<f64, 5>| {
            points.iter().map(|(terms, shift)| (terms.dot(found) - shift).abs()).fold(0.0, f64::max)
                * fx.max(fy)
        };
        let miss_px = found.as_ref().map_or(f64::NAN, miss);
        match found {
            Some(found) if miss_px <= FACTORY_MISS_PX => Ok(found.into()),
            _ => {
                let (serial, form) = (self.pinhole.serial.clone(), "tangential after radial");
                Err(CameraModelError::Distortion { serial, form, miss_px })
            }
        }
    }
}

/// Where the factory's form moves a normalised point.
fn tangential_after_radial([x, y]: [f64; 2], [k1, k2, p1, p2, k3]: &[f64; 5]) -> [f64; 2] {
    let r2 = x * x + y * y;
    let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
    let (x, y) = (x * radial, y * radial);
    [x + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x), y + 2.0 * p2 * x * y + p1 * (r2 + 2.0 * y * y)]
}

/// What each of k1, k2, p1, p2, k3 adds to x and to y, per unit, in our form.
fn brown_conrady_terms(x: f64, y: f64) -> [[f64; 5]; 2] {
    let r2 = x * x + y * y;
    [
        [x * r2, x * r2 * r2, 2.0 * x * y, r2 + 2.0 * x * x, x * r2 * r2 * r2],
        [y * r2, y * r2 * r2, r2 + 2.0 * y * y, 2.0 * x * y, y * r2 * r2 * r2],
    ]
}

/// For each coefficient what it adds to x and to y.
fn transposed([x, y]: [[f64; 5]; 2]) -> impl Iterator<Item = [f64; 2]> {
    x.into_iter().zip(y).map(|(x, y)| [x, y])
}

impl CameraModel {
    /// Checks that the numbers can belong to a camera.
    ///
    /// # Errors
    /// `NotFinite` or `Implausible` with the first field at fault: focal length within 0.2 to 20 picture
    /// widths, principal point inside the picture, picture edges within 16 to 16384 pixels, distortion below
    /// 100.
    pub fn check(&self) -> Result<(), CameraModelError> {
        let (width, height) = (f64::from(self.width), f64::from(self.height));
        let bounds = [
            ("width", width, 16.0, 16384.0, "is outside 16 to 16384 pixels"),
            ("height", height, 16.0, 16384.0, "is outside 16 to 16384 pixels"),
            ("fx", self.fx, 0.2 * width, 20.0 * width, "is outside 0.2 to 20 picture widths"),
            ("fy", self.fy, 0.2 * width, 20.0 * width, "is outside 0.2 to 20 picture widths"),
            ("cx", self.cx, 0.0, width, "is outside the picture"),
            ("cy", self.cy, 0.0, height, "is outside the picture"),
            ("k1", self.distortion[0], -100.0, 100.0, "is outside -100 to 100"),
            ("k2", self.distortion[1], -100.0, 100.0, "is outside -100 to 100"),
            ("p1", self.distortion[2], -100.0, 100.0, "is outside -100 to 100"),
            ("p2", self.distortion[3], -100.0, 100.0, "is outside -100 to 100"),
            ("k3", self.distortion[4], -100.0, 100.0, "is outside -100 to 100"),
        ];
        for (field, value, low, high, reason) in bounds {
            let serial = self.serial.clone();
            if !value.is_finite() {
                return Err(CameraModelError::NotFinite { serial, field });
            }
            if !(low..=high).contains(&value) {
                return Err(CameraModelError::Implausible { serial, field, value, reason });
            }
        }
        Ok(())
    }

    /// Checks that a picture of this size is one these numbers hold for.
    ///
    /// # Errors
    /// `OtherSize` with both sizes.
    pub fn check_picture(&self, width: u32, height: u32) -> Result<(), CameraModelError> {
        if (width, height) == (self.width, self.height) {
            return Ok(());
        }
        Err(CameraModelError::OtherSize {
            serial: self.serial.clone(),
            width: self.width,
            height: self.height,
            picture_width: width,
            picture_height: height,
        })
    }

    /// The matrix that takes normalised camera coordinates to pixels.
    pub fn matrix(&self) -> Matrix3<f64> {
        Matrix3::new(self.fx, 0.0, self.cx, 0.0, self.fy, self.cy, 0.0, 0.0, 1.0)
    }

    /// The pixel at which a point in the camera frame (m) shows, if that is in the picture; `None` also
    /// where the distortion says nothing, far outside of it.
    pub fn pixel(&self, [x, y, z]: [f64; 3]) -> Option<[f64; 2]> {
        if z <= 0.0 {
            return None;
        }
        let (x, y) = (x / z, y / z);
        let (width, height) = (f64::from(self.width), f64::from(self.height));
        let near = |value: f64, focal: f64, length: f64| (value * focal).abs() < length;
        if !near(x, self.fx, width) || !near(y, self.fy, height) {
            return None;
        }
        let mut moved = [x, y];
        for (weight, terms) in self.distortion.iter().zip(transposed(brown_conrady_terms(x, y))) {
            moved[0] += weight * terms[0];
            moved[1] += weight * terms[1];
        }
        let [u, v] = [self.fx * moved[0] + self.cx, self.fy * moved[1] + self.cy];
        let inside = (-0.5..=width - 0.5).contains(&u) && (-0.5..=height - 0.5).contains(&v);
        inside.then_some([u, v])
    }

    /// Mean focal length, pixels: metres across the view times this over the distance is pixels.
    pub fn focal(&self) -> f64 {
        0.5 * (self.fx + self.fy)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_shows_where_opencv_projects_it_and_nowhere_outside_of_the_picture() {
        let camera = crate::testing::camera(1280, 720);
        let mut shown = 0;
        for k in 0..400 {
            let (x, y) = (f64::from(k % 20) / 8.0 - 1.2, f64::from(k / 20) / 14.0 - 0.7);
            let point = [0.5 * x, 0.5 * y, 0.5];
            let there = crate::cv::project(&camera, &nalgebra::Isometry3::identity(), &[point]).unwrap()[0];
            let inside = (0.0..1279.0).contains(&there[0]) && (0.0..719.0).contains(&there[1]);
            match camera.pixel(point) {
                Some(pixel) => {
                    shown += 1;
                    let off = (pixel[0] - there[0]).hypot(pixel[1] - there[1]);
                    assert!(off < 1e-6, "{point:?}: {pixel:?}, OpenCV: {there:?}");
                }
                None => assert!(!inside, "{point:?} is at {there:?}"),
            }
        }
        assert!(shown > 100, "{shown}");
        assert_eq!(camera.pixel([0.0, 0.0, -0.5]), None);
    }

    fn d405() -> CameraModel {
        CameraModel {
            serial: "123".into(),
            width: 1280,
            height: 720,
            fx: 650.0,
            fy: 651.0,
            cx: 639.0,
            cy: 359.0,
            distortion: [-0.05, 0.06, 1e-4, -2e-4, -0.02],
        }
    }

    #[test]
    fn numbers_that_no_camera_has_are_refused_by_name() {
        assert_eq!(d405().check(), Ok(()));
        let broken = |change: fn(&mut CameraModel)| {
            let mut camera = d405();
            change(&mut camera);
            camera.check().unwrap_err().to_string()
        };
        assert!(broken(|c| c.fy = f64::NAN).contains("fy is not a finite"));
        assert!(broken(|c| c.fx = 0.65).contains("fx = 0.65"));
        assert!(broken(|c| c.cx = 1300.0).contains("cx = 1300"));
        assert!(broken(|c| c.distortion[4] = f64::INFINITY).contains("k3"));
        assert!(broken(|c| c.width = 0).contains("width"));
    }

    #[test]
    fn a_factory_s_distortion_is_brought_into_our_form_or_refused() {
        let coefficients = [-0.0553, 0.0596, 3e-4, -4e-4, -0.0193];
        let of = |form, coefficients| FactoryLens { pinhole: d405(), form, coefficients }.model();
        assert_eq!(of(FactoryDistortion::None, coefficients).unwrap().distortion, [0.0; 5]);
        assert_eq!(of(FactoryDistortion::BrownConrady, coefficients).unwrap().distortion, coefficients);
        let found = of(FactoryDistortion::TangentialAfterRadial, coefficients).unwrap().distortion;
        // At a corner and at an edge of the picture, by OpenCV's formula against the factory's.
        for [x, y] in [[-0.98, -0.55], [0.98, 0.0], [0.3, 0.5]] {
            let ours =
                brown_conrady_terms(x, y).map(|t| t.iter().zip(found).map(|(t, k)| t * k).sum::<f64>());
            let theirs = tangential_after_radial([x, y], &coefficients);
            let miss = (x + ours[0] - theirs[0]).hypot(y + ours[1] - theirs[1]) * 650.0;
            assert!(miss < 0.05, "{miss} px at {x} {y}");
        }
        assert!(found != coefficients && (found[0] - coefficients[0]).abs() < 1e-3, "{found:?}");
        let skewed = of(FactoryDistortion::TangentialAfterRadial, [-0.5, 0.3, 0.05, 0.0, 0.0]);
        assert!(skewed.unwrap_err().to_string().contains("calibrate camera"));
        assert!(of(FactoryDistortion::Fisheye, coefficients).is_err());
        assert!(of(FactoryDistortion::BrownConrady, [f64::NAN; 5]).is_err());
    }

    #[test]
    fn another_picture_size_is_refused() {
        assert!(d405().check_picture(1280, 720).is_ok());
        assert!(d405().check_picture(640, 480).unwrap_err().to_string().contains("640 x 480"));
    }
}
