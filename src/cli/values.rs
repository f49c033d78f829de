//! Values on the command line that have to be sound before anything starts: numbers in a range, solvers,
//! addresses.
//!
//! In: the text after an option. Out: the value, or one sentence that says what to give; clap adds the
//! option's name and ends with exit code 2. The ranges are those of the same keys in the configuration.

use crate::jobs::policy::{JobObjective, SOLVER_WORDS, unknown_word};
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

/// A solver's name.
///
/// # Errors
/// The text is none of [`SOLVER_WORDS`].
pub fn solver(text: &str) -> Result<String, String> {
    if SOLVER_WORDS.contains(&text) {
        return Ok(text.to_owned());
    }
    let (message, help) = unknown_word(text, &SOLVER_WORDS);
    Err(format!("{message}; {help}"))
}

/// An objective's name.
///
/// # Errors
/// The text is none of [`JobObjective::WORDS`].
pub fn objective(text: &str) -> Result<JobObjective, String> {
    JobObjective::from_word(text).ok_or_else(|| {
        let (message, help) = unknown_word(text, &JobObjective::WORDS);
        format!("{message}; {help}")
    })
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
    fn numbers_out_of_range_are_told_the_range() {
        for text in ["-1", "nan", "inf", "1e30", "0", "", "2 s"] {
            let reported = planning_seconds(text).unwrap_err();
            assert_eq!(reported, "give a number between 0.001 and 86400 s", "{text}");
            assert!(ur_sim::command::time_factor(text).is_err(), "{text}");
        }
        assert_eq!((planning_seconds("2.5"), ur_sim::command::time_factor("5")), (Ok(2.5), Ok(5.0)));
        assert!(table_size("3").is_err() && table_size("0.5") == Ok(0.5));
    }

    #[test]
    fn unknown_solvers_and_open_addresses_are_refused() {
        assert!(solver("foo").unwrap_err().contains("\"foo\" is not known here; one of: tbm, rbm"));
        assert_eq!((solver("rbm").as_deref(), solver("auto").as_deref()), (Ok("rbm"), Ok("auto")));
        assert!(
            loopback("127.0.0.9").is_ok() && loopback("0.0.0.0").is_err() && loopback("localhost").is_err()
        );
    }
}
