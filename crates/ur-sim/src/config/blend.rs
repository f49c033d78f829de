//! `blend:` of the simulator's configuration: how the controller passes blends.
//!
//! In: the section. Out: at which speed the arm passes them.

use crate::motion::rounding::{ENTRY_SPEEDS, EntrySpeed};
use rearrange::document::decode::{At, Decoder};

/// Reads the section.
pub fn entry_speed(decoder: &mut Decoder, at: &At) -> Option<EntrySpeed> {
    let fields = decoder.map(at, &["entry_speed"])?;
    let at = fields.required("entry_speed", decoder)?;
    decoder.choice(&at, ENTRY_SPEEDS)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::read::read_sim;

    fn read(section: &str) -> Result<EntrySpeed, String> {
        const SIM: &str = include_str!("../../../../config/sim.yaml");
        const BLEND: &str = "\nblend: {entry_speed: braked}";
        assert!(SIM.contains(BLEND));
        let text = SIM.replace(BLEND, section);
        read_sim(&text, "sim.yaml").map(|file| file.entry_speed).map_err(|complaints| complaints.to_string())
    }

    #[test]
    fn each_reading_has_its_word_and_another_word_is_reported() {
        assert_eq!(read("").unwrap(), EntrySpeed::Braked, "without the section");
        for (word, speed) in ENTRY_SPEEDS {
            assert_eq!(read(&format!("\nblend: {{entry_speed: {word}}}")).unwrap(), *speed);
        }
        let reported = read("\nblend: {entry_speed: quick}").unwrap_err();
        assert!(reported.contains("\"quick\" is not known here"), "{reported}");
        assert!(read("\nblend: {}").unwrap_err().contains("entry_speed"));
    }
}
