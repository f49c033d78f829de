//! The depth picture of a short-range stereo camera, aligned to the colour picture.
//!
//! In: true depth a pixel along the optical axis, m. Out: what stereo matching makes of it, in units of 0.1
//! mm, 0 where it finds nothing. Modelled after a D405 (baseline 18 mm, left picture = colour picture), with
//! these errors:
//! - disparity noise of `DISPARITY_SIGMA_PX`, smooth over a matching window, so that the error grows with
//!   the square of the distance (0.3 mm at 0.2 m, 1.7 mm at 0.5 m);
//! - a curved field: flat targets read up to `FIELD_CURVATURE` too far in the corners (librealsense issue
//!   13391);
//! - edges: within half a window of a step in depth the nearer surface wins, raggedly;
//! - holes: what the right imager cannot see beside a near object, what is nearer than 70 mm or beyond 3 m,
//!   specks, and everything in the dark.
//!
//! Pure: seeded by run and frame.

use crate::render::lens::CameraTruth;

/// Metres of one unit of the picture.
pub const UNIT_M: f64 = 1e-4;
/// Distance of the two imagers, m.
const BASELINE_M: f64 = 0.018;
/// Standard deviation of the disparity, px.
const DISPARITY_SIGMA_PX: f64 = 0.08;
/// Share by which the corners of a flat target read too far.
const FIELD_CURVATURE: f64 = 0.01;
/// Half the matching window, px.
const HALF_WINDOW: usize = 3;
/// A step in depth from here on is an edge, m.
const STEP_M: f64 = 4e-3;
/// Nearest and farthest depth that is found, m.
const RANGE_M: [f64; 2] = [0.07, 3.0];
/// Share of specks, each a window wide, in which nothing is found.
const SPECKS: f64 = 4e-4;
/// Light (gain) below which nothing is found.
const DARK: f32 = 0.08;

/// A depth picture: row by row, in [`UNIT_M`], 0 where nothing was found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DepthImage {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Depth along the optical axis.
    pub units: Vec<u16>,
}

/// What the matching finds; `truth` row by row, not finite where nothing is met.
pub fn match_stereo(camera: &CameraTruth, truth: &[f32], gain: f32, seed: [u64; 2]) -> DepthImage {
    let (width, height) = (camera.width as usize, camera.height as usize);
    let mut units = vec![0u16; truth.len()];
    if gain >= DARK {
        let noise = Noise::new(width, height, seed);
        let half_diagonal2 = (width as f64 / 2.0).powi(2) + (height as f64 / 2.0).powi(2);
        for row in 0..height {
            let line = &truth[row * width..][..width];
            let hidden = hidden(line, camera.fx);
            for column in 0..width {
                let rough = noise.at(column, row);
                if hidden[column] || rough.speck {
                    continue;
                }
                let near = at_edge(line, column, &rough);
                let (dx, dy) = (column as f64 - camera.cx, row as f64 - camera.cy);
                let curved = 1.0 + FIELD_CURVATURE * (dx * dx + dy * dy) / half_diagonal2;
                let disparity = camera.fx * BASELINE_M / f64::from(near) + rough.deviate * DISPARITY_SIGMA_PX;
                let depth_m = camera.fx * BASELINE_M / disparity * curved;
                if (RANGE_M[0]..=RANGE_M[1]).contains(&depth_m) {
                    units[row * width + column] = (depth_m / UNIT_M).round() as u16;
                }
            }
        }
    }
    DepthImage { width: camera.width, height: camera.height, units }
}

/// Pixels of a line whose point the right imager cannot see: something nearer further right has a disparity
/// so much larger that it covers them.
fn hidden(line: &[f32], fx: f64) -> Vec<bool> {
    let mut hidden = vec![false; line.len()];
    // Column of the right picture that is covered so far, coming from the right.
    let mut covered = f64::MAX;
    for column in (0..line.len()).rev() {
        let disparity = fx * BASELINE_M / f64::from(line[column]).max(1e-3);
        let seen_at = column as f64 - disparity;
        hidden[column] = seen_at > covered + 1.0 || !line[column].is_finite();
        covered = covered.min(seen_at);
    }
    hidden
}

/// Depth at a pixel: near a step, that of the nearer surface if it is within reach of the ragged window.
fn at_edge(line: &[f32], column: usize, rough: &Rough) -> f32 {
    let reach = ((HALF_WINDOW as f64) * rough.ragged).round() as usize;
    let window = &line[column.saturating_sub(reach)..=(column + reach).min(line.len() - 1)];
    let nearest = window.iter().copied().fold(f32::MAX, f32::min);
    if f64::from(line[column] - nearest) > STEP_M { nearest } else { line[column] }
}

/// The noise at a pixel.
struct Rough {
    /// Standard normal, smooth over a window.
    deviate: f64,
    /// How much of the half window reaches here, 0 to 1.
    ragged: f64,
    /// Nothing is found here.
    speck: bool,
}

/// Smooth noise: deviates on a grid a window apart, interpolated.
struct Noise {
    across: usize,
    cells: Vec<[f32; 3]>,
}

impl Noise {
    const PITCH: usize = 2 * HALF_WINDOW;

    fn new(width: usize, height: usize, [seed, frame]: [u64; 2]) -> Noise {
        let across = width / Noise::PITCH + 2;
        let down = height / Noise::PITCH + 2;
        let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ frame.wrapping_mul(0xa24b_aed4_963e_e407);
        let mut uniform = || {
            state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mut z = state;
            z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
        };
        let cells = (0..across * down)
            .map(|_| {
                let (u, v) = (uniform(), uniform());
                let deviate = (-2.0 * (1.0 - u).ln()).sqrt() * (std::f64::consts::TAU * v).cos();
                [deviate as f32, uniform() as f32, f32::from(uniform() < SPECKS)]
            })
            .collect();
        Noise { across, cells }
    }

    fn at(&self, column: usize, row: usize) -> Rough {
        let (i, j) = (column / Noise::PITCH, row / Noise::PITCH);
        let s = (column % Noise::PITCH) as f64 / Noise::PITCH as f64;
        let t = (row % Noise::PITCH) as f64 / Noise::PITCH as f64;
        let cell = |i: usize, j: usize| self.cells[j * self.across + i];
        let weights = [(1.0 - s) * (1.0 - t), s * (1.0 - t), (1.0 - s) * t, s * t];
        let corners = [cell(i, j), cell(i + 1, j), cell(i, j + 1), cell(i + 1, j + 1)];
        let sum: f64 = weights.iter().zip(&corners).map(|(w, c)| w * f64::from(c[0])).sum();
        // The weights' squares do not add up to 1 between the grid's points; the noise keeps its size.
        let size = weights.iter().map(|w| w * w).sum::<f64>().sqrt();
        Rough { deviate: sum / size, ragged: f64::from(corners[0][1]), speck: corners[0][2] > 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> CameraTruth {
        CameraTruth::ideal("t", 320, 180, 650.0)
    }

    fn depths(image: &DepthImage, columns: std::ops::Range<usize>) -> Vec<f64> {
        let rows = 60..120;
        rows.flat_map(|row| columns.clone().map(move |column| row * 320 + column))
            .map(|at| f64::from(image.units[at]) * UNIT_M)
            .collect()
    }

    #[test]
    fn noise_grows_with_the_square_of_the_distance() {
        for (distance, wanted) in [(0.2, 0.27e-3), (0.4, 1.09e-3)] {
            let found = match_stereo(&camera(), &vec![distance as f32; 320 * 180], 1.0, [1, 1]);
            let values: Vec<f64> = depths(&found, 130..190).into_iter().filter(|z| *z > 0.0).collect();
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            let deviation =
                (values.iter().map(|z| (z - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt();
            assert!((mean - distance).abs() < 3.0 * wanted / 10.0_f64.sqrt(), "{mean}");
            assert!((deviation / wanted - 1.0).abs() < 0.3, "{deviation} at {distance}");
        }
    }

    #[test]
    fn beside_a_near_object_the_far_side_is_hidden_and_edges_are_ragged() {
        let mut truth = vec![0.5f32; 320 * 180];
        for row in 0..180 {
            truth[row * 320 + 160..][..60].fill(0.3);
        }
        let found = match_stereo(&camera(), &truth, 1.0, [1, 1]);
        // Disparities 39 and 23.4 px: 15.6 columns left of the object are seen by one imager only.
        assert!(depths(&found, 147..157).iter().all(|z| *z == 0.0));
        assert!(depths(&found, 120..140).iter().filter(|z| **z == 0.0).count() < 20);
        assert!(depths(&found, 230..300).iter().all(|z| *z == 0.0 || (*z - 0.5).abs() < 0.02));
        let beyond = depths(&found, 220..223);
        let near = beyond.iter().filter(|z| (**z - 0.3).abs() < 0.02).count();
        assert!(near > 20 && near < beyond.len() - 20, "{near} of {}", beyond.len());
    }

    #[test]
    fn nothing_is_found_too_near_in_the_void_or_in_the_dark() {
        let all = |depth: f32, gain: f32| {
            match_stereo(&camera(), &vec![depth; 320 * 180], gain, [1, 1]).units.iter().all(|u| *u == 0)
        };
        assert!(all(0.05, 1.0) && all(f32::INFINITY, 1.0) && all(0.3, 0.01));
        assert!(!all(0.3, 1.0));
    }

    #[test]
    fn frames_repeat_by_seed_and_number() {
        let draw = |frame| match_stereo(&camera(), &vec![0.4f32; 320 * 180], 1.0, [7, frame]);
        assert_eq!(draw(1), draw(1));
        assert_ne!(draw(1), draw(2));
    }
}
