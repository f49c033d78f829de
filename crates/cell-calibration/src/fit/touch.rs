//! Where the table lies, by touching points on it with the tip of the tool; and that answer tied to the
//! camera's.
//!
//! In: [`Touch`]es (a point of the table and where the tip was in the base). Out: [`TouchFit`] with its
//! covariance and each touch's error, or the sentence that says which point to touch besides; [`register`]
//! compares with the table that the camera sees and weighs the two by their covariances. Touching knows
//! nothing of lens and mount, so the two can only agree when both are right. Pure.

use crate::fit::TransformStd;
use cell_values::units::{deg_from_rad, mm_from_m};
use cell_vision::observe::pnp::cross;
use nalgebra::{
    Isometry3, Matrix3, Matrix3x6, Matrix6, Point3, Rotation3, SymmetricEigen, Translation3, UnitQuaternion,
    Vector3, Vector6,
};

/// One point touched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Touch {
    /// The point, table frame, m.
    pub on_table: Point3<f64>,
    /// Where the tip was, base frame, m.
    pub in_base: Point3<f64>,
}

/// What is required of the touches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TouchSettings {
    /// How far a careful hand misses the point along each axis, m: what is assumed before the residuals are
    /// seen.
    pub hand_std_m: f64,
    /// How many degrees of freedom that assumption is worth against those of the residuals.
    pub hand_weight: f64,
    /// Largest standard deviation of the worst determined direction, m (rotations count by a lever of 0.3
    /// m).
    pub std_max_m: f64,
    /// Largest root mean square residual, m.
    pub residual_max_m: f64,
}

impl Default for TouchSettings {
    fn default() -> TouchSettings {
        TouchSettings { hand_std_m: 3e-4, hand_weight: 4.0, std_max_m: 1e-3, residual_max_m: 2e-3 }
    }
}

/// The table by touch.
#[derive(Clone, Debug, PartialEq)]
pub struct TouchFit {
    /// The table in the base.
    pub base_from_table: Isometry3<f64>,
    /// Covariance of small motions of the table in its own frame: shift (m2) before turn (rad2).
    pub covariance: Matrix6<f64>,
    /// How far touches miss along each axis: belief and residuals together, m.
    pub touch_std_m: f64,
    /// Distance between each point and where the tip says it is, m.
    pub residuals_m: Vec<f64>,
    /// The same with a fit to the other touches; `None` where those alone do not fix the table.
    pub held_out_m: Vec<Option<f64>>,
    /// Root mean square of `residuals_m`.
    pub rms_m: f64,
}

/// Why the touches give no table.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TouchError {
    /// Fewer than three.
    #[error("{given} points were touched, at least 3 are needed: touch three far apart, not on one line")]
    TooFew {
        /// How many there are.
        given: usize,
    },
    /// The table could turn about a line.
    #[error(
        "the touched points lie on one line within {beside_mm:.0} mm, so the table's turn about that line is \
         open: also touch a point at least {wanted_mm:.0} mm beside it"
    )]
    OneLine {
        /// Root mean square distance from the line, mm.
        beside_mm: f64,
        /// Distance that would do, mm.
        wanted_mm: f64,
    },
    /// All near one place.
    #[error(
        "the touched points lie within {spread_mm:.0} mm of each other, too near to each other to show how the table lies: \
         touch points at least {wanted_mm:.0} mm apart"
    )]
    TooClose {
        /// Root mean square distance from their middle, mm.
        spread_mm: f64,
        /// Distance that would do, mm.
        wanted_mm: f64,
    },
    /// The two sets of points have different shapes.
    #[error(
        "the touches miss their points by {rms_mm:.1} mm on the whole, touch {worst} by {worst_mm:.1} mm: \
         another point was touched, a marker was surveyed wrongly, or the tip's offset from the flange is \
         wrong; leave one out with --drop-touch"
    )]
    NoFit {
        /// Root mean square residual, mm.
        rms_mm: f64,
        /// The worst touch, from 1.
        worst: usize,
        /// Its residual, mm.
        worst_mm: f64,
    },
    /// Not a number, or nothing that can be solved.
    #[error("the touches are no points in metres")]
    Broken,
}

/// Lever by which a rotation error counts as a distance, m.
const LEVER_M: f64 = 0.3;

/// Points that spread this much less across than along lie on a line.
const LINE: f64 = 0.2;

/// Fits the table to the touches.
///
/// # Errors
/// [`TouchError`]: each says what to touch.
pub fn fit_touches(touches: &[Touch], settings: &TouchSettings) -> Result<TouchFit, TouchError> {
    if touches.len() < 3 {
        return Err(TouchError::TooFew { given: touches.len() });
    }
    let finite = |p: &Point3<f64>| p.iter().all(|value| value.is_finite());
    if !touches.iter().all(|touch| finite(&touch.on_table) && finite(&touch.in_base)) {
        return Err(TouchError::Broken);
    }
    check_spread(touches, settings)?;
    let base_from_table = rigid(touches).ok_or(TouchError::Broken)?;
    let residuals_m: Vec<f64> = touches.iter().map(|touch| miss(&base_from_table, touch)).collect();
    let squares: f64 = residuals_m.iter().map(|miss| miss * miss).sum();
    let rms_m = (squares / touches.len() as f64).sqrt();
    let no_fit = || {
        let worst =
            (0..touches.len()).max_by(|&a, &b| residuals_m[a].total_cmp(&residuals_m[b])).unwrap_or(0);
        let worst_mm = mm_from_m(residuals_m[worst]);
        TouchError::NoFit { rms_mm: mm_from_m(rms_m), worst: worst + 1, worst_mm }
    };
    if rms_m > settings.residual_max_m {
        return Err(no_fit());
    }
    // Three coordinates each, six of them spent on the pose: three touches say too little about themselves
    // alone.
    let freedom = (3 * touches.len() - 6) as f64;
    let belief = settings.hand_weight * settings.hand_std_m.powi(2);
    let touch_std_m = ((belief + squares) / (settings.hand_weight + freedom)).sqrt();
    let information = information(touches);
    let covariance = information.try_inverse().ok_or(TouchError::Broken)? * touch_std_m.powi(2);
    // Far enough apart for a careful hand, and not for these: it is the touches that are to be made better.
    check_spread(touches, &TouchSettings { hand_std_m: touch_std_m, ..*settings }).map_err(|_| no_fit())?;
    let held_out_m = (0..touches.len()).map(|left_out| held_out(touches, left_out, settings)).collect();
    Ok(TouchFit { base_from_table, covariance, touch_std_m, residuals_m, held_out_m, rms_m })
}

fn miss(base_from_table: &Isometry3<f64>, touch: &Touch) -> f64 {
    (touch.in_base - base_from_table * touch.on_table).norm()
}

/// Error of one touch predicted by the others.
fn held_out(touches: &[Touch], left_out: usize, settings: &TouchSettings) -> Option<f64> {
    let touch = touches.get(left_out)?;
    let others = touches.iter().enumerate().filter(|(index, _)| *index != left_out);
    let others: Vec<Touch> = others.map(|(_, touch)| *touch).collect();
    if others.len() < 3 || check_spread(&others, settings).is_err() {
        return None;
    }
    Some(miss(&rigid(&others)?, touch))
}

fn middle(points: impl Iterator<Item = Point3<f64>> + Clone) -> Vector3<f64> {
    let count = points.clone().count().max(1) as f64;
    points.map(|point| point.coords).sum::<Vector3<f64>>() / count
}

/// The rigid motion with the least squared distance (Arun, Huang and Blostein, 1987), reflections excluded.
fn rigid(touches: &[Touch]) -> Option<Isometry3<f64>> {
    let table = middle(touches.iter().map(|touch| touch.on_table));
    let base = middle(touches.iter().map(|touch| touch.in_base));
    let product = |touch: &Touch| (touch.in_base.coords - base) * (touch.on_table.coords - table).transpose();
    let svd = touches.iter().map(product).sum::<Matrix3<f64>>().svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    // Points of a plane leave the third singular value at nothing; its sign must make a rotation.
    let mut signs = Matrix3::identity();
    let least = svd.singular_values.imin();
    signs[(least, least)] = (u * v_t).determinant().signum();
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(u * signs * v_t));
    let pose = Isometry3::from_parts(Translation3::from(base - rotation * table), rotation);
    pose.translation.vector.iter().chain(rotation.coords.iter()).all(|v| v.is_finite()).then_some(pose)
}

/// Inverse covariance of small motions of the table in its own frame, for 1 m of noise along each axis.
fn information(touches: &[Touch]) -> Matrix6<f64> {
    let of = |touch: &Touch| {
        let mut slope = Matrix3x6::zeros();
        slope.fixed_columns_mut::<3>(0).copy_from(&Matrix3::identity());
        slope.fixed_columns_mut::<3>(3).copy_from(&-cross(&touch.on_table.coords));
        slope.transpose() * slope
    };
    touches.iter().map(of).sum()
}

/// Refuses points that leave a rotation open.
fn check_spread(touches: &[Touch], settings: &TouchSettings) -> Result<(), TouchError> {
    let at = middle(touches.iter().map(|touch| touch.on_table));
    let arm = |touch: &Touch| touch.on_table.coords - at;
    let scatter: Matrix3<f64> = touches.iter().map(|touch| arm(touch) * arm(touch).transpose()).sum();
    let mut spread: [f64; 3] =
        SymmetricEigen::new(scatter).eigenvalues.map(|value| value.max(0.0).sqrt()).into();
    spread.sort_by(f64::total_cmp);
    let [_, across, along] = spread;
    // About the long axis of the points: their distance from it is the lever.
    let wanted = settings.hand_std_m * LEVER_M / settings.std_max_m;
    if across >= wanted {
        return Ok(());
    }
    let count = touches.len() as f64;
    // What one more point has to add, with room to spare.
    let wanted_mm = (mm_from_m(wanted) * 1.5).max(50.0);
    Err(if along > 0.0 && across < LINE * along {
        TouchError::OneLine { beside_mm: mm_from_m(across / count.sqrt()), wanted_mm }
    } else {
        let spread_mm = mm_from_m(across.hypot(along) / count.sqrt());
        TouchError::TooClose { spread_mm, wanted_mm }
    })
}

/// How far touch and camera may disagree.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RegistrationLimits {
    /// At the middle of the table, m.
    pub shift_m: f64,
    /// rad.
    pub turn_rad: f64,
}

/// The table by both.
#[derive(Clone, Debug, PartialEq)]
pub struct Registration {
    /// The table in the base: both answers, weighted.
    pub base_from_table: Isometry3<f64>,
    /// Covariance of small motions of the table in its own frame: shift (m2) before turn (rad2).
    pub covariance: Matrix6<f64>,
    /// Its standard deviations.
    pub std: TransformStd,
    /// Where touch puts the table's middle less where the camera puts it, table axes, m.
    pub shift_m: Vector3<f64>,
    /// Angle between the two, rad.
    pub turn_rad: f64,
    /// The disagreement in standard deviations: root of its normalised square over the six directions; about
    /// 1 where both standard deviations are true.
    pub in_std: f64,
}

/// Touch and camera do not speak of the same table.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RegistrationError {
    /// More than the limits.
    #[error(
        "touch and camera disagree: touch puts the table's middle {x:+.2}, {y:+.2}, {z:+.2} mm (x right, y \
         away, z up) from where the camera puts it, turned by {deg:.2} degrees; {limit_mm} mm and \
         {limit_deg} degrees are the limits. {hint}"
    )]
    Disagree {
        /// mm.
        x: f64,
        /// mm.
        y: f64,
        /// mm.
        z: f64,
        /// degrees.
        deg: f64,
        /// mm.
        limit_mm: f64,
        /// degrees.
        limit_deg: f64,
        /// What to do.
        hint: &'static str,
    },
    /// A covariance that is none.
    #[error("the covariances of touch and camera cannot be combined")]
    Broken,
}

const ALONG_Z: &str =
    "It is mostly height: measure the tip's length (--tip-mm) again, and let the tip just touch";
const ELSEWHERE: &str = "See that the tip's offset (--tip-mm) is right and the tip points straight along it, \
                         that the touched markers lie where the survey says, and take a new round with \
                         `celld calibrate hand-eye`";

/// Ties the table by touch to the table by camera; `middle` is the table's middle in its own frame, m.
///
/// # Errors
/// [`RegistrationError::Disagree`] above the limits, with what to look at.
pub fn register(
    camera: (&Isometry3<f64>, &Matrix6<f64>),
    touch: &TouchFit,
    middle: &Point3<f64>,
    limits: &RegistrationLimits,
) -> Result<Registration, RegistrationError> {
    let (by_camera, camera_covariance) = camera;
    let between = by_camera.inverse() * touch.base_from_table;
    let shift_m = between * middle - middle;
    let turn_rad = between.rotation.angle();
    if shift_m.norm() > limits.shift_m || turn_rad > limits.turn_rad {
        let [x, y, z] = [shift_m.x, shift_m.y, shift_m.z].map(mm_from_m);
        let upright = turn_rad <= limits.turn_rad && z.abs() > 2.0 * x.hypot(y);
        return Err(RegistrationError::Disagree {
            x,
            y,
            z,
            deg: deg_from_rad(turn_rad),
            limit_mm: mm_from_m(limits.shift_m),
            limit_deg: deg_from_rad(limits.turn_rad),
            hint: if upright { ALONG_Z } else { ELSEWHERE },
        });
    }
    let step = small(&between);
    let both = (camera_covariance + touch.covariance).try_inverse().ok_or(RegistrationError::Broken)?;
    let gain = camera_covariance * both;
    let covariance = camera_covariance - gain * camera_covariance;
    let covariance = (covariance + covariance.transpose()) / 2.0;
    let moved = gain * step;
    let turn = UnitQuaternion::from_scaled_axis(moved.fixed_rows::<3>(3).into_owned());
    let shift = Translation3::from(moved.fixed_rows::<3>(0).into_owned());
    Ok(Registration {
        base_from_table: by_camera * Isometry3::from_parts(shift, turn),
        covariance,
        std: TransformStd::of(&covariance),
        shift_m,
        turn_rad,
        in_std: (step.dot(&(both * step)) / 6.0).sqrt(),
    })
}

/// A small motion as six numbers: shift, then turn.
fn small(motion: &Isometry3<f64>) -> Vector6<f64> {
    let (shift, turn) = (motion.translation.vector, motion.rotation.scaled_axis());
    Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use cell_vision::testing::normal;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    fn truth() -> Isometry3<f64> {
        Isometry3::new(Vector3::new(-0.25, 0.18, 0.003), Vector3::new(0.01, -0.006, 0.4))
    }

    const ROUND: [[f64; 3]; 6] = [
        [-0.045, -0.045, 0.0],
        [0.545, -0.045, 0.0],
        [0.545, 0.545, 0.0],
        [-0.045, 0.545, 0.0],
        [0.25, 0.545, 0.0],
        [0.25, 0.1, 0.02],
    ];

    fn touches(points: &[[f64; 3]], noise_m: f64, random: &mut ChaCha8Rng) -> Vec<Touch> {
        let mut touch = |point: &[f64; 3]| {
            let on_table = Point3::from(*point);
            let noise = Vector3::from_fn(|_, _| normal(random)) * noise_m;
            Touch { on_table, in_base: truth() * on_table + noise }
        };
        points.iter().map(&mut touch).collect()
    }

    fn normalised(found: &Isometry3<f64>, covariance: &Matrix6<f64>) -> f64 {
        let off = small(&(found.inverse() * truth()));
        off.dot(&(covariance.try_inverse().unwrap() * off)) / 6.0
    }

    #[test]
    fn exact_touches_give_the_table_also_when_all_lie_in_its_plane() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        for count in [3, 4, 6] {
            let fit = fit_touches(&touches(&ROUND[..count], 0.0, &mut random), &Default::default()).unwrap();
            let off = fit.base_from_table.inverse() * truth();
            assert!(off.translation.vector.norm() < 1e-12 && off.rotation.angle() < 1e-9, "{off}");
            assert!(fit.rms_m < 1e-12 && fit.touch_std_m > 1e-4, "three exact touches prove no exact hand");
            assert_eq!(fit.held_out_m.iter().all(Option::is_some), count > 3);
        }
    }

    #[test]
    fn the_stated_errors_are_the_true_ones() {
        for (points, noise_m) in [(3, 3e-4), (4, 3e-4), (6, 3e-4), (6, 5e-4), (6, 2e-4)] {
            let mut random = ChaCha8Rng::seed_from_u64(7);
            let trials = 600;
            let sum: f64 = (0..trials)
                .map(|_| {
                    let touches = touches(&ROUND[..points], noise_m, &mut random);
                    let fit = fit_touches(&touches, &Default::default()).unwrap();
                    normalised(&fit.base_from_table, &fit.covariance)
                })
                .sum();
            let ratio = sum / f64::from(trials);
            println!("{points} touches, {} mm: normalised squared error {ratio:.2}", noise_m * 1e3);
            let expected = if noise_m == 3e-4 { 0.85..1.2 } else { 0.55..1.5 };
            assert!(expected.contains(&ratio), "{points} {noise_m}: {ratio}");
        }
    }

    #[test]
    fn points_on_a_line_near_each_other_or_too_few_are_refused_in_words() {
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let mut reported = |points: &[[f64; 3]]| {
            let touches = touches(points, 1e-4, &mut random);
            fit_touches(&touches, &Default::default()).unwrap_err().to_string()
        };
        let line =
            reported(&[[-0.045, -0.045, 0.0], [0.25, -0.045, 0.0], [0.545, -0.045, 0.0], [0.1, -0.044, 0.0]]);
        assert!(line.contains("on one line within 0 mm") && line.contains("beside it"), "{line}");
        let near = reported(&[[0.0, 0.0, 0.0], [0.03, 0.0, 0.0], [0.0, 0.03, 0.0]]);
        assert!(near.contains("too near"), "{near}");
        let same = reported(&[[0.1, 0.1, 0.0]; 4]);
        assert!(same.contains("too near"), "{same}");
        assert!(reported(&ROUND[..2]).contains("2 points were touched"));
    }

    #[test]
    fn a_touch_beside_its_point_is_named() {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let mut touched = touches(&ROUND, 2e-4, &mut random);
        touched[4].in_base.x += 0.012;
        let reported = fit_touches(&touched, &Default::default()).unwrap_err();
        assert!(matches!(reported, TouchError::NoFit { worst: 5, .. }), "{reported}");
        // Points near each other bear only small errors.
        let mut near = touches(
            &[[0.0, 0.0, 0.0], [0.12, 0.0, 0.0], [0.12, 0.1, 0.0], [0.0, 0.1, 0.0]],
            1e-4,
            &mut random,
        );
        assert!(fit_touches(&near, &Default::default()).is_ok());
        near[1].in_base.z += 0.0035;
        let reported = fit_touches(&near, &Default::default()).unwrap_err();
        assert!(matches!(reported, TouchError::NoFit { .. }), "{reported}");
        touched[4].in_base.x = f64::NAN;
        assert_eq!(fit_touches(&touched, &Default::default()).unwrap_err(), TouchError::Broken);
    }

    const LIMITS: RegistrationLimits = RegistrationLimits { shift_m: 2e-3, turn_rad: 0.007 };

    fn middle_of_table() -> Point3<f64> {
        Point3::new(0.25, 0.25, 0.0)
    }

    #[test]
    fn both_answers_together_are_better_than_each_and_say_how_good() {
        let mut random = ChaCha8Rng::seed_from_u64(4);
        let stds = Vector6::new(2e-4, 2e-4, 4e-4, 1e-3, 1e-3, 4e-4);
        let by_camera = Matrix6::from_diagonal(&stds.map(|std| std * std));
        let (mut ratio, mut disagreement, mut squares) = (0.0, 0.0, [0.0; 3]);
        let trials = 400;
        for _ in 0..trials {
            let off = stds.map(|std| std * normal(&mut random));
            let turn = UnitQuaternion::from_scaled_axis(off.fixed_rows::<3>(3).into_owned());
            let camera =
                truth() * Isometry3::from_parts(off.fixed_rows::<3>(0).into_owned().into(), turn).inverse();
            let touch = fit_touches(&touches(&ROUND, 3e-4, &mut random), &Default::default()).unwrap();
            let tied = register((&camera, &by_camera), &touch, &middle_of_table(), &LIMITS).unwrap();
            ratio += normalised(&tied.base_from_table, &tied.covariance);
            disagreement += tied.in_std.powi(2);
            for (sum, pose) in squares.iter_mut().zip([camera, touch.base_from_table, tied.base_from_table]) {
                *sum += (truth().inverse() * pose * middle_of_table() - middle_of_table()).norm_squared();
            }
        }
        let [ratio, disagreement] = [ratio, disagreement].map(|sum| sum / f64::from(trials));
        let [camera, touch, tied] = squares.map(|sum: f64| mm_from_m((sum / f64::from(trials)).sqrt()));
        println!(
            "middle: camera {camera:.3}, touch {touch:.3}, both {tied:.3} mm; {ratio:.2} {disagreement:.2}"
        );
        assert!(tied < camera && tied < touch, "{camera} {touch} {tied}");
        assert!(
            (0.85..1.2).contains(&ratio) && (0.85..1.2).contains(&disagreement),
            "{ratio} {disagreement}"
        );
    }

    #[test]
    fn a_wrong_tip_and_a_wrong_survey_are_distinguished() {
        let mut random = ChaCha8Rng::seed_from_u64(5);
        let touch = fit_touches(&touches(&ROUND, 2e-4, &mut random), &Default::default()).unwrap();
        let covariance = Matrix6::identity() * 1e-8;
        let reported = |off: Isometry3<f64>| {
            let camera = truth() * off;
            register((&camera, &covariance), &touch, &middle_of_table(), &LIMITS).unwrap_err().to_string()
        };
        let long = reported(Isometry3::translation(0.0, 0.0, -0.004));
        assert!(long.contains("+4.") && long.contains("mostly height"), "{long}");
        let aside = reported(Isometry3::translation(0.003, 0.0, 0.0));
        assert!(aside.contains("-3.") && aside.contains("survey"), "{aside}");
        let turned = reported(Isometry3::rotation(Vector3::new(0.0, 0.0, 0.02)));
        assert!(turned.contains("degrees"), "{turned}");
    }
}
