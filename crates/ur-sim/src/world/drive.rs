//! What makes the gripper grip: the vacuum pumps of a VGC10 behind a Compute Box or on the tool connector,
//! an ejector on digital pins, or two fingers.
//!
//! Out: plain values; [`crate::world::spec::GripperSpec`] has one. Lengths m, forces N.

/// What makes the gripper grip.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Drive {
    /// Two pumps behind a Compute Box (Modbus).
    #[default]
    Vgc10,
    /// The same on the serial line of the tool connector.
    Vgc10OnTool,
    /// Compressed air through an ejector, switched by the controller's pins.
    Ejector(EjectorPins),
    /// Two parallel fingers.
    Fingers(FingersSpec),
}

/// Pins of the controller by their bit: 0 to 7 standard, 8 to 15 configurable, 16 and 17 at the tool.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EjectorPins {
    /// Output that lets the air through the ejector.
    pub vacuum_on: u8,
    /// Output that blows what is held off.
    pub blow_off: Option<u8>,
    /// Input of the vacuum switch.
    pub part_present: Option<u8>,
    /// Relative vacuum at which the switch closes, fraction.
    pub switches_at: f64,
}

impl EjectorPins {
    /// What the outputs make of it: air through the ejector, air into the cups.
    pub fn read(&self, outputs: u64) -> (bool, bool) {
        let high = |pin: u8| outputs >> pin & 1 == 1;
        (high(self.vacuum_on), self.blow_off.is_some_and(high))
    }
}

/// Two parallel fingers that open along x of the tool frame, their tips in its origin's plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FingersSpec {
    /// Widest opening, m.
    pub stroke_m: f64,
    /// Extent of a finger along y, m.
    pub width_m: f64,
    /// Extent of a finger along x, m.
    pub thickness_m: f64,
    /// How far above the tips the pads reach, m.
    pub pad_m: f64,
    /// Least and greatest speed of the opening, m/s.
    pub speed: [f64; 2],
    /// Least and greatest force of a finger, N.
    pub force: [f64; 2],
}

impl FingersSpec {
    /// Robotiq 2F-85: stroke, speed and force of its data sheet; pads assumed.
    pub const ROBOTIQ_2F85: FingersSpec = FingersSpec {
        stroke_m: 0.085,
        width_m: 0.022,
        thickness_m: 0.014,
        pad_m: 0.037,
        speed: [0.020, 0.150],
        force: [20.0, 235.0],
    };
    /// Robotiq 2F-140, likewise.
    pub const ROBOTIQ_2F140: FingersSpec = FingersSpec {
        stroke_m: 0.140,
        width_m: 0.027,
        thickness_m: 0.014,
        pad_m: 0.065,
        speed: [0.030, 0.250],
        force: [10.0, 125.0],
    };

    /// The share of a register, 0 to 255, of a range.
    pub fn share([least, greatest]: [f64; 2], register: u8) -> f64 {
        least + (greatest - least) * f64::from(register) / 255.0
    }
}
