//! Whether a picture can be measured in: light, glare, contrast, focus.
//!
//! In: a grey picture and limits. Out: four numbers and, where one is beyond its limit, the fault by name.
//! Pure. The numbers do not depend on what the table carries: light is that of the brightest hundredth, and
//! focus is read from the steepest edges, which markers have wherever they lie.

use crate::image::GrayImage;

/// Grey levels from which a pixel counts as saturated.
const SATURATED: usize = 250;
/// Distances over which grey levels are compared, pixels: across an edge that is in focus, and across any
/// edge.
const NEAR: usize = 2;
const FAR: usize = 16;
/// Share of all differences that belong to the steepest edges.
const STEEPEST: f64 = 1e-3;

/// How light, glare, contrast and focus of a picture measure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PictureQuality {
    /// Grey level that the brightest hundredth of the picture reaches, 0 to 255.
    pub light: u8,
    /// Share of saturated pixels, 0 to 1.
    pub glare: f64,
    /// Difference of grey levels across the strongest edges, 0 to 255.
    pub contrast: u8,
    /// Width of the steepest edges, pixels, in the direction in which they are wider; about 3 in focus.
    pub edge_px: f64,
}

/// What a picture must keep to be measured in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PictureLimits {
    /// Least light.
    pub light_min: u8,
    /// Most glare.
    pub glare_max: f64,
    /// Least contrast.
    pub contrast_min: u8,
    /// Widest edges, pixels.
    pub edge_px_max: f64,
}

impl PictureLimits {
    /// Far outside what a usable picture shows and well inside what a useless one does (docs/cameras.md):
    /// not measured on a cell, hence limits of trouble and not of accuracy.
    pub const STANDARD: PictureLimits =
        PictureLimits { light_min: 50, glare_max: 0.25, contrast_min: 30, edge_px_max: 6.0 };
}

/// Why a picture cannot be measured in.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum PictureFault {
    /// Too little light.
    #[error("the picture is dark: its brightest parts have grey level {light} of 255, {limit} are needed")]
    Dark {
        /// Found.
        light: u8,
        /// Needed.
        limit: u8,
    },
    /// Too much.
    #[error("the picture is overexposed: {:.0} % of it are saturated, at most {:.0} % may be", glare * 100.0, limit * 100.0)]
    Overexposed {
        /// Found.
        glare: f64,
        /// Allowed.
        limit: f64,
    },
    /// Nothing is distinct.
    #[error(
        "the picture shows nothing: its strongest edges differ by {contrast} grey levels, {limit} are needed"
    )]
    Flat {
        /// Found.
        contrast: u8,
        /// Needed.
        limit: u8,
    },
    /// Out of focus or moved.
    #[error(
        "the picture is blurred: its sharpest edges are {edge_px:.1} pixels wide, {limit:.1} are allowed"
    )]
    Blurred {
        /// Found.
        edge_px: f64,
        /// Allowed.
        limit: f64,
    },
}

/// Measures a picture; a few milliseconds for 1280 x 720.
pub fn measure(picture: &GrayImage) -> PictureQuality {
    let mut levels = [0usize; 256];
    picture.data.iter().for_each(|&level| levels[usize::from(level)] += 1);
    let pixels = picture.data.len().max(1) as f64;
    let saturated: usize = levels[SATURATED..].iter().sum();
    // Rows and columns apart: a picture that was moved is blurred in one direction alone.
    let across = [Direction::Rows, Direction::Columns].map(|direction| edges(picture, direction));
    let width = |&[near, far]: &[u8; 2]| NEAR as f64 * f64::from(far) / f64::from(near.max(1));
    PictureQuality {
        light: level_reached(&levels, 0.01),
        glare: saturated as f64 / pixels,
        contrast: across.iter().map(|[_, far]| *far).max().unwrap_or(0),
        edge_px: across.iter().map(width).fold(0.0, f64::max),
    }
}

/// Compares with the limits; the first of light, glare, contrast and focus that is beyond its own.
///
/// # Errors
/// The fault.
pub fn judge(quality: &PictureQuality, limits: &PictureLimits) -> Result<(), PictureFault> {
    let PictureQuality { light, glare, contrast, edge_px } = *quality;
    if light < limits.light_min {
        return Err(PictureFault::Dark { light, limit: limits.light_min });
    }
    if glare > limits.glare_max {
        return Err(PictureFault::Overexposed { glare, limit: limits.glare_max });
    }
    if contrast < limits.contrast_min {
        return Err(PictureFault::Flat { contrast, limit: limits.contrast_min });
    }
    if edge_px > limits.edge_px_max {
        return Err(PictureFault::Blurred { edge_px, limit: limits.edge_px_max });
    }
    Ok(())
}

#[derive(Clone, Copy)]
enum Direction {
    Rows,
    Columns,
}

/// Differences that the steepest edges reach over [`NEAR`] and over [`FAR`] pixels; zero in a picture too
/// small for it.
fn edges(picture: &GrayImage, direction: Direction) -> [u8; 2] {
    let width = picture.width as usize;
    let (length, stride) = match direction {
        Direction::Rows => (width, 1),
        Direction::Columns => (picture.height as usize, width),
    };
    if length <= FAR {
        return [0; 2];
    }
    [NEAR, FAR].map(|distance| {
        let mut histogram = [0usize; 256];
        let ahead = distance * stride;
        let mut count = |here: &[u8], there: &[u8]| {
            here.iter().zip(there).for_each(|(a, b)| histogram[usize::from(a.abs_diff(*b))] += 1);
        };
        match direction {
            Direction::Rows => {
                for row in picture.data.chunks_exact(width) {
                    count(row, row.get(ahead..).unwrap_or_default());
                }
            }
            Direction::Columns => count(&picture.data, picture.data.get(ahead..).unwrap_or_default()),
        }
        level_reached(&histogram, STEEPEST)
    })
}

/// The level that the top `share` of a histogram reaches.
fn level_reached(histogram: &[usize; 256], share: f64) -> u8 {
    let total: usize = histogram.iter().sum();
    let wanted = ((total as f64 * share) as usize).max(1);
    let mut above = 0;
    for (level, count) in histogram.iter().enumerate().rev() {
        above += count;
        if above >= wanted {
            return level as u8;
        }
    }
    0
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Dark squares of 40 pixels on light ground, turned, with edges of this standard deviation, and some
    /// noise.
    fn squares(sigma_px: f64, light: f64, dark: f64) -> GrayImage {
        // A blurred step is the normal distribution's sum; this stays within 0.02 of it.
        let step = |distance: f64| 1.0 / (1.0 + (-1.702 * distance / sigma_px).exp());
        let (sin, cos) = 0.4f64.sin_cos();
        let mut noise = 7u32;
        let data = (0..240 * 320).map(|i| {
            let (x, y) = (f64::from(i % 320), f64::from(i / 320));
            let [u, v] =
                [cos * x + sin * y, cos * y - sin * x].map(|t| 20.0 - (t.rem_euclid(80.0) - 40.0).abs());
            noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let grain = f64::from(noise >> 24) / 255.0 * 8.0 - 4.0;
            (light + (dark - light) * step(u) * step(v) + grain).clamp(0.0, 255.0) as u8
        });
        GrayImage::from_data(320, 240, data.collect()).unwrap()
    }

    fn fault(picture: &GrayImage) -> Option<PictureFault> {
        judge(&measure(picture), &PictureLimits::STANDARD).err()
    }

    #[test]
    fn a_good_picture_passes_however_much_of_it_is_empty() {
        assert_eq!(fault(&squares(0.8, 220.0, 30.0)), None);
        assert_eq!(fault(&squares(1.5, 150.0, 60.0)), None);
        let mut empty = GrayImage::from_data(1280, 720, vec![90; 1280 * 720]).unwrap();
        let one = squares(0.8, 200.0, 30.0);
        for (row, line) in one.data.chunks_exact(320).enumerate() {
            empty.data[(200 + row) * 1280 + 300..][..320].copy_from_slice(line);
        }
        let begun = std::time::Instant::now();
        assert_eq!(fault(&empty), None);
        println!("1280 x 720 pixels judged in {:?}", begun.elapsed());
    }

    #[test]
    fn each_fault_has_its_name() {
        assert!(matches!(fault(&squares(0.8, 22.0, 3.0)), Some(PictureFault::Dark { .. })));
        assert!(matches!(fault(&squares(0.8, 400.0, 30.0)), Some(PictureFault::Overexposed { .. })));
        assert!(matches!(fault(&squares(0.8, 130.0, 115.0)), Some(PictureFault::Flat { .. })));
        assert!(matches!(fault(&squares(5.0, 220.0, 30.0)), Some(PictureFault::Blurred { .. })));
    }

    #[test]
    fn a_picture_moved_in_one_direction_is_blurred() {
        let still = squares(0.8, 220.0, 30.0);
        let mut moved = still.clone();
        for (row, line) in still.data.chunks_exact(320).enumerate() {
            for column in 0..320usize {
                let trail = &line[column.saturating_sub(12)..=column];
                let sum: u32 = trail.iter().map(|&level| u32::from(level)).sum();
                moved.data[row * 320 + column] = (sum / trail.len() as u32) as u8;
            }
        }
        assert!(matches!(fault(&moved), Some(PictureFault::Blurred { .. })), "{:?}", measure(&moved));
    }

    #[test]
    fn the_smallest_picture_is_measured_without_panic() {
        for size in [(1, 1), (17, 1), (1, 17), (16, 16)] {
            let picture =
                GrayImage::from_data(size.0, size.1, vec![200; (size.0 * size.1) as usize]).unwrap();
            assert!(matches!(fault(&picture), Some(PictureFault::Flat { .. })));
        }
    }
}
