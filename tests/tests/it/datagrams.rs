//! Tests of a pipeline over `zmq-udp` whose path, cloud or port fails.

use std::net::Ipv4Addr;
use std::time::Duration;

use peernet_tests::network::{DATA_INTERFACE, Network, WireProperties};
use peernet_tests::{Stopwatch, TwoHostTestbed, wait_until};

const LINK: &str = "/api/v1/links/edge~cloud~zmq-udp";

const LOAD: &str = "load = { mode = \"rate\", hz = 20.0 }";

/// Returns the number of answered iterations of the only run.
fn answered_iterations(testbed: &TwoHostTestbed) -> u64 {
    let runs = testbed.api.json("/api/v1/runs");
    let ok = runs["runs"].get(0).and_then(|run| run["counts"]["ok"].as_u64());
    ok.unwrap_or_default()
}

/// Waits until this many further iterations are answered.
fn wait_until_answered(testbed: &TwoHostTestbed, iterations: u64) {
    let target = answered_iterations(testbed) + iterations;
    wait_until("answers", || (answered_iterations(testbed) >= target).then_some(()));
}

/// Waits until one end of the only connection is at an address.
fn wait_until_address_is(testbed: &TwoHostTestbed, end: &str, address: Ipv4Addr) {
    testbed.api.wait_until(LINK, |link| {
        let shown = link["now"]["connections"].get(0)?[end].as_str()?;
        shown.starts_with(&format!("{address}:")).then_some(())
    });
}

/// Waits until the page of the link contains a text.
fn wait_until_page_contains(testbed: &TwoHostTestbed, text: &str) {
    wait_until(text, || {
        let (_, page) = testbed.api.get("/links/edge~cloud~zmq-udp")?;
        page.contains(text).then_some(())
    });
}

#[test]
fn session_survives_small_mtu_and_moved_hosts() {
    let testbed = TwoHostTestbed::with_scheme("udp", |_| Network::direct());
    let cloud = testbed.start_cloud("");
    // No system permits such a large socket buffer by default.
    let pipeline = testbed.pipeline("line", 20_000, LOAD);
    let large = "session = { socket_buffer_bytes = 1073741824 }, model =";
    let edge = testbed.start_edge(&pipeline.replace("model =", large), &[]);
    wait_until_answered(&testbed, 20);
    let warning = "the system caps the buffers of UDP sockets at ";
    let output = edge.wait_for(warning);
    assert!(output.contains("sysctl -w net.core.rmem_max=1073741824"), "{output}");
    wait_until_page_contains(&testbed, warning);
    let (edge_host, cloud_host) = (testbed.network.edge(), testbed.network.cloud());
    for host in [edge_host, cloud_host] {
        host.set_mtu(DATA_INTERFACE, 1_280);
    }
    wait_until_answered(&testbed, 20);

    // This address is in the same network, and no host has it.
    let new_address = Ipv4Addr::from_bits(edge_host.address.to_bits() + 8);
    edge_host.change_address(new_address);
    wait_until_address_is(&testbed, "local_address", new_address);
    wait_until_answered(&testbed, 20);
    let new_address = Ipv4Addr::from_bits(cloud_host.address.to_bits() + 8);
    cloud_host.change_address(new_address);
    wait_until_address_is(&testbed, "remote_address", new_address);
    wait_until_answered(&testbed, 20);
    let (edge, cloud) = (edge.stop(), cloud.stop());
    assert_eq!((edge.code(), cloud.code()), (0, 0), "{}\n{}", edge.log, cloud.log);
    assert!(!edge.log.contains("lost the connection to cloud"), "{}", edge.log);
}

#[test]
fn pipeline_recovers_from_link_and_restart_faults() {
    let testbed = TwoHostTestbed::with_scheme("udp", |_| Network::direct());
    let cloud = testbed.start_cloud("");
    let edge = testbed.start_edge(&testbed.pipeline("line", 20_000, LOAD), &[]);
    wait_until_answered(&testbed, 20);

    let (cloud_host, stopwatch) = (testbed.network.cloud(), Stopwatch::start());
    cloud_host.drop_all();
    let output = edge.wait_for("lost the connection to cloud");
    assert!(
        output.contains("udp://") && output.contains("nothing was received from the peer for 5 s"),
        "{output}"
    );
    // The path is cut for ten seconds in all.
    std::thread::sleep(Duration::from_secs(10).saturating_sub(stopwatch.elapsed()));
    cloud_host.clear_rules();
    edge.wait_for_nth("connected to cloud", 2);
    wait_until_answered(&testbed, 20);

    cloud.kill();
    edge.wait_for_nth("lost the connection to cloud", 2);
    let _cloud = testbed.start_cloud("");
    edge.wait_for_nth("connected to cloud", 3);
    wait_until_answered(&testbed, 20);

    cloud_host.block_udp(5551);
    edge.wait_for_nth("lost the connection to cloud", 3);
    cloud_host.clear_rules();
    edge.wait_for_nth("connected to cloud", 4);
    wait_until_answered(&testbed, 20);
    let runs = testbed.api.json("/api/v1/runs");
    assert_eq!(runs["runs"].as_array().map(Vec::len), Some(1), "the same run continues: {runs}");
}

#[test]
fn reduced_path_mtu_is_reported_and_session_continues() {
    let wire_direction = WireProperties { delay_ms: 0, jitter_ms: 0, loss_percent: 0 };
    let testbed =
        TwoHostTestbed::with_scheme("udp", |folder| Network::wire(folder, wire_direction, wire_direction));
    let _cloud = testbed.start_cloud("[serve.session]\ndatagram_bytes = 1400\n");
    let pipeline = testbed.pipeline("line", 20_000, LOAD);
    let pipeline = pipeline.replace("model =", "session = { datagram_bytes = 1400 }, model =");
    let edge = testbed.start_edge(&pipeline, &[]);
    wait_until_answered(&testbed, 20);

    testbed.network.cloud().drop_longer_than(1_300);
    let output = edge.wait_for("lost the connection to cloud");
    assert!(
        output.contains("long datagrams do not arrive any more") && output.contains("datagram_bytes"),
        "{output}"
    );
    edge.wait_for("continuing with 1200 bytes");
    edge.wait_for_nth("connected to cloud", 2);
    wait_until_answered(&testbed, 20);
    wait_until_page_contains(&testbed, "long datagrams do not arrive any more");
}
