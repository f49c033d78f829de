//! Segments the arm can follow, and the check without which none reaches the robot.
//!
//! In: an [`ArmModel`] (calibrated kinematics, where the table and the tool are, limits), the joints the
//! path starts from, and [`Leg`]s (segment plus the lowest height the tool may reach on it). Out: a
//! [`CheckedPath`], whose only constructor is the check, or a [`PathFault`] that names leg, joint or height.
//! Pure. The controller interpolates; the check samples the same interpolation (joint-linear for `movej`,
//! tool-linear for `movel`) finely enough that nothing can hide between samples at the limits used here.

use cell_values::units::Joints;
use nalgebra::Isometry3;
use ur_arm::kinematics::{DhParameters, forward, inverse, inverse_near, link_frames, posture, unwind};
use ur_arm::pose::ur_pose_from_isometry;

/// Limits every path keeps; from the cell's configuration, none has a default.
#[derive(Clone, Debug, PartialEq)]
pub struct ArmLimits {
    /// Lowest and highest position of each joint, rad.
    pub joint_range: [(f64, f64); 6],
    /// Highest joint speed, rad/s.
    pub joint_speed: f64,
    /// Highest joint acceleration, rad/s2.
    pub joint_acceleration: f64,
    /// Highest tool speed on linear segments, m/s.
    pub tool_speed: f64,
    /// Highest tool acceleration on linear segments, m/s2.
    pub tool_acceleration: f64,
    /// Lowest height of elbow and wrist joints over the table, m.
    pub link_floor: f64,
}

/// Distances kept from the arm's singularities on linear segments, where joint speeds would run away
/// (reference: ur-interfaces 6.3). Joint segments cross them harmlessly.
const MIN_WRIST_SINE: f64 = 0.08;
const MIN_ELBOW_SINE: f64 = 0.08;
const MIN_SHOULDER_RADIUS_M: f64 = 0.15;

/// The arm as far as motion needs to know it.
#[derive(Clone, Debug, PartialEq)]
pub struct ArmModel {
    /// Calibrated kinematics, from the controller.
    pub dh: DhParameters,
    /// Where the table frame is in the base frame, from calibration.
    pub base_from_table: Isometry3<f64>,
    /// The tool frame (centre of the cup lips, z out of the gripper) in the flange frame.
    pub flange_from_tool: Isometry3<f64>,
    /// A taught posture over the table: work is done in its family of solutions (shoulder, elbow and wrist
    /// side), so that transfers never turn the arm inside out over the objects.
    pub home: Joints,
    /// Limits.
    pub limits: ArmLimits,
}

impl ArmModel {
    /// `base_from_flange` that brings the tool to `table_from_tool`.
    pub fn flange_at(&self, table_from_tool: &Isometry3<f64>) -> Isometry3<f64> {
        self.base_from_table * table_from_tool * self.flange_from_tool.inverse()
    }

    /// `table_from_tool` at joint positions `q`.
    pub fn tool_at(&self, q: &Joints) -> Isometry3<f64> {
        self.base_from_table.inverse() * forward(&self.dh, q) * self.flange_from_tool
    }

    /// Joints for a tool pose, nearest to `near` and inside the joint range.
    pub fn joints_at(&self, table_from_tool: &Isometry3<f64>, near: &Joints) -> Option<Joints> {
        inverse_near(&self.dh, &self.flange_at(table_from_tool), near, self.common_range())
            .filter(|q| self.outside_range(q).is_none())
    }

    /// As [`ArmModel::joints_at`], but only in the posture of `home`; joints 1 to 5 come as near to `home`
    /// as they can, and joint 6, which may wind up over many picks, as near to `near`.
    pub fn joints_in_work_posture(&self, table_from_tool: &Isometry3<f64>, near: &Joints) -> Option<Joints> {
        let wanted = posture(&self.dh, &self.home);
        let mut reference = self.home;
        reference.0[5] = near.0[5];
        inverse(&self.dh, &self.flange_at(table_from_tool))
            .into_iter()
            .filter(|q| posture(&self.dh, q) == wanted)
            .filter_map(|q| unwind(&q, &reference, self.common_range()))
            .find(|q| self.outside_range(q).is_none())
    }

    /// The widest range that all joints share at least partly; single joints are checked separately.
    pub fn common_range(&self) -> (f64, f64) {
        let range = &self.limits.joint_range;
        (
            range.iter().map(|r| r.0).fold(f64::INFINITY, f64::min),
            range.iter().map(|r| r.1).fold(f64::NEG_INFINITY, f64::max),
        )
    }

    /// The first joint outside its range (or not a number).
    pub fn outside_range(&self, q: &Joints) -> Option<usize> {
        (0..6).find(|&i| {
            let (low, high) = self.limits.joint_range[i];
            !(low..=high).contains(&q.0[i])
        })
    }
}

/// One piece of a path, as the on-robot program understands it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Segment {
    /// `movej`: straight in joint space. Speed rad/s, acceleration rad/s2, blend radius m.
    Joint {
        /// End of the segment.
        target: Joints,
        /// Leading joint's speed, rad/s.
        speed: f64,
        /// Leading joint's acceleration, rad/s2.
        acceleration: f64,
        /// Blend radius into the next segment, m; 0 stops at the end.
        blend: f64,
    },
    /// `movel`: the tool goes straight. Speed m/s, acceleration m/s2, blend radius m. The end is given in
    /// joints so that the branch of the inverse kinematics is never in doubt.
    Linear {
        /// End of the segment.
        target: Joints,
        /// Tool speed, m/s.
        speed: f64,
        /// Tool acceleration, m/s2.
        acceleration: f64,
        /// Blend radius into the next segment, m; 0 stops at the end.
        blend: f64,
    },
}

impl Segment {
    /// The joints the segment ends at.
    pub fn target(&self) -> Joints {
        match self {
            Segment::Joint { target, .. } | Segment::Linear { target, .. } => *target,
        }
    }

    /// Blend radius, m.
    pub fn blend(&self) -> f64 {
        match self {
            Segment::Joint { blend, .. } | Segment::Linear { blend, .. } => *blend,
        }
    }
}

/// A segment and the lowest height (table frame, m) the tool's tip may have on it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Leg {
    /// The segment.
    pub segment: Segment,
    /// Lowest tip height, m over the table.
    pub floor: f64,
}

/// Why a path was refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PathFault {
    /// No joint solution, or none inside the joint range.
    #[error("{what}: tool pose ({x:.3}, {y:.3}, {z:.3}) m over the table is out of the arm's reach")]
    OutOfReach {
        /// Which pose.
        what: String,
        /// Position in the table frame, m.
        x: f64,
        /// Position in the table frame, m.
        y: f64,
        /// Position in the table frame, m.
        z: f64,
    },
    /// A joint leaves its range.
    #[error("leg {leg}: joint {joint} at {at_deg:.1} degrees is outside its range")]
    JointRange {
        /// Index of the leg.
        leg: usize,
        /// Joint number, 1 to 6.
        joint: usize,
        /// Where it would be, degrees.
        at_deg: f64,
    },
    /// The tool would go too low.
    #[error(
        "leg {leg}: the tool would be {height_mm:.1} mm over the table, {floor_mm:.1} mm is the floor there"
    )]
    TooLow {
        /// Index of the leg.
        leg: usize,
        /// Height reached, mm.
        height_mm: f64,
        /// Height allowed, mm.
        floor_mm: f64,
    },
    /// Elbow or wrist would come too near to the table.
    #[error("leg {leg}: link {link} would be {height_mm:.1} mm over the table")]
    LinkTooLow {
        /// Index of the leg.
        leg: usize,
        /// Link number, 2 to 6.
        link: usize,
        /// Height reached, mm.
        height_mm: f64,
    },
    /// A linear segment passes too near to a singularity, or jumps between branches.
    #[error("leg {leg}: a straight line here passes too near to a {which} singularity")]
    Singular {
        /// Index of the leg.
        leg: usize,
        /// wrist, elbow or shoulder.
        which: &'static str,
    },
    /// Speed, acceleration or blend is not a number in its limits.
    #[error("leg {leg}: {what} is {value}, outside (0, {limit}]")]
    Limit {
        /// Index of the leg.
        leg: usize,
        /// Which number.
        what: &'static str,
        /// Its value, SI.
        value: f64,
        /// Its limit, SI.
        limit: f64,
    },
    /// A path has to have at least one leg.
    #[error("the path is empty")]
    Empty,
}

/// A path that passed the check: the only thing the robot session accepts.
#[derive(Clone, Debug, PartialEq)]
pub struct CheckedPath {
    start: Joints,
    segments: Vec<Segment>,
}

impl CheckedPath {
    /// Checks `legs` from `start` on; see the module for what is checked.
    ///
    /// # Errors
    /// The first fault along the path.
    pub fn new(model: &ArmModel, start: &Joints, legs: &[Leg]) -> Result<CheckedPath, PathFault> {
        if legs.is_empty() {
            return Err(PathFault::Empty);
        }
        let mut from = *start;
        for (index, leg) in legs.iter().enumerate() {
            check_numbers(model, index, &leg.segment)?;
            match leg.segment {
                Segment::Joint { target, .. } => check_joint_leg(model, index, &from, &target, leg.floor)?,
                Segment::Linear { target, .. } => check_linear_leg(model, index, &from, &target, leg.floor)?,
            }
            from = leg.segment.target();
        }
        Ok(CheckedPath { start: *start, segments: legs.iter().map(|leg| leg.segment).collect() })
    }

    /// Where the arm has to be when the path begins.
    pub fn start(&self) -> Joints {
        self.start
    }

    /// Where the arm is at its end.
    pub fn end(&self) -> Joints {
        self.segments.last().map_or(self.start, Segment::target)
    }

    /// The segments in order.
    pub fn segments(&self) -> &[Segment] {
        &self.segments
    }
}

fn check_numbers(model: &ArmModel, leg: usize, segment: &Segment) -> Result<(), PathFault> {
    let limits = &model.limits;
    let (speed, acceleration, blend, speed_limit, acceleration_limit) = match *segment {
        Segment::Joint { speed, acceleration, blend, .. } => {
            (speed, acceleration, blend, limits.joint_speed, limits.joint_acceleration)
        }
        Segment::Linear { speed, acceleration, blend, .. } => {
            (speed, acceleration, blend, limits.tool_speed, limits.tool_acceleration)
        }
    };
    let within = |what, value: f64, limit: f64| {
        let inside = value > 0.0 && value <= limit;
        if inside { Ok(()) } else { Err(PathFault::Limit { leg, what, value, limit }) }
    };
    within("speed", speed, speed_limit)?;
    within("acceleration", acceleration, acceleration_limit)?;
    if (0.0..=0.5).contains(&blend) {
        Ok(())
    } else {
        Err(PathFault::Limit { leg, what: "blend radius", value: blend, limit: 0.5 })
    }
}

/// Joint step between samples, rad: 0.02 rad at 0.9 m reach is 18 mm of travel and, on the arc between two
/// samples, less than 0.05 mm of sag.
const SAMPLE_RAD: f64 = 0.02;

fn check_joint_leg(
    model: &ArmModel,
    leg: usize,
    from: &Joints,
    to: &Joints,
    floor: f64,
) -> Result<(), PathFault> {
    let samples = (from.max_difference(to) / SAMPLE_RAD).ceil().clamp(1.0, 2_000.0) as usize;
    for k in 0..=samples {
        let share = k as f64 / samples as f64;
        let q = Joints(std::array::from_fn(|i| from.0[i] + share * (to.0[i] - from.0[i])));
        check_place(model, leg, &q, floor)?;
    }
    Ok(())
}

/// Tool travel between samples of a linear leg, m.
const SAMPLE_M: f64 = 0.01;

fn check_linear_leg(
    model: &ArmModel,
    leg: usize,
    from: &Joints,
    to: &Joints,
    floor: f64,
) -> Result<(), PathFault> {
    let (start, end) = (model.tool_at(from), model.tool_at(to));
    let travel = (end.translation.vector - start.translation.vector).norm();
    let turn = start.rotation.angle_to(&end.rotation);
    let samples = (travel / SAMPLE_M + turn / 0.05).ceil().clamp(1.0, 500.0) as usize;
    let mut near = *from;
    for k in 0..=samples {
        let share = k as f64 / samples as f64;
        let rotation = start.rotation.try_slerp(&end.rotation, share, 1e-9).unwrap_or(end.rotation);
        let position = start.translation.vector.lerp(&end.translation.vector, share);
        let tool = Isometry3::from_parts(position.into(), rotation);
        let q = model.joints_at(&tool, &near).ok_or_else(|| out_of_reach("on a straight line", &tool))?;
        // A continuous solution moves little from sample to sample; a jump means the branches met.
        if q.max_difference(&near) > 0.35 {
            return Err(PathFault::Singular { leg, which: "shoulder" });
        }
        check_singular(model, leg, &q)?;
        check_place(model, leg, &q, floor)?;
        near = q;
    }
    // The controller follows the same branch: it has to arrive at the joints that were requested.
    if near.max_difference(to) > 1e-3 { Err(PathFault::Singular { leg, which: "wrist" }) } else { Ok(()) }
}

/// Names the position of a pose that no joint solution reaches.
pub fn out_of_reach(what: &str, table_from_tool: &Isometry3<f64>) -> PathFault {
    let [x, y, z, ..] = ur_pose_from_isometry(table_from_tool);
    PathFault::OutOfReach { what: what.to_string(), x, y, z }
}

fn check_singular(model: &ArmModel, leg: usize, q: &Joints) -> Result<(), PathFault> {
    let wrist = forward(&model.dh, q) * nalgebra::Point3::new(0.0, 0.0, -model.dh.d[5]);
    if q.0[4].sin().abs() < MIN_WRIST_SINE {
        Err(PathFault::Singular { leg, which: "wrist" })
    } else if q.0[2].sin().abs() < MIN_ELBOW_SINE {
        Err(PathFault::Singular { leg, which: "elbow" })
    } else if wrist.x.hypot(wrist.y) < MIN_SHOULDER_RADIUS_M {
        Err(PathFault::Singular { leg, which: "shoulder" })
    } else {
        Ok(())
    }
}

fn check_place(model: &ArmModel, leg: usize, q: &Joints, floor: f64) -> Result<(), PathFault> {
    if let Some(joint) = model.outside_range(q) {
        return Err(PathFault::JointRange { leg, joint: joint + 1, at_deg: q.0[joint].to_degrees() });
    }
    let height = model.tool_at(q).translation.vector.z;
    if height < floor - 1e-6 {
        return Err(PathFault::TooLow { leg, height_mm: height * 1e3, floor_mm: floor * 1e3 });
    }
    let table_from_base = model.base_from_table.inverse();
    for (link, frame) in link_frames(&model.dh, q).iter().enumerate().skip(1) {
        let height = (table_from_base * frame).translation.vector.z;
        if height < model.limits.link_floor {
            return Err(PathFault::LinkTooLow { leg, link: link + 1, height_mm: height * 1e3 });
        }
    }
    Ok(())
}
