//! Instance files as people write them, wrong in every way we know, and the public data.

use std::path::{Path, PathBuf};

use crate::document::Diagnostics;
use crate::document::edit::replace_once;
use crate::geometry::footprint::Footprint;
use crate::geometry::pose::Pose2;
use crate::tabletop::instance::Instance;
use crate::tabletop::parse::{parse_instance, parse_pair, parse_with_sound_goals};
use crate::tabletop::write::{to_json, to_yaml};

mod complete;

fn read(text: &str) -> Result<Instance, Diagnostics> {
    parse_instance(text, "t.yaml", &|_| None)
}

/// The complaints, one per line.
fn reported(text: &str) -> Vec<String> {
    read(text).expect_err("refused").0.iter().map(ToString::to_string).collect()
}

/// One object of a 1 m table, with `line` (line 4) as its further key.
fn with(line: &str) -> String {
    format!("workspace: {{width: 1.0, height: 1.0}}\nobjects:\n  - id: a\n    {line}\n")
}

const FULL: &str = "\
workspace: {width: 1.0, height: 0.8}
clearance: 0.002
overlap_tolerance: 0.001
keep_out: [{footprint: {disc: {radius: 0.05}}, pose: [0.9, 0.1, 0]}]
objects:
  - id: plank-1
    footprint: {rectangle: {length: 0.3, width: 0.1}}
    impedance: 0.03
    start: [0.20, 0.35, 1.57]
    goal_deg: [0.70, 0.60, 90]
    group: small
    height: 0.02
    mass: 0.10
    marker: {family: tag36h11, id: 7, size: 0.03, offset: [0.01, 0, 0]}
    grippable: [[-0.1, -0.04], [0.1, -0.04], [0.1, 0.04], [-0.1, 0.04]]
  - {id: ring, footprint: {ellipse: {length: 0.2, width: 0.1}}, start: [0.5, 0.2, 0], fixed: true}
  - {id: el, footprint: [[0, 0], [0, 0.2], [0.05, 0.2], [0.05, 0.05], [0.1, 0.05], [0.1, 0]], start: [0.8, 0.4, 0]}
";

#[test]
fn a_full_file_is_read_and_written_back_the_same() {
    let instance = read(FULL).expect("valid");
    assert_eq!(instance.objects.len(), 3);
    assert_eq!(instance.objects[0].goal, Some(Pose2::new(0.7, 0.6, std::f64::consts::FRAC_PI_2)));
    assert_eq!(instance.objects[0].marker.as_ref().map(|marker| marker.id), Some(7));
    assert!(instance.objects[1].fixed);
    assert!(matches!(instance.objects[2].footprint, Footprint::Polygon(_)));
    for text in [to_yaml(&instance), to_json(&instance)] {
        assert_eq!(read(&text).unwrap_or_else(|faults| panic!("{faults}\n{text}")), instance, "{text}");
    }
}

#[test]
fn defaults_are_those_of_the_design() {
    let text = with("footprint: {disc: {radius: 0.1}}\n    start: [0.5, 0.5, 0]");
    let instance = read(&text).expect("valid");
    assert_eq!((instance.clearance, instance.overlap_tolerance), (0.0, 0.0));
    let object = &instance.objects[0];
    assert!(object.goal.is_none() && object.marker.is_none() && object.impedance.is_none() && !object.fixed);
}

/// Key and value, the text the complaint has to point at, and how the complaint goes on.
const COMPLAINTS: &[(&str, &str, &str)] = &[
    ("fotprint: {disc: {radius: 0.1}}", "fotprint", ".fotprint: unknown key; did you mean \"footprint\"?"),
    ("footprint: {disc: {radius: -1}}", "-1", ".footprint.disc.radius: -1 m is not over 0"),
    ("footprint: {disc: {radius: .nan}}", ".nan", ".footprint.disc.radius: .nan is not a finite number"),
    (
        "footprint: {disc: {radius: 30 mm}}",
        "30 mm",
        ".footprint.disc.radius: \"30 mm\" is not a number; write the number alone, without \"mm\"",
    ),
    (
        "footprint: {disc: {radius: 300}}",
        "300",
        ".footprint.disc.radius: 300 m is out of range; lengths are in m",
    ),
    ("footprint: {disc: {}}", "{}", ".footprint.disc: key \"radius\" is missing; add it"),
    (
        "footprint: {square: {}}",
        "square",
        ".footprint.square: unknown key; known keys: rectangle, disc, ellipse, polygon",
    ),
    ("footprint: 3", "3", ".footprint: \"3\" where a map of keys and values is wanted"),
    (
        "footprint: [[0, 0], [0.1, 0.1], [0.1, 0], [0, 0.1]]",
        "[0.1, 0], [0, 0.1]",
        ".footprint[2]: the outline crosses itself: the edge from point 0 meets the edge from point 2; \
         reorder",
    ),
    ("footprint: [[0, 0], [0.1, x]]", "x", ".footprint[1][1]: \"x\" is not a number"),
    ("footprint: [[0, 0], [0.1, 0]]", "[[0", ".footprint: a polygon needs at least 3 points, this one has 2"),
    (
        "footprint: [[0, 0], [0.1, 0], [0.1, 0], [0, 0.1]]",
        "[0.1, 0], [0, 0.1]",
        ".footprint[2]: points 1 and 2 coincide",
    ),
    (
        "footprint: {disc: {radius: 0.1}, ellipse: {length: 1, width: 1}}",
        "{disc",
        ".footprint: a footprint has exactly one of",
    ),
    ("start: [0.5, 0.5]", "[0.5", ".start: 2 values, 3 are wanted"),
    ("start: [500, 50000, 0]", "[500", ".start: 500 m, 50000 m, 0 rad is out of range; lengths are in m"),
    ("start_deg: [0.5, 0.5, inf]", "inf", ".start_deg[2]: inf is not a finite number"),
    ("start: [0.5, 0.5, 'x']", "'x'", ".start[2]: text in quotes where a number without quotes is wanted"),
    ("fixed: maybe", "maybe", ".fixed: \"maybe\" where true or false is wanted"),
    ("impedance: 0", "0", ".impedance: 0 is not over 0"),
    ("mass: -2", "-2", ".mass: -2 kg is not over 0"),
    ("group: [a]", "[a]", ".group: a list where a text is wanted"),
    (
        "marker: {id: 900, size: 0.03}",
        "900",
        ".marker.id: 900 is out of range; it has to be between 0 and 586",
    ),
    (
        "marker: {family: aruco, id: 9, size: 0.03}",
        "aruco",
        ".marker.family: \"aruco\" is not known here; one of: tag36h11",
    ),
    ("marker: {id: 9}", "{id", ".marker: key \"size\" is missing"),
    ("marker: {id: 9, size: 30}", "30", ".marker.size: 30 m is out of range"),
    ("grippable: [[0, 0], [1, 0], [0.5, 0]]", "[1, 0]", ".grippable[1]: the outline crosses itself"),
];

#[test]
fn every_kind_of_complaint_has_its_line_and_column() {
    for (line, needle, expected) in COMPLAINTS {
        let text = with(line);
        let written = text.lines().nth(3).expect("line 4");
        let column = written.find(needle).expect("needle") + 1;
        let wanted = format!("t.yaml:4:{column}: objects[0]{expected}");
        let complaints = reported(&text);
        assert!(complaints.iter().any(|c| c.starts_with(&wanted)), "wanted {wanted}\ngot {complaints:#?}");
    }
}

#[test]
fn complaints_of_the_whole_file_come_together() {
    let text = "\
workspace: {width: 1.0, heigth: 1.0}
clearance: -1
objects:
  - {id: a, footprint: {disc: {radius: 0.1}}, marker: {id: 3, size: 0.03}, start: [0.5, 0.5, 0]}
  - {id: a, footprint: {disc: {radius: x}}, marker: {id: 3, size: 0.03}, start: [0.5, 0.5, 0]}
  - {id: 'b/c', footprint: {disc: {radius: 0.1}}, fixed: true, start: [0.5, 0.5, 0]}
";
    let complaints = reported(text);
    let expected = [
        "t.yaml:1:12: workspace: key \"height\" is missing",
        "t.yaml:1:25: workspace.heigth: unknown key; did you mean \"height\"?",
        "t.yaml:2:12: clearance: -1 m is out of range",
        "t.yaml:5:10: objects[1].id: the name \"a\" is used twice, first in line 4",
        "t.yaml:5:40: objects[1].footprint.disc.radius: \"x\" is not a number",
        "t.yaml:5:58: objects[1].marker.id: marker 3 is used twice, first by object \"a\" in line 4",
        "t.yaml:6:10: objects[2].id: \"b/c\" is no usable name",
    ];
    assert_eq!(complaints.len(), expected.len(), "{complaints:#?}");
    for (complaint, wanted) in complaints.iter().zip(expected) {
        assert!(complaint.starts_with(wanted), "{complaint}\nwanted {wanted}");
    }
}

#[test]
fn arrangements_that_collide_name_both_and_the_millimetres() {
    let text = "\
workspace: {width: 1.0, height: 1.0}
objects:
  - {id: a, footprint: {disc: {radius: 0.1}}, start: [0.5, 0.5, 0], goal: [0.2, 0.2, 0]}
  - {id: b, footprint: {disc: {radius: 0.1}}, start: [0.69, 0.5, 0], goal: [0.3, 0.2, 0]}
  - {id: c, footprint: {disc: {radius: 0.1}}, start: [0.05, 0.9, 0], goal: [0.9, 1.0, 0]}
";
    let complaints = reported(text);
    assert_eq!(complaints.len(), 2, "{complaints:#?}");
    assert!(complaints[0].starts_with("t.yaml:4:54: objects[1].start: \"b\" overlaps \"a\" by 10.000 mm"));
    assert!(
        complaints[1]
            .starts_with("t.yaml:5:54: objects[2].start: \"c\" reaches over the table's edge by 50.000 mm")
    );
    // A tolerance makes the start acceptable; the goals are wrong for a job, not for an instance.
    let tolerant = replace_once(text, "objects:", "overlap_tolerance: 0.051\nobjects:");
    assert!(read(&tolerant).is_ok());
    let goals = parse_with_sound_goals(&tolerant, "t.yaml", &|_| None).expect_err("goals").0;
    let goals: Vec<String> = goals.iter().map(ToString::to_string).collect();
    assert_eq!(goals.len(), 2, "{goals:#?}");
    assert!(
        goals[0].starts_with("t.yaml:5:76: objects[1].goal: \"b\" overlaps \"a\" by 100.000 mm"),
        "{}",
        goals[0]
    );
    assert!(
        goals[1].contains("objects[2].goal: \"c\" reaches over the table's edge by 100.000 mm"),
        "{}",
        goals[1]
    );
}

#[test]
fn groups_and_fixed_objects_have_to_make_sense() {
    let text = "\
workspace: {width: 1.0, height: 1.0}
objects:
  - {id: a, footprint: {disc: {radius: 0.1}}, group: g, start: [0.2, 0.2, 0]}
  - {id: b, footprint: {disc: {radius: 0.11}}, group: g, impedance: 2, start: [0.8, 0.2, 0]}
  - {id: c, footprint: {disc: {radius: 0.1}}, fixed: true}
  - {id: d, footprint: {disc: {radius: 0.1}}, fixed: true, start: [0.5, 0.5, 0], goal: [0.6, 0.5, 0]}
";
    let complaints = reported(text);
    assert_eq!(complaints.len(), 4, "{complaints:#?}");
    assert!(complaints[0].contains("\"a\" and \"b\" of group \"g\" differ in footprint"));
    assert!(complaints[1].contains("differ in impedance"));
    assert!(complaints[2].starts_with("t.yaml:5:5: objects[2]: a fixed object has no start"));
    assert!(complaints[3].contains("\"d\" is fixed, but its goal is not its start"));
}

#[test]
fn a_second_file_of_ours_gives_goals_by_name() {
    let start = with("footprint: {disc: {radius: 0.1}}\n    start: [0.5, 0.5, 0]");
    let goal = with("footprint: {disc: {radius: 0.1}}\n    start: [0.3, 0.3, 1]");
    let pair = parse_pair((&start, "s"), (&goal, "g"), &|_| None).expect("valid");
    assert_eq!(pair.objects[0].goal, Some(Pose2::new(0.3, 0.3, 1.0)));
    let stranger = replace_once(&goal, "id: a", "id: z");
    let reported = parse_pair((&start, "s"), (&stranger, "g"), &|_| None).expect_err("unknown").to_string();
    assert!(reported.contains("object \"z\" is not in s"), "{reported}");
}

#[test]
fn heterogeneous_tasks_are_imported() {
    let text = r#"{"Workspace_Density":0.1,"Workspace_Height":1000,"Workspace_Width":1000,"number_of_objects":3,
"object_list":[
{"Object_Shape":"cuboid","Object_Length":200.0,"Object_Width":100.0,"initial_pose":[300,300,0.5],"goal_pose":[600,600,0]},
{"Object_Shape":"disc","Object_Length":200.0,"Object_Width":100.0,"initial_pose":[700,300,0.5],"goal_pose":[300,600,0]},
{"Object_Shape":"tri","Object_Length":100.0,"Object_Width":100.0,"initial_pose":[500,800,0],"goal_pose":[200,200,0]}]}"#;
    let shapes = |name: &str| {
        (name == "tri").then(|| r#"{"center":[0,0],"radius":1,"points":[[0,0],[1,0],[0,1]]}"#.to_string())
    };
    let instance = parse_instance(text, "h.json", &shapes).expect("valid");
    assert_eq!(instance.objects[0].footprint, Footprint::rectangle(0.2, 0.1).expect("valid"));
    assert_eq!(instance.objects[1].footprint, Footprint::ellipse(0.2, 0.1).expect("valid"));
    assert_eq!(instance.objects[1].start, Some(Pose2::new(0.7, 0.3, 0.5)));
    assert!((instance.objects[0].impedance.expect("given") - 4.0).abs() < 1e-9);
    assert_eq!(instance.objects[2].impedance, Some(1.0));
    assert_eq!(instance.overlap_tolerance, 0.002);
    let reported = parse_instance(text, "h.json", &|_| None).expect_err("no shape").to_string();
    assert!(
        reported.starts_with("h.json:5:17: object_list[2].Object_Shape: the shape \"tri\" is not known"),
        "{reported}"
    );
}

#[test]
fn small_loops_of_published_outlines_are_cut_off() {
    let task = |points: &str| {
        let shape = format!(r#"{{"center":[0,0],"radius":1,"points":{points}}}"#);
        let text = r#"{"Workspace_Height":1000,"Workspace_Width":1000,"object_list":[
{"Object_Shape":"s","Object_Length":100.0,"Object_Width":100.0,"initial_pose":[500,500,0],"goal_pose":[500,500,0]}]}"#;
        parse_instance(text, "h.json", &|_| Some(shape.clone()))
    };
    let square = task("[[0,0],[1,0],[1,1],[0,1]]").expect("valid").objects[0].footprint.area();
    for looped in [
        "[[0,0],[1,0],[1,1],[0.51,1],[0.5,1.01],[0.51,1.01],[0.49,1],[0,1]]",
        "[[0,0],[1,0],[1,1],[0,1],[-0.05,-0.05],[0.02,0.01],[-0.01,0.02]]",
    ] {
        let instance = task(looped).unwrap_or_else(|faults| panic!("{looped}: {faults}"));
        assert!((instance.objects[0].footprint.area() / square - 1.0).abs() < 0.06, "{looped}");
    }
    let reported = task("[[0,0],[1,1],[1,0],[0,1]]").expect_err("a bow tie is no small loop").to_string();
    assert!(reported.contains("crosses itself"), "{reported}");
}

#[test]
fn disc_and_stick_tasks_are_pairs() {
    let disc = |x: f64| {
        format!(
            r#"{{"Object_Radius":50,"Object_Shape":"disc","Workspace_Density":0.1,"Workspace_Height":1000,"Workspace_Width":1000,"number_of_objects":1,"point_list":[[{x},500]]}}"#
        )
    };
    let pair = parse_pair((&disc(100.0), "s"), (&disc(700.0), "g"), &|_| None).expect("valid");
    assert_eq!(pair.objects[0].footprint, Footprint::disc(0.05).expect("valid"));
    assert_eq!(pair.objects[0].goal, Some(Pose2::new(0.7, 0.5, 0.0)));
    let alone = read(&disc(100.0)).expect_err("half a task").to_string();
    assert!(alone.contains("--goal GOAL.json"), "{alone}");
    let other = replace_once(&disc(700.0), "50,\"Object_S", "60,\"Object_S");
    assert!(parse_pair((&disc(100.0), "s"), (&other, "g"), &|_| None).is_err());
    let mixed = parse_pair((&disc(100.0), "s"), (FULL, "g"), &|_| None).expect_err("mixed").to_string();
    assert!(mixed.contains("different kinds"), "{mixed}");
}

#[test]
fn arbitrary_trees_never_panic() {
    let words = [
        "workspace",
        "objects",
        "id",
        "footprint",
        "polygon",
        "start",
        "[",
        "]",
        "{",
        "}",
        ":",
        ",",
        "1",
        "-0.5",
        "1e400",
        ".nan",
        "null",
        "\n",
        " ",
        "- ",
        "object_list",
        "point_list",
        "\"x\"",
    ];
    let mut state = 99u64;
    for _ in 0..20_000 {
        let mut text = String::new();
        for _ in 0..20 {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            text.push_str(words[(state >> 33) as usize % words.len()]);
            text.push(' ');
        }
        let _ = read(&text);
    }
}

/// The public data, when this machine has them.
pub(crate) fn data_folder() -> Option<PathBuf> {
    let given = std::env::var_os("CELLD_DATA").map(PathBuf::from);
    let beside =
        || Path::new(env!("CARGO_MANIFEST_DIR")).parent().map(|folder| folder.join("shared").join("data"));
    let folder = given.or_else(beside)?;
    if folder.join("hetori").is_dir() {
        return Some(folder);
    }
    eprintln!("SKIPPED: no public data at {} (set CELLD_DATA to their folder)", folder.display());
    None
}

fn json_files(folder: &Path, out: &mut Vec<PathBuf>) {
    let Ok(entries) = std::fs::read_dir(folder) else { return };
    let mut paths: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    paths.sort();
    for path in paths {
        if path.is_dir() {
            json_files(&path, out);
        } else if path.extension().is_some_and(|extension| extension == "json") {
            out.push(path);
        }
    }
}

#[test]
fn the_public_data_are_read() {
    let Some(folder) = data_folder() else { return };
    let shapes =
        |name: &str| std::fs::read_to_string(folder.join("hetori/shapes").join(format!("{name}.json"))).ok();
    let mut files = Vec::new();
    json_files(&folder.join("hetori/instances"), &mut files);
    assert!(files.len() > 100, "{} files", files.len());
    let mut refused = Vec::new();
    for path in &files {
        let text = std::fs::read_to_string(path).expect("readable");
        match parse_instance(&text, &path.display().to_string(), &shapes) {
            Ok(instance) => assert!(!instance.objects.is_empty()),
            Err(faults) => refused.push(faults.to_string()),
        }
    }
    for fault in &refused {
        eprintln!("{fault}");
    }
    eprintln!("{} of {} heterogeneous files refused", refused.len(), files.len());
    // As published: three single Tetris pieces lie over the edge, and the starts of all YCB tables of 28 and
    // of 12 objects and of one of 11 overlap by centimetres.
    assert_eq!(refused.len(), 20);
    for folder in [folder.join("trlb/disks"), folder.join("trlb/sticks")] {
        let mut files = Vec::new();
        json_files(&folder, &mut files);
        for pair in files.chunks_exact(2).filter(|pair| pair[0].parent() == pair[1].parent()) {
            let text = |k: usize| std::fs::read_to_string(&pair[k]).expect("readable");
            let task = parse_pair((&text(0), "start"), (&text(1), "goal"), &shapes);
            task.unwrap_or_else(|faults| panic!("{}: {faults}", pair[0].display()));
        }
    }
}
