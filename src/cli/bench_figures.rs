//! `celld bench figures`: the paper's figures from result tables.
//!
//! In: CSV files of `celld bench planning`, whole runs or shards. Out: one SVG and one PNG a figure in a
//! folder, their paths on standard output. Exit code 0, or 2 with what is wrong: an unreadable table, no row
//! for any figure.

use crate::bench::figures::{FIGURES, Spec, figure};
use crate::bench::table::{Row, Table};
use crate::cli::bench_planning::{figure_parser, figures};
use crate::cli::task::outln;
use crate::report::chart::figure_svg;
use crate::report::raster::png;
use cell_edge::files::{create_folder, write_atomic};
use cell_edge::terminal::{complain, read_text};
use rearrange::document::chain::chain;
use std::path::PathBuf;

/// Pixels of the PNG to one unit of the SVG.
const PNG_SCALE: f32 = 2.0;

/// Arguments of `celld bench figures`.
#[derive(Clone, Debug, clap::Args)]
pub struct BenchFiguresArgs {
    /// Result tables; a case that is in several counts once, as it is in the first
    #[arg(required = true, value_name = "CSV")]
    pub tables: Vec<PathBuf>,
    /// Figures to draw
    #[arg(long, value_delimiter = ',', default_value = "all", value_parser = figure_parser())]
    pub figure: Vec<String>,
    /// Folder for the pictures
    #[arg(long, value_name = "DIR", default_value = "out/figures")]
    pub out: PathBuf,
}

/// Runs `celld bench figures`. Returns the exit code.
pub fn run(args: &BenchFiguresArgs) -> u8 {
    match draw(args) {
        Ok(()) => 0,
        Err(message) => {
            complain(&message);
            2
        }
    }
}

fn draw(args: &BenchFiguresArgs) -> Result<(), String> {
    let rows = read(args)?;
    let mut missing = Vec::new();
    let mut drawn = 0;
    for spec in figures(&args.figure) {
        match draw_one(args, &spec, &rows)? {
            true => drawn += 1,
            false => missing.push(spec.name),
        }
    }
    if drawn == 0 {
        let names: Vec<&str> = FIGURES.iter().map(|spec| spec.name).collect();
        return Err(format!(
            "no row belongs into the requested figures; `celld bench planning --figure NAME` runs the cells \
             of one ({})",
            names.join(", ")
        ));
    }
    if !missing.is_empty() {
        complain(&format!("no rows for {}", missing.join(", ")));
    }
    Ok(())
}

fn read(args: &BenchFiguresArgs) -> Result<Vec<Row>, String> {
    let mut table = Table::default();
    for path in &args.tables {
        table.read(&read_text(path)?, &path.display().to_string())?;
    }
    if table.repeated > 0 {
        complain(&format!("{} rows stand there more than once; the first of each counts", table.repeated));
    }
    Ok(table.rows)
}

/// False when there is nothing to draw.
fn draw_one(args: &BenchFiguresArgs, spec: &Spec, rows: &[Row]) -> Result<bool, String> {
    let Some(figure) = figure(spec, rows) else { return Ok(false) };
    create_folder(&args.out).map_err(|error| chain(&error))?;
    let svg = figure_svg(&figure);
    let picture = png(&svg, PNG_SCALE).map_err(|fault| format!("{}: {fault}", spec.name))?;
    for (ending, bytes) in [("svg", svg.as_bytes()), ("png", &picture)] {
        let path = args.out.join(format!("{}.{ending}", spec.name));
        write_atomic(&path, bytes).map_err(|error| chain(&error))?;
        outln!("{}", path.display());
    }
    Ok(true)
}
