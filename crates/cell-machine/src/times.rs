//! Where the time of a job goes, by what the arm did and what it waited for.
//!
//! In: spans of time with their [`Use`]. Out: [`TimeSplit`]s, s, one for each pick-n-place and one for the
//! full looks, in [`JobTimes`]. [`TimeBook`] sums them up while a job is
//! under way. Pure data; the supervisor says what a span is used for (`supervisor/time_book`).

use serde::{Deserialize, Serialize};
use std::fmt;

/// What a span of time is used for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Use {
    /// The arm moves over the table.
    Travel,
    /// It goes straight down or up.
    Vertical,
    /// It rests while the vacuum comes or goes.
    Vacuum,
    /// It has just arrived at a look pose.
    Settle,
    /// It rests for a picture to be taken and transferred.
    Exposure,
    /// It rests for what the picture shows.
    Detection,
    /// It rests for a plan.
    Planning,
    /// It rests for the journal.
    Disk,
    /// It rests for anything else: a person, a gate, a command on its way.
    Waiting,
}

impl Use {
    /// All of them, in the order of reports.
    pub const ALL: [Use; 9] = [
        Use::Travel,
        Use::Vertical,
        Use::Vacuum,
        Use::Settle,
        Use::Exposure,
        Use::Detection,
        Use::Planning,
        Use::Disk,
        Use::Waiting,
    ];

    /// The word in files and tables.
    pub fn as_str(self) -> &'static str {
        match self {
            Use::Travel => "travel",
            Use::Vertical => "vertical",
            Use::Vacuum => "vacuum",
            Use::Settle => "settle",
            Use::Exposure => "exposure",
            Use::Detection => "detection",
            Use::Planning => "planning",
            Use::Disk => "disk",
            Use::Waiting => "waiting",
        }
    }

    /// The arm rests, and neither for a picture nor for the vacuum.
    pub fn is_idle(self) -> bool {
        match self {
            Use::Travel | Use::Vertical | Use::Vacuum | Use::Exposure => false,
            Use::Settle | Use::Detection | Use::Planning | Use::Disk | Use::Waiting => true,
        }
    }
}

impl fmt::Display for Use {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

/// Seconds by their use.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, Serialize)]
pub struct TimeSplit([f64; Use::ALL.len()]);

impl TimeSplit {
    /// Adds seconds.
    pub fn add(&mut self, what: Use, seconds: f64) {
        self.0[what as usize] += seconds;
    }

    /// Adds all of another split.
    pub fn add_all(&mut self, other: &TimeSplit) {
        self.0.iter_mut().zip(other.0).for_each(|(sum, seconds)| *sum += seconds);
    }

    /// Seconds of one use.
    pub fn of(&self, what: Use) -> f64 {
        self.0[what as usize]
    }

    /// Seconds by use, in the order of [`Use::ALL`].
    pub fn iter(&self) -> impl Iterator<Item = (Use, f64)> {
        Use::ALL.into_iter().zip(self.0)
    }

    /// All of them, s.
    pub fn total_s(&self) -> f64 {
        self.0.iter().sum()
    }

    /// Those in which the arm rests, and neither for a picture nor for the vacuum, s.
    pub fn idle_s(&self) -> f64 {
        self.iter().filter(|(what, _)| what.is_idle()).map(|(_, seconds)| seconds).sum()
    }
}

/// Where the time of a job went.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize)]
pub struct JobTimes {
    /// Each look at the whole table, with planning and what a person was waited for after it; the first also
    /// with all that was waited for before it.
    pub rounds: Vec<TimeSplit>,
    /// Each pick-n-place, with the look before it.
    pub moves: Vec<TimeSplit>,
    /// Stops for pictures in full looks.
    pub round_stops: u32,
    /// Stops for pictures otherwise.
    pub stops: u32,
}

impl JobTimes {
    /// All of it.
    pub fn total(&self) -> TimeSplit {
        let mut sum = self.in_moves();
        self.rounds.iter().for_each(|split| sum.add_all(split));
        sum
    }

    /// All pick-n-places together.
    pub fn in_moves(&self) -> TimeSplit {
        let mut sum = TimeSplit::default();
        self.moves.iter().for_each(|split| sum.add_all(split));
        sum
    }
}

/// The time of the job under way.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize)]
pub struct TimeBook {
    done: JobTimes,
    /// The pick-n-place under way, with the look before it.
    present: TimeSplit,
    /// Segments of the present path that are behind.
    segments: usize,
    /// The first look at the whole table is awaited, and time is counted as its already.
    awaits_round: bool,
}

impl TimeBook {
    /// A path begins.
    pub fn begins_path(&mut self) {
        self.segments = 0;
    }

    /// One segment of it is behind.
    pub fn segment_over(&mut self) {
        self.segments += 1;
    }

    /// A look at the whole table begins.
    pub fn begins_round(&mut self) {
        if !std::mem::take(&mut self.awaits_round) {
            self.done.rounds.push(TimeSplit::default());
        }
    }

    /// The arm has stopped for a picture.
    pub fn stopped_for_a_picture(&mut self, whole: bool) {
        *(if whole { &mut self.done.round_stops } else { &mut self.done.stops }) += 1;
    }

    /// A pick-n-place is over.
    pub fn move_over(&mut self) {
        self.done.moves.push(std::mem::take(&mut self.present));
    }

    /// Segments of the present path that are behind.
    pub fn segments(&self) -> usize {
        self.segments
    }

    /// Time passed in the pick-n-place under way, or in the look at the whole table before it. Before the
    /// first look there is no pick-n-place: what is waited for then, a person or the robot, is no part of
    /// one.
    pub fn spend(&mut self, what: Use, in_round: bool, seconds: f64) {
        if self.done.rounds.is_empty() && self.done.moves.is_empty() {
            self.begins_round();
            self.awaits_round = true;
        }
        let in_round = in_round || self.awaits_round;
        let round = self.done.rounds.last_mut().filter(|_| in_round);
        round.unwrap_or(&mut self.present).add(what, seconds);
    }

    /// Where the time of the last pick-n-place went.
    pub fn last_move(&self) -> Option<TimeSplit> {
        self.done.moves.last().copied()
    }

    /// The job is over: where its time went.
    pub fn close(&mut self) -> JobTimes {
        let TimeBook { mut done, present, .. } = std::mem::take(self);
        match done.rounds.last_mut() {
            Some(round) => round.add_all(&present),
            None => done.rounds.push(present),
        }
        done
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_waited_for_before_the_first_look_is_no_part_of_a_move() {
        let mut book = TimeBook::default();
        book.spend(Use::Waiting, false, 60.0);
        book.begins_round();
        book.spend(Use::Travel, true, 2.0);
        book.spend(Use::Vertical, false, 1.0);
        book.move_over();
        book.begins_round();
        book.spend(Use::Travel, true, 3.0);
        let times = book.close();
        let totals: Vec<f64> = times.rounds.iter().map(TimeSplit::total_s).collect();
        assert_eq!((totals, times.moves.len()), (vec![62.0, 3.0], 1));
        assert_eq!(times.in_moves().total_s(), 1.0);
    }

    #[test]
    fn what_is_no_motion_picture_or_vacuum_is_idle() {
        let mut split = TimeSplit::default();
        for (k, what) in Use::ALL.into_iter().enumerate() {
            split.add(what, f64::from(1 << k));
        }
        assert_eq!((split.total_s(), split.of(Use::Settle)), (511.0, 8.0));
        assert_eq!(split.idle_s(), 8.0 + 32.0 + 64.0 + 128.0 + 256.0);
        let times = JobTimes { rounds: vec![split], moves: vec![split, split], ..JobTimes::default() };
        assert_eq!((times.total().total_s(), times.in_moves().of(Use::Disk)), (3.0 * 511.0, 256.0));
    }
}
