//! Tokens to syntax tree: statements, functions and the whole upload (expressions are in
//! [`super::parser`]).
//!
//! In: the parser's tokens. Out: statements with positions. `return` is the one place that looks at lines:
//! what is on its line is its value; on a later line only what cannot be a statement is, because nothing
//! else distinguishes `return` followed by a call from a returned call.

use crate::ast::{
    Expression, ExpressionKind, Function, FunctionKind, Parameter, Qualifier, Script, Statement,
    StatementKind,
};
use crate::fault::{CompileError, Position};
use crate::lexer::{Keyword, Symbol, Token};
use crate::parser::Parser;

/// Name of a program that was sent as loose statements.
pub const UNNAMED: &str = "unnamed";

impl Parser {
    /// A whole upload: one `def` or `sec`, or statements.
    pub(crate) fn script(&mut self) -> Result<Script, CompileError> {
        let at = self.here();
        let mut body = Vec::new();
        while *self.peek(0) != Token::EndOfText {
            body.push(self.statement()?);
        }
        if let [Statement { kind: StatementKind::Function(function), .. }] = body.as_slice()
            && function.kind != FunctionKind::Thread
        {
            return Ok(Script { main: function.clone(), named: true });
        }
        let main =
            Function { name: UNNAMED.into(), kind: FunctionKind::Def, parameters: Vec::new(), body, at };
        Ok(Script { main, named: false })
    }

    /// Statements up to `end`, `elif`, `else` or the end of the text, none of which is taken.
    fn block(&mut self) -> Result<Vec<Statement>, CompileError> {
        self.nested(|parser| {
            let mut statements = Vec::new();
            while !matches!(
                parser.peek(0),
                Token::Keyword(Keyword::End | Keyword::Elif | Keyword::Else) | Token::EndOfText
            ) {
                statements.push(parser.statement()?);
            }
            Ok(statements)
        })
    }

    fn end(&mut self, of: &str, opened: Position) -> Result<(), CompileError> {
        if self.accept_keyword(Keyword::End) {
            return Ok(());
        }
        Err(self.unexpected(&format!("`end` of the {of} of line {}", opened.line)))
    }

    fn statement(&mut self) -> Result<Statement, CompileError> {
        let at = self.here();
        let kind = match self.peek(0) {
            Token::Keyword(keyword) => {
                let keyword = *keyword;
                self.keyword_statement(keyword, at)?
            }
            Token::Name(_) => self.assignment_or_call(Qualifier::Plain)?,
            _ => return Err(self.unexpected("a statement")),
        };
        Ok(Statement { kind, at })
    }

    fn keyword_statement(&mut self, keyword: Keyword, at: Position) -> Result<StatementKind, CompileError> {
        if keyword == Keyword::Run {
            return Ok(StatementKind::Expression(self.postfix()?));
        }
        let refused = self.unexpected("a statement");
        self.advance();
        Ok(match keyword {
            Keyword::Def | Keyword::Sec | Keyword::Thread => {
                let kind = FunctionKind::from_keyword(keyword).ok_or(refused)?;
                StatementKind::Function(self.function(kind, at)?)
            }
            Keyword::If => self.conditional(at)?,
            Keyword::While => {
                let condition = self.expression()?;
                self.expect(Symbol::Colon)?;
                let body = self.block()?;
                self.end("while", at)?;
                StatementKind::While { condition, body }
            }
            Keyword::Global => self.assignment_or_call(Qualifier::Global)?,
            Keyword::Local => self.assignment_or_call(Qualifier::Local)?,
            Keyword::Return => StatementKind::Return(self.returned()?),
            Keyword::Kill => StatementKind::Kill(self.expression()?),
            Keyword::Join => StatementKind::Join(self.expression()?),
            Keyword::Break => StatementKind::Break,
            Keyword::Continue => StatementKind::Continue,
            Keyword::Halt => StatementKind::Halt,
            Keyword::Pause => StatementKind::Pause,
            Keyword::EnterCritical => StatementKind::EnterCritical,
            Keyword::ExitCritical => StatementKind::ExitCritical,
            Keyword::Pass => StatementKind::Pass,
            Keyword::And
            | Keyword::Elif
            | Keyword::Else
            | Keyword::End
            | Keyword::False
            | Keyword::Not
            | Keyword::Or
            | Keyword::Run
            | Keyword::True
            | Keyword::Xor => return Err(refused),
        })
    }

    /// After `def`, `sec` or `thread`.
    fn function(&mut self, kind: FunctionKind, at: Position) -> Result<Function, CompileError> {
        let name = self.expect_name("the function's name")?;
        self.expect(Symbol::Open)?;
        let mut parameters: Vec<Parameter> = Vec::new();
        while !self.accept(Symbol::Close) {
            if !parameters.is_empty() {
                self.expect(Symbol::Comma)?;
            }
            let here = self.here();
            let name = self.expect_name("a parameter's name")?;
            if parameters.iter().any(|parameter| parameter.name == name) {
                return Err(CompileError::syntax(here, format!("parameter `{name}` is there twice")));
            }
            let default = if self.accept(Symbol::Assign) { Some(self.expression()?) } else { None };
            parameters.push(Parameter { name, default });
        }
        self.expect(Symbol::Colon)?;
        let body = self.block()?;
        self.end(&format!("function `{name}`"), at)?;
        Ok(Function { name, kind, parameters, body, at })
    }

    /// After `if`.
    fn conditional(&mut self, at: Position) -> Result<StatementKind, CompileError> {
        let mut arms = Vec::new();
        let mut otherwise = Vec::new();
        loop {
            let condition = self.expression()?;
            self.expect(Symbol::Colon)?;
            arms.push((condition, self.block()?));
            if self.accept_keyword(Keyword::Elif) {
                continue;
            }
            if self.accept_keyword(Keyword::Else) {
                self.expect(Symbol::Colon)?;
                otherwise = self.block()?;
            }
            self.end("if", at)?;
            return Ok(StatementKind::If { arms, otherwise });
        }
    }

    fn assignment_or_call(&mut self, qualifier: Qualifier) -> Result<StatementKind, CompileError> {
        let expression = self.postfix()?;
        if !self.accept(Symbol::Assign) {
            if qualifier == Qualifier::Plain
                && matches!(expression.kind, ExpressionKind::Call { .. } | ExpressionKind::Method { .. })
            {
                return Ok(StatementKind::Expression(expression));
            }
            return Err(self.unexpected("`=` (only a call may stand alone)"));
        }
        let Some((name, path)) = expression.as_place() else {
            return Err(CompileError::syntax(expression.at, "this cannot be assigned to"));
        };
        let value = self.expression()?;
        Ok(StatementKind::Assign { qualifier, name, path, value })
    }

    /// The value after `return`, if there is one.
    fn returned(&mut self) -> Result<Option<Expression>, CompileError> {
        let begins = match self.peek(0) {
            Token::Int(_) | Token::Float(_) | Token::Text(_) | Token::Name(_) => true,
            Token::Keyword(keyword) => {
                matches!(keyword, Keyword::True | Keyword::False | Keyword::Not | Keyword::Run)
            }
            Token::Symbol(symbol) => {
                matches!(symbol, Symbol::Open | Symbol::OpenList | Symbol::Minus | Symbol::Plus)
            }
            Token::EndOfText => false,
        };
        if !begins {
            return Ok(None);
        }
        if self.here().line == self.previous_line() {
            return Ok(Some(self.expression()?));
        }
        let statement = match self.peek(0) {
            Token::Keyword(Keyword::Run) => true,
            Token::Name(_) => *self.peek(1) == Token::Symbol(Symbol::Open) || self.assignment_follows(),
            _ => false,
        };
        if statement { Ok(None) } else { Ok(Some(self.expression()?)) }
    }

    fn assignment_follows(&mut self) -> bool {
        let mark = self.mark();
        let found = self.postfix().is_ok() && *self.peek(0) == Token::Symbol(Symbol::Assign);
        self.rewind(mark);
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ast::Accessor;
    use crate::parser::parse;
    use crate::parser::tests::show;

    fn outline(statements: &[Statement]) -> String {
        let one = |statement: &Statement| match &statement.kind {
            StatementKind::Assign { name, path, value, qualifier } => {
                let path: Vec<String> = path
                    .iter()
                    .map(|accessor| match accessor {
                        Accessor::Index(index) => format!("[{}]", show(index)),
                        Accessor::Member(member) => format!(".{member}"),
                    })
                    .collect();
                format!("{qualifier:?} {name}{} = {}", path.concat(), show(value))
            }
            StatementKind::Expression(expression) => show(expression),
            StatementKind::If { arms, otherwise } => {
                let arms: Vec<String> =
                    arms.iter().map(|(c, b)| format!("{} {{{}}}", show(c), outline(b))).collect();
                format!("if {} else {{{}}}", arms.join(" elif "), outline(otherwise))
            }
            StatementKind::While { condition, body } => {
                format!("while {} {{{}}}", show(condition), outline(body))
            }
            StatementKind::Return(Some(value)) => format!("return {}", show(value)),
            StatementKind::Return(None) => "return".to_owned(),
            StatementKind::Kill(value) => format!("kill {}", show(value)),
            StatementKind::Join(value) => format!("join {}", show(value)),
            StatementKind::Function(function) => {
                format!("{:?} {} {{{}}}", function.kind, function.name, outline(&function.body))
            }
            other => format!("{other:?}"),
        };
        statements.iter().map(one).collect::<Vec<_>>().join("; ")
    }

    #[track_caller]
    fn check(text: &str, expected: &str) {
        assert_eq!(outline(&parse(text).unwrap().main.body), expected, "{text:?}");
    }

    #[test]
    fn newlines_are_white_space() {
        check("global A = \n0   global B = \n0  global C = 2", "Global A = 0; Global B = 0; Global C = 2");
        check("x = 1 y = 2\nz\n=\n3", "Plain x = 1; Plain y = 2; Plain z = 3");
        check("x = a\n- b", "Plain x = (a Subtract b)");
        check("sync() textmsg(1)", "sync(); textmsg(1)");
        check("a = f\n(x)", "Plain a = f(x)");
    }

    #[test]
    fn assignments_reach_into_values() {
        check("x[1] = 2", "Plain x[1] = 2");
        check("x.append(2) s.a.clear() pause", "x.append(2); s.a.clear(); Pause");
        check("m[i, j] = 2", "Plain m[i][j] = 2");
        check("m[i][j] = 2", "Plain m[i][j] = 2");
        check("s.a[1] = 2", "Plain s.a[1] = 2");
        check("p[0] = 1 p = p[1,2,3,4,5,6]", "Plain p[0] = 1; Plain p = pose[1, 2, 3, 4, 5, 6]");
        check("local q = p[3]", "Local q = p[3]");
    }

    #[test]
    fn control_flow() {
        check("if a: b() elif c: d() else: e() end", "if a {b()} elif c {d()} else {e()}");
        check("if (a\n  or b): if c: d() end end", "if (a Or b) {if c {d()} else {}} else {}");
        check("while True: break continue end", "while true {Break; Continue}");
        check("h = run w() kill h join h halt", "Plain h = run w(); kill h; join h; Halt");
        check("enter_critical x = 1 exit_critical", "EnterCritical; Plain x = 1; ExitCritical");
        check("def f():\nthread t(): sync() end\nend", "Thread t {sync()}");
    }

    #[test]
    fn return_takes_its_line_or_what_is_no_statement() {
        check("return x + 1", "return (x Add 1)");
        check("return f(1)", "return f(1)");
        check("if a: return end", "if a {return} else {}");
        check("return\nx = 1", "return; Plain x = 1");
        check("return\nx[0] = 1", "return; Plain x[0] = 1");
        check("return\nf(1)", "return; f(1)");
        check("return\n0", "return 0");
        check("return\nx", "return x");
        check("return if a: b() end", "return; if a {b()} else {}");
    }

    #[test]
    fn the_first_function_names_the_program() {
        let script = parse("# comment\n\ndef prog(a=1):\n  x = 1\nend\n").unwrap();
        assert!(script.named && &*script.main.name == "prog");
        assert_eq!(parse("sec s(): set_tcp(p[0,0,0,0,0,0]) end").unwrap().main.kind, FunctionKind::Sec);
        assert!(!parse("textmsg(1)").unwrap().named);
    }

    #[test]
    fn what_is_no_statement_is_refused() {
        for text in ["x", "1", "x + 1", "end", "def f(): x = 1", "def f(a, a): end", "global f()", "f() = 1"]
        {
            assert!(parse(text).is_err(), "{text:?} was accepted");
        }
    }
}
