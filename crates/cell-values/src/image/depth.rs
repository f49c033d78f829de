//! A depth picture: how far away what each pixel shows is, along the optical axis.
//!
//! In: metres row by row, or the 16-bit units that depth cameras and PNG files hold. Out: [`DepthImage`],
//! aligned to the colour picture of the same moment, pixel by pixel. A pixel at which nothing was measured
//! (a hole) reads as `None`; 0, NaN, infinities and negative numbers all mean that, so that no source has to
//! agree with another on which. Pure.

use crate::image::{Image, ImageError, check_length, check_size};
use std::io::Cursor;

/// What one unit of a 16-bit depth picture is unless its source says otherwise, m: 0.1 mm, as the D405 has
/// it.
pub const UNIT_M: f64 = 1e-4;

/// Depth along the optical axis, m, rows from the top, no padding; 0 or NaN where nothing was measured.
#[derive(Clone, PartialEq)]
pub struct DepthImage {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width * height` depths, m.
    pub metres: Vec<f32>,
}

impl DepthImage {
    /// A depth picture from its rows of metres.
    ///
    /// # Errors
    /// As [`Image::from_rgb`].
    pub fn from_metres(width: u32, height: u32, metres: Vec<f32>) -> Result<DepthImage, ImageError> {
        check_size(width, height)?;
        check_length(width, height, 1, metres.len())?;
        Ok(DepthImage { width, height, metres })
    }

    /// A depth picture from its rows of units of `unit_m` metres; 0 is a hole.
    ///
    /// # Errors
    /// As [`Image::from_rgb`].
    pub fn from_units(width: u32, height: u32, units: &[u16], unit_m: f64) -> Result<DepthImage, ImageError> {
        let metres = units.iter().map(|&unit| (f64::from(unit) * unit_m) as f32).collect();
        DepthImage::from_metres(width, height, metres)
    }

    /// The depth picture in the bytes of a 16-bit grey PNG file with units of `unit_m`.
    ///
    /// # Errors
    /// `NotDepth` for a picture of another kind (a colour picture given by mistake), `Decode` and `Size` as
    /// [`Image::decode`].
    pub fn decode(bytes: &[u8], unit_m: f64) -> Result<DepthImage, ImageError> {
        let picture = Image::decode_any(bytes)?;
        let (width, height) = (picture.width(), picture.height());
        match picture {
            image::DynamicImage::ImageLuma16(grey) => {
                DepthImage::from_units(width, height, grey.as_raw(), unit_m)
            }
            other => Err(ImageError::NotDepth { found: format!("{:?}", other.color()) }),
        }
    }

    /// The picture as the bytes of a 16-bit grey PNG file with units of `unit_m`; what does not fit becomes
    /// a hole.
    ///
    /// # Errors
    /// As [`Image::encode_png`].
    pub fn encode_png(&self, unit_m: f64) -> Result<Vec<u8>, ImageError> {
        use image::ImageEncoder;
        check_length(self.width, self.height, 1, self.metres.len())?;
        let unit = |metres: &f32| {
            let units = (f64::from(*metres) / unit_m).round();
            if (0.0..=f64::from(u16::MAX)).contains(&units) { units as u16 } else { 0 }
        };
        let raw: Vec<u8> = self.metres.iter().flat_map(|metres| unit(metres).to_ne_bytes()).collect();
        let mut bytes = Vec::new();
        image::codecs::png::PngEncoder::new(Cursor::new(&mut bytes))
            .write_image(&raw, self.width, self.height, image::ExtendedColorType::L16)
            .map_err(ImageError::Encode)?;
        Ok(bytes)
    }

    /// Depth at column `x`, row `y`, m; `None` in a hole and outside the picture.
    pub fn at(&self, x: u32, y: u32) -> Option<f64> {
        if x >= self.width || y >= self.height {
            return None;
        }
        let metres = *self.metres.get(y as usize * self.width as usize + x as usize)?;
        (metres.is_finite() && metres > 0.0).then_some(f64::from(metres))
    }

    /// Share of the pixels at which something was measured, 0 to 1.
    pub fn measured_share(&self) -> f64 {
        let measured = self.metres.iter().filter(|metres| metres.is_finite() && **metres > 0.0).count();
        measured as f64 / self.metres.len().max(1) as f64
    }
}

impl std::fmt::Debug for DepthImage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "DepthImage({} x {})", self.width, self.height)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn holes_are_holes_however_they_are_written() {
        let metres = vec![0.3, 0.0, f32::NAN, f32::INFINITY, -0.1, 0.5];
        let depth = DepthImage::from_metres(3, 2, metres).unwrap();
        let at = |x, y| depth.at(x, y).map(|metres| (metres * 1e3).round());
        assert_eq!([at(0, 0), at(1, 0), at(2, 0)], [Some(300.0), None, None]);
        assert_eq!([at(0, 1), at(1, 1), at(2, 1), at(3, 0), at(0, 2)], [None, None, Some(500.0), None, None]);
        assert!((depth.measured_share() - 2.0 / 6.0).abs() < 1e-12);
    }

    #[test]
    fn a_file_keeps_a_tenth_of_a_millimetre() {
        let depth = DepthImage::from_units(2, 2, &[0, 1, 4217, u16::MAX], UNIT_M).unwrap();
        let back = DepthImage::decode(&depth.encode_png(UNIT_M).unwrap(), UNIT_M).unwrap();
        assert_eq!(back, depth);
        let far = DepthImage::from_metres(1, 1, vec![9.0]).unwrap();
        let back = DepthImage::decode(&far.encode_png(UNIT_M).unwrap(), UNIT_M).unwrap();
        assert_eq!(back.at(0, 0), None, "beyond the units' range is not measured");
    }

    #[test]
    fn a_colour_picture_is_no_depth_picture() {
        let colour = Image::filled(4, 4, [9; 3]).encode_png().unwrap();
        let error = DepthImage::decode(&colour, UNIT_M).unwrap_err();
        assert!(matches!(error, ImageError::NotDepth { .. }), "{error}");
        assert!(matches!(DepthImage::decode(b"hello", UNIT_M), Err(ImageError::Decode { .. })));
        assert!(matches!(
            DepthImage::from_metres(2, 2, vec![1.0; 3]),
            Err(ImageError::Length { needed: 4, found: 3, .. })
        ));
    }
}
