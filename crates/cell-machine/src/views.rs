//! Poses of the arm from which the camera sees given parts of the table.
//!
//! In: the cell (arm, bodies, where the camera sits), the lens, the reference markers, what of the gripper
//! is in the picture. Out: [`Views`]: poses that are free of collision and show enough reference markers,
//! each with the cells of the table that it shows; and for a region and a price for each pose, the
//! cheapest pose, or pair of poses, that shows all of it. Computed once for a cell: a few hundred poses
//! that look straight down from the heights of the taught look poses. Those are among them. Pure.

use cell_calibration::files::hand_eye::Mount;
use cell_motion::bodies::Room;
use cell_motion::bodies::sweep::{Sweep, Zone};
use cell_motion::path::ArmModel;
use cell_motion::pick_n_place::CycleParameters;
use cell_values::units::Joints;
use cell_vision::camera::CameraModel;
use cell_vision::foreign::OwnBody;
use cell_vision::marker::corners_m;
use cell_vision::observe::ReferenceMarker;
use cell_vision::region::Region;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};
use std::sync::{Arc, OnceLock};

/// Edge of a cell of the table, m.
const CELL_M: f64 = 0.025;

/// From pose to pose over the table, m.
const STEP_M: f64 = 0.07;

/// How far beyond the table the camera may be, m.
const BEYOND_M: f64 = 0.07;

/// Heights of the camera, as shares of the highest from which a taught pose looks: from higher one picture
/// shows what two do from there.
const HEIGHTS: [f64; 7] = [1.5, 1.2, 1.0, 0.85, 0.75, 0.65, 0.55];

/// Pixels that each of the eight modules of the smallest marker has at least, straight below. With three all
/// of 240 rendered markers are detected, corners to 0.1 px (`cell_vision::detect`); with 2.6 not all.
const MODULE_PX: f64 = 3.2;

/// Turns of the camera about the vertical.
const TURNS: usize = 12;

/// What counts as seen is so far inside the picture, px.
const RIM_PX: f64 = 8.0;

/// Reference markers that a pose shows at least: one more than a look needs, for one may be covered.
const REFERENCES: usize = 4;

/// Places along a line of sight at which it may meet the gripper.
const ALONG: usize = 24;

/// Columns and rows of the mask of the picture, and room round the gripper in it, m.
const MASK: [usize; 2] = [96, 54];
const ROOM_M: f64 = 0.005;

/// So many of the cheapest poses are looked at for whether they are free, and so many refined.
const TRIED: usize = 60;
const REFINED: usize = 3;

/// Pairs are tried among so many of the poses that show most.
const PAIRED: usize = 40;

/// So many pairs are priced at most: this is computed between two signs of life of the arm's program.
const PAIRS: usize = 4000;

/// What the camera on the wrist shows from where, for looks at parts of the table.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct SightModel {
    /// The lens.
    pub camera: CameraModel,
    /// The surveyed reference markers.
    pub references: Vec<ReferenceMarker>,
    /// Edge of the smallest marker's black square, m.
    pub smallest_m: f64,
    /// The gripper in the picture.
    pub own: Option<OwnBody>,
    /// Poses to look from, computed when they are first needed; shared by all copies of a cell.
    #[serde(skip)]
    pub views: Arc<OnceLock<Views>>,
}

/// The arm with its camera over the table.
#[derive(Clone, Copy, Debug)]
pub struct Rig<'a> {
    /// The arm.
    pub arm: &'a ArmModel,
    /// Where the camera sits.
    pub mount: &'a Mount,
    /// Heights.
    pub cycle: &'a CycleParameters,
    /// Taught poses that together see all of the table.
    pub look_poses: &'a [Joints],
    /// Width and depth of the table, m.
    pub table: [f64; 2],
}

impl Rig<'_> {
    /// `table_from_camera` with the arm at `q`.
    pub fn camera_at(&self, q: &Joints) -> Isometry3<f64> {
        let base_from_flange = self.arm.kinematics.forward(q);
        self.arm.base_from_table.inverse() * self.mount.base_from_camera(&base_from_flange)
    }
}

/// A pose to look from.
#[derive(Clone, Debug)]
struct ViewPose {
    q: Joints,
    /// Which cells it shows, row by row.
    shows: Vec<u64>,
}

/// The poses of a cell. See the module.
#[derive(Clone, Debug)]
pub struct Views {
    table: [f64; 2],
    columns: usize,
    rows: usize,
    /// Of the camera over the table, m.
    heights: (f64, f64),
    picture: Picture,
    poses: Vec<ViewPose>,
}

impl Views {
    /// All poses of a cell whose camera is on the flange.
    pub fn new(model: &Rig, sight: &SightModel) -> Views {
        let table = model.table;
        let cells = |length: f64| (length / CELL_M).ceil().clamp(1.0, 400.0) as usize;
        let (columns, rows) = (cells(table[0]), cells(table[1]));
        let (heights, picture) = (heights(model, sight), Picture::new(sight));
        let mut views = Views { table, columns, rows, heights, picture, poses: Vec::new() };
        let room = Room::new(&model.arm.bodies, &model.cycle.tabletop(Vec::new()), None);
        let mut sweep = Sweep::new(&model.arm.bodies, &room);
        let picture = views.picture.clone();
        let shows_references = |aim: &Aim| picture.shows_references(&aim.table_from_camera().inverse());
        // The cheapest check first: markers, then joints, then collisions.
        let aims = straight_down(table, heights).filter(shows_references);
        let computed = aims.filter_map(|aim| looking_along(model, &aim));
        let taught = model.look_poses.iter().copied();
        let taught = taught.filter(|q| picture.shows_references(&model.camera_at(q).inverse()));
        for q in taught.chain(computed) {
            if model.arm.outside_range(&q).is_none() && sweep.place(&q, Zone::Over).is_ok() {
                let shows = views.shown(&model.camera_at(&q).inverse(), model.cycle.tallest);
                views.poses.push(ViewPose { q, shows });
            }
        }
        views
    }

    /// Height of the tool over the table at the lowest look and at the highest, m.
    pub fn tool_heights(&self, arm: &ArmModel) -> [f64; 2] {
        let height = |pose: &ViewPose| arm.tool_at(&pose.q).translation.vector.z;
        let all = || self.poses.iter().map(height);
        [all().fold(f64::INFINITY, f64::min), all().fold(0.0, f64::max)]
    }

    /// How many poses there are.
    pub fn len(&self) -> usize {
        self.poses.len()
    }

    /// There is none.
    pub fn is_empty(&self) -> bool {
        self.poses.is_empty()
    }

    /// Whether all of these points in the table frame, m, show from a camera, `table_from_camera`.
    pub fn show(&self, camera: &Isometry3<f64>, points: &[Point3<f64>]) -> bool {
        points.iter().all(|point| self.picture.shows(&camera.inverse_transform_point(point)))
    }

    /// Which cells are seen, up to the height of the tallest object, m.
    fn shown(&self, camera_from_table: &Isometry3<f64>, tallest: f64) -> Vec<u64> {
        let corner = |index: usize| {
            let (column, row) = (index % (self.columns + 1), index / (self.columns + 1));
            let at = [column as f64 * CELL_M, row as f64 * CELL_M];
            self.picture.shows_place(camera_from_table, at, tallest)
        };
        let corners: Vec<bool> = (0..(self.columns + 1) * (self.rows + 1)).map(corner).collect();
        let mut shows = vec![0; self.words()];
        for cell in 0..self.columns * self.rows {
            let first = cell / self.columns * (self.columns + 1) + cell % self.columns;
            let around = [first, first + 1, first + self.columns + 1, first + self.columns + 2];
            if around.iter().all(|corner| corners[*corner]) {
                shows[cell / 64] |= 1 << (cell % 64);
            }
        }
        shows
    }

    /// How many of these places are not seen from `q`; `None` where too few reference markers are.
    fn missed(&self, model: &Rig, q: &Joints, places: &[[f64; 2]]) -> Option<usize> {
        let camera_from_table = model.camera_at(q).inverse();
        let tallest = model.cycle.tallest;
        let hidden = |at: &&[f64; 2]| !self.picture.shows_place(&camera_from_table, **at, tallest);
        self.picture.shows_references(&camera_from_table).then(|| places.iter().filter(hidden).count())
    }

    fn words(&self) -> usize {
        (self.columns * self.rows).div_ceil(64)
    }

    /// The cells of the table that a region touches.
    fn cells(&self, region: &Region) -> Vec<u64> {
        let mut cells = vec![0; self.words()];
        for cell in 0..self.columns * self.rows {
            let (column, row) = (cell % self.columns, cell / self.columns);
            // A cell is touched where its middle or a corner is in the region.
            let at = |dx: f64, dy: f64| {
                let place = [(column as f64 + dx) * CELL_M, (row as f64 + dy) * CELL_M];
                [place[0].min(self.table[0]), place[1].min(self.table[1])]
            };
            let tried = [(0.5, 0.5), (0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)];
            if tried.iter().any(|(dx, dy)| region.contains(at(*dx, *dy))) {
                cells[cell / 64] |= 1 << (cell % 64);
            }
        }
        cells
    }

    /// From where all of a region is seen at the least price, in order: one pose where one does, else two;
    /// `None` where two do not. `free` says whether the arm may be at a pose with what may hang on it.
    pub fn covering(
        &self,
        model: &Rig,
        region: &Region,
        price: &dyn Fn(&[Joints]) -> f64,
        free: &dyn Fn(&Joints) -> bool,
    ) -> Option<Vec<Joints>> {
        let wanted = self.cells(region);
        let missed = |shows: &[u64]| -> u32 {
            wanted.iter().zip(shows).map(|(wanted, shows)| (wanted & !shows).count_ones()).sum()
        };
        let mut by_missed: Vec<(u32, &ViewPose)> =
            self.poses.iter().map(|pose| (missed(&pose.shows), pose)).collect();
        let whole = by_missed.iter().filter(|(missed, _)| *missed == 0).map(|(_, pose)| vec![pose.q]);
        let mut best = cheapest(whole, price, free);
        by_missed.sort_by_key(|(missed, _)| *missed);
        by_missed.truncate(PAIRED);
        let search = Search { views: self, model, corners: self.corners(&wanted), price };
        let starts = best.iter().map(|way| way[0]).chain(by_missed.iter().map(|(_, pose)| pose.q));
        let refined: Vec<Vec<Joints>> =
            starts.take(REFINED).filter_map(|start| search.refined(start)).map(|q| vec![q]).collect();
        best.extend(refined);
        if let Some(best) = cheapest(best.into_iter(), price, free).into_iter().next() {
            return Some(best);
        }
        let pairs = by_missed.iter().flat_map(|(_, first)| {
            let together = |second: &ViewPose| -> Vec<u64> {
                first.shows.iter().zip(&second.shows).map(|(a, b)| a | b).collect()
            };
            let seconds = self.poses.iter().filter(move |second| missed(&together(second)) == 0);
            seconds.flat_map(|second| [vec![first.q, second.q], vec![second.q, first.q]])
        });
        cheapest(pairs.take(PAIRS), price, free).into_iter().next()
    }

    /// Corners of these cells, on the table.
    fn corners(&self, cells: &[u64]) -> Vec<[f64; 2]> {
        let across = self.columns + 1;
        let mut marked = vec![false; across * (self.rows + 1)];
        for cell in (0..self.columns * self.rows).filter(|cell| cells[cell / 64] >> (cell % 64) & 1 == 1) {
            let first = cell / self.columns * across + cell % self.columns;
            [first, first + 1, first + across, first + across + 1].iter().for_each(|at| marked[*at] = true);
        }
        let place = |at: usize| [(at % across) as f64 * CELL_M, (at / across) as f64 * CELL_M];
        (0..marked.len()).filter(|at| marked[*at]).map(place).collect()
    }
}

/// A few of the cheapest ways whose poses are free, the cheapest first.
fn cheapest(
    ways: impl Iterator<Item = Vec<Joints>>,
    price: &dyn Fn(&[Joints]) -> f64,
    free: &dyn Fn(&Joints) -> bool,
) -> Vec<Vec<Joints>> {
    let mut priced: Vec<(f64, Vec<Joints>)> = ways.map(|way| (price(&way), way)).collect();
    priced.sort_by(|a, b| a.0.total_cmp(&b.0));
    let free = priced.into_iter().map(|(_, way)| way).take(TRIED).filter(|way| way.iter().all(free));
    free.take(REFINED).collect()
}

/// Where the camera is, and how it is turned about the vertical and tilted about its own axes.
#[derive(Clone, Copy)]
struct Aim([f64; 6]);

impl Aim {
    fn table_from_camera(self) -> Isometry3<f64> {
        let [x, y, z, turn, about_x, about_y] = self.0;
        let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI);
        let tilt = UnitQuaternion::from_scaled_axis(Vector3::new(about_x, about_y, 0.0));
        let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn) * down * tilt;
        Isometry3::from_parts(Translation3::new(x, y, z), turned)
    }
}

/// First steps of the search, m and rad, and how far the camera is tilted at most, rad.
const STEPS: [f64; 6] = [0.03, 0.03, 0.03, 0.15, 0.1, 0.1];
const TILT_RAD: f64 = 0.2;

/// What a place costs that is not seen, s: more than any way.
const MISSED_S: f64 = 1000.0;

/// How often the steps are halved.
const HALVINGS: usize = 3;

/// A search for a pose that shows the same at a lower price.
struct Search<'a> {
    views: &'a Views,
    model: &'a Rig<'a>,
    corners: Vec<[f64; 2]>,
    price: &'a dyn Fn(&[Joints]) -> f64,
}

impl Search<'_> {
    /// Step by step from a pose that looks straight down, as long as it shows more or gets cheaper; the pose
    /// that shows all, if that is found. Taught poses stay.
    fn refined(&self, start: Joints) -> Option<Joints> {
        let mut aim = self.aim_of(&start)?;
        let (mut price, mut best) = self.worth(&aim)?;
        for halving in 0..HALVINGS {
            let mut better = true;
            while std::mem::take(&mut better) {
                for (axis, step) in STEPS.iter().enumerate() {
                    for side in [-1.0, 1.0] {
                        let mut next = aim;
                        next.0[axis] += side * step / f64::from(1 << halving);
                        if let Some((worth, q)) = self.worth(&next).filter(|(worth, _)| *worth < price - 1e-3)
                        {
                            (aim, price, best, better) = (next, worth, q, true);
                        }
                    }
                }
            }
        }
        (price < MISSED_S).then_some(best)
    }

    fn aim_of(&self, q: &Joints) -> Option<Aim> {
        let camera = self.model.camera_at(q);
        let down = camera.rotation * Vector3::z();
        let x = camera.rotation * Vector3::x();
        let at = camera.translation.vector;
        (down.z < -0.9999).then(|| Aim([at.x, at.y, at.z, x.y.atan2(x.x), 0.0, 0.0]))
    }

    /// The price of looking from there, and so much more for every place that has to be seen and is not.
    fn worth(&self, aim: &Aim) -> Option<(f64, Joints)> {
        let [.., z, _, about_x, about_y] = aim.0;
        let (low, high) = self.views.heights;
        if !(low..=high).contains(&z) || about_x.abs() > TILT_RAD || about_y.abs() > TILT_RAD {
            return None;
        }
        let q = looking_along(self.model, aim)?;
        let missed = self.views.missed(self.model, &q, &self.corners)?;
        Some(((self.price)(&[q]) + MISSED_S * missed as f64, q))
    }
}

/// The lens, the reference markers, and what of the picture the gripper leaves free.
#[derive(Clone, Debug)]
struct Picture {
    camera: CameraModel,
    references: Vec<ReferenceMarker>,
    /// Row by row.
    free: Vec<bool>,
}

impl Picture {
    fn new(sight: &SightModel) -> Picture {
        let size = [sight.camera.width, sight.camera.height].map(f64::from);
        let meets = |column: usize, row: usize| {
            let at = [column, row].map(|k| k as f64);
            let u = size[0] * at[0] / MASK[0] as f64;
            let v = size[1] * at[1] / MASK[1] as f64;
            let ray = [(u - sight.camera.cx) / sight.camera.fx, (v - sight.camera.cy) / sight.camera.fy];
            sight.own.as_ref().is_some_and(|own| meets_gripper(own, ray))
        };
        let corner: Vec<bool> =
            (0..=MASK[1]).flat_map(|row| (0..=MASK[0]).map(move |column| meets(column, row))).collect();
        let free = (0..MASK[0] * MASK[1]).map(|index| {
            let first = index / MASK[0] * (MASK[0] + 1) + index % MASK[0];
            ![first, first + 1, first + MASK[0] + 1, first + MASK[0] + 2].iter().any(|at| corner[*at])
        });
        let (camera, references) = (sight.camera.clone(), sight.references.clone());
        Picture { camera, references, free: free.collect() }
    }

    /// Whether a place shows, on the table and at a height over it.
    fn shows_place(&self, camera_from_table: &Isometry3<f64>, [x, y]: [f64; 2], height: f64) -> bool {
        self.shows(&(camera_from_table * Point3::new(x, y, 0.0)))
            && self.shows(&(camera_from_table * Point3::new(x, y, height)))
    }

    fn shows_references(&self, camera_from_table: &Isometry3<f64>) -> bool {
        let shows = |marker: &&ReferenceMarker| {
            corners_m(marker.size).into_iter().all(|corner| {
                let [x, y] = marker.pose.transform(corner);
                self.shows(&(camera_from_table * Point3::new(x, y, 0.0)))
            })
        };
        self.references.iter().filter(shows).take(REFERENCES).count() == REFERENCES
    }

    /// Whether a point in the camera frame shows, with nothing of the gripper before it.
    fn shows(&self, in_camera: &Point3<f64>) -> bool {
        let camera = &self.camera;
        let Some(pixel) = camera.pixel([in_camera.x, in_camera.y, in_camera.z]) else { return false };
        let size = [camera.width, camera.height].map(f64::from);
        if (0..2).any(|axis| pixel[axis] < RIM_PX || pixel[axis] > size[axis] - RIM_PX) {
            return false;
        }
        let [column, row] = [0, 1]
            .map(|axis: usize| ((pixel[axis] / size[axis] * MASK[axis] as f64) as usize).min(MASK[axis] - 1));
        self.free[row * MASK[0] + column]
    }
}

/// Whether a line of sight, x and y at distance 1 along the optical axis, meets the gripper.
fn meets_gripper(own: &OwnBody, ray: [f64; 2]) -> bool {
    let body = OwnBody { radius_m: own.body_m + ROOM_M, beyond_m: ROOM_M, ..*own };
    let reach = own.camera_from_tool.translation.vector.norm() + own.radius_m;
    let at = |k: usize| {
        let z = reach * k as f64 / ALONG as f64;
        Point3::new(ray[0] * z, ray[1] * z, z)
    };
    (1..=ALONG).any(|k| body.contains(&at(k)))
}

/// Lowest and highest place of the camera over the table, m.
fn heights(model: &Rig, sight: &SightModel) -> (f64, f64) {
    let taught = model.look_poses.iter().map(|q| model.camera_at(q).translation.z).fold(0.0, f64::max);
    let large_enough = sight.camera.fx.min(sight.camera.fy) * sight.smallest_m / (8.0 * MODULE_PX);
    let (least, most) = HEIGHTS.iter().fold((f64::INFINITY, 0.0_f64), |(least, most), share| {
        (least.min(share * taught), most.max(share * taught))
    });
    // From the taught poses markers are detected, however small they are.
    (least, most.min(large_enough.max(taught)))
}

/// Places and turns of a camera that looks straight down on the table.
fn straight_down(table: [f64; 2], (least, most): (f64, f64)) -> impl Iterator<Item = Aim> {
    let along = |length: f64| {
        let count = ((length + 2.0 * BEYOND_M) / STEP_M).ceil().clamp(1.0, 40.0) as usize;
        (0..=count).map(move |k| -BEYOND_M + (length + 2.0 * BEYOND_M) * k as f64 / count as f64)
    };
    let lowest = HEIGHTS.iter().copied().fold(f64::INFINITY, f64::min);
    let mut levels = HEIGHTS.map(|share| (share * least / lowest).min(most)).to_vec();
    levels.dedup();
    let over = move |z: f64| along(table[0]).flat_map(move |x| along(table[1]).map(move |y| [x, y, z]));
    let turned = |[x, y, z]: [f64; 3]| {
        (0..TURNS).map(move |k| Aim([x, y, z, TAU * k as f64 / TURNS as f64, 0.0, 0.0]))
    };
    levels.into_iter().flat_map(over).flat_map(turned)
}

/// Joints that bring the camera there, in the posture of the work.
fn looking_along(model: &Rig, aim: &Aim) -> Option<Joints> {
    let flange_from_camera = model.mount.flange_from_camera()?;
    let tool = aim.table_from_camera() * flange_from_camera.inverse() * model.arm.flange_from_tool;
    model.arm.joints_in_work_posture(&tool, &model.arm.home)
}

#[cfg(test)]
mod tests {
    use super::*;
    use cell_motion::testing::{cycle, home, model};
    use cell_vision::cv;
    use rand::{RngExt, SeedableRng};
    use rearrange::geometry::pose::Pose2;

    const TABLE: [f64; 2] = [0.5, 0.5];

    fn sight() -> SightModel {
        let camera = CameraModel {
            serial: "test".into(),
            width: 1280,
            height: 720,
            fx: 650.0,
            fy: 652.0,
            cx: 645.0,
            cy: 356.0,
            distortion: [-0.05, 0.06, 4e-4, -3e-4, -0.01],
        };
        let places =
            [-0.045, 0.1667, 0.3333, 0.545].map(|at| [[at, -0.045], [at, 0.545], [-0.045, at], [0.545, at]]);
        let references = (500..).zip(places.into_iter().flatten());
        let references =
            references.map(|(id, [x, y])| ReferenceMarker { id, size: 0.03, pose: Pose2::new(x, y, 0.0) });
        let flange_from_camera = Isometry3::translation(0.0, -0.07, 0.03);
        let own = OwnBody {
            camera_from_tool: flange_from_camera.inverse() * Isometry3::translation(0.0, 0.0, 0.2),
            radius_m: 0.07,
            body_m: 0.05,
            beyond_m: 0.02,
        };
        let (references, smallest_m, own) = (references.collect(), 0.03, Some(own));
        SightModel { camera, references, smallest_m, own, views: Arc::default() }
    }

    fn mount() -> Mount {
        Mount::Flange { flange_from_camera: Isometry3::translation(0.0, -0.07, 0.03) }
    }

    /// Whether a place shows in a picture from `q`, by OpenCV's lens and points along the line of sight.
    fn really_shows(rig: &Rig, sight: &SightModel, q: &Joints, place: [f64; 3]) -> bool {
        let camera_from_table = rig.camera_at(q).inverse();
        let [[u, v]] = cv::project(&sight.camera, &camera_from_table, &[place]).unwrap()[..] else {
            panic!("one pixel")
        };
        let in_camera = camera_from_table * Point3::from(place);
        let own = sight.own.unwrap();
        let tool_from_camera = own.camera_from_tool.inverse();
        let hidden = (1..400).any(|k| {
            let p = tool_from_camera * (in_camera * (f64::from(k) / 400.0));
            p.z < 0.0 && p.x.hypot(p.y) < own.body_m
        });
        (0.0..1279.0).contains(&u) && (0.0..719.0).contains(&v) && !hidden
    }

    #[test]
    fn a_chosen_pose_shows_all_of_the_region_and_enough_reference_markers() {
        let (arm, cycle, mount, sight) = (model(0.5), cycle(), mount(), sight());
        let look_poses = [home(&arm, 0.5)];
        let rig = Rig { arm: &arm, mount: &mount, cycle: &cycle, look_poses: &look_poses, table: TABLE };
        let views = Views::new(&rig, &sight);
        assert!(views.len() > 100, "{}", views.len());
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let (mut once, mut twice) = (0, 0);
        for case in 0..12 {
            let mut place = || [random.random_range(0.05..0.45), random.random_range(0.05..0.45)];
            let discs = [place(), place(), place()];
            let mut region = Region::default();
            discs.iter().for_each(|disc| region.join(&Region::disc(*disc, 0.05)));
            let price = |way: &[Joints]| way.iter().map(|q| q.max_difference(&look_poses[0])).sum();
            let poses = views.covering(&rig, &region, &price, &|_| true).expect("a table that can be seen");
            match poses.len() {
                1 => once += 1,
                _ => twice += 1,
            }
            for disc in discs {
                for k in 0..16 {
                    let (sin, cos) = (TAU * f64::from(k) / 16.0).sin_cos();
                    let at = [disc[0] + 0.05 * cos, disc[1] + 0.05 * sin];
                    for height in [0.0, cycle.tallest] {
                        let shown = |q: &Joints| really_shows(&rig, &sight, q, [at[0], at[1], height]);
                        assert!(poses.iter().any(shown), "case {case}: {at:?}");
                    }
                }
            }
            for q in &poses {
                let whole = |marker: &&ReferenceMarker| {
                    corners_m(marker.size).iter().all(|corner| {
                        let [x, y] = marker.pose.transform(*corner);
                        really_shows(&rig, &sight, q, [x, y, 0.0])
                    })
                };
                let count = sight.references.iter().filter(whole).count();
                assert!(count >= REFERENCES, "case {case}: {count} reference markers");
            }
        }
        assert!(once > 8 && once + twice == 12, "{once} by one pose");
    }

    #[test]
    fn what_is_not_free_is_not_chosen_and_what_cannot_be_seen_has_no_pose() {
        let (arm, cycle, mount, sight) = (model(0.5), cycle(), mount(), sight());
        let look_poses = [home(&arm, 0.5)];
        let rig = Rig { arm: &arm, mount: &mount, cycle: &cycle, look_poses: &look_poses, table: TABLE };
        let views = Views::new(&rig, &sight);
        let region = Region::disc([0.25, 0.25], 0.05);
        assert!(views.covering(&rig, &region, &|_| 0.0, &|_| false).is_none());
        let left = |q: &Joints| rig.camera_at(q).translation.x < 0.25;
        let poses = views.covering(&rig, &region, &|_| 0.0, &left).unwrap();
        assert!(poses.iter().all(left));
        // A gripper that fills the picture hides everything.
        let own = sight.own.map(|own| OwnBody { body_m: 1.0, ..own });
        assert!(Views::new(&rig, &SightModel { own, ..sight }).is_empty());
    }
}
