//! What the trials of an arm have in common: ready to move over the table, one way or several.
//!
//! In: the cell's configuration, a live robot; gripper, camera and calibration files need not be there. Out:
//! the arm, the model of its cell, a way over the table that was announced; the arm moves if a person has
//! said so.

use crate::cli::daemon::open_shell;
use crate::config::calibrated::{measured, read_calibration};
use crate::config::cell::CellConfig;
use crate::config::load::load_cell;
use crate::config::setup::{Measured, cell_model, nominal_model};
use crate::daemon::shell::{Observer, Shell};
use cell_calibration::blends::{SentPath, fastest_m_s};
use cell_edge::clock::unix_now_s;
use cell_edge::terminal::complain;
use cell_machine::event::Arm;
use cell_machine::supervisor::model::CellModel;
use cell_machine::supervisor::round::RoundOrder;
use cell_motion::bodies::Room;
use cell_motion::crossing::Crossing;
use cell_values::units::Joints;
use cell_vision::camera::CameraModel;
use rearrange::document::chain::chain;
use std::path::PathBuf;

/// Of `celld calibrate blends` and `stops`.
#[derive(clap::Args, Clone, Debug)]
pub struct TrialArgs {
    /// The cell's configuration.
    #[arg(long, default_value = "config/cell.yaml", value_name = "FILE")]
    pub(super) config: PathBuf,
    /// The arm's reach is free of people and things, nothing hangs on the gripper: let it move.
    #[arg(long)]
    pub(super) yes: bool,
}

impl TrialArgs {
    /// The configuration; `None` where what is wrong with it was reported.
    pub(super) fn configuration(&self) -> Option<CellConfig> {
        load_cell(&self.config).map_err(|error| complain(&error.to_string())).ok()
    }
}

/// An arm that is about to move over the table.
pub(super) struct Trial {
    shell: Shell,
    pub(super) arm: Arm,
    pub(super) model: CellModel,
    room: Room,
    pub(super) crossing: Crossing,
}

impl Trial {
    /// Announces the way; `then` says what comes after it.
    ///
    /// # Errors
    /// The robot does not answer, there is no way for it, or nobody has said `yes`.
    pub(super) async fn ready(
        config: &CellConfig,
        yes: bool,
        then: &str,
        stopped: &dyn Fn() -> bool,
    ) -> Result<Trial, String> {
        let mut shell = open_shell(config, (unix_now_s() * 1e3) as u64)?;
        let arm = shell.identify(stopped).await.map_err(|error| chain(&error))?;
        // What was sent meanwhile is old.
        shell.listen().await;
        let from = shell.robot_state().ok_or("no current joint positions from the robot")?.q;
        let model = model(config, &arm)?;
        let room = Room::new(&model.arm.bodies, &model.cycle.tabletop(Vec::new()), None);
        let workspace = [model.workspace.width, model.workspace.height];
        let crossing = Crossing::over_table(&model.arm, &from, workspace, &model.cycle, &room)
            .map_err(|fault| format!("no way over the table: {}", chain(&fault)))?;
        let mut trial = Trial { shell, arm, model, room, crossing };
        trial.announce(then)?;
        if !yes {
            let free = "when the arm's reach is free of people and things and nothing hangs on the gripper";
            return Err(format!("nothing has moved; {free}, add --yes"));
        }
        trial.shell.commission(trial.model.clone(), false);
        Ok(trial)
    }

    /// The path that the arm takes on a crossing.
    pub(super) fn path(&self, crossing: &Crossing) -> Result<SentPath, String> {
        let (model, start) = (&self.model, crossing.start);
        let path = crossing.path(&model.arm, &start, &model.cycle, &self.room, f64::INFINITY);
        let segments = path.map_err(|fault| chain(&fault))?.segments().to_vec();
        Ok(SentPath { start, segments })
    }

    /// Sends the arm on these ways; it rests afterwards, and the program has ended.
    pub(super) async fn go(
        &mut self,
        crossings: Vec<Crossing>,
        observer: &mut dyn Observer,
        stopped: &dyn Fn() -> bool,
    ) -> Result<(), String> {
        let order = RoundOrder::crossings(crossings);
        self.shell.round(order, observer, stopped).await.map_err(|error| chain(&error))
    }
}

/// The cell as it is calibrated, or as it is drawn where it is not yet.
fn model(config: &CellConfig, arm: &Arm) -> Result<CellModel, String> {
    let files = &config.calibration;
    if [&files.camera, &files.hand_eye, &files.table].iter().all(|path| !path.exists()) {
        complain("no calibration files yet: the table position is that of the configuration");
        return Ok(drawn_model(config, arm));
    }
    let measured = read_calibration(config).and_then(|set| measured(config, &set, arm))?;
    cell_model(config, &Measured { blends: true, ..measured }).map_err(|error| error.to_string())
}

/// The model of a cell as it is drawn, for an arm that has no camera yet: nothing is looked at.
fn drawn_model(config: &CellConfig, arm: &Arm) -> CellModel {
    let (width, height, focal) = (1280, 720, 650.0);
    let lens = CameraModel {
        serial: String::new(),
        width,
        height,
        fx: focal,
        fy: focal,
        cx: f64::from(width) / 2.0,
        cy: f64::from(height) / 2.0,
        distortion: [0.0; 5],
    };
    CellModel { sight: None, ..nominal_model(config, arm, &lens) }
}

impl Trial {
    /// What the arm will do; `then` follows the way down.
    fn announce(&self, then: &str) -> Result<(), String> {
        let place = |q: &Joints| {
            let at = self.model.arm.tool_at(q).translation;
            format!("({:.2}, {:.2}, {:.2})", at.x, at.y, at.z)
        };
        let Crossing { start, lifted, over, end, .. } = &self.crossing;
        let fastest_m_s = fastest_m_s(&self.model.arm, &self.path(&self.crossing)?);
        complain(&format!(
            "the tool goes slowly to {} m over the table, then up to {}, across to {}, down to {}, and {then}; it \
             moves at up to {fastest_m_s:.2} m/s; an arm that is off is powered on first",
            place(start),
            place(lifted),
            place(over),
            place(end),
        ));
        Ok(())
    }
}
