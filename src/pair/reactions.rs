//! What the cell does about each fault: the table behind the sweep and behind `docs/reactions.md`.
//!
//! In: nothing. Out: [`ROWS`], numbered as in the reference's fault table, each with the cause, how long it
//! lasts and the phases in which it can occur. What is expected of each is the page itself (`pair::page`).

use crate::pair::Loss;
use crate::pair::disk::Mood;
use crate::pair::outcome::Phase;
use cell_machine::device::gripper_types::Channels;
use cell_machine::device::robot_types::Link;
use cell_machine::orders::Order;

/// How a fault is brought about.
#[derive(Clone, Copy, Debug)]
pub enum Cause {
    /// Faults of the simulator, as posted to it.
    Faults(&'static [&'static str]),
    /// The disk under the journal.
    Disk(Mood),
    /// The daemon's process is gone and started anew.
    Lost(Loss),
    /// Power of everything: PC, controller and gripper.
    AllPower,
    /// Bytes that are none of the protocol's.
    Garbage(Link),
    /// The planner may take so many steps.
    PlanWork(u64),
    /// Two goals of the job overlap.
    OverlappingGoals,
    /// The planner's plan is wrong.
    BadPlan,
    /// Every marker looks tilted to the other side.
    Flipped,
    /// A person gives an order.
    Ordered(fn() -> Order),
}

/// A row of the table.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    /// In the reference's fault table; 0 for what a person does.
    pub number: u8,
    /// What goes wrong.
    pub name: &'static str,
    /// How it is brought about.
    pub cause: Cause,
    /// How long it lasts, s; 0: as the fault says.
    pub seconds: f64,
    /// Where it can occur.
    pub phases: &'static [Phase],
    /// No work is possible until the cell is configured anew.
    pub ends_work: bool,
}

use Phase::{Approach, Approve, BringUp, Carry, Descend, Grip, Lift, Look, Place, Plan, Release, Retreat};

/// Every phase.
const ALL: &[Phase] = &Phase::ALL;
/// An object is held.
const HELD: &[Phase] = &[Lift, Carry, Place];
/// The arm is under way with or for an object.
const WORK: &[Phase] = &[Approach, Descend, Grip, Lift, Carry, Place, Release, Retreat];
const JOB: &[Phase] =
    &[BringUp, Look, Plan, Approve, Approach, Descend, Grip, Lift, Carry, Place, Release, Retreat];

const fn row(number: u8, name: &'static str, cause: Cause, seconds: f64, phases: &'static [Phase]) -> Row {
    Row { number, name, cause, seconds, phases, ends_work: false }
}

/// The table; rows are known by their address.
pub static ROWS: &[Row] = &[
    row(
        1,
        "RTDE connection reset",
        Cause::Faults(&[r#"{"do": "net.reset_peer", "args": {"link": "rtde"}}"#]),
        0.0,
        ALL,
    ),
    row(
        1,
        "dashboard connection reset",
        Cause::Faults(&[r#"{"do": "net.reset_peer", "args": {"link": "dashboard"}}"#]),
        0.0,
        ALL,
    ),
    row(
        1,
        "primary connection reset",
        Cause::Faults(&[r#"{"do": "net.reset_peer", "args": {"link": "primary"}}"#]),
        0.0,
        ALL,
    ),
    row(
        2,
        "RTDE half-open",
        Cause::Faults(&[r#"{"do": "net.timeout", "args": {"link": "rtde"}}"#]),
        4.0,
        ALL,
    ),
    row(
        2,
        "dashboard half-open",
        Cause::Faults(&[r#"{"do": "net.timeout", "args": {"link": "dashboard"}}"#]),
        4.0,
        ALL,
    ),
    row(
        2,
        "cable to the controller cut",
        Cause::Faults(&[
            r#"{"do": "net.timeout", "args": {"link": "rtde"}}"#,
            r#"{"do": "net.timeout", "args": {"link": "dashboard"}}"#,
            r#"{"do": "net.timeout", "args": {"link": "primary"}}"#,
        ]),
        4.0,
        ALL,
    ),
    row(3, "controller reboots", Cause::Faults(&[r#"{"do": "ur.reboot"}"#]), 5.0, ALL),
    Row {
        ends_work: true,
        ..row(
            3,
            "controller comes back with another calibration",
            Cause::Faults(&[r#"{"do": "ur.reboot", "args": {"kinematics": 77}}"#]),
            5.0,
            ALL,
        )
    },
    row(4, "emergency stop", Cause::Faults(&[r#"{"do": "ur.estop"}"#]), 3.0, ALL),
    row(5, "protective stop", Cause::Faults(&[r#"{"do": "ur.pstop"}"#]), 0.0, ALL),
    row(6, "safeguard stop", Cause::Faults(&[r#"{"do": "ur.safeguard"}"#]), 3.0, ALL),
    row(
        7,
        "safety mode that nobody knows",
        Cause::Faults(&[r#"{"do": "ur.safety", "args": {"mode": 99}}"#]),
        3.0,
        ALL,
    ),
    row(8, "fault of the safety system", Cause::Faults(&[r#"{"do": "ur.fault"}"#]), 0.0, ALL),
    row(9, "pendant in local control", Cause::Faults(&[r#"{"do": "ur.local"}"#]), 3.0, ALL),
    row(9, "power switched off at the pendant", Cause::Faults(&[r#"{"do": "ur.power_off"}"#]), 0.0, ALL),
    row(9, "arm guided by hand", Cause::Faults(&[r#"{"do": "ur.freedrive"}"#]), 3.0, ALL),
    row(10, "program stopped from the pendant", Cause::Faults(&[r#"{"do": "ur.kill_program"}"#]), 0.0, ALL),
    row(
        10,
        "another program takes over",
        Cause::Faults(&[r#"{"do": "ur.foreign_script", "args": {"runs_s": 2}}"#]),
        0.0,
        ALL,
    ),
    row(11, "program paused for 5 s", Cause::Faults(&[r#"{"do": "ur.pause"}"#]), 5.0, JOB),
    row(11, "program paused for 40 s", Cause::Faults(&[r#"{"do": "ur.pause"}"#]), 40.0, WORK),
    row(
        12,
        "speed slider at zero for 5 s",
        Cause::Faults(&[r#"{"do": "ur.slider", "args": {"fraction": 0}}"#]),
        5.0,
        ALL,
    ),
    row(
        12,
        "speed slider at zero for 40 s",
        Cause::Faults(&[r#"{"do": "ur.slider", "args": {"fraction": 0}}"#]),
        40.0,
        WORK,
    ),
    row(
        12,
        "speed slider at 20 %",
        Cause::Faults(&[r#"{"do": "ur.slider", "args": {"fraction": 0.2}}"#]),
        20.0,
        ALL,
    ),
    row(
        13,
        "a register is taken by another client",
        Cause::Faults(&[
            r#"{"do": "ur.claim", "args": {"input": "input_int_register_24"}}"#,
            r#"{"do": "net.reset_peer", "args": {"link": "rtde"}}"#,
        ]),
        12.0,
        ALL,
    ),
    row(14, "runtime exception of the program", Cause::Faults(&[r#"{"do": "ur.script_error"}"#]), 0.0, ALL),
    row(14, "the program never starts", Cause::Faults(&[r#"{"do": "ur.never_start"}"#]), 40.0, &[BringUp]),
    row(15, "the arm does not follow", Cause::Faults(&[r#"{"do": "ur.stall"}"#]), 30.0, ALL),
    row(
        16,
        "gripper silent",
        Cause::Faults(&[r#"{"do": "net.timeout", "args": {"link": "gripper"}}"#]),
        5.0,
        ALL,
    ),
    row(
        16,
        "gripper answers with exceptions",
        Cause::Faults(&[r#"{"do": "net.exception", "args": {"code": 4}}"#]),
        5.0,
        ALL,
    ),
    row(
        16,
        "gripper answers with other transactions",
        Cause::Faults(&[r#"{"do": "net.transaction"}"#]),
        5.0,
        ALL,
    ),
    row(
        16,
        "gripper answers 5 s late",
        Cause::Faults(&[r#"{"do": "net.latency", "args": {"link": "gripper", "latency_s": 5}}"#]),
        6.0,
        ALL,
    ),
    row(
        17,
        "the vacuum does not come",
        Cause::Faults(&[r#"{"do": "vacuum.leak", "args": {"vacuum": 0.3}}"#]),
        90.0,
        &[Approach, Descend, Grip],
    ),
    row(18, "an object is lost on the way", Cause::Faults(&[r#"{"do": "vacuum.drop"}"#]), 0.5, HELD),
    row(
        19,
        "the vacuum falls slowly",
        Cause::Faults(&[r#"{"do": "vacuum.leak", "args": {"vacuum": 0.1, "falls_s": 2}}"#]),
        30.0,
        HELD,
    ),
    row(
        20,
        "the object sticks to the cups",
        Cause::Faults(&[r#"{"do": "vacuum.stick"}"#]),
        60.0,
        &[Carry, Place],
    ),
    row(21, "camera unplugged", Cause::Faults(&[r#"{"do": "camera.off"}"#]), 20.0, JOB),
    row(21, "camera away for good", Cause::Faults(&[r#"{"do": "camera.off"}"#]), 400.0, JOB),
    row(22, "camera frozen", Cause::Faults(&[r#"{"do": "camera.freeze"}"#]), 400.0, &[Look, Approach, Carry]),
    row(
        22,
        "camera repeats itself",
        Cause::Faults(&[r#"{"do": "camera.repeat"}"#]),
        400.0,
        &[Look, Approach, Carry],
    ),
    row(
        23,
        "dark",
        Cause::Faults(&[r#"{"do": "camera.gain", "args": {"gain": 0.02}}"#]),
        400.0,
        &[Look, Approach, Carry],
    ),
    row(
        23,
        "overexposed",
        Cause::Faults(&[r#"{"do": "camera.gain", "args": {"gain": 8}}"#]),
        400.0,
        &[Look, Approach, Carry],
    ),
    row(
        23,
        "blurred",
        Cause::Faults(&[r#"{"do": "camera.blur", "args": {"sigma_px": 12}}"#]),
        400.0,
        &[Look, Approach, Carry],
    ),
    row(
        23,
        "fog",
        Cause::Faults(&[r#"{"do": "camera.fog", "args": {"share": 0.99}}"#]),
        400.0,
        &[Look, Approach, Carry],
    ),
    row(
        24,
        "a marker is covered",
        Cause::Faults(&[
            r#"{"do": "camera.occlude", "args": {"marker": 0}}"#,
            r#"{"do": "camera.occlude", "args": {"marker": 1}}"#,
            r#"{"do": "camera.occlude", "args": {"marker": 2}}"#,
        ]),
        400.0,
        &[Look, Approach, Carry],
    ),
    row(
        25,
        "a marker is there twice",
        Cause::Faults(&[r#"{"do": "camera.dup", "args": {"marker": 0, "pose": [0.2, 0.38, 0]}}"#]),
        400.0,
        &[Look, Approach, Carry],
    ),
    row(
        26,
        "a marker that belongs to nothing",
        Cause::Faults(&[
            r#"{"do": "camera.unknown", "args": {"marker": 300, "pose": [0.2, 0.38, 0], "size_m": 0.02}}"#,
        ]),
        400.0,
        &[Look, Approach, Carry],
    ),
    row(27, "marker poses are the other of two", Cause::Flipped, 0.0, &[Look, Approach, Carry]),
    row(
        28,
        "the camera is bumped by 3 mm",
        Cause::Faults(&[r#"{"do": "camera.extrinsics", "args": {"translation_m": [0.003, 0, 0]}}"#]),
        400.0,
        &[Look, Plan, Approve, Approach, Carry],
    ),
    row(
        29,
        "an object is moved by hand",
        Cause::Faults(&[r#"{"do": "world.nudge", "args": {"object": "lid-2", "dx_m": -0.02}}"#]),
        0.0,
        JOB,
    ),
    row(
        30,
        "an object is put at the edge",
        Cause::Faults(&[r#"{"do": "world.place", "args": {"object": "lid-2", "pose": [0.395, 0.2, 0]}}"#]),
        0.0,
        &[Look, Approach, Carry],
    ),
    row(31, "goals that overlap", Cause::OverlappingGoals, 0.0, &[Look]),
    row(32, "the planner finds nothing in time", Cause::PlanWork(0), 0.0, &[Look]),
    row(33, "the planner is wrong", Cause::BadPlan, 0.0, &[Look]),
    row(34, "disk full", Cause::Disk(Mood::Full), 0.0, ALL),
    row(35, "disk fails", Cause::Disk(Mood::Broken), 0.0, ALL),
    row(35, "disk silent", Cause::Disk(Mood::Silent), 0.0, ALL),
    row(35, "disk takes 2 s for an entry", Cause::Disk(Mood::Slow(2.0)), 0.0, ALL),
    row(36, "daemon killed", Cause::Lost(Loss::Killed), 0.0, ALL),
    row(38, "power of the PC cut", Cause::Lost(Loss::PowerCut), 0.0, ALL),
    row(38, "power of everything cut", Cause::AllPower, 0.0, ALL),
    row(40, "garbage from RTDE", Cause::Garbage(Link::Rtde), 0.0, ALL),
    row(40, "garbage from the dashboard", Cause::Garbage(Link::Dashboard), 0.0, ALL),
    row(40, "garbage from the primary interface", Cause::Garbage(Link::Primary), 0.0, ALL),
    row(41, "RTDE at 4 Hz", Cause::Faults(&[r#"{"do": "ur.rate", "args": {"hz": 4}}"#]), 5.0, ALL),
    Row {
        // A dashboard that is made anew meanwhile shows it too, and locks the cell.
        ends_work: true,
        ..row(
            41,
            "software 3.15 after a reconnection",
            Cause::Faults(&[
                r#"{"do": "ur.version", "args": {"version": "3.15.0.1"}}"#,
                r#"{"do": "net.reset_peer", "args": {"link": "rtde"}}"#,
            ]),
            12.0,
            ALL,
        )
    },
    Row {
        ends_work: true,
        ..row(
            47,
            "another robot after a reconnection",
            Cause::Faults(&[
                r#"{"do": "ur.model", "args": {"model": "UR10"}}"#,
                r#"{"do": "ur.reboot", "args": {"serial": "20195599999", "kinematics": 9}}"#,
            ]),
            5.0,
            ALL,
        )
    },
    Row {
        ends_work: true,
        ..row(
            47,
            "another model and software after a reconnection",
            Cause::Faults(&[
                r#"{"do": "ur.model", "args": {"model": "UR10"}}"#,
                r#"{"do": "net.reset_peer", "args": {"link": "dashboard"}}"#,
            ]),
            5.0,
            ALL,
        )
    },
    Row {
        ends_work: true,
        ..row(
            47,
            "another safety configuration",
            Cause::Faults(&[r#"{"do": "ur.safety_checksum", "args": {"checksum": 77}}"#]),
            5.0,
            ALL,
        )
    },
    row(
        48,
        "another payload than set",
        Cause::Faults(&[r#"{"do": "ur.payload", "args": {"mass_kg": 3}}"#]),
        0.0,
        ALL,
    ),
    row(0, "the operator aborts", Cause::Ordered(|| Order::Abort), 0.0, ALL),
    row(0, "the operator disarms", Cause::Ordered(|| Order::Disarm), 0.0, ALL),
    row(0, "the operator releases the vacuum", Cause::Ordered(|| Order::Release(Channels::Both)), 0.0, ALL),
    row(0, "the operator pauses", Cause::Ordered(|| Order::Pause), 0.0, ALL),
];
