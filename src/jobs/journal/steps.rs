//! The step journal: what was meant before anything moves, and how far it got.
//!
//! In: intents and phases. Out: numbered steps. At most one step of a job is open; the database's own index
//! holds that too.

use crate::jobs::journal::rows::encode;
use crate::jobs::journal::{Journal, JournalError, Recovered};
use crate::jobs::record::{JobState, StepIntent, StepPhase, StepRecord};
use cell_machine::code::Code;
use rusqlite::{OptionalExtension, Row, params};

impl Journal {
    /// Writes down a step before its first byte of motion leaves the PC, and returns its number.
    ///
    /// # Errors
    /// [`JournalError::WrongState`] unless the job is active and has no open step: no motion is ordered
    /// twice.
    pub fn step_intent(&mut self, id: &str, intent: &StepIntent, unix_s: f64) -> Result<u32, JournalError> {
        let job = self.job(id)?.ok_or_else(|| JournalError::UnknownJob { id: id.to_owned() })?;
        let open = self.steps(id)?.iter().any(|step| step.phase.is_open());
        if job.state != JobState::Active || open {
            let state = if open { "in the middle of a step" } else { job.state.as_str() };
            return Err(JournalError::WrongState { id: id.to_owned(), state, action: "begin a step" });
        }
        let text = encode(intent);
        self.transact(|transaction| {
            let next = "SELECT coalesce(max(step), 0) + 1 FROM steps WHERE job = ?1";
            let step: u32 = transaction.query_row(next, [job.sequence], |row| row.get(0))?;
            transaction.execute(
                "INSERT INTO steps (job, step, intent, phase, changed) VALUES (?1, ?2, ?3, 'intent', ?4)",
                params![job.sequence, step, text, unix_s],
            )?;
            Ok(step)
        })
    }

    /// The vacuum holds: the object left the table.
    ///
    /// # Errors
    /// The job has no open step of this number ([`JournalError::WrongStep`]), or SQLite fails
    /// ([`JournalError::Database`]).
    pub fn step_gripped(&mut self, id: &str, step: u32, unix_s: f64) -> Result<(), JournalError> {
        self.step_phase(id, step, StepPhase::Gripped, unix_s)
    }

    /// The vacuum is off at the place.
    ///
    /// # Errors
    /// As [`Journal::step_gripped`].
    pub fn step_released(&mut self, id: &str, step: u32, unix_s: f64) -> Result<(), JournalError> {
        self.step_phase(id, step, StepPhase::Released, unix_s)
    }

    /// The step is over.
    ///
    /// # Errors
    /// As [`Journal::step_gripped`].
    pub fn step_done(&mut self, id: &str, step: u32, unix_s: f64) -> Result<(), JournalError> {
        self.step_phase(id, step, StepPhase::Done, unix_s)
    }

    /// The step was given up after a fault that is understood; a new look has to come first.
    ///
    /// # Errors
    /// As [`Journal::step_gripped`].
    pub fn step_abandoned(&mut self, id: &str, step: u32, unix_s: f64) -> Result<(), JournalError> {
        self.step_phase(id, step, StepPhase::Abandoned, unix_s)
    }

    /// What the last step gripped, or meant to, does not hang on the cups any more, after its job's end;
    /// nothing where it was let go before.
    ///
    /// # Errors
    /// The database cannot be written.
    pub fn let_go(&mut self, how: &str, unix_s: f64) -> Result<(), JournalError> {
        let update = "UPDATE steps SET changed = ?1, note = ?2,
             phase = CASE phase WHEN 'gripped' THEN 'released' ELSE 'abandoned' END
             WHERE phase IN ('gripped','intent') AND rowid = (SELECT max(rowid) FROM steps)";
        self.database.execute(update, params![unix_s, how]).map(|_| ()).map_err(|e| self.fail(e))
    }

    fn step_phase(&mut self, id: &str, step: u32, to: StepPhase, unix_s: f64) -> Result<(), JournalError> {
        let update = "UPDATE steps SET phase = ?3, changed = ?4,
             gripped = CASE ?3 WHEN 'gripped' THEN ?4 ELSE gripped END WHERE step = ?2
             AND job = (SELECT sequence FROM jobs WHERE id = ?1) AND phase IN ('intent','gripped','released')";
        let changed =
            self.transact(|transaction| transaction.execute(update, params![id, step, to.as_str(), unix_s]))?;
        if changed == 1 {
            return Ok(());
        }
        Err(JournalError::WrongStep { id: id.to_owned(), step, action: to.as_str() })
    }

    /// The job whose step was the last one of all, where it was cut off in it and nothing was let go since.
    ///
    /// # Errors
    /// As [`Journal::active`].
    pub fn cut_off_before(&self) -> Result<Option<Recovered>, JournalError> {
        let select = "SELECT id FROM jobs WHERE state = 'interrupted'
                      AND sequence = (SELECT job FROM steps ORDER BY rowid DESC LIMIT 1)";
        let id: Option<String> =
            self.database.query_row(select, [], |row| row.get(0)).optional().map_err(|e| self.fail(e))?;
        let (Some(id), Some(step)) = (id, self.last_step()?) else { return Ok(None) };
        let result = self.job(&id)?.and_then(|job| job.result);
        let codes = [Code::Interrupted, Code::InterruptedCarrying].map(|code| code.to_string());
        let cut_off = result.is_some_and(|result| codes.contains(&result.code));
        let open = matches!(step.phase, StepPhase::Intent | StepPhase::Gripped);
        Ok((cut_off && open).then_some(Recovered::Interrupted { id, step }))
    }

    /// All steps of a job, in order.
    ///
    /// # Errors
    /// As [`Journal::active`].
    pub fn steps(&self, id: &str) -> Result<Vec<StepRecord>, JournalError> {
        let select = format!(
            "SELECT {} FROM steps WHERE job = (SELECT sequence FROM jobs WHERE id = ?1) ORDER BY step",
            step_columns(self.version)
        );
        let mut statement = self.database.prepare(&select).map_err(|e| self.fail(e))?;
        let rows = statement
            .query_map([id], step_row)
            .and_then(Iterator::collect::<Result<Vec<_>, _>>)
            .map_err(|e| self.fail(e))?;
        rows.into_iter().map(|row| self.step_record(row)).collect()
    }

    /// The step that was begun last, of whatever job: where it was gripped and not let go, its object may
    /// still hang on the cups.
    ///
    /// # Errors
    /// SQLite fails ([`JournalError::Database`]), or the row is damaged ([`JournalError::Damaged`]).
    pub fn last_step(&self) -> Result<Option<StepRecord>, JournalError> {
        let columns = step_columns(self.version);
        let select = format!("SELECT {columns} FROM steps ORDER BY rowid DESC LIMIT 1");
        let row = self.database.query_row(&select, [], step_row);
        match row.optional().map_err(|e| self.fail(e))? {
            Some(row) => self.step_record(row).map(Some),
            None => Ok(None),
        }
    }

    /// The step in this row of the table.
    pub(super) fn step_at(&self, row: i64) -> Result<StepRecord, JournalError> {
        let select = format!("SELECT {} FROM steps WHERE rowid = ?1", step_columns(self.version));
        let row = self.database.query_row(&select, [row], step_row).map_err(|e| self.fail(e))?;
        self.step_record(row)
    }

    fn step_record(&self, row: StepRow) -> Result<StepRecord, JournalError> {
        let StepRow { step, intent, phase, changed_unix_s, gripped_unix_s, note } = row;
        let phase = phase.parse::<StepPhase>().map_err(|_| self.damaged("steps.phase", &phase))?;
        let intent = self.decode("steps.intent", &intent)?;
        Ok(StepRecord { step, intent, phase, changed_unix_s, gripped_unix_s, note })
    }
}

/// The columns of a step, text not decoded yet.
struct StepRow {
    step: u32,
    intent: String,
    phase: String,
    changed_unix_s: f64,
    gripped_unix_s: Option<f64>,
    note: Option<String>,
}

/// Columns in the order of [`StepRow`]; older databases lack the last ones.
fn step_columns(version: i64) -> &'static str {
    match version {
        ..3 => "step, intent, phase, changed, NULL, NULL",
        3 => "step, intent, phase, changed, gripped, NULL",
        4.. => "step, intent, phase, changed, gripped, note",
    }
}

fn step_row(row: &Row) -> Result<StepRow, rusqlite::Error> {
    Ok(StepRow {
        step: row.get(0)?,
        intent: row.get(1)?,
        phase: row.get(2)?,
        changed_unix_s: row.get(3)?,
        gripped_unix_s: row.get(4)?,
        note: row.get(5)?,
    })
}
