//! Tests of unfinished frames from peers without a session.

use peernet_tests::{LoopbackDeployment, record_measurements, wait_until};

use super::{Peer, peak_memory};

/// Largest peak memory, bytes. A daemon in a debug build takes 70 MB, and all unauthenticated peers together may take
/// 16 MiB; the rest is margin.
const MAX_RESIDENT_BYTES: u64 = 200_000_000;

#[test]
fn unfinished_samples_without_session_take_bounded_memory() {
    let deployment = LoopbackDeployment::new();
    let tables =
        "[serve]\nlisten = \"tcp://127.0.0.1:{data}\"\n[[model]]\nname = \"echo\"\nkind = \"echo\"\n";
    let cloud = deployment.start_agent("cloud", tables);
    cloud.wait_for("ready");
    let before = peak_memory(&cloud);
    let mut peers: Vec<Peer> = (0..30).map(|_| Peer::connect_with_handshake(deployment.data_port)).collect();
    let sent: usize = peers.iter_mut().map(|peer| peer.send_unfinished(60_000_000)).sum();
    wait_until("all are closed", || peers.iter_mut().all(Peer::is_closed).then_some(()));
    let peak = peak_memory(&cloud);
    record_measurements(
        "30 unfinished frames of 60 MB",
        &[("bytes sent", sent.to_string()), ("peak before", before.to_string()), ("peak", peak.to_string())],
    );
    assert!(peak < MAX_RESIDENT_BYTES, "{peak} bytes, {before} before");
    assert!(cloud.log().contains("large_before_hello"), "{}", cloud.log());
    assert_eq!(cloud.stop().code(), 0);
}

#[test]
fn unfinished_batches_without_hello_take_bounded_memory() {
    let deployment = LoopbackDeployment::new();
    let (aggregator, api) = deployment.start_aggregator();
    let before = peak_memory(&aggregator);
    let mut peers: Vec<Peer> =
        (0..450).map(|_| Peer::connect_with_handshake(deployment.events_port)).collect();
    let sent: usize = peers.iter_mut().map(|peer| peer.send_unfinished(3_900_000)).sum();
    wait_until("all are closed", || peers.iter_mut().all(Peer::is_closed).then_some(()));
    let peak = peak_memory(&aggregator);
    record_measurements(
        "450 unfinished frames of 3.9 MB",
        &[("bytes sent", sent.to_string()), ("peak before", before.to_string()), ("peak", peak.to_string())],
    );
    assert!(peak < MAX_RESIDENT_BYTES, "{peak} bytes, {before} before");
    let (_, metrics) = api.get("/metrics").expect("the dashboard answers");
    let expected_metric = "peernet_aggregator_rejected_connections_total{reason=\"large_before_hello\"} 450";
    assert!(metrics.contains(expected_metric), "{metrics}");
    assert_eq!(aggregator.stop().code(), 0);
}
