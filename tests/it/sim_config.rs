//! The simulator's example configuration: it is sound, fits the example cell, and every kind of mistake in
//! it is named with its place.

use crate::edit::{replace_first, replace_once};
use celld::config::load::load_cell;
use std::path::Path;
use ur_sim::config::SimMount;
use ur_sim::config::load::load_sim;
use ur_sim::config::read::{DEFAULT_ERRORS, SIM_KEYS, read_sim};
use ur_sim::controller::program_files::ProgramSource;

const SIM: &str = include_str!("../../config/sim.yaml");

#[test]
fn the_example_simulation_is_sound_and_fits_the_cell() {
    let sim = read_sim(SIM, "sim.yaml").unwrap_or_else(|complaints| panic!("{complaints}"));
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/cell.yaml");
    let cell = load_cell(&path).unwrap();
    assert_eq!(sim.errors, DEFAULT_ERRORS);
    assert_eq!(sim.reference_markers, cell.reference_markers);
    assert_eq!(sim.gripper, cell.gripper);
    assert_eq!(sim.base_from_table, cell.base_from_table);
    assert_eq!(sim.flange_from_tool, cell.flange_from_tool);
    assert_eq!(
        (sim.bind.as_str(), sim.ports.modbus),
        (cell.devices.robot_host.as_str(), cell.devices.gripper_port)
    );
    for (simulated, known) in sim.objects.iter().zip(&cell.objects) {
        assert_eq!((&simulated.id, &simulated.footprint), (&known.id, &known.footprint));
        assert_eq!((simulated.height, &simulated.marker), (known.height, &known.marker));
        assert!(sim.start_of(&known.id).is_some());
    }
}

/// Every key is explained in the example, which shows every key.
#[test]
fn the_example_shows_and_comments_every_key() {
    for key in SIM_KEYS {
        // One that excludes another is shown as a comment.
        let has_key = |line: &str| line.strip_prefix("# ").unwrap_or(line).starts_with(&format!("{key}:"));
        assert!(SIM.lines().any(has_key), "{key} is not shown");
    }
}

/// Changes one thing in the example simulation and expects one complaint that begins with `expected`.
#[track_caller]
fn check_sim(from: &str, to: &str, expected: &str) {
    let Err(complaints) = read_sim(&replace_first(SIM, from, to), "sim.yaml") else {
        panic!("{to} is sound")
    };
    let reported = complaints.to_string();
    assert_eq!(complaints.0.len(), 1, "{reported}");
    assert!(reported.contains(expected), "{reported}");
}

#[test]
fn parts_of_a_simulation_that_do_not_fit_are_reported() {
    check_sim("{id: 501, size", "{id: 0500, size", "reference_markers[1].id: marker 500 is used twice");
    check_sim("{id: 501, size", "{id: 2, size", "marker 2 is also that of object \"block\"");
    check_sim(
        "[0.34, 0.14, -60]",
        "[0.12, 0.14, -60]",
        "objects[1].start: \"plank-2\" overlaps \"plank-1\" by",
    );
    check_sim("[0.36, 0.38, 0]", "[0.36, 0.48, 0]", "\"lid\" reaches over the table's edge by 25.000 mm");
    check_sim("bind: 127.0.0.2", "bind: localhost", "bind: \"localhost\" is not an IP address");
    check_sim("noise_levels: 2.0", "noise_levels: 0", "noise_levels: 0 grey levels is out of range");
}

#[test]
fn the_simulated_camera_may_stand_and_the_hand_carry_a_board() {
    let place = "{translation: [0, 0.43, 0.75], quaternion: [1, 0, 0, 0]}";
    let with = |camera: &str, board: &str| {
        let flange = "flange_from_camera: {translation: [0, -0.07, 0.03], quaternion: [0, 0, 0, 1]}";
        let held = format!("hand_board: {{board: {{{board}}}, flange_from_board: {place}}}");
        read_sim(&replace_once(SIM, flange, &format!("{camera}\n{held}")), "sim.yaml")
    };
    let (stands, grid) = (format!("base_from_camera: {place}"), "columns: 5, rows: 4, size: 0.02");
    // As the example has it in its comments.
    let text = replace_once(SIM, "flange_from_camera:", "# flange:");
    let text = replace_once(&text, "# base_from_camera:", "base_from_camera:");
    let mut text = replace_once(&text, "# hand_board:", "hand_board:");
    for key in ["  board:", "  flange_from_board:"] {
        text = replace_once(&text, &format!("# {key}"), key);
    }
    let read = read_sim(&text, "sim.yaml").unwrap();
    let held = read.hand_board.unwrap();
    assert_eq!((held.board.columns * held.board.rows, held.board.first_id), (20, 100));
    let SimMount::Fixed(base_from_camera) = read.camera else { panic!("{:?}", read.camera) };
    assert_eq!(base_from_camera.translation.z, 0.75);
    assert_eq!(with(&stands, &format!("{grid}, first_id: 100")).unwrap().camera, read.camera);
    let reported = |camera: &str, board: &str| with(camera, board).unwrap_err().to_string();
    assert!(reported(&stands, grid).contains("hand_board.board: marker 0 of the board is also on the table"));
    assert!(reported(&stands, "columns: 5, rows: 4, size: 0.02, first_id: 495").contains("marker 500"));
    let both = format!("{stands}\nflange_from_camera: {place}");
    assert!(reported(&both, &format!("{grid}, first_id: 100")).contains("on the flange or stands, not both"));
    assert!(reported("", &format!("{grid}, first_id: 100")).contains("flange_from_camera"));
}

#[test]
fn programs_are_the_scripts_of_the_folder_beside_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("sim.yaml");
    let text = replace_once(SIM, "\nprograms: {}", "\nprograms: {folder: mine}");
    std::fs::write(&config, text).unwrap();
    let reported = load_sim(&config).unwrap_err().to_string();
    assert!(reported.contains("mine") && reported.contains("No such file"), "{reported}");
    std::fs::create_dir(folder.path().join("mine")).unwrap();
    std::fs::write(folder.path().join("mine/pick.script"), "def pick():\nend\n").unwrap();
    std::fs::write(folder.path().join("mine/pick.urp"), [0x1f, 0x8b]).unwrap();
    let programs = load_sim(&config).unwrap().programs;
    let script = ProgramSource::Script("def pick():\nend\n".into());
    assert_eq!(programs.iter().collect::<Vec<_>>(), [("/programs/pick.urp", &script)]);
}
