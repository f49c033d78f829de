//! The lens, from pictures of a board that a person holds before the camera.
//!
//! In: the board, pictures of the film. Out: which pictures are of use and what of the picture none shows
//! yet; the lens with the error of every picture. Pictures can be taken without a hand on the keyboard: one
//! is taken whenever the board rests and lies where no picture had it. Pure but for the caller's time.

use axum::body::Bytes;
use cell_calibration::board_pictures::{BoardPictures, BoardSight};
use cell_calibration::files::camera::CameraCalibration;
use cell_calibration::fit::lens::{BoardView, LensSample, LensSettings, LensSolution, solve_lens};
use cell_values::image::Image;
use cell_vision::annotate::{GOOD, raster};
use cell_vision::board::Board;
use cell_vision::detect::Detection;
use rearrange::document::chain::chain;
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// Most pictures that are kept.
const PICTURES_MAX: usize = 60;

/// Of JPEG, for people; what is measured was measured before.
const QUALITY: u8 = 80;

/// Radius of a dot at a corner, pixels.
const DOT: i64 = 3;

/// The board rests when its markers move by less from one look to the next, pixels.
const RESTS_PX: f64 = 1.0;

/// It lies elsewhere when they are farther from where every picture had them, pixels, in the mean.
const ELSEWHERE_PX: f64 = 60.0;

/// Middles of the board's markers by number, pixels.
type Middles = BTreeMap<u32, [f64; 2]>;

/// See the module.
pub struct LensWork {
    board: Board,
    pictures: BoardPictures,
    jpegs: Vec<Bytes>,
    had: Vec<Middles>,
    before: Middles,
    /// A picture is taken whenever the board rests somewhere new.
    auto: bool,
    uncovered: Vec<&'static str>,
    said: String,
    size: (u32, u32),
    solved: Option<Result<LensSolution, String>>,
}

impl LensWork {
    /// No picture yet.
    ///
    /// # Errors
    /// The detector cannot be made.
    pub fn new(board: Board) -> Result<LensWork, String> {
        let pictures = BoardPictures::new(&board).map_err(|error| error.to_string())?;
        Ok(LensWork {
            board,
            pictures,
            jpegs: Vec::new(),
            had: Vec::new(),
            before: Middles::new(),
            auto: false,
            uncovered: Vec::new(),
            said: String::new(),
            size: (0, 0),
            solved: None,
        })
    }

    /// The board.
    pub fn board(&self) -> &Board {
        &self.board
    }

    /// Takes pictures by itself, or no longer.
    pub fn set_auto(&mut self, on: bool) {
        self.auto = on;
    }

    /// What the film shows now; a picture is taken of a board that rests where none had it.
    pub fn saw(&mut self, image: &Image, detections: &[Detection]) {
        let now = self.middles(detections);
        let before = std::mem::replace(&mut self.before, now.clone());
        let wanted = LensSettings::default().corners_min / 4;
        let rests = now.len() >= wanted && apart(&now, &before).is_some_and(|px| px < RESTS_PX);
        let elsewhere = self.had.iter().all(|had| apart(&now, had).is_none_or(|px| px > ELSEWHERE_PX));
        if self.auto && rests && elsewhere && self.jpegs.len() < PICTURES_MAX {
            self.said = self.take(image).unwrap_or_else(|fault| fault);
        }
    }

    fn middles(&self, detections: &[Detection]) -> Middles {
        let family = self.board.family.name();
        let ids = self.board.first_id..self.board.first_id + self.board.count();
        let ours = detections.iter().filter(|found| found.family == family && ids.contains(&found.id));
        ours.map(|found| (found.id, middle(&found.corners))).collect()
    }

    /// Takes a picture that a person wants; what it shows, or why it is not kept, is said.
    pub fn picture(&mut self, of_now: Option<&Image>) {
        let none = || Err("the camera gives no picture at the moment: not kept; try again".to_string());
        self.said = of_now.map_or_else(none, |image| self.take(image)).unwrap_or_else(|fault| fault);
    }

    /// Takes a picture; what it shows, in words.
    ///
    /// # Errors
    /// It shows too little, there are enough, or the detector failed.
    fn take(&mut self, image: &Image) -> Result<String, String> {
        if self.jpegs.len() >= PICTURES_MAX {
            return Err(format!("{PICTURES_MAX} pictures are enough"));
        }
        let size = (image.width, image.height);
        if !self.jpegs.is_empty() && size != self.size {
            return Err("the camera's picture has another size now: begin anew".to_string());
        }
        let all = self.board.count();
        match self.pictures.look(image).map_err(|error| error.to_string())? {
            BoardSight::TooLittle { markers } => Err(format!(
                "{markers} of the board's {all} markers: not kept; nearer, sharper, and is it the board that \
                 was named?"
            )),
            BoardSight::Board { markers, uncovered, .. } => {
                let corners = self.pictures.views().last().map(|view| &view.corners);
                let corners = corners.map(|(_, in_picture)| in_picture.as_slice()).unwrap_or_default();
                self.jpegs.push(drawn(image, corners)?);
                self.had.push(self.before.clone());
                (self.size, self.uncovered, self.solved) = (size, uncovered, None);
                Ok(format!("picture {}: {markers} of {all} markers", self.jpegs.len()))
            }
        }
    }

    /// Fits the lens to all pictures but the `dropped` ones, by name.
    pub fn solve(&mut self, dropped: &[String]) {
        let views: Vec<BoardView> =
            self.pictures.views().iter().filter(|view| !dropped.contains(&view.name)).cloned().collect();
        let (width, height) = self.size;
        let solved = solve_lens(&views, width, height, &LensSettings::default());
        self.solved = Some(solved.map_err(|error| chain(&error)));
    }

    /// The lens as its file has it, once it is known.
    pub fn calibration(&self, serial: &str, date: String) -> Option<CameraCalibration> {
        let solved = self.solved.as_ref()?.as_ref().ok()?;
        let used = solved.samples.iter().filter(|sample| !sample.rejected).count();
        let Board { family, columns, rows, size_m, .. } = self.board;
        let source = format!("{family} board {columns}x{rows}, squares {} mm, {used} pictures", size_m * 1e3);
        Some(CameraCalibration::from_solution(solved.clone(), serial, source, date))
    }

    /// A picture, by its number from 1.
    pub fn jpeg(&self, number: usize) -> Option<Bytes> {
        self.jpegs.get(number.checked_sub(1)?).cloned()
    }

    /// For the page.
    pub fn view(&self) -> Value {
        let pictures = self.pictures.views().iter();
        let pictures: Vec<Value> =
            pictures.map(|view| json!({ "name": view.name, "markers": view.corners.0.len() / 4 })).collect();
        let (solved, fault) = match &self.solved {
            Some(Ok(solved)) => (Some(solution(solved)), None),
            Some(Err(fault)) => (None, Some(fault)),
            None => (None, None),
        };
        let Board { columns, rows, size_m, gap_m, first_id, .. } = self.board;
        json!({
            "board": { "columns": columns, "rows": rows, "size_mm": size_m * 1e3, "gap_mm": gap_m * 1e3,
                       "first_id": first_id },
            "auto": self.auto, "pictures": pictures, "uncovered": self.uncovered, "said": self.said,
            "solved": solved, "fault": fault, "least": LensSettings::default().views_min,
        })
    }
}

fn solution(solved: &LensSolution) -> Value {
    let lens = &solved.camera;
    let sample = |sample: &LensSample| {
        json!({
            "name": sample.name, "corners": sample.corners, "px": sample.residual_px,
            "held_out_px": sample.held_out_px, "rejected": sample.rejected,
        })
    };
    json!({
        "fx": lens.fx, "fy": lens.fy, "cx": lens.cx, "cy": lens.cy, "std_px": solved.std_px,
        "px": solved.reprojection_px, "held_out_px": solved.held_out_px,
        "samples": solved.samples.iter().map(sample).collect::<Vec<Value>>(),
    })
}

/// The picture with a dot at every corner that was measured.
fn drawn(image: &Image, corners: &[[f64; 2]]) -> Result<Bytes, String> {
    let mut image = image.clone();
    for corner in corners {
        raster::dot(&mut image, *corner, DOT, GOOD);
    }
    image.encode_jpeg(QUALITY).map(Bytes::from).map_err(|error| error.to_string())
}

fn middle(corners: &[[f64; 2]; 4]) -> [f64; 2] {
    [0, 1].map(|axis| corners.iter().map(|corner| corner[axis]).sum::<f64>() / 4.0)
}

/// How far the markers that both show are apart, pixels, in the mean; `None` where they share hardly any.
fn apart(a: &Middles, b: &Middles) -> Option<f64> {
    let both: Vec<f64> =
        a.iter().filter_map(|(id, [x, y])| b.get(id).map(|[u, v]| (x - u).hypot(y - v))).collect();
    (2 * both.len() >= a.len() && !both.is_empty()).then(|| both.iter().sum::<f64>() / both.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use cell_vision::detect::{DetectSettings, Detector, Family};
    use cell_vision::marker;

    /// Pixels of a module.
    const MODULE: u32 = 7;

    /// A board seen straight on, its upper left corner there.
    fn picture(board: &Board, left: u32, top: u32) -> Image {
        let mut image = Image::filled(1280, 720, [255; 3]);
        for (id, at) in (board.first_id..).zip(0..board.count()) {
            let tile = marker::draw(id, MODULE).unwrap();
            let (column, row) = (at % board.columns, board.rows - 1 - at / board.columns);
            for (pixel, shade) in (0..).zip(&tile.data) {
                let (x, y) = (pixel % tile.width, pixel / tile.width);
                image.set_pixel(left + column * tile.width + x, top + row * tile.height + y, [*shade; 3]);
            }
        }
        image
    }

    #[test]
    fn a_board_at_rest_somewhere_new_is_taken_once() {
        let board = Board::new(Family::Tag36h11, 7, 5, 0.027, 0);
        let mut detector = Detector::of(&[board.family], DetectSettings::default()).unwrap();
        let mut work = LensWork::new(board).unwrap();
        work.set_auto(true);
        let mut pictures = Vec::new();
        for (left, top) in [(40, 60), (600, 240)] {
            let image = picture(&board, left, top);
            let found = detector.detect(&image.gray()).unwrap();
            pictures.push((image, found));
        }
        let count = |work: &LensWork| work.view()["pictures"].as_array().map_or(0, Vec::len);
        let look = |work: &mut LensWork, which: usize| {
            let (image, found) = &pictures[which];
            work.saw(image, found);
        };
        look(&mut work, 0);
        assert_eq!(count(&work), 0, "it may still move");
        look(&mut work, 0);
        assert_eq!(count(&work), 1, "{}", work.view());
        look(&mut work, 0);
        look(&mut work, 1);
        assert_eq!(count(&work), 1, "once, and not on the way");
        look(&mut work, 1);
        assert_eq!(count(&work), 2);
        assert!(work.jpeg(2).is_some() && work.jpeg(3).is_none() && work.jpeg(0).is_none());
        assert!(work.take(&Image::filled(1280, 720, [200; 3])).unwrap_err().contains("not kept"));
        work.solve(&[]);
        let fault = work.view()["fault"].as_str().unwrap_or_default().to_string();
        assert!(fault.contains("are needed"), "two pictures are too few: {fault}");
    }
}
