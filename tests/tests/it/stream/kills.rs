//! Test that kills agents and aggregator repeatedly (SIGKILL).

use std::time::Duration;

use peernet_tests::fleet::{echo, edge, rate};
use peernet_tests::{Account, Chance, Fleet, Since, measured, thousands};

use super::{SMALL_SPOOL, nothing_lost, setting, turn};

/// One agent measures as fast as it can, so that its spool is almost always full and losses are reported among all
/// other events. The other one loses only the ends of its runs, which were in memory when it was killed.
const AGENTS: [&str; 2] = ["hasty", "steady"];
const STEADY_HZ: f64 = 1_000.0;

/// Longest time that a process lives after its first action.
const LIFE: Duration = Duration::from_millis(900);
/// Longest time before a killed process is started again.
const DEATH: Duration = Duration::from_millis(400);

#[derive(Default)]
struct Tally {
    agents: u64,
    aggregator: u64,
    duplicates: u64,
}

#[test]
fn whoever_is_killed_whenever_nothing_spooled_is_lost_and_nothing_is_stored_twice() {
    let _turn = turn();
    let (mut chance, began) = (Chance::new("kills"), Since::now());
    let mut fleet = Fleet::new(&AGENTS, &edge("", &(SMALL_SPOOL.to_owned() + &echo("loop", ""))));
    fleet.agents[1].configure(&fleet.site, &edge("", &echo("loop", &rate(STEADY_HZ))));
    fleet.start_all();
    let mut tally = Tally::default();
    let kills = setting("PEERNET_KILLS", 10);
    while tally.agents + tally.aggregator < kills {
        let agent = chance.below(AGENTS.len());
        match chance.below(5) {
            0 | 1 => kill(&mut fleet, None, true, &mut chance, &mut tally),
            2 | 3 => kill(&mut fleet, Some(agent), false, &mut chance, &mut tally),
            _ => kill(&mut fleet, Some(agent), true, &mut chance, &mut tally),
        }
    }

    fleet.answers();
    let accounts: Vec<Account> = (0..AGENTS.len())
        .map(|agent| {
            fleet.agents[agent].stop();
            fleet.deliver(agent)
        })
        .collect();
    tally.duplicates += accounts.iter().map(|account| account.duplicates).sum::<u64>();
    let ledger = fleet.stop();
    let spooled = nothing_lost(&fleet, &ledger);
    for (agent, account) in fleet.agents.iter().zip(&accounts) {
        account.balances();
        let host = &ledger.hosts[&agent.name];
        assert!(host.missing == account.dropped && host.streams == 1, "{account:?}, {host:?}");
        // Every event is accounted for, whichever process was killed.
        assert_eq!(account.produced, host.events + host.missing, "{account:?}, {host:?}");
    }
    for (id, run) in &ledger.runs {
        assert!(run.host != "steady" || run.is_whole(), "holes in run {id}: {run:?}");
        assert!(!run.reason.is_empty(), "nobody noticed that run {id} has ended: {run:?}");
    }
    let number = |count: u64| thousands(count as f64);
    measured(
        "kills",
        &[
            ("kills of agents", number(tally.agents)),
            ("kills of the aggregator", number(tally.aggregator)),
            ("runs", number(ledger.runs.len() as u64)),
            ("iterations reported as spooled", number(spooled)),
            ("iterations stored", number(ledger.iterations())),
            ("nodes stored", number(ledger.nodes())),
            ("lost", number(0)),
            ("twice", number(0)),
            (
                "dropped with a full spool, and counted",
                number(accounts.iter().map(|account| account.dropped).sum()),
            ),
            ("duplicate batches recognised, at least", number(tally.duplicates)),
            ("seconds", number(began.elapsed().as_secs())),
        ],
    );
}

/// Kills an agent, the aggregator or both at a random moment, and starts them again a random time later.
fn kill(fleet: &mut Fleet, agent: Option<usize>, aggregator: bool, chance: &mut Chance, tally: &mut Tally) {
    // Sometimes during the start, otherwise after some activity.
    if !chance.once_in(4) {
        if let Some(agent) = agent {
            fleet.agents[agent].process().wait_for("spooled batch=");
        }
        if aggregator {
            fleet.account(0, "something is stored", |account| account.events > 0);
        }
    }
    chance.linger(LIFE);
    if aggregator {
        let duplicates = |name| Account::of(&fleet.api, name).map_or(0, |account| account.duplicates);
        tally.duplicates += AGENTS.iter().map(|name| duplicates(name)).sum::<u64>();
        fleet.aggregator.kill();
        tally.aggregator += 1;
    }
    if let Some(agent) = agent {
        fleet.agents[agent].kill();
        tally.agents += 1;
    }
    chance.linger(DEATH);
    if let Some(agent) = agent {
        fleet.start(agent);
    }
    if aggregator {
        fleet.aggregator.start(&fleet.site);
    }
}
