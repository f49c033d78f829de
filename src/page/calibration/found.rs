//! What the film shows of markers, while a person calibrates.
//!
//! In: pictures of the film. Out: their markers for all viewers, three times a second, while a page that
//! calibrates is open; and to the work on the lens. The film goes on meanwhile, with fewer pictures.

use crate::page::shared::Shared;
use cell_values::image::Image;
use cell_vision::detect::{DetectSettings, Detection, Detector};
use serde_json::{Value, json};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// How often a picture is searched.
const EVERY: Duration = Duration::from_millis(300);

/// See the module.
#[derive(Default)]
pub struct Finder {
    detector: Option<Detector>,
    last: Option<Instant>,
}

impl Finder {
    /// Searches the picture, if it is time to.
    pub fn look(&mut self, app: &Shared, image: &Arc<Image>) {
        let recent = self.last.is_some_and(|last| last.elapsed() < EVERY);
        if recent || !app.is_calibrating() {
            return;
        }
        self.last = Some(Instant::now());
        if self.detector.is_none() {
            self.detector = Detector::new(DetectSettings::default())
                .inspect_err(|error| tracing::warn!(%error, "page: no detector"))
                .ok();
        }
        let Some(Ok(found)) = self.detector.as_mut().map(|detector| detector.detect(&image.gray())) else {
            return;
        };
        // A solution is under way: the next picture will do.
        let board = match app.calibration_if_free() {
            Some(mut bench) => bench.lens.as_mut().map(|lens| {
                lens.saw(image, &found);
                *lens.board()
            }),
            None => None,
        };
        let of_board = |id: u32| board.is_some_and(|board| board.corners(id).is_some());
        let kind = |id: u32| {
            let marked = |object: &rearrange::tabletop::instance::ObjectSpec| {
                object.marker.as_ref().is_some_and(|marker| marker.id == id)
            };
            if app.cell.reference_markers.iter().any(|marker| marker.id == id) {
                "reference"
            } else if of_board(id) {
                "board"
            } else if app.cell.objects.iter().any(marked) {
                "object"
            } else {
                "other"
            }
        };
        let marker = |found: &Detection| {
            let corners = found.corners.map(|corner| corner.map(|value| (value * 10.0).round() / 10.0));
            json!({ "id": found.id, "corners": corners, "kind": kind(found.id) })
        };
        let markers: Vec<Value> = found.iter().map(marker).collect();
        app.feed.send("found", &json!({ "width": image.width, "height": image.height, "markers": markers }));
    }
}
