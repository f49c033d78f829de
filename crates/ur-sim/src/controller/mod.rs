//! The simulated UR controller without its sockets: modes, programs, registers and the arm, in 2 ms frames.
//!
//! In: what clients request (methods), and [`Controller::frame`] every 2 ms of simulated time. Out: state
//! for the servers to sample, and messages for the primary interface. Pure: it has no clock and no thread;
//! time is the number of frames. Order in a frame, as on the controller: inputs that have arrived are in
//! effect, the modes advance, programs run, the arm moves, and the state that is then left is what clients
//! see. Source: the interface notes; what is modelled instead of known is said where it is modelled.

pub mod builtins;

pub mod compliance;

pub mod config;

pub mod conveyor_functions;

pub mod core;

pub mod drives;

pub mod encoders;

pub mod external_control;

pub mod force_functions;

pub mod functions;

pub mod interpreter;

pub mod interpreter_mode;

pub mod io_functions;

pub mod modbus_command;

pub mod modbus_map;

pub mod modes;

pub mod motion_functions;

pub mod offset_functions;

pub mod outputs;

pub mod payload_estimate;

pub mod pendant;

pub mod program_files;

pub mod programs;

pub mod realtime;

pub mod registers;

pub mod request_functions;

pub mod robot_state;

pub mod rpc_functions;

pub mod sensing;

pub mod setting_functions;

pub mod settings;

pub mod socket_functions;

pub mod sockets;

pub mod value_requests;

pub mod watchdog;

pub mod xml_rpc;

pub use crate::controller::config::ControllerConfig;

use crate::controller::core::Core;
use crate::controller::program_files::ProgramSource;
use crate::controller::programs::Programs;
use crate::controller::sockets::NoNetwork;
use crate::motion::MotionFault;
use crate::motion::mover::{HARD_RAMP_SECONDS, SOFT_RAMP_SECONDS};
use crate::motion::safety::Clearance;

/// The program that PolyScope X comes with.
const DEFAULT_PROGRAM: &str = "Default program.urpx";
const EMPTY_PROGRAM: &str = "def Default_program():\n  sync()\nend\n";

/// How fast a person who holds the freedrive button draws the tool up: m/s and rad/s in the base frame.
const DRAWN_UP: [f64; 6] = [0.0, 0.0, 0.03, 0.0, 0.0, 0.0];

/// The controller.
#[derive(Debug)]
pub struct Controller {
    /// Everything but the programs.
    pub core: Core,
    /// The programs.
    pub programs: Programs,
}

impl Controller {
    /// A controller just booted.
    pub fn new(config: ControllerConfig) -> Controller {
        let programs = Programs::new(config.seed, config.loads_for_s);
        let mut controller = Controller { core: Core::new(config), programs };
        if controller.core.config.is_polyscope_x() {
            controller.open_default_program();
        }
        controller
    }

    /// PolyScope X always has a program loaded.
    fn open_default_program(&mut self) {
        let empty = ProgramSource::Script(EMPTY_PROGRAM.to_owned());
        self.core.config.programs.add_if_absent(DEFAULT_PROGRAM, empty);
        if let Ok(program) = self.core.open_program(DEFAULT_PROGRAM) {
            self.programs.load(program, &mut self.core);
        }
    }

    /// 2 ms of simulated time.
    pub fn frame(&mut self) {
        self.core.step += 1;
        self.core.payload_frame();
        self.core.modes.advance();
        self.programs.run(&mut self.core);
        if let Some((code, reason)) = self.core.stop_requested.take() {
            self.stop_with((code, 0), &reason);
        }
        self.core.sockets.flush();
        self.core.count_encoders();
        if !self.core.modes.brakes_open() {
            self.core.mover.freeze();
        } else if let Err(fault) = self.move_arm() {
            self.protective_stop(&fault.to_string());
        }
        self.core.come_to_rest();
        self.core.refresh();
        self.hold_to_safety();
        self.hold_to_limits();
        let (q, force) = (self.core.mover.q(), self.core.tcp_force());
        self.core.sensing.remember(q, force);
    }

    fn move_arm(&mut self) -> Result<(), MotionFault> {
        let safe = self.core.modes.motion_allowed();
        self.core.mover.set_ramp(if safe { SOFT_RAMP_SECONDS } else { HARD_RAMP_SECONDS });
        let held = self.programs.paused() || !safe;
        self.core.run_conveyor(held);
        let scaling = if held { 0.0 } else { self.core.registers.speed_fraction() };
        let guided = self.core.pendant.freedrive && safe && self.programs.name().is_none();
        self.core.yield_to_forces(if guided { DRAWN_UP } else { [0.0; 6] });
        self.core.mover.step(scaling)
    }

    /// Stops the arm as its safety system does on a violated limit: on its path, the program paused.
    pub fn protective_stop(&mut self, reason: &str) {
        self.stop_with((modes::PATH_SANITY_CODE, 0), reason);
    }

    /// Stops an arm that gets deeper to where its safety system does not let it be; the way back is free.
    fn hold_to_safety(&mut self) {
        let Core { mover, config, clearance, .. } = &self.core;
        let (q, tcp) = (mover.q(), mover.arm.flange_from_tcp.translation.vector);
        if mover.stands() || clearance.is_some_and(|clearance| clearance.covers(&q, &tcp)) {
            return;
        }
        let at = mover.tcp().translation.vector;
        let found = config.safety.clearance(config.arm.name, &mover.placed().bodies, &at);
        self.core.clearance = found.as_ref().ok().map(|clear_m| Clearance { q, tcp, clear_m: *clear_m });
        let found = found.err();
        let depth = found.as_ref().map_or(0.0, |found| found.depth);
        let deeper = depth > std::mem::replace(&mut self.core.intrusion_m, depth);
        if let Some(found) = found.filter(|_| deeper) {
            let code = match found.joint {
                Some(joint) => (modes::COLLISION_CODE, joint as i32),
                None => (modes::SAFETY_PLANE_CODE, 0),
            };
            self.stop_with(code, &found.reason);
        }
    }

    /// Slows moves down to the momentum and the power that the safety configuration allows; other motion
    /// that passes them is stopped.
    fn hold_to_limits(&mut self) {
        let core = &self.core;
        if core.mover.stands() {
            return;
        }
        let strain = core.config.safety.strain(|| core.momentum(), || core.power());
        if self.core.mover.hold_back(strain) {
            let reason = "momentum or power beyond the safety configuration";
            self.stop_with((modes::SAFETY_LIMIT_CODE, 0), reason);
        }
    }

    fn stop_with(&mut self, (code, argument): (i32, i32), reason: &str) {
        if self.core.modes.protective_stop(self.core.step) {
            self.programs.pause();
            self.core.pendant.safety_popup = true;
            self.core.error_message(code, argument, reason);
            self.core.safety_message();
        }
    }

    /// Ends a protective stop.
    ///
    /// # Errors
    /// The sentence of the dashboard, within 5 s of the stop or without one.
    pub fn unlock_protective_stop(&mut self) -> Result<(), String> {
        self.core.modes.unlock(self.core.step)?;
        self.unlocked();
        Ok(())
    }

    /// Ends a protective stop however old it is: what the primary interface's command does.
    pub fn unlock_at_once(&mut self) {
        self.core.modes.unlock_at_once();
        self.unlocked();
    }

    fn unlocked(&mut self) {
        self.core.pendant.safety_popup = false;
        self.core.safety_message();
    }

    /// Presses or releases the emergency stop: the arm loses power, programs end.
    pub fn emergency_stop(&mut self, pressed: bool) {
        if pressed {
            self.programs.cancel(&mut self.core);
            self.core.mover.freeze();
        }
        self.core.modes.emergency_stop(pressed);
        self.core.safety_message();
    }

    /// Opens or closes the safeguard circuit; programs pause and go on by themselves. True if this changed
    /// anything.
    pub fn safeguard_stop(&mut self, open: bool) -> bool {
        let changes = self.core.modes.safeguard_stop(open);
        if changes {
            if open {
                self.programs.pause_for_safeguard();
            } else {
                self.programs.resume_after_safeguard();
            }
            self.core.safety_message();
        }
        changes
    }

    /// Shows a safety mode by its number and pauses the program unless the mode allows motion; absent: back
    /// to normal, and the program goes on.
    pub fn show_safety(&mut self, number: Option<i32>) {
        self.core.modes.show_safety(number);
        if !self.core.modes.motion_allowed() {
            self.programs.pause_for_safeguard();
        } else {
            self.programs.resume_after_safeguard();
        }
        self.core.safety_message();
    }

    /// A fault of the safety system: the arm loses power, programs end.
    pub fn safety_fault(&mut self) {
        self.power_off();
        self.core.modes.fault();
        self.core.safety_message();
    }

    /// Boots anew, powered off, the arm where it is; with another serial number or another arm's calibration
    /// if given.
    pub fn reboot(&mut self, serial: Option<String>, kinematics: Option<u64>) {
        let mut config = self.core.config.clone();
        config.start = self.core.mover.q();
        config.running = false;
        config.serial_number = serial.unwrap_or(config.serial_number);
        if let Some(seed) = kinematics {
            config.recalibrate(seed);
        }
        self.core.sockets.close_all();
        let sockets = std::mem::replace(&mut self.core.sockets, Box::new(NoNetwork));
        *self = Controller::new(config);
        self.core.sockets = sockets;
    }

    /// Arm power off; a running program ends.
    pub fn power_off(&mut self) {
        self.programs.cancel(&mut self.core);
        self.core.mover.freeze();
        self.core.modes.power_off();
    }

    /// Restart of the safety system after a fault; ends powered off.
    pub fn restart_safety(&mut self) {
        self.power_off();
        self.core.modes.restart_safety();
        self.core.safety_message();
    }
}

#[cfg(test)]
mod tests;
