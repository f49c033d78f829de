//! The camera that the configuration names, opened and under supervision.
//!
//! In: the configuration's devices, the lens where a calibration is to be used. Out: a source that gives
//! usable pictures or reports what is wrong; and what is reported of that to the supervisor.

use crate::config::cell::{CameraDevice, Devices};
use crate::io::camera::folder::FolderCamera;
use crate::io::camera::http::HttpCamera;
use crate::io::camera::late::LateCamera;
use crate::io::camera::monitored::MonitoredCamera;
use crate::io::camera::realsense::RealSenseCamera;
use crate::io::camera::snapshot::SnapshotCamera;
use crate::io::camera::uvc::UvcCamera;
use crate::io::camera::video::VideoCamera;
use crate::io::camera::{CameraError, CameraSource, FaultKind};
use cell_machine::code::Code;
use cell_machine::supervisor::input::CameraFault;
use cell_vision::camera::CameraModel;
use rearrange::document::chain::chain;
use std::time::Duration;

/// How long a frame of the simulator may take, wall time: it may have to be rendered on a busy computer, for
/// which simulated time is held.
const SIMULATOR_LIMIT: Duration = Duration::from_secs(60);
/// And one of a camera: none takes that long, and there has to be time left for connecting anew.
const CAMERA_LIMIT: Duration = Duration::from_secs(4);

/// Opens the camera of the configuration.
///
/// # Errors
/// Why it cannot be opened.
pub fn open_camera(devices: &Devices, lens: Option<CameraModel>) -> Result<MonitoredCamera, CameraError> {
    Ok(MonitoredCamera::new(open_source(&devices.camera, lens)?, devices.picture_limits))
}

/// The same, but a camera that is away may come later; with it, why it is away.
///
/// # Errors
/// What waiting does not mend.
pub fn open_when_there(
    devices: &Devices,
    lens: &CameraModel,
) -> Result<(MonitoredCamera, Option<CameraError>), CameraError> {
    let (device, lens) = (devices.camera.clone(), lens.clone());
    let (camera, away) = LateCamera::open(Box::new(move || open_source(&device, Some(lens.clone()))))?;
    Ok((MonitoredCamera::new(Box::new(camera), devices.picture_limits), away))
}

fn open_source(
    device: &CameraDevice,
    lens: Option<CameraModel>,
) -> Result<Box<dyn CameraSource>, CameraError> {
    Ok(match device {
        CameraDevice::Simulator { host, port, depth } => {
            let mut camera = HttpCamera::new(&format!("http://{host}:{port}"), SIMULATOR_LIMIT);
            if *depth {
                camera = camera.with_depth();
            }
            Box::new(match lens {
                Some(lens) => camera.with_lens(lens),
                None => camera,
            })
        }
        CameraDevice::Http { url, serial } => {
            Box::new(SnapshotCamera::open(url, serial, CAMERA_LIMIT, lens)?)
        }
        CameraDevice::RealSense(settings) => {
            Box::new(RealSenseCamera::open(settings.clone(), CAMERA_LIMIT, lens)?)
        }
        CameraDevice::Folder { path } => Box::new(FolderCamera::open(path, lens)?),
        CameraDevice::Uvc(settings) => Box::new(UvcCamera::open(settings.clone(), CAMERA_LIMIT, lens)?),
        CameraDevice::Video { path } => Box::new(VideoCamera::open(path, lens)?),
    })
}

/// The result code of a camera's fault.
fn code_of(kind: FaultKind) -> Code {
    match kind {
        FaultKind::Unplugged => Code::CameraUnplugged,
        FaultKind::Frozen => Code::CameraFrozen,
        FaultKind::Repeated => Code::CameraRepeats,
        FaultKind::Broken => Code::CameraBrokenPicture,
        FaultKind::Dark => Code::CameraDark,
        FaultKind::Overexposed => Code::CameraOverexposed,
        FaultKind::Flat => Code::CameraSeesNothing,
        FaultKind::Blurred => Code::CameraBlurred,
        FaultKind::Misfit => Code::CameraMisfit,
        FaultKind::Ended => Code::RecordingEnded,
    }
}

/// What is reported to the supervisor of a camera that gives no picture.
pub fn fault_of(error: &CameraError) -> CameraFault {
    let kind = error.kind();
    let lasting = match kind {
        FaultKind::Misfit | FaultKind::Ended => true,
        FaultKind::Unplugged
        | FaultKind::Frozen
        | FaultKind::Repeated
        | FaultKind::Broken
        | FaultKind::Dark
        | FaultKind::Overexposed
        | FaultKind::Flat
        | FaultKind::Blurred => false,
    };
    CameraFault { code: code_of(kind), message: chain(error), hint: kind.hint().into(), lasting }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::camera::Exposure;
    use crate::io::camera::UvcSettings;
    use crate::io::camera::realsense::RealSenseSettings;
    use cell_values::image::Image;
    use cell_values::image::quality::{PictureFault, PictureLimits};
    use std::path::PathBuf;

    fn devices(camera: CameraDevice) -> Devices {
        Devices {
            robot_host: "127.0.0.1".into(),
            gripper_host: "127.0.0.1".into(),
            gripper_port: 502,
            gripper_unit: 65,
            camera,
            picture_limits: PictureLimits::STANDARD,
        }
    }

    #[test]
    fn the_configured_camera_is_opened_and_its_pictures_are_judged() {
        let folder = tempfile::tempdir().unwrap();
        let mut good = Image::filled(64, 64, [180; 3]);
        (0..32 * 64).for_each(|i| good.set_pixel(16 + i % 32, i / 32, [10; 3]));
        for (name, picture) in [("1.png", good), ("2.png", Image::filled(64, 64, [4; 3]))] {
            std::fs::write(folder.path().join(name), picture.encode_png().unwrap()).unwrap();
        }
        let devices = devices(CameraDevice::Folder { path: folder.path().to_owned() });
        let mut camera = open_camera(&devices, None).unwrap();
        assert_eq!(camera.grab().unwrap().sequence, 0);
        let fault = fault_of(&camera.grab().unwrap_err());
        assert_eq!((fault.code, fault.lasting), (Code::CameraDark, false));
        assert!(fault.message.contains("2.png") && fault.hint.contains("light"), "{fault:?}");
        let fault = fault_of(&camera.grab().unwrap_err());
        assert_eq!((fault.code, fault.lasting), (Code::RecordingEnded, true));
    }

    #[test]
    fn every_fault_of_a_picture_has_the_code_that_the_closed_loop_knows() {
        for fault in [
            PictureFault::Dark { light: 1, limit: 50 },
            PictureFault::Overexposed { glare: 0.9, limit: 0.2 },
            PictureFault::Flat { contrast: 1, limit: 30 },
            PictureFault::Blurred { edge_px: 9.0, limit: 6.0 },
        ] {
            let code = Code::of_picture(&fault);
            let error = CameraError::Unusable { place: "camera".into(), sequence: 1, fault };
            assert_eq!(fault_of(&error).code, code);
            assert_eq!(error.kind().code(), code.as_str());
        }
    }

    #[test]
    fn what_cannot_be_opened_is_reported_at_once() {
        let gone = PathBuf::from("no/such/thing");
        let (serial, size, rate, exposure) = ("1".to_string(), [640, 480], 30, Exposure::Auto);
        let uvc = UvcSettings { device: gone.clone(), serial, size, rate, exposure };
        let realsense = RealSenseSettings {
            serial: None,
            file: None,
            library: Some(gone.clone()),
            size,
            rate,
            exposure,
            depth: false,
        };
        for camera in [
            CameraDevice::Folder { path: gone.clone() },
            CameraDevice::Video { path: gone },
            CameraDevice::Uvc(uvc),
            CameraDevice::RealSense(realsense),
        ] {
            let error = open_camera(&devices(camera.clone()), None).err().unwrap();
            let reported = fault_of(&error);
            assert!(reported.message.contains("no/such/thing"), "{camera:?}: {reported:?}");
        }
    }
}
