//! `celld calibrate blends`: how this controller passes corners that are cut, recorded and judged.
//!
//! In: the cell's configuration, a live robot; gripper and camera need not be there. Out: the arm moves over
//! the table, up, across and down again and back, twice; `blends.yaml` and `blends.csv` in the calibration
//! folder if it stayed within what paths are checked for; figures of the on-robot program on the way. Until
//! then a real arm stops at each corner (`config::blends`).

use crate::cli::calibrate::trial::{Trial, TrialArgs};
use crate::cli::daemon::with_runtime;
use crate::config::blends::{joints_file, script_file};
use crate::config::cell::CellConfig;
use crate::daemon::shell::{Observer, Scene};
use crate::jobs::utc;
use cell_calibration::blends::{JointTrack, Passage, SentPath, judge};
use cell_calibration::files::blends::BlendRecording;
use cell_calibration::files::joints::{self, JointSample};
use cell_edge::clock::unix_now_s;
use cell_edge::files::create_folder;
use cell_edge::terminal::complain;
use cell_edge::together::write_together;
use cell_machine::device::robot_types::{Link, RobotState};
use cell_machine::event::{Arm, Effect};
use cell_motion::path::Segment;
use cell_values::time::Timestamp;
use cell_values::units::{Joints, mm_from_m};
use rearrange::document::chain::chain;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use ur_wire::enumerations::RuntimeState;

/// Shown under `celld calibrate blends --help`.
pub(super) const HELP: &str = "\
The arm moves at the speeds of the configuration: slowly to a place over the table, then twice
up, across and down to another place and back, at least 5 cm over everything that the
configuration says may lie there. Nothing hangs on the gripper, the arm's reach is free of people.
Without --yes the places are printed and nothing moves. Gripper, camera and calibration files need
not be there; the table is where the configuration draws it then.
  celld calibrate blends --config config/cell.yaml --yes
  celld-sim compare blends.csv blends.script    # in the calibration folder: the simulated arm beside it
celld cuts corners on a real arm only with this recording, and with the same controller and
software: after an update, record again.";

/// The recording begins so long before the first way, s.
const BEFORE_S: f64 = 0.1;

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
    let mut trial = Trial::ready(config, yes, "back, twice", &stopped).await?;
    let crossings = trial.crossing.both_ways();
    let paths = crossings.iter().map(|crossing| trial.path(crossing)).collect::<Result<Vec<_>, _>>()?;
    let mut recorder = Recorder::default();
    trial.go(crossings, &mut recorder, &stopped).await?;
    complain(&recorder.program());
    let judged = judge(&trial.model.arm, &paths, &recorder.track()).map_err(|(path, fault)| {
        format!("way {path}: {fault}; nothing was written, the arm goes on stopping at corners")
    });
    let passages = judged?;
    passages.iter().enumerate().for_each(|(index, passage)| report(index + 1, passage));
    let begins_s = passages.first().map_or(0.0, |passage| passage.begins_s);
    keep(config, &trial.arm, paths, &recorder.csv(begins_s))
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

fn keep(config: &CellConfig, arm: &Arm, paths: Vec<SentPath>, csv: &str) -> Result<(), String> {
    let file = BlendRecording {
        paths,
        robot_serial: arm.serial.clone(),
        software: arm.software.clone(),
        date: utc::text(unix_now_s()),
    };
    let path = &config.calibration.blends;
    let joints = joints_file(path);
    if let Some(folder) = path.parent() {
        create_folder(folder).map_err(|error| chain(&error))?;
    }
    let (yaml, script) = (file.to_yaml(), script(&file.paths));
    // The joints first: a recording of the last time does not fit the new paths.
    let moves = script_file(path);
    write_together(&[
        (joints.as_path(), csv.as_bytes()),
        (moves.as_path(), script.as_bytes()),
        (path.as_path(), yaml.as_bytes()),
    ])
    .map_err(|error| chain(&error))?;
    complain(&format!("wrote {}, {} and {}", path.display(), joints.display(), moves.display()));
    Ok(())
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

/// Keeps the joints, and what is seen of the on-robot program.
#[derive(Default)]
struct Recorder {
    samples: Vec<JointSample>,
    /// The longest of what was sent to the primary interface, and when.
    sent: Option<(usize, Timestamp)>,
    /// From then until a program plays, s.
    starts_s: Option<f64>,
}

impl Observer for Recorder {
    fn on(&mut self, now: Timestamp, scene: Scene) {
        match scene {
            Scene::Robot(state) => self.sample(now, state),
            Scene::Effect(Effect::Send(link, bytes)) if *link == Link::Primary => {
                self.sent = Some((bytes.len(), now));
                self.starts_s = None;
            }
            _ => {}
        }
    }
}

impl Recorder {
    fn sample(&mut self, now: Timestamp, state: &RobotState) {
        if let (Some((_, at)), None, RuntimeState::Playing) = (self.sent, self.starts_s, state.runtime_state)
        {
            self.starts_s = Some(now.since(at).as_secs_f64());
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

    fn track(&self) -> JointTrack {
        JointTrack {
            times_s: self.samples.iter().map(|sample| sample.time_s).collect(),
            joints: self.samples.iter().map(|sample| Joints(sample.q)).collect(),
        }
    }

    /// From a moment before `begins_s` on: without the way to where the arm set out.
    fn csv(&self, begins_s: f64) -> String {
        let mut text = joints::header();
        let kept = self.samples.iter().filter(|sample| sample.time_s >= begins_s - BEFORE_S);
        kept.for_each(|sample| text.push_str(&joints::line(sample)));
        text
    }
}
