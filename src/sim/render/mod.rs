//! The simulated camera: draws a scene as a lens and a sensor would see it.
//!
//! In: a [`Scene`] (a copy of the world at the moment of exposure), the camera's true pose and lens, a seed and a
//! frame number. Out: an RGB picture. Pure: the same arguments give the same bytes.
//!
//! How: one ray a pixel through the exact inverse of the lens ([`lens`]), met with prisms, prints and board ([`cast`]);
//! where neighbouring pixels see different surfaces, 16 rays; then blur, noise and eight bits ([`sensor`]). Exposure
//! is an instant: there is no motion blur, and no shadow. Uneven light is a smooth gain over the picture.

pub mod cast;
pub mod lens;
pub mod print;
pub mod scene;
pub mod sensor;
pub mod texture;

use crate::sim::render::cast::Caster;
use crate::sim::render::lens::{CameraTruth, RayGrid};
use crate::sim::render::scene::Scene;
use crate::sim::render::sensor::{Noise, blur};
use crate::sim::render::texture::Texture;
use nalgebra::Isometry3;

/// Rays along one side of a pixel on an edge.
const FINE: usize = 4;

/// A camera ready to draw: its lens is inverted once.
pub struct Renderer {
    camera: CameraTruth,
    grid: RayGrid,
    texture: Texture,
    noise: Noise,
}

impl Renderer {
    /// Prepares a camera; inverting the lens takes about 50 ms for 1280 x 720.
    pub fn new(camera: CameraTruth) -> Renderer {
        Renderer {
            grid: RayGrid::new(&camera),
            texture: Texture::new(),
            noise: Noise::new(camera.noise_sigma),
            camera,
        }
    }

    /// The camera.
    pub fn camera(&self) -> &CameraTruth {
        &self.camera
    }

    /// The picture of `scene` from `table_from_camera`; `seed` and `frame` choose the noise.
    pub fn render(&self, scene: &Scene, table_from_camera: &Isometry3<f64>, seed: u64, frame: u64) -> Image {
        let (width, height) = (self.camera.width as usize, self.camera.height as usize);
        let caster = Caster::new(scene, table_from_camera, &self.camera, &self.texture);
        let mut keys = vec![0u32; width * height];
        let mut light = vec![[0.0f32; 3]; width * height];
        for row in 0..height {
            for column in 0..width {
                let ray = self.grid.cell(column, row).at(0.5, 0.5);
                let sample = caster.sample(caster.candidates(column, row), ray);
                keys[row * width + column] = sample.key;
                light[row * width + column] = sample.colour;
            }
        }
        for row in 0..height {
            for column in 0..width {
                if on_edge(&keys, width, height, column, row) {
                    light[row * width + column] = self.fine_sample(&caster, column, row);
                }
            }
        }
        blur(&mut light, width, self.camera.blur_sigma_px);
        let rgb = self.noise.develop(&light, seed, frame);
        Image { width: self.camera.width, height: self.camera.height, rgb }
    }

    fn fine_sample(&self, caster: &Caster, column: usize, row: usize) -> [f32; 3] {
        let cell = self.grid.cell(column, row);
        let candidates = caster.candidates(column, row);
        let mut sum = [0.0f32; 3];
        for i in 0..FINE {
            for j in 0..FINE {
                let (s, t) = ((i as f64 + 0.5) / FINE as f64, (j as f64 + 0.5) / FINE as f64);
                let colour = caster.sample(candidates, cell.at(s, t)).colour;
                for c in 0..3 {
                    sum[c] += colour[c];
                }
            }
        }
        sum.map(|c| c / (FINE * FINE) as f32)
    }
}

/// True when one of the eight neighbours shows another surface.
fn on_edge(keys: &[u32], width: usize, height: usize, column: usize, row: usize) -> bool {
    let own = keys[row * width + column];
    let (left, right) = (column.saturating_sub(1), (column + 1).min(width - 1));
    (row.saturating_sub(1)..=(row + 1).min(height - 1))
        .any(|y| keys[y * width + left..=y * width + right].iter().any(|key| *key != own))
}

/// A picture: rows from the top, three bytes a pixel.
pub struct Image {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Red, green, blue.
    pub rgb: Vec<u8>,
}
