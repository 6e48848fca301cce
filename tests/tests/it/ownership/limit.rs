//! Tests of invented hosts.

use peernet_stream::ToAggregator;
use peernet_tests::truth::query_database;
use peernet_tests::{InventedHost, MisbehavingPeer, TestRng, record_measurements, thousands, wait_until};

use super::start_fleet;

/// Maximum number of stored hosts.
const MAX_HOSTS: usize = 50;
/// Number of connections over which invented hosts say hello.
const CONNECTIONS: usize = 320;
/// Number of hosts that only say hello, on each connection.
const HELLOS_PER_CONNECTION: usize = 62;

#[test]
fn invented_hosts_leave_pages_and_metrics_bounded() {
    let mut rng = TestRng::new("invented hosts");
    let mut fleet = start_fleet(&format!("max_hosts = {MAX_HOSTS}"));
    let bytes = |path: &str| fleet.api.get(path).expect("answers").1.len();
    let (metrics_before, list_before) = (bytes("/metrics"), bytes("/api/v1/hosts"));
    // Most hosts only say hello. On ten of the connections, further hosts prove their ids.
    let peers: Vec<MisbehavingPeer> =
        (0..CONNECTIONS).map(|_| MisbehavingPeer::connect(fleet.deployment.events_port)).collect();
    for misbehaving_peer in &peers {
        for _ in 0..HELLOS_PER_CONNECTION {
            let name = format!("invented-{}", rng.below(1 << 30));
            misbehaving_peer.send_message(&ToAggregator::Hello(InventedHost::new(&name, &mut rng).hello));
        }
    }
    let (mut proven, mut newest) = (0, String::new());
    for (peer_number, misbehaving_peer) in (0..).zip(&peers[..10]) {
        for host_number in 0..20 {
            newest = format!("proven-{peer_number}-{host_number}");
            InventedHost::new(&newest, &mut rng).open_session(misbehaving_peer);
            proven += 1;
        }
    }
    let (host_count, metrics_after, list_after) = wait_until("the newest host is in the list", || {
        let hosts = fleet.api.json("/api/v1/hosts");
        let hosts = hosts["hosts"].as_array()?;
        let is_seen = hosts.iter().any(|host| host["name"] == newest.as_str());
        is_seen.then(|| (hosts.len(), bytes("/metrics"), bytes("/api/v1/hosts")))
    });
    // The list has the robot, which has stored data, and at most as many new hosts as may be stored.
    assert!(host_count <= 1 + MAX_HOSTS, "{host_count} hosts");
    assert!(
        metrics_after < 100 * metrics_before,
        "{metrics_after} bytes of /metrics, {metrics_before} before"
    );
    assert!(list_after < 100 * list_before, "{list_after} bytes of the list, {list_before} before");
    assert_eq!(
        query_database(fleet.database(), "SELECT count(*) FROM host WHERE name <> 'edge'").trim(),
        "0"
    );
    assert_eq!(query_database(fleet.database(), "SELECT count(*) FROM host_secret").trim(), "1");
    drop(peers);
    wait_until("the invented hosts are forgotten", || {
        let hosts = fleet.api.json("/api/v1/hosts");
        (hosts["hosts"].as_array()?.len() == 1).then_some(())
    });
    let before_counts = fleet.wait_for_counts(0, "the agent reports", |_| true);
    fleet.wait_for_counts(0, "more events of the robot are stored", |counts| {
        counts.stored > before_counts.stored + 20
    });
    fleet.stop();
    record_measurements(
        "invented hosts",
        &[
            ("that said hello", thousands((CONNECTIONS * HELLOS_PER_CONNECTION) as f64)),
            ("that proved their id", proven.to_string()),
            ("hosts in the list afterwards", host_count.to_string()),
            ("bytes of /metrics before and afterwards", format!("{metrics_before} {metrics_after}")),
        ],
    );
}

#[test]
fn host_limit_refuses_new_hosts_only() {
    let mut rng = TestRng::new("too many hosts");
    let mut fleet = start_fleet("max_hosts = 2");
    let misbehaving_peer = MisbehavingPeer::connect(fleet.deployment.events_port);
    let mut second = InventedHost::new("second", &mut rng);
    second.open_session(&misbehaving_peer);
    misbehaving_peer.send(&second.batch(1));
    misbehaving_peer.wait_for_ack(1);
    let third = InventedHost::new("third", &mut rng);
    let reason = third.expect_refusal(&misbehaving_peer);
    assert!(reason.contains("max_hosts"), "{reason}");
    fleet.agents[0].stop();
    fleet.start(0);
    fleet.agents[0].process().wait_for("connected to the aggregator");
    second.open_session(&misbehaving_peer);
    fleet.stop();
}
