//! The device sessions, fed by their links: robot and gripper as the loops of the daemon see them.
//!
//! In: commands. Out: [`Happening`]s. Everything that is ready is taken in before time is looked at, so that a
//! daemon that was held up finds fresh states in its sockets instead of declaring them stale.

use crate::daemon::links::{LinkEvent, LinkOrder, spawn_modbus, spawn_tcp};
use crate::device::gripper::{Gripper, GripperCommand, GripperEvent, GripperParameters, ModbusRequest};
use crate::device::program::TemplateError;
use crate::device::robot::Robot;
use crate::device::robot_types::{Link, RobotCommand, RobotEvent, RobotParameters, STALE_AFTER};
use crate::io::clock::Clock;
use crate::supervisor::input::Outside;
use crate::time::Timestamp;
use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::time::Duration;
use tokio::sync::mpsc;

/// Where the devices listen.
#[derive(Clone, Debug)]
pub struct Addresses {
    /// RTDE, port 30004.
    pub rtde: SocketAddr,
    /// Dashboard, port 29999.
    pub dashboard: SocketAddr,
    /// Primary interface, port 30001.
    pub primary: SocketAddr,
    /// Compute Box of the gripper.
    pub gripper: SocketAddr,
}

/// Something a device session reported.
#[derive(Debug)]
pub enum Happening {
    /// From the robot.
    Robot(RobotEvent),
    /// From the gripper.
    Gripper(GripperEvent),
}

/// Robot and gripper.
pub struct Hardware {
    clock: Clock,
    robot: Robot,
    gripper: Gripper,
    events: mpsc::Receiver<LinkEvent>,
    rtde: mpsc::Sender<LinkOrder>,
    dashboard: mpsc::Sender<LinkOrder>,
    primary: mpsc::Sender<LinkOrder>,
    modbus: mpsc::Sender<ModbusRequest>,
    gripper_answers: bool,
    /// Why a link is down, by link: for the sentence of whoever waits for it.
    down: BTreeMap<String, String>,
    last_turn: Timestamp,
    /// Until then silence may be this daemon's own doing.
    listening_from: Timestamp,
}

/// Link events that may wait for the loop: at 500 states a second, two seconds' worth.
const EVENTS: usize = 1024;

/// A turn of the loop that took longer than this says nothing about the robot: the computer was busy.
const LATE_TURN: Duration = Duration::from_millis(50);

/// A vacuum read longer ago than this says nothing: idle channels are read ten times a second.
const VACUUM_AGE: Duration = Duration::from_millis(500);

/// How often the sessions are given time when nothing comes in, in the cell's time.
const TICK: Duration = Duration::from_millis(10);

impl Hardware {
    /// Opens the links; the devices need not be there yet.
    pub fn open(
        addresses: &Addresses,
        clock: Clock,
        robot: RobotParameters,
        gripper: GripperParameters,
    ) -> Result<Hardware, TemplateError> {
        let (sender, events) = mpsc::channel(EVENTS);
        let tcp = |link, address| spawn_tcp(link, address, clock.clone(), sender.clone());
        Ok(Hardware {
            rtde: tcp(Link::Rtde, addresses.rtde),
            dashboard: tcp(Link::Dashboard, addresses.dashboard),
            primary: tcp(Link::Primary, addresses.primary),
            modbus: spawn_modbus(addresses.gripper, clock.clone(), Duration::from_secs(1), sender.clone()),
            clock,
            robot: Robot::new(robot)?,
            gripper: Gripper::new(gripper),
            events,
            gripper_answers: false,
            down: BTreeMap::new(),
            last_turn: Timestamp::ZERO,
            listening_from: Timestamp::ZERO,
        })
    }

    /// The cell's time.
    pub fn now(&self) -> Timestamp {
        self.clock.now()
    }

    /// The robot session.
    pub fn robot(&self) -> &Robot {
        &self.robot
    }

    /// The devices' last word, for the supervisor.
    pub fn outside(&self, now: Timestamp) -> Outside<'_> {
        Outside {
            robot: self.robot.state(),
            robot_fresh: self.robot.fresh(now),
            robot_silent: !self.robot.fresh(now) && now >= self.listening_from,
            program_settled: self.robot.program_settled(),
            gripper_answers: self.gripper_answers,
            vacuum: self.gripper.reading().filter(|(at, _)| now.since(*at) <= VACUUM_AGE).map(|(_, v)| v),
        }
    }

    /// Why links to the controller are down, one line each; empty when all stand.
    pub fn why_down(&self) -> Vec<String> {
        self.down.iter().map(|(link, reason)| format!("{link}: {reason}")).collect()
    }

    /// Gives the robot session a command; a refusal comes back as an event would.
    pub fn command_robot(&mut self, command: RobotCommand) -> Option<RobotEvent> {
        // Working the command out may have taken a while: what came in meanwhile is newer than what was known.
        let now = self.clock.now();
        while let Ok(event) = self.events.try_recv() {
            self.take(now, event);
        }
        let what = command_name(&command);
        let refused = self.robot.command(now, command).err();
        self.flush();
        refused.map(|refused| RobotEvent::Refused { what: what.to_string(), reply: refused.to_string() })
    }

    /// Gives the gripper session a command.
    pub fn command_gripper(&mut self, command: GripperCommand) {
        let now = self.clock.now();
        // What the session refuses never reaches the device; the phase that waits for it runs into its deadline.
        if let Err(refused) = self.gripper.command(now, command) {
            tracing::warn!(%refused, ?command, "gripper command refused");
        }
        self.flush();
    }

    /// Waits for the next thing to happen, at most one tick, and returns all that did.
    pub async fn next(&mut self) -> Vec<Happening> {
        let held_up = self.clock.now().since(self.last_turn) > LATE_TURN;
        let first = tokio::time::timeout(self.clock.wall(TICK), self.events.recv()).await;
        let now = self.clock.now();
        if held_up || now.since(self.last_turn) > LATE_TURN {
            self.listening_from = now + STALE_AFTER;
        }
        self.last_turn = now;
        if let Ok(Some(event)) = first {
            self.take(now, event);
        }
        while let Ok(event) = self.events.try_recv() {
            self.take(now, event);
        }
        if let Some(state) = self.robot.state() {
            self.clock.heard(state.controller_time_s);
        }
        self.robot.tick(now);
        self.gripper.tick(now);
        self.flush();
        let mut out = Vec::new();
        while let Some(event) = self.robot.poll_event() {
            out.push(Happening::Robot(event));
        }
        while let Some(event) = self.gripper.poll_event() {
            match event {
                GripperEvent::Answering => self.gripper_answers = true,
                GripperEvent::Unreachable { .. } => self.gripper_answers = false,
                _ => {}
            }
            out.push(Happening::Gripper(event));
        }
        out
    }

    fn take(&mut self, now: Timestamp, event: LinkEvent) {
        match event {
            LinkEvent::Connected(link) => {
                self.down.remove(&link.to_string());
                self.robot.connected(now, link);
            }
            LinkEvent::Disconnected(link, reason) => {
                tracing::debug!(?link, reason, "link down");
                self.robot.disconnected(now, link, &reason);
                self.down.insert(link.to_string(), reason);
            }
            LinkEvent::Received(link, bytes) => self.robot.received(now, link, &bytes),
            LinkEvent::Modbus(answer) => self.gripper.response(now, answer),
        }
    }

    /// Hands everything the sessions want to say to the links. A full queue means that the peer has not read
    /// for over a second: the link's own deadline ends it, and what is dropped here is dropped with it.
    fn flush(&mut self) {
        while let Some((link, bytes)) = self.robot.poll_transmit() {
            if self.link(link).try_send(LinkOrder::Send(bytes)).is_err() {
                tracing::warn!(?link, "link queue full, bytes dropped");
            }
        }
        while let Some(link) = self.robot.poll_close() {
            let _ = self.link(link).try_send(LinkOrder::Reconnect);
        }
        while let Some(request) = self.gripper.poll_request(self.clock.now()) {
            if self.modbus.try_send(request).is_err() {
                tracing::warn!("gripper queue full, request dropped");
            }
        }
    }

    fn link(&self, link: Link) -> &mpsc::Sender<LinkOrder> {
        match link {
            Link::Rtde => &self.rtde,
            Link::Dashboard => &self.dashboard,
            Link::Primary => &self.primary,
        }
    }
}

/// The command in a word, for messages.
fn command_name(command: &RobotCommand) -> &'static str {
    match command {
        RobotCommand::PowerOn => "power on",
        RobotCommand::ReleaseBrakes => "brake release",
        RobotCommand::StartProgram { .. } => "starting the program",
        RobotCommand::Stream(_) => "a path",
        RobotCommand::SetPayload { .. } => "the payload",
        RobotCommand::SetTcp(_) => "the TCP",
        RobotCommand::Stop => "stop",
        RobotCommand::EndProgram => "ending the program",
        RobotCommand::UnlockProtectiveStop => "unlocking the protective stop",
        RobotCommand::CloseSafetyPopup => "closing the popup",
    }
}
