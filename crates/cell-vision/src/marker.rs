//! The print of a marker: its pattern enlarged to pixels, and its corners in the marker frame.
//!
//! In: an id of the tag36h11 family, a size. Out: a grey picture with the white quiet ring, or points in
//! metres. The marker frame has its origin in the centre, x right, y up, z out of the print; a marker's size
//! is the edge of the black square, so the whole print is 10/8 of it.

use cell_values::image::tag36h11::{MODULES, MODULES_IN_SQUARE};
use cell_values::image::{GrayImage, tag36h11_bitmap};

/// The one family used so far.
pub const FAMILY: &str = "tag36h11";

/// Edge of the whole print (quiet ring included) for a black square of edge `size_m`, m.
pub fn print_edge_m(size_m: f64) -> f64 {
    size_m * MODULES as f64 / MODULES_IN_SQUARE as f64
}

/// Corners of the black square in the marker frame, m, in the order of `Detection::corners`.
///
/// Lower left, lower right, upper right, upper left, as one reads the print.
pub fn corners_m(size_m: f64) -> [[f64; 2]; 4] {
    let half = size_m / 2.0;
    [[-half, -half], [half, -half], [half, half], [-half, half]]
}

/// Marker `id` with `pixels_per_module` pixels to each module and its quiet ring; `None` if there is no such
/// id or the picture would be empty or absurdly large.
pub fn draw(id: u32, pixels_per_module: u32) -> Option<GrayImage> {
    let white = tag36h11_bitmap(id)?;
    let edge = pixels_per_module.checked_mul(MODULES as u32)?;
    let module = |pixel: u32| (pixel / pixels_per_module) as usize;
    if pixels_per_module == 0 || edge > cell_values::image::MAX_EDGE {
        return None;
    }
    let pixels = (0..edge).flat_map(|y| (0..edge).map(move |x| (x, y)));
    let data = pixels.map(|(x, y)| if white[module(y)][module(x)] { 255 } else { 0 }).collect();
    Some(GrayImage { width: edge, height: edge, data })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_drawing_repeats_the_pattern() {
        let picture = draw(7, 3).unwrap();
        let white = tag36h11_bitmap(7).unwrap();
        assert_eq!((picture.width, picture.height), (30, 30));
        for (row, line) in white.iter().enumerate() {
            for (column, &bit) in line.iter().enumerate() {
                assert_eq!(picture.data[(3 * row + 1) * 30 + 3 * column + 1] > 0, bit);
            }
        }
        assert!(draw(7, 0).is_none() && draw(9999, 3).is_none() && draw(7, u32::MAX / 5).is_none());
    }

    #[test]
    fn the_print_is_wider_than_the_square_by_the_ring() {
        assert_eq!(print_edge_m(0.032), 0.04);
    }
}
