//! Whether the things of a file can lie where the file puts them.
//!
//! In: what could be read of a table and its objects, and where that is in the text. Out: a complaint for
//! every overlap and overhang beyond the tolerance, at the later of the two objects. Parts that could not be
//! read are absent here and not judged: two objects that are sound do overlap, whatever is wrong with a
//! third. Pure.

use crate::document::Location;
use crate::document::decode::{At, Decoder};
use crate::geometry::collision::{Placed, TOUCH_M, overhang};
use crate::geometry::pose::Pose2;
use crate::tabletop::instance::{KeepOut, ObjectSpec, Workspace};

/// Where an object's parts are in the text.
#[derive(Clone, Debug)]
pub struct Place {
    /// Its name, as far as it could be read.
    pub name: Option<String>,
    /// Where the name is, or else the object.
    pub at: Location,
    /// Path of the object.
    pub path: String,
    /// Where its start is, or else the object, and the path of the start.
    pub start: (Location, String),
    /// The same of its goal.
    pub goal: (Location, String),
}

impl Place {
    /// Of an object with the keys `id`, `start` and `goal` (or those with `_deg` at the end).
    pub fn of(item: &At) -> Place {
        let pose = |key: &str| {
            let node = item.node.get(key).or_else(|| item.node.get(&format!("{key}_deg")));
            (node.map_or(item.node.at, |node| node.at), format!("{}.{key}", item.path))
        };
        let id = item.node.get("id");
        Place {
            name: id.and_then(|node| node.scalar()).map(str::to_owned),
            at: id.unwrap_or(item.node).at,
            path: item.path.clone(),
            start: pose("start"),
            goal: pose("goal"),
        }
    }
}

/// What is known of a table and the objects on it.
#[derive(Clone, Debug)]
pub struct Layout<'a> {
    /// Size of the table.
    pub workspace: Option<Workspace>,
    /// Overlap that is taken as given, m; nothing is judged without.
    pub overlap_tolerance: Option<f64>,
    /// Regions to leave free.
    pub keep_out: &'a [Option<KeepOut>],
    /// The objects.
    pub objects: Vec<Option<&'a ObjectSpec>>,
    /// Where they are in the text, one place for each.
    pub places: &'a [Place],
}

impl Layout<'_> {
    /// Complains about starts that overlap, or reach over the edge or into a region.
    pub fn start_faults(&self, decoder: &mut Decoder) {
        let starts = |object: &ObjectSpec| object.start;
        self.faults(decoder, &starts, &|place| &place.start);
    }

    /// Complains about goals that overlap each other, a fixed object, a region or the edge.
    pub fn goal_faults(&self, decoder: &mut Decoder) {
        let goals = |object: &ObjectSpec| if object.fixed { object.start } else { object.goal };
        self.faults(decoder, &goals, &|place| &place.goal);
    }

    fn faults(
        &self,
        decoder: &mut Decoder,
        pose: &dyn Fn(&ObjectSpec) -> Option<Pose2>,
        at: &dyn Fn(&Place) -> &(Location, String),
    ) {
        let Some(tolerance) = self.overlap_tolerance else { return };
        let apart = match tolerance > 0.0 {
            true => format!("move them apart; overlap_tolerance allows {:.3} mm", tolerance * 1e3),
            false => "move them apart".to_owned(),
        };
        let regions: Vec<(usize, Placed)> = (0..)
            .zip(self.keep_out)
            .filter_map(|(r, region)| Some((r, region.as_ref()?)))
            .map(|(r, region)| (r, Placed::new(&region.footprint, region.pose)))
            .collect();
        let mut earlier: Vec<(&ObjectSpec, Placed)> = Vec::new();
        for (object, place) in self.objects.iter().zip(self.places) {
            let Some((object, pose)) = object.and_then(|object| Some((object, pose(object)?))) else {
                continue;
            };
            let (location, path) = at(place);
            let mut reported = |what: String, depth: f64, help: &str| {
                if depth > tolerance + TOUCH_M {
                    let message = format!("{:?} {what} by {:.3} mm", object.id, depth * 1e3);
                    decoder.complain(*location, path, message, help);
                }
            };
            if let Some(Workspace { width, height }) = self.workspace {
                let over = overhang(&object.footprint, &pose, width, height);
                let help = format!("the table is {width} m x {height} m");
                reported("reaches over the table's edge".to_owned(), over, &help);
            }
            let shape = Placed::new(&object.footprint, pose);
            for (r, region) in &regions {
                reported(format!("overlaps keep_out[{r}]"), shape.penetration(region), &apart);
            }
            for (other, placed) in &earlier {
                reported(format!("overlaps {:?}", other.id), shape.penetration(placed), &apart);
            }
            earlier.push((object, shape));
        }
    }
}
