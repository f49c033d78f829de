//! What the camera sees at one moment: a light copy of the world that can be drawn without holding it.
//!
//! In: the world. Out: prisms (objects, gripper), prints on the table, the board, and the flange pose.
//! Shapes are shared, so that a copy costs some hundred bytes an object.

use crate::world::section::Section;
use crate::world::spec::CameraMount;
use nalgebra::{Isometry3, Matrix3, Rotation3, UnitQuaternion};
use std::sync::Arc;

/// A marker's modules as printed: row 0 at the top, true = white; the white ring, the black border, the
/// code.
pub type Cells = [[bool; 10]; 10];

/// A scene in the table frame.
pub struct Scene {
    /// The board's extents: x from, y from, x to, y to, m.
    pub board: [f64; 4],
    /// Where the wrist is.
    pub table_from_flange: Isometry3<f64>,
    /// Bodies.
    pub prisms: Vec<Prism>,
    /// Markers on the board.
    pub prints: Vec<Print>,
}

/// An upright prism in its own frame, z from 0 to `height_m`.
#[derive(Clone)]
pub struct Prism {
    /// Where it is.
    pub table_from_prism: Isometry3<f64>,
    /// Its cross-section.
    pub section: Arc<Section>,
    /// Its height, m.
    pub height_m: f64,
    /// Colour of its top; walls are darker.
    pub colour: [u8; 3],
    /// Markers on its top.
    pub prints: Vec<Print>,
}

/// A printed marker: black square of 8 x 8 cells with a white ring of one cell.
#[derive(Clone)]
pub struct Print {
    /// The cells.
    pub cells: Cells,
    /// Edge of the black square, m.
    pub size_m: f64,
    /// Marker frame (x right, y up) in the plane it is printed on: x, y, theta.
    pub pose: rearrange::geometry::pose::Pose2,
}

impl Scene {
    /// Pose of a camera mounted like this.
    pub fn table_from_camera(&self, mount: &CameraMount) -> Isometry3<f64> {
        match mount {
            CameraMount::Flange(flange_from_camera) => self.table_from_flange * flange_from_camera,
            CameraMount::Fixed(table_from_camera) => *table_from_camera,
        }
    }
}

/// The camera pose at `eye` that looks straight at `target`, both in the table frame, image x along `right`.
///
/// Used by tests and the bench; a cell's cameras come from its configuration.
pub fn look_at(eye: [f64; 3], target: [f64; 3], right: [f64; 3]) -> Isometry3<f64> {
    let (eye, target) = (nalgebra::Vector3::from(eye), nalgebra::Vector3::from(target));
    let z = (target - eye).normalize();
    let x = nalgebra::Vector3::from(right);
    let x = (x - z * z.dot(&x)).normalize();
    let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, z.cross(&x), z]));
    Isometry3::from_parts(eye.into(), UnitQuaternion::from_rotation_matrix(&rotation))
}
