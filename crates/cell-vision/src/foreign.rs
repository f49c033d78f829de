//! What lies on the table and carries no marker: a mug, a tool, a hand, an object on its face.
//!
//! In: [`HeightMap`]s of one look, the objects whose place is known, [`ForeignLimits`]. Out:
//! [`ForeignReport`]: everything that is higher than the table and the known objects explain, over an area
//! large enough, with its outline, area and height; and how much of the table was measured at all, with the
//! largest piece that was not. A known object that is tipped, or lies on its marker, was not seen as itself
//! and so explains nothing: it is found like any stranger. Where there is no depth, `change` decides by
//! colour. What is flat, thinner than the limit, smaller than the limit, or of a kind that the camera cannot
//! measure (clear glass, black velvet, mirrors) is not found. Pure.

pub mod body;
pub mod change;
pub mod field;
pub mod height_map;
pub mod holes;
pub mod search;
#[cfg(test)]
mod tests;

pub use body::KnownBody;
pub use height_map::{Area, DepthLens, HeightMap, HeightMapError, HeldBody, OwnBody};
pub use holes::Hole;

use crate::region::Region;
use rearrange::geometry::footprint::Footprint;
use rearrange::geometry::polygon::{centroid, contains, convex_hull, distance_to_outline};
use rearrange::geometry::pose::Pose2;
use rearrange::tabletop::instance::KeepOut;
use serde::{Deserialize, Serialize};

/// From which size on something counts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForeignLimits {
    /// Higher than what is expected by more than this, m.
    pub height_m: f64,
    /// Over at least this area, m2.
    pub area_m2: f64,
    /// So far round a known object its height is still expected: the ragged edges of stereo depth, m.
    pub edge_m: f64,
}

impl Default for ForeignLimits {
    fn default() -> ForeignLimits {
        ForeignLimits { height_m: 0.010, area_m2: 4e-4, edge_m: 0.008 }
    }
}

/// Something that nothing explains.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ForeignObject {
    /// Convex outline, counter-clockwise, m, table frame.
    pub outline: Vec<[f64; 2]>,
    /// Middle of the outline, m, table frame.
    pub centre: [f64; 2],
    /// The area of the table over which it was measured, m2.
    pub area_m2: f64,
    /// Height of its highest point over the table, m; infinite where only colour shows it.
    pub height_m: f64,
}

/// What depth says about a table.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ForeignReport {
    /// What nothing explains, the largest first.
    pub objects: Vec<ForeignObject>,
    /// Share of the area in which depth was measured, 0 to 1.
    pub measured_share: f64,
    /// The pieces of the table in which it was not, outside known objects and their shadows, the largest
    /// first.
    pub holes: Vec<Hole>,
    /// Found by comparing colours with those of the empty table; "measured" then means compared.
    pub by_colour: bool,
}

impl ForeignReport {
    /// The largest piece of the table in which nothing was measured.
    pub fn largest_hole(&self) -> Option<Hole> {
        self.holes.first().cloned()
    }
}

impl std::fmt::Display for ForeignObject {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let high = match self.height_m.is_finite() {
            true => format!("{:.0} mm high", self.height_m * 1e3),
            false => "of unknown height".to_string(),
        };
        write!(
            f,
            "something {high} over {:.0} cm2 at x = {:.0} mm, y = {:.0} mm",
            self.area_m2 * 1e4,
            self.centre[0] * 1e3,
            self.centre[1] * 1e3
        )
    }
}

impl ForeignObject {
    /// The outline with `margin_m` around it, as a place where nothing may be put; `None` for an outline
    /// without area.
    pub fn keep_out(&self, margin_m: f64) -> Option<KeepOut> {
        let grown: Vec<[f64; 2]> = self
            .outline
            .iter()
            .flat_map(|[x, y]| {
                (0..8).map(move |step| {
                    let (sin, cos) = (f64::from(step) * std::f64::consts::FRAC_PI_4).sin_cos();
                    // The octagon lies around the circle of the margin.
                    let reach = margin_m / (std::f64::consts::PI / 8.0).cos();
                    [x + reach * cos, y + reach * sin]
                })
            })
            .collect();
        let footprint = Footprint::polygon(&convex_hull(&grown)).ok()?;
        Some(KeepOut { footprint, pose: Pose2::default() })
    }
}

/// Everything in the maps of one look that neither the table nor `known` explains; over `ignored` nothing is
/// looked for.
///
/// A cell counts when any map says so: what was there in one picture may have been hidden in another.
pub fn find(
    maps: &[&HeightMap],
    known: &[KnownBody],
    ignored: &[KeepOut],
    limits: &ForeignLimits,
) -> ForeignReport {
    find_in(maps, known, ignored, limits, None)
}

/// The same where only a part of the table has to be measured: outside of it nothing counts as a hole. What
/// the maps show is foreign wherever it is.
pub fn find_in(
    maps: &[&HeightMap],
    known: &[KnownBody],
    ignored: &[KeepOut],
    limits: &ForeignLimits,
    region: Option<&Region>,
) -> ForeignReport {
    let Some(first) = maps.first() else { return ForeignReport::default() };
    let maps: Vec<&HeightMap> = maps.iter().copied().filter(|map| map.area == first.area).collect();
    let expected = Expected::of(first, known, ignored, limits);
    let cells = first.heights_m.len();
    let (mut tallest, mut measured) = (vec![f32::NEG_INFINITY; cells], vec![false; cells]);
    for map in maps.iter().filter(|map| map.by_colour) {
        let shaded = Shaded::of(known, map.eye_m, limits);
        for (cell, height) in map.heights_m.iter().enumerate() {
            if shaded.covers(map.centre(cell)) {
                measured[cell] = true;
            } else if !height.is_nan() {
                measured[cell] = true;
                if *height > expected.highest_m[cell] {
                    tallest[cell] = f32::INFINITY;
                }
            }
        }
    }
    for map in maps.iter().filter(|map| !map.by_colour) {
        let heights = map.levelled(&expected.surface_m);
        for (cell, height) in heights.into_iter().enumerate().filter(|(_, height)| height.is_finite()) {
            measured[cell] = true;
            if height > expected.highest_m[cell] {
                tallest[cell] = tallest[cell].max(height);
            }
        }
    }
    let counts = |cell: usize| region.is_none_or(|region| region.contains(first.centre(cell)));
    let excess = closed(first, &tallest, &measured);
    let mut objects: Vec<ForeignObject> = first
        .groups(&excess)
        .into_iter()
        .map(|cells| object(first, &cells, &tallest))
        .filter(|object| object.area_m2 >= limits.area_m2)
        .collect();
    objects.sort_by(|a, b| b.area_m2.total_cmp(&a.area_m2));
    // Known objects, their shadows and keep-outs are left out.
    let bare: Vec<bool> = expected
        .surface_m
        .iter()
        .enumerate()
        .map(|(cell, surface)| *surface == 0.0 && counts(cell))
        .collect();
    let unmeasured = holes::unmeasured(&maps, &bare, &measured, known);
    let count = |cells: &[bool]| cells.iter().filter(|cell| **cell).count() as f64;
    let bare_measured =
        bare.iter().zip(&measured).filter(|(bare, measured)| **bare && **measured).count() as f64;
    let requested = bare_measured + count(&unmeasured);
    let measured_share = if requested > 0.0 { bare_measured / requested } else { 1.0 };
    let holes = holes::pieces(first, &unmeasured);
    ForeignReport { objects, measured_share, holes, by_colour: first.by_colour }
}

/// What is expected of each cell.
struct Expected {
    /// Height up to which nothing is foreign, m.
    highest_m: Vec<f32>,
    /// Height of the surface that is seen when nothing is, m; NaN at the edges of known objects and where
    /// anything may be.
    surface_m: Vec<f32>,
}

impl Expected {
    fn of(map: &HeightMap, known: &[KnownBody], ignored: &[KeepOut], limits: &ForeignLimits) -> Expected {
        let cells = map.heights_m.len();
        let mut expected =
            Expected { highest_m: vec![limits.height_m as f32; cells], surface_m: vec![0.0; cells] };
        let fixed = ignored.iter().map(|place| (&place.footprint, &place.pose, f64::INFINITY));
        let known = known.iter().map(|body| (&body.footprint, &body.pose, body.height_m));
        for (footprint, pose, height_m) in known.chain(fixed) {
            expected.add(map, footprint, pose, height_m, limits);
        }
        expected
    }

    fn add(
        &mut self,
        map: &HeightMap,
        footprint: &Footprint,
        pose: &Pose2,
        height_m: f64,
        limits: &ForeignLimits,
    ) {
        let outline = footprint.outline(64);
        let (low, high) = footprint.bounds(pose);
        for cell in 0..self.highest_m.len() {
            let at = map.centre(cell);
            let far =
                |axis: usize| at[axis] < low[axis] - limits.edge_m || at[axis] > high[axis] + limits.edge_m;
            if far(0) || far(1) {
                continue;
            }
            let p = pose.inverse_transform(at);
            let at_edge = distance_to_outline(&outline, p) <= limits.edge_m;
            if !at_edge && !contains(&outline, p) {
                continue;
            }
            self.highest_m[cell] = self.highest_m[cell].max((height_m + limits.height_m) as f32);
            let on_top = !at_edge && height_m.is_finite() && self.surface_m[cell] == 0.0;
            self.surface_m[cell] = if on_top { height_m as f32 } else { f32::NAN };
        }
    }
}

/// What known objects change on the table's picture: where they are, what they hide from the camera, and
/// their shadows.
struct Shaded<'a> {
    known: Vec<(&'a KnownBody, Vec<[f64; 2]>)>,
    eye_m: [f64; 3],
    edge_m: f64,
}

/// A shadow reaches as far from an object as the object is high: light from 45 degrees up and steeper.
const SHADOW: f64 = 1.0;

impl Shaded<'_> {
    fn of<'a>(known: &'a [KnownBody], eye_m: [f64; 3], limits: &ForeignLimits) -> Shaded<'a> {
        let known = known.iter().map(|body| (body, body.footprint.outline(64))).collect();
        Shaded { known, eye_m, edge_m: limits.edge_m }
    }

    fn covers(&self, at: [f64; 2]) -> bool {
        self.known.iter().any(|(body, outline)| {
            let p = body.pose.inverse_transform(at);
            let near = self.edge_m + SHADOW * body.height_m;
            contains(outline, p)
                || distance_to_outline(outline, p) <= near
                || holes::hides(body, outline, at, self.eye_m)
        })
    }
}

/// The cells that stick out, with unmeasured ones among them: holes in depth must not cut a thing into
/// pieces.
fn closed(map: &HeightMap, tallest: &[f32], measured: &[bool]) -> Vec<bool> {
    let excess: Vec<bool> = tallest.iter().map(|height| *height > f32::NEG_INFINITY).collect();
    let mut closed = excess.clone();
    for cell in (0..excess.len()).filter(|cell| !measured[*cell]) {
        closed[cell] = map.neighbours(cell).filter(|near| excess[*near]).count() >= 4;
    }
    closed
}

fn object(map: &HeightMap, cells: &[usize], tallest: &[f32]) -> ForeignObject {
    let half = height_map::CELL_M / 2.0;
    let corners: Vec<[f64; 2]> = cells
        .iter()
        .flat_map(|cell| {
            let [x, y] = map.centre(*cell);
            [[x - half, y - half], [x + half, y - half], [x + half, y + half], [x - half, y + half]]
        })
        .collect();
    let outline = convex_hull(&corners);
    let height = cells.iter().map(|cell| tallest[*cell]).fold(0.0_f32, f32::max);
    ForeignObject {
        centre: centroid(&outline),
        outline,
        area_m2: cells.len() as f64 * height_map::CELL_M * height_map::CELL_M,
        height_m: f64::from(height),
    }
}
