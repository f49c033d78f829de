//! A calibration round in a folder: its pictures, poses and lens, written as the round goes and read again.
//!
//! In: the stops of a round; a folder that holds one. Out: the files; the samples with the markers of each
//! picture, or a sentence that names the file. A recorded round can be solved again without moving the arm.

use crate::config::pictures::{read_camera, read_picture};
use cell_calibration::files::camera::CameraCalibration;
use cell_calibration::files::hand_eye::Provenance;
use cell_calibration::files::round::{RecordedSample, Round};
use cell_calibration::fit::Sample;
use cell_calibration::visit::Stop;
use cell_edge::files;
use cell_values::image::Image;
use cell_vision::camera::CameraModel;
use cell_vision::detect::{DetectSettings, Detector};
use rearrange::document::chain::chain;
use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Sender, channel};
use std::thread::JoinHandle;

/// Poses and names of a recorded round's pictures, in its folder.
pub const SAMPLES: &str = "samples.yaml";

/// The camera's lens, in the same folder.
const LENS: &str = "camera.yaml";

/// A round being kept in a folder. Pictures are written by a thread of their own: the robot must not be left
/// unheard for as long as a picture takes to pack.
pub struct Recording {
    folder: PathBuf,
    kept: RefCell<Vec<RecordedSample>>,
    pictures: Sender<(PathBuf, Image)>,
    writer: JoinHandle<Result<(), String>>,
}

impl Recording {
    /// The folder is made, and the poses of an earlier round in it are removed.
    ///
    /// # Errors
    /// What the system refused.
    pub fn new(folder: &Path) -> Result<Recording, String> {
        files::create_folder(folder).map_err(|error| chain(&error))?;
        // The poses of an earlier round there must not be taken for those of the new pictures, should this
        // one break off.
        files::remove(&folder.join(SAMPLES)).map_err(|error| chain(&error))?;
        let (pictures, taken) = channel::<(PathBuf, Image)>();
        let write = move || {
            let mut outcome = Ok(());
            for (path, image) in taken {
                let bytes = image.encode_png().map_err(|error| format!("{}: {error}", path.display()));
                let written =
                    bytes.and_then(|bytes| files::write_atomic(&path, &bytes).map_err(|error| chain(&error)));
                // The first fault is the one to report.
                outcome = outcome.and(written);
            }
            outcome
        };
        let writer = std::thread::spawn(write);
        Ok(Recording { folder: folder.to_path_buf(), kept: RefCell::default(), pictures, writer })
    }

    /// Keeps a stop of the round.
    pub fn keep(&self, look: &Stop) {
        let image = format!("{:02}.png", look.pose);
        // It only hangs up when it has panicked, and then `close` says so.
        let _ = self.pictures.send((self.folder.join(&image), look.image.clone()));
        self.kept.borrow_mut().push(RecordedSample { image, base_from_flange: look.sample.base_from_flange });
    }

    /// Waits for the pictures and writes the poses and the lens beside them; how many stops were kept.
    ///
    /// # Errors
    /// A picture or file that could not be written.
    pub fn close(self, lens: &CameraCalibration, provenance: &Provenance) -> Result<usize, String> {
        drop(self.pictures);
        self.writer.join().map_err(|_| "a picture of the round could not be written".to_string())??;
        let round = Round { provenance: provenance.clone(), samples: self.kept.take() };
        let put = |name: &str, text: String| {
            files::write_atomic(&self.folder.join(name), text.as_bytes()).map_err(|error| chain(&error))
        };
        put(LENS, lens.to_yaml())?;
        put(SAMPLES, round.to_yaml())?;
        Ok(round.samples.len())
    }
}

/// A recorded round as it lies in its folder.
pub struct RecordedRound {
    folder: PathBuf,
    /// Poses and names of the pictures.
    pub round: Round,
    /// The lens of the camera that took them, as recorded.
    pub own: CameraModel,
}

impl RecordedRound {
    /// Reads what lies beside the pictures.
    ///
    /// # Errors
    /// A file that is missing, broken, or of another camera.
    pub fn read(folder: &Path) -> Result<RecordedRound, String> {
        let path = folder.join(SAMPLES);
        let name = path.display().to_string();
        let text = files::read_named(&path, 16 << 20).map_err(|error| {
            format!("{}; a round is recorded with `celld calibrate hand-eye --record DIR`", chain(&error))
        })?;
        let round = Round::parse(&text, &name).map_err(|complaints| complaints.to_string())?;
        let own = read_camera(&folder.join(LENS))?;
        if own.serial != round.provenance.camera_serial {
            let wanted = &round.provenance.camera_serial;
            return Err(format!(
                "{name}: recorded with camera {wanted}, but camera.yaml beside it is of {}",
                own.serial
            ));
        }
        Ok(RecordedRound { folder: folder.to_path_buf(), round, own })
    }

    /// Finds the markers in the pictures, which have to be of this lens. `progress` is called with each
    /// sample's number from 1, its picture's name and how many markers are in it.
    ///
    /// # Errors
    /// A picture that cannot be read or is of another size, or a detector that failed.
    pub fn samples(
        &self,
        lens: &CameraModel,
        progress: &dyn Fn(usize, &str, usize),
    ) -> Result<Vec<Sample>, String> {
        let settings = DetectSettings::default();
        let mut detector = Detector::new(settings).map_err(|error| error.to_string())?;
        let mut samples = Vec::with_capacity(self.round.samples.len());
        for (index, recorded) in self.round.samples.iter().enumerate() {
            let file = self.folder.join(&recorded.image);
            let image = read_picture(&file)?;
            let fits = lens.check_picture(image.width, image.height);
            fits.map_err(|error| format!("{}: {error}", file.display()))?;
            let detections = detector.detect(&image.gray()).map_err(|error| error.to_string())?;
            progress(index + 1, &recorded.image, detections.len());
            samples.push(Sample { base_from_flange: recorded.base_from_flange, detections });
        }
        Ok(samples)
    }
}
