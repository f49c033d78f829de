//! What viewers are shown, as JSON: the cell as it is drawn, the arm, the table as it was seen, the picture
//! with what is drawn over it.
//!
//! In: values of the rooms below. Out: plain values for `serde`. Lengths in m, angles in rad, frames as in
//! ARCHITECTURE.md; pixels of the picture, the centre of the first pixel at (0, 0). Pure.

use crate::config::cell::CellConfig;
use crate::daemon::carried::CarriedView;
use crate::daemon::last_picture::Kept;
use crate::daemon::plan_files::drawn_moves;
use crate::jobs::record::{GoalPose, PlanRecord};
use crate::report::colour;
use cell_machine::device::robot_types::RobotState;
use cell_motion::bodies::{Bodies, Part};
use cell_vision::camera::CameraModel;
use cell_vision::observe::Observation;
use nalgebra::{Isometry3, Point3};
use rearrange::geometry::footprint::Footprint;
use rearrange::geometry::pose::Pose2;
use serde::Serialize;

/// Corners of a curve as it is drawn.
const CORNERS: usize = 48;

/// Pieces of each edge over a picture: where it leaves the picture, and how a lens bends it.
const PIECES: u32 = 6;

/// An outline, closed by itself.
pub type Outline = Vec<[f64; 2]>;

/// The cell as it is drawn.
#[derive(Clone, Debug, Serialize)]
pub struct CellView {
    /// Name of the configuration's file.
    pub name: String,
    /// Width and depth of the table, m.
    pub table: [f64; 2],
    /// m.
    pub clearance: f64,
    /// Pose of the table in the base frame: translation, quaternion x, y, z, w.
    pub base_from_table: [f64; 7],
    /// The catalogue.
    pub objects: Vec<ObjectView>,
    /// Places that stay free, table frame.
    pub keep_out: Vec<Outline>,
    /// Number and pose of each reference marker, and its edge, m.
    pub references: Vec<ReferenceView>,
    /// Least approval of jobs.
    pub approval: &'static str,
    /// The devices are simulated.
    pub simulated: bool,
    /// The camera goes on giving pictures; that of a recording is used up by who watches.
    pub film: bool,
    /// What the arm and its surroundings are made of; empty before the robot is known.
    pub bodies: Vec<BodyView>,
}

/// An object of the catalogue.
#[derive(Clone, Debug, Serialize)]
pub struct ObjectView {
    /// Its name.
    pub id: String,
    /// Its colour everywhere, CSS.
    pub colour: String,
    /// In its own frame.
    pub outline: Outline,
    /// Where its label goes, own frame.
    pub centre: [f64; 2],
    /// m.
    pub height: f64,
    /// It never moves.
    pub fixed: bool,
    /// Where it stands, if it never moves.
    pub pose: Option<Pose2>,
    /// Interchangeable with the others of it.
    pub group: Option<String>,
    /// Number of its marker.
    pub marker: Option<u32>,
    /// Edge of the marker's black square, m.
    pub marker_size: Option<f64>,
}

/// A marker that is fixed to the table.
#[derive(Clone, Debug, Serialize)]
pub struct ReferenceView {
    /// Its number.
    pub id: u32,
    /// Table frame.
    pub pose: Pose2,
    /// Edge of its black square, m.
    pub size: f64,
}

/// A convex body: everything within `radius` of the hull of `points`.
#[derive(Clone, Debug, Serialize)]
pub struct BodyView {
    /// As a person calls it.
    pub name: String,
    /// `arm`, `tool`, `stand` or `equipment`.
    pub kind: &'static str,
    /// Which of the arm's frames it moves with; 0 is the base.
    pub frame: usize,
    /// In that frame, m.
    pub points: Vec<[f64; 3]>,
    /// m.
    pub radius: f64,
}

/// The arm.
#[derive(Clone, Debug, Serialize)]
pub struct ArmView {
    /// Joints, rad.
    pub q: [f64; 6],
    /// Poses of base, links and flange in the base frame: translation, quaternion; empty before the robot is
    /// known.
    pub frames: Vec<[f64; 7]>,
    /// Of the tool, m and rotation vector.
    pub tcp: [f64; 6],
    /// In words of the controller.
    pub robot_mode: String,
    /// In words of the controller.
    pub safety_mode: String,
    /// In words of the controller.
    pub program: String,
    /// Momentary speed, share of what was planned.
    pub speed: f64,
    /// kg.
    pub payload: f64,
    /// Accepts orders over the network.
    pub remote: Option<bool>,
    /// A person guides it by hand.
    pub guided: bool,
    /// What hangs on the gripper.
    pub carried: Option<CarriedView>,
}

/// The table as it was seen.
#[derive(Clone, Debug, Serialize)]
pub struct SightView {
    /// s since 1970.
    pub unix_s: f64,
    /// What lies where, with one standard deviation.
    pub objects: Vec<SeenView>,
    /// Not seen.
    pub missing: Vec<String>,
    /// Tilted or at a wrong height, and why.
    pub doubted: Vec<[String; 2]>,
    /// Markers that belong to nothing.
    pub unknown_markers: Vec<u32>,
    /// What carries no marker: outline, m.
    pub foreign: Vec<Outline>,
    /// Of the reference markers, mm.
    pub reference_residual_mm: Option<f64>,
    /// Objects that the arm has carried since, and where they are now.
    pub carried: Vec<CarriedView>,
}

/// One object as it was seen.
#[derive(Clone, Debug, Serialize)]
pub struct SeenView {
    /// Its name.
    pub id: String,
    /// Table frame.
    pub pose: Pose2,
    /// mm.
    pub std_mm: f64,
    /// Degrees.
    pub std_deg: f64,
}

/// What is drawn over the last picture, pixels.
#[derive(Clone, Debug, Default, Serialize)]
pub struct PictureView {
    /// Which picture.
    pub number: u64,
    /// When it came, s since 1970.
    pub unix_s: f64,
    /// Its size.
    pub width: u32,
    /// Its size.
    pub height: u32,
    /// Recognised objects.
    pub objects: Vec<MarkedView>,
    /// Where objects of the plan go.
    pub goals: Vec<MarkedView>,
    /// What carries no marker.
    pub foreign: Vec<Outline>,
    /// Numbered moves: from, to.
    pub moves: Vec<MoveView>,
}

/// An outline with its name.
#[derive(Clone, Debug, Serialize)]
pub struct MarkedView {
    /// Object.
    pub id: String,
    /// Pixels.
    pub outline: Outline,
}

/// A move over a picture.
#[derive(Clone, Debug, Serialize)]
pub struct MoveView {
    /// From 1.
    pub number: usize,
    /// Object.
    pub id: String,
    /// Pixels.
    pub from: [f64; 2],
    /// Pixels.
    pub to: [f64; 2],
}

/// The cell of a configuration; bodies once the robot is known.
pub fn cell_view(config: &CellConfig, name: &str, bodies: Option<&Bodies>) -> CellView {
    CellView {
        name: name.to_string(),
        table: [config.workspace.width_m, config.workspace.height_m],
        clearance: config.workspace.clearance_m,
        base_from_table: numbers(&config.base_from_table),
        objects: config.objects.iter().enumerate().map(object_view).collect(),
        keep_out: config.workspace.keep_out.iter().map(|k| placed(&k.footprint, &k.pose)).collect(),
        references: config
            .reference_markers
            .iter()
            .map(|marker| ReferenceView { id: marker.id, pose: marker.pose, size: marker.size_m })
            .collect(),
        approval: config.approval.as_str(),
        simulated: config.simulation.is_some(),
        film: !config.devices.camera.is_recording(),
        bodies: bodies.map(body_views).unwrap_or_default(),
    }
}

fn object_view((index, object): (usize, &rearrange::tabletop::instance::ObjectSpec)) -> ObjectView {
    ObjectView {
        id: object.id.clone(),
        colour: colour::of(index),
        outline: object.footprint.outline(CORNERS),
        centre: object.footprint.centroid(),
        height: object.height.unwrap_or(0.0),
        fixed: object.fixed,
        pose: object.start.filter(|_| object.fixed),
        group: object.group.clone(),
        marker: object.marker.as_ref().map(|marker| marker.id),
        marker_size: object.marker.as_ref().map(|marker| marker.size),
    }
}

fn body_views(bodies: &Bodies) -> Vec<BodyView> {
    let view = |body: &cell_motion::bodies::Body| {
        let kind = match body.part {
            Part::Link(_) => "arm",
            Part::Tool | Part::Cups => "tool",
            Part::Stand => "stand",
            Part::Equipment => "equipment",
            // Zones and what lies on the table are drawn from elsewhere.
            Part::Load
            | Part::Joint
            | Part::Table
            | Part::Plane
            | Part::Layer
            | Part::Rim
            | Part::CornerLayer
            | Part::CornerRim
            | Part::Standing
            | Part::Tall => return None,
        };
        let outline = body.shape.outline()?;
        let (name, frame) = (body.name.clone(), body.frame);
        Some(BodyView { name, kind, frame, points: outline.points, radius: outline.radius })
    };
    bodies.drawn().filter_map(view).collect()
}

/// The arm as its last state shows it.
pub fn arm_view(state: &RobotState, bodies: Option<&Bodies>) -> ArmView {
    let frames = bodies.map(|bodies| {
        let pose = |pose: parry3d_f64::math::Pose| {
            let (t, r) = (pose.translation, pose.rotation);
            [t.x, t.y, t.z, r.x, r.y, r.z, r.w].map(rounded)
        };
        bodies.frames(&state.q).map(pose).to_vec()
    });
    ArmView {
        q: state.q.0.map(rounded),
        frames: frames.unwrap_or_default(),
        tcp: state.tcp_pose.map(rounded),
        robot_mode: state.robot_mode.to_string(),
        safety_mode: state.safety_mode.to_string(),
        program: format!("{:?}", state.runtime_state).to_lowercase(),
        speed: rounded(state.speed_share()),
        payload: rounded(state.payload),
        remote: state.remote_control,
        guided: state.guided,
        carried: None,
    }
}

/// Ten micrometres are enough for a drawing, and half the bytes.
fn rounded(value: f64) -> f64 {
    (value * 1e5).round() / 1e5
}

fn numbers(pose: &Isometry3<f64>) -> [f64; 7] {
    let (t, r) = (pose.translation.vector, pose.rotation.coords);
    [t.x, t.y, t.z, r.x, r.y, r.z, r.w]
}

/// The table as it was seen at that time.
pub fn sight_view(seen: &Observation, unix_s: f64, carried: &[CarriedView]) -> SightView {
    SightView {
        unix_s,
        objects: seen
            .objects
            .iter()
            .map(|object| SeenView {
                id: object.id.clone(),
                pose: object.pose,
                std_mm: object.std_xy_m * 1e3,
                std_deg: object.std_theta_rad.to_degrees(),
            })
            .collect(),
        missing: seen.missing.clone(),
        doubted: seen.suspicious.iter().map(|object| [object.id.clone(), object.reason.clone()]).collect(),
        unknown_markers: seen.unknown.clone(),
        foreign: seen.foreign.iter().flat_map(|report| &report.objects).map(|o| o.outline.clone()).collect(),
        reference_residual_mm: seen.reference_residual_m.map(|residual| residual * 1e3),
        carried: carried.to_vec(),
    }
}

/// What the lens shows of the table from where a picture was taken.
struct Projection<'a> {
    lens: &'a CameraModel,
    camera_from_table: Isometry3<f64>,
}

impl Projection<'_> {
    fn point(&self, [x, y]: [f64; 2], height: f64) -> Option<[f64; 2]> {
        let point = self.camera_from_table * Point3::new(x, y, height);
        self.lens.pixel([point.x, point.y, point.z]).map(|pixel| pixel.map(|v| (v * 10.0).round() / 10.0))
    }

    /// What is seen of an outline, cut at the picture's rim; nothing where hardly any of it is in the
    /// picture.
    fn outline(&self, outline: &[[f64; 2]], pose: &Pose2, height: f64) -> Option<Outline> {
        let next = outline.iter().cycle().skip(1);
        let along = outline.iter().zip(next).flat_map(|(a, b)| {
            let part = move |k: u32| {
                let share = f64::from(k) / f64::from(PIECES);
                [a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])]
            };
            (0..PIECES).map(part)
        });
        let seen: Outline = along.filter_map(|at| self.point(pose.transform(at), height)).collect();
        (seen.len() > PIECES as usize).then_some(seen)
    }
}

/// What is drawn over a picture: objects as seen last, what carries no marker, the plan and its goals.
pub fn picture_view(
    number: u64,
    picture: &Kept,
    lens: &CameraModel,
    config: &CellConfig,
    seen: Option<&Observation>,
    plan: Option<&PlanRecord>,
) -> PictureView {
    let (width, height, unix_s) = (picture.image.width, picture.image.height, picture.unix_s);
    let Some(table_from_camera) = picture.table_from_camera else {
        return PictureView { number, unix_s, width, height, ..PictureView::default() };
    };
    let projection = Projection { lens, camera_from_table: table_from_camera.inverse() };
    let spec = |id: &str| config.objects.iter().find(|object| object.id == id);
    let marked = |id: &str, pose: &Pose2| {
        let object = spec(id)?;
        let outline = object.footprint.outline(CORNERS);
        let outline = projection.outline(&outline, pose, object.height.unwrap_or(0.0))?;
        Some(MarkedView { id: id.to_string(), outline })
    };
    let moves = plan.map(|plan| drawn_moves(plan, config)).unwrap_or_default();
    let steps = plan.map(|plan| plan.steps.as_slice()).unwrap_or_default();
    let flat = Pose2::default();
    let foreign = seen.and_then(|seen| seen.foreign.as_ref()).map(|report| report.objects.as_slice());
    PictureView {
        number,
        unix_s,
        width,
        height,
        objects: seen.iter().flat_map(|seen| &seen.objects).filter_map(|o| marked(&o.id, &o.pose)).collect(),
        goals: steps.iter().filter_map(|step| marked(&step.object, &step.to)).collect(),
        foreign: foreign
            .unwrap_or_default()
            .iter()
            .filter_map(|thing| projection.outline(&thing.outline, &flat, 0.0))
            .collect(),
        moves: moves
            .iter()
            .filter_map(|step| {
                let [from, to] =
                    [step.from, step.to].map(|pose| projection.point([pose.x, pose.y], step.height_m));
                let id = steps.get(step.number - 1)?.object.clone();
                Some(MoveView { number: step.number, id, from: from?, to: to? })
            })
            .collect(),
    }
}

fn placed(footprint: &Footprint, pose: &Pose2) -> Outline {
    footprint.outline(CORNERS).iter().map(|corner| pose.transform(*corner)).collect()
}

/// Poses by name as they are drawn.
pub fn poses(list: &[(String, Pose2)]) -> Vec<GoalPose> {
    crate::daemon::plan_files::poses(list)
}
