//! `celld bench motion`: where the time of a pick-n-place goes; what kinematics, the swept check, reach and
//! ways cost, and how right they are.
//!
//! In: how many jobs, poses, moves and starts. Out: tables, or one JSON object. Exit code 0; 1 when a job
//! was not done, an accepted move meets something in the other model, or a pose is not found again.

use crate::bench::blends::{self, measure_blends};
use crate::bench::cycle::{self, FAST, HEAVY_SCENE, Pace, SceneFigures, USUAL, means, measure_pace};
use crate::bench::motion::Subject;
use crate::bench::motion::{MotionCases, MotionFigures, WAY_STEPS, measure, subject, table};
use crate::config::setup::{arm_model, cycle_parameters};
use crate::demo::cell::{DemoChoice, cell_config};
use crate::demo::task::requirements;
use cell_edge::terminal::{complain, print};
use rearrange::planning::plan::Objective;
use rearrange::planning::solver::SolverKind;
use rearrange::tabletop::fit::fit;
use rearrange::tabletop::parse::parse_instance;
use std::net::{IpAddr, Ipv4Addr};
use std::path::Path;
use ur_arm::kinematics::DhParameters;

/// Arguments of `celld bench motion`.
#[derive(Clone, Debug, clap::Args)]
pub struct BenchMotionArgs {
    /// Poses of each arm model that are made from joints and found again
    #[arg(long, value_name = "N", default_value_t = 100_000)]
    poses: usize,
    /// Random joint moves that are accepted, and as many that are free by 30 mm
    #[arg(long, value_name = "N", default_value_t = 10_000)]
    moves: usize,
    /// Random starts from which a way to a look pose is searched for
    #[arg(long, value_name = "N", default_value_t = 300)]
    starts: usize,
    /// Jobs of each of the demo's scenes, at each of two limits, for the time of a pick-n-place
    #[arg(long, value_name = "N", default_value_t = 10)]
    jobs: u64,
    /// Measure the time of a pick-n-place only
    #[arg(long)]
    cycle: bool,
    /// Seed of all random choices
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// What standard output gets
    #[arg(long, default_value = "table", value_parser = ["table", "json"])]
    format: String,
}

/// Range of the elbow, rad, as in config/cell.yaml.
const ELBOW: f64 = 175.0 / 180.0 * std::f64::consts::PI;

/// A table of the demo, with one object so that there is one.
const TABLE: &str = "\
workspace: {width: 0.6, height: 0.6}
objects:
  - {id: disc, footprint: {disc: {radius: 0.025}}, start: [0.3, 0.3, 0.0]}
";

/// Jobs of each scene in the comparison of blend speeds, at most: it runs five variants.
const BLEND_JOBS: u64 = 2;

/// Runs `celld bench motion`. Returns the exit code.
pub fn run(args: &BenchMotionArgs) -> u8 {
    let paces = [USUAL, FAST].map(|pace| {
        let figures = measure_pace(&pace, args.jobs);
        complain(&format!("measured: {} jobs of each scene, limits {}", args.jobs, pace.name));
        (pace, figures)
    });
    let mut failed = paces.iter().any(|(_, scenes)| scenes.iter().any(|scene| !scene.faults.is_empty()));
    let mut figures = MotionFigures::default();
    if !args.cycle {
        let subject = match demo_subject(args.seed) {
            Ok(subject) => subject,
            Err(message) => {
                complain(&message);
                return 1;
            }
        };
        let BenchMotionArgs { poses, moves, starts, seed, .. } = *args;
        let cases = MotionCases { poses, moves, starts, roadmap_steps: 100 * WAY_STEPS, seed };
        figures = measure(&subject, cases, &|what| complain(&format!("measured: {what}")));
    }
    if args.jobs > 0 {
        cycles(&mut figures, &paces);
        figures.blends =
            measure_blends(args.jobs.min(BLEND_JOBS), &|what| complain(&format!("measured: {what}")));
        failed |= figures.blends.iter().any(|row| !row.faults.is_empty());
    }
    match args.format.as_str() {
        "json" => print(&format!("{}\n", serde_json::json!(figures))),
        _ => {
            let paces = paces.iter().filter(|_| args.jobs > 0);
            paces.for_each(|(pace, scenes)| print(&cycle::table(pace, scenes)));
            if args.jobs > 0 {
                print(&blends::table(&figures.blends));
            }
            if !args.cycle {
                print(&table(&figures));
            }
        }
    }
    u8::from(failed || figures.accepted_but_meeting > 0 || figures.ik_missed > 0)
}

/// The means over the scenes, at both limits.
fn cycles(figures: &mut MotionFigures, [usual, fast]: &[(Pace, Vec<SceneFigures>); 2]) {
    let all = means(&usual.1, false);
    figures.cycle_s = Some(all.cycle_s);
    figures.cycle_vs_naive = Some(all.vs_naive);
    figures.cycle_vs_bound = Some(all.vs_bound);
    figures.idle_fraction = Some(all.idle);
    figures.pictures_per_move = Some(all.stops);
    figures.cycle_fast_s = Some(means(&fast.1, true).cycle_s);
    let heavy = fast.1.iter().find(|scene| scene.scene == HEAVY_SCENE);
    figures.cycle_fast_heavy_s = heavy.map(|scene| scene.cycle_s);
}

/// The demo's cell, made to measure for the table.
fn demo_subject(seed: u64) -> Result<Subject, String> {
    let given = parse_instance(TABLE, "table", &|_| None).map_err(|complaints| complaints.to_string())?;
    let instance = fit(&given, &requirements()).map_err(|error| error.to_string())?.instance;
    let choice = DemoChoice {
        bind: IpAddr::V4(Ipv4Addr::LOCALHOST),
        time_factor: 1.0,
        seed,
        solver: SolverKind::Auto,
        objective: Objective::Pp,
        time_limit_s: 2.0,
    };
    let mut config = cell_config(&instance, &choice, Path::new("."))?;
    // The elbow of no arm turns further; beyond, it is wound round itself and no way leads out.
    config.limits.joint_range[2] = (-ELBOW, ELBOW);
    let model = arm_model(&config, DhParameters::UR5E, config.base_from_table);
    let size = [config.workspace.width_m, config.workspace.height_m];
    Ok(subject(model, cycle_parameters(&config), size))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::motion::{kinematics, moves, ways};

    const CASES: MotionCases =
        MotionCases { poses: 400, moves: 150, starts: 20, roadmap_steps: 100, seed: 3 };

    #[test]
    fn no_accepted_move_meets_anything_and_few_free_ones_are_refused() {
        let subject = demo_subject(CASES.seed).expect("fits");
        let mut figures = MotionFigures::default();
        moves(&mut figures, &subject, CASES);
        assert_eq!((figures.accepted, figures.accepted_but_meeting), (CASES.moves, 0));
        assert!(figures.free_accepted_fraction > 0.9, "{}", figures.free_accepted_fraction);
    }

    #[test]
    fn every_pose_is_found_again_by_every_arm() {
        let mut figures = MotionFigures::default();
        kinematics(&mut figures, CASES);
        assert!(figures.ik_missed == 0 && figures.ik_worst < 1e-9, "{figures:?}");
    }

    #[test]
    fn ways_are_found_where_there_are_any() {
        let subject = demo_subject(CASES.seed).expect("fits");
        let mut figures = MotionFigures::default();
        ways(&mut figures, &subject, CASES);
        let [found, other_only, _, not_free] = figures.ways;
        assert!(found > 0 && other_only == 0 && found + not_free <= CASES.starts, "{:?}", figures.ways);
    }
}
