//! Calendar time as text, for job names, `not_before` and records. UTC only.
//!
//! In and out: seconds since 1970 and `2026-11-21T08:00:00Z`. Pure. The conversion between days and dates is
//! that of the proleptic Gregorian calendar (Hinnant, "chrono-compatible low-level date algorithms").

/// A date and a time of day, UTC.
struct CivilTime {
    /// Of the common era.
    year: i64,
    /// From 1.
    month: i64,
    /// Of the month, from 1.
    day: i64,
    /// 0 to 23.
    hour: i64,
    /// 0 to 59.
    minute: i64,
    /// 0 to 59.
    second: i64,
}

fn civil(unix_s: f64) -> CivilTime {
    let total = unix_s.clamp(0.0, 253_402_300_799.0) as i64;
    let (days, seconds) = (total.div_euclid(86_400), total.rem_euclid(86_400));
    let z = days + 719_468;
    let era = z.div_euclid(146_097);
    let day_of_era = z.rem_euclid(146_097);
    let year_of_era = (day_of_era - day_of_era / 1_460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let shifted = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * shifted + 2) / 5 + 1;
    let month = if shifted < 10 { shifted + 3 } else { shifted - 9 };
    let year = year_of_era + era * 400 + i64::from(month <= 2);
    CivilTime { year, month, day, hour: seconds / 3_600, minute: seconds / 60 % 60, second: seconds % 60 }
}

/// `2026-11-21T08:00:00Z`.
pub fn text(unix_s: f64) -> String {
    let CivilTime { year, month, day, hour, minute, second } = civil(unix_s);
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}Z")
}

/// `20261121T080000Z`, for names.
pub fn compact(unix_s: f64) -> String {
    text(unix_s).replace(['-', ':'], "")
}

/// `2026-11`, for folders.
pub fn month(unix_s: f64) -> String {
    let CivilTime { year, month, .. } = civil(unix_s);
    format!("{year:04}-{month:02}")
}

/// Seconds since 1970 of `2026-11-21T08:00:00Z`; `None` for anything else.
pub fn parse(text: &str) -> Option<f64> {
    let bytes = text.as_bytes();
    let shape = b"0000-00-00T00:00:00Z";
    let fits = bytes.len() == shape.len()
        && bytes.iter().zip(shape).all(|(b, s)| if *s == b'0' { b.is_ascii_digit() } else { b == s });
    if !fits {
        return None;
    }
    let number = |range: std::ops::Range<usize>| text.get(range)?.parse::<i64>().ok();
    let (year, month, day) = (number(0..4)?, number(5..7)?, number(8..10)?);
    let seconds = number(11..13)? * 3_600 + number(14..16)? * 60 + number(17..19)?;
    let shifted_year = year - i64::from(month <= 2);
    let era = shifted_year.div_euclid(400);
    let year_of_era = shifted_year.rem_euclid(400);
    let day_of_year = (153 * (if month > 2 { month - 3 } else { month + 9 }) + 2) / 5 + day - 1;
    let day_of_era = year_of_era * 365 + year_of_era / 4 - year_of_era / 100 + day_of_year;
    let unix_s = ((era * 146_097 + day_of_era - 719_468) * 86_400 + seconds) as f64;
    // A date that does not exist (30 February, 25 o'clock) comes back as another one.
    (self::text(unix_s) == text).then_some(unix_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_dates() {
        for (unix_s, expected) in [
            (0.0, "1970-01-01T00:00:00Z"),
            (951_782_400.0, "2000-02-29T00:00:00Z"),
            (1_795_248_000.0, "2026-11-21T08:00:00Z"),
            (4_107_542_399.0, "2100-02-28T23:59:59Z"),
            (4_107_542_400.0, "2100-03-01T00:00:00Z"),
        ] {
            assert_eq!(text(unix_s), expected);
            assert_eq!(parse(expected), Some(unix_s));
        }
        assert_eq!(compact(0.0), "19700101T000000Z");
        assert_eq!(month(1_795_248_000.0), "2026-11");
    }

    #[test]
    fn what_is_no_date_is_refused() {
        for bad in [
            "",
            "2026-02-30T00:00:00Z",
            "2026-11-21T25:00:00Z",
            "2026-11-21 08:00:00",
            "2026-11-21T08:00:00+01:00",
        ] {
            assert_eq!(parse(bad), None, "{bad}");
        }
    }
}
