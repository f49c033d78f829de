//! The search for foreign objects on depth pictures that are worked out ray by ray here, with noise, holes
//! and curvature.

use super::*;
use crate::testing;
use cell_values::image::depth::DepthImage;
use nalgebra::{Isometry3, Point3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const AREA: Area = Area { low: [-0.2, -0.15], high: [0.2, 0.15] };

/// An upright box: lowest and highest x and y, and height, m.
type Block = [f64; 5];

fn eye(tilt: f64) -> Isometry3<f64> {
    testing::looking_down(0.0, 0.0, 0.5, [tilt, 0.0], 0.2)
}

/// Depth of table and boxes; `curved` by that share in the corners, `holes` of that share.
fn picture(table_from_camera: &Isometry3<f64>, blocks: &[Block], curved: f64, holes: f64) -> DepthImage {
    let camera = testing::camera(640, 480);
    let pixels: Vec<[f64; 2]> = (0..640 * 480).map(|i| [f64::from(i % 640), f64::from(i / 640)]).collect();
    let rays = crate::cv::undistort(&camera, &pixels).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(4);
    let metres = rays.iter().map(|ray| {
        let direction = table_from_camera.rotation * Vector3::new(ray[0], ray[1], 1.0);
        let from = table_from_camera.translation.vector;
        let mut depth = -from.z / direction.z;
        for [x0, y0, x1, y1, height] in blocks {
            depth = march(&from, &direction, depth, [*x0, *y0, *x1, *y1, *height]);
        }
        let radius2 = (ray[0] * ray[0] + ray[1] * ray[1]) / 0.6;
        let noise = 1.0 + 0.003 * (random.random::<f64>() + random.random::<f64>() - 1.0);
        if random.random::<f64>() < holes { 0.0 } else { (depth * noise * (1.0 + curved * radius2)) as f32 }
    });
    DepthImage::from_metres(640, 480, metres.collect()).unwrap()
}

/// Depth at which a ray enters a box, if before `depth`.
fn march(from: &Vector3<f64>, direction: &Vector3<f64>, depth: f64, block: Block) -> f64 {
    let (low, high) = ([block[0], block[1], 0.0], [block[2], block[3], block[4]]);
    let (mut enter, mut leave) = (0.0_f64, f64::INFINITY);
    for axis in 0..3 {
        let a = (low[axis] - from[axis]) / direction[axis];
        let b = (high[axis] - from[axis]) / direction[axis];
        enter = enter.max(a.min(b));
        leave = leave.min(a.max(b));
    }
    if enter < leave { depth.min(enter) } else { depth }
}

fn map(blocks: &[Block], curved: f64, holes: f64) -> HeightMap {
    let lens = DepthLens::new(&testing::camera(640, 480)).unwrap();
    let eye = eye(0.15);
    HeightMap::new(&picture(&eye, blocks, curved, holes), &lens, &eye, AREA, None).unwrap()
}

fn block(x: f64, y: f64, length: f64, width: f64, height: f64) -> Block {
    [x - length / 2.0, y - width / 2.0, x + length / 2.0, y + width / 2.0, height]
}

fn known(x: f64, y: f64, length: f64, width: f64, height_m: f64) -> KnownBody {
    KnownBody {
        footprint: Footprint::rectangle(length, width).unwrap(),
        pose: Pose2::new(x, y, 0.0),
        height_m,
    }
}

fn found(blocks: &[Block], known: &[KnownBody]) -> Vec<ForeignObject> {
    find(&[&map(blocks, 0.01, 0.02)], known, &[], &ForeignLimits::default()).objects
}

#[test]
fn an_empty_table_and_known_objects_are_nothing_foreign() {
    assert_eq!(found(&[], &[]), []);
    let blocks = [block(0.0, 0.0, 0.12, 0.06, 0.02), block(-0.1, 0.08, 0.05, 0.05, 0.04)];
    let known = [known(0.0, 0.0, 0.12, 0.06, 0.02), known(-0.1, 0.08, 0.05, 0.05, 0.04)];
    assert_eq!(found(&blocks, &known), []);
    assert_eq!(found(&blocks, &known[..1]).len(), 1, "the one that is not known");
}

#[test]
fn a_stranger_is_found_where_it_stands_as_high_and_as_large_as_it_is() {
    let objects = found(&[block(0.1, -0.06, 0.05, 0.04, 0.06)], &[known(-0.1, 0.0, 0.05, 0.05, 0.03)]);
    let [object] = &objects[..] else { panic!("{objects:?}") };
    let off = (object.centre[0] - 0.1).hypot(object.centre[1] + 0.06);
    assert!(off < 0.006, "{object:?}");
    assert!(
        (object.height_m - 0.06).abs() < 0.004 && (object.area_m2 / 20e-4 - 1.0).abs() < 0.3,
        "{object:?}"
    );
    assert!(contains(&object.outline, [0.1, -0.06]));
    let text = object.to_string();
    assert!(text.contains("mm high") && text.contains("x = ") && text.contains("cm2"), "{text}");
}

#[test]
fn a_thing_on_a_known_object_is_found_and_one_below_the_limits_is_not() {
    let plank = known(0.0, 0.0, 0.12, 0.06, 0.02);
    let on_top = [block(0.0, 0.0, 0.12, 0.06, 0.02), block(0.02, 0.0, 0.04, 0.04, 0.05)];
    assert_eq!(found(&on_top, std::slice::from_ref(&plank)).len(), 1);
    assert_eq!(found(&[block(0.1, 0.05, 0.05, 0.05, 0.006)], &[]), [], "a sheet of card");
    assert_eq!(found(&[block(0.1, 0.05, 0.012, 0.012, 0.05)], &[]), [], "a screw on its head");
    assert_eq!(found(&[block(0.1, 0.05, 0.03, 0.03, 0.018)], &[]).len(), 1);
}

#[test]
fn half_the_pixels_missing_change_nothing_and_a_blind_camera_measures_nothing() {
    let stranger = block(-0.05, 0.05, 0.04, 0.04, 0.03);
    let report = find(&[&map(&[stranger], 0.01, 0.5)], &[], &[], &ForeignLimits::default());
    assert!(report.objects.len() == 1 && report.measured_share > 0.85, "{report:?}");
    let report = find(&[&map(&[stranger], 0.01, 1.0)], &[], &[], &ForeignLimits::default());
    assert!(report.objects.is_empty() && report.measured_share == 0.0, "{report:?}");
    assert_eq!(find(&[], &[], &[], &ForeignLimits::default()).measured_share, 0.0);
}

#[test]
fn where_nothing_is_looked_for_nothing_has_to_be_measured() {
    let mut map = map(&[], 0.01, 0.02);
    for cell in 0..map.heights_m.len() {
        if map.centre(cell)[0] > 0.05 {
            map.heights_m[cell] = f32::NAN;
        }
    }
    let footprint = Footprint::rectangle(0.16, 0.32).unwrap();
    let bin = KeepOut { footprint, pose: Pose2::new(0.13, 0.0, 0.0) };
    let report = find(&[&map], &[], &[bin], &ForeignLimits::default());
    assert!(report.measured_share > 0.9 && report.largest_hole().is_none(), "{report:?}");
    let report = find(&[&map], &[], &[], &ForeignLimits::default());
    assert!(report.measured_share < 0.7 && report.largest_hole().is_some(), "{report:?}");
}

#[test]
fn the_tables_own_depth_takes_the_curvature_out() {
    // A per cent at 0.5 m is 5 mm: without the correction the corner's 14 mm read as 9.
    let corner = block(-0.16, 0.11, 0.05, 0.05, 0.014);
    let objects = found(&[corner], &[]);
    assert_eq!(objects.len(), 1);
    assert!((objects[0].height_m - 0.014).abs() < 0.003, "{objects:?}");
}

#[test]
fn a_flat_board_over_a_large_part_of_the_view_is_not_taken_for_the_table() {
    for curved in [0.0, 0.01, -0.01] {
        for (height, share) in [(0.011, 0.2), (0.0118, 0.2), (0.0125, 0.4), (0.0125, 0.6), (0.013, 0.9)] {
            let board = [-0.5, -0.5, -0.2 + 0.4 * share, 0.5, height];
            let seen = map(&[board], curved, 0.02);
            let objects = find(&[&seen], &[], &[], &ForeignLimits::default()).objects;
            let scene = format!("{height} m over {share} of the view, curved by {curved}: {objects:?}");
            let [object] = &objects[..] else { panic!("{scene}") };
            assert!((object.area_m2 / (share * 0.12) - 1.0).abs() < 0.05, "{scene}");
            // The highest of many cells: noise makes it a little higher.
            assert!((object.height_m - height - 1e-3).abs() < 1e-3, "{scene}");
        }
    }
}

#[test]
fn known_flat_objects_all_over_the_table_do_not_hide_what_stands_between_them() {
    for (share, tile_m) in [(0.5_f64, 0.01), (0.6, 0.01), (0.8, 0.01), (0.8, 0.004), (0.8, 0.006)] {
        let (edge, mut blocks, mut tiles) = (0.05 * share.sqrt(), Vec::new(), Vec::new());
        for place in 0..80 {
            let (x, y) = (-0.225 + 0.05 * f64::from(place % 10), -0.175 + 0.05 * f64::from(place / 10));
            // One tile is not there, a stranger is in its place.
            if place == 68 {
                blocks.push(block(x, y, 0.03, 0.03, 0.0125));
            } else {
                blocks.push(block(x, y, edge, edge, tile_m));
                tiles.push(known(x, y, edge, edge, tile_m));
            }
        }
        let objects = found(&blocks, &tiles);
        let scene = format!("{tile_m} m over {share} of the view: {objects:?}");
        let [object] = &objects[..] else { panic!("{scene}") };
        assert!((object.height_m - 0.013).abs() < 1.5e-3, "{scene}");
        assert!((object.centre[0] - 0.175).hypot(object.centre[1] - 0.125) < 0.006, "{scene}");
    }
}

#[test]
fn a_piece_of_the_table_that_cannot_be_measured_is_reported_with_its_place() {
    let (lens, eye) = (DepthLens::new(&testing::camera(640, 480)).unwrap(), eye(0.15));
    let whole = picture(&eye, &[], 0.01, 0.02);
    let report = |depth: &DepthImage, known: &[KnownBody]| {
        let map = HeightMap::new(depth, &lens, &eye, AREA, None).unwrap();
        find(&[&map], known, &[], &ForeignLimits::default())
    };
    assert_eq!(report(&whole, &[]).largest_hole(), None, "specks are none");
    // A black cloth of 6 x 5 cm.
    let camera = testing::camera(640, 480);
    let outline = [[0.03, 0.02], [0.09, 0.02], [0.09, 0.07], [0.03, 0.07]];
    let pixels: Vec<[f64; 2]> = outline
        .iter()
        .map(|[x, y]| testing::project(&camera, &(eye.inverse() * Point3::new(*x, *y, 0.0))))
        .collect();
    let pixels = convex_hull(&pixels);
    let metres = (0..640 * 480).map(|i| {
        let (u, v) = (i % 640, i / 640);
        let black = contains(&pixels, [f64::from(u), f64::from(v)]);
        whole.at(u, v).filter(|_| !black).unwrap_or(0.0) as f32
    });
    let black = DepthImage::from_metres(640, 480, metres.collect()).unwrap();
    let hole = report(&black, &[]).largest_hole().unwrap();
    assert!((hole.area_m2 / 30e-4 - 1.0).abs() < 0.25, "{hole:?}");
    assert!((hole.centre[0] - 0.06).hypot(hole.centre[1] - 0.045) < 0.005, "{hole}");
    // A known object that is black explains it.
    assert_eq!(report(&black, &[known(0.06, 0.045, 0.06, 0.05, 0.02)]).largest_hole(), None);
}

#[test]
fn what_a_known_object_hides_is_no_hole() {
    // 12 cm high at the side of the picture: 3 cm of table lie in its shadow.
    let tower = block(0.14, 0.0, 0.03, 0.1, 0.12);
    let report = |known: &[KnownBody]| {
        let map = map(&[tower], 0.0, 0.0);
        find(&[&map], known, &[], &ForeignLimits::default()).largest_hole()
    };
    let unexplained = report(&[]);
    assert!(unexplained.as_ref().is_some_and(|hole| hole.area_m2 > 8e-4), "{unexplained:?}");
    let explained = report(&[known(0.14, 0.0, 0.03, 0.1, 0.12)]);
    assert!(explained.as_ref().is_none_or(|hole| hole.area_m2 < 3e-4), "{explained:?}");
}

#[test]
fn what_is_the_robots_or_lies_outside_what_is_searched_is_left_out() {
    let stranger = block(0.05, 0.05, 0.04, 0.04, 0.05);
    let place = KeepOut { footprint: Footprint::disc(0.06).unwrap(), pose: Pose2::new(0.05, 0.05, 0.0) };
    let limits = ForeignLimits::default();
    let seen = map(&[stranger], 0.0, 0.0);
    assert_eq!(find(&[&seen], &[], &[place], &limits).objects, []);
    // The same thing hanging under the wrist as the gripper does.
    let lens = DepthLens::new(&testing::camera(640, 480)).unwrap();
    let eye = eye(0.0);
    let tool = eye.inverse() * Point3::new(0.05, 0.05, 0.0);
    let own = OwnBody {
        body_m: 0.0,
        camera_from_tool: Isometry3::translation(tool.x, tool.y, tool.z),
        radius_m: 0.06,
        beyond_m: 0.005,
    };
    let depth = picture(&eye, &[stranger], 0.0, 0.0);
    let with = HeightMap::new(&depth, &lens, &eye, AREA, Some(&own)).unwrap();
    let without = HeightMap::new(&depth, &lens, &eye, AREA, None).unwrap();
    assert_eq!(find(&[&without], &[], &[], &limits).objects.len(), 1);
    assert_eq!(find(&[&with], &[], &[], &limits).objects, []);
}

/// A plank on the cups of a camera beside them is neither a stranger nor proof of free room behind it; what
/// lies elsewhere is seen all the same.
#[test]
fn what_is_held_is_left_out_with_what_it_hides_and_nothing_else() {
    let (plank, stranger) = (block(0.05, 0.05, 0.16, 0.05, 0.05), block(-0.1, -0.08, 0.04, 0.04, 0.05));
    let seen = map(&[plank, stranger], 0.0, 0.0);
    assert_eq!(find(&[&seen], &[], &[], &ForeignLimits::default()).objects.len(), 2);
    // The cups over the plank, pointing down.
    let down = nalgebra::UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let tool = Isometry3::from_parts(nalgebra::Translation3::new(0.05, 0.05, 0.05), down);
    let held = HeldBody {
        outline: vec![[-0.08, -0.025], [0.08, -0.025], [0.08, 0.025], [-0.08, 0.025]],
        below_m: 0.05,
    };
    let bare = seen.without_held(&held, &tool);
    let left = find(&[&bare], &[], &[], &ForeignLimits::default()).objects;
    assert_eq!(left.len(), 1, "{left:?}");
    assert!((left[0].centre[0] + 0.1).abs() < 0.02, "{left:?}");
    let height = |map: &HeightMap, x: f64, y: f64| map.cell([x, y]).map(|cell| map.heights_m[cell]);
    assert!(height(&bare, 0.05, 0.05).is_some_and(f32::is_nan), "of its place nothing is known");
    assert_eq!(height(&bare, -0.1, 0.08), height(&seen, -0.1, 0.08), "the table elsewhere");
    // Short and out of sight it hides nothing of the other thing.
    let away = Isometry3::from_parts(nalgebra::Translation3::new(0.5, 0.5, 0.3), down);
    assert_eq!(
        find(&[&seen.without_held(&held, &away)], &[], &[], &ForeignLimits::default()).objects.len(),
        2
    );
}

#[test]
fn what_one_look_pose_saw_is_not_forgotten_by_the_next() {
    let (there, gone) = (map(&[block(0.05, 0.05, 0.04, 0.04, 0.05)], 0.0, 0.0), map(&[], 0.0, 0.0));
    let report = find(&[&gone, &there, &gone], &[], &[], &ForeignLimits::default());
    assert_eq!(report.objects.len(), 1, "a hand that came and went");
}

#[test]
fn a_depth_picture_of_another_size_is_refused() {
    let lens = DepthLens::new(&testing::camera(640, 480)).unwrap();
    let depth = DepthImage::from_metres(4, 4, vec![0.5; 16]).unwrap();
    let error = HeightMap::new(&depth, &lens, &eye(0.0), AREA, None).unwrap_err();
    assert!(error.to_string().contains("4 x 4") && error.to_string().contains("640 x 480"), "{error}");
}

#[test]
fn as_an_obstacle_it_keeps_the_margin_on_every_side() {
    let [object] = &found(&[block(0.1, -0.06, 0.05, 0.04, 0.06)], &[])[..] else { panic!() };
    let keep_out = object.keep_out(0.01).unwrap();
    let outline = keep_out.footprint.outline(64);
    for corner in &object.outline {
        assert!(contains(&outline, *corner));
        assert!(distance_to_outline(&outline, *corner) >= 0.01 - 1e-9);
    }
    assert!(object.keep_out(0.0).is_some());
}

#[test]
fn of_a_part_of_the_table_only_the_part_has_to_be_measured() {
    let blocks = [block(-0.1, 0.0, 0.03, 0.03, 0.04), block(0.12, 0.0, 0.03, 0.03, 0.04)];
    let mut seen = map(&blocks, 0.01, 0.0);
    // Nothing is measured far to the right.
    let right = (0..seen.heights_m.len()).filter(|cell| seen.centre(*cell)[0] > 0.16).collect::<Vec<_>>();
    right.into_iter().for_each(|cell| seen.heights_m[cell] = f32::NAN);
    let within = |region: &Region| find_in(&[&seen], &[], &[], &ForeignLimits::default(), Some(region));
    let left = within(&Region::disc([-0.1, 0.0], 0.06));
    assert_eq!((left.objects.len(), left.largest_hole()), (2, None), "{left:?}");
    let hole = within(&Region::disc([0.18, 0.1], 0.03));
    assert!(hole.objects.len() == 2 && hole.largest_hole().is_some(), "{hole:?}");
    let all = find(&[&seen], &[], &[], &ForeignLimits::default());
    assert_eq!(all.objects.len(), 2);
    // A strip beside the block is hidden by it; what need not be measured does not count.
    assert!(left.measured_share > 0.95 && left.measured_share > all.measured_share + 0.02, "{left:?}");
}
