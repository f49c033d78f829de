//! The controller's software: which version celld needs, and for what.
//!
//! In: major and minor version, or the dashboard's text with it. Out: why it is too old, in words; what it
//! can. Pure. Source: the vendor's dashboard server manual and script manual, which give the version with
//! each command.

/// The first version with both of the dashboard's commands that celld cannot do without.
const NEEDED: [u32; 2] = [5, 6];

/// The first version whose programs may call `set_target_payload` with a transition time.
const GRADUAL_PAYLOAD: [u32; 2] = [5, 10];

/// Major and minor version in what the dashboard says, as in "URSoftware 5.12.0.1101319".
pub fn version_of(text: &str) -> Option<[u32; 2]> {
    let mut words = text.split_whitespace();
    words.find_map(|word| {
        let mut parts = word.split('.').map(str::parse);
        match (parts.next()?, parts.next()?) {
            (Ok(major), Ok(minor)) => Some([major, minor]),
            _ => None,
        }
    })
}

/// True where a payload can be changed gradually.
pub fn changes_payload_gradually(version: [u32; 2]) -> bool {
    version >= GRADUAL_PAYLOAD
}

/// Why celld does not work with this software; `None` if it does.
pub fn too_old([major, minor]: [u32; 2]) -> Option<String> {
    let [needs, least] = NEEDED;
    ([major, minor] < NEEDED).then(|| {
        format!(
            "controller software {major}.{minor} is too old: celld needs {needs}.{least} or later \
             (`is in remote control`, `get serial number`)"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn software_before_5_6_is_refused_with_the_missing_commands() {
        for version in [[3, 15], [5, 0], [5, 5]] {
            let said = too_old(version).unwrap();
            assert!(said.contains("celld needs 5.6 or later (`is in remote control`"), "{said}");
        }
        assert!([[5, 6], [5, 26], [10, 12]].into_iter().all(|version| too_old(version).is_none()));
    }
}
