//! A recorded run on one page that needs nothing else: the table, the arm, pictures and sentences at any
//! time of it.
//!
//! In: a [`RecordedRun`]. Out: HTML with the run as JSON inside and a script of our own that draws it
//! (`replay_page.js`); no address is called. Whatever came from a file or a device goes into the JSON, where
//! no text can end the script. Pure.

use crate::report::text::escape;
use base64::Engine as _;
use rearrange::geometry::pose::Pose2;
use serde::Serialize;

const STYLE: &str = include_str!("replay_page.css");
const SCRIPT: &str = include_str!("replay_page.js");

/// Corners of an outline, m.
pub type Outline = Vec<[f64; 2]>;

/// All times are s since `began_unix_s`; what was so at a time is the last entry before it.
#[derive(Debug, Default, Serialize)]
pub struct RecordedRun {
    /// Above the page.
    pub title: String,
    /// s since 1970.
    pub began_unix_s: f64,
    /// Width and height of the table's work area, m.
    pub table: [f64; 2],
    /// Places that stay free, table frame.
    pub kept_free: Vec<Outline>,
    /// The catalogue, with where each object was.
    pub objects: Vec<RecordedObject>,
    /// Things without a marker, table frame.
    pub foreign: Vec<(f64, Vec<Outline>)>,
    /// Joints of the arm and the tool's tip, table frame, mm.
    pub arm: Vec<(f64, Vec<[i32; 3]>)>,
    /// Plans as they were made.
    pub plans: Vec<(f64, Vec<RecordedMove>)>,
    /// What the cell did.
    pub states: Vec<(f64, RecordedState)>,
    /// What it said.
    pub sentences: Vec<RecordedSentence>,
    /// JPEG or PNG as a data address.
    pub pictures: Vec<(f64, String)>,
}

/// An object, and where it was.
#[derive(Debug, Serialize)]
pub struct RecordedObject {
    /// Its name.
    pub id: String,
    /// CSS colour, as everywhere.
    pub colour: String,
    /// Object frame.
    pub outline: Outline,
    /// Table frame: x, y, theta.
    pub at: Vec<(f64, [f64; 3])>,
}

/// A pick-n-place of a plan.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RecordedMove {
    /// Of what.
    pub object: String,
    /// Table frame: x, y, theta.
    pub from: [f64; 3],
    /// The same.
    pub to: [f64; 3],
    /// It ends at the goal, not at a buffer.
    pub goal: bool,
}

/// What the cell did from some time on.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RecordedState {
    /// In a few words.
    pub text: String,
    /// The arm may move.
    pub armed: bool,
    /// It moves, or may, whatever `armed` says: what was under way is finished.
    pub moving: bool,
    /// The job under way.
    pub job: Option<String>,
    /// Pick-n-places made.
    pub moves: usize,
    /// What hangs on the gripper, may hang or fell, in words.
    pub held: Option<String>,
    /// The object that hangs there, as far as is known.
    pub carried: Option<String>,
    /// Why it was stopped.
    pub stopped: Option<String>,
    /// What a person should do.
    pub hint: String,
}

/// Something that was said.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RecordedSentence {
    /// When.
    pub at: f64,
    /// A person should read it.
    pub alarm: bool,
    /// The sentence.
    pub text: String,
}

/// A pose as the page has it; a tenth of a millimetre is enough for a drawing.
pub fn drawn(pose: &Pose2) -> [f64; 3] {
    [pose.x, pose.y, pose.theta].map(|value| (value * 1e4).round() / 1e4)
}

/// A picture as an address that holds it.
pub fn data_address(bytes: &[u8]) -> String {
    let kind = if bytes.starts_with(b"\x89PNG") { "png" } else { "jpeg" };
    format!("data:image/{kind};base64,{}", base64::engine::general_purpose::STANDARD.encode(bytes))
}

/// The page.
///
/// # Errors
/// A number that JSON cannot hold.
pub fn replay_page(run: &RecordedRun) -> Result<String, serde_json::Error> {
    // Within a script element only `<` can begin something else.
    let json = serde_json::to_string(run)?.replace('<', "\\u003c");
    let title = escape(&run.title);
    Ok(format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\
         <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; img-src data:; \
         style-src 'unsafe-inline'; script-src 'unsafe-inline'\">\
         <title>{title} - celld</title><style>{STYLE}</style></head>\n<body><main>\n<h1>{title}</h1>\n\
         <p class=\"soft\">A recording: nothing here is of now. It begins at <time id=\"began\"></time>; all \
         times are UTC.</p>\n<div id=\"run\"></div></main>\n<script type=\"application/json\" id=\"data\">{json}</script>\n\
         <script>{SCRIPT}</script></body></html>\n"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_text_of_a_recording_ends_the_script() {
        let text = "</script><script>alert(1)</script>".to_string();
        let sentence = RecordedSentence { at: 0.0, alarm: true, text: text.clone() };
        let run = RecordedRun { title: text, sentences: vec![sentence], ..RecordedRun::default() };
        let page = replay_page(&run).expect("a page");
        assert_eq!(page.matches("</script>").count(), 2, "the data and the script end once each");
        assert!(!page.contains("<script>alert"), "{page}");
        let json = page.split("id=\"data\">").nth(1).and_then(|rest| rest.split("</script>").next());
        let value: serde_json::Value = serde_json::from_str(json.expect("the data")).expect("JSON");
        assert_eq!(value["sentences"][0]["text"], "</script><script>alert(1)</script>");
    }

    #[test]
    fn pictures_are_inside() {
        assert_eq!(data_address(b"\x89PNG"), "data:image/png;base64,iVBORw==");
        assert!(data_address(&[0xff, 0xd8]).starts_with("data:image/jpeg;base64,"));
    }
}
