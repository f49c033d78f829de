//! What the simulated cell consists of, and how far the true cell is from the nominal one.
//!
//! In: the nominal cell (config) and a seed. Out: [`WorldSpec`], checked by `World::new`, and [`TruthSpec`],
//! the deviations that a daemon can only learn by calibrating. Lengths m, angles rad, masses kg; poses of
//! objects and markers in the table frame, cups in the tool frame.

use crate::box_clients::BoxConfig;
use crate::render::lens::CameraTruth;
use crate::world::drive::Drive;
use crate::world::vacuum::Channel;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rearrange::geometry::footprint::Footprint;
use rearrange::geometry::pose::Pose2;

/// Everything the world is made of at the start.
#[derive(Clone, Debug)]
pub struct WorldSpec {
    /// The workspace and the board it is drawn on.
    pub table: TableSpec,
    /// True pose of the table in the robot's base frame.
    pub base_from_table: Isometry3<f64>,
    /// What lies on the table.
    pub objects: Vec<WorldObject>,
    /// Markers printed on the table.
    pub reference_markers: Vec<ReferenceMarker>,
    /// Random errors of gripping, placing and dropping.
    pub errors: PlacementErrors,
    /// The gripper.
    pub gripper: GripperSpec,
    /// A calibration board on the hand.
    pub hand_board: Option<HandBoard>,
}

impl WorldSpec {
    /// A bare table of 0.5 x 0.5 m and a gripper of one cup.
    pub fn bare(base_from_table: Isometry3<f64>, gripper: GripperSpec) -> WorldSpec {
        WorldSpec {
            table: TableSpec { width_m: 0.5, height_m: 0.5, margin_m: 0.1 },
            base_from_table,
            objects: Vec::new(),
            reference_markers: Vec::new(),
            errors: PlacementErrors::default(),
            gripper,
            hand_board: None,
        }
    }
}

/// The workspace `[0, width] x [0, height]` and the margin of board around it; what leaves the board falls.
#[derive(Clone, Copy, Debug)]
pub struct TableSpec {
    /// Extent in x, m.
    pub width_m: f64,
    /// Extent in y, m.
    pub height_m: f64,
    /// Board around the workspace, m.
    pub margin_m: f64,
}

/// An object: an upright prism.
#[derive(Clone, Debug)]
pub struct WorldObject {
    /// Its name.
    pub id: String,
    /// Its footprint.
    pub footprint: Footprint,
    /// Its height, m.
    pub height_m: f64,
    /// Its mass, kg.
    pub mass_kg: f64,
    /// Where it lies.
    pub pose: Pose2,
    /// The marker on its top.
    pub marker: Option<ObjectMarker>,
    /// Where cups may sit; absent: the whole top.
    pub grippable: Option<Footprint>,
    /// Screwed to the table.
    pub fixed: bool,
    /// Colour of its top; absent: one by its number.
    pub colour: Option<[u8; 3]>,
}

/// A thing without a marker that a person puts on the table: an upright prism.
#[derive(Clone, Debug, PartialEq)]
pub struct ForeignBody {
    /// Its footprint.
    pub footprint: Footprint,
    /// Its height, m.
    pub height_m: f64,
    /// Where it is.
    pub pose: Pose2,
}

/// A tag36h11 marker on an object's top.
#[derive(Clone, Copy, Debug)]
pub struct ObjectMarker {
    /// Number in the family.
    pub id: u32,
    /// Edge of the black square, m.
    pub size_m: f64,
    /// Marker frame (x right, y up) in the object frame.
    pub offset: Pose2,
}

/// A tag36h11 marker on the table.
#[derive(Clone, Copy, Debug)]
pub struct ReferenceMarker {
    /// Number in the family.
    pub id: u32,
    /// Edge of the black square, m.
    pub size_m: f64,
    /// Marker frame in the table frame, true.
    pub pose: Pose2,
}

/// Standard deviations of what gripping, placing and dropping do to an object's pose.
#[derive(Clone, Copy, Debug)]
pub struct PlacementErrors {
    /// Per axis, at each grip and at each placing, m.
    pub std_xy_m: f64,
    /// At each grip and at each placing, rad.
    pub std_theta_rad: f64,
    /// Per axis, when an object falls, m per m of height, on top of `std_xy_m`.
    pub drop_xy_per_m: f64,
    /// When an object falls, rad.
    pub drop_theta_rad: f64,
}

impl Default for PlacementErrors {
    fn default() -> PlacementErrors {
        PlacementErrors {
            std_xy_m: 2e-4,
            std_theta_rad: 0.1f64.to_radians(),
            drop_xy_per_m: 0.1,
            drop_theta_rad: 0.1,
        }
    }
}

/// The gripper on the flange.
#[derive(Clone, Debug)]
pub struct GripperSpec {
    /// What makes it grip.
    pub drive: Drive,
    /// How its box treats clients, if it has one.
    pub clients: BoxConfig,
    /// How far its pumps pull beyond their target at first, share of the target.
    pub overshoot: f64,
    /// Tool frame (centre of the cup lips or between the fingertips, z out of the gripper) in the flange
    /// frame.
    pub flange_from_tool: Isometry3<f64>,
    /// The cups; fingers have none.
    pub cups: Vec<Cup>,
    /// Outline of the housing in the tool frame, seen along -z; drawn, and it touches tall objects.
    pub body: Footprint,
    /// Height of the housing's underside above the cup lips, m.
    pub body_above_lips_m: f64,
}

impl GripperSpec {
    /// The simplest gripper: one cup of 20 mm on channel A, `length_m` straight below the flange, under a
    /// housing of 50 x 50 mm whose underside is 50 mm above the lip.
    pub fn one_cup(length_m: f64) -> GripperSpec {
        GripperSpec {
            drive: Drive::Vgc10,
            clients: BoxConfig::default(),
            overshoot: 0.0,
            flange_from_tool: Isometry3::translation(0.0, 0.0, length_m),
            cups: vec![Cup { channel: Channel::A, x_m: 0.0, y_m: 0.0, diameter_m: 0.02 }],
            body: Footprint::Rectangle { length: 0.05, width: 0.05 },
            body_above_lips_m: 0.05,
        }
    }
}

/// A suction cup.
#[derive(Clone, Copy, Debug)]
pub struct Cup {
    /// The channel it is connected to.
    pub channel: Channel,
    /// x in the tool frame, m.
    pub x_m: f64,
    /// y in the tool frame, m.
    pub y_m: f64,
    /// Diameter of its lip, m.
    pub diameter_m: f64,
}

impl Cup {
    /// Area under the lip, m2.
    pub fn area_m2(&self) -> f64 {
        std::f64::consts::PI * self.diameter_m * self.diameter_m / 4.0
    }
}

/// A plate with a grid of tag36h11 markers on the hand, for calibrating a fixed camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandBoard {
    /// The board in the flange frame: origin in the lower left corner of the lower left marker, x right, y
    /// up, z out of the print.
    pub flange_from_board: Isometry3<f64>,
    /// Markers across and up.
    pub grid: [u32; 2],
    /// Edge of a marker's black square, m.
    pub size_m: f64,
    /// White between two neighbours' squares, m.
    pub gap_m: f64,
    /// Number of the lower left marker; they run on to the right, then up.
    pub first_id: u32,
}

/// Where the camera sits.
#[derive(Clone, Copy, Debug)]
pub enum CameraMount {
    /// On the wrist: `flange_from_camera`.
    Flange(Isometry3<f64>),
    /// On a stand: `table_from_camera`.
    Fixed(Isometry3<f64>),
}

/// The cell as its drawings say.
#[derive(Clone, Debug)]
pub struct NominalCell {
    /// Table in the base frame.
    pub base_from_table: Isometry3<f64>,
    /// Camera mount.
    pub mount: CameraMount,
    /// Camera as its data sheet says (no distortion, centred).
    pub camera: CameraTruth,
}

/// How far the true cell may be from the nominal one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TruthLimits {
    /// Table: largest shift along x and y, m; half of it along z.
    pub table_m: f64,
    /// Table: largest turn about z, rad; a sixth of it about x and y.
    pub table_rad: f64,
    /// Camera mount: largest shift along each axis, m.
    pub mount_m: f64,
    /// Camera mount: largest turn about each axis, rad.
    pub mount_rad: f64,
}

/// The cell as it is.
#[derive(Clone, Debug)]
pub struct TruthSpec {
    /// Table in the base frame.
    pub base_from_table: Isometry3<f64>,
    /// Camera mount.
    pub mount: CameraMount,
    /// The camera that takes the pictures.
    pub camera: CameraTruth,
    /// What the camera says about itself: its factory calibration, about 0.02 % off.
    pub reported: CameraTruth,
}

impl TruthSpec {
    /// Deviations by seed, uniform within their limits: table and camera mount as `limits` say; focal length
    /// +-1 %, principal point +-12 px, Brown-Conrady distortion of a short lens; reported intrinsics +-0.02
    /// %.
    pub fn from_seed(nominal: &NominalCell, limits: &TruthLimits, seed: u64) -> TruthSpec {
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x7275_7468);
        let mut spread = |limit: f64| rng.random_range(-1.0..=1.0) * limit;
        let table = deviation(
            [spread(limits.table_m), spread(limits.table_m), spread(0.5 * limits.table_m)],
            [spread(limits.table_rad / 6.0), spread(limits.table_rad / 6.0), spread(limits.table_rad)],
        );
        let mount = deviation([limits.mount_m; 3].map(&mut spread), [limits.mount_rad; 3].map(&mut spread));
        let mut camera = nominal.camera.clone();
        camera.fx *= 1.0 + spread(0.01);
        camera.fy = camera.fx * (1.0 + spread(0.002));
        camera.cx += spread(12.0);
        camera.cy += spread(12.0);
        camera.distortion =
            [-0.05 + spread(0.01), 0.06 + spread(0.01), spread(8e-4), spread(8e-4), -0.02 + spread(0.003)];
        let mut reported = camera.clone();
        reported.fx *= 1.0 + spread(2e-4);
        reported.fy *= 1.0 + spread(2e-4);
        reported.cx += spread(0.1);
        reported.cy += spread(0.1);
        TruthSpec {
            base_from_table: nominal.base_from_table * table,
            mount: match nominal.mount {
                CameraMount::Flange(flange_from_camera) => CameraMount::Flange(flange_from_camera * mount),
                CameraMount::Fixed(table_from_camera) => CameraMount::Fixed(table_from_camera * mount),
            },
            camera,
            reported,
        }
    }
}

/// A small transform from a translation in m and rotations about x, y, z in rad.
fn deviation(translation_m: [f64; 3], rotation_rad: [f64; 3]) -> Isometry3<f64> {
    let rotation = Vector3::from(rotation_rad);
    Isometry3::from_parts(
        Translation3::from(Vector3::from(translation_m)),
        UnitQuaternion::from_scaled_axis(rotation),
    )
}

/// Why a world cannot be built.
#[derive(Debug, thiserror::Error)]
pub enum WorldError {
    /// A number that must be finite and positive is not.
    #[error("{what}: {value} is not a finite number above 0")]
    NotPositive {
        /// Which number.
        what: String,
        /// What was given.
        value: f64,
    },
    /// A pose has a number that is not finite.
    #[error("{what}: the pose is not finite")]
    PoseNotFinite {
        /// Whose pose.
        what: String,
    },
    /// Two objects share a name, or two prints share a marker number.
    #[error("{what} is used twice")]
    Twice {
        /// The name or number.
        what: String,
    },
    /// The marker family has no such number.
    #[error("{what}: tag36h11 has no marker {id}")]
    NoSuchMarker {
        /// Who carries it.
        what: String,
        /// The number.
        id: u32,
    },
}

impl WorldError {
    /// `what` carries a marker that is not in the family.
    pub fn no_marker(what: &str, id: u32) -> WorldError {
        WorldError::NoSuchMarker { what: what.to_string(), id }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: TruthLimits =
        TruthLimits { table_m: 3e-3, table_rad: 5e-3, mount_m: 3e-3, mount_rad: 9e-3 };

    #[test]
    fn limits_of_zero_leave_the_nominal_cell_and_larger_ones_scale_it() {
        let nominal = nominal();
        let none = TruthLimits { table_m: 0.0, table_rad: 0.0, mount_m: 0.0, mount_rad: 0.0 };
        let double = TruthLimits { table_m: 6e-3, ..LIMITS };
        let shift = |limits: &TruthLimits| {
            let truth = TruthSpec::from_seed(&nominal, limits, 7);
            (nominal.base_from_table.inverse() * truth.base_from_table).translation.vector
        };
        assert_eq!(shift(&none).norm(), 0.0);
        assert!((shift(&double) - 2.0 * shift(&LIMITS)).norm() < 1e-12);
    }

    fn nominal() -> NominalCell {
        NominalCell {
            base_from_table: Isometry3::translation(-0.25, 0.18, 0.0),
            mount: CameraMount::Flange(Isometry3::translation(0.0, -0.07, 0.03)),
            camera: CameraTruth::ideal("sim-1", 1280, 720, 650.0),
        }
    }

    #[test]
    fn truth_differs_from_nominal_a_little_and_repeats_by_seed() {
        for seed in 0..50 {
            let nominal = nominal();
            let truth = TruthSpec::from_seed(&nominal, &LIMITS, seed);
            let table = nominal.base_from_table.inverse() * truth.base_from_table;
            assert!(table.translation.vector.norm() < 5e-3 && table.rotation.angle() < 0.32f64.to_radians());
            assert!(table.translation.vector.norm() > 1e-5);
            let (CameraMount::Flange(a), CameraMount::Flange(b)) = (nominal.mount, truth.mount) else {
                panic!()
            };
            let mount = a.inverse() * b;
            assert!(mount.translation.vector.norm() < 6e-3 && mount.rotation.angle() < 1.6e-2);
            assert!((truth.reported.fx / truth.camera.fx - 1.0).abs() <= 2e-4);
            assert_eq!(truth.base_from_table, TruthSpec::from_seed(&nominal, &LIMITS, seed).base_from_table);
            assert_ne!(
                truth.base_from_table,
                TruthSpec::from_seed(&nominal, &LIMITS, seed + 1).base_from_table
            );
        }
    }
}
