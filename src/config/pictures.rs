//! Pictures and lenses from files, for the commands that look at them.
//!
//! In: paths. Out: an image, its bytes, a camera model; or a sentence that names the file.

use cell_calibration::files::camera::CameraCalibration;
use cell_edge::files;
use cell_values::image::Image;
use cell_vision::camera::CameraModel;
use rearrange::document::chain::chain;
use std::path::Path;

/// Largest picture file read, bytes.
const PICTURE_MAX: u64 = 256 << 20;

/// The picture in a file.
///
/// # Errors
/// Why it cannot be had, with the file's name.
pub fn read_picture(path: &Path) -> Result<Image, String> {
    Image::decode(&read_bytes(path)?).map_err(|error| format!("{}: {}", path.display(), chain(&error)))
}

/// What is in a picture's file.
///
/// # Errors
/// Why it cannot be had, with the file's name.
pub fn read_bytes(path: &Path) -> Result<Vec<u8>, String> {
    files::read_bytes(path, PICTURE_MAX).map_err(|error| chain(&error))
}

/// The lens that a calibration file says a camera has.
///
/// # Errors
/// Everything that is wrong with the file.
pub fn read_camera(path: &Path) -> Result<CameraModel, String> {
    let (text, _) = files::read_regular(path, 1 << 20).map_err(|error| chain(&error))?;
    let calibration = CameraCalibration::parse(&text, &path.display().to_string());
    calibration.map(|calibration| calibration.model).map_err(|complaints| complaints.to_string())
}
