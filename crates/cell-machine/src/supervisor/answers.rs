//! What an accepted order is answered: what has happened, and what the arm does next.
//!
//! In: an order that was carried out, and the state that it led to. Out: [`Reply`]. An order that changes
//! nothing says so.

use crate::orders::{Approval, Order, Reply, WayBack};
use crate::supervisor::cell::Supervisor;
use crate::supervisor::gates::motion_speed;
use crate::supervisor::input::DeviceSnapshot;
use crate::supervisor::phase::{BringUp, JobRun, Phase};

/// The arm is at its park pose within this joint angle, rad.
const PARKED_RAD: f64 = 0.002;

impl Supervisor {
    /// What has become of an order that was taken; `None` where the answer comes later.
    pub(crate) fn answer(&self, devices: &DeviceSnapshot, order: &Order) -> Option<Reply> {
        Some(match order {
            Order::Arm => Reply::accept(self.armed_and_now()),
            Order::Disarm => Reply::accept(self.disarmed_and_now(devices)),
            Order::Approve { .. } if !self.mode.armed() => {
                Reply::accept("approved; nothing moves before `celld arm`")
            }
            Order::Approve { .. } => Reply::accept(self.approved_and_now()),
            Order::Reject(_) => Reply::accept("rejected; the job has ended"),
            Order::Cancel(_) => Reply::accept(self.cancelling()),
            Order::Pause => Reply::accept(self.pausing()),
            Order::Resume => Reply::accept(match self.mode.armed() {
                true => "goes on",
                false => "the pause is over; the cell is disarmed, `celld arm` lets it move",
            }),
            Order::Step if matches!(self.phase, Phase::Approve) => {
                Reply::accept("one pick-n-place once the plan is approved, then a pause")
            }
            Order::Step => Reply::accept(match &self.job {
                Some(_) if matches!(self.phase, Phase::Work(_)) => {
                    "the pick-n-place under way is this step; then a pause"
                }
                Some(job) if self.only_looks(job) => {
                    "a last look at the table, and one pick-n-place where more is to be done; then a pause"
                }
                Some(_) => "one pick-n-place, then a pause",
                None => "no job is under way; the next one pauses after one pick-n-place",
            }),
            Order::Park => self.then_the_job(self.answer_park(devices)),
            Order::Recover(WayBack::Show | WayBack::Release)
            | Order::Abort
            | Order::Release(_)
            | Order::ConfirmGripper => return None,
            Order::Recover(way) => return Some(self.recovering(devices, *way)),
            Order::Calibrate => Reply::accept(self.calibrating()),
        })
    }

    /// Nothing of the plan is left but the look that ends the job.
    fn only_looks(&self, job: &JobRun) -> bool {
        let all_made = job.moves > 0 && job.route.as_ref().is_some_and(Vec::is_empty);
        all_made && !job.cancel && matches!(self.phase, Phase::Ready | Phase::Look(_))
    }

    /// That the cell is armed, and what the arm does next.
    fn armed_and_now(&self) -> String {
        if let (Phase::Ready, Some(closed)) = (&self.phase, &self.waiting_for) {
            return format!("armed; nothing moves yet: {}", self.place(closed));
        }
        let now = match &self.phase {
            Phase::Park => "armed: the arm goes on to its park pose",
            Phase::Work(_) => "armed: the pick-n-place under way goes on",
            Phase::Approve => "armed; the plan waits for `celld approve`",
            Phase::BringUp(BringUp { requested: Some(_), .. }) => {
                let now = "armed: celld switches the arm's power on and releases its brakes now";
                return format!("{now}{}", self.once_it_runs());
            }
            Phase::BringUp(_) => {
                let now = "armed: celld starts its program on the robot now";
                return format!("{now}{}", self.once_it_runs());
            }
            Phase::Look(_) if self.mode.paused() => {
                "armed: the arm goes round its look poses, then a pause is in force, `celld resume` ends it"
            }
            _ if self.mode.paused() => "armed; a pause is in force, `celld resume` ends it",
            Phase::Look(_) => {
                return format!("armed: the arm moves to look at the table now{}", self.after_the_look());
            }
            Phase::Ready | Phase::Plan | Phase::Recover(_) | Phase::Visit(_) => {
                match self.round.is_some() || self.job.is_some() {
                    true => "armed: the job goes on now",
                    // One may be on its way already.
                    false => "armed: the arm moves as soon as there is a job",
                }
            }
        };
        now.to_string()
    }

    /// What the arm does once the robot runs celld's program.
    fn once_it_runs(&self) -> String {
        match (self.job.is_some(), self.mode.paused()) {
            (_, true) => "; then a pause is in force, `celld resume` ends it".to_string(),
            (true, false) => format!(", then the arm moves to look at the table{}", self.after_the_look()),
            (false, false) => ", then the arm moves as soon as there is a job".to_string(),
        }
    }

    /// What the arm does once the table was looked at.
    pub(crate) fn after_the_look(&self) -> &'static str {
        let Some(job) =
            self.job.as_ref().filter(|job| job.order.rule.is_some() || !job.order.goals.is_empty())
        else {
            return "";
        };
        match (job.order.approval, self.plan_is_agreed_to()) {
            (Approval::Never, _) => ", then it carries out what is planned: no approval is needed",
            (Approval::Job, true) => ", then it carries out what is planned: the job is approved",
            (Approval::Always, true) => {
                ", then it carries out the approved plan; one in which a move differs waits for approval"
            }
            (Approval::Job | Approval::Always, false) => "; the plan then waits for approval",
        }
    }

    /// A person has agreed to what the job does next.
    pub(crate) fn plan_is_agreed_to(&self) -> bool {
        self.job.as_ref().is_some_and(|job| job.approved || !job.order.agreed.is_empty())
    }

    /// That the cell is disarmed, and what the arm still does.
    fn disarmed_and_now(&self, devices: &DeviceSnapshot) -> &'static str {
        if !devices.robot_fresh {
            return "disarmed; the robot does not answer, so nothing is known of the arm: keep away from it";
        }
        match &self.phase {
            Phase::Work(work) if work.then.is_none() => {
                "disarmed; the pick-n-place under way is finished first, `celld abort` stops it now"
            }
            Phase::Ready
            | Phase::BringUp(_)
            | Phase::Look(_)
            | Phase::Plan
            | Phase::Approve
            | Phase::Park
            | Phase::Work(_)
            | Phase::Recover(_)
            | Phase::Visit(_) => match self.follows_a_path() {
                true => "disarmed; the motion under way goes on to its next stop, `celld abort` stops it now",
                false => "disarmed",
            },
        }
    }

    /// That a plan is approved, and what the arm does next.
    fn approved_and_now(&self) -> String {
        match (&self.phase, &self.waiting_for) {
            (Phase::Ready, Some(closed)) => format!("approved; nothing moves yet: {}", self.place(closed)),
            _ if self.mode.paused() => "approved; a pause is in force, `celld resume` ends it".to_string(),
            _ if self.mode.pauses_after_this_move() => {
                "approved: the arm makes one pick-n-place now; then a pause".to_string()
            }
            (Phase::Look(_), _) => {
                "approved: the arm looks at the table now, then carries the plan out".to_string()
            }
            (
                Phase::Ready
                | Phase::BringUp(_)
                | Phase::Plan
                | Phase::Approve
                | Phase::Work(_)
                | Phase::Park
                | Phase::Recover(_)
                | Phase::Visit(_),
                _,
            ) => "approved: the arm carries the plan out now".to_string(),
        }
    }

    /// The arm is at rest at its park pose.
    pub(crate) fn is_parked(&self, devices: &DeviceSnapshot) -> bool {
        let fresh = devices.robot.filter(|_| devices.robot_fresh);
        fresh.is_some_and(|robot| {
            robot.q.max_difference(&self.model.park) < PARKED_RAD && robot.stands_still()
        })
    }

    /// Parking keeps no job back: who wants the arm to stay there needs to know.
    fn then_the_job(&self, reply: Reply) -> Reply {
        let goes_on = reply.accepted && self.job.is_some() && !self.mode.paused();
        let after = if goes_on {
            "; then the job goes on: to keep the arm there, `celld pause`, then `celld park`"
        } else {
            ""
        };
        Reply { message: format!("{}{after}", reply.message), ..reply }
    }

    fn answer_park(&self, devices: &DeviceSnapshot) -> Reply {
        if self.moving() && motion_speed(devices) == 0.0 {
            return Reply::accept("parks as soon as the present motion is over, which is held now");
        }
        match (&self.phase, &self.waiting_for) {
            (Phase::BringUp(_), _) => Reply::accept("parks as soon as the robot is started"),
            (Phase::Park, _) => Reply::accept("parks now"),
            (Phase::Plan, _) => Reply::accept("parks as soon as the planning is over"),
            (Phase::Approve, _) => Reply::accept("parks as soon as the plan is approved or rejected"),
            (Phase::Ready, Some(reason)) => Reply::accept(format!("parks as soon as it may move: {reason}")),
            (Phase::Ready, None) if !self.mode.parks() => {
                Reply::refuse("not parked: the park pose cannot be reached from here")
            }
            (Phase::Ready, None)
            | (Phase::Look(_) | Phase::Work(_) | Phase::Visit(_) | Phase::Recover(_), _) => {
                Reply::accept("parks as soon as the present motion is over")
            }
        }
    }

    /// When a job that is cancelled ends.
    fn cancelling(&self) -> &'static str {
        if self.job.is_none() {
            return "cancelled";
        }
        match &self.phase {
            Phase::BringUp(_) => "the job ends once the robot has started: power and brakes still come on",
            Phase::Park => "the job ends once the arm is at its park pose",
            Phase::Ready
            | Phase::Look(_)
            | Phase::Plan
            | Phase::Approve
            | Phase::Work(_)
            | Phase::Visit(_)
            | Phase::Recover(_) => "cancelled after the present pick-n-place or look",
        }
    }

    /// What is still done before a pause.
    fn pausing(&self) -> &'static str {
        match &self.phase {
            Phase::Work(work) if work.then.is_some() => {
                "the arm goes on to where it looks from, then it rests; `celld abort` stops it now"
            }
            Phase::Work(_) => "pauses after the present pick-n-place",
            Phase::Park => "the arm goes on to its park pose, then it rests",
            Phase::Look(_) if self.has_set_out() => {
                "the arm goes on to over the next object, then it rests; `celld abort` stops it now"
            }
            Phase::Look(look) if look.void => {
                "the arm goes on to the end of its way, then it rests; `celld abort` stops it now"
            }
            Phase::Look(_) if self.job.is_some() => {
                "the arm goes round its look poses, then it rests; `celld abort` stops it now"
            }
            Phase::BringUp(_) => "power, brakes and program still come on, then the arm rests",
            Phase::Ready
            | Phase::Look(_)
            | Phase::Plan
            | Phase::Approve
            | Phase::Recover(_)
            | Phase::Visit(_) => match &self.job {
                Some(_) => "pauses before the next pick-n-place",
                None => "paused; no job is under way",
            },
        }
    }
}
