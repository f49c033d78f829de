//! How often a thing without a marker is found on a table, and how often one is seen where there is none.
//!
//! In: how many scenes, a seed. Out: [`Report`]. Tables with known objects, drawn by the simulator's depth
//! camera with its noise, holes, ragged edges and curved field; in one half of the scenes there is a box, a
//! mug, an object tipped on its side or one that lies on its marker, at least 30 mm long and wide. What is
//! known is known as the cell knows it: poses of objects and camera carry the errors of marker detection and
//! calibration. Each table is looked at from two places, as the cell does. What depth says is decided by
//! `perception`, as in the cell.

use crate::bench::vision::scene::{bare, bench_camera, looking_down};
use crate::perception::{self, observe_views};
use cell_values::image::Image;
use cell_values::image::depth::DepthImage;
use cell_values::image::depth::UNIT_M;
use cell_values::time::Timestamp;
use cell_vision::foreign::search::{ForeignSearch, Inventory};
use cell_vision::foreign::{Area, ForeignLimits, ForeignObject, ForeignReport, KnownBody};
use cell_vision::observe::View;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use rearrange::document::chain::chain;
use rearrange::geometry::collision::distance_between;
use rearrange::geometry::footprint::Footprint;
use rearrange::geometry::polygon::contains;
use rearrange::geometry::pose::Pose2;
use serde::Serialize;
use std::f64::consts::{FRAC_PI_2, PI};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;
use ur_sim::render::Renderer;
use ur_sim::render::lens::CameraTruth;
use ur_sim::render::scene::{Prism, Scene};
use ur_sim::render::sensor::Exposure;
use ur_sim::world::section::Section;

/// The workspace, m.
pub(super) const WIDTH_M: f64 = 0.5;
const HEIGHT_M: f64 = 0.4;
/// Height of the camera, m.
const EYE_M: [f64; 2] = [0.45, 0.55];
/// Where it is in y for the looks of a table, m.
pub(super) const EYES_Y_M: [f64; 2] = [0.14, HEIGHT_M - 0.14];
/// Height of the camera where it is always the same, m.
pub(super) const CAMERA_HEIGHT_M: f64 = 0.5;
/// What is searched: the workspace and a margin.
pub(super) const AREA: Area = Area { low: [-0.02; 2], high: [WIDTH_M + 0.02, HEIGHT_M + 0.02] };
/// Standard deviations of what the cell knows: object (m, rad), camera (m, rad).
const OBJECT_STD: (f64, f64) = (2e-4, 1e-3);
const CAMERA_STD: (f64, f64) = (3e-4, 5e-4);
/// Smallest extent of a thing on the table, m: 30 mm.
const LEAST_M: f64 = 0.03;

/// What to run.
#[derive(Clone, Copy, Debug)]
pub struct Task {
    /// Scenes with something foreign, and as many without.
    pub scenes: usize,
    /// Seed.
    pub seed: u64,
    /// Scenes at the same time.
    pub threads: usize,
}

/// One kind of thing.
#[derive(Clone, Debug, Serialize)]
pub struct KindRow {
    /// What it is.
    pub kind: &'static str,
    /// Scenes with it.
    pub scenes: usize,
    /// Those in which it was found.
    pub found: usize,
}

/// What came out.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Scenes with something foreign.
    pub scenes: usize,
    /// Share of them in which it was found where it is.
    pub found_rate: f64,
    /// Scenes without, and those with which something was seen all the same.
    pub clean_scenes: usize,
    /// Share of clean scenes with a false alarm.
    pub false_alarm_rate: f64,
    /// Things seen besides the right one in scenes that have one.
    pub strays: usize,
    /// Distance of the middle of the outline from the thing's own middle, median, mm.
    pub position_median_mm: f64,
    /// Error of the height, median, mm.
    pub height_median_mm: f64,
    /// Smallest share of a clean table on which depth was measured.
    pub measured_least: f64,
    /// Largest piece of a clean table in which it was not, cm2.
    pub largest_hole_cm2: f64,
    /// Height maps and search of one look, median, ms.
    pub ms_per_look: f64,
    /// By kind.
    pub kinds: Vec<KindRow>,
}

/// Kinds of foreign things, and how one is drawn.
const KINDS: [&str; 4] = ["box", "mug", "tipped on its side", "on its marker"];

/// Depth camera of the bench, and what the cell knows of an empty table.
pub(super) struct Bench {
    pub(super) renderer: Renderer,
    known: perception::Scene,
    search: ForeignSearch,
}

/// A body of a scene: outline on the table, height, and how it is drawn.
pub(super) struct Thing {
    known: KnownBody,
    pub(super) prism: Prism,
}

/// A table as it was drawn.
pub(super) struct DrawnTable {
    /// All that is on it.
    pub things: Vec<Thing>,
    /// The foreign thing among them, if there is one.
    pub foreign: Option<KnownBody>,
    /// What is known of the rest.
    pub known: Vec<KnownBody>,
}

/// What was taken from one place of a look.
#[derive(Clone, Copy)]
pub(super) struct Capture<'a> {
    /// Depth, where it is measured.
    pub depth: Option<&'a DepthImage>,
    /// Colour, where there is no depth.
    pub colour: Option<&'a Image>,
    /// Where the camera is, as the cell believes.
    pub table_from_camera: &'a Isometry3<f64>,
}

/// What one scene gave.
struct Outcome {
    kind: Option<usize>,
    found: Option<(f64, f64)>,
    others: usize,
    measured_share: f64,
    hole_m2: f64,
    ms: f64,
}

/// Runs; `done` is called after every scene. `None` when `stop` was set.
///
/// # Errors
/// What the lens or the height map says.
pub fn run(task: Task, stop: &AtomicBool, done: &(dyn Fn() + Sync)) -> Result<Option<Report>, String> {
    let bench = Bench::new()?;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(task.threads).build();
    let pool = pool.map_err(|error| error.to_string())?;
    let one = |number: usize| -> Result<Option<Outcome>, String> {
        if stop.load(Ordering::Relaxed) {
            return Ok(None);
        }
        let outcome = bench.scene(task, number)?;
        done();
        Ok(Some(outcome))
    };
    let outcomes = pool.install(|| {
        (0..2 * task.scenes).into_par_iter().map(one).collect::<Result<Option<Vec<Outcome>>, String>>()
    })?;
    Ok(outcomes.map(|outcomes| report(task, &outcomes)))
}

fn report(task: Task, outcomes: &[Outcome]) -> Report {
    let share = |part: usize| part as f64 / task.scenes.max(1) as f64;
    let with = || outcomes.iter().filter(|outcome| outcome.kind.is_some());
    let clean = || outcomes.iter().filter(|outcome| outcome.kind.is_none());
    let found: Vec<(f64, f64)> = outcomes.iter().filter_map(|outcome| outcome.found).collect();
    let median = |values: Vec<f64>| crate::bench::vision::tally::quantile(&mut { values }, 0.5);
    let false_alarms = clean().filter(|outcome| outcome.others > 0).count();
    let row = |(index, kind): (usize, &&'static str)| KindRow {
        kind,
        scenes: with().filter(|outcome| outcome.kind == Some(index)).count(),
        found: with().filter(|outcome| outcome.kind == Some(index) && outcome.found.is_some()).count(),
    };
    Report {
        scenes: task.scenes,
        found_rate: share(found.len()),
        clean_scenes: task.scenes,
        false_alarm_rate: share(false_alarms),
        strays: with().map(|outcome| outcome.others).sum(),
        measured_least: clean().map(|outcome| outcome.measured_share).fold(1.0, f64::min),
        largest_hole_cm2: 1e4 * clean().map(|outcome| outcome.hole_m2).fold(0.0, f64::max),
        position_median_mm: median(found.iter().map(|(off_m, _)| off_m * 1e3).collect()),
        height_median_mm: median(found.iter().map(|(_, off_m)| off_m.abs() * 1e3).collect()),
        ms_per_look: median(outcomes.iter().map(|outcome| outcome.ms).collect()),
        kinds: KINDS.iter().enumerate().map(row).collect(),
    }
}

impl Bench {
    pub(super) fn new() -> Result<Bench, String> {
        let camera = bench_camera();
        let truth = CameraTruth {
            fx: camera.fx,
            fy: camera.fy,
            cx: camera.cx,
            cy: camera.cy,
            distortion: camera.distortion,
            ..CameraTruth::ideal("bench", camera.width, camera.height, camera.fx)
        };
        let inventory =
            Inventory { area: AREA, objects: Vec::new(), fixed: Vec::new(), ignored: Vec::new(), own: None };
        let search = ForeignSearch::new(&camera, inventory, ForeignLimits::default());
        let search = search.map_err(|error| chain(&error))?;
        Ok(Bench { renderer: Renderer::new(truth), known: bare(&camera), search })
    }

    /// From now on looks are compared with these pictures of the empty table.
    pub(super) fn compare_with<'a>(&mut self, empty: impl Iterator<Item = (&'a Image, Isometry3<f64>)>) {
        self.search.compare_with(empty);
    }

    /// What the cell knows of a table on which these bodies are.
    pub(super) fn knowing(&self, bodies: Vec<KnownBody>) -> perception::Scene {
        let foreign = Some(self.search.clone().with_fixed(bodies));
        perception::Scene { foreign, ..self.known.clone() }
    }

    /// Scene `number`: the even ones are clean.
    fn scene(&self, task: Task, number: usize) -> Result<Outcome, String> {
        let mut random = ChaCha8Rng::seed_from_u64(task.seed);
        random.set_stream(number as u64);
        let kind = (number % 2 == 1).then_some(number / 2 % KINDS.len());
        let DrawnTable { things, foreign, known } = tables(kind, &mut random);
        let prisms: Vec<Prism> = things.into_iter().map(|thing| thing.prism).collect();
        let mut taken = Vec::with_capacity(EYES_Y_M.len());
        for (look, y) in (0..).zip(EYES_Y_M) {
            let eye = eye(y, &mut random);
            let depth = self.depth(
                &self.scene_of(prisms.clone(), &eye),
                &eye,
                [task.seed, 2 * number as u64 + look],
            )?;
            taken.push((depth, eye * jitter(CAMERA_STD, &mut random)));
        }
        let cell = self.knowing(known);
        let started = Instant::now();
        let captures = taken.iter().map(|(depth, believed)| Capture {
            depth: Some(depth),
            colour: None,
            table_from_camera: believed,
        });
        let seen = look(&cell, captures)?;
        let ms = started.elapsed().as_secs_f64() * 1e3;
        let is_it = |object: &&ForeignObject| foreign.as_ref().is_some_and(|truth| same(object, truth));
        let found = seen.objects.iter().find(is_it).zip(foreign.as_ref());
        let found = found.map(|(object, truth)| {
            let off = (object.centre[0] - truth.pose.x).hypot(object.centre[1] - truth.pose.y);
            (off, object.height_m - truth.height_m)
        });
        let others = seen.objects.iter().filter(|object| !is_it(object)).count();
        let hole_m2 = seen.largest_hole().map_or(0.0, |hole| hole.area_m2);
        Ok(Outcome { kind, found, others, measured_share: seen.measured_share, hole_m2, ms })
    }

    pub(super) fn scene_of(&self, prisms: Vec<Prism>, table_from_camera: &Isometry3<f64>) -> Scene {
        let board = [-0.2, -0.2, WIDTH_M + 0.2, HEIGHT_M + 0.2];
        Scene { board, table_from_flange: *table_from_camera, prisms, prints: Vec::new() }
    }

    fn depth(
        &self,
        scene: &Scene,
        table_from_camera: &Isometry3<f64>,
        noise: [u64; 2],
    ) -> Result<DepthImage, String> {
        let drawn = self.renderer.expose_depth(scene, table_from_camera, &Exposure::default(), noise);
        let (width, height) = (self.known.camera.width, self.known.camera.height);
        DepthImage::from_units(width, height, &drawn.units, UNIT_M).map_err(|error| error.to_string())
    }
}

/// What a look shows of things without a marker: depth, or colour where there is none, from each place. No
/// marker is drawn on these tables, so none is searched for.
pub(super) fn look<'a>(
    cell: &perception::Scene,
    taken: impl Iterator<Item = Capture<'a>>,
) -> Result<ForeignReport, String> {
    let mut views = Vec::with_capacity(EYES_Y_M.len());
    for Capture { depth, colour, table_from_camera } in taken {
        let heights = cell.heights(depth, colour, table_from_camera).map_err(|error| chain(&error))?;
        let (table_from_camera, time) = (*table_from_camera, Timestamp::ZERO);
        views.push(View { table_from_camera, detections: Vec::new(), time, heights });
    }
    let seen = observe_views(cell, &views, None).map_err(|error| chain(&error))?;
    seen.foreign.ok_or_else(|| "neither depth nor colour showed the table".to_string())
}

/// A table, with something foreign of that kind on it.
pub(super) fn tables(kind: Option<usize>, random: &mut ChaCha8Rng) -> DrawnTable {
    let mut things: Vec<Thing> = Vec::new();
    // First, while there is room for it.
    let foreign = kind.and_then(|kind| {
        let thing = foreign(kind, random);
        place(thing, &mut things, random).then(|| things[0].known.clone())
    });
    for _ in 0..random.random_range(3..9) {
        let thing = object(random);
        place(thing, &mut things, random);
    }
    let known = things.iter().skip(usize::from(foreign.is_some()));
    let known = known.map(|thing| measured(&thing.known, random)).collect();
    DrawnTable { things, foreign, known }
}

/// True when an outline that was found is that of the thing that is there.
pub(super) fn same(found: &ForeignObject, truth: &KnownBody) -> bool {
    contains(&found.outline, [truth.pose.x, truth.pose.y])
        || (found.centre[0] - truth.pose.x).hypot(found.centre[1] - truth.pose.y) < LEAST_M
}

/// An object of the catalogue, lying as it should.
fn object(random: &mut ChaCha8Rng) -> Thing {
    let height_m = random.random_range(0.01..0.045);
    let footprint = if random.random() {
        Footprint::Rectangle {
            length: random.random_range(0.05..0.16),
            width: random.random_range(0.04..0.08),
        }
    } else {
        Footprint::Disc { radius: random.random_range(0.025..0.05) }
    };
    upright(footprint, height_m)
}

fn upright(footprint: Footprint, height_m: f64) -> Thing {
    let prism = Prism {
        table_from_prism: Isometry3::identity(),
        section: Arc::new(Section::from_footprint(&footprint)),
        height_m,
        colour: [120; 3],
        prints: Vec::new(),
    };
    Thing { known: KnownBody { footprint, pose: Pose2::default(), height_m }, prism }
}

/// Something of this kind, at least 30 mm long and wide, or, tipped, long and high.
fn foreign(kind: usize, random: &mut ChaCha8Rng) -> Thing {
    let mut extent = || random.random_range(LEAST_M..0.12);
    let [length, width, height] = [extent(), extent(), extent()];
    match kind {
        0 => upright(Footprint::Rectangle { length, width }, height),
        1 => upright(Footprint::Disc { radius: length.max(width) / 2.0 }, height),
        2 => {
            // A plank of 15 to 30 mm rests on its long edge: its section is turned up about x.
            let thick = random.random_range(0.015..LEAST_M);
            let mut thing = upright(Footprint::Rectangle { length, width }, thick);
            let up = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), FRAC_PI_2);
            thing.prism.table_from_prism =
                Isometry3::from_parts(Translation3::new(0.0, thick / 2.0, width / 2.0), up);
            thing.known.footprint = Footprint::Rectangle { length, width: thick };
            thing.known.height_m = width;
            thing
        }
        _ => {
            let thick = random.random_range(0.015..0.045);
            let mut thing = upright(Footprint::Rectangle { length, width }, thick);
            let over = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI);
            thing.prism.table_from_prism = Isometry3::from_parts(Translation3::new(0.0, 0.0, thick), over);
            thing
        }
    }
}

/// Puts a thing where nothing else is, wholly on the table; false when there is no room for it.
fn place(mut thing: Thing, things: &mut Vec<Thing>, random: &mut ChaCha8Rng) -> bool {
    for _ in 0..300 {
        let (x, y) = (random.random_range(0.0..WIDTH_M), random.random_range(0.0..HEIGHT_M));
        let pose = Pose2::new(x, y, random.random_range(-PI..PI));
        let (low, high) = thing.known.footprint.bounds(&pose);
        let inside = low[0] >= 0.0 && low[1] >= 0.0 && high[0] <= WIDTH_M && high[1] <= HEIGHT_M;
        let apart = |other: &Thing| {
            let (a, b) = (&thing.known, &other.known);
            distance_between(&a.footprint, &pose, &b.footprint, &b.pose) > 0.002
        };
        if inside && things.iter().all(apart) {
            thing.prism.table_from_prism = pose.at_height(0.0) * thing.prism.table_from_prism;
            thing.known.pose = pose;
            things.push(thing);
            return true;
        }
    }
    false
}

fn eye(y: f64, random: &mut ChaCha8Rng) -> Isometry3<f64> {
    let mut within = |reach: f64| random.random_range(-reach..reach);
    let at = [WIDTH_M / 2.0 + within(0.03), y + within(0.02)];
    let tilt = [within(0.05), within(0.05)];
    let turn = within(0.1);
    looking_down(at, random.random_range(EYE_M[0]..EYE_M[1]), tilt, turn)
}

fn normal(random: &mut ChaCha8Rng) -> f64 {
    // Twelve uniform numbers: normal enough for errors that matter at three deviations.
    (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0
}

pub(super) fn jitter((std_m, std_rad): (f64, f64), random: &mut ChaCha8Rng) -> Isometry3<f64> {
    let mut three = |std: f64| Vector3::new(normal(random), normal(random), normal(random)) * std;
    Isometry3::new(three(std_m), three(std_rad))
}

/// A body as the cell knows it.
fn measured(truth: &KnownBody, random: &mut ChaCha8Rng) -> KnownBody {
    let off = |random: &mut ChaCha8Rng| normal(random) * OBJECT_STD.0;
    let pose = Pose2::new(
        truth.pose.x + off(random),
        truth.pose.y + off(random),
        truth.pose.theta + normal(random) * OBJECT_STD.1,
    );
    KnownBody { pose, ..truth.clone() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_few_scenes_meet_the_figures() {
        let task = Task { scenes: 24, seed: 1, threads: 2 };
        let report = run(task, &AtomicBool::new(false), &|| ()).unwrap().unwrap();
        println!("{report:?}");
        assert!(report.found_rate > 0.95 && report.false_alarm_rate < 0.05, "{report:?}");
        assert!(report.position_median_mm < 5.0 && report.height_median_mm < 6.0, "{report:?}");
        assert!(report.kinds.iter().all(|row| row.scenes > 3), "{report:?}");
        assert!(report.measured_least > 0.95 && report.largest_hole_cm2 < 10.0, "{report:?}");
    }

    #[test]
    fn a_run_that_is_stopped_has_no_report() {
        let task = Task { scenes: 2, seed: 1, threads: 1 };
        assert!(run(task, &AtomicBool::new(true), &|| ()).unwrap().is_none());
    }
}
