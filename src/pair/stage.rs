//! What a closed loop is set up with: the simulated cell as it is, and the cell as a calibration would have
//! found it.
//!
//! In: the configuration of a simulated cell and of the daemon, a seed. Out: [`Stage`]. The daemon's numbers
//! differ from the truth by what a calibration round leaves (docs/calibration.md): a tenth of a millimetre
//! and a hundredth of a degree; the lens is the camera's own word. This is the one place of the loop that
//! reads the truth before the end.

use crate::config::cell::CellConfig;
use crate::config::setup::{Measured, SetupError, cell_model, scene};
use crate::pair::network::Weather;
use crate::perception::Scene;
use cell_calibration::files::hand_eye::Mount;
use cell_machine::machine::MachineParameters;
use cell_machine::supervisor::model::CellModel;
use cell_vision::camera::CameraModel;
use nalgebra::{Isometry3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rearrange::document::chain::chain;
use ur_sim::camera::CameraSetup;
use ur_sim::cell::SimConfig;
use ur_sim::controller::ControllerConfig;
use ur_sim::faults::Planned;
use ur_sim::world::spec::{CameraMount, WorldSpec};

/// What a calibration leaves, at most along and about each axis: m and rad.
const LEFT_BY_CALIBRATION: (f64, f64) = (6e-5, 1e-4);

/// Everything a closed loop begins with.
#[derive(Clone)]
pub struct Stage {
    /// The simulated controller.
    pub controller: ControllerConfig,
    /// The simulated world.
    pub world: WorldSpec,
    /// The simulated camera.
    pub camera: CameraSetup,
    /// The cell as the daemon knows it.
    pub model: CellModel,
    /// What perception knows.
    pub scene: Scene,
    /// The camera measures depth.
    pub depth: bool,
    /// How the network behaves, unless the run chooses another.
    pub weather: Weather,
    /// Faults that are there from the start.
    pub at_start: Vec<Planned>,
    /// Parameters of the machine.
    pub parameters: MachineParameters,
}

impl Stage {
    /// From the configurations of both sides.
    ///
    /// # Errors
    /// What does not fit together.
    pub fn new(
        config: &CellConfig,
        sim: SimConfig,
        parameters: MachineParameters,
        seed: u64,
    ) -> Result<Stage, String> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x7374_6167);
        let base_from_table = sim.world.base_from_table * small(&mut rng);
        let mount = match sim.camera.mount {
            CameraMount::Flange(flange_from_camera) => {
                Mount::Flange { flange_from_camera: flange_from_camera * small(&mut rng) }
            }
            CameraMount::Fixed(table_from_camera) => {
                let base_from_camera = sim.world.base_from_table * table_from_camera * small(&mut rng);
                Mount::Fixed { base_from_camera }
            }
        };
        let reported = &sim.camera.reported;
        let camera = CameraModel {
            serial: reported.serial.clone(),
            width: reported.width,
            height: reported.height,
            fx: reported.fx,
            fy: reported.fy,
            cx: reported.cx,
            cy: reported.cy,
            distortion: reported.distortion,
        };
        let measured = Measured { dh: sim.controller.dh, base_from_table, mount, camera, blends: true };
        let model = cell_model(config, &measured).map_err(|error: SetupError| error.to_string())?;
        let scene = scene(config, &measured).map_err(|error| chain(&error))?;
        let SimConfig { controller, world, camera, .. } = sim;
        let depth = config.devices.camera.measures_depth();
        let (weather, at_start) = (Weather::LAN, Vec::new());
        Ok(Stage { controller, world, camera, model, scene, depth, weather, at_start, parameters })
    }
}

fn small(rng: &mut ChaCha8Rng) -> Isometry3<f64> {
    let (length, angle) = LEFT_BY_CALIBRATION;
    let mut within = |limit: f64| {
        let parts: [f64; 3] = std::array::from_fn(|_| rng.random_range(-limit..=limit));
        Vector3::from(parts)
    };
    Isometry3::new(within(length), within(angle))
}
