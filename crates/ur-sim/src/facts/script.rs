//! Examples of the script manual, evaluated.

use crate::facts::rig::{Ran, evaluated, ran, value};
use crate::facts::row::source::SCRIPT;
use crate::facts::row::{Fact, Section, figures, number, numbers, text};

/// Expression of the manual, what it returns there, and to how many places.
#[expect(clippy::approx_constant, reason = "as the manual writes it")]
const EXAMPLES: &[(&str, &[f64], f64)] = &[
    ("acos(0.707)", &[0.785], 1e-3),
    ("asin(0.707)", &[0.785], 1e-3),
    ("atan(1.)", &[0.785], 1e-3),
    ("atan2(.5,.5)", &[0.785], 1e-3),
    ("binary_list_to_integer([True,False,False,True])", &[9.0], 0.0),
    ("ceil(1.43)", &[2.0], 0.0),
    ("cos(1.57)", &[0.0], 1e-3),
    ("d2r(90)", &[1.57], 1e-2),
    ("floor(1.53)", &[1.0], 0.0),
    ("get_list_length([1,3,3,6,2])", &[5.0], 0.0),
    ("interpolate_pose(p[.2,.2,.4,0,0,0], p[.2,.2,.6,0,0,0], .5)", &[0.2, 0.2, 0.5, 0.0, 0.0, 0.0], 1e-6),
    ("inv([[0,1,0],[0,0,1],[1,0,0]])", &[0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0], 1e-9),
    ("inv(p[.2,.5,.1,1.57,0,3.14])", &[0.19324, 0.41794, -0.29662, 1.23993, 0.0, 2.47985], 1e-5),
    ("length(\"here I am\")", &[9.0], 0.0),
    ("log(10.,4.)", &[0.60206], 1e-5),
    ("norm(-5.3)", &[5.3], 1e-9),
    ("norm(-8)", &[8.0], 0.0),
    ("norm(p[-.2,.2,-.2,-1.57,0,3.14])", &[3.52768], 1e-5),
    ("normalize([0, 5, 0])", &[0.0, 1.0, 0.0], 1e-9),
    ("normalize([0, 1, 1])", &[0.0, 0.707, 0.707], 1e-3),
    ("pose_add(p[.2,.5,.1,1.57,0,0], p[.2,.5,.6,1.57,0,0])", &[0.4, 1.0, 0.7, 3.14, 0.0, 0.0], 1e-6),
    ("pose_inv(p[.2,.5,.1,1.57,0,3.14])", &[0.19324, 0.41794, -0.29662, 1.23993, 0.0, 2.47985], 1e-5),
    ("pose_sub(p[.2,.5,.1,1.57,0,0], p[.2,.5,.6,1.57,0,0])", &[0.0, 0.0, -0.5, 0.0, 0.0, 0.0], 1e-6),
    (
        "pose_trans(p[.2,.5,.1,1.57,0,0], p[.2,.5,.6,1.57,0,0])",
        &[0.4, -0.0996, 0.60048, 3.14, 0.0, 0.0],
        1e-5,
    ),
    ("pow(5.,3)", &[125.0], 1e-9),
    ("r2d(1.57)", &[90.0], 1e-1),
    ("rotvec2rpy([3.14,1.57,0])", &[-2.80856, -0.16202, 0.9], 1e-5),
    ("rpy2rotvec([3.14,1.57,0])", &[2.22153, 0.00177, -2.21976], 1e-5),
    ("sin(1.57)", &[1.0], 1e-3),
    ("size(\"here I am\")", &[9.0], 0.0),
    ("size([1,2,3,4,5])", &[5.0], 0.0),
    ("size([[1,2],[3,4],[5,6]])", &[3.0, 2.0], 0.0),
    ("sqrt(9)", &[3.0], 0.0),
    ("tan(.7854)", &[1.0], 1e-4),
    ("get_steptime()", &[0.002], 1e-9),
];

/// Statements that the manual rules out, and like ones that it allows.
const REFUSED: &[(&str, Limit)] = &[
    ("acos(1.1), beyond [-1, 1]", Limit { beyond: "acos(1.1)", at: "acos(1)" }),
    ("sqrt(-1)", Limit { beyond: "sqrt(-1)", at: "sqrt(0)" }),
    ("log(1, 2), base 1", Limit { beyond: "log(1, 2)", at: "log(2, 2)" }),
    ("pow(0, -1)", Limit { beyond: "pow(0, -1)", at: "pow(0, 1)" }),
    ("normalize([0, 0, 0])", Limit { beyond: "normalize([0, 0, 0])", at: "normalize([0, 0, 1])" }),
    (
        "servoj with lookahead_time 0.25, beyond [0.03, 0.2]",
        Limit {
            beyond: "servoj(get_actual_joint_positions(), 0, 0, 0.002, 0.25, 300)",
            at: "servoj(get_actual_joint_positions(), 0, 0, 0.002, 0.2, 300)",
        },
    ),
    (
        "servoj with gain 50, beyond [100, 2000]",
        Limit {
            beyond: "servoj(get_actual_joint_positions(), 0, 0, 0.002, 0.1, 50)",
            at: "servoj(get_actual_joint_positions(), 0, 0, 0.002, 0.1, 100)",
        },
    ),
    (
        "force_mode_set_gain_scaling(2.1), beyond [0, 2]",
        Limit { beyond: "force_mode_set_gain_scaling(2.1)", at: "force_mode_set_gain_scaling(2)" },
    ),
    (
        "force_mode_set_damping(1.1), beyond [0, 1]",
        Limit { beyond: "force_mode_set_damping(1.1)", at: "force_mode_set_damping(1)" },
    ),
    (
        "set_target_payload with an inertia beyond 133 kg m2",
        Limit {
            beyond: "set_target_payload(1, [0,0,0], [134,0,0,0,0,0])",
            at: "set_target_payload(1, [0,0,0], [133,0,0,0,0,0])",
        },
    ),
    (
        "path_offset_set_alpha_filter(1.5), beyond [0, 1]",
        Limit { beyond: "path_offset_set_alpha_filter(1.5)", at: "path_offset_set_alpha_filter(1)" },
    ),
    (
        "write_output_integer_register(48, 1), beyond 47",
        Limit { beyond: "write_output_integer_register(48, 1)", at: "write_output_integer_register(47, 1)" },
    ),
    ("set_flag(33, True), beyond 32", Limit { beyond: "set_flag(33, True)", at: "set_flag(32, True)" }),
    (
        "estimate_payload of three poses",
        Limit {
            beyond: "estimate_payload([p[0,0,0,0,0,0], p[0,0,0,1,0,0], p[0,0,0,0,1,0]], [p[0,0,0,0,0,0], p[0,0,0,0,0,0], p[0,0,0,0,0,0]])",
            at: "estimate_payload([p[0,0,0,0,0,0], p[0,0,0,1,0,0], p[0,0,0,0,1,0], p[0,0,0,-1,0,0]], [p[0,0,-10,0,0,0], p[0,0,-10,0,0,0], p[0,0,-10,0,0,0], p[0,0,-10,0,0,0]])",
        },
    ),
];

/// Two statements of one function: the manual allows the one and rules the other out, for their values.
struct Limit {
    beyond: &'static str,
    at: &'static str,
}

impl Limit {
    /// What becomes of the statement beyond the limit, unless the other one is not carried out either: then
    /// it is not the limit that counts.
    fn answer(&self) -> &'static str {
        match (ran(self.beyond), ran(self.at)) {
            (Ran::Exception, Ran::Through) => "runtime exception",
            (Ran::Exception, _) => "runtime exception, also within the limit",
            (Ran::Through, _) => "accepted",
            (Ran::Neither, _) => "not carried out",
        }
    }
}

/// The table.
pub fn section() -> Section {
    let mut rows: Vec<Fact> = EXAMPLES
        .iter()
        .map(|(expression, values, within)| {
            numbers(expression, SCRIPT, figures(values, *within, ""), evaluated(expression))
        })
        .collect();
    let refused = |(what, limit): &(&'static str, Limit)| {
        text(what, SCRIPT, "runtime exception", limit.answer().to_owned())
    };
    rows.extend(REFUSED.iter().map(refused));
    rows.push(text("make_list(5, \"a\")", SCRIPT, "[a, a, a, a, a]", value("make_list(5, \"a\")")));
    rows.push(number(
        "integer_to_binary_list(57), its length",
        SCRIPT,
        figures(&[32.0], 0.0, ""),
        evaluated("length(integer_to_binary_list(57))").first().copied().unwrap_or(f64::NAN),
    ));
    Section { title: "Script examples", rows }
}
