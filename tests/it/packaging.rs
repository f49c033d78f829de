//! What makes celld a service: the unit, account and folders, the scripts of the package, `make install`.
//!
//! In: the files of `hardware/systemd` and `hardware/debian`, the Makefile. Out: every promise that is not
//! kept. Nothing here needs root or a running systemd; what installing does to a whole system is tried by
//! `make test-deb`.

use std::collections::BTreeMap;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

const UNIT: &str = include_str!("../../hardware/systemd/celld.service");
const TMPFILES: &str = include_str!("../../hardware/systemd/celld.tmpfiles");
const SYSUSERS: &str = include_str!("../../hardware/systemd/celld.sysusers");
const SET_UP: &str = include_str!("../../hardware/systemd/set-up");
const CAMERAS: &str = include_str!("../../hardware/systemd/60-celld-camera.rules");
const CONFFILES: &str = include_str!("../../hardware/debian/conffiles");

/// Below [`root`], in POSIX shell.
const SCRIPTS: [&str; 5] = [
    "hardware/systemd/set-up",
    "hardware/systemd/address-filter",
    "hardware/debian/postinst",
    "hardware/debian/prerm",
    "hardware/debian/postrm",
];

/// Below the prefix, with its mode.
const INSTALLED: [(&str, u32); 13] = [
    ("bin/celld", 0o755),
    ("bin/celld-sim", 0o755),
    ("bin/celld-video", 0o755),
    ("lib/celld/set-up", 0o755),
    ("lib/celld/address-filter", 0o755),
    ("lib/systemd/system/celld.service", 0o644),
    ("lib/sysusers.d/celld.conf", 0o644),
    ("lib/tmpfiles.d/celld.conf", 0o644),
    ("lib/udev/rules.d/60-celld-camera.rules", 0o644),
    ("share/celld/examples/cell.yaml", 0o644),
    ("share/celld/examples/sim.yaml", 0o644),
    ("share/celld/examples/calibration/sim/camera.yaml", 0o644),
    ("share/doc/celld/docs/operation.md", 0o644),
];

/// Paths that stay as they are in whatever prefix.
const ETC: &str = "etc/celld/environment";

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&[output.stdout.clone(), output.stderr.clone()].concat()).into_owned()
}

/// A program that is not on every computer; `None` says loudly what is not tried.
fn program(name: &str, what: &str) -> Option<PathBuf> {
    let folders = std::env::var_os("PATH").unwrap_or_default();
    let found = std::env::split_paths(&folders).map(|folder| folder.join(name)).find(|path| path.is_file());
    if found.is_none() {
        eprintln!("SKIPPED: no {name} here, {what} is not tried");
    }
    found
}

/// The lines of a section without comments, as key and value.
fn settings<'a>(unit: &'a str, section: &str) -> Vec<(&'a str, &'a str)> {
    let lines = unit.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#'));
    let inside = lines.skip_while(|line| *line != format!("[{section}]")).skip(1);
    let inside = inside.take_while(|line| !line.starts_with('['));
    inside.map(|line| line.split_once('=').unwrap_or_else(|| panic!("no setting: {line}"))).collect()
}

fn service() -> Vec<(&'static str, &'static str)> {
    settings(UNIT, "Service")
}

fn seconds(key: &str) -> u32 {
    let found = service().into_iter().find(|(found, _)| *found == key);
    let (_, value) = found.unwrap_or_else(|| panic!("no {key}"));
    value.parse().unwrap_or_else(|error| panic!("{key}={value}: {error}"))
}

#[test]
fn the_unit_has_what_the_daemon_rests_on() {
    let service = service();
    let required = [
        ("Type", "notify"),
        ("NotifyAccess", "main"),
        ("ExecStart", "/usr/bin/celld run --config /etc/celld/cell.yaml --state /var/lib/celld"),
        ("User", "celld"),
        ("Group", "celld"),
        ("SupplementaryGroups", "video plugdev"),
        ("UMask", "0027"),
        ("StateDirectory", "celld"),
        ("StateDirectoryMode", "2750"),
        ("ConfigurationDirectory", "celld"),
        ("KillSignal", "SIGTERM"),
        ("KillMode", "mixed"),
        ("OOMPolicy", "continue"),
        ("Restart", "on-failure"),
        ("RestartPreventExitStatus", "2"),
        ("SuccessExitStatus", "130 75"),
        ("RestartForceExitStatus", "75"),
        ("LimitNICE", "-10"),
        ("LimitRTPRIO", "10"),
        ("IPAddressDeny", "any"),
        ("IPAddressAllow", "localhost"),
        ("RestrictAddressFamilies", "AF_UNIX AF_INET AF_INET6 AF_NETLINK"),
        ("CapabilityBoundingSet", ""),
        ("NoNewPrivileges", "yes"),
        ("ProtectSystem", "strict"),
        ("ProtectHome", "yes"),
        ("PrivateTmp", "yes"),
        ("ProtectControlGroups", "yes"),
        ("ProtectKernelLogs", "yes"),
        ("ProtectKernelModules", "yes"),
        ("ProtectKernelTunables", "yes"),
        ("LockPersonality", "yes"),
        ("RestrictNamespaces", "yes"),
        ("SystemCallArchitectures", "native"),
        ("SystemCallFilter", "@system-service"),
    ];
    let missing: Vec<_> = required.iter().filter(|wanted| !service.contains(wanted)).collect();
    assert!(missing.is_empty(), "{missing:?}");
    let limits = settings(UNIT, "Unit").into_iter().filter(|(key, _)| key.starts_with("StartLimit")).count();
    assert_eq!(limits, 2, "a celld that cannot run is not started for ever");
}

#[test]
fn a_camera_stays_within_reach() {
    let service = service();
    // The first two hide cameras, or replace the list of devices by one without them; the others forbid a
    // priority, and leave users in the log without their numbers.
    for trap in ["PrivateDevices", "ProtectClock", "RestrictRealtime", "PrivateUsers"] {
        assert!(!service.iter().any(|(key, _)| *key == trap), "{trap}");
    }
    for allowed in ["char-video4linux rw", "char-usb_device rw"] {
        assert!(service.contains(&("DeviceAllow", allowed)), "{allowed}");
    }
    // The list is made when the service starts: the kernel has to know the group by then.
    let unit = settings(UNIT, "Unit");
    for key in ["Wants", "After"] {
        let module =
            |(found, value): &(&str, &str)| *found == key && value.contains("modprobe@uvcvideo.service");
        assert!(unit.iter().any(module), "{key}");
    }
    let usb = CAMERAS.lines().find(|line| line.starts_with("SUBSYSTEM==\"usb\"")).expect("a rule");
    for part in ["ATTR{idVendor}==\"8086\"", "0b5b", "GROUP=\"plugdev\"", "MODE=\"0660\""] {
        assert!(usb.contains(part), "{part}: {usb}");
    }
}

#[test]
fn the_watchdog_is_patient_and_an_end_is_waited_for() {
    assert!((5..=30).contains(&seconds("WatchdogSec")));
    // Arm and gripper (6 s), the disk (15 s), the recording (3 s), the log (1.5 s), systemd (1 s).
    let longest = 6.0 + 15.0 + 3.0 + 1.5 + 1.0;
    assert!(seconds("TimeoutStopSec") as f64 > longest);
    assert!(seconds("TimeoutStartSec") >= 30);
}

#[test]
fn folders_and_account_are_the_same_with_and_without_systemd() {
    let lines = TMPFILES.lines().filter(|line| !line.starts_with('#'));
    let folders: BTreeMap<&str, &str> = lines
        .map(|line| match line.split_whitespace().collect::<Vec<_>>()[..] {
            ["d", path, mode, "celld", "celld", "-"] => (path, mode),
            _ => panic!("{line}"),
        })
        .collect();
    let expected = [
        ("/var/lib/celld", "2750"),
        ("/var/lib/celld/commands", "2770"),
        ("/var/lib/celld/jobs", "2750"),
        ("/var/lib/celld/jobs/incoming", "2770"),
        ("/var/lib/celld/recordings", "2750"),
    ];
    assert_eq!(folders, BTreeMap::from(expected));
    for line in [
        "install -d -o celld -g celld -m 2750 \"$state\"",
        "chmod 2750 jobs recordings",
        "chmod 2770 jobs/incoming commands",
        "install -d -o root -g celld -m 2750 \"$configuration\"",
    ] {
        assert!(SET_UP.contains(line), "{line}");
    }
    for part in ["/var/lib/celld", "/usr/sbin/nologin", "celld, the daemon of a robot cell"] {
        assert!(SYSUSERS.contains(part) && SET_UP.contains(part), "{part}");
    }
    for group in ["video", "plugdev"] {
        assert!(SYSUSERS.contains(&format!("m celld {group}")) && SET_UP.contains(group), "{group}");
    }
    assert!(!CONFFILES.contains("cell.yaml"), "every cell changes it: an update must raise no question");
}

#[test]
fn scripts_are_sound_and_end_at_the_first_fault() {
    for script in SCRIPTS {
        let path = root().join(script);
        let text = std::fs::read_to_string(&path).expect("a script");
        assert!(text.starts_with("#!/bin/sh\n") && text.contains("\nset -eu\n"), "{script}");
        let run = Command::new("sh").arg("-n").arg(&path).output().expect("a shell");
        assert!(run.status.success(), "{script}: {}", said(&run));
    }
    let Some(bash) = program("bash", "the syntax of scripts for it") else { return };
    for script in ["tests/package.sh", ".ci/run", ".ci/tree"] {
        let run = Command::new(&bash).arg("-n").arg(root().join(script)).output().expect("bash");
        assert!(run.status.success(), "{script}: {}", said(&run));
    }
}

/// A folder with stand-ins for the binaries: `celld unit` answers with a filter.
fn binaries(folder: &Path) -> PathBuf {
    let binaries = folder.join("binaries");
    std::fs::create_dir(&binaries).expect("a folder");
    for name in ["celld", "celld-sim", "celld-video"] {
        let path = binaries.join(name);
        std::fs::write(&path, "#!/bin/sh\necho '# of no cell'\n").expect("written");
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).expect("executable");
    }
    binaries
}

/// `make` as at a terminal, also when make runs the tests.
fn make(words: &[String]) -> Option<String> {
    let mut command = Command::new(program("make", "make install")?);
    for inherited in
        ["MAKEFLAGS", "MFLAGS", "MAKELEVEL", "MAKEOVERRIDES", "GNUMAKEFLAGS", "DESTDIR", "PREFIX"]
    {
        command.env_remove(inherited);
    }
    let run = command.current_dir(root()).args(words).output().expect("make");
    assert!(run.status.success(), "make {words:?}: {}", said(&run));
    Some(said(&run))
}

fn files_below(folder: &Path) -> Vec<PathBuf> {
    let (mut folders, mut files) = (vec![folder.to_path_buf()], Vec::new());
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).expect("a folder").flatten() {
            if entry.path().is_dir() { folders.push(entry.path()) } else { files.push(entry.path()) }
        }
    }
    files
}

#[test]
fn make_install_places_every_file_and_make_uninstall_removes_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let target = folder.path().join("target");
    let given = [
        format!("DESTDIR={}", target.display()),
        "PREFIX=/opt/celld".to_string(),
        format!("BINARIES={}", binaries(folder.path()).display()),
    ];
    let words = |goal: &[&str]| [goal.iter().map(ToString::to_string).collect(), given.to_vec()].concat();
    let Some(dry) = make(&words(&["-n", "install"])) else { return };
    assert!(!target.exists());
    make(&words(&["install"]));
    for (path, mode) in INSTALLED {
        let named = target.join("opt/celld").join(path);
        assert!(dry.contains(&named.display().to_string()), "{path}");
        let found = named.metadata().unwrap_or_else(|error| panic!("{path}: {error}")).permissions().mode();
        assert_eq!(found & 0o7777, mode, "{path}");
    }
    let text = |path: &str| std::fs::read_to_string(target.join(path)).expect("installed");
    let unit = text("opt/celld/lib/systemd/system/celld.service");
    let paths =
        ["=/opt/celld/bin/celld run", "=-/opt/celld/lib/celld/address-filter", "=+/usr/bin/systemd-tmpfiles"];
    assert!(paths.iter().all(|path| unit.contains(path)), "{unit}");
    // What a person changed is not overwritten.
    std::fs::write(target.join(ETC), "changed").expect("written");
    make(&words(&["install"]));
    assert_eq!(text(ETC), "changed");
    // The example works where it is installed.
    let example = target.join("opt/celld/share/celld/examples/cell.yaml");
    let run = Command::new(env!("CARGO_BIN_EXE_celld")).arg("check").arg(&example).output().expect("celld");
    assert!(run.status.success(), "{}", said(&run));
    let example = std::fs::read_to_string(example).expect("installed");
    assert!(example.contains("recording: {folder: /var/lib/celld/recordings"), "{example}");
    make(&words(&["uninstall"]));
    assert_eq!(files_below(&target), [target.join(ETC)]);
}

#[test]
fn a_filter_that_is_not_that_of_the_configuration_is_said_in_words() {
    let folder = tempfile::tempdir().expect("a folder");
    let given = [
        "install".to_string(),
        format!("DESTDIR={}", folder.path().join("target").display()),
        format!("PREFIX={}", folder.path().join("target/usr").display()),
        format!("BINARIES={}", binaries(folder.path()).display()),
    ];
    if make(&given).is_none() {
        return;
    }
    // Installed below DESTDIR, it calls the celld below PREFIX, which is put there too.
    let inside = folder.path().join("target").join(folder.path().strip_prefix("/").expect("absolute"));
    std::fs::rename(inside.join("target/usr"), folder.path().join("target/usr")).expect("moved");
    let script = folder.path().join("target/usr/lib/celld/address-filter");
    let run = |word: &str| Command::new(&script).arg(word).output().expect("the script");
    let check = run("check");
    assert_eq!(check.status.code(), Some(1));
    assert!(said(&check).contains("is not that of /etc/celld/cell.yaml"), "{}", said(&check));
    assert_eq!(run("").status.code(), Some(2));
}

#[test]
fn systemd_has_nothing_to_say_about_the_unit() {
    let Some(analyze) = program("systemd-analyze", "the unit under `systemd-analyze verify`") else { return };
    let folder = tempfile::tempdir().expect("a folder");
    // Programs have to be there: those of this build in place of the installed ones.
    let filter = root().join("hardware/systemd/address-filter").display().to_string();
    let unit = UNIT.replace("/usr/bin/celld ", concat!(env!("CARGO_BIN_EXE_celld"), " "));
    let unit = unit.replace("/usr/lib/celld/address-filter", &filter);
    let path = folder.path().join("celld.service");
    std::fs::write(&path, unit).expect("written");
    let run =
        Command::new(analyze).args(["verify", "--man=no"]).arg(&path).output().expect("systemd-analyze");
    let about_celld = said(&run).lines().filter(|line| line.contains("celld")).collect::<Vec<_>>().join("\n");
    assert!(run.status.success() && about_celld.is_empty(), "{}", said(&run));
}
