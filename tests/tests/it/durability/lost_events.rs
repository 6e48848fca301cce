//! Tests that lost events are counted: when an agent is killed, and when a database is deleted or replaced.

use std::path::Path;
use std::time::Duration;

use peernet_tests::fleet::{agent_configuration, echo_pipeline, rate_load};
use peernet_tests::truth::query_database;
use peernet_tests::{
    EventCounts, Fleet, SpooledIterations, StoredHost, TestRng, record_measurements, thousands,
};

use super::wait_for_turn;

/// Number of kills of the agent while it measures.
const KILLS: usize = 5;

/// Longest time that the agent measures after its first batch.
const MAX_LIFETIME: Duration = Duration::from_millis(600);

/// Run of an agent that logs each answer before the iteration ends.
struct KilledRun {
    run: String,
    answers: u64,
}

/// Checks that every produced event is stored or in a gap.
fn assert_adds_up(counts: &EventCounts, host: &StoredHost) {
    counts.assert_balanced();
    assert_eq!((counts.waiting, counts.dropped), (0, host.missing), "{counts:?}, {host:?}");
    assert_eq!(counts.produced, host.events + host.missing, "{counts:?}, {host:?}");
}

/// Deletes the contents of a folder.
fn empty_folder(folder: &Path) {
    std::fs::remove_dir_all(folder).expect("deleted");
    std::fs::create_dir(folder).expect("made again");
}

#[test]
fn killed_agent_reports_every_event_it_lost() {
    let _turn = wait_for_turn();
    let mut rng = TestRng::new("lost events");
    let pipeline = echo_pipeline("loop", &format!("{}\nactuator = {{ kind = \"log\" }}", rate_load(500.0)));
    let mut fleet = Fleet::new(&["edge"], &agent_configuration("", &pipeline));
    let mut killed_runs = Vec::new();
    while killed_runs.len() < KILLS {
        fleet.start(0);
        fleet.agents[0].process().wait_for("spooled batch=");
        rng.sleep_up_to(MAX_LIFETIME);
        let log = fleet.agents[0].kill().log;
        // The log was written before the process was killed, and does not depend on its spool.
        let answers = log.matches(" answer ").count() as u64;
        let spooled = SpooledIterations::parse_log(&log);
        let run = spooled.first().expect("the test waited for a spooled batch").run.clone();
        killed_runs.push(KilledRun { run, answers });
        if killed_runs.len() == 2 {
            // The agent is killed again before it can report the loss.
            fleet.start(0);
            fleet.agents[0].process().wait_for("the agent was killed before these events");
            fleet.agents[0].kill();
        }
    }
    let counts = fleet.deliver_spool(0);
    fleet.agents[0].stop();
    // A clean stop leaves nothing to report.
    let counts_after_stop = fleet.deliver_spool(0);
    fleet.agents[0].stop();
    let stored_events = fleet.stop();
    let host = &stored_events.hosts["edge"];
    assert_adds_up(&counts_after_stop, host);
    assert_eq!((counts_after_stop.dropped, host.streams, host.quarantined), (counts.dropped, 1, 0));
    let mut lost = 0;
    for KilledRun { run, answers } in &killed_runs {
        let stored = &stored_events.runs[run];
        assert!(stored.is_contiguous(), "only the end of a run is lost: {stored:?}");
        let accounted = stored.iterations() + stored.missing;
        // The kill may have hit an iteration between its action and its end, which is not an event.
        assert!(
            (answers - 1..=*answers).contains(&accounted),
            "{answers} answers, {accounted} accounted for: {stored:?}"
        );
        lost += stored.missing;
    }
    assert!(lost > 0, "every kill hit an agent that had nothing in memory: {stored_events:?}");
    record_measurements(
        "killed agent",
        &[
            // One further kill ended the agent before it could report a loss.
            ("kills", thousands(killed_runs.len() as f64 + 1.0)),
            (
                "answers in the log",
                thousands(killed_runs.iter().map(|killed_run| killed_run.answers).sum::<u64>() as f64),
            ),
            ("iterations stored", thousands(stored_events.iterations() as f64)),
            ("lost and reported", thousands(lost as f64)),
        ],
    );
}

#[test]
fn deleted_database_reports_number_of_missing_events() {
    let _turn = wait_for_turn();
    let mut fleet =
        Fleet::new(&["edge"], &agent_configuration("", &echo_pipeline("loop", &rate_load(500.0))));
    fleet.start(0);
    fleet.wait_for_counts(0, "something is stored", |counts| counts.stored > 500);
    fleet.aggregator.stop();
    let deleted_events = fleet.stored_events().hosts["edge"].events;
    empty_folder(fleet.database().parent().expect("a folder of its own"));
    fleet.restart_aggregator();
    fleet.wait_for_counts(0, "more is stored", |counts| counts.stored > 500);
    fleet.agents[0].stop();
    let counts = fleet.deliver_spool(0);
    let stored_events = fleet.stop();
    let host = &stored_events.hosts["edge"];
    // Events without an acknowledgement at the aggregator's stop are sent again.
    assert!(
        host.missing <= deleted_events && host.missing > deleted_events / 2,
        "{deleted_events} events were deleted: {host:?}"
    );
    assert_eq!(host.gap_rows, (1, host.missing));
    assert_eq!(counts.produced, host.events + host.missing, "{counts:?}, {host:?}");
    let reason = query_database(fleet.database(), "SELECT reason FROM gap");
    assert!(reason.contains("batches 1 to"), "{reason}");
    let incident = query_database(fleet.database(), "SELECT text FROM incident WHERE kind = 'gap'");
    assert!(incident.contains("events missing: from before this database: batches 1 to"), "{incident}");
}

#[test]
fn restored_database_reports_number_of_missing_events() {
    let _turn = wait_for_turn();
    let mut fleet =
        Fleet::new(&["edge"], &agent_configuration("", &echo_pipeline("loop", &rate_load(500.0))));
    fleet.start(0);
    fleet.wait_for_counts(0, "something is stored", |counts| counts.stored > 500);
    fleet.aggregator.stop();
    let (database, backup) = (fleet.database().to_owned(), fleet.deployment.folder().join("backup.sqlite"));
    std::fs::copy(&database, &backup).expect("copied");
    fleet.restart_aggregator();
    let before = fleet.wait_for_counts(0, "the agent reports", |_| true);
    fleet.wait_for_counts(0, "more is stored", |counts| counts.acknowledged > before.acknowledged + 500);
    fleet.aggregator.stop();
    empty_folder(database.parent().expect("a folder of its own"));
    std::fs::copy(&backup, &database).expect("restored");
    fleet.restart_aggregator();
    fleet.wait_for_counts(0, "newer batches are stored", |counts| counts.missing > 0);
    fleet.agents[0].stop();
    let counts = fleet.deliver_spool(0);
    let stored_events = fleet.stop();
    let (host, run) = (&stored_events.hosts["edge"], stored_events.runs.values().next().expect("one run"));
    assert_eq!((host.gap_rows, run.ranges.len()), ((1, host.missing), 2), "{host:?}, {run:?}");
    assert_eq!(counts.produced, host.events + host.missing, "{counts:?}, {host:?}");
    assert!(host.missing >= run.missing_iterations(), "{host:?}, {run:?}");
}
