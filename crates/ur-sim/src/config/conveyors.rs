//! `conveyors:` of the simulator's configuration: belts in the table that encoders count.
//!
//! In: the list. Out: where each is and which way it runs; its speed follows from the ticks of its encoder.

use cell_parts::fields::{each, optional};
use rearrange::document::decode::{At, Decoder};

/// A belt as configured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConveyorConfig {
    /// The controller's encoder that counts it.
    pub encoder: usize,
    /// Ticks for a metre.
    pub ticks_per_m: f64,
    /// Corners in the table frame, m.
    pub area: [f64; 4],
    /// Where it runs to, rad from the table's x axis.
    pub direction_rad: f64,
}

/// Reads the list.
pub fn conveyors(decoder: &mut Decoder, at: &At) -> Option<Vec<ConveyorConfig>> {
    each(decoder, at, conveyor)?.into_iter().collect()
}

fn conveyor(decoder: &mut Decoder, at: &At) -> Option<ConveyorConfig> {
    let fields = decoder.map(at, &["encoder", "ticks_per_m", "area", "direction_deg"])?;
    let encoder = optional(decoder, &fields, "encoder", 0, |decoder, at| decoder.integer(at, 0..=1));
    let ticks_per_m =
        fields.required("ticks_per_m", decoder).and_then(|at| decoder.number_in(&at, 1.0..=1e7, "ticks/m"));
    let area = fields.required("area", decoder).and_then(|at| {
        let area = decoder.numbers::<4>(&at)?;
        if area[0] < area[2] && area[1] < area[3] {
            return Some(area);
        }
        decoder.complain_at(&at, "a belt has an extent", "write [least x, least y, greatest x, greatest y]");
        None
    });
    let direction = optional(decoder, &fields, "direction_deg", 0.0, |decoder, at| {
        decoder.number_in(at, -360.0..=360.0, "degrees")
    });
    Some(ConveyorConfig {
        encoder: usize::try_from(encoder?).ok()?,
        ticks_per_m: ticks_per_m?,
        area: area?,
        direction_rad: direction?.to_radians(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::read::read_sim;

    fn read(section: &str) -> Result<Vec<ConveyorConfig>, String> {
        const SIM: &str = include_str!("../../../../config/sim.yaml");
        let text = SIM.replace("\nconveyors: []", &format!("\nconveyors: {section}"));
        assert!(text != SIM || section == "[]");
        read_sim(&text, "sim.yaml").map(|file| file.conveyors).map_err(|complaints| complaints.to_string())
    }

    #[test]
    fn belts_are_read_and_what_is_none_is_reported() {
        assert_eq!(read("[]"), Ok(Vec::new()));
        let belt = read("[{encoder: 1, ticks_per_m: 10000, area: [0, 0.1, 0.4, 0.2], direction_deg: 180}]");
        let expected = ConveyorConfig {
            encoder: 1,
            ticks_per_m: 10_000.0,
            area: [0.0, 0.1, 0.4, 0.2],
            direction_rad: std::f64::consts::PI,
        };
        assert_eq!(belt, Ok(vec![expected]));
        for (section, complaint) in [
            ("[{ticks_per_m: 10000}]", "area"),
            ("[{area: [0, 0, 1, 1]}]", "ticks_per_m"),
            ("[{ticks_per_m: 0, area: [0, 0, 1, 1]}]", "ticks_per_m"),
            ("[{ticks_per_m: 10, area: [0, 0.2, 1, 0.1]}]", "a belt has an extent"),
            ("[{encoder: 2, ticks_per_m: 10, area: [0, 0, 1, 1]}]", "encoder"),
        ] {
            let reported = read(section).unwrap_err();
            assert!(reported.contains(complaint), "{section}: {reported}");
        }
    }
}
