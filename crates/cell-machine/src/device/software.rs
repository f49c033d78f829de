//! The controller's software: which version celld needs, and for what.
//!
//! In: major and minor version. Out: why it is too old, in words. Pure. Source: the vendor's dashboard
//! server manual, which gives the version with each command.

/// The first version with both of the dashboard's commands that celld cannot do without.
const NEEDED: [u32; 2] = [5, 6];

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
