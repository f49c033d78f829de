//! What lies on the bench while a cell is calibrated: pictures of a board, a round, touches, a solution.
//!
//! In: pictures and steps. Out: the state of all of it for the page. Nothing is lost by a page that is
//! closed; all of it ends with celld, but for what was kept.

use crate::config::cell::CellConfig;
use crate::page::calibration::kept::{Kept, keep};
use crate::page::calibration::lens::LensWork;
use crate::page::calibration::round::{Requested, RoundWork, Solution, solve};
use crate::page::calibration::touch::TouchWork;
use crate::page::feed::KnownCell;
use axum::body::Bytes;
use cell_calibration::fit::Sample;
use cell_calibration::taken::Wanted;
use cell_machine::supervisor::round::RoundFault;
use cell_values::image::Image;
use serde_json::{Value, json};

/// See the module.
#[derive(Default)]
pub struct Bench {
    /// Pictures of a board.
    pub lens: Option<LensWork>,
    /// Touches.
    pub touches: Option<TouchWork>,
    round: Option<RoundWork>,
    solved: Option<Result<Solution, String>>,
    /// The number of what was solved last.
    solutions: u64,
    kept: Option<String>,
}

/// What is wanted of a round.
pub struct Request<'a> {
    /// Camera and table, or the table alone.
    pub wanted: Wanted,
    /// Samples that are left out, from 1.
    pub dropped: &'a [usize],
    /// The table is tied to the touches.
    pub registration: bool,
    /// Now, in words.
    pub date: &'a str,
}

impl Bench {
    /// Solutions are numbered on from `first`: unlike any of an earlier daemon.
    pub fn numbered_from(first: u64) -> Bench {
        Bench { solutions: first, ..Bench::default() }
    }

    /// A picture of a round; the first begins a new one.
    pub fn pictured(&mut self, pose: usize, image: Image, sample: Sample) {
        if pose == 1 || self.round.is_none() {
            (self.round, self.solved, self.kept) = (Some(RoundWork::default()), None, None);
        }
        if let Some(round) = &mut self.round {
            round.add(image, sample);
        }
    }

    /// The round has ended; one that took no picture has nothing in common with the one before it.
    pub fn round_over(&mut self, result: Result<(), RoundFault>) {
        if self.round.as_ref().is_some_and(RoundWork::is_over) {
            (self.round, self.solved, self.kept) = (None, None, None);
        }
        self.round.get_or_insert_default().ended(result);
    }

    /// Camera and table of the round.
    pub fn solve(&mut self, config: &CellConfig, known: &KnownCell, request: &Request) {
        self.kept = None;
        self.solutions += 1;
        self.solved = Some(self.solution(config, known, request));
    }

    fn solution(
        &self,
        config: &CellConfig,
        known: &KnownCell,
        request: &Request,
    ) -> Result<Solution, String> {
        let round = self.round.as_ref().ok_or("no round was taken yet")?;
        let touches = match &self.touches {
            Some(work) if request.registration => Some(work.touches()),
            None if request.registration => return Err("no point was touched yet".to_string()),
            _ => None,
        };
        let date = request.date.to_string();
        let measured =
            self.lens.as_ref().and_then(|lens| lens.calibration(&known.lens.model.serial, date.clone()));
        // The table alone is seen through the lens for which the camera's place was found.
        let measured = measured.filter(|_| request.wanted != Wanted::Table);
        let lens = measured.unwrap_or_else(|| known.lens.clone());
        let requested = Requested { wanted: request.wanted, dropped: request.dropped, touches, lens, date };
        solve(config, known, round, requested)
    }

    /// Keeps what was solved: the solution of this number, which a person has looked at.
    ///
    /// # Errors
    /// There is nothing, another one has taken its place, or it could not be written.
    pub fn keep(&mut self, number: u64, config: &CellConfig, to: &Kept) -> Result<(), String> {
        let solved = self.solved.as_ref().and_then(|solved| solved.as_ref().ok());
        let solved = solved.ok_or("there is no calibration that could be kept")?;
        if number != self.solutions {
            return Err(
                "nothing was kept: another calibration was computed meanwhile; look at it first".into()
            );
        }
        self.kept = Some(keep(&solved.set, &config.calibration, to)?);
        Ok(())
    }

    /// A picture: `lens-3` or `round-3`.
    pub fn jpeg(&self, name: &str) -> Option<Bytes> {
        let (kind, number) = name.split_once('-')?;
        let number = number.parse().ok()?;
        match kind {
            "lens" => self.lens.as_ref()?.jpeg(number),
            "round" => self.round.as_ref()?.jpeg(number),
            _ => None,
        }
    }

    /// For the page.
    pub fn view(&self, config: &CellConfig) -> Value {
        let (mut solved, fault) = match &self.solved {
            Some(Ok(solved)) => (Some(solved.view.clone()), None),
            Some(Err(fault)) => (None, Some(fault)),
            None => (None, None),
        };
        if let Some(solved) = &mut solved {
            solved["number"] = json!(self.solutions);
        }
        json!({
            "lens": self.lens.as_ref().map(LensWork::view), "round": self.round.as_ref().map(RoundWork::view),
            "touches": self.touches.as_ref().map(|touches| touches.view(config)), "solved": solved,
            "fault": fault, "kept": self.kept,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Isometry3;

    #[test]
    fn a_round_that_took_no_picture_leaves_nothing_of_the_one_before() {
        let mut bench = Bench::default();
        let sample = Sample { base_from_flange: Isometry3::identity(), detections: Vec::new() };
        bench.pictured(1, Image::filled(4, 4, [0; 3]), sample);
        bench.round_over(Ok(()));
        assert!(bench.jpeg("round-1").is_some());
        bench.round_over(Err(RoundFault::Robot("the arm was moved".into())));
        assert!(bench.jpeg("round-1").is_none());
    }
}
