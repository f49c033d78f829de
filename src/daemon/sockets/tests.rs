//! The gripper's connection over real sockets: against the server of a library, and against one that says
//! nothing.

use super::*;
use cell_machine::device::gripper_types::{CONTROL, ModbusFailure, UNIT, VACUUM};
use std::future::ready;
use std::net::Ipv4Addr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio_modbus::server::tcp::{Server, accept_tcp_connection};
use tokio_modbus::{ExceptionCode, Request, Response, SlaveRequest};

/// Longest wait for an answer: two seconds may be needed, and the computer may be busy.
const LONG: Duration = Duration::from_secs(60);

/// Registers from 0 on, and what the vacuum is.
#[derive(Clone)]
struct Device(Arc<Mutex<Vec<u16>>>);

impl tokio_modbus::server::Service for Device {
    type Request = SlaveRequest<'static>;
    type Response = Response;
    type Exception = ExceptionCode;
    type Future = std::future::Ready<Result<Response, ExceptionCode>>;

    fn call(&self, SlaveRequest { slave, request }: SlaveRequest<'static>) -> Self::Future {
        assert_eq!(slave, UNIT);
        let mut registers = self.0.lock().unwrap();
        ready(match request {
            Request::ReadHoldingRegisters(VACUUM, 2) => Ok(Response::ReadHoldingRegisters(vec![600, 3])),
            Request::WriteMultipleRegisters(first, values) => {
                let place = usize::from(first);
                registers[place..place + values.len()].copy_from_slice(&values);
                Ok(Response::WriteMultipleRegisters(first, values.len() as u16))
            }
            _ => Err(ExceptionCode::IllegalDataAddress),
        })
    }
}

async fn listener() -> (TcpListener, SocketAddr) {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).await.unwrap();
    let address = listener.local_addr().unwrap();
    (listener, address)
}

struct Rig {
    sockets: Sockets,
    messages: mpsc::Receiver<Message>,
}

impl Rig {
    fn new(gripper: SocketAddr) -> Rig {
        let nobody = SocketAddr::from((Ipv4Addr::LOCALHOST, 9));
        let (messages_in, messages) = mpsc::channel(16);
        let addresses =
            Addresses { rtde: nobody, dashboard: nobody, primary: nobody, gripper, gripper_unit: UNIT };
        Rig { sockets: Sockets::new(&addresses, Clock::new(1.0), messages_in), messages }
    }

    /// Turns as the daemon's loop does, to the answer.
    async fn answer(&mut self) -> Result<Vec<u16>, ModbusFailure> {
        let mut events = Vec::new();
        tokio::time::timeout(LONG, async {
            while events.is_empty() {
                let due = self.sockets.next_wake().unwrap_or(self.sockets.clock.now());
                let wait = self.sockets.clock.nap(due.since(self.sockets.clock.now()));
                tokio::select! {
                    message = self.messages.recv() => match message {
                        Some(Message::Made(made)) => assert!(self.sockets.made(made).is_none()),
                        _ => panic!("nothing else is sent here"),
                    },
                    () = self.sockets.ready() => {}
                    () = tokio::time::sleep(wait) => {}
                }
                self.sockets.take(&mut events);
            }
        })
        .await
        .expect("an answer");
        match events.remove(0) {
            Event::Registers(answer) if events.is_empty() => answer,
            other => panic!("{other:?}, then {events:?}"),
        }
    }

    async fn read(&mut self) -> Result<Vec<u16>, ModbusFailure> {
        self.sockets.transact(ModbusRequest::Read { address: VACUUM, count: 2 });
        self.answer().await
    }
}

/// The server of a library, which serves one client while `serves` is true.
async fn library(serves: Arc<AtomicBool>) -> (SocketAddr, Device, tokio::task::JoinHandle<()>) {
    let (listener, address) = listener().await;
    let device = Device(Arc::new(Mutex::new(vec![0; 4])));
    let of = device.clone();
    let task = tokio::spawn(async move {
        let connected = |stream, address| {
            let (of, serves) = (of.clone(), serves.load(Ordering::Relaxed));
            ready(accept_tcp_connection(stream, address, |_| Ok(serves.then(|| of.clone()))))
        };
        Server::new(listener).serve(&connected, |_| {}).await.unwrap();
    });
    (address, device, task)
}

#[tokio::test]
async fn registers_are_read_and_written_at_the_server_of_a_library() {
    let (address, device, _task) = library(Arc::new(AtomicBool::new(true))).await;
    let mut rig = Rig::new(address);
    assert_eq!(rig.read().await, Ok(vec![600, 3]));
    rig.sockets.transact(ModbusRequest::Write { address: CONTROL, values: vec![0x013c, 0x0200] });
    assert_eq!(rig.answer().await, Ok(Vec::new()));
    assert_eq!(device.0.lock().unwrap()[..2], [0x013c, 0x0200]);
    rig.sockets.transact(ModbusRequest::Read { address: 1536, count: 1 });
    assert_eq!(rig.answer().await, Err(ModbusFailure::Exception(2)));
    assert_eq!(rig.read().await, Ok(vec![600, 3]), "an exception leaves the connection");
}

#[tokio::test]
async fn a_place_that_another_client_holds_is_tried_until_it_is_free() {
    let serves = Arc::new(AtomicBool::new(false));
    let (address, _device, _task) = library(serves.clone()).await;
    let mut rig = Rig::new(address);
    assert_eq!(rig.read().await, Err(ModbusFailure::Taken));
    serves.store(true, Ordering::Relaxed);
    let answer = tokio::time::timeout(LONG, async {
        loop {
            match rig.read().await {
                Err(ModbusFailure::Taken) => tokio::task::yield_now().await,
                answer => break answer,
            }
        }
    });
    assert_eq!(answer.await, Ok(Ok(vec![600, 3])));
}

#[tokio::test]
async fn an_address_where_nobody_listens_refuses() {
    let (listener, address) = listener().await;
    drop(listener);
    assert_eq!(Rig::new(address).read().await, Err(ModbusFailure::Refused));
}

/// Answers one reading with this number, twice.
async fn answer_one(stream: &mut TcpStream, per_mille: u8) {
    let mut request = [0; 12];
    stream.read_exact(&mut request).await.unwrap();
    let answer = [request[0], request[1], 0, 0, 0, 7, UNIT, 3, 4, 0, per_mille, 0, per_mille];
    stream.write_all(&answer).await.unwrap();
}

#[tokio::test]
async fn a_silent_connection_is_reset_once_a_second_one_is_made() {
    let (listener, address) = listener().await;
    let mut rig = Rig::new(address);
    let device = async {
        let (mut first, _) = listener.accept().await.unwrap();
        answer_one(&mut first, 8).await;
        let (mut second, _) = listener.accept().await.unwrap();
        answer_one(&mut second, 9).await;
        let mut rest = Vec::new();
        let end = first.read_to_end(&mut rest).await.map_err(|error| error.kind());
        (rest.len(), end.map(drop), second)
    };
    let client = async {
        assert_eq!(rig.read().await, Ok(vec![8, 8]));
        assert_eq!(rig.read().await, Err(ModbusFailure::Timeout));
        rig.read().await
    };
    let ((_, end, _second), answer) = tokio::join!(device, client);
    assert_eq!(answer, Ok(vec![9, 9]));
    assert_eq!(end, Err(std::io::ErrorKind::ConnectionReset), "not closed in order");
}
