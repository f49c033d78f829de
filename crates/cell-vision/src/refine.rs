//! Sub-pixel corners of a square print: an edge model fitted to the grey values along each side, the sides
//! crossed.
//!
//! In: a grey picture, four corners good to a pixel or two, the side in modules. Out: corners good to a few
//! hundredths of a pixel. Each side is a straight step between two grey levels, blurred by a Gaussian: its
//! place, direction, levels and blur are found by least squares over every pixel near it. The AprilTag
//! library searches the steepest point along a few normals instead, which is up to 0.2 px off where a side
//! runs along the pixel grid. No sampling between pixels takes place here, so there is nothing to be biased.
//! Pure.

use cell_values::image::GrayImage;
use nalgebra::{SMatrix, SVector, Vector2};

/// Distance from the side within which pixels count, at most, pixels: three standard deviations of usual
/// blur.
const BAND_MAX_PX: f64 = 2.9;
/// The same as a share of a module, so that the next transition of the print stays outside.
const BAND_MODULES: f64 = 0.6;
/// Left out at both ends of a side, where the neighbouring side's blur reaches, pixels.
const END_PX: f64 = 3.0;
/// A corner that moves further than this was misread, pixels.
const MOVE_MAX_PX: f64 = 2.0;
/// Blur that a usable picture has, standard deviation, pixels.
const BLUR_PX: (f64, f64) = (0.3, 2.5);
/// Blur to begin with, and how much it counts beside the pixels: 3 grey levels of noise over 0.4 px,
/// squared.
const BLUR_USUAL_PX: f64 = 0.9;
const BLUR_WEIGHT: f64 = 56.0;
/// Rounds of choosing pixels anew, and steps in each.
const ROUNDS: usize = 2;
const STEPS: usize = 5;
/// Fewest pixels that fix five numbers well.
const PIXELS_MIN: usize = 24;

/// The corners refined; `None` when a side shows no clear step, or a corner would move further than a
/// misread one.
pub fn corners(picture: &GrayImage, rough: &[[f64; 2]; 4], modules: f64) -> Option<[[f64; 2]; 4]> {
    let at = |i: usize| Vector2::from(rough[i % 4]);
    let mut sides = [Line { point: Vector2::zeros(), along: Vector2::zeros() }; 4];
    for (i, side) in sides.iter_mut().enumerate() {
        *side = fit(picture, at(i), at(i + 1), modules)?;
    }
    let mut refined = *rough;
    for (i, corner) in refined.iter_mut().enumerate() {
        let crossing = sides[(i + 3) % 4].crossing(&sides[i])?;
        if (crossing - at(i)).norm() > MOVE_MAX_PX {
            return None;
        }
        *corner = crossing.into();
    }
    Some(refined)
}

/// A straight line in the picture.
#[derive(Clone, Copy)]
struct Line {
    point: Vector2<f64>,
    along: Vector2<f64>,
}

impl Line {
    fn crossing(&self, other: &Line) -> Option<Vector2<f64>> {
        let cross = self.along.perp(&other.along);
        let t = (other.point - self.point).perp(&other.along) / cross;
        let found = self.point + t * self.along;
        (found.x.is_finite() && found.y.is_finite()).then_some(found)
    }
}

/// The side between two corners.
fn fit(picture: &GrayImage, a: Vector2<f64>, b: Vector2<f64>, modules: f64) -> Option<Line> {
    let length = (b - a).norm();
    let mut line = Line { point: (a + b) / 2.0, along: (b - a) / length };
    let half = length / 2.0 - END_PX.min(0.2 * length);
    let band = (BAND_MODULES * length / modules).min(BAND_MAX_PX);
    let mut step = Step { middle: 0.0, half: 0.0, blur: BLUR_USUAL_PX };
    for round in 0..ROUNDS {
        let pixels = pixels_near(picture, &line, half, band);
        if pixels.len() < PIXELS_MIN {
            return None;
        }
        if round == 0 {
            step = levels(&pixels, step.blur);
        }
        line = step.improve(&pixels, line)?;
    }
    (step.half.abs() > 4.0 && (BLUR_PX.0..=BLUR_PX.1).contains(&step.blur)).then_some(line)
}

/// A pixel near a side: along it, across it, its grey level.
struct Near {
    u: f64,
    v: f64,
    grey: f64,
}

fn pixels_near(picture: &GrayImage, line: &Line, half: f64, band: f64) -> Vec<Near> {
    let across = Vector2::new(-line.along.y, line.along.x);
    let reach = Vector2::new(
        half * line.along.x.abs() + band * across.x.abs(),
        half * line.along.y.abs() + band * across.y.abs(),
    );
    let mut found = Vec::new();
    let range = |centre: f64, reach: f64, size: u32| {
        let low = (centre - reach).ceil().max(0.0);
        let high = (centre + reach).floor().min(f64::from(size) - 1.0);
        (low <= high).then_some(low as usize..=high as usize)
    };
    let Some(columns) = range(line.point.x, reach.x, picture.width) else { return found };
    let Some(rows) = range(line.point.y, reach.y, picture.height) else { return found };
    let width = picture.width as usize;
    for row in rows {
        let Some(greys) = picture.data.get(row * width..(row + 1) * width) else { break };
        for column in columns.clone() {
            let off = Vector2::new(column as f64, row as f64) - line.point;
            let (u, v) = (off.dot(&line.along), off.dot(&across));
            if u.abs() <= half && v.abs() <= band {
                found.push(Near { u, v, grey: f64::from(greys[column]) });
            }
        }
    }
    found
}

/// Grey levels on both sides, from the pixels furthest out.
fn levels(pixels: &[Near], blur: f64) -> Step {
    let mean = |sign: f64| {
        let (mut sum, mut weight) = (0.0, 1e-9);
        for pixel in pixels.iter().filter(|p| p.v * sign > 0.0) {
            // The further from the side, the less of the other level is in it.
            let w = pixel.v.powi(4);
            sum += w * pixel.grey;
            weight += w;
        }
        sum / weight
    };
    let (far, near) = (mean(1.0), mean(-1.0));
    Step { middle: (far + near) / 2.0, half: (far - near) / 2.0, blur }
}

/// A blurred step between two grey levels.
struct Step {
    middle: f64,
    /// Half the difference of the levels, positive when it gets brighter with v.
    half: f64,
    /// Standard deviation of the blur, pixels.
    blur: f64,
}

impl Step {
    /// Gauss-Newton on offset, slope, both levels and blur together; `None` when the numbers break down.
    fn improve(&mut self, pixels: &[Near], line: Line) -> Option<Line> {
        let (mut offset, mut slope) = (0.0, 0.0);
        for _ in 0..STEPS {
            let change = self.change(pixels, offset, slope)?;
            offset += change[0].clamp(-1.0, 1.0);
            slope += change[1].clamp(-0.1, 0.1);
            self.middle += change[2];
            self.half += change[3];
            self.blur = (self.blur + change[4].clamp(-0.3, 0.3)).clamp(BLUR_PX.0 * 0.9, BLUR_PX.1 * 1.1);
            if change[0].abs() < 3e-3 && change[1].abs() < 2e-4 {
                break;
            }
        }
        let across = Vector2::new(-line.along.y, line.along.x);
        let along = (line.along + slope * across).try_normalize(1e-9)?;
        Some(Line { point: line.point + offset * across, along })
    }

    fn change(&self, pixels: &[Near], offset: f64, slope: f64) -> Option<SVector<f64, 5>> {
        let mut information = SMatrix::<f64, 5, 5>::zeros();
        let mut pull = SVector::<f64, 5>::zeros();
        // Beyond some tenth of the contrast a residual is no noise: dirt, glare, a finger.
        let usual = 6.0 + 0.15 * self.half.abs();
        for pixel in pixels {
            let z = (pixel.v - offset - slope * pixel.u) / self.blur;
            let (share, density) = normal(z);
            let miss = pixel.grey - (self.middle + self.half * share);
            let by_v = -2.0 * self.half * density / self.blur;
            let row = SVector::<f64, 5>::new(by_v, by_v * pixel.u, 1.0, share, by_v * z);
            let weight = 1.0 / (1.0 + (miss / usual).powi(2));
            // The upper half is enough: the other is its mirror.
            for j in 0..5 {
                let scaled = weight * row[j];
                pull[j] += scaled * miss;
                for i in 0..=j {
                    information[(i, j)] += scaled * row[i];
                }
            }
        }
        information.fill_lower_triangle_with_upper_triangle();
        // Between the transitions of a small print there is too little to determine the blur: it is what is
        // usual then.
        information[(4, 4)] += BLUR_WEIGHT;
        pull[4] += BLUR_WEIGHT * (BLUR_USUAL_PX - self.blur);
        // A flat patch leaves the place undetermined: a little stiffness keeps the numbers finite.
        information += SMatrix::<f64, 5, 5>::identity() * 1e-6;
        let change = information.cholesky()?.solve(&pull);
        change.iter().all(|value| value.is_finite()).then_some(change)
    }
}

/// The normal distribution at `z`: from -1 to 1 what lies below against above, and the density.
fn normal(z: f64) -> (f64, f64) {
    // Abramowitz and Stegun 7.1.26, off by 1.5e-7 at most.
    let x = z.abs() * std::f64::consts::FRAC_1_SQRT_2;
    let t = 1.0 / (1.0 + 0.3275911 * x);
    let tail = (-x * x).exp();
    let poly =
        t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))));
    let share = 1.0 - poly * tail;
    (share.copysign(z), tail * 0.398_942_280_401_432_7)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{self, Print, USUAL};
    use rearrange::geometry::pose::Pose2;

    /// Largest corner error after refining corners that were off by 0.4 px.
    fn worst(turn: f64, size_m: f64, seed: u64) -> f64 {
        let camera = testing::camera(320, 240);
        let table_from_camera = testing::looking_down(0.0, 0.0, 0.5, [0.0, 0.0], 0.0);
        let print = Print::level(5, size_m, Pose2::new(0.0013, -0.0007, turn), 0.0);
        let truth = print.corners(&camera, &table_from_camera);
        let picture = testing::render(&camera, &table_from_camera, &[print], USUAL, seed);
        let rough = [(0.4, 0.1), (-0.3, 0.4), (0.2, -0.4), (-0.4, -0.2)];
        let rough = [0, 1, 2, 3].map(|i| [truth[i][0] + rough[i].0, truth[i][1] + rough[i].1]);
        let refined = corners(&picture, &rough, 8.0).unwrap();
        let off = |i: usize| (refined[i][0] - truth[i][0]).hypot(refined[i][1] - truth[i][1]);
        (0..4).map(off).fold(0.0, f64::max)
    }

    #[test]
    fn corners_are_right_to_a_tenth_also_along_the_pixel_grid() {
        for (seed, turn) in
            [0.0, 0.003, 0.02, 0.4, 0.8, 1.1, std::f64::consts::FRAC_PI_2].into_iter().enumerate()
        {
            let off = worst(turn, 0.03, seed as u64);
            assert!(off < 0.12, "turned by {turn}: {off} px");
        }
    }

    #[test]
    fn small_markers_gain_too() {
        for seed in 0..6 {
            let off = worst(0.26 * seed as f64, 0.016, seed);
            assert!(off < 0.25, "{off} px");
        }
    }

    #[test]
    fn where_there_is_no_step_there_is_no_answer() {
        let picture = GrayImage { width: 64, height: 64, data: vec![90; 64 * 64] };
        let square = [[10.0, 50.0], [50.0, 50.0], [50.0, 10.0], [10.0, 10.0]];
        assert!(corners(&picture, &square, 8.0).is_none());
        let outside = square.map(|[x, y]| [x + 1e4, y]);
        assert!(corners(&picture, &outside, 8.0).is_none());
        let none = square.map(|_| [f64::NAN, 0.0]);
        assert!(corners(&picture, &none, 8.0).is_none());
        assert!(corners(&picture, &[[20.0, 20.0]; 4], 8.0).is_none());
    }

    #[test]
    fn the_approximation_is_the_normal_distribution() {
        assert!((normal(1.0).0 - 0.682689492).abs() < 1e-6 && (normal(-2.0).0 + 0.954499736).abs() < 1e-6);
        assert!((normal(0.5).1 - 0.352065327).abs() < 1e-6);
    }
}
