//! A video file as a camera, read by OpenCV.
//!
//! In: a file and the lens it was taken with. Out: frames numbered from 0 with the file's own time stamps.
//! Compressed video blurs corners: good for trying things out, not for measuring. Only the FFmpeg reader is
//! used: the others guess at file names and write their guesses to the log.

use crate::io::camera::mat::{image_of, video_error};
use crate::io::camera::validator::FrameValidator;
use crate::io::camera::{CameraError, CameraSource, Frame};
use cell_vision::camera::CameraModel;
use opencv::core::{Mat, MatTraitConst};
use opencv::videoio::{
    CAP_FFMPEG, CAP_PROP_POS_MSEC, VideoCapture, VideoCaptureTrait, VideoCaptureTraitConst,
};
use std::path::{Path, PathBuf};

/// Frames of a video file.
#[derive(Debug)]
pub struct VideoCamera {
    path: PathBuf,
    capture: VideoCapture,
    next: u64,
    lens: Option<CameraModel>,
    watch: FrameValidator,
}

impl VideoCamera {
    /// Opens the file; the lens has to come from a calibration.
    ///
    /// # Errors
    /// `File` if there is no such file, `Video` if it is no video that OpenCV reads.
    pub fn open(path: &Path, lens: Option<CameraModel>) -> Result<VideoCamera, CameraError> {
        std::fs::metadata(path).map_err(|source| CameraError::File { path: path.to_owned(), source })?;
        let failed = |what, source| video_error(path, what, source);
        let capture = VideoCapture::from_file(path, CAP_FFMPEG)
            .map_err(|source| failed("OpenCV refuses it", Some(source)))?;
        if !capture.is_opened().unwrap_or(false) {
            return Err(failed("it is no video of a known kind", None));
        }
        Ok(VideoCamera { path: path.to_owned(), capture, next: 0, lens, watch: FrameValidator::default() })
    }

    fn failed(&self, what: &'static str, source: Option<opencv::Error>) -> CameraError {
        video_error(&self.path, what, source)
    }
}

impl CameraSource for VideoCamera {
    fn intrinsics(&mut self) -> Result<CameraModel, CameraError> {
        let place = || self.path.display().to_string();
        self.lens.clone().ok_or_else(|| CameraError::NoIntrinsics { place: place() })
    }

    fn grab(&mut self) -> Result<Frame, CameraError> {
        let mut mat = Mat::default();
        let time_ms = self.capture.get(CAP_PROP_POS_MSEC).unwrap_or(0.0);
        let read = self.capture.read(&mut mat);
        let place = self.path.display().to_string();
        match read {
            Ok(true) if !mat.empty() => {}
            Ok(_) => return Err(CameraError::EndOfRecording { place, frames: self.next }),
            Err(source) => return Err(self.failed("a frame cannot be decoded", Some(source))),
        }
        let image = image_of(&mat).map_err(|source| match source {
            Some(source) => self.failed("a frame has no pixels", Some(source)),
            None => self.failed("a frame is not 8 bit colour", None),
        })?;
        let time_s = time_ms.max(0.0) / 1e3;
        let frame = Frame { image, sequence: self.next, time_s, source: place, depth: None };
        self.next += 1;
        self.watch.check(&frame, self.lens.as_ref())?;
        Ok(frame)
    }

    fn is_live(&self) -> bool {
        false
    }

    /// Goes on with the next frame.
    fn reopen(&mut self) -> Result<(), CameraError> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use opencv::core::{Scalar, Size};
    use opencv::videoio::{VideoWriter, VideoWriterTrait};

    #[test]
    fn a_video_is_read_to_its_end_in_the_right_colours() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("looks.avi");
        let fourcc = VideoWriter::fourcc('M', 'J', 'P', 'G').unwrap();
        let size = Size::new(64, 48);
        let mut writer = VideoWriter::new(&path, fourcc, 10.0, size, true).unwrap();
        for i in 0..3 {
            let blue_green_red = Scalar::new(20.0, 40.0, 160.0 + 30.0 * f64::from(i), 0.0);
            let typ = opencv::core::CV_8UC3;
            writer.write(&Mat::new_rows_cols_with_default(48, 64, typ, blue_green_red).unwrap()).unwrap();
        }
        writer.release().unwrap();
        let mut camera = VideoCamera::open(&path, None).unwrap();
        for i in 0..3 {
            let frame = camera.grab().unwrap();
            assert_eq!((frame.sequence, frame.image.width, frame.image.height), (i, 64, 48));
            let [red, green, blue] = frame.image.pixel(10, 10).unwrap();
            assert!(red > 150 && green < 60 && blue < 50, "{red} {green} {blue}");
        }
        assert!(matches!(camera.grab(), Err(CameraError::EndOfRecording { frames: 3, .. })));
        assert!(matches!(camera.intrinsics(), Err(CameraError::NoIntrinsics { .. })));
    }

    #[test]
    fn no_file_and_no_video_are_errors() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("none.avi");
        assert!(matches!(VideoCamera::open(&path, None), Err(CameraError::File { .. })));
        std::fs::write(&path, b"not a video").unwrap();
        assert!(matches!(VideoCamera::open(&path, None), Err(CameraError::Video { .. })));
    }
}
