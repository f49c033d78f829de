//! Synthetic pictures for the tests of `cell-vision`: a small renderer of markers on a table, with its own
//! lens model.
//!
//! In: a camera, where it is, markers with their poses. Out: a grey picture, supersampled, blurred, with
//! noise from a seed. Shares no code with detection or with OpenCV, so that a misread convention cannot
//! agree with itself.

use crate::camera::CameraModel;
use cell_values::image::{GrayImage, tag36h11_bitmap};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rearrange::geometry::pose::Pose2;

/// A D405-like lens with distortion and an offset principal point.
pub fn camera(width: u32, height: u32) -> CameraModel {
    CameraModel {
        serial: "test-405".into(),
        width,
        height,
        fx: 650.0,
        fy: 652.0,
        cx: f64::from(width) / 2.0 + 6.3,
        cy: f64::from(height) / 2.0 - 4.2,
        distortion: [-0.05, 0.06, 4e-4, -3e-4, -0.01],
    }
}

/// Distorts normalised coordinates: Brown-Conrady, written from Brown's paper.
fn distort(camera: &CameraModel, x: f64, y: f64) -> [f64; 2] {
    let [k1, k2, p1, p2, k3] = camera.distortion;
    let r2 = x * x + y * y;
    let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
    [
        x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
        y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
    ]
}

/// A point in the camera frame to its pixel.
pub fn project(camera: &CameraModel, point: &Point3<f64>) -> [f64; 2] {
    let [x, y] = distort(camera, point.x / point.z, point.y / point.z);
    [camera.fx * x + camera.cx, camera.fy * y + camera.cy]
}

/// A pixel to normalised coordinates, by fixed-point iteration on [`distort`].
fn unproject(camera: &CameraModel, pixel: [f64; 2]) -> [f64; 2] {
    let wanted = [(pixel[0] - camera.cx) / camera.fx, (pixel[1] - camera.cy) / camera.fy];
    let mut guess = wanted;
    for _ in 0..12 {
        let seen = distort(camera, guess[0], guess[1]);
        guess = [guess[0] + wanted[0] - seen[0], guess[1] + wanted[1] - seen[1]];
    }
    guess
}

/// A camera `height_m` above the table point (x, y), looking down, tilted about the table's x and y axes and
/// turned.
pub fn looking_down(x: f64, y: f64, height_m: f64, tilt: [f64; 2], turn: f64) -> Isometry3<f64> {
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn);
    let tilted = UnitQuaternion::from_scaled_axis(Vector3::new(tilt[0], tilt[1], 0.0));
    let look = tilted * turned * down;
    // Tilted about the point it looks at, so that the target stays in the picture.
    let back = look * Vector3::new(0.0, 0.0, -height_m);
    Isometry3::from_parts(Translation3::from(Vector3::new(x, y, 0.0) + back), look)
}

/// A marker in the scene.
#[derive(Clone, Debug)]
pub struct Print {
    /// Number in the family.
    pub id: u32,
    /// Edge of the black square, m.
    pub size_m: f64,
    /// Where it is.
    pub table_from_marker: Isometry3<f64>,
}

impl Print {
    /// A marker lying level at a height.
    pub fn level(id: u32, size_m: f64, pose: Pose2, z_m: f64) -> Print {
        Print { id, size_m, table_from_marker: pose.at_height(z_m) }
    }

    /// Corners in the order of `Detection::corners`, as they really project.
    pub fn corners(&self, camera: &CameraModel, table_from_camera: &Isometry3<f64>) -> [[f64; 2]; 4] {
        let camera_from_marker = table_from_camera.inverse() * self.table_from_marker;
        let half = self.size_m / 2.0;
        [(-half, -half), (half, -half), (half, half), (-half, half)]
            .map(|(x, y)| project(camera, &(camera_from_marker * Point3::new(x, y, 0.0))))
    }
}

/// How the picture degrades.
#[derive(Clone, Copy, Debug)]
pub struct Degrade {
    /// Gaussian blur, standard deviation in pixels.
    pub blur_px: f64,
    /// Noise, standard deviation in grey levels.
    pub noise: f64,
    /// Light on the darkest side of the picture over the brightest.
    pub gradient: f64,
}

/// The figures of the vision benchmark.
pub const USUAL: Degrade = Degrade { blur_px: 0.8, noise: 3.0, gradient: 0.7 };

/// The picture of the markers, 4 x 4 rays a pixel.
pub fn render(
    camera: &CameraModel,
    table_from_camera: &Isometry3<f64>,
    prints: &[Print],
    degrade: Degrade,
    seed: u64,
) -> GrayImage {
    let (width, height) = (camera.width as usize, camera.height as usize);
    let mut light = vec![120.0; width * height];
    for print in prints {
        draw(camera, table_from_camera, print, prints, &mut light);
    }
    for (i, value) in light.iter_mut().enumerate() {
        let across = (i % width) as f64 / width as f64;
        *value *= 1.0 - (1.0 - degrade.gradient) * across;
    }
    blur(&mut light, width, height, degrade.blur_px);
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let data = light.iter().map(|value| value + degrade.noise * normal(&mut random));
    let data = data.map(|value| value.round().clamp(0.0, 255.0) as u8).collect();
    GrayImage { width: camera.width, height: camera.height, data }
}

/// Paints the part of the picture round one marker; what lies nearer hides what lies behind.
fn draw(
    camera: &CameraModel,
    table_from_camera: &Isometry3<f64>,
    print: &Print,
    all: &[Print],
    light: &mut [f64],
) {
    let whole = Print { size_m: print.size_m * 1.3, ..print.clone() };
    let corners = whole.corners(camera, table_from_camera);
    let bound = |axis: usize, limit: u32| {
        let values = corners.map(|corner| corner[axis]);
        let low = values.iter().copied().fold(f64::INFINITY, f64::min).floor().max(0.0);
        let high = values.iter().copied().fold(0.0, f64::max).ceil().min(f64::from(limit) - 1.0);
        low as usize..=(high.max(0.0) as usize)
    };
    for row in bound(1, camera.height) {
        for column in bound(0, camera.width) {
            let mut sum = 0.0;
            for sub in 0..16 {
                // Sheared, so that a side along the pixel grid is cut at 16 places and not at 4.
                let (across, down) = (f64::from(sub % 4), f64::from(sub / 4));
                let cell = |a: f64, b: f64| (a + (b + 0.5) / 4.0) / 4.0 - 0.5;
                let pixel = [column as f64 + cell(across, down), row as f64 + cell(down, across)];
                sum += shade(unproject(camera, pixel), table_from_camera, all);
            }
            light[row * camera.width as usize + column] = sum / 16.0;
        }
    }
}

/// Grey level seen along a ray: the nearest print it meets, or the table.
fn shade(normalised: [f64; 2], table_from_camera: &Isometry3<f64>, prints: &[Print]) -> f64 {
    let ray = table_from_camera * Vector3::new(normalised[0], normalised[1], 1.0);
    let origin = table_from_camera.translation.vector;
    let (mut nearest, mut grey) = (f64::INFINITY, 120.0);
    for print in prints {
        let marker = print.table_from_marker.inverse();
        let (o, d) = (marker * Point3::from(origin), marker * ray);
        let along = -o.z / d.z;
        let hit = o + along * d;
        let module = |value: f64| (value / print.size_m * 8.0 + 5.0).floor();
        let (column, row) = (module(hit.x), 9.0 - module(hit.y));
        if along > 0.0 && along < nearest && (0.0..10.0).contains(&column) && (0.0..10.0).contains(&row) {
            nearest = along;
            let white = tag36h11_bitmap(print.id).expect("id in the family");
            grey = if white[row as usize][column as usize] { 225.0 } else { 35.0 };
        }
    }
    grey
}

/// Blurs grey levels, rows of `width`, by a Gaussian of `sigma` pixels.
pub fn blur(light: &mut [f64], width: usize, height: usize, sigma: f64) {
    if sigma <= 0.0 {
        return;
    }
    let radius = (3.0 * sigma).ceil() as isize;
    let kernel: Vec<f64> =
        (-radius..=radius).map(|i| (-((i * i) as f64) / (2.0 * sigma * sigma)).exp()).collect();
    let total: f64 = kernel.iter().sum();
    for (step, count, lines, line_step) in [(1, width, height, width), (width, height, width, 1)] {
        let mut line = vec![0.0; count];
        for start in (0..lines).map(|index| index * line_step) {
            for (i, value) in line.iter_mut().enumerate() {
                *value = light[start + i * step];
            }
            for i in 0..count {
                let at = |k: usize| (i as isize + k as isize - radius).clamp(0, count as isize - 1) as usize;
                let sum: f64 = kernel.iter().enumerate().map(|(k, weight)| weight * line[at(k)]).sum();
                light[start + i * step] = sum / total;
            }
        }
    }
}

/// A standard normal number (Box and Muller).
pub fn normal(random: &mut ChaCha8Rng) -> f64 {
    let (u, v): (f64, f64) = (random.random(), random.random());
    (-2.0 * (1.0 - u).ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

/// What a detector with this corner noise (standard deviation along each axis, pixels) would report.
pub fn detections(
    camera: &CameraModel,
    table_from_camera: &Isometry3<f64>,
    prints: &[Print],
    noise_px: f64,
    random: &mut ChaCha8Rng,
) -> Vec<crate::detect::Detection> {
    let mut detection = |print: &Print| crate::detect::Detection {
        family: crate::marker::FAMILY.to_owned(),
        id: print.id,
        corners: print
            .corners(camera, table_from_camera)
            .map(|corner| corner.map(|value| value + noise_px * normal(random))),
        decision_margin: 80.0,
        hamming: 0,
    };
    let limits = [f64::from(camera.width), f64::from(camera.height)];
    let inside = |corner: &[f64; 2]| (0..2).all(|axis| (0.0..limits[axis]).contains(&corner[axis]));
    let visible = |print: &&Print| print.corners(camera, table_from_camera).iter().all(inside);
    prints.iter().filter(visible).map(&mut detection).collect()
}
