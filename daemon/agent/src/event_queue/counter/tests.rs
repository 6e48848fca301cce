//! Tests of counting with real files in shared memory.

use tempfile::TempDir;

use super::*;

fn at(nanos: i64) -> WallTime {
    WallTime::from_unix_nanos(nanos)
}

/// Creates a file in place of a spool. Returns its folder and the identity of the file.
fn spool() -> (TempDir, CountOwner) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("spool.sqlite");
    fs::write(&path, "").expect("written");
    let owner = CountOwner::from_path(&path).expect("is there");
    (folder, owner)
}

#[test]
fn counts_are_read_from_file_by_name() {
    let (_folder, owner) = spool();
    let (counter, pipeline) =
        (EventCounter::create(&owner).expect("shared memory"), "line".parse::<Slug>().ok());
    let name = counter.name().expect("a file");
    let (first, second) = (RunId::random(), RunId::random());
    for nanos in 1..=5 {
        counter.count(pipeline.as_ref(), Some(first), at(nanos));
    }
    counter.count(None, None, at(6));
    counter.count(pipeline.as_ref(), Some(second), at(7));
    let sent = |number| SentUnspooled { process: 7, number, batched: 4, reported_drops: 1, events: 5 };
    let slots = MAX_SENT_UNSPOOLED as u64;
    (1..=slots + 1).for_each(|number| counter.record_sent_unspooled(sent(number)));
    // The slot of a batch is its number modulo the number of slots. The last batch overwrites batch 1.
    let sent = [slots, slots + 1].into_iter().chain(2..slots).map(sent).collect();
    let run = |run, events, last| CountedRun { run, pipeline: pipeline.clone(), events, last: at(last) };
    let mut counted_events = read(&name, &owner).expect("readable");
    counted_events.runs.sort_by_key(|run| run.last);
    let runs = vec![run(first, 5, 5), run(second, 1, 7)];
    assert_eq!(counted_events, CountedEvents { total: 7, last: at(7), sent, runs });

    assert!(!counter.release_if_settled(second, 0), "the spool does not account for the event of this run");
    assert!(counter.release_if_settled(first, 5) && counter.release_if_settled(second, 1));
    let counted_events = read(&name, &owner).expect("readable");
    assert_eq!((counted_events.total, counted_events.runs.len()), (7, 0));
    counter.remove();
    assert_eq!(read(&name, &owner), None);
}

#[test]
fn deleted_file_is_created_again_with_its_counts() {
    let (_folder, owner) = spool();
    let counter = EventCounter::create(&owner).expect("shared memory");
    let (name, run) = (counter.name().expect("a file"), RunId::random());
    counter.count(None, Some(run), at(1));
    remove(&name);
    counter.recreate_if_deleted();
    counter.count(None, Some(run), at(2));
    let counted_events = read(&name, &owner).expect("is there");
    assert_eq!((counted_events.total, counted_events.runs[0].events), (2, 2));
    counter.remove();
}

#[test]
fn fifo_with_name_of_count_file_is_not_read() {
    let (_folder, owner) = spool();
    let name = format!("peernet-{}.count", Uuid::new_v4());
    let path = Path::new(SHARED_MEMORY).join(&name);
    let status = std::process::Command::new("mkfifo").arg(&path).status().expect("coreutils");
    assert!(status.success() && read(&name, &owner).is_none());
    fs::remove_file(path).expect("is there");
}

#[test]
fn runs_beyond_capacity_are_counted_in_total() {
    let (_folder, owner) = spool();
    let counter = EventCounter::create(&owner).expect("shared memory");
    let runs: Vec<RunId> = (0..=MAX_COUNTED_RUNS).map(|_| RunId::random()).collect();
    runs.iter().for_each(|run| counter.count(None, Some(*run), at(1)));
    let counted_events = read(&counter.name().expect("a file"), &owner).expect("readable");
    assert_eq!(
        (counted_events.total, counted_events.runs.len()),
        (MAX_COUNTED_RUNS as u64 + 1, MAX_COUNTED_RUNS)
    );
    assert!(counter.release_if_settled(runs[0], 1));
    counter.count(None, Some(RunId::random()), at(2));
    let counted_events = read(&counter.name().expect("a file"), &owner).expect("readable");
    assert_eq!(
        (counted_events.total, counted_events.runs.len()),
        (MAX_COUNTED_RUNS as u64 + 2, MAX_COUNTED_RUNS)
    );
    counter.remove();
}

#[test]
fn file_without_process_and_spool_is_removed() {
    let (_caller_folder, caller_spool) = spool();
    let (folder, owner) = spool();
    let counter = EventCounter::create(&owner).expect("shared memory");
    let name = counter.name().expect("a file");
    let file_exists = || Path::new(SHARED_MEMORY).join(&name).exists();
    drop(folder);
    remove_abandoned(&caller_spool, &[]);
    assert!(file_exists(), "a process still counts in the file");
    drop(counter);
    remove_abandoned(&caller_spool, &[]);
    assert!(!file_exists());
}

#[test]
fn file_of_existing_spool_is_kept() {
    let (_caller_folder, caller_spool) = spool();
    let (_folder, owner) = spool();
    let counter = EventCounter::create(&owner).expect("shared memory");
    let name = counter.name().expect("a file");
    drop(counter);
    remove_abandoned(&caller_spool, &[]);
    assert!(
        read(&name, &owner).is_some(),
        "the agent of the existing spool needs the file at its next start"
    );
    remove_abandoned(&owner, &[&name]);
    assert!(read(&name, &owner).is_some(), "the caller needs the file");
    remove_abandoned(&owner, &[]);
    assert!(read(&name, &owner).is_none(), "the spool of the file does not need the file");
}

#[test]
fn files_of_unknown_spool_or_name_are_kept() {
    let (folder, owner) = spool();
    let (_caller_folder, caller_spool) = spool();
    let counter = EventCounter::create(&owner).expect("shared memory");
    let name = counter.name().expect("a file");
    drop(counter);
    let path = Path::new(SHARED_MEMORY).join(&name);
    // The file of an earlier version contains no identity of a spool.
    File::options()
        .write(true)
        .open(&path)
        .and_then(|file| file.write_all_at(b"PNcount2", 0))
        .expect("written");
    let copy = Path::new(SHARED_MEMORY).join(format!("{name}.kept"));
    fs::copy(&path, &copy).expect("copied");
    drop(folder);
    remove_abandoned(&caller_spool, &[]);
    assert!(path.exists() && copy.exists());
    assert!(
        read(&name, &caller_spool).is_some(),
        "without the identity of a spool, the name of the file is enough"
    );
    fs::remove_file(path).and_then(|()| fs::remove_file(copy)).expect("removed");
}
