//! The controller's own Modbus TCP server (port 502) without its sockets.
//!
//! In: requests of any unit number: read coils (0x01) and discrete inputs (0x02), holding (0x03) and input
//! registers (0x04), write coils (0x05, 0x0F) and registers (0x06, 0x10). Out: what the controller's map
//! holds ([`modbus_map`]), or the exceptions of the protocol. Inputs and outputs are the same map, as on the
//! controller. A write of several is carried out as a whole or not at all, between two frames.

use crate::controller::core::Core;
use crate::controller::modbus_map;
use crate::robot_server::shared::RobotShared;
use ur_wire::bytes::WireError;
use ur_wire::modbus::{Adu, Exception, Function, Splitter, coil_bytes, register_bytes};

/// One master's connection, without its socket.
#[derive(Default)]
pub struct Session(Splitter);

impl Session {
    /// Carries out what arrived; the answers.
    ///
    /// # Errors
    /// The bytes are no Modbus TCP; the connection ends.
    pub fn receive(&mut self, shared: &RobotShared, bytes: &[u8]) -> Result<Vec<u8>, WireError> {
        self.0.push(bytes);
        let mut answers = Vec::new();
        while let Some(request) = self.0.next_adu()? {
            let data = answer(&mut shared.controller().core, &request);
            answers.extend(request.answer(data));
        }
        Ok(answers)
    }
}

fn answer(core: &mut Core, request: &Adu) -> Result<Vec<u8>, Exception> {
    let function = request.function()?;
    let range = |first: u16, count: usize| {
        let last = u16::try_from(count.saturating_sub(1)).ok().and_then(|more| first.checked_add(more));
        last.map(|last| first..=last).ok_or(Exception::IllegalAddress)
    };
    match &function {
        Function::Read { first, count } | Function::ReadInputs { first, count } => {
            let values = range(*first, usize::from(*count))?.map(|address| modbus_map::read(core, address));
            let values: Option<Vec<u16>> = values.collect();
            return values.map(|values| register_bytes(&values)).ok_or(Exception::IllegalAddress);
        }
        Function::ReadCoils { first, count } => {
            let bits =
                range(*first, usize::from(*count))?.map(|address| modbus_map::read_coil(core, address));
            let bits: Option<Vec<bool>> = bits.collect();
            return bits.map(|bits| coil_bytes(&bits)).ok_or(Exception::IllegalAddress);
        }
        Function::WriteOne { first, value } => write(core, range(*first, 1)?, &[*value])?,
        Function::WriteMany { first, values } => write(core, range(*first, values.len())?, values)?,
        Function::WriteCoil { first, on } => write_coils(core, range(*first, 1)?, &[*on])?,
        Function::WriteCoils { first, values } => write_coils(core, range(*first, values.len())?, values)?,
    }
    Ok(function.echo())
}

type Range = std::ops::RangeInclusive<u16>;

fn write(core: &mut Core, addresses: Range, values: &[u16]) -> Result<(), Exception> {
    if !addresses.clone().all(modbus_map::writable) {
        return Err(Exception::IllegalAddress);
    }
    if addresses.clone().zip(values).any(|(address, value)| address == 20 && !matches!(value, 0 | 12 | 24)) {
        return Err(Exception::IllegalValue);
    }
    for (address, value) in addresses.zip(values) {
        modbus_map::write(core, address, *value);
    }
    Ok(())
}

fn write_coils(core: &mut Core, addresses: Range, values: &[bool]) -> Result<(), Exception> {
    if !addresses.clone().all(modbus_map::writable_coil) {
        return Err(Exception::IllegalAddress);
    }
    for (address, on) in addresses.zip(values) {
        modbus_map::write_coil(core, address, *on);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::controller::builtins::compile_program;
    use crate::controller::{Controller, ControllerConfig};
    use std::sync::Arc;

    fn shared() -> Arc<RobotShared> {
        let config = ControllerConfig { running: true, ..ControllerConfig::ur5e(1) };
        RobotShared::new(Controller::new(config))
    }

    /// The answer to a request without its header.
    fn answer_to(shared: &RobotShared, pdu: &[u8]) -> Vec<u8> {
        let mut bytes = vec![0, 9, 0, 0, 0, pdu.len() as u8 + 1, 255];
        bytes.extend(pdu);
        let answer = Session::default().receive(shared, &bytes).unwrap();
        assert_eq!(answer[..4], [0, 9, 0, 0]);
        answer[7..].to_vec()
    }

    fn register(shared: &RobotShared, address: u16) -> u16 {
        let [high, low] = address.to_be_bytes();
        let answer = answer_to(shared, &[3, high, low, 0, 1]);
        assert_eq!(answer[..2], [3, 2], "{address}");
        u16::from_be_bytes([answer[2], answer[3]])
    }

    #[test]
    fn outputs_are_written_by_register_by_mask_and_by_coil() {
        let shared = shared();
        assert_eq!(answer_to(&shared, &[6, 0, 1, 0x01, 0x0f]), [6, 0, 1, 0x01, 0x0f]);
        assert_eq!(shared.controller().core.registers.digital_outputs, 1 << 16 | 0xf);
        answer_to(&shared, &[6, 0, 3, 0, 0x03]);
        answer_to(&shared, &[6, 0, 2, 0, 0x80]);
        assert_eq!((register(&shared, 1), register(&shared, 22)), (0x18c, 1));
        // Coils 16 to 18 off, on, on; 136 on: the first configurable output.
        assert_eq!(answer_to(&shared, &[15, 0, 16, 0, 3, 1, 0b110]), [15, 0, 16, 0, 3]);
        answer_to(&shared, &[5, 0, 136, 0xff, 0]);
        assert_eq!((register(&shared, 1), register(&shared, 31)), (0x18e, 1));
        assert_eq!(answer_to(&shared, &[1, 0, 16, 0, 10]), [1, 2, 0x8e, 0x01]);
        shared.controller().core.registers.digital_inputs = 0b1_0000_0010;
        assert_eq!(answer_to(&shared, &[2, 0, 0, 0, 8]), [2, 1, 0b10]);
        assert_eq!((register(&shared, 0), register(&shared, 30)), (2, 1));
    }

    #[test]
    fn registers_are_shared_with_scripts() {
        let shared = shared();
        answer_to(&shared, &[16, 0, 128, 0, 2, 4, 0xff, 0xfe, 0, 7]);
        answer_to(&shared, &[5, 1, 44, 0xff, 0]);
        let script = "def p():\n textmsg(read_port_register(128), read_port_register(129))\n \
                      textmsg(read_port_bit(300))\n write_port_register(130, 300)\n write_port_bit(17, \
                      True)\n write_output_boolean_register(3, True)\nend\n";
        shared.controller().programs.upload(compile_program(script));
        shared.frame(None);
        let controller = shared.controller();
        assert!(controller.core.registers.input_bits[0]);
        drop(controller);
        assert_eq!(register(&shared, 130), 300);
        assert_eq!(register(&shared, 1), 2);
        assert_eq!(answer_to(&shared, &[1, 1, 247, 0, 1]), [1, 1, 1], "output register 3 is coil 503");
    }

    #[test]
    fn state_and_pose_are_where_the_map_has_them() {
        let shared = shared();
        shared.controller().core.mover.place(cell_values::units::Joints([-0.5, -1.0, 1.0, -1.5, -1.57, 6.2]));
        shared.controller().protective_stop("test");
        shared.frame(None);
        assert_eq!([256, 257, 258, 260, 261, 262, 266].map(|a| register(&shared, a)), [5, 26, 7, 1, 1, 0, 3]);
        assert_eq!([270, 275, 320, 325].map(|a| register(&shared, a)), [5783, 6200, 0xffff, 0]);
        assert_eq!([310, 300].map(|a| register(&shared, a)), [253, 35]);
        let pose = shared.controller().core.tcp_pose();
        let signed = |address| f64::from(register(&shared, address).cast_signed());
        for axis in 0..3 {
            assert!((signed(400 + axis) / 1e4 - pose[usize::from(axis)]).abs() < 1e-4);
            assert!((signed(403 + axis) / 1e3 - pose[3 + usize::from(axis)]).abs() < 1e-3);
        }
        answer_to(&shared, &[6, 8, 0, 0, 1]);
        assert_eq!([2050, 2051].map(|a| register(&shared, a)), [41, 0]);
    }

    #[test]
    fn what_is_not_there_is_an_exception_and_changes_nothing() {
        let shared = shared();
        for (request, exception) in [
            (&[3, 2, 0, 0, 1][..], [0x83, 2]),
            (&[3, 0xff, 0xff, 0, 2], [0x83, 2]),
            (&[6, 0, 0, 0, 1], [0x86, 2]),
            (&[16, 0, 1, 0, 4, 8, 0, 1, 0, 0, 0, 0, 0, 0], [0x90, 2]),
            (&[6, 0, 20, 0, 13], [0x86, 3]),
            (&[5, 0, 16, 1, 0], [0x85, 3]),
            (&[5, 1, 244, 0xff, 0], [0x85, 2]),
            (&[15, 0, 16, 0, 9, 1, 1], [0x8f, 3]),
            (&[23, 0, 0, 0, 1], [0x97, 1]),
        ] {
            assert_eq!(answer_to(&shared, request), exception, "{request:?}");
        }
        assert_eq!(shared.controller().core.registers.digital_outputs, 0);
        assert!(Session::default().receive(&shared, &[0, 1, 0, 1, 0, 6, 1]).is_err());
    }
}
