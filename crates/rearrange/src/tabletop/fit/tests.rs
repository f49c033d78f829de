//! Tests of fitting: sizes worked out by hand, the named scenes, and the public data where it is at hand.

use super::*;
use crate::tabletop::instance::Workspace;
use crate::tabletop::parse::parse_instance;
use crate::tabletop::scenes::{SCENES, scene};
use crate::tabletop::tests::data_folder;

/// The demo cell: a camera of 650 px focal length at 0.45 m, one cup of 20 mm.
fn demo() -> Requirements {
    Requirements {
        pixels_per_metre: 650.0 / 0.45,
        least_module_px: 3.0,
        cups: vec![Cup { x: 0.0, y: 0.0, radius: 0.01 }],
        cup_margin: 0.001,
    }
}

fn task(objects: Vec<ObjectSpec>) -> Instance {
    Instance {
        workspace: Workspace { width: 0.5, height: 0.4 },
        clearance: 0.0,
        overlap_tolerance: 0.0,
        keep_out: Vec::new(),
        objects,
    }
}

fn rectangle(id: &str, length: f64, width: f64) -> ObjectSpec {
    ObjectSpec::new(id, Footprint::rectangle(length, width).unwrap())
}

#[test]
fn what_is_missing_is_filled_in_and_what_is_given_stays() {
    let mut given = rectangle("given", 0.1, 0.1);
    given.height = Some(0.05);
    given.mass = Some(0.3);
    given.marker =
        Some(MarkerSpec { family: FAMILY.into(), id: 0, size: 0.03, offset: Pose2::new(0.01, 0.0, 0.5) });
    let fitted = fit(&task(vec![given.clone(), rectangle("plain", 0.1, 0.05)]), &demo()).unwrap();
    assert_eq!(fitted.instance.objects[0], given);
    let plain = &fitted.instance.objects[1];
    let marker = plain.marker.as_ref().unwrap();
    assert_eq!((marker.id, marker.offset), (1, Pose2::new(0.0, 0.0, 0.0)));
    // 50 mm of print are 40 mm of black square.
    assert!((marker.size - 0.04).abs() < 1e-12, "{}", marker.size);
    assert_eq!(plain.height, Some(0.02));
    assert!((plain.mass.unwrap() - 0.1 * 0.05 * 0.02 * 450.0).abs() < 1e-12);
    assert_eq!(fitted.grips[1], Some(Grip { point: [0.0, 0.0], yaw: None }));
}

#[test]
fn small_objects_are_refused_all_at_once_with_the_table_that_would_do() {
    let mut needs = demo();
    needs.pixels_per_metre = 1000.0; // 3 px a module: 24 mm of black square, 30 mm of print
    let objects =
        vec![rectangle("fine", 0.1, 0.1), rectangle("tag", 0.1, 0.025), rectangle("fixed", 0.01, 0.01)];
    let mut task = task(objects);
    task.objects[2].fixed = true;
    let FitError::Refused(refusals) = fit(&task, &needs).unwrap_err() else { panic!("another error") };
    assert_eq!(refusals.len(), 1);
    assert_eq!(refusals[0].table_size, Some(0.6));
    let text = refusals[0].to_string();
    assert!(text.contains("`tag`") && text.contains("20.0 mm, 2.5 px") && text.contains("0.60 m"), "{text}");
    // A close camera reads it, and then the cup decides: 22 mm.
    needs.pixels_per_metre = 4000.0;
    task.objects.push(rectangle("cup", 0.1, 0.02));
    let FitError::Refused(refusals) = fit(&task, &needs).unwrap_err() else { panic!("another error") };
    assert_eq!((refusals.len(), refusals[0].object.as_str()), (1, "cup"));
    assert!(matches!(refusals[0].lack, Lack::Cups { .. }), "{refusals:?}");
    assert_eq!(refusals[0].table_size, Some(0.55));
    assert!(refusals[0].to_string().contains("22 mm of flat top"), "{}", refusals[0]);
}

#[test]
fn the_smallest_table_is_that_of_the_smallest_object_and_fits() {
    let mut needs = demo();
    needs.pixels_per_metre = 1000.0;
    let task = task(vec![rectangle("large", 0.2, 0.2), rectangle("small", 0.1, 0.04)]);
    let size = smallest_table_size(&task, &needs, 0.8).unwrap();
    assert!((size - 0.38).abs() < 1e-12, "{size}"); // 0.5 * 30 / 40 = 0.375
    fit(&scaled_to_table(&task, size).unwrap(), &needs).unwrap();
    fit(&scaled_to_table(&task, size - 0.01).unwrap(), &needs).unwrap_err();
    let none = smallest_table_size(&task, &needs, 0.3).unwrap_err();
    let text = none.to_string();
    assert!(
        text.contains("0.30 m") && text.contains("`small`") && text.contains("0.38 m would do"),
        "{text}"
    );
}

#[test]
fn an_unreadable_marker_in_the_file_is_refused() {
    let mut object = rectangle("labelled", 0.1, 0.1);
    object.marker = Some(MarkerSpec { family: FAMILY.into(), id: 3, size: 0.01, offset: Pose2::default() });
    let error = fit(&task(vec![object]), &demo()).unwrap_err();
    assert!(
        error.to_string().contains("marker of object `labelled` (10.0 mm) is too small to be read"),
        "{error}"
    );
}

#[test]
fn there_are_no_more_objects_than_markers() {
    let many = (0..201).map(|k| rectangle(&format!("o{k}"), 0.1, 0.1)).collect();
    assert_eq!(
        fit(&task(many), &demo()).unwrap_err(),
        FitError::TooManyObjects { objects: 201, markers: 200 }
    );
}

#[track_caller]
fn is_ready(fitted: &Fitted, needs: &Requirements) {
    let mut ids = BTreeSet::new();
    for (object, grip) in fitted.instance.objects.iter().zip(&fitted.grips) {
        let marker = object.marker.as_ref().unwrap();
        assert!(ids.insert(marker.id), "marker {} is used twice", marker.id);
        assert!(needs.module_px(marker.size) >= needs.least_module_px - 1e-9, "{}", object.id);
        let half = marker.size * PRINT_MODULES / BLACK_MODULES / 2.0 * (1.0 - 1e-6);
        for (x, y) in [
            (-1.0, -1.0),
            (-1.0, 1.0),
            (1.0, -1.0),
            (1.0, 1.0),
            (1.0, 0.0),
            (0.0, 1.0),
            (-1.0, 0.0),
            (0.0, -1.0),
        ] {
            let corner = marker.offset.transform([x * half, y * half]);
            assert!(
                object.footprint.contains_point(corner, 0.0),
                "{}: print off the top at {corner:?}",
                object.id
            );
        }
        let grip = grip.unwrap();
        assert!(object.footprint.contains_point(grip.point, 0.011 - 1e-9), "{}: {grip:?}", object.id);
    }
}

#[test]
fn every_scene_is_ready_for_the_demo_cell_as_it_is() {
    for one in SCENES {
        let instance = scene(one.name).unwrap();
        let fitted = fit(&instance, &demo()).unwrap_or_else(|error| panic!("{}: {error}", one.name));
        is_ready(&fitted, &demo());
    }
}

/// The five public instances the demo has to carry out at the smallest table up to 0.8 m.
#[test]
fn the_public_instances_of_the_demo_fit_a_table_of_at_most_80_cm() {
    let Some(data) = data_folder() else { return };
    let shapes = |name: &str| std::fs::read_to_string(data.join(format!("hetori/shapes/{name}.json"))).ok();
    for path in [
        "random_general/Density=0.30/numObjs=10/0_10_0.30.json",
        "random_general/Density=0.30/numObjs=10/1_10_0.30.json",
        "Klotski_blocks_2large/Density=0.20/numObjs=20/0_20_0.20.json",
        "Klotski_blocks_2large/Density=0.40/numObjs=20/0_20_0.40.json",
        "Tetris0/Density=0.00/numObjs=8/0_8_0.00.json",
    ] {
        let text = std::fs::read_to_string(data.join("hetori/instances").join(path)).unwrap();
        let instance = parse_instance(&text, path, &shapes).unwrap_or_else(|faults| panic!("{faults}"));
        let size =
            smallest_table_size(&instance, &demo(), 0.8).unwrap_or_else(|error| panic!("{path}: {error}"));
        println!("{path}: {size:.2} m");
        is_ready(&fit(&scaled_to_table(&instance, size).unwrap(), &demo()).unwrap(), &demo());
    }
}
