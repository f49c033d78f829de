//! Calibration boards: a grid of markers on one flat sheet.
//!
//! In: family, how many markers, their size and distance. Out: where each marker and each of its corners
//! lies on the board, m. The board frame has its origin in the lower left corner of the lower left marker, x
//! right, y up, z out of the print; numbers run from there to the right, then up. Pure data.

use crate::detect::{Detection, Family};
use crate::marker;
use cell_values::image::tag36h11::BOARD_GAP;

/// A grid of markers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Board {
    /// Whose markers.
    pub family: Family,
    /// Markers across.
    pub columns: u32,
    /// Markers up.
    pub rows: u32,
    /// Edge of a marker's black square, m.
    pub size_m: f64,
    /// White between two neighbours' squares, m.
    pub gap_m: f64,
    /// Number of the lower left marker.
    pub first_id: u32,
}

impl Board {
    /// A board with the usual gap.
    pub fn new(family: Family, columns: u32, rows: u32, size_m: f64, first_id: u32) -> Board {
        Board { family, columns, rows, size_m, gap_m: BOARD_GAP * size_m, first_id }
    }

    /// How many markers it has.
    pub fn count(&self) -> u32 {
        self.columns * self.rows
    }

    /// Its markers: number and centre in the board frame, m.
    pub fn markers(&self) -> impl Iterator<Item = (u32, [f64; 2])> + '_ {
        let pitch = self.size_m + self.gap_m;
        let at = move |index: u32| self.size_m / 2.0 + pitch * f64::from(index);
        (0..self.count()).map(move |i| (self.first_id + i, [at(i % self.columns), at(i / self.columns)]))
    }

    /// From the lower left corner to the upper right, m.
    pub fn extent_m(&self) -> [f64; 2] {
        let pitch = self.size_m + self.gap_m;
        [self.columns, self.rows].map(|n| pitch * f64::from(n) - self.gap_m)
    }

    /// Corners of marker `id` in the board frame, m, in the order of `Detection::corners`.
    pub fn corners(&self, id: u32) -> Option<[[f64; 2]; 4]> {
        let (_, [x, y]) = self.markers().find(|(marker, _)| *marker == id)?;
        Some(marker::corners_m(self.size_m).map(|[dx, dy]| [x + dx, y + dy]))
    }

    /// The board's corners among detections: where they are on the board (m) and in the picture (pixels). A
    /// marker that is seen twice is left out: one of the two is something else.
    pub fn seen(&self, detections: &[Detection]) -> (Vec<[f64; 2]>, Vec<[f64; 2]>) {
        let (mut on_board, mut in_picture) = (Vec::new(), Vec::new());
        for detection in detections {
            let twice = detections.iter().filter(|d| d.id == detection.id && d.family == detection.family);
            if detection.family != self.family.name() || twice.count() > 1 {
                continue;
            }
            if let Some(corners) = self.corners(detection.id) {
                on_board.extend(corners);
                in_picture.extend(detection.corners);
            }
        }
        (on_board, in_picture)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn markers_stand_in_a_grid_from_the_lower_left() {
        let board = Board::new(Family::Tag36h11, 3, 2, 0.04, 10);
        let markers: Vec<_> = board.markers().collect();
        assert_eq!(markers.iter().map(|m| m.0).collect::<Vec<_>>(), [10, 11, 12, 13, 14, 15]);
        let corner = board.corners(14).unwrap()[0];
        assert!((corner[0] - 0.052).abs() < 1e-12 && (corner[1] - 0.052).abs() < 1e-12, "{corner:?}");
        assert!((board.extent_m()[0] - 0.144).abs() < 1e-12 && (board.extent_m()[1] - 0.092).abs() < 1e-12);
        assert!(board.corners(16).is_none());
    }

    #[test]
    fn strangers_and_twins_are_no_part_of_it() {
        let board = Board::new(Family::Tag36h11, 2, 2, 0.04, 0);
        let detection = |family: Family, id| Detection {
            family: family.name().to_owned(),
            id,
            corners: [[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]],
            decision_margin: 50.0,
            hamming: 0,
        };
        let ours = |id| detection(Family::Tag36h11, id);
        let (on_board, in_picture) =
            board.seen(&[ours(0), ours(1), ours(1), ours(9), detection(Family::Tag25h9, 2)]);
        assert_eq!((on_board.len(), in_picture.len()), (4, 4));
    }
}
