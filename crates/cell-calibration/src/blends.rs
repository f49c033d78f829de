//! How a real arm passed the corners that celld had it cut: the recording against the plan.
//!
//! In: paths as they were sent, and the arm's joints as the controller reported them meanwhile. Out: a
//! [`Passage`] for each path: how far off its way the tool came, how fast it was, how each corner was cut;
//! or a [`BlendFault`], with which celld has to stop at corners. What is allowed is what paths are checked
//! for: any way inside the corner, at any speed up to the fastest of the path. Pure.

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
    /// The path is not in the recording.
    #[error("the recording does not show the arm {0}")]
    NotThere(&'static str),
    /// Too long without a sample.
    #[error("the recording has a hole of {ms:.0} ms at {at_s:.2} s, at most {most_ms:.0} ms are read")]
    Hole {
        /// Its length.
        ms: f64,
        /// Where it begins.
        at_s: f64,
        /// The longest allowed.
        most_ms: f64,
    },
    /// Nothing to record.
    #[error("no corner of the path is cut: at these speeds `limits.blend_m` saves nothing")]
    NoBlend,
    /// The tool left the corridor.
    #[error(
        "the tool was {off_mm:.1} mm off its way {after_s:.2} s after the start, at most {most_mm:.0} mm"
    )]
    Off {
        /// How far.
        off_mm: f64,
        /// When, in the path.
        after_s: f64,
        /// What is allowed.
        most_mm: f64,
    },
    /// The tool was too fast.
    #[error("the tool moved at {m_s:.2} m/s, the path allows {allowed_m_s:.2} m/s")]
    TooFast {
        /// Measured.
        m_s: f64,
        /// Allowed.
        allowed_m_s: f64,
    },
    /// The arm stood in another posture than that of the path.
    #[error("joint {joint} was {off_deg:.1} degrees from where the path ends")]
    OtherEnd {
        /// Counted from 1.
        joint: usize,
        /// How far.
        off_deg: f64,
    },
}

/// An arm within this of a place of the path is there, rad.
const AT_RAD: f64 = 5e-3;

/// Most that the tool may be off its way, m: the arm's own error, and lines that bend in joint space.
const OFF_M: f64 = 3e-3;

/// Longest time between two samples, s: at 1 m/s the tool moves by less than a blend.
const HOLE_S: f64 = 0.025;

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
    let mut from = 0;
    let mut passages = Vec::with_capacity(paths.len());
    for (index, path) in paths.iter().enumerate() {
        let fault = |fault| (index + 1, fault);
        let (begins, arrives) = find(path, track, from).map_err(fault)?;
        passages.push(passage(model, path, track, begins, arrives).map_err(fault)?);
        from = arrives;
    }
    let cut = passages.iter().any(|passage| !passage.corners.is_empty());
    if cut { Ok(passages) } else { Err((paths.len(), BlendFault::NoBlend)) }
}

/// The last sample at the start, and the first at the end after it.
fn find(path: &SentPath, track: &JointTrack, from: usize) -> Result<(usize, usize), BlendFault> {
    let end = path.segments.last().map_or(path.start, Segment::target);
    let at =
        |place: &Joints, k: usize| track.joints.get(k).is_some_and(|q| q.max_difference(place) <= AT_RAD);
    let count = track.joints.len().min(track.times_s.len());
    let first = (from..count).find(|k| at(&path.start, *k));
    let first = first.ok_or(BlendFault::NotThere("where a path begins"))?;
    let arrives = (first..count).find(|k| at(&end, *k));
    let arrives = arrives.ok_or(BlendFault::NotThere("where a path ends"))?;
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
    let began_s = track.times_s[begins];
    let over_s = track.times_s[arrives] + WATCHED_S;
    let count = track.times_s[begins..].iter().take_while(|time_s| **time_s <= over_s).count();
    let times_s = &track.times_s[begins..begins + count];
    let tool: Vec<Point> = track.joints[begins..begins + count].iter().map(|q| place(model, q)).collect();
    if let Some(pair) = times_s.windows(2).find(|pair| pair[1] - pair[0] > HOLE_S) {
        let (ms, most_ms) = (1e3 * (pair[1] - pair[0]), 1e3 * HOLE_S);
        return Err(BlendFault::Hole { ms, at_s: pair[0], most_ms });
    }
    check_end(path, &track.joints[begins + count - 1])?;
    let drawn = Drawn::new(model, path);
    let (at, off_m) = drawn.farthest(&tool);
    if off_m > OFF_M {
        let (off_mm, most_mm) = (mm_from_m(off_m), mm_from_m(OFF_M));
        return Err(BlendFault::Off { off_mm, after_s: times_s[at] - began_s, most_mm });
    }
    let speeds = speeds(times_s, &tool);
    let fastest_m_s = speeds.iter().copied().fold(0.0, f64::max);
    let allowed_m_s = drawn.allowed_m_s;
    if fastest_m_s > SPEED_SHARE * allowed_m_s + SPEED_ERROR_M_S {
        return Err(BlendFault::TooFast { m_s: fastest_m_s, allowed_m_s });
    }
    let corners = drawn.corners.iter().filter_map(|corner| corner.passed(&tool, &speeds)).collect();
    let seconds = track.times_s[arrives] - began_s;
    Ok(Passage { begins_s: began_s, seconds, off_m, fastest_m_s, allowed_m_s, corners })
}

/// Another posture could have the tool in the same place.
fn check_end(path: &SentPath, q: &Joints) -> Result<(), BlendFault> {
    let end = path.segments.last().map_or(path.start, Segment::target);
    let off = |joint: usize| (q.0[joint] - end.0[joint]).abs();
    match (0..6).find(|joint| off(*joint) > AT_RAD) {
        Some(joint) => Err(BlendFault::OtherEnd { joint: joint + 1, off_deg: deg_from_rad(off(joint)) }),
        None => Ok(()),
    }
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
    points: Vec<Point>,
    corners: Vec<DrawnCorner>,
    allowed_m_s: f64,
}

/// A corner that may be cut: where, and the ends of its sides.
struct DrawnCorner {
    radius_m: f64,
    apex: Point,
    came: Point,
    goes: Point,
}

impl Drawn {
    fn new(model: &ArmModel, path: &SentPath) -> Drawn {
        let mut from = path.start;
        let mut ways: Vec<Vec<Point>> = Vec::with_capacity(path.segments.len());
        let mut allowed_m_s: f64 = 0.0;
        for segment in &path.segments {
            let to = segment.target();
            let (way, m_s) = way(model, &from, segment);
            allowed_m_s = allowed_m_s.max(m_s);
            ways.push(way);
            from = to;
        }
        let blends = path.segments.iter().zip(ways.windows(2));
        let corners = blends.filter(|(segment, _)| segment.blend() > 0.0).filter_map(|(segment, pair)| {
            let [into, out] = pair else { return None };
            let (apex, far) = (*into.last()?, RADIUS_SHARE * segment.blend());
            let beyond = |p: &&Point| (*p - apex).norm() >= far;
            let came = into.iter().rev().find(beyond).or(into.first()).copied()?;
            let goes = out.iter().find(beyond).or(out.last()).copied()?;
            Some(DrawnCorner { radius_m: segment.blend(), apex, came, goes })
        });
        Drawn { corners: corners.collect(), points: ways.concat(), allowed_m_s }
    }

    /// The sample that is farthest from path and corners, and how far that is, m.
    fn farthest(&self, tool: &[Point]) -> (usize, f64) {
        let off = |p: &Point| {
            let path = self.points.windows(2).map(|pair| from_line(p, &pair[0], &pair[1]));
            path.chain(self.corners.iter().map(|corner| corner.from(p))).fold(f64::INFINITY, f64::min)
        };
        let offs = tool.iter().map(off).enumerate();
        offs.fold((0, 0.0), |most, next| if next.1 > most.1 { next } else { most })
    }
}

/// Where the tool passes on a segment, and how fast it may be there, m/s.
fn way(model: &ArmModel, from: &Joints, segment: &Segment) -> (Vec<Point>, f64) {
    let to = segment.target();
    let share = |k: usize| k as f64 / PIECES as f64;
    match *segment {
        Segment::Joint { speed, .. } => {
            let way: Vec<Point> = (0..=PIECES).map(|k| place(model, &from.lerp(&to, share(k)))).collect();
            let longest = way.windows(2).map(|pair| (pair[1] - pair[0]).norm()).fold(0.0, f64::max);
            let m_per_rad = longest * PIECES as f64 / from.max_difference(&to).max(1e-9);
            (way, speed * m_per_rad)
        }
        Segment::Linear { speed, .. } => {
            let (one, other) = (place(model, from), place(model, &to));
            ((0..=PIECES).map(|k| one.lerp(&other, share(k))).collect(), speed)
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
            0.9 * path.segments.iter().map(|one| way(model, &path.start, one).1).fold(1.0, f64::min);
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
    fn a_recording_that_does_not_show_the_path_is_refused() {
        let (model, path) = sent();
        let whole = followed(&model, &path, 1.0, 0.5);
        let changed = |change: &dyn Fn(&mut JointTrack)| {
            let mut track = whole.clone();
            change(&mut track);
            judged(&track).unwrap_err()
        };
        let half = changed(&|track| track.joints.truncate(track.joints.len() / 2));
        assert_eq!(half, BlendFault::NotThere("where a path ends"));
        assert_eq!(changed(&|track| track.joints.clear()), BlendFault::NotThere("where a path begins"));
        let hole = changed(&|track| {
            track.times_s.iter_mut().skip(60).for_each(|time_s| *time_s += 0.1);
        });
        assert!(matches!(hole, BlendFault::Hole { .. }), "{hole}");
        let turned = changed(&|track| {
            let count = track.joints.len();
            track.joints[count - 20..].iter_mut().for_each(|q| q.0[5] += 0.02);
        });
        assert!(matches!(turned, BlendFault::OtherEnd { joint: 6, .. }), "{turned}");
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
