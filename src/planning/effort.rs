//! The meter every search runs on: deterministic steps, a limit on them, and the caller's wish to stop.
//!
//! In: a work limit and a stop function (the caller's clock, Ctrl-C). Out: whether to go on. A step is one
//! sampled pose or one node of a graph search. The limit gives the same result on every run; the stop function
//! is asked once in [`ASK_EVERY`] steps and promises nothing of the kind.

/// Steps between two questions to the stop function: a step costs about a microsecond, the question more.
const ASK_EVERY: u64 = 128;

/// Counts steps and says when a search has to end.
pub struct Effort<'a> {
    done: u64,
    limit: u64,
    next_question: u64,
    stop: &'a (dyn Fn() -> bool + Sync),
    stopped: bool,
}

impl<'a> Effort<'a> {
    /// A meter at zero; no `limit` means that only `stop` ends the search.
    pub fn new(limit: Option<u64>, stop: &'a (dyn Fn() -> bool + Sync)) -> Effort<'a> {
        Effort { done: 0, limit: limit.unwrap_or(u64::MAX), next_question: 0, stop, stopped: false }
    }

    /// Counts one step; false once the search has to end, and from then on.
    pub fn step(&mut self) -> bool {
        if self.stopped {
            return false;
        }
        self.done += 1;
        if self.done > self.limit {
            self.stopped = true;
        } else if self.done >= self.next_question {
            self.next_question = self.done + ASK_EVERY;
            self.stopped = (self.stop)();
        }
        !self.stopped
    }

    /// The search has to end.
    pub fn is_over(&self) -> bool {
        self.stopped
    }

    /// Steps counted so far.
    pub fn done(&self) -> u64 {
        self.done
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_limit_is_exact_and_final() {
        let mut effort = Effort::new(Some(1000), &|| false);
        assert_eq!((0..5000).filter(|_| effort.step()).count(), 1000);
        assert!(effort.is_over() && !effort.step());
    }

    #[test]
    fn the_stop_function_is_asked() {
        let mut effort = Effort::new(None, &|| true);
        assert!(!effort.step());
    }
}
