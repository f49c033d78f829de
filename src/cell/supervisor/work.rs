//! One pick-n-place: approach, grip and verify, carry, release, retreat; and what to do when a grip fails.

use crate::cell::code::{Code, JobStatus};
use crate::cell::device::gripper_types::{GripperCommand, GripperEvent};
use crate::cell::device::robot_types::RobotCommand;
use crate::cell::supervisor::back::Held;
use crate::cell::supervisor::cell::Supervisor;
use crate::cell::supervisor::gates;
use crate::cell::supervisor::input::{Action, DeviceSnapshot, Record};
use crate::cell::supervisor::model::CellObject;
use crate::cell::supervisor::order::RouteAction;
use crate::cell::supervisor::phase::{Phase, Work, WorkStage};
use crate::cell::supervisor::reason::{alarm, say};
use crate::motion::pick_n_place::plan;
use crate::motion::put_down::Grasp;
use cell_values::time::Timestamp;
use rearrange::geometry::collision::penetration;
use rearrange::geometry::footprint::Footprint;
use rearrange::geometry::pose::Pose2;
use rearrange::planning::plan::ActionKind;

impl Supervisor {
    /// Starts the next pick-n-place of the route, whose first action begins where its object was just seen.
    pub(crate) fn begin_pick_n_place(
        &mut self,
        now: Timestamp,
        outside: &DeviceSnapshot,
        out: &mut Vec<Action>,
    ) {
        let (Some(job), Some(robot)) = (&self.job, outside.robot) else { return };
        let observed = self.seen.is_some();
        if let Err(closed) = gates::manipulate(self.mode.armed(), outside, self.nonce, observed, job.approved)
        {
            return self.wait(now, closed, out);
        }
        if self.gave_way(now, out) {
            return;
        }
        let Some(job) = &self.job else { return };
        let Some(next) = job.route.as_ref().and_then(|route| route.first()).cloned() else { return };
        let Some(object) = self.model.object(&next.object) else { return };
        let task = object.pick_n_place(next.from, next.to);
        if let Some(neighbour) = self.body_meets(&next, object) {
            let message = format!("the gripper's body would meet {neighbour} beside {}", next.object);
            let hint = "move the two apart by hand, or give the job a goal with more room";
            let reason = Code::Unpickable.because(message, hint).of(&next.object);
            return self.finish(now, JobStatus::Failed, reason, out);
        }
        let table = self.tabletop(self.seen.as_ref(), &next.object);
        let paths = match plan(&self.model.arm, &robot.q, &task, &self.cycle(), &table) {
            Ok(paths) => paths,
            Err(fault) => {
                let message = format!("{} cannot be moved: {fault}", next.object);
                let reason = Code::Unreachable.because(message, fault.remedy()).of(&next.object);
                return self.finish(now, JobStatus::Failed, reason, out);
            }
        };
        let lying = task.lying_at(next.from);
        let grasp = Grasp::new(&self.model.arm, &paths.carry.start(), &lying, object.hold);
        let record = Record::Intent {
            step: job.moves,
            object: next.object.clone(),
            from: next.from,
            to: next.to,
            kind: if next.to_goal { ActionKind::Goal } else { ActionKind::Buffer },
            tool_from_object: grasp.as_ref().map(|grasp| grasp.load().tool_from_object),
            table: self.back.table.clone(),
        };
        let held = Held {
            object: next.object.clone(),
            grasp,
            height: object.height,
            mass: object.mass,
            hold: object.hold,
            to: next.to,
            let_go: false,
        };
        let number = self.commit(now, record, out);
        let work = Work { object: next.object, held, paths, stage: WorkStage::NotingIntent(number) };
        self.enter(Phase::Work(Box::new(work)), self.model.tolerances.phase_deadline);
    }

    /// The record with this number is on disk: what waited for it goes on.
    pub(crate) fn work_noted(
        &mut self,
        now: Timestamp,
        outside: &DeviceSnapshot,
        number: u64,
        out: &mut Vec<Action>,
    ) {
        let Phase::Work(work) = &mut self.phase else { return };
        match work.stage {
            WorkStage::NotingIntent(awaited) if awaited == number => {
                return self.begin_approach(now, outside, out);
            }
            WorkStage::NotingGrip(awaited) if awaited == number => {
                work.stage = WorkStage::Carrying;
                out.push(Action::Robot(RobotCommand::Stream(work.paths.carry.clone())));
            }
            WorkStage::NotingRelease(awaited) if awaited == number => {
                work.stage = WorkStage::Retreating;
                out.push(Action::Robot(RobotCommand::Stream(work.paths.retreat.clone())));
            }
            WorkStage::NotingDone(awaited) if awaited == number => {
                self.phase = Phase::Ready;
                self.mode.step_over();
                return;
            }
            WorkStage::NotingIntent(_)
            | WorkStage::Approaching
            | WorkStage::Gripping
            | WorkStage::NotingGrip(_)
            | WorkStage::Carrying
            | WorkStage::Releasing
            | WorkStage::NotingRelease(_)
            | WorkStage::Retreating
            | WorkStage::NotingDone(_)
            | WorkStage::GivingUp
            | WorkStage::Withdrawing => return,
        }
        self.remaining = self.model.tolerances.phase_deadline;
    }

    /// The intent is on disk. Writing it took time: every gate is looked at again before the arm moves.
    fn begin_approach(&mut self, now: Timestamp, outside: &DeviceSnapshot, out: &mut Vec<Action>) {
        let approved = self.job.as_ref().is_some_and(|job| job.approved);
        let (armed, observed) = (self.mode.armed(), self.seen.is_some());
        if let Err(closed) = gates::manipulate(armed, outside, self.nonce, observed, approved) {
            self.phase = Phase::Ready;
            return self.wait(now, closed, out);
        }
        let Phase::Work(work) = &mut self.phase else { return };
        work.stage = WorkStage::Approaching;
        out.push(Action::Robot(RobotCommand::Stream(work.paths.approach.clone())));
        self.remaining = self.model.tolerances.phase_deadline;
    }

    /// An object so tall that the gripper's body, coming down for the pick or the place, would touch it. The
    /// body counts as a disc about the tool's axis, for the yaw is chosen later.
    fn body_meets(&self, next: &RouteAction, object: &CellObject) -> Option<String> {
        let seen = self.seen.as_ref()?;
        let body = self.model.grip.body_radius;
        let underside = object.height - self.model.cycle.press + self.model.grip.body_above_lips;
        let places = [next.from, next.to].map(|pose| pose.transform(object.grip_point));
        if let Some(foreign) = self.meets_foreign(&places, body, underside) {
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
            WorkStage::Approaching => {
                work.stage = WorkStage::Gripping;
                // From here on the table is no longer what was seen.
                self.seen = None;
                self.back.held = Some(work.held.clone());
                let target = self.model.grip.vacuum_target;
                out.push(Action::Gripper(GripperCommand::Grip { channels, target }));
            }
            WorkStage::Carrying => {
                work.stage = WorkStage::Releasing;
                out.push(Action::Gripper(GripperCommand::Release { channels }));
            }
            WorkStage::Retreating => self.note_done(now, out),
            WorkStage::Withdrawing => {
                self.phase = Phase::Ready;
                return;
            }
            WorkStage::NotingIntent(_)
            | WorkStage::Gripping
            | WorkStage::NotingGrip(_)
            | WorkStage::Releasing
            | WorkStage::NotingRelease(_)
            | WorkStage::NotingDone(_)
            | WorkStage::GivingUp => {}
        }
        self.remaining = self.model.tolerances.phase_deadline;
    }

    /// The arm has left the placed object.
    fn note_done(&mut self, now: Timestamp, out: &mut Vec<Action>) {
        self.seen = None;
        let Some(job) = &mut self.job else {
            self.phase = Phase::Ready;
            return;
        };
        let step = job.moves;
        job.moves += 1;
        job.grip_failures = 0;
        if let Some(route) = job.route.as_mut().filter(|route| !route.is_empty()) {
            route.remove(0);
        }
        let number = self.commit(now, Record::Done { step }, out);
        if let Phase::Work(work) = &mut self.phase {
            work.stage = WorkStage::NotingDone(number);
        }
    }

    /// The gripper reports during a pick-n-place.
    pub(crate) fn work_gripper(&mut self, now: Timestamp, event: GripperEvent, out: &mut Vec<Action>) {
        let Phase::Work(work) = &mut self.phase else { return };
        let step = self.job.as_ref().map_or(0, |job| job.moves);
        match (work.stage, event) {
            (WorkStage::Gripping, GripperEvent::Gripped { .. }) => {
                let mass = self.model.object(&work.object).map_or(0.0, |object| object.mass);
                let number = self.commit(now, Record::Gripped { step }, out);
                self.set_payload(mass, out);
                self.set_stage(WorkStage::NotingGrip(number));
            }
            (WorkStage::Gripping, GripperEvent::GripFailed { vacuum }) => {
                say(out, format!("{} did not seal: vacuum only {:.0} %", work.object, vacuum * 100.0));
                work.stage = WorkStage::GivingUp;
                out.push(Action::Gripper(GripperCommand::Release { channels: self.model.grip.channels }));
            }
            (WorkStage::Releasing, GripperEvent::Released) => {
                let number = self.commit(now, Record::Released { step }, out);
                self.set_payload(0.0, out);
                self.set_stage(WorkStage::NotingRelease(number));
            }
            (WorkStage::GivingUp, GripperEvent::Released) => {
                work.stage = WorkStage::Withdrawing;
                out.push(Action::Robot(RobotCommand::Stream(work.paths.give_up.clone())));
                return self.count_grip_failure(now, out);
            }
            (WorkStage::NotingGrip(_) | WorkStage::Carrying, GripperEvent::VacuumLost { vacuum }) => {
                let message = format!("{} was lost: vacuum {:.0} %", work.object, vacuum * 100.0);
                let hint = "see where it lies, or whether it still hangs: `celld recover` says what the \
                            gripper reads";
                let reason = Code::VacuumLost.because(message, hint).of(&work.object);
                return self.stop_all(now, JobStatus::Failed, reason, out);
            }
            // Readings and repeated answers change nothing; a phase that waits in vain runs into its
            // deadline.
            _ => return,
        }
        self.remaining = self.model.tolerances.phase_deadline;
    }

    /// True while an object is gripped, held or let go.
    pub(crate) fn gripper_needed(&self) -> bool {
        let Phase::Work(work) = &self.phase else { return false };
        match work.stage {
            WorkStage::Gripping
            | WorkStage::NotingGrip(_)
            | WorkStage::Carrying
            | WorkStage::Releasing
            | WorkStage::GivingUp => true,
            WorkStage::NotingIntent(_)
            | WorkStage::Approaching
            | WorkStage::NotingRelease(_)
            | WorkStage::Retreating
            | WorkStage::NotingDone(_)
            | WorkStage::Withdrawing => false,
        }
    }

    /// Whether the object is held is unknown from here on: the arm stops where it is.
    pub(crate) fn on_gripper_silent(&mut self, now: Timestamp, out: &mut Vec<Action>) {
        let Phase::Work(work) = &self.phase else { return };
        let during = match work.stage {
            WorkStage::Gripping => "while gripping",
            WorkStage::Releasing | WorkStage::GivingUp => "while letting go of",
            WorkStage::NotingIntent(_)
            | WorkStage::Approaching
            | WorkStage::NotingGrip(_)
            | WorkStage::Carrying
            | WorkStage::NotingRelease(_)
            | WorkStage::Retreating
            | WorkStage::NotingDone(_)
            | WorkStage::Withdrawing => "while holding",
        };
        let message = format!("the gripper stopped answering {during} {}", work.object);
        let hint = "see that the Compute Box is on and in the network, and keep clear of what may fall; \
                    `celld recover` shows what is held and the ways back";
        let reason = Code::GripperUnreachable.because(message, hint).of(&work.object);
        self.stop_all(now, JobStatus::Interrupted, reason, out);
    }

    fn set_stage(&mut self, stage: WorkStage) {
        if let Phase::Work(work) = &mut self.phase {
            work.stage = stage;
        }
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
