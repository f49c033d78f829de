//! The simulated camera's lens: pinhole with Brown-Conrady distortion, forward and inverse.
//!
//! In: points in the camera frame (x right, y down, z forward, m). Out: pixels, (0, 0) being the centre of
//! the first pixel; and back, pixels to directions. Written from the model's formula and held to OpenCV's
//! `projectPoints` by a test in `tests/it`, so that a misreading cannot agree with itself.

use serde::Serialize;

/// The camera that takes the simulated pictures.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraTruth {
    /// Serial number.
    pub serial: String,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Focal length in x, px.
    pub fx: f64,
    /// Focal length in y, px.
    pub fy: f64,
    /// Principal point, column.
    pub cx: f64,
    /// Principal point, row.
    pub cy: f64,
    /// k1, k2, p1, p2, k3.
    pub distortion: [f64; 5],
    /// Blur of lens and pixels, standard deviation in px.
    pub blur_sigma_px: f64,
    /// Noise, standard deviation in grey levels.
    pub noise_sigma: f64,
}

/// What a camera says about itself: the fields of `/intrinsics.json`.
#[derive(Clone, Debug, Serialize)]
pub struct Intrinsics<'a> {
    serial: &'a str,
    width: u32,
    height: u32,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    distortion: [f64; 5],
}

impl CameraTruth {
    /// A camera without distortion, its axis in the middle of the picture; blur 0.7 px, noise 2 grey levels.
    pub fn ideal(serial: &str, width: u32, height: u32, focal_px: f64) -> CameraTruth {
        CameraTruth {
            serial: serial.to_string(),
            width,
            height,
            fx: focal_px,
            fy: focal_px,
            cx: (f64::from(width) - 1.0) / 2.0,
            cy: (f64::from(height) - 1.0) / 2.0,
            distortion: [0.0; 5],
            blur_sigma_px: 0.7,
            noise_sigma: 2.0,
        }
    }

    /// The numbers a client may know.
    pub fn intrinsics(&self) -> Intrinsics<'_> {
        Intrinsics {
            serial: &self.serial,
            width: self.width,
            height: self.height,
            fx: self.fx,
            fy: self.fy,
            cx: self.cx,
            cy: self.cy,
            distortion: self.distortion,
        }
    }

    /// Pixel of a point in the camera frame; `None` on or behind the camera's plane.
    pub fn project(&self, point: [f64; 3]) -> Option<[f64; 2]> {
        if point[2] <= 1e-9 {
            return None;
        }
        let [x, y] = self.distort([point[0] / point[2], point[1] / point[2]]);
        Some([self.fx * x + self.cx, self.fy * y + self.cy])
    }

    /// Where the lens puts the direction (x/z, y/z).
    pub fn distort(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [k1, k2, p1, p2, k3] = self.distortion;
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        [
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        ]
    }

    /// The direction (x/z, y/z) that falls on a pixel: Newton on [`distort`](Self::distort) from `start`.
    pub fn direction(&self, pixel: [f64; 2], start: [f64; 2]) -> [f64; 2] {
        let goal = [(pixel[0] - self.cx) / self.fx, (pixel[1] - self.cy) / self.fy];
        let [mut x, mut y] = start;
        for _ in 0..20 {
            let [dx, dy] = self.distort([x, y]);
            let (ex, ey) = (dx - goal[0], dy - goal[1]);
            if ex.abs() + ey.abs() < 1e-13 {
                break;
            }
            let [[a, b], [c, d]] = self.jacobian([x, y]);
            let determinant = a * d - b * c;
            x -= (d * ex - b * ey) / determinant;
            y -= (a * ey - c * ex) / determinant;
        }
        [x, y]
    }

    fn jacobian(&self, [x, y]: [f64; 2]) -> [[f64; 2]; 2] {
        let [k1, k2, p1, p2, k3] = self.distortion;
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let slope = 2.0 * (k1 + r2 * (2.0 * k2 + 3.0 * k3 * r2));
        let cross = x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y;
        [
            [radial + x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x, cross],
            [cross, radial + y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x],
        ]
    }
}

/// Directions at the corners of all pixels; in between they are interpolated (error below 1e-5 px).
pub struct RayGrid {
    columns: usize,
    rays: Vec<[f32; 2]>,
}

impl RayGrid {
    /// The grid of a camera: (width + 1) x (height + 1) directions.
    pub fn new(camera: &CameraTruth) -> RayGrid {
        let columns = camera.width as usize + 1;
        let mut rays = Vec::with_capacity(columns * (camera.height as usize + 1));
        for row in 0..=camera.height {
            let v = f64::from(row) - 0.5;
            let mut guess = [(-0.5 - camera.cx) / camera.fx, (v - camera.cy) / camera.fy];
            for column in 0..=camera.width {
                guess = camera.direction([f64::from(column) - 0.5, v], guess);
                rays.push([guess[0] as f32, guess[1] as f32]);
                guess[0] += 1.0 / camera.fx;
            }
        }
        RayGrid { columns, rays }
    }

    /// The directions at the four corners of a pixel, for interpolation.
    #[inline]
    pub fn cell(&self, column: usize, row: usize) -> RayCell {
        let at = |c: usize, r: usize| self.rays[r * self.columns + c].map(f64::from);
        let (a, b) = (at(column, row), at(column + 1, row));
        let (c, d) = (at(column, row + 1), at(column + 1, row + 1));
        RayCell {
            origin: a,
            along: [b[0] - a[0], b[1] - a[1]],
            down: [c[0] - a[0], c[1] - a[1]],
            twist: [a[0] - b[0] - c[0] + d[0], a[1] - b[1] - c[1] + d[1]],
        }
    }
}

/// Bilinear interpolation within one pixel.
pub struct RayCell {
    origin: [f64; 2],
    along: [f64; 2],
    down: [f64; 2],
    twist: [f64; 2],
}

impl RayCell {
    /// The direction at (s, t) of the pixel, both in [0, 1]; (0.5, 0.5) is its centre.
    #[inline]
    pub fn at(&self, s: f64, t: f64) -> [f64; 2] {
        [
            self.origin[0] + s * self.along[0] + t * self.down[0] + s * t * self.twist[0],
            self.origin[1] + s * self.along[1] + t * self.down[1] + s * t * self.twist[1],
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> CameraTruth {
        let mut camera = CameraTruth::ideal("t", 640, 360, 325.0);
        camera.cx += 5.0;
        camera.distortion = [-0.05, 0.06, 8e-4, -7e-4, -0.02];
        camera
    }

    #[test]
    fn pixels_go_to_directions_and_back() {
        let camera = camera();
        let grid = RayGrid::new(&camera);
        for column in (0..640).step_by(71) {
            for row in (0..360).step_by(37) {
                let direction = grid.cell(column, row).at(0.3, 0.8);
                let pixel = camera.project([direction[0] * 0.4, direction[1] * 0.4, 0.4]).unwrap();
                let wanted = [column as f64 - 0.2, row as f64 + 0.3];
                assert!((pixel[0] - wanted[0]).hypot(pixel[1] - wanted[1]) < 2e-4, "{pixel:?} {wanted:?}");
            }
        }
        assert!(camera.project([0.0, 0.0, -1.0]).is_none());
    }

    #[test]
    fn without_distortion_it_is_a_pinhole() {
        let camera = CameraTruth::ideal("t", 641, 361, 300.0);
        assert_eq!(camera.project([0.0, 0.0, 0.7]), Some([320.0, 180.0]));
        assert_eq!(camera.project([0.1, -0.05, 0.5]), Some([320.0 + 60.0, 180.0 - 30.0]));
    }
}
