//! Whether the limits of motion are such that arm and cups can keep them.
//!
//! In: the parts of a configuration that could be read. Out: complaints in the decoder. celld slows each
//! object down to what its cups hold, so a limit above that for one object is no fault; a limit that
//! nothing reaches is one: the arm would stop with a fault, or every cycle time would be wrong.

use crate::config::cell::MotionLimits;
use crate::config::check::{CUP_MARGIN_M, cups, off_centre, suction};
use crate::config::parts::CellParts;
use cell_parts::places::Places;
use cell_values::units::deg_from_rad;
use rearrange::document::decode::Decoder;
use rearrange::tabletop::instance::ObjectSpec;
use rearrange::tabletop::room::place_for_cups;

/// Largest acceleration of a joint of a UR5e, degrees/s2.
///
/// Universal Robots publishes no such limit, but what it follows from: a torque of 150 Nm at most at
/// shoulder and elbow ("Max. joint torques"), and mass and centre of mass of every link ("DH parameters for
/// calculations of kinematics and dynamics"). An arm that is stretched out, without a tool, has 3.8 kg m2
/// about its shoulder and weighs 60 Nm there: (150 - 60) Nm / 3.8 kg m2 = 23.6 rad/s2. Tool and load make
/// it less.
const JOINT_ACCELERATION_MAX_DEG_S2: f64 = 1350.0;

/// Up to here a tool acceleration is no complaint, m/s2: it serves the empty arm, and celld carries heavy
/// objects more slowly.
const TOOL_ACCELERATION_OF_EMPTY_ARM: f64 = 2.5;

/// Complains about limits that arm or cups cannot keep, or that do not fit each other.
pub(super) fn check_limits(decoder: &mut Decoder, parts: &CellParts, places: &Places) {
    let Some(limits) = &parts.limits else { return };
    check_blend(decoder, limits, places);
    check_joint_acceleration(decoder, limits, places);
    check_tool_acceleration(decoder, parts, limits, places);
}

fn check_blend(decoder: &mut Decoder, limits: &MotionLimits, places: &Places) {
    if limits.blend_m > limits.lift_height_m {
        let message = format!(
            "a blend radius of {} m rounds the corner of a lift of {} m off",
            limits.blend_m, limits.lift_height_m
        );
        let at = places.at(&["limits", "blend_m"]);
        decoder.complain(at, "limits.blend_m", message, "make it smaller than limits.lift_height_m");
    }
}

fn check_joint_acceleration(decoder: &mut Decoder, limits: &MotionLimits, places: &Places) {
    let wanted = deg_from_rad(limits.joint_acceleration);
    // What a file says in degrees is not changed by going to radians and back but for its last digits.
    if wanted <= JOINT_ACCELERATION_MAX_DEG_S2 + 1e-6 {
        return;
    }
    let message = format!(
        "{wanted:.0} degrees/s2 is more than the arm can do: a UR5e that is stretched out, without a tool, \
         accelerates by {JOINT_ACCELERATION_MAX_DEG_S2} degrees/s2 at most"
    );
    let help = format!("give at most {JOINT_ACCELERATION_MAX_DEG_S2}, and less with a heavy tool or load");
    let at = places.at(&["limits", "joint_acceleration_deg_s2"]);
    decoder.complain(at, "limits.joint_acceleration_deg_s2", message, help);
}

/// The object that the cups hold at the highest acceleration has to be held at the limit.
fn check_tool_acceleration(decoder: &mut Decoder, parts: &CellParts, limits: &MotionLimits, places: &Places) {
    let Some(gripper) = &parts.gripper else { return };
    let suction = suction(gripper);
    let held = |object: &ObjectSpec| {
        let cups = cups(gripper);
        let grip = place_for_cups(&object.footprint, object.grippable.as_ref(), &cups, CUP_MARGIN_M)?;
        Some(suction.acceleration(object.mass?, off_centre(&object.footprint, &grip)))
    };
    let movable = parts.objects.iter().flatten().flatten().filter(|object| !object.fixed);
    let best = movable.filter_map(|object| Some((held(object)?, object.id.as_str())));
    let Some((most, id)) = best.max_by(|a, b| a.0.total_cmp(&b.0)) else { return };
    // An object that is not held at all has a complaint of its own.
    if limits.tool_acceleration <= most.max(TOOL_ACCELERATION_OF_EMPTY_ARM) || most <= 0.0 {
        return;
    }
    let most = (most * 100.0).floor() / 100.0;
    let message = format!(
        "{} m/s2 is more than the vacuum can hold: with four times the force that it takes, the cups carry \
         {id:?} at {most} m/s2 at most, and every other object more slowly",
        limits.tool_acceleration
    );
    let help = format!("give at most {most}; or use larger or more cups, or a higher vacuum_min");
    let at = places.at(&["limits", "tool_acceleration_m_s2"]);
    decoder.complain(at, "limits.tool_acceleration_m_s2", message, help);
}
