//! Sound texts with something in them changed: a change that finds nothing to change is a fault of the test.
//!
//! In: a text, and what is replaced by what. Out: the changed text, or a panic that names what is not there,
//! or not as often as the test means. The unit tests of the library take these functions from here too.

/// The text with `from`, which is in it exactly once, replaced.
#[track_caller]
pub(crate) fn replace_once(text: &str, from: &str, to: &str) -> String {
    replace_times(text, from, to, 1)
}

/// The text with each `from` replaced, of which there are exactly `times`.
#[track_caller]
pub(crate) fn replace_times(text: &str, from: &str, to: &str, times: usize) -> String {
    let found = text.matches(from).count();
    assert!(found == times, "{from:?} stands {found} times, not {times}, in\n{text}");
    text.replace(from, to)
}

/// The text with the first `from` replaced, however many follow.
#[track_caller]
pub(crate) fn replace_first(text: &str, from: &str, to: &str) -> String {
    assert!(text.contains(from), "{from:?} does not stand in\n{text}");
    text.replacen(from, to, 1)
}
