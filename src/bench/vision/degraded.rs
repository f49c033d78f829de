//! How many markers are found in poor pictures: by one pass, by the second, and by the library alone.
//!
//! In: pictures whose markers are known, a seed. Out: [`Report`], a row for each degradation, a column for
//! each way of searching. Ours are called as the daemon and `celld detect` call them, with the same
//! settings; the library with its own default thresholds at three decimations. The same degraded picture
//! goes to all of them.

use crate::bench::vision::{KnownCorners, tally};
use cell_values::image::GrayImage;
use cell_vision::detect::second::Expected;
use cell_vision::detect::{DetectError, DetectSettings, Detection, Detector, Family, PlainLibrary};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::Serialize;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;
use vision_pictures::degrade::Degradation;

/// The columns.
pub const COLUMNS: [&str; 6] =
    ["one pass", "second pass", "nothing expected", "library 1", "library 1.5", "library 2"];
/// A marker with a corner further off is not found, pixels.
const SAME_PX: f64 = 6.0;
/// A corner nearer to the picture's border leaves no room for the white ring, pixels.
const BORDER_PX: f64 = 8.0;
/// Decimations of the library.
const DECIMATE: [f32; 3] = [1.0, 1.5, 2.0];

/// A picture and the markers in it.
pub struct Subject {
    picture: GrayImage,
    /// Those that should be found.
    markers: KnownCorners,
    /// Those that may be: cut by the border, or not surely there.
    others: KnownCorners,
}

/// What to run.
pub struct Task {
    /// Seed of all that is random in a degradation.
    pub seed: u64,
    /// Pictures at the same time.
    pub threads: usize,
}

/// What came out.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Pictures of each row.
    pub pictures: usize,
    /// Markers in them.
    pub markers: usize,
    /// Names of the columns.
    pub columns: [&'static str; 6],
    /// A row for each degradation.
    pub rows: Vec<Row>,
}

/// A degradation.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Its name.
    pub degradation: String,
    /// Column by column.
    pub columns: Vec<Cell>,
    /// Points that the second pass is behind the library's best column; negative when it is before it.
    pub behind_points: f64,
}

/// What one way of searching found.
#[derive(Clone, Debug, Serialize)]
pub struct Cell {
    /// Markers found, percent.
    pub found_percent: f64,
    /// Detections where no such marker is.
    pub false_ids: usize,
    /// Median corner error, pixels.
    pub corner_median_px: f64,
    /// Mean time of a picture, ms.
    pub ms: f64,
}

/// Sums of one column.
#[derive(Clone, Debug, Default)]
struct Sums {
    found: usize,
    false_ids: usize,
    corner_px: Vec<f64>,
    ms: f64,
}

impl Subject {
    /// A picture that was rendered, so that all its markers are known.
    pub fn rendered(picture: GrayImage, all: KnownCorners) -> Subject {
        let high = [f64::from(picture.width), f64::from(picture.height)].map(|size| size - 1.0 - BORDER_PX);
        let inside = |corner: &[f64; 2]| (0..2).all(|k| (BORDER_PX..high[k]).contains(&corner[k]));
        let (markers, others) = all.into_iter().partition(|(_, corners)| corners.iter().all(inside));
        Subject { picture, markers, others }
    }

    /// A picture that was taken: what at least two ways of searching read alike in it as it is counts.
    ///
    /// # Errors
    /// What the detector says.
    pub fn taken(picture: GrayImage) -> Result<Subject, String> {
        let mut detectors = Detectors::new().map_err(|error| error.to_string())?;
        let [_, _, ours, one, middle, two] =
            detectors.see(&picture, &[]).map_err(|error| error.to_string())?;
        let all = [ours.0, one.0, middle.0, two.0];
        let mut subject = Subject { picture, markers: Vec::new(), others: Vec::new() };
        for seen in all.iter().flatten() {
            let known = |known: &(u32, [[f64; 2]; 4])| is_at(seen, known);
            if subject.markers.iter().chain(&subject.others).any(known) {
                continue;
            }
            let marker = (seen.id, seen.corners);
            let readers = all.iter().filter(|way| way.iter().any(|other| is_at(other, &marker))).count();
            if readers > 1 { &mut subject.markers } else { &mut subject.others }.push(marker);
        }
        Ok(subject)
    }

    /// Markers that should be found.
    pub fn count(&self) -> usize {
        self.markers.len()
    }
}

/// Runs; `done` is called after each picture. `None` when `stop` was set.
///
/// # Errors
/// What the detector says; a picture that JPEG cannot hold.
pub fn run(
    task: &Task,
    subjects: &[Subject],
    stop: &AtomicBool,
    done: &(dyn Fn() + Sync),
) -> Result<Option<Report>, String> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(task.threads).build();
    let pool = pool.map_err(|error| error.to_string())?;
    let of = |(number, subject): (usize, &Subject)| {
        let sums = rows_of(task.seed, number, subject, stop);
        done();
        sums
    };
    let all: Vec<Vec<[Sums; 6]>> =
        pool.install(|| subjects.par_iter().enumerate().map(of).collect::<Result<_, _>>())?;
    if stop.load(Ordering::Relaxed) {
        return Ok(None);
    }
    let markers: usize = subjects.iter().map(Subject::count).sum();
    let rows = Degradation::ALL.iter().enumerate().map(|(row, degradation)| {
        let mut sums: [Sums; 6] = Default::default();
        for of_one in &all {
            sums.iter_mut().zip(&of_one[row]).for_each(|(sum, one)| sum.add(one));
        }
        Row::new(*degradation, sums, markers, subjects.len())
    });
    Ok(Some(Report { pictures: subjects.len(), markers, columns: COLUMNS, rows: rows.collect() }))
}

/// All degradations of one picture.
fn rows_of(seed: u64, number: usize, subject: &Subject, stop: &AtomicBool) -> Result<Vec<[Sums; 6]>, String> {
    let mut detectors = Detectors::new().map_err(|error| error.to_string())?;
    let corners: Vec<[[f64; 2]; 4]> =
        subject.markers.iter().chain(&subject.others).map(|(_, corners)| *corners).collect();
    let ids: Vec<u32> = subject.markers.iter().map(|(id, _)| *id).collect();
    let mut rows = Vec::with_capacity(Degradation::ALL.len());
    for degradation in Degradation::ALL {
        if stop.load(Ordering::Relaxed) {
            return Ok(Degradation::ALL.iter().map(|_| Default::default()).collect());
        }
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(number as u64);
        let picture = degradation.apply(&subject.picture, &corners, &mut random)?;
        let seen = detectors.see(&picture, &ids).map_err(|error| error.to_string())?;
        rows.push(seen.map(|(detections, ms)| subject.judge(&detections, ms)));
    }
    Ok(rows)
}

impl Subject {
    fn judge(&self, seen: &[Detection], ms: f64) -> Sums {
        let mut sums = Sums { ms, ..Sums::default() };
        for marker in &self.markers {
            if let Some(found) = seen.iter().find(|seen| is_at(seen, marker)) {
                sums.found += 1;
                sums.corner_px.extend((0..4).map(|i| apart(found.corners[i], marker.1[i])));
            }
        }
        let known = |seen: &&Detection| {
            self.markers.iter().chain(&self.others).any(|(id, corners)| {
                let near = 0.7 * apart(corners[0], corners[2]);
                seen.id == *id && apart(seen.centre(), middle(corners)) < near
            })
        };
        sums.false_ids = seen.iter().filter(|seen| !known(seen)).count();
        sums
    }
}

/// Every way of searching.
struct Detectors {
    ours: Detector,
    library: Vec<PlainLibrary>,
}

/// What a way found and how long it took, ms.
type Found = (Vec<Detection>, f64);

impl Detectors {
    fn new() -> Result<Detectors, DetectError> {
        let ours = Detector::new(DetectSettings { threads: 1, ..DetectSettings::default() })?;
        let library = DECIMATE.iter().map(|decimate| PlainLibrary::new(&[Family::Tag36h11], *decimate));
        Ok(Detectors { ours, library: library.collect::<Result<_, _>>()? })
    }

    fn see(&mut self, picture: &GrayImage, ids: &[u32]) -> Result<[Found; 6], DetectError> {
        let expected: Vec<Expected> =
            ids.iter().map(|id| Expected::anywhere(Family::Tag36h11, *id)).collect();
        let ours = &mut self.ours;
        let one = timed(|| ours.detect(picture))?;
        let first = one.0.clone();
        let mut second = timed(|| ours.look_again(picture, first, &expected))?;
        second.1 += one.1;
        let thorough = timed(|| ours.detect_thoroughly(picture, &[]))?;
        let mut library = self.library.iter_mut().map(|library| timed(|| library.detect(picture)));
        let mut next = || library.next().unwrap_or_else(|| Ok(Found::default()));
        Ok([one, second, thorough, next()?, next()?, next()?])
    }
}

fn timed(search: impl FnOnce() -> Result<Vec<Detection>, DetectError>) -> Result<Found, DetectError> {
    let started = Instant::now();
    let found = search()?;
    Ok((found, started.elapsed().as_secs_f64() * 1e3))
}

impl Sums {
    fn add(&mut self, other: &Sums) {
        self.found += other.found;
        self.false_ids += other.false_ids;
        self.corner_px.extend(&other.corner_px);
        self.ms += other.ms;
    }
}

impl Row {
    fn new(degradation: Degradation, sums: [Sums; 6], markers: usize, pictures: usize) -> Row {
        let cell = |mut sums: Sums| Cell {
            found_percent: 100.0 * sums.found as f64 / markers.max(1) as f64,
            false_ids: sums.false_ids,
            corner_median_px: tally::quantile(&mut sums.corner_px, 0.5),
            ms: sums.ms / pictures.max(1) as f64,
        };
        let columns = sums.map(cell);
        let best = columns[3..].iter().map(|cell| cell.found_percent).fold(0.0, f64::max);
        let behind_points = best - columns[1].found_percent;
        Row { degradation: degradation.to_string(), columns: columns.into(), behind_points }
    }
}

/// True when this is that marker, every corner in its place.
fn is_at(seen: &Detection, (id, corners): &(u32, [[f64; 2]; 4])) -> bool {
    seen.id == *id && (0..4).all(|i| apart(seen.corners[i], corners[i]) < SAME_PX)
}

fn apart(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

fn middle(corners: &[[f64; 2]; 4]) -> [f64; 2] {
    [0, 1].map(|axis| corners.iter().map(|corner| corner[axis]).sum::<f64>() / 4.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::vision::{Bench, Task as Frames};

    /// One rendered picture.
    fn subject() -> Subject {
        let settings = DetectSettings::default();
        let bench =
            Bench::new(Frames { frames: 5, seed: 4, settings, threads: 1, calibrated: false }).unwrap();
        let (picture, markers) = bench.frames(1).remove(0);
        Subject::rendered(picture, markers)
    }

    /// What the daemon's first pass and its second find in it.
    fn found(subject: &Subject, degradation: Degradation) -> [usize; 2] {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let picture = degradation.apply(&subject.picture, &[], &mut random).unwrap();
        let mut detector = Detector::new(DetectSettings::default()).unwrap();
        let first = detector.detect(&picture).unwrap();
        let expected = subject.markers.iter().map(|(id, _)| Expected::anywhere(Family::Tag36h11, *id));
        let expected: Vec<Expected> = expected.collect();
        let second = detector.look_again(&picture, first.clone(), &expected).unwrap();
        [first, second].map(|seen| {
            let sums = subject.judge(&seen, 0.0);
            assert_eq!(sums.false_ids, 0, "{degradation}");
            sums.found
        })
    }

    #[test]
    fn one_pass_finds_all_in_the_dark_and_in_fog_and_the_second_through_a_poor_jpeg() {
        let subject = subject();
        assert!(subject.count() > 10);
        for degradation in [Degradation::Gain(0.08), Degradation::Gain(0.04), Degradation::Fog(0.8)] {
            let [one, _] = found(&subject, degradation);
            assert_eq!(one, subject.count(), "{degradation}");
        }
        let [one, two] = found(&subject, Degradation::Jpeg(5));
        assert!(one < two && two + 1 >= subject.count(), "{one}, {two} of {}", subject.count());
    }

    #[test]
    fn a_marker_elsewhere_or_of_another_number_is_a_false_id_and_one_at_the_border_is_neither() {
        let square = |x: f64| [[x, 60.0], [x + 30.0, 60.0], [x + 30.0, 30.0], [x, 30.0]];
        let picture = GrayImage { width: 200, height: 100, data: vec![0; 20_000] };
        let subject = Subject::rendered(picture, vec![(1, square(50.0)), (2, square(169.0))]);
        assert_eq!(subject.count(), 1);
        let seen = |id, x| Detection { id, corners: square(x), ..Detection::default() };
        let judged = |id, x| {
            let sums = subject.judge(&[seen(id, x)], 0.0);
            (sums.found, sums.false_ids)
        };
        assert_eq!(
            [judged(1, 51.0), judged(1, 110.0), judged(3, 50.0), judged(2, 168.0)],
            [(1, 0), (0, 1), (0, 1), (0, 0)]
        );
    }
}
