//! Tests of a database file that becomes read-only, disappears, comes back or is replaced while the aggregator runs.

use std::path::{Path, PathBuf};

use peernet_tests::fleet::{agent_configuration, echo_pipeline, rate_load};
use peernet_tests::truth::query_database;
use peernet_tests::{Fleet, ImageDisk, StoredEvents, wait_until};

/// Returns the files of a database.
fn files(database: &Path) -> [PathBuf; 3] {
    ["", "-wal", "-shm"].map(|suffix| PathBuf::from(format!("{}{suffix}", database.display())))
}

/// Starts an aggregator whose database is on a separate disk, and an agent that has stored something.
fn start_fleet_on(disk: &ImageDisk) -> Fleet {
    start_fleet_with_database(&disk.folder().join("aggregator.sqlite"))
}

fn start_fleet_with_database(database: &Path) -> Fleet {
    let configuration = agent_configuration("", &echo_pipeline("loop", &rate_load(200.0)));
    let mut fleet = Fleet::with_database(&database.display().to_string(), &["edge"], &configuration);
    fleet.start(0);
    fleet.wait_for_counts(0, "something is stored", |counts| counts.stored > 100);
    fleet
}

/// Waits until the aggregator is not ready, with this text in the reason.
fn wait_until_not_ready(fleet: &Fleet, text: &str) {
    wait_until(&format!("not ready: {text}"), || {
        fleet.api.get("/readyz").filter(|(status, answer)| *status == 503 && answer.contains(text))
    });
}

/// Waits until the aggregator is ready and has stored the events that waited on its agent.
fn wait_until_storing(fleet: &Fleet) {
    wait_until("ready", || fleet.api.get("/readyz").filter(|(status, _)| *status == 200));
    fleet.wait_for_counts(0, "the waiting events are stored", |counts| {
        counts.waiting < 100 && counts.stored > 0
    });
}

/// Stops everything; checks that each produced event is stored or counted as dropped.
fn assert_all_accounted_for(fleet: &mut Fleet) -> StoredEvents {
    fleet.agents[0].stop();
    fleet.deliver_spool(0).assert_balanced();
    fleet.stop()
}

/// Stops everything; checks that no event is missing.
fn assert_nothing_is_missing(fleet: &mut Fleet) {
    let stored_events = assert_all_accounted_for(fleet);
    assert_eq!(stored_events.count_missing(fleet.agents[0].spooled_iterations()), 0, "{stored_events:?}");
    assert_eq!(stored_events.hosts["edge"].gaps, 0, "{stored_events:?}");
    assert!(stored_events.runs.values().all(|run| run.is_contiguous()), "{stored_events:?}");
}

/// Returns whether the aggregator has one of the database's files open.
fn has_open_files(fleet: &Fleet, folder: &Path) -> bool {
    let open = format!("/proc/{}/fd", fleet.aggregator.process().pid());
    let entries = std::fs::read_dir(open).expect("it runs");
    entries
        .flatten()
        .filter_map(|entry| std::fs::read_link(entry.path()).ok())
        .any(|file| file.starts_with(folder) && file.to_string_lossy().contains(".sqlite"))
}

#[test]
fn storing_recovers_after_database_was_read_only() {
    let disk = ImageDisk::new(64 << 20);
    let mut fleet = start_fleet_on(&disk);
    let database = fleet.database().to_owned();
    // Open descriptors cannot write any more, and new descriptors can only read. The third file is excluded: it is mapped
    // into memory, and the kernel ends a process that writes to a mapping of an immutable file.
    let writable_files = &files(&database)[..2];
    disk.set_immutable(writable_files, true);
    wait_until_not_ready(&fleet, "cannot store events");
    disk.set_immutable(writable_files, false);
    wait_until_storing(&fleet);

    disk.set_immutable(writable_files, true);
    wait_until_not_ready(&fleet, "cannot store events");
    wait_until("the files are closed", || (!has_open_files(&fleet, disk.folder())).then_some(()));
    disk.set_immutable(writable_files, false);
    disk.remount("ro");
    // This matches `Read-only` and `read-only`.
    wait_until_not_ready(&fleet, "ead-only");
    disk.remount("rw");
    wait_until_storing(&fleet);
    assert_nothing_is_missing(&mut fleet);
}

#[test]
fn storing_recovers_after_unmount_and_mount() {
    let disk = ImageDisk::new(64 << 20);
    let mut fleet = start_fleet_on(&disk);
    disk.unmount();
    wait_until_not_ready(&fleet, "not mounted");
    // The file system must be released, so that it can be checked or mounted elsewhere.
    wait_until("the device is free", || (!disk.is_in_use()).then_some(()));
    let folder = std::fs::read_dir(disk.folder()).expect("the mount point is there");
    assert_eq!(folder.count(), 0, "nothing is created in the empty mount point");
    disk.mount();
    wait_until_storing(&fleet);
    assert_nothing_is_missing(&mut fleet);
}

#[test]
fn moved_database_is_closed_and_reopened() {
    let folder = tempfile::tempdir().expect("a folder");
    let (original, moved) = (folder.path().join("here"), folder.path().join("away"));
    std::fs::create_dir(&original).expect("a folder");
    let mut fleet = start_fleet_with_database(&original.join("aggregator.sqlite"));
    std::fs::rename(&original, &moved).expect("moves");
    wait_until_not_ready(&fleet, "deleted, moved or replaced");
    wait_until("the files are closed", || (!has_open_files(&fleet, folder.path())).then_some(()));
    std::fs::rename(&moved, &original).expect("moves back");
    wait_until_storing(&fleet);
    assert_nothing_is_missing(&mut fleet);
}

#[test]
fn database_replaced_by_backup_is_compared_with_spools() {
    let mut fleet =
        Fleet::new(&["edge"], &agent_configuration("", &echo_pipeline("loop", &rate_load(200.0))));
    fleet.start(0);
    fleet.wait_for_counts(0, "something is stored", |counts| counts.stored > 200);
    let database = fleet.database().to_owned();
    let backup = fleet.deployment.folder().join("backup.sqlite");
    let backup_end = fleet
        .deployment
        .peernetd(&["backup", "--database", &database.display().to_string(), &backup.display().to_string()])
        .wait_for_end();
    assert_eq!(backup_end.code(), 0, "{}", backup_end.log);
    let backup_events = StoredEvents::read(&backup);
    let before = fleet.wait_for_counts(0, "the agent reports", |_| true);
    fleet.wait_for_counts(0, "more is stored", |counts| counts.acknowledged > before.acknowledged + 200);

    let [main, log, shared] = files(&database);
    for file in [&main, &log, &shared] {
        let moved = file.with_extension(format!(
            "{}-away",
            file.extension().expect("the file has an extension").to_string_lossy()
        ));
        std::fs::rename(file, moved).expect("moves");
    }
    wait_until_not_ready(&fleet, "cannot store events");
    std::fs::rename(&backup, &main).expect("restores");
    wait_until_storing(&fleet);
    fleet.wait_for_counts(0, "newer events are stored", |counts| {
        counts.stored > backup_events.iterations() + 200
    });
    let stored_events = assert_all_accounted_for(&mut fleet);
    let (host, run) = (&stored_events.hosts["edge"], stored_events.runs.values().next().expect("one run"));
    assert_eq!((host.gaps, host.quarantined, stored_events.runs.len()), (1, 0, 1), "{stored_events:?}");
    assert_eq!((run.ranges.len(), run.reason.as_str()), (2, "stopped"), "one gap: {run:?}");
    assert_eq!(run.ranges[0], 1..=backup_events.iterations());
    let reason = query_database(fleet.database(), "SELECT reason FROM gap");
    assert!(reason.contains("batches"), "{reason}");
}

/// Checks that a second aggregator is refused if its path leads to the database of the first.
fn assert_second_is_refused(fleet: &Fleet, database: &Path) {
    let tables = format!(
        "[aggregator]\nname = \"second\"\nlisten = \"tcp://127.0.0.1:{}\"\ndatabase = \"{}\"\n\
         [web]\nlisten = \"127.0.0.1:{}\"\n",
        peernet_tests::free_port(),
        database.display(),
        peernet_tests::free_port()
    );
    fleet.deployment.write("second.toml", &tables);
    let end = fleet.deployment.start("second.toml").wait_for_end();
    assert_eq!(end.code(), 69, "{}", end.log);
    let holder = format!("pid {}", fleet.aggregator.process().pid());
    let names_file_and_holder =
        end.log.contains(&holder) && end.log.contains(&database.display().to_string());
    assert!(names_file_and_holder, "the log does not name the file and {holder}:\n{}", end.log);
}

#[test]
fn second_aggregator_through_another_name_is_refused() {
    let disk = ImageDisk::new(64 << 20);
    let mut fleet = start_fleet_on(&disk);
    let hard_link = disk.folder().join("link.sqlite");
    std::fs::hard_link(fleet.database(), &hard_link).expect("links");
    assert_second_is_refused(&fleet, &hard_link);
    let second_mount = disk.mount_again();
    assert_second_is_refused(&fleet, &second_mount.folder().join("aggregator.sqlite"));
    assert_nothing_is_missing(&mut fleet);
}
