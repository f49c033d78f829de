//! Poor pictures made of good ones: little light, fog, JPEG, motion, defocus, noise, covered borders, glare.
//!
//! In: a grey picture, where its markers are, a [`Degradation`], a random generator. Out: the picture as a
//! camera would have given it. Pure: the same generator gives the same picture. What lowers the light
//! happens before the sensor, so the sensor's own noise and its rounding to 8 bits come after it.

use cell_values::image::GrayImage;
use image::codecs::jpeg::JpegEncoder;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{PI, TAU};
use std::fmt;

/// Noise of the sensor itself, grey levels: what is left of a dark picture's noise however short the
/// exposure was.
const READ_NOISE: f64 = 0.5;
/// Grey level of fog and of light scattered in a lens.
const VEIL: f64 = 205.0;
/// Highlights of glare in a picture, their reach as a share of its width, and how bright they are.
const GLARES: usize = 3;
const GLARE_REACH: (f64, f64) = (0.03, 0.10);
const GLARE_PEAK: f64 = 230.0;

/// A way in which a picture gets worse.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Degradation {
    /// As it is.
    Clean,
    /// Light times this.
    Gain(f64),
    /// This share of the contrast is lost to a bright veil.
    Fog(f64),
    /// Through a JPEG file of this quality.
    Jpeg(u8),
    /// Moved by so many pixels during exposure, in a direction of its own.
    Motion(f64),
    /// Out of focus: Gaussian of this standard deviation, pixels.
    Defocus(f64),
    /// Noise of this standard deviation, grey levels.
    Noise(f64),
    /// This share of every marker's black border lies under something.
    Covered(f64),
    /// Highlights that saturate.
    Glare,
}

impl Degradation {
    /// Those of the benchmark, in its order.
    pub const ALL: [Degradation; 25] = [
        Degradation::Clean,
        Degradation::Gain(1.0),
        Degradation::Gain(0.5),
        Degradation::Gain(0.25),
        Degradation::Gain(0.15),
        Degradation::Gain(0.08),
        Degradation::Gain(0.06),
        Degradation::Gain(0.04),
        Degradation::Fog(0.5),
        Degradation::Fog(0.8),
        Degradation::Jpeg(90),
        Degradation::Jpeg(50),
        Degradation::Jpeg(30),
        Degradation::Jpeg(20),
        Degradation::Jpeg(10),
        Degradation::Jpeg(5),
        Degradation::Motion(5.0),
        Degradation::Motion(9.0),
        Degradation::Defocus(1.0),
        Degradation::Defocus(1.5),
        Degradation::Defocus(2.0),
        Degradation::Noise(20.0),
        Degradation::Noise(35.0),
        Degradation::Covered(0.05),
        Degradation::Glare,
    ];

    /// The picture degraded; `markers` are the corners of the markers in it.
    ///
    /// # Errors
    /// A picture that JPEG cannot hold.
    pub fn apply(
        self,
        picture: &GrayImage,
        markers: &[[[f64; 2]; 4]],
        random: &mut ChaCha8Rng,
    ) -> Result<GrayImage, String> {
        let mut light: Vec<f64> = picture.data.iter().map(|&level| f64::from(level)).collect();
        let (width, height) = (picture.width as usize, picture.height as usize);
        match self {
            Degradation::Clean => return Ok(picture.clone()),
            Degradation::Jpeg(quality) => return jpeg(picture, quality),
            Degradation::Gain(gain) => {
                light.iter_mut().for_each(|value| *value = *value * gain + READ_NOISE * normal(random));
            }
            Degradation::Fog(share) => light.iter_mut().for_each(|value| {
                *value = *value * (1.0 - share) + VEIL * share + READ_NOISE * normal(random);
            }),
            Degradation::Motion(length) => {
                light = moved(&light, width, height, length, random.random_range(0.0..PI));
            }
            Degradation::Defocus(sigma) => light = blurred(&light, width, height, sigma),
            Degradation::Noise(deviation) => {
                light.iter_mut().for_each(|value| *value += deviation * normal(random));
            }
            Degradation::Covered(share) => {
                markers.iter().for_each(|corners| cover(&mut light, width, corners, share, random));
            }
            Degradation::Glare => (0..GLARES).for_each(|_| glare(&mut light, width, random)),
        }
        let data = light.iter().map(|value| value.round().clamp(0.0, 255.0) as u8).collect();
        Ok(GrayImage { width: picture.width, height: picture.height, data })
    }
}

impl fmt::Display for Degradation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Degradation::Clean => f.write_str("clean"),
            Degradation::Gain(gain) => write!(f, "light x{gain}"),
            Degradation::Fog(share) => write!(f, "fog {share}"),
            Degradation::Jpeg(quality) => write!(f, "JPEG quality {quality}"),
            Degradation::Motion(length) => write!(f, "motion {length} px"),
            Degradation::Defocus(sigma) => write!(f, "defocus {sigma} px"),
            Degradation::Noise(deviation) => write!(f, "noise {deviation}"),
            Degradation::Covered(share) => write!(f, "borders covered {:.0} %", 100.0 * share),
            Degradation::Glare => f.write_str("glare"),
        }
    }
}

/// The picture through a JPEG file.
fn jpeg(picture: &GrayImage, quality: u8) -> Result<GrayImage, String> {
    let mut bytes = Vec::new();
    let (width, height) = (picture.width, picture.height);
    let mut encoder = JpegEncoder::new_with_quality(&mut bytes, quality);
    let written = encoder.encode(&picture.data, width, height, image::ExtendedColorType::L8);
    written.map_err(|error| error.to_string())?;
    let read = image::load_from_memory(&bytes).map_err(|error| error.to_string())?;
    GrayImage::from_data(width, height, read.into_luma8().into_raw()).map_err(|error| error.to_string())
}

/// Mean of the light along a line of `length` pixels in a direction.
fn moved(light: &[f64], width: usize, height: usize, length: f64, direction: f64) -> Vec<f64> {
    let steps = (2.0 * length).ceil().max(1.0) as usize;
    let (cos, sin) = (direction.cos(), direction.sin());
    let mut sum = vec![0.0; light.len()];
    for step in 0..steps {
        let off = length * ((step as f64 + 0.5) / steps as f64 - 0.5);
        let (dx, dy) = (off * cos, off * sin);
        let (left, up) = (dx.floor(), dy.floor());
        let (u, v) = (dx - left, dy - up);
        let near = |i: usize, by: f64, size: usize| (i as f64 + by).clamp(0.0, size as f64 - 1.0) as usize;
        for row in 0..height {
            let rows = [near(row, up, height) * width, near(row, up + 1.0, height) * width];
            for column in 0..width {
                let columns = [near(column, left, width), near(column, left + 1.0, width)];
                let along = |row: usize| light[row + columns[0]] * (1.0 - u) + light[row + columns[1]] * u;
                sum[row * width + column] += along(rows[0]) * (1.0 - v) + along(rows[1]) * v;
            }
        }
    }
    sum.iter_mut().for_each(|value| *value /= steps as f64);
    sum
}

/// Gaussian blur, the border repeated.
fn blurred(light: &[f64], width: usize, height: usize, sigma: f64) -> Vec<f64> {
    let reach = (3.0 * sigma).ceil().max(1.0) as isize;
    let weights: Vec<f64> = (-reach..=reach).map(|i| (-0.5 * (i as f64 / sigma).powi(2)).exp()).collect();
    let total: f64 = weights.iter().sum();
    let near = |i: usize, k: usize, size: usize| {
        (i as isize + k as isize - reach).clamp(0, size as isize - 1) as usize
    };
    let pass = |from: &[f64], at: &dyn Fn(usize, usize, usize) -> usize| {
        let one = |i: usize| {
            let (row, column) = (i / width, i % width);
            let sum: f64 = weights.iter().enumerate().map(|(k, w)| w * from[at(row, column, k)]).sum();
            sum / total
        };
        (0..from.len()).map(one).collect::<Vec<f64>>()
    };
    let across = pass(light, &|row, column, k| row * width + near(column, k, width));
    pass(&across, &|row, column, k| near(row, k, height) * width + column)
}

/// Something of one grey level over a piece of one side of a marker: `share` of its whole border, as wide as
/// the border and its white ring.
fn cover(light: &mut [f64], width: usize, corners: &[[f64; 2]; 4], share: f64, random: &mut ChaCha8Rng) {
    let side = random.random_range(0..4);
    let (a, b) = (corners[side], corners[(side + 1) % 4]);
    let along = [b[0] - a[0], b[1] - a[1]];
    let length = along[0].hypot(along[1]);
    // A share of all four sides is four times that share of one.
    let half = 2.0 * share * length;
    let at = random.random_range(0.0..1.0);
    let middle = [a[0] + at * along[0], a[1] + at * along[1]];
    let grey = random.random_range(20.0..235.0);
    // The border and the ring are a module wide each, an eighth of the side.
    let deep = length / 8.0;
    let reach = half.max(deep) * 1.5;
    let height = light.len() / width;
    let range = |centre: f64, size: usize| {
        (centre - reach).max(0.0) as usize..((centre + reach).max(0.0).ceil() as usize).min(size)
    };
    for row in range(middle[1], height) {
        for column in range(middle[0], width) {
            let off = [column as f64 - middle[0], row as f64 - middle[1]];
            let u = (off[0] * along[0] + off[1] * along[1]) / length;
            let v = (off[1] * along[0] - off[0] * along[1]) / length;
            if u.abs() <= half && v.abs() <= deep {
                light[row * width + column] = grey;
            }
        }
    }
}

/// One highlight: bright in its middle, fading like a Gaussian, longer than wide.
fn glare(light: &mut [f64], width: usize, random: &mut ChaCha8Rng) {
    let height = light.len() / width;
    let reach = width as f64 * random.random_range(GLARE_REACH.0..GLARE_REACH.1);
    let (turn, stretch): (f64, f64) = (random.random_range(0.0..TAU), random.random_range(1.0..3.0));
    let centre = [random.random_range(0.0..width as f64), random.random_range(0.0..height as f64)];
    for (i, value) in light.iter_mut().enumerate() {
        let off = [(i % width) as f64 - centre[0], (i / width) as f64 - centre[1]];
        let u = (off[0] * turn.cos() + off[1] * turn.sin()) / (reach * stretch);
        let v = (off[1] * turn.cos() - off[0] * turn.sin()) / reach;
        *value += GLARE_PEAK * (-0.5 * (u * u + v * v)).exp();
    }
}

/// A standard normal number (Box and Muller).
fn normal(random: &mut ChaCha8Rng) -> f64 {
    let (u, v): (f64, f64) = (random.random(), random.random());
    (-2.0 * (1.0 - u).ln()).sqrt() * (TAU * v).cos()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    const SQUARE: [[f64; 2]; 4] = [[20.0, 60.0], [60.0, 60.0], [60.0, 20.0], [20.0, 20.0]];

    /// A bright square on dark ground.
    fn picture() -> GrayImage {
        let inside = |i: usize| (20..60).contains(&(i % 80)) && (20..60).contains(&(i / 80));
        let data = (0..80 * 80).map(|i| if inside(i) { 200 } else { 40 }).collect();
        GrayImage { width: 80, height: 80, data }
    }

    fn worse(degradation: Degradation, seed: u64) -> GrayImage {
        degradation.apply(&picture(), &[SQUARE], &mut ChaCha8Rng::seed_from_u64(seed)).unwrap()
    }

    fn at(picture: &GrayImage, column: usize, row: usize) -> i32 {
        i32::from(picture.data[row * 80 + column])
    }

    /// Mean and standard deviation of the middle of the square.
    fn middle(picture: &GrayImage) -> [f64; 2] {
        let levels: Vec<f64> = (25 * 80..55 * 80)
            .filter(|i| (25..55).contains(&(i % 80)))
            .map(|i| f64::from(picture.data[i]))
            .collect();
        let mean = levels.iter().sum::<f64>() / levels.len() as f64;
        let square = levels.iter().map(|level| (level - mean).powi(2)).sum::<f64>() / levels.len() as f64;
        [mean, square.sqrt()]
    }

    #[test]
    fn every_degradation_repeats_with_its_seed_and_keeps_the_size() {
        for degradation in Degradation::ALL {
            let one = worse(degradation, 5);
            assert_eq!((one.width, one.height, one.data.len()), (80, 80, 6400), "{degradation}");
            assert_eq!(one.data, worse(degradation, 5).data, "{degradation}");
            let changed = one.data != picture().data;
            assert_eq!(changed, degradation != Degradation::Clean, "{degradation}");
        }
    }

    #[test]
    fn light_and_fog_are_what_their_numbers_say() {
        let [dark, noise] = middle(&worse(Degradation::Gain(0.08), 1));
        assert!((dark - 16.0).abs() < 0.1 && (0.3..0.8).contains(&noise), "{dark} {noise}");
        let fog = worse(Degradation::Fog(0.8), 1);
        let [bright, _] = middle(&fog);
        assert!((bright - (0.2 * 200.0 + 0.8 * VEIL)).abs() < 0.1, "{bright}");
        assert!((at(&fog, 5, 5) - (0.2 * 40.0 + 0.8 * VEIL) as i32).abs() <= 2);
    }

    #[test]
    fn noise_has_its_deviation_and_jpeg_its_blocks() {
        let [mean, deviation] = middle(&worse(Degradation::Noise(20.0), 2));
        assert!((mean - 200.0).abs() < 3.0 && (deviation - 20.0).abs() < 2.0, "{mean} {deviation}");
        let off = |quality| {
            let coded = worse(Degradation::Jpeg(quality), 0);
            coded.data.iter().zip(&picture().data).map(|(a, b)| u64::from(a.abs_diff(*b))).sum::<u64>()
        };
        assert!(off(5) > 3 * off(90), "{} {}", off(5), off(90));
    }

    #[test]
    fn motion_and_defocus_widen_edges_and_keep_the_light() {
        let widened =
            |picture: &GrayImage| picture.data.iter().filter(|level| (50..190).contains(*level)).count();
        let total = |picture: &GrayImage| picture.data.iter().map(|level| f64::from(*level)).sum::<f64>();
        let clean = total(&picture());
        let mut last = 0;
        for degradation in [Degradation::Defocus(1.0), Degradation::Defocus(2.0)] {
            let blurred = worse(degradation, 3);
            assert!(widened(&blurred) > last, "{degradation}");
            assert!((total(&blurred) / clean - 1.0).abs() < 0.01, "{degradation}");
            last = widened(&blurred);
        }
        let (five, nine) = (worse(Degradation::Motion(5.0), 3), worse(Degradation::Motion(9.0), 3));
        assert!(widened(&five) > 0 && widened(&nine) > widened(&five));
        assert!((total(&nine) / clean - 1.0).abs() < 0.01);
    }

    #[test]
    fn a_cover_lies_on_the_border_and_glare_saturates() {
        let clean = picture();
        let changed = |worse: &GrayImage| {
            let off = worse.data.iter().zip(&clean.data).enumerate();
            off.filter(|(_, (a, b))| a != b).map(|(i, _)| [i % 80, i / 80]).collect::<Vec<_>>()
        };
        let covered = changed(&worse(Degradation::Covered(0.05), 4));
        // A twentieth of 160 px of border, 10 px wide with the ring.
        assert!((30..160).contains(&covered.len()), "{}", covered.len());
        let near = |[x, y]: &[usize; 2]| (10..70).contains(x) && (10..70).contains(y);
        let inner = |[x, y]: &[usize; 2]| (27..53).contains(x) && (27..53).contains(y);
        assert!(covered.iter().all(|place| near(place) && !inner(place)), "{covered:?}");
        assert!(worse(Degradation::Glare, 4).data.contains(&255));
    }
}
