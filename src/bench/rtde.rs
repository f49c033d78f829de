//! `bench rtde`: what the codec costs, and how the simulator keeps its 500 Hz.
//!
//! In: the program to watch (this one), a configuration, an address, seconds, a number of clients. Out:
//! [`Figures`]. The simulator runs as a process of its own; its clients run here, each on a thread. Lateness
//! is recorded inside the simulator, package by package, from when the frame was due to when the bytes were
//! handed to the system. Beside it is the machine's own wake-up jitter: a thread here that only sleeps to
//! the same schedule meanwhile.

use crate::bench::rtde_client::{Client, Seen, bring_up, play, watch};
use crate::bench::rtde_process::Simulator;
use cell_edge::priority;
use cell_machine::device::rtde_recipes::output_names;
use serde::Serialize;
use std::net::IpAddr;
use std::path::PathBuf;
use std::time::{Duration, Instant};
use ur_sim::robot_server::latency::{Delays, LatencyHistogram};
use ur_wire::rtde::{Reply, Splitter, Version};
use ur_wire::rtde_values::{Leftover, Recipe, Value};
use ur_wire::rtde_variables::output_type;

/// A controller frame.
const FRAME: Duration = Duration::from_millis(2);

/// Packages decoded for the codec's figure.
const DECODED: u32 = 20_000;

/// Commands whose way to a motion is timed.
const COMMANDS: i32 = 100;

/// A program that starts a motion in the frame in which register 24 changes.
const ANSWERS: &str = "def bench():\n  last = 0\n  while True:\n    n = \
                       read_input_integer_register(24)\n    if n != last:\n      last = n\n      \
                       speedj([0.1 * (1 - 2 * (n % 2)),0,0,0,0,0], 20, 0.02)\n      stopj(20)\n    end\n    \
                       sync()\n  end\nend\n";

/// A program that moves without end, as the demo does.
const MOVES: &str = "def bench():\n  q = get_target_joint_positions()\n  while True:\n    movej(q + \
                     [0.5,0,0,0,0,0], a=3, v=1.5)\n    movej(q, a=3, v=1.5)\n  end\nend\n";

/// What to measure, and with what.
#[derive(Clone, Debug)]
pub struct Setup {
    /// The program whose `sim` is watched.
    pub program: PathBuf,
    /// Its configuration.
    pub config: PathBuf,
    /// Loopback address it listens at.
    pub host: IpAddr,
    /// Length of each measurement, s.
    pub seconds: f64,
    /// RTDE clients.
    pub clients: usize,
    /// Time factor of the fast run.
    pub factor: f64,
}

/// What was measured.
#[derive(Clone, Debug, Serialize)]
pub struct Figures {
    /// One package of the daemon's recipe, from bytes to values, ns.
    pub decode_ns: f64,
    /// Bytes of that package.
    pub package_bytes: usize,
    /// RTDE clients in real time, and seconds.
    pub clients: usize,
    /// Length of the measurement, s.
    pub seconds: f64,
    /// Packages the clients received, and frames that passed without one.
    pub received: u64,
    /// See `received`.
    pub lost: u64,
    /// Share of packages that left within 1 ms of their frame's time.
    pub within_1_ms: f64,
    /// Lateness, us.
    pub late_median_us: u64,
    /// Of a thousand, the 999th.
    pub late_p999_us: u64,
    /// The worst.
    pub late_worst_us: u64,
    /// The same of a thread that only sleeps to the schedule: the machine's own jitter.
    pub jitter_within_1_ms: f64,
    /// See `jitter_within_1_ms`.
    pub jitter_p999_us: u64,
    /// See `jitter_within_1_ms`.
    pub jitter_worst_us: u64,
    /// The simulator's share of one core.
    pub cpu_fraction: f64,
    /// Resident memory, MB, the camera not used.
    pub resident_mb: Option<f64>,
    /// From the start of the process to the first accepted connection, ms.
    pub start_ms: f64,
    /// Controller cycles from the state a command answers to, to the first state in motion: median and 99th
    /// of a hundred.
    pub command_to_motion_cycles_p50: u64,
    /// See `command_to_motion_cycles_p50`.
    pub command_to_motion_cycles_p99: u64,
    /// Time factor requested, and reached.
    pub factor: f64,
    /// See `factor`.
    pub factor_reached: f64,
    /// Frames of the fast run that passed without a package, all clients.
    pub factor_lost: u64,
}

/// Measures everything; `progress` is called with what comes next.
///
/// # Errors
/// One sentence: what did not work.
pub fn run(setup: &Setup, progress: &dyn Fn(&str)) -> Result<Figures, String> {
    progress("decoding");
    let (decode_ns, package_bytes) = decode();
    progress("real time");
    let sim = Simulator::start(&setup.program, &setup.config, setup.host, 1.0)?;
    bring_up(setup.host)?;
    let cpu_before = sim.cpu_seconds();
    let began = Instant::now();
    let jitter = std::thread::spawn({
        let end = began + Duration::from_secs_f64(setup.seconds);
        move || sleep_to_schedule(end)
    });
    let seen = crowd(setup)?;
    let cpu_fraction = (sim.cpu_seconds() - cpu_before) / began.elapsed().as_secs_f64();
    let jitter = jitter.join().map_err(|_| "the jitter thread panicked")?;
    let (timing, resident_mb) = (sim.timing()?, sim.resident_mb());
    progress("commands");
    let cycles = command_to_motion(setup.host)?;
    let start_ms = sim.start_ms;
    drop(sim);
    progress("fast");
    let fast = fast(setup)?;
    let number = |key: &str| timing[key].as_f64().unwrap_or(f64::NAN);
    Ok(Figures {
        decode_ns,
        package_bytes,
        clients: setup.clients,
        seconds: setup.seconds,
        received: seen.packages,
        lost: seen.lost,
        within_1_ms: number("within_1_ms"),
        late_median_us: number("median_us") as u64,
        late_p999_us: number("p999_us") as u64,
        late_worst_us: number("worst_us") as u64,
        jitter_within_1_ms: jitter.within_1_ms,
        jitter_p999_us: jitter.p999_us,
        jitter_worst_us: jitter.worst_us,
        cpu_fraction,
        resident_mb,
        start_ms,
        command_to_motion_cycles_p50: quantile(&cycles, 0.5),
        command_to_motion_cycles_p99: quantile(&cycles, 0.99),
        factor: setup.factor,
        factor_reached: fast.0,
        factor_lost: fast.1,
    })
}

/// The `share` quantile of some counts, 0 for none.
fn quantile(counts: &[u64], share: f64) -> u64 {
    let mut sorted = counts.to_vec();
    sorted.sort_unstable();
    let index = (share * sorted.len() as f64).ceil() as usize;
    sorted.get(index.saturating_sub(1)).copied().unwrap_or(0)
}

/// ns for a package of the daemon's own recipe, and its bytes.
fn decode() -> (f64, usize) {
    let fields = output_names().into_iter().filter_map(|name| output_type(&name).map(|kind| (name, kind)));
    let recipe = Recipe { id: 1, fields: fields.collect() };
    let values: Vec<Value> = recipe.fields.iter().map(|(_, kind)| kind.zero()).collect();
    let payload = recipe.encode(&values).unwrap_or_default();
    let bytes = Reply::Data { recipe: 1, payload }.encode(Version::V2);
    let mut splitter = Splitter::default();
    let began = Instant::now();
    for _ in 0..DECODED {
        splitter.push(std::hint::black_box(&bytes));
        while let Ok(Some(frame)) = splitter.next_frame() {
            if let Ok(Reply::Data { payload, .. }) = Reply::decode(Version::V2, &frame) {
                let _ = std::hint::black_box(recipe.decode(&payload, Leftover::Refuse));
            }
        }
    }
    (began.elapsed().as_secs_f64() * 1e9 / f64::from(DECODED), bytes.len())
}

/// Names of the clients' recipe: the daemon's, behind the step that shows what was missed.
fn watched() -> Vec<String> {
    std::iter::once("control_step".to_owned()).chain(output_names()).collect()
}

/// All clients for the time of a measurement.
fn crowd(setup: &Setup) -> Result<Seen, String> {
    let clients: Result<Vec<Client>, String> =
        (0..setup.clients).map(|_| Client::connect(setup.host, &watched(), &[])).collect();
    let end = Instant::now() + Duration::from_secs_f64(setup.seconds);
    let threads: Vec<_> = clients?
        .into_iter()
        .map(|mut client| {
            std::thread::spawn(move || {
                priority::raise();
                watch(&mut client, end)
            })
        })
        .collect();
    let mut all = Seen::default();
    for thread in threads {
        let seen = thread.join().map_err(|_| "a client panicked")??;
        all.packages += seen.packages;
        all.lost += seen.lost;
    }
    Ok(all)
}

/// What a thread that only sleeps sees of the machine, at the priority of the simulator's frames.
fn sleep_to_schedule(end: Instant) -> Delays {
    priority::real_time();
    let _ = rustix::thread::set_current_timer_slack(std::num::NonZeroU64::new(1000));
    let seen = LatencyHistogram::default();
    let mut due = Instant::now() + FRAME;
    while due < end {
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
        seen.record(due.elapsed());
        due = (due + FRAME).max(Instant::now());
    }
    seen.delays()
}

/// Cycles from the state that a command answers to, to the first state in motion.
fn command_to_motion(host: IpAddr) -> Result<Vec<u64>, String> {
    play(host, ANSWERS)?;
    let names = ["control_step", "target_qd"].map(str::to_owned);
    let mut client = Client::connect(host, &names, &["input_int_register_24".to_owned()])?;
    let mut cycles = Vec::new();
    for command in 1..=COMMANDS {
        let (mut stood, mut requested_at) = (0, None);
        loop {
            let values = client.values()?;
            let [Value::Uint64(step), Value::Vector6D(speed)] = values[..] else {
                return Err("the simulator sent something else".to_owned());
            };
            let moves = speed.iter().any(|speed| speed.abs() > 1e-9);
            match requested_at {
                // Ten frames of rest: the move before is over.
                None if moves => stood = 0,
                None if stood < 10 => stood += 1,
                None => {
                    client.write(command.to_be_bytes().to_vec())?;
                    requested_at = Some(step);
                }
                Some(requested) if moves => {
                    cycles.push(step - requested);
                    break;
                }
                Some(requested) if step > requested + 5000 => {
                    return Err("a command had no effect".to_owned());
                }
                Some(_) => {}
            }
        }
    }
    Ok(cycles)
}

/// Time factor reached with the clients reading and the arm moving, and frames they did not get.
fn fast(setup: &Setup) -> Result<(f64, u64), String> {
    let sim = Simulator::start(&setup.program, &setup.config, setup.host, setup.factor)?;
    bring_up(setup.host)?;
    play(setup.host, MOVES)?;
    let frames = |sim: &Simulator| sim.timing().map(|timing| timing["frames"].as_f64().unwrap_or(0.0));
    let (before, began) = (frames(&sim)?, Instant::now());
    let seen = crowd(setup)?;
    let simulated = (frames(&sim)? - before) * FRAME.as_secs_f64();
    Ok((simulated / began.elapsed().as_secs_f64(), seen.lost))
}

/// The figures as a table for people.
pub fn table(figures: &Figures) -> String {
    let f = figures;
    let percent = |share: f64| format!("{:.3} %", share * 100.0);
    let rows = [
        ("decode one package", format!("{:.0} ns ({} bytes)", f.decode_ns, f.package_bytes)),
        ("clients, seconds", format!("{} x 500 Hz, {} s", f.clients, f.seconds)),
        ("packages received, lost", format!("{}, {}", f.received, f.lost)),
        ("sent within 1 ms of the schedule", percent(f.within_1_ms)),
        (
            "lateness: median, 99.9 %, worst",
            format!("{}, {}, {} us", f.late_median_us, f.late_p999_us, f.late_worst_us),
        ),
        (
            "a thread that only sleeps: within 1 ms, 99.9 %, worst",
            format!("{}, {} us, {} us", percent(f.jitter_within_1_ms), f.jitter_p999_us, f.jitter_worst_us),
        ),
        ("simulator, of one core", percent(f.cpu_fraction)),
        ("resident memory", f.resident_mb.map_or("unknown".to_owned(), |mb| format!("{mb:.1} MB"))),
        ("start to first connection", format!("{:.1} ms", f.start_ms)),
        (
            "command to motion: median, 99 %",
            format!("{}, {} cycles", f.command_to_motion_cycles_p50, f.command_to_motion_cycles_p99),
        ),
        (
            "time factor asked for, reached, frames lost",
            format!("{}, {:.2}, {}", f.factor, f.factor_reached, f.factor_lost),
        ),
    ];
    let width = rows.iter().map(|(name, _)| name.len()).max().unwrap_or(0);
    rows.iter().map(|(name, value)| format!("{name:width$}  {value}\n")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_values_that_occurred() {
        assert_eq!(quantile(&[], 0.5), 0);
        assert_eq!(quantile(&[3, 1, 2], 0.5), 2);
        assert_eq!(quantile(&(1..=100).collect::<Vec<_>>(), 0.99), 99);
    }

    #[test]
    fn the_codec_decodes_the_package_it_is_timed_with() {
        let (nanoseconds, bytes) = decode();
        assert!(nanoseconds > 0.0 && bytes > 100, "{bytes} bytes");
    }
}
