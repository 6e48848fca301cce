//! A full disk under an agent's spool.

use peernet_tests::fleet::{echo, edge_in, rate};
use peernet_tests::{Fleet, SmallDisk, measured, thousands};

use super::turn;

#[test]
fn a_full_disk_under_the_spool_is_said_and_what_does_not_fit_is_counted() {
    let _turn = turn();
    let (store, state) = (SmallDisk::new(48 << 20), SmallDisk::new(16 << 20));
    let database = store.folder().join("aggregator.sqlite").display().to_string();
    let folder = state.folder().join("NAME").display().to_string();
    // What waits in memory meanwhile is soon too much.
    let agent = edge_in(&folder, "queue_events = 4000", &echo("loop", &rate(2_000.0)));
    let mut fleet = Fleet::storing_in(&database, &["edge"], &agent);
    fleet.start(0);
    fleet.account(0, "something is stored", |account| account.events > 100);

    // The spool alone: events still arrive, by the way that is left.
    state.fill();
    let before = fleet.account(0, "it is known", |_| true);
    let now = fleet.account(0, "more is stored", |account| account.events > before.events + 4_000);
    assert_eq!(now.dropped, 0, "{now:?}");

    // Nobody takes them any more, so that the spool has to grow and cannot.
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
