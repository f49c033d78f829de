//! Scripts run frame by frame against a host that records what they say.

use super::*;
use crate::compile::compile;
use crate::host::urscript_builtins;
use crate::host::{Builtin, Call, Reply};
use proptest::prelude::*;

const BUILTINS: &[Builtin] = urscript_builtins![say(a; b), wait(frames), read(), movej(q; a, v, t, r)];

fn find(name: &str) -> Option<&'static Builtin> {
    BUILTINS.iter().find(|builtin| builtin.name == name)
}

/// Writes what scripts say, with the frame they say it in.
#[derive(Default)]
pub(crate) struct Recorder {
    frame: u32,
    said: Vec<String>,
    abandoned: Vec<&'static str>,
}

impl Host for Recorder {
    fn call(&mut self, call: Call<'_>) -> Result<Reply, String> {
        match call.name {
            "say" => {
                let second = call.argument(1).map(|b| format!(" {b}")).unwrap_or_default();
                self.said.push(format!("{}{second}", call.required(0)?));
            }
            "read" => return Ok(Reply::Waited(Value::Int(1))),
            "wait" if call.frames < call.required(0)?.integer()? as u64 => return Ok(Reply::Wait),
            "movej" => {
                let texts: Vec<String> = call
                    .arguments
                    .iter()
                    .map(|a| a.as_ref().map_or("-".to_owned(), Value::to_string))
                    .collect();
                self.said.push(texts.join(" "));
            }
            _ => {}
        }
        Ok(Reply::Value(Value::Nothing))
    }

    fn abandoned(&mut self, _: ThreadId, name: &'static str) {
        self.abandoned.push(name);
    }
}

/// Runs `text` for at most `frames` frames; what it said, then how it ended.
pub(crate) fn run(text: &str, frames: u32) -> (Recorder, Progress) {
    let mut host = Recorder::default();
    let code = compile(text, &find).unwrap_or_else(|error| panic!("{error}\n{text}"));
    let mut program = Program::new(Arc::new(code), 7);
    for frame in 0..frames {
        host.frame = frame;
        let progress = program.frame(&mut host);
        if progress != Progress::Running {
            return (host, progress);
        }
    }
    (host, Progress::Running)
}

#[track_caller]
fn check(text: &str, said: &str) {
    let (host, progress) = run(text, 200);
    assert_eq!(host.said.join("|"), said, "{text}");
    assert_eq!(progress, Progress::Finished, "{text}");
}

#[track_caller]
fn check_fails(text: &str, line: u32, column: u32, message: &str) {
    let (_, progress) = run(text, 200);
    let Progress::Failed(exception) = progress else { panic!("{text} gave {progress:?}") };
    assert!(exception.message.contains(message), "{exception}");
    assert_eq!(exception.at, Position { line, column }, "{exception}");
}

#[track_caller]
fn check_refused(text: &str, message: &str) {
    let error = compile(text, &find).expect_err(text);
    assert!(error.controller_text().contains(message), "{}", error.controller_text());
}

#[test]
fn numbers() {
    check("say(1 + 2)", "3");
    check("say(7 / 2)", "3.5");
    check("say(6 / 2)", "3");
    check("say(7 % 4) say(7.5 % 2)", "3|1.5");
    check("say(-7 % 4)", "-3");
    check("say(2147483647 + 1)", "-2147483648");
    check("say(1 == 1.0) say(True == 1) say('a' == 'a') say('a' != 1)", "True|True|True|True");
    check("say(not 0) say(1 and 2) say(0 or 0.5) say(True xor True)", "True|True|True|False");
    check("say(0xff)", "255");
    check("say(norm(-3)) say(norm([3, 4])) say(abs(-2.5))", "3|5|2.5");
    check("say(ceil(1.2)) say(floor(-1.2)) say(pow(2, 3)) say(sqrt(9))", "2|-2|8|3");
    check("say(1 < 2) say(2 >= 2) say('a' < 'b')", "True|True|True");
}

#[test]
fn lists_poses_and_strings() {
    check("x = [1, 2, 3] x[1] = 5 say(x) say(x[1])", "[1, 5, 3]|5");
    check("m = [[1, 2], [3, 4]] m[1, 0] = 9 say(m[1, 0]) say(m)", "9|[[1, 2], [9, 4]]");
    check("say([1, 2] + [3, 4]) say(2 * [1, 2]) say([2, 4] / 2) say([1] - [3])", "[4, 6]|[2, 4]|[1, 2]|[-2]");
    check("say([[1, 2], [3, 4]] * [1, 1])", "[3, 7]");
    check_fails("x = [[]] * []", 1, 10, "sizes of the matrices");
    check_fails("a = make_list(1000, [1]) b = [make_list(1000, 1)] c = a * b", 1, 57, "too large");
    check("a = make_list(100, make_list(100, 1)) b = a * a say(b[99, 99])", "100");
    check_fails("a = make_list(400, make_list(400, 1)) b = a * a", 1, 45, "too large");
    check_fails("a = make_list(200, make_list(200, 1)) b = inv(a)", 1, 43, "too large");
    check("a = [1] b = a b[0] = 2 say(a)", "[1]");
    check("p = p[1, 2, 3, 0, 0, 0] p[0] = 7 say(p[0]) say(p)", "7|p[7, 2, 3, 0, 0, 0]");
    check("p = [5, 6] say(p[1])", "6");
    check("say(pose_trans(p[1,0,0,0,0,0], p[0,2,0,0,0,0]))", "p[1, 2, 0, 0, 0, 0]");
    check("say(pose_inv(p[1,2,3,0,0,0]))", "p[-1, -2, -3, 0, 0, 0]");
    check("say(str_cat(\"a\", [1, True]))", "a[1, True]");
    check(
        "say(str_sub('hello', 1, 3)) say(str_find('hello', 'l')) say(str_len('abc')) say(str_at('abc', 1))",
        "ell|2|3|b",
    );
    check("say(to_num('12') + 1) say(to_str(0.5))", "13|0.5");
    check("s = struct(a = 1, b = [2]) s.b[0] = 4 say(s.a + s.b[0])", "5");
    check("say(get_list_length([1, 2])) say(length([]))", "2|0");
    check("say(binary_list_to_integer(integer_to_binary_list(37)))", "37");
    check("say(make_list(3, 0))", "[0, 0, 0]");
}

#[test]
fn functions_defaults_and_names() {
    check(
        "def f(a, b=2, c=a_default()): return a + b + c end def a_default(): return 10 end say(f(1)) \
         say(f(1, c=0))",
        "13|3",
    );
    check("def p(): say(f(2)) def f(x): return x * 2 end end", "4");
    check("movej([1], v=0.5) movej([1], 1.2, r=0.1)", "[1] - 0.5 - -|[1] 1.2 - - 0.1");
    check("def fac(n): if n <= 1: return 1 end return n * fac(n - 1) end say(fac(10))", "3628800");
    check("def f(): return end f() say(1)", "1");
    check("def f(p): return p[1] end say(f([4, 5]))", "5");
    check("def norm(x): return 42 end say(norm(1))", "42");
    check("def f(x): x[0] = 9 return x end a = [1] b = f(a) say(a, b)", "[1] [9]");
}

#[test]
fn scopes() {
    check("def p(): x = 1 def f(): x = x + 1 end f() say(x) end", "2");
    check("def p(): def f(): y = 5 say(y) end f() y = 1 say(y) f() say(y) end", "5|1|5|5");
    check("def p(): x = 1 def f(): local x = 7 x = x + 1 say(x) end f() say(x) end", "8|1");
    check("def p(): def f(): global g = 3 end f() say(g) end", "3");
    check("def p(): def f(): z = 3 end def g(): z = 1 f() return z end say(g()) end", "1");
    check_fails(
        "def p():\n  def f():\n    return q\n  end\n  f()\n  q = 1\nend",
        3,
        12,
        "`q` is used before",
    );
}

#[test]
fn conditions_and_loops() {
    check("i = 0 while i < 5: i = i + 1 if i == 2: continue end if i == 4: break end say(i) end", "1|3");
    check("x = 2 if x == 1: say(1) elif x == 2: say(2) else: say(3) end", "2");
    check("if (True\n and 2): say(1) end", "1");
    check("def t(): say('t') return True end x = False and t() y = True or t() say(x, y)", "False True");
    check("while True: if True: break end end say(1)", "1");
}

#[test]
fn threads_take_turns_in_frames() {
    check(
        "def p():\n thread a():\n  i = 0 while i < 3: say('a', i) i = i + 1 sync() end\n end\n \
         h = run a() say('m') sync() say('m') join h say('end') end",
        "m|a 0|m|a 1|a 2|end",
    );
    check("thread t(): sleep(0.004) say('t') end h = run t() sleep(0.003) say('m') join h", "m|t");
    check("thread t(): say('never') end h = run t() kill h join h say(h != 0)", "True");
    check("kill 0 join 0 h = 0 kill h if h == 0: say('ok') end", "ok");
    check("thread t(): say(1) end run t() sync()", "1");
}

#[test]
fn a_joined_or_freed_thread_goes_on_in_the_same_frame() {
    let (host, _) = run("thread t(): wait(3) end h = run t() join h say('x') wait(1000)", 4);
    assert_eq!(host.said, ["x"], "three frames of waiting, then the fourth");
}

#[test]
fn killing_takes_the_children_along() {
    let text = "thread child(): wait(100) end thread t(): run child() wait(100) end \
                h = run t() sync() kill h sync() say('done')";
    let (host, progress) = run(text, 10);
    assert_eq!((host.said, progress), (vec!["done".to_owned()], Progress::Finished));
    assert_eq!(host.abandoned, ["wait", "wait"]);
}

#[test]
fn the_critical_section_is_handed_on_in_order() {
    check(
        "thread a(): i = 0 while i < 2: enter_critical say('a') sync() exit_critical i = i + 1 end end\n\
         h = run a() n = 0 while n < 2: enter_critical say('m') sync() exit_critical n = n + 1 end join h",
        "m|a|m|a",
    );
    check(
        "thread a(): enter_critical wait(1000) exit_critical end h = run a() sync() kill h enter_critical \
         say('free') exit_critical",
        "free",
    );
    check("enter_critical enter_critical exit_critical exit_critical say(1)", "1");
    // A trajectory within the section, and orders that are read within it, do not wait for each other.
    check(
        "thread a(): enter_critical wait(5) say('arrived') wait(5) exit_critical end\n\
         h = run a() n = 0 while n < 2: enter_critical wait(2) say('order') exit_critical n = n + 1 end \
         join h",
        "order|order|arrived",
    );
    check(
        "thread a(): enter_critical wait(5) say('arrived') exit_critical end run a() n = 0 \
         while n < 20: enter_critical sync() exit_critical n = n + 1 end say('end')",
        "arrived|end",
    );
    check(
        "thread a(): enter_critical say('a') sync() say('a2') exit_critical end h = run a() enter_critical \
         sync() join 0 say('m') sync() say('m2') exit_critical join h",
        "m|m2|a|a2",
    );
    // A thread that is ordered in the section to end, waited for there, and has to pass it once more itself.
    check(
        "on = True thread a(): while on: enter_critical wait(2) exit_critical end say('ended') end\n\
         h = run a() sync() enter_critical on = False join h say('joined') exit_critical enter_critical \
         say('free') \
         exit_critical",
        "ended|joined|free",
    );
    check_fails("exit_critical", 1, 1, "without enter_critical");
}

#[test]
fn blocking_built_ins_wait_in_frames() {
    let (host, progress) = run("wait(5) say('a')", 5);
    assert_eq!((host.said.len(), progress), (0, Progress::Running));
    check("wait(5) say('a')", "a");
}

#[test]
fn the_end_of_the_main_function_ends_everything() {
    check("thread t(): while True: sync() end end run t() say(1)", "1");
    check("def f(): halt end f() say('never')", "");
}

#[test]
fn a_loop_of_calls_that_wait_is_not_endless_and_leaves_the_others_their_frames() {
    let (host, progress) =
        run("thread t(): while True: say(1) sync() end end run t() while True: read() end", 50);
    assert_eq!((progress, host.said.len()), (Progress::Running, 50));
    // Whatever it waited for before, a loop that does not wait is endless.
    for text in ["read() while 1: end", "n = 0 while n < 500: read() n = n + 1 end while 1: end"] {
        let (_, progress) = run(text, 50);
        let endless = matches!(&progress, Progress::Failed(e) if e.message.starts_with("endless loop"));
        assert!(endless, "{text}: {progress:?}");
    }
}

#[test]
fn threads_that_are_started_and_joined_use_up_one_frame() {
    let text = "thread t():\n i = 0\n while i < 1000: i = i + 1 end\nend\nn = 0\nwhile n < 1000:\n h = run t()\n \
                join h\n n = n + 1\nend";
    let (_, progress) = run(text, 1);
    let endless = matches!(&progress, Progress::Failed(e) if e.message.starts_with("endless loop: 1000000"));
    assert!(endless, "{progress:?}");
}

#[test]
fn a_program_may_have_very_many_variables() {
    let global: String = (0..30_000).map(|n| format!("a{n} = {n}\n")).collect();
    let local: String = (0..30_000).map(|n| format!("local b{n} = a{n}\n")).collect();
    check(
        &format!("{global}say(a29999) sync()\ndef f():\n{local}say(b29999)\nend\nsync() f()"),
        "29999|29999",
    );
}

#[test]
fn exceptions_have_a_place() {
    check_fails("x = 1\ny = [1, 2]\nz = y[2]", 3, 6, "out of range");
    check_fails("x = 1 / 0", 1, 7, "division by zero");
    check_fails("x = 'a' + 1", 1, 9, "cannot compute string + int");
    check_fails("while 1: end", 1, 7, "endless loop");
    check_fails("def f(n): return f(n + 1) end f(0)", 1, 18, "nested deeper");
    check_fails("x = [0] while True: x = [x] end", 1, 25, "too large");
    check_fails("x = [0] x = [1, 2]", 1, 9, "does not fit");
    check_fails("x = [0] x.append(1)", 1, 10, "make_list sets its capacity");
    check_fails("x = [0] x.shape()", 1, 10, "only a matrix");
    check_fails("x = 5 y = x.length()", 1, 12, "int has no method");
    check_fails("x = sqrt(-1)", 1, 5, "not defined");
    check_fails(
        "thread t():\n sync()\n x = [0][1]\nend\nrun t()\nsync() sync() sync()",
        3,
        9,
        "out of range",
    );
    check_fails("x = 1 x.a = 2", 1, 7, "cannot assign into int");
    check_fails("def f(): end x = f()", 1, 14, "without a return value");
}

#[test]
fn loading_checks_names_and_arguments() {
    check_refused("x = nowhere", "compile_error_name_not_found:nowhere:");
    check_refused("nothing(1)", "compile_error_name_not_found:nothing:");
    check_refused("run nothing()", "compile_error_name_not_found:nothing:");
    check_refused("x = (1", "syntax_error_on_line:1:");
    check_refused("movej()", "parameter `q` is missing");
    check_refused("movej([1], q=[2])", "given twice");
    check_refused("movej([1], w=1)", "no parameter `w`");
    check_refused("def f(a): end f(1, 2)", "at most 1");
    check_refused("break", "belong into a `while`");
}

#[test]
fn random_repeats_with_the_seed() {
    let (a, _) = run("say(random()) say(random())", 1);
    let (b, _) = run("say(random()) say(random())", 1);
    assert!(a.said == b.said && a.said[0] != a.said[1]);
}

proptest! {
    #[test]
    fn programs_of_any_tokens_run_or_are_refused(words in proptest::collection::vec(
        proptest::sample::select(vec![
            "def", "f", "(", ")", ":", "end", "if", "else", "while", "x", "=", "p", "[", "]", ",", "1", "0",
            "2.5", "\"s\"", "not", "-", "+", "*", "/", "==", "and", "run", "kill", "join", "return",
            "thread", "global", "local", "enter_critical", "exit_critical", "halt", "say", "wait", "sync()",
            "x = 1", "x = [1, 2]", "f()", "def f():", "x[0]", "end", "while x:", "sync() end",
        ]), 0..40)) {
        let mut host = Recorder::default();
        if let Ok(code) = compile(&words.join(" "), &find) {
            let mut program = Program::new(Arc::new(code), 1);
            for _ in 0..5 {
                if program.frame(&mut host) != Progress::Running {
                    break;
                }
            }
        }
    }
}

#[test]
fn methods_work_on_lists_structs_and_matrices() {
    // The manual's own examples (chapter 4.3), and what it leaves open.
    check(
        "l = make_list(0, 0, 10)\nl.append(88)\nsay(l)\nsay(l.capacity())\nsay(l.excess_capacity())\n\
         l.extend([1, 2])\nl.insert(1, 7)\nsay(l)\nsay(l.pop())\nl.remove(0)\nsay(l.to_string())\n\
         l.clear()\nsay(l.length())",
        "[88]|10|9|[88, 7, 1, 2]|2|[7, 1]|0",
    );
    check(
        "l1 = make_list(5, -1, 10)\nl2 = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10]\nidx = l1.length()\n\
         while(idx < l1.capacity()):\nl1.append(l2[idx])\nidx = idx + 1\nend\nsay(l1)\nsay(l2.slice(2, 4))",
        "[-1, -1, -1, -1, -1, 6, 7, 8, 9, 10]|[3, 4]",
    );
    check(
        "s = struct(a = 1, b = make_list(0, 0, 2))\ns.b.append(5)\nsay(s.b)\nsay(s[0])\nsay(s.length())\n\
         m = [[1, 2, 3], [4, 5, 6]]\nsay(m.shape())\nsay(m.get_row(1))\nsay(m.get_column(2))\nsay(! True)",
        "[5]|1|2|[2, 3]|[4, 5, 6]|[3, 6]|False",
    );
    // A list keeps its capacity when it is assigned to; copies are their own.
    check(
        "a = make_list(0, 0, 3)\na = [1, 2]\na.append(3)\nb = a\nb[0] = 9\nsay(a)\nsay(a.capacity())\n\
         c = [0.0, 0.0]\n\
         c = struct(x = 1.5, y = 2.5)\nsay(c)",
        "[1, 2, 3]|3|[1.5, 2.5]",
    );
}

#[test]
fn a_pause_is_reported_once_and_the_program_goes_on_behind_it() {
    let mut host = Recorder::default();
    let code = compile("say(1) pause say(2)", &find).unwrap();
    let mut program = Program::new(Arc::new(code), 7);
    assert_eq!(program.frame(&mut host), Progress::Paused);
    assert_eq!(host.said, ["1"]);
    assert_eq!(program.frame(&mut host), Progress::Finished);
    assert_eq!(host.said, ["1", "2"]);
}

#[test]
fn strings_stay_within_their_bounds_and_numbers_within_theirs() {
    check("s = 'x' i = 0 while i < 16: s = str_cat(s, s) i = i + 1 end say(str_len(s))", "65536");
    let long = "s = 'x' i = 0 while i < 16: s = str_cat(s, s) i = i + 1 end l = make_list(1000, s) ";
    check(&format!("{long}say(str_len(l.to_string()) < 70000)"), "True");
    check_fails(&format!("{long}x = to_str(l)"), 1, 88, "too long");
    check_fails("x = str_cat('a', struct(b = 1))", 1, 5, "no part of a string");
    check("say(to_num('-0x10')) say(to_num('7')) say(to_num('inf'))", "-16|7|inf");
    check_fails("x = to_num('1e999')", 1, 5, "out of range");
    check_fails("x = to_num('99999999999')", 1, 5, "out of range");
    check_fails("x = to_num('0x+F')", 1, 5, "not a number");
}

#[test]
fn a_local_list_is_declared_anew_and_structs_become_lists_of_one_type() {
    check("def f(): local x = [1] local x = [1, 2] say(x) end f()", "[1, 2]");
    check("a = [1, 2] a = struct(x = 1.5, y = 2) say(a)", "[1.5, 2]");
    check_fails("a = [1, 2] a = struct(x = 1, y = 's')", 1, 12, "members have the list's type");
}
