//! Orders that wait for the arm to come to rest: an abort is answered then, a release goes out then.
//!
//! In: the orders, the robot's state after a stop. Out: answers that say what is so, and the release. A
//! person who reads "stopped" reaches into the cell, and one who releases holds the object: neither may
//! happen while the arm still brakes. Where it is not known to be at rest within [`STANDS_WITHIN`], the
//! answer says that.

use crate::device::robot_types::RobotState;
use crate::orders::Reply;
use crate::supervisor::cell::Supervisor;
use crate::supervisor::gates::{self, GateClosed};
use crate::supervisor::input::{Action, DeviceSnapshot};
use crate::supervisor::phase::{Then, UntilItStands};
use cell_values::time::{Duration, Timestamp};
use ur_wire::enumerations::RuntimeState;

/// Longer than a stop by opcode and one by dashboard after it.
const STANDS_WITHIN: Duration = Duration::from_millis(5500);

impl Supervisor {
    /// The order with this number waits for the arm to come to rest.
    pub(crate) fn answer_when_it_stands(&mut self, now: Timestamp, number: u64, then: Then) {
        self.until_it_stands.push(UntilItStands { number, since: now, then });
    }

    /// Carries out and answers what waited, as soon as the arm is at rest or is not known to be so in time.
    /// What is known of the robot is from before `order`, which is judged by what comes after it.
    pub(crate) fn watch_standing(
        &mut self,
        now: Timestamp,
        devices: &DeviceSnapshot,
        order: Option<u64>,
        out: &mut Vec<Action>,
    ) {
        let fresh = devices.robot.filter(|_| devices.robot_fresh);
        let stands = self.arm_stands(devices);
        self.stands |= stands && order.is_none();
        self.arm_settled = devices.arm_settled;
        self.back.grips = matches!(gates::empty_handed(devices), Err(GateClosed::Holding));
        self.name_what_hangs(devices, out);
        for waits in std::mem::take(&mut self.until_it_stands) {
            let late = now.since(waits.since) >= STANDS_WITHIN;
            if (!stands && !late) || order == Some(waits.number) {
                self.until_it_stands.push(waits);
                continue;
            }
            match waits.then {
                // Of a robot that is silent nothing is known, and its program has been without a heartbeat
                // for long enough to have stopped: a person must be able to take the object.
                Then::Release(channels) if stands || fresh.is_none() => {
                    self.release(waits.number, channels, out);
                }
                Then::Release(_) => out.push(Action::Reply {
                    number: waits.number,
                    reply: Reply::refuse(
                        "not released: the arm has not come to rest, or its program could not be ended: \
                         press the emergency stop, then try again",
                    ),
                }),
                Then::Say => {
                    let reply = stopped(stands, fresh, devices.arm_settled);
                    out.push(Action::Reply { number: waits.number, reply });
                }
            }
        }
    }

    /// The arm has come to rest, and nothing that celld has ordered moves it on: a stop has been confirmed,
    /// or no program is there any more.
    pub(crate) fn arm_stands(&self, devices: &DeviceSnapshot) -> bool {
        let fresh = devices.robot.filter(|_| devices.robot_fresh);
        fresh.is_some_and(|robot| {
            robot.stands_still()
                && devices.arm_settled
                && (self.stands || robot.runtime_state == RuntimeState::Stopped)
        })
    }

    /// A stop was ordered and is not confirmed.
    pub(crate) fn stopping(&self, devices: &DeviceSnapshot) -> bool {
        !self.until_it_stands.is_empty() || !self.stands || !devices.arm_settled
    }

    /// Refuses every pending release: the person who ordered it may no longer be holding the object.
    pub(crate) fn refuse_releases(&mut self, out: &mut Vec<Action>) {
        let releases = |waits: &mut UntilItStands| matches!(waits.then, Then::Release(_));
        for waits in self.until_it_stands.extract_if(.., releases) {
            let reply = Reply::refuse(
                "not released: celld was held up while the arm was stopping; make sure that someone holds \
                 the object, then try again",
            );
            out.push(Action::Reply { number: waits.number, reply });
        }
    }

    /// The daemon ends: who still waits for an answer gets what is known.
    pub(crate) fn answer_at_the_end(&mut self, devices: &DeviceSnapshot, out: &mut Vec<Action>) {
        let stands = self.arm_stands(devices);
        let fresh = devices.robot.filter(|_| devices.robot_fresh);
        for waits in std::mem::take(&mut self.until_it_stands) {
            let reply = match waits.then {
                Then::Say => stopped(stands, fresh, devices.arm_settled),
                Then::Release(_) => Reply::refuse("not released: celld ends"),
            };
            out.push(Action::Reply { number: waits.number, reply });
        }
        for (number, _) in std::mem::take(&mut self.release_orders) {
            let reply = Reply::refuse("celld ends before the gripper has confirmed the release: look at it");
            out.push(Action::Reply { number, reply });
        }
    }
}

/// The answer to an abort; `robot` is its state, if that is fresh, `settled` whether power and brakes are as
/// they stay.
fn stopped(stands: bool, robot: Option<&RobotState>, settled: bool) -> Reply {
    let but = match robot {
        _ if stands => return Reply::accept("stopped and disarmed"),
        Some(_) if !settled => {
            "disarmed, but power and brakes were ordered before and may still come on: keep away from the \
             arm until the pendant shows that it is off"
        }
        Some(robot) if robot.stands_still() => {
            "disarmed, and the arm is at rest, but its program could not be ended: press the emergency stop \
             before you go near the arm"
        }
        Some(_) => "disarmed, but the arm has not come to rest: keep away from it, use the emergency stop",
        None => {
            "disarmed; the robot does not answer, and whether the arm is at rest is not known: use the \
             emergency stop"
        }
    };
    Reply::refuse(but)
}
