//! The robot session against a scripted controller, in virtual time.

mod broken_states;
mod fake;
mod handshake;
mod running;
mod waiting;

use crate::device::program::Nonce;
use crate::device::robot::Robot;
use crate::device::robot_types::{Link, RobotCommand, RobotEvent, RobotParameters};
use cell_motion::bodies::{Bodies, Room};
use cell_motion::path::{ArmLimits, ArmModel, BlendSpeed, CheckedPath, Leg, Segment};
use cell_values::time::{Duration, Timestamp};
use cell_values::units::Joints;
use fake::Fake;
use nalgebra::Isometry3;
use std::f64::consts::{FRAC_PI_2, TAU};
use ur_arm::kinematics::{DhParameters, Kinematics};

/// Session, controller and the wires between them.
struct Rig {
    robot: Robot,
    fake: Fake,
    now: Timestamp,
    events: Vec<RobotEvent>,
    /// Links that are established.
    up: Vec<Link>,
    /// Made again this long after a close; `None`: never.
    reconnect: Option<Duration>,
    due: Vec<(Timestamp, Link)>,
    /// Bytes per delivery to the session.
    slice: usize,
}

const FRAME: Duration = Duration::from_millis(2);

impl Rig {
    fn new() -> Rig {
        Rig {
            robot: Robot::new(RobotParameters::full_rate()).unwrap(),
            fake: Fake::new(),
            now: Timestamp::from_secs_f64(100.0),
            events: Vec::new(),
            up: Vec::new(),
            reconnect: Some(Duration::from_millis(100)),
            due: Vec::new(),
            slice: usize::MAX,
        }
    }

    /// Connected on all links and ready.
    fn ready() -> Rig {
        let mut rig = Rig::new();
        rig.connect_all();
        rig.run_ms(100);
        assert!(rig.saw(&RobotEvent::RtdeReady), "{:?}", rig.events);
        rig
    }

    /// With the program running and nothing streamed.
    fn running() -> Rig {
        let mut rig = Rig::ready();
        rig.command(RobotCommand::StartProgram { nonce: Nonce::new(7) });
        rig.run_ms(100);
        assert!(rig.saw(&RobotEvent::ProgramRunning { nonce: Nonce::new(7) }), "{:?}", rig.events);
        rig.events.clear();
        rig
    }

    fn connect_all(&mut self) {
        for link in Link::ALL {
            self.connect(link);
        }
    }

    fn connect(&mut self, link: Link) {
        self.up.push(link);
        self.fake.connected(link);
        self.robot.connected(self.now, link);
        self.exchange();
    }

    fn drop_link(&mut self, link: Link) {
        self.up.retain(|up| *up != link);
        self.fake.disconnected(link);
        self.robot.disconnected(self.now, link, "cut");
        self.exchange();
    }

    #[track_caller]
    fn command(&mut self, command: RobotCommand) {
        self.robot.command(self.now, command).unwrap();
        self.exchange();
    }

    /// Carries bytes both ways until nothing moves, and handles wishes for new links.
    fn exchange(&mut self) {
        loop {
            let mut moved = false;
            self.robot.tick(self.now);
            self.close_links();
            while let Some((link, bytes)) = self.robot.poll_transmit() {
                assert!(self.up.contains(&link), "the session sends on {link}, which is down");
                self.fake.received(self.now, link, &bytes);
                moved = true;
            }
            moved |= self.take_arrived();
            self.close_links();
            if !moved {
                break;
            }
        }
        while let Some(event) = self.robot.poll_event() {
            self.events.push(event);
        }
    }

    /// Hands over what the controller has sent; true if there was anything.
    fn take_arrived(&mut self) -> bool {
        let mut moved = false;
        while let Some((link, bytes)) = self.fake.poll_transmit() {
            moved = true;
            for part in bytes.chunks(self.slice.min(bytes.len()).max(1)) {
                if self.up.contains(&link) {
                    self.robot.received(self.now, link, part);
                    self.close_links();
                }
            }
        }
        moved
    }

    fn close_links(&mut self) {
        while let Some(link) = self.robot.poll_close() {
            self.up.retain(|up| *up != link);
            self.fake.disconnected(link);
            self.robot.disconnected(self.now, link, "closed by the session");
            if let Some(pause) = self.reconnect {
                self.due.push((self.now + pause, link));
            }
        }
    }

    fn run_ms(&mut self, ms: u64) {
        let end = self.now + Duration::from_millis(ms);
        while self.now < end {
            self.now += FRAME;
            for (_, link) in self.due.extract_if(.., |(at, _)| *at <= self.now).collect::<Vec<_>>() {
                self.connect(link);
            }
            self.fake.frame(self.now);
            self.exchange();
            if self.robot.poll_timeout().is_some_and(|(at, _)| at <= self.now) {
                self.robot.tick(self.now);
                self.exchange();
                let next = self.robot.poll_timeout();
                assert!(next.is_none_or(|(at, _)| at > self.now), "{next:?} stays in the past");
            }
        }
    }

    fn saw(&self, event: &RobotEvent) -> bool {
        self.events.contains(event)
    }

    fn ended(&self) -> Option<String> {
        self.events.iter().find_map(|event| match event {
            RobotEvent::ProgramEnded { reason } => Some(reason.to_string()),
            _ => None,
        })
    }

    fn faults(&self) -> Vec<String> {
        let text = |event: &RobotEvent| match event {
            RobotEvent::ProtocolFault { link, detail, .. } | RobotEvent::LinkSilent { link, detail } => {
                Some(format!("{link}: {detail}"))
            }
            RobotEvent::ArmStalled { detail } => Some(detail.clone()),
            _ => None,
        };
        self.events.iter().filter_map(text).collect()
    }

    fn refusals(&self) -> Vec<String> {
        let text = |event: &RobotEvent| match event {
            RobotEvent::Refused { what, reply } => Some(format!("{what}: {reply}")),
            _ => None,
        };
        self.events.iter().filter_map(text).collect()
    }
}

const HOME: Joints = Joints([0.0, -FRAC_PI_2, FRAC_PI_2, -FRAC_PI_2, -FRAC_PI_2, 0.0]);

fn model() -> ArmModel {
    ArmModel {
        kinematics: Kinematics::of(&DhParameters::UR5E),
        base_from_table: Isometry3::identity(),
        flange_from_tool: Isometry3::translation(0.0, 0.0, 0.1),
        home: HOME,
        limits: ArmLimits {
            joint_range: [(-TAU, TAU); 6],
            joint_speed: 1.0,
            joint_acceleration: 2.0,
            tool_speed: 0.5,
            tool_acceleration: 1.0,
        },
        blend_speed: BlendSpeed::Unknown,
        bodies: Bodies::bare(&DhParameters::UR5E),
    }
}

/// A path of joint segments that turns the base by 0.1 rad each, from `from` on.
fn path(from: Joints, segments: usize) -> CheckedPath {
    let legs: Vec<Leg> = (1..=segments)
        .map(|k| {
            let mut target = from;
            target.0[0] += 0.1 * k as f64;
            let segment = Segment::Joint { target, speed: 1.0, acceleration: 2.0, blend: 0.02 };
            Leg::over(segment, -1.0)
        })
        .collect();
    CheckedPath::new(&model(), &from, &legs, &Room::empty()).unwrap()
}
