//! Setting out for the next object while the last picture of a look is searched.
//!
//! In: the route, where the next object was seen last, what the look shows once it is known. Out: the way to
//! over that object, and the pick-n-place that goes on from it without a stop. The way stays over everything
//! that may lie on the table and ends at a waiting place. The arm goes on only with what the look has shown:
//! everything as the plan expects, so that nothing is to be decided. Anything else is judged as after any
//! look, once the arm rests there.

use crate::device::robot_types::RobotCommand;
use crate::supervisor::cell::Supervisor;
use crate::supervisor::gates;
use crate::supervisor::input::{Action, DeviceSnapshot};
use crate::supervisor::judge::foreign_height;
use crate::supervisor::look_plan::LookPlan;
use crate::supervisor::order::RouteAction;
use crate::supervisor::phase::{Ahead, Look, Phase, WorkStage};
use cell_motion::bodies::Standing;
use cell_motion::cycle_time::rest_to_rest;
use cell_motion::path::{CheckedPath, Segment};
use cell_motion::pick_n_place::{PickNPlace, PickNPlacePaths, plan_straight};
use cell_motion::set_out;
use cell_values::time::Timestamp;
use cell_vision::region::Region;

/// The arm sets out where the search of the pictures, if it takes as long as the last one, is over within
/// this share of the way with so much to spare, s: what comes later finds the arm on its way to the waiting
/// place.
const SEARCHED_WITHIN: f64 = 0.5;
const SPARE_S: f64 = 0.05;

/// And where the way is not longer, for what may still hang on the cups, by more than this share of the
/// search.
const WORTH: f64 = 0.5;

impl Supervisor {
    /// The last picture of a look is taken: the arm sets out for the next object, where it may.
    pub(crate) fn set_out(&mut self, devices: &DeviceSnapshot, out: &mut Vec<Action>) {
        let Some(path) = self.way_out(devices) else { return };
        let Phase::Look(look) = &mut self.phase else { return };
        out.push(Action::Robot(RobotCommand::SetOut(path.clone())));
        look.ahead = Some(Ahead { path, shown: None });
        self.remaining = self.model.tolerances.look_deadline;
    }

    /// The arm is on its way to over the next object, which no look has shown there yet.
    pub fn has_set_out(&self) -> bool {
        matches!(&self.phase, Phase::Look(look) if look.ahead.is_some())
    }

    /// A job that goes on by itself, with an arm that may move.
    fn goes_on_by_itself(&self, devices: &DeviceSnapshot) -> bool {
        let job = self.job.as_ref().is_some_and(|job| !job.cancel && job.approved && job.settled);
        let free = gates::any_motion(self.mode.armed(), devices, self.nonce)
            .and_then(|()| gates::empty_handed(devices));
        let well = self.back.recovery.is_none() && self.back.weak.is_none();
        job && well && free.is_ok() && self.mode.runs()
    }

    fn way_out(&self, devices: &DeviceSnapshot) -> Option<CheckedPath> {
        let Phase::Look(look) = &self.phase else { return None };
        let (job, seen) = (self.job.as_ref()?, self.seen.as_ref()?);
        // A look at the whole table may end in anything, and so may one at something that is hidden.
        if look.region.is_none() || !job.gone.is_empty() || !self.goes_on_by_itself(devices) {
            return None;
        }
        let next = job.route.as_ref()?.first()?;
        let meant = self.meant.as_ref().filter(|meant| meant.on_disk && meant.step == job.moves)?;
        let task = self.model.object(&next.object)?.pick_n_place(next.from, next.to);
        // Gripped as was written down: no other way of gripping is tried while the arm waits.
        let hangs = meant.tool_from_object.map(|hangs| -hangs.theta);
        let task = PickNPlace { grip_yaw: task.grip_yaw.or(hangs), ..task };
        let mut table = self.tabletop(Some(seen), &next.object);
        let mut hangs = None;
        if let Some(held) = &self.back.held {
            hangs = Some((held.grasp.as_ref().filter(|_| held.let_go)?.load(), held.hold));
            let known = self.model.object(&held.object)?;
            let (name, footprint) = (known.id.clone(), known.footprint.clone());
            let placed = Standing { name, footprint, pose: held.to, height: known.height };
            table.standing.extend(Some(placed).filter(|placed| placed.name != next.object));
        }
        let paths = plan_straight(&self.model.arm, &devices.robot?.q, &task, &self.cycle(), &table)?;
        let path = set_out::set_out(&self.model.arm, &paths, &self.cycle(), &table, hangs)?;
        let (search_s, way_s) = (self.sight.searched_s, first_seconds(&path));
        let is_long = search_s > 0.0 && SEARCHED_WITHIN * way_s >= search_s + SPARE_S;
        let is_worth_it = way_s - first_seconds(&paths.approach) < WORTH * search_s;
        (is_long && is_worth_it).then_some(path)
    }

    /// What the look has shown is there, and the arm on its way: it goes on where all is as expected.
    pub(crate) fn go_on(&mut self, now: Timestamp, devices: &DeviceSnapshot, out: &mut Vec<Action>) {
        let Some((route, paths)) = self.what_goes_on(devices) else { return };
        let Phase::Look(look) = &mut self.phase else { return };
        let Some(Ahead { path, shown: Some(shown) }) = look.ahead.take() else { return };
        let left = path.segments().len().saturating_sub(self.times.segments());
        self.take_observed(now, shown, out);
        let goes_on = matches!(self.phase, Phase::Ready) && self.is_seen(now);
        if let Some(job) = self.job.as_mut().filter(|_| goes_on)
            && let Some(next) = route.first().cloned()
        {
            job.route = Some(route);
            self.set_to_work(now, devices, &next, paths, out);
        }
        if let Phase::Work(work) = &mut self.phase
            && let WorkStage::Approaching { segments } = &mut work.stage
        {
            *segments += left;
            return;
        }
        if matches!(self.phase, Phase::Work(_)) {
            self.not_begun(now, out);
        }
        // The way is finished first; what comes next is decided when the arm rests.
        let plan = LookPlan { poses: vec![path.end()], region: Some(Region::default()), for_age: Vec::new() };
        let look = Look { void: true, ..Look::begun(plan) };
        self.enter(Phase::Look(Box::new(look)), self.model.tolerances.look_deadline);
    }

    /// The rest of the route and the paths of its first pick-n-place, where the look has shown that nothing
    /// is to be decided.
    fn what_goes_on(&self, devices: &DeviceSnapshot) -> Option<(Vec<RouteAction>, PickNPlacePaths)> {
        let (Phase::Look(look), Some(job)) = (&self.phase, &self.job) else { return None };
        let (ahead, region) = (look.ahead.as_ref()?, look.region.as_ref()?);
        let shown = ahead.shown.as_ref()?.as_ref().ok()?;
        if look.void || look.failed.is_some() || !self.goes_on_by_itself(devices) {
            return None;
        }
        let hidden = shown.objects.iter().any(|object| self.should_have_shown(object, &look.stops));
        if hidden || self.let_go_unseen(shown) {
            return None;
        }
        let seen = self.with_what_is_remembered(shown.as_ref().clone(), region, &look.for_age);
        let higher = foreign_height(&self.model, &seen).is_some_and(|height| height > self.foreign_height);
        if higher || self.judge(&seen).is_some() || self.all_at_goals(job, &seen) {
            return None;
        }
        let route = self.checked_remainder(job, &seen)?;
        let next = route.first()?;
        let object = self.model.object(&next.object)?;
        if self.body_meets(&seen, next, object).is_some() {
            return None;
        }
        let (task, table) =
            (object.pick_n_place(next.from, next.to), self.tabletop(Some(&seen), &next.object));
        let paths = set_out::go_on(&self.model.arm, &ahead.path, &task, &self.cycle(), &table)?;
        let grasp = self.held(object, next, &paths).grasp;
        let meant = self.meant.as_ref().filter(|meant| meant.on_disk);
        meant.is_some_and(|meant| self.is_as_meant(meant, next, grasp.as_ref())).then_some((route, paths))
    }
}

/// Seconds of the first segment of a way, from rest to rest.
fn first_seconds(path: &CheckedPath) -> f64 {
    match path.segments().first() {
        Some(Segment::Joint { target, speed, acceleration, .. }) => {
            rest_to_rest(path.start().max_difference(target), *speed, *acceleration)
        }
        Some(Segment::Linear { .. }) | None => 0.0,
    }
}
