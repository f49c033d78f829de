//! Events of a fleet in words, for terminal and page. Pure.

use cell_fleet::payloads::{Event, What};

/// An event in words.
pub fn words(event: &Event) -> String {
    match &event.what {
        What::Looked { objects, residual_mm } => {
            let residual = residual_mm.map(|mm| format!(", markers off by {mm:.2} mm")).unwrap_or_default();
            format!("looked: {objects} objects{residual}")
        }
        What::Planned { moves, lower_bound, waits } => {
            let bound = lower_bound.map(|bound| format!(", lower bound {bound:.0}")).unwrap_or_default();
            let waits = if *waits { "; waits for approval, see `celld fleet status`" } else { "" };
            format!("planned: {moves} moves{bound}{waits}")
        }
        What::Approved { by, agreed: true } => format!("approved by {by}"),
        What::Approved { by, agreed: false } => format!("rejected by {by}"),
        What::Step { step, of } => format!("move {step} of {of} made"),
        What::Done { outcome } => {
            format!(
                "{} after {} moves and {:.0} s: {}",
                outcome.status, outcome.moves, outcome.seconds, outcome.message
            )
        }
        What::Fault { code, message } => format!("{message} ({code})"),
        What::Gap { first, lost } => format!("{lost} events from number {first} on were given up"),
    }
}
