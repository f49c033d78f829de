//! How evenly the loop turns: the time from one turn to the next, for the metrics.
//!
//! In: each turn, on the loop's own thread, without a lock. Out: quantiles over the last turns. The arm's
//! states arrive in even steps; what holds the loop up shows as a step that is longer.

use std::sync::atomic::{AtomicU32, AtomicUsize, Ordering};
use std::time::Instant;

/// Turns that are kept: a minute or less of a controller with 500 states a second.
const KEPT: usize = 16_384;

/// See the module.
#[derive(Debug)]
pub struct Turns {
    /// Microseconds; 0: none yet.
    steps: Vec<AtomicU32>,
    next: AtomicUsize,
}

impl Default for Turns {
    fn default() -> Turns {
        Turns { steps: (0..KEPT).map(|_| AtomicU32::new(0)).collect(), next: AtomicUsize::new(0) }
    }
}

impl Turns {
    /// The loop has come round; `before` is when it last did.
    pub fn turned(&self, before: Instant, now: Instant) {
        let us = u32::try_from(now.saturating_duration_since(before).as_micros()).unwrap_or(u32::MAX);
        let next = self.next.fetch_add(1, Ordering::Relaxed);
        if let Some(step) = self.steps.get(next % KEPT) {
            step.store(us.max(1), Ordering::Relaxed);
        }
    }

    #[cfg(test)]
    fn count(&self) -> usize {
        self.steps.iter().filter(|step| step.load(Ordering::Relaxed) > 0).count()
    }

    /// These shares of the last turns took no longer, s; `None` before there are any.
    pub fn quantiles<const N: usize>(&self, shares: [f64; N]) -> Option<[f64; N]> {
        let mut steps: Vec<u32> =
            self.steps.iter().map(|step| step.load(Ordering::Relaxed)).filter(|us| *us > 0).collect();
        steps.sort_unstable();
        let last = steps.len().checked_sub(1)?;
        let at = |share: f64| steps.get((share * last as f64).round() as usize).copied();
        Some(shares.map(|share| at(share).map_or(0.0, |us| f64::from(us) * 1e-6)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn one_turn_in_fifty_that_is_late_is_seen_at_the_99th_percentile() {
        let (turns, start) = (Turns::default(), Instant::now());
        assert_eq!(turns.quantiles([0.5]), None);
        for turn in 0..KEPT + 100 {
            let ms = if turn % 50 == 0 { 9 } else { 2 };
            turns.turned(start, start + Duration::from_millis(ms));
        }
        assert_eq!(turns.count(), KEPT, "the oldest make room");
        let [median, late] = turns.quantiles([0.5, 0.99]).expect("turns");
        assert!((median - 2e-3).abs() < 1e-9 && (late - 9e-3).abs() < 1e-9, "{median} {late}");
    }
}
