//! How late packages leave the simulator: the time from when their frame was due to when they were handed to
//! the system.
//!
//! In: one delay per package, from many threads. Out: a count, the share within a bound, quantiles. Counters
//! only, so that measuring does not disturb.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// Width of a bucket, and their number; later ones fall into the last.
const BUCKET_US: u64 = 10;
const BUCKETS: usize = 2001;

/// Delays by bucket.
pub struct LatencyHistogram {
    buckets: Box<[AtomicU64]>,
    worst_us: AtomicU64,
}

impl std::fmt::Debug for LatencyHistogram {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("LatencyHistogram")
    }
}

impl Default for LatencyHistogram {
    fn default() -> LatencyHistogram {
        let buckets = (0..BUCKETS).map(|_| AtomicU64::new(0)).collect();
        LatencyHistogram { buckets, worst_us: AtomicU64::new(0) }
    }
}

/// What was measured.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Delays {
    /// Packages.
    pub count: u64,
    /// Share of them within 1 ms.
    pub within_1_ms: f64,
    /// Median, us, to a bucket of 10.
    pub median_us: u64,
    /// Of a thousand, the 999th, us.
    pub p999_us: u64,
    /// Latest, us.
    pub worst_us: u64,
}

impl LatencyHistogram {
    /// Takes in one delay.
    pub fn record(&self, delay: Duration) {
        let us = u64::try_from(delay.as_micros()).unwrap_or(u64::MAX);
        let bucket = usize::try_from(us / BUCKET_US).unwrap_or(BUCKETS).min(BUCKETS - 1);
        self.buckets[bucket].fetch_add(1, Ordering::Relaxed);
        self.worst_us.fetch_max(us, Ordering::Relaxed);
    }

    /// Forgets everything.
    pub fn clear(&self) {
        self.buckets.iter().for_each(|bucket| bucket.store(0, Ordering::Relaxed));
        self.worst_us.store(0, Ordering::Relaxed);
    }

    /// What was measured so far.
    pub fn delays(&self) -> Delays {
        let counts: Vec<u64> = self.buckets.iter().map(|bucket| bucket.load(Ordering::Relaxed)).collect();
        let count: u64 = counts.iter().sum();
        if count == 0 {
            return Delays::default();
        }
        let within: u64 = counts.iter().take((1000 / BUCKET_US) as usize).sum();
        let quantile = |share: f64| {
            let wanted = (share * count as f64).ceil() as u64;
            let mut seen = 0;
            let reached = counts.iter().position(|bucket| {
                seen += bucket;
                seen >= wanted
            });
            (reached.unwrap_or(BUCKETS) as u64 + 1) * BUCKET_US
        };
        Delays {
            count,
            within_1_ms: within as f64 / count as f64,
            median_us: quantile(0.5),
            p999_us: quantile(0.999),
            worst_us: self.worst_us.load(Ordering::Relaxed),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_and_quantiles_count_every_delay() {
        let latency = LatencyHistogram::default();
        assert_eq!(latency.delays(), Delays::default());
        (0..998).for_each(|_| latency.record(Duration::from_micros(55)));
        latency.record(Duration::from_micros(1000));
        latency.record(Duration::from_secs(5));
        let delays = latency.delays();
        assert_eq!((delays.count, delays.median_us, delays.p999_us), (1000, 60, 1010));
        assert_eq!((delays.within_1_ms, delays.worst_us), (0.998, 5_000_000));
        latency.clear();
        assert_eq!(latency.delays().count, 0);
    }
}
