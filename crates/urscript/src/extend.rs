//! Statements that join a running program (the controller's interpreter mode).
//!
//! In: the code of the program and a statement's text. Out: the code with a function more, which carries out
//! the statement: it sees and assigns the names of the program's first level, and what it declares there
//! (variables, functions, threads) is there for the statements after it. Nothing that runs is touched:
//! functions keep their numbers and variables their slots.

use crate::ast::FunctionKind;
use crate::code::{Code, ProgramScope};
use crate::compile::{Compiler, Declared, LookUp};
use crate::fault::CompileError;
use crate::{parser, scope};

/// Adds a statement to a program's code; the new code and the number of the function to call.
///
/// # Errors
/// The text is not URScript, or names something that neither program nor host has.
pub fn extend(code: &Code, text: &str, host: LookUp<'_>) -> Result<(Code, usize), CompileError> {
    // By itself too: an `end` too many must not end what is put round it.
    parser::parse(text)?;
    let script = parser::parse(&format!("def statement(): {text}\nend\n"))?;
    let mut globals = code.scope.globals.clone();
    scope::add_globals(&script.main, &mut globals);
    let mut compiler = Compiler::new(host, globals);
    let known = code.functions.iter().zip(&code.scope.parameters);
    compiler.functions = known
        .map(|(function, parameters)| Declared {
            parameters: parameters.clone(),
            code: Some(function.clone()),
        })
        .collect();
    compiler.visible.push(code.scope.functions.clone());
    let function = compiler.functions.len();
    let declared = compiler.first_level(&script.main)?;
    let mut names = code.scope.functions.clone();
    names.extend(declared);
    Ok((compiler.code(code.name.clone(), FunctionKind::Def, names), function))
}

/// The code for statements to come once those that came before are forgotten: the names of `base`, the
/// program without statements.
pub fn forget(code: &Code, base: &Code) -> Code {
    let scope = ProgramScope { parameters: code.scope.parameters.clone(), ..base.scope.clone() };
    Code { scope, ..code.clone() }
}
