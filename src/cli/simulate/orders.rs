//! `celld simulate --orders`: every order in every state, on all cores.
//!
//! In: which cases, where the page goes. Out: cases whose answer is not what happens, or that the page has
//! differently. Exit codes as those of `celld simulate`.

use crate::cli::progress::Progress;
use crate::cli::simulate::args::SimulateArgs;
use crate::pair::camera_view::SightKind;
use crate::pair::orders::{Given, ORDERS_SEED, State, case, cases, judge};
use crate::pair::orders_page::{OrderCase, PAGE, expected, line, title, write};
use cell_edge::terminal::{complain, print};
use rayon::iter::{IntoParallelRefIterator, ParallelIterator};
use std::time::Instant;

/// Runs it; returns the exit code.
pub(super) fn run(args: &SimulateArgs) -> u8 {
    if args.refuses_to_write() {
        return 2;
    }
    let wanted = |title: &str| args.only.as_ref().is_none_or(|only| title.contains(only.as_str()));
    let chosen: Vec<(&'static State, &'static Given)> =
        cases().filter(|(state, given)| wanted(&title(state, given))).collect();
    let bar = Progress::new(chosen.len(), "cases");
    let began = Instant::now();
    let ran: Result<Vec<OrderCase>, String> = args.stage(ORDERS_SEED, SightKind::Corners).and_then(|stage| {
        let found = chosen.par_iter().map(|&(state, given)| {
            let found = case(&stage, state, given)?;
            bar.inc();
            Ok(OrderCase { state, given, found })
        });
        found.collect()
    });
    bar.finish();
    let found = match ran {
        Ok(found) => found,
        Err(message) => {
            complain(&message);
            return 2;
        }
    };
    if let Some(path) = &args.write
        && let Err(error) = std::fs::write(path, write(&found))
    {
        complain(&format!("{}: {error}", path.display()));
        return 2;
    }
    let (page, mut bad) = (expected(PAGE), 0);
    for OrderCase { state, given, found } in &found {
        let title = title(state, given);
        let mut faults = judge(given, found);
        let now = line(given, found);
        if args.is_usual() && page.get(&title) != Some(&now) {
            let page = page.get(&title).map_or("nothing", String::as_str);
            faults.push(format!("found    {now}\n    expected {page}"));
        }
        bad += usize::from(!faults.is_empty());
        if !faults.is_empty() || args.only.is_some() {
            print(&format!("{title}\n    {now}\n    {}\n", faults.join("\n    ")));
        }
    }
    let seconds = began.elapsed().as_secs_f64();
    print(&format!("{} cases, {bad} not as expected, {seconds:.0} s\n", found.len()));
    if !args.is_usual() {
        print("only the rules were checked: docs/orders.md is without --blend and --controller\n");
    }
    u8::from(bad > 0)
}
