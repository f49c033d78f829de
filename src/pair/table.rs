//! The cells that the closed loop runs: a small table with six objects, or what two configurations describe.
//!
//! In: a seed and how the cell sees, or the daemon's configuration and the simulator's. Out: a [`Stage`].

use crate::config::cell::CellConfig;
use crate::config::sessions::machine_parameters;
use crate::demo::cell::{DemoChoice, cell_config, sim_file};
use crate::demo::task::requirements;
use crate::pair::camera_view::SightKind;
use crate::pair::stage::Stage;
use cell_machine::supervisor::model::ForeignRule;
use rearrange::planning::plan::Objective;
use rearrange::planning::solver::SolverKind;
use rearrange::tabletop::fit::fit;
use rearrange::tabletop::parse::parse_instance;
use std::net::{IpAddr, Ipv4Addr};
use std::path::Path;
use ur_sim::command::sim_config;
use ur_sim::config::SimFile;
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
    let file = sim_file(&instance, &config, &choice)?;
    stage_of(&config, &file, seed)
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
