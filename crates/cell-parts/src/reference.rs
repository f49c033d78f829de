//! The markers fixed to the table, as both configuration files list them.
//!
//! In: located values and a decoder that collects complaints. Out: [`ReferenceMarkerConfig`]s in the table
//! frame, or `None` with a complaint kept.

use crate::fields::{each, required_number};
use crate::places::Places;
use rearrange::document::decode::{At, Decoder};
use rearrange::document::tree::{Node, Value};
use rearrange::geometry::pose::Pose2;
use rearrange::tabletop::decode;
use rearrange::tabletop::parse::MarkerUse;

/// A marker fixed to the table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReferenceMarkerConfig {
    /// Number within tag36h11.
    pub id: u32,
    /// Edge of the black square, m.
    pub size_m: f64,
    /// Surveyed pose in the table frame.
    pub pose: Pose2,
}

/// Markers fixed to the table.
pub fn reference_markers(decoder: &mut Decoder, at: &At) -> Option<Vec<ReferenceMarkerConfig>> {
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

/// Complains about reference markers that share a number with each other or with an object. Works on the
/// tree, so that it finds them in markers and objects that are wrong otherwise.
pub fn check_reference_markers(decoder: &mut Decoder, places: &Places, objects: &[MarkerUse]) {
    let Some(Value::Sequence(markers)) = places.top().get("reference_markers").map(|node| &node.value) else {
        return;
    };
    let number = |node: &Node| Some((node.get("id")?.scalar()?.parse::<i64>().ok()?, node.get("id")?.at));
    let mut seen: Vec<i64> = Vec::new();
    for (index, marker) in markers.iter().enumerate() {
        let Some((number, at)) = number(marker) else { continue };
        let path = format!("reference_markers[{index}].id");
        if seen.contains(&number) {
            let message = format!("marker {number} is used twice");
            decoder.complain(at, &path, message, "give each place a marker of its own");
        }
        if let Some(object) = objects.iter().find(|object| object.number == number) {
            let message = format!("marker {number} is also that of object {:?}", object.owner);
            decoder.complain(at, &path, message, "give one of them another marker");
        }
        seen.push(number);
    }
}
