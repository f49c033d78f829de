//! What the Robot API takes and gives: a request without its socket, and the reply to it.
//!
//! In: method, path below the API's own, type and bytes of the body. Out: a status and JSON, always JSON:
//! clients parse the body before they look at the status.

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
}

impl Reply {
    /// What was asked for.
    pub fn of(body: Value) -> Reply {
        Reply { status: 200, body, location: None }
    }

    /// It is done.
    pub fn done(message: &str) -> Reply {
        Reply::of(json!({ "message": message }))
    }

    /// It is not done: what, and why.
    pub fn refused(status: u16, message: &str, details: &str) -> Reply {
        Reply { status, body: json!({"message": message, "details": details}), location: None }
    }

    /// The same request belongs there.
    pub fn elsewhere(location: &'static str) -> Reply {
        Reply { status: 307, body: json!({"message": "Temporary redirect"}), location: Some(location) }
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
