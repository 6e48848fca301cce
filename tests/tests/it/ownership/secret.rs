//! Tests of agents that prove their id, and of others that cannot.

use std::path::PathBuf;

use peernet_logger::HostId;
use peernet_stream::{ToAgent, ToAggregator};
use peernet_tests::truth::query_database;
use peernet_tests::{Fleet, InventedHost, MisbehavingPeer, TestRng, wait_until};

use super::start_fleet;

fn state_folder(fleet: &Fleet) -> PathBuf {
    fleet.deployment.folder().join("edge")
}

fn read_secret(fleet: &Fleet) -> String {
    std::fs::read_to_string(state_folder(fleet).join("host-secret"))
        .expect("made at the first start")
        .trim()
        .to_owned()
}

/// Returns a host that claims to be the robot, without its secret.
fn host_without_secret(fleet: &Fleet, rng: &mut TestRng) -> InventedHost {
    let id = std::fs::read_to_string(state_folder(fleet).join("host-id")).expect("made at the first start");
    let mut impostor = InventedHost::new("edge", rng);
    impostor.hello.host.id = id.trim().parse::<HostId>().expect("an id");
    impostor
}

/// Runs `peernetd clear-host-secret` for the robot while the aggregator runs.
fn clear_host_secret(fleet: &Fleet) -> String {
    let end = fleet
        .deployment
        .peernetd(&["clear-host-secret", "--config", "aggregator.toml", "edge"])
        .wait_for_end();
    assert_eq!(end.code(), 0, "{}", end.log);
    end.log
}

#[test]
fn impostor_does_not_exclude_known_host() {
    let mut rng = TestRng::new("impostor");
    let mut fleet = start_fleet("");
    // The robot leaves with batches that are not stored.
    fleet.aggregator.kill();
    let spooled = fleet.agents[0].process().log().matches("spooled batch=").count();
    fleet.agents[0].process().wait_for_nth("spooled batch=", spooled + 5);
    fleet.agents[0].kill();
    fleet.restart_aggregator();

    let misbehaving_peer = MisbehavingPeer::connect(fleet.deployment.events_port);
    let mut impostor = host_without_secret(&fleet, &mut rng);
    let reason = impostor.expect_refusal(&misbehaving_peer);
    assert!(reason.contains("clear-host-secret") && reason.contains("spool"), "{reason}");
    assert!(!reason.contains("delete the"), "no advice destroys unsent data: {reason}");
    // The impostor gets no welcome, whatever it sends afterwards.
    misbehaving_peer.send(&impostor.batch(10));
    misbehaving_peer.receive_until(|message| (*message == ToAgent::Unknown).then_some(()));
    misbehaving_peer.send_message(&ToAggregator::Goodbye(impostor.hello.host.id));
    // While the impostor repeats its hello, the robot comes back as a new process.
    for _ in 0..20 {
        misbehaving_peer.send_message(&ToAggregator::Hello(impostor.hello.clone()));
    }
    fleet.start(0);
    fleet.agents[0].process().wait_for("connected to the aggregator");
    assert!(!fleet.agents[0].process().log().contains("refuses this agent"));
    let reason = impostor.expect_refusal(&misbehaving_peer);
    assert!(reason.contains("clear-host-secret"), "{reason}");
    let before = fleet.wait_for_counts(0, "the agent reports", |_| true);
    fleet.wait_for_counts(0, "more events of the robot are stored", |counts| {
        counts.stored > before.stored + 50 && counts.waiting < 100
    });
    fleet.agents[0].stop();
    fleet.deliver_spool(0).assert_balanced();
    let stored_events = fleet.stop();
    assert_eq!(stored_events.count_missing(fleet.agents[0].spooled_iterations()), 0, "{stored_events:?}");
    // A gap may report events that were not in the spool when the robot was killed. Even so, the stream continues.
    assert_eq!(stored_events.hosts["edge"].streams, 1, "{stored_events:?}");
}

#[test]
fn host_secret_survives_loss_of_spool_or_database() {
    let mut fleet = start_fleet("");
    let before = read_secret(&fleet);
    assert_eq!(before.len(), 64);
    fleet.agents[0].stop();
    for entry in std::fs::read_dir(state_folder(&fleet)).expect("the folder exists") {
        let path = entry.expect("readable").path();
        if path.file_name().is_some_and(|name| name.to_string_lossy().starts_with("spool.sqlite")) {
            std::fs::remove_file(path).expect("deleted");
        }
    }
    fleet.start_without_pipelines(0);
    assert_eq!(read_secret(&fleet), before);
    assert_eq!(query_database(fleet.database(), "SELECT lower(hex(secret)) FROM host_secret").trim(), before);

    // The secret is not shown anywhere.
    let pages = [
        "/",
        "/hosts",
        "/api/v1/hosts",
        "/api/v1/hosts/edge",
        "/api/v1/runs",
        "/api/v1/incidents",
        "/metrics",
    ];
    let texts = pages.map(|page| {
        let (status, text) = fleet.api.get(page).expect("answers");
        assert_eq!(status, 200, "{page}: {text}");
        text
    });
    let logs = [fleet.agents[0].process().log(), fleet.aggregator.process().log()];
    for text in texts.iter().chain(&logs) {
        assert!(!text.to_lowercase().contains(&before), "{text}");
    }

    fleet.agents[0].stop();
    fleet.aggregator.stop();
    std::fs::remove_dir_all(fleet.database().parent().expect("a folder of its own"))
        .expect("the aggregator has stopped");
    fleet.restart_aggregator();
    fleet.start(0);
    fleet.wait_for_counts(0, "events are stored again", |counts| counts.stored > 20);
    assert_eq!(query_database(fleet.database(), "SELECT lower(hex(secret)) FROM host_secret").trim(), before);
    fleet.stop();
}

#[test]
fn cleared_secret_permits_new_secret() {
    let mut fleet = start_fleet("");
    let before = read_secret(&fleet);
    fleet.agents[0].stop();
    std::fs::remove_file(state_folder(&fleet).join("host-secret")).expect("the secret existed");
    fleet.start(0);
    let output = fleet.agents[0].process().wait_for("refuses this agent");
    assert!(output.contains("clear-host-secret"), "{output}");
    let output = clear_host_secret(&fleet);
    assert!(output.contains("deleted the secret of edge"), "{output}");
    fleet.agents[0].process().wait_for("connected to the aggregator");
    let after = read_secret(&fleet);
    assert_ne!(after, before);
    wait_until("the new secret is stored", || {
        let stored = query_database(fleet.database(), "SELECT lower(hex(secret)) FROM host_secret");
        (stored.trim() == after).then_some(())
    });
    fleet.wait_for_counts(0, "the waiting events are stored", |counts| counts.waiting < 100);
    fleet.agents[0].stop();
    fleet.deliver_spool(0).assert_balanced();
    let stored_events = fleet.stop();
    assert_eq!(stored_events.count_missing(fleet.agents[0].spooled_iterations()), 0, "{stored_events:?}");
}

#[test]
fn robot_takes_its_name_back_from_newcomer() {
    let mut rng = TestRng::new("namesake");
    let mut fleet = start_fleet("");
    fleet.agents[0].stop();
    let misbehaving_peer = MisbehavingPeer::connect(fleet.deployment.events_port);
    let namesake = InventedHost::new("edge", &mut rng);
    namesake.open_session(&misbehaving_peer);
    fleet.start(0);
    fleet.agents[0].process().wait_for("connected to the aggregator");
    assert!(!fleet.agents[0].process().log().contains("refuses this agent"));
    let reason = namesake.expect_refusal(&misbehaving_peer);
    assert!(reason.contains("the name edge is taken"), "{reason}");
    fleet.stop();
}
