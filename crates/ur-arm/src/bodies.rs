//! Capsules that contain the links of six arms: what a collision check takes for the arm.
//!
//! In: the name of an arm. Out: the capsules of its base and six links, in the frames of its nominal
//! Denavit-Hartenberg parameters, m. Pure.
//!
//! The numbers are computed from the collision and visual meshes of the vendor's public description package
//! (version 2.4.5; those of UR20 and UR30 are published under the vendor's terms for graphical
//! documentation): each vertex and each split triangle of a link lies at least 1 mm inside of its capsules,
//! which overestimate it by 5 to 15 mm on average and at most by 69 mm, at the flat ends of the joints.
//! Cables, screws and tools are not in them. The capsule of the base bulges below the mounting surface.

/// Everything within `radius` of the segment from `a` to `b`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Capsule {
    /// One end of the segment, m.
    pub a: [f64; 3],
    /// The other end, m.
    pub b: [f64; 3],
    /// m.
    pub radius: f64,
}

/// The names of the bodies, base first: body `i` moves with frame `i`.
pub const BODY_NAMES: [&str; 7] =
    ["base", "shoulder", "upper arm", "forearm", "wrist 1", "wrist 2", "wrist 3"];

/// Pairs of bodies (by index) whose capsules overlap in every or in harmless positions, although the links
/// cannot touch: neighbours, and three pairs that the joints keep apart by their construction.
pub const HARMLESS_PAIRS: [(usize, usize); 9] =
    [(0, 1), (1, 2), (2, 3), (3, 4), (4, 5), (5, 6), (0, 2), (4, 6), (3, 5)];

/// Capsules of base, shoulder, upper arm, forearm and three wrists.
pub type LinkCapsules = [&'static [Capsule]; 7];

/// The capsules of an arm; `None` for one whose dimensions are not published.
pub fn capsules(model: &str) -> Option<&'static LinkCapsules> {
    TABLE.iter().find(|(name, _)| *name == model).map(|(_, capsules)| capsules)
}

const fn capsule(a: [f64; 3], b: [f64; 3], radius: f64) -> Capsule {
    Capsule { a, b, radius }
}

const TABLE: &[(&str, LinkCapsules)] = &[
    (
        "UR3e",
        [
            &[capsule([0.0, 0.0, 0.0208], [0.0, 0.0, 0.0446], 0.0685)],
            &[
                capsule([0.0001, -0.0326, 0.0], [-0.0001, -0.0002, 0.0385], 0.0522),
                capsule([-0.0002, 0.0145, -0.003], [0.0005, 0.0292, 0.0039], 0.0503),
            ],
            &[
                capsule([0.2298, -0.0001, 0.1208], [0.2424, 0.0001, 0.1139], 0.0712),
                capsule([0.0489, 0.0001, 0.1198], [0.1543, -0.0015, 0.121], 0.0429),
                capsule([0.0016, 0.0001, 0.1038], [0.0044, -0.0011, 0.1325], 0.0551),
            ],
            &[
                capsule([0.1802, -0.0004, 0.0279], [0.2138, 0.0, 0.0591], 0.0394),
                capsule([0.0417, 0.0, 0.027], [0.1351, 0.0007, 0.0262], 0.0348),
                capsule([0.0036, 0.0005, 0.0149], [0.0017, 0.0005, 0.0495], 0.0439),
            ],
            &[
                capsule([0.0, -0.0367, -0.0004], [0.0, -0.0007, -0.0212], 0.037),
                capsule([0.0, 0.0001, 0.0405], [0.0, 0.0, 0.0046], 0.034),
            ],
            &[
                capsule([-0.0003, -0.0044, 0.0073], [0.0, 0.0004, 0.0418], 0.034),
                capsule([0.0, 0.001, -0.0217], [0.0, 0.0198, -0.0001], 0.0364),
            ],
            &[capsule([0.0003, -0.0016, -0.0213], [-0.0001, 0.0, -0.0212], 0.0388)],
        ],
    ),
    (
        "UR5e",
        [
            &[capsule([0.0, 0.0, 0.0271], [0.0, 0.0, 0.0436], 0.0813)],
            &[capsule([-0.0007, -0.0064, 0.0022], [0.0002, -0.0004, 0.0148], 0.0844)],
            &[
                capsule([0.4033, -0.0005, 0.1401], [0.4255, 0.0, 0.1337], 0.0841),
                capsule([0.1022, 0.0015, 0.1372], [0.3224, 0.0011, 0.1359], 0.0517),
                capsule([0.0005, 0.0, 0.1228], [0.02, 0.0, 0.1417], 0.0863),
            ],
            &[
                capsule([0.3461, 0.0003, 0.0076], [0.3933, 0.0, 0.0487], 0.0605),
                capsule([0.0477, 0.0003, 0.0066], [0.2939, -0.0001, 0.0066], 0.0398),
                capsule([0.0005, 0.0, 0.019], [0.0032, 0.0002, -0.0021], 0.0567),
            ],
            &[
                capsule([0.0, -0.0506, -0.0003], [-0.0002, -0.0005, 0.0304], 0.0451),
                capsule([0.0001, -0.0021, -0.033], [-0.0008, 0.0008, -0.01], 0.0426),
            ],
            &[
                capsule([0.0006, -0.005, 0.0007], [0.0, 0.0003, 0.0419], 0.0405),
                capsule([0.0001, 0.0019, -0.029], [0.0, 0.0274, -0.0007], 0.0439),
            ],
            &[capsule([0.0003, 0.0012, -0.0273], [-0.0012, -0.0022, -0.0271], 0.0429)],
        ],
    ),
    (
        "UR10e",
        [
            &[capsule([0.0005, -0.001, 0.0324], [0.0, 0.0001, 0.0325], 0.1015)],
            &[
                capsule([0.0, -0.058, 0.0], [0.0006, -0.0261, -0.0062], 0.0798),
                capsule([0.0001, 0.0364, 0.0075], [0.0, -0.0003, 0.054], 0.087),
            ],
            &[
                capsule([0.5911, -0.0007, 0.1787], [0.6124, -0.0001, 0.1738], 0.111),
                capsule([0.0731, -0.0002, 0.1765], [0.4721, 0.0016, 0.1748], 0.0646),
                capsule([0.0006, 0.0, 0.1547], [0.012, -0.0006, 0.1797], 0.0818),
            ],
            &[
                capsule([0.5137, -0.0002, 0.0384], [0.5725, 0.0, 0.0784], 0.063),
                capsule([0.0636, -0.0001, 0.0391], [0.4708, -0.001, 0.0384], 0.0484),
                capsule([0.0024, 0.0, 0.061], [0.0078, 0.0005, 0.0366], 0.0657),
            ],
            &[
                capsule([0.0, -0.0467, -0.0005], [-0.0003, -0.0035, -0.0251], 0.0515),
                capsule([0.0, 0.0001, 0.0518], [0.0001, 0.0043, 0.0001], 0.0489),
            ],
            &[
                capsule([-0.0006, -0.0064, 0.009], [0.0, 0.0005, 0.0556], 0.048),
                capsule([0.0, 0.0041, -0.0234], [0.0, 0.0301, 0.0003], 0.0521),
            ],
            &[capsule([-0.0001, -0.0028, -0.0295], [0.0, 0.0008, -0.029], 0.0506)],
        ],
    ),
    (
        "UR16e",
        [
            &[capsule([0.0005, -0.001, 0.0324], [0.0, 0.0001, 0.0325], 0.1015)],
            &[
                capsule([0.0, -0.058, 0.0], [0.0006, -0.0261, -0.0062], 0.0798),
                capsule([0.0001, 0.0364, 0.0075], [0.0, -0.0003, 0.054], 0.087),
            ],
            &[
                capsule([0.4526, 0.0004, 0.1775], [0.4782, -0.0001, 0.1741], 0.1109),
                capsule([0.081, -0.0003, 0.1745], [0.3359, 0.0007, 0.1761], 0.0681),
                capsule([0.0024, 0.0001, 0.1571], [0.0121, 0.0029, 0.1768], 0.0848),
            ],
            &[
                capsule([0.3025, 0.0002, 0.0395], [0.361, -0.0001, 0.0792], 0.063),
                capsule([0.0632, -0.0001, 0.0396], [0.2553, -0.0004, 0.0398], 0.0508),
                capsule([0.0011, -0.0002, 0.0606], [0.0081, -0.0004, 0.0367], 0.0654),
            ],
            &[
                capsule([0.0, -0.0467, -0.0005], [-0.0003, -0.0035, -0.0251], 0.0515),
                capsule([0.0, 0.0001, 0.0518], [0.0001, 0.0043, 0.0001], 0.0489),
            ],
            &[
                capsule([-0.0006, -0.0064, 0.009], [0.0, 0.0005, 0.0556], 0.048),
                capsule([0.0, 0.0041, -0.0234], [0.0, 0.0301, 0.0003], 0.0521),
            ],
            &[capsule([-0.0001, -0.0028, -0.0295], [0.0, 0.0008, -0.029], 0.0506)],
        ],
    ),
    (
        "UR20",
        [
            &[capsule([-0.0004, 0.0002, 0.023], [0.0002, -0.0001, 0.0228], 0.1256)],
            &[
                capsule([-0.0004, 0.0109, 0.0143], [-0.0001, -0.0749, 0.0], 0.1057),
                capsule([0.0, 0.0, 0.1052], [0.0001, 0.0001, 0.1017], 0.0979),
            ],
            &[
                capsule([0.8623, 0.0, 0.1962], [0.8393, -0.0001, 0.2568], 0.1137),
                capsule([0.1282, -0.0045, 0.2647], [0.7635, -0.0003, 0.2577], 0.0988),
                capsule([-0.0002, -0.0002, 0.1952], [0.0173, 0.0026, 0.2577], 0.0932),
            ],
            &[
                capsule([0.714, -0.0011, 0.0423], [0.7283, -0.0002, 0.0995], 0.0908),
                capsule([0.1196, -0.0036, 0.041], [0.6518, 0.0005, 0.0423], 0.0776),
                capsule([0.0006, -0.0002, 0.083], [0.0155, -0.0008, 0.0426], 0.0717),
            ],
            &[
                capsule([-0.0014, -0.0618, -0.0002], [0.0034, -0.0611, -0.0002], 0.0546),
                capsule([-0.0009, -0.0081, -0.001], [-0.0001, -0.0001, 0.0553], 0.0593),
            ],
            &[
                capsule([-0.0015, -0.0022, 0.0211], [-0.0001, 0.0002, 0.0667], 0.0549),
                capsule([-0.0001, 0.0062, -0.0098], [0.0, 0.0503, 0.0], 0.0572),
            ],
            &[capsule([0.0, 0.0, -0.043], [0.0, 0.0, -0.0287], 0.058)],
        ],
    ),
    (
        "UR30",
        [
            &[capsule([-0.0004, 0.0002, 0.023], [0.0002, -0.0001, 0.0228], 0.1256)],
            &[
                capsule([-0.0004, 0.0109, 0.0143], [-0.0001, -0.0749, 0.0], 0.1057),
                capsule([0.0, 0.0, 0.1052], [0.0001, 0.0001, 0.1017], 0.0979),
            ],
            &[
                capsule([0.6368, 0.0, 0.1909], [0.6172, 0.0011, 0.2584], 0.1104),
                capsule([0.1315, -0.0016, 0.2577], [0.5404, -0.0005, 0.258], 0.0927),
                capsule([0.0001, -0.0001, 0.1938], [0.018, 0.0003, 0.2637], 0.099),
            ],
            &[
                capsule([0.4858, -0.0003, 0.0421], [0.5039, -0.0001, 0.095], 0.0933),
                capsule([0.1192, 0.001, 0.0462], [0.4163, -0.0002, 0.0426], 0.0797),
                capsule([0.0, -0.0003, 0.0858], [0.0153, 0.0007, 0.0423], 0.0685),
            ],
            &[
                capsule([-0.0014, -0.0618, -0.0002], [0.0034, -0.0611, -0.0002], 0.0546),
                capsule([-0.0009, -0.0081, -0.001], [-0.0001, -0.0001, 0.0553], 0.0593),
            ],
            &[
                capsule([-0.0015, -0.0022, 0.0211], [-0.0001, 0.0002, 0.0667], 0.0549),
                capsule([-0.0001, 0.0062, -0.0098], [0.0, 0.0503, 0.0], 0.0572),
            ],
            &[capsule([0.0, 0.0, -0.043], [0.0, 0.0, -0.0287], 0.058)],
        ],
    ),
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinematics::{ARM_MODELS, link_frames};
    use cell_values::units::Joints;
    use nalgebra::{Isometry3, Point3};

    /// A position of an arm and the clearance of each pair of bodies in it, m, base-shoulder first, computed
    /// with another program from the same meshes.
    struct Position {
        model: &'static str,
        q_deg: [f64; 6],
        clearance: [f64; 21],
    }

    const POSITIONS: &[Position] = &[
        Position {
            model: "UR3e",
            q_deg: [10.0, -80.0, 95.0, -100.0, -85.0, 20.0],
            clearance: [
                -0.04605, 0.01754, 0.23941, 0.28784, 0.32831, 0.30709, -0.04799, 0.1267, 0.2169, 0.28267,
                0.26702, -0.04977, 0.09876, 0.18521, 0.21831, -0.03603, 0.02533, 0.06005, -0.04535, 0.01111,
                -0.04373,
            ],
        },
        Position {
            model: "UR5e",
            q_deg: [10.0, -80.0, 95.0, -100.0, -85.0, 20.0],
            clearance: [
                -0.05318, 0.01319, 0.39722, 0.49729, 0.56219, 0.54094, -0.0496, 0.27916, 0.41378, 0.49364,
                0.47972, -0.07269, 0.22951, 0.3326, 0.37189, -0.0381, 0.03486, 0.07235, -0.04709, 0.01148,
                -0.05299,
            ],
        },
        Position {
            model: "UR10e",
            q_deg: [10.0, -80.0, 95.0, -100.0, -85.0, 20.0],
            clearance: [
                -0.0911, 0.01534, 0.59057, 0.74026, 0.80886, 0.78695, -0.0782, 0.42603, 0.63981, 0.73043,
                0.71466, -0.06849, 0.41197, 0.52503, 0.57196, -0.05072, 0.02813, 0.07627, -0.06305, 0.01092,
                -0.06698,
            ],
        },
        Position {
            model: "UR16e",
            q_deg: [10.0, -80.0, 95.0, -100.0, -85.0, 20.0],
            clearance: [
                -0.0911, 0.0156, 0.45711, 0.53495, 0.5861, 0.56257, -0.0778, 0.2935, 0.41806, 0.49949,
                0.48197, -0.06986, 0.1991, 0.3121, 0.36148, -0.05005, 0.02795, 0.07584, -0.06305, 0.01092,
                -0.06698,
            ],
        },
        Position {
            model: "UR20",
            q_deg: [10.0, -80.0, 95.0, -100.0, -85.0, 20.0],
            clearance: [
                -0.0929, 0.05035, 0.85431, 1.0462, 1.11738, 1.0763, -0.1206, 0.65293, 0.91681, 1.00726,
                0.97733, -0.0883, 0.56878, 0.67975, 0.73479, -0.07008, 0.03216, 0.10302, -0.0628, 0.03511,
                -0.0683,
            ],
        },
        Position {
            model: "UR30",
            q_deg: [10.0, -80.0, 95.0, -100.0, -85.0, 20.0],
            clearance: [
                -0.0929, 0.05046, 0.62753, 0.75516, 0.82041, 0.77885, -0.1226, 0.42625, 0.61706, 0.70795,
                0.67765, -0.0935, 0.3441, 0.45495, 0.51951, -0.06967, 0.03293, 0.1042, -0.0628, 0.03511,
                -0.0683,
            ],
        },
    ];

    fn apart(a: &Capsule, at: &Isometry3<f64>, b: &Capsule, bt: &Isometry3<f64>) -> f64 {
        let point = |frame: &Isometry3<f64>, p: [f64; 3], q: [f64; 3], share: f64| {
            frame * Point3::from([0, 1, 2].map(|i: usize| p[i] + share * (q[i] - p[i])))
        };
        let steps = (0..=60).flat_map(|i| (0..=60).map(move |k| (f64::from(i) / 60.0, f64::from(k) / 60.0)));
        let nearest = steps
            .map(|(s, t)| (point(at, a.a, a.b, s) - point(bt, b.a, b.b, t)).norm())
            .fold(f64::INFINITY, f64::min);
        nearest - a.radius - b.radius
    }

    #[test]
    fn capsules_lie_where_another_program_found_them() {
        for position in POSITIONS {
            let arm = ARM_MODELS.iter().find(|arm| arm.name == position.model).expect("known");
            let links = capsules(position.model).expect("published");
            let q = Joints(position.q_deg.map(f64::to_radians));
            let mut frames = vec![Isometry3::identity()];
            frames.extend(link_frames(&arm.dh, &q));
            let pairs = (0..7).flat_map(|i| (i + 1..7).map(move |k| (i, k)));
            for ((i, k), expected) in pairs.zip(position.clearance) {
                let each = links[i].iter().flat_map(|a| links[k].iter().map(move |b| (a, b)));
                let found =
                    each.map(|(a, b)| apart(a, &frames[i], b, &frames[k])).fold(f64::INFINITY, f64::min);
                let names = (position.model, BODY_NAMES[i], BODY_NAMES[k]);
                // The steps along the segments leave a millimetre or two, never on the near side.
                assert!((-2e-4..3e-3).contains(&(found - expected)), "{names:?}: {found} for {expected}");
            }
        }
    }

    #[test]
    fn an_arm_without_published_meshes_has_none() {
        assert!(capsules("UR5").is_none() && capsules("UR15").is_none());
    }
}
