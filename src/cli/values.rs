//! Values on the command line that have to be sound before anything starts: numbers in a range, addresses.
//!
//! In: the text after an option. Out: the value, or one sentence that says what to give; clap adds the
//! option's name and ends with exit code 2. The ranges are those of the same keys in the configuration.

use cell_edge::terminal::within;
use std::net::IpAddr;

/// A planning budget, s.
///
/// # Errors
/// The text is not a number from 0.001 to 86400.
pub fn planning_seconds(text: &str) -> Result<f64, String> {
    within(text, 0.001..=86_400.0, "s")
}

/// Edge of a demo table, m.
///
/// # Errors
/// The text is not a number from 0.1 to 2.
pub fn table_size(text: &str) -> Result<f64, String> {
    within(text, 0.1..=2.0, "m")
}

/// An address of this machine that no other machine can reach.
///
/// # Errors
/// The text is not an IP address, or other machines can reach the address.
pub fn loopback(text: &str) -> Result<IpAddr, String> {
    match text.parse::<IpAddr>() {
        Ok(address) if address.is_loopback() => Ok(address),
        _ => Err("give a loopback address, 127.x.x.x or ::1: the demo's devices have no safety of their own"
            .into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_out_of_range_are_refused_with_the_range() {
        for text in ["-1", "nan", "inf", "1e30", "0", "", "2 s"] {
            let reported = planning_seconds(text).unwrap_err();
            assert_eq!(reported, "give a number between 0.001 and 86400 s", "{text}");
            assert!(ur_sim::command::time_factor(text).is_err(), "{text}");
        }
        assert_eq!((planning_seconds("2.5"), ur_sim::command::time_factor("5")), (Ok(2.5), Ok(5.0)));
        assert!(table_size("3").is_err() && table_size("0.5") == Ok(0.5));
    }

    #[test]
    fn open_addresses_are_refused() {
        assert!(
            loopback("127.0.0.9").is_ok() && loopback("0.0.0.0").is_err() && loopback("localhost").is_err()
        );
    }
}
