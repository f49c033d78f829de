//! Where what is held may be put down: its goal, or the nearest free place.
//!
//! In: where the object hangs, a look made after the stop. Out: a pose on the table that is inside it, clear
//! of everything seen, of keep-out regions and of what was there before the stop and is not seen now, with
//! paths down and up that pass the check; or why there is none. One place is tried at a time: a path takes
//! longer than the heartbeat may wait for twelve of them. Pure.

use crate::supervisor::back::{Held, PlaceSearch};
use crate::supervisor::cell::Supervisor;
use crate::supervisor::model::CellObject;
use cell_motion::bodies::Standing;
use cell_motion::put_down::{Grasp, PutDown};
use cell_values::time::Timestamp;
use cell_values::units::Joints;
use cell_vision::foreign::{ForeignObject, Hole};
use cell_vision::observe::Observation;
use rearrange::geometry::collision::{closer_than, inside};
use rearrange::geometry::footprint::Footprint;
use rearrange::geometry::polygon::{contains, distance_to_outline};
use rearrange::geometry::pose::Pose2;
use std::f64::consts::TAU;

/// Least gap to everything else, m: the object may have slipped a little on the cups when the arm stopped.
const GAP_M: f64 = 0.005;

/// Rings of places round the point below the object, and places on each.
const RING_M: f64 = 0.015;
const RINGS: usize = 40;
const PLACES: usize = 24;

/// Free places whose paths are tried.
const TRIES: usize = 12;

/// What the next step of a search comes to.
pub(crate) enum Searched {
    /// A place, whether it is the one it was carried to, and the paths.
    Found(Pose2, bool, Box<PutDown>),
    /// There are others to try, the next time that time is handed over.
    NotYet,
    /// No place.
    Nowhere(String),
}

/// Something that takes room on the table.
struct Taken {
    footprint: Footprint,
    pose: Pose2,
    height: f64,
}

/// How far over its outline and its top what depth shows of an object may reach, m.
const RAGGED_M: f64 = 0.012;

/// Corners of a curve.
const CORNERS: usize = 64;

/// Whether what depth shows is this object at this place.
fn is_of(object: &CellObject, pose: &Pose2, thing: &ForeignObject) -> bool {
    let outline = object.footprint.outline(CORNERS);
    let inside = |at: &[f64; 2]| {
        let own = pose.inverse().transform(*at);
        contains(&outline, own) || distance_to_outline(&outline, own) <= RAGGED_M
    };
    thing.height_m <= object.height + RAGGED_M && thing.outline.iter().all(inside)
}

impl Supervisor {
    /// The free places for what is held, nearest first.
    pub(crate) fn places_for_held(&self, below: Pose2, seen: &Observation) -> Result<PlaceSearch, String> {
        let (held, object, _) = self.held_object()?;
        let taken = self.taken(held, seen);
        let free =
            |pose: &Pose2| self.is_free(&object.footprint, object.grip_point, held.height, pose, &taken);
        let ring = around(below).map(|pose| (pose, false));
        let candidates = std::iter::once((held.to, true)).chain(ring).filter(|(pose, _)| free(pose));
        let not_where_meant = (!free(&held.to))
            .then(|| "where it was to go is not free, as far as the look shows it".to_string());
        let places = candidates.take(TRIES).collect();
        Ok(PlaceSearch { places, tried: None, fault: None, not_where_meant })
    }

    /// Tries the path to the next place, once at a time.
    pub(crate) fn try_place(
        &self,
        now: Timestamp,
        q: &Joints,
        seen: &Observation,
        search: &mut PlaceSearch,
    ) -> Searched {
        if search.tried == Some(now) {
            return Searched::NotYet;
        }
        search.tried = Some(now);
        let (held, _, grasp) = match self.held_object() {
            Ok(known) => known,
            Err(why) => return Searched::Nowhere(why.to_string()),
        };
        let Some((pose, meant)) = search.places.pop_front() else {
            return Searched::Nowhere(match search.fault.take() {
                None => "no place on the table is free; make room by hand".to_string(),
                Some(fault) => format!("no free place can be reached: {fault}"),
            });
        };
        let mut table = self.tabletop(Some(seen), &held.object);
        let hidden = self.hidden(held, seen).filter_map(|(id, pose)| {
            let object = self.model.object(id)?;
            Some(object.pick_n_place(pose, pose).lying_at(pose))
        });
        table.standing.extend(hidden);
        match grasp.put_down(&self.model.arm, q, &pose, &self.cycle(), &table) {
            Ok(paths) => Searched::Found(pose, meant, Box::new(paths)),
            Err(fault) => {
                if meant {
                    search.not_where_meant = Some(format!("where it was to go cannot be reached: {fault}"));
                }
                search.fault.get_or_insert_with(|| fault.to_string());
                Searched::NotYet
            }
        }
    }

    /// What is held, as the catalogue has it, and how it hangs.
    fn held_object(&self) -> Result<(&Held, &CellObject, &Grasp), &'static str> {
        let held = self.back.held.as_ref().ok_or("nothing is known to be held")?;
        let object = self.model.object(&held.object).ok_or("the catalogue does not have what is held")?;
        let grasp = held.grasp.as_ref().ok_or("how the object hangs is not known")?;
        Ok((held, object, grasp))
    }

    /// Everything that is on the table besides what is held, as far as it is known.
    fn taken(&self, held: &Held, seen: &Observation) -> Vec<Taken> {
        let now = seen.objects.iter().map(|object| (object.id.as_str(), object.pose));
        let now = now.filter(|(id, _)| *id != held.object);
        let known = now.chain(self.hidden(held, seen));
        let objects = known.filter_map(|(id, pose)| {
            let object = self.model.object(id)?;
            Some(Taken { footprint: object.footprint.clone(), pose, height: object.height })
        });
        let fixed = self.standing_obstacles(seen).into_iter();
        let fixed = fixed.map(|Standing { footprint, pose, height, .. }| Taken { footprint, pose, height });
        let report = seen.foreign.iter();
        let unseen = report.flat_map(|report| &report.holes).map(|hole| {
            let disc =
                (Footprint::Disc { radius: hole.reach_m }, Pose2::new(hole.centre[0], hole.centre[1], 0.0));
            let outline = Footprint::polygon(&hole.outline).ok().map(|outline| (outline, Pose2::default()));
            let (footprint, pose) = outline.unwrap_or(disc);
            // What stands there is not known, nor how high.
            Taken { footprint, pose, height: f64::INFINITY }
        });
        objects.chain(fixed).chain(unseen).collect()
    }

    /// What was there before and is not seen now: what is held may hide it.
    fn hidden<'a>(&'a self, held: &'a Held, seen: &'a Observation) -> impl Iterator<Item = (&'a str, Pose2)> {
        let unseen = |id: &str| !seen.objects.iter().any(|object| object.id == id);
        let before = self.back.table.iter().filter(move |(id, _)| unseen(id) && *id != held.object);
        before.map(|(id, pose)| (id.as_str(), *pose))
    }

    /// What was seen without the things that are no strangers: objects whose markers are behind what is
    /// held, where they were before. They stay in the way.
    pub(crate) fn without_hidden(&self, mut seen: Observation) -> Observation {
        let Some(held) = &self.back.held else { return seen };
        let object = |(id, pose): (&str, Pose2)| Some((self.model.object(id)?, pose));
        let hidden: Vec<(&CellObject, Pose2)> = self.hidden(held, &seen).filter_map(object).collect();
        let is_known = |thing: &ForeignObject| hidden.iter().any(|(object, pose)| is_of(object, pose, thing));
        if let Some(report) = &mut seen.foreign {
            let (known, strangers) = std::mem::take(&mut report.objects).into_iter().partition(is_known);
            report.objects = strangers;
            let known: Vec<ForeignObject> = known;
            // Where depth shows it there is no room, though its marker was elsewhere by a little.
            report.holes.extend(known.into_iter().map(|thing| Hole {
                area_m2: thing.area_m2,
                centre: thing.centre,
                reach_m: thing.area_m2.sqrt(),
                outline: thing.outline,
            }));
        }
        seen
    }

    fn is_free(
        &self,
        footprint: &Footprint,
        grip_point: [f64; 2],
        height: f64,
        pose: &Pose2,
        taken: &[Taken],
    ) -> bool {
        let (workspace, grip) = (&self.model.workspace, &self.model.grip);
        let gap = self.model.clearance.max(GAP_M);
        let [x, y] = pose.transform(grip_point);
        let (body, over) = (Footprint::Disc { radius: grip.body_radius }, Pose2::new(x, y, 0.0));
        let underside = height - self.model.cycle.press + grip.body_above_lips;
        inside(footprint, pose, workspace.width, workspace.height)
            && taken.iter().all(|other| {
                let meets_body = other.height > underside
                    && closer_than(&body, &over, &other.footprint, &other.pose, GAP_M);
                !meets_body && !closer_than(footprint, pose, &other.footprint, &other.pose, gap)
            })
    }
}

/// Places round `centre`, nearest first, in its orientation.
fn around(centre: Pose2) -> impl Iterator<Item = Pose2> {
    let ring = move |ring: usize| {
        let radius = ring as f64 * RING_M;
        let places = if ring == 0 { 1 } else { PLACES };
        (0..places).map(move |place| {
            let (sin, cos) = (TAU * place as f64 / places as f64).sin_cos();
            Pose2::new(centre.x + radius * cos, centre.y + radius * sin, centre.theta)
        })
    };
    (0..RINGS).flat_map(ring)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rearrange::tabletop::instance::MarkerSpec;

    fn block() -> CellObject {
        let marker = MarkerSpec { family: "tag36h11".into(), id: 0, size: 0.03, offset: Pose2::default() };
        CellObject {
            id: "block".into(),
            group: None,
            footprint: Footprint::rectangle(0.08, 0.06).expect("valid"),
            impedance: None,
            height: 0.03,
            mass: 0.1,
            marker,
            grip_point: [0.0, 0.0],
            grip_yaw: None,
            hold: 20.0,
        }
    }

    fn thing(outline: Vec<[f64; 2]>, height_m: f64) -> ForeignObject {
        ForeignObject { centre: outline[0], outline, area_m2: 1e-3, height_m }
    }

    /// What is where the block was and no higher is the block; a hand on it, or beside it, is not.
    #[test]
    fn only_what_the_hidden_object_explains_is_no_stranger() {
        let at = Pose2::new(0.3, 0.2, std::f64::consts::FRAC_PI_2);
        let of_it = |outline: &[[f64; 2]], height| is_of(&block(), &at, &thing(outline.to_vec(), height));
        let half = [[0.28, 0.17], [0.33, 0.17], [0.33, 0.21]];
        assert!(of_it(&half, 0.031));
        assert!(!of_it(&half, 0.06), "higher than the block");
        assert!(!of_it(&half, f64::INFINITY), "of unknown height");
        assert!(!of_it(&[[0.28, 0.17], [0.40, 0.17], [0.33, 0.21]], 0.031), "it reaches out");
    }
}
