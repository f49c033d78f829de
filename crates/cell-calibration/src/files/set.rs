//! The three calibration files together: parsed, checked against each other, the cell as drawn and the arm.
//!
//! In: the texts of the files. Out: [`CalibrationSet`], or every complaint about all three at once. A
//! calibration is only as good as the agreement of camera, hand and table: files of different rounds, of
//! another camera or arm, or of markers that have been moved since are refused. Pure.

use crate::drawn::CameraMount;
use crate::files::camera::CameraCalibration;
use crate::files::hand_eye::HandEyeCalibration;
use crate::files::table::TableCalibration;
use cell_vision::observe::ReferenceMarker;
use rearrange::document::Diagnostics;

/// Distance (m) and angle (rad) by which a survey may differ from the configuration's: rounding in the
/// files.
const SAME_PLACE: (f64, f64) = (1e-6, 1e-6);

/// Camera, hand-eye and table of one calibration round.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibrationSet {
    /// The lens.
    pub camera: CameraCalibration,
    /// Where the camera sits.
    pub hand_eye: HandEyeCalibration,
    /// The table under the robot.
    pub table: TableCalibration,
}

/// One of the three files.
#[derive(Clone, Debug)]
pub struct FileText {
    /// Its name, for the complaints.
    pub name: String,
    /// What is in it, or the sentence that says why it could not be read.
    pub text: Result<String, String>,
}

impl CalibrationSet {
    /// Judges the texts of camera, hand-eye and table file, for the cell with this mount and survey.
    ///
    /// # Errors
    /// Everything that is wrong with any of them, one complaint a line.
    pub fn parse(
        [camera, hand_eye, table]: &[FileText; 3],
        mount: &CameraMount,
        survey: &[ReferenceMarker],
    ) -> Result<CalibrationSet, String> {
        let parsed = (
            camera.parse(CameraCalibration::parse),
            hand_eye.parse(HandEyeCalibration::parse),
            table.parse(TableCalibration::parse),
        );
        let (set, names) = match parsed {
            (Ok(camera), Ok(of_hand), Ok(of_table)) => {
                let set = CalibrationSet { camera, hand_eye: of_hand, table: of_table };
                (set, [&*hand_eye.name, &*table.name])
            }
            (camera, hand_eye, table) => {
                let faults = [camera.err(), hand_eye.err(), table.err()];
                return Err(faults.into_iter().flatten().collect::<Vec<_>>().join("\n"));
            }
        };
        let faults = set.faults(names, mount, survey);
        if faults.is_empty() { Ok(set) } else { Err(faults.join("\n")) }
    }

    /// What does not fit together; the names are those of the hand-eye and the table file.
    fn faults(
        &self,
        [hand_eye, table]: [&str; 2],
        mount: &CameraMount,
        survey: &[ReferenceMarker],
    ) -> Vec<String> {
        let mut faults = Vec::new();
        let mut differ = |name: &str, what: &str, made_with: &str, now: &str| {
            if made_with != now {
                faults.push(format!(
                    "{name}: made with {what} {made_with}, now it is {now}; run `celld calibrate`"
                ));
            }
        };
        differ(hand_eye, "mount", self.hand_eye.mount.as_str(), mount.as_str());
        let (hand, flat) = (&self.hand_eye.provenance, &self.table.provenance);
        differ(hand_eye, "camera", &hand.camera_serial, &self.camera.model.serial);
        differ(table, "camera", &flat.camera_serial, &self.camera.model.serial);
        differ(table, "robot", &flat.robot_serial, &hand.robot_serial);
        differ(table, "kinematics", &flat.kinematics_checksum, &hand.kinematics_checksum);
        // Written one after the other: a power cut in between leaves files of two rounds, which look alike.
        let beside = self.table.hand_eye_date.as_ref().unwrap_or(&hand.date);
        differ(table, "a hand-eye calibration of", beside, &hand.date);
        if !same_survey(&self.table.reference_markers, survey) {
            faults.push(format!(
                "{table}: made with other reference markers than the configuration's; run `celld calibrate`"
            ));
        }
        faults
    }

    /// That the calibration was made with the arm of this serial number and kinematics checksum; `name` is
    /// the hand-eye file's.
    ///
    /// # Errors
    /// A sentence that names both arms.
    pub fn check_arm(&self, name: &str, serial: &str, checksum: &str) -> Result<(), String> {
        let made_with = &self.hand_eye.provenance;
        if made_with.robot_serial == serial && made_with.kinematics_checksum == checksum {
            return Ok(());
        }
        Err(format!(
            "{name}: made with robot {} (kinematics {}), but this is {serial} ({checksum}); run `celld \
             calibrate`",
            made_with.robot_serial, made_with.kinematics_checksum
        ))
    }
}

impl FileText {
    fn parse<T>(&self, parse: impl Fn(&str, &str) -> Result<T, Diagnostics>) -> Result<T, String> {
        let text = self.text.as_ref().map_err(|reason| {
            format!("{}: {reason}; `celld calibrate` makes the calibration files", self.name)
        })?;
        parse(text, &self.name).map_err(|complaints| complaints.to_string())
    }
}

fn same_survey(made_with: &[ReferenceMarker], now: &[ReferenceMarker]) -> bool {
    let same = |a: &ReferenceMarker, b: &ReferenceMarker| {
        let (distance, angle) = SAME_PLACE;
        a.id == b.id
            && (a.size - b.size).abs() <= distance
            && a.pose.distance(&b.pose) <= distance
            && a.pose.angle_difference(&b.pose) <= angle
    };
    made_with.len() == now.len() && made_with.iter().all(|a| now.iter().any(|b| same(a, b)))
}
