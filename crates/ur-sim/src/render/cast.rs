//! Ray casting: which surface a direction of the camera meets, and its colour.
//!
//! In: a scene, the camera pose, directions (x/z, y/z). Out: a colour in grey levels and a key that changes
//! where the surface does, so that the caller samples edges more finely. Candidates come from lists per tile
//! of 32 x 32 px, filled from the projected bounding boxes. All rays have length 1 along the optical axis,
//! so the parameter of a hit is its depth and bodies compare by it.

use crate::render::lens::CameraTruth;
use crate::render::scene::{Cells, Print, Prism, Scene};
use crate::render::texture::Texture;
use crate::world::section::{Shape, edges, inside_polygon};
use nalgebra::{Isometry3, Point3, Vector3};

/// Edge of a tile, px.
pub const TILE: usize = 32;
/// Nearest depth that is drawn, m.
const NEAR_M: f64 = 1e-3;

type Colour = [f32; 3];

const TABLE: Colour = [172.0, 166.0, 152.0];
const FLOOR: Colour = [62.0, 62.0, 66.0];
const PAPER: Colour = [214.0, 214.0, 212.0];
const INK: Colour = [26.0, 26.0, 28.0];

/// One prepared scene.
pub struct Caster<'a> {
    table: Plane,
    board: [f64; 4],
    prisms: Vec<Target<'a>>,
    prints: Vec<Sheet>,
    texture: &'a Texture,
    tiles: Vec<Candidates>,
    tiles_across: usize,
}

/// What may be met within a tile.
#[derive(Clone, Default)]
pub struct Candidates {
    prisms: Vec<usize>,
    prints: Vec<usize>,
}

/// A surface and its colour.
#[derive(Clone, Copy)]
pub struct Sample {
    /// Changes where the surface or the print does.
    pub key: u32,
    /// Grey levels, red, green, blue.
    pub colour: Colour,
}

/// A camera seen from some frame: where it is, and how its axes lie.
struct Plane {
    eye: [f64; 3],
    rows: [[f64; 3]; 3],
}

struct Target<'a> {
    view: Plane,
    low: [f64; 2],
    high: [f64; 2],
    height_m: f64,
    shape: &'a Shape,
    edges: Vec<Edge>,
    top: Colour,
    wall: Colour,
    light: Vector3<f64>,
    sheets: Vec<Sheet>,
}

struct Edge {
    from: [f64; 2],
    along: [f64; 2],
    shade: f32,
}

struct Sheet {
    x: f64,
    y: f64,
    sin: f64,
    cos: f64,
    per_cell: f64,
    cells: Cells,
}

/// Where a ray meets a body.
#[derive(Clone, Copy)]
struct Hit {
    /// Depth along the optical axis, m.
    depth_m: f64,
    /// Number of the face within the body.
    face: u32,
    /// Grey levels, red, green, blue.
    colour: Colour,
}

/// Where a ray crosses a wall into a body.
#[derive(Clone, Copy)]
struct WallHit {
    /// Share of the searched part of the ray that lies before it, 0 to 1.
    share: f64,
    /// Number of the face within the body.
    face: u32,
    /// Factor of the wall's colour.
    shade: f32,
}

impl Plane {
    fn new(camera_in_frame: &Isometry3<f64>) -> Plane {
        let m = camera_in_frame.rotation.to_rotation_matrix();
        let row = |i: usize| [m[(i, 0)], m[(i, 1)], m[(i, 2)]];
        Plane { eye: camera_in_frame.translation.vector.into(), rows: [row(0), row(1), row(2)] }
    }

    #[inline]
    fn direction(&self, [x, y]: [f64; 2]) -> [f64; 3] {
        let r = &self.rows;
        [
            r[0][0] * x + r[0][1] * y + r[0][2],
            r[1][0] * x + r[1][1] * y + r[1][2],
            r[2][0] * x + r[2][1] * y + r[2][2],
        ]
    }
}

impl Sheet {
    fn new(print: &Print) -> Sheet {
        let (sin, cos) = print.pose.theta.sin_cos();
        Sheet { x: print.pose.x, y: print.pose.y, sin, cos, per_cell: 8.0 / print.size_m, cells: print.cells }
    }

    /// True or false for white or black, `None` off the paper.
    #[inline]
    fn cell(&self, x: f64, y: f64) -> Option<bool> {
        let (dx, dy) = (x - self.x, y - self.y);
        let column = (self.cos * dx + self.sin * dy) * self.per_cell + 5.0;
        let row = 5.0 - (self.cos * dy - self.sin * dx) * self.per_cell;
        if !(0.0..10.0).contains(&column) || !(0.0..10.0).contains(&row) {
            return None;
        }
        Some(self.cells[row as usize][column as usize])
    }

    /// Half the paper's diagonal, m.
    fn reach_m(&self) -> f64 {
        5.0 * std::f64::consts::SQRT_2 / self.per_cell
    }
}

impl<'a> Target<'a> {
    fn new(prism: &'a Prism, table_from_camera: &Isometry3<f64>) -> Target<'a> {
        let section = &prism.section;
        let low = [-section.support([-1.0, 0.0]), -section.support([0.0, -1.0])];
        let high = [section.support([1.0, 0.0]), section.support([0.0, 1.0])];
        let prism_from_table = prism.table_from_prism.inverse();
        let light = prism_from_table * Vector3::new(0.35, -0.45, 0.82);
        let outline: &[[f64; 2]] = match section.shape() {
            Shape::Polygon(outline) => outline,
            Shape::Ellipse(_) => &[],
        };
        let edge = |(a, b): ([f64; 2], [f64; 2])| {
            let along = [b[0] - a[0], b[1] - a[1]];
            let length = along[0].hypot(along[1]).max(1e-12);
            let normal = Vector3::new(along[1] / length, -along[0] / length, 0.0);
            Edge { from: a, along, shade: wall_shade(normal.dot(&light)) }
        };
        Target {
            view: Plane::new(&(prism_from_table * table_from_camera)),
            low,
            high,
            height_m: prism.height_m,
            shape: section.shape(),
            edges: edges(outline).map(edge).collect(),
            top: prism.colour.map(|c| f32::from(c) * (0.75 + 0.3 * light.z.max(0.0) as f32)),
            wall: prism.colour.map(f32::from),
            light,
            sheets: prism.prints.iter().map(Sheet::new).collect(),
        }
    }

    /// The first hit nearer than `limit`, m.
    #[inline]
    fn meet(&self, ray: [f64; 2], limit: f64) -> Option<Hit> {
        let d = self.view.direction(ray);
        let o = self.view.eye;
        let (to_bottom, to_top) = (-o[2] / d[2], (self.height_m - o[2]) / d[2]);
        let enter = to_bottom.min(to_top).max(NEAR_M);
        let leave = to_bottom.max(to_top).min(limit);
        if enter >= leave {
            return None;
        }
        let start = [o[0] + enter * d[0], o[1] + enter * d[1]];
        let along = [(leave - enter) * d[0], (leave - enter) * d[1]];
        for i in 0..2 {
            let (a, b) = (start[i], start[i] + along[i]);
            if a.max(b) < self.low[i] || a.min(b) > self.high[i] {
                return None;
            }
        }
        if enter > NEAR_M && self.inside(start) {
            let (face, colour) =
                if d[2] < 0.0 { self.top_at(start) } else { (1, self.wall.map(|c| c * 0.4)) };
            return Some(Hit { depth_m: enter, face, colour });
        }
        let WallHit { share, face, shade } = self.wall_hit(start, along)?;
        let depth_m = enter + share * (leave - enter);
        Some(Hit { depth_m, face, colour: self.wall.map(|c| c * shade) })
    }

    #[inline]
    fn inside(&self, p: [f64; 2]) -> bool {
        match self.shape {
            Shape::Polygon(outline) => inside_polygon(outline, p),
            Shape::Ellipse(half) => (p[0] / half[0]).powi(2) + (p[1] / half[1]).powi(2) <= 1.0,
        }
    }

    #[inline]
    fn top_at(&self, [x, y]: [f64; 2]) -> (u32, Colour) {
        // Ink shows wherever it is: a neighbour's white ring is the same paper.
        let seen = self.sheets.iter().filter_map(|sheet| sheet.cell(x, y)).min();
        match seen {
            Some(true) => (2, PAPER),
            Some(false) => (3, INK),
            None => (0, self.top),
        }
    }

    /// First crossing of `start + s * along`, s in [0, 1], into the outline.
    fn wall_hit(&self, start: [f64; 2], along: [f64; 2]) -> Option<WallHit> {
        if let Shape::Ellipse(half) = self.shape {
            return self.round_wall_hit(*half, start, along);
        }
        let mut first = None;
        let mut nearest = 1.0;
        for (number, edge) in self.edges.iter().enumerate() {
            // Inward crossings only: the ray runs against the outward normal of a counter-clockwise outline.
            let across = along[0] * edge.along[1] - along[1] * edge.along[0];
            if across >= 0.0 {
                continue;
            }
            let (x, y) = (edge.from[0] - start[0], edge.from[1] - start[1]);
            let s = (x * edge.along[1] - y * edge.along[0]) / across;
            let r = (x * along[1] - y * along[0]) / across;
            if s >= 0.0 && s < nearest && (0.0..=1.0).contains(&r) {
                nearest = s;
                first = Some(WallHit { share: s, face: 4 + number as u32, shade: edge.shade });
            }
        }
        first
    }

    fn round_wall_hit(&self, half: [f64; 2], start: [f64; 2], along: [f64; 2]) -> Option<WallHit> {
        let (p, d) = ([start[0] / half[0], start[1] / half[1]], [along[0] / half[0], along[1] / half[1]]);
        let (a, b) = (d[0] * d[0] + d[1] * d[1], p[0] * d[0] + p[1] * d[1]);
        let c = p[0] * p[0] + p[1] * p[1] - 1.0;
        let root = b * b - a * c;
        if root <= 0.0 || a <= 0.0 {
            return None;
        }
        let s = (-b - root.sqrt()) / a;
        if !(0.0..=1.0).contains(&s) {
            return None;
        }
        let (x, y) = ((p[0] + s * d[0]) / half[0], (p[1] + s * d[1]) / half[1]);
        let length = x.hypot(y).max(1e-12);
        let shade = wall_shade(Vector3::new(x / length, y / length, 0.0).dot(&self.light));
        Some(WallHit { share: s, face: 4, shade })
    }
}

fn wall_shade(towards_light: f64) -> f32 {
    (0.55 + 0.25 * towards_light) as f32
}

impl<'a> Caster<'a> {
    /// Prepares a scene for one picture.
    pub fn new(
        scene: &'a Scene,
        table_from_camera: &Isometry3<f64>,
        lens: &CameraTruth,
        texture: &'a Texture,
    ) -> Self {
        let tiles_across = (lens.width as usize).div_ceil(TILE);
        let tiles_down = (lens.height as usize).div_ceil(TILE);
        let mut caster = Caster {
            table: Plane::new(table_from_camera),
            board: scene.board,
            prisms: scene.prisms.iter().map(|prism| Target::new(prism, table_from_camera)).collect(),
            prints: scene.prints.iter().map(Sheet::new).collect(),
            texture,
            tiles: vec![Candidates::default(); tiles_across * tiles_down],
            tiles_across,
        };
        let camera_from_table = table_from_camera.inverse();
        for (index, prism) in scene.prisms.iter().enumerate() {
            let target = &caster.prisms[index];
            let camera_from_prism = camera_from_table * prism.table_from_prism;
            let window = window(lens, &camera_from_prism, target.low, target.high, prism.height_m);
            caster.enlist(window, |tile| tile.prisms.push(index));
        }
        for index in 0..caster.prints.len() {
            let sheet = &caster.prints[index];
            let reach = sheet.reach_m();
            let (low, high) = ([sheet.x - reach, sheet.y - reach], [sheet.x + reach, sheet.y + reach]);
            caster.enlist(window(lens, &camera_from_table, low, high, 0.0), |tile| tile.prints.push(index));
        }
        caster
    }

    fn enlist(&mut self, window: [f64; 4], mut add: impl FnMut(&mut Candidates)) {
        let tiles_down = self.tiles.len() / self.tiles_across;
        let index = |v: f64, count: usize| ((v / TILE as f64).floor().max(0.0) as usize).min(count);
        let (left, right) =
            (index(window[0], self.tiles_across), index(window[2] + TILE as f64, self.tiles_across));
        let (above, below) = (index(window[1], tiles_down), index(window[3] + TILE as f64, tiles_down));
        for row in above..below {
            for column in left..right {
                add(&mut self.tiles[row * self.tiles_across + column]);
            }
        }
    }

    /// The candidates of the tile that a pixel lies in.
    #[inline]
    pub fn candidates(&self, column: usize, row: usize) -> &Candidates {
        &self.tiles[(row / TILE) * self.tiles_across + column / TILE]
    }

    /// What the direction `ray` meets.
    #[inline]
    pub fn sample(&self, candidates: &Candidates, ray: [f64; 2]) -> Sample {
        let d = self.table.direction(ray);
        let mut depth = if d[2] < -1e-9 { -self.table.eye[2] / d[2] } else { f64::MAX };
        let ground = depth;
        let mut hit = None;
        for &index in &candidates.prisms {
            if let Some(Hit { depth_m, face, colour }) = self.prisms[index].meet(ray, depth) {
                depth = depth_m;
                hit = Some(Sample { key: ((index as u32 + 1) << 12) | face, colour });
            }
        }
        let mut sample = hit.unwrap_or_else(|| self.ground(candidates, d, ground));
        let [x, y] = ray;
        let light = ((1.0 + 0.06 * x - 0.04 * y) * (1.0 - 0.10 * (x * x + y * y))) as f32;
        sample.colour = sample.colour.map(|c| c * light);
        sample
    }

    /// Depth of what the direction `ray` meets, m along the optical axis; infinite if there is nothing.
    pub fn depth(&self, candidates: &Candidates, ray: [f64; 2]) -> f64 {
        let d = self.table.direction(ray);
        // The floor far below the board is too far to matter: the board's plane represents both.
        let ground = if d[2] < -1e-9 { -self.table.eye[2] / d[2] } else { f64::INFINITY };
        let nearest = |depth: f64, index: &usize| {
            self.prisms[*index].meet(ray, depth.min(f64::MAX)).map_or(depth, |hit| hit.depth_m)
        };
        candidates.prisms.iter().fold(ground, nearest)
    }

    #[inline]
    fn ground(&self, candidates: &Candidates, d: [f64; 3], depth: f64) -> Sample {
        let (x, y) = (self.table.eye[0] + depth * d[0], self.table.eye[1] + depth * d[1]);
        let board = &self.board;
        if !(depth > 0.0 && x >= board[0] && x <= board[2] && y >= board[1] && y <= board[3]) {
            return Sample { key: 1, colour: FLOOR };
        }
        for &index in &candidates.prints {
            if let Some(white) = self.prints[index].cell(x, y) {
                let colour = if white { PAPER } else { INK };
                return Sample { key: 2 + 2 * index as u32 + u32::from(white), colour };
            }
        }
        let grain = self.texture.at(x, y);
        Sample { key: 0, colour: TABLE.map(|c| c + grain) }
    }
}

/// Bounding window in px of a box in some frame: left, upper, right, lower; the whole picture when in doubt.
fn window(
    lens: &CameraTruth,
    camera_from_box: &Isometry3<f64>,
    low: [f64; 2],
    high: [f64; 2],
    height_m: f64,
) -> [f64; 4] {
    let mut window = [f64::MAX, f64::MAX, f64::MIN, f64::MIN];
    // The lens bends straight edges: the corners and the middles of the edges, and a margin for what is
    // between.
    let between = |a: f64, b: f64| [a, (a + b) / 2.0, b];
    for x in between(low[0], high[0]) {
        for y in between(low[1], high[1]) {
            for z in [0.0, height_m] {
                let p = camera_from_box * Point3::new(x, y, z);
                let steep = p.x.abs() > 1.5 * p.z || p.y.abs() > 1.5 * p.z;
                let Some([u, v]) = lens.project([p.x, p.y, p.z]).filter(|_| !steep && p.z > 0.01) else {
                    return [0.0, 0.0, f64::from(lens.width), f64::from(lens.height)];
                };
                window = [window[0].min(u), window[1].min(v), window[2].max(u), window[3].max(v)];
            }
        }
    }
    let margin = 4.0 + 0.02 * (window[2] - window[0]).max(window[3] - window[1]);
    [window[0] - margin, window[1] - margin, window[2] + margin, window[3] + margin]
}
