//! The rules by name, and a breach of one.
//!
//! Names stay: the sweep, the mutants and their reports use them.

/// A rule, by a name that stays.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Rule {
    /// The arm begins to move although the cell is disarmed and no pick-n-place is under way.
    MotionWhileDisarmed,
    /// The vacuum is switched on for a pick-n-place that is not on disk.
    GripBeforeCommit,
    /// The arm begins to move on a state older than 100 ms.
    MotionOnStaleState,
    /// The arm moves for a program that is not the one uploaded last.
    MotionOfOldProgram,
    /// The arm moves two and a half seconds after a stop was reported, or has been at rest since and
    /// moves again.
    MotionAfterStop,
    /// The vacuum is switched off while the tool moves.
    VacuumOffInMotion,
    /// The vacuum is switched off although what is held is not at its place, and no person ordered it.
    VacuumOffAway,
    /// Something is held and the vacuum is not read.
    HeldUnwatched,
    /// An empty tool goes down for a pick, or the vacuum is switched on for it, on a sight older than the
    /// last pick, place, stop or release.
    PickOnOldSight,
    /// An object is gripped that is not where it was picked for, although a hand had moved it before a
    /// picture that shows where it is, or where it was.
    PickOfMoved,
    /// A record is reported to the machine as on disk, and it is not.
    AcknowledgedNotWritten,
    /// An answer says what is not so.
    AnswerNotTrue,
    /// An order was answered twice, or an answer came for none.
    AnswerWithoutOrder,
    /// An order has no answer.
    OrderUnanswered,
    /// The status says armed and the cell is not, or the other way round; or that a disarmed arm rests, and
    /// it moves.
    StatusNotTrue,
    /// Arming was accepted although no state of the robot comes, safety forbids motion, or something is
    /// held.
    ArmedWithGateClosed,
    /// A connection was lost and the cell is armed all the same.
    ArmedThroughLinkLoss,
    /// A safety stop was acknowledged by celld.
    SafetyAcknowledged,
    /// A motion begins although the pendant was switched to local control a while ago.
    MotionInLocalControl,
    /// Power, brakes or a program are ordered of the robot although the cell is disarmed.
    StartedWhileDisarmed,
    /// The arm moves where it lies in itself or in the table, by a model of this loop's own.
    ArmMeets,
    /// The vacuum is switched on for a pick-n-place that no person has approved, in a job that requires it.
    PickWithoutApproval,
    /// The vacuum is switched on for a pick-n-place although the camera sits elsewhere than calibrated, and
    /// a look at the whole table could show it.
    PickUncalibrated,
    /// Gripper, camera or load moves through an object or pushes it, or goes into the table.
    MeetsObject,
    /// Arm, gripper, camera or load is inside of equipment or beyond a safety plane.
    MeetsEquipment,
    /// A joint leaves its configured range under celld's program.
    JointRange,
    /// A joint is faster than configured.
    JointSpeed,
    /// A joint accelerates harder than configured.
    JointAcceleration,
    /// The tool is faster on a line than ordered or configured.
    ToolSpeed,
    /// Something is touched at speed that is neither picked nor put down.
    ContactTooFast,
    /// The flange leaves the calibration box in a calibration round.
    RoundOutsideBox,
    /// The tool is faster than 0.1 m/s in a calibration round.
    RoundTooFast,
    /// The cell stays armed although nothing has moved for longer than `arm_lapse_s`.
    ArmedTooLong,
    /// The cell stays armed although a person guides the arm by hand.
    ArmedThroughGuiding,
    /// The cell stays armed although power or brakes were switched, and not by celld.
    ArmedThroughPower,
    /// The cell is armed, and no person has ordered it.
    ArmedWithoutOrder,
    /// An order that only stops, or the end of celld, is not handed on within 10 ms, or not decided within
    /// 20.
    StopLate,
    /// The status does not say what hangs on the gripper, or says that something does where nothing hangs.
    HeldNotTrue,
    /// A text that is not celld's own reaches a script or the dashboard.
    TextInScript,
    /// Something is under way, and nothing happens for minutes.
    WaitWithoutEnd,
    /// One pick-n-place is begun again and again.
    RetriesWithoutEnd,
    /// An order that does more than stop is carried out although its client had left, or it is older than
    /// 10 s.
    OrderOutOfTime,
    /// An order is refused for its age or its client although it is young and its client waits.
    RefusedInTime,
    /// The cell stays armed although orders have not reached it for longer than a second.
    ArmedCutOff,
    /// The cell stays armed although celld's process stood still for longer than a second.
    ArmedAfterHoldUp,
    /// The recorded run, carried out again, decides something else.
    ReplayDiffers,
}

impl Rule {
    /// All of them.
    pub const ALL: [Rule; 46] = [
        Rule::MotionWhileDisarmed,
        Rule::GripBeforeCommit,
        Rule::MotionOnStaleState,
        Rule::MotionOfOldProgram,
        Rule::MotionAfterStop,
        Rule::VacuumOffInMotion,
        Rule::VacuumOffAway,
        Rule::HeldUnwatched,
        Rule::PickOnOldSight,
        Rule::PickOfMoved,
        Rule::AcknowledgedNotWritten,
        Rule::AnswerNotTrue,
        Rule::AnswerWithoutOrder,
        Rule::OrderUnanswered,
        Rule::StatusNotTrue,
        Rule::ArmedWithGateClosed,
        Rule::ArmedThroughLinkLoss,
        Rule::SafetyAcknowledged,
        Rule::MotionInLocalControl,
        Rule::StartedWhileDisarmed,
        Rule::ArmMeets,
        Rule::PickWithoutApproval,
        Rule::PickUncalibrated,
        Rule::MeetsObject,
        Rule::MeetsEquipment,
        Rule::JointRange,
        Rule::JointSpeed,
        Rule::JointAcceleration,
        Rule::ToolSpeed,
        Rule::ContactTooFast,
        Rule::RoundOutsideBox,
        Rule::RoundTooFast,
        Rule::ArmedTooLong,
        Rule::ArmedThroughGuiding,
        Rule::ArmedThroughPower,
        Rule::ArmedWithoutOrder,
        Rule::StopLate,
        Rule::HeldNotTrue,
        Rule::TextInScript,
        Rule::WaitWithoutEnd,
        Rule::RetriesWithoutEnd,
        Rule::OrderOutOfTime,
        Rule::RefusedInTime,
        Rule::ArmedCutOff,
        Rule::ArmedAfterHoldUp,
        Rule::ReplayDiffers,
    ];
}

/// A rule that was broken.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Breach {
    /// When, in controller frames.
    pub frame: u64,
    /// Which.
    pub rule: Rule,
    /// What was seen.
    pub detail: String,
}
