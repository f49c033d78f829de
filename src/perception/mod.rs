//! From frames and arm states to one observation of the table: the one way of seeing that all of celld uses.
//!
//! In: pictures (with depth where the camera measures it), where the camera was, the surveyed scene. Out: a
//! [`View`] for each frame, and of all views of a look one [`Observation`]. The daemon, `celld detect`,
//! `celld capture` and the benchmarks call these functions, so that what is measured on the bench is what
//! the cell sees. Pure but for OpenCV's and apriltag's calls in `cell-vision`: no camera is opened here, and
//! no file written.

pub mod diagnostic_images;
pub mod place;
mod second_look;

use cell_values::image::depth::DepthImage;
use cell_values::image::{GrayImage, Image};
use cell_values::time::Timestamp;
use cell_vision::camera::CameraModel;
use cell_vision::detect::second::Expected;
use cell_vision::detect::{DetectError, DetectSettings, Detection, Detector, Family};
use cell_vision::foreign::search::ForeignSearch;
use cell_vision::foreign::{HeightMap, HeightMapError, HeldBody};
use cell_vision::observe::reference::DriftLimits;
use cell_vision::observe::{
    MarkedObject, Observation, ObserveLimits, PartialLook, ReferenceMarker, View, observe,
};
use nalgebra::Isometry3;
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

/// What perception has to know of the cell.
#[derive(Clone)]
pub struct Scene {
    /// Calibrated camera.
    pub camera: CameraModel,
    /// Markers to look for.
    pub objects: Vec<MarkedObject>,
    /// Reference markers round the table.
    pub reference: Vec<ReferenceMarker>,
    /// Limits of plausibility.
    pub limits: ObserveLimits,
    /// The search for what carries no marker; `None` when it is switched off.
    pub foreign: Option<ForeignSearch>,
    /// From where on the camera counts as moved.
    pub drift: DriftLimits,
}

impl Scene {
    /// The views without what the gripper holds; `None` where there is nothing to leave out.
    fn without_held(&self, views: &[View], held: Option<&HeldBody>) -> Option<Vec<View>> {
        self.foreign.as_ref()?.without_held(views, held?)
    }

    /// What depth says of things without a marker, or where there is no depth, what colour says if that
    /// is requested; `None` when the search is switched off or neither gives an answer.
    ///
    /// # Errors
    /// The depth picture is not of this lens.
    pub fn heights(
        &self,
        depth: Option<&DepthImage>,
        colour: Option<&Image>,
        table_from_camera: &Isometry3<f64>,
    ) -> Result<Option<Arc<HeightMap>>, PerceptionError> {
        let Some(search) = &self.foreign else { return Ok(None) };
        let map = match (depth, colour) {
            (Some(depth), _) => Some(search.map(depth, table_from_camera)?),
            (None, Some(colour)) => search.changed(colour, table_from_camera),
            (None, None) => None,
        };
        Ok(map.map(Arc::new))
    }
}

/// A picture as it came from a camera.
#[derive(Clone, Copy)]
pub struct Picture<'a> {
    /// What it shows.
    pub image: &'a Image,
    /// Depth of the same moment, aligned to it.
    pub depth: Option<&'a DepthImage>,
}

/// Why a picture could not be evaluated.
#[derive(Debug, thiserror::Error)]
pub enum PerceptionError {
    /// The marker detector failed.
    #[error("the marker detector failed")]
    Detector(#[from] DetectError),
    /// The depth picture is not of this lens.
    #[error(transparent)]
    Depth(#[from] HeightMapError),
    /// The views cannot be put together.
    #[error("the views cannot be put together: {0}")]
    Observe(String),
}

/// Pictures of a look that are kept for its second pass, at most: a look takes fewer.
const KEPT_MAX: usize = 16;

/// The first picture of a place of the look under way.
struct Kept {
    table_from_camera: Isometry3<f64>,
    time: Timestamp,
    grey: GrayImage,
}

/// Markers found and things measured, for one cell.
pub struct Perception {
    scene: Scene,
    detector: Detector,
    /// Of the look under way, newest first.
    kept: VecDeque<Kept>,
    /// How often each marker was searched for in vain in whole pictures since it was seen last.
    in_vain: BTreeMap<u32, u32>,
}

/// What was searched for in vain so often is taken for absent: an object of the catalogue that is not on the
/// table must not cost each look a second pass. Where it is expected at a known place it is searched for
/// there all the same, and one that a first pass shows counts anew.
const IN_VAIN_MAX: u32 = 2;

impl Perception {
    /// With a detector of its own.
    ///
    /// # Errors
    /// The detector cannot be made.
    pub fn new(scene: Scene, settings: DetectSettings) -> Result<Perception, PerceptionError> {
        let detector = Detector::new(settings)?;
        Ok(Perception { scene, detector, kept: VecDeque::new(), in_vain: BTreeMap::new() })
    }

    /// What it knows.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// True when the last frame of a look pose should carry depth.
    pub fn wants_depth(&self) -> bool {
        self.scene.foreign.is_some()
    }

    /// The markers in a picture, searched whole.
    ///
    /// # Errors
    /// The detector failed.
    pub fn detect(&mut self, image: &Image) -> Result<Vec<Detection>, PerceptionError> {
        Ok(self.detector.detect(&image.gray())?)
    }

    /// The markers in a picture that need not show all of the cell's, with a second pass for each that it
    /// does not show: for single pictures.
    ///
    /// # Errors
    /// The detector failed.
    pub fn detect_known(&mut self, image: &Image) -> Result<Vec<Detection>, PerceptionError> {
        let objects = self.scene.objects.iter().map(|object| object.marker_id);
        let known = objects.chain(self.scene.reference.iter().map(|marker| marker.id));
        let known: Vec<Expected> = known.map(|id| Expected::anywhere(Family::Tag36h11, id)).collect();
        Ok(self.detector.detect_expected(&image.gray(), &known)?)
    }

    /// One frame of a look pose: markers, and on the last frame what depth or colour say of things without
    /// one. `earlier` is a view of the same place and the same moment: only its markers are searched for
    /// again.
    ///
    /// # Errors
    /// The detector failed, or depth is not of this lens.
    pub fn view(
        &mut self,
        picture: Picture,
        table_from_camera: Isometry3<f64>,
        time: Timestamp,
        earlier: Option<&View>,
        last: bool,
    ) -> Result<View, PerceptionError> {
        let view = self.grey_view(picture.image.gray(), table_from_camera, time, earlier)?;
        let heights = self.scene.heights(picture.depth, last.then_some(picture.image), &table_from_camera)?;
        Ok(View { heights, ..view })
    }

    /// The markers of a frame in grey levels, as [`Perception::view`] finds them; nothing of other things.
    /// The first frame of a place is kept until the look's views are put together.
    ///
    /// # Errors
    /// The detector failed.
    pub fn grey_view(
        &mut self,
        grey: GrayImage,
        table_from_camera: Isometry3<f64>,
        time: Timestamp,
        earlier: Option<&View>,
    ) -> Result<View, PerceptionError> {
        let detections = match earlier {
            Some(View { detections, .. }) => self.detector.detect_again(&grey, detections)?,
            None => self.detector.detect(&grey)?,
        };
        if earlier.is_none() {
            self.kept.truncate(KEPT_MAX - 1);
            self.kept.push_front(Kept { table_from_camera, time, grey });
        }
        Ok(View { table_from_camera, detections, time, heights: None })
    }

    /// The views of a look put together; of a partial look only its region is searched for things without a
    /// marker. Where none of them shows a marker that one should show, its picture is searched again in
    /// other ways before it is called missing.
    ///
    /// # Errors
    /// The detector failed; what keeps the views from fitting together.
    pub fn observe(
        &mut self,
        views: &[View],
        partial: Option<&PartialLook>,
    ) -> Result<Observation, PerceptionError> {
        let again = self.looked_again(views, partial)?;
        observe_views(&self.scene, again.as_deref().unwrap_or(views), partial)
    }

    /// The same with something in the gripper, which the camera beside it sees too.
    ///
    /// # Errors
    /// As [`Perception::observe`].
    pub fn observe_holding(
        &mut self,
        views: &[View],
        partial: Option<&PartialLook>,
        held: Option<&HeldBody>,
    ) -> Result<Observation, PerceptionError> {
        let bare = self.scene.without_held(views, held);
        self.observe(bare.as_deref().unwrap_or(views), partial)
    }

    /// The views with what a second pass adds; `None` when nothing is missing. The kept pictures go.
    fn looked_again(
        &mut self,
        views: &[View],
        partial: Option<&PartialLook>,
    ) -> Result<Option<Vec<View>>, PerceptionError> {
        let Perception { scene, detector, kept, in_vain } = self;
        let kept = std::mem::take(kept);
        forget_seen(in_vain, views);
        let mut missing = second_look::missing(&scene.objects, &scene.reference, views, partial);
        missing.retain(|one| {
            one.is_somewhere() || in_vain.get(&one.id()).is_none_or(|times| *times < IN_VAIN_MAX)
        });
        if missing.is_empty() {
            return Ok(None);
        }
        let mut views = views.to_vec();
        for view in &mut views {
            let of_it =
                |kept: &&Kept| kept.time == view.time && kept.table_from_camera == view.table_from_camera;
            let Some(Kept { grey, .. }) = kept.iter().find(of_it) else { continue };
            let expected = second_look::expected(&scene.camera, &missing, &view.table_from_camera);
            let found = std::mem::take(&mut view.detections);
            view.detections = detector.look_again(grey, found, &expected)?;
        }
        for one in missing.iter().filter(|one| !one.is_somewhere()) {
            *in_vain.entry(one.id()).or_default() += 1;
        }
        forget_seen(in_vain, &views);
        Ok(Some(views))
    }
}

/// What a view shows was not searched for in vain.
fn forget_seen(in_vain: &mut BTreeMap<u32, u32>, views: &[View]) {
    for seen in views.iter().flat_map(|view| &view.detections) {
        in_vain.remove(&seen.id);
    }
}

/// The same for views that were made elsewhere: from marker corners with known noise, for volume.
///
/// # Errors
/// What keeps them from fitting together.
pub fn observe_views(
    scene: &Scene,
    views: &[View],
    partial: Option<&PartialLook>,
) -> Result<Observation, PerceptionError> {
    let Scene { camera, objects, reference, limits, foreign, .. } = scene;
    let mut seen = observe(objects, reference, camera, views, limits)
        .map_err(|error| PerceptionError::Observe(rearrange::document::chain::chain(&error)))?;
    seen.foreign = foreign.as_ref().and_then(|search| search.report(views, &seen, partial));
    Ok(seen)
}
