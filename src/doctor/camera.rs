//! The camera: whether it gives pictures, how soon, with depth where depth is needed, and whether the
//! reference markers in them are where the calibration says.
//!
//! In: [`CameraFacts`]. Out: lines. Pure.

use crate::doctor::{Area, Line};
use cell_vision::observe::reference::{DriftLimits, ReferenceCheck};

/// What the camera showed.
#[derive(Clone, Debug)]
pub struct CameraFacts {
    /// A picture, or why there is none with what to do.
    pub picture: Result<PictureFacts, CameraProblem>,
    /// Depth is configured.
    pub depth_wanted: bool,
    /// The reference markers as seen from where the arm is, or why that is not known.
    pub references: Result<References, String>,
}

/// Why there is no picture.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraProblem {
    /// What is wrong.
    pub message: String,
    /// What to do.
    pub hint: String,
}

/// A picture.
#[derive(Clone, Debug, PartialEq)]
pub struct PictureFacts {
    /// Where it came from.
    pub source: String,
    /// Serial number of the camera, where it gives one.
    pub serial: Option<String>,
    /// Pixels.
    pub size: [u32; 2],
    /// From opening the camera to the first usable picture, s.
    pub seconds: f64,
    /// It came with depth.
    pub depth: bool,
    /// It shows the table as it is now.
    pub live: bool,
}

/// The reference markers in one picture.
#[derive(Clone, Debug)]
pub struct References {
    /// Surveyed.
    pub surveyed: usize,
    /// Seen where joints and calibration say they are, against their survey; `None` if none was seen.
    pub check: Option<ReferenceCheck>,
    /// What counts as moved.
    pub limits: DriftLimits,
}

/// Fewer reference markers than this say nothing of drift.
const ENOUGH: usize = 3;

fn note(item: &'static str, found: impl Into<String>, hint: impl Into<String>) -> Line {
    Line::note(Area::Camera, item, found, hint)
}

impl CameraFacts {
    /// The lines.
    pub fn lines(&self) -> Vec<Line> {
        let picture = match &self.picture {
            Ok(picture) => picture,
            Err(problem) => {
                return vec![Line::problem(Area::Camera, "picture", &problem.message, &problem.hint)];
            }
        };
        let [width, height] = picture.size;
        let serial = picture.serial.as_ref().map_or(String::new(), |serial| format!(" of camera {serial}"));
        let found = format!("{width} x {height}{serial}, the first after {:.1} s", picture.seconds);
        let mut lines = vec![Line::ok(Area::Camera, "picture", found)];
        if !picture.live {
            let hint = "name a live camera under `devices.camera`: old pictures show an old table";
            let found = format!("{} is a recording", picture.source);
            lines.push(Line::problem(Area::Camera, "picture", found, hint));
        }
        lines.push(match (self.depth_wanted, picture.depth) {
            (true, true) => Line::ok(Area::Camera, "depth", "comes with the picture"),
            (true, false) => Line::problem(
                Area::Camera,
                "depth",
                "configured, and the picture came without",
                "see `depth` in docs/cameras.md; a D405 needs USB 3",
            ),
            (false, _) => note(
                "depth",
                "not configured: things without a marker are found by colour, or not at all",
                "`depth: true` under `devices.camera`, or `empty` under `calibration` (docs/cameras.md)",
            ),
        });
        lines.push(self.drift());
        lines
    }

    fn drift(&self) -> Line {
        let item = "drift";
        let References { surveyed, check, limits } = match &self.references {
            Ok(references) => references,
            Err(why) => return note(item, format!("not known: {why}"), ""),
        };
        let seen = check.as_ref().map_or(0, |check| check.markers.len());
        let Some(check) = check.as_ref().filter(|_| seen >= ENOUGH) else {
            let hint = "a look pose shows more markers: `celld park`, or jog the arm there at the pendant \
                        in Local Control, then switch it back to Remote Control; run `celld doctor` again";
            let found = format!("{seen} of {surveyed} reference markers in view, {ENOUGH} are needed");
            return note(item, found, hint);
        };
        let found = format!(
            "{seen} of {surveyed} reference markers in view, {:.2} mm rms from their survey (limit {:.2} mm)",
            1e3 * check.residual_rms_m,
            1e3 * limits.residual_m
        );
        if check.drifted(limits) {
            let hint = "camera, table or a marker was moved since the calibration: `celld calibrate` \
                        (docs/calibration.md)";
            return Line::problem(Area::Camera, item, found, hint);
        }
        Line::ok(Area::Camera, item, found)
    }
}
