//! The pieces that both configuration files have: the gripper, and the reference markers of the table.
//!
//! In: located values and a decoder that collects complaints. Out: values in SI, or `None` with a complaint
//! kept.

use crate::config::cell::{CupChannel, CupConfig, GripperConfig, ReferenceMarkerConfig};
use crate::config::fields::{each, list, required_number, required_positive};
use crate::document::decode::{At, Decoder};
use crate::tabletop::decode;

/// Cups, body and mass of the gripper.
pub(super) fn gripper(decoder: &mut Decoder, at: &At) -> Option<GripperConfig> {
    let known = ["cups", "body", "vacuum_min", "mass_kg", "centre_of_gravity_m"];
    let fields = decoder.map(at, &known)?;
    let cups = fields.required("cups", decoder).and_then(|at| list(decoder, &at, cup));
    let body = fields.required("body", decoder).and_then(|at| {
        let fields = decoder.map(&at, &["polygon", "height"])?;
        let polygon = fields.required("polygon", decoder).and_then(|at| decode::polygon(decoder, &at));
        let height = required_number(decoder, &fields, "height", 0.0..=1.0, "m");
        Some((polygon?.points().to_vec(), height?))
    });
    let vacuum_min = required_number(decoder, &fields, "vacuum_min", 0.05..=0.8, "of an atmosphere");
    let mass_kg = required_positive(decoder, &fields, "mass_kg", 5.0, "kg");
    let centre = fields.required("centre_of_gravity_m", decoder).and_then(|at| decoder.numbers::<3>(&at));
    let cups = cups?;
    if cups.is_empty() {
        decoder.complain_at(at, "no cups are given", "add at least one to `cups`");
        return None;
    }
    let (body_polygon, body_height_m) = body?;
    Some(GripperConfig {
        cups,
        body_polygon,
        body_height_m,
        vacuum_min: vacuum_min?,
        mass_kg: mass_kg?,
        centre_of_gravity_m: centre?,
    })
}

fn cup(decoder: &mut Decoder, at: &At) -> Option<CupConfig> {
    let fields = decoder.map(at, &["channel", "x", "y", "diameter"])?;
    let channels = [("A", CupChannel::A), ("B", CupChannel::B)];
    let channel = fields.required("channel", decoder).and_then(|at| decoder.choice(&at, &channels));
    let x = required_number(decoder, &fields, "x", -0.5..=0.5, "m");
    let y = required_number(decoder, &fields, "y", -0.5..=0.5, "m");
    let diameter = required_number(decoder, &fields, "diameter", 0.003..=0.2, "m");
    Some(CupConfig { channel: channel?, x_m: x?, y_m: y?, diameter_m: diameter? })
}

/// Markers fixed to the table.
pub(super) fn reference_markers(decoder: &mut Decoder, at: &At) -> Option<Vec<ReferenceMarkerConfig>> {
    let markers = each(decoder, at, |decoder, at| {
        let fields = decoder.map(at, &["id", "size", "pose", "pose_deg"])?;
        let id = fields.required("id", decoder).and_then(|at| decoder.integer(&at, 0..=586));
        let size = required_number(decoder, &fields, "size", 0.005..=0.5, "m");
        let pose = decode::required_pose(decoder, &fields, "pose");
        Some(ReferenceMarkerConfig { id: u32::try_from(id?).ok()?, size_m: size?, pose: pose? })
    })?;
    if markers.len() < 4 {
        let message = format!("{} reference markers, a look has to see at least 4", markers.len());
        decoder.complain_at(at, message, "add markers round the workspace");
        return None;
    }
    markers.into_iter().collect()
}
