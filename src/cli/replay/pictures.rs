//! The recorded pictures searched again.
//!
//! In: pictures and the markers that were found in them. Out: for each picture that shows something else
//! now, what; and how far the corners of the others moved.

use crate::daemon::playback::PICTURES;
use crate::io::recording::read::Entry;
use cell_machine::event::Event;
use cell_replay::{Kind, event_of};
use cell_values::image::Image;
use cell_vision::detect::{DetectError, DetectSettings, Detection, Detector};
use foxglove::Decode;
use foxglove::messages::CompressedImage;
use std::collections::BTreeMap;

/// See the module.
pub(super) struct Pictures {
    detector: Detector,
    /// The last picture that has not met its markers yet.
    last: Option<Vec<u8>>,
    searched: usize,
    changed: usize,
    largest_px: f64,
    text: String,
}

impl Pictures {
    /// # Errors
    /// The detector cannot be made, in words.
    pub fn new() -> Result<Pictures, DetectError> {
        let detector = Detector::new(DetectSettings::default())?;
        Ok(Pictures { detector, last: None, searched: 0, changed: 0, largest_px: 0.0, text: String::new() })
    }

    /// A picture is followed by the event with the markers of its look; the last view is of that picture.
    pub fn take(&mut self, entry: &Entry, kind: Option<Kind>) {
        if entry.channel.topic == PICTURES {
            let picture = CompressedImage::decode(entry.data.as_slice());
            self.last = picture.ok().map(|picture| picture.data.to_vec());
        }
        if kind != Some(Kind::Event) || self.last.is_none() {
            return;
        }
        let Some((at, Event::Looked(_, Ok(views)))) = event_of(&entry.piece()) else { return };
        if let (Some(picture), Some(view)) = (self.last.take(), views.last()) {
            self.search(at.as_secs_f64(), &picture, &view.detections);
        }
    }

    fn search(&mut self, seconds: f64, picture: &[u8], then: &[Detection]) {
        let found = Image::decode(picture).ok().and_then(|image| self.detector.detect(&image.gray()).ok());
        let Some(now) = found else { return };
        self.searched += 1;
        let (then, now) = (by_marker(then), by_marker(&now));
        let words = |of: &BTreeMap<(String, u32), [[f64; 2]; 4]>, not: &BTreeMap<(String, u32), _>| {
            let only = of.keys().filter(|key| !not.contains_key(*key)).map(|(_, id)| id.to_string());
            only.collect::<Vec<_>>().join(", ")
        };
        let (lost, new) = (words(&then, &now), words(&now, &then));
        for (key, corners) in &then {
            let moved = now
                .get(key)
                .into_iter()
                .flatten()
                .zip(corners)
                .map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1]));
            self.largest_px = moved.fold(self.largest_px, f64::max);
        }
        if lost.is_empty() && new.is_empty() {
            return;
        }
        self.changed += 1;
        self.text.push_str(&format!("picture at {seconds:.3} s:"));
        for (what, markers) in [("found no more", lost), ("found now", new)] {
            if !markers.is_empty() {
                self.text.push_str(&format!(" {what}: {markers};"));
            }
        }
        self.text.push('\n');
    }

    /// What was found, and whether anything changed.
    pub fn finish(self) -> (String, bool) {
        let summary = format!(
            "{} pictures searched again, {} with other markers; corners move by {:.2} px at most\n",
            self.searched, self.changed, self.largest_px
        );
        (self.text + &summary, self.changed > 0)
    }
}

fn by_marker(found: &[Detection]) -> BTreeMap<(String, u32), [[f64; 2]; 4]> {
    found.iter().map(|marker| ((marker.family.clone(), marker.id), marker.corners)).collect()
}
