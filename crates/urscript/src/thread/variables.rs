//! A thread's access to variables: loading, storing, changing a part of one.
//!
//! In: where the compiler says that a variable may be, and the stack. Out: values on the stack or in their
//! place, local or global. Which of the two is decided here and not by the compiler, because it depends on
//! which of them exists when the instruction runs.

use crate::ast::Qualifier;
use crate::bounds::bounded_ref;
use crate::code::{PathStep, Variable};
use crate::methods;
use crate::operators::{self, Step};
use crate::thread::{Shared, Thread};
use crate::value::Value;

/// Elements that a list may grow by until all elements of its variable are counted again.
const COUNTED_EVERY: usize = 64;

impl Thread {
    pub(super) fn load(&mut self, variable: &Variable, shared: &Shared) -> Result<Value, String> {
        let local = variable.local.and_then(|slot| self.calls.last()?.locals.get(slot)?.as_ref());
        let found = local.or_else(|| shared.globals.get(variable.global?)?.as_ref());
        found.cloned().ok_or_else(|| format!("variable `{}` is used before it has a value", variable.name))
    }

    /// Puts a value into a variable.
    #[inline]
    pub(super) fn store(
        &mut self,
        variable: &Variable,
        qualifier: Qualifier,
        shared: &mut Shared,
    ) -> Result<(), String> {
        let value = self.stored_value()?;
        match self.place(variable, qualifier, shared)? {
            // `local` declares anew, whatever had the name before.
            Some(target) if qualifier != Qualifier::Local => operators::assign(target, value)?,
            place => *place = Some(value),
        }
        Ok(())
    }

    pub(super) fn store_into(
        &mut self,
        variable: &Variable,
        qualifier: Qualifier,
        path: &[PathStep],
        shared: &mut Shared,
    ) -> Result<(), String> {
        let value = self.stored_value()?;
        let steps = self.steps(path);
        let nests = matches!(value, Value::List(_) | Value::Struct(_));
        let place = self.place(variable, qualifier, shared)?;
        let Some(target) = place else {
            return Err(format!("variable `{}` is used before it has a value", variable.name));
        };
        operators::replace(target, &steps, value)?;
        if nests && let Err(message) = bounded_ref(target) {
            *target = Value::Nothing;
            return Err(message);
        }
        Ok(())
    }

    /// A method that changes a part of a variable.
    pub(super) fn change(
        &mut self,
        variable: &Variable,
        path: &[PathStep],
        (name, count): (&str, usize),
        shared: &mut Shared,
    ) -> Result<(), String> {
        let arguments = self.pop_many(count);
        let nests = arguments.iter().any(|value| matches!(value, Value::List(_) | Value::Struct(_)));
        let steps = self.steps(path);
        let Some(whole) = self.place(variable, Qualifier::Plain, shared)? else {
            return Err(format!("variable `{}` is used before it has a value", variable.name));
        };
        let of = operators::part(whole, &steps)?;
        let result = methods::change(of, name, arguments)?;
        // Counting everything at every element would make filling a list as slow as its square.
        let counts = nests || matches!(of, Value::List(list) if list.len().is_multiple_of(COUNTED_EVERY));
        if counts && let Err(message) = bounded_ref(whole) {
            *whole = Value::Nothing;
            return Err(message);
        }
        self.stack.push(result);
        Ok(())
    }

    fn stored_value(&mut self) -> Result<Value, String> {
        match self.pop() {
            Value::Nothing => Err("a function without a return value cannot be assigned".to_owned()),
            value => Ok(value),
        }
    }

    fn place<'a>(
        &'a mut self,
        variable: &Variable,
        qualifier: Qualifier,
        shared: &'a mut Shared,
    ) -> Result<&'a mut Option<Value>, String> {
        let has_local = variable.local.is_some_and(|slot| {
            self.calls.last().is_some_and(|c| c.locals.get(slot).is_some_and(Option::is_some))
        });
        let has_global =
            variable.global.is_some_and(|slot| shared.globals.get(slot).is_some_and(Option::is_some));
        let global = match qualifier {
            Qualifier::Global => true,
            Qualifier::Local => false,
            Qualifier::Plain => variable.local.is_none() || (!has_local && has_global),
        };
        let place = if global {
            variable.global.and_then(|slot| shared.globals.get_mut(slot))
        } else {
            variable.local.and_then(|slot| self.calls.last_mut()?.locals.get_mut(slot))
        };
        place.ok_or_else(|| format!("variable `{}` cannot be assigned here", variable.name))
    }

    /// A path with the indices that were left on the stack.
    fn steps(&mut self, path: &[PathStep]) -> Vec<Step> {
        let count = path.iter().filter(|step| matches!(step, PathStep::Index)).count();
        let mut indices = self.pop_many(count).into_iter();
        let step = |step: &PathStep| match step {
            PathStep::Index => Step::Index(indices.next().unwrap_or(Value::Nothing)),
            PathStep::Member(name) => Step::Member(name.clone()),
        };
        path.iter().map(step).collect()
    }
}
