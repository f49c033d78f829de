//! The program that runs on the robot: its text with the two numbers filled in.
//!
//! In: the template (hardware/ur5e/celld_program.script), a [`Nonce`], the watchdog's number of frames. Out:
//! the text to upload and the program's name. Only checked integers are put into the text, never a string.

use crate::device::software::{changes_payload_gradually, version_of};
use serde::{Deserialize, Serialize};
use ur_wire::bytes::cut_text;

/// The template that celld comes with.
pub const PROGRAM_TEXT: &str = include_str!("../../../../hardware/ur5e/celld_program.script");

/// How the template sets a payload: at once, on every controller.
const PAYLOAD_AT_ONCE: &str = "set_payload(v0, [v1, v2, v3])";

/// The same over 0.1 s, where the software can: the arm does not jerk under a heavy object. Nobody has
/// measured how long is best; it is less than gripping or releasing takes.
const PAYLOAD_GRADUALLY: &str = "set_target_payload(v0, [v1, v2, v3], [0, 0, 0, 0, 0, 0], 0.1)";

/// Frames (2 ms) without a heartbeat after which the program stops the arm: 200 ms.
pub const WATCHDOG_FRAMES: u32 = 100;

/// The number that proves that the running program is the one just uploaded: never used twice in a row, and
/// not 0, which is what registers hold after the controller's start.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub struct Nonce(i32);

impl Nonce {
    /// Any number becomes a nonce in 1 to 2^31 - 1.
    pub fn new(seed: u64) -> Nonce {
        Nonce((seed % (i32::MAX as u64)) as i32 + 1)
    }

    /// The number in the register.
    pub fn number(self) -> i32 {
        self.0
    }
}

/// Why a text is not a template.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TemplateError {
    /// A place to fill in is missing.
    #[error("program template lacks {{{{{0}}}}}")]
    Missing(&'static str),
    /// Something in braces that celld does not know.
    #[error("program template has an unknown place to fill in: {0}")]
    Unknown(String),
    /// Controllers run a text as a program if it is one `def` to `end`.
    #[error("program template has to start with \"def celld_{{{{NONCE}}}}():\" and to end with \"end\"")]
    Frame,
    /// Fewer frames than celld can be sure to keep.
    #[error("watchdog of {0} frames is outside 50 to 500")]
    Watchdog(u32),
}

/// A checked template.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub struct ProgramTemplate {
    text: String,
}

impl ProgramTemplate {
    /// Checks a text and fills in the watchdog's frames.
    ///
    /// # Errors
    /// See [`TemplateError`].
    pub fn new(text: &str, watchdog_frames: u32) -> Result<ProgramTemplate, TemplateError> {
        if !text.starts_with("def celld_{{NONCE}}():\n") || !text.ends_with("\nend\n") {
            return Err(TemplateError::Frame);
        }
        if !(50..=500).contains(&watchdog_frames) {
            return Err(TemplateError::Watchdog(watchdog_frames));
        }
        if !text.contains("{{WATCHDOG_FRAMES}}") {
            return Err(TemplateError::Missing("WATCHDOG_FRAMES"));
        }
        let text = text.replace("{{WATCHDOG_FRAMES}}", &watchdog_frames.to_string());
        let rest = text.replace("{{NONCE}}", "0");
        match rest.find("{{") {
            Some(at) => Err(TemplateError::Unknown(cut_text(&rest[at..], 30).to_string())),
            None => Ok(ProgramTemplate { text }),
        }
    }

    /// The text to upload, for every controller.
    pub fn render(&self, nonce: Nonce) -> String {
        self.text.replace("{{NONCE}}", &nonce.number().to_string())
    }

    /// The same for a controller with this software (as its dashboard reports it), if that is known: what
    /// newer software does better is used.
    pub fn render_for(&self, nonce: Nonce, software: Option<&str>) -> String {
        let text = self.render(nonce);
        match software.and_then(version_of).is_some_and(changes_payload_gradually) {
            true => text.replace(PAYLOAD_AT_ONCE, PAYLOAD_GRADUALLY),
            false => text,
        }
    }
}

/// Name of the program in the controller's key messages; at most 31 characters, and fresh for each upload,
/// as messages name nothing else.
pub fn program_name(nonce: Nonce) -> String {
    format!("celld_{}", nonce.number())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_program_in_hardware_is_a_template() {
        let template = ProgramTemplate::new(PROGRAM_TEXT, WATCHDOG_FRAMES).unwrap();
        let nonce = Nonce::new(u64::MAX);
        let text = template.render(nonce);
        assert!(text.starts_with(&format!("def {}():\n", program_name(nonce))));
        assert!(text.contains("watchdog_frames = 100\n") && !text.contains("{{"));
        assert!(program_name(nonce).len() <= 31);
        let column_0 = text.lines().filter(|line| !line.starts_with("  ") && !line.is_empty()).count();
        assert_eq!(column_0, 2, "only the first and the last line may start in column 0");
        assert!(text.lines().all(|line| line.is_ascii()));
    }

    #[test]
    fn a_payload_changes_gradually_where_the_software_can() {
        let template = ProgramTemplate::new(PROGRAM_TEXT, WATCHDOG_FRAMES).unwrap();
        let text = |software| template.render_for(Nonce::new(1), software);
        for old in [None, Some("URSoftware 5.9.4.1031110"), Some("URSoftware"), Some("")] {
            assert!(
                text(old).contains(PAYLOAD_AT_ONCE) && !text(old).contains("set_target_payload"),
                "{old:?}"
            );
        }
        for new in ["URSoftware 5.10.0.1 (Jan 01 2021)", "URSoftware 5.26.0.1234567", "10.12.0"] {
            assert!(text(Some(new)).contains(PAYLOAD_GRADUALLY), "{new}");
            assert!(!text(Some(new)).contains(PAYLOAD_AT_ONCE), "{new}");
        }
    }

    #[test]
    fn a_nonce_is_positive_and_never_zero() {
        for seed in [0, 1, i32::MAX as u64 - 1, i32::MAX as u64, u64::MAX] {
            assert!(Nonce::new(seed).number() > 0);
        }
        assert_ne!(Nonce::new(1), Nonce::new(2));
    }

    #[test]
    fn what_is_no_template_is_refused() {
        let check = |text: &str| ProgramTemplate::new(text, 100).unwrap_err();
        assert_eq!(check("movej(q)\n"), TemplateError::Frame);
        assert_eq!(check("def celld_{{NONCE}}():\nend\n"), TemplateError::Missing("WATCHDOG_FRAMES"));
        let unknown = check("def celld_{{NONCE}}():\n {{WATCHDOG_FRAMES}} {{HOST}}\nend\n");
        assert_eq!(unknown, TemplateError::Unknown("{{HOST}}\nend\n".into()));
        assert_eq!(ProgramTemplate::new(PROGRAM_TEXT, 10).unwrap_err(), TemplateError::Watchdog(10));
    }
}
