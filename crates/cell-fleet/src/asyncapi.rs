//! What goes over a fleet in a document for other programs: AsyncAPI 3, made from the names and payloads.
//!
//! Out: the document as JSON; `docs/asyncapi.json` is held to it by a test, and examples of every payload to
//! its schemas. Pure.

use crate::files::FileKind;
use crate::fragments::FRAGMENT_MAX;
use crate::payloads::{JOB_TEXT_MAX, PAYLOAD_MAX, VERSION, What};
use crate::subjects::{JOB_ID_MAX, NAME_MAX, Priority, ROOT, RequestKind};
use serde_json::{Map, Value, json};

/// The document.
pub fn asyncapi() -> Value {
    json!({
        "asyncapi": "3.0.0",
        "info": {
            "title": "celld fleet", "version": VERSION.to_string(),
            "description": format!(
                "Jobs, claims, states and events of a fleet of robot cells over NATS JetStream. Payloads are JSON of \
                 at most {PAYLOAD_MAX} bytes. Times are s since 1970, lengths m, angles rad. Unknown fields are to be \
                 left out; another version is refused. USER is the person, as the server's permissions enforce it."
            ),
        },
        "defaultContentType": "application/json",
        "channels": channels(),
        "operations": operations(),
        "components": { "schemas": schemas(), "messages": messages() },
    })
}

fn channel(address: String, parameters: &[&str], message: &str, description: &str) -> Value {
    let known: Map<String, Value> =
        parameters.iter().map(|name| (name.to_string(), parameter(name))).collect();
    json!({
        "address": address, "description": description, "parameters": known,
        "messages": { message: { "$ref": format!("#/components/messages/{message}") } },
    })
}

fn parameter(name: &str) -> Value {
    let words = |words: Vec<&str>| json!({ "enum": words });
    match name {
        "priority" => words(Priority::ALL.into_iter().map(Priority::as_str).collect()),
        "asked" => words(RequestKind::ALL.into_iter().map(RequestKind::as_str).collect()),
        "kind" => words(What::KINDS.to_vec()),
        "target" => json!({ "description": "`cell.NAME`, or `label.NAME`; every cell has the label `any`" }),
        "job" => json!({ "description": "a job's id with `=` for each dot" }),
        _ => json!({ "description": format!("1 to {NAME_MAX} letters, digits, - and _") }),
    }
}

fn channels() -> Value {
    let claims = "$KV.celld-{fleet}-claims";
    json!({
        "jobs": channel(
            format!("{ROOT}.{{fleet}}.job.{{target}}.{{priority}}.{{user}}"),
            &["fleet", "target", "priority", "user"], "job",
            "the stream celld-FLEET-jobs: a work queue; Nats-Msg-Id is ID/SHA/EPOCH",
        ),
        "events": channel(
            format!("{ROOT}.{{fleet}}.event.{{cell}}.{{kind}}"), &["fleet", "cell", "kind"], "event",
            "the stream celld-FLEET-events; Nats-Msg-Id is CELL/SERIES/NUMBER; a number seen before is the same event",
        ),
        "ask": channel(
            format!("{ROOT}.{{fleet}}.ask.{{cell}}.{{asked}}.{{user}}"), &["fleet", "cell", "asked", "user"], "ask",
            "a request to one cell, answered after it was decided",
        ),
        "fragments": channel(
            "$KV.celld-{fleet}-config.{target}.{user}".to_string(), &["fleet", "target", "user"], "fragment",
            "parts of a configuration that cells share; of one target the newest counts, its number is its revision",
        ),
        "cells": channel(
            "$KV.celld-{fleet}-cells.{cell}".to_string(), &["fleet", "cell"], "cell",
            "the bucket of the cells' states",
        ),
        "claims": channel(
            format!("{claims}.claim.{{job}}"), &["fleet", "job"], "claim",
            "the one record of a job; every change is a compare-and-set of its revision",
        ),
        "refusals": channel(
            format!("{claims}.refusal.{{job}}.{{cell}}"), &["fleet", "job", "cell"], "refusal",
            "why a cell does not take a job",
        ),
        "cancels": channel(
            format!("{claims}.cancel.{{job}}.{{user}}"), &["fleet", "job", "user"], "wish",
            "a person does not want the job any more",
        ),
        "gives": channel(
            format!("{claims}.give.{{job}}.{{user}}"), &["fleet", "job", "user"], "wish",
            "a person gives the job to another cell; for one that was begun this alone does",
        ),
    })
}

fn operations() -> Value {
    let operation = |action: &str, channel: &str, summary: &str| json!({ "action": action, "channel": { "$ref": format!("#/channels/{channel}") }, "summary": summary });
    let mut request = operation(
        "send",
        "ask",
        "agree to a plan, refuse it, give a job up, or have its files put into the object store celld-FLEET-files",
    );
    request["reply"] = json!({ "messages": [{ "$ref": "#/components/messages/answer" }] });
    json!({
        "submit": operation("send", "jobs", "submit a job"),
        "cancel": operation("send", "cancels", "cancel a job"),
        "give": operation("send", "gives", "give a job to another cell"),
        "ask": request,
        "follow": operation("receive", "events", "what happens in the cells"),
        "see": operation("receive", "cells", "the state of each cell"),
        "publish": operation("send", "fragments", "publish a part of a configuration, or take it back by an empty text"),
        "trace": operation("receive", "claims", "what becomes of each job"),
    })
}

fn messages() -> Value {
    let names = ["job", "event", "ask", "answer", "cell", "claim", "refusal", "wish", "fragment"];
    let message = |name: &&str| {
        (name.to_string(), json!({ "payload": { "$ref": format!("#/components/schemas/{name}") } }))
    };
    names.iter().map(message).collect::<Map<String, Value>>().into()
}

fn object(properties: Value, required: &[&str]) -> Value {
    let mut properties = properties;
    properties["version"] = json!({ "const": VERSION });
    let required: Vec<&str> = std::iter::once("version").chain(required.iter().copied()).collect();
    json!({ "type": "object", "properties": properties, "required": required })
}

fn schemas() -> Value {
    let (number, count, text) = (
        json!({ "type": "number" }),
        json!({ "type": "integer", "minimum": 0 }),
        json!({ "type": "string" }),
    );
    let maybe = |kind: &str| json!({ "type": [kind, "null"] });
    let name = json!({ "type": "string", "pattern": format!("^[A-Za-z0-9_-]{{1,{NAME_MAX}}}$") });
    let id = json!({ "type": "string", "pattern": format!("^[A-Za-z0-9_-][A-Za-z0-9._-]{{0,{}}}$", JOB_ID_MAX - 1) });
    let texts = json!({ "type": "array", "items": text });
    let outcome = json!({
        "type": "object",
        "properties": {
            "status": text, "code": text, "message": text, "moves": count, "lower_bound": maybe("number"),
            "seconds": number,
        },
        "required": ["status", "code", "message", "moves", "seconds"],
    });
    let job = object(
        json!({
            "id": id, "sha256": { "type": "string", "pattern": "^([0-9a-f]{64})?$" },
            "text": { "type": "string", "maxLength": JOB_TEXT_MAX }, "epoch": { "type": "integer", "minimum": 1 },
            "submitted_unix_s": number, "not_before_unix_s": number, "campaign": text,
        }),
        &["id", "sha256", "text", "epoch", "submitted_unix_s"],
    );
    json!({
        "job": job,
        "event": event(&name, &outcome),
        "ask": object(
            json!({
                "job": id, "plan": { "type": ["integer", "null"] },
                "files": { "type": "array", "items": { "enum": FileKind::ALL.map(FileKind::as_str) } },
            }),
            &["job"],
        ),
        "answer": object(
            json!({ "accepted": { "type": "boolean" }, "message": text, "files": texts }),
            &["accepted", "message"],
        ),
        "refusal": object(json!({ "epoch": count, "reason": text, "unix_s": number }), &["epoch", "reason", "unix_s"]),
        "wish": wish(&number, &count, &text),
        "claim": object(
            json!({
                "job": { "$ref": "#/components/schemas/job" }, "target": text,
                "priority": { "enum": Priority::ALL.map(Priority::as_str) }, "by": text,
                "state": { "enum": ["offered", "claimed", "begun", "ended", "aside", "cancelled"] }, "cell": text,
                "unix_s": number, "queued": { "type": "boolean" }, "outcome": outcome,
                "reasons": { "type": "object", "additionalProperties": text },
            }),
            &["job", "target", "priority", "by", "state", "cell", "unix_s"],
        ),
        "fragment": fragment(&number),
        "cell": cell(&number, &count, &text, &texts),
    })
}

fn wish(number: &Value, count: &Value, text: &Value) -> Value {
    let properties =
        json!({ "epoch": count, "target": text, "begun": { "type": "boolean" }, "unix_s": number });
    object(properties, &["epoch", "unix_s"])
}

fn fragment(number: &Value) -> Value {
    let properties = json!({
        "text": { "type": "string", "maxLength": FRAGMENT_MAX },
        "sha256": { "type": "string", "pattern": "^[0-9a-f]{64}$" }, "unix_s": number,
    });
    object(properties, &["text", "sha256", "unix_s"])
}

fn cell(number: &Value, count: &Value, text: &Value, texts: &Value) -> Value {
    let flag = json!({ "type": "boolean" });
    let totals = json!({
        "type": "object",
        "properties": { "done": count, "failed": count, "moves": count, "bound": number, "seconds": number },
    });
    object(
        json!({
            "labels": texts, "celld": text, "unix_s": number, "clock_ahead_s": number, "state": text,
            "message": text, "hint": text, "armed": flag, "moving": flag, "idle": flag, "job": { "type": ["string", "null"] },
            "awaiting_approval": texts, "plan": { "type": ["integer", "null"] }, "holds": texts, "step": { "type": ["array", "null"], "items": count },
            "totals": totals, "fragment": count, "fragment_waits": count, "undelivered": count, "vacuum_percent": { "type": ["number", "null"] },
            "drift_mm": { "type": ["number", "null"] }, "complaints": texts,
        }),
        &["labels", "celld", "unix_s", "state", "message", "armed", "idle"],
    )
}

fn event(name: &Value, outcome: &Value) -> Value {
    let text = json!({ "type": "string" });
    let count = json!({ "type": "integer", "minimum": 0 });
    let number = json!({ "type": ["number", "null"] });
    object(
        json!({
            "cell": name, "series": text, "number": { "type": "integer", "minimum": 1 },
            "unix_s": { "type": "number" }, "job": text, "kind": { "enum": What::KINDS },
            "objects": count, "residual_mm": number, "moves": count, "lower_bound": number,
            "waits": { "type": "boolean" }, "by": text, "agreed": { "type": "boolean" }, "step": count,
            "of": count, "outcome": outcome, "code": text, "message": text, "first": count, "lost": count,
        }),
        &["cell", "series", "number", "unix_s", "kind"],
    )
}
