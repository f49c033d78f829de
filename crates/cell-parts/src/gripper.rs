//! The gripper as both configuration files describe it: cups, channels, body, mass.
//!
//! In: located values and a decoder that collects complaints. Out: [`GripperConfig`] in SI, in the tool and
//! flange frames, or `None` with a complaint kept.

use crate::fields::{list, required_number, required_positive};
use cell_values::units::ATMOSPHERE_PA;
use rearrange::document::decode::{At, Decoder, Fields};
use rearrange::tabletop::decode;

/// The two suction channels of the VGC10.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum CupChannel {
    /// Channel A.
    A,
    /// Channel B.
    B,
}

/// One suction cup in the tool frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CupConfig {
    /// The channel that feeds it.
    pub channel: CupChannel,
    /// Centre, m.
    pub x_m: f64,
    /// Centre, m.
    pub y_m: f64,
    /// Diameter of the lip, m.
    pub diameter_m: f64,
}

/// The gripper.
#[derive(Clone, Debug, PartialEq)]
pub struct GripperConfig {
    /// At least one, but of fingers.
    pub cups: Vec<CupConfig>,
    /// Outline of the body in the tool frame, m: what must not touch the neighbours of a gripped object.
    pub body_polygon: Vec<[f64; 2]>,
    /// Height of the body's lower face above the cup lips, m.
    pub body_height_m: f64,
    /// Least relative vacuum (0 to 1) that counts as gripped.
    pub vacuum_min: f64,
    /// Mass of gripper and camera on the flange, kg.
    pub mass_kg: f64,
    /// Centre of that mass in the flange frame, m.
    pub centre_of_gravity_m: [f64; 3],
}

impl GripperConfig {
    /// Force with which `cups` hold at `vacuum_min`, N.
    pub fn holding_force_n(&self, cups: &[CupConfig]) -> f64 {
        let area_m2 = |cup: &CupConfig| std::f64::consts::PI * cup.diameter_m * cup.diameter_m / 4.0;
        self.vacuum_min * ATMOSPHERE_PA * cups.iter().map(area_m2).sum::<f64>()
    }
}

/// Keys of the section.
pub const GRIPPER_KEYS: &[&str] = &["cups", "body", "vacuum_min", "mass_kg", "centre_of_gravity_m"];

/// Least vacuum of a gripper that has none to compare it with.
const NO_VACUUM: f64 = 0.3;

/// Cups, body and mass of the gripper.
pub fn gripper(decoder: &mut Decoder, at: &At) -> Option<GripperConfig> {
    let fields = decoder.map(at, GRIPPER_KEYS)?;
    gripper_of(decoder, at, &fields, true)
}

/// The same from a section that may have further keys; a gripper that does not suck has no cups.
pub fn gripper_of(decoder: &mut Decoder, at: &At, fields: &Fields, sucks: bool) -> Option<GripperConfig> {
    let (cups, vacuum_min) = if sucks {
        let cups = fields.required("cups", decoder).and_then(|at| list(decoder, &at, cup));
        (cups, required_number(decoder, fields, "vacuum_min", 0.05..=0.8, "of an atmosphere"))
    } else {
        for key in ["cups", "vacuum_min"] {
            if let Some(at) = fields.optional(key) {
                decoder.complain_at(&at, format!("{key} of a gripper that does not suck"), "leave it out");
            }
        }
        (Some(Vec::new()), Some(NO_VACUUM))
    };
    let body = fields.required("body", decoder).and_then(|at| {
        let fields = decoder.map(&at, &["polygon", "height"])?;
        let polygon = fields.required("polygon", decoder).and_then(|at| decode::polygon(decoder, &at));
        let height = required_number(decoder, &fields, "height", 0.0..=1.0, "m");
        Some((polygon?.points().to_vec(), height?))
    });
    let mass_kg = required_positive(decoder, fields, "mass_kg", 5.0, "kg");
    let centre = fields
        .required("centre_of_gravity_m", decoder)
        .and_then(|at| decoder.numbers_in::<3>(&at, -1.0..=1.0, "m"));
    let cups = cups?;
    if sucks && cups.is_empty() {
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
