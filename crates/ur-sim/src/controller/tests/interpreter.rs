//! Interpreter mode: statements of a client in the running program.

use super::*;
use crate::controller::interpreter::MAX_STATEMENTS;

/// A program in interpreter mode.
fn interpreting(arguments: &str) -> Controller {
    let mut controller = running();
    let script = format!(
        "def p():\n own = 1\n def twice(x):\n  return 2 * x\n end\n interpreter_mode({arguments})\n \
         textmsg(\"left with \", own)\nend\n"
    );
    upload(&mut controller, &script);
    controller.frame();
    messages(&mut controller);
    controller
}

fn say(controller: &mut Controller, line: &str) -> String {
    controller.programs.interpret(line, &mut controller.core)
}

#[test]
fn statements_are_acknowledged_and_join_the_programs_first_level() {
    let mut controller = interpreting("");
    for (number, line) in
        ["x = twice(own) + 40", "def half(y): return y / 2 end", "own = half(x)", "textmsg(x, own)"]
            .iter()
            .enumerate()
    {
        assert_eq!(say(&mut controller, line), format!("ack: {}: {line}", number + 1));
    }
    assert_eq!(say(&mut controller, "stateunexecuted"), "state: 4: stateunexecuted");
    assert_eq!(say(&mut controller, "statelastexecuted"), "state: 0: statelastexecuted");
    controller.frame();
    assert_eq!(messages(&mut controller), ["text:4221"]);
    assert_eq!(say(&mut controller, "statelastexecuted"), "state: 4: statelastexecuted");
    assert_eq!(say(&mut controller, "statelastinterpreted"), "state: 4: statelastinterpreted");
    assert!(controller.programs.playing(), "it waits for more");
    say(&mut controller, "end_interpreter()");
    step_until(&mut controller, stopped);
    assert_eq!(messages(&mut controller), ["text:left with 21", "STOPPED:p"]);
}

#[test]
fn what_cannot_join_is_discarded_with_a_reason() {
    let mut controller = running();
    assert_eq!(say(&mut controller, "x = 1"), "discard: no program is running: x = 1");
    let mut controller = interpreting("");
    let reply = say(&mut controller, "x = = 1");
    assert!(reply.starts_with("discard: syntax error, ") && reply.ends_with(": x = = 1"), "{reply}");
    let reply = say(&mut controller, "nowhere()");
    assert_eq!(reply, "discard: name not found, nowhere: nowhere()");
    let reply = say(&mut controller, "x = 1 end def q(): y = 2");
    assert!(reply.starts_with("discard: syntax error"), "no way out of the statement: {reply}");
    assert_eq!(say(&mut controller, "statelastinterpreted"), "state: 0: statelastinterpreted");
    assert_eq!(say(&mut controller, "sync()"), "ack: 1: sync()");
}

#[test]
fn a_move_takes_its_time_and_abort_ends_it() {
    let mut controller = interpreting("");
    say(&mut controller, "movej([1,-1.57,1.57,-1.57,-1.57,0], a=1, v=1)");
    say(&mut controller, "textmsg(\"there\")");
    say(&mut controller, "textmsg(\"never\")");
    (0..300).for_each(|_| controller.frame());
    assert_eq!(say(&mut controller, "stateunexecuted"), "state: 2: stateunexecuted");
    assert!(!controller.core.mover.stands() && messages(&mut controller).is_empty());
    assert_eq!(say(&mut controller, "abort"), "ack: 3: abort");
    controller.frame();
    assert_eq!(messages(&mut controller), ["text:there", "text:never"]);
    step_until(&mut controller, |c| c.core.mover.stands());
    assert!(controller.core.mover.q().0[0] < 0.9);
    say(&mut controller, "movej([0,-1.57,1.57,-1.57,-1.57,0])");
    say(&mut controller, "textmsg(\"skipped\")");
    controller.frame();
    assert_eq!(say(&mut controller, "skipbuffer"), "ack: 5: skipbuffer");
    step_until(&mut controller, |c| c.core.mover.q().0[0] == 0.0);
    (0..10).for_each(|_| controller.frame());
    assert_eq!(messages(&mut controller), [""; 0]);
    assert_eq!(say(&mut controller, "statelastexecuted"), "state: 4: statelastexecuted");
}

#[test]
fn clearing_forgets_what_statements_declared_and_keeps_what_they_changed() {
    let mut controller = interpreting("");
    for line in ["own = 7", "mine = 5", "def f(): return 3 end", "clear_interpreter()"] {
        assert!(say(&mut controller, line).starts_with("ack"), "{line}");
    }
    let reply = say(&mut controller, "textmsg(f())");
    assert!(reply.starts_with("discard: name not found, f"), "{reply}");
    // Another type than before: the variable of that name is a new one.
    assert!(say(&mut controller, "mine = \"six\"").starts_with("ack: 5"));
    say(&mut controller, "textmsg(own, mine)");
    (0..3).for_each(|_| controller.frame());
    assert_eq!(messages(&mut controller), ["text:7six"]);
    assert_eq!(say(&mut controller, "statelastcleared"), "state: 4: statelastcleared");
}

#[test]
fn clearing_ends_the_threads_that_statements_have_started_and_no_others() {
    let script = "def p():\n thread own():\n  while True:\n   write_output_integer_register(1, \
                  read_output_integer_register(1) + 1)\n   sync()\n  end\n end\n run own()\n \
                  interpreter_mode()\nend\n";
    let mut controller = running();
    upload(&mut controller, script);
    (0..5).for_each(|_| controller.frame());
    let count = "write_output_integer_register(2, read_output_integer_register(2) + 1)";
    for line in [
        format!("thread child(): while True: {count} sync() end end"),
        "thread parent(): run child() while True: speedj([0.2,0,0,0,0,0], 1, 10) end end".to_owned(),
        "run parent()".to_owned(),
    ] {
        assert!(say(&mut controller, &line).starts_with("ack"), "{line}");
    }
    (0..500).for_each(|_| controller.frame());
    assert!(controller.core.mover.qd()[0] > 0.1);
    say(&mut controller, "clear_interpreter()");
    (0..200).for_each(|_| controller.frame());
    let before = [1, 2].map(|register| controller.core.registers.output_ints[register]);
    (0..50).for_each(|_| controller.frame());
    let after = [1, 2].map(|register| controller.core.registers.output_ints[register]);
    assert_eq!([after[0] - before[0], after[1] - before[1]], [50, 0]);
    assert!(before[1] > 100 && controller.core.mover.stands());
    assert!(say(&mut controller, "run parent()").starts_with("discard"), "it is forgotten");
}

#[test]
fn statements_before_the_mode_wait_for_it_or_go_as_its_argument_says() {
    for (argument, expected) in [("clearQueueOnEnter=False", &["text:early"][..]), ("", &[])] {
        let mut controller = running();
        let script = format!("def p():\n sleep(0.1)\n interpreter_mode({argument})\nend\n");
        upload(&mut controller, &script);
        controller.frame();
        messages(&mut controller);
        assert_eq!(say(&mut controller, "textmsg(\"early\")"), "ack: 1: textmsg(\"early\")");
        (0..20).for_each(|_| controller.frame());
        assert_eq!(messages(&mut controller), [""; 0], "not before");
        (0..100).for_each(|_| controller.frame());
        assert_eq!(messages(&mut controller), expected);
    }
}

#[test]
fn the_mode_is_for_the_main_thread_and_ends_with_its_program() {
    check(
        "def p():\n thread t():\n  interpreter_mode()\n end\n run t()\n sleep(1)\nend\n",
        &[
            "STARTED:p",
            "exception 3:3 interpreter_mode: only the main thread may enter interpreter mode",
            "STOPPED:p",
        ],
    );
    let mut controller = interpreting("");
    say(&mut controller, "x = [0][1]");
    controller.frame();
    assert!(messages(&mut controller)[0].contains("out of range") && stopped(&controller));
    assert!(say(&mut controller, "sync()").starts_with("discard: no program"));
}

#[test]
fn statements_without_end_are_bounded_and_many_short_ones_are_no_endless_loop() {
    let mut controller = interpreting("");
    for _ in 0..MAX_STATEMENTS {
        assert!(say(&mut controller, "own = own + 1").starts_with("ack"));
    }
    assert!(say(&mut controller, "own = own + 1").starts_with("discard: too many statements"));
    assert!(say(&mut controller, "clear_interpreter()").starts_with("ack"), "that makes room");
    assert!(say(&mut controller, "own = own + 1").starts_with("discard: too many"), "once it is carried out");
    assert!(say(&mut controller, "clear_interpreter()").starts_with("discard: too many"), "one is enough");
    (0..10).for_each(|_| controller.frame());
    assert_eq!(say(&mut controller, "stateunexecuted"), "state: 0: stateunexecuted");
    let mut controller = interpreting("");
    for round in 0..3 {
        for _ in 0..MAX_STATEMENTS - 1 {
            assert!(say(&mut controller, "own = own + 1").starts_with("ack"), "round {round}");
        }
        assert!(say(&mut controller, "clear_interpreter()").starts_with("ack"));
        (0..10).for_each(|_| controller.frame());
    }
    say(&mut controller, "end_interpreter()");
    step_until(&mut controller, stopped);
    let left = format!("text:left with {}", 1 + 3 * (MAX_STATEMENTS - 1));
    assert_eq!(messages(&mut controller), [left, "STOPPED:p".to_owned()]);
}
