//! What the controller's error codes mean, as far as they go with a stop of the arm.
//!
//! In: the code and argument of an error message on the primary interface. Out: a few words. The maker's
//! error code directory has all of them; here are those that an operator meets at a stop, in our own words
//! (codes 150 to 210 of PolyScope 5, and 403).

/// Joints as the argument counts them.
const JOINTS: [&str; 6] = ["base", "shoulder", "elbow", "wrist 1", "wrist 2", "wrist 3"];

/// Code, words, and whether the argument names a joint.
const CODES: [(i32, &str, bool); 23] = [
    (150, "a joint is near the limit of its range", false),
    (151, "the tool's direction is near its limits", false),
    (152, "the arm is near a safety plane", false),
    (153, "a joint does not follow its path", true),
    (154, "the arm is in a singularity", false),
    (155, "the arm cannot hold its position: check the payload", false),
    (156, "wrong payload or mounting, or the arm was pushed as freedrive began", false),
    (157, "collision", true),
    (158, "collision, or the payload of 0 kg is wrong", true),
    (159, "a joint does not follow its path, or the payload of 0 kg is wrong", true),
    (160, "the arm was switched off because two measurements of a joint disagreed", false),
    (161, "the joints were moved while the arm was off", false),
    (162, "the payload's mass or centre of gravity is probably wrong", false),
    (163, "one joint has had over 50 protective stops in 8 hours", true),
    (164, "a wrist is near a safety plane", false),
    (172, "the joints are not in the mode that the motion needs", false),
    (173, "the motion needs too much torque", true),
    (174, "the motion needs too sudden a change of torque", true),
    (191, "a limit of the safety configuration was violated", false),
    (204, "the path changes faster than the arm can follow", false),
    (209, "the program requested the stop", false),
    (210, "a program came over a connection that was made in local control", false),
    (403, "a hand could be clamped between forearm and tool", false),
];

/// What a code means; `None` for one that is not in the table.
pub fn meaning(code: i32, argument: i32) -> Option<String> {
    let (_, words, by_joint) = CODES.iter().find(|(number, ..)| *number == code)?;
    let joint = usize::try_from(argument).ok().and_then(|joint| JOINTS.get(joint)).filter(|_| *by_joint);
    Some(joint.map_or_else(|| (*words).to_string(), |joint| format!("{words} (joint: {joint})")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_code_names_the_joint_where_its_argument_does() {
        assert_eq!(meaning(157, 2).as_deref(), Some("collision (joint: elbow)"));
        assert_eq!(meaning(157, 9).as_deref(), Some("collision"));
        assert_eq!(meaning(204, 1).as_deref(), Some("the path changes faster than the arm can follow"));
        assert_eq!(meaning(9999, 0), None);
        assert!(CODES.windows(2).all(|pair| pair[0].0 < pair[1].0), "in order, none twice");
    }
}
