//! RTDE packages, protocol versions 1 and 2, for the client and for the controller.
//!
//! In: bytes of TCP port 30004. Out: [`Request`]s (client to controller) and [`Reply`]s (controller to
//! client), and bytes again. The same type byte means different payloads by direction and version, so both
//! are arguments. A session starts in version 1 until `V` has been answered. Source: the vendor's RTDE
//! guide.

use crate::bytes::{Pending, Reader, WireError, Writer, cut_text};
use crate::rtde_values::Offer;
use serde::{Deserialize, Serialize};

/// Bytes of a package header: `u16` size of the whole package, `u8` type.
pub const HEADER: usize = 3;

/// Longest list of names in one set-up request; recent controllers refuse more.
pub const MAX_NAMES: usize = 2048;

/// Protocol version spoken on a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub enum Version {
    /// Spoken until `V` has been answered.
    V1,
    /// Adds output frequency, output recipe ids and longer text messages.
    V2,
}

/// One package, not interpreted yet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frame {
    /// Type byte, a printable letter.
    pub kind: u8,
    /// What follows the header.
    pub payload: Vec<u8>,
}

impl Frame {
    /// Header and payload. A payload that does not fit a package (65532 bytes) is cut; none of ours comes
    /// near, and the peer then refuses the package by its fields.
    pub fn encode(&self) -> Vec<u8> {
        let payload = &self.payload[..self.payload.len().min(usize::from(u16::MAX) - HEADER)];
        let mut out = Writer::new();
        out.u16((payload.len() + HEADER) as u16).u8(self.kind).bytes(payload);
        out.finish()
    }
}

/// Splits a byte stream into frames. Holds at most one unfinished package (64 KiB) besides what was pushed.
#[derive(Default, Deserialize, Serialize)]
pub struct Splitter(Pending);

impl Splitter {
    /// Appends what arrived; then call [`Splitter::next_frame`] until it gives `None`.
    pub fn push(&mut self, bytes: &[u8]) {
        self.0.push(bytes);
    }

    /// The next whole package.
    ///
    /// # Errors
    /// A size below the header's: the stream cannot be trusted any more and what waits is dropped.
    pub fn next_frame(&mut self) -> Result<Option<Frame>, WireError> {
        let [high, low, kind, ..] = *self.0.waiting() else { return Ok(None) };
        let size = usize::from(u16::from_be_bytes([high, low]));
        if size < HEADER {
            self.0.clear();
            return Err(WireError::Length { found: size as i64, min: HEADER, max: usize::from(u16::MAX) });
        }
        let taken = self.0.take(size).and_then(|package| package.get(HEADER..));
        Ok(taken.map(|payload| Frame { kind, payload: payload.to_vec() }))
    }
}

/// Level of a text message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// 0.
    Exception,
    /// 1.
    Error,
    /// 2.
    Warning,
    /// 3.
    Info,
}

impl Level {
    fn decode(reader: &mut Reader) -> Result<Level, WireError> {
        let offset = reader.offset();
        match reader.u8("level")? {
            0 => Ok(Level::Exception),
            1 => Ok(Level::Error),
            2 => Ok(Level::Warning),
            3 => Ok(Level::Info),
            other => Err(WireError::Unexpected {
                field: "level",
                offset,
                found: other.to_string(),
                expected: "0 to 3",
            }),
        }
    }

    fn code(self) -> u8 {
        match self {
            Level::Exception => 0,
            Level::Error => 1,
            Level::Warning => 2,
            Level::Info => 3,
        }
    }
}

/// A text for a person's eyes; may arrive at any time, also between a request and its reply.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TextMessage {
    /// The text.
    pub message: String,
    /// Who says it; empty in version 1.
    pub source: String,
    /// How bad it is.
    pub level: Level,
}

impl TextMessage {
    fn encode(&self, version: Version) -> Vec<u8> {
        let mut out = Writer::new();
        match version {
            Version::V1 => out.u8(self.level.code()).bytes(self.message.as_bytes()),
            Version::V2 => out.short_text(&self.message).short_text(&self.source).u8(self.level.code()),
        };
        out.finish()
    }

    fn decode(version: Version, reader: &mut Reader) -> Result<TextMessage, WireError> {
        match version {
            Version::V1 => {
                let level = Level::decode(reader)?;
                Ok(TextMessage { message: reader.rest_text(), source: String::new(), level })
            }
            Version::V2 => {
                let message = reader.short_text("message")?;
                let source = reader.short_text("source")?;
                Ok(TextMessage { message, source, level: Level::decode(reader)? })
            }
        }
    }
}

/// What a client sends.
#[derive(Clone, Debug, PartialEq)]
pub enum Request {
    /// `V`: wants to speak this version.
    ProtocolVersion(u16),
    /// `v`: requests the controller's software version.
    ControllerVersion,
    /// `M`: a text for the controller's log.
    Text(TextMessage),
    /// `O`: wants these outputs. The frequency in Hz exists in version 2 only.
    SetupOutputs {
        /// Packages per second; `None` in version 1.
        frequency_hz: Option<f64>,
        /// Variable names.
        names: Vec<String>,
    },
    /// `I`: wants to write these inputs.
    SetupInputs {
        /// Variable names.
        names: Vec<String>,
    },
    /// `S`: start sending outputs.
    Start,
    /// `P`: pause sending outputs.
    Pause,
    /// `U`: values for an input recipe.
    Data {
        /// Recipe id.
        recipe: u8,
        /// Packed fields; see `Recipe::decode`.
        payload: Vec<u8>,
    },
}

impl Request {
    /// The whole package.
    pub fn encode(&self, version: Version) -> Vec<u8> {
        let mut out = Writer::new();
        let kind = match self {
            Request::ProtocolVersion(wanted) => {
                out.u16(*wanted);
                b'V'
            }
            Request::ControllerVersion => b'v',
            Request::Text(text) => {
                out.bytes(&text.encode(version));
                b'M'
            }
            Request::SetupOutputs { frequency_hz, names } => {
                if version == Version::V2 {
                    out.f64(frequency_hz.unwrap_or(0.0));
                }
                out.bytes(names.join(",").as_bytes());
                b'O'
            }
            Request::SetupInputs { names } => {
                out.bytes(names.join(",").as_bytes());
                b'I'
            }
            Request::Start => b'S',
            Request::Pause => b'P',
            Request::Data { recipe, payload } => {
                out.u8(*recipe).bytes(payload);
                b'U'
            }
        };
        Frame { kind, payload: out.finish() }.encode()
    }

    /// Reads a client's package. Bytes behind the last field are ignored, as controllers do.
    ///
    /// # Errors
    /// The type is unknown, the package ends inside a field, a level is above 3, or variable names are not
    /// ASCII.
    pub fn decode(version: Version, frame: &Frame) -> Result<Request, WireError> {
        let mut reader = Reader::new(&frame.payload);
        Ok(match frame.kind {
            b'V' => Request::ProtocolVersion(reader.u16("protocol version")?),
            b'v' => Request::ControllerVersion,
            b'M' => Request::Text(TextMessage::decode(version, &mut reader)?),
            b'O' => {
                let frequency_hz = match version {
                    Version::V1 => None,
                    Version::V2 => Some(reader.f64("output frequency")?),
                };
                Request::SetupOutputs { frequency_hz, names: names(&mut reader)? }
            }
            b'I' => Request::SetupInputs { names: names(&mut reader)? },
            b'S' => Request::Start,
            b'P' => Request::Pause,
            b'U' => Request::Data { recipe: reader.u8("recipe id")?, payload: reader.rest().to_vec() },
            found => return Err(WireError::UnknownType { found }),
        })
    }
}

/// A list of names; a trailing comma is tolerated because a wide-spread client always sends one.
fn names(reader: &mut Reader) -> Result<Vec<String>, WireError> {
    let offset = reader.offset();
    let text = std::str::from_utf8(reader.rest()).ok().filter(|text| text.is_ascii());
    let Some(text) = text else {
        let found = "other bytes".to_string();
        return Err(WireError::Unexpected { field: "variable names", offset, found, expected: "ASCII" });
    };
    let list = text.strip_suffix(',').unwrap_or(text);
    if list.is_empty() {
        return Ok(Vec::new());
    }
    Ok(list.split(',').map(|name| name.trim().to_string()).collect())
}

/// The controller's software version.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ControllerVersion {
    /// 5 for PolyScope 5.
    pub major: u32,
    /// Minor.
    pub minor: u32,
    /// Bug fix.
    pub bugfix: u32,
    /// Build number.
    pub build: u32,
}

/// What a controller sends.
#[derive(Clone, Debug, PartialEq)]
pub enum Reply {
    /// `V`: whether the version is accepted.
    ProtocolVersion(bool),
    /// `v`.
    ControllerVersion(ControllerVersion),
    /// `M`.
    Text(TextMessage),
    /// `O`: recipe id (0 refused; always 1 in version 1, which has none) and an offer for each name.
    SetupOutputs {
        /// Recipe id.
        recipe: u8,
        /// One per name, in order.
        offers: Vec<Offer>,
    },
    /// `I`: recipe id (0 refused) and an offer for each name.
    SetupInputs {
        /// Recipe id.
        recipe: u8,
        /// One per name, in order.
        offers: Vec<Offer>,
    },
    /// `S`: whether outputs are sent from now on.
    Start(bool),
    /// `P`.
    Pause(bool),
    /// `U`: output values. Version 1 has no id, it reads as 1.
    Data {
        /// Recipe id.
        recipe: u8,
        /// Packed fields; see `Recipe::decode`.
        payload: Vec<u8>,
    },
}

impl Reply {
    /// What it is, for messages.
    pub fn name(&self) -> &'static str {
        match self {
            Reply::ProtocolVersion(_) => "protocol version reply",
            Reply::ControllerVersion(_) => "controller version",
            Reply::Text(_) => "text",
            Reply::SetupOutputs { .. } => "output set-up reply",
            Reply::SetupInputs { .. } => "input set-up reply",
            Reply::Start(_) => "start reply",
            Reply::Pause(_) => "pause reply",
            Reply::Data { .. } => "data package",
        }
    }

    /// The whole package.
    pub fn encode(&self, version: Version) -> Vec<u8> {
        let mut out = Writer::new();
        let kind = match self {
            Reply::ProtocolVersion(accepted) => {
                out.bool(*accepted);
                b'V'
            }
            Reply::ControllerVersion(v) => {
                out.u32(v.major).u32(v.minor).u32(v.bugfix).u32(v.build);
                b'v'
            }
            Reply::Text(text) => {
                out.bytes(&text.encode(version));
                b'M'
            }
            Reply::SetupOutputs { recipe, offers } => {
                if version == Version::V2 {
                    out.u8(*recipe);
                }
                out.bytes(tokens(offers).as_bytes());
                b'O'
            }
            Reply::SetupInputs { recipe, offers } => {
                out.u8(*recipe).bytes(tokens(offers).as_bytes());
                b'I'
            }
            Reply::Start(accepted) => {
                out.bool(*accepted);
                b'S'
            }
            Reply::Pause(accepted) => {
                out.bool(*accepted);
                b'P'
            }
            Reply::Data { recipe, payload } => {
                if version == Version::V2 {
                    out.u8(*recipe);
                }
                out.bytes(payload);
                b'U'
            }
        };
        Frame { kind, payload: out.finish() }.encode()
    }

    /// Reads a controller's package; every byte of it has to be accounted for.
    ///
    /// # Errors
    /// The type is unknown, the package ends inside a field or goes on behind the last one, or a field holds
    /// a value that it cannot hold.
    pub fn decode(version: Version, frame: &Frame) -> Result<Reply, WireError> {
        let mut reader = Reader::new(&frame.payload);
        let reply = match frame.kind {
            b'V' => Reply::ProtocolVersion(reader.bool("accepted")?),
            b'v' => Reply::ControllerVersion(ControllerVersion {
                major: reader.u32("major")?,
                minor: reader.u32("minor")?,
                bugfix: reader.u32("bugfix")?,
                build: reader.u32("build")?,
            }),
            b'M' => Reply::Text(TextMessage::decode(version, &mut reader)?),
            b'O' => {
                let recipe = recipe_id(version, &mut reader)?;
                Reply::SetupOutputs { recipe, offers: offers(&mut reader)? }
            }
            b'I' => Reply::SetupInputs { recipe: reader.u8("recipe id")?, offers: offers(&mut reader)? },
            b'S' => Reply::Start(reader.bool("accepted")?),
            b'P' => Reply::Pause(reader.bool("accepted")?),
            b'U' => {
                let recipe = recipe_id(version, &mut reader)?;
                Reply::Data { recipe, payload: reader.rest().to_vec() }
            }
            found => return Err(WireError::UnknownType { found }),
        };
        reader.finish()?;
        Ok(reply)
    }
}

fn recipe_id(version: Version, reader: &mut Reader) -> Result<u8, WireError> {
    match version {
        Version::V1 => Ok(1),
        Version::V2 => reader.u8("recipe id"),
    }
}

/// Without a trailing comma: a wide-spread client raises on an empty token.
fn tokens(offers: &[Offer]) -> String {
    offers.iter().map(|offer| offer.token()).collect::<Vec<_>>().join(",")
}

fn offers(reader: &mut Reader) -> Result<Vec<Offer>, WireError> {
    let offset = reader.offset();
    let text = reader.rest_text();
    if text.is_empty() {
        // The answer to a request that names nothing.
        return Ok(Vec::new());
    }
    let unknown = |token: &str| WireError::Unexpected {
        field: "variable type",
        offset,
        found: format!("{:?}", cut_text(token, 40)),
        expected: "a type of the RTDE guide, NOT_FOUND or IN_USE",
    };
    text.split(',').map(|token| Offer::from_token(token).ok_or_else(|| unknown(token))).collect()
}

#[cfg(test)]
mod tests;
