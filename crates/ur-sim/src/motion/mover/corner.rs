//! A move that takes over in full motion: the corner is rounded at a speed that is not braked for it.
//!
//! In: the move under way, which has come to its blend, and the next one. Out: the next one as a segment
//! that begins with the rounded corner; none where there is no corner to round: nothing blends, the tool
//! hardly travels on one of the sides, the way turns back, or a duration is given. Then the two moves
//! overlap, and the first one brakes as hard as its blend is short. If no smooth curve has the speeds of
//! both sides, the arm ends the corner more slowly, or a joint turns back a little. The same holds for
//! `movec` and `movep` after such a move: nothing is known of them.

use crate::motion::mover::{Mover, Task};
use crate::motion::rounding::{EntrySpeed, JointState, Rounding};
use crate::motion::segment::{MoveLimits, Segment, Start, joint_blend};
use crate::motion::tool_path::{REVERSAL, ToolPath};
use crate::motion::{Arm, FRAME_SECONDS, MotionFault};
use cell_values::units::Joints;
use nalgebra::Isometry3;

/// Steps in which a tool move is followed to where a corner ends.
const STEPS: u32 = 8;

/// Steps from the wanted speed at a corner's end down to the speed at its start.
const SPEED_STEPS: usize = 8;

/// A slower tool has no speed to keep, m/s.
const MIN_TOOL_SPEED_M_S: f64 = 1e-3;

/// Nor has one that travels less than this for each of the move's own units, m.
const MIN_METRES_PER_UNIT: f64 = 1e-3;

/// A move whose turning counts so many times its travel is timed by its turning.
const MAX_TURN_RATIO: f64 = 1.01;

/// Where the next move leads.
pub(super) enum Next<'a> {
    /// A line in joint space.
    Joints(&'a Joints),
    /// A line of the tool.
    Tool(&'a Isometry3<f64>),
}

/// The next move where a corner joins it.
struct JoinPoint {
    q: Joints,
    /// Joint speeds for a speed of 1 in the move's unit.
    direction: [f64; 6],
    /// Length of the move from here to its target: rad of the leading joint, or m of the tool.
    left: f64,
    /// Metres of the tool for each unit there.
    metres: f64,
}

impl JoinPoint {
    /// The move's highest speed at which no joint is too fast here, in its unit.
    fn fastest(&self, arm: &Arm) -> f64 {
        let limits = arm.joint_speed.iter().zip(self.direction);
        limits.map(|(most, one)| most / one.abs().max(1e-9)).fold(f64::INFINITY, f64::min)
    }
}

impl Mover {
    /// The next move from within the blend of the one under way; `None` where it begins at its corner.
    pub(super) fn rounded(&self, next: &Next, limits: &MoveLimits) -> Result<Option<Segment>, MotionFault> {
        let reading = self.blends.entry_speed();
        if reading == EntrySpeed::Braked || limits.seconds > 0.0 {
            return Ok(None);
        }
        let Some((came, corner)) = self.passing()? else { return Ok(None) };
        let place = |q: &Joints| self.arm.tcp(q).translation.vector;
        let Some(joins) = self.joins(&corner, next, self.blend_radius) else { return Ok(None) };
        let (begins, turns, ends) = (place(&came.q), place(&corner), place(&joins.q));
        let speed = self.tool_speed_of(&came);
        let turned = (turns - begins).angle(&(ends - turns));
        let can_be_kept = speed >= MIN_TOOL_SPEED_M_S && joins.metres >= MIN_METRES_PER_UNIT;
        if !can_be_kept || turned > REVERSAL {
            return Ok(None);
        }
        let brakes = (2.0 * limits.acceleration * joins.left).sqrt() * joins.metres;
        let wanted = reading.at_end(speed, limits.speed * joins.metres, brakes);
        let sides = (turns - begins).norm() + (ends - turns).norm();
        // A parabola that touches both sides.
        let arc = (2.0 * (ends - begins).norm() + sides) / 3.0;
        let curve = |wanted: f64| {
            // No joint is faster than it can be.
            let entry = (wanted / joins.metres).min(joins.fastest(&self.arm));
            let goes = JointState { q: joins.q, qd: joins.direction.map(|one| one * entry) };
            (entry, Rounding::new(came, goes, 2.0 * arc / (speed + entry * joins.metres)))
        };
        let least = wanted.min(speed);
        let speeds = (0..=SPEED_STEPS).map(|k| wanted + (least - wanted) * k as f64 / SPEED_STEPS as f64);
        let smooth = speeds.map(curve).find(|(_, rounding)| rounding.is_smooth());
        let (entry, rounding) = smooth.unwrap_or_else(|| curve(least));
        let end_speed = entry * joins.metres;
        let segment = match next {
            Next::Joints(to) => Segment::joint(&self.arm, &joins.q, to, limits, Start::Motion(entry)),
            Next::Tool(to) => {
                let path = ToolPath::line(&self.arm.tcp(&joins.q), to);
                Segment::tool(&self.arm, &joins.q, path, limits, Start::Motion(end_speed))?
            }
        };
        Ok(Some(segment.after(rounding)))
    }

    /// Where the arm is on its move and how fast, and the corner it comes to; `None` before the blend.
    fn passing(&self) -> Result<Option<(JointState, Joints)>, MotionFault> {
        let Task::Segments(segments) = &self.task else { return Ok(None) };
        let Some(only) = segments.back().filter(|_| segments.len() == 1) else { return Ok(None) };
        let (time, release) = (only.time, only.segment.release());
        if release >= only.segment.duration() || time + FRAME_SECONDS < release || time < FRAME_SECONDS {
            return Ok(None);
        }
        // On the move's own clock: what slows the arm down slows the corner down too.
        let mut segment = only.segment.clone();
        let before = segment.position(&self.arm, time - FRAME_SECONDS)?;
        let q = segment.position(&self.arm, time)?;
        let qd = std::array::from_fn(|i| (q.0[i] - before.0[i]) / FRAME_SECONDS);
        Ok(Some((JointState { q, qd }, segment.target())))
    }

    /// Where the next move is `radius` (m) away from the corner, half of it at most.
    fn joins(&self, corner: &Joints, next: &Next, radius: f64) -> Option<JoinPoint> {
        let place = |q: &Joints| self.arm.tcp(q).translation.vector;
        match next {
            Next::Joints(to) => {
                let delta: [f64; 6] = std::array::from_fn(|i| to.0[i] - corner.0[i]);
                let length = corner.max_difference(to);
                if length < 1e-9 {
                    return None;
                }
                let share = joint_blend(&self.arm, to, &delta.map(|way| -way), corner, radius);
                let (q, on) = (corner.lerp(to, share), corner.lerp(to, share + 1e-4));
                let metres = (place(&on) - place(&q)).norm() / (1e-4 * length);
                let direction = delta.map(|way| way / length);
                Some(JoinPoint { q, direction, left: (1.0 - share) * length, metres })
            }
            Next::Tool(to) => {
                let path = ToolPath::line(&self.arm.tcp(corner), to);
                if path.travel() < 1e-9 || path.length() > MAX_TURN_RATIO * path.travel() {
                    return None;
                }
                let share = (radius / path.travel()).min(0.5);
                let along = |from: &Joints, to: f64| self.arm.follow(&path.pose(to), from);
                let step = |q: Joints, k: u32| along(&q, share * f64::from(k) / f64::from(STEPS));
                let q = (1..=STEPS).try_fold(*corner, step)?;
                let on = along(&q, share + 1e-4)?;
                let direction = std::array::from_fn(|i| (on.0[i] - q.0[i]) / (1e-4 * path.travel()));
                Some(JoinPoint { q, direction, left: (1.0 - share) * path.travel(), metres: 1.0 })
            }
        }
    }

    fn tool_speed_of(&self, passing: &JointState) -> f64 {
        let on = Joints(std::array::from_fn(|i| passing.q.0[i] + passing.qd[i] * 1e-4));
        let place = |q: &Joints| self.arm.tcp(q).translation.vector;
        (place(&on) - place(&passing.q)).norm() / 1e-4
    }
}
