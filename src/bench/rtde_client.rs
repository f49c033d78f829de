//! Plain RTDE, dashboard and script clients over blocking sockets, for benchmarks and `celld record`.
//!
//! In: an address and names of outputs. Out: values as they come, and counts of what was missed.
//! Deliberately not the daemon's session: a benchmark must not wait for states that only the daemon needs,
//! and a recorder claims no inputs.

use std::io::{Read, Write};
use std::net::{IpAddr, SocketAddr, TcpStream, ToSocketAddrs};
use std::time::{Duration, Instant};
use ur_wire::rtde::{Reply, Request, Splitter, Version};
use ur_wire::rtde_values::{Leftover, Offer, Recipe, Value};

/// Longest wait for anything from the controller.
pub const PATIENCE: Duration = Duration::from_secs(20);

/// Ports of the controller.
pub const DASHBOARD: u16 = 29999;
/// Takes programs.
pub const PRIMARY: u16 = 30001;
/// RTDE.
pub const RTDE: u16 = 30004;

/// The address of a controller's name.
///
/// # Errors
/// It has none.
pub fn address(host: &str) -> Result<IpAddr, String> {
    let found = (host, 0).to_socket_addrs().map_err(|error| format!("{host}: {error}"))?;
    found.map(|address| address.ip()).next().ok_or_else(|| format!("{host} has no address"))
}

/// A connection with an output recipe, and an input recipe if requested.
pub struct Client {
    stream: TcpStream,
    splitter: Splitter,
    recipe: Recipe,
}

fn broken(what: &str) -> String {
    format!("the RTDE connection: {what}")
}

impl Client {
    /// Connects and subscribes at 500 Hz; `inputs` become input recipe 1.
    ///
    /// # Errors
    /// The connection broke, or a name was refused.
    pub fn connect(host: IpAddr, outputs: &[String], inputs: &[String]) -> Result<Client, String> {
        let stream = TcpStream::connect(SocketAddr::new(host, RTDE)).map_err(|e| broken(&e.to_string()))?;
        let timed = stream.set_read_timeout(Some(PATIENCE)).and_then(|()| stream.set_nodelay(true));
        timed.map_err(|e| broken(&e.to_string()))?;
        let recipe = Recipe { id: 1, fields: Vec::new() };
        let mut client = Client { stream, splitter: Splitter::default(), recipe };
        client.send(&Request::ProtocolVersion(2), Version::V1)?;
        client.reply(Version::V1)?;
        if !inputs.is_empty() {
            client.send(&Request::SetupInputs { names: inputs.to_vec() }, Version::V2)?;
            client.reply(Version::V2)?;
        }
        let names = outputs.to_vec();
        client.send(&Request::SetupOutputs { frequency_hz: Some(500.0), names }, Version::V2)?;
        let Reply::SetupOutputs { offers, .. } = client.reply(Version::V2)? else {
            return Err(broken("no answer to the set-up"));
        };
        for (name, offer) in outputs.iter().zip(offers) {
            let Offer::Type(kind) = offer else { return Err(broken(&format!("{name} is refused"))) };
            client.recipe.fields.push((name.clone(), kind));
        }
        client.send(&Request::Start, Version::V2)?;
        Ok(client)
    }

    fn send(&mut self, request: &Request, version: Version) -> Result<(), String> {
        self.stream.write_all(&request.encode(version)).map_err(|error| broken(&error.to_string()))
    }

    /// Writes input recipe 1, packed.
    ///
    /// # Errors
    /// The connection broke.
    pub fn write(&mut self, payload: Vec<u8>) -> Result<(), String> {
        self.send(&Request::Data { recipe: 1, payload }, Version::V2)
    }

    fn reply(&mut self, version: Version) -> Result<Reply, String> {
        loop {
            if let Some(frame) = self.splitter.next_frame().map_err(|error| broken(&error.to_string()))? {
                return Reply::decode(version, &frame).map_err(|error| broken(&error.to_string()));
            }
            let mut buffer = [0; 16 * 1024];
            match self.stream.read(&mut buffer) {
                Ok(0) => return Err(broken("closed")),
                Ok(count) => self.splitter.push(&buffer[..count]),
                // A signal; who wants to end looks at it between two values.
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
                Err(error) => return Err(broken(&error.to_string())),
            }
        }
    }

    /// The next values.
    ///
    /// # Errors
    /// The connection broke.
    pub fn values(&mut self) -> Result<Vec<Value>, String> {
        loop {
            if let Reply::Data { payload, .. } = self.reply(Version::V2)? {
                let values = self.recipe.decode(&payload, Leftover::Refuse);
                return values.map_err(|error| broken(&error.to_string()));
            }
        }
    }
}

/// What one client saw.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Seen {
    /// Packages.
    pub packages: u64,
    /// Controller frames that passed without one.
    pub lost: u64,
}

/// Reads until `end`; the first output has to be `control_step`.
///
/// # Errors
/// The connection broke.
pub fn watch(client: &mut Client, end: Instant) -> Result<Seen, String> {
    let (mut seen, mut last) = (Seen::default(), None);
    while Instant::now() < end {
        let values = client.values()?;
        let Some(Value::Uint64(step)) = values.first() else { return Err(broken("no control_step")) };
        seen.packages += 1;
        seen.lost += last.map_or(0, |last: u64| step.saturating_sub(last).saturating_sub(1));
        last = Some(*step);
    }
    Ok(seen)
}

/// Sends one query to the dashboard on a connection of its own.
///
/// # Errors
/// The connection broke.
pub fn request(host: IpAddr, question: &str) -> Result<String, String> {
    let said = |error: std::io::Error| format!("the dashboard: {error}");
    let mut stream = TcpStream::connect(SocketAddr::new(host, DASHBOARD)).map_err(said)?;
    stream.set_read_timeout(Some(PATIENCE)).map_err(said)?;
    stream.write_all(format!("{question}\nquit\n").as_bytes()).map_err(said)?;
    let mut text = String::new();
    stream.read_to_string(&mut text).map_err(said)?;
    Ok(text.lines().nth(1).unwrap_or_default().to_owned())
}

/// Powers the arm on, opens its brakes and waits until it runs.
///
/// # Errors
/// It did not come to that.
pub fn bring_up(host: IpAddr) -> Result<(), String> {
    request(host, "brake release")?;
    wait_for("the arm runs", || Ok(request(host, "robotmode")? == "Robotmode: RUNNING"))
}

/// Sends a program and waits until it runs.
///
/// # Errors
/// The connection broke, or the program did not start.
pub fn play(host: IpAddr, program: &str) -> Result<(), String> {
    let said = |error: std::io::Error| format!("the primary interface: {error}");
    let mut stream = TcpStream::connect(SocketAddr::new(host, PRIMARY)).map_err(said)?;
    stream.write_all(program.as_bytes()).map_err(said)?;
    wait_for("the program runs", || Ok(request(host, "running")? == "Program running: true"))
}

fn wait_for(what: &str, mut done: impl FnMut() -> Result<bool, String>) -> Result<(), String> {
    let began = Instant::now();
    while !done()? {
        if began.elapsed() > PATIENCE {
            return Err(format!("waited {} s for: {what}", PATIENCE.as_secs()));
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    Ok(())
}
