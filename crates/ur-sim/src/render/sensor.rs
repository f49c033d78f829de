//! From light to bytes: blur of lens and pixels, then noise, then eight bits.
//!
//! In: colours in grey levels, one triple a pixel. Out: RGB bytes. The noise is seeded by run and frame, so
//! that two frames never agree and a repeated run does.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::VecDeque;

/// Kernel radius of a sharp lens, px; a blurred one needs more.
const REACH: usize = 3;
/// Normal deviates kept for the noise.
const DEVIATES: usize = 4096;

/// What happens to the light on top of what lens and sensor do by themselves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exposure {
    /// Light times this.
    pub gain: f32,
    /// Share of the contrast that is lost to fog, 0 to 1.
    pub fog: f32,
    /// Further blur, standard deviation in px.
    pub blur_px: f64,
}

impl Default for Exposure {
    fn default() -> Exposure {
        Exposure { gain: 1.0, fog: 0.0, blur_px: 0.0 }
    }
}

impl Exposure {
    /// Brightness of fog, grey levels.
    const FOG: f32 = 190.0;

    /// Fog, then gain, in place.
    pub fn apply(&self, light: &mut [[f32; 3]]) {
        if (self.gain, self.fog) == (1.0, 0.0) {
            return;
        }
        for level in light.iter_mut().flatten() {
            *level = (*level + (Exposure::FOG - *level) * self.fog) * self.gain;
        }
    }
}

/// Blurs in place, rows then columns, with the border repeated.
pub fn blur(light: &mut [[f32; 3]], width: usize, sigma_px: f64) {
    let reach = REACH.max((3.0 * sigma_px.min(20.0)).ceil() as usize);
    let kernel = kernel(sigma_px, reach);
    let height = light.len() / width;
    let mut line = vec![[0.0f32; 3]; width + 2 * reach];
    for row in light.chunks_exact_mut(width) {
        line[reach..reach + width].copy_from_slice(row);
        line[..reach].fill(row[0]);
        line[reach + width..].fill(row[width - 1]);
        for (pixel, taps) in row.iter_mut().zip(line.windows(2 * reach + 1)) {
            *pixel = weigh(taps.iter(), &kernel);
        }
    }
    // Columns: a ring of the original rows, so that a row is overwritten only after all that need it were
    // made.
    let row_of = |y: isize| y.clamp(0, height as isize - 1) as usize;
    let mut ring: VecDeque<Vec<[f32; 3]>> =
        (-(reach as isize)..reach as isize).map(|y| light[row_of(y) * width..][..width].to_vec()).collect();
    for y in 0..height {
        ring.push_back(light[row_of((y + reach) as isize) * width..][..width].to_vec());
        let out = &mut light[y * width..][..width];
        out.fill([0.0; 3]);
        for (source, weight) in ring.iter().zip(&kernel) {
            for (pixel, other) in out.iter_mut().zip(source) {
                for c in 0..3 {
                    pixel[c] += weight * other[c];
                }
            }
        }
        ring.pop_front();
    }
}

fn weigh<'a>(taps: impl Iterator<Item = &'a [f32; 3]>, kernel: &[f32]) -> [f32; 3] {
    let mut sum = [0.0; 3];
    for (tap, weight) in taps.zip(kernel) {
        for c in 0..3 {
            sum[c] += weight * tap[c];
        }
    }
    sum
}

fn kernel(sigma_px: f64, reach: usize) -> Vec<f32> {
    let sigma = sigma_px.max(1e-3);
    let weight = |i: usize| (-(i as f64 - reach as f64).powi(2) / (2.0 * sigma * sigma)).exp();
    let weights: Vec<f64> = (0..=2 * reach).map(weight).collect();
    let sum: f64 = weights.iter().sum();
    weights.iter().map(|weight| (weight / sum) as f32).collect()
}

/// Normal deviates, quick to draw from.
pub struct Noise {
    deviates: Vec<f32>,
}

impl Noise {
    /// Deviates with that standard deviation, grey levels.
    pub fn new(sigma: f64) -> Noise {
        let mut rng = ChaCha8Rng::seed_from_u64(0x6e6f_6973);
        let uniform = |rng: &mut ChaCha8Rng| (rng.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
        let deviate = |_| {
            let (u, v) = (uniform(&mut rng), uniform(&mut rng));
            (sigma * (-2.0 * (1.0 - u).ln()).sqrt() * (std::f64::consts::TAU * v).cos()) as f32
        };
        Noise { deviates: (0..DEVIATES).map(deviate).collect() }
    }

    /// Adds noise and rounds to bytes.
    pub fn develop(&self, light: &[[f32; 3]], seed: u64, frame: u64) -> Vec<u8> {
        // Splitmix64 over a counter: well mixed, and cheap enough for three million numbers a frame.
        let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ frame.wrapping_mul(0xd1b5_4a32_d192_ed03);
        let mut bytes = Vec::with_capacity(light.len() * 3);
        for pixel in light {
            state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mut z = state;
            z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            z ^= z >> 31;
            for (c, level) in pixel.iter().enumerate() {
                let deviate = self.deviates[(z >> (12 * c + 8)) as usize % DEVIATES];
                bytes.push((level + deviate + 0.5).clamp(0.0, 255.0) as u8);
            }
        }
        bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blur_keeps_light_and_spreads_a_point_as_a_gaussian() {
        let (width, height) = (21, 15);
        let mut light = vec![[0.0f32; 3]; width * height];
        light[7 * width + 10] = [100.0, 50.0, 0.0];
        blur(&mut light, width, 0.7);
        let sum: f32 = light.iter().map(|p| p[0]).sum();
        assert!((sum - 100.0).abs() < 1e-3);
        let at = |x: usize, y: usize| light[y * width + x][0];
        assert!((at(11, 7) / at(10, 7) - (-1.0f32 / 0.98).exp()).abs() < 1e-4);
        assert_eq!(at(11, 7), at(10, 8));
        assert_eq!(at(9, 7), at(10, 6));
    }

    #[test]
    fn noise_has_its_sigma_and_never_repeats() {
        let light = vec![[100.0f32; 3]; 20000];
        let noise = Noise::new(2.0);
        let bytes = noise.develop(&light, 1, 1);
        let mean = bytes.iter().map(|b| f64::from(*b)).sum::<f64>() / bytes.len() as f64;
        let variance = bytes.iter().map(|b| (f64::from(*b) - mean).powi(2)).sum::<f64>() / bytes.len() as f64;
        assert!((mean - 100.0).abs() < 0.1 && (variance.sqrt() - 2.0).abs() < 0.1, "{mean} {variance}");
        assert_eq!(bytes, noise.develop(&light, 1, 1));
        assert_ne!(bytes, noise.develop(&light, 1, 2));
        assert_ne!(bytes, noise.develop(&light, 2, 1));
    }
}
