//! A grid of markers on one flat sheet, as both configuration files describe the board in the robot's hand.
//!
//! In: located values and a decoder that collects complaints. Out: [`MarkerGrid`], lengths in m, or `None`
//! with a complaint kept. The markers are of the family that the table's markers are of, so that one
//! detector finds both.

use crate::fields::{optional, required_number};
use cell_values::image::tag36h11;
use rearrange::document::Location;
use rearrange::document::decode::{At, Decoder};
use std::ops::Range;

/// A grid of tag36h11 markers: number `first_id` in the lower left corner, from there to the right, then up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MarkerGrid {
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

impl MarkerGrid {
    /// The numbers of its markers.
    pub fn numbers(&self) -> Range<i64> {
        let first = i64::from(self.first_id);
        first..first + i64::from(self.columns) * i64::from(self.rows)
    }
}

/// The board that the hand carries before a fixed camera. Of the family that the table's markers are of, so
/// that one detector finds both.
pub fn board(decoder: &mut Decoder, at: &At) -> Option<MarkerGrid> {
    let fields = decoder.map(at, &["columns", "rows", "size", "gap", "first_id"])?;
    let mut count = |key: &str| {
        let at = fields.required(key, decoder)?;
        decoder.integer(&at, 1..=24).and_then(|count| u32::try_from(count).ok())
    };
    let (columns, rows) = (count("columns"), count("rows"));
    let size_m = required_number(decoder, &fields, "size", 0.003..=0.5, "m");
    let printed = size_m.map_or(0.0, |size| tag36h11::BOARD_GAP * size);
    let gap_m = optional(decoder, &fields, "gap", printed, |d, at| d.number_in(at, 0.0..=0.5, "m"));
    let last = i64::from(tag36h11::COUNT) - 1;
    let first_id = optional(decoder, &fields, "first_id", 0, |d, at| d.integer(at, 0..=last));
    let board = MarkerGrid {
        columns: columns?,
        rows: rows?,
        size_m: size_m?,
        gap_m: gap_m?,
        first_id: u32::try_from(first_id?).ok()?,
    };
    if board.numbers().end > last + 1 {
        decoder.complain_at(
            at,
            format!("markers {} and on are not in the family", last + 1),
            "lower first_id, or take a smaller board",
        );
        return None;
    }
    Some(board)
}

/// Complains at the place and keys given about a board with markers of these numbers, one of which is also
/// on the table.
pub fn board_apart(
    decoder: &mut Decoder,
    numbers: Range<i64>,
    mut on_table: impl Iterator<Item = i64>,
    (at, path): (Location, &str),
) {
    if let Some(number) = on_table.find(|number| numbers.contains(number)) {
        let message = format!("marker {number} of the board is also on the table");
        let help = "print the board with other numbers: celld markers --board 5x4 --first-id 100";
        decoder.complain(at, path, message, help);
    }
}
