//! Tests of a database page that is overwritten while the aggregator runs.

use std::os::unix::fs::FileExt;
use std::path::Path;

use peernet_tests::fleet::{agent_configuration, echo_pipeline, rate_load};
use peernet_tests::truth::query_database;
use peernet_tests::{Fleet, ProcessEnd, StoredEvents, record_measurements, thousands, wait_until};

/// Returns reproducible noise, such as a faulty disk, a stray write or `dd` may leave.
fn noise(seed: u64) -> Vec<u8> {
    let mut state = seed;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as u8
    };
    (0..4096).map(|_| next()).collect()
}

/// Overwrites 4 KiB, from `offset` bytes after the beginning of a page in the middle of a table.
fn overwrite(database: &Path, table: &str, offset: u64) {
    let pages = query_database(
        database,
        &format!("SELECT pageno FROM dbstat WHERE name = '{table}' AND pagetype = 'leaf' ORDER BY path"),
    );
    let pages: Vec<u64> = pages.lines().map(|page| page.parse().expect("a page's number")).collect();
    assert!(pages.len() > 4, "{table} has only the pages {pages:?}");
    let page = pages[pages.len() / 2];
    let file = std::fs::File::options().write(true).open(database).expect("the database exists");
    file.write_all_at(&noise(page), (page - 1) * 4096 + offset).expect("it can be written");
}

fn doctor(fleet: &Fleet, arguments: &[&str]) -> ProcessEnd {
    let database = fleet.database().display().to_string();
    let mut all_arguments = vec!["doctor"];
    all_arguments.extend(arguments);
    all_arguments.extend(["--database", &database]);
    fleet.deployment.peernetd(&all_arguments).wait_for_end()
}

fn is_ready(fleet: &Fleet) -> bool {
    fleet.api.get("/readyz").is_some_and(|(status, _)| status == 200)
}

fn wait_for_failure_reason(fleet: &Fleet) -> String {
    wait_until("not ready", || {
        fleet.api.get("/readyz").filter(|(status, _)| *status == 503).map(|(_, text)| text)
    })
}

/// Stores this number of events in the database file itself: pages in the write-ahead log would hide a
/// damaged page.
fn start_with_events_in_file(events: u64) -> Fleet {
    let mut fleet =
        Fleet::new(&["edge"], &agent_configuration("", &echo_pipeline("loop", &rate_load(400.0))));
    fleet.start(0);
    fleet.wait_for_counts(0, "something is stored", |counts| counts.stored > events);
    fleet.aggregator.stop();
    fleet.restart_aggregator();
    fleet
}

#[test]
fn damaged_page_stops_storing_until_repaired() {
    let mut fleet = start_with_events_in_file(2_000);
    wait_until("ready", || is_ready(&fleet).then_some(()));

    overwrite(fleet.database(), "node", 0);
    let reason = wait_for_failure_reason(&fleet);
    assert!(reason.contains("damaged") && reason.contains("peernetd doctor --repair"), "{reason}");
    // The agent reports the last acknowledgement a moment later.
    let first = fleet.wait_for_counts(0, "events wait", |counts| {
        counts.waiting > 100 && counts.acknowledged == counts.stored
    });
    let later = fleet.wait_for_counts(0, "more events wait", |counts| counts.waiting > first.waiting + 400);
    assert_eq!(
        (later.stored, later.acknowledged),
        (first.stored, first.acknowledged),
        "nothing more is acknowledged"
    );
    let (status, page) = fleet.api.get("/").expect("the dashboard answers");
    assert!(status == 200 && page.contains("damaged"), "the page does not report the damage: {page}");
    let refused = doctor(&fleet, &["--repair"]);
    assert_eq!(refused.code(), 69, "the aggregator runs: {}", refused.log);

    let log = fleet.aggregator.stop().log;
    assert_eq!(log.matches("ERROR aggregator: the database").count(), 1, "the error is logged once: {log}");
    fleet.restart_aggregator();
    let reason = wait_for_failure_reason(&fleet);
    assert!(reason.contains("damaged") && reason.contains("peernetd doctor --repair"), "{reason}");
    // The aggregator may have committed events without an acknowledgement while it found the damage. They count as
    // stored only since the restart, so the later counts are compared with the first counts after the restart.
    let first = fleet.wait_for_counts(0, "more wait than before", |counts| counts.waiting > later.waiting);
    let second = fleet.wait_for_counts(0, "even more wait", |counts| counts.waiting > first.waiting + 400);
    assert_eq!(second.stored, first.stored, "nothing more is stored");
    fleet.aggregator.stop();

    let diagnosis = doctor(&fleet, &[]);
    assert_eq!(diagnosis.code(), 65, "{}", diagnosis.log);
    assert!(diagnosis.log.contains("--repair"), "{}", diagnosis.log);
    assert_continues_after_repair(fleet, "a page of nodes");
}

#[test]
fn damage_across_pages_of_several_tables_is_repaired() {
    let mut fleet = start_with_events_in_file(2_000);
    for (table, offset) in [("iteration", 100), ("rollup", 2_000), ("node", 4_000)] {
        overwrite(fleet.database(), table, offset);
    }
    let reason = wait_for_failure_reason(&fleet);
    assert!(reason.contains("damaged"), "{reason}");
    // The killed aggregator leaves its write-ahead log beside the file.
    fleet.aggregator.kill();
    assert_continues_after_repair(fleet, "pages of three tables");
}

/// Repairs the database, and checks that every measured event is stored or in a gap.
fn assert_continues_after_repair(mut fleet: Fleet, title: &str) {
    let repair = doctor(&fleet, &["--repair"]);
    assert_eq!(repair.code(), 0, "{}", repair.log);
    assert!(repair.log.contains(".damaged-") && repair.log.contains("iteration"), "{}", repair.log);
    let check = doctor(&fleet, &["--full"]);
    assert_eq!(check.code(), 0, "{}", check.log);
    let second_repair = doctor(&fleet, &["--repair"]);
    assert!(second_repair.code() == 0 && second_repair.log.contains("not damaged"), "{}", second_repair.log);

    fleet.restart_aggregator();
    wait_until("ready", || is_ready(&fleet).then_some(()));
    fleet.agents[0].stop();
    fleet.start_without_pipelines(0);
    let counts = fleet.wait_for_counts(0, "everything is delivered", |counts| {
        counts.waiting == 0 && counts.stored + counts.missing == counts.produced
    });
    assert_eq!((counts.dropped, counts.acknowledged), (0, counts.produced), "{counts:?}");
    assert!(counts.missing > 0, "{counts:?}");
    fleet.agents[0].stop();
    fleet.aggregator.stop();

    let stored_events = StoredEvents::read(fleet.database());
    let [run] = stored_events.runs.values().collect::<Vec<_>>()[..] else {
        panic!("one run: {stored_events:?}")
    };
    assert_eq!(run.counted_iterations, run.iterations(), "{run:?}");
    assert_eq!((run.iterations_with_nodes, run.incomplete_iterations), (run.iterations(), 0), "{run:?}");
    assert_eq!(run.missing_iterations(), run.missing, "produced = stored + gaps: {run:?}");
    let host = &stored_events.hosts["edge"];
    assert_eq!(host.gap_rows, (host.gaps, host.missing), "{host:?}");
    assert_eq!(host.nodes, stored_events.nodes(), "{host:?}");
    record_measurements(
        title,
        &[
            ("iterations stored", thousands(run.iterations() as f64)),
            ("iterations lost and reported", thousands(run.missing as f64)),
        ],
    );
}
