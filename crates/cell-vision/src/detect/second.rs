//! The second pass: other ways of searching, where something expected is missing.
//!
//! In: a picture, what one pass found in it, what should be in it. Out: what was found, and what else the
//! other ways show. No single way of searching is best in every picture: a coarse one bridges covered
//! borders and motion, a blurred one noise, a fine one reads what is small. Together they take up to ten
//! times as long as the first pass, so they are tried one after the other, until nothing expected is
//! missing. A false id is worse than a missing one: what is not expected has to look more like its print
//! than what is.

use crate::detect::detection::{DetectError, Detection, sort};
use crate::detect::family::Family;
use crate::detect::library::Way;
use crate::detect::piece::{Piece, pieces};
use crate::detect::{Detector, Rule, levels};
use cell_values::image::GrayImage;

/// The other ways, the most rewarding for their time first. Shares of markers found in 14 pictures with 196
/// markers (the benchmark's and prints laid into photographs), by the first pass alone and with each:
/// noise 35: 62 %, coarse 69 %, blurred 96 %; motion 9 px: 45 %, coarse 64 %, coarsest 78 % of the
/// benchmark's; defocus 2 px: 83 %, fine 86 %; edges of 9 to 22 px: 50 %, fine 73 %.
const WAYS: [Way; 4] = [
    // Coarse: what is covered or has moved.
    Way { decimate: 2.0, sharpen_px: 0.0, tone: 1.0, contrast_min: 5, edge_min_px: 14.0 },
    // Blurred at full size: noise, blocks of JPEG, glare.
    Way { decimate: 1.0, sharpen_px: -0.8, tone: 1.0, contrast_min: 8, edge_min_px: 14.0 },
    // Sharpened at full size: small ones.
    Way { decimate: 1.0, sharpen_px: 1.1, tone: 0.75, contrast_min: 12, edge_min_px: 14.0 },
    // Coarsest: large ones that have moved further.
    Way { decimate: 3.0, sharpen_px: 0.0, tone: 1.0, contrast_min: 5, edge_min_px: 14.0 },
];

/// Room about a place where something is expected, pixels and its own edges: it may have been nudged.
const ROOM_PX: f64 = 24.0;
const ROOM_EDGES: f64 = 2.0;

/// A marker that should be in a picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Expected {
    /// Its family.
    pub family: Family,
    /// Its number.
    pub id: u32,
    /// About where its corners are, pixels, if that is known: nowhere else it is expected.
    pub corners: Option<[[f64; 2]; 4]>,
}

impl Expected {
    /// Somewhere in the picture.
    pub fn anywhere(family: Family, id: u32) -> Expected {
        Expected { family, id, corners: None }
    }

    fn piece(&self, picture: &GrayImage) -> Option<Piece> {
        let corners = self.corners?;
        let at = Detection { corners, ..Detection::default() };
        Some(Piece::about(&corners, ROOM_EDGES * at.edge_min_px() + ROOM_PX, picture.width, picture.height))
    }

    /// True when this is it, at its place if that is known.
    fn is(&self, seen: &Detection, picture: &GrayImage) -> bool {
        let there = self.piece(picture).is_none_or(|piece| piece.holds(seen.centre()));
        seen.id == self.id && seen.family == self.family.name() && there
    }
}

impl Detector {
    /// As [`Detector::detect`], and where something expected is missing, a second pass.
    ///
    /// # Errors
    /// As [`Detector::detect`].
    pub fn detect_expected(
        &mut self,
        picture: &GrayImage,
        expected: &[Expected],
    ) -> Result<Vec<Detection>, DetectError> {
        let found = self.detect(picture)?;
        self.look_again(picture, found, expected)
    }

    /// Searches in every way, whether something is missing or not: for single pictures of unknown content.
    ///
    /// # Errors
    /// As [`Detector::detect`].
    pub fn detect_thoroughly(
        &mut self,
        picture: &GrayImage,
        expected: &[Expected],
    ) -> Result<Vec<Detection>, DetectError> {
        let mut found = self.detect(picture)?;
        let expected: Vec<&Expected> = expected.iter().collect();
        let stretched = levels::stretched(picture);
        let to_fit = stretched.as_ref().unwrap_or(picture);
        for way in WAYS {
            self.search_more([picture, to_fit], None, way, &expected, &mut found)?;
        }
        sort(&mut found);
        Ok(found)
    }

    /// The second pass alone: `found`, and what else there is if something of `expected` is not among it.
    ///
    /// # Errors
    /// As [`Detector::detect`].
    pub fn look_again(
        &mut self,
        picture: &GrayImage,
        mut found: Vec<Detection>,
        expected: &[Expected],
    ) -> Result<Vec<Detection>, DetectError> {
        let mut missing: Vec<&Expected> = expected.iter().collect();
        let mut stretched = None;
        for way in WAYS {
            missing.retain(|one| !found.iter().any(|seen| one.is(seen, picture)));
            if missing.is_empty() {
                break;
            }
            let to_fit = stretched.get_or_insert_with(|| levels::stretched(picture)).as_ref();
            let pictures = [picture, to_fit.unwrap_or(picture)];
            // Where the place of each is known, nothing else is searched.
            let places: Option<Vec<Piece>> = missing.iter().map(|one| one.piece(picture)).collect();
            match places.map(pieces) {
                Some(places) => {
                    for piece in &places {
                        self.search_more(pictures, Some(piece), way, &missing, &mut found)?;
                    }
                }
                None => self.search_more(pictures, None, way, &missing, &mut found)?,
            }
        }
        sort(&mut found);
        Ok(found)
    }

    /// Adds what this way shows in a piece of the picture, or in all of it, beside what has been found;
    /// corners are fitted in the second picture, which is the first one stretched.
    fn search_more(
        &mut self,
        [picture, to_fit]: [&GrayImage; 2],
        piece: Option<&Piece>,
        way: Way,
        missing: &[&Expected],
        found: &mut Vec<Detection>,
    ) -> Result<(), DetectError> {
        let cut = piece.and_then(|piece| piece.cut(picture));
        let seen = match (piece, &cut) {
            (Some(piece), Some(cut)) => {
                let mut seen = self.pass(cut, way)?;
                seen.iter_mut().for_each(|one| piece.shift(&mut one.detection));
                seen
            }
            _ => self.pass(picture, way)?,
        };
        for one in seen {
            let expected = missing.iter().any(|missing| missing.is(&one.detection, picture));
            let rule = if expected { Rule::ANY } else { Rule::STRANGER };
            if !self.passes(&one, rule) {
                continue;
            }
            if let Some(detection) = self.refined(one, to_fit)
                && !found.iter().any(|known| overlap(known, &detection))
            {
                found.push(detection);
            }
        }
        Ok(())
    }
}

/// True when both are read from the same print: at most one of them is right, the one that was first.
fn overlap(a: &Detection, b: &Detection) -> bool {
    let ([x, y], [u, v]) = (a.centre(), b.centre());
    (x - u).hypot(y - v) < 0.5 * a.edge_min_px().max(b.edge_min_px())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::DetectSettings;
    use crate::testing::{self, Degrade, Print};
    use rearrange::geometry::pose::Pose2;

    /// Six markers of 25 mm in so much noise that one pass overlooks some of them.
    fn noisy() -> (GrayImage, Vec<Print>, Vec<[[f64; 2]; 4]>) {
        let place = |i: u32| {
            let (column, row) = (f64::from(i % 3), f64::from(i / 3));
            Pose2::new(0.06 * (column - 1.0), 0.07 * (row - 0.5), 0.55 * f64::from(i))
        };
        let prints: Vec<Print> = (0..6).map(|i| Print::level(i, 0.025, place(i), 0.0)).collect();
        let (camera, view) =
            (testing::camera(640, 480), testing::looking_down(0.0, 0.0, 0.4, [0.0, 0.0], 0.0));
        let noise = Degrade { blur_px: 0.8, noise: 60.0, gradient: 0.7 };
        let corners = prints.iter().map(|print| print.corners(&camera, &view)).collect();
        (testing::render(&camera, &view, &prints, noise, 11), prints, corners)
    }

    fn ids(found: &[Detection]) -> Vec<u32> {
        found.iter().map(|detection| detection.id).collect()
    }

    #[test]
    fn what_is_expected_is_found_by_the_second_pass_and_nothing_is_searched_when_nothing_is_missing() {
        let (picture, ..) = noisy();
        let mut detector = Detector::new(DetectSettings::default()).unwrap();
        let first = detector.detect(&picture).unwrap();
        assert!(first.len() < 6, "the first pass finds all: nothing is shown here");
        let all: Vec<Expected> = (0..6).map(|id| Expected::anywhere(Family::Tag36h11, id)).collect();
        assert_eq!(ids(&detector.detect_expected(&picture, &all).unwrap()), [0, 1, 2, 3, 4, 5]);
        let seen: Vec<Expected> =
            first.iter().map(|seen| Expected::anywhere(Family::Tag36h11, seen.id)).collect();
        assert_eq!(detector.detect_expected(&picture, &seen).unwrap(), first);
        assert_eq!(detector.detect_expected(&picture, &[]).unwrap(), first);
    }

    #[test]
    fn where_the_place_is_known_only_that_is_searched() {
        let (picture, _, corners) = noisy();
        let mut detector = Detector::new(DetectSettings::default()).unwrap();
        let first = ids(&detector.detect(&picture).unwrap());
        let lost = (0..6).find(|id| !first.contains(id)).unwrap();
        let at =
            |corners: [[f64; 2]; 4]| Expected { family: Family::Tag36h11, id: lost, corners: Some(corners) };
        let here = detector.detect_expected(&picture, &[at(corners[lost as usize])]).unwrap();
        assert!(ids(&here).contains(&lost), "{here:?}");
        // A corner of the picture where nothing lies: the rest of it is not searched.
        let nowhere = [[20.0, 60.0], [60.0, 60.0], [60.0, 20.0], [20.0, 20.0]];
        let there = detector.detect_expected(&picture, &[at(nowhere)]).unwrap();
        assert_eq!(ids(&there), first);
    }

    #[test]
    fn without_anything_expected_every_way_is_gone_and_nothing_is_found_twice() {
        let (picture, ..) = noisy();
        let mut detector = Detector::new(DetectSettings::default()).unwrap();
        assert_eq!(ids(&detector.detect_thoroughly(&picture, &[]).unwrap()), [0, 1, 2, 3, 4, 5]);
        let flat = GrayImage { data: vec![77; picture.data.len()], ..picture };
        assert!(detector.detect_thoroughly(&flat, &[]).unwrap().is_empty());
    }

    #[test]
    fn a_place_outside_the_picture_is_no_trouble() {
        let (picture, ..) = noisy();
        let mut detector = Detector::new(DetectSettings::default()).unwrap();
        for corners in [[[-500.0, 9e9]; 4], [[f64::NAN; 2]; 4], [[2000.0, 3000.0]; 4]] {
            let expected = [Expected { family: Family::Tag36h11, id: 77, corners: Some(corners) }];
            detector.detect_expected(&picture, &expected).unwrap();
        }
    }
}
