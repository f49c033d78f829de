//! An ejector: compressed air that the controller's pins switch, in place of the pumps' Modbus.
//!
//! In: the digital outputs of a frame. Out: what the cups do, and the level of the vacuum switch. Air
//! through the ejector pulls as the pumps at full power do; without it the cups fill again, and blown off
//! they fill at once.

use crate::box_clients::BoxConfig;
use crate::world::World;
use crate::world::drive::Drive;
use crate::world::vacuum::{Channel, HIGHEST_TARGET, VacuumMode};

impl World {
    /// Follows the controller's outputs; input and level of the vacuum switch, if there is one.
    pub fn drive_ejector(&mut self, outputs: u64) -> Option<(u8, bool)> {
        let Drive::Ejector(pins) = self.gripper.drive else { return None };
        let (on, blows) = pins.read(outputs);
        let mode = if on && !blows { VacuumMode::Grip } else { VacuumMode::Release };
        let mut present = false;
        for channel in Channel::ALL {
            let pump = &mut self.channels[channel.index()].pump;
            pump.command(mode, HIGHEST_TARGET);
            if blows {
                pump.collapse();
            }
            present |= pump.vacuum() >= pins.switches_at;
        }
        Some((pins.part_present?, present))
    }

    /// The gripper is one behind a Compute Box.
    pub fn has_compute_box(&self) -> bool {
        self.gripper.drive == Drive::Vgc10
    }

    /// How the box treats its clients.
    pub fn box_config(&self) -> BoxConfig {
        self.gripper.clients
    }

    /// The gripper is one on the serial line of the tool connector.
    pub fn is_on_tool_line(&self) -> bool {
        self.gripper.drive == Drive::Vgc10OnTool
    }

    /// The gripper has fingers and the socket of their URCap.
    pub fn has_fingers(&self) -> bool {
        self.fingers.is_some()
    }
}

#[cfg(test)]
mod tests {
    use crate::world::drive::{Drive, EjectorPins};
    use crate::world::spec::GripperSpec;
    use crate::world::tests::{Cell, block, gripper, no_errors};

    fn cell() -> Cell {
        let pins = EjectorPins { vacuum_on: 2, blow_off: Some(9), part_present: Some(4), switches_at: 0.3 };
        let gripper = GripperSpec { drive: Drive::Ejector(pins), ..gripper() };
        Cell::with(gripper, vec![block("a", 0.25, 0.25)], no_errors(), 1)
    }

    /// So many seconds with these outputs; the level of the vacuum switch.
    fn run(cell: &mut Cell, outputs: u64, seconds: f64) -> bool {
        let mut level = None;
        for _ in 0..(seconds / 0.002) as usize {
            level = cell.world.drive_ejector(outputs);
            cell.frame(0.0);
        }
        assert_eq!(level.unwrap().0, 4);
        level.unwrap().1
    }

    #[test]
    fn pins_suck_blow_off_and_report_the_part() {
        let mut cell = cell();
        assert!(!run(&mut cell, 1 << 2, 0.5), "in the air little vacuum builds up");
        cell.go([0.25, 0.25, 0.02]);
        assert!(!run(&mut cell, 0, 0.1) && run(&mut cell, 1 << 2, 0.5));
        cell.go([0.25, 0.25, 0.1]);
        assert_eq!(cell.world.held().collect::<Vec<_>>(), ["a"]);
        assert!(!run(&mut cell, 1 << 2 | 1 << 9, 0.01), "blown off at once");
        assert_eq!(cell.world.held().count(), 0);
    }

    #[test]
    fn without_air_the_part_falls_a_little_later() {
        let mut cell = cell();
        cell.go([0.25, 0.25, 0.02]);
        run(&mut cell, 1 << 2, 0.5);
        cell.go([0.25, 0.25, 0.1]);
        run(&mut cell, 0, 0.01);
        assert_eq!(cell.world.held().count(), 1);
        run(&mut cell, 0, 0.3);
        assert_eq!(cell.world.held().count(), 0);
    }
}
