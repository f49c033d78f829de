//! The simulated camera: draws a scene as a lens and a sensor would see it.
//!
//! In: a [`Scene`] (a copy of the world at the moment of exposure), the camera's true pose and lens, a seed
//! and a frame number. Out: an RGB picture. Pure: the same arguments give the same bytes.
//!
//! How: one ray a pixel through the exact inverse of the lens ([`lens`]), met with prisms, prints and board
//! ([`cast`]); where neighbouring pixels see different surfaces, 16 rays; then blur, noise and eight bits
//! ([`sensor`]). A camera that moves while it exposes is drawn from several places along its way; there is
//! no shadow. Uneven light is a smooth gain over the picture. Depth pictures are the same rays' lengths with
//! the errors of stereo matching ([`depth`]).

pub mod cast;
pub mod depth;
pub mod lens;
pub mod scene;
pub mod sensor;
pub mod texture;

use crate::render::cast::Caster;
use crate::render::depth::{DepthImage, match_stereo};
use crate::render::lens::{CameraTruth, RayGrid};
use crate::render::scene::Scene;
use crate::render::sensor::{Exposure, Noise, blur};
use crate::render::texture::Texture;
use cell_values::image::Image;
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
        self.expose(scene, table_from_camera, &Exposure::default(), [seed, frame])
    }

    /// The same with something wrong with light or lens; `noise` is seed and frame.
    pub fn expose(
        &self,
        scene: &Scene,
        table_from_camera: &Isometry3<f64>,
        exposure: &Exposure,
        noise: [u64; 2],
    ) -> Image {
        self.expose_along(scene, std::slice::from_ref(table_from_camera), exposure, noise)
    }

    /// The same by a camera that moves: the mean of the light at places along its way, then blur and noise
    /// once.
    pub fn expose_along(
        &self,
        scene: &Scene,
        table_from_camera: &[Isometry3<f64>],
        exposure: &Exposure,
        noise: [u64; 2],
    ) -> Image {
        let mut places = table_from_camera.iter();
        let first = places.next().copied().unwrap_or_default();
        let mut light = self.light(scene, &first);
        for place in places {
            for (sum, more) in light.iter_mut().zip(self.light(scene, place)) {
                (0..3).for_each(|c| sum[c] += more[c]);
            }
        }
        let share = 1.0 / table_from_camera.len().max(1) as f32;
        light.iter_mut().for_each(|colour| *colour = colour.map(|c| c * share));
        blur(&mut light, self.camera.width as usize, self.camera.blur_sigma_px.hypot(exposure.blur_px));
        exposure.apply(&mut light);
        let rgb = self.noise.develop(&light, noise[0], noise[1]);
        Image { width: self.camera.width, height: self.camera.height, rgb }
    }

    /// The light that reaches each pixel from one place.
    fn light(&self, scene: &Scene, table_from_camera: &Isometry3<f64>) -> Vec<[f32; 3]> {
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
        light
    }

    /// The depth picture of the same moment and place, aligned to the colour picture; `noise` is seed and
    /// frame.
    pub fn expose_depth(
        &self,
        scene: &Scene,
        table_from_camera: &Isometry3<f64>,
        exposure: &Exposure,
        noise: [u64; 2],
    ) -> DepthImage {
        let (width, height) = (self.camera.width as usize, self.camera.height as usize);
        let caster = Caster::new(scene, table_from_camera, &self.camera, &self.texture);
        let depth = |row: usize, column: usize| {
            caster.depth(caster.candidates(column, row), self.grid.cell(column, row).at(0.5, 0.5)) as f32
        };
        let truth: Vec<f32> = (0..height)
            .flat_map(|row| (0..width).map(move |column| (row, column)))
            .map(|(r, c)| depth(r, c))
            .collect();
        match_stereo(&self.camera, &truth, exposure.gain, noise)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::scene::{Prism, look_at};
    use crate::world::section::Section;
    use nalgebra::Point3;
    use rearrange::geometry::pose::Pose2;
    use std::sync::Arc;

    fn camera() -> CameraTruth {
        let mut camera = CameraTruth::ideal("t", 320, 180, 300.0);
        camera.distortion = [-0.05, 0.06, 8e-4, -7e-4, -0.02];
        camera.noise_sigma = 0.0;
        camera
    }

    fn prism(section: Section, pose: Pose2, height_m: f64) -> Prism {
        Prism {
            table_from_prism: pose.at_height(0.0),
            section: Arc::new(section),
            height_m,
            colour: [0; 3],
            prints: Vec::new(),
        }
    }

    fn scene(prisms: Vec<Prism>) -> Scene {
        let table_from_flange = Isometry3::identity();
        Scene { board: [-1.0, -1.0, 1.0, 1.0], table_from_flange, prisms, prints: Vec::new() }
    }

    /// Sum of (1 - level / background) over the picture: the dark area in px, and its centre of mass.
    fn dark_area(with: &Image, without: &Image) -> (f64, [f64; 2]) {
        let (mut area, mut centre) = (0.0, [0.0; 2]);
        for row in 0..with.height {
            for column in 0..with.width {
                let at = 3 * (row * with.width + column) as usize;
                let share = 1.0 - f64::from(with.rgb[at]) / f64::from(without.rgb[at]);
                area += share;
                centre[0] += share * f64::from(column);
                centre[1] += share * f64::from(row);
            }
        }
        (area, centre.map(|c| c / area))
    }

    #[test]
    fn a_thin_disc_covers_the_pixels_the_lens_gives_it() {
        let renderer = Renderer::new(camera());
        let eye = look_at([0.03, -0.05, 0.4], [0.02, 0.01, 0.0], [1.0, 0.0, 0.0]);
        let disc = prism(Section::ellipse(0.1, 0.06), Pose2::new(0.04, 0.02, 0.5), 1e-4);
        let outline = Section::ellipse(0.1, 0.06);
        let [with, without] = [scene(vec![disc]), scene(Vec::new())].map(|s| renderer.render(&s, &eye, 0, 0));
        let (area, centre) = dark_area(&with, &without);
        // The same by projecting the outline and integrating it (shoelace).
        let pose = Pose2::new(0.04, 0.02, 0.5);
        let crate::world::section::Shape::Ellipse(half) = outline.shape() else { panic!() };
        let pixels: Vec<[f64; 2]> = (0..2000)
            .map(|i| {
                let (sin, cos) = (f64::from(i) * std::f64::consts::TAU / 2000.0).sin_cos();
                let [x, y] = pose.transform([half[0] * cos, half[1] * sin]);
                let p = eye.inverse() * Point3::new(x, y, 1e-4);
                renderer.camera().project([p.x, p.y, p.z]).unwrap()
            })
            .collect();
        let (mut twice, mut moment) = (0.0, [0.0; 2]);
        for (a, b) in crate::world::section::edges(&pixels) {
            let cross = a[0] * b[1] - b[0] * a[1];
            twice += cross;
            moment[0] += cross * (a[0] + b[0]) / 3.0;
            moment[1] += cross * (a[1] + b[1]) / 3.0;
        }
        let wanted = [moment[0] / twice, moment[1] / twice];
        assert!((area / (twice.abs() / 2.0) - 1.0).abs() < 5e-3, "{area} {twice}");
        assert!((centre[0] - wanted[0]).hypot(centre[1] - wanted[1]) < 0.03, "{centre:?} {wanted:?}");
    }

    #[test]
    fn walls_are_seen_from_the_side_and_near_bodies_hide_far_ones() {
        let renderer = Renderer::new(camera());
        let eye = look_at([0.0, -0.3, 0.25], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]);
        let mut low = prism(Section::rectangle(0.1, 0.02), Pose2::new(0.0, 0.05, 0.0), 0.02);
        low.colour = [200, 0, 0];
        let mut tall = prism(Section::rectangle(0.1, 0.02), Pose2::new(0.0, 0.0, 0.0), 0.1);
        tall.colour = [0, 200, 0];
        let picture = renderer.render(&scene(vec![low, tall]), &eye, 0, 0);
        let level = |point: [f64; 3]| {
            let p = eye.inverse() * Point3::from(point);
            let [u, v] = renderer.camera().project([p.x, p.y, p.z]).unwrap();
            let at = 3 * (v.round() as usize * 320 + u.round() as usize);
            [picture.rgb[at], picture.rgb[at + 1], picture.rgb[at + 2]]
        };
        let (wall, top, hidden) =
            (level([0.0, -0.01, 0.05]), level([0.0, 0.0, 0.1]), level([0.0, 0.05, 0.02]));
        assert!(wall[1] > 60 && wall[0] < 10, "{wall:?}");
        assert!(top[1] > wall[1] + 20, "{top:?} {wall:?}");
        assert!(hidden[0] < 10, "the low body is behind the tall one: {hidden:?}");
        assert!(level([0.049, 0.05, 0.02])[0] < 10 && level([0.2, 0.05, 0.0])[0] > 100);
    }

    #[test]
    fn depth_is_that_of_the_surfaces_that_are_seen() {
        let renderer = Renderer::new(camera());
        let eye = look_at([0.0, 0.0, 0.4], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]);
        let block = prism(Section::rectangle(0.1, 0.1), Pose2::new(0.0, 0.0, 0.0), 0.05);
        let picture = renderer.expose_depth(&scene(vec![block]), &eye, &Exposure::default(), [1, 1]);
        let mean = |centre: [f64; 3]| {
            let p = eye.inverse() * Point3::from(centre);
            let [u, v] = renderer.camera().project([p.x, p.y, p.z]).unwrap();
            let (u, v) = (u.round() as usize, v.round() as usize);
            let values: Vec<f64> = (v - 6..v + 6)
                .flat_map(|row| (u - 6..u + 6).map(move |column| row * 320 + column))
                .map(|at| f64::from(picture.units[at]) * depth::UNIT_M)
                .filter(|z| *z > 0.0)
                .collect();
            values.iter().sum::<f64>() / values.len() as f64
        };
        assert!((mean([0.0, 0.0, 0.05]) - 0.35).abs() < 2e-3, "{}", mean([0.0, 0.0, 0.05]));
        assert!((mean([0.12, 0.0, 0.0]) - 0.40).abs() < 5e-3, "{}", mean([0.12, 0.0, 0.0]));
    }

    #[test]
    fn frames_repeat_by_seed_and_number() {
        let mut camera = camera();
        camera.noise_sigma = 2.0;
        let renderer = Renderer::new(camera);
        let eye = look_at([0.0, -0.1, 0.4], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]);
        let draw = |seed, frame| renderer.render(&scene(Vec::new()), &eye, seed, frame).rgb;
        assert_eq!(draw(1, 1), draw(1, 1));
        assert_ne!(draw(1, 1), draw(1, 2));
    }

    #[test]
    fn a_camera_inside_or_beside_things_draws_without_trouble() {
        let renderer = Renderer::new(camera());
        let body = || prism(Section::rectangle(0.4, 0.4), Pose2::new(0.0, 0.0, 0.0), 0.5);
        let inside = look_at([0.0, 0.0, 0.25], [0.3, 0.0, 0.2], [0.0, 1.0, 0.0]);
        let up = look_at([0.0, 0.0, 0.1], [0.0, 0.01, 0.9], [1.0, 0.0, 0.0]);
        let level = look_at([-1.0, 0.0, 0.25], [0.0, 0.0, 0.25], [0.0, -1.0, 0.0]);
        for eye in [inside, up, level] {
            assert_eq!(renderer.render(&scene(vec![body()]), &eye, 0, 0).rgb.len(), 320 * 180 * 3);
        }
    }
}
