//! The files of one simulated cell of a fleet: those of `config/`, with an address and a name of its own.
//!
//! In: which cell, where the server is, the folder. Out: files there, which `celld check` accepts. Edited as
//! text, so that their comments stay: whoever looks into them finds the examples explained. What is to be
//! replaced and is not there is an error, not a cell on the address of another.

use std::net::Ipv4Addr;
use std::path::{Path, PathBuf};

const CELL: &str = include_str!("../../../config/cell.yaml");
const SIM: &str = include_str!("../../../config/sim.yaml");

/// The calibration that a person has made of that simulated cell.
const CALIBRATION: [(&str, &str); 3] = [
    ("camera.yaml", include_str!("../../../calibration/sim/camera.yaml")),
    ("hand_eye.yaml", include_str!("../../../calibration/sim/hand_eye.yaml")),
    ("table.yaml", include_str!("../../../calibration/sim/table.yaml")),
];

/// The label of every second cell, and of the others.
pub const LABELS: [&str; 2] = ["line-a", "line-b"];

/// One simulated cell.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DemoCell {
    /// Its name in the fleet.
    pub name: String,
    /// The line it belongs to.
    pub label: &'static str,
    /// Where its devices listen.
    pub address: Ipv4Addr,
    /// Where its files are.
    pub folder: PathBuf,
}

impl DemoCell {
    /// The cell of this number, from 0; its address follows on the first one's.
    ///
    /// # Errors
    /// The address is not one of loopback.
    pub fn new(number: u32, first: Ipv4Addr, out: &Path) -> Result<DemoCell, String> {
        let address = Ipv4Addr::from(u32::from(first).wrapping_add(number));
        if !address.is_loopback() {
            return Err(format!("{address}: simulated devices listen on this computer alone, 127.x.y.z"));
        }
        let name = format!("cell-{}", number + 1);
        let folder = out.join(&name);
        Ok(DemoCell { name, label: LABELS[number as usize % LABELS.len()], address, folder })
    }

    /// The cell's configuration.
    pub fn config(&self) -> PathBuf {
        self.folder.join("cell.yaml")
    }

    /// The simulator's.
    pub fn sim(&self) -> PathBuf {
        self.folder.join("sim.yaml")
    }

    /// The state folder.
    pub fn state(&self) -> PathBuf {
        self.folder.join("state")
    }

    /// Writes its files.
    ///
    /// # Errors
    /// What the system says, with the file; or an example that is no longer what this expects.
    pub fn write(&self, fleet: &str, server: &str) -> Result<(), String> {
        let calibration = self.folder.join("calibration");
        let fault = |path: &Path| {
            let path = path.display().to_string();
            move |error: std::io::Error| format!("{path}: {error}")
        };
        std::fs::create_dir_all(&calibration).map_err(fault(&calibration))?;
        let put = |path: PathBuf, text: &str| std::fs::write(&path, text).map_err(fault(&path));
        put(self.config(), &self.cell_text(fleet, server)?)?;
        put(self.sim(), &replaced(SIM, &[("bind: 127.0.0.2", &format!("bind: {}", self.address))])?)?;
        CALIBRATION.iter().try_for_each(|(name, text)| put(calibration.join(name), text))
    }

    fn cell_text(&self, fleet: &str, server: &str) -> Result<String, String> {
        let host = format!("host: {}", self.address);
        let page = format!("\npage: {{listen: {}:8737}}", self.address);
        let text = replaced(
            CELL,
            &[
                ("host: 127.0.0.2", &host),
                ("../calibration/sim/", "calibration/"),
                ("folder: ../recordings", "folder: recordings"),
                ("\napproval: always", "\napproval: never"),
                ("\narm_at_start: false", "\narm_at_start: true"),
                ("\npage: {listen: 127.0.0.1:8737}", &page),
                ("# yaml-language-server: $schema=../schemas/config.json\n", ""),
            ],
        )?;
        let Self { name, label, .. } = self;
        Ok(format!(
            "{text}\nfleet: {{name: {fleet}, cell: {name}, labels: [{label}], servers: [\"{server}\"]}}\n"
        ))
    }
}

/// Every place of each first text has the second.
fn replaced(text: &str, changes: &[(&str, &str)]) -> Result<String, String> {
    changes.iter().try_fold(text.to_string(), |text, (from, to)| match text.contains(from) {
        true => Ok(text.replace(from, to)),
        false => Err(format!("the example configuration has no {from:?} to be replaced")),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::calibrated::read_calibration;
    use crate::config::load::load_cell;
    use cell_machine::orders::Approval;

    #[test]
    fn each_cell_is_a_sound_cell_of_its_own() {
        let folder = tempfile::tempdir().unwrap();
        for number in [0, 3] {
            let cell = DemoCell::new(number, Ipv4Addr::new(127, 0, 40, 1), folder.path()).unwrap();
            cell.write("demo", "nats://127.0.0.1:4222").unwrap();
            let config = load_cell(&cell.config()).unwrap_or_else(|error| panic!("{error}"));
            read_calibration(&config).unwrap();
            let host = Ipv4Addr::new(127, 0, 40, 1 + u8::try_from(number).unwrap()).to_string();
            assert_eq!((&config.devices.robot_host, &config.devices.gripper_host), (&host, &host));
            assert!(config.arm_at_start && config.approval == Approval::Never);
            let fleet = config.fleet.unwrap();
            assert_eq!((fleet.cell, fleet.labels.len()), (cell.name.clone(), 1));
            let sim = std::fs::read_to_string(cell.sim()).unwrap();
            assert!(sim.contains(&format!("\nbind: {host}")) && !sim.contains("127.0.0.2"), "{sim}");
        }
        assert!(DemoCell::new(4, Ipv4Addr::new(127, 255, 255, 254), folder.path()).is_err());
    }

    #[test]
    fn an_example_that_has_changed_is_an_error() {
        assert_eq!(replaced("a b a", &[("a", "c")]).as_deref(), Ok("c b c"));
        assert!(replaced("a", &[("b", "c")]).is_err());
    }
}
