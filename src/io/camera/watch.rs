//! Watches a stream of frames for a camera that is frozen, restarted, or not the one that was calibrated.
//!
//! In: frames in the order they came. Out: nothing, or the error that says what is wrong. Content is compared by a hash of all pixels:
//! a real sensor's noise never repeats, so two equal pictures are one picture.

use crate::io::camera::{CameraError, Frame};
use crate::vision::camera::CameraModel;
use std::hash::{DefaultHasher, Hash, Hasher};

/// What the last good frame was.
#[derive(Debug, Default)]
pub struct Watch {
    last: Option<Last>,
}

#[derive(Debug)]
struct Last {
    sequence: u64,
    time_s: f64,
    content: u64,
}

impl Watch {
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
        let sequence = frame.sequence;
        let mut hasher = DefaultHasher::new();
        frame.image.rgb.hash(&mut hasher);
        let content = hasher.finish();
        if let Some(last) = &self.last {
            if sequence <= last.sequence {
                return Err(CameraError::RepeatedSequence { place: place(), sequence, last: last.sequence });
            }
            if content == last.content {
                return Err(CameraError::RepeatedPicture { place: place(), sequence, last: last.sequence });
            }
        }
        let last_s = self.last.as_ref().map_or(f64::NEG_INFINITY, |last| last.time_s);
        if !frame.time_s.is_finite() || frame.time_s < last_s {
            return Err(CameraError::Time { place: place(), sequence, time_s: frame.time_s, last_s });
        }
        self.last = Some(Last { sequence, time_s: frame.time_s, content });
        Ok(())
    }

    /// Forgets the last frame, after the caller decided that a restarted camera is fine.
    pub fn forget(&mut self) {
        self.last = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vision::image::Image;

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
        let mut watch = Watch::default();
        watch.check(&frame(5, 1.0, 10), None).unwrap();
        let error = watch.check(&frame(5, 1.1, 11), None).unwrap_err();
        assert!(matches!(error, CameraError::RepeatedSequence { sequence: 5, last: 5, .. }));
        assert!(matches!(watch.check(&frame(2, 1.1, 11), None), Err(CameraError::RepeatedSequence { .. })));
        let error = watch.check(&frame(6, 1.1, 10), None).unwrap_err();
        assert!(matches!(error, CameraError::RepeatedPicture { sequence: 6, last: 5, .. }));
        assert!(matches!(watch.check(&frame(7, 0.5, 12), None), Err(CameraError::Time { .. })));
        assert!(matches!(watch.check(&frame(7, f64::NAN, 12), None), Err(CameraError::Time { .. })));
        watch.check(&frame(8, 1.2, 13), None).unwrap();
        watch.forget();
        watch.check(&frame(1, 0.0, 13), None).unwrap();
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
        let error = Watch::default().check(&frame(1, 0.0, 1), Some(&lens)).unwrap_err();
        assert!(matches!(error, CameraError::Model(_)));
    }
}
