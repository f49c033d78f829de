//! One pick-n-place as three checked paths: to the pick, with the object to the place, and away.
//!
//! In: the arm, where it is, the object's pose before and after, where on it the cups sit, and the heights.
//! Out: [`PickNPlacePaths`]; the gripper acts between them (grip and verify, release). Pure.
//! The tool stays vertical and the arm in the posture of its home pose. The tool's yaw is free, so a ring of
//! yaws is tried, cheapest joint travel first, and the first that passes the path check is taken. Where the
//! straight joint moves of none are free, a way round is searched for the cheapest of them.

pub(crate) mod pieces;

use crate::bodies::{Load, Room, Standing, Tabletop};
pub use crate::cycle::CycleParameters;
use crate::path::{ArmModel, CheckedPath, Leg, PathFault, Segment, out_of_reach};
use crate::pick_n_place::pieces::{corner, joint, linear, metres, round, widest};
use crate::way::Search;
use cell_values::units::Joints;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use rearrange::geometry::footprint::Footprint;
use rearrange::geometry::pose::{Pose2, wrap_angle};
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};

/// What has to be carried where; poses of the object's footprint origin in the table frame.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
pub struct PickNPlace {
    /// Name of the object.
    pub object: String,
    /// Its outline.
    pub footprint: Footprint,
    /// Where the object is.
    pub from: Pose2,
    /// Where it shall be.
    pub to: Pose2,
    /// Where the tool's axis meets the object, in the object frame, m.
    pub grip_point: [f64; 2],
    /// Tool yaw in the object frame that the cups need, rad; `None` when any will do (one cup).
    pub grip_yaw: Option<f64>,
    /// Height of the object, m: the cups touch it there.
    pub height: f64,
    /// Largest acceleration of the tool that the vacuum holds the object at, m/s2.
    pub hold: f64,
}

impl PickNPlace {
    /// The object on the table.
    pub fn lying_at(&self, pose: Pose2) -> Standing {
        let (name, footprint) = (self.object.clone(), self.footprint.clone());
        Standing { name, footprint, pose, height: self.height }
    }

    /// How far it may reach below the cups while it is carried, m.
    pub fn depth(&self) -> f64 {
        self.hanging(0.0).depth()
    }

    /// The object hanging on a tool that came down on it with this yaw.
    pub(crate) fn hanging(&self, yaw: f64) -> Load {
        let [x, y] = self.from.transform(self.grip_point);
        let tool = Pose2::new(x, y, yaw);
        Load {
            name: self.object.clone(),
            footprint: self.footprint.clone(),
            tool_from_object: tool.inverse().compose(&self.from),
            height: self.height,
        }
    }
}

/// The three paths of one pick-n-place.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
pub struct PickNPlacePaths {
    /// From where the arm is, over the object, down until the cups touch.
    pub approach: CheckedPath,
    /// Up, over, down to the new place.
    pub carry: CheckedPath,
    /// Straight up from the pick again, for a grip that failed.
    pub give_up: CheckedPath,
    /// Straight up.
    pub retreat: CheckedPath,
}

/// How many yaws a single cup may try.
pub(crate) const YAWS: usize = 16;

/// How many of the cheapest candidates go through the full check before the move is given up.
const CANDIDATES: usize = 48;

/// From where on the last joint counts as turned far, rad, and by what share of the rest.
const WOUND_FROM_RAD: f64 = 0.75 * PI;
const WOUND: f64 = 0.3;

/// A transfer along a line turns the object by this much at most, rad.
const LINE_TURN_RAD: f64 = 0.35;

/// Of these a way round is searched for, where no candidate's straight moves are free.
const SEARCHED: usize = 2;

/// How far: twice for each of them, to the pick and with the object.
const SEARCH: Search = Search { seed: 1, steps: 400 };

/// Plans the three paths from the joints `start` (the arm at rest, gripper empty). `table` is what lies on
/// it besides the object.
///
/// # Errors
/// The fault of the cheapest candidate, or that a pose has no joint solution at all.
pub fn plan(
    model: &ArmModel,
    start: &Joints,
    task: &PickNPlace,
    cycle: &CycleParameters,
    table: &Tabletop,
) -> Result<PickNPlacePaths, PathFault> {
    let rooms = Rooms::new(model, task, table);
    let candidates = candidates(model, start, task, cycle);
    let mut first_fault = None;
    for (count, search) in [(CANDIDATES, None), (SEARCHED, Some(SEARCH))] {
        for candidate in candidates.iter().take(count) {
            match assemble(model, start, candidate, task, cycle, (&rooms, search)) {
                Ok(paths) => return Ok(paths),
                // A search mends what is met on the way, and nothing else.
                Err(fault @ PathFault::Meets { .. }) => {
                    first_fault.get_or_insert(fault);
                }
                Err(fault) if search.is_none() => {
                    first_fault.get_or_insert(fault);
                }
                Err(_) => {}
            }
        }
    }
    Err(first_fault.unwrap_or_else(|| unreachable_pose(model, start, task, cycle)))
}

/// The same where the straight joint moves are free, without a search for a way round.
pub fn plan_straight(
    model: &ArmModel,
    start: &Joints,
    task: &PickNPlace,
    cycle: &CycleParameters,
    table: &Tabletop,
) -> Option<PickNPlacePaths> {
    let rooms = Rooms::new(model, task, table);
    let candidates = candidates(model, start, task, cycle);
    candidates.iter().find_map(|one| assemble(model, start, one, task, cycle, (&rooms, None)).ok())
}

/// The tool pointing down at `(x, y, z)` of the table with `yaw` about the vertical.
pub fn tool_down(x: f64, y: f64, z: f64, yaw: f64) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI);
    Isometry3::from_parts(Translation3::new(x, y, z), turn * down)
}

/// Joints at the corners of the move for one yaw and one branch.
pub(crate) struct Candidate {
    yaw: f64,
    /// Where the empty tool comes over the object.
    hover: Joints,
    /// Where it is lifted to.
    over_pick: Joints,
    pub pick: Joints,
    over_place: Joints,
    place: Joints,
    cost: f64,
}

/// The table before the pick, while the object is carried, and after it was placed.
pub(crate) struct Rooms {
    pub before: Room,
    meanwhile: Room,
    after: Room,
}

impl Rooms {
    pub fn new(model: &ArmModel, task: &PickNPlace, table: &Tabletop) -> Rooms {
        Rooms {
            before: Room::new(&model.bodies, table, Some(&task.lying_at(task.from))),
            meanwhile: Room::new(&model.bodies, table, None),
            after: Room::new(&model.bodies, table, Some(&task.lying_at(task.to))),
        }
    }
}

/// Height of the tool while it travels with the object, or after it was put down, when it may still hang
/// on the cups: over everything that is on the table, and so far over the place that the straight part is
/// there.
pub(crate) fn travel_height(task: &PickNPlace, cycle: &CycleParameters) -> f64 {
    (cycle.tallest + cycle.air + task.depth()).max(task.height + cycle.approach)
}

/// Height at which the empty tool comes over the object, the same way.
fn hover_height(task: &PickNPlace, cycle: &CycleParameters) -> f64 {
    (cycle.tallest + cycle.air).max(task.height + cycle.approach)
}

fn yaws(task: &PickNPlace) -> Vec<f64> {
    match task.grip_yaw {
        Some(yaw) => vec![task.from.theta + yaw],
        None => (0..YAWS).map(|k| TAU * k as f64 / YAWS as f64).collect(),
    }
}

fn candidates(
    model: &ArmModel,
    start: &Joints,
    task: &PickNPlace,
    cycle: &CycleParameters,
) -> Vec<Candidate> {
    let [x, y] = task.from.transform(task.grip_point);
    let mut out = Vec::new();
    for yaw in yaws(task) {
        let hovers = model.in_work_posture(&tool_down(x, y, hover_height(task, cycle), yaw));
        if hovers.is_empty() {
            continue;
        }
        let Some(corners) = Corners::new(model, yaw, task, cycle) else { continue };
        // The other way round for joint 6 may save a turn of the object's, or keep it in range.
        for start_turn in [0.0, -TAU, TAU] {
            let mut near = *start;
            near.0[5] += start_turn;
            let Some(hover) = model.first_unwound(&hovers, &near) else { continue };
            let Some(candidate) = corners.candidate(model, &hover) else { continue };
            let way =
                start.max_difference(&hover) + candidate.over_pick.max_difference(&candidate.over_place);
            let cost = way + wound(&hover) + wound(&candidate.over_place);
            out.push(Candidate { cost, ..candidate });
        }
    }
    out.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    out
}

/// The corners of the move for an arm that comes over the object with this yaw.
pub(crate) fn from_over(
    model: &ArmModel,
    hover: &Joints,
    yaw: f64,
    task: &PickNPlace,
    cycle: &CycleParameters,
) -> Option<Candidate> {
    Corners::new(model, yaw, task, cycle)?.candidate(model, hover)
}

/// Joint solutions at the corners of the move for one yaw, without full turns.
struct Corners {
    yaw: f64,
    pick: Vec<Joints>,
    over_pick: Vec<Joints>,
    over_place: Vec<Joints>,
    place: Vec<Joints>,
}

impl Corners {
    /// `None` where one of them has no solution.
    fn new(model: &ArmModel, yaw: f64, task: &PickNPlace, cycle: &CycleParameters) -> Option<Corners> {
        let at = |pose: &Pose2, z, yaw| {
            let [x, y] = pose.transform(task.grip_point);
            let solutions = model.in_work_posture(&tool_down(x, y, z, yaw));
            (!solutions.is_empty()).then_some(solutions)
        };
        let (high, low) = (travel_height(task, cycle), task.height - cycle.press);
        let turn = wrap_angle(task.to.theta - task.from.theta);
        Some(Corners {
            yaw,
            pick: at(&task.from, low, yaw)?,
            over_pick: at(&task.from, high, yaw)?,
            over_place: at(&task.to, high, yaw + turn)?,
            place: at(&task.to, low, yaw + turn)?,
        })
    }

    /// Each corner as near to the one before as full turns allow.
    fn candidate(&self, model: &ArmModel, hover: &Joints) -> Option<Candidate> {
        let pick = model.first_unwound(&self.pick, hover)?;
        let over_pick = model.first_unwound(&self.over_pick, &pick)?;
        let over_place = model.first_unwound(&self.over_place, &over_pick)?;
        let place = model.first_unwound(&self.place, &over_place)?;
        Some(Candidate { yaw: self.yaw, hover: *hover, over_pick, pick, over_place, place, cost: 0.0 })
    }
}

/// What it costs that the last joint is turned far, rad of the leading joint: where it is left at one end of
/// its range, the next turn may have to go all the way back.
pub fn wound(q: &Joints) -> f64 {
    WOUND * (q.0[5].abs() - WOUND_FROM_RAD).max(0.0)
}

/// Which of the four tool poses has no solution: pick or place.
fn unreachable_pose(
    model: &ArmModel,
    start: &Joints,
    task: &PickNPlace,
    cycle: &CycleParameters,
) -> PathFault {
    let yaw = task.grip_yaw.unwrap_or(0.0) + task.from.theta;
    for (what, pose) in [("pick", &task.from), ("place", &task.to)] {
        let [x, y] = pose.transform(task.grip_point);
        for z in [travel_height(task, cycle), task.height] {
            let tool = tool_down(x, y, z, yaw);
            if model.joints_in_work_posture(&tool, start).is_none() {
                return out_of_reach(what, &tool);
            }
        }
    }
    let [x, y] = task.to.transform(task.grip_point);
    out_of_reach("place in the same posture as the pick", &tool_down(x, y, task.height, yaw))
}

fn assemble(
    model: &ArmModel,
    start: &Joints,
    candidate: &Candidate,
    task: &PickNPlace,
    cycle: &CycleParameters,
    (rooms, search): (&Rooms, Option<Search>),
) -> Result<PickNPlacePaths, PathFault> {
    let low = task.height - cycle.press;
    let empty_floor = cycle.layer();
    let lower = Leg::between(linear(candidate.pick, cycle, 0.0), low - 1e-3);
    let ways = [metres(model, start, &candidate.hover), metres(model, &candidate.hover, &candidate.pick)];
    let direct = |blend: f64| {
        let legs = [Leg::over(joint(candidate.hover, cycle, blend), empty_floor), lower];
        CheckedPath::new(model, start, &legs, &rooms.before)
    };
    let radii = corner(hover_height(task, cycle), 0.0, cycle, ways);
    let approach = widest(radii, direct).or_else(|fault| {
        let ends = (start, &candidate.hover);
        let mut legs = round(model, ends, cycle, &rooms.before, search).ok_or(fault)?;
        legs.iter_mut().for_each(|leg| leg.floor = empty_floor);
        legs.push(lower);
        CheckedPath::new(model, start, &legs, &rooms.before)
    })?;
    from_pick(model, approach, candidate, task, cycle, (rooms, search))
}

/// What comes after the approach.
pub(crate) fn from_pick(
    model: &ArmModel,
    approach: CheckedPath,
    candidate: &Candidate,
    task: &PickNPlace,
    cycle: &CycleParameters,
    (rooms, search): (&Rooms, Option<Search>),
) -> Result<PickNPlacePaths, PathFault> {
    let low = task.height - cycle.press;
    let carry = carry_path(model, candidate, task, cycle, (rooms, search))?;
    let up = |from: &Joints, to: Joints, room: &Room| {
        CheckedPath::new(model, from, &[Leg::between(linear(to, cycle, 0.0), low - 1e-3)], room)
    };
    let give_up = up(&candidate.pick, candidate.over_pick, &rooms.before)?;
    let retreat = up(&candidate.place, candidate.over_place, &rooms.after)?;
    Ok(PickNPlacePaths { approach, carry, give_up, retreat })
}

/// Lift, transfer, lower. The transfer goes through joint space where that keeps the height, else straight.
fn carry_path(
    model: &ArmModel,
    candidate: &Candidate,
    task: &PickNPlace,
    cycle: &CycleParameters,
    (rooms, search): (&Rooms, Option<Search>),
) -> Result<CheckedPath, PathFault> {
    let low = task.height - cycle.press;
    let floor = cycle.layer() + task.height;
    let straight = metres(model, &candidate.pick, &candidate.over_pick);
    // There is a corner at both ends of the transfer.
    let transfer = 0.5 * metres(model, &candidate.over_pick, &candidate.over_place);
    let radii = corner(travel_height(task, cycle), task.depth(), cycle, [straight, transfer]);
    let room = rooms.meanwhile.holding(&model.bodies, Some(&task.hanging(candidate.yaw)));
    let with_transfer = |blend: f64, transfer: Vec<Leg>| {
        let lift = Leg::between(linear(candidate.over_pick, cycle, blend), low - 1e-3);
        let lower = Leg::between(linear(candidate.place, cycle, 0.0), low - 1e-3);
        let transfer = transfer.into_iter().map(|leg| Leg { floor, ..leg });
        let legs = std::iter::once(lift).chain(transfer).chain(std::iter::once(lower));
        let legs: Vec<Leg> = legs.map(|leg| leg.holding(task.hold)).collect();
        CheckedPath::new(model, &candidate.pick, &legs, &room)
    };
    let blended = |transfer: &dyn Fn(f64) -> Segment| {
        widest(radii, |blend| with_transfer(blend, vec![Leg::over(transfer(blend), floor)]))
    };
    let over = candidate.over_place;
    // A line is as slow as its turn: one that mostly turns is left for another yaw, or a way round.
    let turns = wrap_angle(task.to.theta - task.from.theta).abs() > LINE_TURN_RAD;
    blended(&|blend| joint(over, cycle, blend))
        .or_else(|fault| if turns { Err(fault) } else { blended(&|blend| linear(over, cycle, blend)) })
        .or_else(|fault| {
            let ends = (&candidate.over_pick, &candidate.over_place);
            with_transfer(0.0, round(model, ends, cycle, &room, search).ok_or(fault)?)
        })
}

/// The yaw of a tool that points down.
pub(crate) fn yaw_at(model: &ArmModel, q: &Joints) -> f64 {
    let ahead = model.tool_at(q).rotation * Vector3::x();
    ahead.y.atan2(ahead.x)
}

/// From a place, where the arm is at `from`, straight up to `over` and on to `to`, as one motion; `None`
/// where the way from there is not free for the tool with `load`, which was put down and may hang on it
/// all the same. `table` is what else lies on it.
pub fn leave(
    model: &ArmModel,
    [from, over, to]: [&Joints; 3],
    (placed, load): (&PickNPlace, &Load),
    cycle: &CycleParameters,
    table: &Tabletop,
) -> Option<CheckedPath> {
    let room = Room::new(&model.bodies, table, None).holding(&model.bodies, Some(load));
    let low = placed.height - cycle.press;
    let to = model.unwound(to, over)?;
    let ways = [metres(model, from, over), metres(model, over, &to)];
    let away = Leg::over(joint(to, cycle, 0.0), f64::NEG_INFINITY).holding(placed.hold);
    let radii = corner(travel_height(placed, cycle), placed.depth(), cycle, ways);
    let path = |blend: f64| {
        let up = Leg::between(linear(*over, cycle, blend), low - 1e-3).holding(placed.hold);
        CheckedPath::new(model, from, &[up, away], &room)
    };
    widest(radii, path).ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bodies::cell::NamedShape;
    use crate::bodies::shape::Shape;
    use crate::path::BlendSpeed;
    use crate::testing::{cycle, home, model, table, task};
    use rand::{RngExt, SeedableRng};

    #[test]
    fn every_place_of_the_demo_table_is_served() {
        // Keeps all blends, whatever their speed.
        let model = ArmModel { blend_speed: BlendSpeed::Braked, ..model(0.5) };
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(11);
        let mut at = home(&model, 0.5);
        for _ in 0..200 {
            let mut pose = || {
                Pose2::new(
                    rng.random_range(0.02..0.48),
                    rng.random_range(0.02..0.48),
                    rng.random_range(-3.1..3.1),
                )
            };
            let task = task(pose(), pose(), [0.0, 0.0]);
            let paths = plan(&model, &at, &task, &cycle(), &table())
                .unwrap_or_else(|fault| panic!("{task:?}: {fault}"));
            let tip = model.tool_at(&paths.carry.end());
            assert!((tip.translation.vector - Vector3::new(task.to.x, task.to.y, 0.019)).norm() < 1e-6);
            let carried = paths.carry.start();
            let turned = model.tool_at(&carried).rotation.rotation_to(&tip.rotation).scaled_axis().z;
            assert!(wrap_angle(turned - (task.to.theta - task.from.theta)).abs() < 1e-6, "turned {turned}");
            // Up with the object: what hangs lowest keeps some air where the corner is left.
            let over = model.tool_at(&paths.carry.segments()[0].target()).translation.z;
            let blend = paths.carry.segments()[0].blend();
            assert!(over - task.depth() - blend >= 0.025, "{blend} below {over}");
            let transfer =
                metres(&model, &paths.carry.segments()[0].target(), &paths.carry.segments()[1].target());
            assert!(blend >= cycle().blend.min(0.22 * transfer) - 2e-3, "the air is used: {blend}");
            at = paths.retreat.end();
        }
    }

    /// Corners nearer to each other than their radii: a controller would leave one of them out.
    #[test]
    fn corners_do_not_overlap_however_short_the_way() {
        let model = model(0.5);
        let wide = CycleParameters { blend: 0.05, ..cycle() };
        for (way, turn) in [(0.0, 1.0), (0.002, 0.0), (0.02, 0.1), (0.045, 2.0), (0.3, 0.0)] {
            let task = task(Pose2::new(0.1, 0.2, 0.0), Pose2::new(0.1 + way, 0.2, turn), [0.0, 0.0]);
            let start = home(&model, 0.5);
            let paths = plan(&model, &start, &task, &wide, &table()).expect("reachable");
            let [up, over, _] = paths.carry.segments() else { panic!("{:?}", paths.carry.segments()) };
            let apart = metres(&model, &up.target(), &over.target());
            assert!(up.blend() + over.blend() <= apart, "{way} m: {} + {}", up.blend(), over.blend());
            assert!(way < 0.1 || up.blend() > 0.02, "a long way has wide corners: {}", up.blend());
        }
        let at = |x: f64, z: f64| {
            model.joints_in_work_posture(&tool_down(x, 0.25, z, 0.0), &model.home).expect("in reach")
        };
        let path = |way: f64| {
            let legs = [
                Leg::over(linear(at(0.1, 0.2), &wide, 0.02), f64::NEG_INFINITY),
                Leg::over(linear(at(0.1 + way, 0.2), &wide, 0.02), f64::NEG_INFINITY),
                Leg::over(linear(at(0.1 + way, 0.1), &wide, 0.0), f64::NEG_INFINITY),
            ];
            CheckedPath::new(&model, &at(0.1, 0.1), &legs, &Room::empty())
        };
        assert!(path(0.041).is_ok(), "{:?}", path(0.041).err());
        assert!(matches!(path(0.039), Err(PathFault::Limit { what, .. }) if what.contains("blend")));
    }

    #[test]
    fn a_place_beyond_the_reach_is_refused_by_name() {
        let model = model(0.5);
        let task = task(Pose2::new(0.25, 0.25, 0.0), Pose2::new(0.25, 1.2, 0.0), [0.0, 0.0]);
        let fault = plan(&model, &home(&model, 0.5), &task, &cycle(), &table()).expect_err("too far");
        assert!(fault.to_string().contains("place"), "{fault}");
    }

    #[test]
    fn the_check_refuses_what_goes_too_low_too_fast_or_too_far() {
        let model = model(0.5);
        let start = home(&model, 0.5);
        let down = model.joints_at(&tool_down(0.25, 0.25, 0.01, 0.0), &start).expect("reachable");
        let empty = Room::empty();
        let leg = |segment, floor| {
            let leg = match segment {
                Segment::Joint { .. } => Leg::over(segment, floor),
                Segment::Linear { .. } => Leg::between(segment, floor),
            };
            CheckedPath::new(&model, &start, &[leg], &empty)
        };
        assert!(matches!(leg(linear(down, &cycle(), 0.0), 0.02), Err(PathFault::TooLow { .. })));
        assert!(leg(linear(down, &cycle(), 0.0), 0.0099).is_ok());
        let fast = Segment::Joint { target: down, speed: 9.0, acceleration: 1.0, blend: 0.0 };
        assert!(matches!(leg(fast, 0.0), Err(PathFault::Limit { what, .. }) if what == "speed"));
        let mut turned = start;
        turned.0[5] += 3.0 * TAU;
        assert!(matches!(
            leg(joint(turned, &cycle(), 0.0), 0.0),
            Err(PathFault::JointRange { joint: 6, .. })
        ));
        let nan = Segment::Joint { target: down, speed: f64::NAN, acceleration: 1.0, blend: 0.0 };
        assert!(leg(nan, 0.0).is_err());
        assert_eq!(CheckedPath::new(&model, &start, &[], &empty), Err(PathFault::Empty));
    }

    /// A post in the middle of the table, higher than anything is carried.
    #[test]
    fn round_a_post_a_way_is_found() {
        let mut model = model(0.5);
        let middle = model.base_from_table * Isometry3::translation(0.25, 0.2, 0.0);
        let post = Shape::cylinder(0.02, 0.35, &middle);
        model.bodies = model.bodies.with(&NamedShape { name: "the post".into(), shape: post });
        let start = tool_down(0.06, 0.2, 0.3, 0.0);
        let start = model.joints_in_work_posture(&start, &model.home).expect("reachable");
        let ends = [0.06, 0.44].map(|x| Pose2::new(x, 0.2, 0.0));
        let task = task(ends[0], ends[1], [0.0, 0.0]);
        let paths = plan(&model, &start, &task, &cycle(), &table()).expect("a way round");
        assert!(paths.carry.segments().len() > 3, "{:?}", paths.carry.segments());
    }
}
