//! The server's settings of docs/fleet.md, as they are there: TLS, a user for each cell and each person.
//!
//! In: the page, the program that `CELLD_NATS_SERVER` names. Out: with these settings a cell works and a
//! person does all that `celld fleet` does, and neither does anything in the name of another.

use super::bench::{Cell, STORAGE, Server, program, until};
use cell_fleet::client::Client;
use cell_fleet::connect::{Access, Credentials};
use cell_fleet::files::FileKind;
use cell_fleet::payloads::{ClaimState, Job};
use cell_fleet::subjects::{Fleet, Lane, Priority, RequestKind, Target};
use std::path::{Path, PathBuf};
use tokio::runtime::Runtime;

const PAGE: &str = include_str!("../../../../docs/fleet.md");

/// The settings on the page, for this computer: other keys, another place for files, any port.
fn settings(folder: &Path, keys: &[(&str, &nkeys::KeyPair)]) -> String {
    let begins = PAGE.find("listen: \"0.0.0.0:4222\"\n").expect("the settings are on the page");
    let mut text = PAGE[begins..].split("```").next().unwrap().to_string();
    let mut put = |from: &str, to: &str| {
        assert!(text.contains(from), "the settings have no {from}");
        text = text.replace(from, to);
    };
    put("listen: \"0.0.0.0:4222\"\n", "");
    put("/etc/nats/", &format!("{}/", folder.display()));
    put("/var/lib/nats", "STORE");
    put("20GB", "8GB");
    // As the page has it for who may publish shared configuration.
    let also = "$KV.celld-plant-config.*.*.anna";
    assert!(PAGE.contains(&format!("`{also}`")));
    put("give.*.anna\"", &format!("give.*.anna\", \"{also}\""));
    keys.iter().for_each(|(name, pair)| put(name, &pair.public_key()));
    text
}

struct Site {
    server: Server,
    folder: tempfile::TempDir,
    runtime: Runtime,
}

impl Site {
    fn open(program: &Path, keys: &[(&str, &nkeys::KeyPair)]) -> Site {
        let folder = tempfile::tempdir().unwrap();
        let made = rcgen::generate_simple_self_signed(["localhost".to_string()]).unwrap();
        std::fs::write(folder.path().join("server.pem"), made.cert.pem()).unwrap();
        std::fs::write(folder.path().join("server.key"), made.signing_key.serialize_pem()).unwrap();
        let server = Server::start(program, &settings(folder.path(), keys));
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build();
        Site { server, folder, runtime: runtime.unwrap() }
    }

    fn access(&self, pair: &nkeys::KeyPair) -> Access {
        let seed: PathBuf = self.folder.path().join(pair.public_key());
        std::fs::write(&seed, pair.seed().unwrap()).unwrap();
        Access {
            servers: vec![format!("tls://localhost:{}", self.server.port)],
            credentials: Some(Credentials::Nkey(seed)),
            authority: Some(self.folder.path().join("server.pem")),
            tls: true,
            domain: None,
            name: "test".to_string(),
        }
    }

    fn person(&self, pair: &nkeys::KeyPair, user: &str) -> Client {
        let fleet = Fleet::new("plant").unwrap();
        self.runtime.block_on(Client::open(&self.access(pair), fleet, user, STORAGE)).unwrap()
    }

    fn submit(&self, who: &Client, id: &str) -> Result<bool, String> {
        let lane = Lane { priority: Priority::Normal, target: Target::any() };
        let job = Job::new(id, &format!("version: 1\nid: {id}\n"), 1.0);
        self.runtime.block_on(who.submit(&job, &lane))
    }

    fn until_a_job_is(&self, who: &Client, state: ClaimState) {
        until(state.as_str(), || {
            let claims = self.runtime.block_on(who.claims()).unwrap_or_default();
            claims.iter().any(|claim| claim.state == state)
        });
    }
}

#[test]
fn the_settings_on_the_page_let_each_do_their_own_and_nothing_else() {
    let Some(program) = program() else { return };
    let (cell_key, anna_key) = (nkeys::KeyPair::new_user(), nkeys::KeyPair::new_user());
    let site = Site::open(&program, &[("UA...CELL1", &cell_key), ("UA...ANNA", &anna_key)]);
    let mut cell = Cell::new("cell-1", site.access(&cell_key), 0);
    cell.fleet = Fleet::new("plant").unwrap();
    cell.disk.lock().unwrap().file = vec![7; 300_000];
    cell.up();
    let anna = site.person(&anna_key, "anna");
    let run = &site.runtime;

    // All that a person does.
    assert_eq!(site.submit(&anna, "tidy"), Ok(true));
    site.until_a_job_is(&anna, ClaimState::Ended);
    until("its events are there", || {
        run.block_on(anna.why("tidy")).is_ok_and(|story| !story.events.is_empty())
    });
    let answer = run.block_on(anna.request("cell-1", RequestKind::Reject, "tidy", None)).unwrap();
    assert!(answer.accepted, "{answer:?}");
    let files = run.block_on(anna.request_for_files("cell-1", "tidy", &[FileKind::Plan])).unwrap();
    assert!(files.accepted, "{files:?}");
    let folder = tempfile::tempdir().unwrap();
    let path = run.block_on(anna.fetch("cell-1", "tidy", &files.files[0], folder.path())).unwrap();
    assert_eq!(std::fs::metadata(path).unwrap().len(), 300_000);
    run.block_on(anna.publish_fragment(&Target::any(), "shared", 1.0)).unwrap();
    until("the cell knows what is shared", || {
        cell.disk.lock().unwrap().wanted == Some(Some("shared".to_string()))
    });
    cell.disk.lock().unwrap().disarmed = true;
    until("the cell shows that it is disarmed", || {
        run.block_on(anna.cells()).unwrap_or_default().iter().any(|cell| !cell.state.armed)
    });
    assert_eq!(site.submit(&anna, "later"), Ok(true));
    run.block_on(anna.cancel("later")).unwrap();
    site.until_a_job_is(&anna, ClaimState::Cancelled);
    let complaints = cell.disk.lock().unwrap().complaints.clone();
    assert!(complaints.is_empty(), "the cell lacks a permission: {complaints:?}");

    // Nothing in the name of another.
    let ben = site.person(&anna_key, "ben");
    for (what, refused) in [
        ("submit", site.submit(&ben, "of-ben").map(drop)),
        ("approve", run.block_on(ben.request("cell-1", RequestKind::Approve, "tidy", Some(1))).map(drop)),
        ("publish", run.block_on(ben.publish_fragment(&Target::any(), "of ben", 1.0)).map(drop)),
        ("forget", run.block_on(ben.forget("cell-1"))),
    ] {
        let fault = refused.expect_err(what);
        assert!(fault.contains("permissions do not let this user"), "{what}: {fault}");
    }
    let ordered = cell.disk.lock().unwrap().ordered.clone();
    assert!(ordered.iter().all(|(.., by)| by != "ben"), "{ordered:?}");
    let stranger = site.access(&nkeys::KeyPair::new_user());
    let fleet = Fleet::new("plant").unwrap();
    assert!(run.block_on(Client::open(&stranger, fleet, "anna", STORAGE)).is_err());
}
