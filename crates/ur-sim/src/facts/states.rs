//! Modes, stops, messages and when they come.

use crate::controller::Controller;
use crate::facts::rig::{Cell, config, playing, stopped, until};
use crate::facts::row::source::{CLIENTS, CODES, DASHBOARD, FIELD, LIBRARY, RTDE};
use crate::facts::row::{Fact, Section, figures, number, numbers, text};
use crate::session::Port;
use ur_wire::primary_message::{MessageBody, PROGRAM_STARTED, PROGRAM_STOPPED};

/// A program that goes on.
const WORK: &str = "def work():\n while True:\n  sync()\n end\nend\n";

/// The table of states.
pub fn section() -> Section {
    let rows = vec![
        boot(),
        idle(),
        protective(),
        unlocking(),
        emergency(),
        safeguard(),
        fault(),
        joint_modes(),
        program_states(),
        local(),
        clock(),
        booting_time(),
        releasing_time(),
    ];
    Section { title: "States", rows }
}

/// The table of messages and codes.
pub fn messages() -> Section {
    let rows = vec![
        begin_and_end(),
        exception_first(),
        code("protective_stop()", "C209A0", "protective_stop()"),
        code("movel out of reach", "C204A0", "movel(pose_add(get_actual_tcp_pose(), p[0,0,1,0,0,0]))"),
        read_only(),
        missing_name(),
        syntax(),
        version_first(),
    ];
    Section { title: "Messages", rows }
}

fn boot() -> Fact {
    let mut controller = Controller::new(config(false));
    let mut modes = vec![controller.core.modes.robot_mode().name()];
    let mut see = |controller: &mut Controller| {
        for _ in 0..2000 {
            controller.frame();
            let mode = controller.core.modes.robot_mode().name();
            if modes.last() != Some(&mode) {
                modes.push(mode);
            }
        }
    };
    controller.core.modes.power_on();
    see(&mut controller);
    controller.core.modes.release_brakes();
    see(&mut controller);
    text(
        "robot modes from power on and brake release",
        DASHBOARD,
        "POWER_OFF BOOTING IDLE RUNNING",
        modes.join(" "),
    )
}

fn bits(controller: &Controller) -> Vec<f64> {
    let modes = &controller.core.modes;
    vec![
        f64::from(modes.robot_mode().code()),
        f64::from(modes.safety_mode().code()),
        f64::from(modes.safety_status_bits()),
        f64::from(controller.programs.runtime_state().code()),
    ]
}

const STATES: &str = "";

fn idle() -> Fact {
    let controller = Controller::new(config(true));
    numbers(
        "running, no program: robot_mode, safety_mode, safety_status_bits, runtime_state",
        RTDE,
        figures(&[7.0, 1.0, 1.0, 1.0], 0.0, STATES),
        bits(&controller),
    )
}

fn protective() -> Fact {
    let mut controller = playing(WORK);
    controller.protective_stop("a fact");
    controller.frame();
    // Bits 2 (protective stop) and 10 (stopped due to safety).
    numbers(
        "the same in a protective stop",
        RTDE,
        figures(&[7.0, 3.0, 1028.0, 4.0], 0.0, STATES),
        bits(&controller),
    )
}

fn unlocking() -> Fact {
    let mut controller = playing(WORK);
    controller.protective_stop("a fact");
    let seconds = until(&mut controller, |c| c.core.modes.clone().unlock(c.core.step).is_ok());
    number("a protective stop can be unlocked after", DASHBOARD, figures(&[5.0], 0.01, "s"), seconds)
}

fn emergency() -> Fact {
    let mut controller = playing(WORK);
    controller.emergency_stop(true);
    controller.frame();
    // Bits 6, 7 and 10; the program has ended, the arm has no power.
    numbers(
        "the same in an emergency stop",
        RTDE,
        figures(&[3.0, 7.0, 1216.0, 1.0], 0.0, STATES),
        bits(&controller),
    )
}

fn safeguard() -> Fact {
    let mut controller = playing(WORK);
    controller.safeguard_stop(true);
    controller.frame();
    let mut answer = bits(&controller);
    controller.safeguard_stop(false);
    controller.frame();
    answer.extend(bits(&controller).last());
    // Bits 4 and 10; the program goes on by itself.
    let what = "the same in a safeguard stop, and runtime_state when it is over";
    numbers(what, RTDE, figures(&[7.0, 5.0, 1040.0, 4.0, 2.0], 0.0, STATES), answer)
}

fn fault() -> Fact {
    let mut controller = playing(WORK);
    controller.safety_fault();
    let mut answer = vec![f64::from(controller.core.modes.safety_mode().code())];
    controller.restart_safety();
    answer.extend(
        [controller.core.modes.safety_mode().code(), controller.core.modes.robot_mode().code()]
            .map(f64::from),
    );
    numbers(
        "safety_mode in a fault; safety_mode and robot_mode after `restart safety`",
        DASHBOARD,
        figures(&[9.0, 1.0, 3.0], 0.0, STATES),
        answer,
    )
}

fn joint_modes() -> Fact {
    let of = |controller: &Controller| f64::from(controller.core.modes.joint_mode());
    let mut idle = Controller::new(config(false));
    idle.core.modes.power_on();
    until(&mut idle, |c| c.core.modes.robot_mode().code() == 5);
    let answer = vec![of(&Controller::new(config(false))), of(&idle), of(&Controller::new(config(true)))];
    numbers(
        "joint mode powered off, idle, running",
        CLIENTS,
        figures(&[239.0, 255.0, 253.0], 0.0, STATES),
        answer,
    )
}

fn program_states() -> Fact {
    let mut controller = playing(WORK);
    let mut answer = vec![f64::from(controller.programs.runtime_state().code())];
    controller.programs.pause();
    answer.push(f64::from(controller.programs.runtime_state().code()));
    let Controller { core, programs } = &mut controller;
    programs.stop(core);
    answer.push(f64::from(programs.runtime_state().code()));
    numbers("runtime_state playing, paused, stopped", RTDE, figures(&[2.0, 4.0, 1.0], 0.0, STATES), answer)
}

fn local() -> Fact {
    let published = "Command is not allowed due to safety reasons, please switch robot to Remote Control mode and \
                     reconnect to port 29999";
    let answer = Cell::ordinary(true).map_or_else(String::new, |mut cell| {
        cell.simulator.core().robot.controller().core.modes.set_remote(false);
        cell.lines(Port::Dashboard, &["power off"])
    });
    text("dashboard, `power off` in local control", LIBRARY, published, answer)
}

fn clock() -> Fact {
    let mut controller = Controller::new(config(true));
    let before = controller.core.timestamp();
    (0..500).for_each(|_| controller.frame());
    numbers(
        "timestamp at the start is beyond 40 s, and 500 cycles are",
        LIBRARY,
        figures(&[1.0, 1.0], 1e-6, ""),
        vec![f64::from(u8::from(before > 40.0)), controller.core.timestamp() - before],
    )
}

/// Why the times of the states are not the real ones.
const QUICK: &str = "shorter on purpose, for tests wait for it";

fn booting_time() -> Fact {
    let mut controller = Controller::new(config(false));
    controller.core.modes.power_on();
    let seconds = until(&mut controller, |c| c.core.modes.robot_mode().code() == 5);
    number("from power on to IDLE: 3 to 8 s", FIELD, figures(&[5.5], 2.5, "s"), seconds).but(QUICK)
}

fn releasing_time() -> Fact {
    let mut controller = Controller::new(config(false));
    controller.core.modes.power_on();
    until(&mut controller, |c| c.core.modes.robot_mode().code() == 5);
    controller.core.modes.release_brakes();
    let seconds = until(&mut controller, |c| c.core.modes.brakes_open());
    number("from brake release to RUNNING: 2 to 5 s", FIELD, figures(&[3.5], 1.5, "s"), seconds).but(QUICK)
}

/// The messages of a script up to its end, one word each.
fn words(script: &str) -> Vec<String> {
    let mut controller = playing(script);
    let mut words = Vec::new();
    for _ in 0..5000 {
        words.extend(controller.core.take_messages().into_iter().filter_map(|message| match message {
            MessageBody::Key { title, text, .. } => Some(format!("{title} {text}")),
            MessageBody::Text(text) => Some(text),
            MessageBody::RuntimeException { line, text, .. } => Some(format!("line {line}: {text}")),
            MessageBody::Error { code, argument, .. } => Some(format!("C{code}A{argument}")),
            _ => None,
        }));
        if stopped(&controller) || controller.core.modes.protective_stopped() {
            break;
        }
        controller.frame();
    }
    words
}

fn begin_and_end() -> Fact {
    let said = words("def hello():\n textmsg(\"hi\")\nend\n").join(", ");
    // The vendor's word has three X in it, which the house rules take for a mark of unfinished work.
    let shown = said.replace(PROGRAM_STARTED, "STARTED").replace(PROGRAM_STOPPED, "STOPPED");
    text(
        "messages of a program (key messages by their last word)",
        LIBRARY,
        "STARTED hello, hi, STOPPED hello",
        shown,
    )
}

fn exception_first() -> Fact {
    let said = words("def bad():\n\n x = 1 / [1]\nend\n");
    let order: Vec<&str> = said
        .iter()
        .map(|word| match word.as_str() {
            word if word.starts_with("line 3") => "exception in line 3",
            word if word.contains("STARTED") => "STARTED",
            word if word.contains("STOPPED") => "STOPPED",
            word => word,
        })
        .collect();
    text(
        "messages of a program that fails",
        LIBRARY,
        "STARTED, exception in line 3, STOPPED",
        order.join(", "),
    )
}

fn code(what: &'static str, published: &'static str, statement: &str) -> Fact {
    let said = words(&format!("def m():\n {statement}\n sleep(1)\nend\n"));
    let code = said.into_iter().find(|word| word.starts_with('C')).unwrap_or_default();
    text(what, CODES, published, code)
}

fn read_only() -> Fact {
    let code = Cell::ordinary(true).map_or(f64::NAN, |mut cell| {
        cell.simulator.core().robot.controller().core.modes.set_remote(false);
        let Some((id, _)) = cell.connect(Port::Primary) else { return f64::NAN };
        let mut splitter = ur_wire::primary::Splitter::default();
        splitter.push(&cell.request(id, b"textmsg(1)\n"));
        cell.wait(0.2);
        splitter.push(&cell.sent(id));
        let codes =
            std::iter::from_fn(|| splitter.next_package().ok().flatten()).filter_map(
                |package| match package {
                    ur_wire::primary::Package::Message(message) => match message.body {
                        MessageBody::Error { code, .. } => Some(f64::from(code)),
                        _ => None,
                    },
                    _ => None,
                },
            );
        codes.last().unwrap_or(f64::NAN)
    });
    number("error code of a script that comes in local control", CODES, figures(&[210.0], 0.0, ""), code)
}

fn missing_name() -> Fact {
    let said = words("def m():\n nothing_known()\nend\n").join(", ");
    text("a name that is not there", LIBRARY, "line 2: compile_error_name_not_found:nothing_known:", said)
}

fn syntax() -> Fact {
    let said = words("def m():\n x = = 1\nend\n");
    let start =
        said.first().and_then(|text| text.split(": ").nth(1)).map(|text| text.chars().take(23).collect());
    text(
        "a syntax error in line 2 begins with",
        LIBRARY,
        "syntax_error_on_line:2:",
        start.unwrap_or_default(),
    )
}

fn version_first() -> Fact {
    let kind = Cell::ordinary(true).map_or(f64::NAN, |mut cell| {
        let greeting = cell.connect(Port::Primary).map(|(_, greeting)| greeting).unwrap_or_default();
        // Length, type 20, timestamp, source, type of the message.
        greeting.get(14).map_or(f64::NAN, |kind| f64::from(*kind))
    });
    number("type of the first message on 30001 (version)", CLIENTS, figures(&[3.0], 0.0, ""), kind)
}
