//! What `celld detect --config` adds: where the objects lie on the table, and, with a depth picture, what
//! carries no marker.
//!
//! In: the cell's configuration and calibration, the markers of a picture, a depth picture aligned to it.
//! Out: sentences, JSON and outlines to draw. Where the picture was taken is determined by the reference
//! markers in it.

use crate::cli::capture::reported;
use crate::config::cell::CellConfig;
use crate::config::load::load_cell;
use crate::config::pictures::{read_bytes, read_camera};
use crate::config::setup::{drawn_search, movable_scene, reference_markers};
use crate::perception::Perception;
use crate::perception::place::where_taken;
use cell_values::image::Image;
use cell_values::image::depth::DepthImage;
use cell_values::image::depth::UNIT_M;
use cell_values::time::Timestamp;
use cell_vision::annotate::{self, BAD, GOOD, Overlay};
use cell_vision::camera::CameraModel;
use cell_vision::detect::family::Family;
use cell_vision::detect::{DetectSettings, Detection};
use cell_vision::observe::{Observation, View};
use nalgebra::Isometry3;
use rearrange::document::chain::chain;
use std::fmt::Write;
use std::path::Path;

/// A cell as far as pictures of its table go.
pub(super) struct Cell {
    config: CellConfig,
    /// The calibrated lens.
    pub lens: CameraModel,
}

/// A table as one picture shows it.
pub(super) struct Table {
    /// What lies where.
    pub seen: Observation,
    config: CellConfig,
    lens: CameraModel,
    table_from_camera: Isometry3<f64>,
}

impl Cell {
    /// Reads the configuration and the lens it names.
    ///
    /// # Errors
    /// The configuration or the lens that it names cannot be read, or its content is wrong.
    pub fn read(path: &Path) -> Result<Cell, String> {
        let config = load_cell(path).map_err(|error| error.to_string())?;
        let lens = read_camera(&config.calibration.camera).map_err(|error| {
            format!("{error}; `celld calibrate camera` or `celld calibrate hand-eye` makes it")
        })?;
        Ok(Cell { config, lens })
    }

    /// The markers of its objects and its reference markers.
    pub fn markers(&self) -> Vec<u32> {
        let scene = movable_scene(&self.config, self.lens.clone(), None);
        let objects = scene.objects.iter().map(|object| object.marker_id);
        objects.chain(scene.reference.iter().map(|marker| marker.id)).collect()
    }

    /// The table in a picture with these markers.
    ///
    /// # Errors
    /// The reference markers do not fix where the picture was taken, the depth picture cannot be read or
    /// does not fit the lens, or OpenCV fails.
    pub fn look(self, detections: &[Detection], depth: Option<&Path>) -> Result<Table, String> {
        let Cell { config, lens } = self;
        // Markers of the cell are of one family; in others the same numbers mean nothing to it.
        let own = detections.iter().filter(|detection| detection.family == Family::Tag36h11.name());
        let detections: Vec<Detection> = own.cloned().collect();
        let table_from_camera = where_taken(&lens, &reference_markers(&config), &detections)?;
        let depth = depth.map(read_depth).transpose()?;
        let search = depth.as_ref().map(|_| drawn_search(&config, &lens)).transpose();
        let search = search.map_err(|error| chain(&error))?;
        let scene = movable_scene(&config, lens.clone(), search);
        let mut perception =
            Perception::new(scene, DetectSettings::default()).map_err(|error| chain(&error))?;
        let heights = perception.scene().heights(depth.as_ref(), None, &table_from_camera);
        let heights = heights.map_err(|error| chain(&error))?;
        let view = View { table_from_camera, detections, time: Timestamp::ZERO, heights };
        let seen = perception.observe(&[view], None).map_err(|error| chain(&error))?;
        Ok(Table { seen, config, lens, table_from_camera })
    }
}

fn read_depth(path: &Path) -> Result<DepthImage, String> {
    let bytes = read_bytes(path)?;
    DepthImage::decode(&bytes, UNIT_M).map_err(|error| format!("{}: {}", path.display(), chain(&error)))
}

impl Table {
    /// One line for each object and each thing without a marker.
    pub fn reported(&self) -> String {
        let mut text = reported(&self.seen);
        if let Some(report) = &self.seen.foreign {
            for object in &report.objects {
                let _ = writeln!(text, "foreign: {object}");
            }
            let share = 100.0 * report.measured_share;
            let _ = writeln!(text, "{} foreign, depth on {share:.0} % of the table", report.objects.len());
        }
        text
    }

    /// Draws outlines of what lies where.
    ///
    /// # Errors
    /// OpenCV fails to project an outline into the picture.
    pub fn draw(&self, image: &mut Image) -> Result<(), String> {
        let good = self.seen.objects.iter().map(|object| (object, GOOD));
        let doubted = self.seen.suspicious.iter().filter_map(|doubted| doubted.estimate.as_ref());
        let mut overlays: Vec<Overlay> = good
            .chain(doubted.map(|object| (object, BAD)))
            .filter_map(|(object, colour)| {
                let spec = self.config.objects.iter().find(|spec| spec.id == object.id)?;
                Some(Overlay {
                    label: object.id.clone(),
                    pose: object.pose,
                    height_m: spec.height.unwrap_or(0.0),
                    outline: spec.footprint.outline(64),
                    colour,
                })
            })
            .collect();
        if let Some(report) = &self.seen.foreign {
            overlays.extend(annotate::foreign_overlays(&report.objects));
        }
        annotate::draw_overlays(image, &overlays, &self.lens, &self.table_from_camera)
            .map_err(|error| chain(&error))
    }
}
