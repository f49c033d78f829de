//! The check of a path, leg by leg, and what it slows.
//!
//! In: the arm's model, the start, the legs, the room. Out: the segments, slowed where a joint or the vacuum
//! requires it, or the first fault. Pure.
//!
//! A leg is followed as a chain of joint positions: the two ends of a `movej`, which is straight in joint
//! space, or steps of 10 mm along a `movel`. The swept check (`bodies::sweep`) goes along the chains
//! without a gap; heights, singularities and joint speeds are looked at where the chain, or a fine division
//! of it, has its points.

use crate::arm::{ArmModel, BlendSpeed};
use crate::bodies::Room;
use crate::bodies::sweep::{Bulge, Meeting, STRAIGHT, Sweep, Zone};
use crate::path::corners::make_safe;
use crate::path::fault::{PathFault, out_of_reach};
use crate::path::leg::{Leg, Segment};
use crate::path::traced::{Traced, at_distance};
use cell_values::units::Joints;
use nalgebra::{Isometry3, Vector3};

/// Distances kept from the arm's singularities on linear segments, where joint speeds would run away
/// (reference: ur-interfaces 6.3). Joint segments cross them harmlessly.
const MIN_WRIST_SINE: f64 = 0.08;
const MIN_ELBOW_SINE: f64 = 0.08;
const MIN_SHOULDER_RADIUS_M: f64 = 0.15;

/// Joint step between samples for heights, rad: 0.02 rad at 0.9 m reach is 18 mm of travel and, on the arc
/// between two samples, less than 0.05 mm of sag.
const SAMPLE_RAD: f64 = 0.02;

/// Tool travel between samples of a linear leg, m.
const SAMPLE_M: f64 = 0.01;

/// Between two of its points a curve goes aside by an eighth of its second difference, and by this share of
/// it at most where that changes from point to point.
const BULGE: f64 = 0.25;

/// Points of a line are so near to each other that no joint's second difference is larger, rad: only then
/// it changes little from point to point.
const BENT_RAD: f64 = 0.01;

/// Points of a line at most.
const POINTS: usize = 500;

/// Straight pieces along a corner.
const CORNER_PIECES: usize = 8;

/// A leg between the objects turns the tool by at most this much, rad.
const TURN_RAD: f64 = 0.01;

/// A leg between the objects goes aside by at most this much, m.
const ASIDE_M: f64 = 1e-3;

/// Where a line turns more than it travels, a radian counts as so many metres for its speed: assumed,
/// nothing is published.
const METRES_PER_RADIAN: f64 = 0.25;

/// A line that has to be slower than this for the joints to follow is refused, m/s.
const LEAST_SPEED: f64 = 0.01;

/// So is one that would take longer, s: the deadline of a path of several legs is a minute.
const LONGEST_S: f64 = 15.0;

/// Pieces of a joint leg at which the tool's acceleration is looked at.
const LOAD_SAMPLES: usize = 16;

/// The segments of a path, if all of it passes.
pub(super) fn path(
    model: &ArmModel,
    start: &Joints,
    legs: &[Leg],
    room: &Room,
) -> Result<Vec<Segment>, PathFault> {
    if legs.is_empty() {
        return Err(PathFault::Empty);
    }
    let mut from = *start;
    let mut traced = Vec::with_capacity(legs.len());
    for leg in legs {
        check_numbers(model, &leg.segment)?;
        check_hold(leg.hold)?;
        let way = match leg.segment {
            Segment::Joint { target, .. } => trace_joint(model, &from, &target, leg)?,
            Segment::Linear { target, .. } => trace_linear(model, &from, &target, leg)?,
        };
        check_numbers(model, &way.segment)?;
        traced.push(way);
        from = leg.segment.target();
    }
    blends_part(model, start, legs)?;
    match model.blend_speed {
        BlendSpeed::Unknown => make_safe(model, legs, &mut traced),
        BlendSpeed::Braked => {}
    }
    sweep(model, start, legs, &traced, room)?;
    Ok(traced.into_iter().map(|leg| leg.segment).collect())
}

/// No two corners are cut in the same place: a controller leaves a segment out whose blend reaches into that
/// of the one before or after it, and goes another way than the one that is checked here (user manual,
/// "Blend parameters": blends cannot overlap).
fn blends_part(model: &ArmModel, start: &Joints, legs: &[Leg]) -> Result<(), PathFault> {
    let place = |q: &Joints| model.tool_at(q).translation.vector;
    let (mut from, mut before) = (place(start), 0.0);
    for (index, leg) in legs.iter().enumerate() {
        // The last segment ends at rest, whatever its blend.
        let blend = if index + 1 == legs.len() { 0.0 } else { leg.segment.blend() };
        let to = place(&leg.segment.target());
        let way = (to - from).norm();
        // Without any blend there is nothing to overlap, however short the way.
        if before + blend > 0.0 && before + blend > way {
            let what = "sum of the blend radii at the ends of a segment".into();
            return Err(PathFault::Limit { what, value: before + blend, limit: way });
        }
        (from, before) = (to, blend);
    }
    Ok(())
}

/// All pairs of bodies along all legs and their corners.
fn sweep(
    model: &ArmModel,
    start: &Joints,
    legs: &[Leg],
    traced: &[Traced],
    room: &Room,
) -> Result<(), PathFault> {
    let mut sweep = Sweep::new(&model.bodies, room);
    sweep.accept_start(start);
    for (index, (leg, way)) in legs.iter().zip(traced).enumerate() {
        let found = |meeting| meets(model, (index == 0).then_some(start), meeting);
        chain(&mut sweep, &way.points, leg.zone).map_err(found)?;
        let Some((after, next)) = traced.get(index + 1).zip(legs.get(index + 1)) else { continue };
        if way.segment.blend() > 0.0 {
            // An early blend cuts the corner more: by 1 mm at a radius of 30 mm. The clearance kept in
            // corners is larger.
            let corner = Corner::new(model, way, after, way.segment.blend());
            // A corner is cut aside of both legs: clear of everything, and over everything, where one of
            // them goes down with less air.
            let zones: &[Zone] =
                if leg.zone == next.zone { &[leg.zone] } else { &[Zone::Between, Zone::Corner] };
            for zone in zones {
                corner.check(&mut sweep, *zone).map_err(found)?;
            }
        }
    }
    Ok(())
}

/// All that is between the points of a curve in joint space.
fn chain(sweep: &mut Sweep, points: &[Joints], zone: Zone) -> Result<(), Meeting> {
    for (k, pair) in points.windows(2).enumerate() {
        sweep.piece(&pair[0], &pair[1], zone, &bulge(points, k))?;
    }
    Ok(())
}

/// How far a curve is off the straight way from its point `k` to the next, by its second differences there
/// and at the points next to them: at the ends of a line, and where it bends to the other side, one says too
/// little.
fn bulge(points: &[Joints], k: usize) -> Bulge {
    let second = |at: usize, joint: usize| -> Option<f64> {
        let value = |k: usize| points.get(k).map(|q| q.0[joint]);
        let (before, after) = (value(at.checked_sub(1)?)?, value(at + 1)?);
        Some((before - 2.0 * value(at)? + after).abs())
    };
    let largest =
        |joint| (k.saturating_sub(1)..=k + 2).filter_map(|at| second(at, joint)).fold(0.0, f64::max);
    std::array::from_fn(|joint| BULGE * largest(joint))
}

/// A meeting in words for people; `start` on the path's first leg only.
fn meets(model: &ArmModel, start: Option<&Joints>, meeting: Meeting) -> PathFault {
    let Meeting { one, other, distance, at } = meeting;
    let at_start = start.is_some_and(|start| at.max_difference(start) < 1e-9);
    let tool = model.tool_at(&at).translation.vector.into();
    PathFault::Meets { one, other, distance_mm: distance * 1e3, tool, at_start }
}

/// A corner that is cut: where a blend leaves the one leg and where it joins the next.
struct Corner {
    leaves: Joints,
    at: Joints,
    joins: Joints,
}

impl Corner {
    fn new(model: &ArmModel, before: &Traced, after: &Traced, blend: f64) -> Corner {
        Corner {
            leaves: at_distance(model, before.points.iter().rev(), blend),
            at: before.segment.target(),
            joins: at_distance(model, after.points.iter(), blend),
        }
    }

    /// From the corner back to where it is left, along the parabola that touches both legs, straight back as
    /// the shortest way of all, and to the corner.
    fn check(&self, sweep: &mut Sweep, zone: Zone) -> Result<(), Meeting> {
        let Corner { leaves, at, joins } = self;
        let parabola = (0..=CORNER_PIECES).map(|k| {
            let share = k as f64 / CORNER_PIECES as f64;
            leaves.lerp(at, share).lerp(&at.lerp(joins, share), share)
        });
        sweep.piece(at, leaves, zone, &STRAIGHT)?;
        chain(sweep, &parabola.collect::<Vec<_>>(), zone)?;
        sweep.piece(joins, leaves, zone, &STRAIGHT)?;
        sweep.piece(leaves, at, zone, &STRAIGHT)
    }
}

fn check_numbers(model: &ArmModel, segment: &Segment) -> Result<(), PathFault> {
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
        if inside { Ok(()) } else { Err(PathFault::Limit { what, value, limit }) }
    };
    within("speed".into(), speed, speed_limit)?;
    within("acceleration".into(), acceleration, acceleration_limit)?;
    if (0.0..=0.5).contains(&blend) {
        Ok(())
    } else {
        Err(PathFault::Limit { what: "blend radius".into(), value: blend, limit: 0.5 })
    }
}

/// What is held withstands some acceleration.
fn check_hold(hold: f64) -> Result<(), PathFault> {
    if hold > 0.0 {
        Ok(())
    } else {
        let what = "the acceleration that the vacuum holds at";
        Err(PathFault::Limit { what: what.into(), value: hold, limit: f64::INFINITY })
    }
}

fn trace_joint(model: &ArmModel, from: &Joints, to: &Joints, leg: &Leg) -> Result<Traced, PathFault> {
    if leg.zone == Zone::Between {
        return Err(PathFault::Aside { aside_mm: f64::INFINITY });
    }
    let samples = (from.max_difference(to) / SAMPLE_RAD).ceil().clamp(1.0, 2_000.0) as usize;
    // Without a floor the ends say it all: no joint leaves its range between them.
    let samples = if leg.floor == f64::NEG_INFINITY { 1 } else { samples };
    for k in 0..=samples {
        check_place(model, &from.lerp(to, k as f64 / samples as f64), leg.floor)?;
    }
    let segment = if leg.hold.is_finite() { slowed_for_load(model, from, leg) } else { leg.segment };
    Ok(Traced { points: vec![*from, *to], segment, length: from.max_difference(to) })
}

/// A joint leg at a speed and an acceleration at which what is held withstands the tool's acceleration:
/// along the way, and across it where the way is bent.
fn slowed_for_load(model: &ArmModel, from: &Joints, leg: &Leg) -> Segment {
    let Segment::Joint { target, speed, acceleration, blend } = leg.segment else { return leg.segment };
    let travel = from.max_difference(&target);
    let at = |k: usize| model.tool_at(&from.lerp(&target, k as f64 / LOAD_SAMPLES as f64)).translation.vector;
    let places: Vec<Vector3<f64>> = (0..=LOAD_SAMPLES).map(at).collect();
    // For each radian of the leading joint, and for each squared.
    let step = travel / LOAD_SAMPLES as f64;
    if step < 1e-6 {
        return leg.segment;
    }
    let along = places.windows(2).map(|p| (p[1] - p[0]).norm() / step).fold(0.0, f64::max);
    let bent = places.windows(3).map(|p| (p[2] - 2.0 * p[1] + p[0]).norm() / (step * step));
    let bent = bent.fold(0.0, f64::max);
    let (speed, acceleration) = within_sum(speed, acceleration, along, bent, leg.hold);
    Segment::Joint { target, speed, acceleration, blend }
}

/// The largest speed and acceleration, not above those given, for which `along * acceleration + bent *
/// speed^2` stays within `limit`: where it does not, each of the two gets half.
fn within_sum(speed: f64, acceleration: f64, along: f64, bent: f64, limit: f64) -> (f64, f64) {
    if along * acceleration + bent * speed * speed <= limit {
        return (speed, acceleration);
    }
    let slower = speed.min((0.5 * limit / bent.max(1e-12)).sqrt());
    let softer = acceleration.min((limit - bent * slower * slower) / along.max(1e-12));
    (slower, softer)
}

fn trace_linear(model: &ArmModel, from: &Joints, to: &Joints, leg: &Leg) -> Result<Traced, PathFault> {
    let (start, end) = (model.tool_at(from), model.tool_at(to));
    let way = end.translation.vector - start.translation.vector;
    let aside = way.x.hypot(way.y);
    if leg.zone == Zone::Between && aside > ASIDE_M {
        return Err(PathFault::Aside { aside_mm: aside * 1e3 });
    }
    let turn = start.rotation.angle_to(&end.rotation);
    if leg.zone == Zone::Between && turn > TURN_RAD {
        return Err(PathFault::Turning { turn_deg: turn.to_degrees() });
    }
    let mut samples = (way.norm() / SAMPLE_M + turn / 0.05).ceil().clamp(2.0, POINTS as f64) as usize;
    let mut points = on_line(model, from, [&start, &end], samples, leg)?;
    while bends(&points) > BENT_RAD && samples < POINTS {
        samples = (2 * samples).min(POINTS);
        points = on_line(model, from, [&start, &end], samples, leg)?;
    }
    if bends(&points) > BENT_RAD {
        return Err(PathFault::Singular { which: "wrist".into() });
    }
    // The controller follows the same branch: it has to arrive at the joints that were requested.
    if points.last().is_none_or(|last| last.max_difference(to) > 1e-3) {
        return Err(PathFault::Singular { which: "wrist".into() });
    }
    let length = way.norm().max(turn * METRES_PER_RADIAN);
    let segment = slowed_on_line(model, &points, length, leg)?;
    Ok(Traced { points, segment, length })
}

/// Joints at the ends of so many equal pieces of a line, each from the one before.
fn on_line(
    model: &ArmModel,
    from: &Joints,
    [start, end]: [&Isometry3<f64>; 2],
    pieces: usize,
    leg: &Leg,
) -> Result<Vec<Joints>, PathFault> {
    let mut points = Vec::with_capacity(pieces + 1);
    let mut near = *from;
    for k in 0..=pieces {
        let share = k as f64 / pieces as f64;
        let rotation = start.rotation.try_slerp(&end.rotation, share, 1e-9).unwrap_or(end.rotation);
        let position = start.translation.vector.lerp(&end.translation.vector, share);
        let tool = Isometry3::from_parts(position.into(), rotation);
        let q = model
            .kinematics
            .inverse_from(&model.flange_at(&tool), &near)
            .ok_or_else(|| out_of_reach("on a straight line", &tool))?;
        // A continuous solution moves little from sample to sample; a jump means the branches met.
        if q.max_difference(&near) > 0.35 {
            return Err(PathFault::Singular { which: "shoulder".into() });
        }
        check_singular(model, &q)?;
        check_place(model, &q, leg.floor)?;
        points.push(q);
        near = q;
    }
    Ok(points)
}

/// The largest second difference of a joint, rad.
fn bends(points: &[Joints]) -> f64 {
    let second = |three: &[Joints], joint: usize| {
        (three[0].0[joint] - 2.0 * three[1].0[joint] + three[2].0[joint]).abs()
    };
    points.windows(3).flat_map(|three| (0..6).map(move |joint| second(three, joint))).fold(0.0, f64::max)
}

/// A line at a speed and an acceleration at which every joint keeps its limits, and the vacuum its load.
fn slowed_on_line(model: &ArmModel, points: &[Joints], length: f64, leg: &Leg) -> Result<Segment, PathFault> {
    let Segment::Linear { target, mut speed, mut acceleration, blend } = leg.segment else {
        return Ok(leg.segment);
    };
    let step = length / (points.len() - 1) as f64;
    if step < 1e-6 {
        return Ok(leg.segment);
    }
    acceleration = acceleration.min(leg.hold);
    let limits = &model.limits;
    let least = (length / LONGEST_S).max(LEAST_SPEED).min(limits.tool_speed);
    for joint in 0..6 {
        let at = |k: usize| points[k].0[joint];
        let along = (1..points.len()).map(|k| (at(k) - at(k - 1)).abs() / step).fold(0.0, f64::max);
        let bent = (2..points.len())
            .map(|k| (at(k) - 2.0 * at(k - 1) + at(k - 2)).abs() / (step * step))
            .fold(0.0, f64::max);
        speed = speed.min(limits.joint_speed / along.max(1e-9));
        (speed, acceleration) = within_sum(speed, acceleration, along, bent, limits.joint_acceleration);
        if speed < least {
            return Err(PathFault::TooSlow { joint: joint + 1, speed_mm_s: speed * 1e3 });
        }
    }
    Ok(Segment::Linear { target, speed, acceleration, blend })
}

fn check_singular(model: &ArmModel, q: &Joints) -> Result<(), PathFault> {
    let wrist = model.kinematics.forward(q) * nalgebra::Point3::new(0.0, 0.0, -model.kinematics.dh().d[5]);
    if q.0[4].sin().abs() < MIN_WRIST_SINE {
        Err(PathFault::Singular { which: "wrist".into() })
    } else if q.0[2].sin().abs() < MIN_ELBOW_SINE {
        Err(PathFault::Singular { which: "elbow".into() })
    } else if wrist.x.hypot(wrist.y) < MIN_SHOULDER_RADIUS_M {
        Err(PathFault::Singular { which: "shoulder".into() })
    } else {
        Ok(())
    }
}

fn check_place(model: &ArmModel, q: &Joints, floor: f64) -> Result<(), PathFault> {
    if let Some(joint) = model.outside_range(q) {
        return Err(PathFault::JointRange { joint: joint + 1, at_deg: q.0[joint].to_degrees() });
    }
    if floor == f64::NEG_INFINITY {
        return Ok(());
    }
    let height = model.tool_at(q).translation.vector.z;
    if height < floor - 1e-6 {
        return Err(PathFault::TooLow { height_mm: height * 1e3, floor_mm: floor * 1e3 });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pick_n_place::tool_down;
    use crate::testing::model;
    use rand::{RngExt, SeedableRng};

    #[test]
    fn joints_on_a_line_are_off_the_straight_way_by_the_bulge_at_most() {
        let model = model(0.5);
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(7);
        let mut traced = 0;
        let mut largest: f64 = 0.0;
        while traced < 600 {
            let mut tool = || {
                let (x, y) = (random.random_range(-0.5..1.0), random.random_range(-0.1..0.8));
                let aside = Vector3::new(random.random_range(-0.6..0.6), random.random_range(-0.6..0.6), 0.0);
                let tilt = Isometry3::rotation(aside);
                tool_down(x, y, random.random_range(0.05..0.5), random.random_range(-3.0..3.0)) * tilt
            };
            let (from, to) = (tool(), tool());
            let Some(from) = model.joints_in_work_posture(&from, &model.home) else { continue };
            let Some(to) = model.joints_in_work_posture(&to, &from) else { continue };
            let segment = Segment::Linear { target: to, speed: 0.02, acceleration: 1.0, blend: 0.0 };
            let leg = Leg::over(segment, f64::NEG_INFINITY);
            let Ok(way) = trace_linear(&model, &from, &to, &leg) else { continue };
            traced += 1;
            let [start, end] = [from, to].map(|q| model.tool_at(&q));
            for (k, pair) in way.points.windows(2).enumerate() {
                let bulge = bulge(&way.points, k);
                for part in [0.25, 0.5, 0.75] {
                    let share = (k as f64 + part) / (way.points.len() - 1) as f64;
                    let rotation = start.rotation.slerp(&end.rotation, share);
                    let place = start.translation.vector.lerp(&end.translation.vector, share);
                    let tool = model.flange_at(&Isometry3::from_parts(place.into(), rotation));
                    let there = model
                        .kinematics
                        .inverse_from(&tool, &pair[0])
                        .expect("between two that are in reach");
                    let chord = pair[0].lerp(&pair[1], part);
                    for (joint, bulge) in bulge.iter().enumerate() {
                        let off = (there.0[joint] - chord.0[joint]).abs();
                        let most = 4.0 * part * (1.0 - part) * bulge;
                        largest = largest.max(off);
                        assert!(
                            off <= most + 1e-6,
                            "line {traced}, piece {k}, joint {joint}: {off} of {most}"
                        );
                    }
                }
            }
        }
        assert!(largest > 1e-3, "lines that bend: {largest}");
    }
}
