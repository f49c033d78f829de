//! What the machine must never do, played through with made-up devices.

use crate::code::{Code, JobStatus};
use crate::device::gripper_types::{Channels, GripperCommand, GripperFault, Identity};
use crate::device::registers::ProgramStatus;
use crate::device::robot_types::{Link, RobotCommand, RobotEvent, RobotState};
use crate::orders::{Approval, ConfirmedGripper, Order, Reply};
use crate::supervisor::cell::Supervisor;
use crate::supervisor::input::{Action, DeviceSnapshot, Input, PlanAnswer, Record};
use crate::supervisor::model::{
    CellModel, CellObject, DeviceAddresses, ForeignRule, GripSettings, Tolerances,
};
use crate::supervisor::order::JobOrder;
use crate::supervisor::round::RoundOrder;
use cell_calibration::files::hand_eye::Mount;
use cell_motion::path::{ArmLimits, ArmModel, BlendSpeed};
use cell_motion::pick_n_place::CycleParameters;
use cell_motion::testing::bodies;
use cell_values::time::{Duration, Timestamp};
use cell_values::units::Joints;
use cell_vision::foreign::{ForeignObject, ForeignReport, Hole};
use cell_vision::observe::reference::{DriftLimits, LookShift, ReferenceCheck, ReferenceError};
use cell_vision::observe::{ObjectEstimate, Observation};
use nalgebra::{Isometry3, Vector3};
use rearrange::geometry::footprint::Footprint;
use rearrange::geometry::pose::Pose2;
use rearrange::planning::plan::{Action as PlanAction, ActionKind, Objective};
use rearrange::planning::solver::SolverKind;
use rearrange::tabletop::instance::{KeepOut, MarkerSpec, Workspace};
use std::f64::consts::TAU;
use ur_arm::kinematics::{DhParameters, Kinematics};
use ur_wire::enumerations::{RobotMode, RuntimeState, SafetyMode};

const HOME: Joints = Joints([-1.6, -1.6, 1.9, -1.9, -1.57, 0.0]);

fn object() -> CellObject {
    let marker = MarkerSpec { family: "tag36h11".into(), id: 0, size: 0.03, offset: Pose2::default() };
    CellObject {
        id: "a".into(),
        group: None,
        footprint: Footprint::rectangle(0.06, 0.06).expect("valid"),
        impedance: None,
        height: 0.02,
        mass: 0.1,
        marker,
        grip_point: [0.0, 0.0],
        grip_yaw: None,
        hold: 20.0,
    }
}

fn tolerances() -> Tolerances {
    Tolerances {
        goal_position: 1e-3,
        goal_angle: 0.01,
        expected_position: 2e-3,
        expected_angle: 0.02,
        observation_age: Duration::from_secs(30),
        full_look_every: 5,
        reference: DriftLimits { residual_m: 1e-3, shift_m: 5e-4, turn_rad: 1e-3 },
        reference_seen: 3,
        measurement_std: 1e-3,
        retries: 1,
        stop_retries: 0,
        settle: Duration::from_millis(100),
        look_deadline: Duration::from_secs(20),
        phase_deadline: Duration::from_secs(20),
        arm_lapse: Duration::from_secs(600),
        plan_grace: Duration::from_secs(5),
    }
}

fn model() -> CellModel {
    CellModel {
        round: RoundOrder::default(),
        addresses: DeviceAddresses { robot: "10.0.0.2".into(), gripper: "10.0.0.3:502, unit 65".into() },
        confirmed: ConfirmedGripper::NotNeeded,
        held_before: None,
        plans_before: 0,
        cut_off: None,
        arm: ArmModel {
            kinematics: Kinematics::of(&DhParameters::UR5E),
            base_from_table: Isometry3::translation(-0.25, 0.18, 0.0),
            flange_from_tool: Isometry3::translation(0.0, 0.0, 0.2),
            home: HOME,
            limits: ArmLimits {
                joint_range: [(-TAU, TAU); 6],
                joint_speed: 2.0,
                joint_acceleration: 4.0,
                tool_speed: 0.5,
                tool_acceleration: 2.0,
            },
            blend_speed: BlendSpeed::Unknown,
            bodies: bodies(Isometry3::translation(-0.25, 0.18, 0.0), [0.5, 0.5]),
        },
        cycle: CycleParameters {
            tallest: 0.02,
            air: 0.03,
            approach: 0.04,
            press: 5e-4,
            blend: 0.02,
            joint_speed: 1.5,
            joint_acceleration: 3.0,
            tool_speed: 0.25,
            tool_acceleration: 1.2,
        },
        mount: Mount::Flange { flange_from_camera: Isometry3::translation(0.0, -0.07, 0.03) },
        look_poses: vec![HOME],
        frames_per_view: 1,
        sight: None,
        park: HOME,
        workspace: Workspace { width: 0.5, height: 0.5 },
        clearance: 0.002,
        keep_out: Vec::new(),
        ignore_markers: vec![78],
        foreign: ForeignRule::Refuse { depth_needed: false },
        objects: vec![object()],
        tolerances: tolerances(),
        grip: GripSettings {
            channels: Channels::A,
            vacuum_target: 0.6,
            body_radius: 0.05,
            body_above_lips: 0.05,
            tool_mass: 0.9,
            tool_centre: Vector3::new(0.0, 0.0, 0.07),
        },
    }
}

/// A cell, its robot, and the time.
struct Bench {
    cell: Supervisor,
    robot: RobotState,
    silent: bool,
    gripper_answers: bool,
    gripper_fault: GripperFault,
    identity: Option<Identity>,
    vacuum: [f64; 2],
    unknown: Vec<u32>,
    missing: Vec<String>,
    /// Where `a` is, and a second object.
    at: Pose2,
    other: Option<(String, Pose2)>,
    reference: ReferenceCheck,
    foreign: Option<ForeignReport>,
    now: Timestamp,
    /// Nothing that is committed gets to the disk.
    slow_disk: bool,
    /// Power and brakes are as they stay.
    arm_settled: bool,
    link_down: Option<Link>,
}

/// `count` reference markers, all `shift_m` off along x.
fn reference(count: u32, shift_m: f64) -> ReferenceCheck {
    let marker = |id| ReferenceError { id, error_m: [shift_m, 0.0], error_rad: 0.0, views: 1 };
    ReferenceCheck {
        markers: (500..500 + count).map(marker).collect(),
        residual_rms_m: shift_m.abs(),
        residual_max_m: shift_m.abs(),
        shift_m: [shift_m, 0.0],
        turn_rad: 0.0,
        looks: vec![LookShift {
            view: 0,
            markers: count as usize,
            // These tests are about the residual over all.
            shift_m: [0.0; 2],
            turn_rad: 0.0,
            lift_m: 0.0,
            errors: Vec::new(),
        }],
    }
}

impl Bench {
    fn new() -> Bench {
        let robot = RobotState {
            received: Timestamp::ZERO,
            controller_time_s: 100.0,
            q: HOME,
            qd: [0.0; 6],
            tcp_pose: [0.0; 6],
            robot_mode: RobotMode::Running,
            safety_mode: SafetyMode::Normal,
            runtime_state: RuntimeState::Playing,
            guided: false,
            speed_scaling: 1.0,
            target_speed_fraction: 1.0,
            payload: 0.9,
            payload_cog: [0.0; 3],
            tcp_offset: [0.0; 6],
            nonce: 0,
            accepted: 0,
            finished: 0,
            program_status: ProgramStatus::Idle,
            heartbeat_echo: 0,
            remote_control: Some(true),
        };
        Bench {
            cell: Supervisor::new(model(), 7),
            robot,
            silent: false,
            gripper_answers: true,
            gripper_fault: GripperFault::Silent,
            identity: Some(Identity::default()),
            vacuum: [0.01, 0.0],
            unknown: Vec::new(),
            missing: Vec::new(),
            at: Pose2::new(0.15, 0.3, 0.0),
            other: None,
            reference: reference(4, 1e-4),
            foreign: None,
            now: Timestamp::from_secs_f64(1.0),
            slow_disk: false,
            arm_settled: true,
            link_down: None,
        }
    }

    /// One input; what is to be written is on disk 20 ms later, unless the disk is slow.
    fn feed(&mut self, input: Input) -> Vec<Action> {
        let mut actions = self.feed_once(input);
        let mut next = 0;
        while let Some(action) = actions.get(next) {
            next += 1;
            if let Action::Commit { number, .. } = *action
                && !self.slow_disk
            {
                actions.extend(self.feed_once(Input::Committed { number, result: Ok(()) }));
            }
        }
        actions
    }

    /// What is known of the devices, with the robot as given.
    fn devices<'a>(&self, robot: &'a RobotState) -> DeviceSnapshot<'a> {
        DeviceSnapshot {
            link_down: self.link_down,
            link_lost: self.link_down,
            all_links_lost: false,
            robot: Some(robot),
            robot_fresh: !self.silent,
            program_settled: true,
            arm_settled: self.arm_settled,
            gripper_holds: self.vacuum.iter().any(|share| *share > 0.4),
            gripper_answers: self.gripper_answers,
            gripper_fault: self.gripper_fault,
            gripper_identity: self.identity,
            vacuum: Some(self.vacuum),
        }
    }

    fn feed_once(&mut self, input: Input) -> Vec<Action> {
        self.now += Duration::from_millis(20);
        if !self.silent {
            self.robot.received = self.now;
        }
        let robot = self.robot.clone();
        let devices = self.devices(&robot);
        let actions = self.cell.step(self.now, &devices, input);
        for action in &actions {
            if let Action::Robot(RobotCommand::StartProgram { nonce }) = action {
                self.robot.nonce = nonce.number();
            }
        }
        actions
    }

    fn ticks(&mut self, count: usize) -> Vec<Action> {
        (0..count).flat_map(|_| self.feed(Input::Tick)).collect()
    }

    fn job(&mut self, needs_approval: bool) -> Vec<Action> {
        self.job_with(if needs_approval { Approval::Always } else { Approval::Never })
    }

    fn job_with(&mut self, approval: Approval) -> Vec<Action> {
        self.feed(Input::Job(Box::new(JobOrder {
            id: "j".into(),
            goals: vec![("a".into(), Pose2::new(0.35, 0.3, 0.0))],
            objective: Objective::Pp,
            solver: SolverKind::Erbm,
            time_limit: Duration::from_secs(1),
            seed: 0,
            approval,
            rule: None,
            agreed: Vec::new(),
        })))
    }

    /// Arms and goes as far as the plan request.
    fn until_planning(&mut self) -> Vec<Action> {
        let mut started = self.feed(order(Order::Arm));
        started.extend(self.ticks(20));
        assert!(streams(&started) == 1, "the look begins: {started:?}");
        self.look()
    }

    /// The arm is on its way to the look pose; the look ends with `a` at its start.
    fn look(&mut self) -> Vec<Action> {
        for _ in 0..self.cell.model().look_poses.len() {
            self.feed(Input::Robot(RobotEvent::PathFinished { batch: 1 }));
            let settled = self.ticks(10);
            assert!(settled.iter().any(|action| matches!(action, Action::Capture { .. })), "{settled:?}");
            self.feed(Input::Captured(Ok(Vec::new())));
        }
        let estimate = estimate("a", self.at, self.now);
        let reference = Some(self.reference.clone());
        let other = self.other.iter().map(|(id, pose)| ObjectEstimate {
            id: id.clone(),
            pose: *pose,
            ..estimate.clone()
        });
        let objects: Vec<_> = std::iter::once(estimate.clone()).chain(other).collect();
        let (missing, unknown) = (self.missing.clone(), self.unknown.clone());
        let foreign = self.foreign.clone();
        let seen = Observation { objects, reference, unknown, missing, foreign, ..Observation::default() };
        self.feed(Input::Observed(Ok(Box::new(seen))))
    }

    fn plan(&mut self) -> Vec<Action> {
        let (from, to) = (self.at, Pose2::new(0.35, 0.3, 0.0));
        let actions = vec![PlanAction { object: 0, from, to, kind: ActionKind::Goal }];
        let answer = PlanAnswer::Found { actions, cost: 1.0, lower_bound: 1.0, seconds: 0.01 };
        self.feed(Input::Planned(Box::new(answer)))
    }
}

/// An object that lies flat and was seen in one picture.
fn estimate(id: &str, pose: Pose2, time: Timestamp) -> ObjectEstimate {
    ObjectEstimate {
        id: id.to_string(),
        pose,
        std_xy_m: 2e-4,
        std_theta_rad: 1e-3,
        views: 1,
        rejected_views: 0,
        tilt_rad: 0.0,
        tilt_std_rad: 0.01,
        height_error_m: 0.0,
        height_std_m: 1e-3,
        time,
    }
}

/// An order as it comes in.
fn order(order: Order) -> Input {
    Input::Order { number: 1, order }
}

/// The answer to an order.
fn answer(actions: &[Action]) -> Option<Reply> {
    actions.iter().find_map(|action| match action {
        Action::Reply { reply, .. } => Some(reply.clone()),
        _ => None,
    })
}

fn streams(actions: &[Action]) -> usize {
    actions.iter().filter(|action| matches!(action, Action::Robot(RobotCommand::Stream(_)))).count()
}

fn ended(actions: &[Action]) -> Option<(JobStatus, String)> {
    actions.iter().find_map(|action| match action {
        Action::Commit { record: Record::Ended(report), .. } => Some((report.end, report.code_text())),
        _ => None,
    })
}

/// At a found plan, with a disk that does not answer; the number of the intent.
fn intent_under_way() -> (Bench, u64) {
    let mut bench = Bench::new();
    bench.job(false);
    let requested = bench.until_planning();
    assert!(requested.iter().any(|action| matches!(action, Action::Plan(_))), "{requested:?}");
    bench.slow_disk = true;
    let mut all = bench.plan();
    all.extend(bench.ticks(20));
    let intents: Vec<u64> = all
        .iter()
        .filter_map(|action| match action {
            Action::Commit { number, record: Record::Intent { .. } } => Some(*number),
            _ => None,
        })
        .collect();
    assert!(intents.len() == 1 && streams(&all) == 0, "{all:?}");
    (bench, intents[0])
}

#[test]
fn the_journal_is_on_disk_before_the_arm_moves_for_an_object() {
    let (mut bench, number) = intent_under_way();
    let other = bench.feed(Input::Committed { number: number + 1, result: Ok(()) });
    assert_eq!(streams(&other), 0, "another record's word moves nothing");
    assert_eq!(streams(&bench.feed(Input::Committed { number, result: Ok(()) })), 1);
}

#[test]
fn what_waited_for_the_disk_never_begins_after_a_stop() {
    for stop in [order(Order::Disarm), order(Order::Abort), Input::Shutdown] {
        let (mut bench, number) = intent_under_way();
        bench.feed(stop.clone());
        let mut all = bench.feed(Input::Committed { number, result: Ok(()) });
        all.extend(bench.ticks(100));
        assert_eq!(streams(&all), 0, "{stop:?}: {all:?}");
        assert!(!bench.cell.status().armed);
    }
}

#[test]
fn gates_that_closed_while_the_intent_was_written_keep_the_arm_still() {
    let (mut bench, number) = intent_under_way();
    bench.robot.robot_mode = RobotMode::Idle;
    let all = bench.feed(Input::Committed { number, result: Ok(()) });
    assert_eq!(streams(&all), 0, "{all:?}");
}

#[test]
fn a_disk_that_cannot_write_or_is_silent_stops_the_arm_and_ends_the_daemon() {
    let (mut bench, number) = intent_under_way();
    let mut failed = bench.feed(Input::Committed { number, result: Err("full".into()) });
    failed.extend(bench.feed(Input::Robot(RobotEvent::Stopped)));
    failed.extend(bench.ticks(2));
    let (mut bench, _) = intent_under_way();
    let mut silent = bench.ticks(700);
    assert_eq!(ended(&silent), None, "14 s have passed");
    silent.extend(bench.ticks(60));
    silent.extend(bench.feed(Input::Robot(RobotEvent::Stopped)));
    silent.extend(bench.ticks(2));
    for all in [failed, silent] {
        assert_eq!(ended(&all), Some((JobStatus::Interrupted, Code::JournalFailed.as_str().into())));
        let stop = all.iter().position(|a| matches!(a, Action::Robot(RobotCommand::Stop)));
        let end = all.iter().position(|a| matches!(a, Action::End(Err(_))));
        assert!(stop.is_some() && stop < end, "{all:?}");
    }
}

#[test]
fn silence_while_moving_stops_first_then_ends_the_job_and_disarms() {
    let mut bench = Bench::new();
    bench.job(false);
    bench.until_planning();
    bench.plan();
    bench.silent = true;
    let actions = bench.feed(Input::Tick);
    assert!(matches!(actions.first(), Some(Action::Robot(RobotCommand::Stop))), "{actions:?}");
    assert_eq!(ended(&actions), Some((JobStatus::Interrupted, "link_silent".into())));
    assert!(!bench.cell.status().armed);
    bench.silent = false;
    bench.job(false);
    assert_eq!(streams(&bench.ticks(500)), 0, "nothing moves until a person armed it again");
}

#[test]
fn a_safety_stop_while_moving_never_releases_the_vacuum() {
    let mut bench = Bench::new();
    bench.job(false);
    bench.until_planning();
    bench.plan();
    bench.robot.safety_mode = SafetyMode::ProtectiveStop;
    let mut actions = bench.feed(Input::Tick);
    actions.extend(bench.ticks(100));
    assert!(matches!(actions.first(), Some(Action::Robot(RobotCommand::Stop))), "{actions:?}");
    assert!(!actions.iter().any(|action| matches!(action, Action::Gripper(_))), "{actions:?}");
    assert!(!actions.iter().any(|a| matches!(a, Action::Robot(RobotCommand::UnlockProtectiveStop))));
}

#[test]
fn shutdown_stops_the_arm_first_and_names_the_job() {
    let mut bench = Bench::new();
    bench.job(false);
    bench.until_planning();
    bench.plan();
    let actions = bench.feed(Input::Shutdown);
    assert!(matches!(actions.first(), Some(Action::Robot(RobotCommand::Stop))), "{actions:?}");
    assert_eq!(ended(&actions), Some((JobStatus::Interrupted, "shutdown".into())));
    assert_eq!(streams(&bench.ticks(100)), 0);
}

/// Looks until the job ends; nothing may be requested of the planner or the gripper meanwhile.
fn ends_without_planning(reference: ReferenceCheck) -> (JobStatus, String) {
    let mut bench = Bench::new();
    bench.reference = reference;
    bench.job(false);
    let mut all = bench.until_planning();
    for _ in 0..3 {
        if let Some(end) = ended(&all) {
            assert!(!all.iter().any(|a| matches!(a, Action::Plan(_) | Action::Gripper(_))), "{all:?}");
            return end;
        }
        all.extend(bench.look());
    }
    panic!("the job did not end: {all:?}");
}

#[test]
fn a_bumped_camera_stops_the_job_before_anything_is_picked() {
    let (end, code) = ends_without_planning(reference(4, 1.2e-3));
    assert_eq!((end, code.as_str()), (JobStatus::Failed, "calibration_invalid"));
    let (end, code) = ends_without_planning(reference(4, f64::NAN));
    assert_eq!((end, code.as_str()), (JobStatus::Failed, "calibration_invalid"));
}

#[test]
fn a_camera_that_was_lifted_shifted_or_turned_at_one_look_pose_stops_the_job() {
    let [look] = &reference(4, 0.0).looks[..] else { panic!("one look") };
    let bumps = [
        LookShift { lift_m: -8e-4, ..look.clone() },
        LookShift { shift_m: [4e-4, -4e-4], ..look.clone() },
        LookShift { turn_rad: 2e-3, ..look.clone() },
        LookShift { lift_m: f64::NAN, ..look.clone() },
    ];
    for bump in bumps {
        let looks = vec![look.clone(), bump];
        let (_, code) = ends_without_planning(ReferenceCheck { looks: looks.clone(), ..reference(4, 1e-4) });
        assert_eq!(code, "calibration_invalid", "{looks:?}");
    }
    let mut bench = Bench::new();
    bench.reference = ReferenceCheck { looks: vec![look.clone()], ..reference(4, 1e-4) };
    bench.job(false);
    assert!(bench.until_planning().iter().any(|action| matches!(action, Action::Plan(_))));
}

#[test]
fn a_look_near_its_limits_is_worked_on_and_reported_once() {
    let mut bench = Bench::new();
    let limit = bench.cell.model().tolerances.reference.shift_m;
    let reported = |all: &[Action]| {
        let says = |action: &&Action| matches!(action, Action::Say(notice) if notice.text.contains("of what is allowed"));
        all.iter().filter(says).count()
    };
    bench.job(false);
    bench.reference.looks[0].shift_m = [0.4 * limit, 0.0];
    let all = bench.until_planning();
    assert_eq!(reported(&all), 0, "{all:?}");
    let mut bench = Bench::new();
    bench.job(false);
    bench.reference.looks[0].shift_m = [0.6 * limit, 0.0];
    let all = bench.until_planning();
    assert!(reported(&all) == 1 && all.iter().any(|action| matches!(action, Action::Plan(_))), "{all:?}");
}

#[test]
fn markers_that_no_look_shows_together_prove_nothing() {
    let spread = ReferenceCheck { looks: Vec::new(), ..reference(4, 0.0) };
    assert_eq!(ends_without_planning(spread), (JobStatus::Failed, "reference_hidden".into()));
}

#[test]
fn hidden_reference_markers_are_not_taken_for_a_bump() {
    let (end, code) = ends_without_planning(reference(2, 0.0));
    assert_eq!((end, code.as_str()), (JobStatus::Failed, "reference_hidden"));
}

#[test]
fn keep_out_regions_of_the_cell_reach_the_planner() {
    let region =
        KeepOut { footprint: Footprint::disc(0.02).expect("valid"), pose: Pose2::new(0.4, 0.1, 0.0) };
    let mut bench = Bench::new();
    bench.cell = Supervisor::new(CellModel { keep_out: vec![region.clone()], ..model() }, 7);
    bench.job(false);
    let requested = bench.until_planning();
    let request = requested.iter().find_map(|action| match action {
        Action::Plan(request) => Some(request),
        _ => None,
    });
    assert_eq!(request.expect("a plan is asked for").instance.keep_out, [region]);
}

#[test]
fn a_plan_approved_late_waits_for_a_new_look() {
    let mut bench = Bench::new();
    bench.job(true);
    bench.until_planning();
    bench.plan();
    bench.now += Duration::from_secs(31);
    let actions = bench.feed(order(bench.approval()));
    let journalled = |all: &[Action]| {
        all.iter().any(|a| matches!(a, Action::Commit { record: Record::Intent { .. }, .. }))
    };
    assert!(!journalled(&actions), "nothing is picked on an old observation: {actions:?}");
    assert_eq!(streams(&actions), 1, "the arm goes to look");
    let actions = bench.look();
    assert!(journalled(&actions), "the approved plan goes on: {actions:?}");
}

mod arming;
mod faults;
mod foreign;
mod improve;
mod jump;
mod lapse;
mod moving;
mod preview;
mod reach;
mod rest;
mod rounds;
pub(crate) mod set_out;
mod sight;
mod standing;
