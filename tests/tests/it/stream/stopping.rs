//! Tests of SIGTERM while everything runs at full speed.

use peernet_tests::fleet::{agent_configuration, echo_pipeline};
use peernet_tests::{Fleet, ProcessEnd, record_measurements, thousands};

use super::{SMALL_SPOOL, assert_nothing_lost, wait_for_turn};

/// Returns an agent that logs each answer, so that the number of measured iterations is known independently of the
/// spool.
fn counting_agent() -> String {
    agent_configuration(
        "",
        &(SMALL_SPOOL.to_owned() + &echo_pipeline("loop", "actuator = { kind = \"log\" }")),
    )
}

/// Returns the number of answers in an agent's log.
fn count_answers(end: &ProcessEnd) -> u64 {
    end.log.lines().filter(|line| line.contains("actuators: answer")).count() as u64
}

/// Checks that every measured iteration is stored or counted in gaps, and that the end of the run is stored.
fn assert_everything_is_stored(title: &str, mut fleet: Fleet, measured: u64) {
    fleet.deliver_spool(0).assert_balanced();
    let stored_events = fleet.stop();
    assert_nothing_lost(&fleet, &stored_events);
    let run = stored_events.runs.values().next().expect("one run");
    assert_eq!((stored_events.runs.len(), run.reason.as_str()), (1, "stopped"), "{stored_events:?}");
    assert_eq!(run.iterations() + run.missing, measured, "{stored_events:?}");
    let number = |count: u64| thousands(count as f64);
    record_measurements(
        title,
        &[
            ("iterations measured", number(measured)),
            ("iterations stored", number(run.iterations())),
            ("iterations in gaps", number(run.missing)),
        ],
    );
}

#[test]
fn agent_stopped_without_aggregator_keeps_all_in_spool() {
    let _turn = wait_for_turn();
    let mut fleet = Fleet::new(&["edge"], &counting_agent());
    fleet.aggregator.stop();
    fleet.start(0);
    fleet.agents[0].process().wait_for_nth("spooled batch=", 8);
    let end = fleet.agents[0].stop();
    fleet.restart_aggregator();
    assert_everything_is_stored("SIGTERM, agent alone", fleet, count_answers(&end));
}

#[test]
fn agent_stopped_under_load_spooled_or_stored_everything() {
    let _turn = wait_for_turn();
    let mut fleet = Fleet::new(&["edge"], &counting_agent());
    fleet.start(0);
    fleet.wait_for_counts(0, "something is stored", |counts| counts.stored > 1_000);
    let end = fleet.agents[0].stop();
    assert_everything_is_stored("SIGTERM, agent", fleet, count_answers(&end));
}

#[test]
fn aggregator_stopped_under_load_stored_acknowledged_batches() {
    let _turn = wait_for_turn();
    let mut fleet = Fleet::new(
        &["edge-1", "edge-2"],
        &agent_configuration("", &(SMALL_SPOOL.to_owned() + &echo_pipeline("loop", ""))),
    );
    fleet.start_all();
    for agent in 0..2 {
        fleet.wait_for_counts(agent, "something is stored", |counts| counts.stored > 1_000);
    }
    fleet.aggregator.stop();
    let first = fleet.stored_events();
    let before = [0, 1].map(|agent| first.hosts[&fleet.agents[agent].name].events);
    // Acknowledged batches are deleted in the spools: if they had not been stored, there would be a gap now.
    fleet.restart_aggregator();
    for (agent, before) in before.into_iter().enumerate() {
        fleet.wait_for_counts(agent, "more is stored", |counts| counts.stored > before);
        fleet.agents[agent].stop();
        fleet.deliver_spool(agent).assert_balanced();
    }
    let stored_events = fleet.stop();
    assert_nothing_lost(&fleet, &stored_events);
    assert!(stored_events.iterations() > first.iterations(), "{stored_events:?}");
    let number = |count: u64| thousands(count as f64);
    record_measurements(
        "SIGTERM, aggregator",
        &[
            ("iterations stored when the aggregator ended", number(first.iterations())),
            ("iterations stored at the end", number(stored_events.iterations())),
        ],
    );
}
