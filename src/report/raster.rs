//! Drawings as pixels: any SVG of this module becomes a PNG, the same on every machine.
//!
//! In: SVG text and a scale. Out: the bytes of a PNG file. The font comes with the binary, and none of the
//! machine's is looked at, so that a picture does not depend on what is installed.

#[cfg(feature = "figures")]
use epaint_default_fonts::UBUNTU_LIGHT;
#[cfg(feature = "figures")]
use resvg::tiny_skia::{Pixmap, Transform};
#[cfg(feature = "figures")]
use resvg::usvg::{Options, Tree};
#[cfg(feature = "figures")]
use std::sync::Arc;

/// Largest edge of a picture, pixels.
#[cfg(feature = "figures")]
const MOST_PIXELS: f32 = 20_000.0;

/// Why there is no picture.
#[derive(Clone, Debug, thiserror::Error)]
pub enum RasterFault {
    /// The SVG cannot be read.
    #[error("the drawing cannot be read: {0}")]
    Svg(String),
    /// The size makes no sense.
    #[error("a picture of {0} x {1} pixels cannot be made")]
    Size(f32, f32),
    /// The pixels cannot be packed.
    #[error("the picture cannot be packed: {0}")]
    Png(String),
    /// The feature is left out.
    #[error(
        "this celld is built without PNG figures (cargo's feature `figures`); the SVG file is the same \
         drawing"
    )]
    NotBuilt,
}

/// Without the feature `figures` there is no PNG.
///
/// # Errors
/// Always, with what to build.
#[cfg(not(feature = "figures"))]
pub fn png(_svg: &str, _scale: f32) -> Result<Vec<u8>, RasterFault> {
    Err(RasterFault::NotBuilt)
}

/// The drawing as a PNG file, `scale` pixels to one of its units.
///
/// # Errors
/// What is wrong with the drawing, or with its size.
#[cfg(feature = "figures")]
pub fn png(svg: &str, scale: f32) -> Result<Vec<u8>, RasterFault> {
    let mut options = Options::default();
    let fonts = Arc::make_mut(&mut options.fontdb);
    fonts.load_font_data(UBUNTU_LIGHT.to_vec());
    let family = fonts.faces().find_map(|face| face.families.first()).map(|(name, _)| name.clone());
    if let Some(family) = family {
        fonts.set_sans_serif_family(family.clone());
        options.font_family = family;
    }
    let tree = Tree::from_str(svg, &options).map_err(|fault| RasterFault::Svg(fault.to_string()))?;
    let (width, height) = (tree.size().width() * scale, tree.size().height() * scale);
    if !(1.0..=MOST_PIXELS).contains(&width) || !(1.0..=MOST_PIXELS).contains(&height) {
        return Err(RasterFault::Size(width, height));
    }
    let mut pixels =
        Pixmap::new(width.ceil() as u32, height.ceil() as u32).ok_or(RasterFault::Size(width, height))?;
    resvg::render(&tree, Transform::from_scale(scale, scale), &mut pixels.as_mut());
    pixels.encode_png().map_err(|fault| RasterFault::Png(fault.to_string()))
}

#[cfg(feature = "figures")]
#[cfg(test)]
mod tests {
    use super::*;

    fn pixels(svg: &str, scale: f32) -> image::RgbaImage {
        image::load_from_memory(&png(svg, scale).unwrap()).unwrap().to_rgba8()
    }

    fn drawing(inside: &str) -> String {
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"40\" height=\"20\" font-family=\"sans-serif\">\
             <rect width=\"40\" height=\"20\" fill=\"#fff\"/>{inside}</svg>"
        )
    }

    #[test]
    fn shapes_lie_where_they_are_drawn_at_any_scale() {
        let image = pixels(&drawing("<rect x=\"10\" width=\"10\" height=\"20\" fill=\"#f00\"/>"), 2.0);
        assert_eq!(image.dimensions(), (80, 40));
        assert_eq!(image.get_pixel(30, 20).0, [255, 0, 0, 255]);
        assert_eq!(image.get_pixel(50, 20).0, [255, 255, 255, 255]);
    }

    #[test]
    fn text_needs_no_font_of_the_machine() {
        let image = pixels(&drawing("<text x=\"2\" y=\"16\" font-size=\"16\">MMM</text>"), 1.0);
        assert!(image.pixels().filter(|pixel| pixel.0[0] < 128).count() > 40);
    }

    #[test]
    fn what_is_no_drawing_is_refused() {
        assert!(matches!(png("<svg", 1.0), Err(RasterFault::Svg(_))));
        assert!(matches!(png(&drawing(""), 1e6), Err(RasterFault::Size(..))));
    }
}
