//! How often a thing without a marker is found by comparing colours with the empty table, and how often one
//! is seen where there is none.
//!
//! In: how many scenes, a seed. Out: [`Report`]. The tables of `foreign`, each body in a colour of its own,
//! drawn as colour pictures from two look poses to which the arm comes back within its repeatability, in
//! light that is up to 15 % brighter or darker than when the table was empty. There are no shadows: the
//! renderer has none.

use crate::bench::vision::foreign::{
    Bench, CAMERA_HEIGHT_M, Capture, DrawnTable, EYES_Y_M, WIDTH_M, jitter, look, same, tables,
};
use crate::bench::vision::scene::looking_down;
use crate::bench::vision::tally::quantile;
use cell_values::image::Image;
use nalgebra::Isometry3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::Serialize;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;
use ur_sim::render::sensor::Exposure;

/// The arm's repeatability, standard deviation along and about each axis, m and rad.
const REPEAT_STD: (f64, f64) = (3e-5, 3e-5);
/// Light compared with that of the empty table.
const GAIN: [f32; 2] = [0.85, 1.15];

/// What came out.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Scenes with something foreign, and as many without.
    pub scenes: usize,
    /// Share of the first in which it was found where it is.
    pub found_rate: f64,
    /// Share of the others with a false alarm.
    pub false_alarm_rate: f64,
    /// Comparison and search of one look, median, ms.
    pub ms_per_look: f64,
}

/// One scene: whether there is something foreign, whether that was found, whether anything else was, and the
/// time.
struct Outcome {
    foreign: bool,
    found: bool,
    others: bool,
    ms: f64,
}

/// Runs `scenes` with something foreign and as many without; `None` when `stop` was set.
///
/// # Errors
/// What the lens says.
pub fn run(scenes: usize, seed: u64, threads: usize, stop: &AtomicBool) -> Result<Option<Report>, String> {
    let mut bench = Bench::new()?;
    let poses = EYES_Y_M.map(|y| looking_down([WIDTH_M / 2.0, y], CAMERA_HEIGHT_M, [0.02, -0.03], 0.05));
    let empty = |(look, pose): (u64, &Isometry3<f64>)| {
        (picture(&bench, Vec::new(), pose, &Exposure::default(), [seed, u64::MAX - look]), *pose)
    };
    let empty: Vec<(Image, Isometry3<f64>)> = (0..).zip(&poses).map(empty).collect();
    bench.compare_with(empty.iter().map(|(image, pose)| (image, *pose)));
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    let pool = pool.map_err(|error| error.to_string())?;
    let one = |number: usize| -> Result<Option<Outcome>, String> {
        if stop.load(Ordering::Relaxed) {
            return Ok(None);
        }
        scene(&bench, &poses, [seed, number as u64]).map(Some)
    };
    let outcomes = pool.install(|| {
        (0..2 * scenes).into_par_iter().map(one).collect::<Result<Option<Vec<Outcome>>, String>>()
    })?;
    Ok(outcomes.map(|outcomes| {
        let share = |count: usize| count as f64 / scenes.max(1) as f64;
        Report {
            scenes,
            found_rate: share(outcomes.iter().filter(|outcome| outcome.found).count()),
            false_alarm_rate: share(outcomes.iter().filter(|o| !o.foreign && o.others).count()),
            ms_per_look: quantile(&mut outcomes.iter().map(|outcome| outcome.ms).collect::<Vec<f64>>(), 0.5),
        }
    }))
}

fn scene(bench: &Bench, poses: &[Isometry3<f64>; 2], [seed, number]: [u64; 2]) -> Result<Outcome, String> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(number);
    let kind = (number % 2 == 1).then_some(number as usize / 2 % 4);
    let DrawnTable { mut things, foreign, known } = tables(kind, &mut random);
    for thing in &mut things {
        thing.prism.colour = [0; 3].map(|_: u8| random.random_range(20..235));
    }
    let prisms: Vec<_> = things.into_iter().map(|thing| thing.prism).collect();
    let mut images = Vec::with_capacity(poses.len());
    for (look, pose) in (0..).zip(poses) {
        let exposure = Exposure { gain: random.random_range(GAIN[0]..GAIN[1]), ..Exposure::default() };
        let truly = pose * jitter(REPEAT_STD, &mut random);
        images.push(picture(bench, prisms.clone(), &truly, &exposure, [seed, 2 * number + look]));
    }
    let cell = bench.knowing(known);
    let started = Instant::now();
    let captures = images.iter().zip(poses).map(|(image, pose)| Capture {
        depth: None,
        colour: Some(image),
        table_from_camera: pose,
    });
    let seen = look(&cell, captures)?;
    let ms = started.elapsed().as_secs_f64() * 1e3;
    let is_it = |object| foreign.as_ref().is_some_and(|truth| same(object, truth));
    Ok(Outcome {
        foreign: foreign.is_some(),
        found: seen.objects.iter().any(is_it),
        others: seen.objects.iter().any(|object| !is_it(object)),
        ms,
    })
}

fn picture(
    bench: &Bench,
    prisms: Vec<ur_sim::render::scene::Prism>,
    table_from_camera: &Isometry3<f64>,
    exposure: &Exposure,
    noise: [u64; 2],
) -> Image {
    let scene = bench.scene_of(prisms, table_from_camera);
    bench.renderer.expose(&scene, table_from_camera, exposure, noise)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn most_things_are_found_by_their_colour_and_none_where_there_is_none() {
        let report = run(8, 1, 2, &AtomicBool::new(false)).unwrap().unwrap();
        println!("{report:?}");
        assert!(report.found_rate > 0.8 && report.false_alarm_rate == 0.0, "{report:?}");
    }
}
