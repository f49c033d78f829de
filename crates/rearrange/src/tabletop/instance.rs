//! A rearrangement task as data: the workspace, the objects with their footprints, starts and goals, and
//! what the cell has to know besides (height, mass, marker, where cups may sit).
//!
//! In: values from the parsers in this folder, or from code. Out: plain structs in m, rad, kg; the checks
//! that need geometry are made when a planning problem is built from them.

use crate::geometry::footprint::{Footprint, FootprintFault};
use crate::geometry::polygon::{Point, Polygon};
use crate::geometry::pose::Pose2;
use serde::{Deserialize, Serialize};

/// The rectangle objects may lie on, m: from (0, 0) to (width, height) in the table frame.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
pub struct Workspace {
    /// Along x, m.
    pub width: f64,
    /// Along y, m.
    pub height: f64,
}

/// A region no object may be placed in.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
pub struct KeepOut {
    /// Its shape.
    pub footprint: Footprint,
    /// Its pose.
    pub pose: Pose2,
}

/// The fiducial marker on an object's top.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
pub struct MarkerSpec {
    /// Family, `tag36h11`.
    pub family: String,
    /// Number within the family.
    pub id: u32,
    /// Edge of the black square, m.
    pub size: f64,
    /// `object_from_marker`: the marker's centre and angle in the object frame.
    pub offset: Pose2,
}

/// One object.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
pub struct ObjectSpec {
    /// Unique name.
    pub id: String,
    /// Outline on the table.
    pub footprint: Footprint,
    /// Cost of one move under TI; default: footprint area, m2.
    pub impedance: Option<f64>,
    /// Pose at the beginning; absent in a catalogue.
    pub start: Option<Pose2>,
    /// Wanted pose; absent: the object may end anywhere.
    pub goal: Option<Pose2>,
    /// An obstacle that never moves.
    pub fixed: bool,
    /// Members of one group are interchangeable.
    pub group: Option<String>,
    /// m.
    pub height: Option<f64>,
    /// kg.
    pub mass: Option<f64>,
    /// On its top.
    pub marker: Option<MarkerSpec>,
    /// Where cups may sit, object frame; default: the footprint.
    pub grippable: Option<Polygon>,
}

impl ObjectSpec {
    /// An object with a shape and nothing else.
    pub fn new(id: impl Into<String>, footprint: Footprint) -> ObjectSpec {
        ObjectSpec {
            id: id.into(),
            footprint,
            impedance: None,
            start: None,
            goal: None,
            fixed: false,
            group: None,
            height: None,
            mass: None,
            marker: None,
            grippable: None,
        }
    }
}

/// A task.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
pub struct Instance {
    /// Where objects may lie.
    pub workspace: Workspace,
    /// Gap between objects at every new place, m; not to the edge.
    pub clearance: f64,
    /// Overlap up to which a pair given as overlapping is taken as it is, m.
    pub overlap_tolerance: f64,
    /// Regions to leave free.
    pub keep_out: Vec<KeepOut>,
    /// The objects.
    pub objects: Vec<ObjectSpec>,
}

impl Instance {
    /// The same task on a table `factor` times as large: every length scales, impedances stay as they are.
    /// Heights, masses and markers are dropped: what fits changes with the size.
    ///
    /// # Errors
    /// The first footprint that becomes too small or too large to be one.
    pub fn scaled(&self, factor: f64) -> Result<Instance, FootprintFault> {
        let pose = |pose: &Pose2| Pose2::new(pose.x * factor, pose.y * factor, pose.theta);
        let mut keep_out = Vec::with_capacity(self.keep_out.len());
        for region in &self.keep_out {
            keep_out.push(KeepOut { footprint: region.footprint.scaled(factor)?, pose: pose(&region.pose) });
        }
        let mut objects = Vec::with_capacity(self.objects.len());
        for object in &self.objects {
            objects.push(ObjectSpec {
                footprint: object.footprint.scaled(factor)?,
                impedance: Some(object.impedance.unwrap_or_else(|| object.footprint.area())),
                start: object.start.as_ref().map(pose),
                goal: object.goal.as_ref().map(pose),
                height: None,
                mass: None,
                marker: None,
                grippable: object.grippable.as_ref().map(|area| scaled_polygon(area, factor)).transpose()?,
                ..object.clone()
            });
        }
        Ok(Instance {
            workspace: Workspace {
                width: self.workspace.width * factor,
                height: self.workspace.height * factor,
            },
            clearance: self.clearance * factor,
            overlap_tolerance: self.overlap_tolerance * factor,
            keep_out,
            objects,
        })
    }

    /// Share of the workspace that the objects cover.
    pub fn density(&self) -> f64 {
        let covered: f64 = self.objects.iter().map(|object| object.footprint.area()).sum();
        covered / (self.workspace.width * self.workspace.height)
    }
}

fn scaled_polygon(polygon: &Polygon, factor: f64) -> Result<Polygon, FootprintFault> {
    let points: Vec<Point> = polygon.points().iter().map(|p| [p[0] * factor, p[1] * factor]).collect();
    Ok(Polygon::new(&points)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scaling_keeps_density_and_angles() {
        let mut object = ObjectSpec::new("a", Footprint::rectangle(0.4, 0.2).expect("valid"));
        object.start = Some(Pose2::new(0.5, 0.5, 1.0));
        let instance = Instance {
            workspace: Workspace { width: 1.0, height: 1.0 },
            clearance: 0.0,
            overlap_tolerance: 0.002,
            keep_out: Vec::new(),
            objects: vec![object],
        };
        let half = instance.scaled(0.5).expect("valid");
        assert!((half.density() - instance.density()).abs() < 1e-12);
        assert_eq!(half.objects[0].start, Some(Pose2::new(0.25, 0.25, 1.0)));
        assert_eq!(half.objects[0].impedance, Some(0.4 * 0.2));
        assert!((half.overlap_tolerance - 0.001).abs() < 1e-12);
    }
}
