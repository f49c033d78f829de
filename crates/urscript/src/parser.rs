//! Tokens to syntax tree: the parser's frame and its expressions (statements are in [`super::statement`]).
//!
//! In: text. Out: [`Script`], or the first error with line and column. Statement ends are found by grammar
//! alone: an expression ends where the next token cannot continue it, across lines too, and `(`, `[`, `-`
//! and `+` always continue. Precedence, loosest first: `or`/`xor`, `and`, `not`, comparison, `+ -`, `* / %`,
//! sign and `!`, then calls, indices, members and methods. Nesting is bounded by [`MAX_NESTING`].

use crate::ast::{Argument, Binary, Expression, ExpressionKind, MAX_HEIGHT, Script, Unary};
use crate::fault::{CompileError, Position};
use crate::lexer::{Keyword, Located, Symbol, Token, tokens};
use std::sync::Arc;

/// Deepest nesting of brackets and blocks that is accepted.
pub const MAX_NESTING: u32 = 100;

/// Parses one upload.
///
/// # Errors
/// The text is not URScript, or it is nested too deep. The error has the place of the first fault.
pub fn parse(text: &str) -> Result<Script, CompileError> {
    let mut parser = Parser { tokens: tokens(text)?, next: 0, nesting: 0 };
    parser.script()
}

/// Recursive descent over the tokens of one upload.
pub(crate) struct Parser {
    tokens: Vec<Located>,
    next: usize,
    nesting: u32,
}

const LEVEL_OR: u8 = 1;
const LEVEL_NOT: u8 = 3;
const LEVEL_SIGN: u8 = 7;

/// Operator and how tightly it binds.
fn binary_operator(token: &Token) -> Option<(Binary, u8)> {
    Some(match token {
        Token::Keyword(Keyword::Or) => (Binary::Or, LEVEL_OR),
        Token::Keyword(Keyword::Xor) => (Binary::Xor, LEVEL_OR),
        Token::Keyword(Keyword::And) => (Binary::And, 2),
        Token::Symbol(Symbol::Equal) => (Binary::Equal, 4),
        Token::Symbol(Symbol::NotEqual) => (Binary::NotEqual, 4),
        Token::Symbol(Symbol::Less) => (Binary::Less, 4),
        Token::Symbol(Symbol::LessEqual) => (Binary::LessEqual, 4),
        Token::Symbol(Symbol::Greater) => (Binary::Greater, 4),
        Token::Symbol(Symbol::GreaterEqual) => (Binary::GreaterEqual, 4),
        Token::Symbol(Symbol::Plus) => (Binary::Add, 5),
        Token::Symbol(Symbol::Minus) => (Binary::Subtract, 5),
        Token::Symbol(Symbol::Times) => (Binary::Multiply, 6),
        Token::Symbol(Symbol::Divide) => (Binary::Divide, 6),
        Token::Symbol(Symbol::Modulo) => (Binary::Modulo, 6),
        _ => return None,
    })
}

impl Parser {
    /// The token `ahead` places further on.
    pub(crate) fn peek(&self, ahead: usize) -> &Token {
        static END: Token = Token::EndOfText;
        self.tokens.get(self.next + ahead).map_or(&END, |located| &located.token)
    }

    /// Where the next token begins.
    pub(crate) fn here(&self) -> Position {
        self.tokens.get(self.next).or(self.tokens.last()).map_or(Position::START, |located| located.at)
    }

    /// Line on which the token before the next one begins.
    pub(crate) fn previous_line(&self) -> u32 {
        let previous = self.next.checked_sub(1).and_then(|index| self.tokens.get(index));
        previous.map_or(0, |located| located.at.line)
    }

    /// Takes the next token.
    pub(crate) fn advance(&mut self) -> Token {
        let token = self.peek(0).clone();
        self.next += 1;
        token
    }

    /// The parser's position, for [`Parser::rewind`].
    pub(crate) fn mark(&self) -> usize {
        self.next
    }

    /// Goes back to a mark.
    pub(crate) fn rewind(&mut self, mark: usize) {
        self.next = mark;
    }

    /// Takes the next token if it is this symbol.
    pub(crate) fn accept(&mut self, symbol: Symbol) -> bool {
        let found = *self.peek(0) == Token::Symbol(symbol);
        self.next += usize::from(found);
        found
    }

    /// Takes the next token if it is this keyword.
    pub(crate) fn accept_keyword(&mut self, keyword: Keyword) -> bool {
        let found = *self.peek(0) == Token::Keyword(keyword);
        self.next += usize::from(found);
        found
    }

    /// An error at the next token, which is named.
    pub(crate) fn unexpected(&self, wanted: &str) -> CompileError {
        CompileError::syntax(self.here(), format!("expected {wanted}, found {}", self.peek(0)))
    }

    /// Takes this symbol or fails.
    pub(crate) fn expect(&mut self, symbol: Symbol) -> Result<(), CompileError> {
        if self.accept(symbol) { Ok(()) } else { Err(self.unexpected(&format!("`{}`", symbol.text()))) }
    }

    /// Takes a name or fails.
    pub(crate) fn expect_name(&mut self, what: &str) -> Result<Arc<str>, CompileError> {
        let Token::Name(name) = self.peek(0) else { return Err(self.unexpected(what)) };
        let name = name.clone();
        self.next += 1;
        Ok(name)
    }

    /// Takes the name of a member, which may be spelt like a keyword: `time().sec`.
    fn member_name(&mut self) -> Result<Arc<str>, CompileError> {
        if let Token::Keyword(keyword) = self.peek(0) {
            let name = keyword.text().into();
            self.next += 1;
            return Ok(name);
        }
        self.expect_name("the name of a member")
    }

    /// Runs `inner` one level deeper.
    pub(crate) fn nested<T>(
        &mut self,
        inner: impl FnOnce(&mut Parser) -> Result<T, CompileError>,
    ) -> Result<T, CompileError> {
        if self.nesting >= MAX_NESTING {
            return Err(CompileError::syntax(
                self.here(),
                format!("nested deeper than {MAX_NESTING} levels"),
            ));
        }
        self.nesting += 1;
        let result = inner(self);
        self.nesting -= 1;
        result
    }

    /// One expression.
    pub(crate) fn expression(&mut self) -> Result<Expression, CompileError> {
        self.expression_from(LEVEL_OR)
    }

    fn expression_from(&mut self, level: u8) -> Result<Expression, CompileError> {
        let mut left = self.nested(Parser::operand)?;
        while let Some((operator, binds)) = binary_operator(self.peek(0)).filter(|&(_, binds)| binds >= level)
        {
            let at = self.here();
            self.next += 1;
            let right = self.expression_from(binds + 1)?;
            let kind = ExpressionKind::Binary(operator, Box::new(left), Box::new(right));
            left = self.build(kind, at)?;
        }
        Ok(left)
    }

    /// A sign, `not` or `!` with what it applies to, or a postfix expression.
    fn operand(&mut self) -> Result<Expression, CompileError> {
        let at = self.here();
        let (operator, level) = match self.peek(0) {
            Token::Keyword(Keyword::Not) => (Unary::Not, LEVEL_NOT),
            Token::Symbol(Symbol::Bang) => (Unary::Not, LEVEL_SIGN),
            Token::Symbol(Symbol::Minus) => (Unary::Negate, LEVEL_SIGN),
            Token::Symbol(Symbol::Plus) => (Unary::Plus, LEVEL_SIGN),
            _ => return self.postfix(),
        };
        self.next += 1;
        let operand = self.expression_from(level)?;
        self.build(ExpressionKind::Unary(operator, Box::new(operand)), at)
    }

    /// A primary followed by indices, members and methods.
    pub(crate) fn postfix(&mut self) -> Result<Expression, CompileError> {
        let mut expression = self.primary()?;
        loop {
            let at = self.here();
            if self.accept(Symbol::OpenList) {
                let indices = self.list_after_open(Symbol::CloseList)?;
                if indices.is_empty() {
                    return Err(CompileError::syntax(at, "an index is missing between `[` and `]`"));
                }
                expression = self.build(ExpressionKind::Index(Box::new(expression), indices), at)?;
            } else if self.accept(Symbol::Dot) {
                let name = self.member_name()?;
                let of = Box::new(expression);
                let kind = if self.accept(Symbol::Open) {
                    ExpressionKind::Method { of, name, arguments: self.list_after_open(Symbol::Close)? }
                } else {
                    ExpressionKind::Member(of, name)
                };
                expression = self.build(kind, at)?;
            } else {
                return Ok(expression);
            }
        }
    }

    fn primary(&mut self) -> Result<Expression, CompileError> {
        let at = self.here();
        let kind = match self.peek(0).clone() {
            Token::Int(value) => self.taken(ExpressionKind::Int(value)),
            Token::Float(value) => self.taken(ExpressionKind::Float(value)),
            Token::Text(text) => self.taken(ExpressionKind::Text(text)),
            Token::Keyword(Keyword::True) => self.taken(ExpressionKind::Bool(true)),
            Token::Keyword(Keyword::False) => self.taken(ExpressionKind::Bool(false)),
            Token::Keyword(Keyword::Run) => {
                self.next += 1;
                let name = self.expect_name("the name of a thread after `run`")?;
                self.expect(Symbol::Open)?;
                ExpressionKind::Run { name, arguments: self.arguments()? }
            }
            Token::Name(name) if *self.peek(1) == Token::Symbol(Symbol::Open) => {
                self.next += 2;
                ExpressionKind::Call { name, arguments: self.arguments()? }
            }
            Token::Name(name) if &*name == "p" && *self.peek(1) == Token::Symbol(Symbol::OpenList) => {
                return self.pose_or_index(at);
            }
            Token::Name(name) => self.taken(ExpressionKind::Name(name)),
            Token::Symbol(Symbol::Open) => {
                self.next += 1;
                let inner = self.expression()?;
                self.expect(Symbol::Close)?;
                return Ok(inner);
            }
            Token::Symbol(Symbol::OpenList) => {
                self.next += 1;
                ExpressionKind::List(self.list_after_open(Symbol::CloseList)?)
            }
            _ => return Err(self.unexpected("an expression")),
        };
        self.build(kind, at)
    }

    /// `p[...]`: a pose literal with six expressions, else an index into a variable that is called `p`.
    fn pose_or_index(&mut self, at: Position) -> Result<Expression, CompileError> {
        self.next += 2;
        let elements = self.list_after_open(Symbol::CloseList)?;
        let kind = match elements.len() {
            6 => ExpressionKind::Pose(elements),
            1 | 2 => {
                let variable = Expression::new(ExpressionKind::Name("p".into()), at);
                ExpressionKind::Index(Box::new(variable), elements)
            }
            count => {
                return Err(CompileError::syntax(at, format!("a pose has 6 elements, this one has {count}")));
            }
        };
        self.build(kind, at)
    }

    /// Expressions up to `close`, the opening bracket being taken already.
    fn list_after_open(&mut self, close: Symbol) -> Result<Vec<Expression>, CompileError> {
        let mut elements = Vec::new();
        if self.accept(close) {
            return Ok(elements);
        }
        loop {
            elements.push(self.expression()?);
            if !self.accept(Symbol::Comma) {
                self.expect(close)?;
                return Ok(elements);
            }
        }
    }

    /// Call arguments after `(`: by position first, then by name.
    fn arguments(&mut self) -> Result<Vec<Argument>, CompileError> {
        let mut arguments: Vec<Argument> = Vec::new();
        if self.accept(Symbol::Close) {
            return Ok(arguments);
        }
        loop {
            let name = match (self.peek(0), self.peek(1)) {
                (Token::Name(name), Token::Symbol(Symbol::Assign)) => Some(name.clone()),
                _ => None,
            };
            if name.is_some() {
                self.next += 2;
            } else if arguments.last().is_some_and(|last| last.name.is_some()) {
                return Err(self.unexpected("a named argument (arguments by position come first)"));
            }
            arguments.push(Argument { name, value: self.expression()? });
            if !self.accept(Symbol::Comma) {
                self.expect(Symbol::Close)?;
                return Ok(arguments);
            }
        }
    }

    fn taken(&mut self, kind: ExpressionKind) -> ExpressionKind {
        self.next += 1;
        kind
    }

    fn build(&self, kind: ExpressionKind, at: Position) -> Result<Expression, CompileError> {
        let expression = Expression::new(kind, at);
        if expression.height > MAX_HEIGHT {
            return Err(CompileError::syntax(at, format!("expression of more than {MAX_HEIGHT} levels")));
        }
        Ok(expression)
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// An expression in fully bracketed form.
    pub(crate) fn show(expression: &Expression) -> String {
        let all = |parts: &[Expression]| parts.iter().map(show).collect::<Vec<_>>().join(", ");
        let args = |arguments: &[Argument]| {
            let one = |a: &Argument| match &a.name {
                Some(name) => format!("{name}={}", show(&a.value)),
                None => show(&a.value),
            };
            arguments.iter().map(one).collect::<Vec<_>>().join(", ")
        };
        match &expression.kind {
            ExpressionKind::Int(value) => value.to_string(),
            ExpressionKind::Float(value) => format!("{value:?}"),
            ExpressionKind::Bool(value) => value.to_string(),
            ExpressionKind::Text(text) => format!("{text:?}"),
            ExpressionKind::Name(name) => name.to_string(),
            ExpressionKind::List(parts) => format!("[{}]", all(parts)),
            ExpressionKind::Pose(parts) => format!("pose[{}]", all(parts)),
            ExpressionKind::Index(of, indices) => format!("{}[{}]", show(of), all(indices)),
            ExpressionKind::Member(of, name) => format!("{}.{name}", show(of)),
            ExpressionKind::Call { name, arguments } => format!("{name}({})", args(arguments)),
            ExpressionKind::Method { of, name, arguments } => {
                format!("{}.{name}({})", show(of), all(arguments))
            }
            ExpressionKind::Run { name, arguments } => format!("run {name}({})", args(arguments)),
            ExpressionKind::Unary(operator, of) => format!("({operator:?} {})", show(of)),
            ExpressionKind::Binary(operator, a, b) => format!("({} {operator:?} {})", show(a), show(b)),
        }
    }

    #[track_caller]
    fn check(text: &str, expected: &str) {
        let mut parser = Parser { tokens: tokens(text).unwrap(), next: 0, nesting: 0 };
        let expression = parser.expression().unwrap();
        assert_eq!(*parser.peek(0), Token::EndOfText, "{text:?} was not read to its end");
        assert_eq!(show(&expression), expected, "{text:?}");
    }

    #[track_caller]
    fn check_refused(text: &str, line: u32, column: u32, message: &str) {
        let error = parse(text).unwrap_err();
        assert_eq!(error.at, Position { line, column }, "{error}");
        assert!(error.to_string().contains(message), "{error} lacks {message:?}");
    }

    #[test]
    fn precedence() {
        check("1 + 2 * 3", "(1 Add (2 Multiply 3))");
        check("1 - 2 - 3", "((1 Subtract 2) Subtract 3)");
        check("-a * b", "((Negate a) Multiply b)");
        check("a - -b", "(a Subtract (Negate b))");
        check("not a == b and c", "((Not (a Equal b)) And c)");
        check("a or b and c xor d", "((a Or (b And c)) Xor d)");
        check("a < b + 1", "(a Less (b Add 1))");
        check("(a\n or\n b)", "(a Or b)");
        check("a % 2 == 0", "((a Modulo 2) Equal 0)");
    }

    #[test]
    fn poses_lists_indices_and_calls() {
        check("p[1,2,3,4,5,6]", "pose[1, 2, 3, 4, 5, 6]");
        check("p[0]", "p[0]");
        check("p [1, 2]", "p[1, 2]");
        check("p", "p");
        check("m[i, j][0]", "m[i, j][0]");
        check("[[1,2],[3,4]]", "[[1, 2], [3, 4]]");
        check("[]", "[]");
        check("s.a.b[1]", "s.a.b[1]");
        check("movej(q, a=1.2, v=0.5)", "movej(q, a=1.2, v=0.5)");
        check("f(a == b)", "f((a Equal b))");
        check("run worker()", "run worker()");
        check("f(x)[2] + 1", "(f(x)[2] Add 1)");
        check("p_a[0] + p[1]", "(p_a[0] Add p[1])");
        check("a.b[1].append(c, 2).length() + 1", "(a.b[1].append(c, 2).length() Add 1)");
        check("! a.b() == c", "((Not a.b()) Equal c)");
        check("time().sec + t.end", "(time().sec Add t.end)");
    }

    #[test]
    fn errors_name_the_place() {
        check_refused("x = ", 1, 5, "expected an expression, found the end");
        check_refused("x = p[1,2,3]", 1, 5, "has 3");
        check_refused("def f():\n  x = (1\nend\n", 3, 1, "expected `)`");
        check_refused("movej(a=1, 2)", 1, 12, "named argument");
        check_refused("x[] = 1", 1, 2, "index is missing");
    }

    #[test]
    fn towers_are_refused_not_fatal() {
        for text in [
            format!("x = {}1{}", "(".repeat(100_000), ")".repeat(100_000)),
            format!("x = {}1", "-".repeat(100_000)),
            format!("x = {}1", "not ".repeat(100_000)),
            format!("x = 1{}", "+1".repeat(100_000)),
            format!("x = a{}", "[0]".repeat(100_000)),
            format!("x = {}", "[".repeat(100_000)),
            "if 1:\n".repeat(100_000),
            "def f():\n".repeat(100_000),
            format!("x = {}", "f(".repeat(100_000)),
        ] {
            let error = parse(&text).unwrap_err().to_string();
            assert!(error.contains("nested deeper") || error.contains("levels"), "{error}");
        }
    }

    proptest! {
        #[test]
        fn any_text_is_parsed_or_refused(text in "\\PC{0,80}") {
            let _ = parse(&text);
        }

        #[test]
        fn any_mix_of_tokens_is_parsed_or_refused(words in proptest::collection::vec(
            proptest::sample::select(vec![
                "def", "f", "(", ")", ":", "end", "if", "elif", "else", "while", "x", "=", "p", "[", "]", ",",
                "1", "2.5", "\"s\"", "not", "-", "+", "*", "==", "and", "run", "kill", "join", "return",
                "thread", "global", "local", "enter_critical", "exit_critical", "halt", ".", "True", "\n", "pause", "!",
            ]), 0..60)) {
            let _ = parse(&words.join(" "));
        }
    }
}
