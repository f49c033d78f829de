//! Faults are ordered here: the injector brings them about when they are due and ends them when their time
//! is over.
//!
//! In: plans from a file or a post, and one call of [`FaultInjector::frame`] per frame from the thread that
//! keeps the time. Out: changes to controller, world and links. What camera, vacuum and links suffer follows
//! from the list of faults in force, so that ending one never ends another. Locks are taken one at a time
//! after its own, and never the other way round.

use crate::controller::Controller;
use crate::controller::builtins::compile_program;
use crate::controller::pendant::SAFETY_CHECKSUM;
use crate::controller::registers::ClientId;
use crate::faults::camera::CameraFaults;
use crate::faults::link::{LinkName, LinkState};
use crate::faults::schedule::{Schedule, Situation, Steps};
use crate::faults::{
    CameraFault, Fault, FaultError, Order, Phase, Planned, RobotFault, Toxic, Trigger, VacuumFault,
    WorldFault,
};
use crate::motion::FRAME_SECONDS;
use crate::robot_server::shared::RobotShared;
use crate::world::vacuum::{Channel, ChannelFaults, Leak};
use crate::world::{SharedWorld, World, lock};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// The client that claims inputs as a fault: no connection has this number.
const STRANGER: ClientId = ClientId(u64::MAX);

/// Frames between two steps of a camera that drifts (0.1 s).
const DRIFT_FRAMES: u64 = 50;

/// Faults planned and in force.
#[derive(Debug)]
pub struct FaultInjector {
    robot: Arc<RobotShared>,
    world: WorldHandle,
    /// Simulated seconds per second.
    factor: f64,
    state: Mutex<State>,
}

/// The world behind a handle that prints as its name: it is long.
struct WorldHandle(SharedWorld);

impl std::fmt::Debug for WorldHandle {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("World")
    }
}

#[derive(Debug, Default)]
struct State {
    schedule: Schedule,
    steps: Steps,
    active: Vec<Active>,
    /// Events of the world taken in.
    seen: u64,
    frames: u64,
}

#[derive(Debug)]
struct Active {
    order: Order,
    began_s: f64,
    ends_s: Option<f64>,
    /// The speed slider before.
    slider: f64,
}

impl State {
    fn time_s(&self) -> f64 {
        self.frames as f64 * FRAME_SECONDS
    }

    fn has(&self, wanted: impl Fn(&Fault) -> bool) -> bool {
        self.active.iter().any(|active| wanted(&active.order.fault))
    }
}

impl FaultInjector {
    /// Over a cell whose time runs `factor` times as fast as the wall's.
    pub fn new(robot: Arc<RobotShared>, world: SharedWorld, factor: f64) -> FaultInjector {
        FaultInjector { robot, world: WorldHandle(world), factor, state: Mutex::new(State::default()) }
    }

    /// The controller whose faults these are.
    pub fn robot(&self) -> &RobotShared {
        &self.robot
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes in plans; those without a trigger are carried out before this returns.
    ///
    /// # Errors
    /// When an object or marker does not exist, nothing is done; when a fault is impossible now, those
    /// before it in the list stay.
    pub fn submit(&self, plans: Vec<Planned>) -> Result<(), FaultError> {
        {
            let world = lock(&self.world.0);
            plans.iter().try_for_each(|plan| check(plan, &world))?;
        }
        let mut state = self.state();
        for plan in plans {
            match plan.at {
                Some(_) => state.schedule.add(plan),
                None => self.carry_out(&mut state, plan.order)?,
            }
        }
        Ok(())
    }

    /// One frame of simulated time, after controller and world have made theirs.
    pub fn frame(&self) {
        let mut state = self.state();
        let state = &mut *state;
        state.frames += 1;
        let progress = self.robot.controller().core.mover.progress().unwrap_or(0.0);
        let due = {
            let world = lock(&self.world.0);
            state.steps.advance(&world.glance());
            let seen = std::mem::replace(&mut state.seen, world.recorded());
            let now = Situation { time_s: state.time_s(), step: state.steps.now(), progress };
            state.schedule.due(&now, world.events_after(seen))
        };
        for order in due {
            let name = order.name;
            if let Err(error) = self.carry_out(state, order) {
                tracing::warn!(fault = name, %error, "a planned fault could not be brought about");
            }
        }
        let drifts = |fault: &Fault| matches!(fault, Fault::Camera(CameraFault::Drift { .. }));
        if state.frames.is_multiple_of(DRIFT_FRAMES) && state.has(drifts) {
            self.settle_camera(state);
        }
        let now_s = state.time_s();
        self.end(state, |active| active.ends_s.is_some_and(|ends_s| now_s >= ends_s));
    }

    /// In which pick-n-place the arm is, from 1, and in which part of it, as far as the world can say.
    pub fn phase(&self) -> (u32, Phase) {
        self.state().steps.now()
    }

    /// What is planned and in force, for the control server.
    pub fn snapshot_json(&self) -> serde_json::Value {
        let state = self.state();
        let (step, phase) = state.steps.now();
        let active: Vec<&str> = state.active.iter().map(|active| active.order.name).collect();
        serde_json::json!({
            "active": active,
            "waiting": state.schedule.waiting(),
            "step": step,
            "phase": phase.name(),
            "time_s": state.time_s(),
        })
    }

    fn carry_out(&self, state: &mut State, order: Order) -> Result<(), FaultError> {
        let slider = self.robot.controller().core.registers.speed_fraction();
        match &order.fault {
            Fault::Robot(fault) => begin(&mut self.robot.controller(), fault)?,
            Fault::World(WorldFault::Nudge { object, by }) => lock(&self.world.0).nudge(object, by)?,
            Fault::World(WorldFault::Place { object, pose }) => lock(&self.world.0).put(object, pose)?,
            Fault::Net { link, toxic: Toxic::ResetPeer } => {
                self.reset(|name| link.is_none_or(|one| one == name))
            }
            Fault::Clear { fault } => {
                self.end(state, |active| fault.as_ref().is_none_or(|name| active.order.name == name));
            }
            Fault::World(WorldFault::Foreign(thing)) => lock(&self.world.0).put_foreign(thing),
            Fault::Vacuum(_) | Fault::Camera(_) | Fault::Net { .. } => {}
        }
        lock(&self.world.0).note_fault(order.name);
        if order.fault.lasts() {
            let ends_s = order.seconds.map(|seconds| state.time_s() + seconds);
            // The same fault again only begins its time anew.
            match state.active.iter_mut().find(|active| active.order.fault == order.fault) {
                Some(active) => active.ends_s = ends_s,
                None => {
                    let began_s = state.time_s();
                    state.active.push(Active { order, began_s, ends_s, slider });
                }
            }
            self.settle(state);
        }
        Ok(())
    }

    /// Ends the faults in force that are `over`.
    fn end(&self, state: &mut State, over: impl Fn(&Active) -> bool) {
        let (ended, going): (Vec<Active>, Vec<Active>) =
            state.active.drain(..).partition(|active| over(active));
        state.active = going;
        if ended.is_empty() {
            return;
        }
        // The controller is ready before its servers listen again.
        for active in &ended {
            let fault = &active.order.fault;
            if let Fault::Robot(robot) = fault
                && !state.has(|other| same_kind(other, fault))
            {
                undo(&mut self.robot.controller(), robot, active.slider);
            }
        }
        self.settle(state);
    }

    /// Brings camera, table, vacuum and links into line with the faults in force.
    fn settle(&self, state: &State) {
        let faults = || state.active.iter().map(|active| &active.order.fault);
        self.settle_camera(state);
        self.settle_controller(state);
        {
            let mut world = lock(&self.world.0);
            world.set_sticky(state.has(|fault| *fault == Fault::Vacuum(VacuumFault::Stick)));
            let foreign = faults().filter_map(|fault| match fault {
                Fault::World(WorldFault::Foreign(thing)) => Some(thing),
                _ => None,
            });
            world.keep_foreign(&foreign.collect::<Vec<_>>());
            for channel in Channel::ALL {
                world.set_channel_faults(channel, channel_faults(channel, faults()));
            }
        }
        let reboots = state.has(|fault| matches!(fault, Fault::Robot(RobotFault::Reboot { .. })));
        for name in LinkName::ALL {
            let mut link = LinkState { down: reboots && name.on_controller(), ..LinkState::default() };
            faults().for_each(|fault| self.poison(&mut link, name, fault));
            self.robot.links.get(name).set(link);
        }
        if reboots {
            self.reset(LinkName::on_controller);
        }
    }

    fn settle_camera(&self, state: &State) {
        let now_s = state.time_s();
        let cameras = state.active.iter().filter_map(|active| match &active.order.fault {
            Fault::Camera(camera) => Some((camera, now_s - active.began_s)),
            _ => None,
        });
        lock(&self.world.0).set_camera_faults(CameraFaults::at(cameras));
    }

    /// What the controller claims to be, and how often it sends.
    fn settle_controller(&self, state: &State) {
        let (mut rate, mut version, mut model) = (None, None, None);
        for active in &state.active {
            match &active.order.fault {
                Fault::Robot(RobotFault::Rate(hz)) => rate = Some(*hz),
                Fault::Robot(RobotFault::Version(numbers)) => version = Some(*numbers),
                Fault::Robot(RobotFault::Model(name)) => model = Some(name.clone()),
                _ => {}
            }
        }
        self.robot.publisher().force_rate(rate);
        let mut controller = self.robot.controller();
        controller.core.pendant.pretend_version(version);
        controller.core.pendant.pretend_model(model);
    }

    fn reset(&self, which: impl Fn(LinkName) -> bool) {
        LinkName::ALL
            .into_iter()
            .filter(|name| which(*name))
            .for_each(|name| self.robot.links.get(name).reset());
    }

    /// Adds what `fault` does to the connections of the server `name`.
    fn poison(&self, link: &mut LinkState, name: LinkName, fault: &Fault) {
        let Fault::Net { link: which, toxic } = fault else { return };
        if which.is_some_and(|which| which != name) {
            return;
        }
        match toxic {
            Toxic::ResetPeer => {}
            Toxic::Timeout => link.silent = true,
            Toxic::Latency(seconds) => {
                link.latency = link.latency.max(Duration::from_secs_f64(seconds / self.factor));
            }
            Toxic::Slicer(bytes) => link.slice = Some(link.slice.map_or(*bytes, |least| least.min(*bytes))),
            Toxic::LimitData(bytes) => {
                link.limit = Some(link.limit.map_or(*bytes, |least| least.min(*bytes)))
            }
            Toxic::Exception(code) => link.exception = Some(*code),
            Toxic::Transaction => link.wrong_transaction = true,
        }
    }
}

/// What a plan names has to exist.
fn check(plan: &Planned, world: &World) -> Result<(), FaultError> {
    let object = match &plan.order.fault {
        Fault::World(WorldFault::Nudge { object, .. } | WorldFault::Place { object, .. }) => Some(object),
        _ => None,
    };
    let waited_for = match &plan.at {
        Some(Trigger::Event { object, .. }) => object.as_ref().filter(|name| name.as_str() != "table"),
        _ => None,
    };
    for name in object.into_iter().chain(waited_for) {
        if world.object(name).is_none() {
            return Err(FaultError::NoSuchObject(name.clone()));
        }
    }
    match &plan.order.fault {
        Fault::Camera(CameraFault::Occlude(marker)) if !world.has_marker(*marker) => {
            Err(FaultError::NoSuchMarker(*marker))
        }
        Fault::Camera(CameraFault::Print(print))
            if print.size_m.is_none() && !world.has_marker(print.marker) =>
        {
            Err(FaultError::NoSuchMarker(print.marker))
        }
        _ => Ok(()),
    }
}

fn channel_faults<'a>(channel: Channel, faults: impl Iterator<Item = &'a Fault>) -> ChannelFaults {
    let mut all = ChannelFaults::default();
    let mine = |which: &Option<Channel>| which.is_none_or(|which| which == channel);
    for fault in faults {
        match fault {
            Fault::Vacuum(VacuumFault::Drop(which)) if mine(which) => all.open = true,
            Fault::Vacuum(VacuumFault::Leak { channel: which, vacuum, falls_s }) if mine(which) => {
                all.leak = Some(Leak { vacuum: *vacuum, falls_s: *falls_s });
            }
            _ => {}
        }
    }
    all
}

/// True for two faults that act on the same part of the controller.
fn same_kind(a: &Fault, b: &Fault) -> bool {
    match (a, b) {
        (Fault::Robot(RobotFault::Claim(a)), Fault::Robot(RobotFault::Claim(b))) => a == b,
        (Fault::Robot(a), Fault::Robot(b)) => std::mem::discriminant(a) == std::mem::discriminant(b),
        _ => false,
    }
}

fn begin(controller: &mut Controller, fault: &RobotFault) -> Result<(), FaultError> {
    let possible = |done: bool, error: FaultError| if done { Ok(()) } else { Err(error) };
    match fault {
        RobotFault::ProtectiveStop => {
            controller.protective_stop("protective stop by the fault injector");
            return possible(controller.core.modes.protective_stopped(), FaultError::NotNow);
        }
        RobotFault::EmergencyStop => controller.emergency_stop(true),
        RobotFault::Safeguard => {
            return possible(controller.safeguard_stop(true), FaultError::NotNow);
        }
        RobotFault::SafetyMode(number) => controller.show_safety(Some(*number)),
        RobotFault::SafetyFault => controller.safety_fault(),
        RobotFault::Local => controller.core.modes.set_remote(false),
        RobotFault::PowerOff => controller.power_off(),
        RobotFault::Freedrive => controller.core.pendant.freedrive = true,
        RobotFault::KillProgram => {
            return possible(controller.programs.stop(&mut controller.core), FaultError::NoProgram);
        }
        RobotFault::ForeignScript(seconds) => {
            let script = format!("def foreign_program():\n  sleep({seconds:.3})\nend\n");
            return possible(controller.programs.upload(compile_program(&script)), FaultError::NotNow);
        }
        RobotFault::ScriptError => {
            return possible(controller.programs.fail(&mut controller.core), FaultError::NoProgram);
        }
        RobotFault::NeverStart => controller.programs.set_deaf(true),
        RobotFault::Pause => return possible(controller.programs.pause(), FaultError::NoProgram),
        RobotFault::Slider(fraction) => controller.core.registers.slide_to(*fraction),
        RobotFault::Stall => controller.core.mover.set_stalled(true),
        RobotFault::Claim(input) => controller.core.registers.seize(STRANGER, input),
        RobotFault::Payload(mass_kg) => controller.core.payload_is(*mass_kg),
        RobotFault::SafetyChecksum(checksum) => controller.core.pendant.safety_checksum = *checksum,
        RobotFault::Reboot { .. } => controller.power_off(),
        // These follow from the list of faults in force.
        RobotFault::Rate(_) | RobotFault::Version(_) | RobotFault::Model(_) => {}
    }
    Ok(())
}

fn undo(controller: &mut Controller, fault: &RobotFault, slider: f64) {
    match fault {
        RobotFault::EmergencyStop => controller.emergency_stop(false),
        RobotFault::Safeguard => {
            controller.safeguard_stop(false);
        }
        RobotFault::SafetyMode(_) => controller.show_safety(None),
        RobotFault::Local => controller.core.modes.set_remote(true),
        RobotFault::Freedrive => controller.core.pendant.freedrive = false,
        RobotFault::NeverStart => controller.programs.set_deaf(false),
        RobotFault::Pause => {
            if controller.programs.paused() {
                controller.programs.play(&mut controller.core);
            }
        }
        RobotFault::Slider(_) => controller.core.registers.slide_to(slider),
        RobotFault::Stall => controller.core.mover.set_stalled(false),
        RobotFault::Claim(input) => controller.core.registers.give_back(STRANGER, input),
        RobotFault::SafetyChecksum(_) => controller.core.pendant.safety_checksum = SAFETY_CHECKSUM,
        RobotFault::Reboot { serial, kinematics } => controller.reboot(serial.clone(), *kinematics),
        RobotFault::Rate(_)
        | RobotFault::Version(_)
        | RobotFault::Model(_)
        | RobotFault::ProtectiveStop
        | RobotFault::SafetyFault
        | RobotFault::PowerOff
        | RobotFault::KillProgram
        | RobotFault::ForeignScript(_)
        | RobotFault::ScriptError
        | RobotFault::Payload(_) => {}
    }
}
