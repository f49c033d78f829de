//! What a recording shows of the cell, as Foxglove's messages.
//!
//! In: the cell's model and lens, observations, what hangs on the gripper, goals, plans, joints. Out: frames
//! (`base`, `table`, the links, `flange`, `camera`, and `picture`, where the last one was taken), a scene
//! (table, bodies, objects with outline and height, goals, plan, foreign things), the lens, joint states.
//! Lengths in m, angles in rad; frames as in ARCHITECTURE.md. What is drawn is kept, so that each file
//! begins with all of it. Pure.

use crate::daemon::carried::{Carried, merged};
use crate::report::colour;
use cell_calibration::files::hand_eye::Mount;
use cell_machine::supervisor::model::CellModel;
use cell_machine::supervisor::order::RouteAction;
use cell_motion::bodies::shape::Outline;
use cell_motion::bodies::{Part, TOOL_FRAME};
use cell_motion::put_down::Grasp;
use cell_values::units::Joints;
use cell_vision::camera::CameraModel;
use cell_vision::observe::Observation;
use foxglove::messages::line_primitive::Type as LineType;
use foxglove::messages::{
    ArrowPrimitive, CameraCalibration, Color, CubePrimitive, CylinderPrimitive, FrameTransform,
    FrameTransforms, JointState, JointStates, LinePrimitive, Point3, Pose, Quaternion, SceneEntity,
    SceneEntityDeletion, SceneUpdate, SpherePrimitive, TextPrimitive, Timestamp, TriangleListPrimitive,
    Vector3,
};
use nalgebra::{Isometry3, Translation3, UnitQuaternion};
use parry3d_f64::math::Vector;
use parry3d_f64::transformation::try_convex_hull;
use rearrange::geometry::footprint::Footprint;
use rearrange::geometry::pose::Pose2;
use std::collections::{BTreeMap, BTreeSet};

/// Corners by which round outlines are drawn.
const CORNERS: usize = 32;

/// Thickness of the drawn table top, m.
const TABLE_M: f64 = 0.01;

/// What has no known height is drawn so high, m.
const UNKNOWN_HEIGHT_M: f64 = 0.03;

/// Names of the joints, as UR's own tools give them.
const JOINT_NAMES: [&str; 6] = [
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
];

/// See the module.
#[derive(Default)]
pub struct Drawing {
    cell: Option<Box<CellModel>>,
    lens: Option<CameraModel>,
    seen: Option<Observation>,
    carried: Carried,
    /// The arm's joints as they were last.
    q: Option<Joints>,
    /// What hangs on the gripper, and the table in the flange's frame when it was gripped.
    gripped: Option<(String, Isometry3<f64>)>,
    /// Objects that are drawn in the present file.
    drawn: BTreeSet<String>,
    goals: Vec<(String, Pose2)>,
    route: Vec<RouteAction>,
}

impl Drawing {
    /// A drawing for the pictures of this lens.
    pub fn new(lens: Option<CameraModel>) -> Drawing {
        Drawing { lens, ..Drawing::default() }
    }

    /// From now on this is the cell.
    pub fn cell(&mut self, cell: Box<CellModel>) {
        self.cell = Some(cell);
    }

    /// The lens, for the picture's topic; its frame is that of the picture.
    pub fn calibration(&self, now: Timestamp) -> Option<CameraCalibration> {
        let lens = self.lens.as_ref()?;
        let (fx, fy, cx, cy) = (lens.fx, lens.fy, lens.cx, lens.cy);
        Some(CameraCalibration {
            timestamp: Some(now),
            frame_id: "picture".to_string(),
            width: lens.width,
            height: lens.height,
            distortion_model: "plumb_bob".to_string(),
            d: lens.distortion.to_vec(),
            k: vec![fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
            r: vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            p: vec![fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
        })
    }

    /// Frames that stay: the table and the camera.
    pub fn fixed_frames(&self, now: Timestamp) -> Option<FrameTransforms> {
        let cell = self.cell.as_ref()?;
        let camera = match &cell.mount {
            Mount::Flange { flange_from_camera } => frame(now, "flange", "camera", flange_from_camera),
            Mount::Fixed { base_from_camera } => frame(now, "base", "camera", base_from_camera),
        };
        Some(FrameTransforms {
            transforms: vec![frame(now, "base", "table", &cell.arm.base_from_table), camera],
        })
    }

    /// Where the last picture was taken; without a place, where the camera is now.
    pub fn picture_frame(
        &self,
        now: Timestamp,
        table_from_camera: Option<Isometry3<f64>>,
    ) -> Option<FrameTransforms> {
        let here = || {
            let (cell, q) = (self.cell.as_ref()?, self.q.as_ref()?);
            let base_from_camera = match &cell.mount {
                Mount::Flange { flange_from_camera } => {
                    cell.arm.kinematics.chain().frames(q)[5] * flange_from_camera
                }
                Mount::Fixed { base_from_camera } => *base_from_camera,
            };
            Some(cell.arm.base_from_table.inverse() * base_from_camera)
        };
        let at = table_from_camera.or_else(here)?;
        Some(FrameTransforms { transforms: vec![frame(now, "table", "picture", &at)] })
    }

    /// Frames of the links with the joints at `q`.
    pub fn moving_frames(&self, now: Timestamp, q: &Joints) -> Option<FrameTransforms> {
        let cell = self.cell.as_ref()?;
        let links = cell.arm.kinematics.chain().placed(q).bodies;
        let names = (1..).map(|link| format!("link_{link}"));
        let mut transforms: Vec<_> =
            links.iter().zip(names).map(|(at, name)| frame(now, "base", &name, at)).collect();
        transforms.push(frame(now, "base", "flange", &links[5]));
        Some(FrameTransforms { transforms })
    }

    /// The table and what stands round it; links move with their frames.
    pub fn surroundings(&mut self, now: Timestamp) -> Option<SceneUpdate> {
        // A new file: nothing of the one before has to be deleted in it.
        self.drawn.clear();
        let cell = self.cell.as_ref()?;
        let (width, height) = (cell.workspace.width, cell.workspace.height);
        let table = CubePrimitive {
            pose: Some(pose(&Isometry3::translation(0.5 * width, 0.5 * height, -0.5 * TABLE_M))),
            size: Some(Vector3 { x: width, y: height, z: TABLE_M }),
            color: Some(GREY),
        };
        let mut entities = vec![SceneEntity { cubes: vec![table], ..entity(now, "table", "table") }];
        for (number, body) in cell.arm.bodies.drawn().enumerate() {
            let drawn =
                matches!(body.part, Part::Link(_) | Part::Tool | Part::Cups | Part::Stand | Part::Equipment);
            let Some(outline) = body.shape.outline().filter(|_| drawn) else { continue };
            let in_frame = match body.frame {
                0 => "base".to_string(),
                TOOL_FRAME => "flange".to_string(),
                link => format!("link_{link}"),
            };
            let id = format!("body/{number}/{}", body.name);
            entities.push(SceneEntity { frame_locked: true, ..solid(&outline, entity(now, &in_frame, &id)) });
        }
        Some(SceneUpdate { entities, deletions: Vec::new() })
    }

    /// The table was looked at, or (`partial`) a part of it.
    pub fn observed(&mut self, seen: &Observation, partial: bool) {
        self.carried.seen(seen, partial);
        let before = self.seen.take().filter(|_| partial);
        self.seen = Some(merged(seen.clone(), before.as_ref()));
    }

    /// The arm's joints.
    pub fn joints(&mut self, q: &Joints) {
        self.q = Some(*q);
        if let Some(cell) = &self.cell {
            self.carried.arm(&cell.arm, q);
        }
    }

    /// What hangs on the gripper, and how; true if that is something else than before.
    pub fn hangs(&mut self, object: Option<(&str, Option<&Grasp>)>) -> bool {
        let changed = self.carried.hangs(object);
        if changed {
            self.gripped = None;
            if let (Some(cell), Some(q)) = (&self.cell, &self.q) {
                self.carried.arm(&cell.arm, q);
                let base_from_flange = cell.arm.kinematics.chain().frames(q)[5];
                let flange_from_table = base_from_flange.inverse() * cell.arm.base_from_table;
                self.gripped = self.carried.held().map(|held| (held.id.clone(), flange_from_table));
            }
        }
        changed
    }

    /// All objects as far as is known, with outline, height and name: as they were seen, or where the arm
    /// has them or put them since; and what carries no marker. What was drawn and is not known is deleted.
    pub fn objects(&mut self, now: Timestamp) -> SceneUpdate {
        let seen = self.seen.iter().flat_map(|seen| &seen.objects);
        let mut poses: BTreeMap<&str, Pose2> = seen.map(|object| (object.id.as_str(), object.pose)).collect();
        for object in self.carried.objects() {
            // What fell, or was taken, may be anywhere.
            match object.lost {
                true => poses.remove(object.id.as_str()),
                false => poses.insert(&object.id, object.pose),
            };
        }
        let block = |(id, at): (&&str, &Pose2)| Some(self.block(now, id, &self.looks(id)?, at));
        let mut entities: Vec<SceneEntity> = poses.iter().filter_map(block).collect();
        let strangers = self.seen.iter().filter_map(|seen| seen.foreign.as_ref());
        let outlines = strangers.flat_map(|report| &report.objects).map(|stranger| {
            let height = if stranger.height_m.is_finite() { stranger.height_m } else { UNKNOWN_HEIGHT_M };
            let corners = stranger.outline.iter().map(|[x, y]| Point3 { x: *x, y: *y, z: height });
            LinePrimitive { color: Some(RED), ..line(corners.collect(), LineType::LineLoop) }
        });
        entities.push(SceneEntity { lines: outlines.collect(), ..entity(now, "table", "foreign") });
        let known: BTreeSet<String> = poses.keys().map(|id| (*id).to_string()).collect();
        let gone = self.drawn.difference(&known);
        let deletions = gone.map(|id| deletion(now, object_id(id))).collect();
        self.drawn = known;
        SceneUpdate { entities, deletions }
    }

    /// The goals of the job; none without one.
    pub fn goals(&mut self, goals: Vec<(String, Pose2)>) {
        self.goals = goals;
    }

    /// Outlines of the goals.
    pub fn goal_lines(&self, now: Timestamp) -> SceneUpdate {
        let lines = self.goals.iter().filter_map(|(id, at)| {
            let Looks { footprint, colour, .. } = self.looks(id)?;
            let points = ring(footprint, at, 0.001);
            Some(LinePrimitive { color: Some(colour), ..line(points, LineType::LineLoop) })
        });
        let goals = SceneEntity { lines: lines.collect(), ..entity(now, "table", "goals") };
        SceneUpdate { entities: vec![goals], deletions: Vec::new() }
    }

    /// What is left of the plan.
    pub fn route(&mut self, route: Vec<RouteAction>) {
        self.route = route;
    }

    /// An arrow for each move, with its number.
    pub fn route_arrows(&self, now: Timestamp) -> SceneUpdate {
        let mut plan = entity(now, "table", "plan");
        for (number, step) in self.route.iter().enumerate() {
            let Some(Looks { footprint, height, colour }) = self.looks(&step.object) else { continue };
            let middle = footprint.centroid();
            let ([x, y], [to_x, to_y]) = (step.from.transform(middle), step.to.transform(middle));
            let length = (to_x - x).hypot(to_y - y);
            let turn = UnitQuaternion::from_euler_angles(0.0, 0.0, (to_y - y).atan2(to_x - x));
            let at = Isometry3::from_parts(Translation3::new(x, y, height + 0.01), turn);
            let head = 0.02_f64.min(0.5 * length);
            plan.arrows.push(ArrowPrimitive {
                pose: Some(pose(&at)),
                shaft_length: length - head,
                shaft_diameter: 0.004,
                head_length: head,
                head_diameter: 0.012,
                color: Some(colour),
            });
            let at = Isometry3::translation(to_x, to_y, height + 0.03);
            plan.texts.push(text(&at, format!("{}", number + 1)));
        }
        SceneUpdate { entities: vec![plan], deletions: Vec::new() }
    }

    /// How an object of the catalogue looks.
    fn looks(&self, id: &str) -> Option<Looks<'_>> {
        let objects = &self.cell.as_ref()?.objects;
        let index = objects.iter().position(|object| object.id == id)?;
        let [r, g, b] = colour::rgb(index);
        let colour = Color { r, g, b, a: 1.0 };
        Some(Looks { footprint: &objects[index].footprint, height: objects[index].height, colour })
    }

    /// An object on the table, or with the flange where it hangs.
    fn block(&self, now: Timestamp, id: &str, looks: &Looks, at: &Pose2) -> SceneEntity {
        let Looks { footprint, height, colour } = *looks;
        let (low, high) = (ring(footprint, at, 0.0), ring(footprint, at, height));
        let count = low.len();
        // Sides alone: the outline on top closes it for the eye, also where it is not convex.
        let side = |i: usize| {
            [low[i], low[(i + 1) % count], high[(i + 1) % count], low[i], high[(i + 1) % count], high[i]]
        };
        let hanging = self.gripped.as_ref().filter(|(gripped, _)| gripped == id);
        let (in_frame, from_table) = match hanging {
            Some((_, flange_from_table)) => ("flange", *flange_from_table),
            None => ("table", Isometry3::identity()),
        };
        let sides = TriangleListPrimitive {
            pose: Some(pose(&from_table)),
            points: (0..count).flat_map(side).collect(),
            color: Some(colour),
            ..TriangleListPrimitive::default()
        };
        let [x, y] = at.transform(footprint.centroid());
        let label = text(&(from_table * Isometry3::translation(x, y, height + 0.01)), id.to_string());
        let rim = line(high.clone(), LineType::LineLoop);
        let rim = LinePrimitive { color: Some(colour), pose: Some(pose(&from_table)), ..rim };
        SceneEntity {
            triangles: vec![sides],
            lines: vec![rim],
            texts: vec![label],
            frame_locked: true,
            ..entity(now, in_frame, &object_id(id))
        }
    }
}

/// How an object looks: outline, height (m), colour.
struct Looks<'a> {
    footprint: &'a Footprint,
    height: f64,
    colour: Color,
}

/// Everything within a radius of some points, as one can see it: a ball, a capsule, or the convex hull of
/// the points and of those that lie the radius beside them.
fn solid(outline: &Outline, entity: SceneEntity) -> SceneEntity {
    let radius = outline.radius.max(0.0025);
    let ball = |[x, y, z]: &[f64; 3]| SpherePrimitive {
        pose: Some(pose(&Isometry3::translation(*x, *y, *z))),
        size: Some(Vector3 { x: 2.0 * radius, y: 2.0 * radius, z: 2.0 * radius }),
        color: Some(GREY),
    };
    if outline.points.len() <= 2 {
        let spheres = outline.points.iter().map(ball).collect();
        let cylinders = outline.points.windows(2).map(|ends| between(&ends[0], &ends[1], radius)).collect();
        return SceneEntity { spheres, cylinders, ..entity };
    }
    let beside = |[x, y, z]: &[f64; 3]| {
        let at = |dx: f64, dy: f64, dz: f64| Vector::new(x + dx, y + dy, z + dz);
        let r = outline.radius;
        [
            at(r, 0.0, 0.0),
            at(-r, 0.0, 0.0),
            at(0.0, r, 0.0),
            at(0.0, -r, 0.0),
            at(0.0, 0.0, r),
            at(0.0, 0.0, -r),
        ]
    };
    let points: Vec<Vector> = outline.points.iter().flat_map(beside).collect();
    let Ok((corners, faces)) = try_convex_hull(&points) else {
        // Flat, or a line: its edges show where it is.
        let points = outline.points.iter().map(|[x, y, z]| Point3 { x: *x, y: *y, z: *z }).collect();
        let edges = line(points, LineType::LineLoop);
        return SceneEntity { lines: vec![LinePrimitive { color: Some(GREY), ..edges }], ..entity };
    };
    let corner = |index: &u32| corners.get(*index as usize).map(|at| Point3 { x: at.x, y: at.y, z: at.z });
    let hull = TriangleListPrimitive {
        pose: Some(pose(&Isometry3::identity())),
        points: faces.iter().flatten().filter_map(corner).collect(),
        color: Some(GREY),
        ..TriangleListPrimitive::default()
    };
    SceneEntity { triangles: vec![hull], ..entity }
}

/// The cylinder from one point to another.
fn between(a: &[f64; 3], b: &[f64; 3], radius: f64) -> CylinderPrimitive {
    let [a, b] = [a, b].map(|[x, y, z]| nalgebra::Vector3::new(*x, *y, *z));
    let along = b - a;
    // Against the z axis any half turn will do.
    let turn = UnitQuaternion::rotation_between(&nalgebra::Vector3::z(), &along)
        .unwrap_or_else(|| UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.0, 0.0));
    CylinderPrimitive {
        pose: Some(pose(&Isometry3::from_parts(Translation3::from(0.5 * (a + b)), turn))),
        size: Some(Vector3 { x: 2.0 * radius, y: 2.0 * radius, z: along.norm() }),
        bottom_scale: 1.0,
        top_scale: 1.0,
        color: Some(GREY),
    }
}

/// Joint positions, rad, and speeds, rad/s.
pub fn joint_states(now: Timestamp, q: &Joints, qd: &[f64; 6]) -> JointStates {
    let joint = |(index, name): (usize, &str)| JointState {
        name: name.to_string(),
        position: Some(q.0[index]),
        velocity: Some(qd[index]),
        ..JointState::default()
    };
    JointStates { timestamp: Some(now), joints: JOINT_NAMES.into_iter().enumerate().map(joint).collect() }
}

const GREY: Color = Color { r: 0.6, g: 0.6, b: 0.62, a: 0.7 };
const RED: Color = Color { r: 0.85, g: 0.1, b: 0.1, a: 1.0 };
const BLACK: Color = Color { r: 0.1, g: 0.1, b: 0.1, a: 1.0 };

fn object_id(id: &str) -> String {
    format!("object/{id}")
}

fn entity(now: Timestamp, in_frame: &str, id: &str) -> SceneEntity {
    let (frame_id, id) = (in_frame.to_string(), id.to_string());
    SceneEntity { timestamp: Some(now), frame_id, id, ..SceneEntity::default() }
}

fn deletion(now: Timestamp, id: String) -> SceneEntityDeletion {
    // 0 is the schema's word for the entity of this id.
    SceneEntityDeletion { timestamp: Some(now), r#type: 0, id }
}

fn line(points: Vec<Point3>, kind: LineType) -> LinePrimitive {
    let pose = Some(pose(&Isometry3::identity()));
    LinePrimitive { r#type: kind as i32, pose, thickness: 0.003, points, ..LinePrimitive::default() }
}

fn text(at: &Isometry3<f64>, text: String) -> TextPrimitive {
    let (pose, color) = (Some(pose(at)), Some(BLACK));
    TextPrimitive { pose, billboard: true, font_size: 12.0, scale_invariant: true, color, text }
}

fn ring(footprint: &Footprint, at: &Pose2, z: f64) -> Vec<Point3> {
    let corners = footprint.outline(CORNERS).into_iter().map(|corner| at.transform(corner));
    corners.map(|[x, y]| Point3 { x, y, z }).collect()
}

fn pose(at: &Isometry3<f64>) -> Pose {
    let (translation, rotation) = parts(at);
    Pose { position: Some(translation), orientation: Some(rotation) }
}

fn frame(now: Timestamp, parent: &str, child: &str, at: &Isometry3<f64>) -> FrameTransform {
    let (translation, rotation) = parts(at);
    FrameTransform {
        timestamp: Some(now),
        parent_frame_id: parent.to_string(),
        child_frame_id: child.to_string(),
        translation: Some(translation),
        rotation: Some(rotation),
    }
}

fn parts(at: &Isometry3<f64>) -> (Vector3, Quaternion) {
    let (t, q) = (at.translation.vector, at.rotation);
    (Vector3 { x: t.x, y: t.y, z: t.z }, Quaternion { x: q.i, y: q.j, z: q.k, w: q.w })
}
