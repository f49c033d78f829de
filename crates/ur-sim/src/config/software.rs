//! `controller:` of the simulator's configuration: which software it has, and what is wired to its encoders.
//!
//! In: the section. Out: a version, whose major number says which kind of controller it is, and the ticks a
//! second of two conveyors.

use crate::controller::config::SOFTWARE;
use cell_parts::fields::optional;
use rearrange::document::decode::{At, Decoder};

/// Version of PolyScope X unless the section names another.
const POLYSCOPE_X: [u32; 4] = [10, 12, 0, SOFTWARE[3]];

/// Fastest that the controller counts, ticks a second.
const FASTEST: f64 = 40_000.0;

/// Software, and ticks a second of the encoders.
pub type Controller = ([u32; 4], [f64; 2]);

/// Reads the section.
pub fn controller(decoder: &mut Decoder, at: &At) -> Option<Controller> {
    let fields = decoder.map(at, &["software", "version", "encoders"])?;
    let encoders = optional(decoder, &fields, "encoders", [0.0; 2], |decoder, at| {
        decoder.numbers_in::<2>(at, -FASTEST..=FASTEST, "ticks a second")
    });
    let newest = optional(decoder, &fields, "software", SOFTWARE, |decoder, at| {
        decoder.choice(at, &[("polyscope_5", SOFTWARE), ("polyscope_x", POLYSCOPE_X)])
    })?;
    let version = optional(decoder, &fields, "version", newest, |decoder, at| {
        let text = decoder.text(at)?;
        let version = version(&text).filter(|version| version[0] == newest[0]);
        if version.is_none() {
            let [major, minor, ..] = newest;
            let message = format!("{text:?} is no version of this software");
            decoder.complain_at(at, message, format!("write it as {major}.{minor} or {major}.{minor}.1"));
        }
        version
    });
    Some((version?, encoders?))
}

/// Major, minor and, if given, bug fix.
fn version(text: &str) -> Option<[u32; 4]> {
    let numbers: Option<Vec<u32>> = text.split('.').map(number).collect();
    match numbers?[..] {
        [major, minor] => Some([major, minor, 0, SOFTWARE[3]]),
        [major, minor, bugfix] => Some([major, minor, bugfix, SOFTWARE[3]]),
        _ => None,
    }
}

fn number(text: &str) -> Option<u32> {
    let digits = (1..=3).contains(&text.len()) && text.bytes().all(|byte| byte.is_ascii_digit());
    digits.then(|| text.parse().ok()).flatten()
}

#[cfg(test)]
mod tests {
    use crate::config::read::read_sim;

    fn read(section: &str) -> Result<[u32; 4], String> {
        const SIM: &str = include_str!("../../../../config/sim.yaml");
        let text = SIM.replace("\ncontroller: {}", &format!("\ncontroller: {section}"));
        assert_eq!(text == SIM, section == "{}");
        read_sim(&text, "sim.yaml").map(|file| file.software).map_err(|complaints| complaints.to_string())
    }

    #[test]
    fn a_version_decides_which_kind_of_controller_it_is() {
        let of = |major, minor, bugfix| Ok([major, minor, bugfix, 1_234_567]);
        assert_eq!(read("{}"), of(5, 26, 0));
        assert_eq!(read("{version: 5.10}"), of(5, 10, 0));
        assert_eq!(read("{software: polyscope_x}"), of(10, 12, 0));
        assert_eq!(read("{software: polyscope_x, version: 10.11.1}"), of(10, 11, 1));
        let text = include_str!("../../../../config/sim.yaml");
        let file =
            read_sim(&text.replace("controller: {}", "controller: {encoders: [-250.5, 7]}"), "sim.yaml");
        assert_eq!(file.unwrap().encoders, [-250.5, 7.0]);
    }

    #[test]
    fn versions_of_other_software_are_reported() {
        for (section, complaint) in [
            ("{version: 10.12}", "write it as 5.26 or 5.26.1"),
            ("{software: polyscope_x, version: 5.26}", "write it as 10.12 or 10.12.1"),
            ("{version: 5}", "\"5\" is no version"),
            ("{version: 5.26.0.1}", "is no version"),
            ("{version: 5.+6}", "is no version"),
            ("{software: cb3}", "polyscope_5"),
            ("{encoders: [50000, 0]}", "encoders"),
            ("{encoders: [1]}", "encoders"),
        ] {
            let reported = read(section).unwrap_err();
            assert!(reported.contains(complaint), "{section}: {reported}");
        }
    }
}
