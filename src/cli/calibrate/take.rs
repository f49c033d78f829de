//! Pictures of the board, one at a time, with a word on each: how much of the board it shows, and where none
//! was yet.
//!
//! In: a camera, the board, a person who moves it. Out: numbered pictures in a folder. A picture in which
//! nothing can be measured is reported and not kept, so that this is not found out after the last one.

use crate::cli::calibrate::fault::{Fault, bad_input};
use crate::io::camera::{CameraSource, FaultKind};
use cell_calibration::board_pictures::{BoardPictures, BoardSight};
use cell_edge::files;
use cell_edge::terminal::complain;
use cell_vision::board::Board;
use rearrange::document::chain::chain;
use std::path::Path;

/// Pictures that may fail before it is given up, for each that is wanted.
const ATTEMPTS: usize = 10;

/// Takes `count` pictures into `save`; `ready` waits for the person and is false when they want no more.
///
/// # Errors
/// A camera that will not give any, or a folder that cannot be written to.
pub(super) fn take(
    camera: &mut dyn CameraSource,
    board: &Board,
    save: &Path,
    count: usize,
    ready: &mut dyn FnMut() -> bool,
) -> Result<(), Fault> {
    let mut pictures = BoardPictures::new(board).map_err(|error| bad_input(error.to_string()))?;
    let mut attempts = 0;
    while pictures.count() < count && attempts < ATTEMPTS * count {
        attempts += 1;
        complain(&format!("picture {}/{count}", pictures.count() + 1));
        if !ready() {
            break;
        }
        let frame = match camera.grab() {
            Ok(frame) => frame,
            Err(error) => match error.kind() {
                FaultKind::Ended => break,
                FaultKind::Misfit => return Err(Fault { message: chain(&error), code: 1 }),
                kind => {
                    complain(&format!("  {}; {}", chain(&error), kind.hint()));
                    continue;
                }
            },
        };
        let all = board.count();
        match pictures.look(&frame.image).map_err(|error| bad_input(error.to_string()))? {
            BoardSight::TooLittle { markers } => complain(&format!(
                "  {markers} of the board's {all} markers: not kept; nearer, sharper, and is it the board \
                 that was named?"
            )),
            BoardSight::Board { name, markers, uncovered } => {
                let bytes = frame.image.encode_png().map_err(|error| bad_input(error.to_string()))?;
                files::write_atomic(&save.join(&name), &bytes)
                    .map_err(|error| bad_input(error.to_string()))?;
                let empty = if uncovered.is_empty() {
                    "the whole picture is covered".to_string()
                } else {
                    format!("no marker yet: {}", uncovered.join(", "))
                };
                complain(&format!("  {markers} of {all} markers; {empty}"));
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::vision::calibrated::{bench_board, board_picture};
    use crate::bench::vision::scene::bench_camera;
    use crate::io::camera::folder::FolderCamera;
    use crate::io::camera::monitored::MonitoredCamera;
    use cell_values::image::Image;
    use cell_values::image::quality::PictureLimits;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use vision_pictures::render::Lens;

    #[test]
    fn pictures_without_the_board_or_light_are_reported_and_not_kept() {
        let (input, save) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let mut random = ChaCha8Rng::seed_from_u64(8);
        let lens = Lens::new(bench_camera(), &mut random);
        let mut board = || board_picture(&lens, &bench_board(), &mut random).0.to_image();
        let mut wall = Image::filled(1280, 720, [200; 3]);
        (0..300 * 300).for_each(|i| wall.set_pixel(400 + i % 300, 200 + i / 300, [40; 3]));
        let (first, second) = (board(), board());
        let pictures = [Image::filled(1280, 720, [5; 3]), wall, first.clone(), second.clone()];
        for (number, picture) in pictures.iter().enumerate() {
            std::fs::write(input.path().join(format!("{number}.png")), picture.encode_png().unwrap())
                .unwrap();
        }
        let source = FolderCamera::open(input.path(), None).unwrap();
        let mut camera = MonitoredCamera::new(Box::new(source), PictureLimits::STANDARD);
        let mut requested = 0;
        let mut ready = || {
            requested += 1;
            true
        };
        take(&mut camera, &bench_board(), save.path(), 3, &mut ready).unwrap();
        let kept = |name: &str| Image::decode(&std::fs::read(save.path().join(name)).unwrap()).unwrap();
        assert!(kept("01.png") == first && kept("02.png") == second && !save.path().join("03.png").exists());
        assert_eq!(requested, 5, "the fifth finds the recording at its end");
        let source = FolderCamera::open(input.path(), None).unwrap();
        let mut camera = MonitoredCamera::new(Box::new(source), PictureLimits::STANDARD);
        let none = tempfile::tempdir().unwrap();
        take(&mut camera, &bench_board(), none.path(), 3, &mut || false).unwrap();
        assert_eq!(std::fs::read_dir(none.path()).unwrap().count(), 0, "nobody pressed Enter");
    }
}
