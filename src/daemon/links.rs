//! Sockets that reconnect: three TCP links to the controller, one Modbus link to the gripper.
//!
//! In: bytes and register requests over bounded channels. Out: [`LinkEvent`]s over one bounded channel. A link
//! never blocks the daemon: what cannot be written in time closes the connection, and reconnecting backs off
//! from 100 ms to 2 s, because a cell that came back must not wait a minute for its daemon (reference:
//! ecosystem, 0.3).

use crate::device::gripper::{ModbusFailure, ModbusRequest};
use crate::device::robot_types::Link;
use crate::io::clock::Clock;
use std::net::SocketAddr;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::sync::mpsc;
use tokio_modbus::prelude::{Reader, Slave, Writer, tcp};

/// What the links report.
#[derive(Debug)]
pub enum LinkEvent {
    /// The connection stands.
    Connected(Link),
    /// It is gone, or could not be made.
    Disconnected(Link, String),
    /// Bytes came in.
    Received(Link, Vec<u8>),
    /// The gripper answered a request, or did not.
    Modbus(Result<Vec<u16>, ModbusFailure>),
}

/// What a link is told.
#[derive(Debug)]
pub enum LinkOrder {
    /// Write these bytes.
    Send(Vec<u8>),
    /// Drop the connection and make a new one.
    Reconnect,
}

/// First and longest pause between two attempts to connect, in the cell's time.
const BACKOFF: (Duration, Duration) = (Duration::from_millis(100), Duration::from_secs(2));

/// How long connecting or one write may take, in the cell's time.
const PATIENCE: Duration = Duration::from_secs(2);

/// Orders a link may lag behind before the daemon has to wait: at 50 heartbeats a second, over a second.
const ORDERS: usize = 64;

/// Starts the task of one TCP link; it ends when the returned sender is dropped.
pub fn spawn_tcp(
    link: Link,
    address: SocketAddr,
    clock: Clock,
    events: mpsc::Sender<LinkEvent>,
) -> mpsc::Sender<LinkOrder> {
    let (orders_in, mut orders) = mpsc::channel(ORDERS);
    tokio::spawn(async move {
        let mut pause = BACKOFF.0;
        loop {
            let reason = match tokio::time::timeout(clock.wall(PATIENCE), TcpStream::connect(address)).await {
                Ok(Ok(stream)) => {
                    pause = BACKOFF.0;
                    // What was meant for the last connection must not be the first thing this one hears.
                    while orders.try_recv().is_ok() {}
                    if events.send(LinkEvent::Connected(link)).await.is_err() {
                        return;
                    }
                    match serve(link, stream, &clock, &events, &mut orders).await {
                        Some(reason) => reason,
                        None => return,
                    }
                }
                Ok(Err(error)) => format!("{address}: {error}"),
                Err(_) => format!("{address}: no answer to the connection request"),
            };
            if events.send(LinkEvent::Disconnected(link, reason)).await.is_err() || orders.is_closed() {
                return;
            }
            tokio::time::sleep(clock.wall(pause)).await;
            pause = (pause * 2).min(BACKOFF.1);
        }
    });
    orders_in
}

/// Carries bytes until the connection ends (the reason) or the daemon does (`None`).
async fn serve(
    link: Link,
    mut stream: TcpStream,
    clock: &Clock,
    events: &mpsc::Sender<LinkEvent>,
    orders: &mut mpsc::Receiver<LinkOrder>,
) -> Option<String> {
    if let Err(error) = stream.set_nodelay(true) {
        return Some(error.to_string());
    }
    let mut buffer = vec![0u8; 16 * 1024];
    loop {
        tokio::select! {
            read = stream.read(&mut buffer) => match read {
                Ok(0) => return Some("the controller closed the connection".to_string()),
                Ok(count) => {
                    let bytes = buffer.get(..count).unwrap_or_default().to_vec();
                    events.send(LinkEvent::Received(link, bytes)).await.ok()?;
                }
                Err(error) => return Some(error.to_string()),
            },
            order = orders.recv() => match order {
                Some(LinkOrder::Send(bytes)) => {
                    match tokio::time::timeout(clock.wall(PATIENCE), stream.write_all(&bytes)).await {
                        Ok(Ok(())) => {}
                        Ok(Err(error)) => return Some(error.to_string()),
                        Err(_) => return Some("the controller does not read".to_string()),
                    }
                }
                Some(LinkOrder::Reconnect) => return Some("dropped by celld".to_string()),
                None => return None,
            },
        }
    }
}

/// The VGC10's Modbus unit (reference: ur-interfaces 7.1).
const GRIPPER_UNIT: u8 = 65;

/// Starts the task of the gripper link: one request at a time, one [`LinkEvent::Modbus`] each.
pub fn spawn_modbus(
    address: SocketAddr,
    clock: Clock,
    patience: Duration,
    events: mpsc::Sender<LinkEvent>,
) -> mpsc::Sender<ModbusRequest> {
    let (requests_in, mut requests) = mpsc::channel::<ModbusRequest>(4);
    tokio::spawn(async move {
        let mut connection: Option<tokio_modbus::client::Context> = None;
        while let Some(request) = requests.recv().await {
            let deadline = clock.wall(patience);
            let answer =
                match tokio::time::timeout(deadline, exchange(&mut connection, address, request)).await {
                    Ok(answer) => answer,
                    Err(_) => Err(ModbusFailure::Timeout),
                };
            // After a failure the answer to an old request could be taken for that to a new one.
            if answer.is_err() {
                connection = None;
            }
            if events.send(LinkEvent::Modbus(answer)).await.is_err() {
                return;
            }
        }
    });
    requests_in
}

async fn exchange(
    connection: &mut Option<tokio_modbus::client::Context>,
    address: SocketAddr,
    request: ModbusRequest,
) -> Result<Vec<u16>, ModbusFailure> {
    let link = |error: &dyn std::fmt::Display| ModbusFailure::Connection(error.to_string());
    let context = match connection {
        Some(context) => context,
        None => {
            let made = tcp::connect_slave(address, Slave(GRIPPER_UNIT)).await.map_err(|e| link(&e))?;
            connection.insert(made)
        }
    };
    match request {
        ModbusRequest::Read { address, count } => {
            match context.read_holding_registers(address, count).await {
                Ok(Ok(words)) => Ok(words),
                Ok(Err(exception)) => Err(ModbusFailure::Exception(exception.into())),
                Err(error) => Err(link(&error)),
            }
        }
        ModbusRequest::Write { address, values } => {
            match context.write_multiple_registers(address, &values).await {
                Ok(Ok(())) => Ok(Vec::new()),
                Ok(Err(exception)) => Err(ModbusFailure::Exception(exception.into())),
                Err(error) => Err(link(&error)),
            }
        }
    }
}
