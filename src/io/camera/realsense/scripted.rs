//! A RealSense process that crashes, hangs or sends something else: a script in its place.

use super::*;
use crate::io::camera::{Exposure, FaultKind};
use rearrange::document::chain::chain;
use rustix::process::Signal;
use std::os::unix::process::ExitStatusExt;

const LIMIT: Duration = Duration::from_secs(20);
const OPEN: &str = r#"read task; echo '{"open":{"serial":"405","lens":null}}'"#;

fn live() -> RealSenseSettings {
    let (size, exposure) = ([2, 1], Exposure::Auto);
    let serial = Some("405".to_string());
    RealSenseSettings { serial, file: None, library: None, size, rate: 30, exposure, depth: true }
}

/// A camera that a script in POSIX shell reads.
fn read_by(script: &str, settings: RealSenseSettings) -> Result<RealSenseCamera, CameraError> {
    let program = ["/bin/sh", "-c", script].map(OsString::from).to_vec();
    RealSenseCamera::read_by(program, settings, LIMIT, None)
}

/// A request, and a picture of 2 pixels with that number.
fn picture(number: u64, depth: bool) -> String {
    let metres = if depth { "printf '\\000\\000\\000\\077\\000\\000\\200\\077'" } else { "true" };
    format!(
        "read grab; echo '{{\"picture\":{{\"width\":2,\"height\":1,\"sequence\":{number},\"time_s\":{number}.5,\
         \"depth\":{depth}}}}}'; printf 'rgb{number:03}'; {metres}"
    )
}

#[test]
fn pictures_come_with_their_depth() {
    let script = format!("{OPEN}; {}; {}; read end", picture(7, true), picture(9, false));
    let mut camera = read_by(&script, live()).unwrap();
    let frame = camera.grab().unwrap();
    assert_eq!((frame.sequence, frame.time_s, frame.image.rgb.as_slice()), (7, 7.5, b"rgb007".as_slice()));
    assert_eq!(frame.depth.unwrap().metres, [0.5, 1.0]);
    assert!(camera.grab().unwrap().depth.is_none());
}

fn crash_of(error: CameraError) -> String {
    let CameraError::Crashed { how, .. } = error else { panic!("{error:?}") };
    how.to_string()
}

#[test]
fn a_live_camera_starts_again_at_the_picture_after_a_crash() {
    let folder = tempfile::tempdir().unwrap();
    let mark = folder.path().join("crashed");
    let script = format!(
        "{OPEN}; if [ -e {mark} ]; then {}; read grab; exit 3; fi; touch {mark}; {}; read grab; kill -SEGV $$",
        picture(1, false),
        picture(5, false),
        mark = mark.display()
    );
    let mut camera = read_by(&script, live()).unwrap();
    assert_eq!(camera.grab().unwrap().sequence, 5);
    let crash = camera.grab().unwrap_err();
    assert_eq!(crash.kind(), FaultKind::Broken);
    assert!(crash_of(crash).contains("signal: 11"));
    assert_eq!(camera.serial().unwrap(), "405", "known from before");
    assert_eq!(camera.grab().unwrap().sequence, 1, "the count begins again");
    assert!(crash_of(camera.grab().unwrap_err()).contains("exit status: 3"));
}

#[test]
fn an_open_is_tried_three_times() {
    let folder = tempfile::tempdir().unwrap();
    let count = folder.path().join("count");
    let script = |crashes: u32| {
        let count = count.display();
        format!("echo >> {count}; [ $(wc -l < {count}) -gt {crashes} ] || kill -ABRT $$; {OPEN}; read end")
    };
    drop(read_by(&script(2), live()).unwrap());
    std::fs::remove_file(&count).unwrap();
    let error = read_by(&script(10), live()).err().unwrap();
    assert!(error.is_crash() && crash_of(error).contains("signal: 6"));
    assert_eq!(std::fs::read(&count).unwrap().len(), 3);
}

/// Settings of a recording; the script reads no file.
fn recording() -> RealSenseSettings {
    RealSenseSettings { file: Some("looks.bag".into()), serial: None, ..live() }
}

#[test]
fn a_recording_that_crashes_at_the_same_picture_each_time_ends_with_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let count = folder.path().join("count");
    let pictures = [picture(1, false), picture(2, false)].join("; ");
    let script = format!("echo >> {}; {OPEN}; {pictures}; read grab; kill -ABRT $$", count.display());
    let mut camera = read_by(&script, recording()).unwrap();
    assert_eq!([camera.grab().unwrap().sequence, camera.grab().unwrap().sequence], [1, 2]);
    assert!(crash_of(camera.grab().unwrap_err()).contains("signal: 6"));
    assert_eq!(std::fs::read(&count).unwrap().len(), 3);
}

#[test]
fn a_recording_continues_after_a_crash_and_its_count_is_still_checked() {
    let folder = tempfile::tempdir().unwrap();
    let mark = folder.path().join("crashed");
    let pictures = [picture(1, false), picture(2, false)].join("; ");
    let rest = [picture(3, false), picture(2, false)].join("; ");
    let script = format!(
        "{OPEN}; {pictures}; [ -e {mark} ] || {{ touch {mark}; read grab; kill -ABRT $$; }}; {rest}; read grab; \
         echo '\"end\"'; read end",
        mark = mark.display()
    );
    let mut camera = read_by(&script, recording()).unwrap();
    let numbers = [(); 3].map(|()| camera.grab().unwrap().sequence);
    assert_eq!(numbers, [1, 2, 3]);
    let back = camera.grab().unwrap_err();
    assert!(matches!(back, CameraError::RepeatedSequence { sequence: 2, last: 3, .. }), "{back:?}");
    assert!(matches!(camera.grab().unwrap_err(), CameraError::EndOfRecording { .. }));
}

#[test]
fn a_process_that_hangs_is_killed() {
    let mut camera = read_by(&format!("{OPEN}; read grab; read never"), live()).unwrap();
    let process = camera.process.clone().unwrap();
    camera.helper.as_mut().unwrap().set_limit(Duration::from_millis(50));
    assert!(matches!(camera.grab(), Err(CameraError::Silent { .. })));
    assert!(process.ends(LIMIT).is_some_and(|status| status.signal() == Some(Signal::KILL.as_raw())));
}

#[test]
fn the_process_has_time_to_stop_its_streams() {
    let folder = tempfile::tempdir().unwrap();
    let mark = folder.path().join("stopped");
    let script = format!("{OPEN}; read end; sleep 0.3; touch {}", mark.display());
    drop(read_by(&script, live()).unwrap());
    assert!(mark.exists());
}

#[test]
fn a_process_that_ignores_the_end_of_its_input_is_killed() {
    let camera = read_by(&format!("{OPEN}; read end; exec sleep 60"), live()).unwrap();
    let process = camera.process.clone().unwrap();
    drop(camera);
    assert!(process.ended().is_some_and(|status| status.signal() == Some(Signal::KILL.as_raw())));
}

#[test]
fn what_the_process_reports_keeps_its_kind_and_cause() {
    let script =
        r#"read task; echo '{"failed":{"kind":"unplugged","what":"D405 is away","cause":"no USB"}}'"#;
    let error = read_by(script, live()).err().unwrap();
    assert!(error.kind() == FaultKind::Unplugged && chain(&error) == "D405 is away: no USB", "{error:?}");
    for script in [format!("{OPEN}; echo hello; read end; true"), format!("{OPEN}; {OPEN}; read end; true")] {
        let error = read_by(&script, live()).unwrap().grab().unwrap_err();
        assert!(error.kind() == FaultKind::Broken && error.to_string().contains("unexpected"), "{error}");
    }
}

#[test]
fn another_serial_number_is_not_taken() {
    let other = RealSenseSettings { serial: Some("406".into()), ..live() };
    let error = read_by(&format!("{OPEN}; read end"), other).err().unwrap();
    assert!(matches!(&error, CameraError::OtherSerial { found, .. } if found == "405"), "{error:?}");
}

#[test]
fn a_restart_gets_a_process_of_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let tasks = folder.path().join("tasks");
    let script = format!(
        "read -r task; echo \"$task\" >> {}; case \"$task\" in \
         *restart*) echo '\"restarted\"';; *) echo '{{\"open\":{{\"serial\":\"405\",\"lens\":null}}}}'; read end;; esac",
        tasks.display()
    );
    let mut camera = read_by(&script, live()).unwrap();
    camera.reset().unwrap();
    let tasks = std::fs::read_to_string(tasks).unwrap();
    let kinds: Vec<&str> = tasks.lines().map(|line| line.split('"').nth(1).unwrap()).collect();
    assert_eq!(kinds, ["stream", "restart", "stream"]);
    assert!(tasks.lines().nth(1).unwrap().contains("405"), "{tasks}");
}
