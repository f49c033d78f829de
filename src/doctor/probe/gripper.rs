//! The gripper's registers over Modbus, and the maker's service where it runs.
//!
//! In: the configuration. Out: [`GripperFacts`]. Nothing is written to the device.

use crate::config::cell::{CellConfig, Devices};
use crate::config::sessions::gripper_address;
use crate::daemon::sockets::{exchange, resolve};
use crate::doctor::gripper::{Confirmed, GripperFacts, Product};
use crate::jobs::state::StateFolder;
use cell_machine::device::gripper::vacuum_of;
use cell_machine::device::gripper_types::{
    CONTROL, FIRMWARE, ModbusFailure, ModbusRequest, PRODUCT, SERIAL, SERIAL_COUNT, VACUUM,
};
use std::time::Duration;
use tokio_modbus::prelude::Slave;

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
    let Registers { vacuum, control, product } = registers(devices);
    let confirmed = match config.simulation {
        Some(_) => Some(Confirmed::Simulation),
        None => state.gripper_confirmed(&address).then_some(Confirmed::ByPerson),
    };
    let service = service(devices);
    GripperFacts { address, vacuum, control, product, service, confirmed, daemon: false }
}

/// What is read of the device. Beside the vacuum only what it gives out.
struct Registers {
    vacuum: Result<[f64; 2], ModbusFailure>,
    control: Option<[u16; 2]>,
    product: Option<Product>,
}

fn registers(devices: &Devices) -> Registers {
    let unread =
        |cause| Registers { vacuum: Err(ModbusFailure::Connection(cause)), control: None, product: None };
    let address = match resolve(&devices.gripper_host, devices.gripper_port) {
        Ok(address) => address,
        Err(cause) => return unread(cause),
    };
    let runtime = match tokio::runtime::Builder::new_current_thread().enable_all().build() {
        Ok(runtime) => runtime,
        Err(error) => return unread(error.to_string()),
    };
    let unit = Slave(devices.gripper_unit);
    runtime.block_on(async {
        let mut connection = None;
        let mut read = async |first, count| {
            let request = ModbusRequest::Read { address: first, count };
            let exchange = exchange(&mut connection, (address, unit), request, &|_| {});
            tokio::time::timeout(ANSWER_WITHIN, exchange).await.unwrap_or(Err(ModbusFailure::Timeout))
        };
        let vacuum = read(VACUUM, 2).await.and_then(|words| vacuum_of(&words));
        // After a failure without an answer the next read would wait as long again.
        if matches!(vacuum, Err(ModbusFailure::Timeout | ModbusFailure::Connection(_))) {
            return Registers { vacuum, control: None, product: None };
        }
        let control = read(CONTROL, 2).await.ok().and_then(|words| words.try_into().ok());
        let code = read(PRODUCT, 1).await.ok().and_then(|words| words.first().copied());
        let firmware = read(FIRMWARE, 2).await.ok().and_then(|words| words.try_into().ok());
        let serial = read(SERIAL, SERIAL_COUNT).await.ok();
        let product = code.map(|code| Product { code, firmware, serial });
        Registers { vacuum, control, product }
    })
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

    #[test]
    fn an_answer_of_the_service_is_a_boolean_or_nothing() {
        let answer = |value: &str| format!("<methodResponse><params><param><value>{value}</value>");
        assert_eq!(connected(&answer("<boolean>1</boolean>")), Some(true));
        assert_eq!(connected(&answer("<boolean>0</boolean>")), Some(false));
        assert_eq!(connected(&answer("<int>4</int>")), None);
        assert_eq!(connected(""), None);
    }
}
