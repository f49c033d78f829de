//! Why a plan is refused: what comes out of the checker when no plan does.
//!
//! In: nothing. Out: [`PlanFault`], with names for people and lengths in micrometres. Pure data.

/// Why a plan is refused. Actions count from 0; lengths are micrometres.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PlanFault {
    /// The caller ended the check before it was through; nothing is known.
    #[error("the check was not finished: it was stopped")]
    Unfinished,
    /// The start arrangement itself overlaps beyond the tolerance.
    #[error("start: {object} overlaps {meets} by {depth_um:.3} um; {tolerated_um:.3} um are tolerated")]
    Start {
        /// The object.
        object: String,
        /// Whom or what it meets.
        meets: String,
        /// Depth.
        depth_um: f64,
        /// Tolerated depth.
        tolerated_um: f64,
    },
    /// An action names no object of the problem.
    #[error("action {action}: there is no object number {object}")]
    NoSuchObject {
        /// Action.
        action: usize,
        /// The number.
        object: usize,
    },
    /// A pose has NaN or infinity in it.
    #[error("action {action}: a pose of {object} is not finite")]
    NotFinite {
        /// Action.
        action: usize,
        /// The object.
        object: String,
    },
    /// A fixed object is moved.
    #[error("action {action}: {object} is fixed")]
    Fixed {
        /// Action.
        action: usize,
        /// The object.
        object: String,
    },
    /// The object is not where the action takes it from.
    #[error(
        "action {action}: {object} is {off_um:.3} um and {off_deg:.6} deg from where the action picks it"
    )]
    From {
        /// Action.
        action: usize,
        /// The object.
        object: String,
        /// Distance.
        off_um: f64,
        /// Angle, degrees.
        off_deg: f64,
    },
    /// An action that claims to go to a goal goes elsewhere.
    #[error("action {action}: {object} does not go to its goal, {off_um:.3} um and {off_deg:.6} deg off")]
    NotItsGoal {
        /// Action.
        action: usize,
        /// The object.
        object: String,
        /// Distance from the nearest goal it may take.
        off_um: f64,
        /// Angle from that goal, degrees.
        off_deg: f64,
    },
    /// The object would reach over the table's edge.
    #[error("action {action}: {object} reaches over the table's edge by {depth_um:.3} um")]
    Edge {
        /// Action.
        action: usize,
        /// The object.
        object: String,
        /// Overhang.
        depth_um: f64,
    },
    /// The object would overlap another object or a keep-out region.
    #[error("action {action}: {object} overlaps {meets} by {depth_um:.3} um")]
    Overlap {
        /// Action.
        action: usize,
        /// The object.
        object: String,
        /// Whom or what it meets.
        meets: String,
        /// Depth.
        depth_um: f64,
    },
    /// The object would be nearer than the clearance.
    #[error(
        "action {action}: {object} comes within {gap_um:.3} um of {meets}; the clearance is \
         {clearance_um:.3} um"
    )]
    Clearance {
        /// Action.
        action: usize,
        /// The object.
        object: String,
        /// Whom or what it comes near.
        meets: String,
        /// Distance.
        gap_um: f64,
        /// Wanted distance.
        clearance_um: f64,
    },
    /// An object with a goal does not end exactly there.
    #[error(
        "{object} ends {off_um:.6} um and {off_deg:.9} deg from its goal; its last action must repeat the \
         goal's numbers"
    )]
    Goal {
        /// The object.
        object: String,
        /// Distance.
        off_um: f64,
        /// Angle, degrees.
        off_deg: f64,
    },
    /// A goal of a group is taken by no member.
    #[error("group {group}: no member of its own ends at the goal given with {object}")]
    GroupGoal {
        /// The group.
        group: String,
        /// The object with which the goal was given.
        object: String,
    },
}
