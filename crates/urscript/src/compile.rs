//! Syntax tree to instructions: names to slots, calls to functions or built-ins, control flow to jumps.
//!
//! In: text or a [`Script`], and which built-ins the host has. Out: [`Code`], or the first name
//! or argument that does not fit, as the controller checks when it loads a program. Functions of the script
//! hide built-ins of the same name.

use crate::ast::{
    Accessor, Argument, Binary, Expression, ExpressionKind, Function, FunctionKind, Qualifier, Script,
    Statement, StatementKind,
};
use crate::body::Body;
use crate::code::{Code, FunctionCode, Instruction, Parameters, PathStep, ProgramScope, Variable};
use crate::fault::{CompileError, CompileErrorKind, Position};
use crate::host::Builtin;
use crate::scope::Names;
use crate::value::Value;
use crate::{library, methods, parser, scope};
use std::collections::{HashMap, HashSet};
use std::sync::Arc;

/// Looks up a built-in of the host by name.
pub type LookUp<'a> = &'a dyn Fn(&str) -> Option<&'static Builtin>;

/// Parses and compiles one upload.
///
/// # Errors
/// The text is not URScript, or [`compile_script`] fails. The error has the place of the first fault.
pub fn compile(text: &str, host: LookUp<'_>) -> Result<Code, CompileError> {
    compile_script(&parser::parse(text)?, host)
}

/// Compiles a parsed upload.
///
/// # Errors
/// A name is not known, the arguments of a call do not match its parameters, or a `break` or `continue` is
/// outside a `while`.
pub fn compile_script(script: &Script, host: LookUp<'_>) -> Result<Code, CompileError> {
    let program = &script.main;
    let mut globals = Names::default();
    scope::add_globals(program, &mut globals);
    let mut compiler = Compiler::new(host, globals);
    let names = compiler.first_level(program)?;
    let kind = if program.kind == FunctionKind::Sec { FunctionKind::Sec } else { FunctionKind::Def };
    Ok(compiler.code(program.name.clone(), kind, names))
}

/// A function that has been declared and will be compiled.
pub(crate) struct Declared {
    pub(crate) parameters: Parameters,
    pub(crate) code: Option<Arc<FunctionCode>>,
}

pub(crate) struct Compiler<'a> {
    host: LookUp<'a>,
    globals: Names,
    pub(crate) functions: Vec<Declared>,
    /// Functions by name, outermost scope first.
    pub(crate) visible: Vec<HashMap<Arc<str>, usize>>,
    /// The function whose plain assignments are those of the program.
    first: usize,
}

impl<'a> Compiler<'a> {
    pub(crate) fn new(host: LookUp<'a>, globals: Names) -> Compiler<'a> {
        Compiler { host, globals, functions: Vec::new(), visible: Vec::new(), first: 0 }
    }

    /// Compiles a function whose names are those of the program; the functions that it declares.
    pub(crate) fn first_level(
        &mut self,
        program: &Function,
    ) -> Result<HashMap<Arc<str>, usize>, CompileError> {
        self.first = self.declare(program);
        self.function(program, self.first)
    }

    /// What has been compiled, with `names` for the functions of the first level.
    pub(crate) fn code(self, name: Arc<str>, kind: FunctionKind, names: HashMap<Arc<str>, usize>) -> Code {
        let parameters = self.functions.iter().map(|slot| slot.parameters.clone()).collect();
        // All that is declared is compiled.
        let functions = self.functions.into_iter().filter_map(|slot| slot.code).collect();
        let scope = ProgramScope { globals: self.globals, functions: names, parameters };
        Code { name, kind, functions, scope }
    }

    fn declare(&mut self, function: &Function) -> usize {
        let parameters =
            function.parameters.iter().map(|parameter| (parameter.name.clone(), parameter.default.is_some()));
        self.functions.push(Declared { parameters: parameters.collect(), code: None });
        self.functions.len() - 1
    }

    /// Compiles a declared function; the functions that it declares.
    fn function(
        &mut self,
        function: &Function,
        index: usize,
    ) -> Result<HashMap<Arc<str>, usize>, CompileError> {
        let nested = scope::functions(&function.body);
        let mut names = HashMap::new();
        let mut indices = Vec::new();
        for inner in &nested {
            let inner_index = self.declare(inner);
            indices.push(inner_index);
            names.insert(inner.name.clone(), inner_index);
        }
        self.visible.push(names);
        let mut body = Body::default();
        function.parameters.iter().for_each(|parameter| body.locals.add(&parameter.name));
        let assigned = scope::assigned(&function.body);
        assigned.local.iter().for_each(|name| body.locals.add(name));
        if index != self.first {
            assigned.plain.iter().for_each(|name| body.locals.add(name));
        }
        self.defaults(function, &mut body)?;
        self.statements(&function.body, &mut body)?;
        let at = body.positions.last().copied().unwrap_or(function.at);
        body.emit(Instruction::Constant(Value::Nothing), at);
        body.emit(Instruction::Return, at);
        for (inner, inner_index) in nested.into_iter().zip(indices) {
            self.function(inner, inner_index)?;
        }
        let names = self.visible.pop().unwrap_or_default();
        self.functions[index].code = Some(Arc::new(FunctionCode {
            name: function.name.clone(),
            locals: body.locals.count(),
            instructions: body.instructions,
            positions: body.positions,
        }));
        Ok(names)
    }

    /// Fills the parameters that the caller left out.
    fn defaults(&mut self, function: &Function, body: &mut Body) -> Result<(), CompileError> {
        for (slot, parameter) in function.parameters.iter().enumerate() {
            if let Some(default) = &parameter.default {
                let given = body.emit(Instruction::JumpIfGiven(slot, 0), default.at);
                self.expression(default, body)?;
                body.emit(Instruction::StoreParameter(slot), default.at);
                body.land(given);
            }
        }
        Ok(())
    }

    fn statements(&mut self, statements: &[Statement], body: &mut Body) -> Result<(), CompileError> {
        statements.iter().try_for_each(|statement| self.statement(statement, body))
    }

    fn statement(&mut self, statement: &Statement, body: &mut Body) -> Result<(), CompileError> {
        let at = statement.at;
        match &statement.kind {
            StatementKind::Assign { qualifier, name, path, value } => {
                self.assignment(*qualifier, name, path, value, at, body)?;
            }
            StatementKind::Expression(expression) => {
                self.expression(expression, body)?;
                body.emit(Instruction::Pop, at);
            }
            StatementKind::If { arms, otherwise } => self.conditional(arms, otherwise, body)?,
            StatementKind::While { condition, body: inner } => self.repetition(condition, inner, at, body)?,
            StatementKind::Break | StatementKind::Continue => jump_out(&statement.kind, at, body)?,
            StatementKind::Return(value) => {
                match value {
                    Some(value) => self.expression(value, body)?,
                    None => {
                        body.emit(Instruction::Constant(Value::Nothing), at);
                    }
                }
                body.emit(Instruction::Return, at);
            }
            StatementKind::Kill(handle) => {
                self.expression(handle, body)?;
                body.emit(Instruction::Kill, at);
            }
            StatementKind::Join(handle) => {
                self.expression(handle, body)?;
                body.emit(Instruction::Join, at);
            }
            StatementKind::Halt => {
                body.emit(Instruction::Halt, at);
            }
            StatementKind::Pause => {
                body.emit(Instruction::Pause, at);
            }
            StatementKind::EnterCritical => {
                body.emit(Instruction::EnterCritical, at);
            }
            StatementKind::ExitCritical => {
                body.emit(Instruction::ExitCritical, at);
            }
            StatementKind::Pass | StatementKind::Function(_) => {}
        }
        Ok(())
    }

    fn assignment(
        &mut self,
        qualifier: Qualifier,
        name: &Arc<str>,
        path: &[Accessor],
        value: &Expression,
        at: Position,
        body: &mut Body,
    ) -> Result<(), CompileError> {
        let steps = self.path(path, body)?;
        self.expression(value, body)?;
        let variable = self.variable(name, body);
        if steps.is_empty() {
            body.emit(Instruction::Store(variable, qualifier), at);
        } else {
            body.emit(Instruction::StoreInto(variable, qualifier, steps), at);
        }
        Ok(())
    }

    /// Leaves the indices of a path on the stack.
    fn path(&mut self, path: &[Accessor], body: &mut Body) -> Result<Vec<PathStep>, CompileError> {
        let mut steps = Vec::new();
        for accessor in path {
            match accessor {
                Accessor::Index(index) => {
                    self.expression(index, body)?;
                    steps.push(PathStep::Index);
                }
                Accessor::Member(member) => steps.push(PathStep::Member(member.clone())),
            }
        }
        Ok(steps)
    }

    /// `of.name(arguments)`; what changes a variable does so in its place.
    fn method(
        &mut self,
        of: &Expression,
        name: &Arc<str>,
        arguments: &[Expression],
        body: &mut Body,
    ) -> Result<Instruction, CompileError> {
        let count = arguments.len();
        let Some((variable, path)) = methods::changes(name).then(|| of.as_place()).flatten() else {
            self.expression(of, body)?;
            self.all(arguments, body)?;
            return Ok(Instruction::Method(name.clone(), count));
        };
        let place = self.variable(&variable, body);
        if place.local.is_none() && place.global.is_none() {
            return Err(not_found(&variable, of.at));
        }
        let steps = self.path(&path, body)?;
        self.all(arguments, body)?;
        Ok(Instruction::Change(place, steps, name.clone(), count))
    }

    fn conditional(
        &mut self,
        arms: &[(Expression, Vec<Statement>)],
        otherwise: &[Statement],
        body: &mut Body,
    ) -> Result<(), CompileError> {
        let mut exits = Vec::new();
        for (condition, inner) in arms {
            self.expression(condition, body)?;
            let skip = body.emit(Instruction::JumpUnless(0), condition.at);
            self.statements(inner, body)?;
            exits.push(body.emit(Instruction::Jump(0), condition.at));
            body.land(skip);
        }
        self.statements(otherwise, body)?;
        exits.into_iter().for_each(|exit| body.land(exit));
        Ok(())
    }

    fn repetition(
        &mut self,
        condition: &Expression,
        inner: &[Statement],
        at: Position,
        body: &mut Body,
    ) -> Result<(), CompileError> {
        let start = body.instructions.len();
        self.expression(condition, body)?;
        let leave = body.emit(Instruction::JumpUnless(0), condition.at);
        body.loops.push((start, vec![leave]));
        self.statements(inner, body)?;
        body.emit(Instruction::Jump(start), at);
        let (_, exits) = body.loops.pop().unwrap_or_default();
        exits.into_iter().for_each(|exit| body.land(exit));
        Ok(())
    }

    fn variable(&self, name: &Arc<str>, body: &Body) -> Variable {
        Variable { name: name.clone(), local: body.locals.place(name), global: self.globals.place(name) }
    }

    fn expression(&mut self, expression: &Expression, body: &mut Body) -> Result<(), CompileError> {
        let at = expression.at;
        let instruction = match &expression.kind {
            ExpressionKind::Int(value) => Instruction::Constant(Value::Int(*value)),
            ExpressionKind::Float(value) => Instruction::Constant(Value::Float(*value)),
            ExpressionKind::Bool(value) => Instruction::Constant(Value::Bool(*value)),
            ExpressionKind::Text(text) => Instruction::Constant(Value::Text(text.clone())),
            ExpressionKind::Name(name) => {
                let variable = self.variable(name, body);
                if variable.local.is_none() && variable.global.is_none() {
                    return Err(not_found(name, at));
                }
                Instruction::Load(variable)
            }
            ExpressionKind::List(elements) => {
                self.all(elements, body)?;
                Instruction::MakeList(elements.len())
            }
            ExpressionKind::Pose(elements) => {
                self.all(elements, body)?;
                Instruction::MakePose
            }
            ExpressionKind::Index(of, indices) => {
                self.expression(of, body)?;
                self.all(indices, body)?;
                Instruction::Index(indices.len())
            }
            ExpressionKind::Member(of, member) => {
                self.expression(of, body)?;
                Instruction::Member(member.clone())
            }
            ExpressionKind::Call { name, arguments } => return self.call(name, arguments, at, body),
            ExpressionKind::Method { of, name, arguments } => self.method(of, name, arguments, body)?,
            ExpressionKind::Run { name, arguments } => {
                let Some(function) = self.find_function(name) else { return Err(not_found(name, at)) };
                let slots = self.arguments_of(function, name, arguments, at, body)?;
                Instruction::Run(function, slots)
            }
            ExpressionKind::Unary(operator, of) => {
                self.expression(of, body)?;
                Instruction::Unary(*operator)
            }
            ExpressionKind::Binary(operator @ (Binary::And | Binary::Or), left, right) => {
                self.expression(left, body)?;
                let jump = body.emit(Instruction::ShortCircuit(*operator == Binary::Or, 0), at);
                self.expression(right, body)?;
                body.emit(Instruction::Truth, at);
                body.land(jump);
                return Ok(());
            }
            ExpressionKind::Binary(operator, left, right) => {
                self.expression(left, body)?;
                self.expression(right, body)?;
                Instruction::Binary(*operator)
            }
        };
        body.emit(instruction, at);
        Ok(())
    }

    fn all(&mut self, expressions: &[Expression], body: &mut Body) -> Result<(), CompileError> {
        expressions.iter().try_for_each(|expression| self.expression(expression, body))
    }

    fn find_function(&self, name: &Arc<str>) -> Option<usize> {
        self.visible.iter().rev().find_map(|names| names.get(name).copied())
    }

    fn call(
        &mut self,
        name: &Arc<str>,
        arguments: &[Argument],
        at: Position,
        body: &mut Body,
    ) -> Result<(), CompileError> {
        let instruction = if let Some(function) = self.find_function(name) {
            let slots = self.arguments_of(function, name, arguments, at, body)?;
            Instruction::Call(function, slots)
        } else if &**name == "struct" {
            self.structure(arguments, at, body)?
        } else if let Some(builtin) = library::find(name).or_else(|| (self.host)(name)) {
            let parameters: Vec<(&str, bool)> =
                builtin.parameters.iter().map(|parameter| (parameter.name, parameter.optional)).collect();
            let slots = bind(name, &parameters, arguments, at)?;
            arguments.iter().try_for_each(|argument| self.expression(&argument.value, body))?;
            Instruction::CallBuiltin(builtin, slots)
        } else {
            return Err(not_found(name, at));
        };
        body.emit(instruction, at);
        Ok(())
    }

    fn arguments_of(
        &mut self,
        function: usize,
        name: &str,
        arguments: &[Argument],
        at: Position,
        body: &mut Body,
    ) -> Result<Arc<[usize]>, CompileError> {
        let parameters: Vec<(&str, bool)> = self.functions[function]
            .parameters
            .iter()
            .map(|(parameter, optional)| (&**parameter, *optional))
            .collect();
        let slots = bind(name, &parameters, arguments, at)?;
        arguments.iter().try_for_each(|argument| self.expression(&argument.value, body))?;
        Ok(slots)
    }

    /// `struct(a = 1, b = 2)`
    fn structure(
        &mut self,
        arguments: &[Argument],
        at: Position,
        body: &mut Body,
    ) -> Result<Instruction, CompileError> {
        let mut names: Vec<Arc<str>> = Vec::new();
        let mut known = HashSet::new();
        for argument in arguments {
            let Some(name) = argument.name.as_ref().filter(|&name| known.insert(name)) else {
                return Err(wrong_arguments(
                    at,
                    "each member of a struct needs a name of its own".to_owned(),
                ));
            };
            names.push(name.clone());
            self.expression(&argument.value, body)?;
        }
        Ok(Instruction::MakeStruct(names.into()))
    }
}

/// `break` and `continue`.
fn jump_out(kind: &StatementKind, at: Position, body: &mut Body) -> Result<(), CompileError> {
    let Some(&(start, _)) = body.loops.last() else {
        return Err(CompileError::syntax(at, "`break` and `continue` belong into a `while`"));
    };
    if *kind == StatementKind::Continue {
        body.emit(Instruction::Jump(start), at);
        return Ok(());
    }
    let exit = body.emit(Instruction::Jump(0), at);
    if let Some((_, exits)) = body.loops.last_mut() {
        exits.push(exit);
    }
    Ok(())
}

/// Which parameter each argument fills.
fn bind(
    name: &str,
    parameters: &[(&str, bool)],
    arguments: &[Argument],
    at: Position,
) -> Result<Arc<[usize]>, CompileError> {
    let mut filled = vec![false; parameters.len()];
    let mut slots = Vec::with_capacity(arguments.len());
    for (index, argument) in arguments.iter().enumerate() {
        let slot = match &argument.name {
            None => Some(index).filter(|&index| index < parameters.len()),
            Some(wanted) => parameters.iter().position(|(parameter, _)| **parameter == **wanted),
        };
        let Some(slot) = slot else {
            let message = match &argument.name {
                Some(wanted) => format!("{name} has no parameter `{wanted}`"),
                None => {
                    format!("{name} takes at most {} arguments, {} given", parameters.len(), arguments.len())
                }
            };
            return Err(wrong_arguments(at, message));
        };
        if std::mem::replace(&mut filled[slot], true) {
            return Err(wrong_arguments(
                at,
                format!("{name}: parameter `{}` is given twice", parameters[slot].0),
            ));
        }
        slots.push(slot);
    }
    let missing = parameters.iter().zip(&filled).find(|((_, optional), filled)| !optional && !**filled);
    if let Some(((parameter, _), _)) = missing {
        return Err(wrong_arguments(at, format!("{name}: parameter `{parameter}` is missing")));
    }
    Ok(slots.into())
}

fn wrong_arguments(at: Position, message: String) -> CompileError {
    CompileError { at, kind: CompileErrorKind::Arguments(message) }
}

fn not_found(name: &str, at: Position) -> CompileError {
    CompileError { at, kind: CompileErrorKind::NameNotFound(name.to_owned()) }
}
