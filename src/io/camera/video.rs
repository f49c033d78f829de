//! A video file as a camera.
//!
//! In: a file and the lens it was taken with. Out: frames numbered from 0 with the file's own time stamps.
//! Compressed video blurs corners: good for trying things out, not for measuring.

use crate::io::camera::reader::Reader;
use crate::io::camera::validator::FrameValidator;
use crate::io::camera::wire::Source;
use crate::io::camera::{CameraError, CameraSource, Frame};
use cell_vision::camera::CameraModel;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// How long a frame may take: far more than any does on a busy computer.
const LIMIT: Duration = Duration::from_secs(30);

/// Frames of a video file.
#[derive(Debug)]
pub struct VideoCamera {
    path: PathBuf,
    reader: Reader,
    next: u64,
    lens: Option<CameraModel>,
    watch: FrameValidator,
}

impl VideoCamera {
    /// Opens the file; the lens has to come from a calibration.
    ///
    /// # Errors
    /// `File` if there is no such file, `Video` if it is no video that OpenCV reads, `NoReader` without
    /// `celld-video`.
    pub fn open(path: &Path, lens: Option<CameraModel>) -> Result<VideoCamera, CameraError> {
        std::fs::metadata(path).map_err(|source| CameraError::File { path: path.to_owned(), source })?;
        let reader = Reader::open(&Source::Video { path: path.to_owned() }, LIMIT)?;
        Ok(VideoCamera { path: path.to_owned(), reader, next: 0, lens, watch: FrameValidator::default() })
    }

    /// A file is not unplugged.
    fn in_time(&self, error: CameraError) -> CameraError {
        match error {
            CameraError::Silent { limit, .. } => CameraError::Video {
                path: self.path.clone(),
                what: format!("a frame was not decoded within {limit:?}"),
                source: None,
            },
            other => other,
        }
    }
}

impl CameraSource for VideoCamera {
    fn intrinsics(&mut self) -> Result<CameraModel, CameraError> {
        let place = || self.path.display().to_string();
        self.lens.clone().ok_or_else(|| CameraError::NoIntrinsics { place: place() })
    }

    fn grab(&mut self) -> Result<Frame, CameraError> {
        let source = self.path.display().to_string();
        let Some(time_ms) = self.reader.grab().map_err(|error| self.in_time(error))? else {
            return Err(CameraError::EndOfRecording { place: source, frames: self.next });
        };
        let image = self.reader.picture().map_err(|error| self.in_time(error))?;
        let time_s = time_ms.max(0.0) / 1e3;
        let frame = Frame { image, sequence: self.next, time_s, source, depth: None };
        self.next += 1;
        self.watch.check(&frame, self.lens.as_ref())?;
        Ok(frame)
    }

    fn is_live(&self) -> bool {
        false
    }

    /// Goes on with the next frame, where what reads it has not ended.
    fn reopen(&mut self) -> Result<(), CameraError> {
        Ok(())
    }
}
