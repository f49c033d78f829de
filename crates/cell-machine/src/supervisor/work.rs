//! One pick-n-place: approach, grip and verify, carry, release, and on to the next look; and what to do when
//! a grip fails.
//!
//! What is meant is on disk before the arm sets out for it. The next one is written down when the object is
//! released, and reaches the disk while the arm goes to look; nothing else of a pick-n-place waits for the
//! disk.

use crate::code::{Code, JobStatus};
use crate::device::gripper_types::{GripperCommand, GripperEvent, GripperFault};
use crate::device::robot_types::RobotCommand;
use crate::supervisor::back::Held;
use crate::supervisor::cell::Supervisor;
use crate::supervisor::gates;
use crate::supervisor::input::{Action, DeviceSnapshot, Record};
use crate::supervisor::model::CellObject;
use crate::supervisor::order::RouteAction;
use crate::supervisor::phase::{Look, Meant, Phase, Work, WorkStage};
use crate::supervisor::reason::{alarm, say, with_fault};
use cell_motion::bodies::{Standing, Tabletop};
use cell_motion::path::{CheckedPath, PathFault};
use cell_motion::pick_n_place::{PickNPlace, PickNPlacePaths, leave, plan};
use cell_motion::put_down::Grasp;
use cell_values::time::Timestamp;
use cell_values::units::Joints;
use cell_vision::observe::Observation;
use rearrange::geometry::collision::penetration;
use rearrange::geometry::footprint::Footprint;
use rearrange::geometry::pose::Pose2;
use rearrange::planning::plan::ActionKind;

/// A pick-n-place is the one that was written down where its object lies, and hangs on the tool, as near to
/// that as this: m and rad.
const AS_MEANT: (f64, f64) = (2e-3, 0.02);

impl Supervisor {
    /// Starts the next pick-n-place of the route, whose first action begins where its object was just seen.
    pub(crate) fn begin_pick_n_place(
        &mut self,
        now: Timestamp,
        devices: &DeviceSnapshot,
        out: &mut Vec<Action>,
    ) {
        let (Some(job), Some(robot)) = (&self.job, devices.robot) else { return };
        if let Err(closed) =
            gates::manipulate(self.mode.armed(), devices, self.nonce, self.is_seen(now), job.approved)
        {
            return self.wait(now, closed, out);
        }
        if self.gave_way(now, out) {
            return;
        }
        let Some(job) = &self.job else { return };
        let Some(next) = job.route.as_ref().and_then(|route| route.first()).cloned() else { return };
        let Some(object) = self.model.object(&next.object) else { return };
        if let Some(neighbour) = self.seen.as_ref().and_then(|seen| self.body_meets(seen, &next, object)) {
            let message = format!("the gripper's body would meet {neighbour} beside {}", next.object);
            let hint = "move the two apart by hand, or give the job a goal with more room";
            let reason = Code::Unpickable.because(message, hint).of(&next.object);
            return self.finish(now, JobStatus::Failed, reason, out);
        }
        let table = self.tabletop(self.seen.as_ref(), &next.object);
        let task = object.pick_n_place(next.from, next.to);
        match self.paths(&robot.q, &task, &table) {
            Ok(paths) => self.set_to_work(now, devices, &next, paths, out),
            Err(fault) => {
                let message = format!("{} cannot be moved: {fault}", next.object);
                let reason = Code::Unreachable.because(message, fault.hint()).of(&next.object);
                self.finish(now, JobStatus::Failed, reason, out);
            }
        }
    }

    /// Begins a pick-n-place on these paths as soon as it is written down.
    pub(crate) fn set_to_work(
        &mut self,
        now: Timestamp,
        devices: &DeviceSnapshot,
        next: &RouteAction,
        paths: PickNPlacePaths,
        out: &mut Vec<Action>,
    ) {
        let Some(object) = self.model.object(&next.object) else { return };
        let (held, object) = (self.held(object, next, &paths), next.object.clone());
        let meant = self.meant.take().filter(|meant| self.is_as_meant(meant, next, held.grasp.as_ref()));
        let meant = meant.unwrap_or_else(|| self.mean(now, next, held.grasp.as_ref(), out));
        let stage = WorkStage::NotingIntent(meant.number);
        let work = Work { object, from: next.from, held, paths, stage, over: false, then: None };
        self.enter(Phase::Work(Box::new(work)), self.model.tolerances.phase_deadline);
        if meant.on_disk {
            self.begin_approach(now, devices, out);
        }
    }

    /// The paths of a pick-n-place, its object gripped as was written down while the arm can do that: what
    /// is written down then still holds, although the table is seen a little otherwise.
    fn paths(
        &self,
        from: &Joints,
        task: &PickNPlace,
        table: &Tabletop,
    ) -> Result<PickNPlacePaths, PathFault> {
        let planned = |task: &PickNPlace| plan(&self.model.arm, from, task, &self.cycle(), table);
        let meant = self.meant.as_ref().filter(|meant| meant.action.object == task.object);
        let hangs = meant.and_then(|meant| meant.tool_from_object).filter(|_| task.grip_yaw.is_none());
        let as_meant = hangs
            .and_then(|hangs| planned(&PickNPlace { grip_yaw: Some(-hangs.theta), ..task.clone() }).ok());
        as_meant.map_or_else(|| planned(task), Ok)
    }

    /// What will hang on the gripper.
    pub(crate) fn held(&self, object: &CellObject, next: &RouteAction, paths: &PickNPlacePaths) -> Held {
        let lying = object.pick_n_place(next.from, next.to).lying_at(next.from);
        Held {
            object: next.object.clone(),
            grasp: Grasp::new(&self.model.arm, &paths.carry.start(), &lying, object.hold),
            height: object.height,
            mass: object.mass,
            hold: object.hold,
            to: next.to,
            let_go: false,
            unsealed: false,
        }
    }

    /// Has the next pick-n-place written down.
    fn mean(
        &mut self,
        now: Timestamp,
        next: &RouteAction,
        grasp: Option<&Grasp>,
        out: &mut Vec<Action>,
    ) -> Meant {
        let step = self.job.as_ref().map_or(0, |job| job.moves);
        let tool_from_object = grasp.map(|grasp| grasp.load().tool_from_object);
        let record = Record::Intent {
            step,
            object: next.object.clone(),
            from: next.from,
            to: next.to,
            kind: if next.to_goal { ActionKind::Goal } else { ActionKind::Buffer },
            tool_from_object,
            table: self.back.table.clone(),
        };
        let number = self.commit(now, record, out);
        Meant { number, on_disk: false, step, action: next.clone(), tool_from_object }
    }

    /// What was written down is what is about to be done.
    pub(crate) fn is_as_meant(&self, meant: &Meant, next: &RouteAction, grasp: Option<&Grasp>) -> bool {
        let near = |a: &Pose2, b: &Pose2| a.distance(b) <= AS_MEANT.0 && a.angle_difference(b) <= AS_MEANT.1;
        let hangs = match (&meant.tool_from_object, grasp) {
            (Some(meant), Some(grasp)) => near(meant, &grasp.load().tool_from_object),
            (None, None) => true,
            (Some(_), None) | (None, Some(_)) => false,
        };
        let RouteAction { object, from, to, to_goal } = &meant.action;
        let step = self.job.as_ref().map(|job| job.moves);
        let same = *object == next.object && *to == next.to && *to_goal == next.to_goal;
        same && near(from, &next.from) && hangs && step == Some(meant.step)
    }

    /// The pick-n-place that was written down is not begun now: a later start must not take it for one that
    /// may have been.
    pub(crate) fn withdraw_meant(&mut self, now: Timestamp, out: &mut Vec<Action>) {
        if let Some(meant) = self.meant.take() {
            self.commit(now, Record::Withdrawn { step: meant.step }, out);
        }
    }

    /// A pick-n-place for which the arm has not set out is given up.
    pub(crate) fn not_begun(&mut self, now: Timestamp, out: &mut Vec<Action>) {
        self.phase = Phase::Ready;
        let step = self.job.as_ref().map_or(0, |job| job.moves);
        self.commit(now, Record::Withdrawn { step }, out);
    }

    /// The record with this number is on disk: what waited for it goes on.
    pub(crate) fn work_noted(
        &mut self,
        now: Timestamp,
        devices: &DeviceSnapshot,
        number: u64,
        out: &mut Vec<Action>,
    ) {
        if let Some(meant) = self.meant.as_mut().filter(|meant| meant.number == number) {
            meant.on_disk = true;
        }
        let Phase::Work(work) = &self.phase else { return };
        if work.stage == WorkStage::NotingIntent(number) {
            self.begin_approach(now, devices, out);
        }
    }

    /// The intent is on disk. Writing it took time: every gate is looked at again before the arm moves.
    fn begin_approach(&mut self, now: Timestamp, devices: &DeviceSnapshot, out: &mut Vec<Action>) {
        let approved = self.job.as_ref().is_some_and(|job| job.approved);
        let (armed, observed) = (self.mode.armed(), self.is_seen(now));
        if let Err(closed) = gates::manipulate(armed, devices, self.nonce, observed, approved) {
            self.not_begun(now, out);
            return self.wait(now, closed, out);
        }
        let Phase::Work(work) = &mut self.phase else { return };
        work.stage = WorkStage::Approaching { segments: work.paths.approach.segments().len() };
        out.push(Action::Robot(RobotCommand::Stream(work.paths.approach.clone())));
        self.remaining = self.model.tolerances.phase_deadline;
        self.begin_improving(out);
    }

    /// An object so tall that the gripper's body, coming down for the pick or the place, would touch it. The
    /// body counts as a disc about the tool's axis, for the yaw is chosen later.
    pub(crate) fn body_meets(
        &self,
        seen: &Observation,
        next: &RouteAction,
        object: &CellObject,
    ) -> Option<String> {
        let body = self.model.grip.body_radius;
        let underside = object.height - self.model.cycle.press + self.model.grip.body_above_lips;
        let places = [next.from, next.to].map(|pose| pose.transform(object.grip_point));
        if let Some(foreign) = self.meets_foreign(seen, &places, body, underside) {
            return Some(foreign);
        }
        let others = seen.objects.iter().filter(|other| other.id != object.id);
        let moving = others.filter_map(|other| self.model.object(&other.id).map(|known| (known, other.pose)));
        let mut tall = moving.filter(|(known, _)| known.height > underside);
        let disc = Footprint::Disc { radius: body };
        tall.find_map(|(known, pose)| {
            let meets = places
                .iter()
                .any(|[x, y]| penetration(&disc, &Pose2::new(*x, *y, 0.0), &known.footprint, &pose) > 0.0);
            meets.then(|| known.id.clone())
        })
    }

    /// The arm finished the path of the present stage.
    pub(crate) fn work_path_finished(&mut self, now: Timestamp, out: &mut Vec<Action>) {
        let Phase::Work(work) = &mut self.phase else { return };
        let channels = self.model.grip.channels;
        match work.stage {
            WorkStage::Approaching { .. } => {
                work.stage = WorkStage::Gripping;
                self.back.held = Some(work.held.clone());
                let (object, from, mass) = (work.object.clone(), work.from, work.held.mass);
                let target = self.model.grip.vacuum_target;
                out.push(Action::Gripper(GripperCommand::Grip { channels, target }));
                // From here on the object counts as held. The controller takes the payload over while the
                // arm rests.
                self.set_payload(mass, out);
                // From here on the table is no longer what was seen.
                self.disturb(&object, &from);
            }
            WorkStage::Carrying { .. } => {
                work.stage = WorkStage::Releasing;
                out.push(Action::Gripper(GripperCommand::Release { channels }));
                // The object stands on its place: the controller takes the payload off while the vacuum
                // falls. A release that fails ends in a stop, after which the program is given what hangs.
                self.set_payload(0.0, out);
            }
            WorkStage::Retreating => return self.left_the_place(now, out),
            // One step is one try.
            WorkStage::Withdrawing => {
                self.phase = Phase::Ready;
                self.mode.step_over();
                return;
            }
            WorkStage::NotingIntent(_) | WorkStage::Gripping | WorkStage::Releasing | WorkStage::GivingUp => {
            }
        }
        self.remaining = self.model.tolerances.phase_deadline;
    }

    /// One segment of a path is behind: from over the place the arm goes on to look.
    pub(crate) fn work_segment_finished(&mut self, now: Timestamp, out: &mut Vec<Action>) {
        let Phase::Work(work) = &mut self.phase else { return };
        if work.stage != WorkStage::Retreating {
            return;
        }
        let Some(then) = work.then.take() else { return };
        self.left_the_place(now, out);
        // A pause, a park pose that is waited for, an end of the job: the way is finished, and nothing
        // follows.
        let goes_on = self.mode.runs() && self.job.as_ref().is_some_and(|job| !job.cancel);
        let look = Look { void: !goes_on, ..Look::begun(then) };
        if look.region.is_none() {
            self.times.begins_round();
        }
        self.enter(Phase::Look(Box::new(look)), self.model.tolerances.look_deadline);
    }

    /// The arm is over the placed object again.
    fn left_the_place(&mut self, now: Timestamp, out: &mut Vec<Action>) {
        let over = matches!(&self.phase, Phase::Work(work) if work.over);
        if !over {
            self.note_done(now, out);
        }
        self.phase = Phase::Ready;
        self.mode.step_over();
    }

    /// The object is at its place.
    pub(crate) fn note_done(&mut self, now: Timestamp, out: &mut Vec<Action>) {
        self.moved_one();
        self.times.move_over();
        let Some(job) = &mut self.job else { return };
        let step = job.moves;
        job.moves += 1;
        job.grip_failures = 0;
        if let Some(route) = job.route.as_mut().filter(|route| !route.is_empty()) {
            route.remove(0);
        }
        self.commit(now, Record::Done { step }, out);
    }

    /// The gripper reports during a pick-n-place.
    pub(crate) fn work_gripper(
        &mut self,
        now: Timestamp,
        devices: &DeviceSnapshot,
        event: GripperEvent,
        out: &mut Vec<Action>,
    ) {
        let Phase::Work(work) = &mut self.phase else { return };
        let step = self.job.as_ref().map_or(0, |job| job.moves);
        match (work.stage, event) {
            (WorkStage::Gripping, GripperEvent::Gripped { .. }) => {
                work.stage = WorkStage::Carrying { segments: work.paths.carry.segments().len() };
                let (object, carry) = (work.object.clone(), work.paths.carry.clone());
                self.note_moved(&object);
                self.commit(now, Record::Gripped { step }, out);
                out.push(Action::Robot(RobotCommand::Stream(carry)));
            }
            (WorkStage::Gripping, GripperEvent::GripFailed { vacuum }) => {
                say(out, format!("{} did not seal: vacuum only {:.0} %", work.object, vacuum * 100.0));
                work.stage = WorkStage::GivingUp;
                self.seen = None;
                out.push(Action::Gripper(GripperCommand::Release { channels: self.model.grip.channels }));
                self.set_payload(0.0, out);
            }
            (WorkStage::Releasing, GripperEvent::Released) => {
                self.commit(now, Record::Released { step }, out);
                self.retreat(now, devices, out);
            }
            (WorkStage::GivingUp, GripperEvent::Released) => {
                work.stage = WorkStage::Withdrawing;
                out.push(Action::Robot(RobotCommand::Stream(work.paths.give_up.clone())));
                return self.count_grip_failure(now, out);
            }
            (WorkStage::Carrying { .. }, GripperEvent::VacuumLost { vacuum }) => {
                let object = work.object.clone();
                return self.carried_was_lost(now, object, vacuum, out);
            }
            // Readings and repeated answers change nothing; a phase that waits in vain runs into its
            // deadline.
            (
                _,
                GripperEvent::Gripped { .. }
                | GripperEvent::GripFailed { .. }
                | GripperEvent::Released
                | GripperEvent::ReleaseFailed { .. }
                | GripperEvent::VacuumWeak { .. }
                | GripperEvent::VacuumLost { .. }
                | GripperEvent::Unreachable { .. }
                | GripperEvent::Answering
                | GripperEvent::Refused
                | GripperEvent::Reading { .. },
            ) => return,
        }
        self.remaining = self.model.tolerances.phase_deadline;
    }

    /// What was carried hangs there no more.
    fn carried_was_lost(&mut self, now: Timestamp, object: String, vacuum: f64, out: &mut Vec<Action>) {
        let message = format!("{object} was lost: vacuum {:.0} %", vacuum * 100.0);
        let hint =
            "see where it lies, or whether it still hangs: `celld recover` says what the gripper reads";
        let reason = Code::VacuumLost.because(message, hint).of(object);
        match self.job_outlives_a_stop() {
            true => self.stop_and_keep_the_job(now, reason, out),
            false => self.stop_all(now, JobStatus::Failed, reason, out),
        }
    }

    /// The object is released: straight up, and where the job goes on, to the next look without a stop.
    fn retreat(&mut self, now: Timestamp, devices: &DeviceSnapshot, out: &mut Vec<Action>) {
        let Phase::Work(work) = &mut self.phase else { return };
        work.stage = WorkStage::Retreating;
        let (object, to, up) = (work.object.clone(), work.held.to, work.paths.retreat.clone());
        self.disturb(&object, &to);
        self.back.table.retain(|(id, _)| *id != object);
        self.back.table.push((object, to));
        let path = self.goes_on(devices).then(|| self.on_to_look(now, &up.start(), &up.end(), out)).flatten();
        out.push(Action::Robot(RobotCommand::Stream(path.unwrap_or(up))));
    }

    /// Nothing keeps the arm from going on with the job.
    fn goes_on(&self, devices: &DeviceSnapshot) -> bool {
        let job = self.job.as_ref().is_some_and(|job| !job.cancel && job.approved);
        let open = gates::any_motion(self.mode.armed(), devices, self.nonce).is_ok();
        job && open && self.mode.runs() && self.back.weak.is_none()
    }

    /// From a place (joints `from`, and `over` it) on to where the next look begins; and what is done after
    /// that look is written down.
    fn on_to_look(
        &mut self,
        now: Timestamp,
        from: &Joints,
        over: &Joints,
        out: &mut Vec<Action>,
    ) -> Option<CheckedPath> {
        let Phase::Work(work) = &self.phase else { return None };
        let (object, to) = (self.model.object(&work.object)?, work.held.to);
        let task = object.pick_n_place(to, to);
        let load = work.held.grasp.as_ref()?.load().clone();
        let table = self.tabletop(self.seen.as_ref(), &work.object);
        self.note_done(now, out);
        if let Phase::Work(work) = &mut self.phase {
            work.over = true;
        }
        let look = self.next_look(now, over);
        let first = look.poses.first()?;
        let path = leave(&self.model.arm, [from, over, first], (&task, &load), &self.cycle(), &table)?;
        self.mean_next(now, look.poses.last()?, out);
        if let Phase::Work(work) = &mut self.phase {
            work.then = Some(look);
        }
        Some(path)
    }

    /// Writes down the pick-n-place that follows a look from `view`, as far as it is known before that.
    fn mean_next(&mut self, now: Timestamp, view: &Joints, out: &mut Vec<Action>) {
        let route = self.job.as_ref().and_then(|job| job.route.as_ref());
        let Some(next) = route.and_then(|route| route.first()).cloned() else { return };
        let Some(object) = self.model.object(&next.object) else { return };
        let mut table = self.tabletop(self.seen.as_ref(), &next.object);
        // The look will show what was just put down; until then only its place is known.
        table.standing.extend(self.just_put_down().filter(|placed| placed.name != next.object));
        let task = object.pick_n_place(next.from, next.to);
        let Ok(paths) = plan(&self.model.arm, view, &task, &self.cycle(), &table) else { return };
        let grasp = self.held(object, &next, &paths).grasp;
        self.meant = Some(self.mean(now, &next, grasp.as_ref(), out));
    }

    /// What the pick-n-place under way has put down, where it should be.
    fn just_put_down(&self) -> Option<Standing> {
        let Phase::Work(work) = &self.phase else { return None };
        let known = self.model.object(&work.object)?;
        let (name, footprint) = (known.id.clone(), known.footprint.clone());
        Some(Standing { name, footprint, pose: work.held.to, height: known.height })
    }

    /// True while an object is gripped, held or let go.
    pub(crate) fn gripper_needed(&self) -> bool {
        let Phase::Work(work) = &self.phase else { return false };
        match work.stage {
            WorkStage::Gripping | WorkStage::Carrying { .. } | WorkStage::Releasing | WorkStage::GivingUp => {
                true
            }
            WorkStage::NotingIntent(_)
            | WorkStage::Approaching { .. }
            | WorkStage::Retreating
            | WorkStage::Withdrawing => false,
        }
    }

    /// Whether the object is held is unknown from here on: the arm stops where it is.
    pub(crate) fn on_gripper_silent(&mut self, now: Timestamp, fault: GripperFault, out: &mut Vec<Action>) {
        let Phase::Work(work) = &self.phase else { return };
        let during = match work.stage {
            WorkStage::Gripping => "gripping",
            WorkStage::Releasing | WorkStage::GivingUp => "releasing",
            WorkStage::NotingIntent(_)
            | WorkStage::Approaching { .. }
            | WorkStage::Carrying { .. }
            | WorkStage::Retreating
            | WorkStage::Withdrawing => "holding",
        };
        let stopped = format!("gripper not responding while {during} {}", work.object);
        let message = with_fault(stopped, fault);
        let hint = "stay clear, the object may fall; check the Compute Box's power and network; \
                    `celld recover` shows what is held and the ways back";
        let reason = Code::GripperUnreachable.because(message, hint).of(&work.object);
        self.stop_all(now, JobStatus::Interrupted, reason, out);
    }

    fn count_grip_failure(&mut self, now: Timestamp, out: &mut Vec<Action>) {
        let retries = self.model.tolerances.retries;
        let Some(job) = &mut self.job else { return };
        job.grip_failures += 1;
        if job.grip_failures > retries {
            let object = job.route.as_ref().and_then(|route| route.first()).map(|a| a.object.clone());
            let object = object.unwrap_or_default();
            let message = format!("{object} could not be gripped in {} tries", retries + 1);
            alarm(out, message.clone());
            let hint = "clean cups and object, check the grip point, then submit again";
            self.finish(now, JobStatus::Failed, Code::Unpickable.because(message, hint).of(object), out);
        }
    }
}
