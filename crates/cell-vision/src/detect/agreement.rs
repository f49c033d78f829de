//! How well a picture agrees with the print that was read in it.
//!
//! In: a picture, the corners of what was read, the print's modules. Out: a correlation, 1 for the print
//! itself, about 0 for anything else. The library decides bit by bit whether a module is black or white and
//! counts the wrong ones; what it does not look at is whether all black modules, the border's among them,
//! are about as dark as each other, and all white ones as bright. In a real marker they are, however dark or
//! hazy the picture; where words or stripes were read as bits they are not. Pure.

use crate::detect::family::Pattern;
use cell_values::image::GrayImage;
use nalgebra::{Matrix3, Vector3};

/// Where a module is sampled, from its middle, in modules.
const SAMPLES: [f64; 3] = [-0.25, 0.0, 0.25];

/// Correlation between the grey levels of the modules and black and white as printed, once an even slope of
/// the light across the marker is taken out. 0 where it cannot be known.
pub(super) fn agreement(picture: &GrayImage, corners: &[[f64; 2]; 4], pattern: &Pattern) -> f64 {
    let Some(square) = Square::new(corners) else { return 0.0 };
    let sides = pattern.square_modules as f64;
    let ring = (pattern.modules as f64 - sides) / 2.0;
    let mut modules = Vec::with_capacity(pattern.white.len());
    for (place, &white) in pattern.white.iter().enumerate() {
        let (column, row) = ((place % pattern.modules) as f64, (place / pattern.modules) as f64);
        let middle = [column + 0.5 - ring, row + 0.5 - ring];
        let mut sum = 0.0;
        for down in SAMPLES {
            for across in SAMPLES {
                let at = square.pixel((middle[0] + across) / sides, 1.0 - (middle[1] + down) / sides);
                let Some(grey) = grey(picture, at) else { return 0.0 };
                sum += grey;
            }
        }
        let colour = if white { 1.0 } else { -1.0 };
        modules.push(Module { at: Vector3::new(1.0, middle[0], middle[1]), grey: sum / 9.0, colour });
    }
    correlation(&modules).unwrap_or(0.0)
}

/// A module: where it is (with a one before it), its grey level, 1 for white and -1 for black.
struct Module {
    at: Vector3<f64>,
    grey: f64,
    colour: f64,
}

/// Of grey and colour, once what a slope explains of each is taken out.
fn correlation(modules: &[Module]) -> Option<f64> {
    let mut information = Matrix3::zeros();
    let (mut of_grey, mut of_colour) = (Vector3::zeros(), Vector3::zeros());
    for module in modules {
        information += module.at * module.at.transpose();
        of_grey += module.at * module.grey;
        of_colour += module.at * module.colour;
    }
    let inverse = information.try_inverse()?;
    let (grey_slope, colour_slope) = (inverse * of_grey, inverse * of_colour);
    let (mut both, mut greys, mut colours) = (0.0, 0.0, 0.0);
    for module in modules {
        let grey = module.grey - grey_slope.dot(&module.at);
        let colour = module.colour - colour_slope.dot(&module.at);
        both += grey * colour;
        greys += grey * grey;
        colours += colour * colour;
    }
    let found = both / (greys * colours).sqrt();
    found.is_finite().then_some(found)
}

/// The unit square seen in perspective (Heckbert 1989): (0, 0), (1, 0), (1, 1), (0, 1) are the corners.
struct Square {
    x: [f64; 3],
    y: [f64; 3],
    below: [f64; 2],
}

impl Square {
    fn new(corners: &[[f64; 2]; 4]) -> Option<Square> {
        let [a, b, c, d] = *corners;
        let sum = [0, 1].map(|k| a[k] - b[k] + c[k] - d[k]);
        let (right, up) = ([0, 1].map(|k| b[k] - c[k]), [0, 1].map(|k| d[k] - c[k]));
        let cross = right[0] * up[1] - up[0] * right[1];
        let below =
            [(sum[0] * up[1] - up[0] * sum[1]) / cross, (right[0] * sum[1] - sum[0] * right[1]) / cross];
        let axis = |k: usize| [b[k] - a[k] + below[0] * b[k], d[k] - a[k] + below[1] * d[k], a[k]];
        below.iter().all(|value| value.is_finite()).then(|| Square { x: axis(0), y: axis(1), below })
    }

    fn pixel(&self, u: f64, v: f64) -> [f64; 2] {
        let scale = self.below[0] * u + self.below[1] * v + 1.0;
        [&self.x, &self.y].map(|axis| (axis[0] * u + axis[1] * v + axis[2]) / scale)
    }
}

/// The grey level between four pixels; `None` outside the picture.
fn grey(picture: &GrayImage, [x, y]: [f64; 2]) -> Option<f64> {
    let (width, height) = (picture.width as usize, picture.height as usize);
    let inside = |value: f64, size: usize| value >= -0.5 && value <= size as f64 - 0.5;
    if !(inside(x, width) && inside(y, height)) {
        return None;
    }
    let (x, y) = (x.clamp(0.0, width as f64 - 1.0), y.clamp(0.0, height as f64 - 1.0));
    let (left, above) = (x as usize, y as usize);
    let (u, v) = (x - left as f64, y - above as f64);
    let at = |column: usize, row: usize| {
        let place = row.min(height - 1) * width + column.min(width - 1);
        picture.data.get(place).map(|&level| f64::from(level))
    };
    let upper = at(left, above)? * (1.0 - u) + at(left + 1, above)? * u;
    let lower = at(left, above + 1)? * (1.0 - u) + at(left + 1, above + 1)? * u;
    Some(upper * (1.0 - v) + lower * v)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::family::Family;
    use crate::marker;

    /// Marker 7, 6 pixels a module, with its corners; light and contrast as given, brighter to the right.
    fn seen(foot: f64, span: f64, slope: f64) -> (GrayImage, [[f64; 2]; 4]) {
        let mut picture = marker::draw(7, 6).unwrap();
        for (place, level) in picture.data.iter_mut().enumerate() {
            let light = foot + slope * (place % 60) as f64 / 60.0;
            *level = (light + span * f64::from(*level) / 255.0) as u8;
        }
        (picture, [[5.5, 53.5], [53.5, 53.5], [53.5, 5.5], [5.5, 5.5]])
    }

    fn of(id: u32, picture: &GrayImage, corners: &[[f64; 2]; 4]) -> f64 {
        agreement(picture, corners, &Family::Tag36h11.pattern(id).unwrap())
    }

    #[test]
    fn a_print_agrees_with_itself_in_any_light_and_with_no_other() {
        for (foot, span, slope) in
            [(0.0, 255.0, 0.0), (180.0, 30.0, 0.0), (1.0, 8.0, 0.0), (20.0, 60.0, 150.0)]
        {
            let (picture, corners) = seen(foot, span, slope);
            let own = of(7, &picture, &corners);
            assert!(own > 0.95, "{foot} {span} {slope}: {own}");
            // Border and ring are the same for all, so others agree in part.
            let other =
                (0..100).filter(|id| *id != 7).map(|id| of(id, &picture, &corners)).fold(0.0, f64::max);
            assert!(other < 0.85, "{foot} {span} {slope}: {other}");
        }
    }

    #[test]
    fn corners_in_another_order_agree_less_and_what_is_outside_or_no_square_not_at_all() {
        let (picture, corners) = seen(0.0, 255.0, 0.0);
        let [a, b, c, d] = corners;
        assert!(of(7, &picture, &[b, c, d, a]) < 0.85);
        assert_eq!(of(7, &picture, &corners.map(|[x, y]| [x + 20.0, y])), 0.0);
        assert_eq!(of(7, &picture, &[[30.0, 30.0]; 4]), 0.0);
        assert_eq!(of(7, &picture, &[[f64::NAN; 2]; 4]), 0.0);
        let flat = GrayImage { data: vec![90; picture.data.len()], ..picture };
        assert!(of(7, &flat, &corners) < 1e-9);
    }
}
