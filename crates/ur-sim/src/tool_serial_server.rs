//! The serial line of the tool connector behind a TCP port (54321), as the forwarder of Universal Robots'
//! Tool Communication URCap offers it, with a VGC10 on it.
//!
//! In: bytes of a client, which go on the line as they are: Modbus RTU frames of unit 65, with the registers
//! of the device behind a Compute Box. Out: its frames. The device has power while the tool voltage is 24 V,
//! and receives what is sent with its own line settings: even parity, one stop bit, at 1,000,000 or 115,200
//! baud, of which sources name both (assumed: either). To everything else it is silent, as it is to other
//! units and wrong checksums. A frame that stops for 50 ms is none. All clients share the line.

use crate::controller::settings::ToolLine;
use crate::core::Core;
use crate::faults::link::LinkState;
use crate::gripper_server;
use crate::motion::FRAMES_PER_SECOND;
use crate::world::lock;
use ur_wire::modbus::Exception;
use ur_wire::modbus_rtu::{SerialLine, answer};

/// Frames without a byte after which a piece of a frame is none.
const SILENCE_FRAMES: u64 = FRAMES_PER_SECOND / 20;

/// Voltage of the device.
const VOLTAGE: i32 = 24;

/// Unit to which all devices listen and none answers.
const EVERYONE: u8 = 0;

/// One client's connection, without its socket.
#[derive(Debug, Default)]
pub struct Session {
    line: SerialLine,
    last_step: u64,
}

impl Session {
    /// Puts what arrived on the line; what the device answers.
    pub fn receive(&mut self, core: &Core, faults: &LinkState, bytes: &[u8]) -> Vec<u8> {
        let (step, heard) = {
            let controller = &core.robot.controller().core;
            let powered = controller.registers.tool_voltage == VOLTAGE;
            (controller.step, powered && controller.settings.tool_line.is_some_and(understood))
        };
        if step > std::mem::replace(&mut self.last_step, step) + SILENCE_FRAMES {
            self.line.silence();
        }
        if !heard {
            self.line.silence();
            return Vec::new();
        }
        self.line.push(bytes);
        let mut world = lock(&core.world);
        let mut answers = Vec::new();
        while let Some(request) = self.line.next_request() {
            if !world.is_on_tool_line() || ![gripper_server::UNIT, EVERYONE].contains(&request.unit) {
                continue;
            }
            let data = match faults.exception.and_then(Exception::from_code) {
                Some(exception) => Err(exception),
                None => gripper_server::carry_out(&mut world, &request),
            };
            if request.unit == gripper_server::UNIT {
                answers.extend(answer(&request, data));
            }
        }
        answers
    }
}

/// The settings of the device.
fn understood(line: ToolLine) -> bool {
    /// `set_tool_communication`: 0 none, 1 odd, 2 even.
    const EVEN: i32 = 2;
    matches!(line.baud, 1_000_000 | 115_200) && line.parity == EVEN && line.stop_bits == 1
}

#[cfg(test)]
mod tests {
    use crate::controller::ControllerConfig;
    use crate::controller::builtins::compile_program;
    use crate::session::Port;
    use crate::simulator::{ConnectionId, Simulator, Transmission};
    use crate::world::drive::Drive;
    use crate::world::lock;
    use crate::world::spec::{GripperSpec, WorldSpec};
    use crate::world::vacuum::{Channel, VacuumMode};
    use nalgebra::Isometry3;
    use ur_wire::modbus_rtu::checksum;

    const GRIP: &[u8] = &[65, 6, 0, 0, 1, 60];
    const VACUUM: &[u8] = &[65, 3, 1, 2, 0, 1];

    fn simulator(drive: Drive, voltage: u8, line: &str) -> (Simulator, Option<ConnectionId>) {
        let gripper = GripperSpec { drive, ..GripperSpec::one_cup(0.2) };
        let world = WorldSpec::bare(Isometry3::translation(-0.75, -0.4, 0.0), gripper);
        let config = ControllerConfig { running: true, ..ControllerConfig::ur5e(1) };
        let mut simulator = Simulator::new(config, world, 1, Vec::new()).unwrap();
        let script = format!(
            "def l():\n set_tool_voltage({voltage})\n set_tool_communication({line}, 1.5, 3.5)\nend\n"
        );
        simulator.core().robot.controller().programs.upload(compile_program(&script));
        (0..5).for_each(|_| simulator.advance());
        let id = simulator.connect(Port::ToolSerial);
        (simulator, id)
    }

    fn request(simulator: &mut Simulator, id: ConnectionId, body: &[u8]) -> Vec<u8> {
        let frame = [body, &checksum(body).to_le_bytes()].concat();
        simulator.receive(id, &frame);
        let sent = std::iter::from_fn(|| simulator.transmit());
        sent.flat_map(|transmission| match transmission {
            Transmission::Bytes(_, bytes) => bytes.to_vec(),
            Transmission::Closed(_) => b"closed".to_vec(),
        })
        .collect()
    }

    #[test]
    fn the_gripper_answers_on_the_tools_serial_line_and_sucks() {
        let (mut simulator, id) = simulator(Drive::Vgc10OnTool, 24, "True, 1000000, 2, 1");
        let id = id.unwrap();
        let echo = request(&mut simulator, id, GRIP);
        assert_eq!(echo[..6], *GRIP);
        assert_eq!(lock(&simulator.core().world).vacuum_command(Channel::A), (VacuumMode::Grip, 0.6));
        (0..500).for_each(|_| simulator.advance());
        let read = request(&mut simulator, id, VACUUM);
        // In the air little vacuum builds up: 12 %.
        let vacuum = u16::from_be_bytes([read[3], read[4]]);
        assert!(read[..3] == [65, 3, 2] && (100..140).contains(&vacuum), "{read:?}");
        assert_eq!(checksum(&read[..5]).to_le_bytes(), read[5..]);
        // All devices listen to unit 0, and none answers.
        assert_eq!(request(&mut simulator, id, &[0, 6, 0, 0, 0, 0]), b"");
        assert_eq!(lock(&simulator.core().world).vacuum_command(Channel::A).0, VacuumMode::Release);
        // The first half of a frame is none once the line was silent.
        simulator.receive(id, &[65, 6, 0, 0]);
        (0..30).for_each(|_| simulator.advance());
        assert_eq!(request(&mut simulator, id, VACUUM)[..3], [65, 3, 2]);
    }

    #[test]
    fn without_power_or_with_other_line_settings_or_units_it_is_silent() {
        for (voltage, line) in [
            (0, "True, 1000000, 2, 1"),
            (12, "True, 1000000, 2, 1"),
            (24, "False, 1000000, 2, 1"),
            (24, "True, 9600, 2, 1"),
            (24, "True, 115200, 0, 1"),
            (24, "True, 115200, 2, 2"),
        ] {
            let (mut simulator, id) = simulator(Drive::Vgc10OnTool, voltage, line);
            assert_eq!(request(&mut simulator, id.unwrap(), GRIP), b"", "{voltage} V, {line}");
            assert_eq!(lock(&simulator.core().world).vacuum_command(Channel::A).0, VacuumMode::Release);
        }
        let (mut simulator, id) = simulator(Drive::Vgc10OnTool, 24, "True, 115200, 2, 1");
        assert_eq!(request(&mut simulator, id.unwrap(), &[66, 6, 0, 0, 1, 60]), b"");
        assert_eq!(request(&mut simulator, id.unwrap(), &[65, 3, 9, 9, 0, 1])[..3], [65, 0x83, 2]);
    }

    #[test]
    fn a_gripper_on_the_tool_has_no_compute_box_and_others_no_serial_line() {
        let (mut simulator, _) = simulator(Drive::Vgc10OnTool, 24, "True, 1000000, 2, 1");
        let modbus = simulator.connect(Port::Gripper).unwrap();
        simulator.receive(modbus, &[0, 1, 0, 0, 0, 6, 65, 3, 1, 2, 0, 1]);
        let refused = [0, 1, 0, 0, 0, 3, 65, 0x83, 0x0b];
        assert_eq!(simulator.transmit(), Some(Transmission::Bytes(modbus, refused.to_vec().into())));
        let (_, id) = self::simulator(Drive::Vgc10, 24, "True, 1000000, 2, 1");
        assert_eq!(id, None);
    }
}
