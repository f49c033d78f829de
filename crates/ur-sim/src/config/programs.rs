//! `programs:` of the simulator's configuration: which files `load` finds.
//!
//! In: the section. Out: the folder of scripts to read, and the files that it describes by itself: programs
//! of the External Control URCap. The scripts come later, from the code that opens files.

use crate::controller::program_files::{ProgramFiles, ProgramSource, SCRIPT_PORT};
use cell_parts::fields::{each, host, optional};
use rearrange::document::decode::{At, Decoder};

/// Folder of scripts, and the files known so far.
pub type Programs = (Option<String>, ProgramFiles);

/// Reads the section.
pub fn programs(decoder: &mut Decoder, at: &At) -> Option<Programs> {
    let fields = decoder.map(at, &["folder", "at", "external_control"])?;
    let folder = optional(decoder, &fields, "folder", None, |decoder, at| decoder.text(at).map(Some));
    let place = optional(decoder, &fields, "at", "/programs".to_owned(), |decoder, at| {
        let place = decoder.text(at)?;
        let complaint = format!("{place:?} is not a folder of the controller");
        absolute(decoder, at, place, complaint)
    });
    let requests = optional(decoder, &fields, "external_control", Vec::new(), |decoder, at| {
        each(decoder, at, external_control)?.into_iter().collect()
    });
    let mut files = ProgramFiles::in_folder(&place?);
    for (name, source) in requests? {
        if !files.add(&name, source) {
            let help = "give each program a name of its own";
            decoder.complain_at(at, format!("there are two programs called {name}"), help);
        }
    }
    Some((folder?, files))
}

fn absolute(decoder: &mut Decoder, at: &At, place: String, complaint: String) -> Option<String> {
    if place.starts_with('/') {
        return Some(place);
    }
    decoder.complain_at(at, complaint, "write a path from the root, as /ursim/programs");
    None
}

fn external_control(decoder: &mut Decoder, at: &At) -> Option<(String, ProgramSource)> {
    let fields = decoder.map(at, &["name", "host", "port"])?;
    let name = fields.required("name", decoder).and_then(|at| {
        let name = decoder.text(&at)?;
        if name.ends_with(".urp") {
            return Some(name);
        }
        let message = format!("{name:?} is not the file of a program");
        decoder.complain_at(&at, message, "write what clients load, as external_control.urp");
        None
    });
    let host = host(decoder, &fields, "host");
    let port = optional(decoder, &fields, "port", SCRIPT_PORT, |decoder, at| {
        decoder.integer(at, 1..=65_535).and_then(|port| u16::try_from(port).ok())
    });
    Some((name?, ProgramSource::ExternalControl { host: host?, port: port? }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::read::read_sim;

    fn read(section: &str) -> Result<Programs, String> {
        const SIM: &str = include_str!("../../../../config/sim.yaml");
        let text = SIM.replace("\nprograms: {}", &format!("\nprograms: {section}"));
        assert_ne!(text, SIM);
        let file = read_sim(&text, "sim.yaml").map_err(|complaints| complaints.to_string())?;
        Ok((file.program_folder, file.programs))
    }

    #[test]
    fn programs_have_a_folder_on_the_controller_and_pcs_that_hand_them_out() {
        let (folder, files) = read(
            "{folder: mine, at: /ursim/programs, external_control: [{name: a.urp, host: pc.local}, {name: \
             /usb/b.urp, host: 10.0.0.2, port: 7}]}",
        )
        .unwrap();
        assert_eq!(folder.as_deref(), Some("mine"));
        let source = |host: &str, port| ProgramSource::ExternalControl { host: host.to_owned(), port };
        assert_eq!(
            files.iter().collect::<Vec<_>>(),
            [("/ursim/programs/a.urp", &source("pc.local", 50_002)), ("/usb/b.urp", &source("10.0.0.2", 7))]
        );
    }

    #[test]
    fn what_no_controller_could_load_is_reported() {
        for (section, complaint) in [
            ("{at: programs}", "is not a folder of the controller"),
            ("{external_control: [{name: a, host: pc}]}", "\"a\" is not the file of a program"),
            ("{external_control: [{name: a.urp}]}", "host"),
            ("{external_control: [{name: a.urp, host: \"http://pc\"}]}", "is not a host name"),
            ("{external_control: [{name: a.urp, host: pc, port: 0}]}", "port"),
            (
                "{external_control: [{name: a.urp, host: pc}, {name: /programs/a.urp, host: pc}]}",
                "there are two programs called /programs/a.urp",
            ),
        ] {
            let reported = read(section).unwrap_err();
            assert!(reported.contains(complaint), "{section}: {reported}");
        }
    }
}
