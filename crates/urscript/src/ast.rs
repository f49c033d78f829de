//! The syntax tree of a script.
//!
//! In: what the parser recognised. Out: plain data with positions. Every expression carries its height, and
//! the parser refuses towers above [`MAX_HEIGHT`], so that walking and dropping a tree cannot exhaust the
//! stack whatever text came over the socket.

use crate::fault::Position;
use crate::lexer::Keyword;
use std::sync::Arc;

/// Tallest expression tree that is accepted.
pub const MAX_HEIGHT: u16 = 300;

/// A whole upload.
#[derive(Clone, Debug, PartialEq)]
pub struct Script {
    /// The program function, or the loose statements wrapped in one.
    pub main: Function,
    /// False for text without a `def` or `sec` around it.
    pub named: bool,
}

/// A `def`, `sec` or `thread`.
#[derive(Clone, Debug, PartialEq)]
pub struct Function {
    /// Its name.
    pub name: Arc<str>,
    /// Which of the three.
    pub kind: FunctionKind,
    /// Parameters in order.
    pub parameters: Vec<Parameter>,
    /// Statements.
    pub body: Vec<Statement>,
    /// Where its keyword is.
    pub at: Position,
}

/// How a function was introduced.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FunctionKind {
    /// `def`
    Def,
    /// `sec`: beside the main program, in one control cycle.
    Sec,
    /// `thread`
    Thread,
}

/// A parameter and its default.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// Its name.
    pub name: Arc<str>,
    /// What an omitted argument counts as.
    pub default: Option<Expression>,
}

/// Which variable an assignment means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Qualifier {
    /// No word: an existing variable of that name, else a new one of the function.
    Plain,
    /// `global`
    Global,
    /// `local`
    Local,
}

/// One statement.
#[derive(Clone, Debug, PartialEq)]
pub struct Statement {
    /// What.
    pub kind: StatementKind,
    /// Where it begins.
    pub at: Position,
}

/// The kinds of statements.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs)]
pub enum StatementKind {
    Assign { qualifier: Qualifier, name: Arc<str>, path: Vec<Accessor>, value: Expression },
    Expression(Expression),
    If { arms: Vec<(Expression, Vec<Statement>)>, otherwise: Vec<Statement> },
    While { condition: Expression, body: Vec<Statement> },
    Break,
    Continue,
    Return(Option<Expression>),
    Halt,
    Pause,
    Kill(Expression),
    Join(Expression),
    EnterCritical,
    ExitCritical,
    Pass,
    Function(Function),
}

/// A step from a variable to a part of it.
#[derive(Clone, Debug, PartialEq)]
pub enum Accessor {
    /// `[i]`; `[i, j]` is two of them.
    Index(Expression),
    /// `.name`
    Member(Arc<str>),
}

/// An expression.
#[derive(Clone, Debug, PartialEq)]
pub struct Expression {
    /// What.
    pub kind: ExpressionKind,
    /// Where (of an operation: its operator).
    pub at: Position,
    /// Levels of expressions below and including this one.
    pub height: u16,
}

/// The kinds of expressions.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs)]
pub enum ExpressionKind {
    Int(i32),
    Float(f64),
    Bool(bool),
    Text(Arc<str>),
    Name(Arc<str>),
    List(Vec<Expression>),
    Pose(Vec<Expression>),
    Index(Box<Expression>, Vec<Expression>),
    Member(Box<Expression>, Arc<str>),
    Call { name: Arc<str>, arguments: Vec<Argument> },
    Method { of: Box<Expression>, name: Arc<str>, arguments: Vec<Expression> },
    Run { name: Arc<str>, arguments: Vec<Argument> },
    Unary(Unary, Box<Expression>),
    Binary(Binary, Box<Expression>, Box<Expression>),
}

/// An argument, by position or by name.
#[derive(Clone, Debug, PartialEq)]
pub struct Argument {
    /// The parameter's name, if given.
    pub name: Option<Arc<str>>,
    /// The value.
    pub value: Expression,
}

/// Operators of one operand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Unary {
    Negate,
    Plus,
    Not,
}

/// Operators of two operands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Binary {
    Add,
    Subtract,
    Multiply,
    Divide,
    Modulo,
    Equal,
    NotEqual,
    Less,
    LessEqual,
    Greater,
    GreaterEqual,
    And,
    Or,
    Xor,
}

impl FunctionKind {
    /// The kind a keyword introduces.
    pub fn from_keyword(keyword: Keyword) -> Option<FunctionKind> {
        match keyword {
            Keyword::Def => Some(FunctionKind::Def),
            Keyword::Sec => Some(FunctionKind::Sec),
            Keyword::Thread => Some(FunctionKind::Thread),
            _ => None,
        }
    }
}

impl Expression {
    /// The variable and the way into it, if this can be assigned to.
    pub fn as_place(&self) -> Option<(Arc<str>, Vec<Accessor>)> {
        let mut path = Vec::new();
        let mut target = self;
        let name = loop {
            match &target.kind {
                ExpressionKind::Name(name) => break name.clone(),
                ExpressionKind::Index(of, indices) => {
                    path.extend(indices.iter().rev().cloned().map(Accessor::Index));
                    target = of;
                }
                ExpressionKind::Member(of, member) => {
                    path.push(Accessor::Member(member.clone()));
                    target = of;
                }
                _ => return None,
            }
        };
        path.reverse();
        Some((name, path))
    }

    /// An expression with its height computed from its parts.
    pub fn new(kind: ExpressionKind, at: Position) -> Expression {
        let tallest = |parts: &[Expression]| parts.iter().map(|part| part.height).max().unwrap_or(0);
        let below = match &kind {
            ExpressionKind::Int(_)
            | ExpressionKind::Float(_)
            | ExpressionKind::Bool(_)
            | ExpressionKind::Text(_)
            | ExpressionKind::Name(_) => 0,
            ExpressionKind::List(parts) | ExpressionKind::Pose(parts) => tallest(parts),
            ExpressionKind::Index(of, parts) | ExpressionKind::Method { of, arguments: parts, .. } => {
                of.height.max(tallest(parts))
            }
            ExpressionKind::Member(of, _) | ExpressionKind::Unary(_, of) => of.height,
            ExpressionKind::Call { arguments, .. } | ExpressionKind::Run { arguments, .. } => {
                arguments.iter().map(|argument| argument.value.height).max().unwrap_or(0)
            }
            ExpressionKind::Binary(_, left, right) => left.height.max(right.height),
        };
        Expression { kind, at, height: below.saturating_add(1) }
    }
}
