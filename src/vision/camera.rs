//! The lens as numbers: focal lengths, principal point, distortion, and the picture size they hold for.
//!
//! In: values from the camera's factory or from a calibration. Out: a checked [`CameraModel`]. Pure data; projecting and
//! undistorting with it is `cv`'s job. Pixel (0, 0) is the centre of the first pixel; the camera frame is
//! optical (x right, y down, z forward). Distortion is Brown-Conrady as OpenCV orders it: k1, k2, p1, p2, k3.

use nalgebra::Matrix3;
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
        "the picture is {picture_width} x {picture_height} but camera {serial:?} is calibrated for {width} x {height}; \
         set the stream to that size or calibrate at this one"
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
}

impl CameraModel {
    /// Checks that the numbers can belong to a camera.
    ///
    /// # Errors
    /// `NotFinite` or `Implausible` with the first field at fault: focal length within 0.2 to 20 picture
    /// widths, principal point inside the picture, picture edges within 16 to 16384 pixels, distortion below 100.
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

    /// Mean focal length, pixels: metres across the view times this over the distance is pixels.
    pub fn focal(&self) -> f64 {
        0.5 * (self.fx + self.fy)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
    fn another_picture_size_is_refused() {
        assert!(d405().check_picture(1280, 720).is_ok());
        assert!(d405().check_picture(640, 480).unwrap_err().to_string().contains("640 x 480"));
    }
}
