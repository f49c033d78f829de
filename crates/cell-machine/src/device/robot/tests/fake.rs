//! A scripted controller: just enough of each port, with switches for what can go wrong. The on-robot
//! program is a few lines of Rust with the register protocol of hardware/ur5e/README.md; the real one is run
//! by the simulator.

use crate::device::robot_types::Link;
use cell_values::time::{Duration, Timestamp};
use std::collections::{BTreeMap, VecDeque};
use ur_wire::dashboard::{self, Command, LineSplitter};
use ur_wire::primary::Package;
use ur_wire::primary_arm::KinematicsData;
use ur_wire::primary_message::{Message, MessageBody, PROGRAM_STOPPED};
use ur_wire::primary_state::SubPackage;
use ur_wire::rtde::{ControllerVersion, Reply, Request, Splitter, Version};
use ur_wire::rtde_values::{Leftover, Offer, Recipe, Value};
use ur_wire::rtde_variables::{Register, input_type, output_type};

pub struct Fake {
    out: VecDeque<(Link, Vec<u8>)>,
    frames: Splitter,
    version: Version,
    lines: LineSplitter,
    primary_up: bool,
    output: Option<Recipe>,
    inputs: Vec<Recipe>,
    streaming: bool,
    pub registers: BTreeMap<Register, Value>,
    pub time_s: f64,
    pub q: [f64; 6],
    pub robot_mode: i32,
    pub safety_mode: i32,
    pub runtime_state: u32,
    pub speed_scaling: f64,
    pub payload: (f64, [f64; 3]),
    pub tcp: [f64; 6],
    /// Sequence numbers in the order they were taken, with opcodes and the time.
    pub taken: Vec<(i32, i32)>,
    /// And their options.
    pub options: Vec<i32>,
    pub heartbeats: Vec<Timestamp>,
    pub uploads: Vec<String>,
    pub dashboard_lines: Vec<String>,
    queue: VecDeque<(i32, i32, [f64; 6])>,
    busy_frames: u32,
    segment_from: [f64; 6],
    silent_frames: u32,
    /// The program that runs, by nonce.
    pub program: Option<i32>,
    // Switches.
    pub in_use: Vec<String>,
    pub not_found: Vec<String>,
    pub mute_rtde: bool,
    pub mute_dashboard: bool,
    pub mute_primary: bool,
    pub frozen_time: bool,
    pub nan_in_q: bool,
    /// Offset along each axis in the kinematics.
    pub link_m: f64,
    /// Sent in place of the true value.
    pub broken: Option<(&'static str, Value)>,
    pub remote: bool,
    pub answers: BTreeMap<String, String>,
    pub ignore_uploads: bool,
    pub read_only_uploads: u32,
    pub fail_uploads: bool,
    /// The program stops the arm and does not end.
    pub stays_after_its_stop: bool,
    pub deaf_program: bool,
    pub segment_frames: u32,
    pub wrong_payload: bool,
    /// Major and minor version of its software, as RTDE says it.
    pub software: [u32; 2],
}

impl Fake {
    pub fn new() -> Fake {
        Fake {
            out: VecDeque::new(),
            frames: Splitter::default(),
            version: Version::V1,
            lines: LineSplitter::default(),
            primary_up: false,
            output: None,
            inputs: Vec::new(),
            streaming: false,
            registers: BTreeMap::new(),
            time_s: 50.0,
            q: super::HOME.0,
            robot_mode: 7,
            safety_mode: 1,
            runtime_state: 1,
            speed_scaling: 1.0,
            payload: (0.0, [0.0; 3]),
            tcp: [0.0; 6],
            taken: Vec::new(),
            options: Vec::new(),
            heartbeats: Vec::new(),
            uploads: Vec::new(),
            dashboard_lines: Vec::new(),
            queue: VecDeque::new(),
            busy_frames: 0,
            segment_from: [0.0; 6],
            silent_frames: 0,
            program: None,
            in_use: Vec::new(),
            not_found: Vec::new(),
            mute_rtde: false,
            mute_dashboard: false,
            mute_primary: false,
            frozen_time: false,
            nan_in_q: false,
            link_m: 0.1625,
            broken: None,
            remote: true,
            answers: BTreeMap::new(),
            ignore_uploads: false,
            read_only_uploads: 0,
            fail_uploads: false,
            stays_after_its_stop: false,
            deaf_program: false,
            segment_frames: 50,
            wrong_payload: false,
            software: [5, 20],
        }
    }

    pub fn connected(&mut self, link: Link) {
        match link {
            Link::Rtde => {
                self.frames = Splitter::default();
                self.version = Version::V1;
                self.output = None;
                self.inputs.clear();
                self.streaming = false;
            }
            Link::Dashboard => {
                self.lines = LineSplitter::default();
                if !self.mute_dashboard {
                    self.send(Link::Dashboard, format!("{}\n", dashboard::GREETING).into_bytes());
                }
            }
            Link::Primary => {
                self.primary_up = true;
                self.message(MessageBody::Text("hello".into()));
                let kinematics =
                    KinematicsData { checksum: [9; 6], d: [self.link_m; 6], ..Default::default() };
                let package = Package::RobotState(vec![SubPackage::Kinematics(kinematics)]);
                self.send(Link::Primary, package.encode());
            }
        }
    }

    pub fn disconnected(&mut self, link: Link) {
        match link {
            Link::Rtde => self.streaming = false,
            Link::Dashboard => {}
            Link::Primary => self.primary_up = false,
        }
    }

    pub fn send(&mut self, link: Link, bytes: Vec<u8>) {
        self.out.push_back((link, bytes));
    }

    pub fn message(&mut self, body: MessageBody) {
        if self.primary_up && !self.mute_primary {
            let package = Package::Message(Message { timestamp: 0, source: -2, body });
            self.send(Link::Primary, package.encode());
        }
    }

    pub fn poll_transmit(&mut self) -> Option<(Link, Vec<u8>)> {
        self.out.pop_front()
    }

    pub fn received(&mut self, now: Timestamp, link: Link, bytes: &[u8]) {
        match link {
            Link::Rtde => {
                self.frames.push(bytes);
                while let Some(frame) = self.frames.next_frame().unwrap() {
                    let request = Request::decode(self.version, &frame).unwrap();
                    if !self.mute_rtde {
                        self.rtde(now, request);
                    }
                }
            }
            Link::Dashboard => {
                self.lines.push(bytes);
                while let Some(line) = self.lines.next_line().unwrap() {
                    self.dashboard(&line);
                }
            }
            Link::Primary => self.upload(String::from_utf8(bytes.to_vec()).unwrap()),
        }
    }

    fn rtde(&mut self, now: Timestamp, request: Request) {
        let reply = match request {
            Request::ProtocolVersion(wanted) => {
                assert_eq!(wanted, 2);
                let reply = Reply::ProtocolVersion(true).encode(self.version);
                self.version = Version::V2;
                return self.send(Link::Rtde, reply);
            }
            Request::ControllerVersion => {
                let [major, minor] = self.software;
                Reply::ControllerVersion(ControllerVersion { major, minor, bugfix: 0, build: 1 })
            }
            Request::Text(_) => return,
            Request::SetupOutputs { names, .. } => {
                let offers = self.offers(&names, output_type);
                let fields = names.into_iter().filter_map(|name| output_type(&name).map(|kind| (name, kind)));
                self.output = Some(Recipe { id: 1, fields: fields.collect() });
                Reply::SetupOutputs { recipe: 1, offers }
            }
            Request::SetupInputs { names } => {
                let offers = self.offers(&names, input_type);
                let good = offers.iter().all(|offer| matches!(offer, Offer::Type(_)));
                let recipe = if good { self.inputs.len() as u8 + 1 } else { 0 };
                if good {
                    let fields =
                        names.into_iter().filter_map(|name| input_type(&name).map(|kind| (name, kind)));
                    self.inputs.push(Recipe { id: recipe, fields: fields.collect() });
                }
                Reply::SetupInputs { recipe, offers }
            }
            Request::Start => {
                self.streaming = true;
                Reply::Start(true)
            }
            Request::Pause => {
                self.streaming = false;
                Reply::Pause(true)
            }
            Request::Data { recipe, payload } => return self.inputs_written(now, recipe, &payload),
        };
        let bytes = reply.encode(self.version);
        self.send(Link::Rtde, bytes);
    }

    fn offers(
        &self,
        names: &[String],
        kind: fn(&str) -> Option<ur_wire::rtde_values::VariableType>,
    ) -> Vec<Offer> {
        let offer = |name: &String| {
            if self.in_use.contains(name) {
                Offer::InUse
            } else if self.not_found.contains(name) {
                Offer::NotFound
            } else {
                kind(name).map_or(Offer::NotFound, Offer::Type)
            }
        };
        names.iter().map(offer).collect()
    }

    fn inputs_written(&mut self, now: Timestamp, recipe: u8, payload: &[u8]) {
        let recipe = &self.inputs[usize::from(recipe) - 1];
        let values = recipe.decode(payload, Leftover::Refuse).unwrap();
        for ((name, _), value) in recipe.fields.iter().zip(values) {
            let register = Register::from_name(name).unwrap();
            if register == Register::InputInt(27) {
                self.heartbeats.push(now);
            }
            self.registers.insert(register, value);
        }
    }

    fn dashboard(&mut self, line: &str) {
        self.dashboard_lines.push(line.to_string());
        if self.mute_dashboard {
            return;
        }
        let scripted = self.answers.get(line).cloned();
        let command = Command::parse(line);
        let reply = scripted.unwrap_or_else(|| match command {
            Command::PolyscopeVersion => "URSoftware 5.20.0.1 (Jan 01 2025)".into(),
            Command::GetSerialNumber => "20235500001".into(),
            Command::GetRobotModel => "UR5".into(),
            Command::IsInRemoteControl => self.remote.to_string(),
            Command::RobotMode => "Robotmode: RUNNING".into(),
            Command::SafetyMode => "Safetymode: NORMAL".into(),
            Command::PowerOn => {
                self.robot_mode = 5;
                "Powering on".into()
            }
            Command::BrakeRelease => {
                self.robot_mode = 7;
                "Brake releasing".into()
            }
            Command::Stop => {
                self.end_program();
                self.runtime_state = 1;
                "Stopped".into()
            }
            other => dashboard::Reply::accepted(&other).line(&other).trim_end().to_string(),
        });
        self.send(Link::Dashboard, format!("{reply}\n").into_bytes());
    }

    fn upload(&mut self, text: String) {
        let nonce =
            text.strip_prefix("def celld_").and_then(|rest| rest.split('(').next()).unwrap().to_string();
        self.uploads.push(text);
        if self.read_only_uploads > 0 {
            self.read_only_uploads -= 1;
            let text = String::new();
            let body = MessageBody::Error { code: 210, argument: 0, level: 2, data_type: 0, data: 0, text };
            return self.message(body);
        }
        if self.ignore_uploads {
            return;
        }
        let name = format!("celld_{nonce}");
        if self.fail_uploads {
            self.message(MessageBody::RuntimeException { line: 3, column: 9, text: "no".into() });
            let title = PROGRAM_STOPPED.into();
            return self.message(MessageBody::Key { code: 0, argument: 0, title, text: name });
        }
        self.program = Some(nonce.parse().unwrap());
        self.runtime_state = 2;
        self.queue.clear();
        self.busy_frames = 0;
        self.silent_frames = 0;
        let sequence = self.int(Register::InputInt(24));
        for (number, value) in [(25, sequence), (26, sequence), (27, 0), (24, self.program.unwrap())] {
            self.set_out(number, value);
        }
    }

    pub fn end_program(&mut self) {
        if self.program.take().is_some() {
            self.set_out(24, 0);
        }
        self.runtime_state = 1;
        self.queue.clear();
    }

    fn int(&self, register: Register) -> i32 {
        match self.registers.get(&register) {
            Some(Value::Int32(value)) => *value,
            _ => 0,
        }
    }

    fn double(&self, number: u8) -> f64 {
        match self.registers.get(&Register::InputDouble(number)) {
            Some(Value::Double(value)) => *value,
            _ => 0.0,
        }
    }

    pub fn out_int(&self, number: u8) -> i32 {
        self.int(Register::OutputInt(number))
    }

    /// The opcode that the program finds in its next frame.
    pub fn opcode(&self) -> i32 {
        self.int(Register::InputInt(25))
    }

    /// What celld has written is gone.
    pub fn clear_inputs(&mut self) {
        self.registers.retain(|register, _| matches!(register, Register::OutputInt(_)));
    }

    pub fn set_out(&mut self, number: u8, value: i32) {
        self.registers.insert(Register::OutputInt(number), Value::Int32(value));
    }

    /// One control cycle.
    pub fn frame(&mut self, _now: Timestamp) {
        if !self.frozen_time {
            self.time_s += Duration::from_millis(2).as_secs_f64();
        }
        if self.program.is_some() && self.runtime_state == 2 && !self.deaf_program {
            self.program_frame();
        }
        if self.primary_up && !self.mute_primary && ((self.time_s * 500.0) as u64).is_multiple_of(50) {
            self.send(Link::Primary, Package::RobotState(Vec::new()).encode());
        }
        if self.streaming && !self.mute_rtde {
            self.send_state();
        }
    }

    fn program_frame(&mut self) {
        let beat = self.int(Register::InputInt(27));
        self.silent_frames = if beat == self.out_int(28) { self.silent_frames + 1 } else { 0 };
        self.set_out(28, beat);
        let (sequence, opcode) = (self.int(Register::InputInt(24)), self.int(Register::InputInt(25)));
        let accepted = self.out_int(25);
        if self.silent_frames >= 100 {
            self.set_out(27, 2);
            return self.end_program();
        }
        if sequence != accepted && opcode == 5 {
            self.queue.clear();
            self.take(sequence, opcode);
            self.set_out(27, 4);
            if !self.stays_after_its_stop {
                return self.end_program();
            }
        } else if sequence != accepted && opcode == 6 {
            self.take(sequence, opcode);
            return self.end_program();
        } else if sequence != accepted && self.out_int(27) < 2 {
            assert_eq!(sequence, accepted.wrapping_add(1), "commands come in order");
            assert!(self.queue.len() <= 8, "the queue holds 8 and the one under way");
            self.take(sequence, opcode);
            let arguments = std::array::from_fn(|i| self.double(24 + i as u8));
            self.queue.push_back((sequence, opcode, arguments));
            self.set_out(27, 1);
        }
        self.work();
    }

    fn take(&mut self, sequence: i32, opcode: i32) {
        self.set_out(25, sequence);
        self.taken.push((sequence, opcode));
        self.options.push(self.int(Register::InputInt(26)));
    }

    fn work(&mut self) {
        let Some(&(sequence, opcode, arguments)) = self.queue.front() else {
            if self.out_int(27) == 1 {
                self.set_out(27, 0);
            }
            return;
        };
        if self.busy_frames == 0 {
            self.segment_from = self.q;
        }
        self.busy_frames += 1;
        if opcode <= 2 && self.busy_frames < self.segment_frames {
            let share = f64::from(self.busy_frames) / f64::from(self.segment_frames);
            let from = self.segment_from;
            self.q = std::array::from_fn(|joint| from[joint] + share * (arguments[joint] - from[joint]));
            return;
        }
        self.busy_frames = 0;
        match opcode {
            1 | 2 => self.q = arguments,
            3 if !self.wrong_payload => {
                self.payload = (arguments[0], [arguments[1], arguments[2], arguments[3]]);
            }
            4 => self.tcp = arguments,
            _ => {}
        }
        self.queue.pop_front();
        self.set_out(26, sequence);
    }

    fn send_state(&mut self) {
        let Some(recipe) = self.output.clone() else { return };
        let mut q = self.q;
        if self.nan_in_q {
            q[2] = f64::NAN;
        }
        let value = |name: &str| match name {
            _ if self.broken.is_some_and(|(broken, _)| broken == name) => self.broken.unwrap().1,
            "timestamp" => Value::Double(self.time_s),
            "actual_q" => Value::Vector6D(q),
            "robot_mode" => Value::Int32(self.robot_mode),
            "safety_mode" => Value::Int32(self.safety_mode),
            "runtime_state" => Value::Uint32(self.runtime_state),
            "speed_scaling" => Value::Double(self.speed_scaling),
            "target_speed_fraction" => Value::Double(1.0),
            "payload" => Value::Double(self.payload.0),
            "payload_cog" => Value::Vector3D(self.payload.1),
            "tcp_offset" => Value::Vector6D(self.tcp),
            other => match Register::from_name(other) {
                Some(register) => Value::Int32(self.int(register)),
                None => output_type(other).unwrap().zero(),
            },
        };
        let values: Vec<Value> = recipe.fields.iter().map(|(name, _)| value(name)).collect();
        let payload = recipe.encode(&values).unwrap();
        let bytes = Reply::Data { recipe: recipe.id, payload }.encode(Version::V2);
        self.send(Link::Rtde, bytes);
    }
}
