//! A calibration that is kept: its files, and those that were there before.
//!
//! In: the files as data, where the configuration has them, the state folder. Out: the files written,
//! whole sets only: a lens alone would not fit the mount beside it. The ones before lie in the state
//! folder's `calibration`. Where celld may not write (a service and `/etc/celld`), the new ones lie there
//! for a person to put in their place.

use crate::config::calibrated::write_calibration;
use crate::config::cell::CalibrationFiles;
use cell_calibration::files::set::CalibrationSet;
use cell_edge::files::{FileError, create_folder, write_atomic};
use rearrange::document::chain::chain;
use std::path::Path;

/// Where files are put aside, and under which time.
pub struct Kept<'a> {
    /// The state folder.
    pub state: &'a Path,
    /// Now, as part of a name.
    pub when: &'a str,
}

/// Writes the files; what was done, in a sentence.
///
/// # Errors
/// Nothing could be written.
pub fn keep(set: &CalibrationSet, files: &CalibrationFiles, to: &Kept) -> Result<String, String> {
    let Kept { state, when } = *to;
    let folder = state.join("calibration");
    let before = folder.join(format!("before-{when}"));
    put_aside(files, &before).map_err(|error| {
        format!("nothing was kept: the present files could not be put aside: {}", chain(&error))
    })?;
    match write_calibration(set, files) {
        Ok(paths) => Ok(format!(
            "kept as {}; those before are in {}. celld works with them from its next start: end it and start \
             it again",
            paths.map(|path| path.display().to_string()).join(", "),
            before.display()
        )),
        Err(refused) => {
            let new = folder.join(format!("new-{when}"));
            let there = |name: &str| new.join(name);
            let beside = CalibrationFiles {
                camera: there("camera.yaml"),
                hand_eye: there("hand_eye.yaml"),
                table: there("table.yaml"),
                empty: None,
                blends: there("blends.yaml"),
            };
            write_calibration(set, &beside)
                .map_err(|error| format!("nothing was kept: {}", chain(&error)))?;
            Ok(format!(
                "celld may not write where the configuration has them ({}); the new files are in {}: put all \
                 three in their place, then start celld again",
                chain(&refused),
                new.display()
            ))
        }
    }
}

/// Copies the files that are there.
fn put_aside(files: &CalibrationFiles, to: &Path) -> Result<(), FileError> {
    create_folder(to)?;
    for path in [&files.camera, &files.hand_eye, &files.table] {
        if let (Ok(bytes), Some(name)) = (std::fs::read(path), path.file_name()) {
            write_atomic(&to.join(name), &bytes)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::calibrated::read_calibration;
    use crate::config::load::load_cell;

    #[test]
    fn what_was_there_is_put_aside_and_a_folder_that_is_closed_gets_nothing() {
        let config = load_cell(&Path::new(env!("CARGO_MANIFEST_DIR")).join("config/cell.yaml")).unwrap();
        let set = read_calibration(&config).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let own = |name: &str| folder.path().join("own").join(name);
        let files = CalibrationFiles {
            camera: own("camera.yaml"),
            hand_eye: own("hand_eye.yaml"),
            table: own("table.yaml"),
            empty: None,
            blends: own("blends.yaml"),
        };
        std::fs::create_dir(folder.path().join("own")).unwrap();
        std::fs::write(&files.table, "the one before").unwrap();
        let said = keep(&set, &files, &Kept { state: folder.path(), when: "1" }).unwrap();
        assert!(said.contains("next start"), "{said}");
        assert_eq!(std::fs::read_to_string(&files.camera).unwrap(), set.camera.to_yaml());
        let aside = folder.path().join("calibration/before-1/table.yaml");
        assert_eq!(std::fs::read_to_string(aside).unwrap(), "the one before");
        // A file in the place of the folder: nothing can be written there, whoever runs this.
        std::fs::write(&files.camera, "in use").unwrap();
        let closed = CalibrationFiles { table: own("camera.yaml/table.yaml"), ..files };
        let said = keep(&set, &closed, &Kept { state: folder.path(), when: "2" }).unwrap();
        assert!(said.contains("put all three in their place"), "{said}");
        assert_eq!(std::fs::read_to_string(&closed.camera).unwrap(), "in use", "all or none");
        let new = folder.path().join("calibration/new-2/hand_eye.yaml");
        assert_eq!(std::fs::read_to_string(new).unwrap(), set.hand_eye.to_yaml());
    }
}
