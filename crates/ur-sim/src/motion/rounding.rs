//! How fast the arm is in a blend: what a controller may do there, and the curve it then takes.
//!
//! In: a reading of the controller's behaviour, joint positions and speeds at both ends of the blend. Out:
//! the speed at its end, joint positions inside. Pure. The vendor publishes neither the curve nor the
//! speed. The curve here is the cubic that touches both moves in joint space.

use crate::motion::FRAME_SECONDS;
use cell_values::units::Joints;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A blend begins at between these shares of its radius, in the readings that do not brake before it.
/// Chosen: a blend of 20 mm that began 3 mm before the corner was reported once, of a tool at 1 mm/s.
/// Nothing is published about late blends at speed or about early blends.
const BLEND_START_RANGE: std::ops::RangeInclusive<f64> = 0.5..=1.1;

/// A joint that has this share of the fastest one's speed leads.
const LEADING_SHARE: f64 = 0.5;

/// A curve with too fast a joint is stretched by this factor, repeatedly.
const LONGER: f64 = 1.1;
const LONGER_STEPS: usize = 80;

/// At which speed the arm passes a blend.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum EntrySpeed {
    /// It brakes before the blend, to what the blend's length lets it brake from.
    #[default]
    Braked,
    /// It keeps its speed to the end of the blend, and speeds up or brakes after it.
    Kept,
    /// As kept, but inside the blend it brakes to what it can be braked from until the next move's end.
    Scaled,
    /// It has the next move's own speed at the end of the blend.
    Raised,
}

/// The readings by name, as the configuration and the command line have them.
pub const ENTRY_SPEEDS: &[(&str, EntrySpeed)] = &[
    ("braked", EntrySpeed::Braked),
    ("kept", EntrySpeed::Kept),
    ("scaled", EntrySpeed::Scaled),
    ("raised", EntrySpeed::Raised),
];

/// How a controller blends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BlendConfig {
    /// At which speed.
    pub entry_speed: EntrySpeed,
    /// Seed of where the blends begin.
    pub seed: u64,
}

/// The blends of an arm, one after the other.
#[derive(Clone, Debug)]
pub struct Blends {
    entry_speed: EntrySpeed,
    rng: ChaCha8Rng,
}

impl Blends {
    /// As configured.
    pub fn new(config: BlendConfig) -> Blends {
        Blends { entry_speed: config.entry_speed, rng: ChaCha8Rng::seed_from_u64(config.seed ^ 0x626c_656e) }
    }

    /// At which speed they are passed.
    pub fn entry_speed(&self) -> EntrySpeed {
        self.entry_speed
    }

    /// The radius at which the next blend begins, early or late, m.
    pub fn radius(&mut self, nominal: f64) -> f64 {
        match self.entry_speed {
            EntrySpeed::Braked => nominal,
            EntrySpeed::Kept | EntrySpeed::Scaled | EntrySpeed::Raised if nominal > 0.0 => {
                nominal * self.rng.random_range(BLEND_START_RANGE)
            }
            EntrySpeed::Kept | EntrySpeed::Scaled | EntrySpeed::Raised => nominal,
        }
    }
}

impl EntrySpeed {
    /// The tool's speed at the end of a blend, m/s: it came in at `came`, the next move has the speed `own`
    /// and can be braked to rest from `brakes`.
    pub fn at_end(self, came: f64, own: f64, brakes: f64) -> f64 {
        match self {
            EntrySpeed::Braked | EntrySpeed::Kept => came,
            EntrySpeed::Scaled => came.min(brakes),
            EntrySpeed::Raised => own,
        }
    }
}

/// Positions and speeds of the joints where a curve begins or ends, rad and rad/s.
#[derive(Clone, Copy, Debug)]
pub struct JointState {
    /// Where.
    pub q: Joints,
    /// How fast.
    pub qd: [f64; 6],
}

/// The curve from one move to the next.
#[derive(Clone, Debug)]
pub struct Rounding {
    from: JointState,
    to: JointState,
    seconds: f64,
    smooth: bool,
}

impl Rounding {
    /// A curve of about so many seconds, stretched or shortened until it is smooth. If no time makes it
    /// smooth, some joints turn back.
    pub fn new(from: JointState, to: JointState, seconds: f64) -> Rounding {
        let [mut least, most] = smooth_seconds(&from, &to);
        // Joints that do not lead stay below the fastest speed at the ends.
        let fastest = fastest(&from, &to);
        let too_fast = |seconds: f64| (0..6).any(|joint| largest_speed(joint, &from, &to, seconds) > fastest);
        let mut steps = 0..LONGER_STEPS;
        while too_fast(least) && steps.next().is_some() {
            least = least.max(FRAME_SECONDS) * LONGER;
        }
        let seconds = seconds.clamp(least, most.max(least)).max(FRAME_SECONDS);
        Rounding { from, to, seconds, smooth: least <= most && steps.next().is_some() }
    }

    /// No leading joint turns back, unless its direction differs at the two ends.
    pub fn is_smooth(&self) -> bool {
        self.smooth
    }

    /// How long it takes, s.
    pub fn seconds(&self) -> f64 {
        self.seconds
    }

    /// Joint positions at `time` (s) of it.
    pub fn at(&self, time: f64) -> Joints {
        let s = (time / self.seconds).clamp(0.0, 1.0);
        let (s2, s3) = (s * s, s * s * s);
        let (begin, end) = (2.0 * s3 - 3.0 * s2 + 1.0, 3.0 * s2 - 2.0 * s3);
        let (leaves, arrives) = ((s3 - 2.0 * s2 + s) * self.seconds, (s3 - s2) * self.seconds);
        Joints(std::array::from_fn(|i| {
            let places = begin * self.from.q.0[i] + end * self.to.q.0[i];
            places + leaves * self.from.qd[i] + arrives * self.to.qd[i]
        }))
    }
}

/// The highest speed of any joint at either end, rad/s.
fn fastest(from: &JointState, to: &JointState) -> f64 {
    from.qd.iter().chain(&to.qd).fold(0.0f64, |most, one| most.max(one.abs()))
}

/// A joint's highest speed inside a cubic of so many seconds, rad/s: at the vertex of its parabola of speed.
fn largest_speed(joint: usize, from: &JointState, to: &JointState, seconds: f64) -> f64 {
    let mean = (to.q.0[joint] - from.q.0[joint]) / seconds.max(FRAME_SECONDS);
    let (one, other) = (from.qd[joint], to.qd[joint]);
    let (linear, square) = (6.0 * mean - 4.0 * one - 2.0 * other, 3.0 * (one + other) - 6.0 * mean);
    let turns = -linear / (2.0 * square);
    let inside = square.abs() > 1e-12 && (0.0..1.0).contains(&turns);
    if inside { (one + linear * turns / 2.0).abs() } else { 0.0 }
}

/// Between these times, s, no leading joint is faster in the curve than at both ends, and none that goes on
/// in its direction turns back: the speed of a cubic is a parabola over time.
fn smooth_seconds(from: &JointState, to: &JointState) -> [f64; 2] {
    let fastest = fastest(from, to);
    let mut seconds = [0.0f64, f64::INFINITY];
    for joint in 0..6 {
        let (one, other) = (from.qd[joint], to.qd[joint]);
        let (fast, slow) = if one.abs() > other.abs() { (one, other) } else { (other, one) };
        if fast.abs() < LEADING_SHARE * fastest {
            continue;
        }
        // In the direction of the faster end.
        let (way, slow, fast) =
            ((to.q.0[joint] - from.q.0[joint]) * fast.signum(), slow * fast.signum(), fast.abs());
        seconds[0] = seconds[0].max(3.0 * way / (slow + 2.0 * fast));
        if slow >= 0.0 {
            seconds[1] = seconds[1].min(3.0 * way / fast);
        }
    }
    seconds
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_has_the_positions_and_speeds_of_its_ends() {
        let from = JointState { q: Joints([0.1; 6]), qd: [0.5, 0.0, -0.2, 0.3, 0.0, 0.1] };
        let to = JointState { q: Joints([0.2; 6]), qd: [0.0, 0.7, 0.2, -0.3, 0.4, 0.1] };
        let curve = Rounding { from, to, seconds: 0.2, smooth: true };
        let h = 1e-7;
        for joint in 0..6 {
            let at = |time: f64| curve.at(time).0[joint];
            assert!((at(0.0) - 0.1).abs() < 1e-12 && (at(0.2) - 0.2).abs() < 1e-12);
            let (first, last) = ((at(h) - at(0.0)) / h, (at(0.2) - at(0.2 - h)) / h);
            assert!((first - from.qd[joint]).abs() < 1e-4, "{first}");
            assert!((last - to.qd[joint]).abs() < 1e-4, "{last}");
        }
    }

    /// A joint that is to go 0.1 rad, with 1 rad/s at one end and 0.1 at the other.
    #[test]
    fn no_curve_is_faster_than_its_ends_or_turns_back() {
        let state = |q: f64, qd: f64| JointState { q: Joints([q; 6]), qd: [qd; 6] };
        for (begins, ends) in [(1.0, 0.1), (0.1, 1.0), (1.0, -0.3), (-0.3, 1.0)] {
            for wanted in [0.01, 0.1, 0.2, 5.0] {
                let curve = Rounding::new(state(0.0, begins), state(0.1, ends), wanted);
                assert!(curve.is_smooth());
                let seconds = curve.seconds();
                let at = |k: i32| curve.at(seconds * f64::from(k) / 500.0).0[0];
                for k in 0..500 {
                    let speed = (at(k + 1) - at(k)) * 500.0 / seconds;
                    let least = begins.min(ends).min(0.0) - 1e-9;
                    // A joint whose ends differ in direction turns back.
                    assert!(speed < 1.001 && (speed >= least || least < -1e-6), "{wanted} s, {k}: {speed}");
                }
            }
        }
        // One joint would need longer than another one can take.
        let mut to = state(0.1, 1.0);
        to.q.0[1] = 10.0;
        assert!(!Rounding::new(state(0.0, 1.0), to, 0.1).is_smooth());
    }

    /// The first joint leads. The second one is slow at both ends and moves by 0.3 rad.
    #[test]
    fn a_joint_that_does_not_lead_is_no_faster_than_the_others() {
        let state = |q: [f64; 2], qd: [f64; 2]| JointState {
            q: Joints([q[0], q[1], 0.0, 0.0, 0.0, 0.0]),
            qd: [qd[0], qd[1], 0.0, 0.0, 0.0, 0.0],
        };
        for speeds in [[0.0, 0.0], [0.2, -0.1], [-0.4, 0.3]] {
            let (from, to) = (state([0.0, 0.0], [1.0, speeds[0]]), state([0.1, 0.3], [1.0, speeds[1]]));
            let curve = Rounding::new(from, to, 0.1);
            let seconds = curve.seconds();
            let at = |k: i32| curve.at(seconds * f64::from(k) / 500.0).0[1];
            let fastest = (0..500).map(|k| ((at(k + 1) - at(k)) * 500.0 / seconds).abs()).fold(0.0, f64::max);
            assert!(fastest > 0.5 && fastest < 1.001, "{speeds:?}: {fastest} rad/s in {seconds} s");
        }
    }

    #[test]
    fn each_reading_has_its_speed_at_the_end_of_a_blend() {
        let ends = |reading: EntrySpeed| reading.at_end(0.5, 0.7, 0.3);
        assert_eq!(ENTRY_SPEEDS.iter().map(|(_, one)| ends(*one)).collect::<Vec<_>>(), [0.5, 0.5, 0.3, 0.7]);
    }

    #[test]
    fn blends_begin_early_and_late_by_seed() {
        let radii = |entry_speed, seed| {
            let mut blends = Blends::new(BlendConfig { entry_speed, seed });
            (0..100).map(|_| blends.radius(0.03)).collect::<Vec<f64>>()
        };
        assert!(radii(EntrySpeed::Braked, 1).iter().all(|radius| *radius == 0.03));
        let kept = radii(EntrySpeed::Kept, 1);
        assert!(kept.iter().all(|radius| (0.015..=0.033).contains(radius)), "{kept:?}");
        assert!(kept.iter().any(|radius| *radius < 0.016) && kept.iter().any(|radius| *radius > 0.0325));
        assert_eq!(kept, radii(EntrySpeed::Kept, 1));
        assert_ne!(kept, radii(EntrySpeed::Kept, 2));
    }
}
