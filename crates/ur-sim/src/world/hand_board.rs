//! A calibration board on the hand: where its markers are printed on the plate, and the plate as it is
//! drawn.
//!
//! In: a [`HandBoard`]. Out: a thin prism with the prints on its top, at the flange. The grid is laid out
//! here and not by `cell_vision::board`, so that a board that is misread there does not agree with itself.
//! The plate is seen and hides what lies behind it; it weighs nothing and touches nothing.

use crate::render::scene::{Print, Prism};
use crate::world::section::Section;
use crate::world::spec::{HandBoard, WorldError};
use cell_values::image::tag36h11_bitmap;
use nalgebra::Isometry3;
use rearrange::geometry::pose::Pose2;
use std::sync::Arc;

/// Thickness of the plate, m.
const THICK_M: f64 = 0.003;
/// White round the outermost squares, as a share of a square's edge: their quiet rings, and as much again.
const RIM: f64 = 0.25;
/// Paper, grey levels.
const PAPER: [u8; 3] = [204, 204, 202];

/// The plate, ready to be drawn.
pub(super) struct Plate {
    flange_from_plate: Isometry3<f64>,
    section: Arc<Section>,
    prints: Vec<Print>,
}

/// Numbers of the markers on a board.
pub(super) fn numbers(board: &HandBoard) -> impl Iterator<Item = u32> + use<> {
    let [columns, rows] = board.grid;
    let first = board.first_id;
    (0..columns.saturating_mul(rows)).map(move |index| first.saturating_add(index))
}

impl Plate {
    /// The plate of a board.
    ///
    /// # Errors
    /// A number that is not in the family.
    pub(super) fn new(board: &HandBoard) -> Result<Plate, WorldError> {
        let pitch = board.size_m + board.gap_m;
        let middle = board.grid.map(|count| (pitch * f64::from(count) - board.gap_m) / 2.0);
        let centre = |index: u32| board.size_m / 2.0 + pitch * f64::from(index);
        let print = |(index, id): (usize, u32)| -> Result<Print, WorldError> {
            let cells = tag36h11_bitmap(id).ok_or_else(|| WorldError::no_marker("hand board", id))?;
            let (column, row) = (index as u32 % board.grid[0], index as u32 / board.grid[0]);
            let pose = Pose2::new(centre(column) - middle[0], centre(row) - middle[1], 0.0);
            Ok(Print { cells, size_m: board.size_m, pose })
        };
        let [length, width] = middle.map(|half| 2.0 * (half + RIM * board.size_m));
        Ok(Plate {
            // The print is on the board's plane, the plate behind it.
            flange_from_plate: board.flange_from_board
                * Isometry3::translation(middle[0], middle[1], -THICK_M),
            section: Arc::new(Section::rectangle(length, width)),
            prints: numbers(board).enumerate().map(print).collect::<Result<_, _>>()?,
        })
    }

    /// The plate where the flange carries it.
    pub(super) fn carried(&self, table_from_flange: &Isometry3<f64>) -> Prism {
        Prism {
            table_from_prism: table_from_flange * self.flange_from_plate,
            section: self.section.clone(),
            height_m: THICK_M,
            colour: PAPER,
            prints: self.prints.clone(),
        }
    }
}
