//! What the configuration says about calibration: where the camera sits, the files, the box in which poses
//! are proposed.
//!
//! In: located values and a decoder that collects complaints. Out: [`CameraMount`], [`CalibrationFiles`],
//! [`CalibrationBox`], or `None` with a complaint kept. Only what the printed board's maker (`celld
//! markers`) decides by itself has a default.

use crate::config::cell::CalibrationFiles;
use crate::config::parts::CellParts;
use cell_calibration::drawn::CameraMount;
use cell_motion::slow::CalibrationBox;
use cell_parts::fields::{joints_deg, list, path, transform};
use cell_parts::grid::{MarkerGrid, board, board_apart};
use cell_parts::places::Places;
use cell_vision::board::Board;
use cell_vision::detect::Family;
use rearrange::document::decode::{At, Decoder};
use std::path::Path;
use ur_arm::kinematics::{DhParameters, forward};

/// Name of the file of recorded blends, beside that of the table.
const BLENDS: &str = "blends.yaml";

/// Least edge of a box in which poses are proposed, m: less leaves no room to turn in.
const LEAST_EDGE_M: f64 = 0.05;

pub(super) fn camera(decoder: &mut Decoder, at: &At) -> Option<CameraMount> {
    let mount_at = decoder.open_map(at)?.required("mount", decoder)?;
    match decoder.choice(&mount_at, &[("flange", "flange"), ("fixed", "fixed")])? {
        "flange" => {
            let fields = decoder.map(at, &["mount", "flange_from_camera"])?;
            let flange_from_camera = transform(decoder, &fields, "flange_from_camera")?;
            Some(CameraMount::Flange { flange_from_camera })
        }
        _ => {
            let fields = decoder.map(at, &["mount", "base_from_camera", "board", "flange_from_board"])?;
            let base_from_camera = transform(decoder, &fields, "base_from_camera");
            let board = fields.required("board", decoder).and_then(|at| board(decoder, &at)).map(printed);
            let clamped = fields.optional("flange_from_board").is_some();
            let flange_from_board =
                if clamped { Some(transform(decoder, &fields, "flange_from_board")?) } else { None };
            Some(CameraMount::Fixed { base_from_camera: base_from_camera?, board: board?, flange_from_board })
        }
    }
}

/// The board that is printed for a grid of the configuration.
fn printed(grid: MarkerGrid) -> Board {
    let MarkerGrid { columns, rows, size_m, gap_m, first_id } = grid;
    Board { family: Family::Tag36h11, columns, rows, size_m, gap_m, first_id }
}

/// Complains about markers of the hand's board that also lie on the table.
pub(super) fn check_board(decoder: &mut Decoder, parts: &CellParts, places: &Places) {
    let Some(CameraMount::Fixed { board, .. }) = &parts.camera else { return };
    let reference = parts.reference_markers.iter().flatten().map(|marker| i64::from(marker.id));
    let objects = parts.object_markers.iter().map(|marker| marker.number);
    let numbers = i64::from(board.first_id)..i64::from(board.first_id + board.count());
    board_apart(
        decoder,
        numbers,
        reference.chain(objects),
        (places.at(&["camera", "board"]), "camera.board"),
    );
}

pub(super) fn files(decoder: &mut Decoder, at: &At, folder: &Path) -> Option<CalibrationFiles> {
    let fields = decoder.map(at, &["camera", "hand_eye", "table", "empty", "blends"])?;
    let mut file = |key: &str| fields.required(key, decoder).and_then(|at| path(decoder, &at, folder));
    let (camera, hand_eye, table) = (file("camera"), file("hand_eye"), file("table"));
    let empty = match fields.optional("empty") {
        Some(at) => Some(path(decoder, &at, folder)?),
        None => None,
    };
    let blends = match fields.optional("blends") {
        Some(at) => path(decoder, &at, folder)?,
        None => table.as_ref()?.with_file_name(BLENDS),
    };
    let files = CalibrationFiles { camera: camera?, hand_eye: hand_eye?, table: table?, empty, blends };
    let names = [
        ("camera", &files.camera),
        ("hand_eye", &files.hand_eye),
        ("table", &files.table),
        ("blends", &files.blends),
    ];
    for (index, (key, file)) in names.iter().enumerate() {
        let earlier = names.iter().take(index).find(|(_, other)| other == file);
        if let (Some((other, _)), Some(at)) = (earlier, fields.optional(key)) {
            let message =
                format!("the same file as {other:?}: a new calibration of one would overwrite the other");
            decoder.complain_at(&at, message, "give each its own file");
        }
    }
    Some(files)
}

/// `{low: [x, y, z], high: [x, y, z]}` in the base frame (m), or `{corners_deg: [[6 joints], ...]}` as
/// taught.
pub(super) fn calibration_box(decoder: &mut Decoder, at: &At) -> Option<CalibrationBox> {
    let found = if at.node.get("corners_deg").is_some() {
        let fields = decoder.map(at, &["corners_deg"])?;
        let corners = fields.required("corners_deg", decoder)?;
        let taught = list(decoder, &corners, joints_deg)?;
        // The drawing's arm: a real one differs by a millimetre or two, which a box does not mind.
        let places = taught.iter().map(|q| forward(&DhParameters::UR5E, q).translation.vector);
        CalibrationBox::around(places.map(|place| [place.x, place.y, place.z]))
    } else {
        let fields = decoder.map(at, &["low", "high"])?;
        let low =
            fields.required("low", decoder).and_then(|at| decoder.numbers_in::<3>(&at, -100.0..=100.0, "m"));
        let high =
            fields.required("high", decoder).and_then(|at| decoder.numbers_in::<3>(&at, -100.0..=100.0, "m"));
        Some(CalibrationBox { low_m: low?, high_m: high? })
    };
    let large = |found: &CalibrationBox| {
        let edges = found.low_m.iter().zip(&found.high_m).map(|(low, high)| high - low);
        edges.into_iter().all(|edge| (LEAST_EDGE_M..=4.0).contains(&edge))
    };
    if found.as_ref().is_some_and(large) {
        return found;
    }
    let help = "low is its corner with the smallest x, y and z (m, base frame); or teach at least two \
                opposite corners, also of different height";
    decoder.complain_at(at, format!("no box with edges of {LEAST_EDGE_M} to 4 m"), help);
    None
}
