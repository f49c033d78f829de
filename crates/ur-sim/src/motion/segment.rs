//! One piece of motion: a straight line in joint space, a way of the tool, or the run-out of a speed.
//!
//! In: where it starts and ends, and a [`Profile`]. Out: joint positions at any time of it. The joint
//! positions of a [`ToolPath`] follow frame by frame from the last ones, so it never changes the arm's
//! posture.

use crate::motion::profile::{Profile, Shape};
use crate::motion::rounding::Rounding;
use crate::motion::tool_path::ToolPath;
use crate::motion::{Arm, FRAME_SECONDS, MotionFault};
use cell_values::units::Joints;
use nalgebra::{Unit, Vector3};

/// Points at which a way of the tool is tried before it starts, per metre or radian of it.
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
    /// It is not braked before the blend.
    pub keeps: bool,
}

/// How a segment begins.
#[derive(Clone, Copy, Debug)]
pub enum Start {
    /// From rest, or within the time (s) the predecessor still needs.
    Lead(f64),
    /// At this speed, of the leading joint (rad/s) or the tool (m/s).
    Motion(f64),
}

/// Where a segment leads.
#[derive(Clone, Debug)]
enum Course {
    Joint { from: Joints, delta: [f64; 6] },
    Tool { path: ToolPath, last: Joints },
    RunOut { from: Joints, speed: [f64; 6], seconds: f64 },
}

/// A piece of motion.
#[derive(Clone, Debug)]
pub struct Segment {
    /// A rounded corner that comes before all the rest.
    corner: Option<Rounding>,
    course: Course,
    profile: Profile,
    target: Joints,
    /// A successor may take over in full motion.
    constant_speed: bool,
    /// The ordered speed of a line of the tool, m/s.
    line_speed: Option<f64>,
}

/// How a segment whose successor takes over moves at that moment.
#[derive(Clone, Copy, Debug)]
pub struct Handover {
    /// Where the tool is heading.
    pub direction: Unit<Vector3<f64>>,
    /// How far it has to its target, m.
    pub ahead: f64,
    /// m/s
    pub speed: f64,
}

impl Segment {
    /// A line in joint space.
    pub fn joint(arm: &Arm, from: &Joints, to: &Joints, limits: &MoveLimits, start: Start) -> Segment {
        let delta: [f64; 6] = std::array::from_fn(|i| to.0[i] - from.0[i]);
        let length = delta.iter().fold(0.0f64, |longest, value| longest.max(value.abs()));
        let blend =
            if limits.blend > 0.0 { length * joint_blend(arm, from, &delta, to, limits.blend) } else { 0.0 };
        // No joint may be faster than it can, also where another one leads.
        let slowest = delta.iter().zip(arm.joint_speed).filter(|(way, _)| way.abs() > 0.0);
        let most = slowest.map(|(way, most)| most * length / way.abs()).fold(f64::INFINITY, f64::min);
        let speed = limits.speed.min(most);
        let mut profile = profile(length, &MoveLimits { speed, ..*limits }, blend, start);
        // A duration in which they cannot do it is stretched: the controller slows down and says nothing.
        let too_fast = profile.top_speed() / most;
        if too_fast > 1.0 {
            let seconds = profile.duration() * too_fast;
            profile = profile.lasting(seconds);
        }
        let course = Course::Joint { from: *from, delta };
        Segment { corner: None, course, profile, target: *to, constant_speed: false, line_speed: None }
    }

    /// A way of the tool from `from`, where `path` starts.
    ///
    /// # Errors
    /// When the way leads out of reach or through a singularity.
    pub fn tool(
        arm: &Arm,
        from: &Joints,
        path: ToolPath,
        limits: &MoveLimits,
        start: Start,
    ) -> Result<Segment, MotionFault> {
        Segment::along(arm, from, path, limits, start, false)
    }

    /// The same for a process move, whose successor takes over where its blend begins; it may have
    /// taken over itself.
    ///
    /// # Errors
    /// As for [`Segment::tool`].
    pub fn process(
        arm: &Arm,
        from: &Joints,
        path: ToolPath,
        limits: &MoveLimits,
        start: Start,
    ) -> Result<Segment, MotionFault> {
        Segment::along(arm, from, path, limits, start, true)
    }

    fn along(
        arm: &Arm,
        from: &Joints,
        path: ToolPath,
        limits: &MoveLimits,
        start: Start,
        constant_speed: bool,
    ) -> Result<Segment, MotionFault> {
        let (target, quickest) = probe(arm, from, &path)?;
        let (distance, length) = (path.travel(), path.length());
        // A process move is handed over on the straight piece at its end.
        let straight = path.final_line().map_or(0.0, |(_, length)| length);
        let radius = if constant_speed { limits.blend.min(straight) } else { limits.blend };
        let near_target = if distance > 1e-9 { (radius / distance).min(0.5) } else { 0.5 };
        let blend = if radius > 0.0 { length * near_target } else { 0.0 };
        let profile = match start {
            Start::Lead(lead) => within_joints(length, limits, blend, lead, quickest),
            Start::Motion(entry) => {
                // Where the tool mostly turns, the length is longer than the way.
                let entry = entry * length / distance.max(1e-9);
                profile(length, limits, blend, Start::Motion(entry))
            }
        };
        let course = Course::Tool { path, last: *from };
        let line_speed = Some(limits.speed).filter(|_| !constant_speed && limits.seconds <= 0.0);
        Ok(Segment { corner: None, course, profile, target, constant_speed, line_speed })
    }

    /// The way on from `speed` (rad/s) until all joints have stopped together, the fastest of them braking
    /// at `acceleration`.
    pub fn run_out(from: &Joints, speed: &[f64; 6], acceleration: f64) -> Segment {
        let fastest = speed.iter().fold(0.0f64, |fastest, value| fastest.max(value.abs()));
        let seconds = fastest / acceleration;
        let target = Joints(std::array::from_fn(|i| from.0[i] + speed[i] * seconds / 2.0));
        let unit = MoveLimits { acceleration: 1.0, speed: 1.0, seconds: 0.0, blend: 0.0, keeps: false };
        let profile = profile(1.0, &unit, 0.0, Start::Lead(0.0)).lasting(seconds.max(1e-9));
        let course = Course::RunOut { from: *from, speed: *speed, seconds };
        Segment { corner: None, course, profile, target, constant_speed: false, line_speed: None }
    }

    /// The same after a rounded corner that ends where it begins.
    pub fn after(self, corner: Rounding) -> Segment {
        Segment { corner: Some(corner), ..self }
    }

    /// How long its rounded corner takes, s.
    pub fn corner_seconds(&self) -> f64 {
        self.corner.as_ref().map_or(0.0, Rounding::seconds)
    }

    /// The ordered speed of a line of the tool, m/s; none for other moves and where a duration is ordered.
    pub fn line_speed(&self) -> Option<f64> {
        self.line_speed
    }

    /// Where it ends.
    pub fn target(&self) -> Joints {
        self.target
    }

    /// How long it takes, s.
    pub fn duration(&self) -> f64 {
        self.corner_seconds() + self.profile.duration()
    }

    /// When the successor may start, s.
    pub fn release(&self) -> f64 {
        self.corner_seconds() + self.profile.release()
    }

    /// Joint positions at `time` (s); later than the end is the end.
    ///
    /// # Errors
    /// When the tool cannot be kept on its line.
    pub fn position(&mut self, arm: &Arm, time: f64) -> Result<Joints, MotionFault> {
        if let Some(corner) = self.corner.as_ref().filter(|corner| time < corner.seconds()) {
            return Ok(corner.at(time));
        }
        let time = time - self.corner_seconds();
        if time >= self.profile.duration() {
            return Ok(self.target);
        }
        let fraction = self.profile.fraction(time);
        Ok(match &mut self.course {
            Course::Joint { from, delta } => Joints(std::array::from_fn(|i| from.0[i] + delta[i] * fraction)),
            Course::Tool { path, last } => {
                *last = arm.follow(&path.pose(fraction), last).ok_or(MotionFault::Unreachable)?;
                *last
            }
            Course::RunOut { from, speed, seconds } => {
                let t = time.min(*seconds);
                let travelled = t - t * t / (2.0 * *seconds);
                Joints(std::array::from_fn(|i| from.0[i] + speed[i] * travelled))
            }
        })
    }

    /// How a process move can be taken over at `time` (s); `None` before its blend begins and for other
    /// moves.
    pub fn handover(&self, time: f64) -> Option<Handover> {
        let Course::Tool { path, .. } = &self.course else { return None };
        let blends = self.release() < self.duration() && time + FRAME_SECONDS >= self.release();
        if !self.constant_speed || !blends || time <= 0.0 {
            return None;
        }
        let step = FRAME_SECONDS.min(time);
        let (now, before) = (self.profile.fraction(time), self.profile.fraction(time - step));
        let speed = (now - before) * path.travel() / step;
        let ahead = (1.0 - now) * path.travel();
        let (direction, _) = path.final_line()?;
        (speed > 1e-4).then_some(Handover { direction, ahead, speed })
    }
}

fn profile(length: f64, limits: &MoveLimits, blend: f64, start: Start) -> Profile {
    let MoveLimits { speed, acceleration, keeps, .. } = *limits;
    let (lead, entry) = match start {
        Start::Lead(lead) => (lead, 0.0),
        Start::Motion(entry) => (0.0, entry),
    };
    let shape = Shape { length, speed, acceleration, blend, lead, keeps, entry };
    let natural = Profile::new(&shape);
    if limits.seconds > 0.0 { natural.lasting(limits.seconds) } else { natural }
}

/// The same for a way of the tool that the joints cannot pass in less than `quickest` (s) at constant speed.
/// A duration that is too short for them is stretched, though never beyond what the move takes without one:
/// what is too fast then leads past a singularity.
fn within_joints(length: f64, limits: &MoveLimits, blend: f64, lead: f64, quickest: f64) -> Profile {
    let start = Start::Lead(lead);
    let wanted = profile(length, limits, blend, start);
    let too_fast = wanted.top_speed() * quickest / length.max(1e-9);
    if limits.seconds <= 0.0 || too_fast <= 1.0 {
        return wanted;
    }
    let natural = profile(length, &MoveLimits { seconds: 0.0, ..*limits }, blend, start).duration();
    let (requested, possible) = (wanted.duration(), wanted.duration() * too_fast);
    wanted.lasting(possible.min(natural.max(requested)))
}

/// Follows a way of the tool to its end in coarse steps: its last joint positions, and the shortest time (s)
/// in which the joints can pass it at constant speed.
fn probe(arm: &Arm, from: &Joints, path: &ToolPath) -> Result<(Joints, f64), MotionFault> {
    let steps = ((path.travel() + path.turning()) * PROBES_PER_UNIT).ceil().clamp(1.0, 2000.0) as u32;
    let mut q = *from;
    let mut quickest = 0.0f64;
    for step in 1..=steps {
        let next =
            arm.follow(&path.pose(f64::from(step) / f64::from(steps)), &q).ok_or(MotionFault::Unreachable)?;
        if let Some(joint) = arm.outside(&next) {
            return Err(MotionFault::JointRange { joint, position: next.0[joint] });
        }
        for (joint, most) in arm.joint_speed.iter().enumerate() {
            quickest = quickest.max((next.0[joint] - q.0[joint]).abs() / most * f64::from(steps));
        }
        q = next;
    }
    Ok((q, quickest))
}

/// Fraction of a joint move, from its end, during which the TCP is within `radius` (m) of its target; at
/// most one half.
pub(super) fn joint_blend(arm: &Arm, from: &Joints, delta: &[f64; 6], to: &Joints, radius: f64) -> f64 {
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
