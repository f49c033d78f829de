//! The meters every search runs on: deterministic steps, a limit on them, and the caller's wish to stop.
//!
//! In: a work limit and a stop function (the caller's clock, Ctrl-C). Out: whether to go on. A step is one
//! sampled pose or one node of a graph search. The limit on steps gives the same result on every run. The
//! stop function promises nothing of the kind: it is called by the amount of work since the last time, in
//! ticks, so that a table of a thousand objects is stopped as promptly as one of ten.

/// Ticks between two questions to the stop function: less than a millisecond of work, and far more than the
/// question costs.
const ASK_EVERY: u64 = 16_384;

/// Ticks of a step of which nothing else is known.
const TICKS_OF_A_STEP: u64 = 128;

/// A function that says when the caller wants no more: true ends the search.
pub type StopFunction<'a> = &'a (dyn Fn() -> bool + Sync);

/// Calls the caller's stop function once in a while. A tick is about what a test of two simple shapes costs.
pub struct Watch<'a> {
    stop: StopFunction<'a>,
    /// Ticks until the next question.
    left: u64,
    /// Ticks of work that are still done once the caller wants no more.
    grace: u64,
    stopped: bool,
}

impl<'a> Watch<'a> {
    /// A watch that calls the stop function at its first tick.
    pub fn new(stop: StopFunction<'a>) -> Watch<'a> {
        Watch { stop, left: 0, grace: 0, stopped: false }
    }

    /// A watch that lets work of so many ticks be finished after the caller wants no more.
    pub fn with_grace(stop: StopFunction<'a>, grace: u64) -> Watch<'a> {
        Watch { grace, ..Watch::new(stop) }
    }

    /// Counts work; false once the caller wants no more, and from then on.
    pub fn go_on(&mut self, ticks: u64) -> bool {
        if self.stopped {
            return false;
        }
        match self.left.checked_sub(ticks) {
            Some(left) => self.left = left,
            None => {
                self.left = ASK_EVERY;
                if (self.stop)() {
                    self.stopped = self.grace < ticks;
                    self.grace = self.grace.saturating_sub(ticks.max(ASK_EVERY));
                }
            }
        }
        !self.stopped
    }

    /// The caller wants no more.
    pub fn is_stopped(&self) -> bool {
        self.stopped
    }
}

/// Counts steps and says when a search has to end.
pub struct Effort<'a> {
    done: u64,
    limit: u64,
    ticks: u64,
    spent: bool,
    watch: Watch<'a>,
}

impl<'a> Effort<'a> {
    /// A meter at zero; no `limit` means that only `stop` ends the search.
    pub fn new(limit: Option<u64>, stop: StopFunction<'a>) -> Effort<'a> {
        let (limit, watch) = (limit.unwrap_or(u64::MAX), Watch::new(stop));
        Effort { done: 0, limit, ticks: TICKS_OF_A_STEP, spent: false, watch }
    }

    /// The same with the work that a step takes, in ticks.
    pub fn with_ticks(self, ticks: u64) -> Effort<'a> {
        Effort { ticks, ..self }
    }

    /// Counts one step; false once the search has to end, and from then on.
    pub fn step(&mut self) -> bool {
        if self.is_over() {
            return false;
        }
        self.done += 1;
        self.spent = self.done > self.limit;
        !self.spent && self.watch.go_on(self.ticks)
    }

    /// For work that is no step: calls the stop function as often as it takes.
    pub fn watch(&mut self) -> &mut Watch<'a> {
        &mut self.watch
    }

    /// A meter for a part of the search that may take `most` steps; pass what it took to [`Effort::spend`].
    pub fn part(&self, most: u64) -> Effort<'a> {
        Effort::new(Some(most.min(self.left())), self.watch.stop).with_ticks(self.ticks)
    }

    /// Counts the steps of a part.
    pub fn spend(&mut self, part: &Effort) {
        self.done += part.done.min(part.limit);
        self.watch.stopped |= part.watch.stopped;
    }

    /// A meter for the rest of the search in another one, of whose steps `steps` count as one of these; pass
    /// what it took to [`Effort::spend_cheap`].
    pub fn cheap_part(&self, steps: u64) -> Effort<'a> {
        Effort::new(Some(self.left().saturating_mul(steps)), self.watch.stop).with_ticks(self.ticks)
    }

    /// Counts the steps of a part of cheap steps.
    pub fn spend_cheap(&mut self, part: &Effort, steps: u64) {
        self.done += part.done.min(part.limit).div_ceil(steps);
        self.watch.stopped |= part.watch.stopped;
    }

    /// Steps that may still be made.
    pub fn left(&self) -> u64 {
        self.limit.saturating_sub(self.done)
    }

    /// The search has to end.
    pub fn is_over(&self) -> bool {
        self.spent || self.watch.stopped
    }

    /// Steps counted so far.
    pub fn done(&self) -> u64 {
        self.done
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicU64, Ordering};

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

    #[test]
    fn the_stop_function_is_asked_by_the_work_and_not_by_the_steps() {
        let asked = AtomicU64::new(0);
        let stop = || {
            asked.fetch_add(1, Ordering::Relaxed);
            false
        };
        let mut light = Effort::new(None, &stop).with_ticks(1);
        (0..1000).for_each(|_| assert!(light.step()));
        assert_eq!(asked.swap(0, Ordering::Relaxed), 1, "at the first step alone");
        let mut heavy = Effort::new(None, &stop).with_ticks(ASK_EVERY + 1);
        (0..1000).for_each(|_| assert!(heavy.step()));
        assert_eq!(asked.swap(0, Ordering::Relaxed), 1000);
        assert!(light.watch().go_on(ASK_EVERY + 1) && light.done() == 1000);
        assert_eq!(asked.load(Ordering::Relaxed), 1, "for work between two steps");
    }

    #[test]
    fn a_watch_that_was_stopped_ends_the_effort() {
        let mut effort = Effort::new(None, &|| true);
        assert!(!effort.watch().go_on(1) && effort.is_over() && !effort.step());
        assert_eq!(effort.done(), 0);
    }
}
