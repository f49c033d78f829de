//! What hangs on the gripper, or may: followed from the grip until a picture shows the object on the table.
//!
//! In: the gripper's reports, looks, orders. Out: what is held, for gates, paths and people. A vacuum that
//! has gone proves nothing: an object may stick to the cups, and one that was lost may hang by an edge. So
//! what was let go counts as possibly hanging until it is seen, and what was lost until a person says that
//! it is gone.

use crate::code::{Code, JobStatus};
use crate::device::gripper_types::GripperEvent;
use crate::supervisor::back::{BackStage, Held};
use crate::supervisor::cell::Supervisor;
use crate::supervisor::gates::{self, GateClosed};
use crate::supervisor::input::{Action, DeviceSnapshot, Record};
use crate::supervisor::phase::{Phase, WorkStage};
use crate::supervisor::reason::alarm;
use cell_motion::bodies::Load;
use cell_motion::put_down::Grasp;
use cell_values::time::{Duration, Timestamp};
use cell_vision::foreign::HeldBody;
use cell_vision::observe::Observation;
use rearrange::geometry::pose::Pose2;

/// What hangs on the tool, in its frame: the pose is as seen from above, and the tool looks down, so its
/// y axis is the other way round.
pub(crate) fn outline_in_tool(load: &Load) -> Vec<[f64; 2]> {
    let corner = |at: &[f64; 2]| load.tool_from_object.transform(*at);
    load.footprint.outline(HELD_CORNERS).iter().map(corner).map(|[x, y]| [x, -y]).collect()
}

/// What became of what a person's release let go.
const TAKEN_OFF: &str = "it was taken off by a person's order";

/// Corners of a curve, and of what may be anything.
const HELD_CORNERS: usize = 32;

/// A gripper that shows no vacuum for so long after a start holds nothing.
const EMPTY_FOR: Duration = Duration::from_secs(1);

impl Supervisor {
    /// What hangs on the gripper on a way back, as the camera beside it sees it. What was let go is no part
    /// of this: whether it hangs there all the same is what the picture has to show.
    pub(crate) fn held_in_sight(&self) -> Option<HeldBody> {
        self.back.recovery.as_ref()?;
        let below_m = self.held_depth();
        let grasp = match self.back.held.as_ref().filter(|held| !held.let_go) {
            Some(held) => held.grasp.as_ref(),
            None if self.back.grips => None,
            None => return None,
        };
        let outline = match grasp.map(|grasp| grasp.load()) {
            // Seen from above; the tool looks down, its y axis is the other way round.
            Some(load) => outline_in_tool(load),
            // It may be any object, gripped anywhere.
            None => {
                let radii = self.model.objects.iter().map(|object| object.footprint.bounding_radius());
                let reach = 2.0 * radii.fold(0.0, f64::max);
                let corner = |k: usize| (std::f64::consts::TAU * k as f64 / HELD_CORNERS as f64).sin_cos();
                (0..HELD_CORNERS).map(corner).map(|(sin, cos)| [reach * cos, reach * sin]).collect()
            }
        };
        Some(HeldBody { outline, below_m })
    }

    /// Follows what is held by what the gripper reports.
    pub(crate) fn note_vacuum(
        &mut self,
        devices: &DeviceSnapshot,
        event: &GripperEvent,
        out: &mut Vec<Action>,
    ) {
        let works = matches!(self.phase, Phase::Work(_));
        if let Some(held) = &mut self.back.held {
            held.unsealed &= !devices.gripper_holds;
        }
        match event {
            GripperEvent::Gripped { .. } => self.back.fell = None,
            // At its place it may stick to the cups; where a person has it, or where nothing was gripped,
            // not.
            GripperEvent::Released => match (&self.phase, &mut self.back.held) {
                (Phase::Work(work), Some(held)) if work.stage == WorkStage::Releasing => held.let_go = true,
                (Phase::Recover(BackStage::Leaving), Some(held)) => {
                    held.let_go = true;
                    let how = self.where_it_is_put(devices);
                    self.note_let_go(how, out);
                }
                // One channel may have been let go, and the other hold on.
                (_, held) if gates::empty_handed(devices).is_ok() => {
                    let gone = held.take().filter(|_| !works);
                    let fell = self.back.fell.take();
                    if let Some(held) = gone {
                        let fell = fell.as_deref().and_then(|fell| fell.strip_prefix(&held.object));
                        let how = fell.map_or_else(|| TAKEN_OFF.to_string(), |fell| format!("it{fell}"));
                        self.note_let_go(how, out);
                    }
                }
                _ => {}
            },
            GripperEvent::VacuumWeak { vacuum, best } => self.vacuum_falls(works, [*best, *vacuum], out),
            GripperEvent::VacuumLost { .. } => {
                let what =
                    self.back.held.as_ref().map_or("what the gripper held", |held| held.object.as_str());
                let fell = format!("{what} fell{}", self.fell_where(devices));
                if !works {
                    alarm(out, format!("{fell}: see where it lies, or whether it still hangs on the cups"));
                }
                self.back.fell = Some(fell);
            }
            // A gripper that does not answer shows nothing about the grip.
            GripperEvent::GripFailed { .. } => {
                if let Some(held) = &mut self.back.held {
                    held.unsealed = devices.gripper_answers && !devices.gripper_holds;
                }
            }
            GripperEvent::ReleaseFailed { .. }
            | GripperEvent::Unreachable { .. }
            | GripperEvent::Answering
            | GripperEvent::Refused
            | GripperEvent::Reading { .. } => {}
        }
    }

    /// Where the tool is as something falls, for people.
    fn fell_where(&self, devices: &DeviceSnapshot) -> String {
        devices.robot.map_or_else(String::new, |robot| {
            let at = self.model.arm.tool_at(&robot.q).translation.vector;
            let height = (at.z - self.held_height()) * 1e3;
            format!(" near x {:.3} m, y {:.3} m, from {height:.0} mm over the table", at.x, at.y)
        })
    }

    /// After a start: what an earlier celld had gripped hangs there if the vacuum holds it. Less vacuum
    /// proves nothing: a gripper that has lost its object goes on pumping through open cups. None at all has
    /// to last: a gripper whose power was cut reads none for a moment. How it hangs was written down before
    /// it was picked.
    pub(crate) fn name_what_hangs(&mut self, devices: &DeviceSnapshot, out: &mut Vec<Action>) {
        if devices.vacuum.is_none() || !devices.gripper_answers {
            self.back.empty_since = None;
            return;
        }
        if self.model.held_before.is_some() && !self.back.grips {
            let now = self.clock();
            if now.since(*self.back.empty_since.get_or_insert(now)) < EMPTY_FOR {
                return;
            }
        }
        let Some(before) = self.model.held_before.take() else { return };
        if !self.back.grips {
            // What hangs there at a later start is another thing.
            return self.note_let_go("it had gone when celld started".to_string(), out);
        }
        if self.back.table.is_empty() {
            self.back.table.clone_from(&before.table);
        }
        let Some(object) = self.model.object(&before.object) else { return };
        let held = Held {
            object: before.object,
            grasp: before.tool_from_object.map(|tool_from_object| {
                let (name, footprint) = (object.id.clone(), object.footprint.clone());
                let load = Load { name, footprint, tool_from_object, height: object.height };
                Grasp::remembered(load, object.hold)
            }),
            height: object.height,
            mass: object.mass,
            hold: object.hold,
            to: before.to,
            let_go: false,
            unsealed: false,
        };
        let what = &held.object;
        let gripped = format!("{what} was gripped when celld last ended");
        if devices.gripper_holds {
            alarm(out, format!("{gripped}: it hangs on the cups; `celld recover`"));
        } else {
            alarm(
                out,
                format!(
                    "{gripped} and may have fallen, the vacuum is too low to hold it: look for it on the \
                     table and on the cups, then `celld recover`"
                ),
            );
            self.back.fell = Some(format!("{what} may have fallen before celld started"));
        }
        self.back.held = Some(held);
    }

    /// What is gripped is not any more where it was seen last.
    pub(crate) fn note_moved(&mut self, object: &str) {
        let seen = self.job.iter_mut().flat_map(|job| &mut job.last_seen);
        seen.filter(|seen| seen.id == object).for_each(|seen| seen.moved = true);
    }

    /// Writes down that what was gripped last is gone from the cups; nothing waits for it.
    fn note_let_go(&mut self, how: String, out: &mut Vec<Action>) {
        self.commit(self.clock(), Record::LetGo { how }, out);
    }

    /// Where a way back puts down what is held, from where the arm is.
    fn where_it_is_put(&self, devices: &DeviceSnapshot) -> String {
        let grasp = self.back.held.as_ref().and_then(|held| held.grasp.as_ref());
        let at =
            grasp.zip(devices.robot).and_then(|(grasp, robot)| grasp.object_at(&self.model.arm, &robot.q));
        match at {
            Some(Pose2 { x, y, .. }) => format!("a way back put it down at x {x:.3} m, y {y:.3} m"),
            None => "a way back put it down".to_string(),
        }
    }

    /// What is held may be lost soon. A pick-n-place under way is finished, which is sooner over than
    /// anything else; nothing is picked after it before a person has looked at cups and hoses.
    fn vacuum_falls(&mut self, works: bool, [best, now]: [f64; 2], out: &mut Vec<Action>) {
        let what = self.back.held.as_ref().map_or("something unknown", |held| held.object.as_str());
        let fell = format!(
            "the vacuum fell from {:.0} to {:.0} % with {what} on the cups",
            100.0 * best,
            100.0 * now
        );
        let then = if works { "it is put down, and nothing is picked after it" } else { "it may fall" };
        alarm(out, format!("{fell}: {then}"));
        self.back.weak = works.then_some(fell);
    }

    /// Ends the job where the vacuum fell at the last pick; true if it does.
    pub(crate) fn gave_way(&mut self, now: Timestamp, out: &mut Vec<Action>) -> bool {
        let Some(fell) = self.back.weak.take() else { return false };
        let hint = "clean the cups and the tops of the objects, look for leaks in hoses and bellows, then \
                    `celld arm` and submit again";
        self.mode.disarm();
        alarm(out, format!("disarmed: {fell}; {hint}"));
        self.finish(now, JobStatus::Failed, Code::VacuumWeak.because(fell, hint), out);
        true
    }

    /// What was let go is not among what is seen.
    pub(crate) fn let_go_unseen(&self, seen: &Observation) -> bool {
        let held = self.back.held.as_ref().filter(|held| held.let_go);
        held.is_some_and(|held| seen.objects.iter().all(|object| object.id != held.object))
    }

    /// What was let go and is not on the table hangs on the cups: the job ends by its name. True if it does.
    pub(crate) fn sticks(&mut self, now: Timestamp, seen: &Observation, out: &mut Vec<Action>) -> bool {
        let Some(held) = self.back.held.as_mut().filter(|held| held.let_go) else { return false };
        if seen.objects.iter().any(|object| object.id == held.object) {
            self.back.held = None;
            return false;
        }
        held.let_go = false;
        let object = held.object.clone();
        let message = format!("{object} was let go and is not seen on the table: it may hang on the cups");
        let hint = "take it off the cups by hand, `celld release --yes`, then `celld arm` and submit again";
        self.mode.disarm();
        alarm(out, format!("disarmed: {message}; {hint}"));
        self.finish(now, JobStatus::Failed, Code::ObjectStuck.because(message, hint).of(object), out);
        true
    }

    /// Arming needs that nothing may hang on the gripper, besides what was just put down and is looked at
    /// first.
    pub(crate) fn may_arm(&self, devices: &DeviceSnapshot) -> Result<(), GateClosed> {
        self.orders_reach()?;
        gates::arming(devices)?;
        gates::confirmed(&self.model.confirmed, devices.gripper_identity.as_ref())?;
        if let Some(before) = &self.model.held_before {
            return Err(GateClosed::MayHang(before.object.clone()));
        }
        match &self.back.held {
            Some(held) if !held.let_go => Err(GateClosed::MayHang(held.object.clone())),
            None if self.back.fell.is_some() => Err(GateClosed::MayHang("what the gripper held".to_string())),
            Some(_) | None => Ok(()),
        }
    }

    /// The object that hangs on the gripper, as far as is known, and how, unless the tool did not point
    /// straight down when it was gripped.
    pub fn object_on_the_gripper(&self) -> Option<(&str, Option<&Grasp>)> {
        let hangs = |held: &&Held| !held.let_go && !held.unsealed && self.back.fell.is_none();
        let held = self.back.held.as_ref().filter(hangs)?;
        Some((&held.object, held.grasp.as_ref()))
    }

    /// What hangs on the gripper, may hang or fell, in a few words; `None` where it is empty.
    pub(crate) fn holding_words(&self) -> Option<String> {
        match &self.back.held {
            Some(held) if held.let_go => None,
            Some(held) if self.back.fell.is_some() => Some(format!(
                "{}, or hangs on the cups",
                self.back.fell.clone().unwrap_or(held.object.clone())
            )),
            Some(held) if held.unsealed => {
                Some(format!("{} may hang on the cups: the grip did not seal", held.object))
            }
            Some(held) => Some(format!("holds {}", held.object)),
            // The gripper has not answered since the start.
            None => match &self.model.held_before {
                Some(before) => Some(format!("{} may hang on the cups", before.object)),
                None => self.back.fell.clone(),
            },
        }
    }
}
