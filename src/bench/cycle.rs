//! `bench motion`: where the time of a pick-n-place goes, in the demo's four scenes in virtual time.
//!
//! In: limits of the arm, scenes, seeds. Out: for each scene the mean seconds of a verified pick-n-place
//! by use, beside a naive script and a lower bound, the stops for pictures, the errors at the end by the
//! world's truth. The limits are set here, not read from a file. The script and the bound are those of
//! `bench/script`, each with the vacuum's own times as they were measured in the run.

use crate::bench::script::{Carried, Rest, Script};
use crate::config::cell::{CellConfig, MotionLimits};
use crate::demo::cell::{DemoChoice, cell_config, sim_file};
use crate::demo::task::fitted;
use crate::pair::camera_view::SightKind;
use crate::pair::run::{bring_up, true_poses};
use crate::pair::table::stage_of;
use crate::pair::{Choice, Pair};
use cell_machine::code::Code;
use cell_machine::orders::{Approval, Order};
use cell_machine::supervisor::model::CellModel;
use cell_machine::supervisor::model::ForeignRule;
use cell_machine::supervisor::order::JobOrder;
use cell_machine::supervisor::status::{Doing, WorkStep};
use cell_machine::times::{JobTimes, TimeSplit, Use};
use cell_motion::path::BlendSpeed;
use cell_values::time::Duration;
use rayon::iter::{IntoParallelIterator, ParallelIterator};
use rearrange::geometry::pose::Pose2;
use rearrange::planning::plan::Objective;
use rearrange::planning::solver::SolverKind;
use rearrange::tabletop::instance::Instance;
use rearrange::tabletop::scenes::{SCENES, scene};
use std::f64::consts::TAU;
use std::net::{IpAddr, Ipv4Addr};
use std::path::Path;
use ur_sim::motion::rounding::{BlendConfig, EntrySpeed};

/// Simulated seconds for a job.
const JOB_WITHIN_S: f64 = 900.0;

/// Limits of the arm that are measured.
#[derive(Clone, Copy, Debug)]
pub struct Pace {
    /// For the table.
    pub name: &'static str,
    /// Of every joint, rad/s and rad/s2.
    pub joint: (f64, f64),
    /// Of the tool on straight parts, m/s and m/s2.
    pub tool: (f64, f64),
    /// At which speed the simulated arm passes blends.
    pub entry_speed: EntrySpeed,
    /// What celld knows of its blend speed.
    pub blend_speed: BlendSpeed,
}

/// Those of config/cell.yaml.
pub const USUAL: Pace = Pace {
    name: "as config/cell.yaml",
    joint: (60.0 * TAU / 360.0, 120.0 * TAU / 360.0),
    tool: (0.25, 1.0),
    entry_speed: EntrySpeed::Braked,
    blend_speed: BlendSpeed::Unknown,
};

/// What a UR5e does in production.
pub const FAST: Pace = Pace { name: "fast", joint: (180.0 * TAU / 360.0, 8.0), tool: (1.0, 3.0), ..USUAL };

impl Pace {
    fn limits(&self) -> MotionLimits {
        MotionLimits {
            joint_speed: self.joint.0,
            joint_acceleration: self.joint.1,
            tool_speed: self.tool.0,
            tool_acceleration: self.tool.1,
            joint_range: [(-TAU, TAU); 6],
            link_floor_m: 0.03,
            press_m: 5e-4,
            lift_height_m: 0.03,
            approach_height_m: 0.03,
            blend_m: 0.03,
        }
    }

    /// The limits in words.
    pub fn text(&self) -> String {
        let MotionLimits { lift_height_m, approach_height_m, blend_m, .. } = self.limits();
        format!(
            "{:.0} degrees/s, {:.0} degrees/s2, {:.2} m/s, {:.1} m/s2; lift {lift_height_m} m, approach \
             {approach_height_m} m, blend {blend_m} m",
            self.joint.0.to_degrees(),
            self.joint.1.to_degrees(),
            self.tool.0,
            self.tool.1
        )
    }
}

/// One job, measured.
#[derive(Clone, Debug, Default)]
pub struct CycleRun {
    /// How it ended, where it was not done.
    pub fault: Option<String>,
    /// Pick-n-places.
    pub moves: usize,
    /// Where the time went.
    pub times: JobTimes,
    /// Seconds of the naive script and of the bound for the same pick-n-places.
    pub naive_s: f64,
    /// See there.
    pub bound_s: f64,
    /// Distances from the goals at the end, by the world's truth, mm.
    pub errors_mm: Vec<f64>,
    /// Angles, degrees.
    pub errors_deg: Vec<f64>,
}

impl CycleRun {
    /// Seconds of all pick-n-places, without the first and the last look at the whole table.
    pub fn seconds(&self) -> f64 {
        let rounds = &self.times.rounds;
        let between = rounds.get(1..rounds.len().saturating_sub(1)).unwrap_or_default();
        let planning = rounds.first().map_or(0.0, |split| split.of(Use::Planning));
        self.times.in_moves().total_s() + between.iter().map(TimeSplit::total_s).sum::<f64>() + planning
    }
}

/// Figures of one scene over its seeds.
#[derive(Clone, Debug, Default)]
pub struct SceneFigures {
    /// Its name.
    pub scene: String,
    /// Pick-n-places in all.
    pub moves: usize,
    /// Jobs that were not done, with the reason.
    pub faults: Vec<String>,
    /// Mean seconds of a pick-n-place.
    pub cycle_s: f64,
    /// By use.
    pub split: TimeSplit,
    /// Mean seconds of the naive script's.
    pub naive_s: f64,
    /// Of the bound's.
    pub bound_s: f64,
    /// Stops for pictures of a pick-n-place, whole looks not counted.
    pub stops: f64,
    /// Mean and largest error, mm.
    pub error_mm: (f64, f64),
    /// Largest error, degrees.
    pub error_deg: f64,
}

/// Of all scenes, one with objects at the limit of their cups apart where `apart` is set: seconds of a
/// pick-n-place, and the means of what it is measured by.
#[derive(Clone, Copy, Debug, Default)]
pub struct Means {
    /// Seconds.
    pub cycle_s: f64,
    /// Over those of the naive script.
    pub vs_naive: f64,
    /// Over those of the bound.
    pub vs_bound: f64,
    /// Share in which the arm rests, and neither for a picture nor for the vacuum.
    pub idle: f64,
    /// Stops for pictures.
    pub stops: f64,
}

/// The scene whose heaviest part is at the limit of its cup.
pub const HEAVY_SCENE: &str = "desk";

/// The means over scenes, the heavy one apart or not.
pub fn means(figures: &[SceneFigures], heavy_apart: bool) -> Means {
    let counted = figures.iter().filter(|scene| !heavy_apart || scene.scene != HEAVY_SCENE);
    let scenes: Vec<&SceneFigures> = counted.collect();
    let mean = |of: &dyn Fn(&SceneFigures) -> f64| {
        scenes.iter().map(|scene| of(scene)).sum::<f64>() / scenes.len().max(1) as f64
    };
    Means {
        cycle_s: mean(&|scene| scene.cycle_s),
        vs_naive: mean(&|scene| scene.cycle_s / scene.naive_s),
        vs_bound: mean(&|scene| scene.cycle_s / scene.bound_s),
        idle: mean(&|scene| scene.split.idle_s() / scene.cycle_s),
        stops: mean(&|scene| scene.stops),
    }
}

/// All scenes at these limits, `seeds` each.
pub fn measure_pace(pace: &Pace, seeds: u64) -> Vec<SceneFigures> {
    SCENES.iter().map(|scene| scene_figures(pace, scene.name, seeds)).collect()
}

/// One scene.
pub fn scene_figures(pace: &Pace, name: &str, seeds: u64) -> SceneFigures {
    let runs: Vec<CycleRun> = (0..seeds)
        .into_par_iter()
        .map(|seed| {
            run(pace, name, seed)
                .unwrap_or_else(|fault| CycleRun { fault: Some(fault), ..CycleRun::default() })
        })
        .collect();
    let moves = runs.iter().map(|run| run.moves).sum::<usize>();
    let each = 1.0 / moves.max(1) as f64;
    let mut split = TimeSplit::default();
    for run in &runs {
        run.times.in_moves().iter().for_each(|(what, seconds)| split.add(what, seconds * each));
    }
    let sum = |of: &dyn Fn(&CycleRun) -> f64| runs.iter().map(of).sum::<f64>() * each;
    let errors = || runs.iter().flat_map(|run| run.errors_mm.iter().copied());
    let mean = errors().sum::<f64>() / errors().count().max(1) as f64;
    SceneFigures {
        scene: name.to_string(),
        moves,
        faults: runs.iter().filter_map(|run| run.fault.clone()).collect(),
        cycle_s: sum(&CycleRun::seconds),
        split,
        naive_s: sum(&|run| run.naive_s),
        bound_s: sum(&|run| run.bound_s),
        stops: sum(&|run| f64::from(run.times.stops)),
        error_mm: (mean, errors().fold(0.0, f64::max)),
        error_deg: runs.iter().flat_map(|run| run.errors_deg.iter().copied()).fold(0.0, f64::max),
    }
}

/// The cell of a scene in virtual time, brought up, and the scene; objects are at its starts.
///
/// # Errors
/// The scene cannot be set up.
pub fn cell_of(pace: &Pace, name: &str, pairing: Choice) -> Result<(Pair, Instance), String> {
    let given = scene(name).map_err(|error| error.to_string())?;
    let instance = fitted(&given, None)?;
    let seed = pairing.seed;
    let choice = DemoChoice {
        bind: IpAddr::V4(Ipv4Addr::LOCALHOST),
        time_factor: 1.0,
        seed,
        solver: SolverKind::Auto,
        objective: Objective::Pp,
        time_limit_s: 2.0,
    };
    let mut config: CellConfig = cell_config(&instance, &choice, Path::new("."))?;
    config.limits = pace.limits();
    // Corners have no depth.
    config.foreign = ForeignRule::Off;
    let mut stage = stage_of(&config, &sim_file(&instance, &config, &choice)?, seed)?;
    stage.controller.blends = BlendConfig { entry_speed: pace.entry_speed, seed };
    stage.model.arm.blend_speed = pace.blend_speed;
    let mut pair =
        Pair::new(stage, Choice { eye: SightKind::Corners, ..pairing }).map_err(|error| error.to_string())?;
    if !bring_up(&mut pair) {
        return Err("the cell did not come up".to_string());
    }
    Ok((pair, instance))
}

/// One job of a scene.
///
/// # Errors
/// The scene cannot be set up.
pub fn run(pace: &Pace, name: &str, seed: u64) -> Result<CycleRun, String> {
    let (mut pair, instance) = cell_of(pace, name, Choice::of(seed))?;
    let model = pair.machine().supervisor().ok_or("no cell")?.model().clone();
    pair.order(Order::Arm);
    pair.submit(order_of(&instance, seed));
    let mut rests: Vec<Rest> = Vec::new();
    let over = pair.run_until(JOB_WITHIN_S, |pair| {
        if let Some(rest) = rest_of(pair)
            && rests.last() != Some(&rest)
        {
            rests.push(rest);
        }
        !pair.reports().is_empty()
    });
    let report = pair.reports().first().filter(|_| over);
    let Some(report) = report else { return Err(format!("{name}, seed {seed}: the job does not end")) };
    let mut fault = (report.code != Code::Done).then(|| format!("{name}, seed {seed}: {}", report.message));
    if let Some(breach) = pair.breaches().first() {
        fault = Some(format!("{name}, seed {seed}: {breach:?}"));
    }
    let (errors_mm, errors_deg) = errors(&pair, &model, &instance);
    let script = Script { model: &model, cycle: &model.cycle };
    let vacuum_s = report.times.in_moves().of(Use::Vacuum);
    Ok(CycleRun {
        fault,
        moves: report.moves,
        times: report.times.clone(),
        naive_s: script.naive_s(&rests) + vacuum_s,
        bound_s: script.bound_s(&rests) + vacuum_s,
        errors_mm,
        errors_deg,
    })
}

/// The job that brings every object of a scene to its goal.
pub fn order_of(instance: &Instance, seed: u64) -> JobOrder {
    let goals = instance.objects.iter().filter(|object| !object.fixed);
    JobOrder {
        id: "cycle".to_string(),
        goals: goals.filter_map(|object| Some((object.id.clone(), object.goal?))).collect(),
        objective: Objective::Pp,
        solver: SolverKind::Auto,
        time_limit: Duration::from_secs(2),
        seed,
        approval: Approval::Never,
        rule: None,
        agreed: Vec::new(),
    }
}

/// Where the arm rests now, and what for.
fn rest_of(pair: &Pair) -> Option<Rest> {
    let controller = pair.simulator().core().robot.controller();
    let mover = &controller.core.mover;
    if mover.still_frames() < 2 {
        return None;
    }
    match &pair.status()?.doing {
        Doing::Looking(..) => Some(Rest::Look(mover.q())),
        Doing::Working(WorkStep::Gripping, _) => {
            let supervisor = pair.machine().supervisor()?;
            let carry = supervisor.pick_n_place()?.carry;
            Some(Rest::Pick(mover.q(), Carried::by(carry, &supervisor.model().cycle)))
        }
        Doing::Working(WorkStep::Releasing, _) => Some(Rest::Place(mover.q())),
        _ => None,
    }
}

fn errors(pair: &Pair, model: &CellModel, instance: &Instance) -> (Vec<f64>, Vec<f64>) {
    let truth = true_poses(pair, model);
    let goal = |id: &str| -> Option<Pose2> {
        instance.objects.iter().find(|object| object.id == id && !object.fixed)?.goal
    };
    let pairs: Vec<(Pose2, Pose2)> = truth.iter().filter_map(|(id, pose)| Some((*pose, goal(id)?))).collect();
    let mm = pairs.iter().map(|(pose, goal)| 1e3 * pose.distance(goal)).collect();
    let deg = pairs.iter().map(|(pose, goal)| pose.angle_difference(goal).to_degrees()).collect();
    (mm, deg)
}

/// The figures for people.
pub fn table(pace: &Pace, figures: &[SceneFigures]) -> String {
    let mut text = format!("limits {}: {}\n", pace.name, pace.text());
    text.push_str(&format!("{:<14}{:>6}{:>8}", "scene", "moves", "cycle"));
    Use::ALL.iter().for_each(|what| text.push_str(&format!("{:>10}", what.as_str())));
    text.push_str(&format!(
        "{:>8}{:>7}{:>8}{:>8}{:>8}{:>7}{:>14}{:>7}\n",
        "naive", "bound", "/naive", "/bound", "idle", "stops", "error mm", "deg"
    ));
    for scene in figures {
        let SceneFigures { cycle_s, naive_s, bound_s, .. } = scene;
        text.push_str(&format!("{:<14}{:>6}{:>8.2}", scene.scene, scene.moves, cycle_s));
        scene.split.iter().for_each(|(_, seconds)| text.push_str(&format!("{seconds:>10.3}")));
        text.push_str(&format!(
            "{naive_s:>8.2}{bound_s:>7.2}{:>8.2}{:>8.2}{:>7.1}%{:>7.2}{:>14}{:>7.2}\n",
            cycle_s / naive_s,
            cycle_s / bound_s,
            100.0 * scene.split.idle_s() / cycle_s,
            scene.stops,
            format!("{:.2}..{:.2}", scene.error_mm.0, scene.error_mm.1),
            scene.error_deg
        ));
        scene.faults.iter().for_each(|fault| text.push_str(&format!("  {fault}\n")));
    }
    for (what, apart) in [("mean of four", false), ("without desk", true)] {
        let Means { cycle_s, vs_naive, vs_bound, idle, stops } = means(figures, apart);
        text.push_str(&format!(
            "{what:<14}{:>6}{cycle_s:>8.2}{:>105}{vs_naive:>8.2}{vs_bound:>8.2}{:>7.1}%{stops:>7.2}\n",
            "",
            "",
            100.0 * idle
        ));
    }
    text
}
