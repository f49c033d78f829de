//! The simulator without sockets: controller, world, gripper and faults, driven by calls.
//!
//! In: [`Simulator::advance`] for 2 ms of simulated time, [`Simulator::connect`], [`Simulator::receive`] and
//! [`Simulator::hang_up`] for what clients do. Out: [`Simulator::transmit`], the bytes for each connection
//! and the connections that the simulator ends. Nothing here reads a clock, opens a socket or starts a
//! thread: the same calls give the same bytes. `serve` drives the same [`Session`]s over the same
//! [`Core`] from real sockets; what a network does to the bytes on the way (delays, cut cables) is the
//! caller's business, and [`Simulator::link`] says what the faults want of it.

use crate::controller::{Controller, ControllerConfig};
use crate::core::Core;
use crate::faults::link::{LinkName, LinkState};
use crate::faults::{FaultError, Planned};
use crate::robot_server::line::{Bytes, Inlet};
use crate::session::{Port, Session};
use crate::world::spec::{WorldError, WorldSpec};
use crate::world::{World, lock};
use std::collections::{BTreeMap, VecDeque};

/// A connection, by number; numbers are not used again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ConnectionId(pub u64);

/// What the simulator does with a connection.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Transmission {
    /// These bytes are for its client.
    Bytes(ConnectionId, Bytes),
    /// It is over.
    Closed(ConnectionId),
}

/// The whole simulated cell as one machine.
pub struct Simulator {
    core: Core,
    sessions: BTreeMap<ConnectionId, (Session, Inlet)>,
    last_id: u64,
    out: VecDeque<Transmission>,
}

/// Why a simulator cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum SimulatorError {
    /// The world's description is wrong.
    #[error("the simulated world cannot be built")]
    World(#[from] WorldError),
    /// A fault names something that is not there.
    #[error("a planned fault is impossible")]
    Fault(#[from] FaultError),
}

impl Simulator {
    /// A cell just switched on.
    ///
    /// # Errors
    /// [`SimulatorError`].
    pub fn new(
        controller: ControllerConfig,
        world: WorldSpec,
        seed: u64,
        faults: Vec<Planned>,
    ) -> Result<Simulator, SimulatorError> {
        let core = Core::new(Controller::new(controller), World::new(world, seed)?, 1.0);
        core.injector.submit(faults)?;
        Ok(Simulator { core, sessions: BTreeMap::new(), last_id: 0, out: VecDeque::new() })
    }

    /// Controller, world and faults: tests, reports and the camera.
    pub fn core(&self) -> &Core {
        &self.core
    }

    /// What is wrong with a server's connections.
    pub fn link(&self, name: LinkName) -> LinkState {
        self.core.robot.links.get(name).state()
    }

    /// 2 ms of simulated time.
    pub fn advance(&mut self) {
        self.core.advance(None);
        let Simulator { core, sessions, out, .. } = self;
        for (id, (_, inlet)) in sessions.iter_mut() {
            pass_on(*id, inlet, out);
        }
        // A switch to local control ends connections, and so does a client that never reads.
        let ended: Vec<ConnectionId> =
            sessions.iter().filter(|(_, (session, _))| !session.is_open(core)).map(|(id, _)| *id).collect();
        for id in ended {
            self.end(id);
        }
    }

    /// A client connects; `None` while no server listens there.
    pub fn connect(&mut self, port: Port) -> Option<ConnectionId> {
        let without_dashboard = self.core.robot.controller().core.config.is_polyscope_x();
        let absent = match port {
            Port::Dashboard => without_dashboard,
            Port::Robotiq => !lock(&self.core.world).has_fingers(),
            Port::ToolSerial => !lock(&self.core.world).is_on_tool_line(),
            _ => false,
        };
        if absent || self.link(port.link()).down {
            return None;
        }
        self.last_id += 1;
        let id = ConnectionId(self.last_id);
        let (session, mut inlet) = Session::open(&self.core, port, None);
        pass_on(id, &mut inlet, &mut self.out);
        self.sessions.insert(id, (session, inlet));
        Some(id)
    }

    /// Bytes of a client; those for a connection that is over are lost.
    pub fn receive(&mut self, id: ConnectionId, bytes: &[u8]) {
        let Simulator { core, sessions, out, .. } = self;
        let Some((session, inlet)) = sessions.get_mut(&id) else { return };
        let outcome = session.receive(core, bytes);
        pass_on(id, inlet, out);
        out.extend(outcome.answers.into_iter().map(|answer| Transmission::Bytes(id, answer)));
        if outcome.over {
            self.end(id);
        } else {
            session.answered(core);
        }
    }

    /// The client is gone.
    pub fn hang_up(&mut self, id: ConnectionId) {
        let Some((mut session, _)) = self.sessions.remove(&id) else { return };
        session.finish(&self.core);
        session.close(&self.core);
    }

    /// The next thing to do with a connection.
    pub fn transmit(&mut self) -> Option<Transmission> {
        self.out.pop_front()
    }

    fn end(&mut self, id: ConnectionId) {
        self.hang_up(id);
        self.out.push_back(Transmission::Closed(id));
    }
}

/// What the controller sends to a connection without a request.
fn pass_on(id: ConnectionId, inlet: &mut Inlet, out: &mut VecDeque<Transmission>) {
    while let Some(bytes) = inlet.take() {
        out.push_back(Transmission::Bytes(id, bytes));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::drive::{Drive, EjectorPins};
    use crate::world::spec::GripperSpec;
    use nalgebra::Isometry3;
    use ur_wire::primary::{HEADER, Package};
    use ur_wire::primary_message::MessageBody;
    use ur_wire::primary_state::SubPackage;

    fn simulator() -> Simulator {
        let controller = ControllerConfig { running: true, ..ControllerConfig::ur5e(1) };
        let world = WorldSpec::bare(Isometry3::translation(-0.75, -0.4, 0.0), GripperSpec::one_cup(0.2));
        Simulator::new(controller, world, 1, Vec::new()).unwrap()
    }

    fn sent(simulator: &mut Simulator) -> Vec<Transmission> {
        std::iter::from_fn(|| simulator.transmit()).collect()
    }

    #[test]
    fn the_same_calls_give_the_same_bytes() {
        let run = || {
            let mut simulator = simulator();
            let dashboard = simulator.connect(Port::Dashboard).unwrap();
            simulator.connect(Port::Primary).unwrap();
            simulator.receive(dashboard, b"robotmode\nis in remote control\n");
            (0..600).for_each(|_| simulator.advance());
            sent(&mut simulator)
        };
        let first = run();
        assert!(first.len() > 15, "greetings, answers and twelve robot states: {}", first.len());
        assert_eq!(first, run());
    }

    /// Of what was sent, the packages to a connection, in order.
    fn packages(sent: &[Transmission], wanted: ConnectionId) -> Vec<Package> {
        let bytes = sent.iter().filter_map(|transmission| match transmission {
            Transmission::Bytes(id, bytes) if *id == wanted => Some(bytes),
            _ => None,
        });
        bytes.map(|bytes| Package::decode(bytes[4], &bytes[HEADER..]).unwrap()).collect()
    }

    fn stop_of(package: &Package) -> Option<bool> {
        let Package::RobotState(parts) = package else { return None };
        parts.iter().find_map(|part| match part {
            SubPackage::RobotMode(mode) => Some(mode.protective_stopped),
            _ => None,
        })
    }

    #[test]
    fn the_state_with_a_protective_stop_comes_before_the_error_about_it() {
        let mut simulator = simulator();
        let primary = simulator.connect(Port::Primary).unwrap();
        let secondary = simulator.connect(Port::Secondary).unwrap();
        simulator.advance();
        sent(&mut simulator);
        simulator.core().robot.controller().protective_stop("test");
        simulator.advance();
        let out = sent(&mut simulator);
        let [state, error, mode] = &packages(&out, primary)[..] else { panic!("{out:?}") };
        assert_eq!(stop_of(state), Some(true));
        let body = |package: &Package| match package {
            Package::Message(message) => message.body.clone(),
            other => panic!("{other:?}"),
        };
        assert!(matches!(body(error), MessageBody::Error { code: 204, .. }));
        assert!(matches!(body(mode), MessageBody::SafetyMode { .. }));
        assert_eq!(packages(&out, secondary).len(), 1, "at once there too");
        (0..3).for_each(|_| simulator.advance());
        assert_eq!(packages(&sent(&mut simulator), primary), [], "once, then ten times a second");
    }

    #[test]
    fn the_interpreter_socket_has_a_reply_for_each_line() {
        let mut simulator = simulator();
        let primary = simulator.connect(Port::Primary).unwrap();
        let socket = simulator.connect(Port::Interpreter).unwrap();
        simulator.receive(primary, b"interpreter_mode()\n");
        simulator.advance();
        sent(&mut simulator);
        simulator.receive(socket, b"set_digital_out(1, Tr");
        simulator.receive(socket, b"ue)\r\n\nstatelastexecuted\nx = (\n");
        simulator.receive(socket, &[b'x'; 5000]);
        simulator.advance();
        let replies: Vec<u8> = sent(&mut simulator)
            .iter()
            .filter_map(|transmission| match transmission {
                Transmission::Bytes(id, bytes) if *id == socket => Some(bytes.to_vec()),
                _ => None,
            })
            .flatten()
            .collect();
        let replies = String::from_utf8(replies).unwrap();
        let lines: Vec<&str> = replies.lines().collect();
        assert_eq!(lines[..2], ["ack: 1: set_digital_out(1, True)", "state: 0: statelastexecuted"]);
        assert!(lines[2].starts_with("discard: syntax error") && lines[2].ends_with(": x = ("), "{replies}");
        assert!(lines[3].starts_with("discard: the statement is too long") && lines.len() == 4, "{replies}");
        assert_eq!(simulator.core().robot.controller().core.registers.digital_outputs & 2, 2);
    }

    #[test]
    fn the_primary_interface_unlocks_at_once_and_the_dashboard_after_five_seconds() {
        let mut simulator = simulator();
        let primary = simulator.connect(Port::Primary).unwrap();
        let dashboard = simulator.connect(Port::Dashboard).unwrap();
        simulator.core().robot.controller().protective_stop("test");
        simulator.receive(dashboard, b"unlock protective stop\n");
        simulator.advance();
        assert!(simulator.core().robot.controller().core.modes.protective_stopped());
        simulator.receive(primary, b"set unlock protective stop\n");
        assert!(!simulator.core().robot.controller().core.modes.protective_stopped());
        simulator.core().robot.controller().emergency_stop(true);
        simulator.receive(primary, b"set unlock protective stop\n");
        assert!(simulator.core().robot.controller().core.modes.emergency_stopped(), "no other stop");
    }

    #[test]
    fn polyscope_x_has_no_dashboard_and_reports_its_version() {
        let controller = ControllerConfig { version: [10, 12, 3, 4], ..ControllerConfig::ur5e(1) };
        let world = WorldSpec::bare(Isometry3::identity(), GripperSpec::one_cup(0.2));
        let mut simulator = Simulator::new(controller, world, 1, Vec::new()).unwrap();
        assert_eq!(simulator.connect(Port::Dashboard), None);
        let primary = simulator.connect(Port::Primary).unwrap();
        let sent = packages(&sent(&mut simulator), primary);
        let versions = sent.iter().filter_map(|package| match package {
            Package::Message(message) => match &message.body {
                MessageBody::Version { major, minor, bugfix, build, .. } => {
                    Some((*major, *minor, *bugfix, *build))
                }
                _ => None,
            },
            _ => None,
        });
        assert_eq!(versions.collect::<Vec<_>>(), [(10, 12, 3, 4)]);
    }

    #[test]
    fn a_script_switches_an_ejector_on_and_sees_its_vacuum_switch() {
        // In the air the cups reach 12 %.
        let pins = EjectorPins { vacuum_on: 2, blow_off: None, part_present: Some(4), switches_at: 0.1 };
        let gripper = GripperSpec { drive: Drive::Ejector(pins), ..GripperSpec::one_cup(0.2) };
        let world = WorldSpec::bare(Isometry3::translation(-0.75, -0.4, 0.0), gripper);
        let controller = ControllerConfig { running: true, ..ControllerConfig::ur5e(1) };
        let mut simulator = Simulator::new(controller, world, 1, Vec::new()).unwrap();
        let primary = simulator.connect(Port::Primary).unwrap();
        let script =
            b"def e():\n set_standard_digital_out(2, True)\n while not get_standard_digital_in(4):\n  \
                       sync()\n end\n set_standard_digital_out(3, True)\nend\n";
        simulator.receive(primary, script);
        let outputs =
            |simulator: &Simulator| simulator.core().robot.controller().core.registers.digital_outputs;
        (0..10).for_each(|_| simulator.advance());
        assert_eq!(outputs(&simulator), 1 << 2);
        (0..500).for_each(|_| simulator.advance());
        assert_eq!(outputs(&simulator), 1 << 2 | 1 << 3);
        let box_of_a_vgc10 = lock(&simulator.core().world).has_compute_box();
        assert!(!box_of_a_vgc10 && simulator.connect(Port::Robotiq).is_none());
    }

    #[test]
    fn a_client_that_leaves_is_forgotten_and_garbage_ends_a_connection() {
        let mut simulator = simulator();
        let dashboard = simulator.connect(Port::Dashboard).unwrap();
        simulator.receive(dashboard, b"quit\n");
        assert_eq!(sent(&mut simulator).last(), Some(&Transmission::Closed(dashboard)));
        let rtde = simulator.connect(Port::Rtde).unwrap();
        simulator.receive(rtde, &[0, 1, b'V']);
        assert_eq!(sent(&mut simulator), [Transmission::Closed(rtde)]);
        let gripper = simulator.connect(Port::Gripper).unwrap();
        simulator.hang_up(gripper);
        simulator.receive(gripper, &[0xff; 20]);
        assert_eq!(sent(&mut simulator), []);
    }
}
