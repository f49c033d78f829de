//! What clients wrap a file and a name in: multipart forms and percent signs.
//!
//! In: bytes of a client. Out: the file in the form, the text of a part of a path, or nothing where the
//! bytes are neither. Pure; nothing is copied but the text.

/// Longest boundary of a form (RFC 2046), bytes.
const MAX_BOUNDARY: usize = 70;

/// The file in a form of this `Content-Type`: its first part that has a file name or is called `file`.
pub fn file_of<'a>(content_type: &str, body: &'a [u8]) -> Option<&'a [u8]> {
    let boundary = boundary(content_type)?;
    let (first, further) = (format!("--{boundary}"), format!("\r\n--{boundary}"));
    let mut rest = &body[find(body, first.as_bytes())? + first.len()..];
    // Behind the last part the boundary has two dashes.
    while let Some(part) = rest.strip_prefix(b"\r\n") {
        let end = find(part, further.as_bytes())?;
        let (part, behind) = part.split_at(end);
        let head = find(part, b"\r\n\r\n")?;
        let (headers, content) = (String::from_utf8_lossy(&part[..head]), &part[head + 4..]);
        if headers.lines().any(is_file) {
            return Some(content);
        }
        rest = &behind[further.len()..];
    }
    None
}

fn is_file(header: &str) -> bool {
    let Some((name, value)) = header.split_once(':') else { return false };
    name.trim().eq_ignore_ascii_case("content-disposition")
        && value.split(';').map(str::trim).any(|part| part.starts_with("filename") || part == "name=\"file\"")
}

fn boundary(content_type: &str) -> Option<&str> {
    let mut parts = content_type.split(';').map(str::trim);
    parts.next().filter(|kind| kind.eq_ignore_ascii_case("multipart/form-data"))?;
    let named = parts.find_map(|part| {
        let (key, value) = part.split_once('=')?;
        key.eq_ignore_ascii_case("boundary").then(|| value.trim_matches('"'))
    })?;
    (1..=MAX_BOUNDARY).contains(&named.len()).then_some(named)
}

fn find(text: &[u8], wanted: &[u8]) -> Option<usize> {
    text.windows(wanted.len()).position(|window| window == wanted)
}

/// A part of a path as text.
pub fn decoded(part: &str) -> Option<String> {
    let mut bytes = Vec::with_capacity(part.len());
    let mut rest = part.bytes();
    while let Some(byte) = rest.next() {
        bytes.push(match byte {
            b'%' => {
                let mut digit = || char::from(rest.next()?).to_digit(16);
                let (high, low) = (digit()?, digit()?);
                u8::try_from(high * 16 + low).ok()?
            }
            plain => plain,
        });
    }
    String::from_utf8(bytes).ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const TYPE: &str = "multipart/form-data; boundary=xyz";

    #[test]
    fn the_file_is_found_among_the_parts_of_a_form() {
        let plain = "--xyz\r\nContent-Disposition: form-data; name=\"note\"\r\n\r\nhello\r\n";
        let file = "--xyz\r\ncontent-disposition: form-data; name=\"any\"; filename=\"a.urpx\"\r\nContent-Type: \
                    text/plain\r\n\r\n{\r\n}\r\n--xyz--\r\n";
        assert_eq!(file_of(TYPE, format!("{plain}{file}").as_bytes()), Some(&b"{\r\n}"[..]));
        assert_eq!(file_of("Multipart/Form-Data; Boundary=\"xyz\"", file.as_bytes()), Some(&b"{\r\n}"[..]));
        for (kind, body) in [
            (TYPE, plain),
            (TYPE, &file[..file.len() - 12]),
            (TYPE, ""),
            ("application/json", file),
            ("multipart/form-data", file),
            ("multipart/form-data; boundary=", file),
        ] {
            assert_eq!(file_of(kind, body.as_bytes()), None, "{kind} {body:?}");
        }
    }

    #[test]
    fn percent_signs_are_undone() {
        assert_eq!(decoded("test%20upload").as_deref(), Some("test upload"));
        for wrong in ["%", "%2", "%zz", "%ff", "%+1"] {
            assert_eq!(decoded(wrong), None, "{wrong}");
        }
    }

    proptest! {
        #[test]
        fn no_bytes_break_a_form(
            kind in "multipart/form-data; ?boundary=\"?[-x]{0,3}\"?",
            body in prop::collection::vec(prop::sample::select(b"-x\r\n:;ab".to_vec()), 0..200),
        ) {
            let _ = file_of(&kind, &body);
            let _ = decoded(&String::from_utf8_lossy(&body));
        }
    }
}
