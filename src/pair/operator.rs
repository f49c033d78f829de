//! A person who approves plans: by the number that was shown, some time after it was.
//!
//! In: which plan waits, a seed. Out: orders. The person reads a plan for a while and approves that one,
//! also where another has taken its place meanwhile; the answer is then a refusal, and the new one is read.

use cell_machine::orders::Order;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use ur_sim::motion::FRAME_SECONDS;

/// Seconds for which a plan is read, from and to.
const READ_S: (f64, f64) = (0.1, 4.0);

/// The person. See the module.
pub struct Operator {
    rng: ChaCha8Rng,
    /// The plan that is read, and until when.
    reads: Option<(u64, u64)>,
}

impl Operator {
    /// A person who takes as long as this seed says.
    pub fn new(seed: u64) -> Operator {
        Operator { rng: ChaCha8Rng::seed_from_u64(seed ^ 0x6f70_6572), reads: None }
    }

    /// One controller frame in which this plan of this job waits; what the person orders.
    pub fn sees(&mut self, frame: u64, job: &str, plan: u64) -> Option<Order> {
        let Some((read, until)) = self.reads else {
            let seconds = self.rng.random_range(READ_S.0..READ_S.1);
            self.reads = Some((plan, frame + (seconds / FRAME_SECONDS) as u64));
            return None;
        };
        if frame < until {
            return None;
        }
        self.reads = None;
        Some(Order::Approve { id: job.to_string(), plan: read })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_plan_that_was_read_is_approved_although_another_has_come() {
        let mut operator = Operator::new(1);
        assert_eq!(operator.sees(0, "job-1", 3), None);
        let order = (1..3000).find_map(|frame| operator.sees(frame, "job-1", 4));
        assert_eq!(order, Some(Order::Approve { id: "job-1".to_string(), plan: 3 }));
        let order = (3000..6000).find_map(|frame| operator.sees(frame, "job-1", 4));
        assert_eq!(order, Some(Order::Approve { id: "job-1".to_string(), plan: 4 }));
    }
}
