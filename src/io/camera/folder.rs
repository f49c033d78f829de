//! A folder of pictures as a camera: PNG and JPEG files in the order of their names.
//!
//! In: a folder, and the lens from a calibration or from `intrinsics.json` in the folder. Out: frames
//! numbered from 0; names sort with their numbers taken as numbers (`look_2.png` before `look_10.png`). Time
//! is the frame number: files carry none.

use crate::io::camera::validator::FrameValidator;
use crate::io::camera::{CameraError, CameraSource, Frame};
use cell_values::image::Image;
use cell_vision::camera::CameraModel;
use std::path::{Path, PathBuf};

/// Pictures in a folder.
#[derive(Debug)]
pub struct FolderCamera {
    folder: PathBuf,
    files: Vec<PathBuf>,
    next: usize,
    lens: Option<CameraModel>,
    watch: FrameValidator,
}

impl FolderCamera {
    /// Lists the folder; without a lens, `intrinsics.json` in it is used when there is one.
    ///
    /// # Errors
    /// `File` if it cannot be listed, `NoPictures` if there is none in it.
    pub fn open(folder: &Path, lens: Option<CameraModel>) -> Result<FolderCamera, CameraError> {
        let failed = |source| CameraError::File { path: folder.to_owned(), source };
        let mut files = Vec::new();
        for entry in std::fs::read_dir(folder).map_err(failed)? {
            let path = entry.map_err(failed)?.path();
            if is_picture(&path) {
                files.push(path);
            }
        }
        if files.is_empty() {
            return Err(CameraError::NoPictures { path: folder.to_owned() });
        }
        files.sort_by_cached_key(|path| natural(&path.to_string_lossy()));
        Ok(FolderCamera { folder: folder.to_owned(), files, next: 0, lens, watch: FrameValidator::default() })
    }

    /// How many pictures there are.
    pub fn len(&self) -> usize {
        self.files.len()
    }

    /// Never: a folder without pictures is not opened.
    pub fn is_empty(&self) -> bool {
        self.files.is_empty()
    }
}

impl CameraSource for FolderCamera {
    fn intrinsics(&mut self) -> Result<CameraModel, CameraError> {
        if let Some(lens) = &self.lens {
            return Ok(lens.clone());
        }
        let path = self.folder.join("intrinsics.json");
        if !path.exists() {
            return Err(CameraError::NoIntrinsics { place: self.folder.display().to_string() });
        }
        let text = std::fs::read(&path).map_err(|source| CameraError::File { path: path.clone(), source })?;
        let lens: CameraModel = serde_json::from_slice(&text)
            .map_err(|source| CameraError::Intrinsics { place: path.display().to_string(), source })?;
        lens.check()?;
        self.lens = Some(lens.clone());
        Ok(lens)
    }

    fn grab(&mut self) -> Result<Frame, CameraError> {
        let Some(path) = self.files.get(self.next) else {
            let place = self.folder.display().to_string();
            return Err(CameraError::EndOfRecording { place, frames: self.next as u64 });
        };
        let sequence = self.next as u64;
        let place = path.display().to_string();
        let bytes = std::fs::read(path).map_err(|source| CameraError::File { path: path.clone(), source });
        // A broken file is reported once; the next call goes on behind it.
        self.next += 1;
        let image =
            Image::decode(&bytes?).map_err(|source| CameraError::Picture { place: place.clone(), source })?;
        let frame = Frame { image, sequence, time_s: sequence as f64, source: place, depth: None };
        self.watch.check(&frame, self.lens.as_ref())?;
        Ok(frame)
    }

    fn is_live(&self) -> bool {
        false
    }

    /// Goes on with the next file: what was read is what there is.
    fn reopen(&mut self) -> Result<(), CameraError> {
        Ok(())
    }
}

fn is_picture(path: &Path) -> bool {
    let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
    matches!(extension.as_deref(), Some("png" | "jpg" | "jpeg"))
}

/// A key that sorts runs of digits by their value.
fn natural(name: &str) -> Vec<(u64, String)> {
    let mut key: Vec<(u64, String)> = vec![(0, String::new())];
    let mut digits = String::new();
    for c in name.chars().chain(std::iter::once('\0')) {
        if c.is_ascii_digit() {
            digits.push(c);
            continue;
        }
        if !digits.is_empty() {
            key.push((digits.parse().unwrap_or(u64::MAX), String::new()));
            digits.clear();
        }
        if let Some((_, text)) = key.last_mut() {
            text.push(c);
        }
    }
    key
}

#[cfg(test)]
mod tests {
    use super::*;

    fn write(folder: &Path, name: &str, grey: u8) {
        std::fs::write(folder.join(name), Image::filled(40, 32, [grey; 3]).encode_png().unwrap()).unwrap();
    }

    #[test]
    fn pictures_come_in_the_order_of_their_numbers_and_end() {
        let folder = tempfile::tempdir().unwrap();
        for (name, grey) in [("look_10.png", 3), ("look_2.png", 2), ("look_1.PNG", 1), ("notes.txt", 0)] {
            write(folder.path(), name, grey);
        }
        let mut camera = FolderCamera::open(folder.path(), None).unwrap();
        assert_eq!(camera.len(), 3);
        let greys: Vec<u8> = (0..3).map(|_| camera.grab().unwrap().image.rgb[0]).collect();
        assert_eq!(greys, [1, 2, 3]);
        assert!(matches!(camera.grab(), Err(CameraError::EndOfRecording { frames: 3, .. })));
        assert!(matches!(camera.intrinsics(), Err(CameraError::NoIntrinsics { .. })));
    }

    #[test]
    fn a_broken_file_is_reported_by_name_and_passed() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("a.png"), b"nonsense").unwrap();
        write(folder.path(), "b.png", 50);
        write(folder.path(), "c.png", 50);
        let mut camera = FolderCamera::open(folder.path(), None).unwrap();
        let error = camera.grab().unwrap_err();
        assert!(error.to_string().contains("a.png"), "{error}");
        assert_eq!(camera.grab().unwrap().sequence, 1);
        assert!(matches!(camera.grab(), Err(CameraError::RepeatedPicture { .. })));
        assert!(matches!(camera.grab(), Err(CameraError::EndOfRecording { .. })));
    }

    #[test]
    fn no_folder_and_an_empty_one_are_errors() {
        let folder = tempfile::tempdir().unwrap();
        assert!(matches!(FolderCamera::open(folder.path(), None), Err(CameraError::NoPictures { .. })));
        let gone = folder.path().join("gone");
        assert!(matches!(FolderCamera::open(&gone, None), Err(CameraError::File { .. })));
    }
}
