//! Arguments of `celld simulate`, and the trace that they may want.

use crate::pair::Pair;
use crate::pair::camera_view::SightKind;
use crate::pair::stage::Stage;
use crate::pair::table::stage;
use crate::pair::worst::worst;
use cell_edge::terminal::complain;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Args, ValueEnum};
use std::path::PathBuf;
use ur_sim::motion::rounding::{BlendConfig, ENTRY_SPEEDS, EntrySpeed};

/// `celld simulate`
#[derive(Args, Clone, Debug)]
#[command(after_help = HELP)]
pub struct SimulateArgs {
    /// Seed of the cell's truth, of every delay and of the jobs
    #[arg(long, default_value_t = 0)]
    pub(super) seed: u64,
    /// Jobs of two to four moves
    #[arg(long, default_value_t = 3)]
    pub(super) jobs: usize,
    /// A fault file, as for `celld sim`; or `sweep`: every fault in every phase of a pick-n-place; or
    /// `random`: one to three faults in every job, each job of the next seed; `hands`: the same with hands
    /// that push objects, and the camera, between looks; `shell`: with late orders, and a celld that stands
    /// still or is cut off from its folder; `cuts`: power cuts after every effect of every job
    #[arg(long, value_name = "FILE|sweep|random|hands|shell|cuts")]
    pub(super) faults: Option<PathBuf>,
    /// One cell at work for so many hours, with a fault every ten minutes: a line an hour says what was done
    /// and how large the machine and this process are
    #[arg(long, value_name = "N", conflicts_with_all = ["faults", "orders", "replay"],
          value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub(super) hours: Option<u32>,
    /// Every order of the operator in every state of the cell: the answer is held against what happens
    #[arg(long, conflicts_with_all = ["faults", "trace"])]
    pub(super) orders: bool,
    /// Of the sweep or the orders: only cases whose number, name or phase contains this; of random faults:
    /// only these, by number
    #[arg(long, value_name = "TEXT")]
    pub(super) only: Option<String>,
    /// Of the sweep or the orders: write their page to this file
    #[arg(long, value_name = "FILE")]
    pub(super) write: Option<PathBuf>,
    /// Record every run and carry it out again beside it, from the recording's bytes: each decision has to
    /// be the same (not with `sweep`, `hands`, `shell`, `cuts` and `--orders`)
    #[arg(long)]
    pub(super) replay: bool,
    /// How the cell sees: rendered pictures with the real detector, or marker corners with its noise
    #[arg(long, value_enum, default_value_t = SightArg::Corners)]
    pub(super) eye: SightArg,
    /// Speed at which the simulated arm passes blends (see `blend:` in config/sim.yaml); `none`: celld plans
    /// no blends. The pages in docs/ are compared only with `braked`
    #[arg(long, value_name = "SPEED", value_parser = blends(), default_value = "braked")]
    pub(super) blend: Blend,
    /// `worst`: the worst plausible controller, gripper and network, see docs/simulator.md. The pages in
    /// docs/ are compared only with `usual`
    #[arg(long, value_enum, default_value_t = ControllerArg::Usual, conflicts_with = "blend")]
    pub(super) controller: ControllerArg,
    /// Write what happened, line by line, to this file; the same seed writes the same bytes
    #[arg(long, value_name = "FILE")]
    pub(super) trace: Option<PathBuf>,
}

const HELP: &str = "\
The machine that drives a real robot, the simulated cell, a network and a disk run on one thread
without socket, file or clock: the same seed gives the same trace, byte for byte. After every 2 ms
of simulated time the rules that hold at all times are checked against the simulated truth.";

/// How controller, gripper and network behave.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ControllerArg {
    /// As usual.
    Usual,
    /// As badly as is still plausible.
    Worst,
}

/// How the cell sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum SightArg {
    /// Rendered pictures with the real detector.
    Pictures,
    /// Marker corners with the detector's noise.
    Corners,
}

/// Blends in celld's paths, and the speed at which the simulated arm passes them; `None`: no blends.
pub(super) type Blend = Option<EntrySpeed>;

/// Value of `--blend` for paths without blends.
const NO_BLENDS: &str = "none";

/// The speeds by their names.
fn blends() -> impl TypedValueParser<Value = Blend> {
    let names = ENTRY_SPEEDS.iter().map(|(name, _)| *name).chain([NO_BLENDS]);
    let known = |name: String| ENTRY_SPEEDS.iter().find(|(known, _)| *known == name);
    PossibleValuesParser::new(names).map(move |name| known(name).map(|(_, speed)| *speed))
}

impl SimulateArgs {
    /// The closed loop's cell with this seed.
    pub(super) fn stage(&self, seed: u64, eye: SightKind) -> Result<Stage, String> {
        let mut stage = stage(seed, eye)?;
        match self.controller {
            ControllerArg::Usual => match self.blend {
                Some(entry_speed) => stage.controller.blends = BlendConfig { entry_speed, seed },
                None => stage.model.cycle.blend = 0.0,
            },
            ControllerArg::Worst => worst(&mut stage, seed)?,
        }
        Ok(stage)
    }

    /// Arm and controller are those of the pages in docs/.
    pub(super) fn is_usual(&self) -> bool {
        self.blend == Some(EntrySpeed::Braked) && self.controller == ControllerArg::Usual
    }

    /// Says why no page is written, where that is so: the pages in docs/ are those of the usual cell.
    pub(super) fn refuses_to_write(&self) -> bool {
        let refuses = self.write.is_some() && !self.is_usual();
        if refuses {
            complain("--write: the page is that of the usual cell; leave --blend and --controller out");
        }
        refuses
    }

    /// Arguments to append to the command that repeats a failure.
    pub(super) fn repeat_arguments(&self) -> String {
        if self.controller == ControllerArg::Worst {
            return " --controller worst".to_string();
        }
        if self.is_usual() {
            return String::new();
        }
        let name = ENTRY_SPEEDS.iter().find(|(_, speed)| Some(*speed) == self.blend);
        format!(" --blend {}", name.map_or(NO_BLENDS, |(name, _)| name))
    }
}

/// Writes the trace where it is wanted.
pub(super) fn keep_trace(args: &SimulateArgs, pair: &Pair) -> Result<(), String> {
    let Some(path) = &args.trace else { return Ok(()) };
    std::fs::write(path, pair.trace.lines().join("\n") + "\n")
        .map_err(|error| format!("{}: {error}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pair::network::Weather;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        args: SimulateArgs,
    }

    fn read(words: &[&str]) -> Result<SimulateArgs, String> {
        let line = ["celld simulate"].iter().chain(words);
        Line::try_parse_from(line).map(|line| line.args).map_err(|error| error.to_string())
    }

    #[test]
    fn blend_option_reaches_the_arm_and_the_repeat_command() {
        let usual = read(&[]).expect("no option is required");
        assert_eq!((usual.blend, usual.repeat_arguments()), (Some(EntrySpeed::Braked), String::new()));
        for (word, entry_speed) in ENTRY_SPEEDS {
            let args = read(&["--blend", word]).expect(word);
            let stage = args.stage(7, SightKind::Corners).expect("the usual cell");
            assert_eq!(stage.controller.blends, BlendConfig { entry_speed: *entry_speed, seed: 7 });
            let repeated = args.repeat_arguments();
            let words: Vec<&str> = repeated.split_whitespace().collect();
            assert_eq!(read(&words).expect(word).blend, Some(*entry_speed));
        }
        let none = read(&["--blend", "none"]).expect("no blends");
        assert_eq!(none.stage(7, SightKind::Corners).expect("the cell").model.cycle.blend, 0.0);
        assert_eq!(none.repeat_arguments(), " --blend none");
        assert!(!usual.refuses_to_write() && !read(&["--write", "a.md"]).expect("a page").refuses_to_write());
        assert!(read(&["--blend", "none", "--write", "a.md"]).expect("a page").refuses_to_write());
        let worst = read(&["--controller", "worst"]).expect("worst");
        let stage = worst.stage(7, SightKind::Corners).expect("the worst cell");
        assert!(stage.weather == Weather::WORST && stage.world.gripper.overshoot > 0.0);
        assert_eq!(worst.repeat_arguments(), " --controller worst");
        assert!(read(&["--blend", "quick"]).unwrap_err().contains("braked, kept, scaled, raised, none"));
    }
}
