//! `safety:` of the simulator's configuration: what the controller's safety system holds the arm to.
//!
//! In: the section. Out: its limits; what it leaves out is as delivered.

use crate::motion::safety::{SafetyLimits, SafetyPlane};
use cell_parts::fields::{each, optional};
use rearrange::document::decode::{At, Decoder};

/// Reads the section.
pub fn safety(decoder: &mut Decoder, at: &At) -> Option<SafetyLimits> {
    let delivered = SafetyLimits::default();
    let fields = decoder.map(at, &["planes", "tool_speed", "momentum", "power", "tool_radius"])?;
    let planes = optional(decoder, &fields, "planes", Vec::new(), |decoder, at| {
        each(decoder, at, plane)?.into_iter().collect()
    });
    let tool_speed = optional(decoder, &fields, "tool_speed", delivered.tool_speed, |decoder, at| {
        decoder.number_in(at, 0.01..=5.0, "m/s")
    });
    let mut limit = |name: &str, range: std::ops::RangeInclusive<f64>, unit: &str| {
        optional(decoder, &fields, name, None, |decoder, at| decoder.number_in(at, range, unit).map(Some))
    };
    let momentum = limit("momentum", 0.1..=1000.0, "kg m/s");
    let power = limit("power", 0.1..=10_000.0, "W");
    let tool_radius = limit("tool_radius", 0.0..=0.5, "m");
    Some(SafetyLimits {
        planes: planes?,
        tool_speed: tool_speed?,
        momentum: momentum?,
        power: power?,
        tool_radius: tool_radius?,
    })
}

fn plane(decoder: &mut Decoder, at: &At) -> Option<SafetyPlane> {
    let fields = decoder.map(at, &["point", "normal"])?;
    let point = fields.required("point", decoder).and_then(|at| decoder.numbers::<3>(&at));
    let normal = fields.required("normal", decoder).and_then(|at| {
        let normal = decoder.numbers::<3>(&at)?;
        if normal.iter().any(|axis| *axis != 0.0) {
            return Some(normal);
        }
        decoder.complain_at(
            &at,
            "a plane has a direction",
            "write the way to where the arm may be, as [0, 0, 1]",
        );
        None
    });
    Some(SafetyPlane { point: point?, normal: normal? })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::read::read_sim;

    fn read(section: &str) -> Result<SafetyLimits, String> {
        const SIM: &str = include_str!("../../../../config/sim.yaml");
        let text = SIM.replace("\nsafety: {}", &format!("\nsafety: {section}"));
        assert_ne!(text, SIM);
        read_sim(&text, "sim.yaml").map(|file| file.safety).map_err(|complaints| complaints.to_string())
    }

    #[test]
    fn planes_and_speeds_are_read_and_what_is_none_is_reported() {
        let plane = SafetyPlane { point: [0.0, 0.1, 0.2], normal: [0.0, 1.0, 0.0] };
        let limits = read("{tool_speed: 0.25, planes: [{point: [0, 0.1, 0.2], normal: [0, 1, 0]}]}").unwrap();
        assert_eq!(limits, SafetyLimits { planes: vec![plane], tool_speed: 0.25, ..SafetyLimits::default() });
        let limits = read("{momentum: 25, power: 300, tool_radius: 0.06}").unwrap();
        assert_eq!(
            (limits.momentum, limits.power, limits.tool_radius),
            (Some(25.0), Some(300.0), Some(0.06))
        );
        for (section, complaint) in [
            ("{planes: [{point: [0, 0, 0], normal: [0, 0, 0]}]}", "a plane has a direction"),
            ("{planes: [{point: [0, 0, 0]}]}", "normal"),
            ("{tool_speed: 0}", "tool_speed"),
            ("{momentum: 0}", "momentum"),
            ("{power: -5}", "power"),
            ("{tool_radius: 2}", "tool_radius"),
        ] {
            let reported = read(section).unwrap_err();
            assert!(reported.contains(complaint), "{section}: {reported}");
        }
    }
}
