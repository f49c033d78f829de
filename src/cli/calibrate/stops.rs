//! `celld calibrate stops`: how soon this arm stops by order, without celld's heartbeat, by the dashboard.
//!
//! In: the cell's configuration, a live robot. Out: the arm crosses the table three times and is stopped on
//! the way in one of these ways each; for each when it began to slow down and when it stood, from a
//! recording of every controller frame beside celld. Nothing is kept: the figures belong into the cell's
//! papers.

use crate::bench::rtde_client::{Client, request};
use crate::cli::calibrate::trial::{Trial, TrialArgs};
use crate::cli::daemon::with_runtime;
use crate::config::cell::CellConfig;
use crate::daemon::shell::{Observer, Scene};
use cell_edge::terminal::complain;
use cell_motion::crossing::Crossing;
use cell_motion::path::Segment;
use cell_values::time::Timestamp;
use std::net::{IpAddr, ToSocketAddrs};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::time::Duration;
use ur_wire::rtde_values::Value;

/// Shown under `celld calibrate stops --help`.
pub(super) const HELP: &str = "\
The arm moves at the speeds of the configuration, at least 5 cm over everything that the
configuration says may lie on the table, and is stopped on the way: by celld's own stop, by
celld's silence (celld holds its breath for 0.6 s, the program on the robot has to stop the arm),
and by `stop` over the dashboard. Write the figures down: after an update of the controller they
should be the same. Gripper, camera and calibration files need not be there.";

/// The ways to stop, in this order.
const WAYS: [Way; 3] = [Way::Order, Way::Silence, Way::Dashboard];

/// So long celld is silent: three times what the program on the robot waits for.
const SILENT: Duration = Duration::from_millis(600);

/// The arm counts as fast when it has this share of the transfer's speed, and as slowing below the other.
const FAST: f64 = 0.98;
const SLOWING: f64 = 0.95;

/// Slower than this, rad/s, it stands.
const STANDS_RAD_S: f64 = 0.01;

/// The recording goes on for so long after the arm was stopped.
const WATCHED: Duration = Duration::from_millis(800);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Way {
    Order,
    Silence,
    Dashboard,
}

impl Way {
    fn name(self) -> &'static str {
        match self {
            Way::Order => "stop by order",
            Way::Silence => "watchdog",
            Way::Dashboard => "dashboard stop",
        }
    }
}

/// Measures stops; returns the exit code.
pub(super) fn run(args: &TrialArgs, stop: Arc<AtomicBool>) -> u8 {
    let Some(config) = args.configuration() else { return 2 };
    let yes = args.yes;
    with_runtime(stop, move |stop| async move { measure(&config, yes, stop).await })
}

async fn measure(config: &CellConfig, yes: bool, stop: Arc<AtomicBool>) -> Result<(), String> {
    let stopped = || stop.load(Ordering::Relaxed);
    let mut trial = Trial::ready(config, yes, "is stopped on the way, three times", &stopped).await?;
    let host = address(&config.devices.robot_host)?;
    let crossing = Crossing { slower: true, ..trial.crossing };
    let path = trial.path(&crossing)?;
    let across = path.segments.iter().find_map(|segment| match segment {
        Segment::Joint { speed, .. } => Some(*speed),
        Segment::Linear { .. } => None,
    });
    let across_rad_s = across.ok_or("the way has no transfer")?;
    for way in WAYS {
        let recorder = Recorder::start(host)?;
        let mut trigger = Trigger { way, host, across_rad_s, at_s: None, ended: false };
        let fired = std::cell::Cell::new(false);
        let ended = {
            let ends = || stopped() || fired.get();
            let mut watch = Watch { trigger: &mut trigger, fired: &fired };
            trial.go(vec![crossing], &mut watch, &ends).await
        };
        std::thread::sleep(WATCHED);
        let frames = recorder.end()?;
        if stopped() {
            return Err("stopped by the operator".to_string());
        }
        let at_s = trigger.at_s.ok_or_else(|| format!("{}: {}", way.name(), ended_early(&ended)))?;
        complain(&figures(way, &frames, at_s)?);
    }
    Ok(())
}

fn ended_early(ended: &Result<(), String>) -> String {
    match ended {
        Ok(()) => "the arm was never fast enough to be stopped".to_string(),
        Err(why) => why.clone(),
    }
}

fn address(host: &str) -> Result<IpAddr, String> {
    let found = (host, 0).to_socket_addrs().map_err(|error| format!("{host}: {error}"))?;
    found.map(|address| address.ip()).next().ok_or_else(|| format!("{host} has no address"))
}

/// Stops the arm once it is fast.
struct Trigger {
    way: Way,
    host: IpAddr,
    across_rad_s: f64,
    /// The controller's time when it was stopped, s.
    at_s: Option<f64>,
    ended: bool,
}

/// The trigger as the loop's observer; `fired` says that the round is to be stopped by order.
struct Watch<'a> {
    trigger: &'a mut Trigger,
    fired: &'a std::cell::Cell<bool>,
}

impl Observer for Watch<'_> {
    fn on(&mut self, _now: Timestamp, scene: Scene) {
        let Scene::Robot(state) = scene else { return };
        let trigger = &mut *self.trigger;
        if trigger.ended || fastest(&state.qd) < FAST * trigger.across_rad_s {
            return;
        }
        (trigger.at_s, trigger.ended) = (Some(state.controller_time_s), true);
        match trigger.way {
            Way::Order => self.fired.set(true),
            // The loop does nothing meanwhile: no heartbeat leaves it.
            Way::Silence => std::thread::sleep(SILENT),
            Way::Dashboard => {
                let host = trigger.host;
                std::thread::spawn(move || request(host, "stop"));
            }
        }
    }
}

/// One controller frame: its time, s, and the joints' speeds, rad/s.
type Frame = (f64, [f64; 6]);

fn fastest(qd: &[f64; 6]) -> f64 {
    qd.iter().fold(0.0, |most, speed| speed.abs().max(most))
}

/// Every frame of the controller, taken by a thread of its own.
struct Recorder {
    ends: Arc<AtomicBool>,
    frames: mpsc::Receiver<Result<Frame, String>>,
}

impl Recorder {
    fn start(host: IpAddr) -> Result<Recorder, String> {
        let names = ["timestamp", "actual_qd"].map(str::to_owned);
        let mut client = Client::connect(host, &names, &[])?;
        let ends = Arc::new(AtomicBool::new(false));
        let (sender, frames) = mpsc::channel();
        let over = ends.clone();
        std::thread::spawn(move || {
            while !over.load(Ordering::Relaxed) {
                let frame = client.values().and_then(|values| match values.as_slice() {
                    [Value::Double(time_s), Value::Vector6D(qd)] => Ok((*time_s, *qd)),
                    _ => Err("values of unexpected types".to_string()),
                });
                let broken = frame.is_err();
                if sender.send(frame).is_err() || broken {
                    return;
                }
            }
        });
        Ok(Recorder { ends, frames })
    }

    fn end(self) -> Result<Vec<Frame>, String> {
        self.ends.store(true, Ordering::Relaxed);
        self.frames.iter().collect()
    }
}

fn figures(way: Way, frames: &[Frame], at_s: f64) -> Result<String, String> {
    let after = || frames.iter().filter(|(time_s, _)| *time_s >= at_s);
    let (_, first) = after().next().ok_or("no frame was recorded")?;
    let speed = fastest(first);
    let name = way.name();
    let slows = after().find(|(_, qd)| fastest(qd) < SLOWING * speed);
    let (slows_s, _) = slows.ok_or_else(|| format!("{name}: THE ARM DID NOT SLOW DOWN"))?;
    // Later frames may show noise, and the way back to a start.
    let stands = after().find(|(_, qd)| fastest(qd) < STANDS_RAD_S);
    let (stands_s, _) = stands.ok_or_else(|| format!("{name}: THE ARM DID NOT STOP"))?;
    Ok(format!(
        "{name}: from {speed:.2} rad/s it slows after {:.0} ms and stands after {:.0} ms",
        1e3 * (slows_s - at_s),
        1e3 * (stands_s - at_s)
    ))
}
