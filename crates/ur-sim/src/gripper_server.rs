//! The gripper's Modbus TCP server without its sockets: the registers of a vacuum gripper behind its compute
//! box.
//!
//! In: requests of unit 65: read holding registers (0x03), write one (0x06) or several (0x10), from one
//! client at a time (`compute_box`). Out: register values, or the exceptions the protocol has for what
//! the device does not offer. Registers: 0 and 1 control of channels A and B (high byte 0 release, 1
//! grip, 2 idle; low byte target in per cent, more than 80 is taken as 80), 2 current limit in mA (up to
//! 1000); read only: 258 and 259 relative vacuum in per mille, 1536 product code, 1540 and 1541 firmware,
//! 1545 to 1560 serial number. How firmware and serial number are laid out is not published; ours are
//! made up. A lost connection leaves the last command active, as on the device. Source: Connectivity
//! Guide, reference drivers of the device; the answer to other units, and that of every unit where
//! another gripper is on the hand (exception 0x0B), is our choice.

use crate::faults::link::LinkState;
use crate::world::World;
use crate::world::vacuum::{Channel, HIGHEST_TARGET, VacuumMode};
use ur_wire::bytes::WireError;
use ur_wire::modbus::{Adu, Exception, Function, Splitter, register_bytes};

/// The unit number the device answers to.
pub const UNIT: u8 = 65;
/// Control of channel A; B follows.
pub const CONTROL_REGISTER: u16 = 0;
/// Current limit, mA.
pub const CURRENT_LIMIT_REGISTER: u16 = 2;
/// Relative vacuum of channel A, per mille; B follows.
pub const VACUUM_REGISTER: u16 = 258;
/// Product code, that of a VGC10; firmware; serial number, two characters a register.
const PRODUCT_REGISTER: u16 = 1536;
const PRODUCT: u16 = 0x11;
const FIRMWARE_REGISTERS: std::ops::RangeInclusive<u16> = 1540..=1541;
const FIRMWARE: [u16; 2] = [1, 0];
const SERIAL_REGISTERS: std::ops::RangeInclusive<u16> = 1545..=1560;
const SERIAL: &[u8; 32] = b"sim-vgc10\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0";
/// Highest current limit, mA.
const HIGHEST_CURRENT_MA: u16 = 1000;

/// One master's connection, without its socket.
#[derive(Debug, Default)]
pub struct Session {
    splitter: Splitter,
}

impl Session {
    /// Carries out what arrived; the answers.
    ///
    /// # Errors
    /// The bytes are no Modbus TCP; the connection ends.
    pub fn receive(
        &mut self,
        world: &mut World,
        faults: &LinkState,
        bytes: &[u8],
    ) -> Result<Vec<u8>, WireError> {
        self.splitter.push(bytes);
        let mut answers = Vec::new();
        while let Some(mut request) = self.splitter.next_adu()? {
            let data = match faults.exception.and_then(Exception::from_code) {
                Some(exception) => Err(exception),
                None => answer(world, &request),
            };
            if faults.wrong_transaction {
                request.transaction = request.transaction.wrapping_add(1);
            }
            answers.extend(request.answer(data));
        }
        Ok(answers)
    }
}

fn answer(world: &mut World, request: &Adu) -> Result<Vec<u8>, Exception> {
    if request.unit != UNIT || !world.has_compute_box() {
        return Err(Exception::NoTarget);
    }
    carry_out(world, request)
}

/// Carries out a request to the device, however it came to it; the data of the answer.
///
/// # Errors
/// The exception to answer with.
pub fn carry_out(world: &mut World, request: &Adu) -> Result<Vec<u8>, Exception> {
    let function = request.function()?;
    match &function {
        Function::Read { first, count } => return Ok(register_bytes(&read(world, *first, *count)?)),
        Function::WriteOne { first, value } => write(world, *first, &[*value])?,
        Function::WriteMany { first, values } => write(world, *first, values)?,
        _ => return Err(Exception::IllegalFunction),
    }
    Ok(function.echo())
}

fn addresses(first: u16, count: usize) -> Result<impl Iterator<Item = u16>, Exception> {
    let last = u16::try_from(count.saturating_sub(1)).ok().and_then(|more| first.checked_add(more));
    let last = last.ok_or(Exception::IllegalAddress)?;
    Ok(first..=last)
}

fn read(world: &World, first: u16, count: u16) -> Result<Vec<u16>, Exception> {
    addresses(first, usize::from(count))?
        .map(|address| match address {
            CURRENT_LIMIT_REGISTER => Ok(world.current_limit_ma()),
            _ => match (control_channel(address), vacuum_channel(address)) {
                (Some(channel), _) => Ok(control_word(world, channel)),
                (_, Some(channel)) => Ok(world.vacuum_reading_per_mille(channel)),
                (None, None) => identity_word(address).ok_or(Exception::IllegalAddress),
            },
        })
        .collect()
}

/// What the device says of itself.
fn identity_word(address: u16) -> Option<u16> {
    let place = |first: u16| usize::from(address - first);
    if address == PRODUCT_REGISTER {
        Some(PRODUCT)
    } else if FIRMWARE_REGISTERS.contains(&address) {
        FIRMWARE.get(place(*FIRMWARE_REGISTERS.start())).copied()
    } else if SERIAL_REGISTERS.contains(&address) {
        let (pairs, _) = SERIAL.as_chunks::<2>();
        pairs.get(place(*SERIAL_REGISTERS.start())).map(|pair| u16::from_be_bytes(*pair))
    } else {
        None
    }
}

/// Writes all or nothing: every value is checked before the first takes effect.
fn write(world: &mut World, first: u16, values: &[u16]) -> Result<(), Exception> {
    for (address, value) in addresses(first, values.len())?.zip(values) {
        match (address, control_channel(address)) {
            (_, Some(_)) => drop(mode_of(*value)?),
            (CURRENT_LIMIT_REGISTER, None) if *value <= HIGHEST_CURRENT_MA => {}
            (CURRENT_LIMIT_REGISTER, None) => return Err(Exception::IllegalValue),
            _ => return Err(Exception::IllegalAddress),
        }
    }
    for (address, value) in addresses(first, values.len())?.zip(values) {
        match control_channel(address) {
            Some(channel) => {
                let target = (f64::from(value & 0xff) / 100.0).min(HIGHEST_TARGET);
                world.command_vacuum(channel, mode_of(*value)?, target);
            }
            None => world.set_current_limit_ma(*value),
        }
    }
    Ok(())
}

fn mode_of(word: u16) -> Result<VacuumMode, Exception> {
    match word >> 8 {
        0 => Ok(VacuumMode::Release),
        1 => Ok(VacuumMode::Grip),
        2 => Ok(VacuumMode::Idle),
        _ => Err(Exception::IllegalValue),
    }
}

fn control_word(world: &World, channel: Channel) -> u16 {
    let (mode, target) = world.vacuum_command(channel);
    let mode = match mode {
        VacuumMode::Release => 0u16,
        VacuumMode::Grip => 1,
        VacuumMode::Idle => 2,
    };
    mode << 8 | (target * 100.0).round() as u16
}

fn control_channel(address: u16) -> Option<Channel> {
    Channel::ALL.into_iter().find(|channel| address == CONTROL_REGISTER + channel.index() as u16)
}

fn vacuum_channel(address: u16) -> Option<Channel> {
    Channel::ALL.into_iter().find(|channel| address == VACUUM_REGISTER + channel.index() as u16)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::controller::{Controller, ControllerConfig};
    use crate::core::Core;
    use crate::serve::{Servers, listen};
    use crate::session::Port;
    use crate::world::{SharedWorld, empty_world, lock};
    use nalgebra::Isometry3;
    use std::net::{Ipv4Addr, SocketAddr};
    use std::time::Duration;
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    use tokio::net::TcpStream;
    use tokio::sync::watch;
    use tokio_modbus::client::{Context, Reader, Writer, tcp};
    use tokio_modbus::prelude::{ExceptionCode, Slave};
    use tokio_modbus::slave::SlaveContext;

    async fn started() -> (SocketAddr, SharedWorld, watch::Sender<bool>) {
        let core = Core::new(Controller::new(ControllerConfig::ur5e(1)), empty_world(5), 1.0);
        let door = listen("gripper", Ipv4Addr::LOCALHOST.into(), 0).await.unwrap();
        let (address, (sender, shutdown)) = (door.1, watch::channel(false));
        Servers::default().take(door, &core, Port::Gripper, &shutdown);
        (address, core.world, sender)
    }

    async fn client(address: SocketAddr) -> Context {
        tcp::connect_slave(address, Slave(UNIT)).await.unwrap()
    }

    fn run(world: &SharedWorld, frames: u64) {
        for frame in 0..frames {
            lock(world).step(frame as f64 * 0.002, 0.002, &Isometry3::identity());
        }
    }

    #[tokio::test]
    async fn grip_is_written_and_the_leaking_vacuum_read_back() {
        let (address, world, _running) = started().await;
        let mut client = client(address).await;
        client.write_multiple_registers(0, &[0x013C, 0x0200]).await.unwrap().unwrap();
        assert_eq!(lock(&world).vacuum_command(Channel::A), (VacuumMode::Grip, 0.6));
        assert_eq!(lock(&world).vacuum_command(Channel::B), (VacuumMode::Idle, 0.0));
        run(&world, 1000);
        let vacuum = client.read_holding_registers(258, 2).await.unwrap().unwrap();
        assert!((112..=128).contains(&vacuum[0]) && vacuum[1] <= 8, "{vacuum:?}");
        assert_eq!(client.read_holding_registers(0, 3).await.unwrap().unwrap(), [0x013C, 0x0200, 500]);
        assert_eq!(client.read_holding_registers(1536, 1).await.unwrap().unwrap(), [0x11]);
        assert_eq!(client.read_holding_registers(1545, 2).await.unwrap().unwrap(), [0x7369, 0x6d2d]);
        assert_eq!(client.read_holding_registers(1545, 16).await.unwrap().unwrap().len(), 16);
        client.write_single_register(2, 900).await.unwrap().unwrap();
        client.write_single_register(1, 0x01FF).await.unwrap().unwrap();
        assert_eq!(client.read_holding_registers(1, 2).await.unwrap().unwrap(), [0x0150, 900]);
    }

    #[tokio::test]
    async fn what_the_device_does_not_offer_is_an_exception_and_changes_nothing() {
        let (address, world, _running) = started().await;
        let mut client = client(address).await;
        let bad_value = Err(ExceptionCode::IllegalDataValue);
        let bad_address = Err(ExceptionCode::IllegalDataAddress);
        assert_eq!(client.write_multiple_registers(0, &[0x013C, 0x0300]).await.unwrap(), bad_value);
        assert_eq!(lock(&world).vacuum_command(Channel::A), (VacuumMode::Release, 0.0));
        assert_eq!(client.write_single_register(2, 1001).await.unwrap(), bad_value);
        assert_eq!(client.write_single_register(258, 1).await.unwrap(), bad_address);
        assert_eq!(client.write_multiple_registers(1, &[0, 500, 0]).await.unwrap(), bad_address);
        assert_eq!(client.read_holding_registers(257, 2).await.unwrap().map(drop), bad_address);
        assert_eq!(client.read_holding_registers(65535, 2).await.unwrap().map(drop), bad_address);
        assert_eq!(client.read_coils(0, 1).await.unwrap().map(drop), Err(ExceptionCode::IllegalFunction));
        client.set_slave(Slave(66));
        let refused = client.read_holding_registers(0, 1).await.unwrap().map(drop);
        assert_eq!(refused, Err(ExceptionCode::GatewayTargetDevice));
    }

    /// Whether the box has closed the connection before it answered.
    async fn is_turned_away(address: SocketAddr) -> bool {
        let mut stream = TcpStream::connect(address).await.unwrap();
        // With a request on its way the end may be a reset.
        let _ = stream.write_all(&[0, 1, 0, 0, 0, 6, UNIT, 3, 0, 2, 0, 1]).await;
        let read = tokio::time::timeout(Duration::from_secs(20), stream.read_exact(&mut [0; 1])).await;
        read.expect("an answer or the end").is_err()
    }

    #[tokio::test]
    async fn a_second_client_is_turned_away_until_the_first_has_gone() {
        let (address, _world, _running) = started().await;
        let mut first = client(address).await;
        assert_eq!(first.read_holding_registers(2, 1).await.unwrap().unwrap(), [500]);
        for _ in 0..100 {
            assert!(is_turned_away(address).await);
        }
        assert_eq!(first.read_holding_registers(2, 1).await.unwrap().unwrap(), [500]);
        drop(first);
        while is_turned_away(address).await {}
    }

    #[tokio::test]
    async fn garbage_ends_only_its_own_connection() {
        let (address, _world, _running) = started().await;
        let mut raw = TcpStream::connect(address).await.unwrap();
        raw.write_all(&[0xff; 64]).await.unwrap();
        raw.shutdown().await.unwrap();
        let mut rest = Vec::new();
        // The server may reset the connection with bytes of ours unread: that is an end, too.
        drop(raw.read_to_end(&mut rest).await);
        assert!(rest.is_empty());
        let mut client = client(address).await;
        assert_eq!(client.read_holding_registers(2, 1).await.unwrap().unwrap(), [500]);
    }
}
