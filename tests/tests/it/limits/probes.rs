//! Test of forged probes from an unknown host.

use peernet_tests::network::Host;
use peernet_tests::{Network, TwoHostTestbed, wait_until};

/// Port of the reflector.
const PORT: &str = "8620";

/// Rate of forged probes: low enough for the reflector to process all of them beside other tests, and ten times the
/// rate of answers.
const FORGED_HZ: u64 = 10_000;
/// Duration of the flood.
const SECONDS: u64 = 4;

/// Rate of the edge's own probes.
const EDGE_HZ: u64 = 50;

/// Largest rate of answers to all peers without a session, with a burst of the same number (docs/configuration.md).
const ANSWERED_HZ: u64 = 1_000;

/// Returns the number of UDP packets that a host has sent.
fn sent_packets(host: &Host) -> u64 {
    let counts = host.run("cat", &["/proc/net/snmp"]);
    let udp = counts.lines().filter(|line| line.starts_with("Udp:")).nth(1).expect("the kernel counts");
    udp.split_whitespace().nth(4).and_then(|count| count.parse().ok()).expect("OutDatagrams")
}

/// Returns the number of sent probes and the number of lost probes of the edge.
fn probe_counts(testbed: &TwoHostTestbed) -> (u64, u64) {
    let counts = testbed.query_database(
        "SELECT coalesce(sum(probes_sent), 0), coalesce(sum(probes_lost), 0) FROM clock_sample",
    );
    let mut counts = counts.split('|').map(|count| count.trim().parse::<u64>().expect("a number"));
    (counts.next().expect("two columns"), counts.next().expect("two columns"))
}

#[test]
fn peer_with_session_is_answered_during_forged_flood() {
    let testbed = TwoHostTestbed::new(|_| Network::direct().with_third_host());
    let (cloud, third_host) = (testbed.network.cloud(), testbed.network.third_host());
    // With these settings, the cloud accepts packets with forged source addresses and sends the answers.
    for interface in ["all", "third"] {
        cloud.run("sysctl", &["-qw", &format!("net.ipv4.conf.{interface}.rp_filter=0")]);
    }
    cloud.run("ip", &["route", "add", "11.0.0.0/8", "via", &third_host.address.to_string()]);
    let _cloud = testbed.start_cloud("");
    let pipeline = testbed.pipeline("steady", 100, "load = { mode = \"rate\", hz = 20.0 }");
    let probes = format!("[probes]\nrate_hz = {EDGE_HZ}.0\nidle_rate_hz = {EDGE_HZ}.0\n");
    let _edge = testbed.start_edge(&(probes + &pipeline), &[]);
    wait_until("probes", || (probe_counts(&testbed).0 > EDGE_HZ).then_some(()));

    let (counts_before, answers_before) = (probe_counts(&testbed), sent_packets(cloud));
    let script = peernet_tests::root().join("tests/tests/it/limits/forged_probes.py");
    let arguments = [
        &script.display().to_string(),
        &testbed.network.cloud_address_for_third_host().to_string(),
        PORT,
        &FORGED_HZ.to_string(),
        &SECONDS.to_string(),
    ];
    let forged_probes = third_host.run("python3", &arguments);
    let forged_probes: u64 = forged_probes.trim().parse().expect("the script prints a number");
    let answers = sent_packets(cloud) - answers_before;
    // A probe counts as lost after two seconds, so the test waits for the probes of three more seconds.
    let expected_probes = counts_before.0 + EDGE_HZ * (SECONDS + 3);
    wait_until("the results of the probes", || (probe_counts(&testbed).0 > expected_probes).then_some(()));
    let lost_probes = probe_counts(&testbed).1 - counts_before.1;

    assert!(
        forged_probes > ANSWERED_HZ * (SECONDS + 2) * 2,
        "too few forged probes to reach the limit: {forged_probes}"
    );
    // Two seconds more than the flood: one for the burst, one as margin. The second term is twice the
    // number of answers to the edge's probes.
    let max_answers = ANSWERED_HZ * (SECONDS + 2) + 2 * EDGE_HZ * SECONDS;
    assert!(answers <= max_answers, "{answers} answers to {forged_probes} forged probes");
    // At most one in twenty may be lost.
    assert!(lost_probes * 20 <= EDGE_HZ * SECONDS, "{lost_probes} of the edge's probes were lost");
}
