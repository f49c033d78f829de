//! Plays the tables of docs/simulator-states.md on a controller: a row that is wrong, or that the controller
//! does not follow any more, fails.

use crate::controller::modes::{Control, Modes};
use crate::controller::outputs::{Grade, grade};
use crate::controller::program_files::ProgramSource;
use crate::controller::{Controller, ControllerConfig};
use crate::robot_server::dashboard::answer;
use ur_wire::dashboard::{Command, NOT_ALLOWED_TEXT};
use ur_wire::rtde_variables::OUTPUTS;

const PAGE: &str = include_str!("../../../../../docs/simulator-states.md");

/// Cells of the table whose header starts with `header`.
fn table(header: &str) -> Vec<Vec<&'static str>> {
    let rows = PAGE.lines().skip_while(|line| !line.starts_with(&format!("| {header} |"))).skip(2);
    let rows: Vec<Vec<&str>> = rows
        .take_while(|line| line.starts_with('|'))
        .map(|line| line.trim_matches('|').split('|').map(str::trim).collect())
        .collect();
    assert!(!rows.is_empty(), "no table with {header:?}");
    rows
}

/// A controller and a dashboard connection to it.
struct Player {
    controller: Controller,
    switches: u64,
}

impl Player {
    fn new() -> Player {
        let mut config = ControllerConfig::ur5e(1);
        for (name, text) in
            [("work", "def work():\n while True:\n  sync()\n end\nend\n"), ("broken", "def b(:")]
        {
            config.programs.add(&format!("{name}.urp"), ProgramSource::Script(text.to_owned()));
        }
        Player { controller: Controller::new(config), switches: 0 }
    }

    fn request(&mut self, line: &str) -> String {
        let command = Command::parse(line);
        let reply = answer(&mut self.controller, &command, line, self.switches).line(&command);
        self.controller.frame();
        reply.trim_end().to_owned()
    }

    /// Plays steps separated by commas; the last answer.
    fn play(&mut self, steps: &str) -> String {
        let mut said = String::new();
        for step in steps.split(',').map(str::trim).filter(|step| !step.is_empty()) {
            if let Some(line) = step.strip_prefix('`').and_then(|step| step.strip_suffix('`')) {
                said = self.request(line);
                continue;
            }
            let controller = &mut self.controller;
            match step {
                "protective stop" => controller.protective_stop("test"),
                "emergency stop pressed" => controller.emergency_stop(true),
                "emergency stop released" => controller.emergency_stop(false),
                "safeguard opens" => {
                    controller.safeguard_stop(true);
                }
                "safeguard closes" => {
                    controller.safeguard_stop(false);
                }
                "safety fault" => controller.safety_fault(),
                "reduced mode" => controller.show_safety(Some(2)),
                "normal mode" => controller.show_safety(None),
                "local control" => controller.core.modes.set_remote(false),
                "remote control" => controller.core.modes.set_remote(true),
                "new connection" => self.switches = controller.core.modes.switches(),
                wait => {
                    let seconds: f64 = wait.strip_suffix(" s").and_then(|s| s.parse().ok()).expect(wait);
                    (0..(seconds * 500.0) as u32).for_each(|_| controller.frame());
                }
            }
        }
        said
    }

    /// Robot mode, safety mode and program state in the dashboard's words.
    fn seen(&mut self) -> [String; 3] {
        let word = |text: String| text.split(' ').next_back().unwrap_or_default().to_owned();
        let program = self.request("programState").split(' ').next().unwrap_or_default().to_owned();
        [word(self.request("robotmode")), word(self.request("safetymode")), program]
    }
}

fn state(name: &str) -> ([String; 3], &'static str) {
    let (name, program) = name.split_once(", ").map_or((name, None), |(name, program)| (name, Some(program)));
    let rows = table("state");
    let row = rows.iter().find(|row| row[0] == name).unwrap_or_else(|| panic!("there is no state {name:?}"));
    ([row[1], row[2], program.unwrap_or(row[3])].map(str::to_owned), row[4])
}

#[test]
fn every_state_is_reached_by_its_steps() {
    for row in table("state") {
        let mut player = Player::new();
        player.play(row[4]);
        assert_eq!(player.seen(), state(row[0]).0, "{row:?}");
        assert_eq!(player.controller.core.modes.remote(), row[0] != "local");
    }
}

#[test]
fn every_transition_leads_where_the_table_says() {
    for row in table("in state") {
        let mut player = Player::new();
        player.play(state(row[0]).1);
        let said = player.play(row[1]);
        assert_eq!(said, row[2], "{row:?}");
        assert_eq!(player.seen(), state(row[3]).0, "{row:?}");
    }
}

#[test]
fn every_command_answers_as_listed() {
    let mut player = Player::new();
    player.play(state("ready").1);
    let mut parsed = Vec::new();
    for row in table("command") {
        let line = row[0].trim_matches('`');
        assert_eq!(player.request(line), row[1], "{row:?}");
        let mut local = Player::new();
        local.controller.core.modes.set_remote(false);
        local.switches = 1;
        assert_eq!(local.request(line) == NOT_ALLOWED_TEXT, row[2] == "refused", "{row:?} in local mode");
        parsed.push(std::mem::discriminant(&Command::parse(line)));
    }
    parsed.dedup();
    assert!(parsed.len() >= 37, "the table has lost commands");
}

#[test]
fn a_controller_without_remote_control_takes_commands_and_has_no_switch() {
    let mut player = Player::new();
    player.controller.core.modes = Modes::new(false, Control::NotEnabled);
    assert_eq!(player.request("is in remote control"), "false");
    assert_eq!(player.play("`brake release`, 2 s, `load work.urp`, `play`"), "Starting program");
    assert_eq!(player.play("local control, `stop`"), "Stopped");
    assert_eq!(player.request("is in remote control"), "false");
}

#[test]
fn outputs_that_do_not_follow_the_simulation_are_listed() {
    let constants: String = table("always the same").iter().map(|row| row[0]).collect::<Vec<_>>().join(",");
    let zeros = PAGE.split("Always zero:").nth(1).unwrap();
    for (name, _) in OUTPUTS {
        let quoted = format!("`{name}`");
        let listed = (constants.contains(&quoted), zeros.contains(&quoted));
        let expected = match grade(name).unwrap() {
            Grade::Computed => (false, false),
            Grade::Constant => (true, false),
            Grade::Zero => (false, true),
        };
        assert_eq!(listed, expected, "{name}");
    }
}
