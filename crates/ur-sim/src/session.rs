//! A client's connection without its socket: the one place where its bytes become answers.
//!
//! In: a [`Port`], then the client's bytes in any pieces, its last byte, its end. Out: [`Outcome`], the
//! answers to what was received; and at the connection's [`Inlet`] what it is sent without a request: the
//! greeting, states, data. The carrier of the bytes (real sockets in `serve`, calls in `simulator`) takes
//! first what is in the inlet, then the answers, and reports that they are on their way
//! ([`Session::answered`]).

use crate::compute_box::{self, Over, Service};
use crate::core::Core;
use crate::faults::link::LinkName;
use crate::gripper_server;
use crate::robot_server::line::{Bytes, Inlet, Line, Way};
use crate::robot_server::publisher::Feed;
use crate::robot_server::script_ports::Port as ScriptPort;
use crate::robot_server::{dashboard, interpreter, modbus, rtde, script_ports};
use crate::robotiq_server;
use crate::tool_serial_server;
use crate::world::lock;
use std::sync::Arc;

/// A server of the simulated cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Port {
    /// 30004.
    Rtde,
    /// 29999.
    Dashboard,
    /// 30001.
    Primary,
    /// 30002.
    Secondary,
    /// 30003.
    Realtime,
    /// 30011.
    PrimaryReadOnly,
    /// 30012.
    SecondaryReadOnly,
    /// 30013.
    RealtimeReadOnly,
    /// 30020.
    Interpreter,
    /// 502, of the controller.
    Modbus,
    /// Modbus of the gripper.
    Gripper,
    /// 63352, the socket of a Robotiq gripper's URCap.
    Robotiq,
    /// 54321, the serial line of the tool connector.
    ToolSerial,
}

impl Port {
    /// Under which name faults act on it.
    pub fn link(self) -> LinkName {
        match self {
            Port::Rtde => LinkName::Rtde,
            Port::Dashboard => LinkName::Dashboard,
            Port::Primary | Port::PrimaryReadOnly => LinkName::Primary,
            Port::Interpreter | Port::Modbus => LinkName::Primary,
            Port::Secondary | Port::SecondaryReadOnly => LinkName::Secondary,
            Port::Realtime | Port::RealtimeReadOnly => LinkName::Realtime,
            Port::Gripper | Port::Robotiq | Port::ToolSerial => LinkName::Gripper,
        }
    }

    /// True for a server that sends nothing without a request (but a greeting), so that a silent connection
    /// is an idle one.
    pub fn only_answers(self) -> bool {
        match self {
            Port::Dashboard | Port::Interpreter | Port::Modbus => true,
            Port::Gripper | Port::Robotiq | Port::ToolSerial => true,
            Port::Rtde | Port::Primary | Port::Secondary | Port::Realtime => false,
            Port::PrimaryReadOnly | Port::SecondaryReadOnly | Port::RealtimeReadOnly => false,
        }
    }

    /// The server in messages.
    pub fn name(self) -> &'static str {
        match self {
            Port::Rtde => "RTDE server",
            Port::Dashboard => "dashboard server",
            Port::Primary => "primary interface",
            Port::Secondary => "secondary interface",
            Port::Realtime => "real-time interface",
            Port::PrimaryReadOnly => "read-only primary interface",
            Port::SecondaryReadOnly => "read-only secondary interface",
            Port::RealtimeReadOnly => "read-only real-time interface",
            Port::Interpreter => "interpreter socket",
            Port::Modbus => "controller's Modbus server",
            Port::Gripper => "gripper",
            Port::Robotiq => "Robotiq URCap",
            Port::ToolSerial => "tool's serial line",
        }
    }
}

/// What became of a client's bytes.
#[derive(Debug, Default)]
pub struct Outcome {
    /// For the client, in this order.
    pub answers: Vec<Bytes>,
    /// The connection ends behind the answers.
    pub over: bool,
}

impl Outcome {
    /// The bytes break the protocol.
    const NONSENSE: Outcome = Outcome { answers: Vec::new(), over: true };

    /// One piece, if there is anything to say.
    fn one(answer: Vec<u8>, over: bool) -> Outcome {
        let answers = if answer.is_empty() { Vec::new() } else { vec![answer.into()] };
        Outcome { answers, over }
    }
}

enum Kind {
    Rtde(rtde::Session),
    Dashboard(dashboard::Session),
    Script(script_ports::Session),
    Interpreter(interpreter::Session),
    Modbus(modbus::Session),
    Gripper(gripper_server::Session, BoxClient),
    Robotiq(robotiq_server::Session),
    ToolSerial(tool_serial_server::Session),
}

/// A client of the gripper's box.
struct BoxClient {
    /// `None` if another gripper is mounted: its port serves several clients.
    number: Option<u64>,
    /// How often the cable was pulled before the last bytes of the client.
    silences: u64,
}

impl BoxClient {
    fn enter(core: &Core, line: &Line) -> BoxClient {
        let (now_s, has_box) = {
            let world = lock(&core.world);
            (world.now_s(), world.has_compute_box())
        };
        let number = has_box.then(|| compute_box::lock(&core.compute_box).enter(now_s, line));
        BoxClient { number, silences: silences(core) }
    }

    fn service(&self, core: &Core) -> Service {
        let Some(number) = self.number else { return Service::Served };
        let now_s = lock(&core.world).now_s();
        compute_box::lock(&core.compute_box).serves(now_s, number)
    }

    fn heard(&mut self, core: &Core) {
        self.silences = silences(core);
    }

    /// Its connection is gone. If the cable was pulled after its last bytes, the box has not noticed.
    fn leave(self, core: &Core) {
        let Some(number) = self.number else { return };
        let now_s = lock(&core.world).now_s();
        compute_box::lock(&core.compute_box).leave(now_s, number, silences(core) != self.silences);
    }
}

/// How often the cable of the gripper's box was pulled.
fn silences(core: &Core) -> u64 {
    core.robot.links.get(LinkName::Gripper).silences()
}

/// One connection.
pub struct Session {
    port: Port,
    kind: Kind,
}

impl Session {
    /// A client has connected. RTDE packages take the `way`, if there is one, past the inlet; the states of
    /// others would only delay them.
    pub fn open(core: &Core, port: Port, way: Option<Arc<dyn Way>>) -> (Session, Inlet) {
        let robot = &core.robot;
        let script = |feed, read_only| {
            let (session, inlet) = script_ports::Session::open(robot, ScriptPort { feed, read_only });
            (Kind::Script(session), inlet)
        };
        let (kind, inlet) = match port {
            Port::Rtde => {
                let (session, inlet) = rtde::Session::open(robot, way);
                (Kind::Rtde(session), inlet)
            }
            Port::Dashboard => {
                let (line, inlet) = Line::open(None);
                // The queue of a new connection has room.
                let _ = line.try_send(dashboard::Session::greeting().into_bytes().into());
                (Kind::Dashboard(dashboard::Session::new(&robot.controller())), inlet)
            }
            Port::Primary => script(Feed::Primary, false),
            Port::Secondary => script(Feed::Secondary, false),
            Port::Realtime => script(Feed::Realtime, false),
            Port::PrimaryReadOnly => script(Feed::Primary, true),
            Port::SecondaryReadOnly => script(Feed::Secondary, true),
            Port::RealtimeReadOnly => script(Feed::Realtime, true),
            Port::Interpreter => (Kind::Interpreter(interpreter::Session::default()), Line::open(None).1),
            Port::Modbus => (Kind::Modbus(modbus::Session::default()), Line::open(None).1),
            Port::Gripper => {
                let (line, inlet) = Line::open(None);
                (Kind::Gripper(gripper_server::Session::default(), BoxClient::enter(core, &line)), inlet)
            }
            Port::Robotiq => (Kind::Robotiq(robotiq_server::Session::default()), Line::open(None).1),
            Port::ToolSerial => {
                (Kind::ToolSerial(tool_serial_server::Session::default()), Line::open(None).1)
            }
        };
        (Session { port, kind }, inlet)
    }

    /// Carries out what arrived.
    pub fn receive(&mut self, core: &Core, bytes: &[u8]) -> Outcome {
        let robot = &core.robot;
        let outcome = match &mut self.kind {
            Kind::Rtde(session) => session.receive(robot, bytes).map(|answers| {
                let answers = answers.into_iter().map(Bytes::from).collect();
                Outcome { answers, over: false }
            }),
            Kind::Dashboard(session) => session
                .receive(robot, bytes)
                .map(|replies| Outcome::one(replies.into_bytes(), session.over())),
            Kind::Script(session) => {
                let over = session.receive(robot, bytes).is_err();
                Ok(Outcome { answers: Vec::new(), over })
            }
            Kind::Interpreter(session) => Ok(Outcome::one(session.receive(robot, bytes).into_bytes(), false)),
            Kind::Modbus(session) => {
                session.receive(robot, bytes).map(|answers| Outcome::one(answers, false))
            }
            Kind::Gripper(session, client) => {
                client.heard(core);
                let answers = match client.number {
                    Some(number) => core.box_receives(number, bytes),
                    None => core.gripper_receives(session, bytes).map_err(|_| Over),
                };
                return answers.map_or(Outcome::NONSENSE, |answers| Outcome::one(answers, false));
            }
            Kind::ToolSerial(session) => {
                let faults = robot.links.get(self.port.link()).state();
                Ok(Outcome::one(session.receive(core, &faults, bytes), false))
            }
            Kind::Robotiq(session) => session
                .receive(&mut lock(&core.world), bytes)
                .map(|answers| Outcome::one(answers.into_bytes(), false)),
        };
        outcome.unwrap_or(Outcome::NONSENSE)
    }

    /// The answers to what was received last are on their way.
    pub fn answered(&mut self, core: &Core) {
        if let Kind::Rtde(session) = &mut self.kind {
            session.answered(&core.robot);
        }
    }

    /// The client has sent its last byte.
    pub fn finish(&mut self, core: &Core) {
        if let Kind::Script(session) = &mut self.kind {
            session.finish(&core.robot);
        }
    }

    /// False once the controller has ended the connection: a switch to local control, a client that never
    /// reads.
    pub fn is_open(&self, core: &Core) -> bool {
        let id = match &self.kind {
            Kind::Rtde(session) => session.id(),
            Kind::Script(session) => session.id(),
            Kind::Dashboard(_) | Kind::Interpreter(_) | Kind::Modbus(_) => return true,
            Kind::Gripper(_, client) => return client.service(core) != Service::Ended,
            Kind::Robotiq(_) | Kind::ToolSerial(_) => return true,
        };
        core.robot.publisher().is_open(id)
    }

    /// The connection is gone: what it had claimed is free, and nothing more is sent to it.
    pub fn close(self, core: &Core) {
        match self.kind {
            Kind::Rtde(session) => session.close(&core.robot),
            Kind::Script(session) => session.close(&core.robot),
            Kind::Dashboard(_) | Kind::Interpreter(_) | Kind::Modbus(_) => {}
            Kind::Gripper(_, client) => client.leave(core),
            Kind::Robotiq(_) | Kind::ToolSerial(_) => {}
        }
    }
}
