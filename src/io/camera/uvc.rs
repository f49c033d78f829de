//! A USB camera as the kernel shows it (V4L2).
//!
//! In: the device file, size, rate, exposure, and the lens from a calibration, for such a camera reports
//! none. Out: frames with a count of our own and the driver's time. The driver keeps pictures until they are
//! read; those that were exposed before a picture was requested are passed over, or a look would see the
//! table as it was at the last one.

use crate::io::camera::helper::Process;
use crate::io::camera::reader::Reader;
use crate::io::camera::validator::FrameValidator;
use crate::io::camera::wire::Source;
use crate::io::camera::{CameraError, CameraSource, Exposure, Frame, UvcSettings};
use cell_values::image::Image;
use cell_vision::camera::CameraModel;
use std::os::unix::fs::FileTypeExt;
use std::path::Path;
use std::time::{Duration, Instant};

/// Where the kernel shows what its cameras are.
const SYSTEM_CAMERAS: &str = "/sys/class/video4linux";
/// Where cameras have names that last.
const LASTING_NAMES: &str = "/dev/v4l/by-id";
/// Pictures passed over at most: more than any driver keeps.
const KEPT_MAX: u32 = 8;

/// A USB camera.
#[derive(Debug)]
pub struct UvcCamera {
    settings: UvcSettings,
    limit: Duration,
    reader: Option<Reader>,
    /// The process of the reader before, while a driver keeps it: it has the device.
    process: Option<Process>,
    taken: u64,
    lens: Option<CameraModel>,
    watch: FrameValidator,
}

impl UvcCamera {
    /// Opens the device and sets it up. A picture may take `limit`.
    ///
    /// # Errors
    /// `NotConnected` (with the cameras there are), `OtherSerial`, `Setting` for what it does not do,
    /// `Video` and `Silent` where it does not answer, `NoReader` without `celld-video`.
    pub fn open(
        settings: UvcSettings,
        limit: Duration,
        lens: Option<CameraModel>,
    ) -> Result<UvcCamera, CameraError> {
        super::same_serial(&settings.device.display().to_string(), &settings.serial, lens.as_ref())?;
        let watch = FrameValidator::default();
        let mut camera = UvcCamera { settings, limit, reader: None, process: None, taken: 0, lens, watch };
        camera.start()?;
        Ok(camera)
    }

    fn start(&mut self) -> Result<(), CameraError> {
        // One process at a time has the device.
        self.reader = None;
        if self.process.as_ref().is_some_and(|process| process.ended().is_none()) {
            let place = self.settings.device.display().to_string();
            return Err(CameraError::Silent { place, limit: self.limit });
        }
        check_device(&self.settings, Path::new(SYSTEM_CAMERAS), Path::new(LASTING_NAMES))?;
        let UvcSettings { device: path, size, rate, exposure, .. } = self.settings.clone();
        let exposure_us = match exposure {
            Exposure::Auto => None,
            Exposure::Fixed(exposure_us) => Some(exposure_us),
        };
        let reader = Reader::open(&Source::Device { path, size, rate, exposure_us }, self.limit)?;
        self.process = Some(reader.process());
        self.reader = Some(reader);
        Ok(())
    }
}

/// That the device is there, is a device, and is the one with that serial number.
fn check_device(settings: &UvcSettings, system: &Path, names: &Path) -> Result<(), CameraError> {
    let place = settings.device.display().to_string();
    let kind = match std::fs::metadata(&settings.device) {
        Ok(meta) => meta.file_type(),
        Err(error) => {
            let found = format!("{error}; cameras there are: {}", listed(names));
            return Err(CameraError::NotConnected { wanted: place, found });
        }
    };
    if !kind.is_char_device() {
        let what =
            "it is no device; for a video file write `kind: video`, for pictures `kind: folder`".to_string();
        return Err(CameraError::Setting { place, what });
    }
    match serial_of(&settings.device, system) {
        Some(found) if found != settings.serial => {
            let wanted = settings.serial.clone();
            Err(CameraError::OtherSerial { address: place, found, wanted })
        }
        _ => Ok(()),
    }
}

fn listed(names: &Path) -> String {
    let entries = std::fs::read_dir(names).into_iter().flatten().flatten();
    let mut found: Vec<String> = entries.map(|entry| entry.path().display().to_string()).collect();
    found.sort();
    if found.is_empty() { format!("none in {}", names.display()) } else { found.join(", ") }
}

/// The serial number that the USB device behind a device file has; many have none.
fn serial_of(device: &Path, system: &Path) -> Option<String> {
    let node = std::fs::canonicalize(device).ok()?;
    let interface = std::fs::canonicalize(system.join(node.file_name()?).join("device")).ok()?;
    // The video interface is a part of the USB device, which is the folder above.
    let text = std::fs::read_to_string(interface.parent()?.join("serial")).ok()?;
    let serial = text.trim();
    (!serial.is_empty()).then(|| serial.to_string())
}

/// Now on the clock that drivers stamp pictures with, ms.
fn driver_now_ms() -> f64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    now.tv_sec as f64 * 1e3 + now.tv_nsec as f64 / 1e6
}

/// The driver's time of a picture, ms, where it is one of that clock: some drivers give none, some that of
/// the day.
fn stamp_of(driver_ms: f64, now_ms: f64) -> Option<f64> {
    (driver_ms > 0.0 && driver_ms <= now_ms).then_some(driver_ms)
}

/// True for a picture whose exposure began after it was requested; without a time of the driver's only the
/// count decides.
fn is_fresh(stamp_ms: Option<f64>, requested_ms: f64, exposure_ms: f64, passed: u32) -> bool {
    passed >= KEPT_MAX || stamp_ms.is_some_and(|stamp_ms| stamp_ms - exposure_ms >= requested_ms)
}

impl UvcCamera {
    /// The next picture that is exposed from now on, and when, ms. A driver decodes into the memory of the
    /// picture before: one that it cannot decode shows that again, which the validator finds.
    fn fresh(&self, reader: &mut Reader, now_ms: impl Fn() -> f64) -> Result<(Image, f64), CameraError> {
        let (requested, requested_ms) = (Instant::now(), now_ms());
        // Exposure fits between two pictures: as configured, and as they come, for a camera that exposes by
        // itself takes longer in poor light. Stamps are of its end at the latest.
        let mut exposure_ms = 1e3 / f64::from(self.settings.rate.max(1));
        if let Exposure::Fixed(exposure_us) = self.settings.exposure {
            exposure_ms = exposure_ms.max(exposure_us / 1e3);
        }
        let mut before_ms = None;
        for passed in 0.. {
            // A camera that was pulled out fails at once.
            let Some(time_ms) = reader.grab()? else { break };
            let stamp_ms = stamp_of(time_ms, now_ms());
            if let (Some(before_ms), Some(stamp_ms)) = (before_ms, stamp_ms) {
                exposure_ms = f64::max(exposure_ms, stamp_ms - before_ms);
            }
            before_ms = stamp_ms;
            if is_fresh(stamp_ms, requested_ms, exposure_ms, passed) {
                return Ok((reader.picture()?, stamp_ms.unwrap_or(requested_ms)));
            }
        }
        let place = self.settings.device.display().to_string();
        Err(CameraError::Silent { place, limit: requested.elapsed() })
    }
}

impl CameraSource for UvcCamera {
    fn intrinsics(&mut self) -> Result<CameraModel, CameraError> {
        let place = || self.settings.device.display().to_string();
        self.lens.clone().ok_or_else(|| CameraError::NoIntrinsics { place: place() })
    }

    fn grab(&mut self) -> Result<Frame, CameraError> {
        if self.reader.is_none() {
            self.start()?;
        }
        let place = self.settings.device.display().to_string();
        let Some(mut reader) = self.reader.take() else {
            return Err(CameraError::Silent { place, limit: Duration::ZERO });
        };
        let (image, time_ms) = self.fresh(&mut reader, driver_now_ms)?;
        // One that failed is started anew.
        self.reader = Some(reader);
        let frame = Frame { image, sequence: self.taken, time_s: time_ms / 1e3, source: place, depth: None };
        self.taken += 1;
        self.watch.check(&frame, self.lens.as_ref())?;
        Ok(frame)
    }

    fn serial(&mut self) -> Result<String, CameraError> {
        Ok(self.settings.serial.clone())
    }

    fn is_live(&self) -> bool {
        true
    }

    fn reopen(&mut self) -> Result<(), CameraError> {
        self.watch.restarted();
        self.start()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    fn settings(device: &Path) -> UvcSettings {
        UvcSettings {
            device: device.to_owned(),
            serial: "A1".into(),
            size: [1280, 720],
            rate: 30,
            exposure: Exposure::Auto,
        }
    }

    #[test]
    fn a_camera_that_is_not_there_is_reported_with_those_that_are() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("usb-Other_Cam-video-index0"), b"").unwrap();
        let gone = settings(Path::new("/dev/v4l/by-id/usb-gone-video-index0"));
        let reported = check_device(&gone, folder.path(), folder.path()).unwrap_err();
        assert!(matches!(reported, CameraError::NotConnected { .. }));
        assert!(reported.to_string().contains("usb-Other_Cam-video-index0"), "{reported}");
        let opened = UvcCamera::open(gone, Duration::from_secs(1), None);
        assert!(matches!(opened, Err(CameraError::NotConnected { .. })));
    }

    #[test]
    fn a_file_is_no_device() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("looks.avi");
        std::fs::write(&file, b"x").unwrap();
        let reported = UvcCamera::open(settings(&file), Duration::from_secs(1), None).unwrap_err();
        assert!(reported.to_string().contains("kind: video"), "{reported}");
    }

    #[test]
    fn the_usb_device_s_serial_number_is_compared() {
        let folder = tempfile::tempdir().unwrap();
        let (system, usb) = (folder.path().join("class"), folder.path().join("usb/1-2"));
        std::fs::create_dir_all(usb.join("1-2:1.0")).unwrap();
        std::fs::create_dir_all(system.join("null")).unwrap();
        symlink(usb.join("1-2:1.0"), system.join("null/device")).unwrap();
        let check = || check_device(&settings(Path::new("/dev/null")), &system, folder.path());
        assert!(check().is_ok(), "a device without a serial number is taken as it is named");
        std::fs::write(usb.join("serial"), "A1\n").unwrap();
        assert!(check().is_ok());
        std::fs::write(usb.join("serial"), "B2\n").unwrap();
        assert!(matches!(check(), Err(CameraError::OtherSerial { found, .. }) if found == "B2"));
    }

    /// A camera whose pictures come from a script; their red is their number.
    fn scripted(script: &str) -> UvcCamera {
        let open = "n=0; echo '{\"open\":{\"wire\":1}}'";
        let reader = Reader::scripted(&format!("{open}\n{script}"), Duration::from_secs(20)).unwrap();
        let (settings, limit) = (settings(Path::new("/dev/none")), Duration::from_secs(20));
        let watch = FrameValidator::default();
        UvcCamera { settings, limit, reader: Some(reader), process: None, taken: 0, lens: None, watch }
    }

    #[test]
    fn what_the_driver_kept_is_passed_over_without_its_pixels() {
        let mut camera = scripted(
            "while read request; do case $request in
               *grab*) n=$((n + 1)); echo '{\"grabbed\":{\"time_ms\":0}}' ;;
               *) echo '{\"picture\":{\"width\":1,\"height\":1}}'; printf \"\\\\$(printf %03o $n)bc\" ;;
             esac; done",
        );
        for look in 1..=2 {
            let frame = camera.grab().unwrap();
            assert_eq!(frame.image.pixel(0, 0), Some([look * (KEPT_MAX as u8 + 1), b'b', b'c']));
            assert_eq!(frame.sequence, u64::from(look) - 1);
        }
    }

    /// Requested at 1010 ms, after the first of pictures that come so many ms apart; the time that is taken.
    fn taken_at(apart_ms: u32, exposure: Exposure) -> f64 {
        let script = format!(
            "t=$((1000 - {apart_ms})); while read request; do case $request in
               *grab*) t=$((t + {apart_ms})); echo '{{\"grabbed\":{{\"time_ms\":'$t'}}}}' ;;
               *) echo '{{\"picture\":{{\"width\":1,\"height\":1}}}}'; printf abc ;;
             esac; done"
        );
        let mut camera = scripted(&script);
        camera.settings.exposure = exposure;
        let mut reader = camera.reader.take().unwrap();
        let times = std::cell::Cell::new(1010.0);
        camera.fresh(&mut reader, || times.replace(5000.0)).unwrap().1
    }

    #[test]
    fn a_picture_is_taken_whose_whole_exposure_lies_after_the_request() {
        assert_eq!(taken_at(30, Exposure::Auto), 1060.0, "30 a second expose for 33 ms at most");
        assert_eq!(taken_at(30, Exposure::Fixed(100e3)), 1120.0);
        assert_eq!(taken_at(40, Exposure::Auto), 1080.0, "in poor light a camera takes its time");
    }

    #[test]
    fn a_camera_is_not_opened_while_a_driver_keeps_the_process_before() {
        let mut camera = scripted("read never");
        camera.process = camera.reader.as_ref().map(Reader::process);
        // As if killing it had no effect: what ends the process is kept from doing so.
        std::mem::forget(camera.reader.take());
        assert!(matches!(camera.grab(), Err(CameraError::Silent { .. })));
    }

    #[test]
    fn a_camera_that_gives_nothing_or_whose_reader_ended_is_started_anew() {
        for (script, silent) in [("read request; echo '\"end\"'; read never", true), ("read request", false)]
        {
            let mut camera = scripted(script);
            let error = camera.grab().unwrap_err();
            assert_eq!(matches!(error, CameraError::Silent { .. }), silent, "{error}");
            assert!(camera.reader.is_none());
            assert!(
                matches!(camera.grab(), Err(CameraError::NotConnected { .. })),
                "there is no such device"
            );
        }
    }

    #[test]
    fn pictures_from_before_the_question_are_passed_over() {
        let fresh = |driver_ms, passed| is_fresh(stamp_of(driver_ms, 1060.0), 1010.0, 33.0, passed);
        assert!(!fresh(1000.0, 0), "kept by the driver");
        assert!(!fresh(1030.0, 1), "its exposure had begun");
        assert!(fresh(1050.0, 2));
        assert!(!fresh(0.0, 3) && fresh(0.0, KEPT_MAX), "no stamp");
        assert!(!fresh(1.7e12, 3) && fresh(1.7e12, KEPT_MAX), "the time of the day says nothing");
        let [before, after] = [driver_now_ms(), driver_now_ms()];
        assert!(before > 0.0 && after >= before);
    }
}
