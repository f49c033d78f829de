//! The picture that the camera gave last, for the folders of jobs.
//!
//! In: pictures from the loop, as they are shown, the lens, moves of a plan. Out: the last picture as JPEG
//! with the markers that were found in it and the moves drawn over it, on the thread that keeps the folders:
//! encoding takes longer than the loop may stop.

use crate::daemon::messages::Displayed;
use crate::jobs::utc;
use cell_edge::clock::unix_now_s;
use cell_values::image::Image;
use cell_vision::annotate::draw_detections;
use cell_vision::annotate::moves::{DrawnMove, draw_moves};
use cell_vision::annotate::raster;
use cell_vision::camera::CameraModel;
use cell_vision::detect::Detection;
use nalgebra::Isometry3;
use std::sync::{Arc, Mutex, PoisonError};

/// Of JPEG: markers stay legible, a picture takes some 100 KB.
const QUALITY: u8 = 85;

/// Pixels of a dot of the letters of its time.
const DATE_SCALE: i32 = 2;

/// A picture, what was found in it and where it was taken from.
pub struct Kept {
    /// As the camera gave it.
    pub image: Image,
    /// The markers.
    pub found: Vec<Detection>,
    /// Where the camera was; `None` where nothing was made of the picture.
    pub table_from_camera: Option<Isometry3<f64>>,
    /// When it came, s since 1970.
    pub unix_s: f64,
}

/// A picture, and whether it was taken for the job under way.
type OfJob = (Arc<Kept>, bool);

/// The last picture. See the module.
#[derive(Clone)]
pub struct LastPicture {
    kept: Arc<Mutex<Option<OfJob>>>,
    lens: Option<CameraModel>,
}

impl LastPicture {
    /// No picture yet; without a lens nothing can be drawn at its place on the table.
    pub fn new(lens: Option<CameraModel>) -> LastPicture {
        LastPicture { kept: Arc::default(), lens }
    }

    /// Keeps a picture; whatever else is shown is passed over.
    pub fn keep(&self, displayed: &Displayed) {
        if let Displayed::Picture { image, views } = displayed {
            let found = views.iter().flat_map(|view| view.detections.iter().cloned()).collect();
            let table_from_camera = views.last().map(|view| view.table_from_camera);
            let (image, unix_s) = (image.clone(), unix_now_s());
            let kept = Arc::new(Kept { image, found, table_from_camera, unix_s });
            *self.kept.lock().unwrap_or_else(PoisonError::into_inner) = Some((kept, true));
        }
    }

    /// A job begins: what was seen before is none of it.
    pub fn job_begins(&self) {
        if let Some((_, of_this_job)) = &mut *self.kept.lock().unwrap_or_else(PoisonError::into_inner) {
            *of_this_job = false;
        }
    }

    /// The last picture there is.
    pub fn latest(&self) -> Option<Arc<Kept>> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner).as_ref().map(|(kept, _)| kept.clone())
    }

    /// The bytes of a JPEG file; `None` before the job has a picture.
    pub fn of_job(&self, moves: &[DrawnMove]) -> Option<Vec<u8>> {
        self.drawn(moves, |of_this_job| of_this_job)
    }

    /// The same of the last picture there is, for a preview.
    pub fn of_any(&self, moves: &[DrawnMove]) -> Option<Vec<u8>> {
        self.drawn(moves, |_| true)
    }

    fn drawn(&self, moves: &[DrawnMove], wanted: impl FnOnce(bool) -> bool) -> Option<Vec<u8>> {
        let (kept, of_this_job) = self.kept.lock().unwrap_or_else(PoisonError::into_inner).clone()?;
        if !wanted(of_this_job) {
            return None;
        }
        let (mut image, table_from_camera) = (kept.image.clone(), kept.table_from_camera);
        draw_detections(&mut image, &kept.found);
        if let (Some(lens), Some(from)) = (&self.lens, table_from_camera)
            && let Err(error) = draw_moves(&mut image, moves, lens, &from)
        {
            tracing::warn!(%error, "the moves could not be drawn on the picture");
        }
        dated(&mut image, kept.unix_s);
        image.encode_jpeg(QUALITY).ok()
    }
}

/// The time in the lower left corner: a picture is taken out of its folder, and looked at much later.
fn dated(image: &mut Image, unix_s: f64) {
    let words = utc::text(unix_s);
    let at = [f64::from(DATE_SCALE * 3) * (words.len() as f64 + 1.0), f64::from(image.height) - 14.0];
    raster::text(image, at, &words, [255; 3], i64::from(DATE_SCALE));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_job_gets_no_picture_of_the_one_before_and_a_preview_does() {
        let last = LastPicture::new(None);
        assert_eq!((last.of_job(&[]), last.of_any(&[])), (None, None));
        let image = Image::filled(64, 48, [200, 30, 10]);
        last.keep(&Displayed::Picture { image, views: Vec::new() });
        let shown = Image::decode(&last.of_job(&[]).expect("a picture")).expect("a JPEG file");
        assert_eq!((shown.width, shown.height), (64, 48));
        assert!(shown.pixel(30, 20).is_some_and(|[red, _, blue]| red > 180 && blue < 40));
        last.job_begins();
        assert!(last.of_job(&[]).is_none() && last.of_any(&[]).is_some());
    }
}
