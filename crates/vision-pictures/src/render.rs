//! Pictures for the vision benchmark: flat prints over a flat ground, seen through a distorting lens.
//!
//! In: a lens, a camera pose, prints with their grey levels, a ground, a seed. Out: a grey picture: 4 x 4
//! rays a pixel, 8 x 8 on a print's edges, light that falls off across it, blurred, with noise, rounded to 8
//! bits. Written for the benchmark alone: it shares no code with detection, OpenCV or the simulated camera,
//! so that one misread convention cannot agree with itself.

use cell_values::image::GrayImage;
use cell_vision::camera::CameraModel;
use cell_vision::detect::family::Pattern;
use nalgebra::{Isometry3, Point3, Vector3};
use rand::{Rng, RngExt};
use rand_chacha::ChaCha8Rng;

/// Rays along each edge of a pixel of the ground, and of one that an edge of a print crosses.
const RAYS: usize = 4;
const EDGE_RAYS: usize = 8;

/// A lens with the direction of every pixel's corners worked out.
#[derive(Debug)]
pub struct Lens {
    /// Its numbers.
    pub camera: CameraModel,
    /// Normalised coordinates of the corners between pixels, `(width + 1) * (height + 1)` by rows.
    directions: Vec<[f64; 2]>,
    /// Normal deviates to draw noise from.
    noise: Vec<f32>,
}

impl Lens {
    /// Works the directions out; `seed` is that of the noise table.
    pub fn new(camera: CameraModel, random: &mut ChaCha8Rng) -> Lens {
        let (columns, rows) = (camera.width + 1, camera.height + 1);
        let corners = (0..rows).flat_map(|row| (0..columns).map(move |column| (column, row)));
        let direction = |(column, row)| straight(&camera, [f64::from(column) - 0.5, f64::from(row) - 0.5]);
        let directions = corners.map(direction).collect();
        let noise = (0..1 << 16).map(|_| normal(random) as f32).collect();
        Lens { camera, directions, noise }
    }

    /// A point in the camera frame to its pixel; `None` behind the camera.
    pub fn project(&self, point: &Point3<f64>) -> Option<[f64; 2]> {
        (point.z > 1e-3).then(|| {
            let [x, y] = bent(&self.camera, point.x / point.z, point.y / point.z);
            [self.camera.fx * x + self.camera.cx, self.camera.fy * y + self.camera.cy]
        })
    }

    fn direction(&self, column: usize, row: usize) -> Vector3<f64> {
        let [x, y] = self.directions[row * (self.camera.width as usize + 1) + column];
        Vector3::new(x, y, 1.0)
    }
}

/// Lens distortion by Brown's radial and decentring terms.
fn bent(camera: &CameraModel, x: f64, y: f64) -> [f64; 2] {
    let [k1, k2, p1, p2, k3] = camera.distortion;
    let square = x * x + y * y;
    let stretch = 1.0 + k1 * square + k2 * square.powi(2) + k3 * square.powi(3);
    let shear = 2.0 * (p1 * y + p2 * x);
    [x * (stretch + shear) + p2 * square, y * (stretch + shear) + p1 * square]
}

/// The direction that a pixel looks in: [`bent`] undone by secant steps.
fn straight(camera: &CameraModel, pixel: [f64; 2]) -> [f64; 2] {
    let seen = [(pixel[0] - camera.cx) / camera.fx, (pixel[1] - camera.cy) / camera.fy];
    let mut at = seen;
    for _ in 0..40 {
        let there = bent(camera, at[0], at[1]);
        let miss = [seen[0] - there[0], seen[1] - there[1]];
        at = [at[0] + 0.8 * miss[0], at[1] + 0.8 * miss[1]];
        if miss[0].hypot(miss[1]) < 1e-13 {
            break;
        }
    }
    at
}

/// A marker on a flat top.
#[derive(Clone, Debug)]
pub struct Print {
    /// Its modules.
    pub pattern: Pattern,
    /// Edge of its square, m.
    pub size_m: f64,
    /// Where it is.
    pub table_from_marker: Isometry3<f64>,
    /// Grey levels of black and white.
    pub greys: [f32; 2],
    /// Width of the top that shows round the print, m, and its grey level.
    pub rim: (f64, f32),
}

impl Print {
    /// Half the edge of the whole top, m.
    pub fn reach_m(&self) -> f64 {
        self.pattern.print_edge_m(self.size_m) / 2.0 + self.rim.0
    }

    /// The corners of the whole top in the picture; `None` when one is behind the camera.
    pub fn outline(&self, lens: &Lens, table_from_camera: &Isometry3<f64>) -> Option<[[f64; 2]; 4]> {
        self.square(self.reach_m(), lens, table_from_camera)
    }

    /// The corners of the marker's square in the picture, in the order in which detections give them.
    pub fn corners(&self, lens: &Lens, table_from_camera: &Isometry3<f64>) -> Option<[[f64; 2]; 4]> {
        self.square(self.size_m / 2.0, lens, table_from_camera)
    }

    fn square(&self, half: f64, lens: &Lens, table_from_camera: &Isometry3<f64>) -> Option<[[f64; 2]; 4]> {
        let camera_from_marker = table_from_camera.inverse() * self.table_from_marker;
        let mut pixels = [[0.0; 2]; 4];
        for (pixel, (x, y)) in
            pixels.iter_mut().zip([(-half, -half), (half, -half), (half, half), (-half, half)])
        {
            *pixel = lens.project(&(camera_from_marker * Point3::new(x, y, 0.0)))?;
        }
        Some(pixels)
    }

    /// Number of the module at a place of the marker's plane, `None` beside the modules.
    fn module(&self, [x, y]: [f64; 2]) -> Option<usize> {
        let modules = self.pattern.modules as f64;
        let module = |value: f64| value / self.size_m * self.pattern.square_modules as f64 + modules / 2.0;
        let inside = |value: &f64| (0.0..modules).contains(value);
        let [column, up] = [module(x), module(y)];
        (inside(&column) && inside(&up)).then(|| up as usize * self.pattern.modules + column as usize)
    }

    /// Grey level at a place of the marker's plane, `None` beside the top, which reaches so far.
    fn grey(&self, reach: f64, x: f64, y: f64) -> Option<f32> {
        if x.abs() >= reach || y.abs() >= reach {
            return None;
        }
        let Some(module) = self.module([x, y]) else { return Some(self.rim.1) };
        let (column, up) = (module % self.pattern.modules, module / self.pattern.modules);
        let row = self.pattern.modules - 1 - up;
        Some(self.greys[usize::from(self.pattern.is_white(column, row))])
    }
}

/// What lies under the prints, at table height.
#[derive(Clone, Debug)]
pub enum Ground<'a> {
    /// One grey level.
    Plain(f32),
    /// A printed sheet, repeated: its origin on the table (m) and its turn (rad).
    Sheet(&'a Sheet, [f64; 2], f64),
}

/// A square piece of printed ground.
#[derive(Clone, Debug)]
pub struct Sheet {
    /// Grey levels, `edge * edge` by rows.
    pub greys: Vec<u8>,
    /// Pixels along an edge.
    pub edge: usize,
    /// Edge of a pixel, m.
    pub pixel_m: f64,
}

impl Sheet {
    fn grey(&self, x: f64, y: f64) -> f32 {
        let at = |value: f64| ((value / self.pixel_m).floor() as i64).rem_euclid(self.edge as i64) as usize;
        f32::from(self.greys[at(y) * self.edge + at(x)])
    }
}

/// How the picture degrades.
#[derive(Clone, Copy, Debug)]
pub struct Degrade {
    /// Gaussian blur, standard deviation, pixels.
    pub blur_px: f64,
    /// Noise, standard deviation, grey levels.
    pub noise: f32,
    /// Light lost from one side of the picture to the other, as a share.
    pub gradient: f64,
}

/// The picture. Prints must not cover each other.
pub fn render(
    lens: &Lens,
    table_from_camera: &Isometry3<f64>,
    ground: &Ground,
    prints: &[Print],
    degrade: Degrade,
    random: &mut ChaCha8Rng,
) -> GrayImage {
    let (width, height) = (lens.camera.width as usize, lens.camera.height as usize);
    let mut light = match ground {
        Ground::Plain(grey) => vec![*grey; width * height],
        Ground::Sheet(sheet, origin, turn) => spread(lens, table_from_camera, sheet, *origin, *turn),
    };
    for print in prints {
        paint(lens, table_from_camera, print, &mut light);
    }
    shade(&mut light, width, degrade.gradient, random.random_range(0.0..std::f64::consts::TAU));
    blur(&mut light, width, degrade.blur_px);
    let mut noise = vec![0_u8; 2 * light.len()];
    random.fill_bytes(&mut noise);
    let draw = |bytes: &[u8]| lens.noise[usize::from(u16::from_le_bytes([bytes[0], bytes[1]]))];
    let data = light.iter().zip(noise.chunks_exact(2));
    let data =
        data.map(|(value, bytes)| (value + degrade.noise * draw(bytes)).round().clamp(0.0, 255.0) as u8);
    GrayImage { width: lens.camera.width, height: lens.camera.height, data: data.collect() }
}

/// Places where the rays through a row of pixel corners meet a plane z = 0, in that plane's frame.
fn meet(
    lens: &Lens,
    plane_from_camera: &Isometry3<f64>,
    columns: std::ops::RangeInclusive<usize>,
    row: usize,
) -> Vec<[f64; 2]> {
    let origin = plane_from_camera.translation.vector;
    let hit = |column| {
        let ray = plane_from_camera.rotation * lens.direction(column, row);
        let place = origin - ray * (origin.z / ray.z);
        [place.x, place.y]
    };
    columns.map(hit).collect()
}

/// Mean grey of the rays of one pixel and the share that met something; the plane is flat, so that inside a
/// pixel the places follow from those of its corners.
fn pixel(corners: [[f64; 2]; 4], rays: usize, grey: impl Fn(f64, f64) -> Option<f32>) -> (f32, f32) {
    let (mut sum, mut hits) = (0.0, 0.0);
    let [a, b, c, d] = corners;
    for i in 0..rays * rays {
        // Sheared, so that a side along the pixel grid is cut at `rays` squared places: else it would be
        // drawn up to an eighth of a pixel off.
        let (across, down) = (i % rays, i / rays);
        let cell = |a: usize, b: usize| (a as f64 + (b as f64 + 0.5) / rays as f64) / rays as f64;
        let (u, v) = (cell(across, down), cell(down, across));
        let mix = |k: usize| (a[k] * (1.0 - u) + b[k] * u) * (1.0 - v) + (c[k] * (1.0 - u) + d[k] * u) * v;
        if let Some(grey) = grey(mix(0), mix(1)) {
            sum += grey;
            hits += 1.0;
        }
    }
    (sum / (rays * rays) as f32, hits / (rays * rays) as f32)
}

/// The ground sheet over the whole picture.
fn spread(
    lens: &Lens,
    table_from_camera: &Isometry3<f64>,
    sheet: &Sheet,
    origin: [f64; 2],
    turn: f64,
) -> Vec<f32> {
    let table_from_sheet =
        Isometry3::new(Vector3::new(origin[0], origin[1], 0.0), Vector3::new(0.0, 0.0, turn));
    let sheet_from_camera = table_from_sheet.inverse() * table_from_camera;
    let (width, height) = (lens.camera.width as usize, lens.camera.height as usize);
    let mut light = Vec::with_capacity(width * height);
    let mut above = meet(lens, &sheet_from_camera, 0..=width, 0);
    for row in 0..height {
        let below = meet(lens, &sheet_from_camera, 0..=width, row + 1);
        light.extend((0..width).map(|i| {
            pixel([above[i], above[i + 1], below[i], below[i + 1]], RAYS, |x, y| Some(sheet.grey(x, y))).0
        }));
        above = below;
    }
    light
}

/// Paints one print over what is there.
fn paint(lens: &Lens, table_from_camera: &Isometry3<f64>, print: &Print, light: &mut [f32]) {
    let (width, height) = (lens.camera.width as usize, lens.camera.height as usize);
    let Some(outline) = print.outline(lens, table_from_camera) else { return };
    let bound = |axis: usize, size: usize| {
        let values = outline.map(|corner| corner[axis]);
        let low = values.iter().copied().fold(f64::INFINITY, f64::min) - 2.0;
        let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max) + 2.0;
        (high >= 0.0 && low < size as f64).then(|| (low.max(0.0) as usize, (high as usize).min(size - 1)))
    };
    let (Some((left, right)), Some((top, bottom))) = (bound(0, width), bound(1, height)) else { return };
    let marker_from_camera = print.table_from_marker.inverse() * table_from_camera;
    let reach = print.reach_m();
    let mut above = meet(lens, &marker_from_camera, left..=right + 1, top);
    for row in top..=bottom {
        let below = meet(lens, &marker_from_camera, left..=right + 1, row + 1);
        for i in 0..=right - left {
            let corners = [above[i], above[i + 1], below[i], below[i + 1]];
            let module = print.module(corners[0]);
            // A pixel all of whose corners lie in one module has its grey: modules have no bays.
            let plain = module.is_some() && corners[1..].iter().all(|corner| print.module(*corner) == module);
            let rays = if plain { 1 } else { EDGE_RAYS };
            let (grey, share) = pixel(corners, rays, |x, y| print.grey(reach, x, y));
            let there = &mut light[row * width + left + i];
            *there = *there * (1.0 - share) + grey;
        }
        above = below;
    }
}

/// Dims the picture linearly across, along `direction`.
fn shade(light: &mut [f32], width: usize, loss: f64, direction: f64) {
    let height = light.len() / width;
    let (cos, sin) = (direction.cos(), direction.sin());
    let reach = (width as f64 * cos.abs() + height as f64 * sin.abs()) / 2.0;
    for (row, line) in light.chunks_exact_mut(width).enumerate() {
        for (column, value) in line.iter_mut().enumerate() {
            let (x, y) = (column as f64 - width as f64 / 2.0, row as f64 - height as f64 / 2.0);
            let across = (x * cos + y * sin) / reach * 0.5 + 0.5;
            *value *= (1.0 - loss * across) as f32;
        }
    }
}

/// Gaussian blur, rows then columns, the border repeated.
fn blur(light: &mut [f32], width: usize, sigma: f64) {
    if sigma <= 0.0 {
        return;
    }
    let height = light.len() / width;
    let reach = (3.5 * sigma).ceil() as isize;
    let weights: Vec<f64> = (-reach..=reach).map(|i| (-0.5 * (i as f64 / sigma).powi(2)).exp()).collect();
    let total: f64 = weights.iter().sum();
    let weights: Vec<f32> = weights.iter().map(|weight| (weight / total) as f32).collect();
    let near = |i: isize, size: usize| i.clamp(0, size as isize - 1) as usize;
    let mut across = vec![0.0_f32; light.len()];
    let mut padded = vec![0.0_f32; width + 2 * reach as usize];
    for (line, out) in light.chunks_exact(width).zip(across.chunks_exact_mut(width)) {
        for (i, value) in padded.iter_mut().enumerate() {
            *value = line[near(i as isize - reach, width)];
        }
        for (k, weight) in weights.iter().enumerate() {
            out.iter_mut().zip(&padded[k..]).for_each(|(out, value)| *out += weight * value);
        }
    }
    light.fill(0.0);
    for row in 0..height {
        let out = &mut light[row * width..(row + 1) * width];
        for (k, weight) in weights.iter().enumerate() {
            let from = near(row as isize + k as isize - reach, height) * width;
            out.iter_mut().zip(&across[from..from + width]).for_each(|(out, value)| *out += weight * value);
        }
    }
}

/// A standard normal number (Box and Muller).
fn normal(random: &mut ChaCha8Rng) -> f64 {
    let (u, v): (f64, f64) = (random.random(), random.random());
    (-2.0 * (1.0 - u).ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::{bench_camera, looking_down};
    use cell_vision::cv;
    use cell_vision::detect::Family;
    use rand::SeedableRng;

    fn small() -> (Lens, ChaCha8Rng) {
        let mut random = ChaCha8Rng::seed_from_u64(4);
        let camera = CameraModel { width: 160, height: 120, cx: 80.4, cy: 58.7, ..bench_camera() };
        (Lens::new(camera, &mut random), random)
    }

    #[test]
    fn the_forward_model_is_opencvs_and_its_inverse_undoes_it() {
        let camera = bench_camera();
        for pixel in [[0.0, 0.0], [1279.0, 719.0], [640.0, 20.0], [1250.0, 300.0]] {
            let [x, y] = straight(&camera, pixel);
            let there = cv::project(&camera, &Isometry3::identity(), &[[x, y, 1.0]]).unwrap()[0];
            assert!((there[0] - pixel[0]).hypot(there[1] - pixel[1]) < 1e-6, "{pixel:?} {there:?}");
        }
    }

    #[test]
    fn a_print_is_where_its_corners_project() {
        let (lens, mut random) = small();
        let table_from_camera = looking_down([0.0, 0.0], 0.5, [0.0, 0.0], 0.0);
        let print = Print {
            pattern: Family::Tag36h11.pattern(3).unwrap(),
            size_m: 0.03,
            table_from_marker: Isometry3::translation(0.004, -0.002, 0.0),
            greys: [30.0, 220.0],
            rim: (0.004, 120.0),
        };
        let clean = Degrade { blur_px: 0.0, noise: 0.0, gradient: 0.0 };
        let ground = Ground::Plain(90.0);
        let picture =
            render(&lens, &table_from_camera, &ground, std::slice::from_ref(&print), clean, &mut random);
        let [a, b, c, d] = print.corners(&lens, &table_from_camera).unwrap();
        let centre = [(a[0] + c[0]) / 2.0, (a[1] + c[1]) / 2.0];
        // A little inside each corner the border is black, a little outside the ring is white.
        for corner in [a, b, c, d] {
            let along = |share: f64| {
                let at = [0, 1].map(|k| (centre[k] + share * (corner[k] - centre[k])).round() as usize);
                picture.data[at[1] * 160 + at[0]]
            };
            assert_eq!((along(0.9), along(1.1)), (30, 220));
        }
        assert_eq!(picture.data[0], 90);
    }

    #[test]
    fn noise_blur_and_light_are_as_requested() {
        let (lens, mut random) = small();
        let table_from_camera = looking_down([0.0, 0.0], 0.5, [0.0, 0.0], 0.0);
        let noisy = Degrade { blur_px: 0.8, noise: 3.0, gradient: 0.0 };
        let picture = render(&lens, &table_from_camera, &Ground::Plain(100.0), &[], noisy, &mut random);
        let count = picture.data.len() as f64;
        let mean = picture.data.iter().map(|&v| f64::from(v)).sum::<f64>() / count;
        let variance = picture.data.iter().map(|&v| (f64::from(v) - mean).powi(2)).sum::<f64>() / count;
        assert!((mean - 100.0).abs() < 0.2 && (variance.sqrt() - 3.0).abs() < 0.2, "{mean} {variance}");
        let dim = Degrade { gradient: 0.3, noise: 0.0, ..noisy };
        let picture = render(&lens, &table_from_camera, &Ground::Plain(200.0), &[], dim, &mut random);
        let (low, high) = (*picture.data.iter().min().unwrap(), *picture.data.iter().max().unwrap());
        assert!((140..=146).contains(&low) && (194..=200).contains(&high), "{low} {high}");
    }
}
