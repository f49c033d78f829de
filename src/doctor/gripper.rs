//! The gripper: whether it answers, what hangs there, whether a person has confirmed it, who else commands
//! it.
//!
//! In: [`GripperFacts`]. Out: lines. Pure. The device gives out its product code, firmware and serial number
//! (Connectivity Guide), which do not prove that it hangs on this arm: that rests on a person, and on the
//! maker's own service where it runs (reference: ur-interfaces 7.3).

use crate::doctor::{Area, Line};
use cell_machine::device::gripper_types::{GripperFault, Identity, ModbusFailure, VG10, VGC10};
use cell_machine::orders::ConfirmedGripper;
use cell_machine::supervisor::gates::{self, GateClosed};

/// What was found at the gripper's address.
#[derive(Clone, Debug, PartialEq)]
pub struct GripperFacts {
    /// Host, port and unit.
    pub address: String,
    /// Relative vacuum of both channels, or why there is none.
    pub vacuum: Result<[f64; 2], ModbusFailure>,
    /// The two control registers, where they can be read: mode in the high byte, target in the low one.
    pub control: Option<[u16; 2]>,
    /// What it says of itself, or why that could not be read.
    pub identity: Result<Identity, ModbusFailure>,
    /// What the maker's service (XML-RPC, port 41414) says of a VGC10, where it answers, and at which host.
    pub service: Option<(String, Option<bool>)>,
    /// Which gripper a person has confirmed.
    pub confirmed: ConfirmedGripper,
    /// A celld runs on the state folder, and reads the gripper.
    pub daemon: bool,
}

const SILENT_HINT: &str = "see that the Compute Box has power and its cable; `devices.gripper` in the \
                           configuration names its host, port (502) and unit (65 alone on the wrist, 66 or 67 \
                           on a dual quick changer)";

/// Above this vacuum something hangs on a cup.
const HANGS: f64 = 0.05;

/// High byte of a control register that grips.
const GRIP: u16 = 1;

fn problem(item: &'static str, found: impl Into<String>, hint: impl Into<String>) -> Line {
    Line::problem(Area::Gripper, item, found, hint)
}

impl GripperFacts {
    /// The lines.
    pub fn lines(&self) -> Vec<Line> {
        let vacuum = match &self.vacuum {
            Ok(vacuum) => *vacuum,
            Err(cause) => {
                let fault = GripperFault::from(cause);
                let hint = match fault {
                    GripperFault::Silent => SILENT_HINT,
                    GripperFault::Taken
                    | GripperFault::Refused
                    | GripperFault::Unserved
                    | GripperFault::NoVacuum => GateClosed::Gripper(fault).hint(),
                };
                return vec![problem("Modbus", format!("{}: {cause}", self.address), hint)];
            }
        };
        let mut lines = vec![Line::ok(Area::Gripper, "Modbus", format!("{} answers", self.address))];
        lines.push(vacuum_line(vacuum));
        match &self.identity {
            Ok(identity) => {
                lines.extend(product_line(identity));
                lines.push(self.confirmed(identity));
            }
            Err(cause) => lines.push(problem(
                "identity",
                format!("product, firmware or serial number could not be read: {cause}"),
                "run `celld doctor` again; if that does not help, `celld run` will ask for \
                 `celld confirm-gripper`",
            )),
        }
        lines.extend(self.other_master());
        lines
    }

    fn confirmed(&self, identity: &Identity) -> Line {
        let said = match &self.service {
            Some((host, Some(true))) => format!("; the maker's service at {host}:41414 finds a VGC10"),
            Some((host, Some(false))) => {
                let found = format!("the maker's service at {host}:41414 finds no VGC10 on the first tool");
                let hint =
                    "see that the gripper is on its quick changer; another product needs another driver";
                return problem("identity", found, hint);
            }
            Some((_, None)) | None => String::new(),
        };
        let closed = match gates::confirmed(&self.confirmed, Some(identity)) {
            Ok(()) if self.confirmed == ConfirmedGripper::NotNeeded => {
                return Line::ok(Area::Gripper, "identity", format!("not needed in a simulation{said}"));
            }
            Ok(()) => return Line::ok(Area::Gripper, "identity", format!("confirmed by a person{said}")),
            Err(closed) => closed,
        };
        let found = match closed {
            GateClosed::GripperOther | GateClosed::GripperByAddress => closed.to_string(),
            _ => "no person has confirmed yet that this is the gripper on the arm".to_string(),
        };
        problem(
            "identity",
            format!("{found}{said}"),
            "see on the Compute Box's own web page (its address in a browser) that it is the one on this \
             arm, then `celld run` and `celld confirm-gripper`; once for each gripper",
        )
    }

    /// One master only: what another one commands, celld cannot know.
    fn other_master(&self) -> Vec<Line> {
        let mut lines = Vec::new();
        if let Some((host, _)) = &self.service {
            let found = format!("the maker's URCap or Compute Box serves {host}:41414");
            let hint =
                "no program that uses its gripper nodes may run beside celld: two masters let go at will";
            lines.push(Line::note(Area::Gripper, "other master", found, hint));
        }
        let grips = |word: u16| word >> 8 == GRIP;
        if let Some(control) = self.control.filter(|words| !self.daemon && words.iter().any(|w| grips(*w))) {
            let channels: Vec<&str> = ["A", "B"]
                .into_iter()
                .zip(control)
                .filter(|(_, word)| grips(*word))
                .map(|(c, _)| c)
                .collect();
            let found =
                format!("channel {} is commanded to grip, and no celld runs here", channels.join(" and "));
            let hint = "an earlier celld left it so, which keeps what is held; or another master commands \
                        it: end that one";
            lines.push(Line::note(Area::Gripper, "other master", found, hint));
        }
        lines
    }
}

/// `None` where it does not say which product it is.
fn product_line(identity: &Identity) -> Option<Line> {
    let name = match identity.product? {
        VGC10 => "VGC10",
        VG10 => "VG10",
        other => {
            let found = format!("product code {other:#04x}, which is neither a VGC10 nor a VG10");
            return Some(problem("product", found, "another product needs another driver"));
        }
    };
    let firmware = identity.firmware;
    let firmware =
        firmware.map_or_else(String::new, |[first, second]| format!(", firmware {first}.{second}"));
    let serial = identity.serial_text().map_or_else(String::new, |text| format!(", serial number {text}"));
    Some(Line::ok(Area::Gripper, "product", format!("{name}{firmware}{serial}")))
}

fn vacuum_line(vacuum: [f64; 2]) -> Line {
    let found = format!("A {:.0} %, B {:.0} %", 100.0 * vacuum[0], 100.0 * vacuum[1]);
    // A reading that is no number is no proof of an empty cup.
    if vacuum.iter().all(|share| *share < HANGS) {
        return Line::ok(Area::Gripper, "vacuum", found);
    }
    let hint = "something hangs there: `celld run`, then `celld recover` says what can be done with it";
    problem("vacuum", found, hint)
}
