//! Fault files that are sound, and every way to be wrong.

use super::*;

fn reported(text: &str) -> String {
    read_faults(text, "f.yaml").expect_err("refused").to_string()
}

#[track_caller]
fn refused(text: &str, complaint: &str) {
    let reported = reported(text);
    assert!(reported.contains(complaint), "{reported}");
}

#[test]
fn triggers_and_arguments_are_read() {
    let text = "faults:\n  - {at: {time_s: 3}, do: vacuum.drop}\n  - at: \
                {step: 3, phase: carry, progress: 0.5}\n    do: ur.slider\n    args: \
                {fraction: 0.1, seconds: 2}\n  - {at: {event: grip, count: 2}, do: camera.off}\n";
    let plans = read_faults(text, "f").unwrap();
    assert_eq!(plans[0].at, Some(Trigger::Time(3.0)));
    assert_eq!(plans[0].order.fault, Fault::Vacuum(VacuumFault::Drop(None)));
    assert_eq!(plans[0].order.seconds, Some(DROP_SECONDS));
    assert_eq!(plans[1].at, Some(Trigger::Step { step: 3, phase: Phase::Carry, progress: 0.5 }));
    assert_eq!(plans[1].order.fault, Fault::Robot(RobotFault::Slider(0.1)));
    assert_eq!(plans[1].order.seconds, Some(2.0));
    assert_eq!(plans[2].at, Some(Trigger::Event { kind: DeviceEvent::Grip, object: None, count: 2 }));
}

#[test]
fn what_is_wrong_is_said_with_its_place() {
    refused(
        "faults:\n  - {do: vacuum.dorp}\n",
        "f.yaml:2:10: faults[0].do: there is no fault \"vacuum.dorp\"; did you mean \"vacuum.drop\"?",
    );
    refused("faults:\n  - {do: ur.pstop, args: {x: 1}}\n", "2:27: faults[0].args.x: unknown key");
    refused("faults:\n  - {do: ur.pstop, args: {seconds: 1}}\n", "faults[0].args.seconds: unknown key");
    refused("faults:\n  - {do: world.nudge, args: {object: a}}\n", "none of dx_m, dy_m, dtheta_rad is given");
    refused("faults:\n  - {do: camera.drift}\n", "none of translation_m, rotation_deg is given");
    refused("faults:\n  - {do: world.place, args: {object: a, pose: [1e9, 0, 0]}}\n", "out of range");
    refused("faults:\n  - {do: world.place, args: {object: '', pose: [0, 0, 0]}}\n", "an empty text");
    refused("faults:\n  - {do: ur.slider}\n", "key \"fraction\" is missing");
    refused("faults:\n  - {do: ur.slider, args: {fraction: 2}}\n", "2 of full speed is out of range");
    refused("faults:\n  - {do: ur.estop, args: {seconds: -1}}\n", "-1 s is out of range");
    refused("faults:\n  - {do: vacuum.drop, args: {channel: C}}\n", "\"C\" is not known here");
    refused("faults:\n  - {do: ur.claim, args: {input: nonsense}}\n", "RTDE has no input \"nonsense\"");
    refused("faults:\n  - {do: camera.occlude, args: {marker: 9999}}\n", "tag36h11 has no marker 9999");
    refused("faults:\n  - {do: world.nudge}\n", "key \"object\" is missing");
    refused("faults:\n  - {do: net.timeout, args: {link: rdte}}\n", "\"rdte\" is not known here");
    refused("faults:\n  - {do: net.exception, args: {code: 5}}\n", "code 5 is no error");
    refused("faults:\n  - {do: ur.version, args: {version: 5.9}}\n", "no software version");
    refused("faults:\n  - {do: ur.rate, args: {hz: 0}}\n", "0 Hz is out of range");
    refused("faults:\n  - {do: clear, args: {fault: ur}}\n", "\"ur\" is not known here");
    refused("fault: []\n", "did you mean \"faults\"?");
    refused("faults: 3\n", "a list");
}

#[test]
fn a_trigger_is_one_thing() {
    let with = |trigger: &str| format!("faults:\n  - {{at: {trigger}, do: ur.pstop}}\n");
    refused(&with("{}"), "exactly one of time_s, step and event");
    refused(&with("{time_s: 1, step: 2}"), "exactly one of");
    refused(&with("{time_s: 1, phase: carry}"), "\"phase\" does not go with \"time_s\"");
    refused(&with("{event: grip, progress: 0.1}"), "\"progress\" does not go with \"event\"");
    refused(&with("{step: 0}"), "0 is out of range");
    refused(&with("{step: 1, phase: fly}"), "\"fly\" is not known here");
    refused(&with("{step: 1, progress: 2}"), "2 of the move is out of range");
    refused(&with("{event: gripp}"), "one of: grip, place");
    refused(&with("{time_s: .nan}"), "not a finite number");
    refused(&with("{when: 1}"), "unknown key");
}

#[test]
fn one_fault_may_be_posted_without_a_list() {
    let plans = read_posted(r#"{"do": "world.nudge", "args": {"object": "a", "dx_m": 0.01}}"#).unwrap();
    let by = Pose2::new(0.01, 0.0, 0.0);
    assert_eq!(plans[0].order.fault, Fault::World(WorldFault::Nudge { object: "a".into(), by }));
    assert_eq!(read_posted(r#"{"faults": [{"do": "ur.pstop"}, {"do": "clear"}]}"#).unwrap().len(), 2);
    for bad in ["nonsense", "]", "", "{\"do\": 3}", "{\"do\": \"camera.off\", \"args\": {\"x\": 1}}"] {
        assert!(read_posted(bad).is_err(), "{bad}");
    }
}

#[test]
fn the_example_shows_every_fault_and_is_sound() {
    let text = include_str!("../../../../../config/faults-example.yaml");
    let plans = read_faults(text, "config/faults-example.yaml").unwrap();
    for (name, keys) in CATALOGUE {
        assert!(plans.iter().any(|plan| plan.order.name == *name), "{name} is not in the example");
        let page = include_str!("../../../../../docs/faults.md");
        assert!(page.contains(&format!("| `{name}` |")), "{name} is not in docs/faults.md");
        for key in keys.iter().filter(|key| **key != "seconds" && **key != "pose_deg") {
            assert!(page.contains(&format!("`{key}`")), "{name}: {key} is not in docs/faults.md");
        }
    }
}
