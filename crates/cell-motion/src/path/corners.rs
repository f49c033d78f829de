//! Corners that are safe at any speed that the controller may have in a blend.
//!
//! In: the traced legs of a path. Out: the same legs, some of them slower, some blends replaced by a stop.
//! Pure.
//!
//! The vendor does not publish a controller's speed in a blend. It may brake before the blend, keep its
//! speed to the end of the blend, or reach the next segment's speed inside it. An answer in the vendor's
//! forum says that it keeps its speed (topic 3205); a user saw a UR3e's tool become faster inside (topic
//! 41354). So three rules hold at every corner. The next segment is long enough to brake in, where `out` is
//! the speed allowed at its end:
//!
//! ```text
//! v^2 <= out^2 + 2 a (length - r)
//! ```
//!
//! The arm enters no segment above that segment's speed. The vacuum holds the load in the turn, also if the
//! blend begins late. If slowing both segments takes longer than a stop, the arm stops.
//!
//! Not covered: joint acceleration inside a blend of an empty arm, which the controller limits.

use crate::arm::ArmModel;
use crate::path::leg::{Leg, Segment};
use crate::path::traced::{Traced, at_distance};
use crate::ramp::rest_to_rest;
use nalgebra::Vector3;

/// A blend's real radius over its nominal one, at least and at most. Both are guesses. One late blend was
/// reported (topic 41354): of 20 mm, 3 mm before the corner, at 1 mm/s, where no load feels the turn.
/// Nothing is published about late blends at speed or about early blends.
const BLEND_RADIUS_MIN_RATIO: f64 = 0.5;
const BLEND_RADIUS_MAX_RATIO: f64 = 1.1;

/// Pieces into which a joint segment's part of a blend is divided to find the tool's speed.
const TOOL_SPEED_SAMPLES: usize = 8;

/// The tool's travel for each unit of a segment, m: below it the arm stops, as there is no tool speed to
/// keep.
const MIN_TOOL_M_PER_UNIT: f64 = 1e-3;

/// One end of a segment. Lengths are in the segment's unit: rad of the leading joint, or m of the tool.
struct Side {
    length: f64,
    /// Length inside the blend.
    inside: f64,
    /// Tool travel for each unit inside the blend.
    max_m_per_unit: f64,
    min_m_per_unit: f64,
    /// Where the tool is at the blend's end, from the corner, m.
    from_corner: Vector3<f64>,
}

/// Makes every corner of a path safe, from the last to the first: a segment's entry speed depends on its
/// exit speed.
pub(super) fn make_safe(model: &ArmModel, legs: &[Leg], traced: &mut [Traced]) {
    // Of the segment after the corner, in its unit: its speed at its end, and its length in the next blend.
    let (mut out, mut taken) = (0.0, 0.0);
    for index in (0..traced.len().saturating_sub(1)).rev() {
        let (before, after) = traced.split_at_mut(index + 1);
        let (Some(way), Some(next)) = (before.last_mut(), after.first_mut()) else { return };
        let hold = legs.iter().skip(index).take(2).map(|leg| leg.hold).fold(f64::INFINITY, f64::min);
        let from_rest = index == 0 || legs[index - 1].segment.blend() <= 0.0;
        let corner = CornerContext { from_rest, hold, out, taken };
        (out, taken) = corner.settle(model, way, next).unwrap_or((0.0, 0.0));
    }
}

/// What a corner's speeds depend on beside its two segments.
struct CornerContext {
    /// The first segment starts from rest.
    from_rest: bool,
    /// Highest acceleration at which the cups hold the load, m/s2.
    hold: f64,
    /// The second segment's speed at its end and its length in the next blend, in its unit.
    out: f64,
    taken: f64,
}

impl CornerContext {
    /// Slows the two segments, or replaces the blend by a stop. Returns the first segment's speed at its end
    /// and its length in the blend, in its unit; `None` for a stop.
    fn settle(&self, model: &ArmModel, way: &mut Traced, next: &mut Traced) -> Option<(f64, f64)> {
        let radius = way.segment.blend();
        if radius <= 0.0 {
            return None;
        }
        let settled = self.speeds(model, way, next, radius).and_then(|(entry, exit, inside)| {
            let slow = with_speed(&way.segment, entry);
            let slow_next = with_speed(&next.segment, exit);
            let lost = seconds(way, &slow) - seconds(way, &way.segment) + seconds(next, &slow_next)
                - seconds(next, &next.segment);
            (lost <= saved(&slow, inside)).then_some((slow, slow_next, entry, inside))
        });
        let Some((slow, slow_next, entry, inside)) = settled else {
            way.segment = with_blend(&way.segment, 0.0);
            return None;
        };
        (way.segment, next.segment) = (slow, slow_next);
        Some((entry, inside))
    }

    /// Safe speeds of the two segments, and the first one's length in the blend, each in its segment's unit.
    fn speeds(&self, model: &ArmModel, way: &Traced, next: &Traced, radius: f64) -> Option<(f64, f64, f64)> {
        let radius = BLEND_RADIUS_MAX_RATIO * radius;
        let (one, other) = (Side::new(model, way, radius, true), Side::new(model, next, radius, false));
        if one.max_m_per_unit < MIN_TOOL_M_PER_UNIT || other.min_m_per_unit < MIN_TOOL_M_PER_UNIT {
            return None;
        }
        let (speed, acceleration) = pace(&way.segment);
        let (next_speed, next_acceleration) = pace(&next.segment);
        let room = other.length - other.inside - self.taken;
        let brakes = (self.out * self.out + 2.0 * next_acceleration * room.max(0.0)).sqrt();
        let turns = self.turn_limit(&one, &other);
        // The arm may reach the second segment's speed inside the blend.
        let exit = next_speed.min(brakes).min(turns / other.max_m_per_unit);
        // A late blend leaves the arm a longer way to speed up.
        let before = one.length - BLEND_RADIUS_MIN_RATIO / BLEND_RADIUS_MAX_RATIO * one.inside;
        let reached = match self.from_rest {
            true => (2.0 * acceleration * before.max(0.0)).sqrt(),
            false => f64::INFINITY,
        };
        // The tool may keep the first segment's speed to the end of the blend.
        let kept = (exit * other.min_m_per_unit).min(turns) / one.max_m_per_unit;
        let entry = if speed.min(reached) <= kept { speed } else { kept };
        (entry > 0.0 && exit > 0.0).then_some((entry, exit, one.inside))
    }

    /// The tool's highest speed at which the cups hold the load in the turn, m/s. Along the arc the velocity
    /// changes its direction, or grows from zero if the tool comes slowly.
    fn turn_limit(&self, one: &Side, other: &Side) -> f64 {
        let chord = (other.from_corner - one.from_corner).norm();
        let arc = (2.0 * chord + one.from_corner.norm() + other.from_corner.norm()) / 3.0;
        let [came, goes] =
            [-one.from_corner, other.from_corner].map(|way| way.try_normalize(1e-9).unwrap_or_default());
        let change = (goes - came).norm().max(1.0);
        (self.hold * BLEND_RADIUS_MIN_RATIO / BLEND_RADIUS_MAX_RATIO * arc / change).sqrt()
    }
}

impl Side {
    /// `ends`: the segment ends at the corner, otherwise it begins there.
    fn new(model: &ArmModel, way: &Traced, radius: f64, ends: bool) -> Side {
        let place = |index: Option<&cell_values::units::Joints>| {
            index.map_or_else(Vector3::zeros, |q| model.tool_at(q).translation.vector)
        };
        let far = match ends {
            true => at_distance(model, way.points.iter().rev(), radius),
            false => at_distance(model, way.points.iter(), radius),
        };
        let corner = if ends { way.points.last() } else { way.points.first() };
        let away = model.tool_at(&far).translation.vector - place(corner);
        let length = way.length;
        match (way.segment, corner) {
            (Segment::Joint { .. }, Some(corner)) => {
                let inside = corner.max_difference(&far);
                let at = |k: usize| place(Some(&corner.lerp(&far, k as f64 / TOOL_SPEED_SAMPLES as f64)));
                let piece = (inside / TOOL_SPEED_SAMPLES as f64).max(1e-9);
                let metres = (0..TOOL_SPEED_SAMPLES).map(|k| (at(k + 1) - at(k)).norm() / piece);
                let (least, most) =
                    metres.fold((f64::INFINITY, 0.0f64), |(low, high), one| (low.min(one), high.max(one)));
                Side { length, inside, max_m_per_unit: most, min_m_per_unit: least, from_corner: away }
            }
            (Segment::Joint { .. } | Segment::Linear { .. }, _) => {
                // The length of a line that mostly turns is that of its turn.
                let share = (place(way.points.last()) - place(way.points.first())).norm() / length.max(1e-9);
                Side {
                    length,
                    inside: away.norm() / share.max(1e-9),
                    max_m_per_unit: share,
                    min_m_per_unit: share,
                    from_corner: away,
                }
            }
        }
    }
}

fn pace(segment: &Segment) -> (f64, f64) {
    match *segment {
        Segment::Joint { speed, acceleration, .. } | Segment::Linear { speed, acceleration, .. } => {
            (speed, acceleration)
        }
    }
}

fn with_speed(segment: &Segment, least: f64) -> Segment {
    let mut slower = *segment;
    match &mut slower {
        Segment::Joint { speed, .. } | Segment::Linear { speed, .. } => *speed = speed.min(least),
    }
    slower
}

fn with_blend(segment: &Segment, radius: f64) -> Segment {
    let mut other = *segment;
    match &mut other {
        Segment::Joint { blend, .. } | Segment::Linear { blend, .. } => *blend = radius,
    }
    other
}

/// Seconds of a segment from rest to rest.
fn seconds(way: &Traced, segment: &Segment) -> f64 {
    let (speed, acceleration) = pace(segment);
    rest_to_rest(way.length, speed, acceleration)
}

/// Seconds that a blend saves against a stop: both segments run at the same time in it.
fn saved(segment: &Segment, inside: f64) -> f64 {
    let (speed, acceleration) = pace(segment);
    let speed = speed.min((2.0 * acceleration * inside).sqrt()).max(1e-9);
    inside / speed + speed / (2.0 * acceleration)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bodies::Room;
    use crate::path::{BlendSpeed, CheckedPath};
    use crate::pick_n_place::tool_down;
    use crate::testing::model;
    use cell_values::units::Joints;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// A path over a table and down.
    #[derive(Clone, Copy, Debug)]
    struct Way {
        /// Height of the corner over the end, and radius of the blend there, m.
        down: f64,
        blend: f64,
        joint: (f64, f64),
        line: (f64, f64),
        hold: f64,
    }

    const USUAL: Way =
        Way { down: 0.06, blend: 0.03, joint: (1.5, 3.0), line: (0.25, 1.0), hold: f64::INFINITY };

    /// Joints with the tool straight down at a place in the plane y = 0.25 m.
    fn joints_at(model: &ArmModel, x: f64, z: f64) -> Joints {
        model.joints_in_work_posture(&tool_down(x, 0.25, z, 0.0), &model.home).expect("reachable")
    }

    fn path(model: &ArmModel, way: &Way) -> (Joints, CheckedPath) {
        let at = |x: f64, z: f64| joints_at(model, x, z);
        let (start, over, low) = (at(0.1, 0.1 + way.down), at(0.4, 0.1 + way.down), at(0.4, 0.1));
        let (speed, acceleration) = way.joint;
        let across = Segment::Joint { target: over, speed, acceleration, blend: way.blend };
        let (speed, acceleration) = way.line;
        let down = Segment::Linear { target: low, speed, acceleration, blend: 0.0 };
        let legs = [across, down].map(|segment| Leg::over(segment, 0.0).holding(way.hold));
        (start, CheckedPath::new(model, &start, &legs, &Room::empty()).expect("free"))
    }

    /// The tool's highest speed at the start of the blend, from the first segment's trapezoid.
    fn comes_at(model: &ArmModel, start: &Joints, across: &Segment) -> f64 {
        let (speed, acceleration) = pace(across);
        let (target, travel) = (across.target(), start.max_difference(&across.target()));
        let tool = |share: f64| model.tool_at(&start.lerp(&target, share)).translation.vector;
        let begins = (0..1000).map(|k| f64::from(k) / 1000.0);
        let begins = begins
            .rev()
            .find(|share| (tool(*share) - tool(1.0)).norm() >= BLEND_RADIUS_MIN_RATIO * across.blend());
        let begins = begins.unwrap_or(0.0);
        let reached = speed.min((2.0 * acceleration * begins * travel).sqrt());
        reached * (tool(begins + 1e-4) - tool(begins)).norm() / (1e-4 * travel)
    }

    #[test]
    fn the_next_segment_can_always_be_braked() {
        let model = model(0.5);
        let (mut blended, mut stops) = (0, 0);
        for seed in 0..300 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let down = rng.random_range(0.03..0.2);
            let hold = if rng.random() { f64::INFINITY } else { rng.random_range(0.5..40.0) };
            let way = Way {
                down,
                blend: (rng.random_range(0.1..0.9) * down).min(0.05),
                joint: (rng.random_range(0.3..2.0), rng.random_range(1.0..4.0)),
                line: (rng.random_range(0.05..0.5), rng.random_range(0.5..2.0)),
                hold,
            };
            let (start, path) = path(&model, &way);
            let [across, below] = path.segments() else { panic!("{path:?}") };
            let ((next_speed, next_acceleration), radius) = (pace(below), across.blend());
            if radius > 0.0 {
                blended += 1;
                let came = comes_at(&model, &start, across);
                let brakes = (2.0 * next_acceleration * (down - radius)).sqrt();
                assert!(
                    came.max(next_speed) <= 1.01 * brakes,
                    "{seed}: {came} and {next_speed}, {brakes} m/s"
                );
                assert!(came <= 1.01 * next_speed, "{seed}: {came} m/s into a segment of {next_speed}");
                // A right angle along a parabola of half the radius.
                let arc = (2.0 * std::f64::consts::SQRT_2 + 2.0) / 3.0 * radius * BLEND_RADIUS_MIN_RATIO;
                let turned = std::f64::consts::SQRT_2 * came.max(next_speed).powi(2) / arc;
                assert!(turned <= 1.1 * hold, "{seed}: {turned} m/s2, where {hold} holds");
            } else {
                stops += 1;
            }
            // A second check does not slow the path again.
            let legs = [*across, *below].map(|segment| Leg::over(segment, 0.0).holding(hold));
            let again = CheckedPath::new(&model, &start, &legs, &Room::empty()).expect("free");
            assert_eq!(again.segments(), path.segments(), "{seed}");
        }
        assert!(blended > 20 && stops > 20, "{blended} corners are cut, {stops} are stops");
    }

    /// Up, across and down: the segment across starts in a blend and ends with a stop.
    #[test]
    fn a_segment_between_two_corners_can_stop_at_the_second() {
        let model = model(0.5);
        let (mut stops, mut slowed) = (0, 0);
        for seed in 0..300 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let (height, across_m) = (rng.random_range(0.04..0.15), rng.random_range(0.03..0.3));
            let [speed, acceleration] = [rng.random_range(0.5..2.0), rng.random_range(0.5..4.0)];
            let at = |x: f64, z: f64| joints_at(&model, x, z);
            let tool_speed = rng.random_range(0.03..0.3);
            let line =
                |target, blend| Segment::Linear { target, speed: tool_speed, acceleration: 1.5, blend };
            let over = [at(0.1, 0.1 + height), at(0.1 + across_m, 0.1 + height)];
            let radius = 0.3 * across_m.min(0.03);
            let legs = [
                line(over[0], radius),
                Segment::Joint { target: over[1], speed, acceleration, blend: radius },
                line(at(0.1 + across_m, 0.07 + height), 0.0),
            ]
            .map(|segment| Leg::over(segment, 0.0));
            let path = CheckedPath::new(&model, &at(0.1, 0.1), &legs, &Room::empty()).expect("free");
            let [up, across, _] = path.segments() else { panic!("{path:?}") };
            if up.blend() <= 0.0 || across.blend() > 0.0 {
                continue;
            }
            // After the first blend, the rest of the segment is long enough to stop in, in rad.
            stops += 1;
            slowed += usize::from(pace(across).0 < speed);
            let tool = |share: f64| model.tool_at(&over[0].lerp(&over[1], share)).translation.vector;
            let begins = (0..1000).map(|k| f64::from(k) / 1000.0);
            let share = begins.into_iter().find(|share| (tool(*share) - tool(0.0)).norm() >= radius);
            let left = (1.0 - share.unwrap_or(1.0)) * over[0].max_difference(&over[1]);
            let brakes = (2.0 * acceleration * left).sqrt();
            assert!(pace(across).0 <= 1.01 * brakes, "{seed}: {} rad/s, {brakes}", pace(across).0);
        }
        assert!(stops > 20 && slowed > 5, "{stops} stops, {slowed} slowed");
    }

    /// Up, across and down by lines that all blend: the line across is entered no faster than it can be
    /// braked to what the last one allows.
    #[test]
    fn of_two_blends_in_a_row_the_first_leaves_room_for_the_second() {
        let model = model(0.5);
        let (mut chained, mut slowed) = (0, 0);
        for seed in 0..300 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let [height, across_m, down_m]: [f64; 3] = std::array::from_fn(|_| rng.random_range(0.03..0.12));
            let accelerations: [f64; 3] = std::array::from_fn(|_| rng.random_range(0.5..2.0));
            let wanted: [f64; 3] = std::array::from_fn(|_| rng.random_range(0.05..0.4));
            let radii = [0.3 * height.min(across_m), 0.3 * across_m.min(down_m), 0.0];
            let at = |x: f64, z: f64| joints_at(&model, x, z);
            let top = 0.2 + height;
            let targets = [at(0.1, top), at(0.1 + across_m, top), at(0.1 + across_m, top - down_m)];
            let legs: [Leg; 3] = std::array::from_fn(|k| {
                let (speed, acceleration) = (wanted[k], accelerations[k]);
                let segment = Segment::Linear { target: targets[k], speed, acceleration, blend: radii[k] };
                Leg::over(segment, 0.0)
            });
            let path = CheckedPath::new(&model, &at(0.1, 0.2), &legs, &Room::empty()).expect("free");
            let [up, across, down] = path.segments() else { panic!("{path:?}") };
            if up.blend() <= 0.0 || across.blend() <= 0.0 {
                continue;
            }
            chained += 1;
            let speeds = [up, across, down].map(|segment| pace(segment).0);
            slowed += usize::from(speeds != wanted);
            let reached = (2.0 * accelerations[0] * (height - 0.5 * radii[0])).sqrt();
            let came = speeds[0].min(reached);
            let leaves = speeds[2].min((2.0 * accelerations[2] * (down_m - radii[1])).sqrt());
            let room = across_m - radii[0] - radii[1];
            let brakes = (leaves * leaves + 2.0 * accelerations[1] * room).sqrt();
            assert!(came <= 1.01 * speeds[1], "{seed}: {came} m/s into a line of {} m/s", speeds[1]);
            let entered = came.max(speeds[1]);
            assert!(entered <= 1.01 * brakes, "{seed}: entered at {entered} m/s, braked from {brakes}");
            assert!(speeds[1] <= 1.01 * speeds[2] || across.blend() <= 0.0, "{seed}: {speeds:?}");
        }
        assert!(chained > 20 && slowed > 20, "{chained} chains, {slowed} slowed");
    }

    #[test]
    fn a_corner_that_is_safe_at_full_speed_is_unchanged() {
        let model = model(0.5);
        let long = Way { down: 0.3, joint: (0.3, 3.0), ..USUAL };
        let (_, path) = path(&model, &long);
        let [across, below] = path.segments() else { panic!("{path:?}") };
        assert_eq!((pace(across), across.blend(), pace(below)), (long.joint, long.blend, long.line));
    }

    #[test]
    fn before_a_short_descent_a_fast_segment_stops_and_a_slow_one_is_slowed() {
        let model = model(0.5);
        let (_, fast) = path(&model, &USUAL);
        assert_eq!((fast.segments()[0].blend(), pace(&fast.segments()[0])), (0.0, USUAL.joint));
        let nearly = Way { joint: (0.6, 3.0), ..USUAL };
        let (_, slowed) = path(&model, &nearly);
        let across = &slowed.segments()[0];
        assert!(across.blend() > 0.0 && pace(across).0 < nearly.joint.0, "{across:?}");
        // A controller that is known to brake before corners gets the path unchanged.
        let braked = ArmModel { blend_speed: BlendSpeed::Braked, ..model };
        assert_eq!(path_of_braked(&braked), (0.03, USUAL.joint));
    }

    fn path_of_braked(model: &ArmModel) -> (f64, (f64, f64)) {
        let (_, path) = path(model, &USUAL);
        (path.segments()[0].blend(), pace(&path.segments()[0]))
    }

    #[test]
    fn a_weak_grip_limits_the_speed_in_corners() {
        let model = model(0.5);
        let slow = Way { joint: (0.4, 3.0), line: (0.25, 1.0), ..USUAL };
        let (_, held) = path(&model, &Way { hold: 0.5, ..slow });
        let (_, empty) = path(&model, &slow);
        assert!(empty.segments()[0].blend() > 0.0);
        let [across, _] = held.segments() else { panic!("{held:?}") };
        assert!(across.blend() == 0.0 || pace(across).0 < pace(&empty.segments()[0]).0, "{across:?}");
    }
}
