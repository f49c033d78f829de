//! The small words of a job: approval, objective and solver, with the names that files use.
//!
//! In: a word from a job or configuration file. Out: the value, or a complaint that names the words there
//! are. Pure.

use rearrange::document::decode::{At, Decoder};
use serde::{Deserialize, Serialize};

/// Who has to agree before the arm moves. Ordered by strictness: a job may only be stricter than the cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Approval {
    /// No person: an armed cell carries out accepted jobs at once.
    Never,
    /// A person approves each job once, with its first plan.
    Job,
    /// A person approves every plan, also each new plan within a job.
    Always,
}

impl Approval {
    /// The words a file may use, in the order of strictness.
    pub const WORDS: [&'static str; 3] = ["never", "job", "always"];

    /// The value that `word` names.
    pub fn from_word(word: &str) -> Option<Approval> {
        match word {
            "never" => Some(Approval::Never),
            "job" => Some(Approval::Job),
            "always" => Some(Approval::Always),
            _ => None,
        }
    }

    /// The word a file uses.
    pub fn word(self) -> &'static str {
        Approval::WORDS[self as usize]
    }
}

/// What a plan is judged by.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum JobObjective {
    /// Number of pick-n-places.
    Pp,
    /// Total impedance of the moves.
    Ti,
    /// Seconds of the arm's travel, estimated.
    Time,
}

impl JobObjective {
    /// The words a file may use.
    pub const WORDS: [&'static str; 3] = ["pp", "ti", "time"];

    /// The value that `word` names.
    pub fn from_word(word: &str) -> Option<JobObjective> {
        match word {
            "pp" => Some(JobObjective::Pp),
            "ti" => Some(JobObjective::Ti),
            "time" => Some(JobObjective::Time),
            _ => None,
        }
    }

    /// The word a file uses.
    pub fn word(self) -> &'static str {
        JobObjective::WORDS[self as usize]
    }
}

/// The solver names that job and configuration files may use.
pub const SOLVER_WORDS: [&str; 7] = ["tbm", "rbm", "etbm", "erbm", "mcts", "emcts", "auto"];

/// What is wrong with a word that names nothing here, and what to write instead.
pub fn unknown_word(word: &str, known: &[&str]) -> (String, String) {
    (format!("{word:?} is not known here"), format!("one of: {}", known.join(", ")))
}

/// A solver's name.
pub fn decode_solver(decoder: &mut Decoder, at: &At) -> Option<&'static str> {
    let text = decoder.text(at)?;
    let found = SOLVER_WORDS.into_iter().find(|word| *word == text);
    if found.is_none() {
        let (message, help) = unknown_word(&text, &SOLVER_WORDS);
        decoder.complain_at(at, message, help);
    }
    found
}

/// An objective's name.
pub fn decode_objective(decoder: &mut Decoder, at: &At) -> Option<JobObjective> {
    let text = decoder.text(at)?;
    let found = JobObjective::from_word(&text);
    if found.is_none() {
        let (message, help) = unknown_word(&text, &JobObjective::WORDS);
        decoder.complain_at(at, message, help);
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_and_values_agree() {
        for word in Approval::WORDS {
            assert_eq!(Approval::from_word(word).map(Approval::word), Some(word));
        }
        for word in JobObjective::WORDS {
            assert_eq!(JobObjective::from_word(word).map(JobObjective::word), Some(word));
        }
        assert!(Approval::Always > Approval::Job && Approval::Job > Approval::Never);
    }
}
