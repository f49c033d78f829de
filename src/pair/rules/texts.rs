//! The rule about texts that reach the robot: its program with two numbers filled in, and a few words of the
//! dashboard, nothing else.
//!
//! In: the bytes that go to the primary interface and to the dashboard. Out: what in them is not celld's
//! own. The program is compared with the file that people read, by a matcher of its own.

use crate::pair::rules::found::Found;
use crate::pair::rules::rule::Rule;

/// The program in the repository.
const PROGRAM: &str = include_str!("../../../hardware/ur5e/celld_program.script");

/// What stands for a number in it.
const PLACES: [&str; 2] = ["{{NONCE}}", "{{WATCHDOG_FRAMES}}"];

/// Most digits of a number that is filled in.
const DIGITS: usize = 10;

/// All that celld says to the dashboard.
const WORDS: [&str; 13] = [
    "power on",
    "power off",
    "brake release",
    "stop",
    "unlock protective stop",
    "close safety popup",
    "is in remote control",
    "robotmode",
    "safetymode",
    "safetystatus",
    "polyscopeversion",
    "get serial number",
    "get robot model",
];

/// Longest text that a breach shows.
const SHOWN: usize = 60;

/// Something is sent to the primary interface.
pub(super) fn check_program(bytes: &[u8], found: &mut Found) {
    let text = String::from_utf8_lossy(bytes);
    if let Some(rest) = first_difference(&text) {
        found.push(Rule::TextInScript, rest.chars().take(SHOWN).collect::<String>());
    }
}

/// Something is sent to the dashboard.
pub(super) fn check_line(bytes: &[u8], found: &mut Found) {
    let text = String::from_utf8_lossy(bytes).to_lowercase();
    if let Some(line) = text.lines().find(|line| !WORDS.contains(&line.trim())) {
        found.push(Rule::TextInScript, line.chars().take(SHOWN).collect::<String>());
    }
}

/// How newer software sets a payload, and how the program has it.
const GRADUALLY: &str = "set_target_payload(v0, [v1, v2, v3], [0, 0, 0, 0, 0, 0], 0.1)";
const AT_ONCE: &str = "set_payload(v0, [v1, v2, v3])";

/// The rest of a text from where it is not the program any more; `None` where all of it is.
fn first_difference(text: &str) -> Option<String> {
    let text = text.replace(GRADUALLY, AT_ONCE);
    let mut rest = text.as_str();
    let mut template = PROGRAM;
    loop {
        let next = PLACES.iter().filter_map(|place| Some((template.find(place)?, place.len()))).min();
        let (fixed, after) =
            next.map_or((template, ""), |(at, length)| (&template[..at], &template[at + length..]));
        let Some(matched) = rest.strip_prefix(fixed) else {
            let same = fixed.bytes().zip(rest.bytes()).take_while(|(a, b)| a == b).count();
            return Some(String::from_utf8_lossy(&rest.as_bytes()[same..]).into_owned());
        };
        if next.is_none() {
            return (!matched.is_empty()).then(|| matched.to_string());
        }
        let digits = matched.bytes().take_while(u8::is_ascii_digit).count();
        if !(1..=DIGITS).contains(&digits) {
            return Some(matched.to_string());
        }
        (rest, template) = (&matched[digits..], after);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cell_machine::device::program::{Nonce, PROGRAM_TEXT, ProgramTemplate, WATCHDOG_FRAMES};

    #[test]
    fn a_program_with_numbers_passes_and_one_with_a_word_does_not() {
        let program = ProgramTemplate::new(PROGRAM_TEXT, WATCHDOG_FRAMES).unwrap().render(Nonce::new(4711));
        assert_eq!(first_difference(&program), None);
        let spoilt = program.replace("\nend\n", "\n  textmsg(\"lid-1\")\nend\n");
        let rest = first_difference(&spoilt).expect("a difference");
        assert!(rest.trim_start().starts_with("textmsg"), "in the middle: {rest}");
        let spoilt = program.replace("watchdog_frames = 100", "watchdog_frames = 1e2");
        assert!(first_difference(&spoilt).is_some_and(|rest| rest.starts_with("e2")), "a number is digits");
        assert_eq!(first_difference(&format!("{program}movej(q)")).as_deref(), Some("movej(q)"), "after it");
    }

    #[test]
    fn a_dashboard_line_with_an_argument_is_found() {
        let mut found = Found::default();
        check_line(b"robotmode\npower on\n", &mut found);
        assert!(found.take().is_empty());
        check_line(b"load lid-1.urp\n", &mut found);
        assert_eq!(found.take(), [(Rule::TextInScript, "load lid-1.urp".to_string())]);
    }
}
