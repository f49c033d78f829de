//! What happened in the world, for tests, the report and the control server; and the faults that can be asked for.
//!
//! In and out: plain values that serialise to JSON. A fault is `{"do": NAME, "args": {...}}`, the form of the
//! fault file; unknown names and keys are refused with the names that exist.

use crate::geometry::pose::Pose2;
use crate::sim::world::vacuum::Channel;
use serde::{Deserialize, Serialize};

/// Something that happened, with the controller's time.
#[derive(Clone, Debug, Serialize)]
pub struct Event {
    /// Controller time, s.
    pub time_s: f64,
    /// What it was.
    #[serde(flatten)]
    pub kind: EventKind,
}

/// What can happen.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum EventKind {
    /// The vacuum of a channel took hold of an object.
    Gripped {
        /// The object.
        object: String,
    },
    /// An object was set down.
    Placed {
        /// The object.
        object: String,
        /// Where it lies now.
        pose: Pose2,
    },
    /// An object fell.
    Dropped {
        /// The object.
        object: String,
        /// How far, m.
        height_m: f64,
    },
    /// A placed object moved a neighbour, or was moved by one that is fixed.
    Pushed {
        /// Who moved.
        object: String,
        /// Who moved it.
        by: String,
        /// How far, m.
        distance_m: f64,
    },
    /// A placed object came to lie on others.
    Tilted {
        /// The object.
        object: String,
        /// Those under it.
        on: Vec<String>,
        /// Angle of its top against the table, rad.
        tilt_rad: f64,
    },
    /// An object left the table.
    Fallen {
        /// The object.
        object: String,
    },
    /// The arm pressed something into something, beyond what the cups give.
    Contact(Contact),
    /// A fault was asked for.
    Fault {
        /// Its name.
        name: String,
    },
}

/// Something pressed into something else.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Contact {
    /// What the arm moves: an object's name, `cup` or `gripper`.
    pub moving: String,
    /// What stands in the way: an object's name or `table`.
    pub against: String,
    /// How far, m.
    pub depth_m: f64,
}

/// A fault.
#[derive(Clone, Debug, PartialEq)]
pub enum Fault {
    /// `vacuum.drop`: air enters a channel (absent: both) for a time, 0.5 s by default.
    VacuumDrop {
        /// Which channel.
        channel: Option<Channel>,
        /// How long, s.
        seconds: f64,
    },
    /// `camera.off` and `camera.on`: the camera stops or starts answering.
    Camera {
        /// Whether it answers.
        on: bool,
    },
    /// `world.nudge`: somebody moves an object that lies on the table.
    Nudge {
        /// Which object.
        object: String,
        /// Shift in the table frame and turn.
        by: Pose2,
    },
}

/// Why a fault was refused.
#[derive(Debug, thiserror::Error)]
pub enum FaultError {
    /// Not of the form `{"do": ..., "args": {...}}`, or wrong arguments.
    #[error("fault not understood")]
    Syntax(#[from] serde_json::Error),
    /// No fault has that name.
    #[error("there is no fault {0:?}; there are vacuum.drop, camera.off, camera.on, world.nudge")]
    Unknown(String),
    /// No object has that name.
    #[error("there is no object {0:?}")]
    NoSuchObject(String),
    /// The object is held, fallen or fixed.
    #[error("object {0:?} does not lie free on the table")]
    NotFree(String),
    /// A number is not finite or not in its range.
    #[error("{0}")]
    Range(&'static str),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FaultText {
    #[serde(rename = "do")]
    name: String,
    #[serde(default)]
    args: serde_json::Map<String, serde_json::Value>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct DropArguments {
    channel: Option<ChannelName>,
    seconds: Option<f64>,
}

#[derive(Clone, Copy, Deserialize)]
enum ChannelName {
    A,
    B,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct NudgeArguments {
    object: String,
    #[serde(default)]
    dx_m: f64,
    #[serde(default)]
    dy_m: f64,
    #[serde(default)]
    dtheta_rad: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct NoArguments {}

impl Fault {
    /// A fault from its JSON text.
    ///
    /// # Errors
    /// [`FaultError`]: not JSON of this form, an unknown name, unknown keys, numbers out of range.
    pub fn from_json(text: &[u8]) -> Result<Fault, FaultError> {
        let FaultText { name, args } = serde_json::from_slice(text)?;
        let args = serde_json::Value::Object(args);
        match name.as_str() {
            "vacuum.drop" => drop_fault(serde_json::from_value(args)?),
            "camera.off" | "camera.on" => {
                serde_json::from_value::<NoArguments>(args)?;
                Ok(Fault::Camera { on: name == "camera.on" })
            }
            "world.nudge" => nudge_fault(serde_json::from_value(args)?),
            _ => Err(FaultError::Unknown(name)),
        }
    }

    /// The name it has in fault files.
    pub fn name(&self) -> &'static str {
        match self {
            Fault::VacuumDrop { .. } => "vacuum.drop",
            Fault::Camera { on: true } => "camera.on",
            Fault::Camera { on: false } => "camera.off",
            Fault::Nudge { .. } => "world.nudge",
        }
    }
}

fn drop_fault(args: DropArguments) -> Result<Fault, FaultError> {
    let seconds = args.seconds.unwrap_or(0.5);
    if !(seconds > 0.0 && seconds <= 3600.0) {
        return Err(FaultError::Range("vacuum.drop: seconds must be above 0 and at most 3600"));
    }
    let channel = args.channel.map(|name| match name {
        ChannelName::A => Channel::A,
        ChannelName::B => Channel::B,
    });
    Ok(Fault::VacuumDrop { channel, seconds })
}

fn nudge_fault(args: NudgeArguments) -> Result<Fault, FaultError> {
    let by = Pose2::new(args.dx_m, args.dy_m, args.dtheta_rad);
    if !by.is_finite() || by.x.hypot(by.y) > 10.0 {
        return Err(FaultError::Range(
            "world.nudge: dx_m, dy_m, dtheta_rad must be finite, the shift at most 10 m",
        ));
    }
    Ok(Fault::Nudge { object: args.object, by })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_are_read_strictly() {
        let drop = Fault::from_json(br#"{"do": "vacuum.drop"}"#).unwrap();
        assert_eq!(drop, Fault::VacuumDrop { channel: None, seconds: 0.5 });
        let nudge =
            Fault::from_json(br#"{"do": "world.nudge", "args": {"object": "a", "dx_m": 0.01}}"#).unwrap();
        assert_eq!(nudge, Fault::Nudge { object: "a".into(), by: Pose2::new(0.01, 0.0, 0.0) });
        assert_eq!(Fault::from_json(br#"{"do": "camera.off"}"#).unwrap(), Fault::Camera { on: false });
        for bad in [
            r#"{"do": "camera.off", "args": {"x": 1}}"#,
            r#"{"do": "vacuum.dorp"}"#,
            r#"{"do": "vacuum.drop", "args": {"channel": "C"}}"#,
            r#"{"do": "vacuum.drop", "args": {"seconds": -1}}"#,
            r#"{"do": "world.nudge"}"#,
            "nonsense",
        ] {
            assert!(Fault::from_json(bad.as_bytes()).is_err(), "{bad}");
        }
    }
}
