//! How a real arm passed the corners that celld had it cut: the recording against the plan.
//!
//! In: paths as they were sent, and the arm's joints as the controller reported them meanwhile. Out: a
//! [`Passage`] for each path: how far off its way the tool came, how fast it was, how each corner was cut;
//! or a [`BlendFault`], with which celld has to stop at corners. The check of paths (`cell_motion::path`)
//! says what is allowed: any way inside a corner; on each segment its own speed, in a corner up to that of
//! the faster one of its two segments. Pure.

use cell_motion::path::{ArmModel, Segment};
use cell_values::units::{Joints, deg_from_rad, mm_from_m};
use nalgebra::Vector3;

/// A path as it was sent.
#[derive(Clone, Debug, PartialEq)]
pub struct SentPath {
    /// Where the arm stood.
    pub start: Joints,
    /// Its segments in order.
    pub segments: Vec<Segment>,
}

/// Joints of the arm over time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct JointTrack {
    /// The controller's time, s, growing.
    pub times_s: Vec<f64>,
    /// Joints at these times.
    pub joints: Vec<Joints>,
}

/// How the arm followed a path.
#[derive(Clone, Debug, PartialEq)]
pub struct Passage {
    /// When the arm set out, controller's time, s.
    pub begins_s: f64,
    /// From rest to rest, s.
    pub seconds: f64,
    /// Largest distance of the tool from the path, or from the corner that it may cut, m.
    pub off_m: f64,
    /// The tool's highest speed, m/s.
    pub fastest_m_s: f64,
    /// The highest that the path allows, m/s.
    pub allowed_m_s: f64,
    /// The corners that were to be cut.
    pub corners: Vec<CornerPassage>,
}

/// How one corner was cut.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CornerPassage {
    /// The blend radius that was sent, m.
    pub radius_m: f64,
    /// How near the tool came to the corner, m: 0 where the controller did not cut it.
    pub cut_m: f64,
    /// The tool's speed where it came within the radius of the corner, m/s.
    pub enters_m_s: f64,
    /// Its speed where it left it, m/s.
    pub leaves_m_s: f64,
    /// Its lowest speed between, m/s.
    pub slowest_m_s: f64,
}

/// Why a recording does not let corners be cut.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum BlendFault {
    /// No sample there.
    #[error("the recording has no sample {0} of the way")]
    NotThere(&'static str),
    /// It ends too soon.
    #[error("the recording ends {0:.1} s before the arm was watched at rest at the end of the way")]
    EndsTooSoon(f64),
    /// Too many samples, ways or segments.
    #[error("the recording has more than {most} {what}")]
    TooLong {
        /// Of what.
        what: &'static str,
        /// How many there may be.
        most: usize,
    },
    /// Too long without a sample.
    #[error("the recording has a gap of {ms:.0} ms at {at_s:.2} s; the limit is {most_ms:.0} ms")]
    Gap {
        /// Its length.
        ms: f64,
        /// Where it begins.
        at_s: f64,
        /// The longest allowed.
        most_ms: f64,
    },
    /// Nothing to record.
    #[error("no way has a blend before its way down: at these speeds a stop is faster than a blend")]
    NoBlend,
    /// The tool left the corridor.
    #[error(
        "{after_s:.2} s after the start the tool was {off_mm:.1} mm off its way; the limit is {most_mm:.0} mm"
    )]
    Off {
        /// How far.
        off_mm: f64,
        /// When, after it set out.
        after_s: f64,
        /// What is allowed.
        most_mm: f64,
    },
    /// The tool was too fast.
    #[error(
        "{after_s:.2} s after the start the tool moved at {m_s:.3} m/s; the limit there is {allowed_m_s:.3} m/s"
    )]
    TooFast {
        /// Measured.
        m_s: f64,
        /// Allowed there.
        allowed_m_s: f64,
        /// When, after it set out.
        after_s: f64,
    },
    /// The arm had another posture than that of the path.
    #[error(
        "{after_s:.2} s after the start joint {joint} was {off_deg:.1} degrees from where the way has it"
    )]
    OtherPosture {
        /// Counted from 1.
        joint: usize,
        /// How far.
        off_deg: f64,
        /// When, after it set out.
        after_s: f64,
    },
}

/// An arm within this of a place of the path is there, rad.
const AT_RAD: f64 = 5e-3;

/// Most that the tool may be off its way, m: the arm's own error, and lines that bend in joint space.
const OFF_M: f64 = 3e-3;

/// Most that a joint may be off while the tool is on its way, rad: more is another posture. Where a corner
/// is cut, the nearest place of the path has joints a little different.
const POSTURE_RAD: f64 = 0.15;

/// Longest time between two samples, s: at 1 m/s the tool moves by less than a blend.
const GAP_S: f64 = 0.025;

/// More is no recording of ours, and would take long to judge: ways, segments of each, samples of each.
const MOST_WAYS: usize = 16;
const MOST_SEGMENTS: usize = 16;
const MOST_SAMPLES: usize = 20_000;

/// Speeds are measured over so long, s.
const SPEED_OVER_S: f64 = 0.02;

/// Share over the allowed speed, and m/s, that are the measurement's.
const SPEED_SHARE: f64 = 1.05;
const SPEED_ERROR_M_S: f64 = 0.01;

/// A controller may begin a blend so many radii before the corner (as the check of paths has it).
const RADIUS_SHARE: f64 = 1.1;

/// After the end is reached the arm is watched for so long, s: an arm that came too fast swings beyond it.
const WATCHED_S: f64 = 0.3;

/// Pieces that a segment is drawn with, and lines across a corner.
const PIECES: usize = 100;
const ACROSS: usize = 40;

type Point = Vector3<f64>;

/// Holds each path against the recording, in this order.
///
/// # Errors
/// The first [`BlendFault`], with the number of its path from 1.
pub fn judge(
    model: &ArmModel,
    paths: &[SentPath],
    track: &JointTrack,
) -> Result<Vec<Passage>, (usize, BlendFault)> {
    let too_many = |what, most| BlendFault::TooLong { what, most };
    if paths.len() > MOST_WAYS {
        return Err((MOST_WAYS + 1, too_many("ways", MOST_WAYS)));
    }
    let mut from = 0;
    let mut passages = Vec::with_capacity(paths.len());
    for (index, path) in paths.iter().enumerate() {
        let fault = |fault| (index + 1, fault);
        if path.segments.len() > MOST_SEGMENTS {
            return Err(fault(too_many("segments in a way", MOST_SEGMENTS)));
        }
        let (begins, arrives) = find(path, track, from).map_err(fault)?;
        passages.push(passage(model, path, track, begins, arrives).map_err(fault)?);
        from = arrives;
    }
    let recorded = paths.iter().any(cut_before_a_descent);
    if recorded { Ok(passages) } else { Err((paths.len().max(1), BlendFault::NoBlend)) }
}

/// The tool's highest speed on the path as it was sent, m/s.
pub fn fastest_m_s(model: &ArmModel, path: &SentPath) -> f64 {
    Drawn::new(model, path).fastest_m_s()
}

/// The corner after which an arm that is too fast would meet the table.
fn cut_before_a_descent(path: &SentPath) -> bool {
    let cut = |pair: &[Segment]| match pair {
        [Segment::Joint { blend, .. }, Segment::Linear { .. }] => *blend > 0.0,
        _ => false,
    };
    path.segments.windows(2).any(cut)
}

/// The last sample at the start, and the first at the end after it.
fn find(path: &SentPath, track: &JointTrack, from: usize) -> Result<(usize, usize), BlendFault> {
    let end = path.segments.last().map_or(path.start, Segment::target);
    let at =
        |place: &Joints, k: usize| track.joints.get(k).is_some_and(|q| q.max_difference(place) <= AT_RAD);
    let count = track.joints.len().min(track.times_s.len());
    let first = (from..count).find(|k| at(&path.start, *k));
    let first = first.ok_or(BlendFault::NotThere("at the start"))?;
    let arrives = (first..count).find(|k| at(&end, *k));
    let arrives = arrives.ok_or(BlendFault::NotThere("at the end"))?;
    let begins = (first..arrives).rev().find(|k| at(&path.start, *k)).unwrap_or(first);
    Ok((begins, arrives))
}

fn passage(
    model: &ArmModel,
    path: &SentPath,
    track: &JointTrack,
    begins: usize,
    arrives: usize,
) -> Result<Passage, BlendFault> {
    let (began_s, arrived_s) = (track.times_s[begins], track.times_s[arrives]);
    let seen = seen(track, begins, arrived_s + WATCHED_S)?;
    let drawn = Drawn::new(model, path);
    let tool: Vec<Point> = seen.iter().map(|(_, q)| place(model, q)).collect();
    let near: Vec<Near> = tool.iter().map(|p| drawn.near(p)).collect();
    check_way(&seen, &near)?;
    let times_s: Vec<f64> = seen.iter().map(|(time_s, _)| *time_s).collect();
    let speeds = speeds(&times_s, &tool);
    check_speeds(&times_s, &speeds, &near)?;
    Ok(Passage {
        begins_s: began_s,
        seconds: arrived_s - began_s,
        off_m: near.iter().map(|near| near.off_m).fold(0.0, f64::max),
        fastest_m_s: speeds.iter().copied().fold(0.0, f64::max),
        allowed_m_s: drawn.fastest_m_s(),
        corners: drawn.corners.iter().filter_map(|corner| corner.passed(&tool, &speeds)).collect(),
    })
}

/// The samples of a way, without a gap.
fn seen(track: &JointTrack, begins: usize, over_s: f64) -> Result<Vec<(f64, Joints)>, BlendFault> {
    let all = track.times_s.iter().copied().zip(track.joints.iter().copied()).skip(begins);
    let seen: Vec<(f64, Joints)> =
        all.take_while(|(time_s, _)| *time_s <= over_s).take(MOST_SAMPLES + 1).collect();
    if seen.len() > MOST_SAMPLES {
        return Err(BlendFault::TooLong { what: "samples of a way", most: MOST_SAMPLES });
    }
    if let Some(pair) = seen.windows(2).find(|pair| pair[1].0 - pair[0].0 > GAP_S) {
        let (ms, most_ms) = (1e3 * (pair[1].0 - pair[0].0), 1e3 * GAP_S);
        return Err(BlendFault::Gap { ms, at_s: pair[0].0, most_ms });
    }
    let short_s = seen.last().map_or(over_s, |(last_s, _)| over_s - last_s);
    if short_s > GAP_S { Err(BlendFault::EndsTooSoon(short_s)) } else { Ok(seen) }
}

/// The tool on the path or in a corner, the joints those of that place.
fn check_way(seen: &[(f64, Joints)], near: &[Near]) -> Result<(), BlendFault> {
    let began_s = seen.first().map_or(0.0, |(time_s, _)| *time_s);
    for ((time_s, q), near) in seen.iter().zip(near) {
        let after_s = time_s - began_s;
        if near.off_m > OFF_M {
            let (off_mm, most_mm) = (mm_from_m(near.off_m), mm_from_m(OFF_M));
            return Err(BlendFault::Off { off_mm, after_s, most_mm });
        }
        let off = |joint: usize| (q.0[joint] - near.joints.0[joint]).abs();
        if let Some(joint) = (0..6).find(|joint| off(*joint) > POSTURE_RAD) {
            let off_deg = deg_from_rad(off(joint));
            return Err(BlendFault::OtherPosture { joint: joint + 1, off_deg, after_s });
        }
    }
    Ok(())
}

/// No sample faster than the places allow that the tool has passed while its speed was measured.
fn check_speeds(times_s: &[f64], speeds: &[f64], near: &[Near]) -> Result<(), BlendFault> {
    for (k, m_s) in speeds.iter().copied().enumerate() {
        let passed = (0..=k).rev().take_while(|j| times_s[k] - times_s[*j] <= SPEED_OVER_S + GAP_S);
        let allowed_m_s = passed.map(|j| near[j].allowed_m_s).fold(0.0, f64::max);
        if m_s > SPEED_SHARE * allowed_m_s + SPEED_ERROR_M_S {
            return Err(BlendFault::TooFast { m_s, allowed_m_s, after_s: times_s[k] - times_s[0] });
        }
    }
    Ok(())
}

fn place(model: &ArmModel, q: &Joints) -> Point {
    model.tool_at(q).translation.vector
}

/// The tool's speed at each sample, m/s, over the time before it.
fn speeds(times_s: &[f64], tool: &[Point]) -> Vec<f64> {
    let mut since = 0;
    let speed = |k: usize| {
        while since < k && times_s[k] - times_s[since + 1] >= SPEED_OVER_S {
            since += 1;
        }
        let over_s = times_s[k] - times_s[since];
        if over_s < 0.5 * SPEED_OVER_S { 0.0 } else { (tool[k] - tool[since]).norm() / over_s }
    };
    (0..tool.len()).map(speed).collect()
}

/// The path of the tool.
struct Drawn {
    ways: Vec<DrawnWay>,
    corners: Vec<DrawnCorner>,
}

/// A segment: where the tool passes, with which joints, and how fast it may be there, m/s.
struct DrawnWay {
    points: Vec<Point>,
    joints: Vec<Joints>,
    m_s: f64,
}

/// A corner that may be cut: where, the ends of its sides, and how fast the tool may be in it, m/s.
struct DrawnCorner {
    radius_m: f64,
    apex: Point,
    came: Point,
    goes: Point,
    m_s: f64,
}

/// Where the tool is on a path.
struct Near {
    /// Distance from the path, or from a corner that may be cut, m.
    off_m: f64,
    /// Joints of the nearest place.
    joints: Joints,
    /// How fast the tool may be there, m/s.
    allowed_m_s: f64,
}

impl Drawn {
    fn new(model: &ArmModel, path: &SentPath) -> Drawn {
        let mut from = path.start;
        let mut ways: Vec<DrawnWay> = Vec::with_capacity(path.segments.len());
        for segment in &path.segments {
            ways.push(DrawnWay::new(model, &from, segment));
            from = segment.target();
        }
        let corners = path.segments.iter().zip(ways.windows(2)).filter_map(|(segment, pair)| {
            let [into, out] = pair else { return None };
            let (radius_m, apex) = (segment.blend(), *into.points.last()?);
            let beyond = |p: &&Point| (*p - apex).norm() >= RADIUS_SHARE * radius_m;
            let came = into.points.iter().rev().find(beyond).or(into.points.first()).copied()?;
            let goes = out.points.iter().find(beyond).or(out.points.last()).copied()?;
            let m_s = into.m_s.max(out.m_s);
            (radius_m > 0.0).then_some(DrawnCorner { radius_m, apex, came, goes, m_s })
        });
        let corners = corners.collect();
        Drawn { ways, corners }
    }

    fn fastest_m_s(&self) -> f64 {
        self.ways.iter().map(|way| way.m_s).fold(0.0, f64::max)
    }

    fn near(&self, p: &Point) -> Near {
        let mut near = Near { off_m: f64::INFINITY, joints: Joints([0.0; 6]), allowed_m_s: 0.0 };
        for way in &self.ways {
            for (pair, joints) in way.points.windows(2).zip(&way.joints) {
                let off_m = from_line(p, &pair[0], &pair[1]);
                if off_m < near.off_m {
                    near = Near { off_m, joints: *joints, allowed_m_s: way.m_s };
                }
            }
        }
        for corner in &self.corners {
            near.off_m = near.off_m.min(corner.from(p));
            if (p - corner.apex).norm() <= RADIUS_SHARE * corner.radius_m {
                near.allowed_m_s = near.allowed_m_s.max(corner.m_s);
            }
        }
        near
    }
}

impl DrawnWay {
    fn new(model: &ArmModel, from: &Joints, segment: &Segment) -> DrawnWay {
        let to = segment.target();
        let share = |k: usize| k as f64 / PIECES as f64;
        let joints: Vec<Joints> = (0..=PIECES).map(|k| from.lerp(&to, share(k))).collect();
        match *segment {
            Segment::Joint { speed, .. } => {
                let points: Vec<Point> = joints.iter().map(|q| place(model, q)).collect();
                let longest = points.windows(2).map(|pair| (pair[1] - pair[0]).norm()).fold(0.0, f64::max);
                let m_per_rad = longest * PIECES as f64 / from.max_difference(&to).max(1e-9);
                DrawnWay { points, joints, m_s: speed * m_per_rad }
            }
            Segment::Linear { speed, .. } => {
                let (one, other) = (place(model, from), place(model, &to));
                let points = (0..=PIECES).map(|k| one.lerp(&other, share(k))).collect();
                DrawnWay { points, joints, m_s: speed }
            }
        }
    }
}

impl DrawnCorner {
    /// Distance from the area that the corner may be cut in, m.
    fn from(&self, p: &Point) -> f64 {
        let line = |k: usize| {
            let share = k as f64 / ACROSS as f64;
            from_line(p, &self.apex.lerp(&self.came, share), &self.apex.lerp(&self.goes, share))
        };
        (0..=ACROSS).map(line).fold(f64::INFINITY, f64::min)
    }

    /// How the tool passed; `None` where it never came near.
    fn passed(&self, tool: &[Point], speeds: &[f64]) -> Option<CornerPassage> {
        let far = |p: &Point| (p - self.apex).norm();
        let inside: Vec<usize> = (0..tool.len()).filter(|k| far(&tool[*k]) <= self.radius_m).collect();
        let (enters, leaves) = (*inside.first()?, *inside.last()?);
        let passed = &speeds[enters..=leaves];
        Some(CornerPassage {
            radius_m: self.radius_m,
            cut_m: tool.iter().map(far).fold(f64::INFINITY, f64::min),
            enters_m_s: speeds[enters],
            leaves_m_s: speeds[leaves],
            slowest_m_s: passed.iter().copied().fold(f64::INFINITY, f64::min),
        })
    }
}

/// Distance of a point from the line between two others, m.
fn from_line(p: &Point, one: &Point, other: &Point) -> f64 {
    let along = other - one;
    let share = ((p - one).dot(&along) / along.norm_squared().max(1e-18)).clamp(0.0, 1.0);
    (p - (one + along * share)).norm()
}

#[cfg(test)]
mod tests {
    use super::*;
    use cell_motion::bodies::Room;
    use cell_motion::crossing::Crossing;
    use cell_motion::testing::{cycle, model};

    const STEP_S: f64 = 0.008;

    fn sent() -> (ArmModel, SentPath) {
        let (model, cycle, room) = (model(0.5), cycle(), Room::empty());
        let there = Crossing::over_table(&model, &model.home, [0.5, 0.5], &cycle, &room).unwrap();
        let there = Crossing { slower: true, ..there };
        let path = there.path(&model, &there.start, &cycle, &room, f64::INFINITY).unwrap();
        (model, SentPath { start: there.start, segments: path.segments().to_vec() })
    }

    /// An arm that follows the path at this share of its speed, cutting corners by this share of their
    /// radius along a straight line.
    fn followed(model: &ArmModel, path: &SentPath, speed: f64, cut: f64) -> JointTrack {
        let mut stops = vec![path.start];
        let mut from = path.start;
        for (segment, next) in path.segments.iter().zip(path.segments.iter().skip(1)) {
            let (corner, to) = (segment.target(), next.target());
            let length = |a: &Joints, b: &Joints| (place(model, a) - place(model, b)).norm();
            let share = |way: f64| cut * segment.blend() / way;
            stops.push(corner.lerp(&from, share(length(&corner, &from))));
            stops.push(corner.lerp(&to, share(length(&corner, &to))));
            from = corner;
        }
        stops.extend(path.segments.last().map(Segment::target));
        let slowest_m_s =
            0.9 * Drawn::new(model, path).ways.iter().map(|way| way.m_s).fold(f64::INFINITY, f64::min);
        let mut track = JointTrack::default();
        for pair in stops.windows(2) {
            let metres = (place(model, &pair[0]) - place(model, &pair[1])).norm();
            let steps = (metres / (speed * slowest_m_s * STEP_S)).ceil().max(1.0) as usize;
            track.joints.extend((0..steps).map(|k| pair[0].lerp(&pair[1], k as f64 / steps as f64)));
        }
        track.joints.extend([stops.last().copied().unwrap_or(path.start); 50]);
        track.times_s = (0..track.joints.len()).map(|k| 100.0 + STEP_S * k as f64).collect();
        track
    }

    fn judged(track: &JointTrack) -> Result<Passage, BlendFault> {
        let (model, path) = sent();
        let passages = judge(&model, &[path], track).map_err(|(_, fault)| fault)?;
        Ok(passages.into_iter().next().unwrap())
    }

    #[test]
    fn an_arm_that_cuts_corners_or_stops_at_them_passes() {
        let (model, path) = sent();
        for cut in [0.0, 0.4, 1.0] {
            let passage = judged(&followed(&model, &path, 1.0, cut)).unwrap();
            assert_eq!(passage.corners.len(), 2);
            for corner in &passage.corners {
                // A line across a right angle passes it at the radius by the root of two.
                let expected = cut * corner.radius_m / 2f64.sqrt();
                assert!((corner.cut_m - expected).abs() < 2e-3, "{corner:?}, {expected}");
            }
            assert!(passage.fastest_m_s <= passage.allowed_m_s && passage.off_m < 1e-3, "{passage:?}");
        }
    }

    #[test]
    fn an_arm_that_is_off_its_way_or_too_fast_does_not() {
        let (model, path) = sent();
        // Corners that are cut by half as much again as was sent.
        let wide = judged(&followed(&model, &path, 1.0, 1.6)).unwrap_err();
        assert!(matches!(wide, BlendFault::Off { .. }), "{wide}");
        let fast = judged(&followed(&model, &path, 2.5, 0.5)).unwrap_err();
        assert!(matches!(fast, BlendFault::TooFast { .. }), "{fast}");
        // On its way down not faster than the transfer before, but faster than that segment allows.
        let (mut uneven, track) = (path.clone(), followed(&model, &path, 1.0, 0.0));
        let Some(Segment::Linear { speed, .. }) = uneven.segments.last_mut() else { panic!("{uneven:?}") };
        *speed *= 0.5;
        let (_, fast) = judge(&model, &[uneven], &track).unwrap_err();
        assert!(matches!(fast, BlendFault::TooFast { .. }), "{fast}");
        // An arm that came too fast goes beyond the end, and back.
        let mut beyond = followed(&model, &path, 1.0, 0.5);
        let count = beyond.joints.len();
        for (k, q) in beyond.joints[count - 45..count - 30].iter_mut().enumerate() {
            q.0[1] += 0.02 * (k as f64 / 15.0 * std::f64::consts::PI).sin();
        }
        let beyond = judged(&beyond).unwrap_err();
        assert!(matches!(beyond, BlendFault::Off { .. }), "{beyond}");
    }

    #[test]
    fn a_recording_without_the_whole_path_is_refused() {
        let (model, path) = sent();
        let whole = followed(&model, &path, 1.0, 0.5);
        let changed = |change: &dyn Fn(&mut JointTrack)| {
            let mut track = whole.clone();
            change(&mut track);
            judged(&track).unwrap_err()
        };
        let half = changed(&|track| track.joints.truncate(track.joints.len() / 2));
        assert_eq!(half, BlendFault::NotThere("at the end"));
        assert_eq!(changed(&|track| track.joints.clear()), BlendFault::NotThere("at the start"));
        let count = whole.joints.len();
        let cut = changed(&|track| track.joints.truncate(count - 40));
        assert!(matches!(cut, BlendFault::EndsTooSoon(_)), "{cut}");
        let gap = changed(&|track| {
            track.times_s.iter_mut().skip(60).for_each(|time_s| *time_s += 0.1);
        });
        assert!(matches!(gap, BlendFault::Gap { .. }), "{gap}");
        let turned = changed(&|track| {
            track.joints[count / 3..count / 2].iter_mut().for_each(|q| q.0[5] += 0.2);
        });
        assert!(matches!(turned, BlendFault::OtherPosture { joint: 6, .. }), "{turned}");
        // The arm stands for minutes on its way.
        let slow = changed(&|track| {
            let half = track.joints[count / 2];
            track.joints.splice(count / 2..count / 2, std::iter::repeat_n(half, MOST_SAMPLES));
            track.times_s = (0..track.joints.len()).map(|k| STEP_S * k as f64).collect();
        });
        assert!(matches!(slow, BlendFault::TooLong { .. }), "{slow}");
        let stops = |mut path: SentPath| {
            for segment in &mut path.segments {
                let (Segment::Joint { blend, .. } | Segment::Linear { blend, .. }) = segment;
                *blend = 0.0;
            }
            path
        };
        let none = judge(&model, &[stops(path)], &followed(&model, &sent().1, 1.0, 0.0)).unwrap_err();
        assert_eq!(none, (1, BlendFault::NoBlend));
    }
}
