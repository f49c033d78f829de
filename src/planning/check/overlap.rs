//! Overlap, depth and distance of placed footprints by polygons and `geo`'s robust predicates.
//!
//! A curve lies between an inscribed and a circumscribed polygon; both are refined until they agree. "Deeper
//! than t" means: the interiors meet, and no translation by t along an edge normal, or across the region of
//! overlap, parts them.

use crate::geometry::footprint::Footprint;
use crate::geometry::pose::Pose2;
use geo::coordinate_position::CoordPos;
use geo::dimensions::Dimensions;
use geo::{
    Area, BooleanOps, Coord, Distance, Euclidean, LineString, MultiPolygon, Polygon, Relate, Translate,
};
use std::f64::consts::TAU;

/// Vertices of the polygons about a curve, all round, at the first level.
const COARSE: usize = 64;

/// Vertices all round that the spacing of the finer levels corresponds to. The last differs from a curve of
/// 0.3 m semi-axis by less than 1e-9 m.
const LEVELS: [usize; 3] = [1024, 8192, 65_536];

/// A footprint at a pose.
pub(super) struct Body {
    kind: Kind,
    /// Lowest and highest coordinates.
    low: [f64; 2],
    high: [f64; 2],
}

enum Kind {
    Exact(Polygon<f64>),
    Curve { pose: Pose2, semi: [f64; 2] },
}

#[derive(Clone, Copy, PartialEq)]
enum Side {
    Inner,
    Outer,
}

impl Body {
    pub(super) fn new(footprint: &Footprint, pose: Pose2) -> Body {
        let kind = match footprint {
            Footprint::Disc { radius } => Kind::Curve { pose, semi: [*radius, *radius] },
            Footprint::Ellipse { length, width } => Kind::Curve { pose, semi: [length / 2.0, width / 2.0] },
            Footprint::Rectangle { .. } | Footprint::Polygon(_) => {
                Kind::Exact(ring(footprint.outline(4).iter().map(|p| pose.transform(*p))))
            }
        };
        let (low, high) = match &kind {
            Kind::Exact(polygon) => corners_box(polygon),
            Kind::Curve { pose, semi } => {
                let (sin, cos) = pose.theta.sin_cos();
                let x = ((semi[0] * cos).powi(2) + (semi[1] * sin).powi(2)).sqrt();
                let y = ((semi[0] * sin).powi(2) + (semi[1] * cos).powi(2)).sqrt();
                ([pose.x - x, pose.y - y], [pose.x + x, pose.y + y])
            }
        };
        Body { kind, low, high }
    }

    fn is_curve(&self) -> bool {
        matches!(self.kind, Kind::Curve { .. })
    }

    /// The body's polygon; a curve is refined to the spacing of `vertices` all round in `windows`.
    fn polygon(&self, side: Side, windows: &[[f64; 2]], vertices: usize) -> Polygon<f64> {
        match &self.kind {
            Kind::Exact(polygon) => polygon.clone(),
            Kind::Curve { pose, semi } => {
                let angles = angles(windows, vertices);
                let n = angles.len();
                ring((0..n).map(|k| {
                    let (from, to) = (angles[k], if k + 1 < n { angles[k + 1] } else { angles[0] + TAU });
                    // Inside: points of the curve. Outside: where the tangents at two neighbours meet.
                    let (angle, grown) = match side {
                        Side::Inner => (from, 1.0),
                        Side::Outer => (0.5 * (from + to), 1.0 / (0.5 * (to - from)).cos()),
                    };
                    let (sin, cos) = angle.sin_cos();
                    pose.transform([semi[0] * grown * cos, semi[1] * grown * sin])
                }))
            }
        }
    }

    /// Stretches of the curve's parameter near the given points.
    fn windows(&self, near: &MultiPolygon<f64>) -> Vec<[f64; 2]> {
        let Kind::Curve { pose, semi } = &self.kind else { return Vec::new() };
        let reach = 2.0 * TAU / COARSE as f64;
        let angle = |c: &Coord<f64>| {
            let local = pose.inverse_transform([c.x, c.y]);
            (local[1] / semi[1]).atan2(local[0] / semi[0]).rem_euclid(TAU)
        };
        let corners = near.iter().flat_map(|region| region.exterior().coords());
        corners.map(|c| [angle(c) - reach, angle(c) + reach]).collect()
    }

    fn boxes_apart(&self, other: &Body, gap: f64) -> bool {
        (0..2).any(|k| self.low[k] - other.high[k] > gap || other.low[k] - self.high[k] > gap)
    }
}

/// How far a body reaches over the edge of the table, m; negative inside.
pub(super) fn overhang(body: &Body, width: f64, height: f64) -> f64 {
    (-body.low[0]).max(-body.low[1]).max(body.high[0] - width).max(body.high[1] - height)
}

/// True when the two overlap by more than `tolerance`, m.
pub(super) fn deeper_than(a: &Body, b: &Body, tolerance: f64) -> bool {
    if a.boxes_apart(b, 0.0) {
        return false;
    }
    decide(a, b, |p, q| polygons_deeper(p, q, tolerance))
}

/// True when the two are nearer to each other than `distance`, m.
pub(super) fn nearer_than(a: &Body, b: &Body, distance: f64) -> bool {
    if a.boxes_apart(b, distance) {
        return false;
    }
    decide(a, b, |p, q| Euclidean.distance(p, q) < distance)
}

/// Decides a question that holds for shapes whenever it holds for smaller ones. Where coarse polygons leave
/// it open, the curves are refined near the places where those overlap. At the finest level an answer that
/// still depends on the side is within a nanometre of the limit and counts as no.
fn decide(a: &Body, b: &Body, question: impl Fn(&Polygon<f64>, &Polygon<f64>) -> bool) -> bool {
    let pair = |side, near: (&[[f64; 2]], &[[f64; 2]]), vertices| {
        (a.polygon(side, near.0, vertices), b.polygon(side, near.1, vertices))
    };
    let (outer_a, outer_b) = pair(Side::Outer, (&[], &[]), COARSE);
    let outer = question(&outer_a, &outer_b);
    if !outer || (!a.is_curve() && !b.is_curve()) {
        return outer;
    }
    let (inner_a, inner_b) = pair(Side::Inner, (&[], &[]), COARSE);
    if question(&inner_a, &inner_b) {
        return true;
    }
    let overlap = outer_a.intersection(&outer_b);
    let everywhere = || vec![[0.0, TAU]];
    let windows = |body: &Body| if overlap.0.is_empty() { everywhere() } else { body.windows(&overlap) };
    let (near_a, near_b) = (windows(a), windows(b));
    for vertices in LEVELS {
        let (p, q) = pair(Side::Outer, (&near_a, &near_b), vertices);
        if !question(&p, &q) {
            return false;
        }
        let (p, q) = pair(Side::Inner, (&near_a, &near_b), vertices);
        if question(&p, &q) {
            return true;
        }
    }
    false
}

/// Parameters of a curve's samples, ascending in [0, 2 pi): coarse, and fine inside the windows.
fn angles(windows: &[[f64; 2]], vertices: usize) -> Vec<f64> {
    let step = TAU / vertices.max(COARSE) as f64;
    let coarse = (vertices.max(COARSE) / COARSE).max(1);
    let inside = |angle: f64| {
        windows.iter().any(|w| [angle, angle - TAU, angle + TAU].iter().any(|a| (w[0]..=w[1]).contains(a)))
    };
    let spans: Vec<bool> = (0..COARSE).map(|k| inside((k as f64 + 0.5) * TAU / COARSE as f64)).collect();
    let mut out = Vec::new();
    for (k, fine) in spans.iter().enumerate() {
        let points = if *fine { coarse } else { 1 };
        let stride = if *fine { 1 } else { coarse };
        out.extend((0..points).map(|p| (k * coarse + p * stride) as f64 * step));
    }
    out
}

/// Depth of an overlap, m, to a nanometre or a thousandth; for messages.
pub(super) fn depth(a: &Body, b: &Body) -> f64 {
    let whole = [[0.0, TAU]];
    let (p, q) = (a.polygon(Side::Outer, &whole, LEVELS[0]), b.polygon(Side::Outer, &whole, LEVELS[0]));
    let (mut low, mut high) = (0.0, 10.0);
    while high - low > 1e-9 + 1e-3 * low {
        let middle = 0.5 * (low + high);
        if polygons_deeper(&p, &q, middle) {
            low = middle;
        } else {
            high = middle;
        }
    }
    high
}

fn polygons_deeper(p: &Polygon<f64>, q: &Polygon<f64>, tolerance: f64) -> bool {
    if !interiors_meet(p, q) {
        return false;
    }
    // If a translation by t along n parted them, the overlap would be at most t wide along n, and no longer
    // across than the shape: an overlap of more area is deeper, whatever the direction.
    let overlap = p.intersection(q);
    let (low, high) = corners_box(p);
    let longest = (high[0] - low[0]).hypot(high[1] - low[1]);
    if overlap.unsigned_area() > 2.0 * tolerance * longest {
        return true;
    }
    let parts = |n: &[f64; 2]| {
        let moved = |sign: f64| p.translate(sign * n[0] * tolerance, sign * n[1] * tolerance);
        !interiors_meet(&moved(1.0), q) || !interiors_meet(&moved(-1.0), q)
    };
    !directions(p, q, &overlap).iter().any(parts)
}

fn interiors_meet(p: &Polygon<f64>, q: &Polygon<f64>) -> bool {
    p.relate(q).get(CoordPos::Inside, CoordPos::Inside) == Dimensions::TwoDimensional
}

/// Polygons with at most this many edges lend their normals as directions of escape.
const FEW_EDGES: usize = 24;

/// Unit directions along which the two may come apart soonest.
fn directions(p: &Polygon<f64>, q: &Polygon<f64>, overlap: &MultiPolygon<f64>) -> Vec<[f64; 2]> {
    let mut out = Vec::new();
    for polygon in [p, q] {
        let lines: Vec<_> = polygon.exterior().lines().collect();
        if lines.len() <= FEW_EDGES {
            out.extend(lines.iter().map(|line| unit([line.dy(), -line.dx()])));
        }
    }
    // Across the region of overlap: normal to the longest line between two of its corners.
    for region in overlap {
        let corners: Vec<Coord<f64>> = region.exterior().coords().copied().collect();
        out.push(normal_to_longest(&corners));
    }
    out
}

fn normal_to_longest(corners: &[Coord<f64>]) -> [f64; 2] {
    let far = |from: Coord<f64>| {
        let length = |c: &Coord<f64>| (c.x - from.x).hypot(c.y - from.y);
        corners.iter().copied().max_by(|a, b| length(a).total_cmp(&length(b))).unwrap_or(from)
    };
    // Twice to the farthest corner: exact for the thin regions this is for.
    let one = far(corners.first().copied().unwrap_or_default());
    let two = far(one);
    unit([two.y - one.y, one.x - two.x])
}

fn unit(v: [f64; 2]) -> [f64; 2] {
    let length = v[0].hypot(v[1]);
    if length > 0.0 { [v[0] / length, v[1] / length] } else { [1.0, 0.0] }
}

fn ring(points: impl Iterator<Item = [f64; 2]>) -> Polygon<f64> {
    Polygon::new(
        points.map(|p| (p[0], p[1])).collect::<Vec<_>>().into_iter().collect::<LineString<f64>>(),
        vec![],
    )
}

fn corners_box(polygon: &Polygon<f64>) -> ([f64; 2], [f64; 2]) {
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for c in polygon.exterior().coords() {
        low = [low[0].min(c.x), low[1].min(c.y)];
        high = [high[0].max(c.x), high[1].max(c.y)];
    }
    (low, high)
}
