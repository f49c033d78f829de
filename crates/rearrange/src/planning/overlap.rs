//! The plan checker's own geometry: do two placed footprints overlap deeper than so much, or come too near?
//!
//! In: footprints and poses, m. Out: yes or no. Built on `geo` (exact orientation predicates, ear cutting,
//! polygon intersection and distance) and shares nothing with `geometry::collision` but the shapes, so that
//! a mistake there cannot vouch for itself. It works differently on purpose: polygons are cut into
//! triangles, and a question is answered by testing if *shifting one of two convex pieces by the allowed
//! depth along an edge's normal puts all of it beyond that edge*, decided by exact orientation of every
//! corner. A curve is held between an inscribed and a circumscribed polygon of tangents, which are refined
//! where the answer hangs on them until both give the same one; what is still open at the limit of `f64`
//! counts as an overlap.

use std::f64::consts::TAU;

use geo::kernels::{Kernel, Orientation, RobustKernel};
use geo::{
    Area, BoundingRect, Coord, Distance, Euclidean, Intersects, LineString, Polygon, Rect, TriangulateEarcut,
    coord,
};

use crate::geometry::footprint::Footprint;
use crate::geometry::pose::Pose2;

/// Penetration up to here is touching, m (design, section 3).
pub const TOUCH_M: f64 = 1e-9;

/// Rounds of refinement before a question counts as open; each divides the doubt by about four.
const MAX_ROUNDS: usize = 64;

/// Points of a curve are not refined closer than this, rad. Shorter edges would have directions spoilt by
/// rounding; what is left open is 1e-11 of the radius.
const CLOSEST_PARAMETERS: f64 = 1e-5;

/// A footprint at a pose, as the checker sees it.
#[derive(Clone, Debug)]
pub struct Body {
    pieces: Vec<Piece>,
    outline: Option<Polygon<f64>>,
    bounds: Rect<f64>,
    /// False when the triangles do not add up to the polygon: then every contact counts as an overlap.
    sound: bool,
}

#[derive(Clone, Debug)]
enum Piece {
    /// Convex, counter-clockwise.
    Corners(Vec<Coord<f64>>),
    Curve(Curve),
}

/// An ellipse (or disc) at its pose.
#[derive(Clone, Copy, Debug)]
struct Curve {
    pose: Pose2,
    a: f64,
    b: f64,
}

impl Body {
    /// Places a footprint.
    pub fn new(footprint: &Footprint, pose: &Pose2) -> Body {
        match footprint {
            Footprint::Disc { radius } => Body::curve(Curve { pose: *pose, a: *radius, b: *radius }),
            Footprint::Ellipse { length, width } => {
                Body::curve(Curve { pose: *pose, a: length / 2.0, b: width / 2.0 })
            }
            Footprint::Rectangle { length, width } => {
                let (x, y) = (length / 2.0, width / 2.0);
                let corners = [[-x, -y], [x, -y], [x, y], [-x, y]].map(|p| placed(pose, p)).to_vec();
                let outline = Polygon::new(LineString::new(corners.clone()), Vec::new());
                let bounds = bounds_of(&corners);
                Body { pieces: vec![Piece::Corners(corners)], outline: Some(outline), bounds, sound: true }
            }
            Footprint::Polygon(polygon) => Body::polygon(polygon.points(), pose),
        }
    }

    fn curve(curve: Curve) -> Body {
        let bounds = bounds_of(&curve.outer(&curve.extreme_parameters()));
        Body { pieces: vec![Piece::Curve(curve)], outline: None, bounds, sound: true }
    }

    /// Cut in the object frame, so that the pose's rounding cannot change how, and then placed.
    fn polygon(points: &[[f64; 2]], pose: &Pose2) -> Body {
        let ring: LineString<f64> = points.iter().map(|p| (p[0], p[1])).collect();
        let own = Polygon::new(ring, Vec::new());
        let raw = own.earcut_triangles_raw();
        let n = points.len();
        let mut covered = 0.0;
        let mut pieces = Vec::with_capacity(raw.triangle_indices.len() / 3);
        for triple in raw.triangle_indices.chunks_exact(3) {
            let own = [points[triple[0] % n], points[triple[1] % n], points[triple[2] % n]];
            covered += geo::Triangle::from(own.map(|p| coord! { x: p[0], y: p[1] })).unsigned_area();
            let [p, q, r] = own.map(|p| placed(pose, p));
            match orient(p, q, r) {
                Orientation::CounterClockwise => pieces.push(Piece::Corners(vec![p, q, r])),
                Orientation::Clockwise => pieces.push(Piece::Corners(vec![p, r, q])),
                Orientation::Collinear => {}
            }
        }
        let sound = (covered - own.unsigned_area()).abs() <= 1e-9 * own.unsigned_area();
        let corners: Vec<Coord<f64>> = points.iter().map(|p| placed(pose, *p)).collect();
        let bounds = bounds_of(&corners);
        Body { pieces, outline: Some(Polygon::new(LineString::new(corners), Vec::new())), bounds, sound }
    }

    /// True when the two overlap by more than `depth` (m, at least [`TOUCH_M`]): some two convex pieces
    /// share interior points, and no shift of `depth` along an edge's normal parts them.
    pub fn overlaps_deeper(&self, other: &Body, depth: f64) -> bool {
        if !boxes_meet(&self.bounds, &other.bounds, 0.0) {
            return false;
        }
        if let (Some(mine), Some(theirs)) = (&self.outline, &other.outline) {
            // The whole outlines, without the triangles.
            if !mine.intersects(theirs) {
                return false;
            }
            if !self.sound || !other.sound {
                return true;
            }
        }
        self.any_pair(other, |a, b| pieces_deeper(a, b, depth))
    }

    /// True when the two are nearer than `clearance` (m), touching allowed for.
    pub fn nearer_than(&self, other: &Body, clearance: f64) -> bool {
        let limit = clearance - TOUCH_M;
        if !boxes_meet(&self.bounds, &other.bounds, clearance) {
            return false;
        }
        if let (Some(mine), Some(theirs)) = (&self.outline, &other.outline) {
            return Euclidean.distance(mine, theirs) < limit;
        }
        self.any_pair(other, |a, b| pieces_nearer(a, b, limit))
    }

    /// True when any of it lies more than `depth` (m) outside the table from (0, 0) to (width, height).
    pub fn reaches_over(&self, width: f64, height: f64, depth: f64) -> bool {
        let beyond =
            |p: &Coord<f64>| p.x < -depth || p.y < -depth || p.x > width + depth || p.y > height + depth;
        self.pieces.iter().any(|piece| match piece {
            Piece::Corners(corners) => corners.iter().any(beyond),
            // The circumscribed polygon touches the curve at its extremes: its bounds are the curve's.
            Piece::Curve(curve) => curve.outer(&curve.extreme_parameters()).iter().any(beyond),
        })
    }

    /// Depth of the overlap in m, from [`Body::overlaps_deeper`] by halving; for messages.
    pub fn depth(&self, other: &Body) -> f64 {
        halve(|depth| self.overlaps_deeper(other, depth), self.diagonal().max(other.diagonal()))
    }

    /// Distance in m if less than `up_to`, by halving; for messages.
    pub fn gap(&self, other: &Body, up_to: f64) -> f64 {
        halve(|clearance| !self.nearer_than(other, clearance + TOUCH_M), up_to)
    }

    /// Overhang over the table's edge in m, by halving; for messages.
    pub fn overhang(&self, width: f64, height: f64) -> f64 {
        let far = self.diagonal() + self.bounds.min().x.abs() + self.bounds.min().y.abs();
        halve(
            |depth| self.reaches_over(width, height, depth),
            far + self.bounds.max().x.abs() + self.bounds.max().y.abs(),
        )
    }

    fn diagonal(&self) -> f64 {
        self.bounds.width() + self.bounds.height()
    }

    fn any_pair(&self, other: &Body, test: impl Fn(&Piece, &Piece) -> bool) -> bool {
        self.pieces.iter().any(|mine| other.pieces.iter().any(|theirs| test(mine, theirs)))
    }
}

/// The value at which a question that is true below it becomes false.
fn halve(holds: impl Fn(f64) -> bool, most: f64) -> f64 {
    let (mut low, mut high) = (0.0, most);
    for _ in 0..48 {
        let middle = 0.5 * (low + high);
        if holds(middle) {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

fn placed(pose: &Pose2, p: [f64; 2]) -> Coord<f64> {
    let [x, y] = pose.transform(p);
    coord! { x: x, y: y }
}

fn bounds_of(corners: &[Coord<f64>]) -> Rect<f64> {
    let line = LineString::new(corners.to_vec());
    line.bounding_rect().unwrap_or_else(|| Rect::new(coord! { x: 0.0, y: 0.0 }, coord! { x: 0.0, y: 0.0 }))
}

fn boxes_meet(a: &Rect<f64>, b: &Rect<f64>, margin: f64) -> bool {
    a.min().x - margin <= b.max().x
        && b.min().x - margin <= a.max().x
        && a.min().y - margin <= b.max().y
        && b.min().y - margin <= a.max().y
}

fn orient(p: Coord<f64>, q: Coord<f64>, r: Coord<f64>) -> Orientation {
    RobustKernel::orient2d(p, q, r)
}

/// Outward unit normal of the edge from `p` to `q` of a counter-clockwise polygon.
fn normal(p: Coord<f64>, q: Coord<f64>) -> Coord<f64> {
    let edge = q - p;
    let length = edge.x.hypot(edge.y);
    coord! { x: edge.y / length, y: -edge.x / length }
}

fn edges(corners: &[Coord<f64>]) -> impl Iterator<Item = (Coord<f64>, Coord<f64>)> + '_ {
    corners.iter().copied().zip(corners.iter().copied().cycle().skip(1))
}

/// True when a shift by `depth` along an edge's normal puts one convex polygon wholly beyond that edge of
/// the other.
fn parted(a: &[Coord<f64>], b: &[Coord<f64>], depth: f64) -> bool {
    parted_by_edge(a, b, depth) || parted_by_edge(b, a, depth)
}

fn parted_by_edge(a: &[Coord<f64>], b: &[Coord<f64>], depth: f64) -> bool {
    edges(a).filter(|(p, q)| p != q).any(|(p, q)| {
        let shift = normal(p, q) * depth;
        b.iter().all(|corner| orient(p, q, *corner + shift) != Orientation::CounterClockwise)
    })
}

fn pieces_deeper(a: &Piece, b: &Piece, depth: f64) -> bool {
    if let (Piece::Corners(mine), Piece::Corners(theirs)) = (a, b) {
        return !parted(mine, theirs, depth);
    }
    let (mut mine, mut theirs) = (Bracket::new(a), Bracket::new(b));
    for _ in 0..MAX_ROUNDS {
        let (inner_a, inner_b) = (mine.inner(), theirs.inner());
        if !parted(&inner_a, &inner_b, depth) {
            return true;
        }
        let (outer_a, outer_b) = (mine.outer(), theirs.outer());
        if parted(&outer_a, &outer_b, depth) {
            return false;
        }
        let mut refined = false;
        for direction in [best_normal(&inner_a, &inner_b), best_normal(&outer_a, &outer_b)] {
            refined |= mine.refine(direction);
            refined |= theirs.refine(-direction);
        }
        if !refined {
            return true;
        }
    }
    true
}

fn pieces_nearer(a: &Piece, b: &Piece, limit: f64) -> bool {
    let (mut mine, mut theirs) = (Bracket::new(a), Bracket::new(b));
    for _ in 0..MAX_ROUNDS {
        let (inner_a, inner_b) = (mine.inner(), theirs.inner());
        if Euclidean.distance(&ring(&inner_a), &ring(&inner_b)) < limit {
            return true;
        }
        let (outer_a, outer_b) = (mine.outer(), theirs.outer());
        if Euclidean.distance(&ring(&outer_a), &ring(&outer_b)) >= limit {
            return false;
        }
        let mut refined = false;
        for direction in [nearest_direction(&inner_a, &inner_b), nearest_direction(&outer_a, &outer_b)] {
            refined |= mine.refine(direction);
            refined |= theirs.refine(-direction);
        }
        if !refined {
            return true;
        }
    }
    true
}

fn ring(corners: &[Coord<f64>]) -> Polygon<f64> {
    Polygon::new(LineString::new(corners.to_vec()), Vec::new())
}

/// The edge normal (pointing from `a` to `b`) along which the two are farthest apart or overlap least. Only
/// says where to refine; nothing is decided by it.
fn best_normal(a: &[Coord<f64>], b: &[Coord<f64>]) -> Coord<f64> {
    let mut best = (f64::NEG_INFINITY, coord! { x: 1.0, y: 0.0 });
    for (from, to, sign) in [(a, b, 1.0), (b, a, -1.0)] {
        for (p, q) in edges(from).filter(|(p, q)| p != q) {
            let n = normal(p, q);
            let gap = to.iter().map(|c| (*c - p).x * n.x + (*c - p).y * n.y).fold(f64::INFINITY, f64::min);
            if gap > best.0 {
                best = (gap, n * sign);
            }
        }
    }
    best.1
}

/// Direction from the nearest point of `a` to that of `b`. Only says where to refine.
fn nearest_direction(a: &[Coord<f64>], b: &[Coord<f64>]) -> Coord<f64> {
    let mut best = (f64::INFINITY, coord! { x: 1.0, y: 0.0 });
    for (from, to, sign) in [(a, b, 1.0), (b, a, -1.0)] {
        for point in from {
            for (p, q) in edges(to) {
                let (edge, to_point) = (q - p, *point - p);
                let squared = edge.x * edge.x + edge.y * edge.y;
                let share = ((to_point.x * edge.x + to_point.y * edge.y) / squared).clamp(0.0, 1.0);
                let way = p + edge * share - *point;
                let distance = way.x.hypot(way.y);
                if distance > 0.0 && distance < best.0 {
                    best = (distance, way * (sign / distance));
                }
            }
        }
    }
    best.1
}

impl Curve {
    fn point(&self, parameter: f64, stretch: f64) -> Coord<f64> {
        let (sin, cos) = parameter.sin_cos();
        placed(&self.pose, [self.a * stretch * cos, self.b * stretch * sin])
    }

    /// Parameter of the point farthest along `direction`, in [0, 2 pi).
    fn support(&self, direction: Coord<f64>) -> f64 {
        let (sin, cos) = self.pose.theta.sin_cos();
        let along = cos * direction.x + sin * direction.y;
        let across = -sin * direction.x + cos * direction.y;
        (self.b * across).atan2(self.a * along).rem_euclid(TAU)
    }

    /// Parameters of the extremes along the table's axes, and the points halfway between, ascending.
    fn extreme_parameters(&self) -> Vec<f64> {
        let directions = [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)];
        let mut out: Vec<f64> =
            directions.iter().map(|(x, y)| self.support(coord! { x: *x, y: *y })).collect();
        out.sort_by(f64::total_cmp);
        out.dedup_by(|a, b| (*a - *b).abs() < CLOSEST_PARAMETERS);
        let halves: Vec<f64> = arcs(&out).map(|(from, to)| (0.5 * (from + to)).rem_euclid(TAU)).collect();
        out.extend(halves);
        out.sort_by(f64::total_cmp);
        out
    }

    fn inner(&self, parameters: &[f64]) -> Vec<Coord<f64>> {
        parameters.iter().map(|parameter| self.point(*parameter, 1.0)).collect()
    }

    /// Corners where the tangents of neighbouring points meet.
    fn outer(&self, parameters: &[f64]) -> Vec<Coord<f64>> {
        arcs(parameters)
            .map(|(from, to)| self.point(0.5 * (from + to), 1.0 / (0.5 * (to - from)).cos()))
            .collect()
    }
}

/// Neighbouring parameters round the curve; the last arc ends beyond a full turn.
fn arcs(parameters: &[f64]) -> impl Iterator<Item = (f64, f64)> + '_ {
    let wrapped = parameters.first().map(|first| first + TAU);
    parameters.iter().copied().zip(parameters.iter().copied().skip(1).chain(wrapped))
}

/// A piece between two polygons, one within it and one around it.
struct Bracket<'a> {
    piece: &'a Piece,
    parameters: Vec<f64>,
}

impl<'a> Bracket<'a> {
    fn new(piece: &'a Piece) -> Bracket<'a> {
        let parameters = match piece {
            Piece::Corners(_) => Vec::new(),
            Piece::Curve(curve) => curve.extreme_parameters(),
        };
        Bracket { piece, parameters }
    }

    fn inner(&self) -> Vec<Coord<f64>> {
        match self.piece {
            Piece::Corners(corners) => corners.clone(),
            Piece::Curve(curve) => curve.inner(&self.parameters),
        }
    }

    fn outer(&self) -> Vec<Coord<f64>> {
        match self.piece {
            Piece::Corners(corners) => corners.clone(),
            Piece::Curve(curve) => curve.outer(&self.parameters),
        }
    }

    /// Adds the point that lies farthest along `direction`; false when it is there already.
    fn refine(&mut self, direction: Coord<f64>) -> bool {
        let Piece::Curve(curve) = self.piece else { return false };
        let parameter = curve.support(direction);
        let apart = |known: &f64| {
            let turn = (known - parameter).abs().rem_euclid(TAU);
            turn.min(TAU - turn) >= CLOSEST_PARAMETERS
        };
        if !self.parameters.iter().all(apart) {
            return false;
        }
        let at = self.parameters.partition_point(|known| *known < parameter);
        self.parameters.insert(at, parameter);
        true
    }
}
