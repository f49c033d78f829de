//! The pictures of a calibration round as they come.
//!
//! In: what the shell shows during a round. Out: the samples in the order of the poses; whoever wants to say
//! something about each, or to keep it, is called with it.

use crate::daemon::heard::Shown;
use crate::daemon::shell::{Observer, Scene};
use crate::time::Timestamp;
use crate::vision::calibrate::Sample;
use crate::vision::image::Image;

/// One stop of a calibration round.
pub struct Stop<'a> {
    /// The pose's number, from 1.
    pub pose: usize,
    /// The picture taken there.
    pub image: &'a Image,
    /// Where the flange was and which markers were found.
    pub sample: &'a Sample,
}

/// Collects samples.
pub struct Samples<'a> {
    progress: &'a dyn Fn(&Stop),
    samples: Vec<Sample>,
}

impl<'a> Samples<'a> {
    /// `progress` is called at each pose.
    pub fn new(progress: &'a dyn Fn(&Stop)) -> Samples<'a> {
        Samples { progress, samples: Vec::new() }
    }

    /// What was collected.
    pub fn into_vec(self) -> Vec<Sample> {
        self.samples
    }
}

impl Observer for Samples<'_> {
    fn on(&mut self, _now: Timestamp, scene: Scene) {
        if let Scene::Shown(Shown::Sample { pose, image, sample }) = scene {
            (self.progress)(&Stop { pose: *pose, image, sample });
            self.samples.push(sample.clone());
        }
    }
}
