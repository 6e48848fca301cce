//! Tests of restored databases and of copied or deleted spools: they are recognised and never merged wrongly.

use std::path::Path;

use peernet_tests::fleet::{agent_configuration, agent_configuration_in, echo_pipeline, rate_load};
use peernet_tests::truth::query_database;
use peernet_tests::{Daemon, Fleet, record_measurements, thousands};

use super::{assert_nothing_lost, wait_for_turn};

/// Copies a folder with all its files.
fn copy_folder(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).expect("the temporary folder is writable");
    for entry in std::fs::read_dir(from).expect("the folder exists") {
        let entry = entry.expect("readable");
        std::fs::copy(entry.path(), to.join(entry.file_name())).expect("copied");
    }
}

/// Stops an agent's measurement and waits until everything is delivered.
fn stop_measuring_and_deliver(fleet: &mut Fleet, agent: usize) {
    fleet.agents[agent].stop();
    let since = fleet.start_without_pipelines(agent);
    fleet
        .wait_for_counts(agent, "nothing waits", |counts| counts.last_seen > since && counts.waiting == 0)
        .assert_balanced();
}

/// Kills the aggregator, and some batches later the agent, so that these batches wait in its spool.
fn kill_with_batches(fleet: &mut Fleet) {
    fleet.aggregator.kill();
    let spooled = fleet.agents[0].process().log().matches("spooled batch=").count();
    fleet.agents[0].process().wait_for_nth("spooled batch=", spooled + 5);
    fleet.agents[0].kill();
}

#[test]
fn restored_database_records_gap_and_continues() {
    let _turn = wait_for_turn();
    let mut fleet =
        Fleet::new(&["edge"], &agent_configuration("", &echo_pipeline("loop", &rate_load(500.0))));
    fleet.start(0);
    fleet.wait_for_counts(0, "something is stored", |counts| counts.stored > 500);
    let store = fleet.database().parent().expect("a folder of its own").to_owned();
    let backup = fleet.deployment.folder().join("backup");
    fleet.aggregator.stop();
    copy_folder(&store, &backup);
    let backup_events = fleet.stored_events();

    fleet.restart_aggregator();
    let before = fleet.wait_for_counts(0, "the agent reports", |_| true);
    fleet.wait_for_counts(0, "more is stored", |counts| counts.acknowledged > before.acknowledged + 1_000);
    fleet.aggregator.stop();
    let later_events = fleet.stored_events();
    std::fs::remove_dir_all(&store).expect("the aggregator has stopped");
    copy_folder(&backup, &store);

    fleet.restart_aggregator();
    fleet.wait_for_counts(0, "newer batches are stored", |counts| {
        counts.stored > backup_events.iterations() + 1_000
    });
    stop_measuring_and_deliver(&mut fleet, 0);
    let stored_events = fleet.stop();
    let (host, run) = (&stored_events.hosts["edge"], stored_events.runs.values().next().expect("one run"));
    assert_eq!((host.gaps, host.streams, host.quarantined), (1, 1, 0), "{host:?}");
    assert_eq!((stored_events.runs.len(), run.ranges.len()), (1, 2), "one gap: {run:?}");
    assert_eq!(run.reason, "stopped");
    // The gap begins where the backup ended, and is not longer than the lost part of the database.
    assert_eq!(run.ranges[0], 1..=backup_events.iterations());
    assert!(*run.ranges[1].start() <= later_events.iterations() + 1, "{run:?}, {later_events:?}");
    let reason = query_database(fleet.database(), "SELECT reason FROM gap");
    assert!(reason.contains("are not in this database"), "{reason}");
    let (first, last) = (run.ranges[0].end() + 1, run.ranges[1].start() - 1);
    record_measurements(
        "restored database",
        &[
            ("iterations missing in the gap", thousands((last - first + 1) as f64)),
            ("stored before and after", thousands(stored_events.iterations() as f64)),
            ("gap", reason.trim().to_owned()),
        ],
    );
}

#[test]
fn copied_state_folder_starts_new_stream_after_refusal() {
    let _turn = wait_for_turn();
    let configuration = agent_configuration("", &echo_pipeline("loop", &rate_load(200.0)));
    let mut fleet = Fleet::new(&["edge"], &configuration);
    fleet.start(0);
    fleet.wait_for_counts(0, "something is stored", |counts| counts.stored > 100);
    // The copied spool contains batches that the first agent delivers before the copy connects.
    kill_with_batches(&mut fleet);
    let folder = fleet.deployment.folder();
    copy_folder(&folder.join("edge"), &folder.join("copy"));
    fleet.restart_aggregator();
    fleet.start(0);
    fleet.wait_for_counts(0, "the waiting events are delivered", |counts| counts.waiting < 100);

    let configuration =
        agent_configuration_in("{folder}/copy", "", &echo_pipeline("loop", &rate_load(200.0)))
            .replace("NAME", "copy");
    let mut copy = Daemon::start_new(&fleet.deployment, "copy", &configuration);
    let line = copy.process().wait_for("refused");
    assert!(line.contains("another agent with the host id"), "{line}");
    copy.stop();
    fleet.wait_for_counts(0, "the first agent continues", |counts| counts.waiting < 100);
    fleet.agents[0].stop();
    // This starts the agent again, without its pipelines.
    fleet.deliver_spool(0).assert_balanced();
    fleet.agents[0].stop();

    copy.start(&fleet.deployment);
    copy.process().wait_for("new stream");
    fleet.agents.push(copy);
    fleet.wait_for_counts(1, "events of the copy are stored", |counts| {
        counts.waiting < 100 && counts.acknowledged > 500
    });
    stop_measuring_and_deliver(&mut fleet, 1);
    let stored_events = fleet.stop();
    assert_eq!(stored_events.count_missing(fleet.agents[0].spooled_iterations()), 0, "{stored_events:?}");
    assert_eq!(stored_events.count_missing(fleet.agents[1].spooled_iterations()), 0, "{stored_events:?}");
    let streams = query_database(fleet.database(), "SELECT count(*) FROM stream");
    assert_eq!(streams.trim(), "2", "the copy continues in a separate stream: {stored_events:?}");
    for (id, run) in &stored_events.runs {
        assert!(run.is_contiguous(), "run {id}: {run:?}");
    }
}

#[test]
fn deleted_spool_causes_new_stream_and_gap() {
    let _turn = wait_for_turn();
    let mut fleet =
        Fleet::new(&["edge"], &agent_configuration("", &echo_pipeline("loop", &rate_load(200.0))));
    fleet.start(0);
    fleet.wait_for_counts(0, "something is stored", |counts| counts.stored > 100);
    kill_with_batches(&mut fleet);
    for entry in std::fs::read_dir(fleet.deployment.folder().join("edge")).expect("the folder exists") {
        let path = entry.expect("readable").path();
        if path.file_name().is_some_and(|name| name.to_string_lossy().starts_with("spool.sqlite")) {
            std::fs::remove_file(path).expect("deleted");
        }
    }
    fleet.restart_aggregator();
    fleet.start(0);
    fleet.wait_for_counts(0, "a gap or 300 events", |counts| counts.missing > 0 || counts.stored > 300);
    stop_measuring_and_deliver(&mut fleet, 0);
    let stored_events = fleet.stop();
    let host = &stored_events.hosts["edge"];
    assert_eq!((host.streams, host.gaps, host.quarantined), (2, 1, 0), "{host:?}");
    let reason = query_database(fleet.database(), "SELECT reason FROM gap");
    assert!(reason.contains("spool"), "{reason}");
    // The missing events are the last ones of the first run, whose agent was killed, so no run has a gap between its iterations.
    assert_eq!(stored_events.runs.len(), 2, "{stored_events:?}");
    assert!(stored_events.runs.values().all(|run| run.is_contiguous()), "{stored_events:?}");
}

#[test]
fn second_agent_in_state_folder_is_refused() {
    let _turn = wait_for_turn();
    let mut fleet =
        Fleet::new(&["edge"], &agent_configuration("", &echo_pipeline("loop", &rate_load(100.0))));
    fleet.start(0);
    fleet.wait_for_counts(0, "something is stored", |counts| counts.stored > 0);
    let second = agent_configuration_in("{folder}/edge", "", "").replace("NAME", "second");
    fleet.deployment.write("second.toml", &second);
    let end = fleet.deployment.start("second.toml").wait_for_end();
    assert_eq!(end.code(), 69, "{}", end.log);
    assert!(end.log.contains("another agent uses"), "{}", end.log);
    fleet.agents[0].stop();
    fleet.deliver_spool(0).assert_balanced();
    let stored_events = fleet.stop();
    assert_nothing_lost(&fleet, &stored_events);
}
