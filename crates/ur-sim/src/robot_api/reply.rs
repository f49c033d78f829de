//! What the Robot API takes and gives: a request without its socket, and the reply to it.
//!
//! In: method, path below the API's own, type and bytes of the body. Out: a status and JSON, but for files
//! always JSON: clients parse the body before they look at the status.

use serde_json::{Value, json};

/// A request.
#[derive(Clone, Copy, Debug)]
pub struct Request<'a> {
    /// In capitals, as GET.
    pub method: &'a str,
    /// Behind the API's own path, percent signs and all.
    pub path: &'a str,
    /// `Content-Type`; empty without one.
    pub content_type: &'a str,
    /// The body.
    pub body: &'a [u8],
}

impl Request<'_> {
    /// The text under a key of the body, which is a JSON object.
    ///
    /// # Errors
    /// The refusal: there is no such text.
    pub fn text(&self, keys: &[&str]) -> Result<String, Reply> {
        let body: Option<Value> = serde_json::from_slice(self.body).ok();
        let found = keys.iter().find_map(|key| body.as_ref()?.get(*key)?.as_str());
        found.map(str::to_owned).ok_or_else(|| {
            let wanted = keys.first().copied().unwrap_or_default();
            Reply::refused(422, "Validation error", &format!("the body needs {wanted:?}, a text"))
        })
    }
}

/// A reply.
#[derive(Clone, Debug, PartialEq)]
pub struct Reply {
    /// Of HTTP.
    pub status: u16,
    /// JSON.
    pub body: Value,
    /// Where the client is sent instead, below the API's own path.
    pub location: Option<&'static str>,
    /// In place of the JSON: its type, and a file.
    pub file: Option<(&'static str, Vec<u8>)>,
}

impl Reply {
    /// What was requested.
    pub fn of(body: Value) -> Reply {
        Reply { status: 200, body, location: None, file: None }
    }

    /// It is done.
    pub fn done(message: &str) -> Reply {
        Reply::of(json!({ "message": message }))
    }

    /// It will be done; nothing more is said.
    pub fn accepted() -> Reply {
        Reply { status: 202, ..Reply::of(json!({ "message": null })) }
    }

    /// There is nothing to give.
    pub fn empty() -> Reply {
        Reply { status: 204, ..Reply::of(Value::Null) }
    }

    /// A file of a type.
    pub fn file(kind: &'static str, bytes: Vec<u8>) -> Reply {
        Reply { file: Some((kind, bytes)), ..Reply::of(Value::Null) }
    }

    /// It is not done: what, and why.
    pub fn refused(status: u16, message: &str, details: &str) -> Reply {
        Reply { status, ..Reply::of(json!({"message": message, "details": details})) }
    }

    /// The same request belongs there.
    pub fn elsewhere(location: &'static str) -> Reply {
        Reply { status: 307, location: Some(location), ..Reply::done("Temporary redirect") }
    }
}

/// What became of a request.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// The reply.
    Reply(Reply),
    /// The reply comes when the arm is so far.
    Until(Goal),
}

impl From<Reply> for Outcome {
    fn from(reply: Reply) -> Outcome {
        Outcome::Reply(reply)
    }
}

/// What a reply waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Goal {
    /// The arm has power.
    Powered,
    /// The brakes are open.
    Running,
}
