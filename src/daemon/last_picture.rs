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

    /// A job begins: what was seen before is none of it.
    pub fn forget(&self) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }

    /// The bytes of a JPEG file; `None` before there is a picture.
    pub fn jpeg(&self) -> Option<Vec<u8>> {
        let (mut image, found) = self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()?;
        draw_detections(&mut image, &found);
        image.encode_jpeg(QUALITY).ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_job_gets_no_picture_of_the_one_before() {
        let last = LastPicture::default();
        assert_eq!(last.jpeg(), None);
        let image = Image::filled(64, 48, [200, 30, 10]);
        last.keep(&Displayed::Picture { image, views: Vec::new() });
        let shown = Image::decode(&last.jpeg().expect("a picture")).expect("a JPEG file");
        assert_eq!((shown.width, shown.height), (64, 48));
        assert!(shown.pixel(30, 20).is_some_and(|[red, _, blue]| red > 180 && blue < 40));
        last.forget();
        assert_eq!(last.jpeg(), None);
    }
}
