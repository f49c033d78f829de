//! The recording of a run: the daemon's events into one MCAP file.
//!
//! In: events as they happen. Out: the file, and at the end what went wrong with it, if anything did. A
//! recording that fails never stops a run, and never silently: the first fault is kept. Pictures are turned
//! into PNG on a thread of their own, for it takes tens of milliseconds in which the robot would get no
//! message from us.

use crate::config::cell::RecordingConfig;
use crate::daemon::messages::Displayed;
use crate::daemon::shell::Scene;
use crate::io::recording::{PictureFormat, RecordedObject, Recording, RecordingError, Severity};
use crate::jobs::utc;
use cell_edge::clock::unix_now_s;
use cell_edge::priority;
use cell_values::image::Image;
use cell_values::time::{Duration, Timestamp};
use cell_vision::observe::Observation;
use serde_json::json;
use std::path::Path;
use std::sync::mpsc::{Receiver, SyncSender, channel, sync_channel};
use std::thread::JoinHandle;

/// How often joint states are recorded, in the cell's time.
const JOINTS_EVERY: Duration = Duration::from_millis(40);

/// Pictures that may wait for the encoder: 90 MB at most.
const WAITING_PICTURES: usize = 32;

/// A picture with the time it was taken, before and after encoding.
type Picture = (Timestamp, Image);
type EncodedPicture = (Timestamp, Vec<u8>);

/// The thread that encodes.
struct Encoder {
    pictures: SyncSender<Picture>,
    encoded: Receiver<EncodedPicture>,
    thread: JoinHandle<()>,
}

/// A new file in the recording folder, named by the time.
///
/// # Errors
/// A folder or file that cannot be made: the operator who requests a recording wants to know before, not
/// after.
pub fn start(config: &RecordingConfig) -> Result<Recorder, String> {
    std::fs::create_dir_all(&config.folder)
        .map_err(|error| format!("{}: {error}", config.folder.display()))?;
    let name = format!("run-{}.mcap", utc::text(unix_now_s()).replace(':', ""));
    let recorder = Recorder::create(&config.folder.join(name), config.pictures);
    match recorder.fault() {
        Some(fault) => Err(format!("recording: {fault}")),
        None => Ok(recorder),
    }
}

/// Writes a run down.
pub struct Recorder {
    recording: Option<Recording>,
    encoder: Option<Encoder>,
    last_joints: Timestamp,
    dropped: usize,
    fault: Option<String>,
}

impl Recorder {
    /// Creates the file; `pictures`: also what the camera saw. A file that cannot be created is the first
    /// fault.
    pub fn create(path: &Path, pictures: bool) -> Recorder {
        let (recording, fault) = match Recording::create(path, unix_now_s()) {
            Ok(recording) => (Some(recording), None),
            Err(error) => (None, Some(rearrange::document::chain::chain(&error))),
        };
        Recorder {
            recording,
            encoder: pictures.then(encoder),
            last_joints: Timestamp::ZERO,
            dropped: 0,
            fault,
        }
    }

    /// What is wrong with the recording so far.
    pub fn fault(&self) -> Option<&str> {
        self.fault.as_deref()
    }

    /// Takes one event in.
    pub fn on(&mut self, now: Timestamp, scene: &Scene) {
        self.write_encoded();
        match scene {
            Scene::Notice(notice) => {
                let severity = if notice.alarm { Severity::Warning } else { Severity::Info };
                self.write(|recording| recording.log(now, severity, "cell", &notice.text));
            }
            Scene::Displayed(Displayed::Picture { image, .. } | Displayed::Sample { image, .. }) => {
                self.picture(now, image)
            }
            Scene::Displayed(Displayed::Observed(observation)) => {
                let objects = recorded(observation);
                self.write(|recording| recording.arrangement(now, "camera", &objects));
            }
            Scene::Route(route) => {
                let steps: Vec<_> = route
                    .iter()
                    .map(|s| json!({"object": s.object, "from": s.from, "to": s.to, "goal": s.to_goal}))
                    .collect();
                self.write(|recording| recording.plan(now, &json!({ "actions": steps })));
            }
            Scene::Robot(state) if now.since(self.last_joints) >= JOINTS_EVERY => {
                self.last_joints = now;
                self.write(|recording| recording.joints(now, &state.q, &state.qd));
            }
            Scene::Ended(report) => {
                let text = format!("job {} ended: {}: {}", report.id, report.code_text(), report.message);
                self.write(|recording| recording.log(now, Severity::Info, "cell", &text));
            }
            Scene::Robot(_) | Scene::Status(_) => {}
        }
    }

    /// Waits for pictures still being encoded, ends the file, and says what went wrong with it.
    pub fn close(&mut self) -> Option<String> {
        if let Some(Encoder { pictures, encoded, thread }) = self.encoder.take() {
            drop(pictures);
            for (taken, png) in encoded {
                self.write(|recording| recording.picture(taken, PictureFormat::Png, &png));
            }
            // A panic in it was printed when it happened.
            let _ = thread.join();
        }
        if let Some(Err(error)) = self.recording.take().map(Recording::finish) {
            self.keep_fault(&error);
        }
        if self.dropped > 0 && self.fault.is_none() {
            self.fault = Some(format!("{} pictures came faster than they could be encoded", self.dropped));
        }
        self.fault.take()
    }

    fn picture(&mut self, now: Timestamp, image: &Image) {
        let Some(encoder) = &self.encoder else { return };
        if encoder.pictures.try_send((now, image.clone())).is_err() {
            self.dropped += 1;
        }
    }

    fn write_encoded(&mut self) {
        while let Some((taken, png)) =
            self.encoder.as_ref().and_then(|encoder| encoder.encoded.try_recv().ok())
        {
            self.write(|recording| recording.picture(taken, PictureFormat::Png, &png));
        }
    }

    /// Writes; the first failure ends the recording.
    fn write(&mut self, write: impl FnOnce(&mut Recording) -> Result<(), RecordingError>) {
        if let Some(Err(error)) = self.recording.as_mut().map(write) {
            self.recording = None;
            self.keep_fault(&error);
        }
    }

    fn keep_fault(&mut self, error: &RecordingError) {
        self.fault.get_or_insert_with(|| rearrange::document::chain::chain(error));
    }
}

fn recorded(observation: &Observation) -> Vec<RecordedObject> {
    let object = |o: &cell_vision::observe::ObjectEstimate| RecordedObject {
        id: o.id.clone(),
        x: o.pose.x,
        y: o.pose.y,
        theta: o.pose.theta,
        std_xy_m: o.std_xy_m,
        std_theta_rad: o.std_theta_rad,
    };
    observation.objects.iter().map(object).collect()
}

/// Starts the thread that turns pictures into PNG; it ends when no more can come.
fn encoder() -> Encoder {
    let (pictures, waiting) = sync_channel::<Picture>(WAITING_PICTURES);
    let (encoded_in, encoded) = channel();
    let thread = std::thread::spawn(move || {
        priority::lower();
        for (taken, picture) in waiting {
            // A picture that cannot be encoded is a fault of this program, and no reason to stop an arm.
            let Ok(png) = picture.encode_png() else { continue };
            if encoded_in.send((taken, png)).is_err() {
                return;
            }
        }
    });
    Encoder { pictures, encoded, thread }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cell::supervisor::input::Notice;

    fn pictures_in(path: &Path) -> usize {
        let bytes = std::fs::read(path).unwrap();
        let messages = mcap::MessageStream::new(&bytes).unwrap();
        messages.filter(|message| message.as_ref().unwrap().channel.topic == "/camera/image").count()
    }

    #[test]
    fn the_last_pictures_are_in_the_file_even_when_it_is_closed_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.mcap");
        let mut recorder = Recorder::create(&path, true);
        let image = Image::filled(64, 48, [10, 20, 30]);
        for k in 0..5 {
            let now = Timestamp::from_secs_f64(f64::from(k));
            let displayed = Displayed::Picture { image: image.clone(), views: Vec::new() };
            recorder.on(now, &Scene::Displayed(&displayed));
        }
        assert_eq!(recorder.close(), None);
        assert_eq!(pictures_in(&path), 5);
    }

    #[test]
    fn a_recording_that_cannot_be_made_is_reported() {
        let folder = tempfile::tempdir().unwrap();
        let mut recorder = Recorder::create(&folder.path().join("missing/run.mcap"), false);
        let notice = Notice { alarm: true, text: "x".to_string() };
        recorder.on(Timestamp::ZERO, &Scene::Notice(&notice));
        assert!(recorder.close().is_some_and(|fault| fault.contains("run.mcap")));
    }
}
