//! What is published about the controller, and what the simulator says to it, as one page for users.
//!
//! In: rows that name a published figure, sentence or packet and measure the simulator's, each on a
//! simulated controller of its own. Out: Markdown, `docs/controller-facts.md`, which a test compares with
//! this; `celld sim --facts` measures and prints it. A row that does not agree says why, and a test fails
//! for one that agrees nevertheless.

mod devices;
mod motion;
mod rig;
mod script;
mod states;
mod wire;

pub mod row;

use row::{Fact, Section};
use std::fmt::Write;

/// All rows, measured.
pub fn sections() -> Vec<Section> {
    vec![
        motion::section(),
        states::section(),
        states::messages(),
        wire::rtde(),
        wire::others(),
        script::section(),
        devices::section(),
    ]
}

/// The page.
pub fn page() -> String {
    let sections = sections();
    let rows = || sections.iter().flat_map(|section| &section.rows);
    let deviating = rows().filter(|row| !row.agrees()).count();
    let mut page = format!(
        "# Published facts and the simulator's answers\n\n\
         Measured and printed by `celld sim --facts`; tests keep this page equal to the program and every row \
         to its\njudgement. Left what manuals, clients and their tests say of the controller, beside it what \
         the simulator does.\n{} facts; {deviating} of them deviate, and say why. What is simpler than the real \
         machine without\ncontradicting a published figure says [simulator-conformance.md](\
         simulator-conformance.md).\n",
        rows().count()
    );
    for Section { title, rows } in &sections {
        let _ =
            writeln!(page, "\n## {title}\n\n| what | published | simulator | source |\n|---|---|---|---|");
        rows.iter().for_each(|row| line(&mut page, row));
    }
    page
}

fn line(page: &mut String, row: &Fact) {
    let answer = row.answered();
    let remark = if row.but.is_empty() { String::new() } else { format!("; {}", row.but) };
    let _ = writeln!(page, "| {} | {} | {answer}{remark} | {} |", row.what, row.expected(), row.source);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_is_what_the_program_measures() {
        let kept = include_str!("../../../docs/controller-facts.md");
        assert!(kept == page(), "run: celld sim --facts > docs/controller-facts.md");
    }

    #[test]
    fn every_answer_agrees_with_what_is_published_or_says_why_not() {
        let sections = sections();
        let rows = sections.iter().flat_map(|section| &section.rows);
        let wrong: Vec<String> = rows
            .filter(|row| row.agrees() != row.but.is_empty())
            .map(|row| format!("{}: published {}, answered {}", row.what, row.expected(), row.answered()))
            .collect();
        assert!(wrong.is_empty(), "{wrong:#?}");
        assert!(sections.iter().map(|section| section.rows.len()).sum::<usize>() >= 100);
    }
}
