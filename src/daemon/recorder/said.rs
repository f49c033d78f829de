//! What a recording says of a job's progress and of orders that were refused: no notice of the cell has it,
//! and a viewer looks for it first.
//!
//! In: the effects of the machine, in order. Out: a line of the log topic for some of them. A line is there
//! when the record goes to the disk, and so before an object begins to move by it.

use cell_machine::event::Effect;
use cell_machine::supervisor::input::Record;
use foxglove::messages::log::Level;
use rearrange::planning::plan::ActionKind;

/// What is needed of the effects before.
#[derive(Debug, Default)]
pub struct Said {
    /// Of the step that was meant last.
    object: String,
}

impl Said {
    /// The line for an effect.
    pub fn line(&mut self, effect: &Effect) -> Option<(Level, String)> {
        match effect {
            Effect::Commit { record, .. } => Some((Level::Info, self.progress(record)?)),
            Effect::Reply { reply, .. } if !reply.accepted => {
                let first = reply.message.lines().next().unwrap_or_default();
                Some((Level::Warning, format!("an order was refused: {first}")))
            }
            // What an accepted order leads to has its notices and records.
            Effect::Reply { .. }
            | Effect::Connect(_)
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

    /// What is written into the journal, in words; plans and the job's end have notices.
    fn progress(&mut self, record: &Record) -> Option<String> {
        // As in the job's story: from 1.
        let of_step = |step: &usize, words: &str| format!("{}. {words}", step + 1);
        Some(match record {
            Record::Found { objects, goals } => {
                format!("found {} objects on the table, {} of them with a goal", objects.len(), goals.len())
            }
            Record::Approved => "a person approved a plan".to_string(),
            Record::Intent { step, object, to, kind, .. } => {
                self.object.clone_from(object);
                let place = match kind {
                    ActionKind::Goal => "its goal",
                    ActionKind::Buffer => "a temporary place",
                };
                let words = format!("{object} is to be moved to {place}, x {:.3} m, y {:.3} m", to.x, to.y);
                of_step(step, &words)
            }
            Record::Gripped { step } => of_step(step, &format!("{} is gripped", self.object)),
            Record::Released { step } => of_step(step, &format!("{} is let go", self.object)),
            Record::Done { step } => of_step(step, &format!("{} is done", self.object)),
            Record::Withdrawn { step } => of_step(step, &format!("{} is not begun", self.object)),
            Record::LetGo { how } => {
                format!("what was gripped last does not hang on the cups any more: {how}")
            }
            Record::Planned(_) | Record::Ended(_) => return None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cell_machine::orders::Reply;
    use rearrange::geometry::pose::Pose2;

    #[test]
    fn grips_approvals_and_refusals_are_in_the_log() {
        let mut said = Said::default();
        let intent = Record::Intent {
            step: 1,
            object: "mug".into(),
            from: Pose2::default(),
            to: Pose2::new(0.1, 0.25, 0.0),
            kind: ActionKind::Buffer,
            tool_from_object: None,
            table: Vec::new(),
        };
        let expected = [
            (Record::Approved, "a person approved a plan"),
            (intent, "2. mug is to be moved to a temporary place, x 0.100 m, y 0.250 m"),
            (Record::Gripped { step: 1 }, "2. mug is gripped"),
            (Record::Done { step: 1 }, "2. mug is done"),
        ];
        for (record, text) in expected {
            let line = said.line(&Effect::Commit { number: 1, record });
            assert_eq!(line, Some((Level::Info, text.to_string())));
        }
        let mut answer = |reply| said.line(&Effect::Reply { number: 1, reply });
        let refused = answer(Reply::refuse("why\nmore"));
        assert_eq!(refused, Some((Level::Warning, "an order was refused: why".to_string())));
        assert_eq!(answer(Reply::accept("armed")), None, "the cell has a notice of it");
    }
}
