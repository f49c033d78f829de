//! Texts on their way: their hash, a length that can be passed on, the server's times. Pure.

use sha2::{Digest, Sha256};

/// Longest sentence that is passed on.
const SENTENCE_MAX: usize = 2000;

/// The hash of a job's text, lower-case hex.
pub fn sha256(text: &str) -> String {
    use std::fmt::Write as _;
    Sha256::digest(text.as_bytes()).iter().fold(String::new(), |mut hex, byte| {
        let _ = write!(hex, "{byte:02x}");
        hex
    })
}

/// A sentence of a length that can be passed on.
pub fn sentence(text: &str) -> String {
    text.chars().take(SENTENCE_MAX).collect()
}

/// Seconds since 1970 of a time as the server writes it, UTC: `2026-11-21T08:00:00.123456789Z`.
pub fn unix_s_of(text: &str) -> Option<f64> {
    let (date, clock) = text.strip_suffix('Z')?.split_once('T')?;
    let whole = |text: &str| text.parse::<u32>().ok();
    let mut date = date.split('-').map(whole);
    let (year, month, day) = (date.next()??, date.next()??, date.next()??);
    let mut clock = clock.splitn(3, ':');
    let (hours, minutes) = (whole(clock.next()?)?, whole(clock.next()?)?);
    let seconds: f64 = clock.next()?.parse().ok()?;
    if !(1970..=9999).contains(&year) || !(1..=12).contains(&month) || !(1..=31).contains(&day) {
        return None;
    }
    let leap = |year: u32| year.is_multiple_of(4) && (!year.is_multiple_of(100) || year.is_multiple_of(400));
    let of_years: u32 = (1970..year).map(|year| 365 + u32::from(leap(year))).sum();
    let months = [31, 28 + u32::from(leap(year)), 31, 30, 31, 30, 31, 31, 30, 31, 30, 31];
    let of_months: u32 = months.iter().take(month as usize - 1).sum();
    let days = f64::from(of_years + of_months + day - 1);
    Some(days * 86_400.0 + f64::from(hours) * 3600.0 + f64::from(minutes) * 60.0 + seconds)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_of_the_server_are_read() {
        assert_eq!(unix_s_of("1970-01-01T00:00:00Z"), Some(0.0));
        assert_eq!(unix_s_of("2026-11-21T08:00:00.5Z"), Some(1_795_248_000.5));
        assert_eq!(
            unix_s_of("2024-03-01T00:00:00Z").zip(unix_s_of("2024-02-28T00:00:00Z")).map(|(a, b)| a - b),
            Some(172_800.0)
        );
        for foreign in ["", "2026-11-21", "2026-13-01T00:00:00Z", "2026-11-21T08:00:00+01:00", "aT:Z"] {
            assert_eq!(unix_s_of(foreign), None, "{foreign}");
        }
    }
}
