//! One pick-n-place: approach, grip and verify, carry, release, retreat; and what to do when a grip fails.

use crate::device::gripper::{GripperCommand, GripperEvent};
use crate::device::robot_types::RobotCommand;
use crate::geometry::collision::penetration;
use crate::geometry::footprint::Footprint;
use crate::geometry::pose::Pose2;
use crate::motion::pick_n_place::{PickNPlace, plan};
use crate::supervisor::cell::{Cell, Phase, RouteAction, Work, WorkStage, alarm, say};
use crate::supervisor::gates;
use crate::supervisor::input::{Action, JournalEntry, Outside};
use crate::supervisor::model::CellObject;
use crate::supervisor::order::JobEnd;
use crate::time::Timestamp;

impl Cell {
    /// Starts the next pick-n-place of the route, whose first action begins where its object was just seen.
    pub(crate) fn begin_work(&mut self, now: Timestamp, outside: &Outside, out: &mut Vec<Action>) {
        let (Some(job), Some(robot)) = (&self.job, outside.robot) else { return };
        let observed = self.seen.is_some();
        if let Err(closed) = gates::manipulate(self.armed, outside, self.nonce, observed, job.approved) {
            return self.wait(now, closed, out);
        }
        let Some(next) = job.route.as_ref().and_then(|route| route.first()).cloned() else { return };
        let Some(object) = self.model.object(&next.object) else { return };
        let task = PickNPlace {
            from: next.from,
            to: next.to,
            grip_point: object.grip_point,
            grip_yaw: object.grip_yaw,
            height: object.height,
        };
        if let Some(neighbour) = self.body_meets(&next, object) {
            let message = format!("the gripper's body would meet {neighbour} beside {}", next.object);
            let remedy = "move the two apart by hand, or give the job a goal with more room";
            self.finish(now, JobEnd::Failed, &format!("unpickable:{}", next.object), &message, remedy, out);
            return;
        }
        let paths = match plan(&self.model.arm, &robot.q, &task, &self.cycle()) {
            Ok(paths) => paths,
            Err(fault) => {
                let message = format!("{} cannot be moved: {fault}", next.object);
                let remedy = "put the object or its goal nearer to the robot";
                self.finish(now, JobEnd::Failed, "unreachable", &message, remedy, out);
                return;
            }
        };
        let step = job.moves;
        out.push(Action::Journal(JournalEntry::Intent {
            step,
            object: next.object.clone(),
            from: next.from,
            to: next.to,
        }));
        out.push(Action::Robot(RobotCommand::Stream(paths.approach.clone())));
        let work = Work { object: next.object, paths, stage: WorkStage::Approaching };
        self.enter(Phase::Work(Box::new(work)), self.model.tolerances.phase_deadline);
    }

    /// An object so tall that the gripper's body, coming down for the pick or the place, would touch it. The body
    /// counts as a disc about the tool's axis, for the yaw is chosen later.
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
    pub(crate) fn work_path_finished(&mut self, out: &mut Vec<Action>) {
        let Phase::Work(work) = &mut self.phase else { return };
        let channels = self.model.grip.channels;
        match work.stage {
            WorkStage::Approaching => {
                work.stage = WorkStage::Gripping;
                // From here on the table is no longer what was seen.
                self.seen = None;
                let target = self.model.grip.vacuum_target;
                out.push(Action::Gripper(GripperCommand::Grip { channels, target }));
            }
            WorkStage::Carrying => {
                work.stage = WorkStage::Releasing;
                out.push(Action::Gripper(GripperCommand::Release { channels }));
            }
            WorkStage::Retreating => return self.work_done(out),
            WorkStage::Withdrawing => {
                self.phase = Phase::Ready;
                return;
            }
            WorkStage::Gripping | WorkStage::Releasing | WorkStage::GivingUp => {}
        }
        self.remaining = self.model.tolerances.phase_deadline;
    }

    fn work_done(&mut self, out: &mut Vec<Action>) {
        self.phase = Phase::Ready;
        self.seen = None;
        if let Some(job) = &mut self.job {
            out.push(Action::Journal(JournalEntry::Done { step: job.moves }));
            job.moves += 1;
            job.grip_failures = 0;
            if let Some(route) = &mut job.route {
                route.remove(0);
            }
        }
        if self.single_step {
            self.single_step = false;
            self.paused = true;
        }
    }

    /// The gripper reports during a pick-n-place.
    pub(crate) fn work_gripper(&mut self, now: Timestamp, event: GripperEvent, out: &mut Vec<Action>) {
        let Phase::Work(work) = &mut self.phase else { return };
        let step = self.job.as_ref().map_or(0, |job| job.moves);
        match (work.stage, event) {
            (WorkStage::Gripping, GripperEvent::Gripped { .. }) => {
                work.stage = WorkStage::Carrying;
                let carry = work.paths.carry.clone();
                let mass = self.model.object(&work.object).map_or(0.0, |object| object.mass);
                out.push(Action::Journal(JournalEntry::Gripped { step }));
                self.set_payload(mass, out);
                out.push(Action::Robot(RobotCommand::Stream(carry)));
            }
            (WorkStage::Gripping, GripperEvent::GripFailed { vacuum }) => {
                say(out, format!("{} did not seal: vacuum only {:.0} %", work.object, vacuum * 100.0));
                work.stage = WorkStage::GivingUp;
                out.push(Action::Gripper(GripperCommand::Release { channels: self.model.grip.channels }));
            }
            (WorkStage::Releasing, GripperEvent::Released) => {
                work.stage = WorkStage::Retreating;
                let retreat = work.paths.retreat.clone();
                out.push(Action::Journal(JournalEntry::Released { step }));
                self.set_payload(0.0, out);
                out.push(Action::Robot(RobotCommand::Stream(retreat)));
            }
            (WorkStage::GivingUp, GripperEvent::Released) => {
                work.stage = WorkStage::Withdrawing;
                out.push(Action::Robot(RobotCommand::Stream(work.paths.give_up.clone())));
                return self.count_grip_failure(now, out);
            }
            (WorkStage::Carrying, GripperEvent::VacuumLost { vacuum }) => {
                let message = format!("{} was lost: vacuum {:.0} %", work.object, vacuum * 100.0);
                return self.stop_all(now, JobEnd::Failed, "vacuum_lost", &message, out);
            }
            (WorkStage::Carrying, GripperEvent::Unreachable { .. }) => {
                let message = format!("the gripper stopped answering while holding {}", work.object);
                return self.stop_all(now, JobEnd::Interrupted, "gripper_unreachable", &message, out);
            }
            // Readings and repeated answers change nothing; a phase that waits in vain runs into its deadline.
            _ => return,
        }
        self.remaining = self.model.tolerances.phase_deadline;
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
            let remedy = "clean cups and object, check the grip point, submit again";
            self.finish(now, JobEnd::Failed, &format!("unpickable:{object}"), &message, remedy, out);
        }
    }
}
