//! What a path has to keep clear of on the table, and what hangs on the gripper, as bodies.
//!
//! In: the last look, the catalogue, what is held. Out: [`Tabletop`], [`Room`]. What was not seen since it
//! was last disturbed may be anywhere on the table, up to the tallest object.

use crate::plan_check::PlanLimits;
use crate::supervisor::cell::Supervisor;
use cell_motion::bodies::{Room, Standing, Tabletop};
use cell_vision::observe::Observation;
use rearrange::tabletop::instance::KeepOut;
use std::sync::Arc;

impl Supervisor {
    /// What lies on the table but for the object `without`.
    pub(crate) fn tabletop(&self, seen: Option<&Observation>, without: &str) -> Tabletop {
        let Some(seen) = seen else { return self.cycle().tabletop(Vec::new()) };
        let others = seen.objects.iter().filter(|object| object.id != without);
        let objects = others.filter_map(|object| {
            let known = self.model.object(&object.id)?;
            let (name, footprint) = (known.id.clone(), known.footprint.clone());
            Some(Standing { name, footprint, pose: object.pose, height: known.height })
        });
        let standing = objects.chain(self.standing_obstacles(seen)).collect();
        self.cycle().tabletop(standing)
    }

    /// What stands there and is never moved: things without a marker as high as they were seen, fixed
    /// objects and keep-out regions, of which no height is known, as high as the tallest object.
    pub(crate) fn standing_obstacles(&self, seen: &Observation) -> Vec<Standing> {
        let standing = |name: &str, region: KeepOut, height| Standing {
            name: name.to_string(),
            footprint: region.footprint,
            pose: region.pose,
            height,
        };
        let kept_out = self.model.keep_out.iter().cloned();
        let kept_out =
            kept_out.map(|region| standing("a region kept free", region, self.model.cycle.tallest));
        let foreign = self.foreign_regions(seen);
        let foreign = foreign.map(|(region, height)| standing("a thing without a marker", region, height));
        kept_out.chain(foreign).collect()
    }

    /// What the arm can do of a plan for the table as it was seen.
    pub(crate) fn plan_limits(&self, seen: &Observation) -> PlanLimits {
        let known = seen.objects.iter();
        let objects = known
            .filter_map(|object| Some(self.model.object(&object.id)?.pick_n_place(object.pose, object.pose)));
        PlanLimits {
            arm: self.model.arm.clone(),
            cycle: self.cycle(),
            objects: objects.collect(),
            obstacles: self.standing_obstacles(seen),
            start: self.model.after_a_look(),
            mask: Arc::default(),
        }
    }

    /// Name of the object with this index in a plan request: those known of the seen ones, in their order.
    pub(crate) fn listed(&self, seen: &Observation, index: usize) -> Option<String> {
        let mut known = seen.objects.iter().filter(|object| self.model.object(&object.id).is_some());
        known.nth(index).map(|object| object.id.clone())
    }

    /// The table as nothing was seen of it, and what may hang on the gripper.
    pub(crate) fn unseen_room(&self) -> Room {
        let bodies = &self.model.arm.bodies;
        let grasp = self.back.held.as_ref().and_then(|held| held.grasp.as_ref());
        let table = self.tabletop(None, "");
        Room::new(bodies, &table, None).holding(bodies, grasp.map(|grasp| grasp.load()))
    }

    /// Largest acceleration that what may hang on the gripper withstands, m/s2.
    pub(crate) fn hold(&self) -> f64 {
        self.back.held.as_ref().map_or_else(|| self.unknown_hold(), |held| held.hold)
    }

    /// The same of something that was held when celld started: any object of the catalogue; no limit where
    /// nothing hangs.
    fn unknown_hold(&self) -> f64 {
        if !self.back.grips {
            return f64::INFINITY;
        }
        self.model.objects.iter().map(|object| object.hold).fold(f64::INFINITY, f64::min)
    }
}
