//! `docs/reactions.md`: what the cell does about each fault, for people and for the sweep.
//!
//! In: the [`Outcome`]s of a sweep. Out: the page; and, from the page, what is expected of each case. The
//! page is both the documentation and the expectation: a change of behaviour is a change of a line of it, to
//! be read before it is committed. Numbers and objects are left out of sentences, because they are the
//! seed's.

use crate::pair::outcome::{Outcome, Phase};
use crate::pair::reactions::{ROWS, Row};
use std::collections::BTreeMap;

/// The page, as it is in the repository.
pub const PAGE: &str = include_str!("../../docs/reactions.md");

/// The seed that the page is written with.
pub const PAGE_SEED: u64 = 0;

const HEAD: &str = "\
# What the cell does about faults

Every fault below is brought about in every phase of a pick-n-place in which it can occur, in the closed
loop of `celld simulate`. The columns: how the job ended (its `code`, see [results](results.md)), whether
the cell is armed afterwards, whether what was held is still held, what the operator reads last and what
to do about it, and how another job ends once the fault is over, a person has cleared what there is to
clear at the pendant and armed the cell. `#` is a number, `OBJECT` the name of one. Numbers of rows are
those of the fault table that the project started from, 0 is what a person does; 37, 39 and 42 to 46 (the
process, clocks, files, the network) have tests of their own.

Written by `celld simulate --faults sweep --write docs/reactions.md`; `celld simulate --faults sweep`
compares the cell with it and checks the [rules](../ARCHITECTURE.md) after every step. `make test` does so with
every fault in every third phase.

| # | fault | phases | job | armed | held | operator reads | what to do | next job |
|---|---|---|---|---|---|---|---|---|
";

/// What became of a case of the sweep.
pub struct CaseOutcome<'a> {
    /// The fault.
    pub row: &'a Row,
    /// The phase in which it was brought about.
    pub phase: Phase,
    /// What became of it.
    pub outcome: Outcome,
}

/// Name of a case: number, fault, phase.
pub fn title(row: &Row, phase: Phase) -> String {
    format!("{} {} / {}", row.number, row.name, phase.name())
}

/// The last six columns of a case.
pub fn reaction(outcome: &Outcome) -> String {
    let ended = if outcome.daemon_ended { ", celld ends" } else { "" };
    let none = if outcome.has_job { "waits" } else { "" };
    let job = outcome.code.map_or(none.to_string(), |code| format!("`{code}`"));
    let armed = if outcome.armed { "yes" } else { "no" };
    let held = outcome.kept.map_or("", |kept| if kept { "yes" } else { "no" });
    let next = outcome.next.map_or("none".to_string(), |code| format!("`{code}`"));
    let (sentence, hint) = (plain(&outcome.sentence), plain(&outcome.hint));
    format!("{job}{ended} | {armed} | {held} | {sentence} | {hint} | {next} |")
}

/// A sentence without numbers, names of objects and what a table cannot have.
pub(super) fn plain(sentence: &str) -> String {
    // Foreign bytes in quotes.
    let sentence = match sentence.split_once('"') {
        Some((before, quoted)) if quoted.contains('\u{fffd}') => format!("{before}..."),
        _ => sentence.to_string(),
    };
    let words: Vec<String> = sentence.split(' ').map(plain_word).collect();
    words.join(" ").replace('|', "/")
}

fn plain_word(word: &str) -> String {
    if ["plank-", "block-", "lid-"].iter().any(|kind| word.starts_with(kind)) {
        let name = |c: char| c.is_ascii_alphanumeric() || c == '-';
        return format!("OBJECT{}", word.trim_start_matches(name));
    }
    let mut plain = String::new();
    for character in word.chars() {
        match character {
            '0'..='9' if plain.ends_with('#') => {}
            '0'..='9' => plain.push('#'),
            '.' if plain.ends_with('#') => {}
            other => plain.push(other),
        }
    }
    plain
}

/// The page for these outcomes, phases with the same reaction in one line.
pub fn write(outcomes: &[CaseOutcome]) -> String {
    let mut page = HEAD.to_string();
    for row in ROWS {
        let mut lines: Vec<(String, Vec<&str>)> = Vec::new();
        for CaseOutcome { phase, outcome, .. } in outcomes.iter().filter(|case| std::ptr::eq(case.row, row)) {
            let reaction = reaction(outcome);
            match lines.iter_mut().find(|(known, _)| *known == reaction) {
                Some((_, phases)) => phases.push(phase.name()),
                None => lines.push((reaction, vec![phase.name()])),
            }
        }
        for (reaction, phases) in lines {
            page.push_str(&format!("| {} | {} | {} | {reaction}\n", row.number, row.name, phases.join(", ")));
        }
    }
    page
}

/// What the page expects of each case, by its title.
pub fn expected(page: &str) -> BTreeMap<String, String> {
    let mut cases = BTreeMap::new();
    for line in page.lines() {
        let Some(line) = line.strip_prefix("| ") else { continue };
        let mut parts = line.splitn(4, " | ");
        let (Some(number), Some(name), Some(phases), Some(reaction)) =
            (parts.next(), parts.next(), parts.next(), parts.next())
        else {
            continue;
        };
        if number.parse::<u8>().is_err() {
            continue;
        }
        for phase in phases.split(", ") {
            cases.insert(format!("{number} {name} / {phase}"), reaction.to_string());
        }
    }
    cases
}
