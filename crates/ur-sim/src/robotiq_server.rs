//! The socket of the Robotiq grippers' URCap (63352), without its sockets: registers by name.
//!
//! In: lines `SET NAME VALUE [NAME VALUE ...]` and `GET NAME`. Out: `ack` without a line end, as scripts
//! read three bytes, and `NAME VALUE` with one. What is no such line is answered `?` (assumed); of a SET
//! with an unknown name nothing is carried out. A client that goes leaves the fingers as they are.

use crate::world::World;
use ur_wire::bytes::WireError;
use ur_wire::dashboard::LineSplitter;

/// Most registers that one line may set.
const MAX_PAIRS: usize = 16;

/// One connection.
#[derive(Default)]
pub struct Session(LineSplitter);

impl Session {
    /// Carries out what arrived; the answers.
    ///
    /// # Errors
    /// A line without an end; the connection ends.
    pub fn receive(&mut self, world: &mut World, bytes: &[u8]) -> Result<String, WireError> {
        self.0.push(bytes);
        let mut answers = String::new();
        while let Some(line) = self.0.next_line()? {
            let words: Vec<&str> = line.split_whitespace().collect();
            match words[..] {
                [] => {}
                ["GET", name] => answers.push_str(&read(world, name)),
                ["SET", ref pairs @ ..] if write(world, pairs) => answers.push_str("ack"),
                _ => answers.push_str("?\n"),
            }
        }
        Ok(answers)
    }
}

fn read(world: &World, name: &str) -> String {
    match world.finger_register(name) {
        // Two digits: some clients read it as text.
        Some(value) if name == "FLT" => format!("FLT {value:02}\n"),
        Some(value) => format!("{name} {value}\n"),
        None => "?\n".to_owned(),
    }
}

/// Sets registers in the order of the line; false, and nothing set, if something is wrong with it.
fn write(world: &mut World, words: &[&str]) -> bool {
    let mut pairs = Vec::new();
    for pair in words.chunks(2) {
        let [name, value] = pair else { return false };
        let Ok(value) = value.parse::<f64>() else { return false };
        // Out of range counts as the nearest; what is no number counts as 0.
        pairs.push((*name, value.clamp(0.0, 255.0) as u8));
    }
    let known = |name: &str| {
        matches!(name, "ACT" | "GTO" | "POS" | "SPE" | "FOR" | "ATR" | "ADR" | "ARD") && world.has_fingers()
    };
    let sound = (1..=MAX_PAIRS).contains(&pairs.len()) && pairs.iter().all(|(name, _)| known(name));
    sound && pairs.into_iter().all(|(name, value)| world.set_finger_register(name, value))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::controller::{Controller, ControllerConfig};
    use crate::core::Core;
    use crate::session::Port;
    use crate::simulator::{Simulator, Transmission};
    use crate::world::drive::{Drive, FingersSpec};
    use crate::world::spec::{GripperSpec, WorldSpec};
    use crate::world::{empty_world, lock};
    use nalgebra::Isometry3;
    use proptest::prelude::*;

    fn spec() -> WorldSpec {
        let drive = Drive::Fingers(FingersSpec::ROBOTIQ_2F85);
        let gripper = GripperSpec { drive, cups: Vec::new(), ..GripperSpec::one_cup(0.2) };
        WorldSpec::bare(Isometry3::translation(-0.75, -0.4, 0.0), gripper)
    }

    fn simulator() -> Simulator {
        Simulator::new(ControllerConfig::ur5e(1), spec(), 1, Vec::new()).unwrap()
    }

    /// What a line is answered.
    fn request(simulator: &mut Simulator, id: crate::simulator::ConnectionId, line: &str) -> String {
        simulator.receive(id, line.as_bytes());
        let sent = std::iter::from_fn(|| simulator.transmit());
        let bytes: Vec<u8> = sent
            .flat_map(|transmission| match transmission {
                Transmission::Bytes(_, bytes) => bytes.to_vec(),
                Transmission::Closed(_) => b"closed".to_vec(),
            })
            .collect();
        String::from_utf8(bytes).unwrap()
    }

    #[test]
    fn a_published_clients_calls_activate_and_calibrate_the_gripper() {
        let mut simulator = simulator();
        let id = simulator.connect(Port::Robotiq).unwrap();
        let wait = |simulator: &mut Simulator, name: &str, value: &str| {
            let wanted = format!("{name} {value}\n");
            (0..3000).any(|_| {
                simulator.advance();
                request(simulator, id, &format!("GET {name}\n")) == wanted
            })
        };
        assert_eq!(request(&mut simulator, id, "GET STA\n"), "STA 0\n");
        assert_eq!(request(&mut simulator, id, "SET ACT 0\nSET ATR 0\n"), "ackack");
        assert_eq!(request(&mut simulator, id, "SET ACT 1\n"), "ack");
        assert!(wait(&mut simulator, "STA", "3"));
        for (wanted, reached) in [(0, 3), (255, 227), (0, 3)] {
            let line = format!("SET POS {wanted} SPE 64 FOR 1 GTO 1\n");
            assert_eq!(request(&mut simulator, id, &line), "ack");
            assert_eq!(request(&mut simulator, id, "GET PRE\nGET OBJ\n"), format!("PRE {wanted}\nOBJ 0\n"));
            assert!(wait(&mut simulator, "OBJ", "3"));
            assert_eq!(request(&mut simulator, id, "GET POS\n"), format!("POS {reached}\n"));
        }
        assert_eq!(request(&mut simulator, id, "GET FLT\r\n"), "FLT 00\n");
    }

    #[test]
    fn lines_that_are_none_are_answered_and_change_nothing() {
        let mut simulator = simulator();
        let id = simulator.connect(Port::Robotiq).unwrap();
        for line in
            ["GET FMT", "GET", "SET", "SET POS", "SET POS 1 NOPE 2", "SET POS x", "SET STA 3", "HELLO"]
        {
            assert_eq!(request(&mut simulator, id, &format!("{line}\n")), "?\n", "{line}");
        }
        assert_eq!(request(&mut simulator, id, "GET PRE\n"), "PRE 0\n");
        assert_eq!(request(&mut simulator, id, "SET POS 300\nGET PRE\n"), "ackPRE 255\n");
        assert_eq!(request(&mut simulator, id, &"x".repeat(100_000)), "closed");
    }

    #[test]
    fn other_grippers_have_no_such_registers_and_this_one_no_compute_box() {
        let core = Core::new(Controller::new(ControllerConfig::ur5e(1)), empty_world(5), 1.0);
        let answers = Session::default().receive(&mut lock(&core.world), b"GET POS\nSET POS 1\n").unwrap();
        assert_eq!(answers, "?\n?\n");
        let mut simulator = simulator();
        let gripper = simulator.connect(Port::Gripper).unwrap();
        simulator.receive(gripper, &[0, 1, 0, 0, 0, 6, 65, 3, 1, 2, 0, 1]);
        let refused = [0, 1, 0, 0, 0, 3, 65, 0x83, 0x0b];
        assert_eq!(simulator.transmit(), Some(Transmission::Bytes(gripper, refused.to_vec().into())));
    }

    proptest! {
        #[test]
        fn no_bytes_break_it(text in "((SET|GET)( (POS|ACT|GTO|ATR|x)( [-0-9a-z.]{0,5})?){0,4}\n){0,4}") {
            let mut simulator = simulator();
            let id = simulator.connect(Port::Robotiq).unwrap();
            simulator.receive(id, text.as_bytes());
            simulator.advance();
        }
    }
}
