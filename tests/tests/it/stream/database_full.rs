//! Test of a full disk under the database.

use peernet_tests::fleet::{agent_configuration, echo_pipeline, rate_load};
use peernet_tests::{Fleet, SmallDisk, record_measurements, thousands, wait_until};

use super::{assert_nothing_lost, wait_for_turn};

#[test]
fn full_database_disk_stops_storing_without_loss() {
    let _turn = wait_for_turn();
    let disk = SmallDisk::new(48 << 20);
    let database = disk.folder().join("aggregator.sqlite").display().to_string();
    let mut fleet = Fleet::with_database(
        &database,
        &["edge"],
        &agent_configuration("", &echo_pipeline("loop", &rate_load(500.0))),
    );
    fleet.start(0);
    fleet.wait_for_counts(0, "something is stored", |counts| counts.stored > 100);

    disk.fill();
    let reason = wait_until("not ready", || {
        fleet.api.get("/readyz").filter(|(status, _)| *status == 503).map(|(_, text)| text)
    });
    assert!(reason.contains("full"), "the reason does not say that the disk is full: {reason}");
    assert!(
        reason.contains(&database) && reason.contains("free some space"),
        "the reason lacks the file or the remedy: {reason}"
    );
    let (status, page) = fleet.api.get("/").expect("the dashboard answers");
    assert!(status == 200 && page.contains("full"), "the page does not report the full disk: {page}");
    // The live state contains seconds that began after the disk was full.
    let newest_second = || {
        let pipeline = fleet.api.json("/api/v1/pipelines/edge/loop");
        pipeline["seconds"].as_array().and_then(|seconds| seconds.last()?["at"].as_i64())
    };
    let before = newest_second().expect("the pipeline measures");
    wait_until("newer live statistics", || newest_second().filter(|second| *second > before + 1));
    let waiting = fleet.wait_for_counts(0, "events wait", |counts| counts.waiting > 400);
    assert_eq!(waiting.dropped, 0, "{waiting:?}");

    disk.free();
    wait_until("ready", || fleet.api.get("/readyz").filter(|(status, _)| *status == 200));
    fleet.wait_for_counts(0, "the waiting events are stored", |counts| {
        counts.stored > waiting.stored + waiting.waiting
    });
    let outage = fleet.api.wait_until("/api/v1/incidents", |list| {
        let storage = list["incidents"].as_array()?.iter().find(|incident| incident["kind"] == "storage")?;
        storage["text"].as_str().map(str::to_owned)
    });
    assert!(outage.starts_with("nothing could be stored for ") && outage.contains("full"), "{outage}");
    fleet.agents[0].stop();
    let counts = fleet.deliver_spool(0);
    counts.assert_balanced();
    let stored_events = fleet.stop();
    let spooled = assert_nothing_lost(&fleet, &stored_events);
    let number = |count: u64| thousands(count as f64);
    record_measurements(
        "full disk, database",
        &[
            ("events that waited, at least", number(waiting.waiting)),
            ("iterations reported as spooled", number(spooled)),
            ("iterations stored", number(stored_events.iterations())),
        ],
    );
}
