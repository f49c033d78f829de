//! The API in a document for programs: made from the table of routes, so that it names what there is.
//!
//! In: the table. Out: OpenAPI 3.1 as JSON; `docs/openapi.json` is held to it by a test.

use crate::page::routes::{Route, table};
use serde_json::{Map, Value, json};

/// The document.
pub fn openapi() -> Value {
    let mut paths = Map::new();
    for route in table() {
        let entry = paths.entry(route.path).or_insert_with(|| json!({}));
        entry[route.method.to_lowercase()] = operation(&route);
    }
    json!({
        "openapi": "3.1.0",
        "info": {
            "title": "celld", "version": "1",
            "description": "The API of celld's page. A session comes from `celld open` (a cookie; whatever does \
                            more than look or stop also needs the header x-celld-page) or `celld open --token` (a \
                            bearer token). Lengths in m, angles in rad, times in s since 1970.",
        },
        "paths": paths,
        "components": {
            "securitySchemes": { "token": { "type": "http", "scheme": "bearer" } },
            "schemas": schemas(),
        },
    })
}

fn operation(route: &Route) -> Value {
    let role = route.least.map_or("none".to_string(), |role| role.to_string());
    let mut operation = json!({
        "summary": route.summary, "x-role": role,
        "responses": {
            "2XX": { "description": "done", "content": { route.answer: {} } },
            "4XX": {
                "description": "refused, with the reason",
                "content": { "application/json": { "schema": { "$ref": "#/components/schemas/Refusal" } } },
            },
        },
    });
    if route.least.is_some() {
        operation["security"] = json!([{ "token": [] }]);
    }
    if let Some(body) = route.body {
        let schema = json!({ "$ref": format!("#/components/schemas/{body}") });
        operation["requestBody"] =
            json!({ "required": true, "content": { "application/json": { "schema": schema } } });
    }
    let names: Vec<Value> = route.path.split('{').skip(1).filter_map(|rest| rest.split_once('}')).map(|(name, _)| {
        json!({ "name": name, "in": "path", "required": true, "schema": { "type": "string" } })
    }).collect();
    if !names.is_empty() {
        operation["parameters"] = names.into();
    }
    operation
}

fn object(properties: Value, required: &[&str]) -> Value {
    json!({ "type": "object", "properties": properties, "required": required, "additionalProperties": false })
}

fn schemas() -> Value {
    let text = json!({ "type": "string" });
    let number = json!({ "type": "number" });
    let flag = json!({ "type": "boolean" });
    let pose = json!({ "type": "array", "prefixItems": [number, number, number], "minItems": 3, "maxItems": 3,
                       "description": "x m, y m, theta rad" });
    let goal = object(json!({ "id": text, "pose": pose }), &["id", "pose"]);
    let goals = json!({ "type": "array", "items": goal });
    let orders = [
        "arm",
        "disarm",
        "approve",
        "reject",
        "cancel",
        "pause",
        "resume",
        "step",
        "abort",
        "park",
        "release",
        "recover",
        "confirm-gripper",
        "calibrate",
    ];
    let ways = ["show", "place", "hold", "release", "retreat"];
    let command = object(
        json!({
            "do": { "enum": orders }, "id": { "type": "string", "description": "approve, reject, cancel: the job" },
            "plan": { "type": "integer", "description": "approve: the plan's number, as in the status" },
            "channel": { "enum": ["A", "B"] }, "how": { "enum": ways },
        }),
        &["do"],
    );
    let steps = ["board", "picture", "auto", "lens", "touches", "touch", "untouch", "solve", "keep"];
    let list = |items: &Value| json!({ "type": "array", "items": items });
    let calibration = object(
        json!({
            "do": { "enum": steps }, "columns": { "type": "integer" }, "rows": { "type": "integer" },
            "size_mm": number, "gap_mm": number, "first_id": { "type": "integer" }, "on": flag,
            "drop": { "type": "array", "description": "names of pictures, or numbers of samples" },
            "points": list(&text), "tip_mm": list(&number), "table_only": flag, "tie": flag,
            "number": { "type": "integer", "description": "with `keep`: the `solved.number` that was looked at" },
        }),
        &["do"],
    );
    json!({
        "Calibration": calibration,
        "Nothing": { "type": "object" },
        "Refusal": { "type": "object", "properties": { "error": text } },
        "Ticket": object(json!({ "ticket": text }), &["ticket"]),
        "Control": object(json!({ "take": flag, "force": flag }), &["take"]),
        "Order": object(json!({ "command": command, "beat": { "type": "integer" } }), &["command"]),
        "JobText": object(json!({ "text": text, "name": text }), &["text"]),
        "Draft": object(json!({ "objects": goals, "moved": text }), &["objects"]),
        "GoalFile": object(json!({ "objects": goals, "replace": flag }), &["objects"]),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_document_in_docs_is_that_of_the_program() {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/openapi.json");
        let made = serde_json::to_string_pretty(&openapi()).unwrap() + "\n";
        if std::env::var_os("CELLD_WRITE").is_some() {
            std::fs::write(&path, &made).unwrap();
        }
        let kept = std::fs::read_to_string(&path).unwrap_or_default();
        assert_eq!(kept, made, "CELLD_WRITE=1 cargo test openapi writes it anew");
    }

    #[test]
    fn every_body_has_its_schema() {
        let document = openapi();
        for route in table() {
            if let Some(body) = route.body {
                assert!(document["components"]["schemas"][body].is_object(), "{}: {body}", route.path);
            }
        }
    }
}
