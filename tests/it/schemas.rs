//! The schemas of `celld schema` against the readers of the daemon and the commands: a schema accepts what
//! is read, and refuses what is wrong with a single key.
//!
//! In: the example files, each changed in every place (an unknown key, a key gone, another type, another
//! number). Out: no change that a reader accepts and its schema refuses; no unknown key and no wrong type
//! that a reader refuses and its schema accepts.

#![allow(clippy::unwrap_used, reason = "helpers of tests: an unwrap that fails is the test that fails")]

use cell_calibration::files::camera::CameraCalibration;
use cell_calibration::files::hand_eye::HandEyeCalibration;
use cell_calibration::files::table::TableCalibration;
use cell_machine::orders::Approval;
use celld::cli::schema::Kind;
use celld::config::read_cell::read_cell;
use celld::jobs::goal::parse_goal_file;
use celld::jobs::job_file::{JobContext, read_job};
use jsonschema::Validator;
use rearrange::document::Diagnostics;
use rearrange::document::tree::{Node, Value as Tree};
use rearrange::planning::plan::PlanFile;
use rearrange::tabletop::parse::parse_with_sound_goals;
use serde_json::{Map, Value, json};
use std::path::Path;
use ur_sim::config::read::read_sim;
use ur_sim::faults::read::read_faults;

const PLAN: &str = r#"{"solver": "erbm", "objective": "pp", "seed": 0, "status": "solved", "cost": 1.0, "moves": 1,
    "lower_bound": 1.0, "first_plan_seconds": 0.004, "seconds": 0.012,
    "actions": [{"object": "a", "from": [0.1, 0.1, 0], "to": [0.4, 0.1, 0], "kind": "goal"}]}"#;

/// What a reader says of a text.
type Reader = fn(&str) -> Result<(), String>;

fn outcome<T>(read: Result<T, Diagnostics>) -> Result<(), String> {
    read.map(drop).map_err(|complaints| complaints.to_string())
}

fn config(text: &str) -> Result<(), String> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("config");
    let file = |path: &Path| std::fs::read_to_string(path).map_err(|error| error.to_string());
    outcome(read_cell(text, "cell.yaml", None, &folder, &file))
}

fn job(text: &str) -> Result<(), String> {
    let read_goal = |_: &str| -> Result<String, String> { Ok(super::spoilt_files::GOAL.to_string()) };
    let context = JobContext { goal: None, approval: Approval::Never, read_goal: &read_goal, found: None };
    outcome(read_job(text, "job.yaml", &context))
}

fn plan(text: &str) -> Result<(), String> {
    PlanFile::parse(text).map(drop).map_err(|error| error.to_string())
}

/// Each kind with sound examples.
fn examples() -> Vec<(Kind, Reader, Vec<String>)> {
    use super::spoilt_files as sound;
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let file = |name: &str| std::fs::read_to_string(root.join(name)).unwrap();
    let jobs = [
        sound::JOB,
        "version: 1\ngoal: {file: goal.yaml}\n",
        "version: 1\ngoal: {objects: [{id: plank-1, pose_deg: [0.1, 0.2, 90]}]}\nobjective: time\nseed: 3\n",
        "version: 1\ngoal: {grid: {objects: [a, b], origin: [0.1, 0.1], pitch: [0.1, 0.1], columns: 2, theta: 0}}\n",
        "version: 1\ngoal: {swap: [a, b]}\npriority: 3\n",
        "version: 1\ngoal: {restore: tidy-1}\n",
    ];
    vec![
        (Kind::Config, config, vec![file("config/cell.yaml")]),
        (Kind::Sim, |text| outcome(read_sim(text, "sim.yaml")), simulators(&file("config/sim.yaml"))),
        (
            Kind::Faults,
            |text| outcome(read_faults(text, "faults.yaml")),
            vec![file("config/faults-example.yaml")],
        ),
        (Kind::Job, job, jobs.map(str::to_string).to_vec()),
        (Kind::Goal, |text| outcome(parse_goal_file(text, "goal.yaml", None)), vec![sound::GOAL.to_string()]),
        (
            Kind::Instance,
            |text| outcome(parse_with_sound_goals(text, "instance.yaml", &|_| None)),
            vec![sound::INSTANCE.to_string()],
        ),
        (Kind::Plan, plan, vec![PLAN.to_string()]),
        (
            Kind::Calibration,
            |text| outcome(CameraCalibration::parse(text, "c")),
            vec![sound::CAMERA.to_string()],
        ),
        (
            Kind::Calibration,
            |text| outcome(HandEyeCalibration::parse(text, "c")),
            vec![sound::HAND_EYE.to_string()],
        ),
        (
            Kind::Calibration,
            |text| outcome(TableCalibration::parse(text, "c")),
            vec![sound::TABLE.to_string()],
        ),
    ]
}

/// The example, and the same with other grippers and another controller.
fn simulators(text: &str) -> Vec<String> {
    let with = |from: &str, to: &str| {
        assert!(text.contains(from), "{from}");
        text.replacen(from, to, 1)
    };
    let fingers = with("\n  vacuum_min: 0.3\n", "\n  kind: robotiq_2f85\n  vacuum_min: null\n");
    let cups = "  cups: [{channel: A, x: 0, y: 0, diameter: 0.02}]\n";
    vec![
        text.to_string(),
        with(
            "\n  vacuum_min: 0.3\n",
            "\n  kind: ejector\n  vacuum_on: 0\n  part_present: 17\n  vacuum_min: 0.3\n",
        ),
        fingers.replacen(cups, "  cups: null\n", 1),
        with("second_client: refused, half_open_s: 0", "second_client: waits, half_open_s: 20"),
        with("\ncontroller: {}", "\ncontroller: {software: polyscope_x, version: 10.12, encoders: [100, 0]}"),
    ]
}

fn validator(kind: Kind) -> Validator {
    let schema: Value = serde_json::from_str(kind.schema()).unwrap();
    jsonschema::validator_for(&schema).unwrap_or_else(|error| panic!("{kind:?}: {error}"))
}

/// A document as an editor's language server sees it.
fn json_of(node: &Node) -> Value {
    match &node.value {
        Tree::Sequence(items) => items.iter().map(json_of).collect(),
        Tree::Map(entries) => entries
            .iter()
            .map(|entry| (entry.key.clone(), json_of(&entry.node)))
            .collect::<Map<_, _>>()
            .into(),
        Tree::Unread => panic!("{:?}: what is not valid is no document", node.at),
        Tree::Scalar { text, quoted: true } => json!(text),
        Tree::Scalar { text, quoted: false } => match text.as_str() {
            "" | "~" | "null" => Value::Null,
            "true" => json!(true),
            "false" => json!(false),
            _ => text
                .parse::<i64>()
                .map(|n| json!(n))
                .or_else(|_| text.parse::<f64>().map(|n| json!(n)))
                .unwrap_or(json!(text)),
        },
    }
}

/// How a document is spoilt.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Spoilt {
    /// A key that there is not.
    Stranger,
    /// A list or a map in a scalar's place, a scalar in theirs.
    Shape,
    /// Anything else.
    Other,
}

/// Every document that differs from this one in one place.
fn mutants(sound: &Value) -> Vec<(Spoilt, Value)> {
    let mut out = Vec::new();
    let mut places = vec![String::new()];
    while let Some(place) = places.pop() {
        let here = sound.pointer(&place).unwrap();
        let mut put = |how: Spoilt, value: Value| {
            let mut other = sound.clone();
            *other.pointer_mut(&place).unwrap() = value;
            out.push((how, other));
        };
        match here {
            Value::Object(map) => {
                let mut more = map.clone();
                more.insert("no_such_key".to_string(), json!(1));
                put(Spoilt::Stranger, more.into());
                put(Spoilt::Shape, json!("text"));
                for key in map.keys() {
                    let mut less = map.clone();
                    less.remove(key);
                    put(Spoilt::Other, less.into());
                    places.push(format!("{place}/{}", key.replace('~', "~0").replace('/', "~1")));
                }
            }
            Value::Array(list) => {
                put(Spoilt::Shape, json!({"a": 1}));
                put(Spoilt::Other, list.iter().skip(1).cloned().collect());
                put(Spoilt::Other, list.iter().chain(list.last()).cloned().collect());
                places.extend((0..list.len()).map(|index| format!("{place}/{index}")));
            }
            _ => {
                put(Spoilt::Shape, json!({"a": 1}));
                put(Spoilt::Shape, json!([[]]));
                let others =
                    [json!(-1), json!(0), json!(1e9), json!("word"), json!(true), json!(null), json!(0.5)];
                others.into_iter().for_each(|other| put(Spoilt::Other, other));
            }
        }
    }
    out
}

#[test]
fn schemas_accept_what_is_read_and_refuse_what_is_wrong_with_one_key() {
    let (mut tried, mut refused) = (0, 0);
    for (kind, read, texts) in examples() {
        let validator = validator(kind);
        for text in texts {
            let sound = json_of(&rearrange::document::parse(&text, "example").unwrap());
            let complaints: Vec<_> = validator.iter_errors(&sound).map(|error| error.to_string()).collect();
            assert!(complaints.is_empty(), "{kind:?}: {}\n{text}", complaints.join("\n"));
            assert_eq!(read(&sound.to_string()), Ok(()), "{kind:?}\n{text}");
            for (how, spoilt) in mutants(&sound) {
                tried += 1;
                let (read, valid) = (read(&spoilt.to_string()), validator.is_valid(&spoilt));
                match read {
                    Ok(()) => assert!(
                        valid,
                        "{kind:?} is read and not valid: {}\n{spoilt}",
                        validator
                            .iter_errors(&spoilt)
                            .map(|error| error.to_string())
                            .collect::<Vec<_>>()
                            .join("\n")
                    ),
                    Err(complaints) => {
                        refused += usize::from(!valid);
                        let shape = how != Spoilt::Other;
                        assert!(!(shape && valid), "{kind:?} is valid and refused: {complaints}\n{spoilt}");
                    }
                }
            }
        }
    }
    println!("{tried} files, {refused} refused by both");
    assert!(tried > 3000 && refused > 2000, "{tried} files, {refused} refused by both");
}

/// The words of the command are those of the contract.
#[test]
fn every_kind_has_a_schema_of_draft_07() {
    use clap::ValueEnum;
    let kinds: Vec<String> = Kind::value_variants()
        .iter()
        .filter_map(|kind| Some(kind.to_possible_value()?.get_name().to_string()))
        .collect();
    assert_eq!(kinds, ["config", "sim", "job", "goal", "instance", "plan", "calibration", "faults"]);
    for kind in Kind::value_variants() {
        let schema: Value = serde_json::from_str(kind.schema()).unwrap();
        assert_eq!(schema["$schema"], "http://json-schema.org/draft-07/schema#", "{kind:?}");
        assert!(schema["description"].is_string() && schema["title"].is_string(), "{kind:?}");
    }
}
