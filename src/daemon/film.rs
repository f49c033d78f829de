//! The camera's film for viewers, and what it shows of a calibration round: the camera's end of it.
//!
//! In: whether anyone watches. Out: pictures for the thread that encodes them. The camera's thread takes a
//! picture for viewers only while it has nothing else to do, hands it over and goes on; while one is still
//! being encoded none is taken, so that a slow encoder or viewer holds nothing up and fills nothing. The
//! loop hands the pictures of a round over in the same way.

use cell_calibration::fit::Sample;
use cell_machine::supervisor::round::RoundFault;
use cell_values::image::Image;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Duration;

/// Ten pictures a second: what moves is seen to move.
pub const EVERY: Duration = Duration::from_millis(100);

/// What is shown.
#[derive(Debug)]
pub enum Shown {
    /// The next picture of the film.
    Picture(Image),
    /// A picture of a calibration round.
    Sample {
        /// The pose, from 1.
        pose: usize,
        /// What it shows.
        image: Image,
        /// Where the flange was, and which markers were found.
        sample: Sample,
    },
    /// The round has ended.
    RoundOver(Result<(), RoundFault>),
}

/// See the module; all clones are of one film.
#[derive(Clone)]
pub struct Film {
    viewers: Arc<AtomicUsize>,
    /// A picture is on its way to the viewers.
    busy: Arc<AtomicBool>,
    shown: Sender<Shown>,
}

impl Film {
    /// A film without viewers, and the end at which its pictures arrive.
    pub fn new() -> (Film, Receiver<Shown>) {
        let (shown, pictures) = channel();
        (Film { viewers: Arc::default(), busy: Arc::default(), shown }, pictures)
    }

    /// There are viewers, and the picture before is encoded.
    pub fn wants_a_picture(&self) -> bool {
        self.viewers() > 0 && !self.busy.load(Ordering::Acquire)
    }

    /// How many watch.
    pub fn viewers(&self) -> usize {
        self.viewers.load(Ordering::Relaxed)
    }

    /// The next picture.
    pub fn picture(&self, image: Image) {
        self.busy.store(true, Ordering::Release);
        self.show(Shown::Picture(image));
    }

    /// Hands something over; the thread that takes it may have ended.
    pub fn show(&self, shown: Shown) {
        let _ = self.shown.send(shown);
    }

    /// The last picture was encoded: there may be another one.
    pub fn encoded(&self) {
        self.busy.store(false, Ordering::Release);
    }

    /// One more watches, as long as the value lives.
    pub fn watch(&self) -> Watching {
        self.viewers.fetch_add(1, Ordering::Relaxed);
        Watching(self.viewers.clone())
    }
}

/// A viewer of the film.
pub struct Watching(Arc<AtomicUsize>);

impl Drop for Watching {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_are_wanted_while_one_watches_and_none_is_on_its_way() {
        let (film, pictures) = Film::new();
        assert!(!film.wants_a_picture());
        let (first, second) = (film.watch(), film.watch());
        assert!(film.wants_a_picture() && film.viewers() == 2);
        film.picture(Image::filled(2, 2, [0; 3]));
        assert!(!film.wants_a_picture(), "one is on its way");
        assert!(matches!(pictures.try_recv(), Ok(Shown::Picture(_))));
        film.encoded();
        drop(first);
        assert!(film.wants_a_picture());
        drop(second);
        assert!(!film.wants_a_picture());
        drop(pictures);
        film.picture(Image::filled(2, 2, [0; 3]));
    }
}
