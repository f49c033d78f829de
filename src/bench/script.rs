//! The same pick-n-places by other programs, beside what the cell needs: from the places where the arm
//! rested.
//!
//! In: rests of one job, in order. Out: seconds. The naive script has no blends, waits for both looks
//! after every move, and then grips. The bound has the same rests (place, picture, pick) and between them
//! no way but straight up and down as far as things may lie on the table; every joint turns between from
//! the speed that the straight part lets it have, at its limits; one exposure. The vacuum's times are the
//! caller's.

use cell_machine::supervisor::model::CellModel;
use cell_motion::cycle_time::rest_to_rest;
use cell_motion::path::{CheckedPath, Segment};
use cell_motion::pick_n_place::CycleParameters;
use cell_values::units::Joints;
use ur_sim::camera::CameraTiming;

/// What the naive script rests before each of its pictures, s, and what one takes it from then on: half a
/// period until the exposure, the exposure, the transfer, the detection.
const NAIVE_SETTLE_S: f64 = 0.15;
const DETECTION_S: f64 = 0.045;

/// A place where the arm rests; from a pick on, what may be required of it with the object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Rest {
    Look(Joints),
    Pick(Joints, Carried),
    Place(Joints),
}

/// Speeds and accelerations at which the vacuum holds an object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Carried {
    /// Of the joints, rad/s and rad/s2.
    pub joint: (f64, f64),
    /// Of the tool, m/s and m/s2.
    pub tool: (f64, f64),
}

impl Carried {
    fn empty(cycle: &CycleParameters) -> Carried {
        Carried {
            joint: (cycle.joint_speed, cycle.joint_acceleration),
            tool: (cycle.tool_speed, cycle.tool_acceleration),
        }
    }

    /// As the path of a pick-n-place is slowed for its object.
    pub fn by(path: &CheckedPath, cycle: &CycleParameters) -> Carried {
        let mut carried = Carried::empty(cycle);
        for segment in path.segments() {
            match *segment {
                Segment::Joint { speed, acceleration, .. } => carried.joint = (speed, acceleration),
                Segment::Linear { speed, acceleration, .. } => carried.tool = (speed, acceleration),
            }
        }
        carried
    }
}

/// The same pick-n-places by other programs, from the places where the arm rested.
pub struct Script<'a> {
    pub model: &'a CellModel,
    pub cycle: &'a CycleParameters,
}

impl Script<'_> {
    /// Each pick-n-place: the place before it, the look, the pick, the place; and how the object is carried.
    fn each(rests: &[Rest]) -> Vec<([Joints; 4], Carried)> {
        let (mut look, mut pick, mut before) = (None, None, None);
        let mut out = Vec::new();
        for rest in rests {
            match rest {
                Rest::Look(q) => look = Some(*q),
                Rest::Pick(q, carried) => pick = Some((*q, *carried)),
                Rest::Place(place) => {
                    if let (Some(look), Some((pick, carried))) = (look, pick) {
                        out.push(([before.unwrap_or(look), look, pick, *place], carried));
                    }
                    before = Some(*place);
                }
            }
        }
        out
    }

    /// Joints straight above `q`, with the tool at `height` over the table.
    fn above(&self, q: &Joints, height: f64) -> (Joints, f64) {
        let mut tool = self.model.arm.tool_at(q);
        let rise = (height - tool.translation.vector.z).max(0.0);
        tool.translation.vector.z += rise;
        (self.model.arm.joints_at(&tool, q).unwrap_or(*q), rise)
    }

    fn turn(&self, from: &Joints, to: &Joints) -> f64 {
        let to = self.model.arm.unwound(to, from).unwrap_or(*to);
        from.max_difference(&to)
    }

    /// From rest to rest at every corner, all look poses after every move, and their pictures.
    pub fn naive_s(&self, rests: &[Rest]) -> f64 {
        let cycle = self.cycle;
        let timing = CameraTiming::D405;
        let picture =
            NAIVE_SETTLE_S + timing.period_s / 2.0 + timing.exposure_s + timing.latency_s + DETECTION_S;
        let empty = Carried::empty(cycle);
        let joint = |from: &Joints, to: &Joints, by: Carried| {
            rest_to_rest(self.turn(from, to), by.joint.0, by.joint.1)
        };
        let line = |length: f64, by: Carried| rest_to_rest(length, by.tool.0, by.tool.1);
        let height = cycle.tallest + cycle.air + cycle.approach;
        let mut sum = 0.0;
        for ([before, _, pick, place], by) in Script::each(rests) {
            let (mut at, rise) = self.above(&before, height);
            sum += line(rise, empty);
            for look in &self.model.look_poses {
                sum += joint(&at, look, empty) + picture;
                at = *look;
            }
            let (over_pick, down) = self.above(&pick, height);
            let (over_place, last) = self.above(&place, height);
            sum += joint(&at, &over_pick, empty) + line(down, empty);
            sum += line(down, by) + joint(&over_pick, &over_place, by) + line(last, by);
        }
        sum
    }

    /// Without a stop but at place, picture and pick.
    pub fn bound_s(&self, rests: &[Rest]) -> f64 {
        let cycle = self.cycle;
        let layer = cycle.layer();
        let mut sum = 0.0;
        let empty = Carried::empty(cycle);
        for ([before, look, pick, place], by) in Script::each(rests) {
            sum += CameraTiming::D405.exposure_s;
            sum += self.leg_s([&before, &look], layer, empty) + self.leg_s([&look, &pick], layer, empty);
            // The load hangs below the tool.
            let height = self.model.arm.tool_at(&pick).translation.vector.z;
            sum += self.leg_s([&pick, &place], layer + height, by);
        }
        sum
    }

    /// One way from rest to rest over a height: up at the tool's limits, over at the joints', down; speeding
    /// up and braking at the ends alone.
    fn leg_s(&self, [from, to]: [&Joints; 2], height: f64, by: Carried) -> f64 {
        let ((above, up), (over, down)) = (self.above(from, height), self.above(to, height));
        let Carried { joint, tool } = by;
        let over = self.model.arm.unwound(&over, &above).unwrap_or(over);
        let ends = [up, down].map(|length| from_rest_s(length, tool));
        // Where the straight part ends a joint is no faster than that lets it be.
        let speeds = |q: &Joints, rise: f64| {
            let speed = if rise > 1e-4 { (2.0 * tool.1 * rise).sqrt().min(tool.0) } else { 0.0 };
            let height = self.model.arm.tool_at(q).translation.vector.z;
            let (next, step) = self.above(q, height + 1e-3);
            let rate = |joint: usize| (next.0[joint] - q.0[joint]).abs() / step.max(1e-9);
            std::array::from_fn::<f64, 6, _>(|joint| (rate(joint) * speed).min(by.joint.0))
        };
        let (first, last) = (speeds(&above, up), speeds(&over, down));
        let middle = |j: usize| ramped_s((over.0[j] - above.0[j]).abs(), [first[j], last[j]], joint);
        ends[0] + (0..6).map(middle).fold(0.0, f64::max) + ends[1]
    }
}

/// Seconds of a length from one speed to another, at the most.
fn ramped_s(length: f64, [from, to]: [f64; 2], (speed, acceleration): (f64, f64)) -> f64 {
    // The way that speeding up and braking take, without a piece at full speed between.
    let peak = ((2.0 * acceleration * length + from * from + to * to) / 2.0).sqrt();
    if peak <= from.max(to) {
        // Too short for the one speed to become the other: no less than at the higher one all along.
        return length / from.max(to).max(1e-9);
    }
    let peak = peak.min(speed);
    let ramps = (2.0 * peak * peak - from * from - to * to) / (2.0 * acceleration);
    (2.0 * peak - from - to) / acceleration + (length - ramps).max(0.0) / peak
}

/// Seconds of a length from rest, without braking at its end.
fn from_rest_s(length: f64, (speed, acceleration): (f64, f64)) -> f64 {
    let ramp = speed * speed / (2.0 * acceleration);
    if length < ramp { (2.0 * length / acceleration).sqrt() } else { (length + ramp) / speed }
}
