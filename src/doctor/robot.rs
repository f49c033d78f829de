//! The controller: addresses, services, who it is, what its modes are, who holds the registers, how steadily
//! its states come.
//!
//! In: [`RobotFacts`]. Out: lines. Pure.

use crate::doctor::{Area, Line};
use cell_machine::device::robot_types::{InputsTaken, Link, RobotState};
use cell_machine::device::software::{missing, too_old, version_of};
use cell_machine::stillness::{STILL_RAD, Sway};
use cell_machine::supervisor::safety_words::{mode_words, safety_hint, safety_words};
use cell_values::time::Duration;
use cell_values::units::mm_from_m;
use nalgebra::{Isometry3, Vector3};
use ur_arm::kinematics::{DhParameters, model_of};
use ur_arm::links::{farthest_apart, misfits};
use ur_arm::pose::isometry_from_ur_pose;
use ur_wire::enumerations::{RobotMode, SafetyMode};

/// Why a service gave no answer.
#[derive(Clone, Debug, PartialEq)]
pub enum LinkFault {
    /// The name has no address.
    NoAddress(String),
    /// The host refuses the connection: it is there, the service is not.
    Refused,
    /// Nothing came back.
    Silent(String),
    /// What came is not what this service says.
    Broken(String),
}

impl LinkFault {
    /// What was found.
    pub fn text(&self) -> String {
        match self {
            LinkFault::NoAddress(cause) => format!("no address: {cause}"),
            LinkFault::Refused => "the host refuses the connection".to_string(),
            LinkFault::Silent(cause) | LinkFault::Broken(cause) => cause.clone(),
        }
    }
}

/// What the dashboard server says.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DashboardFacts {
    /// As the controller writes it.
    pub version: Option<String>,
    /// Serial number.
    pub serial: Option<String>,
    /// Model.
    pub model: Option<String>,
    /// The pendant is in remote control.
    pub remote_control: Option<bool>,
    /// Mode of the arm.
    pub robot_mode: Option<RobotMode>,
    /// Mode of the safety system.
    pub safety_mode: Option<SafetyMode>,
    /// Longest answer.
    pub slowest: Duration,
}

/// What RTDE says.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RtdeFacts {
    /// Input registers that another client holds.
    pub taken: Option<InputsTaken>,
    /// The last state.
    pub state: Option<RobotState>,
    /// Packages that came while watched.
    pub packages: u32,
    /// Packages that should have come and did not.
    pub lost: u32,
    /// Longest time between two.
    pub longest_gap: Duration,
    /// The joint that moved most within the time in which the arm has to rest for a picture.
    pub sway: Sway,
    /// What the controller said in words.
    pub messages: Vec<String>,
}

/// What the primary interface says.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PrimaryFacts {
    /// The calibrated arm.
    pub dh: Option<DhParameters>,
    /// Checksum of the kinematics, hex, as in calibration files.
    pub checksum: String,
    /// Checksum of the safety configuration, where the controller sends it.
    pub safety_checksum: Option<u32>,
}

/// The empty gripper, as the configuration has it.
#[derive(Clone, Debug, PartialEq)]
pub struct ToolFacts {
    /// kg.
    pub mass_kg: f64,
    /// In the flange frame, m.
    pub centre_of_gravity_m: [f64; 3],
    /// Tool centre point.
    pub flange_from_tool: Isometry3<f64>,
}

/// All of it.
#[derive(Clone, Debug)]
pub struct RobotFacts {
    /// Name or address from the configuration.
    pub host: String,
    /// Port 29999.
    pub dashboard: Result<DashboardFacts, LinkFault>,
    /// Port 30004.
    pub rtde: Result<RtdeFacts, LinkFault>,
    /// Port 30001.
    pub primary: Result<PrimaryFacts, LinkFault>,
    /// What the installation should say of the tool.
    pub tool: ToolFacts,
    /// A celld runs on the state folder, and holds the registers.
    pub daemon: bool,
    /// The configuration is one of a simulation.
    pub simulated: bool,
}

/// States come every 8 ms; from here on the stop for a silent controller is near (100 ms).
const GAP_NOTED: Duration = Duration::from_millis(40);
/// From here on a state counts as stale.
const GAP_STALE: Duration = Duration::from_millis(100);
/// Payload and TCP of the installation may differ so much from the configuration: 0.1 kg is noticeable in
/// freedrive, the rest is what people measure to.
const MASS_OFF_KG: f64 = 0.1;
const CENTRE_OFF_M: f64 = 0.01;
const TCP_OFF_M: f64 = 0.001;
const TCP_OFF_RAD: f64 = 0.01;
/// Published calibrations: links up to 8 mm from nominal ones.
const UNUSUAL_DEVIATION_M: f64 = 0.02;
/// A dashboard slower than this makes remote control look outdated.
const SLOW_ANSWER: Duration = Duration::from_millis(500);

fn ok(item: &'static str, found: impl Into<String>) -> Line {
    Line::ok(Area::Robot, item, found)
}

fn note(item: &'static str, found: impl Into<String>, hint: impl Into<String>) -> Line {
    Line::note(Area::Robot, item, found, hint)
}

fn problem(item: &'static str, found: impl Into<String>, hint: impl Into<String>) -> Line {
    Line::problem(Area::Robot, item, found, hint)
}

impl RobotFacts {
    /// The lines.
    pub fn lines(&self) -> Vec<Line> {
        let mut lines = vec![
            self.service("dashboard", 29999, self.dashboard.as_ref().err(), "Dashboard Server"),
            self.service("RTDE", 30004, self.rtde.as_ref().err(), "Real-Time Data Exchange (RTDE)"),
            self.service("primary", 30001, self.primary.as_ref().err(), "Primary Client Interface"),
        ];
        if let Ok(dashboard) = &self.dashboard {
            lines.extend(self.dashboard_lines(dashboard));
        }
        if let Ok(rtde) = &self.rtde {
            lines.extend(self.rtde_lines(rtde));
        }
        if let Ok(primary) = &self.primary {
            lines.push(kinematics_line(primary));
        }
        lines
    }

    /// The first link that is down.
    pub fn link_down(&self) -> Option<Link> {
        if self.rtde.is_err() {
            Some(Link::Rtde)
        } else if self.dashboard.is_err() {
            Some(Link::Dashboard)
        } else {
            self.primary.is_err().then_some(Link::Primary)
        }
    }

    fn service(&self, item: &'static str, port: u16, fault: Option<&LinkFault>, name: &str) -> Line {
        let Some(fault) = fault else { return ok(item, format!("{}:{port} answers", self.host)) };
        let found = format!("{}:{port}: {}", self.host, fault.text());
        let hint = match fault {
            LinkFault::NoAddress(_) => {
                "correct `devices.robot.host` in the configuration, or write the address itself".to_string()
            }
            LinkFault::Refused if self.simulated => "start `celld sim`".to_string(),
            LinkFault::Refused => {
                let x = match port {
                    29999 => "; PolyScope X has no dashboard server, which celld needs",
                    _ => "",
                };
                format!(
                    "the controller boots, or the service is off: on the pendant under Settings, Security, \
                     Services, enable \"{name}\"{x}"
                )
            }
            LinkFault::Silent(_) => format!(
                "see that the controller is on, its cable plugged in, and this computer in its subnet: \
                 `ping {}`; a firewall may drop port {port}",
                self.host
            ),
            LinkFault::Broken(_) => {
                "something else listens there, or the controller's software is too old or too new for celld"
                    .to_string()
            }
        };
        problem(item, found, hint)
    }

    fn dashboard_lines(&self, dashboard: &DashboardFacts) -> Vec<Line> {
        let or_unknown = |text: &Option<String>| text.clone().unwrap_or_else(|| "unknown".to_string());
        let identity = format!(
            "{}, serial number {}, {}",
            or_unknown(&dashboard.model),
            or_unknown(&dashboard.serial),
            or_unknown(&dashboard.version)
        );
        let mut lines = vec![ok("identity", identity)];
        lines.extend(dashboard.version.as_deref().and_then(software_line));
        lines.push(match dashboard.remote_control {
            Some(true) => ok("remote control", "on"),
            Some(false) => problem(
                "remote control",
                "off: the pendant is in local control",
                "enable it under Settings, System, Remote Control; then switch the pendant from Local to \
                 Remote",
            ),
            None => problem(
                "remote control",
                "the controller does not say",
                "PolyScope 5.6 or later is needed: CB-Series controllers have no remote control mode",
            ),
        });
        if dashboard.slowest > SLOW_ANSWER {
            let found = format!("its slowest answer took {:.0} ms", dashboard.slowest.as_secs_f64() * 1e3);
            lines.push(note("dashboard", found, "see what else talks to the dashboard or fills the network"));
        }
        lines.extend(dashboard.safety_mode.map(safety_line));
        lines.extend(dashboard.robot_mode.map(arm_line));
        lines
    }

    fn rtde_lines(&self, rtde: &RtdeFacts) -> Vec<Line> {
        let mut lines = vec![self.claim(rtde)];
        if let Some(state) = &rtde.state {
            lines.push(stream_line(rtde));
            lines.extend(state_lines(state));
            // While celld runs, its program has set them.
            lines.extend((!self.daemon).then(|| self.installation(state)));
        }
        if rtde.packages > 0 {
            lines.push(rest_line(rtde.sway));
        }
        for message in &rtde.messages {
            lines.push(note("RTDE", format!("the controller says: {message}"), ""));
        }
        lines
    }

    /// What the controller believes of the tool: it counts for jogging and freedrive, and until a program
    /// has set something else.
    fn installation(&self, state: &RobotState) -> Line {
        let (mass, [x, y, z]) = (state.payload, state.payload_cog.map(mm_from_m));
        let tcp = isometry_from_ur_pose(state.tcp_offset);
        let at = tcp.translation.vector.map(mm_from_m);
        let found = format!(
            "payload {mass:.2} kg, centre of gravity {x:.0}, {y:.0}, {z:.0} mm; TCP {:.0}, {:.0}, {:.0} mm",
            at.x, at.y, at.z
        );
        let ToolFacts { mass_kg, centre_of_gravity_m, flange_from_tool } = &self.tool;
        let centre_off = (Vector3::from(state.payload_cog) - Vector3::from(*centre_of_gravity_m)).norm();
        let tcp_off = (tcp.translation.vector - flange_from_tool.translation.vector).norm();
        let turned = tcp.rotation.angle_to(&flange_from_tool.rotation);
        if (mass - mass_kg).abs() <= MASS_OFF_KG
            && centre_off <= CENTRE_OFF_M
            && tcp_off <= TCP_OFF_M
            && turned <= TCP_OFF_RAD
        {
            return ok("installation", found);
        }
        let [x, y, z] = centre_of_gravity_m.map(mm_from_m);
        let at = flange_from_tool.translation.vector.map(mm_from_m);
        let found = format!(
            "{found}; the configuration has {mass_kg:.2} kg, {x:.0}, {y:.0}, {z:.0} mm; {:.0}, {:.0}, {:.0} mm",
            at.x, at.y, at.z
        );
        let hint = "once the gripper is mounted, enter the configured values under Installation, General: Payload and TCP. \
                    With a wrong payload the arm may sink in freedrive and stop. An ended program may also have left \
                    its own values";
        note("installation", found, hint)
    }

    /// Who holds the input registers.
    fn claim(&self, rtde: &RtdeFacts) -> Line {
        match (&rtde.taken, self.daemon) {
            (None, _) => ok("registers", "the input registers that celld writes are free"),
            (_, true) => note(
                "registers",
                "celld itself holds them: it runs on this state folder",
                "end it to see more; `celld status` says what it does",
            ),
            (Some(taken), false) => problem(
                "registers",
                taken.to_string(),
                "end it, on whichever computer it runs, or EtherNet/IP and PROFINET in the installation; a \
                 client that has crashed holds them for some seconds more",
            ),
        }
    }
}

fn stream_line(rtde: &RtdeFacts) -> Line {
    let gap = rtde.longest_gap;
    let found = format!(
        "{} states in a row, {} lost, longest gap {:.1} ms (8 ms is regular)",
        rtde.packages,
        rtde.lost,
        gap.as_secs_f64() * 1e3
    );
    let hint = "connect the controller by a cable of its own, not over wireless or a busy switch; see the \
                lines on this computer";
    if gap >= GAP_STALE {
        problem("states", found, hint)
    } else if gap >= GAP_NOTED || rtde.lost > 0 {
        note("states", found, hint)
    } else {
        ok("states", found)
    }
}

fn rest_line(sway: Sway) -> Line {
    if sway.by_rad <= STILL_RAD {
        return ok("rest", format!("at rest: {sway}"));
    }
    let hint = "wait until the arm has stopped; if it shakes at rest, check its mounting and the payload in its \
                installation: celld takes no picture until it rests";
    problem("rest", format!("not at rest: {sway}"), hint)
}

fn safety_line(mode: SafetyMode) -> Line {
    if mode.allows_motion() {
        return ok("safety", format!("mode {mode}"));
    }
    problem("safety", safety_words(mode), safety_hint(mode))
}

/// What the controller's software lacks of what celld uses.
fn software_line(text: &str) -> Option<Line> {
    let version @ [major, minor] = version_of(text)?;
    if let Some(fault) = too_old(version) {
        return Some(problem("software", fault, "update the controller's software"));
    }
    let lacks: Vec<String> = missing(version)
        .map(|feature| format!("no {} (from {}.{})", feature.name, feature.since[0], feature.since[1]))
        .collect();
    (!lacks.is_empty()).then(|| {
        let found = format!("{major}.{minor}: {}; celld works without it", lacks.join(", "));
        note("software", found, "an update of the controller's software brings it")
    })
}

fn arm_line(mode: RobotMode) -> Line {
    match mode {
        RobotMode::Running => ok("arm", "powered, brakes released"),
        RobotMode::PowerOff | RobotMode::Idle => {
            ok("arm", "off; `celld arm` powers it and releases the brakes")
        }
        _ => problem("arm", mode_words(mode), "look at the pendant for what it waits for"),
    }
}

fn state_lines(state: &RobotState) -> Vec<Line> {
    let mut lines = Vec::new();
    if state.guided {
        lines.push(problem("arm", "guided by hand (freedrive)", "let go of the freedrive button"));
    }
    if state.target_speed_fraction < 1.0 {
        let found = format!("the speed slider is at {:.0} %", 100.0 * state.target_speed_fraction);
        lines.push(note("speed", found, "the arm moves that much slower; deadlines allow for it"));
    }
    lines
}

fn kinematics_line(primary: &PrimaryFacts) -> Line {
    let Some(dh) = &primary.dh else {
        return problem(
            "kinematics",
            "the controller has not sent its calibrated kinematics",
            "restart the controller; they come with each connection to the primary interface",
        );
    };
    let model = model_of(dh);
    let found = format!("calibrated {} (checksum {})", model.name, primary.checksum);
    if *dh == model.dh {
        let hint = "fine for a simulated arm; a real one whose calibration is missing misses by millimetres: \
                    request its calibration file from the vendor";
        return note("kinematics", format!("those of a nominal {}", model.name), hint);
    }
    let apart_m = farthest_apart(dh, &model.dh);
    let wider_m = misfits(dh, &model.dh).into_iter().max_by(f64::total_cmp).unwrap_or_default();
    let found = format!(
        "{found}; links up to {:.1} mm from those of a nominal arm; the bodies that are checked follow them, up to {:.1} mm \
         wider",
        mm_from_m(apart_m),
        mm_from_m(wider_m)
    );
    if apart_m.is_nan() || apart_m > UNUSUAL_DEVIATION_M {
        let hint = "far beyond factory tolerance: ask the vendor whether the calibration belongs to this arm. Paths \
                    have less room, clearances are kept";
        return note("kinematics", found, hint);
    }
    ok("kinematics", found)
}
