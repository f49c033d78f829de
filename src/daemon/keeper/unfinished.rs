//! What an earlier daemon left unfinished: jobs, steps, what may hang on the cups.
//!
//! In: the journal as it was found. Out: sentences for the log, the job that was cut off, what was gripped
//! and not let go.

use crate::jobs::journal::{Journal, JournalError, Recovered};
use crate::jobs::record::{StepPhase, StepRecord};
use cell_machine::supervisor::model::{CutOff, HeldBefore};

/// Decides about jobs that were active; what is to be said of each, and the one that was cut off in a step.
pub(super) fn unfinished(
    journal: &mut Journal,
    unix_s: f64,
) -> Result<(Vec<String>, Option<CutOff>), JournalError> {
    let recovered = journal.recover(unix_s)?;
    let notices = recovered.iter().map(ToString::to_string).collect();
    let cut_off = match recovered.iter().find_map(cut_off_by) {
        Some(cut_off) => Some(cut_off),
        // An earlier start may have found it, and ended before a person saw it.
        None => journal.cut_off_before()?.as_ref().and_then(cut_off_by),
    };
    Ok((notices, cut_off))
}

/// What was gripped and not let go.
pub(super) fn held_before(journal: &Journal) -> Result<Option<HeldBefore>, JournalError> {
    // The word of a grip may not have reached the disk before the end.
    let may_hang = |step: &StepRecord| matches!(step.phase, StepPhase::Gripped | StepPhase::Intent);
    Ok(journal.last_step()?.filter(may_hang).map(|step| HeldBefore {
        object: step.intent.object,
        to: step.intent.to,
        tool_from_object: step.intent.tool_from_object,
        table: step.intent.table,
    }))
}

/// What a person has to know of a job that ended in the middle of a step.
fn cut_off_by(recovered: &Recovered) -> Option<CutOff> {
    let Recovered::Interrupted { step, .. } = recovered else { return None };
    Some(CutOff {
        object: step.intent.object.clone(),
        carrying: step.phase == StepPhase::Gripped,
        message: recovered.to_string(),
    })
}
