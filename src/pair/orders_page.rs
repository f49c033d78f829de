//! `docs/orders.md`: what each order does in each state of the cell, for people and for the test.
//!
//! In: what came of every case. Out: the page; and from the page what is expected of each case. Numbers and
//! objects are left out of the answers, because they are the seed's.

use crate::pair::orders::{Found, Given, ORDERS, STATES, State};
use crate::pair::page::plain;
use std::collections::BTreeMap;

/// The page, as it is in the repository.
pub const PAGE: &str = include_str!("../../docs/orders.md");

const HEAD: &str = "\
# What each order does in each state of the cell

Every command of the operator is given in every state below, in the closed loop of `celld simulate`; the
test `every_order_in_every_state_does_what_it_answers` holds the answer against what arm, power, vacuum
and jobs truly do in the 30 seconds after it. `#` is a number, `OBJECT` the name of one.

Written by `celld simulate --orders --write docs/orders.md`; `celld simulate --orders` compares the cell
with it.
";

/// What became of a case.
pub struct OrderCase {
    /// The state.
    pub state: &'static State,
    /// The order.
    pub given: &'static Given,
    /// What came of it.
    pub found: Found,
}

/// Name of a case.
pub fn title(state: &State, given: &Given) -> String {
    format!("{} / {}", state.name, given.command)
}

/// The last two columns of a case: the answer, and what happens.
pub fn line(given: &Given, found: &Found) -> String {
    let Some(reply) = &found.reply else { return "no answer | |".to_string() };
    let mut answer = plain(&reply.message);
    if given.command == "recover" && reply.accepted {
        answer = "the last stop, the object held, the recovery options".to_string();
    }
    let yes = if reply.accepted { "yes" } else { "no" };
    let mut happens = vec![if found.armed.1 { "armed" } else { "disarmed" }.to_string()];
    let motion = match (found.moves, found.rests) {
        (false, _) => "the arm stays where it is",
        (true, true) => "the arm moves, then rests",
        (true, false) => "the arm moves on",
    };
    happens.push(motion.to_string());
    if found.powers {
        happens.push("power or brakes change".to_string());
    }
    happens.extend(match found.held {
        (true, true) => Some("the object stays held".to_string()),
        (true, false) => Some("nothing is held in the end".to_string()),
        (false, _) => None,
    });
    happens.extend(found.ended.as_ref().map(|code| format!("job `{code}`")));
    format!("{yes} | {answer} | {} |", happens.join(", "))
}

/// The page for these cases, orders with the same line together.
pub fn write(cases: &[OrderCase]) -> String {
    let mut page = HEAD.to_string();
    for state in STATES {
        page.push_str(&format!(
            "\n## {}\n\n| order | done | answer | then |\n|---|---|---|---|\n",
            state.name
        ));
        let mut lines: Vec<(String, Vec<&str>)> = Vec::new();
        for given in ORDERS {
            let same = |case: &&OrderCase| std::ptr::eq(case.state, state) && std::ptr::eq(case.given, given);
            let Some(case) = cases.iter().find(same) else { continue };
            let line = line(given, &case.found);
            match lines.iter_mut().find(|(known, _)| *known == line) {
                Some((_, commands)) => commands.push(given.command),
                None => lines.push((line, vec![given.command])),
            }
        }
        for (line, commands) in lines {
            page.push_str(&format!("| {} | {line}\n", commands.join(", ")));
        }
    }
    page
}

/// What the page expects of each case, by its title.
pub fn expected(page: &str) -> BTreeMap<String, String> {
    let (mut cases, mut state) = (BTreeMap::new(), "");
    for text in page.lines() {
        if let Some(name) = text.strip_prefix("## ") {
            state = name;
        }
        let Some((commands, line)) = text.strip_prefix("| ").and_then(|rest| rest.split_once(" | ")) else {
            continue;
        };
        // The heads of the tables.
        if commands == "order" || commands.starts_with('-') {
            continue;
        }
        for command in commands.split(", ") {
            cases.insert(format!("{state} / {command}"), line.to_string());
        }
    }
    cases
}
