//! The two encoders of conveyors: counts that scripts set or that come from pulses on inputs, filtered.
//!
//! In: what scripts set up, counts, and the digital inputs and conveyor of each frame. Out: raw and filtered
//! counts within their range, and how far the filtered one has moved. Pure. The filter's time and four
//! counts for each period of a quadrature encoder are assumed. Inputs are looked at once a frame: faster
//! pulses than 250 Hz are missed, where the controller takes 40 kHz; those of the configured conveyor are
//! counted without that.

use crate::motion::FRAME_SECONDS;

/// How quickly the filtered count follows, 1/s; it lags behind no steady motion.
const FOLLOWS: f64 = 20.0;

/// Counts closer than this are the same.
const SETTLED: f64 = 1e-6;

/// Span of a counter that counts pulses.
const PULSE_SPAN: f64 = 65_536.0;

/// Ranges by their number: least count, and how many there are.
const RANGES: [(f64, f64); 5] = [
    (-2_147_483_648.0, 4_294_967_296.0),
    (0.0, 256.0),
    (0.0, 65_536.0),
    (0.0, 16_777_216.0),
    (0.0, 4_294_967_296.0),
];

/// How pulses count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Decoder {
    /// Two inputs, a quarter of a period apart: the direction counts.
    Quadrature,
    /// Both edges of one input.
    Edges,
    /// Rising edges.
    Rising,
    /// Falling edges.
    Falling,
}

/// The conveyor that is tracked.
#[derive(Clone, Copy, Debug)]
pub struct Conveyor {
    /// Which encoder.
    pub encoder: usize,
    /// m or rad.
    pub per_tick: f64,
    /// Share of the belt's motion that the arm follows: 0 while it is held.
    pub share: f64,
}

#[derive(Clone, Copy, Debug)]
enum Source {
    /// Not set up.
    None,
    /// Scripts set the count.
    Set,
    /// Pulses on inputs A and B, by bit.
    Pulses(Decoder, [u8; 2]),
}

/// An encoder.
#[derive(Clone, Debug)]
pub struct Encoder {
    source: Source,
    least: f64,
    span: f64,
    /// Levels of A and B when they were looked at last; absent: not yet.
    levels: Option<[bool; 2]>,
    /// The count without its range's ends.
    total: f64,
    filtered: f64,
    rate: f64,
    moved: f64,
    /// A count has been set since it was set up.
    begun: bool,
}

impl Default for Encoder {
    fn default() -> Encoder {
        let (least, span) = RANGES[0];
        Encoder {
            source: Source::None,
            least,
            span,
            levels: None,
            total: 0.0,
            filtered: 0.0,
            rate: 0.0,
            moved: 0.0,
            begun: false,
        }
    }
}

impl Encoder {
    /// Counts will be set, in a range by its number; false if there is no such range.
    pub fn expect_counts(&mut self, range: i32) -> bool {
        let Some((least, span)) = usize::try_from(range).ok().and_then(|range| RANGES.get(range)) else {
            return false;
        };
        *self = Encoder { source: Source::Set, least: *least, span: *span, ..Encoder::default() };
        true
    }

    /// Pulses will come on inputs A and B, by bit; absent: nothing counts any more.
    pub fn expect_pulses(&mut self, pulses: Option<(Decoder, [u8; 2])>) {
        let source = pulses.map_or(Source::None, |(decoder, pins)| Source::Pulses(decoder, pins));
        *self = Encoder { source, least: 0.0, span: PULSE_SPAN, ..Encoder::default() };
    }

    /// Sets the count; false if it is out of range.
    pub fn set(&mut self, count: f64) -> bool {
        if !(self.least..self.least + self.span).contains(&count) {
            return false;
        }
        if self.begun {
            self.total += self.shorter(count - self.wrapped(self.total));
        } else {
            (self.total, self.filtered, self.rate, self.begun) = (count, count, 0.0, true);
        }
        true
    }

    /// The shorter way between two counts; `None` if the range is not known.
    pub fn unwind(&self, delta: f64) -> Option<f64> {
        (!matches!(self.source, Source::None)).then(|| self.shorter(delta))
    }

    fn shorter(&self, delta: f64) -> f64 {
        let half = self.span / 2.0;
        if delta.abs() <= half { delta } else { (delta + half).rem_euclid(self.span) - half }
    }

    fn wrapped(&self, total: f64) -> f64 {
        (total - self.least).rem_euclid(self.span) + self.least
    }

    /// The filtered count within its range.
    pub fn count(&self) -> f64 {
        self.wrapped(self.filtered)
    }

    /// The count as it is, 32 bit.
    pub fn raw(&self) -> i32 {
        match self.source {
            Source::Pulses(..) => self.total as i64 as i32,
            Source::Set | Source::None => self.wrapped(self.total) as i64 as i32,
        }
    }

    /// How far the filtered count has moved since this was called last.
    pub fn take_moved(&mut self) -> f64 {
        std::mem::take(&mut self.moved)
    }

    /// One frame with these digital inputs, and so many ticks from a conveyor that runs.
    pub fn advance(&mut self, inputs: u64, ticks: f64) {
        if let Source::Pulses(decoder, pins) = self.source {
            let levels = pins.map(|pin| inputs >> pin & 1 == 1);
            let before = self.levels.replace(levels).unwrap_or(levels);
            let ticks = if decoder == Decoder::Quadrature { ticks } else { ticks.abs() };
            self.total += f64::from(steps(decoder, before, levels)) + ticks;
        }
        let before = self.filtered;
        self.filtered += self.rate * FRAME_SECONDS;
        let lacks = self.total - self.filtered;
        if lacks.abs() < SETTLED && self.rate.abs() < SETTLED {
            (self.filtered, self.rate) = (self.total, 0.0);
        } else {
            self.filtered += 2.0 * FOLLOWS * lacks * FRAME_SECONDS;
            self.rate += FOLLOWS * FOLLOWS * lacks * FRAME_SECONDS;
        }
        self.moved += self.filtered - before;
    }
}

/// Counts between two looks at the inputs.
fn steps(decoder: Decoder, before: [bool; 2], now: [bool; 2]) -> i32 {
    let (rises, falls) = (!before[0] && now[0], before[0] && !now[0]);
    match decoder {
        Decoder::Edges => i32::from(rises || falls),
        Decoder::Rising => i32::from(rises),
        Decoder::Falling => i32::from(falls),
        Decoder::Quadrature => {
            // A leads B: 00, 10, 11, 01.
            let place = |[a, b]: [bool; 2]| match (a, b) {
                (false, false) => 0,
                (true, false) => 1,
                (true, true) => 2,
                (false, true) => 3,
            };
            match (place(now) - place(before) + 4) % 4 {
                1 => 1,
                3 => -1,
                _ => 0,
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_that_are_set_wrap_round_their_range_and_are_filtered_without_lag() {
        let mut encoder = Encoder::default();
        assert_eq!(encoder.unwind(-65_530.0), None, "its range is not known");
        assert!(!encoder.expect_counts(5) && !encoder.expect_counts(-1) && encoder.expect_counts(2));
        assert_eq!((encoder.unwind(-65_530.0), encoder.unwind(300.0)), (Some(6.0), Some(300.0)));
        assert!(!encoder.set(65_536.0) && !encoder.set(-1.0) && encoder.set(65_000.0));
        assert_eq!((encoder.count(), encoder.raw()), (65_000.0, 65_000), "the first at once");
        encoder.take_moved();
        let mut count = 65_000.0;
        for _ in 0..2000 {
            count = (count + 2.0) % 65_536.0;
            assert!(encoder.set(count));
            encoder.advance(0, 0.0);
        }
        assert!((encoder.count() - count).abs() < 0.5, "{} {count}", encoder.count());
        assert!((encoder.take_moved() - 4000.0).abs() < 0.5);
        assert_eq!(encoder.take_moved(), 0.0);
    }

    #[test]
    fn pulses_count_by_their_decoder_and_direction() {
        // A and B on bits 8 and 9, one period forwards.
        let period = [0b00, 0b01, 0b11, 0b10, 0b00].map(|levels| levels << 8);
        let count = |decoder, levels: &mut dyn Iterator<Item = u64>| {
            let mut encoder = Encoder::default();
            encoder.expect_pulses(Some((decoder, [8, 9])));
            levels.for_each(|inputs| encoder.advance(inputs, 0.0));
            encoder.raw()
        };
        for (decoder, forwards) in
            [(Decoder::Quadrature, 4), (Decoder::Edges, 2), (Decoder::Rising, 1), (Decoder::Falling, 1)]
        {
            assert_eq!(count(decoder, &mut period.into_iter()), forwards, "{decoder:?}");
        }
        assert_eq!(count(Decoder::Quadrature, &mut period.into_iter().rev()), -4);
    }

    #[test]
    fn a_conveyor_that_runs_counts_where_pulses_are_expected_backwards_by_two_inputs_only() {
        for (expected, raw) in
            [(None, 0), (Some((Decoder::Rising, [8, 8])), 500), (Some((Decoder::Quadrature, [8, 9])), -500)]
        {
            let mut encoder = Encoder::default();
            encoder.expect_pulses(expected);
            (0..1000).for_each(|_| encoder.advance(0, -0.5));
            assert_eq!(encoder.raw(), raw, "{expected:?}");
        }
        let mut set = Encoder::default();
        assert!(set.expect_counts(0) && set.set(7.0));
        set.advance(0, 0.5);
        assert_eq!(set.raw(), 7);
    }
}
