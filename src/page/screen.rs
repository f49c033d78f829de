//! The last picture of the camera's film, and the same as it is sent to all who watch.
//!
//! In: pictures. Out: parts of an endless answer, each encoded once; the picture of now. A viewer waits for
//! a part that it has not seen: a slow one misses those between.

use axum::body::Bytes;
use cell_values::image::Image;
use jpeg_encoder::{ColorType, Encoder, SamplingFactor};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::watch;

/// Of JPEG: what is looked at while it moves.
const QUALITY: u8 = 60;

/// A picture is of now for so long.
const OF_NOW: Duration = Duration::from_secs(3);

/// Between two pictures of one answer.
pub const BOUNDARY: &str = "celld-film";

/// A picture as it is sent: all of its part.
pub type Part = Option<Bytes>;

/// The page's end of the film.
pub struct Screen {
    parts: watch::Sender<Part>,
    last: Mutex<Option<(Arc<Image>, Instant)>>,
}

impl Default for Screen {
    fn default() -> Screen {
        Screen { parts: watch::Sender::new(None), last: Mutex::default() }
    }
}

impl Screen {
    /// Parts from now on.
    pub fn parts(&self) -> watch::Receiver<Part> {
        self.parts.subscribe()
    }

    /// What the camera shows now.
    pub fn now(&self) -> Option<Arc<Image>> {
        let last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        last.as_ref().filter(|(_, at)| at.elapsed() < OF_NOW).map(|(image, _)| image.clone())
    }

    /// The next picture.
    pub fn show(&self, image: &Arc<Image>) {
        *self.last.lock().unwrap_or_else(PoisonError::into_inner) = Some((image.clone(), Instant::now()));
        match encoded(image) {
            Ok(jpeg) => {
                // Who watched has gone meanwhile: nothing is lost.
                let _ = self.parts.send(Some(part(&jpeg)));
            }
            Err(error) => tracing::warn!(%error, "page: a picture of the film could not be encoded"),
        }
    }
}

/// JPEG with halved colour: a quarter of the time that the `image` crate takes, which counts ten times a
/// second.
fn encoded(image: &Image) -> Result<Vec<u8>, String> {
    let [width, height] = [image.width, image.height]
        .map(|edge| u16::try_from(edge).map_err(|_| "it is too large".to_string()));
    let mut jpeg = Vec::new();
    let mut encoder = Encoder::new(&mut jpeg, QUALITY);
    encoder.set_sampling_factor(SamplingFactor::R_4_2_0);
    encoder.encode(&image.rgb, width?, height?, ColorType::Rgb).map_err(|error| error.to_string())?;
    Ok(jpeg)
}

/// A picture with its heading, and the boundary that ends it: without it browsers wait for the next one.
fn part(jpeg: &[u8]) -> Bytes {
    let mut part = format!("Content-Type: image/jpeg\r\nContent-Length: {}\r\n\r\n", jpeg.len()).into_bytes();
    part.extend_from_slice(jpeg);
    part.extend_from_slice(format!("\r\n--{BOUNDARY}\r\n").as_bytes());
    part.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All viewers get the same bytes, and a slow one the newest of them.
    #[test]
    fn a_picture_is_encoded_once_and_a_slow_viewer_misses_some() {
        let screen = Screen::default();
        let (mut quick, mut slow) = (screen.parts(), screen.parts());
        assert!(screen.now().is_none());
        let mut seen = Vec::new();
        for shade in [10, 120, 240] {
            screen.show(&Arc::new(Image::filled(64, 48, [shade; 3])));
            assert!(quick.has_changed().unwrap());
            seen.push(quick.borrow_and_update().clone().expect("a picture"));
        }
        let newest = slow.borrow_and_update().clone().expect("a picture");
        assert_eq!(newest.as_ptr(), seen.last().expect("a picture").as_ptr());
        assert!(!slow.has_changed().unwrap());
        assert!(screen.now().is_some_and(|image| image.pixel(3, 3) == Some([240; 3])));
        let part = seen.pop().expect("a picture");
        let end = format!("\r\n--{BOUNDARY}\r\n");
        assert!(part.starts_with(b"Content-Type: image/jpeg\r\n") && part.ends_with(end.as_bytes()));
        let head = part.windows(4).position(|window| window == b"\r\n\r\n").expect("a heading") + 4;
        let jpeg = &part[head..part.len() - end.len()];
        let stated = format!("Content-Length: {}\r\n", jpeg.len());
        assert!(String::from_utf8_lossy(&part[..head]).contains(&stated));
        assert_eq!(Image::decode(jpeg).map(|image| image.width).ok(), Some(64));
    }
}
