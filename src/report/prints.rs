//! Sheets of markers for the printer: SVG and PDF at true scale, with a ruler to check them by.
//!
//! In: markers or a board, their size, the paper. Out: [`Sheet`]s, and their text as SVG (one file a sheet)
//! or PDF (one file). Everything on a sheet is black shapes, thin lines and words, so the PDF is written
//! plainly: no library, no embedded font, the same bytes every time. Lengths in mm, from the lower left
//! corner of the paper, y up. Pure.

use cell_values::units::mm_from_m;
use cell_vision::board::Board;
use cell_vision::detect::Family;
use cell_vision::detect::family::Pattern;
use std::fmt::Write;

/// Paper sizes, upright.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Paper {
    /// 210 x 297 mm.
    A4,
    /// 215.9 x 279.4 mm.
    Letter,
}

impl Paper {
    fn upright_mm(self) -> [f64; 2] {
        match self {
            Paper::A4 => [210.0, 297.0],
            Paper::Letter => [215.9, 279.4],
        }
    }
}

/// Paper that printers leave white all round, mm.
const MARGIN_MM: f64 = 8.0;
/// Strip at the foot for the ruler and the words, mm.
const FOOT_MM: f64 = 16.0;
/// The ruler, mm.
const RULER_MM: f64 = 100.0;
/// Between two markers, with room for the words under each, mm.
const BETWEEN_MM: f64 = 6.0;
/// From a marker's cutting mark to its caption: the two must not run into each other.
const CAPTION_MM: f64 = 3.0;
const POINTS_PER_MM: f64 = 72.0 / 25.4;

/// Why there is no sheet.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PrintFault {
    /// The family has no such marker.
    #[error("{family} has markers 0 to {last}, not {id}")]
    NoSuchMarker {
        /// The family's name.
        family: &'static str,
        /// What was requested.
        id: u32,
        /// The largest number it has.
        last: u32,
    },
    /// It does not fit the paper.
    #[error(
        "{width_mm:.1} x {height_mm:.1} mm do not fit the paper, which has room for {room_wide_mm:.1} x \
         {room_high_mm:.1} mm: {hint}"
    )]
    TooLarge {
        /// What is to be printed.
        width_mm: f64,
        /// See `width_mm`.
        height_mm: f64,
        /// Room on the paper, the better way round.
        room_wide_mm: f64,
        /// See `room_wide_mm`.
        room_high_mm: f64,
        /// What to change.
        hint: &'static str,
    },
    /// Nothing to print.
    #[error("no markers to print: name some with --ids")]
    Nothing,
}

/// A filled black rectangle by its lower left corner: x, y, width, height, mm.
type Bar = [f64; 4];

/// Words on a sheet.
#[derive(Clone, Debug, PartialEq)]
struct Label {
    /// Left end of the base line, mm.
    at_mm: [f64; 2],
    /// Letter height, mm.
    height_mm: f64,
    /// The words.
    text: String,
}

/// One sheet of paper.
#[derive(Clone, Debug, PartialEq)]
pub struct Sheet {
    /// Width and height, mm.
    pub size_mm: [f64; 2],
    /// Groups of black bars; the bars of a group are filled as one shape, so that no seam shows between
    /// them.
    shapes: Vec<Vec<Bar>>,
    /// Grey hairlines to cut along: from, to.
    cuts: Vec<[[f64; 2]; 2]>,
    words: Vec<Label>,
}

/// Object markers, as many to a sheet as fit, each with its name and cutting lines.
///
/// # Errors
/// `NoSuchMarker`, `TooLarge`, `Nothing`.
pub fn markers(family: Family, ids: &[u32], size_m: f64, paper: Paper) -> Result<Vec<Sheet>, PrintFault> {
    let patterns = ids.iter().map(|id| pattern(family, *id)).collect::<Result<Vec<_>, _>>()?;
    let edge = mm_from_m(patterns.first().ok_or(PrintFault::Nothing)?.print_edge_m(size_m));
    let size_mm = paper.upright_mm();
    let room = room(size_mm);
    let fit = |axis: usize| ((room[axis] + BETWEEN_MM) / (edge + BETWEEN_MM)).floor() as usize;
    let (columns, rows) = (fit(0), fit(1));
    if columns == 0 || rows == 0 {
        let hint = "choose smaller markers (--size-mm)";
        let [room_wide_mm, room_high_mm] = room;
        return Err(PrintFault::TooLarge {
            width_mm: edge,
            height_mm: edge,
            room_wide_mm,
            room_high_mm,
            hint,
        });
    }
    let all: Vec<_> = ids.iter().zip(&patterns).collect();
    let sheets = all.chunks(columns * rows).map(|chunk| {
        let mut sheet = Sheet::blank(size_mm);
        for (place, (id, pattern)) in chunk.iter().enumerate() {
            let x = MARGIN_MM + (place % columns) as f64 * (edge + BETWEEN_MM);
            let top = size_mm[1] - MARGIN_MM - (place / columns) as f64 * (edge + BETWEEN_MM);
            sheet.marker(pattern, [x, top - edge], edge);
            sheet.frame([x, top - edge], edge);
            let text = format!("{family} {id}, {} mm", number(mm_from_m(size_m)));
            sheet.words.push(Label { at_mm: [x + CAPTION_MM, top - edge - 3.4], height_mm: 2.4, text });
        }
        sheet.foot(&format!("{family}, black square {} mm", number(mm_from_m(size_m))));
        sheet
    });
    Ok(sheets.collect())
}

/// A calibration board on one sheet, the paper turned the way it fits.
///
/// # Errors
/// `NoSuchMarker`, `TooLarge`.
pub fn board(board: &Board, paper: Paper) -> Result<Sheet, PrintFault> {
    let ring = {
        let pattern = pattern(board.family, board.first_id)?;
        mm_from_m((pattern.print_edge_m(board.size_m) - board.size_m) / 2.0)
    };
    let wanted = board.extent_m().map(|m| mm_from_m(m) + 2.0 * ring);
    let [wide, high] = paper.upright_mm();
    let ways = [[wide, high], [high, wide]];
    let fits = |size: &[f64; 2]| (0..2).all(|axis| wanted[axis] <= room(*size)[axis]);
    let Some(size_mm) = ways.into_iter().find(fits) else {
        let [room_wide_mm, room_high_mm] = room(if wanted[0] > wanted[1] { ways[1] } else { ways[0] });
        let [width_mm, height_mm] = wanted;
        let hint = "choose fewer or smaller markers (--board, --size-mm)";
        return Err(PrintFault::TooLarge { width_mm, height_mm, room_wide_mm, room_high_mm, hint });
    };
    let mut sheet = Sheet::blank(size_mm);
    let left = (size_mm[0] - wanted[0]) / 2.0 + ring;
    let below = MARGIN_MM + FOOT_MM + (room(size_mm)[1] - wanted[1]) / 2.0 + ring;
    for (id, [x, y]) in board.markers() {
        let pattern = pattern(board.family, id)?;
        let edge = mm_from_m(pattern.print_edge_m(board.size_m));
        let corner = [left + mm_from_m(x) - edge / 2.0, below + mm_from_m(y) - edge / 2.0];
        sheet.marker(&pattern, corner, edge);
    }
    sheet.foot(&format!(
        "{} board {}x{}, first id {}, black squares {} mm, {} mm apart",
        board.family,
        board.columns,
        board.rows,
        board.first_id,
        number(mm_from_m(board.size_m)),
        number(mm_from_m(board.gap_m))
    ));
    Ok(sheet)
}

fn pattern(family: Family, id: u32) -> Result<Pattern, PrintFault> {
    let last = family.count().saturating_sub(1);
    family.pattern(id).ok_or(PrintFault::NoSuchMarker { family: family.name(), id, last })
}

/// Room for markers on paper of this size, mm.
fn room([wide, high]: [f64; 2]) -> [f64; 2] {
    [wide - 2.0 * MARGIN_MM, high - 2.0 * MARGIN_MM - FOOT_MM]
}

/// A length without trailing zeros.
fn number(value: f64) -> String {
    let text = format!("{value:.3}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

impl Sheet {
    fn blank(size_mm: [f64; 2]) -> Sheet {
        Sheet { size_mm, shapes: Vec::new(), cuts: Vec::new(), words: Vec::new() }
    }

    /// The black modules of a marker whose print has this lower left corner and edge, row by row.
    fn marker(&mut self, pattern: &Pattern, [x, y]: [f64; 2], edge: f64) {
        let module = edge / pattern.modules as f64;
        let mut bars = Vec::new();
        for row in 0..pattern.modules {
            let mut column = 0;
            while column < pattern.modules {
                let run = (column..pattern.modules).take_while(|c| !pattern.is_white(*c, row)).count();
                if run > 0 {
                    let up = (pattern.modules - 1 - row) as f64 * module;
                    bars.push([x + column as f64 * module, y + up, run as f64 * module, module]);
                }
                column += run.max(1);
            }
        }
        self.shapes.push(bars);
    }

    /// Cutting marks outside the corners of a print.
    fn frame(&mut self, [x, y]: [f64; 2], edge: f64) {
        for (cx, cy, dx, dy) in [
            (x, y, -1.0, -1.0),
            (x + edge, y, 1.0, -1.0),
            (x, y + edge, -1.0, 1.0),
            (x + edge, y + edge, 1.0, 1.0),
        ] {
            self.cuts.push([[cx + 0.5 * dx, cy], [cx + 2.5 * dx, cy]]);
            self.cuts.push([[cx, cy + 0.5 * dy], [cx, cy + 2.5 * dy]]);
        }
    }

    /// The ruler and what the sheet is.
    fn foot(&mut self, what: &str) {
        let (x, y) = (MARGIN_MM, MARGIN_MM + 4.0);
        let mut bars = vec![[x, y, RULER_MM, 0.3]];
        for tick in 0..=RULER_MM as u32 {
            let high = match tick {
                t if t.is_multiple_of(10) => 4.0,
                t if t.is_multiple_of(5) => 3.0,
                _ => 2.0,
            };
            // The outer edges of the first and the last tick are 100 mm apart.
            let at = x + f64::from(tick) * (RULER_MM - 0.15) / RULER_MM;
            bars.push([at, y, 0.15, high]);
        }
        self.shapes.push(bars);
        let check = "This ruler is 100 mm from end to end. Print at 100 %, measure it, and do not use the \
                     sheet if it is not.";
        self.words.push(Label { at_mm: [x, MARGIN_MM], height_mm: 2.6, text: check.to_owned() });
        let at_mm = [x + RULER_MM + 5.0, y + 1.0];
        self.words.push(Label { at_mm, height_mm: 3.0, text: what.to_owned() });
    }

    /// The sheet as an SVG file in true millimetres.
    pub fn svg(&self) -> String {
        let [wide, high] = self.size_mm;
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{wide}mm\" height=\"{high}mm\" viewBox=\"0 0 \
             {wide} {high}\" \
             font-family=\"Helvetica, Arial, sans-serif\">\n\
             <rect width=\"{wide}\" height=\"{high}\" fill=\"#fff\"/>\n"
        );
        for bars in &self.shapes {
            svg.push_str("<path fill=\"#000\" d=\"");
            for [x, y, w, h] in bars {
                let _ = write!(
                    svg,
                    "M{} {}h{}v{}h-{}z",
                    number4(*x),
                    number4(high - y - h),
                    number4(*w),
                    number4(*h),
                    number4(*w)
                );
            }
            svg.push_str("\"/>\n");
        }
        for [[ax, ay], [bx, by]] in &self.cuts {
            let _ = writeln!(
                svg,
                "<path stroke=\"#999\" stroke-width=\"0.1\" d=\"M{ax:.3} {:.3}L{bx:.3} {:.3}\"/>",
                high - ay,
                high - by
            );
        }
        for Label { at_mm: [x, y], height_mm: size, text } in &self.words {
            let _ =
                writeln!(svg, "<text x=\"{x:.3}\" y=\"{:.3}\" font-size=\"{size}\">{text}</text>", high - y);
        }
        svg.push_str("</svg>\n");
        svg
    }

    /// The sheet's drawing commands for a PDF.
    fn pdf_content(&self) -> String {
        let mut text = String::new();
        let pt = |mm: f64| number4(mm * POINTS_PER_MM);
        for bars in &self.shapes {
            for [x, y, w, h] in bars {
                let _ = writeln!(text, "{} {} {} {} re", pt(*x), pt(*y), pt(*w), pt(*h));
            }
            text.push_str("f\n");
        }
        text.push_str("0.6 G 0.3 w\n");
        for [[ax, ay], [bx, by]] in &self.cuts {
            let _ = writeln!(text, "{} {} m {} {} l S", pt(*ax), pt(*ay), pt(*bx), pt(*by));
        }
        for Label { at_mm: [x, y], height_mm: size, text: words } in &self.words {
            let safe = words.replace('\\', "\\\\").replace('(', "\\(").replace(')', "\\)");
            let _ = writeln!(text, "BT /F1 {} Tf {} {} Td ({safe}) Tj ET", pt(*size), pt(*x), pt(*y));
        }
        text
    }
}

fn number4(value: f64) -> String {
    let text = format!("{value:.4}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// All sheets as one PDF file (PDF 1.4, the reader's own Helvetica, no compression).
pub fn pdf(sheets: &[Sheet]) -> String {
    let mut objects = vec![
        "<< /Type /Catalog /Pages 2 0 R >>".to_owned(),
        String::new(),
        "<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>".to_owned(),
    ];
    let mut pages = Vec::new();
    for sheet in sheets {
        let [wide, high] = sheet.size_mm.map(|mm| number4(mm * POINTS_PER_MM));
        let content = sheet.pdf_content();
        objects.push(format!("<< /Length {} >>\nstream\n{content}endstream", content.len()));
        let stream = objects.len();
        objects.push(format!(
            "<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {wide} {high}] /Contents {stream} 0 R \
             /Resources << /Font << /F1 3 0 R >> >> >>"
        ));
        pages.push(format!("{} 0 R", objects.len()));
    }
    objects[1] = format!("<< /Type /Pages /Kids [{}] /Count {} >>", pages.join(" "), pages.len());
    let mut file = String::from("%PDF-1.4\n");
    let mut places = Vec::new();
    for (index, object) in objects.iter().enumerate() {
        places.push(file.len());
        let _ = write!(file, "{} 0 obj\n{object}\nendobj\n", index + 1);
    }
    let table = file.len();
    let _ = write!(file, "xref\n0 {}\n0000000000 65535 f \n", objects.len() + 1);
    for place in &places {
        let _ = writeln!(file, "{place:010} 00000 n ");
    }
    let _ =
        write!(file, "trailer\n<< /Size {} /Root 1 0 R >>\nstartxref\n{table}\n%%EOF\n", objects.len() + 1);
    file
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::raster;
    use cell_values::image::Image;
    use cell_vision::detect::{DetectSettings, Detector};
    use cell_vision::testing;

    /// Pixels to a millimetre in the pictures of these tests.
    const SCALE: f32 = 5.0;

    /// What a detector finds on the sheet, in mm from its upper left corner.
    fn found(sheet: &Sheet, family: Family) -> Vec<(u32, [[f64; 2]; 4])> {
        // The drawing's units are mm; resvg takes an inch as 96 of them.
        let svg = sheet.svg().replace("mm\"", "\"");
        let mut picture = Image::decode(&raster::png(&svg, SCALE).unwrap()).unwrap().gray();
        // As a lens does: corners are fitted to blurred edges, and sharper ones are known to a fifth of a
        // pixel only.
        let mut light: Vec<f64> = picture.data.iter().copied().map(f64::from).collect();
        testing::blur(&mut light, picture.width as usize, picture.height as usize, 1.0);
        picture.data = light.into_iter().map(|value| value.round() as u8).collect();
        let mut detector = Detector::of(&[family], DetectSettings::default()).unwrap();
        let mm = |pixel: f64| (pixel + 0.5) / f64::from(SCALE);
        detector.detect(&picture).unwrap().into_iter().map(|d| (d.id, d.corners.map(|c| c.map(mm)))).collect()
    }

    #[test]
    fn printed_markers_are_found_at_their_true_size() {
        for family in [Family::Tag36h11, Family::Tag25h9, Family::TagStandard41h12] {
            let sheets = markers(family, &[0, 3, 7, 21], 0.03, Paper::A4).unwrap();
            assert_eq!(sheets.len(), 1);
            let found = found(&sheets[0], family);
            assert_eq!(found.iter().map(|f| f.0).collect::<Vec<_>>(), [0, 3, 7, 21], "{family}");
            for (id, corners) in found {
                let edge = |i: usize| {
                    let (a, b) = (corners[i], corners[(i + 1) % 4]);
                    (a[0] - b[0]).hypot(a[1] - b[1])
                };
                assert!(
                    (0..4).all(|i| (edge(i) - 30.0).abs() < 0.03),
                    "{family} {id}: {:?}",
                    [0, 1, 2, 3].map(edge)
                );
            }
        }
    }

    #[test]
    fn a_board_is_where_its_geometry_says() {
        let grid = Board::new(Family::Tag36h11, 7, 5, 0.027, 20);
        let sheet = board(&grid, Paper::A4).unwrap();
        assert_eq!(sheet.size_mm, [297.0, 210.0], "turned the way it fits");
        let found = found(&sheet, Family::Tag36h11);
        assert_eq!(found.len(), 35);
        let corner = |id: u32| found.iter().find(|f| f.0 == id).unwrap().1[0];
        let origin = corner(20);
        for (id, _) in grid.markers() {
            let [x, y] = grid.corners(id).unwrap()[0];
            let there = corner(id);
            let off = (there[0] - origin[0] - 1e3 * x).hypot(origin[1] - there[1] - 1e3 * y);
            assert!(off < 0.05, "{id}: {off} mm");
        }
    }

    #[test]
    fn many_markers_take_several_sheets_and_bad_wishes_are_reported() {
        let ids: Vec<u32> = (0..100).collect();
        assert!(markers(Family::Tag36h11, &ids, 0.03, Paper::Letter).unwrap().len() > 1);
        let reported = |result: Result<Vec<Sheet>, PrintFault>| result.unwrap_err().to_string();
        assert!(reported(markers(Family::Tag16h5, &[30], 0.03, Paper::A4)).contains("0 to 29, not 30"));
        assert!(reported(markers(Family::Tag36h11, &[1], 0.3, Paper::A4)).contains("--size-mm"));
        assert!(reported(markers(Family::Tag36h11, &[], 0.03, Paper::A4)).contains("--ids"));
        let large = Board::new(Family::Tag36h11, 9, 9, 0.03, 0);
        assert!(board(&large, Paper::A4).unwrap_err().to_string().contains("--board"));
    }

    #[test]
    fn the_pdf_is_whole_and_says_its_size() {
        let sheets = markers(Family::Tag36h11, &(0..60).collect::<Vec<_>>(), 0.03, Paper::A4).unwrap();
        let file = pdf(&sheets);
        assert!(file.is_ascii() && file.contains("/MediaBox [0 0 595.2756 841.8898]"));
        assert!(file.contains(&format!("/Count {}", sheets.len())));
        // Every entry of the table points at its object.
        let table: usize =
            file.rsplit("startxref\n").next().unwrap().lines().next().unwrap().parse().unwrap();
        let entries = file[table..].lines().skip(3).take_while(|line| line.ends_with(" n "));
        for (index, entry) in entries.enumerate() {
            let place: usize = entry[..10].parse().unwrap();
            assert!(file[place..].starts_with(&format!("{} 0 obj", index + 1)));
        }
    }
}
