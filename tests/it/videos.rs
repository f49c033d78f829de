//! Videos and USB cameras through `celld-video`, with OpenCV and FFmpeg.
//!
//! Videos are written here, uncompressed and without a library: what is read can be compared with what was
//! written, and this binary does not link what the program is there to keep out of celld.

use celld::io::camera::uvc::UvcCamera;
use celld::io::camera::video::VideoCamera;
use celld::io::camera::{CameraError, CameraSource, Exposure, FaultKind, UvcSettings};
use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

const WIDTH: usize = 64;
const HEIGHT: usize = 48;

/// Blue and red of all frames, and how bright each is (Cb, Cr and Y of ITU-R BT.601).
const CB: u8 = 90;
const CR: u8 = 200;
const LUMA: [u8; 3] = [90, 110, 130];

/// The colour of a frame, by that recommendation.
fn colour(luma: u8) -> [f64; 3] {
    let [y, cb, cr] = [(luma, 16.0), (CB, 128.0), (CR, 128.0)].map(|(value, zero)| f64::from(value) - zero);
    [1.164 * y + 1.596 * cr, 1.164 * y - 0.392 * cb - 0.813 * cr, 1.164 * y + 2.017 * cb]
}

/// A YUV4MPEG2 file of those frames, ten a second.
fn video(folder: &Path) -> PathBuf {
    let mut bytes = format!("YUV4MPEG2 W{WIDTH} H{HEIGHT} F10:1 Ip A1:1 C444\n").into_bytes();
    for luma in LUMA {
        bytes.extend(b"FRAME\n");
        for plane in [luma, CB, CR] {
            bytes.extend(std::iter::repeat_n(plane, WIDTH * HEIGHT));
        }
    }
    let path = folder.join("looks.y4m");
    std::fs::write(&path, bytes).expect("written");
    path
}

#[test]
fn a_video_is_read_to_its_end_in_the_right_colours() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut camera = VideoCamera::open(&video(folder.path()), None).expect("a video");
    for (i, luma) in (0..).zip(LUMA) {
        let frame = camera.grab().expect("a frame");
        let size = (frame.image.width as usize, frame.image.height as usize);
        assert_eq!((frame.sequence, size), (i, (WIDTH, HEIGHT)));
        assert!((frame.time_s - 0.1 * i as f64).abs() < 1e-3, "frame {i} at {} s", frame.time_s);
        let found = frame.image.pixel(10, 10).expect("a pixel");
        for (found, wanted) in found.into_iter().zip(colour(luma)) {
            assert!((f64::from(found) - wanted).abs() < 3.0, "frame {i}: {found}, not {wanted}");
        }
    }
    assert!(matches!(camera.grab(), Err(CameraError::EndOfRecording { frames: 3, .. })));
    assert!(matches!(camera.intrinsics(), Err(CameraError::NoIntrinsics { .. })));
}

#[test]
fn no_file_and_no_video_are_errors() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("none.avi");
    assert!(matches!(VideoCamera::open(&path, None), Err(CameraError::File { .. })));
    std::fs::write(&path, b"not a video").expect("written");
    let reported = VideoCamera::open(&path, None).expect_err("no video");
    assert!(matches!(reported, CameraError::Video { .. }), "{reported}");
    assert!(reported.to_string().contains("no video of a known kind"), "{reported}");
}

#[test]
fn a_device_that_is_no_camera_is_refused() {
    let settings = UvcSettings {
        device: "/dev/null".into(),
        serial: "A1".into(),
        size: [1280, 720],
        rate: 30,
        exposure: Exposure::Auto,
    };
    let reported = UvcCamera::open(settings, Duration::from_secs(20), None).expect_err("no camera");
    assert!(reported.to_string().contains("takes no pictures"), "{reported}");
    assert_eq!(reported.kind(), FaultKind::Misfit);
}

/// `celld-video` without celld.
fn program() -> Child {
    Command::new(env!("CARGO_BIN_EXE_celld-video"))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .expect("celld-video")
}

#[test]
fn the_program_ends_with_its_input() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut child = program();
    let mut requests = child.stdin.take().expect("a pipe");
    let path = video(folder.path());
    write!(requests, "{{\"video\":{{\"path\":{path:?}}}}}\n\"grab\"\n").expect("written");
    let mut replies = BufReader::new(child.stdout.take().expect("a pipe")).lines();
    let mut next = || replies.next().expect("a line").expect("text");
    assert_eq!(next(), "{\"open\":{\"wire\":1}}");
    assert_eq!(next(), "{\"grabbed\":{\"time_ms\":0.0}}");
    drop(requests);
    assert!(child.wait().expect("it ends").success());
}

#[test]
fn the_program_ends_with_its_input_also_where_what_it_reads_blocks() {
    let folder = tempfile::tempdir().expect("a folder");
    let pipe = folder.path().join("looks.avi");
    // Whoever opens it waits for a writer, who does not come.
    assert!(Command::new("mkfifo").arg(&pipe).status().expect("mkfifo").success());
    let mut child = program();
    let mut requests = child.stdin.take().expect("a pipe");
    writeln!(requests, "{{\"video\":{{\"path\":{pipe:?}}}}}").expect("written");
    drop(requests);
    assert_eq!(child.wait().expect("it ends").signal(), Some(9));
}

/// How far a process goes after others.
fn nice_of(process: u32) -> i32 {
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).expect("a process");
    let (_, after) = stat.rsplit_once(") ").expect("a name");
    after.split(' ').nth(16).and_then(|nice| nice.parse().ok()).expect("field 19 of proc_pid_stat(5)")
}

#[test]
fn it_goes_after_whoever_started_it() {
    let mut child = program();
    let mut replies = BufReader::new(child.stdout.take().expect("a pipe"));
    let mut requests = child.stdin.take().expect("a pipe");
    writeln!(requests, "{{\"video\":{{\"path\":\"none\"}}}}").expect("written");
    replies.read_line(&mut String::new()).expect("a line");
    // It may have ended: a process that is not waited for keeps its entry.
    assert!(nice_of(child.id()) >= 10);
    drop(requests);
    child.wait().expect("it ends");
}

#[test]
fn celld_does_not_link_what_reads_videos() {
    let links = |program: &str| {
        let bytes = std::fs::read(program).expect("a program");
        let name = b"libopencv_videoio.so";
        bytes.windows(name.len()).any(|part| part[0] == name[0] && part == name)
    };
    assert!(!links(env!("CARGO_BIN_EXE_celld")));
    assert!(links(env!("CARGO_BIN_EXE_celld-video")));
}

#[test]
fn a_line_that_is_no_request_is_answered() {
    let mut child = program();
    child.stdin.take().expect("a pipe").write_all(b"{\"video\": 3}\n").expect("written");
    let mut said = String::new();
    child.stdout.take().expect("a pipe").read_to_string(&mut said).expect("text");
    assert!(said.contains("another version"), "{said}");
    assert!(child.wait().expect("it ends").success());
}

#[test]
fn what_is_no_request_of_a_person_s_is_explained() {
    let run = Command::new(env!("CARGO_BIN_EXE_celld-video")).arg("--help").output().expect("celld-video");
    assert_eq!(run.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&run.stderr).contains("celld, which starts it"));
}
