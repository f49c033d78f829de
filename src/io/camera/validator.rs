//! Watches a stream of frames for a camera that is frozen, restarted, or not the one that was calibrated.
//!
//! In: frames in the order they came. Out: nothing, or the error that says what is wrong. Content is
//! compared by a hash of all pixels: a real sensor's noise never repeats, so two equal pictures are one
//! picture. Where light or dark leave no room for noise, content says nothing, and the picture is left to
//! those who judge its light.

use crate::io::camera::{CameraError, Frame};
use cell_values::image::Image;
use cell_vision::camera::CameraModel;
use std::hash::{DefaultHasher, Hash, Hasher};

/// What the last good frame was.
#[derive(Debug, Default)]
pub struct FrameValidator {
    last: Option<Last>,
}

#[derive(Debug)]
struct Last {
    sequence: u64,
    time_s: f64,
    /// Of the last picture that had noise.
    content: Option<u64>,
    /// The camera was connected to anew since: its count and its clock may begin again.
    restarted: bool,
}

impl FrameValidator {
    /// Checks a frame against the one before and against the lens, where that is known.
    ///
    /// A frame that is refused is not remembered, except that the same content keeps being refused.
    ///
    /// # Errors
    /// `Model` for another size, `RepeatedSequence`, `RepeatedPicture`, `Time`.
    pub fn check(&mut self, frame: &Frame, lens: Option<&CameraModel>) -> Result<(), CameraError> {
        if let Some(lens) = lens {
            lens.check_picture(frame.image.width, frame.image.height)?;
        }
        let place = || frame.source.clone();
        let (sequence, time_s) = (frame.sequence, frame.time_s);
        let content = content(&frame.image);
        let (mut last_s, mut known) = (f64::NEG_INFINITY, None);
        if let Some(Last { sequence: last, time_s: before_s, content: before, restarted }) = self.last {
            let same = content.is_some() && content == before;
            let counts_on = sequence > last || restarted && sequence != last;
            if !counts_on && (same || !restarted) {
                return Err(CameraError::RepeatedSequence { place: place(), sequence, last });
            }
            if same {
                return Err(CameraError::RepeatedPicture { place: place(), sequence, last });
            }
            if !restarted {
                last_s = before_s;
            }
            known = before;
        }
        if !time_s.is_finite() || time_s < last_s {
            return Err(CameraError::Time { place: place(), sequence, time_s, last_s });
        }
        self.last = Some(Last { sequence, time_s, content: content.or(known), restarted: false });
        Ok(())
    }

    /// The camera was connected to anew: its count and its clock may begin again. Its last picture is
    /// remembered: a camera that still gives that one is frozen.
    pub fn restarted(&mut self) {
        if let Some(last) = &mut self.last {
            last.restarted = true;
        }
    }
}

/// Grey levels between which a sensor's noise shows, and the least share of them that distinguishes
/// pictures.
const NOISY: std::ops::RangeInclusive<u8> = 6..=249;
const NOISY_SHARE: f64 = 1e-3;

/// A picture in one number; nothing for one that is black or white all over.
pub(super) fn content(image: &Image) -> Option<u64> {
    let noisy = image.rgb.iter().filter(|&&level| NOISY.contains(&level)).count();
    if (noisy as f64) < NOISY_SHARE * image.rgb.len() as f64 {
        return None;
    }
    let mut hasher = DefaultHasher::new();
    image.rgb.hash(&mut hasher);
    Some(hasher.finish())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(sequence: u64, time_s: f64, grey: u8) -> Frame {
        Frame {
            image: Image::filled(32, 24, [grey; 3]),
            sequence,
            time_s,
            source: "test".into(),
            depth: None,
        }
    }

    #[test]
    fn a_frozen_or_restarted_camera_is_noticed() {
        let mut watch = FrameValidator::default();
        watch.check(&frame(5, 1.0, 10), None).unwrap();
        let error = watch.check(&frame(5, 1.1, 11), None).unwrap_err();
        assert!(matches!(error, CameraError::RepeatedSequence { sequence: 5, last: 5, .. }));
        assert!(matches!(watch.check(&frame(2, 1.1, 11), None), Err(CameraError::RepeatedSequence { .. })));
        let error = watch.check(&frame(6, 1.1, 10), None).unwrap_err();
        assert!(matches!(error, CameraError::RepeatedPicture { sequence: 6, last: 5, .. }));
        assert!(matches!(watch.check(&frame(7, 0.5, 12), None), Err(CameraError::Time { .. })));
        assert!(matches!(watch.check(&frame(7, f64::NAN, 12), None), Err(CameraError::Time { .. })));
        watch.check(&frame(8, 1.2, 13), None).unwrap();
        watch.restarted();
        assert!(matches!(watch.check(&frame(8, 1.2, 13), None), Err(CameraError::RepeatedSequence { .. })));
        assert!(matches!(watch.check(&frame(1, 0.0, 13), None), Err(CameraError::RepeatedPicture { .. })));
        watch.check(&frame(1, 0.0, 14), None).unwrap();
    }

    #[test]
    fn pictures_without_room_for_noise_are_not_taken_for_frozen_ones() {
        let mut watch = FrameValidator::default();
        for (sequence, grey) in [(1, 90), (2, 255), (3, 255), (4, 0), (5, 0)] {
            watch.check(&frame(sequence, 1.0, grey), None).unwrap();
        }
        assert!(matches!(watch.check(&frame(5, 1.0, 0), None), Err(CameraError::RepeatedSequence { .. })));
        let reported = watch.check(&frame(6, 1.0, 90), None).unwrap_err();
        assert!(
            matches!(reported, CameraError::RepeatedPicture { .. }),
            "what was seen before is remembered: {reported}"
        );
    }

    #[test]
    fn a_picture_of_another_size_is_refused() {
        let lens = CameraModel {
            serial: "a".into(),
            width: 640,
            height: 480,
            fx: 600.0,
            fy: 600.0,
            cx: 320.0,
            cy: 240.0,
            distortion: [0.0; 5],
        };
        let error = FrameValidator::default().check(&frame(1, 0.0, 1), Some(&lens)).unwrap_err();
        assert!(matches!(error, CameraError::Model(_)));
    }
}
