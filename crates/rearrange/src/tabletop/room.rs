//! Where something fits on an object's top: the largest upright square (a marker) and the place for the
//! cups.
//!
//! In: a footprint, lengths in m, object frame. Out: places with their sizes. Both questions are searches
//! for points with enough room around them, and room changes no faster than the point moves; so a search
//! over squares that halves the promising ones is exact to its stated tolerance, also on non-convex tops.

use crate::geometry::collision::TOUCH_M;
use crate::geometry::ellipse::distance_to_ellipse;
use crate::geometry::footprint::Footprint;
use crate::geometry::polygon::{Point, Polygon, contains, distance, distance_to_outline};
use std::cmp::Ordering;
use std::collections::BinaryHeap;
use std::f64::consts::{SQRT_2, TAU};

/// How exactly a place is searched for, m.
const EXACT_M: f64 = 2e-5;

/// A suction cup in the tool frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cup {
    /// Centre, m.
    pub x: f64,
    /// Centre, m.
    pub y: f64,
    /// Radius of the lip, m.
    pub radius: f64,
}

/// Where the tool takes hold of an object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grip {
    /// Where the tool's axis meets the top, object frame, m.
    pub point: Point,
    /// Angle of the tool's x axis in the object frame, rad; `None` when any will do (one cup on the axis).
    pub yaw: Option<f64>,
}

/// Yaws tried when the cups do not sit on the tool's axis alone.
const YAWS: usize = 24;

/// Edge of the largest square, its sides along the object's axes, that lies on the footprint, m. Too small
/// by at most 0.04 mm.
pub fn largest_square(footprint: &Footprint) -> f64 {
    match footprint {
        Footprint::Rectangle { length, width } => length.min(*width),
        Footprint::Disc { radius } => radius * SQRT_2,
        Footprint::Ellipse { length, width } => length * width / length.hypot(*width),
        Footprint::Polygon(polygon) => {
            let room = |p: Point| square_room(polygon.points(), p);
            2.0 * most_room(footprint, &room).max(0.0)
        }
    }
}

/// Centre nearest to the centroid for a square with this edge, its sides along the object's axes.
pub fn place_for_square(footprint: &Footprint, edge: f64) -> Option<Point> {
    let target = footprint.centroid();
    let half = edge / 2.0;
    match footprint {
        // Convex and symmetric: if the square fits anywhere, it fits in the middle.
        Footprint::Rectangle { .. } | Footprint::Disc { .. } | Footprint::Ellipse { .. } => {
            (edge <= largest_square(footprint) + TOUCH_M).then_some(target)
        }
        Footprint::Polygon(polygon) => {
            let room = |p: Point| square_room(polygon.points(), p) - half;
            nearest_with_room(footprint, target, 1.0, &room)
        }
    }
}

/// The grip nearest to the centroid at which every cup lies on the footprint (and on `grippable`, if that is
/// given) with `margin` to spare, m. The tool points down: its x axis lies at the yaw, its y axis 90 degrees
/// clockwise of that, seen from above.
pub fn place_for_cups(
    footprint: &Footprint,
    grippable: Option<&Polygon>,
    cups: &[Cup],
    margin: f64,
) -> Option<Grip> {
    let target = footprint.centroid();
    let on_axis = cups.iter().all(|cup| cup.x.hypot(cup.y) < 1e-9);
    let yaws = if on_axis { 1 } else { YAWS };
    let mut best: Option<(f64, Grip)> = None;
    for k in 0..yaws {
        let yaw = TAU * k as f64 / yaws as f64;
        let (sin, cos) = yaw.sin_cos();
        let room = |p: Point| {
            let rooms = cups.iter().map(|cup| {
                let at = [p[0] + cos * cup.x + sin * cup.y, p[1] + sin * cup.x - cos * cup.y];
                let on_area = grippable.map_or(f64::INFINITY, |area| signed_distance(area.points(), at));
                disc_room(footprint, at).min(on_area) - cup.radius - margin
            });
            rooms.fold(f64::INFINITY, f64::min)
        };
        if let Some(point) = nearest_with_room(footprint, target, SQRT_2, &room) {
            let off = distance(point, target);
            if best.is_none_or(|(least, _)| off < least - EXACT_M) {
                best = Some((off, Grip { point, yaw: (!on_axis).then_some(yaw) }));
            }
        }
    }
    best.map(|(_, grip)| grip)
}

/// Radius of the largest disc about `p` on the footprint, m; negative off the footprint.
fn disc_room(footprint: &Footprint, p: Point) -> f64 {
    match footprint {
        Footprint::Rectangle { length, width } => (length / 2.0 - p[0].abs()).min(width / 2.0 - p[1].abs()),
        Footprint::Disc { radius } => radius - p[0].hypot(p[1]),
        Footprint::Ellipse { length, width } => {
            let distance = distance_to_ellipse([length / 2.0, width / 2.0], p);
            if footprint.contains_point(p, 0.0) { distance } else { -distance }
        }
        Footprint::Polygon(polygon) => signed_distance(polygon.points(), p),
    }
}

fn signed_distance(points: &[Point], p: Point) -> f64 {
    let distance = distance_to_outline(points, p);
    if contains(points, p) { distance } else { -distance }
}

/// Half the edge of the largest upright square about `p` inside the polygon, negative outside: the distance
/// to the outline in the maximum norm.
fn square_room(points: &[Point], p: Point) -> f64 {
    let n = points.len();
    let edges = (0..n).map(|i| max_norm_to_segment(p, points[i], points[(i + 1) % n]));
    let distance = edges.fold(f64::INFINITY, f64::min);
    if contains(points, p) { distance } else { -distance }
}

/// Smallest max(|x|, |y|) from `p` to the segment: the function is convex and piecewise linear along it, so
/// its minimum is at an end or where x, y, x - y or x + y vanishes.
fn max_norm_to_segment(p: Point, a: Point, b: Point) -> f64 {
    let (ax, ay) = (a[0] - p[0], a[1] - p[1]);
    let (ux, uy) = (b[0] - a[0], b[1] - a[1]);
    let at = |t: f64| (ax + t * ux).abs().max((ay + t * uy).abs());
    let zeros = [(ax, ux), (ay, uy), (ax - ay, ux - uy), (ax + ay, ux + uy)];
    let inner = zeros
        .iter()
        .filter(|(_, slope)| *slope != 0.0)
        .map(|(value, slope)| (-value / slope).clamp(0.0, 1.0));
    inner.chain([0.0, 1.0]).map(at).fold(f64::INFINITY, f64::min)
}

/// A square of the search, ordered so that the most promising comes off the heap first.
struct Cell {
    centre: Point,
    half: f64,
    promise: f64,
}

impl PartialEq for Cell {
    fn eq(&self, other: &Cell) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Cell {}

impl PartialOrd for Cell {
    fn partial_cmp(&self, other: &Cell) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Cell {
    fn cmp(&self, other: &Cell) -> Ordering {
        self.promise.total_cmp(&other.promise)
    }
}

fn quarters(cell: &Cell) -> [(Point, f64); 4] {
    let half = cell.half / 2.0;
    let [x, y] = cell.centre;
    [[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]].map(|[i, j]| ([x + i * half, y + j * half], half))
}

/// Half edge of the square about `centre` that covers the footprint.
fn cover(footprint: &Footprint, centre: Point) -> f64 {
    let (low, high) = footprint.bounds(&Default::default());
    let reach = (0..2).map(|k| (high[k] - centre[k]).max(centre[k] - low[k]));
    reach.fold(0.0, f64::max)
}

/// Most room of any point, too small by at most [`EXACT_M`]; `room` changes at most as much as the larger of
/// the two coordinates.
fn most_room(footprint: &Footprint, room: &dyn Fn(Point) -> f64) -> f64 {
    let centre = footprint.centroid();
    let mut best = room(centre);
    let half = cover(footprint, centre);
    let mut cells = BinaryHeap::from([Cell { centre, half, promise: best + half }]);
    while let Some(cell) = cells.pop() {
        if cell.promise <= best + EXACT_M {
            break;
        }
        for (centre, half) in quarters(&cell) {
            let here = room(centre);
            best = best.max(here);
            if here + half > best + EXACT_M {
                cells.push(Cell { centre, half, promise: here + half });
            }
        }
    }
    best
}

/// The point nearest to `target` (farther by at most [`EXACT_M`]) whose room is not negative. Over a square
/// of half edge h, `room` changes by at most `slope` h from its centre. Where room is left for a few
/// micrometres only, it may be missed: looking closer would take ever longer along a strip that just fails.
fn nearest_with_room(
    footprint: &Footprint,
    target: Point,
    slope: f64,
    room: &dyn Fn(Point) -> f64,
) -> Option<Point> {
    const FINEST_M: f64 = 2e-6;
    let mut best: Option<(f64, Point)> = None;
    let half = cover(footprint, target);
    let mut cells = BinaryHeap::from([Cell { centre: target, half, promise: 0.0 }]);
    while let Some(cell) = cells.pop() {
        if best.is_some_and(|(least, _)| -cell.promise >= least - EXACT_M) {
            break;
        }
        let here = room(cell.centre);
        let off = distance(cell.centre, target);
        if here >= -TOUCH_M && best.is_none_or(|(least, _)| off < least) {
            best = Some((off, cell.centre));
        }
        if here + slope * cell.half < 0.0 || cell.half < FINEST_M {
            continue;
        }
        for (centre, half) in quarters(&cell) {
            let nearest = (distance(centre, target) - half * SQRT_2).max(0.0);
            cells.push(Cell { centre, half, promise: -nearest });
        }
    }
    best.map(|(_, point)| point)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn polygon(points: &[Point]) -> Footprint {
        Footprint::polygon(points).unwrap()
    }

    /// 0.12 by 0.12, arms 0.04 wide; its centroid lies off the arms' middle lines.
    fn angle() -> Footprint {
        polygon(&[[0.0, 0.0], [0.12, 0.0], [0.12, 0.04], [0.04, 0.04], [0.04, 0.12], [0.0, 0.12]])
    }

    #[track_caller]
    fn square_is_on(footprint: &Footprint, centre: Point, edge: f64) {
        for i in 0..=40 {
            for j in 0..=40 {
                let p =
                    [centre[0] + edge * (i as f64 / 40.0 - 0.5), centre[1] + edge * (j as f64 / 40.0 - 0.5)];
                // The square may touch the outline: look a micrometre inside.
                let q = [p[0] + (centre[0] - p[0]) * 1e-4, p[1] + (centre[1] - p[1]) * 1e-4];
                assert!(footprint.contains_point(q, 0.0), "{q:?} is off the top");
            }
        }
    }

    #[test]
    fn the_largest_square_of_each_shape_is_known() {
        let near = |footprint: &Footprint, edge: f64| {
            let found = largest_square(footprint);
            assert!(found <= edge + 1e-12 && found > edge - 5e-5, "{found} instead of {edge}");
            square_is_on(footprint, place_for_square(footprint, found).unwrap(), found);
            assert!(place_for_square(footprint, edge + 1e-4).is_none());
        };
        near(&Footprint::rectangle(0.2, 0.05).unwrap(), 0.05);
        near(&Footprint::disc(0.05).unwrap(), 0.05 * SQRT_2);
        near(&Footprint::ellipse(0.2, 0.1).unwrap(), 0.2 * 0.1 / 0.2f64.hypot(0.1));
        near(&angle(), 0.04);
        near(&polygon(&[[0.0, 0.0], [0.1, 0.0], [0.0, 0.1]]), 0.05);
        near(&polygon(&[[0.0, -0.05], [0.05, 0.0], [0.0, 0.05], [-0.05, 0.0]]), 0.05);
    }

    #[test]
    fn a_square_goes_as_near_to_the_centroid_as_it_can() {
        let bar = polygon(&[[0.0, 0.0], [0.2, 0.0], [0.2, 0.03], [0.0, 0.03]]);
        let place = place_for_square(&bar, 0.0299).unwrap();
        assert!(distance(place, [0.1, 0.015]) < 1e-4, "{place:?}");
        let corner = place_for_square(&angle(), 0.0398).unwrap();
        assert!(distance(corner, [0.02, 0.02]) < 0.03, "{corner:?}");
    }

    #[test]
    fn one_cup_sits_at_the_centroid_where_it_can_and_needs_no_yaw() {
        let cup = [Cup { x: 0.0, y: 0.0, radius: 0.01 }];
        let grip = place_for_cups(&Footprint::disc(0.03).unwrap(), None, &cup, 0.001).unwrap();
        assert_eq!(grip, Grip { point: [0.0, 0.0], yaw: None });
        let grip = place_for_cups(&angle(), None, &cup, 0.001).unwrap();
        assert!(angle().contains_point(grip.point, 0.011 - 1e-9), "{grip:?}");
        // The centroid (44 mm, 44 mm) is off the L; straight below it an arm begins at 40 mm, less 11 mm.
        assert!((distance(grip.point, [0.044, 0.044]) - 0.015).abs() < 3e-5, "{grip:?}");
    }

    #[test]
    fn what_is_too_narrow_for_the_cup_has_no_place() {
        let cup = [Cup { x: 0.0, y: 0.0, radius: 0.01 }];
        assert!(place_for_cups(&Footprint::rectangle(0.2, 0.0219).unwrap(), None, &cup, 0.001).is_none());
        assert!(place_for_cups(&Footprint::rectangle(0.2, 0.022).unwrap(), None, &cup, 0.001).is_some());
        assert!(place_for_cups(&Footprint::ellipse(0.1, 0.0219).unwrap(), None, &cup, 0.001).is_none());
    }

    #[test]
    fn cups_keep_to_the_grippable_area() {
        let cup = [Cup { x: 0.0, y: 0.0, radius: 0.01 }];
        let area = Polygon::new(&[[0.02, -0.02], [0.06, -0.02], [0.06, 0.02], [0.02, 0.02]]).unwrap();
        let grip =
            place_for_cups(&Footprint::rectangle(0.2, 0.1).unwrap(), Some(&area), &cup, 0.001).unwrap();
        assert!(distance(grip.point, [0.031, 0.0]) < 1e-4, "{grip:?}");
    }

    #[test]
    fn several_cups_choose_the_yaw_that_fits() {
        let cups = [Cup { x: 0.02, y: 0.0, radius: 0.01 }, Cup { x: -0.02, y: 0.0, radius: 0.01 }];
        let bar = Footprint::rectangle(0.03, 0.1).unwrap();
        let grip = place_for_cups(&bar, None, &cups, 0.001).unwrap();
        assert_eq!(grip.point, [0.0, 0.0]);
        assert!((grip.yaw.unwrap().cos()).abs() < 1e-9, "{grip:?}");
    }

    #[test]
    fn a_cup_off_the_axis_is_mirrored_by_the_tool_that_points_down() {
        let cups = [Cup { x: 0.0, y: 0.03, radius: 0.01 }, Cup { x: 0.0, y: 0.0, radius: 0.01 }];
        // Room for the second cup only at smaller y than the first: the tool's y axis must point to -y, yaw
        // 0.
        let area = Polygon::new(&[[-0.012, -0.05], [0.012, -0.05], [0.012, 0.012], [-0.012, 0.012]]).unwrap();
        let grip =
            place_for_cups(&Footprint::rectangle(0.1, 0.1).unwrap(), Some(&area), &cups, 0.001).unwrap();
        assert_eq!((grip.point, grip.yaw), ([0.0, 0.0], Some(0.0)));
    }
}
