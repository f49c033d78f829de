//! A process of the SDK that crashes, hangs or says something else: a script in its place.

use super::*;
use crate::io::camera::{Exposure, FaultKind};
use std::time::Instant;

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

#[test]
fn a_live_camera_whose_process_crashed_is_started_again_at_the_next_picture() {
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
    let crashed = camera.grab().unwrap_err();
    assert!(crashed.kind() == FaultKind::Broken && chain(&crashed).contains("signal: 11"), "{crashed:?}");
    assert_eq!(camera.grab().unwrap().sequence, 1, "it counts from the beginning");
    let ended = chain(&camera.grab().unwrap_err());
    assert!(ended.contains("exit status: 3"), "{ended}");
}

#[test]
fn a_crash_at_the_start_is_tried_again_and_one_each_time_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let count = folder.path().join("count");
    let script = |crashes: u32| {
        let count = count.display();
        format!("echo >> {count}; [ $(wc -l < {count}) -gt {crashes} ] || kill -ABRT $$; {OPEN}; read end")
    };
    drop(read_by(&script(2), live()).unwrap());
    std::fs::remove_file(&count).unwrap();
    let error = read_by(&script(10), live()).err().unwrap();
    assert!(chain(&error).contains("signal: 6"), "{}", chain(&error));
    assert_eq!(std::fs::read(&count).unwrap().len(), STARTS as usize);
}

#[test]
fn one_that_hangs_is_killed() {
    let mut camera = read_by(&format!("{OPEN}; read grab; read never"), live()).unwrap();
    let process = camera.process.clone().unwrap();
    camera.running.as_mut().unwrap().helper.set_limit(Duration::from_millis(50));
    assert!(matches!(camera.grab(), Err(CameraError::Silent { .. })));
    assert!(process.ends(LIMIT).is_some_and(|status| status.signal() == Some(Signal::KILL.as_raw())));
    assert!(!camera.has_crashed(), "it was killed");
}

#[test]
fn what_the_process_reports_keeps_its_kind_and_cause() {
    let script =
        r#"read task; echo '{"failed":{"kind":"unplugged","what":"D405 is away","cause":"no USB"}}'"#;
    let error = read_by(script, live()).err().unwrap();
    assert!(error.kind() == FaultKind::Unplugged && chain(&error) == "D405 is away: no USB", "{error:?}");
    for script in [format!("{OPEN}; echo hello; read end"), format!("{OPEN}; {OPEN}; read end")] {
        let error = read_by(&script, live()).unwrap().grab().unwrap_err();
        assert!(error.to_string().contains("of another version"), "{error}");
    }
}

#[test]
fn another_serial_number_is_not_taken() {
    let other = RealSenseSettings { serial: Some("406".into()), ..live() };
    let error = read_by(&format!("{OPEN}; read end"), other).err().unwrap();
    assert!(matches!(&error, CameraError::OtherSerial { found, .. } if found == "405"), "{error:?}");
}

#[test]
fn a_restart_is_requested_of_a_process_of_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let tasks = folder.path().join("tasks");
    let script = format!(
        "read -r task; echo \"$task\" >> {}; case \"$task\" in \
         *restart*) echo '\"restarted\"';; *) echo '{{\"open\":{{\"serial\":\"405\",\"lens\":null}}}}'; read end;; esac",
        tasks.display()
    );
    let mut camera = read_by(&script, live()).unwrap();
    let begun = Instant::now();
    camera.reset().unwrap();
    assert!(begun.elapsed() < BACK_WITHIN, "it was back at once");
    let tasks = std::fs::read_to_string(tasks).unwrap();
    let kinds: Vec<&str> = tasks.lines().map(|line| line.split('"').nth(1).unwrap()).collect();
    assert_eq!(kinds, ["stream", "restart", "stream"]);
    assert!(tasks.lines().nth(1).unwrap().contains("405"), "{tasks}");
}
