//! Small pieces of text that all reports share: escaping, numbers with units, aligned columns.
//!
//! In: values. Out: text. Pure.

/// Text safe between tags and in attribute values of HTML and SVG. Control characters become spaces.
pub fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\'' => escaped.push_str("&#39;"),
            c if c.is_control() && c != '\n' => escaped.push(' '),
            c => escaped.push(c),
        }
    }
    escaped
}

/// Seconds as people say them: `4.2 ms`, `0.31 s`, `83.1 s`, `3 min 05 s`, `4.2 h`.
pub fn seconds(seconds: f64) -> String {
    if seconds < 0.1 {
        format!("{:.1} ms", seconds * 1e3)
    } else if seconds < 10.0 {
        format!("{seconds:.2} s")
    } else if seconds < 120.0 {
        format!("{seconds:.1} s")
    } else if seconds >= 7200.0 {
        format!("{:.1} h", seconds / 3600.0)
    } else {
        let whole = seconds.round();
        format!("{:.0} min {:02.0} s", (whole / 60.0).floor(), whole % 60.0)
    }
}

/// A number that may be missing, as a dash.
pub fn or_dash<T>(value: Option<T>, text: impl FnOnce(T) -> String) -> String {
    value.map_or_else(|| "-".to_owned(), text)
}

/// A bound or cost: whole numbers without decimals.
pub fn plain_number(value: f64) -> String {
    if value == value.round() { format!("{value:.0}") } else { format!("{value:.2}") }
}

/// Rows in columns: the first column to the left, the others to the right, two spaces between.
pub fn columns(head: &[&str], rows: &[Vec<String>]) -> String {
    let width = |column: usize| {
        let cells = rows.iter().filter_map(|row| row.get(column)).map(|cell| cell.chars().count());
        cells.chain(head.get(column).map(|cell| cell.chars().count())).max().unwrap_or(0)
    };
    let widths: Vec<usize> = (0..head.len()).map(width).collect();
    let line = |cells: &[&str]| {
        let padded = cells.iter().zip(&widths).enumerate().map(|(column, (cell, width))| {
            if column == 0 { format!("{cell:<width$}") } else { format!("{cell:>width$}") }
        });
        padded.collect::<Vec<_>>().join("  ").trim_end().to_owned()
    };
    let mut lines = vec![line(head)];
    lines.push(widths.iter().map(|width| "-".repeat(*width)).collect::<Vec<_>>().join("  "));
    for row in rows {
        lines.push(line(&row.iter().map(String::as_str).collect::<Vec<_>>()));
    }
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_read_well() {
        let said: Vec<_> = [0.0042, 0.312, 83.14, 185.2, 119.99, 15_120.0].map(seconds).into();
        assert_eq!(said, ["4.2 ms", "0.31 s", "83.1 s", "3 min 05 s", "120.0 s", "4.2 h"]);
    }

    #[test]
    fn nothing_escapes_from_an_attribute() {
        assert_eq!(escape("<a href=\"x\" t='y'>&\u{7}"), "&lt;a href=&quot;x&quot; t=&#39;y&#39;&gt;&amp; ");
    }

    #[test]
    fn columns_line_up() {
        let rows = vec![vec!["mug".into(), "1.25".into()], vec!["a longer one".into(), "10.0".into()]];
        let expected = "object          mm\n------------  ----\nmug           1.25\na longer one  10.0";
        assert_eq!(columns(&["object", "mm"], &rows), expected);
    }
}
