//! Values that a program has requested from whoever is at the pendant: what is shown, and the answer.
//!
//! In: a request, and JSON. Out: the value once it is of the type that is wanted. One request is shown at a
//! time, others wait their turn. Pure.

use serde_json::Value as Json;
use urscript::value::{ThreadId, Value};

/// Which value a program requests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wanted {
    /// Yes or no.
    Boolean,
    /// A whole number of 32 bits.
    Integer,
    /// A number.
    Float,
    /// A text.
    Text,
}

/// A request that the pendant shows.
#[derive(Clone, Debug)]
pub struct ValueRequest {
    number: u64,
    thread: ThreadId,
    /// What is wanted.
    pub wanted: Wanted,
    /// The program's words.
    pub text: String,
    answer: Option<Value>,
}

/// The request that is shown, and how many there were.
#[derive(Clone, Debug, Default)]
pub struct ValueRequests {
    shown: Option<ValueRequest>,
    count: u64,
}

impl Wanted {
    /// What a built-in of this name requests.
    pub fn of(name: &str) -> Option<Wanted> {
        Some(match name {
            "request_boolean_from_primary_client" => Wanted::Boolean,
            "request_integer_from_primary_client" => Wanted::Integer,
            "request_float_from_primary_client" => Wanted::Float,
            "request_string_from_primary_client" => Wanted::Text,
            _ => return None,
        })
    }

    /// Its name, as in the functions.
    pub fn name(self) -> &'static str {
        match self {
            Wanted::Boolean => "boolean",
            Wanted::Integer => "integer",
            Wanted::Float => "float",
            Wanted::Text => "string",
        }
    }

    /// Its number in the message to clients.
    pub fn code(self) -> u32 {
        match self {
            Wanted::Boolean => 0,
            Wanted::Integer => 1,
            Wanted::Float => 2,
            Wanted::Text => 3,
        }
    }

    fn value(self, answer: &Json) -> Option<Value> {
        match self {
            Wanted::Boolean => answer.as_bool().map(Value::Bool),
            Wanted::Integer => answer.as_i64().and_then(|number| i32::try_from(number).ok()).map(Value::Int),
            Wanted::Float => answer.as_f64().filter(|number| number.is_finite()).map(Value::Float),
            Wanted::Text => answer.as_str().map(Value::text),
        }
    }
}

impl ValueRequests {
    /// What the pendant shows; `None` when nothing is wanted or it is answered.
    pub fn shown(&self) -> Option<&ValueRequest> {
        self.shown.as_ref().filter(|request| request.answer.is_none())
    }

    /// Answers what the pendant shows.
    ///
    /// # Errors
    /// Nothing is wanted, or something of another type.
    pub fn answer(&mut self, answer: &Json) -> Result<(), String> {
        let Some(request) = self.shown.as_mut().filter(|request| request.answer.is_none()) else {
            return Err("no program has requested a value".to_owned());
        };
        let value = request.wanted.value(answer);
        let value =
            value.ok_or_else(|| format!("the program wants a {}, not {answer}", request.wanted.name()))?;
        request.answer = Some(value);
        Ok(())
    }

    /// Shows the request of a thread, if none is shown; its number, never 0.
    pub fn show(&mut self, thread: ThreadId, wanted: Wanted, text: String) -> Option<u64> {
        if self.shown.is_some() {
            return None;
        }
        self.count += 1;
        self.shown = Some(ValueRequest { number: self.count, thread, wanted, text, answer: None });
        Some(self.count)
    }

    /// The answer to a request, once there is one; the next may be shown then.
    pub fn take(&mut self, number: u64) -> Option<Value> {
        let answered = |request: &mut ValueRequest| request.number == number && request.answer.is_some();
        self.shown.take_if(answered).and_then(|request| request.answer)
    }

    /// A thread has gone; what another one has requested stays.
    pub fn clear_of(&mut self, thread: ThreadId) {
        self.shown.take_if(|request| request.thread == thread);
    }

    /// The program has gone.
    pub fn clear(&mut self) {
        self.shown = None;
    }
}
