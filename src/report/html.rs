//! One HTML page about a run that needs nothing else: pictures inside, drawings inside, no script.
//!
//! In: a [`RunReport`]. Out: the page as text, legible in light and in dark, on paper and on a telephone.
//! Everything that came from a file or a device is escaped; drawings are `report`'s own SVG and go in as
//! they are. Pure.

use crate::report::run::{
    Deviation, Drawing, Figures, LogRow, MoveRow, ObjectRow, Picture, RunReport, deviation,
};
use crate::report::summary::figures;
use crate::report::text::{escape, or_dash, seconds};
use base64::Engine as _;
use rearrange::geometry::pose::Pose2;
use std::fmt::Write as _;

const STYLE: &str = include_str!("page.css");

/// The whole page.
pub fn html(report: &RunReport) -> String {
    let mut page = String::new();
    let _ = write!(
        page,
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\
         <title>{} - celld</title><style>{STYLE}</style></head>\n<body><main>\n",
        escape(&report.title)
    );
    header(&mut page, report);
    figure_list(&mut page, &report.figures);
    pictures(&mut page, &report.pictures);
    drawings(&mut page, &report.drawings);
    objects(&mut page, &report.objects, &report.figures);
    moves(&mut page, &report.moves);
    log(&mut page, &report.log);
    settings(&mut page, &report.settings);
    page.push_str("</main></body></html>\n");
    page
}

fn header(page: &mut String, report: &RunReport) {
    let (class, word) = if report.reached { ("good", "goal reached") } else { ("bad", "goal not reached") };
    let _ = writeln!(
        page,
        "<header><span class=\"verdict {class}\">{word}</span><h1>{}</h1><p>{}</p></header>",
        escape(&report.title),
        escape(&report.headline)
    );
}

fn figure_list(page: &mut String, values: &Figures) {
    page.push_str("<dl class=\"figures\">");
    for (label, value) in figures(values) {
        let _ = write!(page, "<div><dt>{}</dt><dd>{}</dd></div>", escape(&label), escape(&value));
    }
    page.push_str("</dl>\n");
}

fn pictures(page: &mut String, pictures: &[Picture]) {
    if pictures.is_empty() {
        return;
    }
    page.push_str("<h2>What the camera saw</h2><div class=\"side\">");
    for picture in pictures {
        let data = base64::engine::general_purpose::STANDARD.encode(&picture.bytes);
        let caption = escape(&picture.caption);
        let _ = write!(
            page,
            "<figure><img alt=\"{caption}\" \
             src=\"data:{};base64,{data}\"><figcaption>{caption}</figcaption></figure>",
            picture.media_type
        );
    }
    page.push_str("</div>\n");
}

fn drawings(page: &mut String, drawings: &[Drawing]) {
    if drawings.is_empty() {
        return;
    }
    page.push_str("<h2>Arrangement and plan</h2><div class=\"stack\">");
    for drawing in drawings {
        let caption = escape(&drawing.caption);
        let _ = write!(page, "<figure>{}<figcaption>{caption}</figcaption></figure>", drawing.svg);
    }
    page.push_str("</div>\n");
}

fn objects(page: &mut String, objects: &[ObjectRow], values: &Figures) {
    if objects.is_empty() {
        return;
    }
    let with_truth = objects.iter().any(|object| object.truth.is_some());
    let _ = write!(
        page,
        "<h2>Objects</h2><p>Distance to the goal; {:.1} mm and {:.1} degrees are allowed.</p>\
         <div class=\"scroll\"><table><thead><tr><th>object</th><th>goal: x, y, angle</th><th>seen last \
         at</th><th>from the goal</th><th></th>{}</tr></thead><tbody>",
        values.tolerance_mm,
        values.tolerance_deg,
        if with_truth { "<th>in the simulated world</th><th></th>" } else { "" }
    );
    for object in objects {
        let seen = object.measured.map(pose).or(object.unseen.as_deref().map(escape));
        let _ = write!(
            page,
            "<tr><td>{}</td><td>{}</td><td>{}</td>",
            escape(&object.id),
            or_dash(object.goal, pose),
            or_dash(seen, |words| words)
        );
        deviation_cells(page, deviation(object.goal, object.measured), values);
        if with_truth {
            deviation_cells(page, deviation(object.goal, object.truth), values);
        }
        page.push_str("</tr>");
    }
    page.push_str("</tbody></table></div>\n");
}

/// The distance with a bar that is full at the tolerance, and the angle.
fn deviation_cells(page: &mut String, deviation: Option<Deviation>, values: &Figures) {
    let Some(Deviation { mm, deg }) = deviation else {
        page.push_str("<td>-</td><td></td>");
        return;
    };
    let good = mm <= values.tolerance_mm && deg <= values.tolerance_deg;
    let share = (mm / values.tolerance_mm.max(1e-9)).max(deg / values.tolerance_deg.max(1e-9));
    let percent = (share * 100.0).clamp(2.0, 100.0);
    let class = if good { "good" } else { "bad" };
    let _ = write!(
        page,
        "<td class=\"{class}\">{mm:.2} mm<span class=\"bar\"><i \
         style=\"width:{percent:.0}%\"></i></span></td><td>{deg:.2}&deg;</td>"
    );
}

fn moves(page: &mut String, moves: &[MoveRow]) {
    if moves.is_empty() {
        return;
    }
    let with_vacuum = moves.iter().any(|row| row.vacuum.is_some());
    let _ = write!(
        page,
        "<h2>Pick-n-places</h2><div class=\"scroll\"><table><thead><tr><th>no.</th><th \
         class=\"text\">object</th><th \
         class=\"text\">to</th><th>from</th><th>to</th>{}<th>time</th></tr></thead><tbody>",
        if with_vacuum { "<th>vacuum</th>" } else { "" }
    );
    for (index, row) in moves.iter().enumerate() {
        let kind = if row.buffer { "buffer" } else { "goal" };
        let _ = write!(
            page,
            "<tr><td>{}</td><td class=\"text\">{}</td><td class=\"text\"><span class=\"kind \
             {kind}\">{kind}</span></td><td>{}</td><td>{}</td>",
            index + 1,
            escape(&row.object),
            pose(row.from),
            pose(row.to)
        );
        if with_vacuum {
            let _ =
                write!(page, "<td>{}</td>", or_dash(row.vacuum, |vacuum| format!("{:.0} %", vacuum * 100.0)));
        }
        let _ = match &row.unfinished {
            Some(words) => {
                let class = if row.anew { "soft" } else { "bad" };
                write!(page, "<td class=\"{class}\">{}</td></tr>", escape(words))
            }
            None => write!(page, "<td>{}</td></tr>", or_dash(row.seconds, seconds)),
        };
    }
    page.push_str("</tbody></table></div>\n");
}

fn pose(pose: Pose2) -> String {
    format!("{:.1}, {:.1} mm, {:.1}&deg;", pose.x * 1e3, pose.y * 1e3, pose.theta.to_degrees())
}

fn log(page: &mut String, log: &[LogRow]) {
    if log.is_empty() {
        return;
    }
    let _ = write!(page, "<details><summary>Log ({} lines)</summary><ol class=\"log\">", log.len());
    for row in log {
        let _ = write!(
            page,
            "<li class=\"{}\"><b>{}</b>{}</li>",
            escape(row.level),
            row.seconds.map_or_else(String::new, |seconds| format!("{seconds:.2} s")),
            escape(&row.text)
        );
    }
    page.push_str("</ol></details>\n");
}

fn settings(page: &mut String, settings: &[(String, String)]) {
    if settings.is_empty() {
        return;
    }
    page.push_str("<p class=\"settings\">");
    for (label, value) in settings {
        let _ = write!(page, "<span>{}: {}</span> ", escape(label), escape(value));
    }
    page.push_str("</p>\n");
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::table_svg::{DrawnObject, TableDrawing, table_svg};
    use rearrange::geometry::footprint::Footprint;

    const GOAL: Option<Pose2> = Some(Pose2 { x: 0.3, y: 0.2, theta: 0.5 });
    const NEAR: Option<Pose2> = Some(Pose2 { x: 0.3004, y: 0.2003, theta: 0.504 });
    const FAR: Option<Pose2> = Some(Pose2 { x: 0.31, y: 0.2, theta: 0.5 });

    fn objects() -> Vec<ObjectRow> {
        let row = |id: &str, measured, unseen: Option<&str>, truth| ObjectRow {
            id: id.to_string(),
            goal: GOAL,
            measured,
            unseen: unseen.map(str::to_string),
            truth,
        };
        vec![
            row("plank-1", NEAR, None, NEAR),
            row("plank-2", FAR, None, None),
            row("plank-3", None, Some("not seen since it was gripped"), None),
        ]
    }

    fn report() -> RunReport {
        let footprint = Footprint::rectangle(0.1, 0.05).unwrap();
        let drawing = table_svg(&TableDrawing {
            title: "end",
            width_m: 0.5,
            height_m: 0.4,
            keep_out: Vec::new(),
            objects: vec![DrawnObject {
                id: "plank-1",
                footprint: &footprint,
                start: GOAL,
                goal: GOAL,
                measured: NEAR,
            }],
        });
        RunReport {
            title: "planks <b>".into(),
            reached: true,
            headline: "Every object is where it should be.".into(),
            figures: Figures { moves: 1, tolerance_mm: 2.0, tolerance_deg: 1.0, ..Figures::default() },
            moves: vec![
                MoveRow {
                    object: "plank-1".into(),
                    buffer: true,
                    from: Pose2::default(),
                    to: Pose2::new(0.3, 0.2, 0.5),
                    unfinished: None,
                    anew: false,
                    seconds: Some(7.2),
                    vacuum: Some(0.62),
                },
                MoveRow {
                    object: "plank-2".into(),
                    buffer: false,
                    from: Pose2::default(),
                    to: Pose2::new(0.3, 0.2, 0.5),
                    unfinished: Some("was gripped, on its way".into()),
                    anew: false,
                    seconds: None,
                    vacuum: None,
                },
            ],
            objects: objects(),
            pictures: vec![Picture {
                caption: "start".into(),
                media_type: "image/png",
                bytes: vec![1, 2, 3],
            }],
            drawings: vec![Drawing { caption: "end".into(), svg: drawing }],
            log: vec![LogRow { seconds: Some(1.5), level: "warning", text: "slow <turn>".into() }],
            settings: vec![("seed".into(), "7".into())],
        }
    }

    #[test]
    fn the_page_needs_nothing_from_outside() {
        let page = html(&report());
        for outside in ["http:", "https:", "<script", "@import", "url(", "<link"] {
            let inside = page.replace("http://www.w3.org/2000/svg", "");
            assert!(!inside.contains(outside), "{outside}");
        }
        assert!(page.contains("data:image/png;base64,AQID"));
        assert!(page.contains("<svg "));
    }

    #[test]
    fn text_from_outside_is_escaped() {
        let page = html(&report());
        assert!(page.contains("planks &lt;b&gt;") && page.contains("slow &lt;turn&gt;"));
        assert!(!page.contains("<turn>"));
    }

    #[test]
    fn what_is_beyond_the_tolerance_is_marked() {
        let page = html(&report());
        assert!(page.contains("class=\"good\">0.50 mm"), "{page}");
        assert!(page.contains("class=\"bad\">10.00 mm"));
    }

    #[test]
    fn where_an_object_ended_is_there_or_why_it_is_not_known() {
        let page = html(&report());
        assert!(page.contains("<td>310.0, 200.0 mm, 28.6&deg;</td>"), "{page}");
        assert!(page.contains("<td>not seen since it was gripped</td><td>-</td>"), "{page}");
    }

    #[test]
    fn tags_are_closed() {
        let page = html(&report());
        for tag in ["table", "tr", "td", "figure", "div", "details", "dl", "main", "svg", "ol", "h2"] {
            let open = page.matches(&format!("<{tag}>")).count() + page.matches(&format!("<{tag} ")).count();
            assert_eq!(open, page.matches(&format!("</{tag}>")).count(), "{tag}");
        }
    }
}
