//! Where and why a script is wrong: before it runs ([`CompileError`]) and while it runs
//! ([`RuntimeException`]).
//!
//! In: positions from the lexer. Out: values whose text is what the controller reports on the primary
//! interface. Lines and columns count from 1 within the text that was sent, as clients expect that print a
//! caret under the fault.

/// A place in the script's text; both count from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Position {
    /// Line, from 1.
    pub line: u32,
    /// Column in characters, from 1.
    pub column: u32,
}

impl Position {
    /// The first character.
    pub const START: Position = Position { line: 1, column: 1 };
}

impl std::fmt::Display for Position {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}:{}", self.line, self.column)
    }
}

/// What keeps a script from being loaded.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{at}: {kind}")]
pub struct CompileError {
    /// Where.
    pub at: Position,
    /// What.
    pub kind: CompileErrorKind,
}

impl CompileError {
    /// A syntax error at `at`.
    pub fn syntax(at: Position, message: impl Into<String>) -> CompileError {
        CompileError { at, kind: CompileErrorKind::Syntax(message.into()) }
    }

    /// The text of the runtime exception message with which a controller refuses the script; clients match
    /// the two prefixes.
    pub fn controller_text(&self) -> String {
        match &self.kind {
            CompileErrorKind::Syntax(message) => format!("syntax_error_on_line:{}:{message}", self.at.line),
            CompileErrorKind::NameNotFound(name) => format!("compile_error_name_not_found:{name}:"),
            CompileErrorKind::Arguments(message) => format!("compile_error_wrong_arguments:{message}:"),
        }
    }
}

/// The kinds of [`CompileError`].
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CompileErrorKind {
    /// The text is not URScript.
    #[error("syntax error: {0}")]
    Syntax(String),
    /// A name that is no variable, function, thread or built-in.
    #[error("name not found: {0}")]
    NameNotFound(String),
    /// A call whose arguments cannot be matched to the parameters.
    #[error("wrong arguments: {0}")]
    Arguments(String),
}

/// An error while the script runs; it ends the program.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{at}: {message}")]
pub struct RuntimeException {
    /// Where the failing instruction came from.
    pub at: Position,
    /// What went wrong.
    pub message: String,
}
