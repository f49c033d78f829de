//! A recording whose writer was killed, made whole.
//!
//! In: a file without an end. Out: the same file with everything that can be read of it, an index and an
//! end, so that every reader opens it; what was being written in the last second before the end is lost. The
//! new file takes the old one's place only when it is complete and on disk.

use crate::io::recording::options;
use crate::io::recording::read::{Item, Items, ReadError};
use cell_edge::files::{FileError, rewrite};
use mcap::{MAGIC, McapError, Message};
use std::borrow::Cow;
use std::fs::File;
use std::io::{BufReader, BufWriter, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Why a recording could not be repaired; the file is as it was.
#[derive(Debug, thiserror::Error)]
pub enum RepairError {
    /// It cannot be read.
    #[error("read {path}")]
    Read {
        /// The file.
        path: PathBuf,
        /// The cause.
        #[source]
        source: std::io::Error,
    },
    /// It does not begin as a recording does.
    #[error("{path} is no recording: it does not begin as an MCAP file does")]
    NoRecording {
        /// The file.
        path: PathBuf,
    },
    /// The new one cannot be written.
    #[error(transparent)]
    Write(#[from] FileError),
}

/// What became of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Repaired {
    /// It has its end: nothing was done.
    Whole,
    /// It has one now.
    Mended {
        /// Messages that were kept.
        messages: u64,
        /// Where the file is as it was, if it did not just break off: what lies behind a damage is not lost.
        kept: Option<PathBuf>,
    },
}

/// True when the file ends as a finished recording does.
///
/// # Errors
/// It cannot be read.
pub fn is_whole(path: &Path) -> std::io::Result<bool> {
    let mut file = File::open(path)?;
    let length = file.metadata()?.len();
    let mut end = [0; MAGIC.len()];
    if length < 2 * end.len() as u64 {
        return Ok(false);
    }
    file.seek(SeekFrom::End(-(end.len() as i64)))?;
    file.read_exact(&mut end)?;
    Ok(end == *MAGIC)
}

/// Repairs the file where it needs it.
///
/// # Errors
/// [`RepairError`]; the file is as it was.
pub fn repair(path: &Path) -> Result<Repaired, RepairError> {
    let fail = |source| RepairError::Read { path: path.to_owned(), source };
    if is_whole(path).map_err(fail)? {
        return Ok(Repaired::Whole);
    }
    let mut file = File::open(path).map_err(fail)?;
    let mut start = [0; MAGIC.len()];
    let begins = file.read_exact(&mut start).is_ok() && start == *MAGIC;
    if !begins {
        return Err(RepairError::NoRecording { path: path.to_owned() });
    }
    file.seek(SeekFrom::Start(0)).map_err(fail)?;
    let source = BufReader::new(file);
    let mut kept = None;
    let messages = rewrite(path, |target| {
        let (messages, damaged) = copy(source, target).map_err(std::io::Error::other)?;
        if damaged {
            let beside = path.with_extension("mcap.broken");
            std::fs::hard_link(path, &beside)?;
            kept = Some(beside);
        }
        Ok(messages)
    })?;
    Ok(Repaired::Mended { messages, kept })
}

/// Everything that can be read of `source`: how many messages, and whether more may lie behind a damage.
fn copy(source: impl Read, target: &mut File) -> Result<(u64, bool), McapError> {
    let mut writer = options().create(BufWriter::new(target))?;
    let (mut messages, mut damaged) = (0, false);
    for item in Items::new(source) {
        match item {
            Ok(Item::About(metadata)) => writer.write_metadata(&metadata)?,
            Ok(Item::Message(entry)) => {
                messages += 1;
                writer.write(&Message {
                    channel: entry.channel,
                    sequence: entry.sequence,
                    log_time: entry.log_time,
                    publish_time: entry.log_time,
                    data: Cow::Owned(entry.data),
                })?;
            }
            Err(ReadError::File(error)) => return Err(McapError::Io(error)),
            Err(ReadError::Content(McapError::UnexpectedEof | McapError::UnexpectedEoc)) => {}
            Err(ReadError::Content(_)) => damaged = true,
        }
    }
    writer.finish()?;
    Ok((messages, damaged))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::recording::Recording;
    use cell_values::time::Timestamp;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// A recording of `count` messages with a chunk for every seven.
    fn recorded(path: &Path, count: u64) {
        let mut recording = Recording::create(path, 1_000.0).unwrap();
        let mut noise = ChaCha8Rng::seed_from_u64(3);
        for k in 0..count {
            let bytes: Vec<u8> = (0..noise.random_range(0..400)).map(|_| noise.random()).collect();
            recording.piece("/replay/event", Timestamp::from_nanos(k), &bytes).unwrap();
            if k % 7 == 6 {
                recording.flush().unwrap();
            }
        }
        recording.finish().unwrap();
    }

    fn messages(bytes: &[u8]) -> Vec<Vec<u8>> {
        let items = Items::new(bytes).map_while(Result::ok);
        let data =
            items.filter_map(|item| if let Item::Message(entry) = item { Some(entry.data) } else { None });
        data.collect()
    }

    /// Wherever the file was cut, every finished chunk is kept, and readers that want an index have one.
    #[test]
    fn a_file_cut_anywhere_keeps_every_finished_chunk() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.mcap");
        recorded(&path, 200);
        assert_eq!(repair(&path).unwrap(), Repaired::Whole);
        let whole = std::fs::read(&path).unwrap();
        let all = messages(&whole);
        assert_eq!(all.len(), 200);
        let mut random = ChaCha8Rng::seed_from_u64(11);
        let (mut kept, cuts) = (0, 1_000);
        for _ in 0..cuts {
            let at = random.random_range(MAGIC.len()..whole.len());
            std::fs::write(&path, &whole[..at]).unwrap();
            let readable = messages(&whole[..at]);
            let Repaired::Mended { messages: count, kept: None } = repair(&path).unwrap() else {
                panic!("cut at {at}")
            };
            let mended = std::fs::read(&path).unwrap();
            assert_eq!(messages(&mended), readable, "cut at {at}");
            assert_eq!(readable, all[..readable.len()], "cut at {at}");
            assert_eq!(count as usize, readable.len());
            let summary = mcap::Summary::read(&mended).unwrap().unwrap();
            assert_eq!(summary.stats.unwrap().message_count, count);
            assert!(is_whole(&path).unwrap());
            kept += readable.len();
        }
        assert!(kept > 60 * cuts, "half of 200 on average: {kept} of {cuts} files");
    }

    /// Anything may lie in the folder: it stays as it is, and nothing panics.
    #[test]
    fn what_is_no_recording_stays_as_it_is() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.mcap");
        recorded(&path, 30);
        let whole = std::fs::read(&path).unwrap();
        let mut random = ChaCha8Rng::seed_from_u64(5);
        for bytes in [vec![], b"notes".to_vec(), vec![0; 100]] {
            std::fs::write(&path, &bytes).unwrap();
            assert!(matches!(repair(&path), Err(RepairError::NoRecording { .. })));
            assert_eq!(std::fs::read(&path).unwrap(), bytes);
        }
        for _ in 0..300 {
            let mut spoilt = whole[..whole.len() - 5].to_vec();
            for _ in 0..random.random_range(1..20) {
                let at = random.random_range(MAGIC.len()..spoilt.len());
                spoilt[at] = random.random();
            }
            std::fs::write(&path, &spoilt).unwrap();
            let Ok(Repaired::Mended { kept, .. }) = repair(&path) else { panic!("it begins as a recording") };
            assert!(is_whole(&path).unwrap());
            if let Some(kept) = kept {
                assert_eq!(std::fs::read(&kept).unwrap(), spoilt, "what lies behind the damage stays");
                std::fs::remove_file(kept).unwrap();
            }
        }
    }
}
