//! An offset that is laid over the path of the arm's tool.
//!
//! In: the offset that a script wants and its frame, then the pose of the path in each frame. Out: where the
//! tool is. Pure. The offset is filtered in its own coordinates and limited along and around each axis. A
//! rotation turns the tool about its own centre point. Assumed: that the limits cut each axis off, that the
//! filter goes on across a change of the frame, and that without a tangent yet (the path has not moved) the
//! motion frame is that of the tool.

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// A path that moves less in a frame than this has no direction, m.
const STANDING_M: f64 = 1e-9;

/// What an offset is relative to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OffsetFrame {
    /// The robot's base.
    Base,
    /// The tool centre point.
    Tool,
    /// x along the path, y across it and the tool's z axis.
    Motion,
    /// The offset is the place of the base in the world, which the path is meant in.
    World,
}

/// What scripts have set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OffsetWish {
    /// m and a rotation vector in rad.
    pub offset: [f64; 6],
    /// What it is relative to.
    pub frame: OffsetFrame,
    /// Share of the wish in each frame, the rest being what was applied before; 1: no filter.
    pub alpha: f64,
    /// Most along an axis, m.
    pub most_m: f64,
    /// Most around an axis, rad.
    pub most_rad: f64,
}

impl Default for OffsetWish {
    /// None; limits of 0.1 m and 30 degrees (script manual).
    fn default() -> OffsetWish {
        OffsetWish {
            offset: [0.0; 6],
            frame: OffsetFrame::Base,
            alpha: 1.0,
            most_m: 0.1,
            most_rad: std::f64::consts::FRAC_PI_6,
        }
    }
}

/// The offset that is applied.
#[derive(Clone, Debug, Default)]
pub struct PathOffset {
    wish: OffsetWish,
    applied: [f64; 6],
    /// Direction of the path when it moved last.
    tangent: Option<Vector3<f64>>,
}

impl PathOffset {
    /// One frame on: towards the wish, the path having come from `before` to `now`.
    pub fn advance(&mut self, wish: &OffsetWish, before: &Isometry3<f64>, now: &Isometry3<f64>) {
        self.wish = *wish;
        for (axis, applied) in self.applied.iter_mut().enumerate() {
            let most = if axis < 3 { wish.most_m } else { wish.most_rad };
            *applied += wish.alpha * (wish.offset[axis].clamp(-most, most) - *applied);
        }
        let way = now.translation.vector - before.translation.vector;
        self.tangent = way.try_normalize(STANDING_M).or(self.tangent);
    }

    /// Where the tool is for a pose of the path; both in the base frame.
    pub fn place(&self, path: &Isometry3<f64>) -> Isometry3<f64> {
        let [x, y, z, rx, ry, rz] = self.applied;
        let (shift, turn) = (Vector3::new(x, y, z), Vector3::new(rx, ry, rz));
        let offset = Isometry3::new(shift, turn);
        match self.wish.frame {
            OffsetFrame::World => offset.inverse() * path,
            OffsetFrame::Tool => path * offset,
            OffsetFrame::Base | OffsetFrame::Motion => {
                let axes = self.axes(self.wish.frame, path);
                let turned = UnitQuaternion::from_scaled_axis(axes * turn) * path.rotation;
                let moved = Translation3::from(path.translation.vector + axes * shift);
                Isometry3::from_parts(moved, turned)
            }
        }
    }

    /// The offset that is applied at a pose of the path, as one relative to `frame`.
    pub fn relative_to(&self, frame: OffsetFrame, path: &Isometry3<f64>) -> [f64; 6] {
        let at = self.place(path);
        let offset = match frame {
            OffsetFrame::World => path * at.inverse(),
            OffsetFrame::Tool => path.inverse() * at,
            OffsetFrame::Base | OffsetFrame::Motion => {
                let back = self.axes(frame, path).transpose();
                let turn = (at.rotation * path.rotation.inverse()).scaled_axis();
                Isometry3::new(back * (at.translation.vector - path.translation.vector), back * turn)
            }
        };
        let (shift, turn) = (offset.translation.vector, offset.rotation.scaled_axis());
        [shift.x, shift.y, shift.z, turn.x, turn.y, turn.z]
    }

    /// Axes of a frame whose origin is the tool centre point, in the base frame.
    fn axes(&self, frame: OffsetFrame, path: &Isometry3<f64>) -> Matrix3<f64> {
        if frame == OffsetFrame::Base {
            return Matrix3::identity();
        }
        let tool = *Rotation3::from(path.rotation).matrix();
        let Some(x) = self.tangent else { return tool };
        // A path along the tool's own axis has no such y: the tool's is as good as any.
        let y = x.cross(&(path.rotation * Vector3::z())).try_normalize(1e-6);
        let y = y.or_else(|| (path.rotation * Vector3::y()).try_normalize(1e-6)).unwrap_or_else(Vector3::y);
        Matrix3::from_columns(&[x, y, x.cross(&y)])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn down() -> Isometry3<f64> {
        Isometry3::new(Vector3::new(0.4, 0.1, 0.3), Vector3::new(std::f64::consts::PI, 0.0, 0.0))
    }

    fn applied(wish: OffsetWish, way: Vector3<f64>) -> Isometry3<f64> {
        let mut offset = PathOffset::default();
        offset.advance(&wish, &down(), &(Translation3::from(way) * down()));
        offset.place(&down())
    }

    #[test]
    fn an_offset_is_along_the_axes_of_its_frame() {
        let wish =
            |frame| OffsetWish { offset: [0.01, 0.02, 0.03, 0.0, 0.0, 0.0], frame, ..Default::default() };
        let shift = |frame| {
            applied(wish(frame), Vector3::new(0.0, 0.001, 0.0)).translation.vector - down().translation.vector
        };
        for (frame, expected) in [
            (OffsetFrame::Base, [0.01, 0.02, 0.03]),
            // The tool looks down: its y and z are against those of the base.
            (OffsetFrame::Tool, [0.01, -0.02, -0.03]),
            // Along y; y cross tool z (down) is minus x; the third axis is up.
            (OffsetFrame::Motion, [-0.02, 0.01, 0.03]),
            (OffsetFrame::World, [-0.01, -0.02, -0.03]),
        ] {
            assert!((shift(frame) - Vector3::from(expected)).norm() < 1e-12, "{frame:?}: {}", shift(frame));
        }
    }

    #[test]
    fn it_is_cut_off_at_its_limits_and_filtered() {
        let far = OffsetWish { offset: [0.5, -0.5, 0.05, 1.0, 0.0, -1.0], ..Default::default() };
        let mut offset = PathOffset::default();
        offset.advance(&far, &down(), &down());
        let limit = std::f64::consts::FRAC_PI_6;
        assert_eq!(offset.applied, [0.1, -0.1, 0.05, limit, 0.0, -limit]);
        let slow = OffsetWish { offset: [0.1, 0.0, 0.0, 0.0, 0.0, 0.0], alpha: 0.25, ..Default::default() };
        let mut offset = PathOffset::default();
        for expected in [0.025, 0.04375] {
            offset.advance(&slow, &down(), &down());
            assert!((offset.applied[0] - expected).abs() < 1e-15, "{:?}", offset.applied);
        }
    }

    proptest! {
        #[test]
        fn what_is_applied_is_reported_in_every_frame(
            offset in proptest::array::uniform6(-0.1..0.1f64), way in proptest::array::uniform3(0.1..1.0f64)
        ) {
            for frame in [OffsetFrame::Base, OffsetFrame::Tool, OffsetFrame::Motion, OffsetFrame::World] {
                let mut applied = PathOffset::default();
                let wish = OffsetWish { offset, frame, ..Default::default() };
                applied.advance(&wish, &down(), &(Translation3::from(Vector3::from(way)) * down()));
                for other in [OffsetFrame::Base, OffsetFrame::Tool, OffsetFrame::Motion, OffsetFrame::World] {
                    let applied_pose = applied.relative_to(other, &down());
                    let mut same = applied.clone();
                    (same.applied, same.wish.frame) = (applied_pose, other);
                    let (a, b) = (applied.place(&down()), same.place(&down()));
                    prop_assert!((a.translation.vector - b.translation.vector).norm() < 1e-9);
                    prop_assert!(a.rotation.angle_to(&b.rotation) < 1e-7);
                }
                let own = applied.relative_to(frame, &down());
                prop_assert!(own.iter().zip(offset).all(|(a, b)| (a - b).abs() < 1e-9), "{own:?} {offset:?}");
            }
        }
    }
}
