//! Calibrations of real arms that were published, for tests of this and of other crates. Plain data.
//!
//! Sources: the deviations from a nominal UR10 that the test of the vendor's ROS driver
//! (`ur_calibration/test/calibration_test.cpp`) has, which look like those of three arms, two of them with
//! offsets of hundreds of metres; and the kinematics of a UR5e in a tutorial (checksum
//! calib_14698139022496758595).

use crate::models::{ARM_MODELS, DhParameters};
use nalgebra::{Isometry3, Translation3, UnitQuaternion};

/// Deviations from the nominal table: d, a, theta, alpha.
type Deviations = [[f64; 6]; 4];

const DEVIATIONS: [Deviations; 3] = [
    [
        [0.000656092, 1.444216238, 0.854147724, -2.298942588, -1.5735e-5, 1.9072e-5],
        [4.6311e-5, -0.000125683, 0.001862166, 9.9186e-5, 4.2155e-6, 0.0],
        [-7.29007e-5, -0.017138973, -0.037071594, 0.054279462, 1.489e-7, 1.5515e-5],
        [0.000211988, -0.007255363, -0.013483227, 0.001349582, -0.001263136, 0.0],
    ],
    [
        [-0.000144895, 303.469135666158, -309.883943077897, 6.414599043974, -4.48233e-5, -0.000870714],
        [0.000108651, 0.240324175250532, 0.001806281802135, 2.63076e-5, 3.96639e-6, 0.0],
        [1.59614e-7, -0.91720962152883, 7.129361313464995, 0.071029902942439, -1.64259e-6, 9.17287e-8],
        [-0.000444781952842, -0.001602151125312, 0.006319177933312, -0.001650552473408, 0.000763682516, 0.0],
    ],
    [
        [-0.000160188, 439.140974079901, -446.027059806332, 6.886186896423602, -3.86588e-5, -0.000879083],
        [2.12235e-5, 0.632017132627701, 0.002298336388902, -4.61409e-5, -6.3928e-5, 0.0],
        [-2.41478e-7, 1.602339523826946, -1.686071907521713, 0.083733114770012, -1.0126e-7, 3.91986e-8],
        [-0.000650246557584, 0.001394166668226, 0.00693818880326, -0.00081164156239, 0.00041112, 0.0],
    ],
];

/// The tables of three arms.
pub const PUBLISHED: [DhParameters; 3] = [of(&DEVIATIONS[0]), of(&DEVIATIONS[1]), of(&DEVIATIONS[2])];

const UR10: usize = 8;

const fn of(deviations: &Deviations) -> DhParameters {
    let mut dh = ARM_MODELS[UR10].dh;
    let mut i = 0;
    while i < 6 {
        dh.d[i] += deviations[0][i];
        dh.a[i] += deviations[1][i];
        dh.theta[i] += deviations[2][i];
        dh.alpha[i] += deviations[3][i];
        i += 1;
    }
    dh
}

/// x, y, z (m), roll, pitch, yaw (rad) of the six joints of a UR5e.
pub const PUBLISHED_UR5E: [[f64; 6]; 6] = [
    [0.0, 0.0, 0.1627122445743823, 0.0, 0.0, 5.707382499074709e-8],
    [0.0001820110310317555, 0.0, 0.0, 1.571314866107557, 0.0, 1.12157791523139e-6],
    [-0.425170344631444, 0.0, 0.0, 0.001444320579376547, -0.0004261037597356073, 4.642343028998144e-6],
    [
        -0.392646598028507,
        -0.0004030322688786401,
        0.1331063119537431,
        0.003027888244224887,
        -0.001185722601572754,
        -2.569771029137183e-6,
    ],
    [
        -7.071306960874342e-6,
        -0.09960359635829828,
        -3.198591184007791e-7,
        1.570799538115874,
        0.0,
        1.304820282092834e-6,
    ],
    [
        1.369362273278849e-5,
        0.09958483828527664,
        9.521789789182917e-5,
        1.571752475045119,
        std::f64::consts::PI,
        3.141592510837143,
    ],
];

/// The poses of joints from x, y, z, roll, pitch, yaw.
pub fn described(joints: &[[f64; 6]; 6]) -> [Isometry3<f64>; 6] {
    joints.map(|[x, y, z, roll, pitch, yaw]| {
        let turn = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
        Isometry3::from_parts(Translation3::new(x, y, z), turn)
    })
}
