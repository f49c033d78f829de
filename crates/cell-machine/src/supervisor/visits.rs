//! A calibration round: slow moves to given poses, one picture at each; or ways through cut corners, at the
//! speeds of the configuration, for a recorder.
//!
//! In: the poses and the taught box, or the ways; the order to begin is the operator's leave to move. Poses
//! are of the class *calibrate*: in the box, at most 0.1 m/s. A crossing is like the way to a look: the
//! gripper empty, the path checked. `celld calibrate` hands poses over and arms by it; a person at the page
//! orders the round of the taught poses in a cell that is armed, holds nothing and works on nothing. Out: a
//! picture request at each pose where the arm is at rest, and at the end the cell disarmed, whatever
//! happened, and the on-robot program ended, or stopped where a stop ended the round. The gates and the
//! bring-up are those of every other motion.

use crate::device::robot_types::RobotCommand;
use crate::orders::Reply;
use crate::supervisor::cell::Supervisor;
use crate::supervisor::gates::{self, GateClosed};
use crate::supervisor::input::{Action, CameraFault, DeviceSnapshot};
use crate::supervisor::mode::Mode;
use crate::supervisor::phase::{Phase, Visit};
use crate::supervisor::reason::say;
use crate::supervisor::round::{Round, RoundFault, RoundOrder};
use cell_motion::crossing::Crossing;
use cell_motion::slow::slow_move;
use cell_values::time::{Duration, Timestamp};
use cell_values::units::Joints;

/// An arm within this of the start of a crossing, or of its end, is there, rad: resting arms repeat to 1e-4.
const AT_START_RAD: f64 = 1e-3;

/// The arm is at rest for this long before a picture.
const SETTLE: Duration = Duration::from_millis(500);

/// For one pose, at full speed.
const POSE_WITHIN: Duration = Duration::from_secs(120);

/// For one picture; a camera gives up by itself before.
const PICTURE_WITHIN: Duration = Duration::from_secs(120);

impl Supervisor {
    /// Takes a round up and arms the cell for it, unless what keeps an operator from arming is there.
    pub(crate) fn on_round(
        &mut self,
        now: Timestamp,
        devices: &DeviceSnapshot,
        order: RoundOrder,
        out: &mut Vec<Action>,
    ) {
        self.waiting_since = now;
        let way_back = self.back.recovery.is_some().then_some("a way back is under way");
        let why = self.under_way(devices).or(way_back).map(str::to_string);
        let why = why.or_else(|| self.round_gate(devices)).or_else(|| self.crossing_gate(&order, devices));
        let why = why.or_else(|| {
            (!self.mode.arm()).then(|| match &self.mode {
                Mode::Locked(reason) => reason.clone(),
                Mode::Ending { .. } | Mode::Disarmed { .. } | Mode::Armed { .. } => {
                    "celld is ending".to_string()
                }
            })
        });
        match why {
            Some(why) => out.push(Action::RoundOver(Err(RoundFault::Robot(why)))),
            None => self.round = Some(Round::new(order)),
        }
    }

    /// A person orders a round to the taught poses, in a cell that is armed already.
    pub(crate) fn on_calibrate(&mut self, now: Timestamp, devices: &DeviceSnapshot) -> Option<Reply> {
        let no = |why: String| Some(Reply::refuse(format!("no calibration round: {why}")));
        let order = self.model.round.clone();
        if order.poses.is_empty() {
            return no("the configuration names no `calibration_poses_deg`".to_string());
        }
        if self.round.is_some() {
            return Some(Reply::accept("a calibration round is under way already"));
        }
        if let Some(job) = &self.job {
            return no(format!("job {} is under way; let it end, or cancel it", job.order.id));
        }
        if !self.mode.armed() {
            return Some(self.not_armed(devices, "no calibration round"));
        }
        if self.mode.paused() {
            return no("the cell is paused; `celld resume` first".to_string());
        }
        if let Some(why) = self.under_way(devices) {
            return no(format!("{why}; try again"));
        }
        if !matches!(self.phase, Phase::Ready) || self.back.recovery.is_some() || self.mode.parks() {
            return no("the arm is under way; wait until it rests".to_string());
        }
        if let Err(closed) = gates::empty_handed(devices) {
            return no(format!("{}; {}", self.place(&closed), closed.hint()));
        }
        self.waiting_since = now;
        self.round = Some(Round::new(order));
        None
    }

    /// That a round begins, and what the arm does.
    pub(crate) fn calibrating(&self) -> String {
        let poses = self.round.as_ref().map_or(0, |round| round.order.poses.len());
        let when = match &self.waiting_for {
            Some(closed) => format!("as soon as it may move ({closed}) "),
            None => String::new(),
        };
        format!(
            "{when}the arm goes slowly to {poses} poses and takes a picture at each; then the cell is disarmed; \
             `celld abort` stops it now"
        )
    }

    /// What keeps the cell from being armed for a round, and what to do about it.
    fn round_gate(&self, devices: &DeviceSnapshot) -> Option<String> {
        let closed = self.orders_reach().and_then(|()| gates::arming_for_round(devices)).err()?;
        Some(format!("{}; {}", self.place(&closed), closed.hint_to_try_again()))
    }

    /// Crossings are as fast as work, so nothing may hang on the gripper. One that does not answer, as on an
    /// arm without any, is for the person to see who has ordered them.
    fn crossing_gate(&self, order: &RoundOrder, devices: &DeviceSnapshot) -> Option<String> {
        let held = gates::empty_handed(devices).err().filter(|closed| *closed == GateClosed::Holding);
        let held = held.filter(|_| !order.crossings.is_empty())?;
        Some(format!("{}; {}", self.place(&held), held.hint_to_try_again()))
    }

    /// Sends the arm to the next pose; after the last one the round is over.
    pub(crate) fn begin_visit(&mut self, devices: &DeviceSnapshot, out: &mut Vec<Action>) {
        let (Some(round), Some(robot)) = (&self.round, devices.robot) else { return };
        if let Some(crossing) = round.order.crossing(round.at).copied() {
            return self.begin_crossing(devices, robot.q, crossing, out);
        }
        let Some(target) = round.order.poses.get(round.at).copied() else {
            return self.end_round(Ok(()), out);
        };
        // What lies on the table was perhaps not seen, and nothing of it is looked at on the way.
        let (room, over) = (round.order.room.as_ref(), self.unseen_room());
        match slow_move(&self.model.arm, room, &over, round.at + 1, &robot.q, target) {
            Ok(path) => {
                out.push(Action::Robot(RobotCommand::Stream(path)));
                self.enter(Phase::Visit(Visit::Moving), POSE_WITHIN);
            }
            Err(fault) => self.end_round(Err(fault.into()), out),
        }
    }

    /// Sends the arm slowly to where the crossing begins, or on it, if it stands there.
    fn begin_crossing(
        &mut self,
        devices: &DeviceSnapshot,
        q: Joints,
        crossing: Crossing,
        out: &mut Vec<Action>,
    ) {
        let at_start = q.max_difference(&crossing.start) <= AT_START_RAD;
        let Some(round) = &mut self.round else { return };
        round.crosses = at_start;
        let pose = round.at + 1;
        if gates::empty_handed(devices) == Err(GateClosed::Holding) {
            let held = self.place(&GateClosed::Holding);
            return self.end_round(Err(RoundFault::Robot(held)), out);
        }
        let (arm, over) = (&self.model.arm, self.unseen_room());
        let path = if !at_start {
            slow_move(arm, None, &over, pose, &q, crossing.start).map_err(RoundFault::Move)
        } else {
            let path = crossing.path(arm, &q, &self.model.cycle, &over, self.hold());
            path.map_err(RoundFault::Crossing)
        };
        match path {
            Ok(path) => {
                out.push(Action::Robot(RobotCommand::Stream(path)));
                self.enter(Phase::Visit(Visit::Moving), POSE_WITHIN);
            }
            Err(fault) => self.end_round(Err(fault), out),
        }
    }

    /// The arm rests where a crossing begins or ends; if it rests elsewhere, the round ends.
    fn crossing_rests(&mut self, q: &Joints, out: &mut Vec<Action>) {
        let Some(round) = &mut self.round else { return };
        let Some(crossing) = round.order.crossing(round.at) else { return };
        let place = if round.crosses { crossing.end } else { crossing.start };
        let off = q.max_difference(&place);
        if off > AT_START_RAD {
            return self.end_round(Err(RoundFault::Elsewhere { off_mrad: 1e3 * off }), out);
        }
        round.at += usize::from(round.crosses);
        self.phase = Phase::Ready;
    }

    /// While settling: requests the picture once the arm has been at rest long enough.
    pub(crate) fn watch_visit(&mut self, now: Timestamp, devices: &DeviceSnapshot, out: &mut Vec<Action>) {
        let Phase::Visit(Visit::Settling { rest }) = &mut self.phase else { return };
        let Some(robot) = devices.robot.filter(|_| devices.robot_fresh) else { return };
        let rested = rest.note(robot.received, &robot.q);
        if rested < SETTLE {
            rest.report(now).into_iter().for_each(|why| say(out, why));
        } else if self.round.as_ref().is_some_and(|round| round.order.crossing(round.at).is_some()) {
            let q = robot.q;
            self.crossing_rests(&q, out);
        } else {
            let pose = self.round.as_ref().map_or(0, |round| round.at + 1);
            let base_from_flange = self.model.arm.kinematics.forward(&robot.q);
            out.push(Action::Picture { pose, base_from_flange });
            self.enter(Phase::Visit(Visit::Picturing), PICTURE_WITHIN);
        }
    }

    pub(crate) fn on_pictured(&mut self, result: Result<(), CameraFault>, out: &mut Vec<Action>) {
        if !matches!(self.phase, Phase::Visit(Visit::Picturing)) {
            return;
        }
        self.phase = Phase::Ready;
        match (result, &mut self.round) {
            (Ok(()), Some(round)) => round.at += 1,
            (Err(fault), _) => self.end_round(Err(RoundFault::Camera(fault.message)), out),
            (Ok(()), None) => {}
        }
    }

    /// Ends the round, if there is one: the program ends, nothing moves any more.
    pub(crate) fn end_round(&mut self, result: Result<(), RoundFault>, out: &mut Vec<Action>) {
        if self.round.take().is_none() {
            return;
        }
        self.phase = Phase::Ready;
        self.mode.disarm();
        out.push(Action::Robot(RobotCommand::EndProgram));
        out.push(Action::RoundOver(result));
    }
}
