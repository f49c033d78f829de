//! A round as the command line requests it.
//!
//! In: the command line. Out: what taking a round and solving it have in common.

use crate::cli::calibrate::touch::RegistrationArgs;
use clap::Args;
use std::path::PathBuf;

/// A round over the reference markers.
#[derive(Args, Clone, Debug)]
pub struct RoundArgs {
    /// The cell's configuration, with nominal camera mount, table and calibration poses.
    #[arg(long, default_value = "config/cell.yaml", value_name = "FILE")]
    pub(super) config: PathBuf,
    /// Solve a round recorded in this folder instead of moving the arm.
    #[arg(long, value_name = "DIR", conflicts_with = "record")]
    pub(super) from: Option<PathBuf>,
    /// Keep the round's pictures and poses in this folder.
    #[arg(long, value_name = "DIR")]
    pub(super) record: Option<PathBuf>,
    /// Leave these samples out, by their numbers in the report: 3,7
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    pub(super) drop: Vec<usize>,
    #[command(flatten)]
    pub(super) registration: RegistrationArgs,
}
