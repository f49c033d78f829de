//! The search for foreign objects of one cell: everything it has to know, set up once.
//!
//! In: lens, workspace, catalogue, what never moves, what of the robot is in view, pictures of the empty
//! table; then depth pictures (or pictures, where there is no depth), and the observation of the same look.
//! Out: [`HeightMap`]s and a [`ForeignReport`]. Pure.

use crate::camera::CameraModel;
use crate::foreign::change::EmptyTable;
use crate::foreign::{
    Area, DepthLens, ForeignLimits, ForeignReport, HeightMap, HeightMapError, HeldBody, KnownBody, OwnBody,
    find_in,
};
use crate::observe::{Observation, PartialLook, View};
use cell_values::image::Image;
use cell_values::image::depth::DepthImage;
use nalgebra::Isometry3;
use rearrange::geometry::footprint::Footprint;
use rearrange::geometry::pose::Pose2;
use rearrange::tabletop::instance::KeepOut;

/// What the cell may have on its table.
#[derive(Clone, Debug)]
pub struct Inventory {
    /// The part of the table that is searched.
    pub area: Area,
    /// What carries a marker.
    pub objects: Vec<CatalogueObject>,
    /// What is there and never moves.
    pub fixed: Vec<KnownBody>,
    /// Where anything may be: regions that are kept out of anyway.
    pub ignored: Vec<KeepOut>,
    /// The gripper, if the camera may see it.
    pub own: Option<OwnBody>,
}

/// An object of the catalogue, wherever it lies.
#[derive(Clone, Debug)]
pub struct CatalogueObject {
    /// Its name.
    pub id: String,
    /// Its outline in its own frame.
    pub footprint: Footprint,
    /// Its height, m.
    pub height_m: f64,
}

/// The search.
#[derive(Clone, Debug)]
pub struct ForeignSearch {
    lens: DepthLens,
    inventory: Inventory,
    limits: ForeignLimits,
    empty: Option<EmptyTable>,
}

impl ForeignSearch {
    /// Prepares the search with this lens.
    ///
    /// # Errors
    /// `Cv`.
    pub fn new(
        camera: &CameraModel,
        inventory: Inventory,
        limits: ForeignLimits,
    ) -> Result<ForeignSearch, HeightMapError> {
        Ok(ForeignSearch { lens: DepthLens::new(camera)?, inventory, limits, empty: None })
    }

    /// The same search of a table with these bodies on it, which never move.
    pub fn with_fixed(mut self, fixed: Vec<KnownBody>) -> ForeignSearch {
        self.inventory.fixed = fixed;
        self
    }

    /// Compares colours with the empty table where there is no depth: its pictures, each with the camera's
    /// place.
    pub fn compare_with<'a>(&mut self, empty: impl Iterator<Item = (&'a Image, Isometry3<f64>)>) {
        let mut table = EmptyTable::default();
        for (image, table_from_camera) in empty {
            table.add(image, &self.lens, &table_from_camera, self.inventory.area);
        }
        self.empty = Some(table);
    }

    /// What a colour picture says about the table, if it is known how the table looks when it is empty.
    pub fn changed(&self, image: &Image, table_from_camera: &Isometry3<f64>) -> Option<HeightMap> {
        let empty = self.empty.as_ref()?;
        Some(empty.changed(image, &self.lens, table_from_camera, self.inventory.area))
    }

    /// What a depth picture says about the table.
    ///
    /// # Errors
    /// `OtherSize`.
    pub fn map(
        &self,
        depth: &DepthImage,
        table_from_camera: &Isometry3<f64>,
    ) -> Result<HeightMap, HeightMapError> {
        HeightMap::new(depth, &self.lens, table_from_camera, self.inventory.area, self.inventory.own.as_ref())
    }

    /// The views without what the gripper holds; `None` where the camera does not move with it.
    pub fn without_held(&self, views: &[View], held: &HeldBody) -> Option<Vec<View>> {
        let camera_from_tool = self.inventory.own.as_ref()?.camera_from_tool;
        let without = |view: &View| {
            let table_from_tool = view.table_from_camera * camera_from_tool;
            let map = view.heights.as_ref().map(|map| map.without_held(held, &table_from_tool).into());
            View { heights: map, ..view.clone() }
        };
        Some(views.iter().map(without).collect())
    }

    /// What the height maps of a look's views show besides what was observed in them; `None` without any
    /// map. Of a partial look only its region counts, and objects that it does not show are where they were.
    pub fn report(
        &self,
        views: &[View],
        seen: &Observation,
        partial: Option<&PartialLook>,
    ) -> Option<ForeignReport> {
        let maps: Vec<&HeightMap> = views.iter().filter_map(|view| view.heights.as_deref()).collect();
        if maps.is_empty() {
            return None;
        }
        let remembered = |id: &str| -> Option<Pose2> {
            let known = partial?.remembered.iter().find(|(known, _)| known == id)?;
            Some(known.1)
        };
        let placed = |object: &CatalogueObject| {
            let pose = seen.object(&object.id).map(|seen| seen.pose).or_else(|| remembered(&object.id))?;
            Some(KnownBody { footprint: object.footprint.clone(), pose, height_m: object.height_m })
        };
        let known: Vec<KnownBody> = self
            .inventory
            .objects
            .iter()
            .filter_map(placed)
            .chain(self.inventory.fixed.iter().cloned())
            .collect();
        let region = partial.map(|partial| &partial.region);
        Some(find_in(&maps, &known, &self.inventory.ignored, &self.limits, region))
    }
}
