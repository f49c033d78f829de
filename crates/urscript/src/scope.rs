//! Which names a script declares, and where they live.
//!
//! In: the syntax tree. Out: the functions each body declares, and the names it assigns. Names assigned on
//! the first level of the program are global to all its functions and threads, with or without `global`;
//! functions and threads may be used before the text reaches them.

use crate::ast::{Function, Qualifier, Statement, StatementKind};
use std::collections::HashMap;
use std::sync::Arc;

/// Names, each with its place in the order in which they came.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Names(HashMap<Arc<str>, usize>);

impl Names {
    /// Adds `name` behind the others unless it is there.
    pub fn add(&mut self, name: &Arc<str>) {
        let place = self.0.len();
        self.0.entry(name.clone()).or_insert(place);
    }

    /// The place of a name, counted from 0.
    pub fn place(&self, name: &str) -> Option<usize> {
        self.0.get(name).copied()
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.0.len()
    }
}

/// Names a body assigns, by the word in front, as often as it does.
#[derive(Debug, Default)]
pub struct Assigned {
    /// Without a word.
    pub plain: Vec<Arc<str>>,
    /// With `local`.
    pub local: Vec<Arc<str>>,
    /// With `global`.
    pub global: Vec<Arc<str>>,
}

/// Calls `visit` on every statement of `body` that belongs to the same function.
fn each<'a>(body: &'a [Statement], visit: &mut dyn FnMut(&'a Statement)) {
    for statement in body {
        visit(statement);
        match &statement.kind {
            StatementKind::If { arms, otherwise } => {
                arms.iter().for_each(|(_, body)| each(body, visit));
                each(otherwise, visit);
            }
            StatementKind::While { body, .. } => each(body, visit),
            _ => {}
        }
    }
}

/// Functions and threads declared directly in `body`.
pub fn functions(body: &[Statement]) -> Vec<&Function> {
    let mut found = Vec::new();
    each(body, &mut |statement| {
        if let StatementKind::Function(function) = &statement.kind {
            found.push(function);
        }
    });
    found
}

/// Names that `body` itself assigns (not its nested functions).
pub fn assigned(body: &[Statement]) -> Assigned {
    let mut found = Assigned::default();
    each(body, &mut |statement| {
        if let StatementKind::Assign { qualifier, name, .. } = &statement.kind {
            let names = match qualifier {
                Qualifier::Plain => &mut found.plain,
                Qualifier::Local => &mut found.local,
                Qualifier::Global => &mut found.global,
            };
            names.push(name.clone());
        }
    });
    found
}

/// Adds all global names of a program.
pub fn add_globals(program: &Function, names: &mut Names) {
    program.parameters.iter().for_each(|parameter| names.add(&parameter.name));
    assigned(&program.body).plain.iter().for_each(|name| names.add(name));
    collect_global(program, names);
}

fn collect_global(function: &Function, names: &mut Names) {
    assigned(&function.body).global.iter().for_each(|name| names.add(name));
    functions(&function.body).into_iter().for_each(|nested| collect_global(nested, names));
}
