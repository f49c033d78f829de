//! `celld capture`: the table as it is now, as a goal file.
//!
//! In: the cell's configuration, the lens, and pictures of the table: files, or one frame of the cell's
//! camera where it is. Each picture shows by itself where it was taken, from the reference markers in it, so
//! no robot is queried. Out: a goal file. Exit codes: 0 every object was seen and written, 1 some were not
//! (with `--partial` the others are written), 2 bad input.

use crate::cli::daemon::open_camera;
use crate::config::cell::CellConfig;
use crate::config::load::load_cell;
use crate::config::pictures::{read_camera, read_picture};
use crate::config::setup::movable_scene;
use crate::io::camera::CameraSource;
use crate::jobs::job_file::goal_yaml;
use crate::perception::Perception;
use crate::perception::place::placed_view;
use cell_edge::files;
use cell_edge::terminal::{complain, print};
use cell_values::image::Image;
use cell_values::time::Timestamp;
use cell_vision::camera::CameraModel;
use cell_vision::detect::DetectSettings;
use cell_vision::observe::Observation;
use rearrange::document::chain::chain;
use std::path::PathBuf;

/// Arguments of `celld capture`.
#[derive(Clone, Debug, clap::Args)]
pub struct CaptureArgs {
    /// The cell's configuration: objects, reference markers, calibration files
    #[arg(long, default_value = "config/cell.yaml", value_name = "FILE")]
    config: PathBuf,
    /// Pictures of the table (PNG or JPEG); without any, the cell's camera takes one where it is
    #[arg(value_name = "IMAGE")]
    images: Vec<PathBuf>,
    /// Where to write the goal
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Write the objects that were seen even when others were not; those may then end anywhere
    #[arg(long)]
    partial: bool,
}

/// Runs the subcommand and returns the exit code.
pub fn run(args: &CaptureArgs) -> u8 {
    match capture(args) {
        Ok((text, code)) => {
            print(&text);
            code
        }
        Err(message) => {
            complain(&format!("celld capture: {message}"));
            2
        }
    }
}

/// What to report, and the exit code.
fn capture(args: &CaptureArgs) -> Result<(String, u8), String> {
    let config = load_cell(&args.config).map_err(|error| error.to_string())?;
    let lens = read_camera(&config.calibration.camera).map_err(|error| {
        format!("{error}; `celld calibrate camera` or `celld calibrate hand-eye` makes it")
    })?;
    let pictures = pictures(args, &config, &lens)?;
    let scene = movable_scene(&config, lens, None);
    let mut perception = Perception::new(scene, DetectSettings::default()).map_err(|error| chain(&error))?;
    let mut views = Vec::with_capacity(pictures.len());
    for (index, (name, image)) in pictures.iter().enumerate() {
        let view = placed_view(&mut perception, image, Timestamp::from_nanos(index as u64));
        views.push(view.map_err(|fault| format!("{name}: {fault}"))?);
    }
    let seen = perception.observe(&views, None).map_err(|error| chain(&error))?;
    let mut text = reported(&seen);
    if !seen.complete() && !args.partial || seen.objects.is_empty() {
        text.push_str("nothing was written; look again from where all can be seen, or give --partial\n");
        return Ok((text, 1));
    }
    let goal = goal_yaml(seen.objects.iter().map(|object| (object.id.as_str(), object.pose)), "");
    let file = format!("version: 1\n{goal}");
    files::write_atomic(&args.out, file.as_bytes()).map_err(|error| error.to_string())?;
    text.push_str(&format!("wrote {} objects to {}\n", seen.objects.len(), args.out.display()));
    Ok((text, u8::from(!seen.complete())))
}

/// The pictures with their names.
fn pictures(
    args: &CaptureArgs,
    config: &CellConfig,
    lens: &CameraModel,
) -> Result<Vec<(String, Image)>, String> {
    if args.images.is_empty() {
        let frame = open_camera(config, Some(lens.clone()))?
            .grab()
            .map_err(|error| format!("{}; {}", chain(&error), error.kind().hint()))?;
        return Ok(vec![(frame.source, frame.image)]);
    }
    args.images.iter().map(|path| Ok((path.display().to_string(), read_picture(path)?))).collect()
}

/// One line for each object that was expected.
pub(super) fn reported(seen: &Observation) -> String {
    let mut text = String::new();
    for object in &seen.objects {
        let pose = object.pose;
        text.push_str(&format!(
            "{}: x {:.4} m, y {:.4} m, {:.2} deg, +- {:.2} mm\n",
            object.id,
            pose.x,
            pose.y,
            pose.theta.to_degrees(),
            1e3 * object.std_xy_m
        ));
    }
    for id in &seen.missing {
        text.push_str(&format!("{id}: not seen\n"));
    }
    for suspicious in &seen.suspicious {
        text.push_str(&format!("{}: {}\n", suspicious.id, suspicious.reason));
    }
    for duplicate in &seen.duplicates {
        text.push_str(&format!("{}: marker {} is at several places\n", duplicate.id, duplicate.marker_id));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::vision::scene::{DEGRADE, looking_down};
    use crate::config::setup::{movable_objects, reference_markers};
    use crate::jobs::goal::parse_goal_file;
    use cell_vision::detect::Family;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rearrange::geometry::pose::Pose2;
    use std::path::Path;
    use vision_pictures::render::{Ground, Lens, Print, render};

    /// A picture of the example cell from above, with some of its objects in a row; returns where they lie.
    fn picture(
        config: &CellConfig,
        object_count: usize,
        references: usize,
        path: &Path,
    ) -> Vec<(String, Pose2)> {
        let lens = read_camera(&config.calibration.camera).unwrap();
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let print = |id: u32, size_m: f64, pose: Pose2, z_m: f64| Print {
            pattern: Family::Tag36h11.pattern(id).unwrap(),
            size_m,
            table_from_marker: pose.at_height(z_m),
            greys: [30.0, 220.0],
            rim: (0.001, 130.0),
        };
        let surveyed = reference_markers(config);
        let mut prints: Vec<Print> =
            surveyed.iter().take(references).map(|m| print(m.id, m.size, m.pose, 0.0)).collect();
        let mut truth = Vec::new();
        for (i, object) in movable_objects(config).iter().take(object_count).enumerate() {
            let pose = Pose2::new(0.13 + 0.24 * (i % 2) as f64, 0.13 + 0.24 * (i / 2) as f64, 0.4 * i as f64);
            let marker = pose.compose(&object.offset);
            prints.push(print(object.marker_id, object.marker_size, marker, object.height));
            truth.push((object.id.clone(), pose));
        }
        let lens = Lens::new(lens, &mut random);
        let view = looking_down([0.25, 0.25], 0.75, [0.02, -0.01], 1.5);
        let picture = render(&lens, &view, &Ground::Plain(120.0), &prints, DEGRADE, &mut random);
        std::fs::write(path, picture.encode_png().unwrap()).unwrap();
        truth
    }

    fn args(image: &Path, out: &Path) -> CaptureArgs {
        let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/cell.yaml");
        CaptureArgs { config, images: vec![image.to_path_buf()], out: out.to_path_buf(), partial: false }
    }

    #[test]
    fn what_lies_there_becomes_a_goal_that_reads_back() {
        let folder = tempfile::tempdir().unwrap();
        let (image, out) = (folder.path().join("t.png"), folder.path().join("goal.yaml"));
        let args = args(&image, &out);
        let config = load_cell(&args.config).unwrap();
        let all = movable_objects(&config).len();
        let truth = picture(&config, all, 12, &image);
        let (text, code) = capture(&args).unwrap();
        assert_eq!(code, 0, "{text}");
        let written = std::fs::read_to_string(&out).unwrap();
        let obstacles = config.obstacles();
        let context = config.goal_context(&obstacles);
        let goal = parse_goal_file(&written, "goal.yaml", Some(&context)).unwrap();
        assert_eq!(goal.len(), truth.len());
        for (id, pose) in truth {
            let found = goal.iter().find(|goal| goal.id.as_ref() == Some(&id)).unwrap().pose.unwrap();
            assert!(found.distance(&pose) < 5e-4, "{id}: {found:?} {pose:?}");
        }
    }

    #[test]
    fn what_is_missing_is_named_and_a_part_is_written_only_when_requested() {
        let folder = tempfile::tempdir().unwrap();
        let (image, out) = (folder.path().join("t.png"), folder.path().join("goal.yaml"));
        let args = args(&image, &out);
        let config = load_cell(&args.config).unwrap();
        let missing = movable_objects(&config)[2].id.clone();
        picture(&config, 2, 12, &image);
        let (text, code) = capture(&args).unwrap();
        assert!(code == 1 && text.contains(&format!("{missing}: not seen")) && !out.exists(), "{text}");
        let (_, code) = capture(&CaptureArgs { partial: true, ..args.clone() }).unwrap();
        assert!(code == 1 && out.exists());
        picture(&config, 2, 2, &image);
        let reported = capture(&args).unwrap_err();
        assert!(reported.contains("t.png: 2 of the") && reported.contains("reference markers"), "{reported}");
        std::fs::write(&image, b"\x89PNG").unwrap();
        assert!(capture(&args).unwrap_err().contains("t.png"));
    }
}
