//! The thread that keeps the simulated cell's time: pace, priority, and whom time waits for.
//!
//! In: the [`Core`], a time factor, a stop signal. Out: one [`Core::advance`] per frame, and [`Progress`]. A
//! frame is 2 ms of simulated time and is due every 2 ms / factor of wall time. Frames that come late push
//! the later ones back instead of being made up for in a burst: clients would see time jump. Simulated time
//! is held, within bounds, for a daemon that follows it over the clock channel ([`Holding`]), and with a
//! factor above 1 for a client that reads too slowly. No other client is waited for.

use crate::core::Core;
use crate::motion::FRAME_SECONDS;
use cell_edge::clock_channel::ClockServer;
use cell_edge::priority;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};
use tokio::sync::watch;

/// Longest that simulated time is held for a client that does not read, wall time.
const LONGEST_HOLD: Duration = Duration::from_millis(250);

/// How often a held frame looks whether it may go on.
const HOLD_POLL: Duration = Duration::from_micros(200);

/// Lateness that is still made up for: below the wake-up jitter of the system time would run slow, above it
/// frames are pushed back. At factor 20 this is a burst of five frames at most.
const TOLERATED_LATENESS: Duration = Duration::from_micros(500);

/// The same while no client watches the robot, to whom time would jump.
const UNWATCHED_LATENESS: Duration = Duration::from_millis(100);

/// Frames in a row after none of which there was time to sleep, at which real-time priority is given up.
const MOST_SLEEPLESS: u32 = 50;

/// When the next frame is due.
struct Schedule {
    period: Duration,
    due: Instant,
    /// When the frame that is being made was due before it was pushed back.
    intended: Instant,
}

impl Schedule {
    fn new(factor: f64, now: Instant) -> Schedule {
        let period = Duration::from_secs_f64(FRAME_SECONDS / factor);
        Schedule { period, due: now + period, intended: now }
    }

    /// Time to sleep until the frame that is due at `now`; a frame that is late by more than `tolerated`
    /// moves all later ones.
    fn wait(&mut self, now: Instant, tolerated: Duration) -> Duration {
        let wait = self.due.saturating_duration_since(now);
        self.intended = self.due;
        if now > self.due + tolerated.max(self.period) {
            self.due = now;
        }
        self.due += self.period;
        wait
    }
}

/// What the frame thread reports to the rest of the process.
#[derive(Debug)]
pub struct Progress {
    start: Instant,
    simulated_us: AtomicU64,
    wall_us: AtomicU64,
    /// For how long simulated time was held, us of wall time.
    held_us: AtomicU64,
}

impl Default for Progress {
    /// Nothing was simulated yet.
    fn default() -> Progress {
        let nothing = || AtomicU64::new(0);
        Progress { start: Instant::now(), simulated_us: nothing(), wall_us: nothing(), held_us: nothing() }
    }
}

impl Progress {
    /// Seconds of wall time for which simulated time was held for others.
    pub fn seconds_held(&self) -> f64 {
        self.held_us.load(Ordering::Relaxed) as f64 * 1e-6
    }

    /// Simulated seconds per second of wall time so far; 1 before the first.
    pub fn factor(&self) -> f64 {
        let wall = self.wall_us.load(Ordering::Relaxed);
        let simulated = self.simulated_us.load(Ordering::Relaxed);
        if wall == 0 { 1.0 } else { simulated as f64 / wall as f64 }
    }

    fn reached(&self, simulated: Duration) {
        self.simulated_us.store(simulated.as_micros() as u64, Ordering::Relaxed);
        self.wall_us.store(self.start.elapsed().as_micros() as u64, Ordering::Relaxed);
    }
}

/// For whom simulated time is held.
#[derive(Debug)]
pub struct Holding {
    /// Daemons that follow the simulator's time: while one is late, or the simulator's own tasks are late
    /// with what it sends and is sent.
    pub clock: Option<ClockServer>,
    /// Clients that read too slowly to get every frame.
    pub slow_readers: bool,
}

impl Holding {
    /// A frame has ended: followers get its time.
    fn reached(&mut self, core: &Core, simulated: Duration) {
        if let Some(clock) = &mut self.clock {
            clock.reached(simulated, Instant::now());
            core.robot.lateness.frame(clock.is_followed());
        }
    }

    /// Holds the time for as long as it has to be.
    fn hold(&mut self, core: &Core, progress: &Progress, stopped: &watch::Receiver<bool>) {
        let start = Instant::now();
        let mut now = start;
        while self.holds(core, start, now) && !*stopped.borrow() {
            std::thread::sleep(HOLD_POLL);
            let before = std::mem::replace(&mut now, Instant::now());
            progress.held_us.fetch_add((now - before).as_micros() as u64, Ordering::Relaxed);
        }
    }

    /// Each wait is bounded, so that a dead client does not stop the time.
    fn holds(&mut self, core: &Core, start: Instant, now: Instant) -> bool {
        if let Some(clock) = &mut self.clock
            && clock.is_followed()
            && (clock.holds(now) || core.robot.lateness.holds(now))
        {
            return true;
        }
        if !self.slow_readers || !core.robot.publisher().a_client_is_behind() {
            return false;
        }
        let patient = now - start < LONGEST_HOLD;
        if !patient {
            core.robot.publisher().give_up();
        }
        patient
    }
}

/// Advances the core, frame by frame and `factor` times as fast as the wall's clock, until the signal.
pub fn run(
    core: &Core,
    progress: &Progress,
    factor: f64,
    mut holding: Holding,
    stopped: &watch::Receiver<bool>,
) {
    // Clients measure silence on their own clocks; drawing pictures and planning can wait. Faster than real
    // time this thread may fill a core, which would then be lost to the clients it is meant for.
    if factor > 1.0 {
        priority::raise()
    } else {
        priority::real_time()
    }
    // The default slack of 50 us is half a frame at factor 20. Without it the pace is merely less even.
    let _ = rustix::thread::set_current_timer_slack(std::num::NonZeroU64::new(1000));
    let mut schedule = Schedule::new(factor, Instant::now());
    let (mut frames, mut sleepless): (u64, u32) = (0, 0);
    while !*stopped.borrow() && stopped.has_changed().is_ok() {
        holding.hold(core, progress, stopped);
        core.advance(Some(schedule.intended));
        frames += 1;
        let simulated = Duration::from_secs_f64(frames as f64 * FRAME_SECONDS);
        progress.reached(simulated);
        holding.reached(core, simulated);
        let alone = factor > 1.0 && !core.robot.publisher().has_clients();
        let tolerated = if alone { UNWATCHED_LATENESS } else { TOLERATED_LATENESS };
        let wait = schedule.wait(Instant::now(), tolerated);
        sleepless = if wait.is_zero() { sleepless + 1 } else { 0 };
        if sleepless == MOST_SLEEPLESS && factor <= 1.0 {
            // Frames that take longer than they last would leave nothing to ordinary threads.
            tracing::warn!("this computer is too slow for real time: the simulation gives up its priority");
            priority::ordinary();
            priority::raise();
        }
        if !wait.is_zero() {
            std::thread::sleep(wait);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_pushed_back_and_never_made_up_for_in_a_burst() {
        let start = Instant::now();
        let ms = Duration::from_millis;
        let mut schedule = Schedule::new(1.0, start);
        let mut wait = |at: u64| schedule.wait(start + ms(at), TOLERATED_LATENESS);
        assert_eq!(wait(0), ms(2));
        assert_eq!(wait(3), ms(1));
        assert_eq!(wait(7), Duration::ZERO, "1 ms late");
        assert_eq!(wait(7), ms(1), "little lateness is made up for");
        assert_eq!(wait(500), Duration::ZERO);
        assert_eq!(wait(500), ms(2), "much is not");
        assert_eq!(schedule.wait(start + ms(550), UNWATCHED_LATENESS), Duration::ZERO);
        assert_eq!(schedule.wait(start + ms(550), UNWATCHED_LATENESS), Duration::ZERO, "unwatched, it is");
    }
}
