//! The lower bound on the public instances against the bounds measured with other code.
//!
//! `trlb-baseline.csv` holds exact bounds (a MILP with lazy cycle cuts) for the peers' shapes: ellipses
//! there are inscribed polygons, and what touches collides. That moves no bound of these instances; a
//! failure names the arcs.

use celld::bench::planning::{Limits, run_case};
use celld::bench::table::Key;
use celld::cli::bench_cases::public_task;
use rearrange::planning::bound::start_goal_graph;
use rearrange::planning::effort::Watch;
use rearrange::planning::plan::{Objective, Status};
use rearrange::planning::problem::Problem;
use rearrange::planning::scene::Scene;
use rearrange::planning::solver::{SolverKind, lower_bound};
use std::path::PathBuf;

/// The folder with the public data, or a loud line and nothing.
fn data() -> Option<PathBuf> {
    let folder = std::env::var_os("CELLD_DATA")
        .map_or_else(|| PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data")), PathBuf::from);
    if folder.join("hetori").is_dir() && folder.join("trlb").is_dir() {
        return Some(folder);
    }
    eprintln!("SKIPPED: no public data in {}; set CELLD_DATA", folder.display());
    None
}

struct Baseline {
    name: String,
    problem: Problem,
    pp: f64,
    ti: f64,
}

/// Every distinct instance of the baseline that is among the data.
fn baseline() -> Option<Vec<Baseline>> {
    let data = data()?;
    let path = data.join("../reference/trlb-baseline.csv");
    let Ok(text) = std::fs::read_to_string(&path) else {
        eprintln!("SKIPPED: no {}", path.display());
        return None;
    };
    let mut rows: Vec<Baseline> = Vec::new();
    for line in text.lines().skip(1) {
        let fields: Vec<&str> = line.split(',').collect();
        let number = |at: usize| fields[at].parse::<f64>().expect("a number");
        let family = match fields[0] {
            "hete" => fields[1].split(':').next().expect("a label"),
            other => other,
        };
        let task = public_task(&data, family, number(2), number(3) as usize, fields[4]);
        let name = format!("{family} {} {} {}", fields[2], fields[3], fields[4]);
        let there = task.instance.is_file() && task.goal.as_ref().is_none_or(|goal| goal.is_file());
        if there && rows.iter().all(|row| row.name != name) {
            let problem = task.read().unwrap_or_else(|complaints| panic!("{name}: {complaints}"));
            rows.push(Baseline { name, problem, pp: number(12), ti: number(13) });
        }
    }
    Some(rows)
}

#[test]
fn bounds_equal_the_measured_ones() {
    let Some(rows) = baseline() else { return };
    assert!(rows.len() > 50, "only {} rows of the baseline are among the data", rows.len());
    for Baseline { name, problem, pp, ti } in &rows {
        let scene = Scene::new(problem);
        let arcs = || start_goal_graph(&scene, &mut Watch::new(&|| false)).arcs().collect::<Vec<_>>();
        let our_pp = lower_bound(&scene, Objective::Pp, 0.0, &mut Watch::new(&|| false)).value;
        let our_ti = lower_bound(&scene, Objective::Ti, 0.0, &mut Watch::new(&|| false)).value;
        assert_eq!(our_pp, *pp, "{name}; arcs {:?}", arcs());
        assert!((our_ti - ti).abs() <= 0.01 * ti, "{name}: {our_ti} not {ti}; arcs {:?}", arcs());
    }
    eprintln!("{} instances, all with the measured bounds", rows.len());
}

#[test]
fn running_buffers_solve_the_easy_public_instances() {
    let Some(data) = data() else { return };
    for (family, density, n, id) in [("rand", 0.3, 20, "1"), ("sq", 0.3, 20, "0"), ("Tetris0", 0.0, 8, "0")] {
        let problem = public_task(&data, family, density, n, id).read().expect("a public instance");
        for solver in [SolverKind::Rbm, SolverKind::Erbm] {
            for objective in [Objective::Pp, Objective::Ti] {
                let limits = Limits {
                    seconds: f64::INFINITY,
                    work: Some(3_000_000),
                    first: true,
                    strict_paper: false,
                    solver_threads: 1,
                };
                let key = Key {
                    scenario: family.into(),
                    density: density.to_string(),
                    objects: problem.objects.len(),
                    id: id.into(),
                    solver,
                    objective,
                    seed: 3,
                };
                let row = run_case(&problem, key, limits, &|| false).expect("solvers that are built");
                let row = row.expect("nothing stops it");
                assert!(matches!(row.status, Status::Optimal | Status::Solved), "{}", row.csv());
                assert!(row.cost.expect("a plan costs something") >= row.lower_bound - 1e-9, "{}", row.csv());
            }
        }
    }
}
