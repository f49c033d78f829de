//! Generated instances: the paper's laws hold, and the independent checker finds both arrangements free.

use super::*;
use crate::geometry::pose::Pose2;
use crate::planning::overlap::{Body, TOUCH_M};
use crate::tabletop::write::to_yaml;
use proptest::prelude::*;

fn recipe(scenario: Scenario, objects: usize, density: f64) -> Recipe {
    Recipe { scenario, objects, density, ratios: RatioLaw::Paper }
}

fn made(recipe: &Recipe, seed: u64, case: u64) -> Generated {
    generate(recipe, seed, case).unwrap_or_else(|fault| panic!("{recipe:?}, seed {seed}: {fault}"))
}

/// Decides with the checker's predicate, which shares nothing with the generator's.
#[track_caller]
fn assert_free(instance: &Instance, pose: impl Fn(&ObjectSpec) -> Option<Pose2>) {
    let bodies: Vec<Body> = instance
        .objects
        .iter()
        .map(|object| Body::new(&object.footprint, &pose(object).expect("both arrangements are given")))
        .collect();
    for (i, body) in bodies.iter().enumerate() {
        assert!(!body.reaches_over(TABLE.width, TABLE.height, TOUCH_M), "object {i} over the edge");
        for (j, other) in bodies.iter().enumerate().skip(i + 1) {
            assert!(!body.overlaps_deeper(other, TOUCH_M), "objects {i} and {j} overlap");
        }
    }
}

/// Longer over shorter extent, and whether the object's x is the longer one.
fn ratio(footprint: &Footprint) -> (f64, bool) {
    let (Footprint::Rectangle { length, width } | Footprint::Ellipse { length, width }) = footprint else {
        panic!("neither rectangle nor ellipse")
    };
    (length.max(*width) / length.min(*width), length >= width)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn both_arrangements_are_free_and_the_density_is_met(
        squares in any::<bool>(), objects in 3usize..30, level in 1u32..=9, seed in any::<u64>(), case in 0u64..100,
    ) {
        let scenario = if squares { Scenario::Sq } else { Scenario::Rand };
        let density = f64::from(level) * 0.05;
        // Few objects at a high density need not fit; what is generated has to be right.
        if let Ok(generated) = generate(&recipe(scenario, objects, density), seed, case) {
            let instance = generated.instance;
            prop_assert_eq!(instance.objects.len(), objects);
            prop_assert!((instance.density() - density).abs() < 1e-12);
            assert_free(&instance, |object| object.start);
            assert_free(&instance, |object| object.goal);
        } else {
            prop_assert!(density > 0.2 && objects < 12, "{scenario:?} {objects} {density}");
        }
    }

    #[test]
    fn rand_keeps_the_laws_of_area_and_side_ratio(objects in 1usize..60, seed in any::<u64>(), public in any::<bool>()) {
        let ratios = if public { RatioLaw::Public } else { RatioLaw::Paper };
        let instance = made(&Recipe { ratios, ..recipe(Scenario::Rand, objects, 0.1) }, seed, 0).instance;
        let areas = || instance.objects.iter().map(|object| object.footprint.area());
        let (smallest, largest) = (areas().fold(f64::INFINITY, f64::min), areas().fold(0.0, f64::max));
        prop_assert!(largest / smallest <= 20.0 + 1e-9);
        for object in &instance.objects {
            let (ratio, along_x) = ratio(&object.footprint);
            let most = if public { 1.0 / 0.33 } else { 3.0 };
            prop_assert!(ratio >= 1.0 && ratio <= most + 1e-9, "{}", ratio);
            prop_assert!(along_x != public || ratio == 1.0);
            let impedance = object.impedance.expect("given");
            prop_assert!((impedance - object.footprint.area() / smallest).abs() < 1e-9);
        }
    }
}

#[test]
fn side_ratios_are_uniform_by_either_law() {
    let count = |ratios: RatioLaw, below: f64| -> f64 {
        let instance = made(&Recipe { ratios, ..recipe(Scenario::Rand, 1000, 0.05) }, 1, 0).instance;
        let low = instance.objects.iter().filter(|object| ratio(&object.footprint).0 < below).count();
        low as f64 / 1000.0
    };
    // Half of U[1, 3] is below 2; 1/2 < U[0.33, 1] has a chance of 0.746.
    assert!((count(RatioLaw::Paper, 2.0) - 0.5).abs() < 0.06);
    assert!((count(RatioLaw::Public, 2.0) - 0.746).abs() < 0.06);
}

#[test]
fn half_of_rand_are_ellipses_and_areas_are_spread_evenly() {
    let instance = made(&recipe(Scenario::Rand, 1000, 0.05), 2, 0).instance;
    let objects = &instance.objects;
    let round = objects.iter().filter(|object| matches!(object.footprint, Footprint::Ellipse { .. })).count();
    assert!((440..=560).contains(&round), "{round}");
    let largest = objects.iter().map(|object| object.footprint.area()).fold(0.0, f64::max);
    let mean = objects.iter().map(|object| object.footprint.area() / largest).sum::<f64>() / 1000.0;
    assert!((mean - 0.525).abs() < 0.03, "{mean}");
}

#[test]
fn sq_has_two_squares_of_nine_times_the_area() {
    for objects in [3, 20] {
        let instance = made(&recipe(Scenario::Sq, objects, 0.3), 3, 0).instance;
        let areas: Vec<f64> = instance.objects.iter().map(|object| object.footprint.area()).collect();
        assert!(instance.objects.iter().all(|object| ratio(&object.footprint).0 == 1.0));
        for (k, area) in areas.iter().enumerate() {
            let wanted = if k < 2 { 9.0 } else { 1.0 };
            assert!((area / areas[objects - 1] - wanted).abs() < 1e-9, "{k}: {area}");
        }
    }
}

#[test]
fn the_same_seed_gives_the_same_file_and_another_case_another() {
    let recipe = recipe(Scenario::Rand, 12, 0.4);
    let file = |seed, case| to_yaml(&made(&recipe, seed, case).instance);
    assert_eq!(file(5, 2), file(5, 2));
    assert_ne!(file(5, 2), file(5, 3));
    assert_ne!(file(5, 2), file(6, 2));
}

#[test]
fn the_paper_s_cells_come_by_rejection_and_denser_ones_by_push_apart() {
    for scenario in [Scenario::Rand, Scenario::Sq] {
        for (density, method) in
            [(0.3, Method::Rejection), (0.45, Method::PushApart), (0.5, Method::PushApart)]
        {
            let generated = made(&recipe(scenario, 20, density), 11, 0);
            assert_eq!((generated.start, generated.goal), (method, method), "{scenario:?} {density}");
            assert_free(&generated.instance, |object| object.start);
            assert_free(&generated.instance, |object| object.goal);
            let word = if method == Method::Rejection { "rejection sampling" } else { "push-apart" };
            assert!(generated.origin.contains(&format!("start by {word}")), "{}", generated.origin);
        }
    }
}

#[test]
fn push_apart_leaves_no_trace_of_where_objects_were_in_the_other_arrangement() {
    let instance = made(&recipe(Scenario::Sq, 20, 0.45), 4, 1).instance;
    let still = |object: &&ObjectSpec| object.start.unwrap().distance(&object.goal.unwrap()) < 0.01;
    assert!(instance.objects.iter().filter(still).count() <= 2);
}

#[test]
fn what_cannot_be_made_is_refused_and_the_density_named() {
    let fault = |objects, density| generate(&recipe(Scenario::Sq, objects, density), 0, 0).unwrap_err();
    assert!(matches!(fault(2, 0.3), GenerateError::Objects { found: 2, least: 3, .. }));
    assert_eq!(fault(20, 0.0), GenerateError::Density(0.0));
    assert!(matches!(fault(20, f64::NAN), GenerateError::Density(_)));
    // Two squares of 45 % of the table each.
    let message = fault(3, 0.95).to_string();
    assert!(message.contains("density 0.95") && message.contains("3 objects"), "{message}");
}
