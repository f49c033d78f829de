//! `hand_eye.yaml`: where the camera sits, on the flange or fixed over the table, with every sample's error.
//!
//! In: text, or a [`HandEye`] or [`FixedCamera`] solution and the devices it was made with. Out:
//! [`HandEyeCalibration`], or complaints; and the text of a new file. Camera and robot serial numbers and
//! the checksum of the robot's kinematics show when it no longer holds. Pure.

use crate::drawn::CameraMount;
use crate::files;
use crate::files::{FIT_M, FIT_PX, FIT_RAD, SAMPLE_M, SAMPLE_PX};
use crate::fit::fixed::FixedCamera;
use crate::fit::{HandEye, SampleResidual, TransformStd};
use nalgebra::Isometry3;
use rearrange::document::Diagnostics;
use rearrange::document::decode::{At, Decoder, Fields, read};
use rearrange::document::write::Out;
use serde::{Deserialize, Serialize};

/// The devices a calibration belongs to, and when it was made.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Provenance {
    /// Serial number of the camera.
    pub camera_serial: String,
    /// Serial number of the robot.
    pub robot_serial: String,
    /// Checksum of the robot's calibrated kinematics, as the controller reports it.
    pub kinematics_checksum: String,
    /// When the samples were taken.
    pub date: String,
}

impl Provenance {
    /// True when camera, robot and its kinematics are the same.
    pub fn same_devices(&self, other: &Provenance) -> bool {
        self.camera_serial == other.camera_serial
            && self.robot_serial == other.robot_serial
            && self.kinematics_checksum == other.kinematics_checksum
    }
}

/// How well the samples fit, as in [`HandEye`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Residuals {
    /// Root mean square corner error, pixels.
    pub reprojection_px_rms: f64,
    /// Root mean square error on the table of samples that were not used, m.
    pub held_out_rms_m: Option<f64>,
    /// Largest of them, m.
    pub held_out_max_m: Option<f64>,
    /// Between fits to two halves, m.
    pub halves_m: Option<f64>,
    /// Between fits to two halves, rad.
    pub halves_rad: Option<f64>,
}

/// Where a camera sits.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
pub enum Mount {
    /// On the wrist.
    Flange {
        /// The camera in the flange frame.
        flange_from_camera: Isometry3<f64>,
    },
    /// Over the table; it never moves.
    Fixed {
        /// The camera in the robot's base frame.
        base_from_camera: Isometry3<f64>,
    },
}

impl Mount {
    /// The word for it in files.
    pub fn as_str(&self) -> &'static str {
        match self {
            Mount::Flange { .. } => "flange",
            Mount::Fixed { .. } => "fixed",
        }
    }

    /// The camera in the flange frame, where it is on the wrist.
    pub fn flange_from_camera(&self) -> Option<Isometry3<f64>> {
        match self {
            Mount::Flange { flange_from_camera } => Some(*flange_from_camera),
            Mount::Fixed { .. } => None,
        }
    }

    /// The camera in the base with the flange at `base_from_flange`.
    pub fn base_from_camera(&self, base_from_flange: &Isometry3<f64>) -> Isometry3<f64> {
        match self {
            Mount::Flange { flange_from_camera } => base_from_flange * flange_from_camera,
            Mount::Fixed { base_from_camera } => *base_from_camera,
        }
    }

    fn transform(&self) -> (&'static str, &Isometry3<f64>) {
        match self {
            Mount::Flange { flange_from_camera } => ("flange_from_camera", flange_from_camera),
            Mount::Fixed { base_from_camera } => ("base_from_camera", base_from_camera),
        }
    }
}

/// The camera's place.
#[derive(Clone, Debug, PartialEq)]
pub struct HandEyeCalibration {
    /// Where the camera sits.
    pub mount: Mount,
    /// How uncertain that is.
    pub std: TransformStd,
    /// Whose it is and when.
    pub provenance: Provenance,
    /// How well the samples fit.
    pub residuals: Residuals,
    /// Every sample's error.
    pub samples: Vec<SampleResidual>,
}

/// Furthest plausible camera from the flange, m.
const REACH_M: f64 = 0.5;

/// Furthest plausible fixed camera from the robot's base, m.
const FIXED_REACH_M: f64 = 5.0;

impl HandEyeCalibration {
    /// The file's content from a solution.
    pub fn from_solution(solution: &HandEye, provenance: Provenance) -> HandEyeCalibration {
        HandEyeCalibration {
            mount: Mount::Flange { flange_from_camera: solution.flange_from_camera },
            std: solution.flange_from_camera_std,
            provenance,
            residuals: Residuals::of(solution),
            samples: solution.samples.clone(),
        }
    }

    /// The file's content for a fixed camera.
    pub fn from_fixed(solution: &FixedCamera, provenance: Provenance) -> HandEyeCalibration {
        HandEyeCalibration {
            mount: Mount::Fixed { base_from_camera: solution.base_from_camera() },
            std: solution.base_from_camera_std(),
            provenance,
            residuals: Residuals::of(&solution.hand),
            samples: solution.hand.samples.clone(),
        }
    }

    /// That it is of a camera with this mount, and of camera and robot as they are `now`; `name` is the
    /// file's.
    ///
    /// # Errors
    /// A sentence that says how they differ.
    pub fn check_devices(&self, name: &str, mount: &CameraMount, now: &Provenance) -> Result<(), String> {
        let (made, wanted) = (&self.provenance, mount.as_str());
        if self.mount.as_str() != wanted {
            return Err(format!(
                "{name}: made with `mount: {}`, but the configuration says {wanted}; run `celld calibrate \
                 hand-eye`",
                self.mount.as_str()
            ));
        }
        if made.same_devices(now) {
            return Ok(());
        }
        Err(format!(
            "{name}: made with camera {} on robot {}, but this is {} on {}; run `celld calibrate hand-eye`",
            made.camera_serial, made.robot_serial, now.camera_serial, now.robot_serial
        ))
    }

    /// Reads the text of a file; `name` is for the complaints.
    ///
    /// # Errors
    /// Everything that is wrong with it.
    pub fn parse(text: &str, name: &str) -> Result<HandEyeCalibration, Diagnostics> {
        read(text, name, decode)
    }

    /// The text of the file.
    pub fn to_yaml(&self) -> String {
        let (key, transform) = self.mount.transform();
        let mut pairs = vec![
            ("version", Out::Integer(files::VERSION)),
            (
                "hand_eye",
                Out::map(vec![
                    ("mount", Out::Text(self.mount.as_str().to_owned())),
                    (key, files::transform_out(transform)),
                    ("std_m", files::finite(self.std.translation_m)),
                    ("std_rad", files::finite(self.std.rotation_rad)),
                ]),
            ),
        ];
        self.provenance.write(&mut pairs);
        pairs.push(("residuals", self.residuals.to_out()));
        pairs.push(("samples", Out::List(self.samples.iter().map(sample_out).collect())));
        let header = "# Where the camera sits, by celld calibrate: lengths m, angles rad, rotations as \
                      quaternions x, y, z, w.\n";
        format!("{header}{}", Out::map(pairs).to_yaml(2))
    }
}

impl Provenance {
    /// Keys this adds at the top level of a file.
    pub const KEYS: [&str; 4] = ["camera_serial", "robot_serial", "kinematics_checksum", "date"];

    /// Reads the keys.
    pub fn decode(fields: &Fields, decoder: &mut Decoder) -> Option<Provenance> {
        let [camera, robot, kinematics, date] =
            Provenance::KEYS.map(|key| files::short_text(fields, key, decoder));
        Some(Provenance {
            camera_serial: camera?,
            robot_serial: robot?,
            kinematics_checksum: kinematics?,
            date: date?,
        })
    }

    /// Adds the keys.
    pub fn write(&self, pairs: &mut Vec<(&str, Out)>) {
        let values = [&self.camera_serial, &self.robot_serial, &self.kinematics_checksum, &self.date];
        pairs.extend(Provenance::KEYS.into_iter().zip(values).map(|(key, v)| (key, Out::Text(v.clone()))));
    }
}

impl Residuals {
    /// The residuals of a solution.
    pub fn of(solution: &HandEye) -> Residuals {
        Residuals {
            reprojection_px_rms: solution.reprojection_px_rms,
            held_out_rms_m: solution.held_out_rms_m,
            held_out_max_m: solution.held_out_max_m,
            halves_m: solution.halves_m,
            halves_rad: solution.halves_rad,
        }
    }

    /// Reads the map.
    pub fn decode(at: &At, decoder: &mut Decoder) -> Option<Residuals> {
        let keys = ["reprojection_px_rms", "held_out_rms_m", "held_out_max_m", "halves_m", "halves_rad"];
        let fields = decoder.map(at, &keys)?;
        let reprojection = files::size(&fields, keys[0], FIT_PX, decoder);
        let mut optional = |key, most| files::optional_size(&fields, key, most, decoder);
        let (rms, max) = (optional(keys[1], FIT_M), optional(keys[2], SAMPLE_M));
        let (halves, turn) = (optional(keys[3], FIT_M), optional(keys[4], FIT_RAD));
        Some(Residuals {
            reprojection_px_rms: reprojection?,
            held_out_rms_m: rms?,
            held_out_max_m: max?,
            halves_m: halves?,
            halves_rad: turn?,
        })
    }

    /// The map.
    pub fn to_out(self) -> Out {
        let mut pairs = vec![("reprojection_px_rms", files::finite(self.reprojection_px_rms))];
        files::push_number(&mut pairs, "held_out_rms_m", self.held_out_rms_m);
        files::push_number(&mut pairs, "held_out_max_m", self.held_out_max_m);
        files::push_number(&mut pairs, "halves_m", self.halves_m);
        files::push_number(&mut pairs, "halves_rad", self.halves_rad);
        Out::map(pairs)
    }
}

fn decode(top: &At, decoder: &mut Decoder) -> Option<HandEyeCalibration> {
    let mut known = vec!["version", "hand_eye", "residuals", "samples"];
    known.extend(Provenance::KEYS);
    let fields = decoder.map(top, &known)?;
    let version = files::check_version(&fields, decoder);
    let placed = fields.required("hand_eye", decoder).and_then(|at| placed(&at, decoder));
    let provenance = Provenance::decode(&fields, decoder);
    let residuals = fields.required("residuals", decoder).and_then(|at| Residuals::decode(&at, decoder));
    let samples = match fields.required("samples", decoder).and_then(|at| decoder.sequence(&at)) {
        Some(items) => items.iter().map(|item| sample(item, decoder)).collect::<Vec<_>>(),
        None => vec![None],
    };
    version?;
    let (mount, std) = placed?;
    Some(HandEyeCalibration {
        mount,
        std,
        provenance: provenance?,
        residuals: residuals?,
        samples: samples.into_iter().collect::<Option<_>>()?,
    })
}

fn placed(at: &At, decoder: &mut Decoder) -> Option<(Mount, TransformStd)> {
    // Files from before there were fixed cameras do not say: they are of the flange.
    let fixed = match decoder.open_map(at)?.optional("mount") {
        Some(at) => decoder.choice(&at, &[("flange", false), ("fixed", true)])?,
        None => false,
    };
    let key = if fixed { "base_from_camera" } else { "flange_from_camera" };
    let fields = decoder.map(at, &["mount", key, "std_m", "std_rad"])?;
    let camera = fields.required(key, decoder);
    let reach = if fixed { FIXED_REACH_M } else { REACH_M };
    let camera = camera.and_then(|at| files::transform(&at, reach, decoder));
    let std_m = files::size(&fields, "std_m", files::FIT_M, decoder);
    let std_rad = files::size(&fields, "std_rad", files::FIT_RAD, decoder);
    let mount = match (camera?, fixed) {
        (base_from_camera, true) => Mount::Fixed { base_from_camera },
        (flange_from_camera, false) => Mount::Flange { flange_from_camera },
    };
    Some((mount, TransformStd { translation_m: std_m?, rotation_rad: std_rad? }))
}

fn sample(at: &At, decoder: &mut Decoder) -> Option<SampleResidual> {
    let keys = ["sample", "markers", "residual_px", "residual_m", "held_out_m", "rejected"];
    let fields = decoder.map(at, &keys)?;
    let [sample, markers] = ["sample", "markers"].map(|key| {
        let at = fields.required(key, decoder)?;
        decoder.integer(&at, 0..=1_000_000).and_then(|value| usize::try_from(value).ok())
    });
    let rejected = fields.required("rejected", decoder).and_then(|at| decoder.boolean(&at));
    let most = |most| if rejected == Some(false) { most } else { files::unlimited(most) };
    let residual_px = files::size(&fields, "residual_px", most(SAMPLE_PX), decoder);
    let residual_m = files::size(&fields, "residual_m", most(SAMPLE_M), decoder);
    let held_out_m = files::optional_size(&fields, "held_out_m", most(SAMPLE_M), decoder);
    Some(SampleResidual {
        sample: sample?,
        markers: markers?,
        residual_px: residual_px?,
        residual_m: residual_m?,
        held_out_m: held_out_m?,
        rejected: rejected?,
    })
}

fn sample_out(sample: &SampleResidual) -> Out {
    let mut pairs = vec![
        ("sample", files::counted(sample.sample)),
        ("markers", files::counted(sample.markers)),
        ("residual_px", files::finite(sample.residual_px)),
        ("residual_m", files::finite(sample.residual_m)),
    ];
    files::push_number(&mut pairs, "held_out_m", sample.held_out_m);
    pairs.push(("rejected", Out::Boolean(sample.rejected)));
    Out::map(pairs)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    fn measured() -> HandEyeCalibration {
        let sample = |index: usize| SampleResidual {
            sample: index,
            markers: 4,
            residual_px: 0.1,
            residual_m: 1.2e-4,
            held_out_m: (index != 1).then_some(2e-4),
            rejected: index == 1,
        };
        HandEyeCalibration {
            mount: Mount::Flange {
                flange_from_camera: Isometry3::new(
                    Vector3::new(0.001, -0.07, 0.03),
                    Vector3::new(0.01, 0.02, 0.03),
                ),
            },
            std: TransformStd { translation_m: 1e-4, rotation_rad: 2e-4 },
            provenance: Provenance {
                camera_serial: "405".into(),
                robot_serial: "20235500001".into(),
                kinematics_checksum: "0x12ab".into(),
                date: "2026-11-21".into(),
            },
            residuals: Residuals {
                reprojection_px_rms: 0.14,
                held_out_rms_m: Some(1.5e-4),
                held_out_max_m: Some(3e-4),
                halves_m: None,
                halves_rad: None,
            },
            samples: (0..3).map(sample).collect(),
        }
    }

    #[test]
    fn a_file_is_read_back_as_it_was_written() {
        let fixed = Mount::Fixed {
            base_from_camera: Isometry3::new(Vector3::new(0.1, 0.6, 1.3), Vector3::new(3.0, 0.02, 0.1)),
        };
        for file in [measured(), HandEyeCalibration { mount: fixed, ..measured() }] {
            let text = file.to_yaml();
            let back = HandEyeCalibration::parse(&text, "hand_eye.yaml").unwrap();
            let (there, here) = (back.mount.transform(), file.mount.transform());
            assert!(there.0 == here.0 && there.1.rotation.angle_to(&here.1.rotation) < 1e-12);
            assert!((there.1.translation.vector - here.1.translation.vector).norm() == 0.0);
            assert_eq!(HandEyeCalibration { mount: file.mount, ..back }, file, "{text}");
            assert!(text.contains(&format!("mount: {}", file.mount.as_str())), "{text}");
        }
    }

    #[test]
    fn a_mount_and_a_transform_that_do_not_fit_are_refused() {
        let text = measured().to_yaml();
        let reported = |text: &str| HandEyeCalibration::parse(text, "h.yaml").unwrap_err().to_string();
        assert!(reported(&text.replace("mount: flange", "mount: fixed")).contains("base_from_camera"));
        assert!(reported(&text.replace("mount: flange", "mount: wall")).contains("wall"));
        let old = text.replace("  mount: flange\n", "");
        assert_ne!(old, text);
        let old = HandEyeCalibration::parse(&old, "h.yaml").unwrap();
        assert!(matches!(old.mount, Mount::Flange { .. }), "a file from before there were fixed cameras");
    }

    #[test]
    fn errors_too_large_to_work_with_are_refused_where_they_stand() {
        let wrong = |change: fn(&mut HandEyeCalibration)| {
            let mut file = measured();
            change(&mut file);
            HandEyeCalibration::parse(&file.to_yaml(), "h.yaml").map_err(|faults| faults.to_string())
        };
        let reported = wrong(|file| file.std.translation_m = f64::INFINITY).unwrap_err();
        assert!(
            reported.contains("hand_eye.std_m: 1.798e308 m is too large")
                && reported.contains("calibrate again"),
            "{reported}"
        );
        assert!(wrong(|file| file.std.translation_m = 0.0051).is_err());
        assert!(wrong(|file| file.std.rotation_rad = 0.02).unwrap_err().contains("hand_eye.std_rad"));
        assert!(wrong(|file| file.residuals.reprojection_px_rms = 6.0).is_err());
        assert!(wrong(|file| file.residuals.held_out_max_m = Some(0.03)).is_err());
        assert!(wrong(|file| file.residuals.halves_rad = Some(0.1)).is_err());
        assert!(
            wrong(|file| file.samples[0].residual_m = 0.03).unwrap_err().contains("samples[0].residual_m")
        );
        assert!(
            wrong(|file| file.samples[1].residual_m = f64::INFINITY).is_ok(),
            "it was left out of the fit"
        );
    }

    #[test]
    fn the_files_of_the_simulated_cell_are_good() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../calibration/sim");
        let text = |name: &str| std::fs::read_to_string(folder.join(name)).unwrap();
        HandEyeCalibration::parse(&text("hand_eye.yaml"), "hand_eye.yaml").unwrap();
        files::table::TableCalibration::parse(&text("table.yaml"), "table.yaml").unwrap();
        files::camera::CameraCalibration::parse(&text("camera.yaml"), "camera.yaml").unwrap();
    }

    #[test]
    fn a_camera_without_serial_or_in_millimetres_is_refused() {
        let text = measured().to_yaml().replace("-0.07", "-70").replace("camera_serial", "camera_serail");
        let reported = HandEyeCalibration::parse(&text, "h.yaml").unwrap_err().to_string();
        assert!(
            reported.contains("not millimetres") && reported.contains("did you mean \"camera_serial\""),
            "{reported}"
        );
        let text = measured().to_yaml().replace("residual_px: 0.1", "residual_px: .nan");
        let reported = HandEyeCalibration::parse(&text, "h.yaml").unwrap_err().to_string();
        assert!(
            reported.contains("samples[0].residual_px") && reported.contains("samples[2].residual_px"),
            "{reported}"
        );
    }
}
