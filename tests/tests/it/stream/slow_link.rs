//! Test of an agent behind a link with a quarter of the rate that it produces.

use std::time::Duration;

use peernet_tests::fleet::{echo, rate};
use peernet_tests::network::HOME;
use peernet_tests::{Account, Ledger, Network, Plant, Since, say, wall};

use super::turn;

const KBIT: u32 = 50;
const HZ: f64 = 100.0;
const ITERATIONS: u64 = 3_500;
/// Largest lag of the live state on a busy machine, seconds; 2.5 s were observed.
const MOST_BEHIND_S: f64 = 5.0;

#[test]
fn a_host_behind_fifty_kilobits_stays_live_and_loses_nothing() {
    let _turn = turn();
    let plant = Plant::new(|_| Network::direct());
    let host = plant.network.edge();
    host.throttle(HOME, KBIT);
    let more = format!("{}\nlimit = {{ total = {ITERATIONS} }}", rate(HZ));
    let model = "[[model]]\nname = \"echo\"\nkind = \"echo\"\n";
    let edge = plant.edge(&format!("{model}{}", echo("line", &more)), &[]);
    let began = Since::now();
    let first = Account::until(&plant.api, "edge", "it is live", |account| account.produced > 0);

    let (mut behind, mut stored, mut asked) = (0.0_f64, first.events, 0);
    while began.elapsed() < Duration::from_secs(35) {
        let account = Account::of(&plant.api, "edge").expect("the aggregator answers");
        assert!(account.connected, "away after {:?}: {account:?}", began.elapsed());
        assert!(account.events >= stored, "{account:?}");
        account.balances();
        behind = behind.max(account.live_lag_s);
        (stored, asked) = (account.events, asked + 1);
        std::thread::sleep(Duration::from_millis(250));
    }
    say(&format!("{KBIT} kbit/s: {behind:.2} s behind at most, {stored} events stored, asked {asked} times"));
    assert!(behind <= MOST_BEHIND_S, "the live picture was {behind} s behind");
    // Compressed events have some hundred bytes each.
    assert!(stored >= 300, "the durable lane stored {stored} events only");
    assert!(stored < ITERATIONS, "the link was not slow");

    host.open_up(HOME);
    let account = Account::at_rest(&plant.api, "edge", wall());
    account.balances();
    assert_eq!((account.dropped, account.gaps, account.missing, account.duplicates), (0, 0, 0, 0));
    let ended = edge.stop();
    assert_eq!(ended.code(), 0, "{}", ended.log);
    assert_eq!(ended.log.matches("connected to the aggregator").count(), 1, "{}", ended.log);
    let database = plant.folder().join("aggregator.sqlite");
    plant.stop_leaving(|| {
        let ledger = Ledger::of(&database);
        ledger.agrees();
        assert_eq!(ledger.iterations(), ITERATIONS);
        assert!(ledger.runs.values().all(|run| run.is_whole() && run.reason == "finished"), "{ledger:?}");
    });
}
