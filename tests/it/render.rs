//! The simulated camera against OpenCV and the marker detector: two readings of the same lens, and corners
//! in drawn pictures where the lens puts them. `ur-sim` may use neither, hence here.

#![allow(clippy::unwrap_used, reason = "helpers of tests: an unwrap that fails is the test that fails")]

use cell_values::image::Image;
use cell_vision::board::Board;
use cell_vision::camera::CameraModel;
use cell_vision::cv;
use cell_vision::detect::{DetectSettings, Detector, Family};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rearrange::geometry::footprint::Footprint;
use rearrange::geometry::pose::Pose2;
use ur_sim::box_clients::BoxConfig;
use ur_sim::render::Renderer;
use ur_sim::render::lens::CameraTruth;
use ur_sim::render::scene::look_at;
use ur_sim::world::World;
use ur_sim::world::drive::Drive;
use ur_sim::world::spec::{CameraMount, Cup, GripperSpec, HandBoard, NominalCell, ObjectMarker};
use ur_sim::world::spec::{
    PlacementErrors, ReferenceMarker, TableSpec, TruthLimits, TruthSpec, WorldObject, WorldSpec,
};
use ur_sim::world::vacuum::{Channel, VacuumMode};

fn truth(seed: u64) -> TruthSpec {
    let nominal = NominalCell {
        base_from_table: Isometry3::identity(),
        mount: CameraMount::Flange(Isometry3::translation(0.0, -0.07, 0.03)),
        camera: CameraTruth::ideal("sim-1", 1280, 720, 650.0),
    };
    let limits = TruthLimits { table_m: 3e-3, table_rad: 5e-3, mount_m: 3e-3, mount_rad: 9e-3 };
    TruthSpec::from_seed(&nominal, &limits, seed)
}

/// The camera as OpenCV takes it, through the JSON that the camera server sends.
fn model(camera: &CameraTruth) -> CameraModel {
    serde_json::from_value(serde_json::to_value(camera.intrinsics()).unwrap()).unwrap()
}

#[test]
fn the_simulated_lens_agrees_with_opencv() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut seen = 0;
    for seed in 0..20 {
        let camera = truth(seed).camera;
        let points: Vec<[f64; 3]> =
            (0..500).map(|_| std::array::from_fn(|_| rng.random_range(-0.5..0.5))).collect();
        let turn = UnitQuaternion::from_scaled_axis(Vector3::from_fn(|_, _| rng.random_range(-0.6..0.6)));
        let pose = Isometry3::from_parts(Translation3::new(0.02, -0.03, 1.2), turn);
        let theirs = cv::project(&model(&camera), &pose, &points).unwrap();
        for (point, theirs) in points.iter().zip(theirs) {
            let p = pose * nalgebra::Point3::from(*point);
            let ours = camera.project([p.x, p.y, p.z]).unwrap();
            assert!(
                (ours[0] - theirs[0]).hypot(ours[1] - theirs[1]) < 1e-6,
                "seed {seed}: {ours:?} {theirs:?}"
            );
            seen += 1;
        }
    }
    assert_eq!(seen, 10_000);
}

fn gripper() -> GripperSpec {
    GripperSpec {
        drive: Drive::Vgc10,
        overshoot: 0.0,
        clients: BoxConfig::default(),
        flange_from_tool: Isometry3::translation(0.0, 0.0, 0.2),
        cups: vec![Cup { channel: Channel::A, x_m: 0.0, y_m: 0.0, diameter_m: 0.02 }],
        body: Footprint::rectangle(0.07, 0.07).unwrap(),
        body_above_lips_m: 0.08,
    }
}

/// Twelve marked objects of two shapes at random angles, four reference markers round them.
fn marked_table(seed: u64) -> WorldSpec {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut objects = Vec::new();
    for k in 0..12u32 {
        let pose = Pose2::new(
            0.07 + 0.12 * f64::from(k % 4) + rng.random_range(-0.01..0.01),
            0.07 + 0.11 * f64::from(k / 4) + rng.random_range(-0.01..0.01),
            rng.random_range(-3.1..3.1),
        );
        let footprint = match k % 2 {
            0 => Footprint::rectangle(0.07, 0.05).unwrap(),
            _ => Footprint::disc(0.033).unwrap(),
        };
        objects.push(WorldObject {
            id: format!("object-{k}"),
            footprint,
            height_m: 0.01 + 0.005 * f64::from(k % 3),
            mass_kg: 0.1,
            pose,
            marker: Some(ObjectMarker { id: k, size_m: 0.03, offset: Pose2::new(0.002, -0.001, 0.4) }),
            grippable: None,
            fixed: false,
            colour: None,
        });
    }
    let corner = |id: u32, x: f64, y: f64| ReferenceMarker { id, size_m: 0.03, pose: Pose2::new(x, y, 0.3) };
    WorldSpec {
        table: TableSpec { width_m: 0.5, height_m: 0.36, margin_m: 0.12 },
        base_from_table: Isometry3::identity(),
        objects,
        reference_markers: vec![
            corner(500, -0.04, -0.04),
            corner(501, 0.54, -0.04),
            corner(502, 0.54, 0.40),
            corner(503, -0.04, 0.40),
        ],
        errors: PlacementErrors::default(),
        gripper: gripper(),
        hand_board: None,
    }
}

#[test]
fn markers_in_drawn_pictures_have_their_corners_where_the_lens_puts_them() {
    let mut errors = Vec::new();
    let (mut wanted, mut found) = (0, 0);
    let mut detector = Detector::new(DetectSettings::default()).unwrap();
    for seed in 0..3 {
        let camera = truth(seed).camera;
        let renderer = Renderer::new(camera.clone());
        let world = World::new(marked_table(seed), seed).unwrap();
        let eye = look_at([0.25, 0.10 - 0.05 * seed as f64, 0.50], [0.25, 0.18, 0.0], [1.0, 0.0, 0.0]);
        let picture = renderer.render(&world.scene(), &eye, seed, 1);
        keep(&picture, &seed.to_string());
        let detections = detector.detect(&picture.gray()).unwrap();
        for (id, size_m, table_from_marker) in markers(&world, &marked_table(seed)) {
            let half = size_m / 2.0;
            let corners = [[-half, -half, 0.0], [half, -half, 0.0], [half, half, 0.0], [-half, half, 0.0]];
            let truth = cv::project(&model(&camera), &(eye.inverse() * table_from_marker), &corners).unwrap();
            wanted += 1;
            let Some(detection) = detections.iter().find(|detection| detection.id == id) else { continue };
            found += 1;
            errors.extend(detection.corners.iter().zip(truth).map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1])));
        }
        assert!(detections.iter().all(|detection| detection.id < 12 || (500..504).contains(&detection.id)));
    }
    errors.sort_by(f64::total_cmp);
    let (median, worst) = (errors[errors.len() / 2], errors[errors.len() * 95 / 100]);
    println!("{found} of {wanted} markers, corner error median {median:.3} px, 95 % below {worst:.3} px");
    assert_eq!(found, wanted);
    assert!(median < 0.1 && worst < 0.3, "{median} {worst}");
}

#[test]
fn the_board_on_the_hand_is_seen_where_it_is_carried_and_hides_what_lies_under_it() {
    use ur_sim::render::sensor::Exposure;
    let camera = truth(2).camera;
    let mut spec = marked_table(2);
    let facing_up = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let flange_from_board = Isometry3::from_parts(Translation3::new(0.05, 0.05, 0.03), facing_up);
    spec.hand_board =
        Some(HandBoard { flange_from_board, grid: [5, 4], size_m: 0.02, gap_m: 0.006, first_id: 100 });
    let mut world = World::new(spec, 2).unwrap();
    let turned = UnitQuaternion::from_scaled_axis(Vector3::new(0.2, -0.25, 0.3)) * facing_up;
    let flange = Isometry3::from_parts(Translation3::new(0.14, 0.18, 0.3), turned);
    world.step(0.002, 0.002, &flange);
    let eye = look_at([0.25, 0.18, 0.75], [0.25, 0.18, 0.0], [1.0, 0.0, 0.0]);
    let scene = world.scene();
    let renderer = Renderer::new(camera.clone());
    let picture = renderer.render(&scene, &eye, 2, 1);
    keep(&picture, "board");
    let detections = Detector::new(DetectSettings::default()).unwrap().detect(&picture.gray()).unwrap();
    // The print as `celld markers` lays it out and calibration takes it.
    let board = Board::new(Family::Tag36h11, 5, 4, 0.02, 100);
    let (on_board, in_picture) = board.seen(&detections);
    assert_eq!(on_board.len(), 80, "all twenty markers");
    let points: Vec<[f64; 3]> = on_board.iter().map(|[x, y]| [*x, *y, 0.0]).collect();
    let camera_from_board = eye.inverse() * flange * flange_from_board;
    let wanted = cv::project(&model(&camera), &camera_from_board, &points).unwrap();
    let errors = in_picture.iter().zip(&wanted).map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1]));
    assert!(errors.fold(0.0, f64::max) < 0.3);
    let covers = |id: u32| {
        let (_, _, marker) = markers(&world, &marked_table(2)).into_iter().find(|m| m.0 == id).unwrap();
        let ray = marker.translation.vector - eye.translation.vector;
        let [normal, at] =
            [flange * flange_from_board * Vector3::z(), (flange * flange_from_board).translation.vector];
        let hit =
            eye.translation.vector + ray * ((at - eye.translation.vector).dot(&normal) / ray.dot(&normal));
        let [x, y] =
            [0, 1].map(|i| ((flange * flange_from_board).inverse() * nalgebra::Point3::from(hit))[i]);
        (0.0..0.124).contains(&x) && (0.0..0.098).contains(&y)
    };
    let hidden: Vec<u32> = (0..12).filter(|id| covers(*id)).collect();
    assert!(!hidden.is_empty(), "something lies under it");
    assert!(detections.iter().all(|detection| !hidden.contains(&detection.id)));
    let depth = renderer.expose_depth(&scene, &eye, &Exposure::default(), [2, 1]);
    let middle = camera_from_board * nalgebra::Point3::new(0.062, 0.049, 0.0);
    let [u, v] = camera.project([middle.x, middle.y, middle.z]).unwrap();
    let measured = f64::from(depth.units[v.round() as usize * 1280 + u.round() as usize])
        * ur_sim::render::depth::UNIT_M;
    assert!((measured - middle.z).abs() < 5e-3, "{measured} {}", middle.z);
}

fn markers(world: &World, spec: &WorldSpec) -> Vec<(u32, f64, Isometry3<f64>)> {
    let on_objects = world.objects().iter().zip(&spec.objects).filter_map(|(body, object)| {
        let marker = object.marker?;
        let object_from_marker = marker.offset.at_height(object.height_m);
        Some((marker.id, marker.size_m, body.table_from_object * object_from_marker))
    });
    let on_table = spec.reference_markers.iter().map(|m| (m.id, m.size_m, m.pose.at_height(0.0)));
    on_objects.chain(on_table).collect()
}

/// An arm whose tool points straight down, moved in controller frames.
struct Arm {
    world: World,
    now_s: f64,
    at: [f64; 3],
}

impl Arm {
    fn flange(&self) -> Isometry3<f64> {
        let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let table_from_tool = Isometry3::from_parts(Translation3::from(Vector3::from(self.at)), down);
        self.world.base_from_table() * table_from_tool * gripper().flange_from_tool.inverse()
    }

    fn go(&mut self, to: [f64; 3], seconds: f64) {
        let from = self.at;
        let frames = (seconds / 0.002) as usize;
        for k in 1..=frames {
            let s = k as f64 / frames as f64;
            let s = s * s * (3.0 - 2.0 * s);
            self.at = std::array::from_fn(|i| from[i] + s * (to[i] - from[i]));
            self.now_s += 0.002;
            let flange = self.flange();
            self.world.step(self.now_s, 0.002, &flange);
        }
    }

    fn suck(&mut self, mode: VacuumMode) {
        self.world.command_vacuum(Channel::A, mode, 0.6);
        self.go(self.at, 0.5);
    }
}

#[test]
fn an_object_put_onto_another_is_seen_to_be_tilted() {
    let mut spec = marked_table(4);
    let (from, to) = (spec.objects[0].pose, spec.objects[9].pose);
    let (marker, height_m) = (spec.objects[0].marker.unwrap(), spec.objects[0].height_m);
    spec.base_from_table = truth(4).base_from_table;
    let mut arm = Arm { world: World::new(spec, 4).unwrap(), now_s: 0.0, at: [0.25, 0.2, 0.2] };
    // Its middle is beyond the other's edge: nearer, it would lie flat on top.
    for (x, y, mode) in [(from.x, from.y, VacuumMode::Grip), (to.x + 0.038, to.y, VacuumMode::Release)] {
        arm.go([x, y, 0.1], 1.5);
        arm.go([x, y, height_m], 1.0);
        arm.suck(mode);
        arm.go([x, y, 0.1], 1.0);
    }
    let true_tilt = arm.world.object("object-0").unwrap().tilt_rad().to_degrees();
    assert!((5.0..12.1).contains(&true_tilt), "{true_tilt}");

    arm.go([0.25, 0.1, 0.25], 1.0);
    let truth = truth(4);
    let scene = arm.world.scene();
    let eye = scene.table_from_camera(&truth.mount);
    let picture = Renderer::new(truth.camera.clone()).render(&scene, &eye, 4, 1);
    keep(&picture, "tilted");
    let detections = Detector::new(DetectSettings::default()).unwrap().detect(&picture.gray()).unwrap();
    let tilt_of = |id: u32| {
        let seen = detections.iter().find(|detection| detection.id == id);
        let seen = seen.unwrap_or_else(|| panic!("marker {id} is not in view"));
        let poses = cv::square_poses(&model(&truth.camera), &seen.corners, marker.size_m).unwrap();
        let normal = |pose: &Isometry3<f64>| (eye * pose).rotation * Vector3::z();
        normal(&poses[0].camera_from_target).angle(&Vector3::z()).to_degrees()
    };
    let (tilted, flat) = (tilt_of(0), tilt_of(6));
    assert!((tilted - true_tilt).abs() < 2.0, "seen {tilted}, true {true_tilt}");
    assert!(flat < 2.0, "{flat}");
}

/// Keeps a picture to look at, where `CELLD_TEST_PICTURES` names a folder.
fn keep(picture: &Image, name: &str) {
    if let Some(folder) = std::env::var_os("CELLD_TEST_PICTURES") {
        let path = std::path::Path::new(&folder).join(format!("render-{name}.png"));
        std::fs::write(path, picture.encode_png().unwrap()).unwrap();
    }
}
