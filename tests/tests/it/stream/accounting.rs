//! Test that all counts agree at rest, wherever they are read.

use std::collections::BTreeMap;

use peernet_tests::fleet::{agent_configuration, echo_pipeline};
use peernet_tests::{EventCounts, Fleet, record_measurements, thousands, wait_until};

use super::wait_for_turn;

#[test]
fn produced_events_are_stored_or_counted_as_dropped() {
    let _turn = wait_for_turn();
    // The spool is too small for what is measured without an aggregator, and hardly large enough with one.
    let configuration = agent_configuration("queue_events = 2000", "[spool]\nlimit_bytes = 1048576\n");
    let mut fleet = Fleet::new(&["edge-1", "edge-2"], &(configuration + &echo_pipeline("loop", "")));
    fleet.start_all();
    for agent in 0..2 {
        fleet.wait_for_counts(agent, "something is stored", |counts| counts.stored > 100);
    }
    fleet.aggregator.stop();
    fleet.restart_aggregator();
    let counts_of_agents: Vec<EventCounts> = (0..2)
        .map(|agent| {
            fleet.wait_for_counts(agent, "dropped events are reported", |counts| counts.dropped > 0);
            fleet.agents[agent].stop();
            fleet.deliver_spool(agent)
        })
        .collect();

    // The counts of the agent, of the aggregator, and of the metrics agree.
    for (agent, counts) in fleet.agents.iter().zip(&counts_of_agents) {
        counts.assert_balanced();
        assert_eq!((counts.waiting, counts.missing), (0, counts.dropped), "{counts:?}");
        let expected = [
            ("peernet_host_produced_events_total", counts.produced),
            ("peernet_host_acknowledged_events_total", counts.acknowledged),
            ("peernet_host_waiting_events", counts.waiting),
            ("peernet_host_dropped_events_total", counts.dropped),
            ("peernet_host_stored_events_total", counts.stored),
            ("peernet_host_missing_events_total", counts.missing),
        ];
        wait_until("the metrics agree", || {
            let metrics = metrics_of(&fleet, &agent.name);
            expected.iter().all(|(name, value)| metrics.get(*name) == Some(value)).then_some(())
        });
    }
    // The counts of the tables agree with them.
    let stored_events = fleet.stop();
    for (agent, counts) in fleet.agents.iter().zip(&counts_of_agents) {
        let host = &stored_events.hosts[&agent.name];
        assert_eq!(host.missing, counts.dropped, "{host:?}, {counts:?}");
        // The agent ran until `Fleet::stop`, so it may have sent further events after these counts.
        assert!(host.events >= counts.acknowledged && host.quarantined == 0, "{host:?}, {counts:?}");
        assert_eq!(stored_events.count_missing(agent.spooled_iterations()), 0);
        record_measurements(
            &format!("accounting, {}", agent.name),
            &[
                ("produced", thousands(counts.produced as f64)),
                ("acknowledged", thousands(counts.acknowledged as f64)),
                ("dropped", thousands(counts.dropped as f64)),
                ("gaps", thousands(counts.gaps as f64)),
            ],
        );
    }
}

/// Returns the values of all metrics of a host, by name.
fn metrics_of(fleet: &Fleet, host: &str) -> BTreeMap<String, u64> {
    let (_, text) = fleet.api.get("/metrics").expect("the aggregator answers");
    let label = format!("host=\"{host}\"");
    text.lines()
        .filter(|line| !line.starts_with('#') && line.contains(&label))
        .filter_map(|line| {
            let (name, rest) = line.split_once('{')?;
            Some((name.to_owned(), rest.rsplit_once(' ')?.1.parse::<f64>().ok()? as u64))
        })
        .collect()
}
