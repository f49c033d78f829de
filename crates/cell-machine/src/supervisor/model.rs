//! What the supervisor knows of its cell: the table, the objects on it, the arm, the limits.
//!
//! In: checked configuration, calibration, and the kinematics that the controller reported. Out: plain data.
//! Lengths in m, angles in rad, masses in kg.

use crate::device::gripper_types::Channels;
use crate::orders::ConfirmedGripper;
use crate::supervisor::round::RoundOrder;
use crate::views::{Rig, SightModel, Views};
use cell_calibration::files::hand_eye::Mount;
use cell_motion::path::ArmModel;
use cell_motion::pick_n_place::{CycleParameters, PickNPlace};
use cell_values::time::Duration;
use cell_values::units::Joints;
use cell_vision::observe::reference::DriftLimits;
use nalgebra::{Isometry3, Vector3};
use rearrange::geometry::footprint::Footprint;
use rearrange::geometry::pose::Pose2;
use rearrange::tabletop::instance::{KeepOut, MarkerSpec, Workspace};
use serde::{Deserialize, Serialize};

/// One kind of thing the cell may move.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct CellObject {
    /// Name, as in jobs.
    pub id: String,
    /// Its group: members are interchangeable in rules.
    pub group: Option<String>,
    /// Shape on the table.
    pub footprint: Footprint,
    /// Cost of one move under TI; default: footprint area.
    pub impedance: Option<f64>,
    /// Height, m.
    pub height: f64,
    /// Mass, kg.
    pub mass: f64,
    /// The marker on its top.
    pub marker: MarkerSpec,
    /// Where the tool's axis meets the object, object frame, m.
    pub grip_point: [f64; 2],
    /// Tool yaw in the object frame the cups need; `None` when any will do.
    pub grip_yaw: Option<f64>,
    /// Largest acceleration of the tool at which the cups hold it, m/s2.
    pub hold: f64,
}

impl CellObject {
    /// This object's pick-n-place from one pose to another.
    pub fn pick_n_place(&self, from: Pose2, to: Pose2) -> PickNPlace {
        PickNPlace {
            object: self.id.clone(),
            footprint: self.footprint.clone(),
            from,
            to,
            grip_point: self.grip_point,
            grip_yaw: self.grip_yaw,
            height: self.height,
            hold: self.hold,
        }
    }
}

/// Numbers the supervisor decides by; from the configuration.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Tolerances {
    /// An object within this distance of its goal counts as there, m.
    pub goal_position: f64,
    /// And within this angle, rad.
    pub goal_angle: f64,
    /// A picked-up object may be this far from where the plan expects it before a new plan is made, m.
    pub expected_position: f64,
    /// And this angle, rad.
    pub expected_angle: f64,
    /// What was seen longer ago than this is not acted upon.
    pub observation_age: Duration,
    /// The whole table is looked at again after so many pick-n-places.
    pub full_look_every: u32,
    /// Larger errors of the reference markers than these mean that camera or table were moved.
    pub reference: DriftLimits,
    /// Fewer reference markers in a look than this say nothing about that.
    pub reference_seen: usize,
    /// An object whose position is less certain than this is looked at again, m (one standard deviation).
    pub measurement_std: f64,
    /// How often a failed grip, an incomplete look or a disturbed table is tried again before the job fails.
    pub retries: u32,
    /// How often a job goes on after a lost object or a missed heartbeat, once a person has armed the cell,
    /// before such a stop ends it.
    pub stop_retries: u32,
    /// How long the arm has to be at rest before a frame counts.
    pub settle: Duration,
    /// Deadline of one look pose: motion, settling and frames together.
    pub look_deadline: Duration,
    /// Deadline of one motion or gripper phase at full speed.
    pub phase_deadline: Duration,
    /// Arming lapses after this long without motion.
    pub arm_lapse: Duration,
    /// Added to a plan's own time limit before the planner counts as stuck.
    pub plan_grace: Duration,
}

/// What is done about things on the table that carry no marker.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
pub enum ForeignRule {
    /// They are not looked for.
    Off,
    /// Nothing is moved while there is one.
    Refuse {
        /// A look without depth is refused too; otherwise a camera that has no depth is no fault.
        depth_needed: bool,
    },
    /// They are obstacles like any that never move, with this much room round them, m. Depth is needed.
    Obstacle {
        /// Room round the outline, and above it, m.
        margin_m: f64,
    },
}

/// The gripper as the supervisor uses it.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct GripSettings {
    /// Channels whose cups are used.
    pub channels: Channels,
    /// Relative vacuum requested, 0..0.8.
    pub vacuum_target: f64,
    /// Radius about the tool's axis of the gripper's body, m.
    pub body_radius: f64,
    /// Underside of the body over the cup lips, m.
    pub body_above_lips: f64,
    /// Mass of the gripper with camera, kg.
    pub tool_mass: f64,
    /// Its centre of gravity in the flange frame, m.
    pub tool_centre: Vector3<f64>,
}

/// A job that was cut off in the middle of a pick-n-place when an earlier celld ended.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub struct CutOff {
    /// What was to be moved.
    pub object: String,
    /// It was gripped, and not let go.
    pub carrying: bool,
    /// One sentence.
    pub message: String,
}

/// An object that was gripped when an earlier celld ended.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
pub struct HeldBefore {
    /// Its name.
    pub object: String,
    /// Where it was to go, table frame.
    pub to: Pose2,
    /// How it hangs on the tool, seen from above; `None` where that was not written down.
    pub tool_from_object: Option<Pose2>,
    /// Where each object was seen last before it was gripped.
    pub table: Vec<(String, Pose2)>,
}

/// Where the devices are, for the sentences about waiting for them.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub struct DeviceAddresses {
    /// Host of the controller.
    pub robot: String,
    /// Host, port and unit of the gripper's Compute Box.
    pub gripper: String,
}

/// The cell.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct CellModel {
    /// Where the devices are.
    pub addresses: DeviceAddresses,
    /// Which gripper a person has confirmed.
    pub confirmed: ConfirmedGripper,
    /// What an earlier celld gripped and did not release; it counts as held while the vacuum holds it.
    pub held_before: Option<HeldBefore>,
    /// The job that was cut off when an earlier celld ended: a stop that is still to be left.
    pub cut_off: Option<CutOff>,
    /// The highest number of a plan that an earlier celld made for a job that is kept: later ones go on from
    /// it, so that no person agrees to another plan by an old number.
    pub plans_before: u64,
    /// Arm, table pose and limits.
    pub arm: ArmModel,
    /// Heights and speeds of a cycle; `tallest` covers every object of the catalogue.
    pub cycle: CycleParameters,
    /// Where the camera sits, from calibration.
    pub mount: Mount,
    /// Joint poses that together see the whole table.
    pub look_poses: Vec<Joints>,
    /// Frames taken at each look pose.
    pub frames_per_view: usize,
    /// For looks at a part of the table; `None` where every look goes round the look poses: with a camera
    /// that stands, or where colours are compared with pictures of the empty table from those poses.
    pub sight: Option<SightModel>,
    /// Where the arm rests.
    pub park: Joints,
    /// Where a calibration round goes that a person orders; no poses: there is none.
    pub round: RoundOrder,
    /// Size of the table's work area.
    pub workspace: Workspace,
    /// Gap kept round every new place, m.
    pub clearance: f64,
    /// Where nothing may be put: keep-out regions and objects that never move.
    pub keep_out: Vec<KeepOut>,
    /// Markers in view that belong to nothing on the table.
    pub ignore_markers: Vec<u32>,
    /// What may be moved.
    pub objects: Vec<CellObject>,
    /// What is done about things without a marker.
    pub foreign: ForeignRule,
    /// Limits of decisions.
    pub tolerances: Tolerances,
    /// The gripper.
    pub grip: GripSettings,
}

impl CellModel {
    /// The object with this name.
    pub fn object(&self, id: &str) -> Option<&CellObject> {
        self.objects.iter().find(|object| object.id == id)
    }

    /// `table_from_camera` with the arm at `q`.
    pub fn camera_at(&self, q: &Joints) -> Isometry3<f64> {
        self.rig().camera_at(q)
    }

    /// The arm with its camera over the table.
    pub fn rig(&self) -> Rig<'_> {
        let table = [self.workspace.width, self.workspace.height];
        Rig { arm: &self.arm, mount: &self.mount, cycle: &self.cycle, look_poses: &self.look_poses, table }
    }

    /// Where the arm is when a pick-n-place begins: at the last look pose, for each begins with a look.
    pub fn after_a_look(&self) -> Joints {
        self.look_poses.last().copied().unwrap_or(self.arm.home)
    }

    /// The poses for looks at parts of the table; `None` where there are none.
    pub fn views(&self) -> Option<&Views> {
        let sight = self.sight.as_ref()?;
        Some(sight.views.get_or_init(|| Views::new(&self.rig(), sight))).filter(|views| !views.is_empty())
    }

    /// True when `pose` counts as being at `goal`.
    pub fn at_goal(&self, pose: &Pose2, goal: &Pose2) -> bool {
        pose.distance(goal) <= self.tolerances.goal_position
            && pose.angle_difference(goal) <= self.tolerances.goal_angle
    }
}
