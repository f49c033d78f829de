//! The simulator without sockets: controller, world, gripper and faults, driven by calls.
//!
//! In: [`Simulator::advance`] for 2 ms of simulated time, [`Simulator::connect`], [`Simulator::receive`] and
//! [`Simulator::hang_up`] for what clients do. Out: [`Simulator::transmit`], the bytes for each connection
//! and the connections that the simulator ends. Nothing here reads a clock, opens a socket or starts a
//! thread: the same calls give the same bytes. `sim::cell` puts sockets, pace and priorities round the same
//! [`Core`]; what a network does to the bytes on the way (delays, cut cables) is the caller's business, and
//! [`Simulator::link`] says what the faults want of it.

use crate::sim::controller::{Controller, ControllerConfig};
use crate::sim::faults::desk::FaultDesk;
use crate::sim::faults::link::{LinkName, LinkState};
use crate::sim::faults::{FaultError, Planned};
use crate::sim::gripper_server;
use crate::sim::motion::FRAME_SECONDS;
use crate::sim::robot_server::outlets::{Feed, Inlet};
use crate::sim::robot_server::script_ports::{self, Port as ScriptPort};
use crate::sim::robot_server::{RobotShared, dashboard, rtde};
use crate::sim::world::event::Contact;
use crate::sim::world::spec::{WorldError, WorldSpec};
use crate::sim::world::{SharedWorld, World, lock};
use crate::wire::dashboard::GREETING;
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex};
use std::time::Instant;

/// Depth of a contact at which the arm's safety system stops it, m: cups and flange give way by some mm
/// first.
const STOP_DEPTH_M: f64 = 0.006;

/// Controller, world and faults, in step.
#[derive(Clone)]
pub struct Core {
    /// The controller and what it sends.
    pub robot: Arc<RobotShared>,
    /// The table, the objects, the gripper.
    pub world: SharedWorld,
    /// Faults planned and in force.
    pub desk: Arc<FaultDesk>,
}

impl Core {
    /// The world has its arm from the beginning. `factor`: simulated seconds per second, for delays of real
    /// sockets.
    pub fn new(robot: Arc<RobotShared>, world: World, factor: f64) -> Core {
        let world: SharedWorld = Arc::new(Mutex::new(world));
        let desk = Arc::new(FaultDesk::new(robot.clone(), world.clone(), factor));
        let core = Core { robot, world, desk };
        core.step_world();
        core
    }

    /// One controller frame, 2 ms; `due`: when it was, for how late packages leave.
    pub fn advance(&self, due: Option<Instant>) {
        self.robot.frame(due);
        self.step_world();
        self.desk.frame();
    }

    /// The world follows the arm, which feels what it touches; where it presses too hard, its safety system
    /// stops it.
    fn step_world(&self) {
        let (now, base_from_flange, moving) = {
            let controller = self.robot.controller();
            (controller.core.timestamp(), controller.core.base_from_flange(), !controller.core.mover.stands())
        };
        let (force, pressed) = {
            let mut world = lock(&self.world);
            let before = world.contact().map_or(0.0, |contact| contact.depth_m);
            world.step(now, FRAME_SECONDS, &base_from_flange);
            // Only what gets deeper: after the stop the arm must be able to retreat.
            let too_deep = |contact: &&Contact| moving && contact.depth_m > STOP_DEPTH_M.max(before);
            let force = world.base_from_table().rotation * world.contact_force();
            (force, world.contact().filter(too_deep).cloned())
        };
        let wrench = [force.x, force.y, force.z, 0.0, 0.0, 0.0];
        let mut controller = self.robot.controller();
        controller.core.sensing.set_contact_wrench(wrench);
        if let Some(contact) = pressed {
            controller.protective_stop(&format!("{} presses on {}", contact.moving, contact.against));
        }
    }
}

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
    /// Modbus.
    Gripper,
}

impl Port {
    /// Under which name faults act on it.
    pub fn link(self) -> LinkName {
        match self {
            Port::Rtde => LinkName::Rtde,
            Port::Dashboard => LinkName::Dashboard,
            Port::Primary => LinkName::Primary,
            Port::Secondary => LinkName::Secondary,
            Port::Realtime => LinkName::Realtime,
            Port::Gripper => LinkName::Gripper,
        }
    }
}

/// A connection, by number; numbers are not used again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ConnectionId(pub u64);

/// What the simulator does with a connection.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Transmission {
    /// These bytes are for its client.
    Bytes(ConnectionId, Arc<[u8]>),
    /// It is over.
    Closed(ConnectionId),
}

enum Session {
    Rtde(rtde::Session, Inlet),
    Dashboard(dashboard::Session),
    Script(script_ports::Session, Inlet),
    Gripper(gripper_server::Session),
}

/// The whole simulated cell as one machine.
pub struct Simulator {
    core: Core,
    sessions: BTreeMap<ConnectionId, (Port, Session)>,
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
        let robot = RobotShared::without_network(Controller::new(controller));
        let core = Core::new(robot, World::new(world, seed)?, 1.0);
        core.desk.submit(faults)?;
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
        for (id, (_, session)) in sessions.iter_mut() {
            if let Session::Rtde(_, inlet) | Session::Script(_, inlet) = session {
                pass_on(*id, inlet, out);
            }
        }
        // A switch to local control ends connections, and so does a client that never reads.
        let ended: Vec<ConnectionId> = sessions
            .iter()
            .filter(|(_, (_, session))| match session {
                Session::Rtde(_, inlet) | Session::Script(_, inlet) => {
                    !core.robot.outlets().is_open(inlet.id)
                }
                Session::Dashboard(_) | Session::Gripper(_) => false,
            })
            .map(|(id, _)| *id)
            .collect();
        for id in ended {
            self.end(id);
        }
    }

    /// A client connects; `None` while nobody listens there.
    pub fn connect(&mut self, port: Port) -> Option<ConnectionId> {
        if self.link(port.link()).down {
            return None;
        }
        self.last_id += 1;
        let id = ConnectionId(self.last_id);
        let robot = &self.core.robot;
        let script = |feed| {
            let (inlet, session) = script_ports::Session::open(robot, ScriptPort { feed, read_only: false });
            Session::Script(session, inlet)
        };
        let mut session = match port {
            Port::Rtde => {
                let inlet = robot.outlets().open(Feed::Rtde, false, None);
                Session::Rtde(rtde::Session::new(inlet.id), inlet)
            }
            Port::Dashboard => {
                let greeting = format!("{GREETING}\n").into_bytes();
                self.out.push_back(Transmission::Bytes(id, greeting.into()));
                Session::Dashboard(dashboard::Session::new(&robot.controller()))
            }
            Port::Primary => script(Feed::Primary),
            Port::Secondary => script(Feed::Secondary),
            Port::Realtime => script(Feed::Realtime),
            Port::Gripper => Session::Gripper(gripper_server::Session::default()),
        };
        if let Session::Script(_, inlet) = &mut session {
            pass_on(id, inlet, &mut self.out);
        }
        self.sessions.insert(id, (port, session));
        Some(id)
    }

    /// Bytes of a client; those for a connection that is over are lost.
    pub fn receive(&mut self, id: ConnectionId, bytes: &[u8]) {
        let Simulator { core, sessions, out, .. } = self;
        let Some((port, session)) = sessions.get_mut(&id) else { return };
        let robot = &core.robot;
        let fine = match session {
            Session::Rtde(session, inlet) => session.receive(robot, bytes).map(|answers| {
                pass_on(id, inlet, out);
                out.extend(answers.into_iter().map(|answer| Transmission::Bytes(id, answer.into())));
                session.answered(robot);
                true
            }),
            Session::Dashboard(session) => session.receive(robot, bytes).map(|replies| {
                if !replies.is_empty() {
                    out.push_back(Transmission::Bytes(id, replies.into_bytes().into()));
                }
                !session.over()
            }),
            Session::Script(session, inlet) => {
                let taken = session.receive(robot, bytes).is_ok();
                pass_on(id, inlet, out);
                Ok(taken)
            }
            Session::Gripper(session) => {
                let state = robot.links.get(port.link()).state();
                session.receive(&mut lock(&core.world), &state, bytes).map(|answers| {
                    if !answers.is_empty() {
                        out.push_back(Transmission::Bytes(id, answers.into()));
                    }
                    true
                })
            }
        };
        if !fine.unwrap_or(false) {
            self.end(id);
        }
    }

    /// The client is gone.
    pub fn hang_up(&mut self, id: ConnectionId) {
        let Some((_, session)) = self.sessions.remove(&id) else { return };
        match session {
            Session::Rtde(session, _) => session.close(&self.core.robot),
            Session::Script(mut session, inlet) => {
                session.finish(&self.core.robot);
                self.core.robot.outlets().close(inlet.id);
            }
            Session::Dashboard(_) | Session::Gripper(_) => {}
        }
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

/// What the controller sends to a connection without being asked.
fn pass_on(id: ConnectionId, inlet: &mut Inlet, out: &mut VecDeque<Transmission>) {
    while let Some(bytes) = inlet.take() {
        out.push_back(Transmission::Bytes(id, bytes));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::world::spec::GripperSpec;
    use nalgebra::Isometry3;

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
