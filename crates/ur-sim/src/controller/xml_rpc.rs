//! XML-RPC as scripts speak it: calls to text, answers to values.
//!
//! In: a method and its arguments, or the bytes of an answer. Out: the document of the call, or the value of
//! the answer. Types as the script manual has them: bool, int, double, string, arrays, structs; a pose is a
//! struct of x, y, z, rx, ry and rz, both ways. Foreign bytes: nesting is bounded, and what is not
//! XML-RPC is an error with a reason. Pure.

use crate::controller::sockets::MAX_BUFFER;
use std::fmt::Write;
use std::sync::Arc;
use urscript::value::Value;

/// Deepest nesting of arrays and structs in an answer.
const MAX_NESTING: usize = 16;

/// Members of a pose.
const POSE: [&str; 6] = ["x", "y", "z", "rx", "ry", "rz"];

/// The document of a call.
///
/// # Errors
/// An argument is a handle or nothing, or they are longer than a connection takes.
pub fn call(method: &str, arguments: &[Value]) -> Result<String, String> {
    let mut text = String::from("<?xml version=\"1.0\"?><methodCall><methodName>");
    escape(&mut text, method);
    text.push_str("</methodName><params>");
    for argument in arguments {
        text.push_str("<param>");
        encode(&mut text, argument)?;
        text.push_str("</param>");
    }
    text.push_str("</params></methodCall>");
    Ok(text)
}

fn encode(text: &mut String, value: &Value) -> Result<(), String> {
    if text.len() > MAX_BUFFER {
        return Err("the arguments are too long".to_owned());
    }
    text.push_str("<value>");
    // Writing to a string cannot fail.
    match value {
        Value::Bool(on) => drop(write!(text, "<boolean>{}</boolean>", u8::from(*on))),
        Value::Int(number) => drop(write!(text, "<int>{number}</int>")),
        Value::Float(number) => drop(write!(text, "<double>{number}</double>")),
        Value::Text(words) => {
            text.push_str("<string>");
            escape(text, words);
            text.push_str("</string>");
        }
        Value::List(elements) => {
            text.push_str("<array><data>");
            elements.iter().try_for_each(|element| encode(text, element))?;
            text.push_str("</data></array>");
        }
        Value::Pose(pose) => {
            let members =
                POSE.iter().zip(pose).map(|(name, number)| (Arc::from(*name), Value::Float(*number)));
            structure(text, &members.collect::<Vec<_>>())?;
        }
        Value::Struct(members) => structure(text, members)?,
        Value::Nothing | Value::Thread(_) | Value::Remote(_) => {
            return Err(format!("a {} cannot be handed over by XML-RPC", value.type_name()));
        }
    }
    text.push_str("</value>");
    Ok(())
}

fn structure(text: &mut String, members: &[(Arc<str>, Value)]) -> Result<(), String> {
    text.push_str("<struct>");
    for (name, value) in members {
        text.push_str("<member><name>");
        escape(text, name);
        text.push_str("</name>");
        encode(text, value)?;
        text.push_str("</member>");
    }
    text.push_str("</struct>");
    Ok(())
}

fn escape(text: &mut String, words: &str) {
    for character in words.chars() {
        match character {
            '<' => text.push_str("&lt;"),
            '>' => text.push_str("&gt;"),
            '&' => text.push_str("&amp;"),
            other => text.push(other),
        }
    }
}

/// The value of an answer.
///
/// # Errors
/// The fault that the server reports, or that the text is no answer.
pub fn answer(text: &str) -> Result<Value, String> {
    let start = text.find("<methodResponse").ok_or("the answer is not XML-RPC")?;
    let mut rest = Rest(text.get(start..).unwrap_or_default());
    rest.open("methodResponse")?;
    if rest.open("fault").is_ok() {
        let fault = value(&mut rest, 0)?;
        let Value::Struct(members) = &fault else { return Err(format!("fault {fault}")) };
        let words = members.iter().find(|(name, _)| &**name == "faultString");
        return Err(format!("fault: {}", words.map_or(&fault, |(_, words)| words)));
    }
    rest.open("params")?;
    rest.open("param")?;
    value(&mut rest, 0)
}

/// What is left of a document.
struct Rest<'a>(&'a str);

impl<'a> Rest<'a> {
    /// The next tag's name if there is nothing but space before it; `/` is part of it.
    fn tag(&self) -> Option<(&'a str, &'a str)> {
        let (name, rest) = self.0.trim_start().strip_prefix('<')?.split_once('>')?;
        Some((name.trim_end(), rest))
    }

    fn open(&mut self, wanted: &str) -> Result<(), String> {
        match self.tag() {
            Some((name, rest)) if name == wanted => {
                self.0 = rest;
                Ok(())
            }
            _ => Err(format!("the answer is not XML-RPC: no {wanted} where one belongs")),
        }
    }

    /// Text up to the next tag.
    fn text(&mut self) -> Result<String, String> {
        let end = self.0.find('<').ok_or("the answer is not XML-RPC: it breaks off")?;
        let (words, rest) = self.0.split_at(end);
        self.0 = rest;
        Ok(words
            .replace("&lt;", "<")
            .replace("&gt;", ">")
            .replace("&quot;", "\"")
            .replace("&apos;", "'")
            .replace("&amp;", "&"))
    }
}

fn value(rest: &mut Rest<'_>, depth: usize) -> Result<Value, String> {
    if depth > MAX_NESTING {
        return Err("the answer is nested too deep".to_owned());
    }
    if rest.open("value/").is_ok() {
        return Ok(Value::text(""));
    }
    rest.open("value")?;
    // Text without a type is a string; space before a type is none.
    let Some((kind, behind)) = rest.tag().filter(|(name, _)| !name.starts_with('/')) else {
        let words = rest.text()?;
        rest.open("/value")?;
        return Ok(Value::text(words));
    };
    rest.0 = behind;
    let found = match kind {
        "array" => array(rest, depth)?,
        "struct" => members(rest, depth)?,
        "array/" => Value::list(Vec::new()),
        "string/" => Value::text(""),
        "nil/" => Value::Nothing,
        _ => {
            let words = rest.text()?;
            rest.open(&format!("/{kind}"))?;
            scalar(kind, &words)?
        }
    };
    rest.open("/value")?;
    Ok(found)
}

fn scalar(kind: &str, words: &str) -> Result<Value, String> {
    let number = words.trim();
    let wrong = || format!("the answer has {words:?} as {kind}");
    Ok(match kind {
        "int" | "i4" => Value::Int(number.parse().map_err(|_| wrong())?),
        "double" => Value::Float(number.parse().map_err(|_| wrong())?),
        "boolean" if matches!(number, "0" | "1") => Value::Bool(number == "1"),
        "string" | "base64" | "dateTime.iso8601" => Value::text(words),
        _ => return Err(wrong()),
    })
}

fn array(rest: &mut Rest<'_>, depth: usize) -> Result<Value, String> {
    let mut elements = Vec::new();
    if rest.open("data/").is_err() {
        rest.open("data")?;
        while rest.open("/data").is_err() {
            elements.push(value(rest, depth + 1)?);
        }
    }
    rest.open("/array")?;
    Ok(Value::list(elements))
}

fn members(rest: &mut Rest<'_>, depth: usize) -> Result<Value, String> {
    let mut members: Vec<(Arc<str>, Value)> = Vec::new();
    while rest.open("/struct").is_err() {
        rest.open("member")?;
        rest.open("name")?;
        let name = rest.text()?;
        rest.open("/name")?;
        members.push((name.into(), value(rest, depth + 1)?));
        rest.open("/member")?;
    }
    let of_pose = |wanted: &str| members.iter().find(|(name, _)| &**name == wanted)?.1.as_number();
    let pose: Vec<f64> = POSE.iter().filter_map(|name| of_pose(name)).collect();
    Ok(match <[f64; 6]>::try_from(pose) {
        Ok(pose) if members.len() == 6 => Value::Pose(pose),
        _ => Value::Struct(Arc::new(members)),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn answered(value: &str) -> Result<Value, String> {
        answer(&format!(
            "<?xml version='1.0'?>\n<methodResponse>\n <params><param>\n{value}</param></params></methodResponse>"
        ))
    }

    #[test]
    fn what_a_call_says_is_what_an_answer_means() {
        let values = [
            Value::Bool(true),
            Value::Int(-7),
            Value::Float(0.25),
            Value::text("a <b> & c"),
            Value::text(""),
            Value::list(vec![Value::Int(1), Value::list(vec![]), Value::text("x")]),
            Value::Pose([0.1, 0.2, 0.3, 1.0, -2.0, 3.0]),
            Value::Struct(Arc::new(vec![("n".into(), Value::Int(1))])),
        ];
        for expected in values {
            let text = call("f", std::slice::from_ref(&expected)).unwrap();
            let inner = text.split("<param>").nth(1).unwrap().split("</param>").next().unwrap();
            assert_eq!(answered(inner), Ok(expected), "{text}");
        }
        assert!(call("f", &[Value::Nothing]).is_err());
        let long = Value::list(vec![Value::text("x".repeat(MAX_BUFFER)); 1000]);
        assert!(call("f", &[long]).unwrap_err().contains("too long"));
    }

    #[test]
    fn answers_of_other_libraries_are_understood() {
        for (text, expected) in [
            ("<value>plain</value>", Value::text("plain")),
            ("<value/>", Value::text("")),
            ("<value> <i4> 5 </i4> </value>", Value::Int(5)),
            ("<value><string/></value>", Value::text("")),
            ("<value><array><data/></array></value>", Value::list(vec![])),
        ] {
            assert_eq!(answered(text), Ok(expected), "{text}");
        }
        let fault = "<methodResponse><fault><value><struct><member><name>faultCode</name><value><int>4</int>\
                     </value></member><member><name>faultString</name><value>no such method</value></member>\
                     </struct></value></fault></methodResponse>";
        assert_eq!(answer(fault), Err("fault: no such method".to_owned()));
        for wrong in
            ["<value><int>x</int></value>", "<value><boolean>2</boolean></value>", "<int>1</int>", ""]
        {
            assert!(answered(wrong).is_err(), "{wrong}");
        }
        let deep = "<value><array><data>".repeat(100);
        assert_eq!(answered(&deep), Err("the answer is nested too deep".to_owned()));
    }

    proptest! {
        #[test]
        fn foreign_text_never_panics(text in "[<>/a-z0-9 &;]{0,200}") {
            let _ = answer(&text);
            let _ = answered(&format!("<value>{text}"));
        }
    }
}
