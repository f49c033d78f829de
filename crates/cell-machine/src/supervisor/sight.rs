//! Which part of the table has to be seen before the next pick, from where it is looked at, and what is
//! remembered of the rest.
//!
//! In: what was seen, what was disturbed since, the next pick-n-place. Out: a [`LookPlan`]; an observation
//! of a part of the table put together with what was seen before. A pick-n-place disturbs what its object
//! and a slip of it can reach round its two places, and whatever reaches into that. Before the next one
//! all of that is seen again, and where the next one picks and places: between, a hand may have been
//! there; and every object that was last seen so long ago that it will soon be too old. The whole table is
//! looked at when nothing is known of it, when something is too old, at the end of a job, when a look shows
//! anything unexpected, and every so many pick-n-places.

use crate::code::Code;
use crate::supervisor::cell::Supervisor;
use crate::supervisor::look_plan::{LookPlan, Sight, Stop};
use crate::supervisor::model::CellObject;
use crate::supervisor::order::RouteAction;
use crate::supervisor::reason::Reason;
use cell_motion::bodies::sweep::{Sweep, Zone};
use cell_motion::cycle_time::rest_to_rest;
use cell_motion::pick_n_place::{tool_down, wound};
use cell_values::time::Timestamp;
use cell_values::units::Joints;
use cell_vision::foreign::ForeignReport;
use cell_vision::marker::corners_m;
use cell_vision::observe::{ObjectEstimate, Observation};
use cell_vision::region::Region;
use nalgebra::Point3;
use rearrange::geometry::collision::penetration;
use rearrange::geometry::footprint::Footprint;
use rearrange::geometry::pose::Pose2;
use std::cell::RefCell;
use std::f64::consts::FRAC_1_SQRT_2;

/// How far round an object it, or what is beside it, may have slipped, m.
const SLIP_M: f64 = 0.02;

/// Room round an object that a look shows with it, m: it may lie so far from where it was seen.
const AROUND_M: f64 = 0.015;

/// Room round a marker that a look has to show where it was, m; one that is farther off is missing, and the
/// whole table is looked at.
const RIM_M: f64 = 0.001;

/// Two looks agree about a place to this, m.
const SAME_PLACE_M: f64 = 2e-3;

/// An object that no look has shown for longer than this share of `observation_age_s` is seen with the next
/// look: the one after that may come too late.
const SOON: f64 = 0.5;

/// What a stop for a picture costs besides the way, s.
const STOP_S: f64 = 0.1;

impl Supervisor {
    /// A look has shown what it should; `before` is what was seen before it.
    pub(crate) fn looked(&mut self, now: Timestamp, whole: bool, before: Option<&Observation>) {
        let since_whole = if whole { 0 } else { self.sight.since_whole };
        let made_for = self.job.as_ref().map(|job| job.moves);
        let looked_at = |object: &ObjectEstimate| {
            // What is remembered has the picture that it had.
            let known = before.and_then(|before| before.object(&object.id));
            let remembered = known.filter(|known| known.time == object.time);
            let at = remembered.map(|_| self.sight.looked_at.get(&object.id).copied().unwrap_or(object.time));
            (object.id.clone(), at.unwrap_or(now))
        };
        let looked_at = self.seen.iter().flat_map(|seen| &seen.objects).map(looked_at).collect();
        let searched_s = self.sight.searched_s;
        let disturbed = Region::default();
        self.sight = Sight { disturbed, made_for, whole, since_whole, looked_at, searched_s };
    }

    /// What was seen is still what a pick has to rest on, and nothing of it is too old.
    pub(crate) fn is_seen(&self, now: Timestamp) -> bool {
        let moves = self.job.as_ref().map(|job| job.moves);
        let is_made_for = self.sight.made_for == moves && self.sight.disturbed.is_empty();
        let is_old = self.seen_before(now, 1.0).next().is_some();
        self.seen.is_some() && is_made_for && !is_old
    }

    /// Objects that no look has shown for longer than this share of what a look is acted upon for.
    fn seen_before(&self, now: Timestamp, share: f64) -> impl Iterator<Item = &ObjectEstimate> {
        let limit = share * self.model.tolerances.observation_age.as_secs_f64();
        let objects = self.seen.iter().flat_map(|seen| &seen.objects);
        objects.filter(move |object| {
            let at = self.sight.looked_at.get(&object.id).copied().unwrap_or(object.time);
            now.since(at).as_secs_f64() > limit
        })
    }

    /// The tool comes down on an object, or goes down with it: what is there may have moved since it was
    /// seen, and the object itself is somewhere else until it is seen again.
    pub(crate) fn disturb(&mut self, object: &str, pose: &Pose2) {
        self.glance = None;
        let Some(known) = self.model.object(object) else { return };
        let reach = known.footprint.bounding_radius() + SLIP_M;
        self.sight.disturbed.join(&Region::disc([pose.x, pose.y], reach));
        self.sight.whole = false;
        if let Some(seen) = &mut self.seen {
            seen.objects.retain(|known| known.id != object);
        }
    }

    /// One more pick-n-place is over.
    pub(crate) fn moved_one(&mut self) {
        self.sight.since_whole += 1;
    }

    /// All of the table, from the taught poses.
    pub(crate) fn whole_look(&self) -> LookPlan {
        LookPlan { poses: self.model.look_poses.clone(), region: None, for_age: Vec::new() }
    }

    /// The look that what comes next needs, for an arm at `from`.
    pub(crate) fn next_look(&self, now: Timestamp, from: &Joints) -> LookPlan {
        self.partial_look(now, from).unwrap_or_else(|| self.whole_look())
    }

    fn partial_look(&self, now: Timestamp, from: &Joints) -> Option<LookPlan> {
        let next = self.job.as_ref()?.route.as_ref()?.first()?;
        let object = self.model.object(&next.object)?;
        let is_due = self.sight.since_whole >= self.model.tolerances.full_look_every;
        // A part after the other would not do for an arm so slow that the first is old after the second.
        let is_old = self.seen_before(now, 1.0).next().is_some();
        if self.back.recovery.is_some() || self.seen.is_none() || is_due || is_old {
            return None;
        }
        let (region, for_age) = self.region_for(now, next, object);
        let over_pick = self.over_pick(next, object);
        let poses = self.poses_for(from, &region, over_pick.as_ref())?;
        Some(LookPlan { poses, region: Some(region), for_age })
    }

    /// A look at the place of what was let go, where that has not been seen yet.
    pub(crate) fn place_look(&self, from: &Joints) -> Option<LookPlan> {
        let held = self.back.held.as_ref().filter(|held| held.let_go)?;
        let radius = self.model.object(&held.object)?.footprint.bounding_radius() + AROUND_M;
        let region = Region::disc([held.to.x, held.to.y], radius);
        let poses = self.poses_for(from, &region, None)?;
        Some(LookPlan { poses, region: Some(region), for_age: Vec::new() })
    }

    /// The cheapest poses to see a region from, free with what may hang on the cups.
    fn poses_for(&self, from: &Joints, region: &Region, then: Option<&Joints>) -> Option<Vec<Joints>> {
        let price = |poses: &[Joints]| self.price(from, poses, then);
        let room = self.unseen_room();
        let sweep = RefCell::new(Sweep::new(&self.model.arm.bodies, &room));
        let free = |q: &Joints| sweep.borrow_mut().place(q, Zone::Over).is_ok();
        self.model.views()?.covering(&self.model.rig(), region, &price, &free)
    }

    /// What has to be seen before a pick-n-place, with the places of what will soon be too old; and what is
    /// in there for its age alone.
    fn region_for(&self, now: Timestamp, next: &RouteAction, object: &CellObject) -> (Region, Vec<String>) {
        let mut region = self.sight.disturbed.clone();
        let radius = object.footprint.bounding_radius() + AROUND_M;
        for pose in [&next.from, &next.to] {
            region.join(&Region::disc([pose.x, pose.y], radius));
        }
        for seen in self.seen.iter().flat_map(|seen| &seen.objects) {
            if let Some(marker) =
                self.model.object(&seen.id).and_then(|known| self.marker_disturbed(known, &seen.pose))
            {
                region.join(&marker);
            }
        }
        let old = self.seen_before(now, SOON);
        let old: Vec<_> = old.filter(|old| !self.should_show(&old.id, &old.pose, &region)).collect();
        for old in &old {
            if let Some(known) = self.model.object(&old.id) {
                region.join(&marker_place(known, &old.pose));
            }
        }
        let for_age = old.into_iter().map(|old| old.id.clone()).collect();
        (region, for_age)
    }

    /// The place of an object's marker, where what was disturbed reaches into the object: it
    /// may have been shifted or tipped.
    fn marker_disturbed(&self, known: &CellObject, pose: &Pose2) -> Option<Region> {
        let reaches = |(centre, radius): ([f64; 2], f64)| {
            let disc = Footprint::Disc { radius };
            penetration(&disc, &Pose2::new(centre[0], centre[1], 0.0), &known.footprint, pose) > 0.0
        };
        self.sight.disturbed.discs().any(reaches).then(|| marker_place(known, pose))
    }

    /// Joints over the next pick; `None` where it is out of reach, which is said later.
    fn over_pick(&self, next: &RouteAction, object: &CellObject) -> Option<Joints> {
        let [x, y] = next.from.transform(object.grip_point);
        let over = tool_down(x, y, self.model.cycle.tallest + self.model.cycle.air, 0.0);
        self.model.arm.joints_in_work_posture(&over, &self.model.arm.home)
    }

    /// Seconds of the way from stop to stop and on to the next pick, about. The last joint turns with the
    /// yaw, which is chosen later.
    fn price(&self, from: &Joints, poses: &[Joints], over_pick: Option<&Joints>) -> f64 {
        let cycle = &self.model.cycle;
        let mut at = *from;
        let mut sum = 0.0;
        for (target, joints) in poses.iter().map(|q| (q, 6)).chain(over_pick.map(|q| (q, 5))) {
            let target = self.model.arm.unwound(target, &at).unwrap_or(*target);
            let turn = (0..joints).map(|j| (target.0[j] - at.0[j]).abs()).fold(0.0, f64::max);
            sum += STOP_S + rest_to_rest(turn + wound(&target), cycle.joint_speed, cycle.joint_acceleration);
            at = target;
        }
        sum
    }

    /// An observation of a part of the table, with what was seen before of the rest. What the part should
    /// have shown and did not is missing, whatever is remembered. What was in it for its age alone may be
    /// hidden from there: it is as old as it was, and a look at the whole table comes when that is too old.
    pub(crate) fn with_what_is_remembered(
        &self,
        now: Observation,
        region: &Region,
        for_age: &[String],
    ) -> Observation {
        let Some(before) = &self.seen else { return now };
        let named = |id: &str| {
            now.suspicious.iter().any(|doubted| doubted.id == id)
                || now.duplicates.iter().any(|twice| twice.id == id)
        };
        let remembered = |id: &str| {
            let known = before.object(id)?;
            let had_to = !for_age.iter().any(|old| old == id) && self.should_show(id, &known.pose, region);
            (!named(id) && !had_to).then(|| known.clone())
        };
        let mut objects = now.objects;
        let mut missing = Vec::new();
        for id in now.missing {
            match remembered(&id) {
                Some(known) => objects.push(known),
                None => missing.push(id),
            }
        }
        // In the order of every other observation, which plans refer to.
        let place = |id: &str| self.model.objects.iter().position(|known| known.id == id);
        objects.sort_by_key(|object| place(&object.id));
        let foreign = with_foreign_elsewhere(now.foreign, before.foreign.as_ref(), region);
        Observation { objects, missing, foreign, ..now }
    }

    /// What is in one picture and not in a later one that shows its place: something took it away between
    /// them, or is before it. `None` where there is nothing of that kind, and where the look before has
    /// shown the same at the same places: what is before it stays there.
    pub(crate) fn gone(&mut self, now: &Observation, stops: &[Stop]) -> Option<Reason> {
        let gone = now.objects.iter().filter(|object| self.should_have_shown(object, stops));
        let gone: Vec<(String, Pose2)> = gone.map(|object| (object.id.clone(), object.pose)).collect();
        let job = self.job.as_mut()?;
        let before = std::mem::take(&mut job.gone);
        let known = |(id, pose): &(String, Pose2)| {
            before.iter().any(|(other, at)| other == id && at.distance(pose) < SAME_PLACE_M)
        };
        if gone.iter().all(known) {
            return None;
        }
        let (id, _) = gone.first()?;
        let message = format!("{id} is in one picture and not in a later one that shows its place");
        let reason = Code::ObjectUncertain.because(message, "see that nothing moves on the table").of(id);
        job.gone = gone;
        Some(reason)
    }

    /// A stop of a look that came after the last picture of an object shows the place of its marker.
    pub(crate) fn should_have_shown(&self, object: &ObjectEstimate, stops: &[Stop]) -> bool {
        let (Some(known), Some(views)) = (self.model.object(&object.id), self.model.views()) else {
            return false;
        };
        let marker = object.pose.compose(&known.marker.offset);
        let corners = corners_m(known.marker.size).map(|corner| {
            let [x, y] = marker.transform(corner);
            Point3::new(x, y, known.height)
        });
        stops.iter().any(|stop| stop.at > object.time && views.show(&stop.camera, &corners))
    }

    /// Whether a look at a region has to show an object's marker, with the object at `pose`.
    fn should_show(&self, id: &str, pose: &Pose2, region: &Region) -> bool {
        self.model.object(id).is_some_and(|known| {
            let marker = pose.compose(&known.marker.offset);
            region.contains_disc([marker.x, marker.y], known.marker.size * FRAC_1_SQRT_2)
        })
    }
}

/// Where an object's marker is, with some room round it.
fn marker_place(known: &CellObject, pose: &Pose2) -> Region {
    let marker = pose.compose(&known.marker.offset);
    Region::disc([marker.x, marker.y], known.marker.size * FRAC_1_SQRT_2 + RIM_M)
}

/// Things without a marker that were seen before and not all in a region are still there.
fn with_foreign_elsewhere(
    now: Option<ForeignReport>,
    before: Option<&ForeignReport>,
    region: &Region,
) -> Option<ForeignReport> {
    let mut report = now?;
    let elsewhere = before.iter().flat_map(|before| &before.objects);
    report
        .objects
        .extend(elsewhere.filter(|object| !object.outline.iter().all(|at| region.contains(*at))).cloned());
    Some(report)
}
