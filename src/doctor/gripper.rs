//! The gripper: whether it answers, what hangs there, whether a person has confirmed it, who else commands
//! it.
//!
//! In: [`GripperFacts`]. Out: lines. Pure. The device gives out its product code, firmware and serial number
//! (Connectivity Guide), which do not prove that it hangs on this arm: that rests on a person, and on the
//! maker's own service where it runs (reference: ur-interfaces 7.3).

use crate::doctor::{Area, Line};
use cell_machine::device::gripper_types::{ModbusFailure, VG10, VGC10};

/// What was found at the gripper's address.
#[derive(Clone, Debug, PartialEq)]
pub struct GripperFacts {
    /// Host, port and unit.
    pub address: String,
    /// Relative vacuum of both channels, or why there is none.
    pub vacuum: Result<[f64; 2], ModbusFailure>,
    /// The two control registers, where they can be read: mode in the high byte, target in the low one.
    pub control: Option<[u16; 2]>,
    /// Which product it says it is; `None` where it has no such registers.
    pub product: Option<Product>,
    /// What the maker's service (XML-RPC, port 41414) says of a VGC10, where it answers, and at which host.
    pub service: Option<(String, Option<bool>)>,
    /// Why it is taken for the gripper; `None` where no person has said so.
    pub confirmed: Option<Confirmed>,
    /// A celld runs on the state folder, and reads the gripper.
    pub daemon: bool,
}

/// What the device says of itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Product {
    /// Its code.
    pub code: u16,
    /// Firmware, as it stands in its two registers.
    pub firmware: Option<[u16; 2]>,
    /// Serial number, as it stands in its registers.
    pub serial: Option<Vec<u16>>,
}

/// Modbus exception of a register that is not there.
const NO_SUCH_REGISTER: u8 = 2;

/// Why what answers is taken for the gripper.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Confirmed {
    /// A person has said so, for this address.
    ByPerson,
    /// The cell is simulated, and no person has to confirm.
    Simulation,
}

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
            Err(ModbusFailure::Exception(NO_SUCH_REGISTER)) => {
                let found =
                    format!("{} answers, without the registers of the vacuum (258, 259)", self.address);
                let hint = "see on the Compute Box's own web page which gripper and which firmware it has: \
                            older firmware may have the vacuum in other registers, update it";
                return vec![problem("Modbus", found, hint)];
            }
            Err(cause) => {
                let hint = "see that the Compute Box has power and its cable; `devices.gripper` in the \
                            configuration names its host, port (502) and unit (65 alone on the wrist, 66 or \
                            67 on a dual quick changer)";
                return vec![problem("Modbus", format!("{}: {cause}", self.address), hint)];
            }
        };
        let mut lines = vec![Line::ok(Area::Gripper, "Modbus", format!("{} answers", self.address))];
        lines.push(vacuum_line(vacuum));
        lines.extend(self.product.as_ref().map(product_line));
        lines.push(self.identity());
        lines.extend(self.other_master());
        lines
    }

    fn identity(&self) -> Line {
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
        if let Some(confirmed) = self.confirmed {
            let by = match confirmed {
                Confirmed::ByPerson => "confirmed by a person",
                Confirmed::Simulation => "not needed in a simulation",
            };
            return Line::ok(Area::Gripper, "identity", format!("{by}{said}"));
        }
        problem(
            "identity",
            format!("no person has confirmed yet that this is the gripper on the arm{said}"),
            "see on the Compute Box's own web page (its address in a browser) that it is the one on this \
             arm, then `celld run` and `celld confirm-gripper`; once for an address",
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

fn product_line(Product { code, firmware, serial }: &Product) -> Line {
    let name = match *code {
        VGC10 => "VGC10",
        VG10 => "VG10",
        other => {
            let found = format!("product code {other:#04x}, which is neither a VGC10 nor a VG10");
            return problem("product", found, "another product needs another driver");
        }
    };
    let firmware =
        firmware.map_or_else(String::new, |[first, second]| format!(", firmware {first}.{second}"));
    let serial = serial.as_ref().map_or_else(String::new, |words| format!(", serial {}", serial_text(words)));
    Line::ok(Area::Gripper, "product", format!("{name}{firmware}{serial}"))
}

/// A serial number as text where its bytes are one, else in hexadecimal. How the device lays it out is not
/// published.
fn serial_text(words: &[u16]) -> String {
    let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_be_bytes()).filter(|byte| *byte != 0).collect();
    if !bytes.is_empty() && bytes.iter().all(u8::is_ascii_graphic) {
        return bytes.iter().copied().map(char::from).collect();
    }
    words.iter().map(|word| format!("{word:04x}")).collect()
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
