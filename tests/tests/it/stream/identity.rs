//! Tests of restored databases and of copied or deleted spools: they are recognised and never merged wrongly.

use std::path::Path;

use peernet_tests::fleet::{echo, edge, edge_in, rate};
use peernet_tests::truth::ask;
use peernet_tests::{Daemon, Fleet, measured, thousands};

use super::{nothing_lost, turn};

/// Copies a folder with all its files.
fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).expect("the temporary folder is writable");
    for entry in std::fs::read_dir(from).expect("the folder is there") {
        let entry = entry.expect("readable");
        std::fs::copy(entry.path(), to.join(entry.file_name())).expect("copied");
    }
}

/// Stops an agent's measurement and waits until everything is delivered.
fn nothing_waits(fleet: &mut Fleet, agent: usize) {
    fleet.agents[agent].stop();
    let since = fleet.idle(agent);
    fleet.account(agent, "nothing waits", |account| account.seen > since && account.waiting == 0).balances();
}

/// Kills the aggregator, and some batches later the agent, so that these batches wait in its spool.
fn killed_with_batches(fleet: &mut Fleet) {
    fleet.aggregator.kill();
    let spooled = fleet.agents[0].process().log().matches("spooled batch=").count();
    fleet.agents[0].process().wait_for_nth("spooled batch=", spooled + 5);
    fleet.agents[0].kill();
}

#[test]
fn a_database_restored_from_an_older_copy_shows_the_hole_and_goes_on() {
    let _turn = turn();
    let mut fleet = Fleet::new(&["edge"], &edge("", &echo("loop", &rate(500.0))));
    fleet.start(0);
    fleet.account(0, "something is stored", |account| account.events > 500);
    let store = fleet.database().parent().expect("a folder of its own").to_owned();
    let backup = fleet.site.folder().join("backup");
    fleet.aggregator.stop();
    copy(&store, &backup);
    let older = fleet.ledger();

    fleet.aggregator_returns();
    let before = fleet.account(0, "it is back", |_| true);
    fleet.account(0, "more is stored", |account| account.stored > before.stored + 1_000);
    fleet.aggregator.stop();
    let newer = fleet.ledger();
    std::fs::remove_dir_all(&store).expect("the aggregator has stopped");
    copy(&backup, &store);

    fleet.aggregator_returns();
    fleet.account(0, "newer batches are stored", |account| account.events > older.iterations() + 1_000);
    nothing_waits(&mut fleet, 0);
    let ledger = fleet.stop();
    let (host, run) = (&ledger.hosts["edge"], ledger.runs.values().next().expect("one run"));
    assert_eq!((host.gaps, host.streams, host.quarantined), (1, 1, 0), "{host:?}");
    assert_eq!((ledger.runs.len(), run.ranges.len()), (1, 2), "one hole: {run:?}");
    assert_eq!(run.reason, "stopped");
    // The gap begins where the copy ended, and is not longer than the lost part of the database.
    assert_eq!(run.ranges[0], 1..=older.iterations());
    assert!(*run.ranges[1].start() <= newer.iterations() + 1, "{run:?}, {newer:?}");
    let why = ask(fleet.database(), "SELECT reason FROM gap");
    assert!(!why.trim().is_empty());
    let (first, last) = (run.ranges[0].end() + 1, run.ranges[1].start() - 1);
    measured(
        "restored database",
        &[
            ("iterations missing by the hole", thousands((last - first + 1) as f64)),
            ("stored before and after", thousands(ledger.iterations() as f64)),
            ("gap", why.trim().to_owned()),
        ],
    );
}

#[test]
fn a_copied_state_folder_is_refused_while_the_first_lives_and_is_a_stream_of_its_own_later() {
    let _turn = turn();
    let configuration = edge("", &echo("loop", &rate(200.0)));
    let mut fleet = Fleet::new(&["edge"], &configuration);
    fleet.start(0);
    fleet.account(0, "something is stored", |account| account.events > 100);
    // The copied spool contains batches that the first agent delivers before the copy connects.
    killed_with_batches(&mut fleet);
    let folder = fleet.site.folder();
    copy(&folder.join("edge"), &folder.join("copy"));
    fleet.aggregator_returns();
    fleet.start(0);
    fleet.account(0, "it delivers", |account| account.waiting < 100);

    let copied = edge_in("{folder}/copy", "", &echo("loop", &rate(200.0))).replace("NAME", "copy");
    let mut copy = Daemon::started(&fleet.site, "copy", &copied);
    let said = copy.process().wait_for("refused");
    assert!(said.contains("another agent with the host id"), "{said}");
    copy.stop();
    fleet.account(0, "the first goes on", |account| account.waiting < 100);
    fleet.agents[0].stop();
    fleet.deliver(0).balances();
    fleet.agents[0].stop();

    copy.start(&fleet.site);
    copy.process().wait_for("new stream");
    fleet.agents.push(copy);
    fleet.account(1, "what the copy measures is stored", |account| {
        account.waiting < 100 && account.stored > 500
    });
    nothing_waits(&mut fleet, 1);
    let ledger = fleet.stop();
    assert_eq!(ledger.lacks(fleet.agents[0].spooled()), 0, "{ledger:?}");
    assert_eq!(ledger.lacks(fleet.agents[1].spooled()), 0, "{ledger:?}");
    let streams = ask(fleet.database(), "SELECT count(*) FROM stream");
    assert_eq!(streams.trim(), "2", "the copy goes on in a stream of its own: {ledger:?}");
    for (id, run) in &ledger.runs {
        assert!(run.is_whole(), "run {id}: {run:?}");
    }
}

#[test]
fn a_deleted_spool_is_a_new_stream_and_a_gap() {
    let _turn = turn();
    let mut fleet = Fleet::new(&["edge"], &edge("", &echo("loop", &rate(200.0))));
    fleet.start(0);
    fleet.account(0, "something is stored", |account| account.events > 100);
    killed_with_batches(&mut fleet);
    for entry in std::fs::read_dir(fleet.site.folder().join("edge")).expect("the state is there") {
        let path = entry.expect("readable").path();
        if path.file_name().is_some_and(|name| name.to_string_lossy().starts_with("spool.sqlite")) {
            std::fs::remove_file(path).expect("deleted");
        }
    }
    fleet.aggregator_returns();
    fleet.start(0);
    fleet.account(0, "a gap", |account| account.missing > 0 || account.events > 300);
    nothing_waits(&mut fleet, 0);
    let mut ledger = fleet.stop();
    let host = ledger.hosts.get_mut("edge").expect("stored");
    assert_eq!((host.streams, host.gaps, host.quarantined), (2, 1, 0), "{host:?}");
    let why = ask(fleet.database(), "SELECT reason FROM gap");
    assert!(why.contains("spool"), "{why}");
    // Apart from the gap, which is in the run that was killed, everything is right.
    host.gaps = 0;
    assert_eq!(ledger.runs.len(), 2, "{ledger:?}");
    assert!(ledger.runs.values().all(|run| run.is_whole()), "{ledger:?}");
}

#[test]
fn two_agents_in_one_folder_are_one_too_many() {
    let _turn = turn();
    let mut fleet = Fleet::new(&["edge"], &edge("", &echo("loop", &rate(100.0))));
    fleet.start(0);
    fleet.account(0, "something is stored", |account| account.events > 0);
    let second = edge_in("{folder}/edge", "", "").replace("NAME", "second");
    fleet.site.write("second.toml", &second);
    let ended = fleet.site.start("second.toml").ended();
    assert_eq!(ended.code(), 69, "{}", ended.log);
    assert!(ended.log.contains("another agent uses"), "{}", ended.log);
    fleet.agents[0].stop();
    fleet.deliver(0).balances();
    let ledger = fleet.stop();
    nothing_lost(&fleet, &ledger);
}
