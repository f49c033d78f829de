//! celld's program on the robot, run by the simulated controller frame by frame, driven through registers
//! alone: what the daemon relies on, without the daemon.

use cell_values::units::Joints;
use ur_sim::controller::registers::Input;
use ur_sim::controller::{Controller, ControllerConfig, builtins};
use ur_wire::rtde_values::Value;

const PROGRAM: &str = include_str!("../../hardware/ur5e/celld_program.script");
const NONCE: i32 = 4711;
const WATCHDOG_FRAMES: u64 = 100;

const MOVEJ: i32 = 1;
const MOVEL: i32 = 2;
const SET_PAYLOAD: i32 = 3;
const STOP: i32 = 5;
const END: i32 = 6;

/// The daemon's side of the register protocol.
struct Driver {
    controller: Controller,
    heartbeat: i32,
    silent: bool,
    sequence: i32,
}

impl Driver {
    fn start() -> Driver {
        let config = ControllerConfig { running: true, ..ControllerConfig::ur5e(2) };
        let mut controller = Controller::new(config);
        let text = PROGRAM
            .replace("{{NONCE}}", &NONCE.to_string())
            .replace("{{WATCHDOG_FRAMES}}", &WATCHDOG_FRAMES.to_string());
        let code = builtins::compile_program(&text);
        if let Err(error) = &code {
            panic!("{error}");
        }
        assert!(controller.programs.upload(code));
        let mut driver = Driver { controller, heartbeat: 0, silent: false, sequence: 0 };
        driver.until(|d| d.output(24) == NONCE);
        driver
    }

    fn output(&self, register: usize) -> i32 {
        self.controller.core.registers.output_ints[register]
    }

    fn status(&self) -> i32 {
        self.output(27)
    }

    fn frame(&mut self) {
        if self.controller.core.step.is_multiple_of(10) && !self.silent {
            self.heartbeat += 1;
            self.controller.core.registers.write(&[Input::Int(27)], &[Value::Int32(self.heartbeat)]);
        }
        self.controller.frame();
    }

    #[track_caller]
    fn until(&mut self, done: impl Fn(&Driver) -> bool) {
        let start = self.controller.core.step;
        while !done(self) {
            self.frame();
            assert!(
                self.controller.core.step - start < 20_000,
                "did not happen in 40 s, status {}",
                self.status()
            );
        }
    }

    fn command(
        &mut self,
        opcode: i32,
        options: i32,
        numbers: [f64; 6],
        speed: f64,
        acceleration: f64,
        blend: f64,
    ) {
        self.sequence += 1;
        let mut fields = vec![Input::Int(24), Input::Int(25), Input::Int(26)];
        let mut values = vec![Value::Int32(self.sequence), Value::Int32(opcode), Value::Int32(options)];
        for (index, number) in numbers.into_iter().chain([speed, acceleration, blend]).enumerate() {
            fields.push(Input::Double(24 + index));
            values.push(Value::Double(number));
        }
        self.controller.core.registers.write(&fields, &values);
        let sequence = self.sequence;
        self.until(|d| d.output(25) == sequence || d.status() > 1);
    }

    fn movej(&mut self, turn: f64, last: bool) {
        let q = [turn, -1.57, 1.57, -1.57, -1.57, 0.0];
        self.command(MOVEJ, i32::from(last), q, 1.0, 3.0, 0.05);
    }
}

#[test]
fn streamed_segments_blend_without_stopping() {
    let mut driver = Driver::start();
    for k in 1..=3 {
        driver.movej(0.5 * f64::from(k), false);
    }
    driver.until(|d| d.controller.core.mover.q().0[0] > 0.3);
    driver.movej(2.0, true);
    let mut slowest = f64::INFINITY;
    while driver.controller.core.mover.q().0[0] < 1.7 {
        driver.frame();
        slowest = slowest.min(driver.controller.core.mover.qd()[0]);
    }
    assert!(slowest > 0.6, "slowed down to {slowest} rad/s");
    let sequence = driver.sequence;
    driver.until(|d| d.output(26) == sequence && d.status() == 0);
    assert_eq!(driver.controller.core.mover.q(), Joints([2.0, -1.57, 1.57, -1.57, -1.57, 0.0]));
}

/// A way to a waiting place at 0.7 rad by a corner at 0.5: what comes next is there in time or not.
#[test]
fn a_way_goes_on_without_stopping_where_what_it_waits_for_is_there() {
    let way_out = |driver: &mut Driver| {
        driver.movej(0.5, false);
        driver.command(MOVEJ, 3, [0.7, -1.57, 1.57, -1.57, -1.57, 0.0], 1.0, 3.0, 0.0);
        driver.until(|d| d.controller.core.mover.q().0[0] > 0.2);
    };
    let turned = |driver: &Driver| driver.controller.core.mover.q().0[0];
    let mut driver = Driver::start();
    way_out(&mut driver);
    driver.command(MOVEJ, 1, [0.5, -1.3, 1.57, -1.57, -1.57, 0.0], 1.0, 3.0, 0.0);
    let (mut slowest, mut farthest) = (f64::INFINITY, 0.0_f64);
    while driver.output(26) < 3 {
        driver.frame();
        farthest = farthest.max(turned(&driver));
        if driver.controller.core.mover.q().0[1] < -1.4 {
            let speeds = driver.controller.core.mover.qd().map(f64::abs);
            slowest = slowest.min(speeds.into_iter().fold(0.0, f64::max));
        }
    }
    assert!(farthest < 0.5 + 1e-6 && slowest > 0.1, "{farthest} rad, {slowest} rad/s at least");
    let mut driver = Driver::start();
    way_out(&mut driver);
    driver.until(|d| d.output(26) == 2 && d.status() == 0);
    assert!((turned(&driver) - 0.7).abs() < 1e-9, "at the waiting place: {}", turned(&driver));
}

#[test]
fn a_full_queue_waits_and_every_segment_is_carried_out() {
    let mut driver = Driver::start();
    for k in 1..=12 {
        driver.movej(0.1 * f64::from(k), k == 12);
    }
    driver.until(|d| d.output(26) == 12);
    assert!((driver.controller.core.mover.q().0[0] - 1.2).abs() < 1e-9);
}

#[test]
fn a_line_ends_in_the_joints_it_was_given() {
    let mut driver = Driver::start();
    let q = [0.1, -1.5, 1.6, -1.66, -1.57, 0.1];
    driver.command(MOVEL, 1, q, 0.25, 1.2, 0.0);
    driver.until(|d| d.output(26) == 1);
    assert!(driver.controller.core.mover.q().max_difference(&Joints(q)) < 1e-6);
}

#[test]
fn the_payload_is_set_in_sequence() {
    let mut driver = Driver::start();
    driver.command(SET_PAYLOAD, 0, [1.2, 0.0, 0.0, 0.1, 0.0, 0.0], 0.0, 0.0, 0.0);
    driver.until(|d| d.output(26) == 1);
    assert_eq!(driver.controller.core.payload.mass, 1.2);
    assert_eq!(driver.controller.core.payload.centre, [0.0, 0.0, 0.1]);
}

#[test]
fn silence_stops_the_arm_and_ends_the_program() {
    let mut driver = Driver::start();
    driver.movej(3.0, true);
    driver.until(|d| d.controller.core.mover.q().0[0] > 0.5);
    driver.silent = true;
    let began = driver.controller.core.step;
    driver.until(|d| d.status() == 2);
    let frames = driver.controller.core.step - began;
    assert!((WATCHDOG_FRAMES - 10..=WATCHDOG_FRAMES + 2).contains(&frames), "{frames} frames");
    driver.until(|d| !d.controller.programs.playing());
    assert!(driver.controller.core.mover.stands());
    assert!(driver.controller.core.mover.q().0[0] < 2.0);
    driver.silent = false;
    (0..500).for_each(|_| driver.frame());
    assert!(!driver.controller.programs.playing() && driver.controller.core.mover.stands());
}

#[test]
fn stop_brakes_at_once_and_nothing_but_the_end_is_taken_after_it() {
    let mut driver = Driver::start();
    driver.movej(3.0, true);
    driver.until(|d| d.controller.core.mover.q().0[0] > 0.5);
    driver.command(STOP, 0, [0.0; 6], 0.0, 0.0, 0.0);
    let sequence = driver.sequence;
    driver.until(|d| d.output(25) == sequence);
    assert!(driver.controller.core.mover.stands() && driver.status() == 4);
    let rest = driver.controller.core.mover.q();
    driver.movej(1.0, true);
    (0..500).for_each(|_| driver.frame());
    assert_eq!(driver.controller.core.mover.q(), rest);
    driver.command(END, 0, [0.0; 6], 0.0, 0.0, 0.0);
    driver.until(|d| !d.controller.programs.playing());
}

#[test]
fn numbers_that_are_no_targets_are_refused() {
    for bad in [f64::NAN, f64::INFINITY, 7.0] {
        let mut driver = Driver::start();
        driver.command(MOVEJ, 1, [bad, 0.0, 0.0, 0.0, 0.0, 0.0], 1.0, 1.0, 0.0);
        assert_eq!(driver.status(), 3, "{bad}");
        assert!(driver.controller.programs.playing(), "the program reports, it does not break off");
    }
}
