//! The page's own files, compiled in: the cell PC has no internet.
//!
//! In: a path, what the browser accepts, the version it has. Out: the file, compressed where that is
//! accepted, or that nothing has changed. What is of others lies in `assets/vendor` with its licence.

use axum::body::Bytes;
use axum::http::header::{
    ACCEPT_ENCODING, CACHE_CONTROL, CONTENT_ENCODING, CONTENT_TYPE, ETAG, IF_NONE_MATCH, VARY,
};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use flate2::Compression;
use flate2::write::GzEncoder;
use sha2::{Digest, Sha256};
use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;
use std::sync::OnceLock;

const HTML: &str = "text/html; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";
const JSON: &str = "application/json";
const SVG: &str = "image/svg+xml";

macro_rules! files {
    ($($path:literal $kind:ident),* $(,)?) => {
        [$(($path, $kind, include_bytes!(concat!("assets/", $path)).as_slice())),*]
    };
}

/// Path, type, content.
static FILES: [(&str, &str, &[u8]); 20] = files![
    "index.html" HTML,
    "page.css" CSS,
    "icon.svg" SVG,
    "main.js" SCRIPT,
    "net.js" SCRIPT,
    "text.js" SCRIPT,
    "text-de.json" JSON,
    "dom.js" SCRIPT,
    "table.js" SCRIPT,
    "picture.js" SCRIPT,
    "film.js" SCRIPT,
    "calibrate.js" SCRIPT,
    "arm.js" SCRIPT,
    "live.js" SCRIPT,
    "spark.js" SCRIPT,
    "orders.js" SCRIPT,
    "goal.js" SCRIPT,
    "jobs.js" SCRIPT,
    "setup.js" SCRIPT,
    "vendor/three.module.min.js" SCRIPT,
];

struct Asset {
    kind: &'static str,
    plain: &'static [u8],
    gzip: Bytes,
    etag: String,
}

fn made() -> &'static [Asset] {
    static MADE: OnceLock<Vec<Asset>> = OnceLock::new();
    MADE.get_or_init(|| {
        let make = |(_, kind, plain): &(&str, &'static str, &'static [u8])| {
            let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
            // Into memory: nothing is refused there.
            let gzip = encoder.write_all(plain).and_then(|()| encoder.finish()).unwrap_or_default();
            let hash = Sha256::digest(plain);
            let etag: String = hash.iter().take(8).map(|byte| format!("{byte:02x}")).collect();
            Asset { kind, plain, gzip: gzip.into(), etag: format!("\"{etag}\"") }
        };
        FILES.iter().map(make).collect()
    })
}

/// All texts of the page, in English: those of the built-in table.
pub fn known_texts() -> BTreeSet<String> {
    let table = FILES.iter().find(|(path, ..)| *path == "text-de.json").map(|(.., plain)| *plain);
    let table: BTreeMap<String, String> =
        table.and_then(|plain| serde_json::from_slice(plain).ok()).unwrap_or_default();
    table.into_keys().collect()
}

/// A file of the page.
pub fn asset(path: &str, headers: &HeaderMap) -> Response {
    let path = if path.is_empty() { "index.html" } else { path };
    let Some(asset) = FILES.iter().position(|(name, ..)| *name == path).map(|index| &made()[index]) else {
        return (StatusCode::NOT_FOUND, "not found\n").into_response();
    };
    let has = |name, wanted: &str| {
        headers.get(name).and_then(|value| value.to_str().ok()).is_some_and(|value| value.contains(wanted))
    };
    let common = [
        (CONTENT_TYPE, asset.kind.to_string()),
        (ETAG, asset.etag.clone()),
        (CACHE_CONTROL, "no-cache".to_string()),
        (VARY, "accept-encoding".to_string()),
    ];
    if has(IF_NONE_MATCH, &asset.etag) {
        return (StatusCode::NOT_MODIFIED, common).into_response();
    }
    if has(ACCEPT_ENCODING, "gzip") && !asset.gzip.is_empty() {
        return (common, [(CONTENT_ENCODING, "gzip")], asset.gzip.clone()).into_response();
    }
    (common, Bytes::from_static(asset.plain)).into_response()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::history::story_lines;
    use crate::jobs::record::{
        GoalPose, JobRecord, JobResult, PlanRecord, PlanStep, StepIntent, StepKind, StepPhase, StepRecord,
    };
    use cell_machine::code::JobStatus;
    use cell_machine::supervisor::gates::GateClosed;
    use rearrange::geometry::pose::Pose2;
    use std::collections::{BTreeMap, BTreeSet};

    fn file(name: &str) -> &'static str {
        let (.., plain) = FILES.iter().find(|(path, ..)| *path == name).expect("a file");
        std::str::from_utf8(plain).expect("text")
    }

    fn german() -> BTreeMap<String, String> {
        serde_json::from_str(file("text-de.json")).expect("a table")
    }

    /// Everything that a file of the page names is there, and nothing is fetched from elsewhere.
    #[test]
    fn the_page_is_complete_and_offline() {
        let mut bytes = 0;
        for ((path, kind, plain), asset) in FILES.iter().zip(made()) {
            bytes += asset.gzip.len();
            let text = std::str::from_utf8(plain).expect("text");
            if path.starts_with("vendor/") {
                continue;
            }
            for foreign in ["https://", "http://", "//cdn", "eval("] {
                let allowed = text.replace("http://www.w3.org/", "");
                assert!(!allowed.contains(foreign), "{path} has {foreign}");
            }
            if *kind == SCRIPT {
                for line in text.lines().filter(|line| line.starts_with("import ")) {
                    let name = line.rsplit('"').nth(1).expect("a name").trim_start_matches("./");
                    assert!(FILES.iter().any(|(known, ..)| *known == name), "{path} imports {name}");
                }
            }
        }
        assert!(bytes < 400_000, "{bytes} bytes are transferred");
    }

    /// Every text of the scripts is in the table of the other language.
    #[test]
    fn no_text_is_left_in_english() {
        let german = german();
        let scripts = FILES.iter().filter(|(path, kind, _)| *kind == SCRIPT && !path.starts_with("vendor/"));
        let mut count = 0;
        for (path, ..) in scripts {
            for (before, rest) in file(path).match_indices("t(\"").map(|(at, _)| file(path).split_at(at)) {
                // A call of t, and not of a function whose name ends in t.
                if before.ends_with(|c: char| c.is_ascii_alphanumeric() || c == '.' || c == '_') {
                    continue;
                }
                let text = rest[3..].split('"').next().expect("its end");
                assert!(german.contains_key(text), "{path}: {text:?} is not in text-de.json");
                count += 1;
            }
        }
        assert!(count > 100, "{count}");
        for (english, german) in &german {
            let holes = |text: &str| text.matches('{').count();
            assert_eq!(holes(english), holes(german), "{english}: what is filled in");
        }
    }

    /// Every closed gate: its hint is in the status.
    fn hints() -> Vec<GateClosed> {
        use cell_machine::device::gripper_types::GripperFault;
        use cell_machine::device::robot_types::Link;
        use ur_wire::enumerations::{RobotMode, SafetyMode};
        let safety = [
            SafetyMode::RobotEmergencyStop,
            SafetyMode::ProtectiveStop,
            SafetyMode::SafeguardStop,
            SafetyMode::Fault,
            SafetyMode::Unknown(99),
        ];
        let others = [
            GateClosed::Link(Link::Rtde),
            GateClosed::Link(Link::Dashboard),
            GateClosed::Link(Link::Primary),
            GateClosed::Stale,
            GateClosed::Guided,
            GateClosed::Local,
            GateClosed::Program,
            GateClosed::Paused,
            GateClosed::NotPlaying("STOPPED".into()),
            GateClosed::Disarmed,
            GateClosed::Locked(String::new()),
            GateClosed::Gripper(GripperFault::Silent),
            GateClosed::Gripper(GripperFault::Taken),
            GateClosed::Gripper(GripperFault::Refused),
            GateClosed::Gripper(GripperFault::Unserved),
            GateClosed::Gripper(GripperFault::NoVacuum),
            GateClosed::GripperUnknown,
            GateClosed::GripperByAddress,
            GateClosed::GripperOther,
            GateClosed::GripperUnconfirmed,
            GateClosed::Holding,
            GateClosed::MayHang("mug".into()),
            GateClosed::NotObserved,
            GateClosed::NotApproved,
        ];
        let modes =
            [-1, 0, 1, 2, 3, 4, 5, 6, 7, 8].map(|number| GateClosed::Mode(RobotMode::from_code(number)));
        safety.map(GateClosed::Safety).into_iter().chain(modes).chain(others).collect()
    }

    /// A line of a job's story, phrase by phrase as the page has it, with its holes.
    fn phrases_of(line: &str) -> Vec<String> {
        let mut holes = String::new();
        for c in line.replace("mug", "OBJECT").chars() {
            match (c.is_ascii_digit(), holes.ends_with('#')) {
                (true, false) => holes.push('#'),
                (true, true) => {}
                (false, _) => holes.push(c),
            }
        }
        let holes = holes.replace("#.#", "#");
        holes.split("; ").flat_map(|part| part.split(": ")).map(str::to_string).collect()
    }

    #[test]
    fn the_story_of_a_job_is_there_in_german() {
        let german = german();
        let mut lines = 0;
        for shape in 0..16 {
            let (job, steps) = story_of(shape);
            for (_, line) in story_lines(&job, &steps) {
                for phrase in phrases_of(&line).iter().filter(|phrase| !phrase.contains(".yaml")) {
                    assert!(german.contains_key(phrase), "{line:?}: {phrase:?} is not in text-de.json");
                }
                lines += 1;
            }
        }
        assert!(lines > 100, "{lines}");
    }

    /// A job with all that its story may have; the bits of `shape` say which parts of its plan are known.
    fn story_of(shape: u32) -> (JobRecord, Vec<StepRecord>) {
        let has = |bit: u32| shape & (1 << bit) != 0;
        let kind = if has(0) { StepKind::Buffer } else { StepKind::Goal };
        let pose = Pose2::new(0.1, 0.2, 0.0);
        let intent = || StepIntent {
            object: "mug".into(),
            from: pose,
            to: pose,
            kind,
            tool_from_object: None,
            table: Vec::new(),
        };
        let phases = [StepPhase::Intent, StepPhase::Gripped, StepPhase::Done, StepPhase::Abandoned];
        let step = |phase| StepRecord {
            step: 1,
            intent: intent(),
            phase,
            changed_unix_s: 5.0,
            gripped_unix_s: None,
            note: None,
        };
        let let_go = StepRecord {
            note: Some("it was taken off by a person's order".into()),
            gripped_unix_s: Some(6.0),
            ..step(StepPhase::Released)
        };
        let steps = phases.into_iter().map(step).chain([let_go]).collect();
        let status = [JobStatus::Done, JobStatus::Failed, JobStatus::Cancelled, JobStatus::Interrupted]
            [shape as usize % 4];
        let mut job = JobRecord::sample("tidy");
        job.spec.priority = 2;
        job.started_unix_s = Some(1.0);
        job.found = vec![GoalPose { id: "mug".into(), pose }];
        job.approved = Some("[]".into());
        job.plan = Some(PlanRecord {
            number: 1,
            steps: vec![PlanStep { object: "mug".into(), from: pose, to: pose, kind }],
            lower_bound: has(1).then_some(1.0),
            seconds: has(2).then_some(8.0),
            table: Vec::new(),
            preview: has(3),
            made: 0,
            sight_age_s: 12.0,
            unix_s: 3.0,
        });
        job.result = Some(JobResult {
            id: "tidy".into(),
            status,
            code: String::new(),
            message: String::new(),
            hint: String::new(),
            moves: 1,
            lower_bound: None,
            seconds: 29.0,
            times: BTreeMap::new(),
            links_off_mm: None,
            objects: Vec::new(),
        });
        (job, steps)
    }

    /// Refusals to arm that no case of the pages comes to.
    const REFUSALS: [&str; 4] = [
        "not armed: `celld arm` is refused: the cell is locked or ends",
        "not armed: celld is ending",
        "not armed: a release is under way, and the gripper has not confirmed it yet; try again",
        "not armed: the pick-n-place under way is finished first; then `celld arm`",
    ];

    /// What the pages say that the cell answers, and what an operator reads after a fault, phrase by phrase.
    #[test]
    fn what_the_cell_says_is_there_in_german() {
        let german = german();
        let cells = |line: &'static str| line.trim_matches('|').split('|').map(str::trim).collect::<Vec<_>>();
        let orders = include_str!("../../docs/orders.md").lines().map(cells);
        let answers = orders.filter(|row| matches!(row.get(1), Some(&"yes" | &"no"))).map(|row| row[2]);
        let reactions = include_str!("../../docs/reactions.md").lines().map(cells);
        let faults =
            reactions.filter(|row| row.len() >= 9 && row[0].starts_with(|c: char| c.is_ascii_digit()));
        let hints = hints();
        let gates: Vec<String> = hints.iter().map(|gate| phrases_of(&gate.to_string()).join("; ")).collect();
        let hints = hints.iter().flat_map(|hint| [hint.hint(), hint.hint_before_arming()]);
        let of_gates = hints.chain(gates.iter().map(String::as_str)).chain(REFUSALS);
        let sentences = answers.chain(faults.flat_map(|row| [row[6], row[7]])).chain(of_gates);
        let phrases = sentences.flat_map(|text| text.split("; ").flat_map(|part| part.split(": ")));
        let phrases: BTreeSet<&str> = phrases.flat_map(|part| part.split(", then ")).collect();
        // A person names jobs as he likes.
        let known = |phrase: &str| {
            let of_any_job = phrase.replace("job job-#", "job JOB").replace("job none", "job JOB");
            phrase.is_empty() || german.contains_key(&of_any_job)
        };
        let missing: Vec<_> = phrases.iter().filter(|phrase| !known(phrase)).collect();
        assert!(missing.is_empty() && phrases.len() > 200, "{missing:#?}");
        for (english, german) in &german {
            let holes = |text: &str| ["#", "OBJECT", "JOB"].map(|hole| text.matches(hole).count());
            assert_eq!(holes(english), holes(german), "{english}: what is filled in");
        }
    }
}
