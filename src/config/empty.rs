//! The pictures of the empty table that `celld calibrate empty` took, for looks without depth.
//!
//! In: the configuration, the calibration. Out: the search for foreign objects knows how the empty
//! table looks from the look poses; or a sentence that names the file. Pictures that were just taken are
//! kept only if they show none of the cell's objects.

use crate::config::cell::CellConfig;
use crate::config::round::SAMPLES;
use crate::config::setup::Measured;
use cell_calibration::files::round::Round;
use cell_calibration::fit::Sample;
use cell_edge::files;
use cell_machine::event::Arm;
use cell_values::image::Image;
use cell_vision::foreign::search::ForeignSearch;
use nalgebra::Isometry3;
use rearrange::document::chain::chain;
use rearrange::tabletop::instance::ObjectSpec;
use std::path::Path;

/// Largest picture that is read, bytes.
const PICTURE_MAX: u64 = 64 << 20;

/// Where there is no depth and the configuration names a folder, looks are compared with its pictures.
///
/// # Errors
/// A file that is missing, broken, or of another camera or robot.
pub fn compare_with_empty(
    search: Option<&mut ForeignSearch>,
    config: &CellConfig,
    measured: &Measured,
    arm: &Arm,
) -> Result<(), String> {
    let Some((search, folder)) = search.zip(config.calibration.empty.as_deref()) else { return Ok(()) };
    if config.devices.camera.measures_depth() {
        return Ok(());
    }
    let pictures = read(folder, measured, arm)?;
    search.compare_with(pictures.iter().map(|(image, from)| (image, *from)));
    Ok(())
}

/// Leaves the pictures in the folder if the table was empty.
///
/// # Errors
/// What was seen on it.
pub fn keep_if_empty(config: &CellConfig, folder: &Path, samples: &[Sample]) -> Result<(), String> {
    let Some(seen) = not_empty(config, samples) else { return Ok(()) };
    // The daemon must not take it for what belongs there.
    files::remove(&folder.join(SAMPLES)).map_err(|error| chain(&error))?;
    Err(seen)
}

/// The sentence about an object whose marker is seen, if there is one.
fn not_empty(config: &CellConfig, samples: &[Sample]) -> Option<String> {
    let seen = |id: u32| samples.iter().flat_map(|sample| &sample.detections).any(|found| found.id == id);
    let there = |object: &&ObjectSpec| object.marker.as_ref().is_some_and(|marker| seen(marker.id));
    let mut names =
        config.objects.iter().filter(|object| !object.fixed).filter(there).map(|object| &*object.id);
    let first = names.next()?;
    let all = names.fold(format!("{first:?}"), |all, name| format!("{all}, {name:?}"));
    Some(format!("the table is not empty, {all} can be seen: clear it and take the pictures again"))
}

fn read(folder: &Path, measured: &Measured, arm: &Arm) -> Result<Vec<(Image, Isometry3<f64>)>, String> {
    let path = folder.join(SAMPLES);
    let name = path.display().to_string();
    let again = "clear the table and run `celld calibrate empty`";
    let text = files::read_named(&path, 1 << 20).map_err(|error| format!("{}; {again}", chain(&error)))?;
    let round = Round::parse(&text, &name).map_err(|complaints| complaints.to_string())?;
    let made = &round.provenance;
    let then = [&made.camera_serial, &made.robot_serial, &made.kinematics_checksum];
    let now = [&measured.camera.serial, &arm.serial, &arm.checksum];
    if let Some(k) = (0..3).find(|&k| then[k] != now[k]) {
        let what = ["camera", "robot", "kinematics"][k];
        return Err(format!("{name}: taken with {what} {}, now it is {}; {again}", then[k], now[k]));
    }
    let mut pictures = Vec::with_capacity(round.samples.len());
    for sample in &round.samples {
        let file = folder.join(&sample.image);
        let bytes =
            files::read_bytes(&file, PICTURE_MAX).map_err(|error| format!("{}; {again}", chain(&error)))?;
        let image = Image::decode(&bytes).map_err(|error| format!("{}: {error}; {again}", file.display()))?;
        let fits = measured.camera.check_picture(image.width, image.height);
        fits.map_err(|error| format!("{}: {error}; {again}", file.display()))?;
        let table_from_camera =
            measured.base_from_table.inverse() * measured.mount.base_from_camera(&sample.base_from_flange);
        pictures.push((image, table_from_camera));
    }
    Ok(pictures)
}
