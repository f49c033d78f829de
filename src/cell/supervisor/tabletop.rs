//! What a path has to keep clear of on the table, and what hangs on the gripper, as bodies.
//!
//! In: the last look, the catalogue, what is held. Out: [`Tabletop`], [`Room`]. What was not seen since it
//! was last disturbed may be anywhere on the table, up to the tallest object.

use crate::cell::plan_check::PlanLimits;
use crate::cell::supervisor::cell::Supervisor;
use crate::motion::bodies::{Room, Standing, Tabletop};
use cell_vision::observe::Observation;
use std::sync::Arc;

impl Supervisor {
    /// What lies on the table but for the object `without`.
    pub(crate) fn tabletop(&self, seen: Option<&Observation>, without: &str) -> Tabletop {
        let Some(seen) = seen else { return Tabletop { layer: self.layer(), standing: Vec::new() } };
        let others = seen.objects.iter().filter(|object| object.id != without);
        let objects = others.filter_map(|object| {
            let known = self.model.object(&object.id)?;
            let (name, footprint) = (known.id.clone(), known.footprint.clone());
            Some(Standing { name, footprint, pose: object.pose, height: known.height })
        });
        let standing = objects.chain(self.standing_obstacles(seen)).collect();
        Tabletop { layer: self.layer(), standing }
    }

    /// Keep-out regions, fixed objects and what carries no marker. How high they are is not known of all,
    /// so all count as high as the highest.
    fn standing_obstacles(&self, seen: &Observation) -> Vec<Standing> {
        let height = self.cycle().tallest;
        let obstacles = self.obstacles(seen).into_iter().map(|region| Standing {
            name: "an obstacle on the table".to_string(),
            footprint: region.footprint,
            pose: region.pose,
            height,
        });
        obstacles.collect()
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
            mask: Arc::clone(&self.model.reach),
        }
    }

    /// Name of the object with this index in a plan request: those known of the seen ones, in their order.
    pub(crate) fn listed(&self, index: usize) -> String {
        let seen = self.seen.iter().flat_map(|seen| &seen.objects);
        let mut known = seen.filter(|object| self.model.object(&object.id).is_some());
        known.nth(index).map(|object| object.id.clone()).unwrap_or_default()
    }

    /// Anything may lie on the table up to here, m; the air over it is for what hangs below the tool.
    fn layer(&self) -> f64 {
        let cycle = self.cycle();
        cycle.tallest + 0.5 * cycle.air
    }

    /// The table as nothing was seen of it, and what may hang on the gripper.
    pub(crate) fn unseen_room(&self) -> Room {
        let bodies = &self.model.arm.bodies;
        let grasp = self.back.held.as_ref().and_then(|held| held.grasp.as_ref());
        let table = self.tabletop(None, "");
        Room::new(bodies, &table, None).holding(bodies, grasp.map(|grasp| grasp.load()))
    }

    /// Largest acceleration that what may hang on the gripper stands, m/s2.
    pub(crate) fn hold(&self) -> f64 {
        let grasp = self.back.held.as_ref().and_then(|held| held.grasp.as_ref());
        grasp.map_or(f64::INFINITY, |grasp| grasp.hold())
    }
}
