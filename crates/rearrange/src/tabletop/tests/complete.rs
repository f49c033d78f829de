//! One fault hides no other: what is sound in a file is judged, whatever is wrong beside it.

use super::{read, reported};
use crate::document::edit::{replace_first, replace_once};
use crate::tabletop::parse::parse_pair;

fn pair_complaints(start: &str, goal: &str) -> Vec<String> {
    let faults = parse_pair((start, "s"), (goal, "g"), &|_| None).expect_err("refused");
    faults.0.iter().map(ToString::to_string).collect()
}

#[track_caller]
fn check(reported: &[String], wanted: &[&str]) {
    assert_eq!(reported.len(), wanted.len(), "{reported:#?}");
    for (line, wanted) in reported.iter().zip(wanted) {
        assert!(line.starts_with(wanted), "{line}\nwanted {wanted}");
    }
}

const TASK: &str = "\
workspace: {width: 1.0, height: 1.0}
objects:
  - {id: a, footprint: {disc: {radius: 0.1}}, start: [0.2, 0.2, 0], marker: {id: 7, size: 0.03}}
  - {id: b, footprint: {disc: {radius: 0.1}}, start: [0.7, 0.2, 0], marker: {id: 8, size: 0.03}}
";

#[test]
fn overlaps_are_reported_beside_wrong_keys() {
    let text = replace_once(TASK, "[0.7, 0.2, 0]", "[0.3, 0.2, 0]");
    let text = format!(
        "{text}  - {{id: c, footprint: {{disc: {{radius: 0.1 m}}}}, start: [0.2, 0.2, 0]}}\ncolour: red\n"
    );
    check(
        &reported(&text),
        &[
            "t.yaml:4:54: objects[1].start: \"b\" overlaps \"a\" by 100.000 mm; move them apart",
            "t.yaml:5:40: objects[2].footprint.disc.radius: \"0.1 m\" is not a number",
            "t.yaml:6:1: colour: unknown key",
        ],
    );
    // Without a sound tolerance nothing can be said about overlaps.
    let text = format!("overlap_tolerance: much\n{}", replace_once(&text, "colour: red\n", ""));
    assert!(!reported(&text).iter().any(|line| line.contains("overlaps")));
}

#[test]
fn marker_numbers_are_compared_as_numbers() {
    for same in ["7", "07", "+7", "0007"] {
        let reported = reported(&replace_once(TASK, "id: 8", &format!("id: {same}")));
        check(
            &reported,
            &["t.yaml:4:82: objects[1].marker.id: marker 7 is used twice, first by object \"a\" in line 3"],
        );
    }
}

#[test]
fn an_object_of_a_task_has_a_start() {
    let without_start = replace_once(TASK, "start: [0.7, 0.2, 0], ", "");
    let text = replace_once(&without_start, "start: [0.2, 0.2, 0]", "start: null");
    check(
        &reported(&text),
        &[
            "t.yaml:3:5: objects[0]: the object has no start; add `start:",
            "t.yaml:4:5: objects[1]: the object",
        ],
    );
    // The second file of a pair says only where things go.
    let goal = replace_once(&without_start, "start: [0.2", "goal: [0.5");
    let task = parse_pair((TASK, "s"), (&goal, "g"), &|_| None).expect("valid");
    assert_eq!(task.objects.iter().filter(|object| object.goal.is_some()).count(), 1);
}

#[test]
fn both_files_of_a_pair_are_judged_and_strangers_named_where_they_stand() {
    let start = replace_once(TASK, "[0.7, 0.2, 0]", "[0.7, 0.2]");
    let goal = replace_once(TASK, "id: b", "id: z");
    let goal = replace_first(&goal, "radius: 0.1", "radius: wide");
    check(
        &pair_complaints(&start, &goal),
        &[
            "s:4:54: objects[1].start: 2 values, 3 are wanted",
            "g:3:40: objects[0].footprint.disc.radius: \"wide\" is not a number",
            "g:4:10: objects[1]: object \"z\" is not in s; remove it or correct its name",
        ],
    );
    let torn = pair_complaints("objects: [", &goal);
    assert!(torn.len() == 2 && torn[1].starts_with("g:3:40:"), "{torn:#?}");
}

fn discs(points: &str, count: &str) -> String {
    format!(
        "{{\"Object_Radius\": 50, \"Object_Shape\": \"disc\", \"Workspace_Density\": \
         0.1, \"Workspace_Height\": 1000,\n\
         \"Workspace_Width\": 1000, \"number_of_objects\": {count},\n\"point_list\": [{points}]}}"
    )
}

#[test]
fn starts_of_public_arrangements_are_checked() {
    let goal = discs("[100, 500], [300, 500]", "2");
    let task = parse_pair((&goal, "s"), (&goal, "g"), &|_| None).expect("valid");
    assert_eq!(task.objects.len(), 2);
    check(
        &pair_complaints(&discs("[100, 500], [140, 500]", "2"), &goal),
        &["s:3:28: point_list[1]: \"disc-1\" overlaps \"disc-0\" by 60.000 mm"],
    );
    let over = pair_complaints(&discs("[100, 500], [990, 500]", "2"), &goal);
    check(&over, &["s:3:28: point_list[1]: \"disc-1\" reaches over the table's edge by 40.000 mm"]);
    // Goals that overlap make a task without a solution, not a bad file.
    assert!(parse_pair((&goal, "s"), (&discs("[100, 500], [140, 500]", "2"), "g"), &|_| None).is_ok());
}

#[test]
fn what_public_files_say_of_themselves_is_read() {
    let good = discs("[100, 500], [300, 500]", "2");
    let wrong = |count: &str| pair_complaints(&discs("[100, 500], [300, 500]", count), &good);
    check(&wrong("\"abc\""), &["s:2:47: number_of_objects: text in quotes where a whole number"]);
    check(&wrong("3"), &["s:2:47: number_of_objects: 3 objects are stated, 2 are listed"]);
    let dense = pair_complaints(
        &replace_once(&good, "\"Workspace_Density\": 0.1", "\"Workspace_Density\": 30"),
        &good,
    );
    check(&dense, &["s:1:68: Workspace_Density: 30 of the table is out of range"]);
    // The published desk states 0.
    assert!(parse_pair((&discs("[100, 500], [300, 500]", "0"), "s"), (&good, "g"), &|_| None).is_ok());
    let task = "{\"Workspace_Height\": 1000, \"Workspace_Width\": 1000, \"number_of_objects\": abc, \"object_list\": []}";
    let reported = read(task).expect_err("refused").to_string();
    assert!(reported.contains("number_of_objects: \"abc\" is not a whole number"), "{reported}");
}
