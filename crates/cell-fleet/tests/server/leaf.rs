//! A cell behind a leaf node: a server of its own without JetStream, whose connection to the fleet's server
//! comes and goes while that of the cell stays.
//!
//! In: two real servers. Out: the cell works the queue off as before after an absence, and sees what a
//! person wants, although its own connection was never gone.

use crate::bench::{Cell, Server, client, program, until};
use crate::{any, ended, job, runtime};
use cell_fleet::connect::Access;
use cell_fleet::payloads::{ClaimState, Job};
use std::net::TcpListener;

#[test]
fn a_cell_behind_a_leaf_node_goes_on_after_its_way_to_the_server_was_gone() {
    let Some(program) = program() else { return };
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let hub_config = format!(
        "jetstream {{domain: hub, store_dir: \"STORE\", max_file_store: 10GB, sync_interval: always}}\n\
         leafnodes {{listen: \"127.0.0.1:{port}\"}}"
    );
    let leaf_config = format!("leafnodes {{remotes: [{{url: \"nats-leaf://127.0.0.1:{port}\"}}]}}");
    let (mut hub, leaf) = (Server::start(&program, &hub_config), Server::start(&program, &leaf_config));
    let runtime = runtime();
    let mut cell = Cell::new("c1", Access { domain: Some("hub".into()), ..leaf.access(None) }, 20);
    cell.up();
    let client = runtime.block_on(client(&hub, "anna"));
    let submit = |id: &str| assert_eq!(runtime.block_on(client.submit(&job(id), &any())), Ok(true));
    submit("before");
    ended(&runtime, &client, 1, std::slice::from_ref(&cell));
    hub.kill();
    cell.disk.lock().unwrap().announced.push("fault".to_string());
    until("the cell cannot deliver", || cell.complains_of("events"));
    hub.up();
    until("the server answers", || runtime.block_on(client.cells()).is_ok_and(|cells| !cells.is_empty()));
    submit("after");
    ended(&runtime, &client, 2, std::slice::from_ref(&cell));
    // The watch of wishes has come back too, and that of all claims.
    let late = Job { not_before_unix_s: Some(4e9), ..job("late") };
    assert_eq!(runtime.block_on(client.submit(&late, &any())), Ok(true));
    runtime.block_on(client.cancel("late")).unwrap();
    until("what was cancelled is closed", || {
        let claims = runtime.block_on(client.claims()).unwrap_or_default();
        claims.iter().any(|claim| claim.job.id == "late" && claim.state == ClaimState::Cancelled)
    });
    until("nothing is wrong any more", || cell.disk.lock().unwrap().complaints.is_empty());
}
