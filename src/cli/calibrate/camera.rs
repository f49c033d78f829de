//! `celld calibrate camera`: the lens, from pictures of a printed board (`celld markers --board`).
//!
//! In: a folder of pictures, or a live camera and a person who moves the board; the board's geometry. Out:
//! `camera.yaml` with the error of every picture, and the same on stderr. Exit codes: 0 written, 1 the
//! pictures do not determine the lens, 2 bad input.

use crate::cli::calibrate::fault::{Fault, bad_input};
use crate::cli::calibrate::take::take;
use crate::cli::daemon::open_camera;
use crate::cli::markers::{grid, millimetres};
use crate::config::load::load_cell;
use crate::config::pictures::read_picture;
use crate::io::camera::CameraSource;
use crate::jobs::utc;
use cell_calibration::files::camera::CameraCalibration;
use cell_calibration::fit::lens::{BoardView, LensSettings, LensSolution, solve_lens};
use cell_edge::clock::unix_now_s;
use cell_edge::files;
use cell_edge::terminal::complain;
use cell_values::image::Image;
use cell_vision::board::Board;
use cell_vision::detect::{DetectSettings, Detector, Family};
use rearrange::document::chain::chain;
use std::path::{Path, PathBuf};

/// Arguments of `celld calibrate camera`.
#[derive(Clone, Debug, clap::Args)]
pub struct CameraArgs {
    /// Folder of pictures of the board (PNG or JPEG), all of one camera at one size
    #[arg(value_name = "DIR", required_unless_present = "config")]
    pub images: Option<PathBuf>,
    /// Take the pictures with this cell's camera instead: one each time Enter is pressed
    #[arg(long, value_name = "FILE", conflicts_with = "images", requires = "save")]
    pub config: Option<PathBuf>,
    /// Folder for the pictures taken
    #[arg(long, value_name = "DIR", requires = "config")]
    pub save: Option<PathBuf>,
    /// Pictures to take
    #[arg(long, value_name = "N", default_value_t = 24, requires = "config")]
    pub count: usize,
    /// Markers across and up
    #[arg(long, value_name = "CxR", default_value = "7x5", value_parser = grid)]
    pub board: [u32; 2],
    /// The markers' family
    #[arg(long, default_value = "tag36h11")]
    pub family: Family,
    /// The board's lowest number
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub first_id: u32,
    /// Edge of a black square as measured on the print, mm
    #[arg(long, value_name = "MM", value_parser = millimetres)]
    pub size_mm: f64,
    /// White between two squares as measured, mm; default: 0.3 of the edge, as `celld markers` prints
    #[arg(long, value_name = "MM", value_parser = millimetres)]
    pub gap_mm: Option<f64>,
    /// The camera's serial number, as on its label; with --config, the camera is queried
    #[arg(long, value_name = "TEXT", required_unless_present = "config")]
    pub serial: Option<String>,
    /// Leave these pictures out, by name
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    pub drop: Vec<String>,
    /// Where to write; default: the file that --config names
    #[arg(long, value_name = "FILE", required_unless_present = "config")]
    pub out: Option<PathBuf>,
}

/// Runs the subcommand and returns the exit code.
pub fn run(args: &CameraArgs) -> u8 {
    match calibrate(args) {
        Ok(()) => 0,
        Err(fault) => {
            complain(&format!("celld calibrate camera: {}", fault.message));
            fault.code
        }
    }
}

/// Measures the lens and writes its file.
pub(super) fn calibrate(args: &CameraArgs) -> Result<(), Fault> {
    let Places { folder, out, serial } = places(args)?;
    let names = pictures(&folder, &args.drop)?;
    let ([columns, rows], board) = (args.board, board_of(args));
    let BoardPictures { views, width, height } = look(&folder, &names, &board)?;
    let solved = solve_lens(&views, width, height, &LensSettings::default());
    let solved = solved.map_err(|error| Fault { message: chain(&error), code: 1 })?;
    report(&solved);
    let source = format!(
        "{} board {columns}x{rows}, squares {} mm, {} pictures",
        board.family,
        args.size_mm,
        solved.samples.iter().filter(|sample| !sample.rejected).count()
    );
    let file = CameraCalibration::from_solution(solved, &serial, source, utc::text(unix_now_s()));
    if let Some(parent) = out.parent().filter(|parent| !parent.as_os_str().is_empty()) {
        files::create_folder(parent).map_err(|error| bad_input(error.to_string()))?;
    }
    files::write_atomic(&out, file.to_yaml().as_bytes()).map_err(|error| bad_input(error.to_string()))?;
    complain(&format!(
        "wrote {}; now run `celld calibrate hand-eye`: a lens that changed moves everything",
        out.display()
    ));
    Ok(())
}

/// The board as printed and measured.
fn board_of(args: &CameraArgs) -> Board {
    let [columns, rows] = args.board;
    let mut board = Board::new(args.family, columns, rows, args.size_mm / 1e3, args.first_id);
    if let Some(gap_mm) = args.gap_mm {
        board.gap_m = gap_mm / 1e3;
    }
    board
}

/// The folder with pictures in it, the file to write, the camera's serial number.
struct Places {
    folder: PathBuf,
    out: PathBuf,
    serial: String,
}

/// Says where everything is; takes the pictures first if need be.
fn places(args: &CameraArgs) -> Result<Places, Fault> {
    let Some(path) = &args.config else {
        let (Some(images), Some(out), Some(serial)) = (&args.images, &args.out, &args.serial) else {
            return Err(bad_input("a folder of pictures, --out and --serial are needed".into()));
        };
        return Ok(Places { folder: images.clone(), out: out.clone(), serial: serial.clone() });
    };
    let config = load_cell(path).map_err(|error| bad_input(error.to_string()))?;
    let Some(save) = &args.save else { return Err(bad_input("--save DIR is needed with --config".into())) };
    files::create_folder(save).map_err(|error| bad_input(error.to_string()))?;
    if pictures(save, &[]).is_ok() {
        let message = "there are pictures in it already: name a new folder, or solve those without --config";
        return Err(bad_input(format!("--save {}: {message}", save.display())));
    }
    let mut camera = open_camera(&config, None).map_err(bad_input)?;
    let own = camera.serial().map_err(|error| Fault { message: chain(&error), code: 1 })?;
    if let Some(reported) = args.serial.as_ref().filter(|reported| **reported != own) {
        return Err(bad_input(format!("--serial {reported}, but the camera is {own}; leave --serial out")));
    }
    complain("hold the board still before the camera and press Enter for each picture; Ctrl-D ends early");
    let mut ready = || std::io::stdin().read_line(&mut String::new()).is_ok_and(|bytes| bytes > 0);
    take(&mut camera, &board_of(args), save, args.count, &mut ready)?;
    let out = args.out.clone().unwrap_or(config.calibration.camera);
    Ok(Places { folder: save.clone(), out, serial: own })
}

/// Names of the folder's pictures but the dropped ones, in order.
fn pictures(folder: &Path, drop: &[String]) -> Result<Vec<String>, Fault> {
    let failed = |error: std::io::Error| bad_input(format!("{}: {error}", folder.display()));
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let name = entry.map_err(failed)?.file_name().to_string_lossy().into_owned();
        let ending = name.rsplit('.').next().unwrap_or("").to_ascii_lowercase();
        if ["png", "jpg", "jpeg"].contains(&ending.as_str()) {
            names.push(name);
        }
    }
    names.sort();
    if let Some(wrong) = drop.iter().find(|name| !names.contains(name)) {
        return Err(bad_input(format!("--drop {wrong}: no such picture in {}", folder.display())));
    }
    names.retain(|name| !drop.contains(name));
    if names.is_empty() {
        return Err(bad_input(format!("{}: no PNG or JPEG pictures of the board in it", folder.display())));
    }
    Ok(names)
}

/// What pictures of one size show of the board.
struct BoardPictures {
    /// The board's corners in every picture.
    views: Vec<BoardView>,
    /// Width of each picture, pixels.
    width: u32,
    /// Height of each picture, pixels.
    height: u32,
}

/// Finds the board in the folder's pictures.
fn look(folder: &Path, names: &[String], board: &Board) -> Result<BoardPictures, Fault> {
    let settings = DetectSettings::default();
    let mut detector =
        Detector::of(&[board.family], settings).map_err(|error| bad_input(error.to_string()))?;
    let mut views = Vec::with_capacity(names.len());
    let mut size: Option<(u32, u32)> = None;
    for name in names {
        let path = folder.join(name);
        let image: Image = read_picture(&path).map_err(bad_input)?;
        let (width, height) = *size.get_or_insert((image.width, image.height));
        if (image.width, image.height) != (width, height) {
            return Err(bad_input(format!(
                "{}: {} x {}, but the pictures before it are {width} x {height}: all of one lens have one \
                 size",
                path.display(),
                image.width,
                image.height
            )));
        }
        let detections = detector.detect(&image.gray()).map_err(|error| bad_input(error.to_string()))?;
        views.push(BoardView { name: name.clone(), corners: board.seen(&detections) });
    }
    let (width, height) = size.unwrap_or_default();
    Ok(BoardPictures { views, width, height })
}

fn report(solved: &LensSolution) {
    let lens = &solved.camera;
    let [fx, fy, cx, cy] = solved.std_px;
    complain(&format!(
        "focal lengths {:.2} +- {fx:.2}, {:.2} +- {fy:.2} px; principal point {:.2} +- {cx:.2}, {:.2} +- \
         {cy:.2} px",
        lens.fx, lens.fy, lens.cx, lens.cy
    ));
    complain(&format!(
        "reprojection {:.3} px rms, {:.3} px in pictures that were held out",
        solved.reprojection_px, solved.held_out_px
    ));
    for sample in &solved.samples {
        let held_out = sample.held_out_px.map_or(String::new(), |px| format!(", held out {px:.3} px"));
        let mark = if sample.rejected { "  rejected" } else { "" };
        complain(&format!(
            "  {}: {} corners, {:.3} px{held_out}{mark}",
            sample.name, sample.corners, sample.residual_px
        ));
    }
}
