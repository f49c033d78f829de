//! When the camera exposes a frame, and from where: the part of the camera that has nothing to do with HTTP.
//!
//! In: the moment at which a picture is requested, the arm's recent way. Out: the window in which the frame
//! is exposed, when it reaches the client, and the camera's poses during the exposure. A sensor that runs
//! free exposes at multiples of its period; a requested frame is the next one that begins, exposed for a
//! while and then transferred. An arm that moves meanwhile smears the picture. Pure.

use crate::render::Renderer;
use crate::render::depth::DepthImage;
use crate::render::lens::CameraTruth;
use crate::render::scene::Scene;
use crate::render::sensor::Exposure;
use crate::world::World;
use crate::world::spec::CameraMount;
use cell_values::image::Image;
use nalgebra::Isometry3;

/// A camera that moves less than this during an exposure is drawn from one place: 0.02 px at half a metre, m
/// and rad.
const STILL: (f64, f64) = (1e-5, 3e-5);

/// Places along the exposure from which a smeared picture is drawn.
const PLACES: usize = 5;

/// How a camera takes its time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraTiming {
    /// From frame to frame, s; 0: a frame begins when it is requested.
    pub period_s: f64,
    /// For which a pixel gathers light, s.
    pub exposure_s: f64,
    /// From the end of the exposure to the client, s.
    pub latency_s: f64,
}

impl CameraTiming {
    /// 30 frames a second, exposed for 8 ms, 20 ms over USB.
    pub const D405: CameraTiming = CameraTiming { period_s: 1.0 / 30.0, exposure_s: 0.008, latency_s: 0.02 };

    /// A picture of the moment, at once.
    pub const INSTANT: CameraTiming = CameraTiming { period_s: 0.0, exposure_s: 0.0, latency_s: 0.0 };

    /// The frame for a client's request at `requested_s`.
    pub fn window(&self, requested_s: f64) -> Window {
        let begin_s = match self.period_s > 0.0 {
            // A frame that begins at this very moment counts.
            true => ((requested_s / self.period_s - 1e-6).ceil() * self.period_s).max(requested_s),
            false => requested_s,
        };
        let end_s = begin_s + self.exposure_s;
        Window { begin_s, end_s, ready_s: end_s + self.latency_s }
    }
}

/// One frame in time, on the controller's clock, s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// Light is gathered from here on.
    pub begin_s: f64,
    /// And no more from here on.
    pub end_s: f64,
    /// The client has it.
    pub ready_s: f64,
}

/// The camera as it is, and as it says it is.
#[derive(Clone, Debug)]
pub struct CameraSetup {
    /// The lens and sensor that take the pictures.
    pub truth: CameraTruth,
    /// What it says of itself.
    pub reported: CameraTruth,
    /// Where it sits, true.
    pub mount: CameraMount,
    /// How it takes its time.
    pub timing: CameraTiming,
}

/// A copy of what an exposure needs of the world, so that drawing does not hold it.
pub struct Moment {
    scene: Scene,
    places: Vec<Isometry3<f64>>,
    exposure: Exposure,
    seed: u64,
}

impl Moment {
    /// The colour picture; `number` chooses the noise.
    pub fn picture(&self, renderer: &Renderer, number: u64) -> Image {
        renderer.expose_along(&self.scene, &self.places, &self.exposure, [self.seed, number])
    }

    /// The depth picture of the same moment.
    pub fn depth(&self, renderer: &Renderer, number: u64) -> DepthImage {
        let middle = self.places.get(self.places.len() / 2).copied().unwrap_or_default();
        renderer.expose_depth(&self.scene, &middle, &self.exposure, [self.seed, number])
    }

    /// What is wrong with light and lens.
    pub fn exposure(&self) -> &Exposure {
        &self.exposure
    }

    /// What is there to be seen.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// `table_from_camera` along the exposure.
    pub fn places(&self) -> &[Isometry3<f64>] {
        &self.places
    }
}

impl World {
    /// What a camera exposes in a window that is over.
    pub fn moment(&self, setup: &CameraSetup, window: &Window) -> Moment {
        let faults = self.camera_faults();
        Moment {
            scene: self.scene(),
            places: setup.places(self, window),
            exposure: faults.exposure,
            seed: self.seed(),
        }
    }
}

impl CameraSetup {
    /// `table_from_camera` along the exposure; one place where the camera is still.
    pub fn places(&self, world: &World, window: &Window) -> Vec<Isometry3<f64>> {
        let shift = world.camera_faults().shift;
        let at = |time_s: f64| match &self.mount {
            CameraMount::Flange(flange_from_camera) => {
                world.table_from_flange_at(time_s) * flange_from_camera * shift
            }
            CameraMount::Fixed(table_from_camera) => table_from_camera * shift,
        };
        let along = |share: f64| at(window.begin_s + share * (window.end_s - window.begin_s));
        let (first, last) = (along(0.0), along(1.0));
        let way = (first.translation.vector - last.translation.vector).norm();
        if way <= STILL.0 && first.rotation.angle_to(&last.rotation) <= STILL.1 {
            return vec![along(0.5)];
        }
        (0..PLACES).map(|place| along((place as f64 + 0.5) / PLACES as f64)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::empty_world;

    #[test]
    fn a_frame_begins_with_the_sensor_and_arrives_after_exposure_and_transfer() {
        let timing = CameraTiming { period_s: 0.04, exposure_s: 0.01, latency_s: 0.02 };
        for (requested_s, begin_s) in
            [(0.0, 0.0), (0.001, 0.04), (0.0399, 0.04), (0.04, 0.04), (0.0401, 0.08)]
        {
            let window = timing.window(requested_s);
            assert!((window.begin_s - begin_s).abs() < 1e-9, "{requested_s}: {window:?}");
            assert!((window.end_s - begin_s - 0.01).abs() < 1e-9 && window.begin_s >= requested_s - 1e-9);
            assert!((window.ready_s - begin_s - 0.03).abs() < 1e-9);
        }
        let now = CameraTiming::INSTANT.window(7.3);
        assert_eq!((now.begin_s, now.end_s, now.ready_s), (7.3, 7.3, 7.3));
    }

    #[test]
    fn a_moving_arm_smears_the_picture_and_a_still_one_does_not() {
        let truth = CameraTruth::ideal("t", 64, 36, 40.0);
        let mount = CameraMount::Flange(Isometry3::identity());
        let timing = CameraTiming { period_s: 0.0, exposure_s: 0.02, latency_s: 0.0 };
        let setup = CameraSetup { reported: truth.clone(), truth, mount, timing };
        let mut world = empty_world(1);
        for frame in 0..100 {
            // 0.1 m/s from the 50th frame on.
            let x = 0.0002 * f64::from((frame - 50_i32).max(0));
            world.step(f64::from(frame) * 0.002, 0.002, &Isometry3::translation(x, 0.0, 0.5));
        }
        let still = setup.places(&world, &timing.window(0.05));
        let moving = setup.places(&world, &timing.window(0.15));
        assert_eq!((still.len(), moving.len()), (1, PLACES));
        let way = moving[PLACES - 1].translation.vector - moving[0].translation.vector;
        assert!((way.norm() - 0.002 * 0.8).abs() < 1e-6, "{way}");
    }
}
