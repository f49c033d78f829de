//! `celld record`: the arm's joints as the controller reports them, into a file.
//!
//! In: the address of a controller, with or without a running daemon. Out: lines as `ur_rtde` writes them
//! (`cell_calibration::files::joints`), until Ctrl-C, or so many seconds. Nothing is written to the
//! controller: no input is claimed, so that it can listen beside everything that moves the arm.

use crate::bench::rtde_client::{Client, address};
use crate::config::load::load_cell;
use cell_calibration::files::joints::{JointSample, header, line};
use cell_edge::terminal::complain;
use clap::Args;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use ur_wire::rtde_values::Value;

/// Shown under `celld record --help`.
pub const HELP: &str = "\
500 lines a second: timestamp, actual_q_0 to 5 (rad), actual_qd_0 to 5 (rad/s), robot_mode,
safety_mode, runtime_state. It only listens, also beside `celld run`.
  celld record --config config/cell.yaml --out moves.csv     # Ctrl-C ends it
  celld-sim compare moves.csv program.script                 # against the simulated arm";

/// `celld record`
#[derive(Args, Clone, Debug)]
pub struct RecordArgs {
    /// The cell's configuration, for the robot's address.
    #[arg(long, default_value = "config/cell.yaml", value_name = "FILE")]
    config: PathBuf,
    /// The controller's address instead of the configuration's.
    #[arg(long, value_name = "HOST")]
    robot: Option<String>,
    /// Where the lines go; a file that is there is replaced.
    #[arg(long, value_name = "FILE.csv")]
    out: PathBuf,
    /// End after so many seconds of the controller's time, instead of at Ctrl-C.
    #[arg(long, value_name = "S", value_parser = clap::value_parser!(u32).range(1..=86_400))]
    seconds: Option<u32>,
}

/// Outputs, in this order.
const OUTPUTS: [&str; 6] =
    ["timestamp", "actual_q", "actual_qd", "robot_mode", "safety_mode", "runtime_state"];

/// Records; returns the exit code: 0 also after Ctrl-C, if anything was recorded.
pub fn run(args: &RecordArgs, stop: &Arc<AtomicBool>) -> u8 {
    let host = match &args.robot {
        Some(host) => Ok(host.clone()),
        None => load_cell(&args.config).map(|config| config.devices.robot_host).map_err(|e| e.to_string()),
    };
    let host = match host.and_then(|host| address(&host)) {
        Ok(host) => host,
        Err(message) => {
            complain(&message);
            return 2;
        }
    };
    match record(host, &args.out, args.seconds, stop) {
        Ok(0) if stop.load(Ordering::Relaxed) => 130,
        Ok(count) => {
            complain(&format!("{count} lines in {}", args.out.display()));
            0
        }
        Err(message) => {
            complain(&message);
            1
        }
    }
}

/// Returns how many samples are in the file.
fn record(host: IpAddr, out: &Path, seconds: Option<u32>, stop: &AtomicBool) -> Result<usize, String> {
    let mut client = Client::connect(host, &OUTPUTS.map(str::to_owned), &[])
        .map_err(|error| format!("{host}: {error}; is it on, and RTDE enabled?"))?;
    let full = |error: std::io::Error| format!("{}: {error}", out.display());
    let mut file = BufWriter::new(File::create(out).map_err(full)?);
    file.write_all(header().as_bytes()).map_err(full)?;
    complain("recording; Ctrl-C ends it");
    let (mut count, mut last, mut first_s) = (0, f64::NEG_INFINITY, None);
    while !stop.load(Ordering::Relaxed) {
        let sample =
            sample(&client.values()?).ok_or_else(|| format!("{host}: values of unexpected types"))?;
        let began_s = *first_s.get_or_insert(sample.time_s);
        if seconds.is_some_and(|limit| sample.time_s - began_s >= f64::from(limit)) {
            break;
        }
        if sample.time_s > last {
            file.write_all(line(&sample).as_bytes()).map_err(full)?;
            (count, last) = (count + 1, sample.time_s);
        }
    }
    file.flush().map_err(full)?;
    Ok(count)
}

fn sample(values: &[Value]) -> Option<JointSample> {
    let [
        Value::Double(time_s),
        Value::Vector6D(q),
        Value::Vector6D(qd),
        Value::Int32(robot),
        Value::Int32(safety),
        Value::Uint32(runtime),
    ] = values
    else {
        return None;
    };
    let states = [*robot, *safety, i32::try_from(*runtime).ok()?];
    Some(JointSample { time_s: *time_s, q: *q, qd: *qd, states })
}
