//! `rest:` of the simulator's configuration: how the joints come to rest, and how noisy they
//! are measured.
//!
//! In: the section. Out: see [`RestConfig`].

use crate::motion::rest::{RestConfig, Stop};
use cell_parts::fields::optional;
use rearrange::document::decode::{At, Decoder};

/// As the file names them.
const STOPS: &[(&str, Stop)] = &[("creeping", Stop::Creeping), ("exact", Stop::Exact)];

/// Largest noise, rad/s or rad.
const LOUDEST: f64 = 0.1;

/// Reads the section.
pub fn rest(decoder: &mut Decoder, at: &At) -> Option<RestConfig> {
    let fields = decoder.map(at, &["stop", "speed_noise", "position_noise"])?;
    let usual = RestConfig::recorded();
    let stop = optional(decoder, &fields, "stop", usual.stop, |decoder, at| decoder.choice(at, STOPS));
    let speed_noise = optional(decoder, &fields, "speed_noise", usual.speed_noise, |decoder, at| {
        decoder.number_in(at, 0.0..=LOUDEST, "rad/s")
    });
    let position_noise = optional(decoder, &fields, "position_noise", usual.position_noise, |decoder, at| {
        decoder.number_in(at, 0.0..=LOUDEST, "rad")
    });
    Some(RestConfig { stop: stop?, speed_noise: speed_noise?, position_noise: position_noise? })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::read::read_sim;

    fn read(section: &str) -> Result<RestConfig, String> {
        const SIM: &str = include_str!("../../../../config/sim.yaml");
        const REST: &str = "\nrest: {stop: creeping}";
        assert!(SIM.contains(REST));
        let text = SIM.replace(REST, section);
        read_sim(&text, "sim.yaml").map(|file| file.rest).map_err(|complaints| complaints.to_string())
    }

    #[test]
    fn joints_creep_unless_the_file_says_otherwise() {
        assert_eq!(read("").unwrap(), RestConfig::recorded(), "without the section");
        let exact = read("\nrest: {stop: exact}").unwrap();
        assert_eq!(exact, RestConfig { stop: Stop::Exact, ..RestConfig::recorded() });
        let noisy = read("\nrest: {speed_noise: 0.0028, position_noise: 1e-4}").unwrap();
        assert_eq!((noisy.stop, noisy.speed_noise, noisy.position_noise), (Stop::Creeping, 0.0028, 1e-4));
    }

    #[test]
    fn unknown_words_and_noise_out_of_range_are_reported() {
        assert!(read("\nrest: {stop: soft}").unwrap_err().contains("\"soft\" is not known here"));
        assert!(read("\nrest: {speed_noise: 0.2}").unwrap_err().contains("speed_noise"));
        assert!(read("\nrest: {position_noise: -1}").unwrap_err().contains("position_noise"));
    }
}
