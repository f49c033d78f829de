//! `celld markers`: object markers and calibration boards for the printer, as SVG or PDF at true scale.
//!
//! In: family, numbers or a grid, size, paper. Out: one PDF, or one SVG a sheet, each with a ruler to check
//! the print by. Exit codes: 0 written, 2 bad input.

use crate::report::prints::{self, Paper, Sheet};
use cell_edge::files;
use cell_edge::terminal::{complain, print};
use cell_vision::board::Board;
use cell_vision::detect::Family;
use std::path::{Path, PathBuf};

/// Arguments of `celld markers`.
#[derive(Clone, Debug, clap::Args)]
pub struct MarkersArgs {
    /// Marker family: tag36h11 is the cell's own
    #[arg(long, default_value = "tag36h11")]
    family: Family,
    /// Numbers to print: 0-9,12
    #[arg(long, value_name = "LIST", value_parser = id_list, required_unless_present = "board")]
    ids: Option<IdList>,
    /// A calibration board of C x R markers instead, e.g. 7x5
    #[arg(long, value_name = "CxR", value_parser = grid, conflicts_with = "ids")]
    board: Option<[u32; 2]>,
    /// The board's lowest number
    #[arg(long, value_name = "N", default_value_t = 0, requires = "board")]
    first_id: u32,
    /// Edge of the black square, mm
    #[arg(long, value_name = "MM", default_value_t = 30.0, value_parser = millimetres)]
    size_mm: f64,
    /// Paper
    #[arg(long, default_value = "a4", value_parser = ["a4", "letter"])]
    paper: String,
    /// Where to write: .pdf, or .svg (several sheets become NAME-1.svg, NAME-2.svg, ...)
    #[arg(long, value_name = "FILE", default_value = "markers.pdf")]
    out: PathBuf,
}

/// Marker numbers in the requested order.
#[derive(Clone, Debug, PartialEq)]
struct IdList(Vec<u32>);

/// More on one order is a slip of the finger.
const MOST_IDS: usize = 10_000;

fn id_list(text: &str) -> Result<IdList, String> {
    let mut ids = Vec::new();
    for part in text.split(',') {
        let (low, high) = part.split_once('-').unwrap_or((part, part));
        let number =
            |text: &str| text.trim().parse::<u32>().map_err(|_| format!("{part:?} is no number or range"));
        let (low, high) = (number(low)?, number(high)?);
        if low > high || (high - low) as usize >= MOST_IDS || ids.len() > MOST_IDS {
            return Err(format!("{part:?} is no range of at most {MOST_IDS} numbers"));
        }
        ids.extend(low..=high);
    }
    Ok(IdList(ids))
}

/// `7x5` as columns and rows.
///
/// # Errors
/// The text is not two numbers from 1 to 100 with an `x` between them.
pub fn grid(text: &str) -> Result<[u32; 2], String> {
    let number = |text: &str| text.parse::<u32>().ok().filter(|n| (1..=100).contains(n));
    let numbers = text.split_once(['x', 'X']).and_then(|(c, r)| Some([number(c)?, number(r)?]));
    numbers.ok_or_else(|| format!("{text:?} is no board: columns x rows, e.g. 7x5"))
}

/// A marker's edge in mm.
///
/// # Errors
/// The text is not a number from 1 to 1000.
pub fn millimetres(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if (1.0..=1000.0).contains(&value) => Ok(value),
        _ => Err(format!("{text:?} is not a size of 1 to 1000 mm")),
    }
}

/// Runs the subcommand and returns the exit code.
pub fn run(args: &MarkersArgs) -> u8 {
    match write(args) {
        Ok(text) => {
            print(&text);
            0
        }
        Err(message) => {
            complain(&format!("celld markers: {message}"));
            2
        }
    }
}

fn write(args: &MarkersArgs) -> Result<String, String> {
    let sheets = sheets(args)?;
    let put = |path: &Path, text: &str| {
        files::write_atomic(path, text.as_bytes()).map_err(|error| error.to_string())
    };
    let mut reported = String::new();
    match args.out.extension().and_then(|extension| extension.to_str()) {
        Some("pdf") => {
            put(&args.out, &prints::pdf(&sheets))?;
            reported = format!("{}: {} sheet(s)\n", args.out.display(), sheets.len());
        }
        Some("svg") => {
            for (index, sheet) in sheets.iter().enumerate() {
                let path = numbered(&args.out, index + 1, sheets.len());
                put(&path, &sheet.svg())?;
                reported.push_str(&format!("{}\n", path.display()));
            }
        }
        _ => return Err(format!("{}: the name has to end in .pdf or .svg", args.out.display())),
    }
    reported.push_str("print at 100 %, measure the ruler\n");
    Ok(reported)
}

fn sheets(args: &MarkersArgs) -> Result<Vec<Sheet>, String> {
    let paper = if args.paper == "letter" { Paper::Letter } else { Paper::A4 };
    let size_m = args.size_mm / 1000.0;
    let made = match (args.board, &args.ids) {
        (Some([columns, rows]), _) => {
            let board = Board::new(args.family, columns, rows, size_m, args.first_id);
            prints::board(&board, paper).map(|sheet| vec![sheet])
        }
        (None, Some(IdList(ids))) => prints::markers(args.family, ids, size_m, paper),
        (None, None) => prints::markers(args.family, &[], size_m, paper),
    };
    made.map_err(|fault| fault.to_string())
}

/// The file of a sheet: the name itself when there is only one.
fn numbered(path: &Path, number: usize, of: usize) -> PathBuf {
    if of == 1 {
        return path.to_path_buf();
    }
    let stem = path.file_stem().and_then(|stem| stem.to_str()).unwrap_or("markers");
    path.with_file_name(format!("{stem}-{number}.svg"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn args(out: PathBuf, ids: &str) -> MarkersArgs {
        MarkersArgs {
            family: Family::Tag36h11,
            ids: Some(id_list(ids).unwrap()),
            board: None,
            first_id: 0,
            size_mm: 30.0,
            paper: "a4".into(),
            out,
        }
    }

    #[test]
    fn lists_and_grids_are_read_or_refused() {
        assert_eq!(id_list("0-2,7").unwrap(), IdList(vec![0, 1, 2, 7]));
        for wrong in ["", "3-1", "a", "1-99999999", "-4"] {
            assert!(id_list(wrong).is_err(), "{wrong}");
        }
        assert_eq!(grid("7x5"), Ok([7, 5]));
        assert!(grid("7").is_err() && grid("0x5").is_err() && grid("7x5x3").is_err());
        assert!(millimetres("nan").is_err() && millimetres("30").is_ok());
    }

    #[test]
    fn files_are_written_by_the_ending_of_their_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        write(&args(path("m.pdf"), "0-9")).unwrap();
        assert!(std::fs::read(path("m.pdf")).unwrap().starts_with(b"%PDF-1.4"));
        write(&args(path("m.svg"), "0-99")).unwrap();
        assert!(path("m-2.svg").exists() && !path("m.svg").exists());
        assert!(write(&args(path("m.png"), "1")).unwrap_err().contains(".pdf or .svg"));
        assert!(write(&args(path("m.pdf"), "600")).unwrap_err().contains("0 to 586"));
    }
}
