//! The AprilTag library as it comes: what a benchmark compares ours with.
//!
//! In: a picture, how much smaller it is searched. Out: everything the library reads with its own default
//! thresholds, two repaired bits, no curve over the grey levels and no filter after it; its own corners, in
//! our conventions.

use crate::detect::detection::{DetectError, Detection};
use crate::detect::family::Family;
use crate::detect::library::{Library, Way};
use cell_values::image::GrayImage;

/// Bits that the library repairs unless it is set otherwise.
const BITS_CORRECTED: u8 = 2;
/// Its threshold of contrast, grey levels.
const CONTRAST_MIN: u8 = 5;

/// The plain library.
#[derive(Debug)]
pub struct PlainLibrary {
    library: Library,
}

impl PlainLibrary {
    /// With its defaults but for the decimation, on one thread.
    ///
    /// # Errors
    /// `Library` for no family at all, and when there is no memory.
    pub fn new(families: &[Family], decimate: f32) -> Result<PlainLibrary, DetectError> {
        let mut library = Library::new(families, BITS_CORRECTED, 1)?;
        let (sharpen_px, tone, edge_min_px) = (0.0, 1.0, 0.0);
        library.search_in(Way { decimate, sharpen_px, tone, contrast_min: CONTRAST_MIN, edge_min_px });
        Ok(PlainLibrary { library })
    }

    /// Everything that it reads.
    ///
    /// # Errors
    /// `Picture` if there is nothing to search, `Library` when the library has no memory.
    pub fn detect(&mut self, picture: &GrayImage) -> Result<Vec<Detection>, DetectError> {
        let as_it_is = std::array::from_fn(|level| level as u8);
        let read = self.library.read(picture, &as_it_is)?;
        Ok(read.into_iter().map(|(detection, _)| detection).collect())
    }
}
