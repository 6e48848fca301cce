//! Test that kills agents and aggregator repeatedly (SIGKILL).

use std::time::Duration;

use peernet_tests::fleet::{agent_configuration, echo_pipeline, rate_load};
use peernet_tests::{EventCounts, Fleet, Stopwatch, TestRng, record_measurements, thousands};

use super::{SMALL_SPOOL, assert_nothing_lost, setting, wait_for_turn};

/// `hasty` measures as fast as it can, so its spool is almost always full and losses are reported
/// among all other events. `steady` loses only the ends of its runs, which were in memory when it
/// was killed.
const AGENTS: [&str; 2] = ["hasty", "steady"];
const STEADY_HZ: f64 = 1_000.0;

/// Longest time that a process lives after its first action.
const MAX_LIFETIME: Duration = Duration::from_millis(900);
/// Longest time before a killed process is started again.
const MAX_DOWNTIME: Duration = Duration::from_millis(400);

#[derive(Default)]
struct KillCounts {
    /// Number of kills of agents.
    agents: u64,
    /// Number of kills of the aggregator.
    aggregator: u64,
    /// Number of duplicate batches that killed aggregators had recognised.
    duplicates: u64,
}

#[test]
fn random_kills_lose_and_duplicate_no_spooled_iteration() {
    let _turn = wait_for_turn();
    let (mut rng, stopwatch) = (TestRng::new("kills"), Stopwatch::start());
    let mut fleet =
        Fleet::new(&AGENTS, &agent_configuration("", &(SMALL_SPOOL.to_owned() + &echo_pipeline("loop", ""))));
    fleet.agents[1].configure(
        &fleet.deployment,
        &agent_configuration("", &echo_pipeline("loop", &rate_load(STEADY_HZ))),
    );
    fleet.start_all();
    let mut kill_counts = KillCounts::default();
    let kills = setting("PEERNET_KILLS", 10);
    while kill_counts.agents + kill_counts.aggregator < kills {
        let agent = rng.below(AGENTS.len());
        let (agent, kills_aggregator) = match rng.below(5) {
            0 | 1 => (None, true),
            2 | 3 => (Some(agent), false),
            _ => (Some(agent), true),
        };
        kill(&mut fleet, agent, kills_aggregator, &mut rng, &mut kill_counts);
    }

    fleet.wait_until_ready();
    let counts_of_agents: Vec<EventCounts> = (0..AGENTS.len())
        .map(|agent| {
            fleet.agents[agent].stop();
            fleet.deliver_spool(agent)
        })
        .collect();
    kill_counts.duplicates += counts_of_agents.iter().map(|counts| counts.duplicates).sum::<u64>();
    let stored_events = fleet.stop();
    let spooled = assert_nothing_lost(&fleet, &stored_events);
    for (agent, counts) in fleet.agents.iter().zip(&counts_of_agents) {
        counts.assert_balanced();
        let host = &stored_events.hosts[&agent.name];
        assert!(host.missing == counts.dropped && host.streams == 1, "{counts:?}, {host:?}");
        // Every event is accounted for, whichever process was killed.
        assert_eq!(counts.produced, host.events + host.missing, "{counts:?}, {host:?}");
    }
    for (id, run) in &stored_events.runs {
        assert!(run.host != "steady" || run.is_contiguous(), "gaps in run {id}: {run:?}");
        assert!(!run.reason.is_empty(), "the end of run {id} is not stored: {run:?}");
    }
    let number = |count: u64| thousands(count as f64);
    record_measurements(
        "kills",
        &[
            ("kills of agents", number(kill_counts.agents)),
            ("kills of the aggregator", number(kill_counts.aggregator)),
            ("runs", number(stored_events.runs.len() as u64)),
            ("iterations reported as spooled", number(spooled)),
            ("iterations stored", number(stored_events.iterations())),
            ("nodes stored", number(stored_events.nodes())),
            ("iterations lost", number(0)),
            ("iterations stored twice", number(0)),
            (
                "dropped with a full spool, and counted",
                number(counts_of_agents.iter().map(|counts| counts.dropped).sum()),
            ),
            ("duplicate batches recognised, at least", number(kill_counts.duplicates)),
            ("seconds", number(stopwatch.elapsed().as_secs())),
        ],
    );
}

/// Kills an agent, the aggregator or both at a random moment, and starts them again a random time later.
fn kill(
    fleet: &mut Fleet,
    agent: Option<usize>,
    kills_aggregator: bool,
    rng: &mut TestRng,
    kill_counts: &mut KillCounts,
) {
    // One kill in four may hit a process during its start. The others follow some activity.
    if !rng.once_in(4) {
        if let Some(agent) = agent {
            fleet.agents[agent].process().wait_for("spooled batch=");
        }
        if kills_aggregator {
            fleet.wait_for_counts(0, "something is stored", |counts| counts.stored > 0);
        }
    }
    rng.sleep_up_to(MAX_LIFETIME);
    if kills_aggregator {
        let duplicates = |name| EventCounts::read(&fleet.api, name).map_or(0, |counts| counts.duplicates);
        kill_counts.duplicates += AGENTS.iter().map(|name| duplicates(name)).sum::<u64>();
        fleet.aggregator.kill();
        kill_counts.aggregator += 1;
    }
    if let Some(agent) = agent {
        fleet.agents[agent].kill();
        kill_counts.agents += 1;
    }
    rng.sleep_up_to(MAX_DOWNTIME);
    if let Some(agent) = agent {
        fleet.start(agent);
    }
    if kills_aggregator {
        fleet.aggregator.start(&fleet.deployment);
    }
}
