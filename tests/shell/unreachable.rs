//! A state folder or a journal that vanishes or is spoilt while the arm carries something.

use super::Cell;
use crate::cell::{result_of, wait_until};
use std::os::unix::fs::symlink;
use std::path::Path;

/// The arm stops, the object stays held, the cell is disarmed, and celld reports it and stays.
fn stops_without_its_folder(cell: &mut Cell, take_away: impl FnOnce(&Cell)) {
    let token = cell.token();
    cell.carry();
    assert_eq!(cell.shown(&token)["armed"], true);
    take_away(cell);
    wait_until("it says so", || cell.log().contains("orders do not reach celld"));
    wait_until("the arm rests", || cell.rests());
    wait_until("the page shows it disarmed", || cell.shown(&token)["armed"] == false);
    assert!(cell.holds(), "the object stays held: {}", cell.log());
    assert!(cell.daemon().try_wait().expect("a child").is_none(), "it stays: {}", cell.log());
}

/// The folder that was open all the time has its name again.
fn takes_orders_again(cell: &Cell) {
    wait_until("orders reach it", || cell.log().contains("orders reach celld again"));
    wait_until("it takes orders", || cell.celld(&["recover"]).0 == Some(0));
    wait_until("the status is of now again", || !cell.armed());
}

#[test]
fn cell_stops_when_its_state_folder_is_renamed_and_takes_orders_when_it_is_back() {
    let mut cell = Cell::start("127.7.9.7", &[]);
    let aside = cell.path().join("aside");
    stops_without_its_folder(&mut cell, |cell| std::fs::rename(cell.state(), &aside).expect("renamed"));
    // The daemon has made folders of that name again; they are not the ones that orders come to.
    let _ = std::fs::remove_dir_all(cell.state());
    std::fs::rename(&aside, cell.state()).expect("put back");
    takes_orders_again(&cell);
}

/// The link that is the state folder leads to `target` at once.
fn lead_to(cell: &Cell, target: &str) {
    let link = cell.path().join("link");
    symlink(target, &link).expect("a link");
    std::fs::rename(&link, cell.state()).expect("in its place");
}

#[test]
fn cell_stops_when_its_state_folder_is_a_link_that_is_led_elsewhere() {
    let mut cell = Cell::without_daemon("127.7.9.18");
    for folder in ["first", "second"] {
        std::fs::create_dir(cell.path().join(folder)).expect("created");
    }
    lead_to(&cell, "first");
    cell.start_daemon(&[]);
    stops_without_its_folder(&mut cell, |cell| lead_to(cell, "second"));
    lead_to(&cell, "first");
    takes_orders_again(&cell);
}

#[test]
fn cell_stops_when_its_state_folder_is_removed_with_everything_in_it() {
    let mut cell = Cell::start("127.7.9.19", &[]);
    stops_without_its_folder(&mut cell, |cell| {
        // It is not empty where the daemon writes into it meanwhile.
        let remove = || std::fs::remove_dir_all(cell.state()).is_ok();
        wait_until("it is removed", || remove() || !cell.state().exists());
    });
    cell.end();
    assert!(cell.holds(), "the end leaves the vacuum as it is");
}

/// No further pick-n-place, no "done"; the cell is locked, and celld names the way on and stays.
fn stops_without_its_journal(cell: &mut Cell, spoil: impl FnOnce(&Path), fault: &str) {
    cell.carry();
    spoil(&cell.state().join("history.sqlite"));
    wait_until("it says so", || cell.log().contains(fault));
    wait_until("the arm rests", || cell.rests());
    assert!(cell.holds() && result_of(&cell.state(), "done", "carry").is_none(), "{}", cell.log());
    wait_until("the status says so", || !cell.armed());
    assert!(cell.daemon().try_wait().expect("a child").is_none(), "it stays: {}", cell.log());
    let (code, said) = cell.celld(&["arm"]);
    assert!(code == Some(1) && said.contains("celld journal repair"), "{code:?}: {said}");
}

#[test]
fn cell_stops_when_its_journal_is_removed() {
    let mut cell = Cell::start("127.7.9.8", &[]);
    let remove = |journal: &Path| std::fs::remove_file(journal).expect("removed");
    stops_without_its_journal(&mut cell, remove, "was removed or replaced while celld ran");
}

/// Half of the journal is cut off. The way on that celld names leads on.
#[test]
fn cell_stops_when_its_journal_is_cut_and_starts_after_the_repair() {
    let mut cell = Cell::start("127.7.9.24", &[]);
    let cut = |journal: &Path| {
        let file = std::fs::OpenOptions::new().write(true).open(journal).expect("the journal");
        let length = file.metadata().expect("its length").len();
        file.set_len(length / 2).expect("cut");
    };
    stops_without_its_journal(&mut cell, cut, "was cut from");
    cell.end();
    let (code, said) = cell.celld(&["journal", "repair"]);
    assert_eq!(code, Some(0), "{said}");
    cell.start_daemon(&[]);
}
