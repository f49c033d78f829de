//! Conveyors in the table: what lies on a belt goes along.
//!
//! In: where the belts are and how fast they run. Out: moved objects. What an object on a belt runs into is
//! pushed on as the arm pushes, and holds the object up where it does not give way; the belt slips under it
//! then. An object is on a belt while its middle is; one that bridges two follows the first that is listed.

use crate::motion::belt::TableBelt;
use crate::world::push::Pusher;
use crate::world::{Body, World};
use nalgebra::{Isometry3, Vector3};

/// Overlap that an object on a belt is pushed out of, m.
const MEETS_M: f64 = 1e-6;

fn carries(belt: &TableBelt, body: &Body) -> bool {
    let [x, y] = body.pose().transform(body.section.centroid());
    let [left, low, right, high] = belt.area;
    let flat = body.is_resting() && body.supports().is_empty() && !body.fixed;
    flat && (left..=right).contains(&x) && (low..=high).contains(&y)
}

impl World {
    /// Puts belts into the table in place of those that were there.
    pub fn set_conveyors(&mut self, conveyors: Vec<TableBelt>) {
        self.conveyors = conveyors;
    }

    /// One frame of the belts.
    pub(super) fn run_conveyors(&mut self, dt_s: f64) {
        if self.conveyors.is_empty() {
            return;
        }
        let before: Vec<Isometry3<f64>> = self.bodies.iter().map(|body| body.table_from_object).collect();
        let mut moved = vec![false; self.bodies.len()];
        for belt in self.conveyors.clone() {
            let ahead = Vector3::new(belt.velocity[0], belt.velocity[1], 0.0) * dt_s;
            let along = |world: &World, index: usize| {
                world.bodies[index].table_from_object.translation.vector.dot(&ahead)
            };
            let mut carried: Vec<usize> = (0..self.bodies.len())
                .filter(|index| !moved[*index] && carries(&belt, &self.bodies[*index]))
                .collect();
            // Those in front first, so that a row on the belt does not run into itself.
            carried.sort_by(|a, b| along(self, *b).total_cmp(&along(self, *a)));
            for index in carried {
                moved[index] = true;
                self.carry_on(index, &ahead);
            }
        }
        self.carry_along(&before);
        for (index, before) in before.iter().enumerate() {
            if self.bodies[index].table_from_object != *before && self.bodies[index].is_resting() {
                self.fall_off(index);
            }
        }
        self.settle_stacks();
    }

    fn carry_on(&mut self, index: usize, ahead: &Vector3<f64>) {
        let place = self.bodies[index].table_from_object;
        self.bodies[index].table_from_object.translation.vector += ahead;
        for (other, _) in self.overlapping(index, MEETS_M) {
            let pusher = Pusher::object(index, &self.bodies[index]);
            if self.push(&pusher, other).is_none() {
                self.bodies[index].table_from_object = place;
                return;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::motion::belt::TableBelt;
    use crate::world::tests::{Cell, block, no_errors};

    /// A belt along the middle of the table at 0.1 m/s, from x = 0 to 0.4.
    fn cell(objects: Vec<crate::world::spec::WorldObject>) -> Cell {
        let mut cell = Cell::new(objects, no_errors(), 3);
        cell.world.set_conveyors(vec![TableBelt { area: [0.0, 0.2, 0.4, 0.3], velocity: [0.1, 0.0] }]);
        cell
    }

    #[test]
    fn what_lies_on_the_belt_goes_along_to_its_end_and_what_lies_beside_it_does_not() {
        let mut cell = cell(vec![block("a", 0.1, 0.25), block("b", 0.1, 0.4)]);
        cell.wait(1.0);
        assert!((cell.pose("a").x - 0.2).abs() < 1e-9, "{:?}", cell.pose("a"));
        cell.wait(5.0);
        assert!(
            (0.4..0.4003).contains(&cell.pose("a").x),
            "its middle is beyond the end: {:?}",
            cell.pose("a")
        );
        assert_eq!((cell.pose("b").x, cell.pose("b").y), (0.1, 0.4));
    }

    #[test]
    fn a_row_keeps_its_distances_and_pushes_what_stands_in_its_way() {
        let mut cell = cell(vec![block("a", 0.1, 0.25), block("b", 0.16, 0.25), block("c", 0.44, 0.25)]);
        cell.wait(1.0);
        assert!((cell.pose("b").x - cell.pose("a").x - 0.06).abs() < 1e-9);
        cell.wait(1.4);
        // b is at 0.4 now, and c, which stood at its end, 0.05 before it.
        assert!((cell.pose("c").x - 0.45).abs() < 1e-3, "{:?}", cell.pose("c"));
        assert!((cell.pose("c").x - cell.pose("b").x - 0.05).abs() < 1e-4);
    }

    #[test]
    fn a_post_holds_what_runs_into_it_and_what_stands_on_top_goes_along() {
        let mut post = block("post", 0.35, 0.25);
        post.fixed = true;
        let mut cell = cell(vec![block("a", 0.1, 0.25), post, block("top", 0.4, 0.45)]);
        cell.world.set_conveyors(Vec::new());
        cell.move_object([0.4, 0.45], [0.11, 0.25], 0.021);
        assert!(cell.world.object("top").unwrap().is_stacked());
        cell.world.set_conveyors(vec![TableBelt { area: [0.0, 0.2, 0.4, 0.3], velocity: [0.1, 0.0] }]);
        cell.wait(1.0);
        assert!((cell.pose("top").x - cell.pose("a").x - 0.01).abs() < 1e-9);
        cell.wait(3.0);
        assert!((cell.pose("a").x - 0.3).abs() < 5e-4, "{:?}", cell.pose("a"));
        assert!(cell.world.object("top").unwrap().is_stacked());
        assert_eq!(cell.pose("post").x, 0.35);
    }

    #[test]
    fn a_gripper_takes_an_object_off_the_running_belt() {
        let mut cell = cell(vec![block("a", 0.1, 0.25)]);
        cell.world.set_conveyors(vec![TableBelt { area: [0.0, 0.2, 0.4, 0.3], velocity: [0.02, 0.0] }]);
        cell.grip(0.145, 0.25, 0.02);
        cell.go([0.2, 0.4, 0.1]);
        assert_eq!(cell.world.held().collect::<Vec<_>>(), ["a"]);
    }
}
