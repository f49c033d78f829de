//! A camera that may come after the program: opened when it is first there.
//!
//! In: how it is opened. Out: a source that answers with the reason while the camera is away and is the
//! camera from then on. A cell must not go down because the camera is plugged in a minute later than the
//! computer.

use crate::io::camera::{CameraError, CameraSource, FaultKind, Frame};
use cell_vision::camera::CameraModel;

/// How the camera is opened.
pub type Open = Box<dyn FnMut() -> Result<Box<dyn CameraSource>, CameraError> + Send>;

/// A camera that may still be away.
pub struct LateCamera {
    open: Open,
    camera: Option<Box<dyn CameraSource>>,
    wants_depth: bool,
}

impl LateCamera {
    /// Opens it now or, when it is away, later: each requested picture and each reconnection tries again.
    /// With it, why it is away.
    ///
    /// # Errors
    /// What waiting does not mend: another serial number, a setting it lacks, no SDK, a recording that is
    /// not there.
    pub fn open(mut open: Open) -> Result<(LateCamera, Option<CameraError>), CameraError> {
        let (camera, away) = match open() {
            Ok(camera) => (Some(camera), None),
            Err(error) if error.kind() == FaultKind::Unplugged || error.is_crash() => (None, Some(error)),
            Err(error) => return Err(error),
        };
        Ok((LateCamera { open, camera, wants_depth: true }, away))
    }

    fn camera(&mut self) -> Result<&mut Box<dyn CameraSource>, CameraError> {
        let camera = match self.camera.take() {
            Some(camera) => camera,
            None => {
                let mut camera = (self.open)()?;
                camera.want_depth(self.wants_depth);
                camera
            }
        };
        Ok(self.camera.insert(camera))
    }
}

impl CameraSource for LateCamera {
    fn intrinsics(&mut self) -> Result<CameraModel, CameraError> {
        self.camera()?.intrinsics()
    }

    fn grab(&mut self) -> Result<Frame, CameraError> {
        self.camera()?.grab()
    }

    fn want_depth(&mut self, wanted: bool) {
        self.wants_depth = wanted;
        if let Some(camera) = &mut self.camera {
            camera.want_depth(wanted);
        }
    }

    fn serial(&mut self) -> Result<String, CameraError> {
        self.camera()?.serial()
    }

    /// Only live cameras can be away.
    fn is_live(&self) -> bool {
        self.camera.as_ref().is_none_or(|camera| camera.is_live())
    }

    fn reopen(&mut self) -> Result<(), CameraError> {
        match &mut self.camera {
            Some(camera) => camera.reopen(),
            None => self.camera().map(|_| ()),
        }
    }

    fn can_reset(&self) -> bool {
        self.camera.as_ref().is_some_and(|camera| camera.can_reset())
    }

    fn reset(&mut self) -> Result<(), CameraError> {
        self.camera()?.reset()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::camera::folder::FolderCamera;
    use cell_values::image::Image;
    use std::path::Path;

    fn away() -> CameraError {
        CameraError::NotConnected { wanted: "A1".into(), found: "none".into() }
    }

    fn folder_at(path: &Path) -> Result<Box<dyn CameraSource>, CameraError> {
        Ok(Box::new(FolderCamera::open(path, None)?))
    }

    #[test]
    fn a_camera_that_comes_later_is_taken_when_it_is_there() {
        let folder = tempfile::tempdir().unwrap();
        let picture = folder.path().join("1.png");
        std::fs::write(&picture, Image::filled(64, 64, [180; 3]).encode_png().unwrap()).unwrap();
        let path = folder.path().to_owned();
        let mut tries = 0;
        let open = move || {
            tries += 1;
            if tries < 3 { Err(away()) } else { folder_at(&path) }
        };
        let (mut camera, why) = LateCamera::open(Box::new(open)).unwrap();
        assert!(matches!(why, Some(CameraError::NotConnected { .. })) && camera.is_live());
        assert!(!camera.can_reset(), "what is away cannot be restarted");
        assert_eq!(camera.grab().unwrap_err().kind(), FaultKind::Unplugged);
        camera.reopen().unwrap();
        assert_eq!(camera.grab().unwrap().sequence, 0);
        assert!(!camera.is_live(), "a folder is a recording");
        // It stays the same camera: opened anew it would begin again.
        assert!(matches!(camera.grab(), Err(CameraError::EndOfRecording { .. })));
    }

    #[test]
    fn a_crash_of_the_sdk_does_not_end_the_start() {
        let crash = || {
            Err(CameraError::Crashed {
                place: "D405".into(),
                how: std::os::unix::process::ExitStatusExt::from_raw(6),
            })
        };
        let (_, why) = LateCamera::open(Box::new(crash)).unwrap();
        assert_eq!(why.unwrap().to_string(), "D405: the RealSense SDK crashed (signal: 6 (SIGABRT))");
    }

    #[test]
    fn what_waiting_does_not_mend_is_reported_at_once() {
        let wrong = || {
            let (found, wanted) = ("1".into(), "2".into());
            Err(CameraError::OtherSerial { address: "usb".into(), found, wanted })
        };
        assert!(matches!(LateCamera::open(Box::new(wrong)), Err(CameraError::OtherSerial { .. })));
    }
}
