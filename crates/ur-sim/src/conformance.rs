//! What of the real machines is real here, what is modelled and what is absent, as one page for users.
//!
//! In: the tables that the simulator itself runs by (built-ins of scripts, RTDE variables), and for the rest
//! rows that name a test of theirs. Out: Markdown, `docs/simulator-conformance.md`, which a test compares
//! with this; `celld sim --conformance` prints it. A claim without a test is not listed here.

use crate::controller::builtins::{self, Entry, Grade};
use crate::controller::outputs;
use std::fmt::Write;
use ur_wire::rtde_variables::{INPUTS, OUTPUTS};

/// A row that no table of the simulator holds: what, how much of it, what to know, and the test of it.
struct Claim(&'static str, Grade, &'static str, &'static str);

const MOTION: &[Claim] = &[
    Claim(
        "Forward and inverse kinematics",
        Grade::Real,
        "Denavit-Hartenberg with the calibration's deltas",
        "kinematics_agree_both_ways",
    ),
    Claim(
        "Times of moves",
        Grade::Modelled,
        "trapezoids of speed in joint or tool space; the controller's own smoothing adds to short moves",
        "published_times_of_trapezoids",
    ),
    Claim(
        "Blends",
        Grade::Modelled,
        "parabolas within the radius; the controller's curve is not published",
        "the_corner_is_passed_within_the_blend_radius",
    ),
    Claim(
        "Speed in a blend",
        Grade::Modelled,
        "not published; braked before the blend, or, by configuration, kept, scaled or raised, and then begun early or late",
        "a_blend_is_passed_at_the_speed_of_its_reading",
    ),
    Claim(
        "Coming to rest",
        Grade::Modelled,
        "the joints creep the last 0.1 mrad, and tremble, for as long as in recordings of a UR10e; in which joints is chosen",
        "the_joints_are_quiet_as_late_as_in_the_recordings",
    ),
    Claim(
        "Overlapping blends",
        Grade::Modelled,
        "of movej and movel: the second of two moves is skipped; the words are assumed",
        "a_move_whose_blend_overlaps_the_one_before_is_skipped",
    ),
    Claim(
        "movep, movec",
        Grade::Real,
        "constant tool speed round corners and circles",
        "process_moves_round_their_corners_at_constant_speed",
    ),
    Claim("servoj", Grade::Modelled, "first-order lag", "servoing_converges_on_the_target"),
    Claim("speedj, speedl, stopj, stopl", Grade::Real, "", "a_tool_speed_goes_straight_and_stops"),
    Claim("Speed slider, pausing on the way", Grade::Real, "", "half_the_slider_takes_twice_the_time"),
    Claim(
        "Ways out of reach, out of the joint range or through a singularity",
        Grade::Real,
        "a protective stop, as on the arm",
        "impossible_moves_stop_protectively_and_pause_the_program",
    ),
    Claim(
        "Tool speed limit of the safety configuration",
        Grade::Real,
        "",
        "the_tool_is_slowed_down_to_the_safety_configurations_speed",
    ),
    Claim(
        "Contact",
        Grade::Modelled,
        "quasi-static; pressing too deep stops protectively",
        "pressing_on_the_table_stops_the_arm",
    ),
    Claim(
        "force_mode, freedrive",
        Grade::Modelled,
        "speed in proportion to the missing force",
        "force_mode_runs_at_its_limit_in_the_air_and_rests_at_its_force_on_a_wall",
    ),
    Claim(
        "Joint moments and currents, acceleration, momentum",
        Grade::Modelled,
        "moments from the published masses; currents in proportion to them, as no torque constant is \
         published",
        "a_standing_arm_holds_its_weight_and_the_payload_and_what_presses_on_it",
    ),
    Claim(
        "Self-collision, safety planes",
        Grade::Modelled,
        "a protective stop (C157, C152), not slowed down before; links as capsules, 20 mm of overlap free, the \
         tool a capsule where it is configured; tool and elbow at planes; numbers assumed",
        "an_arm_that_meets_itself_or_a_safety_plane_stops_and_may_go_back",
    ),
    Claim(
        "Conveyor tracking",
        Grade::Modelled,
        "a belt by its encoder, straight or round; assumed: the count's filter, and that an arm which is held \
         stays behind",
        "moves_are_carried_along_by_the_conveyor_until_it_is_left",
    ),
    Claim(
        "Momentum and power limits",
        Grade::Modelled,
        "where they are configured: moves are slowed down to them, other motion stops protectively (C191, \
         assumed); power is what the tool does to what it touches",
        "momentum_and_power_slow_moves_down_and_stop_what_cannot_be_slowed",
    ),
    Claim(
        "Path offsets",
        Grade::Modelled,
        "in all four frames, filtered and limited; see the built-ins",
        "a_weaving_offset_is_laid_over_a_move_and_left_at_its_end",
    ),
    Claim(
        "UR3e, UR5e, UR10e, UR16e and others by their DH table",
        Grade::Real,
        "masses for dynamics are those of the UR5e",
        "other_models_have_their_reach_and_their_name",
    ),
];

const SERVERS: &[Claim] = &[
    Claim(
        "RTDE version 1 and 2",
        Grade::Real,
        "recipes, frequencies, several clients",
        "rtde_gives_recipes_and_data",
    ),
    Claim(
        "RTDE inputs claimed by one client",
        Grade::Real,
        "IN_USE",
        "inputs_take_effect_in_the_next_frame_and_belong_to_one_client",
    ),
    Claim(
        "RTDE clients that do not read",
        Grade::Real,
        "dropped after 10 s",
        "an_rtde_client_that_does_not_read_is_dropped_and_a_script_client_is_not",
    ),
    Claim("RTDE input watchdog", Grade::Real, "", "a_watchdog_acts_when_its_client_falls_silent"),
    Claim(
        "Dashboard, all e-Series commands",
        Grade::Real,
        "simulator-states.md lists the answers, and what is modelled or absent",
        "every_command_answers_as_listed",
    ),
    Claim(
        "Robot, safety and program states",
        Grade::Real,
        "simulator-states.md has the table",
        "every_transition_leads_where_the_table_says",
    ),
    Claim(
        "Local and remote control",
        Grade::Real,
        "",
        "local_mode_refuses_until_the_connection_is_made_anew",
    ),
    Claim(
        "Primary interface: version, robot state, key, error, runtime exception, text, popup",
        Grade::Real,
        "",
        "every_published_sub_package_is_sent",
    ),
    Claim(
        "Secondary and real-time interface",
        Grade::Real,
        "block of 5.10 and newer",
        "the_block_has_the_length_it_names",
    ),
    Claim(
        "Read-only ports 30011 to 30013",
        Grade::Real,
        "",
        "read_only_ports_send_the_same_and_take_nothing",
    ),
    Claim(
        "Scripts on all three ports, secondary programs",
        Grade::Real,
        "",
        "a_secondary_program_runs_beside_the_main_one",
    ),
    Claim(
        "Programs of the External Control URCap",
        Grade::Modelled,
        "as its published source; assumed: when an answer is whole, 5 s for the first byte, one round",
        "a_program_of_external_control_runs_what_the_pc_hands_out",
    ),
    Claim(
        "Interpreter mode (30020)",
        Grade::Modelled,
        "assumed: reasons of a discard, replies to skipbuffer and abort, identifiers from 1 in each program",
        "statements_are_acknowledged_and_join_the_programs_first_level",
    ),
    Claim(
        "Modbus server of the controller (502)",
        Grade::Modelled,
        "the published map without Euromap and analog inputs; assumed: gaps, turns of joints, who may write",
        "outputs_are_written_by_register_by_mask_and_by_coil",
    ),
    Claim(
        "XML-RPC calls of scripts",
        Grade::Modelled,
        "a connection for each call; assumed: what fails is a runtime exception",
        "scripts_call_methods_of_a_server_and_wait_for_the_answer",
    ),
    Claim(
        "PolyScope X: modes, power and brakes over the Robot API, in place of the dashboard",
        Grade::Modelled,
        "words, and what waits for the arm, as published clients rely on them; assumed: statuses, unlocking \
         at once, a safeguard stop shown as a protective one",
        "power_and_brakes_are_answered_when_the_arm_is_so_far",
    ),
    Claim(
        "PolyScope X: programs (.urpx) uploaded, loaded, played",
        Grade::Modelled,
        "assumed: the application's script runs before the program's own; uploads in local control too",
        "programs_are_uploaded_listed_replaced_downloaded_and_played",
    ),
    Claim(
        "PolyScope X: requests by version (10.11, 10.12, 10.14)",
        Grade::Modelled,
        "assumed: the API's own version before 3.1.4, what is in a flight report, the body that sets the \
         operational mode; no licences, URCaps",
        "each_version_has_its_requests",
    ),
    Claim(
        "Values that programs request from the pendant",
        Grade::Modelled,
        "answered at the simulator's control server; assumed: the message to primary clients",
        "a_program_waits_for_values_of_the_type_it_wants",
    ),
    Claim("PROFINET, EtherNet/IP", Grade::Absent, "", ""),
    Claim(
        "Files over SSH/SFTP, other URCaps, PolyScope itself",
        Grade::Absent,
        "programs come from the configured folder",
        "",
    ),
];

const CELL: &[Claim] = &[
    Claim(
        "VGC10 registers over Modbus TCP (Compute Box), both channels",
        Grade::Real,
        "",
        "grip_is_written_and_the_leaking_vacuum_read_back",
    ),
    Claim(
        "Modbus exceptions",
        Grade::Real,
        "",
        "what_the_device_does_not_offer_is_an_exception_and_changes_nothing",
    ),
    Claim(
        "Pump, leaks, current limit",
        Grade::Modelled,
        "first-order curves",
        "the_current_limit_slows_the_pump_and_stops_it_at_nothing",
    ),
    Claim(
        "Gripping",
        Grade::Modelled,
        "an object comes when its cups lie flat and wholly on it and the vacuum holds its weight",
        "a_cup_seals_only_flat_on_top_and_wholly_inside",
    ),
    Claim("Acceleration shakes loads off", Grade::Modelled, "", "shaking_needs_more_force_than_holding"),
    Claim(
        "Falling, leaning, falling off the table",
        Grade::Modelled,
        "at once, without flight or bounce",
        "a_deep_overlap_leaves_it_tilted_on_top_until_the_lower_one_is_taken",
    ),
    Claim(
        "Pushing",
        Grade::Modelled,
        "quasi-static in the plane, friction by a limit surface",
        "a_push_beside_the_middle_turns_the_object",
    ),
    Claim(
        "Stacking",
        Grade::Modelled,
        "an object stands where the middle of its load is over its contacts, for all that it stands on, \
         from the start on those named before it; what does not stand leans",
        "a_bridge_stands_on_two_and_a_counterweight_holds_what_hangs_out",
    ),
    Claim(
        "Objects on conveyors",
        Grade::Modelled,
        "go along, push what is in their way, slip where it does not give way; a belt is level with the table",
        "a_post_holds_what_runs_into_it_and_what_stands_on_top_goes_along",
    ),
    Claim(
        "Robotiq 2F-85, 2F-140: registers over their URCap's socket (63352)",
        Grade::Modelled,
        "as published clients use them; assumed: 3 and 227 when open and closed, 1 s of activation, `?` for \
         what is unknown, motor current 0",
        "a_published_clients_calls_activate_and_calibrate_the_gripper",
    ),
    Claim(
        "Fingers: what is between them is centred, held by friction and set down",
        Grade::Modelled,
        "shifted, not turned; friction 0.5 and the pads' size assumed",
        "an_object_between_the_fingers_is_centred_held_carried_and_set_down",
    ),
    Claim(
        "Ejector on digital pins, blow-off, vacuum switch",
        Grade::Modelled,
        "pulls as the VGC10's pumps at full power do",
        "pins_suck_blow_off_and_report_the_part",
    ),
    Claim(
        "Compute Box: one Modbus client at a time",
        Grade::Modelled,
        "assumed: what becomes of a second one, and how long the place of one is kept whose cable was pulled",
        "a_second_client_is_turned_away_until_the_first_has_gone",
    ),
    Claim(
        "VGC10 on the tool's serial line (Modbus RTU through port 54321)",
        Grade::Modelled,
        "the Compute Box's registers; assumed: even parity, one stop bit, 1,000,000 or 115,200 baud, silence to \
         everything else",
        "the_gripper_answers_on_the_tools_serial_line_and_sucks",
    ),
    Claim(
        "Colour picture",
        Grade::Modelled,
        "ray cast with lens, blur and noise; a snapshot over HTTP instead of USB",
        "frames_carry_time_serial_and_a_growing_number",
    ),
    Claim(
        "Depth picture",
        Grade::Modelled,
        "noise, holes and ragged edges of a stereo camera",
        "noise_grows_with_the_square_of_the_distance",
    ),
];

/// The page.
pub fn page() -> String {
    let mut page = String::from(HEAD);
    claims(&mut page, "Motion", MOTION);
    claims(&mut page, "Servers", SERVERS);
    claims(&mut page, "Gripper, world and camera", CELL);
    scripts(&mut page);
    variables(&mut page);
    page
}

const HEAD: &str = "# What is real, modelled and absent

Printed by `celld sim --conformance`; a test keeps this page equal to the program. Real: as the manuals
say. Modelled: something simpler, which the note names. Absent: not there, and said so when it is requested. The
last column of the first tables names a test of it; the script and RTDE tables are those that the
simulator runs by, and tests call every row of them (`crates/ur-sim/src/controller/builtins.rs`,
`crates/ur-sim/src/robot_server/dashboard/tests.rs`) and judge every built-in that is called real
(`crates/ur-sim/src/controller/tests/judged.rs`).
";

fn claims(page: &mut String, title: &str, rows: &[Claim]) {
    let _ = writeln!(page, "\n## {title}\n\n| what | | note | test |\n|---|---|---|---|");
    for Claim(what, grade, note, test) in rows {
        let test = if test.is_empty() { String::new() } else { format!("`{test}`") };
        let _ = writeln!(page, "| {what} | {grade} | {note} | {test} |");
    }
}

/// The built-ins: those that are real need only be named.
fn scripts(page: &mut String) {
    let all = builtins::all();
    let of = |grade| all.iter().filter(move |entry| entry.grade == grade);
    let count = |grade| of(grade).count();
    let _ = writeln!(
        page,
        "\n## URScript\n\n\
         The language is whole: threads, critical sections, nested definitions, named and default \
         arguments, lists, matrices,\n\
         poses, structs and their methods, strings. Of {} built-ins known by name {} are real, {} modelled, \
         {} absent (calling one is a runtime\nexception; a program that only mentions it loads).\n",
        all.len(),
        count(Grade::Real),
        count(Grade::Modelled),
        count(Grade::Absent)
    );
    let _ = writeln!(page, "| built-in | | note |\n|---|---|---|");
    for grade in [Grade::Modelled, Grade::Absent] {
        for entry in of(grade) {
            let _ = writeln!(page, "| `{}` | {grade} | {} |", signature(entry), entry.note);
        }
    }
    let mut real: Vec<_> = of(Grade::Real).map(|entry| format!("`{}`", entry.builtin.name)).collect();
    real.sort();
    let _ = writeln!(page, "\nReal:\n{}.", wrapped(&real));
    for entry in of(Grade::Real).filter(|entry| !entry.note.is_empty()) {
        let _ = writeln!(page, "\n`{}`: {}.", entry.builtin.name, entry.note);
    }
}

fn signature(entry: &Entry) -> String {
    let names: Vec<_> = entry.builtin.parameters.iter().map(|parameter| parameter.name).collect();
    format!("{}({})", entry.builtin.name, names.join(", "))
}

fn variables(page: &mut String) {
    let graded = |wanted| {
        let names = OUTPUTS.iter().map(|(name, _)| *name);
        names.filter(|name| outputs::grade(name) == Some(wanted)).map(|name| format!("`{name}`")).collect()
    };
    let computed: Vec<String> = graded(outputs::Grade::Computed);
    let constant: Vec<String> = graded(outputs::Grade::Constant);
    let zero: Vec<String> = graded(outputs::Grade::Zero);
    let inputs: Vec<_> = INPUTS.iter().map(|(name, _)| format!("`{name}`")).collect();
    let _ = writeln!(
        page,
        "\n## RTDE variables\n\n\
         All have the guide's types. Registers (bit 64 to 127, int and double 0 to 47, in and \
         out) are real.\n\nOutputs that follow the simulation:\n{}.\n\n\
         Always what a healthy robot could send:\n{}.\n\n\
         Always zero, as nothing in the simulation corresponds to them:\n{}.\n\nInputs, all of them:\n{}.",
        wrapped(&computed),
        wrapped(&constant),
        wrapped(&zero),
        wrapped(&inputs)
    );
}

/// Names in lines of the width that the other pages have.
fn wrapped(names: &[String]) -> String {
    let mut text = String::new();
    let mut width = 0;
    for (index, name) in names.iter().enumerate() {
        let word = if index + 1 < names.len() { format!("{name},") } else { name.clone() };
        if width + word.len() > 118 {
            text.push('\n');
            width = 0;
        } else if index > 0 {
            text.push(' ');
        }
        width += word.len() + 1;
        text.push_str(&word);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn the_page_is_what_the_program_says() {
        let kept = include_str!("../../../docs/simulator-conformance.md");
        assert!(kept == page(), "run: celld sim --conformance > docs/simulator-conformance.md");
    }

    fn sources(folder: &Path, text: &mut String) {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            match path.extension() {
                _ if path.is_dir() => sources(&path, text),
                Some(end) if end == "rs" => text.push_str(&std::fs::read_to_string(&path).unwrap()),
                _ => {}
            }
        }
    }

    #[test]
    fn every_claim_has_a_test_and_only_what_is_absent_has_none() {
        let mut text = String::new();
        sources(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src"), &mut text);
        for Claim(what, grade, _, test) in MOTION.iter().chain(SERVERS).chain(CELL) {
            assert_eq!(*grade == Grade::Absent, test.is_empty(), "{what}");
            let before = text.split(&format!("fn {test}(")).next().unwrap();
            let above =
                before.trim_end().trim_end_matches("async").trim_end().lines().last().unwrap_or_default();
            let is_test = above.trim().starts_with("#[") && above.contains("test");
            assert!(
                test.is_empty() || (is_test && before.len() < text.len()),
                "{what}: there is no test {test}"
            );
        }
    }
}
