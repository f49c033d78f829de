//! `.csv` of an arm's joints over time, with the names that `ur_rtde` gives the columns, so that `celld-sim
//! compare` and other tools read them.
//!
//! In: samples, or text. Out: lines, or a [`JointTrack`] of those columns that are needed here. Pure.

use crate::blends::JointTrack;
use cell_values::units::Joints;
use std::fmt::Write;

/// One sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointSample {
    /// The controller's time, s.
    pub time_s: f64,
    /// Joint positions, rad.
    pub q: [f64; 6],
    /// Joint speeds, rad/s.
    pub qd: [f64; 6],
    /// Robot mode, safety mode and runtime state, as the controller numbers them.
    pub states: [i32; 3],
}

/// The line of names.
pub fn header() -> String {
    let [q, qd] = ["actual_q", "actual_qd"].map(|name| names(name).join(","));
    format!("timestamp,{q},{qd},robot_mode,safety_mode,runtime_state\n")
}

fn names(name: &str) -> [String; 6] {
    std::array::from_fn(|joint| format!("{name}_{joint}"))
}

/// The line of a sample.
pub fn line(sample: &JointSample) -> String {
    let mut text = format!("{:.4}", sample.time_s);
    for value in sample.q.iter().chain(&sample.qd) {
        let _ = write!(text, ",{value:.6}");
    }
    for state in sample.states {
        let _ = write!(text, ",{state}");
    }
    text.push('\n');
    text
}

/// Reads the times and joints of a recording.
///
/// # Errors
/// The first line that is wrong, and why.
pub fn parse(text: &str) -> Result<JointTrack, String> {
    let mut lines = text.lines().zip(1..);
    let header: Vec<&str> = lines.next().map_or("", |(line, _)| line).split(',').map(str::trim).collect();
    let column = |name: &str| {
        let found = header.iter().position(|found| *found == name);
        found.ok_or_else(|| format!("line 1: no column {name}"))
    };
    let time_at = column("timestamp")?;
    let [a, b, c, d, e, f] = names("actual_q").map(|name| column(&name));
    let joints_at = [a?, b?, c?, d?, e?, f?];
    let mut track = JointTrack::default();
    for (line, number) in lines.filter(|(line, _)| !line.trim().is_empty()) {
        let cells: Vec<&str> = line.split(',').map(str::trim).collect();
        let value = |at: usize| {
            let text = cells.get(at).copied().unwrap_or_default();
            let value = text.parse().ok().filter(|value: &f64| value.is_finite());
            value.ok_or_else(|| format!("line {number}: {text:?} is not a number (column {})", at + 1))
        };
        let time_s = value(time_at)?;
        if track.times_s.last().is_some_and(|last| time_s <= *last) {
            return Err(format!("line {number}: time {time_s} is not after that of the line before"));
        }
        let mut q = [0.0; 6];
        for (joint, at) in q.iter_mut().zip(joints_at) {
            *joint = value(at)?;
        }
        track.times_s.push(time_s);
        track.joints.push(Joints(q));
    }
    Ok(track)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text() -> String {
        let sample = |time_s| JointSample {
            time_s,
            q: [0.1, -1.5, 2.0, 3.0, 4.0, -5.25],
            qd: [0.0; 6],
            states: [7, 1, 2],
        };
        [header(), line(&sample(41.0)), line(&sample(41.002))].concat()
    }

    #[test]
    fn written_samples_are_read_back() {
        let track = parse(&text()).unwrap();
        assert_eq!(track.times_s, [41.0, 41.002]);
        assert_eq!(track.joints, [Joints([0.1, -1.5, 2.0, 3.0, 4.0, -5.25]); 2]);
    }

    #[test]
    fn invalid_recordings_report_the_line() {
        let said = |from: &str, to: &str| {
            assert!(text().contains(from));
            parse(&text().replace(from, to)).unwrap_err()
        };
        assert_eq!(said("timestamp", "time"), "line 1: no column timestamp");
        assert_eq!(said("actual_q_5", "q5"), "line 1: no column actual_q_5");
        assert!(said("41.0020", "41.0000").starts_with("line 3: time 41 is not after"));
        assert_eq!(said("41.0020,0.100000", "41.0020,nan"), "line 3: \"nan\" is not a number (column 2)");
        assert!(said("41.0000,0.100000,", "41.0000\n").starts_with("line 2: \"\" is not a number"));
        assert!(parse("").is_err());
    }
}
