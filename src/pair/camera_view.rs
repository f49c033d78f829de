//! What the cell sees in the closed loop: rendered pictures with the real detector, or marker corners for
//! volume.
//!
//! In: look requests, the simulated world, the time. Out: views after exposure, transfer and detection have
//! taken their time. Pictures go through the same [`Perception`] as on a real cell. Corners are projected by
//! the simulator's own lens, with the noise that the benchmark of the detector measured; they miss what only
//! a picture has: a marker half hidden by the gripper, light, depth. A test compares both on the same
//! tables.

use crate::pair::stage::Stage;
use crate::perception::{Perception, Picture, Scene, observe_views};
use cell_machine::code::Code;
use cell_machine::event::Event;
use cell_machine::supervisor::input::CameraFault;
use cell_values::image::depth::DepthImage;
use cell_values::image::quality::{PictureLimits, judge, measure};
use cell_values::image::{Image, tag36h11_bitmap};
use cell_values::time::Timestamp;
use cell_vision::detect::{DetectSettings, Detection, Family};
use cell_vision::foreign::HeldBody;
use cell_vision::observe::{Observation, PartialLook, View};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use ur_sim::camera::{CameraSetup, Moment, Window};
use ur_sim::render::Renderer;
use ur_sim::render::scene::{Cells, Print};
use ur_sim::world::World;

/// Standard deviation of a marker corner along each axis, px: what the detector leaves on rendered pictures.
const CORNER_STD_PX: f64 = 0.06;

/// A marker counts as seen when all of it is this far inside the picture, px.
const MARGIN_PX: f64 = 3.0;

/// Largest camera motion in an exposure, m and rad: about a pixel at 0.4 m.
const MAX_EXPOSURE_TRAVEL_M: f64 = 5e-4;
const MAX_EXPOSURE_TURN_RAD: f64 = 1.5e-3;

/// Seconds of detection a frame, from and to.
const DETECTION_S: (f64, f64) = (0.03, 0.06);

/// After so long a camera that does not answer is given up by its supervisor, s.
const GIVEN_UP_AFTER_S: f64 = 3.0;

/// How the cell sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SightKind {
    /// Rendered pictures and the real detector.
    Pictures,
    /// Corners with noise.
    Corners,
}

enum Sight {
    Pictures(Box<(Renderer, Perception)>),
    Corners(Box<(Scene, BTreeMap<Cells, u32>)>),
}

/// A request under way.
struct Task {
    number: u64,
    window: Window,
    wanted: Wanted,
}

enum Wanted {
    Look(Look),
    Picture { pose: usize, base_from_flange: Isometry3<f64> },
}

struct Look {
    left: usize,
    table_from_camera: Isometry3<f64>,
    views: Vec<View>,
}

/// A picture of a calibration round.
pub struct RoundPicture {
    /// Number of the pose, from 1.
    pub pose: usize,
    /// Where the flange was, by the robot's word.
    pub base_from_flange: Isometry3<f64>,
    /// `None` where corners are all that is seen.
    pub image: Option<Image>,
}

/// Camera and perception. See the module.
pub struct CameraView {
    setup: CameraSetup,
    sight: Sight,
    rng: ChaCha8Rng,
    frames: u64,
    task: Option<Task>,
    flipped: bool,
    depth: bool,
    pictures: Vec<RoundPicture>,
}

/// The answer to a request, and how many seconds the cell waits for it still.
pub struct Seen {
    /// At once: the frames are exposed.
    pub exposed: Option<Event>,
    /// For the machine.
    pub event: Event,
    /// Seconds.
    pub evaluation_s: f64,
}

impl CameraView {
    /// Eyes of this kind for a stage.
    ///
    /// # Errors
    /// The detector cannot be made.
    pub fn new(eye: SightKind, stage: &Stage, seed: u64) -> Result<CameraView, String> {
        let (setup, scene) = (stage.camera.clone(), stage.scene.clone());
        let sight = match eye {
            SightKind::Pictures => {
                let renderer = Renderer::new(setup.truth.clone());
                let perception =
                    Perception::new(scene, DetectSettings::default()).map_err(|error| error.to_string())?;
                Sight::Pictures(Box::new((renderer, perception)))
            }
            SightKind::Corners => {
                let numbers = (0..587).filter_map(|id| tag36h11_bitmap(id).map(|cells| (cells, id)));
                Sight::Corners(Box::new((scene, numbers.collect())))
            }
        };
        let rng = ChaCha8Rng::seed_from_u64(seed ^ 0x6579_6573);
        let (depth, pictures) = (stage.depth, Vec::new());
        Ok(CameraView { setup, sight, rng, frames: 0, task: None, flipped: false, depth, pictures })
    }

    /// Takes `frames` frames from now on; a look that was under way is forgotten.
    pub fn look(&mut self, now_s: f64, number: u64, frames: usize, table_from_camera: Isometry3<f64>) {
        let window = self.setup.timing.window(now_s);
        let wanted = Wanted::Look(Look { left: frames, table_from_camera, views: Vec::new() });
        self.task = Some(Task { number, window, wanted });
    }

    /// Takes one picture of a calibration round.
    pub fn picture(&mut self, now_s: f64, number: u64, pose: usize, base_from_flange: Isometry3<f64>) {
        let window = self.setup.timing.window(now_s);
        self.task = Some(Task { number, window, wanted: Wanted::Picture { pose, base_from_flange } });
    }

    /// The pictures of calibration rounds so far, oldest first.
    pub fn pictures(&self) -> &[RoundPicture] {
        &self.pictures
    }

    /// From now on corners are swayed so that the other pose that a flat marker could have fits them better:
    /// the one tilted to the other side of the line of sight. Pictures have no such switch.
    pub fn flip(&mut self, flipped: bool) {
        self.flipped = flipped;
    }

    /// Forgets the look under way: its requester is gone.
    pub fn forget(&mut self) {
        self.task = None;
    }

    /// One frame of time.
    pub fn step(&mut self, world: &World, now_s: f64) -> Option<Seen> {
        let task = self.task.take_if(|task| now_s >= task.window.ready_s)?;
        let faults = world.camera_faults();
        let fault = match (faults.off, faults.frozen, faults.repeats) {
            (true, ..) => Some(Code::CameraUnplugged),
            (_, true, _) => Some(Code::CameraFrozen),
            (.., true) => Some(Code::CameraRepeats),
            _ => None,
        };
        self.frames += 1;
        let moment = world.moment(&self.setup, &task.window);
        match task.wanted {
            Wanted::Picture { pose, base_from_flange } => {
                let image = match &self.sight {
                    Sight::Pictures(sight) => Some(moment.picture(&sight.0, self.frames)),
                    Sight::Corners(_) => None,
                };
                let fault = fault.or_else(|| image.as_ref().and_then(|image| usable(image).err()));
                let evaluation_s = if fault.is_some() { GIVEN_UP_AFTER_S } else { 0.0 };
                let result = fault.map_or(Ok(()), |code| Err(camera_fault(code)));
                if result.is_ok() {
                    self.pictures.push(RoundPicture { pose, base_from_flange, image });
                }
                Some(Seen { exposed: None, event: Event::Pictured(task.number, result), evaluation_s })
            }
            Wanted::Look(look) => {
                let seen = match fault {
                    Some(code) => Err(code),
                    None => self.see(&moment, &look, Timestamp::from_secs_f64(now_s)),
                };
                self.looked(task.number, look, seen, now_s)
            }
        }
    }

    fn see(&mut self, moment: &Moment, look: &Look, time: Timestamp) -> Result<View, Code> {
        match &mut self.sight {
            Sight::Pictures(sight) => {
                let (renderer, perception) = &mut **sight;
                let image = moment.picture(renderer, self.frames);
                usable(&image)?;
                let last = look.left <= 1;
                let depth = self.depth && last && perception.wants_depth();
                let depth = depth.then(|| moment.depth(renderer, self.frames)).and_then(|depth| {
                    let metres = depth.units.iter().map(|unit| f32::from(*unit) * 1e-4).collect();
                    DepthImage::from_metres(depth.width, depth.height, metres).ok()
                });
                let picture = Picture { image: &image, depth: depth.as_ref() };
                let view = perception.view(picture, look.table_from_camera, time, look.views.last(), last);
                view.map_err(|_| Code::DetectionFailed)
            }
            Sight::Corners(sight) => {
                see_corners(&sight.1, &self.setup, moment, self.flipped, &mut self.rng).map(|detections| {
                    View { table_from_camera: look.table_from_camera, detections, time, heights: None }
                })
            }
        }
    }

    /// A frame of a look is evaluated: the answer, or the next frame.
    fn looked(&mut self, number: u64, look: Look, seen: Result<View, Code>, now_s: f64) -> Option<Seen> {
        let (from, to) = DETECTION_S;
        let mut evaluation_s = self.rng.random_range(from..to);
        let Look { left, table_from_camera, mut views } = look;
        let result = match seen {
            Err(code) => {
                evaluation_s = GIVEN_UP_AFTER_S;
                Err(camera_fault(code))
            }
            Ok(view) => {
                views.push(view);
                if left > 1 {
                    let wanted = Wanted::Look(Look { left: left - 1, table_from_camera, views });
                    self.task = Some(Task { number, window: self.setup.timing.window(now_s), wanted });
                    return None;
                }
                Ok(views)
            }
        };
        let exposed = result.is_ok().then_some(Event::Exposed(number));
        Some(Seen { exposed, event: Event::Looked(number, result), evaluation_s })
    }

    /// The views of a look put together.
    ///
    /// # Errors
    /// What keeps them from fitting together.
    pub fn observe(
        &mut self,
        views: &[View],
        partial: Option<&PartialLook>,
        held: Option<&HeldBody>,
    ) -> Result<Box<Observation>, String> {
        let seen = match &mut self.sight {
            Sight::Pictures(sight) => sight.1.observe_holding(views, partial, held),
            Sight::Corners(sight) => observe_views(&sight.0, views, partial),
        };
        seen.map(Box::new).map_err(|error| error.to_string())
    }
}

fn camera_fault(code: Code) -> CameraFault {
    CameraFault {
        code,
        message: code.meaning().to_string(),
        hint: "look at the camera".into(),
        lasting: false,
    }
}

/// What keeps a picture from being looked at.
fn usable(image: &Image) -> Result<(), Code> {
    judge(&measure(&image.gray()), &PictureLimits::STANDARD).map_err(|fault| Code::of_picture(&fault))
}

/// The camera moves by more than about a pixel in an exposure.
fn moves(places: &[Isometry3<f64>]) -> bool {
    let (Some(first), Some(last)) = (places.first(), places.last()) else { return false };
    let way = (first.translation.vector - last.translation.vector).norm();
    way > MAX_EXPOSURE_TRAVEL_M || first.rotation.angle_to(&last.rotation) > MAX_EXPOSURE_TURN_RAD
}

/// Markers by their corners, as an undisturbed detector would find them.
fn see_corners(
    numbers: &BTreeMap<Cells, u32>,
    setup: &CameraSetup,
    moment: &Moment,
    flipped: bool,
    rng: &mut ChaCha8Rng,
) -> Result<Vec<Detection>, Code> {
    let exposure = moment.exposure();
    if exposure.gain < 0.15 {
        return Err(Code::CameraDark);
    } else if exposure.gain > 4.0 {
        return Err(Code::CameraOverexposed);
    } else if exposure.fog > 0.9 {
        return Err(Code::CameraSeesNothing);
    } else if exposure.blur_px > 6.0 || moves(moment.places()) {
        return Err(Code::CameraBlurred);
    }
    let Some(table_from_camera) = moment.places().get(moment.places().len() / 2) else {
        return Ok(Vec::new());
    };
    let camera_from_table = table_from_camera.inverse();
    let scene = moment.scene();
    let on_table = scene.prints.iter().map(|print| (print, Isometry3::identity()));
    let on_objects = scene.prisms.iter().flat_map(|prism| {
        let top = prism.table_from_prism * Isometry3::translation(0.0, 0.0, prism.height_m);
        prism.prints.iter().map(move |print| (print, top))
    });
    let mut found = Vec::new();
    for (print, table_from_plane) in on_table.chain(on_objects) {
        let Some(id) = numbers.get(&print.cells) else { continue };
        let corners = corners_px(setup, &(camera_from_table * table_from_plane), print, flipped, rng);
        found.extend(corners.map(|corners| Detection {
            family: Family::Tag36h11.name().to_string(),
            id: *id,
            corners,
            decision_margin: 60.0,
            hamming: 0,
        }));
    }
    Ok(found)
}

/// Corners of a print in the picture, with noise; `None` when some of it is outside.
fn corners_px(
    setup: &CameraSetup,
    camera_from_plane: &Isometry3<f64>,
    print: &Print,
    flipped: bool,
    rng: &mut ChaCha8Rng,
) -> Option<[[f64; 2]; 4]> {
    let half = print.size_m / 2.0;
    let [x, y] = print.pose.transform([0.0, 0.0]);
    let flip =
        if flipped { other_tilt(camera_from_plane, Point3::new(x, y, 0.0)) } else { Isometry3::identity() };
    let mut corners = [[0.0; 2]; 4];
    for (corner, [x, y]) in
        corners.iter_mut().zip([[-half, -half], [half, -half], [half, half], [-half, half]])
    {
        let [x, y] = print.pose.transform([x, y]);
        let at = camera_from_plane * Point3::new(x, y, 0.0);
        let other = flip * at;
        let truly = setup.truth.project([at.x, at.y, at.z])?;
        let other = setup.truth.project([other.x, other.y, other.z])?;
        let [u, v]: [f64; 2] = std::array::from_fn(|axis| truly[axis] + SWAYED * (other[axis] - truly[axis]));
        let (width, height) = (f64::from(setup.truth.width), f64::from(setup.truth.height));
        if u < MARGIN_PX || v < MARGIN_PX || u > width - MARGIN_PX || v > height - MARGIN_PX {
            return None;
        }
        *corner = [u + CORNER_STD_PX * normal(rng), v + CORNER_STD_PX * normal(rng)];
    }
    Some(corners)
}

/// How far corners are from those of the true pose towards those of the other, when the other shall fit
/// better.
const SWAYED: f64 = 0.55;

/// Turns a plane about a point of it to the other side of the line of sight: the second pose with which a
/// flat marker gives nearly the same corners.
fn other_tilt(camera_from_plane: &Isometry3<f64>, centre: Point3<f64>) -> Isometry3<f64> {
    let centre = camera_from_plane * centre;
    let normal = camera_from_plane.rotation * Vector3::z();
    let sight = -centre.coords.normalize();
    let turn = UnitQuaternion::rotation_between(&normal, &sight).unwrap_or_default();
    Isometry3::from_parts(centre.coords.into(), turn * turn) * Translation3::from(-centre.coords)
}

/// The sum of twelve uniform numbers is normal enough and needs no further crate.
fn normal(rng: &mut ChaCha8Rng) -> f64 {
    (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0
}
