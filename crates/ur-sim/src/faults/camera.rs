//! What is wrong with the camera at this moment, as one value.
//!
//! In: the faults in force. Out: [`CameraFaults`], which the world keeps for the scene and the camera server
//! reads at every exposure.

use crate::faults::{CameraFault, ExtraPrint};
use crate::render::sensor::Exposure;
use nalgebra::Isometry3;

/// Everything that is wrong with the camera.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraFaults {
    /// It does not answer.
    pub off: bool,
    /// It sends the same frame again.
    pub frozen: bool,
    /// It sends the same picture as a new frame.
    pub repeats: bool,
    /// Light, fog and blur.
    pub exposure: Exposure,
    /// Camera where it was mounted from camera where it is.
    pub shift: Isometry3<f64>,
    /// Numbers of half covered markers.
    pub covered: Vec<u32>,
    /// Further prints.
    pub prints: Vec<ExtraPrint>,
}

impl Default for CameraFaults {
    fn default() -> CameraFaults {
        CameraFaults {
            off: false,
            frozen: false,
            repeats: false,
            exposure: Exposure::default(),
            shift: Isometry3::identity(),
            covered: Vec::new(),
            prints: Vec::new(),
        }
    }
}

impl CameraFaults {
    /// All of `faults` at once: gains multiply, blurs and shifts add up, the densest fog counts.
    pub fn of<'a>(faults: impl Iterator<Item = &'a CameraFault>) -> CameraFaults {
        CameraFaults::at(faults.map(|fault| (fault, 0.0)))
    }

    /// As [`CameraFaults::of`], each with the time it has been in force, s.
    pub fn at<'a>(faults: impl Iterator<Item = (&'a CameraFault, f64)>) -> CameraFaults {
        let mut all = CameraFaults::default();
        for (fault, age_s) in faults {
            match fault {
                CameraFault::Off => all.off = true,
                CameraFault::Freeze => all.frozen = true,
                CameraFault::Repeat => all.repeats = true,
                CameraFault::Gain(gain) => all.exposure.gain *= *gain as f32,
                CameraFault::Blur(sigma_px) => all.exposure.blur_px = all.exposure.blur_px.hypot(*sigma_px),
                CameraFault::Fog(share) => all.exposure.fog = all.exposure.fog.max(*share as f32),
                CameraFault::Occlude(marker) => all.covered.push(*marker),
                CameraFault::Print(print) => all.prints.push(*print),
                CameraFault::Extrinsics(shift) => all.shift *= shift,
                CameraFault::Drift { translation, rotation } => {
                    let minutes = age_s / 60.0;
                    all.shift *= Isometry3::new(translation * minutes, rotation * minutes);
                }
            }
        }
        all
    }
}
