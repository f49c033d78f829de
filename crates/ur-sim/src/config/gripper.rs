//! `gripper:` of the simulator's configuration: which kind it is, and its sizes.
//!
//! In: the section. Out: what all grippers have, and what makes this one grip. Without a kind it is a VGC10,
//! and the section is that of a cell's configuration.

use crate::world::drive::{Drive, EjectorPins, FingersSpec};
use cell_parts::fields::optional;
use cell_parts::gripper::{GRIPPER_KEYS, GripperConfig, gripper_of};
use rearrange::document::decode::{At, Decoder, Fields};

/// Highest pin: the tool's second.
const MAX_PIN: i64 = 17;

/// Keys of an ejector.
const PINS: [&str; 3] = ["vacuum_on", "blow_off", "part_present"];

#[derive(Clone, Copy)]
enum Kind {
    Vgc10,
    Vgc10OnTool,
    Ejector,
    Fingers(FingersSpec),
}

/// Reads the section.
pub fn gripper(decoder: &mut Decoder, at: &At) -> Option<(GripperConfig, Drive)> {
    let keys: Vec<&str> = GRIPPER_KEYS.iter().chain(&PINS).copied().chain(["kind"]).collect();
    let fields = decoder.map(at, &keys)?;
    let kind = optional(decoder, &fields, "kind", Kind::Vgc10, |decoder, at| {
        let kinds = [
            ("vgc10", Kind::Vgc10),
            ("vgc10_tool", Kind::Vgc10OnTool),
            ("ejector", Kind::Ejector),
            ("robotiq_2f85", Kind::Fingers(FingersSpec::ROBOTIQ_2F85)),
            ("robotiq_2f140", Kind::Fingers(FingersSpec::ROBOTIQ_2F140)),
        ];
        decoder.choice(at, &kinds)
    });
    let common = gripper_of(decoder, at, &fields, !matches!(kind, Some(Kind::Fingers(_))));
    let drive = match kind? {
        Kind::Ejector => ejector(decoder, at, &fields, common.as_ref().map_or(0.3, |it| it.vacuum_min)),
        kind => {
            for key in PINS {
                if let Some(at) = fields.optional(key) {
                    decoder.complain_at(&at, format!("{key} is for an ejector"), "add kind: ejector");
                }
            }
            Some(match kind {
                Kind::Fingers(spec) => Drive::Fingers(spec),
                Kind::Vgc10OnTool => Drive::Vgc10OnTool,
                Kind::Vgc10 | Kind::Ejector => Drive::Vgc10,
            })
        }
    };
    Some((common?, drive?))
}

fn ejector(decoder: &mut Decoder, at: &At, fields: &Fields, switches_at: f64) -> Option<Drive> {
    let pin = |decoder: &mut Decoder, at: &At| {
        decoder.integer(at, 0..=MAX_PIN).and_then(|pin| u8::try_from(pin).ok())
    };
    let vacuum_on = fields.required("vacuum_on", decoder).and_then(|at| pin(decoder, &at));
    let blow_off = optional(decoder, fields, "blow_off", None, |decoder, at| pin(decoder, at).map(Some));
    let part_present =
        optional(decoder, fields, "part_present", None, |decoder, at| pin(decoder, at).map(Some));
    if vacuum_on.is_some() && Some(vacuum_on) == blow_off {
        decoder.complain_at(
            at,
            "one output sucks and blows off",
            "give vacuum_on and blow_off pins of their own",
        );
    }
    let (vacuum_on, blow_off, part_present) = (vacuum_on?, blow_off?, part_present?);
    Some(Drive::Ejector(EjectorPins { vacuum_on, blow_off, part_present, switches_at }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::SimFile;
    use crate::config::read::read_sim;

    const SIM: &str = include_str!("../../../../config/sim.yaml");
    const BODY: &str = "body: {polygon: [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]], height: 0.05}, \
                        mass_kg: 1, centre_of_gravity_m: [0, 0, 0.05]";
    const CUPS: &str = "cups: [{channel: A, x: 0, y: 0, diameter: 0.02}], vacuum_min: 0.4";

    fn read(section: &str) -> Result<SimFile, String> {
        let begin = SIM.find("\ngripper:\n").unwrap();
        let end = begin + SIM[begin..].find("\n\n").unwrap();
        let text = format!("{}\ngripper: {section}{}", &SIM[..begin], &SIM[end..]);
        read_sim(&text, "sim.yaml").map_err(|complaints| complaints.to_string())
    }

    #[test]
    fn the_kind_decides_what_makes_it_grip() {
        let drive = |section: String| read(&section).map(|file| file.drive);
        assert_eq!(drive(format!("{{{BODY}, {CUPS}}}")), Ok(Drive::Vgc10));
        assert_eq!(drive(format!("{{kind: vgc10, {BODY}, {CUPS}}}")), Ok(Drive::Vgc10));
        assert_eq!(drive(format!("{{kind: vgc10_tool, {BODY}, {CUPS}}}")), Ok(Drive::Vgc10OnTool));
        let fingers = read(&format!("{{kind: robotiq_2f85, {BODY}}}")).unwrap();
        assert_eq!(fingers.drive, Drive::Fingers(FingersSpec::ROBOTIQ_2F85));
        assert!(fingers.gripper.cups.is_empty() && fingers.gripper.mass_kg == 1.0);
        let pins = EjectorPins { vacuum_on: 0, blow_off: None, part_present: Some(17), switches_at: 0.4 };
        let section = format!("{{kind: ejector, vacuum_on: 0, part_present: 17, {BODY}, {CUPS}}}");
        assert_eq!(drive(section), Ok(Drive::Ejector(pins)));
    }

    #[test]
    fn what_fits_no_kind_is_reported() {
        for (section, complaint) in [
            (format!("{{{BODY}}}"), "cups"),
            (format!("{{kind: hand, {BODY}}}"), "robotiq_2f85"),
            (format!("{{kind: ejector, {BODY}, {CUPS}}}"), "vacuum_on"),
            (format!("{{kind: ejector, vacuum_on: 18, {BODY}, {CUPS}}}"), "vacuum_on"),
            (format!("{{kind: ejector, vacuum_on: 1, blow_off: 1, {BODY}, {CUPS}}}"), "sucks and blows"),
            (format!("{{vacuum_on: 1, {BODY}, {CUPS}}}"), "add kind: ejector"),
            (format!("{{kind: robotiq_2f140, {BODY}, {CUPS}}}"), "cups"),
        ] {
            let reported = read(&section).unwrap_err();
            assert!(reported.contains(complaint), "{section}: {reported}");
        }
    }
}
