//! The cells that the closed loop runs: a small table with six objects, or what two configurations describe.
//!
//! In: a seed and how the cell sees, or the daemon's configuration and the simulator's. Out: a [`Stage`]. By
//! seed a post stands beside the table, or safety planes bound the cell, or neither.

use crate::config::cell::CellConfig;
use crate::config::sessions::machine_parameters;
use crate::demo::cell::{DemoChoice, cell_config, sim_file};
use crate::demo::task::requirements;
use crate::pair::camera_view::SightKind;
use crate::pair::stage::Stage;
use cell_machine::supervisor::model::ForeignRule;
use cell_motion::bodies::cell::NamedShape;
use cell_motion::bodies::shape::Shape;
use nalgebra::Translation3;
use rearrange::planning::plan::Objective;
use rearrange::planning::solver::SolverKind;
use rearrange::tabletop::fit::fit;
use rearrange::tabletop::parse::parse_instance;
use std::net::{IpAddr, Ipv4Addr};
use std::path::Path;
use ur_sim::command::sim_config;
use ur_sim::config::SimFile;
use ur_sim::motion::safety::SafetyPlane;
use ur_sim::robot_server::RobotPorts;

/// Six objects on a small table: enough for buffers, small enough for thousands of jobs.
const TABLE: &str = "\
workspace: {width: 0.4, height: 0.4}
clearance: 0.002
objects:
  - {id: plank-1, footprint: {rectangle: {length: 0.10, width: 0.05}}, start: [0.08, 0.08, 0.0]}
  - {id: plank-2, footprint: {rectangle: {length: 0.10, width: 0.05}}, start: [0.22, 0.08, 0.3]}
  - {id: block-1, footprint: {rectangle: {length: 0.06, width: 0.06}}, start: [0.32, 0.20, 0.0]}
  - {id: block-2, footprint: {rectangle: {length: 0.06, width: 0.06}}, start: [0.08, 0.24, 0.5]}
  - {id: lid-1, footprint: {disc: {radius: 0.035}}, start: [0.20, 0.22, 0.0]}
  - {id: lid-2, footprint: {disc: {radius: 0.035}}, start: [0.32, 0.32, 0.0]}
";

/// A post beside the table: its middle in the table frame, its edges, m.
const POST_AT_M: [f64; 3] = [-0.06, 0.2, 0.2];
const POST_M: [f64; 3] = [0.03, 0.03, 0.4];

/// Safety planes: so far beyond the table's left edge, and so high over the base, m.
const WALL_M: f64 = 0.25;
const CEILING_M: f64 = 0.95;

/// The closed loop's cell: a small table with six objects, as demo and simulator would configure it.
///
/// # Errors
/// What does not fit together.
pub fn stage(seed: u64, eye: SightKind) -> Result<Stage, String> {
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
    if eye == SightKind::Corners {
        // Corners have no depth.
        config.foreign = ForeignRule::Off;
    }
    let mut file = sim_file(&instance, &config, &choice)?;
    surround(&mut config, &mut file, seed);
    stage_of(&config, &file, seed)
}

/// What stands round the arm. The planes are the controller's too.
fn surround(config: &mut CellConfig, file: &mut SimFile, seed: u64) {
    let table = config.base_from_table;
    match seed % 4 {
        2 => {
            let shape = Shape::cuboid(POST_M, &(table * Translation3::from(POST_AT_M)));
            config.equipment.fixed.push(NamedShape { name: "the post".to_string(), shape });
        }
        3 => {
            let left = table.translation.x - WALL_M;
            for (name, point, normal) in [
                ("the wall", [left, 0.0, 0.0], [1.0, 0.0, 0.0]),
                ("the ceiling", [0.0, 0.0, CEILING_M], [0.0, 0.0, -1.0]),
            ] {
                let shape = Shape::half_space(point, normal);
                config.equipment.fixed.push(NamedShape { name: name.to_string(), shape });
                file.safety.planes.push(SafetyPlane { point, normal });
            }
        }
        _ => {}
    }
}

/// The closed loop's cell as two configurations have it: the daemon's and the simulator's.
///
/// # Errors
/// What does not fit together.
pub fn stage_of(config: &CellConfig, sim: &SimFile, seed: u64) -> Result<Stage, String> {
    let sim = sim_config(sim, IpAddr::V4(Ipv4Addr::LOCALHOST), RobotPorts::ANY);
    let parameters = machine_parameters(config, seed.wrapping_add(1));
    Stage::new(config, sim, parameters, seed)
}
