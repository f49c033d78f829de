//! The AprilTag C library: one detector of it, searching in the way that is wanted at the moment.
//!
//! In: families, a [`Way`], a picture on a grey curve. Out: what the library read, in our conventions: half
//! a pixel taken off every corner, because the library puts the centre of the first pixel at (0.5, 0.5).
//! One detector serves every way of searching: its tables of codes take up to 20 MB and a tenth of a second
//! to make.

use crate::detect::detection::{DetectError, Detection};
use crate::detect::family::Family;
use cell_values::image::{GrayImage, MAX_EDGE};
use std::ffi::c_int;
use std::ptr::NonNull;

/// How a picture is searched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Way {
    /// See `DetectSettings::decimate`.
    pub decimate: f32,
    /// Unsharp mask where positive, Gaussian blur where negative: standard deviation, pixels of the smaller
    /// picture.
    pub sharpen_px: f32,
    /// See `DetectSettings::tone`.
    pub tone: f32,
    /// See `DetectSettings::contrast_min`.
    pub contrast_min: u8,
    /// Squares with shorter edges need not be found, pixels; 0 for the library's own limit.
    pub edge_min_px: f64,
}

/// The library's own limit of an outline, points.
const OUTLINE_MIN: i32 = 5;

/// A detector of the library and its decoding tables.
#[derive(Debug)]
pub(super) struct Library {
    families: Vec<Family>,
    detector: apriltag::Detector,
    /// Of `detector`, which keeps it for as long as it lives.
    raw: NonNull<apriltag_sys::apriltag_detector_t>,
}

// SAFETY: the C detector is owned by this value alone (never cloned, its pointer never leaves this module),
// keeps no thread-local state between calls, and its worker threads end before `apriltag_detector_detect`
// returns.
#[allow(unsafe_code)]
unsafe impl Send for Library {}

#[allow(unsafe_code)]
unsafe extern "C" {
    fn workerpool_create(threads: c_int) -> *mut apriltag_sys::workerpool_t;
    fn workerpool_run(pool: *mut apriltag_sys::workerpool_t);
}

/// The library's pool of threads, all of which wait for work. It makes its own with the first picture and
/// hands tasks over without a lock: a thread that starts late reads them while they are moved, and the
/// process dies (with a small first picture, one time in eighty). A run without tasks ends once every thread
/// waits; a second one follows, because the first may count one twice that was starting just then.
#[allow(unsafe_code)]
fn resting_pool(threads: c_int) -> *mut apriltag_sys::workerpool_t {
    // SAFETY: the functions are the library's own, linked with it; the pool is a live one from the first of
    // them, and runs on this thread alone.
    unsafe {
        let pool = workerpool_create(threads);
        if !pool.is_null() {
            workerpool_run(pool);
            workerpool_run(pool);
        }
        pool
    }
}

impl Library {
    /// A detector of these families that repairs so many bits.
    ///
    /// # Errors
    /// `Library` for no family at all, and when there is no memory.
    #[allow(unsafe_code)]
    pub fn new(families: &[Family], bits_corrected: u8, threads: u8) -> Result<Library, DetectError> {
        let mut families = families.to_vec();
        families.sort_unstable();
        families.dedup();
        let mut builder = apriltag::Detector::builder();
        for family in &families {
            builder = builder.add_family_bits(family.library(), usize::from(bits_corrected));
        }
        let library =
            builder.build().map_err(|source| DetectError::Library { what: "make a detector", source })?;
        let raw = library.into_raw();
        // SAFETY: the pointer comes from `into_raw` the line before and has no other owner.
        let mut detector = unsafe { apriltag::Detector::from_raw(raw.as_ptr()) };
        detector.set_thread_number(threads);
        detector.set_refine_edges(true);
        if threads > 1 {
            // SAFETY: the detector is new and this thread's alone; it owns the pool from here on, finds it
            // as large as it wants it, and ends it with itself.
            unsafe { (*raw.as_ptr()).wp = resting_pool(c_int::from(threads)) };
        }
        Ok(Library { families, detector, raw })
    }

    /// Searches in this way from now on; the crate's own setter of thresholds takes an angle where the
    /// library wants its cosine.
    #[allow(unsafe_code)]
    pub fn search_in(&mut self, way: Way) {
        self.detector.set_decimation(way.decimate);
        // A negative blur is the library's word for sharpening.
        self.detector.set_sigma(-way.sharpen_px);
        // Outlines have about one point a pixel; four fifths, because the ends of a side are cut.
        let outline = 0.8 * 4.0 * way.edge_min_px / f64::from(way.decimate);
        // SAFETY: the pointer is the detector's own, alive for as long as `self.detector`, and no call of
        // the library is under way while `self` is borrowed for writing.
        unsafe {
            let thresholds = &mut (*self.raw.as_ptr()).qtp;
            thresholds.min_white_black_diff = i32::from(way.contrast_min);
            thresholds.min_cluster_pixels = (outline as i32).max(OUTLINE_MIN);
        }
    }

    /// Everything that the library reads.
    ///
    /// # Errors
    /// `Picture` if there is nothing to search, `Library` when the library has no memory.
    pub fn read(
        &mut self,
        picture: &GrayImage,
        curve: &[u8; 256],
    ) -> Result<Vec<(Detection, Family)>, DetectError> {
        let image = library_image(picture, curve)?;
        let found = self.detector.detect(&image).into_iter();
        Ok(found.filter_map(|found| convert(found, &self.families)).collect())
    }
}

/// The picture on the curve, in the library's own buffer, whose rows are padded.
fn library_image(picture: &GrayImage, curve: &[u8; 256]) -> Result<apriltag::Image, DetectError> {
    let (width, height) = (picture.width as usize, picture.height as usize);
    let edges = 32..=MAX_EDGE;
    let whole = picture.data.len() == width * height;
    if !whole || !edges.contains(&picture.width) || !edges.contains(&picture.height) {
        return Err(DetectError::Picture {
            width: picture.width,
            height: picture.height,
            bytes: picture.data.len(),
        });
    }
    let alignment = apriltag::image_buf::DEFAULT_ALIGNMENT_U8;
    let mut image = apriltag::Image::zeros_with_alignment(width, height, alignment)
        .map_err(|source| DetectError::Library { what: "hold the picture", source })?;
    let stride = image.stride();
    let rows = image.as_slice_mut().chunks_exact_mut(stride);
    for (row, pixels) in rows.zip(picture.data.chunks_exact(width)) {
        for (on_curve, &level) in row.iter_mut().zip(pixels) {
            *on_curve = curve[usize::from(level)];
        }
    }
    Ok(image)
}

/// The library's detection in our conventions: corner order stays, half a pixel comes off. `None` for a
/// family that was not requested, which cannot be.
#[allow(unsafe_code)]
fn convert(found: apriltag::Detection, families: &[Family]) -> Option<(Detection, Family)> {
    let mut detection = Detection {
        family: String::new(),
        id: u32::try_from(found.id()).unwrap_or(u32::MAX),
        corners: found.corners().map(|[x, y]| [x - 0.5, y - 0.5]),
        decision_margin: f64::from(found.decision_margin()),
        hamming: u8::try_from(found.hamming()).unwrap_or(u8::MAX),
    };
    let raw = found.into_raw().as_ptr();
    // SAFETY: the detection is owned here until `from_raw` takes it back and frees it; its family lives as
    // long as the detector, and the family's name is a string constant of the library.
    let name = unsafe {
        let name = std::ffi::CStr::from_ptr((*(*raw).family).name).to_str().ok().and_then(|n| n.parse().ok());
        drop(apriltag::Detection::from_raw(raw));
        name
    };
    let family = families.iter().copied().find(|family| Some(*family) == name)?;
    family.name().clone_into(&mut detection.family);
    Some((detection, family))
}
