//! The machine: device sessions, supervisor and commit gate behind three calls.
//!
//! In: [`Machine::handle`] takes events with the time at which they are handed over. Out: [`Machine::poll`]
//! gives effects until there are none; [`Machine::next_wake`] says when to hand over [`Event::Time`] at the
//! latest. A shell hands over everything that has happened, then the time, then carries out the effects.
//! Decisions are made when time is handed over: a computer that was held up reads its sockets first, and so
//! never calls a device silent whose words it had not read. No effect has to be taken back: what must be on
//! disk first is waited for as an event.

use crate::device::gripper::Gripper;
use crate::device::gripper_types::{GripperEvent, GripperParameters};
use crate::device::program::TemplateError;
use crate::device::robot::{DROPPED, Robot};
use crate::device::robot_types::{
    InputsTaken, KnownRobot, Link, RobotCommand, RobotEvent, RobotIdentity, RobotParameters, RobotState,
};
use crate::event::{Arm, Effect, Event, News};
use crate::intake::refusal;
use crate::links::{Connections, Wish};
use crate::notified::{Notified, RESTS_AFTER};
use crate::orders::Reply;
use crate::snapshot::{Sessions, snapshot};
use crate::supervisor::cell::Supervisor;
use crate::supervisor::input::{Action, Input, Record};
use crate::supervisor::model::CellModel;
use crate::supervisor::status::Status;
use cell_values::time::{Duration, Timestamp};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use ur_arm::kinematics::DhParameters;

/// How often the supervisor is given time while something is under way, and while nothing is.
const TICK: Duration = Duration::from_millis(10);
const IDLE_TICK: Duration = Duration::from_millis(100);

/// What a machine is made with.
#[derive(Clone, Debug)]
pub struct MachineParameters {
    /// The robot session.
    pub robot: RobotParameters,
    /// The gripper session.
    pub gripper: GripperParameters,
    /// The first nonce is made from this; it differs from run to run.
    pub nonce_seed: u64,
}

/// The cell. See the module. It is written down for recordings; one that was read from a file drives
/// nothing: its paths were checked by the celld that wrote it, and `replay` alone reads one.
#[derive(Serialize, Deserialize)]
pub struct Machine {
    robot: Robot,
    gripper: Gripper,
    connections: Connections,
    supervisor: Option<Supervisor>,
    nonce_seed: u64,
    gripper_answers: bool,
    identity: Identity,
    inputs: VecDeque<Input>,
    effects: VecDeque<Effect>,
    requests: Requests,
    /// A job was requested and has not come.
    wants_job: bool,
    notified: Notified,
    last_turn: Timestamp,
    ended: bool,
}

impl std::fmt::Debug for Machine {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Machine").finish_non_exhaustive()
    }
}

/// What the controller has said of the arm.
#[derive(Default, Deserialize, Serialize)]
struct Identity {
    kinematics: Option<(DhParameters, String)>,
    robot: KnownRobot,
    /// Inputs that another client holds, since the last request for RTDE.
    taken: Option<InputsTaken>,
    reported: bool,
}

/// Numbers of the requests to perception and planner: an answer to one from before the last one, or before
/// the first picture of the present look, is too late to count.
#[derive(Default, Deserialize, Serialize)]
struct Requests {
    last: u64,
    since: u64,
    planning: bool,
}

impl Machine {
    /// A machine without connections and without a cell.
    ///
    /// # Errors
    /// The on-robot program is no template.
    pub fn new(parameters: MachineParameters) -> Result<Machine, TemplateError> {
        Ok(Machine {
            robot: Robot::new(parameters.robot)?,
            gripper: Gripper::new(parameters.gripper),
            connections: Connections::default(),
            supervisor: None,
            nonce_seed: parameters.nonce_seed,
            gripper_answers: false,
            identity: Identity::default(),
            inputs: VecDeque::new(),
            effects: VecDeque::new(),
            requests: Requests::default(),
            wants_job: false,
            notified: Notified::default(),
            last_turn: Timestamp::ZERO,
            ended: false,
        })
    }

    /// Takes in what happened; decisions follow with [`Event::Time`].
    pub fn handle(&mut self, now: Timestamp, event: Event) {
        match event {
            Event::Time => self.turn(now),
            Event::Connected(link) => {
                self.connections.made(link);
                self.robot.connected(now, link);
            }
            Event::Disconnected(link, reason) => {
                self.robot.disconnected(now, link, &reason);
                self.connections.lost(now, link, reason);
            }
            Event::Received(link, bytes) => self.robot.received(now, link, &bytes),
            Event::Registers(answer) => self.gripper.response(now, answer),
            Event::Exposed(number) => self.answered(number, Input::Exposed),
            Event::Looked(number, result) => self.answered(number, Input::Captured(result)),
            Event::Observed(number, result) => self.answered(number, Input::Observed(result)),
            Event::Pictured(number, result) => self.answered(number, Input::Pictured(result)),
            Event::Planned(number, answer) => {
                self.requests.planning &= number != self.requests.last;
                self.answered(number, Input::Planned(answer));
            }
            Event::Committed(number, result) => self.inputs.push_back(Input::Committed { number, result }),
            Event::StoreLost(fault) => self.inputs.push_back(Input::StoreLost(fault)),
            Event::Commission { model, arm } => self.commission(*model, arm),
            Event::Job(order) => {
                self.wants_job = false;
                self.inputs.push_back(Input::Job(order));
            }
            Event::Round(order) => self.inputs.push_back(Input::Round(order)),
            Event::Order(number, order, origin) => match refusal(&order, origin) {
                Some(reply) => self.effects.push_back(Effect::Reply { number, reply }),
                None => self.inputs.push_back(Input::Order { number, order }),
            },
            Event::OrdersReach(fault) => self.inputs.push_back(Input::OrdersReach(fault)),
            Event::HeldUp(gap) => self.inputs.push_back(Input::HeldUp(gap)),
            Event::Shutdown => self.inputs.push_back(Input::Shutdown),
        }
    }

    /// The next effect to carry out.
    pub fn poll(&mut self) -> Option<Effect> {
        self.effects.pop_front()
    }

    /// When [`Event::Time`] is due at the latest.
    pub fn next_wake(&self) -> Timestamp {
        let tick = if self.supervisor.as_ref().is_none_or(Supervisor::is_idle) { IDLE_TICK } else { TICK };
        let sessions = [self.robot.poll_timeout(), self.gripper.poll_timeout()];
        let due = sessions.into_iter().flatten().map(|(at, _)| at).chain(self.connections.next_wake());
        due.fold(self.last_turn + tick, Timestamp::min)
    }

    /// The robot as its last package showed it.
    pub fn robot_state(&self) -> Option<&RobotState> {
        self.robot.state()
    }

    /// The robot's latest state, unless it is too old to count on.
    pub fn fresh_robot_state(&self, now: Timestamp) -> Option<&RobotState> {
        self.robot.state().filter(|_| self.robot.fresh(now))
    }

    /// What of the robot is missing, one line each; empty when it is known and all links are up.
    pub fn missing(&self) -> Vec<String> {
        let identity = &self.identity;
        let mut lines = self.connections.why_down();
        if let Some(taken) = &identity.taken {
            lines.retain(|line| !line.starts_with(&Link::Rtde.to_string()));
            lines.push(taken.to_string());
        }
        if lines.is_empty() && !identity.reported {
            lines.push("the controller answers, and has not yet said which arm it moves".to_string());
        }
        lines
    }

    /// The supervisor, once the cell is commissioned.
    pub fn supervisor(&self) -> Option<&Supervisor> {
        self.supervisor.as_ref()
    }

    /// The gripper's last reading and its time.
    pub fn vacuum(&self) -> Option<(Timestamp, [f64; 2])> {
        self.gripper.reading()
    }

    /// True while a program of ours is being started, stopped or ended.
    pub fn program_busy(&self) -> bool {
        !self.robot.program_settled()
    }

    fn commission(&mut self, model: CellModel, arm: bool) {
        // A number that a calibration round has used proves nothing any more.
        let seed = self.supervisor.as_ref().map_or(self.nonce_seed, Supervisor::next_nonce);
        let mut supervisor = Supervisor::new(model, seed);
        supervisor.commissioned_for(self.identity.robot.clone());
        if arm {
            supervisor.arm_at_start();
        }
        self.supervisor = Some(supervisor);
        self.wants_job = false;
    }

    fn answered(&mut self, number: u64, input: Input) {
        if (self.requests.since..=self.requests.last).contains(&number) {
            self.inputs.push_back(input);
        }
    }

    /// Time is handed over: sessions, then decisions, then what is to be sent.
    fn turn(&mut self, now: Timestamp) {
        self.last_turn = now;
        while let Some(wish) = self.connections.tick(now) {
            self.effects.push_back(match wish {
                Wish::Connect(link) => Effect::Connect(link),
                Wish::Close(link) => Effect::Close(link),
            });
        }
        self.robot.tick(now);
        self.gripper.tick(now);
        let waiting = std::mem::take(&mut self.inputs);
        self.take_session_events();
        self.inputs.extend(waiting);
        // After a pause nothing that was under way goes on before the cell knows of the pause.
        self.inputs.make_contiguous().sort_by_key(|input| !matches!(input, Input::HeldUp(_)));
        self.work_off(now);
        self.step(now, Input::Tick);
        self.work_off(now);
        self.flush(now);
        self.show(now);
    }

    /// Everything the sessions report, in order.
    fn take_session_events(&mut self) {
        while let Some(event) = self.robot.poll_event() {
            self.identify(&event);
            self.inputs.push_back(Input::Robot(event));
        }
        while let Some(event) = self.gripper.poll_event() {
            if let GripperEvent::Answering | GripperEvent::Unreachable { .. } = event {
                self.gripper_answers = event == GripperEvent::Answering;
            }
            self.inputs.push_back(Input::Gripper(event));
        }
    }

    fn identify(&mut self, event: &RobotEvent) {
        let identity = &mut self.identity;
        match event {
            RobotEvent::Kinematics { dh, checksum } => {
                identity.kinematics = Some((*dh, checksum.map(|word| format!("{word:08x}")).concat()));
            }
            RobotEvent::Identity { serial, model, version } => {
                let (model, serial, version) = (model.clone(), serial.clone(), version.clone());
                identity.robot.identity = Some(RobotIdentity { model, serial, version });
            }
            RobotEvent::SafetyChecksum { checksum } => identity.robot.safety_checksum = Some(*checksum),
            RobotEvent::InputInUse { taken, .. } => identity.taken = Some(taken.clone()),
            RobotEvent::RtdeReady => identity.taken = None,
            RobotEvent::RtdeLost
            | RobotEvent::RemoteControl { .. }
            | RobotEvent::ProgramRunning { .. }
            | RobotEvent::ProgramEnded { .. }
            | RobotEvent::SegmentFinished { .. }
            | RobotEvent::PathFinished { .. }
            | RobotEvent::PayloadSet
            | RobotEvent::TcpSet
            | RobotEvent::Stopped
            | RobotEvent::Paused
            | RobotEvent::Resumed
            | RobotEvent::Safety { .. }
            | RobotEvent::Mode { .. }
            | RobotEvent::Completed { .. }
            | RobotEvent::Refused { .. }
            | RobotEvent::RuntimeException { .. }
            | RobotEvent::ErrorCode { .. }
            | RobotEvent::Message { .. }
            | RobotEvent::LinkSilent { .. }
            | RobotEvent::ArmStalled { .. }
            | RobotEvent::JointJump { .. }
            | RobotEvent::ProtocolFault { .. } => {}
        }
    }

    /// Inputs one after the other; what comes of one is looked at before the next.
    fn work_off(&mut self, now: Timestamp) {
        while let Some(input) = self.inputs.pop_front() {
            if self.has_gone_on(&input) {
                continue;
            }
            self.step(now, input);
            let later = std::mem::take(&mut self.inputs);
            self.take_session_events();
            self.inputs.extend(later);
        }
    }

    /// The end of a path that another one was sent after: the arm does not rest there, or not for long, and
    /// it is not the end that is waited for.
    fn has_gone_on(&self, input: &Input) -> bool {
        let Input::Robot(RobotEvent::PathFinished { batch }) = input else { return false };
        *batch != self.robot.last_batch()
    }

    /// One input through the supervisor; its actions are carried out in order.
    fn step(&mut self, now: Timestamp, input: Input) {
        let Some(supervisor) = &mut self.supervisor else { return self.step_without_cell(input) };
        let Machine { robot, gripper, connections, .. } = self;
        let devices = snapshot(now, &Sessions { robot, gripper, connections }, self.gripper_answers);
        let actions = supervisor.step(now, &devices, input);
        let mut refused = Vec::new();
        for action in actions {
            refused.extend(self.carry_out(now, action));
        }
        for input in refused.into_iter().rev() {
            self.inputs.push_front(input);
        }
    }

    /// Before the arm is known there is nothing to decide but the end.
    fn step_without_cell(&mut self, input: Input) {
        match input {
            Input::Order { number, .. } => {
                let reply = Reply::refuse(format!("celld is starting: {}", self.missing().join("; ")));
                self.effects.push_back(Effect::Reply { number, reply });
            }
            Input::Shutdown => self.end(Ok(())),
            Input::StoreLost(fault) => self.end(Err(fault)),
            Input::Tick
            | Input::Robot(_)
            | Input::Gripper(_)
            | Input::Exposed
            | Input::Captured(_)
            | Input::Observed(_)
            | Input::Planned(_)
            | Input::Pictured(_)
            | Input::Committed { .. }
            | Input::OrdersReach(_)
            | Input::HeldUp(_)
            | Input::Job(_)
            | Input::Round(_) => {}
        }
    }

    fn end(&mut self, how: Result<(), crate::supervisor::mode::EndFault>) {
        if !std::mem::replace(&mut self.ended, true) {
            self.effects.push_back(Effect::End(how));
        }
    }

    /// Carries out one action; a refusal of a session is the next input.
    fn carry_out(&mut self, now: Timestamp, action: Action) -> Option<Input> {
        let effect = match action {
            Action::Robot(command) => return self.command_robot(now, command),
            Action::Gripper(command) => {
                let refused = self.gripper.command(now, command).is_err();
                return refused.then_some(Input::Gripper(GripperEvent::Refused));
            }
            Action::Capture { frames, table_from_camera, first } => {
                let number = if first { self.next_request() } else { self.further_request() };
                Effect::Look { number, frames, table_from_camera }
            }
            Action::Observe { views, partial, held } => {
                Effect::Observe { number: self.next_request(), views, partial, held }
            }
            Action::Picture { pose, base_from_flange } => {
                Effect::Picture { number: self.next_request(), pose, base_from_flange }
            }
            Action::Plan(request) => {
                let number = self.next_request();
                self.requests.planning = true;
                Effect::Plan { number, request }
            }
            Action::Commit { number, record } => {
                if let Record::Ended(report) = &record {
                    self.cancel_plan();
                    self.effects.push_back(Effect::Notify(News::Ended(report.clone())));
                }
                Effect::Commit { number, record }
            }
            Action::Reply { number, reply } => Effect::Reply { number, reply },
            Action::RoundOver(result) => Effect::RoundOver(result),
            Action::Say(notice) => Effect::Notify(News::Notice(notice)),
            Action::End(how) => {
                self.cancel_plan();
                self.end(how);
                return None;
            }
        };
        self.effects.push_back(effect);
        None
    }

    fn command_robot(&mut self, now: Timestamp, command: RobotCommand) -> Option<Input> {
        let what = command.name();
        // A program that has ended by itself need not be ended.
        let may_fail = command == RobotCommand::EndProgram;
        let refused = self.robot.command(now, command).err().filter(|_| !may_fail)?;
        Some(Input::Robot(RobotEvent::Refused { what: what.to_string(), reply: refused.to_string() }))
    }

    fn next_request(&mut self) -> u64 {
        self.requests.since = self.requests.last + 1;
        self.further_request()
    }

    /// Answers to the requests before it still count.
    fn further_request(&mut self) -> u64 {
        self.cancel_plan();
        self.requests.last += 1;
        self.requests.last
    }

    fn cancel_plan(&mut self) {
        if std::mem::take(&mut self.requests.planning) {
            self.effects.push_back(Effect::CancelPlan);
        }
    }

    /// What the sessions want to send, and which links they want dropped.
    fn flush(&mut self, now: Timestamp) {
        while let Some((link, bytes)) = self.robot.poll_transmit() {
            self.effects.push_back(Effect::Send(link, bytes));
        }
        while let Some(link) = self.robot.poll_close() {
            if self.connections.is_up(link) {
                self.effects.push_back(Effect::Close(link));
                self.close(now, link);
            }
        }
        while let Some(request) = self.gripper.poll_request(now) {
            self.effects.push_back(Effect::Registers(request));
        }
    }

    fn close(&mut self, now: Timestamp, link: Link) {
        self.connections.dropped(now, link);
        self.robot.disconnected(now, link, DROPPED);
    }

    /// What has changed for people, and whether a job is wanted.
    fn show(&mut self, now: Timestamp) {
        self.report_identity();
        let Some(supervisor) = &self.supervisor else { return };
        let Machine { robot, gripper, connections, .. } = self;
        let sessions = Sessions { robot, gripper, connections };
        let seen = snapshot(now, &sessions, self.gripper_answers);
        let status = supervisor.status_with(&seen);
        // The last status is written as soon as the arm rests.
        let long = if supervisor.mode().ending() { Duration::ZERO } else { RESTS_AFTER };
        let moving = self.notified.moves(now, &seen, long) || status.moving;
        let status = Status { moving, ..status };
        if self.notified.status.as_ref() != Some(&status) {
            self.effects.push_back(Effect::Notify(News::Status(Box::new(status.clone()))));
            self.notified.status = Some(status);
            let route = supervisor.route();
            if self.notified.route != route {
                self.effects.push_back(Effect::Notify(News::Route(route.clone())));
                self.notified.route = route;
            }
        }
        if supervisor.wants_job() && !self.wants_job {
            self.wants_job = true;
            self.effects.push_back(Effect::WantJob);
        }
    }

    /// Once: the arm is known when its kinematics, its serial number, its state and who controls it are.
    fn report_identity(&mut self) {
        let identity = &self.identity;
        let (Some((dh, checksum)), Some(robot)) = (&identity.kinematics, &identity.robot.identity) else {
            return;
        };
        let known = self.robot.state().is_some_and(|state| state.remote_control.is_some());
        if identity.reported || !known {
            return;
        }
        let arm = Arm::new(robot, *dh, checksum);
        self.identity.reported = true;
        self.effects.push_back(Effect::Notify(News::Identified(Box::new(arm))));
    }
}

#[cfg(test)]
mod tests;
