//! Forward and inverse kinematics of a UR arm, on nominal or calibrated Denavit-Hartenberg parameters.
//!
//! In: DH parameters (m, rad, standard convention) and joint positions or a `base_from_flange` pose.
//! Out: the pose, the geometric Jacobian, or all joint solutions of the pose (2 shoulders x 2 wrists x 2
//! elbows). Pure. The closed form (Hawkins, "Analytic inverse kinematics for the Universal Robots") holds
//! for the nominal arm only: three parallel axes. A real arm's parameters deviate by its calibration, and
//! its table may even trade large opposite offsets along the parallel axes, so each nominal solution is the
//! start of a few Newton steps on the calibrated parameters. Where two singularities meet these lead
//! nowhere; then damped steps from many starts find what there is.

#[cfg(test)]
mod tests;

use crate::chain::{Chain, flange_of};
pub use crate::links::model_of;
use crate::links::{all_over, farthest_apart};
pub use crate::models::{ARM_MODELS, ArmModel, DhParameters};
use cell_values::units::Joints;
use nalgebra::{Isometry3, Matrix6, Vector3, Vector6};
use serde::{Deserialize, Serialize};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Newton stops when the pose error (m and rad together) is below this; the controller's own
/// `get_inverse_kin` works to 1e-10.
const POSE_TOLERANCE: f64 = 1e-11;

/// Newton steps before a start is given up; a nominal start needs three or four.
const MAX_NEWTON_STEPS: usize = 30;

/// And damped ones, near a singularity.
const MAX_DAMPED_STEPS: usize = 600;

/// Within so many of them the error has to be halved.
const STEPS_TO_HALVE: usize = 80;

/// Where the branches of the closed form meet, so many are followed.
const SINGULAR_SOLUTIONS: usize = 8;

/// Starts that rest on no closed form.
const ANYWHERE: usize = 200;

/// Elbow and wrist count as near their singularity below this sine.
const SINGULAR: f64 = 0.25;

/// How far the closed form's solutions may be from exact ones.
#[derive(Clone, Copy)]
struct Closed {
    /// How far a cosine may be beyond 1.
    beyond: f64,
    /// Least angle of shoulder, elbow and wrist from where their two branches meet, rad.
    apart: f64,
}

/// Its own solutions: a cosine is beyond 1 by the rounding of the pose.
const SOLUTIONS: Closed = Closed { beyond: 1e-6, apart: 0.0 };

/// Starts for a calibrated arm: it may just reach, and its branches meet elsewhere. A start between them
/// would lead to one of the two only.
const STARTS: Closed = Closed { beyond: 0.1, apart: 0.05 };

/// Starts where those have led nowhere: how near they are to the pose decides.
const FAR_STARTS: Closed = Closed { beyond: 1.0, apart: 0.0 };

/// And what is then added to joint 1, rad.
const AROUND: &[f64] = &[0.0, 0.02, -0.02, 0.1, -0.1, 0.3, -0.3, 0.6, -0.6, 1.0, -1.0, 1.5, -1.5];

/// Joints nearer to each other are one solution, rad: where two branches meet, Newton's tolerance leaves
/// some 1e-6 between them.
const SAME_RAD: f64 = 2e-5;

/// Nearer than this to the shoulder's axis, in offsets d4, joint 1 is near its singularity.
const SINGULAR_SHOULDER: f64 = 1.1;

/// How far the nominal arm may be from a pose at a start near a singularity, m and rad together.
const NEAR: f64 = 0.15;

/// Of these starts so many are followed, nearest first.
const NEAREST: usize = 8;

/// From where on a start is clearly of its family: the wrist before or behind the shoulder axis, m, and the
/// sines of elbow and wrist 2. Calibrations move a solution by a few millimetres and milliradians.
const CLEARLY: [f64; 3] = [0.05, 0.1, 0.1];

/// Longest Newton step of a joint, rad.
const MAX_STEP: f64 = 0.2;

/// An arm's kinematics, with what is the same for every pose computed once.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(from = "DhParameters", into = "DhParameters")]
pub struct Kinematics {
    dh: DhParameters,
    model: &'static ArmModel,
    chain: Chain,
    /// Chain of the nominal arm.
    nominal: Chain,
}

impl From<DhParameters> for Kinematics {
    fn from(dh: DhParameters) -> Kinematics {
        Kinematics::of(&dh)
    }
}

impl From<Kinematics> for DhParameters {
    fn from(kinematics: Kinematics) -> DhParameters {
        kinematics.dh
    }
}

impl Kinematics {
    /// The kinematics of an arm with this table.
    pub fn of(dh: &DhParameters) -> Kinematics {
        let model = model_of(dh);
        Kinematics { dh: *dh, model, chain: Chain::of(dh), nominal: Chain::of(&model.dh) }
    }

    /// The table.
    pub fn dh(&self) -> &DhParameters {
        &self.dh
    }

    /// The links.
    pub fn chain(&self) -> &Chain {
        &self.chain
    }

    /// How far the frames of this arm are from those of the nominal one at most, m: a figure for people, not
    /// a bound.
    pub fn farthest_apart(&self) -> f64 {
        farthest_apart(&self.dh, &self.model.dh)
    }

    /// `base_from_flange` for joint positions `q`.
    pub fn forward(&self, q: &Joints) -> Isometry3<f64> {
        self.chain.forward(q)
    }

    /// All joint solutions of a flange pose, each joint in (-pi, pi]; empty when the pose is out of reach.
    ///
    /// At a wrist singularity (joint 5 at 0 or pi) joint 6 is free and taken as 0.
    pub fn inverse(&self, base_from_flange: &Isometry3<f64>) -> Vec<Joints> {
        let mut solutions: Vec<Joints> = Vec::with_capacity(8);
        let starts = self.starts(base_from_flange);
        for (start, sure) in &starts {
            note(&mut solutions, self.refined(base_from_flange, start, *sure));
        }
        // Where the nominal arm is not at one of its boundaries, no closed-form solution means out of reach.
        if solutions.is_empty() && !(self.is_nominal() && starts.is_empty()) {
            solutions = self.at_singularities(base_from_flange, starts);
        }
        solutions
    }

    /// The solutions of [`Kinematics::inverse`] that are of one family, in the same order. A start of the
    /// closed form that is clearly of another family is not refined.
    pub fn inverse_in(&self, base_from_flange: &Isometry3<f64>, wanted: [bool; 3]) -> Vec<Joints> {
        let other = |start: &Joints| {
            let values = family(&self.nominal, start).into_iter().zip(CLEARLY).zip(wanted);
            let clearly_other = |((value, clearly), wanted): ((f64, f64), bool)| {
                value.abs() > clearly && (value > 0.0) != wanted
            };
            values.into_iter().any(clearly_other)
        };
        let starts = self.starts(base_from_flange);
        let mut solutions = Vec::new();
        let mut others = 0;
        for (start, sure) in &starts {
            if *sure && other(start) {
                others += 1;
            } else {
                note(&mut solutions, self.refined(base_from_flange, start, *sure));
            }
        }
        solutions.retain(|q| self.posture(q) == wanted);
        // If all starts clearly belong to other families, this one has no solution.
        if solutions.is_empty() && (starts.is_empty() || others < starts.len()) {
            solutions = self.inverse(base_from_flange);
            solutions.retain(|q| self.posture(q) == wanted);
        }
        solutions
    }

    /// Of the solutions of a pose and their full turns within `min..max` (rad), the one nearest to `near`
    /// (largest joint difference).
    pub fn inverse_near(
        &self,
        base_from_flange: &Isometry3<f64>,
        near: &Joints,
        range: (f64, f64),
    ) -> Option<Joints> {
        let unwound = self.inverse(base_from_flange).into_iter();
        unwound
            .filter_map(|solution| unwind(&solution, near, range))
            .min_by(|a, b| a.max_difference(near).total_cmp(&b.max_difference(near)))
    }

    /// The solution of a pose that a continuous motion from `start` leads to; `None` where there is none, or
    /// where a singularity lies between.
    pub fn inverse_from(&self, base_from_flange: &Isometry3<f64>, start: &Joints) -> Option<Joints> {
        refine(&self.chain, base_from_flange, *start)
    }

    /// Which of the 2 x 2 x 2 solution families `q` belongs to: wrist in front of the shoulder axis or
    /// behind, sign of the elbow, sign of wrist 2. Within one family a continuous motion stays away from
    /// singularities.
    pub fn posture(&self, q: &Joints) -> [bool; 3] {
        family(&self.chain, q).map(|value| value > 0.0)
    }

    /// The closed form is exact for this arm, except near its singularities and at the edge of reach.
    fn is_nominal(&self) -> bool {
        self.dh == self.model.dh
    }

    /// The closed form's solutions of a pose, and whether each is sure.
    fn starts(&self, base_from_flange: &Isometry3<f64>) -> Vec<(Joints, bool)> {
        let wanted = if self.is_nominal() { SOLUTIONS } else { STARTS };
        inverse_nominal(&self.model.dh, base_from_flange, &[0.0], wanted)
    }

    /// The solution of this arm that a start of the closed form leads to.
    fn refined(&self, base_from_flange: &Isometry3<f64>, start: &Joints, sure: bool) -> Option<Joints> {
        if sure && self.is_nominal() { Some(*start) } else { refine(&self.chain, base_from_flange, *start) }
    }

    /// Solutions where two singularities meet: there the calibrated arm is elsewhere than the nominal one by
    /// far more than the calibration itself. Few poses are like this, and most that are out of reach are
    /// not.
    fn at_singularities(
        &self,
        base_from_flange: &Isometry3<f64>,
        starts: Vec<(Joints, bool)>,
    ) -> Vec<Joints> {
        let nominal = &self.model.dh;
        let at_boundary = !starts.is_empty();
        let far = inverse_nominal(nominal, base_from_flange, AROUND, FAR_STARTS);
        let off = |q: &Joints| pose_error(&self.nominal.forward(q), base_from_flange).norm();
        let starts = starts.into_iter().chain(far).map(|(start, _)| (off(&start), start));
        let mut near: Vec<(f64, Joints)> = starts.filter(|(off, _)| *off < NEAR).collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0));
        let shoulder = wrist_radius(nominal, base_from_flange) < SINGULAR_SHOULDER * nominal.d[3];
        let two_meet = near.iter().any(|(_, q)| {
            let [wrist, elbow] = [4, 2].map(|joint| q.0[joint].sin().abs() < SINGULAR);
            [wrist, elbow, shoulder].into_iter().filter(|near| *near).count() > 1
        });
        let nearest = near.iter().map(|(_, start)| *start).take(NEAREST).filter(|_| at_boundary || two_meet);
        let starts = nearest.chain(all_over(ANYWHERE).filter(|_| two_meet));
        let found = starts.filter_map(|start| refine_damped(&self.chain, base_from_flange, start));
        let mut solutions = Vec::new();
        found.take(SINGULAR_SOLUTIONS).for_each(|joints| note(&mut solutions, Some(joints)));
        solutions
    }
}

/// `base_from_flange` for joint positions `q`.
pub fn forward(dh: &DhParameters, q: &Joints) -> Isometry3<f64> {
    flange_of(dh, q)
}

/// `base_from_link` of the six links, base to flange, where the links truly are (see [`Chain`]).
pub fn link_frames(dh: &DhParameters, q: &Joints) -> [Isometry3<f64>; 6] {
    Chain::of(dh).frames(q)
}

/// Geometric Jacobian in the base frame: rows 0-2 linear velocity of the flange origin, rows 3-5 angular.
pub fn jacobian(dh: &DhParameters, q: &Joints) -> Matrix6<f64> {
    jacobian_at(&link_frames(dh, q))
}

/// The same from the poses of the links.
pub fn jacobian_at(frames: &[Isometry3<f64>; 6]) -> Matrix6<f64> {
    let tip = frames[5].translation.vector;
    let mut jacobian = Matrix6::zeros();
    let mut axis_frame = Isometry3::identity();
    for (i, frame) in frames.iter().enumerate() {
        let axis = axis_frame.rotation * Vector3::z();
        let linear = axis.cross(&(tip - axis_frame.translation.vector));
        jacobian.fixed_view_mut::<3, 1>(0, i).copy_from(&linear);
        jacobian.fixed_view_mut::<3, 1>(3, i).copy_from(&axis);
        axis_frame = *frame;
    }
    jacobian
}

/// How far the wrist is from the shoulder's axis, m.
fn wrist_radius(dh: &DhParameters, base_from_flange: &Isometry3<f64>) -> f64 {
    let wrist = base_from_flange * nalgebra::Point3::new(0.0, 0.0, -dh.d[5]);
    wrist.x.hypot(wrist.y)
}

/// Adds a solution that is not known yet.
fn note(solutions: &mut Vec<Joints>, found: Option<Joints>) {
    let Some(joints) = found else { return };
    let wrapped = Joints(joints.0.map(wrap));
    let apart = |known: &Joints| known.0.iter().zip(wrapped.0).any(|(a, b)| wrap(a - b).abs() > SAME_RAD);
    if solutions.iter().all(apart) {
        solutions.push(wrapped);
    }
}

/// What decides on the family: the wrist's distance before the shoulder axis, m, and two sines.
fn family(chain: &Chain, q: &Joints) -> [f64; 3] {
    let link_1_from_4 = chain.link(1, q.0[1]) * chain.link(2, q.0[2]) * chain.link(3, q.0[3]);
    [link_1_from_4.translation.vector.x, q.0[2].sin(), q.0[4].sin()]
}

/// Adds full turns to each joint so that it comes nearest to `near` inside `range`; `None` if one cannot.
pub fn unwind(solution: &Joints, near: &Joints, range: (f64, f64)) -> Option<Joints> {
    let mut out = *solution;
    for (value, near) in out.0.iter_mut().zip(near.0) {
        let nearest = *value + TAU * ((near - *value) / TAU).round();
        *value = [nearest, nearest - TAU, nearest + TAU]
            .into_iter()
            .filter(|candidate| (range.0..=range.1).contains(candidate))
            .min_by(|a, b| (a - near).abs().total_cmp(&(b - near).abs()))?;
    }
    Some(out)
}

fn wrap(angle: f64) -> f64 {
    if angle > -PI && angle <= PI {
        return angle;
    }
    let turned = angle.rem_euclid(TAU);
    if turned > PI { turned - TAU } else { turned }
}

/// The closed form for the nominal arm, and whether each solution is exact as it is; solutions that are just
/// out of reach are clamped onto the boundary so that the refinement may still find them on the calibrated
/// arm. `turns` are added to joint 1, rad: with others than 0 they are starts only.
fn inverse_nominal(
    dh: &DhParameters,
    base_from_flange: &Isometry3<f64>,
    turns: &[f64],
    wanted: Closed,
) -> Vec<(Joints, bool)> {
    let mut out = Vec::with_capacity(8);
    let p = base_from_flange.translation.vector;
    let rotation = base_from_flange.rotation.to_rotation_matrix().into_inner();
    let [x6, y6, z6] = [0, 1, 2].map(|i| rotation.column(i).into_owned());
    let wrist = p - dh.d[5] * z6;
    let radius = wrist.x.hypot(wrist.y);
    let Some((shoulder, known)) = clamped_acos(dh.d[3] / radius, wanted) else { return out };
    let both = [1.0, -1.0].map(|side| wrist.y.atan2(wrist.x) + side * shoulder + FRAC_PI_2);
    for q1 in both.into_iter().flat_map(|q1| turns.iter().map(move |turn| q1 + turn)) {
        let (s1, c1) = q1.sin_cos();
        // The axis shared by shoulder, elbow and wrist 1.
        let axis = Vector3::new(s1, -c1, 0.0);
        // How the flange is turned against it is joint 5, towards where joint 6. A cosine alone would be too
        // coarse where joint 5 is near its singularity.
        let [x, y, z] = [x6, y6, z6].map(|side| axis.dot(&side));
        let exact_bend = x.hypot(y).atan2(z);
        let bend = exact_bend.clamp(wanted.apart, PI - wanted.apart);
        let sure = known && bend == exact_bend;
        for q5 in [bend, -bend] {
            let (s5, c5) = q5.sin_cos();
            let q6 = if exact_bend.sin() < 1e-12 { 0.0 } else { (-y * s5.signum()).atan2(x * s5.signum()) };
            let (s6, c6) = q6.sin_cos();
            // Frame 4, in which joint 5 turns: its x axis, and its origin. The products of the links, with
            // the nominal twists, written out.
            let x4 = c5 * (c6 * x6 - s6 * y6) - s5 * z6;
            let from_1 = wrist + dh.d[4] * (s6 * x6 + c6 * y6) - Vector3::new(0.0, 0.0, dh.d[0]);
            let wrist_1 = Planar {
                reach: [c1 * from_1.x + s1 * from_1.y, from_1.z],
                angle: x4.z.atan2(c1 * x4.x + s1 * x4.y),
            };
            planar_pair(dh, &wrist_1, ([q1, q5, q6], sure), wanted, &mut out);
        }
    }
    out
}

/// Where wrist 1 is to be in the plane of the arm: from the shoulder, m, and how it is turned, rad.
struct Planar {
    reach: [f64; 2],
    angle: f64,
}

/// Shoulder, elbow and wrist 1 as a planar two-link arm: both elbow solutions.
fn planar_pair(
    dh: &DhParameters,
    &Planar { reach: [x, y], angle }: &Planar,
    (known, sure): ([f64; 3], bool),
    wanted: Closed,
    out: &mut Vec<(Joints, bool)>,
) {
    let [q1, q5, q6] = known;
    let (upper, fore) = (dh.a[1], dh.a[2]);
    let cosine = (x * x + y * y - upper * upper - fore * fore) / (2.0 * upper * fore);
    let Some((elbow, exact)) = clamped_acos(cosine, wanted) else { return };
    let (sin, cos) = elbow.sin_cos();
    let (towards, bent) = (y.atan2(x), (fore * sin).atan2(upper + fore * cos));
    for (q2, q3) in [(towards - bent, elbow), (towards + bent, -elbow)] {
        let q4 = angle - q2 - q3;
        out.push((Joints([q1, q2, q3, q4, q5, q6].map(wrap)), sure && exact));
    }
}

/// acos that forgives what is just beyond [-1, 1] and refuses more, and NaN; and whether the angle is exact.
fn clamped_acos(cosine: f64, Closed { beyond, apart }: Closed) -> Option<(f64, bool)> {
    let most = apart.cos();
    let exact = cosine.abs() < most.min(1.0 - 1e-6);
    (cosine.abs() <= 1.0 + beyond).then(|| (cosine.clamp(-most, most).acos(), exact))
}

/// Newton on the pose error; `None` when it does not converge (out of reach, or in a singularity).
fn refine(chain: &Chain, target: &Isometry3<f64>, start: Joints) -> Option<Joints> {
    let mut q = start;
    for _ in 0..MAX_NEWTON_STEPS {
        let frames = chain.frames(&q);
        let error = pose_error(&frames[5], target);
        if error.norm() < POSE_TOLERANCE {
            return Some(q);
        }
        // Damping far below the arm's own scale only keeps an exactly singular start solvable.
        let j = jacobian_at(&frames);
        let damped = j.transpose() * j + Matrix6::identity() * 1e-12;
        let step = damped.cholesky()?.solve(&(j.transpose() * error));
        if !step.iter().all(|value| value.is_finite()) {
            return None;
        }
        // Near a singularity a whole step would lead far away.
        let share = (MAX_STEP / step.amax()).min(1.0);
        for (value, delta) in q.0.iter_mut().zip(step.iter()) {
            *value += share * delta;
        }
    }
    (pose_error(&chain.forward(&q), target).norm() < 1e-9).then_some(q)
}

/// The same by Levenberg and Marquardt, for starts near a singularity: slower, and it comes nearer with
/// every step.
fn refine_damped(chain: &Chain, target: &Isometry3<f64>, start: Joints) -> Option<Joints> {
    let error_at = |q: &Joints| pose_error(&chain.forward(q), target);
    let (mut q, mut damping) = (start, 1e-4);
    let mut error = error_at(&q);
    let mut before = f64::INFINITY;
    for step in 0..MAX_DAMPED_STEPS {
        if error.norm() < POSE_TOLERANCE {
            return Some(q);
        }
        // A pose that is out of reach comes to rest before it is reached.
        if step % STEPS_TO_HALVE == 0 && error.norm() > 0.5 * std::mem::replace(&mut before, error.norm()) {
            return None;
        }
        let j = jacobian_at(&chain.frames(&q));
        let damped = j.transpose() * j + Matrix6::identity() * damping;
        let step = damped.cholesky()?.solve(&(j.transpose() * error));
        if !step.iter().all(|value| value.is_finite()) {
            return None;
        }
        let next = Joints(std::array::from_fn(|i| q.0[i] + step[i]));
        let next_error = error_at(&next);
        if next_error.norm() < error.norm() {
            (q, error, damping) = (next, next_error, (damping * 0.2).max(1e-14));
        } else {
            damping *= 5.0;
        }
    }
    (error.norm() < 1e-9).then_some(q)
}

/// Translation (m) and rotation vector (rad), both in the base frame, that carry `from` to `to`.
pub fn pose_error(from: &Isometry3<f64>, to: &Isometry3<f64>) -> Vector6<f64> {
    let linear = to.translation.vector - from.translation.vector;
    let angular = (to.rotation * from.rotation.inverse()).scaled_axis();
    Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
}
