//! One picture, and the reference markers in it where the arm's place is known.
//!
//! In: the configuration, the calibration with this arm's kinematics, the arm's joints. Out:
//! [`CameraFacts`].

use crate::config::calibrated::read_lens;
use crate::config::cell::CellConfig;
use crate::config::setup::{Measured, cell_model, drift_limits, scene};
use crate::daemon::cameras::{fault_of, open_camera};
use crate::doctor::camera::{CameraFacts, CameraProblem, PictureFacts, References};
use crate::doctor::robot::RobotFacts;
use crate::io::camera::{CameraError, CameraSource, Frame};
use crate::perception::{Perception, Scene};
use cell_values::time::Timestamp;
use cell_vision::detect::DetectSettings;
use rearrange::document::chain::chain;
use std::time::Instant;

/// Looks through the camera of the configuration.
pub fn facts(config: &CellConfig, known: Option<&Measured>, robot: &RobotFacts) -> CameraFacts {
    let depth_wanted = config.devices.camera.measures_depth();
    let begun = Instant::now();
    let (picture, references) = match one_picture(config) {
        Err(error) => {
            let fault = fault_of(&error);
            let problem = CameraProblem { message: fault.message, hint: fault.hint.to_string() };
            (Err(problem), Err("there is no picture".to_string()))
        }
        Ok((frame, serial, live)) => {
            let facts = PictureFacts {
                source: frame.source.clone(),
                serial,
                size: [frame.image.width, frame.image.height],
                seconds: begun.elapsed().as_secs_f64(),
                depth: frame.depth.is_some(),
                live,
            };
            (Ok(facts), references(config, known, robot, &frame))
        }
    };
    CameraFacts { picture, depth_wanted, references }
}

/// A picture, the camera's serial number where it gives one, and whether it shows the table as it is now.
fn one_picture(config: &CellConfig) -> Result<(Frame, Option<String>, bool), CameraError> {
    // Without a lens the camera's own is read; a cell that is not calibrated yet has pictures too.
    let lens = read_lens(&config.calibration.camera).ok().map(|calibration| calibration.model);
    let mut camera = open_camera(&config.devices, lens)?;
    let frame = camera.grab()?;
    let (serial, live) = (camera.serial().ok(), camera.is_live());
    Ok((frame, serial, live))
}

/// The reference markers of the picture, where the joints say the camera was.
fn references(
    config: &CellConfig,
    known: Option<&Measured>,
    robot: &RobotFacts,
    frame: &Frame,
) -> Result<References, String> {
    let known = known.ok_or("the cell is not calibrated with this arm")?;
    let state = robot.rtde.as_ref().ok().and_then(|rtde| rtde.state.as_ref());
    let state = state.ok_or("the joints of the arm are not known")?;
    if !state.stands_still() {
        return Err("the arm moves".to_string());
    }
    let model = cell_model(config, known).map_err(|error| error.to_string())?;
    let scene = scene(config, known).map_err(|error| chain(&error))?;
    let scene = Scene { foreign: None, ..scene };
    let surveyed = scene.reference.len();
    let mut perception = Perception::new(scene, DetectSettings::default()).map_err(|error| chain(&error))?;
    let at = model.camera_at(&state.q);
    let view = perception.grey_view(frame.image.gray(), at, Timestamp::ZERO, None);
    let view = view.map_err(|error| chain(&error))?;
    let seen = perception.observe(&[view], None).map_err(|error| chain(&error))?;
    Ok(References { surveyed, check: seen.reference, limits: drift_limits(config) })
}
