//! Holds `docs/asyncapi.json` to the names and payloads; `CELLD_WRITE=1` writes it anew.
//!
//! In: the document as it is made, examples of every payload. Out: a difference, or an example that its
//! schema does not take.

#![allow(clippy::unwrap_used, reason = "helpers of tests: an unwrap that fails is the test that fails")]

use cell_fleet::asyncapi::asyncapi;
use cell_fleet::fragments::Fragment;
use cell_fleet::payloads::{
    Answer, CellState, Claim, ClaimState, Event, Job, Outcome, Refusal, Request, VERSION, What, Wish, sha256,
};
use cell_fleet::subjects::{Fleet, Key, Lane, Priority, RequestKind, Target};
use serde_json::{Value, json};
use std::path::Path;

#[test]
fn the_document_is_what_the_code_says() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/asyncapi.json");
    let made = serde_json::to_string_pretty(&asyncapi()).unwrap() + "\n";
    if std::env::var_os("CELLD_WRITE").is_some() {
        std::fs::write(&path, &made).unwrap();
    }
    let written = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(
        written == made,
        "docs/asyncapi.json differs; CELLD_WRITE=1 cargo test -p cell-fleet writes it anew"
    );
}

fn schema(name: &str) -> jsonschema::Validator {
    let document = asyncapi();
    let whole = json!({
        "$ref": format!("#/components/schemas/{name}"), "components": document["components"].clone(),
    });
    jsonschema::validator_for(&whole).unwrap()
}

#[track_caller]
fn fits(name: &str, value: &impl serde::Serialize) {
    let value = serde_json::to_value(value).unwrap();
    if let Err(error) = schema(name).validate(&value) {
        panic!("{name}: {error}\n{value:#}");
    }
}

#[test]
fn every_payload_fits_its_schema_and_names_no_field_that_it_has_not() {
    let job =
        Job { not_before_unix_s: Some(1.0), campaign: Some("week".into()), ..Job::new("a.b", "x", 0.0) };
    fits("job", &job);
    let lane = Lane { priority: Priority::Urgent, target: Target::any() };
    let outcome = Outcome { status: "done".into(), lower_bound: Some(1.0), ..Outcome::default() };
    let mut claim = Claim::new(job, &lane, "anna", ClaimState::Ended, "c1", 1.0);
    (claim.outcome, claim.reasons) = (Some(outcome.clone()), [("c1".to_string(), "no".to_string())].into());
    fits("claim", &claim);
    fits("refusal", &Refusal { version: VERSION, epoch: 1, reason: "no".into(), unix_s: 1.0 });
    fits("wish", &Wish { version: VERSION, epoch: 1, target: Some("any".into()), begun: true, unix_s: 1.0 });
    fits("ask", &Request { version: VERSION, job: "a".into(), plan: Some(3), files: vec!["plan".into()] });
    fits(
        "answer",
        &Answer { version: VERSION, accepted: true, message: "yes".into(), files: vec!["plan.svg".into()] },
    );
    let text = "version: 1\n".to_string();
    fits("fragment", &Fragment { version: VERSION, sha256: sha256(&text), text, unix_s: 1.0 });
    let cell = CellState {
        version: VERSION,
        step: Some((1, 2)),
        plan: Some(3),
        fragment: Some(4),
        fragment_waits: Some(5),
        vacuum_percent: Some(50.0),
        ..CellState::default()
    };
    fits("cell", &cell);
    let document = asyncapi();
    let named = |schema: &str, value: Value| {
        for key in value.as_object().unwrap().keys() {
            let known = &document["components"]["schemas"][schema]["properties"][key];
            assert!(!known.is_null(), "{schema} does not name {key}");
        }
    };
    named("cell", serde_json::to_value(&cell).unwrap());
    named("claim", serde_json::to_value(&claim).unwrap());
    let whats = [
        What::Looked { objects: 1, residual_mm: Some(0.1) },
        What::Planned { moves: 1, lower_bound: None, waits: true },
        What::Approved { by: "anna".into(), agreed: true },
        What::Step { step: 1, of: 2 },
        What::Done { outcome },
        What::Fault { code: "x".into(), message: "y".into() },
        What::Gap { first: 1, lost: 2 },
    ];
    assert_eq!(whats.clone().map(|what| what.kind()), What::KINDS);
    for what in whats {
        let (cell, series) = ("c1".to_string(), "s".to_string());
        let event =
            Event { version: VERSION, cell, series, number: 1, unix_s: 1.0, job: Some("a".into()), what };
        fits("event", &event);
        named("event", serde_json::to_value(&event).unwrap());
    }
    assert!(schema("job").validate(&json!({ "version": 2 })).is_err());
}

/// Every subject and key that the code makes is one of the document's addresses.
#[test]
fn every_name_is_an_address_of_the_document() {
    let fleet = Fleet::new("plant").unwrap();
    let lane = Lane { priority: Priority::Normal, target: Target::any() };
    let (job, by, cell) = ("a".to_string(), "anna".to_string(), "c1".to_string());
    let key = |key: Key| format!("$KV.{}.{key}", fleet.claims_bucket());
    let names = [
        ("jobs", fleet.job(&lane, "anna")),
        ("events", fleet.event("c1", "done")),
        ("ask", fleet.request("c1", RequestKind::Approve, "anna")),
        ("fragments", format!("$KV.{}.{}", fleet.config_bucket(), lane.target.config_key("anna"))),
        ("cells", format!("$KV.{}.c1", fleet.cells_bucket())),
        ("claims", key(Key::claim("a"))),
        ("refusals", key(Key::Refusal { job: job.clone(), cell })),
        ("cancels", key(Key::Cancel { job: job.clone(), by: by.clone() })),
        ("gives", key(Key::Give { job, by })),
    ];
    let document = asyncapi();
    assert_eq!(document["channels"].as_object().unwrap().len(), names.len());
    for (channel, name) in names {
        let address = document["channels"][channel]["address"].as_str().unwrap();
        let filled = address
            .replace("{fleet}", "plant")
            .replace("{target}", "label.any")
            .replace("{priority}", "normal")
            .replace("{user}", "anna")
            .replace("{cell}", "c1")
            .replace("{kind}", "done")
            .replace("{asked}", "approve")
            .replace("{job}", "a");
        assert_eq!(filled, name, "{channel}");
    }
}
