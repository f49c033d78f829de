//! Where the time of a run went, as a picture: one bar for each pick-n-place, in the order of the run.
//!
//! In: for each row its label and seconds by use. Out: an `<svg>` element. Uses have the same colours and
//! the same order in every bar. Pure.

use crate::report::text::escape;
use std::fmt::Write as _;

/// One bar: its label, and seconds by use.
#[derive(Clone, Debug, PartialEq)]
pub struct TimeRow {
    /// What it is of.
    pub label: String,
    /// Use and seconds, in the order in which they are drawn.
    pub parts: Vec<(&'static str, f64)>,
}

/// Colours that colour-blind people distinguish, after Okabe and Ito; rests are darker than motion.
const COLOURS: [&str; 9] =
    ["#56b4e9", "#0072b2", "#009e73", "#e69f00", "#f0e442", "#d55e00", "#cc79a7", "#777777", "#222222"];

const LABEL: f64 = 120.0;
const WIDTH: f64 = 620.0;
const BAR: f64 = 16.0;
const ROW: f64 = 22.0;
const TOP: f64 = 52.0;

/// Draws the bars; an empty text where there is none.
pub fn times_svg(rows: &[TimeRow]) -> String {
    let total = |row: &TimeRow| row.parts.iter().map(|(_, seconds)| seconds.max(0.0)).sum::<f64>();
    let longest = rows.iter().map(total).fold(0.0, f64::max);
    if longest <= 0.0 || !longest.is_finite() {
        return String::new();
    }
    let (width, height) = (LABEL + WIDTH + 60.0, TOP + ROW * rows.len() as f64 + 8.0);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.0}\" height=\"{height:.0}\" \
         viewBox=\"0 0 {width:.0} {height:.0}\" font-family=\"sans-serif\" font-size=\"12\" role=\"img\" \
         aria-label=\"Where the time went\">\n<rect width=\"{width:.0}\" height=\"{height:.0}\" fill=\"#fff\"/>\n"
    );
    let names: Vec<&str> = rows[0].parts.iter().map(|(name, _)| *name).collect();
    for (index, name) in names.iter().enumerate() {
        let (x, y) = (LABEL + 130.0 * (index % 5) as f64, 8.0 + 18.0 * (index / 5) as f64);
        let colour = COLOURS[index % COLOURS.len()];
        let _ = writeln!(
            svg,
            "<rect x=\"{x:.0}\" y=\"{y:.0}\" width=\"12\" height=\"12\" fill=\"{colour}\"/><text x=\"{:.0}\" \
             y=\"{:.0}\" fill=\"#222\">{}</text>",
            x + 17.0,
            y + 10.5,
            escape(name)
        );
    }
    for (index, row) in rows.iter().enumerate() {
        bar(&mut svg, row, TOP + ROW * index as f64, WIDTH / longest);
    }
    svg.push_str("</svg>\n");
    svg
}

fn bar(svg: &mut String, row: &TimeRow, y: f64, scale: f64) {
    let _ = writeln!(
        svg,
        "<text x=\"{:.0}\" y=\"{:.1}\" text-anchor=\"end\" fill=\"#222\">{}</text>",
        LABEL - 8.0,
        y + BAR - 4.0,
        escape(&row.label)
    );
    let mut x = LABEL;
    for (index, (name, seconds)) in row.parts.iter().enumerate() {
        let length = seconds.max(0.0) * scale;
        let colour = COLOURS[index % COLOURS.len()];
        let _ = writeln!(
            svg,
            "<rect x=\"{x:.2}\" y=\"{y:.1}\" width=\"{length:.2}\" height=\"{BAR}\" fill=\"{colour}\">\
             <title>{} {seconds:.2} s</title></rect>",
            escape(name)
        );
        x += length;
    }
    let total = row.parts.iter().map(|(_, seconds)| seconds.max(0.0)).sum::<f64>();
    let (x, y) = (x + 6.0, y + BAR - 4.0);
    let _ = writeln!(svg, "<text x=\"{x:.1}\" y=\"{y:.1}\" fill=\"#222\">{total:.1} s</text>");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bars_are_as_long_as_their_seconds_and_no_time_is_no_picture() {
        let row = |label: &str, a: f64, b: f64| TimeRow {
            label: label.to_string(),
            parts: vec![("travel", a), ("waiting", b)],
        };
        let svg = times_svg(&[row("1 <plank>", 2.0, 1.0), row("2 lid", 6.0, 0.0)]);
        assert!(svg.contains("1 &lt;plank&gt;") && svg.contains("3.0 s") && svg.contains("6.0 s"), "{svg}");
        // Of 620 pixels for 6 s.
        assert!(svg.contains("width=\"206.67\"") && svg.contains("width=\"103.33\""), "{svg}");
        assert_eq!(times_svg(&[]), "");
        assert_eq!(times_svg(&[row("", 0.0, f64::NAN)]), "");
    }
}
