//! `celld calibrate blends`: how this controller passes corners that are cut, recorded and judged.
//!
//! In: the cell's configuration, a live robot; gripper and camera need not be there. Out: the arm moves over
//! the table, up, across and down again and back, twice; `blends.yaml` and `blends.csv` in the calibration
//! folder if it stayed within what paths are checked for; figures of the on-robot program on the way. Until
//! then a real arm stops at each corner (`config::blends`).

use crate::cli::calibrate::trial::{Trial, TrialArgs};
use crate::cli::daemon::with_runtime;
use crate::config::blends::{joints_file, limits, script_file};
use crate::config::cell::CellConfig;
use crate::daemon::shell::{Observer, Scene};
use crate::jobs::utc;
use cell_calibration::blends::{Passage, SentPath, judge};
use cell_calibration::files::blends::BlendRecording;
use cell_calibration::files::joints::{self, JointSample};
use cell_edge::clock::unix_now_s;
use cell_edge::files::{self, create_folder};
use cell_edge::terminal::complain;
use cell_edge::together::write_together;
use cell_machine::device::robot_types::{Link, RobotState};
use cell_machine::event::Effect;
use cell_motion::path::{ArmModel, Segment};
use cell_values::time::Timestamp;
use cell_values::units::mm_from_m;
use rearrange::document::chain::chain;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use ur_wire::enumerations::RuntimeState;

/// Shown under `celld calibrate blends --help`.
pub(super) const HELP: &str = "\
Before you start: empty the gripper, clear the arm's reach of people and things, keep a hand at the
emergency stop. An arm that is off is powered on and its brakes are released. The arm goes slowly
to a place over the table, then up, across, down and back, twice, at the speeds of the
configuration and at least 4 cm over everything that may lie on the table by the configuration.
Without --yes celld prints the places, and nothing moves.
  celld calibrate blends --config config/cell.yaml --yes
  celld-sim compare blends.csv blends.script --joint-tolerance 0.004 --time-tolerance 0.05
The last command runs in the calibration folder.
A real arm cuts corners only with this recording, with the same controller and software, and with
limits that are no larger: record again after an update and after you raise a limit. Gripper and
camera may be absent. Without calibration files celld uses the table position of the configuration.";

/// The joints are kept from so long before the first way on, s.
const BEFORE_S: f64 = 0.1;

/// Below this share of full speed a recording proves nothing of full speed.
const FULL_SPEED: f64 = 0.99;

/// Samples are kept that are at least so far apart, s; celld requests 125 a second.
const APART_S: f64 = 0.0035;

/// Records blends; returns the exit code.
pub(super) fn run(args: &TrialArgs, stop: Arc<AtomicBool>) -> u8 {
    let Some(config) = args.configuration() else { return 2 };
    if config.limits.blend_m <= 0.0 {
        complain(&format!("{}: limits.blend_m is 0, there is no blend to record", args.config.display()));
        return 2;
    }
    let yes = args.yes;
    with_runtime(stop, move |stop| async move { record(&config, yes, stop).await })
}

async fn record(config: &CellConfig, yes: bool, stop: Arc<AtomicBool>) -> Result<(), String> {
    let stopped = || stop.load(Ordering::Relaxed);
    let mut trial = Trial::ready(config, yes, "goes back, and all of it again", &stopped).await?;
    let crossings = trial.crossing.both_ways();
    let paths = crossings.iter().map(|crossing| trial.path(crossing)).collect::<Result<Vec<_>, _>>()?;
    let mut recorder = Recorder::default();
    trial.go(crossings, &mut recorder, &stopped).await?;
    complain(&recorder.program());
    let yaml = BlendRecording {
        paths,
        limits: limits(config),
        robot_serial: trial.arm.serial.clone(),
        software: trial.arm.software.clone(),
        date: utc::text(unix_now_s()),
    }
    .to_yaml();
    match judged(&trial.model.arm, &yaml, &recorder) {
        Ok((recording, csv)) => keep(config, &recording, &yaml, &csv),
        Err(why) => {
            // What was recorded before is no proof any more.
            let void = files::take_away(&config.calibration.blends).map_err(|error| chain(&error));
            let kept = void.err().map_or(String::new(), |error| format!("; {error}: remove it by hand"));
            Err(format!("{why}; no recording is kept, celld has the arm stop at each corner{kept}"))
        }
    }
}

/// Judges the texts that are read again at each start, and reports it; also the text of the joints, which
/// begins a moment before the first way.
fn judged(model: &ArmModel, yaml: &str, recorder: &Recorder) -> Result<(BlendRecording, String), String> {
    if let Some(share) = recorder.slowest_share.filter(|share| *share < FULL_SPEED) {
        return Err(format!("the speed slider or the limiter was at {:.0} %: record at 100 %", 1e2 * share));
    }
    let recording = BlendRecording::parse(yaml, "blends.yaml").map_err(|faults| faults.to_string())?;
    let passages = |csv: &str| {
        let passages = judge(model, &recording.paths, &joints::parse(csv)?);
        passages.map_err(|(way, fault)| format!("way {way}: {fault}"))
    };
    let whole = passages(&recorder.csv(f64::NEG_INFINITY))?;
    let csv = recorder.csv(whole.first().map_or(0.0, |passage| passage.begins_s) - BEFORE_S);
    passages(&csv)?.iter().enumerate().for_each(|(index, passage)| report(index + 1, passage));
    Ok((recording, csv))
}

fn keep(config: &CellConfig, recording: &BlendRecording, yaml: &str, csv: &str) -> Result<(), String> {
    let path = &config.calibration.blends;
    let (joints, moves) = (joints_file(path), script_file(path));
    if let Some(folder) = path.parent() {
        create_folder(folder).map_err(|error| chain(&error))?;
    }
    let script = script(&recording.paths);
    write_together(&[
        (joints.as_path(), csv.as_bytes()),
        (moves.as_path(), script.as_bytes()),
        (path.as_path(), yaml.as_bytes()),
    ])
    .map_err(|error| chain(&error))?;
    complain(&format!("wrote {}, {} and {}", path.display(), joints.display(), moves.display()));
    Ok(())
}

fn report(number: usize, passage: &Passage) {
    let Passage { seconds, off_m, fastest_m_s, allowed_m_s, .. } = passage;
    complain(&format!(
        "way {number}: {seconds:.2} s, at most {:.1} mm off, at most {fastest_m_s:.3} m/s of {allowed_m_s:.3}",
        mm_from_m(*off_m)
    ));
    for corner in &passage.corners {
        complain(&format!(
            "  blend of {:.1} mm: passed {:.1} mm from the corner, in at {:.3} m/s, out at {:.3}, slowest {:.3}",
            mm_from_m(corner.radius_m),
            mm_from_m(corner.cut_m),
            corner.enters_m_s,
            corner.leaves_m_s,
            corner.slowest_m_s,
        ));
    }
}

/// The same moves as a program, for `celld-sim compare`.
fn script(paths: &[SentPath]) -> String {
    let mut text = String::from("def blends():\n");
    let end = |path: &SentPath| path.segments.len();
    let numbered = paths.iter().flat_map(|path| (1..).zip(&path.segments).map(move |one| (end(path), one)));
    for (count, (number, segment)) in numbered {
        let (name, speed, acceleration) = match *segment {
            Segment::Joint { speed, acceleration, .. } => ("movej", speed, acceleration),
            Segment::Linear { speed, acceleration, .. } => ("movel", speed, acceleration),
        };
        let (q, blend) = (segment.target().0.map(|value| format!("{value:.6}")).join(", "), segment.blend());
        text += &format!("  {name}([{q}], a={acceleration:.6}, v={speed:.6}, r={blend:.6})\n");
        if number == count {
            text += "  sleep(0.5)\n";
        }
    }
    text + "end\n"
}

/// Records the arm's joints, and the on-robot program's size and start.
#[derive(Default)]
struct Recorder {
    samples: Vec<JointSample>,
    /// The longest text that was sent to the primary interface, and when.
    sent: Option<(usize, Timestamp)>,
    /// From then until a program plays, s.
    starts_s: Option<f64>,
    /// The least share of full speed at which the arm moved.
    slowest_share: Option<f64>,
}

impl Observer for Recorder {
    fn on(&mut self, now: Timestamp, scene: Scene) {
        match scene {
            Scene::Robot(state) => self.sample(now, state),
            Scene::Effect(Effect::Send(Link::Primary, bytes)) if self.is_longer(bytes) => {
                (self.sent, self.starts_s) = (Some((bytes.len(), now)), None);
            }
            _ => {}
        }
    }
}

impl Recorder {
    fn is_longer(&self, bytes: &[u8]) -> bool {
        self.sent.is_none_or(|(longest, _)| bytes.len() > longest)
    }

    fn sample(&mut self, now: Timestamp, state: &RobotState) {
        if let (Some((_, at)), None, RuntimeState::Playing) = (self.sent, self.starts_s, state.runtime_state)
        {
            self.starts_s = Some(now.since(at).as_secs_f64());
        }
        if state.runtime_state == RuntimeState::Playing && !state.stands_still() {
            let share = state.speed_share();
            self.slowest_share = Some(self.slowest_share.map_or(share, |least| least.min(share)));
        }
        let time_s = state.controller_time_s;
        if self.samples.last().is_some_and(|last| time_s - last.time_s < APART_S) {
            return;
        }
        let states = [state.robot_mode.code(), state.safety_mode.code(), state.runtime_state.code()];
        self.samples.push(JointSample { time_s, q: state.q.0, qd: state.qd, states });
    }

    fn program(&self) -> String {
        match (self.sent, self.starts_s) {
            (Some((bytes, _)), Some(starts_s)) => {
                format!("program: {bytes} bytes, plays {starts_s:.2} s after it was sent")
            }
            (Some((bytes, _)), None) => format!("program: {bytes} bytes"),
            (None, _) => "program: none was sent".to_string(),
        }
    }

    /// The samples from this time on, s.
    fn csv(&self, from_s: f64) -> String {
        let mut text = joints::header();
        let kept = self.samples.iter().filter(|sample| sample.time_s >= from_s);
        kept.for_each(|sample| text.push_str(&joints::line(sample)));
        text
    }
}
