//! A published fact with the simulator's answer, and whether the two agree.
//!
//! In: what is published, a tolerance where it is a number, and what was measured. Out: text for the page,
//! and a judgement.

/// Where a fact is published.
pub mod source {
    /// UR's URScript manual, software 5.
    pub const SCRIPT: &str = "script manual";
    /// UR's RTDE guide.
    pub const RTDE: &str = "RTDE guide";
    /// UR's dashboard server guide.
    pub const DASHBOARD: &str = "dashboard guide";
    /// UR's client-interface guide.
    pub const CLIENTS: &str = "client interface guide";
    /// UR's client library and its tests.
    pub const LIBRARY: &str = "UR's client library";
    /// UR's Python client of RTDE.
    pub const PYTHON: &str = "UR's RTDE client for Python";
    /// UR's support article on kinematics.
    pub const KINEMATICS: &str = "UR's article on DH parameters";
    /// Data sheets of the arms.
    pub const SHEET: &str = "data sheet";
    /// UR's error code directory.
    pub const CODES: &str = "error code directory";
    /// UR's map of the Modbus server.
    pub const MODBUS: &str = "Modbus server map";
    /// Public drivers of the VGC10.
    pub const VGC10: &str = "public VGC10 drivers";
    /// Public drivers of Robotiq grippers.
    pub const ROBOTIQ: &str = "public Robotiq drivers";
    /// What users of real arms report.
    pub const FIELD: &str = "field reports";
    /// The Modbus organisation.
    pub const RTU: &str = "Modbus over serial line";
}

/// What is published.
#[derive(Clone, Debug, PartialEq)]
pub enum Published {
    /// Numbers.
    Numbers(Figures),
    /// Words, or bytes in hexadecimal.
    Text(&'static str),
}

/// Numbers as they are published.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Figures {
    values: &'static [f64],
    within: f64,
    unit: &'static str,
}

/// `values` in `unit`, of which an answer may differ by `within`.
pub fn figures(values: &'static [f64], within: f64, unit: &'static str) -> Figures {
    Figures { values, within, unit }
}

/// What the simulator says.
#[derive(Clone, Debug, PartialEq)]
pub enum Answer {
    /// Numbers in the published unit.
    Numbers(Vec<f64>),
    /// Words, or bytes in hexadecimal.
    Text(String),
}

/// A row of the page.
#[derive(Clone, Debug, PartialEq)]
pub struct Fact {
    /// What was measured.
    pub what: &'static str,
    /// What is published.
    pub published: Published,
    /// What the simulator says.
    pub answer: Answer,
    /// Where it is published.
    pub source: &'static str,
    /// Why the two differ; empty where they agree.
    pub but: &'static str,
}

/// A table of the page.
#[derive(Clone, Debug, PartialEq)]
pub struct Section {
    /// Its heading.
    pub title: &'static str,
    /// Its rows.
    pub rows: Vec<Fact>,
}

/// A row with one number.
pub fn number(what: &'static str, source: &'static str, published: Figures, answer: f64) -> Fact {
    numbers(what, source, published, vec![answer])
}

/// A row with several.
pub fn numbers(what: &'static str, source: &'static str, published: Figures, answer: Vec<f64>) -> Fact {
    let published = Published::Numbers(published);
    Fact { what, published, answer: Answer::Numbers(answer), source, but: "" }
}

/// A row with words or bytes.
pub fn text(what: &'static str, source: &'static str, published: &'static str, answer: String) -> Fact {
    Fact { what, published: Published::Text(published), answer: Answer::Text(answer), source, but: "" }
}

impl Fact {
    /// The same, known to deviate.
    pub fn but(self, but: &'static str) -> Fact {
        Fact { but, ..self }
    }

    /// The answer is what is published, within the tolerance.
    pub fn agrees(&self) -> bool {
        match (&self.published, &self.answer) {
            (Published::Numbers(Figures { values, within, .. }), Answer::Numbers(answer)) => {
                let near = |(a, b): (&f64, &f64)| (a - b).abs() <= within + 1e-9;
                values.len() == answer.len() && values.iter().zip(answer).all(near)
            }
            (Published::Text(text), Answer::Text(answer)) => text == answer,
            _ => false,
        }
    }

    /// What is published, for people.
    pub fn expected(&self) -> String {
        match &self.published {
            Published::Numbers(published) => written(published.values, published),
            Published::Text(text) => format!("`{text}`"),
        }
    }

    /// What the simulator says, for people.
    pub fn answered(&self) -> String {
        match (&self.answer, &self.published) {
            (Answer::Numbers(values), Published::Numbers(published)) => written(values, published),
            (Answer::Numbers(values), Published::Text(_)) => written(values, &figures(&[], 1e-6, "")),
            (Answer::Text(text), _) => format!("`{text}`"),
        }
    }
}

/// Numbers with as many places as the tolerance has.
fn written(values: &[f64], &Figures { within, unit, .. }: &Figures) -> String {
    let places = if within <= 0.0 { 0 } else { (-within.log10()).ceil().clamp(1.0, 9.0) as usize };
    let one = |value: &f64| {
        let text = format!("{value:.places$}");
        let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
        if text == "-0" { "0".to_owned() } else { text.to_owned() }
    };
    let list = values.iter().map(one).collect::<Vec<_>>().join(", ");
    if unit.is_empty() { list } else { format!("{list} {unit}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_agree_within_their_tolerance_and_are_written_with_its_places() {
        let row = |answer| number("n", "s", figures(&[2.21], 0.01, "s"), answer);
        assert!(row(2.219).agrees() && !row(2.23).agrees() && !row(f64::NAN).agrees());
        assert_eq!((row(2.219).answered(), row(0.0).expected()), ("2.22 s".to_owned(), "2.21 s".to_owned()));
        let several = numbers("n", "s", figures(&[0.2, -0.5], 1e-5, ""), vec![0.2, -0.0]);
        assert!(!several.agrees());
        assert_eq!(several.answered(), "0.2, 0");
        assert!(!numbers("n", "s", figures(&[1.0], 0.1, ""), vec![]).agrees());
        assert_eq!(number("n", "s", figures(&[500.0], 0.0, "Hz"), 500.0).answered(), "500 Hz");
    }
}
