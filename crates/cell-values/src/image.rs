//! Pictures in memory: colour for people and recordings, grey for the detector, PNG and JPEG bytes in and
//! out.
//!
//! In: rows of pixels, or the bytes of an image file. Out: [`Image`], [`GrayImage`], PNG bytes; depth
//! pictures are in `depth`. Pure: bytes come as arguments, no file is touched. The simulator draws with the
//! marker family's patterns (`tag36h11`), which therefore lie here and not beside the detector.

pub mod depth;
pub mod quality;
pub mod tag36h11;

pub use tag36h11::tag36h11_bitmap;

use std::io::Cursor;

/// Longest edge of a picture accepted from outside, pixels: more is a broken header, not a camera.
pub const MAX_EDGE: u32 = 16_384;

/// A colour picture, 8 bits per channel, rows from the top, no padding.
#[derive(Clone, PartialEq, Eq)]
pub struct Image {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `3 * width * height` bytes: red, green, blue.
    pub rgb: Vec<u8>,
}

/// A grey picture, 8 bits, rows from the top, no padding.
#[derive(Clone, PartialEq, Eq)]
pub struct GrayImage {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width * height` bytes.
    pub data: Vec<u8>,
}

/// Why bytes are not a picture we can use.
#[derive(Debug, thiserror::Error)]
pub enum ImageError {
    /// Not an image, cut short, or of a kind that is not PNG or JPEG.
    #[error("the {bytes} bytes are not a readable PNG or JPEG picture; take the picture again")]
    Decode {
        /// How many bytes there were.
        bytes: usize,
        /// What the decoder says.
        #[source]
        source: image::ImageError,
    },
    /// The pixel buffer has not the length that width and height require.
    #[error("a {width} x {height} picture needs {needed} bytes, there are {found}")]
    Length {
        /// Pixels per row.
        width: u32,
        /// Rows.
        height: u32,
        /// Bytes that width and height require.
        needed: usize,
        /// Bytes there are.
        found: usize,
    },
    /// No pixels, or more than any camera has.
    #[error("a {width} x {height} picture is outside 1 x 1 to {MAX_EDGE} x {MAX_EDGE}")]
    Size {
        /// Pixels per row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// A picture, but not one of depths.
    #[error(
        "a picture with pixels of kind {found} is no depth picture: a PNG file with 16 bits of grey is wanted"
    )]
    NotDepth {
        /// The kind of its pixels.
        found: String,
    },
    /// The picture could not be written as PNG.
    #[error("the picture could not be encoded as PNG")]
    Encode(#[source] image::ImageError),
}

impl Image {
    /// A picture of one colour.
    ///
    /// The size must be within [`MAX_EDGE`]; larger ones come out empty of meaning but never panic.
    pub fn filled(width: u32, height: u32, colour: [u8; 3]) -> Image {
        let pixels = width as usize * height as usize;
        Image { width, height, rgb: colour.iter().copied().cycle().take(3 * pixels).collect() }
    }

    /// A picture from its rows of red, green and blue bytes.
    ///
    /// # Errors
    /// `Size` for no or absurdly many pixels, `Length` if the buffer does not fit the size.
    pub fn from_rgb(width: u32, height: u32, rgb: Vec<u8>) -> Result<Image, ImageError> {
        check_size(width, height)?;
        check_length(width, height, 3, rgb.len())?;
        Ok(Image { width, height, rgb })
    }

    /// The picture in the bytes of a PNG or JPEG file.
    ///
    /// # Errors
    /// `Decode` for anything that is not a whole picture of these kinds, `Size` for absurd dimensions.
    pub fn decode(bytes: &[u8]) -> Result<Image, ImageError> {
        let picture = Image::decode_any(bytes)?.into_rgb8();
        Image::from_rgb(picture.width(), picture.height(), picture.into_raw())
    }

    /// The picture in whatever kind of pixels the file has.
    fn decode_any(bytes: &[u8]) -> Result<image::DynamicImage, ImageError> {
        let failed = |source| ImageError::Decode { bytes: bytes.len(), source };
        let mut reader = image::ImageReader::new(Cursor::new(bytes))
            .with_guessed_format()
            .map_err(|error| failed(image::ImageError::IoError(error)))?;
        let mut limits = image::Limits::default();
        limits.max_image_width = Some(MAX_EDGE);
        limits.max_image_height = Some(MAX_EDGE);
        limits.max_alloc = Some(256 << 20);
        reader.limits(limits);
        reader.decode().map_err(failed)
    }

    /// The picture as the bytes of a PNG file.
    ///
    /// # Errors
    /// `Length` if the pixel buffer does not fit the size, `Encode` if the encoder refuses.
    pub fn encode_png(&self) -> Result<Vec<u8>, ImageError> {
        check_length(self.width, self.height, 3, self.rgb.len())?;
        encode_png(&self.rgb, self.width, self.height, image::ExtendedColorType::Rgb8)
    }

    /// Colour at column `x`, row `y`; `None` outside.
    pub fn pixel(&self, x: u32, y: u32) -> Option<[u8; 3]> {
        let start = self.offset(x, y)?;
        self.rgb.get(start..start + 3)?.try_into().ok()
    }

    /// Sets the colour at column `x`, row `y`; outside the picture nothing happens.
    pub fn set_pixel(&mut self, x: u32, y: u32, colour: [u8; 3]) {
        let Some(start) = self.offset(x, y) else { return };
        if let Some(pixel) = self.rgb.get_mut(start..start + 3) {
            pixel.copy_from_slice(&colour);
        }
    }

    fn offset(&self, x: u32, y: u32) -> Option<usize> {
        (x < self.width && y < self.height).then(|| 3 * (y as usize * self.width as usize + x as usize))
    }

    /// The grey picture, luma of ITU-R BT.601 (the weights OpenCV and JPEG use).
    pub fn gray(&self) -> GrayImage {
        let luma = |p: &[u8]| {
            let sum = 299 * u32::from(p[0]) + 587 * u32::from(p[1]) + 114 * u32::from(p[2]);
            ((sum + 500) / 1000) as u8
        };
        GrayImage {
            width: self.width,
            height: self.height,
            data: self.rgb.chunks_exact(3).map(luma).collect(),
        }
    }
}

impl GrayImage {
    /// A picture from its rows of grey bytes.
    ///
    /// # Errors
    /// As [`Image::from_rgb`].
    pub fn from_data(width: u32, height: u32, data: Vec<u8>) -> Result<GrayImage, ImageError> {
        check_size(width, height)?;
        check_length(width, height, 1, data.len())?;
        Ok(GrayImage { width, height, data })
    }

    /// The same picture with three equal channels.
    pub fn to_image(&self) -> Image {
        let rgb = self.data.iter().flat_map(|&grey| [grey; 3]).collect();
        Image { width: self.width, height: self.height, rgb }
    }

    /// The picture as the bytes of a PNG file.
    ///
    /// # Errors
    /// As [`Image::encode_png`].
    pub fn encode_png(&self) -> Result<Vec<u8>, ImageError> {
        check_length(self.width, self.height, 1, self.data.len())?;
        encode_png(&self.data, self.width, self.height, image::ExtendedColorType::L8)
    }
}

impl std::fmt::Debug for Image {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Image({} x {})", self.width, self.height)
    }
}

impl std::fmt::Debug for GrayImage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "GrayImage({} x {})", self.width, self.height)
    }
}

fn check_size(width: u32, height: u32) -> Result<(), ImageError> {
    let fine = 1..=MAX_EDGE;
    if fine.contains(&width) && fine.contains(&height) {
        Ok(())
    } else {
        Err(ImageError::Size { width, height })
    }
}

fn check_length(width: u32, height: u32, channels: usize, found: usize) -> Result<(), ImageError> {
    let needed = width as usize * height as usize * channels;
    if needed == found { Ok(()) } else { Err(ImageError::Length { width, height, needed, found }) }
}

fn encode_png(
    data: &[u8],
    width: u32,
    height: u32,
    colour: image::ExtendedColorType,
) -> Result<Vec<u8>, ImageError> {
    use image::ImageEncoder;
    use image::codecs::png::{CompressionType, FilterType, PngEncoder};
    let mut bytes = Vec::new();
    // Fast: a noisy camera picture hardly shrinks further, and encoding is in the way of the next look.
    let encoder =
        PngEncoder::new_with_quality(Cursor::new(&mut bytes), CompressionType::Fast, FilterType::Sub);
    encoder.write_image(data, width, height, colour).map_err(ImageError::Encode)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn png_goes_there_and_back() {
        let rgb = (0..3 * 7 * 5).map(|i| (i * 37 % 251) as u8).collect();
        let picture = Image::from_rgb(7, 5, rgb).unwrap();
        assert_eq!(Image::decode(&picture.encode_png().unwrap()).unwrap(), picture);
        assert_eq!(Image::decode(&picture.gray().encode_png().unwrap()).unwrap().gray(), picture.gray());
    }

    #[test]
    fn broken_bytes_are_errors() {
        let bytes = Image::filled(40, 30, [200, 10, 90]).encode_png().unwrap();
        assert!(matches!(Image::decode(&bytes[..bytes.len() / 2]), Err(ImageError::Decode { .. })));
        assert!(matches!(Image::decode(b""), Err(ImageError::Decode { bytes: 0, .. })));
        assert!(matches!(Image::decode(b"hello"), Err(ImageError::Decode { .. })));
        assert!(matches!(Image::from_rgb(2, 2, vec![0; 11]), Err(ImageError::Length { needed: 12, .. })));
        assert!(matches!(GrayImage::from_data(0, 2, vec![]), Err(ImageError::Size { .. })));
    }

    #[test]
    fn luma_weighs_the_channels() {
        let grey = |colour| Image::filled(1, 1, colour).gray().data[0];
        assert_eq!(
            [grey([255; 3]), grey([255, 0, 0]), grey([0, 255, 0]), grey([0, 0, 255])],
            [255, 76, 150, 29]
        );
    }

    #[test]
    fn pixels_outside_are_left_alone() {
        let mut picture = Image::filled(3, 2, [0; 3]);
        picture.set_pixel(2, 1, [1, 2, 3]);
        picture.set_pixel(3, 0, [9; 3]);
        assert_eq!(picture.pixel(2, 1), Some([1, 2, 3]));
        assert_eq!(picture.pixel(3, 0), None);
        assert!(!picture.rgb.contains(&9));
    }
}
