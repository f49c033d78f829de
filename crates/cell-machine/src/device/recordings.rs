//! Recordings of a real UR10e, read from the folder in CELLD_DATA, for tests.

use cell_values::units::Joints;
use std::path::PathBuf;

/// One sample of a recording.
pub struct Sample {
    /// Controller time, s.
    pub time_s: f64,
    /// Measured positions, rad.
    pub q: Joints,
    /// Measured speeds, rad/s.
    pub qd: [f64; 6],
}

/// Name and samples of every recording. Without the folder: `None`, and a line on standard error.
pub fn ur10e() -> Option<Vec<(String, Vec<Sample>)>> {
    let folder = std::env::var_os("CELLD_DATA").map(|data| PathBuf::from(data).join("real/ur10e"));
    let Some(files) = folder.and_then(|folder| folder.read_dir().ok()) else {
        eprintln!("SKIPPED: no folder real/ur10e with recordings of a real arm (set CELLD_DATA)");
        return None;
    };
    let read = |path: PathBuf| {
        let text = std::fs::read_to_string(&path).unwrap();
        (path.display().to_string(), text.lines().skip(1).map(sample).collect())
    };
    Some(files.map(|file| read(file.unwrap().path())).collect())
}

fn sample(line: &str) -> Sample {
    let numbers: Vec<f64> = line.split(',').map(|number| number.parse().unwrap()).collect();
    let six = |from: usize| numbers[from..from + 6].try_into().unwrap();
    Sample { time_s: numbers[0], q: Joints(six(1)), qd: six(7) }
}
