//! One channel of the vacuum gripper: pump, vents and the relative vacuum they leave.
//!
//! In: the mode written to the gripper, whether the cups of the channel are sealed, time steps. Out:
//! relative vacuum (0 = ambient, 0.6 = 60 %). A first-order model: the pump pulls towards what it can reach
//! with `tau` = 0.12 s; unsealed cups leave 12 %; open vents release with 0.05 s; idle keeps what is there,
//! and a sealed cup leaks with 40 s. Source of the figures: the device's data sheet times (0.35 s to grip,
//! 0.2 s to release) and field reports; not measured by us. The current limit slows the pump down in
//! proportion below the device's default of 500 mA, and at 0 it does not run: our assumption, nothing is
//! published. A pump may overshoot: it pulls that much beyond its target once and lets it fall back (seen by
//! others on a VGC10; how much and how fast is not published).

/// Time constant of the pump on sealed cups, s.
const PUMP_TAU_S: f64 = 0.12;
/// Current limit at which the pump has its full speed, mA: the device's default.
pub const FULL_SPEED_MA: u16 = 500;
/// Time constant with which an overshoot falls back to the target, s.
const FALLS_BACK_TAU_S: f64 = 0.5;
/// Share of its goal at which a pump turns: a first-order model never quite gets there.
const AT_PEAK: f64 = 0.98;
/// Time constant of open vents and of air through an unsealed cup, s.
const VENT_TAU_S: f64 = 0.05;
/// Time constant of a sealed cup with the pump off, s.
const SEAL_TAU_S: f64 = 40.0;
/// What the pump reaches when the cups suck air.
pub const UNSEALED_VACUUM: f64 = 0.12;
/// Highest target the device takes.
pub const HIGHEST_TARGET: f64 = 0.8;

/// A channel of the gripper.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Channel {
    /// Holding register 0, status 258.
    A,
    /// Holding register 1, status 259.
    B,
}

impl Channel {
    /// Both channels, in register order.
    pub const ALL: [Channel; 2] = [Channel::A, Channel::B];

    /// 0 for A, 1 for B.
    pub fn index(self) -> usize {
        match self {
            Channel::A => 0,
            Channel::B => 1,
        }
    }
}

/// What the pump and the vents of a channel do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VacuumMode {
    /// Vents open, pump off.
    Release,
    /// Vents shut, pump keeps the target.
    Grip,
    /// Vents shut, pump off.
    Idle,
}

/// What is wrong with a channel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ChannelFaults {
    /// Air enters freely.
    pub open: bool,
    /// The pump no longer reaches what it did.
    pub leak: Option<Leak>,
}

/// A leak.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Leak {
    /// The most the pump reaches in the end, fraction.
    pub vacuum: f64,
    /// Time to fall to that, s.
    pub falls_s: f64,
}

impl Leak {
    /// The most the pump reaches after `age_s` seconds of leaking.
    pub fn ceiling(&self, age_s: f64) -> f64 {
        if age_s >= self.falls_s {
            return self.vacuum;
        }
        HIGHEST_TARGET + (self.vacuum - HIGHEST_TARGET) * age_s / self.falls_s
    }
}

/// State of one channel.
#[derive(Clone, Debug)]
pub struct Pump {
    mode: VacuumMode,
    target: f64,
    vacuum: f64,
    ceiling: f64,
    pump_tau_s: f64,
    /// How far it pulls beyond its target at first, share of the target.
    overshoot: f64,
    peaked: bool,
}

impl Pump {
    /// A channel at ambient pressure with open vents.
    pub fn new() -> Pump {
        let (mode, ceiling) = (VacuumMode::Release, HIGHEST_TARGET);
        let (pump_tau_s, overshoot) = (PUMP_TAU_S, 0.0);
        Pump { mode, target: 0.0, vacuum: 0.0, ceiling, pump_tau_s, overshoot, peaked: true }
    }

    /// A pump that first pulls beyond its target, by this share of it.
    pub fn overshooting(share: f64) -> Pump {
        Pump { overshoot: share, ..Pump::new() }
    }

    /// Limits the pump's current, mA.
    pub fn set_current_limit_ma(&mut self, limit: u16) {
        // Without current the time constant is infinite, which `step` takes as no change.
        self.pump_tau_s = PUMP_TAU_S * (f64::from(FULL_SPEED_MA) / f64::from(limit)).max(1.0);
    }

    /// Takes a new mode; the target (fraction) is clamped to what the device takes and ignored but for grip.
    pub fn command(&mut self, mode: VacuumMode, target: f64) {
        if mode == VacuumMode::Grip && self.mode != VacuumMode::Grip {
            self.peaked = self.overshoot == 0.0;
        }
        self.mode = mode;
        self.target = if target.is_finite() { target.clamp(0.0, HIGHEST_TARGET) } else { 0.0 };
    }

    /// The mode last commanded.
    pub fn mode(&self) -> VacuumMode {
        self.mode
    }

    /// The target last commanded, fraction.
    pub fn target(&self) -> f64 {
        self.target
    }

    /// Relative vacuum, fraction.
    pub fn vacuum(&self) -> f64 {
        self.vacuum
    }

    /// True when nothing would change: vents open and ambient pressure inside.
    pub fn at_rest(&self) -> bool {
        self.mode != VacuumMode::Grip && self.vacuum < 1e-6
    }

    /// Lets all air in at once (a fault).
    pub fn collapse(&mut self) {
        self.vacuum = 0.0;
    }

    /// The most that can be reached, fraction (a leak); absent: what the device can.
    pub fn set_ceiling(&mut self, ceiling: Option<f64>) {
        self.ceiling = ceiling.unwrap_or(HIGHEST_TARGET);
    }

    /// Advances by `dt_s`, exactly for the first-order model, so that the step size does not matter.
    pub fn step(&mut self, dt_s: f64, sealed: bool) {
        let (goal, tau) = match (self.mode, sealed) {
            (VacuumMode::Grip | VacuumMode::Idle, true) if self.vacuum > self.ceiling => {
                (self.ceiling, VENT_TAU_S)
            }
            (VacuumMode::Grip, true) if !self.peaked => (self.peak() / AT_PEAK, self.pump_tau_s),
            (VacuumMode::Grip, true) if self.vacuum > self.target => {
                (self.target.min(self.ceiling), FALLS_BACK_TAU_S)
            }
            (VacuumMode::Grip, true) => (self.target.min(self.ceiling), self.pump_tau_s),
            (VacuumMode::Grip, false) if self.vacuum > UNSEALED_VACUUM => {
                (UNSEALED_VACUUM.min(self.target).min(self.ceiling), VENT_TAU_S)
            }
            (VacuumMode::Grip, false) => {
                (UNSEALED_VACUUM.min(self.target).min(self.ceiling), self.pump_tau_s)
            }
            (VacuumMode::Release, _) | (VacuumMode::Idle, false) => (0.0, VENT_TAU_S),
            (VacuumMode::Idle, true) => (0.0, SEAL_TAU_S),
        };
        self.vacuum += (goal - self.vacuum) * -(-dt_s / tau).exp_m1();
        self.peaked |= self.vacuum >= self.peak();
    }

    fn peak(&self) -> f64 {
        (self.target * (1.0 + self.overshoot)).min(self.ceiling)
    }
}

impl Default for Pump {
    fn default() -> Pump {
        Pump::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(pump: &mut Pump, seconds: f64, sealed: bool) -> f64 {
        for _ in 0..(seconds / 0.002).round() as usize {
            pump.step(0.002, sealed);
        }
        pump.vacuum()
    }

    #[test]
    fn a_sealed_cup_follows_the_first_order_curve() {
        let mut pump = Pump::new();
        pump.command(VacuumMode::Grip, 0.6);
        assert!((run(&mut pump, 0.12, true) - 0.6 * (1.0 - (-1.0f64).exp())).abs() < 1e-9);
        assert!((run(&mut pump, 1.0, true) - 0.6).abs() < 1e-3);
        pump.command(VacuumMode::Idle, 0.0);
        assert!((run(&mut pump, 1.0, true) - 0.6 * (-1.0f64 / 40.0).exp()).abs() < 1e-3);
        pump.command(VacuumMode::Release, 0.0);
        assert!(run(&mut pump, 0.2, true) < 0.6 * 0.02);
    }

    #[test]
    fn an_overshoot_comes_once_and_falls_back_to_the_target() {
        let mut pump = Pump::overshooting(0.2);
        pump.command(VacuumMode::Grip, 0.6);
        let mut highest: f64 = 0.0;
        for _ in 0..500 {
            highest = highest.max(run(&mut pump, 0.01, true));
        }
        assert!((0.719..0.725).contains(&highest), "{highest}");
        assert!((pump.vacuum() - 0.6).abs() < 1e-3, "{}", pump.vacuum());
        assert!(run(&mut pump, 1.0, true) < 0.601, "no second one");
    }

    #[test]
    fn an_open_cup_reaches_twelve_per_cent_and_loses_more_quickly() {
        let mut pump = Pump::new();
        pump.command(VacuumMode::Grip, 0.6);
        assert!((run(&mut pump, 2.0, false) - 0.12).abs() < 1e-6);
        run(&mut pump, 2.0, true);
        assert!(run(&mut pump, 0.15, false) < 0.12 + 0.48 * 0.051);
        pump.command(VacuumMode::Grip, 9.0);
        assert_eq!(pump.target(), HIGHEST_TARGET);
        pump.command(VacuumMode::Grip, f64::NAN);
        assert_eq!(pump.target(), 0.0);
    }

    #[test]
    fn the_current_limit_slows_the_pump_and_stops_it_at_nothing() {
        let after = |limit: u16| {
            let mut pump = Pump::new();
            pump.set_current_limit_ma(limit);
            pump.command(VacuumMode::Grip, 0.6);
            run(&mut pump, 0.24, true)
        };
        let expected = |tau: f64| 0.6 * (1.0 - (-0.24 / tau).exp());
        assert!((after(500) - expected(0.12)).abs() < 1e-9 && (after(1000) - expected(0.12)).abs() < 1e-9);
        assert!((after(250) - expected(0.24)).abs() < 1e-9);
        assert_eq!(after(0), 0.0);
    }
}
