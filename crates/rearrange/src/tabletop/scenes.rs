//! The named scenes of the demo: instance files that come with the binary.
//!
//! In: a name. Out: an [`Instance`], parsed by the same parser as any other file, so that a scene is also an
//! example of the format. Goals keep gaps of at least 3 mm, starts of 4 mm (a robot places within a
//! millimetre or so and the planner's clearance is 2 mm), and in every scene some objects have to wait in a
//! buffer.

use crate::document::Diagnostics;
use crate::tabletop::instance::Instance;
use crate::tabletop::parse::parse_instance;

/// One scene.
#[derive(Clone, Copy, Debug)]
pub struct Scene {
    /// As `--scene` names it.
    pub name: &'static str,
    /// One line for `--help`.
    pub about: &'static str,
    /// The instance file.
    pub text: &'static str,
}

/// Every scene; the first is the default.
pub const SCENES: &[Scene] = &[
    Scene {
        name: "tetris-heart",
        about: "thirteen Tetris pieces become a heart",
        text: include_str!("scenes/tetris-heart.yaml"),
    },
    Scene {
        name: "planks",
        about: "ten square planks, two of them large, density 0.35",
        text: include_str!("scenes/planks.yaml"),
    },
    Scene {
        name: "blocks",
        about: "twelve thick blocks of different shapes, density 0.36",
        text: include_str!("scenes/blocks.yaml"),
    },
    Scene {
        name: "desk",
        about: "nine things on a desk, of different shapes and weights",
        text: include_str!("scenes/desk.yaml"),
    },
];

/// Why there is no such scene.
#[derive(Clone, Debug, thiserror::Error)]
pub enum SceneError {
    /// The name is not known.
    #[error("there is no scene `{name}`; there are {known}")]
    Unknown {
        /// As given.
        name: String,
        /// The names there are.
        known: String,
    },
    /// The file that came with the binary does not parse: a fault of this build.
    #[error("the scene's own file is faulty:\n{0}")]
    Faulty(Diagnostics),
}

/// The instance of a named scene.
///
/// # Errors
/// An unknown name.
pub fn scene(name: &str) -> Result<Instance, SceneError> {
    let Some(scene) = SCENES.iter().find(|scene| scene.name == name) else {
        let known = SCENES.iter().map(|scene| scene.name).collect::<Vec<_>>().join(", ");
        return Err(SceneError::Unknown { name: name.to_string(), known });
    };
    parse_instance(scene.text, scene.name, &|_| None).map_err(SceneError::Faulty)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::collision::{closer_than, distance_between};
    use crate::geometry::pose::Pose2;

    fn all() -> Vec<(&'static str, Instance)> {
        SCENES
            .iter()
            .map(|one| (one.name, scene(one.name).unwrap_or_else(|fault| panic!("{fault}"))))
            .collect()
    }

    fn poses(instance: &Instance) -> (Vec<Pose2>, Vec<Pose2>) {
        instance.objects.iter().map(|object| (object.start.unwrap(), object.goal.unwrap())).unzip()
    }

    #[test]
    fn an_unknown_scene_is_refused_with_the_names_there_are() {
        let message = scene("tetris").unwrap_err().to_string();
        assert!(
            message.contains("`tetris`") && message.contains("tetris-heart, planks, blocks, desk"),
            "{message}"
        );
    }

    #[test]
    fn every_arrangement_keeps_its_gaps_and_the_table() {
        for (name, instance) in all() {
            let (starts, goals) = poses(&instance);
            for (which, poses, gap) in [("start", &starts, 0.004), ("goal", &goals, 0.002)] {
                for (i, a) in instance.objects.iter().enumerate() {
                    let (low, high) = a.footprint.bounds(&poses[i]);
                    let (width, height) = (instance.workspace.width, instance.workspace.height);
                    let margin = low[0].min(low[1]).min(width - high[0]).min(height - high[1]);
                    assert!(margin >= 0.004, "{name}: {which} of {} is {margin} m from the edge", a.id);
                    for (j, b) in instance.objects.iter().enumerate().skip(i + 1) {
                        let near = closer_than(&a.footprint, &poses[i], &b.footprint, &poses[j], gap);
                        let between = distance_between(&a.footprint, &poses[i], &b.footprint, &poses[j]);
                        assert!(!near, "{name}: {which}s of {} and {} are {between} m apart", a.id, b.id);
                    }
                }
            }
        }
    }

    #[test]
    fn densities_are_those_of_the_demonstrations() {
        for (name, low, high) in
            [("tetris-heart", 0.2, 0.25), ("planks", 0.34, 0.36), ("blocks", 0.35, 0.37), ("desk", 0.3, 0.4)]
        {
            let density = scene(name).unwrap().density();
            assert!((low..=high).contains(&density), "{name}: {density}");
        }
    }

    #[test]
    fn two_planks_have_nine_times_the_area_of_the_eight_others() {
        let areas: Vec<f64> =
            scene("planks").unwrap().objects.iter().map(|object| object.footprint.area()).collect();
        assert_eq!(areas.len(), 10);
        for (k, area) in areas.iter().enumerate() {
            let wanted = if k < 2 { 9.0 } else { 1.0 };
            assert!((area / areas[9] - wanted).abs() < 1e-9, "{k}: {area}");
        }
    }

    #[test]
    fn things_on_the_desk_cost_what_they_weigh() {
        let desk = scene("desk").unwrap();
        assert!(desk.objects.iter().all(|object| object.mass.is_some() && object.impedance == object.mass));
    }

    /// Smallest number of objects without which the goals can be filled one after the other.
    fn fewest_in_buffers(instance: &Instance) -> u32 {
        let (starts, goals) = poses(instance);
        let objects = &instance.objects;
        let n = objects.len();
        let blockers: Vec<u32> = (0..n)
            .map(|i| {
                let blocks = |j: &usize| {
                    let (a, b) = (&objects[i].footprint, &objects[*j].footprint);
                    *j != i && closer_than(a, &goals[i], b, &starts[*j], instance.clearance)
                };
                (0..n).filter(blocks).fold(0, |set, j| set | 1 << j)
            })
            .collect();
        let acyclic = |mut left: u32| loop {
            let free = (0..n).filter(|i| left >> i & 1 == 1 && blockers[*i] & left == 0);
            let free = free.fold(0u32, |set, i| set | 1 << i);
            match (left, free) {
                (0, _) => break true,
                (_, 0) => break false,
                _ => left &= !free,
            }
        };
        let everything = (1u32 << n) - 1;
        (0..=everything).filter(|out| acyclic(everything & !out)).map(u32::count_ones).min().unwrap()
    }

    #[test]
    fn every_scene_needs_buffers() {
        for (name, instance) in all() {
            assert_eq!(fewest_in_buffers(&instance), 3, "{name}");
        }
    }
}
