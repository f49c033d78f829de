//! Pictures of a look that could not be trusted: foreign objects outlined, and arrows where the reference
//! markers went.
//!
//! In: the pictures of a look, its views, what was observed in them, the scene. Out: one picture for each
//! look pose, or none where the look is fine; the caller keeps them.

use crate::perception::Scene;
use cell_values::image::Image;
use cell_vision::annotate::{draw_drift, draw_overlays, foreign_overlays};
use cell_vision::observe::reference::LookShift;
use cell_vision::observe::{Observation, View};
use nalgebra::Isometry3;

/// Look poses that are kept at most.
pub const SHOTS_MAX: usize = 8;

/// The last picture of one look pose.
pub struct Shot {
    /// What the camera saw.
    pub image: Image,
    /// From where.
    pub table_from_camera: Isometry3<f64>,
}

/// Keeps the newest picture of each place.
pub fn keep(shots: &mut Vec<Shot>, shot: Shot) {
    shots.retain(|old| old.table_from_camera != shot.table_from_camera);
    shots.push(shot);
    if shots.len() > SHOTS_MAX {
        shots.remove(0);
    }
}

/// Pictures of what is doubted in a look, as PNG, in the order of the shots; none for a look that is fine.
///
/// # Errors
/// A picture that cannot be drawn.
pub fn pictures(
    scene: &Scene,
    shots: &[Shot],
    views: &[View],
    seen: &Observation,
) -> Result<Vec<Vec<u8>>, String> {
    let foreign = seen.foreign.as_ref().map_or(&[][..], |report| &report.objects);
    let drifted = seen.reference.as_ref().is_some_and(|check| check.drifted(&scene.drift));
    if foreign.is_empty() && !drifted {
        return Ok(Vec::new());
    }
    shots.iter().map(|shot| draw(scene, shot, look_of(shot, views, seen), seen)).collect()
}

/// What the reference markers said from where this picture was taken; from another side they say something
/// else.
fn look_of<'a>(shot: &Shot, views: &[View], seen: &'a Observation) -> Option<&'a LookShift> {
    let from_here = |look: &&LookShift| {
        views.get(look.view).is_some_and(|view| view.table_from_camera == shot.table_from_camera)
    };
    seen.reference.as_ref()?.looks.iter().find(from_here)
}

fn draw(scene: &Scene, shot: &Shot, look: Option<&LookShift>, seen: &Observation) -> Result<Vec<u8>, String> {
    let (camera, eye) = (&scene.camera, &shot.table_from_camera);
    let mut image = shot.image.clone();
    if let Some(report) = &seen.foreign {
        let overlays = foreign_overlays(&report.objects);
        draw_overlays(&mut image, &overlays, camera, eye).map_err(|error| error.to_string())?;
    }
    if let Some(look) = look {
        let limit_m = scene.drift.shift_m;
        draw_drift(&mut image, look, &scene.reference, limit_m, camera, eye)
            .map_err(|error| error.to_string())?;
    }
    image.encode_png().map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use cell_values::time::Timestamp;
    use cell_vision::camera::CameraModel;
    use cell_vision::foreign::{ForeignObject, ForeignReport};
    use cell_vision::observe::reference::{DriftLimits, ReferenceCheck, ReferenceError};
    use cell_vision::observe::{ObserveLimits, ReferenceMarker};
    use nalgebra::Vector3;
    use rearrange::geometry::pose::Pose2;

    fn scene() -> Scene {
        let camera = CameraModel {
            serial: "t".into(),
            width: 320,
            height: 240,
            fx: 300.0,
            fy: 300.0,
            cx: 160.0,
            cy: 120.0,
            distortion: [0.0; 5],
        };
        Scene {
            camera,
            objects: Vec::new(),
            reference: vec![ReferenceMarker { id: 500, size: 0.03, pose: Pose2::new(0.05, 0.0, 0.0) }],
            limits: ObserveLimits::default(),
            foreign: None,
            drift: DriftLimits { residual_m: 1e-3, shift_m: 1e-3, turn_rad: 1e-3 },
        }
    }

    fn shot(x: f64) -> Shot {
        let down = Isometry3::new(Vector3::new(x, 0.0, 0.5), Vector3::x() * std::f64::consts::PI);
        Shot { image: Image::filled(320, 240, [0; 3]), table_from_camera: down }
    }

    #[test]
    fn what_is_doubted_is_drawn_and_a_good_look_is_not() {
        let outline = vec![[-0.03, -0.03], [0.03, -0.03], [0.03, 0.03], [-0.03, 0.03]];
        let object = ForeignObject { outline, centre: [0.0; 2], area_m2: 0.0036, height_m: 0.05 };
        let report = ForeignReport { objects: vec![object], measured_share: 1.0, ..ForeignReport::default() };
        let seen = Observation { foreign: Some(report), ..Observation::default() };
        let drawn = pictures(&scene(), &[shot(0.0), shot(0.02)], &[], &seen).unwrap();
        assert_eq!(drawn.len(), 2);
        for bytes in drawn {
            let drawn = Image::decode(&bytes).unwrap();
            assert!(drawn.rgb.chunks_exact(3).filter(|p| p[0] > 200).count() > 100);
        }
        assert!(pictures(&scene(), &[shot(0.0)], &[], &Observation::default()).unwrap().is_empty());
    }

    #[test]
    fn each_picture_shows_the_shift_from_its_own_place() {
        let view = |x: f64| View {
            table_from_camera: shot(x).table_from_camera,
            detections: Vec::new(),
            time: Timestamp::ZERO,
            heights: None,
        };
        // What a bump shifts from one side it shifts back from the other: in the mean there is nothing to be
        // seen.
        let error = |dx: f64| ReferenceError { id: 500, error_m: [dx, 0.0], error_rad: 0.0, views: 1 };
        let look = |view: usize, dx: f64| LookShift {
            view,
            markers: 3,
            shift_m: [dx, 0.0],
            turn_rad: 0.0,
            lift_m: 0.0,
            errors: vec![error(dx)],
        };
        let check = ReferenceCheck {
            markers: vec![error(0.0)],
            residual_rms_m: 0.0,
            residual_max_m: 0.0,
            shift_m: [0.0; 2],
            turn_rad: 0.0,
            looks: vec![look(0, 3e-3), look(1, -3e-3)],
        };
        let seen = Observation { reference: Some(check), ..Observation::default() };
        let (shots, views) = ([shot(0.0), shot(0.02)], [view(0.0), view(0.02)]);
        let drawn = pictures(&scene(), &shots, &views, &seen).unwrap();
        let lengths = [0, 1].map(|index| {
            let drawn = Image::decode(&drawn[index]).unwrap();
            // The marker is at x = 50 mm; the picture's middle at 0 and 20 mm, 0.6 px to a mm.
            let start = if index == 0 { 190 } else { 178 };
            let red = |u: u32| (116..=124).any(|v| drawn.pixel(u, v) == Some(cell_vision::annotate::BAD));
            [red(start + 25), red(start - 25)]
        });
        assert_eq!(lengths, [[true, false], [false, true]]);
    }

    #[test]
    fn the_newest_picture_of_each_place_is_kept_and_not_too_many() {
        let mut shots = Vec::new();
        for number in 0..20 {
            keep(&mut shots, shot(f64::from(number % 10)));
        }
        assert_eq!(shots.len(), SHOTS_MAX);
        keep(&mut shots, shot(9.0));
        assert_eq!(shots.len(), SHOTS_MAX);
    }
}
