//! The ends of jobs, as the journal has them.
//!
//! In: the journal, read as any other process reads it, and the job that the status names. Out: each job
//! that ended since the last look, once, however it ended: worked on, cancelled while it waited, over
//! between two statuses. The status does not show all of them, and it does not say how.

use crate::jobs::journal::places::Since;
use crate::jobs::journal::{Journal, JournalError};
use crate::jobs::record::JobRecord;
use std::cmp::Ordering;
use std::collections::BTreeSet;

/// Which jobs had not ended, and how far the journal was read.
#[derive(Debug, Default)]
pub struct Ends {
    open: BTreeSet<String>,
    read_to: i64,
}

impl Ends {
    /// From here on: what has ended before is of no interest.
    ///
    /// # Errors
    /// As [`Ends::next`].
    pub fn from_now(journal: &Journal) -> Result<Ends, JournalError> {
        let Since { open, last, .. } = journal.since(i64::MAX)?;
        Ok(Ends { open, read_to: last })
    }

    /// Jobs that have ended since the last look, in the order of their ends. One that the status still shows
    /// (`active`) is kept for the next look: its last step is reported before its end. A damaged row is left
    /// out: it must not keep back the ends of all others.
    ///
    /// # Errors
    /// SQLite fails ([`JournalError::Database`]); the next look begins where this one did.
    pub fn next(&mut self, journal: &Journal, active: Option<&str>) -> Result<Vec<JobRecord>, JournalError> {
        let Since { mut open, newer, last } = journal.since(self.read_to)?;
        let mut ended: Vec<JobRecord> = Vec::new();
        let over = self.open.iter().chain(&newer).filter(|id| !open.contains(*id)).collect::<Vec<_>>();
        for id in over {
            if active == Some(id) {
                open.insert(id.clone());
                continue;
            }
            match journal.job(id) {
                Ok(job) => ended.extend(job),
                Err(error @ JournalError::Damaged { .. }) => {
                    tracing::warn!(job = id, %error, "the end of a job is not reported to the fleet");
                }
                Err(error) => return Err(error),
            }
        }
        ended.sort_by(|a, b| a.ended_unix_s.partial_cmp(&b.ended_unix_s).unwrap_or(Ordering::Equal));
        *self = Ends { open, read_to: self.read_to.max(last) };
        Ok(ended)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::journal::{Claim, NewJob};
    use crate::jobs::record::{JobResult, JobSpec};
    use cell_edge::files::FileIdentity;
    use cell_machine::code::JobStatus;

    const NOW: f64 = 1_795_248_000.0;

    fn claim(journal: &mut Journal, id: &str) {
        let source = FileIdentity { device: 1, inode: 2, size: 3, modified_ns: 4 };
        let spec = JobSpec { id: Some(id.to_string()), ..JobSpec::default() };
        let job = NewJob { id, name: "job.yaml", sha256: "00", text: "version: 1", spec: &spec, source };
        assert_eq!(journal.claim(&job, NOW).unwrap(), Claim::Claimed { id: id.to_string() });
    }

    fn finish(journal: &mut Journal, id: &str, status: JobStatus, after_s: f64) {
        let result = JobResult::sample(id, status);
        journal.finish(id, &result, NOW + after_s).unwrap();
    }

    fn ids(ended: Vec<JobRecord>) -> Vec<String> {
        ended.into_iter().map(|job| job.id).collect()
    }

    #[test]
    fn every_end_is_reported_once_however_a_job_ended() {
        let folder = tempfile::tempdir().unwrap();
        let mut journal = Journal::open(&folder.path().join("history.sqlite")).unwrap();
        claim(&mut journal, "before");
        finish(&mut journal, "before", JobStatus::Done, 1.0);
        claim(&mut journal, "waits");
        let mut ends = Ends::from_now(&journal).unwrap();
        assert_eq!(ids(ends.next(&journal, None).unwrap()), [""; 0]);
        // Three come. One is cancelled while it waits, as is the one from before; one is done between two
        // looks.
        claim(&mut journal, "cancelled");
        claim(&mut journal, "quick");
        claim(&mut journal, "stays");
        finish(&mut journal, "cancelled", JobStatus::Cancelled, 2.0);
        journal.start("quick", NOW).unwrap();
        finish(&mut journal, "quick", JobStatus::Done, 3.0);
        finish(&mut journal, "waits", JobStatus::Cancelled, 4.0);
        // The status shows the quick one still.
        assert_eq!(ids(ends.next(&journal, Some("quick")).unwrap()), ["cancelled", "waits"]);
        assert_eq!(ids(ends.next(&journal, None).unwrap()), ["quick"]);
        assert_eq!(ids(ends.next(&journal, None).unwrap()), [""; 0]);
        // One that goes back to the queue has not ended.
        journal.start("stays", NOW).unwrap();
        journal.requeue("stays").unwrap();
        assert_eq!(ids(ends.next(&journal, None).unwrap()), [""; 0]);
        finish(&mut journal, "stays", JobStatus::Failed, 5.0);
        assert_eq!(ids(ends.next(&journal, None).unwrap()), ["stays"]);
    }

    #[test]
    fn a_damaged_row_does_not_keep_back_the_others() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("history.sqlite");
        let mut journal = Journal::open(&path).unwrap();
        let mut ends = Ends::from_now(&journal).unwrap();
        for id in ["a", "b"] {
            claim(&mut journal, id);
            finish(&mut journal, id, JobStatus::Done, 1.0);
        }
        let other = rusqlite::Connection::open(&path).unwrap();
        assert_eq!(other.execute("UPDATE jobs SET spec = '?' WHERE id = 'a'", []).unwrap(), 1);
        assert!(matches!(journal.job("a"), Err(JournalError::Damaged { .. })));
        assert_eq!(ids(ends.next(&journal, None).unwrap()), ["b"]);
        assert_eq!(ids(ends.next(&journal, None).unwrap()), [""; 0]);
    }
}
