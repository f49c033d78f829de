//! The bodies of the cell: arm, tool, what it carries, table, equipment, what lies on the table.
//!
//! In: the arm's kinematics, what hangs on the flange, the table's pose and size, the `cell:` section of the
//! configuration. Out: [`Bodies`], which belongs to the arm's model, and [`Room`], what lies on the table
//! while one path is followed: both are what the swept check (`sweep`) goes through pair by pair. Pure.
//!
//! Links are capsules (`ur_arm::bodies`) in the frames of this very arm, tool and load hang on its flange. A
//! link is wider by as much as its two axes deviate from those that its capsules were measured about.

pub mod cell;
mod chains;
mod nearing;
pub mod shape;
pub mod sweep;
#[cfg(test)]
mod tests;

use crate::bodies::cell::{CellBodies, NamedShape};
pub use crate::bodies::chains::TOOL_FRAME;

use crate::bodies::chains::poses;
use crate::bodies::shape::{Shape, apart};
use cell_values::units::Joints;
use nalgebra::Isometry3;
use parry3d_f64::math::Pose;
use rearrange::geometry::footprint::Footprint;
use rearrange::geometry::pose::Pose2;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;
use std::sync::Arc;
use ur_arm::bodies::{BODY_NAMES, HARMLESS_PAIRS, capsules};
use ur_arm::chain::Chain;
use ur_arm::kinematics::{ArmModel as Model, DhParameters, model_of};
use ur_arm::links::misfits;

/// Distance kept between parts of the arm, m, besides what [`misfits`] knows: offsets along the parallel
/// axes that cancel each other, and the tolerances of the bodies.
const SELF_MARGIN_M: f64 = 0.005;

/// What a body of an arm without published meshes is wider by than that of the arm it resembles most, m.
const GUESSED_M: f64 = 0.03;

/// Radius of the stand under a base, m, where the configuration gives none: a little more than its flange.
const STAND_RADIUS_M: f64 = 0.1;

/// A base so far under the table's surface or more stands beside the table, not on it, m.
const BESIDE_M: f64 = 0.02;

/// Thickness of a table beside the robot, m: whatever is under it, the arm does not go there.
const TABLE_DEPTH_M: f64 = 1.0;

/// Positions of joint 6 at which a body on the flange is compared with wrist 2.
const RING: usize = 72;

/// What a body is: which pairs are checked, and when.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub enum Part {
    /// Link with this index, base first.
    Link(usize),
    /// Gripper, camera, bracket.
    Tool,
    /// The cups and what holds them: they come down between the objects.
    Cups,
    /// What the gripper holds.
    Load,
    /// The middle of the elbow or of a wrist, which keeps a height of its own over the table.
    Joint,
    /// The table's surface.
    Table,
    /// The plane of the table's surface, under the joints.
    Plane,
    /// Equipment and walls.
    Equipment,
    /// What the robot is mounted on.
    Stand,
    /// The air over the table up to which something may lie there, unless it is seen in full.
    Layer,
    /// The same over the table's rim, for what hangs on the flange.
    Rim,
    /// The lower part of that air that a cut corner keeps out of.
    CornerLayer,
    /// The same over the table's rim.
    CornerRim,
    /// One object that was seen or is planned there.
    Standing,
    /// One that reaches out of the layer: the arm goes round it, not only over the layer.
    Tall,
}

/// One convex body.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
pub struct Body {
    /// As a person calls it.
    pub name: String,
    /// What it is.
    pub part: Part,
    /// The frame it moves with: 0 is the base, [`TOOL_FRAME`] the calibrated flange.
    pub frame: usize,
    /// Its shape in that frame.
    pub shape: Shape,
}

impl Body {
    fn new(name: impl Into<String>, part: Part, frame: usize, shape: Shape) -> Body {
        Body { name: name.into(), part, frame, shape }
    }
}

/// Everything of the cell that is the same for every path.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
pub struct Bodies {
    /// The arm's links.
    chain: Chain,
    /// How much wider each link is than its capsules, m.
    misfits: [f64; 6],
    base_from_table: Isometry3<f64>,
    flange_from_tool: Isometry3<f64>,
    /// Width and depth of the table's workspace, m.
    table: [f64; 2],
    moving: Vec<Body>,
    fixed: Vec<Body>,
    pairs: Vec<Pair>,
    margin: f64,
    link_floor: f64,
}

/// Two bodies that are kept apart.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
pub(super) struct Pair {
    /// Index of the moving body.
    pub a: usize,
    /// The other one.
    pub b: Other,
    /// Distance kept, m; less than `wanted` while an arm leaves a place that is nearer.
    pub margin: f64,
    /// Distance to be kept, m.
    pub wanted: f64,
    /// Metres that the two move against each other at most, for each radian of each joint.
    pub levers: [f64; 6],
}

impl Pair {
    pub fn new(a: usize, b: Other, margin: f64, levers: [f64; 6]) -> Pair {
        Pair { a, b, margin, wanted: margin, levers }
    }
}

/// The second body of a pair.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
pub(super) enum Other {
    Moving(usize),
    Fixed(usize),
    /// Of the room.
    Room(usize),
}

/// The arm and its surroundings, from which bodies are made.
#[derive(Clone, Debug, PartialEq)]
pub struct Surroundings {
    /// Where the table frame is in the base frame.
    pub base_from_table: Isometry3<f64>,
    /// The tool frame in the flange frame.
    pub flange_from_tool: Isometry3<f64>,
    /// Width and depth of the table's workspace, m.
    pub table: [f64; 2],
    /// Lowest height of elbow and wrists over the table, m.
    pub link_floor: f64,
    /// Gripper, camera and equipment.
    pub cell: CellBodies,
}

impl Bodies {
    /// The bodies of a cell with these calibrated kinematics.
    pub fn new(dh: &DhParameters, surroundings: &Surroundings) -> Bodies {
        let cell = &surroundings.cell;
        let model = model_of(dh);
        let misfits = misfits(dh, &model.dh);
        let mut moving = links(model, &misfits, cell.cable_m);
        let tool = |named: &NamedShape, part| Body::new(&named.name, part, TOOL_FRAME, named.shape.clone());
        moving.extend(cell.tool.iter().map(|named| tool(named, Part::Tool)));
        moving.extend(cell.cups.iter().map(|named| tool(named, Part::Cups)));
        moving.extend((2..=6).map(|frame| {
            let name = format!("the middle of {}", link_name(frame));
            Body::new(name, Part::Joint, frame, Shape::capsule([0.0; 3], [0.0; 3], 0.0))
        }));
        let mut fixed = vec![table(surroundings), plane(surroundings)];
        fixed.push(Body::new("the robot's stand", Part::Stand, 0, stand(cell)));
        let known = cell.equipment.iter();
        fixed.extend(known.map(|named| Body::new(&named.name, Part::Equipment, 0, named.shape.clone())));
        let mut bodies = Bodies {
            chain: Chain::of(dh),
            misfits,
            base_from_table: surroundings.base_from_table,
            flange_from_tool: surroundings.flange_from_tool,
            table: surroundings.table,
            moving,
            fixed,
            pairs: Vec::new(),
            margin: cell.margin_m,
            link_floor: surroundings.link_floor,
        };
        bodies.pairs = bodies.all_pairs();
        bodies
    }

    /// The same with one more thing that does not move, in the base frame.
    pub fn with(mut self, thing: &NamedShape) -> Bodies {
        self.fixed.push(Body::new(&thing.name, Part::Equipment, 0, thing.shape.clone()));
        self.pairs = self.all_pairs();
        self
    }

    /// The bodies of an arm with nothing on its flange, nothing round it and no table but the plane below
    /// it, whose joints may go as low as that.
    pub fn bare(dh: &DhParameters) -> Bodies {
        let still = Isometry3::identity();
        let surroundings = Surroundings {
            base_from_table: Isometry3::translation(0.0, 0.0, -TABLE_DEPTH_M),
            flange_from_tool: still,
            table: [1.0, 1.0],
            link_floor: 0.0,
            cell: CellBodies::bare(),
        };
        Bodies::new(dh, &surroundings)
    }

    fn all_pairs(&self) -> Vec<Pair> {
        let mut pairs = Vec::new();
        for (a, body) in self.moving.iter().enumerate() {
            for (b, other) in self.moving.iter().enumerate().skip(a + 1) {
                if let Some(margin) =
                    own_margin(body, other).filter(|margin| self.can_part(body, other, *margin))
                {
                    let levers = self.levers(other, body.frame);
                    pairs.push(Pair::new(a, Other::Moving(b), margin, levers));
                }
            }
            for (b, other) in self.fixed.iter().enumerate() {
                if let Some(margin) = self.margin_to(body, other) {
                    let levers = against(self.levers(body, 0), &other.shape);
                    pairs.push(Pair::new(a, Other::Fixed(b), margin, levers));
                }
            }
        }
        pairs
    }

    /// False where a body on the flange is within the margin of wrist 2 in every position of joint 6, which
    /// alone moves the two against each other: it is built so, and no path could keep the margin. That holds
    /// for the whole body: a long bracket is better entered as several. What the link may be wider by does
    /// not count.
    fn can_part(&self, link: &Body, tool: &Body, margin: f64) -> bool {
        if link.part != Part::Link(5) {
            return true;
        }
        (0..RING).any(|k| {
            let frames = self.frames(&Joints([0.0, 0.0, 0.0, 0.0, 0.0, TAU * k as f64 / RING as f64]));
            apart(&link.shape, &frames[link.frame], &tool.shape, &frames[tool.frame])
                > margin - self.misfits[4]
        })
    }

    /// Distance a moving body keeps to something that does not move; `None` where the two cannot meet.
    fn margin_to(&self, body: &Body, other: &Body) -> Option<f64> {
        match (body.part, other.part) {
            (Part::Joint, Part::Plane) => Some(self.link_floor),
            (Part::Joint, _) | (_, Part::Plane) => None,
            // The base stands on its stand, and the shoulder turns on the spot.
            (Part::Link(0 | 1), _) => None,
            // So does the upper arm's end there.
            (Part::Link(2), Part::Stand) if self.is_at_shoulder(body) => None,
            _ => Some(self.margin),
        }
    }

    /// True of the end of the upper arm that the shoulder's axis goes through.
    fn is_at_shoulder(&self, body: &Body) -> bool {
        let middle = body.shape.middle();
        (middle.x - self.chain.links()[1].translation.x.abs()).hypot(middle.y) < body.shape.thickness()
    }

    /// Metres that `body` moves at most, seen from frame `seen_from`, for each radian of each joint.
    fn levers(&self, body: &Body, seen_from: usize) -> [f64; 6] {
        let frame = body.frame.min(6);
        let at = |link: usize| self.chain.links()[link].translation.vector;
        let chain = |joint: usize| -> f64 {
            let links = (joint + 1..frame).map(|link| at(link).norm()).sum::<f64>();
            at(joint).xy().norm() + links + body.shape.farthest()
        };
        std::array::from_fn(
            |joint| {
                if joint < seen_from.min(6) || joint >= frame { 0.0 } else { chain(joint) }
            },
        )
    }

    /// What moves with the arm, and what stands, for a drawing.
    pub fn drawn(&self) -> impl Iterator<Item = &Body> {
        self.moving.iter().chain(&self.fixed)
    }

    /// Poses of the frames 0 to 6 and of the flange, in the base frame.
    pub fn frames(&self, q: &Joints) -> [Pose; 8] {
        poses(&self.chain, q)
    }
}

/// Levers against a thing that does not move: joint 1 moves nothing towards a plane that its axis is square
/// to.
fn against(mut levers: [f64; 6], other: &Shape) -> [f64; 6] {
    levers[0] *= other.across([0.0, 0.0, 1.0]);
    levers
}

/// The arm's own capsules. Hoses and cables lie round forearm and wrists, `cable_m` wide.
fn links(model: &Model, misfits: &[f64; 6], cable_m: f64) -> Vec<Body> {
    let resembles = format!("{}e", model.name);
    let (links, more) = match (capsules(model.name), capsules(&resembles)) {
        (Some(links), _) => (links, 0.0),
        (None, Some(links)) => (links, GUESSED_M),
        (None, None) => return Vec::new(),
    };
    let bodies = links.iter().enumerate().flat_map(|(link, capsules)| {
        let cable = if link >= 3 { cable_m } else { 0.0 };
        let wider = more + cable + link.checked_sub(1).map_or(0.0, |link| misfits[link]);
        capsules.iter().map(move |capsule| {
            let shape = Shape::capsule(capsule.a, capsule.b, capsule.radius + wider);
            Body::new(link_name(link), Part::Link(link), link, shape)
        })
    });
    bodies.collect()
}

/// A link in a sentence: "the forearm", "wrist 1".
fn link_name(link: usize) -> String {
    let name = BODY_NAMES[link];
    if name.starts_with("wrist") { name.to_string() } else { format!("the {name}") }
}

/// Distance that two bodies of the arm keep; `None` where they cannot meet, or always touch.
fn own_margin(a: &Body, b: &Body) -> Option<f64> {
    match (a.part, b.part) {
        (Part::Link(i), Part::Link(k)) if i == k || HARMLESS_PAIRS.contains(&(i.min(k), i.max(k))) => None,
        (Part::Link(_), Part::Link(_)) => Some(SELF_MARGIN_M),
        // Wrist 3 carries the tool, and what hangs on the cups is on the other side of it than wrist 2.
        (Part::Link(6), _) | (Part::Link(5), Part::Load) => None,
        (Part::Link(_), Part::Tool | Part::Cups | Part::Load) => Some(SELF_MARGIN_M),
        _ => None,
    }
}

/// What the robot is mounted on: as configured, or a column that its base fits on.
fn stand(cell: &CellBodies) -> Shape {
    let below = Isometry3::translation(0.0, 0.0, -TABLE_DEPTH_M);
    cell.stand.clone().unwrap_or_else(|| Shape::cylinder(STAND_RADIUS_M, TABLE_DEPTH_M, &below))
}

/// Everything below the table's surface.
fn plane(surroundings: &Surroundings) -> Body {
    let base_from_table = &surroundings.base_from_table;
    let up = base_from_table.rotation * nalgebra::Vector3::z();
    let shape = Shape::half_space(base_from_table.translation.vector.into(), up.into());
    Body::new("the table's plane", Part::Plane, 0, shape)
}

/// The table: everything below its plane where the robot is mounted on it or higher, else the block that it
/// is.
fn table(surroundings: &Surroundings) -> Body {
    let base_from_table = &surroundings.base_from_table;
    let base_over_table = base_from_table.inverse().translation.z;
    let shape = if base_over_table > -BESIDE_M {
        plane(surroundings).shape
    } else {
        let block = layer_box(surroundings.table, TABLE_RIM_M, (-TABLE_DEPTH_M, 0.0));
        Shape::cuboid(block.0, &(base_from_table * block.1))
    };
    Body::new("the table", Part::Table, 0, shape)
}

/// How far a table beside the robot reaches beyond its workspace, m.
const TABLE_RIM_M: f64 = 0.1;

/// What a person calls the air over the table in which things may lie.
pub const LAYER: &str = "what may lie on the table";

/// How far beyond the workspace things may lie, m: looks search so far.
const LAYER_RIM_M: f64 = 0.02;

/// Higher than any arm reaches, m.
const HIGHEST_M: f64 = 5.0;

/// Size and middle (table frame) of the box over a table from one height to another, `rim` wider all round.
fn layer_box(table: [f64; 2], rim: f64, (low, high): (f64, f64)) -> ([f64; 3], Isometry3<f64>) {
    let size = [table[0] + 2.0 * rim, table[1] + 2.0 * rim, high - low];
    (size, Isometry3::translation(table[0] / 2.0, table[1] / 2.0, 0.5 * (low + high)))
}

/// An object on the table.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
pub struct Standing {
    /// Its name.
    pub name: String,
    /// Its outline.
    pub footprint: Footprint,
    /// Where it lies, table frame.
    pub pose: Pose2,
    /// m.
    pub height: f64,
}

/// What hangs on the tool, which points straight down while it is picked and placed.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
pub struct Load {
    /// Its name.
    pub name: String,
    /// Its outline.
    pub footprint: Footprint,
    /// Its pose seen from above, in the frame of a tool whose y axis is mirrored as that of a tool pointing
    /// down is: `table_from_tool.inverse() * table_from_object` in the plane.
    pub tool_from_object: Pose2,
    /// m.
    pub height: f64,
}

/// An object that hangs on cups may be tilted by so much, rad: a soft bellows gives way.
const TILT_RAD: f64 = 0.05;

impl Load {
    /// How far it may reach below the cups, m: tilted, its far edge hangs lower.
    pub fn depth(&self) -> f64 {
        self.height + TILT_RAD * (self.reach() + self.height)
    }

    /// How far its outline reaches from the tool's axis, m.
    fn reach(&self) -> f64 {
        let [x, y] = self.tool_from_object.transform([0.0, 0.0]);
        x.hypot(y) + self.footprint.bounding_radius()
    }
}

/// What lies on the table while a path is followed, and what the gripper holds.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Room {
    bodies: Arc<Vec<Body>>,
    load: Option<Body>,
}

/// What is on the table: known objects, and the height up to which anything may lie there.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Tabletop {
    /// m; 0 where nothing can be there.
    pub layer: f64,
    /// The same for corners that are cut, m: not over `layer`.
    pub corner_layer: f64,
    /// Objects that were seen, or that will lie there.
    pub standing: Vec<Standing>,
}

impl Room {
    /// Nothing on the table, nothing held.
    pub fn empty() -> Room {
        Room::default()
    }

    /// A table with this on it, and one more thing where `also` is given; nothing held.
    pub fn new(bodies: &Bodies, table: &Tabletop, also: Option<&Standing>) -> Room {
        let mut out = Vec::new();
        let corner_layer = table.corner_layer.min(table.layer);
        for (part, rim, layer) in [
            (Part::Layer, LAYER_RIM_M, table.layer),
            (Part::Rim, TABLE_RIM_M, table.layer),
            (Part::CornerLayer, LAYER_RIM_M, corner_layer),
            (Part::CornerRim, TABLE_RIM_M, corner_layer),
        ] {
            // What has no known height reaches higher than any arm.
            let layer = layer.min(HIGHEST_M);
            if layer > 0.0 {
                let (size, middle) = layer_box(bodies.table, rim, (0.0, layer));
                let shape = Shape::cuboid(size, &(bodies.base_from_table * middle));
                out.push(Body::new(LAYER, part, 0, shape));
            }
        }
        out.extend(table.standing.iter().chain(also).map(|thing| {
            let range = (0.0, thing.height.min(HIGHEST_M));
            let shape = Shape::prism(&thing.footprint, &thing.pose, range, &bodies.base_from_table);
            let part = if thing.height > table.layer { Part::Tall } else { Part::Standing };
            Body::new(&thing.name, part, 0, shape)
        }));
        Room { bodies: Arc::new(out), load: None }
    }

    /// The same table with something else in the gripper.
    pub fn holding(&self, bodies: &Bodies, load: Option<&Load>) -> Room {
        Room { bodies: Arc::clone(&self.bodies), load: load.map(|load| bodies.loaded(load)) }
    }
}

impl Bodies {
    /// What is held: its prism below the cups, tilted a little in any direction.
    fn loaded(&self, load: &Load) -> Body {
        // Seen from the tool, whose z points down and whose y is mirrored against the view from above.
        let mirrored = Isometry3::rotation(nalgebra::Vector3::x() * std::f64::consts::PI);
        let frame = self.flange_from_tool * mirrored;
        let aside = TILT_RAD * load.height;
        // Widened by what its lower face moves aside; its raised edge is as far over the cups.
        let range = (aside - load.depth(), TILT_RAD * load.reach() - aside);
        let shape = Shape::prism(&load.footprint, &load.tool_from_object, range, &frame);
        Body::new(&load.name, Part::Load, TOOL_FRAME, shape.widened(aside))
    }
}
