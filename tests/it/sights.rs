//! What the cell sees in the closed loop, with rendered pictures, the real detector and depth: things
//! without a marker, faults of the camera, a fixed camera.
//!
//! The example cell of `config/`, calibrated as well as a round leaves it, in virtual time. What is compared
//! is the truth of the simulated world, in every frame.

use cell_calibration::drawn::CameraMount;
use cell_machine::code::Code;
use cell_machine::orders::{Approval, Order};
use cell_machine::supervisor::model::ForeignRule;
use cell_machine::supervisor::order::JobOrder;
use cell_machine::supervisor::round::RoundOrder;
use cell_machine::supervisor::status::Doing;
use cell_values::image::Image;
use cell_values::time::Duration;
use cell_values::units::Joints;
use cell_vision::board::Board;
use cell_vision::detect::Family;
use celld::config::cell::CellConfig;
use celld::config::load::load_cell;
use celld::pair::camera_view::SightKind;
use celld::pair::run::bring_up;
use celld::pair::stage::Stage;
use celld::pair::table::stage_of;
use celld::pair::{Choice, Pair};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use rearrange::geometry::pose::Pose2;
use rearrange::planning::plan::Objective;
use rearrange::planning::solver::SolverKind;
use std::path::Path;
use ur_sim::config::load::load_sim;
use ur_sim::config::{SimFile, SimMount};
use ur_sim::faults::read::read_posted;
use ur_sim::world::event::EventKind;
use ur_sim::world::lock;

const MUG: &str = r#"{"do": "world.foreign", "args":
    {"shape": "mug", "size_m": [0.08, 0.08], "height_m": 0.09, "pose": [0.23, 0.22, 0]}}"#;

/// Middle, half an edge and height of the box between the lid's start and its goal, m.
const BOX: [f64; 2] = [0.285, 0.295];
const HALF_M: f64 = 0.03;
const HEIGHT_M: f64 = 0.045;
const LID_RADIUS_M: f64 = 0.045;
const MARGIN_M: f64 = 0.01;

/// The example cell and its simulation.
fn configurations() -> Result<(CellConfig, SimFile), String> {
    let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("config");
    let cell = load_cell(&config.join("cell.yaml")).map_err(|error| error.to_string())?;
    let sim = load_sim(&config.join("sim.yaml")).map_err(|error| error.to_string())?;
    Ok((cell, sim))
}

/// A cell, armed, with pictures for eyes.
fn armed(stage: Stage) -> Result<Pair, String> {
    let choice = Choice { eye: SightKind::Pictures, ..Choice::of(1) };
    let mut pair = Pair::new(stage, choice).map_err(|error| error.to_string())?;
    assert!(bring_up(&mut pair), "the cell comes up");
    pair.order(Order::Arm);
    Ok(pair)
}

/// The example cell with this rule about things without a marker.
fn example(foreign: ForeignRule) -> Result<Pair, String> {
    let (mut cell, sim) = configurations()?;
    cell.foreign = foreign;
    armed(stage_of(&cell, &sim, 1)?)
}

fn fault(pair: &mut Pair, text: &str) -> Result<(), String> {
    for planned in read_posted(text).map_err(|complaints| complaints.to_string())? {
        pair.fault(planned).map_err(|error| error.to_string())?;
    }
    Ok(())
}

/// Wants the lid there.
fn submit(pair: &mut Pair, id: &str, [x, y]: [f64; 2]) {
    pair.submit(JobOrder {
        id: id.to_string(),
        goals: vec![("lid".to_string(), Pose2::new(x, y, 0.0))],
        objective: Objective::Pp,
        solver: SolverKind::Auto,
        time_limit: Duration::from_secs(2),
        seed: 1,
        approval: Approval::Never,
        rule: None,
        agreed: Vec::new(),
    });
}

/// Until a further job has ended; its code and its moves.
fn ended(pair: &mut Pair, mut meanwhile: impl FnMut(&Pair)) -> (Code, usize, String) {
    let before = pair.reports().len();
    let over = pair.run_until(300.0, |pair| {
        meanwhile(pair);
        pair.reports().len() > before
    });
    assert!(over, "the job ends: {:?}", pair.notices());
    pair.reports().last().map_or((Code::Aborted, 0, String::new()), |report| {
        (report.code, report.moves, report.message.clone())
    })
}

fn said(pair: &Pair, what: &str) -> bool {
    pair.notices().iter().any(|notice| notice.text.contains(what))
}

/// The number after a word in a sentence.
fn number(sentence: &str, after: &str) -> f64 {
    let digits = sentence.split(after).nth(1).unwrap_or_default();
    let digits: String = digits.chars().take_while(char::is_ascii_digit).collect();
    digits.parse().unwrap_or(f64::NAN)
}

/// A mug that is unknown to the cell keeps everything where it is, for as long as it is there.
#[test]
fn nothing_moves_while_something_without_a_marker_stands_on_the_table() {
    let mut pair = example(ForeignRule::Refuse { depth_needed: true }).unwrap();
    // There at first, and taken away while the cell looks again.
    fault(&mut pair, MUG).unwrap();
    submit(&mut pair, "one", [0.30, 0.38]);
    let seen =
        pair.run_until(60.0, |pair| said(pair, "belongs to nothing the cell knows; the arm looks again now"));
    assert!(seen, "{:?}", pair.notices());
    fault(&mut pair, r#"{"do": "clear", "args": {"fault": "world.foreign"}}"#).unwrap();
    let (code, moves, _) = ended(&mut pair, |_| ());
    assert_eq!((code, moves), (Code::Done, 1), "{:?}", pair.notices());

    // There to stay: the job ends, its message has place and height, and nothing was moved.
    fault(&mut pair, MUG).unwrap();
    submit(&mut pair, "two", [0.40, 0.38]);
    let (code, moves, message) = ended(&mut pair, |_| ());
    assert_eq!((code, moves), (Code::ForeignObject, 0), "{message}");
    for (after, truth) in [("x = ", 230.0), ("y = ", 220.0), ("something ", 90.0)] {
        assert!((number(&message, after) - truth).abs() < 8.0, "{message}");
    }

    // Taken away, work goes on.
    fault(&mut pair, r#"{"do": "clear"}"#).unwrap();
    submit(&mut pair, "three", [0.40, 0.38]);
    assert_eq!(ended(&mut pair, |_| ()).0, Code::Done);
    assert_eq!(pair.breaches(), []);
}

/// Distance of a place from the box, seen from above, m.
fn beside([x, y]: [f64; 2]) -> f64 {
    let out = |at: f64, middle: f64| ((at - middle).abs() - HALF_M).max(0.0);
    out(x, BOX[0]).hypot(out(y, BOX[1]))
}

#[test]
fn an_obstacle_without_a_marker_is_worked_round_and_nothing_comes_near_it() {
    let mut pair = example(ForeignRule::Obstacle { margin_m: MARGIN_M }).unwrap();
    let thing = format!(
        r#"{{"do": "world.foreign", "args":
            {{"shape": "box", "size_m": [0.06, 0.06], "height_m": {HEIGHT_M}, "pose": [{}, {}, 0]}}}}"#,
        BOX[0], BOX[1]
    );
    fault(&mut pair, &thing).unwrap();
    pair.run_until(0.1, |_| false);
    let stranger = |pair: &Pair| {
        let world = lock(&pair.simulator().core().world);
        let found = world.objects().iter().find(|body| body.id.starts_with("foreign"));
        found.map(|body| (body.id.clone(), body.table_from_object))
    };
    let stood = stranger(&pair).expect("the box stands there");

    // The least air under the lid while it is over the box.
    let mut air: Option<f64> = None;
    submit(&mut pair, "round", [0.225, 0.205]);
    let (code, moves, message) = ended(&mut pair, |pair| {
        let world = lock(&pair.simulator().core().world);
        let lid = world.object("lid").map(|lid| lid.table_from_object.translation.vector);
        if let Some(at) = lid.filter(|at| beside([at.x, at.y]) < LID_RADIUS_M) {
            air = Some(air.map_or(at.z, |least: f64| least.min(at.z)));
        }
    });
    assert_eq!((code, moves), (Code::Done, 1), "{message}");
    assert!(said(&pair, "is kept clear of"), "{:?}", pair.notices());
    let air = air.expect("the way leads over the box") - HEIGHT_M;
    assert!(air > 0.5 * MARGIN_M, "carried {air} m over the box");
    assert_eq!(stranger(&pair), Some(stood.clone()), "nobody touched it");
    let world = lock(&pair.simulator().core().world);
    let lid = world.object("lid").expect("the lid").pose();
    assert!((lid.x - 0.225).hypot(lid.y - 0.205) < 3e-3, "{lid:?}");
    assert!(!world.events().any(|event| format!("{event:?}").contains(&stood.0)), "nobody touched it");
    assert_eq!(pair.breaches(), []);
}

/// Each fault of a camera is named while the arm is stopped and waits; when it is over, the job goes on by
/// itself.
#[test]
fn every_fault_of_a_camera_is_named_and_nothing_is_touched_until_it_is_over() {
    let mut pair = example(ForeignRule::Off).unwrap();
    let cases = [
        ("camera.off", "{}", Code::CameraUnplugged),
        ("camera.freeze", "{}", Code::CameraFrozen),
        ("camera.repeat", "{}", Code::CameraRepeats),
        ("camera.gain", r#"{"gain": 0.1}"#, Code::CameraDark),
        ("camera.gain", r#"{"gain": 50}"#, Code::CameraOverexposed),
        ("camera.fog", r#"{"share": 0.95}"#, Code::CameraSeesNothing),
        ("camera.blur", r#"{"sigma_px": 6}"#, Code::CameraBlurred),
    ];
    let truth = |pair: &Pair| {
        let world = lock(&pair.simulator().core().world);
        let grips = world.events().filter(|event| matches!(event.kind, EventKind::Gripped { .. })).count();
        (world.object("lid").expect("the lid").pose(), grips)
    };
    for (number, (fault_name, args, code)) in cases.into_iter().enumerate() {
        // There is always something to move, so that the absence of motion means something.
        let x = if number % 2 == 0 { 0.30 } else { 0.36 };
        let before = truth(&pair);
        fault(&mut pair, &format!(r#"{{"do": "{fault_name}", "args": {args}}}"#)).unwrap();
        submit(&mut pair, code.as_str(), [x, 0.38]);
        let named = |pair: &Pair| matches!(&pair.status().expect("a status").doing, Doing::Looking(.., Some(named)) if *named == code);
        assert!(pair.run_until(60.0, named), "{code:?} is not named: {:?}", pair.reports().last());
        assert_eq!(truth(&pair), before, "{code:?}: nothing is touched while nothing is seen");
        fault(&mut pair, r#"{"do": "clear"}"#).unwrap();
        assert_eq!(ended(&mut pair, |_| ()).0, Code::Done, "{code:?}");
        assert!((truth(&pair).0.x - x).abs() < 3e-3, "{code:?}: the lid was carried after all");
        assert!(pair.status().is_some_and(|status| status.armed), "{code:?}: a camera disarms nothing");
    }
    assert_eq!(pair.breaches(), []);
}

/// A camera over the table sees the whole of it at once, with the arm turned away; the cell works from that.
#[test]
fn a_cell_works_from_a_camera_that_stands() {
    let (mut cell, mut sim) = configurations().unwrap();
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 3.12);
    let table_from_camera = Isometry3::from_parts(Translation3::new(0.26, 0.25, 0.68), down);
    sim.camera = SimMount::Fixed(sim.base_from_table * table_from_camera);
    let base_from_camera = sim.base_from_table * table_from_camera;
    let family = Family::Tag36h11;
    let board = Board { family, columns: 5, rows: 4, size_m: 0.02, gap_m: 0.005, first_id: 100 };
    cell.camera = CameraMount::Fixed { base_from_camera, board, flange_from_board: None };
    let turned_away = [88.3, -110.0, 100.0, -80.0, -90.0, 0.0];
    cell.look_poses = vec![Joints(turned_away.map(f64::to_radians))];
    let mut pair = armed(stage_of(&cell, &sim, 1).unwrap()).unwrap();
    submit(&mut pair, "one", [0.30, 0.38]);
    let (code, moves, message) = ended(&mut pair, |_| ());
    assert_eq!((code, moves), (Code::Done, 1), "{message}: {:?}", pair.notices());
    let lid = lock(&pair.simulator().core().world).object("lid").expect("the lid").pose();
    assert!((lid.x - 0.30).hypot(lid.y - 0.38) < 2e-3, "{lid:?}");
    assert_eq!(pair.breaches(), []);
}

/// The pictures that `celld calibrate empty` takes, from a round over the look poses of a bare table.
fn of_the_empty_table(stage: &Stage) -> Result<Vec<(Image, Isometry3<f64>)>, String> {
    let mut bare = stage.clone();
    bare.world.objects.clear();
    let choice = Choice { eye: SightKind::Pictures, ..Choice::of(2) };
    let mut pair = Pair::new(bare, choice).map_err(|error| error.to_string())?;
    assert!(bring_up(&mut pair), "the cell comes up");
    pair.visit(RoundOrder::pictures(stage.model.look_poses.clone(), None));
    assert!(pair.run_until(300.0, |pair| pair.round_over().is_some()), "{:?}", pair.notices());
    assert_eq!(pair.round_over(), Some(&Ok(())));
    assert_eq!(pair.breaches(), []);
    let table_from_base = stage.model.arm.base_from_table.inverse();
    let pictures = pair.camera_view().pictures().iter().map(|picture| {
        let image = picture.image.clone().ok_or("no picture")?;
        Ok((image, table_from_base * stage.model.mount.base_from_camera(&picture.base_from_flange)))
    });
    pictures.collect()
}

/// Where there is no depth, a mug is found because the table looks different without it.
#[test]
fn colour_finds_what_was_not_on_the_empty_table() {
    let (mut cell, sim) = configurations().unwrap();
    cell.foreign = ForeignRule::Refuse { depth_needed: false };
    let mut stage = stage_of(&cell, &sim, 1).unwrap();
    stage.depth = false;
    let empty = of_the_empty_table(&stage).unwrap();
    assert_eq!(empty.len(), stage.model.look_poses.len());
    let search = stage.scene.foreign.as_mut().expect("it is searched for");
    search.compare_with(empty.iter().map(|(image, table_from_camera)| (image, *table_from_camera)));

    let mut pair = armed(stage).unwrap();
    submit(&mut pair, "clean", [0.30, 0.38]);
    let (code, moves, message) = ended(&mut pair, |_| ());
    assert_eq!((code, moves), (Code::Done, 1), "{message}");
    fault(&mut pair, MUG).unwrap();
    submit(&mut pair, "mug", [0.40, 0.38]);
    let (code, moves, message) = ended(&mut pair, |_| ());
    assert_eq!((code, moves), (Code::ForeignObject, 0), "{message}");
    assert!(message.contains("its height is not known"), "{message}");
    assert!(pair.status().is_some_and(|status| !status.armed), "nobody knows how high it is");
    fault(&mut pair, r#"{"do": "clear"}"#).unwrap();
    pair.order(Order::Arm);
    submit(&mut pair, "again", [0.40, 0.38]);
    let (code, _, message) = ended(&mut pair, |_| ());
    assert_eq!(code, Code::Done, "{message}");
    assert_eq!(pair.breaches(), []);
}
