//! The simulated table, its objects and the gripper: what is true, stepped by the time it is given.
//!
//! In: a [`WorldSpec`] and a seed, then the arm's flange pose at every controller frame and the gripper's
//! commands. Out: true poses (for tests and the final report only), relative vacuum, contacts, events, and
//! the light [`Scene`](crate::render::scene::Scene) that the camera draws. Pure: no clock, no socket;
//! the same seed and the same calls give the same world.
//!
//! The model, and what it leaves out:
//! - Objects are upright prisms, quasi-static: nothing slides or topples by itself. What the arm runs into
//!   from the side is pushed along the table (`push`); nothing is knocked over.
//! - A channel is sealed when all its cups lie on one object's top, within 2 mm in height and 3 degrees of
//!   its normal, each lip inside the top (and inside `grippable`) and nothing else above it.
//! - A sealed channel takes hold at 20 % vacuum. The object then moves rigidly with the tool while the
//!   vacuum carries m (a - g); below that it falls. Resting on something it is let go below 5 %.
//! - Grip and placing each add a random offset; nothing is ever moved towards a goal. - A placed object
//!   that penetrates others by up to 1 mm shares the push with them; deeper, it stands on top if its middle
//!   is over what is under it (`stack`), and leans on that if not.
//! - Pressing into table or objects lifts what is held and is recorded as a contact; the arm itself is not
//!   stopped here.

mod conveyor;
pub mod disturb;
pub mod drive;
mod ejector;
pub mod event;
mod finger_grip;
mod fingers;
mod grip;
mod hand_board;
mod placing;
mod push;
pub mod section;
mod snapshot;
pub mod spec;
mod stack;
mod two_finger;
pub mod vacuum;
mod view;

use crate::faults::camera::CameraFaults;
use crate::motion::belt::TableBelt;
use crate::render::scene::Cells;
use crate::world::drive::Drive;
use crate::world::event::{Contact, Event, EventKind};
use crate::world::fingers::Fingers;
use crate::world::hand_board::Plate;
use crate::world::section::Section;
use crate::world::spec::{
    ForeignBody, GripperSpec, ObjectMarker, PlacementErrors, ReferenceMarker, TableSpec,
};
use crate::world::spec::{WorldError, WorldObject, WorldSpec};
use crate::world::vacuum::{Channel, ChannelFaults, Pump, VacuumMode};
use cell_values::hue::hue_deg;
use cell_values::image::tag36h11_bitmap;
use nalgebra::{Isometry3, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rearrange::geometry::pose::Pose2;
use std::collections::{HashSet, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Events kept; older ones are dropped.
const EVENT_CAPACITY: usize = 4096;
/// Places of the flange kept: 0.6 s of controller frames.
const TRAIL_CAPACITY: usize = 300;
/// Time constant of the filter behind the tool's acceleration, s: a controller frame's step in speed (a
/// stop) must not read as 100 m/s2.
const ACCELERATION_TAU_S: f64 = 0.02;

/// The world as the simulator's threads share it.
pub type SharedWorld = Arc<Mutex<World>>;

/// Locks the world. A thread that panicked while holding it left it usable: every step writes whole values.
pub fn lock(world: &SharedWorld) -> MutexGuard<'_, World> {
    world.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The simulated cell's true state.
pub struct World {
    table: TableSpec,
    base_from_table: Isometry3<f64>,
    table_from_base: Isometry3<f64>,
    reference: Vec<(ReferenceMarker, Cells)>,
    errors: PlacementErrors,
    gripper: GripperSpec,
    housing: Arc<Section>,
    housing_from_above: Arc<Section>,
    cup_sections: Vec<Arc<Section>>,
    bodies: Vec<Body>,
    channels: [ChannelState; 2],
    fingers: Option<Fingers>,
    current_limit_ma: u16,
    rng: ChaCha8Rng,
    seed: u64,
    now_s: f64,
    steps: u64,
    tool: Option<Tool>,
    contact: Option<Contact>,
    /// The deepest contact of the arm, also where the cups only give way.
    touch: Option<Contact>,
    /// Pairs that touch, and not from the side: what of the arm, and which object.
    from_above: Vec<(String, usize)>,
    /// Force that the objects being pushed take, N, in the table frame.
    pushing: Vector3<f64>,
    events: VecDeque<Event>,
    recorded: u64,
    camera: CameraFaults,
    sticky: bool,
    /// Things without a marker that are on the table, with their places among the bodies.
    foreign: Vec<(ForeignBody, usize)>,
    conveyors: Vec<TableBelt>,
    hand_board: Option<Plate>,
    /// Where the flange was lately: time and `base_from_flange`, for exposures that take a while.
    trail: VecDeque<(f64, Isometry3<f64>)>,
}

/// An object as it is now.
#[derive(Clone, Debug)]
pub struct Body {
    /// Its name.
    pub id: String,
    /// Its footprint.
    pub section: Arc<Section>,
    /// Its height, m.
    pub height_m: f64,
    /// Its mass, kg.
    pub mass_kg: f64,
    /// Its marker and the marker's cells.
    pub marker: Option<(ObjectMarker, Cells)>,
    /// Where cups may sit; absent: the whole top.
    pub grippable: Option<Arc<Section>>,
    /// Screwed to the table.
    pub fixed: bool,
    /// Colour of its top.
    pub colour: [u8; 3],
    /// Where it is: the footprint's origin on its underside.
    pub table_from_object: Isometry3<f64>,
    /// What holds it up.
    pub state: BodyState,
}

/// What holds an object up.
#[derive(Clone, Debug, PartialEq)]
pub enum BodyState {
    /// It lies on the table; on the objects listed, if any: flat on top of them, or leaning.
    Resting {
        /// Objects under it.
        on: Vec<usize>,
    },
    /// The gripper holds it.
    Held {
        /// Its place in the tool frame.
        tool_from_object: Isometry3<f64>,
        /// Height below which it cannot go, m: the table or what it would land on.
        floor_m: f64,
        /// Objects it overlapped where it was gripped; they do not count as obstacles until it is above
        /// them.
        beside: Vec<usize>,
    },
    /// It left the table.
    Fallen,
}

struct ChannelState {
    pump: Pump,
    sealed: bool,
    holds: Option<usize>,
    faults: ChannelFaults,
    leak_age_s: f64,
}

impl ChannelState {
    fn new(overshoot: f64) -> ChannelState {
        let (pump, faults) = (Pump::overshooting(overshoot), ChannelFaults::default());
        ChannelState { pump, sealed: false, holds: None, faults, leak_age_s: 0.0 }
    }
}

#[derive(Clone, Copy)]
struct Tool {
    base_from_flange: Isometry3<f64>,
    table_from_tool: Isometry3<f64>,
    velocity: Vector3<f64>,
    acceleration: Vector3<f64>,
}

impl Body {
    /// Position and angle on the table, whatever its height and tilt.
    pub fn pose(&self) -> Pose2 {
        let t = self.table_from_object.translation.vector;
        let x_axis = self.table_from_object.rotation * Vector3::x();
        Pose2::new(t.x, t.y, x_axis.y.atan2(x_axis.x))
    }

    /// Angle between its top and the table, rad.
    pub fn tilt_rad(&self) -> f64 {
        (self.table_from_object.rotation * Vector3::z()).angle(&Vector3::z())
    }

    /// True while it lies on the table or on other objects.
    pub fn is_resting(&self) -> bool {
        matches!(self.state, BodyState::Resting { .. })
    }

    /// True while the gripper holds it.
    pub fn is_held(&self) -> bool {
        matches!(self.state, BodyState::Held { .. })
    }

    /// True when it leans on other objects instead of lying flat.
    pub fn is_tilted(&self) -> bool {
        matches!(&self.state, BodyState::Resting { on } if !on.is_empty()) && !self.is_stacked()
    }

    /// True when it left the table.
    pub fn is_fallen(&self) -> bool {
        self.state == BodyState::Fallen
    }

    /// Lowest point of its underside, m above the table.
    fn bottom_m(&self) -> f64 {
        let up = self.table_from_object.rotation.inverse() * Vector3::z();
        self.table_from_object.translation.z - self.section.support([-up.x, -up.y])
    }

    /// Highest point of its top, m above the table.
    fn top_m(&self) -> f64 {
        let up = self.table_from_object.rotation.inverse() * Vector3::z();
        self.table_from_object.translation.z + self.height_m * up.z + self.section.support([up.x, up.y])
    }
}

impl World {
    /// A world at rest.
    ///
    /// # Errors
    /// [`WorldError`] for sizes that are not above 0, poses that are not finite, names and markers used
    /// twice.
    pub fn new(spec: WorldSpec, seed: u64) -> Result<World, WorldError> {
        check(&spec)?;
        let mut bodies = Vec::with_capacity(spec.objects.len());
        for (index, object) in spec.objects.into_iter().enumerate() {
            bodies.push(body(index, object)?);
        }
        let reference = spec
            .reference_markers
            .iter()
            .map(|marker| Ok((*marker, cells_of("reference marker", marker.id)?)))
            .collect::<Result<_, WorldError>>()?;
        let mut world = World {
            table: spec.table,
            base_from_table: spec.base_from_table,
            table_from_base: spec.base_from_table.inverse(),
            reference,
            errors: spec.errors,
            housing: Arc::new(Section::from_footprint(&spec.gripper.body)),
            housing_from_above: Arc::new(Section::from_footprint(&spec.gripper.body).turned_over()),
            cup_sections: spec
                .gripper
                .cups
                .iter()
                .map(|cup| Arc::new(Section::ellipse(cup.diameter_m, cup.diameter_m)))
                .collect(),
            fingers: match spec.gripper.drive {
                Drive::Fingers(fingers) => Some(Fingers::new(fingers)),
                Drive::Vgc10 | Drive::Vgc10OnTool | Drive::Ejector(_) => None,
            },
            channels: [spec.gripper.overshoot; 2].map(ChannelState::new),
            gripper: spec.gripper,
            bodies,
            current_limit_ma: vacuum::FULL_SPEED_MA,
            rng: ChaCha8Rng::seed_from_u64(seed),
            seed,
            now_s: 0.0,
            steps: 0,
            tool: None,
            contact: None,
            touch: None,
            from_above: Vec::new(),
            pushing: Vector3::zeros(),
            events: VecDeque::new(),
            recorded: 0,
            camera: CameraFaults::default(),
            sticky: false,
            foreign: Vec::new(),
            conveyors: Vec::new(),
            hand_board: spec.hand_board.as_ref().map(Plate::new).transpose()?,
            trail: VecDeque::new(),
        };
        world.stack_in_order();
        Ok(world)
    }

    /// Advances by one controller frame: `now_s` is the controller's time at its end, `dt_s` its length, and
    /// `base_from_flange` the true flange pose then.
    pub fn step(&mut self, now_s: f64, dt_s: f64, base_from_flange: &Isometry3<f64>) {
        self.now_s = now_s;
        if self.trail.len() >= TRAIL_CAPACITY {
            self.trail.pop_front();
        }
        self.trail.push_back((now_s, *base_from_flange));
        self.track_tool(dt_s, base_from_flange);
        self.run_conveyors(dt_s);
        self.push_aside();
        if self.steps.is_multiple_of(5) {
            self.feel_contacts();
        }
        self.carry();
        self.run_pumps(dt_s);
        self.run_fingers(dt_s);
        self.let_go();
        self.steps += 1;
    }

    /// Commands a channel; `target` is a fraction and counts for [`VacuumMode::Grip`] only.
    pub fn command_vacuum(&mut self, channel: Channel, mode: VacuumMode, target: f64) {
        self.channels[channel.index()].pump.command(mode, target);
    }

    /// Mode and target last commanded to a channel.
    pub fn vacuum_command(&self, channel: Channel) -> (VacuumMode, f64) {
        let pump = &self.channels[channel.index()].pump;
        (pump.mode(), pump.target())
    }

    /// True relative vacuum of a channel, fraction.
    pub fn vacuum(&self, channel: Channel) -> f64 {
        self.channels[channel.index()].pump.vacuum()
    }

    /// What the gripper's sensor says about a channel, per mille: the truth with a noise of up to +-8, the
    /// same for all readings within one frame.
    pub fn vacuum_reading_per_mille(&self, channel: Channel) -> u16 {
        let mut z = self.seed ^ (self.steps * 2 + channel.index() as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        let noise = (z >> 40) % 9 + (z >> 20) % 9; // triangular, 0 to 16
        (self.vacuum(channel) * 1000.0 + noise as f64 - 8.0).round().clamp(0.0, 1000.0) as u16
    }

    /// The gripper's current limit, mA: kept, and without effect on this pump.
    pub fn current_limit_ma(&self) -> u16 {
        self.current_limit_ma
    }

    /// Sets the current limit register, mA.
    pub fn set_current_limit_ma(&mut self, limit: u16) {
        self.current_limit_ma = limit;
        self.channels.iter_mut().for_each(|channel| channel.pump.set_current_limit_ma(limit));
    }

    /// All objects, in the order of the spec. Truth: for tests, the report and the drawing only.
    pub fn objects(&self) -> &[Body] {
        &self.bodies
    }

    /// The object of that name. Truth: for tests and the report only.
    pub fn object(&self, id: &str) -> Option<&Body> {
        self.bodies.iter().find(|body| body.id == id)
    }

    /// Names of the objects in the gripper.
    pub fn held(&self) -> impl Iterator<Item = &str> {
        self.bodies.iter().filter(|body| body.is_held()).map(|body| body.id.as_str())
    }

    /// What the arm presses on at this moment, the deepest first found.
    pub fn contact(&self) -> Option<&Contact> {
        self.contact.as_ref()
    }

    /// What happened so far, oldest first; at most the last 4096.
    pub fn events(&self) -> impl Iterator<Item = &Event> {
        self.events.iter()
    }

    /// Controller time of the last step, s.
    pub fn now_s(&self) -> f64 {
        self.now_s
    }

    /// The seed it was made with.
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// True pose of the table in the robot's base frame. Truth: for tests and the report only.
    pub fn base_from_table(&self) -> &Isometry3<f64> {
        &self.base_from_table
    }

    /// False after the fault `camera.off`.
    pub fn camera_on(&self) -> bool {
        !self.camera.off
    }

    fn track_tool(&mut self, dt_s: f64, base_from_flange: &Isometry3<f64>) {
        let table_from_tool = self.table_from_base * base_from_flange * self.gripper.flange_from_tool;
        let (mut velocity, mut acceleration) = self
            .tool
            .map_or((Vector3::zeros(), Vector3::zeros()), |before| (before.velocity, before.acceleration));
        if let Some(before) = &self.tool
            && dt_s > 0.0
        {
            let raw = (table_from_tool.translation.vector - before.table_from_tool.translation.vector) / dt_s;
            velocity = before.velocity + (raw - before.velocity) * -(-dt_s / ACCELERATION_TAU_S).exp_m1();
            acceleration = (velocity - before.velocity) / dt_s;
        }
        self.tool =
            Some(Tool { base_from_flange: *base_from_flange, table_from_tool, velocity, acceleration });
    }

    fn record(&mut self, kind: EventKind) {
        if self.events.len() >= EVENT_CAPACITY {
            self.events.pop_front();
        }
        self.recorded += 1;
        self.events.push_back(Event { time_s: self.now_s, kind });
    }
}

fn cells_of(what: &str, id: u32) -> Result<Cells, WorldError> {
    tag36h11_bitmap(id).ok_or_else(|| WorldError::no_marker(what, id))
}

fn body(index: usize, object: WorldObject) -> Result<Body, WorldError> {
    let marker = match object.marker {
        Some(marker) => Some((marker, cells_of(&object.id, marker.id)?)),
        None => None,
    };
    Ok(Body {
        section: Arc::new(Section::from_footprint(&object.footprint)),
        height_m: object.height_m,
        mass_kg: object.mass_kg,
        marker,
        grippable: object.grippable.as_ref().map(|shape| Arc::new(Section::from_footprint(shape))),
        fixed: object.fixed,
        colour: object.colour.unwrap_or_else(|| palette(index)),
        table_from_object: object.pose.at_height(0.0),
        state: BodyState::Resting { on: Vec::new() },
        id: object.id,
    })
}

/// Distinct, not too bright colours by number, of the hues that celld draws its objects in.
fn palette(index: usize) -> [u8; 3] {
    let hue = hue_deg(index).to_radians();
    [0.0, 2.094, 4.189].map(|phase| (130.0 + 55.0 * (hue - phase).cos()) as u8)
}

fn check(spec: &WorldSpec) -> Result<(), WorldError> {
    let positive = |what: String, value: f64| {
        if value.is_finite() && value > 0.0 { Ok(()) } else { Err(WorldError::NotPositive { what, value }) }
    };
    let finite = |what: String, ok: bool| if ok { Ok(()) } else { Err(WorldError::PoseNotFinite { what }) };
    positive("table width".into(), spec.table.width_m)?;
    positive("table height".into(), spec.table.height_m)?;
    finite("base_from_table".into(), spec.base_from_table.to_homogeneous().iter().all(|v| v.is_finite()))?;
    let tool = spec.gripper.flange_from_tool.to_homogeneous();
    finite("flange_from_tool".into(), tool.iter().all(|v| v.is_finite()))?;
    for cup in &spec.gripper.cups {
        positive("cup diameter".into(), cup.diameter_m)?;
        finite("cup".into(), cup.x_m.is_finite() && cup.y_m.is_finite())?;
    }
    let (mut names, mut numbers) = (HashSet::new(), HashSet::new());
    let mut marker_used = |id: u32| {
        if numbers.insert(id) { Ok(()) } else { Err(WorldError::Twice { what: format!("marker {id}") }) }
    };
    for object in &spec.objects {
        positive(format!("{}: height", object.id), object.height_m)?;
        positive(format!("{}: mass", object.id), object.mass_kg)?;
        finite(object.id.clone(), object.pose.is_finite())?;
        if !names.insert(&object.id) {
            return Err(WorldError::Twice { what: format!("object {}", object.id) });
        }
        if let Some(marker) = &object.marker {
            positive(format!("{}: marker size", object.id), marker.size_m)?;
            finite(format!("{}: marker", object.id), marker.offset.is_finite())?;
            marker_used(marker.id)?;
        }
    }
    for marker in &spec.reference_markers {
        positive(format!("reference marker {}: size", marker.id), marker.size_m)?;
        finite(format!("reference marker {}", marker.id), marker.pose.is_finite())?;
        marker_used(marker.id)?;
    }
    if let Some(board) = &spec.hand_board {
        positive("hand board: size".into(), board.size_m)?;
        finite("hand board: gap".into(), board.gap_m.is_finite())?;
        let place = board.flange_from_board.to_homogeneous();
        finite("hand board".into(), place.iter().all(|v| v.is_finite()))?;
        hand_board::numbers(board).try_for_each(marker_used)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests;

/// A table with nothing on it and a one-cup gripper, for the tests of the servers.
#[cfg(test)]
pub(crate) fn empty_world(seed: u64) -> World {
    let spec = WorldSpec {
        table: TableSpec { width_m: 0.5, height_m: 0.5, margin_m: 0.1 },
        base_from_table: Isometry3::identity(),
        objects: Vec::new(),
        reference_markers: Vec::new(),
        errors: PlacementErrors::default(),
        gripper: tests::gripper(),
        hand_board: None,
    };
    World::new(spec, seed).expect("an empty table is a valid world")
}
