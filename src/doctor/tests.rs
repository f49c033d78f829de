//! Every line of the sheet from facts alone: what is found, and what is said to be done about it.

use super::camera::{CameraFacts, CameraProblem, PictureFacts, References};
use super::computer::ComputerFacts;
use super::gripper::GripperFacts;
use super::robot::{DashboardFacts, LinkFault, PrimaryFacts, RobotFacts, RtdeFacts, ToolFacts};
use super::*;
use cell_machine::device::gripper_types::{Identity, ModbusFailure};
use cell_machine::device::registers::ProgramStatus;
use cell_machine::device::robot_types::{InputsTaken, RobotState};
use cell_machine::orders::ConfirmedGripper;
use cell_machine::stillness::Sway;
use cell_values::time::{Duration, Timestamp};
use cell_values::units::Joints;
use cell_vision::observe::reference::{DriftLimits, ReferenceCheck, ReferenceError};
use nalgebra::Isometry3;
use ur_arm::kinematics::DhParameters;
use ur_wire::enumerations::{RobotMode, RuntimeState, SafetyMode};

fn robot() -> RobotFacts {
    let mut dh = DhParameters::UR5E;
    dh.a[1] += 1e-4;
    RobotFacts {
        host: "10.0.0.2".into(),
        dashboard: Ok(DashboardFacts {
            version: Some("URSoftware 5.12.0".into()),
            serial: Some("20235500001".into()),
            model: Some("UR5".into()),
            remote_control: Some(true),
            robot_mode: Some(RobotMode::PowerOff),
            safety_mode: Some(SafetyMode::Normal),
            slowest: Duration::from_millis(3),
        }),
        rtde: Ok(RtdeFacts { packages: 250, longest_gap: Duration::from_millis(9), ..RtdeFacts::default() }),
        primary: Ok(PrimaryFacts { dh: Some(dh), checksum: "ab".into(), safety_checksum: None }),
        tool: ToolFacts {
            mass_kg: 1.72,
            centre_of_gravity_m: [0.0, -0.005, 0.065],
            flange_from_tool: Isometry3::translation(0.0, 0.0, 0.2),
        },
        daemon: false,
        simulated: false,
    }
}

/// SG12.
const SERIAL: [u16; 16] = [0x5347, 0x3132, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];

fn gripper() -> GripperFacts {
    GripperFacts {
        address: "10.0.0.3:502, unit 65".into(),
        vacuum: Ok([0.0, 0.01]),
        control: Some([0, 0]),
        identity: Ok(Identity { product: Some(0x11), firmware: Some([1, 2]), serial: Some(SERIAL) }),
        service: None,
        confirmed: ConfirmedGripper::Serial("SG12".into()),
        daemon: false,
    }
}

fn camera() -> CameraFacts {
    let picture = PictureFacts {
        source: "camera".into(),
        serial: Some("sim-d405".into()),
        size: [1280, 720],
        seconds: 0.4,
        depth: true,
        live: true,
    };
    CameraFacts { picture: Ok(picture), depth_wanted: true, references: Ok(references(4, 2e-4)) }
}

fn references(count: u32, residual_rms_m: f64) -> References {
    let error = |id| ReferenceError { id, error_m: [0.0; 2], error_rad: 0.0, views: 1 };
    let check = ReferenceCheck {
        markers: (0..count).map(error).collect(),
        residual_rms_m,
        residual_max_m: residual_rms_m,
        shift_m: [0.0; 2],
        turn_rad: 0.0,
        looks: Vec::new(),
    };
    let limits = DriftLimits { residual_m: 2e-3, shift_m: 1e-3, turn_rad: 0.01 };
    References { surveyed: 12, check: Some(check), limits }
}

fn computer() -> ComputerFacts {
    ComputerFacts {
        unix_s: 1.8e9,
        clock_follows: Some(true),
        state: "/var/lib/celld".into(),
        free_bytes: Some(80 << 30),
        write: Ok(Duration::from_millis(4)),
        may_go_first: true,
        cores: 4,
        latest_wake: Duration::from_millis(1),
    }
}

/// That exactly one line is `verdict`, that it is about `item`, and says these words or the hint does.
#[track_caller]
fn only(lines: &[Line], verdict: Verdict, item: &str, words: &str) {
    let found: Vec<&Line> = lines.iter().filter(|line| line.verdict > Verdict::Ok).collect();
    let [line] = found.as_slice() else { panic!("one line, not {found:#?}") };
    assert_eq!((line.verdict, line.item), (verdict, item), "{line:?}");
    assert!(format!("{} {}", line.found, line.hint).contains(words), "{words}: {line:?}");
}

#[test]
fn a_sound_cell_has_nothing_missing() {
    let mut lines = [robot().lines(), gripper().lines(), camera().lines(), computer().lines()].concat();
    lines.push(arming(Ok(())));
    let sheet = Sheet::new("cell.yaml".into(), 1.8e9, lines);
    assert!(sheet.text().lines().all(|line| line.chars().count() <= COLUMNS), "{}", sheet.text());
    assert!(sheet.ready && sheet.count(Verdict::Note) == 0, "{}", sheet.text());
    assert!(
        sheet
            .text()
            .ends_with("nothing is missing (0 notes); `celld run`, then `celld arm` lets the arm move\n")
    );
}

/// What one line then says, and what spoils the facts.
type Case<F> = (Verdict, &'static str, &'static str, fn(&mut F));

#[test]
fn each_fault_of_the_controller_has_one_line() {
    use Verdict::{Note, Problem};
    fn dashboard(facts: &mut RobotFacts) -> &mut DashboardFacts {
        facts.dashboard.as_mut().expect("a dashboard")
    }
    fn rtde(facts: &mut RobotFacts) -> &mut RtdeFacts {
        facts.rtde.as_mut().expect("an RTDE link")
    }
    let cases: [Case<RobotFacts>; 19] = [
        (Problem, "software", "celld needs 5.6", |f| dashboard(f).version = Some("URSoftware 5.5.1".into())),
        (Note, "software", "`set_target_payload`", |f| {
            dashboard(f).version = Some("URSoftware 5.9.4".into());
        }),
        (Problem, "dashboard", "Dashboard Server", |f| f.dashboard = Err(LinkFault::Refused)),
        (Problem, "dashboard", "`celld sim`", |f| {
            (f.dashboard, f.simulated) = (Err(LinkFault::Refused), true);
        }),
        (Problem, "RTDE", "`ping 10.0.0.2`", |f| f.rtde = Err(LinkFault::Silent("no answer".into()))),
        (Problem, "primary", "devices.robot.host", |f| f.primary = Err(LinkFault::NoAddress("gone".into()))),
        (Problem, "RTDE", "too old or too new", |f| f.rtde = Err(LinkFault::Broken("type 9".into()))),
        (Problem, "remote control", "from Local to Remote", |f| dashboard(f).remote_control = Some(false)),
        (Problem, "remote control", "CB-Series", |f| dashboard(f).remote_control = None),
        (Problem, "safety", "emergency stop", |f| {
            dashboard(f).safety_mode = Some(SafetyMode::RobotEmergencyStop);
        }),
        (Problem, "arm", "pendant", |f| dashboard(f).robot_mode = Some(RobotMode::Booting)),
        (Problem, "rest", "shakes", |f| rtde(f).sway = Sway { joint: 3, by_rad: 3e-4 }),
        (Note, "dashboard", "800 ms", |f| dashboard(f).slowest = Duration::from_millis(800)),
        (Problem, "registers", "input_int_register_24", |f| {
            rtde(f).taken = Some(taken());
        }),
        (Note, "registers", "celld itself", |f| {
            rtde(f).taken = Some(taken());
            f.daemon = true;
        }),
        (Note, "RTDE", "says: careful", |f| rtde(f).messages = vec!["careful".into()]),
        (Problem, "kinematics", "has not sent", |f| f.primary = Ok(PrimaryFacts::default())),
        (Note, "kinematics", "mm from those of a nominal arm", |f| {
            f.primary.as_mut().expect("a primary link").dh.as_mut().expect("kinematics").a[1] += 0.03;
        }),
        (Note, "kinematics", "nominal UR5e", |f| {
            f.primary.as_mut().expect("a primary link").dh = Some(DhParameters::UR5E);
        }),
    ];
    for (verdict, item, words, spoil) in cases {
        let mut facts = robot();
        spoil(&mut facts);
        only(&facts.lines(), verdict, item, words);
    }
}

#[test]
fn each_fault_of_the_gripper_has_one_line() {
    use Verdict::{Note, Problem};
    let cases: [Case<GripperFacts>; 15] = [
        (Problem, "Modbus", "end the other one", |f| f.vacuum = Err(ModbusFailure::Taken)),
        (Problem, "Modbus", "may still be starting", |f| f.vacuum = Err(ModbusFailure::Refused)),
        (Problem, "identity", "another gripper", |f| f.confirmed = ConfirmedGripper::Serial("SG13".into())),
        (Problem, "Modbus", "check the unit", |f| f.vacuum = Err(ModbusFailure::Unserved)),
        (Problem, "identity", "reports a serial number", |f| f.confirmed = ConfirmedGripper::AtAddress),
        (Problem, "identity", "could not be read", |f| f.identity = Err(ModbusFailure::Timeout)),
        (Problem, "Modbus", "unit", |f| f.vacuum = Err(ModbusFailure::Connection("refused".into()))),
        (Problem, "Modbus", "firmware", |f| f.vacuum = Err(ModbusFailure::Exception(2))),
        (Problem, "product", "0x20", |f| {
            f.identity = Ok(Identity { product: Some(0x20), ..f.identity.clone().expect("a VGC10") });
        }),
        (Problem, "vacuum", "celld recover", |f| f.vacuum = Ok([0.4, 0.0])),
        (Problem, "vacuum", "NaN", |f| f.vacuum = Ok([f64::NAN, 0.0])),
        (Problem, "identity", "celld confirm-gripper", |f| f.confirmed = ConfirmedGripper::None),
        (Note, "other master", "channel B", |f| f.control = Some([0, 0x0128])),
        (Note, "other master", "URCap", |f| f.service = Some(("10.0.0.2".into(), None))),
        (Note, "other master", "URCap", |f| f.service = Some(("10.0.0.2".into(), Some(true)))),
    ];
    for (verdict, item, words, spoil) in cases {
        let mut facts = gripper();
        spoil(&mut facts);
        only(&facts.lines(), verdict, item, words);
    }
    let product = |facts: GripperFacts| {
        facts.lines().into_iter().find(|line| line.item == "product").map(|line| line.found)
    };
    assert_eq!(product(gripper()).as_deref(), Some("VGC10, firmware 1.2, serial number SG12"));
    let older = GripperFacts { identity: Ok(Identity::default()), ..gripper() };
    assert_eq!(product(older), None, "older firmware");
    let other = GripperFacts { service: Some(("h".into(), Some(false))), ..gripper() };
    assert!(other.lines().iter().any(|line| line.item == "identity" && line.verdict == Problem));
    let commanded = GripperFacts { control: Some([0x0128, 0]), daemon: true, ..gripper() };
    assert!(commanded.lines().iter().all(|line| line.verdict == Verdict::Ok), "that was celld");
}

#[test]
fn each_fault_of_the_camera_has_one_line() {
    use Verdict::{Note, Problem};
    let cases: [Case<CameraFacts>; 7] = [
        (Problem, "picture", "plug it in", |f| {
            f.picture = Err(CameraProblem { message: "unplugged".into(), hint: "plug it in".into() });
        }),
        (Problem, "picture", "recording", |f| f.picture.as_mut().expect("a picture").live = false),
        (Problem, "depth", "USB 3", |f| f.picture.as_mut().expect("a picture").depth = false),
        (Note, "depth", "not configured", |f| f.depth_wanted = false),
        (Note, "drift", "the arm moves", |f| f.references = Err("the arm moves".into())),
        (Note, "drift", "2 of 12", |f| f.references = Ok(references(2, 0.0))),
        (Problem, "drift", "celld calibrate", |f| f.references = Ok(references(5, 4e-3))),
    ];
    for (verdict, item, words, spoil) in cases {
        let mut facts = camera();
        spoil(&mut facts);
        only(&facts.lines(), verdict, item, words);
    }
    let unknown = CameraFacts { references: Ok(references(5, f64::NAN)), ..camera() };
    only(&unknown.lines(), Problem, "drift", "celld calibrate");
}

#[test]
fn each_fault_of_the_computer_has_one_line() {
    use Verdict::{Note, Problem};
    let ms = Duration::from_millis;
    let cases: [(Verdict, &str, ComputerFacts); 11] = [
        (Problem, "clock", ComputerFacts { unix_s: 0.0, ..computer() }),
        (Note, "clock", ComputerFacts { clock_follows: Some(false), ..computer() }),
        (Note, "clock", ComputerFacts { clock_follows: None, ..computer() }),
        (Problem, "disk", ComputerFacts { free_bytes: Some(100 << 20), ..computer() }),
        (Note, "disk", ComputerFacts { free_bytes: Some(2 << 30), ..computer() }),
        (Problem, "disk writes", ComputerFacts { write: Err("read-only".into()), ..computer() }),
        (Problem, "disk writes", ComputerFacts { write: Ok(ms(900)), ..computer() }),
        (Note, "disk writes", ComputerFacts { write: Ok(ms(90)), ..computer() }),
        (Note, "priority", ComputerFacts { may_go_first: false, ..computer() }),
        (Note, "wake-ups", ComputerFacts { latest_wake: ms(20), ..computer() }),
        (Problem, "wake-ups", ComputerFacts { latest_wake: ms(80), ..computer() }),
    ];
    for (verdict, item, facts) in cases {
        only(&facts.lines(), verdict, item, "");
    }
}

#[test]
fn arming_is_answered_as_the_cell_would() {
    let refused = arming(Err(GateClosed::Local));
    assert!(refused.verdict == Verdict::Problem && refused.found.contains("remote control is off"));
    assert!(arming(Err(GateClosed::GripperUnconfirmed)).hint.contains("celld confirm-gripper"));
    assert_eq!(arming(Ok(())).verdict, Verdict::Ok);
}

#[test]
fn a_program_reads_the_same() {
    let lines = vec![arming(Err(GateClosed::Local)), Line::ok(Area::Files, "configuration", "sound")];
    let sheet = Sheet::new("cell.yaml".into(), 0.0, lines);
    let json = serde_json::to_value(&sheet).unwrap();
    assert_eq!(json["ready"], false);
    assert_eq!(
        (&json["lines"][0]["area"], &json["lines"][1]["verdict"]),
        (&"files".into(), &"problem".into())
    );
}

fn taken() -> InputsTaken {
    InputsTaken { names: vec!["input_int_register_24".into()], celld: None }
}

/// A robot that rests, with this payload and TCP.
fn state(payload: f64, payload_cog: [f64; 3], tcp_offset: [f64; 6]) -> RobotState {
    RobotState {
        received: Timestamp::ZERO,
        controller_time_s: 100.0,
        q: Joints([0.0, -1.5, 1.5, -1.5, -1.5, 0.0]),
        qd: [0.0; 6],
        tcp_pose: [0.0; 6],
        robot_mode: RobotMode::Running,
        safety_mode: SafetyMode::Normal,
        runtime_state: RuntimeState::Stopped,
        guided: false,
        speed_scaling: 1.0,
        target_speed_fraction: 1.0,
        payload,
        payload_cog,
        tcp_offset,
        nonce: 0,
        accepted: 0,
        finished: 0,
        program_status: ProgramStatus::Idle,
        heartbeat_echo: 0,
        remote_control: Some(true),
    }
}

#[test]
fn the_installation_has_the_tool_of_the_configuration() {
    let line = |payload: f64, centre: [f64; 3], tcp: [f64; 6], daemon: bool| {
        let mut facts = robot();
        facts.daemon = daemon;
        facts.rtde.as_mut().expect("a link").state = Some(state(payload, centre, tcp));
        facts.lines().into_iter().find(|line| line.item == "installation")
    };
    let (centre, tcp) = ([0.0, -0.005, 0.065], [0.0, 0.0, 0.2, 0.0, 0.0, 0.0]);
    let entered = line(1.7, centre, tcp, false).expect("a line");
    assert!(
        entered.verdict == Verdict::Ok && entered.found.contains("1.70 kg, centre of gravity 0, -5, 65 mm"),
        "{entered:?}"
    );
    for (payload, centre, tcp) in [
        (0.0, centre, tcp),
        (1.72, [0.0, 0.0, 0.04], tcp),
        (1.72, centre, [0.0, 0.0, 0.19, 0.0, 0.0, 0.0]),
        (1.72, centre, [0.0, 0.0, 0.2, 0.0, 0.0, 1.57]),
    ] {
        let other = line(payload, centre, tcp, false).expect("a line");
        assert!(
            other.verdict == Verdict::Note && other.found.contains("the configuration has 1.72 kg"),
            "{other:?}"
        );
    }
    assert_eq!(line(0.0, centre, tcp, true), None, "those of celld's program");
}
