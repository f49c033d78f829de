//! What came of a fleet's work: one page that needs nothing else.
//!
//! In: a [`FleetView`] at the end, how long it took. Out: HTML with sums, a bar for each job in its cell's
//! row, the cells, the jobs. Everything that came from a file or a cell is escaped. Pure.

use crate::fleet::view::{CellView, FleetView, JobView};
use crate::report::colour;
use crate::report::text::{escape, seconds};
use std::fmt::Write as _;

const STYLE: &str = include_str!("../../report/page.css");

const LEFT: f64 = 90.0;
const WIDTH: f64 = 820.0;
const ROW: f64 = 34.0;

/// The page.
pub fn html(view: &FleetView, wall_s: f64) -> String {
    let over: Vec<&JobView> = view.jobs.iter().filter(|job| job.outcome.is_some()).collect();
    let done = over.iter().filter(|job| is_done(job)).count();
    let (class, word) = match done == view.jobs.len() {
        true => ("good", "all jobs done"),
        false => ("bad", "not all jobs done"),
    };
    let mut page = format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\
         <title>Fleet {name} - celld</title><style>{STYLE}</style></head>\n<body><main>\n\
         <header><span class=\"verdict {class}\">{word}</span><h1>Fleet {name}</h1>\
         <p>{done} of {} jobs in {} cells, in {}</p></header>\n",
        view.jobs.len(),
        view.cells.len(),
        seconds(wall_s),
        name = escape(&view.fleet),
    );
    sums(&mut page, view, &over, wall_s);
    let _ = writeln!(
        page,
        "<h2>Who did what, and when</h2><figure>{}<figcaption>Each bar is a job, from its beginning in the cell to \
         its end.</figcaption></figure>",
        timeline(view)
    );
    cells(&mut page, &view.cells);
    jobs(&mut page, &view.jobs);
    page.push_str("</main></body></html>\n");
    page
}

fn is_done(job: &JobView) -> bool {
    job.outcome.as_ref().is_some_and(|outcome| outcome.status == "done")
}

fn sums(page: &mut String, view: &FleetView, over: &[&JobView], wall_s: f64) {
    let outcomes = || over.iter().filter_map(|job| job.outcome.as_ref());
    let moves: u32 = outcomes().map(|outcome| outcome.moves).sum();
    let bound: f64 = outcomes().filter_map(|outcome| outcome.lower_bound).sum();
    let working: f64 = outcomes().map(|outcome| outcome.seconds).sum();
    let each = if moves > 0 { seconds(working / f64::from(moves)) } else { "-".to_string() };
    let busy = 100.0 * working / (wall_s.max(1.0) * view.cells.len().max(1) as f64);
    let figures = [
        ("pick-n-places", moves.to_string()),
        ("no plan has fewer than", format!("{bound:.0}")),
        ("an hour", format!("{:.0}", f64::from(moves) * 3600.0 / wall_s.max(1.0))),
        ("time of one", each),
        ("cells at work", format!("{busy:.0} %")),
    ];
    page.push_str("<dl class=\"figures\">");
    for (label, value) in figures {
        let _ = write!(page, "<div><dt>{label}</dt><dd>{}</dd></div>", escape(&value));
    }
    page.push_str("</dl>\n");
}

/// A row a cell, a bar a job.
fn timeline(view: &FleetView) -> String {
    let span = |job: &JobView| {
        let end = job.ended_unix_s?;
        Some((end - job.outcome.as_ref()?.seconds, end))
    };
    let spans: Vec<(usize, &JobView, (f64, f64))> =
        view.jobs.iter().enumerate().filter_map(|(index, job)| Some((index, job, span(job)?))).collect();
    let begin = spans.iter().map(|(.., (begin, _))| *begin).fold(f64::INFINITY, f64::min);
    let end = spans.iter().map(|(.., (_, end))| *end).fold(f64::NEG_INFINITY, f64::max);
    let scale = WIDTH / (end - begin).max(1.0);
    let height = ROW * view.cells.len() as f64 + 30.0;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {:.0} {height:.0}\" font-family=\"sans-serif\" \
         font-size=\"12\" role=\"img\" aria-label=\"Jobs by cell and time\"><rect width=\"100%\" height=\"100%\" \
         fill=\"#fff\"/>",
        LEFT + WIDTH + 20.0
    );
    for (row, cell) in view.cells.iter().enumerate() {
        let y = 8.0 + ROW * row as f64;
        let _ = write!(
            svg,
            "<text x=\"{:.0}\" y=\"{:.0}\" text-anchor=\"end\" fill=\"#222\">{}</text>",
            LEFT - 8.0,
            y + 17.0,
            escape(&cell.name)
        );
        for (index, job, (begun, ended)) in spans.iter().filter(|(_, job, _)| job.cell == cell.name) {
            let (x, width) = (LEFT + (begun - begin) * scale, ((ended - begun) * scale).max(1.0));
            let dash = if is_done(job) { "" } else { " stroke-dasharray=\"4 3\"" };
            let _ = write!(
                svg,
                "<rect x=\"{x:.1}\" y=\"{y:.0}\" width=\"{width:.1}\" height=\"24\" rx=\"3\" fill=\"{}\" \
                 stroke=\"#222\"{dash}><title>{}: {}</title></rect>",
                colour::of(*index),
                escape(&job.id),
                seconds(ended - begun)
            );
        }
    }
    let _ = write!(
        svg,
        "<text x=\"{LEFT:.0}\" y=\"{0:.0}\" fill=\"#222\">0 s</text><text x=\"{1:.0}\" y=\"{0:.0}\" \
         text-anchor=\"end\" fill=\"#222\">{2}</text></svg>",
        height - 8.0,
        LEFT + WIDTH,
        seconds((end - begin).max(0.0))
    );
    svg
}

fn cells(page: &mut String, cells: &[CellView]) {
    page.push_str(
        "<h2>Cells</h2><div class=\"scroll\"><table><thead><tr><th>cell</th><th class=\"text\">labels</th><th>done</th>\
         <th>failed</th><th>moves</th><th>bound</th><th>s a move</th><th>moves an hour</th></tr></thead><tbody>",
    );
    for CellView { name, state, counts, .. } in cells {
        let each = if counts.moves > 0 {
            format!("{:.1}", counts.seconds / counts.moves as f64)
        } else {
            "-".into()
        };
        let _ = write!(
            page,
            "<tr><td>{}</td><td class=\"text\">{}</td><td>{}</td><td>{}</td><td>{}</td><td>{:.0}</td><td>{each}</td>\
             <td>{:.0}</td></tr>",
            escape(name),
            escape(&state.labels.join(", ")),
            counts.done,
            counts.failed,
            counts.moves,
            counts.bound,
            counts.moves_per_hour
        );
    }
    page.push_str("</tbody></table></div>\n");
}

fn jobs(page: &mut String, jobs: &[JobView]) {
    page.push_str(
        "<h2>Jobs</h2><div class=\"scroll\"><table><thead><tr><th>job</th><th class=\"text\">for</th>\
         <th class=\"text\">cell</th><th class=\"text\">state</th><th>moves</th><th>time</th><th class=\"text\">what</th>\
         </tr></thead><tbody>",
    );
    for job in jobs.iter().rev() {
        let outcome = job.outcome.clone().unwrap_or_default();
        let state = if outcome.status.is_empty() { &job.state } else { &outcome.status };
        let class = if is_done(job) { "good" } else { "bad" };
        let reasons: Vec<String> =
            job.reasons.iter().map(|(cell, reason)| format!("{cell}: {reason}")).collect();
        let what = if outcome.message.is_empty() { reasons.join("; ") } else { outcome.message.clone() };
        let _ = write!(
            page,
            "<tr><td>{}</td><td class=\"text\">{}</td><td class=\"text\">{}</td><td class=\"text {class}\">{}</td>\
             <td>{}</td><td>{}</td><td class=\"text\">{}</td></tr>",
            escape(&job.id),
            escape(&job.target),
            escape(&job.cell),
            escape(state),
            outcome.moves,
            seconds(outcome.seconds),
            escape(&what)
        );
    }
    page.push_str("</tbody></table></div>\n");
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fleet::view::Board;
    use cell_fleet::changes::Change;
    use cell_fleet::client::Shown;
    use cell_fleet::payloads::{CellState, Claim, ClaimState, Job, Outcome};
    use cell_fleet::subjects::{Lane, Priority, Target};

    fn board(status: &str) -> Board {
        let mut board = Board::default();
        let state = CellState { state: "idle".into(), labels: vec!["<b>".into()], ..CellState::default() };
        board.take(Change::Cell(Box::new(Shown { name: "cell-1".into(), state, unix_s: 100.0 })));
        let lane = Lane { priority: Priority::Normal, target: Target::any() };
        let mut claim =
            Claim::new(Job::new("a", "x", 10.0), &lane, "demo", ClaimState::Ended, "cell-1", 90.0);
        let message = "<script>".to_string();
        let status = status.to_string();
        claim.outcome = Some(Outcome { status, message, moves: 4, seconds: 40.0, ..Outcome::default() });
        board.take(Change::Claim(Box::new(claim)));
        board
    }

    #[test]
    fn the_report_says_what_was_done_and_escapes_it() {
        let page = html(&board("done").view("demo", 100.0, true), 60.0);
        assert!(page.contains("all jobs done") && page.contains("1 of 1 jobs in 1 cells"), "{page}");
        assert!(page.contains("<dt>an hour</dt><dd>240</dd>") && page.contains("&lt;script&gt;"), "{page}");
        assert!(!page.contains("<script>") && !page.contains("<b>"), "{page}");
        assert!(page.contains("<title>a: 40"), "a bar for the job: {page}");
        let page = html(&board("failed").view("demo", 100.0, true), 60.0);
        assert!(page.contains("not all jobs done") && page.contains("0 of 1 jobs"), "{page}");
    }
}
