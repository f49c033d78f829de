//! How often markers are read in pictures that show none.
//!
//! In: how many pictures, a seed, photographs to put under the clutter. Out: [`Report`]: false ids of one
//! pass, of every way together with nothing expected, of the same with a catalogue of objects expected, and
//! of the library with its default thresholds. Every picture is another one, cluttered and degraded.

use crate::bench::vision::clutter;
use cell_values::image::GrayImage;
use cell_vision::detect::second::Expected;
use cell_vision::detect::{DetectSettings, Detection, Detector, Family, PlainLibrary};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::Serialize;
use std::sync::atomic::{AtomicBool, Ordering};

/// Width and height of a picture.
const SIZE: [u32; 2] = [640, 480];
/// Markers of the catalogue that is expected and not there.
const CATALOGUE: u32 = 40;
/// One in so many pictures is also shown to the library: it takes as long as all of ours.
const LIBRARY_SHARE: usize = 4;
/// One in so many pictures lies on a photograph, where there are some.
const PHOTOGRAPH_SHARE: usize = 3;
/// Decimations of the library.
const DECIMATE: [f32; 3] = [1.0, 1.5, 2.0];

/// What to run.
pub struct Task {
    /// Pictures.
    pub pictures: usize,
    /// Seed of everything.
    pub seed: u64,
    /// Pictures at the same time.
    pub threads: usize,
    /// Photographs without markers to lie under the clutter of some pictures.
    pub photographs: Vec<GrayImage>,
}

/// A marker that was read where there is none.
#[derive(Clone, Debug, Serialize)]
pub struct False {
    /// The picture's number.
    pub picture: usize,
    /// What was read.
    pub detection: Detection,
}

/// What came out.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Report {
    /// Pictures searched by ours.
    pub pictures: usize,
    /// False ids of one pass.
    pub one_pass: Vec<False>,
    /// Of every way together, nothing expected.
    pub thorough: Vec<False>,
    /// Of every way together, a catalogue of objects expected that are not there.
    pub expecting: Vec<False>,
    /// Pictures shown to the library too.
    pub library_pictures: usize,
    /// Its false ids at decimation 1, 1.5 and 2.
    pub library: [usize; 3],
}

impl Report {
    fn merge(mut self, other: Report) -> Report {
        self.pictures += other.pictures;
        self.one_pass.extend(other.one_pass);
        self.thorough.extend(other.thorough);
        self.expecting.extend(other.expecting);
        self.library_pictures += other.library_pictures;
        self.library.iter_mut().zip(other.library).for_each(|(sum, one)| *sum += one);
        self
    }
}

/// Runs; `done` is called after each picture. `None` when `stop` was set.
///
/// # Errors
/// What the detector says; a picture that JPEG cannot hold.
pub fn run(task: &Task, stop: &AtomicBool, done: &(dyn Fn() + Sync)) -> Result<Option<Report>, String> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(task.threads).build();
    let pool = pool.map_err(|error| error.to_string())?;
    let one = |detectors: &mut Result<Detectors, String>, number: usize| {
        let report = match detectors {
            _ if stop.load(Ordering::Relaxed) => Ok(Report::default()),
            Ok(detectors) => detectors.look(task, number),
            Err(error) => Err(error.clone()),
        };
        done();
        report
    };
    let all = pool.install(|| {
        let numbers = (0..task.pictures).into_par_iter();
        numbers.map_init(Detectors::new, one).try_reduce(Report::default, |a, b| Ok(a.merge(b)))
    })?;
    Ok((!stop.load(Ordering::Relaxed)).then_some(all))
}

/// Ours and the library's detectors.
struct Detectors {
    ours: Detector,
    library: Vec<PlainLibrary>,
}

impl Detectors {
    fn new() -> Result<Detectors, String> {
        let settings = DetectSettings { threads: 1, ..DetectSettings::default() };
        let ours = Detector::new(settings).map_err(|error| error.to_string())?;
        let library = DECIMATE.iter().map(|decimate| PlainLibrary::new(&[Family::Tag36h11], *decimate));
        let library = library.collect::<Result<_, _>>().map_err(|error| error.to_string())?;
        Ok(Detectors { ours, library })
    }

    fn look(&mut self, task: &Task, number: usize) -> Result<Report, String> {
        let mut random = ChaCha8Rng::seed_from_u64(task.seed);
        random.set_stream(number as u64);
        let photographs = &task.photographs;
        let under = (number.is_multiple_of(PHOTOGRAPH_SHARE) && !photographs.is_empty())
            .then(|| &photographs[number / PHOTOGRAPH_SHARE % photographs.len()]);
        let picture = clutter::degraded(SIZE, under, &mut random)?;
        let catalogue: Vec<Expected> =
            (0..CATALOGUE).map(|id| Expected::anywhere(Family::Tag36h11, id)).collect();
        let found = |found: Vec<Detection>| {
            found.into_iter().map(|detection| False { picture: number, detection }).collect::<Vec<_>>()
        };
        let text = |error: cell_vision::detect::DetectError| error.to_string();
        let expecting = found(self.ours.detect_thoroughly(&picture, &catalogue).map_err(text)?);
        // Fewer things pass where less is expected and fewer ways are gone: most often there is nothing.
        let (one_pass, thorough) = if expecting.is_empty() {
            (Vec::new(), Vec::new())
        } else {
            let one_pass = found(self.ours.detect(&picture).map_err(text)?);
            (one_pass, found(self.ours.detect_thoroughly(&picture, &[]).map_err(text)?))
        };
        let mut report = Report { pictures: 1, one_pass, thorough, expecting, ..Report::default() };
        if number.is_multiple_of(LIBRARY_SHARE) {
            report.library_pictures = 1;
            for (count, library) in report.library.iter_mut().zip(&mut self.library) {
                *count = library.detect(&picture).map_err(text)?.len();
            }
        }
        Ok(report)
    }
}
