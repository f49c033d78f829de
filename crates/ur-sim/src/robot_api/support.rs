//! Support files of the Robot API: flight reports, generated and downloaded as a ZIP archive.
//!
//! In: requests. Out: the archive, with a file for each report: what the controller was, its modes, and
//! joint positions and forces of its last seconds as text. That there are such requests, their statuses and
//! their words are those of the vendor's client library; what is in a report is assumed. The archive stores
//! without compression, which every reader takes.

use crate::controller::Controller;
use crate::robot_api::reply::Reply;
use serde_json::json;
use std::fmt::Write;

/// Reports kept; the oldest goes.
const KEPT: usize = 5;

/// Frames between two lines of a report: 50 Hz.
const EVERY: usize = 10;

/// POST `/supportfiles/v1`.
pub fn generate(controller: &mut Controller) -> Reply {
    let report = report(controller);
    let pendant = &mut controller.core.pendant;
    pendant.flight_reports += 1;
    let name = format!("flightreport_{:04}.txt", pendant.flight_reports);
    if pendant.reports.len() >= KEPT {
        pendant.reports.remove(0);
    }
    pendant.reports.push((name, report));
    Reply::of(json!({"message": "Flight report generated successfully.", "details": null}))
}

/// GET `/supportfiles/v1`.
pub fn download(controller: &Controller) -> Reply {
    match &controller.core.pendant.reports[..] {
        [] => Reply::empty(),
        reports => Reply::file("application/zip", archive(reports)),
    }
}

fn report(controller: &Controller) -> String {
    let core = &controller.core;
    let [major, minor, bugfix, build] = core.version();
    let mut text = format!(
        "model {}\nserial number {}\nsoftware {major}.{minor}.{bugfix}.{build}\ntime {:.3} s\nrobot mode \
         {}\nsafety mode {}\nprogram {}\n\nseconds ago, joint positions (rad), force and torque at the tool (N, \
         Nm)\n",
        core.config.arm.name,
        core.config.serial_number,
        core.timestamp(),
        core.modes.robot_mode().name(),
        core.modes.safety_mode().name(),
        controller.programs.name().unwrap_or("none"),
    );
    for (frames, (q, wrench)) in core.sensing.past().enumerate().step_by(EVERY) {
        let _ = write!(text, "{:.3}", (frames + 1) as f64 * crate::motion::FRAME_SECONDS);
        q.0.iter().chain(wrench).for_each(|number| {
            let _ = write!(text, " {number:.6}");
        });
        text.push('\n');
    }
    text
}

/// The files in one archive, stored as they are.
fn archive(files: &[(String, String)]) -> Vec<u8> {
    let (mut out, mut directory) = (Vec::new(), Vec::new());
    for (name, text) in files {
        // Bounded: a name is short, a report some hundred kB, and all begin within the first megabytes.
        let (length, at) = (text.len() as u32, out.len() as u32);
        let mut head = Vec::new();
        // Version 2.0, no flags, stored; 1980-01-01 without a time, so that the same files are the same
        // bytes.
        [20u16, 0, 0, 0, 0x21].iter().for_each(|word| head.extend(word.to_le_bytes()));
        [crc32(text.as_bytes()), length, length].iter().for_each(|word| head.extend(word.to_le_bytes()));
        [name.len() as u16, 0].iter().for_each(|word| head.extend(word.to_le_bytes()));
        out.extend(b"PK\x03\x04");
        out.extend(&head);
        out.extend(name.as_bytes());
        out.extend(text.as_bytes());
        directory.extend(b"PK\x01\x02");
        directory.extend(20u16.to_le_bytes());
        directory.extend(&head);
        // No comment, first disk, no attributes; where the file begins.
        directory.extend([0; 10]);
        directory.extend(at.to_le_bytes());
        directory.extend(name.as_bytes());
    }
    let (count, begins, length) = (files.len() as u16, out.len() as u32, directory.len() as u32);
    out.extend(directory);
    out.extend(b"PK\x05\x06");
    [0, 0, count, count].iter().for_each(|word| out.extend(word.to_le_bytes()));
    out.extend(length.to_le_bytes());
    out.extend(begins.to_le_bytes());
    out.extend(0u16.to_le_bytes());
    out
}

fn crc32(bytes: &[u8]) -> u32 {
    let step = |sum: u32, byte: &u8| {
        (0..8).fold(sum ^ u32::from(*byte), |sum, _| sum >> 1 ^ if sum & 1 == 1 { 0xedb8_8320 } else { 0 })
    };
    !bytes.iter().fold(u32::MAX, step)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_checksum_and_the_archive_are_those_of_zip() {
        // The check value of CRC-32.
        assert_eq!(crc32(b"123456789"), 0xcbf4_3926);
        let files = [("a.txt".to_owned(), "first".to_owned()), ("b.txt".to_owned(), "second".to_owned())];
        let bytes = archive(&files);
        let ends = bytes.len() - 22;
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!(&bytes[ends..ends + 4], b"PK\x05\x06");
        let (length, begins) = (word(ends + 12), word(ends + 16));
        assert_eq!(begins + length, ends);
        let mut at = begins;
        for (name, text) in &files {
            assert_eq!(&bytes[at..at + 4], b"PK\x01\x02");
            assert_eq!((word(at + 16), word(at + 20)), (crc32(text.as_bytes()) as usize, text.len()));
            let file = word(at + 42);
            assert_eq!(&bytes[file..file + 4], b"PK\x03\x04");
            assert_eq!(&bytes[file + 30..][..name.len() + text.len()], format!("{name}{text}").as_bytes());
            at += 46 + name.len();
        }
    }
}
