//! `compute_box:` of the simulator's configuration: how the gripper's box treats its clients.
//!
//! In: the section. Out: see [`BoxConfig`].

use crate::box_clients::{BoxConfig, SecondClient};
use cell_parts::fields::optional;
use rearrange::document::decode::{At, Decoder};

/// As the file names them.
const SECONDS: &[(&str, SecondClient)] =
    &[("refused", SecondClient::Refused), ("evicts", SecondClient::Evicts), ("waits", SecondClient::Waits)];

/// Longest time that a place is kept, s.
const LONGEST_S: f64 = 86_400.0;

/// Reads the section.
pub fn compute_box(decoder: &mut Decoder, at: &At) -> Option<BoxConfig> {
    let fields = decoder.map(at, &["second_client", "half_open_s"])?;
    let second = optional(decoder, &fields, "second_client", SecondClient::Refused, |decoder, at| {
        decoder.choice(at, SECONDS)
    });
    let half_open_s = optional(decoder, &fields, "half_open_s", 0.0, |decoder, at| {
        decoder.number_in(at, 0.0..=LONGEST_S, "s")
    });
    Some(BoxConfig { second: second?, half_open_s: half_open_s? })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::read::read_sim;

    fn read(section: &str) -> Result<BoxConfig, String> {
        const SIM: &str = include_str!("../../../../config/sim.yaml");
        const BOX: &str = "\ncompute_box: {second_client: refused, half_open_s: 0}\n";
        assert!(SIM.contains(BOX));
        let text = SIM.replace(BOX, &format!("\n{section}\n"));
        read_sim(&text, "sim.yaml").map(|file| file.compute_box).map_err(|complaints| complaints.to_string())
    }

    #[test]
    fn a_second_client_is_refused_unless_the_file_says_otherwise() {
        assert_eq!(read("").unwrap(), BoxConfig::default(), "without the section");
        let evicts = read("compute_box: {second_client: evicts, half_open_s: 30}").unwrap();
        assert_eq!(evicts, BoxConfig { second: SecondClient::Evicts, half_open_s: 30.0 });
    }

    #[test]
    fn unknown_words_and_negative_times_are_reported() {
        assert!(
            read("compute_box: {second_client: queues}").unwrap_err().contains("\"queues\" is not known")
        );
        assert!(read("compute_box: {half_open_s: -1}").unwrap_err().contains("half_open_s"));
    }
}
