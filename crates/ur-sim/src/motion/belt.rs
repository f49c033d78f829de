//! A conveyor: one that the arm's motion is carried along by, and where one lies in the table.
//!
//! In: how far the belt has moved. Out: where a pose of the programmed path is on it. Pure.

use nalgebra::{Isometry3, Translation3, Unit, UnitQuaternion, Vector3};

/// A belt, and how far it has moved since tracking began.
#[derive(Clone, Debug)]
pub enum Belt {
    /// Straight on.
    Straight {
        /// Unit vector in the base frame.
        direction: Vector3<f64>,
        /// m.
        moved: f64,
    },
    /// Round a centre.
    Round {
        /// A point of the axis, in the base frame.
        centre: Vector3<f64>,
        /// The axis.
        axis: Unit<Vector3<f64>>,
        /// The tool turns with it; else it keeps the path's orientation.
        turns_tool: bool,
        /// rad.
        moved: f64,
    },
}

/// A belt level with the table, for the world's objects.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TableBelt {
    /// Least and greatest x and y in the table frame, m: `[x, y, x, y]`.
    pub area: [f64; 4],
    /// Along x and y of the table, m/s.
    pub velocity: [f64; 2],
}

impl Belt {
    /// It moves on: m or rad.
    pub fn advance(&mut self, by: f64) {
        match self {
            Belt::Straight { moved, .. } | Belt::Round { moved, .. } => *moved += by,
        }
    }

    /// Where a pose of the path is on the belt; both in the base frame.
    pub fn place(&self, path: &Isometry3<f64>) -> Isometry3<f64> {
        match self {
            Belt::Straight { direction, moved } => Isometry3::from_parts(
                Translation3::from(path.translation.vector + direction * *moved),
                path.rotation,
            ),
            Belt::Round { centre, axis, turns_tool, moved } => {
                let turn = UnitQuaternion::from_axis_angle(axis, *moved);
                let at = centre + turn * (path.translation.vector - centre);
                let rotation = if *turns_tool { turn * path.rotation } else { path.rotation };
                Isometry3::from_parts(Translation3::from(at), rotation)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;

    #[test]
    fn a_straight_belt_shifts_and_a_round_one_turns_about_its_centre() {
        let path = Isometry3::new(Vector3::new(1.0, 0.0, 0.5), Vector3::new(0.0, 0.3, 0.0));
        let mut straight = Belt::Straight { direction: Vector3::y(), moved: 0.0 };
        assert_eq!(straight.place(&path), path);
        straight.advance(0.2);
        straight.advance(0.1);
        let moved = straight.place(&path);
        assert!((moved.translation.vector - Vector3::new(1.0, 0.3, 0.5)).norm() < 1e-12);
        assert_eq!(moved.rotation, path.rotation);
        for turns_tool in [false, true] {
            let (centre, axis) = (Vector3::new(0.5, 0.0, 0.0), Vector3::z_axis());
            let mut round = Belt::Round { centre, axis, turns_tool, moved: 0.0 };
            round.advance(FRAC_PI_2);
            let moved = round.place(&path);
            assert!((moved.translation.vector - Vector3::new(0.5, 0.5, 0.5)).norm() < 1e-12);
            let turned = moved.rotation.angle_to(&path.rotation);
            assert!((turned - if turns_tool { FRAC_PI_2 } else { 0.0 }).abs() < 1e-9);
        }
    }
}
