//! The moves of a plan drawn over a picture of the table: numbered arrows and the outlines they lead to.
//!
//! In: moves in the table frame, the camera's lens and pose. Out: the picture with them. Whoever approves a
//! plan compares it with what lies there, and not with a list of numbers.

use super::{Overlay, arrow, draw_outline, path, raster};
use crate::camera::CameraModel;
use crate::cv::CvError;
use cell_values::image::Image;
use nalgebra::Isometry3;
use rearrange::geometry::pose::Pose2;

/// A move of a plan.
#[derive(Clone, Debug)]
pub struct DrawnMove {
    /// From 1.
    pub number: usize,
    /// Where the object lies, table frame.
    pub from: Pose2,
    /// Where it goes.
    pub to: Pose2,
    /// Height of its top, m.
    pub height_m: f64,
    /// Its outline in its own frame, m; closed by itself.
    pub outline: Vec<[f64; 2]>,
    /// The object's own, as in every other picture of it.
    pub colour: [u8; 3],
}

/// Draws for each move the outline where the object goes and an arrow from where it lies, with the number of
/// the move, all of them in the object's colour.
///
/// # Errors
/// What OpenCV reports; what the camera does not see is left out.
pub fn draw_moves(
    image: &mut Image,
    moves: &[DrawnMove],
    camera: &CameraModel,
    table_from_camera: &Isometry3<f64>,
) -> Result<(), CvError> {
    let outline_of = |step: &DrawnMove| Overlay {
        label: String::new(),
        pose: step.to,
        height_m: step.height_m,
        outline: step.outline.clone(),
        colour: step.colour,
    };
    for step in moves {
        draw_outline(image, &outline_of(step), camera, table_from_camera)?;
    }
    // Arrows and numbers last, so that no outline hides them.
    for step in moves {
        let at = |pose: Pose2| {
            let overlay = Overlay { pose, ..outline_of(step) };
            path(&overlay, [0.0, 0.0], [0.0, 0.0], camera, table_from_camera)
                .map(|found| found.first().copied())
        };
        let (Some(from), Some(to)) = (at(step.from)?, at(step.to)?) else { continue };
        arrow(image, from, to, step.colour);
        // Nearer to its beginning: where several arrows end, their numbers stay apart.
        let along = |k: usize| from[k] + 0.3 * (to[k] - from[k]);
        raster::text(image, [along(0), along(1)], &step.number.to_string(), step.colour, 3);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{camera, looking_down, project};
    use nalgebra::Point3;

    #[test]
    fn a_move_is_an_arrow_with_its_number_and_the_outline_it_leads_to() {
        let lens = camera(640, 480);
        let table_from_camera = looking_down(0.0, 0.0, 0.4, [0.0, 0.0], 0.0);
        let step = DrawnMove {
            number: 1,
            from: Pose2::new(-0.06, 0.0, 0.0),
            to: Pose2::new(0.06, 0.0, 0.0),
            height_m: 0.02,
            outline: vec![[-0.02, -0.02], [0.02, -0.02], [0.02, 0.02], [-0.02, 0.02]],
            colour: [40, 120, 190],
        };
        let mut image = Image::filled(640, 480, [0; 3]);
        draw_moves(&mut image, std::slice::from_ref(&step), &lens, &table_from_camera).unwrap();
        let colour = |x: f64, y: f64| {
            let [u, v] = project(&lens, &(table_from_camera.inverse() * Point3::new(x, y, 0.02)));
            image.pixel(u.round() as u32, v.round() as u32)
        };
        assert_eq!(colour(0.01, 0.0), Some(step.colour), "the arrow passes there");
        assert_eq!(colour(0.08, 0.01), Some(step.colour), "the outline at its end");
        assert_eq!(colour(-0.08, 0.01), Some([0; 3]), "and none where it begins");
        // What is behind the camera or far outside breaks nothing.
        let outside = DrawnMove { from: Pose2::new(1e6, f64::NAN, 0.0), ..step };
        draw_moves(&mut image, &[outside], &lens, &table_from_camera).unwrap();
    }
}
