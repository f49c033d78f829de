//! The table's grain: a periodic field of smooth noise, the same in every picture.
//!
//! In: a place on the table, m. Out: grey levels to add, about +-6. Seeded once, not by the world: the table
//! top does not change from run to run.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Samples along one period.
const SIDE: usize = 256;
/// Distance of samples, m.
const PITCH_M: f64 = 2e-3;

/// The grain.
pub struct Texture {
    grain: Vec<f32>,
}

impl Texture {
    /// The one table top there is.
    pub fn new() -> Texture {
        let mut rng = ChaCha8Rng::seed_from_u64(0x7461_626c);
        let mut grain = vec![0.0f32; SIDE * SIDE];
        for (step, strength) in [(1usize, 1.0f32), (4, 2.0), (32, 3.0)] {
            let side = SIDE / step;
            let coarse: Vec<f32> = (0..side * side).map(|_| rng.random_range(-strength..=strength)).collect();
            for y in 0..SIDE {
                for x in 0..SIDE {
                    let (fx, fy) = ((x % step) as f32 / step as f32, (y % step) as f32 / step as f32);
                    let at =
                        |i: usize, j: usize| coarse[((y / step + j) % side) * side + (x / step + i) % side];
                    let upper = at(0, 0) * (1.0 - fx) + at(1, 0) * fx;
                    let lower = at(0, 1) * (1.0 - fx) + at(1, 1) * fx;
                    grain[y * SIDE + x] += upper * (1.0 - fy) + lower * fy;
                }
            }
        }
        Texture { grain }
    }

    /// Grey levels to add at a place, bilinear between samples.
    #[inline]
    pub fn at(&self, x_m: f64, y_m: f64) -> f32 {
        // Far enough into the positive that truncation is floor for every place a camera can see.
        let (u, v) = (x_m / PITCH_M + 65536.0, y_m / PITCH_M + 65536.0);
        let (i, j) = (u as usize, v as usize);
        let (s, t) = ((u - i as f64) as f32, (v - j as f64) as f32);
        let at = |i: usize, j: usize| self.grain[(j % SIDE) * SIDE + i % SIDE];
        let upper = at(i, j) * (1.0 - s) + at(i + 1, j) * s;
        let lower = at(i, j + 1) * (1.0 - s) + at(i + 1, j + 1) * s;
        upper * (1.0 - t) + lower * t
    }
}

impl Default for Texture {
    fn default() -> Texture {
        Texture::new()
    }
}
