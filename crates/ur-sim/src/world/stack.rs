//! Objects that stand on objects.
//!
//! In: where an object is put down, and what lies there. Out: whether it stands on top of that, flat, and
//! what comes down when something under a stack goes. The model is quasi-static: an object stands where the
//! centre of mass of it and of what it carries is over the hull of its contacts, for itself and for all
//! that it stands on. What stands on several carries weight into each in equal parts, at its own centre;
//! tops that differ by less than a millimetre are one. What does not stand leans (`placing`).

use crate::world::section::{Section, within_hull};
use crate::world::{Body, BodyState, World};
use nalgebra::Isometry3;
use rearrange::geometry::pose::Pose2;

/// Tops this close bear together, m.
const LEVEL_M: f64 = 1e-3;
/// An object this flat can bear another, rad.
const FLAT_RAD: f64 = 1e-6;
/// Objects above each other that a load is followed through; a pile as high as that does not stand.
const HIGHEST: usize = 16;
/// Rounds in which stacks settle.
const ROUNDS: usize = 8;

impl Body {
    /// It stands flat on others.
    pub fn is_stacked(&self) -> bool {
        matches!(&self.state, BodyState::Resting { on } if !on.is_empty()) && self.tilt_rad() < FLAT_RAD
    }

    /// What it lies on, besides the table.
    pub(super) fn supports(&self) -> &[usize] {
        match &self.state {
            BodyState::Resting { on } => on,
            BodyState::Held { .. } | BodyState::Fallen => &[],
        }
    }

    fn bears(&self) -> bool {
        self.is_resting() && self.tilt_rad() < FLAT_RAD
    }

    /// Its centre of mass on the table.
    fn centre(&self) -> [f64; 2] {
        self.pose().transform(self.section.centroid())
    }
}

impl World {
    /// Stands the object on what is under it at `pose`, if it then stands; false, and nothing changed, if
    /// not.
    pub(super) fn stand_on(&mut self, index: usize, pose: &Pose2, under: &[usize]) -> bool {
        let top_m = under.iter().map(|other| self.bodies[*other].top_m()).fold(0.0, f64::max);
        let bearing = |other: &usize| {
            let body = &self.bodies[*other];
            body.bears() && body.top_m() > top_m - LEVEL_M
        };
        let on: Vec<usize> = under.iter().copied().filter(bearing).collect();
        if on.is_empty() {
            return false;
        }
        let before = (self.bodies[index].table_from_object, self.bodies[index].state.clone());
        let body = &mut self.bodies[index];
        body.table_from_object = pose.at_height(top_m);
        body.state = BodyState::Resting { on };
        let stands = self.stands(index, HIGHEST);
        if !stands {
            let body = &mut self.bodies[index];
            (body.table_from_object, body.state) = before;
        }
        stands
    }

    /// The object and all that it stands on stand.
    fn stands(&self, index: usize, depth: usize) -> bool {
        let body = &self.bodies[index];
        if body.supports().is_empty() {
            // Flat on the table: over its own outline a load may hang out.
            return depth > 0 && self.contact_holds(index, &body.section.corners(&body.pose()));
        }
        let contacts: Vec<[f64; 2]> = body
            .supports()
            .iter()
            .flat_map(|other| {
                let under = &self.bodies[*other];
                Section::common(&body.section, &body.pose(), &under.section, &under.pose())
            })
            .collect();
        depth > 0
            && self.contact_holds(index, &contacts)
            && body.supports().iter().all(|other| self.stands(*other, depth - 1))
    }

    fn contact_holds(&self, index: usize, contacts: &[[f64; 2]]) -> bool {
        let (mass, moment) = self.load(index, HIGHEST);
        self.bodies[index].fixed || within_hull(contacts, [moment[0] / mass, moment[1] / mass])
    }

    /// Mass of an object and what it carries, and that times its place, kg and kg m.
    fn load(&self, index: usize, depth: usize) -> (f64, [f64; 2]) {
        let body = &self.bodies[index];
        let (centre, mut mass) = (body.centre(), body.mass_kg);
        let mut moment = [centre[0] * mass, centre[1] * mass];
        for (other, above) in self.bodies.iter().enumerate() {
            if depth > 0 && above.is_stacked() && above.supports().contains(&index) {
                let (weight, along) = self.load(other, depth - 1);
                let share = 1.0 / above.supports().len() as f64;
                mass += weight * share;
                (moment[0], moment[1]) = (moment[0] + along[0] * share, moment[1] + along[1] * share);
            }
        }
        (mass, moment)
    }

    /// Kg of everything that stands on an object.
    pub(super) fn carried_kg(&self, index: usize) -> f64 {
        self.load(index, HIGHEST).0 - self.bodies[index].mass_kg
    }

    /// What stood on something that has moved or gone, and does not stand any more, comes down.
    pub(super) fn settle_stacks(&mut self) {
        for _ in 0..ROUNDS {
            let loose = |world: &World, index: usize| {
                let body = &world.bodies[index];
                body.is_stacked() && !world.still_stands(index)
            };
            // From the bottom: what is under others comes down before them.
            let mut order: Vec<usize> = (0..self.bodies.len()).filter(|i| loose(self, *i)).collect();
            if order.is_empty() {
                return;
            }
            order.sort_by(|a, b| self.bodies[*a].bottom_m().total_cmp(&self.bodies[*b].bottom_m()));
            for index in order {
                let pose = self.bodies[index].pose();
                self.come_down(index, pose);
            }
        }
    }

    fn still_stands(&self, index: usize) -> bool {
        let body = &self.bodies[index];
        let at_m = body.bottom_m();
        let there = |other: &usize| {
            let under = &self.bodies[*other];
            under.bears() && (under.top_m() - at_m).abs() <= LEVEL_M
        };
        body.supports().iter().all(there) && self.stands(index, HIGHEST)
    }

    /// What stands on objects that have moved since `before` goes with them.
    pub(super) fn carry_along(&mut self, before: &[Isometry3<f64>]) {
        let mut order: Vec<usize> = (0..self.bodies.len()).filter(|i| self.bodies[*i].is_stacked()).collect();
        order.sort_by(|a, b| self.bodies[*a].bottom_m().total_cmp(&self.bodies[*b].bottom_m()));
        for index in order {
            let moved = self.bodies[index].supports().iter().copied().find(|other| {
                before.get(*other).is_some_and(|before| *before != self.bodies[*other].table_from_object)
            });
            // One that has been pushed itself is where it was pushed to.
            let own = before.get(index).is_some_and(|own| *own == self.bodies[index].table_from_object);
            if let (Some(other), true) = (moved, own) {
                let motion = self.bodies[other].table_from_object * before[other].inverse();
                self.bodies[index].table_from_object = motion * self.bodies[index].table_from_object;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::world::event::EventKind;
    use crate::world::tests::{Cell, block, no_errors};
    use crate::world::vacuum::{Channel, VacuumMode};
    use rearrange::geometry::footprint::Footprint;
    use rearrange::geometry::pose::Pose2;

    fn height(cell: &Cell, id: &str) -> f64 {
        cell.world.object(id).unwrap().table_from_object.translation.z
    }

    fn stacked(cell: &Cell, id: &str) -> bool {
        cell.world.object(id).unwrap().is_stacked()
    }

    /// Blocks of 50 mm and 20 mm height, `b` at (0.3, 0.3), and `a` set down on it from (0.1, 0.1).
    fn pair(x: f64) -> Cell {
        let mut cell = Cell::new(vec![block("a", 0.1, 0.1), block("b", 0.3, 0.3)], no_errors(), 6);
        cell.move_object([0.1, 0.1], [x, 0.3], 0.021);
        cell
    }

    #[test]
    fn a_block_set_down_on_another_stands_there_and_is_picked_again() {
        let mut cell = pair(0.31);
        assert!(stacked(&cell, "a") && !cell.world.object("a").unwrap().is_tilted());
        assert!((height(&cell, "a") - 0.02).abs() < 1e-12);
        assert!(cell.pose("a").distance(&Pose2::new(0.31, 0.3, 0.0)) < 1e-9);
        let reported = cell.world.snapshot_json();
        assert_eq!(
            (&reported["objects"][0]["on"][0], &reported["objects"][0]["z_m"]),
            (&"b".into(), &0.02.into())
        );
        cell.at = [0.31, 0.3, 0.15];
        cell.go([0.31, 0.3, 0.04]);
        cell.world.command_vacuum(Channel::A, VacuumMode::Grip, 0.6);
        cell.wait(0.5);
        assert_eq!(cell.world.held().collect::<Vec<_>>(), ["a"], "the upper one");
        cell.go([0.31, 0.3, 0.15]);
        assert_eq!((height(&cell, "b"), cell.pose("b").x), (0.0, 0.3));
        assert_eq!(cell.happened(|kind| matches!(kind, EventKind::Contact(_))), 0);
    }

    #[test]
    fn a_block_whose_middle_is_beyond_the_lower_ones_edge_leans() {
        for (x, stands) in [(0.3245, true), (0.3255, false)] {
            let cell = pair(x);
            assert_eq!(stacked(&cell, "a"), stands, "{x}");
            assert_eq!(cell.world.object("a").unwrap().is_tilted(), !stands, "{x}");
        }
    }

    #[test]
    fn what_stood_on_a_block_comes_down_when_that_is_taken() {
        let mut wide = block("b", 0.3, 0.3);
        wide.footprint = Footprint::rectangle(0.12, 0.05).unwrap();
        let mut cell = Cell::new(vec![block("a", 0.1, 0.1), wide], no_errors(), 6);
        cell.move_object([0.1, 0.1], [0.27, 0.3], 0.021);
        assert!(stacked(&cell, "a"));
        cell.grip(0.345, 0.3, 0.02);
        assert_eq!(cell.world.held().collect::<Vec<_>>(), ["b"]);
        cell.go([0.345, 0.3, 0.1]);
        assert_eq!(height(&cell, "a"), 0.0);
        assert!(!stacked(&cell, "a"));
    }

    #[test]
    fn what_stands_on_a_block_goes_with_it_when_it_is_pushed() {
        let mut cell = pair(0.3);
        cell.go([0.2, 0.3, 0.1]);
        cell.go([0.2, 0.3, 0.005]);
        cell.go([0.3, 0.3, 0.005]);
        let (upper, lower) = (cell.pose("a"), cell.pose("b"));
        assert!((lower.x - 0.335).abs() < 1e-4, "{lower:?}");
        assert!((upper.x - lower.x).abs() < 1e-4 && stacked(&cell, "a"), "{upper:?}");
    }

    #[test]
    fn a_block_pushed_off_another_leans_and_then_lies() {
        let mut cell = pair(0.3);
        cell.go([0.2, 0.3, 0.1]);
        cell.go([0.2, 0.3, 0.03]);
        cell.go([0.28, 0.3, 0.03]);
        // The front of the cup is at 0.29; the block begins there.
        assert!((cell.pose("b").x - 0.3).abs() < 1e-9, "the lower one stays");
        assert!((cell.pose("a").x - 0.315).abs() < 1e-3 && stacked(&cell, "a"), "{:?}", cell.pose("a"));
        cell.go([0.30, 0.3, 0.03]);
        assert!(!stacked(&cell, "a"), "its middle is beyond the edge");
    }

    #[test]
    fn a_bridge_stands_on_two_and_a_counterweight_holds_what_hangs_out() {
        let mut beam = block("beam", 0.1, 0.1);
        beam.footprint = Footprint::rectangle(0.15, 0.04).unwrap();
        let bridge = vec![beam.clone(), block("b", 0.25, 0.3), block("c", 0.35, 0.3)];
        let mut cell = Cell::new(bridge, no_errors(), 6);
        cell.move_object([0.1, 0.1], [0.3, 0.3], 0.021);
        assert!(stacked(&cell, "beam"), "nothing is under its middle, but on both sides of it");
        let balance = || {
            let objects =
                vec![beam.clone(), block("b", 0.3, 0.3), block("w", 0.4, 0.1), block("v", 0.1, 0.4)];
            let mut cell = Cell::new(objects, no_errors(), 6);
            cell.move_object([0.1, 0.1], [0.3, 0.3], 0.021);
            cell
        };
        // The lower block ends at 0.325; of beam and weight the middle is at 0.3275, with the other at
        // 0.3133.
        let mut cell = balance();
        cell.move_object([0.4, 0.1], [0.355, 0.3], 0.041);
        assert!(!stacked(&cell, "w") && stacked(&cell, "beam"), "it would tip the beam over");
        let mut cell = balance();
        cell.move_object([0.1, 0.4], [0.285, 0.3], 0.041);
        cell.move_object([0.4, 0.1], [0.355, 0.3], 0.041);
        assert!(stacked(&cell, "v") && stacked(&cell, "w") && stacked(&cell, "beam"));
        cell.move_object_at([0.285, 0.3], 0.06, [0.1, 0.4], 0.001);
        assert!(!stacked(&cell, "beam") && !stacked(&cell, "w"), "nothing balances them any more");
    }

    #[test]
    fn a_pile_is_there_from_the_start_and_what_would_not_stand_leans() {
        let over = |x: f64| vec![block("a", 0.3, 0.3), block("b", 0.305, 0.3), block("c", x, 0.3)];
        let cell = Cell::new(over(0.31), no_errors(), 6);
        assert_eq!([height(&cell, "a"), height(&cell, "b")], [0.0, 0.02]);
        assert!((height(&cell, "c") - 0.04).abs() < 1e-12 && stacked(&cell, "c"));
        let cell = Cell::new(over(0.345), no_errors(), 6);
        assert!(stacked(&cell, "b") && cell.world.object("c").unwrap().is_tilted());
        let mut apart = over(0.4);
        apart.swap(1, 2);
        let cell = Cell::new(apart, no_errors(), 6);
        assert_eq!(height(&cell, "c"), 0.0, "beside them");
    }

    #[test]
    fn three_stand_on_each_other_and_all_come_down_with_the_lowest() {
        let objects = vec![block("a", 0.1, 0.1), block("b", 0.3, 0.3), block("c", 0.1, 0.3)];
        let mut cell = Cell::new(objects, no_errors(), 6);
        cell.move_object([0.1, 0.1], [0.3, 0.3], 0.021);
        cell.move_object([0.1, 0.3], [0.305, 0.3], 0.041);
        assert!(stacked(&cell, "a") && stacked(&cell, "c"));
        assert!((height(&cell, "c") - 0.04).abs() < 1e-12);
        cell.world.nudge("b", &Pose2::new(-0.1, 0.0, 0.0)).unwrap();
        assert_eq!((height(&cell, "b"), height(&cell, "a")), (0.0, 0.0));
        assert!((height(&cell, "c") - 0.02).abs() < 1e-12, "it stands on a as before");
    }
}
