//! The grey levels of a picture as the library gets them: a dark or hazy one is stretched, then dark levels
//! are lifted.
//!
//! In: a picture, the exponent of the tone curve. Out: what each of the 256 grey levels becomes. The
//! library computes in whole grey levels and its thresholds are grey levels: a picture that uses ten of
//! them is searched as well as one that uses all when it is stretched first. A picture that uses most of
//! them stays as it is, so that nothing changes in good light. Pure.

use cell_values::image::GrayImage;

/// Grey levels that a picture spans after stretching, at least.
const SPAN: f64 = 200.0;
/// A stretched picture spans no fewer before, grey levels: fewer are rounding and noise.
const SPAN_MIN: f64 = 4.0;
/// So many of a picture's pixels may be brighter or darker than the span, as a share: defects of the
/// sensor. The white of the smallest readable marker is twice as many in a picture of 1280 x 720.
const OUTSIDE: f64 = 1e-4;

/// The picture stretched, without the tone curve; `None` where that changes nothing.
///
/// Corners are fitted in it: between ten grey levels there are no clear steps, and a curved tone would move
/// them.
pub(super) fn stretched(picture: &GrayImage) -> Option<GrayImage> {
    let curve = curve(picture, 1.0);
    let changes = (0..256).any(|level| usize::from(curve[level]) != level);
    let data = || picture.data.iter().map(|&level| curve[usize::from(level)]).collect();
    changes.then(|| GrayImage { width: picture.width, height: picture.height, data: data() })
}

/// What each grey level of this picture becomes.
pub(super) fn curve(picture: &GrayImage, tone: f32) -> [u8; 256] {
    let [low, high] = span(picture);
    let width = (high - low).max(SPAN_MIN);
    let factor = (SPAN / width).max(1.0);
    // Not moved further than it must be: at factor 1 every level stays where it is.
    let foot = low.min(255.0 - width * factor).max(0.0);
    let on_curve = |level: usize| {
        let stretched = (foot + (level as f64 - low) * factor).clamp(0.0, 255.0);
        (255.0 * (stretched / 255.0).powf(f64::from(tone))).round() as u8
    };
    std::array::from_fn(on_curve)
}

/// The darkest and the brightest grey level, but for a few pixels.
fn span(picture: &GrayImage) -> [f64; 2] {
    let mut counts = [0_usize; 256];
    for &level in &picture.data {
        counts[usize::from(level)] += 1;
    }
    let outside = (OUTSIDE * picture.data.len() as f64) as usize;
    let low = beyond(&counts, outside, 0..256).unwrap_or(0);
    let high = beyond(&counts, outside, (0..256).rev()).unwrap_or(255);
    [low as f64, high.max(low) as f64]
}

/// The level with which more than `outside` pixels have been passed.
fn beyond(counts: &[usize; 256], outside: usize, mut levels: impl Iterator<Item = usize>) -> Option<usize> {
    let mut passed = 0;
    levels.find(|&level| {
        passed += counts[level];
        passed > outside
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(levels: std::ops::RangeInclusive<u8>) -> GrayImage {
        let data: Vec<u8> = levels.cycle().take(200 * 100).collect();
        GrayImage { width: 200, height: 100, data }
    }

    #[test]
    fn a_picture_in_good_light_keeps_its_levels() {
        let kept = curve(&picture(20..=230), 1.0);
        assert!((0..256).all(|level| usize::from(kept[level]) == level), "{kept:?}");
        let lifted = curve(&picture(0..=255), 0.75);
        assert_eq!((lifted[0], lifted[255]), (0, 255));
        assert!(lifted[40] > 60 && lifted[200] > 205);
    }

    #[test]
    fn dark_and_hazy_pictures_are_stretched_without_a_jump() {
        let dark = curve(&picture(1..=9), 1.0);
        assert_eq!((dark[1], dark[9]), (1, 201));
        let hazy = curve(&picture(170..=210), 1.0);
        assert_eq!((hazy[170], hazy[210]), (55, 255));
        // From one that is just not stretched to one that just is, nothing moves by more than a level.
        let (just_not, just) = (curve(&picture(50..=250), 1.0), curve(&picture(50..=249), 1.0));
        assert!((0..256).all(|level| just_not[level].abs_diff(just[level]) <= 2), "{just:?}");
    }

    #[test]
    fn defects_of_the_sensor_do_not_count_and_flat_pictures_are_no_trouble() {
        let mut defect = picture(1..=9);
        defect.data[77] = 255;
        assert_eq!(curve(&defect, 1.0)[9], 201);
        for level in [0, 128, 255] {
            curve(&GrayImage { width: 40, height: 40, data: vec![level; 1600] }, 0.75);
        }
        curve(&GrayImage { width: 0, height: 0, data: Vec::new() }, 0.75);
    }
}
