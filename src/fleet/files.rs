//! The files of a job for a person of the fleet: what the cell's own page shows of it.
//!
//! In: the configuration, the state folder, the kinds. Out: files with plain names; one that is not there
//! is left out. A job that is not known is an error.

use crate::config::cell::CellConfig;
use crate::daemon::job_report::job_report;
use crate::daemon::recordings_folder::recordings_of;
use crate::jobs::journal::Journal;
use crate::jobs::state::StateFolder;
use crate::report::html::html;
use cell_fleet::files::{Content, FileKind, FileToSend, is_file_name};
use rearrange::document::chain::chain;
use serde_json::json;
use std::path::PathBuf;

/// The files of a job, of these kinds.
///
/// # Errors
/// There is no such job, or the journal cannot be read.
pub fn files_of(
    config: &CellConfig,
    state: &StateFolder,
    id: &str,
    kinds: &[FileKind],
) -> Result<Vec<FileToSend>, String> {
    let unknown = || format!("no job {id} is known at this cell");
    let path = state.journal();
    if !path.exists() {
        return Err(unknown());
    }
    let journal = Journal::open_to_read(&path).map_err(|error| chain(&error))?;
    let job = journal.job(id).map_err(|error| chain(&error))?.ok_or_else(unknown)?;
    let steps = journal.steps(id).map_err(|error| chain(&error))?;
    let folder = journal.folder_of(id).ok().flatten().map(|place| state.root().join("jobs").join(place));
    let mut files = Vec::new();
    for kind in kinds {
        match kind {
            FileKind::Plan => files.extend(there(folder.as_ref(), &["plan.svg"])),
            FileKind::Pictures => files.extend(there(folder.as_ref(), &["plan.jpg", "end.jpg"])),
            FileKind::Report => {
                let page = html(&job_report(&job, &steps, config, folder.as_deref()));
                files.push(made("report.html", page.into_bytes()));
            }
            FileKind::Result => {
                let result = json!({ "id": job.id, "state": job.state.as_str(), "result": job.result });
                files.push(made("result.json", result.to_string().into_bytes()));
            }
            FileKind::Recording => files.extend(recordings(config, id)),
        }
    }
    Ok(files)
}

fn made(name: &str, bytes: Vec<u8>) -> FileToSend {
    FileToSend { name: name.to_string(), content: Content::Bytes(bytes) }
}

/// Those of the names that are files of the folder.
fn there(folder: Option<&PathBuf>, names: &[&str]) -> Vec<FileToSend> {
    let file = |name: &&str| {
        let path = folder?.join(name);
        path.is_file().then(|| FileToSend { name: name.to_string(), content: Content::File(path) })
    };
    names.iter().filter_map(file).collect()
}

fn recordings(config: &CellConfig, id: &str) -> Vec<FileToSend> {
    let found = config.recording.as_ref().map(|to| recordings_of(&to.folder, id)).unwrap_or_default();
    let file = |path: PathBuf| {
        let name = path.file_name()?.to_str().filter(|name| is_file_name(name))?.to_string();
        Some(FileToSend { name, content: Content::File(path) })
    };
    found.into_iter().filter_map(file).collect()
}
