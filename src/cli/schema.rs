//! `celld schema`: the shape of a kind of file, for editors and other programs.
//!
//! In: a kind. Out: its JSON Schema (draft-07), which accepts what `celld check` accepts and refuses what is
//! wrong with a single key: unknown names, types, words, ranges. Whether keys fit each other, `check` says.

use cell_edge::terminal::print;
use clap::{Args, ValueEnum};

/// Arguments of `celld schema`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub struct SchemaArgs {
    /// What kind of file
    kind: Kind,
}

const HELP: &str = "\
An editor with a YAML language server checks and completes a file whose first line is

    # yaml-language-server: $schema=config.schema.json

after `celld schema config > config.schema.json` in the same folder.";

/// The kinds of files there are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Kind {
    /// A cell's configuration.
    Config,
    /// The simulated cell's configuration.
    Sim,
    /// A job.
    Job,
    /// A goal file.
    Goal,
    /// A problem for `celld plan`.
    Instance,
    /// A plan that `celld plan --out` wrote.
    Plan,
    /// A file that calibration wrote.
    Calibration,
    /// Faults for the simulated cell.
    Faults,
}

impl Kind {
    /// The schema, as JSON.
    pub fn schema(self) -> &'static str {
        match self {
            Kind::Config => include_str!("../../schemas/config.json"),
            Kind::Sim => include_str!("../../schemas/sim.json"),
            Kind::Job => include_str!("../../schemas/job.json"),
            Kind::Goal => include_str!("../../schemas/goal.json"),
            Kind::Instance => include_str!("../../schemas/instance.json"),
            Kind::Plan => include_str!("../../schemas/plan.json"),
            Kind::Calibration => include_str!("../../schemas/calibration.json"),
            Kind::Faults => include_str!("../../schemas/faults.json"),
        }
    }
}

/// Runs `celld schema`; returns the exit code.
pub fn run(args: &SchemaArgs) -> u8 {
    print(args.kind.schema());
    0
}
