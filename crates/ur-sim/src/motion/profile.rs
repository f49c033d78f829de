//! Speed over a path: a trapezoid, with a slower end where the next segment blends in and a timed start
//! where this one blends in.
//!
//! In: length, speed and acceleration of the path, blend distance at its end, length in time of the
//! predecessor's end. Out: position and speed along the path at any time. Pure arithmetic; lengths in the
//! path's own unit (rad of the leading joint, m of the tool).
//! A blend is the sum of two motions: while one brakes to a stop over the blend distance, the next starts,
//! taking as long to reach its speed. Both ramps being equally long, speed in a straight continuation stays
//! constant, and round a corner the path is a parabola. A path that is entered faster than its length allows
//! to brake from is overrun: the arm goes past the end and comes back. If such a path has a blend at its end
//! and no next move rounds that corner, the arm brakes harder in the blend.

/// What a profile is built from.
#[derive(Clone, Copy, Debug)]
pub struct Shape {
    /// Length of the path; not negative.
    pub length: f64,
    /// Cruising speed; positive.
    pub speed: f64,
    /// Acceleration; positive.
    pub acceleration: f64,
    /// Distance before the end at which the successor may start; 0 for none.
    pub blend: f64,
    /// Time the predecessor still needs, s; 0 for a start from rest.
    pub lead: f64,
    /// The arm comes to the blend at full speed: whatever takes over there goes on with it.
    pub keeps: bool,
    /// Speed at the start, of a path that takes over from another in full motion; then there is no `lead`.
    pub entry: f64,
}

#[derive(Clone, Copy, Debug)]
struct Phase {
    duration: f64,
    speed: f64,
    acceleration: f64,
}

/// Position and speed over time.
#[derive(Clone, Debug)]
pub struct Profile {
    phases: Vec<Phase>,
    length: f64,
    /// Profile seconds per second, when a duration was requested.
    rate: f64,
    tail: f64,
    /// The arm goes past the end.
    overruns: bool,
}

impl Profile {
    /// The fastest profile of a shape.
    pub fn new(shape: &Shape) -> Profile {
        let Shape { length, speed, acceleration: a, lead, entry, keeps, .. } = *shape;
        if length <= 0.0 {
            return Profile { phases: Vec::new(), length: 0.0, rate: 1.0, tail: 0.0, overruns: false };
        }
        // The middle of the path belongs to no blend, so that the two of a path cannot overlap.
        let blend = shape.blend.clamp(0.0, length / 2.0);
        let until_tail = length - blend;
        let braked = if keeps { speed } else { speed.min((2.0 * a * blend).sqrt()) };
        let mut out = if blend > 0.0 { braked } else { 0.0 };
        let start = if entry > 0.0 { entry } else { start_speed(lead, speed, a, until_tail, out) };
        let ramp = if entry > 0.0 { 0.0 } else { start * lead / 2.0 };
        let middle = (until_tail - ramp).max(0.0);
        out = out.min((start * start + 2.0 * a * middle).sqrt());
        let slowest = (start * start - 2.0 * a * middle).max(0.0).sqrt();
        if entry > 0.0 && keeps && slowest > out {
            if blend <= 0.0 {
                return Profile::overrun(entry, a, length);
            }
            // The next move takes over from an arm that is still too fast.
            out = slowest;
        }
        // A process move that is entered too fast for the way there is brakes harder.
        let needed = (start * start - out * out) / (2.0 * middle.max(1e-9));
        let a = if entry > 0.0 { a.max(needed) } else { a };
        let peak = speed.min(((2.0 * a * middle + start * start + out * out) / 2.0).sqrt()).max(out);
        let peak = if entry > 0.0 { peak } else { peak.max(start) };
        let ramps = ((start * start - peak * peak).abs() + peak * peak - out * out) / (2.0 * a);
        let tail = if out > 0.0 { 2.0 * blend / out } else { 0.0 };
        let lead_slope = if lead > 0.0 { start / lead } else { 0.0 };
        let tail_slope = if tail > 0.0 { -out / tail } else { 0.0 };
        let phases = [
            Phase {
                duration: if start > 0.0 && entry <= 0.0 { lead } else { 0.0 },
                speed: 0.0,
                acceleration: lead_slope,
            },
            Phase {
                duration: (peak - start).abs() / a,
                speed: start,
                acceleration: if start > peak { -a } else { a },
            },
            Phase { duration: ((middle - ramps) / peak).max(0.0), speed: peak, acceleration: 0.0 },
            Phase { duration: (peak - out) / a, speed: peak, acceleration: -a },
            Phase { duration: tail, speed: out, acceleration: tail_slope },
        ];
        let phases = phases.into_iter().filter(|phase| phase.duration > 0.0).collect();
        Profile { phases, length, rate: 1.0, tail, overruns: false }
    }

    /// From `entry` braked at `a` until the arm rests beyond the end, then back to it.
    fn overrun(entry: f64, a: f64, length: f64) -> Profile {
        let beyond = entry * entry / (2.0 * a) - length;
        let half = (beyond / a).sqrt();
        let phases = vec![
            Phase { duration: entry / a, speed: entry, acceleration: -a },
            Phase { duration: half, speed: 0.0, acceleration: -a },
            Phase { duration: half, speed: -a * half, acceleration: a },
        ];
        Profile { phases, length, rate: 1.0, tail: 0.0, overruns: true }
    }

    /// The same profile stretched or squeezed to take `seconds`.
    pub fn lasting(mut self, seconds: f64) -> Profile {
        let natural: f64 = self.phases.iter().map(|phase| phase.duration).sum();
        if natural > 0.0 {
            self.rate = natural / seconds;
        }
        self
    }

    /// Highest speed on the way, length/s.
    pub fn top_speed(&self) -> f64 {
        let ends = self
            .phases
            .iter()
            .map(|phase| phase.speed.max(phase.speed + phase.acceleration * phase.duration));
        ends.fold(0.0, f64::max) * self.rate
    }

    /// Time from start to end, s.
    pub fn duration(&self) -> f64 {
        self.phases.iter().map(|phase| phase.duration).sum::<f64>() / self.rate
    }

    /// Time at which the successor may start: the end, or the begin of the blend, s.
    pub fn release(&self) -> f64 {
        (self.duration() - self.tail / self.rate).max(0.0)
    }

    /// Fraction of the path that is behind at `time` (s), 0 to 1; more where the arm overruns its end.
    pub fn fraction(&self, time: f64) -> f64 {
        if self.length <= 0.0 || time >= self.duration() {
            return 1.0;
        }
        let mut left = (time * self.rate).max(0.0);
        let mut position = 0.0;
        for phase in &self.phases {
            let t = left.min(phase.duration);
            position += phase.speed * t + phase.acceleration * t * t / 2.0;
            left -= t;
            if left <= 0.0 {
                break;
            }
        }
        let fraction = position / self.length;
        if self.overruns { fraction } else { fraction.min(1.0) }
    }
}

/// Speed at the end of the timed start: what `acceleration` gives in `lead`, unless the way left would then
/// be too short to brake to `out`.
fn start_speed(lead: f64, speed: f64, a: f64, distance: f64, out: f64) -> f64 {
    if lead <= 0.0 {
        return 0.0;
    }
    let wanted = speed.min(a * lead);
    let needed = wanted * lead / 2.0 + (wanted * wanted - out * out).max(0.0) / (2.0 * a);
    if needed <= distance {
        return wanted;
    }
    // v lead / 2 + (v^2 - out^2) / (2 a) = distance, the positive root; and never past the distance.
    let half = a * lead / 2.0;
    let root = -half + (half * half + 2.0 * a * distance + out * out).sqrt();
    wanted.min(root).min(2.0 * distance / lead).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn shape(length: f64, acceleration: f64, speed: f64) -> Shape {
        Shape { length, speed, acceleration, blend: 0.0, lead: 0.0, keeps: false, entry: 0.0 }
    }

    #[test]
    fn published_times_of_trapezoids() {
        for (length, a, v, seconds) in [
            (0.5, 1.2, 0.25, 2.21),
            (0.1, 1.2, 0.25, 0.61),
            (0.5, 3.0, 1.0, 0.83),
            (std::f64::consts::FRAC_PI_2, 1.4, 1.05, 2.25),
            (std::f64::consts::FRAC_PI_2, 8.0, 3.0, 0.90),
        ] {
            let duration = Profile::new(&shape(length, a, v)).duration();
            assert!((duration / seconds - 1.0).abs() < 0.02, "{duration} instead of {seconds}");
        }
    }

    #[test]
    fn a_duration_can_be_requested() {
        let profile = Profile::new(&shape(1.0, 1.0, 1.0)).lasting(5.0);
        assert!((profile.duration() - 5.0).abs() < 1e-12);
        assert!((profile.fraction(2.5) - 0.5).abs() < 1e-12);
    }

    #[test]
    fn a_path_taken_over_in_motion_starts_at_its_speed() {
        for (entry, speed, length) in
            [(0.25, 0.25, 0.5), (0.5, 0.25, 0.5), (0.1, 0.25, 0.5), (0.5, 0.5, 0.01)]
        {
            let profile = Profile::new(&Shape { entry, ..shape(length, 1.2, speed) });
            let first = profile.fraction(1e-6) * length / 1e-6;
            assert!((first - entry).abs() < 1e-3, "{first} instead of {entry}");
            let end = profile.duration();
            let last = (1.0 - profile.fraction(end - 1e-5)) * length / 1e-5;
            assert!(last < 1e-3, "{last} m/s at the end");
        }
    }

    /// 0.25 m/s need 26 mm to brake at 1.2 m/s2.
    #[test]
    fn a_path_that_is_too_short_to_brake_on_is_overrun() {
        let shape = Shape { entry: 0.25, keeps: true, ..shape(0.015, 1.2, 0.25) };
        let profile = Profile::new(&shape);
        let at = |time: f64| profile.fraction(time) * 0.015;
        let (step, end) = (1e-3, profile.duration());
        let times = (1..(end / step) as usize).map(|k| k as f64 * step);
        let beyond = times.clone().map(at).fold(0.0, f64::max) - 0.015;
        assert!((beyond - (0.25 * 0.25 / 2.4 - 0.015)).abs() < 1e-6, "{beyond} m beyond the end");
        for time in times.skip(1) {
            let change = (at(time + step) - 2.0 * at(time) + at(time - step)) / (step * step);
            assert!(change.abs() < 1.2 * 1.01, "{change} m/s2 at {time} s");
        }
        assert_eq!(profile.fraction(end), 1.0);
        let enough = Profile::new(&Shape { length: 0.027, ..shape });
        assert!((0..1000).all(|k| enough.fraction(f64::from(k) * step) <= 1.0));
    }

    #[test]
    fn a_straight_continuation_keeps_its_speed() {
        let first = Profile::new(&Shape { blend: 0.1, ..shape(1.0, 2.0, 0.5) });
        let lead = first.duration() - first.release();
        let second = Profile::new(&Shape { lead, ..shape(1.0, 2.0, 0.5) });
        let at = |t: f64| first.fraction(first.release() + t) + second.fraction(t);
        for k in 0..20 {
            let t = lead * f64::from(k) / 20.0;
            let speed = (at(t + 1e-6) - at(t)) / 1e-6;
            assert!((speed - 0.5).abs() < 1e-3, "{speed} at {t}");
        }
    }

    proptest! {
        #[test]
        fn limits_hold(length in 1e-4..3.0f64, speed in 0.01..3.0f64, acceleration in 0.1..20.0f64,
                       blend in 0.0..0.5f64, lead in 0.0..1.0f64) {
            let shape = Shape { length, speed, acceleration, blend, lead, keeps: false, entry: 0.0 };
            let profile = Profile::new(&shape);
            let steps = 400;
            let dt = profile.duration() / f64::from(steps);
            let mut last = 0.0;
            let mut last_speed = None;
            for k in 1..=steps {
                let position = profile.fraction(f64::from(k) * dt) * length;
                let moved = (position - last) / dt;
                prop_assert!(moved >= -1e-9 && moved <= speed * (1.0 + 1e-6), "speed {moved} at {k}");
                if let Some(before) = last_speed {
                    let change: f64 = (moved - before) / dt;
                    prop_assert!(change.abs() <= acceleration * (1.0 + 1e-3) + 1e-6, "acceleration {change} \
                        at {k}");
                }
                (last, last_speed) = (position, Some(moved));
            }
            prop_assert!((last - length).abs() < 1e-9);
            prop_assert!((profile.fraction(profile.duration() - 1e-9) - 1.0).abs() < 1e-6, "jump at the end");
            let first = profile.fraction(dt) * length / dt;
            prop_assert!(first <= acceleration * dt + 1e-6, "jump at the start: {first}");
        }
    }
}
