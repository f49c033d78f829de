//! A state folder that vanishes while the arm carries something.

use super::Cell;
use crate::cell::wait_until;

/// The folder is renamed: the arm stops, the cell disarms and stays; put back, it takes orders again.
#[test]
fn cell_stops_when_its_state_folder_is_gone_and_takes_orders_when_it_is_back() {
    let mut cell = Cell::start("127.7.9.7", &[]);
    cell.carry();
    let aside = cell.path().join("aside");
    std::fs::rename(cell.state(), &aside).expect("renamed");
    wait_until("it says so", || cell.log().contains("orders do not reach celld"));
    wait_until("the arm rests", || cell.rests());
    assert!(cell.holds(), "the object stays held: {}", cell.log());
    assert!(cell.daemon().try_wait().expect("a child").is_none(), "it stays: {}", cell.log());
    // The daemon has made folders of that name again; they are not the ones that orders come to.
    let _ = std::fs::remove_dir_all(cell.state());
    std::fs::rename(&aside, cell.state()).expect("put back");
    wait_until("orders reach it", || cell.log().contains("orders reach celld again"));
    wait_until("it takes orders", || cell.celld(&["recover"]).0 == Some(0));
    wait_until("the status is of now again", || !cell.armed());
}

/// The journal's file is removed: no further pick-n-place, no "done", and the daemon stays.
#[test]
fn cell_stops_when_its_journal_is_removed() {
    let mut cell = Cell::start("127.7.9.8", &[]);
    cell.carry();
    std::fs::remove_file(cell.state().join("history.sqlite")).expect("removed");
    wait_until("it says so", || cell.log().contains("was removed or replaced while celld ran"));
    wait_until("the arm rests", || cell.rests());
    assert!(cell.holds() && !cell.state().join("jobs/done").join("carry").exists(), "{}", cell.log());
    wait_until("the status says so", || !cell.armed());
    assert!(cell.daemon().try_wait().expect("a child").is_none(), "it stays: {}", cell.log());
    let (code, said) = cell.celld(&["arm"]);
    assert!(code == Some(1) && said.contains("celld journal repair"), "{code:?}: {said}");
}
