//! Markers that were just seen, found again in the pictures that follow from the same place.
//!
//! In: a picture, and what the whole picture before it showed. Out: as from a whole picture, in a part of
//! the time. Only the surroundings of what was seen are searched; when one of the markers is not there
//! again, the whole picture is. What comes into view elsewhere is not noticed, so the first picture of every
//! look is searched whole.

use crate::detect::Detector;
use crate::detect::detection::{DetectError, Detection, sort};
use crate::detect::piece::{Piece, pieces};
use cell_values::image::GrayImage;

/// Free space about a marker, in its own edges and pixels: its white ring, and some motion.
const ROOM_EDGES: f64 = 0.5;
const ROOM_PX: f64 = 8.0;
/// A marker found this much further away, pixels, is another print of it.
const SAME_PX: f64 = 8.0;
/// Searching this share of the picture in pieces takes as long as all of it.
const WORTH_IT: f64 = 0.7;
impl Detector {
    /// The markers in a picture that shows about what `before` was found in.
    ///
    /// # Errors
    /// As [`Detector::detect`].
    pub fn detect_again(
        &mut self,
        picture: &GrayImage,
        before: &[Detection],
    ) -> Result<Vec<Detection>, DetectError> {
        let pieces = surroundings(before, picture.width, picture.height);
        let searched: u64 = pieces.iter().map(Piece::area).sum();
        let whole = u64::from(picture.width) * u64::from(picture.height);
        if before.is_empty() || searched as f64 > WORTH_IT * whole as f64 {
            return self.detect(picture);
        }
        let mut found = Vec::with_capacity(before.len());
        for piece in &pieces {
            let Some(cut) = piece.cut(picture) else { return self.detect(picture) };
            for mut detection in self.detect(&cut)? {
                piece.shift(&mut detection);
                found.push(detection);
            }
        }
        if !before.iter().all(|known| found.iter().any(|seen| is_same(known, seen))) {
            return self.detect(picture);
        }
        sort(&mut found);
        Ok(found)
    }
}

fn is_same(known: &Detection, seen: &Detection) -> bool {
    let ([x, y], [u, v]) = (known.centre(), seen.centre());
    known.id == seen.id && known.family == seen.family && (x - u).hypot(y - v) <= SAME_PX
}

/// Pieces about all markers.
fn surroundings(markers: &[Detection], width: u32, height: u32) -> Vec<Piece> {
    let about = |marker: &Detection| {
        Piece::about(&marker.corners, ROOM_EDGES * marker.edge_min_px() + ROOM_PX, width, height)
    };
    pieces(markers.iter().map(about).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::DetectSettings;
    use crate::testing::{self, Print, USUAL};
    use rearrange::geometry::pose::Pose2;

    /// Six markers in a corner of a 640 x 480 picture, two of them close together.
    fn prints(shift_m: f64) -> Vec<Print> {
        let place = |i: u32| {
            let (column, row) = (f64::from(i % 3), f64::from(i / 3));
            Pose2::new(-0.16 + 0.05 * column + shift_m, -0.1 + 0.06 * row, 0.55 * f64::from(i))
        };
        (0..6).map(|i| Print::level(i, 0.025, place(i), 0.0)).collect()
    }

    fn picture(prints: &[Print], seed: u64) -> GrayImage {
        let view = testing::looking_down(0.0, 0.0, 0.4, [0.0, 0.0], 0.0);
        testing::render(&testing::camera(640, 480), &view, prints, USUAL, seed)
    }

    fn ids(found: &[Detection]) -> Vec<u32> {
        found.iter().map(|detection| detection.id).collect()
    }

    #[test]
    fn the_same_markers_are_found_with_the_same_corners() {
        let mut detector = Detector::new(DetectSettings::default()).unwrap();
        let before = detector.detect(&picture(&prints(0.0), 1)).unwrap();
        assert_eq!(ids(&before), [0, 1, 2, 3, 4, 5]);
        let next = picture(&prints(0.0), 2);
        let searched: u64 = surroundings(&before, 640, 480).iter().map(Piece::area).sum();
        assert!(searched < 640 * 480 / 2, "{searched} px would be searched");
        let begun = std::time::Instant::now();
        let again = detector.detect_again(&next, &before).unwrap();
        let (in_pieces, begun) = (begun.elapsed(), std::time::Instant::now());
        let whole = detector.detect(&next).unwrap();
        println!("{searched} of {} px: {in_pieces:?}, whole {:?}", 640 * 480, begun.elapsed());
        assert_eq!(ids(&again), ids(&whole));
        for (a, b) in again.iter().zip(&whole) {
            let apart = a.corners.iter().zip(&b.corners).map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1]));
            assert!(apart.fold(0.0, f64::max) < 0.05, "{a:?} {b:?}");
        }
    }

    #[test]
    fn a_marker_that_has_moved_away_or_is_gone_has_the_whole_picture_searched() {
        let mut detector = Detector::new(DetectSettings::default()).unwrap();
        let before = detector.detect(&picture(&prints(0.0), 1)).unwrap();
        let moved = detector.detect_again(&picture(&prints(0.12), 2), &before).unwrap();
        assert_eq!(ids(&moved), [0, 1, 2, 3, 4, 5], "all of them elsewhere");
        let mut fewer = prints(0.0);
        fewer.remove(3);
        fewer.push(Print::level(9, 0.025, Pose2::new(0.12, 0.1, 0.3), 0.0));
        let found = detector.detect_again(&picture(&fewer, 3), &before).unwrap();
        assert_eq!(ids(&found), [0, 1, 2, 4, 5, 9], "one is gone, so a new one far away is seen too");
        assert_eq!(ids(&detector.detect_again(&picture(&fewer, 4), &[]).unwrap()), [0, 1, 2, 4, 5, 9]);
    }

    #[test]
    fn pieces_stay_inside_the_picture_and_apart() {
        let at = |x: f64, y: f64, edge: f64| Detection {
            corners: [[x, y + edge], [x + edge, y + edge], [x + edge, y], [x, y]],
            ..Detection::default()
        };
        let markers =
            [at(3.0, 3.0, 20.0), at(620.0, 460.0, 16.0), at(300.0, 200.0, 40.0), at(350.0, 205.0, 40.0)];
        let found = surroundings(&markers, 640, 480);
        assert_eq!(found.len(), 3, "the two in the middle share one: {found:?}");
        for piece in &found {
            assert!(piece.columns[1] <= 640 && piece.rows[1] <= 480);
            assert!(piece.columns[1] - piece.columns[0] >= 32 && piece.rows[1] - piece.rows[0] >= 32);
        }
        // Corners that are no numbers must not panic.
        surroundings(&[at(f64::NAN, 1.0, 5.0), at(1e12, -1e12, 5.0)], 640, 480);
        surroundings(&markers, 20, 10);
    }
}
