//! Pictures of everything but markers: what a detector must read nothing in.
//!
//! In: a size, a random generator, perhaps a photograph as ground. Out: a grey picture of gradients, grain,
//! noise, shapes, frames, checkers, stripes, words of made-up letters, and framed squares of random modules
//! such as other marker systems print: the hardest of all, for only their bits are wrong. Pure: the same
//! generator gives the same picture.

use cell_values::image::GrayImage;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{PI, TAU};
use vision_pictures::degrade::Degradation;

/// Things on a picture, fewest and most.
const THINGS: (usize, usize) = (25, 70);
/// Reach of a thing as a share of the picture's width.
const REACH: (f64, f64) = (0.012, 0.11);

/// A picture without markers, then degraded in a way of its own.
///
/// # Errors
/// See [`Degradation::apply`].
pub fn degraded(
    [width, height]: [u32; 2],
    photograph: Option<&GrayImage>,
    random: &mut ChaCha8Rng,
) -> Result<GrayImage, String> {
    let picture = cluttered([width, height], photograph, random);
    let worse = random_degradation(random);
    worse.apply(&picture, &[], random)
}

/// A picture without markers, as sharp as a good camera's.
pub fn cluttered(
    [width, height]: [u32; 2],
    photograph: Option<&GrayImage>,
    random: &mut ChaCha8Rng,
) -> GrayImage {
    let mut canvas = Canvas::new(width as usize, height as usize);
    match photograph {
        Some(photograph) => canvas.show(photograph, random),
        None => canvas.ground(random),
    }
    let things = random.random_range(THINGS.0..THINGS.1);
    // On a photograph there is something already.
    for _ in 0..if photograph.is_some() { things / 4 } else { things } {
        canvas.thing(random);
    }
    let data = canvas.light.iter().map(|value| value.round().clamp(0.0, 255.0) as u8).collect();
    let picture = GrayImage { width, height, data };
    let noise = random.random_range(0.0..4.0);
    let lens = Degradation::Defocus(random.random_range(0.4..1.0));
    // Neither can fail: both give back the picture's own size.
    let seen = lens.apply(&picture, &[], random).unwrap_or(picture);
    Degradation::Noise(noise).apply(&seen, &[], random).unwrap_or(seen)
}

/// One of the benchmark's ways to get worse, as strong as it likes.
fn random_degradation(random: &mut ChaCha8Rng) -> Degradation {
    match random.random_range(0..8) {
        0 => Degradation::Clean,
        1 => Degradation::Gain(random.random_range(0.04..1.0)),
        2 => Degradation::Fog(random.random_range(0.2..0.85)),
        3 => Degradation::Jpeg(random.random_range(5..90)),
        4 => Degradation::Motion(random.random_range(2.0..9.0)),
        5 => Degradation::Defocus(random.random_range(0.5..2.0)),
        6 => Degradation::Noise(random.random_range(5.0..35.0)),
        _ => Degradation::Glare,
    }
}

/// A picture being painted.
struct Canvas {
    width: usize,
    height: usize,
    light: Vec<f64>,
}

impl Canvas {
    fn new(width: usize, height: usize) -> Canvas {
        Canvas { width, height, light: vec![0.0; width * height] }
    }

    /// A photograph, cut, turned over and stretched to the size.
    fn show(&mut self, photograph: &GrayImage, random: &mut ChaCha8Rng) {
        let (wide, high) = (f64::from(photograph.width), f64::from(photograph.height));
        let share = random.random_range(0.4..1.0);
        let (left, top) = (random.random_range(0.0..1.0 - share), random.random_range(0.0..1.0 - share));
        let (over, gain) = (random.random(), random.random_range(0.5..1.0));
        for row in 0..self.height {
            for column in 0..self.width {
                let across = column as f64 / self.width as f64;
                let across = left + share * if over { 1.0 - across } else { across };
                let down = top + share * row as f64 / self.height as f64;
                let at = (down * high) as usize * photograph.width as usize + (across * wide) as usize;
                let level = photograph.data.get(at).copied().unwrap_or(0);
                self.light[row * self.width + column] = gain * f64::from(level);
            }
        }
    }

    /// Even light with a slope, grain along one direction, noise of some coarseness.
    fn ground(&mut self, random: &mut ChaCha8Rng) {
        let (level, slope) = (random.random_range(30.0..220.0), random.random_range(0.0..120.0));
        let (turn, pitch): (f64, f64) = (random.random_range(0.0..TAU), random.random_range(3.0..40.0));
        let grain = random.random_range(0.0..40.0) * f64::from(random.random_range(0..2_u8));
        let coarse = random.random_range(1..24_usize);
        let speckle = random.random_range(0.0..70.0) * f64::from(random.random_range(0..2_u8));
        let columns = self.width / coarse + 2;
        let cells: Vec<f64> = (0..columns * (self.height / coarse + 2)).map(|_| random.random()).collect();
        let (cos, sin) = (turn.cos(), turn.sin());
        for row in 0..self.height {
            for column in 0..self.width {
                let (x, y) = (column as f64, row as f64);
                let along = (x * cos + y * sin) / self.width as f64;
                let across = (y * cos - x * sin) / pitch;
                let cell = cells[row / coarse * columns + column / coarse];
                let wave = (across + 0.7 * (0.37 * across).sin() + 0.3 * (along * 9.0).sin()).sin();
                self.light[row * self.width + column] =
                    level + slope * along + grain * wave + speckle * (cell - 0.5);
            }
        }
    }

    /// One thing somewhere.
    fn thing(&mut self, random: &mut ChaCha8Rng) {
        let reach = self.width as f64 * random.random_range(REACH.0..REACH.1);
        let at = [random.random_range(0.0..self.width as f64), random.random_range(0.0..self.height as f64)];
        let turn = random.random_range(0.0..TAU);
        let (dark, bright) = (random.random_range(5.0..110.0), random.random_range(120.0..250.0));
        let ink = if random.random() { [dark, bright] } else { [bright, dark] };
        let flat = random.random_range(0.4..1.0);
        let pick = random.random_range(0..10);
        match pick {
            0 => {
                self.paint(at, turn, reach, |u, v| (u.abs() < 0.7 && v.abs() < 0.7 * flat).then_some(ink[0]))
            }
            1 => self.paint(at, turn, reach, |u, v| (u * u + v * v / flat / flat < 1.0).then_some(ink[0])),
            2 => {
                let wall = random.random_range(0.05..0.3);
                self.paint(at, turn, reach, |u, v| {
                    let out = u.abs().max(v.abs() / flat) / 0.7;
                    (out < 1.0).then_some(if out > 1.0 - wall { ink[0] } else { ink[1] })
                });
            }
            3 => self.polygon(at, reach, ink[0], random),
            4 => {
                let cells = random.random_range(2.0..10.0_f64).floor();
                self.paint(at, turn, reach, |u, v| {
                    let cell = |w: f64| ((w + 0.7) / 1.4 * cells).floor() as i64;
                    (u.abs() < 0.7 && v.abs() < 0.7).then(|| ink[((cell(u) + cell(v)) & 1) as usize])
                });
            }
            5 => {
                let bars = random.random_range(2.0..20.0_f64);
                self.paint(at, turn, reach, |u, v| {
                    let dark = ((u + 0.7) / 1.4 * bars).fract() < 0.5;
                    (u.abs() < 0.7 && v.abs() < 0.7 * flat).then_some(ink[usize::from(dark)])
                });
            }
            6 | 7 => self.words(at, turn, reach, [dark, bright], random),
            _ => self.code(at, turn, reach, [dark, bright], random),
        }
    }

    /// Paints where `grey` says so; it gets places relative to the thing's reach, turned.
    fn paint(&mut self, at: [f64; 2], turn: f64, reach: f64, grey: impl Fn(f64, f64) -> Option<f64>) {
        let (cos, sin) = (turn.cos(), turn.sin());
        let range = |centre: f64, size: usize| {
            (centre - reach).max(0.0) as usize..((centre + reach).max(0.0) as usize).min(size)
        };
        for row in range(at[1], self.height) {
            for column in range(at[0], self.width) {
                let (x, y) = ((column as f64 - at[0]) / reach, (row as f64 - at[1]) / reach);
                if let Some(grey) = grey(x * cos + y * sin, y * cos - x * sin) {
                    self.light[row * self.width + column] = grey;
                }
            }
        }
    }

    /// A star-shaped polygon of three to eight corners.
    fn polygon(&mut self, at: [f64; 2], reach: f64, ink: f64, random: &mut ChaCha8Rng) {
        let corners = random.random_range(3..9_usize);
        let radii: Vec<f64> = (0..corners).map(|_| random.random_range(0.3..1.0)).collect();
        let step = TAU / corners as f64;
        self.paint(at, random.random_range(0.0..TAU), reach, |u, v| {
            let turn = (v.atan2(u) + PI).min(TAU - 1e-9);
            let side = (turn / step) as usize;
            let (a, b) = (radii[side % corners], radii[(side + 1) % corners]);
            let within = turn - side as f64 * step;
            // Where the ray at this angle meets the side.
            let meet = a * b * step.sin() / (a * within.sin() + b * (step - within).sin());
            (u.hypot(v) < meet).then_some(ink)
        });
    }

    /// Lines of made-up letters on a label.
    fn words(
        &mut self,
        at: [f64; 2],
        turn: f64,
        reach: f64,
        [ink, paper]: [f64; 2],
        random: &mut ChaCha8Rng,
    ) {
        let lines = random.random_range(1..7_usize);
        let letters = lines * random.random_range(2..5_usize);
        let glyphs: Vec<u64> =
            (0..lines * letters).map(|_| random.random::<u64>() & random.random::<u64>()).collect();
        self.paint(at, turn, reach, |u, v| {
            if u.abs() >= 0.9 || v.abs() >= 0.4 {
                return None;
            }
            let (column, row) = ((u + 0.9) / 1.8 * letters as f64, (v + 0.4) / 0.8 * lines as f64);
            let (x, y) = ((column.fract() * 6.0) as usize, (row.fract() * 8.0) as usize);
            let glyph = glyphs[(row as usize * letters + column as usize).min(glyphs.len() - 1)];
            let set = x < 5 && y < 7 && (glyph >> (y * 5 + x)) & 1 == 1;
            Some(if set { ink } else { paper })
        });
    }

    /// A framed square of random modules on a ring of paper.
    fn code(&mut self, at: [f64; 2], turn: f64, reach: f64, [ink, paper]: [f64; 2], random: &mut ChaCha8Rng) {
        let bits = random.random_range(4..9_usize);
        let set: Vec<bool> = (0..bits * bits).map(|_| random.random()).collect();
        let modules = bits as f64 + 4.0;
        self.paint(at, turn, reach, |u, v| {
            let [x, y] = [u, v].map(|w| (w + 0.7) / 1.4 * modules - 2.0);
            let inside = |low: f64, high: f64| low <= x.min(y) && x.max(y) < high;
            if !inside(-2.0, bits as f64 + 2.0) {
                return None;
            }
            let white = if inside(0.0, bits as f64) {
                set[y as usize * bits + x as usize]
            } else {
                !inside(-1.0, bits as f64 + 1.0)
            };
            Some(if white { paper } else { ink })
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cell_vision::detect::second::Expected;
    use cell_vision::detect::{DetectSettings, Detector, Family};
    use rand::SeedableRng;

    #[test]
    fn pictures_repeat_and_differ_and_show_much() {
        let of = |seed| degraded([160, 120], None, &mut ChaCha8Rng::seed_from_u64(seed)).unwrap();
        assert_eq!(of(1).data, of(1).data);
        assert_ne!(of(1).data, of(2).data);
        let sharp = cluttered([160, 120], Some(&of(3)), &mut ChaCha8Rng::seed_from_u64(4));
        let (low, high) = (sharp.data.iter().min().unwrap(), sharp.data.iter().max().unwrap());
        assert!(high - low > 80, "{low} {high}");
    }

    #[test]
    fn nothing_is_read_in_cluttered_pictures_however_it_is_searched() {
        let mut detector = Detector::new(DetectSettings::default()).unwrap();
        let expected: Vec<Expected> = (0..30).map(|id| Expected::anywhere(Family::Tag36h11, id)).collect();
        for seed in 0..200 {
            let picture = degraded([240, 180], None, &mut ChaCha8Rng::seed_from_u64(seed)).unwrap();
            let found = detector.detect_thoroughly(&picture, &expected).unwrap();
            assert!(found.is_empty(), "picture {seed}: {found:?}");
        }
    }
}
