//! Files that are written whole, read with bounds, removed, shared with a group.

use super::*;

#[test]
fn atomic_write_replaces_and_leaves_no_temporary_file() {
    for write in [write_atomic, write_whole] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("status.json");
        write(&path, b"one").unwrap();
        write(&path, b"two").unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"two");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        // A folder cannot be replaced; what was written beside it is gone.
        assert!(write(folder.path(), b"three").is_err());
        let beside = std::fs::read_dir(folder.path().parent().unwrap()).unwrap();
        let own = format!(".{}.", folder.path().file_name().unwrap().to_string_lossy());
        let mut left =
            beside.filter(|entry| entry.as_ref().unwrap().file_name().to_string_lossy().starts_with(&own));
        assert!(left.next().is_none());
    }
}

#[test]
fn a_link_under_the_name_of_a_file_is_replaced_and_never_followed() {
    for write in [write_atomic, write_whole] {
        let folder = tempfile::tempdir().unwrap();
        let (path, other) = (folder.path().join("status.json"), folder.path().join("other"));
        std::fs::write(&other, "kept").unwrap();
        std::os::unix::fs::symlink(&other, &path).unwrap();
        // The name of earlier versions, which could be foreseen.
        let foreseen = folder.path().join(format!(".status.json.{}.tmp", std::process::id()));
        std::os::unix::fs::symlink(&other, foreseen).unwrap();
        write(&path, b"new").unwrap();
        assert_eq!(std::fs::read_to_string(&other).unwrap(), "kept");
        assert!(!path.symlink_metadata().unwrap().is_symlink());
    }
}

#[test]
fn a_secret_is_read_by_whom_it_is_for() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("answer");
    for (for_the_group, mode) in [(true, FOR_THE_GROUP), (false, FOR_ONE)] {
        write_secret(&path, b"secret", for_the_group).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"secret");
        assert_eq!(path.metadata().unwrap().mode() & 0o777, mode);
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn a_new_file_takes_the_first_free_name_and_is_readable_by_its_group() {
    let folder = tempfile::tempdir().unwrap();
    let names = || (1..=2).map(|number| format!("job.{number}"));
    assert_eq!(write_new(folder.path(), names(), b"one").unwrap(), "job.1");
    assert_eq!(write_new(folder.path(), names(), b"two").unwrap(), "job.2");
    assert!(write_new(folder.path(), names(), b"three").unwrap_err().is_present());
    assert!(write_new(folder.path(), std::iter::empty(), b"four").is_err());
    assert_eq!(std::fs::read(folder.path().join("job.1")).unwrap(), b"one");
    let mode = folder.path().join("job.2").metadata().unwrap().mode();
    assert_ne!(mode & 0o400, 0);
    std::fs::set_permissions(folder.path(), Permissions::from_mode(0o2770)).unwrap();
    let shared = write_new(folder.path(), ["job.3".to_string()].into_iter(), b"three").unwrap();
    assert_eq!(folder.path().join(shared).metadata().unwrap().mode() & 0o777, FOR_THE_GROUP);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 3);
}

#[test]
fn a_file_that_is_replaced_all_the_time_is_read_each_time() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("status.json");
    std::fs::write(&path, "0").unwrap();
    let over = std::sync::atomic::AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            let new = folder.path().join("new");
            while !over.load(std::sync::atomic::Ordering::Relaxed) {
                std::fs::write(&new, "0").and_then(|()| std::fs::rename(&new, &path)).unwrap();
            }
        });
        let read: Vec<_> = (0..5000).map(|_| read_regular(&path, 100).map(|(text, _)| text)).collect();
        over.store(true, std::sync::atomic::Ordering::Relaxed);
        let failed: Vec<_> = read.into_iter().filter(|read| read.as_deref().ok() != Some("0")).collect();
        assert!(failed.is_empty(), "{}: {:?}", failed.len(), failed.first());
    });
}

#[test]
fn drafts_of_the_killed_are_removed_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    for name in [".status.json.x1.tmp", "a.tmp", ".hidden"] {
        std::fs::write(path(name), "x").unwrap();
    }
    std::fs::create_dir(path(".folder.tmp")).unwrap();
    remove_drafts(folder.path(), Duration::from_secs(3600)).unwrap();
    assert!(path(".status.json.x1.tmp").exists(), "it may be being written");
    remove_drafts(folder.path(), Duration::ZERO).unwrap();
    assert!(!path(".status.json.x1.tmp").exists());
    assert!(path("a.tmp").exists() && path(".hidden").exists() && path(".folder.tmp").exists());
}

#[test]
fn a_folder_is_shared_with_a_group_where_its_root_is() {
    let folder = tempfile::tempdir().unwrap();
    let mode = |path: &Path| path.metadata().unwrap().mode() & 0o7777;
    let alone = folder.path().join("alone");
    create_group_folder(folder.path(), &alone).unwrap();
    assert_eq!(mode(&alone) & (SETGID | 0o020), 0);
    std::fs::set_permissions(folder.path(), Permissions::from_mode(0o2750)).unwrap();
    create_group_folder(folder.path(), &alone).unwrap();
    assert_eq!(mode(&alone), GROUP_FOLDER);
}

#[test]
fn rename_never_overwrites() {
    let folder = tempfile::tempdir().unwrap();
    let (a, b) = (folder.path().join("a"), folder.path().join("b"));
    std::fs::write(&a, "a").unwrap();
    std::fs::write(&b, "b").unwrap();
    assert!(rename_new(&a, &b).unwrap_err().is_present());
    assert!(rename_new(&folder.path().join("c"), &folder.path().join("d")).unwrap_err().is_absent());
    assert_eq!(std::fs::read_to_string(&b).unwrap(), "b");
}

#[track_caller]
fn check_unfit(prepare: impl FnOnce(&Path, &Path), expected: Unfit) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("job.yaml");
    prepare(folder.path(), &path);
    match read_regular(&path, 10) {
        Err(FileError::Unfit { problem, .. }) => assert_eq!(problem, expected),
        other => panic!("{other:?}"),
    }
}

#[test]
fn links_fifos_folders_and_large_files_are_refused() {
    let write = |path: PathBuf| std::fs::write(path, "x").unwrap();
    check_unfit(|_, path| std::fs::create_dir(path).unwrap(), Unfit::NotRegular);
    check_unfit(
        |folder, path| {
            write(folder.join("other"));
            std::os::unix::fs::symlink(folder.join("other"), path).unwrap();
        },
        Unfit::NotRegular,
    );
    check_unfit(
        |folder, path| {
            write(folder.join("other"));
            std::fs::hard_link(folder.join("other"), path).unwrap();
        },
        Unfit::HardLinked(2),
    );
    check_unfit(
        |_, path| {
            let mode = rustix::fs::Mode::from_raw_mode(0o600);
            rustix::fs::mknodat(CWD, path, rustix::fs::FileType::Fifo, mode, 0).unwrap();
        },
        Unfit::NotRegular,
    );
    check_unfit(|_, path| std::fs::write(path, "12345678901").unwrap(), Unfit::TooLarge(10));
    check_unfit(|_, path| std::fs::write(path, [0xff, 0xfe]).unwrap(), Unfit::NotText);
}

#[test]
fn a_named_file_may_be_a_link_but_never_a_device_or_a_fifo() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    std::fs::write(path("text"), "text").unwrap();
    std::os::unix::fs::symlink(path("text"), path("link")).unwrap();
    std::fs::hard_link(path("text"), path("hard")).unwrap();
    for name in ["text", "link", "hard"] {
        assert_eq!(read_named(&path(name), 10).unwrap(), "text");
    }
    let mode = rustix::fs::Mode::from_raw_mode(0o600);
    rustix::fs::mknodat(CWD, path("fifo"), rustix::fs::FileType::Fifo, mode, 0).unwrap();
    std::os::unix::fs::symlink("/dev/zero", path("zero")).unwrap();
    for unfit in [path("fifo"), path("zero"), folder.path().to_owned()] {
        let problem = read_named(&unfit, 10).unwrap_err();
        assert_eq!(problem.reason(), "not a regular file", "{}", unfit.display());
    }
    assert_eq!(read_named(&path("text"), 3).unwrap_err().reason(), "larger than 3 bytes");
    assert!(read_named(&path("absent"), 3).unwrap_err().is_absent());
}
