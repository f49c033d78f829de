//! What can be seen of the world: the scene the camera draws.
//!
//! In: the world. Out: a [`Scene`] in the table frame, with what faults add to it or cover; the gripper is
//! drawn as its housing (from the flange down) and its cups, and the board on the hand where there is one.
//! The arm itself is not drawn: from the wrist nothing of it is in view.

use crate::render::scene::{Cells, Print, Prism, Scene};
use crate::world::spec::ObjectMarker;
use crate::world::{Body, World};
use cell_values::image::tag36h11_bitmap;
use nalgebra::Isometry3;

impl World {
    /// A light copy of what can be seen now.
    pub fn scene(&self) -> Scene {
        let margin = self.table.margin_m;
        let flange = self.tool.map_or(Isometry3::identity(), |tool| tool.base_from_flange);
        let table_from_flange = self.table_from_base * flange;
        let on_table = self.reference.iter().map(|(marker, cells)| Print {
            cells: *cells,
            size_m: marker.size_m,
            pose: marker.pose,
        });
        let mut prisms: Vec<Prism> =
            self.bodies.iter().filter(|body| !body.is_fallen()).map(object).collect();
        if self.tool.is_some() {
            prisms.extend(self.gripper_prisms(&table_from_flange));
            prisms.extend(self.hand_board.iter().map(|plate| plate.carried(&table_from_flange)));
        }
        let mut scene = Scene {
            board: [-margin, -margin, self.table.width_m + margin, self.table.height_m + margin],
            table_from_flange,
            prisms,
            prints: on_table.collect(),
        };
        self.disturb_prints(&mut scene);
        scene
    }

    /// `table_from_flange` at a time of the last 0.6 s, between two controller frames in proportion.
    pub fn table_from_flange_at(&self, time_s: f64) -> Isometry3<f64> {
        let after = self.trail.partition_point(|(at, _)| *at < time_s);
        let flange = match (after.checked_sub(1).and_then(|i| self.trail.get(i)), self.trail.get(after)) {
            (Some((before_s, before)), Some((after_s, after))) => {
                let share = (time_s - before_s) / (after_s - before_s).max(1e-9);
                before.lerp_slerp(after, share.clamp(0.0, 1.0))
            }
            (Some((_, only)), None) | (None, Some((_, only))) => *only,
            (None, None) => Isometry3::identity(),
        };
        self.table_from_base * flange
    }

    /// Covers prints and adds others, as the camera's faults say.
    fn disturb_prints(&self, scene: &mut Scene) {
        for cells in self.camera.covered.iter().filter_map(|id| tag36h11_bitmap(*id)) {
            let on_objects = scene.prisms.iter_mut().flat_map(|prism| &mut prism.prints);
            for print in scene.prints.iter_mut().chain(on_objects).filter(|print| print.cells == cells) {
                // A strip of white paper over the left half.
                print.cells.iter_mut().for_each(|row| row[..5].fill(true));
            }
        }
        for extra in &self.camera.prints {
            let (cells, like_m) = self.print_of(extra.marker).unzip();
            if let (Some(cells), Some(size_m)) =
                (cells.or_else(|| tag36h11_bitmap(extra.marker)), extra.size_m.or(like_m))
            {
                scene.prints.push(Print { cells, size_m, pose: extra.pose });
            }
        }
    }

    /// Housing between flange and `body_above_lips_m`, and the cups below it, as drawn shapes.
    fn gripper_prisms(&self, table_from_flange: &Isometry3<f64>) -> Vec<Prism> {
        let gripper = &self.gripper;
        let table_from_tool = table_from_flange * gripper.flange_from_tool;
        let reach_m = gripper.flange_from_tool.translation.z;
        let under_m = gripper.body_above_lips_m;
        let mut prisms = Vec::new();
        if reach_m > under_m {
            prisms.push(Prism {
                table_from_prism: table_from_tool * Isometry3::translation(0.0, 0.0, -reach_m),
                section: self.housing.clone(),
                height_m: reach_m - under_m,
                colour: [70, 72, 78],
                prints: Vec::new(),
            });
        }
        for (cup, lip) in gripper.cups.iter().zip(&self.cup_sections) {
            prisms.push(Prism {
                table_from_prism: table_from_tool * Isometry3::translation(cup.x_m, cup.y_m, -under_m),
                section: lip.clone(),
                height_m: under_m,
                colour: [40, 40, 44],
                prints: Vec::new(),
            });
        }
        for (place, fingers) in self.fingers.iter().flat_map(|it| it.places().map(|place| (place, it))) {
            prisms.push(Prism {
                table_from_prism: table_from_tool * Isometry3::translation(place, 0.0, -under_m),
                section: fingers.section.clone(),
                height_m: under_m,
                colour: [40, 40, 44],
                prints: Vec::new(),
            });
        }
        prisms
    }
}

fn object(body: &Body) -> Prism {
    let print = |(marker, cells): &(ObjectMarker, Cells)| Print {
        cells: *cells,
        size_m: marker.size_m,
        pose: marker.offset,
    };
    Prism {
        table_from_prism: body.table_from_object,
        section: body.section.clone(),
        height_m: body.height_m,
        colour: body.colour,
        prints: body.marker.iter().map(print).collect(),
    }
}
