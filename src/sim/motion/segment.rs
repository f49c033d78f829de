//! One piece of motion: a straight line in joint space or in tool space, or the run-out of a speed.
//!
//! In: where it starts and ends, and a [`Profile`]. Out: joint positions at any time of it. A line in tool
//! space moves the TCP straight and turns it by the shortest rotation, both in step; its joint positions
//! follow frame by frame from the last ones, so it never changes the arm's posture.

use crate::geometry::pose::ur_pose_from_isometry;
use crate::sim::motion::profile::{Profile, Shape};
use crate::sim::motion::{Arm, MotionFault};
use crate::units::Joints;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

/// Metres of a tool move that one radian of turning counts as, where turning takes longer than travelling.
const METRES_PER_RADIAN: f64 = 0.25;

/// Points at which a tool line is tried before it starts, per metre or radian of it.
const PROBES_PER_UNIT: f64 = 100.0;

/// Speeds and accelerations of a move, SI; a `seconds` above 0 overrides them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MoveLimits {
    /// Acceleration of the leading joint (rad/s2) or the tool (m/s2).
    pub acceleration: f64,
    /// Speed of the leading joint (rad/s) or the tool (m/s).
    pub speed: f64,
    /// Duration, s; 0 for as fast as the two above allow.
    pub seconds: f64,
    /// Blend radius round the target, m.
    pub blend: f64,
}

/// Where a segment leads.
#[derive(Clone, Debug)]
enum Course {
    Joint { from: Joints, delta: [f64; 6] },
    Line { from: Isometry3<f64>, travel: Vector3<f64>, turn: Vector3<f64>, last: Joints },
    RunOut { from: Joints, speed: [f64; 6], seconds: f64 },
}

/// A piece of motion.
#[derive(Clone, Debug)]
pub struct Segment {
    course: Course,
    profile: Profile,
    target: Joints,
}

impl Segment {
    /// A line in joint space. `lead` is the time the predecessor still needs.
    pub fn joint(arm: &Arm, from: &Joints, to: &Joints, limits: &MoveLimits, lead: f64) -> Segment {
        let delta: [f64; 6] = std::array::from_fn(|i| to.0[i] - from.0[i]);
        let length = delta.iter().fold(0.0f64, |longest, value| longest.max(value.abs()));
        let blend =
            if limits.blend > 0.0 { length * joint_blend(arm, from, &delta, to, limits.blend) } else { 0.0 };
        let profile = profile(length, limits, blend, lead);
        Segment { course: Course::Joint { from: *from, delta }, profile, target: *to }
    }

    /// A line in tool space.
    ///
    /// # Errors
    /// When the line leads out of reach or through a singularity.
    pub fn line(
        arm: &Arm,
        from: &Joints,
        to: &Isometry3<f64>,
        limits: &MoveLimits,
        lead: f64,
    ) -> Result<Segment, MotionFault> {
        let start = arm.tcp(from);
        let travel = to.translation.vector - start.translation.vector;
        let turn = (start.rotation.inverse() * to.rotation).scaled_axis();
        let distance = travel.norm();
        let length = distance.max(turn.norm() * METRES_PER_RADIAN);
        let course = Course::Line { from: start, travel, turn, last: *from };
        let target = probe(arm, from, &start, &travel, &turn)?;
        let near_target = if distance > 1e-9 { (limits.blend / distance).min(0.5) } else { 0.5 };
        let blend = if limits.blend > 0.0 { length * near_target } else { 0.0 };
        Ok(Segment { course, profile: profile(length, limits, blend, lead), target })
    }

    /// The way on from `speed` (rad/s) until all joints have stopped together, the fastest of them braking
    /// at `acceleration`.
    pub fn run_out(from: &Joints, speed: &[f64; 6], acceleration: f64) -> Segment {
        let fastest = speed.iter().fold(0.0f64, |fastest, value| fastest.max(value.abs()));
        let seconds = fastest / acceleration;
        let target = Joints(std::array::from_fn(|i| from.0[i] + speed[i] * seconds / 2.0));
        let unit = Shape { length: 1.0, speed: 1.0, acceleration: 1.0, blend: 0.0, lead: 0.0 };
        let profile = Profile::new(&unit).lasting(seconds.max(1e-9));
        Segment { course: Course::RunOut { from: *from, speed: *speed, seconds }, profile, target }
    }

    /// Where it ends.
    pub fn target(&self) -> Joints {
        self.target
    }

    /// How long it takes, s.
    pub fn duration(&self) -> f64 {
        self.profile.duration()
    }

    /// When the successor may start, s.
    pub fn release(&self) -> f64 {
        self.profile.release()
    }

    /// Joint positions at `time` (s); later than the end is the end.
    ///
    /// # Errors
    /// When the tool cannot be kept on its line.
    pub fn position(&mut self, arm: &Arm, time: f64) -> Result<Joints, MotionFault> {
        if time >= self.profile.duration() {
            return Ok(self.target);
        }
        let fraction = self.profile.fraction(time);
        Ok(match &mut self.course {
            Course::Joint { from, delta } => Joints(std::array::from_fn(|i| from.0[i] + delta[i] * fraction)),
            Course::Line { from, travel, turn, last } => {
                *last =
                    arm.follow(&along(from, travel, turn, fraction), last).ok_or(MotionFault::Unreachable)?;
                *last
            }
            Course::RunOut { from, speed, seconds } => {
                let t = time.min(*seconds);
                let travelled = t - t * t / (2.0 * *seconds);
                Joints(std::array::from_fn(|i| from.0[i] + speed[i] * travelled))
            }
        })
    }

    /// Pose of the TCP where it ends, as the controller writes it.
    pub fn target_pose(&self, arm: &Arm) -> [f64; 6] {
        ur_pose_from_isometry(&arm.tcp(&self.target))
    }
}

fn profile(length: f64, limits: &MoveLimits, blend: f64, lead: f64) -> Profile {
    let shape = Shape { length, speed: limits.speed, acceleration: limits.acceleration, blend, lead };
    let natural = Profile::new(&shape);
    if limits.seconds > 0.0 { natural.lasting(limits.seconds) } else { natural }
}

fn along(from: &Isometry3<f64>, travel: &Vector3<f64>, turn: &Vector3<f64>, fraction: f64) -> Isometry3<f64> {
    Isometry3::from_parts(
        Translation3::from(from.translation.vector + travel * fraction),
        from.rotation * UnitQuaternion::from_scaled_axis(turn * fraction),
    )
}

/// Follows a tool line to its end in coarse steps: its last joint positions.
fn probe(
    arm: &Arm,
    from: &Joints,
    start: &Isometry3<f64>,
    travel: &Vector3<f64>,
    turn: &Vector3<f64>,
) -> Result<Joints, MotionFault> {
    let steps = ((travel.norm() + turn.norm()) * PROBES_PER_UNIT).ceil().clamp(1.0, 2000.0) as u32;
    let mut q = *from;
    for step in 1..=steps {
        let pose = along(start, travel, turn, f64::from(step) / f64::from(steps));
        q = arm.follow(&pose, &q).ok_or(MotionFault::Unreachable)?;
        if let Some(joint) = arm.outside(&q) {
            return Err(MotionFault::JointRange { joint, position: q.0[joint] });
        }
    }
    Ok(q)
}

/// Fraction of a joint move, from its end, during which the TCP is within `radius` (m) of its target; at
/// most one half.
fn joint_blend(arm: &Arm, from: &Joints, delta: &[f64; 6], to: &Joints, radius: f64) -> f64 {
    let target = arm.tcp(to).translation.vector;
    let distance = |fraction: f64| {
        let q = Joints(std::array::from_fn(|i| from.0[i] + delta[i] * (1.0 - fraction)));
        (arm.tcp(&q).translation.vector - target).norm()
    };
    let outside = (1..=32).map(|k| f64::from(k) / 64.0).find(|fraction| distance(*fraction) > radius);
    let Some(mut outside) = outside else { return 0.5 };
    let mut inside = outside - 1.0 / 64.0;
    for _ in 0..20 {
        let middle = (inside + outside) / 2.0;
        if distance(middle) > radius {
            outside = middle;
        } else {
            inside = middle;
        }
    }
    inside
}
