//! What the arguments of `celld bench vision` request, and what each of its parts gives.
//!
//! In: the command line. Out: the arguments; the shape of a part's figures.

use cell_vision::detect::DetectSettings;
use std::path::PathBuf;

/// Arguments of `celld bench vision`.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = HELP)]
pub struct BenchVisionArgs {
    /// 500 frames and 500 tables with something foreign, in place of the smaller numbers below
    #[arg(long)]
    full: bool,
    /// Frames, five views of a table each: 250, in full 500
    #[arg(long, value_name = "N",
          value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    frames: Option<u32>,
    /// Seed of tables, cameras and noise
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub(super) seed: u64,
    /// Tables at the same time
    #[arg(long, value_name = "N", default_value_t = 1,
          value_parser = clap::value_parser!(u16).range(1..=256))]
    pub(super) threads: u16,
    /// Search on a picture this much smaller
    #[arg(long, value_name = "F", default_value_t = DetectSettings::default().decimate)]
    pub(super) decimate: f32,
    /// Sharpen that picture by so many pixels
    #[arg(long, value_name = "PX", default_value_t = DetectSettings::default().sharpen_px)]
    pub(super) sharpen: f32,
    /// Exponent of the curve over the grey levels before squares are searched, 0.25 to 2; below 1 lifts the
    /// dark ones
    #[arg(long, value_name = "G", default_value_t = DetectSettings::default().tone)]
    pub(super) tone: f32,
    /// Take the library's corners instead of our own fit
    #[arg(long)]
    pub(super) library_corners: bool,
    /// With the lens's true numbers only
    #[arg(long)]
    pub(super) no_calibration: bool,
    /// Write the first frames of the first N tables here, with the truth about their corners (truth.json)
    #[arg(long, value_name = "DIR")]
    pub(super) save: Option<PathBuf>,
    /// Which figures, comma-separated
    #[arg(long, value_delimiter = ',', value_enum, default_values_t = Part::USUAL)]
    pub(super) part: Vec<Part>,
    /// Rendered pictures that are degraded (part degraded)
    #[arg(long, value_name = "N", default_value_t = 40,
          value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub(super) pictures: u32,
    /// Degrade the PNG and JPEG files of this folder instead; what is read in them as they are counts
    #[arg(long, value_name = "DIR")]
    pub(super) recorded: Option<PathBuf>,
    /// Cluttered pictures without markers (part empty)
    #[arg(long, value_name = "N", default_value_t = 1000,
          value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
    pub(super) empty: u32,
    /// Photographs without markers to lie under the clutter of every third of them
    #[arg(long, value_name = "DIR")]
    pub(super) photographs: Option<PathBuf>,
    /// Tables with something foreign, and as many without: 150, in full 500
    #[arg(long, value_name = "N",
          value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    scenes: Option<u32>,
    /// Looks with a bumped camera
    #[arg(long, value_name = "N", default_value_t = 1000,
          value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
    pub(super) trials: u32,
    /// Looks with a camera where it should be
    #[arg(long, value_name = "N", default_value_t = 10_000,
          value_parser = clap::value_parser!(u32).range(1..=100_000_000))]
    pub(super) looks: u32,
    /// Looks that are rendered and detected, half of them with a bumped camera
    #[arg(long, value_name = "N", default_value_t = 40,
          value_parser = clap::value_parser!(u32).range(0..=100_000))]
    pub(super) rendered: u32,
    /// Rounds of twenty poses for the camera's mount
    #[arg(long, value_name = "N", default_value_t = 200,
          value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub(super) rounds: u32,
    /// How to print the figures
    #[arg(long, default_value = "text", value_parser = ["text", "json"])]
    pub(super) format: String,
}

const HELP: &str = "\
The default numbers end within three minutes; each part says how many it measured.";

/// Frames and scenes unless others are named, and in full.
const FRAMES: [u32; 2] = [250, 500];
const SCENES: [u32; 2] = [150, 500];

impl BenchVisionArgs {
    /// How many frames.
    pub(super) fn frames(&self) -> usize {
        self.frames.unwrap_or(FRAMES[usize::from(self.full)]) as usize
    }

    /// How many tables with something foreign.
    pub(super) fn scenes(&self) -> usize {
        self.scenes.unwrap_or(SCENES[usize::from(self.full)]) as usize
    }
}

/// Parts of the benchmark.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum Part {
    /// Detection and poses.
    Markers,
    /// Bumped cameras.
    Drift,
    /// Things without a marker.
    Foreign,
    /// The camera's place on the flange.
    HandEye,
    /// Markers in poor pictures, beside the plain library; not run unless named.
    Degraded,
    /// Pictures without markers: false ids; not run unless named.
    Empty,
}

impl Part {
    /// Those that run unless others are named.
    pub(super) const USUAL: [Part; 4] = [Part::Markers, Part::Drift, Part::Foreign, Part::HandEye];
    /// Every part, in the order in which they run.
    pub(super) const ALL: [Part; 6] =
        [Part::Markers, Part::Drift, Part::Foreign, Part::HandEye, Part::Degraded, Part::Empty];
}

/// A part's table, and its figures.
pub(super) type Figures = (String, serde_json::Value);
