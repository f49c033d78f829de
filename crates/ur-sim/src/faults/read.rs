//! Fault files and posted faults: text to plans.
//!
//! In: YAML or JSON: `faults:` with a list, or (posted) one fault by itself. Out: [`Planned`]s, or every
//! complaint with line and column: faults, arguments and triggers that do not exist, numbers out of range.
//! Whether an object or a marker exists is not known here; the injector checks that.

use crate::faults::link::LinkName;
use crate::faults::{
    CameraFault, DeviceEvent, ExtraPrint, Fault, Order, Phase, Planned, RobotFault, Toxic, Trigger,
    VacuumFault, WorldFault,
};
use crate::world::spec::ForeignBody;
use crate::world::vacuum::{Channel, HIGHEST_TARGET};
use cell_values::image::tag36h11_bitmap;
use cell_values::units::rad_from_deg;
use nalgebra::{Isometry3, Vector3};
use rearrange::document::decode::{At, Decoder, Fields, suggestion};
use rearrange::document::tree::Value;
use rearrange::document::{Diagnostics, Node};
use rearrange::geometry::footprint::Footprint;
use rearrange::geometry::pose::Pose2;
use std::ops::RangeInclusive;
use ur_wire::rtde_variables::input_type;

/// Most faults in a file.
const MAX_FAULTS: usize = 1000;
/// Longest time, s: a day.
const MAX_SECONDS: f64 = 86_400.0;

/// Farthest place, m, and largest angle, rad.
const MAX_POSE: f64 = 100.0;
/// Air enters for so long unless `seconds` says otherwise.
const DROP_SECONDS: f64 = 0.5;
/// A controller boots for so long unless `seconds` says otherwise; real ones take longer.
const REBOOT_SECONDS: f64 = 5.0;
/// A foreign program runs for so long unless `runs_s` says otherwise.
const FOREIGN_SECONDS: f64 = 10.0;

/// Names and arguments; lasting faults also take `seconds`.
pub const CATALOGUE: &[(&str, &[&str])] = &[
    ("ur.pstop", &[]),
    ("ur.estop", &["seconds"]),
    ("ur.safeguard", &["seconds"]),
    ("ur.safety", &["mode", "seconds"]),
    ("ur.fault", &[]),
    ("ur.local", &["seconds"]),
    ("ur.power_off", &[]),
    ("ur.freedrive", &["seconds"]),
    ("ur.kill_program", &[]),
    ("ur.foreign_script", &["runs_s"]),
    ("ur.script_error", &[]),
    ("ur.never_start", &["seconds"]),
    ("ur.pause", &["seconds"]),
    ("ur.slider", &["fraction", "seconds"]),
    ("ur.stall", &["seconds"]),
    ("ur.claim", &["input", "seconds"]),
    ("ur.payload", &["mass_kg"]),
    ("ur.rate", &["hz", "seconds"]),
    ("ur.version", &["version", "seconds"]),
    ("ur.model", &["model", "seconds"]),
    ("ur.safety_checksum", &["checksum", "seconds"]),
    ("ur.reboot", &["serial", "kinematics", "seconds"]),
    ("vacuum.drop", &["channel", "seconds"]),
    ("vacuum.leak", &["channel", "vacuum", "falls_s", "seconds"]),
    ("vacuum.stick", &["seconds"]),
    ("camera.off", &["seconds"]),
    ("camera.on", &[]),
    ("camera.freeze", &["seconds"]),
    ("camera.repeat", &["seconds"]),
    ("camera.gain", &["gain", "seconds"]),
    ("camera.blur", &["sigma_px", "seconds"]),
    ("camera.fog", &["share", "seconds"]),
    ("camera.occlude", &["marker", "seconds"]),
    ("camera.dup", &["marker", "pose", "pose_deg", "seconds"]),
    ("camera.unknown", &["marker", "pose", "pose_deg", "size_m", "seconds"]),
    ("camera.extrinsics", &["translation_m", "rotation_deg", "seconds"]),
    ("camera.drift", &["translation_m", "rotation_deg", "seconds"]),
    ("world.nudge", &["object", "dx_m", "dy_m", "dtheta_rad"]),
    ("world.place", &["object", "pose", "pose_deg"]),
    ("world.foreign", &["shape", "size_m", "height_m", "pose", "pose_deg", "seconds"]),
    ("net.reset_peer", &["link"]),
    ("net.timeout", &["link", "seconds"]),
    ("net.latency", &["link", "latency_s", "seconds"]),
    ("net.slicer", &["link", "bytes", "seconds"]),
    ("net.limit_data", &["link", "bytes", "seconds"]),
    ("net.exception", &["code", "seconds"]),
    ("net.transaction", &["seconds"]),
    ("clear", &["fault"]),
];

/// Reads a fault file.
///
/// # Errors
/// Every complaint.
pub fn read_faults(text: &str, source: &str) -> Result<Vec<Planned>, Diagnostics> {
    let (node, mut decoder) = Decoder::open(text, source)?;
    let plans = decoder.map(&At::top(&node), &["version", "faults"]).and_then(|fields| {
        if let Some(at) = fields.optional("version") {
            decoder.integer(&at, 1..=1);
        }
        let at = fields.required("faults", &mut decoder)?;
        list(&mut decoder, &at)
    });
    decoder.finish(plans)
}

/// Reads what was posted: a fault file, or one fault by itself.
///
/// # Errors
/// Every complaint.
pub fn read_posted(text: &str) -> Result<Vec<Planned>, Diagnostics> {
    let source = "posted";
    let (node, mut decoder) = Decoder::open(text, source)?;
    if node.get("faults").is_some() {
        return read_faults(text, source);
    }
    let plan = planned(&mut decoder, &At::top(&node));
    decoder.finish(plan.map(|plan| vec![plan]))
}

fn list(decoder: &mut Decoder, at: &At) -> Option<Vec<Planned>> {
    let items = decoder.sequence(at)?;
    if items.len() > MAX_FAULTS {
        decoder.complain_at(at, format!("{} faults, at most {MAX_FAULTS} are read", items.len()), "");
        return None;
    }
    let plans: Vec<Option<Planned>> = items.iter().map(|item| planned(decoder, item)).collect();
    plans.into_iter().collect()
}

fn planned(decoder: &mut Decoder, at: &At) -> Option<Planned> {
    let fields = decoder.map(at, &["at", "do", "args"])?;
    let trigger = match fields.optional("at") {
        Some(at) => trigger(decoder, &at).map(Some),
        None => Some(None),
    };
    let order = fields.required("do", decoder).and_then(|name| order(decoder, &name, &fields));
    Some(Planned { at: trigger?, order: order? })
}

fn trigger(decoder: &mut Decoder, at: &At) -> Option<Trigger> {
    let fields = decoder.map(at, &["time_s", "step", "phase", "progress", "event", "object", "count"])?;
    let given: Vec<&str> =
        fields.keys().map(|(key, _)| key).filter(|key| ["time_s", "step", "event"].contains(key)).collect();
    let [kind] = given[..] else {
        decoder.complain_at(at, "a trigger has exactly one of time_s, step and event", "see docs/faults.md");
        return None;
    };
    let belongs: &[&str] = match kind {
        "time_s" => &["time_s"],
        "step" => &["step", "phase", "progress"],
        _ => &["event", "object", "count"],
    };
    for (key, place) in fields.keys().filter(|(key, _)| !belongs.contains(key)) {
        decoder.complain(place, fields.path(), format!("{key:?} does not go with {kind:?}"), "leave it out");
    }
    let args = Args { fields };
    match kind {
        "time_s" => args.number(decoder, "time_s", 0.0..=MAX_SECONDS, "s").map(Trigger::Time),
        "step" => {
            let step = args.whole(decoder, "step", 1..=1_000_000)?;
            let phase = args.optional("phase", Phase::Approach, |at| decoder.choice(at, &Phase::NAMES));
            let progress = args.number_or(decoder, "progress", 0.0, 0.0..=1.0, "of the move");
            Some(Trigger::Step { step: u32::try_from(step).ok()?, phase: phase?, progress: progress? })
        }
        _ => {
            let at = args.fields.required("event", decoder)?;
            let kind = decoder.choice(&at, &DeviceEvent::NAMES);
            let object = args.optional("object", None, |at| decoder.text(at).map(Some));
            let count = args.optional("count", 1, |at| decoder.integer(at, 1..=1_000_000));
            Some(Trigger::Event { kind: kind?, object: object?, count: u32::try_from(count?).ok()? })
        }
    }
}

fn order(decoder: &mut Decoder, name_at: &At, fields: &Fields) -> Option<Order> {
    let text = decoder.text(name_at)?;
    let Some((name, keys)) = CATALOGUE.iter().find(|(name, _)| *name == text) else {
        let names: Vec<&str> = CATALOGUE.iter().map(|(name, _)| *name).collect();
        let help = match suggestion(&text, &names) {
            Some(near) => format!("did you mean {near:?}?"),
            None => format!("there are: {}", names.join(", ")),
        };
        decoder.complain_at(name_at, format!("there is no fault {text:?}"), help);
        return None;
    };
    let none = Node { at: name_at.node.at, value: Value::Map(Vec::new()) };
    let absent = At { node: &none, path: name_at.path.clone(), key_at: name_at.key_at };
    let at = fields.optional("args").unwrap_or(absent);
    let args = Args { fields: decoder.map(&at, keys)? };
    let seconds = match args.fields.optional("seconds") {
        Some(at) => decoder.number_in(&at, 1e-3..=MAX_SECONDS, "s").map(Some),
        None => Some(default_seconds(name)),
    };
    let fault = fault(decoder, name, &args);
    Some(Order { name, fault: fault?, seconds: seconds? })
}

fn default_seconds(name: &str) -> Option<f64> {
    match name {
        "vacuum.drop" => Some(DROP_SECONDS),
        "ur.reboot" => Some(REBOOT_SECONDS),
        _ => None,
    }
}

fn fault(decoder: &mut Decoder, name: &str, args: &Args) -> Option<Fault> {
    match name.split_once('.') {
        Some(("ur", name)) => robot(decoder, name, args).map(Fault::Robot),
        Some(("vacuum", name)) => vacuum(decoder, name, args).map(Fault::Vacuum),
        Some(("camera", "on")) => Some(Fault::Clear { fault: Some("camera.off".to_owned()) }),
        Some(("camera", name)) => camera(decoder, name, args).map(Fault::Camera),
        Some(("world", name)) => world(decoder, name, args).map(Fault::World),
        Some((_, name)) => net(decoder, name, args),
        None => clear(decoder, args),
    }
}

fn clear(decoder: &mut Decoder, args: &Args) -> Option<Fault> {
    let names: Vec<(&str, &str)> = CATALOGUE.iter().map(|(name, _)| (*name, *name)).collect();
    let fault = args.optional("fault", None, |at| decoder.choice(at, &names).map(Some))?;
    Some(Fault::Clear { fault: fault.map(str::to_owned) })
}

fn robot(decoder: &mut Decoder, name: &str, args: &Args) -> Option<RobotFault> {
    Some(match name {
        "pstop" => RobotFault::ProtectiveStop,
        "estop" => RobotFault::EmergencyStop,
        "safeguard" => RobotFault::Safeguard,
        "safety" => RobotFault::SafetyMode(i32::try_from(args.whole(decoder, "mode", 0..=255)?).ok()?),
        "fault" => RobotFault::SafetyFault,
        "local" => RobotFault::Local,
        "power_off" => RobotFault::PowerOff,
        "freedrive" => RobotFault::Freedrive,
        "kill_program" => RobotFault::KillProgram,
        "foreign_script" => {
            RobotFault::ForeignScript(args.number_or(decoder, "runs_s", FOREIGN_SECONDS, 0.002..=1e4, "s")?)
        }
        "script_error" => RobotFault::ScriptError,
        "never_start" => RobotFault::NeverStart,
        "pause" => RobotFault::Pause,
        "slider" => RobotFault::Slider(args.number(decoder, "fraction", 0.0..=1.0, "of full speed")?),
        "stall" => RobotFault::Stall,
        "claim" => RobotFault::Claim(args.input(decoder)?),
        "rate" => RobotFault::Rate(args.number(decoder, "hz", 0.1..=500.0, "Hz")?),
        "version" => RobotFault::Version(args.version(decoder)?),
        "model" => {
            let at = args.fields.required("model", decoder)?;
            RobotFault::Model(decoder.text(&at)?)
        }
        "safety_checksum" => {
            let checksum = args.whole(decoder, "checksum", 0..=i64::from(u32::MAX))?;
            RobotFault::SafetyChecksum(u32::try_from(checksum).ok()?)
        }
        "payload" => RobotFault::Payload(args.number(decoder, "mass_kg", 0.0..=50.0, "kg")?),
        _ => {
            let serial = args.optional("serial", None, |at| decoder.text(at).map(Some));
            let kinematics =
                args.optional("kinematics", None, |at| decoder.integer(at, 0..=i64::MAX).map(Some));
            RobotFault::Reboot {
                serial: serial?,
                kinematics: kinematics?.and_then(|seed| u64::try_from(seed).ok()),
            }
        }
    })
}

fn vacuum(decoder: &mut Decoder, name: &str, args: &Args) -> Option<VacuumFault> {
    if name == "stick" {
        return Some(VacuumFault::Stick);
    }
    let names = [("A", Some(Channel::A)), ("B", Some(Channel::B))];
    let channel = args.optional("channel", None, |at| decoder.choice(at, &names));
    if name == "drop" {
        return channel.map(VacuumFault::Drop);
    }
    let vacuum = args.number(decoder, "vacuum", 0.0..=HIGHEST_TARGET, "of an atmosphere");
    let falls_s = args.number_or(decoder, "falls_s", 0.0, 0.0..=MAX_SECONDS, "s");
    Some(VacuumFault::Leak { channel: channel?, vacuum: vacuum?, falls_s: falls_s? })
}

fn camera(decoder: &mut Decoder, name: &str, args: &Args) -> Option<CameraFault> {
    Some(match name {
        "off" => CameraFault::Off,
        "freeze" => CameraFault::Freeze,
        "repeat" => CameraFault::Repeat,
        "gain" => CameraFault::Gain(args.number(decoder, "gain", 0.0..=100.0, "times the light")?),
        "blur" => CameraFault::Blur(args.number(decoder, "sigma_px", 0.0..=20.0, "px")?),
        "fog" => CameraFault::Fog(args.number(decoder, "share", 0.0..=1.0, "of the contrast")?),
        "occlude" => CameraFault::Occlude(args.marker(decoder)?),
        "extrinsics" => {
            let (translation, rotation) = args.shift(decoder)?;
            CameraFault::Extrinsics(Isometry3::new(translation, rotation))
        }
        "drift" => {
            let (translation, rotation) = args.shift(decoder)?;
            CameraFault::Drift { translation, rotation }
        }
        _ => {
            let (marker, pose) = (args.marker(decoder), args.pose(decoder));
            let size_m = match name {
                "unknown" => args.number(decoder, "size_m", 1e-3..=0.5, "m").map(Some),
                _ => Some(None),
            };
            CameraFault::Print(ExtraPrint { marker: marker?, pose: pose?, size_m: size_m? })
        }
    })
}

fn world(decoder: &mut Decoder, name: &str, args: &Args) -> Option<WorldFault> {
    if name == "foreign" {
        return args.foreign(decoder).map(WorldFault::Foreign);
    }
    let object = args.fields.required("object", decoder).and_then(|at| decoder.text(&at));
    if name == "place" {
        let pose = args.pose(decoder);
        return Some(WorldFault::Place { object: object?, pose: pose? });
    }
    args.any_of(decoder, &["dx_m", "dy_m", "dtheta_rad"]);
    let shift = |decoder: &mut Decoder, key: &str| args.number_or(decoder, key, 0.0, -10.0..=10.0, "m");
    let (dx, dy) = (shift(decoder, "dx_m"), shift(decoder, "dy_m"));
    let turn = args.number_or(decoder, "dtheta_rad", 0.0, -10.0..=10.0, "rad");
    Some(WorldFault::Nudge { object: object?, by: Pose2::new(dx?, dy?, turn?) })
}

fn net(decoder: &mut Decoder, name: &str, args: &Args) -> Option<Fault> {
    if name == "exception" {
        let code = args.whole(decoder, "code", 1..=6)?;
        if code == 5 {
            decoder.complain(args.fields.at(), args.fields.path(), "code 5 is no error", "use 1 to 4 or 6");
            return None;
        }
        let toxic = Toxic::Exception(u8::try_from(code).ok()?);
        return Some(Fault::Net { link: Some(LinkName::Gripper), toxic });
    }
    if name == "transaction" {
        return Some(Fault::Net { link: Some(LinkName::Gripper), toxic: Toxic::Transaction });
    }
    let at = args.fields.required("link", decoder)?;
    let link = decoder.choice(&at, &LinkName::NAMES);
    let toxic = match name {
        "reset_peer" => Some(Toxic::ResetPeer),
        "timeout" => Some(Toxic::Timeout),
        "latency" => args.number(decoder, "latency_s", 1e-3..=1e4, "s").map(Toxic::Latency),
        "slicer" => args
            .whole(decoder, "bytes", 1..=1_000_000)
            .and_then(|bytes| usize::try_from(bytes).ok())
            .map(Toxic::Slicer),
        _ => args
            .whole(decoder, "bytes", 0..=1_000_000_000)
            .and_then(|bytes| u64::try_from(bytes).ok())
            .map(Toxic::LimitData),
    };
    Some(Fault::Net { link: link?, toxic: toxic? })
}

/// The arguments of one fault, all of known names.
struct Args<'n> {
    fields: Fields<'n>,
}

impl<'n> Args<'n> {
    fn optional<T>(&self, key: &str, default: T, read: impl FnOnce(&At<'n>) -> Option<T>) -> Option<T> {
        match self.fields.optional(key) {
            Some(at) => read(&at),
            None => Some(default),
        }
    }

    fn number(
        &self,
        decoder: &mut Decoder,
        key: &str,
        range: RangeInclusive<f64>,
        unit: &str,
    ) -> Option<f64> {
        let at = self.fields.required(key, decoder)?;
        decoder.number_in(&at, range, unit)
    }

    fn number_or(
        &self,
        decoder: &mut Decoder,
        key: &str,
        default: f64,
        range: RangeInclusive<f64>,
        unit: &str,
    ) -> Option<f64> {
        self.optional(key, default, |at| decoder.number_in(at, range, unit))
    }

    fn whole(&self, decoder: &mut Decoder, key: &str, range: RangeInclusive<i64>) -> Option<i64> {
        let at = self.fields.required(key, decoder)?;
        decoder.integer(&at, range)
    }

    fn marker(&self, decoder: &mut Decoder) -> Option<u32> {
        let at = self.fields.required("marker", decoder)?;
        let id = u32::try_from(decoder.integer(&at, 0..=i64::from(u32::MAX))?).ok()?;
        if tag36h11_bitmap(id).is_none() {
            decoder.complain_at(&at, format!("tag36h11 has no marker {id}"), "numbers go from 0 to 586");
            return None;
        }
        Some(id)
    }

    fn pose(&self, decoder: &mut Decoder) -> Option<Pose2> {
        let Some([x, y, theta]) = decoder.pose(&self.fields, "pose")? else {
            let help = "add pose: [x, y, theta], or pose_deg with theta in degrees";
            decoder.complain(self.fields.at(), self.fields.path(), "key \"pose\" is missing", help);
            return None;
        };
        if [x, y, theta].iter().any(|value| value.abs() > MAX_POSE) {
            let message = format!("{x} m, {y} m, {theta} rad is out of range");
            decoder.complain(self.fields.at(), self.fields.path(), message, "lengths are in m");
            return None;
        }
        Some(Pose2::new(x, y, theta))
    }

    /// Complains where none of `keys` is given: such a fault changes nothing, and a test with it shows
    /// nothing.
    fn any_of(&self, decoder: &mut Decoder, keys: &[&str]) {
        if keys.iter().all(|key| self.fields.optional(key).is_none()) {
            let message = format!("none of {} is given: nothing would happen", keys.join(", "));
            decoder.complain(self.fields.at(), self.fields.path(), message, "say by how much");
        }
    }

    /// A box or a mug: extents in x and y, height, pose.
    fn foreign(&self, decoder: &mut Decoder) -> Option<ForeignBody> {
        let names = [("box", false), ("mug", true)];
        let round = self.optional("shape", false, |at| decoder.choice(at, &names));
        let size = self.fields.required("size_m", decoder).and_then(|at| {
            let [length, width] = decoder.numbers::<2>(&at)?;
            let fine = 1e-3..=1.0;
            if !fine.contains(&length) || !fine.contains(&width) {
                decoder.complain_at(&at, format!("[{length}, {width}] is no size"), "1 mm to 1 m in x and y");
                return None;
            }
            Some([length, width])
        });
        let height_m = self.number(decoder, "height_m", 1e-3..=0.5, "m");
        let pose = self.pose(decoder);
        let [length, width] = size?;
        let footprint =
            if round? { Footprint::ellipse(length, width) } else { Footprint::rectangle(length, width) };
        Some(ForeignBody { footprint: footprint.ok()?, height_m: height_m?, pose: pose? })
    }

    fn input(&self, decoder: &mut Decoder) -> Option<String> {
        let at = self.fields.required("input", decoder)?;
        let name = decoder.text(&at)?;
        if input_type(&name).is_none() {
            let help = "for instance speed_slider_mask or input_int_register_24";
            decoder.complain_at(&at, format!("RTDE has no input {name:?}"), help);
            return None;
        }
        Some(name)
    }

    /// Four numbers with points between them, in quotes.
    fn version(&self, decoder: &mut Decoder) -> Option<[u32; 4]> {
        let at = self.fields.required("version", decoder)?;
        let text = decoder.text(&at)?;
        let numbers: Option<Vec<u32>> = text.split('.').map(|part| part.parse().ok()).collect();
        let version = numbers.and_then(|numbers| <[u32; 4]>::try_from(numbers).ok());
        if version.is_none() {
            decoder.complain_at(&at, format!("{text:?} is no software version"), "as in \"5.9.4.1031232\"");
        }
        version
    }

    /// Translation in m and turns about x, y, z in degrees, both in the camera's frame.
    fn shift(&self, decoder: &mut Decoder) -> Option<(Vector3<f64>, Vector3<f64>)> {
        self.any_of(decoder, &["translation_m", "rotation_deg"]);
        let mut three = |key: &str, most: f64| {
            self.optional(key, [0.0; 3], |at| {
                let numbers = decoder.numbers::<3>(at)?;
                if numbers.iter().any(|number| number.abs() > most) {
                    decoder.complain_at(at, format!("more than {most}"), "");
                    return None;
                }
                Some(numbers)
            })
        };
        let (translation, degrees) = (three("translation_m", 1.0), three("rotation_deg", 180.0));
        Some((Vector3::from(translation?), Vector3::from(degrees?.map(rad_from_deg))))
    }
}

#[cfg(test)]
mod tests;
