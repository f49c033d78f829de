//! The stream of commands to the on-robot program: numbered, a few ahead of execution, each with a deadline.
//!
//! In: paths, payloads and TCPs in order; what the program reports as accepted and finished; time that
//! passed, scaled by the robot's speed. Out: the next command to write, what was finished, what is overdue.
//! One command is under way at a time (the registers hold only one), up to [`QUEUE_DEPTH`] are on the robot
//! unfinished.

use crate::device::registers::{CommandRegisters, Opcode, QUEUE_DEPTH};
use crate::device::robot_types::Refused;
use cell_motion::path::{CheckedPath, Segment};
use cell_values::units::Joints;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use ur_arm::kinematics::{DhParameters, forward};

/// Commands that may wait on the PC.
const MAX_WAITING: usize = 1024;
/// The program takes a command within this time while it plays, s (two frames when all is well).
const ACCEPT_WITHIN_S: f64 = 0.5;
/// A command is overdue after this many times its nominal duration ...
const DURATION_FACTOR: f64 = 3.0;
/// ... plus this, s at full speed. Both are generous: a late end is noticed, a slow robot is not accused.
const DURATION_SLACK_S: f64 = 2.0;
/// Joint speed assumed where a linear segment turns the wrist more than it travels, rad/s.
const TURNING_RAD_S: f64 = 0.5;

/// Something in the stream was carried out.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
pub enum Done {
    /// A segment.
    Segment {
        /// Number of the path.
        batch: u32,
        /// Index in the path.
        index: usize,
    },
    /// The last segment of a path.
    Path {
        /// Number of the path.
        batch: u32,
    },
    /// A payload was set.
    Payload {
        /// kg.
        mass_kg: f64,
        /// Centre of gravity in the flange frame, m.
        centre_of_gravity_m: [f64; 3],
    },
    /// A TCP was set.
    Tcp([f64; 6]),
}

/// What follows a segment.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
enum End {
    /// Another one of its path.
    GoesOn,
    /// The arm rests at its end.
    Rests,
    /// The arm rests at its end. The segment is left out if another path is queued by then and it is not the
    /// only one of its path.
    Waits,
}

#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
enum What {
    Segment { batch: u32, index: usize, end: End },
    Setting(Done),
}

#[derive(Deserialize, Serialize)]
struct Item {
    what: What,
    command: CommandRegisters,
    nominal_s: f64,
}

#[derive(Deserialize, Serialize)]
struct Sent {
    what: What,
    sequence: i32,
    budget_s: f64,
}

/// The stream. See the module.
#[derive(Default, Deserialize, Serialize)]
pub struct Stream {
    waiting: VecDeque<Item>,
    sent: VecDeque<Sent>,
    done: VecDeque<Done>,
    last_sent: i32,
    accepted: i32,
    finished: i32,
    accept_budget_s: f64,
    batch: u32,
    end: Option<Joints>,
}

impl Stream {
    /// A program has started that counts from `accepted`; whatever was streamed to an earlier one is void.
    pub fn start(&mut self, accepted: i32) {
        self.clear();
        self.last_sent = accepted;
        self.accepted = accepted;
        self.finished = accepted;
    }

    /// Forgets everything that waits or is under way.
    pub fn clear(&mut self) {
        self.waiting.clear();
        self.sent.clear();
        self.done.clear();
        self.end = None;
    }

    /// True if nothing waits and nothing is under way.
    pub fn is_idle(&self) -> bool {
        self.waiting.is_empty() && self.sent.is_empty()
    }

    /// Number of the path taken last.
    pub fn last_batch(&self) -> u32 {
        self.batch
    }

    /// Where the arm will be after all paths; `None` if none is under way.
    pub fn end(&self) -> Option<Joints> {
        self.end
    }

    /// The first number that means something new to the program, whatever is under way.
    pub fn skip_sequence(&mut self) -> i32 {
        self.last_sent = self.last_sent.wrapping_add(1);
        self.last_sent
    }

    /// Adds a path and gives it a number.
    ///
    /// # Errors
    /// Too much is waiting.
    pub fn push_path(&mut self, path: &CheckedPath, dh: &DhParameters) -> Result<u32, Refused> {
        self.push(path, End::Rests, dh)
    }

    /// Adds a path that ends at a waiting place. If the next path is queued in time, the program skips the
    /// last segment, unless it is the only one. The end of such a path that goes on in another is not
    /// reported.
    ///
    /// # Errors
    /// Too much is waiting.
    pub fn push_to_wait(&mut self, path: &CheckedPath, dh: &DhParameters) -> Result<u32, Refused> {
        self.push(path, End::Waits, dh)
    }

    fn push(&mut self, path: &CheckedPath, end: End, dh: &DhParameters) -> Result<u32, Refused> {
        let segments = path.segments();
        self.room_for(segments.len())?;
        self.batch = self.batch.wrapping_add(1);
        let mut from = path.start();
        for (index, segment) in segments.iter().enumerate() {
            let end = if index + 1 == segments.len() { end } else { End::GoesOn };
            let what = What::Segment { batch: self.batch, index, end };
            let nominal_s = nominal_duration_s(dh, &from, segment);
            // A path's only segment is never skipped: the next path begins at its end.
            let command = segment_registers(segment, end == End::GoesOn, end == End::Waits && index > 0);
            self.waiting.push_back(Item { what, command, nominal_s });
            from = segment.target();
        }
        self.end = Some(from);
        Ok(self.batch)
    }

    /// Adds a payload: mass (kg), centre of gravity (m).
    ///
    /// # Errors
    /// Too much is waiting.
    pub fn push_payload(&mut self, mass_kg: f64, cog: [f64; 3]) -> Result<(), Refused> {
        let arguments = [mass_kg, cog[0], cog[1], cog[2], 0.0, 0.0];
        self.push_setting(Done::Payload { mass_kg, centre_of_gravity_m: cog }, Opcode::SetPayload, arguments)
    }

    /// Adds a TCP in the flange frame.
    ///
    /// # Errors
    /// Too much is waiting.
    pub fn push_tcp(&mut self, tcp: [f64; 6]) -> Result<(), Refused> {
        self.push_setting(Done::Tcp(tcp), Opcode::SetTcp, tcp)
    }

    fn push_setting(&mut self, setting: Done, opcode: Opcode, arguments: [f64; 6]) -> Result<(), Refused> {
        self.room_for(1)?;
        let command = CommandRegisters { arguments, ..CommandRegisters::bare(0, opcode) };
        self.waiting.push_back(Item { what: What::Setting(setting), command, nominal_s: 0.0 });
        Ok(())
    }

    fn room_for(&self, count: usize) -> Result<(), Refused> {
        if self.waiting.len() + count > MAX_WAITING {
            return Err(Refused::QueueFull(self.waiting.len()));
        }
        Ok(())
    }

    /// True if the next command begins a path and everything before it is done: the moment to make sure that
    /// payload and TCP are what they should be.
    pub fn path_begins(&self) -> bool {
        self.sent.is_empty() && self.path_is_next()
    }

    /// True if the next command begins a path, whatever is under way.
    pub fn path_is_next(&self) -> bool {
        let begins = |item: &Item| matches!(item.what, What::Segment { index: 0, .. });
        self.waiting.front().is_some_and(begins)
    }

    /// The next command to write, if the program has taken the one before and has room.
    pub fn poll_command(&mut self) -> Option<CommandRegisters> {
        let room = self.sent.len() < QUEUE_DEPTH as usize;
        if self.accepted != self.last_sent || !room {
            return None;
        }
        let item = self.waiting.pop_front()?;
        let sequence = self.skip_sequence();
        self.accept_budget_s = ACCEPT_WITHIN_S;
        let budget_s = DURATION_SLACK_S + DURATION_FACTOR * item.nominal_s;
        self.sent.push_back(Sent { what: item.what, sequence, budget_s });
        Some(CommandRegisters { sequence, ..item.command })
    }

    /// What the program reports.
    ///
    /// # Errors
    /// Numbers that it cannot have.
    pub fn progress(&mut self, accepted: i32, finished: i32) -> Result<(), String> {
        if accepted != self.accepted && accepted != self.last_sent {
            let sent = self.last_sent;
            return Err(format!("the program reports command {accepted} as accepted, {sent} was sent last"));
        }
        // Differences, because numbers may run over the end of the register.
        if accepted.wrapping_sub(finished) < 0 || finished.wrapping_sub(self.finished) < 0 {
            let before = self.finished;
            return Err(format!(
                "the program reports command {finished} as finished, {before} to {accepted} may be"
            ));
        }
        self.accepted = accepted;
        self.finished = finished;
        while self.sent.front().is_some_and(|sent| finished.wrapping_sub(sent.sequence) >= 0) {
            if let Some(sent) = self.sent.pop_front() {
                self.finish(sent.what);
            }
        }
        Ok(())
    }

    fn finish(&mut self, what: What) {
        match what {
            What::Segment { batch, index, end } => {
                self.done.push_back(Done::Segment { batch, index });
                if end == End::GoesOn || (end == End::Waits && batch != self.batch) {
                    return;
                }
                self.done.push_back(Done::Path { batch });
                if batch == self.batch {
                    self.end = None;
                }
            }
            What::Setting(setting) => self.done.push_back(setting),
        }
    }

    /// What was carried out.
    pub fn poll_done(&mut self) -> Option<Done> {
        self.done.pop_front()
    }

    /// Time went by: `playing_s` while the program played, `scaled_s` of it at full speed.
    ///
    /// # Errors
    /// A command is overdue; the text says which.
    pub fn elapse(&mut self, playing_s: f64, scaled_s: f64) -> Result<(), String> {
        if self.accepted != self.last_sent {
            self.accept_budget_s -= playing_s;
            if self.accept_budget_s < 0.0 {
                return Err(format!("the robot did not take command {} within 0.5 s", self.last_sent));
            }
        }
        if let Some(sent) = self.sent.front_mut() {
            sent.budget_s -= scaled_s;
            if sent.budget_s < 0.0 {
                let what = match sent.what {
                    What::Segment { index, .. } => format!("part {} of the motion", index + 1),
                    What::Setting(_) => "setting payload or TCP".into(),
                };
                return Err(format!("{what} (command {}) is overdue", sent.sequence));
            }
        }
        Ok(())
    }
}

fn segment_registers(segment: &Segment, goes_on: bool, waits: bool) -> CommandRegisters {
    let (opcode, target, speed, acceleration, blend) = match *segment {
        Segment::Joint { target, speed, acceleration, blend } => {
            (Opcode::MoveJoint, target, speed, acceleration, blend)
        }
        Segment::Linear { target, speed, acceleration, blend } => {
            (Opcode::MoveLinear, target, speed, acceleration, blend)
        }
    };
    // The last segment of a path ends at rest: what comes next may not be a motion.
    let blend = if goes_on { blend } else { 0.0 };
    CommandRegisters {
        last: !goes_on,
        waits,
        arguments: target.0,
        speed,
        acceleration,
        blend,
        ..CommandRegisters::bare(0, opcode)
    }
}

/// Duration of a segment at full speed, s: a trapezoid that reaches its speed, so rather too long than too
/// short.
fn nominal_duration_s(dh: &DhParameters, from: &Joints, segment: &Segment) -> f64 {
    let turn = from.max_difference(&segment.target());
    let trapezoid = |way: f64, speed: f64, acceleration: f64| way / speed + speed / acceleration;
    match *segment {
        Segment::Joint { speed, acceleration, .. } => trapezoid(turn, speed, acceleration),
        Segment::Linear { target, speed, acceleration, .. } => {
            let way = forward(dh, &target).translation.vector - forward(dh, from).translation.vector;
            trapezoid(way.norm(), speed, acceleration).max(turn / TURNING_RAD_S)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stream_with(count: usize) -> Stream {
        let mut stream = Stream::default();
        stream.start(40);
        for _ in 0..count {
            stream.push_payload(1.0, [0.0, 0.0, 0.05]).unwrap();
        }
        stream
    }

    #[test]
    fn one_command_is_under_way_at_a_time() {
        let mut stream = stream_with(3);
        assert_eq!(stream.poll_command().unwrap().sequence, 41);
        assert_eq!(stream.poll_command(), None);
        stream.progress(40, 40).unwrap();
        assert_eq!(stream.poll_command(), None);
        stream.progress(41, 40).unwrap();
        assert_eq!(stream.poll_command().unwrap().sequence, 42);
        stream.progress(42, 42).unwrap();
        assert!(matches!(stream.poll_done(), Some(Done::Payload { mass_kg: 1.0, .. })));
        assert!(stream.poll_done().is_some());
        assert_eq!(stream.poll_done(), None);
    }

    #[test]
    fn never_more_than_the_robot_holds() {
        let mut stream = stream_with(20);
        let mut sent = 0;
        while let Some(command) = stream.poll_command() {
            sent += 1;
            stream.progress(command.sequence, 40).unwrap();
        }
        assert_eq!(sent, QUEUE_DEPTH);
        stream.progress(40 + QUEUE_DEPTH, 41).unwrap();
        assert!(stream.poll_command().is_some());
    }

    #[test]
    fn impossible_numbers_are_errors() {
        let mut stream = stream_with(2);
        stream.poll_command().unwrap();
        assert!(stream.progress(43, 40).unwrap_err().contains("43"));
        assert!(stream.progress(39, 39).is_err());
        assert!(stream.progress(41, 42).is_err());
        assert!(stream.progress(41, 20).is_err());
        stream.progress(41, 41).unwrap();
    }

    #[test]
    fn numbers_run_over_the_end_of_the_register() {
        let mut stream = stream_with(0);
        stream.start(i32::MAX);
        stream.push_tcp([0.0; 6]).unwrap();
        assert_eq!(stream.poll_command().unwrap().sequence, i32::MIN);
        stream.progress(i32::MIN, i32::MAX).unwrap();
        assert_eq!(stream.poll_done(), None);
        stream.progress(i32::MIN, i32::MIN).unwrap();
        assert_eq!(stream.poll_done(), Some(Done::Tcp([0.0; 6])));
    }

    #[test]
    fn deadlines_count_time_at_full_speed() {
        let mut stream = stream_with(1);
        stream.elapse(10.0, 10.0).unwrap();
        stream.poll_command().unwrap();
        stream.elapse(0.4, 0.4).unwrap();
        stream.elapse(0.0, 0.0).unwrap();
        assert!(stream.elapse(0.2, 0.2).unwrap_err().contains("41"));
        let mut stream = stream_with(1);
        stream.poll_command().unwrap();
        stream.progress(41, 40).unwrap();
        stream.elapse(100.0, 1.9).unwrap();
        assert!(stream.elapse(100.0, 0.2).unwrap_err().contains("overdue"));
    }
}
