//! The rules about bodies: what moves meets nothing, by a model of its own.
//!
//! In: the arm of every frame, the objects of the simulated world, the equipment of the configuration. Out:
//! breaches. Points of gripper, camera and load are looked for inside of objects, equipment and safety
//! planes, where the machine measures distances of convex bodies; the arm is the thin one. An object that
//! lies on the table and is moved by anything but a hand was pushed. What a hand has moved is nowhere that a
//! path could know. A check is due when the arm may have moved as far as the last one allowed.

use crate::pair::rules::found::Found;
use crate::pair::rules::rule::Rule;
use crate::pair::rules::solid::Solid;
use crate::pair::rules::truth::Truth;
use crate::pair::stage::Stage;
use crate::pair::thin_arm::{THINNER_M, ThinModel};
use cell_motion::bodies::Part;
use nalgebra::{Isometry3, Point3};
use rearrange::geometry::pose::Pose2;
use std::collections::BTreeMap;
use ur_arm::bodies::{Capsule, capsules};
use ur_arm::chain::Chain;
use ur_sim::motion::FRAME_SECONDS;
use ur_sim::motion::safety::SafetyPlane;
use ur_sim::world::section::Section;
use ur_sim::world::spec::CameraMount;
use ur_sim::world::vacuum::{Channel, VacuumMode};
use ur_sim::world::{Body, World};

/// No point of arm and tool is farther from a joint's axis, m: reach, gripper and load.
const REACH_M: f64 = 1.3;

/// The least way after which the bodies are looked at again, m.
const LEAST_WAY_M: f64 = 1e-3;

/// An overlap with an object up to this is an error of camera, grip and placing, m.
const OBJECT_M: f64 = 4e-3;

/// The same with equipment, m.
const EQUIPMENT_M: f64 = 2e-3;

/// Edges of the camera's housing, m (D405 data sheet), and how far its front lies before the camera frame.
const CAMERA_M: [f64; 3] = [0.042, 0.042, 0.023];
const CAMERA_FRONT_M: f64 = 0.004;

/// Frames from one look at the objects on the table to the next, 50 ms.
const PUSHED_EVERY: u64 = 25;

/// Places along a link's capsule that are looked at.
const ALONG: usize = 5;

/// Points along an edge of gripper or load that are looked at near equipment are at most so far apart, m.
const APART_M: f64 = 0.015;

/// Everything that moves, and what stands. See the module.
#[derive(Debug)]
pub(super) struct Bodies {
    arm: ThinModel,
    chain: Chain,
    links: Vec<(usize, Capsule)>,
    /// Corners of gripper and camera in the flange frame.
    tool: Vec<(&'static str, Point3<f64>)>,
    /// Points along the gripper's edges.
    tool_edges: Vec<Point3<f64>>,
    equipment: Vec<(String, Solid)>,
    planes: Vec<SafetyPlane>,
    /// Where each object lies since it came to rest.
    lies: BTreeMap<String, Pose2>,
    /// Way that the arm may go before it could lie in itself, m; the same for tool and load.
    arm_clear_m: f64,
    tool_clear_m: f64,
}

impl Bodies {
    /// Of this cell, as it truly is.
    pub fn new(stage: &Stage) -> Bodies {
        let (dh, model) = (&stage.controller.dh, &stage.model.arm);
        let gripper = &stage.world.gripper;
        let z = gripper.flange_from_tool.translation.z;
        // The gripper's body; its cups go down to the table.
        let rod = Capsule { a: [0.0, 0.0, 0.4 * z], b: [0.0, 0.0, 0.6 * z], radius: 0.03 };
        let equipment = model.bodies.drawn().filter(|body| body.part == Part::Equipment);
        let links = capsules(stage.controller.arm.name).into_iter().flatten().enumerate();
        Bodies {
            arm: ThinModel::new(dh, stage.world.base_from_table, rod),
            chain: Chain::of(dh),
            links: links
                .skip(2)
                .flat_map(|(frame, each)| each.iter().map(move |one| (frame, *one)))
                .collect(),
            tool: tool_points(stage),
            tool_edges: tool_edges(stage),
            equipment: equipment
                .filter_map(|body| Some((body.name.clone(), Solid::of(&body.shape.outline()?)?)))
                .collect(),
            planes: stage.controller.safety.planes.clone(),
            lies: BTreeMap::new(),
            arm_clear_m: 0.0,
            tool_clear_m: 0.0,
        }
    }

    /// One controller frame; `astray`: nobody but a hand knows where the object is.
    pub fn frame(&mut self, truth: &Truth, world: &World, astray: impl Fn(&str) -> bool, found: &mut Found) {
        if truth.frame.is_multiple_of(PUSHED_EVERY) {
            self.pushed(world, &astray, found);
        }
        if !truth.moves || !truth.ours {
            return;
        }
        let way = REACH_M * FRAME_SECONDS * truth.qd.iter().map(|speed| speed.abs()).sum::<f64>();
        self.arm_clear_m -= way;
        self.tool_clear_m -= way;
        if self.arm_clear_m <= 0.0 {
            let distance = self.arm.least_at(&truth.q);
            if distance < 0.0 {
                found.push(Rule::ArmMeets, format!("{:.1} mm deep at {:?}", -1e3 * distance, truth.q));
            }
            self.arm_clear_m = distance.max(LEAST_WAY_M);
        }
        if self.tool_clear_m <= 0.0 {
            self.tool_clear_m = self.tool(truth, world, astray, found).max(LEAST_WAY_M);
        }
    }

    /// What lies on the table is moved by a pick-n-place or by a hand, not by something that passes. What
    /// sticks to the cups without vacuum is known to nobody.
    fn pushed(&mut self, world: &World, astray: impl Fn(&str) -> bool, found: &mut Found) {
        let sticks = world.held().next().is_some() && !grips(world);
        for body in world.objects() {
            if sticks || !body.is_resting() || astray(&body.id) {
                self.lies.remove(&body.id);
                continue;
            }
            let pose = body.pose();
            let Some(before) = self.lies.get(&body.id) else {
                self.lies.insert(body.id.clone(), pose);
                continue;
            };
            let moved = pose.distance(before);
            if moved > OBJECT_M {
                found.push(Rule::MeetsObject, format!("{} pushed by {:.0} mm", body.id, 1e3 * moved));
                self.lies.insert(body.id.clone(), pose);
            }
        }
    }

    /// Looks at tool and load; the way that they may go before they could meet anything, m.
    fn tool(&self, truth: &Truth, world: &World, astray: impl Fn(&str) -> bool, found: &mut Found) -> f64 {
        let table_from_base = world.base_from_table().inverse();
        let grips = grips(world);
        let load = world.objects().iter().find(|body| grips && body.is_held());
        let mut points: Vec<(&str, Point3<f64>)> =
            self.tool.iter().map(|(name, point)| (*name, truth.flange * point)).collect();
        if let Some(load) = load {
            let corners = load_corners(load).map(|corner| world.base_from_table() * corner);
            points.extend(corners.map(|corner| (load.id.as_str(), corner)));
        }
        let lies = |body: &&Body| body.is_resting() && !body.is_tilted() && !astray(&body.id);
        let objects: Vec<&Body> = world.objects().iter().filter(lies).collect();
        let tallest = objects.iter().map(|body| top_m(body)).fold(0.0, f64::max);
        let on_table: Vec<_> = points.iter().map(|(name, point)| (*name, table_from_base * point)).collect();
        let lowest = on_table.iter().map(|(_, point)| point.z).fold(f64::INFINITY, f64::min);
        if lowest < tallest {
            self.among_objects(&on_table, load, &objects, found);
        }
        if !self.equipment.is_empty() {
            points.extend(self.tool_edges.iter().map(|point| ("the gripper", truth.flange * point)));
            let edges =
                load.into_iter().flat_map(|load| load_edges(load).map(|point| (load.id.as_str(), point)));
            points.extend(edges.map(|(id, point)| (id, world.base_from_table() * point)));
        }
        let clear = self.near_equipment(truth, &points, found);
        (lowest - tallest).min(clear)
    }

    fn among_objects(
        &self,
        points: &[(&str, Point3<f64>)],
        load: Option<&Body>,
        objects: &[&Body],
        found: &mut Found,
    ) {
        for (name, point) in points {
            let inside = |body: &&&Body| {
                let low = OBJECT_M.min(0.5 * body.height_m);
                let local = body.table_from_object.inverse() * point;
                let between = local.z > low && local.z < body.height_m - low;
                between && body.section.contains([local.x, local.y], OBJECT_M)
            };
            if let Some(body) = objects.iter().find(inside) {
                found.push(Rule::MeetsObject, format!("{name} in {}", body.id));
            }
            if point.z < -OBJECT_M {
                found.push(Rule::MeetsObject, format!("{name} {:.0} mm in the table", -1e3 * point.z));
            }
        }
        let Some(load) = load else { return };
        for body in objects.iter().filter(|body| bottom_m(load) < top_m(body) - OBJECT_M) {
            let pose = (load.pose(), body.pose());
            let overlap = Section::overlap(&load.section, &pose.0, &body.section, &pose.1);
            if let Some(overlap) = overlap.filter(|overlap| overlap.depth_m > OBJECT_M) {
                let detail = format!("{} {:.0} mm in {}", load.id, 1e3 * overlap.depth_m, body.id);
                found.push(Rule::MeetsObject, detail);
            }
        }
    }

    /// The least distance to equipment and planes, m.
    fn near_equipment(&self, truth: &Truth, points: &[(&str, Point3<f64>)], found: &mut Found) -> f64 {
        if self.equipment.is_empty() && self.planes.is_empty() {
            return f64::INFINITY;
        }
        let frames = self.chain.placed(&truth.q).bodies;
        let links = self.links.iter().flat_map(|(frame, capsule)| {
            let radius = capsule.radius - THINNER_M;
            along(capsule).map(move |point| ("the arm", frames[*frame - 1] * point, radius))
        });
        let mut least = f64::INFINITY;
        for (name, point, radius) in points.iter().map(|(name, point)| (*name, *point, 0.0)).chain(links) {
            let depths = self.equipment.iter().map(|(what, solid)| (what.as_str(), solid.depth_m(&point)));
            let planes = self.planes.iter().map(|plane| ("a safety plane", beyond_m(plane, &point)));
            for (what, depth) in depths.chain(planes) {
                let depth = depth + radius;
                least = least.min(-depth);
                if depth > EQUIPMENT_M {
                    found.push(Rule::MeetsEquipment, format!("{name} {:.0} mm in {what}", 1e3 * depth));
                }
            }
        }
        least
    }
}

/// A channel is switched to grip.
fn grips(world: &World) -> bool {
    Channel::ALL.iter().any(|channel| world.vacuum_command(*channel).0 == VacuumMode::Grip)
}

/// Places along a capsule's segment.
fn along(capsule: &Capsule) -> impl Iterator<Item = Point3<f64>> + use<> {
    let (a, b) = (Point3::from(capsule.a), Point3::from(capsule.b));
    (0..ALONG).map(move |k| a + (b - a) * (k as f64 / (ALONG - 1) as f64))
}

/// How far a point is beyond a safety plane, m; negative where the arm may be.
fn beyond_m(plane: &SafetyPlane, point: &Point3<f64>) -> f64 {
    let normal = nalgebra::Vector3::from(plane.normal).normalize();
    normal.dot(&(Point3::from(plane.point) - point))
}

/// Corners of gripper and camera in the flange frame, and the middles between its corners.
fn tool_points(stage: &Stage) -> Vec<(&'static str, Point3<f64>)> {
    let gripper = &stage.world.gripper;
    let outline = Section::from_footprint(&gripper.body).corners(&Pose2::new(0.0, 0.0, 0.0));
    let under = -gripper.body_above_lips_m;
    let top = under.min(gripper.flange_from_tool.inverse().translation.z);
    let corner = |[x, y]: [f64; 2], z: f64| ("the gripper", gripper.flange_from_tool * Point3::new(x, y, z));
    let mut points = Vec::new();
    for (number, at) in outline.iter().enumerate() {
        let next = outline[(number + 1) % outline.len()];
        let middle = [0.5 * (at[0] + next[0]), 0.5 * (at[1] + next[1])];
        points.extend([under, 0.5 * (under + top), top].map(|z| corner(*at, z)));
        points.extend([under, top].map(|z| corner(middle, z)));
    }
    if let CameraMount::Flange(flange_from_camera) = stage.camera.mount {
        points.extend(camera_corners(&flange_from_camera).map(|point| ("the camera", point)));
    }
    points
}

/// Points along the gripper's edges, lower, middle and upper, in the flange frame.
fn tool_edges(stage: &Stage) -> Vec<Point3<f64>> {
    let gripper = &stage.world.gripper;
    let corners = Section::from_footprint(&gripper.body).corners(&Pose2::new(0.0, 0.0, 0.0));
    let under = -gripper.body_above_lips_m;
    let top = under.min(gripper.flange_from_tool.inverse().translation.z);
    let heights = [under, 0.5 * (under + top), top];
    let points = along_edges(&corners);
    points.flat_map(|[x, y]| heights.map(|z| gripper.flange_from_tool * Point3::new(x, y, z))).collect()
}

/// Points between the corners of an outline.
fn along_edges(corners: &[[f64; 2]]) -> impl Iterator<Item = [f64; 2]> {
    let next = corners.iter().cycle().skip(1);
    corners.iter().zip(next).flat_map(|(a, b)| {
        let pieces = ((b[0] - a[0]).hypot(b[1] - a[1]) / APART_M).ceil() as usize;
        (1..pieces).map(move |k| {
            let share = k as f64 / pieces as f64;
            [a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])]
        })
    })
}

/// Points along the edges of an object's lower and upper face, table frame.
fn load_edges(load: &Body) -> impl Iterator<Item = Point3<f64>> {
    let corners = load.section.corners(&Pose2::new(0.0, 0.0, 0.0));
    let points: Vec<[f64; 2]> = along_edges(&corners).collect();
    let faces = points.into_iter().flat_map(|[x, y]| [[x, y, 0.0], [x, y, load.height_m]]);
    faces.map(|point| load.table_from_object * Point3::from(point))
}

fn camera_corners(flange_from_camera: &Isometry3<f64>) -> [Point3<f64>; 8] {
    let [x, y, z] = CAMERA_M;
    std::array::from_fn(|corner| {
        let side = |bit: usize, length: f64| if corner & bit == 0 { -length / 2.0 } else { length / 2.0 };
        let deep = if corner & 4 == 0 { CAMERA_FRONT_M - z } else { CAMERA_FRONT_M };
        flange_from_camera * Point3::new(side(1, x), side(2, y), deep)
    })
}

/// Corners of an object's lower and upper face, table frame.
fn load_corners(load: &Body) -> impl Iterator<Item = Point3<f64>> {
    let corners = load.section.corners(&Pose2::new(0.0, 0.0, 0.0));
    let faces = corners.into_iter().flat_map(|[x, y]| [[x, y, 0.0], [x, y, load.height_m]]);
    faces.map(|point| load.table_from_object * Point3::from(point))
}

/// Height of an object's lower face over the table, m.
fn bottom_m(body: &Body) -> f64 {
    body.table_from_object.translation.z
}

/// Height of its upper face, m.
fn top_m(body: &Body) -> f64 {
    bottom_m(body) + body.height_m
}
