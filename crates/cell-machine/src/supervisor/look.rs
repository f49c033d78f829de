//! Looking at the table: going to where it is seen from, taking pictures, judging what they show.
//!
//! A frame counts only if the arm was at rest before and after it was exposed; the arm goes on as soon as it
//! is, and what it shows comes later. What a look shows is valid until an object is picked, placed or
//! dropped, or the cell was stopped; which part of the table has to be seen is in `sight`.

use crate::code::{Code, JobStatus};
use crate::device::robot_types::RobotCommand;
use crate::stillness::{STILL_RAD, Stillness};
use crate::supervisor::cell::Supervisor;
use crate::supervisor::gates;
use crate::supervisor::input::{Action, CameraFault, DeviceSnapshot};
use crate::supervisor::judge::foreign_height;
use crate::supervisor::look_plan::{LookPlan, Stop};
use crate::supervisor::phase::{Glance, JobRun, LastSeen, Look, LookStage, Phase};
use crate::supervisor::reason::{Reason, alarm, say};
use crate::supervisor::travel::NoTravel;
use cell_values::time::Timestamp;
use cell_values::units::Joints;
use cell_vision::observe::{Observation, PartialLook, View};
use std::collections::VecDeque;

impl Look {
    /// On the way to the first pose of a plan.
    pub(crate) fn begun(plan: LookPlan) -> Look {
        let LookPlan { poses, region, for_age } = plan;
        Look {
            poses,
            region,
            for_age,
            at: 0,
            stage: LookStage::Moving,
            views: Vec::new(),
            awaited: VecDeque::new(),
            stops: Vec::new(),
            fault: None,
            failed: None,
            void: false,
            exposed: None,
            known: None,
            ahead: None,
        }
    }
}

impl Supervisor {
    /// Begins the look that what comes next needs.
    pub(crate) fn begin_look(&mut self, now: Timestamp, devices: &DeviceSnapshot, out: &mut Vec<Action>) {
        let Some(robot) = devices.robot else { return };
        let plan = self.next_look(now, &robot.q);
        self.begin(now, devices, Look::begun(plan), out);
    }

    /// The same of the whole table, whatever comes next.
    pub(crate) fn begin_whole_look(
        &mut self,
        now: Timestamp,
        devices: &DeviceSnapshot,
        out: &mut Vec<Action>,
    ) {
        self.seen = None;
        self.begin(now, devices, Look::begun(self.whole_look()), out);
    }

    fn begin(&mut self, now: Timestamp, devices: &DeviceSnapshot, look: Look, out: &mut Vec<Action>) {
        if look.region.is_none() {
            self.times.begins_round();
        }
        self.go_to_look(now, devices, look, out);
    }

    /// Sends the arm to the present pose of a look.
    fn go_to_look(
        &mut self,
        now: Timestamp,
        devices: &DeviceSnapshot,
        mut look: Look,
        out: &mut Vec<Action>,
    ) {
        let (Some(robot), Some(target)) = (devices.robot, look.poses.get(look.at).copied()) else { return };
        match self.transfer_to(&robot.q, target) {
            Ok(path) => {
                out.push(Action::Robot(RobotCommand::Stream(path)));
                look.stage = LookStage::Moving;
                self.enter(Phase::Look(Box::new(look)), self.model.tolerances.look_deadline);
            }
            // Taught poses are known to be reached.
            Err(_) if look.region.is_some() && self.seen.is_some() => {
                self.begin_whole_look(now, devices, out)
            }
            Err(fault) => match self.place_look(&robot.q).filter(|_| look.region.is_none()) {
                // What was let go may hang on the cups and be in the way: first its place alone is looked
                // at, from where the arm can get to with it.
                Some(plan) => {
                    self.seen = None;
                    self.go_to_look(now, devices, Look::begun(plan), out);
                }
                None => self.no_way_to_look(now, look.at, (&robot.q, &fault), out),
            },
        }
    }

    /// The look pose cannot be reached from here: a person has to see why.
    fn no_way_to_look(
        &mut self,
        now: Timestamp,
        view: usize,
        (from, fault): (&Joints, &NoTravel),
        out: &mut Vec<Action>,
    ) {
        self.phase = Phase::Ready;
        let message = format!("look pose {} cannot be reached: {fault}", view + 1);
        let advice = self.advice(from, fault);
        if self.back.recovery.is_some() {
            return self.end_recovery(Err(format!("{message}; {advice}")), out);
        }
        self.mode.disarm();
        let in_the_way = fault.meets_layer() && self.foreign_height > self.model.cycle.tallest;
        let reason = if in_the_way && self.foreign_height.is_finite() {
            let height_mm = self.foreign_height * 1e3;
            let what = format!("something without a marker reaches up to {height_mm:.0} mm over the table");
            Code::ForeignObject.because(format!("{message}; {what}"), "take it away, then `celld arm`")
        } else if in_the_way {
            let what =
                "something without a marker is on the table; without a depth camera its height is not known";
            Code::ForeignObject.because(what, "take it away, then `celld arm`")
        } else {
            Code::Unreachable.because(message, format!("{advice}, then `celld arm` and submit again"))
        };
        alarm(out, format!("{}; disarmed; {}", reason.message, reason.hint));
        self.finish(now, JobStatus::Failed, reason, out);
    }

    /// The arm has come to a look pose, or to where a look that is not wanted any more ends.
    pub(crate) fn look_pose_reached(&mut self, now: Timestamp, out: &mut Vec<Action>) {
        let Phase::Look(look) = &mut self.phase else { return };
        if look.void {
            self.phase = Phase::Ready;
            return;
        }
        if let Some(fault) = look.failed.take() {
            return self.give_up_looking(now, &fault, out);
        }
        if let Some(shown) = look.ahead.take().and_then(|ahead| ahead.shown) {
            return self.take_observed(now, shown, out);
        }
        if matches!(look.stage, LookStage::Moving) {
            look.stage = LookStage::Settling { rest: Stillness::default() };
        }
    }

    /// While settling: requests frames once the arm has been at rest long enough.
    pub(crate) fn watch_settling(&mut self, now: Timestamp, devices: &DeviceSnapshot, out: &mut Vec<Action>) {
        let Phase::Look(look) = &mut self.phase else { return };
        let LookStage::Settling { rest } = &mut look.stage else { return };
        let Some(robot) = devices.robot.filter(|_| devices.robot_fresh) else { return };
        if rest.note(robot.received, &robot.q) < self.model.tolerances.settle {
            rest.report(now).into_iter().for_each(|why| say(out, why));
            return;
        }
        let table_from_camera = self.model.camera_at(&robot.q);
        look.stage = LookStage::Capturing { q: robot.q };
        let first = look.views.is_empty() && look.awaited.is_empty();
        // One frame of the places that are looked at before every pick; the whole table more carefully.
        let frames = if look.region.is_some() { 1 } else { self.model.frames_per_view };
        self.times.stopped_for_a_picture(look.region.is_none());
        out.push(Action::Capture { frames, table_from_camera, first });
    }

    /// The frames of this pose are exposed: the arm may go on.
    pub(crate) fn on_exposed(&mut self, now: Timestamp, devices: &DeviceSnapshot, out: &mut Vec<Action>) {
        self.camera = Some(Ok(()));
        let Phase::Look(look) = &mut self.phase else { return };
        let LookStage::Capturing { q } = &look.stage else { return };
        let moved = devices.robot.is_none_or(|robot| robot.q.max_difference(q) > STILL_RAD);
        look.awaited.push_back(!moved);
        if moved {
            say(out, "the arm moved while a frame was taken; taking it again");
            look.stage = LookStage::Settling { rest: Stillness::default() };
            return;
        }
        if look.fault.take().is_some() {
            say(out, "the camera gives pictures again");
        }
        look.at += 1;
        if look.at == look.poses.len() {
            look.at -= 1;
            look.stage = LookStage::Observing;
            look.exposed = Some(now);
            return self.set_out(devices, out);
        }
        // Much may have happened since the first pose: a person may have disarmed the cell.
        let open = gates::any_motion(self.mode.armed(), devices, self.nonce).is_ok();
        if let Phase::Look(look) = std::mem::replace(&mut self.phase, Phase::Ready)
            && open
        {
            self.go_to_look(now, devices, *look, out);
        }
    }

    /// What the frames of one pose show, oldest first.
    pub(crate) fn on_captured(
        &mut self,
        now: Timestamp,
        devices: &DeviceSnapshot,
        result: Result<Vec<View>, CameraFault>,
        out: &mut Vec<Action>,
    ) {
        let Phase::Look(look) = &mut self.phase else { return };
        if look.awaited.is_empty() {
            match &result {
                // Whoever does not report exposures has just ended one.
                Ok(_) => self.on_exposed(now, devices, out),
                Err(fault) => return self.no_picture(now, fault.clone(), out),
            }
        }
        let Phase::Look(look) = &mut self.phase else { return };
        match (look.awaited.pop_front(), result) {
            (Some(true), Ok(views)) => {
                let stop = views.first().map(|view| Stop { at: view.time, camera: view.table_from_camera });
                look.stops.extend(stop);
                look.views.extend(views);
            }
            (Some(true), Err(fault)) => return self.no_detection(now, fault, out),
            (Some(false) | None, _) => {}
        }
        self.observe_when_complete(out);
    }

    /// All pictures are taken and searched: what do they show together?
    fn observe_when_complete(&mut self, out: &mut Vec<Action>) {
        let Phase::Look(look) = &mut self.phase else { return };
        if !matches!(look.stage, LookStage::Observing) || !look.awaited.is_empty() {
            return;
        }
        let views = std::mem::take(&mut look.views);
        let partial = look.region.clone().map(|region| {
            let seen = self.seen.iter().flat_map(|seen| &seen.objects);
            let remembered = seen.map(|object| (object.id.clone(), object.pose)).collect();
            PartialLook { region, remembered }
        });
        let held = self.held_in_sight();
        out.push(Action::Observe { views, partial, held });
    }

    /// A picture that was taken could not be searched, which waiting does not mend. An arm on its way ends
    /// that first.
    fn no_detection(&mut self, now: Timestamp, fault: CameraFault, out: &mut Vec<Action>) {
        let Phase::Look(look) = &mut self.phase else { return };
        match look.stage {
            LookStage::Moving => look.failed = Some(fault),
            LookStage::Observing if look.ahead.is_some() => look.failed = Some(fault),
            LookStage::Settling { .. } | LookStage::Capturing { .. } | LookStage::Observing => {
                self.give_up_looking(now, &fault, out);
            }
        }
    }

    /// The arm is at rest and waits for the camera; the look's deadline decides when this has gone on for
    /// too long.
    fn no_picture(&mut self, now: Timestamp, fault: CameraFault, out: &mut Vec<Action>) {
        let Phase::Look(look) = &mut self.phase else { return };
        if !matches!(look.stage, LookStage::Capturing { .. }) {
            return;
        }
        self.camera = Some(Err(fault.message.clone()));
        if self.job.as_ref().is_some_and(|job| job.cancel) {
            // This picture is not awaited any more.
            self.phase = Phase::Ready;
            return;
        }
        if fault.lasting {
            return self.give_up_looking(now, &fault, out);
        }
        look.stage = LookStage::Settling { rest: Stillness::default() };
        if look.fault.as_ref().is_none_or(|before| before.code != fault.code) {
            alarm(
                out,
                format!(
                    "waiting for the camera ({}): {}; the arm moves on as soon as a picture comes, `celld \
                     disarm` before going to it; {}",
                    fault.code, fault.message, fault.hint
                ),
            );
        }
        look.fault = Some(fault);
    }

    /// Ends the job for want of a picture. The arm is at rest, nothing hangs on it and nothing was stopped,
    /// so the cell stays armed: the next job looks again.
    pub(crate) fn give_up_looking(&mut self, now: Timestamp, fault: &CameraFault, out: &mut Vec<Action>) {
        self.phase = Phase::Ready;
        self.seen = None;
        self.camera = Some(Err(fault.message.clone()));
        if self.back.recovery.is_some() {
            return self.end_recovery(Err(format!("{}; {}", fault.message, fault.hint)), out);
        }
        let reason = fault.code.because(fault.message.clone(), fault.hint.as_ref());
        self.finish(now, JobStatus::Failed, reason, out);
    }

    /// What the pictures of a look show together. An arm that has set out goes on with it, or else comes to
    /// rest first.
    pub(crate) fn on_observed(
        &mut self,
        now: Timestamp,
        devices: &DeviceSnapshot,
        result: Result<Box<Observation>, String>,
        out: &mut Vec<Action>,
    ) {
        let Phase::Look(look) = &mut self.phase else { return };
        if !matches!(look.stage, LookStage::Observing) {
            return;
        }
        look.known = Some(now);
        if let Some(exposed) = look.exposed {
            self.sight.searched_s = now.since(exposed).as_secs_f64();
        }
        match &mut look.ahead {
            None => self.take_observed(now, result, out),
            Some(ahead) => {
                ahead.shown = Some(result);
                self.go_on(now, devices, out);
            }
        }
    }

    pub(crate) fn take_observed(
        &mut self,
        now: Timestamp,
        result: Result<Box<Observation>, String>,
        out: &mut Vec<Action>,
    ) {
        let Phase::Look(look) = &mut self.phase else { return };
        let (region, stops) = (look.region.take(), std::mem::take(&mut look.stops));
        // What waited for the arm to rest is as old as it is.
        let known = look.known.unwrap_or(now);
        let for_age = std::mem::take(&mut look.for_age);
        self.phase = Phase::Ready;
        let observation = match result {
            Ok(observation) => *observation,
            Err(reason) => {
                let hint = "check the camera's calibration and the markers in the configuration";
                if self.back.recovery.is_some() {
                    return self.end_recovery(Err(format!("{reason}; {hint}")), out);
                }
                self.finish(now, JobStatus::Failed, Code::Observation.because(reason, hint), out);
                return;
            }
        };
        if self.back.recovery.is_some() {
            return self.on_recovery_look(now, observation, out);
        }
        let whole = region.is_none();
        if !whole && self.seen.is_some() && self.let_go_unseen(&observation) {
            // One picture from one side: the whole table is looked at before a person is sent to the cups.
            self.seen = None;
            return;
        }
        if self.sticks(now, &observation, out) {
            return;
        }
        if !whole && self.seen.is_none() {
            // It showed what it had to: that nothing hangs on the cups. The table is looked at next.
            return;
        }
        if let Some(rejection) = self.gone(&observation, &stops) {
            self.seen = None;
            return self.look_again(now, rejection, out);
        }
        let observation = match region {
            Some(region) => self.with_what_is_remembered(observation, &region, &for_age),
            None => observation,
        };
        self.back.table = observation.objects.iter().map(|object| (object.id.clone(), object.pose)).collect();
        self.judge_look((now, known), observation, whole, out);
    }

    /// What was seen is acted upon, or doubted.
    fn judge_look(
        &mut self,
        (now, known): (Timestamp, Timestamp),
        observation: Observation,
        whole: bool,
        out: &mut Vec<Action>,
    ) {
        let fault = self.judge(&observation);
        if let Some(height) = foreign_height(&self.model, &observation) {
            self.foreign_height = if whole { height } else { self.foreign_height.max(height) };
        }
        self.report_obstacles(&observation, out);
        if fault.is_none() {
            self.report_drift(&observation, out);
        }
        let Some(job) = &mut self.job else { return };
        for object in &observation.objects {
            job.last_seen.retain(|seen| seen.id != object.id);
            let (id, pose, at) = (object.id.clone(), object.pose, object.time);
            job.last_seen.push(LastSeen { id, pose, at, moved: false });
        }
        match fault {
            None => {
                (job.look_failures, job.rejection) = (0, None);
                report_absent(job, &observation, out);
                if whole {
                    self.glance = Some(Glance { seen: observation.clone(), at: known });
                }
                let before = self.seen.replace(observation);
                self.seen_at = known;
                self.looked(known, whole, before.as_ref());
            }
            Some(rejection) => {
                self.seen = None;
                self.look_again(now, rejection, out);
            }
        }
    }

    /// What was seen cannot be acted upon: another look, or the end of the job.
    fn look_again(&mut self, now: Timestamp, rejection: Reason, out: &mut Vec<Action>) {
        let goes_on = self.mode.armed() && !self.mode.paused();
        let Some(job) = &mut self.job else { return };
        if job.look_failures >= self.model.tolerances.retries {
            return self.finish(now, JobStatus::Failed, rejection, out);
        }
        job.look_failures += 1;
        job.rejection = Some(rejection.message.clone());
        let again = if goes_on && !job.cancel { "; the arm looks again now" } else { "" };
        say(out, format!("{}{again}", rejection.message));
    }
}

/// Names once what is in the catalogue and not seen.
fn report_absent(job: &mut JobRun, seen: &Observation, out: &mut Vec<Action>) {
    if !std::mem::replace(&mut job.absent_reported, true) && !seen.missing.is_empty() {
        let absent = seen.missing.join(", ");
        alarm(out, format!("not seen: {absent}; the plan is made as if they were not on the table"));
    }
}
