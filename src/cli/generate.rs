//! `celld generate`: random instances of the paper's scenarios, as files.
//!
//! In: scenario, number of objects, density, seed. Out: one YAML file a case in a folder, whose first line
//! says how it was made; the paths on standard output. Exit code 0, or 2 with what is wrong.

use crate::cli::plan::seconds;
use crate::cli::task::outln;
use cell_edge::files::{create_folder, write_atomic};
use cell_edge::terminal::complain;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use rearrange::document::chain::chain;
use rearrange::planning::generate::{RatioLaw, Recipe, Scenario, generate};
use rearrange::tabletop::write::to_yaml;
use std::path::PathBuf;

/// Arguments of `celld generate`.
#[derive(Clone, Debug, clap::Args)]
pub struct GenerateArgs {
    /// rand: ellipses and rectangles of random size; sq: two large squares and many small ones
    #[arg(value_parser = scenario_parser())]
    pub scenario: Scenario,
    /// Number of objects
    #[arg(long, value_name = "N")]
    pub objects: usize,
    /// Share of the table that the objects cover; 0.5 is about what can be had
    #[arg(long, value_name = "RHO", value_parser = seconds)]
    pub density: f64,
    /// Number of cases
    #[arg(long, value_name = "K", default_value_t = 1,
          value_parser = clap::value_parser!(u64).range(1..=100_000))]
    pub count: u64,
    /// Seed of every random choice; case k of a seed is the same whatever the count
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    /// Side ratios of rand. paper: longer over shorter, uniform in [1, 3]; public: uniform in [0.33, 1], as
    /// the published instances were made
    #[arg(long, default_value = "paper", value_parser = ratios_parser())]
    pub ratios: RatioLaw,
    /// Folder for the files; files of the same name are replaced
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}

/// A scenario by its word.
pub fn scenario_parser() -> impl TypedValueParser<Value = Scenario> {
    PossibleValuesParser::new(Scenario::ALL.map(Scenario::as_str)).try_map(|word| word.parse::<Scenario>())
}

/// A law of side ratios by its word.
pub fn ratios_parser() -> impl TypedValueParser<Value = RatioLaw> {
    PossibleValuesParser::new(RatioLaw::ALL.map(RatioLaw::as_str)).try_map(|word| word.parse::<RatioLaw>())
}

/// Runs `celld generate`. Returns the exit code.
pub fn run(args: &GenerateArgs) -> u8 {
    match write_all(args) {
        Ok(()) => 0,
        Err(message) => {
            complain(&format!("celld generate: {message}"));
            2
        }
    }
}

fn write_all(args: &GenerateArgs) -> Result<(), String> {
    let GenerateArgs { scenario, objects, density, seed, ratios, .. } = *args;
    let recipe = Recipe { scenario, objects, density, ratios };
    recipe.check().map_err(|error| error.to_string())?;
    create_folder(&args.out).map_err(|error| chain(&error))?;
    for case in 0..args.count {
        let generated =
            generate(&recipe, seed, case).map_err(|error| format!("seed {seed}, case {case}: {error}"))?;
        let law = if ratios == RatioLaw::Public && scenario == Scenario::Rand { "-public" } else { "" };
        let name = format!("{scenario}{law}-n{objects}-d{density}-s{seed}-{case}.yaml");
        let path = args.out.join(name);
        let text = format!("# {}\n{}", generated.origin, to_yaml(&generated.instance));
        write_atomic(&path, text.as_bytes()).map_err(|error| chain(&error))?;
        outln!("{}", path.display());
    }
    Ok(())
}
