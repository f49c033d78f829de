//! Where the safety system does not let the arm be: beyond a plane of the safety configuration, or within
//! itself.
//!
//! In: the configured limits, the arm's parameters and joint positions. Out: how deep it is where it must
//! not be, and why. Links are the capsules of [`ur_arm::bodies`], which overestimate them by some 15 mm
//! on average: the arm may overlap itself by `TOLERANCE_M`. The tool is a capsule from the flange to the
//! tool centre point where the configuration gives it a radius; what it holds is no body here. Planes hold
//! the tool centre point, with that radius about it, and the elbow. Pure.

use cell_values::units::Joints;
use nalgebra::{Isometry3, Point3, Vector3};
use ur_arm::bodies::{BODY_NAMES, Capsule, HARMLESS_PAIRS, capsules};

/// Overlap of two capsules that is none of the links.
const TOLERANCE_M: f64 = 0.02;

/// Half a space that the arm must stay in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SafetyPlane {
    /// A point of the plane, base frame, m.
    pub point: [f64; 3],
    /// Towards where the arm may be; any length but 0.
    pub normal: [f64; 3],
}

/// The part of the safety configuration that is modelled.
#[derive(Clone, Debug, PartialEq)]
pub struct SafetyLimits {
    /// What tool and elbow must not pass.
    pub planes: Vec<SafetyPlane>,
    /// Fastest tool, m/s; motion is slowed down to it.
    pub tool_speed: f64,
    /// Most momentum of arm and payload, kg m/s; moves are slowed down to it. Absent: no limit.
    pub momentum: Option<f64>,
    /// Most mechanical work that the tool does to what it touches, W; moves are slowed down to it. Absent:
    /// no limit.
    pub power: Option<f64>,
    /// Radius of the tool, m. Absent: it is no body.
    pub tool_radius: Option<f64>,
}

impl Default for SafetyLimits {
    /// No planes, 1.5 m/s, and nothing else that slows an arm down.
    fn default() -> SafetyLimits {
        SafetyLimits { planes: Vec::new(), tool_speed: 1.5, momentum: None, power: None, tool_radius: None }
    }
}

/// The arm is where it must not be.
#[derive(Clone, Debug, PartialEq)]
pub struct Intrusion {
    /// How deep, m.
    pub depth: f64,
    /// For the message.
    pub reason: String,
    /// The joint that moves the farther of two links; none for a plane.
    pub joint: Option<usize>,
}

impl SafetyLimits {
    /// How far a ball about `point` (base frame, m) is beyond a plane, and which one; `None` if it is within
    /// all.
    pub fn beyond(&self, point: &Vector3<f64>, radius: f64) -> Option<(usize, f64)> {
        self.farthest_beyond(point, radius).filter(|(_, depth)| *depth > 0.0)
    }

    /// The plane that the ball is farthest beyond, or has the least room to; `None` if there are no planes.
    fn farthest_beyond(&self, point: &Vector3<f64>, radius: f64) -> Option<(usize, f64)> {
        let beyond = self.planes.iter().enumerate().map(|(number, plane)| {
            let inwards = Vector3::from(plane.normal).normalize();
            (number, radius - inwards.dot(&(point - Vector3::from(plane.point))))
        });
        beyond.max_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// The share of the limits of momentum and power that a motion takes: `momentum` (kg m/s) is that of arm
    /// and payload, `power` (W) what the tool does to what it touches.
    pub fn strain(&self, momentum: impl FnOnce() -> f64, power: impl FnOnce() -> f64) -> f64 {
        let momentum = self.momentum.map_or(0.0, |most| momentum() / most);
        momentum.max(self.power.map_or(0.0, |most| power() / most))
    }

    /// A lower bound of the clearance to planes, links and tool, m, for these bodies and this tool centre
    /// point in the base frame.
    ///
    /// # Errors
    /// The deepest intrusion.
    pub fn clearance(
        &self,
        model: &str,
        bodies: &[Isometry3<f64>; 6],
        tcp: &Vector3<f64>,
    ) -> Result<f64, Intrusion> {
        let about = self.tool_radius.unwrap_or(0.0);
        let points = [("tool", *tcp, about), ("elbow", bodies[1].translation.vector, 0.0)];
        let planes = points.iter().filter_map(|(name, point, about)| {
            let (number, depth) = self.farthest_beyond(point, *about)?;
            Some((depth, Contact::Plane(name, number)))
        });
        let tool = self.tool_radius.and_then(|radius| tool_against_arm(model, bodies, tcp, radius));
        let all = planes.chain(with_itself(model, bodies)).chain(tool);
        match all.max_by(|a, b| a.0.total_cmp(&b.0)) {
            Some((depth, place)) if depth > 0.0 => Err(place.intrusion(depth)),
            Some((depth, _)) => Ok(-depth),
            None => Ok(f64::INFINITY),
        }
    }
}

/// The pair of things that overlap most, or are nearest to each other.
enum Contact {
    /// A point of the arm by its name, and the number of the plane.
    Plane(&'static str, usize),
    /// A link, and the one farther out.
    Links(usize, usize),
    /// The tool and a link.
    Tool(usize),
}

impl Contact {
    fn intrusion(self, depth: f64) -> Intrusion {
        let (reason, joint) = match self {
            Contact::Plane(name, number) => (format!("{name} beyond safety plane {number}"), None),
            Contact::Links(a, b) => (format!("{} against {}", BODY_NAMES[b], BODY_NAMES[a]), Some(b - 1)),
            // The argument of the message counts joints: the last one moves the tool.
            Contact::Tool(body) => (format!("tool against {}", BODY_NAMES[body]), Some(5)),
        };
        Intrusion { depth, reason, joint }
    }
}

/// No point of arm and tool is farther from a joint's axis than this and the tool's length, m.
const REACH_M: f64 = 2.5;

/// The clearance found at some joint positions. No new check is needed until the joints could have used it
/// up.
#[derive(Clone, Copy, Debug)]
pub struct Clearance {
    /// Joint positions, rad.
    pub q: Joints,
    /// The tool centre point in the flange frame, m.
    pub tcp: Vector3<f64>,
    /// A lower bound of it, m.
    pub clear_m: f64,
}

impl Clearance {
    /// True if the arm is certainly still clear with these joint positions and this tool centre point.
    pub fn covers(&self, q: &Joints, tcp: &Vector3<f64>) -> bool {
        let turned: f64 = q.0.iter().zip(&self.q.0).map(|(now, then)| (now - then).abs()).sum();
        turned * (REACH_M + tcp.norm()) + (tcp - self.tcp).norm() < self.clear_m
    }
}

/// Bodies that the tool can meet: it turns with wrist 3, and on the usual arms its way to wrist 1 is barred
/// by wrist 2.
const MET_BY_TOOL: std::ops::RangeInclusive<usize> = 0..=3;

/// How deep the tool is in a link.
fn tool_against_arm(
    model: &str,
    frames: &[Isometry3<f64>; 6],
    tcp: &Vector3<f64>,
    radius: f64,
) -> Option<(f64, Contact)> {
    let bodies = capsules(model)?;
    let ends = [Point3::from(frames[5].translation.vector), Point3::from(*tcp)];
    let depths = MET_BY_TOOL.map(|body| {
        let place = body.checked_sub(1).map_or(Isometry3::identity(), |link| frames[link]);
        let overlaps = bodies[body].iter().map(|capsule| {
            let link = [capsule.a, capsule.b].map(|end| place * Point3::from(end));
            radius + capsule.radius - distance(&ends, &link)
        });
        (overlaps.fold(f64::NEG_INFINITY, f64::max) - TOLERANCE_M, Contact::Tool(body))
    });
    depths.max_by(|a, b| a.0.total_cmp(&b.0))
}

/// The deepest overlap of two links beyond the tolerance.
fn with_itself(model: &str, frames: &[Isometry3<f64>; 6]) -> Option<(f64, Contact)> {
    let bodies = capsules(model)?;
    let place = |body: usize| body.checked_sub(1).map_or(Isometry3::identity(), |link| frames[link]);
    let balls: [Ball; 7] = std::array::from_fn(|body| Ball::round(bodies[body], &place(body)));
    let pairs = (0..7).flat_map(|a| (a + 1..7).map(move |b| (a, b)));
    let overlaps = pairs.filter(|pair| !HARMLESS_PAIRS.contains(pair)).map(|(a, b)| {
        let apart = balls[a].distance(&balls[b]);
        let overlap =
            if apart > 0.0 { -apart } else { deepest((bodies[a], &place(a)), (bodies[b], &place(b))) };
        (overlap - TOLERANCE_M, Contact::Links(a, b))
    });
    overlaps.max_by(|x, y| x.0.total_cmp(&y.0))
}

/// A ball round some capsules: bodies whose balls are apart are apart.
struct Ball {
    middle: Point3<f64>,
    radius: f64,
}

impl Ball {
    fn round(capsules: &[Capsule], place: &Isometry3<f64>) -> Ball {
        let ends = || capsules.iter().flat_map(|capsule| [capsule.a, capsule.b]).map(Vector3::from);
        let middle = ends().sum::<Vector3<f64>>() / (2 * capsules.len()).max(1) as f64;
        let farthest = |capsule: &Capsule| {
            let to = |end: [f64; 3]| (Vector3::from(end) - middle).norm();
            to(capsule.a).max(to(capsule.b)) + capsule.radius
        };
        let radius = capsules.iter().map(farthest).fold(0.0, f64::max);
        Ball { middle: place * Point3::from(middle), radius }
    }

    fn distance(&self, other: &Ball) -> f64 {
        (self.middle - other.middle).norm() - self.radius - other.radius
    }
}

type LinkAt<'a> = (&'a [Capsule], &'a Isometry3<f64>);

fn deepest((shapes, a): LinkAt<'_>, (others, b): LinkAt<'_>) -> f64 {
    let placed =
        |capsule: &Capsule, at: &Isometry3<f64>| [capsule.a, capsule.b].map(|end| at * Point3::from(end));
    let mut deepest = f64::NEG_INFINITY;
    for shape in shapes {
        let ends = placed(shape, a);
        for other in others {
            deepest = deepest.max(shape.radius + other.radius - distance(&ends, &placed(other, b)));
        }
    }
    deepest
}

/// Distance of two segments: from the best point of one, clamped, to the best of the other.
fn distance([a, b]: &[Point3<f64>; 2], [c, d]: &[Point3<f64>; 2]) -> f64 {
    let (u, v, between) = (b - a, d - c, a - c);
    let (uu, uv, vv) = (u.dot(&u), u.dot(&v), v.dot(&v));
    let (ub, vb) = (u.dot(&between), v.dot(&between));
    let parallel = uu * vv - uv * uv;
    let mut s = if parallel > 1e-15 { ((uv * vb - vv * ub) / parallel).clamp(0.0, 1.0) } else { 0.0 };
    let mut t = (uv * s + vb) / vv.max(1e-15);
    if !(0.0..=1.0).contains(&t) {
        t = t.clamp(0.0, 1.0);
        s = ((uv * t - ub) / uu.max(1e-15)).clamp(0.0, 1.0);
    }
    ((a + u * s) - (c + v * t)).norm()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use ur_arm::chain::{Chain, Placed};
    use ur_arm::models::{ARM_MODELS, DhParameters};

    fn placed(q: [f64; 6]) -> Placed {
        Chain::of(&DhParameters::UR5E).placed(&Joints(q))
    }

    fn intrusion(q: [f64; 6]) -> Option<Intrusion> {
        let at = placed(q);
        SafetyLimits::default().clearance("UR5e", &at.bodies, &at.frames[5].translation.vector).err()
    }

    #[test]
    fn ordinary_postures_are_free_and_a_folded_arm_is_not() {
        let half = std::f64::consts::FRAC_PI_2;
        for q in [
            [0.0; 6],
            [0.0, -half, half, -half, -half, 0.0],
            [0.0, -half, 0.0, -half, 0.0, 0.0],
            [0.0, -1.047, 2.094, -2.618, -half, 0.0],
        ] {
            assert_eq!(intrusion(q), None, "{q:?}");
        }
        let folded = intrusion([0.0, -half, 3.0, 0.0, 0.0, 0.0]).unwrap();
        assert!(folded.depth > 0.01 && folded.joint.is_some(), "{folded:?}");
        let bodies = placed([0.0, -half, 3.0, 0.0, 0.0, 0.0]).bodies;
        let unknown = SafetyLimits::default().clearance("UR99", &bodies, &Vector3::zeros());
        assert_eq!(unknown, Ok(f64::INFINITY), "its capsules are not published");
    }

    #[test]
    fn planes_hold_tool_and_elbow() {
        let plane = SafetyPlane { point: [0.0, 0.0, 0.1], normal: [0.0, 0.0, 2.0] };
        let limits = SafetyLimits { planes: vec![plane], ..SafetyLimits::default() };
        assert_eq!(limits.beyond(&Vector3::new(0.3, 0.0, 0.2), 0.0), None);
        let (number, depth) = limits.beyond(&Vector3::new(0.3, 0.0, 0.04), 0.0).unwrap();
        assert!(number == 0 && (depth - 0.06).abs() < 1e-12);
        assert_eq!(limits.beyond(&Vector3::new(0.3, 0.0, 0.14), 0.05).map(|(number, _)| number), Some(0));
        let bodies = placed([0.0, 0.4, 0.0, 0.0, 0.0, 0.0]).bodies;
        let found = limits.clearance("UR5e", &bodies, &Vector3::z());
        assert!(found.unwrap_err().reason.starts_with("elbow beyond safety plane 0"));
    }

    #[test]
    fn a_tool_with_a_radius_is_a_body() {
        // A tool that reaches back to the middle of the forearm.
        let at = placed([0.0, -1.5, 1.5, -1.5, -1.57, 0.0]);
        let tcp = (at.frames[2] * Point3::new(0.15, 0.0, 0.0066)).coords;
        let with = |tool_radius| {
            let limits = SafetyLimits { tool_radius, ..SafetyLimits::default() };
            limits.clearance("UR5e", &at.bodies, &tcp).err()
        };
        assert_eq!(with(None), None);
        let found = with(Some(0.05)).unwrap();
        assert!(found.reason.starts_with("tool against") && found.joint == Some(5), "{found:?}");
        let thinner = with(Some(0.04)).unwrap();
        assert!((found.depth - thinner.depth - 0.01).abs() < 1e-12);
    }

    #[test]
    fn strain_is_the_larger_share_of_the_limits() {
        let none = SafetyLimits::default();
        assert_eq!(none.strain(|| panic!("not asked for"), || panic!("not asked for")), 0.0);
        let limits = SafetyLimits { momentum: Some(10.0), power: Some(80.0), ..none };
        assert_eq!((limits.strain(|| 5.0, || 20.0), limits.strain(|| 5.0, || 80.0)), (0.5, 1.0));
    }

    proptest! {
        /// No intrusion is skipped: the joints turn, and the tool changes, as far as the clearance allows.
        #[test]
        fn where_a_clearance_holds_the_arm_is_free(
            q in proptest::array::uniform6(-3.0..3.0f64),
            turned in proptest::array::uniform6(-1.0..1.0f64),
            tcp in proptest::array::uniform3(-0.2..0.2f64),
            changed in proptest::array::uniform3(-1.0..1.0f64),
            model in 0..5usize,
        ) {
            let plane = SafetyPlane { point: [0.0, 0.4, 0.0], normal: [0.0, -1.0, 0.2] };
            let limits =
                SafetyLimits { planes: vec![plane], tool_radius: Some(0.04), ..SafetyLimits::default() };
            let model = ["UR3e", "UR5e", "UR10e", "UR16e", "UR20"][model];
            let arm = ARM_MODELS.iter().find(|arm| arm.name == model).expect("a model");
            let dh = arm.dh;
            let clearance = |q: &Joints, tcp: &Vector3<f64>| {
                let at = Chain::of(&dh).placed(q);
                limits.clearance(model, &at.bodies, &(at.frames[5] * Point3::from(*tcp)).coords)
            };
            let (q, tcp) = (Joints(q), Vector3::from(tcp));
            let Ok(clear_m) = clearance(&q, &tcp) else { return Ok(()) };
            let here = Clearance { q, tcp, clear_m };
            // 49 % by the joints, 49 % by the tool.
            let sum: f64 = turned.iter().map(|turn| turn.abs()).sum();
            let changed = Vector3::from(changed).normalize() * (0.49 * clear_m.min(1.0));
            let reach = REACH_M + (tcp + changed).norm();
            let turn = 0.49 * clear_m.min(1.0) / reach / sum;
            let next = Joints(std::array::from_fn(|joint| q.0[joint] + turned[joint] * turn));
            prop_assert!(here.covers(&next, &(tcp + changed)) || clear_m < 1e-9);
            prop_assert!(clearance(&next, &(tcp + changed)).is_ok());
        }

        #[test]
        fn segments_are_no_farther_apart_than_their_nearest_samples(
            numbers in proptest::array::uniform12(-1.0..1.0f64),
        ) {
            let point = |i: usize| Point3::new(numbers[i], numbers[i + 1], numbers[i + 2]);
            let (one, two) = ([point(0), point(3)], [point(6), point(9)]);
            let at = |[a, b]: &[Point3<f64>; 2], k: i32| a + (b - a) * (f64::from(k) / 50.0);
            let samples = (0..=50).flat_map(|i| (0..=50).map(move |k| (i, k)));
            let nearest = samples.map(|(i, k)| (at(&one, i) - at(&two, k)).norm()).fold(f64::INFINITY, f64::min);
            let found = distance(&one, &two);
            prop_assert!(found <= nearest + 1e-9 && found >= nearest - 0.08, "{found} {nearest}");
            prop_assert!((found - distance(&two, &one)).abs() < 1e-9);
        }
    }
}
