//! The folder of recordings: within its budget, and never the cause of a full disk.
//!
//! In: the configuration's budget and reserve, the files in the folder, the space left on the disk. Out:
//! which old recordings go, whether there is room to record at all, names of new files. A cell that records
//! for months must not end because of its own recordings: the journal needs the disk more. Of the time
//! without a job only the last minutes stay. What an earlier celld was killed over is made whole at the next
//! start.

use crate::config::cell::RecordingConfig;
use crate::io::recording::repair::{Repaired, is_whole, repair};
use crate::jobs::utc;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// A file is followed by the next one when it has this share of the budget: what is removed to make room is
/// then a small part of what is kept.
const PARTS: u64 = 8;

/// Files without a job that stay, the one that is written included.
const IDLE_FILES: usize = 2;

/// How file names of the time without a job begin.
const IDLE: &str = "idle-";

/// Of what a recording is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Segment {
    /// Of the job with this id.
    Job(String),
    /// Of the time without one.
    Idle,
}

impl Segment {
    /// How the names of its files begin.
    fn stem(&self) -> String {
        match self {
            Segment::Job(id) => format!("job-{id}-"),
            Segment::Idle => IDLE.to_string(),
        }
    }
}

/// A recording in the folder.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Kept {
    name: String,
    bytes: u64,
    /// Written last.
    changed: Option<SystemTime>,
}

/// The files of a job in the folder, the oldest first.
pub fn recordings_of(folder: &Path, job: &str) -> Vec<PathBuf> {
    let stem = Segment::Job(job.to_string()).stem();
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let is_of_it = |name: &String| {
        // Another job may be called as this one and more.
        let time = name.strip_prefix(&stem).unwrap_or_default().as_bytes();
        let dated = [(4, b'-'), (7, b'-'), (10, b'T')].iter().all(|(at, mark)| time.get(*at) == Some(mark));
        dated && time.iter().take(4).all(u8::is_ascii_digit) && name.ends_with(".mcap")
    };
    let mut names: Vec<String> =
        entries.filter_map(|entry| entry.file_name().into_string().ok()).filter(is_of_it).collect();
    names.sort();
    names.into_iter().map(|name| folder.join(name)).collect()
}

/// The folder and its limits.
#[derive(Clone, Debug)]
pub struct RecordingsFolder {
    folder: PathBuf,
    budget: u64,
    reserve: u64,
}

impl RecordingsFolder {
    /// The folder of the configuration, created where needed.
    ///
    /// # Errors
    /// It cannot be created, with the path.
    pub fn open(config: &RecordingConfig) -> Result<RecordingsFolder, String> {
        std::fs::create_dir_all(&config.folder)
            .map_err(|error| format!("{}: {error}", config.folder.display()))?;
        let RecordingConfig { folder, budget_bytes, reserve_bytes, .. } = config.clone();
        Ok(RecordingsFolder { folder, budget: budget_bytes, reserve: reserve_bytes })
    }

    /// True for a file that has become long enough, and for one that is not there any more.
    pub fn is_full(&self, file: &Path) -> bool {
        std::fs::metadata(file).map_or(true, |meta| meta.len() > self.budget / PARTS)
    }

    /// A name that no file has, by what it is of and the time.
    pub fn next(&self, segment: &Segment, unix_s: f64) -> PathBuf {
        let stem = format!("{}{}", segment.stem(), utc::text(unix_s).replace(':', ""));
        let names = std::iter::once(format!("{stem}.mcap"));
        // An underscore comes after a dot: the order of names stays that of age.
        let mut names = names.chain((2..).map(|number| format!("{stem}_{number:03}.mcap")));
        let free = names.find(|name| !self.folder.join(name).exists());
        self.folder.join(free.unwrap_or_default())
    }

    /// Removes old recordings until budget and reserve are kept; `current` stays.
    ///
    /// # Errors
    /// There is no room for a recording, or it cannot be found out, in one sentence.
    pub fn make_room(&self, current: Option<&Path>) -> Result<(), String> {
        let fail = |error: std::io::Error| format!("{}: {error}", self.folder.display());
        let free = cell_edge::files::free_bytes(&self.folder).map_err(|error| error.to_string())?;
        let kept = self.kept().map_err(fail)?;
        let current = current.and_then(|path| path.file_name()).map(|name| name.to_string_lossy());
        let old = idle_surplus(&kept);
        let beyond = surplus(&kept, current.as_deref(), self.budget, self.reserve.saturating_sub(free));
        let old = old.into_iter().map(|name| (name, "there are newer ones without a job"));
        let beyond = beyond.into_iter().map(|name| (name, "for the budget and the reserve"));
        for (name, why) in old.chain(beyond) {
            let path = self.folder.join(&name);
            match std::fs::remove_file(&path) {
                Ok(()) => tracing::info!("recording {name} was removed: {why}"),
                Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
                Err(error) => tracing::warn!("{}: {error}", path.display()),
            }
        }
        let free = cell_edge::files::free_bytes(&self.folder).map_err(|error| error.to_string())?;
        if free < self.reserve {
            return Err(format!(
                "{} MB are left on the disk of {}, {} MB are kept free",
                free >> 20,
                self.folder.display(),
                self.reserve >> 20
            ));
        }
        Ok(())
    }

    /// Makes whole what an earlier celld was killed over, on a thread of its own: such a file may be long.
    pub fn repair_in_the_background(&self) {
        // Before the first file of this run is begun.
        let broken: Vec<PathBuf> =
            self.kept().unwrap_or_default().into_iter().map(|file| self.folder.join(file.name)).collect();
        let broken: Vec<PathBuf> =
            broken.into_iter().filter(|path| matches!(is_whole(path), Ok(false))).collect();
        if broken.is_empty() {
            return;
        }
        std::thread::spawn(move || {
            cell_edge::priority::lower();
            for path in broken {
                match repair(&path) {
                    Ok(Repaired::Whole) => {}
                    Ok(Repaired::Mended { messages, .. }) => {
                        tracing::info!(
                            "recording {} had no end; {messages} messages are kept",
                            path.display()
                        );
                    }
                    Err(error) => tracing::warn!("{}", rearrange::document::chain::chain(&error)),
                }
            }
        });
    }

    /// Recordings by age; what has a name that celld does not give is no recording of its own.
    fn kept(&self) -> std::io::Result<Vec<Kept>> {
        let mut kept = Vec::new();
        for entry in std::fs::read_dir(&self.folder)? {
            let entry = entry?;
            let name = entry.file_name().to_string_lossy().into_owned();
            // What has gone since it was listed needs no room.
            let Some(meta) = entry.metadata().ok().filter(|meta| meta.is_file() && is_own(&name)) else {
                continue;
            };
            kept.push(Kept { name, bytes: meta.len(), changed: meta.modified().ok() });
        }
        kept.sort_by(|a, b| (a.changed, &a.name).cmp(&(b.changed, &b.name)));
        Ok(kept)
    }
}

/// A name as [`RecordingsFolder::next`] gives it, or as earlier versions did.
fn is_own(name: &str) -> bool {
    let Some(stem) = name.strip_suffix(".mcap") else { return false };
    if !["job-", IDLE, "run-"].iter().any(|start| stem.starts_with(start)) {
        return false;
    }
    // `2026-11-21T080000Z`, and where there is another of that second `_002`.
    let stem = stem
        .rsplit_once('_')
        .filter(|(_, number)| number.parse::<u32>().is_ok())
        .map_or(stem, |(stem, _)| stem);
    let from = stem.len().checked_sub(18).filter(|from| stem.is_char_boundary(*from));
    from.is_some_and(|from| {
        stem[from..].bytes().zip(b"0000-00-00T000000Z").all(|(c, shape)| match shape {
            b'0' => c.is_ascii_digit(),
            other => c == *other,
        })
    })
}

/// The names of the oldest recordings without a job, all but the last.
fn idle_surplus(kept: &[Kept]) -> Vec<String> {
    let idle: Vec<&Kept> = kept.iter().filter(|file| file.name.starts_with(IDLE)).collect();
    let surplus = idle.len().saturating_sub(IDLE_FILES);
    idle[..surplus].iter().map(|file| file.name.clone()).collect()
}

/// Names of the oldest recordings without which the others keep `budget` and at least `wanted` bytes come
/// free.
fn surplus(kept: &[Kept], current: Option<&str>, budget: u64, wanted: u64) -> Vec<String> {
    let mut total: u64 = kept.iter().map(|file| file.bytes).sum();
    let mut freed = 0;
    let mut names = Vec::new();
    for file in kept.iter().filter(|file| current != Some(file.name.as_str())) {
        if total <= budget && freed >= wanted {
            break;
        }
        total -= file.bytes;
        freed += file.bytes;
        names.push(file.name.clone());
    }
    names
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kept() -> Vec<Kept> {
        ["run-1.mcap", "run-2.mcap", "run-3.mcap"]
            .map(|name| Kept { name: name.into(), bytes: 100, changed: None })
            .to_vec()
    }

    #[test]
    fn the_oldest_go_until_the_budget_and_the_reserve_are_kept() {
        let names = |budget, wanted, current| surplus(&kept(), current, budget, wanted);
        assert_eq!(names(300, 0, None), [""; 0]);
        assert_eq!(names(299, 0, None), ["run-1.mcap"]);
        assert_eq!(names(100, 0, None), ["run-1.mcap", "run-2.mcap"]);
        assert_eq!(names(1000, 101, None), ["run-1.mcap", "run-2.mcap"]);
        assert_eq!(names(0, 0, Some("run-3.mcap")), ["run-1.mcap", "run-2.mcap"], "what is written stays");
    }

    fn folder(of: &Path, budget: u64, reserve: u64) -> RecordingsFolder {
        RecordingsFolder { folder: of.to_path_buf(), budget, reserve }
    }

    #[test]
    fn a_job_has_its_own_files_and_not_those_of_one_that_is_called_longer() {
        let folder = tempfile::tempdir().unwrap();
        for name in [
            "job-a-2026-11-26T041000Z_002.mcap",
            "job-a-2026-11-26T041000Z.mcap",
            "job-a-b-2026-11-26T041000Z.mcap",
            "job-a-2026-11-26T041000Z.txt",
            "idle-2026-11-26T041000Z.mcap",
        ] {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        let of = |job: &str| -> Vec<String> {
            let files = recordings_of(folder.path(), job);
            files.iter().map(|path| path.file_name().unwrap().to_string_lossy().into_owned()).collect()
        };
        assert_eq!(of("a"), ["job-a-2026-11-26T041000Z.mcap", "job-a-2026-11-26T041000Z_002.mcap"]);
        assert_eq!((of("a-b").len(), of("c").len()), (1, 0));
        assert!(recordings_of(Path::new("/nowhere"), "a").is_empty());
    }

    #[test]
    fn only_recordings_are_removed_and_a_full_disk_is_named() {
        let folder_on_disk = tempfile::tempdir().unwrap();
        let path = |name: &str| folder_on_disk.path().join(name);
        let [first, second] = ["run-2026-11-21T080000Z.mcap", "run-2026-11-21T080000Z_002.mcap"];
        for name in [first, second, "notes.txt", "run-before-crash.mcap"] {
            std::fs::write(path(name), [0; 100]).unwrap();
        }
        // The calendar in the names is not the age: the one that was written first goes first.
        let at = SystemTime::UNIX_EPOCH + std::time::Duration::from_secs(1);
        std::fs::File::options().append(true).open(path(second)).unwrap().set_modified(at).unwrap();
        folder(folder_on_disk.path(), 150, 0).make_room(None).unwrap();
        assert!(!path(second).exists() && path(first).exists());
        assert!(path("notes.txt").exists() && path("run-before-crash.mcap").exists());
        let fault = folder(folder_on_disk.path(), 150, u64::MAX).make_room(None).unwrap_err();
        assert!(fault.contains("MB are left on the disk"), "{fault}");
        assert!(!path(first).exists() && path("run-before-crash.mcap").exists());
    }

    #[test]
    fn names_are_never_used_twice() {
        let on_disk = tempfile::tempdir().unwrap();
        let folder = folder(on_disk.path(), 1, 0);
        let first = folder.next(&Segment::Idle, 0.0);
        std::fs::write(&first, [0; 2]).unwrap();
        let second = folder.next(&Segment::Idle, 0.0);
        assert!(first < second, "{second:?}");
        assert!(folder.is_full(&first) && folder.is_full(&second), "one that is gone is written no more");
        std::fs::write(&second, []).unwrap();
        assert!(!folder.is_full(&second));
    }
}
