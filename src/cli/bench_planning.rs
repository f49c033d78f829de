//! `celld bench planning`: solvers on generated or public instances.
//!
//! In: which cells, cases and solvers, limits, threads, the share of this machine, a results file. Out: a
//! table for people on standard output, or CSV rows with `--format json`; the rows in the results file as
//! they come, where the same command goes on after an interruption; progress on standard error. Exit code 0
//! when all cases ran, 2 for usage and unreadable files, 130 after Ctrl-C.

use crate::bench::baseline::{self, Measured};
use crate::bench::cells::{Cell, Shard, Unit, units};
use crate::bench::figures::{FIGURES, Spec};
use crate::bench::planning::{Limits, probe};
use crate::bench::results::{Found, ResultsFile};
use crate::bench::runner::Runner;
use crate::bench::summary::summary;
use crate::bench::table::{CSV_HEADER, Row, Table};
use crate::bench::targets::{self, Selection, TARGETS, Target};
use crate::cli::bench_cases::Source;
use crate::cli::generate::ratios_parser;
use crate::cli::plan::{objective_parser, seconds};
use crate::report::text::seconds as duration;
use cell_edge::terminal::{complain, print, read_text};
use clap::builder::PossibleValuesParser;
use indicatif::{ProgressBar, ProgressStyle};
use rearrange::planning::generate::RatioLaw;
use rearrange::planning::plan::{Objective, Status};
use rearrange::planning::solver::SolverKind;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

/// Arguments of `celld bench planning`.
#[derive(Clone, Debug, clap::Args)]
pub struct BenchPlanningArgs {
    /// Take the public instances from this folder (with `hetori` and `trlb` in it) instead of generating
    #[arg(long, value_name = "DIR")]
    pub data: Option<PathBuf>,
    /// The cells of these figures of the paper, instead of --scenario, --density, --n and --objective
    #[arg(long, value_delimiter = ',', value_parser = figure_parser(),
          conflicts_with_all = ["scenario", "density", "n", "objective"])]
    pub figure: Vec<String>,
    /// The cells that auto has figures to reach in; prints what is reached beside them. 10 or 60 s a case,
    /// or
    /// --time-limit if that is less. Generated cases without --data, and then no discs and sticks
    #[arg(long, conflicts_with_all = ["figure", "scenario", "density", "n", "objective"])]
    pub targets: bool,
    /// Of --targets only these cells: SCENARIO/OBJECTIVE/DENSITY/N, from the left as far as given
    /// (rand/pp/0.6, sq/ti)
    #[arg(long, value_delimiter = ',', requires = "targets", value_parser = Selection::parse)]
    pub cells: Vec<Selection>,
    /// Families: rand, sq; with --data also disk, stick, or the name of a folder in `hetori/instances`
    #[arg(long, value_delimiter = ',', default_value = "rand,sq")]
    pub scenario: Vec<String>,
    /// Densities
    #[arg(long, value_delimiter = ',', default_value = "0.20,0.30,0.40", value_parser = seconds)]
    pub density: Vec<f64>,
    /// Numbers of objects
    #[arg(long, value_delimiter = ',', default_value = "20")]
    pub n: Vec<usize>,
    /// Objectives
    #[arg(long, value_delimiter = ',', default_value = "pp", value_parser = objective_parser())]
    pub objective: Vec<Objective>,
    /// The rows of this table of the public code's runs instead of cells; the table printed has both side by
    /// side
    #[arg(long, value_name = "CSV", requires = "data",
          conflicts_with_all = ["figure", "targets", "scenario", "density", "n", "objective", "count", "ids"])]
    pub baseline: Option<PathBuf>,
    /// Cases of each cell; the paper has 50
    #[arg(long, value_name = "K", default_value_t = 5,
          value_parser = clap::value_parser!(u64).range(1..=100_000))]
    pub count: u64,
    /// Ids of public cases instead of the first ones; pairs like 1-3 for discs and sticks
    #[arg(long, value_delimiter = ',', requires = "data")]
    pub ids: Option<Vec<String>>,
    /// Seed that the cases are generated from
    #[arg(long, value_name = "S", default_value_t = 0, conflicts_with = "data")]
    pub instance_seed: u64,
    /// Side ratios of generated rand cases, see `celld generate --help`
    #[arg(long, default_value = "paper", value_parser = ratios_parser(), conflicts_with = "data")]
    pub ratios: RatioLaw,
    /// Solvers; paper: its six
    #[arg(long, value_delimiter = ',', default_value = "erbm", value_parser = solvers_parser())]
    pub solver: Vec<String>,
    /// Seeds of the solvers
    #[arg(long, value_delimiter = ',', default_value = "0")]
    pub seed: Vec<u64>,
    /// Seconds for one case; the paper has 600
    #[arg(long, value_name = "S", default_value = "60", value_parser = seconds)]
    pub time_limit: f64,
    /// Deterministic steps for one case
    #[arg(long, value_name = "N")]
    pub work: Option<u64>,
    /// End each case at its first plan, as the paper's figures do
    #[arg(long)]
    pub first: bool,
    /// As `celld plan --strict-paper`; rows do not record it, so use another --out
    #[arg(long)]
    pub strict_paper: bool,
    /// Cases at the same time; default: one for each core
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Threads of each case, for auto
    #[arg(long, value_name = "N", default_value_t = 1,
          value_parser = clap::value_parser!(u16).range(1..=256))]
    pub solver_threads: u16,
    /// Run part i of N only; the parts' files merge by concatenation
    #[arg(long, value_name = "i/N", value_parser = Shard::parse)]
    pub shard: Option<Shard>,
    /// Write rows to this CSV file as they come; rows that are there are not run again
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// What standard output gets: a table, or (json, csv) the rows as CSV
    #[arg(long, default_value = "table", value_parser = ["table", "json", "csv"])]
    pub format: String,
}

/// The paper's figures by name.
pub fn figure_parser() -> PossibleValuesParser {
    PossibleValuesParser::new(FIGURES.iter().map(|spec| spec.name).chain(["all"]))
}

/// The figures of these names.
pub fn figures(names: &[String]) -> Vec<Spec> {
    let wanted = |spec: &&Spec| names.iter().any(|name| name == spec.name || name == "all");
    FIGURES.iter().filter(wanted).copied().collect()
}

fn solvers_parser() -> PossibleValuesParser {
    PossibleValuesParser::new(SolverKind::ALL.map(SolverKind::as_str).into_iter().chain(["paper"]))
}

fn solvers(words: &[String]) -> Vec<SolverKind> {
    let paper = ["tbm", "etbm", "rbm", "erbm", "mcts", "emcts"];
    let words = words.iter().flat_map(|word| match word.as_str() {
        "paper" => paper.to_vec(),
        word => vec![word],
    });
    let mut kinds: Vec<SolverKind> = Vec::new();
    for kind in words.filter_map(|word| word.parse::<SolverKind>().ok()) {
        if !kinds.contains(&kind) {
            kinds.push(kind);
        }
    }
    kinds
}

/// Runs the benchmark; `stop` is set by Ctrl-C. Returns the exit code.
pub fn run(args: &BenchPlanningArgs, stop: &AtomicBool) -> u8 {
    match run_all(args, stop) {
        Ok(code) => code,
        Err(message) => {
            complain(&message);
            2
        }
    }
}

fn run_all(args: &BenchPlanningArgs, stop: &AtomicBool) -> Result<u8, String> {
    let source = source(args);
    let measured = args.baseline.as_ref().map(|path| read_baseline(path)).transpose()?;
    let units = wanted(args, &source, measured.as_deref())?;
    let (file, found) = match &args.out {
        Some(path) => ResultsFile::open(path).map(|(file, found)| (Some(file), found))?,
        None => (None, Found::default()),
    };
    let mut rows = RowSink::new(args, file, &units, found);
    let left: Vec<Unit> = units.into_iter().filter(|unit| !rows.table.has(&unit.key)).collect();
    rows.announce(&left);
    let limits_of = |unit: &Unit| limits(args, &unit.cell);
    let runner = Runner {
        load: &|unit| source.problem(unit),
        limits: &limits_of,
        threads: threads(args),
        stop: &|| stop.load(Ordering::Relaxed),
    };
    let ended = runner.run(&left, &mut |row| rows.take(row));
    rows.bar.finish_and_clear();
    ended?;
    rows.finish(measured.as_deref());
    if stop.load(Ordering::Relaxed) && rows.fresh < left.len() {
        let go_on = if args.out.is_some() { "; the same command goes on from there" } else { "" };
        complain(&format!("stopped with {} of {} runs to go{go_on}", left.len() - rows.fresh, left.len()));
        return Ok(130);
    }
    Ok(0)
}

/// Where the cases come from.
fn source(args: &BenchPlanningArgs) -> Source {
    match &args.data {
        Some(data) => Source::Public { data: data.clone(), ids: args.ids.clone(), count: args.count },
        None => Source::Generated { seed: args.instance_seed, count: args.count, ratios: args.ratios },
    }
}

fn limits(args: &BenchPlanningArgs, cell: &Cell) -> Limits {
    Limits {
        seconds: if args.targets { targets::limit(cell).min(args.time_limit) } else { args.time_limit },
        work: args.work,
        first: args.first,
        strict_paper: args.strict_paper,
        solver_threads: args.solver_threads,
    }
}

fn read_baseline(path: &Path) -> Result<Vec<Measured>, String> {
    baseline::parse(&read_text(path)?, &path.display().to_string())
}

fn threads(args: &BenchPlanningArgs) -> usize {
    let cores = || std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    args.threads.map_or_else(cores, usize::from)
}

/// The runs requested on this machine; what cannot be run at all is reported before anything is run.
fn wanted(
    args: &BenchPlanningArgs,
    source: &Source,
    measured: Option<&[Measured]>,
) -> Result<Vec<Unit>, String> {
    let (cells, solvers) = (measured.map_or_else(|| cells(args), baseline::cells), solvers(&args.solver));
    if let Some(data) = args.data.as_ref().filter(|data| !data.is_dir()) {
        return Err(format!("--data {}: there is no such folder", data.display()));
    }
    for &solver in &solvers {
        for cell in &cells {
            probe(solver, cell.objective).map_err(|error| format!("--solver {solver}: {error}"))?;
        }
    }
    for cell in &cells {
        source.check(cell)?;
        if measured.is_none() && source.ids(cell).is_empty() {
            complain(&format!(
                "no case of {} density {} n {} among the data",
                cell.scenario, cell.density, cell.objects
            ));
        }
    }
    let all = match measured {
        None => units(&cells, &|cell| source.ids(cell), &solvers, &args.seed),
        Some(rows) => their_units(source, rows, &solvers, &args.seed),
    };
    if all.is_empty() {
        return Err("no case of the cells asked for; see --data, --scenario, --density, --n and --ids".into());
    }
    Ok(args.shard.unwrap_or(Shard::WHOLE).take(all, solvers.len() * args.seed.len()))
}

/// The runs of the public code's table that these solvers can repeat.
fn their_units(source: &Source, rows: &[Measured], solvers: &[SolverKind], seeds: &[u64]) -> Vec<Unit> {
    let mut all = baseline::units(rows, seeds);
    all.retain(|unit| solvers.contains(&unit.key.solver));
    let wanted = all.len();
    all.retain(|unit| source.has(&unit.cell, &unit.key.id));
    if all.len() < wanted {
        complain(&format!(
            "{} of {wanted} runs left out: no such instance among the data",
            wanted - all.len()
        ));
    }
    all
}

fn cells(args: &BenchPlanningArgs) -> Vec<Cell> {
    if !args.figure.is_empty() {
        return figures(&args.figure).iter().flat_map(Spec::cells).collect();
    }
    if args.targets {
        let requested = |cell: &Cell| args.cells.is_empty() || args.cells.iter().any(|some| some.takes(cell));
        let there = |cell: &Cell| args.data.is_some() || ["rand", "sq"].contains(&cell.scenario.as_str());
        let kept = |cell: &Cell| requested(cell) && there(cell);
        return TARGETS.iter().flat_map(Target::cells).filter(kept).collect();
    }
    let mut cells = Vec::new();
    for scenario in &args.scenario {
        for &density in &args.density {
            for &objects in &args.n {
                cells.extend(args.objective.iter().map(|&objective| Cell {
                    scenario: scenario.clone(),
                    density,
                    objects,
                    objective,
                }));
            }
        }
    }
    cells
}

/// Where rows arrive: file, standard output, progress.
struct RowSink<'a> {
    args: &'a BenchPlanningArgs,
    file: Option<ResultsFile>,
    /// Rows of the requested runs, those of earlier runs first.
    table: Table,
    fresh: usize,
    failures: usize,
    bar: ProgressBar,
    csv: bool,
}

impl<'a> RowSink<'a> {
    fn new(
        args: &'a BenchPlanningArgs,
        file: Option<ResultsFile>,
        units: &[Unit],
        found: Found,
    ) -> RowSink<'a> {
        if found.cut {
            complain("the results file ended in the middle of a line; that case is run again");
        }
        let mut table = Table::default();
        let keys: std::collections::HashSet<_> = units.iter().map(|unit| &unit.key).collect();
        for row in found.table.rows.into_iter().filter(|row| keys.contains(&row.key)) {
            table.add(row);
        }
        let bar = ProgressBar::hidden();
        RowSink { args, file, table, fresh: 0, failures: 0, bar, csv: args.format != "table" }
    }

    /// Says what there is to do, and prints the rows that are there.
    fn announce(&mut self, units: &[Unit]) {
        let (threads, left) = (threads(self.args), units.len());
        let rows = &self.table.rows;
        let all: f64 = units.iter().map(|unit| limits(self.args, &unit.cell).seconds).sum();
        let worst = (all / threads.min(left.max(1)) as f64).max(0.0);
        complain(&format!(
            "{left} runs on {threads} threads, {} done earlier; at most about {}",
            rows.len(),
            duration(worst)
        ));
        let shorter = |row: &&Row| {
            row.status == Status::Timeout
                && self.args.work.is_none()
                && row.seconds < 0.9 * self.args.time_limit
        };
        let kept = rows.iter().filter(shorter).count();
        if kept > 0 {
            complain(&format!(
                "{kept} of them ended without a plan at a shorter limit and stay so; use another --out for \
                 another limit"
            ));
        }
        if self.csv {
            print(&format!("{CSV_HEADER}\n"));
            rows.iter().for_each(|row| print(&format!("{}\n", row.csv())));
        }
        let template = "{bar:30} {pos}/{len} runs, {elapsed} gone, about {eta} to go {msg}";
        let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
        self.bar = ProgressBar::new(left as u64).with_style(style);
        self.bar.enable_steady_tick(std::time::Duration::from_millis(500));
    }

    fn take(&mut self, row: Row) -> Result<(), String> {
        if let Some(file) = &mut self.file {
            file.add(&row)?;
        }
        if self.csv {
            self.bar.suspend(|| print(&format!("{}\n", row.csv())));
        }
        self.failures += usize::from(row.cost.is_none());
        self.fresh += 1;
        self.table.add(row);
        self.bar.inc(1);
        if self.failures > 0 {
            self.bar.set_message(format!("({} without a plan)", self.failures));
        }
        Ok(())
    }

    fn finish(&self, measured: Option<&[Measured]>) {
        let rows = &self.table.rows;
        let text = match measured {
            Some(measured) => baseline::report(measured, rows),
            None if self.args.targets => format!("{}{}", summary(rows), targets::report(rows)),
            None => summary(rows),
        };
        if self.csv { complain(&text) } else { print(&text) }
    }
}
