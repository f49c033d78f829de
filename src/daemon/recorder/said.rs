//! What a recording says of an order's answer and of a job's progress: what is nobody's notice, and yet what
//! a viewer looks for first.
//!
//! In: an effect of the machine. Out: a line of the log topic, or none. Pure; the words are those of the
//! job's story (`jobs::history`).

use cell_machine::event::Effect;
use cell_machine::supervisor::input::Record;
use foxglove::messages::log::Level;
use rearrange::planning::plan::ActionKind;

/// The line for an effect.
pub(super) fn line(effect: &Effect) -> Option<(Level, String)> {
    match effect {
        Effect::Commit { record, .. } => Some((Level::Info, progress(record)?)),
        Effect::Reply { reply, .. } => {
            // The situation before a way back has many lines.
            let first = reply.message.lines().next().unwrap_or_default();
            match reply.accepted {
                true => Some((Level::Info, format!("an order is carried out: {first}"))),
                false => Some((Level::Warning, format!("an order was refused: {first}"))),
            }
        }
        Effect::Connect(_)
        | Effect::Close(_)
        | Effect::Send(..)
        | Effect::Registers(_)
        | Effect::Look { .. }
        | Effect::Observe { .. }
        | Effect::Picture { .. }
        | Effect::Plan { .. }
        | Effect::CancelPlan
        | Effect::WantJob
        | Effect::Notify(_)
        | Effect::RoundOver(_)
        | Effect::End(_) => None,
    }
}

/// What is written into the journal, in words; the job's end has a line of its own.
fn progress(record: &Record) -> Option<String> {
    Some(match record {
        Record::Found { objects, goals } => {
            format!("found {} objects on the table, {} of them with a goal", objects.len(), goals.len())
        }
        Record::Planned(note) if note.preview => format!("preview: {} pick-n-places", note.actions.len()),
        Record::Planned(note) => format!("planned: {} pick-n-places", note.actions.len()),
        Record::Approved => "a person approved a plan".to_string(),
        Record::Intent { step, object, to, kind, .. } => {
            let place = match kind {
                ActionKind::Goal => "its goal",
                ActionKind::Buffer => "a temporary place",
            };
            format!("{step}. {object} is to be moved to {place}, x {:.3} m, y {:.3} m", to.x, to.y)
        }
        Record::Gripped { step } => format!("{step}. was gripped"),
        Record::Released { step } => format!("{step}. was let go"),
        Record::Done { step } => format!("{step}. is done"),
        Record::Withdrawn { step } => format!("{step}. is not begun"),
        Record::LetGo => "what was gripped does not hang on the cups any more".to_string(),
        Record::Ended(_) => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use cell_machine::orders::Reply;
    use rearrange::geometry::pose::Pose2;

    #[test]
    fn grips_approvals_and_answers_are_in_the_log() {
        let commit = |record| line(&Effect::Commit { number: 1, record }).map(|(_, text)| text);
        assert_eq!(commit(Record::Approved).as_deref(), Some("a person approved a plan"));
        assert_eq!(commit(Record::Gripped { step: 2 }).as_deref(), Some("2. was gripped"));
        let intent = Record::Intent {
            step: 2,
            object: "mug".into(),
            from: Pose2::default(),
            to: Pose2::new(0.1, 0.25, 0.0),
            kind: ActionKind::Buffer,
            tool_from_object: None,
            table: Vec::new(),
        };
        let expected = "2. mug is to be moved to a temporary place, x 0.100 m, y 0.250 m";
        assert_eq!(commit(intent).as_deref(), Some(expected));
        let (level, text) = line(&Effect::Reply { number: 1, reply: Reply::refuse("why\nmore") }).unwrap();
        assert_eq!((level, text.as_str()), (Level::Warning, "an order was refused: why"));
        assert!(line(&Effect::WantJob).is_none());
    }
}
