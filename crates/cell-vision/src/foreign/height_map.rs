//! From a depth picture to a map of how high the table's surface and the things on it are.
//!
//! In: a [`DepthImage`], the lens, the camera's pose, the part of the table that matters, what of the robot
//! is in view. Out: a [`HeightMap`]: for each cell of the table the median height of the points measured
//! over it. Medians, because single points near edges are wild. Stereo cameras read flat targets up to a per
//! cent or two too far towards the corners, by an amount that differs from camera to camera: the table
//! itself, whose place is known from its markers, shows how much (`field`). The picture is corrected by that
//! before it is mapped, and the map once more when it is known what lies where ([`HeightMap::levelled`]).
//! Pure.

use crate::camera::CameraModel;
use crate::cv::{self, CvError};
use crate::foreign::field::{Field, Sample};
use cell_values::image::depth::DepthImage;
use nalgebra::{Isometry3, Point3, Vector3};
use rearrange::geometry::polygon::{contains, distance_to_outline};
use serde::{Deserialize, Serialize};

/// Edge of a cell, m: some ten points of a picture from half a metre, and 25 cells to the smallest thing
/// looked for.
pub const CELL_M: f64 = 0.004;
/// Every so many pixels of a row and rows of the picture are used: matching windows are larger than that.
const STRIDE: u32 = 2;
/// Fewest points that a cell's median is taken of.
const POINTS_MIN: usize = 2;
/// Cells along one edge at most: a workspace larger than 4 m is none.
const EDGE_MAX: usize = 1100;
/// Every so many of those points determine how far off the depth is.
const SAMPLED: usize = 11;

/// A rectangle of the table, m, table frame.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
pub struct Area {
    /// Lowest x and y.
    pub low: [f64; 2],
    /// Highest x and y.
    pub high: [f64; 2],
}

impl Area {
    /// The workspace `[0, width] x [0, height]` and `margin` around it, m.
    pub fn around(width: f64, height: f64, margin: f64) -> Area {
        Area { low: [-margin, -margin], high: [width + margin, height + margin] }
    }
}

/// A part of the robot that the camera may see: an upright cylinder about the tool's axis.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
pub struct OwnBody {
    /// The tool frame (cup lips, z out of the gripper) seen from the camera.
    pub camera_from_tool: Isometry3<f64>,
    /// Its radius with room for errors: what is measured in it is the robot's own, m.
    pub radius_m: f64,
    /// Its radius as it is, m.
    pub body_m: f64,
    /// How far it reaches beyond the cup lips, m.
    pub beyond_m: f64,
}

impl OwnBody {
    /// Whether a point in the camera frame is in it.
    pub fn contains(&self, in_camera: &Point3<f64>) -> bool {
        let p = self.camera_from_tool.inverse_transform_point(in_camera);
        p.z < self.beyond_m && p.x.hypot(p.y) < self.radius_m
    }
}

/// What the gripper holds, seen by the camera beside it: an upright prism below the cups.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
pub struct HeldBody {
    /// Its outline in the tool frame (z out of the gripper), m.
    pub outline: Vec<[f64; 2]>,
    /// How far it hangs below the cup lips, m.
    pub below_m: f64,
}

/// Room round what is held: it is not quite where it was gripped.
const HELD_MARGIN_M: f64 = 0.012;

/// Points of a line at which it may meet what is held: it is some centimetres high.
const HELD_TRIED: usize = 6;

impl HeldBody {
    /// Whether it is in the way between `eye` and `point`, all in the frame of the tool.
    fn hides(&self, eye: &Point3<f64>, point: &Point3<f64>) -> bool {
        let (low, high) = (-HELD_MARGIN_M, self.below_m + HELD_MARGIN_M);
        let along = point - eye;
        // The part of the line at its height.
        let (mut from, mut to) = (0.0_f64, 1.0_f64);
        if along.z.abs() > 1e-12 {
            let [a, b] = [(low - eye.z) / along.z, (high - eye.z) / along.z];
            (from, to) = (from.max(a.min(b)), to.min(a.max(b)));
        } else if !(low..=high).contains(&eye.z) {
            return false;
        }
        from <= to
            && (0..HELD_TRIED).any(|step| {
                let share = step as f64 / (HELD_TRIED - 1) as f64;
                let at = eye + along * (from + share * (to - from));
                let at = [at.x, at.y];
                contains(&self.outline, at) || distance_to_outline(&self.outline, at) < HELD_MARGIN_M
            })
    }
}

/// Directions of the pixels that are used, worked out once a lens.
#[derive(Clone, Debug)]
pub struct DepthLens {
    width: u32,
    height: u32,
    /// x and y at distance 1 along the optical axis, row by row.
    rays: Vec<[f64; 2]>,
}

/// Why there is no height map.
#[derive(Debug, thiserror::Error)]
pub enum HeightMapError {
    /// The depth picture is not aligned to the colour picture.
    #[error(
        "the depth picture is {found_width} x {found_height} and the camera's calibration is for {width} x \
         {height}: depth has to be aligned to the colour picture"
    )]
    OtherSize {
        /// Pixels per row the lens is for.
        width: u32,
        /// Rows the lens is for.
        height: u32,
        /// Pixels per row of the picture.
        found_width: u32,
        /// Rows of the picture.
        found_height: u32,
    },
    /// OpenCV failed.
    #[error("the directions of the pixels could not be worked out")]
    Cv(#[from] CvError),
}

impl DepthLens {
    /// The directions of this camera's pixels.
    ///
    /// # Errors
    /// `Cv`.
    pub fn new(camera: &CameraModel) -> Result<DepthLens, HeightMapError> {
        let pixels: Vec<[f64; 2]> =
            sampled(camera.width, camera.height).map(|(x, y)| [f64::from(x), f64::from(y)]).collect();
        let rays = cv::undistort(camera, &pixels)?;
        Ok(DepthLens { width: camera.width, height: camera.height, rays })
    }

    /// The pixels that are used, with their directions.
    pub(crate) fn pixels(&self) -> impl Iterator<Item = ((u32, u32), [f64; 2])> + '_ {
        sampled(self.width, self.height).zip(self.rays.iter().copied())
    }

    /// The points that were measured, as direction and depth.
    fn points<'a>(&'a self, depth: &'a DepthImage) -> impl Iterator<Item = ([f64; 2], f64)> + 'a {
        sampled(self.width, self.height)
            .zip(&self.rays)
            .filter_map(|((x, y), ray)| depth.at(x, y).map(|metres| (*ray, metres)))
    }
}

fn sampled(width: u32, height: u32) -> impl Iterator<Item = (u32, u32)> {
    let step = STRIDE as usize;
    (0..height).step_by(step).flat_map(move |y| (0..width).step_by(step).map(move |x| (x, y)))
}

/// Heights over the table, cell by cell.
#[derive(Clone, PartialEq, Deserialize, Serialize)]
pub struct HeightMap {
    /// The part of the table that is mapped.
    pub area: Area,
    /// Cells in x.
    pub columns: usize,
    /// Cells in y.
    pub rows: usize,
    /// Where the camera was, m, table frame.
    pub eye_m: [f64; 3],
    /// Heights are none but 0 and infinite: what is there was found by its colour.
    pub by_colour: bool,
    /// Median height of the points over each cell, m, NaN where too few were measured; x runs fastest.
    pub heights_m: Vec<f32>,
}

impl std::fmt::Debug for HeightMap {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "HeightMap({} x {} cells)", self.columns, self.rows)
    }
}

impl HeightMap {
    /// A map of `area` in which nothing was measured yet, from this place.
    pub fn empty(area: Area, eye_m: [f64; 3]) -> HeightMap {
        let [columns, rows] = [0, 1].map(|axis| {
            let cells = ((area.high[axis] - area.low[axis]) / CELL_M).ceil();
            if cells.is_finite() { (cells.max(0.0) as usize).min(EDGE_MAX) } else { 0 }
        });
        HeightMap { area, columns, rows, eye_m, by_colour: false, heights_m: vec![f32::NAN; columns * rows] }
    }

    /// What a depth picture taken from `table_from_camera` says about `area`, without the points on `own`.
    ///
    /// # Errors
    /// `OtherSize`.
    pub fn new(
        depth: &DepthImage,
        lens: &DepthLens,
        table_from_camera: &Isometry3<f64>,
        area: Area,
        own: Option<&OwnBody>,
    ) -> Result<HeightMap, HeightMapError> {
        if (depth.width, depth.height) != (lens.width, lens.height) {
            return Err(HeightMapError::OtherSize {
                width: lens.width,
                height: lens.height,
                found_width: depth.width,
                found_height: depth.height,
            });
        }
        let mut map = HeightMap::empty(area, table_from_camera.translation.vector.into());
        let field = table_field(depth, lens, table_from_camera);
        let mut points: Vec<(u32, f32)> = Vec::new();
        for (ray, metres) in lens.points(depth) {
            let metres = metres / (1.0 + field.error(ray));
            let in_camera = Point3::new(ray[0] * metres, ray[1] * metres, metres);
            if own.is_some_and(|body| body.contains(&in_camera)) {
                continue;
            }
            let p = table_from_camera * in_camera;
            if let Some(cell) = map.cell([p.x, p.y]) {
                points.push((cell as u32, p.z as f32));
            }
        }
        map.take_medians(&points);
        Ok(map)
    }

    /// The map without what is held and what that hides, with the tool at `table_from_tool`: of both nothing
    /// is known.
    pub fn without_held(&self, held: &HeldBody, table_from_tool: &Isometry3<f64>) -> HeightMap {
        let in_tool = |p: [f64; 3]| table_from_tool.inverse_transform_point(&Point3::from(p));
        let eye = in_tool(self.eye_m);
        let mut map = self.clone();
        for cell in 0..map.heights_m.len() {
            let [x, y] = self.centre(cell);
            // Of what only its colour shows, the table below it is what the line of sight leads to.
            let height = f64::from(self.heights_m[cell]);
            let height = if height.is_finite() { height } else { 0.0 };
            if held.hides(&eye, &in_tool([x, y, height])) {
                map.heights_m[cell] = f32::NAN;
            }
        }
        map
    }

    /// The heights, corrected by what the map says about surfaces whose height is known.
    ///
    /// `surface_m` is the height of the table or the known top in each cell, NaN where it is unknown. The
    /// picture's own correction took every surface near the table for the table; here known objects are
    /// distinguished from it.
    pub fn levelled(&self, surface_m: &[f32]) -> Vec<f32> {
        let eye_m = self.eye_m[2];
        let ray = |cell: usize| {
            let [x, y] = self.centre(cell);
            [(x - self.eye_m[0]) / eye_m, (y - self.eye_m[1]) / eye_m]
        };
        let sample = |(cell, (height, surface)): (usize, (&f32, &f32))| {
            let below = eye_m - f64::from(*surface);
            let share = (f64::from(*surface) - f64::from(*height)) / below;
            (share.is_finite() && below > 0.0).then(|| Sample::new(ray(cell), share, eye_m))
        };
        let samples: Vec<Sample> =
            self.heights_m.iter().zip(surface_m).enumerate().filter_map(sample).collect();
        let field = Field::fitted(&samples);
        let level = |(cell, height): (usize, &f32)| {
            (eye_m - (eye_m - f64::from(*height)) / (1.0 + field.error(ray(cell)))) as f32
        };
        self.heights_m.iter().enumerate().map(level).collect()
    }

    /// Sets each cell to the median of its points.
    fn take_medians(&mut self, points: &[(u32, f32)]) {
        // Sorted by cell in one pass: how many each has, where each begins, then every height to its place.
        let mut ends = vec![0usize; self.heights_m.len()];
        points.iter().for_each(|(cell, _)| ends[*cell as usize] += 1);
        let mut begin = 0;
        for end in &mut ends {
            begin += std::mem::replace(end, begin);
        }
        let mut heights = vec![0.0_f32; points.len()];
        for (cell, height) in points {
            let place = &mut ends[*cell as usize];
            heights[*place] = *height;
            *place += 1;
        }
        let mut begin = 0;
        for (cell, end) in ends.into_iter().enumerate() {
            let of_cell = &mut heights[std::mem::replace(&mut begin, end)..end];
            if of_cell.len() >= POINTS_MIN {
                let middle = of_cell.len() / 2;
                self.heights_m[cell] = *of_cell.select_nth_unstable_by(middle, f32::total_cmp).1;
            }
        }
    }

    /// The cell over which a point of the table lies.
    pub(crate) fn cell(&self, p: [f64; 2]) -> Option<usize> {
        let [column, row] = [0, 1].map(|axis| ((p[axis] - self.area.low[axis]) / CELL_M).floor());
        let inside = column >= 0.0 && row >= 0.0 && column < self.columns as f64 && row < self.rows as f64;
        inside.then(|| row as usize * self.columns + column as usize)
    }

    /// The centre of a cell, m, table frame.
    pub fn centre(&self, cell: usize) -> [f64; 2] {
        let (column, row) = (cell % self.columns, cell / self.columns);
        [(self.area.low[0], column), (self.area.low[1], row)]
            .map(|(low, at)| low + (at as f64 + 0.5) * CELL_M)
    }

    /// Those of the `marked` cells that touch, group by group.
    pub(crate) fn groups(&self, marked: &[bool]) -> Vec<Vec<usize>> {
        let mut open = marked.to_vec();
        let mut groups = Vec::new();
        for start in 0..open.len() {
            if !std::mem::take(&mut open[start]) {
                continue;
            }
            let (mut group, mut next) = (Vec::new(), vec![start]);
            while let Some(cell) = next.pop() {
                group.push(cell);
                for near in self.neighbours(cell) {
                    if std::mem::take(&mut open[near]) {
                        next.push(near);
                    }
                }
            }
            groups.push(group);
        }
        groups
    }

    /// The cells next to a cell, also over the corners.
    pub fn neighbours(&self, cell: usize) -> impl Iterator<Item = usize> {
        let (columns, rows) = (self.columns, self.rows);
        let (column, row) = (cell % columns, cell / columns);
        let across = column.saturating_sub(1)..=(column + 1).min(columns - 1);
        let along = row.saturating_sub(1)..=(row + 1).min(rows - 1);
        along
            .flat_map(move |row| across.clone().map(move |column| row * columns + column))
            .filter(move |near| *near != cell)
    }
}

/// How far off the depth is, learnt from the points that lie on the table.
fn table_field(depth: &DepthImage, lens: &DepthLens, table_from_camera: &Isometry3<f64>) -> Field {
    let eye_m = table_from_camera.translation.z;
    let sample = |(ray, metres): ([f64; 2], f64)| {
        let falls = -(table_from_camera.rotation * Vector3::new(ray[0], ray[1], 1.0)).z;
        let table_m = eye_m / falls;
        (falls > 0.1).then(|| Sample::new(ray, metres / table_m - 1.0, table_m))
    };
    let samples: Vec<Sample> = lens.points(depth).step_by(SAMPLED).filter_map(sample).collect();
    Field::fitted(&samples)
}
