//! The controller's software: which version has what celld uses.
//!
//! In: major and minor version, or the dashboard's text with it. Out: why it is too old, in words; what it
//! can. Pure. Source: the vendor's dashboard server manual and script manual, which give the version with
//! each command.

/// Something that celld uses, and the first version that has it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Feature {
    /// Major and minor version.
    pub since: [u32; 2],
    /// What it is called in the vendor's manuals.
    pub name: &'static str,
    /// celld does not work without it.
    pub needed: bool,
}

/// Programs may change the payload over a time.
const GRADUAL_PAYLOAD: Feature = Feature {
    since: [5, 10],
    name: "gradual payload change (`set_target_payload` with a transition time)",
    needed: false,
};

/// Everything that not every e-Series controller has.
pub const FEATURES: &[Feature] = &[
    Feature { since: [5, 6], name: "`is in remote control`", needed: true },
    Feature { since: [5, 6], name: "`get serial number`", needed: true },
    GRADUAL_PAYLOAD,
];

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
    version >= GRADUAL_PAYLOAD.since
}

/// What this software does not have.
pub fn missing(version: [u32; 2]) -> impl Iterator<Item = &'static Feature> {
    FEATURES.iter().filter(move |feature| version < feature.since)
}

/// Why celld does not work with this software; `None` if it does.
pub fn too_old([major, minor]: [u32; 2]) -> Option<String> {
    let needed: Vec<&Feature> = missing([major, minor]).filter(|feature| feature.needed).collect();
    let [needs, least] = needed.iter().map(|feature| feature.since).max()?;
    let names: Vec<&str> = needed.iter().map(|feature| feature.name).collect();
    Some(format!(
        "controller software {major}.{minor} is too old: celld needs {needs}.{least} or later ({})",
        names.join(", ")
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn software_before_5_6_is_refused_with_the_missing_commands() {
        for version in [[3, 15], [5, 0], [5, 5]] {
            let said = too_old(version).unwrap();
            let words = "celld needs 5.6 or later (`is in remote control`, `get serial number`)";
            assert!(said.ends_with(words), "{said}");
        }
        assert!([[5, 6], [5, 26], [10, 12]].into_iter().all(|version| too_old(version).is_none()));
    }

    #[test]
    fn what_older_software_lacks_is_named() {
        let names = |version| missing(version).map(|feature| feature.name).collect::<Vec<_>>();
        assert_eq!(names([5, 5]).len(), 3);
        assert_eq!(names([5, 9]), ["gradual payload change (`set_target_payload` with a transition time)"]);
        assert!(names([5, 10]).is_empty());
    }
}
