//! Cuts a script's text into tokens with line and column.
//!
//! In: text. Out: tokens, the last of which is [`Token::EndOfText`]. Newlines and indentation are white
//! space: real uploads break lines inside statements and put several statements on one line, so nothing
//! after this step may depend on lines but error messages (and the one rule for `return`, see the parser).
//! Lines that begin with `$` are labels of the program tree, which PolyScope writes into the scripts it
//! saves. Strings know no escapes, as in the classic language; they end on the line they start on.

use crate::fault::{CompileError, Position};
use std::iter::Peekable;
use std::str::Chars;
use std::sync::Arc;

/// One lexical unit.
#[derive(Clone, Debug, PartialEq)]
pub enum Token {
    /// An identifier that is no keyword.
    Name(Arc<str>),
    /// A whole number that fits 32 bits.
    Int(i32),
    /// Any other number.
    Float(f64),
    /// A string without its quotes.
    Text(Arc<str>),
    /// A reserved word.
    Keyword(Keyword),
    /// An operator or bracket.
    Symbol(Symbol),
    /// After the last token.
    EndOfText,
}

impl std::fmt::Display for Token {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Token::Name(name) => write!(f, "`{name}`"),
            Token::Int(value) => write!(f, "`{value}`"),
            Token::Float(value) => write!(f, "`{value}`"),
            Token::Text(text) => write!(f, "string \"{text}\""),
            Token::Keyword(keyword) => write!(f, "`{}`", keyword.text()),
            Token::Symbol(symbol) => write!(f, "`{}`", symbol.text()),
            Token::EndOfText => f.write_str("the end of the text"),
        }
    }
}

/// A token and where it begins.
#[derive(Clone, Debug, PartialEq)]
pub struct Located {
    /// The token.
    pub token: Token,
    /// Its first character.
    pub at: Position,
}

/// Declares a fieldless enum together with the text of each of its values.
macro_rules! words {
    ($(#[$doc:meta])* $name:ident { $($variant:ident = $text:literal),* $(,)? }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[allow(missing_docs)]
        pub enum $name { $($variant),* }

        impl $name {
            /// All values.
            pub const ALL: &'static [$name] = &[$($name::$variant),*];

            /// As written in a script.
            pub const fn text(self) -> &'static str {
                match self { $($name::$variant => $text),* }
            }
        }
    };
}

words! {
    /// Reserved words. There is no `for`; words such as `async`, `time` or `p` are ordinary names.
    Keyword {
        And = "and", Break = "break", Continue = "continue", Def = "def", Elif = "elif", Else = "else",
        End = "end", EnterCritical = "enter_critical", ExitCritical = "exit_critical", False = "False",
        Global = "global", Halt = "halt", If = "if", Join = "join", Kill = "kill", Local = "local",
        Not = "not", Or = "or", Pass = "pass", Pause = "pause", Return = "return", Run = "run", Sec = "sec",
        Thread = "thread", True = "True", While = "while", Xor = "xor",
    }
}

words! {
    /// Operators and brackets, longer ones first so that the first match is the right one.
    Symbol {
        Equal = "==", NotEqual = "!=", LessEqual = "<=", GreaterEqual = ">=", Less = "<", Greater = ">",
        Assign = "=", Plus = "+", Minus = "-", Times = "*", Divide = "/", Modulo = "%", Open = "(",
        Close = ")", OpenList = "[", CloseList = "]", Comma = ",", Colon = ":", Dot = ".", Bang = "!",
    }
}

/// All tokens of `text`.
///
/// # Errors
/// A character begins no token, a number has no digits or is too large, or a string is not closed on its
/// line.
pub fn tokens(text: &str) -> Result<Vec<Located>, CompileError> {
    let mut lexer = Lexer { rest: text.chars().peekable(), here: Position::START };
    let mut found = Vec::new();
    loop {
        lexer.skip_white_space();
        let at = lexer.here;
        let token = lexer.token()?;
        let done = token == Token::EndOfText;
        found.push(Located { token, at });
        if done {
            return Ok(found);
        }
    }
}

struct Lexer<'a> {
    rest: Peekable<Chars<'a>>,
    here: Position,
}

impl Lexer<'_> {
    fn peek(&mut self) -> Option<char> {
        self.rest.peek().copied()
    }

    fn next(&mut self) -> Option<char> {
        let c = self.rest.next()?;
        if c == '\n' {
            self.here = Position { line: self.here.line.saturating_add(1), column: 1 };
        } else {
            self.here.column = self.here.column.saturating_add(1);
        }
        Some(c)
    }

    fn take_while(&mut self, into: &mut String, keep: impl Fn(char) -> bool) {
        while let Some(c) = self.peek().filter(|&c| keep(c)) {
            into.push(c);
            self.next();
        }
    }

    fn skip_white_space(&mut self) {
        let mut line_begins = self.here.column == 1;
        while let Some(c) = self.peek() {
            if c == '#' || (c == '$' && line_begins) {
                while self.peek().is_some_and(|c| c != '\n') {
                    self.next();
                }
            } else if c == '\n' {
                line_begins = true;
                self.next();
            } else if c.is_whitespace() || c == ';' || c == '\u{feff}' {
                self.next();
            } else {
                return;
            }
        }
    }

    fn token(&mut self) -> Result<Token, CompileError> {
        match self.peek() {
            None => Ok(Token::EndOfText),
            Some(c) if c.is_ascii_alphabetic() || c == '_' => Ok(self.word()),
            Some(c) if c.is_ascii_digit() => self.number(),
            Some('.') if self.digit_after_dot() => self.number(),
            Some(quote @ ('"' | '\'')) => self.string(quote),
            Some(_) => self.symbol(),
        }
    }

    fn digit_after_dot(&self) -> bool {
        let mut ahead = self.rest.clone();
        ahead.next();
        ahead.next().is_some_and(|c| c.is_ascii_digit())
    }

    fn word(&mut self) -> Token {
        let mut word = String::new();
        self.take_while(&mut word, |c| c.is_ascii_alphanumeric() || c == '_');
        match Keyword::ALL.iter().find(|keyword| keyword.text() == word) {
            Some(&keyword) => Token::Keyword(keyword),
            None => Token::Name(word.into()),
        }
    }

    fn number(&mut self) -> Result<Token, CompileError> {
        let at = self.here;
        let mut digits = String::new();
        self.take_while(&mut digits, |c| c.is_ascii_digit());
        if digits == "0" && matches!(self.peek(), Some('x' | 'X')) {
            return self.hexadecimal(at);
        }
        let mut whole = true;
        if self.peek() == Some('.') {
            whole = false;
            digits.push('.');
            self.next();
            self.take_while(&mut digits, |c| c.is_ascii_digit());
        }
        if matches!(self.peek(), Some('e' | 'E')) && self.exponent_follows() {
            whole = false;
            digits.push('e');
            self.next();
            if let Some(sign) = self.peek().filter(|c| matches!(c, '+' | '-')) {
                digits.push(sign);
                self.next();
            }
            self.take_while(&mut digits, |c| c.is_ascii_digit());
        }
        if whole && let Ok(value) = digits.parse::<i32>() {
            return Ok(Token::Int(value));
        }
        match digits.parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(Token::Float(value)),
            _ => Err(CompileError::syntax(at, format!("`{digits}` is not a number"))),
        }
    }

    fn exponent_follows(&self) -> bool {
        let mut ahead = self.rest.clone();
        ahead.next();
        match ahead.next() {
            Some('+' | '-') => ahead.next().is_some_and(|c| c.is_ascii_digit()),
            Some(c) => c.is_ascii_digit(),
            None => false,
        }
    }

    /// Digits after `0x`; 32 bits, the top one being the sign as in the controller's registers.
    fn hexadecimal(&mut self, at: Position) -> Result<Token, CompileError> {
        self.next();
        let mut digits = String::new();
        self.take_while(&mut digits, |c| c.is_ascii_hexdigit());
        match u32::from_str_radix(&digits, 16) {
            Ok(value) => Ok(Token::Int(value as i32)),
            Err(_) => Err(CompileError::syntax(at, format!("`0x{digits}` is not a 32 bit number"))),
        }
    }

    fn string(&mut self, quote: char) -> Result<Token, CompileError> {
        let at = self.here;
        self.next();
        let mut text = String::new();
        self.take_while(&mut text, |c| c != quote && c != '\n');
        if self.next() != Some(quote) {
            return Err(CompileError::syntax(at, "string is not closed on its line"));
        }
        Ok(Token::Text(text.into()))
    }

    fn symbol(&mut self) -> Result<Token, CompileError> {
        let at = self.here;
        let first = self.next().unwrap_or_default();
        let second = self.peek();
        let matches = |symbol: &&Symbol| {
            let mut text = symbol.text().chars();
            text.next() == Some(first) && text.next().is_none_or(|c| Some(c) == second)
        };
        let Some(&symbol) = Symbol::ALL.iter().find(matches) else {
            return Err(CompileError::syntax(at, format!("unexpected character `{}`", first.escape_debug())));
        };
        if symbol.text().len() == 2 {
            self.next();
        }
        Ok(Token::Symbol(symbol))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn check(text: &str, expected: &str) {
        let found: Vec<String> = tokens(text).unwrap().iter().map(|t| t.token.to_string()).collect();
        assert_eq!(found[..found.len() - 1].join(" "), expected, "tokens of {text:?}");
    }

    #[test]
    fn words_numbers_and_symbols() {
        check("a==b", "`a` `==` `b`");
        check("a=b", "`a` `=` `b`");
        check("x<=1.5e3", "`x` `<=` `1500`");
        check("0x10 0xFFFFFFFF", "`16` `-1`");
        check(".5 5.", "`0.5` `5`");
        check("3000000000", "`3000000000`");
        check("async def_ end endx", "`async` `def_` `end` `endx`");
        check("'it' \"is\"", "string \"it\" string \"is\"");
        check("a # b\nc", "`a` `c`");
        check("a\n  $ 2 \"Robot Program\"\nc", "`a` `c`");
        check("2e", "`2` `e`");
        check("a.b", "`a` `.` `b`");
    }

    #[test]
    fn positions_count_from_one() {
        let found = tokens("a\n  bb c").unwrap();
        assert_eq!(found[1].at, Position { line: 2, column: 3 });
        assert_eq!(found[2].at, Position { line: 2, column: 6 });
    }

    #[test]
    fn bad_characters_are_named_with_their_place() {
        assert_eq!(tokens("a\n b $").unwrap_err().at, Position { line: 2, column: 4 });
        assert!(tokens("\"open\nline\"").is_err());
        assert!(tokens("0x").is_err());
        assert!(tokens("1e999").is_err());
    }
}
