//! Mutants of the cell: whatever goes wrong between machine and world, one rule of the closed loop finds it,
//! and no other.
//!
//! Each mutant is planted by an adapter, here and nowhere else; the same drill without one breaks no rule.
//! What a mutant represents is the fault in celld's own code that would have the same effect at the border.

mod arming;
mod drill;
mod gripper;
mod motion;
mod orders;
mod plant;
mod rtde;
mod shell;
mod sight;

use crate::mutants::drill::{Case, SEED, run, submit};
use crate::mutants::plant::Plant;
use cell_machine::event::Event;
use cell_machine::orders::Order;
use celld::pair::camera_view::SightKind;
use celld::pair::rules::Rule;
use celld::pair::run::bring_up;
use celld::pair::table::stage;
use celld::pair::{Choice, Pair};
use rayon::iter::{IntoParallelRefIterator, ParallelIterator};
use std::collections::BTreeSet;

fn cases() -> Vec<&'static Case> {
    [motion::CASES, gripper::CASES, sight::CASES, arming::CASES, orders::CASES, shell::CASES]
        .into_iter()
        .flatten()
        .collect()
}

/// CELLD_MUTANT: only those with one of these words in their name, split by commas.
fn chosen() -> Vec<&'static Case> {
    let wanted = std::env::var("CELLD_MUTANT").unwrap_or_default();
    cases().into_iter().filter(|case| wanted.split(',').any(|words| case.name.contains(words))).collect()
}

#[test]
fn every_rule_has_a_mutant() {
    let found: BTreeSet<Rule> = cases().iter().map(|case| case.rule).collect();
    let missing: Vec<Rule> = Rule::ALL.into_iter().filter(|rule| !found.contains(rule)).collect();
    assert_eq!(missing, []);
}

/// `docs/rules.md` says what is watched.
#[test]
fn the_page_of_rules_names_every_rule() {
    let page = include_str!("../../docs/rules.md");
    let missing: Vec<Rule> =
        Rule::ALL.into_iter().filter(|rule| !page.contains(&format!("`{rule:?}`"))).collect();
    assert_eq!(missing, []);
}

#[test]
fn each_mutant_is_found_by_its_rule_and_by_no_other() {
    let wrong: Vec<String> = chosen()
        .par_iter()
        .filter_map(|case| {
            let found = run(case.cell, Some(case.plant), case.drill);
            let alone = !found.is_empty() && found.iter().all(|(rule, _)| *rule == case.rule);
            (!alone).then(|| format!("{}: {:?} is to find it, found {found:?}", case.name, case.rule))
        })
        .collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn the_sound_cell_breaks_no_rule_in_any_drill() {
    let wrong: Vec<String> = chosen()
        .par_iter()
        .filter_map(|case| {
            let found = run(case.cell, None, case.drill);
            (!found.is_empty()).then(|| format!("{}: {found:?}", case.name))
        })
        .collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Before anything is gripped.
#[test]
fn an_old_sight_is_found_as_the_tool_goes_down() {
    let case = cases().into_iter().find(|case| case.rule == Rule::PickOnOldSight).expect("the drill runs");
    let found = run(case.cell, Some(case.plant), case.drill);
    assert!(found.first().is_some_and(|(_, detail)| detail.ends_with("on the way down")), "{found:?}");
}

/// A job that never reaches the machine: no rule sees it, but it has no end.
#[test]
fn a_forgotten_job_has_no_end() {
    let ends = |plant: Option<Plant>| {
        let stage = stage(SEED, SightKind::Corners).expect("the drill runs");
        let mut pair = Pair::new(stage.clone(), Choice::of(SEED)).expect("the drill runs");
        plant.into_iter().for_each(|plant| pair.adapt(Box::new(plant)));
        assert!(bring_up(&mut pair));
        pair.order(Order::Arm);
        submit(&mut pair, &stage, 0);
        pair.run_until(120.0, |pair| !pair.reports().is_empty())
    };
    let forgets = Plant::none().event(|event, events| {
        if !matches!(event, Event::Job(_)) {
            events.push(event);
        }
    });
    assert!(ends(None) && !ends(Some(forgets)));
}
