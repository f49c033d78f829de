//! The real SDK on recordings: two small ones that lie beside the public data, and one that the SDK itself
//! makes here.
//!
//! Without the SDK (`make clients` installs it) or the recordings these tests say so and look at nothing;
//! with `CELLD_CLIENTS` set, as `make test-clients` does, the SDK must be there. No camera is connected
//! where they run: what a live one does is not tested.

use super::*;
use crate::io::camera::{Exposure, FaultKind};
use rearrange::document::chain::chain;
use rustix::process::Signal;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The environment with the third-party clients; `None` if there is none and none was promised.
fn clients() -> Option<PathBuf> {
    let promised = std::env::var_os("CELLD_CLIENTS").map(PathBuf::from);
    let beside = || Some(std::env::current_exe().ok()?.ancestors().nth(3)?.join("clients"));
    let folder = promised.clone().or_else(beside)?;
    if library_in(&folder).is_some() {
        return Some(folder);
    }
    assert!(
        promised.is_none(),
        "CELLD_CLIENTS is set, and there is no RealSense SDK in {}",
        folder.display()
    );
    eprintln!("SKIPPED: no RealSense SDK in {}; `make clients` installs it", folder.display());
    None
}

/// The library inside the Python package.
fn library_in(clients: &Path) -> Option<PathBuf> {
    let python = std::fs::read_dir(clients.join("lib"))
        .ok()?
        .flatten()
        .find(|entry| entry.file_name().to_string_lossy().starts_with("python3"))?;
    let package = std::fs::read_dir(python.path().join("site-packages/pyrealsense2")).ok()?;
    let is_it = |name: &str| name.starts_with("pyrealsense2.cpython") && name.ends_with(".so");
    package
        .flatten()
        .map(|entry| entry.path())
        .find(|path| path.file_name().is_some_and(|name| is_it(&name.to_string_lossy())))
}

/// One of the recordings beside the public data.
fn recording(name: &str) -> Option<PathBuf> {
    let beside =
        || Path::new(env!("CARGO_MANIFEST_DIR")).parent().map(|folder| folder.join("shared").join("data"));
    let folder = std::env::var_os("CELLD_DATA").map(PathBuf::from).or_else(beside)?;
    let file = folder.join("camera").join(name);
    if !file.is_file() {
        eprintln!("SKIPPED: no {} (set CELLD_DATA)", file.display());
    }
    file.is_file().then_some(file)
}

fn settings(library: &Path, file: &Path) -> RealSenseSettings {
    RealSenseSettings {
        serial: None,
        file: Some(file.to_owned()),
        library: Some(library.to_owned()),
        size: [1280, 720],
        rate: 30,
        exposure: Exposure::Auto,
        depth: false,
    }
}

const LIMIT: Duration = Duration::from_secs(20);

/// Runs `test` with each recording, opened.
fn with_each_recording(test: impl Fn(&str, RealSenseCamera)) {
    let Some(library) = clients().as_deref().and_then(library_in) else { return };
    for name in ["sample-d405.bag", "sample-d405.db3"] {
        let Some(file) = recording(name) else { return };
        test(name, RealSenseCamera::open(settings(&library, &file), LIMIT, None).unwrap());
    }
}

#[test]
fn both_kinds_of_recording_play_to_their_end_with_serial_and_lens() {
    with_each_recording(|name, mut camera| {
        assert_eq!(camera.serial().unwrap(), "000000000405");
        let lens = camera.intrinsics().unwrap();
        assert_eq!((lens.width, lens.height, lens.fx, lens.cx, lens.cy), (640, 480, 650.0, 339.5, 259.5));
        assert_eq!(lens.distortion, [0.0; 5], "inverse Brown-Conrady of no distortion");
        let mut last: Option<Frame> = None;
        for number in 0..6 {
            let frame = camera.grab().unwrap_or_else(|error| panic!("{name}, frame {number}: {error:?}"));
            assert_eq!((frame.image.width, frame.image.height), (640, 480));
            assert!(frame.depth.is_none() && frame.source.ends_with(name));
            if let Some(last) = &last {
                assert!(frame.sequence == last.sequence + 1 && frame.time_s > last.time_s);
                assert!(frame.image != last.image);
            }
            last = Some(frame);
        }
        let ended = camera.grab().unwrap_err();
        assert!(matches!(ended, CameraError::EndOfRecording { frames: 6, .. }), "{ended:?}");
        assert!(!camera.is_live() && !camera.can_reset());
    });
}

#[test]
fn a_recording_continues_where_it_was_when_the_sdk_crashes() {
    with_each_recording(|name, mut camera| {
        let first = camera.grab().unwrap().sequence;
        for number in 1..6 {
            camera.process.as_ref().unwrap().signal(Signal::ABORT);
            assert_eq!(camera.grab().unwrap().sequence, first + number, "{name}");
        }
        camera.process.as_ref().unwrap().signal(Signal::ABORT);
        assert!(matches!(camera.grab().unwrap_err(), CameraError::EndOfRecording { frames: 6, .. }));
    });
}

#[test]
fn the_markers_in_the_recording_are_where_they_were_put() {
    let Some(library) = clients().as_deref().and_then(library_in) else { return };
    let Some(file) = recording("sample-d405.bag") else { return };
    let mut camera = RealSenseCamera::open(settings(&library, &file), LIMIT, None).unwrap();
    let image = camera.grab().unwrap().image;
    // Pixels in the right order and place: the tag's centres by the lens and the truth, dark and light
    // around them.
    for [x, y, z] in [[86.8, -140.6, 417.0], [-114.4, 27.5, 482.9], [132.7, -3.0, 535.4]] {
        let (u, v) = (339.5 + 650.0 * x / z, 259.5 + 650.0 * y / z);
        let half = 650.0 * 15.0 / z * 0.9;
        let pixel = |du: f64, dv: f64| image.pixel((u + du) as u32, (v + dv) as u32).unwrap()[0];
        let mut greys: Vec<u8> = (0..400)
            .map(|i| pixel(half * (f64::from(i % 20) / 10.0 - 1.0), half * (f64::from(i / 20) / 10.0 - 1.0)))
            .collect();
        greys.sort_unstable();
        assert!(
            greys[390] > 2 * greys[10].max(20),
            "no black and white at {u:.0} {v:.0}: {} to {}",
            greys[10],
            greys[390]
        );
    }
}

#[test]
fn depth_is_laid_over_the_colour_picture_in_metres() {
    let Some(clients) = clients() else { return };
    let Some(library) = library_in(&clients) else { return };
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("depth.db3");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/clients/realsense_record.py");
    let made = Command::new(clients.join("bin/python")).arg("-B").arg(script).arg(&file).output().unwrap();
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    let with_depth = RealSenseSettings { depth: true, ..settings(&library, &file) };
    let mut camera = RealSenseCamera::open(with_depth, LIMIT, None).unwrap();
    let lens = camera.intrinsics().unwrap();
    let taken = lens.distortion.iter().zip([-0.05, 0.06, 0.0, 0.0, -0.01]);
    assert!(taken.into_iter().all(|(ours, theirs)| (ours - theirs).abs() < 1e-6), "{lens:?}");
    let mut numbers = Vec::new();
    let ended = loop {
        let frame = match camera.grab() {
            Ok(frame) => frame,
            Err(error) => break error,
        };
        numbers.push(frame.sequence);
        assert_eq!(frame.image.pixel(10, 5).unwrap(), [30, 20, 10 * frame.sequence as u8]);
        let depth = frame.depth.unwrap();
        // Not measured left of column 32 of the depth camera, which is 5 pixels further right for the colour
        // camera.
        assert_eq!((depth.at(20, 24), depth.at(35, 24)), (None, None));
        let metres = depth.at(45, 24).unwrap();
        assert!((metres - 0.6).abs() < 1e-6, "{metres} m");
    };
    assert!(matches!(ended, CameraError::EndOfRecording { .. }), "{ended:?}");
    // The SDK plays each stream in a thread of its own: sets before the slower one has begun lack one of the
    // two. From then on every set comes, and none twice.
    assert!(numbers.ends_with(&[8, 9, 10, 11, 12]) && numbers.len() <= 12, "{numbers:?}");
    let without = RealSenseSettings { serial: Some("405".into()), ..settings(&library, &file) };
    let other = RealSenseCamera::open(without, LIMIT, None).err().unwrap();
    assert!(matches!(&other, CameraError::OtherSerial { found, .. } if found == "405405"), "{other}");
}

#[test]
fn what_does_not_fit_is_reported_before_the_first_picture() {
    let Some(library) = clients().as_deref().and_then(library_in) else { return };
    let Some(file) = recording("sample-d405.db3") else { return };
    let depth = RealSenseSettings { depth: true, ..settings(&library, &file) };
    let reported = RealSenseCamera::open(depth, LIMIT, None).err().unwrap();
    assert!(
        reported.kind() == FaultKind::Misfit && reported.to_string().contains("no depth stream"),
        "{reported}"
    );
    let lens = RealSenseCamera::open(settings(&library, &file), LIMIT, None).unwrap().intrinsics().unwrap();
    let larger = CameraModel { width: 1280, ..lens.clone() };
    let reported = RealSenseCamera::open(settings(&library, &file), LIMIT, Some(larger)).err().unwrap();
    assert!(matches!(reported, CameraError::Model(_)), "{reported}");
    let other = CameraModel { serial: "7".into(), ..lens };
    let reported = RealSenseCamera::open(settings(&library, &file), LIMIT, Some(other)).err().unwrap();
    assert!(matches!(reported, CameraError::OtherSerial { .. }), "{reported}");
}

#[test]
fn cut_and_foreign_files_are_errors_that_name_the_file() {
    let Some(library) = clients().as_deref().and_then(library_in) else { return };
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    for name in ["sample-d405.bag", "sample-d405.db3"] {
        let Some(file) = recording(name) else { return };
        let bytes = std::fs::read(file).unwrap();
        std::fs::write(path(name), &bytes[..bytes.len() / 3]).unwrap();
        let opened = RealSenseCamera::open(settings(&library, &path(name)), LIMIT, None);
        // Whole at its beginning, a file may begin to play; it must end, and not with six pictures.
        let reported = match opened {
            Err(reported) => reported,
            Ok(mut camera) => (0..6).find_map(|_| camera.grab().err()).unwrap(),
        };
        let text = format!("{reported} {reported:?}");
        assert!(text.contains(name), "{text}");
    }
    std::fs::write(path("text.bag"), b"no recording").unwrap();
    let reported = RealSenseCamera::open(settings(&library, &path("text.bag")), LIMIT, None).err().unwrap();
    assert!(
        reported.kind() == FaultKind::Misfit && reported.to_string().contains("text.bag cannot be played"),
        "{reported:?}"
    );
    let gone = RealSenseCamera::open(settings(&library, &path("gone.bag")), LIMIT, None).err().unwrap();
    assert!(matches!(gone, CameraError::File { .. }));
}

#[test]
fn without_a_camera_the_sdk_says_that_none_is_connected() {
    let Some(library) = clients().as_deref().and_then(library_in) else { return };
    let live = |serial: &str| RealSenseSettings {
        serial: Some(serial.into()),
        file: None,
        ..settings(&library, Path::new(""))
    };
    // A serial number that no camera has: with one connected the others are listed.
    let reported = RealSenseCamera::open(live("none-such"), LIMIT, None).err().unwrap();
    assert!(
        reported.kind() == FaultKind::Unplugged
            && reported.to_string().contains("none-such is not connected"),
        "{reported}"
    );
}

#[test]
fn without_the_sdk_the_remedy_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.bag");
    std::fs::write(&file, b"x").unwrap();
    let absent = settings(&folder.path().join("librealsense2.so"), &file);
    let reported = RealSenseCamera::open(absent, LIMIT, None).err().unwrap();
    assert!(chain(&reported).contains("install librealsense2"), "{reported:?}");
    assert_eq!(reported.kind(), FaultKind::Misfit);
}
