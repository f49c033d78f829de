//! `celld calibrate stops`: how soon this arm stops by order, without celld's heartbeat, by the dashboard.
//!
//! In: the cell's configuration, a live robot. Out: the arm crosses the table three times and is stopped on
//! the way in one of these ways each; for each when it began to slow down and when it stood, from a
//! recording of every controller frame beside celld. Nothing is kept: the figures belong into the cell's
//! papers.

use crate::bench::rtde_client::{Client, address, request};
use crate::cli::calibrate::trial::{Trial, TrialArgs};
use crate::cli::daemon::with_runtime;
use crate::config::cell::CellConfig;
use crate::daemon::shell::{Observer, Scene};
use cell_calibration::blends::SentPath;
use cell_edge::terminal::complain;
use cell_machine::device::robot_types::RobotState;
use cell_motion::crossing::Crossing;
use cell_motion::path::Segment;
use cell_values::time::Timestamp;
use std::net::IpAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::time::Duration;
use ur_wire::rtde_values::Value;

/// Shown under `celld calibrate stops --help`.
pub(super) const HELP: &str = "\
Before you start: empty the gripper, clear the arm's reach of people and things, keep a hand at the
emergency stop. An arm that is off is powered on and its brakes are released. The arm crosses the
table three times, at least 4 cm over everything that may lie there by the configuration, and is
stopped in the middle of the transfer:
  by order    celld's own stop
  watchdog    celld sends no heartbeat for 0.6 s, the program on the robot has to stop the arm;
              Ctrl-C counts only afterwards, the emergency stop at once
  dashboard   `stop` over the dashboard
The transfer before the watchdog's stop is slowed, so that it lasts long enough. Write the figures
down: after an update of the controller they should be the same. Gripper, camera and calibration
files may be absent.";

/// The ways to stop, in this order.
const WAYS: [Way; 3] = [Way::Order, Way::Silence, Way::Dashboard];

/// So long celld is silent: three times what the program on the robot waits for.
const SILENT: Duration = Duration::from_millis(600);

/// The arm counts as fast when it has this share of the transfer's speed, and as slowing below the other.
const FAST: f64 = 0.98;
const SLOWING: f64 = 0.95;

/// It is in the middle of the way across at these shares of it, each joint within so much of it, rad.
const MIDDLE: std::ops::Range<f64> = 0.1..0.8;
const NEAR_RAD: f64 = 0.02;

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
    // A simulator would wait for a celld that is silent, and the arm with it.
    let config = &CellConfig { simulation: None, ..config.clone() };
    let mut trial = Trial::ready(config, yes, "is stopped on the way across, three times", &stopped).await?;
    let host = address(&config.devices.robot_host)?;
    for way in WAYS {
        let crossing = Crossing { slower: way == Way::Silence, ..trial.crossing };
        let across_rad_s = transfer_speed(&trial.path(&crossing)?).ok_or("the way has no transfer")?;
        let recorder = Recorder::start(host)?;
        let mut trigger = Trigger { way, host, crossing, across_rad_s, at_s: None, answer: None };
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
        if let Some(refused) = trigger.refused() {
            return Err(format!("{}: {refused}", way.name()));
        }
        let at_s = match (trigger.at_s, ended) {
            (Some(at_s), Err(_)) => at_s,
            (Some(_), Ok(())) => {
                return Err(format!("{}: THE ARM DID NOT STOP, it went on to the end", way.name()));
            }
            (None, Ok(())) => return Err(format!("{}: the arm was never fast enough", way.name())),
            (None, Err(why)) => return Err(format!("{}: {why}", way.name())),
        };
        complain(&figures(way, &frames, at_s)?);
    }
    Ok(())
}

/// Of the leading joint on the way across, rad/s.
fn transfer_speed(path: &SentPath) -> Option<f64> {
    path.segments.iter().find_map(|segment| match segment {
        Segment::Joint { speed, .. } => Some(*speed),
        Segment::Linear { .. } => None,
    })
}

/// Stops the arm once it is fast.
struct Trigger {
    way: Way,
    host: IpAddr,
    crossing: Crossing,
    across_rad_s: f64,
    /// The controller's time when it was stopped, s.
    at_s: Option<f64>,
    /// The dashboard's answer, once there is one.
    answer: Option<std::thread::JoinHandle<Result<String, String>>>,
}

impl Trigger {
    /// The arm is in the middle of the way across, and fast.
    fn is_due(&self, state: &RobotState) -> bool {
        let (from, to) = (&self.crossing.lifted.0, &self.crossing.over.0);
        let leading = (0..6).max_by(|a, b| (to[*a] - from[*a]).abs().total_cmp(&(to[*b] - from[*b]).abs()));
        let Some(joint) = leading else { return false };
        let share = (state.q.0[joint] - from[joint]) / (to[joint] - from[joint]);
        let near = state.q.max_difference(&self.crossing.lifted.lerp(&self.crossing.over, share)) <= NEAR_RAD;
        near && MIDDLE.contains(&share) && state.qd[joint].abs() >= FAST * self.across_rad_s
    }

    /// Why the dashboard has not taken the stop; `None` where it has, or got no request.
    fn refused(&mut self) -> Option<String> {
        let answer = self.answer.take()?.join().unwrap_or_else(|_| Err("the request has failed".to_string()));
        match answer {
            Ok(answer) if answer == "Stopped" => None,
            Ok(answer) => Some(format!("the dashboard answers {answer:?}")),
            Err(why) => Some(why),
        }
    }
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
        if trigger.at_s.is_some() || !trigger.is_due(state) {
            return;
        }
        trigger.at_s = Some(state.controller_time_s);
        match trigger.way {
            Way::Order => self.fired.set(true),
            // The loop does nothing meanwhile: no heartbeat leaves it.
            Way::Silence => std::thread::sleep(SILENT),
            Way::Dashboard => {
                let host = trigger.host;
                trigger.answer = Some(std::thread::spawn(move || request(host, "stop")));
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
