//! Faults of the simulated camera as the marker detector sees them. `ur-sim` may not use the detector, hence
//! here.

#![allow(clippy::unwrap_used, reason = "helpers of tests: an unwrap that fails is the test that fails")]

use cell_vision::detect::{DetectSettings, Detection, Detector};
use nalgebra::Isometry3;
use rearrange::geometry::footprint::Footprint;
use rearrange::geometry::pose::Pose2;
use ur_sim::faults::camera::CameraFaults;
use ur_sim::faults::read::read_posted;
use ur_sim::faults::{CameraFault, Fault};
use ur_sim::render::Renderer;
use ur_sim::render::lens::CameraTruth;
use ur_sim::render::scene::look_at;
use ur_sim::world::World;
use ur_sim::world::spec::{GripperSpec, ObjectMarker, PlacementErrors, ReferenceMarker, TableSpec};
use ur_sim::world::spec::{WorldObject, WorldSpec};

/// A block with marker 3 and a place on the table with marker 500.
fn world() -> World {
    let block = WorldObject {
        id: "block".to_owned(),
        footprint: Footprint::rectangle(0.08, 0.08).unwrap(),
        height_m: 0.02,
        mass_kg: 0.1,
        pose: Pose2::new(0.15, 0.2, 0.3),
        marker: Some(ObjectMarker { id: 3, size_m: 0.05, offset: Pose2::default() }),
        grippable: None,
        fixed: false,
        colour: None,
    };
    let spec = WorldSpec {
        table: TableSpec { width_m: 0.5, height_m: 0.5, margin_m: 0.1 },
        base_from_table: Isometry3::identity(),
        objects: vec![block],
        reference_markers: vec![ReferenceMarker { id: 500, size_m: 0.04, pose: Pose2::new(0.25, 0.3, 0.0) }],
        errors: PlacementErrors::default(),
        gripper: GripperSpec::one_cup(0.2),
        hand_board: None,
    };
    World::new(spec, 1).unwrap()
}

/// What is detected with these faults; each as posted to the simulator.
fn seen(faults: &[&str]) -> Vec<Detection> {
    let camera_fault = |text: &&str| match read_posted(text).unwrap().remove(0).order.fault {
        Fault::Camera(fault) => fault,
        other => panic!("{other:?}"),
    };
    let faults: Vec<CameraFault> = faults.iter().map(camera_fault).collect();
    let faults = CameraFaults::of(faults.iter());
    let mut world = world();
    world.set_camera_faults(faults.clone());
    let renderer = Renderer::new(CameraTruth::ideal("sim-1", 480, 360, 480.0));
    let eye = look_at([0.23, 0.23, 0.5], [0.23, 0.23, 0.0], [1.0, 0.0, 0.0]) * faults.shift;
    let picture = renderer.expose(&world.scene(), &eye, &faults.exposure, [1, 1]);
    let mut found = Detector::new(DetectSettings::default()).unwrap().detect(&picture.gray()).unwrap();
    found.sort_by_key(|detection| detection.id);
    found
}

fn ids(faults: &[&str]) -> Vec<u32> {
    seen(faults).iter().map(|detection| detection.id).collect()
}

#[test]
fn a_covered_marker_is_not_detected_and_the_others_are() {
    assert_eq!(ids(&[]), [3, 500]);
    assert_eq!(ids(&["{do: camera.occlude, args: {marker: 3}}"]), [500]);
    assert_eq!(ids(&["{do: camera.occlude, args: {marker: 500}}"]), [3]);
}

#[test]
fn further_prints_are_detected_where_they_lie() {
    let found = seen(&["{do: camera.dup, args: {marker: 3, pose: [0.32, 0.15, 0]}}"]);
    assert_eq!(found.iter().map(|detection| detection.id).collect::<Vec<_>>(), [3, 3, 500]);
    let apart = found[0].corners[0][0] - found[1].corners[0][0];
    assert!(apart.abs() > 100.0, "{apart} px");
    let unknown = "{do: camera.unknown, args: {marker: 77, pose_deg: [0.32, 0.15, 45], size_m: 0.05}}";
    assert_eq!(ids(&[unknown]), [3, 77, 500]);
}

#[test]
fn nothing_is_detected_in_the_dark_in_fog_or_out_of_focus() {
    assert!(ids(&["{do: camera.gain, args: {gain: 0.01}}"]).is_empty());
    assert!(ids(&["{do: camera.fog, args: {share: 0.99}}"]).is_empty());
    assert!(ids(&["{do: camera.blur, args: {sigma_px: 12}}"]).is_empty());
}

#[test]
fn a_bumped_camera_sees_the_markers_elsewhere() {
    let bumped = seen(&["{do: camera.extrinsics, args: {translation_m: [0.01, 0, 0]}}"]);
    let before = seen(&[]);
    assert_eq!(bumped.len(), before.len());
    for (bumped, before) in bumped.iter().zip(&before) {
        // 10 mm at half a metre and 480 px; to the left, for the camera went to the right.
        let shift = bumped.corners[0][0] - before.corners[0][0];
        assert!((shift + 9.8).abs() < 0.7, "{shift} px");
    }
}
