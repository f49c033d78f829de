//! From OpenCV's pictures to ours.
//!
//! In: a matrix as OpenCV's readers give it. Out: an [`Image`], or why the matrix is none, as an error that
//! needs nothing of OpenCV's, so that celld's errors are the same without it.

use crate::io::camera::CameraError;
use cell_values::image::Image;
use opencv::core::{Mat, MatTraitConst, MatTraitConstManual};
use std::path::Path;

/// A video or camera file that OpenCV does not read.
pub(super) fn video_error(path: &Path, what: &'static str, source: Option<opencv::Error>) -> CameraError {
    CameraError::Video { path: path.to_owned(), what, source: source.map(Into::into) }
}

/// OpenCV's blue, green, red in our order.
///
/// # Errors
/// What OpenCV says, or nothing if it is no whole picture of 8 bit colours.
pub(super) fn image_of(mat: &Mat) -> Result<Image, Option<opencv::Error>> {
    if mat.typ() != opencv::core::CV_8UC3 || !mat.is_continuous() {
        return Err(None);
    }
    let bytes = mat.data_bytes().map_err(Some)?;
    let rgb = bytes.chunks_exact(3).flat_map(|p| [p[2], p[1], p[0]]).collect();
    let (width, height) = (u32::try_from(mat.cols()), u32::try_from(mat.rows()));
    match (width, height) {
        (Ok(width), Ok(height)) => Image::from_rgb(width, height, rgb).map_err(|_| None),
        _ => Err(None),
    }
}
