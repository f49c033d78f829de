//! What is made of the pictures of a calibration round as they come.
//!
//! In: one [`Stop`] after the other. Out: the samples in the order of the poses; `progress` is called with
//! each, to report on it or to keep it. Pure.

use crate::fit::Sample;
use cell_values::image::Image;

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

    /// Takes in the next stop.
    pub fn add(&mut self, stop: &Stop) {
        (self.progress)(stop);
        self.samples.push(stop.sample.clone());
    }

    /// What was collected.
    pub fn into_vec(self) -> Vec<Sample> {
        self.samples
    }
}
