//! Built-ins that request a value from whoever is at the pendant: `request_..._from_primary_client`.
//!
//! In: calls from running programs, repeated each frame until there is an answer. Out: a message to the
//! clients of the primary interface (type 9), and the value. What a client sends back is not published, so
//! the answer comes from the pendant, which is the simulator's control server here; types and layout of the
//! message are assumed.

use crate::controller::core::Core;
use crate::controller::value_requests::Wanted;
use ur_wire::primary_message::MessageBody;
use urscript::host::{Call, Reply};
use urscript::string_library::cut_short;

/// Carries out a built-in of this file; `None` if it is none of them.
pub fn call(core: &mut Core, call: &mut Call<'_>) -> Option<Result<Reply, String>> {
    let wanted = Wanted::of(call.name)?;
    if core.secondary {
        return Some(Err(format!("{}: a secondary program must not wait", call.name)));
    }
    Some(call.required(0).map(cut_short).map(|text| request(core, call, wanted, text)))
}

fn request(core: &mut Core, call: &mut Call<'_>, wanted: Wanted, text: String) -> Reply {
    if *call.note != 0 {
        return core.requests.take(*call.note).map_or(Reply::Wait, Reply::Value);
    }
    if let Some(number) = core.requests.show(call.thread, wanted, text.clone()) {
        *call.note = number;
        let request = u32::try_from(number).unwrap_or(u32::MAX);
        core.message(MessageBody::RequestValue { request, value_type: wanted.code(), text });
    }
    Reply::Wait
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::controller::builtins::compile_program;
    use crate::controller::{Controller, ControllerConfig};
    use serde_json::json;

    fn running(script: &str) -> Controller {
        let mut controller = Controller::new(ControllerConfig { running: true, ..ControllerConfig::ur5e(1) });
        controller.programs.upload(compile_program(script));
        (0..10).for_each(|_| controller.frame());
        controller
    }

    #[test]
    fn a_program_waits_for_values_of_the_type_it_wants() {
        let mut controller = running(
            "def request():\n b = request_boolean_from_primary_client(\"Go?\")\n i = \
             request_integer_from_primary_client(\"How many?\")\n f = request_float_from_primary_client(\"How \
             far?\")\n s = request_string_from_primary_client(\"Who?\")\n textmsg([b, i, f, s])\nend\n",
        );
        let answers = [
            ("boolean", "Go?", json!(1), json!(true)),
            ("integer", "How many?", json!(4_000_000_000_u32), json!(-3)),
            ("float", "How far?", json!("far"), json!(0.25)),
            ("string", "Who?", json!(null), json!("me")),
        ];
        for (kind, text, wrong, right) in answers {
            let shown = controller.core.requests.shown().unwrap();
            assert_eq!((shown.wanted.name(), shown.text.as_str()), (kind, text));
            let refused = controller.core.requests.answer(&wrong).unwrap_err();
            assert!(refused.contains(kind), "{refused}");
            (0..100).for_each(|_| controller.frame());
            assert!(controller.core.requests.shown().is_some(), "it waits");
            controller.core.requests.answer(&right).unwrap();
            assert!(controller.core.requests.answer(&right).is_err(), "it is answered");
            (0..3).for_each(|_| controller.frame());
        }
        let messages = controller.core.take_messages();
        let codes: Vec<u32> = messages
            .iter()
            .filter_map(|message| match message {
                MessageBody::RequestValue { value_type, .. } => Some(*value_type),
                _ => None,
            })
            .collect();
        assert_eq!(codes, [0, 1, 2, 3]);
        assert!(messages.contains(&MessageBody::Text("[True, -3, 0.25, me]".to_owned())), "{messages:?}");
    }

    #[test]
    fn one_request_is_shown_at_a_time_and_goes_with_its_thread_or_program() {
        let mut controller = running(
            "def request():\n thread other():\n  textmsg(request_integer_from_primary_client(\"b\"))\n end\n h = run \
             other()\n sync()\n textmsg(request_integer_from_primary_client(\"a\"))\n join h\nend\n",
        );
        for answer in ["b", "a"] {
            assert_eq!(controller.core.requests.shown().unwrap().text, answer);
            controller.core.requests.answer(&json!(1)).unwrap();
            (0..3).for_each(|_| controller.frame());
        }
        assert!(controller.core.requests.shown().is_none());
        let mut controller = running("def ask():\n request_float_from_primary_client(\"a\")\nend\n");
        let Controller { core, programs } = &mut controller;
        programs.stop(core);
        assert!(core.requests.shown().is_none(), "the program has gone");
        let mut controller = running(
            "def request():\n thread other():\n  request_integer_from_primary_client(\"b\")\n end\n h = run \
             other()\n sleep(0.004)\n kill h\n request_integer_from_primary_client(\"a\")\nend\n",
        );
        (0..10).for_each(|_| controller.frame());
        assert_eq!(controller.core.requests.shown().unwrap().text, "a");
    }

    #[test]
    fn a_thread_that_goes_before_its_request_is_shown_leaves_the_other_one() {
        let controller = running(
            "def request():\n thread first():\n  request_integer_from_primary_client(\"a\")\n end\n thread \
             second():\n  request_integer_from_primary_client(\"b\")\n end\n run first()\n h = run \
             second()\n sleep(0.004)\n kill h\n sleep(9)\nend\n",
        );
        assert_eq!(controller.core.requests.shown().unwrap().text, "a");
    }
}
