//! What the swept check sees, and what it lets pass.

use crate::bodies::cell::NamedShape;
use crate::bodies::shape::{Shape, apart};
use crate::bodies::sweep::{STRAIGHT, Sweep, Zone};
use crate::bodies::{Bodies, Room, Standing, Surroundings, Tabletop};
use crate::path::{ArmModel, CheckedPath, Leg, PathFault, Segment};
use crate::pick_n_place::{plan, tool_down};
use crate::testing::{cell, cycle, home, model, task, up_to};
use crate::way::{NoWay, Search, find};
use cell_values::units::Joints;
use nalgebra::Isometry3;
use parry3d_f64::math::Pose;
use rand::{RngExt, SeedableRng};
use rearrange::geometry::footprint::Footprint;
use rearrange::geometry::pose::Pose2;
use ur_arm::kinematics::{DhParameters, model_of};
use ur_arm::links::misfits;
use ur_arm::testing::PUBLISHED;

/// The demo's arm with this beside it.
fn beside(name: &str, shape: Shape) -> ArmModel {
    let mut model = model(0.5);
    let mut cell = cell();
    cell.equipment.push(NamedShape { name: name.to_string(), shape });
    let surroundings = Surroundings {
        base_from_table: model.base_from_table,
        flange_from_tool: model.flange_from_tool,
        table: [0.5, 0.5],
        link_floor: 0.03,
        cell,
    };
    model.bodies = Bodies::new(model.kinematics.dh(), &surroundings);
    model
}

/// A joint move of the base from one side of the table to the other.
fn across(model: &ArmModel) -> (Joints, Joints) {
    let at =
        |x: f64| model.joints_in_work_posture(&tool_down(x, 0.35, 0.2, 0.0), &model.home).expect("in reach");
    (at(0.05), at(0.45))
}

fn meeting(model: &ArmModel, room: &Room) -> Option<[String; 2]> {
    let (from, to) = across(model);
    let segment = Segment::Joint { target: to, speed: 1.0, acceleration: 2.0, blend: 0.0 };
    match CheckedPath::new(model, &from, &[Leg::over(segment, f64::NEG_INFINITY)], room) {
        Ok(_) => None,
        Err(PathFault::Meets { one, other, .. }) => Some([one, other]),
        Err(fault) => panic!("{fault}"),
    }
}

#[test]
fn a_thin_post_in_the_middle_of_the_way_is_not_stepped_over() {
    assert_eq!(meeting(&model(0.5), &Room::empty()), None);
    // 2 mm thick, between the ends of a move of 0.4 m.
    let post = Shape::cylinder(0.001, 0.3, &Isometry3::translation(0.0, 0.53, 0.0));
    let met = meeting(&beside("the post", post), &Room::empty()).expect("in the way");
    assert_eq!(met[1], "the post", "{met:?}");
    // The same post beyond the reach of gripper and camera.
    let post = Shape::cylinder(0.001, 0.3, &Isometry3::translation(0.0, 0.9, 0.0));
    assert_eq!(meeting(&beside("the post", post), &Room::empty()), None);
}

#[test]
fn a_wall_and_what_is_carried_count() {
    let wall = |y: f64| Shape::half_space([0.0, y, 0.0], [0.0, -1.0, 0.0]);
    assert_eq!(meeting(&beside("the wall", wall(0.75)), &Room::empty()), None);
    assert!(meeting(&beside("the wall", wall(0.55)), &Room::empty()).is_some());
    // A plank of 0.4 m below the cups reaches as far as the wall that the empty gripper passes.
    let model = beside("the wall", wall(0.70));
    assert_eq!(meeting(&model, &Room::empty()), None);
    let mut plank = task(Pose2::default(), Pose2::default(), [0.0, 0.0]);
    plank.footprint = Footprint::Rectangle { length: 0.02, width: 0.4 };
    let carried = Room::empty().holding(&model.bodies, Some(&plank.hanging(0.0)));
    let met = meeting(&model, &carried).expect("reaches the wall");
    assert_eq!(met, ["disc".to_string(), "the wall".to_string()]);
}

#[test]
fn what_may_lie_on_the_table_is_passed_over_and_between_the_objects_each_counts() {
    let model = model(0.5);
    let low = Room::new(&model.bodies, &up_to(0.1), None);
    assert_eq!(meeting(&model, &low), None);
    let high = Room::new(&model.bodies, &up_to(0.21), None);
    assert!(meeting(&model, &high).is_some(), "the cups are 0.2 m over the table");
    let tall = crate::pick_n_place::CycleParameters { tallest: 0.15, ..cycle() };
    // A tower of 0.15 m beside the object: the gripper's body, 0.08 m over the cups, would touch it.
    let tower = |x: f64| {
        let standing = Standing {
            name: "tower".to_string(),
            footprint: Footprint::Disc { radius: 0.02 },
            pose: Pose2::new(x, 0.25, 0.0),
            height: 0.15,
        };
        tall.tabletop(vec![standing])
    };
    let picked = task(Pose2::new(0.2, 0.25, 0.0), Pose2::new(0.2, 0.4, 0.0), [0.0, 0.0]);
    let try_beside = |x: f64| plan(&model, &home(&model, 0.5), &picked, &tall, &tower(x));
    let fault = try_beside(0.25).expect_err("too near").to_string();
    assert!(fault.contains("tower") && fault.contains("gripper"), "{fault}");
    assert!(try_beside(0.35).is_ok(), "{:?}", try_beside(0.35).err());
}

#[test]
fn from_a_folded_wrist_there_is_a_way_and_from_inside_of_itself_none() {
    let model = model(0.5);
    let empty = Room::empty();
    let folded = Joints([-30.2, -136.8, 129.9, 36.4, -92.1, -70.0].map(f64::to_radians));
    let target = home(&model, 0.5);
    let search = Search { seed: 1, steps: 1500 };
    let mut sweep = Sweep::new(&model.bodies, &empty);
    let on = |share: f64| folded.lerp(&target, share);
    let met = sweep.way(&folded, &target).expect_err("the gripper would pass through the upper arm");
    assert!([met.one, met.other].iter().any(|name| name.contains("upper arm")));
    let way = find(&model, &empty, &folded, &target, search).expect("round it");
    assert!(way.len() > 1 && way.last() == Some(&target), "{way:?}");
    // On the straight way: where the two are too near, and where they are in each other.
    let mut distances = (0..2000).filter_map(|k| {
        let q = on(f64::from(k) / 2000.0);
        sweep.place(&q, Zone::Over).err().map(|meeting| (q, meeting.distance))
    });
    let (near, distance) = distances.next().expect("too near somewhere");
    assert!(distance > 0.0, "{distance}");
    find(&model, &empty, &near, &target, search).expect("from a place that is only too near");
    let (inside, _) = distances.find(|(_, distance)| *distance <= 0.0).expect("inside somewhere");
    let found = find(&model, &empty, &inside, &target, search);
    assert!(matches!(found, Err(NoWay::Start(_))), "{found:?}");
}

#[test]
fn a_way_leads_round_what_is_between_and_never_beyond_a_joints_range() {
    let slab = Shape::cuboid([0.01, 0.3, 0.5], &Isometry3::translation(0.0, 0.55, 0.1));
    let model = beside("the slab", slab);
    let (from, to) = across(&model);
    assert!(meeting(&model, &Room::empty()).is_some());
    let search = Search { seed: 1, steps: 1500 };
    let way = find(&model, &Room::empty(), &from, &to, search).expect("over the slab");
    assert!(way.len() > 1 && way.last() == Some(&to), "{way:?}");
    let empty = Room::empty();
    let mut sweep = Sweep::new(&model.bodies, &empty);
    let mut at = from;
    for next in &way {
        sweep.way(&at, next).expect("free");
        assert_eq!(model.outside_range(next), None);
        at = *next;
    }
    let again = find(&model, &Room::empty(), &from, &to, search).expect("the same");
    assert_eq!(way, again);
    let mut beyond = to;
    beyond.0[0] += 10.0;
    assert_eq!(
        find(&model, &Room::empty(), &from, &beyond, search),
        Err(NoWay::Range { place: "there", joint: 1 })
    );
}

#[test]
fn lines_are_slowed_to_what_joints_and_vacuum_stand() {
    let model = model(0.5);
    let near = |x: f64, y: f64, z: f64| {
        model.joints_in_work_posture(&tool_down(x, y, z, 0.0), &model.home).expect("in reach")
    };
    let line = |from: Joints, target: Joints, hold: f64| {
        let segment = Segment::Linear { target, speed: 0.5, acceleration: 2.0, blend: 0.0 };
        let leg = Leg::over(segment, f64::NEG_INFINITY).holding(hold);
        let path = CheckedPath::new(&model, &from, &[leg], &Room::empty()).expect("sound");
        let Segment::Linear { speed, acceleration, .. } = path.segments()[0] else { panic!("a line") };
        (speed, acceleration)
    };
    // In the middle of the table nothing is slowed; near the base the first joint is too slow for it.
    let easy = line(near(0.2, 0.35, 0.2), near(0.3, 0.35, 0.2), f64::INFINITY);
    assert_eq!(easy.0, 0.5);
    let (speed, _) = line(near(0.15, 0.0, 0.2), near(0.35, 0.0, 0.2), f64::INFINITY);
    let fastest = joint_speed_on(&model, &near(0.15, 0.0, 0.2), &near(0.35, 0.0, 0.2), speed);
    assert!(fastest <= model.limits.joint_speed * 1.01, "{fastest} rad/s at {speed} m/s");
    assert_eq!(line(near(0.2, 0.35, 0.2), near(0.3, 0.35, 0.2), 0.4).1, 0.4);
    // A joint move with something on the cups.
    let (from, target) = across(&model);
    let segment = Segment::Joint { target, speed: 2.0, acceleration: 4.0, blend: 0.0 };
    let speeds = |hold: f64| {
        let leg = Leg::over(segment, f64::NEG_INFINITY).holding(hold);
        let path = CheckedPath::new(&model, &from, &[leg], &Room::empty()).expect("sound");
        let Segment::Joint { speed, acceleration, .. } = path.segments()[0] else { panic!("a joint move") };
        (speed, acceleration)
    };
    assert_eq!(speeds(100.0), (2.0, 4.0));
    let (speed, acceleration) = speeds(1.0);
    assert!(speed < 2.0 && acceleration < 4.0, "{speed} {acceleration}");
}

/// The fastest joint (rad/s) on a straight line at this speed of the tool.
fn joint_speed_on(model: &ArmModel, from: &Joints, to: &Joints, speed: f64) -> f64 {
    let (start, end) = (model.tool_at(from), model.tool_at(to));
    let length = (end.translation.vector - start.translation.vector).norm();
    let mut near = *from;
    let mut fastest: f64 = 0.0;
    for k in 1..=400 {
        let share = f64::from(k) / 400.0;
        let position = start.translation.vector.lerp(&end.translation.vector, share);
        let tool = Isometry3::from_parts(position.into(), start.rotation);
        let q = model.joints_at(&tool, &near).expect("in reach");
        fastest = fastest.max(q.max_difference(&near) / (length / 400.0 / speed));
        near = q;
    }
    fastest
}

#[test]
fn the_grippers_body_fills_what_is_between_the_cups_and_the_flange() {
    let cell = cell();
    let gripper = cell.tool.iter().find(|named| named.name == "the gripper").expect("there");
    let at = |z: f64| {
        let hair = Shape::cuboid([1e-3; 3], &Isometry3::translation(0.0, 0.0, z));
        apart(&gripper.shape, &Pose::IDENTITY, &hair, &Pose::IDENTITY)
    };
    // The cup lips are 0.2 m from the flange, the body begins 0.08 m above them.
    for z in [0.0, 0.03, 0.08, 0.12] {
        assert!(at(z) < 0.0, "{z}");
    }
    assert!(at(-0.01) > 0.008 && at(0.13) > 0.008, "{} {}", at(-0.01), at(0.13));
    let folded = Joints([-81.4, -104.3, -35.7, 149.0, 140.9, -5.7].map(f64::to_radians));
    let (model, empty) = (model(0.5), Room::empty());
    let met = Sweep::new(&model.bodies, &empty).place(&folded, Zone::Over).expect_err("in the forearm");
    assert_eq!([met.one, met.other], ["the forearm", "the gripper"]);
}

/// The demo's arm on another stand, its table far below.
fn on_a_stand(stand: Shape) -> Bodies {
    let mut cell = cell();
    cell.stand = Some(stand);
    let surroundings = Surroundings {
        base_from_table: Isometry3::translation(-0.25, 0.18, -1.0),
        flange_from_tool: Isometry3::translation(0.0, 0.0, 0.2),
        table: [0.5, 0.5],
        link_floor: 0.03,
        cell,
    };
    Bodies::new(&DhParameters::UR5E, &surroundings)
}

#[test]
fn the_upper_arm_keeps_clear_of_a_stand_that_is_wider_than_the_base() {
    let riser = Shape::cuboid([0.4, 0.4, 0.3], &Isometry3::translation(0.0, 0.0, -0.15));
    let pedestal = Shape::cylinder(0.3, 0.6, &Isometry3::translation(0.0, 0.0, -0.6));
    let cases =
        [(riser, [14.4, 47.4, -116.8, -6.0, -75.0, 0.0]), (pedestal, [14.9, 22.6, 6.9, -10.2, 83.5, 0.0])];
    for (stand, degrees) in cases {
        let (bodies, empty) = (on_a_stand(stand), Room::empty());
        let met = Sweep::new(&bodies, &empty).place(&Joints(degrees.map(f64::to_radians)), Zone::Over);
        let met = met.expect_err("the upper arm is in the stand");
        assert_eq!([met.one, met.other], ["the upper arm", "the robot's stand"]);
        // Upright, every arm is clear of what it stands on, turned as it may be.
        for turn in [-3.0, -1.0, 0.7, 2.0] {
            let upright = Joints([turn, -1.6, 1.9, -1.9, -1.57, 0.0]);
            assert_eq!(Sweep::new(&bodies, &empty).place(&upright, Zone::Over), Ok(()));
        }
    }
}

#[test]
fn a_post_inside_of_a_corner_is_met_by_the_way_that_cuts_it() {
    let plain = model(0.5);
    let at = |x: f64, y: f64| {
        plain.joints_in_work_posture(&tool_down(x, y, 0.2, 0.0), &plain.home).expect("in reach")
    };
    let corner = [at(0.05, 0.25), at(0.25, 0.25), at(0.25, 0.45)];
    // In the middle of the parabola that touches both legs 0.15 m before the corner, and on the straight way
    // between these two places; the cups are lower than the post.
    for place in [[-0.0375, 0.4675], [-0.1125, 0.4675]] {
        let post = Shape::cylinder(0.001, 0.25, &Isometry3::translation(place[0], place[1], 0.0));
        let model = beside("the post", post);
        let met = |blend: f64| {
            let line = |target, blend| Segment::Linear { target, speed: 0.2, acceleration: 1.0, blend };
            let legs = [line(corner[1], blend), line(corner[2], 0.0)].map(|segment| Leg::over(segment, 0.0));
            CheckedPath::new(&model, &corner[0], &legs, &Room::empty()).err()
        };
        assert_eq!(met(0.0), None);
        assert_eq!(met(0.02), None, "so small a corner does not reach it");
        let fault = met(0.15).expect("in the way");
        assert!(fault.names("the post"), "{fault}");
    }
}

#[test]
fn what_rests_too_near_does_not_come_back_once_it_has_left_and_not_nearer_by_and_by() {
    // A wall 3 mm from where the gripper's camera is, which keeps 5 mm.
    let start = across(&model(0.5)).0;
    let wall = |gap: f64| {
        let plain = model(0.5);
        let empty = Room::empty();
        let distance = |y: f64| {
            let model = beside("the wall", Shape::half_space([0.0, y, 0.0], [0.0, -1.0, 0.0]));
            Sweep::new(&model.bodies, &empty).place(&start, Zone::Over).is_ok()
        };
        let (mut near, mut far) = (0.2, 1.2);
        for _ in 0..40 {
            let middle = 0.5 * (near + far);
            if distance(middle) { far = middle } else { near = middle }
        }
        assert!(plain.outside_range(&start).is_none());
        beside("the wall", Shape::half_space([0.0, far - 0.005 + gap, 0.0], [0.0, -1.0, 0.0]))
    };
    let path = |model: &ArmModel, points: &[Joints]| {
        let legs = points.iter().map(|target| {
            Leg::over(
                Segment::Joint { target: *target, speed: 1.0, acceleration: 2.0, blend: 0.0 },
                f64::NEG_INFINITY,
            )
        });
        CheckedPath::new(model, &start, &legs.collect::<Vec<_>>(), &Room::empty()).err()
    };
    let mut away = start;
    away.0[1] -= 0.3;
    let model = wall(0.003);
    assert_eq!(path(&model, &[away]), None, "it may leave");
    let back = path(&model, &[away, start]).expect("but not come back");
    assert!(back.names("the wall"), "{back}");
    let mut nearer = start;
    nearer.0[1] += 0.02;
    assert!(path(&model, &[nearer]).is_some(), "nor come nearer");
    let touching = path(&wall(0.0015), &[away]).expect("too near to tell from touching");
    assert!(touching.met_at_start().is_some(), "{touching}");
}

#[test]
fn what_sticks_out_behind_the_flange_is_kept_clear_of_wrist_2() {
    let plain = model(0.5);
    let mut with_arm = cell();
    let behind = Shape::cuboid([0.01, 0.01, 0.12], &Isometry3::translation(0.06, 0.0, -0.05));
    with_arm.tool.push(NamedShape { name: "the arm of the lamp".to_string(), shape: behind });
    let surroundings = Surroundings {
        base_from_table: plain.base_from_table,
        flange_from_tool: plain.flange_from_tool,
        table: [0.5, 0.5],
        link_floor: 0.03,
        cell: with_arm,
    };
    let (bodies, empty) = (Bodies::new(plain.kinematics.dh(), &surroundings), Room::empty());
    let mut sweep = Sweep::new(&bodies, &empty);
    let met: Vec<Option<String>> = (0..36)
        .map(|k| {
            let mut q = home(&plain, 0.5);
            q.0[5] = f64::from(k) * 0.1745;
            let met = sweep.place(&q, Zone::Over).err()?;
            assert_eq!(met.other, "the arm of the lamp");
            Some(met.one)
        })
        .collect();
    assert!(met.iter().any(|one| one.as_deref() == Some("wrist 2")), "{met:?}");
    assert!(met.iter().any(Option::is_none), "{met:?}");
}

#[test]
fn the_raised_edge_of_what_hangs_tilted_counts() {
    let model = model(0.5);
    let mut plank = task(Pose2::default(), Pose2::default(), [0.0, 0.0]);
    plank.footprint = Footprint::Rectangle { length: 0.02, width: 0.4 };
    let body = model.bodies.loaded(&plank.hanging(0.0));
    // Flange frame, z down: the lips are at 0.2, the edge 0.2 m aside is up to 10 mm higher.
    let over = |z: f64| {
        let up = Shape::half_space([0.0, 0.0, z], [0.0, 0.0, 1.0]);
        apart(&body.shape, &Pose::IDENTITY, &up, &Pose::IDENTITY)
    };
    assert!((over(0.19)).abs() < 1e-3, "{}", over(0.19));
    let under = Shape::half_space([0.0, 0.0, 0.2 + plank.depth()], [0.0, 0.0, -1.0]);
    let lowest = apart(&body.shape, &Pose::IDENTITY, &under, &Pose::IDENTITY);
    assert!(lowest.abs() < 1e-9, "{lowest}");
}

#[test]
fn what_is_no_number_is_never_free() {
    let nan = Shape::hull([[0.0, 0.0, 9.0], [f64::NAN, 0.0, 9.0]], 0.0);
    assert!(meeting(&beside("the thing", nan), &Room::empty()).is_some());
    assert!(meeting(&beside("nothing", Shape::hull([], 0.0)), &Room::empty()).is_some());
    let model = model(0.5);
    let (from, to) = across(&model);
    let path = |q: Joints, hold: f64, speed: f64| {
        let leg =
            Leg::over(Segment::Joint { target: q, speed, acceleration: 2.0, blend: 0.0 }, f64::NEG_INFINITY);
        CheckedPath::new(&model, &from, &[leg.holding(hold)], &Room::empty())
    };
    assert!(path(to, 20.0, 1.0).is_ok());
    for hold in [0.0, -1.0, f64::NAN] {
        assert!(path(to, hold, 1.0).is_err(), "{hold}");
    }
    let nowhere = Joints([to.0[0], f64::NAN, to.0[2], to.0[3], to.0[4], to.0[5]]);
    assert!(path(nowhere, 20.0, 1.0).is_err() && path(to, 20.0, f64::NAN).is_err());
    let empty = Room::empty();
    let mut sweep = Sweep::new(&model.bodies, &empty);
    assert!(sweep.way(&from, &nowhere).is_err() && sweep.way(&nowhere, &from).is_err());
}

#[test]
fn what_stands_higher_than_anything_may_lie_is_passed_over_too() {
    let model = model(0.5);
    let tower = |layer: f64, height: f64| {
        let standing = Standing {
            name: "tower".to_string(),
            footprint: Footprint::Disc { radius: 0.02 },
            pose: Pose2::new(0.25, 0.35, 0.0),
            height,
        };
        Room::new(&model.bodies, &Tabletop { standing: vec![standing], ..up_to(layer) }, None)
    };
    assert_eq!(meeting(&model, &tower(0.0, 0.15)), None);
    for (layer, height) in [(0.0, 0.3), (0.1, 0.3), (0.1, f64::INFINITY)] {
        assert!(meeting(&model, &tower(layer, height)).is_some(), "{layer} {height}");
    }
}

/// Up from a pick in the middle of the table, with the corner at the lowest height there is, and on along x.
fn round_a_corner(blend: f64, table: &Tabletop) -> Result<CheckedPath, PathFault> {
    let model = model(0.5);
    let at = |x: f64, z: f64| {
        model.joints_in_work_posture(&tool_down(x, 0.25, z, 0.0), &model.home).expect("in reach")
    };
    let up = Segment::Linear { target: at(0.2, 0.05), speed: 0.2, acceleration: 1.0, blend };
    let on = Segment::Joint { target: at(0.4, 0.08), speed: 1.0, acceleration: 2.0, blend: 0.0 };
    let legs = [Leg::between(up, 0.018), Leg::over(on, f64::NEG_INFINITY)];
    CheckedPath::new(&model, &at(0.2, 0.019), &legs, &Room::new(&model.bodies, table, None))
}

#[test]
fn a_corner_is_cut_where_it_stays_over_what_may_lie_there() {
    let table = cycle().tabletop(Vec::new());
    // 50 mm over the table, on which anything may be 20 mm high; 5 mm are kept, and 15 mm on the way.
    assert!(round_a_corner(0.024, &table).is_ok(), "{:?}", round_a_corner(0.024, &table).err());
    let fault = round_a_corner(0.027, &table).expect_err("too low");
    assert!(fault.names("what may lie on the table"), "{fault}");
    let unseen = up_to(cycle().layer());
    assert!(round_a_corner(0.014, &unseen).is_ok() && round_a_corner(0.024, &unseen).is_err());
}

#[test]
fn a_corner_is_cut_clear_of_what_is_higher_than_others() {
    let beside = |height: f64| {
        let standing = Standing {
            name: "a thing without a marker".to_string(),
            footprint: Footprint::Disc { radius: 0.01 },
            // The cup comes down 2 mm beside it.
            pose: Pose2::new(0.222, 0.25, 0.0),
            height,
        };
        cycle().tabletop(vec![standing])
    };
    assert!(round_a_corner(0.024, &beside(0.02)).is_ok());
    let fault = round_a_corner(0.024, &beside(0.034)).expect_err("into it");
    assert!(fault.names("a thing without a marker"), "{fault}");
    assert!(round_a_corner(0.01, &beside(0.034)).is_ok());
}

#[test]
fn between_the_objects_the_tool_does_not_turn_and_the_elbow_stays_over_what_may_lie_there() {
    let model = model(0.5);
    let at = |z: f64, yaw: f64| {
        model.joints_in_work_posture(&tool_down(0.25, 0.25, z, yaw), &model.home).expect("in reach")
    };
    let down = |yaw: f64, layer: f64| {
        let segment = Segment::Linear { target: at(0.05, yaw), speed: 0.2, acceleration: 1.0, blend: 0.0 };
        let room = Room::new(&model.bodies, &up_to(layer), None);
        CheckedPath::new(&model, &at(0.2, 0.0), &[Leg::between(segment, 0.0)], &room).err()
    };
    assert_eq!(down(0.0, 0.15), None);
    assert!(matches!(down(0.1, 0.15), Some(PathFault::Turning { .. })), "{:?}", down(0.1, 0.15));
    // Nothing was seen of a table on which things as high as the forearm may stand.
    let fault = down(0.0, 0.45).expect("too near");
    assert!(fault.names("the forearm") || fault.names("the upper arm"), "{fault}");
}

#[test]
fn nowhere_on_an_accepted_way_is_anything_nearer_than_it_may() {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(23);
    let post = Shape::cylinder(0.04, 0.35, &Isometry3::translation(0.1, 0.55, 0.0));
    let model = beside("the post", post);
    let (mut accepted, mut refused) = (0, 0);
    while accepted < 400 {
        let size = [0.02, 0.1, 0.6][random.random_range(0..3)];
        let (x, y) = (random.random_range(-0.1..0.6), random.random_range(0.0..0.6));
        let tool = tool_down(x, y, random.random_range(0.02..0.4), random.random_range(-3.0..3.0));
        let Some(from) = model.joints_in_work_posture(&tool, &model.home) else { continue };
        let to = Joints(from.0.map(|q| q + random.random_range(-size..size)));
        let room = Room::empty();
        let mut sweep = Sweep::new(&model.bodies, &room);
        if sweep.way(&from, &to).is_err() {
            refused += 1;
            continue;
        }
        accepted += 1;
        // The next piece starts at the end of the first and reuses the distances that remain.
        let on = Joints(to.0.map(|q| q + random.random_range(-0.02..0.02)));
        let both = sweep.piece(&to, &on, Zone::Over, &STRAIGHT).is_ok();
        let pieces = [(from, to), (to, on)];
        for (a, b) in &pieces[..if both { 2 } else { 1 }] {
            for k in 0..=60 {
                let q = a.lerp(b, f64::from(k) / 60.0);
                for (pair, distance) in sweep.too_near(&q) {
                    let wanted = sweep.wanted(pair);
                    assert!(distance >= wanted - 6e-4, "{pair}: {distance} of {wanted} m at {q:?}");
                }
            }
        }
    }
    assert!(refused > 50, "ways that meet something: {refused}");
}

/// The tables of real arms put frames hundreds of metres away along their axes. What is checked lies where
/// the arm is, no lever is longer than the arm, and capsules are wider by some millimetres at most.
#[test]
fn the_bodies_of_a_real_arm_are_where_its_links_are() {
    let far = PUBLISHED.iter().filter(|dh| dh.d[1].abs() > 100.0).count();
    assert_eq!(far, 2, "tables as those of real arms");
    for dh in PUBLISHED {
        let (bodies, nominal) = (Bodies::bare(&dh), Bodies::bare(&model_of(&dh).dh));
        let misfits = misfits(&dh, &model_of(&dh).dh);
        assert!((1e-3..8e-3).contains(&misfits[2]), "{misfits:?}");
        for (body, ideal) in bodies.moving.iter().zip(&nominal.moving) {
            let longest = bodies.levers(body, 0).into_iter().fold(0.0, f64::max);
            assert!(longest < 2.5, "{}: {longest} m", body.name);
            let wider = body.shape.thickness() - ideal.shape.thickness();
            let misfit = match body.part {
                super::Part::Link(link @ 1..) => misfits[link - 1],
                _ => 0.0,
            };
            assert!((wider - misfit).abs() < 1e-12, "{}: {wider} m", body.name);
        }
        for k in 0..50 {
            let q =
                Joints(std::array::from_fn(|joint| (f64::from(k) * 0.7 + joint as f64 * 1.3).sin() * 3.0));
            let pairs = bodies.frames(&q).into_iter().zip(nominal.frames(&q));
            for (link, (found, ideal)) in pairs.enumerate() {
                let apart = (found.translation - ideal.translation).length();
                assert!(apart < 8e-3, "link {link} at {q:?}: {apart} m");
                let turned = found.rotation.angle_between(ideal.rotation);
                assert!(turned < 0.025, "link {link} at {q:?}: {turned} rad");
            }
        }
    }
}
