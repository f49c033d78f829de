//! `celld fleet fetch`: pictures, plans and recordings of a job, from the cell that did it.
//!
//! In: a job's id, what is wanted. Out: files in a folder, their paths on stdout. The cell puts them into
//! the fleet's object store on request, and they are read from there: only what is wanted is
//! copied.

use crate::cli::fleet::reach::{Failure, ReachArgs};
use crate::cli::task::outln;
use cell_fleet::files::FileKind;
use cell_fleet::subjects::is_job_id;
use clap::Args;
use std::path::PathBuf;

/// `celld fleet fetch`
#[derive(Args, Debug)]
pub struct FetchArgs {
    /// The job's id
    job: String,
    /// What: plan, pictures, report, result, recording; several with commas
    #[arg(long, value_name = "WHAT", default_value = "plan,pictures,report,result", value_delimiter = ',', value_parser = kind)]
    what: Vec<FileKind>,
    /// The cell [default: the one that has or had the job]
    #[arg(long, value_name = "NAME")]
    cell: Option<String>,
    /// Folder in which one of the job's name is made
    #[arg(long, value_name = "DIR", default_value = "out/fleet-files")]
    out: PathBuf,
    #[command(flatten)]
    reach: ReachArgs,
}

/// Files of one job: a recording comes in several.
const FILES_MOST: usize = 100;

fn kind(word: &str) -> Result<FileKind, String> {
    let known = || FileKind::ALL.map(FileKind::as_str).join(", ");
    FileKind::of(word).ok_or_else(|| format!("write one of {}", known()))
}

/// # Errors
/// One sentence for the terminal: what is wrong with the arguments, the server or the answer.
pub async fn fetch(args: &FetchArgs) -> Result<(), Failure> {
    if !is_job_id(&args.job) {
        return Err(Failure::Usage(format!("{:?} is no id of a job", args.job)));
    }
    let client = args.reach.client().await?;
    let cell = match &args.cell {
        Some(cell) => cell.clone(),
        None => {
            let claim = client.claim_of(&args.job).await?.map(|claim| claim.cell);
            claim.filter(|cell| !cell.is_empty()).ok_or_else(|| {
                Failure::Failed(format!(
                    "no cell has had job {} yet; for one of a cell's own: --cell",
                    args.job
                ))
            })?
        }
    };
    let answer = client.request_for_files(&cell, &args.job, &args.what).await?;
    if !answer.accepted {
        return Err(Failure::Failed(format!("{cell}: {}", answer.message)));
    }
    let folder = args.out.join(&args.job);
    std::fs::create_dir_all(&folder)
        .map_err(|error| Failure::Failed(format!("{}: {error}", folder.display())))?;
    if answer.files.len() > FILES_MOST {
        return Err(Failure::Failed(format!(
            "{cell}: it names {} files, no job has as many",
            answer.files.len()
        )));
    }
    for name in &answer.files {
        let path = client.fetch(&cell, &args.job, name, &folder).await?;
        outln!("{}", path.display());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_can_be_fetched_is_named() {
        assert_eq!(kind("recording"), Ok(FileKind::Recording));
        assert_eq!(kind("all"), Err("write one of plan, pictures, report, result, recording".to_string()));
    }
}
