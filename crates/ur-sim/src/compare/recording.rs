//! Recordings of ur_rtde: comma separated numbers with a line of names.
//!
//! In: the text that `startFileRecording` wrote. Out: [`Track`], or every complaint at once with its line.
//! Needed are `actual_q_0` to `actual_q_5`, and `timestamp` or the rate at which it was recorded; the states
//! are read where they are, everything else is passed over. Pure.

use crate::compare::track::{STATES, Track};

/// Longest time between two samples, s: more is another recording, or a slip.
const MOST_GAP_S: f64 = 60.0;

/// Shortest, s.
const LEAST_STEP_S: f64 = 1e-4;

/// Most complaints about one recording.
const MOST_COMPLAINTS: usize = 20;

/// From what a sample has its time.
#[derive(Clone, Copy)]
enum Time {
    Column(usize),
    /// The samples are so many seconds apart.
    Every(f64),
}

/// Where the columns are.
struct Columns {
    time: Time,
    joints: [usize; 6],
    states: [Option<usize>; 3],
    count: usize,
}

/// Reads a recording; `rate_hz` counts where it has no times.
///
/// # Errors
/// Every complaint, the first twenty of them.
pub fn read_recording(text: &str, rate_hz: Option<f64>) -> Result<Track, Vec<String>> {
    let mut lines = text.lines().enumerate().map(|(index, line)| (index + 1, line));
    let header = lines.next().map_or("", |(_, line)| line);
    let columns = columns(header, rate_hz)?;
    let mut track = Track { states: columns.states.map(|at| at.map(|_| Vec::new())), ..Track::default() };
    let mut complaints = Vec::new();
    // A recorder that was killed leaves half a line.
    let whole = text.ends_with('\n');
    let last = text.lines().count();
    for (number, line) in lines.filter(|(number, line)| !line.trim().is_empty() && (whole || *number < last))
    {
        if let Err(complaint) = sample(line, &columns, &mut track) {
            complaints.push(format!("line {number}: {complaint}"));
        }
        if complaints.len() == MOST_COMPLAINTS {
            break;
        }
    }
    if complaints.is_empty() && track.times_s.len() < 2 {
        complaints.push("a recording has at least two samples".to_owned());
    }
    if complaints.is_empty() { Ok(track) } else { Err(complaints) }
}

fn columns(header: &str, rate_hz: Option<f64>) -> Result<Columns, Vec<String>> {
    let names: Vec<&str> = header.trim_start_matches('\u{feff}').split(',').map(str::trim).collect();
    let mut missing = Vec::new();
    let place = |name: &str| names.iter().position(|found| *found == name);
    let mut need = |name: &str| {
        place(name).unwrap_or_else(|| {
            missing.push(name.to_owned());
            0
        })
    };
    let time = match (place("timestamp"), rate_hz) {
        (None, Some(rate_hz)) => Time::Every(1.0 / rate_hz),
        _ => Time::Column(need("timestamp")),
    };
    let joints = std::array::from_fn(|joint| need(&format!("actual_q_{joint}")));
    if missing.is_empty() {
        return Ok(Columns { time, joints, states: STATES.map(place), count: names.len() });
    }
    Err(vec![format!(
        "line 1: no column {}; record timestamp and actual_q (startFileRecording without a list has both); \
         without times --rate says how many samples a second has",
        missing.join(", ")
    )])
}

fn sample(line: &str, columns: &Columns, track: &mut Track) -> Result<(), String> {
    let cells: Vec<&str> = line.split(',').map(str::trim).collect();
    if cells.len() != columns.count {
        return Err(format!("{} values for {} columns", cells.len(), columns.count));
    }
    let number = |at: usize| {
        let text = cells.get(at).copied().unwrap_or_default();
        let value = text.parse::<f64>().ok().filter(|value| value.is_finite());
        value.ok_or_else(|| format!("{text:?} is not a number (column {})", at + 1))
    };
    let time_s = match columns.time {
        Time::Column(at) => number(at)?,
        Time::Every(step_s) => track.times_s.len() as f64 * step_s,
    };
    let mut joints = [0.0; 6];
    for (joint, at) in joints.iter_mut().zip(columns.joints) {
        *joint = number(at)?;
    }
    let mut states = [None; 3];
    for (state, at) in states.iter_mut().zip(columns.states) {
        *state = at.map(number).transpose()?;
    }
    match track.times_s.last() {
        // The recorder writes a state again when no newer one has come.
        Some(last) if *last == time_s => return Ok(()),
        Some(last) if *last > time_s => return Err(format!("time {time_s} after {last}")),
        Some(last) if time_s - last > MOST_GAP_S => {
            return Err(format!(
                "{:.0} s after the line before, at most {MOST_GAP_S} are read",
                time_s - last
            ));
        }
        Some(last) if time_s - last < LEAST_STEP_S => {
            return Err(format!(
                "{:e} s after the line before, a controller sends every 2 ms",
                time_s - last
            ));
        }
        _ => (),
    }
    track.times_s.push(time_s);
    track.joints.push(joints);
    for (column, state) in track.states.iter_mut().zip(states) {
        if let (Some(column), Some(state)) = (column, state) {
            column.push(state as i32);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADER: &str =
        "timestamp,actual_q_0,actual_q_1,actual_q_2,actual_q_3,actual_q_4,actual_q_5,robot_mode";

    fn complaints(text: &str) -> String {
        read_recording(text, None).unwrap_err().join("\n")
    }

    #[test]
    fn a_recording_is_read_and_what_it_has_beside_passed_over() {
        let text = "x,runtime_state,timestamp,actual_q_0,actual_q_1,actual_q_2,actual_q_3,actual_q_4,actual_q_5\n\
                    9,1,41.8,0.1,-1,2,3,4,5\n9,1,41.8,0.1,-1,2,3,4,5\n8,2,41.802,0.2,-1,2,3,4,5\n8,2,41.8";
        let track = read_recording(text, None).unwrap();
        assert_eq!(track.times_s, [41.8, 41.802]);
        assert_eq!(track.joints[1], [0.2, -1.0, 2.0, 3.0, 4.0, 5.0]);
        assert_eq!(track.states, [None, None, Some(vec![1, 2])]);
    }

    #[test]
    fn a_recording_of_positions_alone_needs_its_rate() {
        let text =
            "actual_q_0,actual_q_1,actual_q_2,actual_q_3,actual_q_4,actual_q_5\n0,1,2,3,4,5\n0,1,2,3,4,5\n";
        let track = read_recording(text, Some(100.0)).unwrap();
        assert_eq!((track.times_s.as_slice(), track.joints.len()), ([0.0, 0.01].as_slice(), 2));
        assert!(complaints(text).contains("no column timestamp; ") && complaints(text).contains("--rate"));
        let timed = format!("{HEADER}\n1,0,0,0,0,0,0,7\n1.5,0,0,0,0,0,0,7\n");
        assert_eq!(read_recording(&timed, Some(100.0)).unwrap().times_s, [1.0, 1.5], "its own times count");
    }

    #[test]
    fn all_that_is_wrong_is_said_at_once_with_its_line() {
        let text = format!("{HEADER}\n1,0,0,0,0,0,0,7\n2,0,0,nan,0,0,0,7\n3,0,0,7\n0.5,0,0,0,0,0,0,7\n");
        let said = complaints(&text);
        assert_eq!(
            said,
            "line 3: \"nan\" is not a number (column 4)\nline 4: 4 values for 8 columns\nline 5: time 0.5 after 1"
        );
        let many = format!("{HEADER}\n{}", "x\n".repeat(1000));
        assert_eq!(read_recording(&many, None).unwrap_err().len(), MOST_COMPLAINTS);
        let far = complaints(&format!("{HEADER}\n1,0,0,0,0,0,0,7\n1e9,0,0,0,0,0,0,7\n"));
        assert!(far.contains("line 3: 999999999 s after the line before"), "{far}");
        let near = complaints(&format!("{HEADER}\n1,0,0,0,0,0,0,7\n1.0000001,0,0,0,0,0,0,7\n"));
        assert!(near.contains("a controller sends every 2 ms"), "{near}");
    }

    #[test]
    fn what_is_no_recording_is_refused() {
        assert!(complaints("").contains("no column timestamp, actual_q_0"));
        assert!(complaints("timestamp,actual_q_0\n1,2\n").contains("no column actual_q_1, actual_q_2"));
        assert!(complaints(&format!("{HEADER}\n1,0,0,0,0,0,0,7\n")).contains("at least two samples"));
    }
}
