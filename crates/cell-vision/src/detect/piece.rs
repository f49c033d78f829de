//! Pieces of a picture: where to search when not all of it has to be.
//!
//! In: corners in a picture, room about them. Out: rectangles that lie inside the picture and are large
//! enough for the library, cut out of it; those that overlap made one, so that nothing is found twice. Pure.

use crate::detect::detection::Detection;
use cell_values::image::GrayImage;

/// The library searches nothing smaller, pixels.
const PIECE_MIN: u32 = 32;

/// A piece of a picture: columns from..to, rows from..to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Piece {
    /// Columns, from and to.
    pub columns: [u32; 2],
    /// Rows, from and to.
    pub rows: [u32; 2],
}

impl Piece {
    /// About these corners, with so much room.
    pub fn about(corners: &[[f64; 2]; 4], room: f64, width: u32, height: u32) -> Piece {
        let span = |axis: usize, length: u32| {
            let of = corners.iter().map(|corner| corner[axis]);
            let (low, high) =
                of.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
            // Casts from outside the range end at its borders.
            let (from, to) = ((low - room).floor() as u32, ((high + room).ceil() as u32).min(length));
            let from = from.min(length.saturating_sub(PIECE_MIN)).min(to.saturating_sub(PIECE_MIN));
            [from, to.max(from + PIECE_MIN).min(length)]
        };
        Piece { columns: span(0, width), rows: span(1, height) }
    }

    /// Pixels in it.
    pub fn area(&self) -> u64 {
        u64::from(self.columns[1] - self.columns[0]) * u64::from(self.rows[1] - self.rows[0])
    }

    /// True for a place in it.
    pub fn holds(&self, [x, y]: [f64; 2]) -> bool {
        let within = |value: f64, [from, to]: [u32; 2]| (f64::from(from)..f64::from(to)).contains(&value);
        within(x, self.columns) && within(y, self.rows)
    }

    /// What was found in the cut, moved to where it is in the picture.
    pub fn shift(&self, detection: &mut Detection) {
        for corner in &mut detection.corners {
            corner[0] += f64::from(self.columns[0]);
            corner[1] += f64::from(self.rows[0]);
        }
    }

    fn touches(&self, other: &Piece) -> bool {
        let meet = |a: [u32; 2], b: [u32; 2]| a[0] < b[1] && b[0] < a[1];
        meet(self.columns, other.columns) && meet(self.rows, other.rows)
    }

    fn with(&self, other: &Piece) -> Piece {
        let both = |a: [u32; 2], b: [u32; 2]| [a[0].min(b[0]), a[1].max(b[1])];
        Piece { columns: both(self.columns, other.columns), rows: both(self.rows, other.rows) }
    }

    /// This part of the picture; `None` of a picture smaller than it.
    pub fn cut(&self, picture: &GrayImage) -> Option<GrayImage> {
        let [left, right] = self.columns.map(|column| column as usize);
        let rows = picture.data.chunks_exact(picture.width as usize).take(self.rows[1] as usize);
        let rows = rows.skip(self.rows[0] as usize).filter_map(|row| row.get(left..right));
        let data = rows.flatten().copied().collect();
        GrayImage::from_data(self.columns[1] - self.columns[0], self.rows[1] - self.rows[0], data).ok()
    }
}

/// Those that overlap made one: no marker is found twice.
pub(super) fn pieces(all: Vec<Piece>) -> Vec<Piece> {
    let mut pieces: Vec<Piece> = Vec::with_capacity(all.len());
    for mut piece in all {
        while let Some(at) = pieces.iter().position(|other| other.touches(&piece)) {
            piece = piece.with(&pieces.swap_remove(at));
        }
        pieces.push(piece);
    }
    pieces
}
