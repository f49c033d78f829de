//! The meter every search runs on: deterministic steps, a limit on them, and the caller's wish to stop.
//!
//! In: a work limit and a stop function (the caller's clock, Ctrl-C). Out: whether to go on. A step is one
//! sampled pose or one node of a graph search. The limit gives the same result on every run; the stop
//! function is called once in `ASK_EVERY` steps and promises nothing of the kind.

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

    /// A meter for a part of the search that may take `most` steps; pass what it took to [`Effort::spend`].
    pub fn part(&self, most: u64) -> Effort<'a> {
        Effort::new(Some(most.min(self.left())), self.stop)
    }

    /// Counts the steps of a part.
    pub fn spend(&mut self, part: &Effort) {
        self.done += part.done.min(part.limit);
        // A part that ended within its limit was stopped from outside.
        self.stopped |= part.stopped && part.done <= part.limit;
    }

    /// A meter for the rest of the search in another one, of whose steps `steps` count as one of these; pass
    /// what it took to [`Effort::spend_cheap`].
    pub fn cheap_part(&self, steps: u64) -> Effort<'a> {
        Effort::new(Some(self.left().saturating_mul(steps)), self.stop)
    }

    /// Counts the steps of a part of cheap steps.
    pub fn spend_cheap(&mut self, part: &Effort, steps: u64) {
        self.done += part.done.min(part.limit).div_ceil(steps);
        self.stopped |= part.stopped && part.done <= part.limit;
    }

    /// Steps that may still be made.
    pub fn left(&self) -> u64 {
        self.limit.saturating_sub(self.done)
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
    fn parts_share_the_limit_and_pass_a_stop_on() {
        let mut effort = Effort::new(Some(100), &|| false);
        let mut part = effort.part(70);
        assert_eq!((0..200).filter(|_| part.step()).count(), 70);
        effort.spend(&part);
        assert!(!effort.is_over());
        assert_eq!(effort.left(), 30);
        let mut rest = effort.part(70);
        assert_eq!((0..200).filter(|_| rest.step()).count(), 30);
        let mut stopped = Effort::new(None, &|| true);
        let mut part = stopped.part(5);
        assert!(!part.step());
        stopped.spend(&part);
        assert!(stopped.is_over());
    }

    #[test]
    fn cheap_steps_count_a_part_of_one() {
        let mut effort = Effort::new(Some(100), &|| false);
        let mut part = effort.cheap_part(12);
        assert_eq!((0..500).filter(|_| part.step()).count(), 500);
        effort.spend_cheap(&part, 12);
        assert!(!effort.is_over());
        assert_eq!(effort.left(), 100 - 42);
        let mut rest = effort.cheap_part(12);
        assert_eq!((0..5000).filter(|_| rest.step()).count(), 58 * 12);
        effort.spend_cheap(&rest, 12);
        assert_eq!((effort.left(), effort.is_over()), (0, false));
        assert!(!effort.step());
    }

    #[test]
    fn the_stop_function_is_requested() {
        let mut effort = Effort::new(None, &|| true);
        assert!(!effort.step());
    }
}
