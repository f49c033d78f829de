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

use std::borrow::Cow;
use std::io::Cursor;

/// Longest edge of a picture accepted from outside, pixels: more is a broken header, not a camera.
pub const MAX_EDGE: u32 = 16_384;

/// Bytes of a decoded picture at most: 32 million pixels of three.
const MAX_DECODED_BYTES: u64 = 96 << 20;

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

/// The first bytes of every PNG file, and of a chunk: length and kind before its data, a checksum behind.
const PNG: &[u8] = b"\x89PNG\r\n\x1a\n";
const CHUNK: usize = 12;

/// The bytes of a PNG file without what is no pixel: colour profiles and texts are packed, and a few of
/// their bytes may unpack to hundreds of megabytes before the size of the picture is looked at. Other
/// bytes, and a file that is cut short, come back as they are: the decoder has its word for them.
fn pixels_alone(bytes: &[u8]) -> Cow<'_, [u8]> {
    let Some(mut rest) = bytes.strip_prefix(PNG) else { return Cow::Borrowed(bytes) };
    let mut kept = PNG.to_vec();
    while let Some([a, b, c, d, kind @ ..]) = rest.first_chunk::<8>() {
        let length = u32::from_be_bytes([*a, *b, *c, *d]) as usize;
        let Some((chunk, next)) = length.checked_add(CHUNK).and_then(|end| rest.split_at_checked(end)) else {
            break;
        };
        // Chunks without which there is no picture have a capital letter first.
        if kind[0].is_ascii_uppercase() {
            kept.extend_from_slice(chunk);
        }
        rest = next;
    }
    kept.extend_from_slice(rest);
    Cow::Owned(kept)
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
        let pixels = pixels_alone(bytes);
        let mut reader = image::ImageReader::new(Cursor::new(&*pixels))
            .with_guessed_format()
            .map_err(|error| failed(image::ImageError::IoError(error)))?;
        let mut limits = image::Limits::default();
        limits.max_image_width = Some(MAX_EDGE);
        limits.max_image_height = Some(MAX_EDGE);
        limits.max_alloc = Some(MAX_DECODED_BYTES);
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

    /// The picture as the bytes of a JPEG file of this quality, 1 to 100.
    ///
    /// # Errors
    /// As [`Image::encode_png`].
    pub fn encode_jpeg(&self, quality: u8) -> Result<Vec<u8>, ImageError> {
        check_length(self.width, self.height, 3, self.rgb.len())?;
        let mut bytes = Vec::new();
        let mut encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, quality);
        encoder
            .encode(&self.rgb, self.width, self.height, image::ExtendedColorType::Rgb8)
            .map_err(ImageError::Encode)?;
        Ok(bytes)
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
    fn what_is_packed_into_a_png_besides_its_pixels_is_not_unpacked() {
        let picture = Image::filled(40, 30, [200, 10, 90]);
        let plain = picture.encode_png().unwrap();
        let chunk = |kind: &[u8; 4], data: &[u8]| {
            let length = u32::try_from(data.len()).unwrap().to_be_bytes();
            [&length, kind.as_slice(), data, &[0; 4]].concat()
        };
        // Behind the header, whose chunk has 13 bytes.
        let (head, tail) = plain.split_at(PNG.len() + CHUNK + 13);
        let extras = [chunk(b"iCCP", b"profile\0\0packed"), chunk(b"zTXt", &[7; 300])].concat();
        let with_extras = [head, &extras, tail].concat();
        assert_eq!(&*pixels_alone(&with_extras), plain.as_slice());
        assert_eq!(Image::decode(&with_extras).unwrap(), picture);
        // A length that leads nowhere, and a file that is cut, are the decoder's.
        for cut in [&with_extras[..head.len() + 20], &[PNG, &[0xff; 40]].concat()] {
            assert_eq!(&*pixels_alone(cut), cut);
            assert!(Image::decode(cut).is_err());
        }
    }

    /// The checksum of a PNG chunk.
    fn checksum(bytes: &[u8]) -> u32 {
        let step = |sum: u32| if sum & 1 == 1 { (sum >> 1) ^ 0xedb8_8320 } else { sum >> 1 };
        !bytes.iter().fold(!0, |sum, byte| (0..8).fold(sum ^ u32::from(*byte), |sum, _| step(sum)))
    }

    #[test]
    fn a_picture_larger_than_any_camera_s_is_refused_by_its_size() {
        let mut bytes = Image::filled(4, 4, [0; 3]).encode_png().unwrap();
        let header = PNG.len() + 4..PNG.len() + 4 + 4 + 13;
        let size = header.start + 4..header.start + 12;
        bytes[size].copy_from_slice(&[0, 0, 0x2e, 0xe0, 0, 0, 0x2e, 0xe0]);
        let sum = checksum(&bytes[header.clone()]).to_be_bytes();
        bytes[header.end..header.end + 4].copy_from_slice(&sum);
        let refused = Image::decode(&bytes);
        let Err(ImageError::Decode { source: image::ImageError::Limits(_), .. }) = refused else {
            panic!("{:?}", refused.map(|picture| picture.rgb.len()))
        };
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
