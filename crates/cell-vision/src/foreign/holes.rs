//! The pieces of the table in which depth measured nothing.
//!
//! In: the height maps of a look, the cells in which none of them measured anything, the known objects. Out:
//! [`Hole`]. Black, mirrors and clear glass leave such holes, and so do look poses that do not show all of
//! the table: something may be there unseen. Left out are what known objects hide from every look pose, and
//! gaps too narrow for anything to fit in. Pure.

use crate::foreign::body::KnownBody;
use crate::foreign::height_map::{CELL_M, HeightMap};
use rearrange::geometry::polygon::contains;
use serde::{Deserialize, Serialize};

/// Heights at which the line from a cell to the camera is tried against a known object, as shares of that
/// object's height.
const TRIED: [f64; 5] = [0.2, 0.4, 0.6, 0.8, 1.0];

/// A piece of the table in which nothing was measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Hole {
    /// Its size, m2.
    pub area_m2: f64,
    /// The mean of its cells, m, table frame.
    pub centre: [f64; 2],
    /// It lies within this distance of that, m.
    pub reach_m: f64,
    /// It lies within this convex outline, m, table frame; without corners where it has none.
    pub outline: Vec<[f64; 2]>,
}

impl std::fmt::Display for Hole {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [x, y] = self.centre.map(|at| at * 1e3);
        write!(f, "{:.0} cm2 in one piece about x = {x:.0} mm, y = {y:.0} mm", self.area_m2 * 1e4)
    }
}

/// The cells of the `bare` table in which nothing was `measured` though no known object hides them from
/// every look pose.
pub(crate) fn unmeasured(
    maps: &[&HeightMap],
    bare: &[bool],
    measured: &[bool],
    known: &[KnownBody],
) -> Vec<bool> {
    let outlines: Vec<Vec<[f64; 2]>> = known.iter().map(|body| body.footprint.outline(64)).collect();
    let hidden = |map: &HeightMap, at: [f64; 2]| {
        known.iter().zip(&outlines).any(|(body, outline)| hides(body, outline, at, map.eye_m))
    };
    let open =
        |cell: usize| bare[cell] && !measured[cell] && !maps.iter().all(|map| hidden(map, map.centre(cell)));
    (0..bare.len()).map(open).collect()
}

/// The groups of `open` cells into which a square of three cells fits, and what of them lies round such
/// squares, the largest first.
pub(crate) fn pieces(map: &HeightMap, open: &[bool]) -> Vec<Hole> {
    let wide: Vec<bool> =
        (0..open.len()).map(|cell| open[cell] && map.neighbours(cell).all(|near| open[near])).collect();
    let mut piece = vec![false; open.len()];
    for cell in (0..open.len()).filter(|cell| wide[*cell]) {
        piece[cell] = true;
        map.neighbours(cell).for_each(|near| piece[near] = true);
    }
    let mut holes: Vec<Hole> = map.groups(&piece).into_iter().map(|cells| hole(map, &cells)).collect();
    holes.sort_by(|a, b| b.area_m2.total_cmp(&a.area_m2));
    holes
}

fn hole(map: &HeightMap, cells: &[usize]) -> Hole {
    let mean =
        |axis: usize| cells.iter().map(|cell| map.centre(*cell)[axis]).sum::<f64>() / cells.len() as f64;
    let centre = [mean(0), mean(1)];
    let away = |cell: &usize| {
        let [x, y] = map.centre(*cell);
        (x - centre[0]).hypot(y - centre[1])
    };
    let reach_m = cells.iter().map(away).fold(0.0, f64::max) + CELL_M;
    let outline = octagon(cells.iter().map(|cell| map.centre(*cell)));
    Hole { area_m2: cells.len() as f64 * CELL_M * CELL_M, centre, reach_m, outline }
}

/// The octagon round cells with these centres: few corners, for it is held against hundreds of places.
fn octagon(cells: impl Iterator<Item = [f64; 2]> + Clone) -> Vec<[f64; 2]> {
    let direction = |k: usize| {
        let (sin, cos) = (k as f64 * std::f64::consts::FRAC_PI_4).sin_cos();
        [cos, sin]
    };
    // Half of a cell's diagonal beyond the farthest centre.
    let far = |k: usize| {
        let [a, b] = direction(k);
        let along = cells.clone().map(|[x, y]| a * x + b * y);
        along.fold(f64::NEG_INFINITY, f64::max) + CELL_M * std::f64::consts::FRAC_1_SQRT_2
    };
    let corner = |k: usize| {
        let ([a, b], [c, d], s, t) = (direction(k), direction(k + 1), far(k), far(k + 1));
        let area = a * d - b * c;
        [(s * d - t * b) / area, (t * a - s * c) / area]
    };
    (0..8).map(corner).collect()
}

/// True when a body is between a place on the table and the camera.
pub(crate) fn hides(body: &KnownBody, outline: &[[f64; 2]], at: [f64; 2], eye_m: [f64; 3]) -> bool {
    TRIED.iter().any(|share| {
        let up = share * body.height_m / eye_m[2];
        let on_line = [0, 1].map(|axis| at[axis] + (eye_m[axis] - at[axis]) * up);
        contains(outline, body.pose.inverse_transform(on_line))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_octagon_holds_every_cell_whole() {
        let cells = [[0.1, 0.2], [0.14, 0.2], [0.12, 0.26], [0.3, 0.21]];
        let outline = octagon(cells.into_iter());
        for [x, y] in cells {
            for (dx, dy) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
                let corner = [x + 0.499 * CELL_M * dx, y + 0.499 * CELL_M * dy];
                assert!(contains(&outline, corner), "{corner:?} in {outline:?}");
            }
        }
        assert!(!contains(&outline, [0.3, 0.3]) && !contains(&outline, [0.1, 0.1]));
    }
}
