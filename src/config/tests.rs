//! The example files are sound, and every kind of mistake is reported with its place.

use crate::config::cell::CellConfig;
use crate::config::read_cell::{CELL_KEYS, read_cell};
use crate::config::sessions::clock;
use crate::jobs::edit::{replace_first, replace_once};
use cell_calibration::drawn::CameraMount;
use cell_parts::gripper::CupChannel;
use rearrange::document::Diagnostics;
use std::path::Path;

const CELL: &str = include_str!("../../config/cell.yaml");

fn cell(text: &str) -> Result<CellConfig, Diagnostics> {
    let read = |path: &Path| match path.to_str() {
        Some("/etc/celld/objects.yaml") => {
            Ok("objects:\n  - {id: mug, footprint: {disc: {radius: 0}}}\n".to_owned())
        }
        _ => Err("no such file".to_owned()),
    };
    read_cell(text, "cell.yaml", None, Path::new("/etc/celld"), &read)
}

/// Changes one thing in the example and expects one complaint that contains `expected`.
#[track_caller]
fn check(from: &str, to: &str, expected: &str) {
    let complaints = cell(&replace_first(CELL, from, to)).unwrap_err();
    let reported = complaints.to_string();
    assert!(reported.contains(expected), "{reported}");
    assert_eq!(complaints.0.len(), 1, "{reported}");
    let line = CELL.split(from).next().unwrap().lines().count();
    let reported_line = complaints.0[0].at.line;
    assert!(
        reported_line.abs_diff(line) <= 4 || expected.contains("missing"),
        "line {reported_line}, not {line}: {reported}"
    );
}

#[test]
fn the_example_cell_is_sound() {
    let cell = cell(CELL).unwrap_or_else(|complaints| panic!("{complaints}"));
    assert_eq!(cell.objects.len(), 4);
    assert_eq!(cell.reference_markers.len(), 12);
    assert_eq!(cell.gripper.cups[0].channel, CupChannel::A);
    assert!((cell.limits.joint_speed - std::f64::consts::FRAC_PI_3).abs() < 1e-12);
    assert!(matches!(cell.camera, CameraMount::Flange { .. }));
    assert_eq!(cell.calibration.table, Path::new("/etc/celld/../calibration/sim/table.yaml"));
    assert!(!cell.look_poses.is_empty() && cell.calibration_poses.len() >= 8);
}

/// Every key is explained in the example, which shows every key.
#[test]
fn the_example_shows_and_comments_every_key() {
    for key in CELL_KEYS {
        // One that excludes another is shown as a comment.
        let has_key = |line: &str| line.strip_prefix("# ").unwrap_or(line).starts_with(&format!("{key}:"));
        assert!(CELL.lines().any(has_key), "{key} is not shown");
    }
}

#[test]
fn a_search_by_depth_needs_a_camera_that_is_requested_it() {
    let blind = replace_once(CELL, "8090, depth: true}", "8090}");
    let reported = cell(&blind).unwrap_err().to_string();
    assert!(
        reported.contains("devices.camera: the search")
            && reported.contains("set `depth: true` in `devices.camera`"),
        "{reported}"
    );
    let compared = replace_once(&blind, "table.yaml}", "table.yaml, empty: ../calibration/sim/empty}");
    let config = cell(&compared).expect("refused by colour");
    assert!(config.calibration.empty.is_some_and(|folder| folder.ends_with("calibration/sim/empty")));
    let driven_over =
        replace_once(&compared, "foreign: {mode: refuse}", "foreign: {mode: obstacle, margin_m: 0.01}");
    assert!(cell(&driven_over).is_err(), "colour does not show how high a thing is");
    for rule in ["", "foreign: {mode: off}"] {
        assert!(cell(&replace_once(&blind, "foreign: {mode: refuse}", rule)).is_ok(), "{rule}");
    }
    assert!(
        cell(&replace_once(&blind, "foreign: {mode: refuse}", "foreign: {mode: obstacle, margin_m: 0.01}"))
            .is_err()
    );
}

#[test]
fn a_reference_marker_lies_beside_what_is_placed() {
    let (aside, inside) = ("pose: [0.545, -0.045, 0]}", "pose: [0.49, 0.25, 0]}");
    check(aside, inside, "reference marker 501 reaches");
    check(aside, "pose: [0.51, 0.25, 0]}", "mm into the workspace, where objects are placed");
    let kept_free =
        "keep_out: [{footprint: {rectangle: {length: 0.06, width: 0.06}}, pose: [0.49, 0.25, 0]}]";
    let moved = replace_once(CELL, aside, inside);
    assert!(cell(&replace_once(&moved, "keep_out: []", kept_free)).is_ok());
}

#[test]
fn a_missing_key_is_named() {
    for key in ["limits", "gripper", "flange_from_tool", "reference_markers", "planner", "clearance"] {
        let without = replace_once(CELL, &format!("\n{key}:"), &format!("\nx-{key}:"));
        let reported = cell(&without).unwrap_err().to_string();
        assert!(reported.contains(&format!("key \"{key}\" is missing")), "{reported}");
        assert!(reported.contains(&format!("x-{key}: unknown key")), "{reported}");
    }
}

#[test]
fn a_unit_or_type_is_reported() {
    check("joint_speed_deg_s: 60", "joint_speed_deg_s: 60 deg", "write the number alone, without \"deg\"");
    check("tool_speed_m_s: 0.25", "tool_speed_m_s: 250", "out of range");
    check("vacuum_min: 0.3", "vacuum_min: 30", "out of range");
    check("clearance: 0.002", "clearance: .nan", "not a finite number");
    check("clearance: 0.002", "clearance: '0.002'", "text in quotes");
    check("port: 5020", "port: 70000", "out of range");
    check("host: 127.0.0.2}", "host: 'http://127.0.0.2:80'}", "not a host name");
    check("solver: auto", "solver: best", "one of: tbm");
    check("objective: pp", "objective: fast", "one of: pp, ti, time");
    check("mount: flange\n  flange_from", "mount: fixed\n  base_from", "key \"board\" is missing");
    check("low: [-0.40, 0.12, 0.25]", "low: [0.40, 0.12, 0.25]", "no box with edges of 0.05 to 4 m");
    check("{low: [-0.40, 0.12, 0.25], ", "{", "key \"low\" is missing");
    check("foreign: {mode: refuse}", "foreign: {mode: obstacle}", "key \"margin_m\" is missing");
    check("foreign: {mode: refuse}", "foreign: {mode: refuse, margin_m: 0.01}", "unknown key");
    check("foreign: {mode: refuse}", "foreign: {mode: ignore}", "one of: refuse, obstacle, off");
    check("reference_shift_m: 0.001", "reference_shift_m: 0", "out of range");
    check("\napproval: always", "\napproval: maybe", "one of: never");
    check(
        "[0, 0, 0.2], quaternion: [0, 0, 0, 1]",
        "[0, 0, 0.2], quaternion: [1, 0, 0, 1]",
        "a rotation has length 1",
    );
    check("{kind: simulator,", "{kind: webcam,", "one of: simulator");
    check("[[-360, 360], [-360", "[[360, -360], [-360", "is not a joint range");
    check("park_pose_deg: [", "park_pose_deg: [0, ", "7 values, 6 are wanted");
}

#[test]
fn limits_are_not_optional() {
    for key in ["joint_speed_deg_s", "joint_acceleration_deg_s2", "tool_speed_m_s", "tool_acceleration_m_s2"]
    {
        let line = CELL.lines().find(|line| line.trim_start().starts_with(key)).unwrap();
        let reported = cell(&replace_once(CELL, line, "")).unwrap_err().to_string();
        assert!(reported.contains(&format!("key \"{key}\" is missing")), "{reported}");
    }
}

/// A tunnel to a real robot may end where a simulator was.
#[test]
fn only_a_simulated_cell_follows_a_simulator() {
    let rtde = "127.0.0.2:30004".parse().unwrap();
    let of = |simulation: &str| {
        let text = replace_once(CELL, "simulation: {clock_factor: 1}", simulation);
        clock(cell(&text).unwrap().simulation, rtde)
    };
    assert!(!of("simulation: null").is_simulated());
    assert!(of("simulation: {clock_factor: 1}").is_simulated());
    let fast = of("simulation: {clock_factor: 4}");
    assert_eq!((fast.is_simulated(), fast.factor()), (true, 4.0));
}

#[test]
fn a_limit_that_arm_or_vacuum_cannot_reach_is_named_with_the_figure() {
    check(
        "joint_acceleration_deg_s2: 120 ",
        "joint_acceleration_deg_s2: 2000 ",
        "limits.joint_acceleration_deg_s2: 2000 degrees/s2 is more than the arm can do",
    );
    check("joint_acceleration_deg_s2: 120 ", "joint_acceleration_deg_s2: 1351 ", "1350 degrees/s2 at most");
    // The lid of 0.05 kg is the lightest: half of what the cups hold beyond its weight, by four times
    // its mass.
    check(
        "tool_acceleration_m_s2: 1.0 ",
        "tool_acceleration_m_s2: 20 ",
        "the cups carry \"lid\" at 17.81 m/s2",
    );
    let fast = [
        ("joint_speed_deg_s: 60 ", "joint_speed_deg_s: 180 "),
        ("joint_acceleration_deg_s2: 120 ", "joint_acceleration_deg_s2: 1350 "),
        ("tool_speed_m_s: 0.25 ", "tool_speed_m_s: 1.0 "),
        ("tool_acceleration_m_s2: 1.0 ", "tool_acceleration_m_s2: 5 "),
    ];
    let text = fast.iter().fold(CELL.to_string(), |text, (from, to)| replace_once(&text, from, to));
    assert!(cell(&text).is_ok(), "{}", cell(&text).unwrap_err());
}

#[test]
fn parts_that_do_not_fit_are_reported() {
    let reported =
        cell(&replace_once(CELL, "host: 127.0.0.2}", "host: 192.168.1.20}")).unwrap_err().to_string();
    assert!(reported.contains("simulation: the robot is at \"192.168.1.20\""), "{reported}");
    let real = replace_once(CELL, "simulation: {clock_factor: 1}", "simulation: null");
    assert!(cell(&real).is_ok());
    let reported =
        cell(&replace_once(&real, "arm_at_start: false", "arm_at_start: true")).unwrap_err().to_string();
    assert!(reported.contains("only a simulated cell may be armed at start"), "{reported}");
    check("id: 1, size: 0.036", "id: 0, size: 0.036", "marker 0 is used twice");
    check("id: 500, size", "id: 3, size", "marker 3 is also that of object \"lid\"");
    check("{id: 501, size", "{id: 500, size", "marker 500 is used twice");
    check("id: 2, size: 0.05,", "id: 2, size: 0.07,", "sticks out over the object");
    check(
        "rectangle: {length: 0.08, width: 0.08}",
        "rectangle: {length: 0.8, width: 0.08}",
        "larger than the table",
    );
    check("mass: 0.12", "mass: 3", "its cups hold");
    let at_rest = 0.3 * 101_325.0 * std::f64::consts::PI * 0.01 * 0.01 / (4.0 * 9.81);
    check("mass: 0.12", &format!("mass: {at_rest:.3}"), "its cups hold");
    check("    mass: 0.12\n", "    mass: 0.12\n    fixed: true\n", "has no pose");
    let reported = cell(&replace_once(CELL, "diameter: 0.02", "diameter: 0.06")).unwrap_err().to_string();
    assert!(
        reported.contains("no place on \"plank-1\"") && !reported.contains("no place on \"block\""),
        "{reported}"
    );
    check("blend_m: 0.03 ", "blend_m: 0.05 ", "rounds the corner");
    check("    mass: 0.12\n", "", "has no mass (kg)");
    check("park_pose_deg: [-91.7", "park_pose_deg: [361", "joint 1 at 361.0 degrees is outside its range");
    let reported =
        cell(&replace_once(CELL, "keep_out: []", "keep_out: []\nkeep_ut: []")).unwrap_err().to_string();
    assert!(reported.contains("keep_ut: unknown key; did you mean \"keep_out\"?"), "{reported}");
}

#[test]
fn a_catalogue_in_a_file_is_judged_with_its_own_places() {
    let start = CELL.find("objects:\n").unwrap();
    let end = CELL.find("# Markers fixed to the table round").unwrap();
    let with = |objects: &str| format!("{}{objects}\n{}", &CELL[..start], &CELL[end..]);
    let reported = cell(&with("objects: {file: objects.yaml}")).unwrap_err().to_string();
    assert!(reported.contains("/etc/celld/objects.yaml:2:") && reported.contains("radius"), "{reported}");
    assert!(!reported.contains("cell.yaml:"), "nothing is wrong with that file: {reported}");
    let reported = cell(&with("objects: {file: none.yaml}")).unwrap_err().to_string();
    assert!(reported.contains("no such file"), "{reported}");
}

#[test]
fn what_could_never_work_is_refused() {
    check(
        "table: ../calibration/sim/table.yaml",
        "table: ../calibration/sim/camera.yaml",
        "the same file as",
    );
    check("ignore_markers: []", "ignore_markers: [586, 0]", "0 is the marker of \"plank-1\"");
    check("ignore_markers: []", "ignore_markers: [500]", "500 is a reference marker");
    check("page: {listen: 127.0.0.1:8737}", "page: {listen: '127.0.0.1:0'}", "is no address with a port");
    check("host: 127.0.0.2, port: 8090", "host: 127.0.0.256, port: 8090", "is not a host name or address");
    check("mass: 0.12", "mass: 1e300", "out of range");
    check("    height: 0.03\n    mass: 0.12", "    height: 300\n    mass: 0.12", "out of range");
    let start = CELL.find("objects:\n").unwrap();
    let end = CELL.find("# Markers fixed to the table round").unwrap();
    let none = format!("{}objects: []\n{}", &CELL[..start], &CELL[end..]);
    assert!(cell(&none).unwrap_err().to_string().contains("no object is given"));
}

#[test]
fn a_wrong_key_hides_no_fault_elsewhere() {
    let changes = [
        ("height: 0.02\n", "height: 20 mm\n"),
        ("{id: 501, size", "{id: 500, size"),
        ("{id: 502, size: 0.03", "{id: 0, size: wide"),
        ("joint_speed_deg_s: 60 ", "joint_speed_deg_s: fast "),
        ("work_pose_deg: [-91.7", "work_pose_deg: [361"),
        ("id: 2, size: 0.05,", "id: 2, size: 0.07,"),
    ];
    let text = changes.iter().fold(CELL.to_owned(), |text, (from, to)| replace_first(&text, from, to));
    let reported = cell(&text).unwrap_err();
    for wanted in [
        "objects[0].height: \"20 mm\" is not a number",
        "reference_markers[1].id: marker 500 is used twice",
        "reference_markers[2].id: marker 0 is also that of object \"plank-1\"",
        "reference_markers[2].size: \"wide\" is not a number",
        "limits.joint_speed_deg_s: \"fast\" is not a number",
        "work_pose_deg: joint 1 at 361.0 degrees is outside its range",
        "objects[2]: the marker of \"block\" with its white ring is 87.5 mm wide and sticks out",
    ] {
        assert!(reported.to_string().contains(wanted), "{wanted}:\n{reported}");
    }
    assert_eq!(reported.0.len(), 7, "{reported}");
}

#[test]
fn a_fixed_camera_names_the_board_on_the_hand() {
    let with = |board: &str| {
        let fixed = format!("mount: fixed\n  board: {{{board}}}\n  base_from");
        cell(&replace_once(CELL, "mount: flange\n  flange_from", &fixed))
    };
    let fixed = with("columns: 5, rows: 4, size: 0.02, first_id: 100").unwrap();
    let CameraMount::Fixed { board, flange_from_board, .. } = fixed.camera else {
        panic!("{:?}", fixed.camera)
    };
    assert_eq!((board.count(), board.first_id, flange_from_board), (20, 100, None));
    assert!((board.gap_m - 0.006).abs() < 1e-12, "as celld markers prints it");
    let reported = |board: &str| with(board).unwrap_err().to_string();
    assert!(reported("columns: 5, rows: 4, size: 0.02, first_id: 495").contains("marker 500 of the board"));
    assert!(
        reported("columns: 5, rows: 4, size: 0.02").contains("marker 0 of the board is also on the table")
    );
    assert!(reported("columns: 5, rows: 4, size: 20, first_id: 100").contains("20 m is out of range"));
    assert!(reported("columns: 5, rows: 4, size: 0.02, first_id: 570").contains("not in the family"));

    let clamped = |how: &str| {
        with(&format!("columns: 5, rows: 4, size: 0.02, first_id: 100}}\n  flange_from_board: {{{how}"))
    };
    let known = clamped("translation: [0.05, 0.04, 0.03], quaternion: [1, 0, 0, 0]").unwrap();
    let CameraMount::Fixed { flange_from_board: Some(held), .. } = known.camera else {
        panic!("{:?}", known.camera)
    };
    assert_eq!(held.translation.vector, nalgebra::Vector3::new(0.05, 0.04, 0.03));
    let reported = |how: &str| clamped(how).unwrap_err().to_string();
    assert!(
        reported("translation: [0, 0, 0], quaternion: [0, 0, 0, 2]").contains("camera.flange_from_board")
    );
    assert!(reported("translation: [0, 0], quaternion: [1, 0, 0, 0]").contains("2 values, 3 are wanted"));
    let on_the_hand = replace_once(CELL, "mount: flange\n", "mount: flange\n  flange_from_board: {}\n");
    assert!(cell(&on_the_hand).unwrap_err().to_string().contains("flange_from_board"));
}

#[test]
fn a_camera_that_stands_is_compared_with_the_empty_table_from_one_look_pose() {
    let stands = "mount: fixed\n  board: {columns: 5, rows: 4, size: 0.02, first_id: 100}\n  base_from";
    let fixed = replace_once(CELL, "mount: flange\n  flange_from", stands);
    let compared = |text: &str| replace_once(text, "sim/table.yaml}", "sim/table.yaml, empty: ../empty}");
    assert!(cell(&compared(CELL)).is_ok() && cell(&fixed).is_ok());
    let reported = cell(&compared(&fixed)).unwrap_err();
    assert_eq!(reported.0.len(), 1, "{reported}");
    assert!(
        reported.to_string().contains("look_poses_deg: 2 look poses before a camera that stands"),
        "{reported}"
    );
    let second = "  - [-106.6, -96.2, 97.0, -90.8, -90.0, -16.6]\n";
    assert!(cell(&compared(&replace_once(&fixed, second, ""))).is_ok());
}

#[test]
fn places_that_no_cell_has_are_out_of_range() {
    let from = CELL.find("centre_of_gravity_m: [").expect("the key") + "centre_of_gravity_m: [".len();
    let to = from + CELL[from..].find(',').expect("three numbers");
    let text = format!("{}-1e308{}", &CELL[..from], &CELL[to..]);
    let reported = cell(&text).unwrap_err();
    assert_eq!(reported.0.len(), 1, "{reported}");
    assert!(reported.to_string().contains("out of range") && reported.to_string().contains("-1 and 1 m"));
    let text = replace_once(CELL, "low: [-0.40, 0.12, 0.25]", "low: [-0.40, 1e9, 0.25]");
    assert!(cell(&text).unwrap_err().to_string().contains("out of range"));
}

#[test]
fn a_box_may_be_taught_by_its_corners() {
    let corners = "{corners_deg: [[-121.6, -128.7, 116.1, -77.4, -90, -31.6], [-77.4, -70.1, 64.8, -55.1, -109.6, 40.8], \
                   [-91.7, -91.7, 108.9, -108.9, -90, 0]]}";
    let text = replace_once(CELL, "{low: [-0.40, 0.12, 0.25], high: [0.40, 0.70, 0.75]}", corners);
    let found = cell(&text).unwrap().calibration_box.unwrap();
    // Where the drawing's arm has its flange in those poses.
    for (found, wanted) in
        found.low_m.iter().chain(&found.high_m).zip([-0.223, 0.254, 0.375, 0.0, 0.540, 0.480])
    {
        assert!((found - wanted).abs() < 1e-3, "{found} {wanted}");
    }
    let one = replace_once(
        CELL,
        "{low: [-0.40, 0.12, 0.25], high: [0.40, 0.70, 0.75]}",
        "{corners_deg: [[-121.6, -128.7, 116.1, -77.4, -90, -31.6]]}",
    );
    assert!(cell(&one).unwrap_err().to_string().contains("at least two opposite corners"));
}

/// The daemon grips with all cups at once, so a second channel that reaches over the objects is no help.
#[test]
fn all_cups_have_to_sit_on_an_object() {
    let far = "cups: [{channel: A, x: 0, y: 0, diameter: 0.02}, {channel: B, x: 0.2, y: 0, diameter: 0.02}]";
    let text = replace_once(CELL, "cups: [{channel: A, x: 0, y: 0, diameter: 0.02}]", far);
    let reported = cell(&text).unwrap_err();
    assert_eq!(reported.0.len(), 4, "{reported}");
    assert!(
        reported.to_string().contains("no place on \"lid\" takes all 2 cups with 1 mm to spare"),
        "{reported}"
    );
    let near = replace_once(&text, "x: 0.2, y: 0,", "x: 0.025, y: 0,");
    assert!(cell(&near).is_ok());
}

#[test]
fn goals_may_overlap_by_what_the_camera_cannot_resolve() {
    let text = replace_once(CELL, "goal_position_m: 0.002 ", "goal_position_m: 0.1 ");
    let cell = cell(&text).unwrap();
    let allowed_m = cell.goal_context(&[]).overlap_tolerance_m;
    assert!((0.0005..=0.0015).contains(&allowed_m), "{allowed_m} m");
}
