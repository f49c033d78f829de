//! Setting out for an object while what is on the table is still worked out.
//!
//! In: the paths of a pick-n-place as it is expected, from where the last picture was taken. Out: the way
//! to over the object, which ends at a waiting place; later, with the object as it was seen, the paths that
//! go on from there. Pure.
//!
//! The arm follows the way to its corner over the object. If the corner is a blend, the
//! arm goes on down, as on any approach, or up to the waiting place straight over the corner, where it
//! stops. The program on the robot decides at the corner; so the next path is checked from the corner and
//! from the waiting place. If the corner is a stop, it is the waiting place itself: a stopped arm starts no
//! further motion. Until then nothing is known, and what was put down last
//! may still hang on the cups: that is kept over everything too.

use crate::bodies::{Load, Room, Tabletop};
use crate::path::{ArmModel, CheckedPath, Leg, Segment};
use crate::pick_n_place::pieces::{WAY_SHARE, linear, metres};
use crate::pick_n_place::{
    CycleParameters, PickNPlace, PickNPlacePaths, Rooms, from_over, from_pick, yaw_at,
};
use nalgebra::Translation3;

/// Extra distance of the waiting place from a blended corner, m.
const FARTHER_M: f64 = 1e-3;

/// The way to over the object of `paths` and to a waiting place there; `None` where the approach has no
/// corner over the object, or where `hangs`, which may still be on the cups, would come too near to what may
/// lie on the table. `table` is what lies there besides the object; what hangs withstands so many m/s2, for
/// which the way may be slower.
pub fn set_out(
    model: &ArmModel,
    paths: &PickNPlacePaths,
    cycle: &CycleParameters,
    table: &Tabletop,
    hangs: Option<(&Load, f64)>,
) -> Option<CheckedPath> {
    let [over @ Segment::Joint { target: corner, blend, .. }, Segment::Linear { target: low, .. }] =
        paths.approach.segments()
    else {
        return None;
    };
    let mut legs = vec![Leg::over(*over, cycle.layer())];
    if *blend > 0.0 {
        // As long as the descent, so that the corner is safe for both.
        let up = (blend / WAY_SHARE).max(metres(model, corner, low)) + FARTHER_M;
        let place = Translation3::new(0.0, 0.0, up) * model.tool_at(corner);
        let waits = model.joints_in_work_posture(&place, corner)?;
        legs.push(Leg::over(linear(waits, cycle, 0.0), cycle.layer()));
    }
    let path = |table: &Tabletop, floor: f64, load: Option<(&Load, f64)>| {
        let room = Room::new(&model.bodies, table, None).holding(&model.bodies, load.map(|(load, _)| load));
        let hold = load.map_or(f64::INFINITY, |(_, hold)| hold);
        let legs: Vec<Leg> = legs.iter().map(|leg| Leg { floor, ..*leg }.holding(hold)).collect();
        let checked = |legs: &[Leg]| CheckedPath::new(model, &paths.approach.start(), legs, &room).ok();
        let path = checked(&legs)?;
        let stops = path.segments().first().is_some_and(|over| over.blend() <= 0.0);
        if stops { checked(&legs[..1]) } else { Some(path) }
    };
    let empty = path(table, cycle.layer(), None)?;
    let Some((load, hold)) = hangs else { return Some(empty) };
    // What most likely does not hang there keeps the air that is kept where corners are cut.
    let near = Tabletop { layer: table.corner_layer, ..table.clone() };
    path(&near, table.corner_layer + load.depth(), Some((load, hold)))
}

/// The paths of a pick-n-place for an arm that is on its way `out` to its object, which was seen meanwhile:
/// the approach begins at the waiting place. `None` where the object is not so near to where it was expected
/// that the tool comes straight down on it, or one of the paths is not free: then the arm goes on to the
/// waiting place, and all is planned from there.
pub fn go_on(
    model: &ArmModel,
    out: &CheckedPath,
    task: &PickNPlace,
    cycle: &CycleParameters,
    table: &Tabletop,
) -> Option<PickNPlacePaths> {
    let over = out.segments().first()?;
    let rooms = Rooms::new(model, task, table);
    // The tool keeps its yaw: an object that is turned a little hangs on it so.
    let corner = over.target();
    let candidate = from_over(model, &corner, yaw_at(model, &corner), task, cycle)?;
    let low = task.height - cycle.press;
    let ways_down = |down: Segment| {
        let leg = Leg::between(down, low - 1e-3);
        let corner = [Leg::over(*over, cycle.layer()), leg];
        let from_corner = CheckedPath::new(model, &out.start(), &corner, &rooms.before).ok()?;
        let from_place = CheckedPath::new(model, &out.end(), &[leg], &rooms.before).ok()?;
        Some((from_corner, from_place))
    };
    // At the speed that the joints can follow from both of them.
    let (corner, place) = ways_down(linear(candidate.pick, cycle, 0.0))?;
    let down = slower(corner.segments().last()?, place.segments().last()?)?;
    let (corner, approach) = ways_down(down)?;
    let as_sent = corner.segments() == [*over, down] && approach.segments() == [down];
    let paths = || from_pick(model, approach, &candidate, task, cycle, (&rooms, None)).ok();
    as_sent.then(paths).flatten()
}

/// A line at the lower speed and acceleration of two to the same place.
fn slower(one: &Segment, other: &Segment) -> Option<Segment> {
    let (
        Segment::Linear { target, speed, acceleration, blend },
        Segment::Linear { speed: v, acceleration: a, .. },
    ) = (*one, *other)
    else {
        return None;
    };
    Some(Segment::Linear { target, speed: speed.min(v), acceleration: acceleration.min(a), blend })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::path::BlendSpeed;
    use crate::pick_n_place::plan;
    use crate::testing::{cycle, home, model, table, task};
    use nalgebra::Vector3;
    use rearrange::geometry::pose::Pose2;

    /// Set out for a disc at (0.4, 0.15), from over the middle of the table.
    fn way(model: &ArmModel, hangs: Option<(&Load, f64)>) -> (PickNPlacePaths, Option<CheckedPath>) {
        let expected = task(Pose2::new(0.4, 0.15, 0.0), Pose2::new(0.1, 0.3, 1.0), [0.0, 0.0]);
        let start = home(model, 0.5);
        let paths = plan(model, &start, &expected, &cycle(), &table()).expect("reachable");
        let out = set_out(model, &paths, &cycle(), &table(), hangs);
        (paths, out)
    }

    /// As it was expected, and a little aside and turned: the approach as planned, from the waiting place
    /// on, and the object to where it shall be.
    #[test]
    fn the_arm_goes_on_to_where_the_object_was_seen() {
        // With a blend and with a stop: at this speed only a controller that brakes may blend.
        for (blend_speed, cuts) in [(BlendSpeed::Braked, true), (BlendSpeed::Unknown, false)] {
            goes_on(&ArmModel { blend_speed, ..model(0.5) }, cuts);
        }
    }

    fn goes_on(model: &ArmModel, cuts: bool) {
        let (paths, out) = way(model, None);
        let out = out.expect("free");
        let over = out.segments()[0];
        assert_eq!(over, paths.approach.segments()[0]);
        assert_eq!((over.blend() > 0.01, out.segments().len()), if cuts { (true, 2) } else { (false, 1) });
        for seen in [Pose2::new(0.4, 0.15, 0.0), Pose2::new(0.4006, 0.1496, 0.006)] {
            let seen = task(seen, Pose2::new(0.1, 0.3, 1.0), [0.0, 0.0]);
            let on = go_on(model, &out, &seen, &cycle(), &table()).expect("near");
            assert_eq!(on.approach.start(), out.end());
            let tip = model.tool_at(&on.approach.end()).translation.vector;
            assert!((tip - Vector3::new(seen.from.x, seen.from.y, 0.019)).norm() < 1e-6, "{tip}");
            let place = model.tool_at(&on.carry.end()).translation.vector;
            assert!((place - Vector3::new(0.1, 0.3, 0.019)).norm() < 1e-6, "{place}");
        }
        let aside = task(Pose2::new(0.4, 0.152, 0.0), Pose2::new(0.1, 0.3, 1.0), [0.0, 0.0]);
        assert_eq!(go_on(model, &out, &aside, &cycle(), &table()), None, "not straight down");
    }

    /// What may hang on the cups keeps over everything, as near as where corners are cut, or the arm waits.
    #[test]
    fn what_may_hang_is_kept_over_everything() {
        let model = model(0.5);
        let hanging = |height: f64, hold: f64| {
            let put_down =
                PickNPlace { height, hold, ..task(Pose2::new(0.1, 0.1, 0.0), Pose2::default(), [0.0; 2]) };
            put_down.hanging(0.0)
        };
        let flat = hanging(0.02, 20.0);
        let (_, out) = way(&model, Some((&flat, 20.0)));
        let corner = out.expect("free").segments()[0].target();
        let below = model.tool_at(&corner).translation.z - flat.depth();
        assert!(below >= cycle().corner_layer(), "{below}");
        assert_eq!(way(&model, Some((&hanging(0.05, 20.0), 20.0))).1, None);
        // What withstands little is carried slowly.
        let (paths, slow) = way(&model, Some((&flat, 0.5)));
        let speed = |segment: &Segment| match segment {
            Segment::Joint { speed, .. } | Segment::Linear { speed, .. } => *speed,
        };
        assert!(speed(&slow.expect("free").segments()[0]) < speed(&paths.approach.segments()[0]));
    }

    /// Something between the waiting place and the object, and something beside the object where the look
    /// shows it for the first time.
    #[test]
    fn what_is_in_the_way_keeps_the_arm_from_going_on() {
        let model = model(0.5);
        let (paths, out) = way(&model, None);
        let out = out.expect("free");
        let beside = crate::bodies::Standing {
            name: "a post".into(),
            footprint: rearrange::geometry::footprint::Footprint::Disc { radius: 0.02 },
            pose: Pose2::new(0.4, 0.2, 0.0),
            height: 0.2,
        };
        let with_post = cycle().tabletop(vec![beside]);
        let seen = task(Pose2::new(0.4, 0.15, 0.0), Pose2::new(0.1, 0.3, 1.0), [0.0, 0.0]);
        assert_eq!(go_on(&model, &out, &seen, &cycle(), &with_post), None);
        assert_eq!(set_out(&model, &paths, &cycle(), &with_post, None), None);
    }
}
