//! Tests of the calibration commands on rendered pictures: what is written, and what is refused with which
//! words.

use super::*;
use crate::bench::vision::calibrated::{bench_board, board_picture};
use crate::bench::vision::scene::bench_camera;
use crate::config::calibrated::read_calibration;
use crate::config::pictures::read_camera;
use crate::config::setup::reference_markers;
use crate::jobs::edit::{replace_once, replace_times};
use camera::{CameraArgs, calibrate};
use cell_calibration::files::set::CalibrationSet;
use cell_calibration::fit::Sample;
use nalgebra::Isometry3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::path::PathBuf;
use vision_pictures::render::Lens;

fn camera_args(images: &Path, out: &Path) -> CameraArgs {
    CameraArgs {
        images: Some(images.to_path_buf()),
        config: None,
        save: None,
        count: 0,
        board: [7, 5],
        family: cell_vision::detect::Family::Tag36h11,
        first_id: 0,
        size_mm: 30.0,
        gap_mm: None,
        serial: Some("bench".into()),
        drop: vec![],
        out: Some(out.to_path_buf()),
    }
}

#[test]
fn a_folder_of_board_pictures_becomes_a_lens_file() {
    let folder = tempfile::tempdir().unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(8);
    let lens = Lens::new(bench_camera(), &mut random);
    for number in 0..24 {
        let (picture, _) = board_picture(&lens, &bench_board(), &mut random);
        let name = folder.path().join(format!("{number:02}.png"));
        std::fs::write(name, picture.encode_png().unwrap()).unwrap();
    }
    let out = folder.path().join("new/camera.yaml");
    let args = camera_args(folder.path(), &out);
    calibrate(&CameraArgs { drop: vec!["03.png".into()], ..args.clone() }).unwrap();
    let text = std::fs::read_to_string(&out).unwrap();
    let found = CameraCalibration::parse(&text, "camera.yaml").unwrap();
    assert_eq!((found.model.serial.as_str(), found.measured.as_ref().unwrap().samples.len()), ("bench", 23));
    assert!((found.model.fx / 650.0 - 1.0).abs() < 2e-3, "{text}");
    assert!(found.reprojection_px.unwrap() < 0.3 && found.source.contains("7x5"));
    // Another board: its markers are not there.
    let reported = calibrate(&CameraArgs { first_id: 300, ..args.clone() }).unwrap_err();
    assert!(reported.code == 1 && reported.message.contains("--first-id"), "{reported:?}");
    let reported = calibrate(&CameraArgs { drop: vec!["99.png".into()], ..args.clone() }).unwrap_err();
    assert!(reported.code == 2 && reported.message.contains("--drop 99.png"), "{reported:?}");
    // A picture cut short, and one of another size.
    let bytes = std::fs::read(folder.path().join("05.png")).unwrap();
    std::fs::write(folder.path().join("05.png"), &bytes[..bytes.len() / 2]).unwrap();
    let reported = calibrate(&args).unwrap_err();
    assert!(reported.code == 2 && reported.message.contains("05.png"), "{reported:?}");
    let other = cell_values::image::Image::filled(640, 480, [9; 3]).encode_png().unwrap();
    std::fs::write(folder.path().join("05.png"), other).unwrap();
    assert!(calibrate(&args).unwrap_err().message.contains("640 x 480"));
}

#[test]
fn a_folder_without_pictures_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let args = camera_args(folder.path(), &folder.path().join("camera.yaml"));
    assert!(calibrate(&args).unwrap_err().message.contains("no PNG or JPEG"));
    assert!(
        calibrate(&camera_args(&folder.path().join("gone"), Path::new("x")))
            .unwrap_err()
            .message
            .contains("gone")
    );
}

/// The example cell, its calibration files copied to a folder of their own.
fn cell(folder: &Path) -> CellConfig {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut config = load_cell(&root.join("config/cell.yaml")).unwrap();
    let calibration = &mut config.calibration;
    for path in [&mut calibration.camera, &mut calibration.hand_eye, &mut calibration.table] {
        let to = folder.join(path.file_name().unwrap());
        std::fs::copy(&*path, &to).unwrap();
        *path = to;
    }
    config
}

fn flange_from_camera(set: &CalibrationSet) -> Isometry3<f64> {
    set.hand_eye.mount.base_from_camera(&Isometry3::identity())
}

fn args_of(round: &Path, drop: Vec<usize>) -> RoundArgs {
    let registration =
        touch::RegistrationArgs { touches: None, drop_touch: vec![], tie_mm: 1.0, tie_deg: 0.2 };
    RoundArgs { config: PathBuf::new(), from: Some(round.to_path_buf()), record: None, drop, registration }
}

/// A round over the example cell's reference markers, rendered through its own lens; returns the mount and
/// table it was taken with.
fn record(config: &CellConfig, folder: &Path) -> [Isometry3<f64>; 2] {
    use crate::bench::vision::scene::{DEGRADE, looking_down};
    use cell_vision::detect::Family;
    use vision_pictures::render::{Ground, Print, render};
    let set = read_calibration(config).unwrap();
    let [mount, table] = [flange_from_camera(&set), set.table.base_from_table];
    let mut random = ChaCha8Rng::seed_from_u64(2);
    let lens = Lens::new(set.camera.model.clone(), &mut random);
    let prints: Vec<Print> = reference_markers(config)
        .iter()
        .map(|marker| Print {
            pattern: Family::Tag36h11.pattern(marker.id).unwrap(),
            size_m: marker.size,
            table_from_marker: marker.pose.at_height(0.0),
            greys: [35.0, 215.0],
            rim: (0.002, 150.0),
        })
        .collect();
    let recording = Recording::new(folder).unwrap();
    for pose in 1..=10 {
        let t = f64::from(pose as u32);
        let tilt = [0.3 * (1.7 * t).sin(), 0.3 * (2.3 * t + 0.5).cos()];
        let mut table_from_camera = looking_down([0.0, 0.0], 0.0, tilt, 0.5 * (0.7 * t).sin());
        let back = table_from_camera.rotation * nalgebra::Vector3::new(0.0, 0.0, -0.62);
        table_from_camera.translation.vector = nalgebra::Vector3::new(0.25, 0.25, 0.0) + back;
        let picture = render(&lens, &table_from_camera, &Ground::Plain(140.0), &prints, DEGRADE, &mut random);
        let base_from_flange = table * table_from_camera * mount.inverse();
        let sample = Sample { base_from_flange, detections: vec![] };
        recording.keep(&Stop { pose, image: &picture.to_image(), sample: &sample });
    }
    recording.close(&set.camera, &set.hand_eye.provenance).unwrap();
    [mount, table]
}

#[test]
fn a_recorded_round_is_solved_again_and_bad_input_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let config = cell(folder.path());
    let round = folder.path().join("round");
    let [mount, table] = record(&config, &round);
    let args = args_of(&round, vec![2]);
    let solve = |args: &RoundArgs, wanted| {
        recorded(&config, args).and_then(|taken| finish(&config, taken, args, wanted))
    };
    solve(&args, Wanted::MountAndTable).unwrap();
    let found = read_calibration(&config).unwrap();
    let off = flange_from_camera(&found).inverse() * mount;
    assert!(off.translation.vector.norm() < 5e-4 && off.rotation.angle() < 1.7e-3, "{off}");
    assert!((found.table.base_from_table.inverse() * table).translation.vector.norm() < 5e-4);
    assert_eq!(found.hand_eye.samples.len(), 9, "one was dropped");
    solve(&args, Wanted::Table).unwrap();
    let kept = read_calibration(&config).unwrap();
    assert_eq!(kept.hand_eye, found.hand_eye, "the mount is kept");
    let reported = |args: &RoundArgs| solve(args, Wanted::MountAndTable).unwrap_err();
    assert!(reported(&RoundArgs { drop: vec![40], ..args.clone() }).message.contains("samples 1 to 10"));
    let few = reported(&RoundArgs { drop: (1..=8).collect(), ..args.clone() });
    assert!(few.code == 1 && few.message.contains("only 2 of 10 samples"), "{few:?}");
    let gone = RoundArgs { from: Some(folder.path().join("gone")), ..args.clone() };
    assert!(reported(&gone).message.contains("--record"));
    std::fs::remove_file(&config.calibration.hand_eye).unwrap();
    assert!(solve(&args, Wanted::Table).unwrap_err().message.contains("calibrate hand-eye"));
    // Intrinsics of another camera beside the pictures.
    let lens = std::fs::read_to_string(round.join("camera.yaml")).unwrap();
    std::fs::write(round.join("camera.yaml"), replace_once(&lens, "serial: sim-d405", "serial: other"))
        .unwrap();
    assert!(reported(&args).message.contains("recorded with camera sim-d405"));
    // And of another size.
    let small = replace_once(&lens, "width: 1280", "width: 1290");
    std::fs::write(round.join("camera.yaml"), small).unwrap();
    std::fs::remove_file(&config.calibration.camera).unwrap();
    assert!(reported(&args).message.contains("01.png: the picture is 1280 x 720"));
}

/// A round before a camera fixed over the example cell's table: the hand carries the board through its
/// picture.
fn record_fixed(config: &CellConfig, folder: &Path) -> [Isometry3<f64>; 2] {
    use crate::bench::vision::scene::DEGRADE;
    use cell_calibration::drawn::CameraMount;
    use cell_calibration::fit::fixed::board_markers;
    use cell_vision::detect::Family;
    use nalgebra::{Translation3, UnitQuaternion, Vector3};
    use vision_pictures::render::{Ground, Print, render};
    let CameraMount::Fixed { base_from_camera, board, .. } = config.camera else { panic!("fixed") };
    let text = std::fs::read_to_string(&config.calibration.camera).unwrap();
    let camera = CameraCalibration::parse(&text, "camera.yaml").unwrap();
    let text = std::fs::read_to_string(&config.calibration.table).unwrap();
    let flat = cell_calibration::files::table::TableCalibration::parse(&text, "table.yaml").unwrap();
    let (table, provenance) = (flat.base_from_table, flat.provenance);
    let base_from_camera =
        base_from_camera * Isometry3::new(Vector3::new(0.004, -0.006, 0.01), Vector3::new(0.02, -0.01, 0.03));
    let table_from_camera = table.inverse() * base_from_camera;
    let flange_from_board =
        Isometry3::new(Vector3::new(-0.05, 0.04, -0.02), Vector3::new(std::f64::consts::PI, 0.02, 0.0));
    let mut random = ChaCha8Rng::seed_from_u64(2);
    let lens = Lens::new(camera.model.clone(), &mut random);
    let print = |id, size_m, table_from_marker| Print {
        pattern: Family::Tag36h11.pattern(id).unwrap(),
        size_m,
        table_from_marker,
        greys: [35.0, 215.0],
        rim: (0.0005, 215.0),
    };
    let recording = Recording::new(folder).unwrap();
    for pose in 1..=12 {
        let t = f64::from(pose as u32);
        let turn = Vector3::new(0.35 * (1.7 * t).sin(), 0.35 * (2.3 * t + 0.5).cos(), 0.4 * (0.7 * t).sin());
        let facing = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let at = Vector3::new(-0.06 + 0.04 * t.sin(), 0.05 + 0.03 * (1.3 * t).cos(), 0.55 + 0.04 * t.cos());
        let camera_from_board =
            Isometry3::from_parts(Translation3::from(at), UnitQuaternion::from_scaled_axis(turn) * facing);
        let table_from_board = table_from_camera * camera_from_board;
        let flat = reference_markers(config);
        let flat = flat.iter().map(|m| print(m.id, m.size, m.pose.at_height(0.0)));
        let held = board_markers(&board);
        let held = held.iter().map(|m| print(m.id, m.size, table_from_board * m.pose.at_height(0.0)));
        let prints: Vec<Print> = flat.chain(held).collect();
        let picture = render(&lens, &table_from_camera, &Ground::Plain(140.0), &prints, DEGRADE, &mut random);
        let base_from_flange = base_from_camera * camera_from_board * flange_from_board.inverse();
        let sample = Sample { base_from_flange, detections: vec![] };
        recording.keep(&Stop { pose, image: &picture.to_image(), sample: &sample });
    }
    recording.close(&camera, &provenance).unwrap();
    [base_from_camera, table]
}

#[test]
fn a_camera_over_the_table_is_calibrated_by_the_board_on_the_hand() {
    use cell_calibration::drawn::CameraMount;
    use cell_vision::board::Board;
    use cell_vision::detect::Family;
    let folder = tempfile::tempdir().unwrap();
    let mut config = cell(folder.path());
    let over = crate::bench::vision::scene::looking_down([0.25, 0.25], 0.95, [0.03, -0.02], 0.0);
    let board = Board::new(Family::Tag36h11, 4, 3, 0.03, 100);
    config.camera = CameraMount::Fixed {
        base_from_camera: config.base_from_table * over,
        board,
        flange_from_board: None,
    };
    assert!(
        read_calibration(&config).unwrap_err().contains("made with mount flange, now it is fixed"),
        "the files of the camera on the hand are not this one's"
    );
    let round = folder.path().join("round");
    let [camera, table] = record_fixed(&config, &round);
    let solve = |args: &RoundArgs, wanted| {
        recorded(&config, args).and_then(|taken| finish(&config, taken, args, wanted))
    };
    let reported = solve(&args_of(&round, vec![]), Wanted::Table).unwrap_err();
    assert!(reported.message.contains("made with `mount: flange`"), "{reported:?}");
    solve(&args_of(&round, vec![3]), Wanted::MountAndTable).unwrap();
    let found = read_calibration(&config).unwrap();
    let text = std::fs::read_to_string(&config.calibration.hand_eye).unwrap();
    assert!(text.contains("mount: fixed") && text.contains("base_from_camera"), "{text}");
    let anywhere = Isometry3::translation(1.0, 2.0, 3.0);
    let off = found.hand_eye.mount.base_from_camera(&anywhere).inverse() * camera;
    println!("camera off by {off}");
    assert!(off.translation.vector.norm() < 1e-3 && off.rotation.angle() < 2e-3, "{off}");
    let off = found.table.base_from_table.inverse() * table;
    assert!(off.translation.vector.norm() < 1e-3 && off.rotation.angle() < 2e-3, "{off}");
    assert_eq!(found.hand_eye.samples.len(), 11, "one was dropped");
    solve(&args_of(&round, vec![]), Wanted::Table).unwrap();
    let kept = read_calibration(&config).unwrap();
    assert_eq!(kept.hand_eye, found.hand_eye, "the camera's place is kept");
    // The board is not there, or another one.
    if let CameraMount::Fixed { board, .. } = &mut config.camera {
        board.first_id = 200;
    }
    let reported = recorded(&config, &args_of(&round, vec![]))
        .and_then(|taken| finish(&config, taken, &args_of(&round, vec![]), Wanted::MountAndTable))
        .unwrap_err();
    assert!(reported.code == 1 && reported.message.contains("show the board on the hand"), "{reported:?}");
}

#[test]
fn a_table_is_tied_to_touches_of_this_robot_and_survey() {
    use cell_calibration::files::touches::{Place, RecordedTouch, Spot, Target, Touches};
    let folder = tempfile::tempdir().unwrap();
    let config = cell(folder.path());
    let round = folder.path().join("round");
    let [_, table] = record(&config, &round);
    let provenance = read_calibration(&config).unwrap().hand_eye.provenance;
    let survey = reference_markers(&config);
    let touch = |id: u32, at: Spot, off_m: f64| {
        let target = Target::Marker { id, at };
        let tip = table * target.on_table(&survey).unwrap() + nalgebra::Vector3::new(off_m, 0.0, -off_m);
        RecordedTouch { target, place: Place::Tip([tip.x, tip.y, tip.z]) }
    };
    let touches = Touches {
        robot_serial: provenance.robot_serial,
        kinematics_checksum: provenance.kinematics_checksum,
        date: "2026-11-21".into(),
        flange_from_tip_m: None,
        touches: vec![
            touch(500, Spot::Centre, 1e-4),
            touch(501, Spot::LowerLeft, -1e-4),
            touch(503, Spot::UpperRight, 0.0),
            touch(502, Spot::Centre, 1e-4),
            touch(505, Spot::Centre, 0.009),
        ],
    };
    let path = folder.path().join("touches.yaml");
    std::fs::write(&path, touches.to_yaml()).unwrap();
    let mut args = args_of(&round, vec![]);
    args.registration.touches = Some(path.clone());
    let solve = |args: &RoundArgs| {
        recorded(&config, args).and_then(|taken| finish(&config, taken, args, Wanted::MountAndTable))
    };
    let before = std::fs::read_to_string(&config.calibration.table).unwrap();
    let reported = solve(&args).unwrap_err();
    assert!(reported.code == 1 && reported.message.contains("touch 5 by"), "{reported:?}");
    args.registration.drop_touch = vec![5];
    let reported = solve(&RoundArgs {
        registration: touch::RegistrationArgs { tie_mm: 1e-3, ..args.registration.clone() },
        ..args.clone()
    });
    assert!(reported.unwrap_err().message.contains("touch and camera disagree"));
    let reported = solve(&RoundArgs {
        registration: touch::RegistrationArgs { drop_touch: vec![6], ..args.registration.clone() },
        ..args.clone()
    });
    assert!(reported.unwrap_err().message.contains("touches 1 to 5"));
    assert_eq!(std::fs::read_to_string(&config.calibration.table).unwrap(), before, "nothing was written");
    solve(&args).unwrap();
    let found = read_calibration(&config).unwrap();
    assert_eq!(found.table.touches.unwrap().residuals_m.len(), 4);
    assert!((found.table.base_from_table.inverse() * table).translation.vector.norm() < 5e-4);
    let other = replace_once(&touches.to_yaml(), "robot_serial: ", "robot_serial: other");
    std::fs::write(&path, other).unwrap();
    assert!(solve(&args).unwrap_err().message.contains("touched with robot"));
}

/// Touches of markers of the example cell by its robot, each so far off its marker along x, m.
fn touches_of(config: &CellConfig, provenance: &Provenance, touched: &[(u32, f64)]) -> String {
    use cell_calibration::files::touches::{Place, RecordedTouch, Spot, Target, Touches};
    let survey = reference_markers(config);
    let touch = |&(id, off_m): &(u32, f64)| {
        let target = Target::Marker { id, at: Spot::Centre };
        let at = target.on_table(&survey).map_or([0.0; 3], |at| [at.x + off_m, at.y, at.z]);
        RecordedTouch { target, place: Place::Tip(at) }
    };
    let touches = Touches {
        robot_serial: provenance.robot_serial.clone(),
        kinematics_checksum: provenance.kinematics_checksum.clone(),
        date: "2026-11-21".into(),
        flange_from_tip_m: None,
        touches: touched.iter().map(touch).collect(),
    };
    touches.to_yaml()
}

fn tie_to(touches: &Path, drop_touch: &[usize]) -> touch::RegistrationArgs {
    let touches = Some(touches.to_path_buf());
    touch::RegistrationArgs { touches, drop_touch: drop_touch.to_vec(), tie_mm: 1.0, tie_deg: 0.2 }
}

/// Four corners of the table, touched where they are.
const FOUR: [(u32, f64); 4] = [(500, 0.0), (501, 0.0), (503, 0.0), (502, 0.0)];

/// What is touched and left out, the exit code, and words of the reason.
type UnfitTouches = (&'static [(u32, f64)], &'static [usize], u8, &'static str);

const UNFIT_TOUCHES: [UnfitTouches; 5] = [
    (&[(500, 0.0), (501, 0.0), (77, 0.0)], &[], 2, "77"),
    (&FOUR, &[5], 2, "touches 1 to 4"),
    (&FOUR, &[1, 2], 1, "at least 3 are needed"),
    (&[(500, 0.0), (504, 0.0), (508, 0.0), (501, 0.0)], &[], 1, "on one line"),
    (&[(500, 0.0), (501, 0.0), (503, 0.0), (502, 0.02)], &[], 1, "miss their points"),
];

#[test]
fn touches_that_cannot_place_the_table_are_reported_before_anything_moves() {
    let folder = tempfile::tempdir().unwrap();
    let config = cell(folder.path());
    let path = folder.path().join("touches.yaml");
    let provenance = read_calibration(&config).unwrap().hand_eye.provenance;
    // No server listens at these addresses: querying a device first would end with another code.
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(root.join("config/cell.yaml")).unwrap();
    let file = folder.path().join("cell.yaml");
    std::fs::write(&file, replace_times(&text, "127.0.0.2", "127.7.1.16", 3)).unwrap();
    for (touched, dropped, code, words) in UNFIT_TOUCHES {
        std::fs::write(&path, touches_of(&config, &provenance, touched)).unwrap();
        let registration = tie_to(&path, dropped);
        let reported = registration.fitted(&config).unwrap_err();
        assert!(reported.code == code && reported.message.contains(words), "{reported:?}");
        let args = RoundArgs { config: file.clone(), from: None, record: None, drop: vec![], registration };
        assert_eq!(round(&args, Wanted::Table, None, Arc::default()), code, "{words}");
    }
}

#[test]
fn touches_and_mount_of_another_robot_are_reported_before_anything_moves() {
    let folder = tempfile::tempdir().unwrap();
    let config = cell(folder.path());
    let path = folder.path().join("touches.yaml");
    let provenance = read_calibration(&config).unwrap().hand_eye.provenance;
    std::fs::write(&path, touches_of(&config, &provenance, &FOUR)).unwrap();
    let registration = tie_to(&path, &[]);
    let fitted = registration.fitted(&config).unwrap().unwrap();
    fitted.check_robot(&provenance).unwrap();
    let other = Provenance { robot_serial: "other".into(), ..provenance.clone() };
    assert!(fitted.check_robot(&other).unwrap_err().to_string().contains("touched with robot"));
    // The arm and the camera answer: then what was made with others is reported, and the mount too.
    let args = RoundArgs { registration, ..args_of(Path::new("."), vec![]) };
    fits_arm(&config, &args, Wanted::Table, &provenance).unwrap();
    assert!(fits_arm(&config, &args, Wanted::MountAndTable, &other).unwrap_err().message.contains("touched"));
    std::fs::remove_file(&config.calibration.hand_eye).unwrap();
    assert!(fits_arm(&config, &args, Wanted::Table, &provenance).unwrap_err().message.contains("hand-eye"));
}

#[test]
fn a_round_that_breaks_off_leaves_no_old_poses_with_its_pictures() {
    let folder = tempfile::tempdir().unwrap();
    let poses = folder.path().join("samples.yaml");
    std::fs::write(&poses, "of another round").unwrap();
    drop(Recording::new(folder.path()).unwrap());
    assert!(!poses.exists());
}

#[test]
fn a_broken_lens_file_is_refused_and_not_written_over() {
    let folder = tempfile::tempdir().unwrap();
    let config = cell(folder.path());
    let own = read_camera(&config.calibration.camera).unwrap();
    assert!(lens_for(&config, own.clone()).is_ok());
    std::fs::write(&config.calibration.camera, "serial: [").unwrap();
    let reported = lens_for(&config, own).unwrap_err();
    assert!(reported.contains("camera.yaml:"), "{reported}");
}
