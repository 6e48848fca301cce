//! Test that all counts agree at rest, wherever they are read.

use std::collections::BTreeMap;

use peernet_tests::fleet::{echo, edge};
use peernet_tests::{Account, Fleet, measured, thousands, until};

use super::turn;

#[test]
fn at_rest_everything_produced_is_stored_or_counted_as_dropped_wherever_one_looks() {
    let _turn = turn();
    // The spool is too small for what is measured without an aggregator, and hardly large enough with one.
    let small = edge("queue_events = 2000", "[spool]\nlimit_bytes = 1048576\n");
    let mut fleet = Fleet::new(&["edge-1", "edge-2"], &(small + &echo("loop", "")));
    fleet.start_all();
    for agent in 0..2 {
        fleet.account(agent, "something is stored", |account| account.events > 100);
    }
    fleet.aggregator.stop();
    fleet.aggregator_returns();
    let accounts: Vec<Account> = (0..2)
        .map(|agent| {
            fleet.account(agent, "drops are told", |account| account.dropped > 0);
            fleet.agents[agent].stop();
            fleet.deliver(agent)
        })
        .collect();

    // The counts of the agent, of the aggregator, and of the metrics.
    for (agent, account) in fleet.agents.iter().zip(&accounts) {
        account.balances();
        assert_eq!((account.waiting, account.missing), (0, account.dropped), "{account:?}");
        let expected = [
            ("peernet_host_produced_events_total", account.produced),
            ("peernet_host_acknowledged_events_total", account.stored),
            ("peernet_host_waiting_events", account.waiting),
            ("peernet_host_dropped_events_total", account.dropped),
            ("peernet_host_stored_events_total", account.events),
            ("peernet_host_missing_events_total", account.missing),
        ];
        until("the metrics agree", || {
            let metrics = metrics_of(&fleet, &agent.name);
            expected.iter().all(|(name, value)| metrics.get(*name) == Some(value)).then_some(())
        });
    }
    // The counts of the tables.
    let ledger = fleet.stop();
    for (agent, account) in fleet.agents.iter().zip(&accounts) {
        let host = &ledger.hosts[&agent.name];
        assert_eq!(host.missing, account.dropped, "{host:?}, {account:?}");
        assert!(host.events >= account.stored && host.quarantined == 0, "{host:?}, {account:?}");
        assert_eq!(ledger.lacks(agent.spooled()), 0);
        measured(
            &format!("accounting, {}", agent.name),
            &[
                ("produced", thousands(account.produced as f64)),
                ("stored", thousands(account.stored as f64)),
                ("dropped", thousands(account.dropped as f64)),
                ("gaps", thousands(account.gaps as f64)),
            ],
        );
    }
}

/// Returns the metrics of a host.
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
