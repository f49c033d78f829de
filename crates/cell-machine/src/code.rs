//! How a job ended in one of four words, [`JobStatus`]; and the result codes: one word for each way in which
//! a job, a job file or an order can end.
//!
//! In: a decision of the cell, of the job folders, or of a restart. Out: [`Code`], its word for files and
//! programs, and where it appears. One enum in place of texts in many files, so that a page, a script and
//! the sweep of faults all know the same words; `docs/results.md` is written from [`Code::ALL`], and a test
//! holds it to that.

use cell_values::image::quality::PictureFault;
use rearrange::document::word::{UnknownWord, named};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// How a job ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum JobStatus {
    /// Every object is at its goal, and the camera says so. Folder `done`.
    Done,
    /// It could not be done. Folder `failed`.
    Failed,
    /// A person ended it. Folder `failed`.
    Cancelled,
    /// It was cut off by a stop, a fault or an end of celld, maybe in motion; the table has to be looked at.
    /// Folder `failed`.
    Interrupted,
}

impl JobStatus {
    /// The word in `result.yaml`.
    pub fn as_str(self) -> &'static str {
        match self {
            JobStatus::Done => "done",
            JobStatus::Failed => "failed",
            JobStatus::Cancelled => "cancelled",
            JobStatus::Interrupted => "interrupted",
        }
    }
}

impl fmt::Display for JobStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

/// Where a code appears.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// `code` in `result.yaml`, in `celld jobs` and in the journal.
    Result,
    /// `code` in a `.reason.yaml` beside a rejected job file.
    Rejection,
}

/// How a job ended, in a word that programs can test.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Deserialize, Serialize)]
#[expect(missing_docs, reason = "each has its sentence in the table below, which is what people read")]
pub enum Code {
    Done,
    Cancelled,
    PlanRejected,
    Aborted,
    Released,
    Shutdown,
    NotReady,
    LinkLost,
    LinkSilent,
    ControllerGone,
    EmergencyStop,
    ProtectiveStop,
    SafeguardStop,
    SafetyMode,
    SafetyFault,
    LocalControl,
    PowerSwitched,
    HandGuided,
    ArmingLapsed,
    ProgramStopped,
    ProgramReplaced,
    ProgramFailed,
    ProgramNotStarted,
    ProgramOverdue,
    HeartbeatLost,
    RobotRefused,
    ProtocolFault,
    ArmStalled,
    JointJump,
    SpeedZero,
    RobotNotStarted,
    OtherRobot,
    PausedTooLong,
    Unreachable,
    LookTimeout,
    WorkTimeout,
    ParkTimeout,
    Unpickable,
    VacuumLost,
    VacuumWeak,
    ObjectStuck,
    GripperUnreachable,
    Infeasible,
    NoArrangement,
    BadStart,
    NoPlan,
    SolverUnfit,
    PlannerStuck,
    TableDisturbed,
    ObjectMissing,
    ObjectTilted,
    ObjectUncertain,
    MarkerTwice,
    UnknownMarker,
    ForeignObject,
    ReferenceHidden,
    CalibrationInvalid,
    DepthMissing,
    DepthPoor,
    TableNotCompared,
    Observation,
    CameraUnplugged,
    CameraFrozen,
    CameraRepeats,
    CameraBrokenPicture,
    CameraDark,
    CameraOverexposed,
    CameraSeesNothing,
    CameraBlurred,
    CameraMisfit,
    CameraBusy,
    RecordingEnded,
    DetectionFailed,
    JournalFailed,
    OrdersUnreachable,
    HeldUp,
    Interrupted,
    InterruptedCarrying,
    Syntax,
    Invalid,
    Incomplete,
    Duplicate,
    IdConflict,
    BadName,
    NotAPlainFile,
    TooLarge,
    NotText,
}

impl Code {
    /// What keeps a picture from being looked at.
    pub fn of_picture(fault: &PictureFault) -> Code {
        match fault {
            PictureFault::Dark { .. } => Code::CameraDark,
            PictureFault::Overexposed { .. } => Code::CameraOverexposed,
            PictureFault::Flat { .. } => Code::CameraSeesNothing,
            PictureFault::Blurred { .. } => Code::CameraBlurred,
        }
    }

    /// Every code, in the order of the table.
    pub const ALL: [Code; TABLE.len()] = {
        assert!(Code::NotText as usize + 1 == TABLE.len(), "the table has every code");
        let mut all = [Code::Done; TABLE.len()];
        let mut at = 0;
        while at < all.len() {
            all[at] = TABLE[at].0;
            assert!(all[at] as usize == at, "the table is in the order of the enum");
            at += 1;
        }
        all
    };

    /// The word in files and tables.
    pub fn as_str(self) -> &'static str {
        self.row().0
    }

    /// What it means, in one sentence.
    pub fn meaning(self) -> &'static str {
        self.row().1
    }

    /// Where it appears.
    pub fn place(self) -> Place {
        TABLE[self as usize].1
    }

    /// Exit code of `celld submit --wait`.
    pub fn exit_code(self) -> u8 {
        match (self, self.place()) {
            (Code::Done, _) => 0,
            (_, Place::Result) => 1,
            (_, Place::Rejection) => 2,
        }
    }

    /// True where the word is followed by a colon and the object's name.
    pub fn names_an_object(self) -> bool {
        matches!(
            self,
            Code::Unpickable
                | Code::ObjectStuck
                | Code::ObjectMissing
                | Code::ObjectTilted
                | Code::ObjectUncertain
        )
    }

    /// The word with the object that it is about, as in `object_missing:lid`.
    pub fn about(self, object: &str) -> String {
        if self.names_an_object() { format!("{self}:{object}") } else { self.to_string() }
    }

    fn row(self) -> (&'static str, &'static str) {
        let (_, _, word, meaning) = TABLE[self as usize];
        (word, meaning)
    }
}

/// Places, words and meanings, in the order of the enum.
const TABLE: [(Code, Place, &str, &str); 87] = [
    (Code::Done, Place::Result, "done", "every object is at its goal, and the camera shows it"),
    (Code::Cancelled, Place::Result, "cancelled", "a person cancelled the job"),
    (Code::PlanRejected, Place::Result, "plan_rejected", "a person rejected the plan"),
    (Code::Aborted, Place::Result, "aborted", "a person stopped the cell"),
    (Code::Released, Place::Result, "released", "a person had the vacuum switched off"),
    (Code::Shutdown, Place::Result, "shutdown", "a person ended celld"),
    (Code::NotReady, Place::Result, "not_ready", "robot or gripper was not ready for 60 s"),
    (Code::LinkLost, Place::Result, "link_lost", "a connection to the controller was lost"),
    (Code::LinkSilent, Place::Result, "link_silent", "the controller stopped answering or sending its state"),
    (
        Code::ControllerGone,
        Place::Result,
        "controller_gone",
        "the controller closed all its connections: it is restarting or was switched off",
    ),
    (Code::EmergencyStop, Place::Result, "emergency_stop", "an emergency stop was pressed"),
    (Code::ProtectiveStop, Place::Result, "protective_stop", "the arm went into a protective stop"),
    (Code::SafeguardStop, Place::Result, "safeguard_stop", "a safeguard was opened"),
    (
        Code::SafetyMode,
        Place::Result,
        "safety_mode",
        "the safety system is in another mode without motion, known or not",
    ),
    (Code::SafetyFault, Place::Result, "safety_fault", "the safety system failed"),
    (Code::LocalControl, Place::Result, "local_control", "the pendant was switched to local control"),
    (
        Code::PowerSwitched,
        Place::Result,
        "power_switched",
        "power or brakes of the arm were switched by others",
    ),
    (Code::HandGuided, Place::Result, "hand_guided", "a person guided the arm by hand"),
    (
        Code::ArmingLapsed,
        Place::Result,
        "arming_lapsed",
        "arming lapsed while a motion was held, or on a way back",
    ),
    (Code::ProgramStopped, Place::Result, "program_stopped", "the on-robot program was stopped from outside"),
    (Code::ProgramReplaced, Place::Result, "program_replaced", "another program took the place of celld's"),
    (
        Code::ProgramFailed,
        Place::Result,
        "program_failed",
        "the on-robot program met an error or refused a command",
    ),
    (Code::ProgramNotStarted, Place::Result, "program_not_started", "the on-robot program did not start"),
    (
        Code::ProgramOverdue,
        Place::Result,
        "program_overdue",
        "the on-robot program did not do in time what was ordered",
    ),
    (Code::HeartbeatLost, Place::Result, "heartbeat_lost", "the robot missed celld's heartbeat"),
    (Code::RobotRefused, Place::Result, "robot_refused", "the controller refused a request"),
    (
        Code::ProtocolFault,
        Place::Result,
        "protocol_fault",
        "the controller sent what its protocol does not have",
    ),
    (Code::ArmStalled, Place::Result, "arm_stalled", "the arm does not follow its path"),
    (
        Code::JointJump,
        Place::Result,
        "joint_jump",
        "a joint was reported where it cannot have turned to so soon",
    ),
    (
        Code::SpeedZero,
        Place::Result,
        "speed_zero",
        "the speed slider was at zero for over 30 s in the middle of a motion",
    ),
    (
        Code::RobotNotStarted,
        Place::Result,
        "robot_not_started",
        "power, brakes or the on-robot program did not come up in time",
    ),
    (
        Code::OtherRobot,
        Place::Result,
        "other_robot",
        "another robot, or the same with another calibration, answers",
    ),
    (
        Code::PausedTooLong,
        Place::Result,
        "paused_too_long",
        "the program was held in the middle of a motion for over 30 s",
    ),
    (Code::Unreachable, Place::Result, "unreachable", "a look pose, a pick or a place cannot be reached"),
    (Code::LookTimeout, Place::Result, "look_timeout", "a look was not finished in time"),
    (Code::WorkTimeout, Place::Result, "work_timeout", "a phase of a pick-n-place was not finished in time"),
    (Code::ParkTimeout, Place::Result, "park_timeout", "the park pose was not reached in time"),
    (Code::Unpickable, Place::Result, "unpickable", "an object could not be gripped"),
    (Code::VacuumLost, Place::Result, "vacuum_lost", "an object was lost on the way"),
    (Code::VacuumWeak, Place::Result, "vacuum_weak", "the vacuum fell while an object was carried"),
    (
        Code::ObjectStuck,
        Place::Result,
        "object_stuck",
        "an object was let go and hangs on the cups, as far as can be seen",
    ),
    (Code::GripperUnreachable, Place::Result, "gripper_unreachable", "gripper not responding"),
    (Code::Infeasible, Place::Result, "infeasible", "it is proved that there is no plan"),
    (
        Code::NoArrangement,
        Place::Result,
        "no_arrangement",
        "no arrangement was found that follows the goal's rule on the table as it is",
    ),
    (Code::BadStart, Place::Result, "bad_start", "the measured table is no valid start"),
    (Code::NoPlan, Place::Result, "no_plan", "no plan was found in time"),
    (Code::SolverUnfit, Place::Result, "solver_unfit", "the chosen solver does not solve this kind of job"),
    (
        Code::PlannerStuck,
        Place::Result,
        "planner_stuck",
        "the planner failed, or did not answer within its budget",
    ),
    (Code::TableDisturbed, Place::Result, "table_disturbed", "the table disagreed with the plan too often"),
    (Code::ObjectMissing, Place::Result, "object_missing", "an object that is needed is not seen"),
    (Code::ObjectTilted, Place::Result, "object_tilted", "an object does not lie flat"),
    (Code::ObjectUncertain, Place::Result, "object_uncertain", "an object was not measured well enough"),
    (Code::MarkerTwice, Place::Result, "marker_twice", "one marker was seen in two places"),
    (Code::UnknownMarker, Place::Result, "unknown_marker", "a marker belongs to nothing that the cell knows"),
    (Code::ForeignObject, Place::Result, "foreign_object", "something without a marker is on the table"),
    (Code::ReferenceHidden, Place::Result, "reference_hidden", "too few reference markers were seen"),
    (
        Code::CalibrationInvalid,
        Place::Result,
        "calibration_invalid",
        "the reference markers are not where they were surveyed",
    ),
    (Code::DepthMissing, Place::Result, "depth_missing", "the look came without depth"),
    (Code::DepthPoor, Place::Result, "depth_poor", "depth shows too little of the table"),
    (
        Code::TableNotCompared,
        Place::Result,
        "table_not_compared",
        "the look could not be compared with the empty table",
    ),
    (Code::Observation, Place::Result, "observation", "the views of a look could not be put together"),
    (Code::CameraUnplugged, Place::Result, "camera_unplugged", "the camera does not answer"),
    (Code::CameraFrozen, Place::Result, "camera_frozen", "the camera repeats its last frame"),
    (Code::CameraRepeats, Place::Result, "camera_repeats", "the camera sends the same picture as new frames"),
    (
        Code::CameraBrokenPicture,
        Place::Result,
        "camera_broken_picture",
        "what the camera sends is no picture",
    ),
    (Code::CameraDark, Place::Result, "camera_dark", "the picture is too dark"),
    (Code::CameraOverexposed, Place::Result, "camera_overexposed", "the picture is overexposed"),
    (Code::CameraSeesNothing, Place::Result, "camera_sees_nothing", "the picture shows nothing: a lid, fog"),
    (Code::CameraBlurred, Place::Result, "camera_blurred", "the picture is blurred"),
    (
        Code::CameraMisfit,
        Place::Result,
        "camera_misfit",
        "camera, picture size or settings are not the configured ones",
    ),
    (Code::CameraBusy, Place::Result, "camera_busy", "perception still works on an earlier request"),
    (
        Code::RecordingEnded,
        Place::Result,
        "recording_ended",
        "the recording that stands in for a camera is over",
    ),
    (Code::DetectionFailed, Place::Result, "detection_failed", "the marker detector failed"),
    (Code::JournalFailed, Place::Result, "journal_failed", "the journal cannot be written"),
    (Code::OrdersUnreachable, Place::Result, "orders_unreachable", "orders did not reach celld for 1 s"),
    (Code::HeldUp, Place::Result, "held_up", "celld itself was stopped or held up for more than 1 s"),
    (
        Code::Interrupted,
        Place::Result,
        "interrupted",
        "celld ended during a step; how far the motion got is not known",
    ),
    (
        Code::InterruptedCarrying,
        Place::Result,
        "interrupted_carrying",
        "celld ended while an object was on the gripper",
    ),
    (Code::Syntax, Place::Rejection, "syntax", "the file is no YAML"),
    (Code::Invalid, Place::Rejection, "invalid", "the file's content is wrong"),
    (Code::Incomplete, Place::Rejection, "incomplete", "the file ends in the middle"),
    (Code::Duplicate, Place::Rejection, "duplicate", "the same job is known already"),
    (Code::IdConflict, Place::Rejection, "id_conflict", "another job has this id"),
    (
        Code::BadName,
        Place::Rejection,
        "bad_name",
        "the file's name has characters that job files may not have",
    ),
    (
        Code::NotAPlainFile,
        Place::Rejection,
        "not_a_plain_file",
        "a link, folder, pipe or a file with a second name",
    ),
    (Code::TooLarge, Place::Rejection, "too_large", "the file is too large"),
    (Code::NotText, Place::Rejection, "not_text", "the file is not UTF-8 text"),
];

impl fmt::Display for Code {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

impl FromStr for Code {
    type Err = UnknownWord;

    /// The code of a word, with or without an object.
    fn from_str(text: &str) -> Result<Code, UnknownWord> {
        named(text.split(':').next().unwrap_or(text), &Code::ALL, Code::as_str)
    }
}

/// The table of `docs/results.md`.
pub fn table() -> String {
    let mut text = String::from("| code | where | exit code | meaning |\n|---|---|---|---|\n");
    for code in Code::ALL {
        let place = match code.place() {
            Place::Result => "result",
            Place::Rejection => "rejection",
        };
        let object = if code.names_an_object() { ":OBJECT" } else { "" };
        let (word, exit, meaning) = (code.as_str(), code.exit_code(), code.meaning());
        text.push_str(&format!("| `{word}{object}` | {place} | {exit} | {meaning} |\n"));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    const PAGE: &str = include_str!("../../../docs/results.md");

    #[test]
    fn every_word_is_one_code_and_reads_back() {
        let words: BTreeSet<&str> = Code::ALL.into_iter().map(Code::as_str).collect();
        assert_eq!(words.len(), Code::ALL.len());
        for code in Code::ALL {
            assert_eq!(code.about("lid").parse::<Code>(), Ok(code));
            assert!(code.as_str().bytes().all(|byte| byte.is_ascii_lowercase() || byte == b'_'), "{code}");
        }
        assert_eq!(Code::ObjectMissing.about("lid"), "object_missing:lid");
        assert_eq!(Code::Aborted.about("lid"), "aborted");
        assert!("E_GRIP".parse::<Code>().is_err());
    }

    #[test]
    fn the_page_has_the_table() {
        assert!(PAGE.ends_with(&table()), "docs/results.md should end with:\n{}", table());
    }
}
