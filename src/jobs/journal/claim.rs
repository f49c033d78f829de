//! The lookup that makes claims happen once: a job, and the id under which it is claimed.
//!
//! In: a checked job file, the transaction that is to claim it. Out: a free id, or what is known already.

use crate::jobs::record::JobSpec;
use cell_edge::files::FileIdentity;
use rusqlite::{OptionalExtension, Transaction};

/// A checked job file about to be claimed.
#[derive(Clone, Debug)]
pub struct NewJob<'a> {
    /// From the file, or made from time, name and hash.
    pub id: &'a str,
    /// Name of the file.
    pub name: &'a str,
    /// Hash of the file, lower-case hex.
    pub sha256: &'a str,
    /// The file, verbatim.
    pub text: &'a str,
    /// What it requests.
    pub spec: &'a JobSpec,
    /// The very file in `incoming`.
    pub source: FileIdentity,
}

/// What came of a claim.
#[derive(Clone, Debug, PartialEq)]
pub enum Claim {
    /// It is ours now, and on disk.
    Claimed {
        /// The job's unique id.
        id: String,
    },
    /// The same content is known under this id.
    Duplicate {
        /// The first job.
        of: String,
    },
    /// The id is known with other content.
    Conflict {
        /// The first job.
        with: String,
    },
}

/// The id under which a job can be claimed, or what is known already.
///
/// An id that the file states is held to: the same content again is a repeated submission, other content a
/// mistake. With `rerun: true`, and for names made here, a number makes the id unique.
pub(super) fn free_id(
    transaction: &Transaction,
    job: &NewJob,
) -> Result<Result<String, Claim>, rusqlite::Error> {
    let sha256_of = |id: &str| -> Result<Option<String>, rusqlite::Error> {
        let select = "SELECT sha256 FROM jobs WHERE id = ?1";
        transaction.query_row(select, [id], |row| row.get(0)).optional()
    };
    let Some(sha256) = sha256_of(job.id)? else {
        return Ok(Ok(job.id.to_owned()));
    };
    if job.spec.id.is_some() && !job.spec.rerun {
        let id = job.id.to_owned();
        let same = sha256 == job.sha256;
        return Ok(Err(if same { Claim::Duplicate { of: id } } else { Claim::Conflict { with: id } }));
    }
    let mut number = 2_u32;
    loop {
        let id = format!("{}.{number}", job.id);
        if sha256_of(&id)?.is_none() {
            return Ok(Ok(id));
        }
        number += 1;
    }
}
