//! The SDK's sets of frames and its lens as celld's own values.
//!
//! In: a set of frames, intrinsics. Out: number and time of its pictures, a [`Frame`] with colour and depth,
//! a factory's lens. Every picture is checked against what was agreed: a set without one, or with depth of
//! another size, is an error.

use crate::io::camera::realsense::sdk::{self, Frames, SdkError, Stream};
use crate::io::camera::{CameraError, Frame};
use cell_values::image::Image;
use cell_values::image::depth::DepthImage;
use cell_vision::camera::{CameraModel, FactoryDistortion, FactoryLens};

/// Number and time of the pictures in a set.
pub(super) struct Heads {
    pub(super) colour: Option<(u64, f64)>,
    pub(super) depth_s: Option<f64>,
}

pub(super) fn heads_of(set: &Frames) -> Result<Heads, SdkError> {
    let mut heads = Heads { colour: None, depth_s: None };
    for picture in set.all()? {
        match picture.stream()? {
            Stream { kind: sdk::STREAM_COLOUR, format: sdk::FORMAT_RGB8, .. } => {
                heads.colour = Some((picture.number()?, picture.time_s()?));
            }
            Stream { kind: sdk::STREAM_DEPTH, format: sdk::FORMAT_Z16, .. } => {
                heads.depth_s = Some(picture.time_s()?);
            }
            _ => {}
        }
    }
    Ok(heads)
}

/// Colour and depth out of a set.
pub(super) fn frame_of(
    set: &Frames,
    unit_m: f64,
    with_depth: bool,
    place: &str,
) -> Result<Frame, CameraError> {
    let refused = |source| CameraError::RealSense { place: place.to_string(), source };
    let broken = |source| CameraError::Picture { place: place.to_string(), source };
    let (mut colour, mut depth) = (None, None);
    for picture in set.all().map_err(refused)? {
        let stream = picture.stream().map_err(refused)?;
        match (stream.kind, stream.format) {
            (sdk::STREAM_COLOUR, sdk::FORMAT_RGB8) => {
                let rows = picture.rows(3).map_err(refused)?;
                let image = Image::from_rgb(rows.width, rows.height, rows.data).map_err(broken)?;
                let (sequence, time_s) =
                    (picture.number().map_err(refused)?, picture.time_s().map_err(refused)?);
                colour = Some((image, sequence, time_s));
            }
            (sdk::STREAM_DEPTH, sdk::FORMAT_Z16) if with_depth => {
                let rows = picture.rows(2).map_err(refused)?;
                let units: Vec<u16> =
                    rows.data.chunks_exact(2).map(|pair| u16::from_ne_bytes([pair[0], pair[1]])).collect();
                depth =
                    Some(DepthImage::from_units(rows.width, rows.height, &units, unit_m).map_err(broken)?);
            }
            _ => {}
        }
    }
    let nonsense = |what: &str| {
        let (function, what) = ("rs2_process_frame", what.to_string());
        refused(SdkError::Nonsense { function, what })
    };
    let (image, sequence, time_s) = colour.ok_or_else(|| nonsense("no colour picture"))?;
    let fits = |depth: &DepthImage| (depth.width, depth.height) == (image.width, image.height);
    if with_depth && !depth.as_ref().is_some_and(fits) {
        return Err(nonsense("no depth of the colour picture's size"));
    }
    Ok(Frame { image, sequence, time_s, source: place.to_string(), depth })
}

/// The SDK's numbers as a factory's lens.
pub(super) fn factory_lens(serial: &str, own: &sdk::Intrinsics) -> FactoryLens {
    let pinhole = CameraModel {
        serial: serial.to_string(),
        width: own.width.unsigned_abs(),
        height: own.height.unsigned_abs(),
        fx: f64::from(own.fx),
        fy: f64::from(own.fy),
        cx: f64::from(own.ppx),
        cy: f64::from(own.ppy),
        distortion: [0.0; 5],
    };
    let form = match own.model {
        0 => FactoryDistortion::None,
        1 | 2 => FactoryDistortion::TangentialAfterRadial,
        4 => FactoryDistortion::BrownConrady,
        _ => FactoryDistortion::Fisheye,
    };
    FactoryLens { pinhole, form, coefficients: own.coefficients.map(f64::from) }
}
