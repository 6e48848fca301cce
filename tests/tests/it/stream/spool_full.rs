//! Tests of a full disk under an agent's spool.

use peernet_tests::fleet::{echo, edge_in, rate};
use peernet_tests::{Fleet, SmallDisk, measured, thousands};
use serde_json::Value;

use super::turn;

#[test]
fn a_full_disk_under_the_spool_is_said_and_what_does_not_fit_is_counted() {
    let _turn = turn();
    let (store, state) = (SmallDisk::new(48 << 20), SmallDisk::new(16 << 20));
    let database = store.folder().join("aggregator.sqlite").display().to_string();
    let folder = state.folder().join("NAME").display().to_string();
    // Events that wait in memory meanwhile soon exceed the limit.
    let agent = edge_in(&folder, "queue_events = 4000", &echo("loop", &rate(2_000.0)));
    let mut fleet = Fleet::storing_in(&database, &["edge"], &agent);
    fleet.start(0);
    fleet.account(0, "something is stored", |account| account.events > 100);

    // Only the spool's disk is full: events still reach the aggregator.
    state.fill();
    let before = fleet.account(0, "it is known", |_| true);
    let now = fleet.account(0, "more is stored", |account| account.events > before.events + 4_000);
    assert_eq!(now.dropped, 0, "{now:?}");

    // The aggregator accepts no more events, so that the spool would have to grow.
    store.fill();
    let troubled = fleet.account(0, "the spool fails", |account| account.trouble.is_some());
    let words = troubled.trouble.as_deref().unwrap_or_default();
    assert!(words.contains("full"), "why: {words}");
    let full = fleet.account(0, "memory is full, too", |account| account.dropped > 1_000);
    assert!(full.produced > troubled.produced, "measuring goes on: {full:?}");

    state.free();
    fleet.account(0, "the spool works again", |account| account.trouble.is_none());
    store.free();
    fleet.account(0, "what waited is stored", |account| account.events > full.events + 5_000);
    fleet.agents[0].stop();
    let account = fleet.deliver(0);
    account.balances();
    let ledger = fleet.stop();
    let host = &ledger.hosts["edge"];
    assert_eq!(host.missing, account.dropped, "{host:?}, {account:?}");
    assert_eq!(host.events, account.stored, "{host:?}, {account:?}");
    assert_eq!((host.streams, host.quarantined), (1, 0), "{host:?}");
    assert_eq!(ledger.lacks(fleet.agents[0].spooled()), 0);
    // Each missing iteration is counted in a gap of its run.
    for run in ledger.runs.values() {
        let last = run.ranges.last().map_or(0, |range| *range.end());
        assert!(last - run.iterations() <= run.missing, "{run:?}");
    }
    measured(
        "full disk, spool",
        &[
            ("events produced", thousands(account.produced as f64)),
            ("stored", thousands(account.stored as f64)),
            ("dropped and counted in gaps", thousands(account.dropped as f64)),
        ],
    );
}

#[test]
fn what_is_measured_after_a_start_on_a_full_disk_and_cannot_be_kept_is_counted() {
    let _turn = turn();
    let state = SmallDisk::new(16 << 20);
    let folder = state.folder().join("NAME").display().to_string();
    // Some events wait in memory until the end; the others are dropped before.
    let agent = edge_in(
        &folder,
        "queue_events = 400",
        &echo("loop", "actuator = { kind = \"log\" }\nload = { mode = \"rate\", hz = 500.0 }"),
    );
    let mut fleet = Fleet::new(&["edge"], &agent);
    fleet.aggregator.stop();
    fleet.start(0);
    fleet.agents[0].process().wait_for_nth("spooled batch=", 5);
    state.fill();
    fleet.agents[0].kill();

    fleet.start(0);
    fleet.agents[0].process().wait_for("the disk is full");
    fleet.agents[0].process().wait_for_nth("actuators: answer", 1_500);
    let spool = state.folder().join("edge").join("spool.sqlite").display().to_string();
    let examined = fleet.site.peernetd(&["doctor", "--json", "--spool", &spool]).ended();
    let report: Value =
        serde_json::from_str(&examined.log).unwrap_or_else(|error| panic!("{error}: {}", examined.log));
    assert_eq!((examined.code(), &report["healthy"]), (65, &Value::Bool(false)), "{report}");
    assert!(report["spool"]["disk_free_bytes"].as_u64().is_some_and(|bytes| bytes < 1 << 20), "{report}");
    assert!(examined.log.contains("KiB of room"), "{report}");
    let ended = fleet.agents[0].stop();
    let answers = ended.log.lines().filter(|line| line.contains("actuators: answer")).count() as u64;
    assert!(ended.log.contains("a gap will say so"), "{}", ended.log);

    state.free();
    fleet.aggregator_returns();
    fleet.idle(0);
    let account = fleet.account(0, "what was lost is told", |account| {
        account.gaps > 0 && account.waiting == 0 && account.events == account.stored
    });
    account.balances();
    let ledger = fleet.stop();
    let host = &ledger.hosts["edge"];
    assert_eq!(host.missing, account.dropped, "{host:?}, {account:?}");
    assert_eq!(ledger.lacks(fleet.agents[0].spooled()), 0);
    let first = &fleet.agents[0].spooled()[0].run;
    let second = ledger.runs.iter().filter(|(id, _)| *id != first).map(|(_, run)| run.iterations());
    assert!(host.missing + second.sum::<u64>() >= answers, "{answers} answers: {host:?}");
    measured(
        "full disk at the start, spool",
        &[
            ("iterations measured", thousands(answers as f64)),
            ("events counted in gaps", thousands(host.missing as f64)),
        ],
    );
}
