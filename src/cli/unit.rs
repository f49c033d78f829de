//! `celld unit`: the address filter of a cell as a drop-in for systemd.
//!
//! In: the cell's configuration. Out: on standard output, a `[Service]` section that lets the daemon reach
//! the devices it names and nothing else; exit code 2 for a configuration that cannot be read, 1 for a host
//! without an address. The robot's protocols know no passwords: what must not be reached from elsewhere must
//! not be reachable through the cell's computer either. systemd filters by number, so names are looked up
//! here, and a complaint says that the filter keeps the daemon from looking them up again.

use crate::config::cell::{CellConfig, Devices};
use crate::config::load::load_cell;
use cell_edge::terminal::{complain, print};
use clap::Args;
use std::collections::BTreeSet;
use std::fmt::Write;
use std::net::{IpAddr, ToSocketAddrs};
use std::path::{Path, PathBuf};

/// `celld unit`
#[derive(Args, Clone, Debug)]
pub struct UnitArgs {
    /// The cell's configuration
    #[arg(long, default_value = "config/cell.yaml", value_name = "FILE")]
    config: PathBuf,
}

/// Prints the drop-in and returns the exit code.
pub fn run(args: &UnitArgs) -> u8 {
    let config = match load_cell(&args.config) {
        Ok(config) => config,
        Err(error) => {
            complain(&error.to_string());
            return 2;
        }
    };
    let found: Result<Vec<(String, Vec<IpAddr>)>, String> =
        hosts(&config).into_iter().map(|host| addresses(&host).map(|found| (host, found))).collect();
    match found {
        Ok(found) => {
            for (host, _) in found.iter().filter(|(host, _)| host.parse::<IpAddr>().is_err()) {
                complain(&format!(
                    "{host} is a name: behind this filter celld reaches no name server, so write its address \
                     into the configuration, or allow the name server too"
                ));
            }
            print(&drop_in(&args.config, &found));
            0
        }
        Err(fault) => {
            complain(&fault);
            1
        }
    }
}

/// Hosts that the daemon connects to, and those from which its page may move the arm, each once.
fn hosts(config: &CellConfig) -> BTreeSet<String> {
    let Devices { robot_host, gripper_host, camera, .. } = &config.devices;
    let named = [Some(robot_host.as_str()), Some(gripper_host.as_str()), camera.host()];
    let controllers = config.page.iter().flat_map(|page| &page.control_from).map(ToString::to_string);
    named.into_iter().flatten().map(str::to_string).chain(controllers).collect()
}

fn addresses(host: &str) -> Result<Vec<IpAddr>, String> {
    let found = (host, 0).to_socket_addrs().map_err(|error| format!("{host}: {error}"))?;
    let found: BTreeSet<IpAddr> = found.map(|address| address.ip()).collect();
    if found.is_empty() { Err(format!("{host}: no address")) } else { Ok(found.into_iter().collect()) }
}

fn drop_in(config: &Path, found: &[(String, Vec<IpAddr>)]) -> String {
    let mut text = format!(
        "# The devices of {}, by `celld unit`. Write it again when they change.\n[Service]\nIPAddressDeny=any\n\
         IPAddressAllow=localhost\n",
        config.display()
    );
    for (host, addresses) in found {
        for address in addresses {
            // Writing into a text does not fail.
            let _ = writeln!(text, "# {host}\nIPAddressAllow={address}");
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_device_is_let_through_and_nothing_else() {
        let found = [("10.0.0.2", "10.0.0.2"), ("gripper", "10.0.0.3")];
        let found = found.map(|(host, address)| (host.to_string(), vec![address.parse().unwrap()]));
        insta::assert_snapshot!(drop_in(Path::new("/etc/celld/cell.yaml"), &found), @r"
        # The devices of /etc/celld/cell.yaml, by `celld unit`. Write it again when they change.
        [Service]
        IPAddressDeny=any
        IPAddressAllow=localhost
        # 10.0.0.2
        IPAddressAllow=10.0.0.2
        # gripper
        IPAddressAllow=10.0.0.3
        ");
    }

    #[test]
    fn the_example_cell_names_its_devices_once() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let cell = load_cell(&root.join("config/cell.yaml")).unwrap();
        assert_eq!(hosts(&cell).into_iter().collect::<Vec<_>>(), ["127.0.0.2"]);
        let mut open = cell;
        if let Some(page) = &mut open.page {
            page.control_from.push("192.168.1.20".parse().unwrap());
        }
        assert_eq!(hosts(&open).into_iter().collect::<Vec<_>>(), ["127.0.0.2", "192.168.1.20"]);
    }
}
