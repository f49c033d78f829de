//! The gripper's registers over Modbus, and the maker's service where it runs.
//!
//! In: the configuration. Out: [`GripperFacts`]. Nothing is written to the device.

use crate::config::cell::{CellConfig, Devices};
use crate::config::sessions::gripper_address;
use crate::daemon::sockets::resolve;
use crate::doctor::gripper::GripperFacts;
use crate::jobs::state::StateFolder;
use cell_machine::device::gripper::vacuum_of;
use cell_machine::device::gripper_identity::MISSING;
use cell_machine::device::gripper_types::{
    CONTROL, FIRMWARE, Identity, ModbusFailure, ModbusRequest, PRODUCT, SERIAL, SERIAL_COUNT, VACUUM,
};
use cell_machine::device::modbus::{Answers, request_bytes};
use cell_machine::orders::ConfirmedGripper;
use std::io::{Error, ErrorKind, Read, Write};
use std::net::TcpStream;
use std::time::Duration;

/// For one answer.
const ANSWER_WITHIN: Duration = Duration::from_secs(2);
/// The maker's XML-RPC service (reference: ur-interfaces 7.3).
const SERVICE_PORT: u16 = 41414;
/// Its question whether a VGC10 (0x11) is the first tool.
const QUESTION: &str = "<?xml version=\"1.0\"?><methodCall><methodName>cb_is_device_connected</methodName><params>\
     <param><value><int>0</int></value></param><param><value><int>17</int></value></param></params></methodCall>";
/// Longest answer read, bytes.
const ANSWER_MAX: u64 = 64 * 1024;

/// Looks at the gripper of the configuration.
pub fn facts(config: &CellConfig, state: &StateFolder) -> GripperFacts {
    let devices = &config.devices;
    let address = gripper_address(devices);
    let Registers { vacuum, control, identity } = read_registers(devices);
    let confirmed = match config.simulation {
        Some(_) => ConfirmedGripper::NotNeeded,
        None => state.confirmed_gripper(&address),
    };
    let service = service(devices);
    GripperFacts { address, vacuum, control, identity, service, confirmed, daemon: false }
}

/// What is read of the device. Beside the vacuum only what it gives out.
struct Registers {
    vacuum: Result<[f64; 2], ModbusFailure>,
    control: Option<[u16; 2]>,
    identity: Result<Identity, ModbusFailure>,
}

fn read_registers(devices: &Devices) -> Registers {
    let unread = |failure: ModbusFailure| Registers {
        vacuum: Err(failure.clone()),
        control: None,
        identity: Err(failure),
    };
    let mut line = match Line::open(devices) {
        Ok(line) => line,
        Err(failure) => return unread(failure),
    };
    let vacuum = line.read(VACUUM, 2).and_then(|words| vacuum_of(&words));
    // After a failure without an answer the next read would wait as long again.
    if let Err(failure) = vacuum.clone()
        && !matches!(failure, ModbusFailure::Exception(_))
    {
        return unread(failure);
    }
    let control = line.read(CONTROL, 2).ok().and_then(|words| words.try_into().ok());
    Registers { vacuum, control, identity: identity(&mut line) }
}

/// Product, firmware and serial number. The device may lack these registers. A failed read is an error:
/// without its serial number a gripper cannot be compared with the confirmed one.
fn identity(line: &mut Line) -> Result<Identity, ModbusFailure> {
    let mut given_out = |address, count| match line.read(address, count) {
        Ok(words) => Ok(words),
        Err(ModbusFailure::Exception(code)) if MISSING.contains(&code) => Ok(Vec::new()),
        Err(failure) => Err(failure),
    };
    let product = given_out(PRODUCT, 1)?.first().copied();
    let firmware = given_out(FIRMWARE, 2)?.try_into().ok();
    let serial = given_out(SERIAL, SERIAL_COUNT)?.try_into().ok();
    Ok(Identity { product, firmware, serial })
}

/// A connection that waits for each answer.
struct Line {
    stream: TcpStream,
    unit: u8,
    transaction: u16,
    answers: Answers,
    answered: bool,
}

impl Line {
    fn open(devices: &Devices) -> Result<Line, ModbusFailure> {
        let address =
            resolve(&devices.gripper_host, devices.gripper_port).map_err(ModbusFailure::Connection)?;
        let stream = TcpStream::connect_timeout(&address, ANSWER_WITHIN).map_err(|error| {
            match error.kind() {
                // No connection was made.
                ErrorKind::TimedOut => ModbusFailure::Timeout,
                _ => failure(&error, false),
            }
        })?;
        stream.set_read_timeout(Some(ANSWER_WITHIN)).map_err(|error| failure(&error, false))?;
        let unit = devices.gripper_unit;
        Ok(Line { stream, unit, transaction: 0, answers: Answers::default(), answered: false })
    }

    fn read(&mut self, address: u16, count: u16) -> Result<Vec<u16>, ModbusFailure> {
        self.exchange(&ModbusRequest::Read { address, count })
    }

    fn exchange(&mut self, request: &ModbusRequest) -> Result<Vec<u16>, ModbusFailure> {
        self.transaction += 1;
        let bytes = request_bytes(self.transaction, self.unit, request);
        self.stream.write_all(&bytes).map_err(|error| failure(&error, self.answered))?;
        let mut buffer = [0; 512];
        loop {
            if let Some(answer) = self.answers.next_answer()? {
                self.answered = true;
                // An earlier request may be answered late.
                if answer.transaction == self.transaction {
                    return answer.words(request);
                }
                continue;
            }
            match self.stream.read(&mut buffer) {
                Ok(0) => return Err(failure(&ErrorKind::ConnectionReset.into(), self.answered)),
                Ok(count) => self.answers.push(buffer.get(..count).unwrap_or_default()),
                Err(error) => return Err(failure(&error, self.answered)),
            }
        }
    }
}

/// An error of a connection on which something was `answered`, or nothing yet.
fn failure(error: &Error, answered: bool) -> ModbusFailure {
    match error.kind() {
        ErrorKind::WouldBlock | ErrorKind::TimedOut if !answered => ModbusFailure::Unserved,
        ErrorKind::WouldBlock | ErrorKind::TimedOut => ModbusFailure::Timeout,
        ErrorKind::ConnectionRefused => ModbusFailure::Refused,
        ErrorKind::ConnectionReset | ErrorKind::BrokenPipe if !answered => ModbusFailure::Taken,
        _ => ModbusFailure::Connection(error.to_string()),
    }
}

/// What the maker's service says, at the gripper's host or the controller's.
fn service(devices: &Devices) -> Option<(String, Option<bool>)> {
    let mut hosts = vec![devices.gripper_host.clone(), devices.robot_host.clone()];
    hosts.dedup();
    let config = ureq::Agent::config_builder().timeout_global(Some(ANSWER_WITHIN)).proxy(None).build();
    let agent = ureq::Agent::new_with_config(config);
    hosts.into_iter().find_map(|host| {
        let posted = agent.post(format!("http://{host}:{SERVICE_PORT}/")).content_type("text/xml");
        let mut answer = posted.send(QUESTION).ok()?;
        let text = answer.body_mut().with_config().limit(ANSWER_MAX).read_to_string().unwrap_or_default();
        Some((host, connected(&text)))
    })
}

/// The boolean of an XML-RPC answer; `None` where it is something else, a fault for example.
fn connected(text: &str) -> Option<bool> {
    match (text.contains("<boolean>1</boolean>"), text.contains("<boolean>0</boolean>")) {
        (true, false) => Some(true),
        (false, true) => Some(false),
        (true, true) | (false, false) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::TcpListener;
    use ur_wire::modbus::Splitter;

    #[test]
    fn an_answer_of_the_service_is_a_boolean_or_nothing() {
        let answer = |value: &str| format!("<methodResponse><params><param><value>{value}</value>");
        assert_eq!(connected(&answer("<boolean>1</boolean>")), Some(true));
        assert_eq!(connected(&answer("<boolean>0</boolean>")), Some(false));
        assert_eq!(connected(&answer("<int>4</int>")), None);
        assert_eq!(connected(""), None);
    }

    /// A line to a device that answers so many requests with zeros, and then ends the connection.
    fn line_to_a_device(answers: usize) -> Line {
        let device = TcpListener::bind("127.0.0.1:0").expect("a port");
        let address = device.local_addr().expect("its address");
        std::thread::spawn(move || {
            let (mut stream, _) = device.accept().expect("a client");
            let mut splitter = Splitter::default();
            let mut buffer = [0; 512];
            for _ in 0..answers {
                let request = loop {
                    if let Some(request) = splitter.next_adu().expect("Modbus") {
                        break request;
                    }
                    let count = stream.read(&mut buffer).expect("a request");
                    splitter.push(&buffer[..count]);
                };
                let registers = usize::from(request.pdu[4]);
                let data = [vec![2 * registers as u8], vec![0; 2 * registers]].concat();
                stream.write_all(&request.answer(Ok(data))).expect("a reader");
            }
        });
        let stream = TcpStream::connect(address).expect("the device");
        Line { stream, unit: 65, transaction: 0, answers: Answers::default(), answered: false }
    }

    #[test]
    fn an_unread_serial_number_is_reported_as_a_failure() {
        assert!(identity(&mut line_to_a_device(2)).is_err());
        let all = identity(&mut line_to_a_device(3)).expect("all parts are answered");
        assert_eq!((all.product, all.serial_text()), (Some(0), None));
    }

    #[test]
    fn a_box_that_takes_the_connection_and_answers_nothing_is_named() {
        let silent = TcpListener::bind("127.0.0.1:0").expect("a port");
        let stream = TcpStream::connect(silent.local_addr().expect("its address")).expect("a place in line");
        stream.set_read_timeout(Some(Duration::from_millis(50))).expect("a socket");
        let mut line =
            Line { stream, unit: 65, transaction: 0, answers: Answers::default(), answered: false };
        assert_eq!(line.read(VACUUM, 2), Err(ModbusFailure::Unserved));
    }
}
