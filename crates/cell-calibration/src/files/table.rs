//! `table.yaml`: where the table lies under the robot, and the surveyed markers that say so.
//!
//! In: text, or a [`HandEye`] solution with the survey it used. Out: [`TableCalibration`], or complaints;
//! and the text of a new file. The survey is kept with the result: a marker glued elsewhere later shows as a
//! difference from the config. Pure.

use crate::files;
use crate::files::hand_eye::{Provenance, Residuals};
use crate::fit::touch::{Registration, TouchFit};
use crate::fit::{HandEye, TransformStd};
use cell_vision::observe::ReferenceMarker;
use nalgebra::Isometry3;
use rearrange::document::Diagnostics;
use rearrange::document::decode::{At, Decoder, read};
use rearrange::document::write::Out;
use rearrange::geometry::pose::Pose2;

/// The table under the robot.
#[derive(Clone, Debug, PartialEq)]
pub struct TableCalibration {
    /// The table frame in the robot's base frame.
    pub base_from_table: Isometry3<f64>,
    /// How uncertain that is.
    pub std: TransformStd,
    /// The survey it rests on, table frame.
    pub reference_markers: Vec<ReferenceMarker>,
    /// With which devices, and when.
    pub provenance: Provenance,
    /// When the hand-eye calibration beside it was measured; files of earlier versions do not say.
    pub hand_eye_date: Option<String>,
    /// How well the samples fit.
    pub residuals: Residuals,
    /// Present when the tool's tip touched the table too.
    pub touches: Option<Touched>,
}

/// What touching the table added.
#[derive(Clone, Debug, PartialEq)]
pub struct Touched {
    /// Distance of each touch used from its point, m.
    pub residuals_m: Vec<f64>,
    /// How far touches miss along each axis, m.
    pub touch_std_m: f64,
    /// Where touch puts the table's middle less where the camera puts it, table axes, m.
    pub shift_m: [f64; 3],
    /// Angle between the two, rad.
    pub turn_rad: f64,
}

/// Furthest plausible table origin from the robot's base, m.
const REACH_M: f64 = 3.0;

impl TableCalibration {
    /// The file's content from a solution and the survey it used.
    pub fn from_solution(
        solution: &HandEye,
        reference_markers: &[ReferenceMarker],
        provenance: Provenance,
    ) -> TableCalibration {
        TableCalibration {
            base_from_table: solution.base_from_table,
            std: solution.base_from_table_std,
            reference_markers: reference_markers.to_vec(),
            provenance,
            hand_eye_date: None,
            residuals: Residuals::of(solution),
            touches: None,
        }
    }

    /// The same tied to touches: both answers, weighted.
    pub fn tied(self, touch: &TouchFit, tie: &Registration) -> TableCalibration {
        let touched = Touched {
            residuals_m: touch.residuals_m.clone(),
            touch_std_m: touch.touch_std_m,
            shift_m: tie.shift_m.into(),
            turn_rad: tie.turn_rad,
        };
        TableCalibration {
            base_from_table: tie.base_from_table,
            std: tie.std,
            touches: Some(touched),
            ..self
        }
    }

    /// Reads the text of a file; `name` is for the complaints.
    ///
    /// # Errors
    /// Everything that is wrong with it.
    pub fn parse(text: &str, name: &str) -> Result<TableCalibration, Diagnostics> {
        read(text, name, decode)
    }

    /// The text of the file.
    pub fn to_yaml(&self) -> String {
        let markers = Out::List(self.reference_markers.iter().map(marker_out).collect());
        let mut pairs = vec![
            ("version", Out::Integer(files::VERSION)),
            (
                "table",
                Out::map(vec![
                    ("base_from_table", files::transform_out(&self.base_from_table)),
                    ("std_m", files::finite(self.std.translation_m)),
                    ("std_rad", files::finite(self.std.rotation_rad)),
                ]),
            ),
            ("reference_markers", markers),
        ];
        self.provenance.write(&mut pairs);
        if let Some(date) = &self.hand_eye_date {
            pairs.push(("hand_eye_date", Out::Text(date.clone())));
        }
        pairs.push(("residuals", self.residuals.to_out()));
        if let Some(touched) = &self.touches {
            pairs.push(("touches", touched.to_out()));
        }
        let header = "# Table under the robot, by celld calibrate: lengths m, angles rad, rotations as \
                      quaternions x, y, z, w.\n";
        format!("{header}{}", Out::map(pairs).to_yaml(2))
    }
}

fn decode(top: &At, decoder: &mut Decoder) -> Option<TableCalibration> {
    let mut known = vec!["version", "table", "reference_markers", "hand_eye_date", "residuals", "touches"];
    known.extend(Provenance::KEYS);
    let fields = decoder.map(top, &known)?;
    let version = files::check_version(&fields, decoder);
    let placed = fields.required("table", decoder).and_then(|at| placed(&at, decoder));
    let markers = fields.required("reference_markers", decoder).and_then(|at| markers(&at, decoder));
    let provenance = Provenance::decode(&fields, decoder);
    let residuals = fields.required("residuals", decoder).and_then(|at| Residuals::decode(&at, decoder));
    let touches = match fields.optional("touches") {
        Some(at) => touched(&at, decoder).map(Some),
        None => Some(None),
    };
    let hand_eye_date = match fields.optional("hand_eye_date") {
        Some(_) => files::short_text(&fields, "hand_eye_date", decoder).map(Some),
        None => Some(None),
    };
    version?;
    let (base_from_table, std) = placed?;
    Some(TableCalibration {
        base_from_table,
        std,
        reference_markers: markers?,
        provenance: provenance?,
        hand_eye_date: hand_eye_date?,
        residuals: residuals?,
        touches: touches?,
    })
}

impl Touched {
    fn to_out(&self) -> Out {
        Out::map(vec![
            ("residuals_m", Out::numbers(&self.residuals_m)),
            ("touch_std_m", files::finite(self.touch_std_m)),
            ("touch_less_camera_m", Out::numbers(&self.shift_m)),
            ("touch_less_camera_rad", files::finite(self.turn_rad)),
        ])
    }
}

fn touched(at: &At, decoder: &mut Decoder) -> Option<Touched> {
    let known = ["residuals_m", "touch_std_m", "touch_less_camera_m", "touch_less_camera_rad"];
    let fields = decoder.map(at, &known)?;
    let residuals = fields.required(known[0], decoder).and_then(|at| decoder.sequence(&at));
    let residuals = residuals.map(|items| {
        let size = |item| files::at_most(item, files::SAMPLE_M, decoder);
        items.iter().map(size).collect::<Vec<_>>()
    });
    let touch_std_m = files::size(&fields, known[1], files::FIT_M, decoder);
    let shift_m = fields.required(known[2], decoder).and_then(|at| decoder.numbers::<3>(&at));
    let turn_rad = files::size(&fields, known[3], files::FIT_RAD, decoder);
    Some(Touched {
        residuals_m: residuals?.into_iter().collect::<Option<_>>()?,
        touch_std_m: touch_std_m?,
        shift_m: shift_m?,
        turn_rad: turn_rad?,
    })
}

fn placed(at: &At, decoder: &mut Decoder) -> Option<(Isometry3<f64>, TransformStd)> {
    let fields = decoder.map(at, &["base_from_table", "std_m", "std_rad"])?;
    let table = fields.required("base_from_table", decoder);
    let table = table.and_then(|at| files::transform(&at, REACH_M, decoder));
    let std_m = files::size(&fields, "std_m", files::FIT_M, decoder);
    let std_rad = files::size(&fields, "std_rad", files::FIT_RAD, decoder);
    Some((table?, TransformStd { translation_m: std_m?, rotation_rad: std_rad? }))
}

/// Reads a list of reference markers: `[{id, size, pose: [x, y, theta]}]`; ids must differ.
pub fn markers(at: &At, decoder: &mut Decoder) -> Option<Vec<ReferenceMarker>> {
    let items = decoder.sequence(at)?;
    let read: Vec<Option<ReferenceMarker>> = items.iter().map(|item| marker(item, decoder)).collect();
    let markers = read.into_iter().collect::<Option<Vec<_>>>()?;
    let mut seen = std::collections::BTreeSet::new();
    for (item, marker) in items.iter().zip(&markers) {
        if !seen.insert(marker.id) {
            decoder.complain_at(item, format!("marker {} is used twice", marker.id), "give each its own id");
        }
    }
    Some(markers)
}

fn marker(at: &At, decoder: &mut Decoder) -> Option<ReferenceMarker> {
    let fields = decoder.map(at, &["id", "size", "pose", "pose_deg"])?;
    let last = i64::from(cell_values::image::tag36h11::COUNT) - 1;
    let id = fields.required("id", decoder).and_then(|at| decoder.integer(&at, 0..=last));
    let size = fields.required("size", decoder).and_then(|at| decoder.number_in(&at, 0.003..=0.5, "m"));
    let pose = decoder.pose(&fields, "pose")?;
    if pose.is_none() {
        decoder.complain(fields.at(), fields.path(), "key \"pose\" is missing", "add it");
    }
    let [x, y, theta] = pose?;
    Some(ReferenceMarker { id: u32::try_from(id?).ok()?, size: size?, pose: Pose2::new(x, y, theta) })
}

fn marker_out(marker: &ReferenceMarker) -> Out {
    Out::map(vec![
        ("id", Out::Integer(i64::from(marker.id))),
        ("size", Out::Number(marker.size)),
        ("pose", Out::numbers(&[marker.pose.x, marker.pose.y, marker.pose.theta])),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    fn measured() -> TableCalibration {
        TableCalibration {
            base_from_table: Isometry3::new(Vector3::new(-0.25, 0.18, 0.002), Vector3::zeros()),
            std: TransformStd { translation_m: 1e-4, rotation_rad: 2e-4 },
            reference_markers: (0..2)
                .map(|i| ReferenceMarker { id: 500 + i, size: 0.03, pose: Pose2::new(-0.05, 0.1, 0.0) })
                .collect(),
            provenance: Provenance {
                camera_serial: "405".into(),
                robot_serial: "20235500001".into(),
                kinematics_checksum: "0x12ab".into(),
                date: "2026-11-21".into(),
            },
            hand_eye_date: Some("2026-11-20".into()),
            residuals: Residuals {
                reprojection_px_rms: 0.14,
                held_out_rms_m: None,
                held_out_max_m: None,
                halves_m: Some(1e-4),
                halves_rad: Some(1e-4),
            },
            touches: None,
        }
    }

    #[test]
    fn a_file_is_read_back_as_it_was_written() {
        let touched = Touched {
            residuals_m: vec![1e-4, 2.5e-4, 0.0],
            touch_std_m: 3e-4,
            shift_m: [1e-4, -2e-4, 5e-4],
            turn_rad: 1e-3,
        };
        for file in [measured(), TableCalibration { touches: Some(touched), ..measured() }] {
            let text = file.to_yaml();
            assert_eq!(TableCalibration::parse(&text, "table.yaml").unwrap(), file, "{text}");
        }
    }

    #[test]
    fn a_marker_used_twice_and_one_in_millimetres_are_refused() {
        let text = measured().to_yaml().replace("id: 501", "id: 500");
        let reported = TableCalibration::parse(&text, "table.yaml").unwrap_err().to_string();
        assert!(reported.contains("marker 500 is used twice"), "{reported}");
        let text = measured().to_yaml().replace("size: 0.03", "size: 30");
        let reported = TableCalibration::parse(&text, "table.yaml").unwrap_err().to_string();
        assert!(reported.contains("reference_markers[1].size: 30 m is out of range"), "{reported}");
    }
}
