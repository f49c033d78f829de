//! The program on the robot (hardware/ur5e/celld_program.script), run by celld's URScript interpreter on a
//! host that has registers and an arm that takes a given number of frames for a move.
//!
//! What is held here is the register protocol of hardware/ur5e/README.md. The robot session is tested
//! against the same protocol in `device`; the two meet over real sockets in the simulator.

#![expect(clippy::unwrap_used, reason = "a test that unwraps is a test that fails loudly")]

use cell_machine::device::program::{Nonce, PROGRAM_TEXT, ProgramTemplate, WATCHDOG_FRAMES};
use cell_machine::device::registers::{CommandRegisters, Opcode};
use std::collections::BTreeMap;
use std::sync::Arc;
use ur_wire::rtde_values::Value as RtdeValue;
use urscript::compile::compile;
use urscript::host::{Builtin, BuiltinParameter, Call, Host, Reply};
use urscript::program::{Program, Progress};
use urscript::value::{ThreadId, Value};

const fn needed(name: &'static str) -> BuiltinParameter {
    BuiltinParameter { name, optional: false }
}

const fn optional(name: &'static str) -> BuiltinParameter {
    BuiltinParameter { name, optional: true }
}

const BUILTINS: &[Builtin] = &[
    Builtin { name: "read_input_integer_register", parameters: &[needed("address")] },
    Builtin { name: "read_input_float_register", parameters: &[needed("address")] },
    Builtin { name: "write_output_integer_register", parameters: &[needed("address"), needed("value")] },
    Builtin {
        name: "movej",
        parameters: &[needed("q"), optional("a"), optional("v"), optional("t"), optional("r")],
    },
    Builtin {
        name: "movel",
        parameters: &[needed("pose"), optional("a"), optional("v"), optional("t"), optional("r")],
    },
    Builtin { name: "stopj", parameters: &[needed("a")] },
    Builtin { name: "set_payload", parameters: &[needed("m"), optional("cog")] },
    Builtin { name: "set_tcp", parameters: &[needed("pose")] },
    Builtin { name: "textmsg", parameters: &[needed("s1"), optional("s2")] },
];

const NONCE: i32 = 4711;
/// Frames a move of this arm takes, and a stop.
const MOVE_FRAMES: u64 = 10;
const STOP_FRAMES: u64 = 5;

#[derive(Default)]
struct Arm {
    ints: BTreeMap<i32, i32>,
    doubles: BTreeMap<i32, f64>,
    out: BTreeMap<i32, i32>,
    frame: u64,
    /// What was begun, with the frame in which it was.
    log: Vec<(u64, String)>,
    abandoned: Vec<&'static str>,
}

impl Arm {
    fn begin(&mut self, call: &Call<'_>, frames: u64, text: String) -> Reply {
        if call.frames == 0 {
            self.log.push((self.frame, text));
        }
        if call.frames + 1 < frames { Reply::Wait } else { Reply::Value(Value::Int(0)) }
    }
}

impl Host for Arm {
    fn call(&mut self, call: Call<'_>) -> Result<Reply, String> {
        let number = |index: usize| call.number_or(index, 0.0);
        Ok(match call.name {
            "read_input_integer_register" => {
                Reply::Value(Value::Int(*self.ints.get(&call.required(0)?.integer()?).unwrap_or(&0)))
            }
            "read_input_float_register" => {
                Reply::Value(Value::Float(*self.doubles.get(&call.required(0)?.integer()?).unwrap_or(&0.0)))
            }
            "write_output_integer_register" => {
                self.out.insert(call.required(0)?.integer()?, call.required(1)?.integer()?);
                Reply::Value(Value::Int(0))
            }
            "movej" | "movel" => {
                let q: [f64; 6] = call.required(0)?.array()?;
                let text =
                    format!("{} {} a={} v={} r={}", call.name, q[0], number(1)?, number(2)?, number(4)?);
                self.begin(&call, MOVE_FRAMES, text)
            }
            "stopj" => {
                let text = format!("stopj {}", number(0)?);
                self.begin(&call, STOP_FRAMES, text)
            }
            "set_payload" => {
                let cog: [f64; 3] = call.required(1)?.array()?;
                self.log.push((self.frame, format!("set_payload {} {cog:?}", number(0)?)));
                Reply::Value(Value::Int(0))
            }
            "set_tcp" => {
                self.log.push((self.frame, format!("set_tcp {:?}", call.required(0)?.pose()?)));
                Reply::Value(Value::Int(0))
            }
            _ => Reply::Value(Value::Int(0)),
        })
    }

    fn abandoned(&mut self, _thread: ThreadId, name: &'static str) {
        self.abandoned.push(name);
    }
}

struct Rig {
    program: Program,
    arm: Arm,
    progress: Progress,
    beating: bool,
}

impl Rig {
    /// Started with this number left over in the sequence register.
    fn with_old_sequence(sequence: i32) -> Rig {
        let text =
            ProgramTemplate::new(PROGRAM_TEXT, WATCHDOG_FRAMES).unwrap().render(Nonce::new(NONCE as u64 - 1));
        let find = |name: &str| BUILTINS.iter().find(|builtin| builtin.name == name);
        let code = compile(&text, &find).unwrap_or_else(|error| panic!("{error}"));
        let mut arm = Arm::default();
        arm.ints.insert(24, sequence);
        arm.ints.insert(25, 1);
        arm.doubles.insert(30, 1.0);
        let program = Program::new(Arc::new(code), 0);
        Rig { program, arm, progress: Progress::Running, beating: true }
    }

    fn new() -> Rig {
        let mut rig = Rig::with_old_sequence(0);
        rig.run(2);
        rig
    }

    fn run(&mut self, frames: u64) {
        for _ in 0..frames {
            if self.progress != Progress::Running {
                return;
            }
            self.arm.frame += 1;
            if self.beating && self.arm.frame.is_multiple_of(10) {
                *self.arm.ints.entry(27).or_default() += 1;
            }
            self.progress = self.program.frame(&mut self.arm);
            assert!(!matches!(self.progress, Progress::Failed(_)), "{:?}", self.progress);
        }
    }

    fn write(&mut self, command: CommandRegisters) {
        let numbers = CommandRegisters::names();
        for (name, value) in numbers.iter().zip(command.values()) {
            let number: i32 = name.rsplit('_').next().unwrap().parse().unwrap();
            match value {
                RtdeValue::Int32(value) => drop(self.arm.ints.insert(number, value)),
                RtdeValue::Double(value) => drop(self.arm.doubles.insert(number, value)),
                other => panic!("{other:?}"),
            }
        }
    }

    fn write_move(&mut self, sequence: i32, target: f64, blend: f64, last: bool) {
        self.write(CommandRegisters { last, ..a_move(sequence, target, blend) });
    }

    /// A way to a waiting place at 0.2, by a corner at 0.1 that is cut, after so many commands: two more.
    fn write_way_out(&mut self, after: i32) {
        self.write_move(after + 1, 0.1, 0.02, false);
        self.run(1);
        self.write(CommandRegisters { last: true, waits: true, ..a_move(after + 2, 0.2, 0.0) });
        self.run(3);
    }

    /// nonce, accepted, finished, status.
    fn out(&self) -> [i32; 4] {
        [24, 25, 26, 27].map(|number| self.arm.out.get(&number).copied().unwrap_or(-1))
    }

    fn log(&self) -> Vec<&str> {
        self.arm.log.iter().map(|(_, text)| text.as_str()).collect()
    }
}

fn a_move(sequence: i32, target: f64, blend: f64) -> CommandRegisters {
    let arguments = [target, 0.0, 0.0, 0.0, 0.0, 0.0];
    let bare = CommandRegisters::bare(sequence, Opcode::MoveJoint);
    CommandRegisters { arguments, speed: 1.0, acceleration: 2.0, blend, ..bare }
}

#[test]
fn an_old_sequence_number_counts_as_done() {
    let mut rig = Rig::with_old_sequence(57);
    rig.run(1);
    assert_eq!(rig.out(), [NONCE, 57, 57, 0]);
    rig.run(50);
    assert_eq!((rig.out(), rig.arm.log.len()), ([NONCE, 57, 57, 0], 0), "the old command is not carried out");
    rig.write_move(58, 0.1, 0.0, true);
    rig.run(2);
    assert_eq!(rig.out(), [NONCE, 58, 57, 1]);
    rig.run(MOVE_FRAMES + 1);
    assert_eq!(rig.out(), [NONCE, 58, 58, 0]);
    assert_eq!(rig.log(), ["movej 0.1 a=2 v=1 r=0"]);
}

#[test]
fn queued_segments_follow_each_other_without_a_frame_between() {
    let mut rig = Rig::new();
    for sequence in 1..=4 {
        rig.write_move(sequence, f64::from(sequence), 0.02, sequence == 4);
        rig.run(1);
        assert_eq!(rig.out()[1], sequence);
    }
    rig.run(5 * MOVE_FRAMES);
    let starts: Vec<u64> = rig.arm.log.iter().map(|(frame, _)| *frame).collect();
    let gaps: Vec<u64> = starts.windows(2).map(|pair| pair[1] - pair[0]).collect();
    assert_eq!(gaps, [MOVE_FRAMES - 1; 3], "the next begins in the frame in which the one before ends");
    assert!(rig.log()[2].ends_with("r=0.02") && rig.log()[3].ends_with("r=0"), "{:?}", rig.log());
    assert_eq!(rig.out(), [NONCE, 4, 4, 0]);
}

#[test]
fn a_blended_segment_waits_for_its_successor() {
    let mut rig = Rig::new();
    rig.write_move(1, 0.1, 0.02, false);
    rig.run(30);
    assert_eq!((rig.out(), rig.arm.log.len()), ([NONCE, 1, 0, 1], 0));
    rig.write_move(2, 0.2, 0.0, true);
    rig.run(3);
    assert_eq!(rig.arm.log.len(), 1);
}

/// Wherever in the ring of the queue it comes.
#[test]
fn a_waiting_place_is_left_out_where_what_comes_next_is_there_in_time() {
    for before in 0..9 {
        let mut rig = Rig::new();
        for sequence in 1..=before {
            rig.write_move(sequence, 0.0, 0.0, true);
            rig.run(2 * MOVE_FRAMES);
        }
        rig.arm.log.clear();
        rig.write_way_out(before);
        rig.write_move(before + 3, 0.3, 0.0, true);
        rig.run(3 * MOVE_FRAMES);
        assert_eq!(rig.log(), ["movej 0.1 a=2 v=1 r=0.02", "movej 0.3 a=2 v=1 r=0"], "after {before}");
        let starts: Vec<u64> = rig.arm.log.iter().map(|(frame, _)| *frame).collect();
        assert_eq!(starts[1] - starts[0], MOVE_FRAMES - 1, "no frame passes, so that they blend");
        assert_eq!(rig.out(), [NONCE, before + 3, before + 3, 0]);
    }
}

#[test]
fn a_stop_after_a_waiting_place_was_left_out_ends_the_program() {
    let mut rig = Rig::new();
    rig.write_way_out(0);
    rig.write_move(3, 0.3, 0.0, true);
    rig.run(MOVE_FRAMES);
    rig.write(CommandRegisters::bare(4, Opcode::Stop));
    rig.run(STOP_FRAMES + 3);
    assert_eq!(rig.out()[1..], [4, 2, 4]);
    assert_eq!(rig.progress, Progress::Finished);
}

#[test]
fn at_a_waiting_place_the_arm_waits_for_what_comes_next() {
    let mut rig = Rig::new();
    rig.write_way_out(0);
    rig.run(3 * MOVE_FRAMES);
    assert_eq!(rig.log(), ["movej 0.1 a=2 v=1 r=0.02", "movej 0.2 a=2 v=1 r=0"]);
    assert_eq!(rig.out(), [NONCE, 2, 2, 0]);
    rig.write_move(3, 0.3, 0.0, true);
    rig.run(2 * MOVE_FRAMES);
    assert_eq!(rig.log()[2..], ["movej 0.3 a=2 v=1 r=0"]);
    // One that has set out for the waiting place gets there first.
    let mut rig = Rig::new();
    rig.write_way_out(0);
    rig.run(MOVE_FRAMES);
    rig.write_move(3, 0.3, 0.0, true);
    rig.run(3 * MOVE_FRAMES);
    assert_eq!(rig.log().len(), 3, "{:?}", rig.log());
    assert_eq!(rig.out(), [NONCE, 3, 3, 0]);
}

#[test]
fn eight_commands_wait_besides_the_one_under_way() {
    let mut rig = Rig::new();
    rig.write_move(1, 0.1, 0.0, false);
    rig.run(2);
    for sequence in 2..=10 {
        rig.write_move(sequence, 0.1, 0.0, false);
        if sequence <= 9 {
            rig.run(1);
            // The first move ends in between; what counts is that nothing is lost.
        }
    }
    rig.run(200);
    assert_eq!((rig.out(), rig.arm.log.len()), ([NONCE, 10, 10, 0], 10));
}

#[test]
fn settings_keep_their_place_between_motions() {
    let mut rig = Rig::new();
    rig.write_move(1, 0.1, 0.0, true);
    rig.run(1);
    let payload = [1.5, 0.0, 0.01, 0.06, 0.0, 0.0];
    rig.write(CommandRegisters { arguments: payload, ..CommandRegisters::bare(2, Opcode::SetPayload) });
    rig.run(1);
    let tcp = [0.0, 0.0, 0.2, 0.0, 0.0, 1.5];
    rig.write(CommandRegisters { arguments: tcp, ..CommandRegisters::bare(3, Opcode::SetTcp) });
    rig.run(1);
    rig.write_move(4, 0.2, 0.0, true);
    rig.run(40);
    let expected = [
        "movej 0.1 a=2 v=1 r=0",
        "set_payload 1.5 [0.0, 0.01, 0.06]",
        "set_tcp [0.0, 0.0, 0.2, 0.0, 0.0, 1.5]",
        "movej 0.2 a=2 v=1 r=0",
    ];
    assert_eq!(rig.log(), expected);
    assert_eq!(rig.out(), [NONCE, 4, 4, 0]);
}

#[test]
fn stop_is_taken_over_everything_and_reported_when_the_arm_stands() {
    let mut rig = Rig::new();
    for sequence in 1..=3 {
        rig.write_move(sequence, 0.1, 0.0, false);
        rig.run(1);
    }
    // 4 is overwritten before it was seen: a stop skips numbers.
    rig.write(CommandRegisters::bare(5, Opcode::Stop));
    rig.run(1);
    assert_eq!(rig.out(), [NONCE, 3, 0, 4], "stopping");
    assert_eq!(rig.arm.abandoned, ["movej"]);
    rig.run(STOP_FRAMES);
    assert_eq!(rig.out()[1..], [5, 0, 4], "stopped; what was not finished is not called so");
    rig.write_move(6, 0.1, 0.0, true);
    rig.run(50);
    assert_eq!(rig.log(), ["movej 0.1 a=2 v=1 r=0", "stopj 4"]);
    assert_eq!((rig.progress.clone(), rig.out()), (Progress::Finished, [0, 5, 0, 4]), "and ended");
}

#[test]
fn end_stops_a_moving_arm_first() {
    let mut rig = Rig::new();
    rig.write_move(1, 0.1, 0.0, true);
    rig.run(3);
    rig.write(CommandRegisters::bare(2, Opcode::End));
    rig.run(STOP_FRAMES + 3);
    assert_eq!(rig.progress, Progress::Finished);
    assert_eq!(rig.log(), ["movej 0.1 a=2 v=1 r=0", "stopj 4"]);
    let mut rig = Rig::new();
    rig.write(CommandRegisters::bare(1, Opcode::End));
    rig.run(2);
    assert_eq!((rig.progress.clone(), rig.out(), rig.arm.log.len()), (Progress::Finished, [0, 1, 0, 0], 0));
}

#[test]
fn the_watchdog_counts_frames_and_ends_the_program() {
    let mut rig = Rig::new();
    rig.write_move(1, 0.1, 0.0, true);
    rig.run(8);
    rig.beating = false;
    let last_beat = rig.arm.frame;
    rig.write_move(2, 0.1, 0.0, true);
    for sequence in 3..=9 {
        rig.run(4);
        rig.write_move(sequence, 0.1, 0.0, true);
    }
    rig.run(200);
    assert_eq!(rig.progress, Progress::Finished);
    let (frame, text) = rig.arm.log.last().unwrap();
    assert_eq!(text, "stopj 4");
    let silent = *frame - last_beat;
    let frames = u64::from(WATCHDOG_FRAMES);
    assert!((frames - 10..=frames).contains(&silent), "stopped after {silent} frames");
    assert_eq!(rig.out()[3], 2);
}

#[test]
fn commands_that_cannot_be_are_refused_and_stop_the_arm() {
    let good = CommandRegisters {
        sequence: 1,
        opcode: Opcode::MoveLinear,
        last: true,
        waits: false,
        arguments: [0.1; 6],
        speed: 0.2,
        acceleration: 1.0,
        blend: 0.0,
    };
    let mut with_nan = good.arguments;
    with_nan[5] = f64::NAN;
    let bad = [
        CommandRegisters { sequence: 2, ..good },
        CommandRegisters { sequence: -1, ..good },
        CommandRegisters { speed: 0.0, ..good },
        CommandRegisters { speed: f64::NAN, ..good },
        CommandRegisters { speed: 3.3, ..good },
        CommandRegisters { acceleration: -1.0, ..good },
        CommandRegisters { blend: 0.6, ..good },
        CommandRegisters { arguments: with_nan, ..good },
        CommandRegisters { arguments: [7.0; 6], ..good },
        CommandRegisters { arguments: [5.1; 6], opcode: Opcode::SetPayload, ..good },
        CommandRegisters { arguments: [1.0; 6], opcode: Opcode::SetTcp, ..good },
    ];
    for command in bad {
        let mut rig = Rig::new();
        rig.write(command);
        rig.run(STOP_FRAMES + 20);
        assert_eq!((rig.out(), rig.log()), ([NONCE, 0, 0, 3], vec!["stopj 4"]), "{command:?}");
        rig.write(CommandRegisters::bare(9, Opcode::End));
        rig.run(3);
        assert_eq!(rig.progress, Progress::Finished);
    }
    let mut rig = Rig::new();
    rig.write(good);
    rig.run(20);
    assert_eq!((rig.out(), rig.log()), ([NONCE, 1, 1, 0], vec!["movel 0.1 a=1 v=0.2 r=0"]));
}
