//! Where what is held may be put down: its goal, or the nearest free place.
//!
//! In: where the object hangs, a look made after the stop. Out: a pose on the table that is inside it, clear
//! of everything seen, of keep-out regions and of what was there before the stop and is not seen now, with
//! paths down and up that pass the check; or why there is none. Pure.

use crate::cell::supervisor::back::Held;
use crate::cell::supervisor::cell::Supervisor;
use crate::motion::bodies::Standing;
use crate::motion::put_down::PutDown;
use cell_values::units::Joints;
use cell_vision::observe::Observation;
use rearrange::geometry::collision::{closer_than, inside};
use rearrange::geometry::footprint::Footprint;
use rearrange::geometry::pose::Pose2;
use std::f64::consts::TAU;

/// Least gap to everything else, m: the object may have slipped a little on the cups when the arm stopped.
const GAP_M: f64 = 0.005;

/// Rings of places round the point below the object, and places on each.
const RING_M: f64 = 0.015;
const RINGS: usize = 40;
const PLACES: usize = 24;

/// Free places whose paths are tried: no heartbeat goes out meanwhile.
const TRIES: usize = 12;

/// Something that takes room on the table.
struct Taken {
    footprint: Footprint,
    pose: Pose2,
    height: f64,
}

impl Supervisor {
    /// A place for what is held, whether it is the one it was carried to, and the paths.
    pub(crate) fn place_for_held(
        &self,
        q: &Joints,
        below: Pose2,
        seen: &Observation,
    ) -> Result<(Pose2, bool, PutDown), String> {
        let held = self.back.held.as_ref().ok_or("nothing is known to be held")?;
        let object = self.model.object(&held.object).ok_or("the catalogue does not have what is held")?;
        let grasp = held.grasp.as_ref().ok_or("how the object hangs is not known")?;
        let taken = self.taken(held, seen);
        let free =
            |pose: &Pose2| self.is_free(&object.footprint, object.grip_point, held.height, pose, &taken);
        let mut table = self.tabletop(Some(seen), &held.object);
        let hidden = self.hidden(held, seen).filter_map(|(id, pose)| {
            let object = self.model.object(id)?;
            Some(object.pick_n_place(pose, pose).lying_at(pose))
        });
        table.standing.extend(hidden);
        let mut fault = None;
        let ring = around(below).map(|pose| (pose, false));
        let candidates = std::iter::once((held.to, true)).chain(ring).filter(|(pose, _)| free(pose));
        for (pose, meant) in candidates.take(TRIES) {
            match grasp.put_down(&self.model.arm, q, &pose, &self.cycle(), &table) {
                Ok(paths) => return Ok((pose, meant, paths)),
                Err(found) => fault = fault.or(Some(found)),
            }
        }
        Err(fault.map_or_else(
            || "no place on the table is free; make room by hand".to_string(),
            |fault| format!("no free place can be reached: {fault}"),
        ))
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
        let unseen = report.flat_map(|report| &report.holes).map(|hole| Taken {
            footprint: Footprint::Disc { radius: hole.reach_m },
            pose: Pose2::new(hole.centre[0], hole.centre[1], 0.0),
            height: 0.0,
        });
        objects.chain(fixed).chain(unseen).collect()
    }

    /// What was there before and is not seen now: what is held may hide it.
    fn hidden<'a>(&'a self, held: &'a Held, seen: &'a Observation) -> impl Iterator<Item = (&'a str, Pose2)> {
        let unseen = |id: &str| !seen.objects.iter().any(|object| object.id == id);
        let before = self.back.table.iter().filter(move |(id, _)| unseen(id) && *id != held.object);
        before.map(|(id, pose)| (id.as_str(), *pose))
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
