//! An error with its causes as one line of text.
//!
//! In: any error. Out: its message and those of its causes, joined by colons, outermost first. Errors here
//! say where and what, their causes say why; a person who reads only the first would have to guess.

use std::error::Error;

/// The error and all its causes, outermost first: `camera.yaml: cannot be read: no such file`.
pub fn chain(error: &(dyn Error + 'static)) -> String {
    let causes = std::iter::successors(Some(error), |&error| error.source());
    causes.map(ToString::to_string).collect::<Vec<_>>().join(": ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fmt;

    #[derive(Debug)]
    struct Layer(&'static str, Option<Box<Layer>>);

    impl fmt::Display for Layer {
        fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str(self.0)
        }
    }

    impl Error for Layer {
        fn source(&self) -> Option<&(dyn Error + 'static)> {
            self.1.as_deref().map(|cause| cause as _)
        }
    }

    #[test]
    fn chain_names_every_cause_outermost_first() {
        let root = Layer("no such file", None);
        let error = Layer("camera.yaml", Some(Box::new(Layer("cannot be read", Some(Box::new(root))))));
        assert_eq!(chain(&error), "camera.yaml: cannot be read: no such file");
        assert_eq!(chain(&Layer("alone", None)), "alone");
    }
}
