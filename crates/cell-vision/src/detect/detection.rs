//! A marker as it was read in a picture, and why there may be none.
//!
//! In: what the AprilTag library read. Out: [`Detection`] with its centre and edges, [`DetectError`]. Below
//! all files of `detect`, which share them. Pure.

use cell_values::image::MAX_EDGE;
use serde::{Deserialize, Serialize};

/// A marker seen in a picture.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Detection {
    /// The family's name.
    pub family: String,
    /// Number within the family.
    pub id: u32,
    /// Corners of the black square, pixels (column, row; (0, 0) is the centre of the first pixel), in the
    /// marker frame (x right, y up as one reads the print): (-,-), (+,-), (+,+), (-,+).
    pub corners: [[f64; 2]; 4],
    /// Mean contrast of the bits against the decision threshold, grey levels on the detector's tone curve.
    pub decision_margin: f64,
    /// Bits that had to be repaired.
    pub hamming: u8,
}

impl Detection {
    /// Where the marker's centre appears: the crossing of the diagonals, pixels.
    pub fn centre(&self) -> [f64; 2] {
        let [a, b, c, d] = self.corners;
        let (ac, bd) = ([c[0] - a[0], c[1] - a[1]], [d[0] - b[0], d[1] - b[1]]);
        let cross = ac[0] * bd[1] - ac[1] * bd[0];
        let along = ((b[0] - a[0]) * bd[1] - (b[1] - a[1]) * bd[0]) / cross;
        if along.is_finite() {
            return [a[0] + along * ac[0], a[1] + along * ac[1]];
        }
        [0, 1].map(|axis| self.corners.iter().map(|corner| corner[axis]).sum::<f64>() / 4.0)
    }

    /// Length of the shortest edge, pixels.
    pub fn edge_min_px(&self) -> f64 {
        let edge = |i: usize| {
            let (a, b) = (self.corners[i], self.corners[(i + 1) % 4]);
            (a[0] - b[0]).hypot(a[1] - b[1])
        };
        (0..4).map(edge).fold(f64::INFINITY, f64::min)
    }
}

/// Why there is no detector or no answer.
#[derive(Debug, thiserror::Error)]
pub enum DetectError {
    /// A setting is outside its range.
    #[error("detector setting {name} = {value} is outside {range}")]
    Setting {
        /// Which setting.
        name: &'static str,
        /// What it is.
        value: f64,
        /// What it may be.
        range: &'static str,
    },
    /// The library could not make what it needs (out of memory).
    #[error("the AprilTag library could not {what}")]
    Library {
        /// What was tried.
        what: &'static str,
        /// What the crate says.
        #[source]
        source: apriltag::Error,
    },
    /// The picture is smaller than any marker, larger than the library can address, or not as long as it
    /// says.
    #[error(
        "a {width} x {height} picture of {bytes} bytes cannot be searched (32 x 32 to {MAX_EDGE} x \
         {MAX_EDGE})"
    )]
    Picture {
        /// Pixels per row.
        width: u32,
        /// Rows.
        height: u32,
        /// Bytes of pixels.
        bytes: usize,
    },
}

/// By id, then by margin, best first.
pub(super) fn sort(found: &mut [Detection]) {
    found.sort_by(|a, b| a.id.cmp(&b.id).then(b.decision_margin.total_cmp(&a.decision_margin)));
}
