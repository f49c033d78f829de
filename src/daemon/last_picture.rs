//! The picture that the camera gave last, for the folders of jobs.
//!
//! In: pictures from the loop, as they are shown. Out: the last of them as JPEG with the markers that were
//! found in it, on the thread that keeps the folders: encoding takes longer than the loop may stop.

use crate::daemon::messages::Displayed;
use cell_values::image::Image;
use cell_vision::annotate::draw_detections;
use cell_vision::detect::Detection;
use std::sync::{Arc, Mutex, PoisonError};

/// Of JPEG: markers stay legible, a picture takes some 100 KB.
const QUALITY: u8 = 85;

/// A picture and the markers that were found in it.
type Found = (Image, Vec<Detection>);

/// The last picture. See the module.
#[derive(Clone, Default)]
pub struct LastPicture(Arc<Mutex<Option<Found>>>);

impl LastPicture {
    /// Keeps a picture; whatever else is shown is passed over.
    pub fn keep(&self, displayed: &Displayed) {
        if let Displayed::Picture { image, views } = displayed {
            let found = views.iter().flat_map(|view| view.detections.iter().cloned()).collect();
            *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some((image.clone(), found));
        }
    }

    /// The bytes of a JPEG file; `None` before there is a picture.
    pub fn jpeg(&self) -> Option<Vec<u8>> {
        let (mut image, found) = self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()?;
        draw_detections(&mut image, &found);
        image.encode_jpeg(QUALITY).ok()
    }
}
