//! Pictures of the board while they are taken: which are of use, and what of the picture no board was in
//! yet.
//!
//! In: the board, one picture after the other. Out: the name under which a picture is kept, or that too
//! little can be measured in it, so that this is not found out after the last one. Pure.

use crate::fit::lens::{BoardView, LensSettings, uncovered};
use cell_values::image::Image;
use cell_vision::board::Board;
use cell_vision::detect::{DetectError, DetectSettings, Detector};

/// What a picture shows.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum BoardSight {
    /// Too few corners to count.
    TooLittle {
        /// Markers of the board in it.
        markers: usize,
    },
    /// Enough.
    Board {
        /// The name of its file.
        name: String,
        /// Markers of the board in it.
        markers: usize,
        /// Parts of the picture where no marker was yet, in this one or those before.
        uncovered: Vec<&'static str>,
    },
}

/// The pictures of use so far.
pub struct BoardPictures {
    board: Board,
    detector: Detector,
    views: Vec<BoardView>,
}

impl BoardPictures {
    /// None yet.
    ///
    /// # Errors
    /// The detector cannot be made.
    pub fn new(board: &Board) -> Result<BoardPictures, DetectError> {
        let detector = Detector::of(&[board.family], DetectSettings::default())?;
        Ok(BoardPictures { board: *board, detector, views: Vec::new() })
    }

    /// How many.
    pub fn count(&self) -> usize {
        self.views.len()
    }

    /// The board's corners in each picture that counts.
    pub fn views(&self) -> &[BoardView] {
        &self.views
    }

    /// Looks at the next picture; it counts where it shows enough.
    ///
    /// # Errors
    /// The detector failed.
    pub fn look(&mut self, image: &Image) -> Result<BoardSight, DetectError> {
        let detections = self.detector.detect(&image.gray())?;
        let corners = self.board.seen(&detections);
        let markers = corners.0.len() / 4;
        if corners.0.len() < LensSettings::default().corners_min {
            return Ok(BoardSight::TooLittle { markers });
        }
        let name = format!("{:02}.png", self.views.len() + 1);
        self.views.push(BoardView { name: name.clone(), corners });
        let uncovered = uncovered(self.views.iter(), image.width, image.height);
        Ok(BoardSight::Board { name, markers, uncovered })
    }
}
