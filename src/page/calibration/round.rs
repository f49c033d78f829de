//! A calibration round: its pictures as they come, and camera and table from them.
//!
//! In: samples with their pictures, the lens, which samples are left out, touches. Out: the three files as
//! data with the error of every sample, and for each picture by how much each reference marker is off. Pure
//! but for the mount of before, which is read from its file.

use crate::config::calibrated::known_mount;
use crate::config::cell::CellConfig;
use crate::config::setup::{drawn, reference_markers};
use crate::page::feed::KnownCell;
use axum::body::Bytes;
use cell_calibration::files::camera::CameraCalibration;
use cell_calibration::files::hand_eye::{Mount, Provenance};
use cell_calibration::files::set::CalibrationSet;
use cell_calibration::files::touches::Touches;
use cell_calibration::fit::solve::Solved;
use cell_calibration::fit::touch::{Registration, RegistrationLimits};
use cell_calibration::fit::{HandEye, Sample, SampleResidual};
use cell_calibration::taken::{Taken, Wanted};
use cell_calibration::tied::FittedTouches;
use cell_machine::supervisor::round::RoundFault;
use cell_values::image::Image;
use cell_values::units::{deg_from_rad, mm_from_m, rad_from_deg};
use cell_vision::annotate::draw_detections;
use cell_vision::marker;
use nalgebra::{Isometry3, Point3};
use rearrange::document::chain::chain;
use serde_json::{Value, json};

/// Of JPEG, for people; what is measured was measured before.
const QUALITY: u8 = 80;

/// How far touch and camera may be apart: as `celld calibrate table` has it.
const TIE_MM: f64 = 1.0;
const TIE_DEG: f64 = 0.2;

/// A round as it is taken.
#[derive(Default)]
pub struct RoundWork {
    samples: Vec<Sample>,
    jpegs: Vec<Bytes>,
    over: Option<Result<(), String>>,
}

impl RoundWork {
    /// The next picture.
    pub fn add(&mut self, mut image: Image, sample: Sample) {
        draw_detections(&mut image, &sample.detections);
        self.jpegs.push(image.encode_jpeg(QUALITY).map(Bytes::from).unwrap_or_default());
        self.samples.push(sample);
    }

    /// Nothing more comes of it.
    pub fn is_over(&self) -> bool {
        self.over.is_some()
    }

    /// It has ended.
    pub fn ended(&mut self, result: Result<(), RoundFault>) {
        self.over = Some(result.map_err(|fault| chain(&fault)));
    }

    /// A picture, by its number from 1.
    pub fn jpeg(&self, number: usize) -> Option<Bytes> {
        self.jpegs.get(number.checked_sub(1)?).cloned()
    }

    /// For the page.
    pub fn view(&self) -> Value {
        let markers: Vec<usize> = self.samples.iter().map(|sample| sample.detections.len()).collect();
        let fault = self.over.as_ref().and_then(|over| over.as_ref().err());
        json!({ "markers": markers, "over": self.over.is_some(), "fault": fault })
    }
}

/// What is wanted of a round.
pub struct Requested<'a> {
    /// Camera and table, or the table alone.
    pub wanted: Wanted,
    /// Samples that are left out, by their numbers from 1.
    pub dropped: &'a [usize],
    /// To be tied to.
    pub touches: Option<&'a Touches>,
    /// The lens to work with.
    pub lens: CameraCalibration,
    /// Now.
    pub date: String,
}

/// Camera and table, not kept yet.
pub struct Solution {
    /// The files as data.
    pub set: CalibrationSet,
    /// For the page.
    pub view: Value,
}

/// Solves a round.
///
/// # Errors
/// Why there is no calibration.
pub fn solve(
    config: &CellConfig,
    known: &KnownCell,
    round: &RoundWork,
    requested: Requested,
) -> Result<Solution, String> {
    let provenance = Provenance {
        camera_serial: requested.lens.model.serial.clone(),
        robot_serial: known.arm.serial.clone(),
        kinematics_checksum: known.arm.checksum.clone(),
        date: requested.date,
    };
    let mut taken = Taken { lens: requested.lens, provenance, samples: round.samples.clone() };
    taken.leave_out(requested.dropped)?;
    let drawn = drawn(config);
    let before = match requested.wanted {
        Wanted::MountAndTable => None,
        Wanted::Table => Some(known_mount(config, &taken.provenance)?),
    };
    let solved = taken.solve(&drawn, before).map_err(|error| chain(&error))?;
    let tied = match requested.touches {
        None => None,
        Some(touches) => Some(tied(config, &taken.provenance, touches, &solved)?),
    };
    let (mount, samples, lens) = (solved.hand_eye.mount, taken.samples.clone(), taken.lens.model.clone());
    let mut view = shown(known, &solved, tied.as_ref().map(|(_, registration)| registration));
    let set = taken.calibrated(
        solved,
        &drawn,
        tied.as_ref().map(|(touched, registration)| (touched.fit(), registration)),
    );
    let marks = |sample: &Sample| {
        let camera = match mount {
            Mount::Flange { flange_from_camera } => sample.base_from_flange * flange_from_camera,
            Mount::Fixed { base_from_camera } => base_from_camera,
        };
        let camera_from_table = camera.inverse() * set.table.base_from_table;
        off_by(sample, config, &camera_from_table, |point| lens.pixel([point.x, point.y, point.z]))
    };
    view["marks"] = json!(samples.iter().map(marks).collect::<Vec<_>>());
    view["what"] = match requested.wanted {
        Wanted::MountAndTable => "camera and table",
        Wanted::Table => "table",
    }
    .into();
    Ok(Solution { set, view })
}

/// The table by touch and camera.
fn tied(
    config: &CellConfig,
    provenance: &Provenance,
    touches: &Touches,
    solved: &Solved,
) -> Result<(FittedTouches, Registration), String> {
    let survey = reference_markers(config);
    let fitted = FittedTouches::new("touches".to_string(), touches.clone(), &[], &survey);
    let fitted = fitted.map_err(|error| error.to_string())?;
    fitted.check_robot(provenance).map_err(|error| error.to_string())?;
    let table_m = [config.workspace.width_m, config.workspace.height_m];
    let limits = RegistrationLimits { shift_m: TIE_MM / 1e3, turn_rad: rad_from_deg(TIE_DEG) };
    let registration = fitted.register(&solved.table, table_m, &limits).map_err(|error| error.to_string())?;
    Ok((fitted, registration))
}

/// By how much each reference marker of a picture is off: where it was found, and how far that is from where
/// the solution has it, pixels.
fn off_by(
    sample: &Sample,
    config: &CellConfig,
    camera_from_table: &Isometry3<f64>,
    pixel: impl Fn(Point3<f64>) -> Option<[f64; 2]>,
) -> Vec<[f64; 4]> {
    let survey = reference_markers(config);
    let one = |found: &cell_vision::detect::Detection| {
        let marker = survey.iter().find(|marker| marker.id == found.id)?;
        let mut sum = [0.0; 4];
        for (seen, corner) in found.corners.iter().zip(marker::corners_m(marker.size)) {
            let [x, y] = marker.pose.transform(corner);
            let at = pixel(camera_from_table * Point3::new(x, y, 0.0))?;
            sum[0] += seen[0] / 4.0;
            sum[1] += seen[1] / 4.0;
            sum[2] += (seen[0] - at[0]) / 4.0;
            sum[3] += (seen[1] - at[1]) / 4.0;
        }
        Some(sum)
    };
    sample.detections.iter().filter_map(one).collect()
}

fn shown(known: &KnownCell, solved: &Solved, registration: Option<&Registration>) -> Value {
    let (camera, table) = (&solved.hand_eye.std, &solved.table.base_from_table_std);
    let before = (known.model.mount, known.model.arm.base_from_table);
    let moved = |a: &Isometry3<f64>, b: &Isometry3<f64>| {
        let between = a.inverse() * b;
        json!({ "mm": mm_from_m(between.translation.vector.norm()), "deg": deg_from_rad(between.rotation.angle()) })
    };
    let camera_moved = match (before.0, solved.hand_eye.mount) {
        (Mount::Flange { flange_from_camera: a }, Mount::Flange { flange_from_camera: b })
        | (Mount::Fixed { base_from_camera: a }, Mount::Fixed { base_from_camera: b }) => Some(moved(&a, &b)),
        _ => None,
    };
    let std = |translation_m: f64, rotation_rad: f64| json!({ "mm": mm_from_m(translation_m), "deg": deg_from_rad(rotation_rad) });
    let registration = registration.map(|registration| {
        json!({
            "shift_mm": registration.shift_m.as_slice().iter().map(|m| mm_from_m(*m)).collect::<Vec<f64>>(),
            "turn_deg": deg_from_rad(registration.turn_rad), "in_std": registration.in_std,
            "std": std(registration.std.translation_m, registration.std.rotation_rad),
        })
    });
    json!({
        "table": fit(&solved.table), "board": solved.board.as_ref().map(fit),
        "camera_std": std(camera.translation_m, camera.rotation_rad),
        "table_std": std(table.translation_m, table.rotation_rad),
        "camera_moved": camera_moved, "table_moved": moved(&before.1, &solved.table.base_from_table),
        "tie": registration,
    })
}

fn fit(solved: &HandEye) -> Value {
    let sample = |sample: &SampleResidual| {
        json!({
            "pose": sample.sample + 1, "markers": sample.markers, "px": sample.residual_px,
            "mm": mm_from_m(sample.residual_m), "rejected": sample.rejected,
        })
    };
    json!({
        "px": solved.reprojection_px_rms, "held_out_mm": solved.held_out_rms_m.map(mm_from_m),
        "held_out_most_mm": solved.held_out_max_m.map(mm_from_m),
        "samples": solved.samples.iter().map(sample).collect::<Vec<Value>>(),
    })
}
