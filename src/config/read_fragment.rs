//! A part of a cell's configuration that it shares with other cells: catalogue, planner, tolerances.
//!
//! In: YAML text with `objects`, `planner`, `tolerances` or some of them. Out: a document whose sections
//! take the place of those in the cell's own file, or every complaint. What a cell alone can know is no key
//! here: bodies, limits, addresses, calibration.

use crate::config::fragment::ConfigFragment;
use crate::config::read_cell::{object_list, planner, tolerances};
use rearrange::document::Diagnostics;
use rearrange::document::decode::{At, Decoder};

/// Keys of a fragment.
pub const FRAGMENT_KEYS: &[&str] = &["version", "objects", "planner", "tolerances"];

/// Reads a fragment.
///
/// # Errors
/// A key that a fragment does not have, or whatever is wrong in a section.
pub fn read_fragment(text: &str, source: &str) -> Result<ConfigFragment, Diagnostics> {
    let (node, mut decoder) = Decoder::open(text, source)?;
    let at = At::top(&node);
    if let Some(fields) = decoder.map(&at, FRAGMENT_KEYS) {
        if let Some(version) = fields.required("version", &mut decoder) {
            decoder.integer(&version, 1..=1);
        }
        let (objects, judged, limits) =
            (fields.optional("objects"), fields.optional("planner"), fields.optional("tolerances"));
        if objects.is_none() && judged.is_none() && limits.is_none() {
            let help = "write objects, planner or tolerances, whole as in cell.yaml";
            decoder.complain_at(&at, "the fragment says nothing", help);
        }
        if let Some(at) = objects {
            object_list(&mut decoder, &at);
        }
        if let Some(at) = judged {
            planner(&mut decoder, &at);
        }
        if let Some(at) = limits {
            // Whatever settles the arm where the file does not say: it is not looked at here.
            tolerances(&mut decoder, &at, 0.0);
        }
    }
    decoder.finish(Some(()))?;
    Ok(ConfigFragment { top: node })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::load::load_cell_with;
    use std::path::Path;

    const OBJECTS: &str = "version: 1\nobjects:\n  - id: ring\n    footprint: {disc: {radius: 0.03}}\n    height: \
                           0.02\n    mass: 0.05\n    marker: {family: tag36h11, id: 9, size: 0.03, offset: [0, 0, \
                           0]}\n";

    fn example() -> std::path::PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("config/cell.yaml")
    }

    #[test]
    fn its_sections_take_the_place_of_the_cells() {
        let own = load_cell_with(&example(), None).unwrap();
        let fragment = read_fragment(
            &format!("{OBJECTS}planner: {{solver: tbm, objective: ti, time_limit_s: 9, seed: 4}}\n"),
            "shared",
        )
        .unwrap();
        let cell = load_cell_with(&example(), Some(&fragment)).unwrap();
        assert_eq!(cell.objects.iter().map(|object| object.id.as_str()).collect::<Vec<_>>(), ["ring"]);
        assert_eq!((cell.planner.time_limit_s, cell.planner.seed), (9.0, 4));
        assert_eq!((cell.limits, cell.devices), (own.limits, own.devices), "what is a cell's own stays");
    }

    #[test]
    fn what_is_a_cells_own_or_unsound_is_refused_with_its_place() {
        for (text, said) in [
            ("version: 1\nlimits: {link_floor_m: 0}\n", "shared:2:1"),
            ("version: 1\ndevices: {robot: {host: 10.0.0.9}}\n", "unknown key"),
            ("version: 1\ncalibration: {camera: x.yaml}\n", "unknown key"),
            ("version: 1\n", "says nothing"),
            ("planner: {solver: auto, objective: pp, time_limit_s: 2, seed: 0}\n", "version"),
            ("version: 1\nplanner: {solver: magic, objective: pp, time_limit_s: 2, seed: 0}\n", "magic"),
            ("version: 1\nobjects: {file: /etc/passwd}\n", "a list"),
            ("version: 1\nobjects: []\n", "no object is given"),
            ("version: [", "shared"),
        ] {
            let fault = read_fragment(text, "shared").unwrap_err().to_string();
            assert!(fault.contains(said), "{text}: {fault}");
        }
    }

    /// Sound by itself, and not in this cell: its marker is one of the table's.
    #[test]
    fn what_does_not_fit_a_cell_is_found_there() {
        let fragment = read_fragment(&OBJECTS.replace("id: 9", "id: 500"), "shared").unwrap();
        let fault = load_cell_with(&example(), Some(&fragment)).unwrap_err().to_string();
        assert!(fault.contains("500"), "{fault}");
    }
}
