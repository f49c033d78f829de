//! What the values of both configuration files are made of: lists, numbers, transforms, joint poses, paths,
//! hosts.
//!
//! In: located values and a decoder that collects complaints. Out: values in SI, or `None` with a complaint
//! kept. Degrees end here.

use cell_values::units::{Joints, rad_from_deg};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use rearrange::document::decode::{At, Decoder, Fields};
use std::net::IpAddr;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

/// Most reference markers, poses and cups in one list.
const MAX_ITEMS: usize = 200;

/// Every item of the list under a required key, or its absence.
pub fn required_each<T>(
    decoder: &mut Decoder,
    fields: &Fields,
    key: &str,
    read: impl FnMut(&mut Decoder, &At) -> Option<T>,
) -> Option<Vec<Option<T>>> {
    let at = fields.required(key, decoder)?;
    each(decoder, &at, read)
}

/// Every item of a list; complaints of all items are collected.
pub fn list<T>(
    decoder: &mut Decoder,
    at: &At,
    read: impl FnMut(&mut Decoder, &At) -> Option<T>,
) -> Option<Vec<T>> {
    each(decoder, at, read)?.into_iter().collect()
}

/// Every item of a list, absent where it is wrong.
pub fn each<T>(
    decoder: &mut Decoder,
    at: &At,
    mut read: impl FnMut(&mut Decoder, &At) -> Option<T>,
) -> Option<Vec<Option<T>>> {
    let items = decoder.sequence(at)?;
    if items.len() > MAX_ITEMS {
        decoder.complain_at(at, format!("{} entries, at most {MAX_ITEMS} are read", items.len()), "");
        return None;
    }
    Some(items.iter().map(|item| read(decoder, item)).collect())
}

/// A required number within `range`, in `unit`.
pub fn required_number(
    decoder: &mut Decoder,
    fields: &Fields,
    key: &str,
    range: RangeInclusive<f64>,
    unit: &str,
) -> Option<f64> {
    let at = fields.required(key, decoder)?;
    decoder.number_in(&at, range, unit)
}

/// Least speed, acceleration, length or time in its unit: what is smaller is a slip of the pen, and a number
/// to divide by.
const LEAST: f64 = 1e-6;

/// A required speed, acceleration, length or time: from 1e-6 to `most`, in `unit`.
pub fn required_positive(
    decoder: &mut Decoder,
    fields: &Fields,
    key: &str,
    most: f64,
    unit: &str,
) -> Option<f64> {
    let at = fields.required(key, decoder)?;
    decoder.positive(&at, unit)?;
    decoder.number_in(&at, LEAST..=most, unit)
}

/// The value under an optional key, or `default`.
pub fn optional<'n, T>(
    decoder: &mut Decoder,
    fields: &Fields<'n>,
    key: &str,
    default: T,
    read: impl FnOnce(&mut Decoder, &At<'n>) -> Option<T>,
) -> Option<T> {
    match fields.optional(key) {
        Some(at) => read(decoder, &at),
        None => Some(default),
    }
}

/// `{translation: [x, y, z], quaternion: [x, y, z, w]}`: m and a unit quaternion.
pub fn transform(decoder: &mut Decoder, fields: &Fields, key: &str) -> Option<Isometry3<f64>> {
    let at = fields.required(key, decoder)?;
    let inner = decoder.map(&at, &["translation", "quaternion"])?;
    let translation = inner.required("translation", decoder).and_then(|at| decoder.numbers::<3>(&at));
    let rotation = inner.required("quaternion", decoder).and_then(|at| rotation(decoder, &at));
    let [x, y, z] = translation?;
    if [x, y, z].iter().any(|v| v.abs() > 10.0) {
        decoder.complain_at(&at, "more than 10 m away", "the translation is in m");
        return None;
    }
    Some(Isometry3::from_parts(Translation3::new(x, y, z), rotation?))
}

fn rotation(decoder: &mut Decoder, at: &At) -> Option<UnitQuaternion<f64>> {
    let [x, y, z, w] = decoder.numbers::<4>(at)?;
    let quaternion = Quaternion::new(w, x, y, z);
    let norm = quaternion.norm();
    if (norm - 1.0).abs() > 1e-3 {
        let message = format!("a quaternion of length {norm:.4}, a rotation has length 1");
        decoder.complain_at(at, message, "the order is [x, y, z, w]; no rotation is [0, 0, 0, 1]");
        return None;
    }
    Some(UnitQuaternion::from_quaternion(quaternion))
}

/// Six joint positions in degrees.
pub fn joints_deg(decoder: &mut Decoder, at: &At) -> Option<Joints> {
    let degrees = decoder.numbers::<6>(at)?;
    if let Some((joint, value)) = degrees.iter().enumerate().find(|(_, value)| value.abs() > 363.0) {
        decoder.complain_at(
            at,
            format!("joint {} at {value} degrees is beyond what the arm can do", joint + 1),
            "",
        );
        return None;
    }
    Some(Joints(degrees.map(rad_from_deg)))
}

/// A path relative to the file's own folder, made absolute against it.
pub fn path(decoder: &mut Decoder, at: &At, folder: &Path) -> Option<PathBuf> {
    let text = decoder.text(at)?;
    if text.contains('\0') {
        decoder.complain_at(at, "not a path", "write a file name relative to this file's folder");
        return None;
    }
    Some(folder.join(text))
}

/// A port number.
pub fn port(decoder: &mut Decoder, fields: &Fields, key: &str) -> Option<u16> {
    let at = fields.required(key, decoder)?;
    decoder.integer(&at, 1..=65_535).and_then(|port| u16::try_from(port).ok())
}

/// A host name or an address without a port.
pub fn host(decoder: &mut Decoder, fields: &Fields, key: &str) -> Option<String> {
    let at = fields.required(key, decoder)?;
    let host = decoder.text(&at)?;
    if !is_host(&host) {
        let help = "write the name or address alone, without scheme and port";
        decoder.complain_at(&at, format!("{host:?} is not a host name or address"), help);
        return None;
    }
    Some(host)
}

/// True for an IP address (without brackets) and for a name as RFC 1123 has it, underscores included. Digits
/// and dots alone are an address or nothing.
pub fn is_host(text: &str) -> bool {
    if text.parse::<IpAddr>().is_ok() {
        return true;
    }
    let numeric = text.chars().all(|c| c.is_ascii_digit() || c == '.');
    let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_');
    let label = |label: &str| {
        let dashes = label.starts_with('-') || label.ends_with('-');
        (1..=63).contains(&label.len()) && label.chars().all(plain) && !dashes
    };
    !numeric && text.len() <= 253 && text.strip_suffix('.').unwrap_or(text).split('.').all(label)
}

#[cfg(test)]
mod tests {
    use super::is_host;

    #[test]
    fn a_host_is_an_address_or_a_name_and_nothing_else() {
        for sound in
            ["127.0.0.1", "::1", "fe80::1", "localhost", "cell-1.plant", "ur_5e", "3com.example", "a."]
        {
            assert!(is_host(sound), "{sound}");
        }
        let long = "a".repeat(64);
        let wrong = [
            "",
            ".",
            "300.1.1.1",
            "1.2.3",
            "-a",
            "a-",
            "a..b",
            "http://a",
            "a:80",
            "a/b",
            "a b",
            "[::1]",
            "..",
            &long,
        ];
        for wrong in wrong {
            assert!(!is_host(wrong), "{wrong}");
        }
    }
}
