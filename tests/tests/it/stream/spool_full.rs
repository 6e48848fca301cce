//! Tests of a full disk under an agent's spool.

use peernet_tests::fleet::{agent_configuration_in, echo_pipeline, rate_load};
use peernet_tests::{Fleet, SmallDisk, record_measurements, thousands};
use serde_json::Value;

use super::wait_for_turn;

#[test]
fn full_spool_disk_is_reported_and_drops_counted() {
    let _turn = wait_for_turn();
    let (database_disk, spool_disk) = (SmallDisk::new(48 << 20), SmallDisk::new(16 << 20));
    let database = database_disk.folder().join("aggregator.sqlite").display().to_string();
    let folder = spool_disk.folder().join("NAME").display().to_string();
    // While the spool fails, the events that wait in memory soon exceed this limit.
    let agent =
        agent_configuration_in(&folder, "queue_events = 4000", &echo_pipeline("loop", &rate_load(2_000.0)));
    let mut fleet = Fleet::with_database(&database, &["edge"], &agent);
    fleet.start(0);
    fleet.wait_for_counts(0, "something is stored", |counts| counts.stored > 100);

    // Only the spool's disk is full: events still reach the aggregator.
    spool_disk.fill();
    let before = fleet.wait_for_counts(0, "the agent reports", |_| true);
    let after = fleet.wait_for_counts(0, "more is stored", |counts| counts.stored > before.stored + 4_000);
    assert_eq!(after.dropped, 0, "{after:?}");

    // The aggregator accepts no more events, so the spool would have to grow.
    database_disk.fill();
    let failing = fleet.wait_for_counts(0, "the spool fails", |counts| counts.trouble.is_some());
    let reason = failing.trouble.as_deref().unwrap_or_default();
    assert!(reason.contains("full"), "the reason does not say that the disk is full: {reason}");
    let dropping = fleet.wait_for_counts(0, "memory is full, too", |counts| counts.dropped > 1_000);
    assert!(dropping.produced > failing.produced, "the agent measures no more: {dropping:?}");

    spool_disk.free();
    fleet.wait_for_counts(0, "the spool works again", |counts| counts.trouble.is_none());
    database_disk.free();
    fleet.wait_for_counts(0, "the waiting events are stored", |counts| {
        counts.stored > dropping.stored + 5_000
    });
    fleet.agents[0].stop();
    let counts = fleet.deliver_spool(0);
    counts.assert_balanced();
    let stored_events = fleet.stop();
    let host = &stored_events.hosts["edge"];
    assert_eq!(host.missing, counts.dropped, "{host:?}, {counts:?}");
    assert_eq!(host.events, counts.acknowledged, "{host:?}, {counts:?}");
    assert_eq!((host.streams, host.quarantined), (1, 0), "{host:?}");
    assert_eq!(stored_events.count_missing(fleet.agents[0].spooled_iterations()), 0);
    // Each missing iteration is counted in a gap of its run.
    for run in stored_events.runs.values() {
        let last = run.ranges.last().map_or(0, |range| *range.end());
        assert!(last - run.iterations() <= run.missing, "{run:?}");
    }
    record_measurements(
        "full disk, spool",
        &[
            ("events produced", thousands(counts.produced as f64)),
            ("acknowledged", thousands(counts.acknowledged as f64)),
            ("dropped and counted in gaps", thousands(counts.dropped as f64)),
        ],
    );
}

#[test]
fn start_on_full_disk_counts_dropped_events() {
    let _turn = wait_for_turn();
    let spool_disk = SmallDisk::new(16 << 20);
    let folder = spool_disk.folder().join("NAME").display().to_string();
    // The first 400 events wait in memory until the agent stops. Later events are dropped.
    let agent = agent_configuration_in(
        &folder,
        "queue_events = 400",
        &echo_pipeline("loop", "actuator = { kind = \"log\" }\nload = { mode = \"rate\", hz = 500.0 }"),
    );
    let mut fleet = Fleet::new(&["edge"], &agent);
    fleet.aggregator.stop();
    fleet.start(0);
    fleet.agents[0].process().wait_for_nth("spooled batch=", 5);
    spool_disk.fill();
    fleet.agents[0].kill();

    fleet.start(0);
    fleet.agents[0].process().wait_for("the disk is full");
    fleet.agents[0].process().wait_for_nth("actuators: answer", 1_500);
    let spool = spool_disk.folder().join("edge").join("spool.sqlite").display().to_string();
    let doctor = fleet.deployment.peernetd(&["doctor", "--json", "--spool", &spool]).wait_for_end();
    let report: Value =
        serde_json::from_str(&doctor.log).unwrap_or_else(|error| panic!("{error}: {}", doctor.log));
    assert_eq!((doctor.code(), &report["healthy"]), (65, &Value::Bool(false)), "{report}");
    assert!(report["spool"]["disk_free_bytes"].as_u64().is_some_and(|bytes| bytes < 1 << 20), "{report}");
    assert!(doctor.log.contains("KiB of free space"), "{report}");
    let end = fleet.agents[0].stop();
    let answers = end.log.lines().filter(|line| line.contains("actuators: answer")).count() as u64;
    assert!(end.log.contains("a gap reports them"), "{}", end.log);

    spool_disk.free();
    fleet.restart_aggregator();
    fleet.start_without_pipelines(0);
    let counts = fleet.wait_for_counts(0, "dropped events are reported", |counts| {
        counts.gaps > 0 && counts.waiting == 0 && counts.stored == counts.acknowledged
    });
    counts.assert_balanced();
    let stored_events = fleet.stop();
    let host = &stored_events.hosts["edge"];
    assert_eq!(host.missing, counts.dropped, "{host:?}, {counts:?}");
    assert_eq!(stored_events.count_missing(fleet.agents[0].spooled_iterations()), 0);
    // The answers belong to the run after the start on the full disk, not to the run of the killed agent.
    let killed_run = &fleet.agents[0].spooled_iterations()[0].run;
    let later_runs = stored_events.runs.iter().filter(|(id, _)| *id != killed_run);
    let stored = later_runs.map(|(_, run)| run.iterations()).sum::<u64>();
    assert!(host.missing + stored >= answers, "{answers} answers: {host:?}");
    record_measurements(
        "full disk at the start, spool",
        &[
            ("iterations measured", thousands(answers as f64)),
            ("events counted in gaps", thousands(host.missing as f64)),
        ],
    );
}
