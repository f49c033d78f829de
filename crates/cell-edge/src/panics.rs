//! Work whose panic ends that work alone: a fault of one search is no reason for a daemon to end.
//!
//! In: a closure. Out: what it returns, or the words of its panic. The panic itself is reported on standard
//! error as ever, with its place. An overflow of the stack is no panic and ends the process.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// What `work` returns.
///
/// What it shares with its caller may be half changed after a panic: the caller drops that, or can judge it.
///
/// # Errors
/// The words of its panic.
pub fn guarded<T>(work: impl FnOnce() -> T) -> Result<T, String> {
    catch_unwind(AssertUnwindSafe(work)).map_err(|panic| words_of(panic.as_ref()))
}

fn words_of(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|text| (*text).to_string());
    let text = text.or_else(|| panic.downcast_ref::<String>().cloned());
    text.unwrap_or_else(|| "a panic without words".to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_comes_back_in_its_words() {
        assert_eq!(guarded(|| 7), Ok(7));
        assert_eq!(guarded(|| -> u8 { panic!("no room") }), Err("no room".to_string()));
        let index = std::hint::black_box(3);
        assert_eq!(guarded(|| -> u8 { panic!("index {index}") }), Err("index 3".to_string()));
        let wordless = guarded(|| -> u8 { std::panic::panic_any(5) });
        assert_eq!(wordless, Err("a panic without words".to_string()));
    }
}
